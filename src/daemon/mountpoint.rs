//! Mount points: what is mounted where, preparing one, what it covers, and unmounting, also after a daemon
//! has died.
//!
//! Only statvfs is called on a mounted file system, and only if mountinfo lists it as a gaugefs: a call to
//! another one, such as a network mount without its server, could hang.

use std::ffi::OsString;
use std::fs;
use std::io::ErrorKind;
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use nix::errno::Errno;
use nix::mount::{MntFlags, umount2};
use nix::sys::statfs::{SYSFS_MAGIC, statfs};
use nix::sys::statvfs::statvfs;
use nix::unistd::geteuid;

use crate::error::{Cause, Error, Result};
use crate::fs::Covered;
use gauge_bus::clock::{Clock, RealClock};

/// The source of every mount of gaugefs, as mountinfo shows it.
pub const SOURCE: &str = "gaugefs";

/// How long an unmount waits for users of the mount, and the time between two attempts.
const PATIENCE: Duration = Duration::from_millis(500);
const STEP: Duration = Duration::from_millis(20);

/// What is mounted at a path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Mounted {
    Nothing,
    /// A gaugefs whose daemon answers.
    Alive,
    /// A gaugefs whose daemon is gone.
    Dead,
    /// Something else: file system and source.
    Other(String),
}

/// Whether a gaugefs is mounted there, dead or alive.
pub fn is_ours(path: &Path) -> bool {
    let Ok(table) = fs::read("/proc/self/mountinfo") else { return false };
    matches!(topmost(&table, path), Some((kind, source)) if ours(&kind, &source))
}

/// Checks that something can be mounted at the path, and returns the full path. A dead gaugefs there is
/// detached first.
pub fn prepare(path: &Path) -> Result<PathBuf> {
    let (path, mounted) = clear(path)?;
    let subject = path.display().to_string();
    match mounted {
        Mounted::Alive => {
            let why = format!("a gaugefs is mounted there; end it with: gaugefs umount {subject}");
            return Err(Error::new(subject, Cause::Busy(why)));
        }
        Mounted::Other(what) => {
            let why = format!("{what} is mounted there; choose another folder");
            return Err(Error::new(subject, Cause::Busy(why)));
        }
        Mounted::Nothing | Mounted::Dead => {}
    }
    match fs::metadata(&path) {
        Ok(status) if !status.is_dir() => Err(Error::host(
            subject,
            Errno::ENOTDIR,
            "not a folder; choose a folder, or a path that does not exist",
        )),
        Err(error) if error.kind() != ErrorKind::NotFound => {
            Err(Error::io(subject, "cannot be examined", &error))
        }
        _ => Ok(path),
    }
}

/// Detaches mounts whose daemon is gone. Returns the full path, and what is mounted there now.
pub(super) fn clear(path: &Path) -> Result<(PathBuf, Mounted)> {
    let path = resolve(path)?;
    // Several of them may be on top of each other.
    loop {
        let mounted = mounted(&path)?;
        if mounted != Mounted::Dead {
            return Ok((path, mounted));
        }
        log::info!("{}: detaching a mount whose daemon is gone", path.display());
        detach(&path, true)?;
    }
}

/// Creates the folder if it is missing.
pub fn make(path: &Path) -> Result<()> {
    fs::create_dir_all(path)
        .map_err(|error| Error::io(path.display().to_string(), "cannot create the folder", &error))
}

/// The kernel's power supplies, if a mount at that path would hide them.
pub fn covered(path: &Path) -> Result<Option<Covered>> {
    let is_theirs = path.ends_with("class/power_supply")
        && statfs(path).is_ok_and(|status| status.filesystem_type() == SYSFS_MAGIC);
    is_theirs.then(|| Covered::open(path)).transpose()
}

