// SPDX-License-Identifier: MIT

//! The row of flash that has the keys: where they are in it, what it holds, and writing it.

use zeroize::{Zeroize, Zeroizing};

use super::Task;
use super::ring::{ERASED, LENGTH_OF_KEY, Ring, SEALS, is_harmless, shows_order, turned, unstored};
use crate::chip::KeyBlock;
use crate::codec::{Bytes, WINDOW};
use crate::dataflash::DataFlash;
use crate::dataflash::keyrow::{quietly, stored};
use crate::dataflash::schemes::{Care, sequence};
use crate::dataflash::session::{ByKeys, store};
use crate::dataflash::window::{Planned, secrets};
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::Gauge;
use crate::journal::KeyPlan;
use crate::keys::{KeyChange, Name, Secret};

pub(super) fn offset(block: &KeyBlock, name: Name) -> Option<usize> {
    match name {
        Name::Unseal => Some(block.unseal),
        Name::FullAccess => Some(block.full_access),
        Name::Authentication => block.authentication,
    }
}

impl Task<'_> {
    pub(super) fn at(&self, name: Name) -> usize {
        self.start + offset(self.block, name).unwrap_or_default()
    }

    /// The row as it is now. Only what is keys counts: beside them may be what the gauge rewrites.
    pub(super) fn read(&self, gauge: &mut Gauge) -> Result<Zeroizing<[u8; WINDOW]>> {
        quietly(gauge, |gauge| sequence(gauge).load(gauge, self.place, Care::Sure).map(Zeroizing::new))
    }

    pub(super) fn is_stored(&self, window: &[u8; WINDOW], key: &Secret, name: Name) -> bool {
        let (at, bytes) = (self.at(name), stored(key, self.block.order));
        window[at..at + bytes.len()] == **bytes
    }

    pub(super) fn put(&self, window: &mut [u8; WINDOW], name: Name, key: &Secret) {
        let (at, bytes) = (self.at(name), stored(key, self.block.order));
        window[at..at + bytes.len()].copy_from_slice(&bytes);
    }

    /// The keys that the gauge has: those that it took, and of the others those that are stored.
    pub(super) fn ring_of(&self, window: &[u8; WINDOW], taken: [Option<Secret>; 2]) -> Result<Ring> {
        let of = |name: Name, taken: Option<Secret>| {
            if let Some(key) = taken {
                return Ok(key);
            }
            let known: Vec<&Secret> = match name == self.change.name {
                true => vec![&self.change.old, &self.change.new],
                false => self.mine(name).into_iter().collect(),
            };
            if let Some(key) = known.iter().find(|key| self.is_stored(window, key, name)) {
                return Ok((*key).clone());
            }
            let at = self.at(name);
            let present = unstored(&window[at..at + 4], self.block.order);
            let erased = ERASED.to_ne_bytes();
            let is_left = (0..4).step_by(2).all(|word| {
                let word = word..word + 2;
                present.bytes()[word.clone()] == erased
                    || self.torn
                        && known.iter().any(|key| key.bytes()[word.clone()] == present.bytes()[word.clone()])
            });
            match (is_left && (self.torn || self.erased), known.first()) {
                (true, _) => Ok(present),
                (false, Some(key)) if name != self.change.name => Ok((*key).clone()),
                _ => Err(neither()),
            }
        };
        let [unseal, full_access] = taken;
        Ok(Ring { unseal: of(Name::Unseal, unseal)?, full_access: of(Name::FullAccess, full_access)? })
    }

    /// The gauge's authentication key: the old one, the new one, or what a change left that was cut short.
    pub(super) fn held_authentication(&self, gauge: &mut Gauge, window: &[u8; WINDOW]) -> Result<Secret> {
        let KeyChange { name, old, new } = self.change;
        for key in [old, new] {
            if self.is_stored(window, key, *name) && self.challenge(gauge, key)? {
                return Ok(key.clone());
            }
        }
        let at = self.at(*name);
        let present = &window[at..at + LENGTH_OF_KEY];
        let word = |at: usize| {
            let word = at..at + 2;
            [&old.bytes()[word.clone()], &new.bytes()[word.clone()], &ERASED.to_ne_bytes()]
                .contains(&&present[word])
        };
        if (0..present.len()).step_by(2).all(word) && !self.is_stored(window, old, *name) {
            return Ok(Secret::of_bytes(present));
        }
        Err(neither())
    }

    /// Puts back what a loss of power took of other keys. Returns the authentication key to prove; notes what is lost.
    pub(super) fn complete(
        &mut self,
        dataflash: &DataFlash,
        mine: Option<Secret>,
        window: &mut [u8; WINDOW],
        ring: &mut Ring,
        key: &KeyPlan,
    ) -> Option<Secret> {
        for name in SEALS.into_iter().filter(|name| *name != self.change.name) {
            if let Some(mine) = self.mine(name).filter(|mine| *mine != ring.get(name)).cloned() {
                ring.set(name, &mine);
                self.put(window, name, &mine);
            }
        }
        let name = Name::Authentication;
        if self.change.name == name || self.block.authentication.is_none() {
            return None;
        }
        let at = self.at(name);
        let present = Secret::of_bytes(&window[at..at + LENGTH_OF_KEY]);
        let is_damaged = present.has_erased_word() && !key.erased.contains(&name);
        let kept =
            dataflash.unfinished.row_before().map(|row| Secret::of_bytes(&row[at..at + LENGTH_OF_KEY]));
        match kept.or(mine) {
            Some(known) if is_damaged || known == present => {
                self.put(window, name, &known);
                Some(known)
            }
            _ if is_damaged || key.names.contains(&name) => {
                self.lost.push(name);
                None
            }
            _ => None,
        }
    }

    /// Checks that accepted keys are stored where, and in the byte order, the table says, and that one of them would look
    /// different in another order. If all are erased, an earlier change has checked it, or the new key is tried and found.
    pub(super) fn compare_with(
        &mut self,
        gauge: &Gauge,
        window: &[u8; WINDOW],
        ring: &Ring,
        held: &Secret,
        left: Option<&KeyPlan>,
    ) -> Result<()> {
        let refuse = |why: &str| {
            let why = format!("{why}; nothing was changed");
            Err(Error::new("", Cause::NotPermitted, why).at(Step::Check))
        };
        let name = self.change.name;
        let places = [(&ring.unseal, Name::Unseal), (&ring.full_access, Name::FullAccess), (held, name)];
        if !places.into_iter().all(|(key, name)| self.is_stored(window, key, name)) {
            return refuse("this gauge does not keep the keys it takes where and how its manual says");
        }
        let is_shown = SEALS.into_iter().any(|name| shows_order(ring.get(name)));
        if is_shown || left.is_some_and(|left| left.ordered) || name == Name::Authentication && left.is_none()
        {
            return Ok(());
        }
        if !SEALS.into_iter().all(|name| ring.get(name).is_erased()) {
            return refuse("neither of its keys shows in which order of bytes this gauge keeps them");
        }
        self.unordered = true;
        let written = SEALS.map(|one| if one == name { Some(&self.change.new) } else { self.mine(one) });
        let are_safe =
            written.into_iter().flatten().all(|key| turned(key).iter().all(|key| is_harmless(gauge, key)));
        if are_safe {
            return Ok(());
        }
        refuse(
            "all its keys are erased, so that none shows in which order of bytes it keeps them, and in another order a \
             word of the new key is a command; change it to some other key first",
        )
    }

    /// Writes the keys and reads them back. `touched` counts the commits.
    pub(super) fn write(&self, gauge: &mut Gauge, keys: &[u8; WINDOW], touched: &mut usize) -> Result<()> {
        quietly(gauge, |gauge| {
            let present = Zeroizing::new(sequence(gauge).load(gauge, self.place, Care::Sure)?);
            let of_keys = Bytes::of(|at| (self.start..self.start + self.block.length).contains(&at));
            // Beside the keys a byte goes back only if it was erased: other keys, and parameters of a flat row.
            let goes = Bytes::of(|at| {
                of_keys.has(at) || present[at] == 0xff && secrets(gauge.chip, self.place).has(at)
            });
            if goes.iter().all(|at| present[at] == keys[at]) {
                return Ok(());
            }
            let learned = Bytes::of(|at| !goes.has(at));
            let mut block =
                Planned { place: self.place, old: *present, new: *present, written: goes, learned };
            goes.iter().for_each(|at| block.new[at] = keys[at]);
            // The keys that it has taken show that it is the one.
            let stored = store(gauge, &mut ByKeys, &block, touched);
            block.old.zeroize();
            block.new.zeroize();
            stored
        })
    }
}

fn neither() -> Error {
    let why = "the gauge has neither the old key nor the new one; nothing was changed";
    Error::new("", Cause::NotPermitted, why).at(Step::Check)
}
