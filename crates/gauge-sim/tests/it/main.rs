//! The simulated gauges, compared byte by byte with the manuals, without the engine and the tables.

mod block;
mod driver;
mod envelope;
mod mac;
mod ram;
mod register;
