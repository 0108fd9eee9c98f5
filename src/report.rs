// SPDX-License-Identifier: MIT

//! The text of a [`Report`]: a trace for replays, below lines with everything about the gauge.

use std::path::Path;
use std::time::Duration;

use gauge_bus::{regular, trace};
use gauge_owner::{Effect, Origin, Report, Times};
use ti_gauge::chip::sbs::failures::failures;
use ti_gauge::chip::{Chip, Evidence, Role, Tier};
use ti_gauge::dataflash::Place;
use ti_gauge::notation;
use ti_gauge::text::{hex, printable};

/// Start of the line about data flash.
const DATA_FLASH: &str = "Data flash: ";
/// Start of that line if none was read.
const NOT_READ: &str = "Data flash: not read: ";

pub(crate) fn text(chip: &Chip, origin: &Origin, report: &Report) -> String {
    let head = format!("{} on {}, {:.0}", chip.name, printable(&origin.place), report.taken);
    let release = Path::new("/proc/sys/kernel/osrelease");
    let kernel = regular::read_text(release, regular::SYSTEM).unwrap_or_default();
    let adapter = match printable(&origin.adapter) {
        adapter if adapter.is_empty() => "none".to_string(),
        adapter => adapter,
    };
    let mut about = vec![
        format!("Report by gaugefs {}, without keys and serial numbers", env!("CARGO_PKG_VERSION")),
        "To mount it: gaugefs mount --replay FILE MOUNTPOINT".to_string(),
        format!("Kernel: Linux {}, {}", printable(kernel.trim()), std::env::consts::ARCH),
        format!("Adapter: {adapter}"),
        format!("Chip: {}; evidence for its table: {}", chip.model, Evidence::list(chip.evidence)),
        format!("Documents: {}", chip.documents.join(", ")),
    ];
    about.extend(gauge(chip, report));
    about.extend(power(chip, report));
    if !report.firmware.is_empty() {
        about.push(format!("Answer to FW_VERSION: {}", hex(&report.firmware)));
    }
    about.extend(chip.beliefs().map(|belief| format!("Not confirmed: {}", belief.name)));
    about.extend(report.values.iter().map(|(row, value)| {
        let (place, text) = (Place::of(*row), notation::render(row.1.kind, value));
        format!("Value {place} {} = {text} {}", row.1.name, row.1.unit).trim_end().to_string()
    }));
    about.extend(times(chip, report));
    about.extend(
        report
            .calibration
            .lines()
            .filter(|line| !line.starts_with('#'))
            .map(|line| format!("Last calibration: {}", printable(line))),
    );
    about.push(match &report.data_flash {
        Ok(read) if read.is_empty() => format!("{DATA_FLASH}none is known of this part"),
        Ok(read) => {
            let names: Vec<_> = read.iter().map(|row| format!("{} ({})", row.name, row.class)).collect();
            format!("{DATA_FLASH}{} was read", names.join(", "))
        }
        Err(why) => format!("{NOT_READ}{}", printable(why)),
    });
    trace::text(&head, &about, origin.address, &report.events)
}

/// The gauge's answers and measurements, a line each.
fn gauge(chip: &Chip, report: &Report) -> Vec<String> {
    let (answers, mut about) = (&report.answers, Vec::new());
    if chip.has_table() {
        let chemistry = answers.chem_id.map_or(String::new(), |id| format!(", chemistry 0x{id:04x}"));
        about.push(format!(
            "Identity: device type 0x{:04x}, firmware 0x{:04x}, hardware 0x{:04x}{chemistry}",
            answers.device_type, answers.firmware_version, answers.hardware_version
        ));
        about.push(format!("Seal state: {}", report.seal.as_str()));
        about.push(format!("CONTROL_STATUS: 0x{:04x}", report.snapshot.control_status));
    }
    if let Some(limited) = report.limited {
        about.push(format!("Limited: {}", printable(&limited.why(chip, answers))));
    }
    for one in failures(chip, |row| report.snapshot.value(row)) {
        about.push(format!("Permanent failure: {}, {}; check {}", one.name, one.what, one.check));
    }
    let serial = chip.serial_register();
    for register in chip.registers.iter().filter(|register| register.tier != Tier::Window) {
        if let Some(value) = report.snapshot.value(register) {
            let shown = match register.unit {
                _ if serial.is_some_and(|serial| serial.source == register.source) => "not shown".to_string(),
                unit if register.bits.is_empty() => format!("{value} {unit}"),
                _ => format!("0x{value:04x}"),
            };
            about.push(format!("Register {} {}() = {}", register.source, register.name, shown.trim_end()));
        }
    }
    about
}

