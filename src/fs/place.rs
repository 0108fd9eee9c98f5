// SPDX-License-Identifier: MIT

//! The number of each node, and back: nothing is remembered of shown nodes.

use std::ops::RangeInclusive;

use super::{Attribute, DfItem, GaugeItem, Item, MainsItem, Node, SimItem, SupplyItem};

/// Numbers of `df/SUBCLASS/OFFSET` and of links to them, among those of a gauge's items.
const PARAMETER: u16 = 0x8000;
const LINK: u16 = 0xc000;
/// Number of the first group of `gauge/`, in the upper byte.
const MEMBER: u8 = 0x20;
/// Numbers from here on are links in the folder underneath the mount, after those of 32 766 gauges.
const COVERED: u32 = 1 << 31;

impl Node {
    /// The number, 1 or more.
    pub fn place(self) -> u32 {
        match self {
            Node::Root => 1,
            Node::Mains(MainsItem::Folder) => 2,
            Node::Mains(MainsItem::Type) => 3,
            Node::Mains(MainsItem::Online) => 4,
            Node::Mains(MainsItem::Uevent) => 5,
            Node::Mains(MainsItem::Subsystem) => 6,
            Node::Covered(number) => COVERED | number,
            Node::Of(gauge, item) => (u32::from(gauge) + 1) << 16 | u32::from(item.place()),
        }
    }

    /// The numbers of a gauge's nodes.
    pub fn of_gauge(gauge: u16) -> RangeInclusive<u32> {
        let first = (u32::from(gauge) + 1) << 16;
        first..=first | u32::from(u16::MAX)
    }

    /// The numbers of the Mains supply's nodes.
    pub fn of_mains() -> RangeInclusive<u32> {
        let place = |item| Node::Mains(item).place();
        place(MainsItem::Folder)..=place(MainsItem::Subsystem)
    }

    /// The node of that number.
    pub fn at(place: u32) -> Option<Self> {
        Some(match place {
            1 => Node::Root,
            2 => Node::Mains(MainsItem::Folder),
            3 => Node::Mains(MainsItem::Type),
            4 => Node::Mains(MainsItem::Online),
            5 => Node::Mains(MainsItem::Uevent),
            6 => Node::Mains(MainsItem::Subsystem),
            COVERED.. => Node::Covered(place - COVERED),
            _ => Node::Of((place >> 16).checked_sub(1)? as u16, Item::at(place as u16)?),
        })
    }
}

impl Item {
    fn place(self) -> u16 {
        let [high, low] = match self {
            Item::Supply(SupplyItem::Folder) => [0, 0],
            Item::Supply(SupplyItem::Uevent) => [0, 1],
            Item::Supply(SupplyItem::Subsystem) => [0, 2],
            Item::Supply(SupplyItem::Attribute(Attribute(at))) => [1, at],
            Item::Df(DfItem::Folder) => [2, 0],
            Item::Df(DfItem::Index) => [2, 1],
            Item::Df(DfItem::Transaction) => [2, 2],
            Item::Df(DfItem::Flat) => [2, 3],
            Item::Df(DfItem::ByName) => [2, 4],
            Item::Df(DfItem::Subclass(at)) => [3, at],
            Item::Df(DfItem::Raw(at)) => [4, at],
            Item::Df(DfItem::Class(at)) => [5, at],
            Item::Df(DfItem::Parameter(at, row)) => return PARAMETER | u16::from(row) << 7 | u16::from(at),
            Item::Df(DfItem::Link(at, row)) => return LINK | u16::from(row) << 7 | u16::from(at),
            Item::Gauge(GaugeItem::Folder) => [6, 0],
            Item::Gauge(GaugeItem::File(at)) => [7, at],
            Item::Gauge(GaugeItem::Group(at)) => [8, at],
            Item::Gauge(GaugeItem::Member(group, number)) => [MEMBER + group, number],
            Item::Sim(SimItem::Folder) => [9, 0],
            Item::Sim(SimItem::Knob(at)) => [10, at],
        };
        u16::from_be_bytes([high, low])
    }

    fn at(place: u16) -> Option<Self> {
        let (at, row) = ((place & 0x7f) as u8, (place >> 7 & 0x7f) as u8);
        Some(match place.to_be_bytes() {
            _ if place >= LINK => Item::Df(DfItem::Link(at, row)),
            _ if place >= PARAMETER => Item::Df(DfItem::Parameter(at, row)),
            [0, 0] => Item::Supply(SupplyItem::Folder),
            [0, 1] => Item::Supply(SupplyItem::Uevent),
            [0, 2] => Item::Supply(SupplyItem::Subsystem),
            [1, at] => Item::Supply(SupplyItem::Attribute(Attribute(at))),
            [2, 0] => Item::Df(DfItem::Folder),
            [2, 1] => Item::Df(DfItem::Index),
            [2, 2] => Item::Df(DfItem::Transaction),
            [2, 3] => Item::Df(DfItem::Flat),
            [2, 4] => Item::Df(DfItem::ByName),
            [3, at] => Item::Df(DfItem::Subclass(at)),
            [4, at] => Item::Df(DfItem::Raw(at)),
            [5, at] => Item::Df(DfItem::Class(at)),
            [6, 0] => Item::Gauge(GaugeItem::Folder),
            [7, at] => Item::Gauge(GaugeItem::File(at)),
            [8, at] => Item::Gauge(GaugeItem::Group(at)),
            [9, 0] => Item::Sim(SimItem::Folder),
            [10, at] => Item::Sim(SimItem::Knob(at)),
            [high, number] if high >= MEMBER => Item::Gauge(GaugeItem::Member(high - MEMBER, number)),
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ti_gauge::chip::Chip;

    #[test]
    fn a_node_follows_from_its_number() {
        let mains =
            [MainsItem::Folder, MainsItem::Type, MainsItem::Online, MainsItem::Uevent, MainsItem::Subsystem];
        for node in
            mains.map(Node::Mains).into_iter().chain([Node::Root, Node::Covered(0), Node::Covered(70_000)])
        {
            assert_eq!(Node::at(node.place()), Some(node));
        }
        // Every other number belongs to no item.
        let items = (0..=u16::MAX).filter_map(|place| Some((place, Item::at(place)?)));
        for (place, item) in items {
            assert_eq!(item.place(), place, "{item:?}");
            for gauge in [0, 1, 511, 32_765] {
                let node = Node::Of(gauge, item);
                assert_eq!(Node::at(node.place()), Some(node));
                assert!(
                    Node::of_gauge(gauge).contains(&node.place())
                        && !Node::of_gauge(gauge + 1).contains(&node.place())
                );
            }
        }
        assert!(mains.iter().all(|&item| Node::of_mains().contains(&Node::Mains(item).place())));
        assert_eq!(Node::at(0), None);
    }

    #[test]
    fn every_table_fits() {
        for chip in Chip::all() {
            assert!(chip.subclasses.len() <= 128 && chip.registers.len() <= 256, "{}", chip.name);
            let rows = chip.subclasses.iter().map(|subclass| subclass.parameters.len()).max();
            assert!(rows.unwrap_or_default() <= 128, "{}", chip.name);
        }
    }
}
