//! The Mains supply beside the gauges, as the kernel's drivers for one look. No gauge measures the mains:
//! whether there is one is concluded from what they say of their packs.

use super::Content;
use super::attribute::plain;

/// What the folder of the Mains supply holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MainsItem {
    /// The folder.
    Folder,
    /// `Mains`.
    Type,
    /// 1 or 0; absent while no gauge tells.
    Online,
    /// `uevent`.
    Uevent,
    /// `subsystem`.
    Subsystem,
}

/// All but the folder.
pub(super) const FILES: [MainsItem; 4] =
    [MainsItem::Type, MainsItem::Online, MainsItem::Uevent, MainsItem::Subsystem];

impl MainsItem {
    pub(super) fn name(self) -> &'static str {
        match self {
            MainsItem::Folder => "",
            MainsItem::Type => "type",
            MainsItem::Online => "online",
            MainsItem::Uevent => "uevent",
            MainsItem::Subsystem => "subsystem",
        }
    }
}

/// Whether the mains feed the packs, by the status of each. A pack that is charged is fed; where none is,
/// one that is discharged says that nothing else feeds the load. One that rests beside it says nothing.
pub(super) fn online(statuses: &[&str]) -> Option<bool> {
    let any = |wanted: &str| statuses.iter().any(|status| *status == wanted);
    (!statuses.is_empty()).then(|| any("Charging") || !any("Discharging"))
}

pub(super) fn content(item: MainsItem, name: &str, online: Option<bool>) -> Content {
    let online = online.map(u8::from);
    let text = match item {
        MainsItem::Folder | MainsItem::Subsystem => None,
        MainsItem::Type => Some("Mains\n".to_string()),
        MainsItem::Online => online.map(|online| format!("{online}\n")),
        MainsItem::Uevent => {
            let line = online.map(|online| format!("POWER_SUPPLY_ONLINE={online}\n")).unwrap_or_default();
            Some(format!("POWER_SUPPLY_NAME={}\nPOWER_SUPPLY_TYPE=Mains\n{line}", plain(name)))
        }
    };
    text.map_or(Content::Absent, |text| Content::Bytes(text.into_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mains_are_concluded_from_all_packs() {
        let told = |statuses: &[&str]| online(statuses);
        assert_eq!(told(&[]), None);
        for (status, expected) in
            [("Charging", true), ("Full", true), ("Not charging", true), ("Discharging", false)]
        {
            assert_eq!(told(&[status]), Some(expected), "{status}");
        }
        // Two packs, one after the other: the one that rests does not stand for the mains.
        assert_eq!(told(&["Not charging", "Discharging"]), Some(false));
        assert_eq!(told(&["Discharging", "Charging"]), Some(true));
    }
}
