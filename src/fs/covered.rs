// SPDX-License-Identifier: MIT

//! The folder that the mount covers. The kernel's own folder of power supplies is shown in the tree too, as symbolic
//! links: the mount has the same path, so their relative targets stay valid.
//!
//! Nothing is cached: additions and removals show at the next look.

use std::collections::BTreeSet;
use std::os::fd::OwnedFd;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use nix::dir::{Dir, Type};
use nix::fcntl::{OFlag, open, readlinkat};
use nix::sys::stat::Mode;

use super::{Node, Operations, Shape};
use crate::error::{Error, Result};

/// A folder, accessible below mounts over it.
#[derive(Debug)]
pub struct Covered {
    folder: OwnedFd,
    /// Every name found so far. Its index identifies it for the life of the mount.
    names: Mutex<Vec<String>>,
    /// Names hidden by the mount's own in the last listing of the root.
    hidden: Mutex<BTreeSet<String>>,
}

impl Covered {
    /// Opens the folder before anything is mounted over it.
    pub fn open(path: &Path) -> Result<Self> {
        let flags = OFlag::O_PATH | OFlag::O_DIRECTORY | OFlag::O_CLOEXEC;
        let folder = open(path, flags, Mode::empty()).map_err(|errno| {
            Error::host(
                path.display().to_string(),
                errno,
                "cannot open the folder that the mount would cover",
            )
        })?;
        Ok(Self { folder, names: Mutex::default(), hidden: Mutex::default() })
    }

    /// Names of the present links.
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
            log::warn!("cannot list the kernel's power supplies: {}", errno.desc());
            Vec::new()
        })
    }

    /// The present target of a link.
    pub fn target(&self, name: &str) -> Option<String> {
        readlinkat(&self.folder, name).ok()?.into_string().ok()
    }

    /// The number of a name.
    pub(super) fn number(&self, name: &str) -> u32 {
        let mut names = self.names.lock().unwrap_or_else(PoisonError::into_inner);
        let at = names.iter().position(|known| known == name).unwrap_or_else(|| {
            names.push(name.to_string());
            names.len() - 1
        });
        at as u32
    }

    /// The name of a number.
    fn name(&self, number: u32) -> Option<String> {
        self.names.lock().unwrap_or_else(PoisonError::into_inner).get(number as usize).cloned()
    }

    /// Logs each name that was hidden since the last call.
    pub(super) fn log_hidden(&self, now: BTreeSet<String>) {
        let mut hidden = self.hidden.lock().unwrap_or_else(PoisonError::into_inner);
        for name in now.difference(&hidden) {
            log::warn!("{name}: hides the kernel's supply of that name; choose another with --name or --ac");
        }
        *hidden = now;
    }
}

pub(super) struct CoveredLink<'a> {
    pub(super) covered: Option<&'a Covered>,
    pub(super) number: u32,
}

impl Operations for CoveredLink<'_> {
    fn parent(&self) -> Node {
        Node::Root
    }

    fn shape(&self) -> Shape {
        Shape::Link
    }

    fn may_be_cached(&self) -> bool {
        false
    }

    fn target(&self) -> Option<String> {
        let covered = self.covered?;
        covered.target(&covered.name(self.number)?)
    }
}
