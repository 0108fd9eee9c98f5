// SPDX-License-Identifier: MIT

//! Polls: by the schedule, or because somebody has asked for one.

use std::sync::Arc;
use std::time::Duration;

use super::readings::{had_battery, has_battery};
use super::{Attempt, Owner, Snapshot, amiss, now};
use crate::error::{Cause, Error, Result};
use gauge_bus::BusError;
use ti_gauge::gauge::Statistics;
use ti_gauge::registers::Registers;

impl Owner {
    pub(super) fn poll_on_time(&mut self) {
        let was_gone = self.access.schedule().is_gone();
        let is_new = Statistics::read(&self.shared().statistics.polls) == 0;
        match self.update() {
            Ok(()) if is_new => {
                log::info!("{}: the gauge answers", self.shared().name());
                self.after_first_poll();
            }
            Ok(()) => {
                if was_gone {
                    log::info!("{}: the gauge is back", self.shared().name());
                }
                self.memory.keep_configured(&mut self.access);
                self.read_if_open();
            }
            Err(error) => self.poll_failed(&error),
        }
    }

    /// Polls, after identifying the gauge anew if another one may be in its place.
    pub(super) fn update(&mut self) -> Result<()> {
        if self.access.schedule().is_gone() || self.access.doubts() {
            self.arrive()?;
        }
        self.poll()
    }

    /// Counts and reports a failed poll. After the third in a row the gauge is gone.
    pub(super) fn poll_failed(&mut self, error: &Error) {
        Statistics::count(&self.shared().statistics.failed_polls);
        // Polls of a gauge that is gone are expected to fail: they are not logged.
        let was_gone = self.access.schedule().is_gone();
        let now = self.access.now();
        match error.cause() {
            // Nothing can reach it.
            Cause::Bus(BusError::Hung(_)) => self.access.set_gone(),
            _ => self.access.schedule().failed(now),
        }
        // A pack may be exchanged while it does not answer.
        self.shared().forget_dataflash();
        self.access.suspect();
        self.memory.doubt();
        if was_gone {
            return;
        }
        self.shared().publish(|published| published.is_failing = true);
        self.shared().report(Attempt::Poll, error);
        if self.access.schedule().is_gone() {
            log::warn!("{}: the gauge is gone", self.shared().name());
            self.shared().publish(|published| {
                published.snapshot = None;
                published.presence = now::presence();
            });
        }
    }

    /// Notes the failure of a poll that somebody has asked for: it is always recorded, also that of a gauge that is gone.
    pub(super) fn asked_poll_failed(&mut self, error: &Error) {
        let was_gone = self.access.schedule().is_gone();
        self.poll_failed(error);
        if was_gone {
            self.shared().record(Attempt::Poll, error);
        }
    }

    pub(super) fn poll(&mut self) -> Result<()> {
        let watched = self.memory.watches_copies(self.access.chip());
        let (taken, registers) = self.readings.read(&mut self.access, watched)?;
        let number = self.access.schedule().succeeded(taken);
        Statistics::count(&self.shared().statistics.polls);
        self.access.note_poll(&registers);
        self.note_battery(&registers);
        self.readings.note_measurement(&mut self.access, &registers);
        let unmeasured = self.readings.unmeasured();
        let can_write = self.access.gauge().check_writes();
        amiss::tell(self.shared(), &registers, unmeasured, self.memory.is_managed(), can_write);
        self.publish_poll(taken, number, registers);
        Ok(())
    }

    /// Notes that a battery was taken out or inserted, or that the gauge seemed to be away.
    fn note_battery(&mut self, registers: &Registers) {
        let (had, has) = (had_battery(self.shared()), has_battery(self.access.chip(), registers));
        match had {
            Some(had) if had != has => self.memory.battery_has_changed(&mut self.access, has),
            Some(true) if !self.shared().is_present() => self.shared().begin_presence(),
            _ => {}
        }
    }

