//! Key changes: the only write to the Security subclass.
//!
//! A gauge whose key is lost cannot be recovered, so every step is verified. The old key is proven by using
//! it. The stored keys are compared with those the gauge accepted, which shows on this very gauge that the
//! table has the right place and byte order. The block is read back while FULL ACCESS still allows a
//! correction, and only then is the gauge sealed and opened with the new key.
//!
//! Until the block is committed an error means that no key was changed. From then on the answer is
//! success, [`Cause::RolledBack`] (the old key is back, and was used) or [`Cause::StateUnknown`], which says what
//! is known of the keys.

use std::time::Duration;

use zeroize::{Zeroize, Zeroizing};

use super::blocks::{Bytes, Dirty, Window};
use super::io::{STORES, is_passing, patiently};
use super::schemes::sequence;
use super::session::{Left, RESTORES, Session};
use super::{Change, DataFlash};
use crate::authentication::{self, LENGTH, Order};
use crate::chip::{Chip, KeyBlock, KeyOrder, KeyStorage, Kind};
use crate::codec::WINDOW;
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::{DEFAULT_FULL_ACCESS, Gauge, SEAL_LAG, Seal, Statistics};
use crate::keys::{KeyChange, Name, Secret, wipe_stack};

/// Time for the change, and again for undoing it, without the pauses that a gauge needs after a refused key.
const WAY: Duration = Duration::from_secs(8);
/// Most pauses that are needed in either direction.
const SILENCES: u32 = 10;
/// Time that a gauge may take to restart before it answers.
const START: Duration = Duration::from_secs(3);
/// After a start Voltage() is valid about 1 s later (E2E 1059347).
const MEASURED: Duration = Duration::from_secs(1);
/// Time between attempts while a gauge does not answer or did not follow a command.
const POLL_INTERVAL: Duration = Duration::from_millis(200);
/// Words below this are, or may become, subcommands of any part.
const SUBCOMMANDS: u16 = 0x0100;
/// Words that ManufacturerAccessControl() takes for addresses.
const ADDRESSES: std::ops::Range<u16> = 0x4000..0x4400;
/// Content of erased flash.
const ERASED: u16 = 0xffff;

/// The keys of a gauge, from SEALED up.
struct Ring {
    unseal: Secret,
    full_access: Secret,
}

impl Ring {
    /// The keys in their order, where each leads, and whether a gauge in that state needs it no more.
    fn rungs(&self, from: Seal) -> [(Name, &Secret, Seal, bool); 2] {
        [
            (Name::Unseal, &self.unseal, Seal::Unsealed, from != Seal::Sealed),
            (Name::FullAccess, &self.full_access, Seal::FullAccess, from == Seal::FullAccess),
        ]
    }
}

/// One change on its way.
struct Task<'a> {
    block: &'a KeyBlock,
    change: &'a KeyChange,
    /// Position of the key in the window.
    at: usize,
    /// In which order challenges are sent.
    order: Order,
    found: Seal,
    /// Something was sent that may have changed the seal.
    moved: bool,
}

impl DataFlash {
    /// Changes a key. `waited` is the time since the request was made.
    pub fn change_key(
        &mut self,
        gauge: &mut Gauge,
        change: &KeyChange,
        order: Order,
        waited: Duration,
    ) -> Result<()> {
        let name = change.name.as_str();
        let outcome = self
            .counted(gauge, |dataflash, gauge| dataflash.change_key_unnamed(gauge, change, order, waited));
        gauge.limit(None);
        wipe_stack();
        self.noted(outcome).map_err(|error| error.within(&format!("{name} key")))
    }

    fn change_key_unnamed(
        &mut self,
        gauge: &mut Gauge,
        change: &KeyChange,
        order: Order,
        waited: Duration,
    ) -> Result<()> {
        let (block, at) = place(gauge.chip, change.name)?;
        check_new(gauge, change)?;
        let waited = self.settle_first(gauge, waited)?;
        let asked = gauge.clock.now().saturating_sub(waited);
        gauge.limit(Some((WAY + gauge.chip.security.key_silence * SILENCES).saturating_sub(waited)));
        gauge.claim()?;
        let found = self.preflight(gauge, &[])?;
        let mut session = Session::new(found.seal, asked);
        self.owe(gauge, &mut session, 0)?;
        let mut task = Task { block, change, at, order, found: found.seal, moved: false };
        let outcome = task.run(self, gauge, found.voltage_mv);
        let outcome = task.close(gauge, outcome);
        match &outcome {
            Err(error)
                if matches!(error.cause(), Cause::StateUnknown(_))
                    && found.seal == Seal::Sealed
                    && gauge.seal() != Ok(Seal::Sealed) =>
            {
                let left = Left { data: false, why: error.to_string() };
                let journal = session.journal.take();
                self.keep(session.entry.take(), journal, left);
            }
            _ => session.remove_journal(),
        }
        outcome
    }

