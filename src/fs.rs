// SPDX-License-Identifier: MIT

//! The tree: names, modes, contents, reads and writes, without any FUSE.
//!
//! A [`Node`] identifies a file, folder or link for the whole life of the mount; its content is rendered on every
//! request. Nothing here blocks or accesses a bus: a request that needs the gauge is queued for the thread that owns
//! it, with a `Done` that gets the outcome.
//!
//! This file has the vocabulary, and passes each request to the module of that part of the tree:
//!
//! | module | part of the tree |
//! | --- | --- |
//! | `root`, `covered` | the mount point, and the kernel's supplies underneath it |
//! | `mains` | the folder of the Mains supply |
//! | `supply` | the folder of a gauge; `attribute` has one row for each power_supply attribute |
//! | `df` | data flash, and `rendered` its index; `transaction` and `raw` parse what is written to `df/transaction`, `caller` is who writes it |
//! | `gauge_dir` | `gauge/`, one row for each file |
//! | `sim_dir` | `sim/` |
//!
//! `place` has the number of each node.

use std::sync::Arc;
use std::time::Duration;

use nix::errno::Errno;

use crate::error::{Error, Result};
use gauge_owner::{Attempt, Done, GaugeOptions, Handle};

mod attribute;
mod caller;
mod covered;
mod df;
mod gauge_dir;
mod mains;
mod place;
mod raw;
mod rendered;
mod root;
mod sim_dir;
mod smart_battery;
mod supply;
mod transaction;

pub use attribute::Attribute;
use attribute::Kind;
pub use caller::{Caller, Process};
pub use covered::Covered;
use covered::CoveredLink;
pub use df::DfItem;
pub use gauge_dir::GaugeItem;
pub use mains::MainsItem;
use root::Root;
pub use root::free_names;
use sim_dir::SimDir;
pub use sim_dir::SimItem;
pub(crate) use smart_battery::{
    ADDRESS as BATTERY_ADDRESS, BatteryEvent, SmartBattery, obstacle as battery_obstacle,
};
pub use supply::{Supply, SupplyItem};

/// Number of gauges whose polls need not be foreseen.
const FEW: usize = 8;

/// The kernel splits a write(2) at pages of the file. Larger pages are multiples of this.
const PAGE: usize = 4096;

/// Target of `subsystem`, by which programs recognise a power supply.
const SUBSYSTEM: &str = "/sys/class/power_supply";

/// The files of `sim/`: the settings of a simulated gauge.
pub trait Knobs: Send + Sync {
    /// The names, and whether each is writable.
    fn list(&self) -> Vec<(&'static str, bool)>;
    /// Text of a knob.
    fn get(&self, name: &str) -> Option<String>;
    /// Changes a knob.
    fn set(&self, name: &str, text: &str) -> Result<()>;
}

/// Scaling and display of a gauge's measured attributes.
#[derive(Clone, Debug)]
pub struct Scales {
    /// Factor of currents and charges.
    pub current: f64,
    /// Factor of voltages.
    pub voltage: f64,
    /// Factor of energies and powers.
    pub energy: f64,
    /// Show currents without their sign.
    pub absolute_current: bool,
    /// Show `energy_now` and `power_avg`.
    pub energy_shown: bool,
}

impl Default for Scales {
    fn default() -> Self {
        Self { current: 1.0, voltage: 1.0, energy: 1.0, absolute_current: false, energy_shown: false }
    }
}

impl Scales {
    /// As the options of a gauge have them.
    pub fn wanted(options: &GaugeOptions) -> Self {
        Self {
            current: options.current_scale.unwrap_or(1.0),
            voltage: options.voltage_scale.unwrap_or(1.0),
            energy: options.energy_scale.unwrap_or(1.0),
            absolute_current: options.absolute_current,
            energy_shown: options.energy,
        }
    }

