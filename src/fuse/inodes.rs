// SPDX-License-Identifier: MIT

//! The table of nodeids: which file each number means, and which value it shows.
//!
//! One nodeid is one immutable value, so a reader never gets the size of one value with the bytes of
//! another. A new value gets a new nodeid; the old one is superseded and keeps its bytes. Only a file that is
//! held open across a change has to follow it under the nodeid that it has: that nodeid is renewed, either
//! after a delay or when a write through it is answered.
//!
//! A file that may be written has a nodeid of its own for each lookup, and so for each time it is opened. The kernel
//! copies what is written to its page cache before it passes it on, and nobody else may see that before it is accepted.
//!
//! The kernel keeps the nodeids of files that nobody has open for as long as it has memory, which is for ever. So a nodeid
//! has in itself which node it is of, and the table holds those in use only. One that nobody has used for a while rests:
//! nothing is known of it. If it is used again, because somebody has held it open, it is renewed.
//!
//! Of a value that is shared, the table keeps a hash and the nodeid even then: if a lookup finds the same value, it finds the
//! same nodeid, for which the kernel still has the bytes.
//!
//! This module knows neither FUSE nor any lock, and reads no clock: every caller passes the time.

use std::collections::{BTreeMap, HashMap};
use std::hash::{BuildHasher, RandomState};
use std::ops::RangeInclusive;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use fuser::Errno;

use super::Shared;
use crate::fs::{Content, Node};

/// Delay before an open file switches to its new value, so that no read of the old value is still under
/// way. 50 ms was too short: one torn read in 5 million.
pub(super) const RENEWAL_DELAY: Duration = Duration::from_secs(2);

/// Time after a renewal in which each GETATTR shows another file time, so that each reader drops the old bytes
/// itself. It cannot rely on the first reader, which makes the new size visible before it drops the bytes.
const SETTLING: Duration = Duration::from_millis(50);

/// How long a nodeid without requests is still in use, unless the kernel may use its name for longer. It uses attributes
/// for no longer than the name or [`RENEWAL_DELAY`] without asking, so that it asks before it uses one that rests.
const IN_USE: Duration = RENEWAL_DELAY.saturating_mul(2);

/// How long such a nodeid is in use if the kernel has its whole value, has nothing to drop, and asks for the name each
/// time.
const READ_THROUGH: Duration = Duration::from_secs(1);

/// How long the kernel may keep the attributes of a file that may be written, after it has asked for them: as long as a
/// program needs to open and read it.
pub(super) const LEASE: Duration = Duration::from_millis(4);

/// Until then it certainly asks again. It counts in its clock's ticks, of up to 10 ms, and from when it gets the answer.
pub(super) const LEASE_OVER: Duration = Duration::from_millis(30);

/// How much longer than it was told the kernel may use a name, because it counts from when it gets the answer.
pub(super) const NAME_OVER: Duration = RENEWAL_DELAY;

/// The table keeps so many nodeids, in use or not.
const SPARE: usize = 128;
/// For how long the kernel keeps a folder's names.
const LISTING_KEPT: Duration = Duration::from_secs(10);

/// A nodeid's bits from here on tell it apart from others of the same file; the lower ones are its node's number.
/// Folders and links have only those.
const TURN: u32 = 32;
/// Number of nodeids of a file before one repeats, if the kernel has forgotten it.
const TURNS: u64 = 1 << 31;

/// The present time on both clocks: one measures delays, the other is shown as a file's time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Now {
    /// Monotonic.
    pub(super) instant: Instant,
    /// The calendar's.
    pub(super) time: SystemTime,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Value {
    /// A file's bytes.
    Bytes(Arc<[u8]>),
    /// A file not yet read from the gauge, and its apparent size.
    Unread(u64),
    /// A file held open whose value no longer exists.
    Gone,
}

impl Value {
    /// The value of a file; `None` if the file does not exist.
    pub(super) fn of(content: Content) -> Option<Self> {
        match content {
            Content::Bytes(bytes) => Some(Value::Bytes(bytes)),
            Content::Unread(size) => Some(Value::Unread(size)),
            Content::Absent => None,
        }
    }

    fn size(&self) -> u64 {
        match self {
            // Not 0: the kernel answers a read at a file's end by itself, and would not return ENODEV.
            Value::Gone => 4096,
            Value::Bytes(bytes) => bytes.len() as u64,
            Value::Unread(size) => *size,
        }
    }
}

