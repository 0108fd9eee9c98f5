// SPDX-License-Identifier: MIT

//! A gauge on a bus, driven by its chip's table: registers, Control() subcommands, seal states.
//!
//! All transfers go through one method, which counts them. Only this module retries, and only idempotent
//! transfers; the checksum that commits a block is not one. Whether it is still the same gauge that answers is watched
//! in `presence`.

use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

pub use crate::chip::Answers;
use crate::chip::{Chip, Scheme, SealStatus};
use crate::error::{Cause, Error, Reason, Result, Step};
use crate::keys::{Keys, Name, Secret, wipe_words};
use gauge_bus::clock::Clock;
use gauge_bus::trace::Event;
use gauge_bus::{Bus, BusError, wire_bytes};

mod effects;
mod presence;

pub use effects::Effects;
use effects::{Seen, Status, Watch};
pub(crate) use presence::Moment;
use presence::Presence;

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

/// MACDataLen(), what it counts besides the data, and the longest answer to FW_VERSION that any part is known to have.
const MAC_DATA_LENGTH: u8 = 0x61;
const MAC_OVERHEAD: usize = 4;
const LONGEST_VERSION: usize = 12;

/// Most bytes following Control() that can be read in the same transfer.
pub const BEHIND: usize = 0x3A;

/// Factory default of the full-access key, the same for every part that has one.
pub const DEFAULT_FULL_ACCESS: [u16; 2] = [0xffff; 2];

/// Pauses before each further attempt at an idempotent transfer. A gauge that programs a row of its flash stretches
/// the clock or does not answer, for up to 250 ms, and it programs rows of its own at any time.
const PAUSES: [Duration; 5] = [
    Duration::from_millis(25),
    Duration::from_millis(25),
    Duration::from_millis(50),
    Duration::from_millis(100),
    Duration::from_millis(120),
];
/// Further looks at a state until two agree.
const TRIES: u32 = 4;
/// Between two looks at CONTROL_STATUS when no earlier one counts: what disturbs the bus for a moment must not make
/// both wrong.
const APART: Duration = Duration::from_millis(5);

/// How late CONTROL_STATUS may show a new seal state, and the pause between looks at it. Drivers wait 40 ms
/// and try again (bq35100), or 100 ms after a key.
pub(crate) const SEAL_LAG: Duration = Duration::from_millis(240);
const SEAL_POLL: Duration = Duration::from_millis(80);
/// Times that SEALED is sent. A frame may be lost, and I2C has no error detection.
const SEALS: u32 = 4;

/// From a subcommand until MACData() must show its answer; the blocks of data flash take as long.
const ANSWER: Duration = Duration::from_millis(55);

/// The least time between two transfers (SLUSBZ5D 6.14, SLUSBH1C 9.5.4.3).
const BUS_FREE: Duration = Duration::from_micros(66);

/// The seal state of a gauge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seal {
    /// Data flash cannot be accessed.
    Sealed,
    /// Data flash can be read and written.
    Unsealed,
    /// Like UNSEALED, and keys can be changed.
    FullAccess,
}

/// A look at CONTROL_STATUS.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Look {
    pub(crate) seal: Seal,
    /// The word.
    pub(crate) status: u16,
    /// The registers from 0x02 on, as far as they were read with it.
    pub(crate) behind: [u8; BEHIND],
}

impl Look {
    const NONE: Self = Self { seal: Seal::Sealed, status: 0, behind: [0; BEHIND] };
}

impl Seal {
    /// The word for it in `gauge/seal`.
    pub fn as_str(self) -> &'static str {
        match self {
            Seal::Sealed => "sealed",
            Seal::Unsealed => "unsealed",
            Seal::FullAccess => "full-access",
        }
    }
}

