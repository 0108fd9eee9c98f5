// SPDX-License-Identifier: MIT

//! ROM mode: a gauge without whole firmware answers at [`ROM_ADDRESS`] only, until a `.bq.fs` or `.bqfs` restores it.
//!
//! No manual describes the boot loader. Known from whole files for bq27510, bq27520-G3 and bq27520-G4, from arrays made of
//! files for bq34z100-G1 and bq34z100-R2, and from drivers that flash gauges; they agree:
//!
//! - A command is written to the buffer at 0x00: code, row in two bytes, and data from 0x04 on. The 16-bit sum of
//!   all bytes of the command, written to 0x64, starts it. Then 0x66 reads 0 if it was carried out.
//! - Instruction flash has 512 rows of 32 words of 24 bits, whose upper two are 0; erased it reads 0x3FFFFF. Data
//!   flash has 32 rows of 32 bytes. Both have a sum, which the gauge calculates and the file compares.
//! - Row 0 has a mark at word 5. Without it the gauge stays in ROM mode after a loss of power. A file writes it when all
//!   else is written, alone or with the rest of row 0. So the file can be started again from its first row whatever
//!   has interrupted it before.
//!
//! A file tells the firmware's version and the Device Name only, and the boot loader nothing: the user must know the part.

use std::time::Duration;

use crate::chip::{CHIPS, Chip, FirmwareFile};
use crate::error::{Cause, Error, Result};
use crate::image::at_line;
use crate::image::flashstream::{self, Command};
use crate::probe::ROM_ADDRESS;
use crate::text::printable;
use gauge_bus::clock::Clock;
use gauge_bus::{Bus, BusError};

mod apart;
mod beside;

pub use apart::{Device, device, find};
pub use beside::Beside;

const ROWS: usize = 512;
const ROW: usize = 96;
const DATA_ROWS: usize = 32;
const DATA_ROW: usize = 32;
const ERASED: [u8; 3] = [0xff, 0xff, 0x3f];
/// The mark of valid firmware in row 0: its word, its byte, and its value.
const MARK_WORD: u8 = 5;
const MARK_AT: usize = 15;
const MARK: [u8; 3] = [0x54, 0x54, 0x15];
/// Offset of the firmware's version in row 0, low byte first.
const VERSION_AT: usize = 48;
const MAGIC: [u8; 2] = [0x83, 0xde];
const SUM: u8 = 0x64;
const RESULT: u8 = 0x66;
const DATA: usize = 0x04;
/// The longest message: the register and a row in its command.
pub const LONGEST: usize = 1 + DATA + ROW;
/// Wait after an erase, beyond the file's 200 ms: files for later parts have 400 ms.
const ERASING: Duration = Duration::from_millis(200);
const FETCHING: Duration = Duration::from_millis(20);
const TRIES: usize = 5;
const PAUSE: Duration = Duration::from_millis(20);

/// How a part's firmware files are recognised; an error that says what else brings it back if that is not known.
pub fn check_part(chip: &Chip) -> Result<&FirmwareFile> {
    chip.firmware_file.as_ref().ok_or_else(|| {
        let why = format!(
            "in ROM mode {}. First switch its power off and on: whole firmware then starts by itself",
            chip.way_out_of_rom()
        );
        Error::new(chip.model, Cause::NotPermitted, why)
    })
}

/// The chips that a firmware file can restore, in words.
pub fn supported() -> String {
    let chips = CHIPS.iter().filter(|chip| chip.firmware_file.is_some());
    chips.map(|chip| chip.name).collect::<Vec<_>>().join(" or ")
}

mod code {
    pub(super) const READ_ROW: u8 = 0x00;
    pub(super) const WRITE_WORD: u8 = 0x01;
    pub(super) const WRITE_ROW: u8 = 0x02;
    pub(super) const ERASE: u8 = 0x04;
    pub(super) const INSTRUCTION_SUM: u8 = 0x05;
    pub(super) const DATA_SUM: u8 = 0x08;
    pub(super) const WRITE_DATA: u8 = 0x0a;
    pub(super) const ERASE_DATA: u8 = 0x0c;
    pub(super) const LEAVE: u8 = 0x0f;
}

type Row = [u8; ROW];

/// A completely checked firmware file.
#[derive(Debug)]
pub struct Firmware {
    /// The version of the firmware.
    pub version: u16,
    /// The Device Name in its data flash.
    pub name: String,
    steps: Vec<(usize, Step)>,
}

#[derive(Debug)]
enum Step {
    Write(u8, Vec<u8>),
    Compare(u8, Vec<u8>),
    Wait(Duration),
}

