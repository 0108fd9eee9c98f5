// SPDX-License-Identifier: MIT

//! Calls of other processes, some of which are killed, and of a user without rights.

use std::collections::BTreeSet;
use std::fs;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use nix::errno::Errno;
use rustix::fs::{Mode, OFlags};

use super::users::User;
use super::{Model, SEALS, of_io};

impl Model {
    /// Several processes that write and read parameters at the same time, one of which may be killed. What is stored
    /// then is what one of those that were told of success has written, or one that was told nothing.
    pub(super) fn starts_processes(&mut self) {
        let few = 1 + self.random.below(4);
        let mut running: Vec<(usize, Option<String>, Child, bool)> = Vec::new();
        for _ in 0..few {
            // Few parameters, so that some are written by several.
            let at = self.random.below(3) as usize;
            let user = self.random.below(self.users.len() as u64) as usize;
            let Ok((min, max)) = self.parameters[at].range else { continue };
            let writes = self.random.one_in(2);
            let value = (min + (max - min) / 3 * self.random.below(3) as i64).to_string();
            let path = self.path(&format!("df/{}", self.parameters[at].place));
            let script = if writes { "printf %s \"$1\" >\"$0\"" } else { "exec cat \"$0\"" };
            let mut command = Command::new("/bin/sh");
            command.args(["-c", script]).arg(&path).arg(&value);
            if let Some((uid, gid)) = self.users[user].ids {
                command.uid(uid).gid(gid);
            }
            command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
            let may = self.users[user].may(0o660) & 6 == 6;
            running.push((at, writes.then_some(value), command.spawn().expect("a shell"), may));
        }
        let killed = if self.random.one_in(3) { self.random.below(few) as usize } else { usize::MAX };
        if let Some((_, _, child, _)) = running.get_mut(killed) {
            std::thread::sleep(Duration::from_micros(self.random.below(4000)));
            let _ = child.kill();
        }
        let mut ended = Vec::new();
        for (number, (at, value, child, may)) in running.into_iter().enumerate() {
            let output = child.wait_with_output().expect("its end");
            let is_killed = number == killed && output.status.code().is_none();
            self.processes.0 += 1;
            self.processes.1 += u64::from(is_killed);
            self.recent.push(format!(
                "process: {} {value:?}, killed {is_killed}: {}",
                self.parameters[at].place, output.status
            ));
            if let Some(value) = &value {
                self.parameters[at].history.insert(value.clone());
            }
            ended.push((at, value, output, is_killed, may));
        }
        // The owner has carried out what a killed one has left in its queue.
        let path = self.path("gauge/refresh");
        let _ = self.users[0].does(move || fs::write(path, "1\n"));
        for (at, value, output, is_killed, may) in &ended {
            let is_calm = !(self.disturbed || *is_killed);
            match value {
                None if output.status.success() => {
                    let text = String::from_utf8_lossy(&output.stdout);
                    if !self.has_had(*at, &text) {
                        self.fail(&format!("another process reads {text:?}"));
                    }
                }
                Some(_) if output.status.success() && (!may || self.keeps_writes_out()) => {
                    self.fail("a write of another process succeeded");
                }
                _ if *may && is_calm && !output.status.success() => {
                    let is_refused = value.is_some() && (self.staged.is_some() || self.low);
                    if !is_refused {
                        self.fail("another process was refused");
                    }
                }
                _ => {}
            }
        }
        for at in 0..3 {
            let wrote = |is: &dyn Fn(bool, bool) -> bool| -> BTreeSet<String> {
                let of = ended.iter().filter(|(of, _, output, is_killed, _)| {
                    *of == at && is(output.status.success(), *is_killed)
                });
                of.filter_map(|(_, value, ..)| value.clone()).collect()
            };
            let stored = wrote(&|success, _| success);
            // Those of which nothing is known: an error of a disturbed gauge may leave either.
            let open = wrote(&|success, is_killed| !success && (is_killed || self.disturbed));
            let parameter = &mut self.parameters[at];
            if !stored.is_empty() {
                parameter.values = stored;
            }
            parameter.values.extend(open);
            parameter.history.extend(parameter.values.clone());
            if self.disturbed {
                self.seal = SEALS.into();
            } else {
                self.reads_back(at);
            }
        }
    }

    /// Whether a text that was read in several calls is one that a parameter has had, or was changed to in between: the end of
    /// the new one follows where the old one ends.
    fn has_had(&self, at: usize, text: &str) -> bool {
        let history = || self.parameters[at].history.iter().map(|value| format!("{value}\n"));
        history().any(|new| {
            new == text
                || history()
                    .any(|old| text.strip_prefix(&*old).is_some_and(|end| new.get(old.len()..) == Some(end)))
        })
    }
}

/// Reads and opens as somebody who has no rights, at the same time.
pub(super) fn trespass(root: &Path, user: &User, over: &AtomicBool) -> u64 {
    let mut count = 0;
    while !over.load(Ordering::SeqCst) {
        for name in
            ["df/80/53", "df/index", "df/transaction", "df/80/raw", "gauge/seal", "gauge/keys", "sim/fault"]
        {
            for flags in [OFlags::RDONLY, OFlags::WRONLY, OFlags::RDWR | OFlags::TRUNC] {
                let path = root.join(name);
                let opened = user.does(move || rustix::fs::open(path, flags, Mode::empty())).map_err(of_io);
                assert!(matches!(opened, Err(Errno::EACCES | Errno::ENOENT)), "{name} {flags:?}: {opened:?}");
                count += 1;
            }
        }
        // Others write to them meanwhile, which is refused and never seen.
        let (path, steady) = (root.join("uevent"), root.join("type"));
        let text = user.does(move || fs::read_to_string(path)).expect("everybody may read it");
        assert!(text.starts_with("POWER_SUPPLY_NAME=BAT0\n") && text.ends_with('\n'), "{text}");
        let text = user.does(move || fs::read_to_string(steady)).expect("everybody may read it");
        assert_eq!(text, "Battery\n");
    }
    count
}
