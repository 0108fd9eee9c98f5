// SPDX-License-Identifier: MIT

//! The life of a mount: how it begins and ends, and what its daemon keeps.

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use crate::room::{
    CHIP, Folder, Foreground, Ran, can_mount, command, gaugefs, in_real_time, read, shown, stop,
    users_can_mount, within,
};

#[test]
fn a_key_file_that_others_may_read_is_refused() {
    let folder = Folder::new();
    let file = folder.file("keys");
    fs::write(&file, "unseal = 1234 zzzz\n").expect("a key file");
    let mount = || gaugefs(&["mount", "--sim", CHIP, "--key-file", &file, &folder.file("m")]);
    fs::set_permissions(&file, Permissions::from_mode(0o640)).expect("its mode");
    mount().failed(&["others may read", "mode 640", "chmod 600"]);
    fs::set_permissions(&file, Permissions::from_mode(0o600)).expect("its mode");
    let bad = mount();
    assert!(!bad.err.contains("zzzz") && !bad.err.contains("1234"), "{}", bad.err);
    bad.failed(&["line 1", "two words"]);
    gaugefs(&["mount", "--sim", CHIP, "--key-file", &folder.file("none"), &folder.file("m")])
        .failed(&["cannot read the key file", "No such file"]);
    assert!(!Path::new(&folder.file("m")).exists(), "a refused mount leaves nothing behind");
}

/// To start a program takes a fifth of a mount, and took a third of an unmount.
#[test]
fn a_mount_starts_one_more_program_and_an_unmount_none() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let starts = |arguments: &[&str]| {
        let starts = Folder::new();
        // The dynamic linker writes a file for each start.
        let mut command = command(arguments);
        command.env("LD_DEBUG", "statistics").env("LD_DEBUG_OUTPUT", starts.file("start"));
        Ran::of(command.output().expect("gaugefs runs")).done();
        fs::read_dir(starts.file("")).expect("its files").count()
    };
    assert_eq!(starts(&["mount", "--sim", CHIP, &at]), 2);
    assert_eq!(starts(&["umount", &at]), 1);
}

/// A script that goes on after it believes that the gauge is sealed.
#[test]
fn a_seal_that_stays_owed_is_a_failure_of_umount_and_of_the_daemon() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let mount = |state: &str, background: bool| {
        let mut mount = command(&["mount", "--sim", CHIP, "--no-backup"]);
        // The first daemon has its gauge for a moment after the unmount.
        let flash = folder.file(&format!("flash of the {state}"));
        mount.args(["--sim-state", &flash, "--state-dir", &folder.file(state), &at]);
        if background {
            Ran::of(mount.output().expect("gaugefs runs")).done();
            return None;
        }
        let log = fs::File::create(folder.file("log")).expect("a log");
        let child =
            mount.arg("--foreground").stdout(Stdio::null()).stderr(log).spawn().expect("gaugefs runs");
        within("mounted", || Path::new(&at).join("BAT0/present").exists());
        Some(child)
    };
    let file = |name: &str| Path::new(&at).join("BAT0").join(name);
    // It is opened for a read, and does not take the commands that would seal it again.
    let left_open = || {
        fs::write(file("sim/drop_seals"), "100000").expect("a knob");
        let read = fs::read(file("df/80/53")).map_err(|error| error.raw_os_error());
        assert_eq!(read, Err(Some(nix::libc::ENOTRECOVERABLE)));
        assert_eq!(fs::read_to_string(file("gauge/owed")).expect("readable"), "1\n");
        // Whoever looks is told.
        let told = [gaugefs(&["list"]).err, gaugefs(&["doctor"]).out].map(|said| {
            said.contains(&format!("{at}/BAT0: ")) && said.contains("restoring the sealed state failed")
        });
        assert_eq!(told, [true, true]);
    };
    let is_journal = |state: &str| {
        let names = fs::read_dir(folder.file(state)).expect("a folder");
        names.flatten().any(|entry| entry.path().extension().is_some_and(|end| end == "journal"))
    };

    let time = in_real_time();
    mount("first", true);
    left_open();
    let ran = gaugefs(&["umount", &at]);
    assert_eq!(ran.code, Some(1), "{}", ran.err);
    assert!(
        ran.err.contains("BAT0: ") && ran.err.contains("restoring the sealed state failed"),
        "{}",
        ran.err
    );
    assert!(ran.err.contains("it is unmounted now"), "{}", ran.err);
    assert!(!gaugefs_client::mounts::is_gaugefs(Path::new(&at)), "it is unmounted all the same");
    assert!(is_journal("first"), "the next start finds it");
    // At once, while the daemon still tries to pay: the next one was refused for some seconds.
    mount("first", true);
    drop(time);
    gaugefs(&["umount", &at]).done();
    assert!(!is_journal("first"), "it has been paid");

    for by_signal in [true, false] {
        let mut daemon = mount("second", false).expect("a child");
        left_open();
        match by_signal {
            true => kill(Pid::from_raw(daemon.id() as i32), Signal::SIGTERM).expect("it runs"),
            false => assert_eq!(gaugefs(&["umount", &at]).code, Some(1)),
        }
        assert_eq!(daemon.wait().expect("a child").code(), Some(1));
        let log = fs::read_to_string(folder.file("log")).expect("a log");
        assert!(log.contains("gaugefs ends, and this is still owed"), "{log}");
        assert!(is_journal("second"));
    }

    // Paid by the next one, which then owes nothing.
    let mut daemon = mount("second", false).expect("a child");
    within("paid", || fs::read_to_string(file("gauge/owed")).is_ok_and(|owed| owed == "0\n"));
    gaugefs(&["umount", &at]).done();
    assert_eq!(daemon.wait().expect("a child").code(), Some(0));
    assert!(!is_journal("second"));
}

