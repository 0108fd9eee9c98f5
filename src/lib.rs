//! gaugefs mounts TI fuel gauges as a Linux power_supply tree.

pub mod authentication;
pub mod bus;
pub mod chip;
pub mod cli;
pub mod clock;
pub mod codec;
mod config;
pub mod daemon;
pub mod dataflash;
pub mod error;
pub mod fs;
pub mod fuse;
pub mod gauge;
pub mod image;
pub mod journal;
pub mod keys;
pub mod lock;
pub mod poll;
pub mod probe;
pub mod saved;
#[cfg(feature = "screen")]
mod screen;
pub mod sim;
pub mod text;
pub mod value;
