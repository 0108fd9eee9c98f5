// SPDX-License-Identifier: MIT

//! Which device answers at ROM mode's address, which is that of a Smart Battery as well. Only registers are read: what
//! the boot loader takes for its buffer and its sum, a Smart Battery takes for commands.
//!
//! - A Smart Battery has a word at each command code. SpecificationInfo(), 0x1A, has few values (Smart Battery Data 1.1,
//!   5.1.25). They might come from a buffer by chance, so other words and DeviceChemistry() must fit as well.
//! - A boot loader has a byte at each register, in a buffer from 0x00 on: drivers read a row at 0x04 at once, or its bytes
//!   one by one at 0x04 to 0x63. So the words at two registers in a row share a byte.
//!
//! The same byte everywhere proves neither: a stuck line, or a Smart Battery that ignores a repeated START.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use super::{RESULT, fetch, repeat};
use crate::chip::sbs::{SPECIFICATION_INFO, is_specification};
use crate::error::Result;
use crate::probe::answers_in_rom;
use gauge_bus::clock::Clock;
use gauge_bus::{Bus, BusError, Packet};

const TEMPERATURE: u8 = 0x08;
const VOLTAGE: u8 = 0x09;
const BATTERY_STATUS: u8 = 0x16;
const DESIGN_VOLTAGE: u8 = 0x19;
const DEVICE_CHEMISTRY: u8 = 0x22;
/// Command codes with words that are read without effect, and next to each other.
const WORDS: [RangeInclusive<u8>; 2] = [TEMPERATURE..=0x0a, BATTERY_STATUS..=0x1c];
/// Reserved bits of BatteryStatus(), 13 and 10.
const RESERVED: u16 = 0x2400;
/// -50 to 100 degrees Celsius, in 0.1 K.
const TEMPERATURES: RangeInclusive<u16> = 2231..=3731;

/// A device at ROM mode's address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Device {
    /// It has a byte at each register, as a boot loader has.
    BootLoader,
    /// It reads like a Smart Battery.
    SmartBattery,
    /// It may be the one or the other, or a third.
    Unclear,
}

/// The device that answers there, if one does.
pub fn find(bus: &mut dyn Bus, clock: &dyn Clock) -> Result<Option<Device>> {
    match answers_in_rom(bus)? {
        true => device(bus, clock).map(Some),
        false => Ok(None),
    }
}

/// Tells which device answers there. Nothing is written but the numbers of registers.
pub fn device(bus: &mut dyn Bus, clock: &dyn Clock) -> Result<Device> {
    let mut words = BTreeMap::new();
    // The first one fails if nobody is there.
    let mut word = [0; 2];
    fetch(bus, clock, SPECIFICATION_INFO, &mut word)?;
    words.insert(SPECIFICATION_INFO, word);
    for code in WORDS.into_iter().flatten().filter(|code| *code != SPECIFICATION_INFO) {
        if has(fetch(bus, clock, code, &mut word))? {
            words.insert(code, word);
        }
    }
    let chemistry = chemistry(bus, clock)?;
    Ok(match (is_battery(&words, &chemistry), shares_bytes(&words)) {
        (true, false) => Device::SmartBattery,
        (false, true) if !is_uniform(bus, clock, &words)? => Device::BootLoader,
        _ => Device::Unclear,
    })
}

/// Whether all of it is the same byte, with the register behind the buffer, which need not be like it.
fn is_uniform(bus: &mut dyn Bus, clock: &dyn Clock, words: &BTreeMap<u8, [u8; 2]>) -> Result<bool> {
    let mut result = [0];
    fetch(bus, clock, RESULT, &mut result)?;
    Ok(words.values().flatten().all(|byte| *byte == result[0]))
}

/// Whether a device that answers has a register: a Smart Battery may refuse a code.
fn has(read: std::result::Result<(), BusError>) -> Result<bool> {
    match read {
        Ok(()) => Ok(true),
        Err(error) if error.may_be_no_ack() => Ok(false),
        Err(error) => Err(error.into()),
    }
}

/// The text of DeviceChemistry(); empty if it is no block.
fn chemistry(bus: &mut dyn Bus, clock: &dyn Clock) -> Result<Vec<u8>> {
    let reach = bus.reach();
    if reach.smbus && reach.blocks {
        let packet = Packet { code: DEVICE_CHEMISTRY, is_block: true, pec: false };
        let mut block = Vec::new();
        return match repeat(clock, || bus.packet(packet).map(|read| block = read)) {
            Ok(()) => Ok(block.split_off(1)),
            Err(error) if error == BusError::NO_LENGTH || error.may_be_no_ack() => Ok(Vec::new()),
            Err(error) => Err(error.into()),
        };
    }
    let mut length = [0];
    if !has(fetch(bus, clock, DEVICE_CHEMISTRY, &mut length))? || !(1..=32).contains(&length[0]) {
        return Ok(Vec::new());
    }
    let mut block = vec![0; 1 + usize::from(length[0])];
    if !reach.carries(1, block.len()) {
        return Ok(Vec::new());
    }
    let read = has(fetch(bus, clock, DEVICE_CHEMISTRY, &mut block))?;
    Ok(if read && block[0] == length[0] { block.split_off(1) } else { Vec::new() })
}

fn is_battery(words: &BTreeMap<u8, [u8; 2]>, chemistry: &[u8]) -> bool {
    let word = |code| words.get(&code).map(|word| u16::from_le_bytes(*word));
    let fits = |code, fits: &dyn Fn(u16) -> bool| word(code).is_some_and(fits);
    fits(SPECIFICATION_INFO, &is_specification)
        && fits(TEMPERATURE, &|kelvin| TEMPERATURES.contains(&kelvin))
        && fits(VOLTAGE, &|voltage| voltage != 0)
        && fits(DESIGN_VOLTAGE, &|voltage| voltage != 0)
        && fits(BATTERY_STATUS, &|status| status & RESERVED == 0)
        && !chemistry.is_empty()
        && chemistry.iter().all(|byte| (b' '..=b'~').contains(byte))
}

fn shares_bytes(words: &BTreeMap<u8, [u8; 2]>) -> bool {
    let shares = |code: u8| match (words.get(&code), words.get(&(code + 1))) {
        (Some(word), Some(next)) => word[1] == next[0],
        _ => false,
    };
    WORDS.into_iter().all(|codes| (*codes.start()..*codes.end()).all(shares))
}
