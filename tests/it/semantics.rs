// SPDX-License-Identifier: MIT

//! Holds docs/SEMANTICS.md and docs/ATTRIBUTES.md to what a mount does: every file of the tree has a row there and every
//! row a file, attributes have the value that their row describes, and each errno of the table occurs when the table says.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{Read, Seek};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use nix::errno::Errno;
use ti_gauge::chip::{CHIPS, Chip, snake_case};

use crate::rig::Rig;
use crate::room::{Folder, LONG, TEXT, can_mount, gaugefs, table, within};

const ATTRIBUTES: &str = include_str!("../../docs/ATTRIBUTES.md");

/// The parts of a cell that are in backticks.
fn quoted(cell: &str) -> impl Iterator<Item = &str> {
    cell.split('`').skip(1).step_by(2)
}

/// A simulated gauge, mounted with the program, as by a user. Unmounted when the folder is dropped.
struct Mount(Folder);

impl Mount {
    fn new(chip: &str, more: &[&str]) -> Option<Self> {
        if !can_mount() {
            return None;
        }
        let folder = Folder::new();
        gaugefs(&[&["mount", "--sim", chip, &folder.file("m")], more].concat()).done();
        let mount = Self(folder);
        // The second poll reads the registers that no attribute needs.
        mount.until("a second poll", |mount| mount.number("gauge/statistics/polls") >= 2);
        Some(mount)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.0.join("m/BAT0").join(name)
    }

