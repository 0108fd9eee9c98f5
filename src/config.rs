// SPDX-License-Identifier: MIT

//! The options of a mount and of its gauges, from the command line or a configuration file. `options` defines each of
//! them once.

use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use crate::error::{Cause, Error, Result};
use gauge_owner::{GaugeOptions, Source};

mod choice;
pub(crate) mod file;
mod node;
pub(crate) mod option;
pub(crate) mod options;
pub(crate) mod values;

pub(crate) use choice::ChoiceOptions;
use node::Node;
pub(crate) use option::{At, Given, Opt, Options, names, written};
pub(crate) use options::{AlertOptions, MountOptions};
pub(crate) use values::{
    adapter, address, celsius, chip_names, chips, divider, meter_current, pack_voltage, seal,
};

/// Whether a gauge is simulated in this process.
pub(crate) fn is_simulated(options: &GaugeOptions) -> bool {
    matches!(Source::of(options), Ok(Source::Sim { .. }))
}

/// Whether a gauge is a recording.
fn is_recorded(options: &GaugeOptions) -> bool {
    matches!(Source::of(options), Ok(Source::Recording(_)))
}

/// The settings of `gaugefs mount`, from the command line and the configuration file. Paths are absolute, because the
/// daemon in the background changes its folder to `/`.
#[derive(Debug)]
pub(crate) struct Setup {
    pub(crate) mount: MountOptions,
    /// Each has a source: simulated, recorded, or on a bus.
    pub(crate) gauges: Vec<GaugeOptions>,
    /// For `gaugefs watch`.
    #[cfg_attr(not(feature = "screen"), allow(dead_code, reason = "the commands of that feature use them"))]
    pub(crate) alerts: Vec<AlertOptions>,
    /// From a configuration file, so that gauges without an answer are skipped.
    pub(crate) configured: bool,
}

impl Setup {
    pub(crate) fn one(mut mount: MountOptions, mut gauge: GaugeOptions) -> Result<Self> {
        Node::complete(&mut gauge)?;
        option::read_dashes(&mut gauge)?;
        option::read_dashes(&mut mount)?;
        make_absolute(&mut mount, Path::new(""))?;
        make_absolute(&mut gauge, Path::new(""))?;
        mount.read_only |= is_recorded(&gauge);
        Ok(Self { mount, gauges: vec![gauge], alerts: Vec::new(), configured: false })
    }

    /// The gauges of a configuration file. `over` replaces the file's options of the mount; `bus` is for gauges without
    /// a source.
    pub(crate) fn read(
        path: &Path,
        over: impl FnOnce(&mut MountOptions),
        bus: Option<&Path>,
    ) -> Result<Self> {
        let mut bus = bus.map(Path::to_path_buf);
        if let Some(bus) = &mut bus {
            absolute(bus, Path::new(""))?;
        }
        let name = path.display().to_string();
        let refuse = |why: &'static str| Err(Error::new(&name, Cause::Invalid, why));
        let (mut mount, gauges, alerts) = file::read(path, bus.as_deref())?;
        if gauges.iter().any(choice::runs) {
            check_own(path)?;
        }
        over(&mut mount);
        option::read_dashes(&mut mount)?;
        make_absolute(&mut mount, Path::new(""))?;
        if mount.mountpoint.is_none() {
            return refuse("no mount point; give one on the command line, or set mountpoint below [mount]");
        }
        let recordings = gauges.iter().filter(|gauge| is_recorded(gauge)).count();
        if recordings > 0 && recordings < gauges.len() && !mount.read_only {
            return refuse(
                "a recording makes all gauges of its mount read-only; set read-only = true below [mount], or \
                 mount it separately",
            );
        }
        mount.read_only |= recordings > 0;
        Ok(Self { mount, gauges, alerts, configured: true })
    }

    pub(crate) fn mountpoint(&self) -> &Path {
        self.mount.mountpoint.as_deref().expect("clap and `read` demand a mount point")
    }
}

/// The mount point in a configuration file, and its alerts, whose programs run with the privileges of the file's
/// reader.
#[cfg(feature = "screen")]
pub(crate) fn alerts(path: &Path) -> Result<(Option<PathBuf>, Vec<AlertOptions>)> {
    check_own(path)?;
    file::alerts(path)
}

/// Checks that nobody else can have written a file with programs to run.
fn check_own(path: &Path) -> Result<()> {
    let name = path.display().to_string();
    if path == Path::new("-") || path == Path::new(STANDARD_INPUT) {
        let why = "programs are run from it, so it must be a file that nobody else may change";
        return Err(Error::new("standard input", Cause::Invalid, why));
    }
    let status = std::fs::metadata(path).map_err(|error| Error::io(&name, "cannot read it", &error))?;
    let me = nix::unistd::geteuid().as_raw();
    let refuse = |why: String| Err(Error::new(&name, Cause::NotPermitted, why));
    if ![me, 0].contains(&status.uid()) {
        let why =
            format!("belongs to user {}; a file with programs to run must be yours or root's", status.uid());
        return refuse(why);
    }
    if status.mode() & 0o022 != 0 {
        let mode = status.mode() & 0o777;
        return refuse(format!("others may change the programs in it (mode {mode:03o}); chmod go-w {name}"));
    }
    Ok(())
}

/// The file for `-` on a command line.
const STANDARD_INPUT: &str = "/dev/stdin";

/// The path of a file that is read as a whole, before the command returns.
pub(crate) fn standard_input(path: PathBuf) -> PathBuf {
    if path == Path::new("-") { STANDARD_INPUT.into() } else { path }
}

/// Makes relative paths of options absolute, below `folder`, or below the current folder if `folder` is empty.
pub(crate) fn make_absolute<T: Options>(options: &mut T, folder: &Path) -> Result<()> {
    let mut done = Ok(());
    option::paths(options, |path| {
        if done.is_ok() {
            done = absolute(path, folder);
        }
    });
    done
}

pub(crate) fn absolute(path: &mut PathBuf, folder: &Path) -> Result<()> {
    *path = std::path::absolute(folder.join(&*path))
        .map_err(|error| Error::io(path.display().to_string(), "cannot find it", &error))?;
    Ok(())
}
