// SPDX-License-Identifier: MIT

//! The power_supply attributes, with the names, units and signs of the kernel's ABI (`sysfs-class-power`).
//!
//! A row of [`ATTRIBUTES`] is an attribute: its name, and the rule for its text.

use gauge_owner::{Handle, Snapshot};
use ti_gauge::chip::sbs::CONDITION_FLAG;
use ti_gauge::chip::sbs::failures::failures;
use ti_gauge::chip::{Chip, Condition, Primary, Register, Role, Scale, Scheme, Signature, power};
use ti_gauge::codec::FREEZING;
use ti_gauge::value::Value;
use ti_gauge::{date, text};

use super::Scales;

pub(super) struct Reading<'a> {
    pub(super) chip: &'static Chip,
    pub(super) model: &'static str,
    /// `None` while the gauge is gone.
    pub(super) snapshot: Option<&'a Snapshot>,
    pub(super) handle: &'a Handle,
    pub(super) scales: &'a Scales,
}

impl<'a> Reading<'a> {
    /// A reading of a gauge, with the name of the part that has answered.
    pub(super) fn new(handle: &'a Handle, snapshot: Option<&'a Snapshot>, scales: &'a Scales) -> Self {
        let chip = handle.chip();
        let model = handle.published().limited.map_or(chip.model, |limited| limited.name(chip));
        Self { chip, model, snapshot, handle, scales }
    }
}

/// A kind of values with a common scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Voltage,
    Current,
    Charge,
    /// Energies and powers.
    Energy,
}

impl Kind {
    pub(super) const ALL: [Self; 4] = [Self::Voltage, Self::Current, Self::Charge, Self::Energy];

    pub(super) fn option(self) -> &'static str {
        match self {
            Kind::Voltage => "voltage-scale",
            Kind::Current | Kind::Charge => "current-scale",
            Kind::Energy => "energy-scale",
        }
    }

    /// The gauge's own scale for them.
    fn scale(self, chip: &Chip) -> Scale {
        let scaling = &chip.scaling;
        match self {
            Kind::Voltage => scaling.voltage,
            Kind::Current => scaling.current,
            Kind::Charge => scaling.charge,
            Kind::Energy => scaling.energy,
        }
    }
}

/// An attribute. `None`: the gauge lacks the value, or lacks it now.
struct Row {
    name: &'static str,
    show: Show,
}

