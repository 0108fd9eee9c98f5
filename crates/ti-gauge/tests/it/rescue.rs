// SPDX-License-Identifier: MIT

//! A gauge that is left in ROM mode is brought back by the whole of a firmware file, whatever interrupts that, and by
//! nothing less.

use std::sync::Arc;
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{AdapterModel, Bus, BusError, GAUGE_ADDRESS, Reach};
use gauge_sim::firmware::{self, Writer};
use gauge_sim::{Options, Sim};
use ti_gauge::chip::{CHIPS, Chip};
use ti_gauge::error::Cause;
use ti_gauge::probe::ROM_ADDRESS;
use ti_gauge::rom::{self, Device, Firmware, Found};

use crate::firmware::{Style, content, file};

const STYLES: [Style; 2] = [Style::Row, Style::Word];

fn chips() -> impl Iterator<Item = &'static Chip> {
    CHIPS.iter().copied().filter(|chip| chip.firmware_file.is_some())
}

struct Bench {
    clock: Arc<SimClock>,
    sim: Sim,
}

impl Bench {
    /// A gauge whose firmware was just erased.
    fn new(chip: &Chip) -> Self {
        let bench = Self::in_rom_mode(chip);
        let mut bus = bench.sim.bus_at(ROM_ADDRESS);
        bus.transfer(&[0x00, 0x04, 0, 0, 0, 0x83, 0xDE], &mut []).expect("it takes the command");
        bus.transfer(&[0x64, 0x65, 0x01], &mut []).expect("it takes the sum");
        bench.clock.sleep(Duration::from_millis(400));
        bench.switch();
        assert_eq!(bench.sim.get("mode").as_deref(), Some("rom"));
        bench
    }

    /// A gauge that was sent to ROM mode, with all its firmware.
    fn in_rom_mode(chip: &Chip) -> Self {
        let clock = Arc::new(SimClock::new());
        let sim = Sim::new(chip.name, &Options::default(), clock.clone()).expect("a simulated gauge");
        clock.sleep(Duration::from_secs(1));
        for word in [0x0414_u16, 0x3672, 0xffff, 0xffff, 0x0f00] {
            let [low, high] = word.to_le_bytes();
            sim.bus().transfer(&[0x00, low, high], &mut []).expect("it takes the word");
            clock.sleep(Duration::from_millis(100));
        }
        Self { clock, sim }
    }

    /// Switches power off and on.
    fn switch(&self) {
        self.sim.set("power", "off").expect("a knob");
        self.sim.set("power", "on").expect("a knob");
        self.clock.sleep(Duration::from_secs(1));
    }

    fn answers(&self, address: u8) -> bool {
        self.sim.bus_at(address).transfer(&[], &mut [0]).is_ok()
    }

    fn rescue(&self, firmware: &Firmware) -> ti_gauge::error::Result<()> {
        let mut bus = self.sim.bus_at(ROM_ADDRESS);
        rom::look(&mut bus, &*self.clock).and_then(|found| firmware.check(&found))?;
        firmware.write(&mut bus, &*self.clock, &mut |_, _| {})
    }

    fn works(&self, data: &[u8]) {
        assert!(self.answers(GAUGE_ADDRESS) && !self.answers(ROM_ADDRESS), "{:?}", self.sim.get("mode"));
        assert!(self.sim.firmware().expect("a boot loader").1 == data, "data flash is the file's");
        assert_eq!(self.sim.get("mode").as_deref(), Some("normal"));
    }
}

