// SPDX-License-Identifier: MIT

//! Checks that need the unsealed gauge: whether the table's addresses are this firmware's, whether the
//! voltage lets the gauge program flash and will let it, and whether the values are safe.

use super::blocks::old_bytes;
use super::schemes::{Care, sequence};
use super::state::{once_measured, read_bits, read_word};
use super::window::locate;
use super::window::{Planned, Window};
use super::{Change, Place};
use crate::chip::{Chip, Gate, Parameter, Role, Safe};
use crate::codec::{FREEZING, Layout, WINDOW};
use crate::error::{Cause, Error, Reason, Result, Step};
use crate::gauge::{Gauge, agreed};
use crate::value::Value;

pub(super) fn check_safe(chip: &Chip, change: &Change, planned: &[Planned]) -> Result<()> {
    let Some((_, parameter)) = change.row else { return Ok(()) };
    let number = integer(chip.layout, parameter, &change.bytes);
    let refuse = |reason| Err(Error::of(change.subject(), reason).at(Step::Check));
    for limit in parameter.safe.iter().flat_map(Safe::each) {
        match limit {
            Safe::Under(other, by, why) => {
                let greatest = value_at(chip, change, planned, *other, why)? - i64::from(*by);
                if number > greatest {
                    return refuse(Reason::UnsafeAbove { number, greatest, why });
                }
            }
            Safe::Over(other, by, why) => {
                let least = value_at(chip, change, planned, *other, why)? + i64::from(*by);
                if number < least {
                    return refuse(Reason::Unsafe { number, least, why });
                }
            }
            Safe::AtLeast(..) | Safe::Within(..) => change.check_limits()?,
            // `check_gate_after` judges the one together with the other values, `check_now` the others.
            Safe::BelowVoltage(_) | Safe::AboveNow(..) | Safe::BelowNow(..) | Safe::All(_) => {}
            Safe::Keep(..) if change.saved => {}
            Safe::Keep(..) => change.check_reserved(&old_bytes(change, planned))?,
        }
    }
    Ok(())
}

/// Refuses a threshold that what is measured now is beyond: it would take effect at once. One that stays is no matter.
pub(super) fn check_now(gauge: &mut Gauge, change: &Change, planned: &[Planned]) -> Result<()> {
    let Some((_, parameter)) = change.row else { return Ok(()) };
    if old_bytes(change, planned) == change.bytes {
        return Ok(());
    }
    let number = integer(gauge.chip.layout, parameter, &change.bytes);
    for limit in parameter.safe.iter().flat_map(Safe::each) {
        let reason = match *limit {
            Safe::AboveNow(role, by, why) => {
                let least = measured_now(gauge, role)?.1 + i64::from(by);
                (number < least).then_some(Reason::Unsafe { number, least, why })
            }
            Safe::BelowNow(role, by, why) => {
                let greatest = measured_now(gauge, role)?.0 - i64::from(by);
                (number > greatest).then_some(Reason::UnsafeAbove { number, greatest, why })
            }
            _ => None,
        };
        if let Some(reason) = reason {
            return Err(Error::of(change.subject(), reason).at(Step::Check));
        }
    }
    Ok(())
}

/// The least and the greatest of two readings, in the unit of parameters: temperatures in 0.1 degrees Celsius.
fn measured_now(gauge: &mut Gauge, role: Role) -> Result<(i64, i64)> {
    let register = gauge.chip.register(role).expect("the tables' tests ask for it");
    let mut look = || {
        let reading = i64::from(read_word(gauge, register.source)?);
        match register.values.hold(reading) {
            true => Ok(if role == Role::Temp { reading - FREEZING } else { reading }),
            false => {
                let why = "not measured yet, and this threshold must not be beyond it; try again";
                Err(Error::new(format!("{}()", register.name), Cause::NotNow, why).at(Step::Check))
            }
        }
    };
    let (one, other) = (look()?, look()?);
    Ok((one.min(other), one.max(other)))
}

