// SPDX-License-Identifier: MIT

//! The journal: records on disk what a write is about to do, before it does it.
//!
//! A host that loses power during a write leaves the gauge unsealed or data flash half written. The journal holds the
//! seal state and the blocks from before the write, and what distinguishes the pack. It never holds keys.
//!
//! An entry is on disk before a sealed gauge is opened, and the plan before the first block is written. Mostly the plan is
//! foreseen, and the entry has it from the start; if it comes otherwise, another one is appended. A power cut in between
//! leaves a plan without its last line, which is ignored: nothing had been written yet. A gauge that was found open is owed
//! nothing before there is a plan, with which its entry begins.
//!
//! An access that is over says so in its last line, and leaves its file as a spare one, to which the next entry is appended:
//! to wait for the disk once costs less than a new name, which takes a second wait, as its removal does. The names need not
//! be on disk: what a file says counts.
//!
//! A journal belongs to a pack, and a pack can come back at any place. So the folder is searched as a whole, and a
//! journal leaves it only with its own pack, or because a person says so:
//!
//! * `KEY.journal` is a write at the place KEY. No other write is begun there until it has been settled or set aside.
//!   Other hosts may use the same folder and the same keys: theirs are left alone, and a number keeps names apart.
//! * `KEY.spare` is a file in which nothing is open, for as long as a process uses that place. After a power cut something
//!   may be open in it, or over in one of the others: the first look puts the names right.
//! * `KEY.waiting` and `KEY.N.waiting` wait for packs that may have been exchanged. They stop nothing.
//! * `KEY.dismissed` and `KEY.N.dismissed` were put aside by a person.
//!
//! A process that works on a journal holds its lock, so that it is never taken for one that was left behind.

use std::fmt::Debug;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use sha1::{Digest as _, Sha1};

use crate::chip::{Chip, FLAT};
use crate::codec::{Bytes, WINDOW};
use crate::error::{Cause, Error, Reason, Result};
use crate::gauge::Seal;
use crate::keys::Name;
use crate::text::{hex, unhex};

pub use disk::{Disk, File, Host, save, save_on};
pub use machine::Machine;

mod disk;
mod machine;

const HEAD: &str = "gaugefs journal 4";
/// A previous version, without the sum of its first lines.
const HEAD_3: &str = "gaugefs journal 3";
/// One without the host.
const HEAD_2: &str = "gaugefs journal 2";
/// Begins the line with the sum of the lines before, without which an entry was not begun.
const BEGUN: &str = "begun ";
/// Follows a plan that has come otherwise, before the one that counts.
const INSTEAD: &str = "instead\n";
/// Follows an entry when nothing of it is left to do.
const OVER: &str = "over\n";
/// A file that has grown to that is not used again.
const FULL: usize = 1 << 16;
/// Follows a plan once its reset is about to be sent.
const RESET_SENT: &str = "reset sent\n";
/// Follows a plan of keys once they have been read back.
pub(crate) const KEYS_WRITTEN: &str = "written\n";
/// Marks a plan for values that the gauge itself measures.
const BY_GAUGE: &str = "by gauge\n";
/// Limit for a block's line, and for the other lines together.
const LINE: usize = 160;

/// Ends of file names in the folder: pending, waiting for its pack, and put aside.
const PENDING: &str = "journal";
const SPARE: &str = "spare";
const WAITING: &str = "waiting";
const DISMISSED: &str = "dismissed";
const SEAL: &str = "seal";

/// Finds the account whose files are believed besides this one's and root's. It is asked about the files of others only: to
/// find an account by its name, the system may load libraries and ask servers.
pub type Trusted = fn() -> Option<u32>;

/// Where a gauge's journal is kept.
#[derive(Clone, Debug)]
pub struct Journal {
    disk: Arc<dyn Disk>,
    folder: PathBuf,
    key: String,
    gauge: String,
    machine: Machine,
    trusted: Trusted,
    /// The names in the folder were put right.
    is_tidy: Arc<AtomicBool>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Identity {
    pub(crate) chip: String,
    pub(crate) device_type: u16,
    pub(crate) firmware: u16,
    /// 0 if the part has no register for it.
    pub(crate) serial: u16,
}

impl Identity {
    pub(crate) fn of(chip: &Chip, firmware: u16, serial: u16) -> Self {
        Self { chip: chip.name.into(), device_type: chip.identity.device_type, firmware, serial }
    }

    pub(crate) fn is_of_part(&self, gauge: &Identity, chip: &Chip) -> bool {
        (&self.chip, self.device_type) == (&gauge.chip, gauge.device_type)
            && (self.firmware == gauge.firmware || chip.identity.is_device_number(self.firmware))
    }
}

/// A started write, or a started read of a sealed gauge.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Entry {
    pub(crate) identity: Identity,
    /// The host that began it; `None` in a journal of an earlier version.
    pub(crate) machine: Option<Machine>,
    pub(crate) found: Seal,
    /// `None` before any block was touched.
    pub(crate) plan: Option<Plan>,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Plan {
    pub(crate) reset: bool,
    /// The reset may have been sent, so the gauge may work with the new values.
    pub(crate) reset_sent: bool,
    /// The gauge stores its own measurement in the written bytes, and it is not yet judged: `new` is unknown.
    pub(crate) by_gauge: bool,
    /// Values that distinguish packs, as far as they had been read.
    pub(crate) marks: Vec<Mark>,
    pub(crate) blocks: Vec<PlannedBlock>,
    /// The keys about to be written; `None` for a write of parameters.
    pub(crate) key: Option<KeyPlan>,
}

/// A change of keys: which ones, and its progress. It contains no key, nor anything computed from one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct KeyPlan {
    pub(crate) names: Vec<Name>,
    /// Keys that read as erased flash before.
    pub(crate) erased: Vec<Name>,
    /// This gauge's keys had shown their byte order.
    pub(crate) ordered: bool,
    /// The new keys were in data flash and read back.
    pub(crate) written: bool,
}

