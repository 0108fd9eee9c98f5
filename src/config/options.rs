// SPDX-License-Identifier: MIT

//! All options of mounts, gauges and alerts. An option is a field, and a row with everything else about it;
//! the command line, the keys of a file, gaugefs(1), gaugefs.toml(5) and the completions follow from the rows.

use std::path::PathBuf;
use std::time::Duration;

use super::choice::ChoiceOptions;
use super::option::{self, At, Dash, Effect, IN_FILE, Opt, Options, put};
use super::values;
use gauge_owner::GaugeOptions;
use gaugefs_client::condition::Condition;

/// For any gauge, also at a station.
const ANY_GAUGE: &[At] = &[At::Line, At::Table, At::Defaults, At::Station];
/// For any gauge that is mounted.
const ANY_MOUNTED: &[At] = &[At::Line, At::Table, At::Defaults];
/// For one gauge only, also at a station.
const ONE_GAUGE: &[At] = &[At::Line, At::Table, At::Station];
/// For one gauge that is mounted.
const ONE_MOUNTED: &[At] = &[At::Line, At::Table];

const GAUGE: &str = "Gauge";
const SHOWN: &str = "What is shown";
const ACCESS: &str = "Access";
const RUNNING: &str = "Running";

/// A gauge and its treatment: `[[gauge]]` and `[defaults]`.
impl Options for GaugeOptions {
    const TABLE: &'static [Opt<Self>] = &[
        Opt {
            name: "sim",
            effect: Effect::Chip(|to| &mut to.sim),
            doc: "Simulate a gauge of this chip; `gaugefs chips` lists them",
            heading: GAUGE,
            at: ONE_GAUGE,
            sample: "'bq27427'",
            ..Opt::NEW
        },
        Opt {
            name: "sim-state",
            effect: Effect::File("FILE", |to| &mut to.sim_state),
            doc: "File that keeps the simulated gauge's flash; created if missing",
            heading: GAUGE,
            at: ONE_GAUGE,
            not_with: &["bus", "replay"],
            needs: Some("sim"),
            sample: "'flash'",
            dash: Dash::Written("the gauge's flash is read from it and written to it"),
            ..Opt::NEW
        },
        Opt {
            name: "sim-key",
            effect: Effect::Text("WORDS", |to, text| put(&mut to.sim_key, values::key(text))),
            doc: "Unseal key of a new simulated gauge",
            default: "the manual's",
            more: "It is two words, such as \"0414 3672\".",
            heading: GAUGE,
            at: ONE_GAUGE,
            not_with: &["bus", "replay"],
            needs: Some("sim"),
            sample: "'0414 3672'",
            ..Opt::NEW
        },
        Opt {
            name: "sim-seal",
            effect: Effect::Text("STATE", |to, text| put(&mut to.sim_seal, values::seal(text))),
            doc: "Seal state in which the simulated gauge begins, sealed or unsealed",
            default: "a new gauge with flash is sealed, one with RAM unsealed",
            heading: GAUGE,
            at: ONE_GAUGE,
            not_with: &["bus", "replay"],
            needs: Some("sim"),
            sample: "'unsealed'",
            ..Opt::NEW
        },
        Opt {
            name: "sim-set",
            effect: Effect::Table("KNOB=VALUE", |to, pairs| to.sim_set = pairs),
            doc: "Turn knobs of the simulated gauge before anything happens, such as cells=7",
            on_line: ", several with a comma between",
            more: "It is a table, such as { cells = 7, board_divider = 33000 }.",
            heading: GAUGE,
            at: ONE_GAUGE,
            not_with: &["bus", "replay"],
            needs: Some("sim"),
            sample: "{ cells = 7 }",
            ..Opt::NEW
        },
        Opt {
            name: "sim-adapter",
            effect: Effect::Text("NAME", |to, text| put(&mut to.sim_adapter, values::adapter(text))),
            doc: "Put the simulated gauge behind an adapter of the kernel, with its limits, error numbers and pace: cp2112, \
                  ft260, ft260-6.1, mcp2221, i801, piix4, i2c-gpio, i2c-tiny-usb, i2c-stub, bcm2835, designware, designware-pci",
            default: "a bus that carries and reports everything",
            heading: GAUGE,
            at: ONE_GAUGE,
            not_with: &["bus", "replay"],
            needs: Some("sim"),
            sample: "'cp2112'",
            ..Opt::NEW
        },
        Opt {
            name: "scenario",
            effect: Effect::NameOrFile("NAME|FILE", |to| &mut to.scenario),
            doc: "Let this happen to the simulated gauge: drone-flight, ebike-ride, failed-pack, failing-bus, laptop-year, \
                  power-cut, robot-day, solar-week, swapped-pack, or a file, whose path has a slash",
            heading: GAUGE,
            at: ONE_GAUGE,
            not_with: &["bus", "replay"],
            needs: Some("sim"),
            sample: "'robot-day'",
            ..Opt::NEW
        },
        Opt {
            name: "scenario-seed",
            effect: Effect::Number("N", |to, text| put(&mut to.scenario_seed, values::count(text))),
            doc: "Draw what is left to chance in the scenario by this number",
            default: "the scenario's",
            heading: GAUGE,
            at: ONE_GAUGE,
            needs: Some("scenario"),
            sample: "7",
            ..Opt::NEW
        },
        Opt {
            name: "bus",
            effect: Effect::File("DEVICE", |to| &mut to.bus),
            doc: "I2C bus of the gauge, such as /dev/i2c-1",
            on_line: ", or the gauge's device, such as /sys/bus/i2c/devices/1-0055",
            heading: GAUGE,
            at: ANY_GAUGE,
            not_with: &["sim", "replay"],
            sample: "'/dev/i2c-1'",
            ..Opt::NEW
        },
        Opt {
            name: "address",
            effect: Effect::Number("ADDRESS", |to, text| put(&mut to.address, values::address(text))),
            doc: "7-bit address of the gauge",
            default: "0x55",
            heading: GAUGE,
            at: ANY_GAUGE,
            not_with: &["sim", "replay"],
            sample: "0x56",
            ..Opt::NEW
        },
        Opt {
            name: "chip",
            effect: Effect::Chip(|to| &mut to.chip),
            doc: "Chip of the gauge",
            default: "the gauge is asked",
            more: "A gauge that is asked is left out if it does not answer when the mount starts. With this option its \
                   folder always exists, and `present` is 0 until the gauge answers.",
            heading: GAUGE,
            at: ANY_GAUGE,
            not_with: &["sim", "replay"],
            sample: "'bq27427'",
            ..Opt::NEW
        },
        Opt {
            name: "replay",
            effect: Effect::File("FILE", |to| &mut to.replay),
            doc: "Replay a gauge from this recording, which --trace made; read-only",
            on_line: "; - is standard input",
            heading: GAUGE,
            at: ONE_MOUNTED,
            not_with: &["sim"],
            sample: "'recording'",
            dash: Dash::Input,
            ..Opt::NEW
        },
        Opt {
            name: "ask-the-pack",
            effect: Effect::Switch(|to, on| to.ask_the_pack = on),
            doc: "Ask a gauge of TI's in a Smart Battery for what the specification has no word for: sends the codes that \
                  gauge/questions shows, and nothing else",
            more: "The part is named by chip, or by the pack's DeviceName().",
            heading: GAUGE,
            at: ONE_MOUNTED,
            not_with: &["replay"],
            ..Opt::NEW
        },
        Opt {
            name: "byte-writes",
            effect: Effect::Switch(|to, on| to.byte_writes = on),
            doc: "Write one byte per transfer, as some gauges need above 100 kHz",
            heading: GAUGE,
            at: ANY_GAUGE,
            ..Opt::NEW
        },
        Opt {
            name: "profile",
            effect: Effect::File("FILE", |to| &mut to.profile),
            doc: "Image, as `gaugefs export` writes it, that a gauge without flash gets whenever it has lost its power",
            on_line: "; - is standard input",
            heading: GAUGE,
            at: ANY_MOUNTED,
            not_with: &["replay"],
            sample: "'image'",
            dash: Dash::Input,
            ..Opt::NEW
        },
        Opt {
            name: "restore",
            effect: Effect::File("FILE", |to| &mut to.profile),
            doc: "Another name of --profile",
            heading: GAUGE,
            at: ANY_MOUNTED,
            not_with: &["replay", "profile"],
            of: "profile",
            sample: "'image'",
            dash: Dash::Input,
            ..Opt::NEW
        },
        Opt {
            name: "choose",
            effect: Effect::Tables(|to, rules| {
                let rules = ChoiceOptions::read(rules)?;
                to.choose = rules.iter().map(ChoiceOptions::rule).collect();
                Ok(())
            }),
            doc: "In place of a profile, the rules by which one of several is chosen, each below [[gauge.choose]]",
            heading: GAUGE,
            at: IN_FILE,
            not_with: &["replay", "profile", "restore", "pack"],
            sample: "[{ profile = 'image' }]",
            ..Opt::NEW
        },
        Opt {
            name: "pack",
            effect: Effect::Text("NAME", |to, text| put(&mut to.pack, values::name(text))),
            doc: "Name of a pack that is never exchanged unnoticed: after a loss of power a gauge without flash gets back \
                  what it has learned, with its profile",
            more: "What is learned is saved in any case; without a name `gaugefs learned` shows and restores it.",
            heading: GAUGE,
            at: ONE_MOUNTED,
            not_with: &["replay"],
            sample: "'BUILT-IN'",
            ..Opt::NEW
        },
        Opt {
            name: "name",
            effect: Effect::Text("NAME", |to, text| put(&mut to.name, values::name(text))),
            doc: "Name of the gauge's folder",
            default: "BAT0, or the first BATn that the kernel does not use",
            heading: SHOWN,
            at: ONE_GAUGE,
            sample: "'PACK'",
            ..Opt::NEW
        },
        Opt {
            name: "poll",
            effect: Effect::Number("SECONDS", |to, text| put(&mut to.poll, values::interval(text))),
            doc: "Seconds between two polls, 0.5 to 3600",
            default: "30; 3 with --sim and --replay",
            heading: SHOWN,
            at: ANY_MOUNTED,
            sample: "10",
            ..Opt::NEW
        },
        Opt {
            name: "energy",
            effect: Effect::Switch(|to, on| to.energy = on),
            doc: "Show energy_now and power_avg too; beside charge_now they mislead some monitors",
            heading: SHOWN,
            at: ANY_MOUNTED,
            ..Opt::NEW
        },
        Opt {
            name: "absolute-current",
            effect: Effect::Switch(|to, on| to.absolute_current = on),
            doc: "Show currents without sign, for monitors that cannot handle negative ones",
            heading: SHOWN,
            at: ANY_MOUNTED,
            ..Opt::NEW
        },
        Opt {
            name: "current-scale",
            effect: Effect::Number("FACTOR", |to, text| put(&mut to.current_scale, values::factor(text))),
            doc: "Multiply currents and charges by this factor",
            default: "1",
            more: OF_SCALES,
            heading: SHOWN,
            at: ANY_MOUNTED,
            sample: "2.5",
            ..Opt::NEW
        },
        Opt {
            name: "voltage-scale",
            effect: Effect::Number("FACTOR", |to, text| put(&mut to.voltage_scale, values::factor(text))),
            doc: "Multiply voltages by this factor",
            default: "1",
            more: OF_SCALES,
            heading: SHOWN,
            at: ANY_MOUNTED,
            sample: "2.5",
            ..Opt::NEW
        },
        Opt {
            name: "energy-scale",
            effect: Effect::Number("FACTOR", |to, text| put(&mut to.energy_scale, values::factor(text))),
            doc: "Multiply energies and powers by this factor",
            default: "1",
            more: OF_SCALES,
            heading: SHOWN,
            at: ANY_MOUNTED,
            sample: "2.5",
            ..Opt::NEW
        },
        Opt {
            name: "kernel-node",
            effect: Effect::Switch(|to, on| to.kernel_node = on),
            doc: "Offer the gauge to the kernel as a Smart Battery too: a battery of the system's for every program, with \
                  events; needs root, or a service, and the kernel's vhci-hcd, i2c-tiny-usb and sbs-battery",
            more: "Its name is sbs-N-000b. A desktop acts on it as on any battery: it also turns the machine off for a \
                   simulated gauge that is empty.",
            heading: SHOWN,
            at: ANY_MOUNTED,
            ..Opt::NEW
        },
        Opt {
            name: "allow-unproven",
            effect: Effect::Switch(|to, on| to.allow_unproven = on),
            doc: "Also write parameters whose address or range is uncertain",
            heading: ACCESS,
            at: ANY_GAUGE,
            ..Opt::NEW
        },
        Opt {
            name: "allow-learning",
            effect: Effect::Switch(|to, on| to.allow_learning = on),
            doc: "Also write during a learning cycle; the reset that follows ends the cycle",
            heading: ACCESS,
            at: ANY_MOUNTED,
            ..Opt::NEW
        },
        Opt {
            name: "writes-per-hour",
            effect: Effect::Number("N", |to, text| put(&mut to.writes_per_hour, values::count(text))),
            doc: "Program at most this many blocks of flash per hour; 0 for no limit",
            default: "300",
            heading: ACCESS,
            at: ANY_GAUGE,
            not_with: &["replay"],
            sample: "7",
            ..Opt::NEW
        },
        Opt {
            name: "key-file",
            effect: Effect::File("FILE", |to| &mut to.key_file),
            doc: "File with the gauge's keys, in lines such as `unseal = 0414 3672`; only its owner may read it",
            heading: ACCESS,
            at: ANY_GAUGE,
            sample: "'keys'",
            dash: Dash::Secret,
            ..Opt::NEW
        },
        Opt {
            name: "no-default-keys",
            effect: Effect::Switch(|to, on| to.no_default_keys = on),
            doc: "Never try the manual's default key",
            heading: ACCESS,
            at: ANY_GAUGE,
            ..Opt::NEW
        },
        Opt {
            name: "auth-order",
            effect: Effect::Text("ORDER", |to, text| put(&mut to.auth_order, values::order(text))),
            doc: "Byte order in which the gauge takes a challenge, lsb-first or as-sent; `gaugefs auth` finds out \
                  which one",
            default: "lsb-first",
            heading: ACCESS,
            at: ANY_GAUGE,
            sample: "'as-sent'",
            ..Opt::NEW
        },
        Opt {
            name: "trace",
            effect: Effect::File("FILE", |to| &mut to.trace),
            doc: "Record every transfer in this file, which must be a new one; keys are left out",
            heading: RUNNING,
            at: ONE_MOUNTED,
            not_with: &["replay"],
            sample: "'trace'",
            dash: Dash::Written(
                "a mount goes on when the command has returned, which standard output does not",
            ),
            ..Opt::NEW
        },
        Opt {
            name: "trace-replace",
            effect: Effect::Switch(|to, on| to.trace_replace = on),
            doc: "Replace the file of --trace if there is one",
            more: "A service does not start again without it, as long as the file is there.",
            heading: RUNNING,
            at: ONE_MOUNTED,
            not_with: &["replay"],
            needs: Some("trace"),
            ..Opt::NEW
        },
    ];
}

