// SPDX-License-Identifier: MIT

//! What is printed when something is wrong: what happened, to what, and what to do. Each line of `golden/messages` is
//! what a user sees; those of a misused command line are in `golden/misuse`.

use std::fmt::Write as _;
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Child, Stdio};

use nix::errno::Errno;

use super::room::{CHIP, Folder, can_mount, command, gaugefs, run, same_as_golden, within};

/// The files of the folder: name and text.
const FILES: &[(&str, &str)] = &[
    ("empty", ""),
    ("hello.txt", "hello\n"),
    ("data.json", "{\n  \"it-cfg\": 1\n}\n"),
    ("uevent", "POWER_SUPPLY_NAME=BAT0\n"),
    ("broken.toml", "chip = \"bq34z100-g1\"\n[it-cfg]\ncell-terminate-voltage = \n"),
    ("range.toml", "chip = \"bq34z100-g1\"\n[it-cfg]\ncell-terminate-voltage = 9999\n"),
    ("unit.toml", "chip = \"bq34z100-g1\"\n[it-cfg]\ncell-terminate-voltage = \"3.1 V\"\n"),
    ("quoted.toml", "chip = \"bq34z100-g1\"\n[it-cfg]\ncell-terminate-voltage = \"3100\"\n"),
    ("class.toml", "chip = \"bq34z100-g1\"\n[it-config]\ncell-terminate-voltage = 3100\n"),
    (
        "twice.toml",
        "chip = \"bq34z100-g1\"\n[it-cfg]\ncell-terminate-voltage = 1\ncell-terminate-voltage = 2\n",
    ),
    ("other.toml", "chip = \"bq34110\"\n[ccgain]\n"),
    ("open.keys", "unseal = 0414 3672\n"),
    ("good.keys", "unseal = 0414 3672\n"),
    ("all.keys", "authentication = 0123456789abcdeffedcba9876543210\n"),
    ("half.keys", "unseal = 0414\n"),
    ("no-gauge.toml", "[mount]\nmountpoint = \"n\"\n"),
    ("no-source.toml", "[mount]\nmountpoint = \"n\"\n\n[[gauge]]\n"),
    ("no-place.toml", "[[gauge]]\nsim = \"bq34z100-g1\"\n"),
    ("no-such-sim.toml", "[mount]\nmountpoint = \"n\"\n[[gauge]]\nsim = \"bq34z10-g1\"\n"),
    ("address.toml", "[mount]\nmountpoint = \"n\"\n[[gauge]]\nbus = \"/dev/i2c-998\"\naddress = 55\n"),
    ("key.toml", "[mount]\nmountpoint = \"n\"\n[[gauge]]\nsim = \"bq34z100-g1\"\nadress = 0x55\n"),
];

