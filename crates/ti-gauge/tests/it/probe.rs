// SPDX-License-Identifier: MIT

//! Finding a gauge on a bus: which transfers each device gets, and which devices are never written.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{Bus, BusError, Reach};
use gauge_sim::{Options, Sim};
use ti_gauge::chip::{CHIPS, Chip, SIBLINGS, Sibling};
use ti_gauge::error::{Cause, Result};
use ti_gauge::gauge::Gauge;
use ti_gauge::keys::Keys;
use ti_gauge::probe::{self, Open, ROM_ADDRESS, Reading, Target, Who, answers_in_rom, check};

fn target<'a>(open: &'a Open<'a>, clock: &'a Arc<dyn Clock>) -> Target<'a> {
    Target { open, clock, reach: Reach::FULL, clock_hz: None }
}

fn candidates(open: &Open<'_>, clock: &Arc<dyn Clock>) -> Result<Vec<Reading>> {
    probe::candidates(&target(open, clock))
}

fn identify(plausible: &[Reading], open: &Open<'_>, clock: &Arc<dyn Clock>) -> Result<Who> {
    probe::identify(plausible, &target(open, clock))
}

fn find(subject: &str, open: &Open<'_>, clock: &Arc<dyn Clock>) -> Result<&'static Chip> {
    probe::find(subject, &target(open, clock))
}

/// An EEPROM with an address pointer, which must not be written.
struct Eeprom(u8);

impl Bus for Eeprom {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        assert!(write.len() <= 1, "the EEPROM was written to");
        read.fill(self.0);
        Ok(())
    }
}

#[test]
fn an_eeprom_is_read_but_never_written() {
    let clock: Arc<dyn Clock> = Arc::new(SimClock::new());
    for byte in [0x00, 0x41, 0xff] {
        let open = || Ok(Box::new(Eeprom(byte)) as Box<dyn Bus>);
        assert!(candidates(&open, &clock).expect("it answers").is_empty());
        find("here", &open, &clock).expect_err("not a gauge");
        let bus = open().expect("it opens");
        let mut gauge = Gauge::new(CHIPS[0], bus, clock.clone(), Keys::default());
        check(&mut gauge).expect_err("not a gauge");
    }
}

#[test]
fn each_simulated_gauge_is_identified() {
    for chip in CHIPS.iter().filter(|chip| !chip.is_inferred()) {
        let clock: Arc<dyn Clock> = Arc::new(SimClock::new());
        let Ok(sim) = Sim::new(chip.name, &Options::default(), clock.clone()) else { continue };
        clock.sleep(std::time::Duration::from_secs(1));
        let open = || Ok(Box::new(sim.bus()) as Box<dyn Bus>);
        assert_eq!(find("here", &open, &clock).expect("a gauge").name, chip.name);
        let plausible = candidates(&open, &clock).expect("it answers");
        assert!(plausible.iter().any(|reading| reading.chip.name == chip.name));
    }
}

/// A gauge that answers as one of the siblings, and records the subcommands that it gets.
struct Sister {
    inner: Box<dyn Bus>,
    sibling: &'static Sibling,
    code: u16,
    asked: Arc<Mutex<Vec<u16>>>,
}

impl Bus for Sister {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        match write {
            [] | [_] => {}
            [register @ (0x00 | 0x3e), low, high] => {
                self.code = if *register == 0 { u16::from_le_bytes([*low, *high]) } else { 0xffff };
                self.asked.lock().expect("no panic").push(u16::from_le_bytes([*low, *high]));
            }
            other => panic!("{}: {other:02x?} was written", self.sibling.name),
        }
        self.inner.transfer(write, read)?;
        let identity = &self.sibling.identity;
        let answer = match (write, self.code) {
            ([0x00], 0x0001) => Some(identity.device_type),
            // Where it is not known, one that no row has.
            ([0x00], 0x0002) => Some(identity.firmware.first().copied().unwrap_or(0x7fff)),
            ([0x00], 0x0004) => identity.dm_codes.first().copied(),
            _ => None,
        };
        if let (Some(answer), [low, high]) = (answer, read) {
            [*low, *high] = answer.to_le_bytes();
        }
        Ok(())
    }
}

