// SPDX-License-Identifier: MIT

//! Epochs of a gauge: for how long a fact about it holds.

use std::hash::{BuildHasher, Hasher, RandomState};

use ti_gauge::epoch::Epoch;

/// While it answers, and nobody may have exchanged it.
pub enum Presence {}

/// Begins a presence. Its number, of 63 bits, is drawn: programs keep it, and no other daemon and no other pack may have it.
pub(super) fn presence() -> Epoch<Presence> {
    Epoch::numbered(RandomState::new().build_hasher().finish() >> 1)
}

/// While nothing may have changed what data flash holds, but for what the gauge rewrites itself.
pub(super) enum Content {}
