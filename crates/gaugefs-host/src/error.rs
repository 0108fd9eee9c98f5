// SPDX-License-Identifier: MIT

//! Errors of the program: the core's, with an errno, and the host's.

use std::borrow::Cow;
use std::path::Path;
use std::{fmt, io};

use nix::errno::Errno;
use serde::Serialize;
use serde_json::{Map, Number, Value};
use ti_gauge::dataflash::Place;
use ti_gauge::error::Fact;
pub use ti_gauge::error::{Cause, Reason, Step};
use ti_gauge::image::Faults;
use ti_gauge::text;

/// A `Result` whose error is [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// A path in a message. Another user's path, such as a mount point, may contain line ends.
pub fn shown(path: &Path) -> String {
    text::printable(&path.to_string_lossy())
}

/// A failure as one line that a technician can act on, with the errno for a file operation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error {
    inner: ti_gauge::error::Error,
    /// The mount daemon's details of it.
    told: Option<Box<Details>>,
    /// Further mistakes in the same file.
    others: Vec<ti_gauge::error::Error>,
}

impl Error {
    /// An error about `subject`: a register, a parameter, a file or a bus.
    pub fn new(subject: impl Into<String>, cause: Cause, text: impl Into<Cow<'static, str>>) -> Self {
        ti_gauge::error::Error::new(subject, cause, text).into()
    }

    /// An error whose reason has facts.
    pub fn of(subject: impl Into<String>, reason: Reason) -> Self {
        ti_gauge::error::Error::of(subject, reason).into()
    }

    /// An error of the host, such as a file, a folder or a mount, with its remedy.
    pub fn host(subject: impl Into<String>, errno: Errno, text: impl Into<String>) -> Self {
        ti_gauge::error::Error::host(subject, errno.into(), text).into()
    }

    /// The host's error for the attempt to `what`.
    pub fn io(subject: impl Into<String>, what: &str, error: &io::Error) -> Self {
        ti_gauge::error::Error::io(subject, what, error).into()
    }

    /// Notes whether the error concerns what is owed, unless that is known already.
    #[must_use]
    pub fn owing(self, owed: bool) -> Self {
        Self { inner: self.inner.owing(owed), ..self }
    }

    /// Adds the step in which it happened, unless one is known already.
    #[must_use]
    pub fn at(self, step: Step) -> Self {
        Self { inner: self.inner.at(step), ..self }
    }

    /// Replaces the subject.
    #[must_use]
    pub fn about(self, subject: impl Into<String>) -> Self {
        Self { inner: self.inner.about(subject), ..self }
    }

    /// Puts a larger subject in front.
    #[must_use]
    pub fn within(self, subject: &str) -> Self {
        let others = self.others.into_iter().map(|other| other.within(subject)).collect();
        Self { inner: self.inner.within(subject), told: self.told, others }
    }

    /// The mistakes in a file: the first one, and those that a person is also told.
    pub fn of_file(faults: &Faults) -> Option<Self> {
        let mut all = faults.iter().cloned();
        let mut first = Self::from(all.next()?);
        first.others = all.collect();
        if faults.more() > 0 {
            let why = format!("and {} more mistakes", faults.more());
            first.others.push(ti_gauge::error::Error::new("", Cause::Invalid, why));
        }
        Some(first)
    }

    /// All lines for a person; the first is the error itself.
    pub fn lines(&self) -> impl Iterator<Item = String> {
        let others = self.others.iter().map(|other| text::printable(&other.to_string()));
        std::iter::once(self.to_string()).chain(others)
    }

    /// What happened.
    pub fn cause(&self) -> Cause {
        self.inner.cause()
    }

    /// The line without subject and step.
    pub fn reason(&self) -> &Reason {
        self.inner.reason()
    }

    /// Whether the access has left something to do, or was refused because an earlier one did.
    pub fn is_owed(&self) -> bool {
        self.inner.is_owed()
    }

