// SPDX-License-Identifier: MIT

//! The command line: what it prints, and its exit codes.
//!
//! The output is compared with the files in `golden/`. After an intended change, run the tests once with
//! GAUGEFS_GOLDEN=write and read the difference before you commit it.

use std::fmt::Write as _;
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::Duration;

use ti_gauge::chip::Chip;

use crate::room::{
    CHIP, Folder, Ran, as_nobody, can_mount, gaugefs, gaugefs_station, in_real_time, read, same_as_golden,
    users_can_mount, within,
};

#[cfg(feature = "screen")]
mod acting;
#[cfg(feature = "screen")]
mod calibrating;
mod files;
mod mounting;
mod watching;

/// Compares the output and exit codes of command lines with a file of `golden/`.
#[track_caller]
fn golden(name: &str, lines: &[&str]) {
    let mut now = String::new();
    for line in lines {
        let Ran { code, out, err, .. } = gaugefs(&line.split_ascii_whitespace().collect::<Vec<_>>());
        writeln!(now, "$ gaugefs {line}\n{out}{err}=> {}\n", code.expect("it exits")).expect("a string");
    }
    same_as_golden(name, &now);
}

#[test]
fn help_texts() {
    golden(
        "help",
        &[
            "--help",
            "mount --help",
            "umount --help",
            "list --help",
            "probe --help",
            "rescue --help",
            "chips --help",
            "report --help",
            "get --help",
            "set --help",
            "export --help",
            "import --help",
            "diff --help",
            "lint --help",
            "bringup --help",
            "calibrate --help",
            "auth --help",
            "keys --help",
            "keys change --help",
            "doctor --help",
            "completions --help",
            "top --help",
            "learn --help",
            "log --help",
            "plot --help",
            "wait --help",
            "watch --help",
            "metrics --help",
            "events --help",
        ],
    );
}

#[test]
fn help_texts_of_the_station() {
    let mut now = String::new();
    for line in ["--help", "program --help", "records --help", "completions --help", "man --help", "program"]
    {
        let Ran { code, out, err, .. } = gaugefs_station(&line.split_ascii_whitespace().collect::<Vec<_>>());
        writeln!(now, "$ gaugefs-station {line}\n{out}{err}=> {}\n", code.expect("it exits"))
            .expect("a string");
    }
    same_as_golden("station", &now);
}

#[test]
fn chips_are_listed() {
    golden(
        "chips",
        &[
            "chips",
            "chips --json",
            "chips bq34z100-g1",
            "chips bq27000",
            "chips --json BQ34110",
            "chips bq27545-g1 --rows",
        ],
    );
}

#[test]
fn misuse_has_exit_code_2() {
    // The usage that is printed repeats the options that were typed.
    let _time = in_real_time();
    golden(
        "misuse",
        &[
            "frob",
            "mount /tmp/x",
            "mount --sim",
            "mount --sim bq34z100-g1",
            "mount --sim bq99 /tmp/x",
            "mount --sim bq34z100-g1 --bus /dev/i2c-1 /tmp/x",
            "mount --sim bq34z100-g1 --poll 0.1 /tmp/x",
            "mount --sim bq34z100-g1 --name a/b /tmp/x",
            "mount --sim bq34z100-g1 --ac=a/b /tmp/x",
            "mount --sim bq34z100-g1 --sim-key 0414 /tmp/x",
            "mount --sim bq34z100-g1 --energy-scale 0 /tmp/x",
            "mount --sim bq34z100-g1 --group no-such-group /tmp/x",
            "mount /dev/i2c-1 /tmp/x",
            "probe /dev/i2c-1",
            "mount --sim bq34z10-g1 /tmp/x",
            "mount --sim bq34z100-g1 -x /tmp/x",
            "mount --sim bq34z100-g1 /tmp/x /tmp/y",
            "mount --bus /dev/i2c-1 --adress 0x55 /tmp/x",
            "mount --bus /dev/i2c-1 --address 0xaa /tmp/x",
            "mount --bus /dev/i2c-1 --address 55 /tmp/x",
            "mount --bus /dev/i2c-1 --address 0x5x /tmp/x",
            "mount --bus /dev/i2c-1 --sim-state /tmp/y /tmp/x",
            "mount --sim bq34z100-g1 --auth-order random /tmp/x",
            "mount --replay /tmp/y --bus /dev/i2c-1 /tmp/x",
            "mount --replay /tmp/y --trace /tmp/z /tmp/x",
            "mount --config /tmp/y --sim bq34z100-g1 /tmp/x",
            "mount --config /tmp/y --name PACK",
            "mount --sim bq34z100-g1 --check /tmp/x",
            "umount",
            "probe --address 0x55",
            "chips bq99",
            "report",
            "report /tmp/x --bus /dev/i2c-1",
            "report /tmp/x --key-file /tmp/y",
            "report --sim bq34z100-g1 --address 0x55",
            "export",
            "import /tmp/x",
            "import /tmp/x /tmp/y --exclude secrets",
            "diff /tmp/x /tmp/y --exclude secrets",
            "keys",
            "keys change /tmp/x",
            "keys change /tmp/x seal",
            "export --format hex /tmp/x",
            "diff /tmp/x",
            "lint",
            "lint --chip bq99 /tmp/x",
            "auth /tmp/x",
            "completions",
            "completions csh",
            "top --count 3",
            "top --interval 0",
            "learn",
            "log",
            "log /tmp/x --count 0",
            "plot",
            "plot /tmp/x --width 10",
        ],
    );
}

