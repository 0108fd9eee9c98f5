// SPDX-License-Identifier: MIT

//! `df/`: data flash. Parameters by place and by name, the index of all, and `df/transaction`.

use std::collections::BTreeSet;
use std::sync::Arc;

use nix::errno::Errno;

use super::caller::Caller;
use super::supply::Supply;
use super::transaction::{self, Moment, Staged};
use super::{Content, Item, Mode, Node, Operations, Shape};
use crate::error::{Cause, Error, Result};
use gauge_owner::{Attempt, Done, operations as op};
use index::Index;
use ti_gauge::chip::{Chip, FLAT, Kind, Parameter, Range, Subclass, kebab_case};
use ti_gauge::dataflash::{Change, Place};
use ti_gauge::notation;
use ti_gauge::text;
use ti_gauge::value::Value;

mod index;

/// The size of a file before it is read: as in sysfs.
const UNREAD: u64 = 4096;
/// A line of `df/transaction` is shorter than this.
const STAGED: u64 = 512;
/// A larger transaction is rendered when it is read, and not at each lookup.
const SHOWN_AT_ONCE: usize = 64;
/// The text of `df/transaction` while no transaction is open.
const IDLE: &[u8] = b"idle\n";

/// An item of `df/`. Numbers are indices into the chip's table, which has at most 64 subclasses of 256 parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DfItem {
    /// The folder itself.
    Folder,
    /// `df/index`.
    Index,
    /// `df/transaction`.
    Transaction,
    /// `df/flash`, on parts with a flat address space.
    Flat,
    /// `df/SUBCLASS`.
    Subclass(u8),
    /// `df/SUBCLASS/OFFSET` or `df/flash/ADDRESS`: the subclass, and the parameter's index in it.
    Parameter(u8, u8),
    /// `df/SUBCLASS/raw`.
    Raw(u8),
    /// `df/by-name`.
    ByName,
    /// `df/by-name/CLASS`.
    Class(u8),
    /// `df/by-name/CLASS/PARAM`: the subclass, and the parameter's index in it.
    Link(u8, u8),
}

impl DfItem {
    pub(super) fn of(self, supply: &Arc<Supply>) -> Box<dyn Operations + '_> {
        match self {
            DfItem::Folder => Box::new(Folder(supply)),
            DfItem::Index => Box::new(Index(supply)),
            DfItem::Transaction => Box::new(Staging(supply)),
            DfItem::Flat => Box::new(Flat(supply)),
            DfItem::Subclass(at) => Box::new(Numbered { supply, at }),
            DfItem::Parameter(at, row) => Box::new(Field { supply, at, row }),
            DfItem::Raw(at) => Box::new(Raw { supply, at }),
            DfItem::ByName => Box::new(ByName(supply)),
            DfItem::Class(at) => Box::new(Class { supply, at }),
            DfItem::Link(at, row) => Box::new(Link { supply, at, row }),
        }
    }
}

struct Folder<'a>(&'a Arc<Supply>);

impl Operations for Folder<'_> {
    fn parent(&self) -> Node {
        self.0.folder()
    }

    fn shape(&self) -> Shape {
        Shape::Folder
    }

    fn list(&self) -> Vec<(String, Node)> {
        let is_flat = self.0.chip().subclasses.iter().any(|subclass| subclass.id == FLAT);
        let fixed =
            [("index", DfItem::Index), ("transaction", DfItem::Transaction), ("by-name", DfItem::ByName)];
        let fixed = fixed.into_iter().chain(is_flat.then_some(("flash", DfItem::Flat)));
        let numbered = self.0.subclasses().filter(|(_, subclass)| subclass.id != FLAT);
        let numbered = numbered.map(|(at, subclass)| (subclass.id.to_string(), DfItem::Subclass(at)));
        self.0.df_nodes(fixed.map(|(name, item)| (name.to_string(), item)).chain(numbered))
    }

    fn refuse_new(&self, name: &str) -> Error {
        self.0.refuse_parameter("", name)
    }
}

struct Staging<'a>(&'a Arc<Supply>);

