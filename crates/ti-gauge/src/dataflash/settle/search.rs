// SPDX-License-Identifier: MIT

//! Journals that were begun at other places, or that wait for their pack: whether one of them is of this gauge.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

use super::task::shows;
use super::waits_for_turn;
use crate::chip::Chip;
use crate::dataflash::DataFlash;
use crate::dataflash::debts::{Pending, Where};
use crate::dataflash::guard::Record;
use crate::dataflash::io::COMMITTED;
use crate::dataflash::pack::{Match, compare, is_named, shows_another};
use crate::dataflash::planned::look_by;
use crate::dataflash::schemes::{Care, sequence};
use crate::dataflash::session::Session;
use crate::dataflash::state::has_lost_memory;
use crate::dataflash::window::Window;
use crate::error::{Cause, Result};
use crate::gauge::{Gauge, Seal};
use crate::journal::{Content, Entry, Found, Identity, in_use};

/// Settles what was begun on this gauge elsewhere, or set aside because the pack was not certain.
pub(super) fn search(
    flash: &mut DataFlash,
    gauge: &mut Gauge,
    place: Where,
    waited: Duration,
) -> Result<Vec<String>> {
    let (begun, mut told) = (gauge.clock.now(), Vec::new());
    let arrival = flash.knowledge.arrival();
    let done = flash.debts.is_searched(arrival, place) || flash.debts.pending().is_some();
    let Some(journal) = flash.records.journal().filter(|_| !done) else {
        return Ok(told);
    };
    let is_waiting = place == Where::Waiting;
    let mut found = loop {
        let found = journal.search(is_waiting, &flash.debts.known_files(arrival))?;
        // One that waits is in use only while it is judged, and may be this gauge's.
        let is_judged = |found: &&Found| is_waiting && matches!(found.content, Content::InUse(_));
        match found.iter().find(is_judged) {
            Some(_) if waits_for_turn(gauge, begun) => {}
            Some(found) => return Err(in_use(&found.path)),
            None => break found,
        }
    };
    found.retain(|found| !found.is_here);
    let others = rule_out(flash, gauge, &found, waited)?;
    flash.debts.note_judged(flash.knowledge.arrival(), others.iter().cloned());
    found.retain(|found| !others.contains(&found.path));
    for found in found {
        let file = found.path.clone();
        let pending = Pending { elsewhere: true, ..Pending::found(found) };
        if pending.entry.is_none() {
            continue;
        }
        let waited = waited + (gauge.clock.now() - begun);
        let settled = flash.resolve(gauge, &pending, None, waited);
        if flash.debts.pending().is_some() {
            return settled.map(|_| told);
        }
        told.extend(settled?);
        flash.debts.note_judged(flash.knowledge.arrival(), [file]);
    }
    flash.debts.note_searched(flash.knowledge.arrival(), place);
    Ok(told)
}

/// The journals that show nothing of this gauge. There may be many, so what they are compared with is read once.
fn rule_out(
    flash: &mut DataFlash,
    gauge: &mut Gauge,
    found: &[Found],
    waited: Duration,
) -> Result<Vec<PathBuf>> {
    let entry = |found: &Found| match &found.content {
        Content::Entry(entry) => Some((found.path.clone(), entry.clone())),
        Content::InUse(_) | Content::Unreadable(_) => None,
    };
    let mut entries: Vec<(PathBuf, Entry)> = found.iter().filter_map(entry).collect();
    let has_blocks =
        |entry: &Entry| entry.plan.as_ref().is_some_and(|plan| plan.key.is_none() && !plan.blocks.is_empty());
    entries.retain(|(_, entry)| has_blocks(entry));
    if entries.len() < 2 {
        return Ok(Vec::new());
    }
    let ruled_out = flash.access(gauge, waited, |this, gauge, asked| {
        gauge.claim()?;
        this.knowledge.forget_name();
        let now = this.knowledge.identity(gauge)?;
        let (mut others, mut open) = (Vec::new(), Vec::new());
        for (path, entry) in entries {
            match entry.identity.is_of_part(&now, gauge.chip) && may_be_of(gauge.chip, &entry, &now) {
                true => open.push((path, entry)),
                false => others.push(path),
            }
        }
        if open.is_empty() {
            return Ok(others);
        }
        let found = gauge.seal_anew()?;
        let record = if found == Seal::Sealed { Record::Change(0) } else { Record::Nothing };
        let session = this.recorded(gauge, found, asked, record)?;
        let run = |_: &mut DataFlash, gauge: &mut Gauge, session: &mut Session| {
            session.open(gauge)?;
            others_of(gauge, &now, &open)
        };
        others.extend(this.guard(gauge, session, run, DataFlash::end)?);
        Ok(others)
    });
    match ruled_out {
        // Each of them is tried with what its plan knows of the keys.
        Err(error) if matches!(error.cause(), Cause::NotPermitted) => Ok(Vec::new()),
        ruled_out => ruled_out,
    }
}

/// Looks for a journal that waits for this pack, before the first read. A failure does not prevent that.
pub(in crate::dataflash) fn search_waiting(flash: &mut DataFlash, gauge: &mut Gauge, waited: Duration) {
    if flash.find_pending().is_some() {
        return;
    }
    for place in [Where::Places, Where::Waiting] {
        match search(flash, gauge, place, waited) {
            Ok(told) => told.iter().for_each(|told| log::warn!("{}: {told}", gauge.chip.name)),
            Err(error) => log::warn!("{}: {error}", gauge.chip.name),
        }
    }
}

/// Whether a gauge, by what it shows without a key, may be the one on which something was begun elsewhere.
pub(super) fn may_be_of(chip: &'static Chip, entry: &Entry, now: &Identity) -> bool {
    let then = &entry.identity;
    match entry.plan.as_ref().filter(|_| !entry.owes_seal()) {
        Some(plan) => !shows_another(chip, then, now, plan),
        // Nobody seals a gauge that may have been opened on purpose.
        None => then.serial == now.serial && is_named(chip, now),
    }
}

fn others_of(gauge: &mut Gauge, now: &Identity, journals: &[(PathBuf, Entry)]) -> Result<Vec<PathBuf>> {
    gauge.wait(COMMITTED);
    let moment = gauge.moment();
    let is_lost = has_lost_memory(gauge)?;
    let (mut read, mut others) = (BTreeMap::new(), Vec::new());
    let mut load = |gauge: &mut Gauge, place: Window| match read.get(&(place.subclass, place.base)) {
        Some(content) => Ok(*content),
        None => {
            let content = sequence(gauge).load(gauge, place, Care::Sure)?;
            read.insert((place.subclass, place.base), content);
            Ok(content)
        }
    };
    for (path, entry) in journals {
        let Some(plan) = &entry.plan else { continue };
        let seen = look_by(gauge, plan, &mut load)?;
        let same = compare(gauge.chip, &entry.identity, now, plan, |place| load(gauge, place))?;
        if is_lost || same != Match::Certain && !shows(&seen, &same) {
            others.push(path.clone());
        }
    }
    // What was read before it was away may be of another one.
    Ok(if gauge.is_unbroken_since(moment) { others } else { Vec::new() })
}
