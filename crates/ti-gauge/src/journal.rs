// SPDX-License-Identifier: MIT

//! The journal: records on disk what a write is about to do, before it does it.
//!
//! A host that loses power during a write leaves the gauge unsealed or data flash half written. The journal holds the
//! seal state and the blocks from before the write, and what distinguishes the pack. It never holds keys.
//!
//! The file is created before a sealed gauge is opened; the plan is appended before the first block is written. A power cut
//! in between leaves a plan without its last line, which is ignored: nothing had been written yet. A gauge that was found
//! open is owed nothing before there is a plan, with which its file is created.
//!
//! A journal belongs to a pack, and a pack can come back at any place. So the folder is searched as a whole, and a
//! journal leaves it only with its own pack, or because a person says so:
//!
//! * `KEY.journal` is a write at the place KEY. No other write is begun there until it has been settled or set aside.
//!   Other hosts may use the same folder and the same keys: theirs are left alone, and a number keeps names apart.
//! * `KEY.waiting` and `KEY.N.waiting` wait for packs that may have been exchanged. They stop nothing.
//! * `KEY.dismissed` and `KEY.N.dismissed` were put aside by a person.
//!
//! A process that works on a journal holds its lock, so that it is never taken for one that was left behind.

use std::fmt::Debug;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

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

const HEAD: &str = "gaugefs journal 3";
/// The previous version, without the host.
const HEAD_2: &str = "gaugefs journal 2";
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
const WAITING: &str = "waiting";
const DISMISSED: &str = "dismissed";
const SEAL: &str = "seal";

/// Where a gauge's journal is kept.
#[derive(Clone, Debug)]
pub struct Journal {
    disk: Arc<dyn Disk>,
    folder: PathBuf,
    key: String,
    gauge: String,
    machine: Machine,
    /// An account, besides this one and root, with believed journals.
    trusted: Option<u32>,
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
        Self { disk: Arc::new(disk::Host), folder, key, gauge, machine, trusted: None }
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
    pub fn trusting(self, account: Option<u32>) -> Self {
        Self { trusted: account, ..self }
    }

    /// The file of a write at this place, unless another host uses that name.
    pub fn path(&self) -> PathBuf {
        self.numbered(PENDING, 0)
    }