/// Unmounts a gaugefs.
pub fn unmount(path: &Path) -> Result<()> {
    let path = resolve(path)?;
    let subject = path.display().to_string();
    match mounted(&path)? {
        Mounted::Alive => retry_busy(|| detach(&path, false)).map_err(|error| {
            if error.errno() != Errno::EBUSY {
                return error;
            }
            let users = users(&path);
            let who = if users.is_empty() { String::new() } else { format!(" by {}", users.join(", ")) };
            let why =
                format!("in use{who}; try again when it is free, or detach it with: umount -l {subject}");
            Error::new(&subject, Cause::Busy(why))
        }),
        Mounted::Dead => detach(&path, true),
        Mounted::Nothing => {
            let there: Vec<_> = list().iter().map(|path| path.display().to_string()).collect();
            let why = match there.len() {
                0 => "no gaugefs is mounted there, or anywhere else".to_string(),
                _ => format!("no gaugefs is mounted there; there is one at {}", there.join(", ")),
            };
            Err(Error::host(subject, Errno::EINVAL, why))
        }
        Mounted::Other(what) => {
            Err(Error::host(subject, Errno::EINVAL, format!("{what} is mounted there, not gaugefs")))
        }
    }
}

/// Repeats an attempt for a moment: monitors open files only while they read them.
fn retry_busy(mut attempt: impl FnMut() -> Result<()>) -> Result<()> {
    let clock = RealClock::new();
    loop {
        match attempt() {
            Err(error) if error.errno() == Errno::EBUSY && clock.now() < PATIENCE => clock.sleep(STEP),
            outcome => return outcome,
        }
    }
}

/// Removes the topmost mount; with `lazily`, even if it is in use.
pub fn detach(path: &Path, lazily: bool) -> Result<()> {
    let subject = path.display().to_string();
    let failed = |errno: Errno| Error::io(&subject, "cannot unmount it", &errno.into());
    if geteuid().is_root() {
        let flags = MntFlags::UMOUNT_NOFOLLOW | if lazily { MntFlags::MNT_DETACH } else { MntFlags::empty() };
        return umount2(path, flags).map_err(failed);
    }
    let mut command = Command::new("fusermount3");
    command.arg("-u").args(lazily.then_some("-z")).arg("--").arg(path);
    let output = command.output().map_err(|error| {
        Error::io(&subject, "cannot run fusermount3 (Debian's package fuse3) to unmount it", &error)
    })?;
    if output.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&output.stderr);
    let said = said.trim();
    if said.to_lowercase().contains("busy") {
        return Err(failed(Errno::EBUSY));
    }
    let why = format!("only root and the user who mounted it may unmount it ({said})");
    Err(Error::new(subject, Cause::NotPermitted(why)))
}

/// The full path, found without access to what is mounted there, which may be dead.
fn resolve(path: &Path) -> Result<PathBuf> {
    let failed = |error| Error::io(path.display().to_string(), "cannot be examined", &error);
    let absolute = std::path::absolute(path).map_err(failed)?;
    let plain = absolute.components().collect::<PathBuf>();
    let (Some(parent), Some(name)) = (plain.parent(), plain.file_name()) else {
        // The root folder, or a path that ends in `..`.
        return fs::canonicalize(&plain).map_err(failed);
    };
    // A missing parent is created later.
    let parent = fs::canonicalize(parent).unwrap_or_else(|_| parent.to_path_buf());
    let path = parent.join(name);
    match fs::read_link(&path) {
        Ok(_) => fs::canonicalize(&path).map_err(failed),
        Err(_) => Ok(path),
    }
}

fn mounted(path: &Path) -> Result<Mounted> {
    let table = fs::read("/proc/self/mountinfo")
        .map_err(|error| Error::io("/proc/self/mountinfo", "cannot read it", &error))?;
    Ok(match topmost(&table, path) {
        None => Mounted::Nothing,
        Some((kind, source)) if !ours(&kind, &source) => Mounted::Other(format!("{kind} ({source})")),
        Some(_) if is_dead(path) => Mounted::Dead,
        Some(_) => Mounted::Alive,
    })
}

/// Whether the daemon of the gaugefs that is mounted there is gone.
pub fn is_dead(path: &Path) -> bool {
    // Only STATFS is never answered from the kernel's cache.
    matches!(statvfs(path), Err(Errno::ENOTCONN | Errno::ECONNABORTED))
}

