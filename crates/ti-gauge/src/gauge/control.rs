// SPDX-License-Identifier: MIT

//! Registers, subcommands and their answers, and the part that answers.

use std::time::Duration;

use super::dialect::Challenge;
use super::dialect::map::CONTROL;
use super::presence::Moment;
use super::{Answers, DEVICE_TYPE, FW_VERSION, Gauge, TRIES, agreed};
use crate::chip::{Mode, Source};
use crate::error::{Cause, Error, Reason, Result, Step};
use gauge_bus::BusError;

/// The build in the answer to FW_VERSION, behind device number and version.
const BUILD: std::ops::Range<usize> = 4..6;

/// Until the end of a mode shows.
const SLIP_SHOWS: Duration = Duration::from_millis(100);

impl Gauge {
    /// Fills `into` with the bytes starting at an address.
    pub fn read(&mut self, code: u8, into: &mut [u8]) -> Result<()> {
        self.dialect
            .fetch(self, code, into)
            .map_err(|bus| Error::bus(self.name_of(code), bus).of_register().at(Step::Read))
    }

    /// Reads a register of two bytes.
    pub fn word(&mut self, code: u8) -> Result<u16> {
        let mut bytes = [0; 2];
        self.read(code, &mut bytes)?;
        Ok(u16::from_le_bytes(bytes))
    }

    /// Writes bytes that may be written twice without harm: a pointer, a selection, the window's buffer.
    pub fn write(&mut self, code: u8, data: &[u8]) -> Result<()> {
        self.refuse_without_table()?;
        self.again(|gauge| gauge.write_once(code, data))
            .map_err(|bus| Error::bus(self.name_of(code), bus).of_register())
    }

    /// Writes bytes whose effect must not happen twice.
    pub fn write_once(&mut self, code: u8, data: &[u8]) -> Result<(), BusError> {
        self.dialect.put(self, code, data)
    }

    pub(super) fn name_of(&self, code: u8) -> String {
        self.chip
            .register_at(Source::Command(code))
            .map_or_else(|| format!("register 0x{code:02x}"), |register| format!("{}()", register.name))
    }

