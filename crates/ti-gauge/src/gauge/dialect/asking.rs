// SPDX-License-Identifier: MIT

//! A gauge of TI's in a Smart Battery that its user lets gaugefs ask: words and blocks as in [`super::smbus`], and answers
//! to the questions of its table.
//!
//! A question is one write of its code, by [`Gauge::pose`], which sends nothing else. The first one is the type. An answer
//! that is not the part's ends asking until the next mount.

use super::smbus::{SMBUS, by_host, of, sum};
use super::{Challenge, Dialect, Touches, Wanted};
use crate::chip::{Asks, Question, Register, Source, Tier, Way};
use crate::codec::Order;
use crate::error::Result;
use crate::gauge::Gauge;
use crate::gauge::asked::Asked;
use crate::gauge::packets::Pec;
use crate::gauge::state::{Answer, Rows, Shown};
use crate::gauge::statistics::Statistics;
use gauge_bus::{BusError, Reach};
use std::time::Duration;

/// The longest answer: its length, the code that is echoed, 32 bytes, and the packet error code.
const LONGEST: usize = 36;
const ECHO: usize = 2;
/// The address byte of a read.
const ADDRESS: u8 = 0x17;
/// The least and the most bytes of a word of status: revisions of one part have them in three, four and five.
const STATUS: std::ops::RangeInclusive<usize> = 2..=8;
/// Device, version and build, most significant byte first (E2E 441952).
const VERSION: usize = 6;
/// Between two attempts. A gauge that programs its flash delivers an old block without a NACK (SLUUBK0B 15.2.1.3).
const PAUSES: [Duration; 4] = [
    Duration::from_millis(10),
    Duration::from_millis(40),
    Duration::from_millis(100),
    Duration::from_millis(250),
];
/// How often an unexpected answer is asked for before it counts: without a checksum it may be a bit error.
const ROUNDS: usize = 3;

pub(super) struct Asking;

pub(super) static ASKING: Asking = Asking;

impl Dialect for Asking {
    fn fetch(&self, gauge: &mut Gauge, code: u8, into: &mut [u8]) -> Result<(), BusError> {
        SMBUS.fetch(gauge, code, into)
    }

    fn put(&self, gauge: &mut Gauge, code: u8, data: &[u8]) -> Result<(), BusError> {
        SMBUS.put(gauge, code, data)
    }

    fn subcommand(&self, gauge: &mut Gauge, code: u16) -> Result<(), BusError> {
        SMBUS.subcommand(gauge, code)
    }

    fn answer(&self, gauge: &mut Gauge, code: u16) -> Result<u16> {
        SMBUS.answer(gauge, code)
    }

    fn answer_bytes(&self, gauge: &mut Gauge, code: u16, into: &mut [u8]) -> Result<()> {
        SMBUS.answer_bytes(gauge, code, into)
    }

    fn version(&self, gauge: &mut Gauge) -> Result<Vec<u8>> {
        SMBUS.version(gauge)
    }

    fn look(&self, gauge: &mut Gauge, also: &[Source]) -> Result<(u16, Rows)> {
        SMBUS.look(gauge, also)
    }

    fn selection(&self) -> &'static [u8] {
        SMBUS.selection()
    }

    fn deselect(&self, gauge: &mut Gauge) -> Result<(), BusError> {
        SMBUS.deselect(gauge)
    }

    fn touches(&self, write: &[u8]) -> Touches {
        SMBUS.touches(write)
    }

    fn shows<'a>(&self, register: u8, bytes: &'a [u8]) -> Shown<'a> {
        SMBUS.shows(register, bytes)
    }

    fn is_of_window(&self, register: u8, length: usize) -> bool {
        SMBUS.is_of_window(register, length)
    }

    fn challenge(&self) -> &'static Challenge {
        SMBUS.challenge()
    }

    fn reads(&self, rows: &[Register], wanted: &dyn Fn(Tier) -> bool) -> Vec<(u8, u8)> {
        SMBUS.reads(rows, wanted)
    }

    fn read(
        &self,
        gauge: &mut Gauge,
        (rows, wanted): Wanted<'_>,
        take: &mut dyn FnMut(Answer<'_>),
    ) -> Result<()> {
        SMBUS.read(gauge, (rows, wanted), take)?;
        let answers = rows.iter().filter(|row| wanted(row.tier) && row.source.answer().is_some());
        ask(gauge, &answers.collect::<Vec<_>>(), take)
    }

    fn is_its_kind(&self, gauge: &mut Gauge) -> Result<Option<bool>> {
        SMBUS.is_its_kind(gauge)
    }
}

