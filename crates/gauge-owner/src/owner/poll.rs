// SPDX-License-Identifier: MIT

//! Reading the registers that are due, and when.

use std::sync::Arc;
use std::time::Duration;

use super::{Attempt, Owner, Snapshot, now};
use crate::error::{Cause, Error, Result, Step};
use gauge_bus::BusError;
use ti_gauge::chip::{Chip, Role, Source, Tier};
use ti_gauge::gauge::Statistics;
use ti_gauge::registers::Registers;

/// The slow tier is read with every tenth poll, first with the second one, which follows soon after the
/// first: a mount waits only for what its attributes need.
const SLOW_EVERY: u64 = 10;
/// Consecutive failed polls after which a gauge counts as gone.
const FAILURES: u32 = 3;
/// Delay before the first failed poll is repeated; further failures wait for the interval.
const RETRY: Duration = Duration::from_secs(1);
/// Least time between polls. The watchdog of a gauge that is sent standard commands more often than twice a
/// second may reset it.
const SHORTEST: Duration = Duration::from_millis(500);

/// When the gauge is polled, and which polls read the slow tier.
#[derive(Debug)]
pub(super) struct Schedule {
    /// Successful polls. Skips numbers to move the next poll of the slow tier.
    number: u64,
    /// Consecutive polls that failed.
    failures: u32,
    /// When the last poll began, or failed; before the first one, when the gauge was last identified.
    last: Duration,
    /// When the registers were read before that.
    before: Duration,
    /// The next poll comes earlier than the interval: it is the second one, what the registers hold has changed, or
    /// something that follows a poll is to be tried again.
    soon: Option<Duration>,
    /// See [`super::Run::phase`]; zero once it has been used.
    phase: Duration,
}

impl Schedule {
    /// The schedule of a gauge whose registers may have been read just now, to identify it.
    pub(super) fn new(phase: Duration, now: Duration) -> Self {
        Self { number: 0, failures: 0, last: now, before: Duration::ZERO, soon: None, phase }
    }

    /// When the next poll is due.
    pub(super) fn due(&self, interval: Duration) -> Duration {
        (self.last + self.pause(interval)).max(self.earliest())
    }

    /// When the registers may be read again: never more than twice a second.
    fn earliest(&self) -> Duration {
        match self.before {
            Duration::ZERO => self.last + SHORTEST,
            before => (self.last + SHORTEST).max(before + 2 * SHORTEST),
        }
    }

    /// The registers are read, to identify the gauge.
    pub(super) fn reads(&mut self, now: Duration) {
        (self.before, self.last) = (self.last, now);
    }

    /// Time from the last poll to the next one.
    fn pause(&self, interval: Duration) -> Duration {
        match (self.failures, self.soon) {
            (0, Some(soon)) => soon,
            (0, None) => interval.saturating_sub(self.phase).max(SHORTEST.min(interval)),
            (1, _) => interval.min(RETRY),
            _ => interval,
        }
    }

    /// How long to wait before a poll that somebody asks for.
    pub(super) fn wait(&self, now: Duration) -> Duration {
        self.earliest().saturating_sub(now)
    }

    /// Whether the last poll succeeded, and began after that moment.
    pub(super) fn is_newer_than(&self, moment: Duration) -> bool {
        self.failures == 0 && moment < self.last
    }

    /// The number of the last poll.
    pub(super) fn number(&self) -> u64 {
        self.number
    }

    /// Whether the last poll failed.
    pub(super) fn has_failed(&self) -> bool {
        self.failures > 0
    }

    /// Whether the gauge is gone.
    pub(super) fn is_gone(&self) -> bool {
        self.failures >= FAILURES
    }

    /// Marks the gauge as gone: it did not answer when it was opened.
    pub(super) fn set_gone(&mut self, now: Duration) {
        (self.failures, self.last) = (FAILURES, now);
    }

    /// Polls again soon: what the registers hold has changed.
    pub(super) fn hurry(&mut self) {
        self.soon = Some(SHORTEST);
    }

    /// Polls again after a pause from now on, which doubles with each attempt up to the interval.
    pub(super) fn try_again(&mut self, now: Duration, attempts: u32, interval: Duration) {
        let pause = SHORTEST.saturating_mul(1_u32.checked_shl(attempts).unwrap_or(u32::MAX));
        self.soon = Some(now.saturating_sub(self.last) + pause.min(interval));
    }

    /// The next poll is the first of a gauge; the one after it reads the slow tier.
    pub(super) fn begin_anew(&mut self) {
        self.number = self.number.next_multiple_of(SLOW_EVERY);
    }

    /// The next poll reads the slow tier.
    pub(super) fn read_slow_tier(&mut self) {
        self.number = self.number.next_multiple_of(SLOW_EVERY) + 1;
    }

    /// The last poll has read the slow tier.
    pub(super) fn has_read_slow_tier(&self) -> bool {
        self.number % SLOW_EVERY == 2
    }

    fn reads_slow_tier(&self) -> bool {
        self.number % SLOW_EVERY == 1
    }

