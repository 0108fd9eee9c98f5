// SPDX-License-Identifier: MIT

//! A gauge on a bus, driven by its chip's table: registers, Control() subcommands, seal states.
//!
//! Its rooms, each above the next: `access` (keys), `seal` (looks), `control` (registers, subcommands), `dialect` (what
//! these are on the wire), `wire` (transfers, retries, time); then `presence`, `effects`, `statistics`, `state`.

use std::sync::Arc;

pub use crate::chip::Answers;
use crate::chip::Chip;
use crate::error::{Cause, Error, Result, Step};
use crate::keys::Keys;
use gauge_bus::clock::Clock;
use gauge_bus::{Bus, Reach};

mod access;
mod control;
pub(crate) mod dialect;
mod effects;
mod presence;
mod seal;
mod state;
mod statistics;
mod wire;

use access::Access;
pub use access::DEFAULT_FULL_ACCESS;
use dialect::Dialect;
pub use dialect::replay;
pub use effects::Effects;
use effects::Watch;
pub(crate) use presence::Moment;
use presence::Presence;
use seal::Looks;
pub(crate) use seal::SEAL_LAG;
pub(crate) use state::Look;
pub use state::{ALONG, Seal};
pub use statistics::{Phase, Progress, Statistics};
pub(crate) use wire::Landmark;
use wire::Wire;

const CONTROL_STATUS: u16 = 0x0000;
const DEVICE_TYPE: u16 = 0x0001;
const FW_VERSION: u16 = 0x0002;
const RESET: u16 = 0x0041;
const TRIES: u32 = 4;

/// One gauge at one address.
pub struct Gauge {
    /// Its table.
    pub chip: &'static Chip,
    /// Counters of its traffic.
    pub statistics: Arc<Statistics>,
    /// Clock for waiting and for measuring time.
    pub clock: Arc<dyn Clock>,
    /// Where its keys are to be put, for messages.
    pub key_file: String,
    dialect: &'static dyn Dialect,
    presence: Presence,
    effects: Watch,
    wire: Wire,
    looks: Looks,
    access: Access,
}

impl Gauge {
    /// A gauge with a chip's table on a bus. Nothing is sent yet.
    pub fn new(chip: &'static Chip, bus: Box<dyn Bus>, clock: Arc<dyn Clock>, keys: Keys) -> Self {
        let statistics = Arc::default();
        Self {
            chip,
            statistics,
            clock,
            key_file: "a file named with --key-file".into(),
            dialect: dialect::of(chip),
            presence: Presence::default(),
            effects: Watch::default(),
            wire: Wire::new(bus),
            looks: Looks::new(),
            access: Access::new(keys),
        }
    }

    /// The gauge within a reach, where it takes less than its bus carries.
    #[must_use]
    pub fn within(mut self, reach: Reach) -> Self {
        self.wire.within(reach);
        self
    }

    /// Forgets all that is known of the gauge, after an access that was not brought to its end.
    pub fn start_over(&mut self) {
        self.forget_refusal();
        self.limit_until(None);
        self.looks.start_over();
        self.hide_nothing();
        self.statistics.progress.end();
    }
}

/// What two looks in a row agree on, because I2C has no error detection. `subject` is what is looked at.
///
/// # Errors
/// [`Cause::Protocol`] if no two agree, and any error of a look.
pub fn agreed<T: PartialEq>(subject: &str, mut look: impl FnMut() -> Result<T>) -> Result<T> {
    let mut last = look()?;
    for _ in 0..TRIES {
        let next = look()?;
        if next == last {
            return Ok(next);
        }
        last = next;
    }
    let why = "it reads differently each time: check the bus";
    Err(Error::new(subject, Cause::Protocol, why).at(Step::Read))
}
