// SPDX-License-Identifier: MIT

//! Which part a gauge is, and whether it can be mounted with its table.

use std::time::Duration;

use super::Answers;
use super::access::Access;
use crate::error::{Cause, Error, Result, Step};
use gauge_bus::BusError;
use ti_gauge::chip::{Chip, Limited, Recognised, recognise};
use ti_gauge::gauge::{Gauge, agreed};
use ti_gauge::probe;

/// A gauge's watchdog allows each command twice a second.
const ASK_AGAIN: Duration = Duration::from_secs(1);

#[derive(Debug)]
pub(super) struct Identity {
    /// See [`super::Run::unverified`].
    unverified: bool,
    /// See [`super::Run::missing`].
    missing: Option<Error>,
    asked: Duration,
}

impl Identity {
    pub(super) fn new(unverified: bool, missing: Option<Error>) -> Self {
        Self { unverified, missing, asked: Duration::ZERO }
    }

    pub(super) fn take_missing(&mut self) -> Result<()> {
        self.missing.take().map_or(Ok(()), Err)
    }

    pub(super) fn is_unverified(&self) -> bool {
        self.unverified
    }

    pub(super) fn was_asked_since(&self, moment: Duration) -> bool {
        moment < self.asked
    }

    /// Identifies a gauge that has come, or come back. Also returns why only its standard commands are used, if it is so.
    pub(super) fn meet(&mut self, access: &mut Access) -> Result<(Answers, Option<Limited>)> {
        let has_table = access.chip().has_table();
        // The registers are all there is to recognise a gauge by that is never asked.
        if self.unverified || !has_table {
            let now = access.now();
            access.schedule().reads(now);
            probe::check(access.gauge())?;
        }
        let identity = match has_table {
            true => match self.ask(access.gauge()) {
                Err(error) if error.cause() == Cause::Bus(BusError::WriteDisabled) => {
                    (Answers::default(), Some(Limited::WriteDisabled))
                }
                answered => answered?,
            },
            false => {
                self.asked = access.now();
                (Answers::default(), Some(Limited::NoTable))
            }
        };
        self.unverified = false;
        Ok(identity)
    }

    /// I2C has no error detection, so versions that the table was not proven for are asked for until two answers agree.
    pub(super) fn ask(&mut self, gauge: &mut Gauge) -> Result<(Answers, Option<Limited>)> {
        self.asked = gauge.clock.now();
        let chip = gauge.chip;
        let answers = gauge.identify()?;
        let limited = check_identity(chip, &answers)?;
        if !matches!(limited, Some(Limited::Unproven)) {
            return Ok((answers, limited));
        }
        let mut first = Some(answers);
        let again = agreed(chip.name, || {
            if let Some(answers) = first.take() {
                return Ok(answers);
            }
            gauge.wait(ASK_AGAIN);
            gauge.identify()
        })?;
        Ok((again, check_identity(chip, &again)?))
    }
}

/// Checks that the part can be mounted with the table. Returns why only its standard commands are used, if so.
pub(super) fn check_identity(chip: &'static Chip, answers: &Answers) -> Result<Option<Limited>> {
    let is_it = |found: &Chip| found.name == chip.name;
    let found = match recognise(answers) {
        Recognised::Chip(found) if is_it(found) => return Ok(None),
        // It answers as is inferred, and the user has named it.
        Recognised::Unknown if chip.is_inferred() && chip.identity.fits(answers) => return Ok(None),
        // The answers fit several chips, and the user has named this one.
        Recognised::Ambiguous(found) if found.iter().any(|found| is_it(found)) => return Ok(None),
        Recognised::Sibling(sibling) if sibling.like.is_some_and(is_it) => {
            return Ok(Some(Limited::Sibling(sibling)));
        }
        Recognised::Unproven(found) if found.iter().any(|found| is_it(found)) => {
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
