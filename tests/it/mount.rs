// SPDX-License-Identifier: MIT

//! A real FUSE mount, used with the file operations of a shell.

use std::fs::{self, OpenOptions};
use std::io::{ErrorKind, Read, Seek, SeekFrom, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use gauge_bus::{Bus, BusError};
use gauge_owner::Run;
use gauge_sim::Sim;
use gaugefs::fuse::{self};
use nix::errno::Errno;
use ti_gauge::chip::Chip;
use ti_gauge::image::Image;
use ti_gauge::keys::Keys;

use crate::room::{LONG, Mount, errno, quiet, statistic};

/// Waits for the effect of a poll and a notification.
fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let start = Instant::now();
    while !holds() {
        assert!(start.elapsed() < LONG, "{what} does not come");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn walk(folder: &Path, seen: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let entry = entry.expect("an entry");
        let kind = entry.file_type().expect("d_type is there");
        seen.push(entry.path());
        let status = fs::symlink_metadata(entry.path()).expect("what is listed is there");
        assert_eq!(status.file_type(), kind, "{}", entry.path().display());
        if kind.is_dir() {
            walk(&entry.path(), seen);
        }
    }
}

#[test]
fn attributes_match_those_of_the_kernel() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    assert_eq!(mount.cat("type"), "Battery");
    assert_eq!(mount.cat("present"), "1");
    assert_eq!(mount.cat("scope"), "System");
    assert_eq!(mount.cat("manufacturer"), "Texas Instruments");
    assert_eq!(mount.cat("model_name"), "bq34z100-G1");
    assert_eq!(mount.cat("charge_full_design"), "1000000");
    let voltage: i64 = mount.cat("voltage_now").parse().expect("a number");
    assert!((2_500_000..4_500_000).contains(&voltage), "{voltage} µV");
    let temp: i64 = mount.cat("temp").parse().expect("a number");
    assert!((200..300).contains(&temp), "{temp} tenths of a degree");
    // At rest there is no time to empty, neither as a file nor in uevent.
    assert!(!mount.path("time_to_empty_now").exists());
    assert!(!mount.path("energy_now").exists());
    let uevent = mount.cat("uevent");
    assert!(uevent.starts_with("POWER_SUPPLY_NAME=BAT0\nPOWER_SUPPLY_TYPE=Battery\n"), "{uevent}");
    for line in uevent.lines() {
        let (key, value) = line.split_once('=').expect("a line of uevent");
        let name = key.strip_prefix("POWER_SUPPLY_").expect("a line of uevent").to_lowercase();
        if name != "name" {
            assert_eq!(mount.cat(&name), value, "{name}");
        }
    }
    let link = fs::read_link(mount.path("subsystem")).expect("a link");
    assert!(link.ends_with("power_supply"));
    assert_eq!(fs::metadata(mount.path("capacity")).expect("there").permissions().mode() & 0o777, 0o444);
    assert_eq!(fs::metadata(mount.path("uevent")).expect("there").size() as usize, uevent.len() + 1);
}

#[test]
fn listing_everything_costs_no_transfer() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let before = mount.transfers();
    let mut seen = Vec::new();
    walk(&mount.folder, &mut seen);
    assert!(seen.len() > 500, "{} names", seen.len());
    for path in seen.iter().filter(|path| !path.starts_with(mount.path("df"))) {
        let kind = fs::symlink_metadata(path).expect("there").file_type();
        if kind.is_file() && fs::metadata(path).expect("there").permissions().mode() & 0o400 != 0 {
            fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        }
    }
    assert_eq!(mount.transfers(), before);
}

#[test]
fn data_flash_reads_and_writes() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    assert_eq!(fs::metadata(mount.path("df/80/53")).expect("there").size(), 4096);
    assert_eq!(mount.cat("df/80/53"), "3000");
    assert_eq!(fs::metadata(mount.path("df/80/53")).expect("there").size(), 5);
    assert_eq!(mount.cat("df/by-name/it-cfg/cell-terminate-voltage"), "3000");
    assert_eq!(mount.cat("df/48/43"), "Texas Inst.");
    assert_eq!(mount.cat("df/64/0"), "0x0161");
    assert_eq!(mount.cat("df/104/0"), "0.4768");
    assert_eq!(fs::read(mount.path("df/80/raw")).expect("bytes").len(), 96, "its blocks, whole");
    assert_eq!(mount.echo("3100", "df/80/53"), Ok(()));
    assert_eq!(mount.cat("df/80/53"), "3100");
    assert_eq!(mount.echo("  0xc80 ", "df/80/53"), Ok(()));
    assert_eq!(mount.cat("df/80/53"), "3200", "the value, not the text that was written");
    assert_eq!(mount.cat("gauge/seal"), "sealed");
    assert_eq!(mount.cat("gauge/last_error"), "");
    // A register that is a copy of data flash is updated soon, even with a long poll interval.
    assert_eq!(mount.echo("2000", "df/48/11"), Ok(()));
    until("the new design capacity", || mount.shows("charge_full_design", "2000000"));
}

/// The text of a string is what a write of the same string takes, whatever its bytes are.
#[test]
fn a_string_is_written_back_as_it_was_read() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let stored = || fs::read(mount.path("df/48/raw")).expect("bytes")[31..43].to_vec();
    let in_index = || {
        let index = mount.cat("df/index");
        let line = index.lines().find(|line| line.starts_with("48\t31\t")).expect("a line of its own");
        line.rsplit_once('\t').expect("fields").1.to_string()
    };
    for (written, shown, bytes) in [
        ("AT&T (4S)", "AT%26T %284S%29", &b"\x09AT&T (4S)\0\0"[..]),
        ("%00%ff%0a%09%1b", "%00%ff%0a%09%1b", b"\x05\0\xff\n\t\x1b\0\0\0\0\0\0"),
        ("%20 %20", "%20 %20", b"\x03   \0\0\0\0\0\0\0\0"),
        ("'%2541\"", "%27%2541%22", b"\x05'%41\"\0\0\0\0\0\0"),
        ("12345678901", "12345678901", b"\x0b12345678901"),
        ("-", "-", b"\x01-\0\0\0\0\0\0\0\0\0\0"),
        ("", "", b"\0\0\0\0\0\0\0\0\0\0\0\0"),
    ] {
        assert_eq!(mount.echo("other", "df/48/31"), Ok(()));
        assert_eq!(mount.echo(written, "df/48/31"), Ok(()), "{written}");
        assert_eq!((mount.cat("df/48/31").as_str(), stored().as_slice()), (shown, bytes));
        assert_eq!(in_index(), if shown == "-" { "%2d" } else { shown });
        let programmed = mount.sim.get("programmed");
        assert_eq!(mount.echo(shown, "df/48/31"), Ok(()), "{shown}");
        assert_eq!(mount.sim.get("programmed"), programmed, "{shown}: the same value is not written again");
        assert_eq!(mount.echo("other", "df/48/31"), Ok(()));
        assert_eq!(mount.echo(&format!("begin\n48/31 {shown}\ncommit"), "df/transaction"), Ok(()));
        assert_eq!(stored(), bytes, "{shown}");
    }
    for refused in ["caf\u{e9}", "a\tb", "123456789012"] {
        assert_eq!(mount.echo(refused, "df/48/31"), Err(Errno::EINVAL), "{refused}");
    }
    // A length that is larger than the field counts as the field's.
    let junk = b"\xffLION\x01\x02\x03AT&T";
    mount.sim.set_flash(48, 31, &junk[..12]);
    assert_eq!(mount.echo("1", "gauge/refresh"), Ok(()));
    let shown = mount.cat("df/48/31");
    assert_eq!(shown, "LION%01%02%03AT%26T");
    assert_eq!(mount.echo(&shown, "df/48/31"), Ok(()));
    assert_eq!(stored(), junk[..12]);
}