impl Firmware {
    /// Checks that a file is a chip's whole firmware, and can be interrupted anywhere.
    pub fn parse(text: &str, chip: &'static Chip) -> Result<Self> {
        let refuse = |why: String| Error::new("", Cause::Invalid, why);
        let known = check_part(chip)?;
        let commands = flashstream::commands(text)?;
        let (device_type, firmware) = flashstream::identity(&commands);
        if let Some((line, found)) = device_type.filter(|(_, found)| *found != chip.identity.device_type) {
            return Err(at_line(
                line,
                format!("it is for device type 0x{found:04x}, not for a {}", chip.model),
            ));
        }
        if let Some((line, found)) = firmware.filter(|(_, found)| !chip.identity.firmware.contains(found)) {
            return Err(at_line(
                line,
                format!("it expects firmware 0x{found:04x}, not that of a {}", chip.model),
            ));
        }
        let mut loader = Loader::default();
        let mut steps = Vec::new();
        for (line, command) in commands {
            let step = match command {
                // Entering ROM mode, and what follows it, do not concern a gauge that is in it.
                Command::Write { address: flashstream::GAUGE, .. }
                | Command::Compare { address: flashstream::GAUGE, .. }
                | Command::Read { address: flashstream::GAUGE } => continue,
                Command::Unread => continue,
                Command::Wait(_) if !loader.has_begun() => continue,
                Command::Wait(ms) => Step::Wait(Duration::from_millis(ms.into())),
                Command::Write { address: flashstream::ROM, register, bytes } => {
                    loader.write(register, &bytes).map_err(|why| at_line(line, why))?;
                    Step::Write(register, bytes)
                }
                Command::Compare { address: flashstream::ROM, register, bytes } => {
                    loader.compare(register, &bytes).map_err(|why| at_line(line, why))?;
                    Step::Compare(register, bytes)
                }
                Command::Write { address, .. }
                | Command::Compare { address, .. }
                | Command::Read { address } => {
                    return Err(at_line(
                        line,
                        format!("address 0x{address:02X} has no place in a firmware file"),
                    ));
                }
            };
            let erases = matches!(step, Step::Write(SUM, _)) && loader.erases();
            steps.push((line, step));
            if erases {
                steps.push((line, Step::Wait(ERASING)));
            }
        }
        loader.check_end().map_err(refuse)?;
        let version = loader.version();
        if !chip.identity.firmware.contains(&version) {
            return Err(refuse(format!(
                "it has firmware 0x{version:04x}, which is not that of a {}",
                chip.model
            )));
        }
        let name = loader.name(known, chip).map_err(refuse)?;
        Ok(Self { version, name, steps })
    }

    /// Checks the file against the gauge's firmware, without changes.
    pub fn check(&self, found: &Found) -> Result<()> {
        match found.version {
            Some(version) if version != self.version => {
                let why = format!(
                    "it has whole firmware of version 0x{version:04x}, and the file has 0x{:04x}; switch its power off \
                     and on, which starts its own firmware",
                    self.version
                );
                Err(Error::new("", Cause::Gone, why))
            }
            _ => Ok(()),
        }
    }

    /// Writes the file to a gauge in ROM mode, first row to last, and starts the firmware. `progress` gets the number
    /// of done steps, and of all.
    ///
    /// It ends at the first failed comparison. The gauge is then in ROM mode, or has the whole firmware.
    pub fn write(
        &self,
        bus: &mut dyn Bus,
        clock: &dyn Clock,
        progress: &mut dyn FnMut(usize, usize),
    ) -> Result<()> {
        for (done, (line, step)) in self.steps.iter().enumerate() {
            let failed = |error: Error| error.about(format!("line {line}"));
            match step {
                Step::Wait(time) => clock.sleep(*time),
                // The sum starts a command, which must not start twice.
                Step::Write(SUM, bytes) => {
                    bus.transfer(&[&[SUM], &bytes[..]].concat(), &mut [])
                        .map_err(|error| failed(error.into()))?;
                }
                Step::Write(register, bytes) => {
                    send(bus, clock, *register, bytes).map_err(|error| failed(error.into()))?;
                }
                Step::Compare(register, bytes) => compare(bus, clock, *register, bytes).map_err(failed)?,
            }
            progress(done + 1, self.steps.len());
        }
        Ok(())
    }
}

/// The contents of a gauge in ROM mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Found {
    /// Version of its firmware, if marked as whole.
    pub version: Option<u16>,
}

