// SPDX-License-Identifier: MIT

//! An image for ROM mode, `.df.fs` or `.bq.fs`, as its parameters.
//!
//! TI's tools export one for parts such as the bq34z100-G1. Its commands erase and write flash past the firmware;
//! interrupted, they leave a gauge in ROM mode. So it is never sent: its rows of data flash become parameters.

use super::{Command, DEVICE_TYPE, FW_VERSION, GAUGE, ROM, ROM_MODE, identity};
use crate::chip::{CHIPS, Chip, Kind, RomImage, Subclass};
use crate::codec::WINDOW;
use crate::error::{Cause, Error, Result};
use crate::image::target::versions;
use crate::image::{Chemistry, Faults, Group, Image, LeftOut, Raw, at_line, cut_short};
use crate::notation;
use crate::value::{Type, Value};

const ROW: usize = 32;
const ROWS: usize = 32;
/// Rows with the vectors and the firmware's version. A file of data flash erases them first and writes them last.
const BOOT_ROWS: usize = 2;
const INSTRUCTION_ROW: usize = 100;
/// Index of the firmware's version in the command for row 0 of instruction flash, low byte first.
const VERSION: usize = 52;
const COMMAND: u8 = 0x00;
/// Register for an answer of four or two bytes.
const ANSWER: u8 = 0x04;
/// Register for the sum of a command's bytes, which executes it.
const EXECUTE: u8 = 0x64;
const STATUS: u8 = 0x66;
const CONTROL: u8 = 0x00;
const DATA_ROW: u8 = 0x0a;
const ERASE: [u8; 5] = [0x00, 0x00, 0x00, 0x83, 0xde];
/// Lifetime data: the history of the image's original pack.
const LIFETIME: [u8; 2] = [59, 60];

pub(super) fn is_one(commands: &[(usize, Command)]) -> bool {
    let writes = |command: &Command| match command {
        Command::Write { address: ROM, register: COMMAND, bytes } => bytes[0] == DATA_ROW,
        _ => false,
    };
    commands.iter().any(|(_, command)| writes(command))
}

pub(super) fn read(
    commands: &[(usize, Command)],
    told: Option<&'static Chip>,
    faults: &mut Faults,
) -> Option<Image> {
    let mut rom = Rom::default();
    for (line, command) in commands {
        let Err(why) = rom.take(*line, command) else { continue };
        faults.at(*line, why);
        rom.doubt();
    }
    // Missing parts of a whole file may follow from a wrong line.
    if !faults.is_empty() {
        return None;
    }
    faults.keep(0, content(rom, commands, told))
}

fn content(rom: Rom, commands: &[(usize, Command)], told: Option<&'static Chip>) -> Result<Image> {
    let content = rom.finish()?;
    let (device_type, checked) = identity(commands);
    let firmware = match (content.firmware, checked) {
        (Some((_, one)), Some((line, other))) if one != other => {
            let why = format!("firmware 0x{other:04x} is checked, but the rows are of 0x{one:04x}");
            return Err(at_line(line, why));
        }
        (one, other) => one.or(other).map(|(_, code)| code),
    };
    let (chip, layout, places) = content.chip(told, device_type.map(|(_, code)| code), firmware)?;
    let mut image = Image::new(chip, firmware);
    image.names_chip = firmware.is_some();
    let sum = layout.chemistry_sum.map(|at| Chemistry::Sum(content.word(at)));
    image.chemistry = Some(sum.unwrap_or(Chemistry::Unknown));
    image.firmware_line = content.whole_firmware;
    content.fill_image(&mut image, layout, places);
    content.fill_notes(&mut image);
    Ok(image)
}

