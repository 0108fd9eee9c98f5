//! The journal: records on disk what a write is about to do, before it does it.
//!
//! A host that loses power during a write leaves the gauge unsealed or data flash half written. The journal
//! holds the seal state and the blocks from before the write, and what distinguishes the pack, so that it can
//! be settled later. It never holds keys.
//!
//! The file is created before the gauge is touched; the plan is appended before the first block is written.
//! A power cut in between leaves a plan without its last line, which is ignored because nothing had been
//! written yet. There is one file for each place where a gauge can be connected, and it is never replaced
//! while it is there: no other write is begun at that place until it has been settled or dismissed.

use std::fmt::Debug;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use sha1::{Digest as _, Sha1};

use crate::chip::{Chip, FLAT};
use crate::codec::WINDOW;
use crate::dataflash::Bytes;
use crate::error::{Cause, Error, Result};
use crate::gauge::Seal;
use crate::text::{hex, unhex};

pub use disk::{Disk, File, Host, save, save_on};

mod disk;

const HEAD: &str = "gaugefs journal 2";
/// Follows a plan once its reset is about to be sent.
const RESET_SENT: &str = "reset sent\n";
/// Upper limit for the length of a block's line, and of the other lines together.
const LINE: usize = 160;

/// Where a gauge's journal is kept.
#[derive(Clone, Debug)]
pub struct Journal {
    disk: Arc<dyn Disk>,
    folder: PathBuf,
    /// Where the gauge is connected; name of the file.
    key: String,
    /// Name of the gauge in the file.
    gauge: String,
}

/// Part, firmware and, if the part reports one, serial number.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Identity {
    pub(crate) chip: String,
    pub(crate) device_type: u16,
    pub(crate) firmware: u16,
    /// 0 if the part has no register for it.
    pub(crate) serial: u16,
}

impl Identity {
    /// A gauge that is known to have its table's part.
    pub(crate) fn of(chip: &Chip, firmware: u16, serial: u16) -> Self {
        Self { chip: chip.name.into(), device_type: chip.identity.device_type, firmware, serial }
    }

    /// Whether it was noted of a part and firmware like those of a gauge with that table.
    pub(crate) fn is_of_part(&self, gauge: &Identity, chip: &Chip) -> bool {
        (&self.chip, self.device_type) == (&gauge.chip, gauge.device_type)
            && (self.firmware == gauge.firmware || chip.identity.is_device_number(self.firmware))
    }
}

/// A write, or a read of a sealed gauge, that was started.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Entry {
    pub(crate) identity: Identity,
    /// Seal state before.
    pub(crate) found: Seal,
    /// `None` if no block had been touched yet.
    pub(crate) plan: Option<Plan>,
}

/// What was about to be written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Plan {
    /// Whether the gauge needs a reset to work with the new values.
    pub(crate) reset: bool,
    /// The reset may have been sent, so that the gauge may work with the new values.
    pub(crate) reset_sent: bool,
    /// Values that distinguish packs, as far as they had been read.
    pub(crate) marks: Vec<Mark>,
    pub(crate) blocks: Vec<PlannedBlock>,
}

/// A parameter that distinguishes packs, and its bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Mark {
    pub(crate) subclass: u8,
    pub(crate) offset: u16,
    pub(crate) bytes: Vec<u8>,
}

/// A block before and after. A neighbour, which the write does not change, is the same before and after.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct PlannedBlock {
    pub(crate) subclass: u8,
    pub(crate) base: u16,
    /// What the changed parameters occupy.
    pub(crate) written: Bytes,
    pub(crate) old: [u8; WINDOW],
    pub(crate) new: [u8; WINDOW],
}

/// The journal of a write in progress.
#[derive(Debug)]
pub(crate) struct OpenJournal {
    disk: Arc<dyn Disk>,
    file: Box<dyn File>,
    path: PathBuf,
}

