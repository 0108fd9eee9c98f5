// SPDX-License-Identifier: MIT

//! Files of a gauge, read after each poll.
//!
//! If a daemon hangs, a read blocks. So a separate thread reads, and its receiver learns that the daemon is silent.

use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::fcntl::{OFlag, openat};
use nix::sys::stat::Mode;

use crate::condition::Texts;
use crate::error::{Error, Result};
use crate::gauge::Gauge;
pub use crate::hang::{Calling, PATIENCE, SILENT};
use crate::hang::{look_again, within};
use crate::place;
use crate::sample::{self, if_readable, of_one_poll, text};
use crate::watch::{INTERVAL, trouble};

/// A report of a thread that follows a gauge.
#[derive(Clone, Debug)]
pub struct Seen {
    /// The gauge's number.
    pub gauge: usize,
    /// Its files, without missing ones; or why there are none.
    pub texts: Result<Texts, String>,
}

/// The attributes of a gauge, and other files of its folder.
pub fn all(folder: &Path, names: &[String]) -> io::Result<Texts> {
    let mut texts: Texts = sample::attributes(folder)?.into_iter().collect();
    // The folder of the previous file: files of one folder come one after the other.
    let mut parent: Option<(&str, File)> = None;
    for (path, name) in names.iter().filter_map(|path| Some((path, path.rsplit_once('/')?))) {
        let (inside, name) = name;
        if parent.as_ref().is_none_or(|(open, _)| *open != inside) {
            parent = if_readable(File::open(folder.join(inside)))?.map(|open| (inside, open));
        }
        let Some((_, open)) = &parent else { continue };
        texts.extend(if_readable(text_in(open, name))?.map(|text| (path.clone(), text)));
    }
    Ok(texts)
}

/// What this user may read of a gauge, by one read: there may be a thousand gauges. It has the attributes and the files of
/// `gauge/`, except `gauge/registers` and the answers to requests. A daemon that is older than this program has no such
/// file, so these files are read of it. An error where no gauge is.
pub fn values(folder: &Path, names: &[String]) -> io::Result<Texts> {
    let open = |name: &str| if_readable(File::open(folder.join(name)));
    let found = match open("gauge/owner_values")? {
        None => open("gauge/values")?,
        found => found,
    };
    let Some(mut file) = found else {
        return if place::is_gauge(folder) { all(folder, names) } else { Err(ErrorKind::NotFound.into()) };
    };
    let mut bytes = vec![0; 1 << 16];
    let length = file.read(&mut bytes)?;
    let mut texts = Texts::new();
    for (name, line) in
        String::from_utf8_lossy(&bytes[..length]).lines().filter_map(|line| line.split_once('='))
    {
        // A text of several lines has the name before each.
        let text = texts.entry(name.into()).and_modify(|text: &mut String| text.push('\n')).or_default();
        text.push_str(line);
    }
    Ok(texts)
}

/// The line of a file in an open folder, for three messages to the daemon: there may be a thousand gauges.
fn text_in(folder: &File, name: &str) -> io::Result<String> {
    let file = openat(folder, name, OFlag::O_RDONLY | OFlag::O_CLOEXEC, Mode::empty())?;
    // Longer than any one-line text.
    let mut bytes = [0; 16384];
    let length = File::from(file).read(&mut bytes)?;
    Ok(String::from_utf8_lossy(&bytes[..length]).trim_end().to_string())
}

/// Files of a gauge, poll by poll.
#[derive(Debug)]
pub struct Follow {
    seen: Receiver<Seen>,
    calling: Calling,
}

impl Follow {
    /// Starts to follow attributes and these files, read in this order; those of one folder should be neighbours.
    pub fn start(folder: &Path, names: Vec<String>) -> Result<Self> {
        let (sender, seen) = mpsc::channel::<Seen>();
        let calling = to_channel(0, folder.to_path_buf(), names, sender)?;
        Ok(Self { seen, calling })
    }

    /// Waits for the next poll. An error: the gauge is gone, the mount has ended, or its daemon is silent, said repeatedly.
    /// `None` after the time limit.
    pub fn next(&mut self, limit: Option<Duration>) -> Option<Result<Texts, String>> {
        let end = limit.map(|limit| Instant::now() + limit);
        loop {
            let left = end.map(|end| end.saturating_duration_since(Instant::now()));
            match self.seen.recv_timeout(left.map_or(INTERVAL, |left| left.min(INTERVAL))) {
                Ok(Seen { texts, .. }) => return Some(texts),
                Err(RecvTimeoutError::Timeout) if !self.calling.is_silent() => {
                    if left.is_some_and(|left| left.is_zero()) {
                        return None;
                    }
                }
                // The thread ends only with its receiver.
                Err(_) => return Some(Err(SILENT.into())),
            }
        }
    }
}

/// Follows a gauge from a thread that reports to a channel and ends with its receiver.
pub fn to_channel<T: From<Seen> + Send + 'static>(
    gauge: usize,
    folder: PathBuf,
    names: Vec<String>,
    to: Sender<T>,
) -> Result<Calling> {
    let mount = folder.clone();
    let look = move |_: &Calling| {
        let (texts, next) = match of_one_poll(&folder, |_| all(&folder, &names)) {
            Ok(texts) if texts.get("present").is_some_and(|text| text == "1") => {
                (Ok(texts), next_poll(&folder))
            }
            Ok(_) => (Err("the gauge does not answer".into()), None),
            Err(error) => (Err(trouble(&folder, &error)), None),
        };
        (Seen { gauge, texts }, next.unwrap_or(INTERVAL))
    };
    look_again(&mount, PATIENCE, look, to)
}

impl Gauge {
    /// Follows files of the gauge's folder, poll by poll.
    pub fn follow<Name: Into<String>>(&self, files: impl IntoIterator<Item = Name>) -> Result<Follow> {
        Follow::start(self.folder(), files.into_iter().map(Into::into).collect())
    }
}

/// Time until the next poll is readable; `None` if the user may not read the interval.
fn next_poll(folder: &Path) -> Option<Duration> {
    let number = |name: &str| text(&folder.join(name)).ok()??.parse::<f64>().ok();
    let left = number("gauge/poll_interval")? - number("gauge/age_ms")? / 1000.0;
    Some(Duration::try_from_secs_f64(left).unwrap_or_default() + sample::SETTLED)
}

/// The gauges at a mount point, or at a gauge's folder or name; an error after 5 s without an answer.
pub fn gauges_at(path: &Path) -> Result<Vec<PathBuf>> {
    let name = path.display().to_string();
    let path = &Gauge::named(path)?;
    // Symbolic links are not resolved: that may hang.
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    let found = within(PATIENCE, move || place::gauges_at(&path).map_err(|error| trouble(&path, &error)));
    let found = found.map_err(|error| error.about(&name))?;
    found.map_err(|why| Error::host(name, Errno::ENOENT, why))
}