    fn of(&self, kind: Kind) -> f64 {
        match kind {
            Kind::Voltage => self.voltage,
            Kind::Current | Kind::Charge => self.current,
            Kind::Energy => self.energy,
        }
    }
}

/// Owner of the files, who may write them and read data flash.
#[derive(Clone, Copy, Debug)]
pub struct Access {
    /// The mount's owner.
    pub uid: u32,
    /// The group of all files.
    pub gid: u32,
    /// Whether the group has the owner's permissions.
    pub group: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    /// Everybody reads.
    Public,
    /// The owner reads, and the group if one was given; so do the next two.
    Read,
    ReadWrite,
    Write,
    /// Only the owner writes: a group that may change values must not be able to lock out the owner.
    OwnerWrite,
}

impl Access {
    fn bits(self, mode: Mode) -> u16 {
        let shared = |bits: u16| if self.group { bits * 0o110 } else { bits * 0o100 };
        match mode {
            Mode::Public => 0o444,
            Mode::Read => shared(4),
            Mode::ReadWrite => shared(6),
            Mode::Write => shared(2),
            Mode::OwnerWrite => 0o200,
        }
    }
}

/// A file, folder or link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Node {
    /// The mount point.
    Root,
    /// A part of the Mains supply.
    Mains(MainsItem),
    /// The link of that number, in the folder underneath the mount.
    Covered(u32),
    /// A part of the gauge of that index.
    Of(u16, Item),
}

/// A part of a gauge's folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Item {
    /// The folder itself and its attributes.
    Supply(SupplyItem),
    /// `df` and everything below it.
    Df(DfItem),
    /// `gauge` and everything below it.
    Gauge(GaugeItem),
    /// `sim` and everything below it.
    Sim(SimItem),
}

/// The kind of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// A folder.
    Folder,
    /// A symbolic link.
    Link,
    /// A regular file.
    File,
}

/// Present content of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Content {
    /// These bytes.
    Bytes(Arc<[u8]>),
    /// Bytes that [`Fs::read`] must first read from the gauge. Until then the file shows this size, which is no smaller
    /// than theirs.
    Unread(u64),
    /// The gauge has no value now, so the file does not exist.
    Absent,
}

impl From<Option<String>> for Content {
    fn from(text: Option<String>) -> Self {
        text.map_or(Content::Absent, |text| Content::Bytes(text.into_bytes().into()))
    }
}

/// Nature and behaviour of a node. Implementing types borrow the source of their answers.
trait Operations {
    /// The folder of the node; the root's is itself.
    fn parent(&self) -> Node;

    fn shape(&self) -> Shape {
        Shape::File
    }

    fn mode(&self) -> Mode {
        Mode::Public
    }

    /// The name, if known without listing the folder.
    fn name(&self) -> Option<&'static str> {
        None
    }

    fn list(&self) -> Vec<(String, Node)> {
        Vec::new()
    }

    /// The node of that name in a folder.
    fn lookup(&self, name: &str) -> Option<Node> {
        find(self.list(), name)
    }

    /// Whether the kernel may keep name and text until it is told of a change.
    fn may_be_cached(&self) -> bool {
        self.shape() != Shape::File
    }

    fn content(&self) -> Content {
        Content::Absent
    }

    fn read(&self, done: Done<Arc<[u8]>>) {
        match self.content() {
            Content::Bytes(bytes) => done(Ok(bytes)),
            Content::Unread(_) | Content::Absent => done(Err(no_value())),
        }
    }

    /// Whether a file is written as a stream. Elsewhere each write is a whole value.
    fn is_stream(&self) -> bool {
        false
    }

    fn write(&self, _: Caller, _data: &[u8], done: Done<()>) {
        done(Err(not_writable()));
    }

    /// See [`Fs::awaits_close`].
    fn awaits_close(&self, _: Caller) -> bool {
        false
    }

    fn close(&self, _file: u64) {}

    /// Refuses a new file of that name in a folder.
    fn refuse_new(&self, _name: &str) -> Error {
        Error::host("", Errno::ENOENT, "there is no such file, and none can be made")
    }

    fn target(&self) -> Option<String> {
        None
    }

    fn xattrs(&self) -> Vec<(&'static str, String)> {
        Vec::new()
    }
}

fn find(list: Vec<(String, Node)>, name: &str) -> Option<Node> {
    list.into_iter().find(|(found, _)| found == name).map(|(_, node)| node)
}

fn no_value() -> Error {
    Error::host("", Errno::ENODEV, "the gauge has no such value now")
}

fn not_writable() -> Error {
    Error::host("", Errno::EACCES, "this file cannot be written")
}