impl KeyPlan {
    pub(crate) fn is_over(&self) -> bool {
        self.written
    }

    pub(crate) fn names(&self) -> String {
        self.names.iter().map(|name| name.as_str()).collect::<Vec<_>>().join(" and ")
    }

    /// That key is about to be written, again or in addition.
    pub(crate) fn begin(&mut self, name: Name) {
        self.written = false;
        if !self.names.contains(&name) {
            self.names.push(name);
        }
    }

    fn render(&self) -> String {
        let Self { names, erased, ordered, written: _ } = self;
        let list =
            |names: &[Name]| names.iter().map(|name| format!(" {}", name.as_str())).collect::<String>();
        let order = if *ordered { "ordered" } else { "unordered" };
        format!("keys {order}{} erased{}\n", list(names), list(erased))
    }

    fn parse(line: &str) -> Option<Self> {
        let mut words = line.split(' ');
        let ordered = match words.next()? {
            "ordered" => true,
            "unordered" => false,
            _ => return None,
        };
        let names =
            words.by_ref().take_while(|word| *word != "erased").map(name).collect::<Option<Vec<_>>>()?;
        let erased = words.map(name).collect::<Option<Vec<_>>>()?;
        (!names.is_empty()).then_some(Self { names, erased, ordered, written: false })
    }

    fn follow(&mut self, rest: &str) {
        for line in rest.split_inclusive('\n') {
            if line == KEYS_WRITTEN {
                self.written = true;
            } else if let Some(name) =
                line.strip_prefix("key ").and_then(|rest| name(rest.strip_suffix('\n')?))
            {
                self.begin(name);
            } else {
                self.written = false;
            }
        }
    }
}

fn name(word: &str) -> Option<Name> {
    Name::ALL.into_iter().find(|name| name.as_str() == word)
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Mark {
    pub(crate) subclass: u8,
    pub(crate) offset: u16,
    pub(crate) bytes: Vec<u8>,
}

/// A block before and after. An unchanged neighbour has the same bytes in both.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct PlannedBlock {
    pub(crate) subclass: u8,
    pub(crate) base: u16,
    pub(crate) written: Bytes,
    pub(crate) old: [u8; WINDOW],
    pub(crate) new: [u8; WINDOW],
}

#[derive(Debug)]
pub(crate) struct OpenJournal {
    disk: Arc<dyn Disk>,
    file: Box<dyn File>,
    path: PathBuf,
    /// The name that the file gets when the access is over; `None` if it is removed then.
    spare: Option<PathBuf>,
    /// It has a plan, or what was foreseen as one.
    is_planned: bool,
}

#[derive(Debug)]
pub(crate) struct Found {
    pub(crate) path: PathBuf,
    /// It was begun at this place, and is not set aside.
    pub(crate) is_here: bool,
    pub(crate) content: Content,
}

#[derive(Debug)]
pub(crate) enum Content {
    Entry(Entry),
    /// Another process works on it.
    InUse(String),
    Unreadable(Error),
}

impl Journal {
    /// `key` identifies the gauge's connection and must be unique on this host; `gauge` is the name in the file.
    pub fn new(folder: PathBuf, key: String, gauge: String) -> Self {
        let machine = Machine::this().clone();
        let (disk, is_tidy) = (Arc::new(disk::Host), Arc::default());
        Self { disk, folder, key, gauge, machine, trusted: || None, is_tidy }
    }

    /// Keeps the journal on another disk.
    pub fn on(self, disk: Arc<dyn Disk>) -> Self {
        Self { disk, ..self }
    }

    /// Names another host, for tests.
    #[must_use]
    pub fn of_host(self, name: &str) -> Self {
        Self { machine: Machine::named(name), ..self }
    }

    /// Also believes journals of an account such as a service's, whose folder root uses.
    #[must_use]
    pub fn trusting(self, account: Trusted) -> Self {
        Self { trusted: account, ..self }
    }

    /// The file of a write at this place, unless another host uses that name.
    pub fn path(&self) -> PathBuf {
        self.numbered(PENDING, 0)
    }

    /// Unsettled journals of this place and this host.
    pub fn unsettled(&self) -> Vec<PathBuf> {
        let paths = self.pending().unwrap_or_default();
        paths.into_iter().filter(|path| self.is_key_of(path) && !self.is_of_other_host(path)).collect()
    }

    /// Journals of this place that a person has put aside.
    pub fn dismissed(&self) -> Vec<PathBuf> {
        let paths = self.files(DISMISSED).unwrap_or_default();
        paths.into_iter().filter(|path| self.is_key_of(path)).collect()
    }

    fn numbered(&self, end: &str, number: u32) -> PathBuf {
        self.folder.join(match number {
            0 => format!("{}.{end}", self.key),
            number => format!("{}.{number}.{end}", self.key),
        })
    }

