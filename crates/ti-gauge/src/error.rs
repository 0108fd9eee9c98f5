// SPDX-License-Identifier: MIT

//! What went wrong, at which step, to which register or parameter, and what to do.
//!
//! Every failure is one [`Error`]: one line that a technician can act on, a [`Cause`] that a program can match on, to
//! choose an errno or an exit code, and [`Facts`], so that no program has to read the line.

use std::sync::Arc;
use std::{error, fmt, io};

use gauge_bus::error::reason;
use gauge_bus::{BusError, ErrorKind};

/// A `Result` whose error is [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// The step of an operation that failed, as it is printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Opening the adapter and claiming the address.
    Open,
    /// Reading a standard command.
    Read,
    /// Sending a Control() subcommand or reading its answer.
    Control,
    /// Asking the gauge which part it is.
    Identify,
    /// Checking a value or the gauge's state before anything is touched.
    Check,
    /// Sending key words and confirming the state they lead to.
    Unseal,
    /// Putting the gauge back into the state it was found in.
    Seal,
    /// Selecting a data-flash block and reading it.
    ReadBlock,
    /// Writing a data-flash block and its checksum.
    WriteBlock,
    /// Reading back what was written.
    Verify,
    /// Resetting the gauge so that new data flash takes effect.
    Reset,
    /// Putting the old block back after a failure.
    Restore,
}

impl Step {
    /// The step's name in a message.
    pub fn as_str(self) -> &'static str {
        match self {
            Step::Open => "open",
            Step::Read => "read",
            Step::Control => "Control()",
            Step::Identify => "identify",
            Step::Check => "check",
            Step::Unseal => "unseal",
            Step::Seal => "seal",
            Step::ReadBlock => "read block",
            Step::WriteBlock => "write block",
            Step::Verify => "verify",
            Step::Reset => "reset",
            Step::Restore => "restore",
        }
    }
}

/// The cause of an error. The text says what happened and what to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Not a value of that type, junk after it, or a subcommand that is not safe.
    Invalid(String),
    /// Outside the range of the manual or the narrower safe limits.
    OutOfRange(String),
    /// Sealed and no key works, or not changeable this way.
    NotPermitted(String),
    /// Something else holds the gauge: a transaction, a kernel driver, another process.
    Busy(String),
    /// The gauge cannot do it now: voltage below its flash-update limit, and the like.
    NotNow(String),
    /// The checksum of a block that was read is wrong.
    BadChecksum(String),
    /// The reply breaks the protocol.
    Protocol(String),
    /// The gauge did not finish in time.
    TimedOut(String),
    /// Failed, and the old block was put back and verified.
    RolledBack(String),
    /// Failed, and data flash or seal are unknown or not as they were found.
    StateUnknown(String),
    /// The gauge is gone, or another part answers in its place.
    Gone(String),
    /// Nobody answers at the address.
    NoAnswer(String),
    /// The bus itself failed.
    Bus(BusError),
    /// The bus could not be opened.
    Adapter(ErrorKind, String),
    /// The host failed: a file or a folder.
    Io(io::ErrorKind, String),
}

impl Cause {
    /// Its name for a program, such as `out-of-range`.
    pub fn name(&self) -> &'static str {
        match self {
            Cause::Invalid(_) => "invalid",
            Cause::OutOfRange(_) => "out-of-range",
            Cause::NotPermitted(_) => "not-permitted",
            Cause::Busy(_) => "busy",
            Cause::NotNow(_) => "not-now",
            Cause::BadChecksum(_) => "bad-checksum",
            Cause::Protocol(_) => "protocol",
            Cause::TimedOut(_) => "timed-out",
            Cause::RolledBack(_) => "rolled-back",
            Cause::StateUnknown(_) => "state-unknown",
            Cause::Gone(_) => "gone",
            Cause::NoAnswer(_) => "no-answer",
            Cause::Bus(_) => "bus",
            Cause::Adapter(..) => "adapter",
            Cause::Io(..) => "io",
        }
    }
}

/// What an error is about, as far as it is known. Nothing that a user wrote is among it: that may be a key.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Facts {
    /// The register, as the manual names it.
    pub register: Option<String>,
    /// The place in data flash: the id of its subclass, or [`FLAT`](crate::chip::FLAT), and an offset in bytes.
    pub place: Option<(u8, u16)>,
    /// The least value and the greatest one that are allowed, in the unit of the register or parameter.
    pub limits: Option<[String; 2]>,
    /// What the gauge shows instead, in the same unit.
    pub value: Option<i64>,
    /// The access has left something to do, or was refused because of what an earlier one has left.
    pub owed: bool,
}

/// One failure: subject, step and cause.
#[derive(Clone, Debug)]
pub struct Error {
    subject: String,
    step: Option<Step>,
    cause: Cause,
    /// `None` if nothing is known. It is behind a pointer because every result has room for an error.
    more: Option<Box<More>>,
}

/// What few errors have.
#[derive(Clone, Debug, Default)]
struct More {
    facts: Facts,
    /// The host's own error.
    source: Option<Arc<io::Error>>,
}

/// The host's own error has no equality; cause and text tell it apart.
impl PartialEq for Error {
    fn eq(&self, other: &Self) -> bool {
        let Self { subject, step, cause, more: _ } = self;
        (subject, step, cause, self.facts()) == (&other.subject, &other.step, &other.cause, other.facts())
    }
}

impl Eq for Error {}

impl Error {
    /// An error about `subject`: a register, a parameter, a file or a bus.
    pub fn new(subject: impl Into<String>, cause: Cause) -> Self {
        Self { subject: subject.into(), step: None, cause, more: None }
    }