    /// A poll that began then has succeeded. Returns its number.
    fn succeeded(&mut self, begun: Duration) -> u64 {
        self.number += 1;
        self.reads(begun);
        self.failures = 0;
        if self.soon.is_none() && self.number > 1 {
            self.phase = Duration::ZERO;
        }
        self.soon = None;
        self.number
    }

    /// A poll has failed.
    fn failed(&mut self, now: Duration) {
        self.failures = self.failures.saturating_add(1);
        self.reads(now);
    }
}

impl Owner {
    /// The poll that is due by the schedule.
    pub(super) fn poll_on_time(&mut self) {
        let was_gone = self.schedule.is_gone();
        let is_new = Statistics::read(&self.shared.statistics.polls) == 0;
        match self.update() {
            Ok(()) if is_new => {
                log::info!("{}: the gauge answers", self.shared.name());
                self.after_first_poll();
            }
            Ok(()) => {
                if was_gone {
                    log::info!("{}: the gauge is back", self.shared.name());
                }
                self.keep_configured();
                self.read_if_open();
            }
            Err(error) => self.poll_failed(&error),
        }
    }

    /// Polls, after identifying the gauge anew if another one may be in its place.
    pub(super) fn update(&mut self) -> Result<()> {
        if self.schedule.is_gone() || self.dataflash.doubts() {
            self.arrive()?;
        }
        self.poll()
    }

    /// Counts and reports a failed poll. After the third in a row the gauge is gone.
    pub(super) fn poll_failed(&mut self, error: &Error) {
        Statistics::count(&self.shared.statistics.failed_polls);
        // Polls of a gauge that is gone are expected to fail: they are not logged.
        let was_gone = self.schedule.is_gone();
        let now = self.gauge.clock.now();
        match error.cause() {
            // Nothing can reach it.
            Cause::Bus(BusError::Hung(_)) => self.schedule.set_gone(now),
            _ => self.schedule.failed(now),
        }
        // A pack may be exchanged while it does not answer.
        self.forget_dataflash();
        self.dataflash.suspect(self.gauge.chip);
        self.memory.doubt();
        if was_gone {
            return;
        }
        self.shared.publish(|published| published.is_failing = true);
        self.shared.report(Attempt::Poll, error);
        if self.schedule.is_gone() {
            log::warn!("{}: the gauge is gone", self.shared.name());
            self.shared.publish(|published| {
                published.snapshot = None;
                published.presence = now::presence();
            });
        }
    }

    /// The same for a poll that somebody has asked for: its failure is always recorded, also that of a gauge that is gone.
    pub(super) fn asked_poll_failed(&mut self, error: &Error) {
        let was_gone = self.schedule.is_gone();
        self.poll_failed(error);
        if was_gone {
            self.shared.record(Attempt::Poll, error);
        }
    }

    /// Reads what is due and publishes it as a new Snapshot.
    pub(super) fn poll(&mut self) -> Result<()> {
        let mut taken = self.gauge.clock.now();
        let (slow, statics) =
            (self.schedule.reads_slow_tier(), !self.statics.is_known(self.shared.content()));
        let statics = statics || self.memory.watches_copies(self.gauge.chip);
        let condition = &self.gauge.chip.condition;
        if slow || statics {
            // Both tiers in one pass: a burst may hold registers of each.
            self.rare.read(&mut self.gauge, |tier| match tier {
                Tier::Slow => slow,
                Tier::Static => statics,
                Tier::Poll | Tier::Window => false,
            })?;
            self.statics.learn(self.shared.content(), ());
        }
        // A primary cell is measured only while CONTROL_STATUS says so.
        let has_table = self.gauge.chip.has_table();
        if has_table && (slow || statics || self.unmeasured > 0 || condition.primary.is_some()) {
            let (seal, status) = self.gauge.control_status()?;
            self.control_status = status;
            self.shared.publish(|published| published.seal = seal);
        }
        let mut registers = self.rare.clone();
        registers.read(&mut self.gauge, |tier| tier == Tier::Poll)?;
        let chip = self.gauge.chip;
        if registers.are_all_ones() {
            let why = "every byte reads 0xff, as on a bus without a gauge; check that it is connected";
            return Err(Error::new(chip.name, Cause::Protocol, why).at(Step::Read));
        }
        let value = |source| word(chip, &registers, source);
        let last = self.shared.published().snapshot.clone();
        let had_battery = last.map(|last| has_battery(chip, &last.registers));
        let has_changed =
            |registers: &Registers| had_battery.is_some_and(|had| had != has_battery(chip, registers));
        if self.dataflash.misreads_loss(&mut self.gauge, value)?
            || self.dataflash.needs_second_poll(chip, value)
            || has_changed(&registers)
        {
            self.schedule.reads(taken);
            self.gauge.wait(self.schedule.wait(self.gauge.clock.now()));
            taken = self.gauge.clock.now();
            if statics {
                self.rare.read(&mut self.gauge, |tier| tier == Tier::Static)?;
            }
            registers = self.rare.clone();
            registers.read(&mut self.gauge, |tier| tier == Tier::Poll)?;
        }
        let number = self.schedule.succeeded(taken);
        Statistics::count(&self.shared.statistics.polls);
        let contradicted = self.dataflash.contradicted(chip, |source| word(chip, &registers, source));
        if self.dataflash.polled(chip, |source| word(chip, &registers, source)) {
            let name = contradicted.unwrap_or("data flash");
            log::warn!("{}: another pack answers, as {name} shows; it is read anew", self.shared.name());
            self.forget_dataflash();
            self.begin_anew();
            self.schedule.hurry();
        }
        if has_changed(&registers) {
            self.battery_has_changed(has_battery(chip, &registers));
        } else if had_battery == Some(true) && !self.shared.is_present() {
            self.begin_anew();
        }
        self.unmeasured = if self.has_measured(&registers) { 0 } else { self.unmeasured.saturating_add(1) };
        if self.unmeasured > 0 {
            self.schedule.try_again(
                self.gauge.clock.now(),
                self.unmeasured,
                self.shared.published().interval,
            );
        }
        self.tell_what_is_amiss(&registers);
        let is_valid = self.unmeasured == 0;
        let is_configured = self.is_configured(&registers);
        let control_status = self.control_status;
        let primary = chip.condition.primary.as_ref();
        let has_current = primary.is_none_or(|primary| control_status & primary.active != 0);
        let snapshot =
            Snapshot { taken, number, registers, control_status, is_valid, is_configured, has_current };
        self.shared.publish(|published| {
            (published.snapshot, published.is_failing) = (Some(Arc::new(snapshot)), false);
        });
        self.shared.succeeded(&Attempt::Poll);
        Ok(())
    }

