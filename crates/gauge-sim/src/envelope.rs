// SPDX-License-Identifier: MIT

//! Unfriendly behaviour of real gauges. Each behaviour is a knob, off at first; a seed draws one gauge from the whole
//! envelope, within the ranges that manuals, drivers and owners report.

use std::time::Duration;

use super::flash::{BLOCK, Flash};
use super::knob::{KnobChoice, KnobValue};
use super::model::Kept;
use super::part::{Part, Scheme};
use super::random::Random;
use super::timing::{Busy, Timing};
use gauge_bus::BusError;

/// What a block shows before it is loaded, with the checksum of that content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Early {
    Previous,
    Blank,
}

/// What a block shows whose bytes were written, until their sum commits them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Uncommitted {
    Written,
    Stored,
}

/// A row after a loss of power while it was programmed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Tear {
    /// The start is new, the rest old.
    RestOld,
    /// The start is new, the rest erased.
    RestErased,
    Old,
    Erased,
    /// The row is new, and some bytes of a neighbour in the same area are wrong. A row without a neighbour is erased.
    Neighbour,
}

/// Predictions before the first measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum First {
    Old,
    Nonsense,
}

/// The error that an adapter reports for a NACK. ENXIO and EREMOTEIO mean the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NackAs {
    Enxio,
    Eio,
    Etimedout,
    Eagain,
}

impl NackAs {
    pub(super) fn error(self) -> BusError {
        match self {
            NackAs::Enxio => BusError::NoAck,
            NackAs::Eio => BusError::Other(5),
            NackAs::Etimedout => BusError::Timeout,
            NackAs::Eagain => BusError::ArbitrationLost,
        }
    }
}

impl KnobChoice for Early {
    const WORDS: &'static [(&'static str, Self)] = &[("previous", Early::Previous), ("blank", Early::Blank)];
}

impl KnobChoice for Uncommitted {
    const WORDS: &'static [(&'static str, Self)] =
        &[("written", Uncommitted::Written), ("stored", Uncommitted::Stored)];
}

impl KnobChoice for Tear {
    const WORDS: &'static [(&'static str, Self)] = &[
        ("rest-old", Tear::RestOld),
        ("rest-erased", Tear::RestErased),
        ("old", Tear::Old),
        ("erased", Tear::Erased),
        ("neighbour", Tear::Neighbour),
    ];
}

impl KnobChoice for First {
    const WORDS: &'static [(&'static str, Self)] = &[("old", First::Old), ("nonsense", First::Nonsense)];
}

impl KnobChoice for NackAs {
    const WORDS: &'static [(&'static str, Self)] = &[
        ("enxio", NackAs::Enxio),
        ("eio", NackAs::Eio),
        ("etimedout", NackAs::Etimedout),
        ("eagain", NackAs::Eagain),
    ];
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Lost {
    Reset,
    Seal,
    Key,
    Update,
}

/// One gauge of the envelope. [`Timing`] has the times that every gauge has.
#[derive(Clone, Debug)]
pub(super) struct Envelope {
    /// Seed of what differs between blocks.
    seed: u64,
    /// Largest extra load time of a block.
    block: Duration,
    pub(super) early: Early,
    pub(super) uncommitted: Uncommitted,
    pub(super) commit_busy: Busy,
    pub(super) tear: Tear,
    /// Time after the first answer in which Voltage() is 0 and predictions are wrong.
    pub(super) first: Duration,
    pub(super) first_values: First,
    /// `[INITCOMP]` never comes.
    pub(super) no_initcomp: bool,
    /// Seconds between two short losses of power; 0 for never.
    pub(super) reset_every_s: u32,
    /// Delay with which CONTROL_STATUS shows a change of the seal state.
    pub(super) status: Duration,
    /// A wrong or incomplete key starts the time in which keys are refused.
    pub(super) key_lock: bool,
    drop_resets: u32,
    drop_seals: u32,
    drop_keys: u32,
    drop_updates: u32,
    /// At the end of CONFIG UPDATE a gauge that was sealed is sealed again, whatever its data memory says.
    pub(super) reseals: bool,
    /// ENTER_CAL does nothing before CAL_ENABLE.
    pub(super) cal_enable: bool,
    /// Interval between rewrites of the gauge's own values, in time and in transfers; 0 for never.
    pub(super) rewrite: Duration,
    pub(super) rewrite_every: u32,
    pub(super) nack_as: NackAs,
    pub(super) firmware: Option<u16>,
    pub(super) hardware: Option<u16>,
    pub(super) watchdog: bool,
    pub(super) single_byte: bool,
    /// START sooner after STOP than this is not acknowledged, in microseconds.
    pub(super) bus_free_us: u32,
    /// How often a block can be programmed without error; 0 for no limit.
    endurance: u32,
}