#[test]
fn refused_writes_return_their_errno_and_change_nothing() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let before = mount.sim.flash();
    let transfers = mount.transfers();
    assert_eq!(mount.echo("abc", "df/80/53"), Err(Errno::EINVAL));
    assert_eq!(mount.echo("", "df/80/53"), Err(Errno::EINVAL));
    assert_eq!(mount.echo("3701", "df/80/53"), Err(Errno::ERANGE));
    assert!(mount.cat("gauge/last_error").contains("the value is outside 1000 to 3700 mV"));
    assert_eq!(mount.echo("0x0", "df/112/0"), Err(Errno::EPERM));
    assert_eq!(fs::read(mount.path("df/112/0")).map_err(errno), Err(Errno::EPERM));
    assert_eq!(mount.echo("0x0f00", "gauge/control"), Err(Errno::EINVAL));
    assert_eq!(mount.echo("RESET", "gauge/control"), Err(Errno::EINVAL));
    assert_eq!(mount.echo("0", "gauge/poll_interval"), Err(Errno::ERANGE));
    assert_eq!(mount.echo("soon", "gauge/poll_interval"), Err(Errno::EINVAL));
    assert_eq!(mount.transfers(), transfers, "nothing was sent");
    // Truncation alone writes nothing, and a write at an offset is refused.
    OpenOptions::new().write(true).truncate(true).open(mount.path("df/80/53")).expect("opens");
    assert_eq!(mount.cat("df/80/53"), "3000");
    let mut file = OpenOptions::new().write(true).open(mount.path("df/80/53")).expect("opens");
    file.seek(SeekFrom::Start(1)).expect("seeks");
    assert_eq!(file.write(b"3100").map_err(errno), Err(Errno::EINVAL));
    drop(file);
    assert!(mount.sim.flash() == before);
    // `>>` acts as `>`.
    let mut file = OpenOptions::new().append(true).open(mount.path("df/80/53")).expect("opens");
    file.write_all(b"3300\n").expect("written");
    drop(file);
    assert_eq!(mount.cat("df/80/53"), "3300");
    assert_eq!(fs::create_dir(mount.path("mine")).map_err(errno), Err(Errno::EPERM));
    assert_eq!(fs::remove_file(mount.path("capacity")).map_err(errno), Err(Errno::EPERM));
    assert_eq!(fs::File::create(mount.path("mine")).map(|_| ()).map_err(errno), Err(Errno::ENOENT));
    for (typo, meant) in [
        ("df/80/54", "80/53 (Cell Terminate Voltage)"),
        ("df/by-name/it-cfg/cell-terminate-voltag", "80/53 (Cell Terminate Voltage)"),
    ] {
        // As a shell does for `>`.
        assert_eq!(fs::write(mount.path(typo), "3100\n").map_err(errno), Err(Errno::ENOENT), "{typo}");
        let error = mount.cat("gauge/last_error");
        assert!(error.contains(&format!("no such parameter; did you mean {meant}?")), "{error}");
    }
    assert_eq!(fs::write(mount.path("df/999"), "3100\n").map_err(errno), Err(Errno::ENOENT));
    assert_eq!(fs::rename(mount.path("temp"), mount.path("mine")).map_err(errno), Err(Errno::EPERM));
    assert_eq!(fs::hard_link(mount.path("temp"), mount.path("mine")).map_err(errno), Err(Errno::EPERM));
}

#[test]
fn writes_below_the_flash_voltage_are_refused() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    mount.sim.set("voltage_mv", "2700").expect("a knob");
    let before = mount.sim.flash();
    assert_eq!(mount.echo("3100", "df/80/53"), Err(Errno::EAGAIN));
    assert!(mount.cat("gauge/last_error").contains("2700 mV"));
    let facts: serde_json::Value =
        serde_json::from_str(&mount.cat("gauge/last_error_facts")).expect("one object");
    assert_eq!((&facts["errno"], &facts["reason"]), (&"EAGAIN".into(), &"flash-voltage".into()));
    assert_eq!((&facts["value"], &facts["least"]), (&2700.into(), &2800.into()));
    assert!(mount.sim.flash() == before);
}

#[test]
fn without_keys_a_sealed_gauge_shows_everything_but_data_flash() {
    let keys = Keys::none();
    let Some(mount) = Mount::new("bq34z100-g1", Duration::from_secs(3600), keys) else { return };
    let before = mount.sim.flash();
    assert_eq!(fs::read(mount.path("df/80/53")).map_err(errno), Err(Errno::EPERM));
    assert_eq!(mount.echo("3100", "df/80/53"), Err(Errno::EPERM));
    assert_eq!(mount.cat("gauge/seal"), "sealed");
    assert!(mount.cat("capacity").parse::<u32>().is_ok());
    let index = mount.cat("df/index");
    assert!(
        index
            .lines()
            .any(|line| line.starts_with("80\t53\tI2\tCell Terminate Voltage\tmV\t1000\t3700\t3000"))
    );
    assert_eq!(index.lines().count(), 212);
    assert!(mount.sim.flash() == before);
}

#[test]
fn the_index_lists_every_value() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let index = mount.cat("df/index");
    let mut lines = index.lines();
    assert_eq!(lines.next(), Some("subclass\toffset\ttype\tname\tunit\tmin\tmax\tdefault\tflags\tvalue"));
    for line in lines {
        let fields: Vec<_> = line.split('\t').collect();
        assert_eq!(fields.len(), 10, "{line}");
        let path = format!("df/{}/{}", fields[0], fields[1]);
        if fields[8].contains("security") {
            assert_eq!(fields[5..8], ["-"; 3], "{line}");
            assert_eq!(fields[9], "-", "{line}");
        } else {
            assert_eq!(mount.cat(&path), fields[9], "{line}");
        }
    }
}

#[test]
fn seal_and_control() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    assert_eq!(mount.echo("unsealed", "gauge/seal"), Ok(()));
    assert_eq!(mount.cat("gauge/seal"), "unsealed");
    assert_eq!(mount.echo("3100", "df/80/53"), Ok(()));
    assert_eq!(mount.cat("gauge/seal"), "unsealed", "left as it was found");
    assert_eq!(mount.echo("full-access", "gauge/seal"), Ok(()));
    assert_eq!(mount.cat("gauge/seal"), "full-access");
    assert_eq!(mount.echo("sealed", "gauge/seal"), Ok(()));
    assert_eq!(mount.cat("gauge/seal"), "sealed");
    assert_eq!(mount.echo("open", "gauge/seal"), Err(Errno::EINVAL));
    assert_eq!(mount.echo("CHEM_ID", "gauge/control"), Ok(()));
    assert_eq!(mount.cat("gauge/device_type"), "0x0100");
    assert_eq!(mount.cat("gauge/chem_id"), "0x0107");
}