/// The tree.
pub struct Fs {
    supplies: Vec<Arc<Supply>>,
    /// In place of supplies: folders with only the knobs of simulated gauges, by their names.
    knobs: Vec<(String, Box<dyn Knobs>)>,
    access: Access,
    /// Folder name of the Mains supply.
    mains: Option<String>,
    covered: Option<Covered>,
}

impl Fs {
    /// A tree of these gauges.
    pub fn new(gauges: Vec<Supply>, access: Access) -> Self {
        let supplies = (0..).zip(gauges).map(|(index, gauge)| Arc::new(gauge.at(index)));
        Self { supplies: supplies.collect(), knobs: Vec::new(), access, mains: None, covered: None }
    }

    /// A tree of nothing but knobs: a folder for each gauge, or the knobs of the only one.
    pub fn of_knobs(knobs: Vec<(String, Box<dyn Knobs>)>, access: Access) -> Self {
        Self { knobs, ..Self::new(Vec::new(), access) }
    }

    /// Adds a Mains supply of that name.
    #[must_use]
    pub fn with_mains(self, name: Option<String>) -> Self {
        Self { mains: name, ..self }
    }

    /// Adds the supplies in the folder that the mount covers.
    #[must_use]
    pub fn overlay(self, covered: Option<Covered>) -> Self {
        Self { covered, ..self }
    }

    /// Whether the tree shows a covered folder too. Its names change without a poll, so the kernel must not cache
    /// listings of the root.
    pub fn is_overlay(&self) -> bool {
        self.covered.is_some()
    }

