// SPDX-License-Identifier: MIT

//! `gauge/`: values without a name in the kernel's ABI. The kernel caches nothing of it.
//!
//! A row of [`FILES`] is a file. A row of [`GROUPS`] is a group of files whose names come from the chip's table or
//! another list, in a folder of their own or beside the other files.

use std::fmt::Display;
use std::sync::Arc;

use jiff::Timestamp;

use super::attribute::Kind;
use super::caller::Caller;
use super::supply::Supply;
use super::{Content, Item, Mode, Node, Operations, Shape, find, not_writable};
use crate::report;
use gauge_owner::{Answers, Done, Failure, FileOperation, Operation, operations as op};
use ti_gauge::authentication;
use ti_gauge::chip::{Bit, Limited, Question, Register, Role, Source, Tier, snake_case};

mod values;

struct File {
    name: &'static str,
    mode: Mode,
    show: Show,
    /// The operation that a write to it requests.
    operation: Option<&'static dyn FileOperation>,
}

/// Text of a file; `None` while the file does not exist, and empty if it is only written.
type Show = fn(&Supply) -> Option<String>;

const fn file(name: &'static str, mode: Mode, show: Show) -> File {
    File { name, mode, show, operation: None }
}

const fn asks<A: Send>(operation: &'static Operation<A>, mode: Mode, show: Show) -> File {
    assert!(operation.has_file());
    File { operation: Some(operation), ..file(operation.name, mode, show) }
}

impl File {
    fn is_there(&self, gauge: &Supply) -> bool {
        values::is_here(self) || (self.show)(gauge).is_some()
    }
}

static FILES: &[File] = &[
    file("control_status", Mode::Public, control_status),
    file("device_type", Mode::Public, |gauge| word(identified(gauge)?.device_type)),
    file("firmware_version", Mode::Public, |gauge| word(identified(gauge)?.firmware_version)),
    file("hardware_version", Mode::Public, |gauge| word(identified(gauge)?.hardware_version)),
    file("chem_id", Mode::Public, |gauge| word(identified(gauge)?.chem_id?)),
    file("itpor", Mode::Public, itpor),
    asks(&op::SEAL, Mode::ReadWrite, |gauge| identified(gauge).and(line(gauge.published().seal.as_str()))),
    asks(&op::CONTROL, Mode::ReadWrite, answered),
    asks(&op::KEYS, Mode::OwnerWrite, |gauge| gauge.has_own_table().then(String::new)),
    asks(&op::AUTHENTICATE, Mode::ReadWrite, digest),
    file("auth_order", Mode::Public, challenge_order),
    file("check", Mode::Public, Supply::checked),
    file("owed", Mode::Public, owed),
    asks(&op::SETTLE, Mode::ReadWrite, settling),
    asks(&op::LEARNED, Mode::ReadWrite, learned),
    asks(&op::CALIBRATE, Mode::Write, |gauge| can_calibrate(gauge).then(String::new)),
    file("calibration", Mode::Read, |gauge| {
        can_calibrate(gauge).then(|| gauge.published().calibration.to_string())
    }),
    asks(&op::REPORT, Mode::ReadWrite, report),
    file("voltage_scale", Mode::Public, |gauge| scale(gauge, Kind::Voltage)),
    file("current_scale", Mode::Public, |gauge| scale(gauge, Kind::Current)),
    file("charge_scale", Mode::Public, |gauge| scale(gauge, Kind::Charge)),
    file("energy_scale", Mode::Public, |gauge| scale(gauge, Kind::Energy)),
    file("pec", Mode::Public, |gauge| gauge.handle.pec().and_then(|pec| line(pec.as_str()))),
    file("questions", Mode::Public, questions),
    file("permanent_failure", Mode::Public, permanent_failure),
    file("presence", Mode::Public, |gauge| line(gauge.published().presence.number())),
    asks(&op::POLL_INTERVAL, Mode::ReadWrite, |gauge| line(gauge.published().interval.as_secs_f64())),
    asks(&op::REFRESH, Mode::Write, |_| empty()),
    file("age_ms", Mode::Public, |gauge| gauge.fresh().and(line(gauge.handle.age()?.as_millis()))),
    file("last_error", Mode::Public, last_error),
    file("last_error_facts", Mode::Public, |gauge| {
        let published = gauge.published();
        let failed = published.failed.as_ref().map(|failed| failed.facts.to_string());
        failed.or_else(|| published.waiting()).map_or_else(empty, line)
    }),
    file("progress", Mode::Public, |gauge| line(gauge.handle.progress().as_deref().unwrap_or("idle"))),
    file(values::ALL, Mode::Public, |gauge| Some(values::text(gauge, Mode::Public))),
    file(values::OWNER, Mode::Read, |gauge| Some(values::text(gauge, Mode::Read))),
];

