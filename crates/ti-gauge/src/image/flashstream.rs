// SPDX-License-Identifier: MIT

//! An image as FlashStream: a host's transfers to a gauge.
//!
//! A file is never replayed but interpreted: what a gauge would change becomes parameters, all else is refused by line.

use std::collections::{BTreeMap, BTreeSet};

use super::target::{chip_like, instead};
use super::{Faults, Format, Group, Image, Raw, Reading, at_line, check_count, is_written};
use crate::chip::{CHIPS, Chip, Effect, FLAT, Kind, Parameter, SIBLINGS, Scheme, Subclass};
use crate::codec::{MAC_OVERHEAD, WINDOW, checksum, mac_sum};

mod romimage;
use crate::error::{Cause, Error, Result};

/// The gauge's address in FlashStream: shifted left by one.
pub(crate) const GAUGE: u8 = 0xaa;
pub(crate) const ROM: u8 = 0x16;
/// Control(ROM_MODE) of every gauge of the family.
pub(super) const ROM_MODE: u16 = 0x0f00;
pub(super) const DEVICE_TYPE: u16 = 0x0001;
pub(super) const FW_VERSION: u16 = 0x0002;
const SET_CFGUPDATE: u16 = 0x0013;
const SOFT_RESET: u16 = 0x0042;
const EXIT_CFGUPDATE: u16 = 0x0043;
const EXIT_RESIM: u16 = 0x0044;
/// Enters CONFIG UPDATE on parts with ManufacturerAccessControl().
const ENTER_CFG_UPDATE: u16 = 0x0090;
const EXIT_CFG_UPDATE_REINIT: u16 = 0x0091;
const EXIT_CFG_UPDATE: u16 = 0x0092;
/// The source of data memory in RAM on such parts: one-time programmable memory, at addresses that are no subcommands.
const ONE_TIME: std::ops::RangeInclusive<u16> = 0x4000..=0x4fff;
const CONTROL: u8 = 0x00;
/// DataFlashClass() and DataFlashBlock(), or ManufacturerAccessControl().
const SELECT: u8 = 0x3e;
/// BlockData(), or MACData().
const DATA: u8 = 0x40;
/// BlockDataChecksum(), or MACDataSum().
const SUM: u8 = 0x60;
/// BlockDataControl(), or MACDataLen().
const LENGTH: u8 = 0x61;
/// The comment that names the chip, because device type and firmware do not distinguish all chips.
const CHIP_LINE: &str = "; gaugefs chip";
/// The comment with the number of commands, because the format has no end mark.
const COUNT_LINE: &str = "; gaugefs commands";
/// Bytes of a row after the register: TI's tools write at most 96 after the row's four in ROM mode.
const LONGEST: usize = 100;
/// bqStudio's value for device type and firmware after reading the wrong register.
const NOT_READ: u16 = 0xffa5;

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Command {
    Write {
        address: u8,
        register: u8,
        bytes: Vec<u8>,
    },
    Compare {
        address: u8,
        register: u8,
        bytes: Vec<u8>,
    },
    Read {
        address: u8,
    },
    /// For at least this time, in milliseconds.
    Wait(u32),
    /// One or more lines that are no commands. [`commands`] refuses them.
    Unread,
}

pub(crate) fn commands(text: &str) -> Result<Vec<(usize, Command)>> {
    let mut commands = Vec::new();
    for_each_line(text, |number, command| {
        commands.push((number, command.map_err(|why| at_line(number, why))?));
        Ok(())
    })?;
    Ok(commands)
}

fn for_each_line(
    text: &str,
    mut act: impl FnMut(usize, Result<Command, String>) -> Result<()>,
) -> Result<()> {
    let text = text.replace("\r\n", "\n").replace('\r', "\n");
    for (number, line) in (1..).zip(text.lines()) {
        // Tools write comments on separate lines, people also after a command.
        let line = line.split(';').next().unwrap_or_default().trim();
        if !line.is_empty() {
            act(number, command(line))?;
        }
    }
    Ok(())
}

/// Whether the first line shows that the file was meant as a FlashStream, although it is no command.
pub(super) fn is_meant(line: &str) -> bool {
    let line = line.split(';').next().unwrap_or_default().trim();
    let after_letter =
        line.strip_prefix(['W', 'C', 'R', 'w', 'c', 'r']).filter(|rest| rest.starts_with([' ', '\t']));
    is_record(line) || after_letter.is_some_and(is_hex) || (is_hex(line) && line.len() > 4)
}

fn is_hex(text: &str) -> bool {
    let words = || text.split_ascii_whitespace().map(|word| word.strip_prefix("0x").unwrap_or(word));
    let is_even =
        |word: &str| word.len().is_multiple_of(2) && word.bytes().all(|digit| digit.is_ascii_hexdigit());
    words().next().is_some() && words().all(is_even)
}

