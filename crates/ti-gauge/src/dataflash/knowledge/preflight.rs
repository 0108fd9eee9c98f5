// SPDX-License-Identifier: MIT

//! Checks before a write unseals the gauge: is it still the gauge whose values were read, is another master using it,
//! would the write interrupt a calibration or a learning cycle. I2C has no error detection, so two looks have to agree
//! on what blocks a write, and on what permits it.

use super::Knowledge;
use crate::chip::{Chip, Kind, Learning, Mode, Register, Role, Source};
use crate::dataflash::io::read_byte;
use crate::dataflash::schemes::sequence;
use crate::dataflash::session::Session;
use crate::dataflash::state::{lost_flag, once_measured, read_bits, read_word};
use crate::dataflash::{Change, Outcome};
use crate::error::{Cause, Error, Reason, Result, Step};
use crate::gauge::{Answers, Gauge, Look, Moment, Seal, Statistics, agreed};
use crate::journal::Identity;

/// Control(ROM_MODE), after which a gauge is a flash programmer at another address.
const ROM_MODE: u16 = 0x0F00;

#[derive(Clone, Copy, Debug)]
pub(in crate::dataflash) struct KnownPack {
    pub(in crate::dataflash) firmware_version: u16,
    /// The word that distinguishes packs; `None` until it has been read.
    pack: Option<u16>,
    /// CycleCount(), which only rises, and DesignCapacity(), as last polled; `None` since a write.
    cycles: Option<u16>,
    design: Option<Design>,
    /// Whether it reported a loss of power then; only for parts with data memory in RAM.
    lost: Option<bool>,
}

impl KnownPack {
    fn new(firmware_version: u16) -> Self {
        Self { firmware_version, pack: None, cycles: None, design: None, lost: None }
    }

    /// Data flash has been written, and with it what the registers show of it.
    pub(in crate::dataflash) fn rewritten(&mut self) {
        (self.pack, self.cycles, self.design) = (None, None, None);
    }
}

/// DesignCapacity(), which a pack's host sets to another unit. Only of one unit it tells packs apart.
#[derive(Clone, Copy, Debug)]
struct Design {
    is_charge: bool,
    number: u16,
}

impl Design {
    fn differ((then, now): (Self, Self)) -> bool {
        then.is_charge == now.is_charge && then.number != now.number
    }
}

struct Distinct {
    pack: Option<u16>,
    cycles: Option<u16>,
    design: Option<Design>,
}

impl Distinct {
    fn of(chip: &Chip, value: impl Fn(Source) -> Option<u32>) -> Self {
        let number = |register: &Register| value(register.source).map(|word| word as u16);
        let pack = chip.serial_register().and_then(number);
        // After a power loss a RAM gauge shows defaults, which identify no pack.
        let of = |role: Role| chip.register(role).filter(|_| chip.volatile.is_none());
        let design = of(Role::ChargeFullDesign).and_then(|register| {
            let is_charge = register.feeds(Role::ChargeFullDesign, |source| value(source).map(i64::from))?;
            Some(Design { is_charge, number: number(register)? })
        });
        Self { pack, cycles: of(Role::CycleCount).and_then(number), design }
    }
}

const LOOKS: u32 = 4;

#[derive(Clone, Copy)]
pub(in crate::dataflash) struct Found {
    pub(in crate::dataflash) seal: Seal,
    pub(in crate::dataflash) status: u32,
    pub(in crate::dataflash) voltage_mv: u16,
    pub(in crate::dataflash) lost: bool,
    /// When the gauge was confirmed.
    pub(in crate::dataflash) moment: Moment,
    look: Look,
}

impl Knowledge {
    pub(in crate::dataflash) fn meet(&mut self, chip: &Chip, answers: &Answers) {
        self.now.arrives();
        let pack = match chip.preflight.pack.as_ref().map(|pack| pack.word) {
            // All subcommands that distinguish packs are named CHEM_ID.
            Some(Source::Answer(_)) => answers.chem_id,
            _ => None,
        };
        let firmware_version = answers.firmware_version;
        self.known_pack = Some(KnownPack { pack, ..KnownPack::new(firmware_version) });
    }

    pub(in crate::dataflash) fn doubts(&self) -> bool {
        self.doubts.is_known(self.now.arrival)
    }

