//! gaugefs mounts TI fuel gauges as a Linux power_supply tree.

pub use gauge_bus as bus;
pub use gauge_bus::clock;
pub use ti_gauge::{
    authentication, chip, codec, dataflash, gauge, image, journal, keys, probe, registers, text, value,
};

pub mod cli;
mod config;
pub mod daemon;
mod errno;
pub mod error;
pub mod fs;
pub mod fuse;
pub mod key_file;
pub mod lock;
mod mounted;
pub mod owner;
#[cfg(feature = "screen")]
mod screen;
