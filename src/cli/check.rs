// SPDX-License-Identifier: MIT

//! `gaugefs check`: is a gauge set up for its battery, and what is wrong if it is not.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, Write as _};
use std::os::fd::AsRawFd;
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use clap::{ArgGroup, Args};
use nix::errno::Errno;
use nix::sys::memfd::{MFdFlags, memfd_create};
use serde::Serialize;

use super::unmounted::Unmounted;
use super::{PASSED_OVER, mounted, trouble};
use crate::config::standard_input;
use crate::error::{Cause, Error, Result, shown};
use crate::output::{print, print_json, say_error};
use crate::{check, report};
use gauge_bus::clock::{Clock, HurriedClock, RealClock};
use gauge_owner::{GaugeOptions, Opening, operations as op};
use gaugefs_client::check::Finding;
use gaugefs_client::{Gauge, mounts};
use gaugefs_host::input::Source;
use ti_gauge::check::{Battery, Checked, Facts, Has, RULES, Rule};
use ti_gauge::chip::{Chip, Row, Scale};
use ti_gauge::text::printable;

mod battery;

use battery::Fitting;

/// How often a gauge that is not mounted is polled at most: one that has measured nothing by then will not.
const POLLS: u32 = 5;

/// How many gauges are looked at together: each waits for its own data flash.
const AT_ONCE: usize = 64;

const STANDARD_INPUT: &str = "-";

const CHECK: &str = "\
The rules look at the last poll, at what earlier polls have shown, and at data flash as far as it has
been read; with --read, it is read first. Nothing is written without --fix --write. A file is a report (gaugefs report), a
recording, or an image of a configuration, of which only data flash is checked; - is standard input.
Exit code 0: nothing is wrong; 1: something is, or it could not be checked; 3: nothing is wrong, but
values were missing; 2: misuse. Doubts, notes, and rules that would need --read do not change it.

BATTERY is a chemistry (li-ion, lifepo4, nimh, nicd, lead-acid, li-socl2, li-mno2), cells in series and
in parallel (3s, 3s2p), and the capacity of all, or of one as 2600mAh/cell. More may follow: energy=57.7Wh,
taper-current=260mA, and of one cell charge-voltage=4.2V and terminate-voltage=3V; what is not said is
left alone if it suits the chemistry. A file has the same names in TOML, with values in quotes, or is a
simple-battery node: source of a device tree, or its folder below /sys/firmware/devicetree. Rows that
differ are shown with their source, then what no row gives: calibration, chemistry, learning.

Examples:
  gaugefs check /run/gauges/BAT0
  gaugefs check --read --json BAT0
  gaugefs check gaugefs-report-bq34z100-g1.txt
  gaugefs check golden.gm.fs
  gaugefs check --for 'li-ion 3s 5200mAh' BAT0
  gaugefs check --for 'li-ion 3s 5200mAh' --fix --write BAT0";

/// Check that a gauge is set up for its battery, and show what is wrong if it is not
#[derive(Args, Debug)]
#[command(after_help = CHECK, group = ArgGroup::new("source").required(true).multiple(false).args(["gauges", "bus", "replay", "sim", "rules"]))]
pub(super) struct Check {
    /// Folders of mounted gauges, such as /run/gauges/BAT0, or files; - is standard input
    #[arg(value_name = "GAUGE")]
    gauges: Vec<PathBuf>,
    #[command(flatten)]
    unmounted: Unmounted,
    /// File that --trace has written
    #[arg(long, value_name = "FILE", conflicts_with_all = ["address", "chip", "byte_writes", "key_file", "no_default_keys"])]
    replay: Option<PathBuf>,
    /// Read data flash first, for the rules that need it
    #[arg(long)]
    read: bool,
    /// Say what the gauge should hold for this battery, such as 'li-ion 3s 5200mAh', or for that of a file
    #[arg(long = "for", value_name = "BATTERY")]
    battery: Option<String>,
    /// Print the `gaugefs set` that would give the gauge these rows
    #[arg(long, requires = "battery")]
    fix: bool,
    /// Write them to a mounted gauge, all of them or none
    #[arg(long, requires = "fix", conflicts_with_all = ["bus", "replay", "sim"])]
    write: bool,
    /// Print all rules, with their limits and sources
    #[arg(long, conflicts_with_all = ["read", "json", "battery"])]
    rules: bool,
    /// Print JSON, one object per line for each gauge
    #[arg(long)]
    json: bool,
}