#[test]
fn extended_attributes_describe_a_parameter() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let output = std::process::Command::new("getfattr").arg("-d").arg(mount.path("df/80/53")).output();
    let Ok(output) = output else {
        eprintln!("SKIPPED: getfattr is missing");
        return;
    };
    let text = String::from_utf8(output.stdout).expect("text");
    for line in [
        "user.gauge.name=\"Cell Terminate Voltage\"",
        "user.gauge.type=\"I2\"",
        "user.gauge.unit=\"mV\"",
        "user.gauge.min=\"1000\"",
        "user.gauge.max=\"3700\"",
        "user.gauge.default=\"3000\"",
    ] {
        assert!(text.contains(line), "{line} in {text}");
    }
}

/// Monitors keep files open and read them again at offset 0.
#[test]
fn an_open_file_shows_new_values() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let file = fs::File::open(mount.path("current_now")).expect("opens");
    let before = file.metadata().and_then(|file| file.modified()).expect("a time");
    let read = || {
        let mut buffer = [0; 64];
        let length = file.read_at(&mut buffer, 0)?;
        Ok::<_, std::io::Error>(String::from_utf8_lossy(&buffer[..length]).trim().to_string())
    };
    assert_eq!(read().expect("reads"), "0");
    mount.sim.set("load_ma", "500").expect("a knob");
    std::thread::sleep(Duration::from_millis(1500));
    assert_eq!(mount.echo("1", "gauge/refresh"), Ok(()));
    let fresh = mount.cat("current_now");
    assert_ne!(fresh, "0");
    // The modification time of a file is that of its value.
    let since = fs::metadata(mount.path("current_now")).and_then(|file| file.modified()).expect("a time");
    assert!(since > before);
    until("the new current", || read().is_ok_and(|text| mount.shows("current_now", &text)));
}

/// The kernel copies what is written to the page that readers share before gaugefs knows of it. A reader waits until
/// the write is answered; it used to read a value that then was not stored.
#[test]
fn regression_an_open_file_does_not_show_a_write_under_way() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let file = fs::File::open(mount.path("df/80/53")).expect("opens");
    let read = || {
        let mut buffer = [0; 64];
        let length = file.read_at(&mut buffer, 0).expect("reads");
        String::from_utf8_lossy(&buffer[..length]).into_owned()
    };
    assert_eq!(read(), "3000\n");
    mount.sim.set("fault", "corrupt-commit").expect("a fault");
    // Without O_TRUNC, which makes the kernel drop the page.
    let mut written = OpenOptions::new().write(true).open(mount.path("df/80/53")).expect("opens");
    std::thread::scope(|scope| {
        let write = scope.spawn(move || written.write_all(b"3100\n").map_err(errno));
        until("the write begins", || mount.cat("df/transaction") != "idle" || write.is_finished());
        while !write.is_finished() {
            assert_eq!(read(), "3000\n");
        }
        assert_eq!(write.join().expect("no panic"), Err(Errno::EIO));
    });
    assert_eq!(read(), "3000\n");
}

/// The kernel may keep a file's attributes for as long as it is notified, and an open file is to follow nevertheless.
#[test]
fn an_open_file_follows_although_nobody_asks_for_its_attributes() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let mut open = fs::File::open(mount.path("voltage_now")).expect("it opens");
    let opened = Instant::now();
    let mut read = || {
        let mut text = String::new();
        open.rewind().and_then(|()| open.read_to_string(&mut text)).expect("it has a value");
        text
    };
    let before = read();
    mount.sim.set("voltage_mv", "3456").expect("a knob");
    assert_eq!(mount.echo("1", "gauge/refresh"), Ok(()));
    until("the new voltage", || read() == "3456000\n");
    // For a minute the kernel would ask for nothing.
    assert!(before != "3456000\n" && opened.elapsed() < Duration::from_secs(60));
}

/// What a refresh has changed is seen as soon as the write to `gauge/refresh` returns, whether the kernel can keep
/// names or not. A folder that is open meanwhile stays where it is.
#[test]
fn a_refresh_is_seen_at_once() {
    for names_not_kept in [false, true] {
        let run = Run { interval: Duration::from_secs(3600), ..Run::default() };
        let options = fuse::Options { names_not_kept, ..fuse::Options::default() };
        let mount = Mount::of("bq34z100-g1", run, |_| {}, |sim| Box::new(sim.bus()), options);
        let Some(mount) = mount else { return };
        let held = fs::File::open(mount.path("")).expect("opens");
        let path = format!("/proc/self/fd/{}", held.as_raw_fd());
        let listed = |folder: &Path| {
            let mut names =
                fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").file_name());
            names.any(|name| name == "time_to_empty_now")
        };
        mount.sim.set("speed", "30").expect("a knob");
        for (load, flows) in [("500", true), ("0", false), ("600", true), ("0", false)] {
            mount.sim.set("load_ma", load).expect("a knob");
            let flowing = |current: &str| (current != "0") == flows;
            until("a poll that finds the load", || {
                assert_eq!(mount.echo("1", "gauge/refresh"), Ok(()));
                let (current, uevent) = (mount.cat("current_now"), mount.cat("uevent"));
                assert!(uevent.contains(&format!("CURRENT_NOW={current}\n")), "{current} in {uevent}");
                let shown = uevent.contains("TIME_TO_EMPTY_NOW=");
                assert_eq!(mount.path("time_to_empty_now").exists(), shown);
                assert_eq!(listed(&mount.path("")), shown);
                assert_eq!(listed(Path::new(&path)), shown);
                flowing(&current) && shown == flows
            });
        }
        assert_eq!(fs::read_link(&path).expect("it is open"), mount.path(""));
    }
}

/// The file of a value, and its line in uevent, exist only while the gauge has the value.
#[test]
fn files_appear_and_disappear_with_their_values() {
    let Some(mount) = Mount::new("bq34z100-g1", Duration::from_millis(500), Keys::default()) else { return };
    let listed = || {
        fs::read_dir(mount.path(""))
            .expect("a folder")
            .any(|entry| entry.expect("an entry").file_name() == "time_to_empty_now")
    };
    assert!(!listed());
    mount.sim.set("speed", "30").expect("a knob");
    mount.sim.set("load_ma", "500").expect("a knob");
    until("a time to empty", || mount.path("time_to_empty_now").exists() && listed());
    assert_eq!(mount.cat("status"), "Discharging");
    assert!(mount.cat("uevent").contains("POWER_SUPPLY_TIME_TO_EMPTY_NOW="));
    mount.sim.set("load_ma", "0").expect("a knob");
    until("no time to empty", || !mount.path("time_to_empty_now").exists() && !listed());
    // The gauge counts as absent after three failed polls, and as present after the first successful one.
    let mut held = fs::File::open(mount.path("voltage_now")).expect("opens");
    mount.sim.set("power", "off").expect("a knob");
    until("the gauge gone", || mount.shows("present", "0"));
    assert_eq!(
        mount.cat("uevent"),
        "POWER_SUPPLY_NAME=BAT0\nPOWER_SUPPLY_TYPE=Battery\nPOWER_SUPPLY_PRESENT=0"
    );
    assert_eq!(fs::read(mount.path("voltage_now")).map_err(|error| error.kind()), Err(ErrorKind::NotFound));
    until("ENODEV of a file held open", || {
        held.seek(SeekFrom::Start(0)).expect("seeks");
        held.read(&mut [0; 16]).map_err(errno) == Err(Errno::ENODEV)
    });
    mount.sim.set("power", "on").expect("a knob");
    until("the gauge back", || mount.shows("present", "1"));
    until("its voltage", || mount.path("voltage_now").exists());
}

