// SPDX-License-Identifier: MIT

//! What a gauge's owner can be asked to do: a row is an operation, with its name, how its text is read, what it needs and
//! what it calls. A file of `gauge/`, a step of a station and a request of the file system are views of these rows.

use std::ptr;
use std::sync::Arc;
use std::time::Duration;

use super::attempt::Importance;
use super::operation::{Asked, Operation};
use super::{Attempt, Owner, Presence, Seal, Wish, words};
use crate::error::{Cause, Error, Reason, Result};
use ti_gauge::authentication::{self, Message};
use ti_gauge::calibration::Job;
use ti_gauge::chip::Subclass;
use ti_gauge::dataflash::{Change, Decision, Outcome, Place};
use ti_gauge::epoch::{Epoch, Fact};
use ti_gauge::keys;
use ti_gauge::notation;
use ti_gauge::quantity;
use ti_gauge::text;
use ti_gauge::unit;

/// Reads subclasses, by their indices in the table. Those that are kept and still valid cost nothing.
pub static READ: Operation<Vec<usize>, Vec<Arc<[u8]>>> =
    Operation::new("read", |owner, wanted: Vec<usize>, asked| owner.read(&wanted, asked.waited))
        .attempting(|wanted| Attempt::Read(wanted.clone()))
        .reporting();

/// Reads subclasses, and what the pack is known by, so that a later access sees whether it is still the one. A failure is
/// none of a program's: it has asked for something else.
pub static KNOW: Operation<Vec<usize>> =
    Operation::new("know", |owner, wanted: Vec<usize>, asked| owner.know(&wanted, asked.waited))
        .attempting(|wanted| Attempt::Read(wanted.clone()))
        .reporting();

/// Writes parameters, all or none.
pub static WRITE: Operation<Vec<Change>> =
    Operation::new("write", Owner::write).attempting(|changes| Attempt::Write(places(changes)));

/// The same, for the gauge that was there in that presence only.
pub static COMMIT: Operation<(Epoch<Presence>, Vec<Change>)> =
    Operation::new("commit", Owner::commit).attempting(|(_, changes)| Attempt::Write(places(changes)));

/// Makes every check of a write, and programs nothing.
pub static CHECK: Operation<Vec<Change>> = Operation::new("check", |owner, changes: Vec<Change>, asked| {
    let outcome = owner.dataflash.try_write(&mut owner.gauge, &changes, asked.waited);
    owner.noted(outcome)
})
.attempting(|changes| Attempt::Write(places(changes)));

/// Goes to a seal state.
pub static SEAL: Operation<Seal> = Operation::new("seal", Owner::go_to).parsed_by(words::seal);

/// Sends a subcommand that the table marks safe.
pub static CONTROL: Operation<u16> = Operation::new("control", Owner::send).parsed_by(words::subcommand);

/// Changes one of the gauge's keys. `gaugefs keys` writes blanks afterwards, which overwrite the key in the daemon's
/// buffer.
pub static KEYS: Operation<keys::KeyChange> = Operation::new("keys", Owner::change_key)
    .parsed_by(|_, text| keys::KeyChange::parse(text))
    .ignoring_blank();

/// Publishes the gauge's answer to a challenge.
pub static AUTHENTICATE: Operation<Message> =
    Operation::new("authenticate", Owner::authenticate).parsed_by(|_, text| authentication::from_hex(text));

/// Shows what is known of an interrupted write, or settles it as somebody has decided.
pub static SETTLE: Operation<Option<Decision>> = Operation::new("settle", Owner::settle_as_decided)
    .parsed_by(words::decision)
    .naming_answer()
    .important(Importance::Owed);

/// Shows what is kept of what a gauge with RAM has learned, writes it, or removes it.
pub static LEARNED: Operation<Wish> =
    Operation::new("learned", Owner::keep_learned).parsed_by(words::wish).naming_answer();

/// Calibrates the gauge, without polls meanwhile.
pub static CALIBRATE: Operation<Job> =
    Operation::new("calibrate", Owner::calibrate).parsed_by(words::job).naming_answer();