/// What a check has found, for --json.
#[derive(Default, Serialize)]
struct Answer {
    gauge: String,
    findings: Vec<Line>,
    /// Rules that lack a value of a poll.
    missing: Vec<Line>,
    /// Rules that need data flash which was not read.
    not_looked_at: Vec<String>,
    /// For --for.
    #[serde(skip_serializing_if = "Option::is_none")]
    battery: Option<Fitting>,
    error: Option<String>,
    exit_code: u8,
}

#[derive(Serialize)]
struct Line {
    severity: String,
    rule: String,
    values: String,
    means: String,
    remedy: String,
    source: &'static str,
}

/// A gauge that was looked at.
struct Looked {
    gauge: String,
    /// As in `gauge/check`.
    text: String,
    battery: Option<Fitting>,
}

impl Check {
    pub(super) fn run(self) -> Result<ExitCode> {
        if self.rules {
            print(&RULES.iter().map(described).collect::<String>())?;
            return Ok(ExitCode::SUCCESS);
        }
        let wanted = match self.battery.as_deref().map(battery::parse).transpose() {
            Ok(wanted) => wanted,
            Err(error) => return trouble(Err(error)),
        };
        if let Some(file) = self.gauges.iter().filter(|_| self.write).find(|path| !is_mounted(path)) {
            let why = "only a mounted gauge is written; mount it, and name its folder";
            return trouble(Err(Error::new(shown(file), Cause::Invalid, why)));
        }
        let told = self.unmounted.chip.is_some();
        if let Some(gauge) = self.gauges.iter().filter(|_| told).find(|path| is_mounted(path)) {
            let why = "--chip is for files and gauges that are not mounted";
            return trouble(Err(Error::new(shown(gauge), Cause::Invalid, why)));
        }
        let files: Vec<Option<&Path>> = match self.gauges.is_empty() {
            true => vec![None],
            false => self.gauges.iter().map(|path| Some(path.as_path())).collect(),
        };
        let mut worst = 0;
        let looks = files.chunks(AT_ONCE).flat_map(|files| self.looks(files, wanted.as_ref()));
        for (path, looked) in looks {
            let mut answer = Answer::default();
            match looked {
                Ok(looked) => answer.take(looked),
                Err(error) => {
                    answer.gauge = path.map_or_else(String::new, |path| path.display().to_string());
                    (answer.error, answer.exit_code) = (Some(error.to_string()), 1);
                    say_error(&error);
                }
            }
            worst = match (worst, answer.exit_code) {
                // 1 is worse than 3.
                (1, _) | (_, 0) => worst,
                (_, code) => code,
            };
            match (self.json, &answer.error) {
                (true, _) => print_json(&answer)?,
                (false, None) => print(&answer.text(self.fix, self.read))?,
                (false, Some(_)) => {}
            }
        }
        Ok(worst.into())
    }

