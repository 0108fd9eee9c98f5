// SPDX-License-Identifier: MIT

//! What a mount shows and takes of each part, and of one that is not as its table says.

use std::fs;
use std::time::Duration;

use gauge_bus::{Bus, BusError};
use gauge_sim::Sim;
use nix::errno::Errno;
use ti_gauge::chip::Chip;
use ti_gauge::image::Image;
use ti_gauge::keys::Keys;

use super::until;
use crate::room::{Mount, quiet};

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