fn is_record(line: &str) -> bool {
    let rest = match line.strip_prefix(':') {
        None => line.strip_prefix('S').filter(|rest| rest.starts_with(|digit: char| digit.is_ascii_digit())),
        rest => rest,
    };
    rest.is_some_and(|rest| rest.len() >= 9 && rest.bytes().all(|digit| digit.is_ascii_hexdigit()))
}

/// A file for HDQ has no addresses.
const NO_ADDRESS: &str = "no address before the register, as in a file for HDQ; gaugefs reads files for I2C, in which \
                          the gauge's address is AA, as in W: AA 3E 50 01";
fn is_register(byte: u8) -> bool {
    // 0x55 is the gauge's address without the shift.
    matches!(byte, CONTROL | SELECT | 0x3f | DATA..=LENGTH) && byte != 0x55
}

fn command(line: &str) -> Result<Command, String> {
    // The line is not repeated: it may contain key words.
    if is_record(line) {
        return Err(format!(
            "a record of an Intel HEX or S-record file, which holds a memory and not what is sent to a gauge; {}",
            instead(None)
        ));
    }
    let Some((letter, rest)) = line.split_once(':') else {
        return Err(match is_hex(line) {
            true => {
                "bytes without a command before them; write W: if a host sends them, as in W: AA 3E 50 01"
                    .into()
            }
            false => "not a line of a FlashStream; they begin with W:, C:, R:, X: or ;".into(),
        });
    };
    if letter.trim().eq_ignore_ascii_case("X") {
        let decimal = rest.trim().parse::<u32>();
        return decimal.map(Command::Wait).map_err(|_| "X: needs a number of milliseconds".into());
    }
    if !["W", "C", "R"].iter().any(|known| letter.trim().eq_ignore_ascii_case(known)) {
        return Err("not a command of a FlashStream; they are W:, C:, R: and X:".into());
    }
    let bytes: Option<Vec<u8>> = rest.split_ascii_whitespace().map(byte).collect();
    let Some(bytes) = bytes else {
        let words = || rest.split_ascii_whitespace();
        let what = match is_hex(rest) {
            true if words().any(|word| word.starts_with("0x")) => "a number with 0x; ",
            true => "packed hexadecimal: bytes without spaces between them; ",
            false if words().any(|word| word.contains(',')) => "numbers with commas between them; ",
            false => "",
        };
        return Err(format!(
            "{what}expected bytes of two hexadecimal digits, separated by spaces, as in W: AA 3E 50 01"
        ));
    };
    let [address, register, ref data @ ..] = bytes[..] else {
        return Err("expected an address, a register and at least one byte".into());
    };
    if data.is_empty() {
        return Err(match is_register(address) {
            true => NO_ADDRESS.into(),
            false => "expected an address, a register and at least one byte".into(),
        });
    }
    if data.len() > LONGEST {
        return Err(format!("{} bytes, but a row holds at most {LONGEST}", data.len()));
    }
    let bytes = data.to_vec();
    match letter.trim() {
        "W" | "w" => Ok(Command::Write { address, register, bytes }),
        "C" | "c" => Ok(Command::Compare { address, register, bytes }),
        _ => Ok(Command::Read { address }),
    }
}

fn byte(digits: &str) -> Option<u8> {
    let two = digits.len() == 2 && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
    two.then(|| u8::from_str_radix(digits, 16).ok()).flatten()
}

/// Reads what a FlashStream would change.
pub fn parse(text: &str, told: Option<&'static Chip>) -> Result<Image> {
    let mut faults = Faults::default();
    let image = read(text, told, &mut faults);
    Reading { image, faults }.whole()
}

