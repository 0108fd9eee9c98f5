// SPDX-License-Identifier: MIT

//! Words and blocks of a Smart Battery (Smart Battery Data 1.1, SMBus 1.1). It has no way to write.
//!
//! A transfer is the code of a row and a read. What a pack does where it has no answer is recognised: a code that is not
//! acknowledged, the word before once more, the address byte (0x1717), the same word everywhere, a block without a text.

use super::{Challenge, Dialect, Touches, Wanted};
use crate::chip::sbs::{SERIAL_NUMBER, SPECIFICATION_INFO, is_specification};
use crate::chip::{Register, Source, Tier};
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::packets::{Pec, Words, crc};
use crate::gauge::state::{Answer, Rows, Shown};
use crate::gauge::statistics::Statistics;
use crate::gauge::{Gauge, TRIES};
use gauge_bus::{BusError, Packet};

const VOLTAGE: u8 = 0x09;
const BATTERY_STATUS: u8 = 0x16;
const LONGEST: u8 = 32;
/// If at least so many words are read, and all of them are the same, no pack has answered.
const FEW: usize = 4;
/// The address byte of a read, twice.
const ECHO: [u8; 2] = [0x17; 2];
/// A pack that is asleep acknowledges within a second.
const WAKING: std::time::Duration = std::time::Duration::from_millis(1200);
/// What the kernel's `sbs-battery` takes at most for one uevent, in which it changes the mode for each energy: 86 transfers, and
/// pauses of 2 ms.
const UEVENT: std::time::Duration = std::time::Duration::from_millis(250);
const WAKE: &str = "a pack that has shut itself off is woken by a charger's voltage, one that sleeps by a load or its \
                    button, and many answer only with their PRES contact at ground";

pub(super) struct Smbus;

pub(super) static SMBUS: Smbus = Smbus;
/// Nothing is challenged.
static CHALLENGE: Challenge = Challenge { select: 0, data: 0, sum: 0, view: 0 };

impl Dialect for Smbus {
    fn fetch(&self, gauge: &mut Gauge, code: u8, into: &mut [u8]) -> Result<(), BusError> {
        gauge.again(|gauge| packet(gauge, code, into))
    }

    fn put(&self, _: &mut Gauge, _: u8, _: &[u8]) -> Result<(), BusError> {
        Err(BusError::ReadOnly)
    }

    fn subcommand(&self, _: &mut Gauge, _: u16) -> Result<(), BusError> {
        Err(BusError::ReadOnly)
    }

    fn answer(&self, gauge: &mut Gauge, _: u16) -> Result<u16> {
        Err(refused(gauge))
    }

    fn answer_bytes(&self, gauge: &mut Gauge, _: u16, _: &mut [u8]) -> Result<()> {
        Err(refused(gauge))
    }

    fn version(&self, gauge: &mut Gauge) -> Result<Vec<u8>> {
        Err(refused(gauge))
    }

    fn look(&self, gauge: &mut Gauge, _: &[Source]) -> Result<(u16, Rows)> {
        Err(refused(gauge))
    }

    fn selection(&self) -> &'static [u8] {
        &[BATTERY_STATUS]
    }

    fn deselect(&self, _: &mut Gauge) -> Result<(), BusError> {
        Ok(())
    }

    fn touches(&self, _: &[u8]) -> Touches {
        Touches::new()
    }

    fn shows<'a>(&self, _: u8, _: &'a [u8]) -> Shown<'a> {
        Shown { selection: None, at: 0, window: &[] }
    }

    fn is_of_window(&self, _: u8, _: usize) -> bool {
        false
    }

    fn challenge(&self) -> &'static Challenge {
        &CHALLENGE
    }

    fn reads(&self, rows: &[Register], wanted: &dyn Fn(Tier) -> bool) -> Vec<(u8, u8)> {
        let codes = rows.iter().filter(|row| wanted(row.tier));
        codes.filter_map(|row| Some((row.source.command()?, if row.text { 1 } else { row.size }))).collect()
    }

    fn read(
        &self,
        gauge: &mut Gauge,
        (rows, wanted): Wanted<'_>,
        take: &mut dyn FnMut(Answer<'_>),
    ) -> Result<()> {
        greet(gauge)?;
        let rows = rows.iter().filter(|row| wanted(row.tier) && row.source.command().is_some());
        let (by_mode, plain): (Vec<&Register>, Vec<&Register>) = rows.partition(|row| row.other.is_some());
        let is_mode = |row: &&Register| {
            by_mode.iter().filter_map(|row| row.other).any(|other| other.bit.0 == row.source)
        };
        let mut poll = Poll::default();
        for row in plain.into_iter().filter(|row| !is_mode(row)) {
            let bytes = poll.row(gauge, row)?;
            take(Answer::Row(row, bytes.as_deref()));
        }
        poll.of_mode(gauge, &by_mode, take)?;
        poll.judge(gauge)
    }

    fn is_its_kind(&self, gauge: &mut Gauge) -> Result<Option<bool>> {
        gauge.wire.packets.forget();
        greet(gauge)?;
        let mut word = [0; 2];
        let info = match self.fetch(gauge, SPECIFICATION_INFO, &mut word) {
            Ok(()) => u16::from_le_bytes(word),
            Err(error) if error.may_be_no_ack() => return Ok(None),
            Err(error) => return Err(of(gauge, SPECIFICATION_INFO, error)),
        };
        Ok(Some(is_specification(info)))
    }
}

