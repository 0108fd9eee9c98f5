//! What was attempted when something failed: it decides which failure `gauge/last_error` shows, and which success
//! clears it.

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
    /// To stage lines of `df/transaction`.
    Stage,
    /// To change the seal state.
    Seal,
    /// To send a subcommand.
    Control,
    /// To change a key.
    Key,
    /// To have a challenge answered.
    Authenticate,
    /// To change the time between polls.
    Interval,
    /// To write the configuration of `--restore`.
    Restore,
    /// To settle an interrupted write.
    Settle,
    /// To calibrate it.
    Calibrate,
    /// To make a report.
    Report,
    /// To turn a knob of a simulated gauge.
    Knob(&'static str),
    /// Something that no later success shows to be over.
    Other,
}

impl Attempt {
    /// While something is owed, a failure is not replaced by one of less importance.
    pub(super) fn importance(&self) -> u8 {
        match self {
            Attempt::Settle => 2,
            Attempt::Write(_)
            | Attempt::Stage
            | Attempt::Seal
            | Attempt::Control
            | Attempt::Key
            | Attempt::Authenticate
            | Attempt::Interval
            | Attempt::Restore
            | Attempt::Calibrate => 1,
            Attempt::Poll | Attempt::Read(_) | Attempt::Report | Attempt::Knob(_) | Attempt::Other => 0,
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
        assert!(!Attempt::Other.includes(&Attempt::Other) && !Attempt::Seal.includes(&Attempt::Key));
    }
}