/// Whether a bus carries the messages of ROM mode. Nothing is sent.
pub fn check_reach(bus: &mut dyn Bus) -> Result<()> {
    let reach = bus.reach();
    if reach.carries(LONGEST, 0) && reach.carries(1, ROW) {
        return Ok(());
    }
    let error = BusError::TooLong { bytes: LONGEST as u16, most: reach.write.min(reach.read) };
    Err(Error::from(error).about("ROM mode"))
}

fn refuse_battery(bus: &mut dyn Bus, clock: &dyn Clock) -> Result<()> {
    let why = match device(bus, clock)? {
        Device::BootLoader => return Ok(()),
        Device::SmartBattery => {
            "a Smart Battery answers there, to which nothing was written; take it off the bus"
        }
        Device::Unclear => {
            "the device there does not read like the boot loader of a gauge, and may be a Smart Battery; nothing was \
             written to it. Switch the gauge's power off and on, with no other device on the bus"
        }
    };
    Err(Error::new("", Cause::Gone, why))
}

/// Reads row 0, which proves a gauge's boot loader, by a command: a Smart Battery is ruled out before. No change.
pub fn look(bus: &mut dyn Bus, clock: &dyn Clock) -> Result<Found> {
    check_reach(bus)?;
    let subject = || format!("address 0x{ROM_ADDRESS:02x}");
    refuse_battery(bus, clock).map_err(|error| error.about(subject()))?;
    let failed = |error: BusError| Error::from(error).about(subject());
    let mut row = [0; ROW];
    for _ in 0..TRIES {
        send(bus, clock, 0x00, &[code::READ_ROW, 0, 0, 0]).map_err(failed)?;
        send(bus, clock, SUM, &[0, 0]).map_err(failed)?;
        clock.sleep(FETCHING);
        let mut result = [0];
        fetch(bus, clock, RESULT, &mut result).map_err(failed)?;
        if result == [0] {
            fetch(bus, clock, DATA as u8, &mut row).map_err(failed)?;
            break;
        }
        // An interrupted command may have left bytes in the buffer, which spoil the next sum.
        clock.sleep(PAUSE);
    }
    let is_words = row.chunks(3).all(|word| word[2] & !ERASED[2] == 0);
    if !is_words || row.iter().all(|byte| *byte == row[0]) {
        let why = "the device there does not answer like the boot loader of a gauge; nothing was erased";
        return Err(Error::new(subject(), Cause::Gone, why));
    }
    let marked = row[MARK_AT..MARK_AT + 3] == MARK;
    Ok(Found { version: marked.then(|| version_of(&row)) })
}

/// Writes to the buffer without consequences, so it is repeated.
fn send(bus: &mut dyn Bus, clock: &dyn Clock, register: u8, bytes: &[u8]) -> Result<(), BusError> {
    let message = [&[register], bytes].concat();
    repeat(clock, || bus.transfer(&message, &mut []))
}

fn fetch(bus: &mut dyn Bus, clock: &dyn Clock, register: u8, into: &mut [u8]) -> Result<(), BusError> {
    repeat(clock, || bus.transfer(&[register], into))
}

fn repeat(clock: &dyn Clock, mut transfer: impl FnMut() -> Result<(), BusError>) -> Result<(), BusError> {
    let mut left = TRIES;
    loop {
        left -= 1;
        match transfer() {
            Err(error) if error.is_transient() && left > 0 => clock.sleep(PAUSE),
            result => return result,
        }
    }
}

/// Reads until the expected bytes come: a gauge may be slower than the file allows, and a bit may be misread.
fn compare(bus: &mut dyn Bus, clock: &dyn Clock, register: u8, expected: &[u8]) -> Result<()> {
    let mut found = vec![0; expected.len()];
    for _ in 0..TRIES {
        fetch(bus, clock, register, &mut found)?;
        if found == expected {
            return Ok(());
        }
        clock.sleep(PAUSE);
    }
    let why = match register {
        RESULT => format!("the gauge did not carry out the command; its result is 0x{:02x}", found[0]),
        _ => format!("the sum of what the gauge has is {}, not {}", hex(&found), hex(expected)),
    };
    Err(Error::new("", Cause::Protocol, why))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ")
}

fn version_of(row: &Row) -> u16 {
    u16::from_le_bytes([row[VERSION_AT], row[VERSION_AT + 1]])
}

struct Loader {
    buffer: [Option<u8>; SUM as usize],
    last: Option<u8>,
    /// It is not yet compared.
    unproven: bool,
    /// Rows of instruction flash; empty before it was erased.
    rows: Vec<Option<Row>>,
    data: Vec<Option<[u8; DATA_ROW]>>,
    summed: bool,
    data_summed: bool,
    marked: bool,
}

