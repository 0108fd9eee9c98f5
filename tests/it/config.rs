// SPDX-License-Identifier: MIT

//! Many gauges in one mount: what a configuration may contain, and that no gauge blocks another.

use std::fs::{self, OpenOptions, Permissions};
use std::io::Write;
use std::os::unix::fs::{FileExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use gauge_bus::clock::{Clock, RealClock, SimClock};
use gauge_bus::{Bus, BusError};
use gauge_owner::{self as owner, Handle, Run, Signal, operations as op};
use gauge_sim::{Options, Sim, SimBus};
use gaugefs::fs::{Access, Fs, Supply};
use gaugefs::fuse;
use nix::errno::Errno;
use ti_gauge::chip::Chip;

use super::room::{self, CHIP, Folder, can_mount, command, gaugefs, read, within};

impl Folder {
    /// A configuration in the folder.
    fn config(&self, text: &str) -> String {
        let path = self.file("gauges.toml");
        fs::write(&path, text).expect("a file");
        path
    }
}

/// The example with all of its gauges: without the # before their lines, and with buses that no machine has.
fn whole_example() -> String {
    let text = fs::read_to_string("udev/gaugefs.toml").expect("the example");
    let is_key = |line: &str| {
        line.starts_with("[[") || line.split_once(" = ").is_some_and(|(key, _)| !key.contains(' '))
    };
    let lines = text.lines().map(|line| line.strip_prefix('#').filter(|line| is_key(line)).unwrap_or(line));
    let text = lines.map(|line| format!("{line}\n")).collect::<String>();
    text.replace("/dev/i2c-1\"", "/dev/i2c-998\"").replace("/dev/i2c-7\"", "/dev/i2c-999\"")
}

#[test]
fn the_example_mounts_as_it_is_shipped() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let example = ["mount", "--config", "udev/gaugefs.toml", &at];
    let shown = gaugefs(&[&example[..], &["--check"]].concat()).done();
    assert_eq!(shown, format!("{at}/SIM  simulated gauge  bq27441-g1\n"));
    gaugefs(&example).done();
    assert_eq!(read(&at, "SIM/present"), "1");
    assert_eq!(read(&at, "SIM/gauge/poll_interval"), "3");
    gaugefs(&["umount", &at]).done();
}

#[test]
fn the_whole_example_waits_for_its_hardware_and_its_check_names_it() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let path = folder.config(&whole_example());
    let group = nix::unistd::Group::from_name("i2c").is_ok_and(|group| group.is_some());
    if !group {
        let without = whole_example().replace("\ngroup = ", "\n# group = ");
        gaugefs(&["mount", "--config", &path, "--check"]).failed(&["group: no such group"]);
        folder.config(&without);
    }
    let at = folder.file("m");
    let ran = gaugefs(&["mount", "--config", &path, &at, "--check"]);
    let lines: Vec<&str> = ran.err.lines().collect();
    assert_eq!((ran.code, lines.len()), (Some(1), 5), "{}{}", ran.out, ran.err);
    assert_eq!(ran.out.lines().count(), 3, "{}", ran.out);
    for (line, words) in lines.iter().zip([
        ["SIM: ", "/gauges.keys: cannot read the key file: No such file"],
        ["BAT0: ", "/gauges.keys: cannot read the key file: No such file"],
        ["BAT0: ", "/dev/i2c-998: no such bus"],
        ["BAT1: ", "/usb.keys: cannot read the key file: No such file"],
        ["BAT1: ", "/dev/i2c-999: no such bus"],
    ]) {
        assert!(words.iter().all(|word| line.contains(word)), "{words:?}: {line}");
    }
    for keys in ["gauges.keys", "usb.keys"] {
        fs::write(folder.file(keys), "unseal = 0414 3672\n").expect("a file");
        fs::set_permissions(folder.file(keys), Permissions::from_mode(0o600)).expect("its owner's");
    }
    let ran = gaugefs(&["mount", "--config", &path, &at]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert_eq!(read(&at, "SIM/present"), "1");
    assert_eq!((read(&at, "BAT0/present"), read(&at, "BAT1/present")), ("0".into(), "0".into()));
    assert_eq!(read(&at, "BAT0/gauge/poll_interval"), "10");
    gaugefs(&["umount", &at]).done();
}

