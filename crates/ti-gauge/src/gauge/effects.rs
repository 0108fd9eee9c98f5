// SPDX-License-Identifier: MIT

//! How long a gauge takes to show what it was told: a commit, SEALED after a RESET, the measurement of an offset.
//!
//! Only transfers that happen anyway are looked at: a time lies between the last look without it and the first with it.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use super::state::{Seal, Shown};
use crate::chip::Chip;
use crate::codec::WINDOW;
use gauge_bus::BusError;
use gauge_bus::replay::Touch;

/// What takes longer was not done, or something else has changed it since.
const LIMIT: Duration = Duration::from_secs(5);

/// Times since the gauge was opened.
#[derive(Debug, Default)]
pub struct Effects {
    count: AtomicU64,
    seen_ms: AtomicU64,
    unseen_ms: AtomicU64,
}

impl Effects {
    /// How often it was seen.
    pub fn count(&self) -> u64 {
        self.count.load(Ordering::Relaxed)
    }

    /// The longest time after which a look was the first to show it, in milliseconds.
    pub fn seen_ms(&self) -> u64 {
        self.seen_ms.load(Ordering::Relaxed)
    }

    /// The longest time after which a look did not show it yet, in milliseconds; 0 if each first look did.
    pub fn unseen_ms(&self) -> u64 {
        self.unseen_ms.load(Ordering::Relaxed)
    }

    fn note(&self, seen: Duration, unseen: Duration) {
        let ms = |time: Duration| u64::try_from(time.as_millis()).unwrap_or(u64::MAX);
        self.count.fetch_add(1, Ordering::Relaxed);
        self.seen_ms.fetch_max(ms(seen), Ordering::Relaxed);
        self.unseen_ms.fetch_max(ms(unseen), Ordering::Relaxed);
    }
}

#[derive(Debug)]
struct Awaited<T> {
    what: T,
    since: Duration,
    unseen: Duration,
}

impl<T> Awaited<T> {
    fn new(what: T, since: Duration) -> Self {
        Self { what, since, unseen: Duration::ZERO }
    }

    fn is_over(&self, now: Duration) -> bool {
        now.saturating_sub(self.since) > LIMIT
    }

    fn note_unseen(&mut self, begun: Duration) {
        self.unseen = begun.saturating_sub(self.since);
    }

    fn note_seen(&self, ended: Duration, effects: &Effects) {
        effects.note(ended.saturating_sub(self.since), self.unseen);
    }
}

type Sent = [Option<u8>; WINDOW];

#[derive(Debug)]
struct Committed {
    selection: [u8; 2],
    sent: Sent,
    /// The window shows the buffer until a block is selected again.
    is_selected: bool,
}

pub(super) struct Seen<'a> {
    pub(super) begun: Duration,
    pub(super) ended: Duration,
    pub(super) touches: &'a [(Touch, u8)],
    pub(super) shown: Option<Shown<'a>>,
    pub(super) outcome: Result<(), BusError>,
}

#[derive(Debug, Default)]
pub(super) struct Watch {
    selection: [u8; 2],
    sent: Sent,
    commit: Option<Awaited<Committed>>,
    reset: Option<Awaited<()>>,
    /// The bits of CONTROL_STATUS. One of them is set while the offset is measured.
    offset: Option<Awaited<u32>>,
}

impl Watch {
    /// What follows is not to be kept: it carries keys.
    pub(super) fn forget(&mut self) {
        *self = Self::default();
    }

