// SPDX-License-Identifier: MIT

//! A gauge behind hosts without plain I2C, through the calls of the kernel's interface.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use gauge_bus::clock::RealClock;
use gauge_bus::linux::{Adapter, LinuxBus};
use gauge_bus::{Bus, BusError, Reach};
use nix::errno::Errno;

use super::room::{CHIP, Folder, Server, can_mount, gaugefs, within};

/// A gauge that is mounted from a bus behind an adapter.
struct Mounted {
    folder: Folder,
    at: String,
    _server: Server,
}

impl Mounted {
    fn new(chip: &str, adapter: &[&str]) -> Self {
        let folder = Folder::new();
        let server = Server::start(&folder, &[&[chip, "--fast"], adapter].concat());
        let (at, state) = (folder.file("m"), folder.file("state"));
        let found = gaugefs(&["probe", "--bus", &server.path]).done();
        assert!(found.contains("maybe"), "{adapter:?}: {found}");
        gaugefs(&[
            "mount",
            "--bus",
            &server.path,
            "--chip",
            chip,
            "--poll",
            "3600",
            "--state-dir",
            &state,
            &at,
        ])
        .done();
        Self { folder, at, _server: server }
    }

    fn file(&self, name: &str) -> String {
        format!("{}/BAT0/{name}", self.at)
    }