impl Journal {
    /// A journal in a folder. `key` identifies where the gauge is connected and must be unique; `gauge` names
    /// it in the file.
    pub fn new(folder: PathBuf, key: String, gauge: String) -> Self {
        Self { disk: Arc::new(disk::Host), folder, key, gauge }
    }

    /// The same journal on another disk.
    pub fn on(self, disk: Arc<dyn Disk>) -> Self {
        Self { disk, ..self }
    }

    /// The file of this place.
    pub fn path(&self) -> PathBuf {
        self.folder.join(format!("{}.journal", self.key))
    }

    /// Starts an entry and reserves space for a plan of `blocks` blocks. On return the entry is on disk. An entry
    /// that is there already is not replaced.
    pub(crate) fn begin(&self, identity: &Identity, found: Seal, blocks: usize) -> Result<OpenJournal> {
        let path = self.path();
        if self.disk.exists(&path) {
            let why = "an interrupted write is not settled yet; see gaugefs settle";
            return Err(Error::new(path.display().to_string(), Cause::Busy(why.into())));
        }
        self.replace(identity, found, blocks)
    }

    /// Starts an entry in place of one of which only the seal state is still owed.
    pub(crate) fn replace(&self, identity: &Identity, found: Seal, blocks: usize) -> Result<OpenJournal> {
        let path = self.path();
        let Identity { chip, device_type, firmware, serial } = identity;
        let text = format!(
            "{HEAD}\ngauge {}\npart {chip} {device_type:04x} {firmware:04x} {serial:04x}\nfound {}\n",
            self.gauge,
            found.as_str()
        );
        // Marks, and a neighbour on either side of each block.
        match disk::store(&*self.disk, &path, &path.with_extension("new"), &text, LINE * (3 * blocks + 8)) {
            Ok(file) => Ok(OpenJournal { disk: self.disk.clone(), file, path }),
            Err(error) => Err(refused(&path, &error)),
        }
    }

    /// The entry of an interrupted write, if there is one.
    pub(crate) fn pending(&self) -> Result<Option<Entry>> {
        let path = self.path();
        let name = path.display().to_string();
        let text = match self.disk.read(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            read => read.map_err(|error| Error::io(&name, "cannot read the journal", &error))?,
        };
        let why = "not a journal of this version of gaugefs; inspect it and move it away";
        parse(&text).map(Some).ok_or_else(|| Error::new(name, Cause::BadChecksum(why.into())))
    }

    /// Whether there is an entry.
    pub(crate) fn exists(&self) -> bool {
        self.disk.exists(&self.path())
    }

    /// Opens the entry of an interrupted write again.
    pub(crate) fn reopen(&self) -> Result<OpenJournal> {
        let path = self.path();
        match self.disk.open(&path) {
            Ok(file) => Ok(OpenJournal { disk: self.disk.clone(), file, path }),
            Err(error) => Err(refused(&path, &error)),
        }
    }

    /// Takes the entry out of the way and keeps it under another name, which is returned.
    pub(crate) fn dismiss(&self) -> Result<PathBuf> {
        let (path, aside) = (self.path(), self.folder.join(format!("{}.dismissed", self.key)));
        let moved = self.disk.rename(&path, &aside).and_then(|()| self.disk.sync(&self.folder));
        moved.map_err(|error| Error::io(path.display().to_string(), "cannot move the journal", &error))?;
        Ok(aside)
    }
}

impl OpenJournal {
    /// Appends what is about to be written. On return it is on disk.
    pub(crate) fn plan(&mut self, plan: &Plan) -> Result<()> {
        let text = render(plan);
        let stored = self.file.append(text.as_bytes()).and_then(|()| self.file.sync());
        stored.map_err(|error| refused(&self.path, &error))
    }

    /// Notes that the reset is about to be sent. On return that is on disk.
    pub(crate) fn reset_sent(&mut self) -> Result<()> {
        let stored = self.file.append(RESET_SENT.as_bytes()).and_then(|()| self.file.sync());
        stored.map_err(|error| refused(&self.path, &error))
    }

