// SPDX-License-Identifier: MIT

//! The checked system: a root folder, and doctor's user.

use std::fs::{self, Metadata};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use gauge_bus::regular;
use nix::unistd::{AccessFlags, access, geteuid};

/// Largest list of a kernel's modules, in bytes.
const MODULES: u64 = 16 << 20;

pub(super) struct Host {
    root: PathBuf,
    pub(super) uid: u32,
    /// All groups of this process, which may lag behind /etc/group.
    pub(super) groups: Vec<u32>,
}

impl Host {
    pub(super) fn new(root: PathBuf) -> Self {
        let status = regular::read_text(&root.join("proc/self/status"), regular::SYSTEM).unwrap_or_default();
        let numbers = |name: &str| -> Vec<u32> {
            let line = status.lines().find_map(|line| line.strip_prefix(name));
            line.unwrap_or_default().split_ascii_whitespace().filter_map(|word| word.parse().ok()).collect()
        };
        // Columns: real, effective, saved and file-system ID.
        let uid = numbers("Uid:").get(1).copied().unwrap_or_else(|| geteuid().as_raw());
        let groups = numbers("Gid:").get(1).copied().into_iter().chain(numbers("Groups:")).collect();
        Self { root, uid, groups }
    }

    pub(super) fn root(&self) -> &Path {
        &self.root
    }

    pub(super) fn is_root(&self) -> bool {
        self.uid == 0
    }

    pub(super) fn at(&self, path: &str) -> PathBuf {
        self.root.join(path.trim_start_matches('/'))
    }

    pub(super) fn has(&self, path: &str) -> bool {
        self.at(path).exists()
    }

    pub(super) fn text(&self, path: &str) -> String {
        regular::read_text(&self.at(path), regular::SYSTEM).unwrap_or_default()
    }

    /// Whether the running kernel has a module of that name, loaded or not; `None` if its modules are not listed here.
    pub(super) fn has_module(&self, name: &str) -> Option<bool> {
        let release = self.text("/proc/sys/kernel/osrelease");
        let lists = ["modules.dep", "modules.builtin"].map(|list| {
            let path = self.at(&format!("/lib/modules/{}/{list}", release.trim()));
            regular::read_text(&path, MODULES).ok()
        });
        let file = format!("/{name}.ko");
        let [dependencies, built_in] = lists;
        let is_in = |list: &String| {
            list.lines().any(|line| line.split(':').next().is_some_and(|at| at.contains(&file)))
        };
        Some(is_in(&dependencies?) || built_in.as_ref().is_some_and(is_in))
    }

    /// The names in a folder, sorted.
    pub(super) fn names(&self, folder: &str) -> Vec<String> {
        let entries = fs::read_dir(self.at(folder)).into_iter().flatten().flatten();
        let mut names: Vec<_> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
        names.sort();
        names
    }

    /// Whether the user may read and write a file.
    pub(super) fn may_use(&self, path: &str, status: &Metadata) -> bool {
        let shift = match status {
            _ if self.is_root() => return true,
            _ if status.uid() == self.uid => 6,
            _ if self.groups.contains(&status.gid()) => 3,
            _ => 0,
        };
        let both = AccessFlags::R_OK | AccessFlags::W_OK;
        // An access control list, such as systemd-logind's, does not show in the mode.
        let listed = || self.uid == geteuid().as_raw() && access(&self.at(path), both).is_ok();
        status.mode() >> shift & 0o6 == 0o6 || listed()
    }

    pub(super) fn user(&self) -> String {
        self.account(0).unwrap_or_else(|| "$USER".into())
    }

    pub(super) fn home(&self) -> String {
        self.account(5).unwrap_or_default()
    }

    /// A field of the user's line in /etc/passwd.
    fn account(&self, field: usize) -> Option<String> {
        let users = self.text("/etc/passwd");
        let mut lines = users.lines().map(|line| line.split(':').collect::<Vec<_>>());
        let mine = lines.find(|fields| fields.get(2).and_then(|uid| uid.parse().ok()) == Some(self.uid))?;
        Some((*mine.get(field)?).to_string())
    }

    /// A group's name, and whether /etc/group lists the user.
    pub(super) fn group(&self, gid: u32) -> Option<(String, bool)> {
        let (groups, user) = (self.text("/etc/group"), self.user());
        groups.lines().find_map(|line| {
            let fields: Vec<_> = line.split(':').collect();
            let [name, _, number, members] = fields[..] else { return None };
            let found = number.parse() == Ok(gid);
            found.then(|| (name.to_string(), members.split(',').any(|member| member == user)))
        })
    }
}
