// SPDX-License-Identifier: MIT

//! Whether a gauge is set up for its battery, and what is wrong if it is not: rules over what was read of it.
//!
//! A row of [`RULES`] is a rule. Rules look at registers and not at attributes, which are absent where a value is impossible.
//! Nothing here reads a gauge: [`Facts`] has what was read, and a rule whose facts are missing says which.

use crate::chip::{Chip, Role, Row, Scale, Source, power};
use crate::registers::Registers;
use crate::value::Value;

mod battery;
mod chemistry;
mod devicetree;
mod history;
mod plan;
mod rules;

pub use battery::{Battery, CHEMISTRIES, Chemistry, Family, Typical};
pub use devicetree::is_source;
pub use plan::{Differs, Has, Plan, Step};

pub use history::{History, Poll, Summary};
pub use rules::RULES;

/// The rows that both the rules and a plan look at, by their names in all tables.
const ENERGY: &[&str] = &["Design Energy"];
const ENERGY_SCALE: &[&str] = &["Design Energy Scale"];
const TERMINATE: &[&str] = &["Terminate Voltage", "Cell Terminate Voltage"];
const TAPER_VOLTAGE: &[&str] = &["Taper Voltage"];
const CHARGE: &[&str] = &["Cell Charge Voltage T2-T3", "Charging Voltage"];
/// What a cell of any chemistry can have in mV.
const CELL_MV: (f64, f64) = (700.0, 4600.0);

/// The first row with one of these names whose address is certain.
fn find(chip: &'static Chip, names: &[&str]) -> Option<Row> {
    chip.rows().find(|(_, row)| names.contains(&row.name) && !row.unproven)
}

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Certainly not as it should be.
    Wrong,
    /// A person has to decide it.
    Doubtful,
    /// Worth knowing.
    Note,
}

impl Severity {
    /// All, the worst first.
    pub const ALL: [Self; 3] = [Self::Wrong, Self::Doubtful, Self::Note];

    /// The word for it.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Wrong => "wrong",
            Self::Doubtful => "doubtful",
            Self::Note => "note",
        }
    }
}

/// What a rule is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Subject {
    /// The gauge has no configuration of its own, or another battery's.
    NotConfigured,
    /// Values that no battery has.
    Impossible,
    /// Data flash.
    Flash,
    /// Qmax and Ra.
    Learning,
    /// The pack's age.
    Age,
    /// Somebody else uses the gauge.
    Interference,
}

/// Why a rule was not decided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lacking {
    /// It does not apply to this part, this pack, or to a file without measurements.
    Never,
    /// This value of a poll is missing.
    Polled(&'static str),
    /// Data flash has not been read.
    Stored,
}

/// The values by which a rule is true; `None` if it is not.
type Verdict = Result<Option<String>, Lacking>;

/// What can be wrong with a gauge.
pub struct Rule {
    /// Its name, for programs.
    pub name: &'static str,
    /// How bad it is.
    pub severity: Severity,
    /// What it is about.
    pub subject: Subject,
    finds: fn(&Facts<'_>) -> Verdict,
    /// What it means.
    pub means: &'static str,
    /// What to do.
    pub remedy: &'static str,
    /// Where that stands.
    pub source: &'static str,
}

/// What is known of a gauge.
#[derive(Clone, Copy)]
pub struct Facts<'a> {
    /// Its table.
    pub chip: &'static Chip,
    /// Its answer to DM_CODE.
    pub dm_code: Option<u16>,
    /// Its answer to CHEM_ID.
    pub chem_id: Option<u16>,
    /// What was polled; `None` for a file that has only data flash.
    pub registers: Option<&'a Registers>,
    /// CONTROL_STATUS when it was last read; `None` of a gauge that is never asked.
    pub control_status: Option<u32>,
    /// Why its profile is not in its data memory; empty if it is, or if it has none.
    pub unwritten: &'a str,
    /// What a failed access has left to do; empty for nothing.
    pub owed: &'a str,
    /// By what the host multiplies voltages, beside the gauge's own scale.
    pub host_scale: f64,
    /// Data flash, as far as it has been read.
    pub stored: &'a dyn Fn(Row) -> Option<Value>,
    /// What earlier polls have shown.
    pub history: Summary,
}

