// SPDX-License-Identifier: MIT

//! Ends a mount after a signal, according to its phase.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError, mpsc};

use nix::errno::Errno;
use nix::sys::signal::Signal;

use super::mountpoint;
use crate::error::{Error, Result};
use crate::fuse;
use crate::output::say;
use gauge_owner::lock;
use gauge_owner::{Handle, operations as op};
use gaugefs_client::mounts;
use gaugefs_host::signals;

#[derive(Default)]
pub(super) enum Phase {
    /// Nothing is mounted, and gauges were only read.
    #[default]
    Starting,
    /// A signal has to unmount this.
    Mounted(PathBuf, Vec<Handle>, fuse::Announcer),
    /// `service::attach` has mounted it, and `service::detach` will unmount it.
    Serving(Vec<Handle>, fuse::Announcer),
    /// It is unmounted, and `run` is about to return.
    Ending,
}

/// The mount's phase, shared with the thread that handles signals.
pub(super) struct Shutdown(Arc<Mutex<Phase>>);

impl Shutdown {
    /// Starts the thread that handles signals. Call it before other threads start.
    pub(super) fn watch() -> Result<Self> {
        let signals = signals::block()?;
        let phase = Arc::new(Mutex::default());
        let watched = Arc::clone(&phase);
        let watch = move || {
            while let Ok(signal) = signals.wait() {
                end(signal, &mut watched.lock().unwrap_or_else(PoisonError::into_inner));
            }
        };
        let thread = std::thread::Builder::new().name("signals".into()).stack_size(128 * 1024);
        thread.spawn(watch).map_err(|error| Error::io("signals", "cannot start a thread", &error))?;
        Ok(Self(phase))
    }

    /// Mounts. A signal waits for the end and finds the new phase: ending the process in between would leave a mount
    /// without a daemon.
    pub(super) fn mount<T>(&self, mount: impl FnOnce() -> Result<(T, Phase)>) -> Result<T> {
        let mut phase = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (mounted, reached) = mount()?;
        *phase = reached;
        Ok(mounted)
    }

    pub(super) fn reach(&self, phase: Phase) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = phase;
    }
}

fn end(signal: Signal, phase: &mut Phase) {
    let (path, handles, announcer) = match phase {
        Phase::Starting => {
            say(format_args!("{signal}: ended before the gauge was mounted"));
            lock::remove_all();
            std::process::exit(1);
        }
        Phase::Mounted(path, handles, announcer) => (path, handles, announcer),
        Phase::Serving(handles, announcer) => {
            log::info!("{signal}: ending");
            let ended = answer(handles, announcer);
            std::process::exit(i32::from(ended.is_err()));
        }
        Phase::Ending => return,
    };
    log::info!("{signal}: unmounting {}", path.display());
    match mountpoint::detach(path, false) {
        // The FUSE session ends, and `run` with it.
        Ok(()) => *phase = Phase::Ending,
        Err(error) if error.errno() == Errno::EBUSY as i32 => {
            log::warn!("{}: in use, so it is detached", path.display());
            let detached = mountpoint::detach(path, true);
            mountpoint::unmake();
            let ended = answer(handles, announcer);
            // Somebody else may have detached it meanwhile.
            let remains = detached.is_err() && mounts::is_gaugefs(path);
            std::process::exit(i32::from(remains || ended.is_err()));
        }
        // Somebody else has detached it, but a file is still open.
        Err(_) if !mounts::is_gaugefs(path) => {
            mountpoint::unmake();
            let ended = answer(handles, announcer);
            std::process::exit(i32::from(ended.is_err()));
        }
        Err(error) => log::error!("{error}"),
    }
}

/// Answers every accepted write with its outcome, and accepts no other. When it returns, the kernel has the answers,
/// and the locks are removed. An error is that of [`finish`].
fn answer(handles: &[Handle], announcer: &fuse::Announcer) -> Result<()> {
    announcer.refuse();
    let ended = finish(handles);
    announcer.stop();
    lock::remove_all();
    ended
}

/// Waits until the gauges' owners have completed submitted requests, such as transactions, and have settled what is
/// owed; then they do nothing else. What is still owed is logged, and is an error.
pub(super) fn finish(handles: &[Handle]) -> Result<()> {
    let (done, is_done) = mpsc::channel();
    for handle in handles {
        let done = done.clone();
        // Requests are served in order.
        handle.ask(&op::END, (), Box::new(move |ended| drop(done.send(ended))));
    }
    drop(done);
    let owed = is_done.iter().filter_map(Result::err).inspect(|error| log::error!("{error}"));
    owed.reduce(|first, _| first).map_or(Ok(()), Err)
}
