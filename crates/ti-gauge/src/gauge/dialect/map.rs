// SPDX-License-Identifier: MIT

//! A map of little-endian registers: Control() at 0x00, data flash from 0x3E to 0x61 (SLUSBZ5D 7.3.1, SLUUBH1C 12.1).

use std::collections::BTreeSet;
use std::ops::Range;
use std::time::Duration;

use super::{Challenge, Dialect, Touches};
use crate::chip::{Chip, Register, SealStatus, Source};
use crate::codec::{MAC_OVERHEAD, WINDOW, mac_sum};
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::state::{Rows, Shown};
use crate::gauge::{APART, CONTROL_STATUS, FW_VERSION, Gauge, TRIES};
use gauge_bus::BusError;
use gauge_bus::replay::Touch;

/// Control(), whose word is a subcommand.
pub(in crate::gauge) const CONTROL: u8 = 0x00;
const CONTROL_END: u8 = 0x02;
/// DataFlashClass() and DataFlashBlock(), or ManufacturerAccessControl(): what is in the window.
const SELECTION: Range<u8> = 0x3e..0x40;
const DATA: Range<u8> = 0x40..0x60;
/// BlockDataChecksum(), which commits the window, or MACDataSum().
const SUM: u8 = 0x60;
/// BlockDataControl(), or MACDataLen(), which commits what was written to MACData().
const LENGTH: u8 = 0x61;
const ACCESS: Range<u8> = 0x3e..0x62;
const ACCESS_LENGTH: usize = (ACCESS.end - ACCESS.start) as usize;

/// The longest answer to FW_VERSION that any part is known to have.
const LONGEST_VERSION: usize = 12;
/// From a subcommand until MACData() must show its answer; the blocks of data flash take as long.
const ANSWER: Duration = Duration::from_millis(55);
/// From a subcommand until looks at MACData() are worth their transfers that show by themselves that the answer has come.
const EARLY_LOOKS: [Duration; 3] =
    [Duration::from_millis(1), Duration::from_millis(4), Duration::from_millis(10)];
/// Control() of a part with answers in MACData() reads this once after DEVICE_TYPE or FW_VERSION, not CONTROL_STATUS.
const ANSWERED_ELSEWHERE: u16 = 0xffa5;

static CHALLENGE: Challenge = Challenge { select: 0x3f, data: 0x40, sum: 0x54, view: 0x61 };

pub(super) struct Map {
    /// Data flash is selected by an address, which a gauge shows where it shows a subcommand.
    is_flat: bool,
}

pub(super) static BLOCK: Map = Map { is_flat: false };
pub(super) static MAC: Map = Map { is_flat: true };

impl Dialect for Map {
    fn fetch(&self, gauge: &mut Gauge, code: u8, into: &mut [u8]) -> Result<(), BusError> {
        let reach = gauge.reach();
        if reach.carries(1, into.len()) {
            return gauge.again(|gauge| gauge.transfer(&[code], into));
        }
        // A word is never cut.
        if !reach.carries(1, 2) {
            return Err(BusError::TooLong { bytes: into.len() as u16, most: reach.read });
        }
        let (most, mut code, mut rest) = (usize::from(reach.read), code, into);
        while !rest.is_empty() {
            let (part, after) = rest.split_at_mut(self.part(gauge.chip, code, rest.len(), most));
            let length = part.len() as u8;
            match part.len() <= most {
                true => gauge.again(|gauge| gauge.transfer(&[code], part))?,
                false => in_pieces(gauge, code, part, most)?,
            }
            (code, rest) = (code + length, after);
        }
        Ok(())
    }

    fn put(&self, gauge: &mut Gauge, code: u8, data: &[u8]) -> Result<(), BusError> {
        let mut message = [0; 1 + WINDOW];
        message[0] = code;
        message[1..=data.len()].copy_from_slice(data);
        let (whole, piece) = (message, piece(gauge, code, data.len())?);
        gauge.tell(&whole[..=data.len()], |gauge| {
            (0..data.len()).step_by(piece).try_for_each(|start| {
                // In the place of the byte before it, which was sent.
                message[start] = code + start as u8;
                gauge.transfer(&message[start..=data.len().min(start + piece)], &mut [])
            })
        })
    }

