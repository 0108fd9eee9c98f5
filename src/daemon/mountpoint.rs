// SPDX-License-Identifier: MIT

//! Mount points: what is mounted, preparing, covering, and unmounting, also if a daemon has died or hangs.
//!
//! mountinfo lists mounts without a call to any mounted file system. `look` makes calls that may reach one, with a time
//! limit: neither another user's stopped gaugefs nor a network mount without its server can block it.

use std::collections::HashSet;
use std::io::ErrorKind;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use std::{fmt, fs, io};

use nix::errno::Errno;
use nix::mount::{MntFlags, umount2};
use nix::unistd::{AccessFlags, Uid, User, access, geteuid, getppid};

use super::background;
use super::look::{self, Found, Look};
use crate::config::MountOptions;
use crate::error::{Cause, Error, Result, shown};
use crate::folders;
use crate::fs::Covered;
use crate::fuse::needs;
use gauge_bus::clock::{Clock, RealClock};
use gauge_bus::regular;
use gauge_owner::lock;
use gaugefs_client::Gauge;
use gaugefs_client::mounts::{self, Mount, containing, list, topmost};

/// How long an unmount waits for users of the mount, and the interval between attempts.
const PATIENCE: Duration = Duration::from_secs(2);
const STEP: Duration = Duration::from_millis(20);

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Mounted {
    Nothing,
    /// A gaugefs whose daemon answers.
    Alive,
    /// A gaugefs whose daemon is gone.
    Dead,
    /// A gaugefs whose daemon does not answer.
    Hung,
    /// Something else: file system and source.
    Other(String),
}

/// The treatment of a folder with content, which a mount hides.
pub(crate) enum Hiding<'a> {
    Refused,
    /// Warns, for units that are older than the refusal.
    Warned(&'a dyn Fn(&str)),
    Wanted,
}

impl<'a> Hiding<'a> {
    /// By the options; processes started by systemd go on.
    pub(crate) fn by(options: &MountOptions, is_unit: bool, tell: &'a dyn Fn(&str)) -> Self {
        match options.over {
            true => Self::Wanted,
            false if is_unit || background::is_of_a_unit() => Self::Warned(tell),
            false => Self::Refused,
        }
    }

    /// Checks a folder with nothing mounted on it.
    fn check(&self, path: &Path) -> Result<()> {
        if matches!(self, Self::Wanted) || path.ends_with("power_supply") {
            return Ok(());
        }
        let failed = |error: io::Error| {
            forbidden(path, "cannot be examined", Errno::from_raw(error.raw_os_error().unwrap_or_default()))
        };
        let first = match fs::read_dir(path) {
            Ok(mut entries) => entries.next().transpose().map_err(failed)?,
            Err(error) if error.kind() == ErrorKind::NotFound => None,
            Err(error) => return Err(failed(error)),
        };
        let Some(first) = first else { return Ok(()) };
        let what = format!("not empty, it has {}, and a mount hides what is in it", shown(&first.path()));
        let subject = path.display().to_string();
        if let Self::Warned(tell) = self {
            tell(&format!(
                "{subject}: {what}; write `over = true` below [mount], or --over: a later version refuses this"
            ));
            return Ok(());
        }
        let why =
            format!("{what}; choose another folder, or add --over (in a file, `over = true` below [mount])");
        Err(Error::new(subject, Cause::Busy, why))
    }
}

/// Checks that something can be mounted at the path, and returns the full path. Detaches a dead gaugefs there first.
pub(crate) fn prepare(path: &Path, hiding: &Hiding<'_>) -> Result<PathBuf> {
    let (path, mounted) = clear(path)?;
    usable(&path, &mounted)?;
    hiding.check(&path)?;
    Ok(path)
}

/// Checks a mount point without changing it, and returns the full path. It may have a dead gaugefs.
pub(crate) fn check(path: &Path, hiding: &Hiding<'_>) -> Result<PathBuf> {
    let (path, mounted) = examine(path, Look::begin(path)?.end())?;
    usable(&path, &mounted)?;
    if mounted == Mounted::Nothing {
        assure_can_be_made(&path)?;
        hiding.check(&path)?;
    }
    Ok(path)
}