    pub(in crate::dataflash) fn doubt_pack(&mut self) {
        self.doubts.learn(self.now.arrival, ());
    }

    pub(in crate::dataflash) fn needs_second_poll(
        &self,
        chip: &Chip,
        value: impl Fn(Source) -> Option<u32>,
    ) -> bool {
        let cycles = self.known_pack.and_then(|known| known.cycles.zip(Distinct::of(chip, &value).cycles));
        cycles.is_some_and(|(then, now)| then != now) || self.contradicted(chip, value).is_some()
    }

    pub(in crate::dataflash) fn misreads_loss(
        &self,
        gauge: &mut Gauge,
        value: impl Fn(Source) -> Option<u32>,
    ) -> Result<bool> {
        let Some((flags, lost)) = lost_flag(gauge.chip) else { return Ok(false) };
        let shown = value(flags).map(|word| word & lost != 0);
        let Some(shown) =
            shown.filter(|&shown| shown != self.known_pack.and_then(|known| known.lost).unwrap_or(false))
        else {
            return Ok(false);
        };
        let again = read_bits(gauge, flags)?;
        Ok((again & lost != 0) != shown)
    }

    pub(in crate::dataflash) fn contradicted(
        &self,
        chip: &Chip,
        value: impl Fn(Source) -> Option<u32>,
    ) -> Option<&'static str> {
        let known = self.known_pack?;
        let now = Distinct::of(chip, value);
        let changes =
            |then: Option<u16>, now: Option<u16>| then.zip(now).is_some_and(|(then, now)| then != now);
        let falls = |then: Option<u16>, now: Option<u16>| then.zip(now).is_some_and(|(then, now)| then > now);
        let name = chip.preflight.pack.as_ref().map_or("", |pack| pack.name);
        let rows = [
            (now.pack.is_some() && changes(known.pack, now.pack), name),
            (falls(known.cycles, now.cycles), "CycleCount()"),
            (known.design.zip(now.design).is_some_and(Design::differ), "DesignCapacity()"),
        ];
        rows.into_iter().find(|(contradicts, _)| *contradicts).map(|(_, name)| name)
    }

    pub(in crate::dataflash) fn polled(
        &mut self,
        chip: &Chip,
        value: impl Fn(Source) -> Option<u32>,
    ) -> bool {
        let flags = chip.register(Role::Flags).and_then(|flags| value(flags.source));
        let contradicted = self.contradicted(chip, &value).is_some();
        let Distinct { pack, cycles, design } = Distinct::of(chip, value);
        let Some(known_pack) = &mut self.known_pack else { return false };
        if let (Some(bit), Some(flags)) = (chip.volatile, flags) {
            known_pack.lost = Some(flags & bit != 0);
        }
        known_pack.pack = known_pack.pack.or(pack);
        (known_pack.cycles, known_pack.design) = (cycles, design);
        if contradicted {
            self.doubt_pack();
        }
        self.doubts()
    }

    pub(in crate::dataflash) fn preflight(&mut self, gauge: &mut Gauge, changes: &[Change]) -> Result<Found> {
        let first = self.first_look(gauge, changes)?;
        self.next_look(gauge, &first, changes)
    }

    /// One look. What it permits is permitted when [`Self::look_while_opening`] or [`Self::next_look`] agrees.
    pub(in crate::dataflash) fn first_look(
        &mut self,
        gauge: &mut Gauge,
        changes: &[Change],
    ) -> Result<Found> {
        let moment = gauge.moment();
        self.confirm(gauge).map_err(|error| in_rom(gauge.chip, error))?;
        let state = match needs_voltage(gauge.chip, changes) {
            true => once_measured(gauge, read_state, |found| found.voltage_mv)?,
            false => read_state(gauge)?,
        };
        let found = Found { moment, ..state };
        if self.check(gauge.chip, &found, changes).is_ok() {
            return Ok(found);
        }
        let found = Found { moment, ..read_state(gauge)? };
        self.check(gauge.chip, &found, changes).inspect_err(|error| self.doubt(error))?;
        Ok(found)
    }

    /// Opens a session with a gauge that was found sealed. The look that shows it open is the second one at its state.
    pub(in crate::dataflash) fn look_while_opening(
        &mut self,
        gauge: &mut Gauge,
        session: &mut Session,
        first: &Found,
        changes: &[Change],
    ) -> Result<Found> {
        gauge.also_read(along(gauge.chip));
        let opened = session.open(gauge);
        gauge.also_read(Vec::new());
        opened?;
        let second = Found { seal: first.seal, ..Found::of(gauge.chip, gauge.last_look(), first.moment) };
        self.agree(gauge, first, second, changes)
    }

    pub(in crate::dataflash) fn next_look(
        &mut self,
        gauge: &mut Gauge,
        first: &Found,
        changes: &[Change],
    ) -> Result<Found> {
        let second = read_state(gauge)?;
        self.agree(gauge, first, second, changes)
    }

    /// Looks once more at a gauge that is open now.
    pub(in crate::dataflash) fn look_again(
        &mut self,
        gauge: &mut Gauge,
        found: &Found,
        changes: &[Change],
    ) -> Result<Found> {
        let now = Found { seal: found.seal, ..read_state(gauge)? };
        self.agree(gauge, found, now, changes)
    }

    fn agree(
        &mut self,
        gauge: &mut Gauge,
        first: &Found,
        second: Found,
        changes: &[Change],
    ) -> Result<Found> {
        let (mut before, mut now) = (*first, second);
        for _ in 0..LOOKS {
            if before.is_like(&now, gauge.chip) {
                self.check(gauge.chip, &now, changes).inspect_err(|error| self.doubt(error))?;
                let voltage_mv = before.voltage_mv.min(now.voltage_mv);
                return Ok(Found { voltage_mv, moment: first.moment, ..now });
            }
            // One that was opened meanwhile is still the gauge that was found sealed.
            let seal = if now.look.seal == now.seal { None } else { Some(now.seal) };
            (before, now) = (now, read_state(gauge)?);
            now.seal = seal.unwrap_or(now.seal);
        }
        let why = "its state reads differently each time: check the bus";
        Err(Error::new(gauge.chip.model, Cause::NotNow, why).at(Step::Check))
    }

    /// Makes sure that the gauge is the one whose values were read: type, firmware, and the distinguishing word. With a
    /// register as that word the type is not read: another part has something else at that address.
    pub(in crate::dataflash) fn confirm(&mut self, gauge: &mut Gauge) -> Result<()> {
        let chip = gauge.chip;
        let pack = chip.preflight.pack.as_ref();
        if chip.serial_register().is_none() {
            gauge.confirm_identity().inspect_err(|error| self.doubt(error))?;
        }
        let firmware_version = match self.known_pack {
            Some(known_pack) => {
                let other = differs(gauge, Gauge::firmware_version, known_pack.firmware_version)?;
                self.same(chip, "firmware", known_pack.firmware_version, other)?;
                known_pack.firmware_version
            }
            None => {
                let known =
                    |version| chip.identity.firmware.is_empty() || chip.identity.firmware.contains(&version);
                let mut version = gauge.firmware_version()?;
                if !known(version) {
                    version = gauge.firmware_version()?;
                }
                if !known(version) {
                    let why = format!(
                        "firmware is 0x{version:04x}, which this table does not cover; mount it anew"
                    );
                    return Err(Error::new(chip.model, Cause::Gone, why).at(Step::Identify));
                }
                version
            }
        };
        gauge.confirm_build()?;
        let known_pack = self.known_pack.get_or_insert(KnownPack::new(firmware_version));
        let Some(pack) = pack else { return Ok(()) };
        let now = agreed(pack.name, || read_word(gauge, pack.word))?;
        let expected = *known_pack.pack.get_or_insert(now);
        self.same(chip, pack.name, expected, Some(now).filter(|&now| now != expected))?;
        if chip.serial_register().is_some() {
            self.identity.learn(self.now.name, Identity::of(chip, firmware_version, now));
        }
        Ok(())
    }

    fn same(&mut self, chip: &Chip, what: &str, expected: u16, other: Option<u16>) -> Result<()> {
        let Some(other) = other else { return Ok(()) };
        let reason = Reason::OtherPack { expected, found: other, what: what.into() };
        let error = Error::of(chip.model, reason).at(Step::Identify);
        self.doubt(&error);
        Err(error)
    }

    fn doubt(&mut self, error: &Error) {
        if matches!(error.cause(), Cause::Gone) {
            self.doubt_pack();
        }
    }

    fn check(&self, chip: &Chip, found: &Found, changes: &[Change]) -> Result<()> {
        let flags = chip.volatile.zip(chip.register(Role::Flags));
        if let Some((bit, flags)) = flags
            && found.word(flags.source).is_some_and(|flags| flags & bit != 0)
            && self.known_pack.is_some_and(|known_pack| known_pack.lost == Some(false))
        {
            let why = "set, and was not when its values were read: the gauge has lost its power, and its data memory \
                       with it; check its values before you write";
            return Err(Error::new("Flags() [ITPOR]", Cause::Gone, why).at(Step::Check));
        }
        for mode in chip.preflight.modes {
            let Some(word) = found.word(mode.word) else { continue };
            if !(mode.ours && self.mode_left_on) {
                off(mode, word)?;
            }
        }
        match chip.preflight.voltage_mv {
            Some((min, max)) if !(min..=max).contains(&found.voltage_mv) && needs_voltage(chip, changes) => {
                let reason = Reason::Supply { value: found.voltage_mv, least: min, greatest: max };
                Err(Error::of("Voltage()", reason).of_register().at(Step::Check))
            }
            _ => Ok(()),
        }
    }

    pub(in crate::dataflash) fn learn_from(
        &mut self,
        gauge: &Gauge,
        changes: &[Change],
        outcome: &Result<Outcome>,
    ) {
        let rows = gauge.chip.preflight.pack.as_ref().map_or(&[][..], |pack| pack.rows);
        let touched = changes.iter().any(|change| rows.iter().any(|&row| change.is_at(row)));
        let Some(known_pack) = &mut self.known_pack else { return };
        match outcome {
            Ok(Outcome::Unchanged) => Statistics::count(&gauge.statistics.unchanged_writes),
            Ok(Outcome::Written { .. }) => {
                self.mode_left_on = false;
                // The end of CONFIG UPDATE clears [ITPOR].
                known_pack.lost = gauge.chip.volatile.map(|_| false);
            }
            Err(error) => {
                self.mode_left_on |= matches!(error.cause(), Cause::StateUnknown);
                if matches!(error.cause(), Cause::StateUnknown | Cause::RolledBack) {
                    known_pack.lost = None;
                }
            }
        }
        if !matches!(outcome, Ok(Outcome::Unchanged)) {
            (known_pack.cycles, known_pack.design) = (None, None);
            if touched {
                known_pack.pack = None;
            }
        }
    }
}

