//! Finding out what answers at an address, without harm to what is not a gauge.
//!
//! An EEPROM may sit at a gauge's address, and for it "Control(DEVICE_TYPE)" is a write. So the registers
//! are read first, which takes no more than a register pointer, and judged: Control() goes only to what
//! reads like a gauge, and only where the user has named the address.

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

const STRANGE: &str = "what answers there does not read like a gauge, so nothing was written to it";

/// Control(DEVICE_TYPE).
const DEVICE_TYPE: u16 = 0x0001;

/// What the registers of a chip's table read at an address.
#[derive(Clone, Debug)]
pub struct Reading {
    /// Whose table it was.
    pub chip: &'static Chip,
    registers: Registers,
}

impl Reading {
    /// What the register that feeds a property reads.
    pub fn value(&self, role: Role) -> Option<i64> {
        self.registers.value(self.chip.register(role)?)
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
    let mut registers = Registers::UNREAD;
    registers.read(gauge, |tier| tier == Tier::Poll)?;
    Ok(Reading { chip: gauge.chip, registers })
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