/// What `stat` shows of a nodeid, besides what follows from its node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shown {
    pub(super) number: u64,
    pub(super) node: Node,
    pub(super) size: u64,
    pub(super) since: SystemTime,
    /// How long the kernel may keep this: at most until a renewal.
    pub(super) valid: Duration,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sharing {
    /// Only the first one.
    Alone,
    /// All while the value is the same; with an unread value only this thread's.
    By(u32),
    /// All while the value is the same. The kernel may keep its name.
    All,
}

/// Limit for a read after a failed `fstat`.
const FOLLOWS: Duration = Duration::from_secs(1);

#[derive(Debug)]
pub(super) struct Inode<W> {
    /// Lookups that the kernel has not forgotten; [`UNKNOWN`] after a rest.
    lookups: u64,
    sharing: Sharing,
    value: Value,
    since: SystemTime,
    /// When another value took its place, until that is shown under this nodeid.
    superseded: Option<Instant>,
    renewed: Option<Instant>,
    /// Unanswered writes. The kernel keeps the file's page locked meanwhile.
    writing: u32,
    /// Requests that wait for an unread value, from the first READ until the value arrives.
    waiting: Option<Vec<W>>,
    /// A thread that may be about to write, and how often it has asked for the attribute that shows this.
    asked: (u32, u32),
    /// Requests for its attributes since the lookup; `None` once it was opened for overwriting.
    looks: Option<u32>,
    /// The errno of a value that `fstat` asked for, until a read has got it as well.
    refusal: Option<(Errno, Instant)>,
    used: Instant,
    /// The kernel has the whole value.
    is_read: bool,
    /// The kernel was told to drop its bytes. It stays set after they are read again: another reader's answer with the
    /// same order may be on its way, and that reader then asks once more.
    was_dropped: bool,
    /// Until when the kernel may use its name without asking, and the attributes that it got with it.
    named: Option<Instant>,
    /// Until when the kernel may use its attributes without asking, although it may be written.
    leased: Option<Instant>,
}

/// A shared nodeid that rests, and its value.
#[derive(Clone, Copy, Debug)]
struct Rested {
    turn: u32,
    hash: u64,
    since: SystemTime,
}

/// So many lookups that no number of them takes them back.
const UNKNOWN: u64 = u64::MAX / 2;

impl<W> Inode<W> {
    fn new(value: Value, sharing: Sharing, now: Now) -> Self {
        Self {
            lookups: 1,
            sharing,
            value,
            since: now.time,
            superseded: None,
            renewed: None,
            writing: 0,
            waiting: None,
            asked: (0, 0),
            looks: Some(0),
            refusal: None,
            used: now.instant,
            is_read: false,
            was_dropped: false,
            named: None,
            leased: None,
        }
    }

    pub(super) fn value(&self) -> &Value {
        &self.value
    }

    /// Whether its value has been asked for and has not arrived.
    pub(super) fn is_awaited(&self) -> bool {
        self.waiting.is_some()
    }

    pub(super) fn is_unread(&self) -> bool {
        matches!(self.value, Value::Unread(_))
    }

    pub(super) fn is_gone(&self) -> bool {
        self.value == Value::Gone
    }

    /// Whether it shows a value that is the file's and will be for as long as it shows it.
    fn is_settled(&self) -> bool {
        let is_value = matches!(self.value, Value::Bytes(_));
        is_value && self.superseded.is_none() && self.renewed.is_none() && self.is_idle()
    }

    fn is_idle(&self) -> bool {
        self.writing == 0 && !self.is_awaited()
    }

    fn rests(&self, now: Now) -> bool {
        let is_done = self.is_read && !self.was_dropped && self.sharing != Sharing::All;
        let delay = if is_done { READ_THROUGH } else { IN_USE };
        self.is_idle() && !self.is_named(now) && now.instant >= self.used + delay
    }

    fn is_named(&self, now: Now) -> bool {
        self.named.is_some_and(|until| now.instant < until)
    }

    /// For how long the kernel was told to use its name.
    fn named_for(&self, now: Now) -> Duration {
        let until = self.named.map(|until| until - NAME_OVER);
        until.map_or(Duration::ZERO, |until| until.saturating_duration_since(now.instant))
    }

    /// Whether the kernel may use its attributes without asking for longer than it shows an old value.
    fn is_trusted(&self, now: Now) -> bool {
        self.named_for(now) > RENEWAL_DELAY
    }