const OF_SCALES: &str = "The factor is from 0.001 to 1000, and comes on top of the scale that the gauge itself reports (bq34z100-R2).";

/// A mount as a whole: `[mount]`.
#[derive(Clone, Debug, Default)]
pub(crate) struct MountOptions {
    pub(crate) mountpoint: Option<PathBuf>,
    /// Even over a folder with content.
    pub(crate) over: bool,
    /// Present if shown, perhaps with its name.
    pub(crate) ac: Option<Option<String>>,
    pub(crate) read_only: bool,
    pub(crate) private: bool,
    pub(crate) group: Option<u32>,
    pub(crate) log: Option<PathBuf>,
    pub(crate) state_dir: Option<PathBuf>,
    pub(crate) no_backup: bool,
    pub(crate) fast: bool,
}

impl Options for MountOptions {
    const TABLE: &'static [Opt<Self>] = &[
        Opt {
            name: "mountpoint",
            effect: Effect::File("MOUNTPOINT", |to| &mut to.mountpoint),
            doc: "Folder to mount at; created if missing",
            more: "Required unless the command line has it.",
            at: &[At::Argument, At::Table],
            sample: "'/run/gauges'",
            ..Opt::NEW
        },
        Opt {
            name: "ac",
            effect: Effect::SwitchOrText("NAME", |to, shown| {
                let name = |name: Option<&str>| name.map(values::name).transpose();
                to.ac = shown.map(name).transpose()?;
                Ok(())
            }),
            doc: "Show a Mains supply too, online while no gauge is discharging",
            on_line: " [default NAME: AC]",
            more: "It has this name; `true` stands for AC.",
            heading: SHOWN,
            sample: "'MAINS'",
            ..Opt::NEW
        },
        Opt {
            name: "read-only",
            effect: Effect::Switch(|to, on| to.read_only = on),
            doc: "Refuse every write",
            heading: ACCESS,
            ..Opt::NEW
        },
        Opt {
            name: "private",
            effect: Effect::Switch(|to, on| to.private = on),
            doc: "Deny other users access to the mount; always so without root, unless there is a --group",
            heading: ACCESS,
            ..Opt::NEW
        },
        Opt {
            name: "group",
            effect: Effect::Text("GROUP", |to, text| put(&mut to.group, values::group(text))),
            doc: "Let this group read and write data flash, besides the owner; without root, a group of yours, \
                  and /etc/fuse.conf must have user_allow_other",
            heading: ACCESS,
            sample: "'0'",
            ..Opt::NEW
        },
        Opt {
            name: "log",
            effect: Effect::File("FILE", |to| &mut to.log),
            doc: "Log to this file",
            default: "syslog, in the foreground standard error",
            heading: RUNNING,
            sample: "'log'",
            dash: Dash::Written("with --foreground the log goes to standard error without it"),
            ..Opt::NEW
        },
        Opt {
            name: "state-dir",
            effect: Effect::File("DIR", |to| &mut to.state_dir),
            doc: "Folder for backups, and for journals, with which a write survives a power cut",
            default: "/var/lib/gaugefs; without root, ~/.local/state/gaugefs",
            heading: RUNNING,
            sample: "'state'",
            ..Opt::NEW
        },
        Opt {
            name: "no-backup",
            effect: Effect::Switch(|to, on| to.no_backup = on),
            doc: "Do not save a gauge's configuration before the first write to it",
            heading: RUNNING,
            ..Opt::NEW
        },
        Opt {
            name: "over",
            effect: Effect::Switch(|to, on| to.over = on),
            doc: "Mount also over a folder that is not empty, and hide what is in it; not needed over power_supply",
            heading: RUNNING,
            ..Opt::NEW
        },
        Opt {
            name: "fast",
            effect: Effect::Switch(|to, on| to.fast = on),
            doc: "Let whatever waits for a gauge go on at once; every gauge has to be simulated",
            heading: GAUGE,
            ..Opt::NEW
        },
    ];
}

