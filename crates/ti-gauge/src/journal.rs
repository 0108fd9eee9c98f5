//! The journal: records on disk what a write is about to do, before it does it.
//!
//! A host that loses power during a write leaves the gauge unsealed or data flash half written. The journal
//! holds the seal state and the blocks from before the write, so that the next start can settle it. It never
//! holds keys.
//!
//! The file is created before the gauge is touched; the plan is appended before the first block is written.
//! A power cut in between leaves a plan without its last line, which is ignored because nothing had been
//! written yet.

use std::borrow::Cow;
use std::fs::{self, DirBuilder, File};
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, fchown};
use std::path::{Path, PathBuf};

use rustix::fs::{FallocateFlags, OFlags, fallocate};
use rustix::process::geteuid;
use sha1::{Digest as _, Sha1};

use crate::codec::WINDOW;
use crate::error::{Cause, Error, Result};
use crate::gauge::Seal;
use crate::text::{hex, unhex};

const HEAD: &str = "gaugefs journal 1";
/// Upper limit for the length of a block's line, and of the other lines together.
const LINE: usize = 160;

/// Where a gauge's journal is kept.
#[derive(Clone, Debug)]
pub struct Journal {
    folder: PathBuf,
    /// Where the gauge is connected; prefix of the file name.
    key: String,
    /// Name of the gauge in the file.
    gauge: String,
}

/// Part, firmware and, if the part reports one, serial number. Journals with another identity belong to
/// other gauges.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Identity {
    pub(crate) chip: &'static str,
    pub(crate) device_type: u16,
    pub(crate) firmware: u16,
    /// 0 if the part has no register for it.
    pub(crate) serial: u16,
}

/// A write that was started.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Entry {
    /// Seal state before the write.
    pub(crate) found: Seal,
    /// `None` if no block had been touched yet.
    pub(crate) plan: Option<Plan>,
}

/// What was about to be written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Plan {
    /// Whether the gauge needs a reset to work with the new values.
    pub(crate) reset: bool,
    /// The new serial number, if the write changes it.
    pub(crate) serial: Option<u16>,
    pub(crate) blocks: Vec<PlannedBlock>,
}

/// A block before and after.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct PlannedBlock {
    pub(crate) subclass: u8,
    pub(crate) base: u16,
    /// Range that the changed parameters occupy: start and end.
    pub(crate) written: (usize, usize),
    pub(crate) old: [u8; WINDOW],
    pub(crate) new: [u8; WINDOW],
}

/// The journal of a write in progress.
#[derive(Debug)]
pub(crate) struct OpenJournal {
    file: File,
    path: PathBuf,
}

impl Journal {
    /// A journal in a folder. `key` identifies where the gauge is connected and must be unique; `gauge` names
    /// it in the file.
    pub fn new(folder: PathBuf, key: String, gauge: String) -> Self {
        Self { folder, key, gauge }
    }

    fn path(&self, identity: Identity) -> PathBuf {
        self.folder.join(format!("{}{:04x}.journal", self.alike(identity), identity.serial))
    }

    /// Prefix of the journals of all gauges of this part and firmware connected here.
    fn alike(&self, Identity { chip, device_type, firmware, .. }: Identity) -> String {
        format!("{}.{chip}-{device_type:04x}-{firmware:04x}-", self.key)
    }

    /// Starts an entry, replacing the previous one, and reserves space for a plan of `blocks` blocks. On
    /// return the entry is on disk.
    pub(crate) fn begin(&self, identity: Identity, found: Seal, blocks: usize) -> Result<OpenJournal> {
        let path = self.path(identity);
        let text = format!("{HEAD}\ngauge {}\nfound {}\n", self.gauge, found.as_str());
        match self.store(&path, &text, LINE * (blocks + 2)) {
            Ok(file) => Ok(OpenJournal { file, path }),
            Err(error) => Err(refused(&path, &error)),
        }
    }