enum Show {
    Text(Text),
    /// A number in the unit of the attribute.
    Number(fn(&Reading<'_>) -> Option<i64>),
    /// A word in four hexadecimal digits, as the kernel's drivers show serial numbers.
    Hex(fn(&Reading<'_>) -> Option<i64>),
}

enum Text {
    /// A word of the kernel, or a name.
    Fixed(fn(&Reading<'_>) -> Option<&'static str>),
    /// The pack's own text, which the table's row with this role reads; the other one where the table has no such row.
    Row(Role, fn(&Reading<'_>) -> &'static str),
}

const fn text(name: &'static str, show: fn(&Reading<'_>) -> Option<&'static str>) -> Row {
    Row { name, show: Show::Text(Text::Fixed(show)) }
}

const fn own_text(name: &'static str, role: Role, otherwise: fn(&Reading<'_>) -> &'static str) -> Row {
    Row { name, show: Show::Text(Text::Row(role, otherwise)) }
}

const fn number(name: &'static str, show: fn(&Reading<'_>) -> Option<i64>) -> Row {
    Row { name, show: Show::Number(show) }
}

const fn hex(name: &'static str, show: fn(&Reading<'_>) -> Option<i64>) -> Row {
    Row { name, show: Show::Hex(show) }
}

/// All attributes, in the order of `uevent`; `gaugefs_client::names` has their units.
static ATTRIBUTES: &[Row] = &[
    text("type", |_| Some("Battery")),
    text("status", |reading| reading.status()),
    number("present", |reading| Some(reading.is_there().into())),
    text("health", |reading| reading.health()),
    text("technology", |reading| Some(reading.technology())),
    text("scope", |_| Some("System")),
    // A Smart Battery may say more.
    number("capacity", |reading| Some(reading.value(Role::Capacity)?.min(100))),
    text("capacity_level", |reading| reading.capacity_level()),
    number("capacity_error_margin", |reading| reading.value(Role::CapacityErrorMargin)),
    number("voltage_now", |reading| reading.micro(Role::VoltageNow, Kind::Voltage)),
    number("voltage_min_design", |reading| reading.design_voltage(Role::VoltageMinDesign)),
    number("voltage_max_design", |reading| reading.design_voltage(Role::VoltageMaxDesign)),
    number("current_now", |reading| reading.current(reading.current_now()?)),
    number("current_avg", |reading| reading.current(Role::CurrentAvg)),
    number("charge_now", |reading| reading.micro(Role::ChargeNow, Kind::Charge)),
    number("charge_full", |reading| reading.micro(Role::ChargeFull, Kind::Charge)),
    number("charge_full_design", |reading| reading.charge_full_design()),
    number("charge_counter", |reading| reading.micro(Role::ChargeCounter, Kind::Charge)),
    number("constant_charge_voltage", |reading| reading.charge_voltage()),
    number("constant_charge_current", |reading| reading.micro(Role::ChargeCurrent, Kind::Current)),
    number("energy_now", |reading| reading.energy(Role::EnergyNow)),
    number("energy_full", |reading| reading.energy(Role::EnergyFull)),
    number("energy_full_design", |reading| reading.energy(Role::EnergyFullDesign)),
    number("power_avg", |reading| reading.power()),
    number("temp", |reading| Some(reading.steps(Role::Temp, 1)? - FREEZING)),
    number("internal_resistance", |reading| reading.resistance()),
    number("time_to_empty_now", |reading| reading.seconds(reading.time_to_empty_now()?)),
    number("time_to_empty_avg", |reading| reading.seconds(Role::TimeToEmptyAvg)),
    number("time_to_full_now", |reading| reading.seconds(Role::TimeToFullNow)),
    number("time_to_full_avg", |reading| reading.seconds(Role::TimeToFullAvg)),
    number("cycle_count", |reading| reading.value(Role::CycleCount)),
    number("state_of_health", |reading| {
        reading.value(Role::StateOfHealth).filter(|_| reading.computes_health() == Some(true))
    }),
    own_text("manufacturer", Role::Manufacturer, |_| "Texas Instruments"),
    own_text("model_name", Role::ModelName, |reading| reading.model),
    hex("serial_number", |reading| reading.value(Role::SerialNumber)),
    number("manufacture_year", |reading| Some(reading.manufactured()?[0])),
    number("manufacture_month", |reading| Some(reading.manufactured()?[1])),
    number("manufacture_day", |reading| Some(reading.manufactured()?[2])),
];

/// The kernel's names for chemistries, by their short names in Smart Battery Data.
pub(super) const CHEMISTRIES: [(&str, &str); 7] = [
    ("LION", "Li-ion"),
    ("LIPO", "Li-poly"),
    ("LIP", "Li-poly"),
    ("LIFE", "LiFe"),
    ("LIMN", "LiMn"),
    ("NIMH", "NiMH"),
    ("NICD", "NiCd"),
];

/// Attributes that `uevent` still lists while the gauge is gone.
const LISTED_WHILE_GONE: [&str; 2] = ["type", "present"];

/// One attribute: a row of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Attribute(pub(super) u8);

impl Attribute {
    /// All attributes, in the order of `uevent`.
    pub(crate) fn all() -> impl Iterator<Item = Self> {
        (0..ATTRIBUTES.len() as u8).map(Self)
    }

    pub(crate) fn by_name(name: &str) -> Option<Self> {
        Self::all().find(|attribute| attribute.name() == name)
    }

    fn row(self) -> &'static Row {
        &ATTRIBUTES[usize::from(self.0)]
    }

    pub(crate) fn name(self) -> &'static str {
        self.row().name
    }

    /// Whether its text is the pack's own.
    fn is_of_pack(self, chip: &Chip) -> bool {
        matches!(self.row().show, Show::Text(Text::Row(role, _)) if chip.register(role).is_some())
    }

    /// Text without a newline; `None` if the gauge lacks it, or lacks it now.
    pub(super) fn text(self, reading: &Reading<'_>) -> Option<String> {
        match self.row().show {
            Show::Text(Text::Fixed(show)) => show(reading).map(str::to_string),
            Show::Text(Text::Row(role, otherwise)) => match reading.chip.register(role) {
                Some(register) => reading.own_text(register),
                None => Some(otherwise(reading).into()),
            },
            Show::Number(show) => show(reading).map(|number| number.to_string()),
            Show::Hex(show) => show(reading).map(|word| format!("{word:04x}")),
        }
    }
}

