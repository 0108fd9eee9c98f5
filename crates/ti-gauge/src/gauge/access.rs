// SPDX-License-Identifier: MIT

//! From one seal state to another: keys, RESET and SEALED.

use super::Gauge;
use super::presence::Moment;
use super::seal::SEAL_POLL;
use super::state::Seal;
use super::statistics::Statistics;
use crate::chip::Scheme;
use crate::error::{Cause, Error, Reason, Result, Step};
use crate::keys::{Keys, Name, Secret, wipe_words};

/// Factory default of the full-access key, the same for every part that has one.
pub const DEFAULT_FULL_ACCESS: [u16; 2] = [0xffff; 2];

/// Times that SEALED is sent. A frame may be lost, and I2C has no error detection.
const SEALS: u32 = 4;

pub(super) struct Access {
    keys: Keys,
    /// The gauge refused the unseal key; it is not sent again.
    refused: bool,
    /// When one look has shown that the gauge took the unseal key; a block that is read proves it.
    opened: Option<Moment>,
    /// When the gauge accepted the unseal key, if it has since it arrived. A refusal is then a disturbance.
    proven: Option<Moment>,
    /// What a command of ours has done that it was not meant to do, until somebody reports it.
    mishap: Option<String>,
}

impl Access {
    pub(super) fn new(keys: Keys) -> Self {
        Self { keys, refused: false, opened: None, proven: None, mishap: None }
    }
}

impl Gauge {
    /// Goes from SEALED to UNSEALED and confirms it.
    ///
    /// The words are sent with nothing in between. If the gauge stays SEALED they are sent once more after a pause, as TI
    /// advises, and never again. It is no refusal of the key if the gauge has accepted it before, or a transfer failed in
    /// between.
    pub fn unseal(&mut self) -> Result<()> {
        let file = self.key_file.to_string();
        let refuse = |reason| Error::of(self.chip.model, reason).at(Step::Unseal);
        let refused = |what: &str| {
            let what = format!("{what}; put the right one into {file} and mount again");
            refuse(Reason::KeyRefused { key: Name::Unseal.as_str(), what })
        };
        let Some(key) = self.key(Name::Unseal) else {
            let before = "SEALED, and no key is given";
            return Err(refuse(Reason::NoKey { key: Name::Unseal.as_str(), before, file }));
        };
        if self.access.refused {
            return Err(refused("SEALED, and the key was refused before"));
        }
        let failures = self.failures();
        if self.takes(&key, Seal::Unsealed)? {
            return Ok(());
        }
        if self.access.proven.is_some() || self.failures() != failures {
            let why = "SEALED, and the gauge did not take its key, twice: the bus is disturbed; try again";
            return Err(Error::new(self.chip.model, Cause::NotNow, why).at(Step::Unseal));
        }
        self.access.refused = true;
        Err(refused("SEALED, and the gauge refused the key"))
    }

    /// Whether the gauge that is there has accepted the unseal key, and could not have been exchanged since.
    pub fn key_is_proven(&self) -> bool {
        self.access.proven.is_some_and(|moment| self.is_unbroken_since(moment))
    }

    /// Whether the unseal key was accepted since the gauge arrived, or by one that was exchanged unnoticed.
    pub(crate) fn key_has_worked(&self) -> bool {
        self.access.proven.is_some() || self.access.opened.is_some()
    }

    /// Notes that the gauge is known to have the unseal key, though it has not been used.
    pub fn prove_key(&mut self) {
        self.access.proven = Some(self.moment());
    }

    /// Notes that the gauge has shown data flash, or that two looks agree: a key that opened it is right.
    pub fn note_open(&mut self) {
        self.access.proven = self.access.opened.or(self.access.proven);
    }

    /// Whether the gauge that is there was opened with the unseal key, so that it may be sealed again.
    pub(crate) fn was_opened(&self) -> bool {
        self.access.opened.into_iter().chain(self.access.proven).any(|moment| self.is_unbroken_since(moment))
    }

