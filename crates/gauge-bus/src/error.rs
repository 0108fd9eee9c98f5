// SPDX-License-Identifier: MIT

//! The error of opening a bus, of reading a recording, and of turning a simulated gauge's knobs.

use std::{fmt, io};

use rustix::io::Errno;

/// A `Result` whose error is [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// The kind of a failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorKind {
    /// A file with invalid contents, or a text that is not understood.
    Invalid,
    /// A number outside of its range.
    OutOfRange,
    /// Not possible on this gauge, or read-only.
    NotPermitted,
    /// No device node of that name.
    NotFound,
    /// The node is not an I2C adapter.
    NotABus,
    /// The adapter has neither plain I2C nor the SMBus commands for words.
    NoWords,
    /// The adapter has a mux, and so another gauge whenever somebody uses another channel.
    HasMux,
    /// A kernel driver or another process uses the address.
    Busy,
    /// The user may not open the node.
    Forbidden,
    /// A file cannot be read or written.
    File(io::ErrorKind),
    /// Any other error of the operating system with the node.
    Io(io::ErrorKind),
}

impl ErrorKind {
    /// The errno of an operation that fails with it.
    pub fn errno(self) -> i32 {
        let errno = match self {
            Self::Invalid => Errno::INVAL,
            Self::OutOfRange => Errno::RANGE,
            Self::NotPermitted => Errno::PERM,
            Self::NotFound => Errno::NOENT,
            Self::NotABus => Errno::NOTTY,
            Self::NoWords | Self::HasMux => Errno::OPNOTSUPP,
            Self::Busy => Errno::BUSY,
            Self::Forbidden => Errno::ACCESS,
            Self::File(kind) | Self::Io(kind) => return errno_of(kind),
        };
        errno.raw_os_error()
    }
}

/// The errno of a kind of error. What has no kind of its own is an input/output error.
pub fn errno_of(kind: io::ErrorKind) -> i32 {
    let errno = match kind {
        io::ErrorKind::NotFound => Errno::NOENT,
        io::ErrorKind::PermissionDenied => Errno::ACCESS,
        io::ErrorKind::StorageFull => Errno::NOSPC,
        io::ErrorKind::QuotaExceeded => Errno::DQUOT,
        io::ErrorKind::ReadOnlyFilesystem => Errno::ROFS,
        io::ErrorKind::NotADirectory => Errno::NOTDIR,
        io::ErrorKind::IsADirectory => Errno::ISDIR,
        io::ErrorKind::ResourceBusy => Errno::BUSY,
        io::ErrorKind::TimedOut => Errno::TIMEDOUT,
        io::ErrorKind::Interrupted => Errno::INTR,
        _ => Errno::IO,
    };
    errno.raw_os_error()
}

/// A kernel driver that is bound to an address.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Driver {
    /// The driver, such as `bq27xxx-battery`.
    pub name: String,
    /// The device it drives, such as `bq34z100`.
    pub device: String,
    /// The number of the adapter on which it is bound.
    pub bus: u64,
}

/// One failure: its subject, its kind, and one line that says what happened and what to do.
#[derive(Clone, PartialEq, Eq)]
pub struct Error {
    /// The node, file, address or knob that the error is about.
    pub subject: String,
    /// Its kind.
    pub kind: ErrorKind,
    /// The failure and its remedy, for the user.
    pub text: String,
    /// The kernel driver that is bound to the address, if that is why.
    pub driver: Option<Box<Driver>>,
}

impl Error {
    /// An error about `subject`.
    pub fn new(subject: impl Into<String>, kind: ErrorKind, text: impl Into<String>) -> Self {
        Self { subject: subject.into(), kind, text: text.into(), driver: None }
    }

    /// A file that cannot be read or written; `what` names what failed.
    pub fn file(subject: impl Into<String>, what: &str, error: &io::Error) -> Self {
        Self::new(subject, ErrorKind::File(error.kind()), format!("{what}: {}", reason(error)))
    }

    #[cfg(feature = "linux")]
    pub(crate) fn io(subject: impl Into<String>, what: &str, error: &io::Error) -> Self {
        Self::new(subject, ErrorKind::Io(error.kind()), format!("{what}: {}", reason(error)))
    }

    pub(crate) fn within(mut self, subject: &str) -> Self {
        self.subject = format!("{subject}: {}", self.subject);
        self
    }
}

/// The system's text for an error, without its number.
pub fn reason(error: &io::Error) -> String {
    let text = error.to_string();
    text.split_once(" (os error").map_or(text.clone(), |(words, _)| words.to_string())
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { subject, text, .. } = self;
        if subject.is_empty() { f.write_str(text) } else { write!(f, "{subject}: {text}") }
    }
}

/// The line of `Display`: `main` prints the error that it returns in this way.
impl fmt::Debug for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl std::error::Error for Error {}