/// Publishes a report of the gauge.
pub static REPORT: Operation<()> =
    Operation::new("report", |owner, (), asked| owner.make_report(asked.waited))
        .parsed_by(words::anything)
        .of_any_gauge()
        .important(Importance::Reading)
        .reporting();

/// Polls now, and forgets what was read of data flash.
pub static REFRESH: Operation<()> =
    Operation::new("refresh", |owner, (), asked| owner.refresh(asked.submitted))
        .parsed_by(words::anything)
        .of_any_gauge()
        .attempting(|()| Attempt::Poll)
        .reporting();

/// Changes the time between polls.
pub static POLL_INTERVAL: Operation<Duration> =
    Operation::new("poll_interval", Owner::set_interval).parsed_by(words::interval).of_any_gauge();

/// Releases the adapter if its device node has gone, or sees whether the gauge is back.
pub static LOOK: Operation<()> = Operation::new("look", |owner, (), _| owner.look_at_adapter())
    .of_any_gauge()
    .attempting(|()| Attempt::Poll)
    .reporting();

/// Pays what is owed for the last time, and ends the owner; an error says what remains.
pub static END: Operation<()> = Operation::new("end", |owner, (), _| owner.end())
    .of_any_gauge()
    .attempting(|()| SETTLE.itself())
    .reporting();

/// The places of changes.
fn places(changes: &[Change]) -> Vec<Place> {
    changes.iter().map(Change::place).collect()
}

/// A warning about a change of the seal state that leads through SEALED.
fn passes_sealed(now: Seal, goal: Seal) -> Option<&'static str> {
    (now == Seal::FullAccess && goal == Seal::Unsealed).then_some(
        "UNSEALED is reached from FULL ACCESS only through SEALED; a gauge that was never sealed before may from \
         now on be SEALED after each reset, and then needs its unseal key",
    )
}

/// A change and the bytes that it replaced, such as `3000 -> 3100 mV`: in the text form of the parameter, or in
/// hexadecimal where it has none.
fn difference(change: &Change, old: &[u8]) -> String {
    let new = change.stored_over(old);
    let show = |bytes: &[u8]| match change.row().zip(change.value_of(bytes)) {
        Some(((_, parameter), value)) => notation::show(parameter, &value),
        None => text::hex(bytes),
    };
    let unit = change.row().map_or("", |(_, parameter)| unit::shown(parameter));
    quantity::change(&show(old), &show(&new), unit)
}

impl Owner {
    fn go_to(&mut self, goal: Seal, asked: Asked) -> Result<()> {
        if let Some(warning) = passes_sealed(self.shared.published().seal, goal) {
            log::warn!("{}gauge/seal: {warning}", self.shared.prefix);
        }
        let outcome = self.dataflash.go_to(&mut self.gauge, goal, asked.waited);
        let outcome = self.noted(outcome);
        self.publish_seal();
        outcome
    }

    fn send(&mut self, code: u16, _: Asked) -> Result<()> {
        let outcome =
            self.settled_first().and_then(|()| self.check_takes(code)).and_then(|()| self.gauge.ask(code));
        self.publish_seal();
        // Until then whoever has asked before can read the answer, which says what it answers.
        let answer =
            outcome.inspect_err(|_| self.shared.publish(|published| published.control = Fact::default()))?;
        self.shared.publish(|published| published.control.learn(published.presence, (code, answer)));
        log::info!("{}Control(0x{code:04x}) answered 0x{answer:04x}", self.shared.prefix);
        Ok(())
    }

    fn change_key(&mut self, change: keys::KeyChange, asked: Asked) -> Result<()> {
        let settles = self.dataflash.owed().is_some();
        let order = self.shared.challenge_order();
        let outcome = self.dataflash.change_key(&mut self.gauge, &change, order, asked.waited);
        if settles {
            self.after_settling();
        }
        let outcome = self.noted(outcome);
        self.publish_seal();
        outcome?;
        log::info!("{}{} key: changed and tried", self.shared.prefix, change.name.as_str());
        Ok(())
    }

