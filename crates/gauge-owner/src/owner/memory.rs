// SPDX-License-Identifier: MIT

//! Data memory that is RAM: a gauge whose power is gone for a moment has TI's defaults, and predicts nonsense. Its profile
//! is written again before anything that depends on it is shown.

use std::time::Duration;

use super::claim::Claim;
use super::{Attempt, Owner, Presence, operations};
use crate::choose::{Choice, Undecided, choose};
use crate::error::{Cause, Error, Step};
use crate::evidence::{Evidence, Looks};
use ti_gauge::chip::{Chip, Role, Subclass};
use ti_gauge::dataflash::{self, Change, Outcome};
use ti_gauge::epoch::Fact;
use ti_gauge::gauge::{Seal, Statistics};
use ti_gauge::registers::Registers;
use ti_gauge::value::Value;

/// How often the profile is written to a gauge that has lost it again by the next poll.
const TRIES: u32 = 3;

/// What is known of data memory in RAM.
#[derive(Debug)]
pub(super) struct Memory {
    /// See [`super::Run::profile`]; the chosen one, where there are several.
    profile: Vec<Change>,
    /// See [`super::Run::choices`].
    choices: Vec<Choice>,
    /// The choice was made for this gauge, which nobody may have exchanged since.
    chosen: Fact<(), Presence>,
    /// What was chosen, and why.
    why: String,
    /// What it is chosen by.
    looks: Looks,
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
    /// Says whose pack the gauge has, while it is certain that it has it.
    pub(super) claim: Option<Claim>,
    /// Another gauge has that pack as well.
    pub(super) is_contested: bool,
    /// What its pack has learned was not restored, because another gauge has it as well.
    pub(super) owes_learned: bool,
    /// When what it has learned is looked at.
    pub(super) next_look: Option<Duration>,
    /// What was found there first since it has come, or was written.
    pub(super) first: Option<Vec<Change>>,
}

/// The name of the pack that was there before an exchange, if it had one.
#[derive(Debug)]
struct Before(Option<String>);

/// The loss of the configuration.
#[derive(Debug, Default)]
enum Loss {
    /// None that is known of.
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
    pub(super) fn new(profile: Vec<Change>, choices: Vec<Choice>) -> Self {
        Self {
            profile,
            choices,
            chosen: Fact::default(),
            why: String::new(),
            looks: Looks::default(),
            loss: Loss::None,
            is_own: Fact::default(),
            compared: Fact::default(),
            is_believed: false,
            design: None,
            lost_again: 0,
            inserted: Fact::default(),
            exchanged: None,
            is_away: false,
            claim: None,
            is_contested: false,
            owes_learned: false,
            next_look: None,
            first: None,
        }
    }

    pub(super) fn profile(&self) -> &[Change] {
        &self.profile
    }

    /// What was chosen, and why; empty where there is no choice, or none was made.
    pub(super) fn why(&self) -> &str {
        &self.why
    }

    /// Whether what the gauge has learned is of another pack than the one that is there.
    pub(super) fn is_of_another_pack(&self) -> bool {
        self.exchanged.is_some()
    }

    /// Whether a loss of it is looked for.
    pub(super) fn is_watched(&self, chip: &Chip) -> bool {
        chip.volatile.is_some() && self.is_managed()
    }

    /// Whether there is a profile, or will be.
    pub(super) fn is_managed(&self) -> bool {
        !self.profile.is_empty() || !self.choices.is_empty()
    }

    /// Whether no loss of it is known, and it is configured.
    pub(super) fn is_kept(&self) -> bool {
        matches!(self.loss, Loss::None) && !self.profile.is_empty()
    }

    /// A gauge has come, or come back.
    pub(super) fn arrives(&mut self) {
        (self.loss, self.lost_again, self.first) = (Loss::None, 0, None);
        (self.is_away, self.is_believed, self.owes_learned) = (false, false, false);
        if self.exchanged.is_some() {
            self.loss = Loss::Owed { attempts: 0, failure: String::new() };
        }
        self.doubt();
    }