pub(super) fn read(text: &str, told: Option<&'static Chip>, faults: &mut Faults) -> Option<Image> {
    let (mut commands, mut count) = (Vec::new(), 0);
    let read = for_each_line(text, |number, command| {
        count += 1;
        match command {
            Ok(command) => commands.push((number, command)),
            Err(why) => {
                faults.at(number, why);
                if !matches!(commands.last(), Some((_, Command::Unread))) {
                    commands.push((number, Command::Unread));
                }
            }
        }
        Ok(())
    });
    faults.keep(0, read)?;
    if romimage::is_one(&commands) && told.is_none_or(|chip| chip.rom_image.is_some()) {
        return romimage::read(&commands, told, faults);
    }
    check_addresses(&commands, told, faults)?;
    let mark = |mark: &str| text.lines().find_map(|line| line.trim().strip_prefix(mark));
    let written = mark(COUNT_LINE).and_then(|count| count.trim().parse().ok());
    faults.keep(0, check_count(text, written, count, "commands"));
    let named = mark(CHIP_LINE);
    let named = named.and_then(|name| Chip::by_name(name.trim()));
    if let (Some(named), Some(told)) = (named, told)
        && !std::ptr::eq(named, told)
    {
        let why = format!("it is for a {}, not for a {}", named.model, told.model);
        return faults.stop(1, at_line(1, why));
    }
    let (device_type, firmware) = identity(&commands);
    let codes = (device_type.map(|(_, code)| code), firmware.map(|(_, code)| code));
    let is_flat = commands.iter().any(|(_, command)| sets_length(command));
    let is_blocks = !is_flat && commands.iter().any(|(_, command)| sets_sum(command));
    let is_like = |chip: &Chip| if chip.access.scheme.is_flat() { !is_blocks } else { !is_flat };
    let chip = match (chip_like(named.or(told), codes.0, codes.1, is_like), device_type) {
        (Ok(chip), _) => chip,
        (Err(error), Some((number, _))) => {
            // Other mistakes in a file for another gauge do not matter.
            *faults = Faults::default();
            return faults.stop(number, error.within(&format!("line {number}")));
        }
        // An unreadable line may be the one that says so.
        (Err(_), None) if !faults.is_empty() => return None,
        (Err(error), None) => return faults.stop(0, error),
    };
    let mut image = Image::new(chip, codes.1);
    image.names_chip = named.is_some() || codes.0.is_some();
    let mut stream = Stream::new(chip);
    stream.run(&commands, faults);
    stream.into_image(&mut image, faults);
    match (device_type, firmware) {
        (Some((one, _)), Some((other, _))) => {
            image.notes.insert(0, format!("device type and firmware are checked in lines {one} and {other}"));
        }
        _ => image.notes.insert(0, "device type and firmware are not both checked by the file".into()),
    }
    Some(image)
}

fn sets_length(command: &Command) -> bool {
    let Command::Write { address: GAUGE, register, bytes } = command else { return false };
    let at = usize::from(LENGTH).checked_sub((*register).into());
    *register >= DATA && at.and_then(|at| bytes.get(at)).is_some_and(|byte| *byte != 0)
}

fn sets_sum(command: &Command) -> bool {
    matches!(command, Command::Write { address: GAUGE, register: SUM, .. })
}

/// Checks that all commands are for the gauge. A file for ROM mode is not read any further.
fn check_addresses(
    commands: &[(usize, Command)],
    told: Option<&'static Chip>,
    faults: &mut Faults,
) -> Option<()> {
    let of_file = || {
        let (_, code) = identity(commands).0?;
        let own = CHIPS.iter().copied().find(|chip| chip.identity.device_type == code && chip.is_proven());
        own.or_else(|| SIBLINGS.iter().find(|sibling| sibling.identity.device_type == code)?.like)
    };
    let mut is_for_gauge = false;
    for (number, command) in commands {
        let address = match command {
            Command::Write { address, .. } | Command::Compare { address, .. } | Command::Read { address } => {
                *address
            }
            Command::Wait(_) | Command::Unread => continue,
        };
        let why = match (address, command) {
            (GAUGE, Command::Write { register: CONTROL | SELECT, bytes, .. })
                if bytes[..] == ROM_MODE.to_le_bytes() =>
            {
                format!(
                    "Control(ROM_MODE): the rest writes flash row by row, bypassing or replacing the gauge's firmware, \
                     which gaugefs never does; {}",
                    instead(told.or_else(of_file))
                )
            }
            (ROM | 0x0b, _) => {
                "address 0x16 is the gauge in ROM mode, which gaugefs never uses: it would replace firmware"
                    .into()
            }
            (GAUGE, _) => {
                is_for_gauge = true;
                continue;
            }
            (other, _) => {
                let is_hdq = is_register(other) && !matches!(command, Command::Read { .. });
                let why = format!("address 0x{other:02x} is not the gauge's, which is AA");
                faults.at(*number, if is_hdq { NO_ADDRESS.into() } else { why });
                continue;
            }
        };
        faults.end_at(*number);
        return faults.stop(*number, at_line(*number, why));
    }
    if !is_for_gauge {
        faults.unite();
    }
    Some(())
}

pub(super) type Expected = Option<(usize, u16)>;

