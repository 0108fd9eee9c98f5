// SPDX-License-Identifier: MIT

//! `df/transaction`: lines that stage changes, and one commit that writes them all.
//!
//! Nothing is written to the gauge before the commit. A write(2) is staged whole or not at all. One that is refused
//! stages nothing and spoils the transaction: a shell passes on each line as a write of its own and goes on after one
//! that fails, so a commit that did not know of it would write the rest. Everything here runs on the thread that
//! answers readers, so it takes time in proportion to what one write(2) brings, whatever is staged already.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use nix::errno::Errno;

use super::raw;
use crate::error::{Cause, Error, Result};
use gauge_owner::Presence;
use ti_gauge::chip::{Chip, Safe, Unnamed};
use ti_gauge::codec::WINDOW;
use ti_gauge::dataflash::{Change, Place};
use ti_gauge::epoch::Epoch;

/// A transaction that is open for longer than this is dropped. So is one whose gauge has gone away since, or is another
/// one: its values were meant for the gauge that was there.
const PATIENCE: Duration = Duration::from_secs(600);
/// Most blocks with undocumented bytes that a transaction can have, 128 KiB: more than any gauge stores, and little
/// enough for the daemon. The chip's table limits the number of parameters.
const RAW_BLOCKS: usize = 4096;

/// The rules for lines.
pub(super) struct Rules<'a> {
    pub(super) chip: &'static Chip,
    pub(super) allow_unproven: bool,
    /// A subclass as the gauge stores it, by its index in the table, if that is known.
    pub(super) stored: &'a dyn Fn(usize) -> Option<Arc<[u8]>>,
    /// See [`Published::presence`](gauge_owner::Published::presence).
    pub(super) presence: Epoch<Presence>,
}

/// The state of a gauge's transaction.
#[derive(Default)]
pub(super) struct Transaction(Mutex<State>);

#[derive(Default)]
struct State {
    open: Option<Open>,
    /// Why lines since the last `begin` or `abort` were refused; nothing is committed then. It outlives the transaction,
    /// for whoever goes on after a commit that failed, or after a write that held the `begin` as well.
    spoiled: Option<Error>,
}

/// When something is asked of a transaction.
#[derive(Clone, Copy)]
pub(super) struct Moment {
    pub(super) now: Duration,
    /// See [`Published::presence`](gauge_owner::Published::presence).
    pub(super) presence: Epoch<Presence>,
}

struct Open {
    since: Moment,
    /// Shared with those who are reading it.
    staged: Arc<Staged>,
}

/// The reason why a transaction was dropped.
#[derive(Clone, Copy)]
enum Dropped {
    Old,
    Left,
}

impl Open {
    fn dropped(&self, at: Moment) -> Option<Dropped> {
        if at.presence != self.since.presence {
            return Some(Dropped::Left);
        }
        (at.now.saturating_sub(self.since.now) >= PATIENCE).then_some(Dropped::Old)
    }
}

/// The staged changes. The later of two changes of one place counts.
#[derive(Clone, Default)]
pub(super) struct Staged {
    /// Parameters, and blocks with undocumented bytes, each with the number of its last line.
    entries: BTreeMap<Key, (u64, Entry)>,
    raw_blocks: usize,
    lines: u64,
}

/// Whether it is a block, its subclass, and its offset there. Subclasses may share their rows.
type Key = (bool, u8, u16);

#[derive(Clone)]
enum Entry {
    Parameter(Change),
    /// Bytes of a block, and a bit for each that is staged. A byte takes 64 times as much as a change of its own.
    Raw {
        bytes: [u8; WINDOW],
        is_staged: u32,
    },
}

impl Staged {
    /// How many parameters and blocks are staged.
    pub(super) fn len(&self) -> usize {
        self.entries.len()
    }

    /// All changes, those of the latest line last. Adjacent undocumented bytes of a block are one change.
    pub(super) fn changes(&self, chip: &Chip) -> Vec<Change> {
        let mut changes = Vec::with_capacity(self.entries.len());
        for key @ (_, subclass, base) in self.keys() {
            match &self.entries[&key].1 {
                Entry::Parameter(change) => changes.push(change.clone()),
                Entry::Raw { bytes, is_staged } => {
                    let offsets: Vec<usize> = (0..WINDOW).filter(|at| is_staged & 1 << at != 0).collect();
                    changes.extend(offsets.chunk_by(|one, next| one + 1 == *next).map(|run| {
                        let place = Place { subclass, offset: base + run[0] as u16 };
                        let raw = Change::raw(chip, place, bytes[run[0]..][..run.len()].to_vec());
                        raw.expect("each byte was checked when it was staged")
                    }));
                }
            }
        }
        changes
    }