/// An alert: `[[alert]]`, or the command line of `gaugefs watch`.
#[derive(Clone, Debug, Default)]
#[cfg_attr(not(feature = "screen"), allow(dead_code, reason = "the commands of that feature use it"))]
pub(crate) struct AlertOptions {
    /// Required.
    pub(crate) when: Option<Condition>,
    pub(crate) clear: Option<Condition>,
    pub(crate) hold: Option<Duration>,
    pub(crate) exec: Vec<String>,
    pub(crate) exec_clear: Vec<String>,
    pub(crate) name: Option<String>,
    pub(crate) gauge: Option<String>,
}

impl Options for AlertOptions {
    const TABLE: &'static [Opt<Self>] = &[
        Opt {
            name: "gauge",
            effect: Effect::Text("NAME", |to, text| put(&mut to.gauge, values::name(text))),
            doc: "Folder of the only gauge that it is for",
            default: "all gauges of the mount",
            at: IN_FILE,
            sample: "'BAT0'",
            ..Opt::NEW
        },
        Opt {
            name: "when",
            effect: Effect::Text("CONDITION", |to, text| put(&mut to.when, values::condition(text))),
            doc: "When the alert is raised, such as 'capacity<20'",
            more: "Required. `gaugefs wait --help` explains conditions.",
            at: &[At::Argument, At::Table],
            sample: "'capacity<20'",
            ..Opt::NEW
        },
        Opt {
            name: "clear",
            effect: Effect::Text("CONDITION", |to, text| put(&mut to.clear, values::condition(text))),
            doc: "When it is cleared, and can be raised again",
            default: "when the condition is false",
            sample: "'capacity>25'",
            ..Opt::NEW
        },
        Opt {
            name: "for",
            effect: Effect::Number("SECONDS", |to, text| put(&mut to.hold, values::hold(text))),
            doc: "Seconds for which the condition must be true in every poll",
            default: "0",
            more: "At most 86400.",
            sample: "60",
            ..Opt::NEW
        },
        Opt {
            name: "exec",
            effect: Effect::Words("CMD", word_of_program, |to, words| to.exec = words),
            doc: "Program to run when the alert is raised",
            on_line: ", with its arguments up to a `;`; no shell",
            more: "These are its name and its arguments. No shell is involved, unless it is [\"sh\", \"-c\", ...]. `gaugefs watch \
                   --help` lists the variables in its environment.",
            sample: "['true', 'x']",
            ..Opt::NEW
        },
        Opt {
            name: "exec-clear",
            effect: Effect::Words("CMD", word_of_program, |to, words| to.exec_clear = words),
            doc: "Program to run when it is cleared",
            sample: "['true', 'x']",
            ..Opt::NEW
        },
        Opt {
            name: "name",
            effect: Effect::Text("NAME", |to, text| put(&mut to.name, Ok(text.into()))),
            doc: "Name of the alert in messages",
            default: "its condition",
            sample: "'nearly empty'",
            ..Opt::NEW
        },
    ];
}

