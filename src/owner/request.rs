//! What the owner can be asked to do, and how it does it.

use std::ptr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use super::{Attempt, Loss, Owner, Seal};
use crate::error::{Cause, Error, Result};
use ti_gauge::authentication::{self, Message};
use ti_gauge::calibration::Job;
use ti_gauge::chip::{Parameter, Subclass};
use ti_gauge::codec;
use ti_gauge::dataflash::{Change, Decision, Outcome, Place};
use ti_gauge::keys;
use ti_gauge::text;
use ti_gauge::unit;

/// Requests queued longer than this are refused, so that write(2) returns within 30 s.
const QUEUE_LIMIT: Duration = Duration::from_secs(12);

/// Called from the owner's thread with the outcome of a request; must not block.
pub type Done<T> = Box<dyn FnOnce(Result<T>) + Send>;

/// What the file system may ask of a gauge's owner.
pub enum Request {
    /// Read subclasses, by their indices in the table. Those that are kept and still valid cost nothing.
    Read(Vec<usize>, Done<Vec<Arc<[u8]>>>),
    /// Write parameters, all or none. Their ranges have been checked.
    WriteAll(Vec<Change>, Done<()>),
    /// Go to a seal state.
    Seal(Seal, Done<()>),
    /// Send a subcommand that the table marks safe.
    Control(u16, Done<()>),
    /// Change one of the gauge's keys.
    ChangeKey(keys::KeyChange, Done<()>),
    /// Publish the gauge's answer to a challenge.
    Authenticate(Message, Done<()>),
    /// Show what is known of an interrupted write, or settle it as somebody has decided.
    Settle(Option<Decision>, Done<()>),
    /// Calibrate the gauge, without polls meanwhile.
    Calibrate(Job, Done<()>),
    /// Publish a report of the gauge.
    Report(Done<()>),
    /// Poll now, and forget what was read of data flash.
    Refresh(Done<()>),
    /// Change the time between polls.
    Interval(Duration, Done<()>),
    /// Pay what is owed for the last time; an error says what remains.
    End(Done<()>),
    /// The adapter's device node has come or gone: release it, or see whether the gauge is back.
    Look,
}

impl Request {
    /// Whether it sends anything but what a poll reads. Such a request needs the gauge's table, a device that
    /// is known to be a gauge, and an answer in time.
    fn goes_beyond_polling(&self) -> bool {
        match self {
            Request::Read(..)
            | Request::WriteAll(..)
            | Request::Seal(..)
            | Request::Control(..)
            | Request::ChangeKey(..)
            | Request::Authenticate(..)
            | Request::Settle(..)
            | Request::Calibrate(..) => true,
            Request::Report(_)
            | Request::Refresh(_)
            | Request::Interval(..)
            | Request::End(_)
            | Request::Look => false,
        }
    }

    /// What it attempts.
    pub(super) fn attempt(&self) -> Attempt {
        match self {
            Request::Read(wanted, _) => Attempt::Read(wanted.clone()),
            Request::WriteAll(changes, _) => Attempt::Write(places(changes)),
            Request::Seal(..) => Attempt::Seal,
            Request::Control(..) => Attempt::Control,
            Request::ChangeKey(..) => Attempt::Key,
            Request::Authenticate(..) => Attempt::Authenticate,
            Request::Settle(..) => Attempt::Settle,
            Request::Calibrate(..) => Attempt::Calibrate,
            Request::Interval(..) => Attempt::Interval,
            Request::End(_) => Attempt::Settle,
            Request::Report(_) => Attempt::Report,
            Request::Refresh(_) | Request::Look => Attempt::Poll,
        }
    }

    /// Returns the request, and what answers it if it is dropped without an answer.
    pub(super) fn or_else_answered(self) -> (Self, Unanswered) {
        match self {
            Request::Read(wanted, done) => share(done, |done| Request::Read(wanted, done)),
            Request::WriteAll(changes, done) => share(done, |done| Request::WriteAll(changes, done)),
            Request::Seal(goal, done) => share(done, |done| Request::Seal(goal, done)),
            Request::Control(code, done) => share(done, |done| Request::Control(code, done)),
            Request::ChangeKey(change, done) => share(done, |done| Request::ChangeKey(change, done)),
            Request::Authenticate(message, done) => share(done, |done| Request::Authenticate(message, done)),
            Request::Settle(decision, done) => share(done, |done| Request::Settle(decision, done)),
            Request::Calibrate(job, done) => share(done, |done| Request::Calibrate(job, done)),
            Request::Report(done) => share(done, Request::Report),
            Request::Refresh(done) => share(done, Request::Refresh),
            Request::Interval(interval, done) => share(done, |done| Request::Interval(interval, done)),
            Request::End(done) => share(done, Request::End),
            Request::Look => (Request::Look, Box::new(drop)),
        }
    }

