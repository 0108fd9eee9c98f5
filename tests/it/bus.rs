// SPDX-License-Identifier: MIT

//! `gaugefs sim`: simulated gauges as a bus of other programs, by a path and in the `/dev` of a command.

use std::fs::{self, File};
use std::io::Read;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use gauge_bus::AdapterModel;
use gauge_bus::linux::Adapter;
use i2c_server::FUNCTIONS;
use i2cdev::core::{I2CDevice, I2CMessage, I2CTransfer};
use i2cdev::linux::{LinuxI2CDevice, LinuxI2CError, LinuxI2CMessage};
use nix::errno::Errno;
use nix::sys::signal::{Signal, kill};
use nix::unistd::{Pid, geteuid};

use super::room::{
    CHIP, Folder, Ran, Server, apart, as_nobody, can_mount, command, gaugefs, ioctls, open_fuse, run,
    users_can_mount, within,
};

fn voltage(device: &mut LinuxI2CDevice) -> u16 {
    device.smbus_read_word_data(0x08).expect("Voltage()")
}

/// Whether a command can have namespaces of its own here.
fn has_namespaces() -> bool {
    let flags: &[&str] = if geteuid().is_root() { &["-m"] } else { &["-Um"] };
    let has = Command::new("unshare").args(flags).arg("true").status().is_ok_and(|status| status.success());
    if !has {
        eprintln!("SKIPPED: this machine forbids namespaces; no command had a /dev of its own");
    }
    has
}

#[test]
fn a_program_uses_the_bus_by_its_path() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let mut server = Server::start(&folder, &[CHIP, "bq27220@0x56"]);
    let mut first = server.device(0x55);
    assert_eq!(voltage(&mut first), 3855);
    assert_eq!(first.smbus_read_i2c_block_data(0x08, 2).expect("a block"), [0x0f, 0x0f]);
    first.write(&[0x08]).expect("a plain write");
    let mut word = [0; 2];
    first.read(&mut word).expect("a plain read");
    assert_eq!(u16::from_le_bytes(word), 3855);
    let mut pair = [LinuxI2CMessage::write(&[0x08]), LinuxI2CMessage::read(&mut word)];
    assert_eq!(first.transfer(&mut pair).expect("a transfer"), 2);
    assert_eq!(u16::from_le_bytes(word), 3855);
    let mut second = server.device(0x56);
    assert!((3000..4300).contains(&voltage(&mut second)));
    // Each open file has an address of its own.
    assert_eq!(voltage(&mut first), 3855);
    let error = server.device(0x54).smbus_read_byte().expect_err("nothing is there").to_string();
    assert!(error.contains("ENXIO"), "{error}");
    drop((first, second));
    server.ends(Signal::SIGTERM);
}

/// The file system of the path stays usable, and the other programs go on, whatever one program does.
#[test]
fn a_program_that_dies_or_hangs_disturbs_no_other() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let mut server = Server::start(&folder, &[CHIP]);
    let mut device = server.device(0x55);
    // One is stopped and one killed, each with the file open.
    let reader = format!("exec 3<>'{}'; echo open; while :; do sleep 1; done", server.path);
    let mut others: Vec<Child> = (0..2)
        .map(|_| {
            let mut other = Command::new("bash");
            other.args(["-c", &reader]).stdout(Stdio::piped()).process_group(0);
            let mut other = other.spawn().expect("bash runs");
            other.stdout.as_mut().expect("a pipe").read_exact(&mut [0; 5]).expect("it is open");
            other
        })
        .collect();
    let send = |other: &Child, signal| kill(Pid::from_raw(-(other.id() as i32)), signal).expect("it runs");
    send(&others[0], Signal::SIGSTOP);
    send(&others[1], Signal::SIGKILL);
    assert_eq!(voltage(&mut device), 3855);
    // 256 files may be open; then others are refused until one is closed.
    let mut open = Vec::new();
    let refused = loop {
        match File::options().read(true).write(true).open(&server.path) {
            Ok(file) => open.push(file),
            Err(error) => break error,
        }
    };
    assert_eq!(refused.raw_os_error(), Some(nix::errno::Errno::ENFILE as i32));
    assert_eq!(voltage(&mut device), 3855);
    drop(open);
    within("a file is closed", || File::options().read(true).write(true).open(&server.path).is_ok());
    // It ends although the file is open.
    server.ends(Signal::SIGINT);
    assert!(device.smbus_read_word_data(0x08).is_err());
    for other in &mut others {
        send(other, Signal::SIGKILL);
        other.wait().expect("a child");
    }
}

