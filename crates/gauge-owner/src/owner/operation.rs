// SPDX-License-Identifier: MIT

//! What an operation is, how it is asked for and answered. The operations are the rows of [`super::operations`].

use std::time::Duration;

use nix::errno::Errno;

use super::attempt::Importance;
use super::{Attempt, Handle, Owner};
use crate::error::{Error, Result};
use ti_gauge::chip::Chip;

/// Requests queued for longer are refused, so that write(2) returns within 30 s.
pub(super) const QUEUE_LIMIT: Duration = Duration::from_secs(12);

/// Called with the outcome of a request, as a rule from the owner's thread; must not block.
pub type Done<T> = Box<dyn FnOnce(Result<T>) + Send>;

/// Something that a gauge's owner does when it is asked to: takes an `A`, answers with a `T`.
pub struct Operation<A, T = ()> {
    /// Its name; where it has a file in `gauge/`, also that of the file.
    pub name: &'static str,
    call: fn(&mut Owner, A, Asked) -> Result<T>,
    parse: Option<Parse<A>>,
    ignores_blank: bool,
    names_answer: bool,
    needs_gauge: bool,
    importance: Importance,
    attempt: Option<fn(&A) -> Attempt>,
    reports: bool,
}

/// Reads the argument from what is written to the operation's file.
type Parse<A> = fn(&Context, &[u8]) -> Result<A>;

/// What the text of an argument is read with.
pub struct Context {
    /// The table of its gauge.
    pub chip: &'static Chip,
    /// The factor of voltages in data flash; `None` while it is not known.
    pub voltage_scale: Option<f64>,
    /// The factor of currents in data flash; `None` while it is not known.
    pub current_scale: Option<f64>,
    /// The reason to send nothing but standard commands to the gauge.
    pub limitation: Option<Error>,
}

#[derive(Clone, Copy)]
pub(super) struct Asked {
    pub(super) submitted: Duration,
    /// How long it was in the queue.
    pub(super) waited: Duration,
    /// A number by which its sender knows the answer.
    pub(super) name: Option<u64>,
}

impl Asked {
    pub(super) fn title(self) -> String {
        self.name.map_or(String::new(), |name| format!("#{name:016x}\n"))
    }
}

impl<A, T> Operation<A, T> {
    /// It needs the gauge's table, a device known to be a gauge, and time; a failure is shown until it succeeds.
    pub(super) const fn new(name: &'static str, call: fn(&mut Owner, A, Asked) -> Result<T>) -> Self {
        Self {
            name,
            call,
            parse: None,
            ignores_blank: false,
            names_answer: false,
            needs_gauge: true,
            importance: Importance::Change,
            attempt: None,
            reports: false,
        }
    }

    /// It has a file, whose text is read so.
    pub(super) const fn parsed_by(self, parse: Parse<A>) -> Self {
        Self { parse: Some(parse), ..self }
    }

    /// A blank text does nothing.
    pub(super) const fn ignoring_blank(self) -> Self {
        Self { ignores_blank: true, ..self }
    }

    /// Its answer is shown with the name of the request, if that has one.
    pub(super) const fn naming_answer(self) -> Self {
        Self { names_answer: true, ..self }
    }

    /// It sends no more than a poll does, so it is carried out on any gauge, however late.
    pub(super) const fn of_any_gauge(self) -> Self {
        Self { needs_gauge: false, ..self }
    }

    pub(super) const fn important(self, importance: Importance) -> Self {
        Self { importance, ..self }
    }

    /// Describes the attempt where the name of the operation does not say enough.
    pub(super) const fn attempting(self, attempt: fn(&A) -> Attempt) -> Self {
        Self { attempt: Some(attempt), ..self }
    }

    /// It reports failures itself, where they happen.
    pub(super) const fn reporting(self) -> Self {
        Self { reports: true, ..self }
    }

    /// Whether it has a file.
    pub const fn has_file(&self) -> bool {
        self.parse.is_some()
    }

    /// The attempt to carry it out, whatever its argument is.
    pub(super) const fn itself(&self) -> Attempt {
        Attempt::Operation(self.name, self.importance)
    }

