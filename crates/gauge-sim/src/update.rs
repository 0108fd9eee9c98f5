// SPDX-License-Identifier: MIT

//! CONFIG UPDATE (SLUUAC9A 2.4.3): the mode in which a gauge without flash takes new data memory. It begins some time
//! after the subcommand, ends some time after the way out, and ends by itself if forgotten.

use std::time::Duration;

const FORGOTTEN: Duration = Duration::from_secs(240);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Exit {
    /// SOFT_RESET and EXIT_RESIM: predicts anew.
    Anew,
    /// EXIT_CFGUPDATE.
    Plain,
    Forgotten,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Mode {
    #[default]
    Off,
    Entering(Duration),
    /// Until then at the latest.
    On(Duration),
    Leaving(Duration, Exit),
}

impl Mode {
    pub(super) fn shows(self) -> bool {
        matches!(self, Mode::On(_) | Mode::Leaving(..))
    }

    /// SET_CFGUPDATE. It has no effect in the mode, nor on the way in or out.
    pub(super) fn enter(&mut self, after: Duration, now: Duration) {
        if *self == Mode::Off {
            *self = Mode::Entering(now + after);
        }
    }

    /// A way out. Before the mode has begun it has no effect: the mode then begins later, and a host that did not wait
    /// finds it set.
    pub(super) fn leave(&mut self, exit: Exit, after: Duration, now: Duration) {
        if let Mode::On(_) = self {
            *self = Mode::Leaving(now + after, exit);
        }
    }

    /// Lets time pass up to `now`. Returns how and when the mode ended.
    pub(super) fn run(&mut self, now: Duration) -> Option<(Exit, Duration)> {
        if let Mode::Entering(at) = *self
            && now >= at
        {
            *self = Mode::On(at + FORGOTTEN);
        }
        let (exit, at) = match *self {
            Mode::On(at) => (Exit::Forgotten, at),
            Mode::Leaving(at, exit) => (exit, at),
            Mode::Off | Mode::Entering(_) => return None,
        };
        if now < at {
            return None;
        }
        *self = Mode::Off;
        Some((exit, at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    #[test]
    fn begins_late_and_ends_late() {
        let mut mode = Mode::Off;
        mode.enter(SECOND, Duration::ZERO);
        assert_eq!((mode.run(SECOND / 2), mode.shows()), (None, false));
        mode.leave(Exit::Plain, SECOND, SECOND / 2);
        assert_eq!((mode.run(SECOND), mode.shows()), (None, true));
        mode.leave(Exit::Plain, SECOND, SECOND * 2);
        assert_eq!((mode.run(SECOND * 2), mode.shows()), (None, true));
        assert_eq!(mode.run(SECOND * 3), Some((Exit::Plain, SECOND * 3)));
        assert!(!mode.shows());
    }

    #[test]
    fn ends_by_itself() {
        let mut mode = Mode::Off;
        mode.enter(SECOND, Duration::ZERO);
        assert_eq!(mode.run(SECOND * 240), None);
        assert_eq!(mode.run(SECOND * 241), Some((Exit::Forgotten, SECOND * 241)));
    }
}