/// A bus on which the gauge's owner panics during a write.
/// Their absence is in the kernel's caches when the values become known.
#[test]
fn files_of_data_flash_appear_when_it_is_read() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let name = "voltage_max_design";
    let listed = || {
        let entries = fs::read_dir(mount.path("")).expect("a folder");
        entries.map(|entry| entry.expect("an entry").file_name()).any(|entry| entry == name)
    };
    assert!(!mount.path(name).exists() && !listed());
    assert_eq!(mount.cat("technology"), "Unknown");
    let transfers = mount.transfers();
    assert!(!mount.cat("uevent").contains("VOLTAGE_MAX_DESIGN"));
    assert_eq!(mount.transfers(), transfers, "nothing is read for them");
    mount.cat("df/48/19");
    mount.cat("df/48/55");
    until("the technology", || mount.shows("technology", "Li-ion"));
    assert!(!mount.path(name).exists(), "the number of cells is not known");
    mount.cat("df/64/7");
    until("a voltage", || mount.shows(name, "4200000") && listed());
    assert!(mount.cat("uevent").contains("POWER_SUPPLY_VOLTAGE_MAX_DESIGN=4200000\n"));
    // A write ends with a reset, after which nothing is believed that was read before.
    mount.echo("4100", "df/48/19").expect("the default key");
    until("no voltage", || !mount.path(name).exists() && !listed());
    mount.cat("df/48/19");
    mount.cat("df/64/7");
    until("the new voltage", || mount.shows(name, "4100000") && listed());
}

struct Panics(gauge_sim::SimBus, Arc<AtomicBool>);

impl Bus for Panics {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        assert!(!self.1.load(Ordering::SeqCst), "as the test wants it");
        self.0.transfer(write, read)
    }
}

/// Nobody knows what came of such a write, so EIO, which means that nothing has changed, would be wrong.
#[test]
fn a_write_that_nobody_answers_is_unknown() {
    let now = Arc::new(AtomicBool::new(false));
    let bus = |sim: &Sim| Box::new(Panics(sim.bus(), now.clone())) as Box<dyn Bus>;
    let hour = Duration::from_secs(3600);
    let Some(mount) = Mount::with("bq34z100-g1", hour, Keys::default(), |_| {}, Vec::new(), bus) else {
        return;
    };
    now.store(true, Ordering::SeqCst);
    assert_eq!(mount.echo("3100", "df/80/53"), Err(Errno::ENOTRECOVERABLE));
    // A panic ends one write, and not the owner.
    assert_eq!(mount.echo("3100", "df/80/53"), Err(Errno::ENOTRECOVERABLE));
}

#[test]
fn a_panic_in_a_request_fails_that_request_only() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    mount.defect.store(true, Ordering::SeqCst);
    for _ in 0..2 {
        assert_eq!(fs::read(mount.path("sim/load_ma")).map_err(errno), Err(Errno::EIO));
        assert_eq!(mount.cat("present"), "1");
    }
    let error = mount.cat("gauge/last_error");
    assert!(error.contains("a defect of gaugefs has stopped a request"), "{error}");
    assert_eq!(mount.echo("3100", "df/80/53"), Ok(()));
}

/// Each open of a file that may be written is another file to the kernel. SEMANTICS.md says what to lock instead.
#[test]
fn a_lock_of_a_folder_excludes_others_and_one_of_a_writable_file_does_not() {
    use rustix::fs::{FlockOperation, flock};
    let Some(mount) = quiet("bq34z100-g1") else { return };
    for (name, excludes) in [("", true), ("df", true), ("df/80/53", false), ("df/transaction", false)] {
        let open = || fs::File::open(mount.path(name)).expect("opens");
        let (one, other) = (open(), open());
        flock(&one, FlockOperation::NonBlockingLockExclusive).expect("nobody has it");
        let locked = flock(&other, FlockOperation::NonBlockingLockExclusive);
        assert_eq!(locked.is_err(), excludes, "{name}: {locked:?}");
    }
}

/// Only the owner can read data flash, and only the owner can write.
#[test]
fn file_modes_restrict_other_users() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let mode = |name: &str| fs::metadata(mount.path(name)).expect("there").permissions().mode() & 0o777;
    assert_eq!(mode("df/80/53"), 0o600);
    assert_eq!(mode("df/80/raw"), 0o400);
    assert_eq!(mode("gauge/control"), 0o600);
    assert_eq!(mode("gauge/seal"), 0o600);
    assert_eq!(mode("gauge/age_ms"), 0o444);
    assert_eq!(mode("sim/load_ma"), 0o600);
    let write = OpenOptions::new().write(true).custom_flags(0).open(mount.path("capacity"));
    // File modes do not restrict root, so for root the write itself is refused.
    let refused = write.and_then(|mut file| file.write_all(b"50"));
    assert_eq!(refused.map_err(errno), Err(Errno::EACCES));
}

/// `>` truncates before it writes. A file that cannot be written cannot be truncated either, not even by root.
#[test]
fn a_read_only_file_cannot_be_truncated() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    for name in ["capacity", "uevent", "gauge/registers/voltage", "gauge/age_ms"] {
        assert!(!mount.cat(name).is_empty());
        let opened = OpenOptions::new().write(true).truncate(true).open(mount.path(name));
        assert_eq!(opened.map(|_| ()).map_err(errno), Err(Errno::EACCES), "{name}");
        assert!(!mount.cat(name).is_empty(), "{name}");
    }
}

/// A program that writes and then reads through one open file gets the stored value, not the written text.
#[test]
fn a_writer_reads_the_stored_value() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let file = OpenOptions::new().read(true).write(true).open(mount.path("df/80/53")).expect("opens");
    let read = || {
        let mut buffer = [0; 64];
        let length = file.read_at(&mut buffer, 0).expect("reads");
        String::from_utf8_lossy(&buffer[..length]).into_owned()
    };
    assert_eq!(read(), "3000\n");
    for (written, value) in [("0xc1c", "3100\n"), (" 3200 \n", "3200\n"), ("3000", "3000\n")] {
        file.write_all_at(written.as_bytes(), 0).expect("written");
        assert_eq!(read(), value);
    }
    assert_eq!(file.write_at(b"99999999", 0).map_err(errno), Err(Errno::ERANGE));
    assert_eq!(read(), "3000\n");
    // The kernel takes over the file's size and time with the answer to a truncation.
    file.write_all_at(b"003000", 0).expect("written");
    file.set_len(0).expect("truncated");
    assert_eq!(read(), "3000\n");
    for millivolts in 3001..3012 {
        file.write_all_at(millivolts.to_string().as_bytes(), 0).expect("written");
    }
    assert_eq!(read(), "3011\n");
}