/// One transfer, with its PEC if the pack has shown that it sends one.
fn packet(gauge: &mut Gauge, code: u8, into: &mut [u8]) -> Result<(), BusError> {
    // What the table does not have may take something, or mean anything.
    if gauge.chip.register_at(Source::Command(code)).is_none() {
        return Err(BusError::ReadOnly);
    }
    let pec = gauge.wire.packets.pec;
    if pec == Pec::Host && into.len() == 2 {
        return by_host(gauge, code, into).map(drop);
    }
    if !pec.is_checked() || pec == Pec::Host || into.len() < 2 || !gauge.reach().carries(1, into.len() + 1) {
        return gauge.transfer(&[code], into);
    }
    let mut bytes = vec![0; into.len() + 1];
    gauge.transfer(&[code], &mut bytes)?;
    let (pec_read, data) = (bytes[into.len()], &bytes[..into.len()]);
    Statistics::count(&gauge.statistics.pec_checked);
    if sum(gauge, pec, code, data) != pec_read {
        Statistics::count(&gauge.statistics.pec_wrong);
        return Err(BusError::Pec);
    }
    into.copy_from_slice(data);
    Ok(())
}

/// A word, or with room for more a block with its length, as one command of an SMBus host. Returns how long it is.
pub(super) fn by_host(gauge: &mut Gauge, code: u8, into: &mut [u8]) -> Result<usize, BusError> {
    let pec = gauge.wire.packets.pec == Pec::Host;
    let read = gauge.packet(Packet { code, is_block: into.len() > 2, pec }, into);
    if pec && matches!(read, Ok(_) | Err(BusError::Pec)) {
        Statistics::count(&gauge.statistics.pec_checked);
    }
    if read == Err(BusError::Pec) {
        Statistics::count(&gauge.statistics.pec_wrong);
    }
    read
}

pub(super) fn sum(gauge: &Gauge, pec: Pec, code: u8, data: &[u8]) -> u8 {
    let [to, from] = [gauge.wire.packets.address << 1, gauge.wire.packets.address << 1 | 1];
    let head: &[u8] = if pec == Pec::Split { &[from] } else { &[to, code, from] };
    crc(&[head, data].concat())
}

pub(super) fn of(gauge: &Gauge, code: u8, error: BusError) -> Error {
    Error::bus(gauge.name_of(code), error).of_register().at(Step::Read)
}

fn refused(gauge: &Gauge) -> Error {
    Error::new(gauge.chip.name, Cause::NotPermitted, gauge.chip.only_read())
}

/// Asks the pack once whether it sends packet error codes: SpecificationInfo() without one, and then with one.
fn greet(gauge: &mut Gauge) -> Result<()> {
    if gauge.wire.packets.pec != Pec::Unasked {
        return Ok(());
    }
    let until = gauge.clock.now() + WAKING;
    let mut word = [0; 2];
    let mut read = SMBUS.fetch(gauge, SPECIFICATION_INFO, &mut word);
    // Any answer shows that it is awake, also of a pack that lacks this word.
    while read.is_err_and(BusError::may_be_no_ack)
        && SMBUS.fetch(gauge, BATTERY_STATUS, &mut [0; 2]).is_err_and(BusError::may_be_no_ack)
    {
        if gauge.clock.now() >= until {
            return Err(absent(gauge, read.err().unwrap_or(BusError::NoAck)));
        }
        read = SMBUS.fetch(gauge, SPECIFICATION_INFO, &mut word);
    }
    let pec = match read {
        Ok(()) if says_pec(gauge, word)? => {
            try_pec(gauge).map_err(|bus| of(gauge, SPECIFICATION_INFO, bus))?
        }
        Ok(()) => Pec::None,
        Err(error) if error.may_be_no_ack() => Pec::None,
        Err(error) => return Err(of(gauge, SPECIFICATION_INFO, error)),
    };
    gauge.wire.packets.pec = pec;
    gauge.statistics.set_pec(pec);
    if let Some(told) = pec.told() {
        log::warn!("{}: {told}", gauge.chip.name);
    }
    Ok(())
}