#[test]
fn what_a_killed_server_has_left_is_replaced() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let mut server = Server::start(&folder, &[CHIP]);
    server.child.kill().expect("it runs");
    server.child.wait().expect("a child");
    let mut again = Server::start(&folder, &[CHIP]);
    assert_eq!(voltage(&mut again.device(0x55)), 3855);
    // A second one is refused, and so is a file with content.
    gaugefs(&["sim", CHIP, &again.path]).failed(&["something is mounted there"]);
    fs::write(folder.file("text"), "text").expect("a file");
    gaugefs(&["sim", CHIP, &folder.file("text")]).failed(&["not an empty file"]);
    kill(Pid::from_raw(again.child.id() as i32), Signal::SIGTERM).expect("it runs");
    again.child.wait().expect("a child");
}

#[test]
fn regression_who_has_the_state_of_a_bus_was_told_to_be_mounted_at_the_root() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let state = folder.file("state");
    let server = Server::start(&folder, &[CHIP, "--state", &state]);
    let who = format!("{state}: in use by process {} (gaugefs of ", server.child.id());
    let end = format!("end it: kill {}", server.child.id());
    let refused = gaugefs(&["sim", CHIP, "--state", &state, "--", "true"]);
    assert!(!refused.err.contains("umount"), "{}", refused.err);
    refused.failed(&[&who, &end]);
}

#[test]
fn the_knobs_act_on_the_gauges_of_the_bus() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let knobs = folder.file("knobs");
    let mut server = Server::start(&folder, &[CHIP, "--knobs", &knobs, "--fast"]);
    let mut device = server.device(0x55);
    let set = |name: &str, text: &str| fs::write(format!("{knobs}/{name}"), text);
    set("voltage_mv", "3210\n").expect("a knob");
    within("the voltage follows", || {
        server.device(0x55).smbus_read_word_data(0x08).is_ok_and(|voltage| voltage == 3210)
    });
    assert_eq!(fs::read_to_string(format!("{knobs}/voltage_mv")).expect("a knob"), "3210\n");
    set("power", "off\n").expect("a knob");
    assert!(device.smbus_read_word_data(0x08).is_err());
    let refused = set("voltage_mv", "nonsense\n").expect_err("refused");
    assert_eq!(refused.raw_os_error(), Some(nix::errno::Errno::EINVAL as i32));
    let listed = fs::read_dir(&knobs).expect("a folder").count();
    assert!(listed > 30, "{listed} knobs");
    drop(device);
    server.ends(Signal::SIGTERM);
    assert!(!Path::new(&knobs).exists());
}

/// As a CP2112 and an FT260 answer at an address without a target.
#[test]
fn regression_nobody_at_0x0b_hid_the_gauge_at_0x55() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let knobs = folder.file("knobs");
    let server = Server::start(&folder, &[CHIP, "--knobs", &knobs, "--fast"]);
    let set = |name: &str, text: &str| fs::write(format!("{knobs}/{name}"), text).expect("a knob");
    for (nack, says) in [("etimedout", "the bus timed out"), ("eio", "Input/output error")] {
        set("nack_as", nack);
        let ran = gaugefs(&["probe", "--bus", &server.path]);
        assert_eq!(ran.code, Some(0), "{}", ran.out);
        for word in ["maybe ", "failed", says, "gaugefs probe --bus"] {
            assert!(ran.out.contains(word), "{nack}: no {word} in:\n{}", ran.out);
        }
        let report: serde_json::Value =
            serde_json::from_str(&gaugefs(&["probe", "--json", "--bus", &server.path]).out).expect("JSON");
        let states = [0, 1].map(|at| report["found"][at]["state"].clone());
        assert_eq!(states, ["maybe", "failed"], "{report}");
    }
    set("power", "off");
    gaugefs(&["probe", "--bus", &server.path]).failed(&["Input/output error"]);
}

/// What a call on a bus returns, or its errno.
fn outcome<T>(called: Result<T, LinuxI2CError>) -> Result<T, Errno> {
    called.map_err(|error| match error {
        LinuxI2CError::Errno(number) => Errno::from_raw(number),
        LinuxI2CError::Io(error) => Errno::from_raw(error.raw_os_error().expect("an errno")),
    })
}

fn functions(server: &Server) -> u64 {
    Adapter::find(Path::new(&server.path)).and_then(|bus| bus.capabilities()).expect("I2C_FUNCS")
}