    /// What is staged, by lines.
    fn keys(&self) -> Vec<Key> {
        let mut keys: Vec<_> = self.entries.iter().map(|(key, (line, _))| (*line, *key)).collect();
        keys.sort_unstable();
        keys.into_iter().map(|(_, key)| key).collect()
    }

    fn stage(&mut self, key: Key, entry: Entry) {
        self.lines += 1;
        match (self.entries.get_mut(&key), entry) {
            (Some((line, Entry::Raw { bytes, is_staged })), Entry::Raw { bytes: new, is_staged: more }) => {
                for at in (0..WINDOW).filter(|at| more & 1 << at != 0) {
                    bytes[at] = new[at];
                }
                (*line, *is_staged) = (self.lines, *is_staged | more);
            }
            (Some(before), entry) => *before = (self.lines, entry),
            (None, entry) => {
                self.raw_blocks += usize::from(key.0);
                self.entries.insert(key, (self.lines, entry));
            }
        }
    }

    /// Stages all that `later` has.
    fn extend(&mut self, mut later: Self) {
        for key in later.keys() {
            if let Some((_, entry)) = later.entries.remove(&key) {
                self.stage(key, entry);
            }
        }
    }
}

/// The effect of the lines of one write(2), which comes when all of them have been accepted.
struct Next {
    is_open: bool,
    /// The transaction that was open before has ended.
    is_new: bool,
    /// A line that was refused earlier still counts.
    is_spoiled: bool,
    commits: bool,
    added: Staged,
    /// Blocks that `added` has and the transaction did not have before.
    new_blocks: usize,
}

impl Next {
    /// Drops all that was written before.
    fn restart(&mut self, is_open: bool) {
        *self = Self {
            is_open,
            is_new: true,
            is_spoiled: false,
            commits: false,
            added: Staged::default(),
            new_blocks: 0,
        };
    }
}

impl Transaction {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The staged changes; `None` while no transaction is open.
    pub(super) fn staged(&self, at: Moment) -> Option<Arc<Staged>> {
        let mut state = self.lock();
        let open = state.open.as_mut()?;
        if open.dropped(at).is_some() {
            open.staged = Arc::default();
            return None;
        }
        Some(open.staged.clone())
    }

    /// Whether a line was refused, so that nothing is committed until `begin` or `abort`.
    pub(super) fn is_spoiled(&self) -> bool {
        self.lock().spoiled.is_some()
    }

    /// Takes the lines of one write(2). Returns the changes that are to be written now, if it commits.
    pub(super) fn write(&self, rules: &Rules<'_>, at: Moment, data: &[u8]) -> Result<Option<Vec<Change>>> {
        self.lock().write(rules, at, data).map_err(|error| error.within("df/transaction"))
    }
}

impl State {
    fn write(&mut self, rules: &Rules<'_>, at: Moment, data: &[u8]) -> Result<Option<Vec<Change>>> {
        let dropped = self.open.as_ref().and_then(|open| open.dropped(at));
        if dropped.is_some() {
            self.spoiled = None;
        }
        let before = self.open.as_ref().filter(|_| dropped.is_none()).map(|open| &*open.staged);
        let was_open = before.is_some();
        let mut next = Next {
            is_open: was_open,
            is_new: false,
            is_spoiled: self.spoiled.is_some(),
            commits: false,
            added: Staged::default(),
            new_blocks: 0,
        };
        let outcome = read_lines(&mut next, rules, before, dropped, data);
        if dropped.is_some() || outcome.is_ok() && next.is_new {
            self.open = None;
        }
        if let Err(error) = outcome {
            match begins(data) {
                // One transaction is kept out by another, which goes on.
                true if was_open && self.spoiled.is_none() => {}
                true => self.spoiled = Some(error.clone()),
                false if was_open => drop(self.spoiled.get_or_insert_with(|| error.clone())),
                false => {}
            }
            return Err(error);
        }
        if !next.is_spoiled {
            self.spoiled = None;
        }
        if next.is_open || next.commits {
            let now_open = self.open.get_or_insert_with(|| Open { since: at, staged: Arc::default() });
            // Copied only while somebody is reading it.
            Arc::make_mut(&mut now_open.staged).extend(next.added);
        }
        if !next.commits {
            return Ok(None);
        }
        let ended = self.open.take();
        match &self.spoiled {
            Some(error) => Err(error
                .clone()
                .within("nothing is committed after a refused line until `begin` or `abort`")),
            None => Ok(ended.map(|open| open.staged.changes(rules.chip))),
        }
    }
}

