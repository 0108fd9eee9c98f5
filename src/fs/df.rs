// SPDX-License-Identifier: MIT

//! `df/`: data flash. The parameters by place and by name, the index of all, and `df/transaction`.

use std::collections::BTreeSet;
use std::sync::Arc;

use nix::errno::Errno;

use super::supply::Supply;
use super::transaction::{self, Moment, Staged};
use super::{Content, Item, Mode, Node, Of, Operations, Shape, SupplyItem};
use crate::error::{Cause, Error, Result};
use gauge_owner::{Attempt, Done, operations as op};
use ti_gauge::chip::{FLAT, Kind, Parameter, Range, Subclass, kebab_case};
use ti_gauge::codec;
use ti_gauge::dataflash::{Change, Place};
use ti_gauge::notation;
use ti_gauge::text;
use ti_gauge::value::Value;

/// The size that a file shows before it has been read: as in sysfs.
const UNREAD: u64 = 4096;
/// A line of `df/index` is shorter than this.
const LINE: u64 = 256;
/// A line of `df/transaction` is shorter than this.
const STAGED: u64 = 512;
/// A transaction of more parameters and blocks than this is shown when it is read, and not at each lookup.
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
    /// `df/SUBCLASS/OFFSET` or `df/flash/ADDRESS`: the subclass, and the index of the parameter in it.
    Parameter(u8, u8),
    /// `df/SUBCLASS/raw`.
    Raw(u8),
    /// `df/by-name`.
    ByName,
    /// `df/by-name/CLASS`.
    Class(u8),
    /// `df/by-name/CLASS/PARAM`: the subclass, and the index of the parameter in it.
    Link(u8, u8),
}

