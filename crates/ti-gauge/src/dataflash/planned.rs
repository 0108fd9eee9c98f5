// SPDX-License-Identifier: MIT

//! A write as its journal has it, and what a gauge holds of it.

use super::Change;
use super::io::COMMITTED;
use super::schemes::{Care, sequence};
use super::window::{Planned, Window, learned, secrets};
use crate::chip::{Chip, Row};
use crate::codec::WINDOW;
use crate::error::Result;
use crate::gauge::Gauge;
use crate::journal::{Entry, Mark, Plan, PlannedBlock};

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Held {
    Old,
    New,
    /// Some of both, or erased.
    Torn,
    /// At least one byte that neither the write nor a loss of power explains.
    Unexplained,
}

/// A planned block, what the gauge has in its place, and which content that is.
pub(super) struct Seen {
    pub(super) block: Planned,
    pub(super) stored: [u8; WINDOW],
    pub(super) held: Held,
}

/// What the next start needs to settle this write, without keys.
pub(super) fn plan(
    gauge: &Gauge,
    reset: bool,
    planned: &[Planned],
    neighbours: &[Planned],
    marks: Vec<Mark>,
) -> Plan {
    let blocks = planned.iter().chain(neighbours).map(|block| {
        let (mut old, mut new) = (block.old, block.new);
        for at in secrets(gauge.chip, block.place).iter() {
            (old[at], new[at]) = (0, 0);
        }
        let Window { subclass, base } = block.place;
        PlannedBlock { subclass, base, written: block.written, old, new }
    });
    Plan { reset, marks, blocks: blocks.collect(), ..Plan::default() }
}

impl PlannedBlock {
    pub(super) fn place(&self) -> Window {
        Window { subclass: self.subclass, base: self.base }
    }
}

impl Plan {
    fn names(&self, chip: &Chip) -> Vec<&'static str> {
        let is_written = |(subclass, row): &Row| {
            self.blocks.iter().filter(|block| block.subclass == subclass.id).any(|block| {
                let bytes = usize::from(row.offset)..usize::from(row.offset) + row.kind.size();
                bytes
                    .filter_map(|at| at.checked_sub(block.base.into()))
                    .any(|at| at < WINDOW && block.written.has(at))
            })
        };
        chip.rows().filter(is_written).map(|(_, row)| row.name).collect()
    }

    pub(super) fn of_marks(marks: Vec<Mark>) -> Self {
        Self { marks, ..Self::default() }
    }

    /// Whether these changes write all of what an interrupted write was about to change.
    pub(super) fn is_covered(&self, changes: &[Change]) -> bool {
        let is_written = |subclass: u8, offset: usize| {
            changes.iter().any(|change| {
                let begin = usize::from(change.place.offset);
                change.place.subclass == subclass && (begin..begin + change.bytes.len()).contains(&offset)
            })
        };
        let covers = |block: &PlannedBlock| {
            let mut written = (0..WINDOW).filter(|&at| block.written.has(at));
            written.all(|at| is_written(block.subclass, usize::from(block.base) + at))
        };
        self.key.is_none() && !self.blocks.is_empty() && self.blocks.iter().all(covers)
    }

    /// Whether it would write what these changes write, but for what the gauge rewrites itself.
    pub(super) fn is_part_of(&self, changes: &[Change]) -> bool {
        let is_written = |change: &Change, number: usize, byte: u8| {
            let offset = usize::from(change.place.offset) + number;
            let mut blocks = self.blocks.iter().filter(|block| block.subclass == change.place.subclass);
            blocks.all(|block| {
                let at = offset.checked_sub(block.base.into()).filter(|&at| at < WINDOW);
                let differs = |at: usize| (block.new[at] ^ byte) & !change.kept_bits(number) != 0;
                at.is_none_or(|at| !block.written.has(at) || !differs(at))
            })
        };
        let is_alike = |change: &Change| {
            let mut bytes = change.bytes.iter().enumerate();
            change.is_learned() || bytes.all(|(number, &byte)| is_written(change, number, byte))
        };
        self.is_covered(changes) && changes.iter().all(is_alike)
    }
}

impl Entry {
    /// What was interrupted, for a message: `the write of Cell Terminate Voltage`.
    pub(super) fn subject(&self) -> String {
        const NAMED: usize = 2;
        let plan = self.plan.as_ref().filter(|_| !self.owes_seal());
        let Some(plan) = plan else { return "an access".into() };
        if let Some(key) = &plan.key {
            return format!("a change of the {} key", key.names());
        }
        let names = Chip::by_name(&self.identity.chip).map_or(Vec::new(), |chip| plan.names(chip));
        match &*names {
            [] => "a write".into(),
            [name] => format!("the write of {name}"),
            [first, second] => format!("the write of {first} and {second}"),
            several => {
                let (named, more) = (several[..NAMED].join(", "), several.len() - NAMED);
                format!("the write of {named} and {more} more")
            }
        }
    }

    pub(super) fn owes_seal(&self) -> bool {
        self.plan.as_ref().is_none_or(|plan| plan.blocks.is_empty() && plan.key.is_none())
    }

    /// Whether it is of a change of keys, after which the gauge may have another one than the mount.
    pub(super) fn changes_keys(&self) -> bool {
        self.plan.as_ref().is_some_and(|plan| plan.key.is_some() || plan.blocks.is_empty() && plan.reset)
    }
}

/// A plan's blocks as the gauge has them now. The dead process's last commit may be at work, and show old content.
pub(super) fn look(gauge: &mut Gauge, plan: &Plan) -> Result<Vec<Seen>> {
    gauge.wait(COMMITTED);
    look_at(gauge, plan)
}

/// The blocks of a plan as a gauge has them on which no commit is at work.
pub(super) fn look_at(gauge: &mut Gauge, plan: &Plan) -> Result<Vec<Seen>> {
    look_by(gauge, plan, &mut |gauge, place| sequence(gauge).load(gauge, place, Care::Sure))
}

pub(super) fn look_by(
    gauge: &mut Gauge,
    plan: &Plan,
    load: &mut impl FnMut(&mut Gauge, Window) -> Result<[u8; WINDOW]>,
) -> Result<Vec<Seen>> {
    let mut seen = Vec::with_capacity(plan.blocks.len());
    for block in &plan.blocks {
        let place = block.place();
        let stored = load(gauge, place)?;
        let learned = learned(gauge.chip, place).without(block.written);
        let mut block = Planned { place, old: block.old, new: block.new, written: block.written, learned };
        for at in secrets(gauge.chip, place).iter() {
            (block.old[at], block.new[at]) = (stored[at], stored[at]);
        }
        for at in block.written.iter().filter(|_| plan.by_gauge) {
            block.new[at] = stored[at];
        }
        let block = block.as_rewritten(gauge.chip, &stored);
        let held = classify(&block, &stored);
        seen.push(Seen { block, stored, held });
    }
    Ok(seen)
}

pub(super) fn classify(block: &Planned, stored: &[u8; WINDOW]) -> Held {
    let Planned { old, new, learned, .. } = block;
    let (mut all_old, mut all_new, mut torn) = (true, true, false);
    for at in (0..WINDOW).filter(|&at| !learned.has(at)) {
        let byte = stored[at];
        match (byte == old[at], byte == new[at]) {
            (true, true) => {}
            (true, false) => all_new = false,
            (false, true) => all_old = false,
            (false, false) if byte == 0xff => torn = true,
            (false, false) => return Held::Unexplained,
        }
    }
    match (all_old, all_new) {
        _ if torn => Held::Torn,
        (true, _) => Held::Old,
        (_, true) => Held::New,
        _ => Held::Torn,
    }
}