/// Accounts that root trusts with a folder to mount in: root, sudo's caller, and accounts unknown to this user
/// namespace.
struct Trusted {
    sudo: [Option<u32>; 2],
    maps: [String; 2],
}

impl Trusted {
    fn read() -> Self {
        let sudo = ["SUDO_UID", "SUDO_GID"].map(|name| std::env::var(name).ok()?.parse().ok());
        let map = |name: &str| regular::read_text(&Path::new("/proc/self").join(name), regular::SYSTEM);
        Self { sudo, maps: ["uid_map", "gid_map"].map(|name| map(name).unwrap_or_default()) }
    }

    fn has_user(&self, uid: u32) -> bool {
        self.has(0, uid)
    }

    fn has_group(&self, gid: u32) -> bool {
        self.has(1, gid)
    }

    fn has(&self, kind: usize, id: u32) -> bool {
        id == 0 || self.sudo[kind] == Some(id) || !is_mapped(&self.maps[kind], id)
    }
}

/// Whether a user namespace has an account, by its uid_map or gid_map.
fn is_mapped(map: &str, id: u32) -> bool {
    let mut ranges = map.lines().map(|line| line.split_ascii_whitespace().map(str::parse::<u64>));
    map.is_empty()
        || ranges.any(|mut range| match (range.next(), range.nth(1)) {
            (Some(Ok(first)), Some(Ok(count))) => (first..first + count).contains(&u64::from(id)),
            _ => true,
        })
}

/// Checks that only root can remove root's mount. Another user who may remove or rename a folder on the way can do that
/// in a mount namespace of his own, where nothing is mounted, and the kernel then detaches the mount everywhere.
pub fn keeps_its_mount(path: &Path) -> Result<()> {
    if !geteuid().is_root() {
        return Ok(());
    }
    let trusted = Trusted::read();
    for folder in path.ancestors() {
        // Root makes what is missing.
        let Ok(status) = fs::symlink_metadata(folder) else { continue };
        let others =
            status.mode() & 0o002 != 0 || status.mode() & 0o020 != 0 && !trusted.has_group(status.gid());
        // In a sticky folder only an entry's owner can.
        let is_open = folder != path && others && status.mode() & 0o1000 == 0;
        let who = match trusted.has_user(status.uid()) {
            false => format!("belongs to user {}, who", name_of(status.uid())),
            true if is_open => "can be written to by other users, who".into(),
            true => continue,
        };
        let what = if folder == path { String::new() } else { format!("the folder {} ", shown(folder)) };
        let why = format!(
            "{what}{who} could take away what root mounts there; choose a folder that root alone can replace, such as \
             /run/gauges"
        );
        return Err(Error::new(path.display().to_string(), Cause::NotPermitted, why));
    }
    Ok(())
}

/// A user's name, or number.
fn name_of(uid: u32) -> String {
    User::from_uid(Uid::from_raw(uid)).ok().flatten().map_or_else(|| uid.to_string(), |user| user.name)
}

fn usable(path: &Path, mounted: &Mounted) -> Result<()> {
    let subject = path.display().to_string();
    if let Some(around) = path.parent().and_then(mounts::of) {
        let why = format!(
            "inside the gaugefs that is mounted at {}; choose a folder outside of it",
            shown(&around)
        );
        return Err(Error::host(subject, Errno::EINVAL, why));
    }
    match mounted {
        Mounted::Alive => {
            let why = format!("a gaugefs is mounted there; end it with: gaugefs umount {subject}");
            return Err(Error::new(subject, Cause::Busy, why));
        }
        Mounted::Hung => {
            let why = format!(
                "a gaugefs is mounted there whose process does not answer; remove it with: gaugefs umount {subject}"
            );
            return Err(Error::new(subject, Cause::Busy, why));
        }
        Mounted::Other(what) => {
            let why = format!("{what} is mounted there; choose another folder");
            return Err(Error::new(subject, Cause::Busy, why));
        }
        Mounted::Nothing | Mounted::Dead => {}
    }
    keeps_its_mount(path)?;
    if *mounted == Mounted::Dead {
        return Ok(());
    }
    match fs::metadata(path) {
        Ok(status) if !status.is_dir() => Err(Error::host(
            subject,
            Errno::ENOTDIR,
            "not a folder; choose a folder, or a path that does not exist",
        )),
        Err(error) if error.kind() != ErrorKind::NotFound => {
            let errno = Errno::from_raw(error.raw_os_error().unwrap_or_default());
            Err(forbidden(path, "cannot be examined", errno))
        }
        _ => Ok(()),
    }
}