#[derive(Default)]
struct Rom {
    /// The bytes of a command before its execution, and its line.
    buffer: Vec<u8>,
    last: Vec<u8>,
    /// The last line of an unexecuted command.
    pending: Option<usize>,
    rows: Vec<(usize, [u8; ROW])>,
    is_erased: bool,
    is_checked: bool,
    has_left: bool,
    firmware: Option<(usize, u16)>,
    instruction_rows: usize,
    whole_firmware: Option<usize>,
    unchecked: usize,
    keys: Option<usize>,
    /// A wrong line leaves the unexecuted command unknown.
    in_doubt: bool,
    /// For that reason, rows may be missing or wrong.
    is_partial: bool,
}

impl Rom {
    fn take(&mut self, line: usize, command: &Command) -> Result<(), String> {
        match command {
            Command::Wait(_) => Ok(()),
            Command::Unread => {
                self.doubt();
                Ok(())
            }
            Command::Write { address, .. } | Command::Compare { address, .. } | Command::Read { address }
                if ![GAUGE, ROM].contains(address) =>
            {
                Err(format!(
                    "address 0x{address:02x} is neither the gauge's, which is AA, nor that of ROM mode"
                ))
            }
            Command::Read { .. } => Ok(()),
            Command::Write { address: ROM, .. } if self.has_left => Err("ROM mode has been left".into()),
            Command::Write { address: ROM, register: EXECUTE, bytes } => self.execute(line, bytes),
            Command::Write { address: ROM, register, bytes } => self.fill(line, *register, bytes),
            Command::Compare { address: ROM, register: STATUS, bytes } if bytes[..] == [0] => Ok(()),
            Command::Compare { address: ROM, register: ANSWER, bytes } => self.compare(bytes),
            Command::Compare { address: ROM, .. } => Err("this answer is not one of ROM mode".into()),
            Command::Write { register: CONTROL, bytes, .. } if bytes.len() % 2 == 0 => {
                let word = u16::from_le_bytes([bytes[0], bytes[1]]);
                if ![ROM_MODE, DEVICE_TYPE, FW_VERSION].contains(&word) {
                    self.keys.get_or_insert(line);
                }
                Ok(())
            }
            Command::Compare { .. } => Ok(()),
            Command::Write { .. } => Err("a file for ROM mode that also writes in normal mode".into()),
        }
    }

    fn doubt(&mut self) {
        self.buffer.clear();
        self.pending = None;
        (self.in_doubt, self.is_partial) = (true, true);
    }

    /// Hosts with small buffers write a command in pieces.
    fn fill(&mut self, line: usize, register: u8, bytes: &[u8]) -> Result<(), String> {
        if register == COMMAND {
            if let Some(line) = self.pending {
                return Err(format!("the command of line {line} is not executed by a sum"));
            }
            self.buffer.clear();
            self.in_doubt = false;
        }
        if self.in_doubt {
            return Ok(());
        }
        if usize::from(register) != self.buffer.len() {
            return Err(format!("register 0x{register:02x} does not continue a command of ROM mode"));
        }
        self.buffer.extend(bytes);
        self.pending = Some(line);
        Ok(())
    }

