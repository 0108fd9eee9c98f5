// SPDX-License-Identifier: MIT

//! A chip's registers as bytes: which reads fetch them, and what the bytes mean.
//!
//! TI calls a register a standard command. All are at addresses below 0x80, least significant byte first.

use crate::chip::{Register, Tier};
use crate::error::Result;
use crate::gauge::Gauge;

/// Addresses that registers can have.
const ADDRESSES: usize = 128;

/// The longest gap between two registers that one read spans. A second read would cost as much: the gauge's
/// address twice and the register's.
const GAP: u8 = 3;

/// The bytes of a gauge's registers, each as it was last read.
#[derive(Clone, Debug)]
pub struct Registers {
    bytes: [u8; ADDRESSES],
    /// Bit n is set once the byte at address n has been read.
    known: u128,
}

impl Registers {
    /// None has been read.
    pub const UNREAD: Self = Self { bytes: [0; ADDRESSES], known: 0 };

    /// Reads the registers of the wanted tiers. If a read fails, the bytes that it was for keep their values.
    pub fn read(&mut self, gauge: &mut Gauge, wanted: impl Fn(Tier) -> bool) -> Result<()> {
        let mut bursts = bursts(gauge.chip.registers, wanted).into_iter();
        bursts.try_for_each(|(start, length)| self.read_span(gauge, start, length))
    }

    /// Reads that many bytes from an address on.
    pub(crate) fn read_span(&mut self, gauge: &mut Gauge, start: u8, length: u8) -> Result<()> {
        let mut bytes = [0; ADDRESSES];
        let bytes = &mut bytes[..usize::from(length)];
        gauge.read(start, bytes)?;
        self.store(start, bytes);
        Ok(())
    }

    fn store(&mut self, start: u8, bytes: &[u8]) {
        for (at, &byte) in (usize::from(start)..).zip(bytes) {
            self.bytes[at] = byte;
            self.known |= 1 << at;
        }
    }

    /// The value of a register, sign applied; `None` unless all of its bytes have been read.
    pub fn value(&self, register: &Register) -> Option<i64> {
        let (start, size) = (usize::from(register.source.command()?), usize::from(register.size));
        if (start..start + size).any(|at| self.known >> at & 1 == 0) {
            return None;
        }
        let bytes = &self.bytes[start..start + size];
        let raw = bytes.iter().rev().fold(0, |sum, &byte| sum << 8 | i64::from(byte));
        let unused = 64 - 8 * size;
        Some(if register.signed { raw << unused >> unused } else { raw })
    }

    /// Whether every byte that has been read is this one.
    pub fn hold_only(&self, byte: u8) -> bool {
        self.bytes.iter().enumerate().all(|(at, &found)| self.known >> at & 1 == 0 || found == byte)
    }
}

