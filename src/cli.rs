//! The command line: flags, subcommands and what they print.

use std::ffi::OsString;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use clap::builder::PossibleValuesParser;
use clap::{ArgGroup, Args, Parser, Subcommand, ValueEnum};

use crate::authentication::Order;
use crate::bus::linux::{Adapter, LinuxBus};
use crate::bus::{Bus, GAUGE_ADDRESS};
use crate::chip::{CHIPS, Chip, Evidence, Role, Scheme};
use crate::clock::{Clock, RealClock};
use crate::daemon::{self, Keyring, Source, background, mountpoint};
use crate::dataflash::{Limits, WRITES_PER_HOUR};
use crate::error::{Error, Result};
use crate::fs::Scales;
use crate::image::{self, Format, Group, Image};
use crate::probe::{self, ROM_ADDRESS, Reading};
use crate::{json, keys};

mod auth;

const EXAMPLES: &str = "\
Examples:
  gaugefs mount --sim bq34z100-g1 /tmp/gauges     a simulated gauge, no hardware needed
  cat /tmp/gauges/BAT0/voltage_now                its voltage in microvolts
  gaugefs umount /tmp/gauges

  gaugefs probe --bus /dev/i2c-1                  what answers on a bus
  gaugefs mount --bus /dev/i2c-1 /run/gauges      mount the gauge on it";

const MOUNT: &str = "\
Examples:
  gaugefs mount --sim bq34z100-g1 /tmp/gauges
  gaugefs mount --bus /dev/i2c-1 /run/gauges
  gaugefs mount --bus /dev/i2c-1 --chip bq34z100-g1 --name PACK --key-file ~/pack.keys /run/gauges
  gaugefs mount --bus /dev/i2c-1 /sys/class/power_supply     beside the kernel's own supplies

The gauge appears in MOUNTPOINT as the kernel shows a power supply: BAT0/voltage_now,
BAT0/capacity and so on; its data flash in BAT0/df, all else in BAT0/gauge.";

const UMOUNT: &str = "A mount whose daemon has died is taken away too.";

const PROBE: &str = "\
Without --address only registers are read, at 0x55 and for a gauge in ROM mode at 0x0b;
that harms no other device. With --address, what reads like a gauge is asked who it is.
An address that a kernel driver has is not touched.

Examples:
  gaugefs probe --bus /dev/i2c-1
  gaugefs probe --bus /dev/i2c-1 --address 0x55";

const EXPORT: &str = "\
Keys are in no file. toml is made for git; gg.csv is bqStudio's; flashstream is what TI's
tools send to a gauge.

Examples:
  gaugefs export /run/gauges/BAT0 -o pack.toml
  gaugefs export /run/gauges/BAT0 --format flashstream -o pack.gm.fs";

const IMPORT: &str = "\
What differs is written through df/transaction and shown. Keys are left out, and so are rows
whose address or range is not sure.

Examples:
  gaugefs import --dry-run /run/gauges/BAT0 pack.toml
  gaugefs import --exclude calibration,serial /run/gauges/BAT0 golden.gm.fs";

const DIFF: &str = "\
Files are TOML, gg.csv or FlashStream, told apart by what is in them. A file need not hold
all parameters: those that both have are compared. Exit code 0: no difference, 1: some,
2: they could not be compared.

Examples:
  gaugefs diff pack.toml /run/gauges/BAT0
  gaugefs diff pack.toml pack.gm.fs";

const LINT: &str = "\
No gauge is needed. A FlashStream is read as a gauge would; what writes firmware or anything
else that is no documented parameter is refused with its line.

Examples:
  gaugefs lint golden.gm.fs
  gaugefs lint --chip bq27441-g1 golden.gm.fs";

/// Mounts TI battery fuel gauges as a Linux power_supply tree, data flash included
#[derive(Debug, Parser)]
#[command(name = "gaugefs", version, after_help = EXAMPLES, max_term_width = 100, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Mount(Box<Mount>),
    Umount(Umount),
    Probe(Probe),
    Chips(Chips),
    Export(Export),
    Import(Import),
    Diff(Diff),
    Lint(Lint),
    Auth(auth::Auth),
}

