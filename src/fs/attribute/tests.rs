// SPDX-License-Identifier: MIT

//! What the attributes of simulated gauges show.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{Bus, BusError};

use super::by_part::read_places;
use super::*;
use gauge_owner::rig::{INTERVAL, Rig};
use gauge_owner::{Direct, GaugeOptions, Run, operations as op};
use gauge_sim::{Options, Sim, SimBus};
use ti_gauge::chip::{Source, Tier};
use ti_gauge::value::Type;

/// What a battery may report by the kernel's ABI (`Documentation/ABI/testing/sysfs-class-power` and
/// `Documentation/power/power_supply_class.rst`).
const ABI: &[&str] = &[
    "authentic",
    "calibrate",
    "capacity",
    "capacity_alert_max",
    "capacity_alert_min",
    "capacity_error_margin",
    "capacity_level",
    "charge_avg",
    "charge_counter",
    "charge_empty",
    "charge_empty_design",
    "charge_full",
    "charge_full_design",
    "charge_now",
    "charge_type",
    "constant_charge_current",
    "constant_charge_current_max",
    "constant_charge_voltage",
    "constant_charge_voltage_max",
    "current_avg",
    "current_max",
    "current_now",
    "cycle_count",
    "energy_avg",
    "energy_empty",
    "energy_empty_design",
    "energy_full",
    "energy_full_design",
    "energy_now",
    "health",
    "internal_resistance",
    "manufacture_day",
    "manufacture_month",
    "manufacture_year",
    "manufacturer",
    "model_name",
    "power_avg",
    "power_now",
    "present",
    "scope",
    "serial_number",
    "state_of_health",
    "status",
    "technology",
    "temp",
    "temp_alert_max",
    "temp_alert_min",
    "temp_ambient",
    "temp_max",
    "temp_min",
    "time_to_empty_avg",
    "time_to_empty_now",
    "time_to_full_avg",
    "time_to_full_now",
    "type",
    "voltage_avg",
    "voltage_boot",
    "voltage_max",
    "voltage_max_design",
    "voltage_min",
    "voltage_min_design",
    "voltage_now",
    "voltage_ocv",
];

#[test]
fn every_attribute_is_one_of_the_kernels() {
    for attribute in Attribute::all() {
        assert!(ABI.contains(&attribute.name()), "{}", attribute.name());
    }
}

#[test]
fn programs_that_read_a_mount_know_every_attribute() {
    use gaugefs_client::names::{self, Kind};
    let kind = |row: &Row| match row.show {
        Show::Text(_) => "text",
        Show::Number(_) => "number",
        Show::Hex(_) => "word",
    };
    let known = names::attributes().map(|attribute| match attribute.kind {
        Kind::Text => (attribute.name, "text"),
        Kind::Number(_) => (attribute.name, "number"),
        Kind::Hex => (attribute.name, "word"),
    });
    assert_eq!(
        known.collect::<Vec<_>>(),
        ATTRIBUTES.iter().map(|row| (row.name, kind(row))).collect::<Vec<_>>()
    );
}

#[test]
fn names_are_unique() {
    let names: BTreeSet<_> = Attribute::all().map(Attribute::name).collect();
    assert_eq!(names.len(), ATTRIBUTES.len());
    assert!(LISTED_WHILE_GONE.iter().all(|name| names.contains(name)));
}

/// A register and its reading, if that is not the gauge's own.
type Other = Arc<Mutex<Option<(u8, Vec<u8>)>>>;

/// A bus with another reading of one register.
struct Reads {
    bus: SimBus,
    other: Other,
}

impl Bus for Reads {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        self.bus.transfer(write, read)?;
        if let ([first], Some((code, bytes))) = (write, &*self.other.lock().expect("no panic")) {
            for (at, byte) in bytes.iter().enumerate() {
                let at = (usize::from(*code) + at).checked_sub(usize::from(*first));
                if let Some(shown) = at.and_then(|at| read.get_mut(at)) {
                    *shown = *byte;
                }
            }
        }
        Ok(())
    }
}

/// The attributes after a poll with this reading of a register.
fn reading(chip: &Chip, register: &Register, value: i64, name: &str) -> Option<String> {
    let other = Other::default();
    let wrap = |bus| Box::new(Reads { bus, other: other.clone() }) as Box<dyn Bus>;
    let mut rig = Rig::on(chip.name, Run::default(), wrap);
    // A packet error code would show that the bytes are others.
    let _ = rig.sim.set("specification", "0x0021");
    rig.start().expect("it answers");
    let bytes = value.to_le_bytes()[..usize::from(register.size)].to_vec();
    *other.lock().expect("no panic") = Some((register.source.command().expect("a standard command"), bytes));
    rig.poll_after(Duration::from_secs(3));
    show(&rig, name)
}

/// Attributes that one register decides.
const SHOWN: &[(Role, &str)] = &[
    (Role::Capacity, "capacity"),
    (Role::CapacityErrorMargin, "capacity_error_margin"),
    (Role::ChargeFull, "charge_full"),
    (Role::VoltageNow, "voltage_now"),
    (Role::Temp, "temp"),
    (Role::TimeToEmptyNow, "time_to_empty_now"),
    (Role::TimeToEmptyAvg, "time_to_empty_avg"),
    (Role::TimeToFullNow, "time_to_full_now"),
    (Role::TimeToFullAvg, "time_to_full_avg"),
    (Role::StateOfHealth, "state_of_health"),
];

