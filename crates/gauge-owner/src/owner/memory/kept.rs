// SPDX-License-Identifier: MIT

//! What a gauge with RAM has learned: saved while its memory is as it should be, restored when it was lost, or on request.

use super::super::access::Access;
use super::super::learning::{Due, Look, over, restored};
use super::super::{Attempt, Snapshot, Version, Wish, operation::Asked, written};
use super::Memory;
use crate::error::{Cause, Error, Result};
use ti_gauge::image::Image;

impl Memory {
    /// Saves what the gauge has learned, if it is time.
    pub(super) fn save_learned(&mut self, access: &mut Access) {
        let published = access.shared().published();
        let is_shown = |snapshot: &Snapshot| snapshot.is_valid && snapshot.is_configured;
        let is_good = published.snapshot.as_deref().is_some_and(is_shown) && self.is_kept();
        match self.learning.due(access.shared(), is_good) {
            Due::Nothing => {}
            Due::Restoration => self.restore_owed(access),
            Due::Look => self.save_what_is_new(access),
        }
    }

    fn save_what_is_new(&mut self, access: &mut Access) {
        let found = self.look_at_learned(access);
        let shared = access.shared();
        match found.and_then(|image| image.map_or(Ok(false), |image| self.learning.save(&image))) {
            Ok(true) => log::info!("{}: what it has learned was saved", shared.name()),
            Ok(false) => {}
            Err(error) => return shared.report(Attempt::LEARNED, &error),
        }
        shared.succeeded(&Attempt::LEARNED);
    }

    /// Restores what was not restored while another gauge had the same pack, unless the gauge has learned something since.
    fn restore_owed(&mut self, access: &mut Access) {
        match self.look_at_learned(access) {
            Ok(None) if self.is_kept() => self.write_profile(access, 0, true),
            Ok(_) => {}
            Err(error) => return access.shared().report(Attempt::LEARNED, &error),
        }
        self.learning.note_restored();
    }

    /// What the gauge has learned; `None` if that is nothing, or no plausible value.
    fn look_at_learned(&mut self, access: &mut Access) -> Result<Option<Image>> {
        Ok(match self.learning.look(access, self.profile.changes())? {
            Look::Learned(image) => Some(image),
            Look::Nothing => None,
            Look::Lost => {
                self.doubt();
                access.hurry();
                None
            }
        })
    }

    pub(in super::super) fn keep_learned(
        &mut self,
        access: &mut Access,
        wish: Wish,
        asked: Asked,
    ) -> Result<()> {
        let refuse = |why: &'static str| Err(Error::new("learned", Cause::NotPermitted, why));
        let chip = access.chip();
        if chip.volatile.is_none() {
            return refuse("its data memory is flash, and keeps what the gauge learns without power");
        }
        if !self.learning.is_stored() {
            return refuse("nothing is kept of a simulated gauge without --state-dir");
        }
        let told = match wish {
            Wish::Show => self.learning.told(chip, self.profile.changes(), self.profile.why()),
            Wish::Forget => format!(
                "{} versions removed; what the gauge itself still has is saved with the next look, unless another pack is \
                 there or its profile is imported\n",
                self.learning.forget(chip)?
            ),
            Wish::Restore(version) => self.restore_learned(access, version, asked)?,
        };
        access.shared().publish(|published| published.learned = (asked.title() + &told).into());
        Ok(())
    }

    /// Writes a version, which is the newest from then on, after what the gauge has learned since the last look.
    fn restore_learned(
        &mut self,
        access: &mut Access,
        named: Option<Version>,
        asked: Asked,
    ) -> Result<String> {
        self.learning.check_contested(access.shared())?;
        let (version, image) = self.learning.version(access.chip(), self.profile.changes(), named)?;
        let begun = access.now();
        if self.is_kept()
            && let Some(present) = self.look_at_learned(access)?
        {
            self.learning.save(&present)?;
        }
        let waited = asked.waited + (access.now() - begun);
        let learned = over(self.profile.changes().to_vec(), restored(&image)?);
        let outcome = access.run(|dataflash, gauge| dataflash.restore(gauge, &learned, true, waited));
        access.shared().next_content();
        access.hurry();
        written::log(access.shared(), &learned, &outcome?);
        self.note_written(access.shared());
        self.learning.save(&image).map_err(|error| {
            error.within(&format!("{version} is restored, but is not the newest version from now on"))
        })?;
        Ok(format!("restored what it had learned until {version}\n"))
    }
}