    fn execute(&mut self, line: usize, sum: &[u8]) -> Result<(), String> {
        if self.in_doubt {
            return Ok(());
        }
        let command = std::mem::take(&mut self.buffer);
        if self.pending.take().is_none() {
            return Err("a sum without a command of ROM mode".into());
        }
        let [low, high] = sum else { return Err("a sum of ROM mode has two bytes".into()) };
        let (told, sum) = (u16::from_le_bytes([*low, *high]), sum16(&command));
        if told != sum {
            return Err(format!("sum 0x{told:04x}, but the bytes give 0x{sum:04x}"));
        }
        match command.as_slice() {
            // Erase the first page of instruction flash, compute a sum, write the last row of instruction flash.
            [0x03, 0, 0] | [0x05 | 0x08] | [0x01, 0, 0, 0x05, _, _, _] => {}
            [0x0f] => self.has_left = true,
            [0x04, rest @ ..] if *rest == ERASE => {
                self.whole_firmware.get_or_insert(line);
            }
            [0x0c, rest @ ..] if *rest == ERASE => {
                self.is_erased = true;
                self.rows.clear();
            }
            [0x02, low, high, 0, data @ ..] if data.len() + 4 == INSTRUCTION_ROW => {
                let row = usize::from(u16::from_le_bytes([*low, *high]));
                self.instruction_rows += 1;
                if row == 0 {
                    let version = u16::from_le_bytes([command[VERSION], command[VERSION + 1]]);
                    self.firmware = Some((line, version));
                }
                if row >= BOOT_ROWS {
                    self.whole_firmware.get_or_insert(line);
                }
            }
            [DATA_ROW, row, 0, 0, data @ ..] if data.len() == ROW => {
                let is_next = usize::from(*row) == self.rows.len() && self.rows.len() != ROWS;
                if !is_next && !self.is_partial {
                    return Err(format!("row {row} of data flash, but row {} is next", self.rows.len()));
                }
                let data = <[u8; ROW]>::try_from(data).expect("its length was compared");
                self.rows.push((line, data));
                self.is_checked = false;
            }
            [code, ..] => {
                return Err(format!(
                    "0x{code:02x} with {} bytes is no known command of ROM mode",
                    command.len()
                ));
            }
            [] => return Err("an empty command of ROM mode".into()),
        }
        self.last = command;
        Ok(())
    }

    fn compare(&mut self, told: &[u8]) -> Result<(), String> {
        if self.is_partial {
            return Ok(());
        }
        match (self.last.as_slice(), told) {
            ([0x08], [low, high]) => {
                let (told, sum) = (u16::from_le_bytes([*low, *high]), sum16(&self.bytes()));
                if told != sum {
                    return Err(format!(
                        "sum 0x{told:04x} of data flash is expected, but its rows give 0x{sum:04x}"
                    ));
                }
                self.is_checked = true;
            }
            // The sum of all instruction flash, most of which is not in the file.
            ([0x05], [_, _, _, _]) => self.unchecked += 1,
            _ => return Err("an answer that the command before does not give".into()),
        }
        Ok(())
    }

    fn bytes(&self) -> Vec<u8> {
        self.rows.iter().flat_map(|(_, row)| *row).collect()
    }

    fn finish(self) -> Result<Self> {
        if let Some(line) = self.pending {
            return Err(at_line(line, "this command is not executed by a sum; the file is cut short"));
        }
        if self.rows.is_empty() {
            return Err(Error::new("", Cause::Invalid, "it writes no data flash"));
        }
        if self.rows.len() != ROWS {
            return Err(cut_short(format_args!("{} rows of data flash instead of {ROWS}", self.rows.len())));
        }
        if !self.has_left {
            return Err(cut_short("ROM mode is not left"));
        }
        Ok(self)
    }

    fn chip(
        &self,
        told: Option<&'static Chip>,
        device_type: Option<u16>,
        firmware: Option<u16>,
    ) -> Result<(&'static Chip, &'static RomImage, Places)> {
        let invalid = |why: String| Err(Error::new("", Cause::Invalid, why));
        let chips = CHIPS.iter().copied().filter(|chip| told.is_none_or(|told| std::ptr::eq(*chip, told)));
        let known: Vec<_> = chips.filter_map(|chip| Some((chip, chip.rom_image.as_ref()?))).collect();
        let is_of = |chip: &Chip| {
            device_type.is_none_or(|code| code == chip.identity.device_type)
                && firmware.is_none_or(|code| chip.identity.firmware.contains(&code))
        };
        let of_firmware: Vec<_> = known.iter().copied().filter(|(chip, _)| is_of(chip)).collect();
        let names = || versions(&known.iter().map(|(chip, _)| *chip).collect::<Vec<_>>());
        let Some((first, _)) = of_firmware.first() else {
            let code = |code: Option<u16>| code.map_or("unknown".into(), |code| format!("0x{code:04x}"));
            return invalid(format!(
                "it is for ROM mode, of device type {} and firmware {}; gaugefs knows a {}",
                code(device_type),
                code(firmware),
                names()
            ));
        };
        let layouts = of_firmware.iter().flat_map(|&(chip, image)| {
            let of_file =
                image.layouts.iter().filter(move |(code, _)| firmware.is_none_or(|one| one == *code));
            of_file.map(move |&(_, places)| (chip, image, places))
        });
        let fitting: Vec<_> = layouts.filter(|&(chip, _, places)| self.fits(chip, places)).collect();
        match fitting.as_slice() {
            [one] => Ok(*one),
            [] => invalid(format!("its data flash is not laid out as that of a {}", first.model)),
            _ => invalid(format!("it may be for a {}; choose with --chip", names())),
        }
    }

