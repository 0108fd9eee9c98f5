// SPDX-License-Identifier: MIT

//! A gauge that arrives, or comes back: which part it is, and what is done before its values are shown.

use std::ptr;
use std::time::Duration;

use super::{Answers, Attempt, Owner, now};
use crate::error::{Cause, Error, Result, Step};
use ti_gauge::chip::{Chip, Limited, Recognised, recognise};
use ti_gauge::dataflash::Place;
use ti_gauge::gauge::agreed;
use ti_gauge::probe;
use ti_gauge::registers::Registers;

/// A gauge's watchdog allows each command twice a second.
const ASK_AGAIN: Duration = Duration::from_secs(1);

impl Owner {
    /// Identifies the gauge and polls it for the first time.
    pub(super) fn open(&mut self) -> Result<()> {
        if let Some(error) = self.missing.take() {
            return Err(error);
        }
        self.arrive()?;
        self.poll()?;
        self.after_first_poll();
        Ok(())
    }

    /// The steps after the first poll of a gauge.
    pub(super) fn after_first_poll(&mut self) {
        self.schedule.hurry();
        self.report_calibration_mode();
        self.keep_configured();
        // Before the mount appears: some monitors read what does not change only once.
        self.read_if_open();
    }

    /// Asks a gauge that has been there all the time what it is, and compares its pack with the one that was there
    /// before, as far as that is possible without a key. Another one is in doubt then, and arrives with the next poll.
    pub(super) fn recognise(&mut self) -> Result<()> {
        if self.schedule.is_gone() || self.dataflash.doubts() || !self.gauge.chip.has_table() {
            return Ok(());
        }
        self.identified = self.gauge.clock.now();
        let (answers, limited) = self.identify()?;
        if answers != self.shared.published().answers {
            self.dataflash.doubt_pack();
        } else if limited.is_none() {
            self.dataflash.compare(&mut self.gauge)?;
        }
        Ok(())
    }

    /// Identifies a gauge that has come, or come back, and forgets what was known of the one before it.
    pub(super) fn arrive(&mut self) -> Result<()> {
        let has_table = self.gauge.chip.has_table();
        // The registers are all there is to recognise a gauge by that is never asked.
        if self.unverified || !has_table {
            self.schedule.reads(self.gauge.clock.now());
            probe::check(&mut self.gauge)?;
        }
        self.identified = self.gauge.clock.now();
        let (answers, limited) =
            if has_table { self.identify()? } else { (Answers::default(), Some(Limited::NoTable)) };
        let chip = self.gauge.chip;
        self.unverified = false;
        self.gauge.forget_refusal();
        self.dataflash.meet(chip, &answers);
        self.forget_dataflash();
        self.rare = Registers::unread(chip.registers);
        self.schedule.begin_anew();
        self.memory.arrives();
        self.shared.publish(|published| {
            published.presence = now::presence();
            (published.answers, published.limited) = (answers, limited);
        });
        match self.limitation() {
            None => self.settle(),
            Some(_) if !has_table => {}
            Some(why) => self.shared.report(Attempt::Other, &why),
        }
        Ok(())
    }

    /// Asks the gauge what it is, and checks that it can be mounted with the chip's table. I2C has no error
    /// detection, so versions that the table was not proven for are asked for until two answers agree.
    fn identify(&mut self) -> Result<(Answers, Option<Limited>)> {
        let chip = self.gauge.chip;
        let answers = self.gauge.identify()?;
        match check_identity(chip, &answers) {
            Ok(None) => Ok((answers, None)),
            Ok(limited @ Some(Limited::Sibling(_) | Limited::NoTable)) => Ok((answers, limited)),
            Ok(Some(Limited::Unproven)) => {
                let mut first = Some(answers);
                let again = agreed(chip.name, || {
                    if let Some(answers) = first.take() {
                        return Ok(answers);
                    }
                    self.gauge.wait(ASK_AGAIN);
                    self.gauge.identify()
                })?;
                Ok((again, check_identity(chip, &again)?))
            }
            Err(error) => Err(error),
        }
    }

    /// The reason to send nothing but standard commands to the gauge, if there is one.
    pub(super) fn limitation(&self) -> Option<Error> {
        self.shared.published().limitation(self.gauge.chip)
    }

    /// Reports the flaws that the table describes, if the bytes that show them have been read.
    pub(super) fn report_quirks(&self) {
        for quirk in self.gauge.chip.quirks {
            let byte = self.shared.kept_byte((quirk.subclass, quirk.offset));
            if byte.is_some_and(|byte| byte & quirk.mask == quirk.wrong) {
                let file = format!("df/{}", Place::from((quirk.subclass, quirk.offset)));
                let why = format!("{}; {}", quirk.effect, quirk.remedy);
                self.shared.report(Attempt::Other, &Error::new(file, Cause::Protocol, why));
            }
        }
    }
}

/// Checks that the part that gave these answers can be mounted with the chip's table. Returns why only its
/// standard commands are used, if it is so.
fn check_identity(chip: &'static Chip, answers: &Answers) -> Result<Option<Limited>> {
    let found = match recognise(answers) {
        Recognised::Chip(found) if ptr::eq(found, chip) => return Ok(None),
        // The answers fit several chips, and the user has named this one.
        Recognised::Ambiguous(found) if found.iter().any(|&found| ptr::eq(found, chip)) => return Ok(None),
        Recognised::Sibling(sibling) if sibling.like.is_some_and(|like| ptr::eq(like, chip)) => {
            return Ok(Some(Limited::Sibling(sibling)));
        }
        Recognised::Unproven(found) if found.iter().any(|&found| ptr::eq(found, chip)) => {
            return Ok(Some(Limited::Unproven));
        }
        Recognised::Chip(found) => format!("this is a {}", found.model),
        Recognised::Sibling(sibling) => format!("this is a {}", sibling.name),
        Recognised::Ambiguous(found) | Recognised::Unproven(found) => {
            let models: Vec<_> = found.iter().map(|found| found.model).collect();
            format!("this is a {}", models.join(" or a "))
        }
        Recognised::Unknown => answers.unknown().to_string(),
    };
    let what = format!("{found}; refusing to mount it as a {}", chip.model);
    Err(Error::of(chip.model, answers.wrong_part(what)).at(Step::Identify))
}

#[cfg(test)]
mod tests;