#[test]
fn mount_makes_the_folder_and_returns_when_the_gauge_can_be_read() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", CHIP, "--name", "PACK-1", &at]).done();
    assert_eq!(read(&at, "PACK-1/model_name"), "bq34z100-G1");
    assert!(read(&at, "PACK-1/uevent").starts_with("POWER_SUPPLY_NAME=PACK-1\n"));
    gaugefs(&["mount", "--sim", CHIP, &at]).failed(&[&at, "a gaugefs is mounted there", "gaugefs umount"]);
    gaugefs(&["umount", &at]).done();
    gaugefs(&["umount", &at]).failed(&["no gaugefs is mounted there"]);
    within("the folder is removed", || !Path::new(&at).exists());
}

#[test]
fn the_daemon_keeps_no_descriptor_of_the_caller() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    // `output` in `gaugefs` returns only when no process has the pipes open any more. So does `cat` here, with
    // a pipe on a descriptor that the daemon does not know.
    let script = format!("{} mount --sim {CHIP} '{at}' 7>&1 | cat", env!("CARGO_BIN_EXE_gaugefs"));
    let status = Command::new("timeout").args(["10", "sh", "-c", &script]).status().expect("a shell");
    assert!(status.success());
    gaugefs(&["umount", &at]).done();
}

#[test]
fn signals_and_an_unmount_end_the_daemon() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    for signal in [Signal::SIGTERM, Signal::SIGINT] {
        let mut daemon = Foreground::new(&at, &[]);
        daemon.send(signal);
        assert_eq!(daemon.ends(), Some(0));
        assert!(!Path::new(&at).join("BAT0").exists());
    }
    let mut daemon = Foreground::new(&at, &[]);
    gaugefs(&["umount", &at]).done();
    assert_eq!(daemon.ends(), Some(0));
}

#[test]
fn a_mount_in_use_is_not_unmounted_but_a_signal_ends_it() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let mut daemon = Foreground::new(&at, &[]);
    let held = fs::File::open(Path::new(&at).join("BAT0/capacity")).expect("a file");
    let me = format!("process {}", std::process::id());
    gaugefs(&["umount", &at]).failed(&["in use by", &me]);
    daemon.send(Signal::SIGTERM);
    assert_eq!(daemon.ends(), Some(0));
    assert!(!Path::new(&at).join("BAT0").exists());
    drop(held);
}

/// A program's name may be anybody's, and must not control the terminal of whoever unmounts.
#[test]
fn the_name_of_a_user_of_the_mount_is_printed_without_control_characters() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, program) = (folder.file("m"), folder.file("a\x1b[31m\nb"));
    fs::copy("/bin/sleep", &program).expect("a program");
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    let mut user = Command::new(&program).arg("60").current_dir(&at).spawn().expect("it runs");
    let ran = gaugefs(&["umount", &at]);
    user.kill().and_then(|()| user.wait()).expect("it ends");
    ran.failed(&["in use by process", r"(a\u{1b}[31m\nb)"]);
    gaugefs(&["umount", &at]).done();
}

