//! The tree: names, modes, contents, reads and writes, with no FUSE in it.
//!
//! A [`Node`] names one file, folder or link for ever; what it holds is asked for anew each time. Nothing
//! here blocks or touches a bus: what needs the gauge goes to its owner with a `Done`.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use nix::errno::Errno;

use crate::authentication;
use crate::chip::{
    Bit, Chip, Effect, FLAT, Kind, Parameter, Range, Register, Role, Subclass, Tier, kebab_case, snake_case,
};
use crate::codec;
use crate::dataflash::Change;
use crate::error::{Cause, Error, Result};
use crate::keys;
use crate::poll::{Answers, Done, Handle, Published, Request, Seal, Snapshot};
use crate::text;

mod attribute;
mod covered;
mod mains;
mod raw;
mod transaction;

pub use attribute::Attribute;
use attribute::Source;
pub use covered::Covered;
pub use mains::MainsItem;
use transaction::Transaction;

/// What a data-flash file shows as its size before it has been read: as sysfs does.
const UNREAD: u64 = 4096;
/// What `df/transaction` holds while none is open.
const IDLE: &[u8] = b"idle\n";
/// Whoever follows `subsystem` finds the folder that a mount stands for.
const SUPPLIES: &str = "/sys/class/power_supply";

/// The files of `sim/`, behind which stands a simulated gauge.
pub trait Knobs: Send + Sync {
    /// Names, and whether each may be written.
    fn list(&self) -> Vec<(&'static str, bool)>;
    /// Its text.
    fn get(&self, name: &str) -> Option<String>;
    /// Changes it.
    fn set(&self, name: &str, text: &str) -> Result<()>;
}

/// How figures are shown.
#[derive(Clone, Debug)]
pub struct Scales {
    /// Factor of currents and charges.
    pub current: f64,
    /// Factor of voltages.
    pub voltage: f64,
    /// Factor of energies and powers.
    pub energy: f64,
    /// Currents without their sign.
    pub absolute_current: bool,
    /// Show `energy_now` and `power_avg`.
    pub energy_shown: bool,
}

impl Default for Scales {
    fn default() -> Self {
        Self { current: 1.0, voltage: 1.0, energy: 1.0, absolute_current: false, energy_shown: false }
    }
}

/// One folder below the mount point.
pub struct Entry {
    /// Its name, such as `BAT0`.
    pub name: String,
    /// The gauge.
    pub handle: Handle,
    /// How its figures are shown.
    pub scales: Scales,
    /// The files of `sim/`, for a simulated gauge.
    pub knobs: Option<Box<dyn Knobs>>,
}

/// Who may write, and read data flash.
#[derive(Clone, Copy, Debug)]
pub struct Access {
    /// The mount's owner.
    pub uid: u32,
    /// The group of all files.
    pub gid: u32,
    /// Whether the group may do what the owner may.
    pub group: bool,
}

/// The tree.
pub struct Fs {
    gauges: Vec<Entry>,
    /// One for each gauge.
    transactions: Vec<Transaction>,
    access: Access,
    /// Name of the Mains supply's folder.
    mains: Option<String>,
    covered: Option<Covered>,
}

/// One file, folder or link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Node {
    /// The mount point.
    Root,
    /// Something of the gauge of that index.
    Of(u16, Item),
    /// Something of the Mains supply.
    Mains(MainsItem),
    /// The link of that number, shown through from the folder underneath.
    Covered(u32),
}

/// What a gauge's folder holds. Numbers are indices into its chip's table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Item {
    /// The gauge's folder.
    Folder,
    /// A power_supply attribute.
    Attribute(Attribute),
    /// `uevent`.
    Uevent,
    /// `subsystem`.
    Subsystem,
    /// `df`.
    Df,
    /// `df/SUBCLASS`.
    Subclass(u16),
    /// `df/flash`.
    Flat,
    /// A parameter: subclass, and index in it.
    Parameter(u16, u16),
    /// `df/SUBCLASS/raw`.
    Raw(u16),
    /// `df/by-name`.
    ByName,
    /// `df/by-name/CLASS`.
    ByNameClass(u16),
    /// `df/by-name/CLASS/PARAM`.
    ByNameLink(u16, u16),
    /// `df/index`.
    Index,
    /// `df/transaction`.
    Transaction,
    /// `gauge`.
    Gauge,
    /// `gauge/registers`.
    Registers,
    /// `gauge/registers/NAME`.
    Register(u16),
    /// `gauge/flags` and other words of bits.
    Bits(u16),
    /// `gauge/statistics`.
    Statistics,
    /// `gauge/statistics/NAME`.
    Statistic(u16),
    /// Any other file of `gauge`.
    State(State),
    /// `sim`.
    Sim,
    /// `sim/NAME`.
    Knob(u16),
}

/// The files of `gauge/` that stand alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum State {
    /// Names of the CONTROL_STATUS bits that are set.
    ControlStatus,
    /// Control(DEVICE_TYPE).
    DeviceType,
    /// Control(FW_VERSION).
    FirmwareVersion,
    /// Control(HW_VERSION).
    HardwareVersion,
    /// Control(CHEM_ID).
    ChemId,
    /// 1 when a gauge whose data memory is RAM has lost it with its power.
    Itpor,
    /// The seal state, to read and to go to.
    Seal,
    /// A subcommand to send.
    Control,
    /// A key to change.
    Keys,
    /// A challenge to write, and the gauge's answer to it.
    Authenticate,
    /// The order of bytes in which challenges are sent.
    AuthOrder,
    /// Seconds between polls.
    PollInterval,
    /// Written: poll now.
    Refresh,
    /// Age of the values now shown.
    AgeMs,
    /// The last failure.
    LastError,
}