#[test]
fn regression_a_reading_that_is_no_value_was_shown_as_one() {
    let mut compared = BTreeSet::new();
    for chip in Chip::all() {
        for &(role, name) in SHOWN {
            let Some(register) = chip.register(role).filter(|register| register.tier == Tier::Poll) else {
                continue;
            };
            let (least, greatest) = (register.values.least, register.values.greatest);
            let greatest = greatest.min((1 << (8 * register.size)) - 1);
            // A primary cell shows its health in some modes only.
            if reading(chip, register, greatest, name).is_none() {
                assert!(chip.condition.primary.is_some(), "{}: {name} {greatest}", chip.name);
                continue;
            }
            for none in [least.max(0) - 1, greatest + 1]
                .into_iter()
                .filter(|&one| one >= 0 && one >> (8 * register.size) == 0)
            {
                let shown = reading(chip, register, none, name);
                assert_eq!(shown, None, "{}: {name}, {}() is {none}", chip.name, register.name);
                compared.insert(name);
            }
            if let Some(by) = register.validity.and_then(|source| chip.register_at(source)) {
                assert_eq!(reading(chip, by, 0, name), None, "{}: {name}", chip.name);
                assert!(reading(chip, by, 1, name).is_some(), "{}: {name}", chip.name);
            }
        }
    }
    assert_eq!(compared.len(), SHOWN.len(), "{compared:?}");
}

/// psutil computes a percentage of 0 if `charge_full` is 0, and takes `capacity` if it is missing.
#[test]
fn regression_a_full_charge_capacity_of_0_was_a_value() {
    let chip = Chip::by_name("bq34z100-g1").expect("it has a table");
    let full = chip.register(Role::ChargeFull).expect("a register");
    assert_eq!(reading(chip, full, 0, "charge_full"), None);
    assert!(reading(chip, full, 0, "capacity").is_some());
    assert!(reading(chip, full, 0, "charge_now").is_some());
}

#[test]
fn regression_initcomp_of_a_bq27220_was_not_looked_at() {
    let chip = Chip::by_name("bq27220").expect("it has a table");
    let status = chip.register_at(Source::Command(0x3A)).expect("OperationStatus()");
    for (word, is_shown) in [(0x0024, true), (0x0004, false)] {
        assert_eq!(reading(chip, status, word, "capacity").is_some(), is_shown, "0x{word:04x}");
    }
}

/// A simulated gauge that has been identified and polled.
pub(super) fn open(chip: &str) -> Rig {
    let mut rig = Rig::of(chip, Run::default());
    rig.start().expect("it answers");
    rig
}

pub(super) fn turn(rig: &Rig, knob: &str, text: &str) {
    rig.sim.set(knob, text).unwrap_or_else(|error| panic!("{knob} {text}: {error}"));
}

pub(super) fn show(rig: &Rig, name: &str) -> Option<String> {
    show_scaled(rig, name, &Scales::default())
}

fn show_scaled(rig: &Rig, name: &str, scales: &Scales) -> Option<String> {
    let published = rig.handle.published();
    let scales = Scales { energy_shown: true, ..scales.clone() };
    let reading = Reading::new(&rig.handle, published.snapshot.as_deref(), &scales);
    Attribute::by_name(name).expect("an attribute").text(&reading)
}

#[track_caller]
fn assert_shows(rig: &Rig, expected: &[(&str, Option<&str>)]) {
    for &(name, text) in expected {
        assert_eq!(show(rig, name).as_deref(), text, "{name}");
    }
}

#[test]
fn an_attribute_may_be_a_text_of_the_pack() {
    let table = Chip::by_name("bq34z100-g1").expect("it has a table");
    let row = Register::new(0x78, Type::S(8), "ManufacturerName", "", Tier::Static).role(Role::Manufacturer);
    let registers = Vec::leak([table.registers, &[row]].concat());
    let chip: &Chip = Box::leak(Box::new(Chip { registers, ..table.clone() }));
    let shown = |chip, bytes: &[u8]| {
        let clock = Arc::new(SimClock::new());
        let sim = Sim::new("bq34z100-g1", &Options::default(), clock.clone()).expect("it is simulated");
        clock.sleep(Duration::from_secs(1));
        let run = Run { interval: INTERVAL, ..Run::default() };
        let other = Other::new(Mutex::new(Some((0x78, bytes.to_vec()))));
        let bus = Box::new(Reads { bus: sim.bus(), other });
        let mut gauge = Direct::new(chip, bus, clock, run);
        gauge.open().expect("it answers");
        let (published, scales) = (gauge.handle.published(), Scales::default());
        let reading = Reading::new(&gauge.handle, published.snapshot.as_deref(), &scales);
        let lines = uevent("BAT0", &reading);
        let line = lines.lines().find_map(|line| line.strip_prefix("POWER_SUPPLY_MANUFACTURER="));
        let text = Attribute::by_name("manufacturer").expect("an attribute").text(&reading);
        (text, line.map(str::to_string))
    };
    let pair = |text: &str, line: &str| (Some(text.to_string()), Some(line.to_string()));
    assert_eq!(shown(table, b"\x04ACME"), pair("Texas Instruments", "Texas Instruments"));
    assert_eq!(shown(chip, b"\x04ACME"), pair("ACME", "ACME"));
    assert_eq!(shown(chip, b"\x07A`b \n\x1b$"), pair("A`b ??$", "A_b____"));
    assert_eq!(shown(chip, b"\x00ACME"), (None, None));
}

/// Everything that is measured, or follows from it.
const MEASURED: [&str; 17] = [
    "capacity",
    "capacity_error_margin",
    "voltage_now",
    "current_now",
    "current_avg",
    "charge_now",
    "charge_full",
    "charge_full_design",
    "energy_now",
    "power_avg",
    "temp",
    "time_to_empty_now",
    "time_to_full_now",
    "cycle_count",
    "state_of_health",
    "status",
    "health",
];

#[test]
fn without_a_battery_nothing_is_measured() {
    let mut rig = open("bq27441-g1");
    assert_shows(&rig, &[("present", Some("1")), ("health", Some("Good"))]);
    // OpConfig without [BIE]: the host says whether there is a battery.
    rig.sim.set_flash(64, 0, &[0x05, 0xf8]);
    let bat_remove = 0x000d;
    rig.ask(&op::CONTROL, bat_remove).expect("a sealed gauge takes it");
    rig.poll_after(INTERVAL);
    assert_shows(&rig, &[("present", Some("0"))]);
    for name in MEASURED.into_iter().chain(["capacity_level"]) {
        assert_eq!(show(&rig, name), None, "{name}");
    }
}

