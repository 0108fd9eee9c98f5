//! `gaugefs log`: records a gauge's history as CSV, one row per poll.

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
Each row is a poll that gaugefs makes anyway; logging causes no bus traffic. An existing file is
continued. While the gauge is absent there is one row with empty fields. `gaugefs plot` draws the
file.

Examples:
  gaugefs log /run/gauges/BAT0 -o history.csv
  gaugefs log --interval 60 --count 1440 /run/gauges > day.csv";

/// A row may be this early, because the next poll may be a long time away.
const EARLY: Duration = Duration::from_millis(250);

/// Record the history of mounted gauges as CSV
#[derive(Args, Debug)]
#[command(after_help = LOG)]
pub(crate) struct Log {
    /// Mount point, or folder of a mounted gauge, such as /run/gauges/BAT0
    gauge: PathBuf,
    /// Minimum time between two rows [default: every poll]
    #[arg(long, value_name = "SECONDS", value_parser = super::seconds)]
    interval: Option<Duration>,
    /// File to write or to continue [default: standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Stop after this many rows
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
}

/// A column: its name and unit, and its text for a gauge that is present.
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

/// The first line: the time of the poll in UTC, the gauge, and [`COLUMNS`].
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

/// The last row of a gauge.
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
        let mut reported = String::new();
        for report in &watch.reports {
            match report.seen {
                Seen::Sample(sample) => {
                    reported.clear();
                    left -= u64::from(self.sample(&mut out, &mut known, report.gauge, &sample)?);
                }
                // A gauge that has gone may come back; one that was never there is an error.
                Seen::Trouble(why) if known.is_empty() => {
                    return Err(Error::host(self.gauge.display().to_string(), Errno::ENOENT, why));
                }
                Seen::Trouble(why) => {
                    if reported != why {
                        eprintln!("gaugefs: {}: {why}; waiting", report.gauge.display());
                        reported = why;
                    }
                    for gone in known.iter_mut().filter(|last| last.moment.is_some()) {
                        gone.moment = None;
                        out.write(&row(&name(&gone.gauge), &Sample::absent()))?;
                    }
                }
                Seen::Learned(_) | Seen::Limits(_) | Seen::Refused(_) => {}
            }
            if left == 0 || out.closed {
                break;
            }
        }
        Ok(ExitCode::SUCCESS)
    }

    /// Writes a row if the sample is new; returns whether it did.
    fn sample(&self, out: &mut Out, known: &mut Vec<Last>, gauge: PathBuf, sample: &Sample) -> Result<bool> {
        let found = known.iter().position(|last| last.gauge == gauge);
        let writes = match found.map(|at| &known[at]) {
            // A continued file may have this poll already.
            None => !out.has(&gauge, sample.time),
            Some(last) => {
                let is_new = match (last.moment, sample.moment) {
                    (Some(before), Some(now)) => !before.is_same_poll(now),
                    (before, now) => before.is_some() != now.is_some(),
                };
                let due = self.interval.is_none_or(|least| last.written.elapsed() + EARLY >= least);
                // An absence is recorded regardless of the interval.
                is_new && (due || sample.moment.is_none() || last.moment.is_none())
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

/// The output.
struct Out {
    name: String,
    to: Box<dyn Write>,
    /// The reader has closed the pipe.
    closed: bool,
    /// The header is written before the first row.
    needs_header: bool,
    /// Gauge and time of the last rows of a continued file.
    before: Vec<(String, Timestamp)>,
}

impl Out {
    /// Opens the output. An existing file must have the same header.
    fn open(path: Option<&PathBuf>) -> Result<Self> {
        let Some(path) = path else {
            let name = "standard output".to_string();
            let to = Box::new(io::stdout());
            return Ok(Self { name, to, closed: false, before: Vec::new(), needs_header: true });
        };
        let name = path.display().to_string();
        let file = File::options().read(true).append(true).create(true).open(path);
        let file = file.map_err(|error| Error::io(&name, "cannot write it", &error))?;
        let wrong = |why: &str| {
            let why = format!("{why}; choose another file, or move this one away");
            Err(Error::new(&name, Cause::Invalid(why)))
        };
        let empty = file.metadata().is_ok_and(|status| status.len() == 0);
        let (mut truncated, mut before) = (false, Vec::new());
        if !empty {
            let text = std::fs::read(path).map_err(|error| Error::io(&name, "cannot read it", &error))?;
            let mut reader = csv::Reader::from_reader(text.as_slice());
            match reader.headers() {
                Ok(found) if found.iter().eq(header()) => {}
                _ => return wrong("its columns are not those that gaugefs log writes"),
            }
            before.extend(
                reader
                    .into_records()
                    .flatten()
                    .filter_map(|row| Some((row.get(1)?.to_string(), row.get(0)?.parse().ok()?))),
            );
            // Only the last rows can be of the present poll.
            before.drain(..before.len().saturating_sub(100));
            truncated = text.last() != Some(&b'\n');
        }
        let mut out = Self { name, to: Box::new(file), closed: false, before, needs_header: empty };
        // A full disk or a power cut has truncated the last row.
        if truncated {
            out.line("\r\n".as_bytes())?;
        }
        Ok(out)
    }

    /// Whether a continued file has this poll already.
    fn has(&self, gauge: &Path, time: Timestamp) -> bool {
        let same = |other: Timestamp| time.duration_since(other).abs() < SignedDuration::from_millis(250);
        self.before.iter().any(|(found, at)| *found == name(gauge) && same(*at))
    }

    fn write<T: AsRef<[u8]>>(&mut self, fields: &[T]) -> Result<()> {
        if std::mem::take(&mut self.needs_header) {
            self.write(&header())?;
        }
        let failed = |error: io::Error| Error::io(&self.name, "cannot write it", &error);
        let mut line = csv::WriterBuilder::new().terminator(csv::Terminator::CRLF).from_writer(Vec::new());
        line.write_record(fields).map_err(|error| failed(error.into()))?;
        let line = line.into_inner().map_err(|error| failed(error.into_error()))?;
        self.line(&line)
    }

    /// Writes a whole row at once, so that a reader of the file never sees half a row.
    fn line(&mut self, line: &[u8]) -> Result<()> {
        match self.to.write_all(line).and_then(|()| self.to.flush()) {
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => self.closed = true,
            outcome => outcome.map_err(|error| Error::io(&self.name, "cannot write a row", &error))?,
        }
        Ok(())
    }
}