    /// The gauge may have lost its power unnoticed.
    pub(super) fn doubt(&mut self) {
        self.compared = Fact::default();
        self.chosen = Fact::default();
        self.is_own = Fact::default();
        self.claim = None;
        self.looks.forget();
    }

    /// Whether the registers that are copies of data memory are read with each poll: no flag shows its loss.
    pub(super) fn watches_copies(&self, chip: &Chip) -> bool {
        chip.volatile == Some(0) && self.is_managed()
    }

    /// Whether it is time for a look at what the gauge has learned.
    pub(super) fn is_look_due(&self, now: Duration) -> bool {
        self.next_look.is_some_and(|due| due <= now)
    }

    /// Whether what data memory holds now is about to be replaced, or should be.
    pub(super) fn is_waited_for(&self) -> bool {
        matches!(self.loss, Loss::Owed { .. } | Loss::Stopped)
    }
}

impl Owner {
    /// Whether the registers of a poll follow from the profile, or the gauge has none.
    pub(super) fn is_configured(&mut self, registers: &Registers) -> bool {
        let chip = self.gauge.chip;
        let Some(flag) = chip.volatile.filter(|_| self.memory.is_managed()) else { return true };
        // The register is a copy of data memory.
        let design = chip.register(Role::ChargeFullDesign).and_then(|design| registers.value(design));
        if flag == 0 && std::mem::replace(&mut self.memory.design, design) != design {
            self.memory.doubt();
        }
        // A gauge without the flag is believed once it has been compared.
        let is_believed = match flag {
            0 => self.memory.compared.is_known(self.shared.published().presence),
            _ => self.memory.choices.is_empty() || self.memory.is_believed,
        };
        is_believed && !self.memory.is_waited_for() && !reports_loss(chip, registers)
    }

    /// Writes the profile to a gauge that has lost it with its power. Called after each scheduled poll, whose flags show
    /// the loss. Where no flag does, the profile is compared: when the gauge has come or has not answered, and now and
    /// then while it is open. A flag may have been cleared by somebody else, so that is compared once, too.
    pub(super) fn keep_configured(&mut self) {
        self.repair_memory();
        self.tell_of_battery();
        self.save_learned();
    }

    /// Called after a poll that somebody has asked for: whoever asks again and again leaves no time for a scheduled one.
    pub(super) fn repair_if_overdue(&mut self) {
        let published = self.shared.published();
        let is_shown = published.snapshot.as_ref().is_none_or(|snapshot| snapshot.is_configured);
        // What has failed is tried again after its pause.
        if !is_shown
            && matches!(self.memory.loss, Loss::None | Loss::Written | Loss::Owed { attempts: 0, .. })
        {
            self.repair_memory();
        }
    }