#[test]
fn a_gauge_in_rom_mode_is_brought_back() {
    for chip in chips() {
        for style in STYLES {
            let bench = Bench::new(chip);
            let firmware = Firmware::parse(&file(chip, style), chip).expect("a whole file");
            assert_eq!(firmware.version, chip.identity.firmware[0]);
            let mut calls = Vec::new();
            let mut bus = bench.sim.bus_at(ROM_ADDRESS);
            assert_eq!(rom::look(&mut bus, &*bench.clock), Ok(Found { version: None }));
            firmware
                .write(&mut bus, &*bench.clock, &mut |done, all| calls.push((done, all)))
                .expect("it ends");
            assert_eq!(calls.first().map(|(done, _)| *done), Some(1));
            assert!(calls.last().is_some_and(|(done, all)| done == all));
            bench.works(&content(chip).1);
            bench.switch();
            bench.works(&content(chip).1);
        }
    }
}

/// What happens at one transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Blow {
    /// It is not acknowledged, and nothing of it arrives.
    Nack,
    /// It arrives, and the host learns that it failed.
    Lost,
    /// One bit of what is written or read is wrong.
    Flip,
    /// Power goes and comes back before it, or after it.
    CutBefore,
    CutAfter,
    /// The host is gone.
    Gone,
}

const BLOWS: [Blow; 6] = [Blow::Nack, Blow::Lost, Blow::Flip, Blow::CutBefore, Blow::CutAfter, Blow::Gone];

/// A bus on which something happens at the nth transfer.
struct Struck<'a> {
    bench: &'a Bench,
    blow: Blow,
    left: usize,
    gone: bool,
}

impl Bus for Struck<'_> {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let mut bus = self.bench.sim.bus_at(ROM_ADDRESS);
        if self.gone {
            return Err(BusError::Gone);
        }
        self.left = self.left.wrapping_sub(1);
        if self.left != 0 {
            return bus.transfer(write, read);
        }
        match self.blow {
            Blow::Nack => Err(BusError::NoAck),
            Blow::Lost => bus.transfer(write, read).and(Err(BusError::Timeout)),
            Blow::Flip if read.is_empty() => {
                let mut write = write.to_vec();
                if let Some(last) = write.last_mut() {
                    *last ^= 0x04;
                }
                bus.transfer(&write, read)
            }
            Blow::Flip => {
                let result = bus.transfer(write, read);
                read[0] ^= 0x04;
                result
            }
            Blow::CutBefore => {
                self.bench.switch();
                bus.transfer(write, read)
            }
            Blow::CutAfter => {
                let result = bus.transfer(write, read);
                self.bench.switch();
                result
            }
            Blow::Gone => {
                self.gone = true;
                Err(BusError::Gone)
            }
        }
    }
}

/// Counts the transfers of a whole run.
fn transfers(firmware: &Firmware, chip: &Chip) -> usize {
    let bench = Bench::new(chip);
    let before: usize = bench.sim.get("transfers").expect("a knob").parse().expect("a number");
    bench.rescue(firmware).expect("it ends");
    let after: usize = bench.sim.get("transfers").expect("a knob").parse().expect("a number");
    after - before
}

/// The transfers that are struck: all of them if GAUGEFS_RESCUE is set, else those at the ends, where the commands differ,
/// and some of the many rows in between.
fn struck(all: usize, style: Style) -> Vec<usize> {
    let every = std::env::var_os("GAUGEFS_RESCUE").is_some();
    let at_ends = |at: &usize| match style {
        Style::Word => *at <= 27 || at + 28 > all || at.is_multiple_of(331),
        Style::Row => at + 24 > all,
    };
    (1..=all).filter(|at| every || at_ends(at)).collect()
}

