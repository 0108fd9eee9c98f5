// SPDX-License-Identifier: MIT

//! Data memory that is RAM: after a loss of power its profile is written again before values that depend on it are shown.

use std::time::Duration;

use super::access::Access;
use super::handle::Shared;
use super::learning::Learning;
use super::profile::Profile;
use super::{Attempt, Presence, written};
use crate::choose::Undecided;
use crate::error::{Cause, Error, Step};
use ti_gauge::chip::{Chip, Role, Subclass};
use ti_gauge::dataflash::{self, Change, Outcome};
use ti_gauge::epoch::Fact;
use ti_gauge::gauge::{Seal, Statistics};
use ti_gauge::registers::Registers;
use ti_gauge::value::Value;

mod kept;

/// How often the profile is written to a gauge that has lost it again by the next poll.
const TRIES: u32 = 3;

#[derive(Debug)]
pub(super) struct Memory {
    /// What it should hold.
    profile: Profile,
    learning: Learning,
    loss: Loss,
    /// While nothing is chosen: the gauge has other values than the part's defaults where a profile has some.
    is_own: Fact<bool, Presence>,
    /// The profile has been compared with this gauge, which nobody may have exchanged or switched off since.
    compared: Fact<(), Presence>,
    /// Since the gauge has come, one of the profiles was chosen, or somebody else has configured it.
    is_believed: bool,
    /// DesignCapacity() as last polled, of a part without the flag.
    design: Option<i64>,
    /// How often the profile was written, and lost again by the next look at it.
    lost_again: u32,
    /// The gauge was told that it has a battery.
    inserted: Fact<(), Presence>,
    /// The gauge has reported another battery, and still has what it has learned of the one before, of this name.
    exchanged: Option<Before>,
    /// It has reported that its battery was taken out.
    is_away: bool,
}

/// The name of the pack that was there before an exchange, if it had one.
#[derive(Debug)]
struct Before(Option<String>);

#[derive(Debug, Default)]
enum Loss {
    /// No loss is known.
    #[default]
    None,
    /// The profile is to be written. That has failed `attempts` times, and `failure` is the last one.
    Owed { attempts: u32, failure: String },
    /// There is no profile to write.
    Accepted,
    /// The profile was written, and the next poll shows whether the gauge keeps it.
    Written,
    /// The gauge loses it each time.
    Stopped,
}

impl Memory {
    pub(super) fn new(profile: Profile, learning: Learning) -> Self {
        Self {
            profile,
            learning,
            loss: Loss::None,
            is_own: Fact::default(),
            compared: Fact::default(),
            is_believed: false,
            design: None,
            lost_again: 0,
            inserted: Fact::default(),
            exchanged: None,
            is_away: false,
        }
    }

    #[cfg(test)]
    pub(super) fn store(&self) -> Option<super::Learned> {
        self.learning.store()
    }

    /// Whether a loss of it is looked for.
    pub(super) fn is_watched(&self, chip: &Chip) -> bool {
        chip.volatile.is_some() && self.is_managed()
    }

    pub(super) fn is_managed(&self) -> bool {
        !self.profile.changes().is_empty() || self.profile.is_choice()
    }

    /// Whether no loss of it is known, and it is configured.
    fn is_kept(&self) -> bool {
        matches!(self.loss, Loss::None) && !self.profile.changes().is_empty()
    }

    pub(super) fn arrives(&mut self) {
        (self.loss, self.lost_again) = (Loss::None, 0);
        (self.is_away, self.is_believed) = (false, false);
        self.learning.arrives();
        if self.exchanged.is_some() {
            self.loss = Loss::Owed { attempts: 0, failure: String::new() };
        }
        self.doubt();
    }

    /// The gauge may have lost its power unnoticed.
    pub(super) fn doubt(&mut self) {
        self.compared = Fact::default();
        self.is_own = Fact::default();
        self.profile.doubt();
        self.learning.doubt();
    }

    /// Whether the registers that are copies of data memory are read with each poll: no flag shows its loss.
    pub(super) fn watches_copies(&self, chip: &Chip) -> bool {
        chip.volatile == Some(0) && self.is_managed()
    }

    pub(super) fn is_look_due(&self, now: Duration) -> bool {
        self.learning.is_look_due(now)
    }

    /// Whether what data memory holds now is about to be replaced, or should be.
    pub(super) fn is_waited_for(&self) -> bool {
        matches!(self.loss, Loss::Owed { .. } | Loss::Stopped)
    }

