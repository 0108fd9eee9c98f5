// SPDX-License-Identifier: MIT

//! Control(): subcommands and their answers, and the part that answers.

use super::presence::Moment;
use super::{
    ANSWER, ANSWERED_ELSEWHERE, Answers, BEHIND, CONTROL, CONTROL_STATUS, DEVICE_TYPE, FW_VERSION, Gauge,
    LONGEST_VERSION, MAC_DATA_LENGTH, MAC_OVERHEAD, TRIES,
};
use crate::error::{Cause, Error, Reason, Result, Step};
use gauge_bus::BusError;

impl Gauge {
    /// Sends a subcommand without reading an answer.
    pub fn command(&mut self, code: u16) -> Result<()> {
        let subject = self.subcommand_name(code);
        self.write(CONTROL, &code.to_le_bytes()).map_err(|error| error.about(subject).at(Step::Control))
    }

    /// Sends a subcommand whose effect must not happen twice.
    pub fn command_once(&mut self, code: u16) -> Result<()> {
        self.refuse_without_table()?;
        let sent = self.write_once(CONTROL, &code.to_le_bytes());
        sent.map_err(|bus| Error::bus(self.subcommand_name(code), bus).at(Step::Control))
    }

    /// Sends a subcommand that must not reach another gauge: only if nothing has happened since then behind which this
    /// one could have been exchanged.
    pub(crate) fn command_since(&mut self, code: u16, moment: Moment) -> Result<()> {
        self.refuse_without_table()?;
        let subject = self.subcommand_name(code);
        let mut is_same = true;
        let sent = self.again(|gauge| {
            gauge.make_ready()?;
            is_same = gauge.is_unbroken_since(moment);
            if is_same { gauge.write_once(CONTROL, &code.to_le_bytes()) } else { Err(BusError::Gone) }
        });
        if !is_same {
            let why =
                "not sent: the gauge did not answer for a moment, in which its pack may have been exchanged";
            return Err(Error::new(subject, Cause::NotNow, why).at(Step::Control));
        }
        sent.map_err(|bus| Error::bus(subject, bus).at(Step::Control))
    }

    /// Sends a subcommand and reads the word that it answers with.
    pub fn ask(&mut self, code: u16) -> Result<u16> {
        if code == FW_VERSION && self.chip.identity.answers_in_mac_data() {
            return self.firmware_in_mac_data();
        }
        self.command(code)?;
        // CONTROL_STATUS answers at Control() itself on every part.
        if code != CONTROL_STATUS {
            return self.answer(code, self.chip.identity.answer, &mut []);
        }
        self.status_word(&mut [])
    }

    /// Sends a subcommand and reads the bytes that it answers with, two or more.
    pub(crate) fn ask_bytes(&mut self, code: u16, into: &mut [u8]) -> Result<()> {
        self.command(code)?;
        let (word, behind) = into.split_at_mut(2);
        let first = self.answer(code, self.chip.identity.answer, behind)?;
        word.copy_from_slice(&first.to_le_bytes());
        Ok(())
    }

    /// The version of the firmware, which follows the device number.
    fn firmware_in_mac_data(&mut self) -> Result<u16> {
        let (identity, mut word) = (&self.chip.identity, 0);
        // MACData() may still show an older answer.
        for _ in 0..TRIES {
            let mut version = [0; 2];
            self.command(FW_VERSION)?;
            word = self.answer(FW_VERSION, identity.answer, &mut version)?;
            if word.swap_bytes() == identity.device_type {
                return Ok(u16::from_be_bytes(version));
            }
        }
        // No document has such an answer; it tells this part from others all the same.
        Ok(word)
    }

