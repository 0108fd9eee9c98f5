// SPDX-License-Identifier: MIT

//! Attempts: what failed decides which failure `gauge/last_error` shows, and which success clears it.

use ti_gauge::dataflash::Place;

/// Something that may fail and succeed later.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Attempt {
    /// To reach, identify and poll the gauge.
    Poll,
    /// To read subclasses, by their indices in the table.
    Read(Vec<usize>),
    /// To write to these places.
    Write(Vec<Place>),
    /// To carry out an operation of that name.
    Operation(&'static str, Importance),
    /// To turn a knob of a simulated gauge.
    Knob(&'static str),
    /// Something that no later success shows to be over.
    Other,
}

/// How important a failure is. While something is owed, it is not replaced by a less important one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Importance {
    /// Something was not read.
    Reading,
    /// Something was not changed.
    Change,
    /// An interrupted write is not settled.
    Owed,
}

impl Attempt {
    /// To stage lines of `df/transaction`.
    pub const STAGE: Self = Self::Operation("stage", Importance::Change);
    /// To settle what an access has left.
    pub(super) const SETTLE: Self = Self::Operation("settle", Importance::Owed);

    /// To calibrate the gauge.
    pub(super) const CALIBRATE: Self = Self::Operation("calibrate", Importance::Change);

    /// To write the profile.
    pub(super) const RESTORE: Self = Self::Operation("restore", Importance::Change);

    /// To save what the gauge has learned.
    pub(super) const LEARNED: Self = Self::Operation("save what was learned", Importance::Reading);

    pub(super) fn importance(&self) -> Importance {
        match self {
            Attempt::Operation(_, importance) => *importance,
            Attempt::Write(_) => Importance::Change,
            Attempt::Poll | Attempt::Read(_) | Attempt::Knob(_) | Attempt::Other => Importance::Reading,
        }
    }

    /// Whether the success of this one shows that an earlier failure is over.
    pub(super) fn includes(&self, failed: &Attempt) -> bool {
        match (self, failed) {
            (Attempt::Read(done), Attempt::Read(failed)) => failed.iter().all(|one| done.contains(one)),
            (Attempt::Write(done), Attempt::Write(failed)) => failed.iter().all(|one| done.contains(one)),
            (Attempt::Other, _) => false,
            (done, failed) => done == failed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_success_of_the_same_attempt_ends_a_failure() {
        let write =
            |offsets: &[u16]| Attempt::Write(offsets.iter().map(|&at| Place::from((48, at))).collect());
        assert!(write(&[11]).includes(&write(&[11])) && write(&[4, 11]).includes(&write(&[11])));
        assert!(!write(&[11]).includes(&write(&[4, 11])) && !write(&[4]).includes(&write(&[11])));
        assert!(Attempt::Read(vec![1, 2]).includes(&Attempt::Read(vec![2])));
        assert!(!Attempt::Read(vec![1]).includes(&Attempt::Read(vec![1, 2])));
        assert!(Attempt::Poll.includes(&Attempt::Poll) && !Attempt::Poll.includes(&Attempt::Read(vec![])));
        assert!(!Attempt::Other.includes(&Attempt::Other) && !Attempt::RESTORE.includes(&Attempt::STAGE));
    }
}
