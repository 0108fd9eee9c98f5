// SPDX-License-Identifier: MIT

//! What a gauge should hold for a battery: rows that differ, and what no row can give it.
//!
//! Only rows whose address and meaning have a source are wanted. Calibration, keys, chemistry and what the gauge learns are
//! never among them: those are steps, with what to type or which tool has them.

use super::battery::{Battery, Family, Typical};
use super::{ENERGY, ENERGY_SCALE, TAPER_VOLTAGE, TERMINATE, chemistry, find};
use crate::chip::{Chip, Row, Scale};
use crate::learning::Learns;
use crate::notation;
use crate::value::Value;

/// The rows that only a plan looks at.
const CAPACITY: &[&str] = &["Design Capacity", "Design Capacity mAh", "Cell Design Capacity mAh"];
const CELLS: &[&str] = &["Number of series cell", "Number of Series Cells", "Series Cell Count"];
const WARM: &[&str] = &["Cell Charge Voltage T1-T2", "Charging Voltage"];
const USUAL: &[&str] = &["Cell Charge Voltage T2-T3"];
const HOT: &[&str] = &["Cell Charge Voltage T3-T4"];
const NOMINAL: &[&str] = &["Design Voltage"];
const CELL_NOMINAL: &[&str] = &["Cell Design Voltage"];
const EDV: &[&str] = &["Fixed EDV 0"];
const NEXT_EDV: &[&str] = &["Fixed EDV 1"];
const TAPER: &[&str] = &["Taper Current"];
const TAPER_RATE: &[&str] = &["Taper Rate"];
const BITS: &[&str] = &["Pack Configuration"];
const BITS_B: &[&str] = &["Pack Configuration B"];
const ALL: [&[&str]; 17] = [
    CAPACITY,
    ENERGY_SCALE,
    ENERGY,
    CELLS,
    WARM,
    USUAL,
    HOT,
    NOMINAL,
    CELL_NOMINAL,
    TERMINATE,
    EDV,
    NEXT_EDV,
    TAPER,
    TAPER_RATE,
    TAPER_VOLTAGE,
    BITS,
    BITS_B,
];

/// Sections that say what to enter, by part and by how the row's name begins. Where none is here, the part's table has it.
#[rustfmt::skip]
const SOURCES: [(&str, &str, &str); 10] = [
    ("bq34z100-g1", "Design Energy Scale", "SLUSBZ5D 7.3.6.5"),
    ("bq34z100-g1", "Design", "SLUSBZ5D 8.2.2.1.1"),
    ("bq34z100-g1", "Cell Charge Voltage", "SLUSBZ5D 8.2.2.1.1"),
    ("bq34z100-g1", "Number of series cell", "SLUSBZ5D 7.3.8"),
    ("bq34z100-g1", "Pack Configuration B", "SLUSBZ5D Table 7-18"),
    ("bq34z100-g1", "Pack Configuration", "SLUSBZ5D 7.3.7.1"),
    ("bq34z100-r2", "Design", "SLUSF37 8.2.2.1.1"),
    ("bq34z100-r2", "Cell Charge Voltage", "SLUSF37 8.2.2.1.1"),
    ("bq27441-g1", "", "SLUUAC9A 6.4.2.3"),
    ("bq27427", "", "SLUUCD5, data memory"),
];

/// Capacities above need a scale on a part that is told of one: SLUSBZ5D 7.3.7.1, which advises factors up to ten.
const UNSCALED_MAH: f64 = 29_000.0;
const MOST_SCALE: f64 = 10.0;
/// Taper Voltage below the voltage at which charging ends: 4200 and 4100 mV in the table of one part, 4300 and 4200 mV
/// in that of its sister.
const BELOW_CHARGE_MV: f64 = 100.0;