    fn repair_memory(&mut self) {
        let chip = self.gauge.chip;
        let Some(flag) = chip.volatile else { return };
        let published = self.shared.published();
        let snapshot = published.snapshot.as_ref().filter(|_| published.limited.is_none());
        // Another pack is identified first, with the next poll.
        let Some(snapshot) = snapshot.filter(|_| !self.dataflash.doubts()) else { return };
        let is_reported = reports_loss(chip, &snapshot.registers);
        if flag == 0 && published.seal != Seal::Sealed && self.schedule.has_read_slow_tier() {
            self.memory.doubt();
        }
        let is_compared = self.memory.compared.is_known(published.presence);
        let (attempts, is_lost) = match (&self.memory.loss, is_reported) {
            // The end of CONFIG UPDATE clears the flag also after a write that failed.
            (Loss::Owed { attempts, .. }, _) => (*attempts, true),
            (Loss::None, true) => (0, true),
            (Loss::Written, true) => {
                self.memory.lost_again += 1;
                (0, true)
            }
            (Loss::Accepted | Loss::Stopped, true) => return,
            (Loss::Stopped, false) if flag == 0 => return,
            (Loss::Written, false) if flag == 0 => (0, false),
            (Loss::None | Loss::Accepted | Loss::Written | Loss::Stopped, false) => {
                (self.memory.loss, self.memory.lost_again) = (Loss::None, 0);
                if is_compared || !self.memory.is_managed() || self.memory.is_away {
                    return;
                }
                (0, false)
            }
        };
        // If the power was lost between two polls, what was read of data memory is out of date, and the seal
        // may be open.
        if is_lost {
            self.forget_dataflash();
        }
        if is_reported {
            if !matches!(self.memory.loss, Loss::Owed { .. }) {
                self.memory.looks.forget();
            }
            self.dataflash.forget();
            self.shared.forget_scales();
        }
        self.publish_seal();
        if !self.memory.is_managed() {
            self.memory.loss = Loss::Accepted;
            self.schedule.hurry();
            return;
        }
        if self.memory.lost_again >= TRIES {
            return self.stop_restoring();
        }
        match self.choose_profile(is_lost) {
            Ok(()) if !is_reported && self.is_pack_of_before() => {
                (self.memory.exchanged, self.memory.loss) = (None, Loss::None);
                self.write_profile(attempts, false);
            }
            Ok(()) => self.write_profile(attempts, is_lost),
            Err(Undecided { why, is_pending }) => {
                if is_lost {
                    self.still_owed(&why, false, attempts);
                } else {
                    let why = format!("{why}; tried again with the next poll");
                    self.shared.report(Attempt::RESTORE, &Error::new("profile", Cause::NotNow, why));
                    self.memory.is_believed = self.is_configured_by_others();
                    self.show_configured();
                }
                if is_pending {
                    self.schedule.hurry();
                }
            }
        }
    }

    /// The gauge, which has kept its power, reports that its battery was taken out, or that there is one again. It keeps what
    /// it has learned of the one before.
    pub(super) fn battery_has_changed(&mut self, is_there: bool) {
        let chip = self.gauge.chip;
        let name = self.shared.name();
        log::info!(
            "{name}: {}",
            if is_there { "a battery was inserted" } else { "the battery was taken out" }
        );
        let was_told = self.memory.inserted.is_known(self.shared.published().presence);
        self.begin_anew();
        if was_told {
            self.memory.inserted.learn(self.shared.published().presence, ());
        }
        // By its profile no pin detects one: the flag shows what a host has said.
        if waits_for_insertion(chip, &self.memory.profile).is_some() {
            return;
        }
        self.memory.is_away = !is_there;
        if !is_there {
            return;
        }
        if self.memory.is_watched(chip) {
            let before = self.learned.as_ref().and_then(|learned| learned.pack_name().map(str::to_string));
            self.memory.exchanged.get_or_insert(Before(before));
            self.memory.loss = Loss::Owed { attempts: 0, failure: String::new() };
        }
        self.forget_dataflash();
        self.dataflash.doubt_pack();
        self.schedule.hurry();
    }

    /// Whether a battery that was taken out and inserted is certainly the same pack, by its name.
    fn is_pack_of_before(&self) -> bool {
        let now = self.learned.as_ref().and_then(|learned| learned.pack_name());
        let before = self.memory.exchanged.as_ref().and_then(|before| before.0.as_deref());
        before.is_some() && before == now
    }

    /// Makes the choice among several profiles, for a gauge that has come or has lost its memory.
    fn choose_profile(&mut self, is_lost: bool) -> Result<(), Undecided> {
        let published = self.shared.published();
        if self.memory.choices.is_empty() || !is_lost && self.memory.chosen.is_known(published.presence) {
            return Ok(());
        }
        let (name, looks) = (self.shared.name(), &mut self.memory.looks);
        let deadline = looks.deadline();
        let look = |evidence: &Evidence| looks.at(evidence, name, deadline);
        let chosen = choose(&self.memory.choices, &published.answers, look);
        // Whatever was chosen before may be for another pack.
        let chosen = chosen.inspect_err(|_| {
            self.memory.profile = Vec::new();
            self.memory.why = String::new();
            self.learned = self.learned.take().map(|learned| learned.of_pack(None));
        })?;
        let pack = chosen.pack.as_ref().map_or(String::new(), |pack| format!(" of the pack {pack}"));
        let why = format!("profile {}{pack}: {}", chosen.choice.rule.profile.display(), chosen.why);
        if self.memory.why != why {
            log::info!("{}: {why}", self.shared.name());
        }
        self.memory.profile = chosen.choice.profile.clone();
        self.learned = self.learned.take().map(|learned| match chosen.choice.rule.pack_by_text {
            true => learned.of_pack_anywhere(chosen.pack),
            false => learned.of_pack(chosen.pack),
        });
        self.memory.why = why;
        self.memory.chosen.learn(published.presence, ());
        self.memory.is_believed = true;
        Ok(())
    }