    fn authenticate(&mut self, challenge: Message, asked: Asked) -> Result<()> {
        let order = self.shared.challenge_order();
        let digest = authentication::ask(&mut self.gauge, &challenge, order, asked.waited);
        let digest =
            digest.inspect_err(|_| self.shared.publish(|published| published.digest = Fact::default()))?;
        self.shared.publish(|published| published.digest.learn(published.presence, (challenge, digest)));
        Ok(())
    }

    fn set_interval(&mut self, interval: Duration, _: Asked) -> Result<()> {
        // By a longer interval it may seem that it has been there all the time.
        if self.shared.published().snapshot.is_some() && !self.shared.is_present() {
            self.begin_anew();
        }
        self.shared.publish(|published| published.interval = interval);
        Ok(())
    }

    fn look_at_adapter(&mut self) -> Result<()> {
        self.gauge.release_if_gone();
        if self.schedule.has_failed() {
            self.poll_on_time();
        }
        Ok(())
    }

    /// Checks that the gauge takes a subcommand: one that is SEALED answers others, and does nothing.
    fn check_takes(&mut self, code: u16) -> Result<()> {
        let all = self.gauge.chip.subcommands;
        let Some(subcommand) = all.iter().find(|one| one.code == code && !one.sealed) else { return Ok(()) };
        if self.gauge.seal_anew()? != Seal::Sealed {
            return Ok(());
        }
        let why = "a SEALED gauge does not take it, so it was not sent; write `unsealed` to gauge/seal before, and `sealed` \
                   afterwards";
        Err(Error::new(subcommand.name, Cause::NotPermitted, why))
    }

    /// Pays what is owed to the gauge. Until then no subcommand is sent: it would go to a gauge of which nobody knows
    /// what it holds, or to another one.
    fn settled_first(&mut self) -> Result<()> {
        if self.dataflash.owed().is_some_and(|owed| !owed.needs_decision) {
            self.pay();
        }
        match self.dataflash.owed() {
            None => Ok(()),
            Some(owed) => {
                let what =
                    format!("no subcommand is sent while an interrupted access is not settled: {}", owed.why);
                let owed = Reason::Owed { decision: owed.needs_decision, what };
                Err(Error::of(self.gauge.chip.name, owed).owing(true))
            }
        }
    }

    /// Returns the bytes of subclasses. Those that are not kept are read together, while the gauge is
    /// unsealed once.
    pub(super) fn read(&mut self, wanted: &[usize], waited: Duration) -> Result<Vec<Arc<[u8]>>> {
        let kept: Vec<_> = wanted.iter().map(|&index| self.shared.kept(index)).collect();
        let unread = wanted.iter().zip(&kept).filter(|(_, kept)| kept.is_none());
        let unread: Vec<usize> = unread.map(|(&index, _)| index).collect();
        let mut read = self.read_anew(&unread, waited)?.into_iter();
        Ok(kept.into_iter().filter_map(|kept| kept.or_else(|| read.next())).collect())
    }

    fn know(&mut self, wanted: &[usize], waited: Duration) -> Result<()> {
        if !wanted.is_empty() {
            return self.read(wanted, waited).map(drop);
        }
        let outcome = self.dataflash.learn_pack(&mut self.gauge, waited);
        self.noted(outcome)
    }

    pub(super) fn read_anew(&mut self, wanted: &[usize], waited: Duration) -> Result<Vec<Arc<[u8]>>> {
        let rows: Vec<&Subclass> = wanted.iter().map(|&index| &self.gauge.chip.subclasses[index]).collect();
        if rows.is_empty() {
            return Ok(Vec::new());
        }
        let read = self.dataflash.read(&mut self.gauge, &rows, waited);
        self.keep(wanted, read)
    }

