// SPDX-License-Identifier: MIT

//! ManufacturerAccessControl (SLUUBH1C 12.1.3, SLUA790 3): a flat address, echoed, up to 32 bytes, MACDataSum, MACDataLen.

use std::cell::Cell;

use super::{Before, Care, Early, Sequence, look_early, look_twice, note_shown, settle};
use crate::chip::FLAT;
use crate::codec::{MAC_OVERHEAD, WINDOW, mac_sum};
use crate::dataflash::window::{Planned, Window};
use crate::dataflash::window::{has_address, holds_keys};
use crate::error::{Cause, Error, Reason, Result, Step};
use crate::gauge::{Gauge, Statistics};

/// ManufacturerAccessControl(); MACData() follows it.
const MAC: u8 = 0x3e;
const MAC_DATA: u8 = 0x40;
/// MACDataSum(); MACDataLen() follows it.
const MAC_DATA_SUM: u8 = 0x60;
/// No subcommand has a longer answer.
const LONGEST_ANSWER: usize = 12;

pub(super) struct Mac;

impl Sequence for Mac {
    fn enable(&self, _: &mut Gauge) -> Result<()> {
        Ok(())
    }

    fn begin(&self, _: &mut Gauge) -> Result<()> {
        Ok(())
    }

    fn load(&self, gauge: &mut Gauge, place: Window, care: Care) -> Result<[u8; WINDOW]> {
        let before = before(gauge, place, care);
        let mut outcome = load_once(gauge, place, before.as_ref(), care);
        // A bit error in the address made the gauge answer for another one.
        let wrong = |error: &Error| matches!(error.cause(), Cause::BadChecksum | Cause::Protocol);
        if outcome.as_ref().is_err_and(wrong) {
            Statistics::count(&gauge.statistics.retries);
            outcome = load_once(gauge, place, None, care);
        }
        outcome.inspect(|window| note_shown(gauge, place, *window))
    }

    fn glance(&self, gauge: &mut Gauge, place: Window, _: Option<&[u8; WINDOW]>) -> Result<[u8; WINDOW]> {
        request(gauge, place)?;
        settle(gauge);
        read_answer(gauge, place).map(|(window, _)| window)
    }

    fn read_part(&self, gauge: &mut Gauge, place: Window, at: usize, into: &mut [u8]) -> Result<()> {
        let window = self.glance(gauge, place, None)?;
        into.copy_from_slice(&window[at..at + into.len()]);
        Ok(())
    }

    fn fills_window(&self) -> bool {
        false
    }

    fn pieces(&self, block: &Planned) -> Vec<Planned> {
        block.runs().into_iter().map(|run| block.only(run)).collect()
    }

    fn fill(&self, gauge: &mut Gauge, block: &Planned) -> Result<()> {
        for run in block.runs() {
            let address = block.place.base + run.start as u16;
            let at = |error: Error| error.at(Step::WriteBlock);
            // The gauge loads the present bytes into MACData() and overwrites anything sent earlier.
            if gauge.chip.volatile.is_some() {
                self.load(gauge, Window { subclass: FLAT, base: address }, Care::Quick)?;
            } else {
                gauge.write(MAC, &address.to_le_bytes()).map_err(at)?;
                settle(gauge);
            }
            gauge.write(MAC_DATA, &block.new[run]).map_err(at)?;
        }
        Ok(())
    }

    fn commit(&self, gauge: &mut Gauge, block: &Planned) -> Result<()> {
        for run in block.runs() {
            let address = block.place.base + run.start as u16;
            let length = (run.len() + MAC_OVERHEAD) as u8;
            let sent = gauge.write_once(MAC_DATA_SUM, &[mac_sum(address, &block.new[run]), length]);
            gauge.wait(gauge.chip.access.commit);
            sent.map_err(|bus| Error::bus("MACDataSum()", bus).at(Step::WriteBlock))?;
        }
        Ok(())
    }

    fn always_finishes(&self) -> bool {
        false
    }
}

fn request(gauge: &mut Gauge, place: Window) -> Result<()> {
    if !has_address(gauge.chip, place.base) {
        // A neighbour of the first or the last row, or what a journal of another kind of part names.
        let why = format!("{}: data flash has no such address", place.name(0));
        return Err(Error::new("", Cause::Invalid, why).at(Step::ReadBlock));
    }
    gauge.write(MAC, &place.base.to_le_bytes()).map_err(|error| error.at(Step::ReadBlock))
}