const STATES: &[State] = &[
    State::ControlStatus,
    State::DeviceType,
    State::FirmwareVersion,
    State::HardwareVersion,
    State::ChemId,
    State::Itpor,
    State::Seal,
    State::Control,
    State::Keys,
    State::Authenticate,
    State::AuthOrder,
    State::PollInterval,
    State::Refresh,
    State::AgeMs,
    State::LastError,
];

impl State {
    fn name(self) -> &'static str {
        match self {
            State::ControlStatus => "control_status",
            State::DeviceType => "device_type",
            State::FirmwareVersion => "firmware_version",
            State::HardwareVersion => "hardware_version",
            State::ChemId => "chem_id",
            State::Itpor => "itpor",
            State::Seal => "seal",
            State::Control => "control",
            State::Keys => "keys",
            State::Authenticate => "authenticate",
            State::AuthOrder => "auth_order",
            State::PollInterval => "poll_interval",
            State::Refresh => "refresh",
            State::AgeMs => "age_ms",
            State::LastError => "last_error",
        }
    }
}

/// What kind of node it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// A folder.
    Folder,
    /// A symbolic link.
    Link,
    /// A regular file.
    File,
}

/// What a file holds now.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Content {
    /// These bytes.
    Bytes(Vec<u8>),
    /// The gauge has to be asked ([`Fs::read`]); until then it shows this size, which is no smaller than
    /// what will come.
    Unread(u64),
    /// Nothing: the value is not there, and neither is the file.
    Absent,
}

impl Fs {
    /// A tree of these gauges.
    pub fn new(gauges: Vec<Entry>, access: Access) -> Self {
        let transactions = gauges.iter().map(|_| Transaction::default()).collect();
        Self { gauges, transactions, access, mains: None, covered: None }
    }

    /// The same tree with a folder of that name, which tells whether the mains feed the packs.
    #[must_use]
    pub fn with_mains(self, name: Option<String>) -> Self {
        Self { mains: name, ..self }
    }

    /// The same tree, beside what the folder that it covers holds.
    #[must_use]
    pub fn over(self, covered: Option<Covered>) -> Self {
        Self { covered, ..self }
    }

    /// Whether names come and go without a poll, so that no listing of the root may be kept.
    pub fn is_over(&self) -> bool {
        self.covered.is_some()
    }

    fn entry(&self, gauge: u16) -> &Entry {
        &self.gauges[usize::from(gauge)]
    }

    /// The folder that holds a node; the root holds itself.
    pub fn parent(&self, node: Node) -> Node {
        let (gauge, item) = match node {
            Node::Root | Node::Covered(_) | Node::Mains(MainsItem::Folder) => return Node::Root,
            Node::Mains(_) => return Node::Mains(MainsItem::Folder),
            Node::Of(gauge, item) => (gauge, item),
        };
        Node::Of(
            gauge,
            match item {
                Item::Folder => return Node::Root,
                Item::Attribute(_) | Item::Uevent | Item::Subsystem | Item::Df | Item::Gauge | Item::Sim => {
                    Item::Folder
                }
                Item::Subclass(_) | Item::Flat | Item::ByName | Item::Index | Item::Transaction => Item::Df,
                Item::Parameter(subclass, _) | Item::Raw(subclass) => self.parameter_folder(gauge, subclass),
                Item::ByNameClass(_) => Item::ByName,
                Item::ByNameLink(subclass, _) => Item::ByNameClass(subclass),
                Item::Registers | Item::Bits(_) | Item::Statistics | Item::State(_) => Item::Gauge,
                Item::Register(_) => Item::Registers,
                Item::Statistic(_) => Item::Statistics,
                Item::Knob(_) => Item::Sim,
            },
        )
    }

    fn parameter_folder(&self, gauge: u16, subclass: u16) -> Item {
        if self.subclass(gauge, subclass).id == FLAT { Item::Flat } else { Item::Subclass(subclass) }
    }