    /// Reads what attributes and messages need of data flash, if the gauge is open: it is never unsealed for this.
    pub(super) fn read_if_open(&mut self) {
        let published = self.shared.published();
        // Values that are about to be undone or restored must not be shown.
        let is_settled = self.dataflash.owed().is_none() && !self.memory.is_waited_for();
        let looked = self.looked.is_known(self.shared.content());
        if looked || !is_settled || published.limited.is_some() || published.seal == Seal::Sealed {
            return;
        }
        // A failure is in the log, and no reason to do without the gauge; the next look follows a change.
        self.looked.learn(self.shared.content(), ());
        let wanted = self.shared.unread_places();
        let rows: Vec<&Subclass> = wanted.iter().map(|&index| &self.gauge.chip.subclasses[index]).collect();
        if rows.is_empty() {
            return;
        }
        let read = self.dataflash.read_if_open(&mut self.gauge, &rows).transpose();
        if let Some(read) = read {
            let _ = self.keep(&wanted, read);
        }
    }

    /// Keeps the bytes of subclasses, and what they show.
    fn keep(&mut self, wanted: &[usize], read: Result<Vec<Vec<u8>>>) -> Result<Vec<Arc<[u8]>>> {
        let read = self.noted(read);
        let first = &self.gauge.chip.subclasses[wanted[0]];
        let read = read.map_err(|error| error.within(&format!("df of {}", first.name)));
        let read = self.logged(Attempt::Read(wanted.to_vec()), read)?;
        let read: Vec<Arc<[u8]>> = read.into_iter().map(Arc::from).collect();
        if self.dataflash.doubts() {
            log::warn!("{}: another pack answers, as data flash shows; it is read anew", self.shared.name());
            self.forget_dataflash();
            self.begin_anew();
            self.schedule.hurry();
        }
        for (&index, bytes) in wanted.iter().zip(&read) {
            self.shared.keep(index, bytes.clone(), self.schedule.number());
        }
        self.report_quirks();
        Ok(read)
    }

    fn write(&mut self, changes: Vec<Change>, asked: Asked) -> Result<()> {
        self.write_all(&changes, asked.waited).map_err(|error| match changes.len() {
            1 => error,
            _ => error.within("df/transaction"),
        })
    }

    fn commit(&mut self, (presence, changes): (Epoch<Presence>, Vec<Change>), asked: Asked) -> Result<()> {
        if self.shared.published().presence == presence {
            return self.write(changes, asked);
        }
        let why = "the gauge has been away or is another one since the commit was written, so nothing of it was done; check \
                   its values and begin again";
        Err(Error::new("df/transaction", Cause::Gone, why))
    }

    fn write_all(&mut self, changes: &[Change], waited: Duration) -> Result<()> {
        if changes.is_empty() {
            return Ok(());
        }
        let begun = self.gauge.clock.now();
        if self.dataflash.owed().is_some() {
            self.pay();
        }
        // While something is still owed the write is refused, and what data flash holds is no configuration.
        if self.dataflash.owed().is_none() {
            self.back_up(changes, waited)?;
        }
        let waited = waited + self.gauge.clock.now().saturating_sub(begun);
        let outcome = self.dataflash.write(&mut self.gauge, changes, waited);
        let outcome = self.noted(outcome);
        match &outcome {
            Ok(Outcome::Unchanged) => {}
            Ok(Outcome::Written { reset: false, .. }) => {
                let touched = |row: &Subclass, change: &Change| match change.row() {
                    Some((subclass, _)) => ptr::eq(subclass, row),
                    None => change.place().subclass == row.id,
                };
                self.shared.forget(|row| changes.iter().any(|change| touched(row, change)));
                self.looked = Fact::default();
            }
            // After a reset, or a failure, nothing that was read before can be relied on.
            Ok(Outcome::Written { reset: true, .. }) => {
                self.forget_values();
                self.schedule.hurry();
            }
            Err(_) => {
                self.forget_values();
                self.shared.doubt_scales_of(changes);
                self.schedule.hurry();
            }
        }
        self.log_written(changes, &outcome?);
        Ok(())
    }