    /// When it is renewed; `None` while it is up to date or in use.
    fn due(&self) -> Option<Instant> {
        // A file opened alone is asked for before each read, and shows that answer.
        let delay = if self.sharing == Sharing::Alone { Duration::ZERO } else { RENEWAL_DELAY };
        self.superseded.filter(|_| self.is_idle()).map(|since| since + delay)
    }

    fn shown(&self, number: u64, now: Now) -> Option<Shown> {
        let node = node(number)?;
        // A nodeid that is not shared may rest sooner, and readers past the kernel's copy (O_DIRECT) have to ask
        // before.
        let most = match self.sharing {
            Sharing::All => RENEWAL_DELAY.max(self.named_for(now)),
            Sharing::By(_) => READ_THROUGH / 2,
            // But for a lease.
            Sharing::Alone => Duration::ZERO,
        };
        let valid = match self.superseded {
            // Readers of an unread value must ask before: from Linux 7.2 on, only that answer's errno reaches programs.
            _ if self.renewed.is_some() || self.is_unread() => Duration::ZERO,
            // Even if it is superseded at once, it is not renewed earlier.
            None => most,
            Some(_) => {
                self.due().map_or(Duration::ZERO, |due| due.saturating_duration_since(now.instant)).min(most)
            }
        };
        Some(Shown { number, node, size: self.value.size(), since: self.since, valid })
    }
}

pub(super) fn node(number: u64) -> Option<Node> {
    Node::at(number as u32)
}

/// The lower bits of the numbers of a gauge's nodes.
const GROUP: u32 = 0xffff;

/// The first number of the gauge of a nodeid.
fn group(number: u64) -> u32 {
    number as u32 & !GROUP
}

/// The number of a nodeid as a key, or back: those of a node, and of a gauge, are in a row.
fn key(number: u64) -> u64 {
    number.rotate_left(TURN)
}

fn keys(places: &RangeInclusive<u32>) -> RangeInclusive<u64> {
    u64::from(*places.start()) << TURN..=u64::from(*places.end()) << TURN | u64::from(u32::MAX)
}

#[derive(Debug)]
struct Listing {
    /// Hash of the names; `None` if the kernel certainly keeps others.
    hash: Option<u64>,
    since: SystemTime,
    /// When the kernel was given it; `None` if it keeps none.
    given: Option<Instant>,
}

/// The nodeids of files that are in use, and the listings of folders.
#[derive(Debug)]
pub(super) struct Inodes<W> {
    /// Of the next nodeid of a file.
    turn: u64,
    started: SystemTime,
    /// By their [`key`].
    live: BTreeMap<u64, Inode<W>>,
    /// Those that a lookup may find again, by their nodes.
    rested: BTreeMap<u32, Rested>,
    hasher: RandomState,
    /// Unanswered writes to files of each gauge.
    writes: BTreeMap<u32, u32>,
    /// The nodeid that a lookup of a node finds, unless the value has changed.
    current: BTreeMap<u32, u64>,
    listings: HashMap<Node, Listing>,
    /// Number of nodeids above which resting ones are dropped.
    room: usize,
    /// When that was last done.
    tidied: Instant,
}

impl<W> Inodes<W> {
    pub(super) fn new(now: Now) -> Self {
        Self {
            turn: 0,
            started: now.time,
            live: BTreeMap::new(),
            rested: BTreeMap::new(),
            hasher: RandomState::new(),
            writes: BTreeMap::new(),
            current: BTreeMap::new(),
            listings: HashMap::new(),
            room: SPARE,
            tidied: now.instant,
        }
    }

    pub(super) fn get(&self, number: u64) -> Option<&Inode<W>> {
        self.live.get(&key(number))
    }

    pub(super) fn shown(&self, number: u64, now: Now) -> Option<Shown> {
        self.get(number)?.shown(number, now)
    }

    pub(super) fn fixed(&self, node: Node) -> Shown {
        let number = node.place().into();
        let since = self.listings.get(&node).map_or(self.started, |listing| listing.since);
        Shown { number, node, size: 0, since, valid: Duration::ZERO }
    }

    fn next(&mut self, node: Node) -> u64 {
        loop {
            self.turn = self.turn % (TURNS - 1) + 1;
            let number = self.turn << TURN | u64::from(node.place());
            let is_known = |rested: &Rested| u64::from(rested.turn) == self.turn;
            if !self.live.contains_key(&key(number)) && !self.rested.get(&node.place()).is_some_and(is_known)
            {
                return number;
            }
        }
    }