    fn chip(&self, gauge: u16) -> &'static Chip {
        self.entry(gauge).handle.chip()
    }

    fn subclass(&self, gauge: u16, subclass: u16) -> &'static Subclass {
        &self.chip(gauge).subclasses[usize::from(subclass)]
    }

    fn row(&self, gauge: u16, subclass: u16, parameter: u16) -> (&'static Subclass, &'static Parameter) {
        let subclass = self.subclass(gauge, subclass);
        (subclass, &subclass.parameters[usize::from(parameter)])
    }

    /// Folder, link or file.
    pub fn shape(&self, node: Node) -> Shape {
        let item = match node {
            Node::Root | Node::Mains(MainsItem::Folder) => return Shape::Folder,
            Node::Covered(_) | Node::Mains(MainsItem::Subsystem) => return Shape::Link,
            Node::Mains(_) => return Shape::File,
            Node::Of(_, item) => item,
        };
        match item {
            Item::Folder
            | Item::Df
            | Item::Subclass(_)
            | Item::Flat
            | Item::ByName
            | Item::ByNameClass(_)
            | Item::Gauge
            | Item::Registers
            | Item::Statistics
            | Item::Sim => Shape::Folder,
            Item::Subsystem | Item::ByNameLink(..) => Shape::Link,
            Item::Attribute(_)
            | Item::Uevent
            | Item::Parameter(..)
            | Item::Raw(_)
            | Item::Index
            | Item::Transaction
            | Item::Register(_)
            | Item::Bits(_)
            | Item::Statistic(_)
            | Item::State(_)
            | Item::Knob(_) => Shape::File,
        }
    }

    /// Owner and group of every node.
    pub fn owner(&self) -> (u32, u32) {
        (self.access.uid, self.access.gid)
    }

    /// Permissions. Attributes are for all; data flash and what can be written are for the mount's owner,
    /// and its group where one was named.
    pub fn mode(&self, node: Node) -> u16 {
        let kept = |bits: u16| if self.access.group { bits * 0o110 } else { bits * 0o100 };
        let (gauge, item) = match node {
            Node::Root | Node::Mains(MainsItem::Folder) => return 0o555,
            Node::Covered(_) | Node::Mains(MainsItem::Subsystem) => return 0o777,
            Node::Mains(_) => return 0o444,
            Node::Of(gauge, item) => (gauge, item),
        };
        match item {
            Item::Parameter(subclass, parameter) => {
                let unproven = self.row(gauge, subclass, parameter).1.unproven;
                kept(if unproven && !self.entry(gauge).handle.allows_unproven() { 4 } else { 6 })
            }
            Item::Raw(_) | Item::Index => kept(4),
            Item::Transaction | Item::State(State::Seal | State::Authenticate | State::PollInterval) => {
                kept(6)
            }
            Item::State(State::Control | State::Refresh) => kept(2),
            // A group that may write values may not shut the owner out.
            Item::State(State::Keys) => 0o200,
            Item::Knob(knob) => {
                let writable =
                    self.knobs(gauge).get(usize::from(knob)).is_some_and(|(_, writable)| *writable);
                if writable { kept(6) } else { kept(4) }
            }
            _ => match self.shape(node) {
                Shape::Folder => 0o555,
                Shape::Link => 0o777,
                Shape::File => 0o444,
            },
        }
    }

    fn knobs(&self, gauge: u16) -> Vec<(&'static str, bool)> {
        self.entry(gauge).knobs.as_ref().map(|knobs| knobs.list()).unwrap_or_default()
    }

    /// Whether the kernel may keep the name and the text until told otherwise: only attributes, which
    /// change with a poll and at no other time.
    pub fn may_be_cached(&self, node: Node) -> bool {
        match node {
            Node::Root | Node::Mains(_) => true,
            Node::Covered(_) => false,
            Node::Of(_, item) => {
                matches!(item, Item::Attribute(_) | Item::Uevent) || self.shape(node) != Shape::File
            }
        }
    }

    /// Whether anybody may write a file.
    pub fn may_be_written(&self, node: Node) -> bool {
        self.shape(node) == Shape::File && self.mode(node) & 0o200 != 0
    }

    /// What a folder holds now.
    pub fn list(&self, folder: Node) -> Vec<(String, Node)> {
        let (gauge, item) = match folder {
            Node::Root => return self.list_root(),
            Node::Mains(MainsItem::Folder) => return self.list_mains(),
            Node::Mains(_) | Node::Covered(_) => return Vec::new(),
            Node::Of(gauge, item) => (gauge, item),
        };
        let chip = self.chip(gauge);
        let of = |name: &str, item: Item| (name.to_string(), Node::Of(gauge, item));
        let subclasses = || (0u16..).zip(chip.subclasses);
        let parameters = |at: u16| (0u16..).zip(chip.subclasses[usize::from(at)].parameters);
        match item {
            Item::Folder => {
                let snapshot = self.fresh(gauge);
                let source = self.source(gauge, snapshot.as_deref());
                let there = |attribute: &&Attribute| attribute.text(&source).is_some();
                let attributes = attribute::ALL.iter().filter(there);
                let mut list: Vec<_> =
                    attributes.map(|attribute| of(attribute.name(), Item::Attribute(*attribute))).collect();
                list.push(of("uevent", Item::Uevent));
                list.push(of("subsystem", Item::Subsystem));
                if self.published(gauge).sibling.is_none() {
                    list.push(of("df", Item::Df));
                }
                list.push(of("gauge", Item::Gauge));
                if self.entry(gauge).knobs.is_some() {
                    list.push(of("sim", Item::Sim));
                }
                list
            }
            Item::Df => {
                let mut list = vec![
                    of("index", Item::Index),
                    of("transaction", Item::Transaction),
                    of("by-name", Item::ByName),
                ];
                if chip.subclasses.iter().any(|subclass| subclass.id == FLAT) {
                    list.push(of("flash", Item::Flat));
                }
                let numbered = subclasses().filter(|(_, subclass)| subclass.id != FLAT);
                list.extend(numbered.map(|(at, subclass)| of(&subclass.id.to_string(), Item::Subclass(at))));
                list
            }
            Item::Subclass(at) => {
                let mut list: Vec<_> = parameters(at)
                    .map(|(row, parameter)| of(&parameter.offset.to_string(), Item::Parameter(at, row)))
                    .collect();
                list.push(of("raw", Item::Raw(at)));
                list
            }
            Item::Flat => subclasses()
                .filter(|(_, subclass)| subclass.id == FLAT)
                .flat_map(|(at, _)| parameters(at).map(move |(row, parameter)| (at, row, parameter)))
                .map(|(at, row, parameter)| {
                    of(&format!("0x{:04x}", parameter.offset), Item::Parameter(at, row))
                })
                .collect(),
            Item::ByName => subclasses()
                .map(|(at, subclass)| of(&chip.class_dir(subclass), Item::ByNameClass(at)))
                .collect(),
            Item::ByNameClass(at) => parameters(at)
                .map(|(row, parameter)| of(&kebab_case(parameter.name), Item::ByNameLink(at, row)))
                .collect(),
            Item::Gauge => {
                let mut list = vec![of("registers", Item::Registers), of("statistics", Item::Statistics)];
                let snapshot = self.fresh(gauge);
                let words =
                    known(chip, snapshot.as_deref()).filter(|(_, register)| !register.bits.is_empty());
                list.extend(words.map(|(at, register)| of(&snake_case(register.name), Item::Bits(at))));
                let published = self.published(gauge);
                let there = |state: &&State| match state {
                    // Of a gauge that has not answered yet nobody knows.
                    State::DeviceType | State::FirmwareVersion | State::HardwareVersion | State::Seal => {
                        published.answers != Answers::default()
                    }
                    State::ChemId => published.answers.chem_id.is_some(),
                    State::Itpor => chip.volatile.is_some() && snapshot.is_some(),
                    State::ControlStatus | State::AgeMs => snapshot.is_some(),
                    State::Authenticate | State::AuthOrder => {
                        chip.authentication.is_some() && published.sibling.is_none()
                    }
                    State::Keys => published.sibling.is_none(),
                    _ => true,
                };
                list.extend(STATES.iter().filter(there).map(|state| of(state.name(), Item::State(*state))));
                list
            }
            Item::Registers => {
                let snapshot = self.fresh(gauge);
                let there = known(chip, snapshot.as_deref());
                there.map(|(at, register)| of(&snake_case(register.name), Item::Register(at))).collect()
            }
            Item::Statistics => {
                let statistics = self.entry(gauge).handle.statistics();
                (0..).zip(statistics).map(|(at, (name, _))| of(name, Item::Statistic(at))).collect()
            }
            Item::Sim => {
                (0..).zip(self.knobs(gauge)).map(|(at, (name, _))| of(name, Item::Knob(at))).collect()
            }
            _ => Vec::new(),
        }
    }

    /// Gauges first: where the kernel has a supply of the same name, the gauge is what is found.
    fn list_root(&self) -> Vec<(String, Node)> {
        let mut list = self.own();
        let Some(covered) = &self.covered else { return list };
        let taken: BTreeSet<String> = list.iter().map(|(name, _)| name.clone()).collect();
        let (hidden, shown): (BTreeSet<_>, BTreeSet<_>) =
            covered.names().into_iter().partition(|name| taken.contains(name));
        covered.hides(hidden);
        list.extend(shown.into_iter().map(|name| (name.clone(), Node::Covered(covered.number(&name)))));
        list
    }

    /// What the root holds of the mount's own.
    fn own(&self) -> Vec<(String, Node)> {
        let gauges = (0..).zip(&self.gauges);
        let gauges = gauges.map(|(at, entry)| (entry.name.clone(), Node::Of(at, Item::Folder)));
        gauges.chain(self.mains.clone().map(|name| (name, Node::Mains(MainsItem::Folder)))).collect()
    }

    fn list_mains(&self) -> Vec<(String, Node)> {
        let there = |item: &MainsItem| *item != MainsItem::Online || self.online().is_some();
        let files = mains::FILES.into_iter().filter(there);
        files.map(|item| (item.name().to_string(), Node::Mains(item))).collect()
    }

    /// Whether the mains feed the packs, as far as the gauges tell. One without a pack does not, nor one of
    /// a primary cell, which nothing feeds.
    fn online(&self) -> Option<bool> {
        let told = (0..self.gauges.len() as u16).filter(|gauge| !self.chip(*gauge).condition.primary);
        let told = told.filter_map(|gauge| {
            let snapshot = self.fresh(gauge)?;
            let source = self.source(gauge, Some(&snapshot));
            let present = Attribute::Present.text(&source).is_some_and(|present| present == "1");
            Attribute::Status.text(&source).filter(|_| present)
        });
        mains::online(&told.collect::<Vec<_>>())
    }

    /// The node of that name in a folder.
    pub fn lookup(&self, folder: Node, name: &str) -> Option<Node> {
        let list = if folder == Node::Root { self.own() } else { self.list(folder) };
        let found = list.into_iter().find(|(found, _)| found == name).map(|(_, node)| node);
        found.or_else(|| {
            let covered = self.covered.as_ref().filter(|_| folder == Node::Root)?;
            covered.target(name).map(|_| Node::Covered(covered.number(name)))
        })
    }

    /// The gauges of which something may have changed since this was last asked.
    pub fn take_changed(&self) -> Vec<u16> {
        let changed = (0..).zip(&self.gauges).filter(|(_, entry)| entry.handle.take_changed());
        changed.map(|(gauge, _)| gauge).collect()
    }

    /// Has whoever waits for the signal look at a node's gauge; at any, where it is of none.
    pub fn raise(&self, node: Node) {
        let gauge = if let Node::Of(gauge, _) = node { gauge } else { 0 };
        self.entry(gauge).handle.raise();
    }

    /// The folders whose names come and go with the values of some gauges.
    pub fn changing_folders(&self, gauges: &[u16]) -> Vec<Node> {
        let items = [Item::Folder, Item::Gauge, Item::Registers];
        let folders = gauges.iter().flat_map(|&gauge| items.map(|item| Node::Of(gauge, item)));
        let mains = self.mains.is_some().then_some(Node::Mains(MainsItem::Folder));
        let common = mains.into_iter().chain(self.is_over().then_some(Node::Root));
        folders.chain(common.filter(|_| !gauges.is_empty())).collect()
    }

    /// The name of a file in its folder, whether it is there now or not.
    pub fn file_name(&self, node: Node) -> Option<String> {
        match node {
            Node::Of(_, Item::Attribute(attribute)) => Some(attribute.name().to_string()),
            Node::Mains(MainsItem::Online) => Some(MainsItem::Online.name().to_string()),
            _ => self
                .list(self.parent(node))
                .into_iter()
                .find(|(_, found)| *found == node)
                .map(|(name, _)| name),
        }
    }

    fn published(&self, gauge: u16) -> Arc<Published> {
        self.entry(gauge).handle.published()
    }

    /// The Snapshot that may be shown: none older than three poll intervals.
    fn fresh(&self, gauge: u16) -> Option<Arc<Snapshot>> {
        let published = self.published(gauge);
        let age = self.entry(gauge).handle.age()?;
        published.snapshot.clone().filter(|_| age <= published.interval * 3)
    }

    fn source<'a>(&'a self, gauge: u16, snapshot: Option<&'a Snapshot>) -> Source<'a> {
        let chip = self.chip(gauge);
        let model = self.published(gauge).sibling.map_or(chip.model, |sibling| sibling.name);
        Source { chip, model, snapshot, scales: &self.entry(gauge).scales }
    }

    /// What a file holds now.
    pub fn content(&self, node: Node) -> Content {
        let (gauge, item) = match node {
            Node::Root | Node::Covered(_) => return Content::Absent,
            Node::Mains(item) => {
                return mains::content(item, self.mains.as_deref().unwrap_or_default(), self.online());
            }
            Node::Of(gauge, item) => (gauge, item),
        };
        let entry = self.entry(gauge);
        let line = |text: Option<String>| match text {
            Some(text) => Content::Bytes((text + "\n").into_bytes()),
            None => Content::Absent,
        };
        match item {
            Item::Attribute(attribute) => {
                let snapshot = self.fresh(gauge);
                line(attribute.text(&self.source(gauge, snapshot.as_deref())))
            }
            Item::Uevent => {
                let snapshot = self.fresh(gauge);
                Content::Bytes(
                    attribute::uevent(&entry.name, &self.source(gauge, snapshot.as_deref())).into_bytes(),
                )
            }
            Item::Parameter(subclass, parameter) => match entry.handle.kept(subclass.into()) {
                Some(bytes) => Content::Bytes(self.parameter_text(gauge, subclass, parameter, &bytes)),
                None => Content::Unread(UNREAD),
            },
            Item::Raw(subclass) => match entry.handle.kept(subclass.into()) {
                Some(bytes) => Content::Bytes(bytes.to_vec()),
                None => Content::Unread(self.subclass(gauge, subclass).stored().into()),
            },
            Item::Index => {
                let rows = entry.handle.chip().subclasses.iter().map(|subclass| subclass.parameters.len());
                Content::Unread(256 * (1 + rows.sum::<usize>() as u64))
            }
            Item::Transaction => {
                match self.staged(gauge) {
                    None => Content::Bytes(entry.handle.progress().map_or(IDLE.to_vec(), |(done, all)| {
                        format!("committing {done}/{all}\n").into_bytes()
                    })),
                    Some(staged) if self.unread(gauge, &staged).is_empty() => {
                        Content::Bytes(self.difference(gauge, &staged))
                    }
                    Some(staged) => Content::Unread(UNREAD + 256 * staged.len() as u64),
                }
            }
            Item::Register(at) => {
                let register = &entry.handle.chip().registers[usize::from(at)];
                line(
                    self.fresh(gauge)
                        .and_then(|snapshot| snapshot.value(register))
                        .map(|value| value.to_string()),
                )
            }
            Item::Bits(at) => {
                let register = &entry.handle.chip().registers[usize::from(at)];
                let word = self.fresh(gauge).and_then(|snapshot| snapshot.value(register));
                line(word.map(|word| set_bits(register.bits, word)))
            }
            Item::Statistic(at) => {
                line(entry.handle.statistics().get(usize::from(at)).map(|(_, value)| value.to_string()))
            }
            Item::State(state) => self.state(gauge, state),
            Item::Knob(at) => {
                let knobs = entry.knobs.as_ref();
                line(knobs.and_then(|knobs| knobs.get(knobs.list().get(usize::from(at))?.0)))
            }
            _ => Content::Absent,
        }
    }

    fn state(&self, gauge: u16, state: State) -> Content {
        let published = self.published(gauge);
        let word = |word: u16| Some(format!("0x{word:04x}"));
        let text = match state {
            State::ControlStatus => self
                .fresh(gauge)
                .map(|snapshot| set_bits(self.chip(gauge).control_status, snapshot.control_status.into())),
            State::DeviceType => word(published.answers.device_type),
            State::FirmwareVersion => word(published.answers.firmware_version),
            State::HardwareVersion => word(published.answers.hardware_version),
            State::ChemId => published.answers.chem_id.and_then(word),
            State::Itpor => {
                let lost = i64::from(self.chip(gauge).volatile.unwrap_or_default());
                let flags = self.chip(gauge).register(Role::Flags);
                let word = self.fresh(gauge).zip(flags).and_then(|(snapshot, flags)| snapshot.value(flags));
                word.map(|word| u8::from(word & lost != 0).to_string())
            }
            State::Seal => Some(published.seal.as_str().to_string()),
            State::Authenticate => match &published.digest {
                Some(digest) => Some(authentication::to_hex(digest)),
                None => return Content::Bytes(Vec::new()),
            },
            State::AuthOrder => Some(self.entry(gauge).handle.auth_order().as_str().to_string()),
            State::PollInterval => Some(published.interval.as_secs_f64().to_string()),
            State::AgeMs => self.entry(gauge).handle.age().map(|age| age.as_millis().to_string()),
            State::LastError if published.last_error.is_empty() => return Content::Bytes(Vec::new()),
            State::LastError => Some(published.last_error.to_string()),
            State::Control | State::Keys | State::Refresh => return Content::Bytes(Vec::new()),
        };
        match text {
            Some(text) => Content::Bytes((text + "\n").into_bytes()),
            None => Content::Absent,
        }
    }

    fn parameter_text(&self, gauge: u16, subclass: u16, parameter: u16, bytes: &[u8]) -> Vec<u8> {
        let (subclass, parameter) = self.row(gauge, subclass, parameter);
        (value_text(subclass, parameter, bytes) + "\n").into_bytes()
    }

    /// Asks the gauge for what [`Content::Unread`] stands for. `done` gets the bytes, perhaps at once,
    /// perhaps from the owner's thread.
    pub fn read(self: &Arc<Self>, node: Node, done: Done<Vec<u8>>) {
        let Node::Of(gauge, item) = node else { return done(Err(not_there())) };
        let fs = Arc::clone(self);
        let handle = &self.entry(gauge).handle;
        match item {
            Item::Parameter(subclass, _) | Item::Raw(subclass)
                if self.subclass(gauge, subclass).kind == Kind::Security =>
            {
                let why = "keys are never read";
                done(Err(Error::new(self.subclass(gauge, subclass).name, Cause::NotPermitted(why.into()))));
            }
            Item::Parameter(subclass, parameter) => handle.submit(Request::Read(
                vec![subclass.into()],
                Box::new(move |read| {
                    done(read.map(|read| fs.parameter_text(gauge, subclass, parameter, &read[0])));
                }),
            )),
            Item::Raw(subclass) => handle.submit(Request::Read(
                vec![subclass.into()],
                Box::new(move |read| done(read.map(|read| read[0].to_vec()))),
            )),
            Item::Index => {
                let rows = handle.chip().subclasses.iter().enumerate();
                let readable = rows.filter(|(_, row)| row.kind != Kind::Security).map(|(at, _)| at);
                handle.submit(Request::Read(
                    readable.collect(),
                    Box::new(move |read| match read {
                        // A sealed gauge still has its table; only the values are missing.
                        Err(error) if error.errno() != Errno::EPERM => done(Err(error)),
                        _ => done(Ok(fs.index(gauge))),
                    }),
                ));
            }
            Item::Transaction => {
                let Some(staged) = self.staged(gauge) else { return done(Ok(IDLE.to_vec())) };
                let unread = self.unread(gauge, &staged);
                handle.submit(Request::Read(
                    unread,
                    Box::new(move |read| match read {
                        // A sealed gauge still has its staged changes; only the old values are missing.
                        Err(error) if error.errno() != Errno::EPERM => done(Err(error)),
                        _ => done(Ok(fs.difference(gauge, &staged))),
                    }),
                ));
            }
            _ => match self.content(node) {
                Content::Bytes(bytes) => done(Ok(bytes)),
                Content::Unread(_) | Content::Absent => done(Err(not_there())),
            },
        }
    }

    fn staged(&self, gauge: u16) -> Option<Vec<Change>> {
        self.transactions[usize::from(gauge)].staged(self.entry(gauge).handle.now())
    }

    /// The subclasses that staged changes are in and that would have to be read first.
    fn unread(&self, gauge: u16, staged: &[Change]) -> Vec<usize> {
        let handle = &self.entry(gauge).handle;
        let touched = |subclass: &Subclass| staged.iter().any(|one| std::ptr::eq(one.subclass, subclass));
        let rows = handle.chip().subclasses.iter().enumerate();
        rows.filter(|(at, row)| touched(row) && handle.kept(*at).is_none()).map(|(at, _)| at).collect()
    }

    /// `df/transaction`: what is staged, a line each.
    fn difference(&self, gauge: u16, staged: &[Change]) -> Vec<u8> {
        let mut lines = String::new();
        for run in staged.chunk_by(raw::follows) {
            let Change { subclass, parameter, bytes, .. } = &run[0];
            let at = self.chip(gauge).subclasses.iter().position(|row| std::ptr::eq(row, *subclass));
            let kept = at.and_then(|at| self.entry(gauge).handle.kept(at));
            lines += &if raw::is_raw(&run[0]) {
                let (id, offset) = (subclass.id, usize::from(parameter.offset));
                let old = kept.map_or("-".into(), |kept| text::hex(&kept[offset..offset + run.len()]));
                let new: Vec<u8> = run.iter().map(|change| change.bytes[0]).collect();
                format!("raw {id}/{offset}: {old} -> {}\n", text::hex(&new))
            } else {
                let old = kept.map_or("-".into(), |kept| value_text(subclass, parameter, &kept));
                let new = text::render(parameter.kind, &codec::decode(parameter.kind, bytes));
                format!("{}: {old} -> {new}\n", parameter.name)
            };
        }
        lines.into_bytes()
    }

    /// `df/index`: every parameter of the table, a line each.
    fn index(&self, gauge: u16) -> Vec<u8> {
        let chip = self.chip(gauge);
        let mut lines = String::from("subclass\toffset\ttype\tname\tunit\tmin\tmax\tdefault\tflags\tvalue\n");
        for (at, subclass) in chip.subclasses.iter().enumerate() {
            let bytes =
                if subclass.kind == Kind::Security { None } else { self.entry(gauge).handle.kept(at) };
            for parameter in subclass.parameters {
                let (id, offset) = match subclass.id {
                    FLAT => ("flash".to_string(), format!("0x{:04x}", parameter.offset)),
                    id => (id.to_string(), parameter.offset.to_string()),
                };
                let [min, max, default] =
                    bounds(subclass, parameter).map(|bound| bound.unwrap_or("-".into()));
                let value = bytes.as_ref().map_or("-".into(), |bytes| value_text(subclass, parameter, bytes));
                let unit = if parameter.unit.is_empty() { "-" } else { parameter.unit };
                let (kind, name, flags) = (parameter.kind, parameter.name, flags(subclass, parameter));
                lines += &format!(
                    "{id}\t{offset}\t{kind}\t{name}\t{unit}\t{min}\t{max}\t{default}\t{flags}\t{value}\n"
                );
            }
        }
        lines.into_bytes()
    }

    /// Whether a file is written as a stream, from wherever the last write ended; elsewhere each write is
    /// a whole value.
    pub fn is_stream(&self, node: Node) -> bool {
        matches!(node, Node::Of(_, Item::Transaction))
    }

    /// Writes one value to a file. `done` gets the outcome, perhaps at once, perhaps from the owner's
    /// thread.
    pub fn write(&self, node: Node, data: &[u8], done: Done<()>) {
        let Node::Of(gauge, item) = node else { return done(Err(not_writable())) };
        let handle = &self.entry(gauge).handle;
        let word = || std::str::from_utf8(data).unwrap_or_default().trim();
        match item {
            Item::Parameter(subclass, parameter) => {
                let (row, field) = self.row(gauge, subclass, parameter);
                if self.staged(gauge).is_some() {
                    return self.refuse(gauge, transaction::busy().within(field.name), done);
                }
                let value = transaction::check(row, field, handle.allows_unproven(), data);
                let change = value.and_then(|value| {
                    let misfit = || Cause::Invalid(format!("does not fit type {}", field.kind));
                    let bytes =
                        codec::encode(field.kind, &value).ok_or_else(|| Error::new(field.name, misfit()))?;
                    Ok(Change { subclass: row, parameter: field, bytes, saved: false })
                });
                match change {
                    Ok(change) => handle.submit(Request::WriteAll(vec![change], done)),
                    Err(error) => self.refuse(gauge, error, done),
                }
            }
            Item::Transaction => {
                let transaction = &self.transactions[usize::from(gauge)];
                let taken = transaction.write(handle.chip(), handle.allows_unproven(), handle.now(), data);
                match taken {
                    Ok(None) => done(Ok(())),
                    Ok(Some(changes)) => handle.submit(Request::WriteAll(changes, done)),
                    Err(error) => self.refuse(gauge, error, done),
                }
            }
            Item::State(State::Seal) => match [Seal::Sealed, Seal::Unsealed, Seal::FullAccess]
                .into_iter()
                .find(|seal| seal.as_str() == word())
            {
                Some(seal) => handle.submit(Request::Seal(seal, done)),
                None => {
                    let why = "write sealed, unsealed or full-access";
                    self.refuse(gauge, Error::new("seal", Cause::Invalid(why.into())), done);
                }
            },
            Item::State(State::Control) => match subcommand(handle.chip(), word()) {
                Ok(code) => handle.submit(Request::Control(code, done)),
                Err(error) => self.refuse(gauge, error, done),
            },
            // Blanks take the place of a key in the buffers that a write passes through.
            Item::State(State::Keys) if data.trim_ascii().is_empty() => done(Ok(())),
            Item::State(State::Keys) => match keys::Change::parse(data) {
                Ok(change) => handle.submit(Request::ChangeKey(change, done)),
                Err(error) => self.refuse(gauge, error, done),
            },
            Item::State(State::Authenticate) => match authentication::from_hex(data) {
                Ok(challenge) => handle.submit(Request::Authenticate(challenge, done)),
                Err(error) => self.refuse(gauge, error, done),
            },
            Item::State(State::PollInterval) => match interval(word()) {
                Ok(interval) => handle.submit(Request::Interval(interval, done)),
                Err(error) => self.refuse(gauge, error, done),
            },
            Item::State(State::Refresh) => handle.submit(Request::Refresh(done)),
            Item::Knob(at) => {
                let knobs = self.entry(gauge).knobs.as_ref();
                let set = knobs.zip(self.knobs(gauge).get(usize::from(at)).copied());
                done(set.map_or_else(|| Err(not_there()), |(knobs, (name, _))| knobs.set(name, word())));
            }
            _ => done(Err(not_writable())),
        }
    }

    /// A refusal that the gauge never heard of shows in `gauge/last_error` all the same.
    fn refuse(&self, gauge: u16, error: Error, done: Done<()>) {
        self.entry(gauge).handle.report(&error);
        done(Err(error));
    }

    /// Where a symbolic link leads.
    pub fn target(&self, node: Node) -> Option<String> {
        let (gauge, item) = match node {
            Node::Mains(MainsItem::Subsystem) => return Some(SUPPLIES.into()),
            Node::Root | Node::Mains(_) => return None,
            Node::Covered(number) => {
                let covered = self.covered.as_ref()?;
                return covered.target(&covered.name(number)?);
            }
            Node::Of(gauge, item) => (gauge, item),
        };
        match item {
            Item::Subsystem => Some(SUPPLIES.into()),
            Item::ByNameLink(subclass, parameter) => {
                let (subclass, parameter) = self.row(gauge, subclass, parameter);
                Some(match subclass.id {
                    FLAT => format!("../../flash/0x{:04x}", parameter.offset),
                    id => format!("../../{id}/{}", parameter.offset),
                })
            }
            _ => None,
        }
    }

    /// The extended attributes of a data-flash file.
    pub fn xattrs(&self, node: Node) -> Vec<(&'static str, String)> {
        let Node::Of(gauge, Item::Parameter(subclass, parameter)) = node else { return Vec::new() };
        let (subclass, parameter) = self.row(gauge, subclass, parameter);
        let mut list = vec![
            ("user.gauge.name", parameter.name.to_string()),
            ("user.gauge.type", parameter.kind.to_string()),
            ("user.gauge.unit", parameter.unit.to_string()),
        ];
        let names = ["user.gauge.min", "user.gauge.max", "user.gauge.default"];
        let bounds = bounds(subclass, parameter);
        list.extend(names.into_iter().zip(bounds).filter_map(|(name, bound)| Some((name, bound?))));
        list
    }
}