    /// The host's error; `what` says what failed.
    pub fn io(subject: impl Into<String>, what: &str, error: &io::Error) -> Self {
        // It cannot be copied. Its number can, and its text otherwise.
        let own = error
            .raw_os_error()
            .map_or_else(|| io::Error::new(error.kind(), error.to_string()), io::Error::from_raw_os_error);
        let cause = Cause::Io(error.kind(), format!("{what}: {}", reason(error)));
        let mut error = Self::new(subject, cause);
        error.more().source = Some(Arc::new(own));
        error
    }

    /// An error about a register.
    pub(crate) fn of_register(name: impl Into<String>, cause: Cause) -> Self {
        let name = name.into();
        let mut error = Self::new(name.clone(), cause);
        error.more().facts.register = Some(name);
        error
    }

    fn more(&mut self) -> &mut More {
        self.more.get_or_insert_default()
    }

    /// Notes where in data flash it is, unless that is known already.
    #[must_use]
    pub fn at_place(mut self, place: (u8, u16)) -> Self {
        self.more().facts.place.get_or_insert(place);
        self
    }

    /// Notes which values are allowed.
    #[must_use]
    pub(crate) fn allowing(mut self, least: impl ToString, greatest: impl ToString) -> Self {
        self.more().facts.limits = Some([least.to_string(), greatest.to_string()]);
        self
    }

    /// Notes what the gauge shows.
    #[must_use]
    pub(crate) fn showing(mut self, value: impl Into<i64>) -> Self {
        self.more().facts.value = Some(value.into());
        self
    }

    /// Notes whether it is about what is owed, unless that is known already.
    #[must_use]
    pub fn owing(mut self, owed: bool) -> Self {
        if owed {
            self.more().facts.owed = true;
        }
        self
    }

    /// Adds the step it happened in, unless one is known already.
    #[must_use]
    pub fn at(mut self, step: Step) -> Self {
        self.step.get_or_insert(step);
        self
    }

    /// Replaces the subject, for a caller that knows the parameter's name.
    #[must_use]
    pub fn about(mut self, subject: impl Into<String>) -> Self {
        self.subject = subject.into();
        self
    }

    /// Puts a larger subject in front: the parameter whose transaction failed.
    #[must_use]
    pub fn within(mut self, subject: &str) -> Self {
        if self.subject.is_empty() {
            self.subject = subject.to_string();
        } else if !subject.is_empty() && self.subject != subject {
            self.subject = format!("{subject}: {}", self.subject);
        }
        self
    }

    /// What happened.
    pub fn cause(&self) -> &Cause {
        &self.cause
    }

    /// The step that failed, where there is one.
    pub fn step(&self) -> Option<Step> {
        self.step
    }

    /// What it is about.
    pub fn facts(&self) -> &Facts {
        static NOTHING: Facts = Facts { register: None, place: None, limits: None, value: None, owed: false };
        self.more.as_ref().map_or(&NOTHING, |more| &more.facts)
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Cause::Invalid(text)
            | Cause::OutOfRange(text)
            | Cause::NotPermitted(text)
            | Cause::Busy(text)
            | Cause::NotNow(text)
            | Cause::BadChecksum(text)
            | Cause::Protocol(text)
            | Cause::TimedOut(text)
            | Cause::RolledBack(text)
            | Cause::StateUnknown(text)
            | Cause::Gone(text)
            | Cause::NoAnswer(text)
            | Cause::Adapter(_, text)
            | Cause::Io(_, text) => f.write_str(text),
            Cause::Bus(bus) => bus.fmt(f),
        }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if !self.subject.is_empty() {
            write!(f, "{}: ", self.subject)?;
        }
        if let Some(step) = self.step {
            write!(f, "{}: ", step.as_str())?;
        }
        self.cause.fmt(f)
    }
}

impl error::Error for Error {
    fn source(&self) -> Option<&(dyn error::Error + 'static)> {
        match (self.more.as_ref().and_then(|more| more.source.as_ref()), &self.cause) {
            (Some(host), _) => Some(&**host),
            (None, Cause::Bus(bus)) => Some(bus),
            (None, _) => None,
        }
    }
}

impl From<BusError> for Error {
    fn from(bus: BusError) -> Self {
        Self::new("", Cause::Bus(bus))
    }
}

impl From<gauge_bus::Error> for Error {
    fn from(error: gauge_bus::Error) -> Self {
        Self::new(error.subject, Cause::Adapter(error.kind, error.text))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_subject_that_is_empty_leaves_no_colon() {
        let error = Error::new("Cell Terminate Voltage", Cause::Invalid("x".into()));
        assert_eq!(error.clone().within("").to_string(), "Cell Terminate Voltage: x");
        assert_eq!(error.clone().within("line 3").to_string(), "line 3: Cell Terminate Voltage: x");
        assert_eq!(Error::new("", Cause::Invalid("x".into())).within("").to_string(), "x");
    }

    #[test]
    fn an_error_has_its_source() {
        use std::error::Error as _;
        let bus = Error::new("Voltage()", Cause::Bus(BusError::NoAck));
        assert_eq!(bus.source().expect("the bus").downcast_ref(), Some(&BusError::NoAck));
        let full = io::Error::from_raw_os_error(28);
        let host = Error::io("/tmp/x", "cannot be written", &full);
        let source = host.source().expect("the host").downcast_ref::<io::Error>().expect("its error");
        assert_eq!(source.raw_os_error(), Some(28));
        assert!(Error::new("seal", Cause::Invalid("x".into())).source().is_none());
    }
}