/// Counters since the gauge was opened.
#[derive(Debug, Default)]
pub struct Statistics {
    /// START...STOP transfers.
    pub transfers: AtomicU64,
    /// Bytes on the wire, address bytes included.
    pub bytes: AtomicU64,
    /// Transfers that were retried.
    pub retries: AtomicU64,
    /// Polls that succeeded.
    pub polls: AtomicU64,
    /// Polls that failed.
    pub failed_polls: AtomicU64,
    /// Blocks of data flash that were programmed.
    pub flash_writes: AtomicU64,
    /// Resets that were sent.
    pub resets: AtomicU64,
    /// Writes whose values were already stored.
    pub unchanged_writes: AtomicU64,
    /// Times until a commit was seen.
    pub commits: Effects,
    /// Times until a RESET was seen, which seals.
    pub reset_seals: Effects,
    /// Times until the measurement of an offset was seen.
    pub offsets: Effects,
    /// Progress of the current write.
    pub progress: Progress,
}

/// Blocks that the current write has programmed, and their total.
#[derive(Debug, Default)]
pub struct Progress(AtomicU64);

impl Progress {
    /// Starts a write of `blocks` blocks.
    pub fn begin(&self, blocks: usize) {
        self.0.store(blocks as u64, Ordering::Relaxed);
    }

    /// Counts a block that was programmed and verified, while a write is in progress.
    pub fn step(&self) {
        if self.get().is_some() {
            self.0.fetch_add(1 << 32, Ordering::Relaxed);
        }
    }

    /// Ends the write, whatever its outcome.
    pub fn end(&self) {
        self.0.store(0, Ordering::Relaxed);
    }

    /// Blocks done and total; `None` while no write is in progress.
    pub fn get(&self) -> Option<(u32, u32)> {
        let both = self.0.load(Ordering::Relaxed);
        (both != 0).then_some(((both >> 32) as u32, both as u32))
    }
}

impl Statistics {
    /// Value of a counter.
    pub fn read(counter: &AtomicU64) -> u64 {
        counter.load(Ordering::Relaxed)
    }

    /// Adds one to a counter.
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
            ("commits_seen", self.commits.count()),
            ("commit_seen_ms", self.commits.seen_ms()),
            ("commit_unseen_ms", self.commits.unseen_ms()),
            ("resets_seen", self.reset_seals.count()),
            ("reset_seen_ms", self.reset_seals.seen_ms()),
            ("reset_unseen_ms", self.reset_seals.unseen_ms()),
            ("offsets_seen", self.offsets.count()),
            ("offset_seen_ms", self.offsets.seen_ms()),
            ("offset_unseen_ms", self.offsets.unseen_ms()),
        ]
    }
}

/// One gauge at one address.
pub struct Gauge {
    /// Its table.
    pub chip: &'static Chip,
    /// Counters of its traffic.
    pub statistics: Arc<Statistics>,
    /// Clock for waiting and for measuring time.
    pub clock: Arc<dyn Clock>,
    /// Where its keys are to be put, for messages.
    pub key_file: String,
    bus: Box<dyn Bus>,
    keys: Keys,
    byte_writes: bool,
    /// The gauge refused the unseal key; it is not sent again.
    refused: bool,
    /// When one look has shown that the gauge took the unseal key; a block that is read proves it.
    opened: Option<Moment>,
    /// When the gauge accepted the unseal key, if it has since it arrived. A refusal is then a disturbance.
    proven: Option<Moment>,
    /// Transfers are not recorded while this is not 0.
    secrets: u32,
    /// The transfers since [`Self::record`].
    recording: Option<Vec<Event>>,
    /// Transfers that failed.
    failures: u64,
    /// When the last transfer ended.
    stopped: Option<Duration>,
    /// When the gauge last answered, and the longest silence since `watch`.
    answered: Duration,
    silence: Duration,
    presence: Presence,
    effects: Watch,
    /// When the last wait was to end.
    rested: Cell<Duration>,
    /// The seal state that the last look has shown; the next look counts if it agrees. `None` once something was sent
    /// that may change the state.
    seen: Option<Seal>,
    /// The seal state that a command of ours leads to, and until when CONTROL_STATUS may show the one before it.
    commanded: Option<(Seal, Duration)>,
    /// When the seal state was last agreed on.
    agreed: Option<Moment>,
    /// What a command of ours has done that it was not meant to do, until somebody reports it.
    mishap: Option<String>,
    /// The last look at CONTROL_STATUS, and how many bytes behind it each look reads.
    look: Look,
    also: usize,
    /// No transfer starts after this time, so that write(2) returns in time.
    deadline: Option<Duration>,
}