    fn files(&self, end: &str) -> io::Result<Vec<PathBuf>> {
        let mut paths = match self.disk.list(&self.folder) {
            Err(error) if error.kind() == ErrorKind::NotFound => Vec::new(),
            paths => paths?,
        };
        paths.retain(|path| path.extension().is_some_and(|found| found == end));
        paths.sort();
        Ok(paths)
    }

    /// The files of the folder that are named as open ones. The first time, names are put right that a power cut has left.
    fn pending(&self) -> io::Result<Vec<PathBuf>> {
        if !self.is_tidy.swap(true, Ordering::Relaxed) {
            for path in self.files(SPARE)?.into_iter().chain(self.files(PENDING)?) {
                self.put_right(&path)?;
            }
        }
        self.files(PENDING)
    }

    /// Gives a file the name that is right by what it says. No file is removed, as another entry may begin in it meanwhile.
    fn put_right(&self, path: &Path) -> io::Result<()> {
        let Ok(text) = self.disk.read(path) else { return Ok(()) };
        let is_open = open_entry(&text).is_some();
        let right = path.with_extension(if is_open { PENDING } else { SPARE });
        if right == path || self.disk.is_locked(path).unwrap_or(true) {
            return Ok(());
        }
        match self.disk.rename_new(path, &right) {
            Err(error) if is_open && error.kind() != ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        }
    }

    /// Removes the spare file, if there is one. Nothing is lost if it stays.
    pub(crate) fn remove_spare(&self) {
        let _ = self.disk.remove(&self.numbered(SPARE, 0));
    }

    fn is_key_of(&self, path: &Path) -> bool {
        let Some(stem) = path.file_stem().and_then(|stem| stem.to_str()) else { return false };
        let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        match stem.strip_prefix(&self.key).map(|rest| rest.strip_prefix('.').ok_or(rest)) {
            Some(Ok(number)) => is_number(number),
            Some(Err(rest)) => rest.is_empty(),
            None => false,
        }
    }

    /// Whether another host has written a journal. An unreadable one may be ours.
    fn is_of_other_host(&self, path: &Path) -> bool {
        let Ok(text) = self.disk.read(path) else { return false };
        match open_entry(&text) {
            Some(_) => parse(&text).is_some_and(|entry| !self.is_ours(&entry)),
            None => !self.was_ours(&text),
        }
    }

    /// Whether all that is over in a file was of this host.
    fn was_ours(&self, text: &str) -> bool {
        text.lines().filter_map(Machine::parse).all(|machine| machine.is(&self.machine))
    }

    fn is_ours(&self, entry: &Entry) -> bool {
        entry.machine.as_ref().is_none_or(|machine| machine.is(&self.machine))
    }

    fn check_folder(&self) -> Result<()> {
        let checked = self.disk.check(&self.folder, self.trusted);
        checked.map_err(|error| untrusted(&self.folder, &error))
    }

    /// All journals of the folder, this place's first, without the known ones in `skip`.
    pub(crate) fn search(&self, waiting: bool, skip: &[PathBuf]) -> Result<Vec<Found>> {
        let unlisted =
            |error| Error::io(self.folder.display().to_string(), "cannot look for journals", &error);
        let listed = if waiting { self.files(WAITING) } else { self.pending() };
        let mut paths = listed.map_err(unlisted)?;
        paths.retain(|path| !skip.contains(path));
        if paths.is_empty() {
            return Ok(Vec::new());
        }
        self.check_folder()?;
        let (mut found, mut elsewhere) = (Vec::new(), Vec::new());
        for path in paths {
            let Some(content) = self.content(&path) else { continue };
            let is_ours = match &content {
                Content::Entry(entry) => self.is_ours(entry),
                Content::InUse(_) | Content::Unreadable(_) => true,
            };
            let is_here = !waiting && self.is_key_of(&path) && is_ours;
            if is_here { &mut found } else { &mut elsewhere }.push(Found { path, is_here, content });
        }
        found.extend(elsewhere);
        Ok(found)
    }

    /// A file's content; `None` if it is gone, or if another host works on it.
    fn content(&self, path: &Path) -> Option<Content> {
        let name = path.display().to_string();
        if let Err(error) = self.disk.check(path, self.trusted) {
            return (error.kind() != ErrorKind::NotFound)
                .then(|| Content::Unreadable(untrusted(path, &error)));
        }
        let text = match self.disk.read(path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return None,
            Ok(text) if open_entry(&text).is_none() => return None,
            read => read.map_err(|error| Error::io(&name, "cannot read the journal", &error)),
        };
        let entry = text.and_then(|text| {
            let why =
                "not a whole journal of this version of gaugefs; inspect it, and move it away or discard it";
            parse(&text).ok_or_else(|| Error::new(&name, Cause::BadChecksum, why))
        });
        let other = entry.as_ref().ok().and_then(|entry| entry.machine.as_ref()).filter(|machine| {
            // Where locks do not work, another host may be at work on it.
            !machine.is(&self.machine)
        });
        match (self.disk.is_locked(path), other) {
            (Ok(false), _) | (Err(_), None) => {}
            (_, Some(_)) => return None,
            (Ok(true), None) => {
                let why = format!("{name}: another gaugefs is writing to the gauge at this place");
                return Some(Content::InUse(why));
            }
        }
        Some(match entry {
            Ok(entry) => Content::Entry(entry),
            Err(error) => Content::Unreadable(error),
        })
    }