/// What is known of a gauge.
#[derive(Clone, Copy)]
pub struct Has<'a> {
    /// Its table.
    pub chip: &'static Chip,
    /// Its answer to CHEM_ID, if it is known.
    pub chem_id: Option<u16>,
    /// Its rows, as far as they could be read.
    pub stored: &'a dyn Fn(Row) -> Option<Value>,
    /// By what the host multiplies currents and charges; `None` if nobody knows.
    pub current: Option<f64>,
    /// By what the host multiplies energies.
    pub energy: Option<f64>,
}

/// A row that does not hold what the battery needs.
#[derive(Clone, Debug)]
pub struct Differs {
    /// The row.
    pub row: Row,
    /// What it holds.
    pub old: Value,
    /// What it should hold.
    pub new: Value,
    /// Whether that follows from what was said of the battery; else it is usual for its chemistry.
    pub is_said: bool,
    /// The document that says what to enter.
    pub source: String,
}

/// What is left to do, which no row does.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Step {
    /// Its name, for programs.
    pub name: &'static str,
    /// Whether the gauge is wrong without it, as far as its rows show.
    pub is_due: bool,
    /// What to do.
    pub text: String,
}

/// What a gauge should hold for a battery.
#[derive(Clone, Debug, Default)]
pub struct Plan {
    /// The rows that differ.
    pub differ: Vec<Differs>,
    /// The rows that hold what they should.
    pub fit: Vec<Row>,
    /// The rows that could not be read.
    pub unread: Vec<Row>,
    /// What is left to do.
    pub steps: Vec<Step>,
}

impl Plan {
    /// Whether nothing differs and nothing is due, as far as it could be read.
    pub fn is_fine(&self) -> bool {
        self.differ.is_empty() && !self.steps.iter().any(|step| step.is_due)
    }
}

impl Battery {
    /// The rows that a plan looks at.
    pub fn rows(chip: &'static Chip) -> Vec<Row> {
        ALL.iter().filter_map(|names| find(chip, names)).collect()
    }

    /// What a gauge should hold for this battery; an error if it cannot gauge it.
    pub fn plan(&self, has: &Has<'_>) -> Result<Plan, String> {
        self.suits(has.chip)?;
        let scale = self.scale(has)?;
        let mut planner = Planner { battery: self, has, scale, plan: Plan::default() };
        planner.capacity()?;
        planner.energy();
        planner.cells();
        planner.charge();
        planner.empty();
        planner.taper();
        planner.bits();
        planner.steps();
        Ok(planner.plan)
    }

    /// Refuses a battery that the part cannot gauge.
    fn suits(&self, chip: &'static Chip) -> Result<(), String> {
        let (model, name) = (chip.model, self.chemistry.name);
        if find(chip, CAPACITY).is_none() {
            return Err(format!("gaugefs knows no data memory of a {model}, which would hold its battery"));
        }
        let is_primary = self.chemistry.family == Family::Primary;
        match chip.condition.primary.is_some() {
            true if !is_primary => {
                return Err(format!("a {model} is for cells that are not charged; {name} is"));
            }
            false if is_primary => {
                return Err(format!("a {model} is for cells that are charged; {name} is not"));
            }
            _ => {}
        }
        if chip.technology == "Li-ion" && self.chemistry.family != Family::Lithium {
            return Err(format!("a {model} gauges lithium-ion cells; the voltages of {name} are others"));
        }
        if find(chip, CELLS).is_none() && self.series > 1 {
            return Err(format!("a {model} gauges one cell, not {} in series", self.series));
        }
        Ok(())
    }

    /// By what capacities and currents are divided in the gauge.
    fn scale(&self, has: &Has<'_>) -> Result<f64, String> {
        let (chip, capacity) = (has.chip, self.capacity_mah);
        let told = has.current.filter(|scale| *scale > 0.0 && *scale != 1.0);
        if let Some(scale) = told {
            return Ok(scale);
        }
        let is_told = chip.scaling.scaled.is_some();
        let scale = (capacity / UNSCALED_MAH).ceil().max(1.0);
        if is_told && scale > MOST_SCALE {
            let most = UNSCALED_MAH * MOST_SCALE / 1000.0;
            return Err(format!("a {} gauges at most {most} Ah, scaled by {MOST_SCALE}", chip.model));
        }
        Ok(if is_told { scale } else { 1.0 })
    }
}

