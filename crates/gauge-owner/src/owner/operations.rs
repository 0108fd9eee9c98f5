// SPDX-License-Identifier: MIT

//! What an owner can be asked to do. Files of `gauge/`, steps of a station and file operations are views of these rows.

use std::ptr;
use std::sync::Arc;
use std::time::Duration;

use super::access::Access;
use super::attempt::Importance;
use super::calibrate::calibrate;
use super::handle::Shared;
use super::operation::{Asked, Operation, QUEUE_LIMIT};
use super::report::{self, Recording};
use super::{Attempt, Owner, Presence, Seal, Wish, words, written};
use crate::error::{Cause, Error, Result};
use ti_gauge::authentication::{self, Message};
use ti_gauge::calibration::Job;
use ti_gauge::chip::{Parameter, Subclass};
use ti_gauge::dataflash::{Change, Decision, Outcome, Place};
use ti_gauge::epoch::{Epoch, Fact};
use ti_gauge::keys;
use ti_gauge::value::Value;

/// Reads subclasses, by their indices in the table. Those that are kept and still valid cost nothing.
pub static READ: Operation<Vec<usize>, Vec<Arc<[u8]>>> =
    Operation::new("read", |owner, wanted: Vec<usize>, asked| owner.access.read(&wanted, asked.waited))
        .attempting(|wanted| Attempt::Read(wanted.clone()))
        .reporting();