/// Command lines, and words that are written to files of the gauge that is mounted at `m`.
const ACTIONS: &[&str] = &[
    // A value.
    "echo 3100mV > m/BAT0/df/80/53",
    "echo 3100 mV > m/BAT0/df/80/53",
    "echo 3.1V > m/BAT0/df/80/53",
    "echo 3100 mA > m/BAT0/df/80/53",
    "echo 3,1 > m/BAT0/df/80/53",
    "echo 9999 > m/BAT0/df/80/53",
    "echo > m/BAT0/df/80/53",
    "echo on > m/BAT0/df/64/0",
    "echo 25C > m/BAT0/df/2/0",
    "echo 55°C > m/BAT0/df/2/0",
    "echo twelve letters > m/BAT0/df/48/46",
    "echo 3100 > m/BAT0/df/80/54",
    "echo 80/53 3100 > m/BAT0/df/transaction",
    "echo commit > m/BAT0/df/transaction",
    // A subcommand, a seal, a decision.
    "echo RESET > m/BAT0/gauge/control",
    "echo reset > m/BAT0/gauge/control",
    "echo 0x0041 > m/BAT0/gauge/control",
    "echo SEAL > m/BAT0/gauge/control",
    "echo Sealed > m/BAT0/gauge/control",
    "echo unseal > m/BAT0/gauge/control",
    "echo ROM_MODE > m/BAT0/gauge/control",
    "echo CAL_ENABLE > m/BAT0/gauge/control",
    "echo xyz > m/BAT0/gauge/control",
    "echo open > m/BAT0/gauge/seal",
    "echo maybe > m/BAT0/gauge/settle",
    "echo 3s > m/BAT0/gauge/poll_interval",
    "echo 0.1 > m/BAT0/gauge/poll_interval",
    "echo volts > m/BAT0/gauge/calibrate",
    // A path that is not a gauge's.
    "gaugefs export m/BAT0/df",
    "gaugefs import m range.toml",
    "gaugefs keys change m unseal --key-file open.keys --new-key-file open.keys",
    "gaugefs auth m --key-file good.keys",
    "gaugefs export hello.txt",
    "gaugefs import m/BAT0/df range.toml",
    "gaugefs export d",
    "gaugefs export d/BAT0",
    "gaugefs diff d/BAT0 m/BAT0",
    "gaugefs settle d/BAT0",
    "gaugefs report d/BAT0",
    "gaugefs top --json --count 1 d/BAT0",
    "gaugefs top --json --count 1 none",
    "gaugefs log d/BAT0 --count 1",
    // A file.
    "gaugefs lint none.toml",
    "gaugefs lint empty",
    "gaugefs lint hello.txt",
    "gaugefs lint data.json",
    "gaugefs lint uevent",
    "gaugefs import m/BAT0 hello.txt",
    "gaugefs lint broken.toml",
    "gaugefs import m/BAT0 range.toml",
    "gaugefs import m/BAT0 unit.toml",
    "gaugefs import m/BAT0 quoted.toml",
    "gaugefs import m/BAT0 class.toml",
    "gaugefs import m/BAT0 twice.toml",
    "gaugefs import m/BAT0 other.toml",
    "gaugefs plot hello.txt",
    "gaugefs plot none.csv",
    // A mount.
    "gaugefs mount --sim bq34z100-g1 m",
    "gaugefs mount --sim bq34z100-g1 m/BAT0/df",
    "gaugefs mount --sim bq34z100-g1 m/BAT0/new",
    "gaugefs mount --sim bq34z100-g1 m/new",
    "gaugefs mount --sim bq34z100-g1 hello.txt",
    "gaugefs mount --sim bq34z100-g1 --private --group root n",
    "gaugefs mount --sim bq34z100-g1 --key-file none.keys n",
    "gaugefs mount --sim bq34z100-g1 --key-file open.keys n",
    "gaugefs mount --sim bq34z100-g1 --key-file half.keys n",
    "gaugefs mount --replay hello.txt n",
    "gaugefs mount --config none.toml",
    "gaugefs mount --config no-gauge.toml",
    "gaugefs mount --config no-source.toml",
    "gaugefs mount --config no-place.toml",
    "gaugefs mount --config no-such-sim.toml",
    "gaugefs mount --config address.toml",
    "gaugefs mount --config key.toml",
    "gaugefs umount /proc",
];

/// Whoever runs the tests has other numbers.
fn plain(text: &str, folder: &Folder) -> String {
    let text = text.replace(&folder.file("").trim_end_matches('/').to_string(), "DIR");
    // A line of last_error begins with its time.
    let is_time = |word: &str| word.len() == 21 && word.starts_with("20") && word.ends_with("Z:");
    let lines =
        text.lines().map(|line| line.split(' ').filter(|word| !is_time(word)).collect::<Vec<_>>().join(" "));
    lines.map(|line| line + "\n").collect()
}

fn act(action: &str, folder: &Folder) -> String {
    let at = |path: &str| Path::new(&folder.file(path)).to_path_buf();
    if let Some(words) = action.strip_prefix("gaugefs ") {
        let mut command = command(&words.split(' ').collect::<Vec<_>>());
        command.current_dir(&folder.0);
        let ran = run(command);
        assert_ne!(ran.code, Some(0), "{action}: {}", ran.out);
        return ran.err;
    }
    let words = action.strip_prefix("echo").expect("an action");
    let (value, file) = words.split_once(" > ").expect("an action");
    let error = fs::write(at(file), format!("{}\n", value.trim())).expect_err(action);
    let told = fs::read_to_string(at("m/BAT0/gauge/last_error")).expect("the last error");
    format!("{:?}: {told}", Errno::from_raw(error.raw_os_error().unwrap_or_default()))
}

fn mounted_in_foreground(folder: &Folder, name: &str) -> Child {
    let at = folder.file(name);
    let mut daemon = command(&["mount", "-f", "--sim", CHIP, &at]);
    let daemon = daemon.stderr(Stdio::null()).spawn().expect("gaugefs runs");
    within("mounted", || Path::new(&at).join("BAT0").exists());
    daemon
}

