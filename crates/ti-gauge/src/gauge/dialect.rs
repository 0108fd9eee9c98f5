// SPDX-License-Identifier: MIT

//! What is on the wire: how registers, subcommands, selections and blocks of a family of gauges are addressed.

use super::Gauge;
use super::state::{Answer, Rows, Shown};
use crate::chip::{Chip, Register, Scheme, SealStatus, Source, Tier, bursts};
use crate::error::Result;
use gauge_bus::BusError;
use gauge_bus::replay::{First, Recording, Replay, Seals, Touch};

mod asking;
pub(in crate::gauge) mod map;
mod smbus;

pub(crate) type Touches = Vec<(Touch, u8)>;
/// The rows of a table, and the tiers that are wanted of them.
pub(crate) type Wanted<'a> = (&'static [Register], &'a dyn Fn(Tier) -> bool);

pub(crate) struct Challenge {
    /// 0 selects challenge and digest.
    pub(crate) select: u8,
    /// The buffer for both.
    pub(crate) data: u8,
    /// The checksum of a challenge, which starts the computation.
    pub(crate) sum: u8,
    /// 1 lets an unsealed gauge show what a sealed one shows.
    pub(crate) view: u8,
}

pub(crate) trait Dialect: Sync {
    fn fetch(&self, gauge: &mut Gauge, code: u8, into: &mut [u8]) -> Result<(), BusError>;
    fn put(&self, gauge: &mut Gauge, code: u8, data: &[u8]) -> Result<(), BusError>;
    fn subcommand(&self, gauge: &mut Gauge, code: u16) -> Result<(), BusError>;
    fn answer(&self, gauge: &mut Gauge, code: u16) -> Result<u16>;
    fn answer_bytes(&self, gauge: &mut Gauge, code: u16, into: &mut [u8]) -> Result<()>;
    /// All bytes of the answer to FW_VERSION; none where that is a word.
    fn version(&self, gauge: &mut Gauge) -> Result<Vec<u8>>;
    fn look(&self, gauge: &mut Gauge, also: &[Source]) -> Result<(u16, Rows)>;
    /// The message that a gauge answers with what was selected last, in two bytes.
    fn selection(&self) -> &'static [u8];
    /// Selects what no access leaves selected.
    fn deselect(&self, gauge: &mut Gauge) -> Result<(), BusError>;
    /// What each byte of a write touches; without those that touch nothing of this.
    fn touches(&self, write: &[u8]) -> Touches;
    /// What a read shows of the window, and of the selection.
    fn shows<'a>(&self, register: u8, bytes: &'a [u8]) -> Shown<'a>;
    /// Whether so many bytes from a register on belong to selection and window, all or in part.
    fn is_of_window(&self, register: u8, length: usize) -> bool;
    fn challenge(&self) -> &'static Challenge;
    /// The reads that fetch all commands of the tiers, as code and length.
    fn reads(&self, rows: &[Register], wanted: &dyn Fn(Tier) -> bool) -> Vec<(u8, u8)> {
        bursts(rows, wanted)
    }
    /// Reads all rows of the tiers.
    fn read(&self, gauge: &mut Gauge, rows: Wanted<'_>, take: &mut dyn FnMut(Answer<'_>)) -> Result<()> {
        for (start, length) in self.reads(rows.0, rows.1) {
            let mut bytes = vec![0; length.into()];
            gauge.read(start, &mut bytes)?;
            take(Answer::Burst(start, &bytes));
        }
        for row in rows.0.iter().filter(|row| rows.1(row.tier)) {
            let mut bytes = vec![0; row.size.into()];
            match row.source {
                Source::Command(_) | Source::Within(..) => continue,
                Source::Answer(code) => gauge.ask_bytes(code, &mut bytes)?,
                Source::Status => {
                    let status = gauge.control_status()?.1.to_le_bytes();
                    bytes.iter_mut().zip(status).for_each(|(to, from)| *to = from);
                }
            }
            take(Answer::Row(row, Some(&bytes)));
        }
        Ok(())
    }
    /// Whether what answers is of this dialect, by reads alone; `None` where only its values show it.
    fn is_its_kind(&self, _: &mut Gauge) -> Result<Option<bool>> {
        Ok(None)
    }
}

pub(crate) fn of(chip: &Chip) -> &'static dyn Dialect {
    match chip.access.scheme {
        Scheme::Block | Scheme::CfgUpdate | Scheme::None => &map::BLOCK,
        Scheme::Mac | Scheme::MacUpdate => &map::MAC,
        Scheme::Smbus => &smbus::SMBUS,
    }
}

/// The dialect of a gauge whose user lets it be asked; without questions it is the same one.
pub(crate) fn asking(chip: &Chip) -> &'static dyn Dialect {
    if chip.asks.is_some() { &asking::ASKING } else { of(chip) }
}

/// The reads that fetch all commands of a chip's tier, as code and length.
pub fn reads(chip: &Chip, tier: Tier) -> Vec<(u8, u8)> {
    of(chip).reads(chip.registers, &|found| found == tier)
}

/// The gauge of a recording, as a bus.
pub fn replay(chip: &Chip, recording: &Recording) -> Replay {
    let status = match chip.security.status {
        SealStatus::Field { word, .. } => word.command(),
        SealStatus::Bits { .. } | SealStatus::None => None,
    };
    let dialect = of(chip);
    let seals = Seals { commands: [chip.security.seal, chip.access.resets], status };
    let first = if chip.access.scheme == Scheme::Smbus { First::Code } else { First::Address };
    Replay::new(recording, first, seals, Box::new(|write| dialect.touches(write)))
}