/// Whether this account may mount there: it may write to the folder or, if that is missing, to the nearest one above
/// it.
fn assure_can_be_made(path: &Path) -> Result<()> {
    let Some(there) = path.ancestors().find(|folder| folder.exists()) else { return Ok(()) };
    if there == path && geteuid().is_root() {
        return Ok(());
    }
    if !there.is_dir() {
        return Err(forbidden(path, CANNOT_CREATE, Errno::ENOTDIR));
    }
    if let Some(mount) =
        containing(table()?, there).filter(|mount| there != path && NO_FOLDERS.contains(&&*mount.kind))
    {
        let why = format!("{CANNOT_CREATE}: nobody can in a {}; choose another place", mount.kind);
        return Err(Error::host(path.display().to_string(), Errno::EPERM, why));
    }
    access(there, AccessFlags::W_OK | AccessFlags::X_OK).map_err(|errno| {
        forbidden(path, if there == path { "cannot be mounted on" } else { CANNOT_CREATE }, errno)
    })
}

/// The kernel's own file systems, where no folder can be created, whatever their permissions say.
const NO_FOLDERS: [&str; 13] = [
    "autofs",
    "binfmt_misc",
    "debugfs",
    "devpts",
    "efivarfs",
    "fusectl",
    "mqueue",
    "nsfs",
    "proc",
    "pstore",
    "securityfs",
    "sysfs",
    "tracefs",
];

const CANNOT_CREATE: &str = "cannot create the folder";

/// The error for root's folder, with the remedy for an ordinary user.
fn forbidden(path: &Path, what: &str, errno: Errno) -> Error {
    let error = Error::io(path.display().to_string(), what, &errno.into());
    match errno {
        Errno::EACCES | Errno::EROFS if !geteuid().is_root() => {
            let why = format!(
                "{}; choose a folder of yours, such as ~/gauges, or run it with sudo",
                error.reason()
            );
            Error::host(path.display().to_string(), errno, why)
        }
        _ => error,
    }
}

/// Detaches mounts whose daemon is gone. Returns the full path, and what is mounted there now.
fn clear(path: &Path) -> Result<(PathBuf, Mounted)> {
    // Several may be on top of each other.
    loop {
        let (path, mounted) = examine(path, Look::begin(path)?.end())?;
        if mounted != Mounted::Dead {
            return Ok((path, mounted));
        }
        log::info!("{}: detaching a mount whose daemon is gone", path.display());
        force(&path)?;
    }
}

/// Detaches all mounts whose daemon is gone. Mounts with a hanging daemon stay, and together delay it by the limit of
/// one look.
pub(super) fn clear_all() -> Result<()> {
    let mut places = list();
    places.sort();
    places.dedup();
    let mut outcome = Ok(());
    for (place, _) in look::together(&places, false)?.iter().filter(|(_, found)| found.dead == Some(true)) {
        let cleared = clear(place).map(|_| {
            // `service::attach` has made it.
            if place.parent() == Some(Path::new(folders::RUN)) {
                let _ = fs::remove_dir(place);
            }
        });
        outcome = outcome.and(cleared);
    }
    outcome
}