/// Whether the first line of a write(2) is `begin`, with a presence or without.
fn begins(data: &[u8]) -> bool {
    let mut lines = data.split(|&byte| byte == b'\n').map(<[u8]>::trim_ascii);
    let first = lines.find(|line| !line.is_empty());
    first.and_then(|line| line.split(u8::is_ascii_whitespace).next()) == Some(b"begin")
}

/// Whether a line is `begin`. One with a presence is for the gauge that was there then.
fn is_begin(line: &str, presence: Epoch<Presence>) -> Result<bool> {
    let (word, then) = split(line);
    if word != "begin" || then.is_empty() {
        return Ok(word == "begin");
    }
    let then: u64 =
        then.trim().parse().map_err(|_| invalid("after `begin` stands what gauge/presence has shown"))?;
    if then == presence.number() {
        return Ok(true);
    }
    let why = "the gauge has been away or is another one since its values were read, so nothing was written; read them again";
    Err(Error::new("", Cause::Gone, why))
}

/// Checks the lines of one write(2), which continue the transaction `before`.
fn read_lines(
    next: &mut Next,
    rules: &Rules<'_>,
    before: Option<&Staged>,
    dropped: Option<Dropped>,
    data: &[u8],
) -> Result<()> {
    if !data.ends_with(b"\n") {
        return Err(invalid("the last line has no newline, so it may not be whole; end it with one"));
    }
    let text = std::str::from_utf8(data).map_err(|_| invalid("not text"))?;
    let lines = (1..).zip(text.lines().map(str::trim)).filter(|(_, line)| !line.is_empty());
    for (number, line) in lines {
        let taken = take(next, rules, before, dropped, line);
        taken.map_err(|error| error.within(&format!("line {number}")))?;
    }
    Ok(())
}

fn take(
    next: &mut Next,
    rules: &Rules<'_>,
    before: Option<&Staged>,
    dropped: Option<Dropped>,
    line: &str,
) -> Result<()> {
    if next.commits {
        return Err(invalid("nothing may follow `commit` in one write"));
    }
    let none = |why: &str| Error::host("", Errno::ENODATA, why);
    let dropped = dropped.filter(|_| !next.is_open && !next.is_new);
    let begins = is_begin(line, rules.presence)?;
    match line {
        _ if begins && next.is_open && !next.is_spoiled => return Err(busy()),
        _ if begins => next.restart(true),
        "commit" if next.is_spoiled => (next.is_open, next.commits) = (false, true),
        "abort" if next.is_spoiled => next.restart(false),
        _ if matches!(dropped, Some(Dropped::Old)) => {
            return Err(none("it was open for 10 minutes and was dropped; nothing was written"));
        }
        _ if matches!(dropped, Some(Dropped::Left)) => {
            let why = "the gauge has been away or is another one since `begin`, so the staged lines were dropped and \
                       nothing was written; check its values and write `begin` again";
            return Err(Error::new("", Cause::Gone, why));
        }
        _ if !next.is_open => return Err(none("no transaction is open; write `begin` first")),
        "abort" => next.restart(false),
        "commit" => (next.is_open, next.commits) = (false, true),
        line => {
            let (key, entry) = match line.strip_prefix("raw ") {
                Some(raw) => raw_entry(&raw::change(rules.chip, raw)?),
                None => {
                    let change = change(rules, line)?;
                    ((false, change.place().subclass, change.place().offset), Entry::Parameter(change))
                }
            };
            let before = before.filter(|_| !next.is_new);
            let is_known = before.is_some_and(|staged| staged.entries.contains_key(&key));
            if key.0 && !is_known && !next.added.entries.contains_key(&key) {
                next.new_blocks += 1;
            }
            if before.map_or(0, |staged| staged.raw_blocks) + next.new_blocks > RAW_BLOCKS {
                let why =
                    format!("no more than {RAW_BLOCKS} blocks with raw bytes can be staged; commit first");
                return Err(Error::host("", Errno::EFBIG, why));
            }
            next.added.stage(key, entry);
        }
    }
    Ok(())
}

