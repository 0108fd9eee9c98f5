//! What is checked before a write, as data.

/// What is looked at before anything is written, beside identity, gate and seal.
#[derive(Debug)]
pub struct Preflight {
    /// What tells a pack from another one with the same part; `None` where nothing is known that does.
    pub pack: Option<Pack>,
    /// Modes that somebody else may have left on.
    pub modes: &'static [Mode],
    /// How a cycle of learning shows that a reset would throw away; `None` where nothing tells for sure.
    pub learning: Option<Learning>,
    /// Voltage() between which the part works, where no [`Gate`] watches.
    pub voltage_mv: Option<(u16, u16)>,
}

/// A word of the gauge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Word {
    /// CONTROL_STATUS, which is read for the seal in any case.
    ControlStatus,
    /// A standard command of two bytes.
    Register(u8),
    /// What a subcommand answers.
    Answer(u16),
}

/// A word that differs from pack to pack.
#[derive(Debug)]
pub struct Pack {
    /// The word. A register, read alone, also tells parts of another type apart, which have something else
    /// at its address.
    pub word: Word,
    /// Its name in a message.
    pub name: &'static str,
    /// Subclass and offset of the rows that it follows from: whoever writes those changes it.
    pub rows: &'static [(u8, u16)],
}

/// A mode in which a write would be lost, or would disturb whoever began it.
#[derive(Debug)]
pub struct Mode {
    /// The word that shows it. A subcommand is asked only once the gauge is unsealed.
    pub word: Word,
    /// The bit that is set meanwhile.
    pub mask: u16,
    /// Where that stands, in a message.
    pub name: &'static str,
    /// What goes on.
    pub what: &'static str,
    /// What helps.
    pub remedy: &'static str,
    /// Whether our own transactions begin it too, so that one that was cut short can have left it on.
    pub ours: bool,
}

impl Mode {
    /// A calibration that is running: a bit of CONTROL_STATUS that the gauge clears by itself.
    pub const fn measuring(mask: u16, name: &'static str, what: &'static str) -> Self {
        let remedy = "it ends by itself; try again in a minute";
        Self { word: Word::ControlStatus, mask, name, what, remedy, ours: false }
    }

    /// Calibration mode, which stays until somebody leaves it.
    pub const fn calibration(word: Word, mask: u16, name: &'static str, remedy: &'static str) -> Self {
        Self { word, mask, name, what: "somebody has left calibration mode on", remedy, ours: false }
    }
}

/// A cycle of learning.
#[derive(Debug)]
pub struct Learning {
    /// CONTROL_STATUS bits that are all set meanwhile.
    pub status: u16,
    /// Subclass and offset of Update Status, the byte that tells a first cycle from what goes on in a finished
    /// pack for ever. Writing it alone is how a cycle is begun and ended by hand.
    pub row: (u8, u16),
    /// A standard command that shows the same bits without unsealing.
    pub register: Option<u8>,
    /// Its bits that tell.
    pub mask: u8,
    /// Their value until the cycle has come to its end.
    pub value: u8,
    /// Both, in a message.
    pub name: &'static str,
}