    /// The step that failed, where there is one.
    pub fn step(&self) -> Option<Step> {
        self.inner.step()
    }

    /// The errno for a file operation.
    pub fn errno(&self) -> Errno {
        Errno::from_raw(self.inner.errno())
    }

    /// The facts for a program.
    pub fn details(&self) -> Details {
        self.told.as_deref().cloned().unwrap_or_else(|| Details::of(&self.inner))
    }
}

/// An error's facts as an object of `--json`, without what is unknown.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct Details(Map<String, Value>);

impl Details {
    fn of(error: &ti_gauge::error::Error) -> Self {
        let errno = ("errno", format!("{:?}", Errno::from_raw(error.errno())).into());
        let facts = error.facts().into_iter().map(|(name, fact)| (name, json(name, fact)));
        Self(std::iter::once(errno).chain(facts).map(|(name, value)| (name.into(), value)).collect())
    }

    /// A daemon's details of a failure, if they belong to a file operation with this `errno`.
    fn told(text: &str, errno: Option<i32>) -> Option<Self> {
        let fields: Map<_, _> = serde_json::from_str(text).ok()?;
        let is_its = fields.get("errno")?.as_str()? == format!("{:?}", Errno::from_raw(errno?));
        is_its.then_some(Self(fields))
    }
}

impl fmt::Display for Details {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&serde_json::to_string(&self.0).map_err(|_| fmt::Error)?)
    }
}

/// Fields with a value, a limit or a reading; they may have decimals.
const NUMBERS: [&str; 6] = ["value", "least", "greatest", "spread", "before", "after"];

fn json(name: &str, fact: Fact) -> Value {
    match fact {
        Fact::Text(text) if NUMBERS.contains(&name) => {
            text.parse::<Number>().map_or_else(|_| text.into(), Value::Number)
        }
        Fact::Yes => true.into(),
        Fact::Number(number) => number.into(),
        Fact::Text(text) => text.into(),
        Fact::Place(place) => Place::from(place).to_string().into(),
        Fact::Failure(error) => {
            let Details(mut fields) = Details::of(&error);
            fields.insert("error".into(), text::printable(&error.to_string()).into());
            fields.into()
        }
    }
}

/// One line without control characters: other users choose names of files and processes.
impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&text::printable(&self.inner.to_string()))
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        self.inner.source()
    }
}

impl From<gaugefs_client::Error> for Error {
    fn from(error: gaugefs_client::Error) -> Self {
        let (subject, text) = (error.subject(), error.text());
        let told = error.facts().and_then(|facts| Details::told(facts, error.errno())).map(Box::new);
        let failed = match (error.refused(), error.io_error()) {
            (Some(refused), _) => refused.clone().into(),
            (None, Some(io)) => match io.raw_os_error() {
                Some(errno) => Self::host(subject, Errno::from_raw(errno), text),
                None => Self::new(subject, Cause::Io(io.kind()), text),
            },
            (None, None) => Self::new(subject, Cause::Io(io::ErrorKind::Other), text),
        };
        Self { told, ..failed }
    }
}

impl From<ti_gauge::error::Error> for Error {
    fn from(inner: ti_gauge::error::Error) -> Self {
        Self { inner, told: None, others: Vec::new() }
    }
}

impl From<gauge_bus::Error> for Error {
    fn from(error: gauge_bus::Error) -> Self {
        ti_gauge::error::Error::from(error).into()
    }
}

impl From<gauge_bus::BusError> for Error {
    fn from(error: gauge_bus::BusError) -> Self {
        ti_gauge::error::Error::from(error).into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_is_one_line_without_control_characters() {
        let error = Error::new("/tmp/a\nb", Cause::Busy, "process 1 (\x1b]0;x\x07)\nwarning: forged");
        assert_eq!(error.to_string(), r"/tmp/a\nb: process 1 (\u{1b}]0;x\u{7})\nwarning: forged");
    }
}
