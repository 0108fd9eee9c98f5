// SPDX-License-Identifier: MIT

//! A seal that is owed beside a write that is neither done nor undone. That write may wait for a person for days, and may
//! be of another pack: the seal has a record of its own and is tried again by itself.

use std::time::Duration;

use super::DataFlash;
use super::session::{Reference, Session};
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Gauge, SEAL_LAG, Seal};
use crate::journal::{Entry, Plan};

/// A seal that is owed.
#[derive(Clone, Debug)]
pub(super) struct OwedSeal {
    /// The gauge that was opened; `None` if the record cannot be read.
    entry: Option<Entry>,
    pub(super) why: String,
}

impl DataFlash {
    /// Records that a sealed gauge is about to be opened while a write waits to be settled.
    pub(super) fn owe_seal(&mut self, gauge: &mut Gauge, session: &mut Session) -> Result<()> {
        let identity = self.knowledge.identity(gauge)?;
        let plan = Some(Plan::of_marks(self.knowledge.marks(gauge.chip)));
        let entry = Entry { identity: identity.clone(), machine: None, found: session.found, plan };
        session.entry = Some(entry);
        self.knowledge.refer(gauge, session);
        if let Some(journal) = self.records.journal() {
            session.journal = Some(journal.owe_seal(&identity)?);
        }
        Ok(())
    }

    /// Keeps a seal that could not be restored.
    pub(super) fn keep_seal(&mut self, entry: Entry, why: String) {
        self.owed_seal = Some(OwedSeal { entry: Some(entry), why });
    }

    /// The seal that is owed, also by an earlier process.
    pub(super) fn find_seal(&mut self) -> Option<&OwedSeal> {
        if self.owed_seal.is_none()
            && let Some(journal) = self.records.journal()
        {
            let why = || "a gauge that was found sealed may have been left open".to_string();
            self.owed_seal = match journal.seal_owed() {
                Ok(None) => None,
                Ok(Some(entry)) => Some(OwedSeal { entry: Some(entry), why: why() }),
                // Whatever gauge it was of, this one was not to be left open.
                Err(error) => Some(OwedSeal { entry: None, why: format!("{}: {error}", why()) }),
            };
        }
        self.owed_seal.as_ref()
    }

    /// No seal is owed any more: it is restored, or somebody has changed the seal state on purpose.
    pub(super) fn forget_seal(&mut self) {
        self.owed_seal = None;
        if let Some(Err(error)) = self.records.journal().map(|journal| journal.seal_paid()) {
            log::warn!("{error}");
        }
    }

    /// Seals a gauge to which that is owed. Returns a message for the log; `None` if none is owed.
    pub(super) fn pay_seal(&mut self, gauge: &mut Gauge, waited: Duration) -> Result<Option<String>> {
        let Some(OwedSeal { entry, .. }) = self.find_seal().cloned() else { return Ok(None) };
        let sealed = self.access(gauge, waited, |_, gauge, asked| {
            gauge.claim()?;
            gauge.confirm_identity()?;
            let part = |entry: &Entry| entry.identity.chip == gauge.chip.name;
            if !entry.as_ref().is_none_or(part) {
                let why =
                    "the gauge that was left open was another part; discard what is owed with gaugefs settle";
                return Err(Error::new(gauge.chip.model, Cause::Gone, why).at(Step::Seal));
            }
            // CONTROL_STATUS may still show the state before the last key.
            gauge.wait(SEAL_LAG);
            let mut session = Session::new(Seal::Sealed, asked);
            session.pack.pack = entry.as_ref().map(Reference::of);
            session.seal(gauge)
        });
        match sealed {
            Ok(()) => {
                self.forget_seal();
                Ok(Some("a gauge that had been left open is sealed again".into()))
            }
            Err(error) => {
                let error = error.within("cannot seal a gauge that was found sealed");
                if let Some(owed) = &mut self.owed_seal {
                    owed.why = error.to_string();
                }
                Err(error)
            }
        }
    }

    /// After the seal state was changed on purpose.
    pub(super) fn seal_was_chosen(&mut self, goal: Seal) {
        if self.find_seal().is_some() {
            log::info!("the gauge is {} as somebody has asked for: no seal is owed any more", goal.as_str());
            self.forget_seal();
        }
    }
}
