// SPDX-License-Identifier: MIT

//! `gaugefs metrics`: mounted gauges for Prometheus, and for NUT.

use std::collections::HashMap;
use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use gauge_bus::clock::{Clock, RealClock};
use gauge_bus::regular::Replace;
use nix::errno::Errno;

use gaugefs_client::Gauge;
use gaugefs_client::follow;
use gaugefs_client::mounts;
use gaugefs_host::error::{Error, Result};
use gaugefs_host::output::{print_file, say, write_file};

mod expected;
mod nut;
mod page;
mod serve;

use page::{Mount, Up};

const METRICS: &str = "\
Prometheus's node_exporter reads the attributes of a power supply. These metrics are the rest:
learning, state of health, wear, seal, writes that wait for a decision, polls, age; and part,
firmware and serial number as labels of gaugefs_chip_info. They have the label power_supply, as
node_exporter's have it, and each comes with its meaning.

gaugefs_mount_up is 0 for a mount whose daemon does not answer, and for one that is gone although it
is expected: by --expect, or else by a file in /etc/gaugefs. Another user's private mount has none.

With --format nut it is one gauge, as NUT's driver dummy-ups reads it from a file: port = FILE in
ups.conf, mode = dummy-loop. ups.status is empty while the gauge does not answer.

With --listen :9947 it answers on all interfaces of the machine, as node_exporter does, and has neither
a password nor TLS; 127.0.0.1:9947 is for this machine alone. The label mountpoint is the mount point,
whether that, a gauge in it or a symbolic link was named.

Everything comes from one file of each gauge, gauge/owner_values or gauge/values, and causes no bus
traffic. A user who may not read the first one gets the seal of some parts only, and no poll interval.

Examples:
  gaugefs metrics
  gaugefs metrics --interval 30 -o /var/lib/prometheus/node-exporter/gauges.prom
  gaugefs metrics --listen 127.0.0.1:9947
  gaugefs metrics --listen unix:/run/gaugefs-metrics.sock
  gaugefs metrics --format nut --interval 2 -o BAT0.seq /run/gauges/BAT0";

/// Most threads that read one mount, for as many clients at once.
const MOST: usize = 8;

/// Print metrics of mounted gauges for Prometheus, or a gauge for NUT
#[derive(Args, Debug)]
#[command(after_help = METRICS)]
pub struct Metrics {
    /// Mount points [default: every mounted gaugefs]; with --format nut, the folder of a gauge
    mountpoints: Vec<PathBuf>,
    /// Also print what node_exporter reads: capacity, voltage, current, temperature, cycles
    #[arg(long)]
    all: bool,
    /// Mount point, or name of a file in /etc/gaugefs, that is reported as down when it is gone [default:
    /// what the files in /etc/gaugefs name]
    #[arg(long, value_name = "PATH|NAME")]
    expect: Vec<PathBuf>,
    /// File to replace as a whole, for node_exporter's textfile collector [default: -, standard
    /// output]
    #[arg(short, long, value_name = "FILE", conflicts_with = "listen")]
    output: Option<PathBuf>,
    /// Write the file again and again, with this time in between
    #[arg(long, value_name = "SECONDS", value_parser = super::seconds, requires = "output")]
    interval: Option<Duration>,
    /// Answer HTTP requests at HOST:PORT, at :PORT of all interfaces, or at unix:PATH
    #[arg(long, value_name = "ADDRESS")]
    listen: Option<serve::Address>,
    /// Text format [default: text with -o, what the client asks for with --listen, else openmetrics]
    #[arg(long, value_enum, conflicts_with = "listen")]
    format: Option<Format>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Format {
    #[value(name = "openmetrics")]
    OpenMetrics,
    // The older one of Prometheus, which node_exporter's textfile collector reads.
    Text,
    Nut,
}

/// The text formats of Prometheus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Prometheus {
    OpenMetrics,
    Text,
}

