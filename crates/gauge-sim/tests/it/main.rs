//! The simulated gauges, compared byte by byte with the manuals, without the engine and the tables.

mod block;
mod driver;
mod mac;
mod ram;
