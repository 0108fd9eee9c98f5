// SPDX-License-Identifier: MIT

//! Where gauges are mounted, and errors about paths.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::{fmt, fs};

use nix::errno::Errno;
use nix::sys::statvfs::statvfs;
use ti_gauge::text;

use crate::error::Error;
use crate::mounts;

/// A file that every mounted gauge has, but no supply of the kernel's.
pub(crate) const EVERY: &str = "gauge/last_error";

const NO_GAUGE: &str = "not a mounted gauge";

/// The remedy for a mount whose daemon is gone.
pub fn died(mount: impl fmt::Display) -> String {
    format!("its daemon has died; remove the mount with: gaugefs umount {mount}")
}

/// The remedy for the mount of a path whose daemon is gone; the mount may be gone too.
pub(crate) fn dead(path: &Path) -> String {
    died(shown(mounts::of(path).as_deref().unwrap_or(path)))
}

pub(crate) fn shown(path: &Path) -> String {
    text::printable(&path.to_string_lossy())
}

/// The error for a path that is not a mounted gauge's folder: what it is, and which path to give.
pub(crate) fn not_a_gauge(path: &Path) -> Error {
    let name = path.display().to_string();
    let why = match mounts::of(path) {
        // Only STATFS is never answered from the kernel's cache.
        Some(mount) if matches!(statvfs(&mount), Err(Errno::ENOTCONN | Errno::ECONNABORTED)) => {
            return Error::host(name, Errno::ENOTCONN, dead(&mount));
        }
        Some(mount) => {
            let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
            let inside =
                || whole.ancestors().skip(1).filter(|above| above.starts_with(&mount)).map(Path::to_path_buf);
            let what = if whole == mount { "the mount point of" } else { "inside the mount of" };
            let below = || gauges_below(&mount).unwrap_or_default().into_iter().next();
            match inside().find(|path| is_gauge(path)).or_else(below) {
                Some(gauge) => {
                    format!("it is {what} gauges; give the folder of one, such as {}", shown(&gauge))
                }
                None => format!("the mount at {} shows none that may be read", shown(&mount)),
            }
        }
        None if path.is_file() => "it is a file; give the folder of one, such as /run/gauges/BAT0".into(),
        None => {
            const SHOWN: usize = 3;
            let is_there = if path.exists() { "no gaugefs is mounted there" } else { "it does not exist" };
            let places: Vec<String> = mounts::list().iter().map(|place| shown(place)).collect();
            match &*places {
                [] => format!("{is_there}, nor is one mounted anywhere; mount a gauge with: gaugefs mount"),
                [first, ..] => {
                    let some = places.iter().take(SHOWN).map(String::as_str).collect::<Vec<_>>().join(", ");
                    let more = match places.len().saturating_sub(SHOWN) {
                        0 => String::new(),
                        more => format!(" and {more} more places"),
                    };
                    format!(
                        "{is_there}; gauges are mounted at {some}{more}: give the folder of one, such as {first}/BAT0"
                    )
                }
            }
        }
    };
    Error::host(name, Errno::ENOENT, format!("{NO_GAUGE}: {why}"))
}

pub(crate) fn with_path(text: &str, gauge: &Path) -> String {
    let path = shown(gauge);
    let is_plain = path.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"/._+-".contains(&byte));
    let path = if is_plain { path } else { format!("'{}'", path.replace('\'', "'\\''")) };
    text.replace(" GAUGE ", &format!(" {path} "))
}

pub(crate) fn is_gauge(path: &Path) -> bool {
    path.join(EVERY).exists()
}

/// Gauge folders below a mount point, without Mains supplies and without the supplies that the mount hides.
pub(crate) fn gauges_below(mountpoint: &Path) -> io::Result<Vec<PathBuf>> {
    let entries = fs::read_dir(mountpoint)?.flatten().map(|entry| entry.path());
    let mut gauges: Vec<_> = entries.filter(|entry| is_gauge(entry)).collect();
    gauges.sort();
    Ok(gauges)
}

/// The gauge at a path, or the gauges below it; an error without any.
pub fn gauges_at(path: &Path) -> io::Result<Vec<PathBuf>> {
    match fs::metadata(path.join(EVERY)) {
        Ok(_) => return Ok(vec![path.to_path_buf()]),
        Err(error) if error.kind() == ErrorKind::NotFound => {}
        Err(error) => return Err(error),
    }
    let gauges = gauges_below(path)?;
    if gauges.is_empty() { Err(ErrorKind::NotFound.into()) } else { Ok(gauges) }
}

/// The last name in a gauge's path. Symbolic links are not resolved: that may hang.
pub fn last_name(gauge: &Path) -> String {
    gauge.file_name().unwrap_or_default().to_string_lossy().into_owned()
}
