// SPDX-License-Identifier: MIT

//! A chip's registers: which reads fetch them, and what has been read.
//!
//! TI calls a register a standard command. All are at addresses below 0x80, least significant byte first.

use std::sync::Arc;

use crate::chip::{Register, Role, Source, Tier};
use crate::codec;
use crate::error::Result;
use crate::gauge::{Answer, Gauge};

/// A number as standard commands have it, least significant byte first.
pub(crate) fn number(bytes: &[u8]) -> i64 {
    codec::Order::Little.number(bytes)
}

/// What a row of the table reads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Cell {
    /// A number, sign applied.
    Number(i64),
    /// A text in printable ASCII.
    Text(Arc<str>),
}

impl Cell {
    fn of(row: &Register, bytes: &[u8]) -> Self {
        if row.text {
            let shown = |&byte: &u8| if matches!(byte, b' '..=b'~') { char::from(byte) } else { '?' };
            return Self::Text(codec::text(bytes).iter().map(shown).collect::<String>().into());
        }
        let raw = number(bytes);
        let unused = 64 - 8 * u32::from(row.size);
        Self::Number(if row.signed { raw << unused >> unused } else { raw })
    }
}

/// A gauge's registers, each as it was last read.
#[derive(Clone, Debug)]
pub struct Registers {
    rows: &'static [Register],
    cells: Vec<Option<Cell>>,
}

impl Registers {
    /// The registers of a table, before any has been read.
    pub fn unread(rows: &'static [Register]) -> Self {
        Self { rows, cells: vec![None; rows.len()] }
    }

    /// Reads the registers of the wanted tiers. If a read fails, the registers that it was for keep their values.
    pub fn read(&mut self, gauge: &mut Gauge, wanted: impl Fn(Tier) -> bool) -> Result<()> {
        let rows = self.rows;
        gauge.read_rows(rows, &wanted, &mut |answer| match answer {
            Answer::Burst(start, bytes) => self.fill(start, bytes),
            Answer::Row(row, bytes) => self.set(row, bytes),
        })
    }

    /// Takes the registers whose bytes are all among these, from an address on.
    pub(crate) fn fill(&mut self, start: u8, bytes: &[u8]) {
        for (row, cell) in self.rows.iter().zip(&mut self.cells) {
            // What Control() and the window show is no reading.
            let code = row.source.command().filter(|_| row.tier != Tier::Window);
            let at = code.and_then(|code| code.checked_sub(start)).map(usize::from);
            if let Some(own) = at.and_then(|at| bytes.get(at..at + usize::from(row.size))) {
                *cell = Some(Cell::of(row, own));
            }
        }
    }

    /// Takes the bytes of one row; `None` if it has no value.
    fn set(&mut self, row: &Register, bytes: Option<&[u8]>) {
        if let Some(at) = self.rows.iter().position(|own| own.source == row.source) {
            self.cells[at] = bytes.map(|bytes| Cell::of(row, bytes));
        }
    }

    /// What a property reads in its unit; `None` until it has been read, and while the part shows another one in its place.
    pub fn property(&self, role: Role) -> Option<i64> {
        let feeds = |row: &&Register| row.feeds(role, |source| self.at(source)) == Some(true);
        let row = self.rows.iter().find(feeds)?;
        Some(row.in_unit_of(role, self.value(row)?, 1))
    }

    fn at(&self, source: Source) -> Option<i64> {
        self.value(self.rows.iter().find(|row| row.source == source)?)
    }

    fn cell(&self, register: &Register) -> Option<&Cell> {
        let at = self.rows.iter().position(|row| row.source == register.source)?;
        self.cells[at].as_ref()
    }

    /// The value of a register; `None` until it has been read, and for a text.
    pub fn value(&self, register: &Register) -> Option<i64> {
        match self.cell(register)? {
            Cell::Number(number) => Some(*number),
            Cell::Text(_) => None,
        }
    }