    fn fits(&self, chip: &'static Chip, places: Places) -> bool {
        let bytes = self.bytes();
        placed(chip, places).all(|(subclass, start)| {
            subclass.parameters.iter().all(|row| {
                let at = usize::from(start + row.offset);
                let stored = &bytes[at..at + row.kind.size()];
                match (row.kind, chip.layout.decode(row.kind, stored)) {
                    (Type::S(size), value) => {
                        let is_text = stored[0] < size
                            && stored[1..=usize::from(stored[0])]
                                .iter()
                                .all(|byte| (0x20..0x7f).contains(byte));
                        is_text && matches!(value, Value::Text(_))
                    }
                    (kind, value) if row.name == "Number of series cell" => {
                        notation::parse(row, notation::render(kind, &value).as_bytes()).is_ok()
                    }
                    _ => true,
                }
            })
        })
    }

    fn word(&self, at: u16) -> u16 {
        let (bytes, at) = (self.bytes(), usize::from(at));
        u16::from_be_bytes([bytes[at], bytes[at + 1]])
    }

    fn line(&self, at: usize) -> usize {
        self.rows[at / ROW].0
    }

    fn fill_image(&self, image: &mut Image, layout: &RomImage, places: Places) {
        let bytes = self.bytes();
        let mut is_named = [false; ROW * ROWS];
        for (subclass, start) in placed(image.chip, places) {
            let (start, length) = (usize::from(start), usize::from(subclass.length));
            is_named[start..start + length].fill(true);
            let line = self.line(start);
            if subclass.kind == Kind::Security {
                image.leave_out(line, "keys; left out", Some(Group::Keys));
                continue;
            }
            if LIFETIME.contains(&subclass.id) {
                let why = format!("{}: the history of another pack; left out", subclass.name);
                image.leave_out(line, why, Some(Group::Learned));
                continue;
            }
            let mut is_parameter = vec![false; length];
            for row in subclass.parameters {
                let (from, size) = (usize::from(row.offset), row.kind.size());
                is_parameter[from..from + size].fill(true);
                let at = start + from;
                let value = image.chip.layout.decode(row.kind, &bytes[at..at + size]);
                image.add(subclass, row, value, self.line(at));
            }
            for offset in (0..length).filter(|&offset| !is_parameter[offset]) {
                let (line, byte) = (self.line(start + offset), bytes[start + offset]);
                let new_block = offset % WINDOW == 0;
                let offset = offset as u16;
                match image.raw.last_mut() {
                    Some(raw) if raw.line == line && !new_block && raw.ends_before(subclass.id, offset) => {
                        raw.bytes.push(byte);
                    }
                    _ => image.raw.push(Raw { subclass: subclass.id, offset, bytes: vec![byte], line }),
                }
            }
        }
        super::by_line(&mut image.raw);
        let chemistry = usize::from(layout.chemistry.0)..usize::from(layout.chemistry.1);
        let others =
            is_named.iter().enumerate().filter(|(at, named)| !**named && !chemistry.contains(at)).count();
        let what = [
            (chemistry.len(), "of the chemistry, which only TI's tools program"),
            (others, "outside of every subclass that a manual names"),
        ];
        for (count, what) in what {
            let text = format!("{count} bytes {what}; left out");
            image.left_out.push(LeftOut { text, group: Some(Group::Undocumented) });
        }
    }

