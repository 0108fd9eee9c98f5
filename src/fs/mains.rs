// SPDX-License-Identifier: MIT

//! The Mains supply beside the gauges, which looks like those of the kernel's drivers. No gauge measures the mains: the
//! packs' `status` decides whether they supply power.

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

impl MainsItem {
    pub(super) fn of(self, fs: &Fs) -> Box<dyn Operations + '_> {
        match self {
            MainsItem::Folder => Box::new(Folder(fs)),
            MainsItem::Type => Box::new(Type),
            MainsItem::Online => Box::new(Online(fs)),
            MainsItem::Uevent => Box::new(Uevent(fs)),
            MainsItem::Subsystem => Box::new(Subsystem),
        }
    }
}

struct Folder<'a>(&'a Fs);

impl Operations for Folder<'_> {
    fn parent(&self) -> Node {
        Node::Root
    }

    fn shape(&self) -> Shape {
        Shape::Folder
    }

    fn list(&self) -> Vec<(String, Node)> {
        let files = [
            ("type", Some(MainsItem::Type)),
            ("online", is_online(self.0).map(|_| MainsItem::Online)),
            ("uevent", Some(MainsItem::Uevent)),
            ("subsystem", Some(MainsItem::Subsystem)),
        ];
        files.into_iter().filter_map(|(name, item)| Some((name.to_string(), Node::Mains(item?)))).collect()
    }
}

struct Type;

impl Operations for Type {
    fn parent(&self) -> Node {
        Node::Mains(MainsItem::Folder)
    }

    fn may_be_cached(&self) -> bool {
        true
    }

    fn content(&self) -> Content {
        Content::Bytes(b"Mains\n".as_slice().into())
    }
}

struct Online<'a>(&'a Fs);

impl Operations for Online<'_> {
    fn parent(&self) -> Node {
        Node::Mains(MainsItem::Folder)
    }

    fn name(&self) -> Option<&'static str> {
        Some("online")
    }

    fn may_be_cached(&self) -> bool {
        true
    }

    fn content(&self) -> Content {
        is_online(self.0).map(|online| format!("{}\n", u8::from(online))).into()
    }
}

struct Uevent<'a>(&'a Fs);

impl Operations for Uevent<'_> {
    fn parent(&self) -> Node {
        Node::Mains(MainsItem::Folder)
    }

    fn may_be_cached(&self) -> bool {
        true
    }

    fn content(&self) -> Content {
        let name = plain(self.0.mains.as_deref().unwrap_or_default());
        let online = is_online(self.0).map(|online| format!("POWER_SUPPLY_ONLINE={}\n", u8::from(online)));
        let online = online.unwrap_or_default();
        Some(format!("POWER_SUPPLY_NAME={name}\nPOWER_SUPPLY_TYPE=Mains\n{online}")).into()
    }
}

struct Subsystem;

impl Operations for Subsystem {
    fn parent(&self) -> Node {
        Node::Mains(MainsItem::Folder)
    }

    fn shape(&self) -> Shape {
        Shape::Link
    }

    fn target(&self) -> Option<String> {
        Some(SUBSYSTEM.into())
    }
}

/// Whether the mains supply power. Gauges without a pack, without a measurement yet, or of a primary cell, which the
/// mains never charge, do not count.
fn is_online(fs: &Fs) -> Option<bool> {
    let gauges = fs.supplies.iter().filter(|supply| supply.chip().condition.primary.is_none());
    let statuses = gauges.filter_map(|supply| {
        let snapshot = supply.fresh();
        let reading = supply.reading(snapshot.as_deref());
        reading.status().filter(|&status| status != "Unknown")
    });
    online(&statuses.collect::<Vec<_>>())
}

/// Whether the mains supply power, by the status of each pack. A charging pack gets power from them. Otherwise a
/// discharging pack shows that the load gets none either; a second pack at rest says nothing.
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