/// The drawn knobs, in the order in which they are shown.
pub(super) const DRAWN: &[&str] = &[
    "block_ms",
    "early",
    "uncommitted",
    "commit_ms",
    "commit_busy",
    "tear",
    "reset_ms",
    "reset_busy",
    "first_ms",
    "first_values",
    "status_ms",
    "key_lock",
    "lock_ms",
    "full_access_quiet_ms",
    "refused_quiet_ms",
    "drop_resets",
    "drop_seals",
    "drop_keys",
    "drop_updates",
    "reseals",
    "cal_enable",
    "rewrite_ms",
    "rewrite_every",
    "nack_as",
    "firmware",
    "hardware",
    "watchdog",
    "bus_free_us",
];

impl Envelope {
    pub(super) fn friendly(seed: u64) -> Self {
        Self {
            seed,
            block: Duration::ZERO,
            early: Early::Previous,
            uncommitted: Uncommitted::Written,
            commit_busy: Busy::Stretch,
            tear: Tear::RestOld,
            first: Duration::ZERO,
            first_values: First::Old,
            no_initcomp: false,
            reset_every_s: 0,
            status: Duration::ZERO,
            key_lock: false,
            drop_resets: 0,
            drop_seals: 0,
            drop_keys: 0,
            drop_updates: 0,
            reseals: false,
            cal_enable: false,
            rewrite: Duration::ZERO,
            rewrite_every: 0,
            nack_as: NackAs::Enxio,
            firmware: None,
            hardware: None,
            watchdog: false,
            single_byte: false,
            bus_free_us: 0,
            endurance: 0,
        }
    }