    /// Looks at some gauges, at the same time if what they wait for is their data flash.
    fn looks<'a>(
        &self,
        files: &[Option<&'a Path>],
        wanted: Option<&Battery>,
    ) -> Vec<(Option<&'a Path>, Result<Looked>)> {
        let look = |path: Option<&Path>| {
            path.map_or_else(|| self.unmounted(wanted), |path| self.named(path, wanted))
        };
        if !self.read || files.len() == 1 {
            return files.iter().map(|path| (*path, look(*path))).collect();
        }
        thread::scope(|scope| {
            let looks: Vec<_> = files.iter().map(|path| (*path, scope.spawn(|| look(*path)))).collect();
            let end = |look: thread::ScopedJoinHandle<'_, _>| {
                look.join().unwrap_or_else(|panic| resume_unwind(panic))
            };
            looks.into_iter().map(|(path, look)| (path, end(look))).collect()
        })
    }

    /// Checks a mounted gauge, or a file.
    fn named(&self, path: &Path, wanted: Option<&Battery>) -> Result<Looked> {
        if is_mounted(path) {
            return self.mounted(&Gauge::open(path).map_err(|error| missing(path, error))?, wanted);
        }
        let is_input = path == Path::new(STANDARD_INPUT);
        let source = Source::read(path)?;
        let name = source.name.clone();
        if report::chip(&String::from_utf8_lossy(&source.bytes)).is_some() {
            // A pipe is read once.
            let kept = if is_input { Some(in_memory(&source.bytes)?) } else { None };
            let held = |file: &File| format!("/proc/self/fd/{}", file.as_raw_fd()).into();
            let replay = Some(kept.as_ref().map_or_else(|| path.to_path_buf(), held));
            return self.opened(name, &GaugeOptions { replay, ..GaugeOptions::default() }, wanted);
        }
        let image = source.image(self.unmounted.chip, false)?;
        let stored = |row: Row| image.entry(row).map(|entry| entry.value.clone());
        let has = Has { chip: image.chip, chem_id: None, stored: &stored, current: None, energy: None };
        let battery = wanted.map(|wanted| battery::compared(&name, wanted, &has)).transpose()?;
        let text = check::text(&Checked::of(&Facts::of_flash(image.chip, &stored)));
        Ok(Looked { gauge: name, text, battery })
    }

    fn mounted(&self, gauge: &Gauge, wanted: Option<&Battery>) -> Result<Looked> {
        const FILE: &str = "gauge/check";
        if self.write {
            mounted::poll(gauge)?;
        }
        let battery = wanted.map(|wanted| battery::mounted(gauge, wanted, self.write)).transpose()?;
        // Of a part without a table, nothing is looked at there.
        if self.read && gauge.folder().join("df/index").exists() {
            gauge.text("df/index").map_err(|error| error.doing("data flash cannot be read"))?;
        }
        let absent = |error: gaugefs_client::Error| match error.errno() == Some(Errno::ENOENT as i32) {
            true => {
                Error::host(gauge.folder().display().to_string(), Errno::ENODEV, "the gauge does not answer")
            }
            false => error.doing("cannot be checked").into(),
        };
        let text = gauge.text(FILE).map_err(absent)?;
        Ok(Looked { gauge: gauge.folder().display().to_string(), text, battery })
    }

    fn unmounted(&self, wanted: Option<&Battery>) -> Result<Looked> {
        let replay = self.replay.clone().map(standard_input);
        let options = GaugeOptions { replay, ..self.unmounted.options() };
        self.opened(gauge_owner::Source::of(&options)?.to_string(), &options, wanted)
    }

    /// Checks a gauge that is opened for it, and polled until it has measured.
    fn opened(&self, name: String, options: &GaugeOptions, wanted: Option<&Battery>) -> Result<Looked> {
        // A recording needs no waits.
        let clock: Arc<dyn Clock> = match options.replay {
            Some(_) => Arc::new(HurriedClock::default()),
            None => Arc::new(RealClock::new()),
        };
        let place = Path::new("/proc").join(std::process::id().to_string());
        let opening = Opening { read_only: true, no_backup: true, ..Opening::new(place, clock.clone()) };
        let ready = opening.one("check".into(), options)?;
        let handle = &ready.handle;
        let failed = |error: Error| error.within(&name);
        for _ in 0..POLLS {
            handle.wait_for(&op::REFRESH, ()).map_err(failed)?;
            if handle.published().snapshot.as_ref().is_some_and(|snapshot| snapshot.is_valid) {
                break;
            }
            clock.sleep(Duration::from_secs(1));
        }
        let chip = handle.chip();
        if self.read && options.replay.is_some() {
            // As much as was recorded.
            for index in readable(chip) {
                let _ = handle.wait_for(&op::READ, vec![index]);
            }
        } else if (self.read || wanted.is_some()) && options.replay.is_none() && chip.has_table() {
            let rows = if wanted.is_some() { Battery::rows(chip) } else { Vec::new() };
            let is_wanted = |index: &usize| {
                self.read
                    || rows.iter().any(|(subclass, _)| std::ptr::eq(*subclass, &chip.subclasses[*index]))
            };
            handle.wait_for(&op::READ, readable(chip).filter(is_wanted).collect()).map_err(failed)?;
        }
        let published = handle.published();
        let none = || Error::host(&name, Errno::ENODEV, "the gauge does not answer");
        let snapshot = published.snapshot.as_ref().ok_or_else(none)?;
        let stored = |(subclass, row): Row| handle.kept_value((subclass.id, row.offset), row.kind);
        let scale = |scale| match scale {
            Scale::Register(source) => {
                snapshot.registers().value(chip.register_at(source)?).map(|scale| scale as f64)
            }
            Scale::None | Scale::Flash(..) | Scale::Power(..) => None,
        };
        let (current, energy) = (scale(chip.scaling.current), scale(chip.scaling.energy));
        let has = Has { chip, chem_id: published.answers.chem_id, stored: &stored, current, energy };
        let battery = wanted.map(|wanted| battery::compared(&name, wanted, &has)).transpose()?;
        let text = check::text(&check::of(handle, snapshot, 1.0));
        Ok(Looked { gauge: name.clone(), text, battery })
    }
}