/// As the kernel's drivers answered when they were run.
#[test]
fn a_bus_behind_an_adapter_has_its_limits_errors_and_functions() {
    if !can_mount() {
        return;
    }
    let server = |name| {
        let folder = Folder::new();
        let server = Server::start(&folder, &[CHIP, "--adapter", name, "--fast"]);
        (folder, server)
    };
    let rdwr = |device: &mut LinuxI2CDevice, mut messages: Vec<LinuxI2CMessage<'_>>| {
        outcome(device.transfer(&mut messages))
    };
    let (block, mut word) = ([0x40; 300], [0; 2]);
    let write = |length| vec![LinuxI2CMessage::write(&block[..length])];
    {
        let (_folder, server) = server("cp2112");
        let mut gauge = server.device(0x55);
        assert_eq!(functions(&server), 0x0ffe_8001 & FUNCTIONS);
        assert_eq!(voltage(&mut gauge), 3855);
        assert_eq!(outcome(server.device(0x54).smbus_read_byte()), Err(Errno::ETIMEDOUT), "nobody is there");
        assert_eq!(rdwr(&mut gauge, write(62)), Err(Errno::EINVAL));
        assert_eq!(rdwr(&mut gauge, write(256)), Ok(1), "as no byte, with success");
        let three = vec![
            LinuxI2CMessage::write(&[8]),
            LinuxI2CMessage::read(&mut word),
            LinuxI2CMessage::write(&[8]),
        ];
        assert_eq!(rdwr(&mut gauge, three), Err(Errno::EOPNOTSUPP));
    }
    {
        let (_folder, server) = server("i801");
        let mut gauge = server.device(0x55);
        assert_eq!(functions(&server), 0x1fff_8008 & (FUNCTIONS | 0x0100_0000));
        assert_eq!(voltage(&mut gauge), 3855);
        assert_eq!(gauge.smbus_read_i2c_block_data(0x08, 2).expect("a block"), [0x0f, 0x0f]);
        assert_eq!(rdwr(&mut gauge, write(1)), Err(Errno::EOPNOTSUPP));
        assert_eq!(outcome(gauge.write(&[0x08])), Err(Errno::EOPNOTSUPP));
        assert_eq!(outcome(gauge.read(&mut [0; 2])), Err(Errno::EOPNOTSUPP));
    }
    {
        let (_folder, server) = server("piix4");
        let mut gauge = server.device(0x55);
        assert_eq!(voltage(&mut gauge), 3855);
        assert_eq!(outcome(gauge.smbus_read_i2c_block_data(0x08, 2)), Err(Errno::EOPNOTSUPP));
    }
    let (_folder, server) = server("bcm2835");
    assert_eq!(outcome(server.device(0x54).smbus_read_byte()), Err(Errno::EREMOTEIO));
    let three =
        vec![LinuxI2CMessage::write(&[8]), LinuxI2CMessage::read(&mut word), LinuxI2CMessage::write(&[8])];
    assert_eq!(rdwr(&mut server.device(0x55), three), Ok(3));
}

#[test]
fn an_unknown_adapter_is_answered_with_the_known_ones() {
    let ran = gaugefs(&["sim", CHIP, "--adapter", "cp2113", "./bus"]);
    assert_eq!(ran.code, Some(2));
    for model in AdapterModel::all() {
        assert!(ran.err.contains(model.name), "{}: {}", model.name, ran.err);
    }
    let help = gaugefs(&["mount", "--help"]).out.split_whitespace().collect::<Vec<_>>().join(" ");
    let names: Vec<_> = AdapterModel::all().map(|model| model.name).collect();
    assert!(help.contains(&format!("pace: {} [default", names.join(", "))), "{names:?}");
}

/// gaugefs reads and writes a gauge behind any of them.
#[test]
fn a_simulated_gauge_is_mounted_behind_any_adapter() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    for model in AdapterModel::all() {
        gaugefs(&["mount", "--sim", CHIP, "--sim-adapter", model.name, "--fast", &at]).done();
        let file = |name: &str| format!("{at}/BAT0/{name}");
        let written = fs::write(file("df/80/53"), "3100\n").map_err(|error| error.raw_os_error());
        // A host with words alone cannot write a block as a whole.
        let (expected, shown) =
            if model.name == "piix4" { (Err(Some(30)), "3000") } else { (Ok(()), "3100") };
        assert_eq!(written, expected, "{}", model.name);
        assert_eq!(fs::read_to_string(file("df/80/53")).expect("a value").trim(), shown, "{}", model.name);
        gaugefs(&["umount", &at]).done();
    }
}