/// Address and length of the reads that fetch all registers of the wanted tiers in the fewest bytes.
pub fn bursts(registers: &[Register], wanted: impl Fn(Tier) -> bool) -> Vec<(u8, u8)> {
    let mut bursts: Vec<(u8, u8)> = Vec::new();
    for register in registers.iter().filter(|register| wanted(register.tier)) {
        let Some(code) = register.source.command() else { continue };
        let end = code + register.size;
        match bursts.last_mut() {
            Some((start, length)) if code <= *start + *length + GAP => {
                *length = (end - *start).max(*length);
            }
            _ => bursts.push((code, register.size)),
        }
    }
    bursts
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::chip::{Chip, Source};
    use crate::keys::Keys;
    use crate::value::Type;
    use gauge_bus::clock::SimClock;
    use gauge_bus::{Bus, BusError};

    const fn register(code: u8, kind: Type, tier: Tier) -> Register {
        Register::new(code, kind, "Register", "", tier)
    }

    /// What a register of that type reads, with these bytes at its address.
    fn decoded(kind: Type, bytes: &[u8]) -> Option<i64> {
        let mut registers = Registers::UNREAD;
        registers.store(0x10, bytes);
        registers.value(&register(0x10, kind, Tier::Poll))
    }

    #[test]
    fn words_are_little_endian_and_signed_where_the_table_says_so() {
        assert_eq!(decoded(Type::U(2), &[0x34, 0x12]), Some(0x1234));
        assert_eq!(decoded(Type::U(2), &[0xff, 0xff]), Some(65535));
        assert_eq!(decoded(Type::I(2), &[0xff, 0xff]), Some(-1));
        assert_eq!(decoded(Type::I(2), &[0x00, 0x80]), Some(-32768));
        assert_eq!(decoded(Type::I(2), &[0xff, 0x7f]), Some(32767));
        assert_eq!(decoded(Type::I(4), &[0xfe, 0xff, 0xff, 0xff]), Some(-2));
        assert_eq!(decoded(Type::U(4), &[0xfe, 0xff, 0xff, 0xff]), Some(0xffff_fffe));
    }

    #[test]
    fn a_register_may_have_one_byte() {
        assert_eq!(decoded(Type::U(1), &[0x80, 0xff]), Some(128));
        assert_eq!(decoded(Type::I(1), &[0x80, 0xff]), Some(-128));
    }

    #[test]
    fn a_register_has_no_value_until_all_its_bytes_are_read() {
        assert_eq!(decoded(Type::U(2), &[]), None);
        assert_eq!(decoded(Type::U(2), &[0x34]), None);
        let mut registers = Registers::UNREAD;
        let last = register(0x7e, Type::U(2), Tier::Poll);
        registers.store(0x7f, &[0x12]);
        assert_eq!(registers.value(&last), None);
        registers.store(0x7e, &[0x34]);
        assert_eq!(registers.value(&last), Some(0x1234));
    }

    #[test]
    fn only_bytes_that_were_read_are_compared() {
        let mut registers = Registers::UNREAD;
        registers.store(0x10, &[0xff, 0xff]);
        assert!(registers.hold_only(0xff));
        assert!(!registers.hold_only(0x00));
        registers.store(0x20, &[0xfe]);
        assert!(!registers.hold_only(0xff));
    }

    #[test]
    fn a_burst_spans_gaps_of_up_to_three_bytes() {
        let registers = [
            register(0x02, Type::U(2), Tier::Poll),
            register(0x05, Type::U(1), Tier::Slow),
            register(0x07, Type::U(1), Tier::Poll),
            register(0x0c, Type::U(2), Tier::Poll),
            register(0x0e, Type::U(2), Tier::Static),
        ];
        assert_eq!(bursts(&registers, |tier| tier == Tier::Poll), [(0x02, 6), (0x0c, 2)]);
        assert_eq!(bursts(&registers, |tier| tier != Tier::Poll), [(0x05, 1), (0x0e, 2)]);
        assert_eq!(bursts(&registers, |_| true), [(0x02, 6), (0x0c, 4)]);
        assert_eq!(bursts(&registers, |tier| tier == Tier::Window), []);
    }

    /// Each byte reads as its address; from `broken` on nothing is acknowledged.
    struct Addresses {
        broken: u8,
    }

    impl Bus for Addresses {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
            for (address, byte) in (write[0]..).zip(read) {
                *byte = address;
                if address >= self.broken {
                    return Err(BusError::NoAck);
                }
            }
            Ok(())
        }
    }

    #[test]
    fn a_failed_read_leaves_its_registers_unknown() {
        let chip = Chip::by_name("bq34z100-g1").expect("it has a table");
        let polled = |code| chip.register_at(Source::Command(code)).expect("a register");
        let read = |broken| {
            let clock = Arc::new(SimClock::new());
            let mut gauge = Gauge::new(chip, Box::new(Addresses { broken }), clock, Keys::default(), false);
            let mut registers = Registers::UNREAD;
            let outcome = registers.read(&mut gauge, |tier| tier == Tier::Poll);
            (outcome.is_ok(), registers)
        };
        let (complete, registers) = read(0x80);
        assert!(complete);
        assert_eq!(registers.value(polled(0x08)), Some(0x0908), "Voltage()");
        assert_eq!(registers.value(polled(0x2e)), Some(0x2f2e), "StateOfHealth()");
        assert_eq!(registers.value(polled(0x3c)), None, "DesignCapacity(), which is not polled");

        let (complete, registers) = read(0x2e);
        assert!(!complete);
        assert_eq!(registers.value(polled(0x08)), Some(0x0908), "Voltage()");
        assert_eq!(registers.value(polled(0x2c)), None, "CycleCount(), which was acknowledged");
        assert_eq!(registers.value(polled(0x2e)), None, "StateOfHealth()");
    }
}