    pub(crate) fn look(&self, path: &Path) -> Option<Content> {
        self.content(path)
    }

    /// Starts an entry with room for so many blocks, on disk and locked on return. An existing one is not replaced.
    pub(crate) fn begin(
        &self,
        identity: &Identity,
        found: Seal,
        blocks: usize,
        plan: Option<&Plan>,
    ) -> Result<OpenJournal> {
        if self.disk.exists(&self.folder) {
            self.check_folder()?;
        }
        let begun = self.entry(identity, found, plan);
        if let Some(journal) = self.begin_in_spare(&begun, blocks, plan)? {
            return Ok(journal);
        }
        for number in 0.. {
            let path = self.numbered(PENDING, number);
            if self.disk.exists(&path) {
                if self.is_of_other_host(&path) {
                    continue;
                }
                let what = "an interrupted write is not settled yet; see gaugefs settle".into();
                return Err(Error::of(path.display().to_string(), Reason::Owed { decision: false, what }));
            }
            match self.store(&path, true, &begun, blocks, plan) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists && self.disk.exists(&path) => {}
                stored => return stored.map_err(|error| refused(&path, &error)),
            }
        }
        unreachable!("there are enough numbers")
    }

    /// Begins an entry in the spare file, if it can be used.
    fn begin_in_spare(&self, begun: &str, blocks: usize, plan: Option<&Plan>) -> Result<Option<OpenJournal>> {
        let (spare, path) = (self.numbered(SPARE, 0), self.path());
        self.put_right(&path).map_err(|error| refused(&path, &error))?;
        let Ok(mut file) = self.disk.open(&spare) else { return Ok(None) };
        let is_believed = self.disk.check(&spare, self.trusted).is_ok();
        let text = match file.lock() {
            Ok(true) if is_believed => self.disk.read(&spare).unwrap_or_default(),
            _ => return Ok(None),
        };
        if open_entry(&text).is_some() || !self.was_ours(&text) {
            return Ok(None);
        }
        if !text.ends_with(OVER) || text.len() > FULL {
            let _ = self.disk.remove(&spare);
            return Ok(None);
        }
        if self.disk.rename_new(&spare, &path).is_err() {
            return Ok(None);
        }
        let room = text.len() + begun.len() + room(blocks);
        let stored = file.reserve(room as u64).and_then(|()| file.append(begun.as_bytes()));
        if let Err(error) = stored.and_then(|()| file.sync()) {
            let _ = self.disk.remove(&path);
            return Err(refused(&path, &error));
        }
        Ok(Some(self.opened(path, file, plan)))
    }

    /// Replaces an entry that owes only a seal.
    pub(crate) fn replace(
        &self,
        path: &Path,
        identity: &Identity,
        found: Seal,
        plan: Option<&Plan>,
    ) -> Result<OpenJournal> {
        let begun = self.entry(identity, found, plan);
        self.store(path, false, &begun, 0, plan).map_err(|error| refused(path, &error))
    }

    /// The text of an entry.
    fn entry(&self, identity: &Identity, found: Seal, plan: Option<&Plan>) -> String {
        let Identity { chip, device_type, firmware, serial } = identity;
        let head = format!(
            "{HEAD}\ngauge {}\npart {chip} {device_type:04x} {firmware:04x} {serial:04x}\nfound {}\n{}\n",
            self.gauge,
            found.as_str(),
            self.machine,
        );
        let sum = sum(&head);
        head + &format!("{BEGUN}{sum}\n") + &plan.map(render).unwrap_or_default()
    }

    fn opened(&self, path: PathBuf, file: Box<dyn File>, plan: Option<&Plan>) -> OpenJournal {
        let spare = (path == self.path()).then(|| self.numbered(SPARE, 0));
        let mut opened =
            OpenJournal { disk: self.disk.clone(), file, path, spare, is_planned: plan.is_some() };
        plan.iter().for_each(|plan| opened.judge(plan));
        opened
    }

    fn store(
        &self,
        path: &Path,
        is_new: bool,
        begun: &str,
        blocks: usize,
        plan: Option<&Plan>,
    ) -> io::Result<OpenJournal> {
        // Nobody else writes to a file of that name.
        let mut random = [0; 4];
        getrandom::fill(&mut random).map_err(io::Error::other)?;
        let temporary = self.folder.join(format!("{}.{}.new", self.key, hex(&random)));
        let how = disk::How::Journal { is_new, room: room(blocks) };
        let file = disk::store(&*self.disk, path, &temporary, begun, how)?;
        Ok(self.opened(path.into(), file, plan))
    }

    /// Reopens and locks the entry of an interrupted write. `None` if it is gone.
    pub(crate) fn open(&self, path: &Path) -> Result<Option<OpenJournal>> {
        let mut file = match self.disk.open(path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            file => file.map_err(|error| refused(path, &error))?,
        };
        if !file.lock().map_err(|error| refused(path, &error))? {
            return Err(in_use(path));
        }
        let disk = self.disk.clone();
        Ok(Some(OpenJournal { disk, file, path: path.into(), spare: None, is_planned: false }))
    }

    fn seal_path(&self) -> PathBuf {
        self.numbered(SEAL, 0)
    }

    /// Records an owed seal. On return that is on disk.
    pub(crate) fn owe_seal(&self, identity: &Identity) -> Result<OpenJournal> {
        self.replace(&self.seal_path(), identity, Seal::Sealed, None)
    }

    pub(crate) fn seal_owed(&self) -> Result<Option<Entry>> {
        match self.content(&self.seal_path()) {
            Some(Content::Entry(entry)) => Ok(Some(entry).filter(|entry| self.is_ours(entry))),
            Some(Content::Unreadable(error)) => Err(error),
            Some(Content::InUse(_)) | None => Ok(None),
        }
    }

    pub(crate) fn seal_paid(&self) -> Result<()> {
        let path = self.seal_path();
        if !self.disk.exists(&path) {
            return Ok(());
        }
        let removed = self.disk.remove(&path).and_then(|()| self.disk.sync(&self.folder));
        removed.map_err(|error| {
            Error::io(path.display().to_string(), "cannot remove the record of a seal", &error)
        })
    }

    /// Sets an entry aside until its pack returns. Returns its new name.
    pub(crate) fn wait(&self, path: &Path) -> Result<PathBuf> {
        self.set_aside(path, WAITING)
    }

    /// Sets an entry aside for good. Returns its new name.
    pub(crate) fn dismiss(&self, path: &Path) -> Result<PathBuf> {
        self.set_aside(path, DISMISSED)
    }

    pub(crate) fn withdraw(&self, path: &Path) -> Result<()> {
        let removed = self.disk.remove(path).and_then(|()| self.disk.sync(&self.folder));
        removed.map_err(|error| not_removed(path, &error))
    }

    pub(crate) fn waiting(&self) -> Result<Vec<(PathBuf, Entry)>> {
        let found = self.search(true, &[])?.into_iter().filter(|found| self.is_key_of(&found.path));
        let entry = |found: Found| match found.content {
            Content::Entry(entry) if self.is_ours(&entry) => Some((found.path, entry)),
            _ => None,
        };
        Ok(found.filter_map(entry).collect())
    }

    /// Renames an entry to a free name: no journal replaces another.
    fn set_aside(&self, path: &Path, end: &str) -> Result<PathBuf> {
        let failed = |error| Error::io(path.display().to_string(), "cannot move the journal", &error);
        for number in 0.. {
            let aside = self.numbered(end, number);
            match self.disk.rename_new(path, &aside) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                moved => {
                    return moved.and_then(|()| self.disk.sync(&self.folder)).map(|()| aside).map_err(failed);
                }
            }
        }
        unreachable!("there are enough numbers")
    }
}