    /// Logs what each change of a write has replaced.
    pub(super) fn log_written(&self, changes: &[Change], outcome: &Outcome) {
        let prefix = format!("{}{}", self.shared.prefix, self.serial());
        for change in changes {
            let Place { subclass, offset } = change.place();
            self.shared.note_scales(subclass, offset, change.bytes());
        }
        match outcome {
            Outcome::Unchanged => {
                for change in changes {
                    log::info!("{prefix}{}: unchanged, nothing written", change.name());
                }
            }
            Outcome::Written { old, .. } => {
                for (change, old) in changes.iter().zip(old) {
                    log::info!(
                        "{prefix}{}: {}, written and verified",
                        change.name(),
                        difference(change, old)
                    );
                }
            }
        }
    }

    /// The pack's serial number at the last poll, as the beginning of a line of the log.
    fn serial(&self) -> String {
        let register = self.gauge.chip.serial_register();
        let published = self.shared.published();
        let word = register.and_then(|register| published.snapshot.as_ref()?.value(register));
        word.map_or_else(String::new, |word| format!("serial 0x{word:04x}: "))
    }

    /// Looks at the gauge anew: forgets what was read of data flash, makes sure that it is the same gauge, and polls
    /// it.
    fn refresh(&mut self, submitted: Duration) -> Result<()> {
        self.forget_values();
        self.dataflash.suspect(self.gauge.chip);
        // A look since then is as new as was asked for.
        if self.schedule.is_newer_than(submitted) && submitted < self.identified {
            return Ok(());
        }
        self.gauge.wait(self.schedule.wait(self.gauge.clock.now()));
        self.schedule.read_slow_tier();
        self.recognise().and_then(|()| self.update()).inspect_err(|error| self.asked_poll_failed(error))?;
        self.repair_if_overdue();
        Ok(())
    }

