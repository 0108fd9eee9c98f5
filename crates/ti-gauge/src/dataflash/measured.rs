// SPDX-License-Identifier: MIT

//! Values that the gauge measures and stores itself, such as offsets. Whether they are right shows only afterwards; until
//! then the old values are owed, as after an interrupted write: settling puts them back.

use std::time::Duration;

use super::blocks::gather;
use super::guard::Record;
use super::planned;
use super::schemes::{Care, sequence};
use super::session::Session;
use super::{Change, DataFlash, Place, Row, old_bytes};
use crate::chip::Kind;
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Gauge, Moment, agreed};
use crate::journal::{OpenJournal, Plan};
use crate::value::Value;

pub(crate) const BEGINS: Duration = Duration::from_secs(2);

/// Records that the gauge is about to store values of its own in these rows. Returns the old values.
pub(crate) fn expect_measured(
    flash: &mut DataFlash,
    gauge: &mut Gauge,
    rows: &[Row],
    waited: Duration,
) -> Result<Vec<Value>> {
    let waited = flash.settle_first(gauge, waited)?;
    flash.access(gauge, waited, |this, gauge, asked| {
        gauge.claim()?;
        let found = gauge.seal_anew()?;
        let session = this.recorded(gauge, found, asked, Record::Change(rows.len()))?;
        let run = |this: &mut DataFlash, gauge: &mut Gauge, session: &mut Session| {
            session.open(gauge)?;
            note_measured(this, gauge, rows, session)
        };
        this.guard(gauge, session, run, DataFlash::end)
    })
}

fn note_measured(
    flash: &mut DataFlash,
    gauge: &mut Gauge,
    rows: &[Row],
    session: &mut Session,
) -> Result<Vec<Value>> {
    if let Some(row) = flash.knowledge.learn_marks(gauge)? {
        return Err(flash.knowledge.other_pack(gauge, row));
    }
    let layout = gauge.chip.layout;
    let as_they_are = rows.iter().map(|&row| {
        let bytes = vec![0; row.1.kind.size()];
        Change { place: Place::of(row), bytes, row: Some(row), saved: false, layout }
    });
    let as_they_are: Vec<Change> = as_they_are.collect();
    let mut blocks =
        gather(gauge, &as_they_are, |gauge, place| sequence(gauge).load(gauge, place, Care::Sure))?;
    blocks.iter_mut().for_each(|block| block.new = block.old);
    blocks.iter().try_for_each(|block| flash.knowledge.recognise(gauge, block.place, &block.old))?;
    let olds = as_they_are
        .iter()
        .zip(rows)
        .map(|(change, (_, parameter))| layout.decode(parameter.kind, &old_bytes(change, &blocks)));
    let olds = olds.collect();
    let neighbours = flash.knowledge.neighbours(gauge, &blocks)?;
    let reset = as_they_are.iter().any(|change| change.kind(gauge.chip) == Kind::Reset);
    let plan = planned::plan(gauge, reset, &blocks, &neighbours, flash.knowledge.marks(gauge.chip));
    flash.note(session, Plan { by_gauge: true, ..plan })?;
    // The rows stand in a block with marks.
    flash.knowledge.expect_rewritten(gauge.chip, &blocks);
    Ok(olds)
}

pub(crate) fn accept_measured(flash: &mut DataFlash) {
    flash.debts.settled();
    if let Some(Err(error)) = flash.debts.take_held().map(OpenJournal::remove) {
        log::warn!("{error}");
    }
}

pub(crate) fn undo_measured(flash: &mut DataFlash, gauge: &mut Gauge) -> Result<()> {
    flash.debts.still_certain(gauge);
    flash.settle(gauge, Duration::ZERO).map(drop)
}

/// The pack must not have been exchanged since: what was measured on one says nothing of another.
pub(crate) fn assure_same(gauge: &Gauge, since: Moment) -> Result<()> {
    if gauge.is_unbroken_since(since) {
        return Ok(());
    }
    let why = "it did not answer for a moment while it was calibrated, so another pack may be there; try again, with the \
               contact kept";
    Err(Error::new(gauge.chip.model, Cause::NotNow, why).at(Step::Identify))
}

/// Makes sure that the gauge does not measure any more: it would store its result later.
pub(super) fn assure_over(gauge: &mut Gauge) -> Result<()> {
    let Some(calibration) = gauge.chip.calibration else { return Ok(()) };
    gauge.wait(BEGINS);
    let running = calibration.board_offset.running | calibration.cc_offset.running;
    if agreed("CONTROL_STATUS", || Ok(gauge.control_status()?.1 & running != 0))? {
        let why = "it still measures its offset, which may take 16 s; try again then";
        return Err(Error::new(gauge.chip.model, Cause::NotNow, why).at(Step::Check));
    }
    Ok(())
}