/// A parameter that is held open gets its new value although that has to be read from the gauge. Each read
/// returns one value, neither cut off nor padded.
#[test]
fn a_parameter_held_open_gets_the_new_value() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let file = fs::File::open(mount.path("df/48/43")).expect("opens");
    let read = || {
        let mut buffer = [0; 64];
        let length = file.read_at(&mut buffer, 0).expect("reads");
        String::from_utf8_lossy(&buffer[..length]).into_owned()
    };
    assert_eq!(read(), "Texas Inst.\n");
    for (name, text, before, after) in [
        ("df/48/43", "TI", "Texas Inst.\n", "TI\n"),
        ("gauge/refresh", "1", "TI\n", "TI\n"),
        ("df/48/43", "Texas", "TI\n", "Texas\n"),
    ] {
        assert_eq!(mount.echo(text, name), Ok(()));
        // It is renewed two seconds after the change.
        let end = Instant::now() + Duration::from_millis(2500);
        let mut last = read();
        while Instant::now() < end || last != after {
            last = read();
            assert!(last == before || last == after, "{last:?} after {text} to {name}");
        }
        assert_eq!(file.metadata().expect("it is open").size(), after.len() as u64);
    }
}

/// Every simulated gauge has the files that monitors need, and shows a written value.
#[test]
fn every_chip_can_be_mounted_read_and_written() {
    for (chip, parameter, value) in [
        ("bq27520-g3", "df/48/10", "1200"),
        ("bq27500", "df/48/10", "1200"),
        ("bq27500-v130", "df/48/10", "1200"),
        ("bq27441-g1", "df/82/10", "1200"),
        ("bq27421-g1", "df/82/10", "1200"),
        ("bq27426", "df/82/6", "1200"),
        ("bq27427", "df/82/6", "1200"),
        ("bq27621-g1", "df/82/3", "1200"),
        ("bq34110", "df/flash/0x41f5", "3100"),
        ("bq35100", "df/flash/0x41fe", "3100"),
    ] {
        let Some(mount) = quiet(chip) else { return };
        for name in ["type", "status", "present", "voltage_now", "temp", "uevent", "health"] {
            assert!(!mount.cat(name).is_empty(), "{chip} {name}");
        }
        if chip != "bq35100" {
            for name in ["current_now", "capacity", "charge_now", "charge_full", "capacity_level"] {
                assert!(!mount.cat(name).is_empty(), "{chip} {name}");
            }
        }
        assert_eq!(mount.echo(value, parameter), Ok(()), "{chip}: {}", mount.cat("gauge/last_error"));
        assert_eq!(mount.cat(parameter), value, "{chip}");
        assert_eq!(mount.cat("gauge/seal"), "sealed", "{chip}");
        let index = mount.cat("df/index");
        let rows: usize =
            Chip::by_name(chip).expect("a table").subclasses.iter().map(|row| row.parameters.len()).sum();
        assert_eq!(index.lines().count(), rows + 1, "{chip}");
    }
}

/// A parameter whose address is uncertain is read-only for every user, and the refusal says which option opens it.
#[test]
fn unproven_parameters_are_read_only() {
    let Some(mount) = quiet("bq34110") else { return };
    let index = mount.cat("df/index");
    let row = index.lines().find(|line| line.contains("unproven")).expect("there are some");
    let path = format!("df/flash/{}", row.split('\t').nth(1).expect("an address"));
    let value = mount.cat(&path);
    assert_eq!(mount.echo(&value, &path), Err(Errno::EACCES));
    assert!(mount.cat("gauge/last_error").contains("--allow-unproven"), "{}", mount.cat("gauge/last_error"));
}

/// Data memory in RAM is lost with the power; the loss is reported, and an exported image is restored.
#[test]
fn a_ram_gauge_gets_its_configuration_restored() {
    let Some(mount) = quiet("bq27441-g1") else { return };
    assert_eq!(mount.echo("1234", "df/82/10"), Ok(()));
    drop(mount);
    let table = Chip::by_name("bq27441-g1").expect("a table");
    let image = "chip = \"bq27441-g1\"\n[state]\ndesign-capacity = 1234\n";
    let image = Image::parse(image, Some(table)).expect("an image");
    let restore = image.to_restore().expect("values in range");
    let open = |sim: &Sim| Box::new(sim.bus()) as Box<dyn Bus>;
    let interval = Duration::from_millis(500);
    let mount =
        Mount::with("bq27441-g1", interval, Keys::default(), |_| {}, restore, open).expect("as before");
    assert_eq!(mount.cat("gauge/itpor"), "0", "a new simulated gauge has not lost anything");
    // Its flag shows no loss, but its memory is that of a gauge that was never configured.
    assert_eq!(mount.cat("df/82/10"), "1234");
    mount.sim.set("power", "off").expect("a knob");
    until("the gauge gone", || mount.shows("present", "0"));
    mount.sim.set("power", "on").expect("a knob");
    let holds = |name: &str, text: &str| {
        fs::read_to_string(mount.path(name)).is_ok_and(|found| found.trim_end() == text)
    };
    until("the restoration", || {
        holds("present", "1") && holds("df/82/10", "1234") && holds("gauge/itpor", "0")
    });
}

#[test]
fn an_inverted_cc_gain_is_reported_with_its_remedy() {
    let prepare = |sim: &Sim| sim.set("cc_gain_inverted", "on").expect("a knob");
    let open = |sim: &Sim| Box::new(sim.bus()) as Box<dyn Bus>;
    let Some(mount) =
        Mount::with("bq27427", Duration::from_secs(3600), Keys::default(), prepare, Vec::new(), open)
    else {
        return;
    };
    mount.cat("df/105/4");
    let told = mount.cat("gauge/last_error");
    assert!(told.contains("df/105/5") && told.contains("write CC Gain (105/4) again"), "{told}");
}

/// A bus on which the gauge reports another firmware version.
struct OtherFirmware {
    bus: Box<dyn Bus>,
    version: u16,
    asked: bool,
}

impl Bus for OtherFirmware {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        self.bus.transfer(write, read)?;
        if self.asked && write == [0] {
            read.copy_from_slice(&self.version.to_le_bytes());
        }
        self.asked = write == [0, 2, 0];
        Ok(())
    }
}

fn with_firmware(chip: &str, version: u16) -> Option<Mount> {
    let open = move |sim: &Sim| {
        Box::new(OtherFirmware { bus: Box::new(sim.bus()), version, asked: false }) as Box<dyn Bus>
    };
    Mount::with(chip, Duration::from_secs(3600), Keys::default(), |_| {}, Vec::new(), open)
}

