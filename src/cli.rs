//! The command line: flags, subcommands and what they print.

use std::ffi::OsString;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use clap::{ArgGroup, Args, CommandFactory, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;

use crate::bus::linux::{Adapter, LinuxBus};
use crate::bus::{Bus, GAUGE_ADDRESS};
use crate::chip::{CHIPS, Chip, Evidence, Role, Scheme};
use crate::clock::{Clock, RealClock};
use crate::config::{self, GaugeOptions, MountOptions, address, chip_names};
use crate::daemon::{self, Gauges, background, mountpoint, service};
use crate::error::{Error, Result};
use crate::fs::Covered;
use crate::image::{self, Format, Group, Image};
use crate::json;
use crate::probe::{self, ROM_ADDRESS, Reading};

mod auth;
mod doctor;
mod keys;
mod manual;
mod progress;

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
  gaugefs mount --config /etc/gaugefs/packs.toml             many gauges

A gauge appears in MOUNTPOINT as the kernel shows a power supply: BAT0/voltage_now,
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
whose address or range is not sure. Where a FlashStream has other bytes than the gauge and no
manual documents them it is refused, but for --raw or --exclude undocumented.

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

const COMPLETIONS: &str = "\
The Debian package installs those of bash, zsh and fish.

Example:
  gaugefs completions bash > ~/.local/share/bash-completion/completions/gaugefs";

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
    Keys(keys::Command),
    #[cfg(feature = "screen")]
    #[command(flatten)]
    Screen(crate::screen::Command),
    Doctor(doctor::Doctor),
    Completions(Completions),
    /// Print the manual page gaugefs(1)
    #[command(hide = true)]
    Man,
    Attach(Box<Attach>),
    /// Take away what services have left that have ended; a step of systemd's units
    #[command(hide = true)]
    Detach,
}

/// Mount gauges; returns once they are mounted and have been read
#[derive(Args, Debug)]
#[command(after_help = MOUNT, group = ArgGroup::new("gauges").required(true).multiple(true).args(["sim", "bus", "replay", "config"]))]
struct Mount {
    /// Any number of gauges, as this file in TOML names them; with --bus, where those are that name none
    #[arg(long, value_name = "FILE", help_heading = "Gauge")]
    config: Option<PathBuf>,
    /// Only read the configuration and say what it would mount
    #[arg(long, requires = "config", conflicts_with_all = ["sim", "replay"], help_heading = "Gauge")]
    check: bool,
    #[command(flatten)]
    gauge: GaugeOptions,
    #[command(flatten)]
    mount: MountOptions,
    /// Stay in the foreground and log to standard error
    #[arg(short, long, help_heading = "Running")]
    foreground: bool,
    /// Leave the mounting to `gaugefs attach`, which systemd's unit runs as root
    #[arg(long, hide = true, requires = "foreground")]
    service: bool,
}

/// Mount what a service serves; a step of systemd's units, with what the service is told
#[derive(Args, Debug)]
#[command(hide = true)]
struct Attach {
    /// The service's process
    #[arg(long)]
    pid: i32,
    #[command(flatten)]
    mount: Mount,
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
    /// Write bytes too that no manual documents
    #[arg(long)]
    raw: bool,
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
    /// Bytes that no manual documents
    Undocumented,
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
    /// Take bytes too that no manual documents
    #[arg(long)]
    raw: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Print what makes a shell complete gaugefs's command line
#[derive(Args, Debug)]
#[command(after_help = COMPLETIONS)]
struct Completions {
    /// The shell
    shell: Shell,
}

/// Runs the command that the arguments name. The exit code is 0 for done, 1 for failed, 2 for misuse.
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
        Command::Attach(attach) => attach
            .mount
            .options()
            .and_then(|options| service::attach(attach.pid, &options))
            .map(|()| ExitCode::SUCCESS),
        Command::Detach => service::detach().map(|()| ExitCode::SUCCESS),
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
        #[cfg(feature = "screen")]
        Command::Screen(command) => command.run(),
        Command::Keys(keys) => keys.run().map(|told| {
            print(&told);
            ExitCode::SUCCESS
        }),
        Command::Doctor(doctor) => {
            let (told, code) = doctor.run();
            print(&told);
            Ok(code)
        }
        Command::Completions(completions) => {
            print(&manual::completions(completions.shell, Cli::command()));
            Ok(ExitCode::SUCCESS)
        }
        Command::Man => {
            print(&manual::page(Cli::command()));
            Ok(ExitCode::SUCCESS)
        }
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
        if self.check {
            print(&plan(self.options()?)?);
            return Ok(ExitCode::SUCCESS);
        }
        if !self.foreground && !background::is_child() {
            return background::start();
        }
        daemon::run(self.options()?).map(|()| ExitCode::SUCCESS)
    }

    fn options(self) -> Result<daemon::Options> {
        let Self { config, gauge, mount, foreground, service, .. } = self;
        let Some(file) = config else {
            let gauge = gauge.of_node()?.gauge().expect("clap wants --sim, --bus, --replay or --config");
            return Ok(daemon::Options { service, ..mount.with(Gauges::One(Box::new(gauge)), foreground) });
        };
        let (mount, gauges) = config::read(&file, mount, gauge.bus())?;
        Ok(daemon::Options { service, ..mount.with(Gauges::Many(gauges), foreground) })
    }
}

