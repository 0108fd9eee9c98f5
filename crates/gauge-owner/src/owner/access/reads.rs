// SPDX-License-Identifier: MIT

//! Reading data flash for everybody: what was read is kept for as long as it is valid.

use std::sync::Arc;
use std::time::Duration;

use super::super::Attempt;
use super::super::handle::Shared;
use super::Access;
use crate::error::{Cause, Error, Result};
use ti_gauge::chip::{Parameter, Subclass};
use ti_gauge::dataflash::{Change, First, Outcome, Part, Place};
use ti_gauge::value::Value;

impl Access {
    /// Returns the bytes of subclasses. Those that are not kept are read together, while the gauge is unsealed once.
    pub(in super::super) fn read(&mut self, wanted: &[usize], waited: Duration) -> Result<Vec<Arc<[u8]>>> {
        let kept: Vec<_> = wanted.iter().map(|&index| self.shared.kept(index)).collect();
        let unread = wanted.iter().zip(&kept).filter(|(_, kept)| kept.is_none());
        let unread: Vec<usize> = unread.map(|(&index, _)| index).collect();
        let mut read = self.read_anew(&unread, waited)?.into_iter();
        Ok(kept.into_iter().filter_map(|kept| kept.or_else(|| read.next())).collect())
    }

    /// Returns the value of a parameter of a subclass. Unless it is kept, the blocks that hold it are read.
    pub(in super::super) fn read_value(
        &mut self,
        index: usize,
        parameter: &'static Parameter,
        waited: Duration,
    ) -> Result<Value> {
        if let Some(value) = self.shared.kept_parameter(index, parameter) {
            return Ok(value);
        }
        let part = Part::of((&self.gauge.chip.subclasses[index], parameter));
        let read = self.dataflash.read_parts(&mut self.gauge, std::slice::from_ref(&part), waited);
        let read = self.keep(&[index], std::slice::from_ref(&part), read)?;
        let at = usize::from(parameter.offset - part.start());
        Ok(self.gauge.chip.layout.decode(parameter.kind, &read[0][at..at + parameter.kind.size()]))
    }

    /// Reads subclasses, or without any what distinguishes the pack, so that a later access sees whether it is the same one.
    pub(in super::super) fn know(&mut self, wanted: &[usize], waited: Duration) -> Result<()> {
        if !wanted.is_empty() {
            return self.read(wanted, waited).map(drop);
        }
        self.run(|dataflash, gauge| dataflash.learn_pack(gauge, waited))
    }

    pub(in super::super) fn read_anew(
        &mut self,
        wanted: &[usize],
        waited: Duration,
    ) -> Result<Vec<Arc<[u8]>>> {
        let parts = self.parts(wanted);
        if parts.is_empty() {
            return Ok(Vec::new());
        }
        let read = self.dataflash.read_parts(&mut self.gauge, &parts, waited);
        self.keep(wanted, &parts, read)
    }

    /// Reads what attributes and messages need of data flash, if the gauge is open: it is never unsealed for this.
    pub(in super::super) fn read_if_open(&mut self) {
        let wanted = self.shared.unread_places();
        let rows = self.rows(&wanted);
        if rows.is_empty() {
            return;
        }
        let read = self.dataflash.read_if_open(&mut self.gauge, &rows).transpose();
        // A failure is in the log, and no reason to do without the gauge.
        if let Some(read) = read {
            let _ = self.keep(&wanted, &self.parts(&wanted), read);
        }
    }

    /// Writes parameters after reading subclasses, as far as these are not kept, in the same session. Nothing is written unless
    /// `take` takes what all of them hold.
    pub(in super::super) fn write_after(
        &mut self,
        changes: &[Change],
        wanted: &[usize],
        mut take: impl FnMut(&Shared, &[Arc<[u8]>]) -> Result<()>,
        waited: Duration,
    ) -> Result<Outcome> {
        let kept: Vec<_> = wanted.iter().map(|&index| self.shared.kept(index)).collect();
        let unread = wanted.iter().zip(&kept).filter(|(_, kept)| kept.is_none());
        let unread: Vec<usize> = unread.map(|(&index, _)| index).collect();
        let (rows, shared, poll) = (self.rows(&unread), self.shared.clone(), self.schedule.number());
        let mut take = |read: Vec<Vec<u8>>| {
            let read: Vec<Arc<[u8]>> = read.into_iter().map(Arc::from).collect();
            for (&index, bytes) in unread.iter().zip(&read) {
                shared.keep(index, shared.chip.subclasses[index].start(), bytes.clone(), poll);
            }
            report_quirks(&shared);
            let mut read = read.into_iter();
            let all = kept.iter().filter_map(|kept| kept.clone().or_else(|| read.next()));
            take(&shared, &all.collect::<Vec<_>>())
        };
        let first = First { wanted: &rows, take: &mut take };
        self.run(|dataflash, gauge| dataflash.write_after(gauge, changes, first, waited))
    }

    fn rows(&self, wanted: &[usize]) -> Vec<&'static Subclass> {
        wanted.iter().map(|&index| &self.gauge.chip.subclasses[index]).collect()
    }

    fn parts(&self, wanted: &[usize]) -> Vec<Part> {
        self.rows(wanted).into_iter().map(Part::whole).collect()
    }

    /// Keeps what was read: a part of each of those subclasses.
    fn keep(
        &mut self,
        wanted: &[usize],
        parts: &[Part],
        read: Result<Vec<Vec<u8>>>,
    ) -> Result<Vec<Arc<[u8]>>> {
        let read = self.noted(read);
        let first = &self.gauge.chip.subclasses[wanted[0]];
        let read = read.map_err(|error| error.within(&format!("df of {}", first.name)));
        let read = self.shared.logged(Attempt::Read(wanted.to_vec()), read)?;
        let read: Vec<Arc<[u8]>> = read.into_iter().map(Arc::from).collect();
        if self.dataflash.doubts() {
            self.note_another("data flash");
        }
        for ((&index, part), bytes) in wanted.iter().zip(parts).zip(&read) {
            self.shared.keep(index, part.start(), bytes.clone(), self.schedule.number());
        }
        report_quirks(&self.shared);
        Ok(read)
    }
}

/// Reports the flaws that the table describes, if the bytes that show them have been read.
fn report_quirks(shared: &Shared) {
    for quirk in shared.chip.quirks {
        let byte = shared.kept_byte((quirk.subclass, quirk.offset));
        if byte.is_some_and(|byte| byte & quirk.mask == quirk.wrong) {
            let file = format!("df/{}", Place::from((quirk.subclass, quirk.offset)));
            let why = format!("{}; {}", quirk.effect, quirk.remedy);
            shared.report(Attempt::Other, &Error::new(file, Cause::Protocol, why));
        }
    }
}

#[cfg(test)]
mod tests;