    fn store(&self, path: &Path, text: &str, room: usize) -> io::Result<File> {
        DirBuilder::new().recursive(true).mode(0o700).create(&self.folder)?;
        let temporary = path.with_extension("new");
        let mut options = File::options();
        options
            .write(true)
            .create(true)
            .truncate(true)
            .mode(0o600)
            .custom_flags(OFlags::NOFOLLOW.bits() as i32);
        let mut file = options.open(&temporary)?;
        // If the folder belongs to a service, that service must be able to settle what root leaves there.
        let owner = fs::metadata(&self.folder)?;
        let owned =
            if geteuid().is_root() { fchown(&file, Some(owner.uid()), Some(owner.gid())) } else { Ok(()) };
        let stored = owned.and_then(|()| file.write_all(text.as_bytes())).and_then(|()| {
            // File systems that cannot reserve space report a full disk later, still before the first block.
            match fallocate(&file, FallocateFlags::KEEP_SIZE, 0, (text.len() + room) as u64) {
                Err(error) if io::Error::from(error).kind() != ErrorKind::Unsupported => Err(error.into()),
                _ => Ok(()),
            }
        });
        let stored = stored.and_then(|()| file.sync_all()).and_then(|()| fs::rename(&temporary, path));
        if let Err(error) = stored {
            // The rest would only take up space on a disk that may be full.
            let _ = fs::remove_file(&temporary);
            return Err(error);
        }
        sync(&self.folder)?;
        Ok(file)
    }

    /// The entry of an interrupted write, if there is one, and the path of its file.
    pub(crate) fn pending(&self, identity: Identity) -> Result<Option<(PathBuf, Entry)>> {
        let own = self.path(identity);
        if let Some(entry) = read(&own)? {
            return Ok(Some((own, entry)));
        }
        // An interrupted write of the serial number may have changed the identity.
        let alike = self.alike(identity);
        Ok(self.others(identity).into_iter().filter(|path| name(path).starts_with(&alike)).find_map(|path| {
            let entry = read(&path).ok()??;
            let serial = entry.plan.as_ref()?.serial?;
            (serial == identity.serial).then_some((path, entry))
        }))
    }

    /// Journals of other gauges that were connected here before.
    pub(crate) fn others(&self, identity: Identity) -> Vec<PathBuf> {
        let (own, begins) = (self.path(identity), format!("{}.", self.key));
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten().map(|entry| entry.path());
        let others = entries.filter(|path| {
            let name = name(path);
            *path != own && name.starts_with(&begins) && name.ends_with(".journal")
        });
        others.collect()
    }
}

impl OpenJournal {
    /// Opens the entry of an interrupted write again.
    pub(crate) fn reopen(path: PathBuf) -> Result<Self> {
        match File::options().append(true).custom_flags(OFlags::NOFOLLOW.bits() as i32).open(&path) {
            Ok(file) => Ok(Self { file, path }),
            Err(error) => Err(refused(&path, &error)),
        }
    }

    /// Appends what is about to be written. On return it is on disk.
    pub(crate) fn plan(&mut self, plan: &Plan) -> Result<()> {
        let text = render(plan);
        let stored = self.file.write_all(text.as_bytes()).and_then(|()| self.file.sync_all());
        stored.map_err(|error| refused(&self.path, &error))
    }

    /// Removes the entry once its write is complete or settled.
    pub(crate) fn remove(self) -> Result<()> {
        let removed = fs::remove_file(&self.path);
        removed
            .and_then(|()| self.path.parent().map_or(Ok(()), sync))
            .map_err(|error| Error::io(self.path.display().to_string(), "cannot remove the journal", &error))
    }
}

fn name(path: &Path) -> Cow<'_, str> {
    path.file_name().unwrap_or_default().to_string_lossy()
}

fn sync(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}

fn refused(path: &Path, error: &io::Error) -> Error {
    let what = "cannot write the journal, so nothing was written to the gauge (choose another folder with \
                --state-dir)";
    Error::io(path.display().to_string(), what, error)
}

