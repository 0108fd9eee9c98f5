//! A chip's table on a bus: registers, Control() subcommands, seal states.
//!
//! Everything that is sent to a gauge passes through one method, where it is counted. Retries
//! live here and only for what is idempotent; the checksum that commits a block is not.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

pub use crate::chip::Answers;
use crate::chip::{Chip, SealStatus};
use crate::error::{Cause, Error, Result, Step};
use crate::keys::{Keys, Name, Secret};
pub use crate::registers::bursts;
use gauge_bus::clock::Clock;
use gauge_bus::{Bus, BusError, wire_bytes};

/// Address of Control().
const CONTROL: u8 = 0x00;
/// Control(CONTROL_STATUS).
const CONTROL_STATUS: u16 = 0x0000;
/// Control(DEVICE_TYPE).
const DEVICE_TYPE: u16 = 0x0001;
/// Control(FW_VERSION).
const FW_VERSION: u16 = 0x0002;
/// Control(RESET).
const RESET: u16 = 0x0041;
/// What Control() of a part that answers in MACData() reads once after DEVICE_TYPE or FW_VERSION, in place
/// of CONTROL_STATUS.
const ANSWERED_ELSEWHERE: u16 = 0xffa5;

/// So many bytes behind Control() are read along with it at most.
pub const BEHIND: usize = 14;

/// The full-access key of every part that has one, as it leaves the factory.
pub const DEFAULT_FULL_ACCESS: [u16; 2] = [0xffff; 2];

/// How often an idempotent transfer is tried, and the pause before each further try: the gauge
/// stretches the clock for some 20 ms while it programs flash, and adapters give up earlier.
const TRIES: u32 = 4;
const PAUSE: Duration = Duration::from_millis(25);

/// The seal state of a gauge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seal {
    /// Data flash is out of reach.
    Sealed,
    /// Data flash can be read and written.
    Unsealed,
    /// As UNSEALED, and keys can be changed.
    FullAccess,
}

impl Seal {
    /// The word that stands for it in `gauge/seal`.
    pub fn as_str(self) -> &'static str {
        match self {
            Seal::Sealed => "sealed",
            Seal::Unsealed => "unsealed",
            Seal::FullAccess => "full-access",
        }
    }
}

/// What has passed since the gauge was opened.
#[derive(Debug, Default)]
pub struct Statistics {
    /// START...STOP transfers.
    pub transfers: AtomicU64,
    /// Bytes on the wire, address bytes included.
    pub bytes: AtomicU64,
    /// Transfers that were tried again.
    pub retries: AtomicU64,
    /// Polls that succeeded.
    pub polls: AtomicU64,
    /// Polls that failed.
    pub failed_polls: AtomicU64,
    /// Blocks of data flash that were programmed.
    pub flash_writes: AtomicU64,
    /// Resets that were sent.
    pub resets: AtomicU64,
    /// Writes that found their values there already.
    pub unchanged_writes: AtomicU64,
    /// How far the write is that is being made.
    pub progress: Progress,
}

/// Blocks that a write has programmed, of how many.
#[derive(Debug, Default)]
pub struct Progress(AtomicU64);

impl Progress {
    /// A write has found that so many blocks are to be programmed.
    pub fn begin(&self, blocks: usize) {
        self.0.store(blocks as u64, Ordering::Relaxed);
    }

    /// One more of them is programmed and verified.
    pub fn step(&self) {
        self.0.fetch_add(1 << 32, Ordering::Relaxed);
    }

    /// The write is over, whatever came of it.
    pub fn end(&self) {
        self.0.store(0, Ordering::Relaxed);
    }

    /// Blocks done, and all; `None` while none is being written.
    pub fn get(&self) -> Option<(u32, u32)> {
        let both = self.0.load(Ordering::Relaxed);
        (both != 0).then_some(((both >> 32) as u32, both as u32))
    }
}

impl Statistics {
    /// What it has come to.
    pub fn read(counter: &AtomicU64) -> u64 {
        counter.load(Ordering::Relaxed)
    }

    /// One more.
    pub fn count(counter: &AtomicU64) {
        counter.fetch_add(1, Ordering::Relaxed);
    }

