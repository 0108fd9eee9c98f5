// SPDX-License-Identifier: MIT

//! A gauge with RAM behind a mount: its profile, and what it has learned.

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use crate::room::{Folder, Foreground, can_mount, gaugefs, read, stop, within};

#[test]
fn a_profile_is_there_again_after_a_loss_of_power() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let [at, profile, state] = ["m", "pack.toml", "state"].map(|name| folder.file(name));
    fs::write(&profile, "chip = \"bq27441-g1\"\n[state]\ndesign-capacity = 2100\n").expect("a file");
    let gauge = format!("{at}/BAT0");
    let mount = ["mount", "--sim", "bq27441-g1", "--poll", "0.5", "--state-dir", &state, "--pack", "A", &at];
    gaugefs(&[&mount[..], &["--profile", &profile]].concat()).done();
    let shows = |text: &str| {
        let found = fs::read_to_string(Path::new(&gauge).join("charge_full_design")).unwrap_or_default();
        found.trim_end() == text
    };
    within("the profile", || shows("2100000"));
    for position in ["off", "on"] {
        fs::write(format!("{gauge}/sim/power"), position).expect("a knob");
    }
    // From now on it shows the profile's value, or nothing.
    within("the profile again", || {
        assert!(!shows("1340000"));
        read(&at, "BAT0/gauge/itpor") == "0" && shows("2100000")
    });
    let shown = gaugefs(&["learned", &gauge]);
    assert!(shown.out.contains("nothing is kept that could be restored"), "{} {}", shown.out, shown.err);
    let refused = gaugefs(&["learned", "--restore", &gauge]);
    assert!(
        refused.code == Some(1) && refused.err.contains("nothing is kept of it"),
        "{} {}",
        refused.out,
        refused.err
    );
    // Versions as `gaugefs` saves them. The backup before a first write has the name of the gauge there.
    within("a write", || gaugefs(&["set", &gauge, "qmax-cell-0=15003"]).code == Some(0));
    let names = fs::read_dir(&state).expect("a folder").map(|entry| entry.expect("a file").file_name());
    let mut names = names.map(|name| name.into_string().expect("text"));
    let backup = names.find(|name| name.ends_with(".backup.toml")).expect("a backup");
    let (key, _) = backup.split_once("-bq27441-g1-").expect("the part");
    for (time, qmax) in [("20261125T093000Z", 15_001), ("20261125T101500Z", 15_002)] {
        let text = format!("chip = \"bq27441-g1\"\n[state]\nqmax-cell-0 = {qmax}\ndesign-capacity = 2100\n");
        let name = format!("{key}-bq27441-g1-A-{time}.learned.toml");
        fs::write(Path::new(&state).join(name), text).expect("a file");
    }
    let shown = gaugefs(&["learned", &gauge]).done();
    assert!(shown.contains("  20261125T093000Z  state/qmax-cell-0 = 15001\n"), "{shown}");
    for (version, why) in [
        ("20261125T093001Z", "there are 20261125T093000Z, 20261125T101500Z"),
        ("yesterday", "not a version"),
        ("20261125T093000Z 20261125T101500Z", "write show, restore"),
    ] {
        gaugefs(&["learned", &gauge, &format!("--restore={version}")]).failed(&[why]);
    }
    let restored = gaugefs(&["learned", &gauge, "--restore=20261125T093000Z"]).done();
    assert!(restored.contains("until 20261125T093000Z"), "{restored}");
    assert_eq!(gaugefs(&["get", &gauge, "qmax-cell-0"]).done().trim_end(), "state/qmax-cell-0: 15001");
    let forgotten = gaugefs(&["learned", "--forget", &gauge]);
    assert!(
        forgotten.code == Some(0) && forgotten.out.contains("4 versions removed"),
        "{} {}",
        forgotten.out,
        forgotten.err
    );
    gaugefs(&["umount", &at]).done();
}

