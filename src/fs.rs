// SPDX-License-Identifier: MIT

//! The tree: names, modes, contents, reads and writes, without any FUSE.
//!
//! A [`Node`] identifies one file, folder or link for the whole life of the mount; its content is rendered
//! each time it is asked for. Nothing here blocks or accesses a bus: a request that needs the gauge is queued
//! for the thread that owns it, together with a `Done` to be called with the outcome.
//!
//! This file holds the vocabulary and passes each question on to the module of that part of the tree:
//!
//! | module | part of the tree |
//! | --- | --- |
//! | `root`, `covered` | the mount point, and the kernel's supplies underneath it |
//! | `mains` | the folder of the Mains supply |
//! | `supply` | the folder of a gauge; `attribute` has one row for each power_supply attribute |
//! | `df` | data flash; `transaction` and `raw` parse what is written to `df/transaction`, `caller` is who writes it |
//! | `gauge_dir` | `gauge/`, one row for each file |
//! | `sim_dir` | `sim/` |
//!
//! `place` has the number of each node.

use std::sync::Arc;

use nix::errno::Errno;

use crate::error::{Error, Result};
use gauge_owner::{Attempt, Done, Handle};

mod attribute;
mod caller;
mod covered;
mod df;
mod gauge_dir;
mod mains;
mod place;
mod raw;
mod root;
mod sim_dir;
mod smart_battery;
mod supply;
mod transaction;

pub use attribute::Attribute;
use attribute::{Kind, Reading};
pub use caller::{Caller, Process};
pub use covered::Covered;
use covered::CoveredLink;
pub use df::DfItem;
pub use gauge_dir::GaugeItem;
pub use mains::MainsItem;
use root::Root;
pub use root::free_names;
pub use sim_dir::SimItem;
pub(crate) use smart_battery::{
    ADDRESS as BATTERY_ADDRESS, SmartBattery, Told, obstacle as battery_obstacle,
};
use supply::Supply;
pub use supply::SupplyItem;

/// The kernel passes a write(2) on in pieces, each of which ends with a page of the file or with the data. Pages
/// that are larger are multiples of this.
const PAGE: usize = 4096;

/// Target of `subsystem`, by which programs recognise a power supply.
const SUBSYSTEM: &str = "/sys/class/power_supply";

/// The files of `sim/`: the settings of a simulated gauge.
pub trait Knobs: Send + Sync {
    /// Their names, and whether each may be written.
    fn list(&self) -> Vec<(&'static str, bool)>;
    /// The text of one.
    fn get(&self, name: &str) -> Option<String>;
    /// Changes one.
    fn set(&self, name: &str, text: &str) -> Result<()>;
}

/// How the measured attributes of a gauge are scaled and shown.
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
    fn of(&self, kind: Kind) -> f64 {
        match kind {
            Kind::Voltage => self.voltage,
            Kind::Current | Kind::Charge => self.current,
            Kind::Energy => self.energy,
        }
    }
}

/// A gauge that gets a folder below the mount point.
pub struct MountedGauge {
    /// Name of the folder, such as `BAT0`.
    pub name: String,
    /// The gauge.
    pub handle: Handle,
    /// How its measurements are shown.
    pub scales: Scales,
    /// The files of `sim/`, for a simulated gauge.
    pub knobs: Option<Box<dyn Knobs>>,
}

impl MountedGauge {
    /// What to warn of: scales of the user's that multiply a scale which the gauge reports, and may be meant to be
    /// the same one; and scales that are missing or given although the gauge says the contrary.
    pub fn warnings(&self) -> Vec<String> {
        let published = self.handle.published();
        let reading = Reading::new(&self.handle, published.snapshot.as_deref(), &self.scales);
        // One warning for each option.
        let kinds = Kind::ALL.chunk_by(|one, other| one.option() == other.option());
        let twice = kinds.filter_map(|kinds| kinds.iter().find_map(|&kind| self.given_twice(&reading, kind)));
        let scaled = reading.is_scaled().and_then(|(is_scaled, what)| self.contradiction(is_scaled, &what));
        twice.chain(scaled).map(|warning| format!("{}: {warning}", self.name)).collect()
    }

    fn given_twice(&self, reading: &Reading<'_>, kind: Kind) -> Option<String> {
        let (reported, given) = (reading.reported_scale(kind)?, self.scales.of(kind));
        (reported != 1 && given != 1.0).then(|| {
            let (option, all) = (kind.option(), f64::from(reported) * given);
            format!(
                "the gauge reports a scale of {reported}, and {option} {given} comes on top: values are multiplied by \
                 {all}; leave out {option} if it is the same scale"
            )
        })
    }