#[test]
fn a_command_has_the_bus_in_its_own_dev_and_gives_its_exit_code() {
    if !can_mount() || !has_namespaces() {
        return;
    }
    apart();
    let with = |script: &str| run(command(&["sim", CHIP, "--fast", "--", "bash", "-c", script]));
    let out = with(
        r#"[ "$I2C_DEV" = "/dev/i2c-$I2C_BUS" ] && stat -c '%F %a' "$I2C_DEV" && test -c /dev/null && echo ok"#,
    );
    assert_eq!(out.done(), "regular empty file 600\nok\n");
    assert_eq!(with("exit 7").code, Some(7));
    assert_eq!(with("kill -TERM $$").code, Some(128 + 15));
    assert_eq!(with("kill -KILL $$").code, Some(128 + 9));
    for path in [&[][..], &["./bus-of-a-test"]] {
        let ran = gaugefs(&[&["sim", CHIP, "--fast"], path, &["--", "no-such-program"]].concat());
        assert_eq!((ran.code, ran.err.contains("no such program")), (Some(127), true), "{}", ran.err);
    }
    assert!(!Path::new("bus-of-a-test").exists());
    // With a path the command finds the bus there.
    let folder = Folder::new();
    let script = r#"gauge=$(od -An -tx1 -N1 "$I2C_DEV" 2>&1); echo "${I2C_BUS-none} $I2C_DEV""#;
    let ran = gaugefs(&["sim", CHIP, "--fast", &folder.file("bus"), "--", "bash", "-c", script]);
    assert_eq!(ran.done(), format!("none {}\n", folder.file("bus")));
    assert!(!Path::new(&folder.file("bus")).exists());
    // A signal goes to the command.
    let mut server = command(&[
        "sim",
        CHIP,
        "--fast",
        "--",
        "bash",
        "-c",
        "trap 'kill $!; exit 9' TERM; sleep 60 & echo; wait",
    ]);
    let mut server = server.stdout(Stdio::piped()).spawn().expect("gaugefs runs");
    server.stdout.as_mut().expect("a pipe").read_exact(&mut [0]).expect("the command runs");
    kill(Pid::from_raw(server.id() as i32), Signal::SIGTERM).expect("it runs");
    assert_eq!(server.wait().expect("a child").code(), Some(9));
}

/// In a user namespace nobody owns the file until the kernel has asked who does, and what nobody owns is not opened for
/// writing.
#[test]
fn regression_the_bus_of_an_ordinary_user_could_not_be_opened_before_it_was_looked_at() {
    if !can_mount() || !geteuid().is_root() {
        eprintln!("SKIPPED: this test becomes another user, which only root may");
        return;
    }
    let namespaces = Command::new("unshare").args(["-Um", "true"]).uid(65534).gid(65534).status();
    if !namespaces.is_ok_and(|status| status.success()) {
        eprintln!("SKIPPED: ordinary users have no namespaces here; none had a /dev of its own");
        return;
    }
    let folder = Folder::new();
    open_fuse(&folder);
    let opened = ["sim", CHIP, "--fast", "--", "sh", "-c", "exec 3<>$I2C_DEV && echo opened"];
    let mut command = as_nobody(&folder, &opened);
    // A command's own bus is mounted in a user namespace.
    command.env("FUSERMOUNT_PATH", "/nonexistent/fusermount3");
    assert_eq!(run(command).done(), "opened\n");
}

/// What it does not have is not acknowledged, so a mount has to be told which chip it is: who looks for that reads other
/// registers than a mount does.
#[test]
fn a_recording_is_a_gauge_of_the_bus() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, trace) = (folder.file("m"), folder.file("trace"));
    gaugefs(&["mount", "--sim", CHIP, "--poll", "0.5", "--trace", &trace, &at]).done();
    let read = |name: &str| fs::read_to_string(format!("{at}/BAT0/{name}")).expect("a value");
    within("three polls", || read("gauge/statistics/polls").trim_end() >= "3");
    let shown = read("voltage_now");
    gaugefs(&["umount", &at]).done();
    let mut server = Server::start(&folder, &["--replay", &trace, "--fast"]);
    let mut device = server.device(0x55);
    assert_eq!(voltage(&mut device), 3855);
    assert!(device.smbus_write_byte_data(0x40, 1).is_err(), "a recording cannot be changed");
    assert_eq!(voltage(&mut device), 3855);
    drop(device);
    gaugefs(&["mount", "--chip", CHIP, "--bus", &server.path, &at]).done();
    assert_eq!(read("voltage_now"), shown);
    gaugefs(&["umount", &at]).done();
    server.ends(Signal::SIGTERM);
}