impl Reading<'_> {
    /// The value of a register, whether it is valid or not.
    fn raw(&self, role: Role) -> Option<i64> {
        self.snapshot?.value(self.chip.register(role)?)
    }

    /// A measured value. There is no value without a battery, before the first measurement, and for a primary cell's
    /// current outside of GAUGE_START and GAUGE_STOP.
    pub(super) fn value(&self, role: Role) -> Option<i64> {
        let snapshot = self.snapshot.filter(|snapshot| snapshot.is_valid && self.is_present())?;
        // Measured whatever data memory contains.
        let is_measured = matches!(role, Role::VoltageNow | Role::CurrentNow | Role::CurrentAvg | Role::Temp);
        if !is_measured && !snapshot.is_configured {
            return None;
        }
        let is_current = matches!(role, Role::CurrentNow | Role::CurrentAvg);
        let value = self.raw(role).filter(|_| snapshot.has_current || !is_current)?;
        let register = self.chip.register(role)?;
        let word = |source| snapshot.value(self.chip.register_at(source)?);
        register.feeds(role, word).filter(|feeds| *feeds)?;
        let is_ready = |source| {
            self.chip.register_at(source).and_then(|by| snapshot.value(by)).is_some_and(|by| by != 0)
        };
        register.validity.is_none_or(is_ready).then_some(())?;
        valid(register, value, self.flags().unwrap_or_default())
    }

    /// A text that the maker of the pack has chosen; `None` for an empty one.
    fn own_text(&self, register: &Register) -> Option<String> {
        let text = self.snapshot.filter(|_| self.is_present())?.text(register)?;
        (!text.is_empty()).then(|| text::printable(text))
    }

    fn flags(&self) -> Option<i64> {
        self.raw(Role::Flags)
    }

    /// A register in that fraction of its role's unit, rounded down as in the kernel's driver.
    pub(super) fn steps(&self, role: Role, fraction: i64) -> Option<i64> {
        Some(self.chip.register(role)?.in_unit_of(role, self.value(role)?, fraction))
    }

    /// A register in thousandths of a unit, converted to millionths.
    pub(super) fn micro(&self, role: Role, kind: Kind) -> Option<i64> {
        Some((self.steps(role, 1000)? as f64 * self.scale(kind)?).round() as i64)
    }

    /// A value of data flash, while it is known and the pack is present. Firmware that keeps its data flash elsewhere,
    /// as the signature shows, has no such value.
    fn stored(&self, role: Role) -> Option<Value> {
        let is_known = self.is_present() && self.snapshot.is_some_and(|snapshot| snapshot.is_configured);
        let (subclass, parameter) = self.chip.stored(role).filter(|_| is_known)?;
        let kept = |row: &Signature| self.handle.kept_value((row.subclass, row.offset), row.kind);
        let fits = |row: &Signature| matches!(kept(row), Some(Value::Int(found)) if row.holds(found));
        let value = self.handle.kept_value((subclass.id, parameter.offset), parameter.kind);
        value.filter(|_| self.chip.signature.iter().all(fits))
    }

    fn stored_number(&self, role: Role) -> Option<i64> {
        match self.stored(role)? {
            Value::Int(number) => Some(number).filter(|&number| role.values().hold(number)),
            Value::Float(_) | Value::Text(_) => None,
        }
    }

    /// The number of cells in series that a value of data flash applies to; 1 if the table has no such number.
    fn cells(&self) -> Option<i64> {
        if self.chip.stored(Role::Cells).is_none() {
            return Some(1);
        }
        self.stored_number(Role::Cells)
    }

    /// Converts a number from thousandths of a unit to millionths.
    fn scaled(&self, number: i64, kind: Kind) -> Option<i64> {
        Some(((number * 1000) as f64 * self.scale(kind)?).round() as i64)
    }

    pub(super) fn design_voltage(&self, role: Role) -> Option<i64> {
        let millivolts = self.stored_number(role)?;
        self.scaled(millivolts * self.cells()?, Kind::Voltage)
    }

    /// From a register, or from data flash if the part has no such register.
    pub(super) fn charge_full_design(&self) -> Option<i64> {
        match self.chip.register(Role::ChargeFullDesign) {
            Some(_) => self.micro(Role::ChargeFullDesign, Kind::Charge),
            None => self.scaled(self.stored_number(Role::ChargeFullDesign)?, Kind::Charge),
        }
    }

    /// The pack's charging voltage. No document says whether a multi-cell gauge shows a cell's: it does, unless the
    /// value is far above the cell's in data flash.
    pub(super) fn charge_voltage(&self) -> Option<i64> {
        let reading = self.micro(Role::ChargeVoltage, Kind::Voltage)?;
        let cells = self.cells()?;
        if cells == 1 {
            return Some(reading);
        }
        let cell = self.scaled(self.stored_number(Role::VoltageMaxDesign)?, Kind::Voltage)?;
        Some(pack_voltage(reading, cell, cells))
    }

    /// The date of a register or in data flash, unless it is 0 or impossible.
    pub(super) fn manufactured(&self) -> Option<[i64; 3]> {
        date::of(self.value(Role::ManufactureDate).or_else(|| self.stored_number(Role::ManufactureDate))?)
    }

    /// The chemistry of a register or in data flash, if the kernel has a name for it.
    pub(super) fn technology(&self) -> &'static str {
        let own = self.chip.register(Role::Technology).and_then(|register| self.own_text(register));
        let named = |chemistry: &[u8]| {
            let names =
                CHEMISTRIES.iter().find(|(short, _)| chemistry.eq_ignore_ascii_case(short.as_bytes()));
            names.map_or(self.chip.technology, |(_, name)| name)
        };
        match (own, self.stored(Role::Technology)) {
            (Some(chemistry), _) => named(chemistry.trim().as_bytes()),
            (None, Some(Value::Text(chemistry))) => named(&chemistry),
            (None, _) => self.chip.technology,
        }
    }

    /// The measured resistance in µΩ, in some of the gauge's modes.
    fn resistance(&self) -> Option<i64> {
        let measures = |primary: &Primary| self.is_in_mode(primary.resistance_modes) == Some(true);
        let milliohms = self.value(Role::InternalResistance).filter(|_| self.primary().is_none_or(measures));
        let ratio = self.scale(Kind::Voltage)? / self.scale(Kind::Current)?;
        Some(((milliohms? * 1000) as f64 * ratio).round() as i64)
    }

    /// The register of `time_to_empty_now`. Parts with a single one compute it with the average current; it is shown
    /// there too, as in the kernel's driver.
    pub(super) fn time_to_empty_now(&self) -> Option<Role> {
        self.first_of([Role::TimeToEmptyNow, Role::TimeToEmptyAvg])
    }

    /// The factor of a kind of values: the gauge's scale times the user's.
    pub(super) fn scale(&self, kind: Kind) -> Option<f64> {
        Some(f64::from(self.reported_scale(kind)?) * self.scales.of(kind))
    }

    /// The gauge's scale, or 1 if the part has none; `None` while it is unknown, or 0.
    pub(super) fn reported_scale(&self, kind: Kind) -> Option<u32> {
        let word = |source| {
            let register = self.chip.register_at(source)?;
            self.snapshot.filter(|snapshot| snapshot.is_valid)?.value(register)?.try_into().ok()
        };
        match kind.scale(self.chip) {
            Scale::None => Some(1),
            Scale::Flash(subclass, offset) => self.handle.flash_scale((subclass, offset)),
            Scale::Register(source) => word(source).filter(|&scale| scale > 0),
            Scale::Power(source, fields) => Some(power(word(source)?, fields)),
        }
    }

    /// Whether the gauge says that its values have a factor unknown to it, and the source; `None` if the part never
    /// says that.
    pub(super) fn is_scaled(&self) -> Option<(bool, String)> {
        let (source, bit) = self.chip.scaling.scaled?;
        let register = self.chip.register_at(source)?;
        let word = self.snapshot?.value(register)?;
        Some((word & i64::from(bit.mask) != 0, format!("[{}] of {}()", bit.name, register.name)))
    }

    /// The register of `current_now`. Parts with a single current register average it. Monitors look for `current_now`,
    /// so the average is shown there too, as in the kernel's driver.
    pub(super) fn current_now(&self) -> Option<Role> {
        self.first_of([Role::CurrentNow, Role::CurrentAvg])
    }

    /// The first of these properties with a register.
    fn first_of<const N: usize>(&self, roles: [Role; N]) -> Option<Role> {
        roles.into_iter().find(|&role| self.chip.register(role).is_some())
    }

    fn current(&self, role: Role) -> Option<i64> {
        let current = self.micro(role, Kind::Current)?;
        Some(if self.scales.absolute_current { current.abs() } else { current })
    }

    fn energy(&self, role: Role) -> Option<i64> {
        // A part that counts in either has no charge beside it.
        let is_alone = self.chip.register(role).is_some_and(|register| register.other.is_some());
        self.micro(role, Kind::Energy).filter(|_| self.scales.energy_shown || is_alone)
    }

    /// Negative while discharging, like the current. A register for discharges only has no value while the average
    /// current is positive, and no 0 while any current flows.
    fn power(&self) -> Option<i64> {
        let power = self.energy(Role::PowerAvg)?;
        if !self.chip.register(Role::PowerAvg)?.discharge {
            return Some(power);
        }
        let current = self.value(self.first_of([Role::CurrentAvg, Role::CurrentNow])?)?;
        let is_so = if power == 0 { current == 0 } else { current <= 0 };
        is_so.then_some(-power)
    }

    pub(super) fn seconds(&self, role: Role) -> Option<i64> {
        self.value(role).map(|minutes| minutes * 60)
    }

    fn primary(&self) -> Option<&'static Primary> {
        self.chip.condition.primary.as_ref()
    }

    /// Whether the gauge computes StateOfHealth(). On a gauge of primary cells the mode in data flash decides, which
    /// must be read first.
    fn computes_health(&self) -> Option<bool> {
        self.primary().map_or(Some(true), |primary| self.is_in_mode(primary.health_modes))
    }

    /// Whether a gauge of primary cells is in one of these modes; `None` while data flash has not been read.
    fn is_in_mode(&self, modes: &[u8]) -> Option<bool> {
        let primary = self.primary()?;
        let mode = self.handle.kept_byte(primary.mode)? & primary.mode_mask;
        Some(modes.contains(&mode))
    }

    /// Whether some of the flags are set, if that is known.
    fn has_flag(&self, mask: u32) -> Option<bool> {
        if self.value(Role::Flags)? & i64::from(mask) != 0 {
            return Some(true);
        }
        // A flag that the configuration blocks is never set.
        let Some(primary) = self.primary() else { return Some(false) };
        let shown = u32::from(self.handle.kept_byte(primary.alerts)?);
        (mask & !shown == 0).then_some(false)
    }

    /// Whether the gauge answers and has a battery.
    pub(super) fn is_present(&self) -> bool {
        self.snapshot.is_some() && self.chip.condition.shows_battery(self.flags())
    }

    /// Whether the gauge is there, even while a long access keeps the last poll too old to be shown.
    fn is_there(&self) -> bool {
        if self.snapshot.is_some() { self.is_present() } else { self.handle.is_present() }
    }

    /// By the current of `current_now`. The full flag comes before a charging current, which is hardly ever 0 at the
    /// end of a charge, as in the kernel's driver; but a pack that is being discharged is not `Full`.
    pub(super) fn status(&self) -> Option<&'static str> {
        let condition = &self.chip.condition;
        if !self.is_present() {
            return None;
        }
        let current = self.current_now().and_then(|role| self.micro(role, Kind::Current));
        let (Some(current), Some(full)) = (current, self.has_full_flag()) else { return Some("Unknown") };
        Some(match current {
            0 if condition.primary.is_some() => "Not charging",
            _ if condition.primary.is_some() => "Discharging",
            0.. if full => "Full",
            0 => "Not charging",
            1.. => "Charging",
            _ => "Discharging",
        })
    }

    /// A primary cell has no full flag.
    fn has_full_flag(&self) -> Option<bool> {
        if self.chip.condition.full == 0 { Some(false) } else { self.has_flag(self.chip.condition.full) }
    }

    /// In the order of the kernel's driver, which knows no voltages. `Dead` is a pack below the final threshold; in the
    /// driver it already is one below the first, which is `Low` in `capacity_level`.
    pub(super) fn health(&self) -> Option<&'static str> {
        let word = |row: &Register| self.snapshot.and_then(|last| last.value(row));
        if !failures(self.chip, word).is_empty() {
            // As the kernel's `sbs-battery` calls the failure of a bq20z65.
            return Some("Unspecified failure").filter(|_| self.is_present());
        }
        let told = self.first_set(&health(&self.chip.condition), "Good");
        told.map(
            |word| if word == "Good" && self.wants_conditioning() { "Calibration required" } else { word },
        )
    }

    /// A Smart Battery asks for a conditioning cycle.
    fn wants_conditioning(&self) -> bool {
        let (source, bit) = CONDITION_FLAG;
        let row = self.chip.register_at(source).filter(|_| self.chip.access.scheme == Scheme::Smbus);
        let mode = row.and_then(|row| self.snapshot?.value(row));
        mode.is_some_and(|mode| mode & i64::from(bit) != 0)
    }

    pub(super) fn capacity_level(&self) -> Option<&'static str> {
        // Predictions that are not to be trusted give no level.
        match self.chip.condition.certain {
            certain if certain != 0 && self.has_flag(certain) != Some(true) => {
                self.snapshot.map(|_| "Unknown")
            }
            _ => self.first_set(&level(&self.chip.condition), "Normal"),
        }
    }

    /// The word of the first set flag, or another word without one; `Unknown` if some flags are unknown. `None` where
    /// no document has the flags.
    fn first_set(&self, flags: &[(u32, &'static str)], otherwise: &'static str) -> Option<&'static str> {
        if !self.is_present() {
            return None;
        }
        let flags = flags.iter().filter(|(mask, _)| *mask != 0);
        let known: Vec<_> = flags.map(|&(mask, word)| (self.has_flag(mask), word)).collect();
        if known.is_empty() {
            return None;
        }
        let set = known.iter().find(|(is_set, _)| *is_set == Some(true)).map(|(_, word)| *word);
        let all_known = known.iter().all(|(is_set, _)| is_set.is_some());
        Some(set.unwrap_or(if all_known { otherwise } else { "Unknown" }))
    }
}

