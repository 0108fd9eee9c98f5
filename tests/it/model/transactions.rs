// SPDX-License-Identifier: MIT

//! Lines for `df/transaction`.

use std::collections::BTreeMap;
use std::fs;

use nix::errno::Errno;
use rustix::fs::OFlags;

use super::files::{Class, Expected, Verdict};
use super::{Model, of_io};

impl Model {
    /// Lines for `df/transaction`.
    pub(super) fn stage(&mut self, user: usize) {
        let presence = self.mount.handle.published().presence;
        if std::mem::replace(&mut self.presence, presence) != presence {
            let path = self.path("df/transaction");
            self.users[0].does(move || {
                // There may be none to end.
                let _ = fs::write(&path, "abort\n");
                let _ = fs::write(&path, "begin\nabort\n");
            });
            (self.staged, self.spoiled) = (None, None);
        }
        let mut lines = Vec::new();
        let (mut staged, mut spoiled) = (self.staged.clone(), self.spoiled);
        let mut expected = Expected::success();
        let mut commits = None;
        for _ in 0..=self.random.below(4) {
            let at = self.random.below(self.parameters.len() as u64) as usize;
            let is_open = staged.is_some();
            let (line, refused) = match self.random.below(8) {
                0 | 1 if !is_open || spoiled.is_some() => {
                    (staged, spoiled) = (Some(BTreeMap::new()), None);
                    ("begin".to_string(), None)
                }
                0 => ("begin".to_string(), is_open.then_some(Errno::EBUSY)),
                1 => {
                    let was_open = staged.take().is_some();
                    ("abort".to_string(), (!was_open).then_some(Errno::ENODATA))
                }
                2 if spoiled.is_some() && self.random.one_in(2) => {
                    (staged, spoiled) = (None, None);
                    ("abort".to_string(), None)
                }
                2 => {
                    let ended = staged.take();
                    let refused = ended.is_none() && spoiled.is_none();
                    commits = (!refused).then(|| ended.filter(|_| spoiled.is_none()).unwrap_or_default());
                    ("commit".to_string(), refused.then_some(Errno::ENODATA))
                }
                3 => {
                    let none = [
                        "80/9999 1",
                        "it-cfg/no-such 1",
                        "power/cell-terminate-voltage 3100",
                        "cell-terminate-volts 3100",
                    ];
                    let line = self.random.pick(&none).to_string();
                    (line, Some(if is_open { Errno::ENOENT } else { Errno::ENODATA }))
                }
                4 => ("nonsense".to_string(), Some(if is_open { Errno::EINVAL } else { Errno::ENODATA })),
                _ => {
                    let (text, verdict) = self.value(at);
                    let text = text.trim().to_string();
                    let named = self.random.below(self.parameters[at].names.len() as u64) as usize;
                    let line = format!("{} {text}", self.parameters[at].names[named]);
                    let refused = match verdict {
                        _ if !is_open => Some(Errno::ENODATA),
                        // A line end in it makes two lines of it, and a text without printable letters none.
                        _ if text.contains('\n') || text.is_empty() => Some(Errno::EINVAL),
                        Verdict::Refused(errno) => Some(errno),
                        Verdict::Value(value) => {
                            staged.as_mut().expect("it is open").insert(at, value);
                            None
                        }
                    };
                    (line, refused)
                }
            };
            lines.push(line);
            if let Some(errno) = refused {
                expected = Expected::failure(&[errno]);
                // In text that is not UTF-8, or that is a value with a line end, an earlier part counts.
                if lines.last().is_some_and(|line| line.contains('\n')) {
                    expected.may.extend([Errno::ERANGE, Errno::EINVAL]);
                }
                break;
            }
            if commits.is_some() {
                break;
            }
        }
        let mut text = lines.join("\n") + "\n";
        if self.random.one_in(8) {
            text.pop();
            expected = Expected::failure(&[Errno::EINVAL]);
        }
        let is_refused = expected.fails;
        if self.opens(user, "df/transaction", Class::Transaction, OFlags::WRONLY).is_none() {
            return;
        }
        let changes: Vec<_> = commits.iter().flatten().map(|(at, value)| (*at, value.clone())).collect();
        if !is_refused && !changes.is_empty() && self.low {
            expected = Expected::failure(&[Errno::EAGAIN]);
        }
        if let Some(errno) = spoiled.filter(|_| !is_refused && commits.is_some()) {
            expected = Expected::failure(&[errno]);
        }
        let expected = if commits.is_some() { expected.perhaps(&self.failures()) } else { expected };
        let fd = self.open.pop().expect("it was opened").fd;
        let data = text.clone();
        let answer = self.users[user].does(move || rustix::io::write(&fd, data.as_bytes())).map_err(of_io);
        let outcome = answer.map(drop);
        let what = format!("{:?} {text:?}", self.users[user].role);
        if outcome == Err(Errno::ENODEV) && self.staged.is_some() {
            // It was away just now.
            (self.staged, self.spoiled) = (None, None);
            self.check("write", &what, answer, Expected::failure(&[Errno::ENODEV]));
            return;
        }
        self.check("write", &what, answer, expected);
        if !is_refused {
            // The commit ends it, whatever comes of it.
            (self.staged, self.spoiled) = (staged, spoiled);
            self.outcome(&changes, outcome);
        } else if lines[0] == "begin" {
            // While a transaction is open that may be committed, it is of another one.
            if self.staged.is_none() || self.spoiled.is_some() {
                self.spoiled = outcome.err();
            }
        } else if self.staged.is_some() {
            self.spoiled = self.spoiled.or(outcome.err());
        } else if outcome == Err(Errno::EBUSY) {
            // A second `begin` after `abort` and `begin`, all in one write: it would have begun one.
            self.spoiled = outcome.err();
        }
        if !self.disturbed && self.random.one_in(2) {
            self.opens(0, "df/transaction", Class::Transaction, OFlags::RDONLY)
                .into_iter()
                .for_each(|at| self.reads(0, at, 0, 70_000, true));
        }
    }
}