    /// Names and values, in the order of `gauge/statistics`.
    pub fn list(&self) -> Vec<(&'static str, u64)> {
        let read = Self::read;
        vec![
            ("transfers", read(&self.transfers)),
            ("bytes", read(&self.bytes)),
            ("retries", read(&self.retries)),
            ("polls", read(&self.polls)),
            ("failed_polls", read(&self.failed_polls)),
            ("flash_writes", read(&self.flash_writes)),
            ("resets", read(&self.resets)),
            ("unchanged_writes", read(&self.unchanged_writes)),
        ]
    }
}

/// One gauge, in the hands of its owner.
pub struct Gauge {
    /// Its table.
    pub chip: &'static Chip,
    /// What has passed.
    pub statistics: Arc<Statistics>,
    /// Time, to wait and to measure with.
    pub clock: Arc<dyn Clock>,
    bus: Box<dyn Bus>,
    keys: Keys,
    byte_writes: bool,
    /// The unseal key that would be sent has been refused; it is not sent again.
    refused: bool,
    /// The seal state when it was last read, or that a command since then should have led to.
    expected: Option<Seal>,
    /// No transfer starts after this moment: a write(2) must have its answer in time.
    deadline: Option<Duration>,
}

impl Gauge {
    /// A gauge with that table behind that bus. Nothing is sent yet.
    pub fn new(
        chip: &'static Chip,
        bus: Box<dyn Bus>,
        clock: Arc<dyn Clock>,
        keys: Keys,
        byte_writes: bool,
    ) -> Self {
        let statistics = Arc::default();
        Self {
            chip,
            statistics,
            clock,
            bus,
            keys,
            byte_writes,
            refused: false,
            expected: None,
            deadline: None,
        }
    }

    /// From now on, no transfer starts later than `time` from now; `None` lifts the limit.
    pub fn limit(&mut self, time: Option<Duration>) {
        self.deadline = time.map(|time| self.clock.now() + time);
    }