#[test]
fn each_sibling_is_identified_and_only_its_type_is_requested() {
    for sibling in SIBLINGS {
        // Siblings that resemble no supported chip get a gauge with registers of the same generation.
        let chip = sibling.like.unwrap_or_else(|| Chip::by_name("bq27441-g1").expect("a chip"));
        let clock: Arc<dyn Clock> = Arc::new(SimClock::new());
        let sim = Sim::new(chip.name, &Options::default(), clock.clone()).expect("a gauge");
        clock.sleep(std::time::Duration::from_secs(1));
        let asked = Arc::new(Mutex::new(Vec::new()));
        let open = || {
            let (inner, asked) = (Box::new(sim.bus()), asked.clone());
            Ok(Box::new(Sister { inner, sibling, code: 0xffff, asked }) as Box<dyn Bus>)
        };
        let plausible = candidates(&open, &clock).expect("it answers");
        assert!(asked.lock().expect("no panic").is_empty(), "{}: reading asks nothing", sibling.name);
        let who = identify(&plausible, &open, &clock).expect("it answers");
        let found = find("here", &open, &clock);
        let device_type = sibling.identity.device_type;
        let alike = SIBLINGS.iter().filter(|other| other.identity.device_type == device_type);
        if sibling.identity.firmware.is_empty() && alike.count() > 1 {
            // Only the user can tell these apart.
            let chips: Vec<_> = who.chips.iter().map(|chip| chip.name).collect();
            let like = sibling.like.expect("a chip").name;
            assert!(who.sibling.is_none() && chips.len() > 1 && chips.contains(&like), "{chips:?}");
            let error = found.expect_err("there are several").to_string();
            assert!(error.contains(&chips.join(", ")) && error.contains("--chip"), "{error}");
            continue;
        }
        assert_eq!(who.sibling.map(|found| found.name), Some(sibling.name));
        assert!(who.chips.is_empty(), "{}: {:?}", sibling.name, who.chips);
        match (sibling.like, found) {
            (Some(like), found) => assert_eq!(found.expect("it is like a chip").name, like.name),
            (None, found) => {
                let error = found.expect_err("it has no table").to_string();
                let says = format!("it is a {}, which gaugefs does not support", sibling.name);
                assert!(error.contains(&says), "{error}");
            }
        }
        let names = ["DEVICE_TYPE", "FW_VERSION", "HW_VERSION", "CHEM_ID", "DM_CODE"];
        let may = |code: &u16| {
            let mut known = CHIPS.iter().flat_map(|chip| chip.subcommands);
            known.any(|known| known.code == *code && names.contains(&known.name))
        };
        let asked = asked.lock().expect("no panic");
        assert!(!asked.is_empty() && asked.iter().all(may), "{}: {asked:04x?}", sibling.name);
    }
}

#[test]
fn a_gauge_in_rom_mode_is_found_by_reading_a_byte() {
    let clock: Arc<dyn Clock> = Arc::new(SimClock::new());
    let sim = Sim::new(CHIPS[0].name, &Options::default(), clock.clone()).expect("a gauge");
    clock.sleep(std::time::Duration::from_secs(1));
    let mut rom = sim.bus_at(ROM_ADDRESS);
    assert_eq!(answers_in_rom(&mut rom), Ok(false));
    // FULL ACCESS with the manual's keys, then the subcommand for ROM mode, as a flash programmer sends it.
    for word in [0x0414_u16, 0x3672, 0xffff, 0xffff, 0x0f00] {
        let [low, high] = word.to_le_bytes();
        sim.bus().transfer(&[0x00, low, high], &mut []).expect("it takes the word");
        clock.sleep(std::time::Duration::from_millis(100));
    }
    assert_eq!(answers_in_rom(&mut rom), Ok(true));
    let open = || Ok(Box::new(sim.bus()) as Box<dyn Bus>);
    let error = candidates(&open, &clock).expect_err("it has left the other address");
    assert_eq!(error.cause(), Cause::Bus(BusError::NoAck));
    assert_eq!(answers_in_rom(&mut Eeprom(0x41)), Ok(true));
}

