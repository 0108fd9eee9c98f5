//! CONFIG UPDATE (SLUUAC9A 3.1): the block access of the flash parts, between SET_CFGUPDATE and
//! SOFT_RESET. Data memory is RAM. The gauge does not gauge in this mode, so every exit ends it.

use std::time::Duration;

use super::Sequence;
use super::block::Block;
use crate::chip::Role;
use crate::codec::WINDOW;
use crate::dataflash::blocks::{Dirty, Window};
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Gauge, Statistics};

/// Control(SET_CFGUPDATE).
const SET_CFGUPDATE: u16 = 0x0013;
/// Control(SOFT_RESET), which ends CONFIG UPDATE with a new OCV and a new simulation.
const SOFT_RESET: u16 = 0x0042;
/// Flags() `[CFGUPMODE]`.
const CFGUPMODE: u16 = 0x0010;
/// Time between two reads of `[CFGUPMODE]`, which takes up to a second to come or go.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

pub(super) struct CfgUpdate;

impl Sequence for CfgUpdate {
    fn enable(&self, gauge: &mut Gauge) -> Result<()> {
        Block.enable(gauge)
    }

    fn begin(&self, gauge: &mut Gauge) -> Result<()> {
        if reaches(gauge, true, Duration::ZERO)? {
            return Ok(());
        }
        gauge.command(SET_CFGUPDATE).map_err(|error| error.at(Step::WriteBlock))?;
        gauge.wait(gauge.chip.access.enter);
        wait_for(gauge, true, gauge.chip.access.enter_limit).map_err(|error| error.at(Step::WriteBlock))?;
        // SLUUAC9A 3.1 enables block access after the mode is on.
        Block.enable(gauge)
    }

    fn load(&self, gauge: &mut Gauge, place: Window) -> Result<[u8; WINDOW]> {
        Block.load(gauge, place)
    }

    fn glance(&self, gauge: &mut Gauge, place: Window) -> Result<[u8; WINDOW]> {
        Block.glance(gauge, place)
    }

    fn read_part(&self, gauge: &mut Gauge, place: Window, at: usize, into: &mut [u8]) -> Result<()> {
        Block.read_part(gauge, place, at, into)
    }

    fn fills_window(&self) -> bool {
        true
    }

    fn pieces(&self, block: &Dirty) -> Vec<Dirty> {
        Block.pieces(block)
    }

    fn fill(&self, gauge: &mut Gauge, block: &Dirty) -> Result<()> {
        Block.fill(gauge, block)
    }

    fn commit(&self, gauge: &mut Gauge, block: &Dirty) -> Result<()> {
        Block.commit(gauge, block)
    }

    fn finish(&self, gauge: &mut Gauge) -> Result<()> {
        // SOFT_RESET is ignored before the mode is on, and the mode is then entered anyway. After a loss of
        // power it is never entered.
        reaches(gauge, true, gauge.chip.access.enter_limit).map_err(|error| error.at(Step::Reset))?;
        Statistics::count(&gauge.statistics.resets);
        gauge.command(SOFT_RESET).map_err(|error| error.at(Step::Reset))?;
        wait_for(gauge, false, gauge.chip.access.reset_limit).map_err(|error| error.at(Step::Reset))
    }

    fn always_finishes(&self) -> bool {
        true
    }
}

fn in_mode(gauge: &mut Gauge) -> Result<bool> {
    let flags = gauge.chip.register(Role::Flags).expect("the tables' tests ask for Flags()");
    let mut word = [0; 2];
    gauge.read(flags.code, &mut word)?;
    Ok(u16::from_le_bytes(word) & CFGUPMODE != 0)
}

/// Waits until the mode is on, or off. I2C has no error detection, and a misread flag would leave the mode
/// on, so two reads must agree.
fn wait_for(gauge: &mut Gauge, on: bool, limit: Duration) -> Result<()> {
    if reaches(gauge, on, limit)? {
        return Ok(());
    }
    let why = if on { "[CFGUPMODE] was not set in time" } else { "[CFGUPMODE] was not cleared in time" };
    Err(Error::new("Flags()", Cause::TimedOut(why.into())))
}

/// Like `wait_for`, but returns whether the mode was reached.
fn reaches(gauge: &mut Gauge, on: bool, limit: Duration) -> Result<bool> {
    let limit = gauge.clock.now() + limit;
    loop {
        if in_mode(gauge)? == on && in_mode(gauge)? == on {
            return Ok(true);
        }
        if gauge.clock.now() >= limit {
            return Ok(false);
        }
        gauge.wait(POLL_INTERVAL);
    }
}
