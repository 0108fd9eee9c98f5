// SPDX-License-Identifier: MIT

//! Errors of the simulator: refused requests, and failures of files on the host.

use std::{fmt, io};

/// A `Result` whose error is [`Error`].
pub(super) type Result<T, E = Error> = std::result::Result<T, E>;

/// What went wrong, for callers to decide by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The text is not understood, or names something that does not exist.
    Invalid,
    /// A number outside its range.
    OutOfRange,
    /// Not possible on this gauge, or read-only.
    NotPermitted,
    /// The host could not read or write the state file.
    Io(io::ErrorKind),
}

/// One failure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error {
    /// The knob, file or part concerned.
    pub subject: String,
    /// The kind of failure.
    pub kind: Kind,
    /// The failure and its remedy, for the user.
    pub text: String,
}

impl Error {
    pub(super) fn new(subject: impl Into<String>, kind: Kind, text: impl Into<String>) -> Self {
        Self { subject: subject.into(), kind, text: text.into() }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.subject, self.text)
    }
}

impl std::error::Error for Error {}