#[test]
fn whatever_interrupts_it_the_next_run_ends_with_a_gauge_that_works() {
    let chip = CHIPS[0];
    for style in STYLES {
        let firmware = Firmware::parse(&file(chip, style), chip).expect("a whole file");
        let data = content(chip).1;
        let all = transfers(&firmware, chip);
        for at in struck(all, style) {
            for blow in BLOWS {
                let bench = Bench::new(chip);
                let mut bus = Struck { bench: &bench, blow, left: at, gone: false };
                let result = rom::look(&mut bus, &*bench.clock)
                    .and_then(|found| firmware.check(&found))
                    .and_then(|()| firmware.write(&mut bus, &*bench.clock, &mut |_, _| {}));
                let what = format!("{style:?} {blow:?} {at} of {all}: {result:?}");
                bench.clock.sleep(Duration::from_secs(5));
                // The gauge is in ROM mode, or it works: nothing in between.
                if bench.answers(GAUGE_ADDRESS) {
                    bench.works(&data);
                    continue;
                }
                assert!(bench.answers(ROM_ADDRESS), "{what}: {:?}", bench.sim.get("mode"));
                if result.is_ok() {
                    // Only the way out was not heard: the firmware is whole, and starts when power comes.
                    bench.switch();
                    bench.works(&data);
                    continue;
                }
                bench.rescue(&firmware).unwrap_or_else(|error| panic!("{what}: {error}"));
                bench.works(&data);
            }
        }
    }
}

#[test]
fn a_gauge_with_whole_firmware_is_written_only_with_the_same_version() {
    let chip = CHIPS[0];
    let bench = Bench::in_rom_mode(chip);
    let mut bus = bench.sim.bus_at(ROM_ADDRESS);
    let found = rom::look(&mut bus, &*bench.clock).expect("a boot loader");
    assert_eq!(found, Found { version: Some(0x0016) });
    let firmware = Firmware::parse(&file(chip, Style::Word), chip).expect("a whole file");
    firmware.check(&found).expect("the same");
    let error = firmware.check(&Found { version: Some(0x0123) }).expect_err("another");
    assert!(error.to_string().contains("0x0123"), "{error}");
    // Its own firmware starts when power comes.
    bench.switch();
    assert!(bench.answers(GAUGE_ADDRESS));
}

/// A device at the address, which must not be written: a word at each code, and the same bytes for the others.
#[derive(Clone)]
struct Unwritten {
    words: Vec<(u8, u16)>,
    chemistry: &'static [u8],
    other: u8,
}

/// What real packs read: 0x0021 and 0x0031 are SpecificationInfo() of most.
const PACK: [(u8, u16); 10] = [
    (0x08, 2981),
    (0x09, 0x2f0b),
    (0x0a, 0xfe2f),
    (0x16, 0x00c0),
    (0x17, 0x0123),
    (0x18, 4400),
    (0x19, 10_800),
    (0x1a, 0x0031),
    (0x1b, 0x4a61),
    (0x1c, 0x1234),
];

impl Unwritten {
    fn pack() -> Self {
        Self { words: PACK.to_vec(), chemistry: b"\x04LION", other: 0xff }
    }

    /// The same pack, but for one word.
    fn with(self, code: u8, word: u16) -> Self {
        let words = self.words.iter().map(|old| if old.0 == code { (code, word) } else { *old }).collect();
        Self { words, ..self }
    }
}

impl Bus for Unwritten {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        assert!(write.len() <= 1 && !read.is_empty(), "{write:02x?} was written");
        read.fill(self.other);
        let word = write.first().and_then(|code| self.words.iter().find(|word| word.0 == *code));
        let text = match (write, word) {
            ([0x22], _) => self.chemistry.to_vec(),
            (_, Some((_, word))) => word.to_le_bytes().to_vec(),
            _ => Vec::new(),
        };
        read.iter_mut().zip(text).for_each(|(byte, text)| *byte = text);
        Ok(())
    }
}

