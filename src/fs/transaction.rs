//! `df/transaction`: lines that stage changes, and one commit that writes them all.
//!
//! The gauge hears of nothing before the commit. A write(2) is staged whole or not at all: a line that
//! is refused leaves the transaction as it was before that write.

use std::sync::{Mutex, MutexGuard};
use std::time::Duration;

use nix::errno::Errno;

use super::raw;
use crate::error::{Cause, Error, Result};
use ti_gauge::chip::{Chip, Kind, Parameter, Subclass};
use ti_gauge::dataflash::Change;
use ti_gauge::text;

/// A transaction that is left open so long is dropped.
const PATIENCE: Duration = Duration::from_secs(600);
/// A write of this size may be a piece of a larger one; where it ends inside a line, nobody knows what
/// the line would have been.
const PIECE: usize = 512;

/// What a gauge's transaction is at.
#[derive(Default)]
pub(super) struct Transaction(Mutex<Option<Open>>);

#[derive(Clone)]
struct Open {
    since: Duration,
    staged: Vec<Change>,
}

impl Open {
    fn is_old(&self, now: Duration) -> bool {
        now.saturating_sub(self.since) >= PATIENCE
    }
}

impl Transaction {
    fn lock(&self) -> MutexGuard<'_, Option<Open>> {
        self.0.lock().expect("no thread panics while it holds the lock")
    }

    /// The staged changes; `None` while no transaction is open.
    pub(super) fn staged(&self, now: Duration) -> Option<Vec<Change>> {
        self.lock().as_ref().filter(|open| !open.is_old(now)).map(|open| open.staged.clone())
    }

    /// Takes the lines of one write(2). Returns the changes that are to be written now, if it commits.
    pub(super) fn write(
        &self,
        chip: &'static Chip,
        allow_unproven: bool,
        now: Duration,
        data: &[u8],
    ) -> Result<Option<Vec<Change>>> {
        let mut open = self.lock();
        let mut next = open.clone();
        let committed = lines(data)?.try_fold(None, |committed, (number, line)| {
            let at = |error: Error| error.within(&format!("line {number}"));
            if committed.is_some() {
                return Err(at(invalid("nothing may follow `commit` in one write")));
            }
            take(&mut next, chip, allow_unproven, now, line).map_err(at)
        });
        let outcome = committed.map_err(|error| error.within("df/transaction"));
        if outcome.is_ok() {
            *open = next;
        } else if open.as_ref().is_some_and(|open| open.is_old(now)) {
            *open = None;
        }
        outcome
    }
}

/// The lines that are not empty, numbered from 1.
fn lines(data: &[u8]) -> Result<impl Iterator<Item = (usize, &str)>> {
    let text = std::str::from_utf8(data).map_err(|_| invalid("not text").within("df/transaction"))?;
    if text.len() >= PIECE && !text.ends_with('\n') {
        let why = format!("a write of {PIECE} bytes and more has to end with a line's newline");
        return Err(invalid(&why).within("df/transaction"));
    }
    let lines = (1..).zip(text.lines().map(str::trim));
    Ok(lines.filter(|(_, line)| !line.is_empty()))
}

fn take(
    open: &mut Option<Open>,
    chip: &'static Chip,
    allow_unproven: bool,
    now: Duration,
    line: &str,
) -> Result<Option<Vec<Change>>> {
    if line == "begin" {
        if open.as_ref().is_some_and(|open| !open.is_old(now)) {
            return Err(busy());
        }
        *open = Some(Open { since: now, staged: Vec::new() });
        return Ok(None);
    }
    let none = |why: &str| Error::host("", Errno::ENODATA, why);
    match open {
        None => Err(none("no transaction is open; write `begin` first")),
        Some(open) if open.is_old(now) => {
            Err(none("it was open for 10 minutes and was dropped; nothing was written"))
        }
        Some(_) if line == "abort" => {
            *open = None;
            Ok(None)
        }
        Some(Open { staged, .. }) if line == "commit" => {
            let changes = std::mem::take(staged);
            *open = None;
            Ok(Some(changes))
        }
        Some(Open { staged, .. }) => {
            let changes = match line.strip_prefix("raw ") {
                Some(raw) => raw::changes(chip, raw)?,
                None => vec![change(chip, allow_unproven, line)?],
            };
            // What is staged twice has the later value. Subclasses may share their rows.
            staged.retain(|other| !changes.iter().any(|change| change.place == other.place));
            staged.extend(changes);
            Ok(None)
        }
    }
}

/// `80/53 3100`, checked as a write to that file is.
fn change(chip: &'static Chip, allow_unproven: bool, line: &str) -> Result<Change> {
    let (place, value) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
    let row = place.split_once('/').and_then(|(subclass, offset)| chip.row(subclass, offset));
    let Some((subclass, parameter)) = row else {
        if place.contains('/') {
            return Err(super::df::unknown(chip, place));
        }
        let why = "write begin, SUBCLASS/OFFSET VALUE, commit or abort; this is none of them";
        return Err(invalid(why));
    };
    check(subclass, parameter, allow_unproven, value.as_bytes())
}

/// The change that a text asks for, checked as far as it can be without the gauge.
pub(super) fn check(
    subclass: &'static Subclass,
    parameter: &'static Parameter,
    allow_unproven: bool,
    text: &[u8],
) -> Result<Change> {
    if subclass.kind == Kind::Security {
        let why = "keys cannot be changed like other parameters";
        return Err(Error::new(parameter.name, Cause::NotPermitted(why.into())));
    }
    if parameter.unproven && !allow_unproven {
        let why = "its address or range is not sure; mount with --allow-unproven to write it";
        return Err(Error::host(parameter.name, Errno::EACCES, why));
    }
    let value = text::parse(parameter, text)?;
    let change = Change::of_value((subclass, parameter), &value).ok_or_else(|| {
        Error::new(parameter.name, Cause::Invalid(format!("does not fit type {}", parameter.kind)))
    })?;
    change.check_least()?;
    Ok(change)
}

/// The answer to whatever a transaction that is open keeps out.
pub(super) fn busy() -> Error {
    let why = "a transaction is open; `commit` or `abort` ends it";
    Error::new("", Cause::Busy(why.into()))
}

fn invalid(why: &str) -> Error {
    Error::new("", Cause::Invalid(why.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tables of the bq27520-G3's two packs are the same rows; one used to take the other's place.
    #[test]
    fn regression_rows_that_subclasses_share_are_staged_apart() {
        let chip = Chip::by_name("bq27520-g3").expect("it has a table");
        let transaction = Transaction::default();
        let lines = b"begin\n91/0 0x55\n92/0 0x55\n92/0 0x00\n";
        assert!(transaction.write(chip, true, Duration::ZERO, lines).expect("lines").is_none());
        let staged = transaction.staged(Duration::ZERO).expect("open");
        let staged: Vec<_> = staged.iter().map(|change| (change.place.subclass, change.bytes[0])).collect();
        assert_eq!(staged, [(91, 0x55), (92, 0x00)]);
    }
}