    fn fill_notes(&self, image: &mut Image) {
        if let Some(line) = self.keys {
            image.notes.push(format!("line {line}: key words; an import uses the keys of the mount"));
        }
        image.notes.push(format!(
            "{ROWS} rows of data flash, whose sums are right; an import writes them in normal mode"
        ));
        if !self.is_erased {
            let why = "it writes data flash without erasing it, so a player may leave a mixture of old and new; an \
                       import writes its values";
            image.notes.push(why.into());
        }
        if !self.is_checked {
            image.notes.push("the sum of all its rows is not compared at its end".into());
        }
        if self.instruction_rows > 0 {
            image
                .notes
                .push(format!("{} rows of firmware; an import does not write them", self.instruction_rows));
        }
        if self.unchecked > 0 {
            let count = self.unchecked;
            let sums = if count == 1 { "sum" } else { "sums" };
            image.notes.push(format!(
                "{count} {sums} of firmware not checked: most of its bytes are not in the file"
            ));
        }
        image.notes.push(match image.chemistry {
            Some(Chemistry::Sum(sum)) => {
                format!("the chemistry's checksum is 0x{sum:04x}; an import compares it with the gauge's")
            }
            _ => "its chemistry has no checksum that a gauge's could be compared with".into(),
        });
    }
}

/// Subclasses by id, and the index of their first byte.
type Places = &'static [(u8, u16)];

fn placed(chip: &'static Chip, places: Places) -> impl Iterator<Item = (&'static Subclass, u16)> {
    places.iter().filter_map(|&(id, start)| Some((chip.subclass(id)?, start)))
}

