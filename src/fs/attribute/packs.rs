// SPDX-License-Identifier: MIT

//! The attributes of a Smart Battery, beside what the kernel's `sbs-battery` makes of the same words (Linux 6.12,
//! drivers/power/supply/sbs-battery.c).

use std::time::Duration;

use super::tests::{open, show, turn};
use super::*;
use gauge_owner::rig::Rig;

fn polled(rig: &mut Rig) {
    for _ in 0..12 {
        rig.poll_after(Duration::from_secs(3));
    }
}

fn word(rig: &Rig, name: &str) -> i64 {
    let register = rig.handle.chip().registers.iter().find(|row| row.name == name).expect("a word");
    rig.handle.published().snapshot.as_ref().and_then(|last| last.value(register)).expect("it was read")
}

/// What the driver shows, by its rules; `None` where gaugefs differs for a reason.
fn driver(rig: &Rig, name: &str) -> Option<String> {
    let number = |word_name: &str, factor: i64| Some((word(rig, word_name) * factor).to_string());
    match name {
        "voltage_now" => number("Voltage", 1000),
        "current_now" => number("Current", 1000),
        "current_avg" => number("AverageCurrent", 1000),
        "capacity" => Some(word(rig, "RelativeStateOfCharge").min(100).to_string()),
        "capacity_error_margin" => number("MaxError", 1),
        "charge_now" => number("RemainingCapacity", 1000),
        "charge_full" => number("FullChargeCapacity", 1000),
        "charge_full_design" => number("DesignCapacity", 1000),
        "temp" => Some((word(rig, "Temperature") - 2731).to_string()),
        "cycle_count" => number("CycleCount", 1),
        "time_to_empty_now" => number("RunTimeToEmpty", 60),
        "time_to_empty_avg" => number("AverageTimeToEmpty", 60),
        "time_to_full_avg" => number("AverageTimeToFull", 60),
        "serial_number" => Some(format!("{:04x}", word(rig, "SerialNumber"))),
        "manufacture_year" => Some(((word(rig, "ManufactureDate") >> 9) + 1980).to_string()),
        "manufacture_month" => Some((word(rig, "ManufactureDate") >> 5 & 15).to_string()),
        "manufacture_day" => Some((word(rig, "ManufactureDate") & 31).to_string()),
        "technology" => Some("Li-ion".into()),
        "manufacturer" => Some("Sim Cells".into()),
        "model_name" => Some("SIM-4S2P".into()),
        "present" => Some("1".into()),
        "status" => Some(
            match (word(rig, "BatteryStatus"), word(rig, "Current")) {
                (flags, 0) if flags & 0x20 == 0 => "Not charging",
                (flags, _) if flags & 0x20 != 0 => "Full",
                (flags, _) if flags & 0x40 != 0 => "Discharging",
                _ => "Charging",
            }
            .into(),
        ),
        _ => None,
    }
}

#[test]
fn attributes_are_those_of_the_kernels_driver() {
    let mut compared = 0;
    for load in ["0", "800", "-800"] {
        let mut rig = open("sbs");
        turn(&rig, "load_ma", load);
        turn(&rig, "speed", "20");
        polled(&mut rig);
        for name in Attribute::all().map(Attribute::name) {
            let Some(expected) = driver(&rig, name) else { continue };
            // 65535 minutes are no time.
            let expected = Some(expected).filter(|text| !name.starts_with("time_") || text != "3932100");
            assert_eq!(show(&rig, name), expected, "{name} with {load} mA");
            compared += 1;
        }
        assert_eq!(rig.sim.get("written").as_deref(), Some("0"));
    }
    assert_eq!(compared, 3 * 22);
}

