// SPDX-License-Identifier: MIT

//! Random system calls by several users and processes on a mounted gauge, against a model of docs/SEMANTICS.md.
//!
//! The model knows for each call which errnos the document and the file's mode allow, and whether the call may succeed
//! at all. It keeps the value of each parameter: a successful write is read back, and a refused one leaves data flash
//! as it was. A failed run prints its seed, and GAUGEFS_MODEL_SEED=SEED repeats it; GAUGEFS_MODEL=100000 is a long run.
//! Without root there is one user only.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs;
use std::os::fd::OwnedFd;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::time::{Duration, Instant};

use gauge_bus::clock::Clock;
use gauge_owner::Settings;
use gaugefs::fs::Access;
use nix::errno::Errno;
use rustix::fs::{AtFlags, CWD, FileType, Mode, OFlags, SeekFrom, Timespec, Timestamps, XattrFlags};
use rustix::process::{Gid, Uid};
use ti_gauge::chip::{Chip, Effect, Kind, Range, kebab_case};
use ti_gauge::dataflash::Limits;
use ti_gauge::value::Type;

use crate::room::{Folder, Swift, can_mount};
use crate::room::{TEXT, table};
use crate::room::{mapped, write_cut};

const CHIP: &str = "bq34z100-g1";
/// Most files that are open at a time.
const OPEN: usize = 12;
/// Open descriptions of one file at a time, now and then.
const MANY: usize = 200;
/// Blocks that a run programs at least.
const WRITES: u64 = 10;

struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 % limit
    }

    fn one_in(&mut self, count: u64) -> bool {
        self.below(count) == 0
    }

    fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.below(from.len() as u64) as usize]
    }
}

/// Who makes a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    Root,
    Owner,
    Member,
    Stranger,
}

type Job = Box<dyn FnOnce() + Send>;

/// A thread with the user and group ids of one user, and with no capabilities unless that is root.
struct User {
    role: Role,
    ids: Option<(u32, u32)>,
    jobs: mpsc::Sender<Job>,
}

impl User {
    fn new(role: Role, ids: Option<(u32, u32)>) -> Self {
        let (jobs, queue) = mpsc::channel::<Job>();
        std::thread::spawn(move || {
            if let Some((uid, gid)) = ids {
                let (uid, gid) = (Uid::from_raw(uid), Gid::from_raw(gid));
                rustix::thread::set_thread_groups(&[gid]).expect("root may do that");
                rustix::thread::set_thread_res_gid(gid, gid, gid).expect("root may do that");
                rustix::thread::set_thread_res_uid(uid, uid, uid).expect("root may do that");
            }
            queue.into_iter().for_each(|job| job());
        });
        Self { role, ids, jobs }
    }

    /// Makes a call as this user.
    fn does<T: Send + 'static>(&self, call: impl FnOnce() -> T + Send + 'static) -> T {
        let (sender, answer) = mpsc::channel();
        self.jobs.send(Box::new(move || drop(sender.send(call())))).expect("the thread runs");
        answer.recv().expect("the call does not panic")
    }

    /// What the mode lets this user do: bits of `rwx`.
    fn may(&self, mode: u32) -> u32 {
        match self.role {
            Role::Root => 0o6 | if mode & 0o111 != 0 { 1 } else { 0 },
            Role::Owner => mode >> 6 & 7,
            Role::Member => mode >> 3 & 7,
            Role::Stranger => mode & 7,
        }
    }
}

/// What kind of file it is, as far as answers differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Class {
    Folder,
    /// A symbolic link to the first parameter.
    Link,
    /// A symbolic link to what is not in the mount.
    Outside,
    /// Public and always there.
    Steady,
    /// Public, and there while the gauge answers.
    Measured,
    /// Public, and there while the gauge predicts it.
    Fleeting,
    Parameter(usize),
    Secret,
    SecretRaw,
    Raw,
    Index,
    Transaction,
    Seal,
    Control,
    Keys,
    Authenticate,
    Settle,
    Interval,
    Refresh,
    Report,
    Knob,
    Reading,
    Missing,
}