/// Why changes with a reset must wait for a learning cycle. Called before any block is read: that may use the window.
pub(in crate::dataflash) fn learning(
    gauge: &mut Gauge,
    status: u32,
    changes: &[Change],
) -> Result<Option<Error>> {
    let resets = changes.iter().any(|change| change.kind(gauge.chip) == Kind::Reset)
        || sequence(gauge).always_finishes();
    let Some(learning) = gauge.chip.preflight.learning.as_ref().filter(|_| resets) else {
        return Ok(None);
    };
    if !learning.may_run(status) || matches!(changes, [one] if one.is_at(learning.row)) {
        return Ok(None);
    }
    if !agreed(learning.name, || learning.runs(gauge))? {
        return Ok(None);
    }
    let why = "a learning cycle is active, and the reset that this write needs would end it: wait until Qmax and Ra are \
               learned, or mount with --allow-learning";
    Ok(Some(Error::new(learning.name, Cause::Busy, why).at(Step::Check)))
}

impl Change {
    fn is_at(&self, row: (u8, u16)) -> bool {
        (self.place.subclass, self.place.offset) == row
    }
}

impl Found {
    fn of(chip: &Chip, look: Look, moment: Moment) -> Self {
        let found = Self { seal: look.seal, status: look.status, voltage_mv: 0, lost: false, moment, look };
        Self {
            voltage_mv: found.word(voltage(chip)).unwrap_or_default() as u16,
            lost: lost_flag(chip)
                .is_some_and(|(flags, lost)| found.word(flags).is_some_and(|word| word & lost != 0)),
            ..found
        }
    }