    /// What a bit says of scales that the gauge does not have, against the options.
    fn contradiction(&self, is_scaled: bool, what: &str) -> Option<String> {
        let scales = &self.scales;
        let kinds = [(Kind::Current, true), (Kind::Energy, scales.energy_shown)];
        let wrong = |&(kind, is_shown): &(Kind, bool)| is_shown && (scales.of(kind) == 1.0) == is_scaled;
        let options: Vec<_> =
            kinds.iter().filter(|kind| wrong(kind)).map(|(kind, _)| kind.option()).collect();
        let options = options.join(" and ");
        match is_scaled {
            _ if options.is_empty() => None,
            true => Some(format!(
                "{what} is set, so currents, charges and energies are a fraction of the real ones, and the gauge does \
                 not have the factor; give {options}"
            )),
            false => Some(format!(
                "{options} given, but {what} is clear, so the gauge reports real values; leave out {options}, or set \
                 the bit"
            )),
        }
    }
}

/// The owner of the files, who may write them and read data flash.
#[derive(Clone, Copy, Debug)]
pub struct Access {
    /// The mount's owner.
    pub uid: u32,
    /// The group of all files.
    pub gid: u32,
    /// Whether the group may do what the owner may.
    pub group: bool,
}

/// The permissions of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    /// Everybody reads.
    Public,
    /// Owner reads, and the group if one was given. The next two work alike.
    Read,
    ReadWrite,
    Write,
    /// Only the owner writes: a group that may change values must not be able to lock the owner out.
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

/// One file, folder or link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Node {
    /// The mount point.
    Root,
    /// Something of the Mains supply.
    Mains(MainsItem),
    /// The link of that number, found in the folder underneath the mount.
    Covered(u32),
    /// Something in the folder of the gauge of that index.
    Of(u16, Item),
}

/// Something in a gauge's folder.
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

/// Whether a node is a folder, a link or a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// A folder.
    Folder,
    /// A symbolic link.
    Link,
    /// A regular file.
    File,
}

/// The present content of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Content {
    /// These bytes.
    Bytes(Vec<u8>),
    /// Bytes that have to be read from the gauge first, by [`Fs::read`]. Until then the file shows this
    /// size, which is at least that of the bytes to come.
    Unread(u64),
    /// Nothing: the gauge does not have the value now, and there is no such file.
    Absent,
}

impl From<Option<String>> for Content {
    fn from(text: Option<String>) -> Self {
        text.map_or(Content::Absent, |text| Content::Bytes(text.into_bytes()))
    }
}

/// The nature and behaviour of one node. The implementing types borrow everything that they answer from.
trait Operations {
    /// The folder that holds the node; the root holds itself.
    fn parent(&self) -> Node;

    /// Folder, link or file.
    fn shape(&self) -> Shape {
        Shape::File
    }

    /// The permissions of a file.
    fn mode(&self) -> Mode {
        Mode::Public
    }

    /// Its name, where that is known without listing the folder that holds it.
    fn name(&self) -> Option<&'static str> {
        None
    }

    /// The present entries of a folder.
    fn list(&self) -> Vec<(String, Node)> {
        Vec::new()
    }

    /// The node of that name in a folder.
    fn lookup(&self, name: &str) -> Option<Node> {
        find(self.list(), name)
    }

    /// Whether the kernel may keep its name and text until it is told of a change.
    fn may_be_cached(&self) -> bool {
        self.shape() != Shape::File
    }

    /// The present content of a file.
    fn content(&self) -> Content {
        Content::Absent
    }

    /// Reads a file's [`Content::Unread`] from the gauge.
    fn read(&self, done: Done<Vec<u8>>) {
        match self.content() {
            Content::Bytes(bytes) => done(Ok(bytes)),
            Content::Unread(_) | Content::Absent => done(Err(no_value())),
        }
    }

    /// Whether a file is written as a stream. In any other file each write is one whole value.
    fn is_stream(&self) -> bool {
        false
    }

    /// Writes to a file.
    fn write(&self, _: Caller, _data: &[u8], done: Done<()>) {
        done(Err(not_writable()));
    }

    /// See [`Fs::awaits_close`].
    fn awaits_close(&self, _: Caller) -> bool {
        false
    }

    /// An open file was closed.
    fn close(&self, _file: u64) {}

    /// Refuses a new file of that name in a folder.
    fn refuse_new(&self, _name: &str) -> Error {
        Error::host("", Errno::ENOENT, "there is no such file, and none can be made")
    }

    /// The target of a link.
    fn target(&self) -> Option<String> {
        None
    }

    /// The extended attributes of a file.
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
    access: Access,
    /// Name of the Mains supply's folder.
    mains: Option<String>,
    covered: Option<Covered>,
}

impl Fs {
    /// A tree of these gauges.
    pub fn new(gauges: Vec<MountedGauge>, access: Access) -> Self {
        let supplies = (0..).zip(gauges).map(|(index, gauge)| Arc::new(Supply::new(index, gauge)));
        Self { supplies: supplies.collect(), access, mains: None, covered: None }
    }

    /// Adds a Mains supply of that name.
    #[must_use]
    pub fn with_mains(self, name: Option<String>) -> Self {
        Self { mains: name, ..self }
    }

