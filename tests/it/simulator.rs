// SPDX-License-Identifier: MIT

//! Holds the simulated gauges to what docs/SIMULATOR.md promises: each knob and each fault is listed and can be written,
//! and a refusal says what would be accepted.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use gauge_bus::clock::SimClock;
use gauge_sim::{FAULTS, Knob, Options, Sim};
use nix::errno::Errno;
use ti_gauge::chip::{Chip, Scheme};

use crate::room::{CHIP, Folder, Foreground, can_mount, errno, gaugefs, read, within};

const TEXT: &str = include_str!("../../docs/SIMULATOR.md");

fn sim(chip: &str) -> Sim {
    Sim::new(chip, &Options::default(), Arc::new(SimClock::new())).expect("a simulated part")
}

/// The rows of the tables whose first title is this one.
fn rows(title: &str) -> Vec<Vec<String>> {
    let mut found = Vec::new();
    let mut lines = TEXT.lines();
    while let Some(line) = lines.next() {
        if line.starts_with(&format!("| {title} |")) {
            let table = lines.by_ref().take_while(|line| line.starts_with('|')).skip(1);
            found.extend(
                table.map(|row| row.trim_matches('|').split(" | ").map(|cell| cell.trim().into()).collect()),
            );
        }
    }
    found
}

/// As the manuals say of power-up, and as hosts leave parts with flash.
#[test]
fn gauges_with_ram_start_unsealed_and_those_with_flash_sealed() {
    let (_, listed) = TEXT.split_once("One with RAM (").expect("the list");
    let listed: BTreeSet<_> = listed
        .split_once(')')
        .expect("its end")
        .0
        .to_lowercase()
        .split([',', '\n', ' '])
        .filter(|name| !name.is_empty())
        .map(String::from)
        .collect();
    let simulated = Chip::all().filter(|chip| chip.has_table() && Sim::knows(chip.name));
    let mut with_ram = BTreeSet::new();
    for chip in simulated {
        let is_ram = chip.access.scheme.is_ram();
        let expected = if is_ram { "unsealed" } else { "sealed" };
        assert_eq!(sim(chip.name).get("seal").as_deref(), Some(expected), "{}", chip.name);
        if is_ram {
            with_ram.insert(chip.name.to_string());
        }
    }
    assert_eq!(with_ram, listed);
}

#[test]
fn the_seal_state_of_a_simulated_gauge_can_be_chosen() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    for (chip, seal) in [(CHIP, "unsealed"), ("bq27441-g1", "sealed")] {
        gaugefs(&["mount", "--sim", chip, "--sim-seal", seal, &at]).done();
        assert_eq!(read(&format!("{at}/BAT0"), "gauge/seal"), seal, "{chip}");
        gaugefs(&["umount", &at]).done();
    }
    let ran = gaugefs(&["mount", "--sim", CHIP, "--sim-seal", "open", &at]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("expected one of: sealed, unsealed"), "{}", ran.err);
    gaugefs(&["mount", "--sim", "bq27541", "--sim-seal", "sealed", &at])
        .failed(&["seal: the part has no seal"]);
}

/// What is within the backticks of a cell.
fn quoted(cell: &str) -> &str {
    cell.strip_prefix('`').and_then(|cell| cell.strip_suffix('`')).expect("a cell in backticks")
}

/// Whether a part is one of those that the column `gauges` names.
fn is_one_of(chip: &Chip, gauges: &str) -> bool {
    let has_flash = !chip.subclasses.is_empty();
    let is_mac = matches!(chip.access.scheme, Scheme::Mac | Scheme::MacUpdate);
    match gauges {
        "all" => true,
        "TI" => chip.access.scheme != Scheme::Smbus,
        "Smart Battery" => chip.access.scheme == Scheme::Smbus,
        "TI in one" => chip.asks.is_some(),
        "data flash" => has_flash,
        "block access" => has_flash && !is_mac,
        "MAC" => is_mac,
        "protector" => chip.name == "bq27742-g1",
        "in the unit of a resistor" => ["bq27000", "bq27010"].contains(&chip.name),
        other => panic!("no gauges are called `{other}`"),
    }
}

