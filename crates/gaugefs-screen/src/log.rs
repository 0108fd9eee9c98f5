// SPDX-License-Identifier: MIT

//! `gaugefs log`: records a gauge's history as CSV, one row per poll.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use clap::Args;
use jiff::{SignedDuration, Timestamp};
use nix::errno::Errno;

use super::learning;
use gauge_bus::regular;
use gaugefs_client::sample::{Moment, Sample};
use gaugefs_client::watch::{INTERVAL, Seen, Watch};
use gaugefs_host::error::{Cause, Error, Result};
use gaugefs_host::output::{self, print_file, say};
use ti_gauge::learning::Cycle;
use ti_gauge::text::printable;

pub(super) mod columns;

use columns::{Column, Facts};

const LOG: &str = "\
Each row is a poll that gaugefs makes anyway; logging causes no bus traffic. An existing file is
continued, with its own columns. While the gauge is absent there is one row with empty fields.
`gaugefs plot` draws the file.

Columns: status, voltage, current, charge, full charge, capacity, temperature, time to empty, time
to full, cycle count, state of health, bits, part, serial number, passed charge and events are
written by default. Others are seal, learning (as `gaugefs learn` prints it) and the registers that
`ls GAUGE/gauge/registers` shows. `events` has what changed since the row before, also in polls
between the two: the status, and bits that were set (+QEN) or cleared (-VOK). A register that is
read with every tenth poll only is marked so in the first line.

The times of a simulated gauge are those of its battery, to which `sim/speed` applies.

Examples:
  gaugefs log /run/gauges/BAT0 -o history.csv
  gaugefs log --columns voltage,true_fcc,events /run/gauges/BAT0 -o cycle.csv
  gaugefs log --interval 60 --count 1440 /run/gauges > day.csv";

/// Listed changes between two rows; more are counted.
const MOST_EVENTS: usize = 50;
/// A row may be this early, because the next poll may be far away.
const EARLY: Duration = Duration::from_millis(250);

/// Record the history of mounted gauges as CSV
#[derive(Args, Debug)]
#[command(after_help = LOG)]
pub struct Log {
    /// Mount point, or folder of a mounted gauge, such as /run/gauges/BAT0
    gauge: PathBuf,
    /// Minimum time between two rows [default: every poll]
    #[arg(long, value_name = "SECONDS", value_parser = super::seconds)]
    interval: Option<Duration>,
    /// Columns to write, by their names [default: see below]
    #[arg(long, value_delimiter = ',', value_name = "NAMES")]
    columns: Vec<String>,
    /// File to write or to continue [default: -, standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Stop after this many rows
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
}