pub(crate) fn identity(commands: &[(usize, Command)]) -> (Expected, Expected) {
    let word = |bytes: &[u8]| u16::from_le_bytes([bytes[0], bytes[1]]);
    let told = |(line, word): (usize, u16)| Some((line, word)).filter(|_| word != NOT_READ);
    let device_type = answer(commands, DEVICE_TYPE).map(|(line, bytes)| (line, word(bytes)));
    match answer(commands, FW_VERSION) {
        // MACData() returns both at once, most significant byte first, before other data.
        Some((line, &[a, b, c, d, ..])) => {
            let (kind, version) = (u16::from_be_bytes([a, b]), u16::from_be_bytes([c, d]));
            (told((line, kind)).or(device_type), told((line, version)))
        }
        Some((line, bytes)) => (device_type, Some((line, word(bytes)))),
        None => (device_type, None),
    }
}

fn answer(commands: &[(usize, Command)], code: u16) -> Option<(usize, &[u8])> {
    let asks = |command: &Command| match command {
        Command::Write { register: CONTROL | SELECT, bytes, .. } => bytes[..] == code.to_le_bytes(),
        _ => false,
    };
    let at = commands.iter().position(|(_, command)| asks(command))?;
    let (number, next) =
        commands[at + 1..].iter().find(|(_, command)| !matches!(command, Command::Wait(_)))?;
    match next {
        // The echo of ManufacturerAccessControl() comes first.
        Command::Compare { register: SELECT, bytes, .. } if bytes.len() >= 4 => Some((*number, &bytes[2..])),
        Command::Compare { register: CONTROL | DATA, bytes, .. } if bytes.len() >= 2 => {
            Some((*number, bytes))
        }
        _ => None,
    }
}

struct Stream {
    chip: &'static Chip,
    class: Option<u8>,
    block: u8,
    address: Option<u16>,
    window: BTreeMap<u8, u8>,
    sum: u8,
    /// The line of uncommitted bytes in the window.
    pending: Option<usize>,
    half_key: bool,
    /// A wrong line leaves the selection or the window unknown.
    in_doubt: bool,
    /// Bytes that such lines may have set.
    doubtful: BTreeSet<(u8, u16)>,
    unread: bool,
    /// A mistake before the current line that does not prevent reading it.
    missed: Option<String>,
    /// The line that entered CONFIG UPDATE, until another one leaves it.
    update: Option<usize>,
    /// Data flash by subclass and offset: each byte and its line.
    stored: BTreeMap<(u8, u16), (u8, usize)>,
    sums: BTreeMap<(u8, u8), u8>,
    /// Lines whose sum covers bytes that the file does not set.
    unchecked: Vec<usize>,
    notes: Vec<String>,
    /// Lines that an import does not carry out, with reason and group.
    left_out: Vec<(usize, String, Option<Group>)>,
}

impl Stream {
    fn new(chip: &'static Chip) -> Self {
        Self {
            chip,
            class: None,
            block: 0,
            address: None,
            window: BTreeMap::new(),
            sum: 0,
            pending: None,
            half_key: false,
            in_doubt: false,
            doubtful: BTreeSet::new(),
            unread: false,
            missed: None,
            update: None,
            stored: BTreeMap::new(),
            sums: BTreeMap::new(),
            unchecked: Vec::new(),
            notes: Vec::new(),
            left_out: Vec::new(),
        }
    }

    fn run(&mut self, commands: &[(usize, Command)], faults: &mut Faults) {
        for (at, (number, command)) in commands.iter().enumerate() {
            let outcome = match command {
                Command::Write { address: GAUGE, register, bytes } => {
                    let next = commands.get(at + 1).map(|(_, next)| next);
                    self.write(*number, *register, bytes, next)
                }
                Command::Compare { address: GAUGE, register, bytes } => self.compare(*register, bytes),
                Command::Write { .. } | Command::Unread => {
                    self.unread = true;
                    self.doubt();
                    Ok(())
                }
                Command::Compare { .. } | Command::Read { .. } | Command::Wait(_) => Ok(()),
            };
            if let Some(why) = self.missed.take() {
                faults.at(*number, why);
            }
            if let Err(why) = outcome {
                faults.at(*number, why);
                self.doubt();
            }
        }
        if let Some(number) = self.pending {
            faults.at(number, "these bytes are never committed by a checksum");
        }
        // An unreadable line may be the one that leaves it.
        if let Some(number) = self.update
            && !self.unread
        {
            let why = "CONFIG UPDATE is entered, and no SOFT_RESET leaves it; the file is cut short";
            faults.at(number, why);
        }
    }

    fn is_mac(&self) -> bool {
        self.chip.access.scheme.is_flat()
    }

