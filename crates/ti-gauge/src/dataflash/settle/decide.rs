// SPDX-License-Identifier: MIT

//! What a person is shown of an interrupted write, and what becomes of it as they decide.

use std::path::PathBuf;
use std::time::Duration;

use super::Decision;
use super::task::{compare_seen, number_of};
use crate::chip::{Chip, Kind};
use crate::codec::WINDOW;
use crate::dataflash::debts::{Pending, Shown};
use crate::dataflash::guard::Record;
use crate::dataflash::keychange::way_out;
use crate::dataflash::pack::Match;
use crate::dataflash::planned::{Seen, look};
use crate::dataflash::session::{Left, Reference, Session};
use crate::dataflash::{DataFlash, Place};
use crate::error::{Cause, Error, Result};
use crate::gauge::{Gauge, Seal};
use crate::journal::{Entry, Identity};
use crate::notation;

pub(super) fn examine(flash: &mut DataFlash, gauge: &mut Gauge, waited: Duration) -> Result<String> {
    let seal = flash.find_seal().map_or(String::new(), |seal| format!("{}\n", seal.why));
    let Some(pending) = flash.find_pending() else {
        let nothing = if seal.is_empty() { "nothing to settle\n".into() } else { seal };
        return Ok(nothing + &waiting(flash));
    };
    let mut text = format!("{seal}{}\n", pending.why);
    let Some(entry) = pending.entry else {
        return Ok(if pending.undecided { text + "To give it up, type\n" + DISCARD } else { text });
    };
    let Identity { chip, firmware, serial, .. } = &entry.identity;
    text += &format!(
        "begun on {chip}, firmware 0x{firmware:04x}, serial number 0x{serial:04x}, found {}\n",
        entry.found.as_str()
    );
    let plan = entry.plan.clone().filter(|_| !entry.owes_seal());
    let Some(plan) = plan else { return Ok(text + "nothing had been written\n") };
    if let Some(key) = &plan.key {
        // The keys that the gauge has were found out when it was tried to settle this.
        let names = key.names();
        let how = match key.is_over() {
            true => "was written and read back",
            false => "was about to be written",
        };
        return Ok(format!("{text}the {names} key {how}\n"));
    }
    flash.access(gauge, waited, |this, gauge, asked| {
        this.knowledge.forget_name();
        let now = this.knowledge.identity(gauge)?;
        let found = gauge.seal_anew()?;
        let session = this.recorded(gauge, found, asked, Record::Nothing)?;
        let run = |_: &mut DataFlash, gauge: &mut Gauge, session: &mut Session| {
            session.open(gauge)?;
            let seen = look(gauge, &plan)?;
            let same = compare_seen(gauge, [&entry.identity, &now], &plan, &seen)?;
            Ok((seen, same))
        };
        let (seen, same) = this.guard(gauge, session, run, DataFlash::end)?;
        let mut serial = String::new();
        if let Match::Other(name) = same {
            text += &match number_of(gauge.chip, &now) {
                Some(number) => {
                    serial = format!(" --serial {number}");
                    format!("{name} is not what it was then: this is another pack, serial number {number}\n")
                }
                None => format!("{name} is not what it was then: this is another pack\n"),
            };
            text += "Connect the pack that it was begun on again, and the write is settled by itself.\n";
        }
        let blocks = seen.iter().map(|seen| seen.stored).collect();
        text += &table(gauge.chip, &seen);
        text += &format!("To decide, type one of\n{}{DISCARD}", to_write(&serial));
        this.debts.show(Shown { entry, identity: now, blocks });
        Ok(text)
    })
}

fn waiting(flash: &DataFlash) -> String {
    let waiting = flash.records.journal().and_then(|journal| journal.waiting().ok()).unwrap_or_default();
    let line = |(path, entry): &(PathBuf, Entry)| {
        let Identity { chip, serial, .. } = &entry.identity;
        let what = entry.subject();
        format!("{}: {what} was interrupted on a {chip}, serial number 0x{serial:04x}\n", path.display())
    };
    match waiting.iter().map(line).collect::<String>() {
        none if none.is_empty() => none,
        lines => {
            format!("{lines}These wait for their packs. If those are lost or this one, type\n{DISCARD}")
        }
    }
}

/// Returns a message for the log, empty without such journals.
fn dismiss_waiting(flash: &DataFlash) -> Result<String> {
    let Some(journal) = flash.records.journal() else { return Ok(String::new()) };
    let mut kept = Vec::new();
    for (path, _) in journal.waiting()? {
        kept.push(journal.dismiss(&path)?.display().to_string());
    }
    let what = "given up; the journals that waited for their packs are kept as";
    Ok(if kept.is_empty() { String::new() } else { format!("{what} {}", kept.join(" and ")) })
}

