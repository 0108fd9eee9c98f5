// SPDX-License-Identifier: MIT

//! Opens files, and makes the calls that take an open one.

use std::fs;
use std::sync::Arc;
use std::time::Instant;

use nix::errno::Errno;
use rustix::fs::{Mode, OFlags, SeekFrom};

use super::files::{Class, Expected, OpenFile};
use super::users::Role;
use super::{Model, of_io};
use crate::room::mapped;

/// Most files that are open at a time.
const OPEN: usize = 12;

/// Open descriptions of one file at a time, now and then.
const MANY: usize = 200;

impl Model {
    pub(super) fn open_one(&mut self, user: usize, name: &str, class: Class) {
        if class == Class::Outside {
            return;
        }
        let mut flags = self.random.pick(&[OFlags::RDONLY, OFlags::RDONLY, OFlags::WRONLY, OFlags::RDWR]);
        for (flag, chance) in [
            (OFlags::TRUNC, 3),
            (OFlags::APPEND, 4),
            (OFlags::CREATE, 6),
            (OFlags::NONBLOCK, 6),
            (OFlags::DIRECTORY, 12),
            (OFlags::NOFOLLOW, 8),
            (OFlags::NOATIME, 12),
            (OFlags::DIRECT, 12),
            (OFlags::SYNC, 12),
        ] {
            if self.random.one_in(chance) {
                flags |= flag;
            }
        }
        if flags.contains(OFlags::CREATE) {
            flags.remove(OFlags::DIRECTORY);
            if self.random.one_in(3) {
                flags |= OFlags::EXCL;
            }
        }
        self.opens(user, name, class, flags);
    }

    pub(super) fn opens(&mut self, user: usize, name: &str, class: Class, flags: OFlags) -> Option<usize> {
        let path = self.path(name);
        let who = &self.users[user];
        let role = who.role;
        let creates = if role == Role::Stranger { Errno::EACCES } else { Errno::EPERM };
        let writes = flags.intersects(OFlags::WRONLY | OFlags::RDWR | OFlags::TRUNC);
        let reads = !flags.contains(OFlags::WRONLY);
        let target = class.followed();
        let is_folder = target == Class::Folder;
        let mut expected = self.there(target);
        if flags.contains(OFlags::CREATE) && !expected.may.is_empty() {
            expected.may = vec![creates, Errno::ENOENT];
        }
        if let Some(mode) = target.mode() {
            let wanted = if reads { 4 } else { 0 } | if writes { 2 } else { 0 };
            let is_owner = matches!(role, Role::Root | Role::Owner);
            expected = expected
                .or_if(!is_folder && who.may(mode) & wanted != wanted, Errno::EACCES)
                // Truncation needs a file that somebody may write, even of root.
                .or_if(!is_folder && flags.contains(OFlags::TRUNC) && mode & 0o222 == 0, Errno::EACCES)
                .or_if(is_folder && (writes || flags.contains(OFlags::CREATE)), Errno::EISDIR)
                .or_if(is_folder && writes && who.may(mode) & 2 == 0, Errno::EACCES)
                .or_if(flags.contains(OFlags::EXCL), Errno::EEXIST)
                .or_if(!is_folder && flags.contains(OFlags::DIRECTORY), Errno::ENOTDIR)
                .or_if(class == Class::Link && flags.contains(OFlags::NOFOLLOW), Errno::ELOOP)
                // A folder has no uncached input and output.
                .or_if(is_folder && flags.contains(OFlags::DIRECT), Errno::EINVAL)
                .or_if(flags.contains(OFlags::NOATIME) && !is_owner, Errno::EPERM);
        }
        let fd = self.users[user].does(move || rustix::fs::open(path, flags, Mode::RUSR));
        let what = format!("{role:?} {name} {flags:?}");
        let fd = self.check("open", &what, fd.map_err(of_io), expected)?;
        if self.open.len() >= OPEN {
            let at = self.random.below(OPEN as u64) as usize;
            self.open.swap_remove(at);
        }
        self.open.push(OpenFile {
            fd: Arc::new(fd),
            class: target,
            flags,
            disturbed: self.disturbed,
            opened: Instant::now(),
            written: None,
        });
        Some(self.open.len() - 1)
    }

    /// One of the open files, most often the last one.
    pub(super) fn held(&mut self) -> Option<usize> {
        let count = self.open.len() as u64;
        match count {
            0 => None,
            _ if self.random.one_in(2) => Some(count as usize - 1),
            _ => Some(self.random.below(count) as usize),
        }
    }