#[test]
fn a_file_that_makes_no_sense_is_refused_with_the_place() {
    let folder = Folder::new();
    let mount = "[mount]\nmountpoint = 'm'\n";
    let sim = "[[gauge]]\nsim = 'bq34z100-g1'\n";
    let all = &format!("{mount}{sim}");
    let cases: &[(&str, &[&str])] = &[
        // Unknown keys, and text that is not TOML.
        ("[defaults]\npoll = \n", &["line 2: not TOML:"]),
        ("[defaults]\npoll = 3\npoll = 4\n", &["line 3: not TOML: duplicate key"]),
        ("[mount]\n[mount]\n", &["line 2: not TOML: duplicate key"]),
        ("\n[defaults]\npol = 3\n", &["line 3: pol: unknown key; did you mean `poll`?"]),
        ("[mount]\nmountpont = 'm'\n", &["line 2: mountpont: unknown key; did you mean `mountpoint`?"]),
        ("[mount]\nstate_dir = 's'\n", &["line 2: state_dir: unknown key; did you mean `state-dir`?"]),
        ("[[gauge]]\nsim_sate = 's'\n", &["line 2: sim_sate: unknown key; did you mean `sim-state`?"]),
        ("[[gauge]]\n[[gauge]]\nenergi = true\n", &["line 3: energi: unknown key; did you mean `energy`?"]),
        ("[mount]\nx = 3\n", &["line 2: x: unknown key; known here are mountpoint, ac, read-only, private"]),
        ("[defaults]\nx = 3\n", &["line 2: x: unknown key; known here are bus, address, chip"]),
        (
            "[[gauge]]\nx = 3\n",
            &[
                "line 2: x: unknown key; known here are sim, sim-state, sim-key, sim-seal, sim-set, sim-adapter",
            ],
        ),
        ("[[gague]]\n", &["line 1: gague: unknown key; did you mean [[gauge]]?"]),
        ("[default]\n", &["line 1: default: unknown key; did you mean [defaults]?"]),
        (
            "x.y = 3\n",
            &["line 1: x: unknown key; a file has the tables [mount], [defaults], [[gauge]], [[alert]]"],
        ),
        ("[mount]\n'' = 3\n'--help' = 3\n", &["line 2: \"\": unknown key; known here are"]),
        ("[mount]\n\"a\\nb\" = 3\n", &["line 2: a\\nb: unknown key; known here are"]),
        // Keys in the wrong table, as in files without [mount] and [defaults].
        ("mountpoint = 'm'\n", &["line 1: mountpoint: belongs to the mount; move it below [mount]"]),
        (
            "poll = 3\n",
            &["line 1: poll: belongs to the gauges; move it below [defaults], or below a [[gauge]]"],
        ),
        ("name = 'PACK'\n", &["line 1: name: belongs to one gauge; move it below its [[gauge]]"]),
        ("[mount]\npoll = 3\n", &["line 2: poll: belongs to the gauges; move it below [defaults]"]),
        ("[mount]\nsim = 'bq34110'\n", &["line 2: sim: belongs to one gauge"]),
        ("[defaults]\nname = 'PACK'\n", &["line 2: name: belongs to one gauge; move it below its [[gauge]]"]),
        ("[defaults]\nlog = 'l'\n", &["line 2: log: belongs to the mount; move it below [mount]"]),
        ("[[gauge]]\nprivate = true\n", &["line 2: private: belongs to the mount; move it below [mount]"]),
        // Tables of another kind.
        ("[gauge]\nname = 'PACK'\n", &["line 1: gauge: write [[gauge]] above the keys of each gauge"]),
        ("gauge.name = 'PACK'\n", &["line 1: gauge: write [[gauge]]"]),
        ("gauge = 3\n", &["line 1: gauge: write [[gauge]]"]),
        ("gauge = ['x']\n", &["line 1: gauge: write [[gauge]]"]),
        ("[alert]\nwhen = 'missing'\n", &["line 1: alert: write [[alert]] above the keys of each alert"]),
        // Alerts.
        ("[[alert]]\nname = 'x'\n", &["line 1: alert:", "missing field `when`"]),
        ("[[alert]]\nwhen = 'capacity<<20'\n", &["line 2: when:", "is not a number of %"]),
        (
            "[[alert]]\nwhen = 'missing'\nbus = 'x'\n",
            &["line 3: bus: unknown key; known below [[alert]] are gauge, when"],
        ),
        ("[[mount]]\nmountpoint = 'm'\n", &["line 1: mount: write [mount] above its keys"]),
        ("defaults = 3\n", &["line 1: defaults: write [defaults] above its keys"]),
        // Values.
        ("[mount]\nac = 3\n", &["line 2: ac: expected true, false or a name"]),
        ("[mount]\ngroup = 'no-such-group'\n", &["line 2: group: no such group"]),
        ("[mount]\nprivate = 'yes'\n", &["line 2: private:", "expected a boolean"]),
        ("[defaults]\npoll = 0.1\n", &["line 2: poll: expected 0.5 to 3600 seconds"]),
        ("[defaults]\nenergy = 'yes'\n", &["line 2: energy:", "expected a boolean"]),
        (
            "[defaults]\naddress = 0xaa\n",
            &["line 2: address: expected a 7-bit address", "8-bit form of 0x55"],
        ),
        ("[defaults]\naddress = 55\n", &["line 2: address: 55 is 0x37; did you mean 0x55?"]),
        ("[[gauge]]\naddress = '55'\n", &["line 2: address: 55 is 0x37; did you mean 0x55?"]),
        (
            "[[gauge]]\nsim = 'bq34z10-g1'\n",
            &["line 2: sim: unknown chip `bq34z10-g1`; did you mean bq34z100-g1?"],
        ),
        ("[defaults]\ncurrent-scale = []\n", &["line 2: current-scale: expected a number or a string"]),
        ("defaults = { poll = 0.1 }\n", &["line 1: poll: expected 0.5 to 3600 seconds"]),
        ("[[gauge]]\nname = 'a/b'\n", &["line 2: name: expected letters"]),
        ("[[gauge]]\n[[gauge]]\nchip = 'bq99'\n", &["line 3: chip: unknown chip `bq99`", "gaugefs chips"]),
        ("[[gauge]]\nwrites-per-hour = -1\n", &["line 2: writes-per-hour:", "-1"]),
        // Keys that contradict each other, or lack another.
        ("[[gauge]]\nsim = 'bq34110'\n\nchip = 'bq34110'\n", &["line 4: chip: cannot be combined with sim"]),
        ("[[gauge]]\nreplay = 'r'\nbus = 'b'\n", &["line 3: bus: cannot be combined with replay"]),
        ("[[gauge]]\nreplay = 'r'\ntrace = 't'\n", &["line 3: trace: cannot be combined with replay"]),
        ("[[gauge]]\nsim-state = 's'\n", &["line 2: sim-state: only together with sim; set sim too"]),
        ("[[gauge]]\ntrace-replace = true\n", &["line 2: trace-replace: only together with trace"]),
        (
            "[[gauge]]\nreplay = 'r'\nwrites-per-hour = 3\n",
            &["line 3: writes-per-hour: cannot be combined with replay"],
        ),
        (&format!("{mount}[[gauge]]\nname = 'A'\n"), &["line 3: [[gauge]]: no source given", "--bus"]),
        (mount, &["no gauge", "[[gauge]]"]),
        ("", &["no gauge", "[[gauge]]"]),
        (sim, &["no mount point", "[mount]"]),
        (&format!("{all}[[gauge]]\nreplay = 'r'\n"), &["a recording", "read-only = true"]),
        // What only one gauge can have.
        (
            &format!("{all}name = 'A'\n[[gauge]]\nsim = 'bq34110'\nname = 'A'\n"),
            &["line 8: name: the same as on line 5"],
        ),
        (
            &format!("{all}sim-state = 's'\n[[gauge]]\nsim = 'bq34110'\nsim-state = './s'\n"),
            &["line 8: sim-state: the same as on line 5"],
        ),
        (&format!("{all}trace = 't'\n{sim}trace = 't'\n"), &["line 8: trace: the same as on line 5"]),
        (
            &format!("{mount}[defaults]\nbus = '/dev/i2c-1'\n[[gauge]]\n[[gauge]]\naddress = 85\n"),
            &["line 7: address: the same as on line 5"],
        ),
    ];
    for (text, words) in cases {
        let path = folder.config(text);
        let words = [&[path.as_str()], *words].concat();
        gaugefs(&["mount", "--config", &path, "--check"]).failed(&words);
    }
    gaugefs(&["mount", "--config", &folder.file("none"), "--check"]).failed(&["none: cannot read it"]);
}

