// SPDX-License-Identifier: MIT

//! Writes to files, and what becomes of them.

use std::fs;
use std::time::Duration;

use gauge_bus::clock::Clock;
use nix::errno::Errno;
use rustix::fs::{OFlags, SeekFrom};

use super::files::{Class, Expected, OpenFile, Verdict};
use super::{Model, SEALS, of_io};
use crate::room::write_cut;

impl Model {
    /// A text for a parameter.
    pub(super) fn value(&mut self, at: usize) -> (String, Verdict) {
        let junk = ["abc", " ", "1 2", "12abc", "0x", "--5", "1.5", "\0", "3\n4", "½"];
        match self.parameters[at].range {
            Ok((min, max)) => match self.random.below(10) {
                0 => (self.random.pick(&junk).into(), Verdict::Refused(Errno::EINVAL)),
                1 => (format!("{}", max + 1), Verdict::Refused(Errno::ERANGE)),
                2 => (format!("{}", min - 1), Verdict::Refused(Errno::ERANGE)),
                3 => ("9".repeat(30), Verdict::Refused(Errno::ERANGE)),
                how => {
                    let few = self.random.below(3) as i64;
                    let value = match how {
                        4 => min,
                        5 => max,
                        _ => min + few * ((max - min) / 3).max(1),
                    }
                    .min(max);
                    let text = match how {
                        6 if value >= 0 => format!("0x{value:x}"),
                        7 => format!("  {value} \n"),
                        8 if value >= 0 => format!("0b{value:b}\n"),
                        _ => format!("{value}\n"),
                    };
                    (text, Verdict::Value(value.to_string()))
                }
            },
            Err(room) => match self.random.below(4) {
                0 => ("x".repeat(room + 1), Verdict::Refused(Errno::EINVAL)),
                1 => ("caf\u{e9}".into(), Verdict::Refused(Errno::EINVAL)),
                _ => {
                    let length = 1 + self.random.below(room as u64) as usize;
                    let letter = self.random.pick(&['a', 'B', '7']);
                    let text: String = std::iter::repeat_n(letter, length).collect();
                    (format!("{text}\n"), Verdict::Value(text))
                }
            },
        }
    }

    /// A text for a file, and what a write of it may answer, with the right to write and at offset 0.
    pub(super) fn text(&mut self, class: Class) -> (String, Expected) {
        let random = &mut self.random;
        let fails = |errno| Expected::failure(&[errno]);
        match class {
            Class::Parameter(at) => {
                let (text, verdict) = self.value(at);
                let expected = match verdict {
                    _ if self.staged.is_some() => fails(Errno::EBUSY),
                    Verdict::Refused(errno) => fails(errno),
                    Verdict::Value(_) if self.low => fails(Errno::EAGAIN),
                    Verdict::Value(_) => Expected::success(),
                };
                (text, expected)
            }
            Class::Secret => ("0x00001234\n".into(), Expected::failure(&[Errno::EPERM, Errno::EBUSY])),
            Class::Seal => match random.pick(&["sealed", "unsealed", "full-access", "open", " "]) {
                word @ ("open" | " ") => (word.into(), fails(Errno::EINVAL)),
                word => (format!("{word}\n"), Expected::success()),
            },
            Class::Control => match random.below(3) {
                0 => (random.pick(&["RESET", "0x0041", "nonsense", "SEALED\n"]).into(), fails(Errno::EINVAL)),
                _ => {
                    let (name, is_taken_sealed) = random.pick(&self.controls);
                    let expected = match (self.seal.contains("sealed"), self.seal.len()) {
                        (true, 1) if !is_taken_sealed => fails(Errno::EPERM),
                        (true, _) if !is_taken_sealed => Expected::success().perhaps(&[Errno::EPERM]),
                        _ => Expected::success(),
                    };
                    (name.into(), expected)
                }
            },
            Class::Keys => match random.below(3) {
                0 => (" \n".into(), Expected::success()),
                1 => ("unseal 0414 3672 0000 0000\n".into(), fails(Errno::ERANGE)),
                _ => (random.pick(&["unseal 0414", "open sesame"]).into(), fails(Errno::EINVAL)),
            },
            Class::Authenticate => match random.below(2) {
                0 => ("12 34\n".into(), fails(Errno::EINVAL)),
                _ => ("0123456789abcdef".repeat(3)[..40].to_string(), Expected::success()),
            },
            Class::Settle => match random.below(2) {
                0 => ("show\n".into(), Expected::success()),
                _ => ("perhaps\n".into(), fails(Errno::EINVAL)),
            },
            Class::Interval => match random.below(3) {
                0 => (random.pick(&["0", "3601", "-1", "1e9"]).into(), fails(Errno::ERANGE)),
                1 => (random.pick(&["soon", " ", "NaN s"]).into(), fails(Errno::EINVAL)),
                _ => (random.pick(&["30\n", "600", "3600"]).into(), Expected::success()),
            },
            Class::Refresh | Class::Report => ("1\n".into(), Expected::success()),
            Class::Knob => match random.below(3) {
                0 => ("much\n".into(), fails(Errno::EINVAL)),
                _ => ("0\n".into(), Expected::success()),
            },
            _ => ("1\n".into(), fails(Errno::EACCES)),
        }
    }

