// SPDX-License-Identifier: MIT

//! A [`Bus`] that answers from a file of [`super::trace`]. An answer depends on what was written before: subcommand,
//! selected block, seal state. So a read gets what was recorded at its register after the same writes, in their order;
//! after the last one, the last that was not a failure is repeated. Writes that only select an answer are accepted, all
//! others refused. If the recorded gauge was unsealed, any key is accepted.

use std::collections::HashMap;
use std::path::Path;

use crate::error::{Error, ErrorKind, Result};
use crate::{Bus, BusError, regular};

/// Longer than a trace of days.
const LONGEST: u64 = 256 << 20;

/// The contents of a recording.
pub struct Recording {
    /// The name of the chip, as on the command line.
    pub chip: String,
    /// That of the first transfer.
    address: Option<u8>,
    events: Vec<Event>,
}

enum Event {
    Transfer {
        write: Vec<u8>,
        read: usize,
        answer: Answer,
    },
    /// A key word.
    Hidden,
}

type Answer = Result<Vec<u8>, BusError>;

/// What a byte of a write touches in a target, as far as the answers to later reads depend on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Touch {
    /// A subcommand: the byte of that index, the least significant one first.
    Subcommand(usize),
    /// What a window shows: the byte of that index of the selection.
    Selects(usize),
    /// The buffer of the window, at that index.
    Fills(usize),
    /// What the buffer holds is stored.
    Commits,
    /// Something else of the window, without an effect of its own.
    Beside,
}

/// What each byte of a write touches, in its order; the first byte of a write is the register.
pub type Touches = Box<dyn Fn(&[u8]) -> Vec<(Touch, u8)> + Send>;

/// What the first byte of a write is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum First {
    /// An address of registers, which goes on with each byte.
    Address,
    /// A command code of SMBus, whose answer is of that code alone.
    Code,
}

/// How to recognise whether a target is sealed.
#[derive(Clone, Copy, Debug)]
pub struct Seals {
    /// The subcommands that seal.
    pub commands: [u16; 2],
    /// The register that shows the seal state, if it is not that of subcommands.
    pub status: Option<u8>,
}

impl Recording {
    /// Reads a file that `--trace` or `gaugefs report` wrote.
    pub fn open(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let text = regular::read_text(path, LONGEST)
            .map_err(|error| Error::file(&name, "cannot read it", &error))?;
        Self::parse(&text).map_err(|error| error.within(&name))
    }

    fn parse(text: &str) -> Result<Self> {
        let only = "only a file that --trace or `gaugefs report` wrote can be replayed";
        let refuse = |number: usize, why: &str| {
            Error::new(format!("line {number}"), ErrorKind::Invalid, format!("{why}; {only}"))
        };
        // A recording that was interrupted may end with an incomplete line.
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        let mut lines = (1..).zip(whole.lines());
        let head = lines.next().and_then(|(_, line)| line.strip_prefix("; gaugefs: "));
        let chip = head.and_then(|head| head.split(" on ").next());
        let chip = chip.ok_or_else(|| refuse(1, "it does not name a gauge"))?.to_string();
        let mut events = Vec::new();
        let (mut asked, mut address) = (None, None);
        for (number, line) in lines {
            if let Some(command) = command(line) {
                if asked.is_some() {
                    return Err(refuse(number - 1, "the transfer has no result below it"));
                }
                let (to, write, read) = command.ok_or_else(|| refuse(number, "not a transfer"))?;
                (asked, address) = (Some((write, read)), address.or(to));
            } else if line == "; hidden" {
                events.push(Event::Hidden);
            } else if let Some((write, read)) = asked.take() {
                let answer = outcome(line).filter(|outcome| match outcome {
                    Ok(bytes) => bytes.len() == read,
                    Err(_) => true,
                });
                let answer = answer.ok_or_else(|| refuse(number, "not a result of the transfer above it"))?;
                events.push(Event::Transfer { write, read, answer });
            } else if !line.is_empty() && !line.starts_with(';') {
                return Err(refuse(number, "neither a transfer nor a comment"));
            }
        }
        Ok(Self { chip, address, events })
    }
}

