// SPDX-License-Identifier: MIT

//! `gaugefs sim`, and the process that it starts for a command.

use std::ffi::OsString;
use std::iter;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use clap::Args;

use super::align;
use crate::bus::{self, Cuse, Gauge, Panel, RootPanel, Vhci};
use crate::config::{adapter, address, seal, standard_input};
use crate::error::{Cause, Error, Result};
use crate::output::{is_standard_output, print};
use gauge_bus::clock::{Clock, RealClock};
use gauge_bus::{AdapterModel, GAUGE_ADDRESS};
use gauge_owner::{Script, Source};
use gauge_sim::{FAULTS, Level, Options};
use gaugefs_host::signals;
use nix::unistd::geteuid;
use ti_gauge::chip::Chip;
use ti_gauge::text;

const SIM: &str = "\
Examples:
  gaugefs sim bq34z100-g1 -- i2cdump -y 90 0x55          as /dev/i2c-90
  gaugefs sim bq34z100-g1 -- sh -c 'i2cget -y $I2C_BUS 0x55 8 w'
  gaugefs sim bq34z100-g1 -- sh -c 'gaugefs mount --bus $I2C_DEV m; ls m'
  gaugefs sim bq34z100-g1 bq27220@0x56 /tmp/bus          a file, for any program
  gaugefs sim bq34z100-g1 --knobs /tmp/knobs /tmp/bus &  with the gauge's knobs
  echo 500 > /tmp/knobs/load_ma                          a load of 500 mA
  gaugefs sim bq34z100-g1 --list                         its knobs and faults
  gaugefs sim bq34z100-g1 --adapter cp2112 /tmp/bus   with a CP2112's limits
  gaugefs sim --replay pack.log /tmp/bus                 a recording
  sudo gaugefs sim bq34z100-g1 --cuse i2c-9              as /dev/i2c-9
  sudo gaugefs sim bq34z100-g1 --device                  for drivers

A program uses the file as it uses /dev/i2c-N. With a COMMAND the bus is /dev/i2c-N for it alone, N is in
$I2C_BUS and the path in $I2C_DEV, and the exit code is the command's. Both work without root; the
programs have to be yours. `i2cdetect -l` does not list the bus.";

/// Offer simulated gauges to any program as an I2C bus
#[derive(Args, Debug)]
#[command(after_help = SIM, override_usage = "gaugefs sim [OPTIONS] <CHIP[@ADDRESS]>... <PATH>\n       gaugefs sim [OPTIONS] <CHIP[@ADDRESS]>... [PATH] -- <COMMAND>...\n       gaugefs sim [OPTIONS] <CHIP[@ADDRESS]>... <--device|--cuse <NAME>>\n       gaugefs sim <CHIP>... --list")]
pub(super) struct Sim {
    /// Gauges to simulate, as `gaugefs chips` lists them, each at 0x55 or the given address; the last word is the PATH to
    /// serve at, if it contains a slash
    #[arg(value_name = "CHIP[@ADDRESS]|PATH")]
    words: Vec<OsString>,
    /// Run this command, for which the bus is /dev/i2c-N
    #[arg(last = true, value_name = "COMMAND")]
    command: Vec<OsString>,
    /// Offer a gauge of this recording too, which mount --trace made; - is standard input
    #[arg(long, value_name = "FILE")]
    replay: Option<PathBuf>,
    /// File that keeps the flash of the only gauge; created if missing
    #[arg(long, value_name = "FILE")]
    state: Option<PathBuf>,
    /// Seal state in which the gauges begin, sealed or unsealed [default: new gauges with flash are sealed, those with RAM
    /// unsealed]
    #[arg(long, value_name = "STATE", value_parser = seal)]
    seal: Option<Level>,
    /// Let this happen to the simulated gauges: a name as for `gaugefs mount --scenario`, or a file, whose path has a slash
    #[arg(long, value_name = "NAME|FILE")]
    scenario: Option<PathBuf>,
    /// Draw what is left to chance in the scenario by this number [default: the scenario's]
    #[arg(long, value_name = "N", requires = "scenario")]
    scenario_seed: Option<u64>,
    /// Show the knobs of the gauges in this folder, which is mounted; made if missing
    #[arg(long, value_name = "DIR")]
    knobs: Option<PathBuf>,
    /// Make a character device of that name in /dev, as root, whose rights are given up before anything is served; needs the
    /// kernel's CUSE
    #[arg(long, value_name = "NAME", conflicts_with_all = ["knobs", "command"])]
    cuse: Option<String>,
    /// Plug an adapter into the kernel, as root, whose rights are given up before anything is served: drivers bind to it, and
    /// it is /dev/i2c-N; needs the kernel's vhci-hcd and i2c-tiny-usb
    #[arg(long, conflicts_with_all = ["command", "cuse"])]
    device: bool,
    /// Answer as this adapter of the kernel does, with its limits, error numbers and pace; an unknown name lists them
    #[arg(long, value_name = "NAME", value_parser = adapter, conflicts_with = "replay")]
    adapter: Option<&'static AdapterModel>,
    /// Clock of the bus in kHz, 100 or 400, which sets how long transfers take [default: 100, or that of --adapter]
    #[arg(long, value_name = "KHZ", value_parser = ["100", "400"], hide_possible_values = true, conflicts_with = "fast")]
    speed: Option<String>,
    /// Transfers take no time on the bus
    #[arg(long)]
    fast: bool,
    /// Print the knobs of these gauges, and the faults that the knob `fault` takes, and exit
    #[arg(long, conflicts_with_all = ["command", "replay", "state", "seal", "scenario", "knobs", "cuse", "device", "adapter", "speed", "fast"])]
    list: bool,
}

