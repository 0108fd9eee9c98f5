//! `gaugefs log`: a gauge's history as CSV, a row for each poll.

use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use clap::Args;
use jiff::{SignedDuration, Timestamp};
use nix::errno::Errno;

use super::sample::{Moment, Sample, decimal};
use super::watch::{Seen, Watch};
use crate::error::{Cause, Error, Result};

const LOG: &str = "\
A row is a poll of the gauge: looking more often gives no more rows, and costs the gauge nothing.
An existing file is continued. While the gauge is away there is one row with empty fields.
`gaugefs plot` draws the file.

Examples:
  gaugefs log /run/gauges/BAT0 -o history.csv
  gaugefs log --interval 60 --count 1440 /run/gauges > day.csv";

/// A row that is due so soon is written: the next poll may be far away.
const EARLY: Duration = Duration::from_millis(250);

/// Write a mounted gauge's history as CSV
#[derive(Args, Debug)]
#[command(after_help = LOG)]
pub(crate) struct Log {
    /// A mount point, or a mounted gauge's folder, such as /run/gauges/BAT0
    gauge: PathBuf,
    /// Least time between two rows [default: every poll]
    #[arg(long, value_name = "SECONDS", value_parser = super::seconds)]
    interval: Option<Duration>,
    /// File to write or to continue [default: standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// End after so many rows
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
}

/// What stands in a column: its name and unit, and its text for a gauge that is there.
type Column = (&'static str, fn(&Sample) -> Option<String>);

const COLUMNS: [Column; 13] = [
    ("status", |sample| Some(sample.status())),
    ("voltage (V)", |sample| millionths(sample, "voltage_now")),
    ("current (A)", |sample| millionths(sample, "current_now")),
    ("charge (Ah)", |sample| millionths(sample, "charge_now")),
    ("full charge (Ah)", |sample| millionths(sample, "charge_full")),
    ("capacity (%)", |sample| plain(sample, "capacity")),
    ("temperature (°C)", |sample| Some(decimal(sample.number("temp")?, 1, 1))),
    ("time to empty (s)", |sample| plain(sample, "time_to_empty_now")),
    ("time to full (s)", |sample| plain(sample, "time_to_full_now")),
    ("cycle count", |sample| plain(sample, "cycle_count")),
    ("state of health (%)", |sample| plain(sample, "state_of_health")),
    ("passed charge (mAh)", |sample| {
        let found = sample.registers.iter().find(|(name, _)| name == "passed_charge");
        found.map(|(_, value)| value.to_string())
    }),
    ("bits", |sample| {
        let words: Vec<_> = sample.words.iter().map(|(_, bits)| bits.as_str()).collect();
        Some(words.join(" ").trim().to_string())
    }),
];

fn millionths(sample: &Sample, name: &str) -> Option<String> {
    Some(decimal(sample.number(name)?, 6, 3))
}

fn plain(sample: &Sample, name: &str) -> Option<String> {
    sample.number(name).map(|value| value.to_string())
}

/// The first line: the moment of a poll in UTC, the gauge, and [`COLUMNS`].
fn header() -> Vec<&'static str> {
    ["time (UTC)", "gauge"].into_iter().chain(COLUMNS.iter().map(|(name, _)| *name)).collect()
}

fn row(gauge: &str, sample: &Sample) -> Vec<String> {
    let text = |column: &Column| if sample.present() { column.1(sample) } else { None };
    let values = COLUMNS.iter().map(|column| text(column).unwrap_or_default());
    [format!("{:.3}", sample.time), gauge.to_string()].into_iter().chain(values).collect()
}