#[test]
fn defaults_names_and_the_command_line_are_combined() {
    let folder = Folder::new();
    let path = folder.config(
        "[mount]\nmountpoint = 'm'\n\
         [defaults]\nbus = '/dev/i2c-1'\nchip = 'bq34z100-g1'\n\
         [[gauge]]\n[[gauge]]\nname = 'BAT0'\naddress = '0x56'\n\
         [[gauge]]\nsim = 'bq34110'\n[[gauge]]\nbus = 'dev/pack'\nchip = 'BQ27427'\n",
    );
    let at = |mountpoint: &str, bus: &str| {
        format!(
            "{mountpoint}/BAT1  {bus} address 0x55  bq34z100-g1\n\
             {mountpoint}/BAT0  {bus} address 0x56  bq34z100-g1\n\
             {mountpoint}/BAT2  simulated gauge  bq34110\n\
             {mountpoint}/BAT3  {}/dev/pack address 0x55  bq27427\n",
            folder.file("").trim_end_matches('/')
        )
    };
    // Columns are as wide as their widest cell, which differs.
    let squeeze = |text: String| {
        let lines = text.lines().map(|line| {
            let cells = line.split("  ").filter(|cell| !cell.is_empty()).map(str::trim);
            cells.collect::<Vec<_>>().join("  ") + "\n"
        });
        lines.collect::<String>()
    };
    let check = |more: &[&str]| {
        let arguments = [&["mount", "--config", &path, "--check"], more].concat();
        // It also lists the buses that are missing.
        squeeze(gaugefs(&arguments).out)
    };
    assert_eq!(check(&[]), at(&folder.file("m"), "/dev/i2c-1"));
    assert_eq!(check(&["--bus", "/dev/i2c-9", "/mnt/x"]), at("/mnt/x", "/dev/i2c-9"));
}

