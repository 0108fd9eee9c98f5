// SPDX-License-Identifier: MIT

//! How long facts hold: whatever happens to the gauge begins the next epoch of what it may have changed.

use crate::epoch::Epoch;

/// While no other gauge has been connected.
pub(in crate::dataflash) enum Arrival {}

/// While nobody may have exchanged the pack without its being noticed.
pub(super) enum Pack {}

/// While its serial number may not have been written.
pub(super) enum Name {}

/// While no access may have changed the values that permit a write.
pub(super) enum Values {}

#[derive(Debug, Default)]
pub(super) struct Now {
    pub(super) arrival: Epoch<Arrival>,
    pub(super) pack: Epoch<Pack>,
    pub(super) name: Epoch<Name>,
    pub(super) values: Epoch<Values>,
}

impl Now {
    /// A gauge was connected, or has returned.
    pub(super) fn arrives(&mut self) {
        self.arrival.next();
        self.forget_name();
        self.forget_pack();
    }

    /// Its data memory is lost, or another pack may be there.
    pub(super) fn forget_pack(&mut self) {
        self.pack.next();
        self.forget_values();
    }

    /// An access has failed, or has changed what permits the next one.
    pub(super) fn forget_values(&mut self) {
        self.values.next();
    }

    /// Its serial number may have been written.
    pub(super) fn forget_name(&mut self) {
        self.name.next();
    }
}
