//! Finding out what answers at an address, without harm to what is not a gauge.
//!
//! An EEPROM may sit at a gauge's address, and for it "Control(DEVICE_TYPE)" is a write. So the registers
//! are read first, which takes no more than a register pointer, and judged: Control() goes only to what
//! reads like a gauge, and only where the user has named the address.

use std::ptr;
use std::sync::Arc;

use crate::bus::{Bus, BusError};
use crate::chip::{CHIPS, Chip, Recognised, Role, SIBLINGS, Sibling, Tier, recognise};
use crate::clock::Clock;
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Answers, Gauge, bursts};
use crate::keys::Keys;

/// The address at which a gauge in ROM mode answers.
pub const ROM_ADDRESS: u8 = 0x0b;

const STRANGE: &str = "what answers there does not read like a gauge, so nothing was written to it";

/// Control(DEVICE_TYPE).
const DEVICE_TYPE: u16 = 0x0001;

/// What the registers of a chip's table read at an address.
#[derive(Clone, Debug)]
pub struct Reading {
    /// Whose table it was.
    pub chip: &'static Chip,
    values: Vec<(Role, i64)>,
}

impl Reading {
    /// What the register that feeds a property reads.
    pub fn value(&self, role: Role) -> Option<i64> {
        self.values.iter().find(|(found, _)| *found == role).map(|&(_, value)| value)
    }

    /// Whether a gauge could say that: a temperature between -50 and 125 degrees Celsius, and percentages
    /// of at most 100.
    pub fn is_plausible(&self) -> bool {
        let within = |role, min, max| self.value(role).is_none_or(|value| min <= value && value <= max);
        let known = self.value(Role::Temp).is_some();
        known
            && within(Role::Temp, 2231, 3981)
            && within(Role::Capacity, 0, 100)
            && within(Role::CapacityErrorMargin, 0, 100)
            && within(Role::StateOfHealth, 0, 100)
    }
}

/// A way to the address, opened anew each time it is called.
pub type Open<'a> = dyn Fn() -> Result<Box<dyn Bus>> + 'a;

fn gauge(chip: &'static Chip, open: &Open<'_>, clock: &Arc<dyn Clock>) -> Result<Gauge> {
    Ok(Gauge::new(chip, open()?, clock.clone(), Keys::default(), false))
}

/// Reads the registers of a chip's table, and nothing else.
pub fn read(chip: &'static Chip, open: &Open<'_>, clock: &Arc<dyn Clock>) -> Result<Reading> {
    reading(&mut gauge(chip, open, clock)?)
}

fn reading(gauge: &mut Gauge) -> Result<Reading> {
    let chip = gauge.chip;
    let mut bytes = [0; 256];
    for (start, length) in bursts(chip.registers, |tier| tier == Tier::Poll) {
        let start = usize::from(start);
        gauge.read(start as u8, &mut bytes[start..start + usize::from(length)])?;
    }
    let polled = chip.registers.iter().filter(|register| register.tier == Tier::Poll);
    let values = polled.filter_map(|register| {
        let at = usize::from(register.code);
        let bytes = &bytes[at..at + usize::from(register.size)];
        let raw = bytes.iter().rev().fold(0, |sum, &byte| sum << 8 | i64::from(byte));
        let span = 1 << (8 * register.size);
        Some((register.role?, if register.signed && raw >= span / 2 { raw - span } else { raw }))
    });
    Ok(Reading { chip, values: values.collect() })
}

/// Makes sure that what is there reads like the gauge that it is said to be. Nothing is written.
pub fn look(gauge: &mut Gauge) -> Result<()> {
    if reading(gauge)?.is_plausible() {
        return Ok(());
    }
    Err(Error::new("", Cause::Gone(STRANGE.into())).at(Step::Identify))
}