/// Checks that only this account, root or a trusted one can have written a file, or can replace a folder's files.
pub fn check(path: &Path, trusted: Trusted) -> Result<()> {
    is_own(path, trusted).map_err(|error| untrusted(path, &error))
}

/// Why somebody else can have written a file, or can replace the contents of a folder.
pub fn is_own(path: &Path, trusted: Trusted) -> io::Result<()> {
    disk::Host.check(path, trusted)
}

fn untrusted(path: &Path, error: &io::Error) -> Error {
    let why = format!(
        "{error}, so what is there is not believed, and nothing is written to the gauge: make it your own and only yours \
         to write (chown, chmod go-w), or choose another folder with --state-dir"
    );
    Error::new(path.display().to_string(), Cause::NotPermitted, why)
}

impl OpenJournal {
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// A journal of keys is removed, whatever comes to the disk of its last line: half of one says that nothing is certain.
    fn judge(&mut self, plan: &Plan) {
        if plan.key.is_some() {
            self.spare = None;
        }
    }

    /// Appends a plan, which counts instead of what was foreseen. On return it is on disk.
    pub(crate) fn plan(&mut self, plan: &Plan) -> Result<()> {
        self.judge(plan);
        let text = if std::mem::replace(&mut self.is_planned, true) { INSTEAD } else { "" };
        let text = text.to_string() + &render(plan);
        let stored = self.file.append(text.as_bytes()).and_then(|()| self.file.sync());
        stored.map_err(|error| refused(&self.path, &error))
    }

    /// Notes that a reset is about to be sent. That outlives the process; only [`Self::sync`] has it on disk.
    pub(crate) fn reset_sent(&mut self) -> Result<()> {
        self.file.append(RESET_SENT.as_bytes()).map_err(|error| refused(&self.path, &error))
    }

    /// Returns once all that was noted is on disk.
    pub(crate) fn sync(&mut self) -> Result<()> {
        self.file.sync().map_err(|error| refused(&self.path, &error))
    }

    /// Appends a line about a plan's progress. On return it is on disk.
    pub(crate) fn note(&mut self, line: &str) -> Result<()> {
        let stored = self.file.append(line.as_bytes()).and_then(|()| self.file.sync());
        stored.map_err(|error| refused(&self.path, &error))
    }

    /// The access is over: on return that is on disk.
    pub(crate) fn remove(mut self) -> Result<()> {
        if let Some(spare) = self.spare.take()
            && self.file.append(OVER.as_bytes()).and_then(|()| self.file.sync()).is_ok()
        {
            return self.disk.rename(&self.path, &spare).map_err(|error| not_removed(&self.path, &error));
        }
        let removed = self.disk.remove(&self.path);
        removed
            .and_then(|()| self.path.parent().map_or(Ok(()), |folder| self.disk.sync(folder)))
            .map_err(|error| not_removed(&self.path, &error))
    }
}

pub(crate) fn in_use(path: &Path) -> Error {
    let what = "another gaugefs works on this journal".into();
    Error::of(path.display().to_string(), Reason::InUse { process: None, mountpoint: None, what })
}