    /// Reads the seal state and CONTROL_STATUS, which a request may have changed. If that fails, so does the
    /// next poll, which reports it.
    pub(super) fn publish_seal(&mut self) {
        if let Ok((seal, status)) = self.gauge.control_status() {
            self.control_status = status;
            self.shared.publish(|published| {
                published.seal = seal;
                if let Some(snapshot) = &mut published.snapshot {
                    Arc::make_mut(snapshot).control_status = status;
                }
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Run;
    use super::super::operation::QUEUE_LIMIT;
    use super::super::rig::{INTERVAL, Rig};
    use super::*;
    use crate::error::Cause;
    use gauge_bus::clock::Clock as _;
    use ti_gauge::chip::{Limited, SIBLINGS};
    use ti_gauge::dataflash::Change;
    use ti_gauge::value::Value;

    /// Each operation that sends more than a poll reads, asked for that late.
    fn ask_all(rig: &mut Rig, delay: Duration) -> [Result<()>; 8] {
        let discharge = rig.index(80);
        let change = change(rig, "3100");
        let key = keys::KeyChange::parse(b"unseal 0414 3672 1234 5678").expect("two keys");
        [
            rig.ask_late(delay, &READ, vec![discharge]).map(drop),
            rig.ask_late(delay, &WRITE, vec![change]),
            rig.ask_late(delay, &SEAL, Seal::Unsealed),
            rig.ask_late(delay, &CONTROL, 0x0002),
            rig.ask_late(delay, &KEYS, key),
            rig.ask_late(delay, &AUTHENTICATE, [0; 20]),
            rig.ask_late(delay, &SETTLE, Some(Decision::Discard)),
            rig.ask_late(delay, &CALIBRATE, Job::BoardOffset),
        ]
    }

    /// Another value for Cell Terminate Voltage.
    fn change(rig: &Rig, text: &str) -> Change {
        let subclass = &rig.handle.chip().subclasses[rig.index(80)];
        let parameter = subclass.parameter(53).expect("a parameter of the table");
        let value = Value::Int(text.parse().expect("a number"));
        Change::of_value(rig.handle.chip(), (subclass, parameter), &value, false).expect("it fits")
    }

    /// Nothing is sent for a request that is refused.
    fn refused(rig: &mut Rig, delay: Duration, is_right: impl Fn(&Error) -> bool) {
        let (flash, transfers) = (rig.sim.flash(), rig.transfers());
        for outcome in ask_all(rig, delay) {
            let error = outcome.expect_err("it is refused");
            assert!(is_right(&error), "{error}");
        }
        assert_eq!(rig.transfers(), transfers, "nothing was sent");
        assert!(rig.sim.flash() == flash);
    }

    #[test]
    fn only_the_way_from_full_access_to_unsealed_passes_through_sealed_unasked() {
        let states = [Seal::Sealed, Seal::Unsealed, Seal::FullAccess];
        for (now, goal) in states.into_iter().flat_map(|now| states.map(|goal| (now, goal))) {
            let warns = (now, goal) == (Seal::FullAccess, Seal::Unsealed);
            assert_eq!(passes_sealed(now, goal).is_some(), warns, "{now:?} to {goal:?}");
        }
        let mut rig = Rig::open();
        rig.ask(&SEAL, Seal::FullAccess).expect("the default keys");
        assert!(passes_sealed(rig.handle.published().seal, Seal::Unsealed).is_some());
    }

    #[test]
    fn a_change_is_described_by_old_and_new_value() {
        let chip = ti_gauge::chip::Chip::by_name("bq34z100-g1").expect("it has a table");
        let of = |id: &str, offset: &str, old: &[u8], new: &[u8]| {
            let row = chip.row(id, offset).expect("a parameter of the table");
            let value = chip.layout.decode(row.1.kind, new);
            difference(&Change::of_value(chip, row, &value, true).expect("a value in range"), old)
        };
        assert_eq!(of("80", "53", &[0x0b, 0xb8], &[0x0c, 0x1c]), "3000 -> 3100 mV");
        assert_eq!(of("48", "4", &[0, 1], &[0, 7]), "0x0001 -> 0x0007");
        assert_eq!(of("58", "3", &[0x00], &[0x5a]), "0x00 -> 0x5a");
        assert_eq!(of("48", "31", b"\x04old\n       ", b"\x03new        "), "old%0a -> new");
        let raw = Change::raw(chip, Place { subclass: 130, offset: 200 }, vec![0xab, 0xcd]).expect("no row");
        assert_eq!(difference(&raw, &[0, 1]), "0001 -> abcd");
    }

    #[test]
    fn a_late_request_is_refused_and_not_begun() {
        let mut rig = Rig::open();
        let late = QUEUE_LIMIT + Duration::from_millis(1);
        refused(&mut rig, late, |error| matches!(error.cause(), Cause::NotNow));
        // These are as good late as at once.
        rig.ask_late(late, &REFRESH, ()).expect("it is polled");
        rig.ask_late(late, &POLL_INTERVAL, late).expect("it is set");
    }

    #[test]
    fn requests_are_carried_out_up_to_the_limit() {
        let mut rig = Rig::open();
        rig.ask_late(QUEUE_LIMIT, &CONTROL, 0x0002).expect("it answers");
        let change = change(&rig, "3100");
        rig.ask(&WRITE, vec![change]).expect("the default key");
        let index = rig.index(80);
        let read = rig.ask(&READ, vec![index]).expect("the default key");
        assert_eq!(read[0][53..55], 3100_u16.to_be_bytes());
        assert!(rig.ask(&READ, vec![]).expect("nothing to read").is_empty());
    }

    #[test]
    fn a_request_to_a_relative_without_a_table_is_refused() {
        let mut rig = Rig::open();
        rig.owner.shared.publish(|published| published.limited = Some(Limited::Sibling(&SIBLINGS[0])));
        refused(&mut rig, Duration::ZERO, |error| {
            matches!(error.cause(), Cause::NotPermitted) && error.to_string().starts_with(SIBLINGS[0].name)
        });
        rig.owner.poll().expect("its standard commands are read");
    }

    #[test]
    fn a_failure_is_shown_until_what_had_failed_succeeds() {
        let mut rig = Rig::open();
        let shown = |rig: &Rig| rig.handle.published().last_error.to_string();
        let write = |rig: &mut Rig, value| {
            let change = change(rig, value);
            rig.ask(&WRITE, vec![change])
        };
        rig.sim.set("voltage_mv", "2700").expect("a knob");
        write(&mut rig, "3100").expect_err("the voltage is too low");
        let failure = shown(&rig);
        assert!(failure.contains("Cell Terminate Voltage") && rig.handle.published().failed.is_some());
        // None of these is what had failed.
        let index = rig.index(48);
        rig.ask(&REFRESH, ()).expect("it answers");
        rig.ask(&READ, vec![index]).expect("the default key");
        rig.ask(&SEAL, Seal::Unsealed).expect("the default key");
        rig.ask(&SEAL, Seal::Sealed).expect("it is sealed");
        assert_eq!(shown(&rig), failure);
        rig.sim.set("voltage_mv", "12000").expect("a knob");
        write(&mut rig, "3100").expect("the default key");
        assert_eq!((shown(&rig), rig.handle.published().failed.clone()), (String::new(), None));

        rig.sim.set("power", "off").expect("a knob");
        rig.owner.poll_on_time();
        assert!(shown(&rig).contains("not acknowledged"));
        rig.sim.set("power", "on").expect("a knob");
        rig.clock.sleep(Duration::from_secs(2));
        rig.owner.poll_on_time();
        assert_eq!(shown(&rig), "");
    }

    #[test]
    fn nothing_is_sent_to_an_address_without_a_known_gauge() {
        let mut rig = Rig::new(Run { unverified: true, ..Run::default() });
        refused(&mut rig, Duration::ZERO, |error| matches!(error.cause(), Cause::Gone));
        rig.owner.open().expect("it reads like a gauge");
        rig.ask(&CONTROL, 0x0002).expect("it is one");
    }

    #[test]
    fn regression_a_subcommand_that_a_sealed_gauge_ignores_was_a_success() {
        let mut rig = Rig::open();
        let it_enable = 0x0021;
        let error = rig.ask(&CONTROL, it_enable).expect_err("it is SEALED");
        assert!(matches!(error.cause(), Cause::NotPermitted), "{error}");
        assert!(error.to_string().starts_with("IT_ENABLE: a SEALED gauge"), "{error}");
        rig.ask(&CONTROL, 0x0008).expect("CHEM_ID is taken by any");
        rig.ask(&SEAL, Seal::Unsealed).expect("the default key");
        rig.ask(&CONTROL, it_enable).expect("it is UNSEALED");
        assert_eq!(rig.handle.published().control().map(|(code, _)| code), Some(it_enable));
    }

    /// What is committed waits in the queue.
    #[test]
    fn a_commit_is_for_the_gauge_that_was_there_when_it_was_written() {
        let mut rig = Rig::open();
        let (then, flash) = (rig.handle.published().presence, rig.sim.flash());
        rig.sim.set("power", "off").expect("a knob");
        (0..3).for_each(|_| rig.poll_after(INTERVAL));
        rig.sim.set("power", "on").expect("a knob");
        (0..2).for_each(|_| rig.poll_after(INTERVAL));
        let changes = vec![change(&rig, "3100")];
        let error = rig.ask(&COMMIT, (then, changes.clone())).expect_err("it was away");
        assert!(
            matches!(error.cause(), Cause::Gone) && error.to_string().contains("nothing of it"),
            "{error}"
        );
        assert!(rig.sim.flash() == flash);
        let now = rig.handle.published().presence;
        rig.ask(&COMMIT, (now, changes)).expect("the default key");
        assert!(rig.sim.flash() != flash);
    }

    #[test]
    fn a_failed_write_of_one_parameter_is_named_after_it() {
        let mut rig = Rig::open();
        rig.sim.set("voltage_mv", "2700").expect("a knob");
        let (one, two) = (change(&rig, "3100"), [change(&rig, "3100"), change(&rig, "3200")]);
        let error = rig.ask(&WRITE, vec![one]).expect_err("the voltage is too low");
        assert!(error.to_string().starts_with("Cell Terminate Voltage (80/53): "), "{error}");
        assert_eq!(*rig.handle.published().last_error, *error.to_string());
        let error = rig.ask(&WRITE, two.into()).expect_err("the voltage is too low");
        assert!(error.to_string().starts_with("df/transaction: "), "{error}");
    }
}