/// What another row of the change's subclass will hold, as the blocks of the write show it.
fn value_at(chip: &Chip, change: &Change, planned: &[Planned], other: u16, why: &str) -> Result<i64> {
    let subclass = change.place.subclass;
    let byte = |offset| planned.iter().find_map(|block| block.at((subclass, offset)).map(|at| block.new[at]));
    let value = chip.parameter(subclass, other).and_then(|row| {
        let bytes: Option<Vec<u8>> = (other..other + row.kind.size() as u16).map(byte).collect();
        Some(integer(chip.layout, row, &bytes?))
    });
    value.ok_or_else(|| {
        let why = format!("{why}, and the write does not show what is stored there");
        Error::new(change.subject(), Cause::NotNow, why).at(Step::Check)
    })
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct Setting {
    pub(super) limit: i64,
    /// 1 if the part has none.
    pub(super) divider: i64,
    pub(super) external: bool,
    cells: i64,
}

impl Setting {
    /// The values that a gauge has now, without the number of cells: should it count, the write stores nothing and fails.
    pub(super) fn now(limit: i16, divider: u16) -> Self {
        Self { limit: limit.into(), divider: divider.into(), external: false, cells: 1 }
    }

    /// The values after the first `stored` of the blocks. What no block holds is as `known` and `cells` say.
    pub(super) fn of(
        (gate, layout): (&Gate, Layout),
        known: (i16, u16),
        cells: u8,
        planned: &[Planned],
        stored: usize,
    ) -> Self {
        let byte = |row, otherwise| {
            let changed = planned[..stored].iter().rev().filter(|block| block.changes(row));
            let new = changed.filter_map(|block| block.at(row).map(|at| block.new[at])).next();
            let old = || planned.iter().find_map(|block| block.at(row).map(|at| block.old[at]));
            new.or_else(old).unwrap_or(otherwise)
        };
        let word = |row, otherwise: u16| {
            let ([first, second], [high, low]) = (both(row), layout.bytes_of(otherwise));
            layout.word([byte(first, high), byte(second, low)])
        };
        let external = gate.external.as_ref();
        Self {
            limit: (word(gate.limit, known.0 as u16) as i16).into(),
            divider: gate.divider.map_or(known.1, |row| word(row, known.1)).into(),
            external: external.is_some_and(|external| byte(external.byte, 0) & external.mask != 0),
            cells: gate.cells.map_or(1, |row| byte(row, cells)).into(),
        }
    }

    /// By how much the voltage at the pin is multiplied; `None` where no source says.
    fn factor(&self, gate: &Gate) -> Option<i64> {
        let external = gate.external.as_ref().filter(|_| self.external);
        let factor = external.map_or(Some(1), |external| external.factor)?;
        Some(self.divider * i64::from(factor))
    }

    /// Why the gate is shut at a Voltage(): every documented way to compare must open it, and no division rounds.
    pub(super) fn shut(
        &self,
        gate: &Gate,
        voltage_mv: i64,
        remedy: impl FnOnce() -> String,
    ) -> Option<Reason> {
        let Self { limit, divider, .. } = *self;
        let cells = self.cells.max(1);
        let scaled = gate.cell_divider.map(i64::from).filter(|cell| voltage_mv * cell < limit * divider);
        let compared = match scaled {
            _ if voltage_mv < limit * cells && cells > 1 => format!(", {} mV per cell,", voltage_mv / cells),
            _ if voltage_mv < limit * cells => String::new(),
            Some(cell) => format!(", {} mV at a Voltage Divider of {cell},", voltage_mv * cell / divider),
            None => return None,
        };
        let place = Place::from(gate.limit).to_string();
        Some(Reason::FlashVoltage { value: voltage_mv, least: limit, compared, place, remedy: remedy() })
    }

    /// Why the gate is shut with the values `after`, from the lowest and the highest Voltage() with these.
    pub(super) fn shut_after(&self, after: &Self, gate: &Gate, low_mv: u16, high_mv: u16) -> Option<String> {
        let (mut low, mut high) = (i64::from(low_mv), i64::from(high_mv));
        if after.limit <= 0 {
            return None;
        }
        if (self.divider, self.external) != (after.divider, after.external) {
            let switched = self.external != after.external;
            let factors = self.factor(gate).filter(|factor| *factor > 0).zip(after.factor(gate));
            let factors =
                factors.or((!switched && self.divider > 0).then_some((self.divider, after.divider)));
            let name = gate.external.as_ref().map_or("the divider", |external| external.name);
            let Some((old, new)) = factors else {
                return Some(format!("nothing tells what Voltage() will read ({name})"));
            };
            // Voltage() is rounded, by half a millivolt at most.
            low = (2 * low - 1).max(0) * new / (2 * old);
            high = ((2 * high + 1) * new + 2 * old - 1) / (2 * old);
            if after.external && switched && high > after.divider {
                return Some(format!(
                    "Voltage() would be {high} mV and the converter ends at {} mV (is there an external divider for \
                     {name}?)",
                    after.divider
                ));
            }
            if high > u16::MAX.into() {
                return Some(format!("Voltage() would be {high} mV, which it cannot show"));
            }
        }
        after.shut(gate, low, String::new).map(|shut| shut.to_string())
    }
}

impl Gate {
    pub(super) fn rows(&self) -> impl Iterator<Item = (u8, u16)> {
        let words = [Some(self.limit), self.divider].into_iter().flatten().flat_map(both);
        words.chain(self.external.as_ref().map(|external| external.byte)).chain(self.cells)
    }
}

impl Change {
    pub(super) fn covers(&self, (subclass, offset): (u8, u16)) -> bool {
        let start = usize::from(self.place.offset);
        self.place.subclass == subclass && (start..start + self.bytes.len()).contains(&offset.into())
    }
}

impl Planned {
    pub(super) fn at(&self, (subclass, offset): (u8, u16)) -> Option<usize> {
        let at = usize::from(offset.checked_sub(self.place.base)?);
        (self.place.subclass == subclass && at < WINDOW).then_some(at)
    }

    pub(super) fn changes(&self, row: (u8, u16)) -> bool {
        self.at(row).is_some_and(|at| self.old[at] != self.new[at])
    }
}

pub(super) fn both((subclass, offset): (u8, u16)) -> [(u8, u16); 2] {
    [(subclass, offset), (subclass, offset + 1)]
}

pub(super) fn place_of((subclass, offset): (u8, u16)) -> (Window, usize) {
    locate(subclass, offset)
}

pub(super) fn short_word(gauge: &mut Gauge, row: (u8, u16)) -> Result<u16> {
    let (place, at) = place_of(row);
    sequence(gauge).word(gauge, place, at)
}

pub(super) fn calibration_enabled(gauge: &mut Gauge) -> Result<bool> {
    let Some((source, mask)) = gauge.chip.gate.as_ref().and_then(|gate| gate.calibration) else {
        return Ok(false);
    };
    agreed("the bit that allows calibration", || Ok(read_bits(gauge, source)? & mask != 0))
}

/// How flash is opened where Voltage() is low because the divider is not set.
pub(super) fn remedy(gate: &Gate) -> String {
    let Some(divider) = gate.divider else { return String::new() };
    let (limit, divider) = (Place::from(gate.limit), Place::from(divider));
    let external = gate.external.as_ref().map_or("", |external| external.name);
    let bring_up = match gate.calibration {
        Some(_) => {
            "run `gaugefs bringup`, which enables calibration (CAL_ENABLE, 0x002d) and so opens flash, or "
        }
        None => "",
    };
    format!(
        "; if Voltage() is low because the divider is not set, {bring_up}raise the voltage at the gauge until {limit} is \
         lowered, and then write {divider}, {external} and {limit} in one transaction"
    )
}

/// Why the gate is shut by present values: a loss of power may have erased the divider, or the bit that switches it.
pub(super) fn shut(gauge: &mut Gauge) -> Result<Option<Error>> {
    let voltage = gauge.chip.register(Role::VoltageNow).map(|register| register.source);
    let Some((gate, voltage)) = gauge.chip.gate.as_ref().zip(voltage) else { return Ok(None) };
    let layout = gauge.chip.layout;
    let mut word = |row| {
        let (place, at) = place_of(row);
        sequence(gauge).load(gauge, place, Care::Sure).map(|window| layout.word([window[at], window[at + 1]]))
    };
    let limit = word(gate.limit)? as i16;
    let now = Setting::now(limit, gate.divider.map(&mut word).transpose()?.unwrap_or(1));
    let twice = |gauge: &mut Gauge| Ok(read_word(gauge, voltage)?.max(read_word(gauge, voltage)?));
    let highest = once_measured(gauge, twice, |&highest| highest)?;
    let remedy = || ": charge the pack, or raise the voltage at the gauge".into();
    let Some(shut) = now.shut(gate, highest.into(), remedy) else { return Ok(None) };
    let is_open = calibration_enabled(gauge)?;
    Ok((!is_open).then(|| Error::of("", shut).at_place(gate.limit).at(Step::Verify)))
}

pub(super) fn integer(layout: Layout, parameter: &Parameter, bytes: &[u8]) -> i64 {
    match layout.decode(parameter.kind, bytes) {
        Value::Int(number) => number,
        Value::Float(_) | Value::Text(_) => 0,
    }
}