/// Mount a gauge; returns once it is mounted and has been read
#[derive(Args, Debug)]
#[command(after_help = MOUNT, group = ArgGroup::new("gauge").required(true).args(["sim", "bus", "replay"]))]
struct Mount {
    /// Folder to mount at; made if it is missing
    mountpoint: PathBuf,

    /// A simulated gauge of this kind; `gaugefs chips` lists them
    #[arg(long, value_name = "CHIP", value_parser = chip_names(), ignore_case = true, hide_possible_values = true, help_heading = "Gauge")]
    sim: Option<String>,
    /// Keep the simulated gauge's flash in this file; made if it is missing
    #[arg(long, value_name = "FILE", conflicts_with_all = ["bus", "replay"], help_heading = "Gauge")]
    sim_state: Option<PathBuf>,
    /// Unseal key of a new simulated gauge [default: the manual's]
    #[arg(long, value_name = "WORDS", value_parser = key_words, conflicts_with_all = ["bus", "replay"], help_heading = "Gauge")]
    sim_key: Option<Key>,
    /// The I2C bus that the gauge is on, such as /dev/i2c-1
    #[arg(long, value_name = "DEVICE", help_heading = "Gauge")]
    bus: Option<PathBuf>,
    /// The gauge's 7-bit address
    #[arg(long, value_name = "ADDRESS", default_value = "0x55", value_parser = address, conflicts_with_all = ["sim", "replay"], help_heading = "Gauge")]
    address: u8,
    /// What the gauge is [default: it is asked]
    #[arg(long, value_name = "CHIP", value_parser = chip_names(), ignore_case = true, hide_possible_values = true, conflicts_with_all = ["sim", "replay"], help_heading = "Gauge")]
    chip: Option<String>,
    /// A recorded gauge, read-only: the file that --trace wrote
    #[arg(long, value_name = "FILE", conflicts_with = "trace", help_heading = "Gauge")]
    replay: Option<PathBuf>,
    /// Write one byte a transfer, as some gauges want above 100 kHz
    #[arg(long, help_heading = "Gauge")]
    byte_writes: bool,
    /// A copy of df/index to write again when a gauge without flash has lost its power
    #[arg(long, value_name = "FILE", conflicts_with = "replay", help_heading = "Gauge")]
    restore: Option<PathBuf>,

    /// Name of the gauge's folder [default: BAT0, or the first BATn that the kernel does not have]
    #[arg(long, value_name = "NAME", value_parser = name, help_heading = "What is shown")]
    name: Option<String>,
    /// Show a Mains supply too [default NAME: AC]: `online` while no gauge is discharged
    #[arg(long, value_name = "NAME", value_parser = name, require_equals = true, num_args = 0..=1, help_heading = "What is shown")]
    ac: Option<Option<String>>,
    /// Time between two polls, 0.5 to 3600 s [default: 30; 3 with --sim and --replay]
    #[arg(long, value_name = "SECONDS", value_parser = interval, help_heading = "What is shown")]
    poll: Option<Duration>,
    /// Show energy_now and power_avg too; beside charge_now they mislead some monitors
    #[arg(long, help_heading = "What is shown")]
    energy: bool,
    /// Show currents without their sign, for monitors that cannot bear it
    #[arg(long, help_heading = "What is shown")]
    absolute_current: bool,
    /// Multiply currents and charges by this factor
    #[arg(long, value_name = "FACTOR", default_value = "1", value_parser = factor, help_heading = "What is shown")]
    current_scale: f64,
    /// Multiply voltages by this factor
    #[arg(long, value_name = "FACTOR", default_value = "1", value_parser = factor, help_heading = "What is shown")]
    voltage_scale: f64,
    /// Multiply energies and powers by this factor
    #[arg(long, value_name = "FACTOR", default_value = "1", value_parser = factor, help_heading = "What is shown")]
    energy_scale: f64,

