// SPDX-License-Identifier: MIT

//! The folder of a gauge: power_supply attributes, `uevent` and `subsystem`, and the folders `df`, `gauge` and `sim`.

use std::sync::{Arc, Mutex, PoisonError};

use super::attribute::{self, Attribute, Kind, Reading};
use super::rendered::Rendered;
use super::transaction::Transaction;
use super::{
    Content, DfItem, GaugeItem, Item, Knobs, Node, Operations, SUBSYSTEM, Scales, Shape, SimItem, find,
};
use crate::check;
use gauge_owner::{Context, Done, FileOperation, Handle, Published, Snapshot};
use ti_gauge::chip::Chip;

/// A mounted gauge, whose folder is below the mount point, with the tree's facts about it.
pub struct Supply {
    pub(super) index: u16,
    pub(super) name: String,
    pub(super) handle: Handle,
    pub(super) knobs: Option<Box<dyn Knobs>>,
    pub(super) transaction: Transaction,
    /// `df/index`.
    pub(super) rendered: Rendered,
    /// The last text of `gauge/check`, and the revision that it is of.
    checked: Mutex<Option<(u64, String)>>,
    scales: Scales,
}

impl Supply {
    /// A gauge whose folder has that name, such as `BAT0`. Its measurements are shown as they are.
    pub fn new(name: String, handle: Handle) -> Self {
        Self {
            index: 0,
            name,
            handle,
            knobs: None,
            transaction: Transaction::default(),
            rendered: Rendered::default(),
            checked: Mutex::default(),
            scales: Scales::default(),
        }
    }

    /// Shows its measurements in another way.
    #[must_use]
    pub fn with_scales(self, scales: Scales) -> Self {
        Self { scales, ..self }
    }

    /// Shows the files of `sim/`, for a simulated gauge.
    #[must_use]
    pub fn with_knobs(self, knobs: Option<Box<dyn Knobs>>) -> Self {
        Self { knobs, ..self }
    }

    /// The gauge of that index in its tree.
    pub(super) fn at(self, index: u16) -> Self {
        self.handle.show_as(index);
        Self { index, ..self }
    }

    /// Warnings about scales: the user's own may repeat a scale that the gauge reports, or may be missing or given
    /// against what the gauge says.
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

    /// What a bit says about scales that the gauge lacks, against the options.
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

    pub(super) fn node(&self, item: Item) -> Node {
        Node::Of(self.index, item)
    }

    pub(super) fn folder(&self) -> Node {
        self.node(Item::Supply(SupplyItem::Folder))
    }

    pub(super) fn chip(&self) -> &'static Chip {
        self.handle.chip()
    }

    pub(super) fn published(&self) -> Arc<Published> {
        self.handle.published()
    }

    /// Whether the table is the part's own, not that of a relative with the same standard commands.
    pub(super) fn has_own_table(&self) -> bool {
        self.published().limited.is_none()
    }

    /// The last poll, unless it is older than three poll intervals and so no longer shown.
    pub(super) fn fresh(&self) -> Option<Arc<Snapshot>> {
        let published = self.published();
        let age = self.handle.age()?;
        published.snapshot.clone().filter(|_| age <= published.interval * 3)
    }

    /// The text of `gauge/check`. It is part of every file of values, and the rules take as long as the rest of one.
    pub(super) fn checked(&self) -> Option<String> {
        let (revision, snapshot) = (self.handle.revision(), self.fresh()?);
        let last = || self.checked.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((of, text)) = &*last()
            && *of == revision
        {
            return Some(text.clone());
        }
        let text = check::text(&check::of(&self.handle, &snapshot, self.user_scale(Kind::Voltage)));
        *last() = Some((revision, text.clone()));
        Some(text)
    }

    /// By what the user's option multiplies a kind of values.
    pub(super) fn user_scale(&self, kind: Kind) -> f64 {
        self.scales.of(kind)
    }

    pub(super) fn reading<'a>(&'a self, snapshot: Option<&'a Snapshot>) -> Reading<'a> {
        Reading::new(&self.handle, snapshot, &self.scales)
    }

    fn text_of(&self, attribute: Attribute) -> Option<String> {
        attribute.text(&self.reading(self.fresh().as_deref()))
    }

    /// Requests what was written to an operation's file.
    pub(super) fn ask(&self, operation: &'static dyn FileOperation, text: &[u8], done: Done<()>) {
        let snapshot = self.fresh();
        let reading = self.reading(snapshot.as_deref());
        let context = Context {
            chip: self.chip(),
            voltage_scale: reading.scale(Kind::Voltage),
            current_scale: reading.scale(Kind::Current),
            limitation: self.published().limitation(self.chip()),
        };
        operation.ask(&self.handle, &context, text, done);
    }
}