    /// The text of a register; `None` until it has been read, and for a number.
    pub fn text(&self, register: &Register) -> Option<&Arc<str>> {
        match self.cell(register)? {
            Cell::Text(text) => Some(text),
            Cell::Number(_) => None,
        }
    }

    /// Whether each number that has been read has all of its bits set, as on a bus that nothing drives.
    pub fn are_all_ones(&self) -> bool {
        let is_ones = |(row, cell): (&Register, &Option<Cell>)| match cell {
            Some(Cell::Number(number)) => number | -1 << (8 * row.size) == -1,
            Some(Cell::Text(_)) | None => true,
        };
        self.rows.iter().zip(&self.cells).all(is_ones)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::{Chip, Source, bursts};
    use crate::keys::Keys;
    use crate::value::Type;
    use gauge_bus::clock::SimClock;
    use gauge_bus::{Bus, BusError};

    const fn register(code: u8, kind: Type, tier: Tier) -> Register {
        Register::new(code, kind, "Register", "", tier)
    }

    /// A table of one register.
    fn table(code: u8, kind: Type) -> &'static [Register] {
        Vec::leak(vec![register(code, kind, Tier::Poll)])
    }

    /// What a register of that type reads, with these bytes at its address.
    fn decoded(kind: Type, bytes: &[u8]) -> Option<i64> {
        let rows = table(0x10, kind);
        let mut registers = Registers::unread(rows);
        registers.fill(0x10, bytes);
        registers.value(&rows[0])
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
        let rows = table(0x7e, Type::U(2));
        let mut registers = Registers::unread(rows);
        registers.fill(0x7f, &[0x12]);
        assert_eq!(registers.value(&rows[0]), None);
        registers.fill(0x7d, &[0xff, 0x34, 0x12]);
        assert_eq!(registers.value(&rows[0]), Some(0x1234));
    }

    #[test]
    fn all_ones_are_those_of_what_was_read() {
        let rows = [Type::I(2), Type::U(1), Type::U(4)];
        let rows = (0..).zip(rows).map(|(at, kind)| register(0x10 + 4 * at, kind, Tier::Poll)).collect();
        let mut registers = Registers::unread(Vec::leak(rows));
        registers.fill(0x10, &[0xff; 5]);
        assert!(registers.are_all_ones());
        registers.fill(0x18, &[0xff, 0xff, 0xff, 0xfe]);
        assert!(!registers.are_all_ones());
        registers.fill(0x18, &[0xff; 4]);
        assert!(registers.are_all_ones());
        registers.fill(0x10, &[0xfe, 0xff]);
        assert!(!registers.are_all_ones());
    }

    #[test]
    fn a_text_has_its_length_first_and_is_no_number() {
        let rows = table(0x20, Type::S(6));
        let mut registers = Registers::unread(rows);
        registers.fill(0x20, b"\x04LI\nNx");
        assert_eq!(registers.text(&rows[0]).map(|text| &**text), Some("LI?N"));
        assert_eq!(registers.value(&rows[0]), None);
        assert!(registers.are_all_ones());
    }

    /// As in Smart Battery Data, where 0x08 is a word and 0x09 another one.
    #[test]
    fn words_whose_addresses_overlap_are_read_one_by_one_into_cells_of_their_own() {
        let rows: &[Register] = Vec::leak(vec![
            register(0x08, Type::U(2), Tier::Poll),
            register(0x09, Type::U(2), Tier::Poll),
            register(0x0b, Type::U(2), Tier::Poll),
        ]);
        assert_eq!(bursts(rows, |_| true), [(0x08, 2), (0x09, 4)]);
        let mut registers = Registers::unread(rows);
        registers.fill(0x08, &[0x34, 0x12]);
        registers.fill(0x09, &[0x78, 0x56, 0xbc, 0x9a]);
        let read = rows.iter().map(|row| registers.value(row));
        assert_eq!(read.collect::<Vec<_>>(), [Some(0x1234), Some(0x5678), Some(0x9abc)]);
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
            let mut gauge = Gauge::new(chip, Box::new(Addresses { broken }), clock, Keys::default());
            let mut registers = Registers::unread(chip.registers);
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
