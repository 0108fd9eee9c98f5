// SPDX-License-Identifier: MIT

//! The keys of a gauge, and what can be told of their words.

use crate::chip::KeyOrder;
use crate::dataflash::keyrow::stored;
use crate::gauge::{Gauge, Seal};
use crate::keys::{Name, Secret};

/// Words below this are, or may become, subcommands of any part.
pub(super) const SUBCOMMANDS: u16 = 0x0100;
pub(super) const ERASED: u16 = 0xffff;
pub(super) const LENGTH_OF_KEY: usize = 16;

pub(super) const SEALS: [Name; 2] = [Name::Unseal, Name::FullAccess];

#[derive(Clone)]
pub(super) struct Ring {
    pub(super) unseal: Secret,
    pub(super) full_access: Secret,
}

impl Ring {
    /// The keys in their order, where each leads, and whether a gauge in that state needs it no more.
    pub(super) fn rungs(&self, from: Seal) -> [(Name, &Secret, Seal, bool); 2] {
        [
            (Name::Unseal, &self.unseal, Seal::Unsealed, from != Seal::Sealed),
            (Name::FullAccess, &self.full_access, Seal::FullAccess, from == Seal::FullAccess),
        ]
    }

    pub(super) fn get(&self, name: Name) -> &Secret {
        if name == Name::Unseal { &self.unseal } else { &self.full_access }
    }

    pub(super) fn set(&mut self, name: Name, key: &Secret) {
        let place = if name == Name::Unseal { &mut self.unseal } else { &mut self.full_access };
        place.clone_from(key);
    }
}

/// A key in the other orders in which a gauge might keep it.
pub(super) fn turned(key: &Secret) -> [Secret; 3] {
    let [a, b, c, d] = [0, 1, 2, 3].map(|at| key.bytes()[at]);
    [[c, d, a, b], [b, a, d, c], [d, c, b, a]].map(|bytes| Secret::of_bytes(&bytes))
}

pub(super) fn shows_order(key: &Secret) -> bool {
    !turned(key).contains(key)
}

/// Whether the words of a key may be sent although the gauge may not have it.
pub(super) fn is_harmless(gauge: &Gauge, key: &Secret) -> bool {
    let is_command = |word: &u16| {
        *word < SUBCOMMANDS || gauge.chip.subcommand(*word).is_some() || gauge.chip.flat.contains(word)
    };
    !key.words().iter().any(is_command)
}

pub(super) fn unstored(bytes: &[u8], order: KeyOrder) -> Secret {
    Secret::of_bytes(&stored(&Secret::of_bytes(bytes), order))
}
