// SPDX-License-Identifier: MIT

//! What only an open gauge shows before a write: whether the table's addresses fit, and whether the gate stays open.

use super::Knowledge;
use crate::chip::{Chip, Role, Scheme};
use crate::dataflash::Change;
use crate::dataflash::blocks::arrange;
use crate::dataflash::checks::{Setting, both, calibration_enabled, place_of, remedy, short_word};
use crate::dataflash::part::Part;
use crate::dataflash::schemes::{Care, sequence};
use crate::dataflash::state::read_word;
use crate::dataflash::window::{Planned, locate};
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::Gauge;
use crate::value::Value;

impl Knowledge {
    /// Before the first write, rows of known content show whether this firmware has the table's addresses.
    pub(in crate::dataflash) fn check_signature(&mut self, gauge: &mut Gauge) -> Result<()> {
        if self.signed.is_known(self.now.pack) {
            return Ok(());
        }
        for row in gauge.chip.signature {
            let size = row.kind.size();
            let (place, at) = locate(row.subclass, row.offset);
            let window = sequence(gauge).load(gauge, place, Care::Sure)?;
            let Value::Int(found) = gauge.chip.layout.decode(row.kind, &window[at..at + size]) else {
                continue;
            };
            if !row.holds(found) {
                let why = format!(
                    "{} holds {found}, which cannot be: this firmware keeps its data flash elsewhere, and nothing \
                     is written to it",
                    place.name(at)
                );
                return Err(Error::new("", Cause::Gone, why).at(Step::Check));
            }
        }
        self.signed.learn(self.now.pack, ());
        Ok(())
    }

    /// Reads the limit and the divider of the flash-voltage gate, unless they are known. UNSEALED only.
    pub(in crate::dataflash) fn learn_gate(&mut self, gauge: &mut Gauge) -> Result<()> {
        let Some(gate) = &gauge.chip.gate else { return Ok(()) };
        if !self.gate.is_known(self.now.values) {
            let divider = gate.divider.map(|row| self.word(gauge, row)).transpose()?;
            let limit = match divider {
                // Loading the divider's block has shown that the window shows data flash.
                Some(_) => short_word(gauge, gate.limit)?,
                None => self.word(gauge, gate.limit)?,
            };
            self.gate.learn(self.now.values, (limit as i16, divider.unwrap_or(1)));
        }
        Ok(())
    }

    /// Takes limit and divider from what this session has read, if both are in them.
    pub(in crate::dataflash) fn take_gate(&mut self, chip: &'static Chip, read: &[Part]) {
        let Some(gate) = &chip.gate else { return };
        let word = |row: (u8, u16)| {
            read.iter().find(|part| part.holds(row))?;
            let (place, at) = place_of(row);
            let window = self.known().get(place)?;
            Some(chip.layout.word([window[at], window[at + 1]]))
        };
        let divider = gate.divider.map_or(Some(1), &word);
        if let Some((limit, divider)) = word(gate.limit).zip(divider) {
            self.gate.learn(self.now.values, (limit as i16, divider));
        }
    }

    fn word(&mut self, gauge: &mut Gauge, row: (u8, u16)) -> Result<u16> {
        let (place, at) = place_of(row);
        let window = sequence(gauge).load(gauge, place, Care::Sure)?;
        self.recognise(gauge, place, &window)?;
        Ok(gauge.chip.layout.word([window[at], window[at + 1]]))
    }

    pub(in crate::dataflash) fn check_gate(&mut self, gauge: &mut Gauge, voltage_mv: u16) -> Result<()> {
        self.learn_gate(gauge)?;
        let (Some(gate), Some(&(limit, divider))) = (&gauge.chip.gate, self.gate.get(self.now.values)) else {
            return Ok(());
        };
        let now = Setting::now(limit, divider);
        let remedy = || format!(": charge the pack{}", remedy(gate));
        let Some(shut) = now.shut(gate, voltage_mv.into(), remedy) else { return Ok(()) };
        if calibration_enabled(gauge)? {
            return Ok(());
        }
        self.now.forget_values();
        Err(Error::of("", shut).at_place(gate.limit).at(Step::Check))
    }

    /// Orders the blocks so that the gate stays open after each. Returns whether the window was loaded with another one.
    pub(in crate::dataflash) fn check_gate_after(
        &mut self,
        gauge: &mut Gauge,
        changes: &[Change],
        planned: &mut [Planned],
        voltage_mv: u16,
    ) -> Result<bool> {
        let (Some(gate), Some(&known)) = (&gauge.chip.gate, self.gate.get(self.now.values)) else {
            return Ok(false);
        };
        let mut cells = 1;
        let layout = gauge.chip.layout;
        let (before, after) = (
            Setting::of((gate, layout), known, cells, planned, 0),
            Setting::of((gate, layout), known, cells, planned, planned.len()),
        );
        if before == after {
            return Ok(false);
        }
        self.now.forget_values();
        let mut loaded = false;
        if let Some(row) = gate.cells.filter(|row| !planned.iter().any(|block| block.at(*row).is_some())) {
            let (place, at) = place_of(row);
            cells = sequence(gauge).load(gauge, place, Care::Sure)?[at];
            loaded = true;
        }
        // A limit is lowered first and raised last.
        if gauge.chip.access.scheme == Scheme::Block {
            let raised = after.limit > before.limit;
            let [high, low] = both(gate.limit);
            let holds = |block: &Planned| block.changes(high) || block.changes(low);
            let is_late = |block: &Planned| after.limit != before.limit && holds(block) == raised;
            arrange(planned, &|block| (is_late(block).into(), 0));
        }
        let setting = |stored: usize| Setting::of((gate, layout), known, cells, planned, stored);
        let before = setting(0);
        // One reading may have a wrong bit.
        let (mut low, mut high) = (voltage_mv, voltage_mv);
        let voltage = gauge.chip.register(Role::VoltageNow).map(|register| register.source);
        for _ in 0..2 {
            let Some(voltage) = voltage else { break };
            let again = read_word(gauge, voltage)?;
            (low, high) = (low.min(again), high.max(again));
        }
        let refuse = |why: String| {
            let of_gate = |change: &&Change| gate.rows().any(|row| change.covers(row));
            let subject = changes.iter().find(of_gate).map_or_else(String::new, Change::subject);
            Err(Error::new(subject, Cause::OutOfRange, why).at(Step::Check))
        };
        let after = setting(planned.len());
        // No source says that Voltage() follows a new divider before a calibration, so flash has to stay open if it does not.
        let only_divider = before.limit == after.limit && before.external == after.external;
        let shut = |now: &Setting| now.shut(gate, low.into(), String::new).map(|shut| shut.to_string());
        let stays = (only_divider && before.divider != after.divider).then(|| shut(&after)).flatten();
        if let Some(shut) = before.shut_after(&after, gate, low, high).or(stays) {
            let why = format!(
                "with this write {shut}, so flash would be shut for good: write all values of the divider together, \
                 or set the limit to 0 until they are right"
            );
            return refuse(why);
        }
        // The gauge may measure anew after each block, or not before the reset.
        let shut = |stored: usize| {
            let next = setting(stored);
            before.shut_after(&next, gate, low, high).or_else(|| shut(&next))
        };
        let shut = (1..planned.len()).find_map(shut);
        if let Some(shut) = shut
            && !calibration_enabled(gauge)?
        {
            let why = format!(
                "before the last block is stored {shut}, so the rest would not be stored: set the limit to 0, then \
                 write the other values, then the limit"
            );
            return refuse(why);
        }
        Ok(loaded)
    }
}