    /// One file open many times, each read, in one order and closed in another.
    pub(super) fn opens_many(&mut self, user: usize, name: &str, class: Class) {
        if matches!(class, Class::Folder | Class::Outside | Class::Transaction) {
            return;
        }
        let kept = std::mem::take(&mut self.open);
        let count = MANY.min(20 + self.random.below(200) as usize);
        let mut open = Vec::new();
        for _ in 0..count {
            match self.opens(user, name, class, OFlags::RDONLY) {
                Some(_) => open.push(self.open.pop().expect("it was opened")),
                None => break,
            }
        }
        while !open.is_empty() {
            let at = self.random.below(open.len() as u64) as usize;
            self.open.push(open.swap_remove(at));
            if self.random.one_in(4) {
                self.reads(user, 0, 0, 4096, false);
            }
            self.open.clear();
        }
        self.open = kept;
    }

    /// What a call may answer that asks for the size of an open file, which fails as a read would.
    fn sized(&self, class: Class, disturbed: bool) -> Expected {
        let expected = Expected::success().perhaps(&self.failures());
        match class {
            Class::Secret | Class::SecretRaw => expected.perhaps(&[Errno::EPERM]),
            Class::Measured if disturbed => expected.perhaps(&[Errno::ENODEV]),
            Class::Fleeting => expected.perhaps(&[Errno::ENODEV]),
            _ => expected,
        }
    }

    /// Calls that take an open file.
    pub(super) fn on_open_file(&mut self, user: usize) {
        let Some(at) = self.held() else { return };
        let OpenFile { class, flags, disturbed, .. } = self.open[at];
        let (fd, may_rest) = (self.open[at].fd.clone(), self.open[at].may_rest());
        let who = &self.users[user];
        let what = format!("{:?} {class:?} {flags:?}", who.role);
        let is_folder = class == Class::Folder;
        let can_write = flags.intersects(OFlags::WRONLY | OFlags::RDWR);
        match self.random.below(7) {
            0 => {
                let expected = Expected::success()
                    .or_if(!can_write, Errno::EINVAL)
                    .or_if(class.mode().is_some_and(|mode| mode & 0o222 == 0), Errno::EACCES);
                let answer = who.does(move || rustix::fs::ftruncate(&fd, 7)).map_err(of_io);
                self.check("ftruncate", &what, answer, expected);
            }
            1 => {
                let answer = who.does(move || rustix::fs::fstat(&fd)).map_err(of_io);
                self.check("fstat", &what, answer, self.sized(class, disturbed));
            }
            2 => {
                let wanted = [
                    SeekFrom::End(0),
                    SeekFrom::Current(-5),
                    SeekFrom::Start(0),
                    SeekFrom::Data(0),
                    SeekFrom::Hole(0),
                    SeekFrom::Data(1 << 20),
                ];
                let wanted = self.random.pick(&wanted);
                let expected = self.sized(class, disturbed).perhaps(&[Errno::EINVAL]);
                // Of a file that is empty, or ends before.
                let expected = match wanted {
                    SeekFrom::Data(_) | SeekFrom::Hole(_) => expected.perhaps(&[Errno::ENXIO]),
                    _ => expected,
                };
                let answer = self.users[user].does(move || rustix::fs::seek(&fd, wanted)).map_err(of_io);
                self.check("lseek", &what, answer, expected);
            }
            3 => {
                // The kernel refuses what nobody may write before gaugefs gets it.
                let is_read_only = class.mode().is_some_and(|mode| mode & 0o222 == 0);
                let refused = if is_read_only { Errno::EACCES } else { Errno::EOPNOTSUPP };
                let expected = Expected::failure(&[refused, Errno::EBADF]);
                let mode = rustix::fs::FallocateFlags::empty();
                let answer = who.does(move || rustix::fs::fallocate(&fd, mode, 0, 10)).map_err(of_io);
                self.check("fallocate", &what, answer, expected);
            }
            4 => {
                let answer = who.does(move || rustix::fs::fsync(&fd)).map_err(of_io);
                self.check("fsync", &what, answer, Expected::success());
            }
            5 => {
                let answer = who.does(move || nix::unistd::isatty(&fd).map(|_| ()));
                let expected = Expected::success().perhaps(&[Errno::ENOTTY]);
                self.check("isatty", &what, answer, expected);
            }
            _ => {
                let mut expected = Expected::success()
                    .or_if(flags.contains(OFlags::WRONLY) || can_write && is_folder, Errno::EACCES)
                    .or_if(is_folder, Errno::ENODEV)
                    .or_if(class.is_secret(), Errno::EFAULT);
                if self.disturbed || disturbed || class == Class::Fleeting || may_rest {
                    expected.may.push(Errno::EFAULT);
                }
                // A file that is empty has no page.
                if matches!(
                    class,
                    Class::Control
                        | Class::Keys
                        | Class::Refresh
                        | Class::Authenticate
                        | Class::Report
                        | Class::Steady
                        | Class::Transaction
                ) {
                    expected.may.push(Errno::EFAULT);
                }
                let answer = who.does(move || {
                    let pipe = nix::unistd::pipe().expect("a pipe");
                    mapped(&fd, &pipe)
                });
                let Some(bytes) = self.check("mmap", &what, answer.map_err(of_io), expected) else { return };
                // Until the file is read, the page of one that was written shows what was written.
                if class.is_secret() && bytes.iter().any(|byte| *byte != 0) {
                    self.fail(&format!("{what}: a key is mapped"));
                }
            }
        }
    }