#[test]
fn golden_messages_say_what_and_why_and_what_to_do() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    for (name, text) in FILES {
        fs::write(folder.file(name), text).expect("a file");
    }
    for name in ["good.keys", "all.keys", "half.keys"] {
        fs::set_permissions(folder.file(name), Permissions::from_mode(0o600)).expect("its mode");
    }
    fs::set_permissions(folder.file("open.keys"), Permissions::from_mode(0o644)).expect("its mode");
    gaugefs(&["mount", "--sim", CHIP, &folder.file("m")]).done();
    // A daemon that has died.
    let mut daemon = mounted_in_foreground(&folder, "d");
    daemon.kill().and_then(|()| daemon.wait()).expect("it ends");
    let mut now = String::new();
    for action in ACTIONS {
        write!(now, "$ {action}\n{}\n", plain(&act(action, &folder), &folder)).expect("a string");
    }
    gaugefs(&["umount", &folder.file("d")]).done();
    gaugefs(&["umount", &folder.file("m")]).done();
    assert!(ACTIONS.len() >= 50);
    // No message without a subject, and none of an empty one.
    for line in now.lines().filter(|line| !line.starts_with('$')) {
        assert!(!line.contains(": : ") && !line.contains("gaugefs: :"), "{line}");
    }
    same_as_golden("messages", &now);
}

/// The case of a name does not matter.
#[test]
fn a_seal_may_be_written_in_capitals() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    let seal = Path::new(&at).join("BAT0/gauge/seal");
    for (written, read) in [("UNSEALED", "unsealed"), ("Sealed", "sealed")] {
        fs::write(&seal, written).expect(written);
        assert_eq!(fs::read_to_string(&seal).expect("the seal").trim(), read);
    }
    gaugefs(&["umount", &at]).done();
}

#[test]
fn a_path_without_a_mount_is_told_where_gauges_are() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    let place = format!("{at}/BAT0");
    let none = folder.file("none");
    gaugefs(&["export", &none])
        .failed(&["none: not a mounted gauge: it does not exist", "gauges are mounted at"]);
    gaugefs(&["export", "/etc"]).failed(&["/etc: not a mounted gauge: no gaugefs is mounted there", "/BAT0"]);
    assert!(Path::new(&place).exists());
    gaugefs(&["umount", &at]).done();
}

/// The command itself is not among those that hold the mount, and whoever stands in it is told to leave.
#[test]
fn an_unmount_from_inside_the_mount_says_so() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    let mut inside = command(&["umount", &at]);
    inside.current_dir(Path::new(&at).join("BAT0"));
    let ran = run(inside);
    assert!(!ran.err.contains("(gaugefs)"), "{}", ran.err);
    ran.failed(&["in use; try again after `cd`, from outside of it"]);
    // The shell that has started it is.
    let script = "cd \"$1/BAT0\" && \"$0\" umount \"$1\"; true";
    let shell =
        std::process::Command::new("sh").args(["-c", script, env!("CARGO_BIN_EXE_gaugefs"), &at]).output();
    let said = String::from_utf8(shell.expect("a shell").stderr).expect("text");
    assert!(said.contains("(sh, which has started this command); try again after `cd`"), "{said}");
    assert!(!said.contains("(gaugefs)"), "{said}");
    gaugefs(&["umount", &at]).done();
}

/// Any `gaugefs list` or `doctor` looks into all mounts. It ends by itself, so it is nothing that a user could free.
#[test]
fn regression_a_look_at_a_mount_was_named_as_its_user() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", CHIP, &at]).done();
    let inside = || Path::new(&at).join("BAT0");
    // The kernel calls a process after its file.
    let name = folder.file("gaugefs-look");
    std::os::unix::fs::symlink("/bin/sleep", &name).expect("a link");
    let look = std::process::Command::new(&name).arg("600").current_dir(inside()).spawn();
    let mut look = look.expect("a process that has the name of a look");
    let mut umount = command(&["umount", &at]);
    umount.current_dir(inside());
    let ran = run(umount);
    look.kill().expect("it is there");
    look.wait().expect("it ends");
    ran.failed(&["in use; try again after `cd`, from outside of it"]);
    gaugefs(&["umount", &at]).done();
}