/// A firmware that the table was not proven for may keep its data flash elsewhere.
#[test]
fn an_unknown_firmware_shows_standard_commands_and_says_why() {
    let Some(mount) = with_firmware("bq34z100-g1", 0x0017) else { return };
    let why = mount.cat("gauge/last_error");
    assert!(why.contains("Z: bq34z100-G1: firmware 0x0017, hardware 0x0008: "), "{why}");
    assert!(why.contains("proven only for firmware 0x0016, hardware 0x0008"), "{why}");
    assert!(why.contains("gaugefs report"), "{why}");
    assert_eq!(mount.cat("model_name"), "bq34z100-G1");
    assert_eq!(mount.cat("gauge/firmware_version"), "0x0017");
    assert!(mount.cat("voltage_now").parse::<i64>().is_ok());
    assert!(!mount.path("df").exists());
    for (text, file) in [("unsealed", "gauge/seal"), ("CHEM_ID", "gauge/control")] {
        assert_eq!(mount.echo(text, file), Err(Errno::EPERM), "{file}");
    }
    let reason = |line: &str| line.split_once("Z: ").map(|(_, reason)| reason.to_string());
    assert_eq!(reason(&mount.cat("gauge/last_error")), reason(&why));
    assert_eq!(mount.echo("1", "gauge/refresh"), Ok(()));
}

/// What the gauge reports, times what the user gives.
#[test]
fn the_scales_that_are_applied_are_shown() {
    let open = |sim: &Sim| Box::new(sim.bus()) as Box<dyn Bus>;
    let prepare = |sim: &Sim| {
        sim.set_flash(48, 30, &[2, 10, 20]);
        sim.set("power", "off").expect("a knob");
        sim.set("power", "on").expect("a knob");
    };
    for (chip, expected) in [("bq34z100-r2", ["2", "10", "10", "20"]), ("bq34110", ["1"; 4])] {
        let prepare = if chip == "bq34z100-r2" { prepare } else { |_: &Sim| {} };
        let Some(mount) =
            Mount::with(chip, Duration::from_secs(3600), Keys::default(), prepare, Vec::new(), open)
        else {
            return;
        };
        let files = ["voltage_scale", "current_scale", "charge_scale", "energy_scale"];
        assert_eq!(files.map(|file| mount.cat(&format!("gauge/{file}"))), expected, "{chip}");
    }
}

/// Whatever is written to it, a subcommand or not.
#[test]
fn regression_control_of_a_gauge_with_standard_commands_only_was_einval_with_no_word_of_why() {
    let Some(mount) = quiet("bq27541") else { return };
    assert!(!mount.path("df").exists() && !mount.path("gauge/seal").exists());
    for text in ["CONTROL_STATUS", "0x0001", "nonsense"] {
        assert_eq!(mount.echo(text, "gauge/control"), Err(Errno::EPERM), "{text}");
        let why = mount.cat("gauge/last_error");
        assert!(
            why.ends_with(
                "bq27541: no table describes its data flash and subcommands; only standard commands are read"
            ),
            "{why}"
        );
    }
}

/// The bq27520-G2 has the registers of the G3, but nobody has described its data flash.
#[test]
fn a_sibling_shows_standard_commands_only() {
    let Some(mount) = with_firmware("bq27520-g3", 0x0311) else { return };
    assert!(mount.cat("model_name").contains("G2"), "{}", mount.cat("model_name"));
    assert!(mount.cat("voltage_now").parse::<i64>().is_ok());
    assert!(!mount.path("df").exists());
    assert_eq!(mount.echo("unsealed", "gauge/seal"), Err(Errno::EPERM));
    assert_eq!(mount.echo("CHEM_ID", "gauge/control"), Err(Errno::EPERM));
}

/// The size of a value is unknown until it has been read. Readers that arrive while it is being read get the
/// whole value and nothing more.
#[test]
fn simultaneous_first_readers_get_the_whole_value() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    for (name, text) in
        [("df/80/53", Some("3000\n")), ("df/48/43", Some("Texas Inst.\n")), ("df/index", None)]
    {
        for round in 0..3 {
            assert_eq!(mount.echo("1", "gauge/refresh"), Ok(()));
            let path = mount.path(name);
            let read = || fs::read_to_string(&path).expect("a value");
            let texts: Vec<String> = std::thread::scope(|scope| {
                let readers: Vec<_> = (0..8)
                    .map(|reader| {
                        scope.spawn(move || {
                            std::thread::sleep(Duration::from_micros(700 * reader));
                            read()
                        })
                    })
                    .collect();
                readers.into_iter().map(|reader| reader.join().expect("no panic")).collect()
            });
            for found in texts {
                match text {
                    Some(text) => assert!(found == text, "round {round}: {} bytes", found.len()),
                    None => assert!(found.ends_with("-\n") && !found.contains('\0'), "round {round}"),
                }
            }
        }
    }
}

/// Programs read in pieces of any size.
#[test]
fn a_first_read_in_pieces_is_complete() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let whole = mount.cat("df/index");
    for (name, whole) in [("df/index", &whole[..]), ("df/80/53", "3000")] {
        for piece in [1, 512, 8192, 65536] {
            assert_eq!(mount.echo("1", "gauge/refresh"), Ok(()));
            let mut file = fs::File::open(mount.path(name)).expect("opens");
            let mut found = Vec::new();
            let mut buffer = vec![0; piece];
            loop {
                let length = file.read(&mut buffer).expect("reads");
                if length == 0 {
                    break;
                }
                found.extend_from_slice(&buffer[..length]);
            }
            assert_eq!(String::from_utf8_lossy(&found).trim_end(), whole, "{name} in pieces of {piece}");
        }
    }
}

/// Every listed file exists, from the start and whatever values the gauge has, and only files of this part are listed.
#[test]
fn listed_files_exist() {
    let open = |sim: &Sim| Box::new(sim.bus()) as Box<dyn Bus>;
    for (chip, itpor) in [("bq34110", false), ("bq27220", false), ("bq27441-g1", true)] {
        let Some(mount) =
            Mount::with(chip, Duration::from_secs(3600), Keys::default(), |_| {}, Vec::new(), open)
        else {
            return;
        };
        walk(&mount.path("gauge"), &mut Vec::new());
        assert_eq!(mount.path("gauge/itpor").exists(), itpor, "{chip}");
        mount.sim.set("power", "off").expect("a knob");
        for _ in 0..3 {
            let _ = mount.echo("1", "gauge/refresh");
        }
        until("an empty folder", || {
            fs::read_dir(mount.path("gauge/registers")).expect("a folder").count() == 0
        });
        walk(&mount.path("gauge"), &mut Vec::new());
    }
}

/// RAM may be lost between two successful polls; cached values are then no longer shown.
#[test]
fn a_short_power_loss_of_a_ram_gauge_is_detected() {
    let Some(mount) = quiet("bq27441-g1") else { return };
    assert_eq!(mount.echo("1234", "df/82/10"), Ok(()));
    assert_eq!(mount.cat("df/82/10"), "1234");
    mount.sim.set("power", "off").expect("a knob");
    mount.sim.set("power", "on").expect("a knob");
    std::thread::sleep(Duration::from_millis(1300));
    assert_eq!(mount.echo("0.5", "gauge/poll_interval"), Ok(()));
    until("the loss to be seen", || mount.shows("gauge/itpor", "1"));
    until("the value of the ROM", || mount.shows("df/82/10", "1340"));
    assert_eq!(mount.cat("gauge/seal"), "unsealed");
}