    pub(super) fn write_one(&mut self, user: usize) {
        let Some(at) = self.held() else { return };
        self.writes(user, at);
    }

    pub(super) fn writes(&mut self, user: usize, at: usize) -> Option<usize> {
        let OpenFile { class, flags, .. } = self.open[at];
        if class == Class::Transaction {
            return None;
        }
        let (mut text, mut expected) = self.text(class);
        let fd = self.open[at].fd.clone();
        let how = self.random.below(12);
        let position = rustix::fs::seek(&fd, SeekFrom::Current(0)).unwrap_or_default();
        // At the position, which a read or write has moved, or at a chosen one.
        let offset = match how {
            0 => Some(self.random.pick(&[1, 4096, 1 << 33])),
            1..4 => None,
            _ => Some(0),
        };
        let too_long = how == 4;
        if too_long {
            text = text.trim_end().to_string() + &" ".repeat(5000);
        }
        let is_moved = offset.unwrap_or(position) != 0 && !flags.contains(OFlags::APPEND);
        // The kernel refuses what nobody may write before gaugefs gets it.
        let is_read_only = class.mode().is_some_and(|mode| mode & 0o222 == 0);
        if (is_moved || too_long) && !is_read_only {
            expected = Expected::failure(&[if is_moved { Errno::EINVAL } else { Errno::EFBIG }]);
        }
        if class == Class::Report && flags.contains(OFlags::APPEND) {
            // What is appended may end where a page does, behind which a longer text would go on.
            expected.may.push(Errno::EFBIG);
        }
        if !flags.intersects(OFlags::WRONLY | OFlags::RDWR) {
            expected = Expected::failure(&[Errno::EBADF]);
        }
        let data = text.clone();
        let in_parts = how == 5;
        if how == 6 && offset.is_some_and(|offset| offset != 1 << 33) && !too_long {
            return self.writes_cut(user, at, text, expected);
        }
        let answer = self.users[user].does(move || match offset {
            Some(offset) => rustix::io::pwrite(&fd, data.as_bytes(), offset),
            // The kernel passes the parts on as one.
            None if in_parts => {
                let (one, two) = data.as_bytes().split_at(data.len() / 2);
                rustix::io::writev(&fd, &[std::io::IoSlice::new(one), std::io::IoSlice::new(two)])
            }
            None => rustix::io::write(&fd, data.as_bytes()),
        });
        let what = format!("{:?} {class:?} {text:.40?} {offset:?}", self.users[user].role);
        self.written("write", &what, at, &text, answer.map_err(of_io), expected);
        Some(at)
    }

    /// A write whose buffer is not all there: the kernel passes on what there is, or nothing.
    pub(super) fn writes_cut(
        &mut self,
        user: usize,
        at: usize,
        text: String,
        expected: Expected,
    ) -> Option<usize> {
        let OpenFile { class, flags, .. } = self.open[at];
        let fd = self.open[at].fd.clone();
        let position = rustix::fs::seek(&fd, SeekFrom::Current(0)).unwrap_or_default();
        let there = self.random.below(text.len() as u64) as usize;
        let part = text.as_bytes()[..there].to_vec();
        // What a part of a text is to the file is not what all of it is.
        let is_moved = position != 0 && !flags.contains(OFlags::APPEND);
        let can_write = flags.intersects(OFlags::WRONLY | OFlags::RDWR);
        let Class::Parameter(parameter) = class else { return None };
        if is_moved
            || !can_write
            || self.parameters[parameter].range.is_err()
            || flags.contains(OFlags::DIRECT)
        {
            return None;
        }
        drop(expected);
        let data = text.clone();
        let answer = self.users[user].does(move || write_cut(&fd, data.as_bytes(), there)).map_err(of_io);
        let what = format!("{:?} {class:?} {text:.40?}, {there} bytes of it", self.users[user].role);
        let refusals = [Errno::EFAULT, Errno::EINVAL, Errno::ERANGE, Errno::EBUSY, Errno::EAGAIN];
        let expected = Expected::success().perhaps(&refusals).perhaps(&self.failures());
        let outcome = answer.map(drop);
        let new = self.canonical(parameter, &String::from_utf8_lossy(&part));
        let is_value = self.parameters[parameter]
            .range
            .is_ok_and(|(min, max)| new.parse::<i64>().is_ok_and(|value| (min..=max).contains(&value)));
        if let Some(length) = self.check("write cut", &what, answer, expected)
            && (length > there || !is_value || self.keeps_writes_out())
        {
            self.fail(&format!("{length} bytes were written, {there} are there"));
        }
        if outcome.is_ok() {
            self.open[at].written = Some(String::from_utf8_lossy(&part).into());
        }
        self.outcome(&[(parameter, new)], outcome);
        Some(at)
    }