/// A rule that is true.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// The rule.
    pub rule: &'static Rule,
    /// The values that show it.
    pub values: String,
}

/// What a check has found.
#[derive(Clone, Debug, Default)]
pub struct Checked {
    /// The rules that are true, the worst first.
    pub findings: Vec<Finding>,
    /// The rules that lack a value of a poll, with its name.
    pub missing: Vec<(&'static Rule, &'static str)>,
    /// The rules that need data flash which has not been read.
    pub unread: Vec<&'static Rule>,
}

impl std::fmt::Debug for Rule {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(self.name)
    }
}

impl PartialEq for Rule {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl Eq for Rule {}

impl Rule {
    /// The rule of that name.
    pub fn by_name(name: &str) -> Option<&'static Self> {
        RULES.iter().find(|rule| rule.name == name)
    }
}

impl Checked {
    /// Applies all rules.
    pub fn of(facts: &Facts<'_>) -> Self {
        let mut checked = Self::default();
        for rule in RULES {
            match (rule.finds)(facts) {
                Ok(Some(values)) => checked.findings.push(Finding { rule, values }),
                Ok(None) | Err(Lacking::Never) => {}
                Err(Lacking::Polled(name)) => checked.missing.push((rule, name)),
                Err(Lacking::Stored) => checked.unread.push(rule),
            }
        }
        checked.findings.sort_by_key(|finding| finding.rule.severity);
        checked
    }
}

impl<'a> Facts<'a> {
    /// Of an image: data flash, and nothing that was polled.
    pub fn of_flash(chip: &'static Chip, stored: &'a dyn Fn(Row) -> Option<Value>) -> Self {
        Self {
            chip,
            dm_code: None,
            chem_id: None,
            registers: None,
            control_status: None,
            unwritten: "",
            owed: "",
            host_scale: 1.0,
            stored,
            history: Summary::default(),
        }
    }

    /// A value of the last poll in its role's unit, if the gauge has measured, has a battery, and can have that value.
    fn polled(&self, role: Role) -> Result<f64, Lacking> {
        let register = self.chip.register(role).ok_or(Lacking::Never)?;
        let registers = self.registers.ok_or(Lacking::Never)?;
        let missing = Lacking::Polled(register.name);
        let flags = self.flags().unwrap_or_default();
        if !self.chip.condition.shows_battery(Some(flags)) || self.history.has_not_measured() {
            return Err(missing);
        }
        registers.property(role).map(|value| value as f64).ok_or(missing)
    }

    /// A polled value that follows from the configuration: a gauge without its own has none.
    fn predicted(&self, role: Role) -> Result<f64, Lacking> {
        match self.has_lost_memory() || !self.unwritten.is_empty() {
            true => Err(Lacking::Never),
            false => self.polled(role),
        }
    }

    fn flags(&self) -> Option<i64> {
        self.registers?.value(self.chip.register(Role::Flags)?)
    }

    /// `[ITPOR]`: data memory has the part's defaults.
    fn has_lost_memory(&self) -> bool {
        self.flags().zip(self.chip.volatile).is_some_and(|(flags, lost)| flags & i64::from(lost) != 0)
    }

    /// The bits of a word of the gauge.
    fn word(&self, source: Source) -> Result<u32, Lacking> {
        let registers = self.registers.ok_or(Lacking::Never)?;
        if source == Source::Status {
            // It is read before the first poll is over.
            let is_read = self.flags().is_some();
            return match self.control_status.filter(|_| self.chip.has_table()) {
                Some(status) if is_read => Ok(status),
                Some(_) => Err(Lacking::Polled("Control")),
                None => Err(Lacking::Never),
            };
        }
        let register = self.chip.register_at(source).ok_or(Lacking::Never)?;
        Ok(registers.value(register).ok_or(Lacking::Polled(register.name))? as u32)
    }