    /// Also shows the supplies in the folder that the mount covers.
    #[must_use]
    pub fn overlay(self, covered: Option<Covered>) -> Self {
        Self { covered, ..self }
    }

    /// Whether the tree shows a covered folder too. Its names come and go without a poll, so the kernel may not
    /// cache listings of the root.
    pub fn is_overlay(&self) -> bool {
        self.covered.is_some()
    }

    /// What answers for a node.
    fn at(&self, node: Node) -> Box<dyn Operations + '_> {
        match node {
            Node::Root => Box::new(Root(self)),
            Node::Mains(item) => item.of(self),
            Node::Covered(number) => Box::new(CoveredLink { covered: self.covered.as_ref(), number }),
            Node::Of(gauge, item) => {
                let supply = &self.supplies[usize::from(gauge)];
                match item {
                    Item::Supply(item) => item.of(supply),
                    Item::Df(item) => item.of(supply),
                    Item::Gauge(item) => item.of(supply),
                    Item::Sim(item) => item.of(supply),
                }
            }
        }
    }

    /// The folder that holds a node; the root holds itself.
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

    /// Permissions. Everybody may read attributes; data flash and writable files are for the mount's owner,
    /// and its group where one was named. They also have the folders, in which nothing can be made, so that it is this
    /// tree that answers when a name is mistyped.
    pub fn mode(&self, node: Node) -> u16 {
        let node = self.at(node);
        match node.shape() {
            Shape::Folder => 0o555 | self.access.bits(Mode::ReadWrite) & 0o222,
            Shape::Link => 0o777,
            Shape::File => self.access.bits(node.mode()),
        }
    }

    /// Whether the kernel may keep the name and the text until it is told of a change. Of the files, that is
    /// true for attributes only: they change with a poll and at no other time.
    pub fn may_be_cached(&self, node: Node) -> bool {
        self.at(node).may_be_cached()
    }

    /// Whether anybody may write a file.
    pub fn may_be_written(&self, node: Node) -> bool {
        self.shape(node) == Shape::File && self.mode(node) & 0o200 != 0
    }

    /// Refuses a file that somebody wants to make, which is one whose name is mistyped. The log and `gauge/last_error`
    /// name the parameter that was probably meant.
    pub fn refuse_new(&self, folder: Node, name: &str) -> Error {
        self.at(folder).refuse_new(name)
    }

    /// Reports that a defect of gaugefs has stopped something: to the gauge that a node belongs to, or to all. The log
    /// has the place.
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

    /// The name of a file in its folder. An attribute has one even while the gauge does not have its value.
    pub fn file_name(&self, node: Node) -> Option<String> {
        let listed = || self.list(self.parent(node)).into_iter().find(|(_, found)| *found == node);
        let name = self.at(node).name();
        name.map(str::to_string).or_else(|| listed().map(|(name, _)| name))
    }

    /// Where a file is, from its gauge's folder on.
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

    /// Reads a file's [`Content::Unread`] from the gauge. `done` is called with the bytes, either at once or
    /// from the thread that owns the gauge.
    pub fn read(&self, node: Node, done: Done<Vec<u8>>) {
        self.at(node).read(done);
    }

    /// Whether a file is written as a stream, each write continuing the one before. In any other file each
    /// write is one whole value.
    pub fn is_stream(&self, node: Node) -> bool {
        self.at(node).is_stream()
    }

    /// Writes to a file. `offset` is where the data begins in the file. `done` is called with the outcome, either at
    /// once or from the thread that owns the gauge.
    pub fn write(&self, node: Node, caller: Caller, offset: u64, data: &[u8], done: Done<()>) {
        let is_cut = data.len() >= PAGE || (offset + data.len() as u64).is_multiple_of(PAGE as u64);
        if self.is_stream(node) || !is_cut {
            return self.at(node).write(caller, data, done);
        }
        let why = "longer than any value, so it may not be whole; write the value alone, without padding";
        let error = Error::host(self.path(node), Errno::EFBIG, why);
        match node {
            Node::Of(gauge, _) => {
                self.supplies[usize::from(gauge)].handle.refuse(Attempt::Other, error, done)
            }
            _ => done(Err(error)),
        }
    }

    /// Whether this write is answered otherwise when the open file through which the same process wrote before it has been
    /// closed.
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

    /// Marks a node's gauge as changed and wakes whoever waits for the signal. A node of no gauge does so by
    /// way of the first one.
    pub fn raise(&self, node: Node) {
        let gauge = if let Node::Of(gauge, _) = node { gauge } else { 0 };
        self.supplies[usize::from(gauge)].handle.raise();
    }

    /// Whether names come and go in a folder.
    pub fn may_change(&self, folder: Node) -> bool {
        let gauge = if let Node::Of(gauge, _) = folder { gauge } else { 0 };
        self.changing_folders(&[gauge]).contains(&folder)
    }

    /// The folders in which names come and go with the values of these gauges.
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