#[test]
fn nothing_is_written_to_what_may_be_a_smart_battery() {
    let clock = SimClock::new();
    let unclear = |words: Vec<(u8, u16)>, other| Unwritten { words, chemistry: b"", other };
    for (mut bus, device) in [
        (Unwritten::pack(), Device::SmartBattery),
        (Unwritten::pack().with(0x1a, 0x0021), Device::SmartBattery),
        (Unwritten::pack().with(0x1a, 0x3311), Device::SmartBattery),
        // One of its words is misread, or is not as the specification has it.
        (Unwritten::pack().with(0x1a, 0x0035), Device::Unclear),
        (Unwritten::pack().with(0x08, 0), Device::Unclear),
        (Unwritten::pack().with(0x16, 0x2000), Device::Unclear),
        (Unwritten { chemistry: b"\xff", ..Unwritten::pack() }, Device::Unclear),
        (Unwritten { chemistry: b"\x04L\x00ON", ..Unwritten::pack() }, Device::Unclear),
        // A stuck line, and packs that answer everything alike.
        (unclear(Vec::new(), 0xff), Device::Unclear),
        (unclear(Vec::new(), 0x00), Device::Unclear),
        (unclear(Vec::new(), 0x17), Device::Unclear),
        (unclear(vec![(0x1a, 0x0021)], 0xff), Device::Unclear),
    ] {
        let words = bus.words.clone();
        assert_eq!(rom::device(&mut bus, &clock), Ok(device), "{words:04x?}");
        let error = rom::look(&mut bus, &clock).expect_err("no boot loader");
        assert!(matches!(error.cause(), Cause::Gone), "{error}");
        let error = error.to_string();
        assert!(error.starts_with("address 0x0b: ") && error.contains("Smart Battery"), "{error}");
    }
}

/// A host for words has a command for the text, or none: without it, nothing can be told apart.
#[test]
fn a_pack_and_a_boot_loader_are_told_apart_behind_smbus_hosts() {
    for host in ["i801", "piix4", "i2c-stub"] {
        let model = AdapterModel::by_name(host).expect("a model");
        let bench = Bench::in_rom_mode(CHIPS[0]);
        bench.sim.set_adapter(model, false);
        let device = rom::device(&mut bench.sim.bus_at(ROM_ADDRESS), &*bench.clock);
        assert_eq!(device, Ok(Device::BootLoader), "{host}");
        let clock = Arc::new(SimClock::new());
        let pack = Sim::new("sbs", &Options::default(), clock.clone()).expect("it is simulated");
        clock.sleep(Duration::from_secs(1));
        pack.set_adapter(model, false);
        assert_eq!(rom::device(&mut pack.bus(), &*clock), Ok(Device::SmartBattery), "{host}");
        for answer in ["22=00", "22=21414243", "22=-"] {
            pack.set("answers", answer).expect("a knob");
            assert_eq!(rom::device(&mut pack.bus(), &*clock), Ok(Device::Unclear), "{host} {answer}");
        }
        pack.set("answers", "own").expect("a knob");
        pack.set_reach(Reach::smbus(2, false));
        assert_eq!(rom::device(&mut pack.bus(), &*clock), Ok(Device::Unclear), "{host}, words alone");
        assert_eq!(pack.get("written").as_deref(), Some("0"), "{host}");
    }
}

/// Whether `gaugefs rescue` takes the part or not, what it has become is told, and what brings it back.
#[test]
fn every_part_that_is_left_in_rom_mode_is_recognised() {
    let mut left = Vec::new();
    for chip in CHIPS {
        let clock = Arc::new(SimClock::new());
        let sim = Sim::new(chip.name, &Options::default(), clock.clone()).expect("a simulated gauge");
        clock.sleep(Duration::from_secs(1));
        if !sim.leave_in_rom() {
            continue;
        }
        left.push(chip.name);
        assert_eq!(sim.bus().transfer(&[], &mut [0]), Err(BusError::NoAck), "{}", chip.name);
        let found = rom::find(&mut sim.bus_at(ROM_ADDRESS), &*clock);
        // What the boot loader of the newer parts reads like is not known.
        let newer = chip.access.scheme.is_flat() && found == Ok(Some(Device::Unclear));
        assert!(newer || found == Ok(Some(Device::BootLoader)), "{}: {found:?}", chip.name);
    }
    let enters = |chip: &&&Chip| chip.subcommand(0x0F00).is_some();
    assert_eq!(left, CHIPS.iter().filter(enters).map(|chip| chip.name).collect::<Vec<_>>());
}