/// The first of BAT0, BAT1 ... that is not taken (monitors look for BAT*), or the same of another stem.
pub fn free_name(stem: &str, taken: &[String]) -> String {
    let names = (0..).map(|number| format!("{stem}{number}"));
    names.into_iter().find(|name| !taken.contains(name)).expect("numbers do not run out")
}

/// The registers that have a file now: all that have been read but Control() and the block-access window.
fn known(chip: &'static Chip, snapshot: Option<&Snapshot>) -> impl Iterator<Item = (u16, &'static Register)> {
    let there =
        move |register: &Register| snapshot.is_some_and(|snapshot| snapshot.value(register).is_some());
    let shown = (0..).zip(chip.registers).filter(|(_, register)| register.tier != Tier::Window);
    shown.filter(move |(_, register)| there(register))
}

fn set_bits(bits: &[Bit], word: i64) -> String {
    let set = bits.iter().filter(|bit| word & i64::from(bit.mask) != 0).map(|bit| bit.name);
    set.collect::<Vec<_>>().join(" ")
}

fn value_text(subclass: &Subclass, parameter: &Parameter, bytes: &[u8]) -> String {
    let at = usize::from(parameter.offset - subclass.start());
    let value = codec::decode(parameter.kind, &bytes[at..at + parameter.kind.size()]);
    text::render(parameter.kind, &value)
}

