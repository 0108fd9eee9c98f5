// SPDX-License-Identifier: MIT

//! `df/transaction`: lines that stage changes, and a commit that writes them all.
//!
//! Nothing reaches the gauge before the commit. A write(2) is staged whole or not at all. A refused one stages nothing
//! and spoils the transaction: a shell passes each line on as a write of its own and continues after a failure, so an
//! unaware commit would write the rest. Everything here runs on the thread that answers readers, so its time depends on
//! the size of one write(2), whatever is staged already.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use nix::errno::Errno;

use super::caller::{Caller, Process};
use super::raw;
use crate::error::{Cause, Error, Result};
use gauge_owner::Presence;
use ti_gauge::chip::{Chip, Safe, Unnamed};
use ti_gauge::codec::WINDOW;
use ti_gauge::dataflash::{Change, Place};
use ti_gauge::epoch::Epoch;

/// A transaction open for longer is dropped. So is one whose gauge was absent since, or is another one: its values were
/// meant for the earlier gauge.
const PATIENCE: Duration = Duration::from_secs(600);
/// Most blocks with undocumented bytes in a transaction, 128 KiB: more than any gauge stores, and little for the
/// daemon. The chip's table limits the parameters.
const RAW_BLOCKS: usize = 4096;

/// The rules for lines.
pub(super) struct Rules<'a> {
    pub(super) chip: &'static Chip,
    pub(super) also_unproven: bool,
    /// A subclass as the gauge stores it, by its index in the table, if that is known.
    pub(super) stored: &'a dyn Fn(usize) -> Option<Arc<[u8]>>,
    /// See [`Published::presence`](gauge_owner::Published::presence).
    pub(super) presence: Epoch<Presence>,
}

#[derive(Default)]
pub(super) struct Transaction(Mutex<State>);

/// The last transaction, open or not, and the open files that have written to this file.
#[derive(Default)]
struct State {
    /// Number of transactions begun.
    number: u64,
    /// The process that began it. If each line opens the file anew, this process continues it.
    process: Option<Process>,
    open: Option<Open>,
    /// Why lines were refused since the last `begin` or `abort`; nothing is committed then. It outlives the
    /// transaction, for writers that continue after a failed commit, or after a refused write with the `begin` in it.
    spoiled: Option<Error>,
    /// Why it was dropped, until that is reported.
    dropped: Option<Dropped>,
    files: BTreeMap<u64, Standing>,
    has_ended: HasEnded,
}

/// An open file that has written.
enum Standing {
    /// To the transaction of that number.
    Of(u64),
    /// It was kept out, and nobody knows to which transaction its lines belong.
    Refused(Error),
}

struct HasEnded(fn(Process) -> bool);

impl Default for HasEnded {
    fn default() -> Self {
        Self(Process::has_ended)
    }
}

/// The time of a request to a transaction.
#[derive(Clone, Copy)]
pub(super) struct Moment {
    pub(super) now: Duration,
    /// See [`Published::presence`](gauge_owner::Published::presence).
    pub(super) presence: Epoch<Presence>,
}

struct Open {
    since: Moment,
    /// Shared with its readers.
    staged: Arc<Staged>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Dropped {
    Old,
    Left,
    /// Nobody can continue it: its open file is closed, and its process has ended or was never visible.
    Abandoned,
}

impl Open {
    fn dropped(&self, at: Moment) -> Option<Dropped> {
        if at.presence != self.since.presence {
            return Some(Dropped::Left);
        }
        (at.now.saturating_sub(self.since.now) >= PATIENCE).then_some(Dropped::Old)
    }
}

/// The staged changes. The later of two changes of a place counts.
#[derive(Clone, Default)]
pub(super) struct Staged {
    /// Parameters, and blocks with undocumented bytes, each with the number of its last line.
    entries: BTreeMap<Key, (u64, Entry)>,
    raw_blocks: usize,
    lines: u64,
}

/// Whether it is a block, its subclass, and its offset. Subclasses may share rows.
type Key = (bool, u8, u16);

#[derive(Clone)]
enum Entry {
    Parameter(Change),
    /// Bytes of a block, and a bit for each staged one. A change per byte would take 64 times as much.
    Raw {
        bytes: [u8; WINDOW],
        is_staged: u32,
    },
}

impl Staged {
    /// Number of staged parameters and blocks.
    pub(super) fn len(&self) -> usize {
        self.entries.len()
    }