    pub(super) fn transfer(&mut self, seen: &Seen<'_>, chip: &Chip, commits: &Effects) {
        let is_flat = chip.access.scheme.is_flat();
        self.commit.take_if(|commit| commit.is_over(seen.begun));
        self.reset.take_if(|reset| reset.is_over(seen.begun));
        self.offset.take_if(|offset| offset.is_over(seen.begun));
        if seen.outcome.is_err() {
            // A gauge that programs or starts may not answer at all.
            self.reset.iter_mut().for_each(|reset| reset.note_unseen(seen.begun));
            self.commit.iter_mut().for_each(|commit| commit.note_unseen(seen.begun));
        }
        match (seen.shown, seen.touches) {
            (Some(shown), _) => self.reads(&shown, seen, is_flat, commits),
            (None, &[(Touch::Subcommand(0), low), (Touch::Subcommand(1), high)]) => {
                let code = u16::from_le_bytes([low, high]);
                let mut offsets = chip.calibration.iter().flat_map(|all| [&all.board_offset, &all.cc_offset]);
                let begun = offsets.find(|offset| offset.start == code);
                if let Some(offset) = begun.filter(|_| seen.outcome.is_ok()) {
                    self.offset = Some(Awaited::new(offset.running, seen.ended));
                }
            }
            (None, touches) => self.writes(touches, seen),
        }
    }

    fn writes(&mut self, touches: &[(Touch, u8)], seen: &Seen<'_>) {
        let is_taken = seen.outcome.is_ok();
        for &(touch, byte) in touches {
            match touch {
                Touch::Selects(at) if is_taken => {
                    self.selection[at] = byte;
                    self.sent = Sent::default();
                    self.commit.iter_mut().for_each(|commit| commit.what.is_selected = true);
                }
                Touch::Fills(at) if is_taken => self.sent[at] = Some(byte),
                // It may take effect although its acknowledgement was lost; all else is sent again.
                Touch::Commits => {
                    let sent = std::mem::take(&mut self.sent);
                    let what = Committed { selection: self.selection, sent, is_selected: false };
                    self.commit = sent.iter().any(Option::is_some).then(|| Awaited::new(what, seen.ended));
                }
                _ => {}
            }
        }
    }

    fn reads(&mut self, shown: &Shown<'_>, seen: &Seen<'_>, is_flat: bool, commits: &Effects) {
        let Some(commit) = self.commit.as_mut().filter(|commit| commit.what.is_selected) else { return };
        let (Some(echo), Some(window)) = (shown.selection, shown.window.first_chunk()) else { return };
        if seen.outcome.is_err() {
            return;
        }
        match commit.what.is_shown(echo, window, is_flat) {
            Some(true) => {
                commit.note_seen(seen.ended, commits);
                self.commit = None;
            }
            Some(false) => commit.note_unseen(seen.begun),
            None => {}
        }
    }

    pub(super) fn reset(&mut self, now: Duration) {
        (self.reset, self.commit) = (Some(Awaited::new((), now)), None);
    }

    /// SEALED is about to be sent, after which it is not the reset that has sealed the gauge.
    pub(super) fn seals(&mut self) {
        self.reset = None;
    }

    pub(super) fn look(&mut self, look: &Status, resets: &Effects, offsets: &Effects) {
        let reset = |_: &mut ()| look.seal == Seal::Sealed;
        see(&mut self.reset, reset, look, resets);
        see(&mut self.offset, |running| look.status & *running != 0, look, offsets);
    }
}

pub(super) struct Status {
    pub(super) begun: Duration,
    pub(super) ended: Duration,
    pub(super) status: u32,
    pub(super) seal: Seal,
}

fn see<T>(
    awaited: &mut Option<Awaited<T>>,
    shows: impl FnOnce(&mut T) -> bool,
    look: &Status,
    effects: &Effects,
) {
    let Some(found) = awaited else { return };
    if shows(&mut found.what) {
        found.note_seen(look.ended, effects);
        *awaited = None;
    } else {
        found.note_unseen(look.begun);
    }
}