/// gaugefs on its own bus shows what it shows of a gauge that it simulates itself, and writes as it does there.
#[test]
fn a_gauge_is_mounted_from_its_bus_as_without_one() {
    if !can_mount() || !has_namespaces() {
        return;
    }
    apart();
    let folder = Folder::new();
    // Every file but those of the simulated gauge's knobs, after a write.
    let script = r#"
set -u
mount=$1; shift
"$gaugefs" mount --poll 3600 --state-dir "$mount.state" "$@" "$mount" || exit
cd "$mount/BAT0"
echo 3100 > df/80/53 || echo write failed
# The second poll reads what no attribute needs.
until [ "$(cat gauge/statistics/polls)" -ge 2 ] && [ -e gauge/registers/true_rc ]; do sleep 0.1; done
# But what counts time and this mount's own transfers, and what is drawn.
find . -type f ! -path './sim/*' ! -path './gauge/report' ! -path './gauge/last_error*' ! -name age_ms ! -name presence ! -path './gauge/*values' \
    ! -path '*/statistics/*' ! -name '*backup*' ! -name '*state_time*' |
    sort | timeout 300 xargs -d '\n' head -v -c 1000000 2>&1 | cat -v
cd /
"$gaugefs" umount "$mount"
"#;
    let bash = |source: &[&str], name: &str| {
        let at = folder.file(name);
        [&["bash", "-c", script, "bash", &at], source].concat().iter().map(|&word| word.to_string()).collect()
    };
    let list = |ran: &mut Command| {
        let output = ran.env("gaugefs", env!("CARGO_BIN_EXE_gaugefs")).output().expect("it runs");
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
        text.lines().map(str::to_string).collect::<Vec<_>>()
    };
    let words: Vec<String> = bash(&["--sim", CHIP], "m");
    let simulated = list(Command::new(&words[0]).args(&words[1..]));
    let shell: Vec<String> = bash(&["--chip", CHIP, "--bus", "$I2C_DEV"], "n");
    // The path is known to the command only.
    let quoted =
        shell.iter().map(|word| if word == "$I2C_DEV" { "\"$I2C_DEV\"".into() } else { quote(word) });
    let line = quoted.collect::<Vec<_>>().join(" ");
    let served = list(&mut command(&["sim", CHIP, "--", "sh", "-c", &line]));
    assert!(simulated.len() > 250, "{simulated:#?}");
    let different: Vec<_> =
        simulated.iter().zip(&served).filter(|(simulated, served)| simulated != served).collect();
    assert!(different.is_empty() && simulated.len() == served.len(), "{different:#?}");
}

fn quote(word: &str) -> String {
    format!("'{}'", word.replace('\'', r"'\''"))
}

/// The path on which i2c-tools are, which somebody else wrote; none if they cannot be used here.
fn path_of_i2c_tools() -> Option<String> {
    if !can_mount() || !has_namespaces() {
        return None;
    }
    apart();
    let path = format!("{}:/usr/sbin:/sbin", std::env::var("PATH").unwrap_or_default());
    let is_there = Command::new("i2cdetect").arg("-V").env("PATH", &path).output().is_ok();
    if !is_there {
        eprintln!("SKIPPED: i2c-tools is missing; to run all tests: sudo apt-get install i2c-tools");
    }
    is_there.then_some(path)
}

#[test]
fn i2c_tools_work() {
    let Some(path) = path_of_i2c_tools() else { return };
    let with = |script: &str| {
        let mut command = command(&["sim", CHIP, "--fast", "--", "bash", "-c", script]);
        command.env("PATH", &path);
        run(command)
    };
    assert_eq!(with("i2cget -y $I2C_BUS 0x55 0x08 w").done(), "0x0f0f\n");
    assert_eq!(with("i2ctransfer -y $I2C_BUS w1@0x55 0x08 r2").done(), "0x0f 0x0f\n");
    let scan = with("i2cdetect -y $I2C_BUS").done();
    assert_eq!(scan.matches(" 55").count() + scan.matches("--").count(), 112, "{scan}");
    assert!(scan.contains("50: -- -- -- -- -- 55 --"), "{scan}");
    // The packet error code that the gauge does not have.
    assert_ne!(with("i2cget -y $I2C_BUS 0x55 0x08 wp").code, Some(0));
    let offered = with("i2cdetect -F $I2C_BUS").done();
    let lacks: Vec<&str> = offered.lines().filter(|line| line.ends_with(" no")).collect();
    assert_eq!(lacks.len(), 2, "{offered}");
    assert!(
        lacks.iter().all(|line| line.contains("SMBus Block Read") || line.contains("Block Process Call"))
    );
    let dump = with("i2cdump -y $I2C_BUS 0x55 w").out;
    assert!(dump.contains("08: 0f0f"), "{dump}");
    // 0x00 to 0x01 is Control(): CONTROL_STATUS is asked for by a write of two bytes.
    assert_eq!(
        with("i2cset -y $I2C_BUS 0x55 0x00 0x0001 w && i2cget -y $I2C_BUS 0x55 0x00 w").done(),
        "0x0100\n"
    );
}

