// SPDX-License-Identifier: MIT

//! The errors of the core, and what the commands add to them: facts as JSON, and paths in messages.

use std::fmt;
use std::path::Path;

use nix::errno::Errno;
use serde::Serialize;
use serde_json::{Map, Number, Value};
use ti_gauge::dataflash::Place;
use ti_gauge::error::Fact;
pub use ti_gauge::error::{Cause, Error, Reason, Result, Step};
use ti_gauge::text;

/// A path in a message. Another user's path, such as a mount point, may contain line ends.
pub fn shown(path: &Path) -> String {
    text::printable(&path.to_string_lossy())
}

/// An error's facts as an object of `--json`, without what is unknown.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct Details(Map<String, Value>);

impl Details {
    /// The facts of an error; those of a mount daemon come from the daemon.
    pub fn of(error: &Error) -> Self {
        let errno = format!("{:?}", Errno::from_raw(error.errno()));
        if let Some(reported) = error.reported().and_then(|facts| Self::reported(facts, &errno)) {
            return reported;
        }
        let facts = error.facts().into_iter().map(|(name, fact)| (name, json(name, fact)));
        let all = std::iter::once(("errno", errno.into())).chain(facts);
        Self(all.map(|(name, value)| (name.into(), value)).collect())
    }

    /// A daemon's facts about a failure, if they belong to a file operation with this `errno`.
    fn reported(facts: &str, errno: &str) -> Option<Self> {
        let fields: Map<_, _> = serde_json::from_str(facts).ok()?;
        (fields.get("errno")?.as_str()? == errno).then_some(Self(fields))
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
            fields.insert("error".into(), error.to_string().into());
            fields.into()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_facts_of_the_daemon_belong_to_the_same_errno() {
        let refused = |errno: Errno| {
            let error = Error::host("BAT0", errno, "no").reporting(r#"{"errno":"EBUSY","reason":"owed"}"#);
            Details::of(&error).to_string()
        };
        assert_eq!(refused(Errno::EBUSY), r#"{"errno":"EBUSY","reason":"owed"}"#);
        assert_eq!(refused(Errno::EIO), r#"{"cause":"io","errno":"EIO"}"#);
    }
}