/// Folders made by this process to mount at, innermost last.
static MADE: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Creates the folder if it is missing.
pub fn make(path: &Path) -> Result<()> {
    let missing: Vec<_> = path.ancestors().take_while(|folder| !folder.exists()).collect();
    MADE.lock().unwrap_or_else(PoisonError::into_inner).extend(missing.iter().rev().map(PathBuf::from));
    fs::create_dir_all(path).map_err(|error| {
        forbidden(path, CANNOT_CREATE, Errno::from_raw(error.raw_os_error().unwrap_or_default()))
    })?;
    // Somebody else may have made one of them meanwhile.
    keeps_its_mount(path).inspect_err(|_| unmake())
}

/// Removes the folders of [`make`], if they are empty and nothing is mounted there again.
pub(super) fn unmake() {
    let mut made = MADE.lock().unwrap_or_else(PoisonError::into_inner);
    while made.pop().is_some_and(|folder| fs::remove_dir(folder).is_ok()) {}
    made.clear();
}

/// Creates a missing folder, and mounts at it.
pub(super) fn make_and_mount<T>(path: &Path, mount: impl Fn() -> Result<T>) -> Result<T> {
    make(path)?;
    let mounted = mount().or_else(|error| match path.exists() {
        true => Err(error),
        // The previous daemon has just removed its folder.
        false => make(path).and_then(|()| mount()),
    });
    mounted.inspect_err(|_| unmake())
}

/// The kernel's power supplies, if a mount at that path would hide them.
pub fn covered(path: &Path) -> Result<Option<Covered>> {
    if !path.ends_with("class/power_supply") {
        return Ok(None);
    }
    let is_theirs = containing(table()?, path).is_some_and(|mount| mount.kind == "sysfs");
    is_theirs.then(|| Covered::open(path)).transpose()
}

/// What remains of a removed mount.
#[derive(Default)]
pub struct Unmounted {
    /// The processes that keep its daemon running, as far as this user may see them.
    pub elsewhere: Option<String>,
    /// Writes and seals still owed, a line per gauge. The daemon tries again at its end, but cannot report the result
    /// then.
    pub owed: Vec<String>,
}

/// Unmounts a gaugefs, by force if its daemon hangs.
pub fn unmount(path: &Path) -> Result<Unmounted> {
    let mut remains = Vec::new();
    let look = Look::begin(path)?;
    // There may be hundreds of processes.
    let foreign = foreign();
    let (path, mounted) = examine(path, look.end())?;
    let subject = path.display().to_string();
    let mount = topmost(table()?, &path).filter(Mount::is_gaugefs);
    let (owner, connection) = mount.map(|mount| (mount.owner, mount.connection)).unwrap_or_default();
    let elsewhere =
        connection.map_or_else(Vec::new, |connection| Elsewhere::all(connection, &foreign, &path));
    if let Some(owner) = owner.filter(|owner| !geteuid().is_root() && *owner != geteuid().as_raw()) {
        let name = name_of(owner);
        let why =
            format!("mounted by user {name}, who may unmount it, as root may: sudo gaugefs umount {subject}");
        return Err(Error::new(subject, Cause::NotPermitted, why));
    }
    match mounted {
        Mounted::Alive => {
            remains = owed(&path);
            retry_busy(|| detach(&path, false)).map_err(|error| {
                if error.errno() != Errno::EBUSY as i32 {
                    return error;
                }
                let users = users(&path);
                let who = if users.is_empty() { String::new() } else { format!(" by {}", users.join(", ")) };
                let here = std::env::current_dir().is_ok_and(|here| here.starts_with(&path));
                let until = if here { "after `cd`, from outside of it" } else { "when it is free" };
                let lazily = if geteuid().is_root() { "umount -l" } else { "fusermount3 -uz" };
                let why = format!("in use{who}; try again {until}, or detach it with: {lazily} {subject}");
                Error::new(&subject, Cause::Busy, why)
            })?;
        }
        Mounted::Dead | Mounted::Hung => force(&path)?,
        Mounted::Nothing => {
            let there: Vec<_> = list().iter().map(|path| shown(path)).collect();
            let why = match there.len() {
                0 => "no gaugefs is mounted there, or anywhere else".to_string(),
                _ => format!("no gaugefs is mounted there; there is one at {}", there.join(", ")),
            };
            return Err(Error::host(subject, Errno::EINVAL, why));
        }
        Mounted::Other(what) => {
            let why = format!("{what} is mounted there, not gaugefs; umount(8) removes it");
            return Err(Error::host(subject, Errno::EINVAL, why));
        }
    }
    let elsewhere = elsewhere.iter().find(|other| other.remains()).map(ToString::to_string);
    Ok(Unmounted { elsewhere, owed: remains })
}