/// Each knob, the gauges that have it, and a value that shows an effect; `None` for a knob that is only read.
const KNOBS: &[(&str, &str, Option<&str>)] = &[
    ("load_ma", "all", Some("500")),
    ("temperature", "all", Some("-50")),
    ("soc", "all", Some("15")),
    ("voltage_mv", "all", Some("2700")),
    ("speed", "all", Some("60")),
    ("clock", "all", None),
    ("cells", "block access", Some("7")),
    ("real_mah", "block access", Some("2400")),
    ("real_soc", "block access", None),
    ("power", "all", Some("off")),
    ("fault", "all", Some("lost 3")),
    ("nack_as", "all", Some("eio")),
    ("drop_resets", "data flash", Some("2")),
    ("drop_seals", "data flash", Some("1")),
    ("drop_keys", "data flash", Some("1")),
    ("drop_updates", "data flash", Some("1")),
    ("reseals", "block access", Some("on")),
    ("tear", "data flash", Some("neighbour")),
    ("endurance", "data flash", Some("3")),
    ("board_divider", "block access", Some("33000")),
    ("shunt_error", "block access", Some("-12.5")),
    ("cell_mohm", "data flash", Some("300")),
    ("thermistor", "data flash", Some("out")),
    ("keeps_full", "data flash", Some("on")),
    ("board_offset_ma", "block access", Some("3")),
    ("cc_offset_ma", "block access", Some("-2")),
    ("bat_det", "block access", Some("out")),
    ("temperature_error", "block access", Some("20")),
    ("noise_mv", "block access", Some("4")),
    ("noise_ma", "block access", Some("2.5")),
    ("cc_gain_inverted", "block access", Some("on")),
    ("load_ms", "data flash", Some("60")),
    ("sealed_load_ms", "block access", Some("40")),
    ("block_ms", "data flash", Some("50")),
    ("early", "data flash", Some("blank")),
    ("uncommitted", "data flash", Some("stored")),
    ("word_ms", "data flash", Some("4")),
    ("commit_ms", "data flash", Some("250")),
    ("commit_busy", "data flash", Some("old")),
    ("reset_ms", "data flash", Some("900")),
    ("reset_busy", "data flash", Some("nack")),
    ("first_ms", "TI", Some("3000")),
    ("first_values", "data flash", Some("nonsense")),
    ("no_initcomp", "data flash", Some("on")),
    ("reset_every_s", "data flash", Some("60")),
    ("status_ms", "data flash", Some("300")),
    ("cfgupdate_ms", "data flash", Some("1100")),
    ("cfgexit_ms", "data flash", Some("500")),
    ("auth_ms", "block access", Some("200")),
    ("bus_free_us", "TI", Some("66")),
    ("firmware", "data flash", Some("0x0201")),
    ("hardware", "data flash", Some("0x0081")),
    ("protocol", "block access", Some("hdq")),
    ("fets", "protector", None),
    ("seal", "data flash", Some("unsealed")),
    ("sealed_writes", "block access", Some("ignore")),
    ("auth_order", "block access", Some("as-sent")),
    ("watchdog", "TI", Some("on")),
    ("single_byte", "TI", Some("on")),
    ("df_shift", "MAC", Some("1")),
    ("cal_enable", "MAC", Some("on")),
    ("battery", "in the unit of a resistor", Some("out")),
    ("rewrite_ms", "data flash", Some("5000")),
    ("rewrite_every", "data flash", Some("40")),
    ("lock_ms", "block access", Some("6000")),
    ("key_lock", "block access", Some("on")),
    ("key_quiet_ms", "data flash", Some("100")),
    ("full_access_quiet_ms", "data flash", Some("5000")),
    ("refused_quiet_ms", "data flash", Some("4000")),
    ("series", "Smart Battery", Some("7")),
    ("specification", "Smart Battery", Some("0x1131")),
    ("battery_mode", "Smart Battery", Some("0x8000")),
    ("pec", "Smart Battery", Some("split")),
    ("answers", "Smart Battery", Some("0d=6400 1b=-")),
    ("sleeps", "Smart Battery", Some("on")),
    ("failed", "Smart Battery", Some("on")),
    ("device_type", "TI in one", Some("0x9E34")),
    ("ti_firmware", "TI in one", Some("0x0402")),
    ("pf_status", "TI in one", Some("0x00000001")),
    ("sealed", "TI in one", Some("off")),
    ("unknown", "TI in one", Some("0x0051 0x0056")),
    ("mac", "TI in one", Some("echo")),
    ("stale", "TI in one", Some("2")),
    ("harm", "TI in one", None),
    ("written", "Smart Battery", None),
    ("mode", "all", None),
    ("wear", "data flash", None),
    ("programmed", "data flash", None),
    ("dropped", "data flash", None),
    ("resets", "data flash", None),
    ("state", "data flash", None),
    ("transfers", "all", None),
    ("bytes", "all", None),
    ("bus_us", "all", None),
    ("stretched_us", "all", None),
    ("nacks", "all", None),
];