#[test]
fn the_scales_of_specification_info_apply() {
    let shown = |specification: &str| {
        let mut rig = open("sbs");
        turn(&rig, "specification", specification);
        turn(&rig, "series", "16");
        turn(&rig, "load_ma", "1000");
        // It is another pack.
        turn(&rig, "power", "off");
        polled(&mut rig);
        turn(&rig, "power", "on");
        polled(&mut rig);
        ["voltage_now", "current_now", "charge_full"]
            .map(|name| show(&rig, name).expect(name).parse::<i64>().expect("a number"))
    };
    let [volts, current, charge] = shown("0x0031");
    assert_eq!((current, charge), (-1_000_000, 5_050_000));
    let scaled = shown("0x1131");
    assert!((scaled[0] - volts).abs() <= 20_000 && scaled[0] % 10_000 == 0, "{scaled:?} {volts}");
    assert_eq!(scaled[1..], [-1_000_000, 5_050_000]);
}

/// The mode is taken as it is found.
#[test]
fn in_capacity_mode_there_are_energies_and_no_charges() {
    let mut rig = open("sbs");
    turn(&rig, "battery_mode", "0x8000");
    polled(&mut rig);
    for (name, text) in [
        ("energy_now", Some("43630000")),
        ("energy_full", Some("72720000")),
        ("energy_full_design", Some("74880000")),
        ("charge_now", None),
        ("charge_full", None),
        ("charge_full_design", None),
        ("capacity", Some("60")),
    ] {
        assert_eq!(show(&rig, name).as_deref(), text, "{name}");
    }
    turn(&rig, "battery_mode", "0x0000");
    polled(&mut rig);
    assert_eq!((show(&rig, "energy_now"), show(&rig, "charge_now").as_deref()), (None, Some("3030000")));
}

#[test]
fn what_a_pack_says_beyond_the_range_of_a_file_is_not_shown_as_it_is() {
    let mut rig = open("sbs");
    // 101 %, no error, no month, no INITIALIZED, a chemistry without a name of the kernel's.
    turn(&rig, "answers", "0d=6500 0c=ff00 1b=0000 16=4000 22=0450624163");
    turn(&rig, "power", "off");
    polled(&mut rig);
    assert_eq!(show(&rig, "present").as_deref(), Some("0"));
    turn(&rig, "power", "on");
    polled(&mut rig);
    for (name, text) in [
        ("capacity", Some("100")),
        ("capacity_error_margin", None),
        ("manufacture_year", None),
        ("manufacture_month", None),
        ("manufacture_day", None),
        ("capacity_level", Some("Unknown")),
        ("technology", Some("Unknown")),
        ("status", Some("Not charging")),
    ] {
        assert_eq!(show(&rig, name).as_deref(), text, "{name}");
    }
}

#[test]
fn flags_are_words_of_the_kernel() {
    let mut rig = open("sbs");
    for (status, level, health) in [
        ("16=c000", "Normal", "Good"),
        ("16=e000", "Full", "Good"),
        ("16=c002", "Low", "Good"),
        ("16=d003", "Critical", "Good"),
        ("16=c010", "Normal", "Overheat"),
        // A conditioning cycle, which an alarm is before.
        ("16=c000 03=8000", "Normal", "Calibration required"),
        ("16=c010 03=8000", "Normal", "Overheat"),
    ] {
        turn(&rig, "answers", status);
        polled(&mut rig);
        assert_eq!(show(&rig, "capacity_level").as_deref(), Some(level), "{status}");
        assert_eq!(show(&rig, "health").as_deref(), Some(health), "{status}");
    }
}

/// Between two polls, and without a transfer that fails.
#[test]
fn a_pack_that_is_exchanged_shows_its_own_texts() {
    let mut rig = open("sbs");
    polled(&mut rig);
    assert_eq!(show(&rig, "model_name").as_deref(), Some("SIM-4S2P"));
    turn(&rig, "answers", "1c=3412 21=054f74686572");
    polled(&mut rig);
    let shown = ["model_name", "serial_number", "present"].map(|name| show(&rig, name));
    assert_eq!(shown.each_ref().map(|text| text.as_deref()), [Some("Other"), Some("1234"), Some("1")]);
}
