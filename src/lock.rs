//! A lock for each gauge, so that a second gaugefs is refused, with the process of the first.
//!
//! The lock is a file in `/run/gaugefs`, or in the user's own runtime folder. It is named after the
//! adapter's number and the address, so that two paths of one adapter are the same gauge. The kernel
//! releases the lock when its holder ends, for whatever reason; the file remains without meaning.
//! Users of different accounts are kept apart by the lock on the bus itself, in `bus::linux`.

use std::ffi::OsStr;
use std::fs::{self, DirBuilder, File};
use std::io::{Read, Seek, Write};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};
use nix::libc;
use nix::unistd::geteuid;

use crate::error::{Cause, Error, Result};
use gauge_bus::clock::Clock;
use gauge_bus::linux::Adapter;

/// Folder for the locks of root's daemons.
const SHARED: &str = "/run/gaugefs";
/// How long a holder that is about to end is waited for, and the time between two attempts.
const PATIENCE: Duration = Duration::from_secs(3);
const STEP: Duration = Duration::from_millis(50);

/// Held while the gauge is in use.
#[derive(Debug)]
pub struct Lock(#[expect(dead_code, reason = "the lock is released when it is dropped")] Flock<File>);

/// The holder of a gauge's lock.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    /// Its process.
    pub pid: i32,
    /// Where it has mounted the gauge, or is going to.
    pub mountpoint: PathBuf,
}

impl Lock {
    /// Locks the gauge at an address of an adapter, to be mounted at `mountpoint`.
    ///
    /// If the lock is held, `ending` decides whether its holder is about to end and is waited for.
    pub fn gauge(
        adapter: &Adapter,
        address: u8,
        mountpoint: &Path,
        clock: &dyn Clock,
        ending: impl Fn(&Holder) -> bool,
    ) -> Result<Self> {
        Self::take(
            &key_of_gauge(adapter, address),
            &format!("{adapter} address 0x{address:02x}"),
            mountpoint,
            clock,
            ending,
        )
    }

    /// Locks the state file of a simulated gauge, given by its absolute path.
    pub fn state(
        state: &Path,
        mountpoint: &Path,
        clock: &dyn Clock,
        ending: impl Fn(&Holder) -> bool,
    ) -> Result<Self> {
        Self::take(&key_of_state(state), &state.display().to_string(), mountpoint, clock, ending)
    }

    fn take(
        key: &str,
        subject: &str,
        mountpoint: &Path,
        clock: &dyn Clock,
        ending: impl Fn(&Holder) -> bool,
    ) -> Result<Self> {
        let start = clock.now();
        loop {
            let holder = match Self::attempt(key, mountpoint)? {
                Ok(lock) => return Ok(lock),
                Err(holder) => holder,
            };
            let wait = holder.as_ref().is_none_or(&ending);
            if !wait || clock.now().saturating_sub(start) > PATIENCE {
                let why = match holder {
                    Some(Holder { pid, mountpoint }) => format!(
                        "in use by another gaugefs, process {pid}, for {0}; end it with: gaugefs umount {0}",
                        mountpoint.display()
                    ),
                    None => "in use by another gaugefs".into(),
                };
                return Err(Error::new(subject, Cause::Busy(why)));
            }
            clock.sleep(STEP);
        }
    }

    /// The lock, or else its holder if that is known.
    fn attempt(key: &str, mountpoint: &Path) -> Result<Result<Self, Option<Holder>>> {
        let name = format!("{key}.lock");
        let folder = folder()?;
        if folder != Path::new(SHARED) {
            // The locks of root's daemons are only checked.
            if let Ok(file) = File::open(Path::new(SHARED).join(&name))
                && let Err((mut file, Errno::EWOULDBLOCK)) = Flock::lock(file, FlockArg::LockSharedNonblock)
            {
                return Ok(Err(holder(&mut file)));
            }
        }
        let path = folder.join(name);
        let failed = |error| Error::io(path.display().to_string(), "cannot lock the gauge", &error);
        let mut options = File::options();
        options
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o644)
            .custom_flags(libc::O_NOFOLLOW);
        let file = options.open(&path).map_err(failed)?;
        match Flock::lock(file, FlockArg::LockExclusiveNonblock) {
            Ok(mut file) => {
                file.set_len(0).map_err(failed)?;
                let mut line = format!("{} ", std::process::id()).into_bytes();
                line.extend_from_slice(mountpoint.as_os_str().as_bytes());
                file.write_all(&line).map_err(failed)?;
                Ok(Ok(Self(file)))
            }
            Err((mut file, Errno::EWOULDBLOCK)) => Ok(Err(holder(&mut file))),
            Err((_, errno)) => Err(failed(errno.into())),
        }
    }
}