#[test]
fn before_the_first_measurement_no_value_is_shown() {
    for chip in ["bq34z100-g1", "bq34z100-r2", "bq27441-g1", "bq27520-g3", "bq27500", "bq27220", "bq34110"] {
        let mut rig = open(chip);
        turn(&rig, "first_ms", "3000");
        turn(&rig, "first_values", "nonsense");
        turn(&rig, "power", "off");
        turn(&rig, "power", "on");
        rig.clock.sleep(Duration::from_secs(1));
        for _ in 0..3 {
            rig.poll_after(Duration::ZERO);
        }
        assert_shows(
            &rig,
            &[("present", Some("1")), ("status", Some("Unknown")), ("health", Some("Unknown"))],
        );
        for name in &MEASURED[..15] {
            assert_eq!(show(&rig, name), None, "{chip}: {name}");
        }
        for _ in 0..4 {
            rig.poll_after(Duration::from_secs(2));
        }
        assert!(show(&rig, "voltage_now").is_some_and(|text| text != "0"), "{chip}");
        assert_shows(&rig, &[("status", Some("Not charging"))]);
    }
}

#[test]
fn the_status_agrees_with_the_current_that_is_shown() {
    for chip in ["bq34z100-g1", "bq27520-g3", "bq27441-g1", "bq34110"] {
        let mut rig = open(chip);
        for load in ["500", "-500", "0", "-300", "300"] {
            turn(&rig, "load_ma", load);
            for _ in 0..12 {
                rig.poll_after(Duration::from_secs(1));
                let current: i64 = show(&rig, "current_now").expect("measured").parse().expect("a number");
                let status = show(&rig, "status").expect("present");
                let expected: &[&str] = match current {
                    0 => &["Not charging", "Full"],
                    1.. => &["Charging", "Full"],
                    _ => &["Discharging"],
                };
                assert!(expected.contains(&&*status), "{chip}: {status} at {current} µA");
            }
        }
    }
}

/// The charge ends with a current that is small, not 0.
#[test]
fn a_pack_that_is_charged_is_full_although_a_current_still_flows() {
    let mut rig = open("bq34110");
    turn(&rig, "soc", "100");
    turn(&rig, "load_ma", "-20");
    turn(&rig, "speed", "100");
    for _ in 0..100 {
        rig.poll_after(Duration::from_secs(1));
    }
    assert_shows(&rig, &[("capacity_level", Some("Full")), ("status", Some("Full"))]);
    turn(&rig, "speed", "1");
    turn(&rig, "load_ma", "500");
    rig.poll_after(Duration::from_secs(3));
    assert_shows(&rig, &[("capacity_level", Some("Full")), ("status", Some("Discharging"))]);
}

#[test]
fn what_a_gauge_of_primary_cells_does_not_know_is_not_shown() {
    let mut rig = open("bq35100");
    turn(&rig, "load_ma", "50");
    rig.poll_after(INTERVAL);
    let unknown = Some("Unknown");
    assert_shows(&rig, &[("current_now", None), ("status", unknown), ("state_of_health", None)]);
    assert_shows(&rig, &[("health", unknown), ("capacity_level", unknown)]);
    let (start, stop) = (0x0011, 0x0012);
    rig.ask(&op::CONTROL, start).expect("a sealed gauge takes it");
    rig.poll_after(Duration::from_secs(3));
    assert_shows(&rig, &[("current_now", Some("-50000")), ("status", Some("Discharging"))]);
    rig.ask(&op::CONTROL, stop).expect("a sealed gauge takes it");
    rig.poll_after(INTERVAL);
    assert_shows(&rig, &[("current_now", None), ("status", unknown)]);

    // ALERT Configuration lets no flag through, and the mode accumulates charge only: both are known now.
    let all = (0..rig.handle.chip().subclasses.len()).collect();
    rig.ask(&op::READ, all).expect("the default key");
    assert_shows(&rig, &[("health", unknown), ("capacity_level", unknown), ("state_of_health", None)]);
    // [GMSEL] 10, and all alerts.
    rig.sim.set_flash(0, 0x1b1, &[0x82, 0xfb]);
    turn(&rig, "power", "off");
    turn(&rig, "power", "on");
    rig.poll_after(INTERVAL);
    rig.ask(&op::REFRESH, ()).expect("it answers");
    let all = (0..rig.handle.chip().subclasses.len()).collect();
    rig.ask(&op::READ, all).expect("the default key");
    rig.poll_after(INTERVAL);
    assert_shows(&rig, &[("health", Some("Good")), ("capacity_level", Some("Normal"))]);
    assert!(show(&rig, "state_of_health").is_some());
}

/// The power of the bq34z100-G1 is unsigned, that of the others negative while discharging.
#[test]
fn power_has_the_sign_of_the_current() {
    for chip in ["bq34z100-g1", "bq27441-g1", "bq27520-g3"] {
        let mut rig = open(chip);
        turn(&rig, "load_ma", "500");
        turn(&rig, "speed", "20");
        for _ in 0..20 {
            rig.poll_after(Duration::from_secs(2));
        }
        let power: i64 = show(&rig, "power_avg").expect("measured").parse().expect("a number");
        assert!(power < -1_000_000, "{chip}: {power} µW");
    }
}

#[test]
fn regression_the_power_of_a_discharge_is_none_of_a_charge() {
    for chip in ["bq34z100-g1", "bq34z100-r2"] {
        let mut rig = open(chip);
        turn(&rig, "speed", "20");
        for (load, is_there) in [("500", true), ("-500", false), ("0", true)] {
            turn(&rig, "load_ma", load);
            for _ in 0..20 {
                rig.poll_after(Duration::from_secs(10));
            }
            let power: Option<i64> = show(&rig, "power_avg").map(|text| text.parse().expect("a number"));
            assert_eq!(power.is_some(), is_there, "{chip} {load}: {power:?}");
            assert!(
                power.is_none_or(|power| if load == "0" { power == 0 } else { power < 0 }),
                "{chip} {load}: {power:?}"
            );
        }
    }
}