fn before(gauge: &mut Gauge, place: Window, care: Care) -> Option<Before> {
    match gauge.chip.volatile {
        _ if care == Care::Sure && holds_keys(gauge.chip, place) => None,
        Some(_) if care == Care::Quick => Before::shown(gauge).or_else(|| read_before(gauge)),
        Some(_) => None,
        None => before_flash(gauge, place),
    }
}

fn read_before(gauge: &mut Gauge) -> Option<Before> {
    let mut content = [0; WINDOW];
    gauge.read(MAC_DATA, &mut content).ok().map(|()| Before::of(None, content))
}

/// What the window shows before a load. A block that is not told from it comes after another one, and so does one that is
/// selected while an answer may be on its way.
fn before_flash(gauge: &mut Gauge, place: Window) -> Option<Before> {
    let known = Before::shown(gauge).or_else(|| {
        let from = if gauge.window_rests() { 0 } else { LONGEST_ANSWER };
        let before = read_before(gauge)?;
        // No sum of it is known: with a wrong bit it would be told from itself. A landmark differs in more.
        let is_certain = from > 0 || read_before(gauge)?.content == before.content;
        is_certain.then_some(Before { from, ..before })
    });
    known?.or_landmark(gauge, place, |gauge, other, landmark| {
        request(gauge, other)?;
        let is_there = |now: &[u8; WINDOW]| landmark.is(now);
        let is_read = Cell::new(false);
        Ok(look_early(gauge, is_there, |gauge: &mut Gauge| look_at(gauge, other, &is_read)))
    })
}

fn load_once(gauge: &mut Gauge, place: Window, before: Option<&Before>, care: Care) -> Result<[u8; WINDOW]> {
    let chip = gauge.chip;
    request(gauge, place)?;
    let read_sum = |gauge: &mut Gauge| {
        let mut sum = [0];
        gauge.read(MAC_DATA_SUM, &mut sum).map(|()| sum[0])
    };
    let is_read = Cell::new(false);
    let whole = |gauge: &mut Gauge| look_at(gauge, place, &is_read);
    let seen = match before {
        None => look_twice(gauge, care, None, read_sum, whole),
        Some(before) => {
            let stale = before.sums(|at, content| mac_sum(at.unwrap_or(place).base, content));
            let is_new = |now: &[u8; WINDOW]| !before.is_shown(chip, now);
            let is_far = |now: &[u8; WINDOW]| before.is_far(chip, now);
            let is_apart = |now: &[u8; WINDOW]| before.is_apart(chip, now);
            let early = Early { stale, is_new: &is_new, is_far: &is_far, is_apart: &is_apart };
            look_twice(gauge, care, Some(&early), read_sum, whole)
        }
    };
    seen.map_err(|error| error.within(&place.name(0)))
}

/// A look at a requested block. Once `is_read`, some parts show the next one: it is requested anew.
fn look_at(gauge: &mut Gauge, place: Window, is_read: &Cell<bool>) -> Result<([u8; WINDOW], u8)> {
    if is_read.replace(true) && gauge.chip.access.advances {
        request(gauge, place)?;
        settle(gauge);
    }
    read_answer(gauge, place)
}

fn read_answer(gauge: &mut Gauge, place: Window) -> Result<([u8; WINDOW], u8)> {
    let address = place.base;
    let at = |error: Error| error.at(Step::ReadBlock);
    let mut answer = [0; 2 + WINDOW + 2];
    // What is read beside keys is not recorded.
    let is_secret = holds_keys(gauge.chip, place);
    gauge.set_secret(is_secret);
    let read = gauge.read(MAC, &mut answer);
    gauge.set_secret(false);
    read.map_err(at)?;
    let echo = u16::from_le_bytes([answer[0], answer[1]]);
    let (reported, length) = (answer[2 + WINDOW], usize::from(answer[2 + WINDOW + 1]));
    let refuse = |reason| Err(Error::of(place.name(0), reason).at(Step::ReadBlock));
    if echo != address {
        let why = format!("the gauge echoes address 0x{echo:04x}");
        return refuse(Reason::Text(Cause::Protocol, why.into()));
    }
    if !(MAC_OVERHEAD..=MAC_OVERHEAD + WINDOW).contains(&length) {
        return refuse(Reason::Text(Cause::Protocol, format!("MACDataLen() is {length}").into()));
    }
    let data = &answer[2..2 + length - MAC_OVERHEAD];
    let adds_up = mac_sum(address, data);
    if adds_up != reported {
        return refuse(Reason::Checksum {
            found: reported.into(),
            expected: adds_up.into(),
            of: "MACDataSum()",
        });
    }
    // At the end of data flash the answer is shorter than a window; the missing bytes are never used.
    let mut window = [0; WINDOW];
    window[..data.len()].copy_from_slice(data);
    Ok((window, reported))
}