    /// Drops resting nodeids if there are many: at once after many additions, otherwise when those of the last time may
    /// rest.
    pub(super) fn tidy(&mut self, now: Now) {
        let is_time = self.live.len() > SPARE && now.instant >= self.tidied + IN_USE;
        if self.live.len() < self.room && !is_time {
            return;
        }
        let (current, rested, hasher) = (&self.current, &mut self.rested, &self.hasher);
        self.live.retain(|&key, inode| {
            let (place, turn) = ((key >> TURN) as u32, key as u32);
            if inode.rests(now)
                && let Value::Bytes(bytes) = &inode.value
                && inode.is_settled()
                && !inode.was_dropped
                && current.get(&place) == Some(&self::key(key))
            {
                rested.insert(place, Rested { turn, hash: hasher.hash_one(bytes), since: inode.since });
            }
            !inode.rests(now)
        });
        (self.room, self.tidied) = (self.live.len() + SPARE, now.instant);
        self.current.retain(|_, number| self.live.contains_key(&key(*number)));
    }

    /// What a lookup finds again: the nodeid of the value that the node has had before.
    fn found_again(&mut self, node: Node, value: &Value, sharing: Sharing, now: Now) -> Option<u64> {
        let rested = *self.rested.get(&node.place()).filter(|_| sharing != Sharing::Alone)?;
        let Value::Bytes(bytes) = value else { return None };
        let number = u64::from(rested.turn) << TURN | u64::from(node.place());
        if rested.hash != self.hasher.hash_one(bytes) || self.live.contains_key(&key(number)) {
            return None;
        }
        self.rested.remove(&node.place());
        let since = rested.since;
        let inode = Inode { lookups: UNKNOWN, since, ..Inode::new(value.clone(), sharing, now) };
        self.live.insert(key(number), inode);
        self.current.insert(node.place(), number);
        Some(number)
    }

    /// Uses a resting nodeid again: it shows the file's present value from now on.
    pub(super) fn wake(&mut self, number: u64, value: Value, sharing: Sharing, now: Now) {
        // It is of another value then.
        let place = number as u32;
        if self.rested.get(&place).is_some_and(|rested| u64::from(rested.turn) == number >> TURN) {
            self.rested.remove(&place);
        }
        // The kernel may have the earlier bytes.
        let renewed = Some(now.instant);
        let inode = Inode { lookups: UNKNOWN, renewed, was_dropped: true, ..Inode::new(value, sharing, now) };
        self.live.entry(key(number)).or_insert(inode);
    }

    pub(super) fn current(&self, node: Node) -> Option<u64> {
        self.current.get(&node.place()).copied()
    }

    /// Counts a lookup of a node with this value, and returns its nodeid.
    ///
    /// An unread file has a nodeid for each thread that looks it up. The kernel corrects the file's
    /// estimated size when a READ returns less, but only if no LOOKUP or GETATTR of that nodeid was answered
    /// in between: with a shared nodeid, the value would be padded with zero bytes. Lookups of one thread
    /// precede its READ and may share a nodeid; they must, because `cp` takes a file whose inode number
    /// changes for another file.
    pub(super) fn enter(&mut self, node: Node, value: Value, sharing: Sharing, now: Now) -> Shown {
        self.tidy(now);
        let current = self.current(node).filter(|_| sharing != Sharing::Alone);
        let current = current.or_else(|| self.found_again(node, &value, sharing, now));
        if let Some(number) = current
            && let Some(inode) = self.live.get_mut(&key(number))
        {
            // Threads outside this process's PID namespace all have the number 0.
            let own = inode.sharing == sharing && sharing != Sharing::By(0) && !inode.is_awaited();
            if inode.value == value && (own || !matches!(value, Value::Unread(_))) {
                inode.lookups += 1;
                (inode.looks, inode.refusal) = (Some(0), None);
                inode.used = now.instant;
                return self.show(number, now).expect("it is of this node");
            }
            self.retire(number, now);
        }
        let number = self.next(node);
        let inode = Inode::new(value, sharing, now);
        if sharing != Sharing::Alone {
            self.current.insert(node.place(), number);
        }
        self.live.insert(key(number), inode);
        self.show(number, now).expect("it is of this node")
    }

