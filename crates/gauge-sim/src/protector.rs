// SPDX-License-Identifier: MIT

//! The FETs of a part that drives them, and what opens them. Thresholds count at once, which is worst for a host that the
//! pack feeds.

use std::time::Duration;

use super::flash::Flash;
use super::model::{FREEZING, Place};

/// How long a wrong sum may stay.
const PATIENCE: Duration = Duration::from_secs(1);
/// In the answer with the sum: it is not the stored one.
const DIFFERS: u16 = 0x8000;

/// Data flash that the protector uses.
#[derive(Debug)]
pub(super) struct Protector {
    /// The stored sum, and the bytes that it is of.
    pub(super) sum: Place,
    pub(super) summed: [Place; 2],
    /// Each threshold, and the time in seconds until it counts; 0 switches it off.
    pub(super) over_voltage: (Place, Place),
    pub(super) under_voltage: (Place, Place),
    pub(super) hot: [(Place, Place); 2],
}

impl Protector {
    fn sums(&self, flash: &Flash) -> [u16; 2] {
        let summed = self.summed.iter().map(|&(id, offset)| u16::from(flash.u8(id, offset))).sum();
        [summed, flash.u16(self.sum.0, self.sum.1)]
    }

    /// The answer to the subcommand that adds up its bytes.
    pub(super) fn answer(&self, flash: &Flash) -> u16 {
        let [summed, stored] = self.sums(flash);
        if summed == stored { summed } else { summed | DIFFERS }
    }
}

#[derive(Debug, Default)]
pub(super) struct Fets {
    /// Since when there is a reason to open them.
    since: [Option<Duration>; REASONS.len()],
    /// What has opened them, for a moment or longer.
    opened: Vec<&'static str>,
}

const REASONS: [&str; 5] = ["checksum", "over-voltage", "under-voltage", "hot-charge", "hot-discharge"];

impl Fets {
    pub(super) fn open(&mut self, why: &'static str) {
        if !self.opened.contains(&why) {
            self.opened.push(why);
        }
    }

    pub(super) fn show(&self) -> String {
        if self.opened.is_empty() { "closed".into() } else { self.opened.join(" ") }
    }

    /// Compares what the part measures with its thresholds, and its sums. A voltage of 0 was not measured.
    pub(super) fn run(
        &mut self,
        part: &Protector,
        flash: &Flash,
        now: Duration,
        voltage_mv: u16,
        temperature: f64,
    ) {
        let limit = |(id, offset): Place| f64::from(flash.i16(id, offset));
        let after = |(id, offset): Place| {
            let seconds = flash.u8(id, offset);
            (seconds > 0).then(|| Duration::from_secs(seconds.into()))
        };
        let [summed, stored] = part.sums(flash);
        let (voltage, is_measured) = (f64::from(voltage_mv), voltage_mv > 0);
        let is_hot = |(at, _): (Place, Place)| temperature - FREEZING >= limit(at);
        let (over, under, [charge, discharge]) = (part.over_voltage, part.under_voltage, part.hot);
        let met = [
            (summed != stored, Some(PATIENCE)),
            (is_measured && voltage >= limit(over.0), after(over.1)),
            (is_measured && voltage <= limit(under.0), after(under.1)),
            (is_hot(charge), after(charge.1)),
            (is_hot(discharge), after(discharge.1)),
        ];
        for (at, (is_met, after)) in met.into_iter().enumerate() {
            let Some(after) = after.filter(|_| is_met) else {
                self.since[at] = None;
                continue;
            };
            if now >= *self.since[at].get_or_insert(now) + after {
                self.open(REASONS[at]);
            }
        }
    }

    /// Without power there is nothing to open.
    pub(super) fn lose_power(&mut self) {
        self.since = Default::default();
    }
}