    /// Answers with an error instead of carrying it out.
    fn refuse(self, error: Error) {
        match self {
            Request::Read(_, done) => done(Err(error)),
            Request::WriteAll(_, done)
            | Request::Seal(_, done)
            | Request::Control(_, done)
            | Request::ChangeKey(_, done)
            | Request::Authenticate(_, done)
            | Request::Settle(_, done)
            | Request::Calibrate(_, done)
            | Request::Report(done)
            | Request::Refresh(done)
            | Request::Interval(_, done)
            | Request::End(done) => done(Err(error)),
            Request::Look => {}
        }
    }
}

/// Answers a request that nothing else has answered.
pub(super) type Unanswered = Box<dyn FnOnce(Error)>;

/// Shares the answer to a request: whoever answers first has answered.
fn share<T: 'static>(done: Done<T>, request: impl FnOnce(Done<T>) -> Request) -> (Request, Unanswered) {
    let first = Arc::new(Mutex::new(Some(done)));
    let second = first.clone();
    let take = |shared: &Mutex<Option<Done<T>>>| shared.lock().unwrap_or_else(PoisonError::into_inner).take();
    let answer = move |outcome| take(&first).map_or((), |done| done(outcome));
    (request(Box::new(answer)), Box::new(move |error| take(&second).map_or((), |done| done(Err(error)))))
}

/// Where changes are.
fn places(changes: &[Change]) -> Vec<Place> {
    changes.iter().map(Change::place).collect()
}

/// What has to be known of a change of the seal state that leads through SEALED.
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
    let show = |bytes: &[u8]| match change.row() {
        Some((_, parameter)) => unit::show(parameter, &codec::decode(parameter.kind, bytes)),
        None => text::hex(bytes),
    };
    let unit = match change.row() {
        // The number says that already.
        None | Some((_, Parameter { unit: "hex", .. })) => String::new(),
        Some((_, parameter)) => unit::suffix(parameter),
    };
    format!("{} -> {}{unit}", show(old), show(&new))
}

impl Owner {
    /// Why a request is refused before anything is sent, if it is.
    fn refusal(&self, request: &Request, waited: Duration) -> Option<Error> {
        if !request.goes_beyond_polling() {
            return None;
        }
        if self.unverified {
            let why =
                "it has not answered yet, so nothing is sent to its address; check that it is connected";
            return Some(Error::new(self.shared.name(), Cause::Gone(why.into())));
        }
        if let Some(error) = self.limitation() {
            return Some(error);
        }
        let why = "the gauge was busy with other requests for too long; nothing was sent, try again";
        let late = || Error::new(self.gauge.chip.name, Cause::NotNow(why.into()));
        (waited > QUEUE_LIMIT).then(late)
    }