#[test]
fn failures_say_what_to_do() {
    gaugefs(&["probe", "--bus", "/dev/i2c-999"]).failed(&["/dev/i2c-999: no such bus"]);
    gaugefs(&["probe", "--bus", "/dev/null"]).failed(&["/dev/null: not an I2C bus"]);
    let at = Folder::new().file("m");
    gaugefs(&["mount", "--bus", "/dev/i2c-999", &at]).failed(&["no such bus"]);
    gaugefs(&["umount", "/proc"]).failed(&["/proc: proc", "not gaugefs"]);
    gaugefs(&["umount", "/etc"]).failed(&["/etc: no gaugefs is mounted there"]);
    let mount = |at| gaugefs(&["mount", "--sim", CHIP, at]);
    mount("/proc").failed(&["/proc: proc", "is mounted there"]);
    let folder = Folder::new();
    let file = folder.file("file");
    fs::write(&file, "").expect("a file");
    mount(&file).failed(&[&format!("{file}: not a folder")]);
}

#[test]
fn a_bus_without_permission_names_the_group_to_join() {
    if !users_can_mount() {
        return;
    }
    let folder = Folder::new();
    let node = folder.file("i2c-250");
    // An adapter that no machine has: the mode is checked before the adapter is opened.
    let device = nix::sys::stat::makedev(89, 250);
    let mode = nix::sys::stat::Mode::from_bits_truncate(0o660);
    let made = nix::sys::stat::mknod(node.as_str(), nix::sys::stat::SFlag::S_IFCHR, mode, device);
    if made.is_err() {
        eprintln!("SKIPPED: no device node can be made without root; no forbidden bus was probed");
        return;
    }
    for (gid, says) in [(0, "no permission; run gaugefs as root"), (1, "join the group daemon")] {
        std::os::unix::fs::chown(&node, Some(0), Some(gid)).expect("its group");
        for arguments in [&["probe", "--bus", &node][..], &["mount", "--bus", &node, &folder.file("m")]] {
            let output = as_nobody(&folder, arguments).output().expect("gaugefs runs");
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(1), "{said}");
            assert!(said.starts_with(&format!("gaugefs: {node}")) && said.contains(says), "{said}");
        }
    }
}