    /// Whether the registers of a poll follow from the profile, or the gauge has none.
    pub(super) fn is_configured(&mut self, shared: &Shared, registers: &Registers) -> bool {
        let chip = shared.chip;
        let Some(flag) = chip.volatile.filter(|_| self.is_managed()) else { return true };
        // The register is a copy of data memory.
        let design = chip.register(Role::ChargeFullDesign).and_then(|design| registers.value(design));
        if flag == 0 && std::mem::replace(&mut self.design, design) != design {
            self.doubt();
        }
        // A gauge without the flag is believed once it has been compared.
        let is_believed = match flag {
            0 => self.compared.is_known(shared.published().presence),
            _ => !self.profile.is_choice() || self.is_believed,
        };
        is_believed && !self.is_waited_for() && !reports_loss(chip, registers)
    }

    /// Writes the profile to a gauge that has lost it. Called after each scheduled poll, whose flags show it. Where no
    /// flag does, or somebody has cleared it, the profile is compared: at an arrival, after a silence, and now and then.
    pub(super) fn keep_configured(&mut self, access: &mut Access) {
        self.repair(access);
        self.tell_of_battery(access);
        self.save_learned(access);
    }

    /// Called after a poll that somebody has asked for: one poll after the other leaves no time for a scheduled one.
    pub(super) fn repair_if_overdue(&mut self, access: &mut Access) {
        let published = access.shared().published();
        let is_shown = published.snapshot.as_ref().is_none_or(|snapshot| snapshot.is_configured);
        // What has failed is tried again after its pause.
        if !is_shown && matches!(self.loss, Loss::None | Loss::Written | Loss::Owed { attempts: 0, .. }) {
            self.repair(access);
        }
    }

    fn repair(&mut self, access: &mut Access) {
        let chip = access.chip();
        let Some(flag) = chip.volatile else { return };
        let published = access.shared().published();
        let snapshot = published.snapshot.as_ref().filter(|_| published.limited.is_none());
        // Another pack is identified first, with the next poll.
        let Some(snapshot) = snapshot.filter(|_| !access.doubts()) else { return };
        let is_reported = reports_loss(chip, &snapshot.registers);
        if flag == 0 && published.seal != Seal::Sealed && access.schedule().has_read_slow_tier() {
            self.doubt();
        }
        let is_compared = self.compared.is_known(published.presence);
        let Some((attempts, is_lost)) = self.judge(flag, is_reported, is_compared) else { return };
        // If the power was lost between two polls, what was read is out of date, and the seal may be open.
        if is_lost {
            access.shared().forget_dataflash();
        }
        if is_reported {
            if !matches!(self.loss, Loss::Owed { .. }) {
                self.profile.look_again();
            }
            access.forget_memory();
        }
        access.publish_seal();
        if !self.is_managed() {
            self.loss = Loss::Accepted;
            access.hurry();
            return;
        }
        if self.lost_again >= TRIES {
            return self.stop_restoring(access);
        }
        match self.choose_profile(access.shared(), is_lost) {
            Ok(()) if !is_reported && self.is_pack_of_before() => {
                (self.exchanged, self.loss) = (None, Loss::None);
                self.write_profile(access, attempts, false);
            }
            Ok(()) => self.write_profile(access, attempts, is_lost),
            Err(undecided) => self.wait_for_choice(access, &undecided, is_lost, attempts),
        }
    }

    /// Whether the profile has to be written or compared: how often that has failed, and whether the memory is lost.
    fn judge(&mut self, flag: u32, is_reported: bool, is_compared: bool) -> Option<(u32, bool)> {
        match (&self.loss, is_reported) {
            // The end of CONFIG UPDATE clears the flag also after a write that failed.
            (Loss::Owed { attempts, .. }, _) => Some((*attempts, true)),
            (Loss::None, true) => Some((0, true)),
            (Loss::Written, true) => {
                self.lost_again += 1;
                Some((0, true))
            }
            (Loss::Accepted | Loss::Stopped, true) => None,
            (Loss::Stopped, false) if flag == 0 => None,
            (Loss::Written, false) if flag == 0 => Some((0, false)),
            (Loss::None | Loss::Accepted | Loss::Written | Loss::Stopped, false) => {
                (self.loss, self.lost_again) = (Loss::None, 0);
                (!is_compared && self.is_managed() && !self.is_away).then_some((0, false))
            }
        }
    }

    fn wait_for_choice(&mut self, access: &mut Access, undecided: &Undecided, is_lost: bool, attempts: u32) {
        let why = &undecided.why;
        if is_lost {
            self.owe(access, why, false, attempts);
        } else {
            let why = format!("{why}; tried again with the next poll");
            access.shared().report(Attempt::RESTORE, &Error::new("profile", Cause::NotNow, why));
            self.is_believed = self.is_configured_by_others(access);
            self.show_configured(access.shared());
        }
        if undecided.is_pending {
            access.hurry();
        }
    }

