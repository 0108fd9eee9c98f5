// SPDX-License-Identifier: MIT

use super::state::read_word;
use crate::error::Result;
use crate::gauge::{Gauge, agreed};
use crate::journal::Identity;

pub(super) fn identify(gauge: &mut Gauge) -> Result<Identity> {
    gauge.confirm_identity()?;
    let firmware = agreed("Control(FW_VERSION)", || gauge.firmware_version())?;
    Ok(Identity::of(gauge.chip, firmware, serial_number(gauge)?))
}

pub(super) fn serial_number(gauge: &mut Gauge) -> Result<u16> {
    let Some(register) = gauge.chip.serial_register() else { return Ok(0) };
    agreed("SerialNumber()", || read_word(gauge, register.source))
}