/// Each fault as it may be written, in the order in which they are listed.
const WRITTEN: &[&str] = &[
    "none",
    "nack 1",
    "eio 2",
    "etimedout 2 0",
    "eagain 2",
    "flip 3 4 7",
    "burst 1 0 32 255",
    "short 2",
    "lost 5",
    "stuck 2 1",
    "arbitration 1",
    "stretch 1 25",
    "silence 1 300",
    "power-cut 12 500",
    "power-cut-after 12",
    "drop-commit",
    "corrupt-commit",
    "torn-commit 5",
    "drop-reset",
    "drop-seal",
    "drop-key; drop-key",
    "random 20",
];

#[test]
fn each_gauge_has_the_knobs_of_its_kind() {
    for chip in Chip::all().filter(|chip| Sim::knows(chip.name)) {
        let knobs: BTreeSet<_> = sim(chip.name).knobs().into_iter().map(|knob| knob.name).collect();
        let expected: BTreeSet<_> =
            KNOBS.iter().filter(|(_, gauges, _)| is_one_of(chip, gauges)).map(|(name, ..)| *name).collect();
        assert_eq!(knobs, expected, "{}: has; should have", chip.name);
    }
}

#[test]
fn each_knob_shows_what_was_written_to_it() {
    for (name, gauges, value) in KNOBS {
        let gauges = Chip::all().filter(|chip| Sim::knows(chip.name) && is_one_of(chip, gauges));
        let sims: Vec<_> = gauges.map(|chip| sim(chip.name)).collect();
        let is_writable = |sim: &Sim| sim.knobs().iter().any(|knob| knob.name == *name && knob.writable);
        match value {
            Some(text) => {
                // No specimen of some parts has what a knob sets.
                let works = |sim: &Sim| {
                    let before = sim.get(name);
                    sim.set(name, text).is_ok() && sim.get(name) != before
                };
                assert!(sims.iter().any(works), "{name}: {text} shows no effect on any part");
                assert!(sims.iter().all(is_writable), "{name}");
            }
            None => assert!(!sims.iter().any(is_writable), "{name} has no value to write"),
        }
    }
}

#[test]
fn each_fault_can_be_written() {
    assert_eq!(FAULTS.len(), WRITTEN.len());
    for (fault, text) in FAULTS.iter().zip(WRITTEN) {
        assert!(text.starts_with(fault.name), "{text}");
        let sim = sim(CHIP);
        sim.set("fault", text).unwrap_or_else(|error| panic!("{text}: {error}"));
        assert_eq!(sim.get("fault").as_deref(), Some(*text));
    }
}

