// SPDX-License-Identifier: MIT

//! One interrupted write on the gauge that answers: whether this is its pack, and which content it gets.

use std::ops::ControlFlow;

use super::Decision;
use crate::chip::{Chip, KeyStorage};
use crate::codec::WINDOW;
use crate::dataflash::debts::Shown;
use crate::dataflash::job::{Job, Landed, Side, converge};
use crate::dataflash::measured;
use crate::dataflash::pack::{Known, Match, compare, mark_windows};
use crate::dataflash::planned::{Held, Seen, look};
use crate::dataflash::schemes::{Care, sequence};
use crate::dataflash::session::{Reference, Session};
use crate::dataflash::verdict::{Verdict, unrestored};
use crate::dataflash::window::{holds_keys, secrets};
use crate::error::Result;
use crate::gauge::{Gauge, Moment};
use crate::journal::{Identity, Plan};

pub(super) struct Task<'a> {
    pub(super) plan: &'a Plan,
    pub(super) subject: String,
    pub(super) then: &'a Identity,
    pub(super) now: &'a Identity,
    pub(super) watched: bool,
    pub(super) certain: Option<Moment>,
    pub(super) decision: Option<Decision>,
    pub(super) shown: Option<&'a Shown>,
    /// It was begun at another place, or waits for its pack.
    pub(super) elsewhere: bool,
}