struct Planner<'a> {
    battery: &'a Battery,
    has: &'a Has<'a>,
    scale: f64,
    plan: Plan,
}

impl Planner<'_> {
    fn number(&self, names: &[&str]) -> Option<f64> {
        match (self.has.stored)(find(self.has.chip, names)?)? {
            Value::Int(number) => Some(number as f64),
            Value::Float(_) | Value::Text(_) => None,
        }
    }

    fn step(&mut self, name: &'static str, is_due: bool, text: String) {
        self.plan.steps.push(Step { name, is_due, text });
    }

    fn source(&self, row: Row) -> String {
        let chip = self.has.chip;
        let is_it =
            |(part, name, _): &&(&str, &str, &str)| *part == chip.name && row.1.name.starts_with(name);
        let section = SOURCES.iter().find(is_it).map(|(.., section)| *section);
        section.or(chip.documents.first().copied()).unwrap_or_default().into()
    }

    /// Wants a number in a row, if the part has it. Another one that fits is left alone.
    fn want(&mut self, names: &[&str], new: f64, is_said: bool, fits: impl Fn(f64) -> bool) {
        let Some(row) = find(self.has.chip, names) else { return };
        let Some(old) = (self.has.stored)(row) else { return self.plan.unread.push(row) };
        let Value::Int(number) = old else { return };
        if fits(number as f64) {
            return self.plan.fit.push(row);
        }
        let new = Value::Int(new.round() as i64);
        if notation::check(row.1, &new).is_err() {
            let text = format!("{} cannot hold {} {}", row.1.name, notation::show(row.1, &new), row.1.unit);
            return self.step("beyond", false, text);
        }
        let source = self.source(row);
        self.plan.differ.push(Differs { row, old, new, is_said, source });
    }

    /// Wants exactly that.
    fn exactly(&mut self, names: &[&str], new: f64) {
        self.want(names, new, true, |old| old == new.round());
    }

    /// Wants what was said, or else keeps what a cell of the chemistry has.
    fn voltage(&mut self, names: &[&str], said: Option<f64>, typical: Typical) {
        match said {
            Some(mv) => self.exactly(names, mv),
            None => self.want(names, f64::from(typical.usual), false, |old| typical.covers(old)),
        }
    }

    fn capacity(&mut self) -> Result<(), String> {
        let chip = self.has.chip;
        let stored = (self.battery.capacity_mah / self.scale).round();
        let row =
            find(chip, CAPACITY).filter(|(_, row)| notation::check(row, &Value::Int(stored as i64)).is_err());
        if let Some((_, row)) = row {
            let why = format!("a {} cannot hold {stored} mAh in {}", chip.model, row.name);
            return Err(match chip.scaling.charge {
                Scale::Register(_) | Scale::Power(..) => {
                    format!(
                        "{why}; set Curr Scale first, whose place in data flash no document has, with TI's tool"
                    )
                }
                _ if find(chip, CELLS).is_some() => {
                    format!(
                        "{why}; a gauge that is calibrated to a part of the current is mounted with --current-scale"
                    )
                }
                _ => why,
            });
        }
        self.exactly(CAPACITY, stored);
        Ok(())
    }

    fn energy(&mut self) {
        let Some((_, row)) = find(self.has.chip, ENERGY) else { return };
        let battery = self.battery;
        let holds = |unit: f64| (1.0..=32767.0).contains(&(battery.energy() / unit).round());
        // In mWh: of the row, and what the host multiplies by.
        let unit = match (row.unit, find(self.has.chip, ENERGY_SCALE)) {
            ("10mWh", _) => 10.0 * self.has.energy.unwrap_or(1.0),
            // Elsewhere that row is one driver's, and only 1 is sure.
            (_, Some(_)) if self.has.chip.scaling.scaled.is_some() => {
                let stored = self.number(ENERGY_SCALE).filter(|scale| [1.0, 10.0].contains(scale));
                let host = self.scale;
                let unit = |scale: f64| scale * host;
                let chosen = stored.into_iter().chain([1.0, 10.0]).find(|scale| holds(unit(*scale)));
                let Some(chosen) = chosen else { return self.too_much() };
                self.exactly(ENERGY_SCALE, chosen);
                if stored.is_some_and(|stored| stored != chosen) {
                    let text = "Reserve Energy and User Rate-Pwr count in other units from then on";
                    self.step("energy-unit", false, format!("{text} (SLUSBZ5D 7.3.6.5)"));
                }
                unit(chosen)
            }
            _ => 1.0,
        };
        if !holds(unit) {
            return self.too_much();
        }
        let fits = |old: f64| match battery.energy_mwh {
            Some(energy) => (old * unit - energy).abs() <= unit,
            None => {
                let volts = old * unit * 1000.0 / battery.capacity_mah / f64::from(battery.series);
                battery.chemistry.nominal.covers(volts)
            }
        };
        self.want(ENERGY, battery.energy() / unit, battery.energy_mwh.is_some(), fits);
    }

    fn too_much(&mut self) {
        let text = format!(
            "Design Energy cannot hold {:.0} Wh; energies and powers mean nothing",
            self.battery.energy() / 1000.0
        );
        self.step("beyond", false, text);
    }

    fn cells(&mut self) {
        let (chip, series) = (self.has.chip, self.battery.series);
        let Some(row) = find(chip, BITS).filter(|_| series > 1) else {
            if series > 1 && find(chip, CELLS).is_some() && chip.condition.primary.is_none() {
                let text = "Voltage Divider must be the board's: calibrate it, or write it with Flash Update OK Voltage";
                self.step("divider", false, text.into());
            }
            return self.exactly(CELLS, f64::from(series));
        };
        match self.is_external() {
            Some(true) => self.exactly(CELLS, f64::from(series)),
            Some(false) => {
                let text = format!(
                    "[VOLTSEL] is clear, so the gauge measures one cell: `gaugefs bringup GAUGE --cells {series} --divider VOLTAGE` \
                     sets it, the divider and Number of series cell"
                );
                self.step("bringup", true, text);
            }
            None => self.plan.unread.push(row),
        }
    }

    /// Whether the external divider is chosen; `None` on a part without the choice, or if that was not read.
    fn is_external(&self) -> Option<bool> {
        let chip = self.has.chip;
        let external = chip.gate.as_ref()?.external.as_ref()?;
        let covers = |(subclass, row): &Row| {
            subclass.id == external.byte.0
                && (row.offset..row.offset + row.kind.size() as u16).contains(&external.byte.1)
        };
        let row = chip.rows().find(covers)?;
        let bytes = chip.layout.encode(row.1.kind, &(self.has.stored)(row)?)?;
        Some(bytes[usize::from(external.byte.1 - row.1.offset)] & external.mask != 0)
    }

    fn charge(&mut self) {
        let Battery { chemistry, charge_mv: said, .. } = *self.battery;
        let is_for_one = find(self.has.chip, CELLS).is_none();
        self.voltage(if is_for_one { NOMINAL } else { CELL_NOMINAL }, None, chemistry.nominal);
        let Some(typical) = chemistry.charge else { return };
        self.voltage(WARM, said, typical);
        self.voltage(USUAL, said, typical);
        let most = said.unwrap_or(f64::from(typical.limits.1));
        let least = f64::from(typical.limits.0);
        let hot = said.unwrap_or(f64::from(typical.usual));
        self.want(HOT, hot, said.is_some(), |old| (least..=most).contains(&old));
        if let Some(mv) = said.filter(|_| is_for_one && find(self.has.chip, TAPER_RATE).is_some()) {
            self.exactly(TAPER_VOLTAGE, mv - BELOW_CHARGE_MV);
        }
    }

    fn empty(&mut self) {
        let Battery { chemistry, terminate_mv: said, .. } = *self.battery;
        self.voltage(TERMINATE, said, chemistry.terminate);
        let is_for_one = find(self.has.chip, CELLS).is_none();
        let Some(mv) = said.filter(|_| is_for_one && find(self.has.chip, EDV).is_some()) else { return };
        match self.number(NEXT_EDV) {
            Some(next) if mv >= next => {
                let text = format!(
                    "Fixed EDV 0 must be below Fixed EDV 1, {next} mV: a CEDV profile of the cell has both"
                );
                self.step("edv", true, text);
            }
            _ => self.exactly(EDV, mv),
        }
    }

    fn taper(&mut self) {
        let capacity = self.battery.capacity_mah;
        if let Some(current) = self.battery.taper_ma {
            self.exactly(TAPER, current / self.scale);
            // In tenths of an hour: the design capacity divided by the current.
            return self.exactly(TAPER_RATE, 10.0 * capacity / current);
        }
        let now = self.number(TAPER).map(|current| current * self.scale);
        let now =
            now.or(self.number(TAPER_RATE).filter(|rate| *rate > 0.0).map(|rate| 10.0 * capacity / rate));
        if let Some(now) = now {
            let text = format!(
                "the charge counts as ended below {now:.0} mA: it must be above the current at which the charger stops; say it as \
                 taper-current={now:.0}mA"
            );
            self.step("taper-current", false, text);
        }
    }

    fn bits(&mut self) {
        let scaled = self.has.chip.scaling.scaled.map(|(_, bit)| bit.mask).filter(|_| self.scale > 1.0);
        self.set_bit(BITS, scaled);
        let of_phosphate = find(self.has.chip, BITS_B)
            .and_then(|(_, row)| row.bits.iter().find(|bit| bit.name == "LFPRelax"))
            .filter(|_| self.battery.chemistry.family == Family::Phosphate);
        self.set_bit(BITS_B, of_phosphate.map(|bit| bit.mask));
        let has_nickel =
            find(self.has.chip, BITS).is_some_and(|(_, row)| row.bits.iter().any(|bit| bit.name == "NiDT"));
        if has_nickel
            && self.battery.chemistry.family == Family::Other
            && self.battery.chemistry.charge.is_none()
        {
            let text = "[NiDT] or [NiDV] of Pack Configuration, by the sign at which the charger stops";
            self.step("charge-end", false, text.into());
        }
    }

    /// Wants a bit set in a word, whose other bits stay.
    fn set_bit(&mut self, names: &[&str], mask: Option<u32>) {
        let Some(mask) = mask.map(i64::from) else { return };
        let word = self.number(names).unwrap_or_default() as i64;
        self.want(names, (word | mask) as f64, true, |old| old as i64 & mask != 0);
    }

    fn steps(&mut self) {
        let (chip, battery) = (self.has.chip, self.battery);
        if self.scale > 1.0 && chip.scaling.scaled.is_some() {
            let (scale, is_due) = (self.scale, self.has.current == Some(1.0));
            let text = format!(
                "the gauge counts in {scale}: mount it with --current-scale {scale} --energy-scale {scale}, and calibrate it with \
                 the current divided by {scale} (docs/ATTRIBUTES.md)"
            );
            self.step("scale", is_due, text);
        }
        let learns = Learns::of(chip);
        if battery.chemistry.family != Family::Primary {
            let (is_due, text) = chemistry::step(chip, battery, self.has.chem_id);
            self.step("chemistry", is_due, text);
        }
        if chip.access.scheme.is_ram() {
            let text = "data memory is lost with the power: `gaugefs export GAUGE -o FILE`, and mount with --profile FILE \
                        (docs/FORGETFUL.md)";
            self.step("profile", false, text.into());
        }
        if learns.is_some() {
            let what = if learns == Some(Learns::FullCharge) {
                "the full charge capacity is"
            } else {
                "Qmax and Ra are"
            };
            self.step("learn", false, format!("{what} learned in a whole cycle: `gaugefs learn GAUGE`"));
        }
    }
}

#[cfg(test)]
mod tests;