impl Class {
    fn mode(self) -> Option<u32> {
        Some(match self {
            // The model's mount has a group.
            Class::Folder => 0o775,
            Class::Outside => 0o777,
            Class::Steady | Class::Measured | Class::Fleeting => 0o444,
            Class::Link
            | Class::Parameter(_)
            | Class::Secret
            | Class::Transaction
            | Class::Seal
            | Class::Control
            | Class::Authenticate
            | Class::Report
            | Class::Settle
            | Class::Interval
            | Class::Knob => 0o660,
            Class::Raw | Class::SecretRaw | Class::Index | Class::Reading => 0o440,
            Class::Refresh => 0o220,
            Class::Keys => 0o200,
            Class::Missing => return None,
        })
    }

    fn is_secret(self) -> bool {
        matches!(self, Class::Secret | Class::SecretRaw)
    }

    /// What is opened by its path.
    fn followed(self) -> Self {
        if self == Class::Link { Class::Parameter(0) } else { self }
    }
}

/// A parameter, and what it may hold. That is one value, unless an answer has left it open.
struct Parameter {
    place: String,
    /// What a line of `df/transaction` may name it: its place, its names below `df` and `df/by-name`, and where no other
    /// class has one of that name, its own.
    names: Vec<String>,
    name: &'static str,
    /// Smallest and largest value; `None` for a text of that many characters.
    range: Result<(i64, i64), usize>,
    values: BTreeSet<String>,
    /// Every value that it has had, which a file that is held open may still show.
    history: BTreeSet<String>,
}

/// What a text is to a parameter.
enum Verdict {
    /// A value, which reads like this.
    Value(String),
    Refused(Errno),
}

struct OpenFile {
    fd: Arc<OwnedFd>,
    class: Class,
    flags: OFlags,
    /// The gauge was disturbed while it was open.
    disturbed: bool,
}

/// What a call may answer.
#[derive(Default, Debug)]
struct Expected {
    may: Vec<Errno>,
    fails: bool,
}

impl Expected {
    fn success() -> Self {
        Self::default()
    }

    /// Fails with one of these.
    fn failure(may: &[Errno]) -> Self {
        Self { may: may.to_vec(), fails: true }
    }

    fn or_if(mut self, refused: bool, errno: Errno) -> Self {
        if refused {
            self.may.push(errno);
            self.fails = true;
        }
        self
    }

    fn perhaps(mut self, errnos: &[Errno]) -> Self {
        self.may.extend(errnos);
        self
    }
}

struct Model {
    seed: u64,
    random: Random,
    users: Vec<User>,
    mount: Swift,
    files: Vec<(String, Class)>,
    parameters: Vec<Parameter>,
    controls: Vec<&'static str>,
    open: Vec<OpenFile>,
    /// The gauge may fail just now.
    disturbed: bool,
    /// Flash cannot be programmed.
    low: bool,
    seal: BTreeSet<&'static str>,
    staged: Option<BTreeMap<usize, String>>,
    /// Why a line of `df/transaction` was refused, since when nothing is committed.
    spoiled: Option<Errno>,
    /// That of the gauge when this was last certain. When it has risen, the gauge was away, which ends a transaction.
    presence: ti_gauge::epoch::Epoch<gauge_owner::Presence>,
    documented: Vec<Errno>,
    counts: BTreeMap<(String, String), u64>,
    /// Calls of other processes, and how many of these were killed.
    processes: (u64, u64),
    recent: Vec<String>,
}

fn of_io(errno: rustix::io::Errno) -> Errno {
    Errno::from_raw(errno.raw_os_error())
}