    /// Refuses a write whose reset would seal a gauge that was found open and may not open again: its key must have
    /// been used, or be the one that it keeps, which only FULL ACCESS lets one read.
    pub(super) fn check_key(&self, gauge: &mut Gauge, found: Seal, changes: &[Change]) -> Result<()> {
        let resets = changes.iter().any(|change| change.kind(gauge.chip) == Kind::Reset);
        let volatile = gauge.chip.volatile.is_some();
        if found == Seal::Sealed || !resets || volatile || gauge.key_is_proven() {
            return Ok(());
        }
        if found == Seal::FullAccess
            && let (KeyStorage::Flash(block), Some(key)) =
                (&gauge.chip.security.storage, gauge.key(Name::Unseal))
        {
            sequence(gauge).enable(gauge)?;
            let place = Window { subclass: block.subclass, base: block.start };
            let window = quietly(gauge, |gauge| sequence(gauge).load(gauge, place).map(Zeroizing::new))?;
            let stored = stored(&key, block.order);
            if window[block.unseal..block.unseal + stored.len()] == **stored {
                gauge.prove_key();
                return Ok(());
            }
        }
        let why = format!(
            "found {}, and the reset that this write needs may seal it, but its unseal key has not been tried; seal \
             and unseal it once (echo sealed > gauge/seal, then echo unsealed), with the right key in {}",
            found.as_str(),
            gauge.key_file
        );
        Err(Error::new(gauge.chip.model, Cause::NotPermitted(why)).at(Step::Check))
    }
}

/// Where the table places a key, or why it cannot be changed.
fn place(chip: &'static Chip, name: Name) -> Result<(&'static KeyBlock, usize)> {
    let refuse = |why: &str| {
        let why = format!("cannot be changed here: {why}");
        Err(Error::new(chip.model, Cause::NotPermitted(why)).at(Step::Check))
    };
    let block = match &chip.security.storage {
        KeyStorage::Fixed(why) => return refuse(why),
        KeyStorage::Flash(block) => block,
    };
    match name {
        Name::Unseal => Ok((block, block.unseal)),
        Name::FullAccess => Ok((block, block.full_access)),
        Name::Authentication => match block.authentication.filter(|_| chip.authentication.is_some()) {
            Some(at) => Ok((block, at)),
            None => {
                refuse("this part has no authentication that gaugefs knows, so a new key could not be tried")
            }
        },
    }
}

/// Refuses keys that would leave a gauge open or be taken for something else. The manual's defaults are
/// allowed, so that a pack can be handed on with them.
fn check_new(gauge: &Gauge, change: &KeyChange) -> Result<()> {
    let refuse =
        |why: &str| Err(Error::new("", Cause::OutOfRange(format!("the new key {why}"))).at(Step::Check));
    if change.new == change.old {
        let why = "the new key is the old one";
        return Err(Error::new("", Cause::Invalid(why.into())).at(Step::Check));
    }
    let (default, other) = match change.name {
        Name::Unseal => (gauge.chip.security.default_unseal, gauge.key(Name::FullAccess)),
        Name::FullAccess => (DEFAULT_FULL_ACCESS, gauge.key(Name::Unseal)),
        Name::Authentication => {
            let bytes = change.new.bytes();
            return if bytes.iter().all(|byte| *byte == bytes[0]) {
                refuse("is one byte sixteen times, which is the first that anybody tries")
            } else {
                Ok(())
            };
        }
    };
    let words = change.new.words();
    if other.is_some_and(|other| other == change.new) {
        return refuse("is the other key as well: sent twice it would open the gauge wide");
    }
    if words == default {
        return Ok(());
    }
    if words.contains(&0) || words.contains(&ERASED) {
        return refuse("has a word of zeros or ones, as a bus or a flash has that fails");
    }
    if words[0] == words[1] {
        return refuse("is one word twice: a transfer that is repeated would open the gauge");
    }
    let known = |word: &u16| gauge.chip.subcommands.iter().any(|subcommand| subcommand.code == *word);
    if words.iter().any(|word| *word < SUBCOMMANDS || known(word)) {
        return refuse("has a word that is a subcommand, which the manual forbids");
    }
    if gauge.chip.access.scheme.is_flat() && words.iter().any(|word| ADDRESSES.contains(word)) {
        return refuse("has a word that is an address of data flash (0x4000 to 0x43ff)");
    }
    Ok(())
}