    /// What the kernel is told of a nodeid. While nobody writes to the gauge, what may be written is leased: a later write
    /// to the gauge begins when the lease is over, so that the kernel has asked again before its answer.
    pub(super) fn show(&mut self, number: u64, now: Now) -> Option<Shown> {
        let is_written = self.writes.contains_key(&group(number));
        let inode = self.live.get_mut(&key(number))?;
        let shown = inode.shown(number, now)?;
        if inode.sharing != Sharing::Alone || is_written || !inode.is_settled() {
            return Some(shown);
        }
        inode.leased = Some(now.instant + LEASE_OVER);
        Some(Shown { valid: LEASE, ..shown })
    }

    /// How long a write through a nodeid waits for leases of its gauge's files, but for its own: the kernel drops that.
    pub(super) fn leases(&self, number: u64, now: Now) -> Duration {
        let first = group(number);
        let others = self.live.range(keys(&(first..=first | GROUP))).filter(|&(&at, _)| at != key(number));
        let until = others.filter_map(|(_, inode)| inode.leased).max();
        until.map_or(Duration::ZERO, |until| until.saturating_duration_since(now.instant))
    }

    /// Notes that the kernel may keep the name of a nodeid for some time.
    fn name(&mut self, number: u64, kept: Duration, now: Now) {
        if let Some(inode) = self.live.get_mut(&key(number)).filter(|_| !kept.is_zero()) {
            inode.named = inode.named.max(Some(now.instant + kept + NAME_OVER));
        }
    }

    /// Notes that the kernel has a nodeid's bytes up to `end`.
    pub(super) fn served(&mut self, number: u64, end: u64, now: Now) {
        let Some(inode) = self.live.get_mut(&key(number)) else { return };
        inode.used = now.instant;
        inode.is_read |= end >= inode.value.size();
    }

    /// Marks a nodeid as superseded: its node has another value now.
    pub(super) fn retire(&mut self, number: u64, now: Now) {
        let Some(inode) = self.live.get_mut(&key(number)) else { return };
        // An unread nodeid has not shown any value, so nothing is kept.
        if !matches!(inode.value, Value::Unread(_)) {
            inode.superseded.get_or_insert(now.instant);
        }
        self.drop_current(number);
    }

    fn drop_current(&mut self, number: u64) {
        if let Some(node) = node(number)
            && self.current(node) == Some(number)
        {
            self.current.remove(&node.place());
        }
    }

    /// Files of these nodes whose changes must be noticed: those that show a read value that is not superseded.
    pub(super) fn up_to_date(
        &self,
        places: &RangeInclusive<u32>,
    ) -> impl Iterator<Item = (u64, Node, &Value)> {
        let files = self
            .live
            .range(keys(places))
            .filter(|(_, inode)| inode.superseded.is_none() && !matches!(inode.value, Value::Unread(_)));
        files.filter_map(|(&at, inode)| Some((key(at), node(key(at))?, &inode.value)))
    }

    /// Adds a request that waits for an unread value. Returns whether it is the first, which means that the caller has
    /// to ask for the value.
    pub(super) fn wait(&mut self, number: u64, waiter: W) -> bool {
        let Some(inode) = self.live.get_mut(&key(number)) else { return false };
        let first = inode.waiting.is_none();
        inode.waiting.get_or_insert_default().push(waiter);
        first
    }

    /// Takes the requested value, `None` if it could not be read. Returns what the nodeid shows now, and the requests
    /// that waited.
    pub(super) fn arrived(
        &mut self,
        number: u64,
        value: Option<&Arc<[u8]>>,
        now: Now,
    ) -> Option<(Shown, Vec<W>)> {
        let inode = self.live.get_mut(&key(number))?;
        let waiting = inode.waiting.take().unwrap_or_default();
        inode.used = now.instant;
        if let Some(bytes) = value {
            inode.value = Value::Bytes(bytes.clone());
            inode.refusal = None;
            // A renewed nodeid gets its new size only now.
            inode.renewed = inode.renewed.map(|_| now.instant);
        }
        let is_shared = inode.sharing != Sharing::Alone;
        let is_present = value.is_some() && inode.superseded.is_none() && inode.writing == 0;
        let shown = self.show(number, now)?;
        if is_present && is_shared {
            // Lookups until the next poll find the value that was read.
            if let Some(other) = self.current(shown.node).filter(|&other| other != number) {
                self.retire(other, now);
            }
            self.current.insert(shown.node.place(), number);
        }
        Some((shown, waiting))
    }

