// SPDX-License-Identifier: MIT

//! Instruction flash, and the boot loader that answers in ROM mode.
//!
//! No manual describes it. Commands, sums and the mark of valid firmware are those of whole files for bq27520-G3 and
//! bq27510 (github.com/pelotoncycle/opensource-quartz, octathorp/Kepler_CM7), which agree with what is public for
//! bq34z100. Where they leave a choice, the gauge does what is worst for a programmer: a loss of power leaves its work
//! half done, and marked but incomplete firmware never answers again. One exception: an interrupted erase has erased
//! the mark, because otherwise no order of rows would help.

use std::borrow::Cow;
use std::sync::Arc;
use std::time::Duration;

use super::random::Random;

/// Address at which a gauge in ROM mode answers.
pub(super) const ROM_ADDRESS: u8 = 0x0B;

pub(super) const ROWS: usize = 512;
const ROW: usize = 96;
pub(super) const DATA_ROWS: usize = 32;
pub(super) const DATA_ROW: usize = 32;
pub(super) const DATA: usize = DATA_ROWS * DATA_ROW;
pub(super) const MARK: [u8; 3] = [0x54, 0x54, 0x15];
pub(super) const MARK_AT: usize = 15;
pub(super) const ERASED: [u8; 3] = [0xFF, 0xFF, 0x3F];
/// Offset of the version in row 0, low byte first.
const VERSION_AT: usize = 48;
/// The values of 0x66: done; wrong magic word; wrong sum; not done yet. No source has the last one.
const DONE: u8 = 0x00;
const REFUSED: u8 = 0x02;
const WRONG_SUM: u8 = 0x04;
const WORKING: u8 = 0xFF;

pub(super) type Row = [u8; ROW];

/// Places of the classes in the boot loader's data flash: class, index, length.
pub(super) type Layout = &'static [(u16, usize, usize)];

pub(super) fn erased() -> Row {
    std::array::from_fn(|at| ERASED[at % 3])
}

/// Made-up words for the firmware of a version: TI's own belong to TI.
fn words(version: u16) -> Vec<Row> {
    let mut random = Random::new(u64::from(version));
    let mut rows: Vec<Row> = vec![erased(); ROWS];
    for row in &mut rows[..ROWS - 12] {
        for (at, byte) in row.iter_mut().enumerate() {
            *byte = random.roll(256) as u8 & ERASED[at % 3];
        }
    }
    rows[0][MARK_AT..MARK_AT + 3].copy_from_slice(&MARK);
    rows[0][VERSION_AT..VERSION_AT + 2].copy_from_slice(&version.to_le_bytes());
    rows
}

/// Instruction flash, and the bytes of data flash outside all classes.
#[derive(Clone, Debug)]
pub(super) struct Firmware {
    version: u16,
    /// `None` until something looks at it: it takes more memory than the rest of the gauge.
    rows: Option<Rows>,
    pub(super) rest: Cow<'static, [u8]>,
}

#[derive(Clone, Debug)]
struct Rows {
    /// The factory's firmware.
    own: Arc<Vec<Row>>,
    now: Arc<Vec<Row>>,
}

impl Firmware {
    pub(super) fn new(version: u16) -> Self {
        Self { version, rows: None, rest: Cow::Borrowed(&[0xFF; DATA]) }
    }

    /// Whether the gauge starts its firmware instead of staying in ROM mode.
    pub(super) fn is_marked(&self) -> bool {
        self.rows.as_ref().is_none_or(|rows| rows.now[0][MARK_AT..MARK_AT + 3] == MARK)
    }

    /// Whether the firmware works.
    pub(super) fn is_sound(&self) -> bool {
        self.rows.as_ref().is_none_or(|rows| rows.now == rows.own)
    }

    fn known(&mut self) -> &mut Rows {
        self.rows.get_or_insert_with(|| {
            let own = Arc::new(words(self.version));
            Rows { now: own.clone(), own }
        })
    }

    pub(super) fn rows(&self) -> Arc<Vec<Row>> {
        self.rows.as_ref().map_or_else(|| words(self.version).into(), |rows| rows.now.clone())
    }

