// SPDX-License-Identifier: MIT

//! `sim/`: the knobs of a simulated gauge, one file each.

use std::sync::Arc;

use nix::errno::Errno;

use super::caller::Caller;
use super::supply::Supply;
use super::{Content, Item, Knobs, Mode, Node, Operations, Shape, not_writable};
use crate::error::Error;
use gauge_owner::{Attempt, Done};

/// An item of `sim/`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SimItem {
    /// The folder itself.
    Folder,
    /// The knob of that index.
    Knob(u8),
}

impl SimItem {
    pub(super) fn of(self, supply: &Arc<Supply>) -> Box<dyn Operations + '_> {
        match self {
            SimItem::Folder => Box::new(Folder(supply)),
            SimItem::Knob(at) => Box::new(Knob { supply, at }),
        }
    }
}

struct Folder<'a>(&'a Supply);

impl Operations for Folder<'_> {
    fn parent(&self) -> Node {
        self.0.folder()
    }

    fn shape(&self) -> Shape {
        Shape::Folder
    }

    fn list(&self) -> Vec<(String, Node)> {
        let knobs = self.0.knobs.as_ref().map(|knobs| knobs.list()).unwrap_or_default();
        let knobs = (0..).zip(knobs);
        knobs.map(|(at, (name, _))| (name.to_string(), self.0.node(Item::Sim(SimItem::Knob(at))))).collect()
    }
}

struct Knob<'a> {
    supply: &'a Supply,
    at: u8,
}

impl<'a> Knob<'a> {
    /// All knobs, this one's name, and whether it is writable.
    fn find(&self) -> Option<(&'a dyn Knobs, &'static str, bool)> {
        let knobs = self.supply.knobs.as_deref()?;
        let (name, writable) = *knobs.list().get(usize::from(self.at))?;
        Some((knobs, name, writable))
    }
}

impl Operations for Knob<'_> {
    fn parent(&self) -> Node {
        self.supply.node(Item::Sim(SimItem::Folder))
    }

    fn mode(&self) -> Mode {
        if self.find().is_some_and(|(_, _, writable)| writable) { Mode::ReadWrite } else { Mode::Read }
    }

    fn content(&self) -> Content {
        let text = self.find().and_then(|(knobs, name, _)| knobs.get(name));
        text.map(|text| text + "\n").into()
    }

    fn write(&self, _: Caller, data: &[u8], done: Done<()>) {
        let (knobs, name) = match self.find() {
            Some((knobs, name, true)) => (knobs, name),
            Some((_, _, false)) => return done(Err(not_writable())),
            None => return done(Err(Error::host("", Errno::ENODEV, "the simulated gauge has no such knob"))),
        };
        let text = std::str::from_utf8(data).unwrap_or_default().trim();
        let attempt = Attempt::Knob(name);
        match knobs.set(name, text) {
            Ok(()) => {
                self.supply.handle.succeeded(&attempt);
                done(Ok(()));
            }
            // The error names the file.
            Err(error) => self.supply.handle.refuse(attempt, error.about(format!("sim/{name}")), done),
        }
    }
}