impl Committed {
    fn is_shown(&self, echo: [u8; 2], window: &[u8; WINDOW], is_flat: bool) -> Option<bool> {
        let shift = match is_flat {
            // Each run of bytes has an address of its own.
            true => u16::from_le_bytes(self.selection).checked_sub(u16::from_le_bytes(echo))?,
            false if echo == self.selection => 0,
            false => return None,
        };
        let mut sent = (usize::from(shift)..).zip(self.sent).filter_map(|(at, byte)| Some((at, byte?)));
        // A window that ends before it shows nothing of it.
        sent.try_fold(true, |so_far, (at, byte)| {
            let found = window.get(at)?;
            Some(so_far && *found == byte)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Control().
    const CONTROL: u8 = 0x00;
    /// DataFlashClass() and DataFlashBlock(), or ManufacturerAccessControl().
    const SELECTION: u8 = 0x3e;
    /// BlockDataChecksum(), or MACDataSum().
    const SUM: u8 = 0x60;
    const BLOCK: &str = "bq34z100-g1";
    const MAC: &str = "bq34110";

    fn ms(time: u64) -> Duration {
        Duration::from_millis(time)
    }

    fn goes(watch: &mut Watch, at: u64, write: &[u8], read: &[u8], chip: &str, commits: &Effects) {
        let (begun, ended) = (ms(at), ms(at + 1));
        let chip = Chip::by_name(chip).expect("a table");
        passes(watch, (begun, ended), write, read, Ok(()), chip, commits);
    }

    fn passes(
        watch: &mut Watch,
        (begun, ended): (Duration, Duration),
        write: &[u8],
        read: &[u8],
        outcome: Result<(), BusError>,
        chip: &Chip,
        commits: &Effects,
    ) {
        let dialect = crate::gauge::dialect::of(chip);
        let touches = dialect.touches(write);
        let shown = if let [start] = write { Some(dialect.shows(*start, read)) } else { None };
        watch.transfer(&Seen { begun, ended, touches: &touches, shown, outcome }, chip, commits);
    }

    fn window(selection: [u8; 2], at: usize, bytes: [u8; 2]) -> Vec<u8> {
        let mut shown = vec![0; 2 + WINDOW + 2];
        shown[..2].copy_from_slice(&selection);
        shown[2 + at..4 + at].copy_from_slice(&bytes);
        shown
    }

    #[test]
    fn a_commit_is_seen_between_the_last_look_without_it_and_the_first_with_it() {
        for (chip, commit, block, at) in
            [(BLOCK, &[SUM, 0x5a][..], [80, 1], 21), (MAC, &[SUM, 0x5a, 6], [0xe0, 0x41], 21)]
        {
            let (mut watch, commits) = (Watch::default(), Effects::default());
            let mut goes = |at, write: &[u8], read: &[u8]| goes(&mut watch, at, write, read, chip, &commits);
            let (run, data) =
                if chip == MAC { ([block[0] + at as u8, block[1]], 0x40) } else { (block, 0x40 + at as u8) };
            goes(0, &[SELECTION, run[0], run[1]], &[]);
            goes(10, &[data, 0x0c, 0x1c], &[]);
            goes(20, commit, &[]);
            // The buffer.
            goes(25, &[SELECTION], &window(block, at, [0x0c, 0x1c]));
            goes(30, &[SELECTION, block[0], block[1]], &[]);
            goes(50, &[SELECTION], &window(block, at, [0x0b, 0xb8]));
            goes(60, &[0x08], &[1, 2]);
            goes(70, &[SELECTION], &window([9, 9], at, [0x0c, 0x1c]));
            goes(80, &[SELECTION], &window(block, at, [0x0c, 0x1c]));
            goes(90, &[SELECTION], &window(block, at, [0x0b, 0xb8]));
            // It has ended at 21, and the looks were from 50 and to 81.
            assert_eq!((commits.count(), commits.unseen_ms(), commits.seen_ms()), (1, 29, 60), "{chip}");
        }
    }

    #[test]
    fn a_gauge_that_does_not_answer_has_not_shown_it() {
        let (mut watch, commits) = (Watch::default(), Effects::default());
        let mut goes = |at, write: &[u8], read: &[u8], outcome| {
            let (begun, ended) = (ms(at), ms(at + 1));
            let chip = Chip::by_name(BLOCK).expect("a table");
            passes(&mut watch, (begun, ended), write, read, outcome, chip, &commits);
        };
        goes(0, &[SELECTION, 80, 1], &[], Ok(()));
        goes(1, &[0x55, 0x0c], &[], Ok(()));
        // Its acknowledgement is lost.
        goes(9, &[SUM, 0x5a], &[], Err(BusError::NoAck));
        goes(110, &[SELECTION, 80, 1], &[], Err(BusError::NoAck));
        goes(135, &[SELECTION, 80, 1], &[], Ok(()));
        goes(155, &[SELECTION], &window([80, 1], 21, [0x0c, 0]), Ok(()));
        assert_eq!((commits.count(), commits.unseen_ms(), commits.seen_ms()), (1, 100, 146));
    }

    #[test]
    fn what_does_not_come_in_time_is_not_counted() {
        let (mut watch, commits) = (Watch::default(), Effects::default());
        let mut goes = |at, write: &[u8], read: &[u8]| goes(&mut watch, at, write, read, BLOCK, &commits);
        goes(0, &[SELECTION, 80, 1], &[]);
        goes(1, &[0x55, 0x0c], &[]);
        goes(2, &[SUM, 0x5a], &[]);
        goes(3, &[SELECTION, 80, 1], &[]);
        goes(6000, &[SELECTION], &window([80, 1], 21, [0x0c, 0]));
        // A sum without a byte commits nothing.
        goes(6010, &[SUM, 0x5a], &[]);
        goes(6020, &[SELECTION, 80, 1], &[]);
        goes(6030, &[SELECTION], &window([80, 1], 21, [0x0c, 0]));
        assert_eq!((commits.count(), commits.seen_ms()), (0, 0));
    }

    fn look(begun: u64, status: u32, seal: Seal) -> Status {
        Status { begun: ms(begun), ended: ms(begun + 2), status, seal }
    }

    #[test]
    fn a_reset_is_seen_by_its_seal_and_not_by_ours() {
        let (mut watch, resets, offsets) = (Watch::default(), Effects::default(), Effects::default());
        let chip = Chip::by_name(BLOCK).expect("a table");
        watch.reset(ms(100));
        watch.look(&look(110, 0, Seal::Unsealed), &resets, &offsets);
        let outcome = Err(BusError::NoAck);
        passes(&mut watch, (ms(200), ms(201)), &[0], &[], outcome, chip, &Effects::default());
        watch.look(&look(318, 0, Seal::Sealed), &resets, &offsets);
        assert_eq!((resets.count(), resets.unseen_ms(), resets.seen_ms()), (1, 100, 220));
        watch.reset(ms(1000));
        watch.look(&look(1300, 0, Seal::Unsealed), &resets, &offsets);
        watch.seals();
        watch.look(&look(1310, 0, Seal::Sealed), &resets, &offsets);
        assert_eq!((resets.count(), offsets.count()), (1, 0));
    }

    #[test]
    fn an_offset_is_seen_by_its_bits() {
        let (mut watch, resets, offsets) = (Watch::default(), Effects::default(), Effects::default());
        let is_not = Effects::default();
        for (begun, code, bit) in [(0, 0x09, 0x0800), (10_000, 0x0a, 0x0800)] {
            goes(&mut watch, begun, &[CONTROL, code, 0], &[], BLOCK, &is_not);
            goes(&mut watch, begun + 5, &[CONTROL, 0, 0], &[], BLOCK, &is_not);
            watch.look(&look(begun + 51, 0x0001, Seal::Unsealed), &resets, &offsets);
            watch.look(&look(begun + 101, bit, Seal::Unsealed), &resets, &offsets);
            watch.look(&look(begun + 151, 0, Seal::Unsealed), &resets, &offsets);
        }
        assert_eq!((offsets.count(), offsets.unseen_ms(), offsets.seen_ms()), (2, 50, 102));
        assert_eq!((resets.count(), is_not.count()), (0, 0));
    }
}
