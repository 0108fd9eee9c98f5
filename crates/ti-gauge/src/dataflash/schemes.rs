//! The access schemes: how a block reaches the gauge and comes back.

use super::blocks::{Dirty, Window};
use crate::chip::Scheme;
use crate::codec::WINDOW;
use crate::error::Result;
use crate::gauge::Gauge;

mod block;
mod cfgupdate;
mod mac;

/// What the access schemes do differently. Each step is straight-line code, to be read beside the manual.
pub(super) trait Sequence {
    /// Lets data flash be read.
    fn enable(&self, gauge: &mut Gauge) -> Result<()>;
    /// Lets data flash be written, where that is a mode of its own.
    fn begin(&self, gauge: &mut Gauge) -> Result<()>;
    /// Brings a block into the window and reads it whole, with its checksum.
    fn load(&self, gauge: &mut Gauge, place: Window) -> Result<[u8; WINDOW]>;
    /// Brings a block into the window and reads some of its bytes.
    fn read_part(&self, gauge: &mut Gauge, place: Window, at: usize, into: &mut [u8]) -> Result<()>;
    /// Whether the block has to be in the window before its bytes are changed. Not where they go out with their
    /// address, and the sum that commits them is over both.
    fn fills_window(&self) -> bool;
    /// Changes the bytes that differ, in the gauge's buffer only.
    fn fill(&self, gauge: &mut Gauge, block: &Dirty) -> Result<()>;
    /// Sends what makes the gauge store the block. Never sent twice: whoever calls finds out what the
    /// block holds instead.
    fn commit(&self, gauge: &mut Gauge, block: &Dirty) -> Result<()>;
    /// Makes new data flash take effect: a reset, or the end of the mode that `begin` began.
    fn finish(&self, gauge: &mut Gauge) -> Result<()>;
    /// Whether `finish` has to follow every `begin`.
    fn always_finishes(&self) -> bool;
}

pub(super) fn sequence(gauge: &Gauge) -> &'static dyn Sequence {
    match gauge.chip.access.scheme {
        Scheme::Block => &block::Block,
        Scheme::CfgUpdate => &cfgupdate::CfgUpdate,
        Scheme::Mac => &mac::Mac,
    }
}
