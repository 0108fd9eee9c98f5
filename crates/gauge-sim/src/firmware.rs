// SPDX-License-Identifier: MIT

//! FlashStream files with the whole firmware of a simulated gauge, to try a rescue from ROM mode with.
//!
//! ```
//! use gauge_sim::firmware::{self, Style};
//!
//! // The Device Name is at byte 736 of data flash there.
//! let (rows, data) = firmware::named("bq34z100-g1", 736, "bq34z100-G1").expect("a part with a boot loader");
//! let text = firmware::file(rows, data, Style::Row);
//! assert!(text.starts_with("; "));
//! ```

use std::fmt::Write as _;
use std::sync::Arc;

use gauge_bus::clock::SimClock;

use crate::rom::{DATA_ROW, DATA_ROWS, ERASED, MARK, MARK_AT, ROWS, erased};
use crate::{Options, Sim};

const MARK_WORD: std::ops::Range<usize> = MARK_AT..MARK_AT + MARK.len();

/// When a file writes the mark of valid firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// With row 0, after all others.
    Row,
    /// As a single word, after every row.
    Word,
}

/// A file in progress, and the flash that its commands write.
#[derive(Clone, Debug)]
pub struct Writer {
    /// The file so far.
    pub text: String,
    /// Instruction flash.
    pub rows: Vec<[u8; 96]>,
    /// Data flash.
    pub data: Vec<u8>,
}

impl Writer {
    /// Adds a command with its sum, and the wait after it.
    pub fn command(&mut self, bytes: &[u8], ms: u32) {
        let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!(" {byte:02X}")).collect::<String>();
        let sum = bytes.iter().fold(0_u16, |sum, byte| sum.wrapping_add((*byte).into()));
        // Writing to a String does not fail.
        let _ = write!(self.text, "W: 16 00{}\nW: 16 64{}\nX: {ms}\n", hex(bytes), hex(&sum.to_le_bytes()));
    }

    /// Adds a command that must report success.
    pub fn done(&mut self, bytes: &[u8], ms: u32) {
        self.command(bytes, ms);
        self.text += "C: 16 66 00\n";
    }

    /// Adds a row of instruction flash.
    pub fn row(&mut self, row: usize) {
        let [low, high] = (row as u16).to_le_bytes();
        self.done(&[&[0x02, low, high, 0x00], &self.rows[row][..]].concat(), 2);
    }

    /// Adds a check of the sum of the rows written so far.
    pub fn sum(&mut self, written: &dyn Fn(usize) -> bool) {
        let rows = (0..ROWS).map(|row| if written(row) { self.rows[row] } else { erased() });
        let of_row = |sum: u32, row: [u8; 96]| {
            row.chunks(3)
                .fold(sum, |sum, word| sum.wrapping_add(u32::from_le_bytes([word[0], word[1], word[2], 0])))
        };
        let sum = rows.fold(0, of_row);
        let [a, b, c, d] = sum.to_le_bytes();
        self.command(&[0x05], 170);
        let _ = writeln!(self.text, "C: 16 04 {a:02X} {b:02X} {c:02X} {d:02X}");
    }

    /// Erases and writes data flash, and checks its sum.
    pub fn data(&mut self) {
        self.done(&[0x0C, 0, 0, 0, 0x83, 0xDE], 200);
        for row in 0..DATA_ROWS {
            let bytes = self.data[row * DATA_ROW..][..DATA_ROW].to_vec();
            self.done(&[&[0x0A, row as u8, 0, 0], &bytes[..]].concat(), 2);
        }
        let sum = self.data.iter().fold(0_u16, |sum, byte| sum.wrapping_add((*byte).into()));
        let [low, high] = sum.to_le_bytes();
        self.command(&[0x08], 2);
        let _ = writeln!(self.text, "C: 16 04 {low:02X} {high:02X}");
    }
}

/// Instruction and data flash of a new gauge, with a Device Name at that byte; `None` if the part's boot loader is not
/// simulated.
pub fn named(part: &str, at: usize, name: &str) -> Option<(Vec<[u8; 96]>, Vec<u8>)> {
    let sim = Sim::new(part, &Options::default(), Arc::new(SimClock::new())).ok()?;
    let (rows, mut data) = sim.firmware()?;
    data[at] = name.len() as u8;
    data[at + 1..at + 1 + name.len()].copy_from_slice(name.as_bytes());
    Some((rows, data))
}

/// The whole file: keys and ROM_MODE, erasure, every row, the mark last, and the way back.
pub fn file(rows: Vec<[u8; 96]>, data: Vec<u8>, style: Style) -> String {
    let text = "; exported\r\nW: AA 00 14 04\nW: AA 00 72 36\nW: AA 00 FF FF\nW: AA 00 FF FF\nX: 1000\n\
                W: AA 00 00 0F\nX: 1000\n";
    let mut out = Writer { text: text.into(), rows, data };
    out.done(&[0x04, 0, 0, 0, 0x83, 0xDE], 200);
    match style {
        Style::Row => {
            (2..ROWS).for_each(|row| out.row(row));
            out.sum(&|row| row >= 2);
            out.data();
            out.row(1);
            out.row(0);
            out.sum(&|_| true);
        }
        Style::Word => {
            let mark = out.rows[0][MARK_WORD].to_vec();
            out.rows[0][MARK_WORD].copy_from_slice(&ERASED);
            (0..ROWS).for_each(|row| out.row(row));
            out.sum(&|_| true);
            out.data();
            out.sum(&|_| true);
            out.done(&[&[0x01, 0, 0, 0x05], &mark[..]].concat(), 2);
            out.rows[0][MARK_WORD].copy_from_slice(&mark);
            out.sum(&|_| true);
        }
    }
    out.command(&[0x0F], 4000);
    out.text
}