    fn write(
        &mut self,
        line: usize,
        register: u8,
        bytes: &[u8],
        next: Option<&Command>,
    ) -> Result<(), String> {
        let mut from = register;
        let mut bytes = bytes;
        if register == CONTROL || (register == SELECT && self.is_mac()) {
            let [low, high, rest @ ..] = bytes else {
                return Err("half a word; gaugefs only reads words that are written in one line".into());
            };
            let word = u16::from_le_bytes([*low, *high]);
            if register == SELECT && (self.is_flash(word) || self.is_one_time(word)) {
                self.select(true);
                self.address = Some(word);
                (from, bytes) = (DATA, rest);
            } else {
                return self.control(line, word, rest, next);
            }
        }
        for (at, &byte) in bytes.iter().enumerate() {
            let register = usize::from(from) + at;
            match u8::try_from(register).unwrap_or(u8::MAX) {
                SELECT if !self.is_mac() => {
                    self.select(true);
                    (self.class, self.block) = (Some(byte), 0);
                }
                0x3f if !self.is_mac() => {
                    self.select(false);
                    self.block = byte;
                }
                register @ DATA..SUM => {
                    self.window.insert(register - DATA, byte);
                    self.pending = Some(line);
                }
                SUM if self.is_mac() => self.sum = byte,
                LENGTH if self.is_mac() => self.commit_mac(line, byte)?,
                SUM => self.commit_block(line, byte)?,
                LENGTH if byte == 0 => {}
                LENGTH => return Err("BlockDataControl() other than 0 does not select data flash".into()),
                _ => return Err(format!("register 0x{register:02x} does not configure a gauge")),
            }
        }
        Ok(())
    }

    /// Whether a word is an address from the first to the last documented byte of a flat data flash.
    fn is_flash(&self, word: u16) -> bool {
        let flat = || self.chip.subclasses.iter().filter(|subclass| subclass.id == FLAT);
        let first = flat().map(Subclass::start).min();
        let last = flat().map(|subclass| subclass.start() + (subclass.length - 1)).max();
        first.zip(last).is_some_and(|(first, last)| (first..=last).contains(&word))
    }

    fn is_one_time(&self, word: u16) -> bool {
        self.chip.access.scheme == Scheme::MacUpdate && ONE_TIME.contains(&word)
    }

    /// Selects anew. A complete selection makes an earlier wrong line harmless.
    fn select(&mut self, all: bool) {
        if let Some(line) = self.pending.take() {
            let why = format!("the bytes of line {line} are not committed before the next block is selected");
            self.missed = Some(why);
        }
        self.in_doubt &= !all;
        self.window.clear();
    }

    fn doubt(&mut self) {
        self.in_doubt = true;
        self.pending = None;
    }

    fn forget(&mut self, selected: Option<(u8, u16)>, length: u16) {
        self.window.clear();
        let Some((subclass, start)) = selected else { return };
        for place in (start..).take(length.into()).map(|offset| (subclass, offset)) {
            self.stored.remove(&place);
            self.doubtful.insert(place);
        }
    }

    /// A word for Control(). Key words are never shown, even in an error.
    fn control(&mut self, line: usize, word: u16, rest: &[u8], next: Option<&Command>) -> Result<(), String> {
        if self.pending.is_none() {
            self.address = None;
        }
        if std::mem::take(&mut self.half_key) && rest.is_empty() {
            return Ok(());
        }
        let Some(subcommand) = self.chip.subcommand(word) else {
            let second = |bytes: &[u8]| bytes.len() == 2;
            let follows = matches!(next, Some(Command::Write { register: CONTROL | SELECT, bytes, .. }) if second(bytes));
            let pair = second(rest) || rest.is_empty() && follows;
            // The other word may be in an unreadable line.
            let half = rest.is_empty() && (self.in_doubt || matches!(next, Some(Command::Unread)));
            if half {
                return Ok(());
            }
            if !pair {
                let model = self.chip.model;
                return Err(format!("neither a subcommand of a {model} nor a pair of key words (not shown)"));
            }
            self.half_key = rest.is_empty();
            self.notes.push(format!("line {line}: key words; an import uses the keys of the mount"));
            return Ok(());
        };
        if !rest.is_empty() {
            return Err(format!("more than a word for {}", subcommand.name));
        }
        let update = config_update(self.chip.access.scheme);
        let enters = update.is_some_and(|(enter, _)| word == enter);
        let leaves = update.is_some_and(|(_, leave)| leave.contains(&word));
        if enters {
            self.update = Some(line);
        } else if leaves || word == self.chip.access.resets {
            self.update = None;
        }
        match subcommand.effect {
            Effect::Never if word == self.chip.access.resets => {
                self.notes.push(format!("line {line}: {}; never sent to this part", subcommand.name));
                Ok(())
            }
            Effect::Never => Err(format!("{}: gaugefs never sends it", subcommand.name)),
            Effect::Answers => Ok(()),
            Effect::Guarded
                if enters || leaves || [self.chip.access.resets, self.chip.security.seal].contains(&word) =>
            {
                self.notes.push(format!("line {line}: {}; an import does it by itself", subcommand.name));
                Ok(())
            }
            Effect::Safe | Effect::Guarded => {
                self.left_out.push((line, format!("{}; an import does not send it", subcommand.name), None));
                Ok(())
            }
        }
    }