    /// Refuse every write
    #[arg(long, help_heading = "Access")]
    read_only: bool,
    /// Write parameters too whose address or range is not sure
    #[arg(long, help_heading = "Access")]
    allow_unproven: bool,
    /// Write in the middle of a learning cycle too; the reset that follows ends it
    #[arg(long, help_heading = "Access")]
    allow_learning: bool,
    /// Program at most so many blocks of flash an hour, 0 for any number [default: 300]
    #[arg(long, value_name = "N", conflicts_with = "replay", help_heading = "Access")]
    writes_per_hour: Option<u32>,
    /// Let no other user look at the mount (without root this is always so)
    #[arg(long, help_heading = "Access")]
    private: bool,
    /// Let this group read and write data flash, besides the owner
    #[arg(long, value_name = "GROUP", value_parser = group, help_heading = "Access")]
    group: Option<u32>,
    /// File with the gauge's keys: lines such as `unseal = 0414 3672`; nobody else may read it
    #[arg(long, value_name = "FILE", help_heading = "Access")]
    key_file: Option<PathBuf>,
    /// Never try the manual's default key
    #[arg(long, help_heading = "Access")]
    no_default_keys: bool,
    /// In which order the gauge takes the bytes of a challenge, lsb-first or as-sent; `gaugefs auth`
    /// tells which one fits
    #[arg(long, value_name = "ORDER", default_value = "lsb-first", value_parser = order, help_heading = "Access")]
    auth_order: Order,

    /// Stay in the foreground and log to standard error
    #[arg(short, long, help_heading = "Running")]
    foreground: bool,
    /// Log to this file [default: syslog, in the foreground standard error]
    #[arg(long, value_name = "FILE", help_heading = "Running")]
    log: Option<PathBuf>,
    /// Folder for the journal, which lets a write survive a power cut [default: /var/lib/gaugefs; without
    /// root, ~/.local/state/gaugefs]
    #[arg(long, value_name = "DIR", help_heading = "Running")]
    state_dir: Option<PathBuf>,
    /// Write every transfer to this file; keys are left out
    #[arg(long, value_name = "FILE", help_heading = "Running")]
    trace: Option<PathBuf>,
}

/// Unmount; the gauge is let go
#[derive(Args, Debug)]
#[command(after_help = UMOUNT)]
struct Umount {
    /// Folder that it is mounted at
    mountpoint: PathBuf,
}