/// Each word, with its packet error code and without, and a text.
#[test]
fn i2c_tools_read_of_a_pack_what_a_mount_shows() {
    const SCRIPT: &str = r#"
set -eu
folder=$1
echo 900 >"$folder/knobs/load_ma"
sleep 1
echo 0 >"$folder/knobs/speed"
"$gaugefs" mount --bus "$I2C_DEV" --chip sbs --poll 1 "$folder/m"
until [ -e "$folder/m/BAT0/cycle_count" ]; do sleep 0.1; done
get() { printf '%d' "$(i2cget -y "$I2C_BUS" 0x0b "$@")"; }
for each in 01:remaining_capacity_alarm 02:remaining_time_alarm 03:battery_mode 08:temperature 09:voltage 0a:current 0b:average_current \
    0c:max_error 0d:relative_state_of_charge 0e:absolute_state_of_charge 0f:remaining_capacity 10:full_charge_capacity \
    11:run_time_to_empty 12:average_time_to_empty 13:average_time_to_full 14:charging_current 15:charging_voltage 16:battery_status \
    17:cycle_count 18:design_capacity 19:design_voltage 1a:specification_info 1b:manufacture_date 1c:serial_number 3c:cell_voltage4 \
    3d:cell_voltage3 3e:cell_voltage2 3f:cell_voltage1; do
    shown=$(cat "$folder/m/BAT0/gauge/registers/${each#*:}")
    echo "$each $(get 0x${each%:*} w) $(get 0x${each%:*} wp) $((shown & 65535))"
done
cd "$folder/m/BAT0"
echo "voltage $(($(get 0x09 w) * 1000)) $(($(get 0x09 wp) * 1000)) $(cat voltage_now)"
echo "charge $(($(get 0x0f w) * 1000)) $(($(get 0x0f wp) * 1000)) $(cat charge_now)"
echo "temp $(($(get 0x08 w) - 2731)) $(($(get 0x08 wp) - 2731)) $(cat temp)"
name=$(for byte in $(i2ctransfer -y "$I2C_BUS" w1@0x0b 0x21 r9 | cut -d ' ' -f 2-); do printf "\\x${byte#0x}"; done)
echo "name $name $name $(cat model_name)"
cd /
"$gaugefs" umount "$folder/m"
echo missing >"$folder/knobs/pec"
i2cget -y "$I2C_BUS" 0x0b 0x09 w >/dev/null
! i2cget -y "$I2C_BUS" 0x0b 0x09 wp 2>/dev/null
"#;
    let Some(path) = path_of_i2c_tools() else { return };
    let folder = Folder::new();
    let knobs = folder.file("knobs");
    let mut server = command(&[
        "sim",
        "sbs",
        "--fast",
        "--knobs",
        &knobs,
        "--",
        "bash",
        "-c",
        SCRIPT,
        "bash",
        &folder.file(""),
    ]);
    server.env("PATH", &path).env("gaugefs", env!("CARGO_BIN_EXE_gaugefs"));
    let shown = run(server).done();
    let lines: Vec<Vec<&str>> = shown.lines().map(|line| line.split(' ').collect()).collect();
    assert_eq!(lines.len(), 32, "{shown}");
    for line in lines {
        assert!(line.len() == 4 && line[1..].iter().all(|value| *value == line[1]), "{line:?}");
    }
}

#[test]
fn smbus2_works() {
    const PROGRAM: &str = r#"
import os, smbus2

with smbus2.SMBus(int(os.environ["I2C_BUS"])) as bus:
    def refused(call, *arguments):
        try:
            call(*arguments)
        except OSError as error:
            return error.errno

    both = [smbus2.i2c_msg.write(0x55, [0x08]), smbus2.i2c_msg.read(0x55, 2)]
    bus.i2c_rdwr(*both)
    print(bus.read_word_data(0x55, 0x08), bus.read_i2c_block_data(0x55, 0x08, 4), list(both[1]))
    # Control(), and which firmware.
    bus.write_word_data(0x55, 0x00, 0x0002)
    print(bus.read_word_data(0x55, 0x00), bus.read_byte_data(0x55, 0x02))
    bus.write_i2c_block_data(0x55, 0x00, [0x01, 0x00])
    bus.write_byte(0x55, 0x00)
    print(hex(bus.read_byte(0x55) | bus.read_byte(0x55) << 8))
    print(refused(bus.read_byte_data, 0x54, 0x08), refused(bus.read_block_data, 0x55, 0x08))
    bus.pec = 1
    print(refused(bus.read_word_data, 0x55, 0x08))
    print(bool(bus.funcs & smbus2.I2cFunc.I2C), bool(bus.funcs & smbus2.I2cFunc.SMBUS_READ_BLOCK_DATA))
"#;
    if !can_mount() || !has_namespaces() {
        return;
    }
    apart();
    // Another Python may come before the system's, which has the package.
    let has = |python: &&str| {
        let ran = Command::new(python).args(["-c", "import smbus2"]).output();
        ran.is_ok_and(|ran| ran.status.success())
    };
    let Some(python) = ["python3", "/usr/bin/python3"].into_iter().find(has) else {
        eprintln!("SKIPPED: smbus2 is missing; to run all tests: sudo apt-get install python3-smbus2");
        return;
    };
    let shown = run(command(&["sim", CHIP, "--fast", "--", python, "-c", PROGRAM])).done();
    // ENXIO, EOPNOTSUPP, and EBADMSG for a packet error code that the gauge does not have.
    assert_eq!(shown, "3855 [15, 15, 0, 0] [15, 15]\n22 60\n0x100\n6 95\n74\nTrue False\n");
}