fn name(gauge: &Path) -> String {
    gauge.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// A known gauge and its last row.
struct Known {
    gauge: PathBuf,
    /// The last sample and its time.
    seen: Sample,
    seen_at: Instant,
    /// The time of the last row, and its poll.
    written: Instant,
    moment: Option<Moment>,
    /// Changes since the last row.
    events: Events,
    cycle: Option<Cycle>,
    learning: String,
}

#[derive(Default)]
struct Events {
    texts: Vec<String>,
    more: usize,
}

impl Events {
    fn add(&mut self, text: String) {
        if self.texts.len() < MOST_EVENTS { self.texts.push(text) } else { self.more += 1 }
    }

    /// Adds the differences of the next sample.
    fn compare(&mut self, before: &Sample, now: &Sample) {
        if before.status() != now.status() {
            self.add(format!("{} -> {}", before.status(), now.status()));
        }
        now.changed_bits(before).for_each(|(_, bits)| self.add(bits));
    }

    /// Takes the notes and empties the list.
    fn take(&mut self) -> String {
        let Self { mut texts, more } = std::mem::take(self);
        if more > 0 {
            texts.push(format!("{more} more"));
        }
        texts.join("; ")
    }
}

impl Known {
    fn new(gauge: PathBuf, sample: &Sample) -> Self {
        Self {
            gauge,
            seen: sample.clone(),
            seen_at: Instant::now(),
            written: Instant::now(),
            moment: None,
            events: Events::default(),
            cycle: None,
            learning: String::new(),
        }
    }

    /// Takes the next sample.
    fn take(&mut self, mut sample: Sample) {
        self.events.compare(&self.seen, &sample);
        let polled = sample.moment.zip(self.seen.moment);
        // `new` has seen the first sample already, but the cycle has not.
        let is_new = self.cycle.is_none() || !polled.is_some_and(|(now, before)| now.is_same_poll(before));
        sample.time = sample.battery_time();
        if self.cycle.is_none() {
            self.cycle = learning::cycle(&sample);
        }
        if let (true, Some(cycle), Some(reading)) = (is_new, &mut self.cycle, learning::reading(&sample)) {
            self.learning = learning::line(&cycle.update(&reading));
        }
        (self.seen, self.seen_at) = (sample, Instant::now());
    }

    /// Notes that the mount has ended. A simulated gauge's time keeps its distance to the host's.
    fn lose(&mut self) {
        let mut absent = Sample::absent();
        if self.seen.simulated.is_some() {
            let passed = SignedDuration::try_from(self.seen_at.elapsed()).unwrap_or_default();
            absent.time = self.seen.time.saturating_add(passed).unwrap_or(absent.time);
        }
        self.take(absent);
    }
}

impl Log {
    pub(super) fn run(self) -> Result<ExitCode> {
        let mut out = Out::open(self.output.as_ref(), &self.columns)?;
        let watch = Watch::start(Some(&self.gauge), None)?;
        let mut known: Vec<Known> = Vec::new();
        let mut left = self.count.unwrap_or(u64::MAX);
        let mut reported = String::new();
        loop {
            if out.file.is_none() && output::is_unread() {
                break;
            }
            let Some(report) = watch.next(INTERVAL) else { continue };
            match report.seen {
                Seen::Sample(sample) => {
                    reported.clear();
                    left -= u64::from(self.sample(&mut out, &mut known, report.gauge, *sample)?);
                }
                // A gauge that has gone may come back; one that was never there is an error.
                Seen::Trouble(why) if known.is_empty() => {
                    return Err(Error::host(self.gauge.display().to_string(), Errno::ENOENT, why));
                }
                Seen::Trouble(why) => {
                    if reported != why {
                        say(format_args!("{}: {why}; waiting", report.gauge.display()));
                        reported = why;
                    }
                    for gone in known.iter_mut().filter(|known| known.moment.is_some()) {
                        gone.lose();
                        gone.moment = None;
                        out.write(gone)?;
                    }
                }
                Seen::Learned(_) | Seen::Limits(_) | Seen::Refused(_) => {}
            }
            if left == 0 {
                break;
            }
        }
        Ok(ExitCode::SUCCESS)
    }

    /// Writes a row for a new sample; returns whether it did.
    fn sample(&self, out: &mut Out, known: &mut Vec<Known>, gauge: PathBuf, sample: Sample) -> Result<bool> {
        let found = known.iter().position(|known| known.gauge == gauge);
        let at = found.unwrap_or_else(|| {
            known.push(Known::new(gauge, &sample));
            known.len() - 1
        });
        let known = &mut known[at];
        let moment = sample.moment;
        known.take(sample);
        let writes = if found.is_none() {
            // A continued file may contain this poll.
            !out.has(&known.gauge, &known.seen)
        } else {
            let is_new = match (known.moment, moment) {
                (Some(before), Some(now)) => !before.is_same_poll(now),
                (before, now) => before.is_some() != now.is_some(),
            };
            let due = self.interval.is_none_or(|least| known.written.elapsed() + EARLY >= least);
            // An absence is recorded regardless of the interval.
            is_new && (due || moment.is_none() || known.moment.is_none())
        };
        if writes {
            out.write(known)?;
        }
        if writes || found.is_none() {
            (known.moment, known.written) = (moment, Instant::now());
        }
        Ok(writes)
    }
}

/// The first line of a file and its last ones: it may be the history of a year.
fn ends(mut file: &File) -> io::Result<Vec<u8>> {
    const PIECE: u64 = 256 << 10;
    let mut text = regular::read_from(file.take(PIECE), PIECE)?;
    let length = file.metadata()?.len();
    if length <= PIECE {
        return Ok(text);
    }
    let end = |text: &[u8]| text.iter().position(|&byte| byte == b'\n').map_or(text.len(), |end| end + 1);
    text.truncate(end(&text));
    file.seek(SeekFrom::Start(length - PIECE))?;
    let tail = regular::read_from(file.take(PIECE), PIECE)?;
    text.extend_from_slice(&tail[end(&tail)..]);
    Ok(text)
}

struct Out {
    name: String,
    /// `None` for standard output.
    file: Option<File>,
    columns: Vec<Column>,
    /// The header is written before the first row.
    needs_header: bool,
    /// Gauge and time of a continued file's last rows.
    before: Vec<(String, Timestamp)>,
}

impl Out {
    /// Opens the output. An existing file is continued if its columns are the wanted ones.
    fn open(path: Option<&PathBuf>, wanted: &[String]) -> Result<Self> {
        let mut columns = if wanted.is_empty() { columns::usual() } else { Column::choose(wanted)? };
        let Some(path) = path.filter(|path| !output::is_standard_output(path)) else {
            let name = "standard output".to_string();
            return Ok(Self { name, file: None, columns, before: Vec::new(), needs_header: true });
        };
        let name = path.display().to_string();
        let file = regular::append(path);
        let file = file.map_err(|error| Error::io(&name, "cannot write it", &error))?;
        let wrong = |why: String| {
            let why = format!("{why}; choose another file, or move this one away");
            Err(Error::new(&name, Cause::Invalid, why))
        };
        let empty = file.metadata().is_ok_and(|status| status.len() == 0);
        let (mut truncated, mut before) = (false, Vec::new());
        if !empty {
            let text = ends(&file).map_err(|error| Error::io(&name, "cannot read it", &error))?;
            let mut reader = csv::Reader::from_reader(text.as_slice());
            let Some(found) = reader.headers().ok().and_then(|titles| Column::of_file(titles.iter())) else {
                return wrong("its columns are not those that gaugefs log writes".into());
            };
            let names = |columns: &[Column]| -> Vec<_> {
                columns.iter().map(|column| column.name().to_string()).collect()
            };
            if !wanted.is_empty() && names(&found) != names(&columns) {
                return wrong(format!("its columns are others: {}", names(&found).join(", ")));
            }
            columns = found;
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
        let mut out = Self { name, file: Some(file), columns, before, needs_header: empty };
        // A full disk or a power cut has truncated the last row.
        if truncated {
            out.line("\r\n".as_bytes())?;
        }
        Ok(out)
    }

    /// Whether a continued file contains this poll.
    fn has(&self, gauge: &Path, sample: &Sample) -> bool {
        // A poll's time is inexact, more so with a faster clock.
        let speed = sample.simulated.map_or(1.0, |(_, speed)| speed.max(1.0));
        let near = |other: Timestamp| sample.time.duration_since(other).abs().as_secs_f64() < 0.25 * speed;
        self.before.iter().any(|(found, at)| *found == name(gauge) && near(*at))
    }

    fn write(&mut self, known: &mut Known) -> Result<()> {
        if std::mem::take(&mut self.needs_header) {
            let titles = self.columns.iter().map(|column| column.title.clone());
            let titles: Vec<_> = columns::FIRST.into_iter().map(str::to_string).chain(titles).collect();
            self.record(&titles)?;
        }
        let events = known.events.take();
        let facts = Facts { sample: &known.seen, events: &events, learning: &known.learning };
        let first = [format!("{:.3}", known.seen.time), name(&known.gauge)];
        let row: Vec<_> =
            first.into_iter().chain(self.columns.iter().map(|column| column.text(&facts))).collect();
        self.record(&row)
    }

    fn record<T: AsRef<str>>(&mut self, fields: &[T]) -> Result<()> {
        let failed = |error: io::Error| Error::io(&self.name, "cannot write it", &error);
        let mut line = csv::WriterBuilder::new().terminator(csv::Terminator::CRLF).from_writer(Vec::new());
        let fields = fields.iter().map(|field| printable(field.as_ref()));
        line.write_record(fields).map_err(|error| failed(error.into()))?;
        let line = line.into_inner().map_err(|error| failed(error.into_error()))?;
        self.line(&line)
    }

    /// Writes a whole row at once, so that a reader never sees half a row.
    fn line(&mut self, line: &[u8]) -> Result<()> {
        match &mut self.file {
            None => print_file(line),
            Some(file) => {
                file.write_all(line).map_err(|error| Error::io(&self.name, "cannot write a row", &error))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hostile values from a gauge, a folder or another mount's user.
    const HOSTILE: [&str; 8] = [
        "a,b",
        "say \"no\"",
        "two\nlines",
        "two\r\nlines",
        "\u{1b}[2J\u{7}",
        "\u{9b}2J\u{202e}",
        "\0",
        "\",\"\n,",
    ];

    #[test]
    fn a_field_is_one_field_of_one_line_whatever_is_in_it() {
        let path = std::env::temp_dir().join(format!("gaugefs-fields-{}.csv", std::process::id()));
        let _ = std::fs::remove_file(&path);
        let mut out = Out::open(Some(&path), &[]).expect("a file");
        out.record(&HOSTILE).expect("written");
        out.record(&["the next one"; HOSTILE.len()]).expect("written");
        drop(out);
        let text = std::fs::read_to_string(&path).expect("text");
        std::fs::remove_file(&path).expect("it is there");
        let lines: Vec<_> = text.split("\r\n").collect();
        assert!(lines.len() == 3 && lines[2].is_empty(), "{text:?}");
        assert_eq!(text.replace("\r\n", "").chars().find(|&letter| !ti_gauge::text::is_plain(letter)), None);
        let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(text.as_bytes());
        let rows: Vec<_> = reader.records().map(|row| row.expect("a row")).collect();
        assert_eq!(rows[0].iter().collect::<Vec<_>>(), HOSTILE.map(printable));
        assert!(rows[1].iter().all(|field| field == "the next one"));
    }
}