/// Look what answers on a bus, without harm to what is no gauge
#[derive(Args, Debug)]
#[command(after_help = PROBE)]
struct Probe {
    /// The I2C bus, such as /dev/i2c-1
    #[arg(long, value_name = "DEVICE")]
    bus: PathBuf,
    /// Ask what is at this 7-bit address who it is
    #[arg(long, value_name = "ADDRESS", value_parser = address)]
    address: Option<u8>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// List the supported gauges, and how far each has been proven
#[derive(Args, Debug)]
struct Chips {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Write a mounted gauge's configuration to a file
#[derive(Args, Debug)]
#[command(after_help = EXPORT)]
struct Export {
    /// A mounted gauge's folder, such as /run/gauges/BAT0
    gauge: PathBuf,
    /// Format of the file
    #[arg(long, value_enum, default_value = "toml")]
    format: FormatName,
    /// File to write [default: standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// The formats on the command line.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum FormatName {
    Toml,
    #[value(name = "gg.csv")]
    GgCsv,
    Flashstream,
}

/// Give a mounted gauge the configuration of a file, all of it or nothing
#[derive(Args, Debug)]
#[command(after_help = IMPORT)]
struct Import {
    /// A mounted gauge's folder, such as /run/gauges/BAT0
    gauge: PathBuf,
    /// A file of any format
    file: PathBuf,
    /// Only show what would change
    #[arg(long)]
    dry_run: bool,
    /// Leave these as they are
    #[arg(long, value_enum, value_delimiter = ',', value_name = "GROUPS")]
    exclude: Vec<GroupName>,
}

/// The groups of parameters that an import can leave alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum GroupName {
    /// The classes Calibration: measured for each circuit
    Calibration,
    /// Serial number, date and lots
    Serial,
    /// What the gauge has learned of its pack
    Learned,
}

/// Compare two configurations, parameter by parameter
#[derive(Args, Debug)]
#[command(after_help = DIFF)]
struct Diff {
    /// A mounted gauge's folder, or a file of any format
    a: PathBuf,
    /// Another
    b: PathBuf,
    /// What a file is for that does not tell
    #[arg(long, value_name = "CHIP", value_parser = chip_names(), ignore_case = true, hide_possible_values = true)]
    chip: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Show what a configuration file would set, and what is wrong with it
#[derive(Args, Debug)]
#[command(after_help = LINT)]
struct Lint {
    /// A file of any format
    file: PathBuf,
    /// What it is for, where it does not tell
    #[arg(long, value_name = "CHIP", value_parser = chip_names(), ignore_case = true, hide_possible_values = true)]
    chip: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Key words from the command line, which are not shown again.
#[derive(Clone)]
struct Key([u16; 2]);

impl std::fmt::Debug for Key {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("hidden")
    }
}

/// Does what the arguments say; the exit code is 0 for done, 1 for failed, 2 for misuse.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let cli = match Cli::try_parse_from(arguments) {
        Ok(cli) => cli,
        Err(error) if error.use_stderr() => {
            let text = error.to_string();
            let text = text.strip_prefix("error: ").map_or(text.clone(), |text| format!("gaugefs: {text}"));
            eprint!("{text}");
            return ExitCode::from(2);
        }
        Err(help) => {
            print(&help.to_string());
            return ExitCode::SUCCESS;
        }
    };
    let done = match cli.command {
        Command::Mount(mount) => mount.run(),
        Command::Umount(umount) => mountpoint::unmount(&umount.mountpoint).map(|()| ExitCode::SUCCESS),
        Command::Probe(probe) => probe.run(),
        Command::Chips(chips) => {
            print(&chips.table());
            Ok(ExitCode::SUCCESS)
        }
        Command::Export(export) => export.run(),
        Command::Import(import) => import.run(),
        Command::Diff(diff) => diff.run(),
        Command::Lint(lint) => lint.run(),
        Command::Auth(auth) => auth.run().map(|told| {
            print(&told);
            ExitCode::SUCCESS
        }),
    };
    done.unwrap_or_else(|error| {
        eprintln!("gaugefs: {error}");
        ExitCode::FAILURE
    })
}

/// Prints to standard output; a reader that has seen enough is no failure.
fn print(text: &str) {
    use std::io::Write;
    let _ = std::io::stdout().write_all(text.as_bytes());
}

impl Mount {
    fn run(self) -> Result<ExitCode> {
        if !self.foreground && !background::is_child() {
            return background::start();
        }
        daemon::run(self.options()).map(|()| ExitCode::SUCCESS)
    }

    fn options(self) -> daemon::Options {
        let known = |name: &str| Chip::by_name(name).expect("clap took only names of chips");
        let source = match (self.sim, self.replay, self.bus) {
            (Some(chip), _, _) => {
                Source::Sim { chip: known(&chip), state: self.sim_state, key: self.sim_key.map(|key| key.0) }
            }
            (None, Some(file), _) => Source::Recorded(file),
            (None, None, bus) => Source::Bus {
                bus: bus.expect("clap wants --sim, --bus or --replay"),
                address: self.address,
                chip: self.chip.as_deref().map(known),
            },
        };
        let recorded = matches!(source, Source::Recorded(_));
        let simulated = matches!(source, Source::Sim { .. });
        daemon::Options {
            mountpoint: self.mountpoint,
            source,
            byte_writes: self.byte_writes,
            name: self.name,
            ac: self.ac,
            interval: self.poll.unwrap_or(Duration::from_secs(if simulated || recorded { 3 } else { 30 })),
            scales: Scales {
                current: self.current_scale,
                voltage: self.voltage_scale,
                energy: self.energy_scale,
                absolute_current: self.absolute_current,
                energy_shown: self.energy,
            },
            read_only: self.read_only || recorded,
            allow_unproven: self.allow_unproven,
            limits: Limits {
                allow_learning: self.allow_learning,
                writes_per_hour: self.writes_per_hour.unwrap_or(WRITES_PER_HOUR),
            },
            auth_order: self.auth_order,
            restore: self.restore,
            private: self.private,
            group: self.group,
            keyring: Keyring { file: self.key_file, no_default: self.no_default_keys },
            foreground: self.foreground,
            log: self.log,
            trace: self.trace,
            state_dir: self.state_dir,
        }
    }
}

