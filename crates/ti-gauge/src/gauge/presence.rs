// SPDX-License-Identifier: MIT

//! Whether it is still the same gauge that answers.
//!
//! A pack can be exchanged while it does not answer: in one transfer that fails, in a pause, or while the host sleeps.
//! After each the gauge is asked first which block is selected. It forgets that with its power, and another one has not
//! been told it. Where that shows nothing, the presence is broken, and nothing about the gauge is certain any longer.

use std::time::Duration;

use gauge_bus::replay::Touch;

/// The selection that an access leaves behind.
const NOTHING: [u8; 2] = [0, 0];
/// A pause without a transfer in which a pack can be exchanged without a trace.
pub(super) const PAUSE: Duration = Duration::from_secs(1);
const FAILED_LOOKS: u32 = 6;

fn selection(touches: &[(Touch, u8)]) -> Option<[u8; 2]> {
    match *touches {
        [(Touch::Selects(0), first), (Touch::Selects(1), second)] => Some([first, second]),
        _ => None,
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Moment(u64);

#[derive(Debug, Default)]
pub(super) struct Presence {
    breaks: u64,
    /// Something has happened behind which the gauge could have been exchanged.
    in_doubt: bool,
    failed: u32,
    /// An access is going on, in which pauses count.
    attended: bool,
    /// What the gauge may show as its selection. Several, if it is not certain which was taken.
    selected: Vec<[u8; 2]>,
}

impl Presence {
    pub(super) fn doubt(&mut self) {
        self.in_doubt = true;
    }

    pub(super) fn note_duration(&mut self, time: Duration) {
        self.in_doubt |= self.attended && time >= PAUSE;
    }

    pub(super) fn sends(&mut self, touches: &[(Touch, u8)]) {
        if let (Some([first, second]), true) = (selection(touches), self.attended) {
            let half: Vec<_> = self.selected.iter().map(|&[_, other]| [first, other]).collect();
            self.selected.extend(half);
            self.selected.push([first, second]);
        }
    }

    /// Bytes were acknowledged. A gauge with a flat address space shows a subcommand in place of its selection.
    pub(super) fn sent(&mut self, touches: &[(Touch, u8)], is_flat: bool) {
        match (selection(touches), touches) {
            (Some(selection), _) if self.attended => self.selected = vec![selection],
            (_, [(Touch::Selects(0), _), ..]) => self.selected.clear(),
            (_, [(Touch::Subcommand(0), _), ..]) if is_flat => self.selected.clear(),
            _ => {}
        }
    }

    /// A whole block was read from its selection on. The gauge may show the selection of the next one from now on.
    pub(super) fn note_advance(&mut self, by: u16) {
        let next = |selected: &[u8; 2]| u16::from_le_bytes(*selected).wrapping_add(by).to_le_bytes();
        let next: Vec<_> = self.selected.iter().map(next).collect();
        self.selected.extend(next);
    }

    pub(super) fn end(&mut self) {
        self.breaks += 1;
        (self.in_doubt, self.failed) = (false, 0);
        self.selected.clear();
    }

    /// The present moment. What is in doubt now counts as happening later.
    pub(super) fn moment(&self) -> Moment {
        Moment(self.breaks)
    }

    pub(super) fn is_unbroken_since(&self, moment: Moment) -> bool {
        !self.in_doubt && self.breaks == moment.0
    }

    pub(super) fn is_doubted(&self) -> bool {
        self.in_doubt
    }

    pub(super) fn is_doubted_after(&self, paused: bool) -> bool {
        self.in_doubt || paused && self.attended
    }

    pub(super) fn is_marked(&self) -> bool {
        !self.selected.is_empty()
    }

    pub(super) fn mark(&self) -> Option<[u8; 2]> {
        let [selected] = self.selected[..] else { return None };
        Some(selected)
    }

    /// The gauge shows this as its selection, by which it is known again.
    pub(super) fn learn(&mut self, seen: [u8; 2]) {
        self.selected = vec![seen];
    }

    pub(super) fn look(&mut self) {
        self.in_doubt = false;
    }

    /// Whether a selection that was looked at shows that it is the same gauge, which then has no other.
    pub(super) fn knows_again(&mut self, seen: [u8; 2]) -> bool {
        let known = seen != NOTHING && self.selected.contains(&seen);
        if known {
            self.failed = 0;
            self.learn(seen);
        }
        known
    }

    /// A look at the selection has failed; whether another one may show it.
    pub(super) fn may_look_again(&mut self) -> bool {
        let may = self.failed < FAILED_LOOKS;
        self.failed += u32::from(may);
        may
    }

    pub(super) fn attend(&mut self, attended: bool) {
        self.attended = attended;
        self.selected.clear();
    }
}