/// Reads a parameter, given by its subclass's index in the table. One that is kept and still valid costs nothing.
pub static READ_VALUE: Operation<(usize, &'static Parameter), Value> =
    Operation::new("read value", |owner, (index, parameter): (usize, &'static Parameter), asked| {
        owner.access.read_value(index, parameter, asked.waited)
    })
    .attempting(|&(index, _)| Attempt::Read(vec![index]))
    .reporting();

/// Reads subclasses, and marks of the pack for later accesses. No program asked, so a failure is not shown.
pub static KNOW: Operation<Vec<usize>> =
    Operation::new("know", |owner, wanted: Vec<usize>, asked| owner.access.know(&wanted, asked.waited))
        .attempting(|wanted| Attempt::Read(wanted.clone()))
        .reporting();

/// Writes parameters, all or none.
pub static WRITE: Operation<Vec<Change>> =
    Operation::new("write", Owner::write).attempting(|changes| Attempt::Write(places(changes)));

/// Writes parameters, all or none, of the gauge that was there in that presence only.
pub static COMMIT: Operation<(Epoch<Presence>, Vec<Change>)> =
    Operation::new("commit", Owner::commit).attempting(|(_, changes)| Attempt::Write(places(changes)));

/// Makes every check of a write, and programs nothing.
pub static CHECK: Operation<Vec<Change>> = Operation::new("check", |owner, changes: Vec<Change>, asked| {
    owner.access.run(|dataflash, gauge| dataflash.try_write(gauge, &changes, asked.waited))
})
.attempting(|changes| Attempt::Write(places(changes)));

/// Goes to a seal state.
pub static SEAL: Operation<Seal> =
    Operation::new("seal", |owner, goal, asked| go_to(&mut owner.access, goal, asked)).parsed_by(words::seal);

/// Sends a subcommand that the table marks safe.
pub static CONTROL: Operation<u16> =
    Operation::new("control", |owner, code, _| send(&mut owner.access, code)).parsed_by(words::subcommand);

/// Changes a key. `gaugefs keys` writes blanks afterwards, which overwrite the key in the daemon's buffer.
pub static KEYS: Operation<keys::KeyChange> =
    Operation::new("keys", |owner, change, asked| change_key(&mut owner.access, &change, asked))
        .parsed_by(|_, text| keys::KeyChange::parse(text))
        .ignoring_blank();

/// Publishes the gauge's answer to a challenge.
pub static AUTHENTICATE: Operation<Message> = Operation::new("authenticate", |owner, challenge, asked| {
    authenticate(&mut owner.access, challenge, asked)
})
.parsed_by(|_, text| authentication::from_hex(text));

/// Shows what is known of an interrupted write, or settles it as somebody has decided.
pub static SETTLE: Operation<Option<Decision>> =
    Operation::new("settle", |owner, decision, asked| owner.access.settle_as_decided(decision, asked))
        .parsed_by(words::decision)
        .naming_answer()
        .important(Importance::Owed);

/// Shows what is kept of what a gauge with RAM has learned, writes it, or removes it.
pub static LEARNED: Operation<Wish> =
    Operation::new("learned", |owner, wish, asked| owner.memory.keep_learned(&mut owner.access, wish, asked))
        .parsed_by(words::wish)
        .naming_answer();

/// Calibrates the gauge, without polls meanwhile.
pub static CALIBRATE: Operation<Job> = Operation::new("calibrate", |owner, job, asked| {
    calibrate(&mut owner.access, &mut owner.backups, job, asked)
})
.parsed_by(words::job)
.naming_answer();

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

fn go_to(access: &mut Access, goal: Seal, asked: Asked) -> Result<()> {
    if let Some(warning) = passes_sealed(access.shared().published().seal, goal) {
        log::warn!("{}gauge/seal: {warning}", access.shared().prefix);
    }
    let outcome = access.run(|dataflash, gauge| dataflash.go_to(gauge, goal, asked.waited));
    access.publish_seal();
    outcome
}

fn send(access: &mut Access, code: u16) -> Result<()> {
    let outcome = access
        .pay_before_subcommand()
        .and_then(|()| check_takes(access, code))
        .and_then(|()| access.gauge().ask(code));
    access.publish_seal();
    let shared = access.shared();
    // Until then the last answer can be read, with the subcommand that it answers.
    let answer = outcome.inspect_err(|_| shared.publish(|published| published.control = Fact::default()))?;
    shared.publish(|published| published.control.learn(published.presence, (code, answer)));
    log::info!("{}Control(0x{code:04x}) answered 0x{answer:04x}", shared.prefix);
    Ok(())
}

/// Checks that the gauge takes a subcommand: one that is SEALED answers others, and does nothing.
fn check_takes(access: &mut Access, code: u16) -> Result<()> {
    let known = access.chip().subcommand(code);
    let Some(subcommand) = known.filter(|known| !known.sealed) else { return Ok(()) };
    if access.gauge().seal_anew()? != Seal::Sealed {
        return Ok(());
    }
    let why = "a SEALED gauge does not take it, so it was not sent; write `unsealed` to gauge/seal before, and `sealed` \
               afterwards";
    Err(Error::new(subcommand.name, Cause::NotPermitted, why))
}

fn change_key(access: &mut Access, change: &keys::KeyChange, asked: Asked) -> Result<()> {
    let settles = access.owed().is_some();
    let order = access.shared().challenge_order();
    let outcome = access.run(|dataflash, gauge| dataflash.change_key(gauge, change, order, asked.waited));
    if settles {
        access.after_settling();
    }
    access.publish_seal();
    outcome?;
    log::info!("{}{} key: changed and tried", access.shared().prefix, change.name.as_str());
    Ok(())
}

fn authenticate(access: &mut Access, challenge: Message, asked: Asked) -> Result<()> {
    let order = access.shared().challenge_order();
    let digest = authentication::ask(access.gauge(), &challenge, order, asked.waited);
    let shared = access.shared();
    let digest = digest.inspect_err(|_| shared.publish(|published| published.digest = Fact::default()))?;
    shared.publish(|published| published.digest.learn(published.presence, (challenge, digest)));
    Ok(())
}

impl Owner {
    fn set_interval(&mut self, interval: Duration, _: Asked) -> Result<()> {
        // By a longer interval it may seem that it has been there all the time.
        if self.shared().published().snapshot.is_some() && !self.shared().is_present() {
            self.shared().begin_presence();
        }
        self.shared().publish(|published| published.interval = interval);
        Ok(())
    }

    fn look_at_adapter(&mut self) -> Result<()> {
        self.access.gauge().release_if_gone();
        if self.access.schedule().has_failed() {
            self.poll_on_time();
        }
        Ok(())
    }

    fn write(&mut self, changes: Vec<Change>, asked: Asked) -> Result<()> {
        self.write_all(&changes, asked.waited).map_err(|error| match changes.len() {
            1 => error,
            _ => error.within("df/transaction"),
        })
    }

    fn commit(&mut self, (presence, changes): (Epoch<Presence>, Vec<Change>), asked: Asked) -> Result<()> {
        if self.shared().published().presence == presence {
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
        let begun = self.access.now();
        if self.access.owed().is_some() {
            self.access.pay();
        }
        let waited = waited + self.access.now().saturating_sub(begun);
        // While something is still owed the write is refused, and what data flash holds is no configuration.
        let unsaved = self.backups.unsaved(self.shared()).filter(|_| self.access.owed().is_none());
        let outcome = match unsaved {
            None => self.access.run(|dataflash, gauge| dataflash.write(gauge, changes, waited)),
            Some(wanted) => {
                let backups = &mut self.backups;
                let save = |shared: &Shared, read: &[Arc<[u8]>]| backups.save_read(shared, read, changes);
                self.access.write_after(changes, &wanted, save, waited)
            }
        };
        match &outcome {
            Ok(Outcome::Unchanged) => {}
            Ok(Outcome::Written { reset: false, .. }) => {
                let touched = |row: &Subclass, change: &Change| match change.row() {
                    Some((subclass, _)) => ptr::eq(subclass, row),
                    None => change.place().subclass == row.id,
                };
                self.shared().forget(|row| changes.iter().any(|change| touched(row, change)));
                self.readings.look_again();
            }
            // After a reset, or a failure, nothing that was read before can be relied on.
            Ok(Outcome::Written { reset: true, .. }) => {
                self.shared().next_content();
                self.access.hurry();
            }
            Err(_) => {
                self.shared().next_content();
                self.shared().doubt_scales_of(changes);
                self.access.hurry();
            }
        }
        written::log(self.shared(), changes, &outcome?);
        Ok(())
    }

    /// Looks anew: forgets what was read of data flash, makes sure that it is the same gauge, and polls it.
    fn refresh(&mut self, submitted: Duration) -> Result<()> {
        self.shared().next_content();
        self.access.suspect();
        // A look since then is as new as was asked for.
        if self.access.schedule().is_newer_than(submitted) && self.identity.was_asked_since(submitted) {
            return Ok(());
        }
        self.access.wait_for_turn();
        self.access.schedule().read_slow_tier();
        self.recognise().and_then(|()| self.update()).inspect_err(|error| self.asked_poll_failed(error))?;
        self.memory.repair_if_overdue(&mut self.access);
        Ok(())
    }

    fn make_report(&mut self, waited: Duration) -> Result<()> {
        let recording = Recording::begin(&mut self.access);
        let outcome = self.poll_for_report();
        let report = recording.end(&mut self.access, outcome.is_ok(), waited);
        outcome.inspect_err(|error| self.asked_poll_failed(error))?;
        let report = Arc::new(report?);
        self.shared().publish(|published| published.report = Some(report));
        self.shared().succeeded(&REPORT.itself());
        Ok(())
    }

    /// Begins as a mount does, so that the recording can be mounted.
    fn poll_for_report(&mut self) -> Result<()> {
        self.shared().forget_dataflash();
        self.access.suspect();
        self.recognise()?;
        self.access.schedule().begin_anew();
        for _ in 0..report::POLLS {
            self.access.wait_for_turn();
            self.update()?;
        }
        Ok(())
    }

    fn end(&mut self) -> Result<()> {
        self.turn.make_last();
        self.access.pay_for_the_last_time()
    }

    /// The reason to refuse an operation that sends more than a poll does, before anything is sent.
    pub(super) fn refusal(&self, waited: Duration) -> Option<Error> {
        if self.identity.is_unverified() {
            let why =
                "it has not answered yet, so nothing is sent to its address; check that it is connected";
            return Some(Error::new(self.shared().name(), Cause::Gone, why));
        }
        if let Some(error) = self.shared().limitation() {
            return Some(error);
        }
        let why = "the gauge was busy with other requests for too long; nothing was sent, try again";
        let late = || Error::new(self.access.chip().name, Cause::NotNow, why);
        (waited > QUEUE_LIMIT).then(late)
    }
}

#[cfg(test)]
mod tests {
    use super::super::Run;
    use super::super::rig::{INTERVAL, Rig};
    use super::*;
    use crate::error::Cause;
    use gauge_bus::clock::Clock as _;
    use ti_gauge::chip::{Limited, Role, SIBLINGS};
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
    fn an_attempt_that_others_name_is_that_of_its_operation() {
        assert_eq!((SETTLE.itself(), CALIBRATE.itself()), (Attempt::SETTLE, Attempt::CALIBRATE));
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

    /// A bq34110 takes what is written without a reset.
    #[test]
    fn regression_design_capacity_was_shown_as_it_was_before_a_write() {
        let mut rig = Rig::of("bq34110", Run::default());
        rig.start().expect("it answers");
        let chip = rig.handle.chip();
        let shown = |rig: &Rig| {
            let snapshot = rig.handle.published().snapshot.clone().expect("it was polled");
            snapshot.registers().value(chip.register(Role::ChargeFullDesign).expect("it has one"))
        };
        assert_eq!(shown(&rig), Some(2200));
        let row = chip.rows().find(|(_, row)| row.name == "Design Capacity mAh").expect("a row");
        let change = Change::of_value(chip, row, &Value::Int(5200), false).expect("it fits");
        rig.ask(&WRITE, vec![change]).expect("the default key");
        rig.poll_after(INTERVAL);
        assert_eq!(shown(&rig), Some(5200));
    }

    #[test]
    fn a_request_to_a_relative_without_a_table_is_refused() {
        let mut rig = Rig::open();
        rig.owner
            .access
            .shared()
            .publish(|published| published.limited = Some(Limited::Sibling(&SIBLINGS[0])));
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