#[test]
fn many_gauges_are_mounted_together() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let keys = folder.file("wrong.keys");
    fs::write(&keys, "unseal = 1234 5678\n").expect("a file");
    fs::set_permissions(&keys, Permissions::from_mode(0o600)).expect("its owner's");
    let path = folder.config(
        "[mount]\nmountpoint = 'm'\nlog = 'log'\nac = true\n\
         [defaults]\nenergy = true\n\
         [[gauge]]\nsim = 'bq34z100-g1'\npoll = 0.5\n\
         [[gauge]]\nsim = 'bq27441-g1'\nenergy = false\nname = 'PACK'\n\
         [[gauge]]\nbus = '/dev/i2c-998'\nchip = 'bq34z100-g1'\n\
         [[gauge]]\nbus = '/dev/i2c-999'\n\
         [[gauge]]\nsim = 'bq34z100-g1'\nkey-file = 'wrong.keys'\n",
    );
    let at = folder.file("m");
    let ran = gaugefs(&["mount", "--config", &path]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(0), ""), "{}", ran.err);
    let lines: Vec<&str> = ran.err.lines().collect();
    assert_eq!(lines.len(), 2, "{}", ran.err);
    assert!(
        lines[0].contains("BAT1: not there yet") && lines[0].contains("/dev/i2c-998: no such bus"),
        "{}",
        ran.err
    );
    assert!(
        lines[1].contains("BAT2: left out") && lines[1].contains("/dev/i2c-999: no such bus"),
        "{}",
        ran.err
    );
    let mut names: Vec<_> = fs::read_dir(&at)
        .expect("mounted")
        .map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8"))
        .collect();
    names.sort();
    assert_eq!(names, ["AC", "BAT0", "BAT1", "BAT3", "PACK"]);

    assert_eq!(read(&at, "BAT0/gauge/poll_interval"), "0.5");
    assert_eq!(read(&at, "PACK/gauge/poll_interval"), "3");
    assert!(Path::new(&at).join("BAT0/energy_now").exists());
    assert!(!Path::new(&at).join("PACK/energy_now").exists());
    assert_eq!(read(&at, "PACK/model_name"), "bq27441-G1");

    // A gauge that is not there is shown as such, without anything that only the gauge knows.
    assert_eq!(
        read(&at, "BAT1/uevent"),
        "POWER_SUPPLY_NAME=BAT1\nPOWER_SUPPLY_TYPE=Battery\nPOWER_SUPPLY_PRESENT=0"
    );
    assert!(read(&at, "BAT1/gauge/last_error").contains("/dev/i2c-998: no such bus"));
    for unknown in ["voltage_now", "gauge/device_type", "gauge/seal", "gauge/flags"] {
        assert!(!Path::new(&at).join("BAT1").join(unknown).exists(), "{unknown}");
    }
    let errno = |error: std::io::Error| Errno::from_raw(error.raw_os_error().unwrap_or_default());
    let path = |name: &str| Path::new(&at).join(name);
    assert_eq!(fs::read(path("BAT1/df/80/53")).map_err(errno), Err(Errno::ENODEV));
    assert_eq!(fs::write(path("BAT1/df/80/53"), "3100").map_err(errno), Err(Errno::ENODEV));

    // The state of the mains follows from all gauges.
    assert_eq!(read(&at, "AC/online"), "1");
    fs::write(path("BAT0/sim/load_ma"), "500").expect("a knob");
    let online = Path::new(&at).join("AC/online");
    within("on battery", || fs::read_to_string(&online).is_ok_and(|text| text.trim() == "0"));

    // Each has its own data flash and its own keys.
    fs::write(path("BAT0/df/80/53"), "3100").expect("written");
    assert_eq!(read(&at, "BAT0/df/80/53"), "3100");
    assert_eq!(fs::read(path("BAT3/df/80/53")).map_err(errno), Err(Errno::EPERM));
    assert!(read(&at, "BAT3/gauge/last_error").contains("SEALED, and the"));

    gaugefs(&["umount", &at]).done();
    let log = || fs::read_to_string(folder.file("log")).expect("the log");
    within("the log's last line", || log().contains("PACK unmounted"));
    for line in [
        "BAT1: not there yet",
        "BAT2: left out",
        "warning: BAT3: ",
        "BAT0: serial 0x0001: Cell Terminate Voltage: 3000 -> 3100 mV, written",
    ] {
        assert!(log().contains(line), "`{line}` is not in: {}", log());
    }
}