    /// Unsettled journals of this place and this host.
    pub fn unsettled(&self) -> Vec<PathBuf> {
        let paths = self.files(PENDING).unwrap_or_default();
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
        let entry = self.disk.read(path).ok().and_then(|text| parse(&text));
        entry.is_some_and(|entry| !self.is_ours(&entry))
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
        let mut paths = self.files(if waiting { WAITING } else { PENDING }).map_err(unlisted)?;
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
        for number in 0.. {
            let path = self.numbered(PENDING, number);
            if self.disk.exists(&path) {
                if self.is_of_other_host(&path) {
                    continue;
                }
                let what = "an interrupted write is not settled yet; see gaugefs settle".into();
                return Err(Error::of(path.display().to_string(), Reason::Owed { decision: false, what }));
            }
            match self.store(&path, true, identity, found, blocks, plan) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists && self.disk.exists(&path) => {}
                stored => return stored.map_err(|error| refused(&path, &error)),
            }
        }
        unreachable!("there are enough numbers")
    }

    /// Replaces an entry that owes only a seal.
    pub(crate) fn replace(&self, path: &Path, identity: &Identity, found: Seal) -> Result<OpenJournal> {
        self.store(path, false, identity, found, 0, None).map_err(|error| refused(path, &error))
    }

    fn store(
        &self,
        path: &Path,
        is_new: bool,
        identity: &Identity,
        found: Seal,
        blocks: usize,
        plan: Option<&Plan>,
    ) -> io::Result<OpenJournal> {
        let Identity { chip, device_type, firmware, serial } = identity;
        let text = format!(
            "{HEAD}\ngauge {}\npart {chip} {device_type:04x} {firmware:04x} {serial:04x}\nfound {}\n\
             {}\n{}",
            self.gauge,
            found.as_str(),
            self.machine,
            plan.map(render).unwrap_or_default()
        );
        // Nobody else writes to a file of that name.
        let mut random = [0; 4];
        getrandom::fill(&mut random).map_err(io::Error::other)?;
        let temporary = self.folder.join(format!("{}.{}.new", self.key, hex(&random)));
        // Marks, and a neighbour on either side of each block.
        let how = disk::How::Journal { is_new, room: LINE * (3 * blocks + 8) };
        let file = disk::store(&*self.disk, path, &temporary, &text, how)?;
        Ok(OpenJournal { disk: self.disk.clone(), file, path: path.into() })
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
        Ok(Some(OpenJournal { disk: self.disk.clone(), file, path: path.into() }))
    }

    fn seal_path(&self) -> PathBuf {
        self.numbered(SEAL, 0)
    }

    /// Records an owed seal. On return that is on disk.
    pub(crate) fn owe_seal(&self, identity: &Identity) -> Result<OpenJournal> {
        self.replace(&self.seal_path(), identity, Seal::Sealed)
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
        removed.map_err(|error| Error::io(path.display().to_string(), "cannot remove the journal", &error))
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
pub fn check(path: &Path, trusted: Option<u32>) -> Result<()> {
    is_own(path, trusted).map_err(|error| untrusted(path, &error))
}

/// Why somebody else can have written a file, or can replace the contents of a folder.
pub fn is_own(path: &Path, trusted: Option<u32>) -> io::Result<()> {
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

    /// Appends a plan. On return it is on disk.
    pub(crate) fn plan(&mut self, plan: &Plan) -> Result<()> {
        let text = render(plan);
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

    pub(crate) fn remove(self) -> Result<()> {
        let removed = self.disk.remove(&self.path);
        removed
            .and_then(|()| self.path.parent().map_or(Ok(()), |folder| self.disk.sync(folder)))
            .map_err(|error| Error::io(self.path.display().to_string(), "cannot remove the journal", &error))
    }
}

pub(crate) fn in_use(path: &Path) -> Error {
    let what = "another gaugefs works on this journal".into();
    Error::of(path.display().to_string(), Reason::InUse { process: None, mountpoint: None, what })
}

fn refused(path: &Path, error: &io::Error) -> Error {
    let what = "cannot write the journal, so nothing was written to the gauge (choose another folder with \
                --state-dir)";
    Error::io(path.display().to_string(), what, error)
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

/// `None` for anything but a journal, or for a complete plan with other content than was written.
fn parse(text: &str) -> Option<Entry> {
    let (head, rest) = text.split_once('\n')?;
    let (gauge, rest) = rest.split_once('\n')?;
    let (part, rest) = rest.split_once('\n')?;
    let (found, rest) = rest.split_once('\n')?;
    let (machine, plan) = match head {
        HEAD_2 => (None, rest),
        HEAD => {
            let (host, plan) = rest.split_once('\n')?;
            (Some(Machine::parse(host)?), plan)
        }
        _ => return None,
    };
    if !gauge.starts_with("gauge ") {
        return None;
    }
    let identity = parse_identity(part.strip_prefix("part ")?)?;
    let word = found.strip_prefix("found ")?;
    let found =
        [Seal::Sealed, Seal::Unsealed, Seal::FullAccess].into_iter().find(|seal| seal.as_str() == word)?;
    let nothing = Entry { identity, machine, found, plan: None };
    // Anything behind the last line, or a part of that, means that the reset may have been sent.
    let ended = plan.rsplit_once("\nend ").and_then(|(text, end)| Some((text, end.split_once('\n')?)));
    let Some((text, (end, rest))) = ended else { return is_begun(plan).then_some(nothing) };
    let text = format!("{text}\n");
    if end != sum(&text) {
        return (is_torn(&text) || is_torn(end)).then_some(nothing);
    }
    let mut plan = Plan { reset_sent: !rest.is_empty(), ..parse_plan(&text)? };
    if let Some(key) = &mut plan.key {
        plan.reset_sent = false;
        key.follow(rest);
    }
    Some(Entry { plan: Some(plan), ..nothing })
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
        let text = format!("{HEAD}\ngauge a\npart bq34z100-g1 0100 0202 0001\nfound sealed\nhost a b c\n")
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
