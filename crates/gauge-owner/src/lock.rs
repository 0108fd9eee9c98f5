// SPDX-License-Identifier: MIT

//! A lock for each gauge, so that a second gaugefs is refused, with the process of the first.
//!
//! The lock is a file that only its owner can open, in `/run/gaugefs` or in a folder of the user's own. It is named after
//! the adapter's number and the address; behind a mux after the path of channels (`related`), because a gauge in front of
//! a mux is reached through every channel. The kernel releases it when its holder ends; a file left behind has no effect.
//!
//! Other accounts are kept out by the lock on the bus, in `bus::linux`; locks of root and of services are looked up first.
//!
//! The holder of a lock is the process in the kernel's list, `/proc/locks`, whatever the file says.

use std::ffi::OsStr;
use std::fmt;
use std::fs::{self, DirBuilder, File, Metadata};
use std::io::{self, Seek, Write};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};
use nix::sys::stat::{major, minor};
use nix::unistd::{Uid, User, geteuid};

use crate::error::{Cause, Error, Reason, Result, shown};
use crate::folders;
use gauge_bus::clock::Clock;
use gauge_bus::linux::Adapter;
use gauge_bus::regular;

mod related;

use related::Name;

/// Looks at the kernel's list before a lock counts as free: it comes in pieces, and may leave out a neighbour.
const LOOKS: u32 = 3;
/// Time to wait for a holder that may end; for one that is ending, which may pay its debts first; between attempts.
const PATIENCE: Duration = Duration::from_secs(3);
const ENDS: Duration = Duration::from_secs(60);
const STEP: Duration = Duration::from_millis(50);

/// The files of the locks that this process holds, for [`remove_all`].
static HELD: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Held while the gauge is in use.
#[derive(Debug)]
pub struct Lock {
    path: PathBuf,
    #[expect(dead_code, reason = "the lock is released when it is dropped")]
    file: Flock<File>,
}

/// The process that holds a gauge's lock.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    /// Its number.
    pub pid: i32,
    /// The place where it has mounted the gauge, or will mount it, if it is a gaugefs that this user may ask.
    pub mountpoint: Option<PathBuf>,
    /// The bus on which it has it, if that is another one in front of a mux or behind it.
    pub bus: Option<String>,
}

