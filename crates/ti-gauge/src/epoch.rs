// SPDX-License-Identifier: MIT

//! Facts that hold for a time only: while the pack is the one, until data flash is written. A [`Fact`] is kept with the
//! [`Epoch`] in which it was learned and cannot be read in another one. To forget is to begin the next epoch.
//!
//! ```
//! use ti_gauge::epoch::{Epoch, Fact};
//!
//! /// While nobody exchanges the pack.
//! enum Pack {}
//!
//! let mut now = Epoch::<Pack>::default();
//! let mut cycles = Fact::default();
//! cycles.learn(now, 214);
//! assert_eq!(cycles.get(now), Some(&214));
//! now.next();
//! assert_eq!(cycles.get(now), None);
//! ```
//!
//! An epoch of one kind is not taken for one of another:
//!
//! ```compile_fail
//! # use ti_gauge::epoch::{Epoch, Fact};
//! # enum Pack {}
//! # enum Poll {}
//! # let mut cycles: Fact<u16, Pack> = Fact::default();
//! let poll = Epoch::<Poll>::default();
//! cycles.learn(poll, 214);
//! ```

use std::fmt;
use std::marker::PhantomData;

/// One of successive epochs. `Of` says what lasts as long.
pub struct Epoch<Of> {
    number: u64,
    of: PhantomData<fn() -> Of>,
}

impl<Of> Epoch<Of> {
    /// The epoch of that number, from numbers that are drawn instead of counted.
    pub fn numbered(number: u64) -> Self {
        Self { number, of: PhantomData }
    }

    /// Begins the next epoch: what was learned before no longer counts.
    pub fn next(&mut self) {
        self.number += 1;
    }

    /// Its number, to be named elsewhere.
    pub fn number(self) -> u64 {
        self.number
    }
}

impl<Of> Default for Epoch<Of> {
    fn default() -> Self {
        Self { number: 0, of: PhantomData }
    }
}

impl<Of> Clone for Epoch<Of> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<Of> Copy for Epoch<Of> {}

impl<Of> PartialEq for Epoch<Of> {
    fn eq(&self, other: &Self) -> bool {
        self.number == other.number
    }
}

impl<Of> Eq for Epoch<Of> {}

impl<Of> fmt::Debug for Epoch<Of> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Epoch({})", self.number)
    }
}

/// A fact that was learned in an epoch.
pub struct Fact<T, Of>(Option<(Epoch<Of>, T)>);

impl<T, Of> Fact<T, Of> {
    /// Keeps a fact learned now.
    pub fn learn(&mut self, now: Epoch<Of>, value: T) {
        self.0 = Some((now, value));
    }

    /// The fact, if it was learned in this epoch.
    pub fn get(&self, now: Epoch<Of>) -> Option<&T> {
        self.0.as_ref().filter(|(then, _)| *then == now).map(|(_, value)| value)
    }

    /// Whether the fact is known in this epoch.
    pub fn is_known(&self, now: Epoch<Of>) -> bool {
        self.get(now).is_some()
    }
}

impl<T: Default, Of> Fact<T, Of> {
    /// The fact, to be extended. In another epoch it starts empty.
    pub fn in_epoch(&mut self, now: Epoch<Of>) -> &mut T {
        if !self.is_known(now) {
            self.learn(now, T::default());
        }
        match &mut self.0 {
            Some((_, value)) => value,
            None => unreachable!("it was just learned"),
        }
    }
}

impl<T: Clone, Of> Clone for Fact<T, Of> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<T, Of> Default for Fact<T, Of> {
    fn default() -> Self {
        Self(None)
    }
}

impl<T: fmt::Debug, Of> fmt::Debug for Fact<T, Of> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Fact").field(&self.0).finish()
    }
}