    /// All bytes that FW_VERSION answers with in MACData(); none on a part that answers with a word.
    pub fn whole_firmware_answer(&mut self) -> Result<Vec<u8>> {
        if !self.chip.identity.answers_in_mac_data() {
            return Ok(Vec::new());
        }
        self.command(FW_VERSION)?;
        self.wait(ANSWER.max(self.chip.access.select));
        let mut length = [0];
        self.read(MAC_DATA_LENGTH, &mut length)?;
        // What follows the answer in the buffer may be of a block that was read before.
        let count = usize::from(length[0]).saturating_sub(MAC_OVERHEAD).min(LONGEST_VERSION);
        let mut bytes = vec![0; count];
        if count > 0 {
            self.read(self.chip.identity.answer, &mut bytes)?;
        }
        Ok(bytes)
    }

    /// Reads the answer to CONTROL_STATUS, and with it the registers following Control().
    pub(super) fn status_word(&mut self, behind: &mut [u8]) -> Result<u16> {
        match self.answer(CONTROL_STATUS, CONTROL, behind)? {
            ANSWERED_ELSEWHERE if self.chip.identity.answer != CONTROL => {
                self.answer(CONTROL_STATUS, CONTROL, behind)
            }
            status => Ok(status),
        }
    }

    /// Reads the answer to a subcommand and the bytes that follow it.
    fn answer(&mut self, code: u16, at: u8, behind: &mut [u8]) -> Result<u16> {
        // MACData() shows the previous answer until the gauge has stored the new one.
        if at != CONTROL {
            self.wait(ANSWER.max(self.chip.access.select));
        }
        let mut bytes = [0; 2 + BEHIND];
        let subject = self.subcommand_name(code);
        let wanted = &mut bytes[..2 + behind.len()];
        self.read(at, wanted).map_err(|error| error.about(subject).at(Step::Control))?;
        behind.copy_from_slice(&wanted[2..]);
        Ok(u16::from_le_bytes([bytes[0], bytes[1]]))
    }

    pub(crate) fn subcommand_name(&self, code: u16) -> String {
        let known = self.chip.subcommands.iter().find(|subcommand| subcommand.code == code);
        known.map_or_else(|| format!("Control(0x{code:04x})"), |known| format!("Control({})", known.name))
    }

    /// Reads the type, firmware and versions that the gauge reports.
    pub fn identify(&mut self) -> Result<Answers> {
        let device_type = self.ask(DEVICE_TYPE).map_err(|error| error.at(Step::Identify))?;
        self.identify_type(device_type)
    }

    /// Reads firmware and versions of a gauge that has answered with that type.
    pub fn identify_type(&mut self, device_type: u16) -> Result<Answers> {
        let named = |error: Error| error.at(Step::Identify);
        let firmware_version = self.firmware_version()?;
        let hardware_version = self.ask_named("HW_VERSION").map_err(named)?.unwrap_or_default();
        let chem_id = self.ask_named("CHEM_ID").map_err(named)?;
        // The code is a byte; nothing is said of the other one.
        let dm_code = self.ask_named("DM_CODE").map_err(named)?.map(|code| code & 0xff);
        Ok(Answers { device_type, firmware_version, hardware_version, chem_id, dm_code })
    }

    /// The answer to a subcommand, if the table has one of that name.
    fn ask_named(&mut self, name: &str) -> Result<Option<u16>> {
        let known = self.chip.subcommands.iter().find(|subcommand| subcommand.name == name);
        known.map(|subcommand| self.ask(subcommand.code)).transpose()
    }

    /// Control(FW_VERSION).
    pub fn firmware_version(&mut self) -> Result<u16> {
        self.ask(FW_VERSION).map_err(|error| error.at(Step::Identify))
    }

    /// Makes sure that the part is still one of the table's.
    pub fn confirm_identity(&mut self) -> Result<()> {
        let expected = self.chip.identity.device_type;
        let mut found = expected;
        // A bit error is not another part, so an unexpected answer is requested again.
        for _ in 0..2 {
            found = self.ask(DEVICE_TYPE).map_err(|error| error.at(Step::Identify))?;
            if found == expected {
                break;
            }
        }
        if found == expected {
            return Ok(());
        }
        Err(Error::of(self.chip.model, Reason::OtherPart { expected, found }).at(Step::Identify))
    }
}