/// Times of commits and resets, from writes since the mount.
fn times(chip: &Chip, report: &Report) -> Vec<String> {
    if !chip.has_table() {
        return Vec::new();
    }
    let shown = |effect: &Effect, first: Option<Duration>| {
        let unseen = match effect.unseen_ms {
            0 => "no look was without it".to_string(),
            unseen => format!("the last look without it after {unseen} ms"),
        };
        let first = first.map_or(String::new(), |first| format!("; the first look is after {first:?}"));
        format!("{unseen}, at the latest seen after {} ms{first}", effect.seen_ms)
    };
    let (Times { resets, commits, reset_seals, offsets }, access) = (&report.times, &chip.access);
    let commits = match commits.count {
        0 => "Commits: none was seen since the mount; write a value and make the report again".to_string(),
        count => {
            format!("Commits: {count} were seen since the mount; {}", shown(commits, Some(access.commit)))
        }
    };
    let seals = match reset_seals.count {
        0 => String::new(),
        count => format!(", SEALED after {count} of them; {}", shown(reset_seals, Some(access.reset))),
    };
    let mut times = vec![commits, format!("Resets: {resets} were sent since the mount{seals}")];
    if let (Some(_), 1..) = (chip.calibration, offsets.count) {
        let shown = shown(offsets, None);
        times.push(format!(
            "Offsets: [BCA] or [CCA] was seen {} times since the mount; {shown}",
            offsets.count
        ));
    }
    times
}

/// AveragePower() and its expected value; parts differ in its unit.
fn power(chip: &Chip, report: &Report) -> Option<String> {
    let named = |name: &str| chip.registers.iter().find(|register| register.name == name);
    let value = |register| report.snapshot.value(register);
    let (power, voltage) = (named("AveragePower")?, chip.register(Role::VoltageNow)?);
    let current = chip.register(Role::CurrentAvg).or(chip.register(Role::CurrentNow))?;
    let product = voltage.in_unit(value(voltage)?, 1) * current.in_unit(value(current)?, 1) / 1000;
    let (power, unit) = (value(power)?, power.unit);
    Some(format!("Power: AveragePower() {power} {unit}, Voltage() x {}() {product} mW", current.name))
}

/// Why the report of this text has no data flash; `None` if it was read, or if the part has none.
pub(crate) fn without_data_flash(text: &str) -> Option<&str> {
    text.lines().find_map(|line| line.strip_prefix("; ")?.strip_prefix(NOT_READ))
}

