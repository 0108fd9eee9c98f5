// SPDX-License-Identifier: MIT

//! A gauge as a Smart Battery for the kernel's `sbs-battery`: the commands of Smart Battery Data ("Smart Battery Data
//! Specification", revision 1.1, section 5).
//!
//! Each answer follows from the last poll, by the rules of the attributes. The kernel drops a whole event if one
//! property of a present battery is unreadable. So a battery answers all of the driver's commands or, while it lacks
//! something without which its values would mislead, none: then it is absent. Anything else that the gauge lacks gets
//! the answer for an unknown value, where the specification or the kernel's ABI has one.

use std::sync::Arc;

use super::Fs;
use super::attribute::{CHEMISTRIES, Kind, Reading};
use super::supply::Supply;
use ti_gauge::chip::{Chip, Role, Scheme};

/// 7-bit address of a Smart Battery.
pub(crate) const ADDRESS: u8 = 0x0b;

// Commands.
const BATTERY_MODE: u8 = 0x03;
const TEMPERATURE: u8 = 0x08;
const VOLTAGE: u8 = 0x09;
const CURRENT: u8 = 0x0a;
const AVERAGE_CURRENT: u8 = 0x0b;
const MAX_ERROR: u8 = 0x0c;
const RELATIVE_STATE_OF_CHARGE: u8 = 0x0d;
const REMAINING_CAPACITY: u8 = 0x0f;
const FULL_CHARGE_CAPACITY: u8 = 0x10;
const RUN_TIME_TO_EMPTY: u8 = 0x11;
const AVERAGE_TIME_TO_EMPTY: u8 = 0x12;
const AVERAGE_TIME_TO_FULL: u8 = 0x13;
const CHARGING_CURRENT: u8 = 0x14;
const CHARGING_VOLTAGE: u8 = 0x15;
const BATTERY_STATUS: u8 = 0x16;
const CYCLE_COUNT: u8 = 0x17;
const DESIGN_CAPACITY: u8 = 0x18;
const DESIGN_VOLTAGE: u8 = 0x19;
const SPECIFICATION_INFO: u8 = 0x1a;
const MANUFACTURE_DATE: u8 = 0x1b;
const SERIAL_NUMBER: u8 = 0x1c;
const MANUFACTURER_NAME: u8 = 0x20;
const DEVICE_NAME: u8 = 0x21;
const DEVICE_CHEMISTRY: u8 = 0x22;

// Bits of BatteryMode().
/// Capacities are in 10 mWh instead of mAh.
const CAPACITY_MODE: u16 = 1 << 15;
/// Bits that the host may change: CAPACITY_MODE, CHARGER_MODE and ALARM_MODE. Nothing is broadcast here.
const WRITABLE: u16 = CAPACITY_MODE | 1 << 14 | 1 << 13;
/// CONDITION_FLAG: a conditioning cycle is requested.
const CONDITION: u16 = 1 << 7;

const OVER_TEMP_ALARM: u16 = 1 << 12;
const TERMINATE_DISCHARGE_ALARM: u16 = 1 << 11;
const REMAINING_CAPACITY_ALARM: u16 = 1 << 9;
const INITIALIZED: u16 = 1 << 7;
const DISCHARGING: u16 = 1 << 6;
const FULLY_CHARGED: u16 = 1 << 5;
const FULLY_DISCHARGED: u16 = 1 << 4;

/// SpecificationInfo(): version 1.1 without packet error codes, revision 1; values are unscaled, as drivers expect.
const SPECIFICATION: u16 = 0x0021;
/// An unknown time, in minutes.
const NO_TIME: u16 = 0xffff;

/// What a present battery must know: the values by which its driver, and programs that act on a low battery, decide.
const NEEDED: [u8; 6] =
    [TEMPERATURE, VOLTAGE, CURRENT, RELATIVE_STATE_OF_CHARGE, REMAINING_CAPACITY, FULL_CHARGE_CAPACITY];

/// Why gauges of that chip cannot be Smart Batteries.
pub(crate) fn obstacle(chip: &Chip) -> Option<String> {
    if chip.access.scheme == Scheme::Smbus {
        return Some("it is one already, which the kernel's sbs-battery reads where gaugefs does not".into());
    }
    let needed = [Role::Temp, Role::VoltageNow, Role::Capacity, Role::ChargeNow, Role::ChargeFull];
    let is_missing = |role: &Role| chip.register(*role).is_none();
    (needed.iter().any(is_missing) || chip.condition.primary.is_some()).then(|| {
        format!(
            "a {} does not report what a battery of the kernel needs: charge, full charge and capacity",
            chip.model
        )
    })
}