    fn cat(&self, name: &str) -> String {
        fs::read_to_string(self.file(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    fn image(&self) -> String {
        let image = self.folder.file("image.toml");
        gaugefs(&["export", &self.file(""), "--output", &image]).done();
        let text = fs::read_to_string(image).expect("an image");
        // The head has the time and the place.
        text.lines().filter(|line| !line.starts_with('#')).collect::<Vec<_>>().join("\n")
    }

    /// Values that do not change with time, and which files are there.
    fn shown(&self) -> (Vec<String>, Vec<String>) {
        let names =
            ["type", "present", "technology", "model_name", "charge_full_design", "cycle_count", "df/index"];
        let mut files: Vec<_> = ["", "gauge", "gauge/registers"]
            .iter()
            .flat_map(|folder| fs::read_dir(self.file(folder)).expect("a folder"))
            .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
            .collect();
        files.sort();
        (names.iter().map(|name| self.cat(name)).collect(), files)
    }
}

impl Drop for Mounted {
    fn drop(&mut self) {
        gaugefs(&["umount", &self.at]);
    }
}

#[test]
fn a_gauge_behind_smbus_commands_shows_what_it_shows_behind_plain_i2c() {
    if !can_mount() {
        return;
    }
    let plain = Mounted::new(CHIP, &[]);
    let (shown, image) = (plain.shown(), plain.image());
    for adapter in ["i801", "i2c-stub", "piix4"] {
        let mounted = Mounted::new(CHIP, &["--adapter", adapter]);
        assert_eq!(mounted.shown(), shown, "{adapter}");
        assert_eq!(mounted.image(), image, "{adapter}");
    }
}

#[test]
fn data_flash_is_written_by_commands_of_blocks() {
    if !can_mount() {
        return;
    }
    for adapter in ["i801", "i2c-stub"] {
        let mounted = Mounted::new(CHIP, &["--adapter", adapter]);
        let before = mounted.image();
        fs::write(mounted.file("df/80/53"), "3100\n").unwrap_or_else(|error| panic!("{adapter}: {error}"));
        // A text of a block and its changes at other places, as one.
        let lines = "begin\n48/31 Pack 7\n48/43 Maker\n80/53 3200\ncommit\n";
        fs::write(mounted.file("df/transaction"), lines).unwrap_or_else(|error| panic!("{adapter}: {error}"));
        let values = ["df/48/31", "df/80/53"].map(|name| mounted.cat(name));
        assert_eq!(values, ["Pack 7\n", "3200\n"], "{adapter}");
        assert_eq!(mounted.cat("gauge/last_error"), "", "{adapter}");
        assert_eq!(mounted.cat("gauge/seal"), "sealed\n", "{adapter}");
        gaugefs(&["import", &mounted.file(""), &mounted.folder.file("image.toml")]).done();
        assert_eq!(mounted.image(), before, "{adapter}");
    }
}

#[test]
fn data_flash_behind_words_alone_is_written_where_the_gauge_takes_single_bytes_and_only_read_elsewhere() {
    if !can_mount() {
        return;
    }
    let mounted = Mounted::new("bq27441-g1", &["--adapter", "piix4"]);
    let written = fs::write(mounted.file("df/82/10"), "1200\n");
    assert!(written.is_ok(), "its manual says so: {}", mounted.cat("gauge/last_error"));
    assert_eq!(mounted.cat("df/82/10"), "1200\n");
    drop(mounted);

    let mounted = Mounted::new(CHIP, &["--adapter", "piix4"]);
    let (before, image) = (mounted.cat("df/80/53"), mounted.image());
    let says = "data flash can only be read: the adapter carries writes of 3 bytes";
    let listed = gaugefs(&["list"]);
    assert!(listed.err.contains(says), "{}{}", listed.out, listed.err);
    let refused = fs::write(mounted.file("df/80/53"), "3100\n").expect_err("it is refused");
    assert_eq!(refused.raw_os_error(), Some(Errno::EROFS as i32));
    assert!(mounted.cat("gauge/last_error").contains(says), "{}", mounted.cat("gauge/last_error"));
    assert!(mounted.cat("gauge/last_error_facts").contains("short-writes"));
    let file = mounted.folder.file("image.toml");
    let refused = gaugefs(&["import", "--set", "80/53=3100", &mounted.file(""), &file]);
    assert!(refused.code == Some(1) && refused.err.contains(says), "{:?} {}", refused.code, refused.err);
    assert_eq!(mounted.image(), image);
    assert_eq!(mounted.cat("df/80/53"), before);
    assert_eq!(mounted.cat("gauge/seal"), "sealed\n");
}

#[test]
fn a_host_carries_what_its_functions_say_and_nothing_else_is_sent() {
    if !can_mount() {
        return;
    }
    for (adapter, reach) in
        [("i801", Reach::smbus(32, true).with_blocks()), ("piix4", Reach::smbus(2, false).with_blocks())]
    {
        let folder = Folder::new();
        let server = Server::start(&folder, &[CHIP, "--fast", "--adapter", adapter]);
        let adapter = Adapter::find(Path::new(&server.path)).expect("a bus");
        assert_eq!(Reach { pec: reach.pec, ..adapter.reach().expect("its functions") }, reach);
        let mut bus = LinuxBus::open(adapter, 0x55, Arc::new(RealClock::new())).expect("a bus");
        let (mut word, most) = ([0; 2], reach.read);
        bus.transfer(&[0x08], &mut word).expect("Voltage()");
        assert_eq!(u16::from_le_bytes(word), 3855);
        let longer = usize::from(most) + 1;
        let refused = Err(BusError::TooLong { bytes: most + 1, most });
        assert_eq!(bus.transfer(&[0x08], &mut vec![0; longer]), refused);
        let refused = Err(BusError::TooLong { bytes: most + 2, most: most + 1 });
        assert_eq!(bus.transfer(&vec![0x40; longer + 1], &mut []), refused);
        assert_eq!(
            bus.transfer(&[], &mut []),
            Err(BusError::Other(Errno::EOPNOTSUPP as i32)),
            "a quick command"
        );
    }
}

#[test]
fn a_pack_behind_smbus_commands_shows_what_it_shows_behind_plain_i2c() {
    if !can_mount() {
        return;
    }
    let mut plain = Vec::new();
    for (adapter, pec) in [
        (&[][..], "checked"),
        (&["--adapter", "i801"], "checked by the adapter"),
        (&["--adapter", "piix4"], "not checked, not carried"),
        (&["--adapter", "i2c-stub"], "checked"),
    ] {
        let folder = Folder::new();
        let server = Server::start(&folder, &[&["sbs", "--fast"], adapter].concat());
        let found = gaugefs(&["probe", "--bus", &server.path]).done();
        assert!(found.contains("0x0b     Smart Battery"), "{adapter:?}: {found}");
        let at = folder.file("m");
        gaugefs(&["mount", "--bus", &server.path, "--chip", "sbs", "--poll", "0.5", &at]).done();
        let cat = |name: &str| fs::read_to_string(format!("{at}/BAT0/{name}"));
        within("all of it has been read", || cat("cycle_count").is_ok());
        let names = [
            "manufacturer",
            "model_name",
            "technology",
            "serial_number",
            "voltage_now",
            "capacity",
            "charge_full",
            "cycle_count",
        ];
        let shown: Vec<_> =
            names.map(|name| cat(name).unwrap_or_else(|error| panic!("{adapter:?}: {name}: {error}"))).into();
        assert_eq!(cat("gauge/pec").expect("a file").trim(), pec, "{adapter:?}");
        let checked: u32 =
            cat("gauge/statistics/pec_checked").expect("a count").trim().parse().expect("a number");
        assert_eq!(checked > 20, pec.starts_with("checked"), "{adapter:?}");
        assert_eq!(cat("gauge/last_error").expect("a file"), "", "{adapter:?}");
        gaugefs(&["umount", &at]).done();
        if plain.is_empty() {
            plain = shown;
        } else {
            assert_eq!(shown, plain, "{adapter:?}");
        }
    }
}