    fn attempt(&self, argument: Option<&A>) -> Attempt {
        match (self.attempt, argument) {
            (Some(attempt), Some(argument)) => attempt(argument),
            _ => self.itself(),
        }
    }
}

/// An operation with a file, whatever its argument is.
pub trait FileOperation: Sync {
    /// Queues a request with the argument that was written, or refuses the text.
    fn ask(&'static self, handle: &Handle, context: &Context, text: &[u8], done: Done<()>);
}

impl<A: Send> FileOperation for Operation<A> {
    fn ask(&'static self, handle: &Handle, context: &Context, text: &[u8], done: Done<()>) {
        let Some(parse) = self.parse.filter(|_| !(self.ignores_blank && text.trim_ascii().is_empty())) else {
            return done(Ok(()));
        };
        let (text, name) = if self.names_answer { named(text) } else { (text, None) };
        match parse(context, text) {
            Ok(argument) => handle.ask_as(self, argument, name, done),
            Err(error) => handle.refuse(self.itself(), error, done),
        }
    }
}

/// A request, and the number at its end that its answer is known by: `show #5d0c66f0`.
fn named(data: &[u8]) -> (&[u8], Option<u64>) {
    let name = data.iter().rposition(|&byte| byte == b'#').and_then(|at| {
        let digits = std::str::from_utf8(&data[at + 1..]).ok()?.trim_end();
        let is_number = digits.bytes().all(|byte| byte.is_ascii_hexdigit());
        Some((at, u64::from_str_radix(digits, 16).ok().filter(|_| is_number)?))
    });
    name.map_or((data, None), |(at, name)| (&data[..at], Some(name)))
}

pub(super) struct Request(Box<dyn Work>);

impl Request {
    /// Carries it out. It was made at that time.
    pub(super) fn carry_out(self, owner: &mut Owner, submitted: Duration) {
        self.0.carry_out(owner, submitted);
    }

    pub(super) fn new<A: Send + 'static, T: 'static>(
        operation: &'static Operation<A, T>,
        argument: A,
        name: Option<u64>,
        gauge: &str,
        done: Done<T>,
    ) -> Self {
        let reply = Reply { gauge: gauge.to_string(), done: Some(done) };
        Self(Box::new(Task { operation, argument, name, reply }))
    }
}

/// The receiver of the answer to a request. One that is dropped answers as well: the owner has ended.
struct Reply<T> {
    gauge: String,
    done: Option<Done<T>>,
}

impl<T> Reply<T> {
    fn answer(mut self, outcome: Result<T>) {
        if let Some(done) = self.done.take() {
            done(outcome);
        }
    }
}

impl<T> Drop for Reply<T> {
    fn drop(&mut self) {
        if let Some(done) = self.done.take() {
            done(Err(Error::host(&self.gauge, Errno::EIO, "its thread has ended")));
        }
    }
}

trait Work: Send {
    fn carry_out(self: Box<Self>, owner: &mut Owner, submitted: Duration);
}

struct Task<A: 'static, T: 'static> {
    operation: &'static Operation<A, T>,
    argument: A,
    name: Option<u64>,
    reply: Reply<T>,
}

impl<A: Send, T> Work for Task<A, T> {
    /// A panic becomes the answer, whether the operation or the callback panicked.
    fn carry_out(self: Box<Self>, owner: &mut Owner, submitted: Duration) {
        let Task { operation, argument, name, reply } = *self;
        let attempt = operation.attempt(Some(&argument));
        let waited = owner.access.now().saturating_sub(submitted);
        let outcome = match owner.refusal(waited).filter(|_| operation.needs_gauge) {
            Some(error) => Err(error),
            None => owner
                .survive(attempt.clone(), |owner| {
                    let outcome = (operation.call)(owner, argument, Asked { submitted, waited, name });
                    match operation.reports {
                        true => outcome,
                        false => owner.shared().logged(attempt.clone(), outcome),
                    }
                })
                .and_then(|outcome| outcome),
        };
        let _ = owner.survive(attempt, |_| reply.answer(outcome));
    }
}