/// Both in one simulated pack: AveragePower() of the bq28z610 is in 10 mW (SLUUA65E), that of the bq27500 in mW.
#[test]
fn regression_power_is_voltage_times_current() {
    for chip in
        ["bq28z610", "bq27500", "bq27510-g1", "bq27541", "bq27530", "bq27545", "bq27441-g1", "bq34z100-r2"]
    {
        let mut rig = open(chip);
        turn(&rig, "load_ma", "500");
        for _ in 0..40 {
            rig.poll_after(Duration::from_secs(2));
        }
        let number = |name| show(&rig, name).expect(name).parse::<f64>().expect("a number");
        let (power, product) = (number("power_avg"), number("voltage_now") * number("current_avg") / 1e6);
        assert!((power / product - 1.0).abs() < 0.02, "{chip}: {power} µW of {product} µW");
    }
}

/// As the driver has it: nothing holds the lines of a gauge that is not there.
#[test]
fn regression_a_bq27000_whose_flags_are_all_set_is_absent() {
    for chip in ["bq27000", "bq27010"] {
        let mut rig = open(chip);
        assert_shows(&rig, &[("present", Some("1"))]);
        turn(&rig, "battery", "out");
        rig.poll_after(INTERVAL);
        assert_shows(&rig, &[("present", Some("0"))]);
        for name in
            ["voltage_now", "status", "capacity", "charge_full_design", "current_now", "temp", "health"]
        {
            assert_eq!(show(&rig, name), None, "{chip} {name}");
        }
        turn(&rig, "battery", "in");
        rig.poll_after(INTERVAL);
        assert_shows(&rig, &[("present", Some("1"))]);
    }
}

/// Attributes of Linux 6.12's driver that not all parts have, and `time_to_empty_avg` of parts whose register for it
/// the driver shows only for other parts.
#[rustfmt::skip]
const OF_THE_DRIVER: &[(&[&str], &str)] = &[
    (&["bq27000"], "capacity charge_full charge_full_design charge_now current_now cycle_count energy_now power_avg temp time_to_empty_avg time_to_empty_now time_to_full_now voltage_now"),
    (&["bq27010"], "capacity charge_full charge_full_design charge_now current_now cycle_count temp time_to_empty_avg time_to_empty_now time_to_full_now voltage_now"),
    (&["bq2750x", "bq2751x", "bq2752x", "bq27510-g3"], "capacity charge_full charge_full_design charge_now current_now cycle_count temp time_to_empty_now voltage_now"),
    (&["bq27510-g1", "bq27520-g2"], "capacity charge_full charge_full_design charge_now current_now cycle_count energy_now power_avg temp time_to_empty_avg time_to_empty_now time_to_full_now voltage_now"),
    // TI gives the unit of its energy in two ways.
    (&["bq27510-g2"], "capacity charge_full charge_full_design charge_now current_now cycle_count power_avg temp time_to_empty_avg time_to_empty_now time_to_full_now voltage_now"),
    (&["bq27520-g1"], "capacity charge_full charge_full_design charge_now current_now energy_now power_avg temp time_to_empty_avg time_to_empty_now time_to_full_now voltage_now"),
    (&["bq27520-g4"], "capacity charge_full charge_now current_now cycle_count temp time_to_empty_now voltage_now"),
    (&["bq27521"], "current_now temp voltage_now"),
    (&["bq27530", "bq27531"], "capacity charge_full charge_now current_now cycle_count power_avg temp time_to_empty_now voltage_now"),
    // The driver shows no state_of_health.
    (&["bq27545"], "capacity charge_full charge_now current_now cycle_count power_avg state_of_health temp time_to_empty_now voltage_now"),
    (&["bq27541"], "capacity charge_full charge_full_design charge_now current_now cycle_count power_avg state_of_health temp time_to_empty_now voltage_now"),
    // At the place of the driver's power_avg is a threshold.
    (&["bq27542", "bq27546"], "capacity charge_full charge_full_design charge_now current_now cycle_count state_of_health temp time_to_empty_now voltage_now"),
    (&["bq27411", "bq27425"], "capacity charge_full charge_full_design charge_now current_now temp voltage_now"),
    // The driver shows a power_avg of theirs; nobody says in which unit it is.
    (&["bq27z561", "bq28z620", "bq78z100"], "capacity charge_full charge_full_design charge_now current_now cycle_count temp time_to_empty_now time_to_full_now voltage_now"),
];

#[test]
fn a_gauge_without_a_table_shows_the_attributes_of_the_kernels_driver() {
    let mut chips = 0;
    for (names, attributes) in OF_THE_DRIVER {
        for name in *names {
            let mut rig = open(name);
            turn(&rig, "speed", "20");
            let mut shown = BTreeSet::new();
            for load in ["500", "-500"] {
                turn(&rig, "load_ma", load);
                for _ in 0..5 {
                    rig.poll_after(Duration::from_secs(2));
                }
                let found = Attribute::all().map(Attribute::name);
                shown.extend(found.filter(|attribute| show(&rig, attribute).is_some()));
            }
            let mut expected: BTreeSet<_> = attributes.split(' ').collect();
            expected.extend(["type", "status", "present", "technology", "scope", "current_avg"]);
            expected.extend(["manufacturer", "model_name"]);
            if *name != "bq27521" {
                expected.extend(["health", "capacity_level"]);
            }
            assert_eq!(shown, expected, "{name}");
            chips += 1;
        }
    }
    assert_eq!(chips, ti_gauge::chip::kernel::GAUGES.len());
}