    /// A word that the look has shown; `None` for an answer to a subcommand, which takes a question of its own.
    fn word(&self, source: Source) -> Option<u32> {
        self.look.word(source)
    }

    /// Whether a later look decides the same. A voltage moves; one with a wrong bit that matters is further off.
    fn is_like(&self, later: &Self, chip: &Chip) -> bool {
        let decides = |found: &Self| {
            let modes = chip.preflight.modes.iter();
            let modes = modes.map(|mode| found.word(mode.word).map(|word| word & mode.mask));
            let learning = chip.preflight.learning.as_ref();
            let voltage = chip.preflight.voltage_mv.map(|(min, max)| (min..=max).contains(&found.voltage_mv));
            let learns = learning.is_some_and(|learning| learning.may_run(found.status));
            (found.seal, found.lost, modes.collect::<Vec<_>>(), learns, voltage)
        };
        let (low, high) = (self.voltage_mv.min(later.voltage_mv), self.voltage_mv.max(later.voltage_mv));
        decides(self) == decides(later) && high - low <= high / 8
    }
}

impl Learning {
    fn may_run(&self, status: u32) -> bool {
        status & self.status == self.status
    }

    fn runs(&self, gauge: &mut Gauge) -> Result<bool> {
        let state = match self.shown {
            None => read_byte(gauge, self.row)?.into(),
            Some(source) => read_bits(gauge, source)?,
        };
        Ok(state & u32::from(self.mask) == u32::from(self.value))
    }
}

