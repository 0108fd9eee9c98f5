// SPDX-License-Identifier: MIT

//! `gaugefs events`: sends the udev events of a mount, because to the kernel a FUSE mount is no device.
//!
//! It is a program apart from the daemon, and has no privilege. It uses only files of the mount, and only the names of
//! supplies get from there into a message.

use std::collections::BTreeMap;
use std::io;
use std::os::fd::{AsRawFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use clap::Args;
use nix::errno::Errno;
use nix::sys::socket::{
    AddressFamily, MsgFlags, NetlinkAddr, SockFlag, SockProtocol, SockType, connect, send, socket,
};
use nix::time::{ClockId, clock_gettime};
use nix::unistd::geteuid;

use gaugefs_client::condition::Texts;
use gaugefs_client::follow::{self, Calling};
use gaugefs_client::supplies::{self, Look};
use gaugefs_host::error::{Error, Result, shown};
use gaugefs_host::output::say;
use gaugefs_host::signals;
use message::{Action, message};

mod message;

const EVENTS: &str = "\
UPower, and other programs that use libudev, look for power supplies on sysfs only, and hear of them
from udev. For a tree that is mounted over /sys/class/power_supply this command sends them the
messages that udev would send: `add` for each supply of the mount, `change` within a second when
status, capacity, capacity_level, present, health or online is another one, and `remove` when the
mount has ended, its daemon does not answer, or this command ends. `change` is repeated every 10 s,
for programs that have been started since.

It needs user 0 with the capability CAP_NET_ADMIN, in the network namespace of those programs.
The rules of udev do not run on these messages: see `gaugefs watch` for programs of your own.

Examples:
  systemctl enable --now gaugefs-events.service     beside gaugefs.service
  gaugefs events";

/// Root of device paths.
const SYS: &str = "/sys";
/// Shortest time between two messages about a supply, unless the second one removes it. A change right after a message
/// is so still told within a second.
const PACE: Duration = Duration::from_millis(500);
/// A supply without news is told again after this time, for listeners that started since. UPower takes `change` for
/// `add` if it does not know the supply; about a second `add` it would complain.
const REPEAT: Duration = Duration::from_secs(10);
/// Attributes whose changes are told.
const NEWS: [&str; 6] = ["status", "capacity", "capacity_level", "present", "health", "online"];

/// Send udev events for mounted gauges, so that UPower updates at once
#[derive(Args, Debug)]
#[command(after_help = EVENTS)]
pub struct Events {
    /// The mount point, below /sys
    #[arg(default_value = "/sys/class/power_supply")]
    mountpoint: PathBuf,
}

impl Events {
    pub(super) fn run(self) -> Result<ExitCode> {
        let listeners = Listeners::open(&self.mountpoint)?;
        let (sender, events) = mpsc::channel();
        // Before another thread exists that could get the signal.
        await_end(sender.clone())?;
        let calling = supplies::to_channel(self.mountpoint.clone(), sender).map_err(Error::from)?;
        let (mountpoint, told, trouble) = (self.mountpoint, Announced::default(), String::new());
        Telling { mountpoint, calling, listeners, told, trouble }.run(&events)
    }
}

enum Event {
    Look(Look),
    /// A signal that ends the process.
    End,
}

impl From<Look> for Event {
    fn from(look: Look) -> Self {
        Self::Look(look)
    }
}

fn await_end(sender: Sender<Event>) -> Result<()> {
    let ends = signals::block()?;
    let wait = move || {
        // It cannot fail: the set is valid.
        let _ = ends.wait();
        let _ = sender.send(Event::End);
    };
    let thread = std::thread::Builder::new().stack_size(256 * 1024).spawn(wait);
    thread.map(drop).map_err(|error| Error::io("", "cannot start a thread", &error))
}

/// The socket to the listeners.
struct Listeners {
    socket: OwnedFd,
    /// The mount point's path below `/sys`.
    folder: String,
    /// Messages sent.
    count: u64,
}

impl Listeners {
    fn open(mountpoint: &Path) -> Result<Self> {
        let name = shown(mountpoint);
        let path = std::path::absolute(mountpoint).unwrap_or_else(|_| mountpoint.to_path_buf());
        let Some(folder) = path.strip_prefix(SYS).ok().and_then(Path::to_str) else {
            let why = "UPower finds supplies only below /sys; mount over /sys/class/power_supply";
            return Err(Error::host(name, Errno::EINVAL, why));
        };
        const NEEDS: &str = "needs root with CAP_NET_ADMIN, which listeners of udev demand of who sends to them; \
                             run it with sudo, or as the service gaugefs-events";
        if !geteuid().is_root() {
            return Err(Error::host("events", Errno::EPERM, NEEDS));
        }
        let kind = SockProtocol::NetlinkKObjectUEvent;
        let socket = socket(AddressFamily::Netlink, SockType::Raw, SockFlag::SOCK_CLOEXEC, kind);
        let socket = socket.map_err(|errno| Error::io("netlink", "no socket", &errno.into()))?;
        match connect(socket.as_raw_fd(), &NetlinkAddr::new(0, message::GROUP)) {
            Ok(()) => Ok(Self { socket, folder: format!("/{folder}"), count: 0 }),
            Err(Errno::EPERM) => Err(Error::host("events", Errno::EPERM, NEEDS)),
            Err(errno) => Err(Error::io("netlink", "cannot be connected", &errno.into())),
        }
    }

    fn tell(&mut self, action: Action, name: &str) -> Result<()> {
        self.count += 1;
        let path = format!("{}/{name}", self.folder);
        let uptime = clock_gettime(ClockId::CLOCK_MONOTONIC).map(Duration::from).unwrap_or_default();
        let message = message(action, &path, name, self.count, uptime);
        match send(self.socket.as_raw_fd(), &message, MsgFlags::empty()) {
            // Nobody listens.
            Ok(_) | Err(Errno::ECONNREFUSED) => Ok(()),
            Err(errno) => Err(Error::io("netlink", "a message was not sent", &io::Error::from(errno))),
        }
    }
}

/// The mount, and what its listeners know.
struct Telling {
    mountpoint: PathBuf,
    calling: Calling,
    listeners: Listeners,
    told: Announced,
    /// The reason for having no supplies that was printed last.
    trouble: String,
}

impl Telling {
    fn run(mut self, events: &mpsc::Receiver<Event>) -> Result<ExitCode> {
        loop {
            let now = Instant::now();
            self.tell(now)?;
            let wake = self.told.next().map_or(PACE, |next| next.saturating_duration_since(now).min(PACE));
            match events.recv_timeout(wake) {
                Ok(Event::Look(look)) => self.take(look.supplies),
                Ok(Event::End) => break,
                Err(RecvTimeoutError::Timeout) if self.calling.is_silent() => {
                    self.take(Err(follow::SILENT.into()));
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => unreachable!("a thread waits for a signal"),
            }
        }
        self.told.see(&BTreeMap::new());
        self.tell(Instant::now())?;
        Ok(ExitCode::SUCCESS)
    }

    fn take(&mut self, supplies: Result<BTreeMap<String, Texts>, String>) {
        match supplies {
            Ok(supplies) => {
                self.trouble.clear();
                self.told.see(&supplies);
            }
            Err(why) => {
                self.told.see(&BTreeMap::new());
                if self.trouble != why {
                    say(format_args!("{}: {why}; waiting", shown(&self.mountpoint)));
                    self.trouble = why;
                }
            }
        }
    }

    fn tell(&mut self, now: Instant) -> Result<()> {
        for (action, name) in self.told.due(now) {
            self.listeners.tell(action, &name)?;
        }
        Ok(())
    }
}

/// The attributes of [`NEWS`].
type State = [Option<String>; NEWS.len()];

/// A supply that was told, or is to be told.
#[derive(Default)]
struct Supply {
    /// `None` while it is gone.
    seen: Option<State>,
    /// What listeners know; `None` for a removed supply.
    told: Option<State>,
    /// The time of the last message.
    at: Option<Instant>,
}

impl Supply {
    /// The next message, and its time; at once without a time.
    fn next(&self) -> Option<(Action, Option<Instant>)> {
        let after = |pause| self.at.map(|at| at + pause);
        match (&self.seen, &self.told) {
            (None, None) => None,
            (None, Some(_)) => Some((Action::Remove, None)),
            (Some(_), None) => Some((Action::Add, after(PACE))),
            (Some(seen), Some(told)) if seen != told => Some((Action::Change, after(PACE))),
            (Some(_), Some(_)) => Some((Action::Change, after(REPEAT))),
        }
    }
}

#[derive(Default)]
struct Announced {
    supplies: BTreeMap<String, Supply>,
}

impl Announced {
    /// Takes a look at the mount.
    fn see(&mut self, supplies: &BTreeMap<String, Texts>) {
        for supply in self.supplies.values_mut() {
            supply.seen = None;
        }
        for (name, texts) in supplies.iter().filter(|(name, _)| is_plain(name)) {
            let state = NEWS.map(|attribute| texts.get(attribute).cloned());
            self.supplies.entry(name.clone()).or_default().seen = Some(state);
        }
    }

    /// The messages that are due; they count as sent.
    fn due(&mut self, now: Instant) -> Vec<(Action, String)> {
        let mut messages = Vec::new();
        self.supplies.retain(|name, supply| {
            match supply.next() {
                Some((action, at)) if at.is_none_or(|at| at <= now) => {
                    messages.push((action, name.clone()));
                    supply.told.clone_from(&supply.seen);
                    supply.at = Some(now);
                }
                _ => {}
            }
            // A supply that has just gone may come back, but not before it may be told.
            supply.seen.is_some() || supply.at.is_some_and(|at| now < at + PACE)
        });
        messages
    }

    /// The time of the next message, as far as known.
    fn next(&self) -> Option<Instant> {
        self.supplies.values().filter_map(|supply| supply.next()?.1).min()
    }
}

/// Whether a name is safe as a part of a path in a message: the daemon has chosen it.
fn is_plain(name: &str) -> bool {
    name.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"._+-".contains(&byte))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mount(supplies: &[(&str, &[(&str, &str)])]) -> BTreeMap<String, Texts> {
        let texts = |texts: &[(&str, &str)]| {
            texts.iter().map(|(name, text)| (name.to_string(), text.to_string())).collect()
        };
        supplies.iter().map(|(name, of)| (name.to_string(), texts(of))).collect()
    }

    /// Looks at a battery in these states, and shows the messages: `add`, `change` and `remove` as `+`, `~` and `-`,
    /// with their times in milliseconds.
    fn told(looks: &[(u64, Option<&str>)], end: u64) -> String {
        let (start, mut told, mut lines) = (Instant::now(), Announced::default(), Vec::new());
        for ms in 0..=end {
            let now = start + Duration::from_millis(ms);
            if let Some((_, status)) = looks.iter().find(|(at, _)| *at == ms) {
                let of: Vec<_> = status.map(|status| ("status", status)).into_iter().collect();
                let supplies: &[(&str, &[(&str, &str)])] = &[("BAT0", &of)];
                told.see(&mount(if status.is_some() { supplies } else { &[] }));
            }
            lines.extend(told.due(now).into_iter().map(|(action, _)| match action {
                Action::Add => format!("+{ms}"),
                Action::Change => format!("~{ms}"),
                Action::Remove => format!("-{ms}"),
            }));
            assert!(told.next().is_none_or(|next| next > now), "{ms}");
        }
        lines.join(" ")
    }

    #[test]
    fn changes_are_told_twice_a_second_at_most_and_the_last_state_always() {
        assert_eq!(told(&[(0, Some("a")), (1500, Some("b"))], 5000), "+0 ~1500");
        assert_eq!(told(&[(0, Some("a")), (1500, Some("b")), (1600, Some("c"))], 5000), "+0 ~1500 ~2000");
        // Back before it was told.
        assert_eq!(told(&[(0, Some("a")), (300, Some("b")), (400, Some("a"))], 5000), "+0");
        let many: Vec<_> = (0..40).map(|step| (step * 100, Some(["a", "b"][step as usize % 2]))).collect();
        assert_eq!(told(&many, 9000), "+0 ~500 ~1000 ~1500 ~2000 ~2500 ~3000 ~3500");
        assert_eq!(told(&[(0, Some("a"))], 25000), "+0 ~10000 ~20000");
    }

    #[test]
    fn regression_what_changed_right_after_a_message_was_told_later_than_a_second() {
        // `change` is repeated after 10 s. A look sees news within half a second.
        for since in [1, 50, 250, 499] {
            let at = 10_000 + since;
            assert_eq!(told(&[(0, Some("a")), (at, Some("b"))], 11_000), "+0 ~10000 ~10500", "{since}");
        }
    }

    #[test]
    fn what_is_gone_is_told_at_once_and_what_comes_back_half_a_second_later() {
        assert_eq!(told(&[(0, Some("a")), (200, None), (400, Some("a"))], 3000), "+0 -200 +700");
        assert_eq!(told(&[(0, Some("a")), (200, None), (400, Some("a")), (600, None)], 3000), "+0 -200");
        assert_eq!(told(&[(0, None)], 3000), "");
    }

    #[test]
    fn voltage_is_no_news_and_a_name_that_is_no_plain_word_is_never_told() {
        let (now, mut told) = (Instant::now(), Announced::default());
        let one = |volts| {
            mount(&[("BAT0", &[("voltage_now", volts)]), ("..\n/x", &[]), ("AC", &[("online", "1")])])
        };
        told.see(&one("3"));
        let names = |told: &mut Announced, ms| told.due(now + Duration::from_millis(ms));
        assert_eq!(names(&mut told, 0), [(Action::Add, "AC".into()), (Action::Add, "BAT0".into())]);
        told.see(&one("4"));
        assert_eq!(names(&mut told, 5000), []);
    }
}
