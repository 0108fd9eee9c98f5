// SPDX-License-Identifier: MIT

//! I2C adapters: their presence, access, functions, and the drivers bound to gauges.

use std::fs;
use std::os::unix::fs::{FileTypeExt, MetadataExt};

use super::host::Host;
use super::{Finding, ok, problem, warning};
use gauge_bus::adapters::patient;
use gauge_bus::linux::{Adapter, adapters, clock, connected, described, driver, model, muxes, write_disable};
use gauge_bus::{GAUGE_ADDRESS, Reach};

/// Fastest clock at which this controller tolerates clock stretching.
const SLOW_HZ: u32 = 50_000;
/// A block of data flash, in bytes.
const BLOCK: u16 = 32;
/// The kernel's name of a controller that shortens bits when a target stretches the clock.
const NO_STRETCHING: &str = "bcm2835";

pub(super) fn check(host: &Host, configured: &[String]) -> Vec<Finding> {
    let adapters = adapters(host.root());
    let mut findings = vec![module(host, adapters.len())];
    findings.extend(pins(host, &adapters));
    findings.extend(group(host));
    for (number, name) in &adapters {
        let wanted = configured.iter().any(|bus| *bus == format!("i2c-{number}"));
        findings.push(adapter(host, *number, name, wanted));
        findings.extend(mux(host, *number, wanted));
        findings.extend(stretching(host, *number, name));
        findings.extend(writes(host, *number, name, wanted));
        findings.extend(patience(host, *number, name));
        findings.extend(drivers(host, *number));
    }
    findings
}

fn module(host: &Host, count: usize) -> Finding {
    let what = "i2c-dev";
    let loaded = host.has("/sys/module/i2c_dev") || host.has("/sys/class/i2c-dev");
    match count {
        // A built-in module has a folder in /sys, others are listed.
        0 if !loaded && host.has_module("i2c-dev") == Some(false) => {
            let says = match host.has("/sys/bus/i2c") {
                true => "this kernel has I2C, but no /dev/i2c-* and no module for that",
                false => "this kernel has no I2C, and no module for it",
            };
            let remedy = "Use a kernel with CONFIG_I2C and CONFIG_I2C_CHARDEV, or build these modules for it; a \
                          simulated gauge needs neither.";
            problem(what, says, remedy)
        }
        0 if loaded => {
            let remedy = "Enable a bus in the device tree (on a Raspberry Pi: dtparam=i2c_arm=on) or in \
                          the firmware, or plug in an adapter.";
            problem(what, "is loaded, but the machine has no I2C bus", remedy)
        }
        0 => {
            let remedy = "Load it as root: modprobe i2c-dev; at each boot: \
                          echo i2c-dev > /etc/modules-load.d/i2c-dev.conf";
            problem(what, "the module is not loaded, so there are no buses /dev/i2c-*", remedy)
        }
        1 => ok(what, "one bus"),
        count => ok(what, format!("{count} buses")),
    }
}

/// The bus on a Raspberry Pi's pins. Buses of its HDMI sockets exist even while it is off.
fn pins(host: &Host, adapters: &[(u64, String)]) -> Option<Finding> {
    let model = host.text("/proc/device-tree/model");
    let model = model.trim_end_matches('\0').trim();
    if !model.starts_with("Raspberry Pi") {
        return None;
    }
    let files = ["/boot/firmware/config.txt", "/boot/config.txt"].map(|path| host.text(path));
    let is_software =
        files.iter().any(|text| text.lines().any(|line| line.starts_with("dtoverlay=i2c-gpio")));
    let bus = adapters.iter().map(|(number, _)| number).find(|&&number| number <= 1);
    let wires = "SDA is pin 3, SCL pin 5, ground pin 9; pull-ups to 3.3 V, never to 5 V";
    Some(match bus {
        Some(number) => ok(model, format!("/dev/i2c-{number} is on its pins: {wires}")),
        None if is_software => ok(model, format!("a bus in software is on its pins: {wires}")),
        None => {
            let remedy = "Switch it on: sudo raspi-config nonint do_i2c 0, or dtparam=i2c_arm=on in \
                          /boot/firmware/config.txt; then restart.";
            warning(model, format!("the bus of its pins is off ({wires})"), remedy)
        }
    })
}