/// Asks for each answer that has one of these rows, once.
fn ask(gauge: &mut Gauge, rows: &[&Register], take: &mut dyn FnMut(Answer<'_>)) -> Result<()> {
    let way = if rows.is_empty() { None } else { meet(gauge)? };
    let mut moment = gauge.moment();
    let mut last: Option<(u16, Option<Vec<u8>>)> = None;
    for row in rows {
        let Some((code, at)) = row.source.answer() else { continue };
        if let Some((_, answer)) = last.as_ref().filter(|(asked, _)| *asked == code) {
            take(Answer::Row(row, shown(row, at, answer.as_deref()).as_deref()));
            continue;
        }
        let mut answer = None;
        if let Some((asks, way)) = way.filter(|_| !gauge.wire.packets.asked.is_over()) {
            // Behind a transfer that has failed there may be another pack.
            if gauge.is_unbroken_since(moment) || is_still(gauge, asks, way)? {
                answer = answered(gauge, code, way)?;
            }
            moment = gauge.moment();
        }
        take(Answer::Row(row, shown(row, at, answer.as_deref()).as_deref()));
        last = Some((code, answer));
    }
    Ok(())
}

/// The bytes of a row in an answer; `None` if the answer is not of its length.
fn shown(row: &Register, at: u8, answer: Option<&[u8]>) -> Option<Vec<u8>> {
    let (answer, at, size) = (answer?, usize::from(at), usize::from(row.size));
    if let Source::Within(..) = row.source {
        return answer.get(at..at + size).map(<[u8]>::to_vec);
    }
    // Bits of bytes that it does not send are not set, and none that is set is left out.
    let has_room = answer.iter().skip(size).all(|byte| *byte == 0);
    let mut bytes = answer.to_vec();
    bytes.resize(size, 0);
    (STATUS.contains(&answer.len()) && has_room).then_some(bytes)
}

/// The part, if it has shown that it is the table's, and the way by which it answers.
fn meet(gauge: &mut Gauge) -> Result<Option<(&'static Asks, Way)>> {
    let Some(asks) = gauge.chip.asks else { return Ok(None) };
    match gauge.wire.packets.asked {
        Asked::Answers { way, .. } => {
            return Ok(is_still(gauge, asks, way)?.then_some((asks, way)));
        }
        Asked::Not => {}
        _ => return Ok(None),
    }
    let reach = gauge.reach();
    let Some(way) = asks.ways.iter().copied().find(|way| is_carried(reach, *way)) else {
        note(gauge, Asked::NotCarried);
        return Ok(None);
    };
    let found = introduced(gauge, asks, way)?;
    note(gauge, found);
    Ok((!found.is_over()).then_some((asks, way)))
}

fn is_carried(reach: Reach, way: Way) -> bool {
    match way {
        Way::Block => reach.carries(4, 0) && reach.carries(1, LONGEST),
        Way::Word => reach.carries(3, 0) && (reads_blocks(reach) || reach.carries(1, 14)),
        Way::Back => reach.carries(3, 0) && reach.carries(1, 2),
    }
}

/// Whether it is a host that reads a block of SMBus as one command.
fn reads_blocks(reach: Reach) -> bool {
    reach.smbus && reach.blocks
}

fn note(gauge: &mut Gauge, asked: Asked) {
    gauge.wire.packets.asked = asked;
    gauge.statistics.set_asked(asked);
    if asked.is_over() {
        log::warn!("{}: {asked}", gauge.chip.name);
    }
}

/// Whether the part is still there: each round of questions begins with its type.
fn is_still(gauge: &mut Gauge, asks: &Asks, way: Way) -> Result<bool> {
    let found = of_type(gauge, asks, way)?;
    match found {
        Ok(()) => {}
        // It may have gone; the next poll shows that, and begins anew.
        Err(Asked::Silent) => note(gauge, Asked::Not),
        Err(other) => note(gauge, other),
    }
    Ok(found.is_ok())
}

fn of_type(gauge: &mut Gauge, asks: &Asks, way: Way) -> Result<std::result::Result<(), Asked>> {
    let mut found = Asked::Silent;
    for _ in 0..ROUNDS {
        let answer = answered(gauge, Question::DEVICE_TYPE, way)?;
        found = match answer.as_deref() {
            Some(&[low, high]) if u16::from_le_bytes([low, high]) == asks.device_type => return Ok(Ok(())),
            Some(&[low, high]) => Asked::OtherType(u16::from_le_bytes([low, high])),
            None if !gauge.wire.packets.was_wrong => Asked::Silent,
            _ => Asked::Unclear,
        };
    }
    Ok(Err(found))
}

/// Who answers: its type, and its firmware, which begins with the same number.
fn introduced(gauge: &mut Gauge, asks: &Asks, way: Way) -> Result<Asked> {
    if let Err(other) = of_type(gauge, asks, way)? {
        return Ok(other);
    }
    let mut found = Asked::Unclear;
    for _ in 0..ROUNDS {
        let answer = answered(gauge, Question::FIRMWARE_VERSION, way)?.unwrap_or_default();
        let number = |at: usize| answer.get(at..at + 2).map(|bytes| Order::Big.number(bytes) as u16);
        found = match (number(0), number(2), number(4)) {
            (Some(kind), Some(version), Some(build)) if kind == asks.device_type => {
                let [major, _] = version.to_be_bytes();
                match asks.majors.is_empty() || asks.majors.contains(&major) {
                    true => return protected(gauge, asks, Asked::Answers { way, version, build }),
                    false => Asked::OtherFirmware(version),
                }
            }
            (Some(kind), ..) if answer.len() >= VERSION => Asked::OtherType(kind),
            _ if way == Way::Back && answer.len() == 2 => {
                let version = u16::from_le_bytes([answer[0], answer[1]]);
                return protected(gauge, asks, Asked::Answers { way, version, build: 0 });
            }
            _ => Asked::Unclear,
        };
    }
    Ok(found)
}

/// What is unsealed takes any command, so its questions need their checksum.
fn protected(gauge: &mut Gauge, asks: &Asks, answers: Asked) -> Result<Asked> {
    let Asked::Answers { way, .. } = answers else { return Ok(answers) };
    if has_pec(gauge, way) {
        return Ok(answers);
    }
    let status = answered(gauge, Question::OPERATION_STATUS, way)?.unwrap_or_default();
    let is_sealed =
        STATUS.contains(&status.len()) && Order::Little.number(&status) as u32 & asks.sealed == asks.sealed;
    Ok(if is_sealed { answers } else { Asked::Unprotected })
}

/// Whether the pack can tell that a question has arrived as it was sent.
fn has_pec(gauge: &mut Gauge, way: Way) -> bool {
    gauge.wire.packets.pec.is_checked() && gauge.reach().carries(if way == Way::Block { 5 } else { 4 }, 0)
}

/// The answer to a question of the table; `None` if the table or the part has none.
fn answered(gauge: &mut Gauge, code: u16, way: Way) -> Result<Option<Vec<u8>>> {
    let Some(question) = Question::of(gauge.chip, code) else { return Ok(None) };
    let failed = |gauge: &Gauge, error| of(gauge, way.code(), error);
    let before = gauge.wire.packets.heard.take();
    let read = exchange(gauge, question, way).map_err(|error| failed(gauge, error))?;
    // Without an echo an answer may be the one before, which packs repeat where they have none, or one that has not
    // arrived.
    let is_doubted = way != Way::Block && read.is_some() && (before.is_none() || read == before);
    let kind = Question::of(gauge.chip, Question::DEVICE_TYPE).filter(|kind| *kind != question);
    let Some((kind, asks)) = kind.zip(gauge.chip.asks).filter(|_| is_doubted) else { return Ok(read) };
    let is_type = |answer: &[u8]| *answer == asks.device_type.to_le_bytes();
    let between = exchange(gauge, kind, way).map_err(|error| failed(gauge, error))?;
    if !between.is_some_and(|answer| is_type(&answer)) {
        return Ok(None);
    }
    let again = exchange(gauge, question, way).map_err(|error| failed(gauge, error))?;
    Ok(again.filter(|answer| !is_type(answer)))
}

/// Asks until the answer is one to the question; once only what it has not answered before.
fn exchange(gauge: &mut Gauge, question: Question, way: Way) -> Result<Option<Vec<u8>>, BusError> {
    let is_known = !gauge.wire.packets.unknown.contains(&question.code());
    let mut pauses = PAUSES.iter().filter(|_| is_known);
    gauge.wire.packets.was_wrong = false;
    loop {
        let outcome = once(gauge, question, way);
        let pause = pauses.next();
        match outcome {
            Ok(Some(answer)) => {
                gauge.wire.packets.unknown.remove(&question.code());
                gauge.wire.packets.heard = Some(answer.clone());
                return Ok(Some(answer));
            }
            Ok(None) => gauge.wire.packets.was_wrong = true,
            Err(error) if error.may_be_no_ack() => {}
            Err(error) if error.is_transient() && pause.is_some() => {}
            Err(error) => return Err(error),
        }
        let Some(pause) = pause.filter(|pause| gauge.has_time_for(**pause)) else { break };
        gauge.wait(*pause);
    }
    gauge.wire.packets.unknown.insert(question.code());
    Ok(None)
}

/// One question and its answer, without length, echo and packet error code; `None` for what is no answer to it.
fn once(gauge: &mut Gauge, question: Question, way: Way) -> Result<Option<Vec<u8>>, BusError> {
    let with_pec = has_pec(gauge, way);
    gauge.pose(question, way, with_pec)?;
    let (reach, pec) = (gauge.reach(), gauge.wire.packets.pec);
    let is_by_host = match way {
        Way::Block => false,
        Way::Word => reads_blocks(reach),
        Way::Back => pec == Pec::Host,
    };
    let length = match way {
        Way::Block => LONGEST,
        Way::Word => LONGEST - ECHO - usize::from(is_by_host),
        Way::Back => 2 + usize::from(pec.is_checked() && !is_by_host),
    };
    let mut bytes = vec![0; if is_by_host { length } else { length.min(reach.read.into()) }];
    if is_by_host {
        match by_host(gauge, way.code(), &mut bytes) {
            Ok(whole) => bytes.truncate(whole),
            Err(BusError::NO_LENGTH) => return Ok(None),
            Err(error) => return Err(error),
        }
    } else {
        gauge.hear(way, &mut bytes)?;
    }
    let end = match (way, bytes.first()) {
        (Way::Back, _) => 2,
        (_, first) => 1 + usize::from(*first.unwrap_or(&0)),
    };
    let Some(data) = bytes.get(..end) else { return Ok(None) };
    if !is_by_host {
        compare(gauge, pec, way.code(), data, bytes.get(end).copied())?;
    }
    let [low, high] = question.code().to_le_bytes();
    Ok(match (way, data) {
        (Way::Block, [_, echo_low, echo_high, answer @ ..]) if [*echo_low, *echo_high] == [low, high] => {
            Some(answer.to_vec())
        }
        // A pack that takes no repeated START reads as its own address (E2E 1189534).
        (Way::Word, [_, answer @ ..]) if answer.iter().any(|byte| *byte != ADDRESS) => Some(answer.to_vec()),
        (Way::Back, word) => Some(word.to_vec()),
        _ => None,
    }
    .filter(|answer| !answer.is_empty()))
}

fn compare(gauge: &mut Gauge, pec: Pec, code: u8, data: &[u8], sent: Option<u8>) -> Result<(), BusError> {
    let Some(sent) = sent.filter(|_| pec.is_checked()) else { return Ok(()) };
    Statistics::count(&gauge.statistics.pec_checked);
    if sum(gauge, pec, code, data) == sent {
        return Ok(());
    }
    Statistics::count(&gauge.statistics.pec_wrong);
    Err(BusError::Pec)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::Chip;

    #[test]
    fn no_bit_of_a_status_is_left_out_or_made_up() {
        let chip = Chip::by_name("bq40z50-r5").expect("a chip");
        let row = chip.register_at(Source::Answer(0x0055)).expect("ChargingStatus");
        let bits = |answer: &[u8]| {
            let word = Order::Little.number(&shown(row, 0, Some(answer))?);
            Some(row.set(word).join(" "))
        };
        assert_eq!(bits(&[0x08, 0x04]).as_deref(), Some("MV RT"));
        // ChargingStatus of a bq40z50-R5 has five bytes.
        assert_eq!(bits(&[0x08, 0x04, 0x00, 0x80, 0x02]).as_deref(), Some("bit 31 bit 33 MV RT"));
        assert_eq!(bits(&[0x08, 0x04, 0x00, 0x80, 0x02, 0x00]).as_deref(), Some("bit 31 bit 33 MV RT"));
        assert_eq!(bits(&[0x08, 0x04, 0x00, 0x00, 0x00, 0x01]), None);
        assert_eq!((bits(&[0x08]), bits(&[0; 9]), shown(row, 0, None)), (None, None, None));
    }
}