/// Smallest and largest value and default as texts, none of which is shown for keys.
fn bounds(subclass: &Subclass, parameter: &Parameter) -> [Option<String>; 3] {
    let show = |value: i64| text::render(parameter.kind, &crate::value::Value::Int(value));
    match &parameter.range {
        _ if subclass.kind == Kind::Security => [None, None, None],
        Range::Int { min, max, default } => [Some(show(*min)), Some(show(*max)), default.map(show)],
        Range::Float { min, max, default } => {
            [Some(min.to_string()), Some(max.to_string()), default.map(|value| value.to_string())]
        }
        Range::Text { default } => [None, None, default.map(str::to_string)],
    }
}

fn flags(subclass: &Subclass, parameter: &Parameter) -> String {
    let flags = [
        ("learned", parameter.learned),
        ("reset", subclass.kind == Kind::Reset),
        ("safe-limit", parameter.safe.is_some()),
        ("security", subclass.kind == Kind::Security),
        ("unproven", parameter.unproven),
    ];
    let set: Vec<_> = flags.iter().filter(|(_, set)| *set).map(|(name, _)| *name).collect();
    if set.is_empty() { "-".into() } else { set.join(",") }
}

fn subcommand(chip: &Chip, word: &str) -> Result<u16> {
    let code =
        word.strip_prefix("0x").and_then(|digits| u16::from_str_radix(digits, 16).ok()).or(word.parse().ok());
    let known =
        chip.subcommands.iter().find(|one| Some(one.code) == code || one.name.eq_ignore_ascii_case(word));
    match known {
        Some(known) if matches!(known.effect, Effect::Answers | Effect::Safe) => Ok(known.code),
        known => {
            let allowed =
                chip.subcommands.iter().filter(|one| matches!(one.effect, Effect::Answers | Effect::Safe));
            let allowed: Vec<_> = allowed.map(|one| one.name).collect();
            // What is no subcommand may be a key: it is not repeated.
            let what = known
                .map_or("this is no subcommand".to_string(), |known| format!("{} is not safe", known.name));
            Err(Error::new("control", Cause::Invalid(format!("{what}; there are {}", allowed.join(" ")))))
        }
    }
}

fn interval(word: &str) -> Result<Duration> {
    let seconds: f64 = word.parse().map_err(|_| {
        Error::new("poll_interval", Cause::Invalid(format!("`{word}` is not a number of seconds")))
    })?;
    if !(0.5..=3600.0).contains(&seconds) {
        let why = format!("{seconds} s is outside 0.5 to 3600 s");
        return Err(Error::new("poll_interval", Cause::OutOfRange(why)));
    }
    Ok(Duration::from_secs_f64(seconds))
}

fn not_there() -> Error {
    Error::host("", Errno::ENODEV, "the gauge has no such value now")
}

fn not_writable() -> Error {
    Error::host("", Errno::EACCES, "this file cannot be written")
}