    /// The consequences of a write.
    pub(super) fn written(
        &mut self,
        call: &str,
        what: &str,
        at: usize,
        text: &str,
        answer: Result<usize, Errno>,
        expected: Expected,
    ) {
        let class = self.open[at].class;
        let mut expected = expected.perhaps(&self.failures());
        // What kept it out has ended where the gauge was away.
        expected.fails &= !(self.staged.is_some() && self.was_away() && expected.may.contains(&Errno::EBUSY));
        let outcome = answer.map(drop);
        let length = answer.unwrap_or(text.len());
        let is_done = self.check(call, what, answer, expected).is_some();
        if is_done && length != text.len() {
            self.fail(&format!("{length} of {} bytes were written", text.len()));
        }
        if is_done {
            self.open[at].written = Some(text.into());
        }
        match class {
            Class::Parameter(at) => {
                let new = self.canonical(at, text);
                self.outcome(&[(at, new)], outcome);
            }
            Class::Seal => match SEALS.iter().find(|seal| **seal == text.trim()) {
                Some(seal) if is_done => self.seal = [*seal].into(),
                _ if self.disturbed => self.seal = SEALS.into(),
                _ => {}
            },
            // A calibration keeps writes out, and ends by itself.
            Class::Control if is_done && text.contains("OFFSET") => {
                self.mount.clock.sleep(Duration::from_secs(120));
                let refresh = self.path("gauge/refresh");
                let refreshed = self.users[0].does(move || fs::write(refresh, "1\n"));
                if let (Err(error), false) = (refreshed, self.disturbed) {
                    self.fail(&format!("refresh: {error}"));
                }
            }
            _ => {}
        }
    }

    /// How a text reads once it is stored.
    pub(super) fn canonical(&self, at: usize, text: &str) -> String {
        let text = text.trim();
        if self.parameters[at].range.is_err() {
            return text.into();
        }
        let number = match (text.strip_prefix("0x"), text.strip_prefix("0b")) {
            (Some(digits), _) => i64::from_str_radix(digits, 16).ok(),
            (_, Some(digits)) => i64::from_str_radix(digits, 2).ok(),
            _ => text.parse().ok(),
        };
        number.map(|number: i64| number.to_string()).unwrap_or_default()
    }

    /// What the parameters of a write hold after it.
    pub(super) fn outcome(&mut self, changes: &[(usize, String)], outcome: Result<(), Errno>) {
        for (at, new) in changes {
            let parameter = &mut self.parameters[*at];
            match outcome {
                Ok(()) => parameter.values = [new.clone()].into(),
                Err(Errno::ENOTRECOVERABLE) => drop(parameter.values.insert(new.clone())),
                Err(_) => {}
            }
            parameter.history.extend(parameter.values.clone());
        }
        if self.disturbed {
            self.seal = SEALS.into();
        } else {
            for (at, _) in changes {
                self.reads_back(*at);
            }
        }
    }

    /// `cat` or `echo` of one file: what a shell does.
    pub(super) fn echo(&mut self, user: usize) {
        let file = self.random.below(self.files.len() as u64) as usize;
        let (name, class) = self.files[file].clone();
        if matches!(class, Class::Outside | Class::Folder) {
            return;
        }
        let writes = self.random.one_in(2);
        let flags = if writes { OFlags::WRONLY | OFlags::TRUNC } else { OFlags::RDONLY };
        let before = self.programmed();
        let Some(at) = self.opens(user, &name, class, flags) else { return };
        if writes {
            self.writes(user, at);
        } else {
            self.reads(user, at, 0, 70_000, true);
        }
        let was_refused = self.recent.last().is_some_and(|last| !last.ends_with("success"));
        if was_refused && !self.disturbed && before != self.programmed() {
            self.fail("a refused write has programmed data flash");
        }
        self.open.pop();
    }
}