fn read(path: &Path) -> Result<Option<Entry>> {
    let name = path.display().to_string();
    let text = match fs::read_to_string(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        read => read.map_err(|error| Error::io(&name, "cannot read the journal", &error))?,
    };
    let why = "not a journal of this version of gaugefs; inspect it and move it away";
    parse(&text).map(Some).ok_or_else(|| Error::new(name, Cause::BadChecksum(why.into())))
}

fn render(plan: &Plan) -> String {
    let Plan { reset, serial, blocks } = plan;
    let mut text = format!("reset {reset}\n");
    if let Some(serial) = serial {
        text += &format!("serial {serial:04x}\n");
    }
    for PlannedBlock { subclass, base, written: (from, to), old, new } in blocks {
        text += &format!("block {subclass} {base} {from} {to} {} {}\n", hex(old), hex(new));
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
    let (found, plan) = rest.split_once('\n')?;
    if head != HEAD || !gauge.starts_with("gauge ") {
        return None;
    }
    let word = found.strip_prefix("found ")?;
    let found =
        [Seal::Sealed, Seal::Unsealed, Seal::FullAccess].into_iter().find(|seal| seal.as_str() == word)?;
    let Some((plan, end)) = plan.strip_suffix('\n').and_then(|plan| plan.rsplit_once("\nend ")) else {
        return Some(Entry { found, plan: None });
    };
    let plan = format!("{plan}\n");
    if end != sum(&plan) {
        return Some(Entry { found, plan: None });
    }
    Some(Entry { found, plan: Some(parse_plan(&plan)?) })
}

fn parse_plan(text: &str) -> Option<Plan> {
    let mut lines = text.lines().peekable();
    let reset = lines.next()?.strip_prefix("reset ")?.parse().ok()?;
    let serial = match lines.peek()?.strip_prefix("serial ") {
        Some(digits) => {
            lines.next();
            Some(u16::from_str_radix(digits, 16).ok()?)
        }
        None => None,
    };
    let blocks = lines.map(|line| parse_block(line.strip_prefix("block ")?)).collect::<Option<_>>()?;
    Some(Plan { reset, serial, blocks })
}

fn parse_block(line: &str) -> Option<PlannedBlock> {
    let mut words = line.split(' ');
    let subclass = words.next()?.parse().ok()?;
    let base = words.next()?.parse().ok()?;
    let written: (usize, usize) = (words.next()?.parse().ok()?, words.next()?.parse().ok()?);
    let (old, new) = (parse_bytes(words.next()?)?, parse_bytes(words.next()?)?);
    let fits = written.0 < written.1 && written.1 <= WINDOW && words.next().is_none();
    fits.then_some(PlannedBlock { subclass, base, written, old, new })
}

fn parse_bytes(digits: &str) -> Option<[u8; WINDOW]> {
    unhex(digits.as_bytes())?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_complete_plan_counts() {
        let block = PlannedBlock { subclass: 80, base: 32, written: (21, 23), old: [0xa5; 32], new: [7; 32] };
        let plan = Plan { reset: true, serial: Some(7), blocks: vec![block.clone(), block] };
        let head = format!("{HEAD}\ngauge i2c-1 address 0x55\nfound sealed\n");
        let text = head.clone() + &render(&plan);
        assert!(text.len() < LINE * 4, "room for two blocks: {}", text.len());
        assert_eq!(parse(&text), Some(Entry { found: Seal::Sealed, plan: Some(plan) }));
        for length in 0..text.len() {
            let nothing = (length >= head.len()).then_some(Entry { found: Seal::Sealed, plan: None });
            assert_eq!(parse(&text[..length]), nothing, "{length} bytes of it");
            // A page that never reached the disk reads as zeros.
            let holed = text[..length].to_string() + &"\0".repeat(text.len() - length);
            assert_eq!(parse(&holed), nothing, "zeros behind {length} bytes");
        }
    }
}