/// Chip and address.
type Simulated = (&'static Chip, u8);

/// Become the command of `gaugefs sim`, with a /dev of its own
#[derive(Args, Debug)]
#[command(hide = true)]
pub(super) struct Inside {
    /// Number of the bus, without which it has its usual /dev
    #[arg(long)]
    number: Option<u32>,
    /// The command
    #[arg(last = true, required = true)]
    command: Vec<OsString>,
}

/// Unmount the knobs of `gaugefs sim` when it has ended
#[derive(Args, Debug)]
#[command(hide = true)]
pub(super) struct End {
    /// The folder
    folder: PathBuf,
    /// It was made for the knobs
    #[arg(long)]
    remove: bool,
}

impl End {
    pub(super) fn run(self) -> Result<ExitCode> {
        bus::end(&self.folder, self.remove).map(|()| ExitCode::SUCCESS)
    }
}

impl Sim {
    pub(super) fn run(self) -> Result<ExitCode> {
        if self.list {
            print(&self.listed()?)?;
            return Ok(ExitCode::SUCCESS);
        }
        let (chips, path) = self.parts()?;
        let signals = signals::block()?;
        let early = self.knobs.as_ref().filter(|_| self.device && geteuid().is_root());
        let early = early.map(|folder| RootPanel::mount(folder, self.state.as_deref())).transpose()?;
        let cuse = self.cuse.as_ref().map(|name| Cuse::open(name, self.state.as_deref())).transpose()?;
        let vhci = self.device.then(|| Vhci::plug(self.state.as_deref())).transpose()?;
        let gauges = self.gauges(&chips)?;
        let mut names: Vec<_> =
            gauges.iter().map(|gauge| format!("{} 0x{:02x}", gauge.name, gauge.address)).collect();
        if let (Some(model), Some(last)) = (self.adapter, names.last_mut()) {
            *last += &format!(" behind {}", model.name);
        }
        let speed =
            self.speed.as_ref().map(|speed| speed.parse::<u32>().expect("one of the possible values") * 1000);
        let hertz = speed.unwrap_or_else(|| self.adapter.map_or(100_000, AdapterModel::hertz));
        let (panel, _end) = match early {
            Some(early) => (None, Some(early.serve(&gauges)?)),
            None => (self.knobs.as_ref().map(|folder| Panel::mount(folder, &gauges)).transpose()?, None),
        };
        let adapter = bus::adapter(gauges, self.adapter, (!self.fast).then_some(hertz))?;
        if let Some(cuse) = cuse {
            return cuse.serve(adapter, signals, &names.join(", "));
        }
        if let Some(vhci) = vhci {
            return vhci.serve(&adapter, signals, &names.join(", "));
        }
        match (path, &self.command[..]) {
            (Some(path), []) => bus::at(&path, adapter, panel, signals, &names.join(", ")),
            (path, command) => bus::with_command(path.as_deref(), adapter, signals, command),
        }
    }

    /// The knobs of each gauge, and the faults.
    fn listed(&self) -> Result<String> {
        if self.words.is_empty() {
            let why = "no gauge; name a CHIP, as `gaugefs chips` lists them";
            return Err(Error::new("sim", Cause::Invalid, why));
        }
        let mut text = String::new();
        for word in &self.words {
            let (chip, _) = chip(&word.to_string_lossy())?;
            let sim = gauge_sim::Sim::new(chip.name, &Options::default(), Arc::new(RealClock::new()))?;
            let head = ["KNOB", "ACCESS", chip.model].map(String::from);
            let rows = sim.knobs().into_iter().map(|knob| {
                let access = if knob.writable { "read, write" } else { "read" };
                [knob.name, access, knob.help].map(String::from)
            });
            text += &align(&iter::once(head).chain(rows).collect::<Vec<_>>());
            text.push('\n');
        }
        let head = ["FAULT".to_string(), "N counts transfers: 1 is the next one".to_string()];
        let faults = FAULTS.iter().map(|fault| [fault.to_string(), fault.help.to_string()]);
        Ok(text + &align(&iter::once(head).chain(faults).collect::<Vec<_>>()))
    }

    /// The gauges' chips and addresses, and the path.
    fn parts(&self) -> Result<(Vec<Simulated>, Option<PathBuf>)> {
        let mut words = &self.words[..];
        let mut path = None;
        if let Some((last, before)) =
            words.split_last().filter(|(last, _)| last.to_string_lossy().contains('/'))
        {
            (path, words) = (Some(PathBuf::from(last)), before);
        }
        let chips = words.iter().map(|word| chip(&word.to_string_lossy())).collect::<Result<Vec<_>>>()?;
        if chips.is_empty() && self.replay.is_none() {
            let why = "no gauge; name a CHIP, as `gaugefs chips` lists them, or a recording with --replay";
            return Err(Error::new("sim", Cause::Invalid, why));
        }
        let is_device = self.device || self.cuse.is_some();
        if path.is_some() && is_device {
            let why = "the bus is offered as a device; leave out the PATH";
            return Err(Error::new("sim", Cause::Invalid, why));
        }
        if path.is_none() && self.command.is_empty() && !is_device {
            let why = "nowhere to offer the bus; add a PATH, such as ./bus, or -- and a command, or --device";
            return Err(Error::new("sim", Cause::Invalid, why));
        }
        if self.scenario.is_some() && chips.is_empty() {
            let why = "a recording shows what has happened, and nothing else; name a CHIP to simulate";
            return Err(Error::new("--scenario", Cause::Invalid, why));
        }
        if self.state.as_deref().is_some_and(is_standard_output) {
            let why = "the gauge's flash is read from it and written to it; name a file";
            return Err(Error::new("--state", Cause::Invalid, why));
        }
        if self.state.is_some() && chips.len() != 1 {
            let why = "it keeps the flash of one gauge; name one CHIP";
            return Err(Error::new("--state", Cause::Invalid, why));
        }
        Ok((chips, path))
    }

    fn gauges(&self, chips: &[Simulated]) -> Result<Vec<Gauge>> {
        let clock: Arc<dyn Clock> = Arc::new(RealClock::new());
        let io = |path: &PathBuf| {
            let failed = |error| Error::io(path.display().to_string(), "is no path", &error);
            std::path::absolute(path).map_err(failed)
        };
        let state = self.state.as_ref().map(io).transpose()?;
        let scenario = self.scenario.clone().map(|name| Script { name, seed: self.scenario_seed });
        let sim = |chip| Source::Sim {
            chip,
            state: state.clone(),
            key: None,
            seal: self.seal,
            scenario: scenario.clone(),
            knobs: Vec::new(),
            adapter: None,
        };
        let mut gauges = chips
            .iter()
            .map(|&(chip, address)| Gauge::open(&sim(chip), address, &clock))
            .collect::<Result<Vec<_>>>()?;
        if let Some(recording) = self.replay.clone().map(standard_input) {
            gauges.push(Gauge::open(&Source::Recording(recording), GAUGE_ADDRESS, &clock)?);
        }
        Ok(gauges)
    }
}

/// `CHIP` or `CHIP@ADDRESS`.
fn chip(word: &str) -> Result<Simulated> {
    let (name, at) = word.split_once('@').map_or((word, None), |(name, at)| (name, Some(at)));
    let refuse = |why: String| Error::new(word, Cause::Invalid, why);
    let is_simulated = |chip: &&'static Chip| gauge_sim::Sim::knows(chip.name);
    let chip = Chip::by_name(&name.to_ascii_lowercase()).filter(is_simulated).ok_or_else(|| {
        let names = Chip::all().filter(is_simulated).map(|chip| chip.name);
        let meant = text::nearest(&name.to_ascii_lowercase(), names);
        let meant = meant.map_or(";".into(), |meant| format!("; did you mean {meant}?"));
        refuse(format!(
            "no gauge that is simulated{meant} `gaugefs chips` lists them. A PATH has a slash, such as ./bus"
        ))
    })?;
    let address = at.map_or(Ok(chip.address), |at| address(at).map_err(refuse))?;
    Ok((chip, address))
}

impl Inside {
    pub(super) fn run(self) -> Result<ExitCode> {
        bus::become_command(self.number, &self.command)
    }
}