    /// A row of data flash whose address is certain, in firmware that keeps it there.
    fn value(&self, row: Row) -> Result<Value, Lacking> {
        if row.1.unproven {
            return Err(Lacking::Never);
        }
        for sign in self.chip.signature {
            match (self.stored)(self.at((sign.subclass, sign.offset))?) {
                Some(Value::Int(found)) if sign.kind.size() > 2 || sign.holds(found) => {}
                Some(Value::Float(_) | Value::Text(_)) => {}
                Some(Value::Int(_)) => return Err(Lacking::Never),
                None => return Err(Lacking::Stored),
            }
        }
        (self.stored)(row).ok_or(Lacking::Stored)
    }

    fn number(&self, row: Row) -> Result<f64, Lacking> {
        match self.value(row)? {
            Value::Int(number) => Ok(number as f64),
            Value::Float(number) => Ok(number),
            Value::Text(_) => Err(Lacking::Never),
        }
    }

    /// The first row with one of these names.
    fn named(&self, names: &[&str]) -> Result<Row, Lacking> {
        find(self.chip, names).ok_or(Lacking::Never)
    }

    /// The row at a place.
    fn at(&self, (id, offset): (u8, u16)) -> Result<Row, Lacking> {
        self.chip
            .rows()
            .find(|(subclass, row)| subclass.id == id && row.offset == offset)
            .ok_or(Lacking::Never)
    }

    /// Whether a number is what the part has there by itself; `None` if no source has that.
    fn default(&self, row: Row) -> Option<f64> {
        row.1.int_default(self.dm_code).map(|default| default as f64)
    }

    /// Design Capacity in mAh: the register, or the row of data flash.
    fn design(&self) -> Result<f64, Lacking> {
        match self.chip.register(Role::ChargeFullDesign) {
            Some(register) if self.registers.is_some() => {
                let value = self.registers.and_then(|registers| registers.property(Role::ChargeFullDesign));
                value.map(|value| value as f64).ok_or(Lacking::Polled(register.name))
            }
            _ => self.number(self.named(rules::DESIGN)?),
        }
    }

    /// The number of cells in series: a row, or one on a part for one cell, which keeps no value of a second one.
    fn cells(&self) -> Result<f64, Lacking> {
        let is_for_one = || !self.chip.rows().any(|(_, row)| row.name == "Qmax Cell 2");
        match self.chip.stored(Role::Cells) {
            Some(row) => self.number(row).map(|cells| cells.max(1.0)),
            None if self.chip.has_table() && self.chip.technology == "Li-ion" && is_for_one() => Ok(1.0),
            None => Err(Lacking::Never),
        }
    }

    /// By what the gauge's voltages are multiplied.
    fn scale(&self) -> Result<f64, Lacking> {
        let own = match self.chip.scaling.voltage {
            Scale::None => 1.0,
            Scale::Register(source) => f64::from(self.word(source)?).max(1.0),
            Scale::Power(source, fields) => f64::from(power(self.word(source)?, fields)),
            Scale::Flash(id, offset) => self.number(self.at((id, offset))?)?.max(1.0),
        };
        Ok(own * self.host_scale)
    }

    /// Voltage() in mV for each cell, with its scale.
    fn cell_mv(&self) -> Result<f64, Lacking> {
        Ok(self.polled(Role::VoltageNow)? * self.scale()? / self.cells()?)
    }

    /// Whether the chemistry is certainly a lithium-ion one, by the part or by data flash.
    fn is_lithium(&self) -> bool {
        let named = |row: Row| match (self.stored)(row) {
            Some(Value::Text(name)) => name.to_ascii_uppercase().starts_with(b"LI"),
            _ => false,
        };
        self.chip.technology == "Li-ion" || self.chip.stored(Role::Technology).is_some_and(named)
    }
}
