// SPDX-License-Identifier: MIT

//! The mount point: a folder for each gauge, the Mains supply, and the kernel's supplies underneath.

use std::collections::{BTreeSet, HashSet};

use super::{Fs, Item, MainsItem, Node, Operations, Shape, SimItem, SupplyItem, find};

/// The mount point.
pub(super) struct Root<'a>(pub(super) &'a Fs);

impl Root<'_> {
    fn own(&self) -> Vec<(String, Node)> {
        let folder = |index| Node::Of(index, Item::Supply(SupplyItem::Folder));
        let gauges = self.0.supplies.iter().map(|supply| (supply.name.clone(), folder(supply.index)));
        let mains = self.0.mains.clone().map(|name| (name, Node::Mains(MainsItem::Folder)));
        gauges.chain(self.knobs()).chain(mains).collect()
    }

    /// The knobs of the only gauge, or a folder for each.
    fn knobs(&self) -> Vec<(String, Node)> {
        if let [_] = self.0.knobs[..] {
            return self.0.sim_dir(0).list();
        }
        let folder = |index| Node::Of(index, Item::Sim(SimItem::Folder));
        (0..).zip(&self.0.knobs).map(|(index, (name, _))| (name.clone(), folder(index))).collect()
    }
}

impl Operations for Root<'_> {
    fn parent(&self) -> Node {
        Node::Root
    }

    fn shape(&self) -> Shape {
        Shape::Folder
    }

    /// A gauge hides the kernel's supply of the same name.
    fn list(&self) -> Vec<(String, Node)> {
        let mut list = self.own();
        let Some(covered) = &self.0.covered else { return list };
        let taken: BTreeSet<String> = list.iter().map(|(name, _)| name.clone()).collect();
        let (hidden, shown): (BTreeSet<_>, BTreeSet<_>) =
            covered.names().into_iter().partition(|name| taken.contains(name));
        covered.log_hidden(hidden);
        list.extend(shown.into_iter().map(|name| (name.clone(), Node::Covered(covered.number(&name)))));
        list
    }

    /// Looks at the one name only: there may be many gauges, and many names in the covered folder.
    fn lookup(&self, name: &str) -> Option<Node> {
        let gauge = self.0.supplies.iter().find(|supply| supply.name == name).map(|supply| supply.folder());
        gauge.or_else(|| find(self.own(), name)).or_else(|| {
            let covered = self.0.covered.as_ref()?;
            covered.target(name).map(|_| Node::Covered(covered.number(name)))
        })
    }
}

/// The unused names among STEM0, STEM1 ...
pub fn free_names(stem: &str, taken: &HashSet<&str>) -> impl Iterator<Item = String> {
    (0..).map(move |number| format!("{stem}{number}")).filter(|name| !taken.contains(name.as_str()))
}