impl Default for Loader {
    fn default() -> Self {
        Self {
            buffer: [None; SUM as usize],
            last: None,
            unproven: false,
            rows: Vec::new(),
            data: Vec::new(),
            summed: false,
            data_summed: false,
            marked: false,
        }
    }
}

impl Loader {
    fn has_begun(&self) -> bool {
        self.last.is_some() || self.buffer.iter().any(Option::is_some)
    }

    fn erases(&self) -> bool {
        matches!(self.last, Some(code::ERASE | code::ERASE_DATA))
    }

    fn write(&mut self, register: u8, bytes: &[u8]) -> Result<(), String> {
        if self.last == Some(code::LEAVE) {
            return Err("it goes on after the gauge has left ROM mode".into());
        }
        if self.unproven {
            return Err("the command before it is not compared, so its failure would pass unnoticed".into());
        }
        let start = usize::from(register);
        if register == SUM {
            return self.execute(bytes);
        }
        let Some(part) = self.buffer.get_mut(start..start + bytes.len()) else {
            return Err(format!("0x{register:02X}: not within the buffer of the boot loader"));
        };
        for (place, byte) in part.iter_mut().zip(bytes) {
            *place = Some(*byte);
        }
        Ok(())
    }

    fn execute(&mut self, sum: &[u8]) -> Result<(), String> {
        let sent: Vec<u8> = self.buffer.iter().flatten().copied().collect();
        let all = sent.iter().fold(0_u16, |sum, byte| sum.wrapping_add((*byte).into()));
        if sum != all.to_le_bytes() {
            return Err("the sum of the row is wrong: it was changed".into());
        }
        let count = self.buffer.iter().rposition(Option::is_some).map_or(0, |last| last + 1);
        // A byte between the row and the data may be missing.
        let command: Vec<u8> = self.buffer[..count].iter().map(|byte| byte.unwrap_or(0)).collect();
        self.buffer.fill(None);
        let Some(&code) = command.first() else { return Err("a sum without a command".into()) };
        let row = command.get(1..3).map_or(0, |row| usize::from(u16::from_le_bytes([row[0], row[1]])));
        let data = command.get(DATA..).unwrap_or(&[]);
        let erases = row == 0 && data == MAGIC;
        if self.rows.is_empty() && code != code::ERASE {
            return Err(NOT_WHOLE.into());
        }
        if self.marked && !matches!(code, code::INSTRUCTION_SUM | code::DATA_SUM | code::LEAVE) {
            return Err(MARKED.into());
        }
        match code {
            code::ERASE if erases && self.rows.is_empty() => self.rows = vec![None; ROWS],
            code::ERASE_DATA if erases && self.data.is_empty() => self.data = vec![None; DATA_ROWS],
            code::WRITE_ROW => self.row(row, data)?,
            code::WRITE_DATA => {
                let place =
                    self.data.get_mut(row).ok_or("data flash has no such row, or is not erased yet")?;
                let data =
                    data.try_into().map_err(|_| format!("a row of data flash has {DATA_ROW} bytes"))?;
                if place.replace(data).is_some() {
                    return Err(format!("row {row} of data flash is written twice"));
                }
                self.data_summed = false;
            }
            code::WRITE_WORD if command[1..] == [0, 0, MARK_WORD, MARK[0], MARK[1], MARK[2]] => {
                self.mark()?
            }
            code::INSTRUCTION_SUM | code::DATA_SUM if command.len() == 1 => {}
            code::LEAVE if command.len() == 1 => self.check_whole()?,
            _ => {
                return Err(format!(
                    "0x{code:02X}: no command, or no form of one, that a firmware file is known to have"
                ));
            }
        }
        self.last = Some(code);
        self.unproven = code != code::LEAVE;
        Ok(())
    }

    fn row(&mut self, row: usize, data: &[u8]) -> Result<(), String> {
        let data: Row = data.try_into().map_err(|_| format!("a row of instruction flash has {ROW} bytes"))?;
        let place = self.rows.get_mut(row).ok_or_else(|| format!("instruction flash has no row {row}"))?;
        if place.replace(data).is_some() {
            return Err(format!("row {row} of instruction flash is written twice"));
        }
        self.summed = false;
        if row == 0 && data[MARK_AT..MARK_AT + 3] == MARK {
            self.marked = true;
            return self.check_written();
        }
        Ok(())
    }

    fn mark(&mut self) -> Result<(), String> {
        self.check_written()?;
        if !self.summed {
            return Err("it marks the firmware as whole before its sum is compared".into());
        }
        self.marked = true;
        let row = self.rows[0].as_mut().ok_or("row 0 is not written yet")?;
        row[MARK_AT..MARK_AT + 3].copy_from_slice(&MARK);
        Ok(())
    }