    fn commit_block(&mut self, line: usize, sum: u8) -> Result<(), String> {
        let Some(class) = self.class else {
            if self.in_doubt {
                return Ok(());
            }
            return Err("a checksum before any subclass is selected".into());
        };
        let start = u16::from(self.block) * WINDOW as u16;
        if self.in_doubt {
            self.sums.remove(&(class, self.block));
            self.forget(Some((class, start)), WINDOW as u16);
            return Ok(());
        }
        self.pending = None;
        let window = std::mem::take(&mut self.window);
        let mut checked = Ok(());
        if window.len() == WINDOW {
            let bytes: Vec<u8> = window.values().copied().collect();
            checked = check_sum(sum, checksum(&bytes));
        } else {
            self.unchecked.push(line);
        }
        self.sums.insert((class, self.block), sum);
        if let Some(subclass) = self.chip.subclass(class) {
            if subclass.kind == Kind::Security {
                self.left_out.push((line, "keys; left out".into(), Some(Group::Keys)));
                return checked;
            }
            if usize::from(self.block) * WINDOW >= usize::from(subclass.stored()) {
                let last = (subclass.stored() - 1) / WINDOW as u16;
                return Err(format!("block {} of subclass {class}, whose last block is {last}", self.block));
            }
        }
        for (at, byte) in window {
            self.store(class, start + u16::from(at), byte, line);
        }
        checked
    }

    fn commit_mac(&mut self, line: usize, length: u8) -> Result<(), String> {
        if self.in_doubt {
            let length = u16::from(length.saturating_sub(MAC_OVERHEAD as u8));
            self.forget(self.address.map(|address| (FLAT, address)), length);
            return Ok(());
        }
        let Some(address) = self.address else { return Err("MACDataLen() before any address".into()) };
        self.pending = None;
        let window = std::mem::take(&mut self.window);
        let whole = window.keys().copied().eq(0..window.len() as u8);
        if !whole || usize::from(length) != window.len() + MAC_OVERHEAD {
            let want = window.len() + MAC_OVERHEAD;
            return Err(format!(
                "MACDataLen() is {length} instead of {want}; a gauge would discard the bytes"
            ));
        }
        let bytes: Vec<u8> = window.into_values().collect();
        let checked = check_sum(self.sum, mac_sum(address, &bytes));
        if self.is_one_time(address) {
            let why = format!(
                "0x{address:04x}: {} of one-time programmable memory, which gaugefs never writes",
                counted(bytes.len())
            );
            self.left_out.push((line, why, Some(Group::Undocumented)));
            return checked;
        }
        for (at, byte) in (0u16..).zip(bytes) {
            let address = address.checked_add(at).ok_or("beyond the last address")?;
            let within = |subclass: &&Subclass| {
                subclass.id == FLAT
                    && address >= subclass.start()
                    && address - subclass.start() < subclass.length
            };
            let mut at = self.chip.subclasses.iter().filter(within);
            if at.next().is_some_and(|subclass| subclass.kind == Kind::Security) {
                let keys = (line, "keys; left out".into(), Some(Group::Keys));
                if self.left_out.last() != Some(&keys) {
                    self.left_out.push(keys);
                }
            } else {
                self.store(FLAT, address, byte, line);
            }
        }
        checked
    }

    /// Stores a byte that a line commits. The later of two lines counts, as on a gauge.
    fn store(&mut self, subclass: u8, offset: u16, byte: u8, line: usize) {
        let before = self.stored.insert((subclass, offset), (byte, line));
        let Some((_, first)) = before.filter(|(old, first)| *first != line && *old != byte) else { return };
        let of_id = self.chip.subclasses.iter().filter(|row| row.id == subclass);
        let mut rows = of_id.flat_map(|class| class.parameters.iter().map(move |row| (class, row)));
        let holds = |row: &Parameter| (row.offset..).take(row.kind.size()).any(|at| at == offset);
        let name = match rows.find(|(_, row)| holds(row)) {
            Some((class, row)) => self.chip.name_of((class, row)),
            None => format!("{subclass}/{offset}"),
        };
        let note = format!("line {line}: {name} has another value in line {first}; the later one counts");
        if !self.notes.contains(&note) {
            self.notes.push(note);
        }
    }

