// SPDX-License-Identifier: MIT

//! The error of opening a bus or reading a recording.

use std::{fmt, io};

/// A `Result` whose error is [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// The kind of a failure; callers that need an errno or an exit code match on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorKind {
    /// A file with invalid contents.
    Invalid,
    /// No device node of that name.
    NotFound,
    /// The node is not an I2C adapter.
    NotABus,
    /// The adapter has only SMBus commands, not plain I2C.
    SmbusOnly,
    /// A kernel driver or another process uses the address.
    Busy,
    /// The user may not open the node.
    Forbidden,
    /// Any other error of the operating system.
    Io(io::ErrorKind),
}

/// One failure: its subject, its kind, and one line that says what happened and what to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error {
    /// The node, file or address that the error is about.
    pub subject: String,
    /// Its kind.
    pub kind: ErrorKind,
    /// The failure and its remedy, for the user.
    pub text: String,
}

impl Error {
    pub(crate) fn new(subject: impl Into<String>, kind: ErrorKind, text: impl Into<String>) -> Self {
        Self { subject: subject.into(), kind, text: text.into() }
    }

    pub(crate) fn io(subject: impl Into<String>, what: &str, error: &io::Error) -> Self {
        Self::new(subject, ErrorKind::Io(error.kind()), format!("{what}: {}", reason(error)))
    }

    /// Puts a larger subject in front, such as the file that contains the line.
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

impl std::error::Error for Error {}