/// Whether a file system of that type and source is a gaugefs.
pub fn ours(kind: &str, source: &str) -> bool {
    source == SOURCE && (kind == "fuse" || kind.starts_with("fuse."))
}

/// Where gaugefs is mounted.
pub fn list() -> Vec<PathBuf> {
    let table = fs::read("/proc/self/mountinfo").unwrap_or_default();
    let ours = entries(&table).filter(|(_, kind, source)| ours(kind, source));
    ours.map(|(path, ..)| path).collect()
}

/// Type and source of the file system that was mounted last at a path.
fn topmost(table: &[u8], path: &Path) -> Option<(String, String)> {
    let (_, kind, source) = entries(table).filter(|(at, ..)| at == path).last()?;
    Some((kind, source))
}

/// Mount point, file system and source of each line of mountinfo.
pub fn entries(table: &[u8]) -> impl Iterator<Item = (PathBuf, String, String)> {
    table.split(|&byte| byte == b'\n').filter_map(|line| {
        let mut fields = line.split(|&byte| byte == b' ');
        let path = unescape(fields.nth(4)?);
        let mut rest = fields.skip_while(|field| *field != b"-").skip(1);
        let mut text = || Some(unescape(rest.next()?).to_string_lossy().into_owned());
        Some((PathBuf::from(path), text()?, text()?))
    })
}

/// In mountinfo space, tab, newline and backslash are written as three octal digits.
fn unescape(field: &[u8]) -> OsString {
    let mut bytes = Vec::with_capacity(field.len());
    let mut rest = field;
    while let Some((&byte, after)) = rest.split_first() {
        let digits = after.get(..3).and_then(|digits| std::str::from_utf8(digits).ok());
        match digits.and_then(|digits| u8::from_str_radix(digits, 8).ok()) {
            Some(escaped) if byte == b'\\' => {
                bytes.push(escaped);
                rest = &after[3..];
            }
            _ => {
                bytes.push(byte);
                rest = after;
            }
        }
    }
    OsString::from_vec(bytes)
}

/// The processes that have something open there, as far as this user may see them.
fn users(path: &Path) -> Vec<String> {
    let inside = |link: PathBuf| fs::read_link(link).is_ok_and(|target| target.starts_with(path));
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
    let using =
        processes.filter(|process| process.file_name().as_bytes()[0].is_ascii_digit()).filter(|process| {
            let process = process.path();
            let files = fs::read_dir(process.join("fd")).into_iter().flatten().flatten();
            inside(process.join("cwd")) || files.map(|file| file.path()).any(inside)
        });
    let named = using.map(|process| {
        let name = fs::read_to_string(process.path().join("comm")).unwrap_or_default();
        format!("process {} ({})", process.file_name().display(), name.trim())
    });
    named.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TABLE: &[u8] = b"\
22 1 8:1 / / rw,relatime shared:1 - ext4 /dev/sda1 rw\n\
40 22 0:36 / /mnt/a\\040b rw,nosuid shared:3 master:1 - fuse.gaugefs gaugefs rw,user_id=0\n\
41 22 0:37 / /mnt/x rw - tmpfs none rw\n\
42 41 0:38 / /mnt/x rw - fuse gaugefs rw\n\
43 22 0:39 / /mnt/y rw - fuse.sshfs host:/ rw\n";

    #[test]
    fn the_topmost_mount_of_mountinfo_counts() {
        let at = |path: &str| topmost(TABLE, Path::new(path)).map(|(kind, source)| ours(&kind, &source));
        assert_eq!(at("/mnt/a b"), Some(true));
        assert_eq!(at("/mnt/x"), Some(true));
        assert_eq!(at("/mnt/y"), Some(false));
        assert_eq!(at("/mnt/z"), None);
    }

    #[test]
    fn escapes_are_undone() {
        assert_eq!(unescape(b"/a\\040b\\134c\\"), OsString::from("/a b\\c\\"));
        assert_eq!(unescape(b"\\"), OsString::from("\\"));
    }
}