    /// A comparison that a player would fail, because the file itself has written something else.
    fn compare(&self, register: u8, bytes: &[u8]) -> Result<(), String> {
        if self.in_doubt {
            return Ok(());
        }
        let selected = match (self.is_mac(), self.address, self.class) {
            (true, Some(address), _) => (FLAT, address, address.to_le_bytes()),
            (false, _, Some(class)) => (class, u16::from(self.block) * WINDOW as u16, [class, self.block]),
            _ => return Ok(()),
        };
        let (subclass, start, selection) = selected;
        let (register, bytes) = match (register, bytes) {
            (SELECT, [low, high, rest @ ..]) if [*low, *high] == selection => (DATA, rest),
            (DATA..=SUM, bytes) => (register, bytes),
            _ => return Ok(()),
        };
        for (register, &told) in (register..=SUM).zip(bytes) {
            let wrote = match register {
                SUM if self.is_mac() => None,
                SUM => self.sums.get(&(subclass, self.block)).copied(),
                _ => start
                    .checked_add(u16::from(register - DATA))
                    .and_then(|offset| self.stored.get(&(subclass, offset)))
                    .map(|(byte, _)| *byte),
            };
            if let Some(wrote) = wrote.filter(|wrote| *wrote != told) {
                let what =
                    if register == SUM { "checksum".into() } else { format!("register 0x{register:02x} =") };
                return Err(format!("{what} 0x{told:02x} is expected, but the file wrote 0x{wrote:02x}"));
            }
        }
        Ok(())
    }

    fn into_image(mut self, image: &mut Image, faults: &mut Faults) {
        for subclass in self.chip.subclasses {
            for parameter in subclass.parameters {
                let offsets = parameter.offset..parameter.offset + parameter.kind.size() as u16;
                let found: Vec<_> =
                    offsets.clone().filter_map(|offset| self.stored.remove(&(subclass.id, offset))).collect();
                let Some(&(_, line)) = found.first() else { continue };
                if found.len() < parameter.kind.size() {
                    let block = |offset: u16| usize::from(offset) / WINDOW;
                    let is_in_two = block(parameter.offset) != block(offsets.end - 1);
                    let is_doubtful =
                        offsets.clone().any(|offset| self.doubtful.contains(&(subclass.id, offset)));
                    if !(is_doubtful || is_in_two && self.unread) {
                        faults.at(line, format!("{}: only part of it is written", parameter.name));
                    }
                    continue;
                }
                let bytes: Vec<u8> = found.iter().map(|(byte, _)| *byte).collect();
                let value = image.chip.layout.decode(parameter.kind, &bytes);
                image.add(subclass, parameter, value, line);
            }
        }
        image.notes.append(&mut self.notes);
        if !self.unchecked.is_empty() {
            let (what, which) = if self.unchecked.len() == 1 {
                ("line", "checksum covers")
            } else {
                ("lines", "checksums cover")
            };
            let lines: Vec<_> = self.unchecked.iter().map(usize::to_string).collect();
            let lines = lines.join(", ");
            image
                .notes
                .push(format!("{what} {lines}: not checked: the {which} bytes that the file does not set"));
        }
        for (line, why, group) in self.left_out {
            image.leave_out(line, why, group);
        }
        for ((subclass, offset), (byte, line)) in self.stored {
            match image.raw.last_mut() {
                Some(raw) if raw.line == line && raw.ends_before(subclass, offset) => raw.bytes.push(byte),
                _ => image.raw.push(Raw { subclass, offset, bytes: vec![byte], line }),
            }
        }
        by_line(&mut image.raw);
    }
}

fn by_line(raw: &mut [Raw]) {
    raw.sort_by_key(|raw| raw.line);
}

fn counted(bytes: usize) -> String {
    if bytes == 1 { "1 byte".into() } else { format!("{bytes} bytes") }
}

fn check_sum(told: u8, sum: u8) -> Result<(), String> {
    if told == sum {
        return Ok(());
    }
    Err(format!("checksum 0x{told:02x}, but the bytes give 0x{sum:02x}; a gauge would discard them"))
}