    /// Whether data memory has anything but the part's defaults where a profile has some other value: it may have been lost
    /// although no flag shows that, which somebody else has cleared.
    fn is_configured_by_others(&mut self) -> bool {
        let now = self.shared.published().presence;
        if let Some(is_own) = self.memory.is_own.get(now) {
            return *is_own;
        }
        let changes: Vec<Change> =
            self.memory.choices.iter().flat_map(|choice| &choice.profile).cloned().collect();
        let mut rows: Vec<&Subclass> = Vec::new();
        for (subclass, _) in changes.iter().filter_map(Change::row) {
            if !rows.iter().any(|row| std::ptr::eq(*row, subclass)) {
                rows.push(subclass);
            }
        }
        let read = self.dataflash.read(&mut self.gauge, &rows, Duration::ZERO);
        let Ok(read) = self.noted(read) else { return false };
        let is_own = changes.iter().any(|change| {
            let stored = change.row().and_then(|(subclass, row)| {
                let at = rows.iter().position(|row| std::ptr::eq(*row, subclass))?;
                let begin = usize::from(row.offset - subclass.start());
                read[at].get(begin..begin + row.kind.size())
            });
            !change.is_learned() && stored.is_some_and(|stored| !change.is_default(stored))
        });
        self.memory.is_own.learn(now, is_own);
        is_own
    }

    pub(super) fn write_profile(&mut self, attempts: u32, is_lost: bool) {
        let (profile, learned) = self.profile_with_learned();
        let ended = Statistics::read(&self.gauge.statistics.resets);
        let outcome = self.dataflash.restore(&mut self.gauge, &profile, is_lost, Duration::ZERO);
        let outcome = self.noted(outcome);
        let was_kept = outcome == Ok(Outcome::Unchanged);
        if !was_kept {
            self.forget_dataflash();
        }
        match outcome {
            Ok(outcome) => {
                let now = self.shared.published().presence;
                self.memory.compared.learn(now, ());
                self.shared.succeeded(&Attempt::RESTORE);
                if was_kept {
                    (self.memory.loss, self.memory.exchanged) = (Loss::None, None);
                    self.memory.lost_again = 0;
                    self.show_configured();
                    return;
                }
                self.log_written(&profile, &outcome);
                // Whatever had been interrupted is gone with the memory.
                self.shared.succeeded(&operations::SETTLE.itself());
                let learned = learned.map(|time| format!(", with what it had learned until {time}"));
                let learned = learned.unwrap_or_default();
                let why = match self.memory.exchanged {
                    Some(_) => "has another battery; its profile is written",
                    None => "lost its configuration with its power; the profile is restored",
                };
                log::info!("{}: {why}{learned}", self.shared.name());
                if self.gauge.chip.volatile == Some(0) && matches!(self.memory.loss, Loss::Written) {
                    self.memory.lost_again += 1;
                }
                self.note_memory_written();
                self.schedule.hurry();
            }
            Err(error) => {
                // It was written to the end, and the gauge has lost it at once.
                let was_written = Statistics::read(&self.gauge.statistics.resets) > ended;
                // Where no flag shows that, what does not stay there is taken for it.
                let is_lost = self.gauge.chip.volatile == Some(0)
                    || dataflash::has_lost_memory(&mut self.gauge) == Ok(true);
                if was_written && is_lost {
                    self.memory.lost_again += 1;
                }
                match self.memory.lost_again >= TRIES {
                    true => self.stop_restoring(),
                    false => self.still_owed(&error.to_string(), error.is_owed(), attempts),
                }
            }
        }
    }