    /// Removes the entry once its write is complete or settled.
    pub(crate) fn remove(self) -> Result<()> {
        let removed = self.disk.remove(&self.path);
        removed
            .and_then(|()| self.path.parent().map_or(Ok(()), |folder| self.disk.sync(folder)))
            .map_err(|error| Error::io(self.path.display().to_string(), "cannot remove the journal", &error))
    }
}

fn refused(path: &Path, error: &io::Error) -> Error {
    let what = "cannot write the journal, so nothing was written to the gauge (choose another folder with \
                --state-dir)";
    Error::io(path.display().to_string(), what, error)
}

fn render(plan: &Plan) -> String {
    let Plan { reset, reset_sent: _, marks, blocks } = plan;
    let mut text = format!("reset {reset}\n");
    for Mark { subclass, offset, bytes } in marks {
        text += &format!("mark {subclass} {offset} {}\n", hex(bytes));
    }
    for PlannedBlock { subclass, base, written, old, new } in blocks {
        text += &format!("block {subclass} {base} {:08x} {} {}\n", written.0, hex(old), hex(new));
    }
    let sum = sum(&text);
    text + &format!("end {sum}\n")
}

/// Distinguishes a complete plan from one of which only some pages reached the disk.
fn sum(text: &str) -> String {
    hex(&Sha1::digest(text))
}

fn parse(text: &str) -> Option<Entry> {
    let (head, rest) = text.split_once('\n')?;
    let (gauge, rest) = rest.split_once('\n')?;
    let (part, rest) = rest.split_once('\n')?;
    let (found, plan) = rest.split_once('\n')?;
    if head != HEAD || !gauge.starts_with("gauge ") {
        return None;
    }
    let identity = parse_identity(part.strip_prefix("part ")?)?;
    let word = found.strip_prefix("found ")?;
    let found =
        [Seal::Sealed, Seal::Unsealed, Seal::FullAccess].into_iter().find(|seal| seal.as_str() == word)?;
    let nothing = Entry { identity, found, plan: None };
    let (plan, reset_sent) = match plan.strip_suffix(RESET_SENT) {
        Some(plan) => (plan, true),
        None => (plan, false),
    };
    // A page of the last line that did not reach the disk leaves the plan complete.
    let Some((plan, rest)) = plan.rsplit_once("\nend ") else { return Some(nothing) };
    let plan = format!("{plan}\n");
    let (end, rest) = rest.split_once('\n').unwrap_or((rest, "-"));
    if end != sum(&plan) || rest == "-" {
        return Some(nothing);
    }
    let plan = Plan { reset_sent: reset_sent || !rest.is_empty(), ..parse_plan(&plan)? };
    Some(Entry { plan: Some(plan), ..nothing })
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
    let (mut marks, mut blocks) = (Vec::new(), Vec::new());
    for line in lines {
        match line.strip_prefix("mark ") {
            Some(mark) => marks.push(parse_mark(mark)?),
            None => blocks.push(parse_block(line.strip_prefix("block ")?)?),
        }
    }
    Some(Plan { reset, reset_sent: false, marks, blocks })
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
    // A block that no gauge has would be an address beyond what can be selected.
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
        let plan = Plan { reset: true, reset_sent: false, marks, blocks: vec![block.clone(), block] };
        let identity =
            Identity { chip: "bq34z100-g1".into(), device_type: 0x100, firmware: 0x202, serial: 1 };
        let head =
            format!("{HEAD}\ngauge i2c-1 address 0x55\npart bq34z100-g1 0100 0202 0001\nfound sealed\n");
        let text = head.clone() + &render(&plan);
        assert!(text.len() < LINE * 8, "room for two blocks: {}", text.len());
        let nothing = Entry { identity, found: Seal::Sealed, plan: None };
        let entry = Entry { plan: Some(plan.clone()), ..nothing.clone() };
        assert_eq!(parse(&text), Some(entry));
        for length in 0..text.len() {
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