/// Files with a common rule and mode 0444.
struct Group {
    /// The folder; `None` for `gauge/` itself.
    folder: Option<&'static str>,
    /// Names of the present files, and a number that identifies each for the life of the mount.
    list: fn(&Supply) -> Vec<(u8, String)>,
    /// Text of a file; `None` while it does not exist.
    show: fn(&Supply, u8) -> Option<String>,
}

static GROUPS: &[Group] = &[
    Group { folder: Some("registers"), list: |gauge| registers(gauge, |_| true), show: register },
    Group { folder: Some("statistics"), list: statistics, show: statistic },
    Group { folder: None, list: |gauge| registers(gauge, |register| !register.bits.is_empty()), show: bits },
];

/// An item of `gauge/`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum GaugeItem {
    /// The folder itself.
    Folder,
    /// A row of `FILES`.
    File(u8),
    /// The folder of a row of `GROUPS`.
    Group(u8),
    /// A row of `GROUPS`, and the number of a file in it.
    Member(u8, u8),
}

/// Folders whose files change with the gauge's reports.
pub(super) fn folders() -> impl Iterator<Item = Item> {
    let groups = (0..).zip(GROUPS).filter(|(_, group)| group.folder.is_some());
    let groups = groups.map(|(at, _)| GaugeItem::Group(at));
    [GaugeItem::Folder].into_iter().chain(groups).map(Item::Gauge)
}

impl GaugeItem {
    pub(super) fn of(self, supply: &Arc<Supply>) -> Box<dyn Operations + '_> {
        let group = |at: u8| &GROUPS[usize::from(at)];
        match self {
            GaugeItem::Folder => Box::new(Folder(supply)),
            GaugeItem::File(at) => Box::new(Shown { supply, file: &FILES[usize::from(at)] }),
            GaugeItem::Group(at) => Box::new(Members { supply, at, group: group(at) }),
            GaugeItem::Member(at, number) => Box::new(Member { supply, at, group: group(at), number }),
        }
    }
}

struct Folder<'a>(&'a Supply);

impl Folder<'_> {
    fn groups(&self) -> Vec<(String, Node)> {
        let groups = (0..).zip(GROUPS);
        let list = groups.flat_map(|(at, group)| match group.folder {
            Some(name) => vec![(name.to_string(), self.0.node(Item::Gauge(GaugeItem::Group(at))))],
            None => Members { supply: self.0, at, group }.list(),
        });
        list.collect()
    }

    fn file(&self, at: u8) -> Node {
        self.0.node(Item::Gauge(GaugeItem::File(at)))
    }
}

impl Operations for Folder<'_> {
    fn parent(&self) -> Node {
        self.0.folder()
    }

    fn shape(&self) -> Shape {
        Shape::Folder
    }

    fn list(&self) -> Vec<(String, Node)> {
        let there = (0..).zip(FILES).filter(|(_, file)| file.is_there(self.0));
        let files = there.map(|(at, file)| (file.name.to_string(), self.file(at)));
        self.groups().into_iter().chain(files).collect()
    }

    /// Renders only the file that is looked up.
    fn lookup(&self, name: &str) -> Option<Node> {
        match (0..).zip(FILES).find(|(_, file)| file.name == name) {
            Some((at, file)) => file.is_there(self.0).then(|| self.file(at)),
            None => find(self.groups(), name),
        }
    }
}

struct Shown<'a> {
    supply: &'a Supply,
    file: &'static File,
}