    pub(super) fn rows_mut(&mut self) -> &mut Vec<Row> {
        Arc::make_mut(&mut self.known().now)
    }

    /// Rows that differ from a new part's.
    pub(super) fn changed(&self) -> impl Iterator<Item = (usize, &Row)> {
        let rows = self.rows.iter().flat_map(|rows| rows.now.iter().zip(&*rows.own).enumerate());
        rows.filter(|(_, (row, own))| row != own).map(|(at, (row, _))| (at, row))
    }

    fn sum(&mut self) -> u32 {
        let words = self.known().now.iter().flat_map(|row| row.chunks(3));
        words.fold(0, |sum, word| sum.wrapping_add(u32::from_le_bytes([word[0], word[1], word[2], 0])))
    }
}

/// Work that takes effect when its command is done.
#[derive(Clone, Debug)]
enum Work {
    Rows(Vec<(usize, Row)>),
    Data(Vec<(usize, Vec<u8>)>),
    Answer(Vec<u8>),
}

/// What the boot loader does to the rest of the gauge.
pub(super) enum Effect {
    Data(Vec<(usize, Vec<u8>)>),
    Leave,
}

/// What a loss of power leaves of work that has begun. Rows of firmware are left so at once.
fn torn(work: &Work, firmware: &mut Firmware, data: &[u8]) -> Option<Effect> {
    match work {
        Work::Answer(_) => None,
        Work::Rows(new) => {
            tear(firmware.rows_mut(), new);
            None
        }
        // Erasing all of data flash.
        Work::Data(new) if new[0].1.len() == DATA => {
            Some(Effect::Data(vec![(0, data.iter().map(|byte| byte | 0x5A).collect())]))
        }
        Work::Data(new) => {
            let (at, new) = (new[0].0, &new[0].1);
            Some(Effect::Data(vec![(at, [&new[..7], &data[at + 7..at + DATA_ROW]].concat())]))
        }
    }
}

/// Half of the words of a row, and half of the rows; the mark is the first to go and the last to come.
fn tear(rows: &mut [Row], new: &[(usize, Row)]) {
    for (at, (row, new)) in new.iter().enumerate() {
        let half = if at % 2 == 0 { ROW / 2 } else { ROW };
        for (byte, new) in rows[*row].iter_mut().zip(new).skip(half) {
            *byte = *new;
        }
        if *row == 0 && rows[0][MARK_AT..MARK_AT + 3] == MARK && new[MARK_AT..MARK_AT + 3] != MARK {
            rows[0][MARK_AT] = 0xD5;
        }
    }
}

#[derive(Clone, Debug)]
pub(super) struct Boot {
    buffer: [u8; 0x64],
    /// Which bytes of the buffer were written since the last command.
    sent: [bool; 0x64],
    sum: u8,
    result: u8,
    working: Option<(Duration, Work)>,
    /// It received a command that ruins a gauge.
    pub(super) ruined: bool,
}

impl Default for Boot {
    fn default() -> Self {
        let (buffer, sent) = ([0xFF; 0x64], [false; 0x64]);
        Self { buffer, sent, sum: 0xFF, result: DONE, working: None, ruined: false }
    }
}

impl Boot {
    pub(super) fn read(&self, register: u8) -> u8 {
        match register {
            0x66 => self.result,
            _ => self.buffer.get(usize::from(register)).copied().unwrap_or(0),
        }
    }

    /// Takes a byte. `data` is data flash as it is. The effect returned happens at once; a loss of power would leave it
    /// as well.
    pub(super) fn write(
        &mut self,
        firmware: &mut Firmware,
        data: &[u8],
        register: u8,
        byte: u8,
        now: Duration,
    ) -> Option<Effect> {
        match usize::from(register) {
            0x64 => self.sum = byte,
            0x65 => return self.execute(firmware, data, u16::from_le_bytes([self.sum, byte]), now),
            at if at < self.buffer.len() && self.working.is_none() => {
                self.buffer[at] = byte;
                self.sent[at] = true;
            }
            _ => {}
        }
        None
    }

