// SPDX-License-Identifier: MIT

//! `sim/`: the knobs of a simulated gauge, one file each.

use nix::errno::Errno;

use super::{Content, Item, Mode, Node, Of, Operations, Shape, SupplyItem, not_writable};
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

impl Of<'_, SimItem> {
    fn knobs(&self) -> Vec<(&'static str, bool)> {
        self.supply.knobs.as_ref().map(|knobs| knobs.list()).unwrap_or_default()
    }

    /// Name of the knob, and whether it may be written; `None` for the folder.
    fn knob(&self) -> Option<(&'static str, bool)> {
        match self.item {
            SimItem::Folder => None,
            SimItem::Knob(at) => self.knobs().get(usize::from(at)).copied(),
        }
    }
}

impl Operations for Of<'_, SimItem> {
    fn parent(&self) -> Node {
        self.supply.node(match self.item {
            SimItem::Folder => Item::Supply(SupplyItem::Folder),
            SimItem::Knob(_) => Item::Sim(SimItem::Folder),
        })
    }

    fn shape(&self) -> Shape {
        if self.item == SimItem::Folder { Shape::Folder } else { Shape::File }
    }

    fn mode(&self) -> Mode {
        if self.knob().is_some_and(|(_, writable)| writable) { Mode::ReadWrite } else { Mode::Read }
    }

    fn list(&self) -> Vec<(String, Node)> {
        if self.item != SimItem::Folder {
            return Vec::new();
        }
        let node = |at| self.supply.node(Item::Sim(SimItem::Knob(at)));
        (0..).zip(self.knobs()).map(|(at, (name, _))| (name.to_string(), node(at))).collect()
    }

    fn content(&self) -> Content {
        let text = self.supply.knobs.as_ref().zip(self.knob()).and_then(|(knobs, (name, _))| knobs.get(name));
        text.map(|text| text + "\n").into()
    }

    fn write(&self, data: &[u8], done: Done<()>) {
        let knob = self.supply.knobs.as_ref().zip(self.knob());
        if knob.is_some_and(|(_, (_, writable))| !writable) {
            return done(Err(not_writable()));
        }
        let Some((knobs, (name, _))) = knob else {
            return done(Err(Error::host("", Errno::ENODEV, "the simulated gauge has no such knob")));
        };
        let text = std::str::from_utf8(data).unwrap_or_default().trim();
        let attempt = Attempt::Knob(name);
        match knobs.set(name, text) {
            Ok(()) => {
                self.supply.handle.succeeded(&attempt);
                done(Ok(()));
            }
            // The knob is named as the file that it is.
            Err(error) => self.supply.handle.refuse(attempt, error.about(format!("sim/{name}")), done),
        }
    }
}
