// SPDX-License-Identifier: MIT

//! The options of a gauge as typed, passed on as one value: an option is read where it is used, and nowhere else.

use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

use crate::choose::Rule;
use gauge_bus::AdapterModel;
use gauge_sim::Level;
use ti_gauge::authentication::Order;
use ti_gauge::chip::Chip;

/// What a gauge is, and how it is treated. All paths are absolute.
#[derive(Clone, Debug, Default)]
pub struct GaugeOptions {
    /// Simulate a gauge of this chip.
    pub sim: Option<&'static Chip>,
    /// File that keeps the flash of the simulated gauge.
    pub sim_state: Option<PathBuf>,
    /// Unseal key of a new simulated gauge.
    pub sim_key: Option<SimKey>,
    /// Seal state in which the simulated gauge begins.
    pub sim_seal: Option<Level>,
    /// Knobs that are turned before anything happens, each with its setting.
    pub sim_set: Vec<(String, String)>,
    /// The adapter that the simulated gauge is behind.
    pub sim_adapter: Option<&'static AdapterModel>,
    /// Name or file of what happens to the simulated gauge.
    pub scenario: Option<PathBuf>,
    /// Another seed than the scenario's.
    pub scenario_seed: Option<u64>,
    /// The adapter's node.
    pub bus: Option<PathBuf>,
    /// Its 7-bit address.
    pub address: Option<u8>,
    /// Its chip; `None` where the gauge is asked.
    pub chip: Option<&'static Chip>,
    /// Replay a gauge from this recording.
    pub replay: Option<PathBuf>,
    /// Send a gauge of TI's in a Smart Battery the questions of its table.
    pub ask_the_pack: bool,
    /// Write one byte a transfer.
    pub byte_writes: bool,
    /// Image that a gauge without flash gets again after it has lost power.
    pub profile: Option<PathBuf>,
    /// In its place, the rules by which one of several profiles is chosen.
    pub choose: Vec<Rule>,
    /// The name of a pack that is never exchanged unnoticed.
    pub pack: Option<String>,
    /// Name of its folder in a mount.
    pub name: Option<String>,
    /// Time between two polls.
    pub poll: Option<Duration>,
    /// A mount shows energies as well.
    pub energy: bool,
    /// A mount shows currents without their sign.
    pub absolute_current: bool,
    /// A mount offers it to the kernel as a battery.
    pub kernel_node: bool,
    /// A mount multiplies currents and charges by this.
    pub current_scale: Option<f64>,
    /// A mount multiplies voltages by this.
    pub voltage_scale: Option<f64>,
    /// A mount multiplies energies and powers by this.
    pub energy_scale: Option<f64>,
    /// Also write parameters whose address or range is uncertain.
    pub allow_unproven: bool,
    /// Also write during a learning cycle.
    pub allow_learning: bool,
    /// Blocks of flash that may be programmed in an hour; 0 for no limit.
    pub writes_per_hour: Option<u32>,
    /// The file with its keys; without one, systemd's credential.
    pub key_file: Option<PathBuf>,
    /// The manual's keys are not tried.
    pub no_default_keys: bool,
    /// Byte order in which challenges are sent.
    pub auth_order: Option<Order>,
    /// File in which every transfer is recorded.
    pub trace: Option<PathBuf>,
    /// That file may be there already, and is replaced.
    pub trace_replace: bool,
}

/// Key words, which are not shown again.
#[derive(Clone)]
pub struct SimKey(pub [u16; 2]);

impl fmt::Debug for SimKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("hidden")
    }
}
