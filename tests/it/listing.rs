// SPDX-License-Identifier: MIT

//! `gaugefs list`, and `gaugefs probe` without a bus.

use std::fs;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;

use crate::room::{CHIP, Folder, can_mount, command, gaugefs, within};

/// The lines of `gaugefs list --json` about what is in a folder: other tests have mounts as well.
fn listed(folder: &Folder) -> Vec<Value> {
    let lines = gaugefs(&["list", "--json"]).out;
    let lines = lines.lines().map(|line| serde_json::from_str::<Value>(line).expect("JSON"));
    let inside = folder.file("");
    let place =
        |line: &Value| line.get("gauge").or(line.get("mountpoint")).and_then(Value::as_str).map(String::from);
    lines.filter(|line| place(line).expect("a place").starts_with(&inside)).collect()
}

#[test]
fn every_mounted_gauge_is_listed_even_beside_a_stopped_daemon() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, other, config) = (folder.file("m"), folder.file("n"), folder.file("two.toml"));
    fs::write(
        &config,
        format!("[[gauge]]\nsim = \"{CHIP}\"\n[[gauge]]\nsim = \"bq27441-g1\"\nname = \"RAM\"\n"),
    )
    .expect("a file");
    gaugefs(&["mount", "--config", &config, &at]).done();
    let foreground = ["mount", "--foreground", "--sim", CHIP, "--name", "STOPPED", &other];
    let mut daemon = command(&foreground).stderr(std::process::Stdio::null()).spawn().expect("gaugefs runs");
    within("mounted", || std::path::Path::new(&other).join("STOPPED/present").exists());
    let all = listed(&folder);
    let paths: Vec<_> = all.iter().map(|line| line["gauge"].as_str().expect("a path")).collect();
    assert_eq!(paths, [format!("{at}/BAT0"), format!("{at}/RAM"), format!("{other}/STOPPED")]);
    assert_eq!((&all[0]["part"], &all[0]["serial"]), (&"bq34z100-G1".into(), &"0x0001".into()));
    assert_eq!((&all[0]["capacity"], &all[0]["status"]), (&60.into(), &"Not charging".into()));
    assert!(all[0]["age_ms"].as_u64().is_some_and(|age| age < 60_000), "{}", all[0]);
    assert_eq!(
        (&all[1]["part"], &all[1]["serial"]),
        (&"bq27441-G1".into(), &Value::Null),
        "it has no serial number"
    );
    let table = gaugefs(&["list"]).out;
    assert!(
        table.starts_with("GAUGE ")
            && table.lines().any(|line| line.contains("/m/BAT0") && line.contains("60 %"))
    );

    let pid = Pid::from_raw(daemon.id() as i32);
    crate::room::stop(daemon.id(), &other);
    let stopped = gaugefs(&["list"]);
    assert_eq!(stopped.code, Some(1));
    assert!(stopped.err.contains(&format!("{other}: its daemon does not answer")), "{}", stopped.err);
    assert!(stopped.out.contains("/m/BAT0") && stopped.out.contains("/m/RAM"), "{}", stopped.out);
    // Neither does a completion wait for ever.
    gaugefs(&["names", &format!("{other}/STOPPED")]).done();
    kill(pid, Signal::SIGKILL).expect("it runs");
    daemon.wait().expect("it ends");
    let dead = gaugefs(&["list"]);
    assert_eq!(dead.code, Some(1));
    assert!(
        dead.err.contains(&format!("{other}: its daemon has died; remove the mount with: gaugefs umount")),
        "{}",
        dead.err
    );
    assert!(
        listed(&folder)
            .iter()
            .any(|line| line["error"].as_str().is_some_and(|error| error.contains("has died")))
    );
    gaugefs(&["get", &other, "80/53"]).failed(&["its daemon has died", "gaugefs umount"]);
}