/// One open file and several writes, as with `{ echo begin; echo ...; } > df/transaction`.
#[test]
fn a_transaction_can_be_sent_in_several_writes() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let mode = fs::metadata(mount.path("df/transaction")).expect("there").permissions().mode() & 0o777;
    assert_eq!(mode, 0o600);
    assert_eq!(mount.cat("df/transaction"), "idle");
    let mut file =
        OpenOptions::new().write(true).truncate(true).open(mount.path("df/transaction")).expect("opens");
    for line in ["begin\n", "80/53 3100\n", "48/11 2200\n"] {
        file.write_all(line.as_bytes()).expect(line);
    }
    let staged = mount.cat("df/transaction");
    assert_eq!(staged, "Cell Terminate Voltage: 3000 -> 3100\nDesign Capacity: 1000 -> 2200");
    assert_eq!(mount.echo("3200", "df/80/53"), Err(Errno::EBUSY));
    assert!(mount.cat("gauge/last_error").contains("a transaction is open"));
    assert_eq!(mount.cat("df/80/53"), "3000");
    file.write_all(b"commit\n").expect("written");
    drop(file);
    assert_eq!(mount.cat("df/transaction"), "idle");
    assert_eq!((mount.cat("df/80/53").as_str(), mount.cat("df/48/11").as_str()), ("3100", "2200"));
    assert_eq!(mount.cat("gauge/seal"), "sealed");
    assert_eq!(mount.echo("3200", "df/80/53"), Ok(()));
}

/// bash writes each line by itself, and goes on after one that is refused.
#[test]
fn regression_a_shell_does_not_commit_what_is_left_of_a_refused_transaction() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let lines = r"begin\n80/53 3111\n48/11 99999999\ncommit\n";
    for script in [
        format!("printf '{lines}' > df/transaction"),
        "{ echo begin; echo 80/53 3111; echo 48/11 99999999; echo commit; } > df/transaction".into(),
        "for line in begin '80/53 3111' '48/11 99999999' commit; do echo $line > df/transaction; done".into(),
    ] {
        let shell = Command::new("bash").args(["-c", &script]).current_dir(mount.path("")).output();
        let output = shell.expect("bash runs");
        let told = String::from_utf8_lossy(&output.stderr);
        assert!(
            !output.status.success() && told.contains("Numerical result out of range"),
            "{script}: {told}"
        );
        let values = ["df/80/53", "df/48/11", "df/transaction"].map(|path| mount.cat(path));
        assert_eq!(values, ["3000", "1000", "idle"], "{script}");
        let reason = mount.cat("gauge/last_error");
        assert!(reason.contains("nothing is committed after a refused line"), "{reason}");
        assert!(reason.contains("Design Capacity"), "{reason}");
    }
}

/// Both scripts go on after what is refused, as a shell does.
#[test]
fn regression_two_shells_that_wrote_at_once_were_mixed() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let shell = |script: &str| {
        let mut bash = Command::new("bash");
        bash.args(["-c", script]).current_dir(mount.path("")).stdin(Stdio::piped()).stdout(Stdio::piped());
        bash.stderr(Stdio::null()).spawn().expect("bash runs")
    };
    let each = "for line in begin \"$1\" commit; do echo $line > df/transaction; done";
    for (first, second) in [
        (
            "{ echo begin; echo 80/53 3100; echo; read; echo commit; } > df/transaction",
            "{ echo begin; echo 48/11 2200; echo commit; } > df/transaction",
        ),
        (
            "echo begin > df/transaction; echo 80/53 3100 > df/transaction; read; echo commit > df/transaction",
            "set -- '48/11 2200'; ",
        ),
    ] {
        let second = if second.starts_with("set") { format!("{second}{each}") } else { second.to_string() };
        assert_eq!(mount.echo("3000", "df/80/53"), Ok(()));
        let mut one = shell(first);
        until("the line is staged", || mount.cat("df/transaction").contains("3100"));
        let other = shell(&second).wait_with_output().expect("it ends");
        assert!(!other.status.success(), "{second}");
        assert_eq!(mount.cat("df/transaction"), "Cell Terminate Voltage: 3000 -> 3100", "{second}");
        let mut waits =
            shell("until echo begin > df/transaction; do sleep 0.1; done; echo abort > df/transaction");
        drop(one.stdin.take());
        assert!(one.wait().expect("it ends").success(), "{first}");
        assert!(waits.wait().expect("it ends").success(), "it gets its turn");
        assert_eq!((mount.cat("df/80/53").as_str(), mount.cat("df/48/11").as_str()), ("3100", "1000"));
    }
    // A program for each line.
    let tee = "for line in begin '48/11 2200' commit; do echo $line | tee df/transaction; done";
    assert!(!shell(tee).wait().expect("it ends").success());
    assert!(mount.cat("gauge/last_error").contains("one open file for all lines"));
    assert_eq!(mount.cat("df/48/11"), "1000");
    let tee = "printf 'begin\\n48/11 2200\\ncommit\\n' | tee df/transaction";
    assert!(shell(tee).wait().expect("it ends").success());
    assert_eq!(mount.cat("df/48/11"), "2200");
}

/// The kernel tells of a closed file in its own time: a shell that opens the file for each line never notices.
#[test]
fn lines_through_one_open_file_after_the_other_are_taken_while_others_read() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let (ends, held) = (AtomicBool::new(false), ["df/80/53", "gauge/seal"].map(|name| mount.path(name)));
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                while !ends.load(Ordering::SeqCst) {
                    held.iter().for_each(|path| drop(fs::read(path).expect("readable")));
                }
            });
        }
        for turn in 0..100 {
            for line in ["begin".to_string(), format!("80/53 {}", 3000 + turn), "abort".to_string()] {
                assert_eq!(mount.echo(&line, "df/transaction"), Ok(()), "{turn}: {line}");
            }
        }
        ends.store(true, Ordering::SeqCst);
    });
}

/// The kernel passes a long write(2) on in pieces. None of them counts as the whole.
#[test]
fn a_piece_that_the_kernel_cuts_is_no_value() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let padded = |before: usize, text: &str| " ".repeat(before) + text;
    for (append, path, text) in [
        (false, "df/48/11", padded(4094, "2200")),
        (true, "df/48/11", padded(4094, "2200")),
        (false, "df/48/11", padded(4094, "2200\n")),
        (false, "df/48/11", padded(3 * 4096 + 4094, "2200\n")),
        (false, "df/48/11", padded((1 << 20) + 4094, "2200\n")),
        (true, "df/48/11", padded(4093, "22\n00\n")),
        (false, "gauge/poll_interval", padded(4095, "30")),
        (false, "gauge/seal", padded(4088, "unsealed\n")),
    ] {
        let mut options = OpenOptions::new();
        options.write(true).append(append);
        let before = mount.cat(path);
        let written = options.open(mount.path(path)).expect("opens").write(text.as_bytes());
        assert_eq!(written.map_err(errno), Err(Errno::EFBIG), "{path}, {} bytes", text.len());
        let reason = mount.cat("gauge/last_error");
        assert!(reason.contains(&format!("Z: {path}: ")) && reason.contains("may not be whole"), "{reason}");
        assert_eq!(mount.cat(path), before);
    }
    // Every position of the cut within a line, the newline included.
    let line = "48/11 2200\n";
    for before in 4096 - line.len() - 1..=4096 {
        mount.echo("begin", "df/transaction").expect("a transaction");
        let text = padded(before, line) + &" ".repeat(100) + "\n";
        let written = fs::write(mount.path("df/transaction"), &text).map_err(errno);
        let staged = mount.cat("df/transaction");
        let all = "Design Capacity: 1000 -> 2200";
        assert!(
            written.is_ok() && staged == all || written == Err(Errno::EINVAL) && staged.is_empty(),
            "{before}: {staged}"
        );
        mount.echo("abort", "df/transaction").expect("the end of it");
    }
    assert_eq!(mount.cat("df/48/11"), "1000");
    assert_eq!(statistic(&mount.handle, "flash_writes"), 0);
    assert_eq!(
        fs::write(mount.path("df/48/11"), "2200").map_err(errno),
        Ok(()),
        "without a newline, but whole"
    );
    assert_eq!(mount.cat("df/48/11"), "2200");
}