/// Another process that reads the file during a commit sees the progress, without waiting.
#[test]
fn a_commit_shows_its_progress() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let _time = in_real_time();
    // It takes a third of a second to program a block.
    let chip = Chip::by_name("bq27520-g3").expect("a chip");
    gaugefs(&["mount", "--sim", chip.name, "--allow-unproven", &at]).done();
    let gauge = format!("{at}/BAT0");
    // A busy machine may not look while it is being programmed, so that it takes more than one commit.
    let mut shown = std::collections::BTreeSet::new();
    for more in 0..20 {
        let lines = format!("48/10 {}\n2/0 {}\n34/2 {}", 1100 + more, 560 + more, 4100 + more);
        let file = format!("{gauge}/df/transaction");
        let commit = std::thread::spawn(move || fs::write(file, format!("begin\n{lines}\ncommit\n")));
        while !commit.is_finished() {
            shown.insert(read(&at, "BAT0/df/transaction"));
            std::thread::sleep(Duration::from_millis(10));
        }
        commit.join().expect("no panic").expect("a commit");
        if shown.contains("committing 1/3") {
            break;
        }
    }
    assert!(shown.contains("committing 1/3"), "{shown:?}");
    assert_eq!(read(&at, "BAT0/df/transaction"), "idle");
    gaugefs(&["umount", &at]).done();
}

/// Uses every key, and looks for them in the log, the trace and `gauge/last_error`.
#[test]
fn a_genuine_pack_is_recognised_and_its_keys_appear_nowhere() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, log, trace, keys) =
        (folder.file("m"), folder.file("log"), folder.file("trace"), folder.file("keys"));
    let write_keys = |text: &str| {
        fs::write(&keys, text).expect("a key file");
        fs::set_permissions(&keys, Permissions::from_mode(0o600)).expect("its mode");
    };
    let default = "0123456789ABCDEFFEDCBA9876543210";
    write_keys(&format!("unseal = 8d3e b7c5\nfull_access = ffff ffff\nauthentication = {default}\n"));
    let mount = ["mount", "--sim", CHIP, "--sim-key", "8d3e b7c5", "--key-file", &keys];
    gaugefs(&[&mount[..], &["--log", &log, "--trace", &trace, &at]].concat()).done();
    let gauge = format!("{at}/BAT0");
    let auth = || gaugefs(&["auth", &gauge, "--key-file", &keys]);

    assert_eq!(auth().done(), "genuine, byte order lsb-first\n");
    fs::write(Path::new(&gauge).join("sim/auth_order"), "as-sent").expect("a knob");
    assert_eq!(
        auth().done(),
        "genuine, byte order as-sent; it is mounted with lsb-first; mount it with --auth-order as-sent\n"
    );
    fs::write(Path::new(&gauge).join("gauge/seal"), "full-access").expect("a state");
    assert!(auth().done().starts_with("genuine"));
    assert_eq!(read(&gauge, "gauge/seal"), "full-access");
    fs::write(Path::new(&gauge).join("df/80/53"), "3100").expect("a write");
    // A key written in place of a subcommand or a challenge is not repeated either.
    for (file, text) in [("control", "8d3e"), ("control", "b7c5"), ("authenticate", default)] {
        fs::write(Path::new(&gauge).join("gauge").join(file), text).expect_err("a refusal");
        let last_error = read(&gauge, "gauge/last_error");
        assert!(!last_error.to_lowercase().contains(&text.to_lowercase()), "{last_error}");
    }

    write_keys("authentication = 0123456789ABCDEFFEDCBA9876543211\n");
    auth().failed(&["BAT0: not genuine", "in either byte order"]);
    write_keys(&format!("authentication = {default}\n"));
    fs::write(Path::new(&gauge).join("sim/auth_ms"), "9000").expect("a knob");
    auth().troubled(&["shows no digest"]);
    write_keys("unseal = 8d3e b7c5\n");
    auth().troubled(&[&keys, "has no line `authentication"]);
    gaugefs(&["auth", &at, "--key-file", &folder.file("none")]).troubled(&["cannot read the key file"]);
    write_keys(&format!("authentication = {default}\n"));
    gaugefs(&["auth", &folder.file(""), "--key-file", &keys]).troubled(&["not a mounted gauge"]);

    let last_error = read(&gauge, "gauge/last_error");
    gaugefs(&["umount", &at]).done();
    within("the end is logged", || fs::read_to_string(&log).expect("the log").contains("unmounted"));
    for text in [last_error, fs::read_to_string(&log).expect("it"), fs::read_to_string(&trace).expect("it")] {
        let tight: String = text.to_lowercase().split_whitespace().collect();
        // As a person writes it, and as it is sent on the bus. Parts of a key that other data may contain by
        // chance are left out.
        for key in ["8d3eb7c5", "3e8dc5b7", "aa003e8d", "aa00c5b7", "aa00ffff"] {
            assert!(!tight.contains(key), "{key} in {text}");
        }
        let turned: String =
            default.as_bytes().chunks(2).rev().map(|pair| String::from_utf8_lossy(pair)).collect();
        for key in [default.to_lowercase(), turned.to_lowercase()] {
            assert!(!tight.contains(&key), "the authentication key in {text}");
        }
    }
}

