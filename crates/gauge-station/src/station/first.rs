// SPDX-License-Identifier: MIT

//! The first pack of a run, which somebody may have to confirm before there is another one.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// How far it is.
#[derive(Debug, Default)]
enum State {
    /// None was begun.
    #[default]
    None,
    /// It is being programmed, or nobody has confirmed it yet.
    UnderWay,
    Confirmed,
}

/// The first pack of a run, whichever slot it comes to.
#[derive(Debug, Default)]
pub(super) struct First(Mutex<State>);

impl First {
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether the caller may begin a pack.
    pub(super) fn may_begin(&self) -> bool {
        let mut state = self.state();
        match *state {
            State::None => {
                *state = State::UnderWay;
                true
            }
            State::UnderWay => false,
            State::Confirmed => true,
        }
    }

    /// The next pack is the first one.
    pub(super) fn begin_again(&self) {
        *self.state() = State::None;
    }

    pub(super) fn confirm(&self) {
        *self.state() = State::Confirmed;
    }

    pub(super) fn is_done(&self) -> bool {
        matches!(*self.state(), State::Confirmed)
    }
}