impl Task<'_> {
    fn run(&mut self, dataflash: &mut DataFlash, gauge: &mut Gauge, voltage_mv: u16) -> Result<()> {
        let (name, old, new) = (self.change.name, &self.change.old, &self.change.new);
        let tried = self.enter(gauge)?;
        sequence(gauge).enable(gauge)?;
        dataflash.check_signature(gauge)?;
        dataflash.check_gate(gauge, voltage_mv)?;
        let before = self.read(gauge)?;
        let held = match tried {
            Some(held) => held,
            None => self.held(gauge, &before)?,
        };
        let ring = self.ring(gauge, &held)?;
        self.compare_with(&before, &ring, &held)?;
        // Restoring the seal state needs this key.
        gauge.set_key(name, &held);
        if name != Name::Authentication && self.found != Seal::Sealed {
            self.moved = true;
            gauge.go_to(Seal::Sealed)?;
            self.climb(gauge, &ring, Seal::Sealed)?;
        }
        sequence(gauge).enable(gauge)?;
        let (mut after, mut back) = (before.clone(), before);
        self.put(&mut after, new);
        self.put(&mut back, old);
        let mut touched = 0;
        let written = self.write(gauge, &after, &mut touched);
        let proven = written.and_then(|()| self.prove(gauge, new));
        let Err(error) = proven else {
            gauge.set_key(name, new);
            return Ok(());
        };
        if touched == 0 {
            return Err(error);
        }
        gauge.limit(Some(WAY + gauge.chip.security.key_silence * SILENCES));
        Err(self.back(gauge, &back, &error))
    }

    /// Goes to FULL ACCESS from the seal state in which the gauge was found, with the key that it has.
    /// Returns it, where it was needed.
    fn enter(&mut self, gauge: &mut Gauge) -> Result<Option<Secret>> {
        let ring = self.ring(gauge, &self.change.old)?;
        let mut held = None;
        for (name, key, goal, above) in ring.rungs(self.found) {
            if above {
                continue;
            }
            self.moved = true;
            let found = self.find(gauge, name, key, goal)?;
            let why = || match name == self.change.name {
                true => "the gauge takes neither the old key nor the new one".to_string(),
                false => format!("the gauge refused the mount's {} key", name.as_str()),
            };
            let found = found
                .ok_or_else(|| Error::new(gauge.chip.model, Cause::NotPermitted(why())).at(Step::Unseal))?;
            if name == self.change.name {
                held = Some(found);
            }
        }
        Ok(held)
    }

    /// The key that the gauge has, where no key was needed to come here: the old one, the new one, or what
    /// a change left behind that was cut short.
    fn held(&self, gauge: &mut Gauge, window: &[u8; WINDOW]) -> Result<Secret> {
        let KeyChange { name, old, new } = self.change;
        let is_stored = |key: &Secret| self.is_stored(window, key, self.at);
        for key in [old, new] {
            if is_stored(key) && (*name != Name::Authentication || self.challenge(gauge, key).is_ok()) {
                return Ok(key.clone());
            }
        }
        let present = &window[self.at..self.at + old.bytes().len()];
        let (was, shall) = (stored(old, self.block.order), stored(new, self.block.order));
        let word = |at: usize| {
            [&was[at..at + 2], &shall[at..at + 2], &ERASED.to_be_bytes()].contains(&&present[at..at + 2])
        };
        if *name == Name::Authentication && (0..present.len()).step_by(2).all(word) && !is_stored(old) {
            return Ok(Secret::of_bytes(present));
        }
        let why = "the gauge has neither the old key nor the new one; nothing was changed";
        Err(Error::new(gauge.chip.model, Cause::NotPermitted(why.into())).at(Step::Check))
    }

    /// The keys with which the gauge opens, while the one that is changed is `key`.
    fn ring(&self, gauge: &Gauge, key: &Secret) -> Result<Ring> {
        let get = |name: Name| {
            if name == self.change.name {
                return Ok(key.clone());
            }
            gauge.key(name).ok_or_else(|| {
                let (name, place) = (name.as_str(), &gauge.key_file);
                let why = format!("the {name} key is needed too; put it into {place} and mount again");
                Error::new(gauge.chip.model, Cause::NotPermitted(why)).at(Step::Check)
            })
        };
        Ok(Ring { unseal: get(Name::Unseal)?, full_access: get(Name::FullAccess)? })
    }

    /// Goes from a seal state to FULL ACCESS with these keys.
    fn climb(&mut self, gauge: &mut Gauge, ring: &Ring, from: Seal) -> Result<()> {
        for (name, key, goal, above) in ring.rungs(from) {
            if above {
                continue;
            }
            self.moved = true;
            if !gauge.takes(key, goal)? {
                let which = if name == self.change.name { "this" } else { "the mount's" };
                let why = format!("the gauge refused {which} {} key", name.as_str());
                return Err(Error::new(gauge.chip.model, Cause::NotPermitted(why)).at(Step::Unseal));
            }
        }
        Ok(())
    }

    /// A random challenge, answered as only this key answers it.
    fn challenge(&self, gauge: &mut Gauge, key: &Secret) -> Result<()> {
        let mut challenge = [0; LENGTH];
        getrandom::fill(&mut challenge).map_err(|error| {
            Error::new("random numbers", Cause::Io(std::io::ErrorKind::Other, error.to_string()))
        })?;
        let digest = authentication::answered(gauge, &challenge, self.order)?;
        let key = key.bytes().try_into().expect("an authentication key has 16 bytes");
        if authentication::fits(key, &challenge, &digest, self.order).is_some() {
            return Ok(());
        }
        let why = "the answer to a challenge does not match this key";
        Err(Error::new(gauge.chip.model, Cause::NotPermitted(why.into())).at(Step::Verify))
    }

    /// Whether the gauge takes the key, found out by using it. Sealed and opened again.
    fn prove(&mut self, gauge: &mut Gauge, key: &Secret) -> Result<()> {
        if self.change.name == Name::Authentication {
            return self.challenge(gauge, key);
        }
        let ring = self.ring(gauge, key)?;
        gauge.go_to(Seal::Sealed)?;
        self.climb(gauge, &ring, Seal::Sealed)
    }

    fn place(&self) -> Window {
        Window { subclass: self.block.subclass, base: self.block.start }
    }

    /// The block as it is now. Only what is keys counts: behind them may be what the gauge rewrites.
    fn read(&self, gauge: &mut Gauge) -> Result<Zeroizing<[u8; WINDOW]>> {
        quietly(gauge, |gauge| sequence(gauge).load(gauge, self.place()).map(Zeroizing::new))
    }

    /// Whether a key is stored at this position, in the byte order of the table.
    fn is_stored(&self, window: &[u8; WINDOW], key: &Secret, at: usize) -> bool {
        let bytes = stored(key, self.block.order);
        window[at..at + bytes.len()] == **bytes
    }

    fn put(&self, window: &mut [u8; WINDOW], key: &Secret) {
        let bytes = stored(key, self.block.order);
        window[self.at..self.at + bytes.len()].copy_from_slice(&bytes);
    }

    /// Checks that the keys the gauge accepted are stored where, and in the byte order, the table says, and that
    /// at least one of them would look different in another order.
    fn compare_with(&self, window: &[u8; WINDOW], ring: &Ring, held: &Secret) -> Result<()> {
        let refuse = |why: &str| {
            let why = format!("{why}; nothing was changed");
            Err(Error::new("", Cause::NotPermitted(why)).at(Step::Check))
        };
        let KeyBlock { unseal, full_access, .. } = *self.block;
        let places = [(&ring.unseal, unseal), (&ring.full_access, full_access), (held, self.at)];
        if !places.into_iter().all(|(key, at)| self.is_stored(window, key, at)) {
            return refuse("this gauge does not keep the keys it takes where and how its manual says");
        }
        let shows_order = |key: &Secret| {
            let [a, b, c, d] = [0, 1, 2, 3].map(|at| key.bytes()[at]);
            ![[c, d, a, b], [b, a, d, c], [d, c, b, a]].contains(&[a, b, c, d])
        };
        if self.change.name != Name::Authentication
            && !shows_order(&ring.unseal)
            && !shows_order(&ring.full_access)
        {
            return refuse("neither of its keys shows in which order of bytes this gauge keeps them");
        }
        Ok(())
    }

    /// Writes the keys and reads them back. `touched` counts the commits.
    fn write(&self, gauge: &mut Gauge, keys: &[u8; WINDOW], touched: &mut usize) -> Result<()> {
        quietly(gauge, |gauge| {
            let length = self.block.length;
            let present = Zeroizing::new(sequence(gauge).load(gauge, self.place())?);
            if present[..length] == keys[..length] {
                return Ok(());
            }
            let mut block = Dirty {
                place: self.place(),
                old: *present,
                new: *present,
                written: Bytes::of(|at| at < length),
                learned: Bytes::of(|at| at >= length),
            };
            // What is behind the keys stays as it is at this moment.
            block.new[..length].copy_from_slice(&keys[..length]);
            let stored = self.commit(gauge, &block, touched);
            block.old.zeroize();
            block.new.zeroize();
            stored
        })
    }

    /// Programs the keys and reads them back. A commit that was not acknowledged and has changed nothing is repeated.
    fn commit(&self, gauge: &mut Gauge, block: &Dirty, touched: &mut usize) -> Result<()> {
        let length = self.block.length;
        let keeps = |gauge: &mut Gauge, keys: &[u8; WINDOW]| {
            let present = sequence(gauge).load(gauge, block.place).map(Zeroizing::new);
            if present.map_err(|error| error.at(Step::Verify))?[..length] == keys[..length] {
                return Ok(());
            }
            let why = "the gauge keeps other keys than were written";
            Err(Error::new("", Cause::Protocol(why.into())).at(Step::Verify))
        };
        *touched += 1;
        for attempt in 1.. {
            Statistics::count(&gauge.statistics.flash_writes);
            let committed =
                sequence(gauge).fill(gauge, block).and_then(|()| sequence(gauge).commit(gauge, block));
            let Err(error) = patiently(gauge, |gauge| keeps(gauge, &block.new)) else { return Ok(()) };
            let unchanged = committed.as_ref().is_err_and(is_passing) && keeps(gauge, &block.old).is_ok();
            if attempt == STORES || !unchanged {
                // A checksum may take effect even if its acknowledgement was lost.
                return Err(committed.err().unwrap_or(error));
            }
        }
        Ok(())
    }

    /// After a failure following the commit: finds out which keys open the gauge, puts the old block back and
    /// tries it. Always an error, which says what is known.
    fn back(&mut self, gauge: &mut Gauge, before: &[u8; WINDOW], error: &Error) -> Error {
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
            let put_back = sequence(gauge)
                .enable(gauge)
                .and_then(|()| self.write(gauge, before, &mut touched))
                .and_then(|()| self.prove(gauge, &self.change.old));
            if put_back.is_ok() {
                gauge.set_key(self.change.name, &self.change.old);
                let why = format!("{error}; the old key was restored, and the gauge takes it");
                return Error::new("", Cause::RolledBack(why));
            }
            if touched > 0 {
                known = Worked::Neither;
            }
            // A gauge that has just started stores nothing before it has measured its voltage.
            gauge.wait(MEASURED);
        }
        let KeyChange { name, new, .. } = self.change;
        let known = match (state, known) {
            (Keyhole::Open(_), Worked::Old) => {
                "the gauge took the old key, but what it keeps could not be put in order and tried again"
            }
            (Keyhole::Open(_), Worked::New) => {
                // Lets the daemon continue even if the key file has the old key.
                gauge.set_key(*name, new);
                "the gauge takes the new key, and the old one could not be restored"
            }
            (Keyhole::Open(_), Worked::Neither) => {
                "the gauge was open, but the old key could not be restored: which key it takes is unknown; do not \
                 cut its power, and make the same change once more"
            }
            (Keyhole::Shut(shut), _) if shut == *name => {
                "the gauge takes neither the old key nor the new one"
            }
            (Keyhole::Shut(_), _) => "the gauge no longer takes its other key",
            (Keyhole::Silent, _) => {
                "the gauge does not answer: it has the old key, the new one or a part of each; when it answers again, \
                 make the same change once more"
            }
        };
        Error::new("", Cause::StateUnknown(format!("{error}; {known}")))
    }

    /// Goes to FULL ACCESS with any key that works.
    fn open_again(&mut self, gauge: &mut Gauge) -> Keyhole {
        let limit = gauge.clock.now() + START;
        let now = loop {
            match gauge.seal() {
                Ok(now) => break now,
                Err(_) if gauge.may_try_until(limit) => gauge.wait(POLL_INTERVAL),
                Err(_) => return Keyhole::Silent,
            }
        };
        let Ok(ring) = self.ring(gauge, &self.change.old) else { return Keyhole::Silent };
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
            let keys = [&self.change.new, &self.change.old];
            let answers = keys.into_iter().find(|key| self.challenge(gauge, key).is_ok());
            worked = answers.map_or(Worked::Neither, |key| self.which(key));
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

    /// The key that leads to a seal state. Of the one that is changed that is the old one, the new one, or
    /// what is left of both where power failed between one word and the next.
    fn find(&self, gauge: &mut Gauge, name: Name, key: &Secret, goal: Seal) -> Result<Option<Secret>> {
        if gauge.takes(key, goal)? {
            return Ok(Some(key.clone()));
        }
        if name != self.change.name {
            return Ok(None);
        }
        let ([old_first, old_second], [first, second]) = (self.change.old.words(), self.change.new.words());
        // Flash is programmed word by word, in ascending order.
        let candidates = match self.block.order {
            KeyOrder::Reversed => [[first, second], [old_first, second], [ERASED, second]],
            KeyOrder::AsSent => [[first, second], [first, old_second], [first, ERASED]],
        };
        for words in candidates {
            gauge.wait(gauge.chip.security.key_silence);
            let candidate = Secret::from(words);
            if gauge.try_key(&candidate, goal)? {
                return Ok(Some(candidate));
            }
        }
        Ok(None)
    }

    /// Restores the seal state and reports both errors if there are two.
    fn close(self, gauge: &mut Gauge, outcome: Result<()>) -> Result<()> {
        gauge.limit(Some(WAY + gauge.chip.security.key_silence * 2 * RESTORES));
        let limit = gauge.clock.now() + START;
        let restore = |gauge: &mut Gauge| match self.found {
            // CONTROL_STATUS may still show the state before the last key.
            Seal::Sealed if outcome.is_err() => {
                gauge.wait(SEAL_LAG);
                gauge.close()
            }
            found => gauge.go_to(found),
        };
        let mut closed = restore(gauge);
        while closed.is_err() && gauge.may_try_until(limit) {
            gauge.wait(POLL_INTERVAL);
            gauge.forget_refusal();
            closed = restore(gauge);
        }
        let found = self.found.as_str();
        match (outcome, closed) {
            (outcome, Ok(())) => outcome,
            // It does not answer, and nothing was sent that could have changed its state.
            (Err(first), Err(_)) if !self.moved => Err(first),
            (Ok(()), Err(error)) => {
                let why =
                    format!("the gauge takes the new key, but restoring the {found} state failed: {error}");
                Err(Error::new("", Cause::StateUnknown(why)))
            }
            (Err(first), Err(second)) => {
                let key = match first.cause() {
                    Cause::RolledBack(_) | Cause::StateUnknown(_) => "",
                    _ => "no key was changed, but ",
                };
                let why = format!("{first}; {key}restoring the {found} state failed: {second}");
                Err(Error::new("", Cause::StateUnknown(why)))
            }
        }
    }
}