    /// sendfile(2), which splices: from an open file into a pipe, or from a file of this machine into an open one.
    pub(super) fn sends(&mut self, user: usize) {
        let Some(at) = self.held() else { return };
        let OpenFile { class, flags, disturbed, .. } = self.open[at];
        if class == Class::Transaction {
            return;
        }
        let fd = self.open[at].fd.clone();
        let what = format!("{:?} {class:?} {flags:?}", self.users[user].role);
        if self.random.one_in(2) {
            let expected = Expected::success()
                .or_if(flags.contains(OFlags::WRONLY), Errno::EBADF)
                .or_if(class == Class::Folder, Errno::EISDIR)
                .or_if(class == Class::Folder, Errno::EINVAL)
                .or_if(class.is_secret(), Errno::EPERM);
            let mut expected = expected.perhaps(&self.failures());
            if self.open[at].may_rest() {
                expected.may.push(Errno::ESTALE);
            }
            if disturbed && class == Class::Measured || class == Class::Fleeting {
                expected.may.push(Errno::ENODEV);
            }
            let answer = self.users[user].does(move || {
                let (from, into) = nix::unistd::pipe().expect("a pipe");
                let mut offset = 0;
                let mut bytes = vec![0; rustix::fs::sendfile(&into, &fd, Some(&mut offset), 4096)?];
                let count = if bytes.is_empty() { 0 } else { rustix::io::read(&from, &mut bytes[..])? };
                bytes.truncate(count);
                Ok(bytes)
            });
            // A pipe takes what the kernel has of the file, which may be less than all of it.
            if let Some(bytes) = self.check("sendfile from", &what, answer.map_err(of_io), expected) {
                // With O_APPEND what was written stands behind the value that was there.
                let line = bytes.iter().position(|&byte| byte == b'\n').map_or(0, |end| end + 1);
                let value = if flags.contains(OFlags::APPEND) { line } else { 0 };
                let written = self.open[at].written.as_deref().map(str::as_bytes);
                let is_written = |bytes: &[u8]| {
                    written.is_some_and(|text| bytes.starts_with(text) || text.starts_with(bytes))
                };
                let value = if is_written(&bytes[value..]) { &bytes[..value] } else { &bytes[..] };
                if !value.is_empty() || bytes.is_empty() {
                    self.is_plausible(class, 0, value.len(), value, false);
                }
            }
            return;
        }
        let (text, mut expected) = self.text(class);
        let position = rustix::fs::seek(&fd, SeekFrom::Current(0)).unwrap_or_default();
        let is_read_only = class.mode().is_some_and(|mode| mode & 0o222 == 0);
        if position != 0 && !is_read_only {
            expected = Expected::failure(&[Errno::EINVAL]);
        }
        if flags.contains(OFlags::APPEND) {
            expected = Expected::failure(&[Errno::EINVAL]);
        }
        if !flags.intersects(OFlags::WRONLY | OFlags::RDWR) {
            expected = Expected::failure(&[Errno::EBADF]);
        }
        let path = self.mount.folder.file("sent");
        fs::write(&path, &text).expect("a file");
        let from = fs::File::open(&path).expect("a file");
        let length = text.len();
        let answer = self.users[user].does(move || rustix::fs::sendfile(&fd, &from, None, length));
        let what = format!("{what} {text:.40?}");
        self.written("sendfile to", &what, at, &text, answer.map_err(of_io), expected);
    }
}