/// The answer, if it differs from the expected one twice in a row.
fn differs(gauge: &mut Gauge, ask: impl Fn(&mut Gauge) -> Result<u16>, expected: u16) -> Result<Option<u16>> {
    if ask(gauge)? == expected {
        return Ok(None);
    }
    Ok(Some(ask(gauge)?).filter(|&again| again != expected))
}

fn voltage(chip: &Chip) -> Source {
    chip.register(Role::VoltageNow).expect("the tables' tests ask for Voltage()").source
}

fn along(chip: &Chip) -> Vec<Source> {
    let modes = chip.preflight.modes.iter().map(|mode| mode.word);
    let flags = chip.register(Role::Flags).filter(|_| chip.volatile.is_some()).map(|flags| flags.source);
    let all = modes.chain(flags).chain([voltage(chip)]);
    all.filter(|source| source.command().is_some()).collect()
}

/// Whether the voltage decides about a write. Restoring RAM that lost its power is harmless at any.
fn needs_voltage(chip: &Chip, changes: &[Change]) -> bool {
    chip.preflight.voltage_mv.is_none() || !changes.iter().all(|change| change.saved)
}

fn read_state(gauge: &mut Gauge) -> Result<Found> {
    gauge.also_read(along(gauge.chip));
    let moment = gauge.moment();
    let look = gauge.look_at_status();
    gauge.also_read(Vec::new());
    look.map(|look| Found::of(gauge.chip, look, moment))
}

pub(in crate::dataflash) fn check_unsealed(gauge: &mut Gauge) -> Result<()> {
    for mode in gauge.chip.preflight.modes {
        let Source::Answer(code) = mode.word else { continue };
        off(mode, agreed(mode.name, || Ok(u32::from(gauge.ask(code)?) & mode.mask))?)?;
    }
    Ok(())
}

fn off(mode: &Mode, word: u32) -> Result<()> {
    if word & mode.mask == 0 {
        return Ok(());
    }
    let reason = Reason::Mode { word, what: mode.what, remedy: mode.remedy };
    Err(Error::of(mode.name, reason).at(Step::Check))
}

/// A gauge that does not answer may have been left in ROM mode by a flash programmer.
fn in_rom(chip: &Chip, error: Error) -> Error {
    if chip.subcommand(ROM_MODE).is_none() || error.cause() != Cause::Bus(gauge_bus::BusError::NoAck) {
        return error;
    }
    let why = format!(
        "not acknowledged; is the gauge powered and connected? One that a flash programmer left in ROM mode answers at \
         0x0b only: {}",
        chip.way_out_of_rom()
    );
    Error::new(chip.model, Cause::NoAnswer, why).at(Step::Identify)
}