    /// The gauge, with power, reports that its battery was taken out or is back. It keeps what it learned of the old one.
    pub(super) fn battery_has_changed(&mut self, access: &mut Access, is_there: bool) {
        let (chip, shared) = (access.chip(), access.shared());
        let what = if is_there { "a battery was inserted" } else { "the battery was taken out" };
        log::info!("{}: {what}", shared.name());
        let was_told = self.inserted.is_known(shared.published().presence);
        shared.begin_presence();
        if was_told {
            self.inserted.learn(shared.published().presence, ());
        }
        // By its profile no pin detects one: the flag shows what a host has said.
        if waits_for_insertion(chip, self.profile.changes()).is_some() {
            return;
        }
        self.is_away = !is_there;
        if !is_there {
            return;
        }
        if self.is_watched(chip) {
            let before = self.learning.pack_name().map(str::to_string);
            self.exchanged.get_or_insert(Before(before));
            self.loss = Loss::Owed { attempts: 0, failure: String::new() };
        }
        shared.forget_dataflash();
        access.doubt_pack();
        access.hurry();
    }

    /// Whether a battery that was taken out and inserted is certainly the same pack, by its name.
    fn is_pack_of_before(&self) -> bool {
        let before = self.exchanged.as_ref().and_then(|before| before.0.as_deref());
        before.is_some() && before == self.learning.pack_name()
    }

    fn choose_profile(&mut self, shared: &Shared, is_lost: bool) -> Result<(), Undecided> {
        let chosen = self.profile.choose(shared, is_lost);
        if let Some(pack) = chosen.inspect_err(|_| self.learning.belongs_to(None, false))? {
            self.learning.belongs_to(pack.name, pack.anywhere);
            self.is_believed = true;
        }
        Ok(())
    }

    /// Whether data memory differs from the part's defaults where a profile does: another may have cleared the flag.
    fn is_configured_by_others(&mut self, access: &mut Access) -> bool {
        let now = access.shared().published().presence;
        if let Some(is_own) = self.is_own.get(now) {
            return *is_own;
        }
        let changes: Vec<Change> = self.profile.of_choices().cloned().collect();
        let mut rows: Vec<&'static Subclass> = Vec::new();
        for (subclass, _) in changes.iter().filter_map(Change::row) {
            if !rows.iter().any(|row| std::ptr::eq(*row, subclass)) {
                rows.push(subclass);
            }
        }
        let read = access.run(|dataflash, gauge| dataflash.read(gauge, &rows, Duration::ZERO));
        let Ok(read) = read else { return false };
        let is_own = changes.iter().any(|change| {
            let stored = change.row().and_then(|(subclass, row)| {
                let at = rows.iter().position(|row| std::ptr::eq(*row, subclass))?;
                let begin = usize::from(row.offset - subclass.start());
                read[at].get(begin..begin + row.kind.size())
            });
            !change.is_learned() && stored.is_some_and(|stored| !change.is_default(stored))
        });
        self.is_own.learn(now, is_own);
        is_own
    }

    fn write_profile(&mut self, access: &mut Access, attempts: u32, is_lost: bool) {
        let is_of_another_pack = self.exchanged.is_some();
        let (profile, learned) =
            self.learning.add_to(access.shared(), self.profile.changes(), is_of_another_pack);
        let ended = Statistics::read(&access.shared().statistics.resets);
        let outcome =
            access.run(|dataflash, gauge| dataflash.restore(gauge, &profile, is_lost, Duration::ZERO));
        if outcome != Ok(Outcome::Unchanged) {
            access.shared().forget_dataflash();
        }
        let error = match outcome {
            Ok(Outcome::Unchanged) => return self.note_unchanged(access.shared()),
            Ok(outcome) => {
                written::log(access.shared(), &profile, &outcome);
                return self.note_restored(access, learned.as_ref().map(ToString::to_string));
            }
            Err(error) => error,
        };
        // It was written to the end, and the gauge has lost it at once.
        let was_written = Statistics::read(&access.shared().statistics.resets) > ended;
        // Where no flag shows that, what does not stay there is taken for it.
        let is_lost =
            access.chip().volatile == Some(0) || dataflash::has_lost_memory(access.gauge()) == Ok(true);
        if was_written && is_lost {
            self.lost_again += 1;
        }
        match self.lost_again >= TRIES {
            true => self.stop_restoring(access),
            false => self.owe(access, &error.to_string(), error.is_owed(), attempts),
        }
    }

    fn note_unchanged(&mut self, shared: &Shared) {
        self.compared.learn(shared.published().presence, ());
        shared.succeeded(&Attempt::RESTORE);
        (self.loss, self.exchanged) = (Loss::None, None);
        self.lost_again = 0;
        self.show_configured(shared);
    }