fn name(gauge: &Path) -> String {
    gauge.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// What was written last of a gauge.
struct Last {
    gauge: PathBuf,
    moment: Option<Moment>,
    written: Instant,
}

impl Log {
    pub(super) fn run(self) -> Result<ExitCode> {
        let mut out = Out::open(self.output.as_ref())?;
        let watch = Watch::start(Some(&self.gauge), None)?;
        let mut known: Vec<Last> = Vec::new();
        let mut left = self.count.unwrap_or(u64::MAX);
        let mut said = String::new();
        for report in &watch.reports {
            match report.seen {
                Seen::Sample(sample) => {
                    said.clear();
                    left -= u64::from(self.sample(&mut out, &mut known, report.gauge, &sample)?);
                }
                // What was never there is a mistake; what has gone may come back.
                Seen::Trouble(why) if known.is_empty() => {
                    return Err(Error::host(self.gauge.display().to_string(), Errno::ENOENT, why));
                }
                Seen::Trouble(why) => {
                    if said != why {
                        eprintln!("gaugefs: {}: {why}; waiting for it", report.gauge.display());
                        said = why;
                    }
                    for gone in known.iter_mut().filter(|last| last.moment.is_some()) {
                        gone.moment = None;
                        out.write(&row(&name(&gone.gauge), &Sample::absent()))?;
                    }
                }
                Seen::Learned(_) | Seen::Refused(_) => {}
            }
            if left == 0 || out.closed {
                break;
            }
        }
        Ok(ExitCode::SUCCESS)
    }

    /// Writes a row where there is something new to write; whether it did.
    fn sample(&self, out: &mut Out, known: &mut Vec<Last>, gauge: PathBuf, sample: &Sample) -> Result<bool> {
        let found = known.iter().position(|last| last.gauge == gauge);
        let writes = match found.map(|at| &known[at]) {
            // It may have been written before the file was continued.
            None => !out.has(&gauge, sample.time),
            Some(last) => {
                let news = match (last.moment, sample.moment) {
                    (Some(before), Some(now)) => !before.is(now),
                    (before, now) => before.is_some() != now.is_some(),
                };
                let due = self.interval.is_none_or(|least| last.written.elapsed() + EARLY >= least);
                // How long it was away is worth a row at any time.
                news && (due || sample.moment.is_none() || last.moment.is_none())
            }
        };
        if writes {
            out.write(&row(&name(&gauge), sample))?;
        }
        if writes || found.is_none() {
            let last = Last { gauge, moment: sample.moment, written: Instant::now() };
            match found {
                Some(at) => known[at] = last,
                None => known.push(last),
            }
        }
        Ok(writes)
    }
}

/// Where rows go.
struct Out {
    name: String,
    to: Box<dyn Write>,
    /// The reader has seen enough.
    closed: bool,
    /// The header is still to be written, with the first row.
    untitled: bool,
    /// Gauge and time of the rows that were there before.
    before: Vec<(String, Timestamp)>,
}

impl Out {
    /// A new file gets a header; one with rows has to have the same.
    fn open(path: Option<&PathBuf>) -> Result<Self> {
        let Some(path) = path else {
            let name = "standard output".to_string();
            let to = Box::new(io::stdout());
            return Ok(Self { name, to, closed: false, before: Vec::new(), untitled: true });
        };
        let name = path.display().to_string();
        let file = File::options().read(true).append(true).create(true).open(path);
        let file = file.map_err(|error| Error::io(&name, "cannot write it", &error))?;
        let wrong = |why: &str| {
            let why = format!("{why}; name another file, or move it away");
            Err(Error::new(&name, Cause::Invalid(why)))
        };
        let empty = file.metadata().is_ok_and(|status| status.len() == 0);
        let (mut cut, mut before) = (false, Vec::new());
        if !empty {
            let text = std::fs::read(path).map_err(|error| Error::io(&name, "cannot read it", &error))?;
            let mut reader = csv::Reader::from_reader(text.as_slice());
            match reader.headers() {
                Ok(found) if found.iter().eq(header()) => {}
                _ => return wrong("has other columns than these rows"),
            }
            before.extend(
                reader
                    .into_records()
                    .flatten()
                    .filter_map(|row| Some((row.get(1)?.to_string(), row.get(0)?.parse().ok()?))),
            );
            // Only the last poll can still be the present one.
            before.drain(..before.len().saturating_sub(100));
            cut = text.last() != Some(&b'\n');
        }
        let mut out = Self { name, to: Box::new(file), closed: false, before, untitled: empty };
        // A full disk or a lost power has cut the last row short.
        if cut {
            out.line("\r\n".as_bytes())?;
        }
        Ok(out)
    }

    /// Whether a poll is in the file that is continued.
    fn has(&self, gauge: &Path, time: Timestamp) -> bool {
        let same = |other: Timestamp| time.duration_since(other).abs() < SignedDuration::from_millis(250);
        self.before.iter().any(|(found, at)| *found == name(gauge) && same(*at))
    }

    fn write<T: AsRef<[u8]>>(&mut self, fields: &[T]) -> Result<()> {
        if std::mem::take(&mut self.untitled) {
            self.write(&header())?;
        }
        let failed = |error: io::Error| Error::io(&self.name, "cannot write it", &error);
        let mut line = csv::WriterBuilder::new().terminator(csv::Terminator::CRLF).from_writer(Vec::new());
        line.write_record(fields).map_err(|error| failed(error.into()))?;
        let line = line.into_inner().map_err(|error| failed(error.into_error()))?;
        self.line(&line)
    }

    /// A whole row in one write, so that a file that is read meanwhile holds whole rows.
    fn line(&mut self, line: &[u8]) -> Result<()> {
        match self.to.write_all(line).and_then(|()| self.to.flush()) {
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => self.closed = true,
            outcome => outcome.map_err(|error| Error::io(&self.name, "cannot write a row", &error))?,
        }
        Ok(())
    }
}
