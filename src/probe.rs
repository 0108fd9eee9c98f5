//! Finding out which gauge answers at an address, without disturbing other devices.
//!
//! An EEPROM may have a gauge's address, and to it Control(DEVICE_TYPE) is a write. So the registers are read
//! first, which sends only a register pointer. Control() goes only to a device whose registers read like a
//! gauge's, and only at an address that the user has named.

use std::ptr;
use std::sync::Arc;

use crate::bus::{Bus, BusError};
use crate::chip::{CHIPS, Chip, Recognised, Role, SIBLINGS, Sibling, Tier, recognise};
use crate::clock::Clock;
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Answers, Gauge};
use crate::keys::Keys;
use crate::registers::Registers;

/// The address at which a gauge in ROM mode answers.
pub const ROM_ADDRESS: u8 = 0x0b;

const STRANGE: &str = "the device at this address does not read like a gauge, so nothing was written to it";

/// Control(DEVICE_TYPE).
const DEVICE_TYPE: u16 = 0x0001;

/// The polled registers of a chip, as the device at an address answers.
#[derive(Clone, Debug)]
pub struct Reading {
    /// The chip whose registers were read.
    pub chip: &'static Chip,
    registers: Registers,
}

impl Reading {
    /// The value of the register that feeds a property.
    pub fn value(&self, role: Role) -> Option<i64> {
        self.registers.value(self.chip.register(role)?)
    }

    /// Whether these can be a gauge's values: a temperature between -50 and 125 degrees Celsius, and
    /// percentages of at most 100.
    pub fn is_plausible(&self) -> bool {
        let within = |role, min, max| self.value(role).is_none_or(|value| min <= value && value <= max);
        self.value(Role::Temp).is_some()
            && within(Role::Temp, 2231, 3981)
            && within(Role::Capacity, 0, 100)
            && within(Role::CapacityErrorMargin, 0, 100)
            && within(Role::StateOfHealth, 0, 100)
    }
}

/// Opens a bus to the address.
pub type Open<'a> = dyn Fn() -> Result<Box<dyn Bus>> + 'a;

fn gauge(chip: &'static Chip, open: &Open<'_>, clock: &Arc<dyn Clock>) -> Result<Gauge> {
    Ok(Gauge::new(chip, open()?, clock.clone(), Keys::default(), false))
}

fn reading(gauge: &mut Gauge) -> Result<Reading> {
    let mut registers = Registers::UNREAD;
    registers.read(gauge, |tier| tier == Tier::Poll)?;
    Ok(Reading { chip: gauge.chip, registers })
}

/// Checks that the device's registers read like the gauge's. Nothing is written.
pub fn check(gauge: &mut Gauge) -> Result<()> {
    if reading(gauge)?.is_plausible() {
        return Ok(());
    }
    Err(Error::new("", Cause::Gone(STRANGE.into())).at(Step::Identify))
}

/// The chips whose registers read plausibly at the address. Fails if no chip's registers could be read at all.
pub fn candidates(open: &Open<'_>, clock: &Arc<dyn Clock>) -> Result<Vec<Reading>> {
    let (mut plausible, mut answered, mut failure) = (Vec::new(), false, None);
    for chip in CHIPS {
        match gauge(chip, open, clock).and_then(|mut gauge| reading(&mut gauge)) {
            Ok(reading) => {
                answered = true;
                plausible.extend(reading.is_plausible().then_some(reading));
            }
            // A part may refuse the registers of another.
            Err(error) if *error.cause() == Cause::Bus(BusError::NoAck) => failure = Some(error),
            Err(error) => return Err(error),
        }
    }
    failure.filter(|_| !answered).map_or(Ok(plausible), Err)
}

/// Whether a device answers at the address of gauges in ROM mode. One byte is read and nothing is written: a
/// smart battery has the same address.
pub fn answers_in_rom(bus: &mut dyn Bus) -> Result<bool> {
    match bus.transfer(&[], &mut [0]) {
        Ok(()) => Ok(true),
        Err(BusError::NoAck) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

/// What the answers to Control() say about a device.
#[derive(Clone, Debug, Default)]
pub struct Who {
    /// Its answers to the questions for the first of `chips`.
    pub answers: Answers,
    /// The chips that give these answers: one, none, or several that only the user can tell apart.
    pub chips: Vec<&'static Chip>,
    /// A part without a table that gives these answers.
    pub sibling: Option<&'static Sibling>,
}

/// Identifies a device that reads like a gauge, by the questions for each of the plausible chips.
///
/// All chips have DEVICE_TYPE at the same code; the other questions follow only if the type fits.
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

/// The chip at an address that the user has named.
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
                 0x{hardware_version:04x}: unknown part; `gaugefs chips` lists the known ones"
            )))
        }
        (several, _) => {
            let names: Vec<_> = several.iter().map(|chip| chip.name).collect();
            failed(Cause::Invalid(format!("it may be any of {}; choose with --chip", names.join(", "))))
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;
    use crate::clock::SimClock;
    use crate::sim::{Options, Sim};

    /// An EEPROM whose bytes are all the same. It takes an address, and must not be written to.
    struct Eeprom(u8);

    impl Bus for Eeprom {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
            assert!(write.len() <= 1, "the EEPROM was written to");
            read.fill(self.0);
            Ok(())
        }
    }

    #[test]
    fn an_eeprom_is_not_written_to() {
        let clock: Arc<dyn Clock> = Arc::new(SimClock::new());
        for byte in [0x00, 0x41, 0xff] {
            let open = || Ok(Box::new(Eeprom(byte)) as Box<dyn Bus>);
            assert!(candidates(&open, &clock).expect("it answers").is_empty());
            find("here", &open, &clock).expect_err("not a gauge");
            let mut gauge = gauge(CHIPS[0], &open, &clock).expect("it opens");
            check(&mut gauge).expect_err("not a gauge");
        }
    }

    #[test]
    fn each_simulated_gauge_is_identified() {
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

    /// A gauge that gives its sibling's answers, and records the subcommands that it is sent.
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
    fn each_sibling_is_named_and_sent_nothing_but_identification() {
        for sibling in SIBLINGS {
            // The siblings that are like no chip: one of the same generation.
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
            assert_eq!(*asked.lock().expect("no panic"), [], "{}: reading sends no subcommand", sibling.name);
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
    fn an_empty_address_is_not_acknowledged() {
        let clock: Arc<dyn Clock> = Arc::new(SimClock::new());
        let sim = Sim::new(CHIPS[0].name, &Options::default(), clock.clone()).expect("a gauge");
        let open = || Ok(Box::new(sim.bus_at(0x50)) as Box<dyn Bus>);
        let error = candidates(&open, &clock).expect_err("nobody is there");
        assert_eq!(error.errno(), nix::errno::Errno::ENXIO);
    }
}