impl Export {
    fn run(self) -> Result<ExitCode> {
        let image = Image::of_mounted(&self.gauge)?;
        let text = image.write(self.format.into(), &self.gauge)?;
        match self.output {
            None => print(&text),
            Some(file) => std::fs::write(&file, text)
                .map_err(|error| Error::io(file.display().to_string(), "cannot be written", &error))?,
        }
        Ok(ExitCode::SUCCESS)
    }
}

impl Import {
    fn run(self) -> Result<ExitCode> {
        let gauge = Image::of_mounted(&self.gauge)?;
        let file = Image::open(&self.file, Some(gauge.chip))?;
        let groups: Vec<Group> = self.exclude.iter().map(|&name| name.into()).collect();
        let changes =
            gauge.changes(&file, &groups).map_err(|error| error.within(&self.file.display().to_string()))?;
        if !self.dry_run {
            image::apply(&self.gauge, &changes)?;
        }
        print(&changes.iter().map(|change| format!("{change}\n")).collect::<String>());
        Ok(ExitCode::SUCCESS)
    }
}

impl From<GroupName> for Group {
    fn from(name: GroupName) -> Self {
        match name {
            GroupName::Calibration => Group::Calibration,
            GroupName::Serial => Group::Serial,
            GroupName::Learned => Group::Learned,
        }
    }
}

impl From<FormatName> for Format {
    fn from(name: FormatName) -> Self {
        match name {
            FormatName::Toml => Format::Toml,
            FormatName::GgCsv => Format::GgCsv,
            FormatName::Flashstream => Format::FlashStream,
        }
    }
}

impl Diff {
    /// As diff(1): whoever asks for a difference has to tell "none" from "cannot say".
    fn run(self) -> Result<ExitCode> {
        self.compare().or_else(|error| {
            eprintln!("gaugefs: {error}");
            Ok(ExitCode::from(2))
        })
    }