    /// Whether the gauge has measured since its power-up or reset. A gauge that answers has more than 0 mV. One whose
    /// flags show a battery, or a loss of power, that the last poll did not may have started since CONTROL_STATUS was
    /// read, which the next poll reads again.
    fn has_measured(&self, registers: &Registers) -> bool {
        let chip = self.gauge.chip;
        let read = |registers: &Registers, role| registers.value(chip.register(role)?);
        let starts = i64::from(chip.condition.present | chip.volatile.unwrap_or(0));
        let before =
            self.shared.published().snapshot.as_ref().and_then(|last| read(&last.registers, Role::Flags));
        let has_started =
            read(registers, Role::Flags).zip(before).is_some_and(|(now, before)| now & !before & starts != 0);
        let shows = |(shown_in, bit)| match shown_in {
            Source::Command(_) => word(chip, registers, shown_in).is_some_and(|word| word & bit != 0),
            Source::Status | Source::Answer(_) => self.control_status & bit != 0,
        };
        chip.condition.complete.is_none_or(shows)
            && read(registers, Role::VoltageNow) != Some(0)
            && !has_started
    }
}

/// Whether the registers of a poll show a battery.
pub(super) fn has_battery(chip: &Chip, registers: &Registers) -> bool {
    chip.condition.shows_battery(chip.register(Role::Flags).and_then(|flags| registers.value(flags)))
}

/// The register of a source, as its bits.
fn word(chip: &Chip, registers: &Registers, source: Source) -> Option<u32> {
    registers.value(chip.register_at(source)?).map(|value| value as u32)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

    use nix::errno::Errno;

    use super::super::rig::{INTERVAL, Rig};
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
                let pause = owner.schedule.pause(INTERVAL);
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
            (rig.owner.schedule.pause(INTERVAL), rig.handle.published().snapshot.is_some())
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
            rig.owner.shared.clear_error();
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
            assert!(!rig.owner.schedule.has_failed() && rig.handle.is_present());
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
        assert!(rig.owner.dataflash.doubts() && rig.handle.published().presence != then);
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
            while let Some(due) = rig.owner.debt.due() {
                rig.clock.sleep(due.saturating_sub(rig.clock.now()));
                rig.owner.pay();
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

    #[test]
    fn the_slow_tier_is_read_with_the_second_poll_and_every_tenth_after_it() {
        let mut schedule = Schedule::new(Duration::ZERO, Duration::ZERO);
        let mut polls = |count| -> Vec<usize> {
            let slow = (1..=count).filter(|_| {
                let slow = schedule.reads_slow_tier();
                schedule.succeeded(Duration::ZERO);
                slow
            });
            slow.collect()
        };
        assert_eq!(polls(25), [2, 12, 22]);
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
                    rig.clock.sleep(rig.owner.schedule.due(SHORTEST).saturating_sub(now));
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

    #[test]
    fn a_gauge_that_comes_back_is_polled_as_at_first() {
        let mut schedule = Schedule::new(Duration::ZERO, Duration::ZERO);
        let last = (0..5).map(|_| schedule.succeeded(Duration::ZERO)).last();
        schedule.begin_anew();
        assert!(!schedule.reads_slow_tier());
        assert!(Some(schedule.succeeded(Duration::ZERO)) > last, "numbers are not used twice");
        assert!(schedule.reads_slow_tier());
    }
}
