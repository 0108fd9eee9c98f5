// SPDX-License-Identifier: MIT

//! Why a mounted gauge did not do what was asked of it.

use std::path::Path;
use std::{fmt, io};

use nix::errno::Errno;
use ti_gauge::text;

/// A `Result` whose error is [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// One failure: one line that says what failed, why, and what to do.
///
/// [`errno`](Self::errno) is that of the file operation, and [`last_error`](Self::last_error) is what the daemon says
/// about it. [`source`](std::error::Error::source) is the error of the host, or that of a name, a value or a unit.
pub struct Error(Box<Inner>);

struct Inner {
    /// The gauge's folder, a file or a parameter.
    subject: String,
    /// What could not be done; empty where that is plain.
    what: String,
    why: Why,
}

enum Why {
    /// A file could not be opened, so the daemon has not heard of it; and what may be said about that beside the errno.
    Unopened { file: String, hint: &'static str, error: io::Error },
    /// The daemon has refused it, and says why.
    Told { text: String, facts: String, error: io::Error },
    /// The file operation has failed, and nothing else is certain to be about it.
    Failed(io::Error),
    /// What the host has, and a remedy.
    Host { text: String, error: io::Error },
    /// A name, a value or a unit.
    Refused(ti_gauge::error::Error),
}

impl Error {
    fn new(subject: impl Into<String>, why: Why) -> Self {
        Self(Box::new(Inner { subject: subject.into(), what: String::new(), why }))
    }

    pub(crate) fn unopened(gauge: &Path, file: &str, hint: &'static str, error: io::Error) -> Self {
        Self::new(gauge.display().to_string(), Why::Unopened { file: file.into(), hint, error })
    }

    pub(crate) fn told(gauge: &Path, text: String, facts: String, error: io::Error) -> Self {
        Self::new(gauge.display().to_string(), Why::Told { text, facts, error })
    }

    pub(crate) fn failed(gauge: &Path, error: io::Error) -> Self {
        Self::new(gauge.display().to_string(), Why::Failed(error))
    }

    /// An error of the host, with the remedy.
    pub(crate) fn host(subject: impl Into<String>, errno: Errno, text: impl Into<String>) -> Self {
        Self::new(subject, Why::Host { text: text.into(), error: errno.into() })
    }

    /// What the host said when it was asked to do `what`.
    pub(crate) fn io(subject: impl Into<String>, what: &str, error: io::Error) -> Self {
        let mut failed = Self::new(subject, Why::Failed(error));
        failed.0.what = what.into();
        failed
    }

    /// Says what it is about.
    pub(crate) fn about(mut self, subject: impl Into<String>) -> Self {
        self.0.subject = subject.into();
        self
    }

    /// Says what could not be done: `nothing was written`. What the daemon says stands for itself.
    #[must_use]
    pub fn doing(mut self, what: impl Into<String>) -> Self {
        self.0.what = what.into();
        self
    }

    /// The errno that the file operation has answered with. There is none where a name, a value or a unit is refused
    /// before any file is touched, or where a file is not what it should be.
    pub fn errno(&self) -> Option<i32> {
        self.io_error().and_then(io::Error::raw_os_error)
    }

    /// Whether the errno is one of these.
    pub(crate) fn is(&self, errnos: &[Errno]) -> bool {
        self.errno().is_some_and(|errno| errnos.contains(&Errno::from_raw(errno)))
    }

    /// What `gauge/last_error` says about this failure. An older text there is left out.
    pub fn last_error(&self) -> Option<&str> {
        match &self.0.why {
            Why::Told { text, .. } => Some(text),
            _ => None,
        }
    }

    /// What `gauge/last_error_facts` has on this failure: one JSON object. It is empty if that is not known.
    pub fn facts(&self) -> Option<&str> {
        match &self.0.why {
            Why::Told { facts, .. } => Some(facts),
            _ => None,
        }
    }

    /// Whether a file could not even be opened, so that the daemon has not heard of the request.
    pub fn is_unopened(&self) -> bool {
        matches!(self.0.why, Why::Unopened { .. })
    }

    /// The gauge's folder, the file or the parameter that it is about.
    pub fn subject(&self) -> &str {
        &self.0.subject
    }

    /// What is wrong with a name, a value or a unit.
    pub fn refused(&self) -> Option<&ti_gauge::error::Error> {
        match &self.0.why {
            Why::Refused(error) => Some(error),
            _ => None,
        }
    }

    /// The error of the file operation.
    pub fn io_error(&self) -> Option<&io::Error> {
        match &self.0.why {
            Why::Unopened { error, .. } | Why::Told { error, .. } | Why::Host { error, .. } => Some(error),
            Why::Failed(error) => Some(error),
            Why::Refused(_) => None,
        }
    }

    /// Why, without what it is about and what could not be done.
    pub fn reason(&self) -> String {
        let desc = |error: &io::Error| match error.raw_os_error() {
            Some(errno) => Errno::from_raw(errno).desc().to_string(),
            None => error.to_string(),
        };
        match &self.0.why {
            Why::Unopened { hint, error, .. } => desc(error) + hint,
            Why::Told { text, .. } | Why::Host { text, .. } => text.clone(),
            Why::Failed(error) => desc(error),
            Why::Refused(error) => error.reason().to_string(),
        }
    }

    /// The line without what it is about.
    pub fn text(&self) -> String {
        let (what, reason) = (&*self.0.what, self.reason());
        let file = if let Why::Unopened { file, .. } = &self.0.why { &**file } else { "" };
        let is_plain = matches!(self.0.why, Why::Told { .. } | Why::Host { .. } | Why::Refused(_));
        let parts = if is_plain { [""; 2] } else { [what, file] };
        let head: String =
            parts.into_iter().filter(|part| !part.is_empty()).map(|part| format!("{part}: ")).collect();
        head + &reason
    }
}

/// One line without control characters: names of files and processes in it may be anybody's.
impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let line = match &self.0.why {
            Why::Refused(error) => error.to_string(),
            _ if self.0.subject.is_empty() => self.text(),
            _ => format!("{}: {}", self.0.subject, self.text()),
        };
        f.write_str(&text::printable(&line))
    }
}

/// The same line: it is how `main` prints the error that it returns.
impl fmt::Debug for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self.io_error() {
            Some(error) => Some(error),
            None => self.refused().map(|error| error as &dyn std::error::Error),
        }
    }
}

impl From<ti_gauge::error::Error> for Error {
    fn from(error: ti_gauge::error::Error) -> Self {
        Self::new("", Why::Refused(error))
    }
}
