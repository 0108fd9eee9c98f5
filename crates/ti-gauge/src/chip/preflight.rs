// SPDX-License-Identifier: MIT

//! Checks before a write, as data.

use super::Source;

/// Checks before a write, besides identity, gate and seal.
#[derive(Clone, Debug)]
pub struct Preflight {
    /// What distinguishes packs with the same part, if anything is known.
    pub pack: Option<Pack>,
    /// Parameters whose values distinguish packs: calibration, the serial number, and counters that only rise
    /// (learned). An interrupted write is settled without asking only if they are unchanged.
    pub marks: &'static [(u8, u16)],
    /// Modes that another program may have left on.
    pub modes: &'static [Mode],
    /// How to recognise a learning cycle, which a reset would lose; `None` without a sure sign.
    pub learning: Option<Learning>,
    /// Range of Voltage() in which the part works, for parts without a [`Gate`](super::Gate).
    pub voltage_mv: Option<(u16, u16)>,
}

impl Preflight {
    pub(super) const NONE: Self =
        Self { pack: None, marks: &[], modes: &[], learning: None, voltage_mv: None };

    /// The mode that DEVICE_TYPE begins if one bit of it is wrong, and what ends it.
    pub fn slip(&self) -> Option<(&'static Mode, u16)> {
        self.modes.iter().find_map(|mode| Some((mode, mode.slip?)))
    }
}

/// A word that differs from pack to pack.
#[derive(Clone, Debug)]
pub struct Pack {
    /// The word. Reading a register also detects another part, which has something else at that address.
    pub word: Source,
    /// Its name in a message.
    pub name: &'static str,
    /// Subclass and offset of the rows that determine it: writes to them change it.
    pub rows: &'static [(u8, u16)],
}

/// What is said of a mode that the gauge leaves soon.
const ENDS: &str = "it ends by itself; try again in a minute";

/// A mode in which a write would be lost, or would disturb the program that entered it.
#[derive(Clone, Debug)]
pub struct Mode {
    /// The word that shows it. Subcommands are sent only after unsealing.
    pub word: Source,
    /// The bit that is set in this mode.
    pub mask: u32,
    /// Name of word and bit, for a message.
    pub name: &'static str,
    /// What is going on, for a message.
    pub what: &'static str,
    /// What to do, for a message.
    pub remedy: &'static str,
    /// Whether gaugefs's own transactions enter it too, so that an interrupted one may have left it on.
    pub ours: bool,
    /// What ends it, on a part on which one wrong bit makes DEVICE_TYPE the subcommand that begins it.
    pub slip: Option<u16>,
}

impl Mode {
    /// A running calibration: a bit of CONTROL_STATUS that the gauge clears by itself.
    pub const fn measuring(mask: u32, name: &'static str, what: &'static str) -> Self {
        Self { word: Source::Status, mask, name, what, remedy: ENDS, ours: false, slip: None }
    }

    /// Whether it lasts until somebody leaves it.
    pub fn lasts(&self) -> bool {
        self.remedy != ENDS
    }

    /// Calibration mode, which lasts until somebody leaves it.
    pub const fn calibration(word: Source, mask: u32, name: &'static str, remedy: &'static str) -> Self {
        let what = "somebody has left calibration mode on";
        Self { word, mask, name, what, remedy, ours: false, slip: None }
    }

    /// One that a wrong bit in DEVICE_TYPE begins, and that this subcommand ends.
    pub const fn slips(self, end: u16) -> Self {
        Self { slip: Some(end), ..self }
    }
}

/// How to recognise a learning cycle.
#[derive(Clone, Debug)]
pub struct Learning {
    /// CONTROL_STATUS bits that are all set during a cycle.
    pub status: u32,
    /// Subclass and offset of Update Status, the byte that distinguishes a first cycle from the continuous learning of
    /// a finished pack. A write to this byte alone starts or ends a cycle by hand.
    pub row: (u8, u16),
    /// The place of the same bits without unsealing.
    pub shown: Option<Source>,
    /// The bits of Update Status to compare.
    pub mask: u8,
    /// Their value until the cycle has ended.
    pub value: u8,
    /// Names of the bits, for a message.
    pub name: &'static str,
}
