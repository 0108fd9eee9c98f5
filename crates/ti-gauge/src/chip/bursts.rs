// SPDX-License-Identifier: MIT

//! Which reads fetch the registers of a map of addresses.

use super::{Register, Tier};

/// The longest gap that one read spans: a second read costs the gauge's address twice and the register's.
const GAP: u8 = 3;

/// The reads that fetch all commands of the tiers in the fewest bytes. Overlapping addresses are read apart.
pub fn bursts(registers: &[Register], wanted: impl Fn(Tier) -> bool) -> Vec<(u8, u8)> {
    let mut bursts: Vec<(u8, u8)> = Vec::new();
    for register in registers.iter().filter(|register| wanted(register.tier)) {
        let Some(code) = register.source.command() else { continue };
        let end = code + register.size;
        match bursts.last_mut() {
            Some((start, length)) if (*start + *length..=*start + *length + GAP).contains(&code) => {
                *length = end - *start;
            }
            _ => bursts.push((code, register.size)),
        }
    }
    bursts
}