#[test]
fn a_bq27000_counts_in_the_voltage_of_its_sense_resistor() {
    let mut rig = open("bq27000");
    let number = |rig: &Rig, name| show(rig, name).expect("measured").parse::<i64>().expect("a number");
    let raw = |rig: &Rig, name| {
        let published = rig.handle.published();
        let chip = rig.handle.chip();
        let register = chip.registers.iter().find(|register| register.name == name).expect("a register");
        published.snapshot.as_ref().expect("polled").value(register).expect("read")
    };
    // In quarters of a kelvin, rounded down as in the driver.
    assert_eq!(number(&rig, "temp"), 249);
    assert_eq!(number(&rig, "charge_full_design"), 25 * 256 * 3570 / 20);
    for (load, sign, status) in [("500", -1, "Discharging"), ("-500", 1, "Charging")] {
        turn(&rig, "load_ma", load);
        for _ in 0..20 {
            rig.poll_after(Duration::from_secs(10));
        }
        let (current, power) = (raw(&rig, "AverageCurrent"), raw(&rig, "AveragePower"));
        assert!((2700..2900).contains(&current), "{current} steps of 3.57 µV");
        assert_eq!(number(&rig, "current_now"), sign * current * 3570 / 20);
        assert_eq!(number(&rig, "power_avg"), power * 29200 / 20, "without a sign, as in the driver");
        assert_eq!(number(&rig, "charge_now"), raw(&rig, "NominalAvailableCapacity") * 3570 / 20);
        assert_eq!(number(&rig, "energy_now"), raw(&rig, "AvailableEnergy") * 29200 / 20);
        assert_shows(&rig, &[("status", Some(status)), ("health", Some("Good"))]);
    }
    turn(&rig, "load_ma", "0");
    turn(&rig, "soc", "0");
    rig.poll_after(INTERVAL);
    // [EDVF] is set, so this 0 is one.
    assert_shows(&rig, &[("capacity", Some("0")), ("health", Some("Dead"))]);
}

#[test]
fn an_empty_reading_of_a_bq27000_that_is_not_empty_is_no_value() {
    let rig = open("bq27000");
    let capacity = rig.handle.chip().register(Role::Capacity).expect("a register");
    assert_eq!(valid(capacity, 0, 0x80), None);
    assert_eq!(valid(capacity, 0, 0x81), Some(0));
    assert_eq!(valid(capacity, 1, 0x80), Some(1));
    let current = rig.handle.chip().register(Role::CurrentAvg).expect("a register");
    assert_eq!(valid(current, 0, 0x80), Some(0));
    assert_eq!([valid(current, 7, 0x80), valid(current, 7, 0)], [Some(7), Some(-7)]);
}

#[test]
fn a_pack_is_dead_at_the_final_threshold_and_low_at_the_first() {
    for chip in ["bq27541", "bq27411", "bq27000", "bq34z100-g1"] {
        let mut rig = open(chip);
        let mut at = |soc| {
            turn(&rig, "soc", soc);
            rig.poll_after(INTERVAL);
            ["health", "capacity_level"].map(|name| show(&rig, name).expect("known"))
        };
        assert_eq!(at("50"), ["Good", "Normal"], "{chip}");
        assert_eq!(at("11"), ["Good", "Low"], "{chip}");
        assert_eq!(at("1"), ["Dead", "Critical"], "{chip}");
    }
}

/// A bq34z100-R2 whose pack is discharged, after a power-up with these scales of voltage, current and energy.
fn with_scales(scales: [u8; 3]) -> Rig {
    let mut rig = open("bq34z100-r2");
    rig.sim.set_flash(48, 30, &scales);
    turn(&rig, "power", "off");
    turn(&rig, "power", "on");
    turn(&rig, "load_ma", "500");
    for _ in 0..20 {
        rig.poll_after(Duration::from_secs(2));
    }
    rig
}

/// Which of the scales it has.
fn byte(kind: Kind) -> usize {
    match kind {
        Kind::Voltage => 0,
        Kind::Current | Kind::Charge => 1,
        Kind::Energy => 2,
    }
}

const SCALED: [(&str, Role, Kind); 8] = [
    ("voltage_now", Role::VoltageNow, Kind::Voltage),
    ("current_now", Role::CurrentNow, Kind::Current),
    ("current_avg", Role::CurrentAvg, Kind::Current),
    ("charge_now", Role::ChargeNow, Kind::Charge),
    ("charge_full", Role::ChargeFull, Kind::Charge),
    ("charge_full_design", Role::ChargeFullDesign, Kind::Charge),
    ("energy_now", Role::EnergyNow, Kind::Energy),
    ("power_avg", Role::PowerAvg, Kind::Energy),
];

#[test]
fn every_attribute_is_multiplied_by_the_scale_that_the_gauge_reports() {
    let given = Scales { voltage: 1.5, current: 0.5, energy: 3.0, ..Scales::default() };
    for reported in [[1, 1, 1], [2, 10, 20], [255, 255, 255]] {
        let rig = with_scales(reported);
        let snapshot = rig.handle.published().snapshot.clone().expect("a poll");
        for (name, role, kind) in SCALED {
            let raw = snapshot.value(rig.handle.chip().register(role).expect("a register")).expect("read");
            assert_ne!(raw, 0, "{name}");
            let sign = if role == Role::PowerAvg { -1 } else { 1 };
            // Energies are in cWh.
            let step = if kind == Kind::Energy { 10_000 } else { 1000 };
            let scaled = sign * raw * step * i64::from(reported[byte(kind)]);
            assert_eq!(show(&rig, name), Some(scaled.to_string()), "{name} {reported:?}");
            // The user's scale comes on top.
            let both = (scaled as f64 * given.of(kind)).round() as i64;
            assert_eq!(show_scaled(&rig, name, &given), Some(both.to_string()), "{name} {reported:?}");
        }
    }
}

/// The scales are read with every poll.
#[test]
fn a_scale_applies_as_soon_as_the_gauge_reports_it() {
    let mut rig = with_scales([1, 1, 1]);
    let before: i64 = show(&rig, "voltage_now").expect("measured").parse().expect("a number");
    turn(&rig, "load_ma", "0");
    turn(&rig, "voltage_mv", &(before / 1000).to_string());
    rig.sim.set_flash(48, 30, &[7]);
    turn(&rig, "power", "off");
    turn(&rig, "power", "on");
    rig.poll_after(Duration::from_secs(2));
    assert_shows(&rig, &[("voltage_now", Some(&(7 * before).to_string()))]);
}