impl Lock {
    /// Locks the gauge at an address. `ending` says by its mount point whether a holder is ending, to be waited for.
    pub fn gauge(
        adapter: &Adapter,
        address: u8,
        mountpoint: &Path,
        clock: &dyn Clock,
        ending: impl Fn(&Path) -> bool,
    ) -> Result<Self> {
        Self::take(
            &Name::of(&adapter.channels(), address).to_string(),
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
        ending: impl Fn(&Path) -> bool,
    ) -> Result<Self> {
        Self::take(&key_of_state(state), &state.display().to_string(), mountpoint, clock, ending)
    }

    fn take(
        key: &str,
        subject: &str,
        mountpoint: &Path,
        clock: &dyn Clock,
        ending: impl Fn(&Path) -> bool,
    ) -> Result<Self> {
        let (start, mut known) = (clock.now(), None);
        loop {
            // The kernel's list may leave it out for a moment.
            let holder = match Self::attempt(key, mountpoint)? {
                Ok(lock) => return Ok(lock),
                Err(holder) => holder.or(known.take()),
            };
            known.clone_from(&holder);
            let mountpoint = holder.as_ref().and_then(|holder| holder.mountpoint.as_deref());
            // Two gauges of one configuration, which do not end for each other.
            let is_own = |holder: &Holder| holder.bus.is_some() && holder.pid == std::process::id() as i32;
            let patience = match mountpoint {
                _ if holder.as_ref().is_some_and(is_own) => Duration::ZERO,
                None => PATIENCE,
                Some(mountpoint) if ending(mountpoint) => ENDS,
                Some(_) => Duration::ZERO,
            };
            if clock.now().saturating_sub(start) >= patience {
                let what = match &holder {
                    Some(Holder { pid, mountpoint: Some(place), .. }) if patience == ENDS => {
                        let (holder, place) = (process(Path::new("/"), *pid), shown(place));
                        format!(
                            "in use by {holder}, which is not mounted at {place} any more and does not end: something there \
                             may still be open; end it with: kill {pid}"
                        )
                    }
                    Some(holder @ Holder { bus: Some(bus), .. }) => {
                        format!("in use on {bus}, on the other side of a mux, by {holder}")
                    }
                    Some(holder) => format!("in use by {holder}"),
                    None => "in use by another process, which /proc/locks does not show".into(),
                };
                let process = holder.as_ref().map(|holder| holder.pid.into());
                let mountpoint = mountpoint.map(shown);
                return Err(Error::of(subject, Reason::InUse { process, mountpoint, what }));
            }
            clock.sleep(STEP);
        }
    }

    /// The lock, or its holder if known, also in front of a mux or behind. Of two at a time, at least one sees the other.
    fn attempt(key: &str, mountpoint: &Path) -> Result<Result<Self, Option<Holder>>> {
        let taken = Self::attempt_alone(key, mountpoint)?;
        let Some(name) = Name::parse(key).filter(|_| taken.is_ok()) else { return Ok(taken) };
        let own = folder()?;
        let folders = folders::SYSTEM_LOCKS.map(PathBuf::from).into_iter().filter(|other| *other != own);
        let folders: Vec<_> = folders.chain([own.clone()]).collect();
        Ok(match name.holder_of_related(&folders) {
            Some(holder) => Err(Some(holder)),
            None => taken,
        })
    }

    fn attempt_alone(key: &str, mountpoint: &Path) -> Result<Result<Self, Option<Holder>>> {
        let name = format!("{key}.lock");
        let folder = folder()?;
        // A lock of another account is not for this one to take, but the kernel lists it.
        for other in folders::SYSTEM_LOCKS.map(Path::new).iter().filter(|other| ***other != folder) {
            if let Some(holder) = seen(&other.join(&name)) {
                return Ok(Err(Some(holder)));
            }
        }
        let path = folder.join(name);
        let failed = |error| Error::io(path.display().to_string(), "cannot lock the gauge", &error);
        let mut options = File::options();
        options.read(true).write(true).create(true).truncate(false).mode(0o600);
        loop {
            let file = match regular::open(&options, &path) {
                // The last holder of another lock has just removed the folder.
                Err(error) if error.kind() == io::ErrorKind::NotFound => {
                    self::folder()?;
                    continue;
                }
                file => file.map_err(failed)?,
            };
            let status = file.metadata().map_err(failed)?;
            let same = |there: Metadata| (there.dev(), there.ino()) == (status.dev(), status.ino());
            let is_there = || fs::symlink_metadata(&path).is_ok_and(same);
            if status.mode() & 0o077 != 0 && is_there() {
                // Somebody else may have it open, and lock it at will.
                remove(&path).map_err(failed)?;
                continue;
            }
            let mut file = match Flock::lock(file, FlockArg::LockExclusiveNonblock) {
                Ok(file) => file,
                Err((mut file, Errno::EWOULDBLOCK)) => return Ok(Err(holder(&mut file))),
                Err((_, errno)) => return Err(failed(errno.into())),
            };
            // Its last holder may have removed it since it was opened; then the lock excludes nobody.
            if !is_there() {
                continue;
            }
            file.set_len(0).map_err(failed)?;
            let mut line = format!("{} ", std::process::id()).into_bytes();
            line.extend_from_slice(mountpoint.as_os_str().as_bytes());
            file.write_all(&line).map_err(failed)?;
            held().push(path.clone());
            return Ok(Ok(Self { path, file }));
        }
    }
}

impl Drop for Lock {
    /// Removes the file before the lock is released, so that it is never another's.
    fn drop(&mut self) {
        let mut held = held();
        if let Some(at) = held.iter().position(|path| *path == self.path) {
            held.swap_remove(at);
            let _ = remove(&self.path);
            leave(&self.path);
        }
    }
}

/// Removes the files of all locks of this process, right before it exits; the locks are released then.
pub fn remove_all() {
    for path in held().drain(..) {
        let _ = remove(&path);
        leave(&path);
    }
}

/// Removes the folder of a lock that was removed, if it is only for locks and this was the last one.
fn leave(path: &Path) {
    if let Some(folder) =
        path.parent().filter(|folder| folders::state().is_none_or(|state| state != **folder))
    {
        // Another process may have a lock there.
        let _ = fs::remove_dir(folder);
    }
}

fn held() -> std::sync::MutexGuard<'static, Vec<PathBuf>> {
    HELD.lock().unwrap_or_else(PoisonError::into_inner)
}

