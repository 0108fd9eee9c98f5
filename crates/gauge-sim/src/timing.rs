// SPDX-License-Identifier: MIT

//! Every time that differs between parts or specimens, or that a knob sets.

use std::time::Duration;

use super::knob::KnobChoice;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Busy {
    /// Does not acknowledge its address.
    Nack,
    /// Holds the clock.
    Stretch,
    /// Answers as before.
    Old,
}

impl KnobChoice for Busy {
    const WORDS: &'static [(&'static str, Self)] =
        &[("nack", Busy::Nack), ("stretch", Busy::Stretch), ("old", Busy::Old)];
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Timing {
    /// From power to the first answer.
    pub(super) power_up: Duration,
    pub(super) reset: Duration,
    /// A gauge that answers as before resets at the end of that time.
    pub(super) reset_busy: Busy,
    /// A gauge that holds the clock during a reset also holds it after power-up; otherwise it is silent then.
    pub(super) power_up_stretches: bool,
    pub(super) first_voltage: Duration,
    /// For a 16-bit word of flash.
    pub(super) word: Duration,
    /// Erasing the row, before a commit.
    pub(super) commit: Duration,
    /// From selecting a block or an address until it is readable.
    pub(super) load: Duration,
    /// Until a block that a sealed gauge shows is readable.
    pub(super) sealed_load: Duration,
    /// From the checksum of a challenge until the digest is readable.
    pub(super) authentication: Duration,
    /// Silence on the bus before a key is accepted.
    pub(super) key_quiet: Duration,
    /// Silence before the key to FULL ACCESS, if longer.
    pub(super) full_access_quiet: Duration,
    /// Silence after a refused key.
    pub(super) refused_quiet: Duration,
    /// How long a self-sealed gauge refuses keys.
    pub(super) lock: Duration,
    /// From the first answer, or the detection of a battery, to the first prediction.
    pub(super) initializing: Duration,
    /// How long the first message in FULL SLEEP is held.
    pub(super) waking: Duration,
    pub(super) calibrating: Duration,
    /// From SET_CFGUPDATE to CONFIG UPDATE, and from the way out to its end.
    pub(super) update_enter: Duration,
    pub(super) update_leave: Duration,
}

impl Timing {
    /// The timing of the bq34z100-G1, and of other parts where nothing else is known.
    pub(super) const USUAL: Self = Self {
        // SLUSBZ5D 6.3.
        power_up: Duration::from_millis(250),
        // Not documented. Authors of drivers found it by trial.
        reset: Duration::from_millis(175),
        // Owners' programs that never repeat a transfer work right after RESET.
        reset_busy: Busy::Stretch,
        power_up_stretches: false,
        first_voltage: Duration::from_secs(1),
        // SLUSBZ5D 6.12.
        word: Duration::from_millis(2),
        commit: Duration::ZERO,
        load: Duration::ZERO,
        // Not documented. Drivers of similar parts wait because the block is blank at first.
        sealed_load: Duration::from_millis(20),
        authentication: Duration::from_millis(20),
        key_quiet: Duration::ZERO,
        full_access_quiet: Duration::ZERO,
        refused_quiet: Duration::ZERO,
        // SLUUAC9A 6.4.5.1.1.
        lock: Duration::from_secs(4),
        // Up to 10 s (SLUUAC9A 2.4.6).
        initializing: Duration::from_secs(2),
        // SLUSBZ5D 7.3.1.2.12.
        waking: Duration::from_millis(8),
        calibrating: Duration::from_secs(4),
        update_enter: Duration::ZERO,
        update_leave: Duration::ZERO,
    };

    pub(super) const MAC: Self = Self {
        power_up: Self::USUAL.reset,
        power_up_stretches: true,
        // An owner's full-access key was refused right after the unseal key and taken after a pause
        // (E2E 888302). TI advises 4 s of silence.
        full_access_quiet: Duration::from_secs(4),
        ..Self::USUAL
    };

    pub(super) fn knob(&mut self, name: &str) -> Option<&mut Duration> {
        Some(match name {
            "load_ms" => &mut self.load,
            "sealed_load_ms" => &mut self.sealed_load,
            "cfgupdate_ms" => &mut self.update_enter,
            "cfgexit_ms" => &mut self.update_leave,
            "auth_ms" => &mut self.authentication,
            "word_ms" => &mut self.word,
            "commit_ms" => &mut self.commit,
            "reset_ms" => &mut self.reset,
            "lock_ms" => &mut self.lock,
            "key_quiet_ms" => &mut self.key_quiet,
            "full_access_quiet_ms" => &mut self.full_access_quiet,
            "refused_quiet_ms" => &mut self.refused_quiet,
            _ => return None,
        })
    }
}
