// SPDX-License-Identifier: MIT

//! `gaugefs mount`, and `gaugefs attach`, which systemd's units run after it.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{ArgGroup, Args};

use super::align;
use crate::config::{At, Given, MountOptions, Setup, names, standard_input};
use crate::daemon::{self, Mode, background, node, preflight, service};
use crate::error::Result;
use crate::output::{print, say};
use gauge_owner::{GaugeOptions, Source};

const MOUNT: &str = "\
Examples:
  gaugefs mount --sim bq34z100-g1 /tmp/gauges
  gaugefs mount --bus /dev/i2c-1 ~/gauges                      for you alone
  sudo gaugefs mount --bus /dev/i2c-1 --group i2c /run/gauges  for all to read
  gaugefs mount --bus /dev/i2c-1 --key-file ~/pack.keys ~/gauges
  sudo gaugefs mount --bus /dev/i2c-1 /sys/class/power_supply  beside others
  sudo gaugefs mount --config /etc/gaugefs/packs.toml          many gauges

Each gauge is a folder in MOUNTPOINT with the files of a kernel power supply: BAT0/voltage_now,
BAT0/capacity and so on. Its data flash is in BAT0/df, everything else in BAT0/gauge.";

/// Mount gauges; returns after the first poll
#[derive(Args, Debug)]
#[command(after_help = MOUNT, group = ArgGroup::new("gauges").required(true).multiple(true).args(["sim", "bus", "replay", "config"]))]
pub(super) struct Mount {
    /// TOML file that lists the gauges to mount, - for standard input; --bus applies to gauges that
    /// name none
    #[arg(long, value_name = "FILE", conflicts_with_all = of_one_gauge(), help_heading = "Gauge")]
    config: Option<PathBuf>,
    /// Print what the configuration would mount, and list every problem that the mount would have;
    /// mounts nothing
    #[arg(long, requires = "config", conflicts_with_all = ["sim", "replay"], help_heading = "Gauge")]
    check: bool,
    #[command(flatten)]
    gauge: Given<GaugeOptions>,
    #[command(flatten)]
    mount: Given<MountOptions>,
    /// Stay in the foreground and log to standard error
    #[arg(short, long, help_heading = "Running")]
    foreground: bool,
    /// Leave mounting to `gaugefs attach`, which systemd's unit runs as root
    #[arg(long, hide = true, requires = "foreground")]
    service: bool,
}

/// Mount for a service; systemd's units run it as root, with the service's own options
#[derive(Args, Debug)]
#[command(hide = true)]
pub(super) struct Attach {
    /// Process ID of the service
    #[arg(long)]
    pid: i32,
    #[command(flatten)]
    mount: Mount,
}

impl Mount {
    pub(super) fn run(self) -> Result<ExitCode> {
        if self.check {
            return check(&self.setup()?);
        }
        let mode = match (self.foreground, self.service) {
            (_, true) => Mode::Service,
            (true, false) => Mode::Foreground,
            (false, false) if background::is_child() => Mode::Background,
            (false, false) => return background::start(std::env::args_os()),
        };
        daemon::run(self.setup()?, mode).map(|()| ExitCode::SUCCESS)
    }

    fn setup(self) -> Result<Setup> {
        let gauge = self.gauge.options();
        match self.config {
            Some(file) => {
                Setup::read(&standard_input(file), |mount| self.mount.over(mount), gauge.bus.as_deref())
            }
            None => Setup::one(self.mount.options(), gauge),
        }
    }
}

/// The options of each gauge in a file. The bus is for gauges without one.
fn of_one_gauge() -> impl Iterator<Item = &'static str> {
    names::<GaugeOptions>(At::Line).filter(|name| *name != "bus")
}

impl Attach {
    pub(super) fn run(self) -> Result<ExitCode> {
        let setup = self.mount.setup()?;
        service::attach(self.pid, &setup)?;
        node::attach(self.pid, &setup)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// Prints the gauges of a configuration, and each problem that the mount would have.
fn check(setup: &Setup) -> Result<ExitCode> {
    let (names, found) = preflight::check(setup);
    print(&plan(setup, &names))?;
    for error in &found {
        say(error);
    }
    Ok(if found.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn plan(setup: &Setup, names: &[String]) -> String {
    let rows = names.iter().zip(&setup.gauges).map(|(name, gauge)| {
        let source = Source::of(gauge).ok();
        let chip = source.as_ref().and_then(Source::chip).map_or("asked", |chip| chip.name);
        let place = setup.mountpoint().join(name).display().to_string();
        [place, source.map_or_else(String::new, |source| source.to_string()), chip.to_string()]
    });
    align(&rows.collect::<Vec<_>>())
}
