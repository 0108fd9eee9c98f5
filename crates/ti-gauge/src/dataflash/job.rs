// SPDX-License-Identifier: MIT

//! What write, undo, settling and key change have in common: blocks with an old and a new content. [`converge`] is the loop.

use std::time::Duration;

use super::io::{reload, still_open, verify_written};
use super::planned::{Held, Seen, classify};
use super::schemes::{Care, sequence};
use super::session::{RESTORES, Session, put, reads_wrong, store};
use super::state::{Copied, has_lost_memory};
use super::window::{Planned, Window};
use crate::codec::{Bytes, WINDOW};
use crate::error::{Cause, Error, Reason, Result, Step};
use crate::gauge::{Gauge, Phase};

/// Between two looks that show whether a byte moves by itself. Gauges measure once a second.
const MOVES: Duration = Duration::from_millis(1200);
const PAUSE: Duration = Duration::from_millis(200);

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    Old,
    New,
}

pub(super) enum Landed {
    There,
    /// It has the old content again: the new one was given up for this error.
    Back(Error),
    Unknown(Error),
}

/// Blocks with two contents, and how far the gauge has come from one to the other.
pub(super) struct Job {
    /// The blocks that change, in the order of their addresses, then those next to them where they are known.
    pub(super) blocks: Vec<Seen>,
    /// The gauge uses the new content only after a reset.
    pub(super) reset: bool,
    /// The only block is in the window already, which saves loading it.
    pub(super) in_window: bool,
    /// A failure leads back to the old content. Nobody may be there to go back once a write has been interrupted.
    pub(super) returns: bool,
    /// The data memory was lost before the job was begun, so its loss is no reason to give up.
    pub(super) was_lost: bool,
    /// [`Care::Quick`] while the loss of RAM is repaired: each block is looked at once, and again only in doubt.
    pub(super) care: Care,
    /// What a register shows of the new content once it is in use.
    pub(super) copied: Option<Copied>,
    /// Blocks whose commit may have been sent.
    pub(super) touched: usize,
    /// The gauge has begun to use the new content: what is otherwise changed since then it has done itself.
    in_use: bool,
    /// Bytes that no table calls learned, and that were seen to move by themselves.
    moving: Vec<(Window, Bytes)>,
}

impl Job {
    pub(super) fn write(planned: Vec<Planned>, neighbours: Vec<Planned>, reset: bool) -> Self {
        let seen = |block: Planned| Seen { stored: block.old, held: Held::Old, block };
        let blocks = planned.into_iter().chain(neighbours).map(seen).collect();
        Self { returns: true, ..Self::interrupted(blocks, reset) }
    }

    pub(super) fn interrupted(blocks: Vec<Seen>, reset: bool) -> Self {
        Self {
            blocks,
            reset,
            in_window: false,
            returns: false,
            was_lost: false,
            care: Care::Sure,
            copied: None,
            touched: 0,
            in_use: false,
            moving: Vec::new(),
        }
    }

    pub(super) fn changed(&self) -> impl Iterator<Item = &Planned> {
        self.blocks.iter().map(|seen| &seen.block).filter(|block| !block.is_neighbour())
    }

    pub(super) fn all(&self, held: Held) -> bool {
        self.blocks.iter().all(|seen| seen.held == held || seen.block.is_neighbour())
    }

    pub(super) fn is_intact(&self) -> bool {
        self.blocks.iter().all(|seen| !seen.block.is_neighbour() || seen.held == Held::Old)
    }

    fn forward(&mut self, gauge: &mut Gauge, session: &mut Session) -> Result<()> {
        session.begin(gauge)?;
        if self.care == Care::Quick {
            self.store_together(gauge, session)?;
        }
        // RAM that is known has only to be in the window.
        let care = if gauge.chip.volatile.is_some() { Care::Quick } else { Care::Sure };
        let mut touched = self.touched;
        let outcome = self.blocks.iter().filter(|seen| !seen.is_at(Side::New)).try_for_each(|seen| {
            let compared = session.pack.compared;
            session.assure(gauge)?;
            // Where the pack has been compared, other blocks were loaded.
            let in_window = self.in_window && session.pack.compared == compared;
            let block = if in_window { seen.block.clone() } else { reload(gauge, &seen.to_new(), care)? };
            session.go_forward(gauge);
            store(gauge, session, &block, &mut touched)
                .map(|()| gauge.statistics.progress.step(Phase::Committing))
        });
        self.touched = touched;
        outcome
    }