    fn subcommand(&self, gauge: &mut Gauge, code: u16) -> Result<(), BusError> {
        self.put(gauge, CONTROL, &code.to_le_bytes())
    }

    fn answer(&self, gauge: &mut Gauge, code: u16) -> Result<u16> {
        let at = gauge.chip.identity.answer;
        if code == FW_VERSION && at != CONTROL {
            return firmware(gauge, at);
        }
        // CONTROL_STATUS answers at Control() itself on every part.
        if code != CONTROL_STATUS {
            return ask(gauge, code, at, &mut []);
        }
        gauge.command(code)?;
        status(gauge, &mut [])
    }

    fn answer_bytes(&self, gauge: &mut Gauge, code: u16, into: &mut [u8]) -> Result<()> {
        let (word, behind) = into.split_at_mut(2);
        let first = ask(gauge, code, gauge.chip.identity.answer, behind)?;
        word.copy_from_slice(&first.to_le_bytes());
        Ok(())
    }

    fn version(&self, gauge: &mut Gauge) -> Result<Vec<u8>> {
        let at = gauge.chip.identity.answer;
        if at == CONTROL {
            return Ok(Vec::new());
        }
        gauge.command(FW_VERSION)?;
        gauge.wait(ANSWER.max(gauge.chip.access.select));
        let mut length = [0];
        gauge.read(LENGTH, &mut length)?;
        // What follows the answer in the buffer may be of a block that was read before.
        let count = usize::from(length[0]).saturating_sub(MAC_OVERHEAD).min(LONGEST_VERSION);
        let mut bytes = vec![0; count];
        if count > 0 {
            gauge.read(at, &mut bytes)?;
        }
        Ok(bytes)
    }

    fn look(&self, gauge: &mut Gauge, also: &[Source]) -> Result<(u16, Rows)> {
        if let SealStatus::Field { word: Source::Answer(code), .. } = gauge.chip.security.status {
            return look_at_answer(gauge, code, also);
        }
        gauge.command(CONTROL_STATUS)?;
        // One transfer reads all, if the bus carries that; one for each piece would read much that is not asked for.
        let last = also.iter().filter_map(|row| row.command()).max().unwrap_or(CONTROL);
        let mut behind = vec![0; usize::from(last)];
        let is_carried = gauge.reach().carries(1, usize::from(CONTROL_END) + behind.len());
        let word = status(gauge, if is_carried { &mut behind } else { &mut [] })?;
        let codes: BTreeSet<_> =
            also.iter().filter_map(|row| row.command()).filter(|_| !is_carried).collect();
        for code in codes {
            let at = usize::from(code - CONTROL_END);
            gauge.read(code, &mut behind[at..at + 2])?;
        }
        let value = |row: &Source| {
            let at = usize::from(row.command()? - CONTROL_END);
            Some(u16::from_le_bytes([behind[at], behind[at + 1]]))
        };
        Ok((word, Rows::of(also, value)))
    }

    fn selection(&self) -> &'static [u8] {
        &[SELECTION.start]
    }

    fn deselect(&self, gauge: &mut Gauge) -> Result<(), BusError> {
        self.put(gauge, if self.is_flat { CONTROL } else { SELECTION.start }, &[0, 0])
    }

    fn touches(&self, write: &[u8]) -> Touches {
        let Some((&start, data)) = write.split_first() else { return Touches::new() };
        let touched = (start..=u8::MAX).zip(data).filter_map(|(at, &byte)| Some((self.touch(at)?, byte)));
        touched.collect()
    }

    fn shows<'a>(&self, register: u8, bytes: &'a [u8]) -> Shown<'a> {
        let selection = if register == SELECTION.start { bytes.first_chunk() } else { None };
        let from = DATA.start.saturating_sub(register);
        let window = bytes.get(usize::from(from)..).filter(|_| register < DATA.end).unwrap_or_default();
        Shown { selection: selection.copied(), at: usize::from(register.saturating_sub(DATA.start)), window }
    }

    fn is_of_window(&self, register: u8, length: usize) -> bool {
        register < ACCESS.end && usize::from(register) + length > usize::from(ACCESS.start)
    }

    fn challenge(&self) -> &'static Challenge {
        &CHALLENGE
    }
}