/// A name for the gauge at an address of an adapter, unique at any one time.
pub fn key_of_gauge(adapter: &Adapter, address: u8) -> String {
    format!("i2c-{}-{address:02x}", adapter.number())
}

/// The same for an adapter that is missing, if the name of its node has its number.
pub fn key_of_place(node: &Path, address: u8) -> Option<String> {
    let number: u64 = node.file_name()?.to_str()?.strip_prefix("i2c-")?.parse().ok()?;
    Some(format!("i2c-{number}-{address:02x}"))
}

/// The same for the simulated gauge that keeps its flash in a file, given by its absolute path.
pub fn key_of_state(state: &Path) -> String {
    // A file name cannot contain a slash or be as long as a path.
    let hash = state.as_os_str().as_bytes().iter().fold(0xcbf2_9ce4_8422_2325_u64, |hash, &byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    format!("sim-{hash:016x}")
}

/// The process that wrote the lock's file last, which is the holder of a lock that is held.
pub fn holder(file: &mut File) -> Option<Holder> {
    let mut line = Vec::new();
    file.rewind().ok()?;
    file.take(8192).read_to_end(&mut line).ok()?;
    let space = line.iter().position(|&byte| byte == b' ')?;
    let pid = std::str::from_utf8(&line[..space]).ok()?.parse().ok()?;
    Some(Holder { pid, mountpoint: PathBuf::from(OsStr::from_bytes(&line[space + 1..])) })
}

/// The folder for locks, to which no other user can write.
fn folder() -> Result<PathBuf> {
    let me = geteuid();
    let (folder, mode) = match std::env::var_os("XDG_RUNTIME_DIR") {
        _ if me.is_root() => (PathBuf::from(SHARED), 0o755),
        Some(runtime) if Path::new(&runtime).is_absolute() => (Path::new(&runtime).join("gaugefs"), 0o700),
        _ => (PathBuf::from(format!("/tmp/gaugefs-{me}")), 0o700),
    };
    let failed =
        |error| Error::io(folder.display().to_string(), "cannot create the folder for locks", &error);
    DirBuilder::new().recursive(true).mode(mode).create(&folder).map_err(failed)?;
    let status = fs::symlink_metadata(&folder).map_err(failed)?;
    if !status.is_dir() || status.uid() != me.as_raw() || status.mode() & 0o022 != 0 {
        let why = "other users could write to it; remove it".into();
        return Err(Error::new(folder.display().to_string(), Cause::NotPermitted(why)));
    }
    Ok(folder)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gauge_bus::clock::SimClock;

    #[test]
    fn a_second_lock_is_refused_with_the_holder_of_the_first() {
        let state = std::env::temp_dir().join(format!("gaugefs-lock-{}", std::process::id()));
        let clock = SimClock::new();
        let lock = |ending: bool| Lock::state(&state, Path::new("/mnt/with space"), &clock, |_| ending);
        let first = lock(false).expect("not held");
        let refused = lock(false).expect_err("held by the first");
        assert_eq!(refused.errno(), Errno::EBUSY);
        let pid = std::process::id();
        let text = refused.to_string();
        assert!(text.contains(&format!("process {pid}, for /mnt/with space;")), "{text}");
        assert_eq!(clock.now(), Duration::ZERO);
        lock(true).expect_err("held by one that does not end");
        assert!(clock.now() > PATIENCE);
        drop(first);
        lock(false).expect("released");
    }
}