    /// Goes from UNSEALED to FULL ACCESS and confirms it.
    pub fn full_access(&mut self) -> Result<()> {
        let refuse = |reason| Error::of(self.chip.model, reason).at(Step::Unseal);
        if !self.chip.security.full_access {
            return Err(refuse(Reason::Text(Cause::NotPermitted, "this part has no FULL ACCESS".into())));
        }
        let name = Name::FullAccess.as_str();
        let Some(key) = self.key(Name::FullAccess) else {
            let before = "no full-access key is given";
            return Err(refuse(Reason::NoKey { key: name, before, file: self.key_file.to_string() }));
        };
        if self.takes(&key, Seal::FullAccess)? {
            return Ok(());
        }
        Err(refuse(Reason::KeyRefused { key: name, what: "the gauge refused the full-access key".into() }))
    }

    /// Sends a key, once more after a pause if it was refused, and returns whether the state followed.
    pub fn takes(&mut self, key: &Secret, goal: Seal) -> Result<bool> {
        if goal == Seal::Unsealed && self.make_ready().is_ok() && self.looks.agreed() != Some(self.moment()) {
            // Another gauge may have come since the state was looked at.
            let now = self.seal_anew()?;
            if now != Seal::Sealed {
                return Ok(now == goal);
            }
        }
        if self.try_key(key, goal)? {
            return Ok(true);
        }
        let silence = self.chip.security.key_silence;
        if !self.has_time_for(silence) {
            let why = "the gauge did not take the key, and no time is left to send it once more; try again";
            return Err(Error::new(self.chip.model, Cause::TimedOut, why).at(Step::Unseal));
        }
        self.wait(silence);
        if goal == Seal::Unsealed {
            // So long nobody has looked.
            self.lose_sight();
        }
        self.try_key(key, goal)
    }

    /// Sends both words of a key and returns whether the state followed.
    pub fn try_key(&mut self, key: &Secret, goal: Seal) -> Result<bool> {
        let moment = self.moment();
        Statistics::count(&self.statistics.keys);
        self.set_secret(true);
        // A word that was not acknowledged is sent again at once: nothing may come between the two.
        let dialect = self.dialect;
        let word = |bytes: &[u8]| u16::from_be_bytes([bytes[0], bytes[1]]);
        let mut send = |bytes: &[u8]| self.again(|gauge| dialect.subcommand(gauge, word(bytes)));
        let sent = key.bytes().chunks_exact(2).try_for_each(&mut send);
        wipe_words();
        self.set_secret(false);
        // A word that was not acknowledged counts as a refused key; the state read below shows it.
        if let Err(bus) = sent
            && !bus.is_transient()
        {
            return Err(Error::bus(self.chip.model, bus).at(Step::Unseal));
        }
        self.commands(goal);
        // A key sent too early is refused, and a misread state looks like success: two looks must agree, except where
        // only an open gauge echoes the selection of the block that is read next.
        let is_echoed = goal == Seal::Unsealed && self.chip.access.scheme == Scheme::Block;
        self.looks.expect(is_echoed.then_some(goal));
        let state = self.seal().map_err(|error| error.at(Step::Unseal))?;
        // Another gauge may have been open already.
        if state == goal && goal == Seal::Unsealed && self.is_unbroken_since(moment) {
            self.access.opened = Some(moment);
        }
        Ok(state == goal)
    }

    /// Goes to a seal state from whatever state the gauge is in, and confirms it.
    pub fn go_to(&mut self, goal: Seal) -> Result<()> {
        let now = self.seal_anew()?;
        self.go(now, goal)?;
        if goal == Seal::Sealed {
            return Ok(());
        }
        let now = self.seal_anew()?;
        if now == goal {
            self.note_open();
            return Ok(());
        }
        let why = format!("the gauge is {} again: it has been reset or has lost its power", now.as_str());
        Err(Error::new(self.chip.model, Cause::NotNow, why).at(Step::Unseal))
    }

    /// Goes to a seal state from the state `now`, and confirms it.
    pub fn go(&mut self, now: Seal, goal: Seal) -> Result<()> {
        match (now, goal) {
            (now, goal) if now == goal => Ok(()),
            (_, Seal::Sealed) => self.close(),
            (Seal::Sealed, Seal::Unsealed) => self.unseal(),
            (Seal::Sealed, Seal::FullAccess) => self.unseal().and_then(|()| self.full_access()),
            (_, Seal::FullAccess) => self.full_access(),
            (_, Seal::Unsealed) => self.go(now, Seal::Sealed).and_then(|()| self.unseal()),
        }
    }

    /// Seals the gauge, whatever its state is, and confirms it.
    pub fn close(&mut self) -> Result<()> {
        self.seal_with(|gauge| gauge.command(gauge.chip.security.seal))
    }