impl Operations for Shown<'_> {
    fn parent(&self) -> Node {
        self.supply.node(Item::Gauge(GaugeItem::Folder))
    }

    fn mode(&self) -> Mode {
        self.file.mode
    }

    fn name(&self) -> Option<&'static str> {
        Some(self.file.name)
    }

    fn content(&self) -> Content {
        (self.file.show)(self.supply).into()
    }

    fn write(&self, _: Caller, data: &[u8], done: Done<()>) {
        match self.file.operation {
            Some(operation) => self.supply.ask(operation, data, done),
            None => done(Err(not_writable())),
        }
    }
}

struct Members<'a> {
    supply: &'a Supply,
    at: u8,
    group: &'static Group,
}

impl Operations for Members<'_> {
    fn parent(&self) -> Node {
        self.supply.node(Item::Gauge(GaugeItem::Folder))
    }

    fn shape(&self) -> Shape {
        Shape::Folder
    }

    fn list(&self) -> Vec<(String, Node)> {
        let node = |number| self.supply.node(Item::Gauge(GaugeItem::Member(self.at, number)));
        (self.group.list)(self.supply).into_iter().map(|(number, name)| (name, node(number))).collect()
    }
}

struct Member<'a> {
    supply: &'a Supply,
    at: u8,
    group: &'static Group,
    number: u8,
}

impl Operations for Member<'_> {
    fn parent(&self) -> Node {
        let own = self.group.folder.map(|_| GaugeItem::Group(self.at));
        self.supply.node(Item::Gauge(own.unwrap_or(GaugeItem::Folder)))
    }

    fn content(&self) -> Content {
        (self.group.show)(self.supply, self.number).into()
    }
}

fn line(text: impl Display) -> Option<String> {
    Some(format!("{text}\n"))
}

fn empty() -> Option<String> {
    Some(String::new())
}

fn word(word: u16) -> Option<String> {
    line(format_args!("0x{word:04x}"))
}

fn set_bits(bits: &[Bit], word: i64) -> Option<String> {
    let set = bits.iter().filter(|bit| word & i64::from(bit.mask) != 0).map(|bit| bit.name);
    line(set.collect::<Vec<_>>().join(" "))
}

/// The gauge's answers when it was identified; `None` before its first answer.
fn identified(gauge: &Supply) -> Option<Answers> {
    Some(gauge.published().answers).filter(|answers| *answers != Answers::default())
}

fn report(gauge: &Supply) -> Option<String> {
    let report = gauge.published().report.clone();
    Some(report.map_or_else(String::new, |report| report::text(gauge.chip(), gauge.handle.origin(), &report)))
}

fn can_authenticate(gauge: &Supply) -> bool {
    gauge.chip().authentication.is_some() && gauge.has_own_table()
}

fn can_calibrate(gauge: &Supply) -> bool {
    gauge.chip().calibration.is_some() && gauge.has_own_table()
}

fn control_status(gauge: &Supply) -> Option<String> {
    if gauge.published().limited.is_some_and(Limited::is_never_asked) {
        return None;
    }
    set_bits(gauge.chip().control_status, gauge.fresh()?.control_status.into())
}

fn itpor(gauge: &Supply) -> Option<String> {
    let chip = gauge.chip();
    let flags = gauge.fresh()?.value(chip.register(Role::Flags)?)?;
    let lost = chip.volatile.filter(|&lost| lost != 0)?;
    line(u8::from(flags & i64::from(lost) != 0))
}

/// What a gauge of TI's in a Smart Battery is asked, or would be.
fn questions(gauge: &Supply) -> Option<String> {
    let (is_agreed, asked) = gauge.handle.asked()?;
    let state = match (is_agreed, gauge.chip().asks) {
        (_, None) => {
            "not asked: name TI's gauge in the pack, such as --chip bq40z50-r2; `gaugefs chips` has all"
                .into()
        }
        (true, _) => asked.to_string(),
        (false, _) => "not asked: with --ask-the-pack these codes are sent".into(),
    };
    let rows =
        Question::all(gauge.chip()).map(|(question, name)| format!("0x{:04x} {name}\n", question.code()));
    Some(format!("{state}\n{}", rows.collect::<String>()))
}