#[test]
fn a_scale_of_0_leaves_no_value_of_its_kind() {
    let rig = with_scales([1, 0, 1]);
    for (name, _, kind) in SCALED {
        assert_eq!(show(&rig, name).is_some(), byte(kind) != 1, "{name}");
    }
    assert_shows(&rig, &[("status", Some("Unknown"))]);
}

#[test]
fn a_scale_that_may_be_given_twice_is_warned_of() {
    let warnings = |reported, given: &Scales| {
        let (handle, scales) = (with_scales(reported).handle.clone(), given.clone());
        crate::fs::Supply::new("BAT0".into(), handle).with_scales(scales).warnings()
    };
    let given = Scales { current: 10.0, energy: 2.5, ..Scales::default() };
    assert_eq!(
        warnings([5, 10, 1], &given),
        [
            "BAT0: the gauge reports a scale of 10, and current-scale 10 comes on top: values are multiplied by 100; \
             leave out current-scale if it is the same scale"
        ]
    );
    assert_eq!(warnings([5, 10, 20], &given).len(), 2);
    assert!(warnings([5, 10, 20], &Scales::default()).is_empty());
    assert!(warnings([1, 1, 1], &given).is_empty());
}

/// The attributes, and what a scale of 10 in data flash makes of each.
fn assert_scaled(rig: &Rig, factors: &[(&str, Role, Option<i64>)]) {
    let snapshot = rig.handle.published().snapshot.clone().expect("a poll");
    for &(name, role, factor) in factors {
        let register = rig.handle.chip().register(role).expect("a register");
        let sign = if register.discharge { -1 } else { 1 };
        let raw = sign * snapshot.value(register).expect("read");
        assert_ne!(raw, 0, "{name}");
        assert_eq!(show(rig, name), factor.map(|factor| (raw * 1000 * factor).to_string()), "{name}");
    }
}

/// A discharging gauge whose Design Energy Scale is 10, and where that is.
fn with_energy_scale(chip: &str) -> (Rig, u8, u8) {
    let (id, offset): (u8, u8) = if chip == "bq34z100-g1" { (48, 30) } else { (80, 81) };
    let options = GaugeOptions { allow_unproven: true, ..GaugeOptions::default() };
    let mut rig = Rig::of(chip, Run { options, ..Run::default() });
    rig.start().expect("it answers");
    rig.sim.set_flash(id.into(), offset.into(), &[10]);
    turn(&rig, "load_ma", "500");
    turn(&rig, "speed", "20");
    for _ in 0..20 {
        rig.poll_after(Duration::from_secs(2));
    }
    (rig, id, offset)
}

/// It is known once its subclass has been read, and stays so from then on.
#[test]
fn a_scale_in_data_flash_applies_once_it_is_known() {
    for chip in ["bq27426", "bq27427", "bq34z100-g1"] {
        let (mut rig, id, _) = with_energy_scale(chip);
        let factors = |energy: i64| -> Vec<(&str, Role, Option<i64>)> {
            let charge = if chip == "bq34z100-g1" { 1 } else { energy };
            let both = [
                ("current_avg", Role::CurrentAvg, Some(1)),
                ("charge_now", Role::ChargeNow, Some(charge)),
                ("charge_full", Role::ChargeFull, Some(charge)),
                ("power_avg", Role::PowerAvg, Some(energy)),
            ];
            both.to_vec()
        };
        assert_scaled(&rig, &factors(1));
        let index = rig.index(id);
        rig.ask(&op::READ, vec![index]).expect("the default key");
        assert_scaled(&rig, &factors(10));
        rig.poll_after(INTERVAL);
        rig.ask(&op::REFRESH, ()).expect("it answers");
        assert_scaled(&rig, &factors(10));
    }
}

/// Once a poll has failed, it may be another gauge, and its scale another one.
#[test]
fn a_scale_in_doubt_leaves_no_value_of_its_kind() {
    let (mut rig, id, _) = with_energy_scale("bq34z100-g1");
    let index = rig.index(id);
    rig.ask(&op::READ, vec![index]).expect("the default key");
    turn(&rig, "power", "off");
    rig.poll_after(INTERVAL);
    turn(&rig, "power", "on");
    for _ in 0..20 {
        rig.poll_after(Duration::from_secs(2));
    }
    let charge = ("charge_now", Role::ChargeNow, Some(1));
    assert_scaled(&rig, &[charge, ("power_avg", Role::PowerAvg, None)]);
    rig.ask(&op::READ, vec![index]).expect("the default key");
    assert_scaled(&rig, &[charge, ("power_avg", Role::PowerAvg, Some(10))]);
}

/// A write tells as well.
#[test]
fn a_scale_that_is_written_applies() {
    let (mut rig, id, offset) = with_energy_scale("bq34z100-g1");
    for scale in ["1", "10"] {
        let row = rig.handle.chip().row(&id.to_string(), &offset.to_string()).expect("a row");
        let value = ti_gauge::notation::parse(row.1, scale.as_bytes()).expect("a value");
        let change =
            ti_gauge::dataflash::Change::of_value(rig.handle.chip(), row, &value, true).expect("it fits");
        rig.ask(&op::WRITE, vec![change]).expect("the default key");
        for _ in 0..20 {
            rig.poll_after(Duration::from_secs(2));
        }
        let factor = scale.parse().expect("a number");
        assert_scaled(&rig, &[("power_avg", Role::PowerAvg, Some(factor))]);
    }
}

