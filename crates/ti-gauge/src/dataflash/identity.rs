// SPDX-License-Identifier: MIT

//! What the gauge says of itself, and whether it is the one whose values are known.

use super::DataFlash;
use super::pack::{Match, compare};
use super::schemes::{Care, sequence};
use super::state::read_word;
use crate::error::Result;
use crate::gauge::{Gauge, agreed};
use crate::journal::{Identity, Plan};

impl DataFlash {
    /// Identity of the gauge for the journal, read on first use after the gauge was connected.
    pub(super) fn identity(&mut self, gauge: &mut Gauge) -> Result<Identity> {
        if let Some(identity) = self.identity.get(self.now.name) {
            return Ok(identity.clone());
        }
        let firmware = match self.known_pack {
            Some(known_pack) => known_pack.firmware_version,
            None => agreed("Control(FW_VERSION)", || gauge.firmware_version())?,
        };
        let identity = Identity::of(gauge.chip, firmware, serial_number(gauge)?);
        self.identity.learn(self.now.name, identity.clone());
        Ok(identity)
    }

    /// Whether the gauge, which is open, is certainly the one whose values were read.
    pub(super) fn is_certain(&mut self, gauge: &mut Gauge) -> Result<bool> {
        let plan = Plan::of_marks(self.marks(gauge.chip));
        let Some(then) = self.identity.get(self.now.name).cloned() else { return Ok(false) };
        let now = identify(gauge)?;
        sequence(gauge).enable(gauge)?;
        let same =
            compare(gauge.chip, &then, &now, &plan, |place| sequence(gauge).load(gauge, place, Care::Sure))?;
        Ok(then.is_of_part(&now, gauge.chip) && same == Match::Certain)
    }
}

/// What the gauge says of itself; an error if it is another part.
pub(super) fn identify(gauge: &mut Gauge) -> Result<Identity> {
    gauge.confirm_identity()?;
    let firmware = agreed("Control(FW_VERSION)", || gauge.firmware_version())?;
    Ok(Identity::of(gauge.chip, firmware, serial_number(gauge)?))
}

fn serial_number(gauge: &mut Gauge) -> Result<u16> {
    let Some(register) = gauge.chip.serial_register() else { return Ok(0) };
    agreed("SerialNumber()", || read_word(gauge, register.source))
}
