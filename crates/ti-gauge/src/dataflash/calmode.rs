// SPDX-License-Identifier: MIT

//! Calibration mode, in which a gauge ignores its flash-voltage gate. CAL_ENABLE toggles, so it is sent only after a
//! look, and never repeated blindly.

use std::time::Duration;

use super::state::read_bits;
use crate::chip::Calibration;
use crate::error::{Error, Reason, Result, Step};
use crate::gauge::{Gauge, Seal, agreed};

/// Times that each subcommand is sent, and the time until its effect must show.
const TRIES: u32 = 4;
const SHOWS: Duration = Duration::from_millis(100);

fn is_enabled(gauge: &mut Gauge, calibration: &Calibration) -> Result<bool> {
    let (source, mask) = calibration.enabled;
    agreed("the bit that allows calibration", || Ok(read_bits(gauge, source)? & mask != 0))
}

pub(super) fn is_on(gauge: &mut Gauge, calibration: &Calibration) -> Result<bool> {
    agreed("CONTROL_STATUS", || Ok(gauge.control_status()?.1 & calibration.mode != 0))
}

fn set_enabled(gauge: &mut Gauge, calibration: &Calibration, wanted: bool) -> Result<()> {
    for _ in 0..TRIES {
        if is_enabled(gauge, calibration)? == wanted {
            return Ok(());
        }
        // Whether a frame that failed was taken shows at the next look.
        let _ = gauge.command_once(calibration.enable);
        gauge.wait(SHOWS);
    }
    if is_enabled(gauge, calibration)? == wanted {
        return Ok(());
    }
    Err(failed(gauge, "CAL_ENABLE"))
}

fn set_mode(gauge: &mut Gauge, calibration: &Calibration, wanted: bool) -> Result<()> {
    let (code, name) = if wanted { (calibration.enter, "ENTER_CAL") } else { (calibration.exit, "EXIT_CAL") };
    for _ in 0..TRIES {
        gauge.command(code)?;
        gauge.wait(SHOWS);
        if is_on(gauge, calibration)? == wanted {
            return Ok(());
        }
    }
    Err(failed(gauge, name))
}

fn failed(gauge: &Gauge, name: &str) -> Error {
    let unseen = Reason::NoEffect { command: name.to_string().into(), times: TRIES.into() };
    Error::of(gauge.chip.model, unseen).at(Step::Control)
}

pub(super) fn enter(gauge: &mut Gauge, calibration: &Calibration) -> Result<()> {
    set_enabled(gauge, calibration, true)?;
    set_mode(gauge, calibration, true)
}

/// Leaves calibration mode if it is on, unsealing a gauge that was sealed meanwhile; returns whether it was on.
pub(super) fn leave(gauge: &mut Gauge, calibration: &Calibration) -> Result<bool> {
    let on = is_on(gauge, calibration)?;
    if !on && !is_enabled(gauge, calibration)? {
        return Ok(false);
    }
    if gauge.seal()? == Seal::Sealed {
        gauge.unseal()?;
    }
    if on {
        set_enabled(gauge, calibration, true)?;
        set_mode(gauge, calibration, false)?;
    }
    set_enabled(gauge, calibration, false)?;
    Ok(true)
}