#[test]
fn the_mount_of_a_killed_daemon_is_removed() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let mut daemon = Foreground::new(&at, &[]);
    assert_eq!(read(&at, "BAT0/present"), "1");
    daemon.send(Signal::SIGKILL);
    daemon.ends();
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    assert_eq!(read(&at, "BAT0/present"), "1");
    gaugefs(&["umount", &at]).done();

    let mut daemon = Foreground::new(&at, &[]);
    daemon.send(Signal::SIGKILL);
    daemon.ends();
    gaugefs(&["umount", &at]).done();
    gaugefs(&["umount", &at]).failed(&["no gaugefs is mounted there"]);
}

/// A daemon whose mount was removed must not unmount the path again when it ends.
#[test]
fn regression_an_ending_daemon_does_not_unmount_the_next_mount() {
    if !users_can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let mut first = Foreground::new(&at, &[]);
    stop(first.0.id(), &at);
    // Not with gaugefs, which would abort the connection of a daemon that does not answer. Another test's look at all mounts
    // may wait in this one.
    let unmounted = Command::new("fusermount3").args(["-uz", &at]).status().expect("fusermount3 runs");
    assert!(unmounted.success());
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    first.send(Signal::SIGCONT);
    assert_eq!(first.ends(), Some(0));
    assert_eq!(read(&at, "BAT0/present"), "1");
    gaugefs(&["umount", &at]).done();
}

#[test]
fn a_mains_supply_follows_the_gauge() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let sim = |knob: &str, value: &str| {
        fs::write(Path::new(&at).join("BAT0/sim").join(knob), value).expect("a knob");
    };
    let text = |name: &str| fs::read_to_string(Path::new(&at).join("AC").join(name)).unwrap_or_default();
    let shows = |online: &str| {
        within("AC/online", || text("online") == online);
        let line = if online.is_empty() { String::new() } else { format!("POWER_SUPPLY_ONLINE={online}") };
        let uevent = format!("POWER_SUPPLY_NAME=AC\nPOWER_SUPPLY_TYPE=Mains\n{line}");
        within("AC/uevent", || text("uevent") == uevent);
        let all = ["online", "subsystem", "type", "uevent"];
        within("the list of AC", || {
            let listed = fs::read_dir(Path::new(&at).join("AC")).expect("a folder");
            let mut listed: Vec<_> = listed.map(|entry| entry.expect("an entry").file_name()).collect();
            listed.sort();
            listed == all[usize::from(online.is_empty())..]
        });
    };
    let _daemon = Foreground::new(&at, &["--ac", "--poll", "0.5"]);
    assert_eq!(text("type"), "Mains\n");
    assert!(fs::read_link(Path::new(&at).join("AC/subsystem")).expect("a link").ends_with("power_supply"));
    shows("1\n");
    sim("load_ma", "500");
    shows("0\n");
    sim("load_ma", "-800");
    shows("1\n");
    sim("power", "off");
    shows("");
    sim("power", "on");
    shows("1\n");
    gaugefs(&["umount", &at]).done();
    gaugefs(&["mount", "--sim", CHIP, "--name", "AC", "--ac", &at]).failed(&["AC", "--name", "--ac"]);
    gaugefs(&["mount", "--sim", "bq35100", "--ac=ADP1", &at]).done();
    // A primary cell says nothing about the mains.
    assert_eq!(read(&at, "ADP1/uevent"), "POWER_SUPPLY_NAME=ADP1\nPOWER_SUPPLY_TYPE=Mains");
    gaugefs(&["umount", &at]).done();
}

#[test]
fn a_state_file_has_one_daemon_and_outlives_it() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, other, state) = (folder.file("m"), folder.file("n"), folder.file("state"));
    let journal = folder.file("journal");
    let daemon = Foreground::new(&at, &["--sim-state", &state, "--state-dir", &journal]);
    fs::write(Path::new(&at).join("BAT0/df/48/11"), "3400\n").expect("a write");
    let who = format!("process {}", daemon.0.id());
    gaugefs(&["mount", "--sim", CHIP, "--sim-state", &state, &other]).failed(&[
        "in use by process",
        &who,
        &at,
    ]);
    gaugefs(&["umount", &at]).done();
    // The first daemon may still be ending; the second waits for that.
    gaugefs(&["mount", "--sim", CHIP, "--sim-state", &state, &other]).done();
    assert_eq!(read(&other, "BAT0/df/48/11"), "3400");
}