/// Data memory is RAM, and reverts to 1 with a loss of power.
#[test]
fn a_scale_in_ram_is_lost_with_the_power() {
    let (mut rig, id, _) = with_energy_scale("bq27427");
    let index = rig.index(id);
    rig.ask(&op::READ, vec![index]).expect("the default key");
    turn(&rig, "power", "off");
    turn(&rig, "power", "on");
    for _ in 0..20 {
        rig.poll_after(Duration::from_secs(2));
    }
    assert_scaled(&rig, &[("charge_now", Role::ChargeNow, Some(1))]);
}

/// SLUSBZ5D 7.3.7.1: the gauge does not have the factor.
#[test]
fn a_scale_that_only_the_user_knows_is_asked_for() {
    let warnings = |is_scaled, given: &Scales| {
        let mut rig = Rig::of("bq34z100-g1", Run::default());
        let word: u16 = if is_scaled { 0x2161 } else { 0x0161 };
        rig.sim.set_flash(64, 0, &word.to_be_bytes());
        turn(&rig, "power", "off");
        turn(&rig, "power", "on");
        rig.clock.sleep(Duration::from_secs(5));
        rig.start().expect("it answers");
        let (handle, scales) = (rig.handle.clone(), given.clone());
        crate::fs::Supply::new("BAT0".into(), handle).with_scales(scales).warnings()
    };
    let (none, both) = (Scales::default(), Scales { current: 10.0, energy: 10.0, ..Scales::default() });
    let with_energy = Scales { energy_shown: true, ..Scales::default() };
    let set = "BAT0: [SCALED] of PackConfiguration() is set, so currents, charges and energies are a fraction of the \
               real ones, and the gauge does not have the factor; give ";
    assert_eq!(warnings(true, &none), [format!("{set}current-scale")]);
    assert_eq!(warnings(true, &with_energy), [format!("{set}current-scale and energy-scale")]);
    assert!(warnings(true, &both).is_empty() && warnings(false, &none).is_empty());
    let given = "BAT0: current-scale given, but [SCALED] of PackConfiguration() is clear, so the gauge reports real \
                 values; leave out current-scale, or set the bit";
    assert_eq!(warnings(false, &both), [given]);
}

#[test]
fn words_in_uevent_are_the_kernels() {
    let rig = open("bq34z100-g1");
    let published = rig.handle.published();
    let scales = Scales::default();
    let reading = Reading::new(&rig.handle, published.snapshot.as_deref(), &scales);
    let text = uevent("my pack", &reading);
    for line in ["NAME=my_pack", "STATUS=Not charging", "MANUFACTURER=Texas Instruments"] {
        assert!(text.contains(&format!("POWER_SUPPLY_{line}\n")), "{line} in {text}");
    }
}

#[test]
fn a_gauge_that_asks_for_an_update_of_its_capacity_says_so() {
    let mut rig = open("bq34z100-g1");
    assert_shows(&rig, &[("health", Some("Good"))]);
    // Max Error Limit; after a reset MaxError() is 100 %.
    rig.sim.set_flash(48, 10, &[50]);
    turn(&rig, "power", "off");
    turn(&rig, "power", "on");
    rig.poll_after(Duration::from_secs(2));
    assert_shows(&rig, &[("health", Some("Calibration required"))]);
}

/// What a bq34z100-G1 has in data flash of a pack of three NiMH cells that was made on 23 May 2012.
fn of_three_cells() -> Rig {
    let rig = open("bq34z100-g1");
    rig.sim.set_flash(64, 7, &[3]);
    rig.sim.set_flash(48, 2, &(23_u16 + 5 * 32 + 32 * 512).to_be_bytes());
    rig.sim.set_flash(48, 55, b"\x04NiMH");
    rig
}

const OF_THREE_CELLS: [(&str, Option<&str>); 6] = [
    ("voltage_min_design", Some("9000000")),
    ("voltage_max_design", Some("12600000")),
    ("manufacture_year", Some("2012")),
    ("manufacture_month", Some("5")),
    ("manufacture_day", Some("23")),
    ("technology", Some("NiMH")),
];

fn assert_shows_nothing_stored(rig: &Rig) {
    for (name, _) in OF_THREE_CELLS {
        assert_eq!(show(rig, name).as_deref(), (name == "technology").then_some("Unknown"), "{name}");
    }
}

/// The cycle count, which the gauge rewrites, is in the same subclass as the date.
#[test]
fn what_data_flash_holds_is_shown_from_its_reading_to_the_first_failed_poll() {
    let mut rig = of_three_cells();
    rig.poll_after(INTERVAL);
    assert_shows_nothing_stored(&rig);
    read_places(&mut rig);
    for _ in 0..3 {
        assert_shows(&rig, &OF_THREE_CELLS);
        rig.poll_after(INTERVAL);
    }
    let scales = Scales { voltage: 2.0, ..Scales::default() };
    assert_eq!(show_scaled(&rig, "voltage_min_design", &scales).as_deref(), Some("18000000"));
    turn(&rig, "power", "off");
    rig.poll_after(INTERVAL);
    assert_shows(&rig, &[("present", Some("1"))]);
    assert_shows_nothing_stored(&rig);
    turn(&rig, "power", "on");
    for _ in 0..3 {
        rig.poll_after(INTERVAL);
    }
    // Another pack may be there now, and it is sealed.
    assert_shows_nothing_stored(&rig);
}

#[test]
fn a_value_of_data_flash_that_cannot_be_one_is_not_shown() {
    let mut rig = of_three_cells();
    // 31 February 1985; no cell; a chemistry that the kernel does not know.
    rig.sim.set_flash(48, 2, &(31_u16 + 2 * 32 + 5 * 512).to_be_bytes());
    rig.sim.set_flash(64, 7, &[0]);
    rig.sim.set_flash(48, 55, b"\x04PbA ");
    read_places(&mut rig);
    assert_shows_nothing_stored(&rig);
    assert_shows(&rig, &[("constant_charge_voltage", None)]);
}

#[test]
fn data_flash_at_other_addresses_than_the_tables_is_not_shown() {
    for (shifted, expected) in [(false, Some("4200000")), (true, None)] {
        let mut rig = open("bq34z100-r2");
        if shifted {
            rig.sim.set_flash(48, 33, b"B");
        }
        read_places(&mut rig);
        assert_shows(&rig, &[("voltage_max_design", expected)]);
    }
}