/// Whether it is a mounted gauge, or was meant as one.
fn is_mounted(path: &Path) -> bool {
    let is_found = || Gauge::named(path).is_ok_and(|folder| mounts::of(&folder).is_some());
    path != Path::new(STANDARD_INPUT) && (path.is_dir() || is_found() || !path.exists())
}

/// The error for what is neither a gauge nor a file.
fn missing(path: &Path, error: gaugefs_client::Error) -> Error {
    if path.exists() || mounts::of(path).is_some() {
        return error.into();
    }
    let why = "no such gauge or file; `gaugefs list` shows the gauges that are mounted";
    Error::host(shown(path), Errno::ENOENT, why)
}

/// A file without a name, with these bytes.
fn in_memory(bytes: &[u8]) -> Result<File> {
    let failed = |error: io::Error| Error::io("standard input", "cannot be kept", &error);
    let mut file =
        File::from(memfd_create("input", MFdFlags::MFD_CLOEXEC).map_err(|errno| failed(errno.into()))?);
    file.write_all(bytes).map_err(failed)?;
    Ok(file)
}

/// A rule for people.
fn described(rule: &Rule) -> String {
    let Rule { name, severity, means, remedy, source, .. } = rule;
    format!("{name} ({}): {means}\n    {remedy}\n    {source}\n", severity.as_str())
}

/// The subclasses that a check reads, by their indices in the table.
fn readable(chip: &'static Chip) -> impl Iterator<Item = usize> {
    gauge_owner::readable(chip).into_iter().filter(|&index| !chip.subclasses[index].is_opaque())
}

impl Answer {
    fn take(&mut self, Looked { gauge, text, mut battery }: Looked) {
        // A command takes a gauge that is mounted.
        let is_mounted = Path::new(&gauge).is_dir();
        let names = |text: String| if is_mounted { text.replace("GAUGE", &gauge) } else { text };
        for Finding { severity, rule, values, means, remedy } in Finding::all(&text) {
            let source = Rule::by_name(&rule).map_or("", |rule| rule.source);
            match severity.as_str() {
                "unread" => self.not_looked_at.push(rule),
                "missing" => self.missing.push(Line { severity, rule, values, means, remedy, source }),
                _ => {
                    self.findings.push(Line { severity, rule, values, means, remedy: names(remedy), source })
                }
            }
        }
        if let Some(battery) = battery.as_mut().filter(|_| is_mounted) {
            battery.name(&gauge);
        }
        let is_wrong = self.findings.iter().any(|line| line.severity == "wrong")
            || battery.as_ref().is_some_and(Fitting::is_wrong);
        let is_missing = !self.missing.is_empty() || battery.as_ref().is_some_and(Fitting::is_partly_unread);
        self.exit_code = match (is_wrong, is_missing) {
            (true, _) => 1,
            (false, true) => PASSED_OVER,
            (false, false) => 0,
        };
        self.battery = battery;
        self.gauge = gauge;
    }

    fn text(&self, fix: bool, read: bool) -> String {
        let count = |severity: &str| self.findings.iter().filter(|line| line.severity == severity).count();
        let counts = ["wrong", "doubtful", "note"].map(|word| (word, count(word)));
        let counts: Vec<_> = counts
            .iter()
            .filter(|(_, count)| *count > 0)
            .map(|(word, count)| format!("{word}: {count}"))
            .collect();
        let told = if counts.is_empty() { "nothing found".into() } else { counts.join(", ") };
        let mut text = format!("{}: {told}\n", printable(&self.gauge));
        // Writing to a String does not fail.
        for Line { severity, rule, values, means, remedy, .. } in &self.findings {
            let _ = writeln!(text, "{severity:8}  {rule}: {values}\n          {means}\n          {remedy}");
        }
        for Line { rule, values, .. } in &self.missing {
            let _ = writeln!(text, "missing   {rule}: {values} has no value now");
        }
        if !self.not_looked_at.is_empty() {
            let why =
                if read { ", as it could not be read or the gauge has updated it" } else { " (--read)" };
            let _ =
                writeln!(text, "not looked at without data flash{why}: {}", self.not_looked_at.join(", "));
        }
        text + &self.battery.as_ref().map_or_else(String::new, |battery| battery.text(fix))
    }
}