    fn compare(self) -> Result<ExitCode> {
        let told = self.chip.as_deref().and_then(Chip::by_name);
        // A gauge tells what a file beside it is for.
        let first = if self.a.is_dir() { Some(Image::open(&self.a, None)?) } else { None };
        let b = Image::open(&self.b, told.or(first.as_ref().map(|image| image.chip)))?;
        let a = match first {
            Some(image) => image,
            None => Image::open(&self.a, told.or(Some(b.chip)))?,
        };
        let comparison = a.compare(&b)?;
        let differences = &comparison.differences;
        if self.json {
            let rows = differences.iter().map(|difference| {
                json::object(&[
                    ("name", json::text(&difference.name)),
                    ("a", json::text(&difference.old.text())),
                    ("b", json::text(&difference.new.text())),
                    ("unit", json::text(difference.new.parameter.unit)),
                ])
            });
            print(&(json::array(rows) + "\n"));
        } else {
            print(&differences.iter().map(|difference| format!("{difference}\n")).collect::<String>());
        }
        for (count, name) in [(comparison.only_first, &self.a), (comparison.only_second, &self.b)] {
            if count > 0 {
                let count = counted(count);
                eprintln!("gaugefs: {}: {count} that the other does not have", name.display());
            }
        }
        Ok(if differences.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }
}

impl Lint {
    fn run(self) -> Result<ExitCode> {
        let image = Image::open(&self.file, self.chip.as_deref().and_then(Chip::by_name))?;
        if self.json {
            let rows = image.entries.iter().map(|entry| {
                json::object(&[
                    ("name", json::text(&image.name(entry))),
                    ("value", json::text(&entry.text())),
                    ("unit", json::text(entry.parameter.unit)),
                    ("line", entry.line.to_string()),
                ])
            });
            let notes = image.notes.iter().map(|note| json::text(note));
            let all = [
                ("chip", json::text(image.chip.name)),
                ("parameters", json::array(rows)),
                ("notes", json::array(notes)),
            ];
            print(&(json::object(&all) + "\n"));
        } else {
            print(&format!("{}: {}\n", image.chip.model, counted(image.entries.len())));
            let rows = image.entries.iter().map(|entry| {
                let unit = entry.parameter.unit;
                let mark = if matches!(entry.is_imported(), Ok(false)) { "not imported" } else { "" };
                let value = format!("{} {unit}", entry.text());
                [image.name(entry), value, format!("line {}", entry.line), mark.to_string()]
            });
            print(&align(&rows.collect::<Vec<_>>()));
            print(&image.notes.iter().map(|note| format!("{note}\n")).collect::<String>());
        }
        let mut code = ExitCode::SUCCESS;
        for error in image.entries.iter().filter_map(|entry| entry.is_imported().err()) {
            eprintln!("gaugefs: {}", error.within(&self.file.display().to_string()));
            code = ExitCode::FAILURE;
        }
        Ok(code)
    }
}

impl Chips {
    fn table(&self) -> String {
        if self.json {
            let chips = CHIPS.iter().map(|chip| {
                json::object(&[
                    ("name", json::text(chip.name)),
                    ("model", json::text(chip.model)),
                    ("data_flash", json::text(scheme(chip))),
                    ("parameters", parameters(chip).to_string()),
                    ("unproven", unproven(chip).to_string()),
                    ("evidence", json::text(evidence(chip.evidence))),
                    ("documents", json::array(chip.documents.iter().map(|document| json::text(document)))),
                ])
            });
            return json::array(chips) + "\n";
        }
        let mut rows =
            vec![["CHIP", "DATA", "PARAMETERS", "UNPROVEN", "EVIDENCE", "DOCUMENT"].map(String::from)];
        rows.extend(CHIPS.iter().map(|chip| {
            [
                chip.name.to_string(),
                scheme(chip).to_string(),
                parameters(chip).to_string(),
                unproven(chip).to_string(),
                evidence(chip.evidence).to_string(),
                chip.documents.first().copied().unwrap_or_default().to_string(),
            ]
        }));
        align(&rows)
    }
}

fn parameters(chip: &Chip) -> usize {
    chip.subclasses.iter().map(|subclass| subclass.parameters.len()).sum()
}

/// Parameters that are read-only because their address or range is not sure.
fn unproven(chip: &Chip) -> usize {
    let rows = chip.subclasses.iter().flat_map(|subclass| subclass.parameters);
    rows.filter(|parameter| parameter.unproven).count()
}

fn counted(parameters: usize) -> String {
    if parameters == 1 { "1 parameter".into() } else { format!("{parameters} parameters") }
}

fn scheme(chip: &Chip) -> &'static str {
    match chip.access.scheme {
        Scheme::Block | Scheme::Mac => "flash",
        Scheme::CfgUpdate => "RAM",
    }
}

fn evidence(evidence: Evidence) -> &'static str {
    match evidence {
        Evidence::Manual => "manual",
        Evidence::Transcript => "manual, transcripts",
        Evidence::Unproven => "relatives, drivers",
    }
}

/// One line of what `probe` found.
struct Found {
    address: u8,
    /// A word for programs: gauge, maybe, rom, driver, busy, other, nothing.
    state: &'static str,
    chips: Vec<&'static str>,
    details: String,
}