fn not_removed(path: &Path, error: &io::Error) -> Error {
    Error::io(path.display().to_string(), "cannot remove the journal", error)
}

fn refused(path: &Path, error: &io::Error) -> Error {
    let what = "cannot write the journal, so nothing was written to the gauge (choose another folder with \
                --state-dir)";
    Error::io(path.display().to_string(), what, error)
}

/// Room for lines that are appended: marks, and a neighbour on either side of each block.
fn room(blocks: usize) -> usize {
    LINE * (3 * blocks + 8)
}

fn render(plan: &Plan) -> String {
    let Plan { reset, reset_sent: _, by_gauge, marks, blocks, key } = plan;
    let mut text = format!("reset {reset}\n");
    if *by_gauge {
        text += BY_GAUGE;
    }
    if let Some(key) = key {
        text += &key.render();
    }
    for Mark { subclass, offset, bytes } in marks {
        text += &format!("mark {subclass} {offset} {}\n", hex(bytes));
    }
    for PlannedBlock { subclass, base, written, old, new } in blocks {
        text += &format!("block {subclass} {base} {:08x} {} {}\n", written.0, hex(old), hex(new));
    }
    let sum = sum(&text);
    text + &format!("end {sum}\n")
}

/// Distinguishes a complete plan from one with missing pages.
fn sum(text: &str) -> String {
    hex(&Sha1::digest(text))
}

/// The entry of a file that is not over, as far as one was begun: before that is on disk nothing is sent.
fn open_entry(text: &str) -> Option<&str> {
    let Some((_, last)) = text.rsplit_once(&format!("\n{OVER}")) else { return Some(text) };
    let (head, rest) = last.split_once(&format!("\n{BEGUN}"))?;
    let (sum, _) = rest.split_once('\n')?;
    (!is_torn(head) && !is_torn(sum)).then_some(last)
}

/// `None` for anything but a journal, or for a complete plan with other content than was written.
fn parse(text: &str) -> Option<Entry> {
    let text = open_entry(text)?;
    let (head, rest) = text.split_once('\n')?;
    let (gauge, rest) = rest.split_once('\n')?;
    let (part, rest) = rest.split_once('\n')?;
    let (found, rest) = rest.split_once('\n')?;
    let (machine, rest) = match head {
        HEAD_2 => (None, rest),
        HEAD | HEAD_3 => {
            let (host, rest) = rest.split_once('\n')?;
            (Some(Machine::parse(host)?), rest)
        }
        _ => return None,
    };
    let plan = match head {
        HEAD => {
            let (said, plan) = rest.strip_prefix(BEGUN)?.split_once('\n')?;
            (said == sum(&text[..text.len() - rest.len()])).then_some(plan)?
        }
        _ => rest,
    };
    if !gauge.starts_with("gauge ") {
        return None;
    }
    let identity = parse_identity(part.strip_prefix("part ")?)?;
    let word = found.strip_prefix("found ")?;
    let found =
        [Seal::Sealed, Seal::Unsealed, Seal::FullAccess].into_iter().find(|seal| seal.as_str() == word)?;
    Some(Entry { identity, machine, found, plan: parse_plans(plan)? })
}

/// The plan that counts: the last one that is complete. `None` if there is something else.
fn parse_plans(text: &str) -> Option<Option<Plan>> {
    // A line that was about to follow, but that of a reset, says nothing.
    let (lines, last) = text.split_at(text.rfind('\n').map_or(0, |at| at + 1));
    let text = if [OVER, INSTEAD].iter().any(|line| line.starts_with(last)) { lines } else { text };
    if let Some((foreseen, plan)) = text.split_once(&format!("\n{INSTEAD}")) {
        let plan = parse_ended(plan)?;
        return if plan.is_some() { Some(plan) } else { parse_ended(&format!("{foreseen}\n")) };
    }
    parse_ended(text)
}

/// A plan and what follows it; nothing if not all of it has come to the disk.
fn parse_ended(plan: &str) -> Option<Option<Plan>> {
    // Anything behind the last line, or a part of that, means that the reset may have been sent.
    let ended = plan.rsplit_once("\nend ").and_then(|(text, end)| Some((text, end.split_once('\n')?)));
    let Some((text, (end, rest))) = ended else { return is_begun(plan).then_some(None) };
    let text = format!("{text}\n");
    if end != sum(&text) {
        return (is_torn(&text) || is_torn(end)).then_some(None);
    }
    let mut plan = Plan { reset_sent: !rest.is_empty(), ..parse_plan(&text)? };
    if let Some(key) = &mut plan.key {
        plan.reset_sent = false;
        key.follow(rest);
    }
    Some(Some(plan))
}

/// Whether a page did not reach the disk. No block had been written then.
fn is_torn(text: &str) -> bool {
    text.contains('\0')
}

fn is_begun(text: &str) -> bool {
    let (lines, last) = text.rsplit_once('\n').unwrap_or(("", text));
    let is_last = |word: &str| word.starts_with(last) || last.starts_with(word);
    let is_plan = || lines.is_empty() || parse_plan(lines).is_some();
    is_torn(text)
        || is_plan() && ["reset ", BY_GAUGE, "keys ", "mark ", "block ", "end "].into_iter().any(is_last)
}