impl Metrics {
    pub(super) fn run(self) -> Result<ExitCode> {
        let reader = Reader::new(self.mountpoints, &self.expect, self.all);
        if let Some(address) = &self.listen {
            return serve::run(address, &reader);
        }
        let default = if self.output.is_some() { Format::Text } else { Format::OpenMetrics };
        let page = || match self.format.unwrap_or(default) {
            Format::OpenMetrics => Ok((reader.page(Prometheus::OpenMetrics), Ok(()))),
            Format::Text => Ok((reader.page(Prometheus::Text), Ok(()))),
            Format::Nut => reader.of_gauge(),
        };
        loop {
            // A missing gauge is an error that the file shows too.
            let (text, is_there) = page()?;
            match &self.output {
                None => print_file(text.as_bytes())?,
                // The collector may read it at any moment.
                Some(file) => write_file(file, text.as_bytes(), Replace::Kept)?,
            }
            let Some(interval) = self.interval else { return is_there.map(|()| ExitCode::SUCCESS) };
            RealClock::new().sleep(interval);
        }
    }
}

/// Reads mounts.
#[derive(Debug)]
struct Reader {
    /// Mount points; empty for every mounted gaugefs.
    mountpoints: Vec<PathBuf>,
    /// Further mounts that ought to be there; empty for those of the configuration.
    expected: Vec<PathBuf>,
    /// Whether node_exporter's own metrics are included.
    all: bool,
    /// Threads that read each mount. A hanging daemon keeps them.
    threads: Mutex<HashMap<PathBuf, usize>>,
}

impl Reader {
    fn new(mountpoints: Vec<PathBuf>, expect: &[PathBuf], all: bool) -> Arc<Self> {
        let expected = expect.iter().map(|word| expected::named(word)).collect();
        // A gauge's name means its folder.
        let named = |path: PathBuf| Gauge::named(&path).unwrap_or(path);
        let mountpoints = mountpoints.into_iter().map(named).collect();
        Arc::new(Self { mountpoints, expected, all, threads: Mutex::default() })
    }

    /// The mounts of a page: the path to read, and its mount point.
    fn places(&self) -> Vec<(PathBuf, PathBuf)> {
        let (mut all, mut expected) = (self.mountpoints.clone(), self.expected.clone());
        if all.is_empty() {
            all = mounts::list();
            if expected.is_empty() {
                expected = expected::configured();
            }
        }
        let mut places: Vec<_> = all.into_iter().map(|path| (mountpoint(&path), path)).collect();
        let expected: Vec<_> = expected.into_iter().map(|path| (mountpoint(&path), path)).collect();
        for place in expected {
            if !places.iter().any(|(mountpoint, _)| *mountpoint == place.0) {
                places.push(place);
            }
        }
        places
    }

    fn threads(&self) -> MutexGuard<'_, HashMap<PathBuf, usize>> {
        // A panic cannot leave the counts half changed.
        self.threads.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn page(self: &Arc<Self>, format: Prometheus) -> String {
        let begun = Instant::now();
        let mounts = self.read(page::files(self.all));
        page::render(&mounts, begun.elapsed(), format, self.all)
    }

    /// The file of the gauge for NUT, and whether the gauge is there.
    fn of_gauge(self: &Arc<Self>) -> Result<(String, Result<()>)> {
        let mut mounts = self.read(nut::files());
        let mut gauges = mounts.iter_mut().flat_map(|mount| mount.gauges.drain(..));
        let gauge = gauges.next();
        if gauges.next().is_some() {
            let why = "there are several gauges, and NUT has a file for each; give the folder of one";
            return Err(Error::host("", Errno::EINVAL, why));
        }
        let names: Vec<_> = self.places().iter().map(|(_, path)| path.display().to_string()).collect();
        let is_there = gauge.is_some();
        let gone =
            || Error::host(names.join(", "), Errno::ENOENT, "no gauge answers there; ups.status is empty");
        Ok((nut::render(gauge.as_ref()), is_there.then_some(()).ok_or_else(gone)))
    }