impl Operations for Staging<'_> {
    fn parent(&self) -> Node {
        self.0.df_node(DfItem::Folder)
    }

    fn mode(&self) -> Mode {
        Mode::ReadWrite
    }

    fn content(&self) -> Content {
        let Some(staged) = self.0.staged() else {
            return Content::Bytes(match self.0.handle.progress() {
                Some(progress) => format!("{progress}\n").into_bytes().into(),
                None => IDLE.into(),
            });
        };
        if staged.len() <= SHOWN_AT_ONCE {
            let changes = staged.changes(self.0.chip());
            if self.0.unread(&changes).is_empty() {
                return Content::Bytes(self.0.staged_text(&changes).into());
            }
        }
        Content::Unread(STAGED * (1 + staged.len() as u64))
    }

    fn read(&self, done: Done<Arc<[u8]>>) {
        let supply = Arc::clone(self.0);
        let Some(staged) = supply.staged() else { return done(Ok(IDLE.into())) };
        let staged = staged.changes(supply.chip());
        self.0.handle.ask(
            &op::READ,
            supply.unread(&staged),
            Box::new(move |read| {
                done(unless_sealed(read.map(drop)).map(|()| supply.staged_text(&staged).into()));
            }),
        );
    }

    fn is_stream(&self) -> bool {
        true
    }

    fn awaits_close(&self, caller: Caller) -> bool {
        self.0.transaction.awaits_close(caller)
    }

    fn close(&self, file: u64) {
        self.0.transaction.close(file);
    }

    fn write(&self, caller: Caller, data: &[u8], done: Done<()>) {
        // Reserved bits are compared with the gauge's, which requires reading. If that fails, the commit compares them.
        let handle = &self.0.handle;
        let mut unread: Vec<usize> = transaction::compared(self.0.chip(), data).into_iter().collect();
        unread.retain(|&at| handle.kept(at).is_none());
        let begins = transaction::begins(data) && self.0.staged().is_none();
        if unread.is_empty() && !begins {
            return self.0.stage(caller, data, done);
        }
        let (supply, data) = (Arc::clone(self.0), data.to_vec());
        // A commit can only check that the pack is the same if its identity is known.
        handle.ask(&op::KNOW, unread, Box::new(move |_| supply.stage(caller, &data, done)));
    }
}

struct Flat<'a>(&'a Arc<Supply>);

impl Operations for Flat<'_> {
    fn parent(&self) -> Node {
        self.0.df_node(DfItem::Folder)
    }

    fn shape(&self) -> Shape {
        Shape::Folder
    }

    fn list(&self) -> Vec<(String, Node)> {
        let flat = self.0.subclasses().filter(|(_, subclass)| subclass.id == FLAT);
        let rows = flat.flat_map(|(at, _)| self.0.rows(at).map(move |(row, field)| (at, row, field)));
        self.0.df_nodes(rows.map(|(at, row, field)| (address(field), DfItem::Parameter(at, row))))
    }

    fn refuse_new(&self, name: &str) -> Error {
        self.0.refuse_parameter("flash", name)
    }
}

struct Numbered<'a> {
    supply: &'a Arc<Supply>,
    at: u8,
}

impl Operations for Numbered<'_> {
    fn parent(&self) -> Node {
        self.supply.df_node(DfItem::Folder)
    }

    fn shape(&self) -> Shape {
        Shape::Folder
    }

    fn list(&self) -> Vec<(String, Node)> {
        let rows = self.supply.rows(self.at);
        let rows = rows.map(|(row, field)| (field.offset.to_string(), DfItem::Parameter(self.at, row)));
        self.supply.df_nodes(rows.chain([("raw".to_string(), DfItem::Raw(self.at))]))
    }

    fn refuse_new(&self, name: &str) -> Error {
        self.supply.refuse_parameter(&self.supply.subclass(self.at).id.to_string(), name)
    }
}

struct Field<'a> {
    supply: &'a Arc<Supply>,
    at: u8,
    row: u8,
}