    /// Draws a gauge, and gives the part's times its own values. `printed` are the part's documented firmware and
    /// hardware versions.
    pub(super) fn draw(seed: u64, part: &Part, printed: [Option<u16>; 2], timing: &mut Timing) -> Self {
        let mut random = Random::new(seed);
        let ms = |random: &mut Random, range| Duration::from_millis(random.within(range));
        let mut new = Self::friendly(seed);
        // Drivers of the bq34z100-G1 wait 10 to 30 ms, others 50 ms; E2E 607746, 287327.
        new.block = ms(&mut random, 0..=50);
        new.early = random.pick(&[Early::Previous, Early::Blank]);
        // The kernel waits 100 ms after a commit, drivers 30 to 200 ms. The words of a block take 32 ms of it.
        let commit = ms(&mut random, 0..=250 - 32);
        timing.commit = if part.has_flash() { commit } else { Duration::ZERO };
        new.commit_busy = random.pick(&[Busy::Nack, Busy::Stretch, Busy::Old]);
        // Flash is erased before it is programmed, row by row.
        let tears = [Tear::RestOld, Tear::RestErased, Tear::Old, Tear::Erased, Tear::Neighbour];
        new.tear = random.pick(&tears);
        // Owners measured 150 to 175 ms, the kernel waits 300 ms.
        timing.reset = ms(&mut random, 0..=500);
        timing.reset_busy = random.pick(&[Busy::Stretch, Busy::Nack, Busy::Old]);
        // Nothing is valid before [INITCOMP] (SLUUAC9A 2.4.6).
        new.first = ms(&mut random, 1000..=2000);
        new.first_values = random.pick(&[First::Old, First::Nonsense]);
        // Drivers wait 40 ms and repeat (bq35100), or 100 ms after keys.
        let status = ms(&mut random, 1..=200);
        new.status = random.pick(&[Duration::ZERO, status]);
        // 4 s (SLUUAC9A 6.4.5.1.1, SLUUCD5), by the gauge's own oscillator and with room for what is not printed.
        let (lock, quiet) = (ms(&mut random, 4000..=5000), ms(&mut random, 4000..=5000));
        match part.scheme {
            Scheme::Block(_) if !part.has_flash() => {
                timing.lock = lock;
                new.key_lock = random.pick(&[false, true]);
            }
            Scheme::Block(_) | Scheme::Registers(_) | Scheme::Smbus(_) => {}
            // E2E 888302.
            Scheme::Mac(_) => {
                timing.refused_quiet = quiet;
                if !timing.full_access_quiet.is_zero() {
                    timing.full_access_quiet = quiet;
                }
            }
        }
        // The bus has no checksum, so any single command may be lost.
        let lost = random.roll(8);
        (new.drop_resets, new.drop_seals) = (u32::from(lost == 0), u32::from(lost == 1));
        new.drop_keys = u32::from(lost == 2);
        // The gauge rewrites learned values, lifetime data and offsets at any moment (SLUSBZ5D 7.3).
        match random.roll(4) {
            // It answers for at least as long as it programs, or it would do nothing else.
            0 => new.rewrite = ms(&mut random, 300..=5000).max(2 * (timing.commit + 16 * timing.word)),
            1 => new.rewrite_every = random.within(50..=500) as u32,
            _ => {}
        }
        // i2c-gpio reports EIO for a NACK; adapters differ.
        new.nack_as = random.pick(&[NackAs::Enxio, NackAs::Eio, NackAs::Etimedout, NackAs::Eagain]);
        // E2E 1370997, 395368: parts whose versions are not the printed ones.
        let mut version =
            |printed: Option<u16>| printed.filter(|_| random.roll(4) == 0).map(|word| word ^ 0x0001);
        (new.firmware, new.hardware) = (version(printed[0]), version(printed[1]));
        // SLUSBH1C 9.5.4.3, SLUS914A 7.3, SLUSBZ5D 6.14.
        new.watchdog = matches!(part.scheme, Scheme::Block(_)) && random.roll(2) == 0;
        new.bus_free_us = random.pick(&[0, 66]);
        // No document says what a gauge keeps of a CONFIG UPDATE that goes wrong.
        if !part.has_flash() {
            new.drop_updates = u32::from(random.roll(8) == 0);
            new.reseals = random.roll(4) == 0;
        }
        // Libraries sum what they have written by reading it back (sparkfun/SparkFun_BQ27441_Arduino_Library); no manual says so.
        new.uncommitted = random.pick(&[Uncommitted::Written, Uncommitted::Stored]);
        // A library sends ENTER_CAL alone to a bq35100; to relatives CAL_ENABLE goes before it.
        new.cal_enable = matches!(part.scheme, Scheme::Mac(_)) && random.roll(2) == 0;
        new
    }

    pub(super) fn knob_value(&mut self, name: &str) -> Option<&mut dyn KnobValue> {
        Some(match name {
            "block_ms" => &mut self.block,
            "early" => &mut self.early,
            "uncommitted" => &mut self.uncommitted,
            "commit_busy" => &mut self.commit_busy,
            "tear" => &mut self.tear,
            "first_ms" => &mut self.first,
            "first_values" => &mut self.first_values,
            "no_initcomp" => &mut self.no_initcomp,
            "reset_every_s" => &mut self.reset_every_s,
            "status_ms" => &mut self.status,
            "key_lock" => &mut self.key_lock,
            "drop_resets" => &mut self.drop_resets,
            "drop_seals" => &mut self.drop_seals,
            "drop_keys" => &mut self.drop_keys,
            "drop_updates" => &mut self.drop_updates,
            "reseals" => &mut self.reseals,
            "cal_enable" => &mut self.cal_enable,
            "rewrite_ms" => &mut self.rewrite,
            "rewrite_every" => &mut self.rewrite_every,
            "nack_as" => &mut self.nack_as,
            "firmware" => &mut self.firmware,
            "hardware" => &mut self.hardware,
            "watchdog" => &mut self.watchdog,
            "single_byte" => &mut self.single_byte,
            "bus_free_us" => &mut self.bus_free_us,
            "endurance" => &mut self.endurance,
            _ => return None,
        })
    }

