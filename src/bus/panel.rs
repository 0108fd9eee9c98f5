// SPDX-License-Identifier: MIT

//! The folder of knobs of `gaugefs sim`.

use std::fs::File;
use std::io;
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{ChildStdin, Command, Stdio};
use std::sync::Arc;

use nix::mount::{MsFlags, mount};
use nix::unistd::{getegid, geteuid};

use super::{Gauge, Place, SOURCE, rights};
use crate::daemon::knobs::SimKnobs;
use crate::error::{Error, Result};
use crate::fs::{Access, Fs, Knobs};
use crate::fuse;
use crate::output::say;

/// The knobs of the simulated gauges: of the only one, or in a folder for each.
fn tree(gauges: &[Gauge], uid: u32, gid: u32) -> Arc<Fs> {
    let knobs = gauges.iter().filter_map(|Gauge { name, address, sim, .. }| {
        let knobs = Box::new(SimKnobs(sim.clone()?)) as Box<dyn Knobs>;
        Some((format!("{name}@0x{address:02x}"), knobs))
    });
    Arc::new(Fs::of_knobs(knobs.collect(), Access { uid, gid, group: false }))
}

/// A mounted folder of knobs; dropping it unmounts it.
pub(crate) struct Panel(Place);

impl Panel {
    pub(crate) fn mount(path: &Path, gauges: &[Gauge]) -> Result<Self> {
        let tree = tree(gauges, geteuid().as_raw(), getegid().as_raw());
        let place = Place::prepare(path, true)?;
        place.mount(|path| fuse::mount_knobs(tree, path, SOURCE))?;
        Ok(Self(place))
    }
}

impl Drop for Panel {
    fn drop(&mut self) {
        if let Err(error) = self.0.remove() {
            say(error);
        }
    }
}

/// A folder that is mounted before root's rights are given up, for the user who has them then. A process that stays root
/// unmounts it when this one ends, however that happens.
pub(crate) struct RootPanel {
    device: OwnedFd,
    end: ChildStdin,
}

impl RootPanel {
    /// Mounts it for the user that [`rights::give_up`] makes of root.
    pub(crate) fn mount(folder: &Path, state: Option<&Path>) -> Result<Self> {
        let failed = |what: &str, error: io::Error| Error::io(folder.display().to_string(), what, &error);
        let (uid, gid) = rights::successor(state)?;
        let place = Place::prepare(folder, true)?;
        let device = place.mount(|path| {
            let device = File::options().read(true).write(true).open("/dev/fuse");
            let device = device.map_err(|error| failed("cannot be mounted without /dev/fuse", error))?;
            let data = format!(
                "fd={},rootmode=40000,user_id={uid},group_id={gid},default_permissions,allow_other",
                device.as_raw_fd()
            );
            let flags = MsFlags::MS_NOSUID | MsFlags::MS_NODEV | MsFlags::MS_NOEXEC;
            mount(Some(SOURCE), path, Some("fuse.knobs"), flags, Some(&*data))
                .map_err(|errno| failed("cannot be mounted", errno.into()))?;
            Ok(device)
        })?;
        // Signals of the terminal are for the server.
        let mut end = Command::new("/proc/self/exe");
        end.arg("sim-end").arg(&place.path).stdin(Stdio::piped()).process_group(0);
        if place.is_made {
            end.arg("--remove");
        }
        let child = end.spawn().inspect_err(|_| drop(place.remove()));
        let mut child = child.map_err(|error| failed("cannot be unmounted at the end", error))?;
        let end = child.stdin.take().expect("a pipe");
        Ok(Self { device: device.into(), end })
    }

    /// Serves the knobs of these gauges there while the returned end is open.
    pub(crate) fn serve(self, gauges: &[Gauge]) -> Result<ChildStdin> {
        let tree = tree(gauges, geteuid().as_raw(), getegid().as_raw());
        let mounted = fuse::serve(tree, self.device, fuse::Options::default(), Arc::default())?;
        // Dropping it would unmount what this process may not.
        std::mem::forget(mounted);
        Ok(self.end)
    }
}

/// Waits until the server has ended, and unmounts its knobs.
pub(crate) fn end(path: &Path, is_made: bool) -> Result<()> {
    let _ = io::copy(&mut io::stdin(), &mut io::sink());
    Place { path: path.into(), is_made }.remove()
}