    /// Reads these files of all gauges. A mount that is silent for some seconds is reported as down, and is not read
    /// again while too many threads wait for it.
    fn read(self: &Arc<Self>, files: Vec<String>) -> Vec<Mount> {
        let files: Arc<[String]> = files.into();
        let all = self.places();
        let mut mounts: Vec<Mount> = Vec::new();
        let (sender, found) = mpsc::channel();
        for (mountpoint, path) in all {
            let number = mounts.iter().position(|mount| mount.path == mountpoint).unwrap_or(mounts.len());
            if number == mounts.len() {
                mounts.push(Mount { path: mountpoint, up: Up::No, gauges: Vec::new() });
            }
            let own = path.clone();
            let (reader, sender, files) = (self.clone(), sender.clone(), files.clone());
            match self.threads().entry(path.clone()).or_default() {
                &mut MOST => continue,
                count => *count += 1,
            }
            let work = move || {
                // Nobody listens any more to a mount that was silent for too long.
                let report = |seen| sender.send((number, seen)).is_ok();
                let up = match read(&path, &files, |gauge| report(Seen::Gauge(gauge))) {
                    Ok(()) => Up::Yes,
                    // The kernel keeps all others out of a private mount, so its state is unknown.
                    Err(error) if error.kind() == io::ErrorKind::PermissionDenied => Up::Unknown,
                    Err(_) => Up::No,
                };
                report(Seen::End(up));
                reader.threads().entry(path).and_modify(|count| *count -= 1);
            };
            if let Err(error) = std::thread::Builder::new().stack_size(256 * 1024).spawn(work) {
                self.threads().entry(own).and_modify(|count| *count -= 1);
                say(Error::io("", "cannot start a thread", &error));
            }
        }
        drop(sender);
        while let Ok((number, seen)) = found.recv_timeout(follow::PATIENCE) {
            let mount = &mut mounts[number];
            match seen {
                // It may have been named twice, by itself and by its mount.
                Seen::Gauge(gauge) if mount.gauges.iter().any(|known| known.name == gauge.name) => {}
                Seen::Gauge(gauge) => mount.gauges.push(gauge),
                Seen::End(Up::Yes) => mount.up = Up::Yes,
                Seen::End(up) if mount.up == Up::No => mount.up = up,
                Seen::End(_) => {}
            }
        }
        mounts
    }
}

/// The mount point of a path, by which it is known under any name; for a missing one, the path itself.
fn mountpoint(path: &Path) -> PathBuf {
    let own: PathBuf = std::path::absolute(path).unwrap_or_default().components().collect();
    if let Some(mount) = mounts::of(&own) {
        return mount;
    }
    let link = own.clone();
    // A link may lead into a mount whose daemon hangs.
    let target = gaugefs_client::within(follow::PATIENCE, move || std::fs::canonicalize(link));
    let target = target.ok().and_then(Result::ok);
    target.map_or(own, |target| mounts::of(&target).unwrap_or(target))
}

/// A thread's report about a mount.
enum Seen {
    Gauge(page::Gauge),
    /// The end of the gauges.
    End(Up),
}

/// Reads these files of a mount's gauges, and reports each gauge.
fn read(path: &Path, files: &[String], report: impl Fn(page::Gauge) -> bool) -> io::Result<()> {
    // In place of a missing mount there may be something else, even the kernel's supplies.
    if mounts::of(path).is_none() && mounts::of(&std::fs::canonicalize(path)?).is_none() {
        return Err(io::ErrorKind::NotFound.into());
    }
    let report =
        |folder: &Path, texts| report(page::Gauge { name: gaugefs_client::last_name(folder), texts });
    match follow::values(path, files) {
        Ok(texts) => {
            report(path, texts);
            return Ok(());
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        Err(error) => return Err(error),
    }
    let mut folders: Vec<_> = std::fs::read_dir(path)?.flatten().map(|entry| entry.path()).collect();
    folders.sort();
    let mut found = Err(io::ErrorKind::NotFound.into());
    for folder in folders {
        // A gauge that goes away meanwhile is left out, as is what is no gauge.
        let Ok(texts) = follow::values(&folder, files) else { continue };
        found = Ok(());
        if !report(&folder, texts) {
            break;
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mount_that_keeps_its_readers_gets_no_more_of_them() {
        let path = PathBuf::from("/no/such/mount");
        let reader = Reader::new(vec![path.clone()], &[], false);
        let count = || reader.threads().get(&path).copied();
        assert!(
            reader.page(Prometheus::Text).contains("gaugefs_mount_up{mountpoint=\"/no/such/mount\"} 0\n")
        );
        // The page is ready a moment before the thread has ended.
        let start = Instant::now();
        while count() != Some(0) {
            assert!(start.elapsed() < Duration::from_secs(300), "{:?}", count());
            std::thread::yield_now();
        }
        reader.threads().insert(path.clone(), MOST);
        assert!(
            reader.page(Prometheus::Text).contains("gaugefs_mount_up{mountpoint=\"/no/such/mount\"} 0\n")
        );
        assert_eq!(count(), Some(MOST));
    }
}