/// A line for each reason, and an empty text without one.
fn permanent_failure(gauge: &Supply) -> Option<String> {
    let snapshot = gauge.fresh()?;
    let known = Source::Answer(Question::PF_STATUS);
    gauge.chip().register_at(known).and_then(|row| snapshot.value(row))?;
    let failures = gauge.handle.failures().into_iter();
    Some(
        failures
            .map(|failure| format!("{}: {}; check {}\n", failure.name, failure.what, failure.check))
            .collect(),
    )
}

fn scale(gauge: &Supply, kind: Kind) -> Option<String> {
    line(gauge.reading(Some(&*gauge.fresh()?)).scale(kind)?)
}

/// The last requested subcommand, and the gauge's answer.
fn answered(gauge: &Supply) -> Option<String> {
    match gauge.published().control() {
        Some((code, answer)) => line(format_args!("0x{code:04x} 0x{answer:04x}")),
        None => empty(),
    }
}

fn digest(gauge: &Supply) -> Option<String> {
    match gauge.published().digest() {
        _ if !can_authenticate(gauge) => None,
        Some((challenge, digest)) => {
            line(format_args!("{} {}", authentication::to_hex(challenge), authentication::to_hex(digest)))
        }
        None => empty(),
    }
}

fn challenge_order(gauge: &Supply) -> Option<String> {
    line(gauge.handle.challenge_order().as_str()).filter(|_| can_authenticate(gauge))
}

fn last_error(gauge: &Supply) -> Option<String> {
    let published = gauge.published();
    let owed = Some((published.owed_since, &*published.owed)).filter(|(_, owed)| !owed.is_empty());
    let shown = owed_and(owed, published.failed.as_ref().map(|failed| (failed, &*published.last_error)))?;
    let shown = match (shown.trim_end(), gauge.handle.long_progress()) {
        (_, None) => shown,
        ("", Some(progress)) => line(progress)?,
        (shown, Some(progress)) => line(format_args!("{shown}; {progress}"))?,
    };
    let amiss = published.amiss.as_ref().filter(|_| published.snapshot.is_some());
    match (shown.trim_end(), amiss) {
        (_, None) => Some(shown),
        ("", Some((since, amiss))) => line(format_args!("{since:.0}: {amiss}")),
        // After a recent failure, the time at the start matters most.
        (shown, Some((since, amiss))) => line(format_args!("{shown}; since {since:.0}: {amiss}")),
    }
}

/// Both begin with their time. What is owed comes first, so that it is not lost among less important errors.
fn owed_and(owed: Option<(Timestamp, &str)>, failed: Option<(&Failure, &str)>) -> Option<String> {
    // A failure that has left what is owed is shown as that.
    let failed = failed.filter(|(failed, _)| owed.is_none() || !failed.owed);
    let show = |(at, text)| format!("{at:.0}: {text}");
    match (owed.map(show), failed.map(|(failed, text)| show((failed.at, text)))) {
        (None, None) => empty(),
        (Some(only), None) | (None, Some(only)) => line(only),
        (Some(owed), Some(error)) => line(format_args!("{owed}; last error: {error}")),
    }
}

/// 1 while a seal is owed, or a write that is neither done nor undone.
fn owed(gauge: &Supply) -> Option<String> {
    line(u8::from(!gauge.published().owed.is_empty())).filter(|_| gauge.has_own_table())
}

/// Known facts of an interrupted write.
fn settling(gauge: &Supply) -> Option<String> {
    let published = gauge.published();
    match (published.settling.is_empty(), published.owed.is_empty()) {
        _ if !gauge.has_own_table() => None,
        (false, _) => Some(published.settling.to_string()),
        (true, false) => line(&published.owed),
        (true, true) => line("nothing to settle"),
    }
}

/// What the daemon keeps of a RAM gauge's learned values.
fn learned(gauge: &Supply) -> Option<String> {
    let published = gauge.published();
    let told = match published.learned.is_empty() {
        true => "write show, restore, restore VERSION or forget\n".to_string(),
        false => published.learned.to_string(),
    };
    Some(told).filter(|_| gauge.has_own_table() && gauge.chip().volatile.is_some())
}