/// The flags that decide `health`, in order of precedence.
fn health(condition: &Condition) -> [(u32, &'static str); 6] {
    [
        (condition.overheat, "Overheat"),
        (condition.cold, "Cold"),
        (condition.over_voltage, "Over voltage"),
        (condition.critical, "Dead"),
        (condition.under_voltage, "Under voltage"),
        (condition.uncertain, "Calibration required"),
    ]
}

/// The flags that decide `capacity_level`, in order of precedence.
fn level(condition: &Condition) -> [(u32, &'static str); 3] {
    [(condition.full, "Full"), (condition.critical | condition.empty, "Critical"), (condition.low, "Low")]
}

/// The charging voltage of a pack of cells in series, from a reading for the pack or for a cell, and from a cell's
/// highest one.
fn pack_voltage(reading: i64, cell: i64, cells: i64) -> i64 {
    if 2 * reading < 3 * cell { reading * cells } else { reading }
}

/// A register's value with the sign from the flags; `None` for a meaningless reading, such as a 0 that the flags
/// contradict.
fn valid(register: &Register, reading: i64, flags: i64) -> Option<i64> {
    let is_set = |mask: u32| mask == 0 || flags & i64::from(mask) != 0;
    let is_value = register.values.hold(reading) && (reading != 0 || is_set(register.empty));
    is_value.then_some(if is_set(register.positive) { reading } else { -reading })
}

/// `uevent`: NAME first, then every attribute that the gauge has, all from one poll. The words are the kernel's, with
/// their spaces, because monitors compare them.
pub(super) fn uevent(name: &str, reading: &Reading<'_>) -> String {
    let mut lines = format!("POWER_SUPPLY_NAME={}\n", plain(name));
    for (attribute, text) in listed(reading) {
        let text = if attribute.is_of_pack(reading.chip) { plain(&text) } else { text };
        lines += &format!("POWER_SUPPLY_{}={}\n", attribute.name().to_uppercase(), text);
    }
    lines
}

/// The attributes of one poll that the gauge has, and their texts. While it is gone there are few.
pub(super) fn listed(reading: &Reading<'_>) -> impl Iterator<Item = (Attribute, String)> {
    let is_listed =
        |attribute: &Attribute| reading.snapshot.is_some() || LISTED_WHILE_GONE.contains(&attribute.name());
    Attribute::all().filter(is_listed).filter_map(|attribute| Some((attribute, attribute.text(reading)?)))
}

/// Text of a user or a gauge for `uevent`. Shells source that file, so characters with a meaning for them become `_`.
pub(super) fn plain(text: &str) -> String {
    let keep = |letter: char| letter.is_ascii_alphanumeric() || "._+-".contains(letter);
    text.chars().map(|letter| if keep(letter) { letter } else { '_' }).collect()
}

#[cfg(test)]
mod by_part;
#[cfg(test)]
mod packs;
#[cfg(test)]
mod tests;