/// Another mount of the same connection: in the table of a process, or of this one.
struct Elsewhere {
    process: Option<i32>,
    connection: u64,
    path: PathBuf,
}

impl Elsewhere {
    /// The other mounts of a connection, as far as this user may see them. `path` is the mount to remove.
    fn all(connection: u64, foreign: &[i32], path: &Path) -> Vec<Self> {
        let tables = [None].into_iter().chain(foreign.iter().copied().map(Some));
        let mounts = tables.flat_map(|process| {
            let mounts = mounts_of(process, connection);
            mounts.into_iter().map(move |path| Self { process, connection, path })
        });
        mounts.filter(|other| other.process.is_some() || other.path != path).collect()
    }

    /// Whether it is still there: the kernel reuses connection numbers.
    fn remains(&self) -> bool {
        mounts_of(self.process, self.connection).contains(&self.path)
    }
}

/// A process of each other mount namespace, as far as this user may see them.
fn foreign() -> Vec<i32> {
    let namespace = |process: &str| fs::read_link(format!("/proc/{process}/ns/mnt")).ok();
    let mut seen = HashSet::from([namespace("self")]);
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
    let processes = processes.filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok());
    processes.filter(|process| seen.insert(namespace(&process.to_string()))).collect()
}

/// A process's mount points of a connection; `None` is this process.
fn mounts_of(process: Option<i32>, connection: u64) -> Vec<PathBuf> {
    let process = process.map_or_else(|| "self".to_string(), |process| process.to_string());
    let table = Path::new("/proc").join(process).join("mountinfo");
    let table = regular::read(&table, regular::SYSTEM).unwrap_or_default();
    let mounts =
        mounts::parse(&table).filter(|mount| mount.connection == Some(connection) && mount.is_gaugefs());
    mounts.map(|mount| mount.path).collect()
}

impl fmt::Display for Elsewhere {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "it is mounted at {}, too", shown(&self.path))?;
        match self.process {
            Some(process) => {
                write!(f, ", in the mount namespace of {}", lock::process(Path::new("/"), process))
            }
            None => Ok(()),
        }
    }
}

/// Lets a mount's daemon settle what it owes, and returns what remains.
fn owed(path: &Path) -> Vec<String> {
    let mut remains = Vec::new();
    for gauge in Gauge::below(path).into_iter().filter(Gauge::is_owed) {
        // Showing it makes the daemon settle it first.
        let _ = gauge.send("gauge/settle", b"show");
        if gauge.is_owed() {
            let why = gauge.last_error().unwrap_or_default();
            remains.push(format!("{}: {}", shown(gauge.folder()), why.trim()));
        }
    }
    remains
}

/// Repeats an attempt for a moment: monitors open files only to read them.
fn retry_busy(mut attempt: impl FnMut() -> Result<()>) -> Result<()> {
    let clock = RealClock::new();
    loop {
        match attempt() {
            Err(error) if error.errno() == Errno::EBUSY as i32 && clock.now() < PATIENCE => clock.sleep(STEP),
            outcome => return outcome,
        }
    }
}