impl Operations for Field<'_> {
    fn parent(&self) -> Node {
        self.supply.folder_of(self.at)
    }

    /// Writing to a read-only one is refused with the reason.
    fn mode(&self) -> Mode {
        Mode::ReadWrite
    }

    fn content(&self) -> Content {
        let (_, parameter) = self.supply.row(self.at, self.row);
        match self.supply.handle.kept_parameter(self.at.into(), parameter) {
            Some(value) => Content::Bytes(line(parameter, &value)),
            None => Content::Unread(UNREAD),
        }
    }

    fn read(&self, done: Done<Arc<[u8]>>) {
        if let Err(error) = self.supply.check_readable(self.at) {
            return done(Err(error));
        }
        let (_, parameter) = self.supply.row(self.at, self.row);
        let done = Box::new(move |read: Result<Value>| done(read.map(|value| line(parameter, &value))));
        self.supply.handle.ask(&op::READ_VALUE, (self.at.into(), parameter), done);
    }

    fn write(&self, _: Caller, data: &[u8], done: Done<()>) {
        let (row, handle) = (self.supply.row(self.at, self.row), &self.supply.handle);
        let change = match self.supply.staged() {
            Some(_) => Err(transaction::busy().within(row.1.name)),
            None => Change::parse(handle.chip(), row, data, handle.allows_unproven()),
        };
        match change {
            Ok(change) => handle.ask(&op::WRITE, vec![change], done),
            Err(error) => handle.refuse(Attempt::Write(vec![Place::of(row)]), error, done),
        }
    }

    fn xattrs(&self) -> Vec<(&'static str, String)> {
        let (subclass, parameter) = self.supply.row(self.at, self.row);
        let dm_code = self.supply.published().answers.dm_code;
        let [min, max, default] = bounds(subclass, parameter, dm_code);
        let list = [
            ("user.gauge.name", Some(parameter.name.to_string())),
            ("user.gauge.type", Some(parameter.kind.to_string())),
            ("user.gauge.unit", Some(parameter.unit.to_string())),
            ("user.gauge.min", min),
            ("user.gauge.max", max),
            ("user.gauge.default", default),
        ];
        list.into_iter().filter_map(|(name, value)| Some((name, value?))).collect()
    }
}

struct Raw<'a> {
    supply: &'a Arc<Supply>,
    at: u8,
}

impl Operations for Raw<'_> {
    fn parent(&self) -> Node {
        self.supply.folder_of(self.at)
    }

    fn mode(&self) -> Mode {
        Mode::Read
    }

    fn content(&self) -> Content {
        match self.supply.handle.kept(self.at.into()) {
            Some(bytes) => Content::Bytes(bytes),
            None => Content::Unread(self.supply.subclass(self.at).stored().into()),
        }
    }

    fn read(&self, done: Done<Arc<[u8]>>) {
        if let Err(error) = self.supply.check_readable(self.at) {
            return done(Err(error));
        }
        let done = Box::new(move |read: Result<Vec<_>>| done(read.map(|mut read| read.swap_remove(0))));
        self.supply.handle.ask(&op::READ, vec![self.at.into()], done);
    }
}

struct ByName<'a>(&'a Arc<Supply>);

impl Operations for ByName<'_> {
    fn parent(&self) -> Node {
        self.0.df_node(DfItem::Folder)
    }

    fn shape(&self) -> Shape {
        Shape::Folder
    }

    fn list(&self) -> Vec<(String, Node)> {
        let chip = self.0.chip();
        let classes =
            chip.classes().map(|(at, subclass)| (chip.class_dir(subclass), DfItem::Class(at as u8)));
        self.0.df_nodes(classes)
    }

    fn refuse_new(&self, name: &str) -> Error {
        self.0.refuse_parameter("", name)
    }
}

struct Class<'a> {
    supply: &'a Arc<Supply>,
    at: u8,
}

impl Operations for Class<'_> {
    fn parent(&self) -> Node {
        self.supply.df_node(DfItem::ByName)
    }

    fn shape(&self) -> Shape {
        Shape::Folder
    }

    fn list(&self) -> Vec<(String, Node)> {
        let groups = self.supply.chip().class_of(self.supply.subclass(self.at));
        let groups = groups.map(|(at, _)| at as u8);
        let rows = groups.flat_map(|at| self.supply.rows(at).map(move |(row, field)| (at, row, field)));
        self.supply.df_nodes(rows.map(|(at, row, field)| (kebab_case(field.name), DfItem::Link(at, row))))
    }

    fn refuse_new(&self, name: &str) -> Error {
        let class = self.supply.chip().class_dir(self.supply.subclass(self.at));
        self.supply.refuse_parameter(&format!("by-name/{class}"), name)
    }
}

struct Link<'a> {
    supply: &'a Arc<Supply>,
    at: u8,
    row: u8,
}

