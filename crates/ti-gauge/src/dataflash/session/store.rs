// SPDX-License-Identifier: MIT

//! Programs one block and verifies it.

use super::{Session, reads_wrong};
use crate::dataflash::checks;
use crate::dataflash::io::{STORES, is_passing, reload, still_open, verify};
use crate::dataflash::schemes::{Care, sequence};
use crate::dataflash::window::Planned;
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Gauge, Moment, Statistics};

/// What shows that the gauge is still the one that a block is meant for.
pub(in crate::dataflash) trait Confidence {
    /// Makes sure of it. What is sent is bound to the moment that this returns.
    fn assure(&mut self, gauge: &mut Gauge) -> Result<Moment>;
    fn compared(&self) -> u32 {
        0
    }
}

impl Confidence for Session {
    fn assure(&mut self, gauge: &mut Gauge) -> Result<Moment> {
        Session::assure(self, gauge)
    }

    fn compared(&self) -> u32 {
        self.pack.compared
    }
}

/// The keys that a gauge has just taken.
pub(in crate::dataflash) struct ByKeys;

impl Confidence for ByKeys {
    fn assure(&mut self, gauge: &mut Gauge) -> Result<Moment> {
        Ok(gauge.moment())
    }
}

/// As [`store_patiently`], with a failure explained by the voltage if that is too low to store anything.
pub(in crate::dataflash) fn store(
    gauge: &mut Gauge,
    confidence: &mut impl Confidence,
    block: &Planned,
    touched: &mut usize,
) -> Result<()> {
    store_patiently(gauge, confidence, block, touched).map_err(|error| match reads_wrong(&error) {
        true => checks::shut(gauge).ok().flatten().unwrap_or(error),
        false => error,
    })
}

/// Writes one block, commits it and reads it back. `touched` counts blocks that may have been committed, to be read back.
/// A commit without acknowledgement that changed nothing is repeated: the gauge was busy with a row of its own.
fn store_patiently(
    gauge: &mut Gauge,
    confidence: &mut impl Confidence,
    block: &Planned,
    touched: &mut usize,
) -> Result<()> {
    let (mut block, before) = (block.clone(), *touched);
    for _ in 1..STORES {
        let moment = assure_loaded(gauge, confidence, &mut block)?;
        let (committed, stored) = store_once(gauge, &block, moment, || *touched = before + 1);
        match (committed, stored) {
            (_, Ok(())) => return confidence.assure(gauge).map(drop),
            (Err(error), Err(_)) if is_passing(&error) => {}
            (committed, Err(error)) => return Err(committed.err().unwrap_or(error)),
        }
        still_open(gauge)?;
        confidence.assure(gauge)?;
        // Not the old content: what the commit has done must not be hidden by another.
        block = reload(gauge, &block, Care::Sure)?;
    }
    let moment = assure_loaded(gauge, confidence, &mut block)?;
    let (committed, stored) = store_once(gauge, &block, moment, || *touched = before + 1);
    stored.map_err(|error| committed.err().unwrap_or(error))?;
    confidence.assure(gauge).map(drop)
}

fn assure_loaded(gauge: &mut Gauge, confidence: &mut impl Confidence, block: &mut Planned) -> Result<Moment> {
    let compared = confidence.compared();
    let moment = confidence.assure(gauge)?;
    if confidence.compared() != compared {
        *block = reload(gauge, block, Care::Sure)?;
    }
    Ok(moment)
}

/// The outcome of the commit, which may take effect unacknowledged, and of reading back. It is bound to `moment`.
fn store_once(
    gauge: &mut Gauge,
    block: &Planned,
    moment: Moment,
    commits: impl FnMut(),
) -> (Result<()>, Result<()>) {
    let committed = put(gauge, block, moment, commits);
    if let Err(error) = &committed
        && matches!(error.cause(), Cause::NotNow)
    {
        // What it shows is nothing that this commit has done.
        return (Err(error.clone()), Err(error.clone()));
    }
    (committed, verify(gauge, block))
}

pub(in crate::dataflash) fn put(
    gauge: &mut Gauge,
    block: &Planned,
    moment: Moment,
    mut commits: impl FnMut(),
) -> Result<()> {
    gauge.chip.check_block(block.place.subclass, block.place.base)?;
    for piece in sequence(gauge).pieces(block) {
        sequence(gauge).fill(gauge, &piece)?;
        if !gauge.is_unbroken_since(moment) {
            let why = "the gauge was away for a moment before the block was programmed; try again";
            return Err(Error::new("", Cause::NotNow, why).at(Step::WriteBlock));
        }
        commits();
        Statistics::count(&gauge.statistics.flash_writes);
        sequence(gauge).commit(gauge, &piece)?;
    }
    Ok(())
}