    fn note_restored(&mut self, access: &mut Access, learned: Option<String>) {
        let shared = access.shared();
        shared.succeeded(&Attempt::RESTORE);
        // Whatever had been interrupted is gone with the memory.
        shared.succeeded(&Attempt::SETTLE);
        let learned = learned.map(|time| format!(", with what it had learned until {time}"));
        let learned = learned.unwrap_or_default();
        let why = match self.exchanged {
            Some(_) => "has another battery; its profile is written",
            None => "lost its configuration with its power; the profile is restored",
        };
        log::info!("{}: {why}{learned}", shared.name());
        if shared.chip.volatile == Some(0) && matches!(self.loss, Loss::Written) {
            self.lost_again += 1;
        }
        self.note_written(shared);
        access.hurry();
    }

    fn note_written(&mut self, shared: &Shared) {
        self.compared.learn(shared.published().presence, ());
        (self.loss, self.exchanged) = (Loss::Written, None);
        self.design = None;
        self.inserted = Fact::default();
        self.learning.note_written();
    }

    /// By the profile no pin detects a battery (`[BIE]` is 0), and without BAT_INSERT such a gauge does not gauge (SLUUAC9A
    /// 4.1.7). Said once after an arrival or a restore, so that a BAT_REMOVE of somebody else stays.
    fn tell_of_battery(&mut self, access: &mut Access) {
        let chip = access.chip();
        let published = access.shared().published();
        let Some(code) = waits_for_insertion(chip, self.profile.changes()) else { return };
        let flags = published.snapshot.as_ref().zip(chip.register(Role::Flags));
        let flags = flags.and_then(|(snapshot, flags)| snapshot.value(flags));
        let is_there = flags.is_none_or(|flags| flags & i64::from(chip.condition.present) != 0);
        if is_there || self.is_waited_for() || self.inserted.is_known(published.presence) {
            return;
        }
        match access.gauge().ask(code) {
            Ok(_) => {
                log::info!(
                    "{}: waits for a battery by its configuration; BAT_INSERT was sent",
                    access.shared().name()
                );
                self.inserted.learn(published.presence, ());
                access.hurry();
            }
            Err(error) => access.shared().report(Attempt::RESTORE, &error.within("BAT_INSERT")),
        }
    }

    /// What was polled before the profile was compared can be shown now.
    fn show_configured(&mut self, shared: &Shared) {
        let registers = shared.published().snapshot.as_ref().map(|snapshot| snapshot.registers.clone());
        let is_configured = registers.is_some_and(|registers| self.is_configured(shared, &registers));
        shared.publish(|published| {
            if let Some(snapshot) = &mut published.snapshot
                && snapshot.is_configured != is_configured
            {
                std::sync::Arc::make_mut(snapshot).is_configured = is_configured;
            }
        });
    }

    fn stop_restoring(&mut self, access: &Access) {
        let why = format!(
            "the gauge has lost its data memory {TRIES} times right after the profile was written to it, so it is not \
             written any more: it resets as soon as it is configured; check its supply, and whether the profile is for \
             this part; after that, unplug the gauge or restart the mount"
        );
        let error = Error::new("profile", Cause::NotNow, why).at(Step::Restore);
        access.shared().report(Attempt::RESTORE, &error);
        self.loss = Loss::Stopped;
        self.show_configured(access.shared());
    }

    /// The profile could not be written; it is tried again.
    fn owe(&mut self, access: &mut Access, why: &str, owed: bool, attempts: u32) {
        let why = format!("{why}; tried again with the next poll");
        let error = Error::new("profile", Cause::NotNow, why).owing(owed);
        let line = error.to_string();
        match &self.loss {
            // In the log only once.
            Loss::Owed { failure, .. } if *failure == line => {
                access.shared().record(Attempt::RESTORE, &error);
            }
            _ => access.shared().report(Attempt::RESTORE, &error),
        }
        self.loss = Loss::Owed { attempts: attempts.saturating_add(1), failure: line };
        self.show_configured(access.shared());
        let (now, interval) = (access.now(), access.shared().published().interval);
        access.schedule().try_again(now, attempts, interval);
    }
}

/// The subcommand for which a gauge with this profile waits before it gauges.
fn waits_for_insertion(chip: &Chip, profile: &[Change]) -> Option<u16> {
    let insert =
        chip.subcommands.iter().find(|subcommand| subcommand.name == "BAT_INSERT" && subcommand.sealed)?;
    let waits = |change: &Change| {
        let bit = change.row()?.1.bits.iter().find(|bit| bit.name == "BIE")?;
        let Some(Value::Int(word)) = change.value_of(change.bytes()) else { return None };
        Some(word & i64::from(bit.mask) == 0)
    };
    profile.iter().find_map(waits)?.then_some(insert.code)
}

pub(super) fn reports_loss(chip: &Chip, registers: &Registers) -> bool {
    let flags = chip.register(Role::Flags).and_then(|flags| registers.value(flags));
    flags.zip(chip.volatile).is_some_and(|(flags, lost)| flags & i64::from(lost) != 0)
}

#[cfg(test)]
mod tests;