    /// Stores all blocks, then looks at each once: the window shows another one before. Wrong ones are stored one by one.
    fn store_together(&mut self, gauge: &mut Gauge, session: &mut Session) -> Result<()> {
        let waiting: Vec<usize> =
            (0..self.blocks.len()).filter(|&at| !self.blocks[at].is_at(Side::New)).collect();
        for &at in &waiting {
            let moment = session.assure(gauge)?;
            let Ok(block) = reload(gauge, &self.blocks[at].to_new(), Care::Quick) else { continue };
            session.go_forward(gauge);
            let touched = &mut self.touched;
            let _ = put(gauge, &block, moment, || *touched += 1);
        }
        for &at in &waiting {
            let seen = &mut self.blocks[at];
            seen.stored = sequence(gauge).load(gauge, seen.block.place, Care::Quick)?;
            seen.held = classify(&seen.block, &seen.stored);
            if seen.held == Held::New {
                gauge.statistics.progress.step(Phase::Committing);
            }
        }
        session.assure(gauge).map(drop)
    }

    /// Restores the old content. `is_seen` says that the blocks have just been looked at.
    pub(super) fn back(&mut self, gauge: &mut Gauge, session: &mut Session, mut is_seen: bool) -> Result<()> {
        let mut outcome = Ok(());
        for _ in 0..RESTORES {
            let tried = session
                .open_again(gauge)
                .and_then(|()| sequence(gauge).enable(gauge))
                .and_then(|()| session.assure(gauge))
                .and_then(|_| self.way_back().try_for_each(|at| self.restore(gauge, session, at, is_seen)));
            is_seen = false;
            let is_late = !gauge.may_try_until(Duration::MAX);
            // That no time was left for one more attempt is not why the first one failed.
            if !(is_late && outcome.is_err() && tried.is_err()) {
                outcome = tried;
            }
            if outcome.is_ok() || session.pack.is_lost() || is_late {
                break;
            }
            if outcome.as_ref().is_err_and(reads_wrong) {
                self.learn_moving(gauge);
            }
            gauge.wait(PAUSE);
        }
        outcome.map_err(|error| error.at(Step::Restore))
    }

    /// Order of the way back: last written first, so that flash stays open; blocks not yet written come last.
    fn way_back(&self) -> impl Iterator<Item = usize> + use<> {
        let changed = self.changed().count();
        let first = if self.returns { self.touched.min(changed) } else { changed };
        (changed..self.blocks.len()).rev().chain((0..first).rev()).chain(first..changed)
    }

    /// Restores one block. Once the gauge uses the new values only written bytes go back, which keeps what was learned. Before
    /// that all do: a bit error in an address misplaces a byte, and the checksum, a plain sum, does not detect it.
    fn restore(&mut self, gauge: &mut Gauge, session: &mut Session, at: usize, is_seen: bool) -> Result<()> {
        if !is_seen {
            gauge.doubt();
            let seen = &mut self.blocks[at];
            seen.stored = sequence(gauge).load(gauge, seen.block.place, Care::Sure)?;
            session.assure(gauge)?;
            seen.block = seen.block.as_rewritten(gauge.chip, &seen.stored);
            seen.held = classify(&seen.block, &seen.stored);
        }
        let seen @ Seen { block, stored, .. } = &self.blocks[at];
        // A loss of power disturbs the rows beside; any other change of a block that it was not the turn of is not ours.
        let waits = self.returns && at >= self.touched && !block.is_neighbour();
        if seen.is_at(Side::Old) {
            return Ok(());
        }
        if waits && !block.is_erased(stored) {
            // That it clears bits and erases no byte is not told from what another program has written.
            if self.blocks[..self.touched.min(at)].iter().any(|seen| seen.block.is_beside(block)) {
                let why = format!("{}, which was not written yet, has changed", block.place.name(0));
                return Err(Error::new("", Cause::Protocol, why));
            }
            return Ok(());
        }
        let block = &self.without_moving(block);
        let wanted = restored(block, stored, self.in_use || seen.held == Held::New);
        if wanted == *stored {
            return Ok(());
        }
        let other = |at: usize| stored[at] != block.old[at] && stored[at] != 0xff && !block.learned.has(at);
        if block.is_neighbour()
            && !session.decided
            && let Some(at) = (0..WINDOW).find(|&at| other(at))
        {
            let why = format!("{}, which this write does not touch, has changed", block.place.name(at));
            return Err(Error::new("", Cause::Protocol, why));
        }
        session.begin(gauge)?;
        let back = reload(gauge, &block.replacing(*stored, wanted), Care::Sure)?;
        store(gauge, session, &back, &mut 0)
    }

    /// Finds bytes that move by themselves: putting them back would program their block again and again.
    fn learn_moving(&mut self, gauge: &mut Gauge) {
        let first: Vec<_> = self
            .blocks
            .iter()
            .map(|seen| sequence(gauge).load(gauge, seen.block.place, Care::Sure))
            .collect();
        gauge.wait(MOVES);
        for (Seen { block, .. }, first) in self.blocks.iter().zip(first) {
            let Ok(first) = first else { continue };
            let Ok(second) = sequence(gauge).load(gauge, block.place, Care::Sure) else { continue };
            let moving =
                Bytes::of(|at| first[at] != second[at]).without(block.written).without(block.learned);
            if moving != Bytes::default() {
                let names: Vec<String> = moving.iter().map(|at| block.place.name(at)).collect();
                log::warn!("{}: {} moves by itself, and is left alone", gauge.chip.name, names.join(", "));
                self.moving.push((block.place, moving));
            }
        }
    }