pub(super) fn decide(
    flash: &mut DataFlash,
    gauge: &mut Gauge,
    decision: Decision,
    waited: Duration,
) -> Result<String> {
    let Some(pending) = flash.find_pending() else {
        let sealed = flash.pay_seal(gauge, waited);
        if decision == Decision::Discard {
            flash.forget_seal();
            let dismissed = dismiss_waiting(flash)?;
            if !dismissed.is_empty() {
                return Ok(dismissed);
            }
        }
        let nothing = || Error::new(gauge.chip.name, Cause::Invalid, "there is nothing to settle");
        return sealed?.ok_or_else(nothing);
    };
    let key = pending.plan().and_then(|plan| plan.key).filter(|key| !key.is_over());
    let needs_keys = match decision {
        Decision::Finish(_) => true,
        Decision::Undo(_) => flash.unfinished.is_none(),
        Decision::Discard => false,
    };
    if let Some(key) = key.filter(|_| needs_keys) {
        let why = format!("no journal has keys: {}", way_out(&key.names));
        return Err(Error::new(gauge.chip.name, Cause::NotPermitted, why));
    }
    if decision != Decision::Discard {
        let told = flash.resolve(gauge, &pending, Some(decision), waited)?;
        return Ok(told.unwrap_or_else(|| "there is nothing to settle".into()));
    }
    let aside = match flash.records.journal().zip(pending.file.as_ref()) {
        Some((journal, file)) if journal.look(file).is_some() => Some(journal.dismiss(file)?),
        _ => None,
    };
    let kept = aside.map_or(String::new(), |path| format!("; the journal is kept as {}", path.display()));
    give_up(flash, gauge, pending.entry, waited)
        .map(|()| format!("an interrupted write was dismissed and data flash left as it is{kept}"))
}

/// Gives up an interrupted write whose values are all written anew: its journal is of no use to anybody.
pub(super) fn withdraw(
    flash: &mut DataFlash,
    gauge: &mut Gauge,
    pending: Pending,
    waited: Duration,
) -> Result<()> {
    if let Some((journal, file)) = flash.records.journal().zip(pending.file.as_ref())
        && journal.look(file).is_some()
    {
        journal.withdraw(file)?;
    }
    give_up(flash, gauge, pending.entry, waited)
}

fn give_up(flash: &mut DataFlash, gauge: &mut Gauge, entry: Option<Entry>, waited: Duration) -> Result<()> {
    flash.debts.settled();
    flash.debts.hold(None);
    flash.unfinished.forget();
    entry.map_or(Ok(()), |entry| leave_as_it_is(flash, gauge, entry, waited))
}

/// Ends the modes that an interrupted write may have left on and seals a gauge that was found sealed.
fn leave_as_it_is(flash: &mut DataFlash, gauge: &mut Gauge, entry: Entry, waited: Duration) -> Result<()> {
    // A gauge whose keys nobody may know stays open, if it is.
    let of_keys = entry.plan.as_ref().and_then(|plan| plan.key.as_ref()).is_some_and(|key| !key.is_over());
    let wrote = !of_keys && !entry.owes_seal();
    let owes = entry.found == Seal::Sealed && !of_keys;
    let reference = Reference::of(&entry);
    let entry = Entry { plan: None, ..entry };
    let kept = entry.clone();
    let ended = flash.access(gauge, waited, |this, gauge, asked| {
        let now = gauge.seal_anew()?;
        let mut session = Session::new(if owes { Seal::Sealed } else { now }, asked);
        if wrote {
            session.inherit_modes(gauge)?;
        }
        if let Some(journal) = this.records.journal().filter(|_| owes) {
            session.journal = Some(journal.begin(&entry.identity, entry.found, 0, None)?);
        }
        (session.now, session.entry) = (None, Some(entry));
        session.pack.pack = Some(reference);
        this.guard(gauge, session, |_, _, _| Ok(()), DataFlash::end)
    });
    if let Err(error) = &ended {
        // The next write ends a mode that may still be on.
        if wrote {
            flash.knowledge.note_mode_left_on();
        }
        if owes && flash.debts.pending().is_none() {
            flash.debts.keep(&flash.records, gauge, Some(kept), None, Left::of(false, error.to_string()));
        }
    }
    ended
}

const DISCARD: &str =
    "  gaugefs settle GAUGE --discard   leave data flash as it is, and put the journal aside\n";

fn to_write(serial: &str) -> String {
    format!(
        "  gaugefs settle GAUGE --undo{serial}      write the old values, verify, seal\n  gaugefs settle GAUGE \
         --finish{serial}    write the new values, verify, seal\n"
    )
}

/// All that a decision may change, one parameter a line: place, name, old, new, and what the gauge has.
fn table(chip: &Chip, seen: &[Seen]) -> String {
    let mut table = String::from("parameter\tname\told\tnew\tgauge\n");
    for Seen { block, stored, .. } in seen {
        let rows = chip.subclasses.iter().filter(|row| row.id == block.place.subclass);
        for row in rows.flat_map(|subclass| subclass.parameters.iter().map(move |one| (subclass, one))) {
            let (subclass, parameter) = row;
            let start = usize::from(parameter.offset).checked_sub(usize::from(block.place.base));
            let Some(start) = start.filter(|start| start + parameter.kind.size() <= WINDOW) else { continue };
            let range = start..start + parameter.kind.size();
            let differs = |at| stored[at] != block.old[at] && !block.learned.has(at);
            if subclass.kind == Kind::Security
                || !range.clone().any(|at| block.written.has(at) || differs(at))
            {
                continue;
            }
            let show = |bytes: &[u8; WINDOW]| {
                notation::render(parameter.kind, &chip.layout.decode(parameter.kind, &bytes[range.clone()]))
            };
            table += &format!(
                "{}\t{}\t{}\t{}\t{}\n",
                Place::of(row),
                parameter.name,
                show(&block.old),
                show(&block.new),
                show(stored)
            );
        }
    }
    table
}
