// SPDX-License-Identifier: MIT

//! Files with whole firmware, as TI's tools write them.

use std::fmt::Write as _;
use std::sync::Arc;

use gauge_bus::clock::SimClock;
use gauge_sim::{Options, Sim};
use ti_gauge::chip::Chip;

/// How a file writes the mark of valid firmware: with row 0 at the end, or alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Style {
    Row,
    Word,
}

const MARK: std::ops::Range<usize> = 15..18;

/// A file in TI's form, with rows of the simulated gauge's own.
pub(crate) struct Writer {
    pub(crate) text: String,
    pub(crate) rows: Vec<[u8; 96]>,
    pub(crate) data: Vec<u8>,
}

impl Writer {
    pub(crate) fn command(&mut self, bytes: &[u8], ms: u32) {
        let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!(" {byte:02X}")).collect::<String>();
        let sum = bytes.iter().fold(0_u16, |sum, byte| sum.wrapping_add((*byte).into()));
        // Writing to a String does not fail.
        let _ = write!(self.text, "W: 16 00{}\nW: 16 64{}\nX: {ms}\n", hex(bytes), hex(&sum.to_le_bytes()));
    }

    pub(crate) fn done(&mut self, bytes: &[u8], ms: u32) {
        self.command(bytes, ms);
        self.text += "C: 16 66 00\n";
    }

    pub(crate) fn row(&mut self, row: usize) {
        let [low, high] = (row as u16).to_le_bytes();
        self.done(&[&[0x02, low, high, 0x00], &self.rows[row][..]].concat(), 2);
    }

    pub(crate) fn sum(&mut self, written: &dyn Fn(usize) -> bool) {
        let erased: [u8; 96] = std::array::from_fn(|at| [0xFF, 0xFF, 0x3F][at % 3]);
        let rows = (0..512).map(|row| if written(row) { self.rows[row] } else { erased });
        let words: Vec<_> =
            rows.flat_map(|row| row.chunks(3).map(<[u8]>::to_vec).collect::<Vec<_>>()).collect();
        let sum = words
            .iter()
            .fold(0_u32, |sum, word| sum.wrapping_add(u32::from_le_bytes([word[0], word[1], word[2], 0])));
        let [a, b, c, d] = sum.to_le_bytes();
        self.command(&[0x05], 170);
        let _ = writeln!(self.text, "C: 16 04 {a:02X} {b:02X} {c:02X} {d:02X}");
    }

    pub(crate) fn data(&mut self) {
        self.done(&[0x0C, 0, 0, 0, 0x83, 0xDE], 200);
        for row in 0..32 {
            let bytes = self.data[row * 32..row * 32 + 32].to_vec();
            self.done(&[&[0x0A, row as u8, 0, 0], &bytes[..]].concat(), 2);
        }
        let sum = self.data.iter().fold(0_u16, |sum, byte| sum.wrapping_add((*byte).into()));
        let [low, high] = sum.to_le_bytes();
        self.command(&[0x08], 2);
        let _ = writeln!(self.text, "C: 16 04 {low:02X} {high:02X}");
    }
}

/// What a file for a chip holds: its firmware, and data flash with its Device Name.
pub(crate) fn content(chip: &Chip) -> (Vec<[u8; 96]>, Vec<u8>) {
    let sim = Sim::new(chip.name, &Options::default(), Arc::new(SimClock::new())).expect("a simulated gauge");
    let (rows, mut data) = sim.firmware().expect("it has a boot loader");
    let file = chip.firmware_file.as_ref().expect("it has one");
    let name = file.names[0].as_bytes();
    data[file.name] = name.len() as u8;
    data[file.name + 1..file.name + 1 + name.len()].copy_from_slice(name);
    (rows, data)
}

pub(crate) fn file_of(rows: Vec<[u8; 96]>, data: Vec<u8>, style: Style) -> String {
    let text = "; exported\r\nW: AA 00 14 04\nW: AA 00 72 36\nW: AA 00 FF FF\nW: AA 00 FF FF\nX: 1000\n\
                W: AA 00 00 0F\nX: 1000\n";
    let mut out = Writer { text: text.into(), rows, data };
    out.done(&[0x04, 0, 0, 0, 0x83, 0xDE], 200);
    match style {
        Style::Row => {
            (2..512).for_each(|row| out.row(row));
            out.sum(&|row| row >= 2);
            out.data();
            out.row(1);
            out.row(0);
            out.sum(&|_| true);
        }
        Style::Word => {
            let mark = out.rows[0][MARK].to_vec();
            out.rows[0][MARK].copy_from_slice(&[0xFF, 0xFF, 0x3F]);
            (0..512).for_each(|row| out.row(row));
            out.sum(&|_| true);
            out.data();
            out.sum(&|_| true);
            out.done(&[&[0x01, 0, 0, 0x05], &mark[..]].concat(), 2);
            out.rows[0][MARK].copy_from_slice(&mark);
            out.sum(&|_| true);
        }
    }
    out.command(&[0x0F], 4000);
    out.text
}

pub(crate) fn file(chip: &Chip, style: Style) -> String {
    let (rows, data) = content(chip);
    file_of(rows, data, style)
}