impl Task<'_> {
    pub(super) fn run(&self, gauge: &mut Gauge, session: &mut Session) -> Result<Verdict> {
        let chip = gauge.chip;
        if self.plan.by_gauge {
            measured::assure_over(gauge)?;
        }
        let moment = gauge.moment();
        let mut job = Job::interrupted(look(gauge, self.plan)?, self.plan.reset);
        let whose = match self.whose(gauge, session, &job, moment)? {
            ControlFlow::Continue(whose) => whose,
            ControlFlow::Break(verdict) => return Ok(verdict),
        };
        let forward = match self.decision {
            Some(Decision::Finish(_)) => true,
            Some(Decision::Undo(_) | Decision::Discard) => false,
            None => job.is_intact() && job.all(Held::New) && !self.plan.by_gauge,
        };
        // A row that is erased meanwhile is put back with all its blocks.
        if !(job.is_intact() && job.all(if forward { Held::New } else { Held::Old })) {
            gauge.check_writes()?;
        }
        // The mode that the write started may still be on; `begin` detects that.
        if sequence(gauge).always_finishes() {
            session.begin(gauge)?;
        }
        if self.plan.by_gauge && forward && job.blocks.iter().any(|seen| seen.held == Held::Torn) {
            let why = "what the gauge has measured was lost while it was stored: it can only be undone";
            return Ok(Verdict::Undecided(why.into()));
        }
        if !forward && job.is_intact() && job.all(Held::Old) && !self.plan.reset_sent {
            return Ok(match whose {
                Whose::Another(pack) => Verdict::Plausible(format!(
                    "another pack than an interrupted write was begun on, {pack}, has the old values already"
                )),
                whose => whose
                    .settled(format!("{} was interrupted; data flash holds the old values", self.subject)),
            });
        }
        let keys = match job.blocks.iter().any(|seen| has_erased_keys(chip, seen)) {
            true => {
                "; the keys in the same row were erased, and no journal has them: they are ffff ffff now, change \
                     them with gaugefs keys"
            }
            false => "",
        };
        let side = if forward { Side::New } else { Side::Old };
        if let Landed::Unknown(error) = converge(gauge, session, &mut job, side, None) {
            return Err(unrestored(error));
        }
        if let Whose::Another(pack) = whose {
            let values = if forward { "new values" } else { "values from before" };
            return Ok(Verdict::Plausible(format!(
                "the {values} of an interrupted write were written to another pack than it was begun on, {pack}, and \
                 verified"
            )));
        }
        let message = match (forward, self.plan.by_gauge) {
            (true, false) => {
                format!("{} was interrupted after its last block; it has been finished and verified", self.subject)
            }
            (false, false) => {
                format!("{} was interrupted half way; the old values were restored and verified", self.subject)
            }
            (true, true) => "what the gauge has measured and stored was kept".into(),
            (false, true) => {
                "what the gauge has measured and stored was not judged; the old values were restored and verified".into()
            }
        };
        Ok(whose.settled(format!("{message}{keys}")))
    }

    /// Whose pack this is, if it is certain, a person has decided, or data flash need not be touched.
    fn whose(
        &self,
        gauge: &mut Gauge,
        session: &mut Session,
        job: &Job,
        moment: Moment,
    ) -> Result<ControlFlow<Verdict, Whose>> {
        let undecided = |why: String| Ok(ControlFlow::Break(Verdict::Undecided(why)));
        if let Some(decision) = self.decision {
            let whose = match self.chosen(gauge, decision, &job.blocks)? {
                Chosen::Itself => Whose::Certain,
                Chosen::Another(pack) => Whose::Another(pack),
                Chosen::Not(why) => return undecided(why),
            };
            session.pack.pack = Some(self.present(gauge)?);
            session.pack.certain_since(moment);
            return Ok(ControlFlow::Continue(whose));
        }
        let all_old = job.all(Held::Old);
        let whole = job.is_intact() && (all_old || job.all(Held::New));
        match self.doubt(gauge, &job.blocks)? {
            Doubt::None => {
                session.pack.certain_since(moment);
                Ok(ControlFlow::Continue(Whose::Certain))
            }
            Doubt::Weak if self.plan.by_gauge && !all_old => undecided(
                "it was not judged what the gauge has measured and stored, and this gauge has the serial number and the \
                 calibration of every new one, so it may be another pack"
                    .into(),
            ),
            // Flash is not touched, whichever gauge it is. A reset may seal it.
            Doubt::Weak if whole && opens_again(gauge) => {
                session.pack.certain_since(moment);
                Ok(ControlFlow::Continue(Whose::Unproven))
            }
            Doubt::Weak if whole => {
                let held = if all_old { "old" } else { "new" };
                let why = format!("{} was interrupted; data flash holds the {held} values", self.subject);
                Ok(ControlFlow::Break(Verdict::Plausible(why)))
            }
            Doubt::Weak => undecided(
                "this gauge has the serial number and the calibration of every new one, so it may be another pack"
                    .into(),
            ),
            Doubt::Another => Ok(ControlFlow::Break(Verdict::Another)),
            Doubt::Exchanged(why) => {
                session.pack.mark_exchanged();
                undecided(why)
            }
            Doubt::Because(why, same) => {
                if same == Match::Certain {
                    session.pack.certain_since(moment);
                }
                undecided(why)
            }
        }
    }

    fn chosen(&self, gauge: &mut Gauge, decision: Decision, seen: &[Seen]) -> Result<Chosen> {
        let look = "look at it with gaugefs settle GAUGE before you decide";
        if self.shown.is_some_and(|shown| !shown.is(self.now, seen)) {
            let why = format!("this is not what was shown: another pack, or it has changed since; {look}");
            return Ok(Chosen::Not(why));
        }
        let number = number_of(gauge.chip, self.now);
        if let Some(pack) = decision.pack()
            && (number.is_none() || pack != self.now.serial)
        {
            let number = number.unwrap_or("none".into());
            return Ok(Chosen::Not(format!(
                "the serial number of this pack is {number}, not 0x{pack:04x}; {look}"
            )));
        }
        let Match::Other(name) = compare_seen(gauge, [self.then, self.now], self.plan, seen)? else {
            return Ok(Chosen::Itself);
        };
        Ok(match (number, decision.pack(), self.shown) {
            (Some(number), Some(_), _) => Chosen::Another(format!("serial number {number}")),
            (None, _, Some(_)) => Chosen::Another("which was shown before".into()),
            (Some(number), None, _) => Chosen::Not(format!(
                "{name} is not what it was then: this is another pack, serial number {number}; to write to it all the same, \
                 add --serial {number}"
            )),
            (None, _, None) => {
                Chosen::Not(format!("{name} is not what it was then: this is another pack; {look}"))
            }
        })
    }

    fn doubt(&self, gauge: &mut Gauge, seen: &[Seen]) -> Result<Doubt> {
        let same = compare_seen(gauge, [self.then, self.now], self.plan, seen)?;
        if self.elsewhere && same != Match::Certain {
            return Ok(if shows(seen, &same) { Doubt::Weak } else { Doubt::Another });
        }
        if let Match::Other(name) = &same {
            // RAM without a flag for its loss looks the same as another pack.
            let or_lost = match gauge.chip.volatile {
                Some(0) => ", or the gauge has lost its power and with it its data memory",
                _ => "",
            };
            return Ok(Doubt::Exchanged(format!(
                "{name} is not what it was then: this is another pack{or_lost}"
            )));
        }
        let certain =
            same == Match::Certain || self.certain.is_some_and(|moment| gauge.is_unbroken_since(moment));
        if !(self.watched && certain)
            && let Some(Seen { block, stored, .. }) = seen.iter().find(|seen| seen.held == Held::Unexplained)
        {
            let unlike = |&at: &usize| {
                ![block.old[at], block.new[at], 0xff].contains(&stored[at]) && !block.learned.has(at)
            };
            let at = (0..WINDOW).find(unlike).unwrap_or(0);
            let why = format!(
                "{} holds 0x{:02x}, which the write does not explain (old 0x{:02x}, new 0x{:02x})",
                block.place.name(at),
                stored[at],
                block.old[at],
                block.new[at]
            );
            return Ok(Doubt::Because(why, same));
        }
        Ok(if certain { Doubt::None } else { Doubt::Weak })
    }

    fn present(&self, gauge: &mut Gauge) -> Result<Reference> {
        let mut known = Known::default();
        for place in mark_windows(gauge.chip) {
            known.note(gauge.chip, place, sequence(gauge).load(gauge, place, Care::Sure)?);
        }
        let plan = Plan { marks: known.marks(gauge.chip), ..self.plan.clone() };
        Ok(Reference { identity: self.now.clone(), plan })
    }
}