fn remove(path: &Path) -> io::Result<()> {
    fs::remove_file(path).or_else(|error| match error.kind() {
        io::ErrorKind::NotFound => Ok(()),
        _ => Err(error),
    })
}

impl fmt::Display for Holder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&process(Path::new("/"), self.pid))?;
        match &self.mountpoint {
            Some(place) => write!(f, " for {0}; end it with: gaugefs umount {0}", shown(place)),
            None => {
                write!(f, "; if it has mounted the gauge, unmount that, otherwise end it: kill {}", self.pid)
            }
        }
    }
}

/// A process of the system below `root`, with its program and its user: `process 12 (gaugefs of root)`.
pub fn process(root: &Path, pid: i32) -> String {
    let folder = root.join(format!("proc/{pid}"));
    let program = regular::read_text(&folder.join("comm"), regular::SYSTEM).ok();
    let user = fs::metadata(&folder).ok().map(|status| status.uid());
    let (Some(program), Some(uid)) = (program, user) else { return format!("process {pid}") };
    let user =
        User::from_uid(Uid::from_raw(uid)).ok().flatten().map_or(format!("user {uid}"), |user| user.name);
    // Every process chooses its own name.
    format!("process {pid} ({} of {user})", program.trim_end_matches('\n').escape_debug())
}

/// A name for the gauge's records, unique at any one time, and the same before the adapter is there.
pub fn key_of_gauge(adapter: &Adapter, address: u8) -> String {
    format!("i2c-{}-{address:02x}", adapter.number())
}

/// A name for a gauge whose adapter is missing, if the name of its node has its number.
pub fn key_of_place(node: &Path, address: u8) -> Option<String> {
    let number: u64 = node.file_name()?.to_str()?.strip_prefix("i2c-")?.parse().ok()?;
    Some(format!("i2c-{number}-{address:02x}"))
}