fn parse_identity(text: &str) -> Option<Identity> {
    let mut words = text.split(' ');
    let chip = words.next()?.to_string();
    let mut word = || u16::from_str_radix(words.next()?, 16).ok();
    let (device_type, firmware, serial) = (word()?, word()?, word()?);
    words.next().is_none().then_some(Identity { chip, device_type, firmware, serial })
}

fn parse_plan(text: &str) -> Option<Plan> {
    let mut lines = text.lines();
    let reset = lines.next()?.strip_prefix("reset ")?.parse().ok()?;
    let (mut marks, mut blocks, mut key, mut by_gauge) = (Vec::new(), Vec::new(), None, false);
    for line in lines {
        if line == BY_GAUGE.trim_end() {
            by_gauge = true;
            continue;
        }
        if let Some(keys) = line.strip_prefix("keys ") {
            key = Some(KeyPlan::parse(keys)?);
            continue;
        }
        match line.strip_prefix("mark ") {
            Some(mark) => marks.push(parse_mark(mark)?),
            None => blocks.push(parse_block(line.strip_prefix("block ")?)?),
        }
    }
    Some(Plan { reset, reset_sent: false, by_gauge, marks, blocks, key })
}

fn parse_mark(line: &str) -> Option<Mark> {
    let mut words = line.split(' ');
    let (subclass, offset) = (words.next()?.parse().ok()?, words.next()?.parse().ok()?);
    let bytes = unhex(words.next()?.as_bytes())?;
    words.next().is_none().then_some(Mark { subclass, offset, bytes })
}

fn parse_block(line: &str) -> Option<PlannedBlock> {
    let mut words = line.split(' ');
    let subclass = words.next()?.parse().ok()?;
    let base: u16 = words.next()?.parse().ok()?;
    let written = Bytes(u32::from_str_radix(words.next()?, 16).ok()?);
    let (old, new) = (parse_bytes(words.next()?)?, parse_bytes(words.next()?)?);
    // A block that no gauge has would be an unselectable address.
    let exists = subclass == FLAT && base.checked_add(WINDOW as u16).is_some()
        || usize::from(base) % WINDOW == 0 && usize::from(base) / WINDOW <= usize::from(u8::MAX);
    (exists && words.next().is_none()).then_some(PlannedBlock { subclass, base, written, old, new })
}