    fn publish_poll(&mut self, taken: Duration, number: u64, registers: Registers) {
        let is_valid = self.readings.unmeasured() == 0;
        let is_configured = self.memory.is_configured(self.access.shared(), &registers);
        let control_status = self.access.control_status();
        let primary = self.access.chip().condition.primary.as_ref();
        let is_asked = self.shared().is_asked();
        let has_current = primary.is_none_or(|primary| !is_asked || control_status & primary.active != 0);
        let history = self.readings.note_history(&self.access, taken, &registers);
        let snapshot = Snapshot {
            taken,
            number,
            registers,
            control_status,
            is_valid,
            is_configured,
            history,
            has_current,
        };
        self.shared().publish(|published| {
            (published.snapshot, published.is_failing) = (Some(Arc::new(snapshot)), false);
        });
        self.shared().succeeded(&Attempt::Poll);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

    use nix::errno::Errno;

    use super::super::rig::{INTERVAL, Rig};
    use super::super::schedule::{FAILURES, RETRY, SHORTEST};
    use super::super::{Run, operations as op};
    use super::*;
    use gauge_bus::Bus;
    use gauge_bus::clock::Clock;
    use gauge_sim::SimBus;
    use ti_gauge::dataflash::Change;
    use ti_gauge::value::Value;

    #[test]
    fn polls_of_many_gauges_are_spread_over_the_interval() {
        for at in 0..4 {
            let phase = INTERVAL * at / 4;
            let mut owner = Rig::new(Run { phase, ..Run::default() }).direct.owner;
            owner.open().expect("it answers");
            // The second poll comes soon, as with a single gauge; the third one comes early by the phase.
            let pauses = [(); 4].map(|()| {
                let pause = owner.access.schedule().pause(INTERVAL);
                owner.poll_on_time();
                pause
            });
            assert_eq!(pauses, [SHORTEST, INTERVAL - phase, INTERVAL, INTERVAL]);
        }
    }

    #[test]
    fn a_failed_poll_is_repeated_soon_and_the_third_makes_the_gauge_gone() {
        let mut rig = Rig::open();
        let good = rig.sim.get("power").expect("a knob");
        rig.sim.set("power", "off").expect("a knob");
        let mut fail = || {
            rig.owner.poll_on_time();
            (rig.owner.access.schedule().pause(INTERVAL), rig.handle.published().snapshot.is_some())
        };
        assert_eq!([fail(), fail(), fail()], [(RETRY, true), (INTERVAL, true), (INTERVAL, false)]);
        assert!(rig.handle.published().last_error.contains("not acknowledged"));

        rig.sim.set("power", &good).expect("a knob");
        rig.clock.sleep(INTERVAL);
        rig.owner.poll_on_time();
        assert!(rig.handle.published().snapshot.is_some(), "the gauge is back");
    }

    #[test]
    fn regression_a_refresh_of_a_gauge_that_is_gone_left_no_reason() {
        let mut rig = Rig::open();
        rig.sim.set("power", "off").expect("a knob");
        for _ in 0..FAILURES {
            rig.poll_after(INTERVAL);
        }
        for operation in [&op::REFRESH, &op::REPORT] {
            rig.owner.access.shared().clear_error();
            rig.poll_after(INTERVAL);
            assert_eq!(*rig.handle.published().last_error, *"", "nobody has asked for this poll");
            let error = rig.ask(operation, ()).expect_err("it is gone");
            assert_eq!(*rig.handle.published().last_error, *error.to_string());
        }
    }

    const SHORT: Duration = Duration::from_millis(500);

    /// A gauge that is polled twice a second.
    fn polled_often() -> Rig {
        let mut rig = Rig::open();
        rig.ask(&op::POLL_INTERVAL, SHORT).expect("it is set");
        rig.poll_after(Duration::from_secs(1));
        rig
    }

    /// Another pack in that gap got what was staged for the one before.
    #[test]
    fn regression_an_absence_that_present_had_shown_left_the_presence_as_it_was() {
        for (away, is_shown) in [(Duration::ZERO, false), (Duration::from_millis(900), true)] {
            let mut rig = polled_often();
            let then = rig.handle.published().presence;
            rig.sim.set("power", "off").expect("a knob");
            rig.poll_after(SHORT);
            assert!(rig.handle.is_present(), "one poll has failed");
            rig.clock.sleep(away);
            assert_eq!(rig.handle.is_present(), !is_shown);
            rig.sim.set("power", "on").expect("a knob");
            rig.poll_after(SHORT);
            assert!(!rig.owner.access.schedule().has_failed() && rig.handle.is_present());
            assert_eq!(rig.handle.published().presence != then, is_shown);
        }
    }

    #[test]
    fn a_longer_interval_does_not_hide_that_the_gauge_was_away() {
        let mut rig = polled_often();
        let then = rig.handle.published().presence;
        rig.sim.set("power", "off").expect("a knob");
        rig.poll_after(SHORT);
        rig.clock.sleep(4 * SHORT);
        assert!(!rig.handle.is_present());
        rig.ask(&op::POLL_INTERVAL, INTERVAL).expect("it is set");
        assert!(rig.handle.published().presence != then);
    }

    #[test]
    fn a_gauge_that_is_busy_for_longer_than_three_polls_is_there() {
        let mut rig = polled_often();
        let then = rig.handle.published().presence;
        rig.clock.sleep(20 * SHORT);
        assert!(rig.handle.is_present());
        rig.owner.poll_on_time();
        assert!(rig.handle.published().presence == then);
    }

    #[test]
    fn a_register_that_shows_another_pack_begins_a_presence_at_once() {
        let mut rig = Rig::open();
        rig.poll_after(INTERVAL);
        let then = rig.handle.published().presence;
        rig.sim.set("power", "off").expect("a knob");
        rig.poll_after(INTERVAL);
        rig.sim.set_flash(48, 4, &[0, 7]);
        rig.sim.set("power", "on").expect("a knob");
        rig.poll_after(Duration::from_secs(3));
        assert!(rig.owner.access.doubts() && rig.handle.published().presence != then);
    }

    /// I2C has no error detection.
    #[test]
    fn one_wrong_bit_of_a_poll_takes_no_battery_out() {
        for byte in 1..=40 {
            for transfer in 1..=2 {
                let mut rig = Rig::of("bq27441-g1", Run::default());
                rig.owner.open().expect("it answers");
                rig.poll_after(INTERVAL);
                let then = rig.handle.published().presence;
                rig.sim.set("fault", &format!("flip {transfer} {byte} 3")).expect("a fault");
                rig.poll_after(INTERVAL);
                assert!(
                    rig.handle.is_present() && rig.handle.published().presence == then,
                    "{transfer} {byte}"
                );
            }
        }
    }

    /// A driver that hangs in a transfer, as `gauge_bus::bounded` shows it.
    struct Hangs {
        bus: SimBus,
        done: u64,
        /// The number of that transfer.
        at: Arc<AtomicU64>,
        /// It has returned.
        returned: Arc<AtomicBool>,
        held: Option<(Vec<u8>, usize)>,
    }

    impl Bus for Hangs {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
            self.done += 1;
            if self.done == self.at.load(Ordering::SeqCst) {
                self.held = Some((write.to_vec(), read.len()));
            }
            match self.held.take() {
                Some(held) if !self.returned.load(Ordering::SeqCst) => {
                    self.held = Some(held);
                    return Err(BusError::Hung(7));
                }
                // It takes effect now.
                Some((write, length)) => drop(self.bus.transfer(&write, &mut vec![0; length])),
                None => {}
            }
            self.bus.transfer(write, read)
        }
    }