/// The gauge stores a scale, which applies after the reset that the write ends with.
#[test]
fn a_scale_that_may_be_given_twice_is_warned_of_at_the_mount() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, state) = (folder.file("m"), folder.file("gauge"));
    let r2 = ["mount", "--sim", "bq34z100-r2", "--sim-state", &state];
    gaugefs(&[&r2[..], &["--allow-unproven", "--current-scale", "10", &at]].concat()).done();
    assert_eq!(read(&at, "BAT0/gauge/current_scale"), "10");
    fs::write(Path::new(&at).join("BAT0/df/48/31"), "10\n").expect("a write");
    fs::write(Path::new(&at).join("BAT0/gauge/refresh"), "1\n").expect("a poll");
    assert_eq!(read(&at, "BAT0/gauge/current_scale"), "100");
    gaugefs(&["umount", &at]).done();

    let ran = gaugefs(&[&r2[..], &["--current-scale", "10", "--voltage-scale", "2", &at]].concat());
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert_eq!(ran.err.lines().count(), 1, "{}", ran.err);
    assert!(
        ran.err.starts_with("gaugefs: warning: BAT0: the gauge reports a scale of 10, and current-scale 10")
    );
    assert_eq!(read(&at, "BAT0/gauge/current_scale"), "100");
    assert_eq!(read(&at, "BAT0/gauge/voltage_scale"), "2");
}

#[test]
fn log_and_trace_are_written() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, log, trace) = (folder.file("m"), folder.file("log"), folder.file("trace"));
    gaugefs(&["mount", "--sim", CHIP, "--log", &log, "--trace", &trace, &at]).done();
    read(&at, "BAT0/df/48/11");
    gaugefs(&["umount", &at]).done();
    let text = || fs::read_to_string(&log).expect("the log");
    within("the end is logged", || text().contains("unmounted"));
    assert!(
        text().contains(&format!("Z bq34z100-G1 (simulated gauge) mounted at {at}/BAT0\n")),
        "{}",
        text()
    );
    let trace = fs::read_to_string(&trace).expect("the trace");
    assert!(trace.contains("\nW: AA 00 01 00\n"), "{trace}");
    assert_eq!(trace.matches("\n; hidden\n").count() + trace.matches("; hidden\n; hidden\n").count(), 2);
    assert!(!trace.contains("W: AA 00 14 04"), "a key word is in the trace");
}

#[test]
fn the_byte_order_is_chosen_with_the_mount() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, keys) = (folder.file("m"), folder.file("keys"));
    fs::write(&keys, "authentication = 0123456789abcdeffedcba9876543210\n").expect("a key file");
    fs::set_permissions(&keys, Permissions::from_mode(0o600)).expect("its mode");
    gaugefs(&["mount", "--sim", CHIP, "--auth-order", "as-sent", &at]).done();
    let auth = gaugefs(&["auth", &folder.file("m/BAT0"), "--key-file", &keys]).done();
    assert!(auth.contains("genuine, byte order lsb-first; it is mounted with as-sent"), "{auth}");
    fs::write(Path::new(&at).join("BAT0/sim/auth_order"), "as-sent").expect("a knob");
    let auth = gaugefs(&["auth", &folder.file("m/BAT0"), "--key-file", &keys]).done();
    assert_eq!(auth, "genuine, byte order as-sent\n");
    gaugefs(&["umount", &at]).done();
}