#[test]
fn an_empty_address_is_reported() {
    let clock: Arc<dyn Clock> = Arc::new(SimClock::new());
    let sim = Sim::new(CHIPS[0].name, &Options::default(), clock.clone()).expect("a gauge");
    let open = || Ok(Box::new(sim.bus_at(0x50)) as Box<dyn Bus>);
    let error = candidates(&open, &clock).expect_err("nobody is there");
    assert_eq!(error.cause(), Cause::Bus(BusError::NoAck));
}

/// A gauge whose transfers are recorded, each with its time.
struct Recorded {
    inner: Box<dyn Bus>,
    clock: Arc<dyn Clock>,
    transfers: Arc<Mutex<Vec<Transfer>>>,
}

/// When it was, what was written, and how many bytes were read.
type Transfer = (Duration, Vec<u8>, usize);

impl Bus for Recorded {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        let transfer = (self.clock.now(), write.to_vec(), read.len());
        self.transfers.lock().expect("no panic").push(transfer);
        self.inner.transfer(write, read)
    }
}

/// All transfers of the identification of a simulated gauge.
fn identification(chip: &Chip, reach: Reach, clock_hz: Option<u32>) -> Vec<Transfer> {
    let clock: Arc<dyn Clock> = Arc::new(SimClock::new());
    let sim = Sim::new(chip.name, &Options::default(), clock.clone()).expect("a gauge");
    clock.sleep(Duration::from_secs(1));
    let transfers = Arc::new(Mutex::new(Vec::new()));
    let open = || {
        let (inner, clock, transfers) = (Box::new(sim.bus()), clock.clone(), transfers.clone());
        Ok(Box::new(Recorded { inner, clock, transfers }) as Box<dyn Bus>)
    };
    let target = Target { open: &open, clock: &clock, reach, clock_hz };
    assert_eq!(probe::find("here", &target).expect("a gauge").name, chip.name);
    std::mem::take(&mut transfers.lock().expect("no panic"))
}

/// The watchdog of a gauge that gets a standard command more often may reset it.
#[test]
fn no_register_is_read_and_no_subcommand_is_sent_more_than_twice_a_second() {
    for chip in CHIPS.iter().copied().filter(|chip| !chip.is_inferred()) {
        let mut times: HashMap<(bool, u16), Vec<Duration>> = HashMap::new();
        for (now, write, read) in identification(chip, Reach::FULL, None) {
            match write[..] {
                [0x00 | 0x3e, low, high] => {
                    times.entry((true, u16::from_le_bytes([low, high]))).or_default().push(now);
                }
                // Control() and MACData() are read after each subcommand.
                [0x00 | 0x40] => {}
                [start] => (start..).take(read).for_each(|code| {
                    times.entry((false, code.into())).or_default().push(now);
                }),
                _ => panic!("{}: {write:02x?} was written", chip.name),
            }
        }
        for ((_, code), times) in times {
            let close = times.windows(3).any(|three| three[2] - three[0] < Duration::from_secs(1));
            assert!(!close, "{}: 0x{code:02x} at {times:?}", chip.name);
        }
    }
}

#[test]
fn one_byte_is_written_a_transfer_while_a_gauge_is_identified() {
    let chip = Chip::by_name("bq27427").expect("a chip");
    let longest = |reach, clock_hz| {
        let written = identification(chip, reach, clock_hz).into_iter().map(|(_, write, _)| write.len());
        written.max()
    };
    assert_eq!(longest(Reach::FULL, None), Some(3));
    assert_eq!(longest(Reach::FULL, Some(100_000)), Some(3));
    assert_eq!(longest(Reach::ONE_BYTE_A_WRITE, None), Some(2));
    assert_eq!(longest(Reach::FULL, Some(400_000)), Some(2));
}