/// Each command says the same thing in the same way, as COMMANDS.md has it.
#[test]
fn a_gauge_and_a_value_have_one_shape_in_the_json_of_every_command() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    let gauge = format!("{at}/BAT0");
    let image = folder.file("image.toml");
    gaugefs(&["export", "-o", &image, &gauge]).done();
    let json = |arguments: &[&str]| -> Value {
        let out = gaugefs(arguments).out;
        serde_json::from_str(out.lines().next().expect("a line"))
            .unwrap_or_else(|_| panic!("{arguments:?}: {out}"))
    };
    let passed = std::path::Path::new(&gauge).join("gauge/registers/passed_charge");
    within("all registers", || passed.exists());
    let voltage = "it-cfg/cell-terminate-voltage";
    let set = format!("{voltage}=3100");
    let commands = [
        &["get", "--json", &gauge, voltage, "serial-number", "manufacture-date", "pack-configuration"][..],
        &["set", "--json", "--dry-run", &gauge, &set],
        &["import", "--json", "--dry-run", "--set", &set, &gauge, &image],
        &["export", "--json", "-o", &image, &gauge],
        &["top", "--json", "--count", "1", &at],
        &["learn", "--json", "--once", &gauge],
    ];
    for command in commands {
        let line = json(command);
        for (field, value) in [("gauge", &*gauge), ("part", "bq34z100-G1"), ("serial", "0x0001")] {
            assert_eq!(line[field], value, "{field} of {command:?}: {line}");
        }
    }
    let listed = listed(&folder);
    assert_eq!((&listed[0]["gauge"], &listed[0]["serial"]), (&gauge.clone().into(), &"0x0001".into()));

    let value = |name: &str, value: Value, unit: &str| serde_json::json!({"name": name, "value": value, "unit": unit});
    let values = json(commands[0]);
    assert_eq!(values["values"][0], value(voltage, 3000.into(), "mV"));
    assert!(values["values"][1]["value"].is_string() && values["values"][2]["value"].is_string(), "{values}");
    assert!(values["values"][3]["value"].as_str().is_some_and(|text| text.starts_with("0x")), "{values}");
    let change = serde_json::json!({"name": voltage, "old": 3000, "new": 3100, "unit": "mV"});
    assert_eq!(json(commands[1])["changes"][0], change);
    assert_eq!(json(commands[2])["changes"][0], change);
    let linted = json(&["lint", "--json", &image]);
    let of_image = linted["parameters"].as_array().expect("a list").iter();
    let row = of_image.clone().find(|row| row["name"] == voltage).expect("a row");
    assert_eq!((&row["value"], &row["unit"]), (&3000.into(), &"mV".into()));
    gaugefs(&["set", &gauge, &set]).done();
    let rows = json(&["diff", "--json", &image, &gauge]);
    assert_eq!(rows[0], serde_json::json!({"name": voltage, "a": 3000, "b": 3100, "unit": "mV"}));
    // A serial number in hexadecimal is no number, whatever its digits are.
    let sample = json(&["top", "--json", "--count", "1", &at]);
    assert!(sample["serial_number"].is_string() && sample["capacity"].is_u64(), "{sample}");
    assert_eq!(sample["present"], 1, "the template in docs/fleet compares it with a number: {sample}");
    let refused = json(&["set", "--json", &gauge, &format!("{voltage}=9999")]);
    let details = &refused["error_details"];
    assert!(details["least"].is_i64() && details["cause"] == "out-of-range", "{details}");
}

/// Where a machine has buses, each is named; where it has none, that is said.
#[test]
fn probe_without_a_bus_looks_at_all_or_says_why_not() {
    let buses = gauge_bus::linux::adapters(std::path::Path::new("/"));
    let ran = gaugefs(&["probe"]);
    if buses.is_empty() {
        ran.failed(&["no I2C bus", "gaugefs doctor"]);
    } else {
        for (number, _) in &buses {
            assert!(ran.out.contains(&format!("/dev/i2c-{number} (")), "{}", ran.out);
        }
        let lines = gaugefs(&["probe", "--json"]).out;
        assert_eq!(lines.lines().count(), buses.len(), "{lines}");
    }
    assert_eq!(gaugefs(&["probe", "--address", "0x55"]).code, Some(2), "an address is one of a bus");
}