/// Two makers of cells: a resistor tells them apart, and a program knows the serial number of the pack.
#[test]
fn the_pack_decides_which_profile_a_gauge_gets() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let [at, adc, state] = ["m", "adc", "state"].map(|name| folder.file(name));
    for (name, capacity) in [("atl.toml", 2100), ("scud.toml", 2250), ("own.toml", 2300)] {
        let image = format!("chip = \"bq27441-g1\"\n[state]\ndesign-capacity = {capacity}\n");
        fs::write(folder.file(name), image).expect("a file");
    }
    let config = folder.file("gauges.toml");
    let text = format!(
        "[mount]\nmountpoint = 'm'\nstate-dir = '{state}'\n\
         [[gauge]]\nname = 'PACK'\nsim = 'bq27441-g1'\npoll = 0.5\nsim-set = {{ lock_ms = 0 }}\n\
         [[gauge.choose]]\nfile = 'adc'\nfrom = 100\nto = 200\nprofile = 'atl.toml'\n\
         [[gauge.choose]]\nfile = 'adc'\nfrom = 300\nto = 400\nprofile = 'scud.toml'\n\
         [[gauge.choose]]\ncommand = ['/bin/sh', '-c', 'cat \"{}\"']\npack-by-text = true\nprofile = 'own.toml'\n",
        folder.file("serial")
    );
    fs::write(&config, &text).expect("a file");
    fs::write(&adc, "150\n").expect("a file");
    // Whoever can change the file chooses what is run.
    fs::set_permissions(&config, Permissions::from_mode(0o664)).expect("a mode");
    gaugefs(&["mount", "--config", &config]).failed(&["others may change the programs"]);
    fs::set_permissions(&config, Permissions::from_mode(0o644)).expect("a mode");
    // A check runs nothing, and names what is missing.
    gaugefs(&["mount", "--config", &config, "--check"]).done();
    let wrong = folder.file("wrong.toml");
    fs::write(&wrong, text.replace("'scud.toml'", "'none.toml'").replace("/bin/sh", "/bin/none"))
        .expect("a file");
    let check = gaugefs(&["mount", "--config", &wrong, "--check"]);
    assert_eq!(check.code, Some(1), "{}{}", check.out, check.err);
    assert!(check.err.contains("none.toml") && check.err.contains("/bin/none"), "{}", check.err);

    gaugefs(&["mount", "--config", &config]).done();
    let shows = |text: &str| {
        fs::read_to_string(format!("{at}/PACK/charge_full_design"))
            .is_ok_and(|found| found.trim_end() == text)
    };
    let exchange = |reading: &str, serial: &str| {
        for position in ["off", "on"] {
            fs::write(&adc, reading).expect("a file");
            fs::write(folder.file("serial"), serial).expect("a file");
            fs::write(format!("{at}/PACK/sim/power"), position).expect("a knob");
        }
    };
    within("the first maker", || shows("2100000"));
    exchange("350\n", "");
    within("the second maker", || shows("2250000"));
    exchange("500\n", "");
    within("what is wrong", || read(&at, "PACK/gauge/last_error").contains("shows nothing"));
    assert!(fs::read_to_string(format!("{at}/PACK/capacity")).is_err(), "it is a guess");
    exchange("500\n", "SN-17\n");
    within("the pack of its own", || shows("2300000"));
    assert_eq!(read(&at, "PACK/gauge/last_error"), "");
    let shown = gaugefs(&["learned", &format!("{at}/PACK")]).done();
    assert!(shown.contains("own.toml of the pack SN-17"), "{shown}");
    gaugefs(&["umount", &at]).done();
}

/// A file in the mount of a daemon that is stopped: whoever reads it waits for good. And a program that does not end.
#[test]
fn regression_what_a_choice_looks_at_took_its_gauge_along_when_it_hung() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let [other, config, profile, state] =
        ["o", "gauges.toml", "p.toml", "state"].map(|name| folder.file(name));
    fs::write(&profile, "chip = \"bq27441-g1\"\n[state]\ndesign-capacity = 2100\n").expect("a file");
    let stopped = Foreground::new(&other, &[]);
    stop(stopped.0.id(), &other);
    for (at, evidence) in [
        ("file", format!("file = '{other}/BAT0/gauge/age_ms'")),
        ("program", "command = ['/bin/sleep', '600']".into()),
    ] {
        let at = folder.file(at);
        let text = format!(
            "[mount]\nmountpoint = '{at}'\nstate-dir = '{state}'\n[[gauge]]\nsim = 'bq27441-g1'\npoll = 0.5\n\
             [[gauge.choose]]\n{evidence}\nprofile = '{profile}'\n"
        );
        fs::write(&config, text).expect("a file");
        let mounted = gaugefs(&["mount", "--config", &config]);
        assert!(!mounted.err.contains("no answer"), "{}", mounted.err);
        mounted.done();
        within("the reason", || {
            ["does not answer", "has not ended in time"]
                .iter()
                .any(|why| read(&at, "BAT0/gauge/last_error").contains(why))
        });
        // Its gauge still answers, and so does the daemon.
        fs::write(format!("{at}/BAT0/gauge/refresh"), "1").expect("it answers");
        assert_eq!(read(&at, "BAT0/df/82/10"), "1340");
        assert!(fs::read_to_string(format!("{at}/BAT0/capacity")).is_err(), "it is a guess");
        gaugefs(&["umount", &at]).done();
    }
    drop(stopped);
    gaugefs(&["umount", &other]).done();
}

#[test]
fn regression_a_gauge_that_was_flat_said_so_nowhere_a_person_looks() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let gauge = format!("{at}/BAT0");
    gaugefs(&["mount", "--sim", "bq27441-g1", "--poll", "0.5", &at]).done();
    assert_eq!(read(&gauge, "gauge/last_error"), "");
    for position in ["off", "on"] {
        fs::write(format!("{gauge}/sim/power"), position).expect("a knob");
    }
    within("the loss", || read(&gauge, "gauge/last_error").contains("has lost its configuration"));
    for command in ["list", "doctor"] {
        let shown = gaugefs(&[command]);
        let shown = shown.out + &shown.err;
        let is_it = |line: &str| line.contains(&gauge) && line.contains("mount with --profile");
        assert!(shown.lines().any(is_it), "{command}: {shown}");
    }
    gaugefs(&["umount", &at]).done();
}

#[test]
fn a_gauge_with_flash_forgets_nothing() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", "bq34z100-g1", &at]).done();
    let refused = gaugefs(&["learned", &format!("{at}/BAT0")]);
    assert!(
        refused.code == Some(1) && refused.err.contains("data memory in RAM"),
        "{} {}",
        refused.out,
        refused.err
    );
    gaugefs(&["umount", &at]).done();
}