/// An account without any right, which mounts with fusermount3 or in a user namespace.
#[test]
fn an_ordinary_user_has_a_bus() {
    if !users_can_mount() {
        return;
    }
    if !geteuid().is_root() {
        eprintln!("SKIPPED: only root can try what another user may do");
        return;
    }
    apart();
    let folder = Folder::new();
    fs::set_permissions(&folder.0, fs::Permissions::from_mode(0o777)).expect("its mode");
    fs::copy(env!("CARGO_BIN_EXE_gaugefs"), folder.file("gaugefs")).expect("a copy that any user may run");
    let script = r#"
set -u
cd "$1"
mknod -m 666 fuse c 10 229 && mount --bind fuse /dev/fuse
user() { setpriv --reuid 65534 --regid 65534 --clear-groups env -u XDG_RUNTIME_DIR HOME="$PWD/home" "$@"; }
mkdir -m 777 home
user ./gaugefs sim bq34z100-g1 --fast -- sh -c 'id -u; ./gaugefs probe --bus $I2C_DEV --address 0x55' || echo failed
user ./gaugefs sim bq34z100-g1 --fast ./bus -- sh -c './gaugefs probe --bus "$I2C_DEV" --address 0x55' || echo failed
# Without the right to mount, and without user namespaces that would give it.
unshare -Ur sh -c 'echo 0 > /proc/sys/user/max_user_namespaces
    setpriv --bounding-set -sys_admin ./gaugefs sim bq34z100-g1 --fast -- true; echo "code $?"'
# As with Yama.
mkdir -p sys/yama; echo 1 > sys/yama/ptrace_scope
mount --bind sys /proc/sys/kernel
user timeout 5 ./gaugefs sim bq34z100-g1 --fast ./other
user ./gaugefs sim bq34z100-g1 --fast ./other -- true && echo quiet
"#;
    let output = Command::new("unshare")
        .args(["--mount", "--propagation", "private", "bash", "-c", script, "bash"])
        .arg(&folder.0)
        .output()
        .expect("util-linux has unshare and setpriv");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let said = text(&output.stdout) + &text(&output.stderr);
    assert_eq!(said.matches("3.855 V").count(), 2, "{said}");
    assert!(said.lines().any(|line| line == "65534") && !said.contains("failed"), "{said}");
    assert!(said.contains("user namespaces are switched off") && said.contains("code 1\n"), "{said}");
    assert!(said.contains("with a PATH before `--`"), "{said}");
    assert!(
        said.contains("kernel.yama.ptrace_scope is 1") && said.contains("gaugefs sim CHIP -- COMMAND"),
        "{said}"
    );
    assert_eq!(said.matches("ptrace_scope").count(), 1, "a command of its own is served: {said}");
    assert!(said.lines().any(|line| line == "quiet"), "{said}");
}

/// It said that permission was denied, because only `mount` looked for what a mount needs.
#[test]
fn regression_a_bus_without_fusermount3_does_not_say_what_is_missing() {
    if !can_mount() {
        return;
    }
    if !geteuid().is_root() {
        eprintln!("SKIPPED: this test becomes another user, which only root may");
        return;
    }
    let folder = Folder::new();
    let bus = folder.file("bus");
    let ways: [&[&str]; 2] = [&["sim", CHIP, &bus], &["sim", CHIP, &bus, "--", "true"]];
    for arguments in ways {
        let mut command = as_nobody(&folder, arguments);
        fs::set_permissions(&folder.0, fs::Permissions::from_mode(0o777)).expect("its mode");
        command.env("FUSERMOUNT_PATH", "/nonexistent/fusermount3");
        run(command).failed(&["fusermount3: not found", "install the package fuse3"]);
        assert!(!Path::new(&bus).exists(), "{bus} was made for nothing");
    }
}

fn run_with(command: &mut Command, out: File) -> Ran {
    let child = command.stdout(out).stderr(Stdio::piped()).spawn().expect("gaugefs runs");
    Ran::of(child.wait_with_output().expect("its output"))
}

