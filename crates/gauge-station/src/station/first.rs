// SPDX-License-Identifier: MIT

//! The first pack of a run, which a person may have to confirm before the next one.

use std::sync::{Mutex, MutexGuard, PoisonError};

#[derive(Debug, Default)]
enum State {
    #[default]
    None,
    UnderWay,
    Confirmed,
}

/// The first pack of a run, in any slot.
#[derive(Debug, Default)]
pub(super) struct First(Mutex<State>);

impl First {
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

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
