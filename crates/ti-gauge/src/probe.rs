// SPDX-License-Identifier: MIT

//! Finds out which gauge answers at an address, without disturbing other devices.
//!
//! An EEPROM may have a gauge's address, and to it Control(DEVICE_TYPE) is a write. So the registers are read first;
//! Control() goes only to a device that reads like a gauge, at an address that the user has named.

use std::ptr;
use std::sync::Arc;
use std::time::Duration;

use crate::chip::{CHIPS, Chip, Recognised, Role, SIBLINGS, Sibling, Tier, bursts, recognise};
use crate::error::{Cause, Error, Reason, Result, Step};
use crate::gauge::{Answers, Gauge};
use crate::keys::Keys;
use crate::registers::Registers;
use gauge_bus::clock::Clock;
use gauge_bus::{Bus, BusError, Reach};

/// The address of a gauge in ROM mode.
pub const ROM_ADDRESS: u8 = 0x0b;

const STRANGE: &str = "the device at this address does not read like a gauge, so nothing was written to it";

/// A gauge's watchdog allows each standard command twice in this time.
const SECOND: Duration = Duration::from_secs(1);

const DEVICE_TYPE: u16 = 0x0001;

/// The polled registers of a chip, read from the device at an address.
#[derive(Clone, Debug)]
pub struct Reading {
    /// The chip whose registers were read.
    pub chip: &'static Chip,
    registers: Registers,
}

impl Reading {
    /// The value of the register for a property, in the role's unit.
    pub fn value(&self, role: Role) -> Option<i64> {
        self.registers.property(role)
    }

    /// Whether these can be a gauge's: between -50 and 125 degrees Celsius, and percentages of at most 100.
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

/// An address, and the way to its device.
pub struct Target<'a> {
    /// Opens a bus to it.
    pub open: &'a Open<'a>,
    /// Clock for waiting.
    pub clock: &'a Arc<dyn Clock>,
    /// What the device takes, at any clock of the bus.
    pub reach: Reach,
    /// Clock of the bus, if known.
    pub clock_hz: Option<u32>,
}

impl Target<'_> {
    fn gauge(&self, chip: &'static Chip) -> Result<Gauge> {
        let gauge = Gauge::new(chip, (self.open)()?, self.clock.clone(), Keys::default());
        Ok(gauge.within(self.reach.narrowed(chip.reach_at(self.clock_hz))))
    }
}

fn is_polled(tier: Tier) -> bool {
    tier == Tier::Poll
}

fn reading(gauge: &mut Gauge) -> Result<Reading> {
    let mut registers = Registers::unread(gauge.chip.registers);
    registers.read(gauge, is_polled)?;
    Ok(Reading { chip: gauge.chip, registers })
}

/// The polled registers of all chips, as address and length of disjoint reads.
fn spans() -> Vec<(u8, u8)> {
    let mut is_read = [false; 0x80];
    for (start, length) in CHIPS.iter().flat_map(|chip| bursts(chip.registers, is_polled)) {
        is_read[usize::from(start)..usize::from(start + length)].fill(true);
    }
    let mut spans: Vec<(u8, u8)> = Vec::new();
    for (at, _) in (0..).zip(is_read).filter(|(_, is_read)| *is_read) {
        match spans.last_mut() {
            Some((first, all)) if at == *first + *all => *all += 1,
            _ => spans.push((at, 1)),
        }
    }
    spans
}

/// Checks that the device's registers read like the gauge's. Nothing is written.
pub fn check(gauge: &mut Gauge) -> Result<()> {
    let is_one = match gauge.is_its_kind()? {
        Some(is_one) => is_one,
        None => reading(gauge)?.is_plausible(),
    };
    if is_one {
        return Ok(());
    }
    Err(Error::new("", Cause::Gone, STRANGE).at(Step::Identify))
}

/// The chips whose registers read plausibly; an error if none. Twice a second at most, for the gauge's watchdog.
pub fn candidates(target: &Target<'_>) -> Result<Vec<Reading>> {
    let refused = |error: &Error| matches!(error.cause(), Cause::Bus(bus) if bus.may_be_no_ack());
    let mut gauge = target.gauge(CHIPS[0])?;
    let all = CHIPS.iter().map(|&chip| Reading { chip, registers: Registers::unread(chip.registers) });
    let (mut all, mut answered, mut failure) = (all.collect::<Vec<_>>(), false, None);
    for (start, length) in spans() {
        let mut bytes = vec![0; length.into()];
        match gauge.read(start, &mut bytes) {
            Ok(()) => {
                answered = true;
                all.iter_mut().for_each(|reading| reading.registers.fill(start, &bytes));
            }
            Err(error) if refused(&error) => failure = Some(error),
            Err(error) => return Err(error),
        }
    }
    if let Some(error) = failure.take_if(|_| !answered) {
        return Err(error);
    }
    drop(gauge);
    let mut plausible = Vec::new();
    for mut reading in all {
        let chip = reading.chip;
        let polled = || chip.registers.iter().filter(|register| is_polled(register.tier));
        // A part may refuse another part's registers, and with them the whole read.
        if polled().any(|register| reading.registers.value(register).is_none()) {
            target.clock.sleep(SECOND);
            match reading.registers.read(&mut target.gauge(chip)?, is_polled) {
                Ok(()) => {}
                Err(error) if refused(&error) => continue,
                Err(error) => return Err(error),
            }
        }
        plausible.extend(reading.is_plausible().then_some(reading));
    }
    Ok(plausible)
}