#[test]
fn without_any_gauge_the_mount_fails_with_all_reasons() {
    let folder = Folder::new();
    let path = folder
        .config("[mount]\nmountpoint = 'm'\n[[gauge]]\nbus = '/dev/i2c-998'\n[[gauge]]\nbus = '/dev/null'\n");
    gaugefs(&["mount", "--config", &path]).failed(&[
        "no gauge can be mounted",
        "BAT0: /dev/i2c-998: no such bus",
        "BAT1: /dev/null: not an I2C bus",
    ]);
    // A gauge whose key file cannot be used is not left out.
    let path = folder.config(&format!(
        "[mount]\nmountpoint = 'm'\n[[gauge]]\nsim = '{CHIP}'\n[[gauge]]\nsim = '{CHIP}'\nkey-file = 'none'\n"
    ));
    gaugefs(&["mount", "--config", &path]).failed(&["none: cannot read the key file"]);
    assert!(!Path::new(&folder.file("m")).exists(), "a refused mount leaves nothing behind");
}

/// A bus on which transfers can be held up.
struct Gate {
    bus: SimBus,
    shut: Arc<(Mutex<bool>, Condvar)>,
}

impl Bus for Gate {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let shut = self.shut.0.lock().expect("no panic");
        drop(self.shut.1.wait_while(shut, |shut| *shut).expect("no panic"));
        self.bus.transfer(write, read)
    }
}