    fn at(&self, node: Node) -> Box<dyn Operations + '_> {
        match node {
            Node::Root => Box::new(Root(self)),
            Node::Mains(item) => item.of(self),
            Node::Covered(number) => Box::new(CoveredLink { covered: self.covered.as_ref(), number }),
            Node::Of(gauge, item) => {
                let supply = || &self.supplies[usize::from(gauge)];
                match item {
                    Item::Supply(item) => item.of(supply()),
                    Item::Df(item) => item.of(supply()),
                    Item::Gauge(item) => item.of(supply()),
                    Item::Sim(item) => item.of(self.sim_dir(gauge)),
                }
            }
        }
    }

    /// Where the knobs of a gauge are.
    fn sim_dir(&self, gauge: u16) -> SimDir<'_> {
        let handle = self.handle(gauge);
        match self.supplies.get(usize::from(gauge)) {
            Some(supply) => SimDir { gauge, knobs: supply.knobs.as_deref(), parent: supply.folder(), handle },
            None => {
                let knobs = self.knobs.get(usize::from(gauge)).map(|(_, knobs)| &**knobs);
                SimDir { gauge, knobs, parent: Node::Root, handle }
            }
        }
    }

    /// A gauge that shows more than its knobs.
    fn handle(&self, gauge: u16) -> Option<&Handle> {
        self.supplies.get(usize::from(gauge)).map(|supply| &supply.handle)
    }

    /// The folder of a node; the root's is itself.
    pub fn parent(&self, node: Node) -> Node {
        self.at(node).parent()
    }

    /// Folder, link or file.
    pub fn shape(&self, node: Node) -> Shape {
        self.at(node).shape()
    }

    /// Owner and group of every node.
    pub fn owner(&self) -> (u32, u32) {
        (self.access.uid, self.access.gid)
    }

    /// Permissions. Everybody may read attributes; data flash and writable files are for the mount's owner, and for its
    /// group if one was named. Folders have the same permissions although nothing can be made in them, so that this
    /// tree answers a mistyped name.
    pub fn mode(&self, node: Node) -> u16 {
        let node = self.at(node);
        match node.shape() {
            Shape::Folder => 0o555 | self.access.bits(Mode::ReadWrite) & 0o222,
            Shape::Link => 0o777,
            Shape::File => self.access.bits(node.mode()),
        }
    }

    /// Whether the kernel may keep name and text until it is told of a change. Among files that holds for attributes
    /// only: they change with a poll and at no other time.
    pub fn may_be_cached(&self, node: Node) -> bool {
        self.at(node).may_be_cached()
    }

    /// Whether a folder is there for the life of the mount: that of a gauge, and `gauge` in it.
    pub fn is_fixed(&self, node: Node) -> bool {
        let is_it = |item| [Item::Supply(SupplyItem::Folder), Item::Gauge(GaugeItem::Folder)].contains(&item);
        matches!(node, Node::Of(_, item) if is_it(item)) && !self.is_overlay()
    }

    /// How long a file keeps its value unless somebody asks for another poll; `None` with few gauges, whose polls are seldom
    /// enough to notify the kernel of each.
    pub fn unchanged_for(&self, node: Node) -> Option<Duration> {
        if self.supplies.len() <= FEW {
            return None;
        }
        let Node::Of(gauge, _) = node else { return Some(Duration::ZERO) };
        let handle = self.handle(gauge)?;
        Some(handle.published().interval.saturating_sub(handle.age().unwrap_or(Duration::MAX)))
    }

    /// How long what was told of a file, or of the mount point, may be shown if the daemon ends and can tell of no change:
    /// until it is three intervals old.
    pub fn outlasts_daemon(&self, node: Node) -> Duration {
        let age = |handle: &Handle| handle.age().unwrap_or(Duration::MAX);
        let lasts = |handle: &Handle| (handle.published().interval * 3).saturating_sub(age(handle));
        match node {
            Node::Of(gauge, _) => self.handle(gauge).map_or(Duration::ZERO, lasts),
            _ => self.supplies.iter().map(|supply| lasts(&supply.handle)).min().unwrap_or_default(),
        }
    }

    /// Whether somebody may write a file.
    pub fn may_be_written(&self, node: Node) -> bool {
        self.shape(node) == Shape::File && self.mode(node) & 0o200 != 0
    }

    /// Refuses a new file, whose name is mistyped. The log and `gauge/last_error` name the parameter that was probably
    /// meant.
    pub fn refuse_new(&self, folder: Node, name: &str) -> Error {
        self.at(folder).refuse_new(name)
    }

    /// Reports a defect of gaugefs that has stopped something: to a node's gauge, or to all. The log has the place.
    pub fn report_defect(&self, node: Option<Node>) {
        let why = "a defect of gaugefs has stopped a request; the log has its place; please report it";
        let error = Error::host("", Errno::EIO, why);
        for (index, supply) in (0_u16..).zip(&self.supplies) {
            if !matches!(node, Some(Node::Of(gauge, _)) if gauge != index) {
                supply.handle.report(Attempt::Other, &error);
            }
        }
    }

    /// The present entries of a folder.
    pub fn list(&self, folder: Node) -> Vec<(String, Node)> {
        self.at(folder).list()
    }

    /// The node of that name in a folder.
    pub fn lookup(&self, folder: Node, name: &str) -> Option<Node> {
        self.at(folder).lookup(name)
    }

    /// Name of a file in its folder. An attribute has one even while the gauge lacks its value.
    pub fn file_name(&self, node: Node) -> Option<String> {
        let listed = || self.list(self.parent(node)).into_iter().find(|(_, found)| *found == node);
        let name = self.at(node).name();
        name.map(str::to_string).or_else(|| listed().map(|(name, _)| name))
    }

    /// Path of a file from its gauge's folder on.
    fn path(&self, node: Node) -> String {
        let name = self.file_name(node).unwrap_or_default();
        match self.parent(node) {
            Node::Root | Node::Of(_, Item::Supply(SupplyItem::Folder)) => name,
            folder => format!("{}/{name}", self.path(folder)),
        }
    }

    /// The present content of a file.
    pub fn content(&self, node: Node) -> Content {
        self.at(node).content()
    }

    /// Reads a file's [`Content::Unread`] from the gauge. `done` gets the bytes, either at once or from the gauge's
    /// thread.
    pub fn read(&self, node: Node, done: Done<Arc<[u8]>>) {
        self.at(node).read(done);
    }

    /// Whether a file is written as a stream, each write continuing the last. Elsewhere each write is a whole value.
    pub fn is_stream(&self, node: Node) -> bool {
        self.at(node).is_stream()
    }

    /// Writes to a file at `offset`. `done` gets the outcome, either at once or from the gauge's thread.
    pub fn write(&self, node: Node, caller: Caller, offset: u64, data: &[u8], done: Done<()>) {
        let is_cut = data.len() >= PAGE || (offset + data.len() as u64).is_multiple_of(PAGE as u64);
        if self.is_stream(node) || !is_cut {
            return self.at(node).write(caller, data, done);
        }
        let why = "longer than any value, so it may not be whole; write the value alone, without padding";
        let error = Error::host(self.path(node), Errno::EFBIG, why);
        let gauge = if let Node::Of(gauge, _) = node { self.handle(gauge) } else { None };
        match gauge {
            Some(handle) => handle.refuse(Attempt::Other, error, done),
            None => done(Err(error)),
        }
    }

    /// Whether this write has another answer after the open file of the process's previous write is closed.
    pub fn awaits_close(&self, node: Node, caller: Caller) -> bool {
        self.at(node).awaits_close(caller)
    }

    /// An open file was closed.
    pub fn close(&self, node: Node, file: u64) {
        self.at(node).close(file);
    }

    /// The target of a symbolic link.
    pub fn target(&self, node: Node) -> Option<String> {
        self.at(node).target()
    }

    /// The extended attributes of a data-flash file.
    pub fn xattrs(&self, node: Node) -> Vec<(&'static str, String)> {
        self.at(node).xattrs()
    }

    /// Marks a node's gauge as changed and wakes those who wait for the signal. Nodes outside gauges use the first
    /// gauge.
    pub fn raise(&self, node: Node) {
        let gauge = if let Node::Of(gauge, _) = node { gauge } else { 0 };
        if let Some(handle) = self.handle(gauge) {
            handle.raise();
        }
    }

    /// Whether names come and go in a folder.
    pub fn may_change(&self, folder: Node) -> bool {
        let gauge = if let Node::Of(gauge, _) = folder { gauge } else { 0 };
        self.changing_folders(&[gauge]).contains(&folder)
    }

    /// The folders whose names change with these gauges' values.
    pub fn changing_folders(&self, gauges: &[u16]) -> Vec<Node> {
        if gauges.is_empty() {
            return Vec::new();
        }
        let items = || [Item::Supply(SupplyItem::Folder)].into_iter().chain(gauge_dir::folders());
        let folders = gauges.iter().flat_map(|&gauge| items().map(move |item| Node::Of(gauge, item)));
        let mains = self.mains.is_some().then_some(Node::Mains(MainsItem::Folder));
        folders.chain(mains).chain(self.is_overlay().then_some(Node::Root)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gauge_bus::clock::Clock as _;
    use gauge_owner::rig::{INTERVAL, Rig};

    #[test]
    fn nothing_is_shown_for_longer_than_three_intervals_after_the_last_word_of_the_daemon() {
        let mut rig = Rig::open();
        let access = Access { uid: 0, gid: 0, group: false };
        let tree = Fs::new(vec![Supply::new("BAT0".into(), rig.handle.clone())], access);
        let file = tree.lookup(Node::Root, "BAT0").expect("its folder");
        for (paused, left) in [(0, 24), (7, 17), (16, 1), (2, 0)] {
            rig.clock.sleep(Duration::from_secs(paused));
            let left = Duration::from_secs(left);
            for node in [file, Node::Root] {
                let lasts = tree.outlasts_daemon(node);
                assert!(lasts <= left && left - lasts < Duration::from_millis(500), "{lasts:?} of {left:?}");
            }
        }
        rig.poll_after(Duration::ZERO);
        assert!(tree.outlasts_daemon(file) > INTERVAL * 2, "it was polled");
    }

    #[test]
    fn a_group_gets_what_the_owner_has_but_for_keys() {
        let alone = Access { uid: 0, gid: 0, group: false };
        let shared = Access { group: true, ..alone };
        for (mode, bits, bits_shared) in [
            (Mode::Public, 0o444, 0o444),
            (Mode::Read, 0o400, 0o440),
            (Mode::ReadWrite, 0o600, 0o660),
            (Mode::Write, 0o200, 0o220),
            (Mode::OwnerWrite, 0o200, 0o200),
        ] {
            assert_eq!((alone.bits(mode), shared.bits(mode)), (bits, bits_shared), "{mode:?}");
        }
    }
}