/// The registers that have been read, except Control() and the block-access window.
fn registers(gauge: &Supply, wanted: impl Fn(&Register) -> bool) -> Vec<(u8, String)> {
    let Some(snapshot) = gauge.fresh() else { return Vec::new() };
    let is_there = |register: &Register| register.tier != Tier::Window && snapshot.value(register).is_some();
    let all = (0..).zip(gauge.chip().registers);
    let shown = all.filter(|(_, register)| is_there(register) && wanted(register));
    shown.map(|(at, register)| (at, snake_case(register.name))).collect()
}

fn register(gauge: &Supply, at: u8) -> Option<String> {
    line(gauge.fresh()?.value(&gauge.chip().registers[usize::from(at)])?)
}

fn bits(gauge: &Supply, at: u8) -> Option<String> {
    let register = &gauge.chip().registers[usize::from(at)];
    line(register.set(gauge.fresh()?.value(register)?).join(" "))
}

fn statistics(gauge: &Supply) -> Vec<(u8, String)> {
    (0..).zip(gauge.handle.statistics()).map(|(at, (name, _))| (at, name.to_string())).collect()
}

fn statistic(gauge: &Supply, at: u8) -> Option<String> {
    line(gauge.handle.statistics().get(usize::from(at))?.1)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use gauge_owner::Attempt;
    use ti_gauge::chip::CHIPS;

    #[test]
    fn names_are_unique_on_every_chip() {
        for chip in CHIPS {
            let words = chip.registers.iter().filter(|register| !register.bits.is_empty());
            let words = words.map(|register| snake_case(register.name));
            let fixed =
                FILES.iter().map(|file| file.name).chain(GROUPS.iter().filter_map(|group| group.folder));
            let mut names = BTreeSet::new();
            for name in fixed.map(str::to_string).chain(words) {
                assert!(names.insert(name.clone()), "{}: gauge/{name}", chip.name);
            }
        }
    }

    #[test]
    fn programs_that_read_a_mount_know_every_file_with_a_text() {
        let shown = FILES.iter().filter(|file| matches!(file.mode, Mode::Public | Mode::ReadWrite));
        let shown: Vec<_> = shown.map(|file| file.name).collect();
        assert_eq!(gaugefs_client::names::fixed_files().collect::<Vec<_>>(), shown);
    }

    #[test]
    fn last_error_shows_what_is_owed_until_it_is_paid() {
        const REFUSED: &str = "df/80/53: it is not sealed";
        let at = |second: i64| Timestamp::from_second(1_800_000_000 + second).expect("a time");
        let shown = |owed: &'static str, error: &'static str| {
            let owes = Some((at(0), owed)).filter(|_| !owed.is_empty());
            let failure =
                Failure { at: at(7), attempt: Attempt::Poll, owed: error == REFUSED, facts: "{}".into() };
            owed_and(owes, Some((&failure, error)).filter(|_| !error.is_empty())).expect("the file is there")
        };
        let owed = "a seal is owed";
        assert_eq!(shown(owed, REFUSED), format!("2027-01-15T08:00:00Z: {owed}\n"));
        let (owed_shown, nack) = ("2027-01-15T08:00:00Z: a seal is owed", "2027-01-15T08:00:07Z: NACK");
        assert_eq!(shown(owed, "NACK"), format!("{owed_shown}; last error: {nack}\n"));
        assert_eq!(shown(owed, ""), format!("{owed_shown}\n"));
        assert_eq!(shown("", "NACK"), format!("{nack}\n"));
        assert_eq!(shown("", ""), "");
    }

    #[test]
    fn a_file_can_be_written_if_its_mode_says_so() {
        for file in FILES {
            let may_be_written = match file.mode {
                Mode::Public | Mode::Read => false,
                Mode::ReadWrite | Mode::Write | Mode::OwnerWrite => true,
            };
            assert_eq!(file.operation.is_some(), may_be_written, "gauge/{}", file.name);
        }
    }
}