/// Whether it has packet error codes by its version. Once it is taken for one without, no wrong bit is noticed any more.
fn says_pec(gauge: &mut Gauge, info: [u8; 2]) -> Result<bool> {
    let mut again = info;
    if info[0] >> 4 != 3 {
        let read = SMBUS.fetch(gauge, SPECIFICATION_INFO, &mut again);
        read.map_err(|bus| of(gauge, SPECIFICATION_INFO, bus))?;
    }
    Ok(again[0] >> 4 == 3)
}

fn try_pec(gauge: &mut Gauge) -> Result<Pec, BusError> {
    let reach = gauge.reach();
    let is_host = reach.smbus && reach.pec;
    if !is_host && !reach.carries(1, 3) {
        return Ok(Pec::Unseen);
    }
    let (mut right, mut split, mut host) = (0, 0, 0);
    // The same byte behind an answer may be its sum by chance.
    for code in [SPECIFICATION_INFO, VOLTAGE, BATTERY_STATUS] {
        let mut bytes = [0; 3];
        let packet = Packet { code, is_block: false, pec: true };
        let read = match is_host {
            true => gauge.again(|gauge| gauge.packet(packet, &mut bytes[..2]).map(drop)),
            false => gauge.again(|gauge| gauge.transfer(&[code], &mut bytes)),
        };
        match read {
            Ok(()) if is_host => {
                host += 1;
                continue;
            }
            Ok(()) => {}
            Err(BusError::Pec) => continue,
            // A recording from behind such an adapter.
            Err(BusError::NotRecorded) => return Ok(Pec::Unseen),
            Err(error) if error.may_be_no_ack() => continue,
            Err(error) => return Err(error),
        }
        let is = |pec| u32::from(sum(gauge, pec, code, &bytes[..2]) == bytes[2]);
        (right, split) = (right + is(Pec::Right), split + is(Pec::Split));
    }
    Ok(match (right, split, host) {
        (.., 2..) => Pec::Host,
        (2.., ..) => Pec::Right,
        (_, 2.., _) => Pec::Split,
        _ => Pec::Wrong,
    })
}

fn absent(gauge: &mut Gauge, error: BusError) -> Error {
    gauge.wire.packets.forget();
    let reason = Error::bus(gauge.name_of(SPECIFICATION_INFO), error).of_register().reason().to_string();
    Error::new(gauge.name_of(SPECIFICATION_INFO), Cause::Bus(error), format!("{reason} {WAKE}"))
        .at(Step::Read)
}

/// What one reading of several rows has shown.
#[derive(Default)]
struct Poll {
    words: Vec<[u8; 2]>,
    /// How many words were acknowledged and are not values of the pack.
    strange: usize,
    answered: Option<u8>,
    unanswered: Option<(u8, BusError)>,
}

impl Poll {
    /// The bytes of a row; `None` where the pack has none.
    fn row(&mut self, gauge: &mut Gauge, row: &Register) -> Result<Option<Vec<u8>>> {
        let Some(code) = row.source.command() else { return Ok(None) };
        let read = if row.text { text(gauge, code) } else { word(gauge, row, code) };
        match read {
            Ok(bytes) => {
                self.answered = Some(code);
                gauge.wire.packets.answers(code);
                let bytes = match bytes {
                    Some(bytes) if code == SERIAL_NUMBER => Some(serial(gauge, row, bytes)?),
                    bytes => bytes,
                };
                let word = bytes.as_ref().filter(|_| !row.text).and_then(|bytes| bytes.first_chunk());
                self.words.extend(word);
                self.strange += usize::from(word.is_none() && !row.text);
                Ok(bytes)
            }
            Err(error) if error.may_be_no_ack() => {
                if gauge.wire.packets.lacks(code) {
                    self.unanswered = self.unanswered.or(Some((code, error)));
                }
                Ok(None)
            }
            // A word decides much, a text nothing.
            Err(error @ BusError::Pec) if row.text => {
                log::warn!("{}; it is left out", of(gauge, code, error));
                Ok(None)
            }
            Err(error) => Err(of(gauge, code, error)),
        }
    }