impl Operations for Of<'_, DfItem> {
    fn parent(&self) -> Node {
        let parent = match self.item {
            DfItem::Folder => return self.supply.node(Item::Supply(SupplyItem::Folder)),
            DfItem::Index | DfItem::Transaction | DfItem::Flat | DfItem::Subclass(_) | DfItem::ByName => {
                DfItem::Folder
            }
            DfItem::Parameter(at, _) | DfItem::Raw(at) if self.supply.subclass(at).id == FLAT => DfItem::Flat,
            DfItem::Parameter(at, _) | DfItem::Raw(at) => DfItem::Subclass(at),
            DfItem::Class(_) => DfItem::ByName,
            DfItem::Link(at, _) => DfItem::Class(at),
        };
        self.supply.node(Item::Df(parent))
    }

    fn shape(&self) -> Shape {
        match self.item {
            DfItem::Folder | DfItem::Flat | DfItem::Subclass(_) | DfItem::ByName | DfItem::Class(_) => {
                Shape::Folder
            }
            DfItem::Link(..) => Shape::Link,
            DfItem::Index | DfItem::Transaction | DfItem::Parameter(..) | DfItem::Raw(_) => Shape::File,
        }
    }

    fn mode(&self) -> Mode {
        match self.item {
            // A parameter that may not be written is refused when that is tried, with the reason.
            DfItem::Parameter(..) | DfItem::Transaction => Mode::ReadWrite,
            _ => Mode::Read,
        }
    }

    fn list(&self) -> Vec<(String, Node)> {
        let chip = self.supply.chip();
        let subclasses = || (0..).zip(chip.subclasses);
        let parameters = |at: u8| (0..).zip(self.supply.subclass(at).parameters);
        let list: Vec<(String, DfItem)> = match self.item {
            DfItem::Folder => {
                let fixed = [
                    ("index", DfItem::Index),
                    ("transaction", DfItem::Transaction),
                    ("by-name", DfItem::ByName),
                ];
                let is_flat = chip.subclasses.iter().any(|subclass| subclass.id == FLAT);
                let flat = is_flat.then_some(("flash", DfItem::Flat));
                let fixed = fixed.into_iter().chain(flat).map(|(name, item)| (name.to_string(), item));
                let numbered = subclasses().filter(|(_, subclass)| subclass.id != FLAT);
                let numbered = numbered.map(|(at, subclass)| (subclass.id.to_string(), DfItem::Subclass(at)));
                fixed.chain(numbered).collect()
            }
            DfItem::Flat => {
                let flat = subclasses().filter(|(_, subclass)| subclass.id == FLAT);
                let rows = flat.flat_map(|(at, _)| parameters(at).map(move |(row, field)| (at, row, field)));
                rows.map(|(at, row, field)| (address(field), DfItem::Parameter(at, row))).collect()
            }
            DfItem::Subclass(at) => {
                let file =
                    |(row, field): (u8, &Parameter)| (field.offset.to_string(), DfItem::Parameter(at, row));
                parameters(at).map(file).chain([("raw".to_string(), DfItem::Raw(at))]).collect()
            }
            DfItem::ByName => {
                subclasses().map(|(at, subclass)| (chip.class_dir(subclass), DfItem::Class(at))).collect()
            }
            DfItem::Class(at) => {
                parameters(at).map(|(row, field)| (kebab_case(field.name), DfItem::Link(at, row))).collect()
            }
            _ => Vec::new(),
        };
        list.into_iter().map(|(name, item)| (name, self.supply.node(Item::Df(item)))).collect()
    }

    fn content(&self) -> Content {
        let handle = &self.supply.handle;
        match self.item {
            DfItem::Parameter(at, row) => match handle.kept(at.into()) {
                Some(bytes) => Content::Bytes(self.supply.parameter_text(at, row, &bytes)),
                None => Content::Unread(UNREAD),
            },
            DfItem::Raw(at) => match handle.kept(at.into()) {
                Some(bytes) => Content::Bytes(bytes.to_vec()),
                None => Content::Unread(self.supply.subclass(at).stored().into()),
            },
            DfItem::Index => {
                let rows = self.supply.chip().subclasses.iter().map(|subclass| subclass.parameters.len());
                Content::Unread(LINE * (1 + rows.sum::<usize>() as u64))
            }
            DfItem::Transaction => match self.supply.staged() {
                None => Content::Bytes(match handle.progress() {
                    Some((done, all)) => format!("committing {done}/{all}\n").into_bytes(),
                    None => IDLE.to_vec(),
                }),
                Some(staged) if staged.len() <= SHOWN_AT_ONCE => {
                    let changes = staged.changes(self.supply.chip());
                    match self.supply.unread(&changes).is_empty() {
                        true => Content::Bytes(self.supply.staged_text(&changes)),
                        false => Content::Unread(STAGED * (1 + staged.len() as u64)),
                    }
                }
                Some(staged) => Content::Unread(STAGED * (1 + staged.len() as u64)),
            },
            _ => Content::Absent,
        }
    }

    fn read(&self, done: Done<Vec<u8>>) {
        let supply = Arc::clone(self.supply);
        let handle = &self.supply.handle;
        match self.item {
            DfItem::Parameter(at, _) | DfItem::Raw(at) if supply.subclass(at).kind == Kind::Security => {
                let why = "keys are never read";
                done(Err(Error::new(supply.subclass(at).name, Cause::NotPermitted, why)));
            }
            DfItem::Parameter(at, row) => handle.ask(
                &op::READ,
                vec![at.into()],
                Box::new(move |read| done(read.map(|read| supply.parameter_text(at, row, &read[0])))),
            ),
            DfItem::Raw(at) => handle.ask(
                &op::READ,
                vec![at.into()],
                Box::new(move |read| done(read.map(|read| read[0].to_vec()))),
            ),
            DfItem::Index => {
                let rows = supply.chip().subclasses.iter().enumerate();
                let readable = rows.filter(|(_, row)| row.kind != Kind::Security).map(|(at, _)| at);
                handle.ask(
                    &op::READ,
                    readable.collect(),
                    Box::new(move |read| done(unless_sealed(read.map(drop)).map(|()| supply.index()))),
                );
            }
            DfItem::Transaction => {
                let Some(staged) = supply.staged() else { return done(Ok(IDLE.to_vec())) };
                let staged = staged.changes(supply.chip());
                handle.ask(
                    &op::READ,
                    supply.unread(&staged),
                    Box::new(move |read| {
                        done(unless_sealed(read.map(drop)).map(|()| supply.staged_text(&staged)))
                    }),
                );
            }
            _ => done(Err(super::no_value())),
        }
    }

    fn is_stream(&self) -> bool {
        self.item == DfItem::Transaction
    }

    fn write(&self, data: &[u8], done: Done<()>) {
        let supply = self.supply;
        let (chip, handle) = (supply.chip(), &supply.handle);
        match self.item {
            DfItem::Parameter(at, row) => {
                let (subclass, parameter) = supply.row(at, row);
                let change = match supply.staged() {
                    Some(_) => Err(transaction::busy().within(parameter.name)),
                    None => Change::parse((subclass, parameter), data, handle.allows_unproven())
                        .map_err(Error::from),
                };
                let attempt = || Attempt::Write(vec![Place::of((subclass, parameter))]);
                match change {
                    Ok(change) => handle.ask(&op::WRITE, vec![change], done),
                    Err(error) => handle.refuse(attempt(), error, done),
                }
            }
            DfItem::Transaction => {
                // Reserved bits are compared with those of the gauge, which has to be read for that. If it cannot be, the
                // commit compares them.
                let mut unread: Vec<usize> = transaction::compared(chip, data).into_iter().collect();
                unread.retain(|&at| handle.kept(at).is_none());
                if unread.is_empty() {
                    return supply.stage(data, done);
                }
                let (supply, data) = (Arc::clone(supply), data.to_vec());
                handle.ask(&op::READ, unread, Box::new(move |_| supply.stage(&data, done)));
            }
            _ => done(Err(super::not_writable())),
        }
    }

    fn target(&self) -> Option<String> {
        let DfItem::Link(at, row) = self.item else { return None };
        let (subclass, parameter) = self.supply.row(at, row);
        Some(match subclass.id {
            FLAT => format!("../../flash/{}", address(parameter)),
            id => format!("../../{id}/{}", parameter.offset),
        })
    }

    fn xattrs(&self) -> Vec<(&'static str, String)> {
        let DfItem::Parameter(at, row) = self.item else { return Vec::new() };
        let (subclass, parameter) = self.supply.row(at, row);
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

impl Supply {
    fn subclass(&self, at: u8) -> &'static Subclass {
        &self.chip().subclasses[usize::from(at)]
    }

    fn row(&self, at: u8, row: u8) -> (&'static Subclass, &'static Parameter) {
        let subclass = self.subclass(at);
        (subclass, &subclass.parameters[usize::from(row)])
    }

    fn parameter_text(&self, at: u8, row: u8, bytes: &[u8]) -> Vec<u8> {
        let (subclass, parameter) = self.row(at, row);
        (value_text(subclass, parameter, bytes) + "\n").into_bytes()
    }

    /// The path of a folder below `df`.
    pub(super) fn df_folder(&self, item: DfItem) -> String {
        match item {
            DfItem::Flat => "flash".into(),
            DfItem::Subclass(at) => self.subclass(at).id.to_string(),
            DfItem::Class(at) => format!("by-name/{}", self.chip().class_dir(self.subclass(at))),
            _ => String::new(),
        }
    }

    /// Takes the lines of one write(2) to `df/transaction`.
    fn stage(&self, data: &[u8], done: Done<()>) {
        let handle = &self.handle;
        let stored = |at| handle.kept(at);
        let rules = transaction::Rules {
            chip: self.chip(),
            allow_unproven: handle.allows_unproven(),
            stored: &stored,
        };
        let staged = self.transaction.write(&rules, self.moment(), data);
        if staged.is_ok() && !self.transaction.is_spoiled() {
            handle.succeeded(&Attempt::STAGE);
        }
        match staged {
            Ok(None) => done(Ok(())),
            Ok(Some(changes)) => handle.ask(&op::WRITE, changes, done),
            Err(error) => handle.refuse(Attempt::STAGE, error, done),
        }
    }

    /// The changes of the open transaction.
    fn staged(&self) -> Option<Arc<Staged>> {
        self.transaction.staged(self.moment())
    }

    fn moment(&self) -> Moment {
        Moment { now: self.handle.now(), presence: self.handle.published().presence }
    }

    /// The subclasses that hold staged changes and have to be read to show the old values.
    fn unread(&self, staged: &[Change]) -> Vec<usize> {
        let touched: BTreeSet<usize> = staged.iter().filter_map(|one| self.index_of(one)).collect();
        touched.into_iter().filter(|&at| self.handle.kept(at).is_none()).collect()
    }

    /// The subclass that a change is in, by its index in the table.
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
                    let old = kept.map_or("-".into(), |kept| column(value_text(subclass, parameter, &kept)));
                    let new = notation::render(parameter.kind, &codec::decode(parameter.kind, bytes));
                    format!("{}: {old} -> {new}\n", parameter.name)
                }
            };
        }
        lines.into_bytes()
    }

    /// `df/index`: a line for each parameter of the table.
    fn index(&self) -> Vec<u8> {
        let dm_code = self.published().answers.dm_code;
        let rows = self.chip().subclasses.iter().map(|subclass| subclass.parameters.len());
        // Lines are half as long as they may be, or less.
        let mut lines = String::with_capacity((LINE / 2) as usize * rows.sum::<usize>());
        lines += "subclass\toffset\ttype\tname\tunit\tmin\tmax\tdefault\tflags\tvalue\n";
        for (at, subclass) in self.chip().subclasses.iter().enumerate() {
            let is_secret = subclass.kind == Kind::Security;
            let bytes = if is_secret { None } else { self.handle.kept(at) };
            for parameter in subclass.parameters {
                let (id, offset) = match subclass.id {
                    FLAT => ("flash".to_string(), address(parameter)),
                    id => (id.to_string(), parameter.offset.to_string()),
                };
                let [min, max, default] =
                    bounds(subclass, parameter, dm_code).map(|bound| bound.unwrap_or("-".into()));
                let value =
                    bytes.as_ref().map_or("-".into(), |bytes| column(value_text(subclass, parameter, bytes)));
                let unit = if parameter.unit.is_empty() { "-" } else { parameter.unit };
                let (kind, name, flags) = (parameter.kind, parameter.name, flags(subclass, parameter));
                lines += &format!(
                    "{id}\t{offset}\t{kind}\t{name}\t{unit}\t{min}\t{max}\t{default}\t{flags}\t{value}\n"
                );
            }
        }
        lines.into_bytes()
    }
}