    fn cat(&self, name: &str) -> String {
        let text = fs::read_to_string(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        text.trim_end().to_string()
    }

    fn number(&self, name: &str) -> i64 {
        let text = self.cat(name);
        text.parse().unwrap_or_else(|_| panic!("{name}: `{text}` is not a number"))
    }

    fn echo(&self, text: &str, name: &str) -> Result<(), Errno> {
        fs::write(self.path(name), format!("{text}\n")).map_err(errno)
    }

    #[track_caller]
    fn until(&self, what: &str, holds: impl Fn(&Self) -> bool) {
        within(what, || holds(self));
    }

    /// Names and modes of the files in a folder of the gauge. A poll may have removed some since they were listed.
    fn list(&self, name: &str) -> BTreeMap<String, u32> {
        let entries = fs::read_dir(self.path(name)).expect("a folder").map(|entry| entry.expect("an entry"));
        let mode = |path: PathBuf| Some(fs::symlink_metadata(path).ok()?.permissions().mode() & 0o777);
        let named = |entry: &fs::DirEntry| entry.file_name().to_string_lossy().into_owned();
        entries.filter_map(|entry| Some((named(&entry), mode(entry.path())?))).collect()
    }
}

fn errno(error: std::io::Error) -> Errno {
    Errno::from_raw(error.raw_os_error().unwrap_or_default())
}

/// Makes the values of data flash known, and those that depend on it.
fn describe_pack(mount: &Mount, chip: &Chip) {
    match chip.name {
        "bq34z100-g1" => {
            mount.echo("16567", "df/48/2").expect("23 May 2012");
            mount.cat("df/index");
            mount.until("a date", |mount| mount.path("manufacture_day").exists());
            mount.until("a voltage", |mount| mount.path("voltage_min_design").exists());
        }
        "bq35100" => {
            // [GMSEL] 10 measures the resistance in a pulse.
            mount.echo("0", "sim/load_ma").expect("a knob");
            // Until the voltage has recovered from the load, flash stores nothing.
            mount.until("a write", |mount| mount.echo("0x82", "df/flash/0x41b1").is_ok());
            mount.echo("GAUGE_START", "gauge/control").expect("a sealed gauge takes it");
            mount.echo("50", "sim/load_ma").expect("a knob");
            let polls = mount.number("gauge/statistics/polls");
            mount.until("a pulse", |mount| mount.number("gauge/statistics/polls") >= polls + 4);
            mount.echo("GAUGE_STOP", "gauge/control").expect("a sealed gauge takes it");
            mount.cat("df/flash/0x41b1");
            mount.until("a resistance", |mount| mount.path("internal_resistance").exists());
        }
        _ => {}
    }
}

#[test]
fn semantics_of_the_tree() {
    let attributes: BTreeSet<_> =
        table(ATTRIBUTES, "## The files").iter().flat_map(|row| quoted(row[0])).collect();
    let rows = table(TEXT, "## gauge/");
    let gauge: BTreeMap<_, _> = rows
        .iter()
        .flat_map(|row| quoted(row[0]).map(|name| (name, (!row[1].is_empty(), !row[2].is_empty()))))
        .collect();
    let (mut seen, mut seen_in_gauge) = (BTreeSet::new(), BTreeSet::new());
    // One attribute is only a bq27000's, and some are a Smart Battery's.
    let others = ["bq27000", "sbs", "bq40z50-r2"].into_iter().filter_map(Chip::by_name);
    for chip in CHIPS.iter().copied().chain(others) {
        let all = ["--energy", "--poll", "0.5", "--ask-the-pack"];
        let options = if chip.asks.is_some() { &all[..] } else { &all[..3] };
        let Some(mount) = Mount::new(chip.name, options) else { return };
        for load in ["500", "-500"] {
            // A primary cell cannot be charged.
            let set = mount.echo(load, "sim/load_ma");
            assert!(set.is_ok() || chip.name == "bq35100" && load == "-500", "{}: {set:?}", chip.name);
            if chip.name == "sbs" && load == "-500" {
                mount.until("an average that charges", |mount| mount.path("time_to_full_avg").exists());
                seen.extend(mount.list(".").into_keys());
                mount.echo("0x8000", "sim/battery_mode").expect("energies in place of charges");
            }
            let polls = mount.number("gauge/statistics/polls");
            mount.until("a poll", |mount| mount.number("gauge/statistics/polls") >= polls + 2);
            if chip.name == "bq34z100-g1" && load == "-500" {
                // It averages over a while.
                mount.until("a time to full", |mount| mount.path("time_to_full_now").exists());
            }
            seen.extend(mount.list(".").into_keys());
        }
        describe_pack(&mount, chip);
        seen.extend(mount.list(".").into_keys());
        for (name, mode) in mount.list("gauge") {
            let flags = chip.registers.iter().any(|register| snake_case(register.name) == name);
            let row = match &*name {
                "registers" => "registers/NAME",
                "statistics" => "statistics/NAME",
                // A word of flags without a row of its own is covered by the row of `flags` and `control_status`.
                name if gauge.contains_key(name) => name,
                _ if flags => "control_status",
                name => name,
            };
            let Some((reads, writes)) = gauge.get(row) else { panic!("gauge/{name} has no row") };
            if !row.ends_with("NAME") {
                assert_eq!(
                    (mode & 0o444 != 0, mode & 0o222 != 0),
                    (*reads, *writes),
                    "gauge/{name}: {mode:o}"
                );
            }
            seen_in_gauge.insert(row.to_string());
        }
    }
    let folders = ["df", "gauge", "sim", "subsystem"];
    seen.retain(|name| !folders.contains(&&**name));
    assert_eq!(seen.iter().map(|name| &**name).collect::<BTreeSet<_>>(), attributes, "attributes; rows");
    assert_eq!(
        seen_in_gauge.iter().map(|name| &**name).collect::<BTreeSet<_>>(),
        gauge.into_keys().collect()
    );
}

#[test]
fn semantics_of_the_attributes() {
    for chip in CHIPS {
        let Some(mount) = Mount::new(chip.name, &["--energy", "--poll", "3600"]) else { return };
        let mut compared = 0;
        for row in table(ATTRIBUTES, "## The files") {
            let registers: Vec<_> =
                row[1].split([' ', ',']).filter_map(|word| word.strip_suffix("()").map(snake_case)).collect();
            for (file, register) in quoted(row[0]).zip(&registers) {
                let path = format!("gauge/registers/{register}");
                if !mount.path(file).exists() || !mount.path(&path).exists() {
                    continue;
                }
                let raw = mount.number(&path);
                compared += 1;
                if file == "serial_number" {
                    assert_eq!(mount.cat(file), format!("{raw:04x}"), "{}", chip.name);
                    continue;
                }
                let shown = match file {
                    "temp" => raw - 2731,
                    "capacity" | "capacity_error_margin" | "cycle_count" | "state_of_health" => raw,
                    // mV, mA, mAh in µV, µA, µAh.
                    _ => raw * 1000,
                };
                assert_eq!(mount.number(file), shown, "{}: {file} and {register}", chip.name);
            }
        }
        assert!(compared > 1, "{}: {compared} files compared", chip.name);
        let uevent = mount.cat("uevent");
        assert!(uevent.starts_with("POWER_SUPPLY_NAME=BAT0\n"));
        for line in uevent.lines() {
            let (key, value) = line.split_once('=').expect("KEY=VALUE");
            let name = key.strip_prefix("POWER_SUPPLY_").expect("the kernel's prefix").to_lowercase();
            if name != "name" {
                assert_eq!(mount.cat(&name), value, "{name}");
            }
        }
    }
}

/// Writes with one of these faults in five transfers in a row, so that retries see it too, beginning with each
/// transfer in turn. Fails with the wanted errno as soon as one of the writes does.
fn engine(faults: &[&str], wanted: Errno) -> Result<(), Errno> {
    let tries = faults.iter().flat_map(|fault| (1..40).map(move |first| (fault, first)));
    for (fault, first) in tries {
        let mut rig = Rig::new("bq34z100-g1");
        let faults: Vec<_> = (first..first + 12).map(|n: u64| fault.replace('N', &n.to_string())).collect();
        rig.sim.set("fault", &faults.join("; ")).expect("faults");
        if rig.write(80, 53, "3100").is_err_and(|error| error.errno() == wanted as i32) {
            return Err(wanted);
        }
    }
    Ok(())
}

#[test]
fn semantics_of_the_errnos() {
    let rows = table(TEXT, "## Errnos");
    let documented: BTreeSet<_> = rows.iter().flat_map(|row| row[0].split(", ")).collect();
    let mut occurred = BTreeMap::new();
    let mut occurs = |what: &'static str, outcome: Result<(), Errno>| {
        let errno = outcome.expect_err(what);
        occurred.insert(format!("{errno:?}"), what);
    };
    let parameter = "df/80/53";
    let Some(mount) = Mount::new("bq34z100-g1", &["--poll", "0.5"]) else { return };
    occurs("not a value of that type", mount.echo("abc", parameter));
    occurs("outside the range", mount.echo("9999", parameter));
    let typo = fs::write(mount.path("df/80/54"), "3100\n").map_err(errno);
    occurs("no such parameter", typo);
    occurs("no transaction is open", mount.echo("commit", "df/transaction"));
    mount.echo("begin", "df/transaction").expect("a transaction");
    occurs("a transaction is open", mount.echo("3100", parameter));
    mount.echo("abort", "df/transaction").expect("the end of it");
    mount.echo("corrupt-commit", "sim/fault").expect("a fault");
    occurs("the old bytes are back", mount.echo("3100", parameter));
    assert_eq!(mount.cat(parameter), "3000");
    mount.echo("2700", "sim/voltage_mv").expect("a knob");
    occurs("below the flash-update voltage", mount.echo("3100", parameter));
    mount.echo("3900", "sim/voltage_mv").expect("a knob");
    mount.echo("torn-commit 1", "sim/fault").expect("a fault");
    occurs("data flash is unknown", mount.echo("3100", parameter));
    mount.echo("none", "sim/fault").expect("a knob");
    mount.echo("on", "sim/power").expect("a knob");
    mount.until("the gauge is back", |mount| mount.echo("now", "gauge/refresh").is_ok());
    mount.until("its first measurement", |mount| mount.path("voltage_now").exists());
    let mut held = fs::File::open(mount.path("voltage_now")).expect("there");
    mount.echo("off", "sim/power").expect("a knob");
    occurs("the address is not acknowledged", mount.echo("3100", parameter));
    mount.until("it is gone", |mount| mount.cat("present") == "0");
    let mut gone =
        || held.rewind().and_then(|()| held.read_to_string(&mut String::new())).map(drop).map_err(errno);
    mount.until("what is held open follows", |_| fs::metadata(mount.path("voltage_now")).is_err());
    let start = Instant::now();
    while gone().is_ok() && start.elapsed() < LONG {
        std::thread::sleep(Duration::from_millis(20));
    }
    occurs("gone", gone());
    // What is held open would keep the mount from being unmounted.
    drop(held);
    drop(mount);

