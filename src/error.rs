//! What went wrong, at which step, to which register or parameter, and what to do.
//!
//! Every failure of gaugefs ends as one [`Error`]: one line that a technician can act on, and the
//! errno that the file operation answers with. The errno is chosen in one place, [`Error::errno`].

use std::{fmt, io};

use nix::errno::Errno;

use crate::bus::BusError;

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
    /// The word that stands for the step in a message.
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

/// The cause of an error: what decides the errno. The text says what happened and what to do.
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
    /// Right now the gauge would not do it: voltage below its flash-update limit, and the like.
    NotNow(String),
    /// The checksum of a block that was read is wrong.
    BadChecksum(String),
    /// The reply breaks the protocol.
    Protocol(String),
    /// The gauge did not do in time what it was asked.
    Slow(String),
    /// Failed, and the old block was put back and verified.
    RolledBack(String),
    /// Failed, and flash content or seal is unknown or not as found.
    Unknown(String),
    /// The gauge is gone, or another part answers in its place.
    Gone(String),
    /// The bus itself failed.
    Bus(BusError),
    /// The host failed: a file, a folder, a mount.
    Host(Errno, String),
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

    /// An error of the host's, with the remedy that fits.
    pub fn host(subject: impl Into<String>, errno: Errno, text: impl Into<String>) -> Self {
        Self::new(subject, Cause::Host(errno, text.into()))
    }

    /// What the host said when it was asked to do `what`.
    pub fn io(subject: impl Into<String>, what: &str, error: &io::Error) -> Self {
        let errno = error.raw_os_error().map(Errno::from_raw);
        let why = errno.map_or_else(|| error.to_string(), |errno| errno.desc().to_string());
        Self::host(subject, errno.unwrap_or(Errno::EIO), format!("{what}: {why}"))
    }

    /// The same error with the step it happened in, unless one is known already.
    #[must_use]
    pub fn at(mut self, step: Step) -> Self {
        self.step.get_or_insert(step);
        self
    }

    /// The same error about another subject, for a caller that knows the parameter's name.
    #[must_use]
    pub fn about(mut self, subject: impl Into<String>) -> Self {
        self.subject = subject.into();
        self
    }

    /// The same error inside a larger subject: the parameter whose transaction met it.
    #[must_use]
    pub fn within(mut self, subject: &str) -> Self {
        if self.subject.is_empty() {
            self.subject = subject.to_string();
        } else if self.subject != subject {
            self.subject = format!("{subject}: {}", self.subject);
        }
        self
    }

    /// What decides the errno.
    pub fn cause(&self) -> &Cause {
        &self.cause
    }

    /// The step that failed, where there is one.
    pub fn step(&self) -> Option<Step> {
        self.step
    }

    /// The errno that a file operation answers with.
    pub fn errno(&self) -> Errno {
        match &self.cause {
            Cause::Invalid(_) => Errno::EINVAL,
            Cause::OutOfRange(_) => Errno::ERANGE,
            Cause::NotPermitted(_) => Errno::EPERM,
            Cause::Busy(_) => Errno::EBUSY,
            Cause::NotNow(_) => Errno::EAGAIN,
            Cause::BadChecksum(_) => Errno::EBADMSG,
            Cause::Protocol(_) => Errno::EPROTO,
            Cause::Slow(_) => Errno::ETIMEDOUT,
            Cause::RolledBack(_) => Errno::EIO,
            Cause::Unknown(_) => Errno::ENOTRECOVERABLE,
            Cause::Gone(_) => Errno::ENODEV,
            Cause::Bus(bus) => bus.errno(),
            Cause::Host(errno, _) => *errno,
        }
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
            | Cause::Slow(text)
            | Cause::RolledBack(text)
            | Cause::Unknown(text)
            | Cause::Gone(text)
            | Cause::Host(_, text) => f.write_str(text),
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