    pub(crate) fn challenge(&self) -> &'static Challenge {
        self.dialect.challenge()
    }

    /// Sends a subcommand without reading an answer.
    pub fn command(&mut self, code: u16) -> Result<()> {
        let subject = self.subcommand_name(code);
        let dialect = self.dialect;
        let sent = self.refuse_without_table().and_then(|()| {
            let sent = self.again(|gauge| dialect.subcommand(gauge, code));
            sent.map_err(|bus| Error::bus(self.name_of(CONTROL), bus).of_register())
        });
        sent.map_err(|error| error.about(subject).at(Step::Control))
    }

    /// Sends a subcommand whose effect must not happen twice.
    pub fn command_once(&mut self, code: u16) -> Result<()> {
        self.refuse_without_table()?;
        let sent = self.dialect.subcommand(self, code);
        sent.map_err(|bus| Error::bus(self.subcommand_name(code), bus).at(Step::Control))
    }

    /// Sends a subcommand, but not to a gauge that could have been exchanged since then.
    pub(crate) fn command_since(&mut self, code: u16, moment: Moment) -> Result<()> {
        self.refuse_without_table()?;
        let subject = self.subcommand_name(code);
        let mut is_same = true;
        let sent = self.again(|gauge| {
            gauge.make_ready()?;
            is_same = gauge.is_unbroken_since(moment);
            if is_same { gauge.dialect.subcommand(gauge, code) } else { Err(BusError::Gone) }
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
        self.dialect.answer(self, code)
    }

    pub(crate) fn ask_bytes(&mut self, code: u16, into: &mut [u8]) -> Result<()> {
        self.dialect.answer_bytes(self, code, into)
    }

    /// All bytes that FW_VERSION answers with in MACData(); none on a part that answers with a word.
    pub fn whole_firmware_answer(&mut self) -> Result<Vec<u8>> {
        self.dialect.version(self)
    }

    pub(crate) fn subcommand_name(&self, code: u16) -> String {
        let known = self.chip.subcommand(code);
        known.map_or_else(|| format!("Control(0x{code:04x})"), |known| format!("Control({})", known.name))
    }

    /// Reads the type, firmware and versions that the gauge reports.
    pub fn identify(&mut self) -> Result<Answers> {
        let device_type = self.device_type().map_err(|error| error.at(Step::Identify))?;
        self.identify_type(device_type)
    }

    /// Reads firmware and versions of a gauge that has answered with that type.
    pub fn identify_type(&mut self, device_type: u16) -> Result<Answers> {
        let named = |error: Error| error.at(Step::Identify);
        let (firmware_version, build) = self.versions().map_err(named)?;
        let hardware_version = self.ask_named("HW_VERSION").map_err(named)?.unwrap_or_default();
        let chem_id = self.ask_named("CHEM_ID").map_err(named)?;
        // The code is a byte; nothing is said of the other one.
        let dm_code = self.ask_named("DM_CODE").map_err(named)?.map(|code| code & 0xff);
        Ok(Answers { device_type, firmware_version, build, hardware_version, chem_id, dm_code })
    }

    fn ask_named(&mut self, name: &str) -> Result<Option<u16>> {
        let known = self.chip.subcommands.iter().find(|subcommand| subcommand.name == name);
        known.map(|subcommand| self.ask(subcommand.code)).transpose()
    }

    /// The firmware's version and build: both from one answer where that is the table's in every byte, type included.
    fn versions(&mut self) -> Result<(u16, Option<u16>)> {
        let identity = &self.chip.identity;
        if let Some(build) = identity.build {
            let answer = self.dialect.version(self)?;
            let is = |version: &&u16| {
                answer.starts_with(&[identity.device_type, **version, build].map(u16::to_be_bytes).concat())
            };
            if let Some(&version) = identity.firmware.iter().find(is) {
                return Ok((version, Some(build)));
            }
        }
        Ok((self.firmware_version()?, self.build()?))
    }

    /// The build behind the version in the answer to FW_VERSION; `None` where no table asks for it. What is not the table's
    /// is asked for again, for a bit error.
    fn build(&mut self) -> Result<Option<u16>> {
        let Some(expected) = self.chip.identity.build else { return Ok(None) };
        let mut found = None;
        for _ in 0..2 {
            let answer = self.dialect.version(self)?;
            found = answer.get(BUILD).and_then(|build| Some(u16::from_be_bytes(build.try_into().ok()?)));
            if found == Some(expected) {
                break;
            }
        }
        Ok(found)
    }

    /// Makes sure that the firmware is still the build of the table, where that has one.
    pub(crate) fn confirm_build(&mut self) -> Result<()> {
        let found = self.build().map_err(|error| error.at(Step::Identify))?;
        if found == self.chip.identity.build {
            return Ok(());
        }
        let why = format!(
            "the firmware's build is 0x{:04x}, which this table does not cover; mount it anew",
            found.unwrap_or_default()
        );
        Err(Error::new(self.chip.model, Cause::Gone, why).at(Step::Identify))
    }

    /// DEVICE_TYPE, which with one wrong bit is the subcommand that begins calibration mode of some parts. That mode is ended
    /// if it shows right after the question and did not right before it; one that showed before is somebody else's.
    fn device_type(&mut self) -> Result<u16> {
        let Some((mode, end)) = self.chip.preflight.slip() else { return self.ask(DEVICE_TYPE) };
        let before = self.status_word().ok();
        let answer = self.ask(DEVICE_TYPE);
        // A gauge that is sealed takes neither.
        let is_sealed = |word| self.chip.security.status.shows_sealed(word);
        if before.is_some_and(|word| word & mode.mask == 0 && !is_sealed(word)) {
            self.end_slip(mode, end)?;
        }
        answer
    }

    fn end_slip(&mut self, mode: &Mode, end: u16) -> Result<()> {
        for _ in 0..TRIES {
            // I2C has no error detection.
            let is_on = self.status_word()? & mode.mask != 0
                && agreed(mode.name, || self.status_word())? & mode.mask != 0;
            if !is_on {
                return Ok(());
            }
            let (subject, name) = (self.subcommand_name(DEVICE_TYPE), self.subcommand_name(end));
            log::warn!(
                "{subject} has reached the gauge with a wrong bit: {} is set; {name} is sent",
                mode.name
            );
            self.command(end)?;
            self.wait(SLIP_SHOWS);
        }
        let command = self.subcommand_name(end).into();
        let failed = Error::of(self.chip.model, Reason::NoEffect { command, times: TRIES.into() });
        Err(Error::of("", Reason::Calibrating { failed }))
    }

    fn status_word(&mut self) -> Result<u32> {
        self.dialect.look(self, &[]).map(|(word, _)| word.into())
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
            found = self.device_type().map_err(|error| error.at(Step::Identify))?;
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