    let Some(mount) = Mount::new("bq34z100-g1", &["--no-default-keys"]) else { return };
    occurs("sealed and no key works", mount.echo("3100", parameter));
    drop(mount);
    let Some(mount) = Mount::new("bq34z100-g1", &["--read-only"]) else { return };
    occurs("mounted read-only", mount.echo("3100", parameter));
    drop(mount);
    let Some(mount) = Mount::new("bq27520-g3", &[]) else { return };
    let raw = |block: usize| format!("raw {}/{} 00\n", 200 + block / 256, 32 * (block % 256));
    mount.echo("begin", "df/transaction").expect("a transaction");
    let lines = |first: usize| (first..first + 64).map(raw).collect::<String>();
    let too_many =
        (0..=4096).step_by(64).try_for_each(|first| mount.echo(lines(first).trim(), "df/transaction"));
    occurs("too many raw bytes", too_many);
    drop(mount);
    let Some(mount) = Mount::new("bq34110", &[]) else { return };
    let index = mount.cat("df/index");
    let row = index.lines().find(|line| line.contains("unproven")).expect("there are some");
    let unproven = format!("df/flash/{}", row.split('\t').nth(1).expect("an address"));
    occurs("an unproven parameter", mount.echo(&mount.cat(&unproven), &unproven));
    drop(mount);