/// A sealed gauge without a key shows everything but the values in data flash.
fn unless_sealed(read: Result<()>) -> Result<()> {
    read.or_else(|error| if error.errno() == Errno::EPERM { Ok(()) } else { Err(error) })
}

/// Name of a parameter's file on parts with a flat address space.
fn address(parameter: &Parameter) -> String {
    format!("0x{:04x}", parameter.offset)
}

fn value_text(subclass: &Subclass, parameter: &Parameter, bytes: &[u8]) -> String {
    let at = usize::from(parameter.offset - subclass.start());
    let value = codec::decode(parameter.kind, &bytes[at..at + parameter.kind.size()]);
    notation::render(parameter.kind, &value)
}

/// A value where `-` means that there is none. Only a string can be a `-` itself.
fn column(text: String) -> String {
    if text == "-" { "%2d".into() } else { text }
}

/// Smallest and largest value as a source prints them, and the default of a part with that DM_CODE; keys show none of them.
fn bounds(subclass: &Subclass, parameter: &Parameter, dm_code: Option<u16>) -> [Option<String>; 3] {
    let show = |value: i64| notation::render(parameter.kind, &Value::Int(value));
    match &parameter.range {
        _ if subclass.kind == Kind::Security => [None, None, None],
        // The limits of a type are none that a source gives.
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
            assert_eq!(error.errno(), Errno::ENOENT, "{place}");
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