/// Each took the other's digest for its own: up to 42 of 150 said that a genuine pack was not genuine.
#[test]
fn regression_a_genuine_pack_was_not_genuine_for_two_who_asked_at_once() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, keys) = (folder.file("m"), folder.file("keys"));
    fs::write(&keys, "authentication = 0123456789abcdeffedcba9876543210\n").expect("a key file");
    fs::set_permissions(&keys, Permissions::from_mode(0o600)).expect("its mode");
    gaugefs(&["mount", "--sim", CHIP, "--fast", &at]).done();
    let gauge = folder.file("m/BAT0");
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                for _ in 0..5 {
                    let ran = gaugefs(&["auth", &gauge, "--key-file", &keys]);
                    match ran.code {
                        Some(0) => assert_eq!(ran.out, "genuine, byte order lsb-first\n"),
                        // A busy machine may not look in time, each time.
                        code => assert!(
                            code == Some(2) && ran.err.contains("another program"),
                            "{code:?} {}",
                            ran.err
                        ),
                    }
                }
            });
        }
    });
    gaugefs(&["auth", &gauge, "--key-file", &keys]).done();
    gaugefs(&["umount", &at]).done();
}

#[cfg(not(feature = "rescue"))]
#[test]
fn a_build_without_rescue_says_which_has_it() {
    for more in [&[][..], &["--help"], &["x.bq.fs", "--bus", "/dev/i2c-1"]] {
        let line = [&["rescue"], more].concat();
        gaugefs(&line).troubled(&["gaugefs: rescue: this build is without it; the Debian package has it"]);
    }
}

#[cfg(feature = "rescue")]
#[test]
fn rescue_checks_its_file_before_anything_else() {
    let file = crate::room::folder().join(format!("rescue-{}.df.fs", std::process::id()));
    let path = file.to_str().expect("a path in UTF-8");
    let rescue = ["rescue", path, "--bus", "/dev/i2c-none", "--chip", "bq34z100-g1", "--yes"];
    // Data flash alone: its first command erases one page of the firmware.
    fs::write(&file, "W: AA 00 00 0F\nX: 1000\nW: 16 00 03 00 00\nW: 16 64 03 00\nX: 20\nC: 16 66 00\n")
        .expect("a file");
    let Ran { code, err, .. } = gaugefs(&rescue);
    assert_eq!(code, Some(1));
    assert!(err.contains("line 4") && err.contains(".bq.fs") && !err.contains("i2c-none"), "{err}");
    fs::write(&file, "W: 16 00 04 00 00 00 83 DE\nW: 16 64 65 01\nX: 400\nC: 16 66 00\n").expect("a file");
    let Ran { code, err, .. } = gaugefs(&rescue);
    assert_eq!(code, Some(1));
    assert!(err.contains("cut short") && !err.contains("i2c-none"), "{err}");
    // The part is never guessed. Of one whose files are not known nothing is read, neither a file nor a bus.
    assert_eq!(gaugefs(&rescue[..4]).code, Some(2));
    for chip in ["bq27500", "bq27500-v130", "bq27541", "bq27542", "bq27545", "bq27742", "bq28z610", "bq35100"]
    {
        let says =
            ["in ROM mode gaugefs does not bring it back", "TI's tools do", "switch its power off and on"];
        let of_bus = ["rescue", "none.bq.fs", "--bus", "/dev/i2c-none", "--chip", chip];
        gaugefs(&of_bus).failed(&says);
        gaugefs(&["rescue", "none.bq.fs", "--sim", chip]).failed(&says);
    }
    fs::remove_file(&file).expect("it is there");
}