impl Map {
    /// How many bytes are read as one: up to the end of a register within one message; all of a longer one or the window.
    fn part(&self, chip: &Chip, code: u8, length: usize, most: usize) -> usize {
        if length <= most || self.is_of_window(code, length) {
            return length;
        }
        // What no table has may be a word of another part.
        let is_between = |length: &usize| {
            let end = usize::from(code) + length;
            let is_cut = |row: &Register| {
                let start = row.source.command().map(usize::from);
                start.is_some_and(|start| start < end && end < start + usize::from(row.size))
            };
            end.is_multiple_of(2) && !chip.registers.iter().any(is_cut)
        };
        let within = (1..=most).rev().find(is_between);
        within.or_else(|| (most..length).find(is_between)).unwrap_or(length)
    }

    fn touch(&self, register: u8) -> Option<Touch> {
        let index = |start: u8| usize::from(register - start);
        match register {
            CONTROL..CONTROL_END => Some(Touch::Subcommand(index(CONTROL))),
            _ if SELECTION.contains(&register) => Some(Touch::Selects(index(SELECTION.start))),
            _ if DATA.contains(&register) => Some(Touch::Fills(index(DATA.start))),
            SUM if self.is_flat => Some(Touch::Beside),
            LENGTH if !self.is_flat => Some(Touch::Beside),
            SUM | LENGTH => Some(Touch::Commits),
            _ => None,
        }
    }
}

/// Reads pieces until two readings agree: a bit error in a register moves bytes, and the sum may still fit.
fn in_pieces(gauge: &mut Gauge, code: u8, into: &mut [u8], most: usize) -> Result<(), BusError> {
    let most = most & !1;
    let mut before = None;
    for _ in 0..=TRIES {
        for (at, piece) in (code..).step_by(most).zip(into.chunks_mut(most)) {
            gauge.again(|gauge| gauge.transfer(&[at], piece))?;
        }
        if before.as_deref() == Some(&*into) {
            return Ok(());
        }
        before = Some(into.to_vec());
    }
    Err(BusError::Unsteady)
}

/// How many bytes one message has. Only a gauge that is known to take single bytes gets less than all of them.
fn piece(gauge: &mut Gauge, code: u8, length: usize) -> Result<usize, BusError> {
    // The manual's rule applies to Control() too (SLUSBH1C 9.5.4.3); elsewhere Control() is only written as a word.
    let by_manual = gauge.chip.byte_writes_above_hz.is_some();
    let is_word = code == CONTROL && !by_manual;
    let is_cut = by_manual || !is_word && gauge.takes_bytes();
    let reach = if is_word { gauge.carried() } else { gauge.reach() };
    match usize::from(reach.write).saturating_sub(1) {
        most if length <= most => Ok(length.max(1)),
        most @ 1.. if is_cut && DATA.contains(&code) => Ok(most),
        1.. if is_cut => Ok(1),
        _ => Err(BusError::TooLong { bytes: 1 + length as u16, most: reach.write }),
    }
}

fn firmware(gauge: &mut Gauge, at: u8) -> Result<u16> {
    let mut word = 0;
    // MACData() may still show an older answer.
    for _ in 0..TRIES {
        let mut version = [0; 2];
        word = ask(gauge, FW_VERSION, at, &mut version)?;
        if word.swap_bytes() == gauge.chip.identity.device_type {
            return Ok(u16::from_be_bytes(version));
        }
    }
    // No document has such an answer; it tells this part from others all the same.
    Ok(word)
}

fn status(gauge: &mut Gauge, behind: &mut [u8]) -> Result<u16> {
    match read_answer(gauge, CONTROL_STATUS, CONTROL, behind)? {
        ANSWERED_ELSEWHERE if gauge.chip.identity.answer != CONTROL => {
            read_answer(gauge, CONTROL_STATUS, CONTROL, behind)
        }
        status => Ok(status),
    }
}