impl Operations for Link<'_> {
    fn parent(&self) -> Node {
        let mut groups = self.supply.chip().class_of(self.supply.subclass(self.at));
        let first = groups.next().map_or(self.at, |(at, _)| at as u8);
        self.supply.df_node(DfItem::Class(first))
    }

    fn shape(&self) -> Shape {
        Shape::Link
    }

    fn target(&self) -> Option<String> {
        let (subclass, parameter) = self.supply.row(self.at, self.row);
        Some(match subclass.id {
            FLAT => format!("../../flash/{}", address(parameter)),
            id => format!("../../{id}/{}", parameter.offset),
        })
    }
}

impl Supply {
    fn subclasses(&self) -> impl Iterator<Item = (u8, &'static Subclass)> {
        (0..).zip(self.chip().subclasses)
    }

    fn subclass(&self, at: u8) -> &'static Subclass {
        &self.chip().subclasses[usize::from(at)]
    }

    fn rows(&self, at: u8) -> impl Iterator<Item = (u8, &'static Parameter)> {
        (0..).zip(self.subclass(at).parameters)
    }

    fn row(&self, at: u8, row: u8) -> (&'static Subclass, &'static Parameter) {
        let subclass = self.subclass(at);
        (subclass, &subclass.parameters[usize::from(row)])
    }

    fn df_node(&self, item: DfItem) -> Node {
        self.node(Item::Df(item))
    }

    fn df_nodes(&self, items: impl Iterator<Item = (String, DfItem)>) -> Vec<(String, Node)> {
        items.map(|(name, item)| (name, self.df_node(item))).collect()
    }

    /// The folder with a subclass's parameters by place.
    fn folder_of(&self, at: u8) -> Node {
        self.df_node(if self.subclass(at).id == FLAT { DfItem::Flat } else { DfItem::Subclass(at) })
    }

    fn check_readable(&self, at: u8) -> Result<()> {
        let subclass = self.subclass(at);
        match subclass.kind {
            Kind::Security => Err(Error::new(subclass.name, Cause::NotPermitted, "keys are never read")),
            Kind::Plain | Kind::Reset => Ok(()),
        }
    }

    fn refuse_parameter(&self, folder: &str, name: &str) -> Error {
        let error = transaction::unknown(self.chip(), &format!("{folder}/{name}"));
        self.handle.report(Attempt::Other, &error);
        error
    }

    fn stage(&self, caller: Caller, data: &[u8], done: Done<()>) {
        let (handle, now) = (&self.handle, self.moment());
        let stored = |at| handle.kept(at);
        let rules = transaction::Rules {
            chip: self.chip(),
            also_unproven: handle.allows_unproven(),
            stored: &stored,
            presence: now.presence,
        };
        let staged = self.transaction.write(&rules, now, caller, data);
        if staged.is_ok() && !self.transaction.is_spoiled() {
            handle.succeeded(&Attempt::STAGE);
        }
        match staged {
            Ok(None) => done(Ok(())),
            Ok(Some(changes)) => handle.ask(&op::COMMIT, (now.presence, changes), done),
            Err(error) => handle.refuse(Attempt::STAGE, error, done),
        }
    }

    fn staged(&self) -> Option<Arc<Staged>> {
        self.transaction.staged(self.moment())
    }

    fn moment(&self) -> Moment {
        Moment { now: self.handle.now(), presence: self.handle.published().presence }
    }

    /// Subclasses with staged changes that must be read to show old values.
    fn unread(&self, staged: &[Change]) -> Vec<usize> {
        let touched: BTreeSet<usize> = staged.iter().filter_map(|one| self.index_of(one)).collect();
        touched.into_iter().filter(|&at| self.handle.kept(at).is_none()).collect()
    }

    /// A change's subclass, by its index in the table.
    fn index_of(&self, change: &Change) -> Option<usize> {
        let mut subclasses = self.chip().subclasses.iter();
        match change.row() {
            Some((own, _)) => subclasses.position(|subclass| std::ptr::eq(subclass, own)),
            None => subclasses.position(|subclass| subclass.id == change.place().subclass),
        }
    }

    /// `df/transaction`: a line for each staged change.
    fn staged_text(&self, staged: &[Change]) -> Vec<u8> {
        let mut lines = String::new();
        for change in staged {
            let (place, bytes, row) = (change.place(), change.bytes(), change.row());
            let kept = self.index_of(change).and_then(|at| self.handle.kept(at));
            lines += &match row {
                None => {
                    let offset = usize::from(place.offset);
                    let old = kept.map_or("-".into(), |kept| text::hex(&kept[offset..offset + bytes.len()]));
                    format!("raw {place}: {old} -> {}\n", text::hex(bytes))
                }
                Some((subclass, parameter)) => {
                    let text = |kept: &[u8]| value_text(self.chip(), subclass, parameter, kept);
                    let old = kept.map_or("-".into(), |kept| column(text(&kept)));
                    let value = change.value_of(bytes).expect("a parameter has a value");
                    let new = notation::render(parameter.kind, &value);
                    format!("{}: {old} -> {new}\n", parameter.name)
                }
            };
        }
        lines.into_bytes()
    }
}

