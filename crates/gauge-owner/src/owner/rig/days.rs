// SPDX-License-Identifier: MIT

//! Days in the life of a device whose gauge loses its power now and then, with a pack that ages: how far the state of
//! charge that is shown is from the one that the pack really has.

use std::ops::Range;
use std::path::Path;
use std::time::Duration;

use super::Rig;
use crate::owner::{Learned, Run, operations};
use gauge_bus::clock::Clock as _;
use ti_gauge::chip::{Chip, Role};
use ti_gauge::dataflash::Change;
use ti_gauge::value::Value;

/// Charge of the pack when it is new, in mAh, which is its design capacity as well.
const DESIGN: i64 = 3000;
/// What of it is left after [`AGED`] days.
const LEFT: f64 = 0.8;
const AGED: f64 = 1000.0;
/// How often the gauge is polled, and compared with the pack.
const LOOK: Duration = Duration::from_secs(15 * 60);
const HOUR: Duration = Duration::from_secs(3600);

/// What is done about a loss of power.
#[derive(Clone, Copy, Debug)]
pub enum Remedy<'a> {
    /// Nothing: the gauge was configured once.
    Nothing,
    /// It has a profile.
    Profile,
    /// And what it has learned is kept in that folder.
    Learned(&'a Path),
}

/// How far what was shown was from the truth, in percent of the full charge, one figure for each look at a gauge in use.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    sorted: Vec<f64>,
    /// Looks at which nothing was shown, although the gauge had power.
    pub hidden: usize,
    /// Losses of power.
    pub losses: usize,
}

impl Errors {
    /// The error that a part of the looks did not exceed: 0.5 for the median, 1 for the worst one.
    pub fn quantile(&self, part: f64) -> f64 {
        let at = (part * self.sorted.len() as f64).ceil() as usize;
        self.sorted.get(at.saturating_sub(1)).copied().unwrap_or(f64::NAN)
    }

    /// Looks at which something was shown.
    pub fn looks(&self) -> usize {
        self.sorted.len()
    }
}

/// Chance that is the same for the same seed (splitmix64).
struct Chance(u64);

impl Chance {
    /// A number from `low` to `high`.
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut word = self.0;
        word = (word ^ (word >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        word = (word ^ (word >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        low + (high - low) * ((word ^ (word >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn of(&mut self, one_in: f64) -> bool {
        self.between(0.0, one_in) < 1.0
    }
}

struct Life {
    rig: Rig,
    chance: Chance,
    errors: Errors,
    charge: &'static ti_gauge::chip::Register,
}

/// Lets days of a pack's life pass. The same seed brings the same loads, charges and losses of power, whatever the remedy is.
pub fn days(chip: &'static Chip, days: Range<u32>, seed: u64, remedy: Remedy<'_>) -> Errors {
    let rows = chip.subclasses.iter().flat_map(|class| class.parameters.iter().map(move |row| (class, row)));
    let row = rows.into_iter().find(|(_, row)| row.name == "Design Capacity").expect("each has one");
    let profile = vec![Change::of_value(chip, row, &Value::Int(DESIGN), false).expect("it fits").saved()];
    let run = match remedy {
        Remedy::Nothing => Run::default(),
        Remedy::Profile => Run { profile: profile.clone(), ..Run::default() },
        Remedy::Learned(folder) => Run {
            profile: profile.clone(),
            learned: Some(Learned::new(folder.into(), "days".into(), Some("PACK".into()))),
            ..Run::default()
        },
    };
    let mut rig = Rig::of(chip.name, run);
    let charge = chip.register(Role::Capacity).expect("it shows a state of charge");
    rig.start().expect("it answers");
    rig.poll_after(Duration::from_secs(1));
    if matches!(remedy, Remedy::Nothing) {
        rig.ask(&operations::WRITE, profile).expect("it is UNSEALED");
    }
    let mut life = Life { rig, chance: Chance(seed), errors: Errors::default(), charge };
    for day in days {
        let left = 1.0 - (1.0 - LEFT) * f64::from(day) / AGED;
        life.set("real_mah", &format!("{:.1}", DESIGN as f64 * left));
        life.day();
    }
    life.errors.sorted.sort_by(f64::total_cmp);
    life.errors
}

impl Life {
    fn set(&self, knob: &str, value: &str) {
        self.rig.sim.set(knob, value).unwrap_or_else(|error| panic!("{knob} {value}: {error:?}"));
    }

    fn truth(&self) -> f64 {
        self.rig.sim.get("real_soc").and_then(|text| text.parse().ok()).expect("a number")
    }

    /// A morning at rest, hours of use with a pause, a night at the charger or not, and perhaps a loss of power at any of
    /// these times.
    fn day(&mut self) {
        let begin = self.rig.clock.now();
        // Each day draws as often as every other one.
        let lost_at =
            self.chance.of(4.0).then_some(()).map(|()| HOUR.mul_f64(self.chance.between(0.0, 23.0)));
        let for_how_long = HOUR.mul_f64(self.chance.between(0.02, 3.0));
        let (use_hours, pause, charges) =
            (self.chance.between(2.0, 9.0), self.chance.of(2.0), self.chance.of(1.4));
        let mut lost_at = lost_at;
        let loads: Vec<f64> = (0..24).map(|_| self.chance.between(120.0, 900.0)).collect();
        while let Some(time) = Some(self.rig.clock.now() - begin).filter(|time| *time < 24 * HOUR) {
            let hour = time.as_secs_f64() / 3600.0;
            let truth = self.truth();
            let load = match hour {
                ..6.0 => 0.0,
                // A pause of three hours in the middle, long enough for an open-circuit voltage.
                _ if pause && (9.0..12.0).contains(&hour) => 0.0,
                _ if hour < 6.0 + use_hours && truth > 6.0 => loads[hour as usize],
                ..16.0 => 0.0,
                _ if charges || truth < 30.0 => -1500.0,
                _ => 0.0,
            };
            if lost_at.is_some_and(|at| time >= at) {
                lost_at = None;
                self.lose(for_how_long);
                continue;
            }
            self.set("load_ma", &format!("{load:.0}"));
            self.rig.poll_after(LOOK);
            // At rest and at the charger everybody is right.
            if load > 0.0 {
                self.look();
            }
        }
    }

    /// The contact is open for a while.
    fn lose(&mut self, time: Duration) {
        self.errors.losses += 1;
        self.set("load_ma", "0");
        self.set("power", "off");
        self.rig.poll_after(time.max(LOOK));
        self.set("power", "on");
        for pause in [3, 3, 1, 5] {
            self.rig.poll_after(Duration::from_secs(pause));
        }
    }

    fn look(&mut self) {
        let truth = self.truth();
        let published = self.rig.handle.published();
        let shown =
            published.snapshot.as_ref().filter(|snapshot| snapshot.is_valid && snapshot.is_configured);
        match shown.and_then(|snapshot| snapshot.value(self.charge)) {
            Some(shown) => self.errors.sorted.push((shown as f64 - truth).abs()),
            None => self.errors.hidden += 1,
        }
    }
}