fn raw_entry(change: &Change) -> (Key, Entry) {
    let (place, new) = (change.place(), change.bytes());
    let at = usize::from(place.offset) % WINDOW;
    let (mut bytes, mut is_staged) = ([0; WINDOW], 0);
    bytes[at..at + new.len()].copy_from_slice(new);
    for at in at..at + new.len() {
        is_staged |= 1 << at;
    }
    ((true, place.subclass, place.offset - at as u16), Entry::Raw { bytes, is_staged })
}

/// A line's place and value.
fn split(line: &str) -> (&str, &str) {
    line.split_once(char::is_whitespace).unwrap_or((line, ""))
}

/// The subclasses, by their indices in the table, that hold reserved bits which these lines are compared with.
pub(super) fn compared(chip: &'static Chip, data: &[u8]) -> BTreeSet<usize> {
    if !data.ends_with(b"\n") {
        return BTreeSet::new();
    }
    let lines = std::str::from_utf8(data).unwrap_or_default().lines();
    let rows = lines.filter_map(|line| chip.find(split(line.trim()).0).ok());
    let reserved = rows.filter(|(_, parameter)| matches!(parameter.safe, Some(Safe::Keep(..))));
    reserved.filter_map(|(own, _)| chip.subclasses.iter().position(|row| std::ptr::eq(row, own))).collect()
}

/// `80/53 3100` or `it-cfg/cell-terminate-voltage 3100`, checked as a write to that file is.
fn change(rules: &Rules<'_>, line: &str) -> Result<Change> {
    let (place, value) = split(line);
    let (subclass, parameter) = rules.chip.find(place).map_err(|unnamed| match unnamed {
        Unnamed::Several(names) => {
            invalid(&format!("several parameters have that name; write one of {}", names.join(", ")))
        }
        Unnamed::Unknown if !place.contains('/') && rules.chip.nearest(place).is_none() => invalid(
            "write begin, SUBCLASS/OFFSET VALUE, CLASS/NAME VALUE, commit or abort; this is none of them",
        ),
        Unnamed::Unknown => unknown(rules.chip, place),
    })?;
    let change = Change::parse((subclass, parameter), value.as_bytes(), rules.allow_unproven)?;
    let index = rules.chip.subclasses.iter().position(|row| std::ptr::eq(row, subclass));
    if let Some(stored) = index.and_then(rules.stored) {
        let at = usize::from(parameter.offset - subclass.start());
        change.check_reserved(&stored[at..at + parameter.kind.size()])?;
    }
    Ok(change)
}

/// The answer to whatever a transaction that is open keeps out.
pub(super) fn busy() -> Error {
    let why = "a transaction is open; `commit` or `abort` ends it";
    Error::new("", Cause::Busy, why)
}

fn invalid(why: &str) -> Error {
    Error::new("", Cause::Invalid, why.to_string())
}

/// The error about a place or a name that is no parameter's, with the one that was probably meant. It does not repeat
/// what was written, which may be a secret in the wrong place.
pub(super) fn unknown(chip: &Chip, place: &str) -> Error {
    // A path that no file has may be the name of a parameter in another spelling.
    let why = match chip.find(place).ok().or_else(|| chip.nearest(place)) {
        Some(row) => format!("no such parameter; did you mean {} ({})?", Place::of(row), row.1.name),
        None => "no such parameter; df/index lists them all".into(),
    };
    Error::host("", Errno::ENOENT, why)
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
        let presence = Epoch::default();
        let rules = Rules { chip, allow_unproven: true, stored: &|_| None, presence };
        let at = Moment { now: Duration::ZERO, presence: Epoch::default() };
        assert!(transaction.write(&rules, at, lines).expect("lines").is_none());
        let staged = transaction.staged(at).expect("open").changes(chip);
        let staged: Vec<_> =
            staged.iter().map(|change| (change.place().subclass, change.bytes()[0])).collect();
        assert_eq!(staged, [(91, 0x55), (92, 0x00)]);
    }
}
