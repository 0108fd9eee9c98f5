// SPDX-License-Identifier: MIT

//! Which keys a gauge takes, found out by using them.

use super::Task;
use super::ring::{ERASED, Ring, turned};
use crate::authentication::{self, LENGTH, Order};
use crate::chip::KeyOrder;
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{Gauge, Seal};
use crate::keys::{Name, Secret};

impl Task<'_> {
    /// Goes to FULL ACCESS from the state in which the gauge was found. Returns the keys that were needed.
    pub(super) fn enter(&mut self, gauge: &mut Gauge) -> Result<[Option<Secret>; 2]> {
        let ring = self.ring(gauge)?;
        let mut taken = [None, None];
        for ((name, key, goal, above), taken) in ring.rungs(self.found).into_iter().zip(&mut taken) {
            if above {
                continue;
            }
            self.moved = true;
            let found = self.find(gauge, name, key, goal)?;
            let why = || match (name == self.change.name, self.torn || self.erased) {
                (true, false) => "the gauge takes neither the old key nor the new one".to_string(),
                (true, true) => {
                    "the gauge takes neither of the two keys, nor a part of each, nor ffff ffff".to_string()
                }
                (false, false) => format!("the gauge refused the mount's {} key", name.as_str()),
                (false, true) => {
                    format!("the gauge refused the mount's {} key, parts of it, and ffff ffff", name.as_str())
                }
            };
            let found = found
                .ok_or_else(|| Error::new(gauge.chip.model, Cause::NotPermitted, why()).at(Step::Unseal))?;
            *taken = Some(found);
        }
        Ok(taken)
    }

    pub(super) fn climb(&mut self, gauge: &mut Gauge, ring: &Ring, from: Seal) -> Result<()> {
        for (name, key, goal, above) in ring.rungs(from) {
            if above {
                continue;
            }
            self.moved = true;
            if !gauge.takes(key, goal)? {
                let which = if name == self.change.name { "this" } else { "the mount's" };
                let why = format!("the gauge refused {which} {} key", name.as_str());
                return Err(Error::new(gauge.chip.model, Cause::NotPermitted, why).at(Step::Unseal));
            }
        }
        Ok(())
    }

    /// Whether the gauge answers a random challenge as only this key does. A bus error says nothing about the key.
    pub(super) fn challenge(&self, gauge: &mut Gauge, key: &Secret) -> Result<bool> {
        answers(gauge, key, self.order)
    }

    pub(super) fn prove(
        &mut self,
        gauge: &mut Gauge,
        ring: &Ring,
        authentication: Option<&Secret>,
    ) -> Result<()> {
        if let Some(key) = authentication
            && !self.challenge(gauge, key)?
        {
            let why = "the answer to a challenge does not match this key";
            return Err(Error::new(gauge.chip.model, Cause::NotPermitted, why).at(Step::Verify));
        }
        if self.change.name == Name::Authentication && !self.torn {
            return Ok(());
        }
        gauge.go_to(Seal::Sealed)?;
        self.climb(gauge, ring, Seal::Sealed)
    }

    /// The key that leads to a seal state: the expected one, or what may be left of it.
    pub(super) fn find(
        &mut self,
        gauge: &mut Gauge,
        name: Name,
        key: &Secret,
        goal: Seal,
    ) -> Result<Option<Secret>> {
        if gauge.takes(key, goal)? {
            self.erased |= key.is_erased() && name == self.change.name;
            return Ok(Some(key.clone()));
        }
        for candidate in self.candidates(name, key) {
            gauge.wait(gauge.chip.security.key_silence);
            if gauge.try_key(&candidate, goal)? {
                self.erased |= candidate.is_erased();
                return Ok(Some(candidate));
            }
        }
        Ok(None)
    }

    /// What may be in place of a key, the likelier first: a row is erased, then programmed word by word, ascending.
    fn candidates(&self, name: Name, key: &Secret) -> Vec<Secret> {
        let erased = Secret::from([ERASED; 2]);
        let is_changed = name == self.change.name;
        let mut found: Vec<Secret> = Vec::new();
        if is_changed {
            found.push(self.change.new.clone());
        }
        // Without anything that shows that the row was erased it would be a key that nobody has given.
        if self.torn || self.erased {
            found.push(erased);
        }
        if is_changed || self.torn {
            let new = if is_changed { self.change.new.words() } else { key.words() };
            let [first, second] = new;
            let [old_first, old_second] = key.words();
            found.extend(
                match self.block.order {
                    KeyOrder::Reversed => [[old_first, second], [ERASED, second]],
                    KeyOrder::AsSent => [[first, old_second], [first, ERASED]],
                }
                .map(Secret::from),
            );
            if self.torn {
                let words = [[old_first, first, ERASED], [old_second, second, ERASED]];
                for (first, second) in
                    words[0].into_iter().flat_map(|first| words[1].map(|second| (first, second)))
                {
                    found.push(Secret::from([first, second]));
                }
            }
        }
        if self.unordered {
            let keys = if is_changed { &self.change.new } else { key };
            found.extend(turned(keys));
        }
        let mut candidates: Vec<Secret> = Vec::with_capacity(found.len());
        for candidate in found {
            if candidate != *key && !candidates.contains(&candidate) {
                candidates.push(candidate);
            }
        }
        candidates
    }
}

fn answers(gauge: &mut Gauge, key: &Secret, order: Order) -> Result<bool> {
    let mut challenge = [0; LENGTH];
    getrandom::fill(&mut challenge).map_err(|error| {
        Error::new("random numbers", Cause::Io(std::io::ErrorKind::Other), error.to_string())
    })?;
    let digest = authentication::answered(gauge, &challenge, order)?;
    let key = key.bytes().try_into().expect("an authentication key has 16 bytes");
    Ok(authentication::fits(key, &challenge, &digest, order).is_some())
}