    /// Takes back lookups; a nodeid without any is dropped.
    pub(super) fn forget(&mut self, number: u64, lookups: u64) {
        let Some(inode) = self.live.get_mut(&key(number)) else { return };
        inode.lookups = inode.lookups.saturating_sub(lookups);
        if inode.lookups == 0 {
            self.live.remove(&key(number));
            self.drop_current(number);
        }
    }

    /// Counts a request for a nodeid's attributes. Returns whether somebody has it open: both `stat` and `open` look
    /// the name up and ask once, so only `fstat` can ask again. An opener for overwriting does not want the value.
    pub(super) fn ask(&mut self, number: u64) -> bool {
        let Some(looks) = self.live.get_mut(&key(number)).and_then(|inode| inode.looks.as_mut()) else {
            return false;
        };
        *looks = looks.saturating_add(1);
        *looks > 1
    }

    /// Keeps the errno of a value that only `fstat` has asked for. Many programs read on after a failed `fstat`, and
    /// would not hear of a gauge that stays open.
    pub(super) fn refuse(&mut self, number: u64, errno: Errno, now: Now) {
        if let Some(inode) = self.live.get_mut(&key(number)) {
            inode.refusal = Some((errno, now.instant));
        }
    }

    /// The errno for a read that follows the `fstat`, once.
    pub(super) fn take_refusal(&mut self, number: u64, now: Now) -> Option<Errno> {
        let (errno, since) = self.live.get_mut(&key(number))?.refusal.take()?;
        (now.instant.saturating_duration_since(since) < FOLLOWS).then_some(errno)
    }

    /// Notes that a nodeid will be overwritten.
    pub(super) fn overwrite(&mut self, number: u64) {
        if let Some(inode) = self.live.get_mut(&key(number)) {
            inode.looks = None;
        }
    }

    /// Notes that a thread asks for the attribute that precedes a write.
    pub(super) fn asks(&mut self, number: u64, thread: u32) {
        let Some(inode) = self.live.get_mut(&key(number)) else { return };
        let before = if inode.asked.0 == thread { inode.asked.1 } else { 0 };
        inode.asked = (thread, before + 1);
    }

    /// The thread removes that attribute. Returns whether it is about to write: the kernel asks twice before a write,
    /// and once before a change of owner.
    pub(super) fn is_about_to_write(&mut self, number: u64, thread: u32) -> bool {
        let Some(inode) = self.live.get_mut(&key(number)) else { return false };
        let (by, count) = std::mem::take(&mut inode.asked);
        by == thread && count >= 2
    }

    /// A write through this nodeid begins. The kernel's copy has the written text, whatever the outcome.
    pub(super) fn write_begins(&mut self, number: u64, now: Now) {
        *self.writes.entry(group(number)).or_default() += 1;
        self.retire(number, now);
        if let Some(inode) = self.live.get_mut(&key(number)) {
            inode.writing += 1;
        }
    }

    /// A write is about to be answered. The nodeid now shows the file's present value, so that the writer reads the
    /// write's result.
    pub(super) fn write_ends(&mut self, number: u64, value: Value, now: Now) {
        if let Some(writes) = self.writes.get_mut(&group(number)) {
            *writes -= 1;
        }
        self.writes.retain(|_, writes| *writes > 0);
        let Some(inode) = self.live.get_mut(&key(number)) else { return };
        inode.writing -= 1;
        if inode.writing == 0 {
            self.renew(number, value, now);
        }
    }

    /// The node of a nodeid that must be renewed before it is shown.
    pub(super) fn due(&self, number: u64, now: Now) -> Option<Node> {
        let inode = self.get(number)?;
        inode.due().filter(|due| *due <= now.instant).and_then(|_| node(number))
    }

    /// Gives a nodeid its file's present value.
    pub(super) fn renew(&mut self, number: u64, value: Value, now: Now) {
        let Some(inode) = self.live.get_mut(&key(number)) else { return };
        inode.value = value;
        inode.superseded = None;
        inode.renewed = Some(now.instant);
        inode.used = now.instant;
        inode.since = now.time;
        self.touch(number);
    }

