//! What went wrong, at which step, to which register or parameter, and what to do.
//!
//! Every failure is one [`Error`]: one line that a technician can act on, and a [`Cause`] that a program
//! can match on, to choose an errno or an exit code.

use std::{fmt, io};

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

/// One failure: subject, step and cause.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error {
    subject: String,
    step: Option<Step>,
    cause: Cause,
}

impl Error {
    /// An error about `subject`: a register, a parameter, a file or a bus.
    pub fn new(subject: impl Into<String>, cause: Cause) -> Self {
        Self { subject: subject.into(), step: None, cause }
    }

    /// The host's error; `what` says what failed.
    pub fn io(subject: impl Into<String>, what: &str, error: &io::Error) -> Self {
        Self::new(subject, Cause::Io(error.kind(), format!("{what}: {}", reason(error))))
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

impl std::error::Error for Error {}

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
}