/// Whether ROM mode's address answers. One byte is read, nothing written: a smart battery has that address too.
pub fn answers_in_rom(bus: &mut dyn Bus) -> Result<bool> {
    match bus.transfer(&[], &mut [0]) {
        Ok(()) => Ok(true),
        Err(BusError::NoAck) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

/// The identity of a device by its answers to Control().
#[derive(Clone, Debug, Default)]
pub struct Who {
    /// Its answers to the first chip's questions.
    pub answers: Answers,
    /// The chips with these answers. Only the user can tell several apart.
    pub chips: Vec<&'static Chip>,
    /// A part without a table that gives these answers.
    pub sibling: Option<&'static Sibling>,
    /// Chips of this device type whose tables are not for these versions.
    pub unproven: Vec<&'static Chip>,
}

/// Identifies a device that reads like a gauge. All chips have DEVICE_TYPE at one code; chips share other answers.
pub fn identify(plausible: &[Reading], target: &Target<'_>) -> Result<Who> {
    let mut who = Who::default();
    let mut types: Vec<(u8, u16)> = Vec::new();
    let mut asked: Vec<(Questions, Answers)> = Vec::new();
    for Reading { chip, .. } in plausible {
        let mut gauge = target.gauge(chip)?;
        let device_type = match types.iter().find(|(register, _)| *register == chip.identity.answer) {
            Some((_, device_type)) => *device_type,
            None => {
                if !types.is_empty() {
                    target.clock.sleep(SECOND);
                }
                let device_type = gauge.ask(DEVICE_TYPE)?;
                types.push((chip.identity.answer, device_type));
                device_type
            }
        };
        let alike = |sibling: &&Sibling| {
            let is_like = |like: &Chip| !like.has_table() || ptr::eq(like, *chip);
            sibling.identity.device_type == device_type && sibling.like.is_none_or(is_like)
        };
        if device_type != chip.identity.device_type && !SIBLINGS.iter().any(|sibling| alike(&sibling)) {
            if who.answers == Answers::default() {
                who.answers.device_type = device_type;
            }
            continue;
        }
        let questions = questions(chip);
        let answers = match asked.iter().find(|(same, _)| *same == questions) {
            Some((_, answers)) => *answers,
            None => {
                let answers = gauge.identify_type(device_type)?;
                asked.push((questions, answers));
                answers
            }
        };
        if who.chips.is_empty() {
            who.answers = answers;
        }
        match recognise(&answers) {
            Recognised::Chip(one) if ptr::eq(one, *chip) => who.chips.push(one),
            Recognised::Ambiguous(several) if several.iter().any(|one| ptr::eq(*one, *chip)) => {
                who.chips.push(chip);
            }
            // Parts without a table, whose registers are not compared with the device's.
            Recognised::Ambiguous(several) if several.iter().all(|one| !one.has_table()) => {
                who.chips = several;
            }
            Recognised::Sibling(sibling) => who.sibling = Some(sibling),
            Recognised::Unproven(several) if several.iter().any(|one| ptr::eq(*one, *chip)) => {
                who.unproven.push(chip);
            }
            Recognised::Chip(_)
            | Recognised::Ambiguous(_)
            | Recognised::Unproven(_)
            | Recognised::Unknown => {}
        }
    }
    Ok(who)
}

type Questions = (u8, bool, [Option<u16>; 3]);

fn questions(chip: &Chip) -> Questions {
    let code = |name| Some(chip.subcommands.iter().find(|subcommand| subcommand.name == name)?.code);
    (chip.identity.answer, chip.identity.build.is_some(), ["HW_VERSION", "CHEM_ID", "DM_CODE"].map(code))
}

impl Answers {
    /// A hint about an unknown part.
    pub fn unknown(&self) -> &'static str {
        match self.device_type {
            // SLUSBH1C 9.5.4.3, SLUSCB7A 6.11: such a gauge takes the first byte of the two.
            0 => {
                "it answers 0 to DEVICE_TYPE, as no gauge does: it has not started yet, or has not taken both bytes of the \
                 subcommand, as above 100 kHz; try again, also with --byte-writes"
            }
            _ => "unknown part",
        }
    }

    /// The reason for refusing a part with these answers.
    pub fn wrong_part(&self, what: String) -> Reason {
        let Self { device_type, firmware_version: firmware, hardware_version: hardware, .. } = *self;
        Reason::WrongPart { device_type, firmware, hardware, what }
    }
}

/// The chip at an address that the user has named.
pub fn find(subject: &str, target: &Target<'_>) -> Result<&'static Chip> {
    let failed = |reason| Err(Error::of(subject, reason).at(Step::Identify));
    let gone = |why: String| failed(Reason::Text(Cause::Gone, why.into()));
    let plausible = candidates(target).map_err(|error| error.within(subject))?;
    if plausible.is_empty() {
        return gone(STRANGE.into());
    }
    let who = identify(&plausible, target).map_err(|error| error.within(subject))?;
    let chips = if who.chips.is_empty() && who.sibling.is_none() { &who.unproven } else { &who.chips };
    match (&chips[..], who.sibling) {
        ([one], _) => Ok(one),
        ([], Some(Sibling { like: Some(chip), .. })) => Ok(chip),
        ([], Some(sibling)) => gone(format!("it is a {}, which gaugefs does not support", sibling.name)),
        ([], None) => failed(
            who.answers
                .wrong_part(format!("{}; `gaugefs chips` lists the known ones", who.answers.unknown())),
        ),
        (several, _) => {
            let names: Vec<_> = several.iter().map(|chip| chip.name).collect();
            let why = format!("it may be any of {}; choose with --chip", names.join(", "));
            failed(Reason::Text(Cause::Invalid, why.into()))
        }
    }
}