    /// Lets time pass without any transfer.
    pub fn wait(&self, time: Duration) {
        if !time.is_zero() {
            self.clock.sleep(time);
        }
    }

    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        if self.deadline.is_some_and(|deadline| self.clock.now() >= deadline) {
            return Err(BusError::Timeout);
        }
        Statistics::count(&self.statistics.transfers);
        self.statistics.bytes.fetch_add(wire_bytes(write.len(), read.len()), Ordering::Relaxed);
        self.bus.transfer(write, read)
    }

    /// Tries an idempotent transfer a bounded number of times.
    fn again(&mut self, mut attempt: impl FnMut(&mut Self) -> Result<(), BusError>) -> Result<(), BusError> {
        let mut outcome = attempt(self);
        for _ in 1..TRIES {
            match outcome {
                Err(BusError::NoAck | BusError::ArbitrationLost | BusError::Timeout | BusError::Short) => {}
                Ok(())
                | Err(
                    BusError::Gone
                    | BusError::Busy
                    | BusError::ReadOnly
                    | BusError::NotRecorded
                    | BusError::Other(_),
                ) => break,
            }
            self.wait(PAUSE);
            Statistics::count(&self.statistics.retries);
            outcome = attempt(self);
        }
        outcome
    }

    /// Reads from an address on, as many bytes as `into` holds.
    pub fn read(&mut self, code: u8, into: &mut [u8]) -> Result<()> {
        self.again(|gauge| gauge.transfer(&[code], into))
            .map_err(|bus| Error::new(self.name_of(code), Cause::Bus(bus)).at(Step::Read))
    }

    /// Writes bytes that may be written twice without harm: a pointer, a selection, the window's buffer.
    pub fn write(&mut self, code: u8, data: &[u8]) -> Result<()> {
        self.again(|gauge| gauge.write_once(code, data))
            .map_err(|bus| Error::new(self.name_of(code), Cause::Bus(bus)))
    }

    /// Writes bytes whose effect must not happen twice.
    pub fn write_once(&mut self, code: u8, data: &[u8]) -> Result<(), BusError> {
        // Where the manual has the rule it is for Control() as well (SLUSBH1C 9.5.4.3); elsewhere Control()
        // is only ever written as a word.
        if self.byte_writes && (code != CONTROL || self.chip.byte_writes_above_hz.is_some()) {
            for (at, &byte) in (code..).zip(data) {
                self.transfer(&[at, byte], &mut [])?;
            }
            return Ok(());
        }
        let mut message = [0; 1 + crate::codec::WINDOW];
        message[0] = code;
        message[1..=data.len()].copy_from_slice(data);
        self.transfer(&message[..=data.len()], &mut [])
    }

    fn name_of(&self, code: u8) -> String {
        let register = self.chip.registers.iter().find(|register| register.code == code);
        register.map_or_else(|| format!("register 0x{code:02x}"), |register| format!("{}()", register.name))
    }

    /// Sends a subcommand that has no answer, or whose answer nobody wants.
    pub fn command(&mut self, code: u16) -> Result<()> {
        let subject = self.subcommand_name(code);
        self.write(CONTROL, &code.to_le_bytes()).map_err(|error| error.about(subject).at(Step::Control))
    }

    /// Sends a subcommand and reads the word that it answers with.
    pub fn ask(&mut self, code: u16) -> Result<u16> {
        self.command(code)?;
        // CONTROL_STATUS answers at Control() itself on every part.
        if code != CONTROL_STATUS {
            return self.answer(code, self.chip.identity.answer, &mut []);
        }
        self.status_word(&mut [])
    }

    /// CONTROL_STATUS, which has been asked for, and with it the registers behind Control().
    fn status_word(&mut self, behind: &mut [u8]) -> Result<u16> {
        match self.answer(CONTROL_STATUS, CONTROL, behind)? {
            ANSWERED_ELSEWHERE if self.chip.identity.answer != CONTROL => {
                self.answer(CONTROL_STATUS, CONTROL, behind)
            }
            status => Ok(status),
        }
    }

    /// Reads the word that a subcommand answers with, and what stands behind it.
    fn answer(&mut self, code: u16, at: u8, behind: &mut [u8]) -> Result<u16> {
        // MACData() shows the answer before this one until the gauge has put it there.
        if at != CONTROL {
            self.wait(self.chip.access.select);
        }
        let mut bytes = [0; 2 + BEHIND];
        let subject = self.subcommand_name(code);
        let wanted = &mut bytes[..2 + behind.len()];
        self.read(at, wanted).map_err(|error| error.about(subject).at(Step::Control))?;
        behind.copy_from_slice(&wanted[2..]);
        Ok(u16::from_le_bytes([bytes[0], bytes[1]]))
    }

    fn subcommand_name(&self, code: u16) -> String {
        let known = self.chip.subcommands.iter().find(|subcommand| subcommand.code == code);
        known.map_or_else(|| format!("Control(0x{code:04x})"), |known| format!("Control({})", known.name))
    }

    /// Makes sure that no kernel driver has taken the address.
    pub fn claim(&mut self) -> Result<()> {
        self.bus.claim().map_err(|bus| Error::new(self.chip.name, Cause::Bus(bus)).at(Step::Check))
    }

    /// Lets go of an adapter that has gone.
    pub fn release_if_gone(&mut self) {
        self.bus.release_if_gone();
    }

    /// Asks the gauge who it is.
    pub fn identify(&mut self) -> Result<Answers> {
        let named = |error: Error| error.at(Step::Identify);
        let device_type = self.ask(DEVICE_TYPE).map_err(named)?;
        let firmware_version = self.ask(FW_VERSION).map_err(named)?;
        let hardware_version = self.ask_named("HW_VERSION").map_err(named)?.unwrap_or_default();
        let chem_id = self.ask_named("CHEM_ID").map_err(named)?;
        // The code is a byte; nothing is said of the other one.
        let dm_code = self.ask_named("DM_CODE").map_err(named)?.map(|code| code & 0xff);
        Ok(Answers { device_type, firmware_version, hardware_version, chem_id, dm_code })
    }

    /// The answer to a subcommand, where the table has one of that name.
    fn ask_named(&mut self, name: &str) -> Result<Option<u16>> {
        let known = self.chip.subcommands.iter().find(|subcommand| subcommand.name == name);
        known.map(|subcommand| self.ask(subcommand.code)).transpose()
    }

    /// Control(FW_VERSION).
    pub fn firmware_version(&mut self) -> Result<u16> {
        self.ask(FW_VERSION).map_err(|error| error.at(Step::Identify))
    }

    /// Makes sure that the part is still one of the table's.
    pub fn confirm_identity(&mut self) -> Result<()> {
        let expected = self.chip.identity.device_type;
        let mut found = expected;
        // One lost bit makes no other part: an answer that is not the expected one is asked for again.
        for _ in 0..2 {
            found = self.ask(DEVICE_TYPE).map_err(|error| error.at(Step::Identify))?;
            if found == expected {
                break;
            }
        }
        if found == expected {
            return Ok(());
        }
        let why = format!(
            "device type is 0x{found:04x}, not 0x{expected:04x}: another part answers; mount it anew"
        );
        Err(Error::new(self.chip.model, Cause::Gone(why)).at(Step::Identify))
    }

    /// Reads the seal state.
    pub fn seal(&mut self) -> Result<Seal> {
        self.control_status().map(|(seal, _)| seal)
    }

    /// Reads the seal state and the CONTROL_STATUS word.
    ///
    /// I2C has no check of its own, and a gauge whose state was misread would be left in that state. So an
    /// answer that is not the expected one counts only when a second one agrees with it.
    pub fn control_status(&mut self) -> Result<(Seal, u16)> {
        self.control_status_and(&mut [])
    }

    /// The same, and in the same transfer the registers from 0x02 on, as many bytes as `behind` holds.
    pub fn control_status_and(&mut self, behind: &mut [u8]) -> Result<(Seal, u16)> {
        let (mut seal, mut status) = self.control_status_once(behind)?;
        for _ in 1..TRIES {
            if self.expected == Some(seal) {
                break;
            }
            self.expected = Some(seal);
            (seal, status) = self.control_status_once(behind)?;
        }
        self.expected = Some(seal);
        Ok((seal, status))
    }

    fn control_status_once(&mut self, behind: &mut [u8]) -> Result<(Seal, u16)> {
        self.command(CONTROL_STATUS)?;
        let status = self.status_word(behind)?;
        let seal = match self.chip.security.status {
            SealStatus::Bits { sealed, .. } if status & sealed != 0 => Seal::Sealed,
            SealStatus::Bits { not_full_access, .. } => {
                if not_full_access != 0 && status & not_full_access == 0 {
                    Seal::FullAccess
                } else {
                    Seal::Unsealed
                }
            }
            SealStatus::Field { register, shift } => {
                let word = match register {
                    None => status,
                    Some(code) => {
                        let mut word = [0; 2];
                        self.read(code, &mut word)?;
                        u16::from_le_bytes(word)
                    }
                };
                match word >> shift & 3 {
                    3 => Seal::Sealed,
                    2 => Seal::Unsealed,
                    1 => Seal::FullAccess,
                    _ => {
                        let why = format!("security bits of 0x{word:04x} are 00, which means no state");
                        return Err(Error::new("CONTROL_STATUS", Cause::Protocol(why)));
                    }
                }
            }
        };
        Ok((seal, status))
    }

    /// Goes from SEALED to UNSEALED and confirms it.
    ///
    /// The two words go out with nothing in between. Where the gauge still says SEALED they go out once
    /// more after a silence, as TI advises, and then never again: a refused key is not sent in a loop.
    pub fn unseal(&mut self) -> Result<()> {
        let refuse =
            |why: &str| Error::new(self.chip.model, Cause::NotPermitted(why.into())).at(Step::Unseal);
        let key = match self.keys.unseal {
            Some(key) => key,
            None if self.keys.no_default => {
                return Err(refuse("SEALED, and no key is given; name a file with --key-file"));
            }
            None => self.chip.security.default_unseal,
        };
        if self.refused {
            return Err(refuse(
                "SEALED, and the key was refused before; mount again with the right --key-file",
            ));
        }
        if self.takes(key, Seal::Unsealed)? {
            return Ok(());
        }
        self.refused = true;
        Err(Error::new(
            self.chip.model,
            Cause::NotPermitted(
                "SEALED, and the gauge refused the key; name the right one with --key-file".into(),
            ),
        )
        .at(Step::Unseal))
    }

    /// Goes from UNSEALED to FULL ACCESS and confirms it.
    pub fn full_access(&mut self) -> Result<()> {
        let key =
            self.keys.full_access.or(if self.keys.no_default { None } else { Some(DEFAULT_FULL_ACCESS) });
        let refuse =
            |why: &str| Error::new(self.chip.model, Cause::NotPermitted(why.into())).at(Step::Unseal);
        if !self.chip.security.full_access {
            return Err(refuse("this part has no FULL ACCESS"));
        }
        let key = key.ok_or_else(|| refuse("no full-access key is given; name a file with --key-file"))?;
        if self.takes(key, Seal::FullAccess)? {
            return Ok(());
        }
        Err(Error::new(self.chip.model, Cause::NotPermitted("the gauge refused the full-access key".into()))
            .at(Step::Unseal))
    }

    /// Sends a key, once more after a silence where it was refused, and tells whether the state followed.
    pub fn takes(&mut self, key: [u16; 2], goal: Seal) -> Result<bool> {
        if self.try_key(key, goal)? {
            return Ok(true);
        }
        self.wait(self.chip.security.key_silence);
        self.try_key(key, goal)
    }

    /// Sends both words of a key and tells whether the state followed.
    pub fn try_key(&mut self, key: [u16; 2], goal: Seal) -> Result<bool> {
        self.bus.set_secret(true);
        let sent = key.iter().try_for_each(|word| self.write_once(CONTROL, &word.to_le_bytes()));
        self.bus.set_secret(false);
        // A word that was not acknowledged is as good as a refused key: the state tells.
        if let Err(
            bus @ (BusError::Gone
            | BusError::Busy
            | BusError::ReadOnly
            | BusError::NotRecorded
            | BusError::Other(_)),
        ) = sent
        {
            return Err(Error::new(self.chip.model, Cause::Bus(bus)).at(Step::Unseal));
        }
        // FULL ACCESS is refused without any fault when it comes too early, so that one misread state would
        // pass for it: two readings have to agree.
        self.expected = (goal != Seal::FullAccess).then_some(goal);
        Ok(self.seal().map_err(|error| error.at(Step::Unseal))? == goal)
    }

    /// Goes to a seal state from whatever state the gauge is in, and confirms it.
    pub fn go_to(&mut self, goal: Seal) -> Result<()> {
        let now = self.seal()?;
        self.go(now, goal)
    }

    /// Goes to a seal state from the state `now`, and confirms it.
    pub fn go(&mut self, now: Seal, goal: Seal) -> Result<()> {
        match (now, goal) {
            (now, goal) if now == goal => Ok(()),
            (_, Seal::Sealed) => {
                self.command(self.chip.security.seal).map_err(|error| error.at(Step::Seal))?;
                self.expected = Some(Seal::Sealed);
                match self.seal().map_err(|error| error.at(Step::Seal))? {
                    Seal::Sealed => Ok(()),
                    other => {
                        let why = format!("the gauge was told to seal and is still {}", other.as_str());
                        Err(Error::new(self.chip.model, Cause::Protocol(why)).at(Step::Seal))
                    }
                }
            }
            (Seal::Sealed, Seal::Unsealed) => self.unseal(),
            (Seal::Sealed, Seal::FullAccess) => self.unseal().and_then(|()| self.full_access()),
            (_, Seal::FullAccess) => self.full_access(),
            // There is no way down but through SEALED.
            (_, Seal::Unsealed) => self.go(now, Seal::Sealed).and_then(|()| self.unseal()),
        }
    }

    /// Sends RESET, after which a part that had been sealed is sealed again (SLUSBZ5D 7.3.3.1 step 11).
    pub fn reset(&mut self) -> Result<()> {
        Statistics::count(&self.statistics.resets);
        self.expected = Some(Seal::Sealed);
        self.command(RESET).map_err(|error| error.at(Step::Reset))
    }

    /// The key that would be sent: the one given, or the manual's where that may be tried.
    pub fn key(&self, name: Name) -> Option<Secret> {
        let default = match name {
            Name::Unseal => Some(self.chip.security.default_unseal),
            Name::FullAccess => Some(DEFAULT_FULL_ACCESS),
            Name::Authentication => None,
        };
        let default = default.filter(|_| !self.keys.no_default).map(Secret::of_words);
        self.keys.secret(name).or(default)
    }

    /// The gauge has another key now.
    pub fn set_key(&mut self, name: Name, key: &Secret) {
        self.keys.set(name, key);
        self.refused = false;
    }

    /// What passes from now on is a secret (`true`), or no longer (`false`).
    pub fn set_secret(&mut self, secret: bool) {
        self.bus.set_secret(secret);
    }

    /// Forgets that a key was refused: the gauge may be another one of the same kind.
    pub fn forget_refusal(&mut self) {
        self.refused = false;
    }
}
