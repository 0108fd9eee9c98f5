//! The access schemes: how blocks are read from a gauge and written to it.

use super::blocks::{Dirty, Window};
use crate::chip::Scheme;
use crate::codec::WINDOW;
use crate::error::Result;
use crate::gauge::Gauge;

mod block;
mod cfgupdate;
mod mac;

/// The steps in which access schemes differ. Each is straight-line code that follows the manual.
pub(super) trait Sequence {
    /// Enables reading data flash.
    fn enable(&self, gauge: &mut Gauge) -> Result<()>;
    /// Enables writing data flash, if that is a mode of its own.
    fn begin(&self, gauge: &mut Gauge) -> Result<()>;
    /// Loads a block into the window, reads all of it and verifies its checksum.
    fn load(&self, gauge: &mut Gauge, place: Window) -> Result<[u8; WINDOW]>;
    /// Loads a block whose content is known into the window again. One reading that agrees with `known` is enough:
    /// it is the second one.
    fn reload(&self, gauge: &mut Gauge, place: Window, known: &[u8; WINDOW]) -> Result<()>;
    /// Loads a block into the window and reads some of its bytes.
    fn read_part(&self, gauge: &mut Gauge, place: Window, at: usize, into: &mut [u8]) -> Result<()>;
    /// Reads a word, believed when the selection is echoed and two readings agree, or its checksum is right.
    fn word(&self, gauge: &mut Gauge, place: Window, at: usize) -> Result<u16> {
        let window = self.load(gauge, place)?;
        Ok(u16::from_be_bytes([window[at], window[at + 1]]))
    }
    /// Whether the block must be in the window before its bytes are changed. Not needed if the bytes are sent
    /// with their address and the checksum covers both.
    fn fills_window(&self) -> bool;
    /// Sends the bytes that differ to the gauge's buffer; flash is not changed yet.
    fn fill(&self, gauge: &mut Gauge, block: &Dirty) -> Result<()>;
    /// Makes the gauge program the block. Never sent twice: after an error the caller reads the block to
    /// find out what it holds.
    fn commit(&self, gauge: &mut Gauge, block: &Dirty) -> Result<()>;
    /// Makes the gauge use the new values: a reset, or the end of the mode that `begin` started.
    fn finish(&self, gauge: &mut Gauge) -> Result<()>;
    /// Whether `finish` must follow every `begin`.
    fn always_finishes(&self) -> bool;
}

pub(super) fn sequence(gauge: &Gauge) -> &'static dyn Sequence {
    match gauge.chip.access.scheme {
        Scheme::Block => &block::Block,
        Scheme::CfgUpdate => &cfgupdate::CfgUpdate,
        Scheme::Mac => &mac::Mac,
    }
}