    /// Rows whose unit is that of a mode, which the kernel's `sbs-battery` changes for a moment if it has the pack on another bus.
    /// So the mode is read around each of them, and as a change and its end may lie there, too, two readings have to agree, with
    /// more time between them than the driver takes for all that it shows.
    fn of_mode(
        &mut self,
        gauge: &mut Gauge,
        rows: &[&Register],
        take: &mut dyn FnMut(Answer<'_>),
    ) -> Result<()> {
        let Some((mode, _)) = rows.first().and_then(|row| row.other).map(|other| other.bit) else {
            return Ok(());
        };
        let Some(mode) = gauge.chip.register_at(mode) else { return Ok(()) };
        for turn in 0..=TRIES {
            if turn > 0 {
                gauge.wait(UEVENT);
            }
            let Some(read) = self.in_one_mode(gauge, mode, rows)? else { continue };
            let before = gauge.wire.packets.in_mode.replace(read.clone());
            if before.is_some_and(|before| agree(&before, &read)) {
                let rows = [mode].into_iter().chain(rows.iter().copied());
                rows.zip(read).for_each(|(row, bytes)| take(Answer::Row(row, bytes.as_deref())));
                return Ok(());
            }
        }
        rows.iter().for_each(|row| take(Answer::Row(row, None)));
        Ok(())
    }

    /// The bytes of the mode and of the rows; `None` if it was changed meanwhile.
    fn in_one_mode(
        &mut self,
        gauge: &mut Gauge,
        mode: &Register,
        rows: &[&Register],
    ) -> Result<Option<Words>> {
        let mut read = vec![self.row(gauge, mode)?];
        for row in rows {
            read.push(self.row(gauge, row)?);
            if self.row(gauge, mode)? != read[0] {
                return Ok(None);
            }
        }
        Ok(Some(read))
    }

    /// Whether this was a pack's answer.
    fn judge(self, gauge: &mut Gauge) -> Result<()> {
        if let Some((code, error)) = self.unanswered {
            // Codes that a pack lacks, or a pack that has gone since.
            match self.answered.map(|code| SMBUS.fetch(gauge, code, &mut [0; 2])) {
                Some(Ok(())) => {}
                Some(Err(error)) => return Err(of(gauge, code, error)),
                None => return Err(absent(gauge, error)),
            }
        }
        let is_echo = self.words.is_empty() && self.strange >= FEW;
        let first = self.words.first().copied().unwrap_or(ECHO);
        // 0 mV is no measurement, and shows nothing else.
        let is_same = self.words.len() >= FEW && self.words.iter().all(|word| *word == first);
        if is_echo || is_same && first != [0; 2] {
            let word = u16::from_le_bytes(first);
            let why = format!(
                "every word reads 0x{word:04x}, as on a bus where nothing answers, or of a pack that does not take a \
                 repeated START; check its wires"
            );
            return Err(Error::new(gauge.chip.name, Cause::Protocol, why).at(Step::Read));
        }
        Ok(())
    }
}

/// Whether two readings have the same mode, and words that differ by no more than a pack does meanwhile.
fn agree(one: &[Option<Vec<u8>>], other: &[Option<Vec<u8>>]) -> bool {
    let number = |bytes: &Option<Vec<u8>>| bytes.as_ref()?.first_chunk().copied().map(u16::from_le_bytes);
    let is_near = |(one, other)| match (number(one), number(other)) {
        (Some(one), Some(other)) => one.abs_diff(other) <= one / 50 + 1,
        (one, other) => one == other,
    };
    one.first() == other.first() && one.iter().zip(other).all(is_near)
}

/// The serial number, if two readings agree; an error if it is not that of the pack before.
fn serial(gauge: &mut Gauge, row: &Register, read: Vec<u8>) -> Result<Vec<u8>> {
    let known = gauge.wire.packets.serial.clone();
    if known.as_ref() == Some(&read) {
        return Ok(read);
    }
    let mut again = vec![0; read.len()];
    attempt(gauge, SERIAL_NUMBER, &mut again).map_err(|error| of(gauge, SERIAL_NUMBER, error))?;
    match known {
        Some(known) if known == again => Ok(again),
        None if read == again => Ok(gauge.wire.packets.serial.insert(read).clone()),
        Some(_) if read == again => {
            gauge.wire.packets.forget();
            let why = "another pack has taken its place, by its serial number; it is read anew";
            Err(Error::new(row.name, Cause::Gone, why).at(Step::Read))
        }
        _ => Err(of(gauge, SERIAL_NUMBER, BusError::Unsteady)),
    }
}

/// A word; one that does not change is read until two readings agree, if nothing else proves it.
fn word(gauge: &mut Gauge, row: &Register, code: u8) -> Result<Option<Vec<u8>>, BusError> {
    let mut word = [0; 2];
    attempt(gauge, code, &mut word)?;
    let is_checked = gauge.wire.packets.pec.is_checked();
    let is_stale = gauge.wire.packets.repeats(code, word) && is_stale(gauge, code, &mut word)?;
    gauge.wire.packets.saw(code, word, is_stale);
    if is_stale || word == ECHO && !is_checked {
        return Ok(None);
    }
    if row.tier == Tier::Static && !is_checked {
        let mut again = [0; 2];
        attempt(gauge, code, &mut again)?;
        if again != word {
            return Err(BusError::Unsteady);
        }
    }
    // What feeds nothing shows no reading that is not a value.
    let value = i64::from(u16::from_le_bytes(word));
    Ok((row.role.is_some() || row.values.hold(value)).then(|| word.to_vec()))
}

/// Sends a code again that the pack has not acknowledged before only once.
fn attempt(gauge: &mut Gauge, code: u8, into: &mut [u8]) -> Result<(), BusError> {
    match gauge.wire.packets.is_lacking(code) {
        true => packet(gauge, code, into),
        false => SMBUS.fetch(gauge, code, into),
    }
}

/// Whether a code that reads as the one before it repeats that: then it repeats another one as well.
fn is_stale(gauge: &mut Gauge, code: u8, word: &mut [u8; 2]) -> Result<bool, BusError> {
    let mut other = [0; 2];
    for before in [VOLTAGE, SPECIFICATION_INFO, BATTERY_STATUS].into_iter().filter(|before| *before != code) {
        match attempt(gauge, before, &mut other) {
            Ok(()) if other != *word => {
                attempt(gauge, code, word)?;
                return Ok(*word == other);
            }
            Ok(()) => {}
            Err(error) if error.may_be_no_ack() => {}
            Err(error) => return Err(error),
        }
    }
    Ok(false)
}

/// The length and the text of a block, up to a NUL, which two readings agree on.
fn text(gauge: &mut Gauge, code: u8) -> Result<Option<Vec<u8>>, BusError> {
    let mut last = None;
    for _ in 0..=TRIES {
        let block = block(gauge, code)?;
        if last.as_ref() == Some(&block) {
            return Ok(block.filter(|block| block[1..].iter().any(|byte| byte.is_ascii_graphic())));
        }
        last = Some(block);
    }
    Err(BusError::Unsteady)
}

/// A block as the pack sends it; `None` for one without a valid length, or that the bus does not carry whole.
fn block(gauge: &mut Gauge, code: u8) -> Result<Option<Vec<u8>>, BusError> {
    let reach = gauge.reach();
    if reach.smbus && reach.blocks {
        let mut bytes = vec![0; 1 + usize::from(LONGEST)];
        return match attempt_by_host(gauge, code, &mut bytes) {
            Ok(whole) => Ok(shortened(bytes, whole)),
            Err(BusError::NO_LENGTH) => Ok(None),
            Err(error) => Err(error),
        };
    }
    let mut length = [0];
    attempt(gauge, code, &mut length)?;
    let whole = 1 + usize::from(length[0]);
    if !(1..=LONGEST).contains(&length[0]) || !gauge.reach().carries(1, whole) {
        return Ok(None);
    }
    let mut bytes = vec![0; whole];
    attempt(gauge, code, &mut bytes)?;
    if bytes[0] != length[0] {
        return Ok(None);
    }
    Ok(shortened(bytes, whole))
}

/// [`attempt`] of a block by the host.
fn attempt_by_host(gauge: &mut Gauge, code: u8, into: &mut [u8]) -> Result<usize, BusError> {
    let mut whole = 0;
    let mut read = |gauge: &mut Gauge| by_host(gauge, code, into).map(|read| whole = read);
    let outcome = if gauge.wire.packets.is_lacking(code) { read(gauge) } else { gauge.again(read) };
    outcome.map(|()| whole)
}

/// The text of a block up to a NUL, as a row has it.
fn shortened(mut bytes: Vec<u8>, whole: usize) -> Option<Vec<u8>> {
    let end = bytes[1..whole].iter().position(|byte| *byte == 0).map_or(whole, |at| 1 + at);
    bytes.truncate(end);
    bytes[0] = (end - 1) as u8;
    // A row has room for the longest.
    bytes.resize(1 + usize::from(LONGEST), 0);
    (whole > 1).then_some(bytes)
}