    /// The extra load time of a block.
    pub(super) fn delay(&self, area: u16, block: usize) -> Duration {
        let longest = self.block.as_millis() as u64;
        Duration::from_millis(Random::of(self.seed, area, block).within(0..=longest))
    }

    pub(super) fn loses(&mut self, lost: Lost) -> bool {
        let left = match lost {
            Lost::Reset => &mut self.drop_resets,
            Lost::Seal => &mut self.drop_seals,
            Lost::Key => &mut self.drop_keys,
            Lost::Update => &mut self.drop_updates,
        };
        let any = *left > 0;
        *left = left.saturating_sub(1);
        any
    }

    /// The answer to FW_VERSION or HW_VERSION, where it differs from the documented one.
    pub(super) fn version(&self, subcommand: u16) -> Option<u16> {
        match subcommand {
            0x0002 => self.firmware,
            0x0003 => self.hardware,
            _ => None,
        }
    }

    pub(super) fn nonsense(&self, register: u8) -> u8 {
        Random::of(self.seed, u16::MAX, register.into()).roll(256) as u8
    }

    /// Leaves `flash` as a loss of power does after `words` words of a commit. `old` is the content before.
    pub(super) fn tear(&self, flash: &mut Flash, old: &Kept, words: usize) {
        let (count, end) = (old.bytes.len().min(2 * words), old.offset + old.bytes.len());
        let rows = old.offset / BLOCK * BLOCK..end.next_multiple_of(BLOCK);
        let erased = [0xFF; 2 * BLOCK];
        match self.tear {
            Tear::RestOld => flash.set(old.area, old.offset + count, &old.bytes[count..]),
            Tear::Old => flash.set(old.area, old.offset, &old.bytes),
            Tear::RestErased => {
                let at = old.offset + count;
                flash.set(old.area, at, &erased[..rows.end - at]);
            }
            Tear::Neighbour => {
                let around = [Some(rows.end / BLOCK), (rows.start / BLOCK).checked_sub(1)];
                let neighbour =
                    around.into_iter().flatten().find(|&at| !flash.block(old.area, at as u8).is_empty());
                match neighbour {
                    Some(block) => self.disturb(flash, old.area, block),
                    None => flash.set(old.area, rows.start, &erased[..rows.len()]),
                }
            }
            Tear::Erased => flash.set(old.area, rows.start, &erased[..rows.len()]),
        }
    }

    /// Clears some bits of a row and erases some of its bytes.
    fn disturb(&self, flash: &mut Flash, area: u16, block: usize) {
        let mut random = Random::of(self.seed, area, block);
        let mut row = flash.block(area, block as u8).to_vec();
        let before = row.clone();
        while row == before {
            for _ in 0..3 {
                let byte = random.roll(row.len() as u64) as usize;
                row[byte] = if random.roll(2) == 0 { 0xFF } else { row[byte] & random.roll(256) as u8 };
            }
        }
        flash.set(area, block * BLOCK, &row);
    }

    /// Clears the bits of a worn-out block that can no longer be erased.
    pub(super) fn wear_out(&self, flash: &mut Flash, area: u16, block: usize) {
        if self.endurance == 0 || flash.wear_of(area, block) <= self.endurance {
            return;
        }
        let mut random = Random::of(self.seed, area, block);
        let mut bytes = flash.block(area, block as u8).to_vec();
        for _ in 0..4 {
            let byte = random.roll(bytes.len() as u64) as usize;
            bytes[byte] &= !(1 << random.roll(8));
        }
        flash.set(area, block * BLOCK, &bytes);
    }
}