fn run(interval: Duration) -> Run {
    Run { interval, ..Run::default() }
}

fn sim(clock: &Arc<dyn Clock>) -> Sim {
    let sim = Sim::new(CHIP, &Options::default(), clock.clone()).expect("a simulated gauge");
    within("the gauge is awake", || {
        clock.sleep(Duration::from_millis(100));
        sim.bus().transfer(&[0], &mut [0; 2]).is_ok()
    });
    sim
}

fn entry(name: &str, handle: &Handle) -> Supply {
    Supply::new(name.into(), handle.clone())
}

/// A mount of some gauges, unmounted at the end.
struct Tree(PathBuf, #[expect(dead_code, reason = "it is unmounted when it is dropped")] fuse::Mounted);

impl Tree {
    fn new(name: &str, entries: Vec<Supply>, signal: Arc<Signal>) -> Self {
        let folder = crate::room::folder_named(&format!("-{name}"));
        let access = Access {
            uid: nix::unistd::geteuid().as_raw(),
            gid: nix::unistd::getegid().as_raw(),
            group: false,
        };
        let tree = Arc::new(Fs::new(entries, access));
        let mounted = fuse::mount(tree, &folder, fuse::Options::default(), signal).expect("a mount");
        Self(folder, mounted)
    }
}

impl Drop for Tree {
    fn drop(&mut self) {
        let _ = nix::mount::umount2(&self.0, nix::mount::MntFlags::MNT_DETACH);
        let _ = fs::remove_dir(&self.0);
    }
}

#[test]
fn a_stuck_gauge_blocks_no_other() {
    if !can_mount() {
        return;
    }
    // On this clock the time during which the bus is held up counts neither for the gauge nor for the commit, which
    // would give up after some seconds.
    let clock: Arc<dyn Clock> = Arc::new(SimClock::new());
    let chip = Chip::by_name(CHIP).expect("a chip of the tables");
    let signal = Arc::new(Signal::default());
    let shut = Arc::new((Mutex::new(false), Condvar::new()));
    let quiet = || run(Duration::from_secs(3600));
    let gate = Gate { bus: sim(&clock).bus(), shut: shut.clone() };
    let stuck = owner::spawn(chip, Box::new(gate), clock.clone(), quiet(), signal.clone()).expect("a gauge");
    let bus = Box::new(sim(&clock).bus());
    let other = owner::spawn(chip, bus, clock.clone(), quiet(), signal.clone()).expect("a gauge");
    let tree = Tree::new("stuck", vec![entry("A", &stuck), entry("B", &other)], signal);
    let path = |name: &str| tree.0.join(name);
    let cat = |name: &str| fs::read_to_string(path(name)).unwrap_or_else(|error| panic!("{name}: {error}"));

    // A transaction in two writes. The second one is in progress while the changes of the first one are
    // announced to the kernel.
    let transaction = OpenOptions::new().write(true).open(path("A/df/transaction")).expect("it opens");
    transaction.write_at(b"begin\n80/53 3100\n", 0).expect("staged");
    let held = fs::File::open(path("B/df/80/53")).expect("it opens");
    let mut shown = [0; 16];
    let count = held.read_at(&mut shown, 0).expect("it reads");
    assert_eq!(&shown[..count], b"3000\n");

    *shut.0.lock().expect("no panic") = true;
    let commit = std::thread::spawn(move || transaction.write_at(b"commit\n", 17));
    let reads: Vec<_> = (0..4)
        .map(|_| path("A/df/48/11"))
        .map(|path| std::thread::spawn(move || fs::read_to_string(path)))
        .collect();
    let refresh = path("A/gauge/refresh");
    let refresh = std::thread::spawn(move || fs::write(refresh, "1"));

    for value in 3100..3108 {
        fs::write(path("B/df/80/53"), value.to_string()).expect("written");
        assert_eq!(cat("B/df/80/53"), format!("{value}\n"));
        // The last known values of the stuck gauge are shown too.
        assert_eq!(cat("A/present"), "1\n");
    }
    fs::write(path("B/gauge/refresh"), "1").expect("polled");
    assert_eq!(cat("B/df/index").lines().count(), cat("B/df/index").lines().count());
    // The change shows in a file that is held open.
    within("the file held open follows", || {
        let mut shown = [0; 16];
        let count = held.read_at(&mut shown, 0).expect("it reads");
        &shown[..count] == b"3107\n"
    });
    assert!(!commit.is_finished() && reads.iter().all(|read| !read.is_finished()) && !refresh.is_finished());

    *shut.0.lock().expect("no panic") = false;
    shut.1.notify_all();
    commit.join().expect("a thread").expect("written");
    for read in reads {
        assert_eq!(read.join().expect("a thread").expect("read"), "1000\n");
    }
    refresh.join().expect("a thread").expect("polled");
    assert_eq!(cat("A/df/80/53"), "3100\n");
}

/// What is at an address: nothing, something else, or a gauge.
struct Socket {
    bus: SimBus,
    holds: Arc<AtomicU8>,
    written: Arc<AtomicU64>,
}

const NOTHING: u8 = 0;
const EEPROM: u8 = 1;
const GAUGE: u8 = 2;

impl Bus for Socket {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        match self.holds.load(Ordering::SeqCst) {
            GAUGE => return self.bus.transfer(write, read),
            EEPROM => read.fill(0x41),
            _ => return Err(BusError::NoAck),
        }
        self.written.fetch_add(u64::from(write.len() > 1), Ordering::SeqCst);
        Ok(())
    }
}