/// What was written may be a key, and may contain what forges a line of the log.
#[test]
fn refused_text_is_not_repeated_in_last_error() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    for text in [
        "8d3e b7c5",
        "0x8d3eb7c5",
        "9d17c2e85ba3f6047e91d80c3b6fa25e",
        "8d3e\nb7c5",
        "8d3e\x1b[2Jb7c5",
        "36158",
    ] {
        for path in [
            "df/80/53",
            "df/48/11",
            "df/48/32",
            "df/transaction",
            "gauge/seal",
            "gauge/control",
            "gauge/settle",
            "gauge/keys",
            "gauge/authenticate",
            "gauge/poll_interval",
            "sim/load_ma",
            "sim/fault",
            "sim/reset_busy",
            "sim/power",
            "sim/firmware",
        ] {
            if path == "df/transaction" {
                mount.echo("begin", path).expect("a transaction");
                for line in [format!("80/53 {text}"), format!("raw 80/60 {text}"), format!("raw {text}")] {
                    mount.echo(&line, path).expect_err("refused");
                    let told = mount.cat("gauge/last_error");
                    assert!(
                        !["8d3e", "b7c5", "9d17", "36158"].iter().any(|word| told.contains(word)),
                        "{line:?}: {told}"
                    );
                }
                mount.echo(&format!("abort\n{text}"), path).expect_err("refused");
                mount.echo("abort", path).expect("the end of it");
                continue;
            }
            if mount.echo(text, path).is_ok() {
                continue;
            }
            let told = mount.cat("gauge/last_error");
            assert!(!told.is_empty() && !told.contains(char::is_control), "{path}: {told:?}");
            assert!(
                !["8d3e", "b7c5", "9d17", "36158"].iter().any(|word| told.contains(word)),
                "{path}: {told}"
            );
        }
    }
}

fn processor_time() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec as u32)
}

/// A user who may write must not be able to stop the others from reading, or to fill the memory.
#[test]
fn staging_is_linear_and_its_memory_is_given_back() {
    let Some(mount) = quiet("bq27520-g3") else { return };
    let resident = || {
        let pages = fs::read_to_string("/proc/self/statm").expect("it is there");
        pages.split(' ').nth(1).and_then(|pages| pages.parse::<usize>().ok()).expect("a number") * 4096
    };
    // The processor time of this process, which is the daemon as well: the machine may do something else meanwhile.
    let line = |at: usize| format!("raw {}/{} {}", 200 + at / 256, 32 * (at % 256), "5a".repeat(32));
    let lines = |from: usize, to: usize| {
        let batches = (from..to).step_by(100).map(|first| {
            let begin = processor_time();
            for at in first..to.min(first + 100) {
                mount.echo(&line(at), "df/transaction").expect("staged");
            }
            processor_time() - begin
        });
        batches.min().expect("there are lines")
    };
    mount.echo("begin", "df/transaction").expect("a transaction");
    lines(0, 100);
    let before = resident();
    let first = lines(100, 300);
    let _ = lines(300, 1700);
    let last = lines(1700, 1900);
    let full = resident();
    assert_eq!(mount.cat("df/transaction").lines().count(), 1900);
    mount.echo("abort", "df/transaction").expect("the end of it");
    assert_eq!(mount.cat("df/transaction"), "idle");
    let after = resident();
    eprintln!("100 lines in {first:?}, and {last:?} after 1700; {before} bytes, {full}, {after}");
    assert!(last < first * 4, "100 lines took {first:?} at first, and {last:?} after 1700 others");
    assert!(full < before + (8 << 20) && after < before + (4 << 20), "{before} bytes, {full}, {after}");
}

#[test]
fn a_challenge_is_answered_sealed_and_unsealed() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    // Most significant byte first, as in SHA-1; on the bus the order is reversed.
    let zeros = "00".repeat(20);
    let answer = format!("{zeros} 2fa27ceb5b616484620fe32217c29b0a8e3cf3f0");
    assert_eq!(mount.cat("gauge/authenticate"), "");
    assert_eq!(mount.cat("gauge/auth_order"), "lsb-first");
    for seal in ["sealed", "unsealed", "full-access"] {
        mount.echo(seal, "gauge/seal").expect("a state");
        // The previous contents of the window are not taken for the answer.
        mount.echo(&"a5".repeat(20), "gauge/authenticate").expect("another challenge");
        assert_ne!(mount.cat("gauge/authenticate"), answer);
        mount.echo(&zeros, "gauge/authenticate").expect("a challenge");
        assert_eq!(mount.cat("gauge/authenticate"), answer);
        assert_eq!(mount.cat("gauge/seal"), seal);
    }
    // The digest of a gauge that expects the challenge in the other byte order.
    let orders = [
        ("lsb-first", "b78043012bb40f9ff86404f645c2ab6a9f28eaf3"),
        ("as-sent", "67d8d90516ecd55a3c751fc0be7a361db366a246"),
    ];
    for (order, answer) in orders {
        mount.sim.set("auth_order", order).expect("a knob");
        let challenge = "000102030405060708090A0B0C0D0E0F10111213";
        mount.echo(challenge, "gauge/authenticate").expect("a challenge");
        assert_eq!(mount.cat("gauge/authenticate"), format!("{} {answer}", challenge.to_lowercase()));
    }
    // Data flash is unchanged, and nothing was programmed.
    mount.echo("unsealed", "gauge/seal").expect("a state");
    mount.echo(&zeros, "gauge/authenticate").expect("a challenge");
    assert_eq!(mount.cat("df/80/53"), "3000");
    assert_eq!(mount.sim.get("programmed").as_deref(), Some("0"));

    for text in ["", "00", &zeros[1..], &format!("{zeros}00"), &format!("{}zz", &zeros[2..])] {
        assert_eq!(mount.echo(text, "gauge/authenticate"), Err(Errno::EINVAL), "`{text}`");
    }
    // After a challenge that cannot be answered there is no digest.
    mount.sim.set("auth_ms", "5000").expect("a knob");
    assert_eq!(mount.echo(&zeros, "gauge/authenticate"), Err(Errno::EPROTO));
    assert_eq!(mount.cat("gauge/authenticate"), "");
    assert!(mount.cat("gauge/last_error").contains("no digest of the challenge"));
}

#[test]
fn only_parts_with_known_authentication_have_the_file() {
    let Some(mount) = quiet("bq27441-g1") else { return };
    assert!(!mount.path("gauge/authenticate").exists());
    assert!(!mount.path("gauge/auth_order").exists());
}