#[test]
fn a_recorded_gauge_can_be_mounted() {
    if !can_mount() {
        return;
    }
    let parts = [("bq34z100-g1", "df/48/11"), ("bq27441-g1", "df/82/10"), ("bq34110", "df/flash/0x41f5")];
    for (chip, parameter) in parts {
        let folder = Folder::new();
        let (at, trace) = (folder.file("m"), folder.file("trace"));
        let gauge = format!("{at}/BAT0");
        let number = |name: &str| read(&gauge, name).parse::<i64>().expect("a number");
        let sim = ["mount", "--sim", chip, "--sim-seal", "sealed"];
        gaugefs(&[&sim[..], &["--poll", "0.5", "--trace", &trace, &at]].concat()).done();
        let first = read(&gauge, "current_now");
        let value = read(&gauge, parameter);
        fs::write(Path::new(&gauge).join("sim/load_ma"), "700").expect("a knob");
        within("the load is seen", || {
            let current = fs::read_to_string(Path::new(&gauge).join("current_now"));
            // Values that are late are not there.
            current.is_ok_and(|current| current.trim() != first)
        });
        // From now on all polls are equal.
        fs::write(Path::new(&gauge).join("sim/speed"), "0").expect("a knob");
        let polls = number("gauge/statistics/polls") + 2;
        within("two polls", || number("gauge/statistics/polls") >= polls);
        let recorded = shown(&gauge);
        gaugefs(&["umount", &at]).done();

        gaugefs(&["mount", "--replay", &trace, "--poll", "0.5", &at]).done();
        assert_eq!(read(&gauge, "current_now"), first, "{chip} begins as the recording");
        assert!(!Path::new(&gauge).join("sim").exists());
        for file in ["gauge/refresh", "gauge/seal", parameter] {
            let refused = fs::File::options().write(true).open(Path::new(&gauge).join(file));
            let error = refused.expect_err("it is read-only").raw_os_error();
            assert_eq!(error, Some(nix::libc::EROFS), "{chip}: {file}");
        }
        assert_eq!(read(&gauge, parameter), value, "{chip}");
        within("all polls", || shown(&gauge) == recorded);
        assert_eq!(read(&gauge, "gauge/last_error"), "", "{chip}");
        // A value that was not recorded cannot be read, and the failure changes nothing else.
        fs::read(Path::new(&gauge).join("df/index")).expect_err("most of data flash was not recorded");
        assert_eq!(read(&gauge, "gauge/seal"), "sealed", "{chip}");
        // The values were not polled while that took its time.
        within("it stays as it ended", || shown(&gauge) == recorded);
        gaugefs(&["umount", &at]).done();
    }
}

#[test]
fn a_file_that_is_not_a_recording_is_refused() {
    let folder = Folder::new();
    let (at, file) = (folder.file("m"), folder.file("trace"));
    let replay = || gaugefs(&["mount", "--replay", &file, &at]);
    replay().failed(&["trace: cannot read it"]);
    fs::write(&file, "W: AA 00 01 00\n").expect("a file");
    replay().failed(&["line 1", "only a file that --trace or `gaugefs report` wrote"]);
    fs::write(&file, "; gaugefs: bq99 on a bus, now\n").expect("a file");
    replay().failed(&["unknown chip `bq99`"]);
    fs::write(&file, "; gaugefs: bq27441-g1 on a bus, now\nR: AA 02 2\n; 0.1 -> 01 0B\n").expect("a file");
    replay().failed(&["recording too short"]);
    assert!(!Path::new(&at).exists());
}

#[test]
fn a_write_of_a_killed_daemon_is_settled_by_the_next() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, state, journal) = (folder.file("m"), folder.file("state"), folder.file("journal"));
    let kept = ["--sim-state", &state, "--state-dir", &journal];
    let _time = in_real_time();
    let files = || {
        let files = fs::read_dir(&journal).into_iter().flatten().flatten().map(|entry| entry.path());
        files.filter(|path| path.extension().is_some_and(|extension| extension == "journal"))
    };
    let planned = |path: PathBuf| fs::read_to_string(path).is_ok_and(|text| text.contains("\nend "));
    // A busy machine may let it end first.
    let is_half_way = |value: &'static str| {
        let mut daemon = Foreground::new(&at, &kept);
        let parameter = Path::new(&at).join("BAT0/df/80/53");
        let write = std::thread::spawn(move || fs::write(parameter, value));
        within("planned", || files().any(planned) || write.is_finished());
        for mode in files().filter_map(|path| fs::metadata(path).ok()).map(|file| file.permissions().mode()) {
            assert_eq!(mode & 0o777, 0o600);
        }
        daemon.send(Signal::SIGKILL);
        daemon.ends();
        let is_half_way = files().any(planned);
        let written = write.join().expect("the thread ends");
        assert!(!is_half_way || written.is_err(), "the daemon was killed");
        // Otherwise the kernel's cache of the dead mount would be taken for the next one.
        gaugefs(&["umount", &at]).done();
        is_half_way
    };
    assert!(["3100", "3000"].into_iter().cycle().take(20).any(is_half_way));
    let log = folder.file("log");
    let _daemon = Foreground::new(&at, &[&kept[..], &["--log", &log]].concat());
    let last_error = read(&at, "BAT0/gauge/last_error");
    assert!(last_error.contains("the write of Cell Terminate Voltage was interrupted"), "{last_error}");
    let log = fs::read_to_string(log).expect("the log");
    assert!(log.contains("the write of Cell Terminate Voltage was interrupted"), "{log}");
    let left: Vec<_> = files().filter(|path| path.extension().is_some_and(|end| end == "journal")).collect();
    assert!(left.is_empty(), "{left:?}");
    assert!(["3000", "3100"].contains(&&*read(&at, "BAT0/df/80/53")));
    assert_eq!(read(&at, "BAT0/gauge/seal"), "sealed");
    fs::write(Path::new(&at).join("BAT0/df/80/53"), "3200\n").expect("writes work again");
    gaugefs(&["umount", &at]).done();
}