/// A sealed gauge without a key shows everything but the values in data flash.
fn unless_sealed(read: Result<()>) -> Result<()> {
    read.or_else(|error| if error.errno() == Errno::EPERM as i32 { Ok(()) } else { Err(error) })
}

/// The text of a parameter's file.
fn line(parameter: &Parameter, value: &Value) -> Arc<[u8]> {
    (notation::render(parameter.kind, value) + "\n").into_bytes().into()
}

/// A parameter's file name on parts with a flat address space.
fn address(parameter: &Parameter) -> String {
    format!("0x{:04x}", parameter.offset)
}

fn value_text(chip: &Chip, subclass: &Subclass, parameter: &Parameter, bytes: &[u8]) -> String {
    let at = usize::from(parameter.offset - subclass.start());
    let value = chip.layout.decode(parameter.kind, &bytes[at..at + parameter.kind.size()]);
    notation::render(parameter.kind, &value)
}

/// A value, or `-` for none. Only a string can be a real `-`.
fn column(text: String) -> String {
    if text == "-" { "%2d".into() } else { text }
}

/// Smallest and largest value as a source prints them, and the default of a part with this DM_CODE; keys have none of
/// them.
fn bounds(subclass: &Subclass, parameter: &Parameter, dm_code: Option<u16>) -> [Option<String>; 3] {
    let show = |value: i64| notation::render(parameter.kind, &Value::Int(value));
    match &parameter.range {
        _ if subclass.kind == Kind::Security => [None, None, None],
        // No source gives the limits of a type.
        Range::Int { .. } if parameter.unprinted => [None, None, parameter.int_default(dm_code).map(show)],
        Range::Int { min, max, .. } => {
            [Some(show(*min)), Some(show(*max)), parameter.int_default(dm_code).map(show)]
        }
        Range::Float { min, max, default } => {
            [Some(min.to_string()), Some(max.to_string()), default.map(|value| value.to_string())]
        }
        Range::Text { default } => {
            let show = |text: &str| notation::render(parameter.kind, &Value::Text(text.into()));
            [None, None, default.map(show)]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ti_gauge::chip::Chip;

    #[test]
    fn the_default_is_that_of_the_flavour() {
        let chip = Chip::by_name("bq27441-g1").expect("it has a table");
        let (subclass, parameter) = chip.row("82", "10").expect("Design Capacity");
        let default = |dm_code| bounds(subclass, parameter, dm_code)[2].clone();
        assert_eq!(default(Some(0x48)).as_deref(), Some("1340"));
        assert_eq!(default(Some(0x58)).as_deref(), Some("1000"));
        assert_eq!(default(None), None, "not identified yet");
    }

    #[test]
    fn an_unknown_parameter_is_reported_with_the_nearest_one() {
        let says = |chip: &str, place: &str| {
            let chip = Chip::by_name(chip).expect("it has a table");
            let error = transaction::unknown(chip, place);
            assert_eq!(error.errno(), Errno::ENOENT as i32, "{place}");
            error.to_string()
        };
        let terminate = "no such parameter; did you mean 80/53 (Cell Terminate Voltage)?";
        for place in ["80/54", "80/52", "by-name/it-cfg/cell-terminate-volts"] {
            assert_eq!(says("bq34z100-g1", place), terminate, "{place}");
        }
        assert!(says("bq34110", "flash/0x41f6").contains("did you mean flash/0x41f5 ("));
        for place in ["99/0", "80/", "x/0414 3672", "flash/0x4000", "80/xyz"] {
            assert_eq!(says("bq34z100-g1", place), "no such parameter; df/index lists them all", "{place}");
        }
    }
}
