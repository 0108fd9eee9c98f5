// SPDX-License-Identifier: MIT

//! `gaugefs doctor` on systems that are only folders, and once on this machine.

use std::fs::{self, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::Output;

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::{Value, json};

use super::room::command;

/// A system that is a folder.
struct System(PathBuf);

impl System {
    /// A system without problems: a user in the group i2c, one bus, FUSE, nothing mounted.
    fn new() -> Self {
        let system = Self(crate::room::folder_named(" with spaces"));
        system.write("proc/sys/kernel/osrelease", "6.1.0-25-amd64\n");
        system.write(
            "proc/self/status",
            "Name:\tx\nUid:\t4711\t4711\t4711\t4711\nGid:\t50\t50\t50\t50\nGroups:\t50 998 \n",
        );
        system.write("proc/self/mountinfo", "22 1 8:1 / / rw - ext4 /dev/sda1 rw\n");
        system.write("proc/locks", "");
        system.write("etc/passwd", "root:x:0:0::/root:/bin/sh\nann:x:4711:50::/home/ann:/bin/sh\n");
        system.write("etc/group", "root:x:0:\ni2c:x:998:bob,ann\n");
        system.mode("dev/fuse", 0o666);
        system.mode("usr/bin/fusermount3", 0o4755);
        system.bus(1, "bcm2835 (i2c@7e804000)");
        system.write("sys/bus/i2c/devices/i2c-1/of_node/clock-frequency", "\0\0\u{43}\u{50}");
        system
    }

    fn write(&self, path: &str, text: &str) {
        let path = self.0.join(path);
        fs::create_dir_all(path.parent().expect("a folder")).expect("folders");
        fs::write(path, text).expect("a file");
    }

    fn mode(&self, path: &str, mode: u32) {
        self.write(path, "");
        fs::set_permissions(self.0.join(path), Permissions::from_mode(mode)).expect("its mode");
    }

    fn bus(&self, number: u32, name: &str) {
        self.write(&format!("sys/class/i2c-dev/i2c-{number}/name"), &format!("{name}\n"));
        self.mode(&format!("dev/i2c-{number}"), 0o666);
    }

    fn remove(&self, path: &str) {
        let path = self.0.join(path);
        if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }.expect("it was there");
    }

    /// A driver bound to a device such as `1-0055`.
    fn driver(&self, device: &str, name: &str, driver: &str) {
        self.write(&format!("sys/bus/i2c/devices/{device}/name"), &format!("{name}\n"));
        let link = self.0.join(format!("sys/bus/i2c/devices/{device}/driver"));
        symlink(format!("../../drivers/{driver}"), link).expect("a link");
    }

    /// Installs a `systemctl` that prints these lines.
    fn units(&self, lines: &str) {
        self.write("run/systemd/system/x", "");
        self.write("usr/lib/systemd/system/gaugefs@.service", "");
        self.write("usr/lib/udev/rules.d/60-gaugefs.rules", "");
        self.write("bin/systemctl", &format!("#!/bin/sh\ncat <<'END'\n{lines}END\n"));
        fs::set_permissions(self.0.join("bin/systemctl"), Permissions::from_mode(0o755)).expect("its mode");
    }

    fn doctor(&self, more: &[&str]) -> Output {
        let path = std::env::var("PATH").unwrap_or_default();
        let mut command = command(&["doctor", "--root"]);
        command.arg(&self.0).args(more).env("PATH", format!("{}:{path}", self.0.join("bin").display()));
        command.output().expect("gaugefs runs")
    }

    /// Checks that the finding with this state and subject has all of `words`, in its line or its remedy.
    #[track_caller]
    fn says(&self, state: &str, what: &str, words: &[&str]) {
        let output = self.doctor(&[]);
        let text = String::from_utf8(output.stdout).expect("text");
        let start = format!("{state:7}  {what}");
        let at = text.find(&start).unwrap_or_else(|| panic!("no `{start}` in:\n{text}"));
        let finding: String = text[at..].lines().take(if state == "ok" { 1 } else { 2 }).collect();
        for word in words {
            assert!(finding.contains(word), "`{word}` is not in: {finding}");
        }
        let problems = text.lines().any(|line| line.starts_with("problem"));
        assert_eq!(output.status.code(), Some(i32::from(problems)), "{text}");
        assert!(state != "problem" || problems);
    }
}