/// The image as text. `raw` returns a subclass's bytes: undocumented bytes are written as they are.
pub fn write(image: &Image, raw: impl Fn(u8) -> Result<Vec<u8>>) -> Result<String> {
    let chip = image.chip;
    let access = &chip.access;
    let update = config_update(access.scheme);
    let wait = |time: std::time::Duration| format!("X: {}\n", time.as_millis().max(5));
    let mut text = String::new();
    let device_type = chip.identity.device_type;
    let check = |code: u16, answer: &[u8]| {
        let ask = row('W', CONTROL, &code.to_le_bytes());
        ask + &wait(access.select) + &row('C', chip.identity.answer, answer)
    };
    text += &check(DEVICE_TYPE, &device_type.to_le_bytes());
    if let Some(firmware) = image.firmware {
        text += &match chip.identity.answers_in_mac_data() {
            false => check(FW_VERSION, &firmware.to_le_bytes()),
            true => check(FW_VERSION, [device_type, firmware].map(u16::to_be_bytes).as_flattened()),
        };
    }
    if let Some((enter, _)) = update {
        text += &row('W', CONTROL, &enter.to_le_bytes());
        text += &wait(access.enter.max(std::time::Duration::from_millis(1100)));
    }
    if access.scheme.is_flat() {
        for (address, bytes) in runs(image)? {
            let select = row('W', SELECT, &address.to_le_bytes()) + &wait(access.select);
            text += &select;
            text += &row('W', DATA, &bytes);
            text += &row('W', SUM, &[mac_sum(address, &bytes), (bytes.len() + MAC_OVERHEAD) as u8]);
            text += &wait(access.commit);
            text += &select;
            text += &row('C', DATA, &bytes);
        }
    } else {
        text += &row('W', LENGTH, &[0]);
        let has = |subclass: &Subclass| match subclass.is_opaque() {
            false => image.entries.iter().any(|entry| {
                std::ptr::eq(entry.subclass, subclass) && is_written(entry, Format::FlashStream)
            }),
            // Other bytes without parameters belong to a circuit.
            true => subclass.is_chemistry() && image.raw.iter().any(|raw| raw.subclass == subclass.id),
        };
        for subclass in chip.subclasses.iter().filter(|subclass| has(subclass)) {
            let id = subclass.id;
            text += &format!("; {}\n", chip.class_dir(subclass));
            for (block, bytes) in (0u8..).zip(raw(id)?.chunks(WINDOW)) {
                let mut window = [0; WINDOW];
                window[..bytes.len()].copy_from_slice(bytes);
                let select = row('W', SELECT, &[id, block]) + &wait(access.select);
                text += &select;
                text += &row('W', DATA, &window);
                text += &row('W', SUM, &[checksum(&window)]);
                text += &wait(access.commit);
                text += &select;
                text += &row('C', SUM, &[checksum(&window)]);
            }
        }
    }
    if !chip.is_never_reset() {
        let reset = update.and_then(|(_, leave)| leave.first()).unwrap_or(&access.resets);
        text += &row('W', CONTROL, &reset.to_le_bytes());
        text += &wait(access.reset_limit);
    }
    let count = text.lines().filter(|line| !line.starts_with(';')).count();
    let (model, name) = (chip.model, chip.name);
    let before = match access.scheme {
        Scheme::MacUpdate => "the gauge has to be in FULL ACCESS before it is sent",
        _ => "a gauge that is SEALED has to be unsealed before it is sent",
    };
    Ok(format!(
        "; {model} configuration, by gaugefs export\n{CHIP_LINE} {name}\n{COUNT_LINE} {count}\n\
         ; No key is in this file: {before}.\n{text}"
    ))
}

/// The subcommand that begins CONFIG UPDATE, and those that end it; `None` for a part with flash.
fn config_update(scheme: Scheme) -> Option<(u16, &'static [u16])> {
    match scheme {
        Scheme::Block | Scheme::Mac | Scheme::None | Scheme::Smbus => None,
        Scheme::CfgUpdate => Some((SET_CFGUPDATE, &[SOFT_RESET, EXIT_CFGUPDATE, EXIT_RESIM])),
        Scheme::MacUpdate => Some((ENTER_CFG_UPDATE, &[EXIT_CFG_UPDATE_REINIT, EXIT_CFG_UPDATE])),
    }
}

fn row(letter: char, register: u8, bytes: &[u8]) -> String {
    let bytes: String = bytes.iter().map(|byte| format!(" {byte:02X}")).collect();
    format!("{letter}: {GAUGE:02X} {register:02X}{bytes}\n")
}

/// Parameters of a flat data flash, joined where adjacent into runs of at most a window, without unproven ones.
fn runs(image: &Image) -> Result<Vec<(u16, Vec<u8>)>> {
    let mut entries: Vec<_> =
        image.entries.iter().filter(|entry| is_written(entry, Format::FlashStream)).collect();
    entries.sort_by_key(|entry| entry.parameter.offset);
    let mut runs: Vec<(u16, Vec<u8>)> = Vec::new();
    for entry in entries {
        let bytes = entry.bytes(image.chip).ok_or_else(|| {
            Error::new(entry.parameter.name, Cause::Invalid, "its value does not fit its type")
        })?;
        let offset = entry.parameter.offset;
        match runs.last_mut() {
            Some((start, run))
                if usize::from(offset - *start) == run.len() && run.len() + bytes.len() <= WINDOW =>
            {
                run.extend(bytes);
            }
            _ => runs.push((offset, bytes)),
        }
    }
    Ok(runs)
}

#[cfg(test)]
mod tests;