    /// A gauge behind such a driver.
    fn behind_a_driver() -> (Rig, Arc<AtomicU64>, Arc<AtomicBool>) {
        let (at, returned) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicBool::new(false)));
        let wrap = |bus| -> Box<dyn Bus> {
            Box::new(Hangs { bus, done: 0, at: at.clone(), returned: returned.clone(), held: None })
        };
        let mut rig = Rig::on("bq34z100-g1", Run::default(), wrap);
        rig.owner.open().expect("it answers");
        (rig, at, returned)
    }

    #[test]
    fn a_gauge_whose_driver_hangs_is_gone_until_the_transfer_has_returned() {
        let (mut rig, at, returned) = behind_a_driver();
        at.store(rig.transfers() + 1, Ordering::SeqCst);
        rig.owner.poll_on_time();
        let published = rig.handle.published();
        assert!(published.snapshot.is_none() && published.last_error.contains("/dev/i2c-7 hangs"));
        let error = rig.ask(&op::CONTROL, 0x0002).expect_err("it hangs");
        assert_eq!(error.errno(), Errno::ETIMEDOUT as i32, "{error}");
        assert!(error.to_string().contains("/dev/i2c-7 hangs"), "{error}");
        returned.store(true, Ordering::SeqCst);
        rig.owner.poll_on_time();
        rig.ask(&op::CONTROL, 0x0002).expect("it answers");
    }

    /// The transfer still takes effect when it returns.
    #[test]
    fn a_write_whose_driver_hangs_at_any_transfer_is_settled_when_it_returns() {
        let mut rig = Rig::open();
        let (old, before) = (rig.sim.flash(), rig.transfers());
        write(&mut rig, 3100).expect("the default key");
        let (new, count) = (rig.sim.flash(), rig.transfers() - before);
        for number in 1..=count {
            let (mut rig, at, returned) = behind_a_driver();
            at.store(before + number, Ordering::SeqCst);
            write(&mut rig, 3100).expect_err("it hangs");
            returned.store(true, Ordering::SeqCst);
            rig.owner.poll_on_time();
            while let Some(due) = rig.owner.access.next_payment() {
                rig.clock.sleep(due.saturating_sub(rig.clock.now()));
                rig.owner.access.pay();
            }
            let flash = rig.sim.flash();
            assert!(flash == old || flash == new, "transfer {number}");
            assert_eq!(*rig.handle.published().owed, *"", "transfer {number}");
            assert_eq!(rig.sim.get("seal").as_deref(), Some("sealed"), "transfer {number}");
            write(&mut rig, 3100).expect("it answers");
        }
    }

    /// Writes Cell Terminate Voltage.
    fn write(rig: &mut Rig, value: i64) -> Result<()> {
        let row = rig.handle.chip().row("80", "53").expect("a parameter of the table");
        let change = Change::of_value(rig.handle.chip(), row, &Value::Int(value), false).expect("it fits");
        rig.ask(&op::WRITE, vec![change])
    }

    /// The watchdog of a gauge may reset it otherwise.
    #[test]
    fn registers_are_not_read_more_than_twice_a_second() {
        for (unverified, refresh) in [(false, false), (true, false), (true, true)] {
            let mut rig = Rig::new(Run { unverified, ..Run::default() });
            rig.sim.keep_log(true);
            rig.owner.open().expect("it answers");
            for _ in 0..4 {
                let now = rig.clock.now();
                if refresh {
                    rig.clock.sleep(Duration::from_millis(10));
                    rig.ask(&op::REFRESH, ()).expect("it answers");
                } else {
                    let due = rig.owner.access.schedule().due(SHORTEST);
                    rig.clock.sleep(due.saturating_sub(now));
                    rig.owner.poll_on_time();
                }
            }
            for code in 2..0x40 {
                let log = rig.sim.log().into_iter();
                let reads = log.filter(|record| match record.write[..] {
                    [start] => (start..).take(record.read.len()).any(|read| read == code),
                    _ => false,
                });
                let times: Vec<_> = reads.map(|record| record.at).collect();
                // A transfer is logged when it has ended.
                let least = 2 * SHORTEST - Duration::from_millis(10);
                let close = times.windows(3).any(|three| three[2] - three[0] < least);
                assert!(!close, "0x{code:02x} is read at {times:?}");
            }
        }
    }
}