    // Faults in single transfers are given to the engine directly; write(2) answers with its errno.
    occurs("bus or gauge too slow", engine(&["stretch N 60000"], Errno::ETIMEDOUT));
    occurs("the checksum is wrong", engine(&["flip N 20 3"], Errno::EBADMSG));
    // A reply that names a block other than the requested one.
    let echoes = ["flip N 2 0", "flip N 3 0", "flip N 4 0", "flip N 35 0", "flip N 36 0", "flip N 37 0"];
    occurs("the reply breaks the protocol", engine(&echoes, Errno::EPROTO));

    // A full disk needs root, and has a test of its own: `without_space_for_the_journal_nothing_is_written`. So
    // has the end of the daemon: `a_daemon_ended_at_any_moment_ends_and_was_truthful`.
    let elsewhere = ["ENOSPC", "ENOTCONN", "ECONNABORTED"];
    let occurred: BTreeSet<_> = occurred.keys().map(String::as_str).chain(elsewhere).collect();
    assert_eq!(occurred, documented, "occurred; documented");
}

#[test]
fn semantics_of_data_flash_modes() {
    let Some(mount) = Mount::new("bq34z100-g1", &[]) else { return };
    for line in mount.cat("df/index").lines().skip(1) {
        let cells: Vec<_> = line.split('\t').collect();
        let mode = fs::metadata(mount.path(&format!("df/{}/{}", cells[0], cells[1]))).expect("there");
        assert_eq!(mode.permissions().mode() & 0o777, 0o600, "{line}");
        if cells[8].contains("security") {
            let read = fs::read(mount.path(&format!("df/{}/{}", cells[0], cells[1]))).map_err(errno);
            assert_eq!(read, Err(Errno::EPERM), "{line}");
        }
    }
    assert!(Path::new(&mount.path("df/80/raw")).exists());
}