/// Values of a present battery whose change is worth an event.
pub(crate) type BatteryEvent =
    Option<(Option<&'static str>, Option<u16>, Option<&'static str>, Option<&'static str>)>;

pub(crate) struct SmartBattery {
    tree: Arc<Fs>,
    gauge: u16,
    /// Bits of BatteryMode() that the host has set.
    mode: u16,
    /// The host has looked for it.
    is_found: bool,
}

impl SmartBattery {
    pub(crate) fn new(tree: Arc<Fs>, gauge: u16) -> Self {
        Self { tree, gauge, mode: 0, is_found: false }
    }

    /// The subject of events.
    pub(crate) fn told(&self) -> BatteryEvent {
        self.ask(|reading| {
            let capacity = word(reading, RELATIVE_STATE_OF_CHARGE, false);
            is_there(reading)
                .then(|| (reading.status(), capacity, reading.capacity_level(), reading.health()))
        })
    }

    /// A transfer as in `i2c_server::Target`; `false` if it is not acknowledged.
    pub(crate) fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> bool {
        match write {
            [command] if !read.is_empty() => match self.answer(*command) {
                Some(bytes) => {
                    // Further bytes are those of an idle bus.
                    read.fill(0xff);
                    read.iter_mut().zip(bytes).for_each(|(to, byte)| *to = byte);
                    true
                }
                None => false,
            },
            [BATTERY_MODE, low, high] if read.is_empty() && self.ask(is_there) => {
                self.mode = u16::from_le_bytes([*low, *high]) & WRITABLE;
                true
            }
            // The address alone.
            [] if read.is_empty() => self.ask(is_there),
            _ => false,
        }
    }

    fn ask<T>(&self, question: impl FnOnce(&Reading<'_>) -> T) -> T {
        let supply: &Supply = &self.tree.supplies[usize::from(self.gauge)];
        let snapshot = supply.fresh();
        question(&supply.reading(snapshot.as_deref()))
    }

    fn answer(&mut self, command: u8) -> Option<Vec<u8>> {
        let (is_first, mode) = (!self.is_found, self.mode);
        self.is_found = true;
        let answer = self.ask(|reading| {
            if !is_there(reading) {
                return None;
            }
            let text = match command {
                MANUFACTURER_NAME => Some("Texas Instruments"),
                DEVICE_NAME => Some(reading.model),
                DEVICE_CHEMISTRY => Some(chemistry(reading.technology())),
                _ => None,
            };
            match text {
                Some(text) => Some([&[text.len() as u8], text.as_bytes()].concat()),
                None => {
                    let word = match command {
                        BATTERY_MODE => mode | if needs_calibration(reading) { CONDITION } else { 0 },
                        _ => word(reading, command, mode & CAPACITY_MODE != 0)?,
                    };
                    Some(word.to_le_bytes().into())
                }
            }
        });
        // The driver looks once, when it is bound, and would never return to an absent battery. It only needs some
        // answer here.
        let found = (is_first && command == BATTERY_STATUS).then(|| vec![0; 2]);
        answer.or(found)
    }
}

/// Whether everything that a battery needs is known and fits.
fn is_there(reading: &Reading<'_>) -> bool {
    let is_known =
        |&command: &u8| [false, true].iter().all(|&energy| word(reading, command, energy).is_some());
    reading.status().is_some_and(|status| status != "Unknown")
        && NEEDED.iter().chain(&[DESIGN_CAPACITY]).all(is_known)
}

fn needs_calibration(reading: &Reading<'_>) -> bool {
    reading.health() == Some("Calibration required")
}

fn chemistry(technology: &'static str) -> &'static str {
    CHEMISTRIES.iter().find(|(_, name)| *name == technology).map_or(technology, |(short, _)| short)
}

/// The word that a command reads; `None` without one, or if it does not fit into 16 bits.
fn word(reading: &Reading<'_>, command: u8, in_energy: bool) -> Option<u16> {
    let milli = |micro: i64| u16::try_from((micro as f64 / 1000.0).round() as i64).ok();
    let minutes = |role: Role| Some(u16::try_from(reading.seconds(role)? / 60).unwrap_or(NO_TIME));
    let time = |role: Role| Some(minutes(role).unwrap_or(NO_TIME));
    match command {
        TEMPERATURE => u16::try_from(reading.steps(Role::Temp, 1)?).ok(),
        VOLTAGE => milli(reading.micro(Role::VoltageNow, Kind::Voltage)?),
        CURRENT => current(reading),
        AVERAGE_CURRENT => match reading.micro(Role::CurrentAvg, Kind::Current) {
            Some(average) => signed(average),
            None => current(reading),
        },
        // Unknown, as after a full reset of a Smart Battery.
        MAX_ERROR => u16::try_from(reading.value(Role::CapacityErrorMargin).unwrap_or(100)).ok(),
        RELATIVE_STATE_OF_CHARGE => u16::try_from(reading.value(Role::Capacity)?).ok(),
        REMAINING_CAPACITY => capacity(reading, reading.micro(Role::ChargeNow, Kind::Charge)?, in_energy),
        FULL_CHARGE_CAPACITY => capacity(reading, reading.micro(Role::ChargeFull, Kind::Charge)?, in_energy),
        DESIGN_CAPACITY => capacity(reading, reading.charge_full_design().unwrap_or(0), in_energy),
        RUN_TIME_TO_EMPTY => time(reading.time_to_empty_now().unwrap_or(Role::TimeToEmptyNow)),
        AVERAGE_TIME_TO_EMPTY => time(Role::TimeToEmptyAvg),
        AVERAGE_TIME_TO_FULL => time(Role::TimeToFullNow),
        // No current or voltage is requested.
        CHARGING_CURRENT => milli(reading.micro(Role::ChargeCurrent, Kind::Current).unwrap_or(0)).or(Some(0)),
        CHARGING_VOLTAGE => milli(reading.charge_voltage().unwrap_or(0)).or(Some(0)),
        BATTERY_STATUS => Some(status(reading)),
        // The kernel's ABI: 0 if unknown.
        CYCLE_COUNT => Some(reading.value(Role::CycleCount).unwrap_or(0).try_into().unwrap_or(0)),
        DESIGN_VOLTAGE => milli(design_voltage(reading).unwrap_or(0)).or(Some(0)),
        SPECIFICATION_INFO => Some(SPECIFICATION),
        MANUFACTURE_DATE => Some(reading.manufactured().map_or(0, date)),
        SERIAL_NUMBER => Some(reading.value(Role::SerialNumber).unwrap_or(0) as u16),
        _ => None,
    }
}

fn date([year, month, day]: [i64; 3]) -> u16 {
    ((year - 1980) << 9 | month << 5 | day) as u16
}

fn signed(microamperes: i64) -> Option<u16> {
    let milliamperes = microamperes as f64 / 1000.0;
    // A flowing current is never 0.
    i16::try_from(milliamperes.signum() as i64 * milliamperes.abs().round().max(1.0) as i64)
        .ok()
        .map(|current| if microamperes == 0 { 0 } else { current as u16 })
}

/// The driver decides by Current() whether a battery is charged, discharged or neither, even if it is full. A full
/// battery with a small charging current is `Full`, so no current is reported then.
fn current(reading: &Reading<'_>) -> Option<u16> {
    let current = reading.micro(reading.current_now()?, Kind::Current)?;
    if reading.status() == Some("Full") { Some(0) } else { signed(current) }
}

/// The voltage that turns a charge into an energy, as UPower takes it from a gauge's folder.
fn design_voltage(reading: &Reading<'_>) -> Option<i64> {
    reading.design_voltage(Role::VoltageMaxDesign).or_else(|| reading.design_voltage(Role::VoltageMinDesign))
}

/// A charge in mAh, or in 10 mWh.
fn capacity(reading: &Reading<'_>, microampere_hours: i64, in_energy: bool) -> Option<u16> {
    let mut value = microampere_hours as f64 / 1000.0;
    if in_energy {
        let voltage = design_voltage(reading).or_else(|| reading.micro(Role::VoltageNow, Kind::Voltage))?;
        value *= voltage as f64 / 1e6 / 10.0;
    }
    u16::try_from(value.round() as i64).ok()
}

fn status(reading: &Reading<'_>) -> u16 {
    let state = match reading.status() {
        Some("Full") => FULLY_CHARGED,
        Some("Charging") => 0,
        // At rest, too.
        _ => DISCHARGING,
    };
    let level = match reading.capacity_level() {
        Some("Critical") => FULLY_DISCHARGED | TERMINATE_DISCHARGE_ALARM | REMAINING_CAPACITY_ALARM,
        Some("Low") => REMAINING_CAPACITY_ALARM,
        _ => 0,
    };
    let heat = if reading.health() == Some("Overheat") { OVER_TEMP_ALARM } else { 0 };
    INITIALIZED | state | level | heat
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::time::Duration;

    use super::super::{Access, Content, Item, Node, Scales, Supply, SupplyItem};
    use super::*;
    use gauge_bus::clock::Clock;
    use gauge_owner::Run;
    use gauge_owner::rig::{INTERVAL, Rig};

    /// The kernel's driver, and the tree beside it.
    struct Host {
        rig: Rig,
        tree: Arc<Fs>,
        battery: SmartBattery,
    }

    impl Host {
        fn of(chip: &str, scales: Scales) -> Self {
            let mut rig = Rig::of(chip, Run::default());
            rig.start().expect("it answers");
            let gauge = Supply::new("BAT0".into(), rig.handle.clone()).with_scales(scales);
            let tree = Arc::new(Fs::new(vec![gauge], Access { uid: 0, gid: 0, group: false }));
            Self { rig, tree: tree.clone(), battery: SmartBattery::new(tree, 0) }
        }

        fn new(chip: &str) -> Self {
            Self::of(chip, Scales::default())
        }

        fn turn(&mut self, knobs: &[(&str, &str)]) {
            for (knob, text) in knobs {
                self.rig.sim.set(knob, text).unwrap_or_else(|error| panic!("{knob} {text}: {error}"));
            }
            // The slow tier, too.
            for _ in 0..12 {
                self.rig.poll_after(INTERVAL);
            }
        }

        /// What a file of the tree shows.
        fn shown(&self, name: &str) -> Option<String> {
            let folder = Node::Of(0, Item::Supply(SupplyItem::Folder));
            match self.tree.content(self.tree.lookup(folder, name)?) {
                Content::Bytes(bytes) => Some(String::from_utf8_lossy(&bytes).trim_end().into()),
                Content::Unread(_) | Content::Absent => None,
            }
        }

        fn word(&mut self, command: u8) -> Option<i32> {
            let mut word = [0; 2];
            self.battery.transfer(&[command], &mut word).then(|| u16::from_le_bytes(word).into())
        }

        fn signed(&mut self, command: u8) -> Option<i32> {
            self.word(command).map(|word| i32::from(word as u16 as i16))
        }

        /// As the driver reads a block on an adapter without block reads: length first, then all of it.
        fn text(&mut self, command: u8) -> Option<String> {
            let mut length = [0];
            self.battery.transfer(&[command], &mut length).then_some(())?;
            let mut block = vec![0; usize::from(length[0]) + 1];
            self.battery.transfer(&[command], &mut block).then_some(())?;
            String::from_utf8(block.split_off(1)).ok()
        }

        /// As `sbs_get_battery_capacity` does it.
        fn capacity(&mut self, command: u8, mode: u16) -> Option<i32> {
            let before = self.word(BATTERY_MODE)? as u16;
            self.set_mode(before & !CAPACITY_MODE | mode);
            let capacity = self.word(command);
            self.set_mode(before);
            assert_eq!(self.word(BATTERY_MODE), Some(before.into()));
            capacity
        }

        fn set_mode(&mut self, mode: u16) {
            let [low, high] = mode.to_le_bytes();
            assert!(self.battery.transfer(&[BATTERY_MODE, low, high], &mut []));
        }

        /// As `sbs_get_battery_property` and `sbs_status_correct` do it.
        fn status(&mut self) -> Option<&'static str> {
            let (status, current) = (self.word(BATTERY_STATUS)? as u16, self.signed(CURRENT)?);
            Some(match current {
                0 if status & FULLY_CHARGED != 0 => "Full",
                0 => "Not charging",
                _ if status & FULLY_CHARGED != 0 => panic!("full, and a current flows"),
                _ if status & DISCHARGING != 0 => "Discharging",
                _ => "Charging",
            })
        }

        /// The properties of the driver, by the names of the attributes.
        fn properties(&mut self) -> BTreeMap<&'static str, String> {
            let numbers = [
                ("voltage_now", self.word(VOLTAGE).map(|millivolts| millivolts * 1000)),
                ("current_avg", self.signed(AVERAGE_CURRENT).map(|milliamperes| milliamperes * 1000)),
                ("capacity", self.word(RELATIVE_STATE_OF_CHARGE)),
                ("temp", self.word(TEMPERATURE).map(|kelvin| kelvin - 2731)),
                ("charge_now", self.capacity(REMAINING_CAPACITY, 0).map(|charge| charge * 1000)),
                ("charge_full", self.capacity(FULL_CHARGE_CAPACITY, 0).map(|charge| charge * 1000)),
                ("charge_full_design", self.capacity(DESIGN_CAPACITY, 0).map(|charge| charge * 1000)),
                ("cycle_count", self.word(CYCLE_COUNT)),
            ];
            let numbers =
                numbers.into_iter().map(|(name, number)| (name, number.map(|number| number.to_string())));
            let texts = [
                ("status", self.status().map(str::to_string)),
                ("serial_number", self.word(SERIAL_NUMBER).map(|word| format!("{word:04x}"))),
                ("manufacturer", self.text(MANUFACTURER_NAME)),
                ("model_name", self.text(DEVICE_NAME)),
            ];
            numbers
                .chain(texts)
                .map(|(name, text)| (name, text.unwrap_or_else(|| panic!("{name}: no answer"))))
                .collect()
        }
    }

    /// Attributes with finer steps than a Smart Battery's.
    fn is_near(name: &str, one: &str, other: &str) -> bool {
        let step = if name.starts_with("charge") || name.starts_with("current") { 500 } else { 0 };
        match (one.parse::<i64>(), other.parse::<i64>()) {
            (Ok(one), Ok(other)) => (one - other).abs() <= step,
            _ => one == other,
        }
    }

    #[test]
    fn every_gauge_shows_the_driver_what_the_tree_shows() {
        let mut left_out = Vec::new();
        let mut seen = BTreeMap::<String, usize>::new();
        for chip in Chip::all() {
            if obstacle(chip).is_some() {
                left_out.push(chip.name);
                continue;
            }
            let mut host = Host::new(chip.name);
            for point in [
                [("load_ma", "0"), ("soc", "60")],
                [("load_ma", "700"), ("soc", "40")],
                [("load_ma", "-700"), ("soc", "30")],
                [("load_ma", "500"), ("soc", "2")],
                [("load_ma", "-30"), ("soc", "100")],
            ] {
                host.turn(&point);
                for (name, property) in host.properties() {
                    let Some(shown) = host.shown(name) else { continue };
                    assert!(
                        is_near(name, &shown, &property),
                        "{} at {point:?}: {name} is {shown} and {property}",
                        chip.name
                    );
                    if name == "status" {
                        *seen.entry(shown).or_default() += 1;
                    }
                }
            }
        }
        left_out.retain(|name| Chip::by_name(name).is_some_and(|chip| chip.asks.is_none()));
        assert_eq!(left_out, ["bq35100", "bq27521", "sbs"]);
        for status in ["Charging", "Discharging", "Full", "Not charging"] {
            assert!(seen.get(status).is_some_and(|&times| times > 3), "{status}: {seen:?}");
        }
    }

    #[test]
    fn energies_are_in_units_of_10_mwh_and_fit_the_charges() {
        let mut host = Host::new("bq27441-g1");
        host.turn(&[("load_ma", "200")]);
        let volts = f64::from(host.word(VOLTAGE).expect("a voltage")) / 1000.0;
        for command in [REMAINING_CAPACITY, FULL_CHARGE_CAPACITY, DESIGN_CAPACITY] {
            let charge = f64::from(host.capacity(command, 0).expect("mAh"));
            let energy = f64::from(host.capacity(command, CAPACITY_MODE).expect("10 mWh"));
            assert!(
                (energy * 10.0 - charge * volts).abs() <= 10.0,
                "{energy} * 10 mWh, {charge} mAh, {volts} V"
            );
            assert!(energy > 100.0);
        }
        // With data flash known, it is the design voltage of the pack.
        let mut host = Host::new("bq34z100-g1");
        let rows: Vec<usize> = [48, 64].map(|id| host.rig.index(id)).into();
        host.rig.ask(&gauge_owner::operations::READ, rows).expect("the default key");
        host.turn(&[]);
        let shown: f64 = host.shown("voltage_max_design").expect("it is known").parse().expect("a number");
        assert_eq!(host.word(DESIGN_VOLTAGE), Some((shown / 1000.0) as i32));
        let charge = f64::from(host.capacity(FULL_CHARGE_CAPACITY, 0).expect("mAh"));
        let energy = f64::from(host.capacity(FULL_CHARGE_CAPACITY, CAPACITY_MODE).expect("10 mWh"));
        assert!((energy * 10.0 - charge * shown / 1e6).abs() <= 10.0);
    }

    #[test]
    fn what_a_gauge_does_not_have_is_answered_as_unknown() {
        let mut host = Host::new("bq27441-g1");
        host.turn(&[("load_ma", "0")]);
        for (command, word) in [
            (RUN_TIME_TO_EMPTY, NO_TIME),
            (AVERAGE_TIME_TO_EMPTY, NO_TIME),
            (AVERAGE_TIME_TO_FULL, NO_TIME),
            (MAX_ERROR, 100),
            (CYCLE_COUNT, 0),
            (DESIGN_VOLTAGE, 0),
            (MANUFACTURE_DATE, 0),
            (SERIAL_NUMBER, 0),
            (CHARGING_CURRENT, 0),
            (CHARGING_VOLTAGE, 0),
        ] {
            assert_eq!(host.word(command), Some(word.into()), "{command:#04x}");
        }
        assert_eq!(host.word(SPECIFICATION_INFO).map(|word| word >> 4 & 0xf), Some(2), "without PEC");
        assert_eq!(host.text(DEVICE_CHEMISTRY).as_deref(), Some("LION"));
    }

    #[test]
    fn a_gauge_that_is_away_acknowledges_nothing() {
        let mut host = Host::new("bq34z100-g1");
        host.turn(&[("load_ma", "100")]);
        assert!(host.battery.told().is_some());
        host.turn(&[("power", "off")]);
        assert_eq!(host.shown("present").as_deref(), Some("0"));
        // The driver's first look, when it is bound.
        assert_eq!(host.word(BATTERY_STATUS), Some(0));
        for command in 0..=0xff {
            assert_eq!(host.word(command), None, "{command:#04x}");
        }
        assert!(!host.battery.transfer(&[BATTERY_MODE, 0, 0x80], &mut []));
        assert!(!host.battery.transfer(&[], &mut []));
        assert_eq!(host.battery.told(), None);
        host.turn(&[("power", "on")]);
        assert_eq!(host.status(), Some("Discharging"));
        assert!(host.battery.transfer(&[], &mut []));

        // Its owner polls no more: after three intervals the tree shows nothing either.
        host.rig.clock.sleep(3 * INTERVAL + Duration::from_secs(1));
        assert_eq!((host.shown("voltage_now"), host.word(VOLTAGE)), (None, None));
    }

    #[test]
    fn a_battery_that_does_not_fit_is_not_there() {
        let scales = Scales { voltage: 100.0, ..Scales::default() };
        let mut host = Host::of("bq27441-g1", scales);
        host.turn(&[("load_ma", "100")]);
        assert_eq!(host.word(BATTERY_STATUS), Some(0));
        assert_eq!((host.word(BATTERY_STATUS), host.word(VOLTAGE)), (None, None));
        // Signs are the specification's, whatever the files show.
        let scales = Scales { absolute_current: true, ..Scales::default() };
        let mut host = Host::of("bq27441-g1", scales);
        host.turn(&[("load_ma", "100")]);
        assert!(host.signed(CURRENT).is_some_and(|current| current < 0));
    }

    #[test]
    fn only_what_smart_batteries_have_is_written_or_read() {
        let mut host = Host::new("bq34z100-g1");
        host.turn(&[]);
        for write in [&[0x00, 0x41, 0x00][..], &[0x16, 0, 0], &[0x03, 0, 0, 0], &[0x03, 0], &[0x55; 40]] {
            assert!(!host.battery.transfer(write, &mut []), "{write:?}");
        }
        for write in [&[][..], &[0x08, 0x09], &[0x04], &[0xff]] {
            assert!(!host.battery.transfer(write, &mut [0; 2]), "{write:?}");
        }
        host.set_mode(0xffff);
        assert_eq!(host.word(BATTERY_MODE), Some(0xe000));
        // More than there is.
        let mut long = [0; 40];
        assert!(host.battery.transfer(&[VOLTAGE], &mut long) && long[2..] == [0xff; 38]);
    }

    #[test]
    fn events_are_about_status_capacity_level_and_health() {
        let mut host = Host::new("bq34z100-g1");
        host.turn(&[("load_ma", "0"), ("speed", "0")]);
        let told = host.battery.told();
        host.turn(&[("voltage_mv", "25000")]);
        assert_eq!(host.battery.told(), told, "a voltage is no news");
        host.turn(&[("load_ma", "300")]);
        assert_ne!(host.battery.told(), told);
    }
}