impl Model {
    fn new(seed: u64) -> Option<Self> {
        if !can_mount() {
            return None;
        }
        let folder = Folder::new();
        let is_root = nix::unistd::geteuid().is_root();
        let access = match is_root {
            true => Access { uid: 2001, gid: 2002, group: true },
            false => {
                let (uid, gid) = (nix::unistd::geteuid().as_raw(), nix::unistd::getegid().as_raw());
                Access { uid, gid, group: true }
            }
        };
        let users = if is_root {
            vec![
                User::new(Role::Root, None),
                User::new(Role::Owner, Some((2001, 2001))),
                User::new(Role::Member, Some((2003, 2002))),
                User::new(Role::Stranger, Some((2004, 2004))),
            ]
        } else {
            eprintln!("SKIPPED in part: only root can act for other users; one user makes all calls");
            vec![User::new(Role::Owner, None)]
        };
        let chip = Chip::by_name(CHIP).expect("a chip of the tables");
        // IT_ENABLE, which anybody may write to `gauge/control`, begins a learning cycle.
        let limits = Limits { writes_per_hour: 0, allow_learning: true };
        let settings = Settings { limits, ..Settings::default() };
        let mount = Swift::new(chip, folder, settings, access, |_| ());
        let parameters = parameters(chip);
        let fixed = [
            ("", Class::Folder),
            ("df", Class::Folder),
            ("df/80", Class::Folder),
            ("df/by-name", Class::Folder),
            ("gauge", Class::Folder),
            ("gauge/registers", Class::Folder),
            ("sim", Class::Folder),
            ("subsystem", Class::Outside),
            ("type", Class::Steady),
            ("uevent", Class::Steady),
            ("present", Class::Steady),
            ("model_name", Class::Steady),
            ("gauge/last_error", Class::Steady),
            ("gauge/last_error_facts", Class::Steady),
            ("gauge/presence", Class::Steady),
            ("gauge/statistics/polls", Class::Steady),
            ("voltage_now", Class::Measured),
            ("capacity", Class::Measured),
            ("status", Class::Measured),
            ("gauge/age_ms", Class::Measured),
            ("gauge/flags", Class::Measured),
            ("gauge/registers/voltage", Class::Measured),
            ("time_to_full_now", Class::Fleeting),
            ("df/112/0", Class::Secret),
            ("df/112/raw", Class::SecretRaw),
            ("df/80/raw", Class::Raw),
            ("df/index", Class::Index),
            ("df/transaction", Class::Transaction),
            ("gauge/seal", Class::Seal),
            ("gauge/control", Class::Control),
            ("gauge/keys", Class::Keys),
            ("gauge/authenticate", Class::Authenticate),
            ("gauge/settle", Class::Settle),
            ("gauge/poll_interval", Class::Interval),
            ("gauge/refresh", Class::Refresh),
            ("gauge/report", Class::Report),
            ("sim/load_ma", Class::Knob),
            ("sim/transfers", Class::Reading),
            ("nothing", Class::Missing),
            ("df/80/9999", Class::Missing),
            ("gauge/nothing", Class::Missing),
        ];
        let mut files: Vec<_> = fixed.map(|(path, class)| (path.to_string(), class)).to_vec();
        let first = &parameters[0];
        files.push((format!("df/by-name/it-cfg/{}", kebab_case(first.name)), Class::Link));
        files.extend(
            (0..).zip(&parameters).map(|(at, one)| (format!("df/{}", one.place), Class::Parameter(at))),
        );
        let answers =
            chip.subcommands.iter().filter(|one| matches!(one.effect, Effect::Answers | Effect::Safe));
        let documented = table(TEXT, "## Errnos");
        let documented = documented.iter().flat_map(|row| row[0].split(", "));
        let all: BTreeMap<String, Errno> =
            (1..200).map(Errno::from_raw).map(|errno| (format!("{errno:?}"), errno)).collect();
        let mut model = Self {
            seed,
            random: Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1),
            users,
            mount,
            files,
            parameters,
            controls: answers.map(|one| one.name).collect(),
            open: Vec::new(),
            disturbed: false,
            low: false,
            seal: ["sealed"].into(),
            staged: None,
            presence: ti_gauge::epoch::Epoch::default(),
            spoiled: None,
            documented: documented.map(|name| all[name]).collect(),
            counts: BTreeMap::new(),
            processes: (0, 0),
            recent: Vec::new(),
        };
        for at in 0..model.parameters.len() {
            let value = model.shown(&format!("df/{}", model.parameters[at].place)).expect("a value");
            model.parameters[at].values = [value.clone()].into();
            model.parameters[at].history = [value].into();
        }
        Some(model)
    }

    fn path(&self, name: &str) -> PathBuf {
        if name.is_empty() { self.mount.root.clone() } else { self.mount.root.join(name) }
    }

    /// The whole text of a file, read by the one who may.
    fn shown(&self, name: &str) -> Result<String, Errno> {
        let path = self.path(name);
        let text = self.users[0].does(move || fs::read_to_string(path));
        let text = text.map_err(|error| Errno::from_raw(error.raw_os_error().unwrap_or_default()))?;
        Ok(text.trim_end_matches('\n').to_string())
    }

    #[track_caller]
    fn fail(&self, what: &str) -> ! {
        let mut text = format!("{what}\nGAUGEFS_MODEL_SEED={}, after:\n", self.seed);
        for line in self.recent.iter().rev().take(25).rev() {
            let _ = writeln!(text, "  {line}");
        }
        panic!("{text}gauge/last_error: {:?}", self.shown("gauge/last_error"));
    }

    /// Compares an answer with what was expected, and counts it.
    #[track_caller]
    fn check<T>(
        &mut self,
        call: &str,
        what: &str,
        answer: Result<T, Errno>,
        expected: Expected,
    ) -> Option<T> {
        let outcome = answer.as_ref().map_or_else(|errno| format!("{errno:?}"), |_| "success".into());
        *self.counts.entry((call.into(), outcome.clone())).or_default() += 1;
        self.recent.push(format!("{call} {what}: {outcome}"));
        match answer {
            Ok(_) if expected.fails => {
                self.fail(&format!("{call} {what} succeeded; expected: {:?}", expected.may))
            }
            Ok(done) => Some(done),
            Err(errno) if expected.may.contains(&errno) => None,
            Err(errno) => self.fail(&format!("{call} {what}: {errno:?}; expected: {expected:?}")),
        }
    }

    /// The errnos of a gauge that fails.
    fn failures(&self) -> Vec<Errno> {
        if self.disturbed { self.documented.clone() } else { Vec::new() }
    }

    /// Whether a file is there: `None` if that is not certain.
    fn exists(&self, class: Class) -> Option<bool> {
        match class {
            Class::Missing => Some(false),
            Class::Fleeting => None,
            Class::Measured | Class::Seal | Class::Keys | Class::Settle if self.disturbed => None,
            _ => Some(true),
        }
    }

    /// What a call on a path may answer that needs the file to be there.
    fn there(&self, class: Class) -> Expected {
        match self.exists(class) {
            Some(true) => Expected::success(),
            Some(false) => Expected::failure(&[Errno::ENOENT]),
            None => Expected::success().perhaps(&[Errno::ENOENT]),
        }
    }

    fn step(&mut self) {
        let user = self.random.below(self.users.len() as u64) as usize;
        let file = self.random.below(self.files.len() as u64) as usize;
        let (name, class) = self.files[file].clone();
        match self.random.below(104) {
            100 | 101 => self.sends(user),
            102 => self.opens_many(user, &name, class),
            103 => self.starts_processes(),
            0..20 => self.open_one(user, &name, class),
            20..36 => self.read_one(user),
            36..52 => self.write_one(user),
            52..62 => self.echo(user),
            62..70 => self.stage(user),
            70..95 => self.call(user, &name, class),
            95..=98 => self.on_open_file(user),
            99 if self.random.one_in(3) => self.disturb(),
            99 if self.random.one_in(4) => {
                self.low = !self.low;
                self.recent.push(format!("low: {}", self.low));
                self.mount.sim.set("voltage_mv", if self.low { "2700" } else { "auto" }).expect("a knob");
            }
            _ => drop((self.random.below(self.open.len().max(1) as u64), self.open.pop())),
        }
    }

    fn open_one(&mut self, user: usize, name: &str, class: Class) {
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

    fn opens(&mut self, user: usize, name: &str, class: Class, flags: OFlags) -> Option<usize> {
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
        self.open.push(OpenFile { fd: Arc::new(fd), class: target, flags, disturbed: self.disturbed });
        Some(self.open.len() - 1)
    }

    /// One of the open files, most often the last one.
    fn held(&mut self) -> Option<usize> {
        let count = self.open.len() as u64;
        match count {
            0 => None,
            _ if self.random.one_in(2) => Some(count as usize - 1),
            _ => Some(self.random.below(count) as usize),
        }
    }

    fn read_one(&mut self, user: usize) {
        let Some(at) = self.held() else { return };
        let offset = self.random.pick(&[0, 0, 0, 1, 3, 4095, 4096, 1 << 40]);
        let length = self.random.pick(&[1, 64, 4096, 70_000]);
        self.reads(user, at, offset, length, false);
    }

    fn reads(&mut self, user: usize, at: usize, offset: u64, length: usize, is_fresh: bool) {
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
    fn is_plausible(&self, class: Class, offset: usize, length: usize, bytes: &[u8], is_fresh: bool) {
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
            Class::Transaction if is_fresh && self.presence != self.mount.handle.published().presence => true,
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

    /// A text for a parameter.
    fn value(&mut self, at: usize) -> (String, Verdict) {
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
    fn text(&mut self, class: Class) -> (String, Expected) {
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
                _ => (random.pick(&self.controls).into(), Expected::success()),
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

    fn write_one(&mut self, user: usize) {
        let Some(at) = self.held() else { return };
        self.writes(user, at);
    }

    fn writes(&mut self, user: usize, at: usize) -> Option<usize> {
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
        self.written("write", &what, class, &text, answer.map_err(of_io), expected);
        Some(at)
    }

    /// A write whose buffer is not all there: the kernel passes on what there is, or nothing.
    fn writes_cut(&mut self, user: usize, at: usize, text: String, expected: Expected) -> Option<usize> {
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
            && (length > there || !is_value || self.staged.is_some())
        {
            self.fail(&format!("{length} bytes were written, {there} are there"));
        }
        self.outcome(&[(parameter, new)], outcome);
        Some(at)
    }

    /// sendfile(2), which splices: from an open file into a pipe, or from a file of this machine into an open one.
    fn sends(&mut self, user: usize) {
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
                let length = bytes.len();
                self.is_plausible(class, 0, length, &bytes, false);
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
        self.written("sendfile to", &what, class, &text, answer.map_err(of_io), expected);
    }

    /// One file open many times, each read, in one order and closed in another.
    fn opens_many(&mut self, user: usize, name: &str, class: Class) {
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

    /// Several processes that write and read parameters at the same time, one of which may be killed. What is stored
    /// then is what one of those that were told of success has written, or one that was told nothing.
    fn starts_processes(&mut self) {
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
                    if !self.parameters[*at].history.contains(text.trim_end()) {
                        self.fail(&format!("another process reads {text:?}"));
                    }
                }
                Some(_) if output.status.success() && (!may || self.staged.is_some()) => {
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

    /// The consequences of a write.
    fn written(
        &mut self,
        call: &str,
        what: &str,
        class: Class,
        text: &str,
        answer: Result<usize, Errno>,
        expected: Expected,
    ) {
        let expected = expected.perhaps(&self.failures());
        let outcome = answer.map(drop);
        let length = answer.unwrap_or(text.len());
        let is_done = self.check(call, what, answer, expected).is_some();
        if is_done && length != text.len() {
            self.fail(&format!("{length} of {} bytes were written", text.len()));
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
    fn canonical(&self, at: usize, text: &str) -> String {
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
    fn outcome(&mut self, changes: &[(usize, String)], outcome: Result<(), Errno>) {
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

    /// A parameter shows one of the values that it may have.
    fn reads_back(&mut self, at: usize) {
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

    /// `cat` or `echo` of one file: what a shell does.
    fn echo(&mut self, user: usize) {
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

    /// How many blocks of flash gaugefs has programmed. The gauge itself programs some as it calibrates and learns.
    fn programmed(&self) -> u64 {
        let statistics = self.mount.handle.statistics();
        statistics.iter().find(|(name, _)| *name == "flash_writes").expect("it is counted").1
    }

    /// Lines for `df/transaction`.
    fn stage(&mut self, user: usize) {
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
        }
        if !self.disturbed && self.random.one_in(2) {
            self.opens(0, "df/transaction", Class::Transaction, OFlags::RDONLY)
                .into_iter()
                .for_each(|at| self.reads(0, at, 0, 70_000, true));
        }
    }

    /// Calls that take a path.
    fn call(&mut self, user: usize, name: &str, class: Class) {
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

    /// Calls that take an open file.
    fn on_open_file(&mut self, user: usize) {
        let Some(at) = self.held() else { return };
        let OpenFile { class, flags, disturbed, .. } = self.open[at];
        let fd = self.open[at].fd.clone();
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
                self.check("fstat", &what, answer, Expected::success());
            }
            2 => {
                let wanted = self.random.pick(&[SeekFrom::End(0), SeekFrom::Current(-5), SeekFrom::Start(0)]);
                // For the end the kernel asks for the size, which fails as a read would.
                let refused: &[_] = if class.is_secret() { &[Errno::EPERM] } else { &[] };
                let expected = Expected::success().perhaps(&[Errno::EINVAL]).perhaps(refused);
                let expected = expected.perhaps(&self.failures());
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
                if self.disturbed || disturbed || class == Class::Fleeting {
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

    /// Something goes wrong on the bus or in the gauge, or everything is well again.
    fn disturb(&mut self) {
        if self.disturbed {
            return self.heal();
        }
        let number = 1 + self.random.below(40);
        let fault = self.random.pick(&[
            "nack N",
            "nack N 1",
            "eio N",
            "etimedout N",
            "flip N 2 3",
            "flip N 20 1",
            "short N",
            "lost N",
            "stuck N",
            "arbitration N",
            "stretch N 5000",
            "silence N 3000",
            "drop-commit",
            "corrupt-commit",
            "drop-seal",
            "drop-reset",
            "random 30",
            "random 300",
            "off",
        ]);
        let fault = fault.replace('N', &number.to_string());
        self.recent.push(format!("fault: {fault}"));
        self.disturbed = true;
        self.open.iter_mut().for_each(|open| open.disturbed = true);
        let knob = if fault == "off" { ("power", "off") } else { ("fault", fault.as_str()) };
        self.mount.sim.set(knob.0, knob.1).expect("a knob");
    }

    /// Afterwards each parameter has a value that the answers allow.
    fn heal(&mut self) {
        self.mount.sim.set("fault", "none").expect("a knob");
        self.mount.sim.set("power", "on").expect("a knob");
        self.mount.sim.set("voltage_mv", "auto").expect("a knob");
        (self.low, self.staged, self.spoiled) = (false, None, None);
        let root = self.mount.root.clone();
        for attempt in 0.. {
            self.mount.clock.sleep(Duration::from_secs(2));
            let at = root.clone();
            let _ = self.users[0].does(move || fs::write(at.join("df/transaction"), "abort\n"));
            let at = root.clone();
            let refreshed = self.users[0].does(move || fs::write(at.join("gauge/refresh"), "1\n"));
            let owes = self.shown("gauge/last_error").is_ok_and(|text| text.contains("OWED"));
            let reads = self.shown(&format!("df/{}", self.parameters[0].place));
            // The key of a gauge that was found open has to be used once before data flash may be written.
            let tried = ["sealed", "unsealed", "sealed"].iter().try_for_each(|seal| {
                let at = root.clone();
                self.users[0].does(move || fs::write(at.join("gauge/seal"), seal))
            });
            let shows = ["voltage_now", "gauge/age_ms"].iter().all(|name| self.path(name).exists());
            if refreshed.is_ok() && !owes && reads.is_ok() && tried.is_ok() && shows {
                self.seal = ["sealed"].into();
                break;
            }
            if attempt == 300 {
                self.fail(&format!("the gauge does not recover: {refreshed:?}, {reads:?}, owes: {owes}"));
            }
        }
        self.recent.push("healed".into());
        self.disturbed = false;
        for at in 0..self.parameters.len() {
            self.reads_back(at);
        }
    }
}

const SEALS: [&str; 3] = ["sealed", "unsealed", "full-access"];

/// Parameters without special rules: any value of their range can be written at any time.
fn parameters(chip: &'static Chip) -> Vec<Parameter> {
    let rows = chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security);
    let rows = rows.flat_map(|subclass| subclass.parameters.iter().map(move |row| (subclass, row)));
    let plain = rows.filter(|(_, row)| !row.learned && !row.unproven && row.safe.is_none());
    let mut found: Vec<_> = plain
        .filter(|(subclass, row)| [80, 48, 32, 49].contains(&subclass.id) && row.bits.is_empty())
        .filter_map(|(subclass, row)| {
            let range = match (&row.range, row.kind) {
                (Range::Int { min, max, .. }, Type::I(_) | Type::U(_)) => Ok((*min, *max)),
                (Range::Text { .. }, Type::S(size)) => Err(usize::from(size) - 1),
                _ => return None,
            };
            let place = format!("{}/{}", subclass.id, row.offset);
            let own = kebab_case(row.name);
            let all = chip.subclasses.iter().flat_map(|subclass| subclass.parameters);
            let is_only = all.filter(|other| kebab_case(other.name) == own).count() == 1;
            let whole = format!("{}/{own}", chip.class_dir(subclass));
            let mut names = vec![place.clone(), format!("by-name/{whole}"), whole.to_uppercase(), whole];
            names.extend(is_only.then_some(own));
            Some(Parameter {
                place,
                names,
                name: row.name,
                range,
                values: BTreeSet::new(),
                history: BTreeSet::new(),
            })
        })
        .collect();
    // The link leads to the first one.
    let first = found.iter().position(|one| one.place == "80/53").expect("the bq34z100-G1 has it");
    found.swap(0, first);
    found.truncate(14);
    found
}

/// Reads and opens as somebody who has no rights, at the same time.
fn trespass(root: &Path, user: &User, over: &AtomicBool) -> u64 {
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

#[test]
fn random_calls_of_several_users_answer_as_documented() {
    let number = |name: &str| std::env::var(name).ok().map(|text| text.parse().expect("a number"));
    let steps = number("GAUGEFS_MODEL").unwrap_or(4000);
    let mut any = [0; 8];
    getrandom::fill(&mut any).expect("random bytes");
    let seed = number("GAUGEFS_MODEL_SEED").unwrap_or(u64::from_ne_bytes(any) >> 16);
    let Some(mut model) = Model::new(seed) else { return };
    let start = Instant::now();
    let stranger = (model.users.len() > 1).then(|| User::new(Role::Stranger, Some((2005, 2005))));
    let over = AtomicBool::new(false);
    let root = model.mount.root.clone();
    let refused = std::thread::scope(|scope| {
        let trespasser = stranger.as_ref().map(|stranger| scope.spawn(|| trespass(&root, stranger, &over)));
        // The scope waits for the trespasser, whose loop has to end after a panic too.
        let ran = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            // Few of the drawn calls are writes that are allowed, so a run ends when some were.
            for taken in 0.. {
                if taken >= steps && (model.programmed() > WRITES || taken >= 4 * steps) {
                    break;
                }
                model.step();
            }
            model.heal();
        }));
        over.store(true, Ordering::SeqCst);
        if let Err(panic) = ran {
            std::panic::resume_unwind(panic);
        }
        trespasser.map(|trespasser| trespasser.join().expect("nothing was allowed"))
    });
    let (others, killed) = model.processes;
    let calls = model.counts.values().sum::<u64>() + others;
    let mut report = format!("seed {seed}: {steps} steps in {:?}; ", start.elapsed());
    let _ = write!(report, "{calls} calls, {others} of them by other processes, {killed} killed; ");
    let _ = writeln!(report, "{refused:?} calls of another user refused meanwhile");
    for ((call, outcome), count) in &model.counts {
        let _ = writeln!(report, "{count:8} {call} {outcome}");
    }
    println!("{report}");
    let section = TEXT.split_once("\n## Errnos\n").expect("the section is there").1;
    let words: BTreeSet<_> = section.split(|letter: char| !letter.is_ascii_uppercase()).collect();
    for (call, outcome) in model.counts.keys() {
        assert!(
            outcome == "success" || words.contains(&**outcome),
            "{call} answers {outcome}: not documented"
        );
    }
    model.open.clear();
    assert!(model.programmed() > WRITES, "{report}");
}
