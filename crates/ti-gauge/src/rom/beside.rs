// SPDX-License-Identifier: MIT

//! What answers at the addresses next to a Smart Battery's: its charger, or a manager of several. Only words are read.
//!
//! - ChargerSpecInfo(), 0x11, has a version of 1 to 3, a bit for a selector, and zeros (Smart Battery Charger 1.1).
//! - BatterySystemInfo(), 0x04, has the packs that a manager takes, and BatterySystemState(), 0x01, those of them that are
//!   there (Smart Battery System Manager 1.1).

use super::fetch;
use crate::error::Result;
use gauge_bus::Bus;
use gauge_bus::clock::Clock;

const CHARGER_STATUS: u8 = 0x13;
const CHARGER_SPEC_INFO: u8 = 0x11;
const SYSTEM_STATE: u8 = 0x01;
const SYSTEM_INFO: u8 = 0x04;
/// Of both words, a bit for each pack.
const PACKS: u16 = 0xf;

/// A device with an address of its own beside Smart Batteries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Beside {
    /// A Smart Battery Charger.
    Charger,
    /// A Smart Battery System Manager, or a selector.
    Manager,
}

impl Beside {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Charger, Self::Manager];

    /// Its address.
    pub const fn address(self) -> u8 {
        match self {
            Self::Charger => 0x09,
            Self::Manager => 0x0a,
        }
    }

    /// The one that has this address.
    pub fn at(address: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|one| one.address() == address)
    }

    /// Whether what answers at its address reads like one. Nothing is written but command codes.
    pub fn reads_like(self, bus: &mut dyn Bus, clock: &dyn Clock) -> Result<bool> {
        let mut word = |code| {
            let mut bytes = [0; 2];
            fetch(bus, clock, code, &mut bytes).map(|()| u16::from_le_bytes(bytes))
        };
        Ok(match self {
            Self::Charger => {
                let (info, status) = (word(CHARGER_SPEC_INFO)?, word(CHARGER_STATUS)?);
                (1..=3).contains(&(info & 0xf)) && info & 0xffe0 == 0 && status != info
            }
            Self::Manager => {
                let (info, state) = (word(SYSTEM_INFO)?, word(SYSTEM_STATE)?);
                info & PACKS != 0 && info & 0xff00 == 0 && state & PACKS & !info == 0 && state != info
            }
        })
    }
}