enum Whose {
    Certain,
    Unproven,
    /// On another one, as a person has decided, named for the message.
    Another(String),
}

impl Whose {
    /// How it was settled. Its journal is kept where nothing proves that it was this pack's.
    fn settled(self, how: String) -> Verdict {
        match self {
            Whose::Certain => Verdict::Done(how),
            Whose::Unproven | Whose::Another(_) => Verdict::Plausible(how),
        }
    }
}

enum Doubt {
    None,
    /// Nothing shows that this is another pack, and nothing that it is the one.
    Weak,
    /// The write was begun elsewhere, and nothing of it shows here.
    Another,
    Exchanged(String),
    Because(String, Match),
}

enum Chosen {
    Itself,
    /// Another one, named for the message.
    Another(String),
    /// Not this one; the text says why.
    Not(String),
}

/// Whether a gauge that nothing proves to be the one shows what an interrupted write leaves: some of it new, or erased.
pub(super) fn shows(seen: &[Seen], same: &Match) -> bool {
    let erased = seen.iter().any(|seen| seen.block.is_erased(&seen.stored));
    let explained = seen.iter().all(|seen| seen.held != Held::Unexplained);
    let all = |held: Held| seen.iter().all(|seen| seen.held == held || seen.block.is_neighbour());
    *same == Match::Weak && (erased || explained && !all(Held::Old) && !all(Held::New))
}

pub(super) fn compare_seen(
    gauge: &mut Gauge,
    [then, now]: [&Identity; 2],
    plan: &Plan,
    seen: &[Seen],
) -> Result<Match> {
    compare(gauge.chip, then, now, plan, |place| {
        let seen = seen.iter().find(|seen| seen.block.place == place);
        seen.map_or_else(|| sequence(gauge).load(gauge, place, Care::Sure), |seen| Ok(seen.stored))
    })
}

pub(super) fn number_of(chip: &Chip, identity: &Identity) -> Option<String> {
    chip.serial_register().map(|_| format!("0x{:04x}", identity.serial))
}

fn has_erased_keys(chip: &Chip, seen: &Seen) -> bool {
    let place = seen.block.place;
    holds_keys(chip, place) && secrets(chip, place).iter().all(|at| seen.stored[at] == 0xff)
}

fn opens_again(gauge: &Gauge) -> bool {
    gauge.was_opened() || matches!(gauge.chip.security.storage, KeyStorage::Fixed(_))
}
