// SPDX-License-Identifier: MIT

//! What a failed access has left to do. It is tried again until the gauge answers, asked for or not.

use std::time::Duration;

use jiff::Timestamp;

use super::handle::Shared;
use ti_gauge::dataflash::Owed;

/// Pause before the first try, which doubles up to the longest.
const FIRST: Duration = Duration::from_secs(1);
const LONGEST: Duration = Duration::from_secs(30);

#[derive(Debug, Default)]
pub(super) struct Debt {
    next: Option<(Duration, Duration)>,
}

impl Debt {
    pub(super) fn due(&self) -> Option<Duration> {
        self.next.map(|(due, _)| due)
    }

    fn note(&mut self, owed: bool, now: Duration) {
        match self.next {
            _ if !owed => self.next = None,
            None => self.next = Some((now + FIRST, FIRST)),
            Some((due, pause)) if due <= now => {
                let pause = (pause * 2).min(LONGEST);
                self.next = Some((now + pause, pause));
            }
            Some(_) => {}
        }
    }

    /// Notes and publishes what is owed after an access. Returns whether that is something new.
    pub(super) fn note_owed(&mut self, owed: Option<Owed<'_>>, shared: &Shared) -> bool {
        let is_payable = owed.as_ref().is_some_and(|owed| !owed.needs_decision);
        self.note(is_payable, shared.clock.now());
        let text = owed.map_or(String::new(), |owed| owed.why.into_owned());
        let published = shared.published();
        if *published.owed == *text {
            return false;
        }
        // The failure that has left it is over when it is no longer owed.
        if text.is_empty() && published.failed.as_ref().is_some_and(|failed| failed.owed) {
            shared.clear_error();
        }
        // What was shown of an interrupted write before is out of date.
        shared.publish(|published| {
            (published.owed, published.settling) = (text.as_str().into(), "".into());
            published.owed_since = Timestamp::now();
        });
        !text.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::super::rig::{INTERVAL, Rig};
    use super::super::{Run, operations as op};
    use super::*;
    use crate::error::{Cause, Error, Result};
    use gauge_bus::clock::Clock;
    use ti_gauge::dataflash::Change;
    use ti_gauge::value::Value;

    /// Writes Cell Terminate Voltage.
    fn write(rig: &mut Rig) -> Result<()> {
        let subclass = &rig.handle.chip().subclasses[rig.index(80)];
        let parameter = subclass.parameter(53).expect("a parameter of the table");
        let change = Change::of_value(rig.handle.chip(), (subclass, parameter), &Value::Int(3100), false)
            .expect("it fits");
        rig.ask(&op::WRITE, vec![change])
    }

    /// A gauge that falls silent for a minute when it is to be sealed after a write.
    fn left_open() -> Rig {
        let mut plain = Rig::new(Run::default());
        plain.owner.open().expect("it answers");
        plain.sim.keep_log(true);
        write(&mut plain).expect("no fault");
        let seal = plain.sim.log().iter().position(|record| record.write == [0x00, 0x20, 0x00]);
        let mut rig = Rig::open();
        let fault = format!("silence {} 60000", seal.expect("it is sealed") + 1);
        rig.sim.set("fault", &fault).expect("a fault");
        let error = write(&mut rig).expect_err("it is not sealed");
        assert!(matches!(error.cause(), Cause::StateUnknown), "{error}");
        rig
    }

    #[test]
    fn what_is_owed_stays_published_while_polls_fail_until_it_is_paid() {
        let mut rig = left_open();
        let owed = rig.handle.published().owed.to_string();
        assert!(owed.contains("restoring the sealed state failed"), "{owed}");
        assert_eq!(rig.sim.get("seal").as_deref(), Some("unsealed"));
        for _ in 0..2 {
            rig.owner.poll_on_time();
            rig.clock.sleep(Duration::from_secs(1));
            let published = rig.handle.published();
            // A failed poll is less important than the write that has left this.
            assert!(*published.owed == *owed && published.last_error.contains(&owed), "{owed}");
        }
        // Nobody asks for anything.
        let (mut pays, begun) = (0, rig.clock.now());
        while let Some(due) = rig.owner.access.next_payment() {
            assert!(!rig.handle.published().owed.is_empty());
            rig.clock.sleep(due.saturating_sub(rig.clock.now()));
            rig.owner.access.pay();
            pays += 1;
        }
        assert!((2..10).contains(&pays) && rig.clock.now() - begun < Duration::from_secs(100), "{pays}");
        assert_eq!(*rig.handle.published().owed, *"");
        assert_eq!(*rig.handle.published().last_error, *"", "the write is complete");
        assert_eq!(rig.sim.get("seal").as_deref(), Some("sealed"));
        rig.clock.sleep(INTERVAL);
        rig.owner.poll_on_time();
        assert_eq!(*rig.handle.published().owed, *"");
    }

    #[test]
    fn a_refusal_because_of_what_is_owed_ends_with_it_and_other_failures_stay() {
        let mut rig = left_open();
        let refused = write(&mut rig).expect_err("it is still silent");
        assert!(refused.is_owed(), "{refused}");
        assert_eq!(*rig.handle.published().last_error, *refused.to_string());
        rig.clock.sleep(Duration::from_secs(60));
        rig.owner.access.pay();
        assert_eq!(*rig.handle.published().last_error, *"");

        let mut rig = left_open();
        let owed = rig.handle.published().owed.clone();
        // It tells what is owed, and is about something else.
        let error = Error::new("line 1", Cause::Invalid, owed.to_string());
        rig.handle.report(crate::Attempt::STAGE, &error);
        rig.clock.sleep(Duration::from_secs(60));
        rig.owner.access.pay();
        assert_eq!(*rig.handle.published().owed, *"");
        assert_eq!(*rig.handle.published().last_error, *error.to_string());
    }

    #[test]
    fn regression_an_owner_that_ended_sent_no_seal_and_said_nothing() {
        let mut rig = left_open();
        let error = rig.ask(&op::END, ()).expect_err("it is silent for a minute");
        assert!(error.to_string().contains("still owed"), "{error}");
        assert_eq!(rig.sim.get("seal").as_deref(), Some("unsealed"));
        rig.clock.sleep(Duration::from_secs(60));
        rig.ask(&op::END, ()).expect("it answers");
        assert_eq!(rig.sim.get("seal").as_deref(), Some("sealed"));
        assert_eq!(*rig.handle.published().owed, *"");
    }

    #[test]
    fn the_next_request_pays_what_is_owed_first() {
        let mut rig = left_open();
        write(&mut rig).expect_err("it is still silent");
        assert!(!rig.handle.published().owed.is_empty());
        rig.clock.sleep(Duration::from_secs(60));
        write(&mut rig).expect("it answers");
        assert_eq!(*rig.handle.published().owed, *"");
        assert_eq!(rig.owner.access.next_payment(), None);
        assert_eq!(rig.sim.get("seal").as_deref(), Some("sealed"));
    }

    /// IT_ENABLE changes Update Status for good, and whose it is was not known.
    #[test]
    fn regression_no_subcommand_is_sent_while_something_is_owed() {
        let mut rig = left_open();
        rig.sim.keep_log(true);
        for code in [0x0021, 0x0008] {
            let error = rig.ask(&op::CONTROL, code).expect_err("it is silent");
            assert_eq!(error.errno(), nix::errno::Errno::EBUSY as i32, "{error}");
            assert!(error.to_string().contains("no subcommand is sent"), "{error}");
        }
        let sent = |rig: &Rig, code: u16| {
            let message = [&[0x00], &code.to_le_bytes()[..]].concat();
            rig.sim.log().iter().any(|record| record.write == message)
        };
        assert!(!sent(&rig, 0x0021) && !sent(&rig, 0x0008));
        // It is paid first, if that is possible.
        rig.clock.sleep(Duration::from_secs(60));
        rig.ask(&op::CONTROL, 0x0008).expect("it answers");
        assert!(sent(&rig, 0x0008) && rig.handle.published().owed.is_empty());
        assert_eq!(rig.sim.get("seal").as_deref(), Some("sealed"));
    }

    #[test]
    fn what_is_owed_is_tried_again_after_growing_pauses_until_it_is_paid() {
        let mut debt = Debt::default();
        let (mut now, mut pauses) = (Duration::ZERO, Vec::new());
        debt.note(true, now);
        for _ in 0..7 {
            let due = debt.due().expect("it is owed");
            pauses.push((due - now).as_secs());
            // An access in between changes nothing.
            debt.note(true, due - Duration::from_millis(1));
            now = due;
            debt.note(true, now);
        }
        assert_eq!(pauses, [1, 2, 4, 8, 16, 30, 30]);
        debt.note(false, now);
        assert_eq!(debt.due(), None);
    }
}