/// The chips whose registers read plausibly there. An error means that nothing could be read at all.
pub fn candidates(open: &Open<'_>, clock: &Arc<dyn Clock>) -> Result<Vec<Reading>> {
    let (mut plausible, mut answered, mut failure) = (Vec::new(), false, None);
    for chip in CHIPS {
        match read(chip, open, clock) {
            Ok(reading) => {
                answered = true;
                plausible.extend(reading.is_plausible().then_some(reading));
            }
            // A part may well refuse the registers of another.
            Err(error) if *error.cause() == Cause::Bus(BusError::NoAck) => failure = Some(error),
            Err(error) => return Err(error),
        }
    }
    failure.filter(|_| !answered).map_or(Ok(plausible), Err)
}

/// Whether anybody answers at the address of gauges in ROM mode. One byte is read, and none written: there
/// is nothing to ask, and a smart battery may live there.
pub fn answers_in_rom(bus: &mut dyn Bus) -> Result<bool> {
    match bus.transfer(&[], &mut [0]) {
        Ok(()) => Ok(true),
        Err(BusError::NoAck) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

/// Who is there, as far as Control() tells.
#[derive(Clone, Debug, Default)]
pub struct Who {
    /// What it answered when it was asked as the first of `chips` is asked.
    pub answers: Answers,
    /// The chips that answer so: one, none, or several that only the user can tell apart.
    pub chips: Vec<&'static Chip>,
    /// A part that is known to answer so and has no table.
    pub sibling: Option<&'static Sibling>,
}

/// Asks what reads like a gauge who it is, as each of the plausible chips would be asked.
///
/// All chips have DEVICE_TYPE at the same code; what comes after it is asked only where the type fits.
pub fn identify(plausible: &[Reading], open: &Open<'_>, clock: &Arc<dyn Clock>) -> Result<Who> {
    let mut who = Who::default();
    for Reading { chip, .. } in plausible {
        let mut gauge = gauge(chip, open, clock)?;
        let device_type = gauge.ask(DEVICE_TYPE)?;
        let alike = |sibling: &&Sibling| {
            sibling.identity.device_type == device_type
                && sibling.like.is_none_or(|like| ptr::eq(like, *chip))
        };
        if device_type != chip.identity.device_type && !SIBLINGS.iter().any(|sibling| alike(&sibling)) {
            if who.answers == Answers::default() {
                who.answers.device_type = device_type;
            }
            continue;
        }
        let answers = gauge.identify()?;
        if who.chips.is_empty() {
            who.answers = answers;
        }
        match recognise(&answers) {
            Recognised::Chip(one) if ptr::eq(one, *chip) => who.chips.push(one),
            Recognised::Ambiguous(several) if several.iter().any(|one| ptr::eq(*one, *chip)) => {
                who.chips.push(chip);
            }
            Recognised::Sibling(sibling) => who.sibling = Some(sibling),
            Recognised::Chip(_) | Recognised::Ambiguous(_) | Recognised::Unknown => {}
        }
    }
    Ok(who)
}

/// The one chip that is at an address the user has named.
pub fn find(subject: &str, open: &Open<'_>, clock: &Arc<dyn Clock>) -> Result<&'static Chip> {
    let failed = |cause| Err(Error::new(subject, cause).at(Step::Identify));
    let plausible = candidates(open, clock).map_err(|error| error.within(subject))?;
    if plausible.is_empty() {
        return failed(Cause::Gone(STRANGE.into()));
    }
    let who = identify(&plausible, open, clock).map_err(|error| error.within(subject))?;
    match (&who.chips[..], who.sibling) {
        ([one], _) => Ok(one),
        ([], Some(Sibling { like: Some(chip), .. })) => Ok(chip),
        ([], Some(sibling)) => {
            failed(Cause::Gone(format!("it is a {}, which gaugefs does not support", sibling.name)))
        }
        ([], None) => {
            let Answers { device_type, firmware_version, hardware_version, .. } = who.answers;
            failed(Cause::Gone(format!(
                "device type 0x{device_type:04x}, firmware 0x{firmware_version:04x}, hardware \
                 0x{hardware_version:04x} is no part that gaugefs knows; see: gaugefs chips"
            )))
        }
        (several, _) => {
            let names: Vec<_> = several.iter().map(|chip| chip.name).collect();
            failed(Cause::Invalid(format!("it may be any of {}; say which with --chip", names.join(", "))))
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;
    use crate::clock::SimClock;
    use crate::sim::{Options, Sim};

    /// An EEPROM: a pointer, bytes, and no patience for writes.
    struct Eeprom(u8);

    impl Bus for Eeprom {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
            assert!(write.len() <= 1, "the EEPROM was written to");
            read.fill(self.0);
            Ok(())
        }
    }

    #[test]
    fn an_eeprom_is_read_and_left_alone() {
        let clock: Arc<dyn Clock> = Arc::new(SimClock::new());
        for byte in [0x00, 0x41, 0xff] {
            let open = || Ok(Box::new(Eeprom(byte)) as Box<dyn Bus>);
            assert!(candidates(&open, &clock).expect("it answers").is_empty());
            find("here", &open, &clock).expect_err("not a gauge");
            let mut gauge = gauge(CHIPS[0], &open, &clock).expect("it opens");
            look(&mut gauge).expect_err("not a gauge");
        }
    }

    #[test]
    fn each_simulated_gauge_is_found_by_asking_it() {
        for chip in CHIPS {
            let clock: Arc<dyn Clock> = Arc::new(SimClock::new());
            let Ok(sim) = Sim::new(chip.name, &Options::default(), clock.clone()) else { continue };
            clock.sleep(std::time::Duration::from_secs(1));
            let open = || Ok(Box::new(sim.bus()) as Box<dyn Bus>);
            assert_eq!(find("here", &open, &clock).expect("a gauge").name, chip.name);
            let plausible = candidates(&open, &clock).expect("it answers");
            assert!(plausible.iter().any(|reading| reading.chip.name == chip.name));
        }
    }

    /// A gauge that answers as its sibling does, and takes down which questions were put to it.
    struct Sister {
        inner: Box<dyn Bus>,
        sibling: &'static Sibling,
        code: u16,
        asked: Arc<Mutex<Vec<u16>>>,
    }

    impl Bus for Sister {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
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
                ([0x00], 0x0002) => identity.firmware.first().copied(),
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
    fn each_sibling_is_named_and_asked_for_its_name_only() {
        for sibling in SIBLINGS {
            // Those without a chip that they are like: what has the registers of their time.
            let chip = match (sibling.like, sibling.identity.device_type) {
                (Some(like), _) => like,
                (None, 0x0520) => Chip::by_name("bq27520-g3").expect("a chip"),
                (None, _) => Chip::by_name("bq27441-g1").expect("a chip"),
            };
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
            assert_eq!(who.sibling.map(|found| found.name), Some(sibling.name));
            assert!(who.chips.is_empty(), "{}: {:?}", sibling.name, who.chips);
            let found = find("here", &open, &clock);
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
        // FULL ACCESS with the manual's keys, then told to go there, as a flash programmer does.
        for word in [0x0414_u16, 0x3672, 0xffff, 0xffff, 0x0f00] {
            let [low, high] = word.to_le_bytes();
            sim.bus().transfer(&[0x00, low, high], &mut []).expect("it takes the word");
            clock.sleep(std::time::Duration::from_millis(100));
        }
        assert_eq!(answers_in_rom(&mut rom), Ok(true));
        let open = || Ok(Box::new(sim.bus()) as Box<dyn Bus>);
        let error = candidates(&open, &clock).expect_err("it has left the other address");
        assert_eq!(error.errno(), nix::errno::Errno::ENXIO);
        assert_eq!(answers_in_rom(&mut Eeprom(0x41)), Ok(true));
    }

    #[test]
    fn an_empty_address_is_told_as_such() {
        let clock: Arc<dyn Clock> = Arc::new(SimClock::new());
        let sim = Sim::new(CHIPS[0].name, &Options::default(), clock.clone()).expect("a gauge");
        let open = || Ok(Box::new(sim.bus_at(0x50)) as Box<dyn Bus>);
        let error = candidates(&open, &clock).expect_err("nobody is there");
        assert_eq!(error.errno(), nix::errno::Errno::ENXIO);
    }
}