/// A look at the answer that has the place of CONTROL_STATUS. MACData() may still show another one, in whose bits a state
/// would be read that the gauge is not in: echo and sum tell it.
fn look_at_answer(gauge: &mut Gauge, code: u16, also: &[Source]) -> Result<(u16, Rows)> {
    gauge.command(code)?;
    gauge.wait(ANSWER.max(gauge.chip.access.select));
    let mut shown = [0; ACCESS_LENGTH];
    let read = gauge.read(SELECTION.start, &mut shown);
    read.map_err(|error| error.about(gauge.subcommand_name(code)).at(Step::Control))?;
    let [low, high, data @ .., sum, length] = shown;
    let data = usize::from(length).checked_sub(MAC_OVERHEAD).and_then(|count| data.get(..count));
    let echo = u16::from_le_bytes([low, high]);
    let is_whole = |data: &&[u8]| mac_sum(echo, data) == sum;
    let word = data.filter(is_whole).and_then(|data| data.first_chunk());
    let Some(word) = word.filter(|_| echo == code) else {
        let why = "the gauge shows another answer, or its sum does not fit";
        return Err(Error::new(gauge.subcommand_name(code), Cause::Protocol, why).at(Step::Control));
    };
    let mut values = Vec::new();
    for source in also {
        if let Some(code) = source.command() {
            values.push((*source, gauge.word(code)?));
        }
    }
    let value = |row: &Source| values.iter().find(|(source, _)| source == row).map(|(_, value)| *value);
    Ok((u16::from_le_bytes(*word), Rows::of(also, value)))
}

/// Sends a subcommand and reads its answer. MACData() shows what it held before, or is blank, until the gauge has stored that.
fn ask(gauge: &mut Gauge, code: u16, at: u8, behind: &mut [u8]) -> Result<u16> {
    if at == CONTROL {
        gauge.command(code)?;
        return read_answer(gauge, code, at, behind);
    }
    // Where something else is on its way into it, no look shows which of both has come.
    let before = if gauge.window_rests() { held(gauge, at, 2 + behind.len()) } else { None };
    gauge.command(code)?;
    let sent = gauge.clock.now();
    for (time, before) in EARLY_LOOKS.into_iter().zip(before.iter().cycle()) {
        gauge.wait_until(sent + time);
        let mut look =
            |gauge: &mut Gauge| Some((read_answer(gauge, code, at, behind).ok()?, behind.to_vec()));
        let Some(now) = look(gauge).filter(|now| is_another(now, before)) else { continue };
        gauge.wait(APART);
        if look(gauge).as_ref() == Some(&now) {
            gauge.note_answered();
            return Ok(now.0);
        }
    }
    gauge.wait_until(sent + ANSWER.max(gauge.chip.access.select));
    read_answer(gauge, code, at, behind)
}

/// What MACData() holds, read twice: with a wrong bit it would be told from itself.
fn held(gauge: &mut Gauge, at: u8, length: usize) -> Option<Vec<u8>> {
    let mut read = |_| {
        let mut bytes = vec![0; length];
        gauge.read(at, &mut bytes).ok().map(|()| bytes)
    };
    let [first, again] = [0, 1].map(&mut read);
    first.filter(|first| again.as_ref() == Some(first))
}

/// Whether an answer is neither what MACData() held before nor blank.
fn is_another((word, behind): &(u16, Vec<u8>), before: &[u8]) -> bool {
    let now: Vec<u8> = word.to_le_bytes().into_iter().chain(behind.iter().copied()).collect();
    now != before && [0, 0xff].iter().all(|blank| now.iter().any(|byte| byte != blank))
}

fn read_answer(gauge: &mut Gauge, code: u16, at: u8, behind: &mut [u8]) -> Result<u16> {
    let mut bytes = vec![0; 2 + behind.len()];
    let read = gauge.read(at, &mut bytes);
    read.map_err(|error| error.about(gauge.subcommand_name(code)).at(Step::Control))?;
    behind.copy_from_slice(&bytes[2..]);
    Ok(u16::from_le_bytes([bytes[0], bytes[1]]))
}
