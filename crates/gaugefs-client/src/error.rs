// SPDX-License-Identifier: MIT

//! Why a mounted gauge did not carry out a request.

use std::path::Path;
use std::{fmt, io};

use nix::errno::Errno;
use ti_gauge::text;

/// A `Result` whose error is [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// A failure as one line: what failed, why, and what to do.
///
/// [`errno`](Self::errno) is that of the file operation, and [`last_error`](Self::last_error) the daemon's explanation.
/// [`source`](std::error::Error::source) is the error of the host, or that of a name, a value or a unit.
pub struct Error(Box<Inner>);

struct Inner {
    /// The gauge's folder, a file or a parameter.
    subject: String,
    /// What could not be done; empty where that is obvious.
    what: String,
    why: Why,
}

enum Why {
    /// A file could not be opened, so the daemon has not heard of the request. The hint adds to the errno.
    Unopened { file: String, hint: &'static str, error: io::Error },
    /// The daemon refused, with its reason.
    Explained { text: String, facts: String, error: io::Error },
    /// The file operation failed, and no explanation certainly belongs to it.
    Failed(io::Error),
    /// A failure of the host, with a remedy.
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
        Self::new(gauge.display().to_string(), Why::Explained { text, facts, error })
    }

    pub(crate) fn failed(gauge: &Path, error: io::Error) -> Self {
        Self::new(gauge.display().to_string(), Why::Failed(error))
    }

    pub(crate) fn host(subject: impl Into<String>, errno: Errno, text: impl Into<String>) -> Self {
        Self::new(subject, Why::Host { text: text.into(), error: errno.into() })
    }

    pub(crate) fn io(subject: impl Into<String>, what: &str, error: io::Error) -> Self {
        let mut failed = Self::new(subject, Why::Failed(error));
        failed.0.what = what.into();
        failed
    }

    pub(crate) fn about(mut self, subject: impl Into<String>) -> Self {
        self.0.subject = subject.into();
        self
    }

    /// Adds what could not be done: `nothing was written`. The daemon's own words stay alone.
    #[must_use]
    pub fn doing(mut self, what: impl Into<String>) -> Self {
        self.0.what = what.into();
        self
    }

    /// The errno of the file operation; `None` for a name, a value or a unit, and for unexpected content.
    pub fn errno(&self) -> Option<i32> {
        self.io_error().and_then(io::Error::raw_os_error)
    }

    pub(crate) fn is(&self, errnos: &[Errno]) -> bool {
        self.errno().is_some_and(|errno| errnos.contains(&Errno::from_raw(errno)))
    }

    /// The text of `gauge/last_error` about this failure. Older texts are left out.
    pub fn last_error(&self) -> Option<&str> {
        match &self.0.why {
            Why::Explained { text, .. } => Some(text),
            _ => None,
        }
    }

    /// The JSON object of `gauge/last_error_facts` about this failure. An empty object if nothing is known.
    pub fn facts(&self) -> Option<&str> {
        match &self.0.why {
            Why::Explained { facts, .. } => Some(facts),
            _ => None,
        }
    }

    /// Whether a file could not be opened, so that the daemon has not heard of the request.
    pub fn is_unopened(&self) -> bool {
        matches!(self.0.why, Why::Unopened { .. })
    }

    /// The gauge's folder, the file or the parameter concerned.
    pub fn subject(&self) -> &str {
        &self.0.subject
    }

    /// The mistake in a name, a value or a unit.
    pub fn refused(&self) -> Option<&ti_gauge::error::Error> {
        match &self.0.why {
            Why::Refused(error) => Some(error),
            _ => None,
        }
    }

    /// The error of the file operation.
    pub fn io_error(&self) -> Option<&io::Error> {
        match &self.0.why {
            Why::Unopened { error, .. } | Why::Explained { error, .. } | Why::Host { error, .. } => {
                Some(error)
            }
            Why::Failed(error) => Some(error),
            Why::Refused(_) => None,
        }
    }

    /// The reason, without the subject and what could not be done.
    pub fn reason(&self) -> String {
        let desc = |error: &io::Error| match error.raw_os_error() {
            Some(errno) => Errno::from_raw(errno).desc().to_string(),
            None => error.to_string(),
        };
        match &self.0.why {
            Why::Unopened { hint, error, .. } => desc(error) + hint,
            Why::Explained { text, .. } | Why::Host { text, .. } => text.clone(),
            Why::Failed(error) => desc(error),
            Why::Refused(error) => error.reason().to_string(),
        }
    }

    /// The line without its subject.
    pub fn text(&self) -> String {
        let (what, reason) = (&*self.0.what, self.reason());
        let file = if let Why::Unopened { file, .. } = &self.0.why { &**file } else { "" };
        let is_plain = matches!(self.0.why, Why::Explained { .. } | Why::Host { .. } | Why::Refused(_));
        let parts = if is_plain { [""; 2] } else { [what, file] };
        let head: String =
            parts.into_iter().filter(|part| !part.is_empty()).map(|part| format!("{part}: ")).collect();
        head + &reason
    }
}

/// One line without control characters: other users choose names of files and processes.
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

/// The line of `Display`: `main` prints the error that it returns in this way.
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

/// A failure of this crate among those of `ti_gauge`, for a program that has both.
impl From<Error> for ti_gauge::error::Error {
    fn from(error: Error) -> Self {
        let text = error.text();
        let Inner { subject, why, .. } = *error.0;
        match why {
            Why::Refused(error) => error,
            Why::Explained { facts, error, .. } => Self::host(subject, error, text).reporting(facts),
            Why::Unopened { error, .. } | Why::Host { error, .. } | Why::Failed(error) => {
                Self::host(subject, error, text)
            }
        }
    }
}
