// SPDX-License-Identifier: MIT

//! Calls that take a path.

use std::collections::BTreeSet;
use std::fs;

use nix::errno::Errno;
use rustix::fs::{AtFlags, CWD, FileType, Mode, Timespec, Timestamps, XattrFlags};
use rustix::process::Uid;

use super::files::{Class, Expected};
use super::users::Role;
use super::{Model, of_io};

impl Model {
    /// Calls that take a path.
    pub(super) fn call(&mut self, user: usize, name: &str, class: Class) {
        let path = self.path(name);
        let new = self.random.pick(&["new", "df/new", "type"]);
        let new = self.path(new);
        let who = &self.users[user];
        let role = who.role;
        let is_stranger = role == Role::Stranger;
        let is_owner = matches!(role, Role::Root | Role::Owner);
        let target = class.followed();
        let may = target.mode().map_or(0, |mode| who.may(mode));
        let is_folder = class == Class::Folder;
        let is_link = matches!(class, Class::Link | Class::Outside);
        let there = self.there(target);
        // Nothing can be added, removed or renamed: gaugefs refuses it, and before that the mode of the folders.
        let fixed =
            || Expected::failure(&[if is_stranger { Errno::EACCES } else { Errno::EPERM }, Errno::ENOENT]);
        let what = format!("{role:?} {name}");
        if class == Class::Outside && !matches!(self.random.below(2), 0) {
            let target = who.does(move || rustix::fs::readlink(path, Vec::new())).map_err(of_io);
            self.check("readlink", &what, target, Expected::success());
            return;
        }
        match self.random.below(21) {
            0 | 1 => {
                let (mode, size) = (class.mode(), class == Class::Folder);
                let status = who.does(move || rustix::fs::lstat(path)).map_err(of_io);
                let Some(status) = self.check("lstat", &what, status, self.there(class)) else { return };
                let wanted = if is_link { Some(0o777) } else { mode };
                if wanted != Some(status.st_mode & 0o7777)
                    || size != (status.st_mode & 0o170_000 == 0o040_000)
                {
                    self.fail(&format!("{what}: mode {:o}, not {:o}", status.st_mode, wanted.unwrap_or(0)));
                }
            }
            2 if class != Class::Outside => {
                let bits = 1 + self.random.below(7) as u32;
                let wanted = rustix::fs::Access::from_bits_truncate(bits);
                // The mount is `noexec`: no file can be executed.
                let has = if is_folder { may } else { may & 6 };
                let expected = there.or_if(target.mode().is_some() && bits & !has != 0, Errno::EACCES);
                let who = &self.users[user];
                let answer = who.does(move || rustix::fs::access(path, wanted)).map_err(of_io);
                self.check("access", &format!("{what} {bits}"), answer, expected);
            }
            3 if class != Class::Outside => {
                let expected = self.there(target).or_if(true, Errno::EPERM);
                let who = &self.users[user];
                let answer = who.does(move || rustix::fs::chmod(path, Mode::RWXU)).map_err(of_io);
                self.check("chmod", &what, answer, expected);
            }
            4 if class != Class::Outside => {
                let mut expected = self.there(target).or_if(true, Errno::EPERM);
                // To give a file to its own owner is the same to gaugefs as a write, which a read-only file refuses so.
                if target.mode().is_some_and(|mode| mode & 0o222 == 0) {
                    expected.may.push(Errno::EACCES);
                }
                let who = &self.users[user];
                let uid = Some(Uid::from_raw(self.random.pick(&[0, 2001, 2004])));
                let answer = who.does(move || rustix::fs::chown(path, uid, None)).map_err(of_io);
                self.check("chown", &what, answer, expected);
            }
            5 => {
                let expected = fixed().or_if(is_folder, Errno::EISDIR).or_if(is_folder, Errno::EBUSY);
                let answer = who.does(move || rustix::fs::unlink(path)).map_err(of_io);
                self.check("unlink", &what, answer, expected);
            }
            6 => {
                let expected = fixed().or_if(!is_folder, Errno::ENOTDIR);
                let answer = who.does(move || rustix::fs::rmdir(path)).map_err(of_io);
                self.check("rmdir", &what, answer, expected);
            }
            7 => {
                // To its own name is no change.
                let mut expected = fixed().perhaps(&[Errno::ENOTDIR, Errno::EISDIR, Errno::EINVAL]);
                expected.fails = path != new;
                let answer = who.does(move || rustix::fs::rename(path, new)).map_err(of_io);
                self.check("rename", &what, answer, expected);
            }
            8 => {
                let expected = fixed().or_if(self.exists(class) != Some(false), Errno::EEXIST);
                let answer =
                    self.users[user].does(move || rustix::fs::mkdir(path, Mode::RWXU)).map_err(of_io);
                self.check("mkdir", &what, answer, expected);
            }
            9 => {
                let expected = fixed().or_if(true, Errno::EEXIST).or_if(true, Errno::EPERM);
                let answer = who.does(move || rustix::fs::link(path, new)).map_err(of_io);
                self.check("link", &what, answer, expected);
            }
            10 => {
                let expected = fixed().or_if(self.exists(class) != Some(false), Errno::EEXIST);
                let answer = self.users[user].does(move || rustix::fs::symlink("there", path)).map_err(of_io);
                self.check("symlink", &what, answer, expected);
            }
            11 => {
                let expected = fixed().or_if(self.exists(class) != Some(false), Errno::EEXIST);
                let answer = self.users[user]
                    .does(move || rustix::fs::mknodat(CWD, path, FileType::Fifo, Mode::RWXU, 0))
                    .map_err(of_io);
                self.check("mknod", &what, answer, expected);
            }
            12 => {
                let expected = self.there(class).or_if(!is_link && class.mode().is_some(), Errno::EINVAL);
                let answer = self.users[user].does(move || rustix::fs::readlink(path, Vec::new()));
                self.check("readlink", &what, answer.map_err(of_io), expected);
            }
            13 | 14 if class != Class::Outside => {
                let length = self.random.pick(&[-1, 0, 1, 4096, 1 << 33]);
                let mode = target.mode();
                let expected = there
                    .or_if(length < 0, Errno::EINVAL)
                    .or_if(is_folder, Errno::EISDIR)
                    .or_if(mode.is_some_and(|mode| may & 2 == 0 || mode & 0o222 == 0), Errno::EACCES);
                let who = &self.users[user];
                let answer = who.does(move || nix::unistd::truncate(&path, length));
                self.check("truncate", &format!("{what} {length}"), answer, expected);
            }
            15 if class != Class::Outside => {
                let (attribute, room) = self.random.pick(&[
                    ("user.gauge.name", 256),
                    ("user.gauge.name", 2),
                    ("user.other", 256),
                ]);
                let is_row = matches!(target, Class::Parameter(_) | Class::Secret);
                let has = is_row && attribute == "user.gauge.name";
                let expected = there
                    .or_if(target.mode().is_some() && may & 4 == 0, Errno::EACCES)
                    .or_if(!has, Errno::ENODATA)
                    .or_if(has && room == 2, Errno::ERANGE);
                let who = &self.users[user];
                let answer = who.does(move || {
                    let mut value = vec![0; room];
                    rustix::fs::getxattr(path, attribute, &mut value[..])
                });
                self.check("getxattr", &format!("{what} {attribute}"), answer.map_err(of_io), expected);
            }
            16 if class != Class::Outside => {
                let answer =
                    who.does(move || rustix::fs::listxattr(path, &mut [0u8; 4096][..])).map_err(of_io);
                self.check("listxattr", &what, answer, there);
            }
            17 if class != Class::Outside => {
                let expected = there.or_if(true, Errno::EPERM).or_if(may & 2 == 0, Errno::EACCES);
                let answer = self.users[user]
                    .does(move || rustix::fs::setxattr(path, "user.gauge.name", b"x", XattrFlags::empty()));
                self.check("setxattr", &what, answer.map_err(of_io), expected);
            }
            18 if class != Class::Outside => {
                let expected = there.or_if(true, Errno::EPERM).or_if(may & 2 == 0, Errno::EACCES);
                let who = &self.users[user];
                let answer =
                    who.does(move || rustix::fs::removexattr(path, "user.gauge.name")).map_err(of_io);
                self.check("removexattr", &what, answer, expected);
            }
            19 if class != Class::Outside => {
                let expected = there.or_if(!is_folder && target.mode().is_some(), Errno::ENOTDIR);
                let who = &self.users[user];
                let names = who.does(move || {
                    fs::read_dir(path).and_then(|list| {
                        list.map(|entry| entry.map(|entry| entry.file_name())).collect::<Result<Vec<_>, _>>()
                    })
                });
                let names = names.map_err(|error| Errno::from_raw(error.raw_os_error().unwrap_or_default()));
                let Some(names) = self.check("readdir", &what, names, expected) else { return };
                if names.iter().collect::<BTreeSet<_>>().len() != names.len() {
                    self.fail(&format!("{what} lists a name twice: {names:?}"));
                }
            }
            20 if class != Class::Outside => {
                let time = Timespec { tv_sec: 1, tv_nsec: 0 };
                let times = Timestamps { last_access: time, last_modification: time };
                let expected = there.or_if(target.mode().is_some() && !is_owner, Errno::EPERM);
                let who = &self.users[user];
                let answer = who.does(move || rustix::fs::utimensat(CWD, path, &times, AtFlags::empty()));
                self.check("utimensat", &what, answer.map_err(of_io), expected);
            }
            _ => {
                let answer = who.does(move || rustix::fs::statvfs(path)).map_err(of_io);
                self.check(
                    "statfs",
                    &what,
                    answer,
                    if class == Class::Outside { Expected::success() } else { there },
                );
            }
        }
    }
}