/// docs/SIMULATOR.md sends its readers to this list.
#[test]
fn knobs_and_faults_are_listed_by_the_program() {
    assert!(TEXT.contains("$ gaugefs sim bq34z100-g1 --list"));
    for chip in Chip::all().filter(|chip| Sim::knows(chip.name)) {
        let list = gaugefs(&["sim", chip.name, "--list"]).done();
        let rows: Vec<Vec<&str>> = list
            .lines()
            .map(|line| line.split("  ").map(str::trim).filter(|cell| !cell.is_empty()).collect())
            .collect();
        for Knob { name, help, writable, .. } in sim(chip.name).knobs() {
            let access = if writable { "read, write" } else { "read" };
            assert!(rows.contains(&vec![name, access, help]), "{}: {name} is not in {list}", chip.name);
        }
        for fault in FAULTS {
            assert!(rows.contains(&vec![&*fault.to_string(), fault.help]), "{fault} is not in {list}");
        }
    }
    gaugefs(&["sim", "--list"]).failed(&["no gauge", "gaugefs chips"]);
    assert_eq!(gaugefs(&["sim", CHIP, "--list", "--fast"]).code, Some(2));
}

/// Nothing that is refused is repeated, because it may be a key.
#[test]
fn simulator_refusals_say_what_would_be_accepted() {
    for chip in [CHIP, "bq27220", "bq27000"] {
        let sim = sim(chip);
        for knob in sim.knobs().iter().filter(|knob| knob.writable) {
            let before = sim.get(knob.name);
            let error = sim.set(knob.name, "8d3eb7c5").expect_err(knob.name).to_string();
            assert!(error.contains("write one") && !error.contains("8d3eb7c5"), "{chip}: {error}");
            assert_eq!(sim.get(knob.name), before, "{chip}: {}", knob.name);
        }
    }
    let refused = |text: &str| sim(CHIP).set("fault", text).expect_err(text).to_string();
    assert_eq!(refused("nack"), "fault: not the numbers of this fault; write: nack N [BYTE]");
    assert!(refused("fail 1").contains("no such fault; write one of these"));
    assert!(refused("fail 1").contains("torn-commit WORDS"));
}

#[test]
fn simulator_refusals_are_in_the_last_error() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    let knob = |name: &str, text: &str| fs::write(format!("{at}/BAT0/sim/{name}"), text);
    let last_error = || read(&at, "BAT0/gauge/last_error");
    let errno = |outcome: std::io::Result<()>| {
        Errno::from_raw(outcome.expect_err("refused").raw_os_error().unwrap_or_default())
    };
    assert_eq!(errno(knob("load_ma", "nonsense\n")), Errno::EINVAL);
    // As in the document, but for the time.
    let shown = last_error();
    let shown = shown.split_once(": ").expect("a time").1;
    assert!(TEXT.contains(shown), "{shown}");
    assert_eq!(errno(knob("load_ma", "99999\n")), Errno::ERANGE);
    assert!(last_error().contains("sim/load_ma: write a number from -32000 to 32000"), "{}", last_error());
    // Another knob does not clear it; this one does.
    knob("soc", "50\n").expect("a knob");
    assert!(!last_error().is_empty());
    knob("load_ma", "500\n").expect("a knob");
    assert_eq!(last_error(), "");
}

/// A mount with a scenario, which keeps its flash and journals in the folder, and the gauge's folder.
fn playing(folder: &Folder, scenario: &str) -> (Foreground, String) {
    let (at, state, journals) = (folder.file("mnt"), folder.file("flash"), folder.file("journals"));
    let more = ["--scenario", scenario, "--poll", "0.5", "--sim-state", &state, "--state-dir", &journals];
    let mount = Foreground::new(&at, &more);
    (mount, format!("{at}/BAT0"))
}