    /// Everything must be there before the firmware is marked as whole: later interruptions cannot be repaired.
    fn check_written(&self) -> Result<(), String> {
        let missing = |rows: usize| format!("it marks the firmware as whole while {rows} rows are missing");
        match self.rows.iter().filter(|row| row.is_none()).count() {
            0 => {}
            rows => return Err(missing(rows)),
        }
        match self.data.iter().filter(|row| row.is_none()).count() {
            0 if !self.data.is_empty() && self.data_summed => Ok(()),
            0 => Err("it marks the firmware as whole before the sum of data flash is compared".into()),
            rows => Err(missing(rows)),
        }
    }

    fn check_whole(&self) -> Result<(), String> {
        match self.marked && self.summed {
            true => Ok(()),
            false => {
                Err("it leaves ROM mode before the firmware is marked as whole and its sum compared".into())
            }
        }
    }

    fn compare(&mut self, register: u8, bytes: &[u8]) -> Result<(), String> {
        let sum = match self.last {
            Some(code::INSTRUCTION_SUM) => self.instruction_sum().to_le_bytes().to_vec(),
            Some(code::DATA_SUM) => self.data_sum().to_le_bytes().to_vec(),
            _ => Vec::new(),
        };
        match (register, bytes) {
            (RESULT, [0]) if self.last.is_some() => {}
            (RESULT, _) => return Err("a result other than 00 is a failure".into()),
            (register, bytes) if usize::from(register) == DATA && !sum.is_empty() => {
                if bytes != sum {
                    let what = if bytes.len() == 2 { "data" } else { "instruction" };
                    return Err(format!(
                        "the sum of {what} flash is wrong: rows are missing or were changed"
                    ));
                }
                match self.last {
                    Some(code::DATA_SUM) => self.data_summed = true,
                    _ => self.summed = true,
                }
            }
            _ => return Err("a comparison with something that is not known".into()),
        }
        self.unproven = false;
        Ok(())
    }

    fn instruction_sum(&self) -> u32 {
        let erased: Row = std::array::from_fn(|at| ERASED[at % 3]);
        let rows = self.rows.iter().map(|row| row.as_ref().unwrap_or(&erased));
        let words = rows.flat_map(|row| row.chunks(3));
        words.fold(0, |sum, word| sum.wrapping_add(u32::from_le_bytes([word[0], word[1], word[2], 0])))
    }

    fn data_sum(&self) -> u16 {
        let bytes = self.data.iter().flat_map(|row| row.unwrap_or([0xff; DATA_ROW]));
        bytes.fold(0, |sum, byte| sum.wrapping_add(byte.into()))
    }

    fn check_end(&self) -> Result<(), String> {
        match self.last {
            Some(code::LEAVE) => Ok(()),
            None => Err(NOT_WHOLE.into()),
            Some(_) => Err("its end, which leaves ROM mode, is missing; the file is cut short".into()),
        }
    }

    fn version(&self) -> u16 {
        self.rows[0].as_ref().map_or(0xffff, version_of)
    }

    /// The Device Name, which the chip must be able to have.
    fn name(&self, known: &FirmwareFile, chip: &Chip) -> Result<String, String> {
        let data: Vec<u8> = self.data.iter().flat_map(|row| row.unwrap_or([0xff; DATA_ROW])).collect();
        let length = usize::from(data[known.name]);
        let name = data.get(known.name + 1..known.name + 1 + length).unwrap_or(&[]);
        let is_text = (1..32).contains(&length) && name.iter().all(|byte| (b' '..=b'~').contains(byte));
        if !is_text {
            return Err(format!(
                "its data flash is not that of a {}: there is no Device Name in its place",
                chip.model
            ));
        }
        let name = printable(&String::from_utf8_lossy(name));
        // A user's own name tells nothing; TI's does.
        if name.to_lowercase().starts_with("bq")
            && !known.names.iter().any(|one| one.eq_ignore_ascii_case(&name))
        {
            return Err(format!("it is for a {name}, not for a {}", chip.model));
        }
        Ok(name)
    }
}

const NOT_WHOLE: &str = "it does not begin by erasing instruction flash, so it is not the whole firmware; a .df.fs has data \
                         flash only and does not bring back a gauge in ROM mode: it takes the .bq.fs of the same part";
const MARKED: &str = "it goes on writing after the firmware is marked as whole; if that were interrupted, the gauge \
                      would start with half of it";
