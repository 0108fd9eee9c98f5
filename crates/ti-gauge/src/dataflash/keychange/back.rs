// SPDX-License-Identifier: MIT

//! The way back of a change of keys: after a failure, and once a gauge answers again.

use std::time::Duration;

use super::beside::{another, restore_rows, same_pack};
use super::remedy::way_out;
use super::ring::SEALS;
use super::{START, Task, Unfinished};
use crate::dataflash::pack::Match;
use crate::dataflash::schemes::sequence;
use crate::dataflash::session::{RESTORES, Session};
use crate::dataflash::verdict::{Verdict, unrestored};
use crate::error::{Cause, Error, Reason, Result, Step};
use crate::gauge::{Gauge, Seal};
use crate::journal::{Identity, Plan};
use crate::keys::{KeyChange, Name, Secret};

/// After a start Voltage() is valid about 1 s later (E2E 1059347).
const MEASURED: Duration = Duration::from_secs(1);
const POLL_INTERVAL: Duration = Duration::from_millis(200);

#[derive(Clone, Copy)]
enum Keyhole {
    /// It is in FULL ACCESS, and this was the key.
    Open(Worked),
    /// No key of that name fits.
    Shut(Name),
    Silent,
}

#[derive(Clone, Copy)]
enum Worked {
    Old,
    New,
    /// Neither was needed, or a mixture of both led there.
    Neither,
}

