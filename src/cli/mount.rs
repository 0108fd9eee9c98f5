//! `gaugefs mount`, and `gaugefs attach`, which systemd's units run after it.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{ArgGroup, Args};

use super::{align, print};
use crate::config::{self, GaugeOptions, MountOptions};
use crate::daemon::{self, Gauges, background, mountpoint, service};
use crate::error::Result;
use crate::fs::Covered;

const MOUNT: &str = "\
Examples:
  gaugefs mount --sim bq34z100-g1 /tmp/gauges
  gaugefs mount --bus /dev/i2c-1 /run/gauges
  gaugefs mount --bus /dev/i2c-1 --chip bq34z100-g1 --name PACK --key-file ~/pack.keys /run/gauges
  gaugefs mount --bus /dev/i2c-1 /sys/class/power_supply     together with the kernel's supplies
  gaugefs mount --config /etc/gaugefs/packs.toml             many gauges

Each gauge is a folder in MOUNTPOINT with the files of a kernel power supply: BAT0/voltage_now,
BAT0/capacity and so on. Its data flash is in BAT0/df, everything else in BAT0/gauge.";

/// Mount gauges; returns after the first poll
#[derive(Args, Debug)]
#[command(after_help = MOUNT, group = ArgGroup::new("gauges").required(true).multiple(true).args(["sim", "bus", "replay", "config"]))]
pub(super) struct Mount {
    /// TOML file that lists the gauges to mount; --bus applies to gauges that name none
    #[arg(long, value_name = "FILE", help_heading = "Gauge")]
    config: Option<PathBuf>,
    /// Check the configuration and print what it would mount, without mounting
    #[arg(long, requires = "config", conflicts_with_all = ["sim", "replay"], help_heading = "Gauge")]
    check: bool,
    #[command(flatten)]
    gauge: GaugeOptions,
    #[command(flatten)]
    mount: MountOptions,
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
            print(&plan(self.options()?)?);
            return Ok(ExitCode::SUCCESS);
        }
        if !self.foreground && !background::is_child() {
            return background::start();
        }
        daemon::run(self.options()?).map(|()| ExitCode::SUCCESS)
    }

    fn options(self) -> Result<daemon::Options> {
        let Self { config, gauge, mount, foreground, service, .. } = self;
        let Some(file) = config else {
            let gauge = gauge.of_node()?.gauge().expect("clap requires --sim, --bus, --replay or --config");
            return Ok(daemon::Options { service, ..mount.with(Gauges::One(Box::new(gauge)), foreground) });
        };
        let (mount, gauges) = config::read(&file, mount, gauge.bus())?;
        Ok(daemon::Options { service, ..mount.with(Gauges::Many(gauges), foreground) })
    }
}

impl Attach {
    pub(super) fn run(self) -> Result<ExitCode> {
        service::attach(self.pid, &self.mount.options()?)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// What a configuration would mount: path, source and chip of each gauge.
fn plan(options: daemon::Options) -> Result<String> {
    let Gauges::Many(gauges) = options.gauges else { return Ok(String::new()) };
    let covered = mountpoint::covered(&options.mountpoint)?;
    let taken = covered.as_ref().map(Covered::names).unwrap_or_default();
    let rows = daemon::named(gauges, &taken).into_iter().map(|(name, gauge)| {
        let chip = gauge.source.chip().map_or("asked", |chip| chip.name);
        let place = options.mountpoint.join(name).display().to_string();
        [place, gauge.source.to_string(), chip.to_string()]
    });
    Ok(align(&rows.collect::<Vec<_>>()))
}