fn parse_bytes(digits: &str) -> Option<[u8; WINDOW]> {
    unhex(digits.as_bytes())?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each mount of root looked for the account, which loads libraries into the daemon for good.
    #[test]
    fn only_the_files_of_others_need_a_trusted_account() {
        let folder = std::env::temp_dir().join(format!("gaugefs-own-{}", std::process::id()));
        std::fs::create_dir(&folder).expect("a folder");
        is_own(&folder, || unreachable!("it is this account's")).expect("it is believed");
        std::fs::remove_dir(&folder).expect("removed");
    }

    #[test]
    fn only_a_complete_plan_counts() {
        let written = Bytes(0x0060_0000);
        let block = PlannedBlock { subclass: 80, base: 32, written, old: [0xa5; 32], new: [7; 32] };
        let marks = vec![Mark { subclass: 104, offset: 4, bytes: vec![1, 2, 0xff, 0] }];
        let blocks = vec![block.clone(), block];
        for by_gauge in [false, true] {
            let plan = Plan {
                reset: true,
                by_gauge,
                marks: marks.clone(),
                blocks: blocks.clone(),
                ..Plan::default()
            };
            only_complete(&plan);
        }
    }

    fn only_complete(plan: &Plan) {
        let identity =
            Identity { chip: "bq34z100-g1".into(), device_type: 0x100, firmware: 0x202, serial: 1 };
        let machine = Machine::named("bench");
        let head = format!(
            "{HEAD}\ngauge i2c-1 address 0x55\npart bq34z100-g1 0100 0202 0001\nfound sealed\n\
             host bench bench bench\n"
        );
        let head = format!("{head}{BEGUN}{}\n", sum(&head));
        let text = head.clone() + &render(plan);
        assert!(text.len() < LINE * 8, "room for two blocks: {}", text.len());
        let nothing = Entry { identity, machine: Some(machine), found: Seal::Sealed, plan: None };
        let entry = Entry { plan: Some(plan.clone()), ..nothing.clone() };
        assert_eq!(parse(&text), Some(entry));
        // Under miri a parse takes a tenth of a second.
        for length in (0..text.len()).step_by(if cfg!(miri) { 41 } else { 1 }) {
            let expected = (length >= head.len()).then(|| nothing.clone());
            assert_eq!(parse(&text[..length]), expected, "{length} bytes of it");
            // A page that never reached the disk reads as zeros.
            let holed = text[..length].to_string() + &"\0".repeat(text.len() - length);
            assert_eq!(parse(&holed), expected, "zeros behind {length} bytes");
        }
        // Any part of the last line means that the reset may have been sent.
        for length in 1..=RESET_SENT.len() {
            let plan = Plan { reset_sent: true, ..plan.clone() };
            let entry = Entry { plan: Some(plan), ..nothing.clone() };
            assert_eq!(parse(&(text.clone() + &RESET_SENT[..length])), Some(entry), "{length} bytes of it");
        }
        is_appended(&head, plan, &nothing);
    }

    /// What is appended counts once all of it is on disk; until then it is as if nothing had been.
    fn is_appended(head: &str, plan: &Plan, nothing: &Entry) {
        let entry = |plan: &Plan| Some(Entry { plan: Some(plan.clone()), ..nothing.clone() });
        let other = Plan { reset: !plan.reset, ..plan.clone() };
        let text = head.to_string() + &render(plan);
        let appended = |text: &str, more: &str, before: &Option<Entry>, after: &Option<Entry>| {
            for length in (0..=more.len()).step_by(if cfg!(miri) { 41 } else { 1 }) {
                let expected = if length == more.len() { after } else { before };
                assert_eq!(
                    parse(&(text.to_string() + &more[..length])),
                    *expected,
                    "{length} bytes of {more}"
                );
            }
        };
        let instead = INSTEAD.to_string() + &render(&other);
        appended(&text, &instead, &entry(plan), &entry(&other));
        for begun in [head, &text, &(text.clone() + &instead), &(text.clone() + RESET_SENT)] {
            appended(begun, OVER, &parse(begun), &None);
        }
        // A new entry behind one that is over.
        let over = text.clone() + OVER;
        appended(&over, head, &None, &Some(nothing.clone()));
        for length in (1..head.len()).step_by(if cfg!(miri) { 41 } else { 1 }) {
            let zeros = |count: usize| "\0".repeat(count);
            let holed = [
                over.clone() + &head[..length] + &zeros(head.len() - length),
                over.clone() + &zeros(length) + &head[length..],
            ];
            assert!(holed.iter().all(|text| open_entry(text).is_none() && parse(text).is_none()), "{length}");
        }
        assert_eq!(parse(&(over.clone() + &text)), entry(plan));
        let damaged = over + &text.replace("found sealed", "found unsealed");
        assert!(parse(&damaged).is_none() && open_entry(&damaged).is_some(), "a person looks at it");
    }

    /// A folder with a spare file that this host has left.
    fn with_spare(name: &str) -> (Journal, Identity) {
        let folder = std::env::temp_dir().join(format!("gaugefs-spare-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        let journal = Journal::new(folder, "i2c-1-55".into(), "i2c-1 address 0x55".into()).of_host("one");
        let identity =
            Identity { chip: "bq34z100-g1".into(), device_type: 0x100, firmware: 0x202, serial: 1 };
        journal.begin(&identity, Seal::Sealed, 1, None).and_then(OpenJournal::remove).expect("a disk");
        assert!(journal.numbered(SPARE, 0).exists() && !journal.path().exists());
        (journal, identity)
    }

    #[test]
    fn half_an_entry_is_not_followed_by_another() {
        let (journal, identity) = with_spare("half");
        let mut spare = disk::Host.open(&journal.numbered(SPARE, 0)).expect("it is there");
        spare.append(b"gaugefs journal 4\ngauge i2c").expect("a disk");
        drop(spare);
        journal.begin(&identity, Seal::Sealed, 1, None).expect("a disk");
        assert!(matches!(journal.look(&journal.path()), Some(Content::Entry(_))));
        let _ = std::fs::remove_dir_all(&journal.folder);
    }

    #[test]
    fn a_spare_file_of_another_host_is_left_alone() {
        let (journal, identity) = with_spare("other");
        let spare = journal.numbered(SPARE, 0);
        let text = disk::Host.read(&spare).expect("it is there");
        let other = journal.clone().of_host("two");
        other.begin(&identity, Seal::Sealed, 1, None).expect("a disk");
        assert_eq!(disk::Host.read(&spare).expect("it is there"), text);
        assert!(!disk::Host.read(&other.path()).expect("its own").contains("host one"));
        let _ = std::fs::remove_dir_all(&journal.folder);
    }

    #[test]
    fn a_change_of_keys_is_written_when_the_whole_line_says_so() {
        let key = KeyPlan {
            names: vec![Name::Unseal],
            erased: vec![Name::FullAccess, Name::Authentication],
            ordered: true,
            written: false,
        };
        let plan = Plan { key: Some(key.clone()), ..Plan::default() };
        let text = format!("{HEAD_3}\ngauge a\npart bq34z100-g1 0100 0202 0001\nfound sealed\nhost a b c\n")
            + &render(&plan);
        let read = |rest: &str| {
            let entry = parse(&(text.clone() + rest)).expect("a journal");
            entry.plan.and_then(|plan| plan.key).expect("keys")
        };
        assert_eq!(read(""), key);
        let both = vec![Name::Unseal, Name::Authentication];
        for (rest, written, names) in [
            ("written\n", true, &key.names),
            ("written", false, &key.names),
            ("key authenti", false, &key.names),
            ("key authentication\n", false, &both),
            ("written\nkey authentication\n", false, &both),
            ("written\nkey auth", false, &key.names),
            ("key authentication\nwritten\n", true, &both),
            ("written\nkey unseal\n", false, &key.names),
        ] {
            assert_eq!(read(rest), KeyPlan { written, names: names.clone(), ..key.clone() }, "{rest}");
        }
    }

    #[test]
    fn impossible_blocks_are_refused() {
        let line = |subclass: u8, base: u32| {
            parse_block(&format!("{subclass} {base} 00000001 {} {}", "00".repeat(32), "01".repeat(32)))
        };
        assert!(line(80, 32).is_some() && line(80, 255 * 32).is_some() && line(FLAT, 0x41f5).is_some());
        for (subclass, base) in [(80, 65504), (80, 33), (80, 256 * 32), (FLAT, 0xffff), (80, 70_000)] {
            assert!(line(subclass, base).is_none(), "{subclass} {base}");
        }
    }
}
