// SPDX-License-Identifier: MIT

//! The Mains supply beside the gauges, which looks like those of the kernel's drivers. No gauge measures the
//! mains: whether they supply power is concluded from the packs' `status`.

use super::attribute::plain;
use super::{Content, Fs, Node, Operations, SUBSYSTEM, Shape};

/// An item of the folder of the Mains supply.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MainsItem {
    /// The folder itself.
    Folder,
    /// `type`: `Mains`.
    Type,
    /// `online`: 1 or 0; absent while no gauge allows a conclusion.
    Online,
    /// `uevent`.
    Uevent,
    /// `subsystem`.
    Subsystem,
}

/// The folder of the Mains supply, or something in it.
pub(super) struct Mains<'a> {
    pub(super) fs: &'a Fs,
    pub(super) item: MainsItem,
}

impl Mains<'_> {
    /// Whether the mains supply power. A gauge without a pack has no say, nor has one that has not measured
    /// yet, or one of a primary cell, which the mains never charge.
    fn online(&self) -> Option<bool> {
        let gauges = self.fs.supplies.iter().filter(|supply| supply.chip().condition.primary.is_none());
        let statuses = gauges.filter_map(|supply| {
            let snapshot = supply.fresh();
            let reading = supply.reading(snapshot.as_deref());
            reading.status().filter(|&status| status != "Unknown")
        });
        online(&statuses.collect::<Vec<_>>())
    }
}

impl Operations for Mains<'_> {
    fn parent(&self) -> Node {
        match self.item {
            MainsItem::Folder => Node::Root,
            _ => Node::Mains(MainsItem::Folder),
        }
    }

    fn shape(&self) -> Shape {
        match self.item {
            MainsItem::Folder => Shape::Folder,
            MainsItem::Subsystem => Shape::Link,
            MainsItem::Type | MainsItem::Online | MainsItem::Uevent => Shape::File,
        }
    }

    fn name(&self) -> Option<&'static str> {
        (self.item == MainsItem::Online).then_some("online")
    }

    fn list(&self) -> Vec<(String, Node)> {
        if self.item != MainsItem::Folder {
            return Vec::new();
        }
        let files = [
            ("type", Some(MainsItem::Type)),
            ("online", self.online().map(|_| MainsItem::Online)),
            ("uevent", Some(MainsItem::Uevent)),
            ("subsystem", Some(MainsItem::Subsystem)),
        ];
        files.into_iter().filter_map(|(name, item)| Some((name.to_string(), Node::Mains(item?)))).collect()
    }

    fn may_be_cached(&self) -> bool {
        true
    }

    fn content(&self) -> Content {
        let online = || self.online().map(u8::from);
        let text = match self.item {
            MainsItem::Folder | MainsItem::Subsystem => None,
            MainsItem::Type => Some("Mains\n".to_string()),
            MainsItem::Online => online().map(|online| format!("{online}\n")),
            MainsItem::Uevent => {
                let name = plain(self.fs.mains.as_deref().unwrap_or_default());
                let online = online().map(|online| format!("POWER_SUPPLY_ONLINE={online}\n"));
                let online = online.unwrap_or_default();
                Some(format!("POWER_SUPPLY_NAME={name}\nPOWER_SUPPLY_TYPE=Mains\n{online}"))
            }
        };
        text.into()
    }

    fn target(&self) -> Option<String> {
        (self.item == MainsItem::Subsystem).then(|| SUBSYSTEM.into())
    }
}

/// Whether the mains supply power, concluded from the status of each pack. A pack that is being charged gets
/// power from them. If none is, a pack that is being discharged shows that the load gets none from them either;
/// a second pack at rest beside it says nothing.
fn online(statuses: &[&str]) -> Option<bool> {
    let any = |wanted: &str| statuses.contains(&wanted);
    (!statuses.is_empty()).then(|| any("Charging") || !any("Discharging"))
}

#[cfg(test)]
mod tests {
    use super::online;

    #[test]
    fn all_packs_decide_whether_the_mains_supply_power() {
        assert_eq!(online(&[]), None);
        for (status, expected) in
            [("Charging", true), ("Full", true), ("Not charging", true), ("Discharging", false)]
        {
            assert_eq!(online(&[status]), Some(expected), "{status}");
        }
        // Two packs used one after the other: the one at rest does not mean that the mains are there.
        assert_eq!(online(&["Not charging", "Discharging"]), Some(false));
        assert_eq!(online(&["Discharging", "Charging"]), Some(true));
    }
}
