// SPDX-License-Identifier: MIT

//! The mounted tree: an adapter between [`Fs`] and the crate `fuser`.
//!
//! - `adapter` handles the kernel's requests.
//! - `inodes` is the table of nodeids. One nodeid is one immutable value: LOOKUP gives a file's present text
//!   a nodeid of its own with its exact size, and GETATTR and READ of that nodeid serve those bytes until FORGET, or
//!   until nobody has used it for a while. So no reader gets the size of one value with the bytes of another, and a value that
//!   has not changed comes from the kernel's page cache without a message. A file that may be written has a nodeid
//!   for each lookup, so that nobody reads what the kernel has copied there for a writer and gaugefs then refuses. Its
//!   attributes are leased to the kernel for a moment, in which one program opens and reads it; a write to the gauge begins
//!   when no lease is left, so that everybody has to ask again before it is answered.
//! - `entry` is the answer to a LOOKUP.
//! - `notify` is the thread that notifies the kernel that files have a new value.
//!
//! `open` is answered ENOSYS once, after which the kernel does not ask again; so is `opendir`, except over
//! the kernel's own supplies, where the kernel must not keep the root's listing.
//!
//! A new value is a new nodeid: it becomes the current one under the lock, the lock is released, and then
//! the kernel is notified, so that it looks the name up again. A file that is held open across a change keeps its
//! nodeid; that nodeid is renewed when no read of the old value can be under way any more. The kernel finds out
//! without a notification, because it has to ask for the file's attributes again by then.

use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::sync::mpsc::{self, Receiver};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use fuser::{Config, MountOption, Session, SessionACL};

use crate::error::{Error, Result};
use crate::fs::{Fs, Node};
use gauge_owner::Signal;

mod adapter;
mod entry;
mod inodes;
pub mod needs;
mod notify;
#[cfg(test)]
mod races;
pub mod single;

use adapter::{Adapter, Waiter};
use inodes::{Inodes, Now, Value};
pub use notify::Announcer;

/// Mount options.
#[derive(Clone, Copy, Debug, Default)]
pub struct Options {
    /// Only the mount's owner has access.
    pub private: bool,
    /// Others have access, although an ordinary user mounts; see `daemon::preflight`.
    pub shared: bool,
    /// Every write is refused.
    pub read_only: bool,
    /// The kernel keeps no names of files, as before Linux 6.16.
    pub names_not_kept: bool,
}

/// A mounted tree. Dropping it unmounts the tree.
pub struct Mounted {
    session: fuser::BackgroundSession,
    /// Disconnects when the session has ended and its adapter is dropped.
    over: Receiver<()>,
    announcer: Announcer,
}

impl Mounted {
    /// Whether somebody else has unmounted the tree.
    pub fn is_over(&self) -> bool {
        self.session.guard.is_finished()
    }

    /// The thread that must stop before the process exits with the tree still mounted.
    pub fn announcer(&self) -> Announcer {
        self.announcer.clone()
    }

    /// Returns when somebody else has unmounted the tree.
    pub fn wait(self) {
        // Nothing is sent: the channel disconnects with the session.
        let _ = self.over.recv();
        // Dropping the session would unmount the path again, and so remove a newer mount: fuser takes the POLLERR of a
        // closed connection for a mount (in its `is_mounted`).
        std::mem::forget(self.session);
    }
}

fn host(subject: &str, error: &std::io::Error) -> Error {
    let errno = nix::errno::Errno::from_raw(error.raw_os_error().unwrap_or_default());
    // The message of fusermount3 ends with a newline.
    Error::host(subject, errno, error.to_string().trim_end())
}

/// Mounts the tree and serves it from separate threads until it is unmounted. The caller raises `signal` after possible
/// changes of the tree.
pub fn mount(fs: Arc<Fs>, mountpoint: &Path, options: Options, signal: Arc<Signal>) -> Result<Mounted> {
    let mut config = Config::default();
    if options.read_only {
        config.mount_options.push(MountOption::RO);
    }
    // The kernel refuses this option to ordinary users unless the administrator allows it.
    if (nix::unistd::geteuid().is_root() || options.shared) && !options.private {
        config.acl = SessionACL::All;
    }
    let source = ("gaugefs", "gaugefs");
    start(fs, options, signal, |adapter| needs::session(adapter, mountpoint, source, config))
}

/// Mounts a tree of nothing but knobs, for this user alone, and serves it until it is unmounted. Its name in the mount table
/// begins with `source`.
pub fn mount_knobs(fs: Arc<Fs>, path: &Path, source: &str) -> Result<()> {
    let mounted = start(fs, Options::default(), Arc::default(), |adapter| {
        needs::session(adapter, path, (source, "knobs"), Config::default())
    })?;
    // Dropping it would unmount the path, and so whatever has been mounted there since.
    std::mem::forget(mounted);
    Ok(())
}

/// Serves the tree through a mounted `/dev/fuse`.
pub fn serve(fs: Arc<Fs>, device: OwnedFd, options: Options, signal: Arc<Signal>) -> Result<Mounted> {
    // The mount's own options tell the kernel who has access.
    start(fs, options, signal, |adapter| {
        Session::from_fd(adapter, device, SessionACL::All, Config::default())
            .map_err(|error| host("/dev/fuse", &error))
    })
}

fn start(
    fs: Arc<Fs>,
    options: Options,
    signal: Arc<Signal>,
    begin: impl FnOnce(Adapter) -> Result<Session<Adapter>>,
) -> Result<Mounted> {
    let table = Arc::new(Mutex::new(Inodes::new(Now::read())));
    let announcer = Announcer::new(signal);
    let (alive, over) = mpsc::channel();
    let adapter = Adapter {
        fs: fs.clone(),
        table: table.clone(),
        options,
        announcer: announcer.clone(),
        waits: Arc::default(),
        _alive: alive,
    };
    let session = begin(adapter)?;
    announcer.device.open(session.as_fd()).map_err(|error| host("/dev/fuse", &error))?;
    if !options.names_not_kept {
        announcer.keep_names();
    }
    let notifier = session.notifier();
    announcer.start(fs, table, notifier)?;
    let session = session.spawn().map_err(|error| host("a thread", &error))?;
    Ok(Mounted { session, over, announcer })
}

/// The nodeids, shared by the handlers and the notifying thread.
type Table = Mutex<Inodes<Waiter>>;

/// Data of several threads. The tests of `races` have their own lock, which chooses whose turn it is.
trait Shared<T> {
    fn with<R>(&self, work: impl FnOnce(&mut T) -> R) -> R;
}

impl<T> Shared<T> for Mutex<T> {
    fn with<R>(&self, work: impl FnOnce(&mut T) -> R) -> R {
        work(&mut lock(self))
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A thread that panicked leaves a table of values, each of them whole.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A file's present value.
fn present(fs: &Fs, node: Node) -> Value {
    Value::of(fs.content(node)).unwrap_or(Value::Gone)
}