    fn execute(&mut self, firmware: &mut Firmware, data: &[u8], sum: u16, now: Duration) -> Option<Effect> {
        if self.working.is_some() {
            return None;
        }
        let sent = std::mem::replace(&mut self.sent, [false; 0x64]);
        let bytes = self.buffer.iter().zip(sent).filter(|(_, sent)| *sent);
        let all = bytes.fold(0_u16, |sum, (byte, _)| sum.wrapping_add((*byte).into()));
        if sum != all {
            self.result = WRONG_SUM;
            return None;
        }
        // A gauge that was sent this never answered again (E2E 171568).
        if self.buffer[0] == 0x06 {
            let rows = firmware.rows_mut();
            rows[0] = erased();
            rows[0][MARK_AT..MARK_AT + 3].copy_from_slice(&MARK);
            self.ruined = true;
            return None;
        }
        if self.buffer[0] == 0x0F {
            return Some(Effect::Leave);
        }
        let Some((time, work)) = self.command(firmware, data) else {
            self.result = REFUSED;
            return None;
        };
        let torn = torn(&work, firmware, data);
        self.result = WORKING;
        self.working = Some((now + time, work));
        torn
    }

    /// What the command in the buffer does, and how long it takes; `None` for one that is refused.
    fn command(&self, firmware: &mut Firmware, data: &[u8]) -> Option<(Duration, Work)> {
        let row = usize::from(u16::from_le_bytes([self.buffer[1], self.buffer[2]]));
        let magic = self.buffer[4..6] == [0x83, 0xDE];
        let (time, work) = match self.buffer[0] {
            0x00 if row < ROWS => (2, Work::Answer(firmware.known().now[row].to_vec())),
            0x01 if row < ROWS && self.buffer[3] < 32 => {
                let mut new = firmware.known().now[row];
                let at = usize::from(self.buffer[3]) * 3;
                for (old, byte) in new[at..at + 3].iter_mut().zip(&self.buffer[4..7]) {
                    *old &= byte;
                }
                (2, Work::Rows(vec![(row, new)]))
            }
            0x02 if row < ROWS => {
                // Programming clears bits; only erasing sets them.
                let old = firmware.known().now[row];
                let new = std::array::from_fn(|at| old[at] & self.buffer[4 + at]);
                (2, Work::Rows(vec![(row, new)]))
            }
            0x03 if row < ROWS / 2 => (20, Work::Rows(vec![(row * 2, erased()), (row * 2 + 1, erased())])),
            0x04 if magic => (200, Work::Rows((0..ROWS).map(|row| (row, erased())).collect())),
            0x05 => (170, Work::Answer(firmware.sum().to_le_bytes().to_vec())),
            0x08 => {
                let sum = data.iter().fold(0_u16, |sum, byte| sum.wrapping_add((*byte).into()));
                (2, Work::Answer(sum.to_le_bytes().to_vec()))
            }
            0x0A if row < DATA_ROWS => {
                let at = row * DATA_ROW;
                let new = (0..DATA_ROW).map(|byte| data[at + byte] & self.buffer[4 + byte]).collect();
                (2, Work::Data(vec![(at, new)]))
            }
            0x0C if magic => (200, Work::Data(vec![(0, vec![0xFF; DATA])])),
            _ => return None,
        };
        Some((Duration::from_millis(time), work))
    }

    /// Lets time pass. Returns the effect of a command that is done now.
    pub(super) fn run(&mut self, firmware: &mut Firmware, now: Duration) -> Option<Option<Effect>> {
        let (_, work) = self.working.take_if(|(until, _)| now >= *until)?;
        self.result = DONE;
        Some(match work {
            Work::Rows(new) => {
                let rows = firmware.rows_mut();
                for (row, new) in new {
                    rows[row] = new;
                }
                None
            }
            Work::Data(new) => Some(Effect::Data(new)),
            Work::Answer(bytes) => {
                self.buffer[4..4 + bytes.len()].copy_from_slice(&bytes);
                None
            }
        })
    }
}
