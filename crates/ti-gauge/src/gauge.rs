// SPDX-License-Identifier: MIT

//! A gauge on a bus, driven by its chip's table: registers, Control() subcommands, seal states.
//!
//! Its rooms, each above the next: `access` (keys), `seal` (looks), `control` (registers, subcommands), `dialect` (what
//! these are on the wire), `wire` (transfers, retries, time); then `packets`, `presence`, `effects`, `statistics`, `state`.

use std::sync::Arc;
use std::time::Duration;

pub use crate::chip::Answers;
use crate::chip::{Chip, Register, Tier};
use crate::error::{Cause, Error, Result, Step};
use crate::keys::Keys;
use gauge_bus::clock::Clock;
use gauge_bus::{Bus, Reach};

mod access;
mod asked;
mod control;
pub(crate) mod dialect;
mod effects;
mod packets;
mod presence;
mod seal;
mod state;
mod statistics;
mod wire;

use access::Access;
pub use access::DEFAULT_FULL_ACCESS;
pub use asked::Asked;
use dialect::Dialect;
pub use dialect::{reads, replay};
pub use effects::Effects;
use effects::Watch;
use packets::Packets;
pub use packets::Pec;
pub(crate) use presence::Moment;
use presence::Presence;
use seal::Looks;
pub use state::{ALONG, Seal};
pub(crate) use state::{Answer, Look};
pub use statistics::{Phase, Progress, Statistics};
pub(crate) use wire::Landmark;
use wire::Wire;

const CONTROL_STATUS: u16 = 0x0000;
const DEVICE_TYPE: u16 = 0x0001;
const FW_VERSION: u16 = 0x0002;
const TRIES: u32 = 4;
/// Time between two looks that must agree: no disturbance makes both wrong in the same way.
pub(crate) const APART: Duration = Duration::from_millis(5);

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
            wire: Wire::new(bus, Packets::at(chip.address)),
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

    /// The gauge at an address, where that is not its part's.
    #[must_use]
    pub fn at(mut self, address: u8) -> Self {
        self.wire.at(address);
        self
    }

    /// The gauge of TI's in a Smart Battery, which its user lets be asked the questions of its table.
    #[must_use]
    pub fn asked(mut self) -> Self {
        self.dialect = dialect::asking(self.chip);
        self
    }

    /// Whether what answers is of the part's kind, by reads alone; `None` where only its values show it.
    pub(crate) fn is_its_kind(&mut self) -> Result<Option<bool>> {
        self.dialect.is_its_kind(self)
    }

    /// Reads the rows of the wanted tiers.
    pub(crate) fn read_rows(
        &mut self,
        rows: &'static [Register],
        wanted: &dyn Fn(Tier) -> bool,
        take: &mut dyn FnMut(Answer<'_>),
    ) -> Result<()> {
        self.dialect.read(self, (rows, wanted), take)
    }

    /// Forgets all that is known of the gauge, after an access that was not brought to its end.
    pub fn start_over(&mut self) {
        self.forget_refusal();
        self.limit_until(None);
        self.looks.start_over();
        self.wire.packets.forget();
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