    /// Ends settling, or until then gives the nodeid a new file time. During a write it gets one each time: the
    /// kernel's page has what is being written, and a reader that drops it waits until the write is answered.
    pub(super) fn settle(&mut self, number: u64, now: Now) {
        let Some(inode) = self.live.get_mut(&key(number)) else { return };
        inode.used = now.instant;
        inode.renewed = inode.renewed.filter(|&since| now.instant < since + SETTLING);
        if inode.renewed.is_some() || inode.writing > 0 {
            self.touch(number);
        }
    }

    /// The kernel got a folder's names, or with `continued` more of them, and may keep them.
    pub(super) fn listed(&mut self, folder: Node, hash: u64, continued: bool, now: Now) {
        let since = self.started;
        let listing = self.listings.entry(folder).or_insert(Listing { hash: None, since, given: None });
        listing.hash = Some(hash).filter(|_| !continued || listing.hash == Some(hash));
        listing.given = Some(now.instant);
    }

    /// Whether the kernel must drop a folder's unchanged names: comparing them at every poll costs more than sending
    /// them again to a later reader. The folder's time then differs by a nanosecond.
    pub(super) fn has_rested(&mut self, folder: Node, now: Now) -> bool {
        let Some(listing) = self.listings.get_mut(&folder) else { return false };
        if listing.given.is_none_or(|given| now.instant < given + LISTING_KEPT) {
            return false;
        }
        listing.given = None;
        listing.since += Duration::from_nanos(1);
        true
    }

    pub(super) fn is_listed(&self, folder: Node) -> bool {
        self.listings.get(&folder).is_some_and(|listing| listing.given.is_some())
    }

    /// Whether the kernel may keep other names than these. The folder then has another time.
    pub(super) fn has_outdated(&mut self, folder: Node, hash: u64, now: Now) -> bool {
        let Some(listing) = self.listings.get_mut(&folder).filter(|listing| listing.hash != Some(hash))
        else {
            return false;
        };
        (listing.hash, listing.since) = (Some(hash), now.time);
        true
    }

    /// Changes a nodeid's file time, so that the kernel drops its bytes and asks for them again.
    pub(super) fn touch(&mut self, number: u64) {
        if let Some(inode) = self.live.get_mut(&key(number)) {
            inode.since += Duration::from_nanos(1);
            inode.was_dropped = true;
        }
    }
}

/// Counts a lookup of a node, whose name the kernel may keep for some time. The value is asked for under the lock: nobody
/// would notify the kernel of a change in between. `None` if the file does not exist.
pub(super) fn look_up<W>(
    table: &impl Shared<Inodes<W>>,
    node: Node,
    content: impl FnOnce() -> Option<Value>,
    (sharing, kept): (Sharing, Duration),
    now: Now,
) -> Option<Shown> {
    table.with(|inodes| {
        let number = inodes.enter(node, content()?, sharing, now).number;
        inodes.name(number, kept, now);
        inodes.show(number, now)
    })
}

/// A write through a nodeid is about to be answered; the file's value is asked for under the lock.
pub(super) fn end_write<W>(
    table: &impl Shared<Inodes<W>>,
    number: u64,
    present: impl FnOnce() -> Value,
    now: Now,
) {
    table.with(|inodes| inodes.write_ends(number, present(), now));
}

/// What the kernel may keep of values that are no more.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Outdated {
    /// The name of one; it asks again for others.
    pub(super) names: bool,
    /// Nodeids whose attributes it would use for too long.
    pub(super) attributes: Vec<u64>,
}

/// Retires every nodeid of these nodes whose file has another value now. Returns what the kernel may keep of them.
pub(super) fn retire_outdated<W>(
    table: &impl Shared<Inodes<W>>,
    places: &[RangeInclusive<u32>],
    present: impl Fn(Node) -> Value,
    now: impl Fn() -> Now,
) -> Outdated {
    let files: Vec<(u64, Node, Value)> = table.with(|inodes| {
        inodes.tidy(now());
        let files = places.iter().flat_map(|places| inodes.up_to_date(places));
        files.map(|(number, node, value)| (number, node, value.clone())).collect()
    });
    let mut outdated = Outdated::default();
    for (number, node, value) in files {
        if present(node) == value {
            continue;
        }
        table.with(|inodes| {
            let now = now();
            if let Some(inode) = inodes.get(number) {
                outdated.names |= inode.is_named(now);
                outdated.attributes.extend(inode.is_trusted(now).then_some(number));
            }
            inodes.retire(number, now);
        });
    }
    outdated
}

#[cfg(test)]
mod tests;