impl Drop for System {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[test]
fn a_good_system_has_no_problem() {
    let system = System::new();
    let output = system.doctor(&[]);
    let text = String::from_utf8(output.stdout).expect("text");
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert_eq!(output.stderr, b"");
    for line in [
        "ok       Linux: 6.1.0-25-amd64\n",
        "ok       /dev/fuse: can be opened\n",
        "ok       fusermount3: /usr/bin/fusermount3\n",
        "ok       i2c-dev: one bus\n",
        "ok       group i2c: ann is in it\n",
        "ok       mounts: no gaugefs is mounted\n",
        "ok       gaugefs@.service: not installed",
    ] {
        assert!(text.contains(line), "no {line}in:\n{text}");
    }
}

#[test]
fn json_has_the_same_findings() {
    let system = System::new();
    system.remove("usr/bin/fusermount3");
    let report: Value = serde_json::from_slice(&system.doctor(&["--json"]).stdout).expect("JSON");
    let findings = report["findings"].as_array().expect("a list");
    let linux = json!({"state": "ok", "what": "Linux", "says": "6.1.0-25-amd64", "remedy": null});
    assert_eq!(findings[0], linux);
    let missing = json!({
        "state": "problem",
        "what": "fusermount3",
        "says": "not installed",
        "remedy": "Install it: sudo apt-get install fuse3",
    });
    assert!(findings.contains(&missing), "{report}");
}

#[test]
fn problems_with_fuse_are_found() {
    let system = System::new();
    system.mode("usr/bin/fusermount3", 0o755);
    system.says("problem", "fusermount3", &["not setuid", "chmod u+s /usr/bin/fusermount3"]);
    system.write("etc/fuse.conf", "# user_allow_other\n");
    system.says("ok", "user_allow_other", &["is not set"]);
    system.write("etc/fuse.conf", "user_allow_other\n");
    system.says("ok", "user_allow_other", &["is set"]);
    system.mode("dev/fuse", 0o600);
    system.says("problem", "/dev/fuse", &["no permission"]);
    system.remove("dev/fuse");
    system.says("problem", "/dev/fuse", &["does not exist", "modprobe fuse"]);
    system.write("proc/sys/kernel/osrelease", "4.19.0\n");
    system.says("warning", "Linux", &["older than 5.1"]);
    system.write("proc/self/status", "Uid:\t0\t0\t0\t0\n");
    system.remove("usr/bin/fusermount3");
    system.says("ok", "fusermount3", &["root does not need it"]);
}

#[test]
fn problems_with_buses_are_found() {
    let system = System::new();
    system.says("warning", "/dev/i2c-1 (bcm2835 (i2c@7e804000))", &["not a device", "17 kHz"]);
    system.write("sys/bus/i2c/devices/i2c-1/of_node/clock-frequency", "\0\u{1}\u{6}\u{20}");
    system.says("warning", "i2c-1 (bcm2835", &["stretches the clock", "i2c-gpio", "baudrate=50000"]);
    system.bus(4, "SMBus I801");
    system.says("ok", "i2c-dev", &["2 buses"]);
    // The node belongs to the user who runs the tests, and to their group.
    system.mode("dev/i2c-1", 0o660);
    let gid = fs::metadata(system.0.join("dev/i2c-1")).expect("a node").gid();
    system.says("problem", "/dev/i2c-1", &["no permission"]);
    if gid != 0 {
        system.write("etc/group", &format!("bus:x:{gid}:\n"));
        system.says("problem", "/dev/i2c-1", &["usermod -aG bus ann"]);
    }
    system.write("proc/self/status", &format!("Uid:\t4711\t4711\nGid:\t50\t50\nGroups:\t50 {gid}\n"));
    system.says("warning", "/dev/i2c-1", &["not a device"]);
    system.remove("dev/i2c-1");
    system.says("problem", "/dev/i2c-1", &["the device node is missing"]);
    system.remove("sys/class/i2c-dev");
    system.says("problem", "i2c-dev", &["not loaded", "modprobe i2c-dev"]);
    // A kernel without it has nothing that could be loaded; one whose modules are not here might have.
    system.write("proc/sys/kernel/osrelease", "6.12.0-tiny\n");
    system.says("problem", "i2c-dev", &["not loaded", "modprobe i2c-dev"]);
    system.write(
        "lib/modules/6.12.0-tiny/modules.dep",
        "kernel/fs/fuse/fuse.ko.xz:\nkernel/net/x.ko: kernel/i2c-dev.ko\n",
    );
    system.remove("sys/bus/i2c");
    system.says("problem", "i2c-dev", &["this kernel has no I2C", "CONFIG_I2C_CHARDEV"]);
    system.write("sys/bus/i2c/x", "");
    system.says("problem", "i2c-dev", &["this kernel has I2C, but no /dev/i2c-*"]);
    system.write("lib/modules/6.12.0-tiny/modules.builtin", "kernel/drivers/i2c/i2c-dev.ko\n");
    system.says("problem", "i2c-dev", &["not loaded", "modprobe i2c-dev"]);
    system.write("sys/module/i2c_dev/x", "");
    system.says("problem", "i2c-dev", &["has no I2C bus"]);
}

/// An adapter of a USB bridge, with the device and the driver to which it belongs.
fn bridge(system: &System, number: u32, driver: &str, name: &str) {
    system.bus(number, name);
    let device = format!("sys/devices/usb/{number}");
    system.write(&format!("{device}/i2c-{number}/name"), &format!("{name}\n"));
    fs::create_dir_all(system.0.join("sys/bus/i2c/devices")).expect("folders");
    let folder = system.0.join(&device);
    symlink(folder.join(format!("i2c-{number}")), system.0.join(format!("sys/bus/i2c/devices/i2c-{number}")))
        .expect("a link");
    symlink(Path::new("../../../bus/hid/drivers").join(driver), folder.join("driver")).expect("a link");
}

#[test]
fn the_clock_of_a_bus_is_shown_with_its_source() {
    let system = System::new();
    system.says("warning", "/dev/i2c-1 (bcm2835", &["17 kHz from the device tree"]);
    bridge(&system, 7, "mcp2221", "MCP2221 usb-i2c bridge");
    system.says("warning", "/dev/i2c-7 (MCP2221", &["400 kHz from the driver mcp2221"]);
    bridge(&system, 8, "ft260", "FT260 usb-i2c bridge on hidraw0");
    system.write("sys/devices/usb/8/clock", "100\n");
    system.says("warning", "/dev/i2c-8 (FT260", &["100 kHz from the file clock of its device in sysfs"]);
    // This kernel leaves the clock that the chip has.
    bridge(&system, 9, "cp2112", "CP2112 SMBus Bridge on hidraw1");
    system.says("warning", "/dev/i2c-9 (CP2112", &["clock unknown"]);
    system.write("proc/sys/kernel/osrelease", "7.3.4+deb14-amd64\n");
    system.says("warning", "/dev/i2c-9 (CP2112", &["100 kHz from the driver cp2112 of this kernel"]);
}

#[test]
fn an_adapter_that_gives_up_on_a_gauge_soon_is_named_with_others_that_wait() {
    let system = System::new();
    for (number, driver, name, least) in [
        (7, "mcp2221", "MCP2221 usb-i2c bridge", "1 ms in a write"),
        (8, "cp2112", "CP2112 SMBus Bridge on hidraw1", "20 ms in a write"),
    ] {
        bridge(&system, number, driver, name);
        system.says(
            "warning",
            &format!("i2c-{number} ({name})"),
            &["gives up on a gauge", least, "FT260, i2c-gpio"],
        );
    }
    bridge(&system, 9, "ft260", "FT260 usb-i2c bridge on hidraw0");
    let text = String::from_utf8(system.doctor(&[]).stdout).expect("text");
    assert_eq!(text.matches("gives up on a gauge").count(), 2, "{text}");
}

#[test]
fn a_mux_is_shown_with_the_buses_to_use() {
    let system = System::new();
    bridge(&system, 0, "mcp2221", "MCP2221 usb-i2c bridge");
    let mux = "sys/devices/usb/0/i2c-0/0-0070";
    system.write(&format!("{mux}/name"), "pca9548\n");
    system.write(&format!("{mux}/idle_state"), "-1\n");
    for channel in 2..=9 {
        let folder = format!("sys/devices/usb/0/i2c-0/i2c-{channel}");
        system.write(&format!("{folder}/name"), &format!("i2c-0-mux (chan_id {})\n", channel - 2));
        symlink("../0-0070", system.0.join(&folder).join("mux_device")).expect("a link");
        let link = system.0.join(format!("sys/bus/i2c/devices/i2c-{channel}"));
        symlink(system.0.join(folder), link).expect("a link");
    }
    let says = "i2c-0 has a mux, pca9548 at 0x70: use i2c-2 to i2c-9";
    system.says("ok", "muxes of i2c-0", &[says]);
    system.write("etc/gaugefs/i2c-0.toml", "[[gauge]]\n");
    system.says(
        "problem",
        "muxes of i2c-0",
        &[says, "a gauge is configured on i2c-0", "0-0070/idle_state is -2"],
    );
    system.write(&format!("{mux}/idle_state"), "-2\n");
    system.says("ok", "muxes of i2c-0", &[says]);
}

/// The channels of the kernel's sbs-manager are one after the other the bus of the packs, and nothing parts them from it.
#[test]
fn a_manager_of_packs_is_shown_with_the_buses_of_its_packs() {
    let system = System::new();
    bridge(&system, 0, "mcp2221", "MCP2221 usb-i2c bridge");
    system.write("sys/devices/usb/0/i2c-0/0-000a/name", "ltc1760\n");
    for channel in [2, 3] {
        let folder = format!("sys/devices/usb/0/i2c-0/i2c-{channel}");
        system.write(&format!("{folder}/name"), &format!("i2c-0-mux (chan_id {})\n", channel - 2));
        symlink("../0-000a", system.0.join(&folder).join("mux_device")).expect("a link");
        let link = system.0.join(format!("sys/bus/i2c/devices/i2c-{channel}"));
        symlink(system.0.join(folder), link).expect("a link");
    }
    let says = "i2c-0 has a mux, ltc1760 at 0x0a: use i2c-2 to i2c-3";
    system.says("ok", "muxes of i2c-0", &[says]);
    system.write("etc/gaugefs/i2c-0.toml", "[[gauge]]\nchip = \"sbs\"\n");
    system.says("problem", "muxes of i2c-0", &[says, "Configure the gauges on these buses."]);
    let text = String::from_utf8(system.doctor(&[]).stdout).expect("text");
    assert!(!text.contains("idle_state"), "{text}");
}

#[test]
fn a_host_that_lets_no_write_through_is_found() {
    let system = System::new();
    bridge(&system, 3, "i801_smbus", "SMBus I801 adapter at efa0");
    let config = |byte: char| format!("{}{byte}{}", "\0".repeat(64), "\0".repeat(191));
    system.write("sys/devices/usb/3/config", &config('\u{1}'));
    let text = String::from_utf8(system.doctor(&[]).stdout).expect("text");
    assert!(!text.contains("SPD"), "{text}");
    system.write("sys/devices/usb/3/config", &config('\u{11}'));
    system.says("ok", "i2c-3 (SMBus I801", &["SPD Write Disable is set: nothing is written to 0x50 to 0x57"]);
    system.write("etc/gaugefs/i2c-3.toml", "[[gauge]]\n");
    system.says(
        "problem",
        "i2c-3 (SMBus I801",
        &["only the standard commands", "the settings of the firmware"],
    );
}

#[test]
fn a_membership_that_needs_a_new_session_is_found() {
    let system = System::new();
    system.write("proc/self/status", "Uid:\t4711\t4711\nGid:\t50\t50\nGroups:\t50\n");
    system.says("warning", "group i2c", &["not yet in this session", "newgrp i2c"]);
    system.write("etc/group", "i2c:x:998:bob\n");
    system.says("warning", "group i2c", &["ann is not in it", "usermod -aG i2c ann"]);
}

#[test]
fn kernel_drivers_on_gauges_are_found() {
    let system = System::new();
    system.driver("1-0055", "bq34z100", "bq27xxx-battery");
    system.driver("1-0036", "max17048", "max17040");
    system.says(
        "problem",
        "i2c-1 address 0x55",
        &["bq27xxx-battery (bq34z100)", "echo 0x55 > /sys/bus/i2c/devices/i2c-1/delete_device"],
    );
    let text = String::from_utf8(system.doctor(&[]).stdout).expect("text");
    assert!(!text.contains("0x36"), "{text}");
    system.remove("sys/bus/i2c/devices/1-0055");
    system.driver("1-0055", "24c02", "at24");
    system.says(
        "warning",
        "i2c-1 address 0x55",
        &["at24 (24c02)", "echo 1-0055 > /sys/bus/i2c/drivers/at24/unbind"],
    );
}

#[test]
fn mounts_and_locks_are_listed() {
    let system = System::new();
    system.write(
        "proc/self/mountinfo",
        "22 1 8:1 / / rw - ext4 /dev/sda1 rw\n\
         40 22 0:36 / /run/gaugefs/i2c-1 rw - fuse.gaugefs gaugefs rw\n\
         41 22 0:37 / /mnt/x rw - fuse.gaugefs gaugefs rw\n\
         42 41 0:38 / /mnt/x rw - tmpfs none rw\n\
         43 22 0:39 / /run/gaugefs/i2c-2 rw - tmpfs none rw\n",
    );
    system.says("ok", "/run/gaugefs/i2c-1", &["a gaugefs is mounted"]);
    system.says("warning", "/mnt/x", &["hidden below tmpfs (none)"]);
    system.says("problem", "/run/gaugefs/i2c-2", &["tmpfs (none)", "umount /run/gaugefs/i2c-2"]);
    let lock = |name: &str, text: &str| {
        let path = format!("run/gaugefs/{name}.lock");
        system.write(&path, text);
        let status = fs::metadata(system.0.join(path)).expect("a lock");
        let (major, minor) = (nix::sys::stat::major(status.dev()), nix::sys::stat::minor(status.dev()));
        let pid = text.split_once(' ').map_or(text, |(pid, _)| pid);
        format!("1: FLOCK  ADVISORY  WRITE {pid} {major:02x}:{minor:02x}:{} 0 EOF\n", status.ino())
    };
    let one = lock("i2c-1-55", "42 /run/gaugefs/i2c-1");
    let two = lock("i2c-2-55", "43 /run/gaugefs/i2c-2");
    lock("i2c-3-55", "44 /run/gaugefs/i2c-3");
    let four = lock("i2c-4-55", "45 /run/gaugefs/i2c-4").replace(" 45 ", " 46 ");
    system.write("proc/locks", &(one + &two + &four));
    system.write("proc/42/comm", "gaugefs\n");
    system.says("ok", "lock i2c-1-55", &["process 42 (gaugefs of ", "), mounted at /run/gaugefs/i2c-1"]);
    system.says("warning", "lock i2c-2-55", &["process 43, but nothing is mounted at", "kill 43"]);
    // The process in the file is not the one that holds the lock.
    system.says("ok", "lock i2c-4-55", &["held by process 46"]);
    system.says("ok", "locks", &["1 left over"]);
}

/// A user may mount wherever they like.
#[test]
fn a_mount_point_cannot_add_a_line_to_the_report() {
    let system = System::new();
    system.write(
        "proc/self/mountinfo",
        "40 22 0:36 / /home/bob/x\\012problem\\040\\040Linux:\\040gone rw - fuse.gaugefs gaugefs rw\n",
    );
    let text = String::from_utf8(system.doctor(&[]).stdout).expect("text");
    assert!(text.contains("/home/bob/x\\nproblem  Linux: gone: a gaugefs is mounted there\n"), "{text}");
    assert!(!text.contains("\nproblem"), "{text}");
}

#[test]
fn journals_are_listed() {
    let system = System::new();
    system.write("var/lib/gaugefs/i2c-1-55.journal", "");
    system.write("home/ann/.local/state/gaugefs/i2c-2-55.journal", "");
    let says = ["in progress, or was interrupted", "Mount the gauge"];
    system.says("warning", "/var/lib/gaugefs/i2c-1-55.journal", &says);
    system.says("warning", "/home/ann/.local/state/gaugefs/i2c-2-55.journal", &says);
    system.write("var/lib/gaugefs/i2c-1-55.1.waiting", "");
    let says = ["may be another one", "until its pack has come back"];
    system.says("warning", "/var/lib/gaugefs/i2c-1-55.1.waiting", &says);
    // A seal that is owed beside a write that waits.
    system.write("var/lib/gaugefs/i2c-1-55.seal", "");
    let says = ["left open", "Mount the gauge", "Keep this file"];
    system.says("warning", "/var/lib/gaugefs/i2c-1-55.seal", &says);
}

#[test]
fn configurations_and_key_files_are_checked() {
    let system = System::new();
    let text = "# a pack\n[defaults]\nkey-file = \"pack.keys\"\n[[gauge]]\nname = \"PACK\"\n";
    system.write("etc/gaugefs/i2c-1.toml", text);
    system.says("ok", "/etc/gaugefs/i2c-1.toml", &["one gauge"]);
    system.says("problem", "/etc/gaugefs/pack.keys", &["does not exist"]);
    system.mode("etc/gaugefs/pack.keys", 0o640);
    system.says("problem", "/etc/gaugefs/pack.keys", &["mode 640", "chmod 600"]);
    system.mode("etc/gaugefs/pack.keys", 0o600);
    system.says("ok", "/etc/gaugefs/pack.keys", &["only its owner"]);
    system.says("problem", "gaugefs@.service", &["60-gaugefs.rules is not installed"]);
    system.write("etc/gaugefs/i2c-1.toml", "[defaults]\npol = 10\n[[gauge]]\n");
    system.says("problem", "/etc/gaugefs/i2c-1.toml", &["line 2: pol", "`poll`"]);
    system.write("etc/gaugefs/i2c-1.toml", "poll = 10\n[[gauge]]\n");
    system.says("problem", "/etc/gaugefs/i2c-1.toml", &["line 1: poll", "[defaults]"]);
    system.write("etc/gaugefs/i2c-7.toml", "[[gauge]]\n");
    system.says("warning", "/etc/gaugefs/i2c-7.toml", &["/dev/i2c-7 does not exist"]);
    system.write("etc/gaugefs/gaugefs.toml", "[[gauge]]\nbus = \"/dev/i2c-1\"\n");
    system.says("problem", "/etc/gaugefs/gaugefs.toml", &["mount point"]);
    system.write("etc/gaugefs/gaugefs.toml", "[[gauge]\n");
    system.says("problem", "/etc/gaugefs/gaugefs.toml", &["gaugefs.toml(5)"]);
}

#[test]
fn units_are_listed_with_their_state() {
    let system = System::new();
    system.write("etc/gaugefs/i2c-1.toml", "[[gauge]]\n");
    system.units("");
    system.says("warning", "gaugefs@i2c\\x2d1.service", &["not started", "udevadm trigger /dev/i2c-1"]);
    system.units("gaugefs@i2c\\x2d1.service loaded active running Fuel gauge\n");
    system.says("ok", "gaugefs@i2c\\x2d1.service", &["active (running)"]);
    system.units("gaugefs@i2c\\x2d1.service loaded failed failed Fuel gauge\n");
    system.says("problem", "gaugefs@i2c\\x2d1.service", &["journalctl -u"]);
    system.units("gaugefs@i2c\\x2d1.service loaded inactive dead Fuel gauge\n");
    system.says("ok", "gaugefs@i2c\\x2d1.service", &["inactive (dead)", "systemctl start"]);
}

/// On this machine, because only a real mount can hang or be dead.
#[test]
fn mounts_that_hang_or_are_dead_are_found() {
    if fs::File::options().read(true).write(true).open("/dev/fuse").is_err() {
        eprintln!("SKIPPED: /dev/fuse cannot be opened; no dead mount was checked");
        return;
    }
    let place = crate::room::folder();
    let at = place.to_str().expect("a path in UTF-8");
    let doctor =
        || String::from_utf8(command(&["doctor"]).output().expect("gaugefs runs").stdout).expect("text");
    let mut daemon =
        command(&["mount", "--foreground", "--sim", "bq34z100-g1", at]).spawn().expect("gaugefs runs");
    let start = std::time::Instant::now();
    while !place.join("BAT0").exists() {
        assert!(start.elapsed() < crate::room::LONG, "not mounted");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let alive = doctor();
    let pid = Pid::from_raw(daemon.id() as i32);
    crate::room::stop(daemon.id(), at);
    let hung = doctor();
    kill(pid, Signal::SIGCONT).expect("it runs");
    daemon.kill().expect("it runs");
    daemon.wait().expect("it ends");
    let dead = doctor();
    command(&["umount", at]).status().expect("gaugefs runs");
    let _ = fs::remove_dir(Path::new(at));
    assert!(alive.contains(&format!("ok       {at}: a gaugefs is mounted there\n")), "{alive}");
    assert!(hung.contains(&format!("problem  {at}: a gaugefs whose process does not answer\n")), "{hung}");
    assert!(dead.contains(&format!("problem  {at}: a gaugefs whose process is gone\n")), "{dead}");
    assert!(dead.contains(&format!("gaugefs umount {at}\n")), "{dead}");
}

#[test]
fn the_pins_of_a_raspberry_pi_are_named() {
    let system = System::new();
    let what = "Raspberry Pi 4 Model B Rev 1.4";
    system.write("proc/device-tree/model", &format!("{what}\0"));
    system.says(
        "ok",
        what,
        &["/dev/i2c-1 is on its pins", "SDA is pin 3, SCL pin 5, ground pin 9", "never to 5 V"],
    );
    // The buses of its HDMI sockets are no such bus.
    system.remove("sys/class/i2c-dev/i2c-1");
    system.bus(20, "fef04500.i2c");
    system.says("warning", what, &["is off", "raspi-config nonint do_i2c 0", "dtparam=i2c_arm=on"]);
    system.write("boot/firmware/config.txt", "#dtoverlay=i2c-gpio\n");
    system.says("warning", what, &["is off"]);
    system
        .write("boot/firmware/config.txt", "dtparam=i2c_arm=off\ndtoverlay=i2c-gpio,bus=3,i2c_gpio_sda=2\n");
    system.says("ok", what, &["a bus in software", "pin 3"]);
}