/// A 7-bit address, what is written to it, and how many bytes are read.
type Command = (Option<u8>, Vec<u8>, usize);

/// The transfer of a line; the inner `None` if it is malformed.
fn command(line: &str) -> Option<Option<Command>> {
    let (line, is_comment) = line.strip_prefix("; ").map_or((line, false), |line| (line, true));
    if let Some(rest) = line.strip_prefix("W:") {
        let (bytes, count) = rest.split_once(" R: ").unwrap_or((rest, "0"));
        return Some(hex(bytes).zip(number(count)).map(addressed));
    }
    let rest = line.strip_prefix("R:")?;
    let (bytes, count) = rest.rsplit_once(' ').unwrap_or((rest, ""));
    // Without a register it is no command of a FlashStream, and so a comment.
    let length = if is_comment { 1 } else { 2 };
    let bytes = hex(bytes).filter(|bytes| bytes.len() == length);
    Some(bytes.zip(number(count)).map(addressed))
}

fn number(text: &str) -> Option<usize> {
    text.parse().ok().filter(|number: &usize| number.to_string() == text)
}

fn addressed((mut bytes, count): (Vec<u8>, usize)) -> Command {
    let address = bytes.drain(..bytes.len().min(1)).next();
    (address.map(|byte| byte >> 1), bytes, count)
}

fn hex(text: &str) -> Option<Vec<u8>> {
    let byte = |digits: &str| {
        let is_byte = digits.len() == 2 && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
        is_byte.then(|| u8::from_str_radix(digits, 16).ok()).flatten()
    };
    text.split_ascii_whitespace().map(byte).collect()
}