/// The chip of a report's text.
pub(crate) fn chip(text: &str) -> Option<&str> {
    text.strip_prefix("; gaugefs: ")?.split(" on ").next()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::{fs, process};

    use super::*;
    use gauge_owner::recorded;
    use gauge_owner::rig::{INTERVAL, Rig};
    use gauge_owner::{Run, operations as op};
    use ti_gauge::dataflash::sample;

    /// Mounts a report as `--replay` does, and compares its gauge with the report.
    fn replays(file: &Path) -> &'static Chip {
        let name = file.display();
        let text = fs::read_to_string(file).expect("a report");
        let (chip, replay) = recorded(file).unwrap_or_else(|error| panic!("{error}"));
        let mut rig = Rig::replay(chip, replay);
        rig.start().unwrap_or_else(|error| panic!("{name}: {error}"));
        for _ in 0..4 {
            rig.poll_after(INTERVAL);
        }
        let published = rig.handle.published();
        assert_eq!(&*published.last_error, "", "{name}");
        let seen = Report {
            taken: jiff::Timestamp::UNIX_EPOCH,
            answers: published.answers,
            limited: published.limited,
            seal: published.seal,
            snapshot: published.snapshot.clone().expect("a poll"),
            firmware: Vec::new(),
            data_flash: Err(String::new()),
            values: Vec::new(),
            calibration: "".into(),
            times: Times::default(),
            events: Vec::new(),
        };
        let lines: BTreeSet<&str> = text.lines().collect();
        let shown = gauge(chip, &seen);
        for line in &shown {
            let line = format!("; {line}");
            assert!(lines.contains(&*line), "{name}: `{line}` is not in\n{text}");
        }
        let count = lines.iter().filter(|line| line.starts_with("; Register ")).count();
        assert!(
            count > 2 && shown.iter().filter(|line| line.starts_with("Register ")).count() == count,
            "{name}"
        );
        // The bq35100 has the voltage for writes in one block with its keys, which is never recorded; each read of data
        // flash looks at it too.
        let is_recorded = without_data_flash(&text).is_none() && chip.name != "bq35100";
        let index = sample(chip).filter(|_| is_recorded);
        if let Some(index) = index {
            rig.ask(&op::READ, vec![index]).unwrap_or_else(|error| panic!("{name}: {error}"));
        }
        chip
    }

    #[test]
    fn the_report_of_every_chip_replays() {
        let file = std::env::temp_dir().join(format!("gaugefs-report-{}", process::id()));
        for chip in Chip::all() {
            let mut rig = Rig::of(chip.name, Run::default());
            rig.start().expect("it answers");
            rig.ask(&op::REPORT, ()).expect("it answers");
            let report = rig.handle.published().report.clone().expect("a report");
            assert_eq!(
                matches!(&report.data_flash, Ok(read) if !read.is_empty()),
                chip.has_table(),
                "{}: {:?}",
                chip.name,
                report.data_flash
            );
            let origin =
                Origin { place: "simulated gauge".into(), address: chip.address, adapter: String::new() };
            fs::write(&file, text(chip, &origin, &report)).expect("a file");
            assert_eq!(replays(&file).name, chip.name);
        }
        fs::remove_file(&file).expect("it is there");
    }

    /// Observations that would settle what the tables assume.
    #[test]
    fn a_report_has_what_could_confirm_the_table() {
        for (chip, wanted) in [
            (
                "bq34z100-g1",
                &["Registers (Configuration)", "Power (Configuration)", "Data (Calibration)"][..],
            ),
            (
                "bq34z100-g1",
                &[
                    "; Value 104/",
                    " Board Offset = ",
                    " CC Offset = ",
                    "; Value 104/14 Voltage Divider = 5000",
                    "; Value 68/0 Flash Update OK Cell Volt = 2800 mV",
                    "; Value 64/0 Pack Configuration = 0x0161",
                    "; Value 64/7 Number of series cell = 1",
                    "; Commits: none was seen since the mount",
                    "; Resets: 0 were sent since the mount",
                ],
            ),
            ("bq34z100-r2", &["; Value 48/30 ", "; Value 48/31 ", "; Value 48/32 ", "; Value 68/0 "]),
            ("bq34110", &["; Value flash/0x4010 Voltage Divider = ", "; Value flash/0x4157 "]),
            ("bq34110", &["Answer to FW_VERSION: 011001000001", "; Not confirmed: addresses as printed"]),
            ("bq35100", &["Answer to FW_VERSION: 010000180008"]),
            ("bq27220", &["Answer to FW_VERSION: 022000030001"]),
            ("bq27z561", &["; Power: AveragePower() ", "; Not confirmed: Voltage() before the first"]),
        ] {
            let mut rig = Rig::of(chip, Run::default());
            rig.start().expect("it answers");
            rig.ask(&op::REPORT, ()).expect("it answers");
            let report = rig.handle.published().report.clone().expect("a report");
            let origin = Origin { place: "simulated gauge".into(), address: 0x55, adapter: String::new() };
            let text = text(rig.handle.chip(), &origin, &report);
            for part in wanted {
                assert!(text.contains(part), "{chip}: `{part}` is not in\n{text}");
            }
            let doubted = |row: &&&ti_gauge::chip::Subclass| (0x4100..0x5000).contains(&row.start());
            let has_doubted =
                report.data_flash.as_ref().expect("it was read").iter().any(|row| doubted(&row));
            assert_eq!(has_doubted, ["bq34110", "bq35100"].contains(&chip), "{chip}");
        }
    }

    /// CONTRIBUTING.md says how a report comes here, and how the evidence for its chip changes.
    #[test]
    fn the_reports_of_the_tests_replay_and_are_evidence() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/reports");
        // What crates.io has of this crate is without it.
        if !folder.exists() {
            eprintln!("SKIPPED: there is no {}", folder.display());
            return;
        }
        let (mut real, mut simulated) = (BTreeSet::new(), 0);
        for entry in fs::read_dir(&folder).expect("the folder") {
            let file = entry.expect("an entry").path();
            let name = replays(&file).name;
            let stem = file.file_stem().and_then(|stem| stem.to_str()).expect("a name");
            assert!(stem.starts_with(name), "{stem}: the name of a report begins with its chip, {name}");
            let head = fs::read_to_string(&file).expect("a report");
            let is_simulated = head.lines().next().is_some_and(|head| head.contains(" on simulated gauge, "));
            assert_eq!(is_simulated, stem.ends_with("-simulated"), "{stem}");
            if is_simulated {
                simulated += 1;
            } else {
                real.insert(name);
            }
        }
        assert!(simulated > 0, "one file shows that this test works");
        let seen = Chip::all().filter(|chip| chip.evidence.contains(&Evidence::RealPart));
        assert_eq!(
            real,
            seen.map(|chip| chip.name).collect(),
            "tests/reports; chips with Evidence::RealPart"
        );
    }

    #[test]
    fn a_report_names_kernel_adapter_and_version_and_hostile_names_make_no_lines() {
        let mut rig = Rig::open();
        rig.ask(&op::REPORT, ()).expect("it answers");
        let report = rig.handle.published().report.clone().expect("a report");
        let adapter = "i2c-7 (evil\nR: AA 08 2), capabilities 0x1".to_string();
        let origin = Origin { place: "/dev/i2c-7 address 0x55".into(), address: 0x55, adapter };
        let text = text(rig.handle.chip(), &origin, &report);
        assert!(text.starts_with("; gaugefs: bq34z100-g1 on /dev/i2c-7 address 0x55, 20"), "{text}");
        for part in [
            &format!("; Report by gaugefs {}", env!("CARGO_PKG_VERSION"))[..],
            "; Kernel: Linux ",
            r"; Adapter: i2c-7 (evil\nR: AA 08 2), capabilities 0x1",
            "; Identity: device type 0x0100, firmware 0x0016",
            "; Seal state: sealed",
            "; Register 0x08 Voltage() = ",
            "; Register 0x28 SerialNumber() = not shown",
            "; Data flash: ",
        ] {
            assert!(text.contains(&format!("\n{part}")), "`{part}` is not in\n{text}");
        }
        assert_eq!(chip(&text), Some("bq34z100-g1"));
    }
}