    /// All that was to be there was written.
    pub(super) fn note_memory_written(&mut self) {
        self.memory.compared.learn(self.shared.published().presence, ());
        (self.memory.loss, self.memory.exchanged) = (Loss::Written, None);
        self.memory.design = None;
        self.memory.inserted = Fact::default();
        (self.memory.first, self.memory.next_look) = (None, None);
    }

    /// Tells a gauge that waits for it that it has a battery: by the profile no pin detects one (`[BIE]` is 0), and before
    /// BAT_INSERT such a gauge does not gauge (SLUUAC9A 4.1.7). It answers, so there is one. Said once after the gauge has
    /// come and after each restore, so that a BAT_REMOVE of somebody else stays.
    fn tell_of_battery(&mut self) {
        let chip = self.gauge.chip;
        let published = self.shared.published();
        let Some(code) = waits_for_insertion(chip, &self.memory.profile) else { return };
        let flags = published.snapshot.as_ref().zip(chip.register(Role::Flags));
        let flags = flags.and_then(|(snapshot, flags)| snapshot.value(flags));
        let is_there = flags.is_none_or(|flags| flags & i64::from(chip.condition.present) != 0);
        if is_there || self.memory.is_waited_for() || self.memory.inserted.is_known(published.presence) {
            return;
        }
        match self.gauge.ask(code) {
            Ok(_) => {
                log::info!(
                    "{}: waits for a battery by its configuration; BAT_INSERT was sent",
                    self.shared.name()
                );
                self.memory.inserted.learn(published.presence, ());
                self.schedule.hurry();
            }
            Err(error) => self.shared.report(Attempt::RESTORE, &error.within("BAT_INSERT")),
        }
    }

    /// What was polled before the profile was compared can be shown now.
    fn show_configured(&mut self) {
        let registers = self.shared.published().snapshot.as_ref().map(|snapshot| snapshot.registers.clone());
        let is_configured = registers.is_some_and(|registers| self.is_configured(&registers));
        self.shared.publish(|published| {
            if let Some(snapshot) = &mut published.snapshot
                && snapshot.is_configured != is_configured
            {
                std::sync::Arc::make_mut(snapshot).is_configured = is_configured;
            }
        });
    }

    /// The gauge loses what is written to it each time.
    fn stop_restoring(&mut self) {
        let why = format!(
            "the gauge has lost its data memory {TRIES} times right after the profile was written to it, so it is not \
             written any more: it resets as soon as it is configured; check its supply, and whether the profile is for \
             this part; after that, unplug the gauge or restart the mount"
        );
        let error = Error::new("profile", Cause::NotNow, why).at(Step::Restore);
        self.shared.report(Attempt::RESTORE, &error);
        self.memory.loss = Loss::Stopped;
        self.show_configured();
    }

    /// The profile could not be written; it is tried again.
    fn still_owed(&mut self, why: &str, owed: bool, attempts: u32) {
        let why = format!("{why}; tried again with the next poll");
        let error = Error::new("profile", Cause::NotNow, why).owing(owed);
        let line = error.to_string();
        match &self.memory.loss {
            // In the log only once.
            Loss::Owed { failure, .. } if *failure == line => self.shared.record(Attempt::RESTORE, &error),
            _ => self.shared.report(Attempt::RESTORE, &error),
        }
        self.memory.loss = Loss::Owed { attempts: attempts.saturating_add(1), failure: line };
        self.show_configured();
        let interval = self.shared.published().interval;
        self.schedule.try_again(self.gauge.clock.now(), attempts, interval);
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

/// Whether the registers show that data memory was lost.
pub(super) fn reports_loss(chip: &Chip, registers: &Registers) -> bool {
    let flags = chip.register(Role::Flags).and_then(|flags| registers.value(flags));
    flags.zip(chip.volatile).is_some_and(|(flags, lost)| flags & i64::from(lost) != 0)
}

#[cfg(test)]
mod tests;
