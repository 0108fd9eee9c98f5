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
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use gauge_owner::Run;
use gaugefs::fs::Access;
use nix::errno::Errno;
use ti_gauge::chip::{Chip, Effect, kebab_case};
use ti_gauge::dataflash::Limits;

use crate::drawn::is_all;
use crate::room::{Abort, Folder, Swift, can_mount};
use crate::room::{TEXT, table};

mod faults;
mod files;
mod open;
mod paths;
mod processes;
mod reads;
mod transactions;
mod users;
mod writes;

use files::{Class, Expected, OpenFile, Parameter, parameters};
use processes::trespass;
use users::{Random, Role, User};

const CHIP: &str = "bq34z100-g1";
/// Blocks that a run programs at least.
const WRITES: u64 = 10;

const SEALS: [&str; 3] = ["sealed", "unsealed", "full-access"];

struct Model {
    /// Dropped first, because nothing else ends while somebody waits for a mount that does not answer.
    abort: Option<Abort>,
    seed: u64,
    random: Random,
    users: Vec<User>,
    mount: Swift,
    files: Vec<(String, Class)>,
    parameters: Vec<Parameter>,
    controls: Vec<(&'static str, bool)>,
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
        let run = Run { limits, ..Run::default() };
        let mount = Swift::new(chip, folder, run, access, |_| ());
        let abort = Abort::of(&mount.root);
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
            ("gauge/progress", Class::Steady),
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
            abort,
            seed,
            random: Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1),
            users,
            mount,
            files,
            parameters,
            controls: answers.map(|one| (one.name, one.sealed)).collect(),
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

    /// Whether the gauge was away since a transaction was begun, which ends it.
    fn was_away(&self) -> bool {
        self.presence != self.mount.handle.published().presence
    }

    /// Whether a transaction is open that refuses other writes.
    fn keeps_writes_out(&self) -> bool {
        self.staged.is_some() && !self.was_away()
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

    /// How many blocks of flash gaugefs has programmed. The gauge itself programs some as it calibrates and learns.
    fn programmed(&self) -> u64 {
        let statistics = self.mount.handle.statistics();
        statistics.iter().find(|(name, _)| *name == "flash_writes").expect("it is counted").1
    }
}

#[test]
fn random_calls_of_several_users_answer_as_documented() {
    let number = |name: &str| std::env::var(name).ok().map(|text| text.parse().expect("a number"));
    let steps = number("GAUGEFS_MODEL").unwrap_or(if is_all() { 4000 } else { 1500 });
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
            model.abort.iter().for_each(Abort::now);
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