#[test]
fn a_boot_loader_is_told_from_a_smart_battery_whatever_its_buffer_holds() {
    let chip = CHIPS[0];
    let bench = Bench::in_rom_mode(chip);
    let mut bus = bench.sim.bus_at(ROM_ADDRESS);
    let told = |bus: &mut dyn Bus| rom::device(bus, &*bench.clock);
    assert_eq!(told(&mut bus), Ok(Device::BootLoader));
    rom::look(&mut bus, &*bench.clock).expect("a boot loader");
    assert_eq!(told(&mut bus), Ok(Device::BootLoader), "with row 0 in its buffer");
    // A row that has the pack's words where no two of them overlap: it is both.
    let mut message = [0; 101];
    for (code, word) in PACK.iter().filter(|(code, _)| ![0x09, 0x17, 0x19, 0x1b].contains(code)) {
        message[1 + usize::from(*code)..][..2].copy_from_slice(&word.to_le_bytes());
    }
    message[1 + 0x22..][..5].copy_from_slice(b"\x04LION");
    bus.transfer(&message, &mut []).expect("it takes the bytes");
    assert_eq!(told(&mut bus), Ok(Device::Unclear));
    // Nobody is there.
    let error = told(&mut bench.sim.bus_at(0x0c)).expect_err("nobody");
    assert_eq!(error.cause(), Cause::Bus(BusError::NoAck));
}

fn refused(text: &str, chip: &'static Chip) -> String {
    Firmware::parse(text, chip).expect_err("refused").to_string()
}

#[test]
fn the_file_of_another_part_is_refused() {
    for chip in chips() {
        for other in chips().filter(|other| other.name != chip.name) {
            let why = refused(&file(other, Style::Word), chip);
            assert!(why.contains(chip.model), "{why}");
        }
    }
    let chip = CHIPS[0];
    // The same version in another part, which its name betrays.
    let (rows, mut data) = content(chip);
    let at = chip.firmware_file.as_ref().expect("it has one").name;
    data[at + 1..at + 12].copy_from_slice(b"bq27541-G1 ");
    assert!(refused(&firmware::file(rows.clone(), data.clone(), Style::Row), chip).contains("bq27541"));
    // A name of the user's own is none of TI's.
    data[at + 1..at + 12].copy_from_slice(b"Our pack 12");
    let firmware =
        Firmware::parse(&firmware::file(rows.clone(), data.clone(), Style::Row), chip).expect("a whole file");
    assert_eq!(firmware.name, "Our pack 12");
    data[at] = 0xFF;
    assert!(refused(&firmware::file(rows, data, Style::Row), chip).contains("Device Name"));
    // What the head of the file expects of the gauge.
    let head = "W: AA 00 01 00\nC: AA 00 20 05\n";
    assert!(refused(&(head.to_string() + &file(chip, Style::Row)), chip).contains("0x0520"));
    // Parts of which no whole file is known.
    for none in CHIPS.iter().filter(|chip| chip.firmware_file.is_none()) {
        let why = refused(&file(chip, Style::Row), none);
        assert!(
            why.starts_with(&format!("{}: in ROM mode gaugefs does not bring it back", none.model)),
            "{why}"
        );
        assert!(why.contains("TI's tools do, with the .bq.fs"), "{why}");
    }
}