/// An item of a gauge's folder, beside `df`, `gauge` and `sim`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SupplyItem {
    /// The folder itself.
    Folder,
    /// A power_supply attribute.
    Attribute(Attribute),
    /// `uevent`.
    Uevent,
    /// `subsystem`.
    Subsystem,
}

impl SupplyItem {
    pub(super) fn of(self, supply: &Arc<Supply>) -> Box<dyn Operations + '_> {
        match self {
            SupplyItem::Folder => Box::new(Folder(supply)),
            SupplyItem::Attribute(attribute) => Box::new(Value { supply, attribute }),
            SupplyItem::Uevent => Box::new(Uevent(supply)),
            SupplyItem::Subsystem => Box::new(Subsystem(supply)),
        }
    }
}

struct Folder<'a>(&'a Supply);

impl Folder<'_> {
    fn rest(&self) -> Vec<(String, Node)> {
        let rest = [
            ("uevent", Some(Item::Supply(SupplyItem::Uevent))),
            ("subsystem", Some(Item::Supply(SupplyItem::Subsystem))),
            ("df", self.0.has_own_table().then_some(Item::Df(DfItem::Folder))),
            ("gauge", Some(Item::Gauge(GaugeItem::Folder))),
            ("sim", self.0.knobs.is_some().then_some(Item::Sim(SimItem::Folder))),
        ];
        let there = rest.into_iter().filter_map(|(name, item)| Some((name, item?)));
        there.map(|(name, item)| (name.to_string(), self.0.node(item))).collect()
    }

    fn attribute(&self, attribute: Attribute) -> Node {
        self.0.node(Item::Supply(SupplyItem::Attribute(attribute)))
    }
}

impl Operations for Folder<'_> {
    fn parent(&self) -> Node {
        Node::Root
    }

    fn shape(&self) -> Shape {
        Shape::Folder
    }

    fn list(&self) -> Vec<(String, Node)> {
        let snapshot = self.0.fresh();
        let reading = self.0.reading(snapshot.as_deref());
        let there = Attribute::all().filter(|attribute| attribute.text(&reading).is_some());
        let attributes = there.map(|attribute| (attribute.name().to_string(), self.attribute(attribute)));
        attributes.chain(self.rest()).collect()
    }

    /// Renders only the attribute that is looked up.
    fn lookup(&self, name: &str) -> Option<Node> {
        match Attribute::by_name(name) {
            Some(attribute) => self.0.text_of(attribute).map(|_| self.attribute(attribute)),
            None => find(self.rest(), name),
        }
    }
}

struct Value<'a> {
    supply: &'a Supply,
    attribute: Attribute,
}

impl Operations for Value<'_> {
    fn parent(&self) -> Node {
        self.supply.folder()
    }

    fn name(&self) -> Option<&'static str> {
        Some(self.attribute.name())
    }

    fn may_be_cached(&self) -> bool {
        true
    }

    fn content(&self) -> Content {
        self.supply.text_of(self.attribute).map(|text| text + "\n").into()
    }
}

struct Uevent<'a>(&'a Supply);

impl Operations for Uevent<'_> {
    fn parent(&self) -> Node {
        self.0.folder()
    }

    fn may_be_cached(&self) -> bool {
        true
    }

    fn content(&self) -> Content {
        let snapshot = self.0.fresh();
        Some(attribute::uevent(&self.0.name, &self.0.reading(snapshot.as_deref()))).into()
    }
}

struct Subsystem<'a>(&'a Supply);

impl Operations for Subsystem<'_> {
    fn parent(&self) -> Node {
        self.0.folder()
    }

    fn shape(&self) -> Shape {
        Shape::Link
    }

    fn target(&self) -> Option<String> {
        Some(SUBSYSTEM.into())
    }
}
