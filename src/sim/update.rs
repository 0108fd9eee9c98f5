//! CONFIG UPDATE (SLUUAC9A 2.4.3): the mode in which a gauge without flash takes new data memory. It
//! comes some time after it was asked for, goes some time after it was told to, and does not stay.

use std::time::Duration;

/// A host that forgets about the mode is relieved of it.
const FORGOTTEN: Duration = Duration::from_secs(240);

/// What is particular to a gauge whose data memory is RAM, filled from ROM when power comes.
#[derive(Debug)]
pub(super) struct Ram {
    /// From SET_CFGUPDATE to the mode, and from the way out to its end.
    pub(super) enter: Duration,
    pub(super) leave: Duration,
    /// Area and offset of Update Status, whose bit 7 seals.
    pub(super) update_status: (u16, usize),
    /// The byte whose bit 7 is the sign of CC Gain, where parts differ in what their ROM has there.
    pub(super) gain_sign: Option<(u16, usize)>,
}

/// How the mode ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Exit {
    /// SOFT_RESET and EXIT_RESIM: the gauge predicts anew.
    Anew,
    /// EXIT_CFGUPDATE.
    Plain,
    /// By itself.
    Forgotten,
}

/// Where the gauge stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mode {
    Off,
    /// Asked for; the mode begins then.
    Entering(Duration),
    /// In it, until then at the latest.
    On(Duration),
    /// Told to leave; the mode ends then.
    Leaving(Duration, Exit),
}

impl Mode {
    /// Flags() `[CFGUPMODE]`.
    pub(super) fn shows(self) -> bool {
        matches!(self, Mode::On(_) | Mode::Leaving(..))
    }

    /// SET_CFGUPDATE. In the mode, and on the way in or out, it changes nothing.
    pub(super) fn enter(&mut self, after: Duration, now: Duration) {
        if *self == Mode::Off {
            *self = Mode::Entering(now + after);
        }
    }

    /// One of the ways out. Before the mode has come there is nothing to leave: whoever does not wait for
    /// it finds it set later.
    pub(super) fn leave(&mut self, exit: Exit, after: Duration, now: Duration) {
        if let Mode::On(_) = self {
            *self = Mode::Leaving(now + after, exit);
        }
    }

    /// Lets time pass up to `now`; tells how and when the mode ended.
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
    fn comes_late_and_goes_late() {
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
    fn does_not_stay() {
        let mut mode = Mode::Off;
        mode.enter(SECOND, Duration::ZERO);
        assert_eq!(mode.run(SECOND * 240), None);
        assert_eq!(mode.run(SECOND * 241), Some((Exit::Forgotten, SECOND * 241)));
    }
}