/// A key as the gauge keeps it.
fn stored(key: &Secret, order: KeyOrder) -> Zeroizing<Vec<u8>> {
    let mut bytes = Zeroizing::new(key.bytes().to_vec());
    if let (KeyOrder::Reversed, [a, b, c, d]) = (order, bytes.as_slice()) {
        let turned = [*c, *d, *a, *b];
        bytes.copy_from_slice(&turned);
    }
    bytes
}

/// What a gauge does that may have one key or another.
enum Keyhole {
    /// It is in FULL ACCESS, and this was the key.
    Open(Worked),
    /// No key of that name fits.
    Shut(Name),
    /// It does not answer.
    Silent,
}

#[derive(Clone, Copy)]
enum Worked {
    Old,
    New,
    /// Neither was needed, or a mixture of both led there.
    Neither,
}

/// Runs transfers that carry keys: they are not recorded, and no error repeats what was read.
fn quietly<T>(gauge: &mut Gauge, run: impl FnOnce(&mut Gauge) -> Result<T>) -> Result<T> {
    gauge.set_secret(true);
    let outcome = run(gauge);
    gauge.set_secret(false);
    outcome.map_err(|error| {
        let cause = match error.cause() {
            Cause::BadChecksum(_) => Cause::BadChecksum("the checksum of the key block is wrong".into()),
            Cause::Protocol(_) => Cause::Protocol("the key block could not be read correctly".into()),
            cause => cause.clone(),
        };
        let plain = Error::new("", cause);
        match error.step() {
            Some(step) => plain.at(step),
            None => plain,
        }
    })
}
