//! Finding out which gauge answers at an address, without disturbing other devices.
//!
//! An EEPROM may have a gauge's address, and to it Control(DEVICE_TYPE) is a write. So the registers are read
//! first, which sends only a register pointer. Control() goes only to a device whose registers read like a
//! gauge's, and only at an address that the user has named.

use std::ptr;
use std::sync::Arc;

use crate::chip::{CHIPS, Chip, Recognised, Role, SIBLINGS, Sibling, Tier, recognise};
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Answers, Gauge};
use crate::keys::Keys;
use crate::registers::Registers;
use gauge_bus::clock::Clock;
use gauge_bus::{Bus, BusError};

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
            Err(error) if matches!(error.cause(), Cause::Bus(bus) if bus.may_be_no_ack()) => {
                failure = Some(error);
            }
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