/// A name for the simulated gauge that keeps its flash in a file, given by its absolute path.
pub fn key_of_state(state: &Path) -> String {
    // A file name cannot contain a slash or be as long as a path.
    let hash = state.as_os_str().as_bytes().iter().fold(0xcbf2_9ce4_8422_2325_u64, |hash, &byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    format!("sim-{hash:016x}")
}

/// The holder of a lock that is not taken here, if it is held.
fn seen(path: &Path) -> Option<Holder> {
    let pid = holding_now(&fs::metadata(path).ok()?)?;
    let file = regular::open(File::options().read(true), path);
    let mountpoint = file.ok().and_then(|mut file| mountpoint_of(&mut file, pid));
    Some(Holder { pid, mountpoint, bus: None })
}

/// The holder of a lock that is held, if the kernel shows it.
fn holder(file: &mut File) -> Option<Holder> {
    let pid = holding_now(&file.metadata().ok()?)?;
    Some(Holder { pid, mountpoint: mountpoint_of(file, pid), bus: None })
}

/// The kernel's list leaves out a lock now and then, while another one goes.
fn holding_now(file: &Metadata) -> Option<i32> {
    (0..LOOKS).find_map(|_| holding(&listed(), file))
}

/// The mount point of the process that holds a lock, if that process has written the lock's file.
pub fn mountpoint_of(file: &mut File, pid: i32) -> Option<PathBuf> {
    file.rewind().ok()?;
    let line = regular::read_from(file, 8192).ok()?;
    let space = line.iter().position(|&byte| byte == b' ')?;
    let writer: i32 = str::from_utf8(&line[..space]).ok()?.parse().ok()?;
    let path = &line[space + 1..];
    // A command that mounts nothing writes no mount point.
    (writer == pid && !path.is_empty()).then(|| PathBuf::from(OsStr::from_bytes(path)))
}

fn listed() -> String {
    regular::read_text(Path::new("/proc/locks"), regular::SYSTEM).unwrap_or_default()
}

/// The process that holds the lock of a file, in the kernel's list.
pub fn holding(listed: &str, file: &Metadata) -> Option<i32> {
    let inode = format!("{:02x}:{:02x}:{}", major(file.dev()), minor(file.dev()), file.ino());
    listed.lines().find_map(|line| {
        // `1: FLOCK  ADVISORY  WRITE 359 00:13:11691 0 EOF`; a process that waits has an arrow in the second column.
        let [_, "FLOCK", _, _, pid, place, ..] = line.split_ascii_whitespace().collect::<Vec<_>>()[..] else {
            return None;
        };
        if place == inode { pid.parse().ok() } else { None }
    })
}

/// The folder for locks, to which no other user can write.
fn folder() -> Result<PathBuf> {
    let folder = folders::locks().ok_or_else(|| {
        let why = "this account has no home for the lock; set XDG_RUNTIME_DIR to a folder of its own";
        Error::host("lock", Errno::ENOENT, why)
    })?;
    own(&folder)?;
    Ok(folder)
}

/// Makes a folder unless it is there, and refuses one to which another user can write.
fn own(folder: &Path) -> Result<()> {
    let me = geteuid();
    let mode = if me.is_root() { 0o755 } else { 0o700 };
    let failed = |error| {
        let what = "cannot create the folder for locks; XDG_RUNTIME_DIR names another one";
        Error::io(folder.display().to_string(), what, &error)
    };
    DirBuilder::new().recursive(true).mode(mode).create(folder).map_err(failed)?;
    let status = fs::symlink_metadata(folder).map_err(failed)?;
    if !status.is_dir() || status.uid() != me.as_raw() || status.mode() & 0o022 != 0 {
        let why = "other users could write to it; remove it";
        return Err(Error::new(folder.display().to_string(), Cause::NotPermitted, why));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use gauge_bus::clock::SimClock;

    fn state(name: &str) -> PathBuf {
        std::env::temp_dir().join(format!("gaugefs-lock-{name}-{}", std::process::id()))
    }

    fn file(state: &Path) -> PathBuf {
        folder().expect("a folder").join(format!("{}.lock", key_of_state(state)))
    }

    /// A clock by which a wait takes a hundred times as long. Each look at /proc/locks holds up all who take a lock on this
    /// machine, so that twelve hundred of them in a row hold up the other tests.
    #[derive(Default)]
    struct Slowly(SimClock);

    impl Clock for Slowly {
        fn now(&self) -> Duration {
            self.0.now()
        }

        fn sleep(&self, time: Duration) {
            self.0.sleep(time * 100);
        }

        fn spend(&self, time: Duration) {
            self.0.spend(time);
        }
    }

    #[test]
    fn a_second_lock_is_refused_with_the_holder_of_the_first() {
        let state = state("second");
        let clock = Slowly::default();
        let lock = |ending: bool| Lock::state(&state, Path::new("/mnt/with space"), &clock, |_| ending);
        let first = lock(false).expect("not held");
        let mode = fs::metadata(file(&state)).expect("a file").mode();
        assert_eq!(mode & 0o777, 0o600, "others could hold it");
        let refused = lock(false).expect_err("held by the first");
        assert_eq!(refused.errno(), Errno::EBUSY as i32);
        let (text, pid) = (refused.to_string(), std::process::id());
        assert!(text.contains(&format!("in use by process {pid} (")), "{text}");
        assert!(
            text.contains(") for /mnt/with space; end it with: gaugefs umount /mnt/with space"),
            "{text}"
        );
        assert_eq!(clock.now(), Duration::ZERO);
        let refused = lock(true).expect_err("held by one that does not end").to_string();
        assert!(clock.now() >= ENDS, "it may still pay what it owes");
        assert!(refused.ends_with(&format!("end it with: kill {pid}")), "{refused}");
        drop(first);
        assert!(!file(&state).exists(), "the file is left behind");
        lock(false).expect("released");
    }

    #[test]
    fn the_holder_is_the_process_that_holds_the_lock_and_not_the_one_in_the_file() {
        let state = state("holder");
        let path = file(&state);
        let mut options = File::options();
        options.write(true).create(true).truncate(true).mode(0o600);
        let held = options.open(&path).expect("a file");
        fs::write(&path, "1 /mnt").expect("a line");
        let held = Flock::lock(held, FlockArg::LockExclusiveNonblock).expect("not held");
        let refused = Lock::state(&state, Path::new("/mnt"), &SimClock::new(), |_| false);
        let text = refused.expect_err("held").to_string();
        assert!(text.contains(&format!("in use by process {} (", std::process::id())), "{text}");
        assert!(!text.contains("/mnt"), "{text}");
        drop(held);
        fs::remove_file(path).expect("it is left");
    }

    /// An older version made it with mode 644, so that any user could keep a shared lock on it.
    #[test]
    fn a_file_that_others_can_open_is_replaced() {
        let state = state("shared");
        let path = file(&state);
        fs::write(&path, "1 /mnt").expect("a file");
        fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o644)).expect("its mode");
        let reader = Flock::lock(File::open(&path).expect("opens"), FlockArg::LockSharedNonblock);
        let lock =
            Lock::state(&state, Path::new("/mnt"), &SimClock::new(), |_| false).expect("it is replaced");
        assert_eq!(fs::metadata(&path).expect("a file").mode() & 0o777, 0o600);
        drop((lock, reader));
        assert!(!path.exists());
    }

    #[test]
    fn a_folder_that_others_can_write_to_holds_no_lock() {
        let parent = state("folder");
        own(&parent).expect("it is made");
        own(&parent).expect("it is there");
        let refuse = |folder: &Path| {
            let error = own(folder).expect_err("another user can write to it");
            assert!(error.to_string().contains("other users could write to it"), "{error}");
        };
        let link = parent.join("link");
        std::os::unix::fs::symlink(&parent, &link).expect("a link");
        refuse(&link);
        for mode in [0o720, 0o702, 0o1777] {
            fs::set_permissions(&parent, std::os::unix::fs::PermissionsExt::from_mode(mode))
                .expect("its mode");
            refuse(&parent);
        }
        fs::set_permissions(&parent, std::os::unix::fs::PermissionsExt::from_mode(0o700)).expect("its mode");
        // Only root can give it away.
        if geteuid().is_root() {
            std::os::unix::fs::chown(&parent, Some(2004), None).expect("its owner");
            refuse(&parent);
        }
        fs::remove_dir_all(parent).expect("it is left");
    }

    /// Each lock is that of another gauge, on a machine without these buses.
    #[test]
    fn a_gauge_in_front_of_a_mux_excludes_those_behind_it_and_they_not_each_other() {
        let bus = format!("i2c-{}", 1_000_000 + std::process::id());
        let name = |path: &str| format!("{bus}{path}-55");
        let lock = |path: &str| {
            Lock::take(&name(path), "a gauge", Path::new("/mnt/pack"), &SimClock::new(), |_| true)
        };
        let left = lock(".70.3").expect("nobody has it");
        let right = lock(".70.4").expect("a sibling channel");
        let deeper = lock(".70.4.71.0").expect_err("it is reached through channel 4").to_string();
        assert!(deeper.contains(&format!("in use on channel 4 of the mux at 0x70 on {bus}")), "{deeper}");
        let front = lock("").expect_err("two gauges are behind it").to_string();
        assert!(
            front.contains("of the mux at 0x70 on") && front.contains("gaugefs umount /mnt/pack"),
            "{front}"
        );
        let path = folder().expect("a folder").join(format!("{}.lock", name("")));
        assert!(!path.exists(), "a refused lock is released");
        drop((left, right));
        let front = lock("").expect("they are gone");
        let behind = lock(".70.3").expect_err("it is in front").to_string();
        assert!(
            behind.contains(&format!("in use on {bus}, on the other side of a mux, by process")),
            "{behind}"
        );
        Lock::take(&format!("{bus}.70.3-54"), "a gauge", Path::new(""), &SimClock::new(), |_| true)
            .expect("another address");
        drop(front);
        // What a dead process has left behind excludes nobody.
        fs::write(&path, "1 /mnt").expect("a file");
        lock(".70.3").expect("nobody holds it");
        fs::remove_file(path).expect("it is left");
    }

    /// The file is removed while another process has opened it, but not yet locked it.
    #[test]
    fn at_no_time_do_two_hold_the_lock() {
        let state = state("race");
        let holders = std::sync::atomic::AtomicU32::new(0);
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..200 {
                        let Ok(Ok(lock)) = Lock::attempt(&key_of_state(&state), Path::new("/mnt")) else {
                            continue;
                        };
                        let others = holders.fetch_add(1, std::sync::atomic::Ordering::SeqCst);
                        assert_eq!(others, 0);
                        std::thread::yield_now();
                        holders.fetch_sub(1, std::sync::atomic::Ordering::SeqCst);
                        drop(lock);
                    }
                });
            }
        });
        assert!(!file(&state).exists());
    }
}