fn outcome(line: &str) -> Option<Answer> {
    let (time, rest) = line.strip_prefix(';')?.trim_start().split_once(' ')?;
    time.parse::<f64>().ok()?;
    if let Some(why) = rest.strip_prefix("failed: ") {
        return (!why.is_empty()).then(|| Err(BusError::by_text(why)));
    }
    match rest.strip_prefix("->") {
        Some(bytes) => hex(bytes).map(Ok),
        None => (rest == "ok").then(|| Ok(Vec::new())),
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Context {
    /// Keys were sent since the gauge was last sealed.
    open: bool,
    /// The word that selected the answer, and whether that is a selection; otherwise it is a subcommand.
    about: Option<(bool, [u8; 2])>,
}

struct Written {
    seals: Seals,
    touches: Touches,
    open: bool,
    command: [u8; 2],
    selection: [u8; 2],
    /// The selection was written last.
    selected_last: bool,
}

impl Written {
    fn new(seals: Seals, touches: Touches) -> Self {
        Self { seals, touches, open: false, command: [0; 2], selection: [0; 2], selected_last: false }
    }

    /// As it was before the first write.
    fn begin(&mut self) {
        (self.open, self.command, self.selection, self.selected_last) = (false, [0; 2], [0; 2], false);
    }

    fn note(&mut self, write: &[u8]) {
        for (touch, byte) in (self.touches)(write) {
            match touch {
                Touch::Subcommand(at) => {
                    (self.command[at], self.selected_last) = (byte, false);
                    if at == 1 && self.seals.commands.contains(&u16::from_le_bytes(self.command)) {
                        self.open = false;
                    }
                }
                Touch::Selects(at) => (self.selection[at], self.selected_last) = (byte, true),
                Touch::Fills(_) | Touch::Commits | Touch::Beside => {}
            }
        }
    }

    /// Whether a write selects the answer to a read, and does nothing else.
    fn selects(&self, write: &[u8]) -> bool {
        let touches = (self.touches)(write);
        let only = |touch: &Touch| matches!(touch, Touch::Subcommand(_) | Touch::Selects(_) | Touch::Beside);
        touches.len() + 1 == write.len() && touches.iter().all(|(touch, _)| only(touch))
    }

    fn touch(&self, register: u8) -> Option<Touch> {
        (self.touches)(&[register, 0]).first().map(|(touch, _)| *touch)
    }

    /// What was last written to a register that selects, and so shows it; `None` for others.
    fn selected(&self, register: u8) -> Option<u8> {
        if let Some(Touch::Selects(at)) = self.touch(register) { Some(self.selection[at]) } else { None }
    }

    fn context(&self, register: u8) -> Context {
        let word = if self.selected_last { self.selection } else { self.command };
        match self.touch(register) {
            Some(Touch::Subcommand(_)) => Context { open: self.open, about: Some((false, self.command)) },
            Some(_) => Context { open: self.open, about: Some((self.selected_last, word)) },
            None => Context { open: self.open && self.seals.status == Some(register), about: None },
        }
    }
}

#[derive(Default)]
struct Series {
    answers: Vec<Answer>,
    next: usize,
}

impl Series {
    fn next(&mut self) -> Option<Answer> {
        if let Some(answer) = self.answers.get(self.next) {
            self.next += 1;
            return Some(answer.clone());
        }
        let good = self.answers.iter().rfind(|answer| answer.is_ok());
        good.or(self.answers.last()).cloned()
    }
}

/// A recorded gauge.
pub struct Replay {
    series: HashMap<(Context, u8, usize), Series>,
    /// The last value of each byte, for reads of other lengths than the recorded ones.
    bytes: HashMap<(Context, u8), u8>,
    /// The recording contains keys, as hidden transfers.
    opened: bool,
    written: Written,
    secret: bool,
    first: First,
    address: Option<u8>,
}

impl Replay {
    /// Replays a recording. `touches` knows the registers of its target.
    pub fn new(recording: &Recording, first: First, seals: Seals, touches: Touches) -> Self {
        let (mut series, mut bytes) = (HashMap::<_, Series>::new(), HashMap::new());
        let (mut written, mut opened) = (Written::new(seals, touches), false);
        for event in &recording.events {
            let Event::Transfer { write, read, answer } = event else {
                (written.open, opened) = (true, true);
                continue;
            };
            let Some((&register, data)) = write.split_first() else { continue };
            written.note(write);
            if *read == 0 {
                continue;
            }
            let register = register.wrapping_add(data.len() as u8);
            let key = (written.context(register), register, *read);
            series.entry(key).or_default().answers.push(answer.clone());
            if first == First::Code {
                continue;
            }
            for (at, &byte) in (register..=0x7f).zip(answer.iter().flatten()) {
                bytes.insert((written.context(at), at), byte);
            }
        }
        written.begin();
        Self { series, bytes, opened, written, secret: false, first, address: recording.address }
    }

    /// Where the target was, if anything was recorded.
    pub fn address(&self) -> Option<u8> {
        self.address
    }

    /// Whether these bytes can be read without a write that selects them first; of a command code, whether it was read.
    pub fn covers(&self, register: u8, length: u8) -> bool {
        if self.first == First::Code {
            return self.series.keys().any(|&(_, code, read)| code == register && read >= length.into());
        }
        (register..register + length).all(|at| self.bytes.contains_key(&(self.written.context(at), at)))
    }

    fn read(&mut self, register: u8, into: &mut [u8]) -> Result<(), BusError> {
        let key = (self.written.context(register), register, into.len());
        if let Some(answer) = self.series.get_mut(&key).and_then(Series::next) {
            return answer.map(|bytes| into.copy_from_slice(&bytes));
        }
        if self.first == First::Code {
            return self.beginning(register, into);
        }
        let bytes = (register..=0x7f).map(|at| {
            let recorded = self.bytes.get(&(self.written.context(at), at)).copied();
            recorded.or_else(|| self.written.selected(at))
        });
        let bytes: Option<Vec<u8>> = bytes.take(into.len()).collect();
        let bytes = bytes.filter(|bytes| bytes.len() == into.len()).ok_or_else(|| self.lacks(register))?;
        into.copy_from_slice(&bytes);
        Ok(())
    }

    /// The first bytes of the shortest answer of a code that has so many.
    fn beginning(&mut self, code: u8, into: &mut [u8]) -> Result<(), BusError> {
        let longer = |&&(_, of, read): &&(Context, u8, usize)| of == code && read > into.len();
        let key = self.series.keys().filter(longer).min_by_key(|&&(_, _, read)| read).copied();
        let answer = key.and_then(|key| self.series.get_mut(&key)?.next());
        answer.ok_or_else(|| self.lacks(code))?.map(|bytes| into.copy_from_slice(&bytes[..into.len()]))
    }

    /// A register that answered after other writes was not asked after these; a target may not have one that never did.
    fn lacks(&self, register: u8) -> BusError {
        let has = self.series.keys().any(|&(_, at, _)| at == register);
        if has { BusError::NotRecorded } else { BusError::NoAck }
    }
}

impl Bus for Replay {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        if self.secret {
            self.written.open = self.opened;
            return if self.opened { Ok(()) } else { Err(BusError::NotRecorded) };
        }
        let Some((&register, data)) = write.split_first() else {
            return if read.is_empty() { Ok(()) } else { Err(BusError::NoAck) };
        };
        // These registers only select an answer; a recording executes no subcommand.
        if !self.written.selects(write) {
            return Err(BusError::ReadOnly);
        }
        self.written.note(write);
        if read.is_empty() {
            return Ok(());
        }
        self.read(register.wrapping_add(data.len() as u8), read)
    }

    fn set_secret(&mut self, secret: bool) {
        self.secret = secret;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "; gaugefs: bq34z100-g1 on /dev/i2c-1 address 0x55, 2026-01-01T00:00:00Z\n\
                        ; Below each transfer: seconds since the start, and the result.\n";

    fn replay(lines: &str) -> Replay {
        let recording = Recording::parse(&format!("{HEAD}{lines}")).expect("a recording");
        assert_eq!(recording.chip, "bq34z100-g1");
        let seals = Seals { commands: [0x20, 0x41], status: None };
        Replay::new(&recording, First::Address, seals, Box::new(touches))
    }

    /// What a target with subcommands at 0 and a window of 32 bytes from 0x40 on is touched by.
    fn touches(write: &[u8]) -> Vec<(Touch, u8)> {
        let touch = |at: u8| match at {
            0..2 => Some(Touch::Subcommand(at.into())),
            0x3e..0x40 => Some(Touch::Selects(usize::from(at) - 0x3e)),
            0x40..0x60 => Some(Touch::Fills(usize::from(at) - 0x40)),
            0x60 => Some(Touch::Commits),
            0x61 => Some(Touch::Beside),
            _ => None,
        };
        let (start, data) = write.split_first().expect("a register");
        (*start..).zip(data).filter_map(|(at, &byte)| Some((touch(at)?, byte))).collect()
    }

    fn ask(bus: &mut Replay, write: &[u8], count: usize) -> Answer {
        let mut read = vec![0; count];
        bus.transfer(write, &mut read).map(|()| read)
    }

    #[test]
    fn answers_are_replayed_in_order_and_the_last_good_one_repeats() {
        let mut bus = replay(
            "R: AA 08 2\n;     1.0 -> 01 02\nR: AA 08 2\n;     2.0 failed: not acknowledged; is the gauge \
             powered and connected?\nR: AA 08 2\n;     3.0 -> 03 04\nR: AA 08 2\n;     4.0 failed: the bus \
             timed out; a line is held low or the clock stretched too long\n",
        );
        assert_eq!(ask(&mut bus, &[8], 2), Ok(vec![1, 2]));
        assert_eq!(ask(&mut bus, &[8], 2), Err(BusError::NoAck));
        assert_eq!(ask(&mut bus, &[8], 2), Ok(vec![3, 4]));
        assert_eq!(ask(&mut bus, &[8], 2), Err(BusError::Timeout));
        assert_eq!(ask(&mut bus, &[8], 2), Ok(vec![3, 4]));
        assert_eq!(ask(&mut bus, &[9], 1), Ok(vec![4]));
        assert_eq!(ask(&mut bus, &[9], 2), Err(BusError::NoAck));
        assert!(bus.covers(8, 2) && !bus.covers(8, 3));
    }

    #[test]
    fn the_answer_of_a_command_code_is_its_own_and_may_be_read_shorter() {
        let text = "; gaugefs: sbs on /dev/i2c-1 address 0x0c, 2026-01-01T00:00:00Z\n\
                    R: 18 09 3\n; 1.0 -> 6B 2C CD\nR: 18 09 3\n; 2.0 -> 6C 2C D8\nR: 18 0B 2\n; 1.0 failed: not \
                    acknowledged; is the gauge powered and connected?\n";
        let recording = Recording::parse(text).expect("a recording");
        let seals = Seals { commands: [0; 2], status: None };
        let mut bus = Replay::new(&recording, First::Code, seals, Box::new(|_| Vec::new()));
        assert_eq!(bus.address(), Some(0x0c));
        assert!(bus.covers(0x09, 2) && bus.covers(0x09, 3) && !bus.covers(0x09, 4) && !bus.covers(0x0a, 1));
        assert!(bus.covers(0x0b, 2), "it was asked for");
        assert_eq!(ask(&mut bus, &[0x09], 2), Ok(vec![0x6b, 0x2c]));
        assert_eq!(ask(&mut bus, &[0x09], 3), Ok(vec![0x6c, 0x2c, 0xd8]));
        assert_eq!(ask(&mut bus, &[0x09], 4), Err(BusError::NotRecorded));
        assert_eq!(ask(&mut bus, &[0x0a], 1), Err(BusError::NoAck), "it is no part of word 0x09");
        assert_eq!(ask(&mut bus, &[0x0b], 2), Err(BusError::NoAck));
        assert_eq!(ask(&mut bus, &[0x03, 0x00, 0x80], 0), Err(BusError::ReadOnly));
    }

    /// A recording of a version that did not ask for it.
    #[test]
    fn what_was_selected_is_shown_unless_the_recording_shows_something_else() {
        let block = "R: AA 40 1\n; 1.0 -> 07\n";
        let mut bus = replay(&format!("W: AA 3E 30 00\n; 1.0 ok\n{block}"));
        assert_eq!(ask(&mut bus, &[0x3e, 0x30, 0x01], 0), Ok(vec![]));
        assert_eq!(ask(&mut bus, &[0x3e], 2), Ok(vec![0x30, 0x01]));
        assert_eq!(ask(&mut bus, &[0x3e], 3), Err(BusError::NoAck));
        let mut bus = replay(&format!("W: AA 3E 30 00\n; 1.0 ok\nR: AA 3E 2\n; 1.0 -> 30 02\n{block}"));
        assert_eq!(ask(&mut bus, &[0x3e, 0x30, 0x00], 0), Ok(vec![]));
        assert_eq!(ask(&mut bus, &[0x3e], 2), Ok(vec![0x30, 0x02]));
    }

    #[test]
    fn an_answer_depends_on_the_writes_before_it() {
        let mut bus = replay(
            "W: AA 00 01 00\n; 1.0 ok\nR: AA 00 2\n; 1.0 -> 00 01\nW: AA 00 00 00\n; 1.0 ok\nR: AA 00 2\n; 1.0 \
             -> 00 60\n; hidden\n; hidden\nW: AA 00 00 00\n; 1.0 ok\nR: AA 00 2\n; 1.0 -> 00 40\nW: AA 3E 30 \
             00\n; 1.0 ok\nR: AA 3E 3\n; 1.0 -> 30 00 07\nW: AA 00 20 00\n; 1.0 ok\n",
        );
        for _ in 0..2 {
            assert_eq!(ask(&mut bus, &[0, 0, 0], 0), Ok(vec![]));
            assert_eq!(ask(&mut bus, &[0], 2), Ok(vec![0x00, 0x60]));
            assert_eq!(ask(&mut bus, &[0, 1, 0], 0), Ok(vec![]));
            assert_eq!(ask(&mut bus, &[0], 2), Ok(vec![0x00, 0x01]));
            assert_eq!(ask(&mut bus, &[0, 2, 0], 0), Ok(vec![]));
            assert_eq!(ask(&mut bus, &[0], 2), Err(BusError::NotRecorded));
            // While the gauge is sealed, the data window has no answer.
            assert_eq!(ask(&mut bus, &[0x3e, 0x30, 0x00], 0), Ok(vec![]));
            assert_eq!(ask(&mut bus, &[0x3e], 3), Err(BusError::NotRecorded));
            bus.set_secret(true);
            assert_eq!(ask(&mut bus, &[0, 0x34, 0x12], 0), Ok(vec![]));
            bus.set_secret(false);
            // Writing one byte per transfer has the same effect.
            assert_eq!(ask(&mut bus, &[0, 0], 0), Ok(vec![]));
            assert_eq!(ask(&mut bus, &[1, 0], 0), Ok(vec![]));
            assert_eq!(ask(&mut bus, &[0], 2), Ok(vec![0x00, 0x40]));
            assert_eq!(ask(&mut bus, &[0x3e, 0x30, 0x00], 0), Ok(vec![]));
            assert_eq!(ask(&mut bus, &[0x3e], 3), Ok(vec![0x30, 0x00, 0x07]));
            assert_eq!(ask(&mut bus, &[0x3e, 0x30, 0x01], 0), Ok(vec![]));
            assert_eq!(ask(&mut bus, &[0x3e], 3), Err(BusError::NotRecorded));
            assert_eq!(ask(&mut bus, &[0, 0x20, 0x00], 0), Ok(vec![]));
        }
    }

    #[test]
    fn writes_are_refused_and_keys_too_if_the_gauge_was_never_unsealed() {
        let mut bus = replay("R: AA 08 2\n;     1.0 -> 01 02\n");
        for write in [&[0x40, 1][..], &[0x3e, 0x30, 0x00, 0x55], &[0x60, 0xff], &[0x02, 1, 2]] {
            assert_eq!(ask(&mut bus, write, 0), Err(BusError::ReadOnly));
        }
        bus.set_secret(true);
        assert_eq!(ask(&mut bus, &[0, 0x14, 0x04], 0), Err(BusError::NotRecorded));
    }

    #[test]
    fn regression_invalid_files_are_refused_with_the_line() {
        let error = |text: &str| {
            let error = Recording::parse(text).err().expect("not a recording");
            assert_eq!(error.kind, ErrorKind::Invalid);
            error.to_string()
        };
        assert!(error("").starts_with("line 1: it does not name a gauge; only a file that --trace"));
        assert!(error("W: AA 00 01 00\n").starts_with("line 1: "));
        let in_line_3 = |line: &str| error(&format!("{HEAD}{line}\n"));
        assert!(in_line_3("X: 100").starts_with("line 3: neither a transfer"));
        assert!(in_line_3("R: AA zz 2").starts_with("line 3: not a transfer"));
        assert!(in_line_3("R: AA 08 2\n; 1.0 -> 01").starts_with("line 4: not a result"));
        assert!(in_line_3("R: AA 08 2\n; hello").starts_with("line 4: not a result"));
        // Lines that were cut, or edited.
        for line in [
            "R: AA 08",
            "R: AA",
            "R:",
            "R: AA 8 2",
            "R: AA +8 2",
            "R: AA 08 +2",
            "W: AA 0 01",
            "W: AA 00 1 R: 2",
        ] {
            assert!(in_line_3(&format!("{line}\n; 1.0 ok")).starts_with("line 3: not a transfer"), "{line}");
        }
        for line in ["-> 01 2", "-> 01 +2", "->", "failed: "] {
            assert!(
                in_line_3(&format!("R: AA 08 2\n; 1.0 {line}")).starts_with("line 4: not a result"),
                "{line}"
            );
        }
        assert!(in_line_3("W: AA 00 00 00\nR: AA 08 2").starts_with("line 3: the transfer has no result"));
        // An interrupted recording ends with its last complete transfer.
        let mut cut = replay("R: AA 08 2\n; 1.0 -> 01 02\nR: AA 0A 2\n; 1.0 -> 0");
        assert_eq!(ask(&mut cut, &[8], 2), Ok(vec![1, 2]));
        assert_eq!(ask(&mut cut, &[10], 2), Err(BusError::NoAck));
    }
}