#[test]
fn what_is_no_bus_is_refused() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let mut tree = command(&["mount", "-f", "--sim", CHIP, &folder.file("m")]).spawn().expect("gaugefs runs");
    let capacity = folder.file("m/BAT0/capacity");
    within("mounted", || Path::new(&capacity).exists());
    fs::write(folder.file("text"), "text").expect("a file");
    for path in [&capacity, &folder.file("text"), "/dev/null"] {
        gaugefs(&["mount", "--bus", path, &folder.file("n")]).failed(&["not an I2C bus"]);
    }
    gaugefs(&["umount", &folder.file("m")]).done();
    tree.wait().expect("a child");
    // A line that cannot be printed is a failure, and nothing is left mounted.
    let mut unheard = command(&["sim", CHIP, &folder.file("bus")]);
    let full = File::options().write(true).open("/dev/full").expect("a full device");
    run_with(&mut unheard, full).failed(&["cannot write standard output"]);
    assert!(!Path::new(&folder.file("bus")).exists());
    gaugefs(&["sim", "--fast"]).failed(&["no gauge; name a CHIP"]);
    gaugefs(&["sim", CHIP]).failed(&["nowhere to offer the bus"]);
    gaugefs(&["sim", "bus"]).failed(&["bus: no gauge that is simulated; `gaugefs chips` lists them"]);
    let typed = ["sim", "bq34z100g1", "--", "true"];
    gaugefs(&typed).failed(&["bq34z100g1: no gauge that is simulated; did you mean bq34z100-g1?"]);
    gaugefs(&["sim", CHIP, CHIP, "./bus"]).failed(&["another gauge is at address 0x55"]);
    gaugefs(&["sim", "bq34z100-g1@0x80", "./bus"]).failed(&["expected a 7-bit address"]);
    gaugefs(&["sim", CHIP, "bq27220@0x56", "--state", &folder.file("s"), "./bus"]).failed(&["one CHIP"]);
}

/// Numbers and arguments by chance, most of them near valid ones: GAUGEFS_IOCTLS of them, from GAUGEFS_SEED.
#[test]
fn ioctls_by_chance_end_and_harm_nobody() {
    if !can_mount() {
        return;
    }
    let number = |name: &str, default: u64| {
        std::env::var(name).ok().map_or(default, |text| text.parse().expect("a number"))
    };
    let (count, seed) = (
        number("GAUGEFS_IOCTLS", if crate::drawn::is_all() { 20_000 } else { 5000 }),
        number("GAUGEFS_SEED", 1),
    );
    let folder = Folder::new();
    let mut server = Server::start(&folder, &[CHIP, "--fast"]);
    let answered = ioctls::by_chance(&|| server.open(), count, seed);
    println!("GAUGEFS_SEED={seed}: {answered} of {count} were carried out");
    assert!(answered > count / 20, "{answered}: they are too wild to reach the bus");
    // The server and other programs are as before.
    assert!(ioctls::funcs(&server.open()), "it answers I2C_FUNCS");
    server.ends(Signal::SIGTERM);
}

/// Its number is larger than that of any adapter.
#[test]
fn regression_a_bus_file_that_hangs_was_shown_as_an_adapter_that_does_not_exist() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let server = Server::start(&folder, &[CHIP]);
    let at = folder.file("m");
    let log = folder.file("log");
    gaugefs(&["mount", "--bus", &server.path, "--poll", "0.5", "--log", &log, &at]).done();
    kill(Pid::from_raw(server.child.id() as i32), Signal::SIGSTOP).expect("it runs");
    let said = || fs::read_to_string(&log).expect("a log");
    within("the bus hangs", || said().contains("hangs"));
    kill(Pid::from_raw(server.child.id() as i32), Signal::SIGCONT).expect("it runs");
    within("it is back", || said().contains("is used again"));
    gaugefs(&["umount", &at]).done();
    assert!(said().contains(&format!("{} hangs: ", server.path)) && !said().contains("i2c-4"), "{}", said());
}

/// A machine that is busy at boot took longer, and its service stayed failed.
#[test]
fn regression_a_mount_that_had_nothing_else_gave_up_after_five_seconds() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let server = Server::start(&folder, &[CHIP]);
    let (at, config) = (folder.file("m"), folder.file("packs.toml"));
    fs::write(&config, format!("[[gauge]]\nbus = '{}'\n", server.path)).expect("a file");
    let stop = |signal| kill(Pid::from_raw(server.child.id() as i32), signal).expect("it runs");
    stop(Signal::SIGSTOP);
    let mut mount = command(&["mount", "--config", &config, &at]).spawn().expect("gaugefs runs");
    std::thread::sleep(Duration::from_millis(5500));
    assert_eq!(mount.try_wait().expect("a child"), None, "it waits");
    stop(Signal::SIGCONT);
    assert!(mount.wait().expect("a child").success());
    gaugefs(&["umount", &at]).done();
}
