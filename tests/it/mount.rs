// SPDX-License-Identifier: MIT

//! A real FUSE mount, used with the file operations of a shell.

use std::fs::{self, OpenOptions};
use std::io::{ErrorKind, Read, Seek, SeekFrom, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::{FileExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use gauge_bus::Bus;
use gauge_owner::Run;
use gauge_sim::Sim;
use gaugefs::fuse;
use nix::errno::Errno;
use ti_gauge::keys::Keys;

use crate::room::{LONG, Mount, errno, quiet};

mod parts;
mod writing;

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