    /// Seals the gauge, but only if nothing has happened since then behind which it could have been exchanged.
    pub(crate) fn close_since(&mut self, moment: Moment) -> Result<()> {
        self.seal_with(|gauge| gauge.command_since(gauge.chip.security.seal, moment))
    }

    fn seal_with(&mut self, send: impl Fn(&mut Self) -> Result<()>) -> Result<()> {
        let before = self
            .looks
            .agreed()
            .filter(|&moment| self.is_unbroken_since(moment))
            .map(|_| self.last_look().status);
        let mut outcome = Ok(Seal::Unsealed);
        for attempt in 0..SEALS {
            if attempt > 0 {
                let why =
                    "SEALED did not reach the gauge, which may have taken it for another command; sent again";
                log::warn!("{}: {why}", self.chip.name);
            }
            self.access.opened = None;
            self.effects.seals();
            let sent = send(self);
            self.commands(Seal::Sealed);
            outcome = sent.and_then(|()| self.seal());
            match &outcome {
                Ok(Seal::Sealed) => {
                    if attempt > 0 {
                        self.note_enabled(before);
                    }
                    return Ok(());
                }
                Err(error) if matches!(error.cause(), Cause::Bus(bus) if !bus.is_transient()) => break,
                Err(error) if matches!(error.cause(), Cause::NotNow) => break,
                _ => self.wait(SEAL_POLL),
            }
        }
        let state = outcome.map_err(|error| error.at(Step::Seal))?;
        let why = format!("the gauge was sent SEALED {SEALS} times and is still {}", state.as_str());
        Err(Error::new(self.chip.model, Cause::Protocol, why).at(Step::Seal))
    }

    /// Notes that a SEALED which did not arrive was IT_ENABLE, which differs in one bit: [QEN] is set, and was not before.
    fn note_enabled(&mut self, before: Option<u32>) {
        let enabled = self.chip.control_status.iter().find(|bit| bit.name == "QEN").map_or(0, |bit| bit.mask);
        let is_new = |now: u32| before.is_some_and(|before| before & enabled == 0) && now & enabled != 0;
        // I2C has no error detection.
        if is_new(self.last_look().status) && self.seal_anew().is_ok() && is_new(self.last_look().status) {
            let why = "SEALED has reached the gauge as IT_ENABLE: [QEN] is set, and Update Status with it (04), which \
                       nothing takes back; check whether Impedance Track was to be enabled";
            self.access.mishap = Some(why.into());
        }
    }

    pub(crate) fn take_mishap(&mut self) -> Option<String> {
        self.access.mishap.take()
    }

    /// RESET, which seals a part that had been sealed (SLUSBZ5D 7.3.3.1 step 11); not to a gauge exchanged since then.
    pub(crate) fn reset_since(&mut self, moment: Moment) -> Result<()> {
        if self.chip.is_never_reset() {
            let why = "never sent to this part, to which it does harm";
            return Err(Error::new("Control(RESET)", Cause::NotPermitted, why).at(Step::Reset));
        }
        Statistics::count(&self.statistics.resets);
        self.looks.resets();
        self.command_since(self.chip.access.resets, moment).map_err(|error| error.at(Step::Reset))?;
        self.effects.reset(self.clock.now());
        Ok(())
    }

    /// The key to send: the configured one, or the manual's default if that is allowed.
    pub fn key(&self, name: Name) -> Option<Secret> {
        self.access.keys.secret(name).or_else(|| self.default_key(name))
    }

    /// The manual's default key, if that is allowed.
    pub fn default_key(&self, name: Name) -> Option<Secret> {
        self.manual_key(name).filter(|_| !self.access.keys.no_default).map(Secret::from)
    }

    pub(crate) fn manual_key(&self, name: Name) -> Option<[u16; 2]> {
        match name {
            Name::Unseal => Some(self.chip.security.default_unseal),
            Name::FullAccess => Some(DEFAULT_FULL_ACCESS),
            Name::Authentication => None,
        }
    }

    /// Sets the key that the gauge has now.
    pub fn set_key(&mut self, name: Name, key: &Secret) {
        self.access.keys.set(name, key);
        self.forget_refusal();
    }

    /// Forgets whether a key was refused or accepted: the gauge may be another one of the same kind.
    pub fn forget_refusal(&mut self) {
        (self.access.refused, self.access.opened, self.access.proven) = (false, None, None);
    }
}