/// What a configuration would mount.
fn plan(options: daemon::Options) -> Result<String> {
    let Gauges::Many(gauges) = options.gauges else { return Ok(String::new()) };
    let covered = mountpoint::covered(&options.mountpoint)?;
    let taken = covered.as_ref().map(Covered::names).unwrap_or_default();
    let rows = daemon::named(gauges, &taken).into_iter().map(|(name, gauge)| {
        let chip = gauge.source.chip().map_or("asked", |chip| chip.name);
        let place = options.mountpoint.join(name).display().to_string();
        [place, gauge.source.to_string(), chip.to_string()]
    });
    Ok(align(&rows.collect::<Vec<_>>()))
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
        let named = |error: Error| error.within(&self.file.display().to_string());
        let changes = gauge.changes(&file, &groups).map_err(named)?;
        let raw = if groups.contains(&Group::Undocumented) {
            Vec::new()
        } else {
            file.raw_changes(&self.gauge, self.raw).map_err(named)?
        };
        if !self.dry_run {
            let bar = progress::Bar::start(&self.gauge);
            let outcome = image::apply(&self.gauge, &changes, &raw);
            bar.end();
            outcome?;
        }
        print(&changes.iter().map(|change| format!("{change}\n")).collect::<String>());
        print(&raw.iter().map(|change| format!("{change}\n")).collect::<String>());
        Ok(ExitCode::SUCCESS)
    }
}

impl From<GroupName> for Group {
    fn from(name: GroupName) -> Self {
        match name {
            GroupName::Calibration => Group::Calibration,
            GroupName::Serial => Group::Serial,
            GroupName::Learned => Group::Learned,
            GroupName::Undocumented => Group::Undocumented,
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
            let raw = image.raw.iter().map(|raw| {
                json::object(&[
                    ("name", json::text(&raw.name())),
                    ("bytes", json::text(&raw.text())),
                    ("line", raw.line.to_string()),
                ])
            });
            let all = [
                ("chip", json::text(image.chip.name)),
                ("parameters", json::array(rows)),
                ("raw", json::array(raw)),
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
            let raw = image.raw.iter().filter(|_| self.raw);
            let raw = raw.map(|raw| [raw.name(), raw.text(), format!("line {}", raw.line), String::new()]);
            print(&align(&rows.chain(raw).collect::<Vec<_>>()));
            print(&image.notes.iter().map(|note| format!("{note}\n")).collect::<String>());
            if !self.raw {
                print(&image.undocumented());
            }
        }
        let mut code = ExitCode::SUCCESS;
        let values = image.entries.iter().filter_map(|entry| entry.is_imported().err());
        let raw = image.raw.chunk_by(|one, other| one.line == other.line);
        let raw = raw.filter_map(|line| image.refused(&line[0], self.raw));
        for error in values.chain(raw) {
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

/// A gauge in ROM mode answers at an address of its own.
fn look_for_rom(adapter: &Adapter) -> Result<Found> {
    let address = ROM_ADDRESS;
    let found =
        |state, details: &str| Ok(Found { address, state, chips: Vec::new(), details: details.into() });
    if let Some(driver) = adapter.driver(address) {
        return found("driver", &format!("driver {} ({}) has it; not touched", driver.name, driver.device));
    }
    let mut bus = LinuxBus::open(adapter.clone(), address, Arc::new(RealClock::new()))?;
    match probe::answers_in_rom(&mut bus) {
        Ok(true) => {
            found("rom", "a gauge whose flash was being programmed, unless another device lives there")
        }
        Ok(false) => found("nothing", ""),
        Err(error) => Err(error.about(format!("{adapter} address 0x{address:02x}"))),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_definition_is_sound() {
        Cli::command().debug_assert();
    }
}