    /// Carries out a request that was submitted at that time.
    pub(super) fn serve(&mut self, submitted: Duration, request: Request) {
        let waited = self.gauge.clock.now().saturating_sub(submitted);
        if let Some(error) = self.refusal(&request, waited) {
            return request.refuse(error);
        }
        let attempt = request.attempt();
        match request {
            Request::Read(wanted, done) => done(self.read(&wanted, waited)),
            Request::WriteAll(changes, done) => {
                let outcome = self.write(&changes, waited).map_err(|error| match changes.len() {
                    1 => error,
                    _ => error.within("df/transaction"),
                });
                done(self.logged(attempt, outcome));
            }
            Request::Seal(goal, done) => {
                if let Some(warning) = passes_sealed(self.shared.published().seal, goal) {
                    log::warn!("{}gauge/seal: {warning}", self.shared.prefix);
                }
                let outcome = self.dataflash.go_to(&mut self.gauge, goal, waited);
                self.note_debt();
                self.publish_seal();
                done(self.logged(attempt, outcome));
            }
            Request::Control(code, done) => {
                // Clear the previous answer first, or it could be taken for this one's.
                self.shared.publish(|published| published.control = None);
                let outcome = self.settled_first().and_then(|()| Ok(self.gauge.ask(code)?));
                self.publish_seal();
                let prefix = &self.shared.prefix;
                done(self.logged(attempt, outcome).map(|answer| {
                    self.shared.publish(|published| published.control = Some((code, answer)));
                    log::info!("{prefix}Control(0x{code:04x}) answered 0x{answer:04x}");
                }));
            }
            Request::ChangeKey(change, done) => {
                let order = self.shared.auth_order;
                let settles = self.dataflash.owed().is_some();
                let outcome = self.dataflash.change_key(&mut self.gauge, &change, order, waited);
                if settles {
                    self.after_settling();
                }
                self.note_debt();
                self.publish_seal();
                let (prefix, name) = (&self.shared.prefix, change.name.as_str());
                done(
                    self.logged(attempt, outcome)
                        .map(|()| log::info!("{prefix}{name} key: changed and tried")),
                );
            }
            Request::Authenticate(challenge, done) => {
                // The last digest is no answer to this challenge, even if this one fails.
                self.shared.publish(|published| published.digest = None);
                let order = self.shared.auth_order;
                let digest = authentication::ask(&mut self.gauge, &challenge, order, waited);
                done(self.logged(attempt, digest).map(|digest| {
                    self.shared.publish(|published| published.digest = Some(digest));
                }));
            }
            Request::Settle(decision, done) => done(self.settle_as_decided(decision, waited)),
            Request::Calibrate(job, done) => {
                let outcome = self.calibrate(&job, waited);
                done(self.logged(attempt, outcome));
            }
            Request::Report(done) => done(self.make_report(waited)),
            Request::Refresh(done) => done(self.refresh(submitted)),
            Request::End(done) => done(self.end()),
            Request::Interval(interval, done) => {
                self.shared.publish(|published| published.interval = interval);
                self.shared.succeeded(&attempt);
                done(Ok(()));
            }
            Request::Look => {
                self.gauge.release_if_gone();
                if self.schedule.has_failed() {
                    self.poll_on_time();
                }
            }
        }
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
                let why =
                    format!("no subcommand is sent while an interrupted access is not settled: {}", owed.why);
                Err(Error::new(self.gauge.chip.name, Cause::Busy(why)))
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
        let is_settled = self.dataflash.owed().is_none() && !matches!(self.loss, Loss::Owed { .. });
        if self.looked || !is_settled || published.limited.is_some() || published.seal == Seal::Sealed {
            return;
        }
        // A failure is in the log, and no reason to do without the gauge; the next look follows a change.
        self.looked = true;
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
    fn keep(
        &mut self,
        wanted: &[usize],
        read: ti_gauge::error::Result<Vec<Vec<u8>>>,
    ) -> Result<Vec<Arc<[u8]>>> {
        self.note_debt();
        let first = &self.gauge.chip.subclasses[wanted[0]];
        let read = read.map_err(|error| error.within(&format!("df of {}", first.name)));
        let read = self.logged(Attempt::Read(wanted.to_vec()), read)?;
        let read: Vec<Arc<[u8]>> = read.into_iter().map(Arc::from).collect();
        if self.dataflash.doubts() {
            log::warn!("{}: another pack answers, as data flash shows; it is read anew", self.shared.name());
            self.forget_dataflash();
            self.schedule.hurry();
        }
        for (&index, bytes) in wanted.iter().zip(&read) {
            self.shared.keep(index, bytes.clone(), self.schedule.number());
        }
        self.report_quirks();
        Ok(read)
    }

    fn write(&mut self, changes: &[Change], waited: Duration) -> Result<()> {
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
        self.note_debt();
        match &outcome {
            Ok(Outcome::Unchanged) => {}
            Ok(Outcome::Written { reset: false, .. }) => {
                let touched = |row: &Subclass, change: &Change| match change.row() {
                    Some((subclass, _)) => ptr::eq(subclass, row),
                    None => change.place().subclass == row.id,
                };
                self.shared.forget(|row| changes.iter().any(|change| touched(row, change)));
                self.looked = false;
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
        let register = self.gauge.chip.serial_register().and_then(|code| self.gauge.chip.register_at(code));
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
        self.recognise().and_then(|()| self.update()).inspect_err(|error| self.poll_failed(error))
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
    use super::super::Startup;
    use super::super::rig::Rig;
    use super::*;
    use gauge_bus::clock::Clock as _;
    use ti_gauge::chip::{Limited, SIBLINGS};
    use ti_gauge::dataflash::Change;
    use ti_gauge::value::Value;

    /// One of each request that sends more than a poll reads.
    fn requests(rig: &Rig) -> Vec<Box<dyn FnOnce(Done<()>) -> Request>> {
        let discharge = rig.index(80);
        let change = change(rig, "3100");
        let key = || keys::KeyChange::parse(b"unseal 0414 3672 1234 5678").expect("two keys");
        let read = move |done: Done<()>| {
            Request::Read(vec![discharge], Box::new(move |read| done(read.map(|_| ()))))
        };
        vec![
            Box::new(read),
            Box::new(|done| Request::WriteAll(vec![change], done)),
            Box::new(|done| Request::Seal(Seal::Unsealed, done)),
            Box::new(|done| Request::Control(0x0002, done)),
            Box::new(move |done| Request::ChangeKey(key(), done)),
            Box::new(|done| Request::Authenticate([0; 20], done)),
        ]
    }

    /// Another value for Cell Terminate Voltage.
    fn change(rig: &Rig, text: &str) -> Change {
        let subclass = &rig.handle.chip().subclasses[rig.index(80)];
        let parameter = subclass.parameter(53).expect("a parameter of the table");
        let value = Value::Int(text.parse().expect("a number"));
        Change::of_value((subclass, parameter), &value, false).expect("it fits")
    }

    /// Nothing is sent for a request that is refused.
    fn refused(rig: &mut Rig, delay: Duration, is_right: impl Fn(&Error) -> bool) {
        let (flash, transfers) = (rig.sim.flash(), rig.transfers());
        for request in requests(rig) {
            let error = rig.ask_late(delay, request).expect_err("it is refused");
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
        rig.ask(|done| Request::Seal(Seal::FullAccess, done)).expect("the default keys");
        assert!(passes_sealed(rig.handle.published().seal, Seal::Unsealed).is_some());
    }

    #[test]
    fn a_change_is_described_by_old_and_new_value() {
        let chip = ti_gauge::chip::Chip::by_name("bq34z100-g1").expect("it has a table");
        let of = |id: &str, offset: &str, old: &[u8], new: &[u8]| {
            let row = chip.row(id, offset).expect("a parameter of the table");
            let value = codec::decode(row.1.kind, new);
            difference(&Change::of_value(row, &value, true).expect("a value in range"), old)
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
        refused(&mut rig, late, |error| matches!(error.cause(), Cause::NotNow(_)));
        // These are as good late as at once.
        rig.ask_late(late, Request::Refresh).expect("it is polled");
        rig.ask_late(late, |done| Request::Interval(late, done)).expect("it is set");
    }

    #[test]
    fn requests_are_carried_out_up_to_the_limit() {
        let mut rig = Rig::open();
        rig.ask_late(QUEUE_LIMIT, |done| Request::Control(0x0002, done)).expect("it answers");
        let change = change(&rig, "3100");
        rig.ask(|done| Request::WriteAll(vec![change], done)).expect("the default key");
        let index = rig.index(80);
        let read = rig.ask(|done| Request::Read(vec![index], done)).expect("the default key");
        assert_eq!(read[0][53..55], 3100_u16.to_be_bytes());
        assert!(rig.ask(|done| Request::Read(vec![], done)).expect("nothing to read").is_empty());
    }

    #[test]
    fn a_request_to_a_relative_without_a_table_is_refused() {
        let mut rig = Rig::open();
        rig.owner.shared.publish(|published| published.limited = Some(Limited::Sibling(&SIBLINGS[0])));
        refused(&mut rig, Duration::ZERO, |error| {
            matches!(error.cause(), Cause::NotPermitted(_)) && error.to_string().starts_with(SIBLINGS[0].name)
        });
        rig.owner.poll().expect("its standard commands are read");
    }

    #[test]
    fn a_failure_is_shown_until_what_had_failed_succeeds() {
        let mut rig = Rig::open();
        let shown = |rig: &Rig| rig.handle.published().last_error.to_string();
        let write = |rig: &mut Rig, value| {
            let change = change(rig, value);
            rig.ask(|done| Request::WriteAll(vec![change], done))
        };
        rig.sim.set("voltage_mv", "2700").expect("a knob");
        write(&mut rig, "3100").expect_err("the voltage is too low");
        let failure = shown(&rig);
        assert!(failure.contains("Cell Terminate Voltage") && rig.handle.published().failed.is_some());
        // None of these is what had failed.
        let index = rig.index(48);
        rig.ask(Request::Refresh).expect("it answers");
        rig.ask(|done| Request::Read(vec![index], done)).expect("the default key");
        rig.ask(|done| Request::Seal(Seal::Unsealed, done)).expect("the default key");
        rig.ask(|done| Request::Seal(Seal::Sealed, done)).expect("it is sealed");
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
        let mut rig = Rig::new(Startup { unverified: true, ..Startup::default() });
        refused(&mut rig, Duration::ZERO, |error| matches!(error.cause(), Cause::Gone(_)));
        rig.owner.open().expect("it reads like a gauge");
        rig.ask(|done| Request::Control(0x0002, done)).expect("it is one");
    }

    #[test]
    fn a_failed_write_of_one_parameter_is_named_after_it() {
        let mut rig = Rig::open();
        rig.sim.set("voltage_mv", "2700").expect("a knob");
        let (one, two) = (change(&rig, "3100"), [change(&rig, "3100"), change(&rig, "3200")]);
        let error = rig.ask(|done| Request::WriteAll(vec![one], done)).expect_err("the voltage is too low");
        assert!(error.to_string().starts_with("Cell Terminate Voltage (80/53): "), "{error}");
        assert_eq!(*rig.handle.published().last_error, *error.to_string());
        let error = rig.ask(|done| Request::WriteAll(two.into(), done)).expect_err("the voltage is too low");
        assert!(error.to_string().starts_with("df/transaction: "), "{error}");
    }
}