/// Whether an ordinary user is in the group that may use buses.
fn group(host: &Host) -> Option<Finding> {
    let groups = host.text("/etc/group");
    let gid = groups.lines().find_map(|line| line.strip_prefix("i2c:")?.split(':').nth(1)?.parse().ok())?;
    if host.is_root() {
        return None;
    }
    let (_, member) = host.group(gid)?;
    let what = "group i2c";
    Some(match (host.groups.contains(&gid), member) {
        (true, _) => ok(what, format!("{} is in it", host.user())),
        (false, true) => {
            let says = format!("{} is in it, but not yet in this session", host.user());
            warning(what, says, "Log in again, or for this shell only: newgrp i2c")
        }
        (false, false) => {
            let remedy = format!("To use its buses: sudo usermod -aG i2c {}", host.user());
            warning(what, format!("{} is not in it", host.user()), remedy + ", and log in again.")
        }
    })
}

/// The device node: access, and the adapter's functions.
fn adapter(host: &Host, number: u64, name: &str, wanted: bool) -> Finding {
    let node = format!("/dev/i2c-{number}");
    let what = format!("{node} ({name})");
    let Ok(status) = fs::metadata(host.at(&node)) else {
        let remedy = "Let udev create it, as root: udevadm trigger --subsystem-match=i2c-dev";
        return problem(what, "the device node is missing", remedy);
    };
    if !host.may_use(&node, &status) {
        return problem(what, "no permission", forbidden(host, &status));
    }
    let clock = clock(host.root(), number).map_or_else(
        || "clock unknown".into(),
        |clock| format!("{} kHz from {}", clock.hz / 1000, clock.from),
    );
    if !status.file_type().is_char_device() {
        return warning(what, format!("not a device, {clock}"), "Let udev create the node again.");
    }
    match Adapter::find(&host.at(&node)).and_then(|adapter| adapter.reach()) {
        Ok(reach) if reach.carries(1, 2) => ok(what, format!("usable, {}, {clock}", carried(reach))),
        Ok(_) if wanted => problem(
            what,
            "has neither plain I2C nor SMBus commands for words, but a gauge is configured on it",
            "Connect the gauge to another bus.",
        ),
        Ok(_) => ok(what, "has neither plain I2C nor SMBus commands for words: not usable for gauges"),
        Err(error) => problem(what, error.text, "Check that the adapter is connected."),
    }
}

/// What an adapter carries, in words.
fn carried(reach: Reach) -> String {
    let messages = match reach {
        Reach { smbus: false, .. } => "plain I2C".into(),
        Reach { write: ..=BLOCK, .. } => {
            "SMBus commands without I2C blocks: the data flash of most parts can only be read".into()
        }
        Reach { read, .. } => format!("SMBus commands of up to {read} bytes"),
    };
    format!("{messages}, packet error codes {}checked", if reach.pec { "" } else { "not " })
}

fn forbidden(host: &Host, status: &fs::Metadata) -> String {
    match host.group(status.gid()).filter(|_| status.gid() != 0 && status.mode() & 0o060 == 0o060) {
        Some((group, true)) => {
            format!(
                "You are in its group {group}, but not yet in this session: log in again, or: newgrp {group}"
            )
        }
        Some((group, false)) => {
            format!("Join its group and log in again: sudo usermod -aG {group} {}", host.user())
        }
        None => "Run gaugefs as root, or give the node a group; Debian's i2c-tools has a udev rule for that."
            .into(),
    }
}