impl Probe {
    fn run(self) -> Result<ExitCode> {
        let adapter = Adapter::find(&self.bus)?;
        let found = match self.address {
            Some(address) => vec![look(&adapter, address, true)?],
            None => vec![look(&adapter, GAUGE_ADDRESS, false)?, look_for_rom(&adapter)?],
        };
        let is_gauge = |found: &Found| matches!(found.state, "gauge" | "maybe" | "rom" | "driver" | "busy");
        let any = found.iter().any(is_gauge);
        print(&if self.json { Self::json(&adapter, &found) } else { self.table(&adapter, &found) });
        Ok(if any { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }

    fn json(adapter: &Adapter, found: &[Found]) -> String {
        let found = found.iter().map(|found| {
            json::object(&[
                ("address", found.address.to_string()),
                ("state", json::text(found.state)),
                ("chips", json::array(found.chips.iter().map(|chip| json::text(chip)))),
                ("details", json::text(&found.details)),
            ])
        });
        let name = adapter.name().unwrap_or_default();
        let all = [
            ("bus", json::text(&adapter.to_string())),
            ("adapter", json::text(&name)),
            ("found", json::array(found)),
        ];
        json::object(&all) + "\n"
    }

    fn table(&self, adapter: &Adapter, found: &[Found]) -> String {
        let mut rows = vec![["ADDRESS", "ANSWERS", "DETAILS"].map(String::from)];
        for found in found {
            let who = match found.state {
                "nothing" => "no".to_string(),
                "gauge" => found.chips.join(" or "),
                "maybe" => format!("maybe {}", found.chips.join(" or ")),
                "rom" => "a gauge in ROM mode?".to_string(),
                "driver" => "the kernel's".to_string(),
                "busy" => "in use".to_string(),
                _ => "something else".to_string(),
            };
            rows.push([format!("0x{:02x}", found.address), who, found.details.clone()]);
        }
        let mut table = align(&rows);
        if self.address.is_none() && found.iter().any(|found| found.state == "maybe") {
            // Writing to a String does not fail.
            let _ = writeln!(table, "To ask it who it is: gaugefs probe --bus {adapter} --address 0x55");
        }
        table
    }
}

/// What is at an address; asked who it is only where the user has named it.
fn look(adapter: &Adapter, address: u8, named: bool) -> Result<Found> {
    let found = |state, chips, details| Ok(Found { address, state, chips, details });
    if let Some(driver) = adapter.driver(address) {
        let details = format!("driver {} ({}) has it; not touched", driver.name, driver.device);
        return found("driver", Vec::new(), details);
    }
    let clock: Arc<dyn Clock> = Arc::new(RealClock::new());
    let open = || {
        let bus = LinuxBus::open(adapter.clone(), address, clock.clone())?;
        Ok(Box::new(bus) as Box<dyn Bus>)
    };
    let plausible = match probe::candidates(&open, &clock) {
        Ok(plausible) => plausible,
        Err(error) => match error.errno() {
            nix::errno::Errno::ENXIO => return found("nothing", Vec::new(), String::new()),
            nix::errno::Errno::EBUSY => return found("busy", Vec::new(), "another gaugefs has it".into()),
            _ => return Err(error),
        },
    };
    let Some(first) = plausible.first() else {
        return found("other", Vec::new(), "does not read like a gauge; nothing was written to it".into());
    };
    let reads = reads(first);
    if !named {
        let chips = plausible.iter().map(|reading| reading.chip.name).collect();
        return found("maybe", chips, reads);
    }
    let who = probe::identify(&plausible, &open, &clock)?;
    let answers = who.answers;
    let told = format!(
        "device type 0x{:04x}, firmware 0x{:04x}, hardware 0x{:04x}",
        answers.device_type, answers.firmware_version, answers.hardware_version
    );
    let chips = who.chips.iter().map(|chip| chip.name).collect::<Vec<_>>();
    match who.sibling {
        _ if !chips.is_empty() => found("gauge", chips, format!("{told}; {reads}")),
        Some(sibling) => {
            let what = match sibling.like {
                Some(like) => format!("mounts as a {}, without data flash", like.name),
                None => "not supported".to_string(),
            };
            found("other", chips, format!("{told}: a {}; {what}", sibling.name))
        }
        None => found("other", chips, format!("{told}: no part that gaugefs knows")),
    }
}

/// A gauge in ROM mode answers at an address of its own; one byte is read from it, and none written.
fn look_for_rom(adapter: &Adapter) -> Result<Found> {
    let address = ROM_ADDRESS;
    let found =
        |state, details: &str| Ok(Found { address, state, chips: Vec::new(), details: details.into() });
    if let Some(driver) = adapter.driver(address) {
        return found("driver", &format!("driver {} ({}) has it; not touched", driver.name, driver.device));
    }
    let mut bus = LinuxBus::open(adapter.clone(), address, Arc::new(RealClock::new()))?;
    match bus.transfer(&[], &mut [0]) {
        Ok(()) => found("rom", "a gauge whose flash was being programmed, unless another device lives there"),
        Err(crate::bus::BusError::NoAck) => found("nothing", ""),
        Err(error) => Err(Error::from(error).about(format!("{adapter} address 0x{address:02x}"))),
    }
}

/// What a person recognises a pack by.
fn reads(reading: &Reading) -> String {
    let mut parts = Vec::new();
    let mut add = |role, show: &dyn Fn(f64) -> String| {
        if let Some(value) = reading.value(role) {
            parts.push(show(value as f64));
        }
    };
    add(Role::VoltageNow, &|mv| format!("{:.3} V", mv / 1000.0));
    add(Role::CurrentNow, &|ma| format!("{:.3} A", ma / 1000.0));
    add(Role::Capacity, &|percent| format!("{percent} %"));
    add(Role::Temp, &|kelvin| format!("{:.1} °C", (kelvin - 2731.0) / 10.0));
    parts.join(", ")
}

/// Columns as wide as their widest cell, two spaces between.
fn align<const N: usize>(rows: &[[String; N]]) -> String {
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let mut table = String::new();
    for row in rows {
        let cells = row.iter().enumerate().map(|(at, cell)| format!("{cell:0$}", width(at)));
        let line = cells.collect::<Vec<_>>().join("  ");
        // Writing to a String does not fail.
        let _ = writeln!(table, "{}", line.trim_end());
    }
    table
}

fn chip_names() -> PossibleValuesParser {
    PossibleValuesParser::new(CHIPS.iter().map(|chip| chip.name))
}

fn key_words(text: &str) -> Result<Key, String> {
    keys::words(text).map(Key).ok_or_else(|| "expected two words, such as '0414 3672'".into())
}

fn order(text: &str) -> Result<Order, String> {
    Order::by_name(text).ok_or_else(|| "expected lsb-first or as-sent".into())
}

fn address(text: &str) -> Result<u8, String> {
    let digits = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X"));
    let number = digits.map_or_else(|| text.parse(), |digits| u8::from_str_radix(digits, 16));
    match number {
        Ok(address @ 0x08..=0x77) => Ok(address),
        _ => Err("expected a 7-bit address, 0x08 to 0x77".into()),
    }
}

fn interval(text: &str) -> Result<Duration, String> {
    match text.parse() {
        Ok(seconds @ 0.5..=3600.0) => Ok(Duration::from_secs_f64(seconds)),
        _ => Err("expected 0.5 to 3600 seconds".into()),
    }
}

fn factor(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(factor @ 0.001..=1000.0) => Ok(factor),
        _ => Err("expected a factor from 0.001 to 1000".into()),
    }
}

/// The name goes into uevent, paths and other people's shell scripts.
fn name(text: &str) -> Result<String, String> {
    let allowed = |byte: u8| byte.is_ascii_alphanumeric() || b"._+-".contains(&byte);
    if !text.is_empty() && text.len() <= 64 && text.bytes().all(allowed) && !text.starts_with(['.', '-']) {
        Ok(text.to_string())
    } else {
        Err("expected letters, digits and . _ + -, at most 64, no dot or dash first".into())
    }
}

fn group(text: &str) -> Result<u32, String> {
    if let Ok(gid) = text.parse() {
        return Ok(gid);
    }
    match nix::unistd::Group::from_name(text) {
        Ok(Some(group)) => Ok(group.gid.as_raw()),
        _ => Err("there is no such group".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_definition_is_sound() {
        use clap::CommandFactory;
        Cli::command().debug_assert();
    }

    #[test]
    fn values_are_checked() {
        assert_eq!(address("0x55"), Ok(0x55));
        assert_eq!(address("85"), Ok(0x55));
        assert!(["0x07", "0x78", "0xaa", "55h", ""].iter().all(|text| address(text).is_err()));
        assert_eq!(interval("0.5"), Ok(Duration::from_millis(500)));
        assert!(["0.4", "3601", "NaN", "-1", "inf"].iter().all(|text| interval(text).is_err()));
        assert!(["0", "-1", "NaN", "1e9"].iter().all(|text| factor(text).is_err()));
        assert!(["", "..", "a/b", "a b", "-x", "BAT\n"].iter().all(|text| name(text).is_err()));
        assert_eq!(name("BAT_1.2"), Ok("BAT_1.2".into()));
    }
}