    fn without_moving(&self, block: &Planned) -> Planned {
        let moving = self.moving.iter().filter(|(place, _)| *place == block.place);
        let learned = moving.fold(block.learned, |learned, (_, moving)| learned.with(*moving));
        Planned { learned, ..block.clone() }
    }

    /// Brings data flash to one side: stores, makes the gauge use it, and reads back what was not read back since.
    fn bring(&mut self, gauge: &mut Gauge, session: &mut Session, side: Side, is_seen: bool) -> Result<()> {
        let unread: Vec<bool> = self.blocks.iter().map(|seen| is_seen && seen.is_at(side)).collect();
        let ends = match side {
            // The gauge may work with the new values, unless this very job has not come so far.
            Side::Old => self.reset && (self.in_use || !self.returns),
            Side::New => self.reset,
        };
        match side {
            Side::New => self.forward(gauge, session)?,
            Side::Old => {
                if ends {
                    session.keep_reset();
                }
                self.back(gauge, session, is_seen)?;
            }
        }
        let ends = ends || sequence(gauge).always_finishes();
        if ends {
            session.leave_calibration(gauge)?;
            self.in_use |= side == Side::New;
            // All blocks were looked at in the mode that ends here. A way back is sure.
            let care = if side == Side::New { self.care } else { Care::Sure };
            if session.finish(gauge, care, self.copied.as_ref())? {
                return Ok(());
            }
        } else if side == Side::New {
            still_open(gauge)?;
        }
        let unread = self.blocks.iter().zip(unread).filter(|(_, unread)| ends || *unread);
        unread.map(|(seen, _)| seen.to(side)).try_for_each(|block| {
            let verified = verify_written(gauge, &block, self.care);
            if side == Side::Old { verified.map_err(|error| error.at(Step::Restore)) } else { verified }
        })
    }
}

/// Brings data flash to one content of a job, or back to the old one if that fails once anything may be committed.
pub(super) fn converge(
    gauge: &mut Gauge,
    session: &mut Session,
    job: &mut Job,
    side: Side,
    accept: Option<super::Accept<'_>>,
) -> Landed {
    let brought = job.bring(gauge, session, side, true);
    let error = match brought.and_then(|()| accept.map_or(Ok(()), |accept| accept(gauge))) {
        Ok(()) => return Landed::There,
        Err(error) if !job.returns => return Landed::Unknown(error),
        Err(error) if job.touched == 0 => return Landed::Back(error),
        Err(error) => error,
    };
    session.go_back(gauge);
    let was_lost = job.was_lost;
    let is_lost = |gauge: &mut Gauge| !was_lost && has_lost_memory(gauge).unwrap_or(false);
    if is_lost(gauge) {
        session.forget_mode();
        return Landed::Unknown(Error::of("", Reason::PowerLost { failed: error }));
    }
    match job.bring(gauge, session, Side::Old, false) {
        // The blocks of this job may read right, because they had the part's defaults; the others did not.
        Ok(()) if is_lost(gauge) => Landed::Unknown(Error::of("", Reason::PowerLost { failed: error })),
        Ok(()) => {
            let what = "the old value was restored and verified".into();
            Landed::Back(Error::of("", Reason::RolledBack { failed: error, what }))
        }
        Err(then) => {
            let what = "data flash contents unknown".into();
            Landed::Unknown(Error::of("", Reason::NotRestored { failed: error, then, what }))
        }
    }
}

impl Seen {
    fn to(&self, side: Side) -> Planned {
        let block = self.block.clone();
        if side == Side::Old { Planned { old: block.new, new: block.old, ..block } } else { block }
    }

    fn is_at(&self, side: Side) -> bool {
        match self.held {
            Held::Old => side == Side::Old || self.block.is_neighbour(),
            Held::New => side == Side::New,
            Held::Torn | Held::Unexplained => false,
        }
    }

    /// The block on its way to the new content. A learned byte stays as it is, unless its row was erased.
    fn to_new(&self) -> Planned {
        let mut new = self.block.new;
        let erased = self.block.is_erased(&self.stored);
        for at in (0..WINDOW).filter(|&at| self.block.learned.has(at) && !erased) {
            new[at] = self.stored[at];
        }
        self.block.replacing(self.stored, new)
    }
}

/// What a block has to hold when its old bytes are back. A learned byte stays as it is, unless the row was erased.
fn restored(block: &Planned, present: &[u8; WINDOW], in_use: bool) -> [u8; WINDOW] {
    let erased = block.is_erased(present);
    let goes_back = Bytes::of(|at| match in_use && !block.is_neighbour() && !erased {
        true => block.written.has(at) && !block.learned.has(at),
        false => erased || !block.learned.has(at),
    });
    let mut wanted = *present;
    for at in (0..WINDOW).filter(|&at| goes_back.has(at)) {
        wanted[at] = block.old[at];
    }
    wanted
}
