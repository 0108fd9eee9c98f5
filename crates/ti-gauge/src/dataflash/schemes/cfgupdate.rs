// SPDX-License-Identifier: MIT

//! CONFIG UPDATE (SLUUAC9A 3.1, SLUUBD4A 6.1) of parts with RAM. Nothing is gauged meanwhile, so every exit ends it.

use std::time::Duration;

use super::block::Block;
use super::mac::Mac;
use super::{Care, Sequence};
use crate::codec::WINDOW;
use crate::dataflash::window::{Planned, Window};
use crate::error::{Error, Reason, Result, Step};
use crate::gauge::{Gauge, Seal, Statistics, agreed};

/// Time between two reads of the mode's flag, which takes up to a second; the kernel's driver and Zephyr's wait as long.
const POLL_INTERVAL: Duration = Duration::from_millis(25);

pub(super) struct CfgUpdate {
    access: &'static (dyn Sequence + Sync),
    enter: u16,
    /// Whether it is accepted in FULL ACCESS only.
    full_access: bool,
    leave: u16,
    /// The register and the bit that show the mode, and their names.
    register: u8,
    mask: u16,
    names: (&'static str, &'static str),
    not_left: &'static str,
}

const NOT_ENTERED: &str = "nothing was changed: it has no battery, is starting, or another program uses it; wait some seconds \
                           and write again";

/// SET_CFGUPDATE and SOFT_RESET.
pub(super) static BLOCK: CfgUpdate = CfgUpdate {
    access: &Block,
    enter: 0x0013,
    full_access: false,
    leave: 0x0042,
    register: 0x06,
    mask: 0x0010,
    names: ("Flags()", "[CFGUPMODE]"),
    // SLUUAC9A 2.4.3.
    not_left: "the gauge leaves CONFIG UPDATE by itself after 4 min; until then it does not gauge",
};

/// ENTER_CFG_UPDATE and EXIT_CFG_UPDATE_REINIT.
pub(super) static MAC: CfgUpdate = CfgUpdate {
    access: &Mac,
    enter: 0x0090,
    full_access: true,
    leave: 0x0091,
    register: 0x3A,
    mask: 0x0400,
    names: ("OperationStatus()", "[CFGUPDATE]"),
    not_left: "the gauge does not gauge in CONFIG UPDATE; switch its power off and on if it stays so",
};

impl Sequence for CfgUpdate {
    fn enable(&self, gauge: &mut Gauge) -> Result<()> {
        self.access.enable(gauge)
    }

    fn begin(&self, gauge: &mut Gauge) -> Result<()> {
        if self.reaches(gauge, true, Duration::ZERO)? {
            return Ok(());
        }
        if self.full_access && gauge.seal_anew()? != Seal::FullAccess {
            gauge.full_access()?;
        }
        gauge.command(self.enter).map_err(|error| error.at(Step::WriteBlock))?;
        gauge.wait(gauge.chip.access.enter);
        let limit = gauge.chip.access.enter_limit;
        self.wait_for(gauge, true, limit).map_err(|error| error.at(Step::WriteBlock))?;
        // SLUUAC9A 3.1 enables block access after the mode is on.
        self.access.enable(gauge)
    }

    fn load(&self, gauge: &mut Gauge, place: Window, care: Care) -> Result<[u8; WINDOW]> {
        self.access.load(gauge, place, care)
    }

    fn glance(&self, gauge: &mut Gauge, place: Window, sent: Option<&[u8; WINDOW]>) -> Result<[u8; WINDOW]> {
        self.access.glance(gauge, place, sent)
    }

    fn read_part(&self, gauge: &mut Gauge, place: Window, at: usize, into: &mut [u8]) -> Result<()> {
        self.access.read_part(gauge, place, at, into)
    }

    fn fills_window(&self) -> bool {
        self.access.fills_window()
    }

    fn pieces(&self, block: &Planned) -> Vec<Planned> {
        self.access.pieces(block)
    }

    fn fill(&self, gauge: &mut Gauge, block: &Planned) -> Result<()> {
        self.access.fill(gauge, block)
    }

    fn commit(&self, gauge: &mut Gauge, block: &Planned) -> Result<()> {
        self.access.commit(gauge, block)
    }

    fn leave(&self, gauge: &mut Gauge) -> Result<Duration> {
        // The way out is ignored before the mode is on, which it enters later; after a loss of power it never does.
        self.reaches(gauge, true, gauge.chip.access.enter_limit).map_err(|error| error.at(Step::Reset))?;
        Statistics::count(&gauge.statistics.resets);
        gauge.command(self.leave).map_err(|error| error.at(Step::Reset))?;
        let readable = gauge.clock.now() + gauge.chip.access.reset;
        self.wait_for(gauge, false, gauge.chip.access.reset_limit).map_err(|error| error.at(Step::Reset))?;
        Ok(readable)
    }

    fn always_finishes(&self) -> bool {
        true
    }

    fn is_begun(&self, gauge: &mut Gauge) -> Result<bool> {
        agreed(self.names.1, || self.in_mode(gauge))
    }
}

impl CfgUpdate {
    fn in_mode(&self, gauge: &mut Gauge) -> Result<bool> {
        let mut word = [0; 2];
        gauge.read(self.register, &mut word)?;
        Ok(u16::from_le_bytes(word) & self.mask != 0)
    }

    /// I2C has no error detection, and a misread flag would leave the mode on, so two reads must agree.
    fn wait_for(&self, gauge: &mut Gauge, on: bool, limit: Duration) -> Result<()> {
        if self.reaches(gauge, on, limit)? {
            return Ok(());
        }
        let (register, flag) = self.names;
        let remedy = if on { NOT_ENTERED } else { self.not_left };
        Err(Error::of(
            register,
            Reason::NotInTime { flag, milliseconds: limit.as_millis() as i64, set: on, remedy },
        ))
    }

    fn reaches(&self, gauge: &mut Gauge, on: bool, limit: Duration) -> Result<bool> {
        let limit = gauge.clock.now() + limit;
        loop {
            if self.in_mode(gauge)? == on && self.in_mode(gauge)? == on {
                return Ok(true);
            }
            if gauge.clock.now() >= limit {
                return Ok(false);
            }
            gauge.wait(POLL_INTERVAL);
        }
    }
}