/// The muxes on a bus, and the buses to use instead of it.
fn mux(host: &Host, number: u64, wanted: bool) -> Option<Finding> {
    let muxes = muxes(host.root(), number);
    let (what, says) = (format!("muxes of i2c-{number}"), described(number, &muxes)?);
    Some(match connected(&muxes) {
        Some(stays) if wanted => {
            let mut remedy = "Configure the gauges on these buses.".to_string();
            if stays.disconnects.is_some() {
                remedy += &format!(
                    " One in front of the mux can be used only if the mux connects no channel while it is idle: \
                     {}/idle_state is -2 (i2c-mux-idle-disconnect in the device tree)",
                    stays.device
                );
            }
            problem(what, format!("{says}; but a gauge is configured on i2c-{number}"), remedy)
        }
        _ => ok(what, says),
    })
}

/// Gauges stretch the clock for milliseconds.
fn stretching(host: &Host, number: u64, name: &str) -> Option<Finding> {
    let slow = clock(host.root(), number).is_some_and(|clock| clock.hz <= SLOW_HZ);
    if !name.contains(NO_STRETCHING) || slow {
        return None;
    }
    let says = "this controller shortens bits when a gauge stretches the clock, as gauges do";
    let remedy = "In config.txt, use a bus in software: dtoverlay=i2c-gpio,bus=3,i2c_gpio_sda=2,i2c_gpio_scl=3 \
                  and dtparam=i2c_arm=off; or a slower clock: dtparam=i2c_arm_baudrate=50000";
    Some(warning(format!("i2c-{number} ({name})"), says, remedy))
}

/// The firmware of many machines lets no write through to where gauges are.
fn writes(host: &Host, number: u64, name: &str, wanted: bool) -> Option<Finding> {
    let says = "SPD Write Disable is set: nothing is written to 0x50 to 0x57, so only the standard commands of a gauge can be \
                read there";
    let remedy = "Switch it off in the settings of the firmware, or connect the gauge to another adapter.";
    let what = format!("i2c-{number} ({name})");
    (write_disable(host.root(), number) == Some(true)).then(|| match wanted {
        true => problem(what, says, remedy),
        false => ok(what, says),
    })
}

/// A gauge holds the clock while it wakes up or stores a row, for longer than some adapters wait.
fn patience(host: &Host, number: u64, name: &str) -> Option<Finding> {
    let model = model(host.root(), number).filter(|model| model.is_impatient())?;
    let says = format!(
        "gives up on a gauge that holds the clock for more than {} ms in a write, as gauges do while they store",
        model.waits(true).as_millis()
    );
    let remedy = format!(
        "gaugefs looks whether such a write has arrived, and repeats what may happen twice. If writes fail often, use an \
         adapter that waits: {}",
        patient()
    );
    Some(warning(format!("i2c-{number} ({name})"), says, remedy))
}

/// Kernel drivers bound to gauges.
fn drivers(host: &Host, number: u64) -> Vec<Finding> {
    let bound = host.names("/sys/bus/i2c/devices").into_iter().filter_map(|device| {
        let (bus, address) = device.split_once('-')?;
        let address = u8::from_str_radix(address, 16).ok()?;
        (bus.parse() == Ok(number)).then_some(address)
    });
    let bound = bound.filter_map(|address| Some((address, driver(host.root(), number, address)?)));
    let gauges = bound.filter_map(|(address, driver)| {
        let gauge = driver.name.starts_with("bq27xxx");
        let what = format!("i2c-{number} address 0x{address:02x}");
        let says = format!("the kernel driver {} ({}) uses it", driver.name, driver.device);
        let remedy = format!("To release it for gaugefs, as root: {}", driver.remedy(address));
        match gauge {
            true => Some(problem(what, says, remedy)),
            false if address == GAUGE_ADDRESS => Some(warning(what, says, remedy)),
            false => None,
        }
    });
    gauges.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_an_adapter_carries_is_said_with_what_that_means() {
        let says = [
            (Reach { pec: false, ..Reach::FULL }, "plain I2C, packet error codes not checked"),
            (Reach::smbus(32, true), "SMBus commands of up to 32 bytes, packet error codes checked"),
            (
                Reach::smbus(2, false),
                "SMBus commands without I2C blocks: the data flash of most parts can only be read, packet error codes not \
                 checked",
            ),
        ];
        for (reach, words) in says {
            assert_eq!(carried(reach), words);
        }
    }
}