    /// All changes, in the order of their last lines. Adjacent undocumented bytes of a block are one change.
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

    /// Adds the stages of `later`.
    fn extend(&mut self, mut later: Self) {
        for key in later.keys() {
            if let Some((_, entry)) = later.entries.remove(&key) {
                self.stage(key, entry);
            }
        }
    }
}

/// The effect of one write(2), once all its lines are accepted.
struct Next {
    is_open: bool,
    /// The earlier open transaction has ended.
    is_new: bool,
    /// An earlier refused line still counts.
    is_spoiled: bool,
    /// A `begin` was refused.
    is_kept_out: bool,
    commits: bool,
    added: Staged,
    /// Blocks of `added` that are new to the transaction.
    new_blocks: usize,
}

impl Next {
    /// Drops everything written before.
    fn restart(&mut self, is_open: bool) {
        *self = Self {
            is_open,
            is_new: true,
            is_spoiled: false,
            is_kept_out: false,
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

    /// The staged changes; `None` without an open transaction.
    pub(super) fn staged(&self, at: Moment) -> Option<Arc<Staged>> {
        let mut state = self.lock();
        state.drop_if_due(at);
        state.open.as_ref().map(|open| open.staged.clone())
    }

    /// Whether a line was refused, so that nothing is committed until `begin` or `abort`.
    pub(super) fn is_spoiled(&self) -> bool {
        self.lock().spoiled.is_some()
    }

    /// Whether the previous open file keeps out a process that continues its transaction through another one, although
    /// it may just have been closed.
    pub(super) fn awaits_close(&self, caller: Caller) -> bool {
        let state = self.lock();
        state.open.is_some()
            && state.is_held()
            && state.is_of_process(caller)
            && !state.files.contains_key(&caller.file)
    }

    pub(super) fn close(&self, file: u64) {
        self.lock().files.remove(&file);
    }

    /// Takes the lines of one write(2). Returns the changes of a commit.
    pub(super) fn write(
        &self,
        rules: &Rules<'_>,
        at: Moment,
        caller: Caller,
        data: &[u8],
    ) -> Result<Option<Vec<Change>>> {
        self.lock().write(rules, at, caller, data).map_err(|error| error.within("df/transaction"))
    }
}

impl State {
    fn is_held(&self) -> bool {
        self.files.values().any(|file| matches!(file, Standing::Of(number) if *number == self.number))
    }

    fn is_of_process(&self, caller: Caller) -> bool {
        caller.process.is_some() && caller.process == self.process
    }

    /// Whether the last transaction is this writer's: begun through this open file or, if that is closed, by this
    /// process.
    fn is_own(&self, caller: Caller) -> bool {
        match self.files.get(&caller.file) {
            Some(Standing::Of(number)) => *number == self.number,
            Some(Standing::Refused(_)) => false,
            None => self.is_of_process(caller) && !self.is_held(),
        }
    }

    fn drop_if_due(&mut self, at: Moment) {
        let Some(open) = &self.open else { return };
        let is_left = || !self.is_held() && self.process.is_none_or(self.has_ended.0);
        let dropped = open.dropped(at).or_else(|| is_left().then_some(Dropped::Abandoned));
        if dropped.is_some() {
            (self.open, self.spoiled, self.dropped) = (None, None, dropped);
        }
    }

    /// Refuses all further writes of an open file. Nobody continues its own transaction.
    fn refuse(&mut self, file: u64, error: &Error) {
        let before = self.files.insert(file, Standing::Refused(error.clone()));
        if matches!(before, Some(Standing::Of(number)) if number == self.number) {
            self.open = None;
        }
    }

    /// A transaction begins, or would have begun with a refused write.
    fn begin(&mut self, caller: Caller) {
        self.number += 1;
        self.process = caller.process;
        (self.open, self.spoiled, self.dropped) = (None, None, None);
        self.files.insert(caller.file, Standing::Of(self.number));
    }

    /// Notes refused lines of a writer's own transaction, or of one that it wants to begin: also a whole write with a
    /// `begin` at its start, and with `is_kept_out` the `begin` itself.
    fn note_refused(&mut self, caller: Caller, begins: bool, is_kept_out: bool, error: &Error) {
        let is_whole = self.open.is_some() && self.spoiled.is_none();
        if self.open.is_none() && (begins || is_kept_out) {
            self.begin(caller);
            self.spoiled = Some(error.clone());
        }
        match self.open.is_some() {
            true if begins && is_whole => self.refuse(caller.file, error),
            true if begins => self.spoiled = Some(error.clone()),
            true => {
                self.files.insert(caller.file, Standing::Of(self.number));
                self.spoiled.get_or_insert_with(|| error.clone());
            }
            false if is_kept_out => self.refuse(caller.file, error),
            false => {}
        }
    }

    fn write(
        &mut self,
        rules: &Rules<'_>,
        at: Moment,
        caller: Caller,
        data: &[u8],
    ) -> Result<Option<Vec<Change>>> {
        self.drop_if_due(at);
        if let Some(Standing::Refused(error)) = self.files.get(&caller.file) {
            return Err(error.clone().within("refused until this open file is closed"));
        }
        let is_own = self.is_own(caller);
        if self.open.is_some() && !is_own {
            let error = occupied();
            // A program that loses a line continues, as a shell does, and must not commit the rest.
            if self.is_of_process(caller) && !begins(data) {
                self.spoiled = self.spoiled.take().or_else(|| Some(error.clone()));
            }
            self.refuse(caller.file, &error);
            return Err(error);
        }
        let dropped = self.dropped.filter(|dropped| is_own || *dropped == Dropped::Abandoned);
        let before = self.open.as_ref().map(|open| &*open.staged);
        let was_open = before.is_some();
        let mut next = Next {
            is_open: was_open,
            is_new: false,
            is_spoiled: is_own && self.spoiled.is_some(),
            is_kept_out: false,
            commits: false,
            added: Staged::default(),
            new_blocks: 0,
        };
        let outcome = read_lines(&mut next, rules, before, dropped, data);
        if is_own {
            self.dropped = None;
        }
        if let Err(error) = outcome {
            self.note_refused(caller, begins(data), next.is_kept_out, &error);
            return Err(error);
        }
        match next.is_new {
            true if next.is_open || next.commits => self.begin(caller),
            true => (self.open, self.spoiled) = (None, None),
            false if is_own => drop(self.files.insert(caller.file, Standing::Of(self.number))),
            false => {}
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

/// Whether the first line of a write(2) is `begin`, with or without a presence.
pub(super) fn begins(data: &[u8]) -> bool {
    let mut lines = data.split(|&byte| byte == b'\n').map(<[u8]>::trim_ascii);
    let first = lines.find(|line| !line.is_empty());
    first.and_then(|line| line.split(u8::is_ascii_whitespace).next()) == Some(b"begin")
}

/// Whether a line is `begin`. A presence means the gauge that was there then.
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
    next.is_kept_out = split(line).0 == "begin";
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
        _ if matches!(dropped, Some(Dropped::Abandoned)) => {
            return Err(none(
                "its open file was closed, and the process that had begun it cannot be seen or has ended; \
                             a program for each line, as in `echo LINE | sudo tee`, needs one open file for all lines: \
                             `printf 'begin\\nLINE\\ncommit\\n' | sudo tee`",
            ));
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

fn split(line: &str) -> (&str, &str) {
    line.split_once(char::is_whitespace).unwrap_or((line, ""))
}

/// Subclasses, by their indices in the table, whose reserved bits are compared with these lines.
pub(super) fn compared(chip: &'static Chip, data: &[u8]) -> BTreeSet<usize> {
    if !data.ends_with(b"\n") {
        return BTreeSet::new();
    }
    let lines = std::str::from_utf8(data).unwrap_or_default().lines();
    let rows = lines.filter_map(|line| chip.find(split(line.trim()).0).ok());
    let reserved = rows.filter(|(_, parameter)| matches!(parameter.safe, Some(Safe::Keep(..))));
    reserved.filter_map(|(own, _)| chip.subclasses.iter().position(|row| std::ptr::eq(row, own))).collect()
}

/// `80/53 3100` or `it-cfg/cell-terminate-voltage 3100`, checked as a write to that file.
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
    let change = Change::parse(rules.chip, (subclass, parameter), value.as_bytes(), rules.also_unproven)?;
    let index = rules.chip.subclasses.iter().position(|row| std::ptr::eq(row, subclass));
    if let Some(stored) = index.and_then(rules.stored) {
        let at = usize::from(parameter.offset - subclass.start());
        change.check_reserved(&stored[at..at + parameter.kind.size()])?;
    }
    Ok(change)
}

/// The answer to a writer kept out by another one's transaction.
fn occupied() -> Error {
    let why = "the transaction of another open file is open, and takes no lines but its own; close this one, and begin again \
               when that has ended; all lines of a transaction go to one open file";
    Error::new("", Cause::Busy, why)
}

/// The answer to anything that an open transaction keeps out.
pub(super) fn busy() -> Error {
    let why = "a transaction is open; `commit` or `abort` ends it";
    Error::new("", Cause::Busy, why)
}

fn invalid(why: &str) -> Error {
    Error::new("", Cause::Invalid, why.to_string())
}

/// The error for an unknown place or name, with the parameter that was probably meant. It does not repeat the text,
/// which may be a secret in the wrong place.
pub(super) fn unknown(chip: &Chip, place: &str) -> Error {
    // A path without a file may be a parameter's name in another spelling.
    let why = match chip.find(place).ok().or_else(|| chip.nearest(place)) {
        Some(row) => format!("no such parameter; did you mean {} ({})?", Place::of(row), row.1.name),
        None => "no such parameter; df/index lists them all".into(),
    };
    Error::host("", Errno::ENOENT, why)
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;

    use proptest::prelude::*;

    use super::*;

    thread_local! {
        static ENDED: RefCell<Vec<Process>> = const { RefCell::new(Vec::new()) };
    }

    /// A writing program.
    #[derive(Clone, Copy, Debug)]
    struct Writer {
        /// `None` if it is not visible.
        process: Option<u32>,
        /// It keeps its file open instead of opening it for each line.
        holds: bool,
    }

    /// Two of one process, and two in another PID namespace, with one open file and with many.
    const WRITERS: [Writer; 5] = [
        Writer { process: Some(1), holds: false },
        Writer { process: Some(2), holds: true },
        Writer { process: Some(2), holds: false },
        Writer { process: None, holds: true },
        Writer { process: None, holds: false },
    ];

    #[derive(Clone, Copy, Debug)]
    enum Does {
        Begin,
        Line,
        Nonsense,
        Commit,
        Abort,
        Close,
        End,
        Time,
        Exchange,
    }

    fn does() -> impl Strategy<Value = Does> {
        prop_oneof![
            4 => Just(Does::Begin),
            6 => Just(Does::Line),
            1 => Just(Does::Nonsense),
            4 => Just(Does::Commit),
            1 => Just(Does::Abort),
            2 => Just(Does::Close),
            1 => Just(Does::End),
            1 => Just(Does::Time),
            1 => Just(Does::Exchange),
        ]
    }

    /// The truth about the last transaction.
    #[derive(Default)]
    struct Truth {
        is_open: bool,
        is_spoiled: bool,
        file: Option<u64>,
        process: Option<Process>,
        lines: BTreeMap<&'static str, u16>,
    }

    /// The model: the right answer to each writer.
    struct Model {
        transaction: Transaction,
        truth: Truth,
        /// Open files that have begun a transaction, and refused ones.
        begun: BTreeSet<u64>,
        refused: BTreeSet<u64>,
        held: [Option<u64>; WRITERS.len()],
        generation: [u32; WRITERS.len()],
        files: u64,
        at: Moment,
        values: u16,
    }

    impl Model {
        fn new() -> Self {
            ENDED.take();
            let transaction = Transaction::default();
            transaction.lock().has_ended =
                HasEnded(|process| ENDED.with_borrow(|ended| ended.contains(&process)));
            Self {
                transaction,
                truth: Truth::default(),
                begun: BTreeSet::new(),
                refused: BTreeSet::new(),
                held: [None; WRITERS.len()],
                generation: [0; WRITERS.len()],
                files: 0,
                at: Moment { now: Duration::ZERO, presence: Epoch::numbered(1) },
                values: 0,
            }
        }

        fn process(&self, writer: usize) -> Option<Process> {
            Some(Process::numbered(10 * self.generation[writer] + WRITERS[writer].process?))
        }

        fn close(&mut self, file: u64) {
            self.transaction.close(file);
            self.begun.remove(&file);
            self.refused.remove(&file);
            if self.truth.file == Some(file) {
                self.truth.file = None;
            }
        }

        fn is_abandoned(&self) -> bool {
            let has_ended = |process| ENDED.with_borrow(|ended| ended.contains(&process));
            self.truth.file.is_none() && self.truth.process.is_none_or(has_ended)
        }

        fn step(&mut self, writer: usize, does: Does, place: &'static str) {
            match does {
                Does::Close => {
                    if let Some(file) = self.held[writer].take() {
                        self.close(file);
                    }
                    return;
                }
                Does::End => {
                    if let Some(process) = self.process(writer) {
                        ENDED.with_borrow_mut(|ended| ended.push(process));
                    }
                    for (other, known) in WRITERS.iter().enumerate() {
                        if known.process == WRITERS[writer].process {
                            if let Some(file) = self.held[other].take() {
                                self.close(file);
                            }
                            self.generation[other] += 1;
                        }
                    }
                    return;
                }
                Does::Time => self.at.now += PATIENCE,
                Does::Exchange => self.at.presence.next(),
                Does::Begin | Does::Line | Does::Nonsense | Does::Commit | Does::Abort => {
                    return self.write(writer, does, place);
                }
            }
            // Either drops it.
            self.truth.is_spoiled &= !self.truth.is_open;
            self.truth.is_open = false;
        }

        fn write(&mut self, writer: usize, does: Does, place: &'static str) {
            if self.truth.is_open && self.is_abandoned() {
                (self.truth.is_open, self.truth.is_spoiled) = (false, false);
            }
            let process = self.process(writer);
            let file = self.held[writer].unwrap_or_else(|| {
                self.files += 1;
                self.files
            });
            let caller = Caller { file, process };
            let truth = &mut self.truth;
            let is_new = !self.begun.contains(&file) && !self.refused.contains(&file);
            let joins = is_new && truth.file.is_none() && process.is_some() && process == truth.process;
            let is_own = !self.refused.contains(&file) && (truth.file == Some(file) || joins);
            let was_refused = self.refused.contains(&file);
            let is_refused = was_refused || truth.is_open && !is_own;
            let is_lost = !was_refused && is_refused && !matches!(does, Does::Begin);
            self.values += 1;
            let value = 3000 + self.values % 500;
            let (line, accepted) = match does {
                Does::Begin => ("begin".into(), !truth.is_open || truth.is_spoiled),
                Does::Line => (format!("{place} {value}"), is_own && truth.is_open),
                Does::Commit => ("commit".into(), is_own && truth.is_open && !truth.is_spoiled),
                Does::Abort => ("abort".into(), is_own && (truth.is_open || truth.is_spoiled)),
                _ => ("nonsense".into(), false),
            };
            let is_accepted = accepted && !is_refused;
            let chip = Chip::by_name("bq34z100-g1").expect("it has a table");
            let rules = Rules { chip, also_unproven: false, stored: &|_| None, presence: self.at.presence };
            let outcome = self.transaction.write(&rules, self.at, caller, format!("{line}\n").as_bytes());
            let told = format!("{writer} {:?} through {file}, {line}: {outcome:?}", WRITERS[writer]);
            assert_eq!(outcome.is_ok(), is_accepted, "{told}");
            let written = outcome.ok().flatten();
            let counts = match does {
                Does::Line | Does::Nonsense => truth.is_open,
                Does::Commit => truth.is_open || truth.is_spoiled,
                _ => false,
            };
            if joins && counts && !is_refused {
                truth.file = Some(file);
                self.begun.insert(file);
            }
            truth.is_spoiled |= is_lost && process.is_some() && process == truth.process;
            match does {
                _ if is_refused => drop(self.refused.insert(file)),
                Does::Begin if is_accepted => {
                    *truth = Truth { is_open: true, file: Some(file), process, ..Truth::default() };
                    self.begun.insert(file);
                }
                // Only the open file that began the first one prevents its own second one.
                Does::Begin => {
                    truth.is_open &= truth.file != Some(file);
                    self.refused.insert(file);
                }
                Does::Line if is_accepted => drop(truth.lines.insert(place, value)),
                Does::Commit if is_accepted => {
                    let written = written.expect("changes").into_iter();
                    let written: BTreeMap<_, _> = written
                        .map(|change| {
                            (
                                change.place().to_string(),
                                u16::from_be_bytes([change.bytes()[0], change.bytes()[1]]),
                            )
                        })
                        .collect();
                    let lines: BTreeMap<_, _> =
                        truth.lines.iter().map(|(place, value)| (place.to_string(), *value)).collect();
                    assert_eq!(written, lines, "{told}");
                    truth.is_open = false;
                }
                Does::Commit if is_own => truth.is_open = false,
                Does::Abort if is_accepted => (truth.is_open, truth.is_spoiled) = (false, false),
                Does::Nonsense if is_own && truth.is_open => truth.is_spoiled = true,
                _ => {}
            }
            if !WRITERS[writer].holds {
                self.close(file);
            } else {
                self.held[writer] = Some(file);
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

        /// Writers unknown to each other write lines in turn, each through one open file or many.
        #[test]
        fn no_writer_gets_a_line_of_another(
            writers in proptest::sample::subsequence((0..WRITERS.len()).collect::<Vec<_>>(), 2..=3),
            steps in proptest::collection::vec((0..3_usize, does(), any::<bool>()), 1..60),
        ) {
            let mut model = Model::new();
            for (writer, does, first) in steps {
                let place = if first { "80/53" } else { "48/11" };
                model.step(writers[writer % writers.len()], does, place);
            }
            // Their remains keep nobody out for good.
            for writer in writers {
                model.step(writer, Does::Close, "");
                model.step(writer, Does::End, "");
            }
            for does in [Does::Begin, Does::Line, Does::Commit] {
                model.step(0, does, "80/53");
            }
            prop_assert!(!model.truth.lines.is_empty());
        }
    }

    /// The tables of the bq27520-G3's two packs are the same rows; one used to take the other's place.
    #[test]
    fn regression_rows_that_subclasses_share_are_staged_apart() {
        let chip = Chip::by_name("bq27520-g3").expect("it has a table");
        let transaction = Transaction::default();
        let lines = b"begin\n91/0 0x55\n92/0 0x55\n92/0 0x00\n";
        let presence = Epoch::default();
        let rules = Rules { chip, also_unproven: true, stored: &|_| None, presence };
        let caller = Caller { file: 1, process: None };
        let at = Moment { now: Duration::ZERO, presence: Epoch::default() };
        assert!(transaction.write(&rules, at, caller, lines).expect("lines").is_none());
        let staged = transaction.staged(at).expect("open").changes(chip);
        let staged: Vec<_> =
            staged.iter().map(|change| (change.place().subclass, change.bytes()[0])).collect();
        assert_eq!(staged, [(91, 0x55), (92, 0x00)]);
    }
}