impl Gauge {
    /// A gauge with a chip's table on a bus. Nothing is sent yet.
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
            key_file: "a file named with --key-file".into(),
            bus,
            keys,
            byte_writes,
            refused: false,
            opened: None,
            proven: None,
            secrets: 0,
            recording: None,
            failures: 0,
            stopped: None,
            answered: Duration::ZERO,
            silence: Duration::ZERO,
            presence: Presence::default(),
            effects: Watch::default(),
            rested: Cell::default(),
            seen: None,
            commanded: None,
            agreed: None,
            mishap: None,
            look: Look::NONE,
            also: 0,
            deadline: None,
        }
    }

    /// Lets no transfer start later than `time` from now; `None` removes the limit.
    pub fn limit(&mut self, time: Option<Duration>) {
        self.limit_until(time.map(|time| self.clock.now() + time));
    }

    /// Lets no transfer start later than that; `None` removes the limit.
    pub fn limit_until(&mut self, deadline: Option<Duration>) {
        self.deadline = deadline;
        self.bus.limit(deadline);
    }

    fn is_late(&self) -> bool {
        self.deadline.is_some_and(|deadline| self.clock.now() >= deadline)
    }

    /// Whether something may still be tried: that time has not come, and the limit for transfers allows it.
    pub fn may_try_until(&self, time: Duration) -> bool {
        self.clock.now() < time && !self.is_late()
    }

    /// Waits without any transfer.
    pub fn wait(&self, time: Duration) {
        if !time.is_zero() {
            self.rested.set(self.clock.now() + time);
            self.clock.sleep(time);
        }
    }

    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        // A register pointer is all that is ever sent to a part without a table.
        if write.len() > 1 && !self.chip.has_table() {
            return Err(BusError::ReadOnly);
        }
        self.make_ready()?;
        self.pass(write, read)
    }

    /// Whatever comes before a transfer.
    fn make_ready(&mut self) -> Result<(), BusError> {
        if self.is_late() {
            return Err(BusError::Timeout);
        }
        self.recognise()
    }

    /// A transfer as it is.
    fn pass(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        if let Some(stopped) = self.stopped {
            self.wait((stopped + BUS_FREE).saturating_sub(self.clock.now()));
        }
        let begun = self.clock.now();
        Statistics::count(&self.statistics.transfers);
        self.statistics.bytes.fetch_add(wire_bytes(write.len(), read.len()), Ordering::Relaxed);
        let outcome = self.bus.transfer(write, read);
        let stopped = self.clock.now();
        self.stopped = Some(stopped);
        self.presence.has_taken(stopped.saturating_sub(begun));
        self.note(write, read, outcome);
        if self.secrets > 0 {
            self.effects.forget();
        } else {
            let seen = Seen { begun, ended: stopped, write, read, outcome };
            self.effects.transfer(&seen, self.chip, &self.statistics.commits);
        }
        match outcome {
            Ok(()) => {
                self.silence = self.longest_silence();
                self.answered = self.clock.now();
            }
            Err(_) => {
                self.failures += 1;
                self.presence.doubt();
            }
        }
        outcome
    }

    /// Starts recording the transfers.
    pub fn record(&mut self) {
        self.recording = Some(Vec::new());
    }

    /// Stops recording, and returns what was transferred since [`Self::record`]. Keys are left out; serial numbers are
    /// not, see [`anonymous`](crate::dataflash::anonymous).
    pub fn recorded(&mut self) -> Vec<Event> {
        self.recording.take().unwrap_or_default()
    }

    fn note(&mut self, write: &[u8], read: &[u8], outcome: Result<(), BusError>) {
        let is_secret = self.secrets > 0;
        let Some(recording) = &mut self.recording else { return };
        recording.push(if is_secret {
            Event::Hidden
        } else {
            let answer = outcome.map(|()| read.to_vec());
            Event::Transfer { at: self.clock.now(), write: write.to_vec(), read: read.len(), answer }
        });
    }

    /// Starts measuring the longest silence of the gauge.
    pub fn watch(&mut self) {
        (self.answered, self.silence) = (self.clock.now(), Duration::ZERO);
    }

    /// The longest time without an answer since `watch`. Within a short one nobody can exchange a pack.
    pub fn longest_silence(&self) -> Duration {
        self.silence.max(self.clock.now().saturating_sub(self.answered))
    }

    /// Retries an idempotent transfer a limited number of times.
    fn again(&mut self, mut attempt: impl FnMut(&mut Self) -> Result<(), BusError>) -> Result<(), BusError> {
        let mut outcome = attempt(self);
        for pause in PAUSES {
            if !outcome.is_err_and(BusError::is_transient) || self.is_late() {
                break;
            }
            self.wait(pause);
            Statistics::count(&self.statistics.retries);
            outcome = attempt(self);
        }
        outcome
    }

    /// Why nothing is written to a gauge without a table.
    fn may_write(&self) -> Result<()> {
        if self.chip.has_table() {
            return Ok(());
        }
        let why = "only its standard commands are known, so nothing is written to it";
        Err(Error::new(self.chip.name, Cause::NotPermitted, why))
    }

    /// Fills `into` with the bytes starting at an address.
    pub fn read(&mut self, code: u8, into: &mut [u8]) -> Result<()> {
        self.again(|gauge| gauge.transfer(&[code], into))
            .map_err(|bus| Error::bus(self.name_of(code), bus).of_register().at(Step::Read))
    }

    /// Writes bytes that may be written twice without harm: a pointer, a selection, the window's buffer.
    pub fn write(&mut self, code: u8, data: &[u8]) -> Result<()> {
        self.may_write()?;
        self.again(|gauge| gauge.write_once(code, data))
            .map_err(|bus| Error::bus(self.name_of(code), bus).of_register())
    }

    /// Writes bytes whose effect must not happen twice.
    pub fn write_once(&mut self, code: u8, data: &[u8]) -> Result<(), BusError> {
        self.make_ready()?;
        self.presence.sends(code, data);
        self.send(code, data)?;
        self.presence.sent(code, data, self.chip.access.scheme.is_flat());
        Ok(())
    }

    fn send(&mut self, code: u8, data: &[u8]) -> Result<(), BusError> {
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
        self.chip
            .register_at(code)
            .map_or_else(|| format!("register 0x{code:02x}"), |register| format!("{}()", register.name))
    }

    /// Sends a subcommand without reading an answer.
    pub fn command(&mut self, code: u16) -> Result<()> {
        let subject = self.subcommand_name(code);
        self.write(CONTROL, &code.to_le_bytes()).map_err(|error| error.about(subject).at(Step::Control))
    }

    /// Sends a subcommand whose effect must not happen twice.
    pub fn command_once(&mut self, code: u16) -> Result<()> {
        self.may_write()?;
        let sent = self.write_once(CONTROL, &code.to_le_bytes());
        sent.map_err(|bus| Error::bus(self.subcommand_name(code), bus).at(Step::Control))
    }

    /// Sends a subcommand that must not reach another gauge: only if nothing has happened since then behind which this
    /// one could have been exchanged.
    pub(crate) fn command_since(&mut self, code: u16, moment: Moment) -> Result<()> {
        self.may_write()?;
        let subject = self.subcommand_name(code);
        let mut is_same = true;
        let sent = self.again(|gauge| {
            gauge.make_ready()?;
            is_same = gauge.is_unbroken_since(moment);
            if is_same { gauge.write_once(CONTROL, &code.to_le_bytes()) } else { Err(BusError::Gone) }
        });
        if !is_same {
            let why =
                "not sent: the gauge did not answer for a moment, in which its pack may have been exchanged";
            return Err(Error::new(subject, Cause::NotNow, why).at(Step::Control));
        }
        sent.map_err(|bus| Error::bus(subject, bus).at(Step::Control))
    }

    /// Sends a subcommand and reads the word that it answers with.
    pub fn ask(&mut self, code: u16) -> Result<u16> {
        if code == FW_VERSION && self.chip.identity.answers_in_mac_data() {
            return self.firmware_in_mac_data();
        }
        self.command(code)?;
        // CONTROL_STATUS answers at Control() itself on every part.
        if code != CONTROL_STATUS {
            return self.answer(code, self.chip.identity.answer, &mut []);
        }
        self.status_word(&mut [])
    }

    /// The version of the firmware, which follows the device number.
    fn firmware_in_mac_data(&mut self) -> Result<u16> {
        let (identity, mut word) = (&self.chip.identity, 0);
        // MACData() may still show an older answer.
        for _ in 0..TRIES {
            let mut version = [0; 2];
            self.command(FW_VERSION)?;
            word = self.answer(FW_VERSION, identity.answer, &mut version)?;
            if word.swap_bytes() == identity.device_type {
                return Ok(u16::from_be_bytes(version));
            }
        }
        // No document has such an answer; it tells this part from others all the same.
        Ok(word)
    }

    /// All bytes that FW_VERSION answers with in MACData(); none on a part that answers with a word.
    pub fn whole_firmware_answer(&mut self) -> Result<Vec<u8>> {
        if !self.chip.identity.answers_in_mac_data() {
            return Ok(Vec::new());
        }
        self.command(FW_VERSION)?;
        self.wait(ANSWER.max(self.chip.access.select));
        let mut length = [0];
        self.read(MAC_DATA_LENGTH, &mut length)?;
        // What follows the answer in the buffer may be of a block that was read before.
        let count = usize::from(length[0]).saturating_sub(MAC_OVERHEAD).min(LONGEST_VERSION);
        let mut bytes = vec![0; count];
        if count > 0 {
            self.read(self.chip.identity.answer, &mut bytes)?;
        }
        Ok(bytes)
    }

    /// Reads the answer to CONTROL_STATUS, and with it the registers following Control().
    fn status_word(&mut self, behind: &mut [u8]) -> Result<u16> {
        match self.answer(CONTROL_STATUS, CONTROL, behind)? {
            ANSWERED_ELSEWHERE if self.chip.identity.answer != CONTROL => {
                self.answer(CONTROL_STATUS, CONTROL, behind)
            }
            status => Ok(status),
        }
    }

    /// Reads the answer to a subcommand and the bytes that follow it.
    fn answer(&mut self, code: u16, at: u8, behind: &mut [u8]) -> Result<u16> {
        // MACData() shows the previous answer until the gauge has stored the new one.
        if at != CONTROL {
            self.wait(ANSWER.max(self.chip.access.select));
        }
        let mut bytes = [0; 2 + BEHIND];
        let subject = self.subcommand_name(code);
        let wanted = &mut bytes[..2 + behind.len()];
        self.read(at, wanted).map_err(|error| error.about(subject).at(Step::Control))?;
        behind.copy_from_slice(&wanted[2..]);
        Ok(u16::from_le_bytes([bytes[0], bytes[1]]))
    }

    pub(crate) fn subcommand_name(&self, code: u16) -> String {
        let known = self.chip.subcommands.iter().find(|subcommand| subcommand.code == code);
        known.map_or_else(|| format!("Control(0x{code:04x})"), |known| format!("Control({})", known.name))
    }

    /// Makes sure that no kernel driver has taken the address.
    pub fn claim(&mut self) -> Result<()> {
        self.bus.claim().map_err(|bus| Error::bus(self.chip.name, bus).at(Step::Check))
    }

    /// Releases an adapter that was removed.
    pub fn release_if_gone(&mut self) {
        self.bus.release_if_gone();
    }

    /// Reads the type, firmware and versions that the gauge reports.
    pub fn identify(&mut self) -> Result<Answers> {
        let device_type = self.ask(DEVICE_TYPE).map_err(|error| error.at(Step::Identify))?;
        self.identify_type(device_type)
    }

    /// Reads firmware and versions of a gauge that has answered with that type.
    pub fn identify_type(&mut self, device_type: u16) -> Result<Answers> {
        let named = |error: Error| error.at(Step::Identify);
        let firmware_version = self.firmware_version()?;
        let hardware_version = self.ask_named("HW_VERSION").map_err(named)?.unwrap_or_default();
        let chem_id = self.ask_named("CHEM_ID").map_err(named)?;
        // The code is a byte; nothing is said of the other one.
        let dm_code = self.ask_named("DM_CODE").map_err(named)?.map(|code| code & 0xff);
        Ok(Answers { device_type, firmware_version, hardware_version, chem_id, dm_code })
    }

    /// The answer to a subcommand, if the table has one of that name.
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
        // A bit error is not another part, so an unexpected answer is requested again.
        for _ in 0..2 {
            found = self.ask(DEVICE_TYPE).map_err(|error| error.at(Step::Identify))?;
            if found == expected {
                break;
            }
        }
        if found == expected {
            return Ok(());
        }
        Err(Error::of(self.chip.model, Reason::OtherPart { expected, found }).at(Step::Identify))
    }

    /// Reads the seal state.
    pub fn seal(&mut self) -> Result<Seal> {
        self.control_status().map(|(seal, _)| seal)
    }

    /// Reads the seal state with two looks, whatever was seen before.
    pub fn seal_anew(&mut self) -> Result<Seal> {
        self.seen = None;
        self.seal()
    }

    /// Reads the seal state and the CONTROL_STATUS word.
    ///
    /// I2C has no error detection, and a gauge whose state was misread would be left in that state, or open. So a
    /// state counts only if the look before has shown it too. What we have sent is no look: after a command that
    /// changes the state it takes two looks to know what came of it, and while the gauge may still show the state
    /// from before the command, that one does not count.
    pub fn control_status(&mut self) -> Result<(Seal, u16)> {
        let look = self.look_at_status()?;
        Ok((look.seal, look.status))
    }

    /// Reads CONTROL_STATUS and the registers behind it, as many as [`Self::also_read`] says.
    pub(crate) fn look_at_status(&mut self) -> Result<Look> {
        let mut differ = 0;
        loop {
            let seal = self.control_status_once()?;
            match self.seen.replace(seal) {
                Some(before) if before == seal => {}
                before => {
                    differ += 1;
                    if differ > TRIES {
                        let why = "the seal state reads differently each time: check the bus";
                        return Err(Error::new("CONTROL_STATUS", Cause::Protocol, why).at(Step::Control));
                    }
                    if before.is_none() {
                        self.wait(APART);
                    }
                    continue;
                }
            }
            match self.commanded {
                Some((goal, until)) if seal != goal && self.clock.now() < until => self.wait(SEAL_POLL),
                _ => {
                    self.agreed = Some(self.moment());
                    return Ok(self.look);
                }
            }
        }
    }

    /// From now on each look at CONTROL_STATUS reads, in the same transfer, that many bytes of the registers from
    /// 0x02 on.
    pub(crate) fn also_read(&mut self, count: usize) {
        self.also = count.min(BEHIND);
    }

    /// The last look at CONTROL_STATUS.
    pub(crate) fn last_look(&self) -> Look {
        self.look
    }

    fn control_status_once(&mut self) -> Result<Seal> {
        let begun = self.clock.now();
        self.command(CONTROL_STATUS)?;
        let mut behind = [0; BEHIND];
        let also = self.also;
        let status = self.status_word(&mut behind[..also])?;
        let seal = match self.chip.security.status {
            SealStatus::Bits { sealed, .. } if status & sealed != 0 => Seal::Sealed,
            SealStatus::Bits { not_full_access, .. } => {
                if not_full_access != 0 && status & not_full_access == 0 {
                    Seal::FullAccess
                } else {
                    Seal::Unsealed
                }
            }
            SealStatus::None => {
                return Err(Error::bus("CONTROL_STATUS", BusError::ReadOnly).of_register());
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
                        return Err(Error::new("CONTROL_STATUS", Cause::Protocol, why));
                    }
                }
            }
        };
        self.look = Look { seal, status, behind };
        let look = Status { begun, ended: self.clock.now(), status, seal };
        self.effects.look(&look, &self.statistics.reset_seals, &self.statistics.offsets);
        Ok(seal)
    }

    /// Goes from SEALED to UNSEALED and confirms it.
    ///
    /// The two words are sent with nothing in between. If the gauge stays SEALED they are sent once more after a
    /// pause, as TI advises, and then never again: a refused key is not sent in a loop. Two cases are no refusal
    /// of the key: the gauge has accepted it before, or a transfer failed in between.
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
        if self.refused {
            return Err(refused("SEALED, and the key was refused before"));
        }
        let failures = self.failures;
        if self.takes(&key, Seal::Unsealed)? {
            return Ok(());
        }
        if self.proven.is_some() || self.failures != failures {
            let why = "SEALED, and the gauge did not take its key, twice: the bus is disturbed; try again";
            return Err(Error::new(self.chip.model, Cause::NotNow, why).at(Step::Unseal));
        }
        self.refused = true;
        Err(refused("SEALED, and the gauge refused the key"))
    }

    /// Whether the gauge that is there is known to have the unseal key: it has accepted it, and nothing has happened
    /// since behind which it could have been exchanged.
    pub fn key_is_proven(&self) -> bool {
        self.proven.is_some_and(|moment| self.is_unbroken_since(moment))
    }

    /// Whether the unseal key was accepted since the gauge arrived, or by one that was exchanged unnoticed.
    pub(crate) fn key_has_worked(&self) -> bool {
        self.proven.is_some() || self.opened.is_some()
    }

    /// Notes that the gauge is known to have the unseal key, though it has not been used.
    pub fn prove_key(&mut self) {
        self.proven = Some(self.moment());
    }

    /// Notes that the gauge is certainly open: it has shown data flash, or two looks agree. If a key has opened it, that
    /// key is right.
    pub fn note_open(&mut self) {
        self.proven = self.opened.or(self.proven);
    }

    /// Whether the gauge that is there was opened with the unseal key, so that it may be sealed again.
    pub(crate) fn was_opened(&self) -> bool {
        self.opened.into_iter().chain(self.proven).any(|moment| self.is_unbroken_since(moment))
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
        if goal == Seal::Unsealed && self.make_ready().is_ok() && self.agreed != Some(self.moment()) {
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
        if self.deadline.is_some_and(|deadline| self.clock.now() + silence >= deadline) {
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
        self.set_secret(true);
        // A word that was not acknowledged is sent again at once: nothing may come between the two.
        let mut send = |word: &[u8]| self.again(|gauge| gauge.write_once(CONTROL, &[word[1], word[0]]));
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
        // A key that is sent too early is refused, for FULL ACCESS and on a gauge with RAM, so a single misread state
        // could look like success: two looks must agree. Elsewhere one does, because only an open gauge echoes the
        // selection of the block that is read next.
        let is_echoed = goal == Seal::Unsealed && self.chip.access.scheme == Scheme::Block;
        self.seen = is_echoed.then_some(goal);
        let state = self.seal().map_err(|error| error.at(Step::Unseal))?;
        // Another gauge may have been open already.
        if state == goal && goal == Seal::Unsealed && self.is_unbroken_since(moment) {
            self.opened = Some(moment);
        }
        Ok(state == goal)
    }

    /// Something is sent that leads to a seal state, which CONTROL_STATUS may show late.
    fn commands(&mut self, goal: Seal) {
        (self.seen, self.commanded) = (None, Some((goal, self.clock.now() + SEAL_LAG)));
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
            // UNSEALED is reached from FULL ACCESS only through SEALED.
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
        let before = self.agreed.filter(|&moment| self.is_unbroken_since(moment)).map(|_| self.look.status);
        let mut outcome = Ok(Seal::Unsealed);
        for attempt in 0..SEALS {
            if attempt > 0 {
                let why =
                    "SEALED did not reach the gauge, which may have taken it for another command; sent again";
                log::warn!("{}: {why}", self.chip.name);
            }
            self.opened = None;
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
    fn note_enabled(&mut self, before: Option<u16>) {
        let enabled = self.chip.control_status.iter().find(|bit| bit.name == "QEN").map_or(0, |bit| bit.mask);
        let is_new = |now: u16| before.is_some_and(|before| before & enabled == 0) && now & enabled != 0;
        // I2C has no error detection.
        if is_new(self.look.status) && self.seal_anew().is_ok() && is_new(self.look.status) {
            let why = "SEALED has reached the gauge as IT_ENABLE: [QEN] is set, and Update Status with it (04), which \
                       nothing takes back; check whether Impedance Track was to be enabled";
            self.mishap = Some(why.into());
        }
    }

    /// What a command of ours has done that it was not meant to do, once.
    pub(crate) fn take_mishap(&mut self) -> Option<String> {
        self.mishap.take()
    }

    /// How many transfers have failed.
    pub(crate) fn failures(&self) -> u64 {
        self.failures
    }

    /// Sends RESET, after which a part that had been sealed is sealed again (SLUSBZ5D 7.3.3.1 step 11): not to a gauge
    /// that may have been exchanged since then.
    pub(crate) fn reset_since(&mut self, moment: Moment) -> Result<()> {
        Statistics::count(&self.statistics.resets);
        (self.seen, self.commanded) = (Some(Seal::Sealed), None);
        self.command_since(RESET, moment).map_err(|error| error.at(Step::Reset))?;
        self.effects.reset(self.clock.now());
        Ok(())
    }

    /// Sends RESET to whatever gauge is there.
    pub fn reset(&mut self) -> Result<()> {
        let moment = self.moment();
        self.reset_since(moment)
    }

    /// The key to send: the configured one, or the manual's default if that is allowed.
    pub fn key(&self, name: Name) -> Option<Secret> {
        self.keys.secret(name).or_else(|| self.default_key(name))
    }

    /// The manual's default key, if that is allowed.
    pub fn default_key(&self, name: Name) -> Option<Secret> {
        self.manual_key(name).filter(|_| !self.keys.no_default).map(Secret::from)
    }

    /// The two words that the manual gives for the key of that name.
    pub(crate) fn manual_key(&self, name: Name) -> Option<[u16; 2]> {
        match name {
            Name::Unseal => Some(self.chip.security.default_unseal),
            Name::FullAccess => Some(DEFAULT_FULL_ACCESS),
            Name::Authentication => None,
        }
    }

    /// Sets the key that the gauge has now.
    pub fn set_key(&mut self, name: Name, key: &Secret) {
        self.keys.set(name, key);
        self.forget_refusal();
    }

    /// Marks the following transfers as secret (`true`), until as many calls have ended that (`false`).
    pub fn set_secret(&mut self, secret: bool) {
        self.secrets = if secret { self.secrets + 1 } else { self.secrets.saturating_sub(1) };
        self.bus.set_secret(self.secrets > 0);
    }

    /// Forgets all that is known of the gauge, after an access that was not brought to its end.
    pub fn start_over(&mut self) {
        self.forget_refusal();
        self.limit_until(None);
        (self.seen, self.commanded, self.also) = (None, None, 0);
        (self.secrets, self.recording) = (0, None);
        self.bus.set_secret(false);
        self.statistics.progress.end();
    }

    /// Forgets whether a key was refused or accepted: the gauge may be another one of the same kind.
    pub fn forget_refusal(&mut self) {
        (self.refused, self.opened, self.proven) = (false, None, None);
    }
}

/// What two looks in a row agree on, because I2C has no error detection. `subject` is what is looked at.
///
/// # Errors
/// [`Cause::Protocol`] if no two agree, and any error of a look.
pub fn agreed<T: PartialEq>(subject: &str, mut look: impl FnMut() -> Result<T>) -> Result<T> {
    let mut last = look()?;
    for _ in 0..TRIES {
        let next = look()?;
        if next == last {
            return Ok(next);
        }
        last = next;
    }
    let why = "it reads differently each time: check the bus";
    Err(Error::new(subject, Cause::Protocol, why).at(Step::Read))
}