/// A word of a program's command line. The option takes all following words, so one of gaugefs's own options in them
/// was most likely meant for gaugefs: the program would run without the requested delay.
fn word_of_program(word: &str) -> Result<String, String> {
    let name = word.strip_prefix("--").map(|option| option.split('=').next().unwrap_or_default());
    let mut own = option::names::<AlertOptions>(At::Line).chain(["config", "test"]);
    match name.filter(|name| own.any(|own| own == *name)) {
        None => Ok(word.into()),
        Some(name) => Err(format!(
            "--{name} is an option of `gaugefs watch`; end CMD with `;` (in a shell, \\;) or put --{name} before it. If it \
             is meant for CMD, write sh -c 'CMD --{name} ...'"
        )),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::collections::HashSet;
    use std::fmt::Debug;

    use clap::{Arg, Args, Command, FromArgMatches};
    use toml::de::{DeTable, DeValue};

    use super::super::option::Given;
    use super::*;

    /// The command line for the sample value.
    fn words(row: &Opt<impl Options>) -> Vec<String> {
        let text = format!("x = {}", row.sample);
        let document = DeTable::parse(&text).expect("TOML").into_inner();
        let (_, value) = document.into_iter().next().expect("a value");
        let option = format!("--{}", row.name);
        let text = |value: &DeValue<'_>| value.as_str().unwrap_or(row.sample).to_string();
        match value.get_ref() {
            DeValue::Boolean(_) => vec![option],
            DeValue::Table(pairs) => {
                let pairs = pairs.iter().map(|(key, value)| match value.get_ref() {
                    DeValue::Integer(number) => format!("{}={}", key.get_ref(), number.as_str()),
                    value => format!("{}={}", key.get_ref(), text(value)),
                });
                vec![format!("{option}={}", pairs.collect::<Vec<_>>().join(","))]
            }
            DeValue::Array(words) => {
                let words = words.iter().map(|word| text(word.get_ref()));
                [option].into_iter().chain(words).collect()
            }
            value if row.is_at(At::Argument) => vec![text(value)],
            value => vec![format!("{option}={}", text(value))],
        }
    }

    fn on_command_line<T: Options>(rows: &[&Opt<T>]) -> T {
        let command = Command::new("x").arg(Arg::new("config").long("config"));
        let command = Given::<T>::augment_args(command);
        let words = rows.iter().flat_map(|row| words(row));
        let words = ["x", "--config=y"].map(String::from).into_iter().chain(words);
        let matches = command.try_get_matches_from(words).unwrap_or_else(|error| panic!("{error}"));
        Given::<T>::from_arg_matches(&matches).expect("they are there").options()
    }

    fn in_file<T: Options>(rows: &[&Opt<T>]) -> T {
        let mut options = T::default();
        for row in rows {
            let text = format!("x = {}", row.sample);
            let document = DeTable::parse(&text).expect("TOML").into_inner();
            let (_, value) = document.into_iter().next().expect("a value");
            row.read(&mut options, value.get_ref()).unwrap_or_else(|wrong| panic!("{}: {wrong:?}", row.name));
        }
        options
    }

    /// Every option of a table has an effect of its own, and the same one on the command line and in a file.
    pub(crate) fn check<T: Options + Debug>() {
        let mut effects = HashSet::new();
        for (number, row) in T::TABLE.iter().enumerate() {
            assert!(T::TABLE[..number].iter().all(|other| other.name != row.name), "{} twice", row.name);
            for other in row.not_with.iter().chain(&row.needs) {
                assert!(T::row(other).is_some(), "{}: no {other}", row.name);
            }
            let mut needed: Vec<_> =
                std::iter::successors(Some(row), |row| row.needs.and_then(T::row)).skip(1).collect();
            needed.reverse();
            let without = format!("{:?}", in_file::<T>(&needed));
            let all = [&needed[..], &[row]].concat();
            let of_file = format!("{:?}", in_file::<T>(&all));
            assert_ne!(of_file, without, "{} has no effect", row.name);
            if row.is_at(At::Line) || row.is_at(At::Argument) {
                assert_eq!(format!("{:?}", on_command_line(&all)), of_file, "{}", row.name);
            }
            // An older name acts as the option's present name.
            let is_new = match T::row(row.of) {
                Some(option) => of_file != format!("{:?}", in_file::<T>(&[option])),
                None => effects.insert(of_file),
            };
            assert_eq!(is_new, row.of.is_empty(), "{} has the effect of another one", row.name);
        }
    }

    #[test]
    fn every_option_has_the_same_effect_on_the_command_line_and_in_a_file() {
        check::<GaugeOptions>();
        check::<MountOptions>();
        check::<AlertOptions>();
        check::<ChoiceOptions>();
    }
}
