//! A gauge at the level of the wire: how it is made, and what its scheme answers byte by byte.

use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

use super::device::Device;
use super::error::Result;
use super::flash::Flash;
use super::model::Model;
use super::seal::Level;

/// Where a gauge in ROM mode answers.
pub(super) const ROM_ADDRESS: u8 = 0x0B;

/// How a simulated gauge is made.
#[derive(Clone, Default)]
pub struct Options {
    /// File that keeps the flash across processes. It is created if it does not exist.
    pub state: Option<PathBuf>,
    /// The key that unseals a new gauge, in the order its words are sent.
    pub unseal_key: Option<[u16; 2]>,
    /// Seed of the random faults and of the part's offsets.
    pub seed: u64,
    /// Seed by which one gauge is drawn from everything that real ones do: late blocks, slow commits, resets that are
    /// lost, values that the gauge itself rewrites, and more. Without it the gauge is friendly; each behaviour is also a
    /// knob.
    pub envelope: Option<u64>,
}

impl fmt::Debug for Options {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { state, unseal_key, seed, envelope } = self;
        let key = unseal_key.map(|_| "hidden");
        let mut out = f.debug_struct("Options");
        out.field("state", state).field("unseal_key", &key).field("seed", seed).field("envelope", envelope);
        out.finish()
    }
}

/// The scheme by which a part is accessed: its registers, its buffer and its subcommands. Power, flash,
/// timing and time itself are the [`Device`]'s, which is passed to every method that needs it.
pub(super) trait Wire: Send {
    /// The address that is answered now, if any.
    fn address(&self, flash: &Flash) -> Option<u8>;
    /// How much longer the clock is held at an address, because the gauge has to wake up.
    fn wake(&mut self, _device: &Device) -> Duration {
        Duration::ZERO
    }
    /// Whether the command byte `register` is acknowledged.
    fn has(&self, register: u8) -> bool;
    /// Whether a message that began at a lower register may continue with `register`.
    fn extends(&self, register: u8) -> bool;
    /// Takes a data byte. Returns whether it is acknowledged.
    fn write(&mut self, device: &mut Device, register: u8, byte: u8) -> bool;
    /// The byte at `register`.
    fn read(&mut self, device: &Device, register: u8) -> u8;
    /// STOP.
    fn stop(&mut self) {}
    /// The printed firmware and hardware versions.
    fn versions(&mut self, flash: &Flash) -> [Option<u16>; 2];
    /// Whether the gauge gauges, so that it may rewrite its own values.
    fn gauges(&self) -> bool;

    /// Builds all RAM anew, after a reset or when power has come.
    fn reset(&mut self, device: &mut Device);
    /// Lets pass what depends on time. `settle` asks for a measurement at once.
    fn run(&mut self, device: &mut Device, settle: bool);
    /// Measures again, because a knob was turned.
    fn refresh(&mut self);
    fn model(&mut self) -> &mut dyn Model;
    fn level(&self) -> Level;
    /// Makes the board fit the calibration: Voltage() shows the pack's voltage as long as that does not change.
    fn fit_board(&mut self, flash: &Flash);
    /// Whether the voltage allows flash to be programmed.
    fn gate(&self, flash: &Flash) -> bool;

    /// What the `mode` knob shows while the gauge is on and not starting.
    fn mode(&self, flash: &Flash) -> &'static str;
    /// What a knob of this scheme shows.
    fn knob(&self, device: &Device, name: &str) -> Option<String>;
    fn set_knob(&mut self, device: &mut Device, name: &str, text: &str) -> Result<()>;
}