#[test]
fn a_gauge_that_comes_later_is_verified_first() {
    if !can_mount() {
        return;
    }
    let clock: Arc<dyn Clock> = Arc::new(RealClock::new());
    let chip = Chip::by_name(CHIP).expect("a chip of the tables");
    let signal = Arc::new(Signal::default());
    let (holds, written) = (Arc::new(AtomicU8::new(NOTHING)), Arc::new(AtomicU64::new(0)));
    let socket = Socket { bus: sim(&clock).bus(), holds: holds.clone(), written: written.clone() };
    let run = Run { name: "PACK".into(), unverified: true, ..run(Duration::from_millis(500)) };
    let (handle, begun) = owner::start(chip, Box::new(socket), clock, run, signal.clone()).expect("a thread");
    let error = begun.recv().expect("an outcome").expect_err("nothing is there");
    assert_eq!(error.errno(), Errno::ENXIO as i32);
    let tree = Tree::new("later", vec![entry("PACK", &handle)], signal);
    let path = |name: &str| tree.0.join("PACK").join(name);
    let cat = |name: &str| fs::read_to_string(path(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    assert_eq!(cat("present"), "0\n");
    assert!(!path("gauge/device_type").exists());

    // A memory at the same address is never written to, whatever is requested.
    holds.store(EEPROM, Ordering::SeqCst);
    let failed =
        || handle.statistics().iter().find(|(name, _)| *name == "failed_polls").map(|(_, count)| *count);
    let before = failed();
    within("two more polls that fail", || failed() >= before.map(|count| count + 2));
    let errno = |error: std::io::Error| Errno::from_raw(error.raw_os_error().unwrap_or_default());
    assert_eq!(fs::write(path("df/80/53"), "3100").map_err(errno), Err(Errno::ENODEV));
    assert_eq!(fs::read(path("df/80/53")).map_err(errno), Err(Errno::ENODEV));
    let refused =
        OpenOptions::new().write(true).open(path("gauge/control")).expect("it opens").write(b"FW_VERSION");
    assert_eq!(refused.map_err(errno), Err(Errno::ENODEV));
    assert!(fs::write(path("gauge/refresh"), "1").is_err());
    handle.ask(&op::LOOK, (), Box::new(drop));
    assert_eq!(cat("present"), "0\n");
    assert_eq!(written.load(Ordering::SeqCst), 0);

    holds.store(GAUGE, Ordering::SeqCst);
    within("the gauge is there", || cat("present") == "1\n");
    within("it is identified", || path("gauge/device_type").exists());
    assert_eq!(cat("gauge/device_type"), "0x0100\n");
    assert_eq!(cat("df/80/53"), "3000\n");
}

/// The daemon in the background changes its folder to `/`, and still finds the files that it was given.
#[test]
fn relative_paths_are_those_of_the_callers_folder() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    write_keys(&folder.file("keys"));
    let run = |arguments: &str| {
        let mut command = command(&arguments.split(' ').collect::<Vec<_>>());
        command.current_dir(&folder.0);
        room::run(command).done();
    };
    let mount = format!(
        "mount --sim {CHIP} --sim-state state --key-file keys --trace trace --log log --state-dir journal m"
    );
    keeps_its_files(&folder, &folder.file(""), || run(&mount));

    run(&format!("mount --sim {CHIP} --poll 0.5 --trace recording m"));
    let polls = || read(&folder.file("m"), "BAT0/gauge/statistics/polls").parse::<u32>();
    within("polls of every register", || polls().is_ok_and(|polls| polls >= 3));
    run("umount m");
    run("mount --replay recording m");
    assert_eq!(read(&folder.file("m"), "BAT0/model_name"), "bq34z100-G1");
    run("umount m");

    run("mount --sim bq27441-g1 m");
    run("export m/BAT0 -o image");
    run("umount m");
    run("mount --sim bq27441-g1 --restore image m");
}

/// Those of a configuration are relative to the folder of its file.
#[test]
fn only_a_simulated_gauge_can_be_hurried() {
    let folder = Folder::new();
    let file = folder.file("gauges.toml");
    let text = format!(
        "[mount]\nfast = true\n[[gauge]]\nsim = '{CHIP}'\n[[gauge]]\nname = 'PACK'\nbus = '/dev/i2c-999'\n"
    );
    std::fs::write(&file, text).expect("a file");
    let ran = gaugefs(&["mount", "--config", &file, "--check", &folder.file("m")]);
    assert!(ran.code == Some(1) && ran.err.contains("PACK: fast is for simulated gauges"), "{}", ran.err);
}

#[test]
fn relative_paths_of_a_configuration_are_those_of_its_folder() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let path = folder.config(&format!(
        "[mount]\nmountpoint = 'm'\nlog = 'log'\nstate-dir = 'journal'\n\
         [defaults]\nkey-file = 'keys'\n\
         [[gauge]]\nsim = '{CHIP}'\nsim-state = 'state'\ntrace = 'trace'\n"
    ));
    write_keys(&folder.file("keys"));
    keeps_its_files(&folder, &folder.file(""), || {
        gaugefs(&["mount", "--config", &path]).done();
    });
}

fn write_keys(path: &str) {
    fs::write(path, "unseal = 0414 3672\n").expect("a key file");
    fs::set_permissions(path, Permissions::from_mode(0o600)).expect("its mode");
}

/// Mounts twice. A parameter that is written the first time is kept, and all other files are in the folder.
fn keeps_its_files(folder: &Folder, files: &str, mount: impl Fn()) {
    let at = folder.file("m");
    mount();
    fs::write(Path::new(&at).join("BAT0/df/80/53"), "3100").expect("written");
    gaugefs(&["umount", &at]).done();
    let file = |name: &str| fs::read_to_string(Path::new(files).join(name)).unwrap_or_default();
    within("the log ends with the unmount", || file("log").contains("unmounted"));
    assert!(file("log").contains("Cell Terminate Voltage: 3000 -> 3100 mV, written"), "{}", file("log"));
    assert!(file("trace").contains("W: AA 3E 50"), "the trace has no write of that block");
    assert!(Path::new(files).join("journal").is_dir(), "no folder for the journal");
    // It is not written over.
    fs::remove_file(Path::new(files).join("trace")).expect("the trace");
    mount();
    assert_eq!(read(&at, "BAT0/df/80/53"), "3100");
    gaugefs(&["umount", &at]).done();
}