/// The file is what an export before the write would have been.
#[test]
fn the_first_write_leaves_a_backup_of_what_was_there() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, state, journal) = (folder.file("m"), folder.file("state"), folder.file("journal"));
    let log = folder.file("log");
    let kept = ["--sim-state", &state, "--state-dir", &journal, "--log", &log];
    let backups = || -> Vec<_> {
        let files = fs::read_dir(&journal).into_iter().flatten().flatten().map(|entry| entry.path());
        files.filter(|path| path.to_string_lossy().ends_with(".backup.toml")).collect()
    };
    let daemon = Foreground::new(&at, &[&kept[..], &["--no-backup"]].concat());
    let gauge = format!("{at}/BAT0");
    fs::write(format!("{gauge}/df/48/11"), "3400\n").expect("a write");
    assert_eq!(backups(), [""; 0].map(std::path::PathBuf::from));
    gaugefs(&["umount", &at]).done();
    drop(daemon);
    let daemon = Foreground::new(&at, &kept);
    let exported = gaugefs(&["export", &gauge]).done();
    fs::write(format!("{gauge}/df/48/11"), "3500\n").expect("a write");
    let [backup] = &backups()[..] else { panic!("{:?}", backups()) };
    let saved = fs::read_to_string(backup).expect("a file");
    let (host, image) = saved.split_once('\n').expect("a line");
    assert!(host.starts_with("# host ") && image == exported, "{saved}");
    assert_eq!(fs::metadata(backup).expect("a file").permissions().mode() & 0o777, 0o600);
    let log = fs::read_to_string(&log).expect("the log");
    assert!(log.contains(&format!("configuration saved in {}", backup.display())), "{log}");
    assert!(
        log.contains("Z serial 0x0001: Design Capacity: 3400 -> 3500 mAh, written and verified\n"),
        "{log}"
    );
    // It can be applied again.
    let file = backup.display().to_string();
    gaugefs(&["import", &gauge, &file]).done();
    assert_eq!(read(&at, "BAT0/df/48/11"), "3400");
    gaugefs(&["umount", &at]).done();
    drop(daemon);
}

#[test]
fn without_space_for_the_journal_nothing_is_written() {
    use nix::mount::{MsFlags, mount, umount};

    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, journal) = (folder.file("m"), folder.file("journal"));
    fs::create_dir(&journal).expect("a folder");
    let options = Some("size=4k,mode=755");
    if let Err(errno) = mount(Some("full"), &*journal, Some("tmpfs"), MsFlags::empty(), options) {
        eprintln!("SKIPPED: no small file system can be mounted here ({errno}); a full disk was not tested");
        return;
    }
    let full = fs::write(Path::new(&journal).join("filler"), [0; 4096]);
    let daemon = Foreground::new(&at, &["--state-dir", &journal]);
    let parameter = Path::new(&at).join("BAT0/df/80/53");
    let commits = || read(&at, "BAT0/gauge/statistics/flash_writes");
    let refused = fs::write(&parameter, "3100\n").map_err(|error| error.raw_os_error());
    let last_error = read(&at, "BAT0/gauge/last_error");
    let flags = MsFlags::MS_REMOUNT | MsFlags::MS_RDONLY;
    let remounted = mount(None::<&str>, &*journal, None::<&str>, flags, None::<&str>);
    let read_only = fs::write(&parameter, "3100\n").map_err(|error| error.raw_os_error());
    let (written, value) = (commits(), read(&at, "BAT0/df/80/53"));
    drop(daemon);
    let ended = gaugefs(&["umount", &at]);
    umount(&*journal).expect("it is unmounted");
    full.and(remounted.map_err(Into::into)).expect("the disk is full, then read-only");
    assert_eq!(refused, Err(Some(nix::libc::ENOSPC)), "{last_error}");
    assert!(last_error.contains(&journal) && last_error.contains("--state-dir"), "{last_error}");
    assert_eq!(read_only, Err(Some(nix::libc::EROFS)));
    assert_eq!((&*written, &*value), ("0", "3000"));
    ended.done();
}
