//! The folder that a mount covers. Where that is the kernel's own of power supplies, they are shown through
//! as the links they are: the mount sits at the same path, so their relative targets lead where they did.
//!
//! Nothing of it is kept. What the kernel adds or removes meanwhile shows at the next look.

use std::collections::BTreeSet;
use std::os::fd::OwnedFd;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use nix::dir::{Dir, Type};
use nix::fcntl::{OFlag, open, readlinkat};
use nix::sys::stat::Mode;

use crate::error::{Error, Result};

/// A folder, reached past whatever is mounted over it.
#[derive(Debug)]
pub struct Covered {
    folder: OwnedFd,
    /// Every name that was found; its place here stands for it for ever.
    names: Mutex<Vec<String>>,
    /// Names that something of the mount's own hides, as far as that has been told.
    hidden: Mutex<BTreeSet<String>>,
}

impl Covered {
    /// Opens the folder, before something is mounted over it.
    pub fn open(path: &Path) -> Result<Self> {
        let flags = OFlag::O_PATH | OFlag::O_DIRECTORY | OFlag::O_CLOEXEC;
        let folder = open(path, flags, Mode::empty()).map_err(|errno| {
            Error::host(path.display().to_string(), errno, "cannot open what the mount would cover")
        })?;
        Ok(Self { folder, names: Mutex::default(), hidden: Mutex::default() })
    }

    /// The links that are there now.
    pub fn names(&self) -> Vec<String> {
        let flags = OFlag::O_RDONLY | OFlag::O_DIRECTORY | OFlag::O_CLOEXEC;
        let listed = Dir::openat(&self.folder, ".", flags, Mode::empty()).and_then(|mut folder| {
            let links = folder.iter().filter_map(|entry| match entry {
                Ok(entry) if entry.file_type() != Some(Type::Symlink) => None,
                Ok(entry) => entry.file_name().to_str().ok().map(|name| Ok(name.to_string())),
                Err(errno) => Some(Err(errno)),
            });
            links.collect::<nix::Result<Vec<_>>>()
        });
        listed.unwrap_or_else(|errno| {
            log::warn!("the kernel's supplies cannot be listed: {}", errno.desc());
            Vec::new()
        })
    }

    /// Where a link leads now.
    pub fn target(&self, name: &str) -> Option<String> {
        readlinkat(&self.folder, name).ok()?.into_string().ok()
    }

    /// The number that stands for a name.
    pub(super) fn number(&self, name: &str) -> u32 {
        let mut names = self.names.lock().unwrap_or_else(PoisonError::into_inner);
        let at = names.iter().position(|known| known == name).unwrap_or_else(|| {
            names.push(name.to_string());
            names.len() - 1
        });
        at as u32
    }

    /// The name that a number stands for.
    pub(super) fn name(&self, number: u32) -> Option<String> {
        self.names.lock().unwrap_or_else(PoisonError::into_inner).get(number as usize).cloned()
    }

    /// Says once of each that it is hidden, and again when it was not in between.
    pub(super) fn hides(&self, now: BTreeSet<String>) {
        let mut hidden = self.hidden.lock().unwrap_or_else(PoisonError::into_inner);
        for name in now.difference(&hidden) {
            log::warn!(
                "{name}: hides the kernel's supply of that name; give this one another by --name or --ac"
            );
        }
        *hidden = now;
    }
}