impl Task<'_> {
    /// Finds out which keys open the gauge, puts the old block back and tries it. The error says what is known.
    pub(super) fn back(&mut self, gauge: &mut Gauge, unfinished: &Unfinished, error: &Error) -> Error {
        let (mut state, mut known) = (Keyhole::Silent, Worked::Neither);
        for _ in 0..RESTORES {
            state = self.open_again(gauge);
            match state {
                Keyhole::Open(Worked::Neither) => {}
                Keyhole::Open(worked) => known = worked,
                Keyhole::Shut(_) => break,
                Keyhole::Silent => continue,
            }
            let mut touched = 0;
            if self.put_back(gauge, unfinished, &mut touched).is_ok() {
                let what = "the old key was restored, and the gauge takes it".into();
                return Error::of("", Reason::RolledBack { failed: error.clone(), what });
            }
            if touched > 0 {
                known = Worked::Neither;
            }
            // A gauge that has just started stores nothing before it has measured its voltage.
            gauge.wait(MEASURED);
        }
        self.is_unknown = matches!((state, known), (Keyhole::Open(_), Worked::Neither));
        let KeyChange { name, new, .. } = self.change;
        let known = match (state, known) {
            (Keyhole::Open(_), Worked::Old) => {
                "the gauge took the old key, but what it keeps could not be put in order and tried again".to_string()
            }
            (Keyhole::Open(_), Worked::New) => {
                // Lets the daemon continue even if the key file has the old key.
                gauge.set_key(*name, new);
                "the gauge takes the new key, and the old one could not be restored".to_string()
            }
            (Keyhole::Open(_), Worked::Neither) => {
                "the gauge is open, but the old key could not be restored: which key it takes is unknown, so it is left \
                 open; do not cut its power and do not seal it"
                    .to_string()
            }
            (Keyhole::Shut(shut), _) if shut == *name => {
                "the gauge takes neither the old key nor the new one, nor a part of each, nor ffff ffff".to_string()
            }
            (Keyhole::Shut(shut), _) => {
                format!("the gauge takes neither its {} key, nor a part of it, nor ffff ffff", shut.as_str())
            }
            (Keyhole::Silent, _) => {
                "the gauge does not answer: it has the old key, the new one, a part of each, or ffff ffff".to_string()
            }
        };
        let way = way_out(&[*name]);
        let what = format!("{known}; this mount undoes the change when it can, as long as it runs; or {way}");
        Error::of("", Reason::KeyUnknown { failed: error.clone(), what })
    }

    /// Whether nobody may be able to open the gauge again once it is SEALED: what it keeps is no key that was tried.
    pub(super) fn is_to_stay_open(&self, gauge: &mut Gauge) -> bool {
        self.is_unknown && gauge.seal() == Ok(Seal::FullAccess)
    }

    fn put_back(&mut self, gauge: &mut Gauge, unfinished: &Unfinished, touched: &mut usize) -> Result<()> {
        sequence(gauge).enable(gauge)?;
        self.write(gauge, &unfinished.before, touched)?;
        self.prove(gauge, &unfinished.ring, unfinished.authentication.as_ref())?;
        SEALS.into_iter().for_each(|name| gauge.set_key(name, unfinished.ring.get(name)));
        gauge.set_key(self.change.name, &self.change.old);
        Ok(())
    }

    pub(super) fn undo(
        &mut self,
        gauge: &mut Gauge,
        plan: &Plan,
        identities: [&Identity; 2],
        watched: bool,
        unfinished: &Unfinished,
        session: &mut Session,
    ) -> Result<Verdict> {
        let way = way_out(&[self.change.name]);
        match self.open_again(gauge) {
            Keyhole::Silent => {
                let why = "the gauge does not answer while its keys are tried";
                return Err(Error::new(gauge.chip.model, Cause::TimedOut, why).at(Step::Restore));
            }
            Keyhole::Shut(name) => {
                let name = name.as_str();
                return Ok(Verdict::Undecided(format!(
                    "a change of keys was cut short, and the gauge takes no {name} key that this mount knows, nor ffff \
                     ffff: it may be another pack; otherwise {way}"
                )));
            }
            Keyhole::Open(_) => {}
        }
        sequence(gauge).enable(gauge)?;
        match same_pack(gauge, identities, plan)? {
            Match::Other(name) => return Ok(Verdict::Undecided(another(&name))),
            Match::Weak if !watched => {
                return Ok(Verdict::Undecided(format!(
                    "a change of keys was cut short, and this gauge has the serial number and the calibration of every new \
                     one, so it may be another pack; if it is the one, {way}"
                )));
            }
            Match::Certain | Match::Weak => {}
        }
        if let Err(error) = self.put_back(gauge, unfinished, &mut 0) {
            self.is_unknown = true;
            if self.is_to_stay_open(gauge) {
                session.stays(Seal::FullAccess);
            }
            return Err(unrestored(error));
        }
        restore_rows(gauge, session, plan)?;
        let name = self.change.name.as_str();
        Ok(Verdict::Done(format!(
            "a change of the {name} key was interrupted; the old key was restored, and the gauge takes it"
        )))
    }

    fn open_again(&mut self, gauge: &mut Gauge) -> Keyhole {
        let limit = gauge.clock.now() + START;
        let now = loop {
            match gauge.seal() {
                Ok(now) => break now,
                Err(_) if gauge.may_try_until(limit) => gauge.wait(POLL_INTERVAL),
                Err(_) => return Keyhole::Silent,
            }
        };
        let Ok(ring) = self.ring(gauge) else { return Keyhole::Silent };
        let mut worked = Worked::Neither;
        for (name, key, goal, above) in ring.rungs(now) {
            if above {
                continue;
            }
            match self.find(gauge, name, key, goal) {
                Ok(Some(found)) if name == self.change.name => worked = self.which(&found),
                Ok(Some(_)) => {}
                Ok(None) => return Keyhole::Shut(name),
                Err(_) => return Keyhole::Silent,
            }
        }
        if self.change.name == Name::Authentication {
            for key in [&self.change.new, &self.change.old] {
                match self.challenge(gauge, key) {
                    Ok(true) => worked = self.which(key),
                    Ok(false) => {}
                    Err(_) => return Keyhole::Silent,
                }
            }
        }
        Keyhole::Open(worked)
    }

    fn which(&self, key: &Secret) -> Worked {
        match key {
            key if *key == self.change.old => Worked::Old,
            key if *key == self.change.new => Worked::New,
            _ => Worked::Neither,
        }
    }
}