fn shows(gauge: &str, name: &str, text: &str) -> bool {
    fs::read_to_string(Path::new(gauge).join(name)).is_ok_and(|shown| shown.trim() == text)
}

fn write(gauge: &str, name: &str, text: &str) -> Result<(), Errno> {
    fs::write(Path::new(gauge).join(name), format!("{text}\n")).map_err(errno)
}

#[test]
fn the_scenario_power_cut_ends_with_the_old_value() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (_mount, gauge) = playing(&folder, "power-cut");
    assert_eq!((&*read(&gauge, "df/80/53"), &*read(&gauge, "serial_number")), ("3000", "0007"));
    assert_eq!(write(&gauge, "df/80/53", "3100"), Err(Errno::ENOTRECOVERABLE));
    assert!(read(&gauge, "gauge/last_error").contains("data flash contents unknown"));
    within("settled", || {
        read(&gauge, "gauge/last_error")
            .contains("interrupted half way; the old values were restored and verified")
    });
    assert_eq!(read(&gauge, "df/80/53"), "3000");
    assert_eq!(write(&gauge, "df/80/53", "3200"), Ok(()));
}

#[test]
fn the_scenario_swapped_pack_changes_neither_pack() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (_mount, gauge) = playing(&folder, "swapped-pack");
    assert_eq!(read(&gauge, "serial_number"), "0001");
    assert_eq!(write(&gauge, "df/80/53", "3100"), Err(Errno::ENOTRECOVERABLE));
    // The next poll says it in its own words.
    let why = read(&gauge, "gauge/last_error");
    let is_said =
        ["another pack answers, and nothing was written to it", "this is another pack; nothing was touched"];
    assert!(is_said.iter().any(|words| why.contains(words)), "{why}");
    within("the second pack", || shows(&gauge, "serial_number", "0007"));
    assert_eq!(read(&gauge, "df/80/53"), "3000");
    assert_eq!(read(&gauge, "sim/programmed"), "0");
    // Nothing is written to it either as long as nobody has decided.
    assert!(write(&gauge, "df/80/53", "3200").is_err());
    assert_eq!(read(&gauge, "sim/programmed"), "0");
    assert_eq!(write(&gauge, "sim/speed", "60"), Ok(()));
    // The pack was taken out while it programmed its only block: a fast host finds the old one, a slow one the new one.
    let outcomes = [("data flash holds the old values", "3000"), ("finished and verified", "3100")];
    let settled = || {
        let told = fs::read_to_string(format!("{gauge}/gauge/last_error")).unwrap_or_default();
        outcomes.iter().find(|(outcome, _)| told.contains(outcome)).map(|(_, value)| *value)
    };
    // Its serial number is that of every new one: a host that was too slow to see it return asks a person.
    let is_asked = || {
        let told = fs::read_to_string(format!("{gauge}/gauge/last_error")).unwrap_or_default();
        told.contains("so it may be another pack; nothing was touched")
    };
    let is_told = || settled().is_some() || is_asked();
    within("the first pack", || shows(&gauge, "serial_number", "0001") && is_told());
    if is_asked() {
        assert!(write(&gauge, "df/80/53", "3200").is_err(), "nobody has decided");
        return;
    }
    assert_eq!(Some(&*read(&gauge, "df/80/53")), settled());
    assert_eq!(write(&gauge, "df/80/53", "3200"), Ok(()));
}

/// An hour in ten seconds.
#[test]
fn the_scenario_failing_bus_ends_with_right_values() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (_mount, gauge) = playing(&folder, "failing-bus");
    let number = |name: &str| read(&gauge, name).parse::<f64>().expect("a number");
    let begun = number("sim/clock");
    assert_eq!(write(&gauge, "sim/speed", "360"), Ok(()));
    within("an hour", || number("sim/clock") > begun + 3600.0);
    assert_eq!(write(&gauge, "sim/speed", "0"), Ok(()));
    assert!(number("sim/nacks") > 0.0);
    let polls = number("gauge/statistics/polls");
    within("two polls", || number("gauge/statistics/polls") > polls + 1.0);
    for (name, text) in
        [("present", "1"), ("status", "Discharging"), ("current_now", "-100000"), ("temp", "250")]
    {
        assert_eq!(read(&gauge, name), text, "{name}");
    }
    assert!((68.0..=72.0).contains(&number("capacity")), "{}", number("capacity"));
    assert!((number("capacity") - number("sim/soc")).abs() <= 1.0, "the pack has {}", number("sim/soc"));
}

