//! The simulated gauges against the manuals: bytes in, bytes out. Nothing of the engine or of the tables takes part.

mod block;
mod driver;
mod mac;
mod ram;
