// SPDX-License-Identifier: MIT

//! The author of a write: an open file, and the process that has called write(2).

use std::fs;
use std::path::Path;

use gauge_bus::regular;

/// The author of a write(2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Caller {
    /// The open file. No other open file has this number.
    pub file: u64,
    /// The process, if visible: the kernel shows none of another PID namespace.
    pub process: Option<Process>,
}

/// A process. Its number may return, but not with its start time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Process {
    id: u32,
    start: u64,
}

impl Process {
    /// The process of a thread.
    pub fn of_thread(thread: u32) -> Option<Self> {
        let status = proc(thread, "status")?;
        let id = status.lines().find_map(|line| line.strip_prefix("Tgid:"))?.trim().parse().ok()?;
        let (_, start) = state(id)?;
        Some(Self { id, start })
    }

    /// Whether it has ended.
    pub(super) fn has_ended(self) -> bool {
        // The first thread may end before the others.
        let others = || {
            let threads = fs::read_dir(Path::new("/proc").join(self.id.to_string()).join("task"));
            threads.is_ok_and(|threads| threads.flatten().count() > 1)
        };
        state(self.id)
            .is_none_or(|(state, start)| start != self.start || matches!(state, 'Z' | 'X') && !others())
    }

    /// A process that a test knows by a number, and no other.
    #[cfg(test)]
    pub(super) fn numbered(id: u32) -> Self {
        Self { id, start: 0 }
    }
}

/// A file of a process or thread.
fn proc(id: u32, file: &str) -> Option<String> {
    let path = Path::new("/proc").join(id.to_string()).join(file);
    // The process's name may be no text.
    Some(String::from_utf8_lossy(&regular::read(&path, regular::SYSTEM).ok()?).into_owned())
}

/// A process's state and start time.
fn state(id: u32) -> Option<(char, u64)> {
    let stat = proc(id, "stat")?;
    // The second field is the name, which may contain anything.
    let mut fields = stat.rsplit_once(')')?.1.split_ascii_whitespace();
    let state = fields.next()?.chars().next()?;
    Some((state, fields.nth(18)?.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    #[test]
    fn threads_are_of_their_process_and_a_process_ends() {
        let own = Process::of_thread(std::process::id()).expect("it is seen");
        let thread = std::thread::spawn(|| Process::of_thread(nix::unistd::gettid().as_raw() as u32));
        assert_eq!(thread.join().expect("no panic"), Some(own));
        assert!(!own.has_ended());
        assert!(Process { start: own.start + 1, ..own }.has_ended(), "another one of that number");
        let mut child = Command::new("sleep").arg("60").spawn().expect("it runs");
        let other = Process::of_thread(child.id()).expect("it is seen");
        assert!(other != own && !other.has_ended());
        child.kill().expect("a child");
        while !other.has_ended() {
            std::thread::yield_now();
        }
        child.wait().expect("a child");
        assert!(other.has_ended());
        assert_eq!(Process::of_thread(0), None);
    }
}