/// A ride of three hours in a few seconds.
#[test]
fn a_scenario_is_recorded_and_drawn() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (_mount, gauge) = playing(&folder, "ebike-ride");
    let (rows, picture) = (folder.file("ride.csv"), folder.file("ride.svg"));
    let clock = || read(&gauge, "sim/clock").parse::<f64>().expect("seconds");
    let capacities = |text: &str| -> Vec<i64> {
        text.lines().filter_map(|row| row.split(',').nth(7)?.parse().ok()).collect()
    };
    gaugefs(&["log", "--count", "2", "-o", &rows, &gauge]).done();
    let before = fs::read_to_string(&rows).expect("rows");
    // How far the ride is at a row depends on the load of the host, and so does whether a row has values.
    let start = clock();
    assert_eq!(write(&gauge, "sim/speed", "3600"), Ok(()));
    within("the ride is over", || clock() - start >= 3.0 * 3600.0);
    let after = gaugefs(&["log", "--count", "3", &gauge]).done();
    let after: String = after.lines().skip(1).map(|row| format!("{row}\n")).collect();
    let (first, last) = (capacities(&before).first().copied(), capacities(&after).last().copied());
    let is_right = first.is_some_and(|first| first > 60) && last.is_some_and(|last| (5..45).contains(&last));
    assert!(is_right, "{before}{after}");
    fs::write(&rows, before + &after).expect("rows");
    gaugefs(&["plot", "-o", &picture, &rows]).done();
    assert!(fs::read_to_string(&picture).expect("a picture").contains("</svg>"));
}

#[test]
fn a_scenario_that_cannot_be_played_mounts_nothing() {
    let folder = Folder::new();
    let (at, file) = (folder.file("mnt"), folder.file("day.toml"));
    let mount = |chip: &str, scenario: &str| gaugefs(&["mount", "--sim", chip, "--scenario", scenario, &at]);
    mount(CHIP, "robot").failed(&["robot: there is no such scenario", "robot-day", "A file has a slash"]);
    mount(CHIP, "./none.toml").failed(&["none.toml: cannot be read: No such file or directory"]);
    fs::write(&file, "[[step]]\nat = 'soon'\n").expect("a file");
    mount(CHIP, &file).failed(&["day.toml: line 2: not a time; write seconds, or one such as \"1h30m\""]);
    fs::write(&file, "[[step]]\nat = 1\nload = 5\n").expect("a file");
    mount(CHIP, &file).failed(&["day.toml: step 1: load: there is no such knob"]);
    mount("bq27220", "swapped-pack").failed(&["swapped-pack: step 1: flash: this part has no flash there"]);
    assert!(!Path::new(&at).join("BAT0").exists());
    let sim = gaugefs(&["sim", "--replay", "tests/none", "--scenario", "robot-day", &folder.file("bus")]);
    sim.failed(&["--scenario: a recording shows what has happened"]);
}

#[test]
fn the_shipped_scenarios_are_in_the_help_and_in_the_document() {
    let help = gaugefs(&["mount", "--help"]).done();
    let help = help.split_whitespace().collect::<Vec<_>>().join(" ");
    let names: Vec<&str> = gauge_sim::scenario::names().collect();
    assert!(help.contains(&names.join(", ")), "{help}");
    let documented: Vec<String> = rows("scenario").iter().map(|row| quoted(&row[0]).to_string()).collect();
    assert_eq!(documented, names);
}