fn sum16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |sum, byte| sum.wrapping_add(u16::from(*byte)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Data flash in which only names, number of cells and Cell Terminate Voltage are there. The places are from the
    /// manual's order of subclasses, and not from the tables.
    fn flash(is_r2: bool) -> [u8; ROW * ROWS] {
        let mut bytes = [0; ROW * ROWS];
        let mut put = |at: usize, what: &[u8]| bytes[at..at + what.len()].copy_from_slice(what);
        let (names, cells) = if is_r2 { (640, 459) } else { (633, 454) };
        put(names, b"\x0bbq34z100-G1");
        put(names + 12, b"\x0bTexas Inst.");
        put(names + 24, b"\x04LION");
        put(cells, &[4]);
        // IT Cfg begins at 85.
        put(85 + 53, &3100u16.to_be_bytes());
        // Keys, behind Current Thresholds.
        put(if is_r2 { 487 } else { 482 }, &[0x36, 0x72, 0x04, 0x14]);
        put(if is_r2 { 605 } else { 600 }, &[0x12, 0x34]);
        bytes
    }

    fn command(bytes: &[u8], wait: u32) -> String {
        let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!(" {byte:02X}")).collect::<String>();
        let sum: u16 = bytes.iter().map(|&byte| u16::from(byte)).sum();
        let sum = hex(&sum.to_le_bytes());
        format!("W: 16 00{}\nW: 16 64{sum}\nX: {wait}\nC: 16 66 00\n", hex(bytes))
    }

    /// A file as TI's tools write it, with so many rows of instruction flash.
    fn file(flash: &[u8], version: u16, rows: u8) -> String {
        let mut text = String::from("W: AA 00 14 04\nW: AA 00 72 36\nX: 1000\nW: AA 00 00 0F\nX: 1000\n");
        text += &command(&[0x03, 0, 0], 20);
        for row in 0..rows {
            let mut bytes = [0xff; 100];
            bytes[..4].copy_from_slice(&[0x02, row, 0, 0]);
            bytes[52..54].copy_from_slice(&version.to_le_bytes());
            text += &command(&bytes, 2);
        }
        text += &command(&[0x05], 170);
        text += "C: 16 04 B5 44 6A D4\n";
        text += &command(&[0x0c, 0, 0, 0, 0x83, 0xde], 200);
        for (row, bytes) in (0..).zip(flash.chunks(ROW)) {
            text += &command(&[&[0x0a, row, 0, 0], bytes].concat(), 2);
        }
        text += &command(&[0x08], 2);
        let [low, high] = sum16(flash).to_le_bytes();
        text += &format!("C: 16 04 {low:02X} {high:02X}\n");
        text += &command(&[0x01, 0, 0, 0x05, 0x54, 0x54, 0x15], 20);
        text + &command(&[0x0f], 4000).replace("C: 16 66 00\n", "")
    }

    fn error(text: &str) -> String {
        Image::parse(text, None).map(|_| ()).expect_err("an error").to_string()
    }

    #[test]
    fn rows_of_data_flash_are_read_as_parameters_of_their_part() {
        for (is_r2, version, name) in [(false, 0x0016, "bq34z100-g1"), (true, 0x0202, "bq34z100-r2")] {
            let image = Image::parse(&file(&flash(is_r2), version, 2), None).expect("an image");
            assert_eq!((image.chip.name, image.firmware), (name, Some(version)));
            assert!(image.names_chip && image.firmware_line.is_none());
            assert_eq!(image.chemistry, Some(Chemistry::Sum(0x1234)));
            let entry = image.entries.iter().find(|entry| entry.parameter.name == "Cell Terminate Voltage");
            let entry = entry.expect("it is there");
            // After five lines and one of an answer, nine commands of four lines and the second line of row 4.
            assert_eq!((entry.text(), entry.line), ("3100".into(), 5 + 1 + 9 * 4 + 2));
            let text = |name: &str| {
                image.entries.iter().find(|entry| entry.parameter.name == name).expect("a name").text()
            };
            assert_eq!(
                (text("Device Chemistry"), text("Number of series cell")),
                ("LION".into(), "4".into())
            );
            // No key, in no form, and nothing of another pack's history.
            assert!(image.entries.iter().all(|entry| ![112, 59, 60].contains(&entry.subclass.id)));
            assert!(image.raw.iter().all(|raw| ![112, 59, 60].contains(&raw.subclass)));
            let told: Vec<_> = image.left_out.iter().map(|left| left.text.as_str()).collect();
            let groups: Vec<_> = image.left_out.iter().map(|left| left.group).collect();
            let expected =
                [Group::Keys, Group::Learned, Group::Learned, Group::Undocumented, Group::Undocumented];
            assert_eq!(groups, expected.map(Some), "{told:?}");
            assert!(told[3].contains("of the chemistry"), "{told:?}");
            let shown = format!("{:?}{told:?}", image.notes);
            assert!(["1404", "0414", "3672", "14 04"].iter().all(|key| !shown.contains(key)), "{shown}");
            // Each byte is a parameter's, an undocumented one of a subclass, or counted.
            let count = |text: &str| -> usize {
                text.split(' ').next().expect("a number").parse().expect("a number")
            };
            let places = image.chip.rom_image.as_ref().expect("a layout").layouts[0].1;
            let lengths: u16 = placed(image.chip, places).map(|(subclass, _)| subclass.length).sum();
            assert_eq!(usize::from(lengths) + count(told[3]) + count(told[4]), ROW * ROWS);
        }
    }

    #[test]
    fn an_image_of_one_part_is_none_of_the_other() {
        let g1 = file(&flash(false), 0x0016, 2);
        let error_of = |text: &str, chip: &str| {
            Image::parse(text, Chip::by_name(chip)).map(|_| ()).expect_err("another part").to_string()
        };
        let why = "it is for ROM mode, of device type unknown and firmware 0x0016; gaugefs knows a bq34z100-R2 with firmware \
                   0x0202";
        assert_eq!(error_of(&g1, "bq34z100-r2"), why);
        let why = "its data flash is not laid out as that of a bq34z100-G1";
        assert_eq!(error(&file(&flash(true), 0x0016, 2)), why);
        let why = "it is for ROM mode, of device type unknown and firmware 0x0204; gaugefs knows a bq34z100-G1 with firmware \
                   0x0016 and a bq34z100-R2 with firmware 0x0202 and a bq27500 with firmware 0x0106 or 0x0120";
        assert_eq!(error(&file(&flash(true), 0x0204, 2)), why);
        // Of a part whose layout is not known the mode is the reason, and what is read of it instead is named.
        for chip in CHIPS.iter().filter(|chip| chip.rom_image.is_none()) {
            let why = error_of(&g1, chip.name);
            let instead = format!("use a .gm.fs or .gg.csv of a {}", chip.model);
            assert!(why.starts_with("line 4: Control(ROM_MODE)") && why.contains(&instead), "{why}");
        }
        // Without firmware the layout alone decides.
        let image = Image::parse(&file(&flash(true), 0, 0), None).expect("an image");
        assert_eq!((image.chip.name, image.firmware, image.names_chip), ("bq34z100-r2", None, false));
        let checked = "W: AA 00 02 00\nC: AA 00 02 02\n".to_string() + &g1;
        assert!(error(&checked).starts_with("line 2: firmware 0x0202 is checked"));
    }

    /// From class 68 on the older firmware has everything a byte before. The places are those of the stock images
    /// (github.com/buglabs/bq27500-update), and not from the table.
    #[test]
    fn rows_of_a_bq27500_are_read_by_its_firmware() {
        for (version, other, back) in [(0x0120, 0x0106, 0), (0x0106, 0x0120, 1)] {
            let mut flash = [0; ROW * ROWS];
            let mut put = |at: usize, what: &[u8]| flash[at..at + what.len()].copy_from_slice(what);
            put(0x8c + 48, &3000u16.to_be_bytes());
            put(0x1fd + 2, &4200u16.to_be_bytes());
            put(0x23c - back, &[0x36, 0x72, 0x04, 0x14]);
            put(0x268 - back, &550u16.to_be_bytes());
            put(0x27c - back + 10, &1340u16.to_be_bytes());
            put(0x27c - back + 12, b"\x07bq27500");
            let image = Image::parse(&file(&flash, version, 2), None).expect("an image");
            assert_eq!((image.chip.name, image.firmware), ("bq27500", Some(version)));
            assert_eq!(image.chemistry, Some(Chemistry::Unknown));
            for (name, value) in [
                ("Terminate Voltage", "3000"),
                ("Charging Voltage", "4200"),
                ("OT Chg", "550"),
                ("Design Capacity", "1340"),
                ("Device Name", "bq27500"),
            ] {
                let entry = image.entries.iter().find(|entry| entry.parameter.name == name);
                assert_eq!(entry.expect(name).text(), value, "{name} of 0x{version:04x}");
            }
            assert!(image.entries.iter().all(|entry| entry.subclass.id != 112));
            let why = "its data flash is not laid out as that of a bq27500";
            assert_eq!(error(&file(&flash, other, 2)), why);
            assert!(error(&file(&flash, 0x0130, 2)).contains("firmware 0x0130; gaugefs knows a"));
        }
    }

    #[test]
    fn firmware_is_taken_for_a_reason_to_refuse() {
        let image = Image::parse(&file(&flash(false), 0x0016, 3), None).expect("an image");
        let why = image.check_firmware(false).expect_err("firmware").to_string();
        assert!(why.starts_with("line 19: it also holds the gauge's firmware"), "{why}");
        image.check_firmware(true).expect("its data flash is asked for");
        let image = Image::parse(&file(&flash(false), 0x0016, 2), None).expect("an image");
        image.check_firmware(false).expect("the rows that every file has");
    }

    #[test]
    fn every_sum_is_checked() {
        let text = file(&flash(false), 0x0016, 2);
        let lines: Vec<&str> = text.lines().collect();
        let sums = lines.iter().enumerate().filter(|(_, line)| line.starts_with("W: 16 64"));
        let mut count = 0;
        for (at, line) in sums {
            let other = if line.ends_with("55") { "56" } else { "55" };
            let bent = format!("{}{other}", &line[..line.len() - 2]);
            let mut lines = lines.clone();
            lines[at] = &bent;
            let why = error(&(lines.join("\n") + "\n"));
            assert!(why.starts_with(&format!("line {}: sum 0x", at + 1)), "{why}");
            count += 1;
        }
        assert_eq!(count, 1 + 2 + 1 + 1 + 32 + 1 + 1 + 1);
        // A row that was changed together with its own sum.
        let mut other = flash(false);
        other[300] = 1;
        let other = file(&other, 0x0016, 2);
        let why = error(&other.replace(&total(&other), &total(&text)));
        assert!(why.contains("of data flash is expected, but its rows give"), "{why}");
    }

    #[test]
    fn a_part_of_a_file_is_refused() {
        let text = file(&flash(false), 0x0016, 2);
        let lines: Vec<&str> = text.lines().collect();
        // The last line is a wait, which nothing follows.
        for end in 0..lines.len() - 1 {
            let cut = lines[..end].join("\n");
            assert!(Image::parse(&cut, Chip::by_name("bq34z100-g1")).is_err(), "{end} lines are an image");
        }
        for (from, to, says) in [
            ("W: 16 00 0A 07", "W: 16 00 0A 08", "sum 0x"),
            ("W: 16 00 03 00 00\nW: 16 64 03 00", "W: 16 00 07 00 00\nW: 16 64 07 00", "no known command"),
            ("W: AA 00 00 0F", "W: AA 3E 44 00", "also writes in normal mode"),
            ("W: AA 00 14 04", "W: AC 00 14 04", "address 0xac is neither the gauge's"),
            ("C: 16 66 00", "C: 16 66 04", "is not one of ROM mode"),
            ("W: 16 64 03 00", "", "is not executed by a sum"),
        ] {
            let why = error(&text.replacen(from, to, 1));
            assert!(why.contains(says), "{from}: {why}");
        }
    }

    /// The line that compares the sum of all rows.
    fn total(text: &str) -> String {
        text.lines().rfind(|line| line.starts_with("C: 16 04")).expect("a sum").into()
    }

    /// As programs of hosts have them that keep only the rows: all are there, each with its sum.
    #[test]
    fn rows_that_are_not_erased_or_summed_are_read_and_noted() {
        let text = file(&flash(false), 0x0016, 2);
        let chip = Chip::by_name("bq34z100-g1");
        let whole = Image::parse(&text, chip).expect("a whole file");
        let bare = text
            .replacen("W: 16 00 0C 00 00 00 83 DE\nW: 16 64 6D 01", "", 1)
            .replace(&total(&text), "; no sum");
        let bare = Image::parse(&bare, chip).expect("all rows");
        assert!(!whole.entries.is_empty() && bare.entries.len() == whole.entries.len());
        let has = |image: &Image, says: &str| image.notes.iter().any(|note| note.contains(says));
        for says in ["without erasing it", "is not compared at its end"] {
            assert!(has(&bare, says) && !has(&whole, says), "{:?}", bare.notes);
        }
    }

    /// Hosts with small buffers split a row.
    #[test]
    fn a_command_in_pieces_is_one() {
        let text = file(&flash(false), 0x0016, 2);
        let row = text.lines().find(|line| line.starts_with("W: 16 00 0A 05")).expect("row 5");
        let bytes: Vec<&str> = row.split(' ').skip(3).collect();
        let pieces = format!("W: 16 00 {}\nW: 16 1D {}", bytes[..29].join(" "), bytes[29..].join(" "));
        let image = Image::parse(&text.replace(row, &pieces), None).expect("an image");
        assert_eq!(image.entries.len(), Image::parse(&text, None).expect("an image").entries.len());
        let why = error(&text.replace(row, &pieces.replace("W: 16 1D", "W: 16 1E")));
        assert!(why.ends_with("register 0x1e does not continue a command of ROM mode"), "{why}");
    }
}
