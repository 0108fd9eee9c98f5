// SPDX-License-Identifier: MIT

//! What a file shows, and whether that may be.

use nix::errno::Errno;
use rustix::fs::{OFlags, SeekFrom};

use super::files::{Class, Expected, OpenFile};
use super::{Model, of_io};

impl Model {
    pub(super) fn read_one(&mut self, user: usize) {
        let Some(at) = self.held() else { return };
        let offset = self.random.pick(&[0, 0, 0, 1, 3, 4095, 4096, 1 << 40]);
        let length = self.random.pick(&[1, 64, 4096, 70_000]);
        self.reads(user, at, offset, length, false);
    }

    pub(super) fn reads(&mut self, user: usize, at: usize, offset: u64, length: usize, is_fresh: bool) {
        let OpenFile { class, flags, disturbed, .. } = self.open[at];
        let expected = Expected::success()
            .or_if(flags.contains(OFlags::WRONLY), Errno::EBADF)
            .or_if(class == Class::Folder, Errno::EISDIR)
            .or_if(class.is_secret(), Errno::EPERM);
        let mut expected = expected.perhaps(&self.failures());
        if disturbed && class == Class::Measured || class == Class::Fleeting {
            expected.may.push(Errno::ENODEV);
        }
        let fd = self.open[at].fd.clone();
        let how = self.random.below(3);
        let bytes = self.users[user].does(move || {
            let mut bytes = vec![0; length];
            let count = match how {
                0 => rustix::fs::seek(&fd, SeekFrom::Start(offset))
                    .and_then(|_| rustix::io::read(&fd, &mut bytes[..]))?,
                _ => rustix::io::pread(&fd, &mut bytes[..], offset)?,
            };
            bytes.truncate(count);
            Ok(bytes)
        });
        let what = format!("{:?} {class:?} {offset} {length}", self.users[user].role);
        // At the end of a file nothing is read, whoever asks.
        let fails = expected.fails && (offset == 0 || !class.is_secret());
        let bytes = self.check("read", &what, bytes.map_err(of_io), Expected { fails, ..expected });
        if let Some(bytes) = bytes {
            self.is_plausible(class, offset as usize, length, &bytes, is_fresh);
        }
    }

    /// Whether these bytes are those of a value that the file has or, if it is held open, has had.
    pub(super) fn is_plausible(
        &self,
        class: Class,
        offset: usize,
        length: usize,
        bytes: &[u8],
        is_fresh: bool,
    ) {
        let part = |text: &str| {
            let text = text.as_bytes();
            bytes == &text[offset.min(text.len())..text.len().min(offset.saturating_add(length))]
        };
        let text = String::from_utf8_lossy(bytes);
        let is_whole = offset == 0 && length >= 4096;
        let is_so = match class {
            Class::Parameter(at) => {
                let parameter = &self.parameters[at];
                let values = if is_fresh { &parameter.values } else { &parameter.history };
                values.iter().any(|value| part(&format!("{value}\n")))
            }
            Class::Secret | Class::SecretRaw => bytes.is_empty(),
            Class::Seal if is_fresh => self.seal.iter().any(|seal| part(&format!("{seal}\n"))),
            Class::Transaction if is_fresh && self.was_away() => true,
            Class::Transaction if is_fresh && !self.disturbed && is_whole => match &self.staged {
                None => text == "idle\n",
                Some(staged) => {
                    text.lines().count() == staged.len()
                        && staged.iter().all(|(&at, value)| {
                            let end = format!(" -> {value}");
                            let name = format!("{}: ", self.parameters[at].name);
                            text.lines().any(|line| line.starts_with(&name) && line.ends_with(&end))
                        })
                }
            },
            Class::Steady | Class::Measured if is_whole => bytes.is_empty() || text.ends_with('\n'),
            Class::Control if is_whole => {
                let bytes_of = |word: &str| ti_gauge::text::unhex(word.strip_prefix("0x")?.as_bytes());
                let is_word = |word: &str| bytes_of(word).is_some_and(|bytes| bytes.len() == 2);
                let words = text.strip_suffix('\n').and_then(|line| line.split_once(' '));
                bytes.is_empty() || words.is_some_and(|(asked, answer)| is_word(asked) && is_word(answer))
            }
            Class::Keys | Class::Refresh => bytes.is_empty(),
            _ => true,
        };
        if !is_so {
            self.fail(&format!("{class:?} shows `{text}` at {offset}"));
        }
    }

    /// A parameter shows one of the values that it may have.
    pub(super) fn reads_back(&mut self, at: usize) {
        let text = self.shown(&format!("df/{}", self.parameters[at].place));
        let parameter = &mut self.parameters[at];
        match text {
            Ok(text) if parameter.values.contains(&text) => parameter.values = [text].into(),
            text => {
                let what = format!("{} reads {text:?}, not {:?}", parameter.name, parameter.values);
                self.fail(&what);
            }
        }
    }
}