#[test]
fn a_part_without_the_register_has_its_design_capacity_from_data_memory() {
    for chip in ["bq27426", "bq27427"] {
        let mut rig = open(chip);
        assert_shows(&rig, &[("charge_full_design", None)]);
        rig.sim.set_flash(82, 6, &1500_u16.to_be_bytes());
        read_places(&mut rig);
        assert_shows(
            &rig,
            &[("charge_full_design", Some("1500000")), ("voltage_min_design", Some("3200000"))],
        );
        let scales = Scales { current: 2.0, ..Scales::default() };
        assert_eq!(show_scaled(&rig, "charge_full_design", &scales).as_deref(), Some("3000000"));
    }
}

#[test]
fn the_charger_gets_the_voltage_of_the_whole_pack() {
    let mut rig = of_three_cells();
    rig.poll_after(INTERVAL);
    let current = ("constant_charge_current", Some("500000"));
    assert_shows(&rig, &[("constant_charge_voltage", None), current]);
    read_places(&mut rig);
    assert_shows(&rig, &[("constant_charge_voltage", Some("12600000")), current]);
    // One cell needs no data flash.
    let mut rig = open("bq27220");
    rig.poll_after(INTERVAL);
    assert!(show(&rig, "constant_charge_voltage").is_some());
}

#[test]
fn a_charging_voltage_far_above_a_cells_is_the_packs() {
    assert_eq!(pack_voltage(4200, 4200, 3), 12600);
    // Reduced in the cold, and none at all.
    assert_eq!([pack_voltage(3900, 4200, 3), pack_voltage(0, 4200, 3)], [11700, 0]);
    assert_eq!([pack_voltage(12600, 4200, 3), pack_voltage(8400, 4200, 2)], [12600, 8400]);
}

#[test]
fn a_charge_counter_falls_while_discharging() {
    for chip in ["bq34110", "bq27220", "bq35100"] {
        let mut rig = open(chip);
        let start = 0x0011;
        if chip == "bq35100" {
            rig.ask(&op::CONTROL, start).expect("a sealed gauge takes it");
        }
        if chip == "bq34110" {
            // Mfg Status Init: it counts in both directions.
            rig.sim.set_flash(0, 0xd7, &[0x00, 0x03]);
            turn(&rig, "power", "off");
            turn(&rig, "power", "on");
        }
        turn(&rig, "load_ma", "100");
        turn(&rig, "speed", "100");
        rig.poll_after(Duration::from_secs(2));
        let counter =
            |rig: &Rig| show(rig, "charge_counter").expect("counted").parse::<i64>().expect("a number");
        let before = counter(&rig);
        rig.poll_after(Duration::from_secs(36));
        // An hour at 100 mA.
        let taken = before - counter(&rig);
        assert!((95_000..=105_000).contains(&taken), "{chip}: {taken} µAh");
    }
}

#[test]
fn a_resistance_is_shown_in_the_mode_that_measures_it() {
    for mode in [0x01, 0x02] {
        let mut rig = open("bq35100");
        rig.sim.set_flash(0, 0x1b1, &[0x80 | mode, 0xfb]);
        turn(&rig, "power", "off");
        turn(&rig, "power", "on");
        rig.poll_after(INTERVAL);
        let (start, stop) = (0x0011, 0x0012);
        rig.ask(&op::CONTROL, start).expect("a sealed gauge takes it");
        turn(&rig, "load_ma", "100");
        rig.poll_after(Duration::from_secs(3));
        rig.ask(&op::CONTROL, stop).expect("a sealed gauge takes it");
        for _ in 0..12 {
            rig.poll_after(INTERVAL);
        }
        assert_shows(&rig, &[("internal_resistance", None)]);
        read_places(&mut rig);
        let published = rig.handle.published();
        let register = rig.handle.chip().register(Role::InternalResistance).expect("a register");
        let milliohms =
            published.snapshot.as_ref().and_then(|snapshot| snapshot.value(register)).expect("read");
        let expected = (mode == 0x02).then(|| (milliohms * 1000).to_string());
        assert_eq!(show(&rig, "internal_resistance"), expected, "{milliohms} mΩ");
        assert!(mode != 0x02 || milliohms > 0, "it was measured");
    }
}

#[test]
fn the_serial_number_is_that_of_the_register() {
    for chip in ["bq34z100-g1", "bq34z100-r2"] {
        let rig = open(chip);
        let published = rig.handle.published();
        let register = rig.handle.chip().register(Role::SerialNumber).expect("a register");
        let number = published.snapshot.as_ref().and_then(|snapshot| snapshot.value(register)).expect("read");
        assert_eq!(show(&rig, "serial_number"), Some(format!("{number:04x}")), "{chip}");
    }
}

#[test]
fn voltages_beyond_the_limits_of_the_pack_are_its_health() {
    let mut rig = open("bq34z100-g1");
    let mut at = |millivolts| {
        turn(&rig, "voltage_mv", millivolts);
        for _ in 0..4 {
            rig.poll_after(Duration::from_secs(2));
        }
        show(&rig, "health").expect("known")
    };
    assert_eq!([at("3900"), at("4400"), at("3900")], ["Good", "Over voltage", "Good"]);
    // Cell BL Set Volt Threshold, Time and Clear Volt Threshold.
    let mut rig = open("bq34z100-g1");
    rig.sim.set_flash(49, 8, &[0x0e, 0x10, 2, 0x0e, 0x74]);
    turn(&rig, "power", "off");
    turn(&rig, "power", "on");
    for (millivolts, health) in [("3900", "Good"), ("3500", "Under voltage"), ("3900", "Good")] {
        turn(&rig, "voltage_mv", millivolts);
        for _ in 0..4 {
            rig.poll_after(Duration::from_secs(2));
        }
        assert_shows(&rig, &[("health", Some(health))]);
    }
}