/// Removes the topmost mount; with `lazily`, even if it is in use. Requests under way are still answered.
pub fn detach(path: &Path, lazily: bool) -> Result<()> {
    if geteuid().is_root() {
        return remove(path, if lazily { MntFlags::MNT_DETACH } else { MntFlags::empty() });
    }
    let subject = path.display().to_string();
    let mut command = Command::new(needs::helper().unwrap_or_else(|| "fusermount3".into()));
    command.arg("-u").args(lazily.then_some("-z")).arg("--").arg(path).env("LC_ALL", "C");
    let run = look::run(&mut command).map_err(|error| {
        Error::io(&subject, "cannot run fusermount3 (Debian's package fuse3) to unmount it", &error)
    })?;
    match run {
        Some((true, _)) => Ok(()),
        Some((false, said)) if said.to_lowercase().contains("busy") => Err(failed(path, Errno::EBUSY)),
        Some((false, said)) => {
            let why = format!("not unmounted; as root: gaugefs umount {subject} ({})", said.trim());
            Err(Error::new(subject, Cause::NotPermitted, why))
        }
        None => {
            let why = format!("fusermount3 hangs; as root: gaugefs umount {subject}");
            Err(Error::host(subject, Errno::ETIMEDOUT, why))
        }
    }
}

/// Removes the topmost mount without its daemon: every request fails at once, even those under way. A daemon that
/// continues later still completes its work on the gauges.
fn force(path: &Path) -> Result<()> {
    if geteuid().is_root() {
        return remove(path, MntFlags::MNT_FORCE | MntFlags::MNT_DETACH);
    }
    // Users have no MNT_FORCE, but the same for connections of their own mounts. If that is unavailable the mount is
    // removed, and processes waiting for the daemon keep waiting.
    if let Some(connection) = topmost(table()?, path).and_then(|mount| mount.connection) {
        let _ = fs::write(format!("/sys/fs/fuse/connections/{connection}/abort"), "1");
    }
    detach(path, true)
}

fn remove(path: &Path, flags: MntFlags) -> Result<()> {
    umount2(path, flags | MntFlags::UMOUNT_NOFOLLOW).map_err(|errno| failed(path, errno))
}

fn failed(path: &Path, errno: Errno) -> Error {
    Error::io(path.display().to_string(), "cannot unmount it", &errno.into())
}

/// What is mounted at a path, by a look at it.
fn examine(path: &Path, Found { path: found, dead, late, .. }: Found) -> Result<(PathBuf, Mounted)> {
    let path = match found {
        Some(found) => found,
        None if late => {
            let why =
                "does not answer: it is in a mount whose process or server is stopped; choose another folder";
            return Err(Error::host(path.display().to_string(), Errno::ETIMEDOUT, why));
        }
        // The child has failed, so this reports why.
        None => look::resolve(path)?,
    };
    let mounted = match (topmost(table()?, &path), dead) {
        (None, _) => Mounted::Nothing,
        (Some(mount), _) if !mount.is_gaugefs() => {
            Mounted::Other(format!("{} ({})", mount.kind, mount.source))
        }
        (_, Some(true)) => Mounted::Dead,
        (_, None) if late => Mounted::Hung,
        (_, Some(false) | None) => Mounted::Alive,
    };
    Ok((path, mounted))
}

fn table() -> Result<Vec<Mount>> {
    mounts::all().map_err(|error| Error::io("/proc/self/mountinfo", "cannot read it", &error))
}

/// Processes with open files there, as far as this user may see them, without this one and those that look, which end
/// by themselves.
fn users(path: &Path) -> Vec<String> {
    let inside = |link: PathBuf| fs::read_link(link).is_ok_and(|target| target.starts_with(path));
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
    let using =
        processes.filter(|process| process.file_name().as_bytes()[0].is_ascii_digit()).filter(|process| {
            if process.file_name().to_str() == Some(&std::process::id().to_string()) {
                return false;
            }
            let process = process.path();
            let files = fs::read_dir(process.join("fd")).into_iter().flatten().flatten();
            inside(process.join("cwd")) || files.map(|file| file.path()).any(inside)
        });
    let named = using.filter_map(|process| {
        let name = regular::read_text(&process.path().join("comm"), regular::SYSTEM).unwrap_or_default();
        if name.trim().as_bytes() == look::NAME.to_bytes() {
            return None;
        }
        let number = process.file_name();
        let is_caller = number.to_str() == Some(&getppid().to_string());
        let caller = if is_caller { ", which has started this command" } else { "" };
        Some(format!("process {} ({}{caller})", number.display(), name.trim().escape_debug()))
    });
    named.collect()
}