#[test]
fn a_file_that_is_cut_or_changed_is_refused_at_every_line() {
    let chip = CHIPS[0];
    for style in STYLES {
        let text = file(chip, style);
        let lines: Vec<_> = text.lines().collect();
        // The last wait is behind the last row.
        for end in
            (0..lines.len() - 1).filter(|end| *end < 16 || end + 60 > lines.len() || end.is_multiple_of(331))
        {
            refused(&lines[..end].join("\n"), chip);
            let is_command = lines[end].starts_with("W: 16") || lines[end].starts_with("C: 16");
            if !is_command {
                continue;
            }
            let without = [&lines[..end], &lines[end + 1..]].concat().join("\n");
            // The status of a command that a sum proves is one comparison of two.
            let proves = lines[end] == "C: 16 66 00" && lines[end + 1].starts_with("C: 16 04");
            assert!(
                proves || Firmware::parse(&without, chip).is_err(),
                "{style:?} without line {end}: {}",
                lines[end]
            );
            let mut changed = lines[end].to_string();
            let digit = changed.pop().expect("a digit");
            changed.push(if digit == '1' { '2' } else { '1' });
            let changed = [&lines[..end], &[&changed[..]], &lines[end + 1..]].concat().join("\n");
            refused(&changed, chip);
        }
    }
}

#[test]
fn data_flash_alone_is_refused() {
    let chip = CHIPS[0];
    let (rows, data) = content(chip);
    let mut out = Writer { text: String::new(), rows, data };
    out.done(&[0x03, 0, 0], 20);
    out.row(0);
    out.row(1);
    out.data();
    out.command(&[0x0F], 4000);
    let why = refused(&out.text, chip);
    assert!(why.contains(".df.fs") && why.contains(".bq.fs"), "{why}");
    assert!(refused("; nothing\n", chip).contains(".bq.fs"));
}

#[test]
fn commands_that_no_file_has_are_refused() {
    let chip = CHIPS[0];
    let good = file(chip, Style::Word);
    // 0x06 ruins a gauge for good.
    for bytes in ["06", "0D", "01 00 00 06 54 54 15"] {
        let sum: u16 = bytes.split(' ').map(|byte| u16::from_str_radix(byte, 16).expect("hex")).sum();
        let [low, high] = sum.to_le_bytes();
        let row = format!("W: 16 00 {bytes}\nW: 16 64 {low:02X} {high:02X}\nX: 2\nC: 16 66 00\n");
        let at = good.find("W: 16 00 0C").expect("it erases data flash");
        let why = refused(&(good[..at].to_string() + &row + &good[at..]), chip);
        assert!(why.contains("no command") || why.contains("missing"), "{why}");
    }
    // An erase or a row behind the mark.
    let at = good.rfind("W: 16 00 05").expect("its last sum");
    let row = "W: 16 00 0C 00 00 00 83 DE\nW: 16 64 6D 01\nX: 200\nC: 16 66 00\n";
    assert!(refused(&(good[..at].to_string() + row + &good[at..]), chip).contains("interrupted"));
    assert!(refused(&good.replace("X: 4000", "W: 16 00 05"), chip).contains("left"));
    assert!(refused(&good.replace("X: 4000", "W: 20 00 05"), chip).contains("0x20"));
}

/// A row is written by one message, so an adapter that carries less is refused before anything is sent.
#[test]
fn an_adapter_that_does_not_carry_a_row_is_refused() {
    let chip = chips().next().expect("a chip");
    let firmware = Firmware::parse(&file(chip, Style::Row), chip).expect("a whole file");
    for (reach, most) in [
        (Reach::smbus(32, true), 32),
        (Reach::of_data(60), 60),
        (Reach { write: 100, ..Reach::FULL }, 100),
        (Reach { read: 95, ..Reach::FULL }, 95),
    ] {
        let bench = Bench::in_rom_mode(chip);
        let before = bench.sim.firmware();
        bench.sim.set_reach(reach);
        bench.sim.keep_log(true);
        let error = bench.rescue(&firmware).expect_err("it is too short");
        let why = format!("ROM mode: a message of 101 bytes, and the adapter carries {most} at most");
        assert!(error.to_string().starts_with(&why), "{error}");
        assert!(bench.sim.log().is_empty() && bench.sim.firmware() == before);
        bench.sim.set_reach(Reach::of_data(100));
        bench.rescue(&firmware).expect("it carries a row");
    }
}
