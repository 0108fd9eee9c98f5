// SPDX-License-Identifier: MIT

//! Transfers: all of them go through one method, which counts them.
//!
//! Only this module retries, and only idempotent transfers; the checksum that commits a block is not one.

use std::cell::Cell;
use std::sync::atomic::Ordering;
use std::time::Duration;

use super::Gauge;
use super::effects::Seen;
use super::packets::{self, Packets};
use super::statistics::Statistics;
use crate::chip::{Question, Scheme, Way};
use crate::codec::WINDOW;
use crate::error::{Cause, Error, Reason, Result, Step};
use gauge_bus::trace::Event;
use gauge_bus::{Bus, BusError, Packet, Reach, wire_bytes};

mod pace;
mod recognise;
mod shown;

pub(crate) use shown::Landmark;

/// Pauses before further attempts. A gauge that programs a row, at any time, stretches the clock or is silent for 250 ms.
const PAUSES: [Duration; 5] = [
    Duration::from_millis(25),
    Duration::from_millis(25),
    Duration::from_millis(50),
    Duration::from_millis(100),
    Duration::from_millis(120),
];

/// The least time between two transfers (SLUSBZ5D 6.14, SLUSBH1C 9.5.4.3).
const BUS_FREE: Duration = Duration::from_micros(66);

pub(super) struct Wire {
    bus: Box<dyn Bus>,
    /// What the gauge takes, whatever its bus carries.
    takes: Reach,
    /// Transfers are not recorded while this is not 0.
    secrets: u32,
    /// The transfers since [`Gauge::record`].
    recording: Option<Vec<Event>>,
    failures: u64,
    stopped: Option<Duration>,
    /// When the gauge last answered, and the longest silence since [`Gauge::watch`].
    answered: Duration,
    silence: Duration,
    /// When the last wait was to end.
    rested: Cell<Duration>,
    pace: pace::Pace,
    /// What the window shows.
    shown: shown::Shown,
    /// No transfer starts after it, so that write(2) returns in time.
    limit: Option<Limit>,
    /// What a Smart Battery answers.
    pub(super) packets: Packets,
}

#[derive(Clone, Copy)]
struct Limit {
    since: Duration,
    transfers: u64,
    failures: u64,
    deadline: Duration,
}

impl Wire {
    pub(super) fn new(bus: Box<dyn Bus>, packets: Packets) -> Self {
        Self {
            bus,
            takes: Reach::FULL,
            secrets: 0,
            recording: None,
            failures: 0,
            stopped: None,
            answered: Duration::ZERO,
            silence: Duration::ZERO,
            rested: Cell::default(),
            pace: pace::Pace::default(),
            shown: shown::Shown::default(),
            limit: None,
            packets,
        }
    }

    pub(super) fn at(&mut self, address: u8) {
        self.packets = Packets::at(address);
    }

    pub(super) fn within(&mut self, reach: Reach) {
        self.takes = reach;
    }
}

impl Gauge {
    /// Lets no transfer start later than `time` from now; `None` removes the limit.
    pub fn limit(&mut self, time: Option<Duration>) {
        self.limit_until(time.map(|time| self.clock.now() + time));
    }

    /// Lets no transfer start later than that; `None` removes the limit.
    pub fn limit_until(&mut self, deadline: Option<Duration>) {
        let begins = || Limit {
            since: self.clock.now(),
            transfers: Statistics::read(&self.statistics.transfers),
            failures: self.wire.failures,
            deadline: Duration::ZERO,
        };
        // A later limit of the same access counts from its beginning.
        self.wire.limit =
            deadline.map(|deadline| Limit { deadline, ..self.wire.limit.unwrap_or_else(begins) });
        self.wire.bus.limit(deadline);
    }

    fn is_late(&self) -> bool {
        self.late().is_some()
    }

    fn late(&self) -> Option<BusError> {
        let Limit { since, transfers, failures, deadline } = self.wire.limit?;
        let now = self.clock.now();
        let milliseconds =
            |time: Duration| time.saturating_sub(since).as_millis().try_into().unwrap_or(u32::MAX);
        let more = |now: u64, then: u64| now.saturating_sub(then).try_into().unwrap_or(u32::MAX);
        (now >= deadline).then(|| BusError::TooSlow {
            transfers: more(Statistics::read(&self.statistics.transfers), transfers),
            failed: more(self.wire.failures, failures),
            milliseconds: milliseconds(now),
            limit: milliseconds(deadline),
        })
    }

    /// Whether something may still be tried: that time has not come, and the limit for transfers allows it.
    pub fn may_try_until(&self, time: Duration) -> bool {
        self.clock.now() < time && !self.is_late()
    }

    pub(super) fn has_time_for(&self, time: Duration) -> bool {
        self.wire.limit.is_none_or(|limit| self.clock.now() + time < limit.deadline)
    }

    /// Waits without any transfer.
    pub fn wait(&self, time: Duration) {
        if !time.is_zero() {
            self.wire.rested.set(self.clock.now() + time);
            self.clock.sleep(time);
        }
    }

    pub(crate) fn wait_until(&self, time: Duration) {
        self.wait(time.saturating_sub(self.clock.now()));
    }

    pub(super) fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        // A register pointer before a read is all that is ever sent to a part without a table.
        if (write.len() > 1 || read.is_empty()) && !self.chip.has_table() {
            return Err(BusError::ReadOnly);
        }
        // A look begins at Control() where the bus carries it, which is not limited. No watchdog of packs does so.
        let scheme = self.chip.access.scheme;
        let is_free = read.is_empty() || scheme.is_flat() || scheme == Scheme::Smbus;
        if let (&[code], false) = (write, is_free) {
            let pause = self.wire.pace.before(code, self.clock.now());
            self.wait(pause);
        }
        self.make_ready()?;
        self.pass(write, read)
    }

    /// Asks a Smart Battery: what a question makes is all that is ever sent to one beside a command code.
    pub(super) fn pose(&mut self, question: Question, way: Way, with_pec: bool) -> Result<(), BusError> {
        let mut message = question.message(way);
        if with_pec {
            let whole = [&[self.wire.packets.address << 1], &*message].concat();
            message.push(packets::crc(&whole));
        }
        self.make_ready()?;
        self.pass(&message, &mut [])
    }

    /// Reads where a question is answered. No watchdog of these parts limits how often.
    pub(super) fn hear(&mut self, way: Way, into: &mut [u8]) -> Result<(), BusError> {
        self.make_ready()?;
        self.pass(&[way.code()], into)
    }

    pub(super) fn make_ready(&mut self) -> Result<(), BusError> {
        if let Some(late) = self.late() {
            return Err(late);
        }
        self.recognise()
    }

    /// A word or a block of SMBus, as one command of the host. Returns how many bytes it has.
    pub(super) fn packet(&mut self, packet: Packet, into: &mut [u8]) -> Result<usize, BusError> {
        self.make_ready()?;
        self.pass_by(&[packet.code], into, |bus, into| {
            let bytes = bus.packet(packet)?;
            into.iter_mut().zip(&bytes).for_each(|(to, byte)| *to = *byte);
            Ok(bytes.len().min(into.len()))
        })
    }

    pub(super) fn pass(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let send = |bus: &mut dyn Bus, read: &mut [u8]| bus.transfer(write, read).map(|()| read.len());
        self.pass_by(write, read, send).map(drop)
    }

    fn pass_by(
        &mut self,
        write: &[u8],
        read: &mut [u8],
        send: impl FnOnce(&mut dyn Bus, &mut [u8]) -> Result<usize, BusError>,
    ) -> Result<usize, BusError> {
        if let Some(stopped) = self.wire.stopped {
            self.wait_until(stopped + BUS_FREE);
        }
        let begun = self.clock.now();
        Statistics::count(&self.statistics.transfers);
        let moved = send(&mut *self.wire.bus, read);
        let (read, outcome) = (&read[..moved.unwrap_or(read.len())], moved.map(drop));
        self.statistics.bytes.fetch_add(wire_bytes(write.len(), read.len()), Ordering::Relaxed);
        let stopped = self.clock.now();
        self.wire.stopped = Some(stopped);
        self.presence.note_duration(stopped.saturating_sub(begun));
        self.note(write, read, outcome);
        let touches = self.dialect.touches(write);
        self.wire.shown.transfer(&touches, outcome, (self.chip.access.scheme.is_flat(), stopped));
        if self.wire.secrets > 0 {
            self.effects.forget();
            self.wire.shown.forget();
        } else {
            let shown = match write {
                [start] => Some(self.dialect.shows(*start, read)),
                _ => None,
            };
            let seen = Seen { begun, ended: stopped, touches: &touches, shown, outcome };
            self.effects.transfer(&seen, self.chip, &self.statistics.commits);
        }
        // What was shown is the selection until the next read, and then the one behind it.
        if self.chip.access.advances
            && write == self.dialect.selection()
            && read.len() > WINDOW
            && outcome.is_ok()
        {
            self.presence.note_advance(WINDOW as u16);
        }
        match outcome {
            Ok(()) => {
                self.wire.silence = self.longest_silence();
                self.wire.answered = self.clock.now();
            }
            // It says nothing of the gauge that was recorded.
            Err(BusError::NotRecorded) => {}
            Err(_) => {
                self.wire.failures += 1;
                self.presence.doubt();
            }
        }
        moved
    }

    /// Starts recording the transfers.
    pub fn record(&mut self) {
        self.wire.recording = Some(Vec::new());
    }

    /// Stops recording. Keys are left out; serial numbers are not, see [`anonymous`](crate::dataflash::anonymous).
    pub fn recorded(&mut self) -> Vec<Event> {
        self.wire.recording.take().unwrap_or_default()
    }

    fn note(&mut self, write: &[u8], read: &[u8], outcome: Result<(), BusError>) {
        let is_secret = self.wire.secrets > 0;
        let Some(recording) = &mut self.wire.recording else { return };
        recording.push(if is_secret {
            Event::Hidden
        } else {
            let answer = outcome.map(|()| read.to_vec());
            Event::Transfer { at: self.clock.now(), write: write.to_vec(), read: read.len(), answer }
        });
    }

    /// Starts measuring the longest silence of the gauge.
    pub fn watch(&mut self) {
        (self.wire.answered, self.wire.silence) = (self.clock.now(), Duration::ZERO);
    }

    /// The longest time without an answer since `watch`. Within a short one nobody can exchange a pack.
    pub fn longest_silence(&self) -> Duration {
        self.wire.silence.max(self.clock.now().saturating_sub(self.wire.answered))
    }

    pub(super) fn again(
        &mut self,
        mut attempt: impl FnMut(&mut Self) -> Result<(), BusError>,
    ) -> Result<(), BusError> {
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

    pub(super) fn refuse_without_table(&self) -> Result<()> {
        if self.chip.has_table() {
            return Ok(());
        }
        Err(Error::new(self.chip.name, Cause::NotPermitted, self.chip.only_read()))
    }

    /// Sends what changes the gauge, and keeps track of what it shows as its selection then.
    pub(super) fn tell(
        &mut self,
        message: &[u8],
        send: impl FnOnce(&mut Self) -> Result<(), BusError>,
    ) -> Result<(), BusError> {
        self.make_ready()?;
        let touches = self.dialect.touches(message);
        self.presence.sends(&touches);
        send(self)?;
        self.presence.sent(&touches, self.chip.access.scheme.is_flat());
        Ok(())
    }

    /// What the bus carries, whatever the gauge takes.
    pub(super) fn carried(&mut self) -> Reach {
        self.wire.bus.reach()
    }

    pub(super) fn reach(&mut self) -> Reach {
        self.carried().narrowed(self.wire.takes)
    }

    pub(super) fn takes_bytes(&self) -> bool {
        self.wire.takes.write <= Reach::ONE_BYTE_A_WRITE.write
    }

    /// Refuses a change of data flash if only its names are known, or if no block of it can be written: one message carries
    /// it, or single bytes do.
    pub fn check_writes(&mut self) -> Result<()> {
        self.chip.check_proven()?;
        let (reach, bytes) = (self.reach(), 1 + WINDOW as u16);
        if reach.write >= bytes || self.takes_bytes() || self.chip.byte_writes_above_hz.is_some() {
            return Ok(());
        }
        let reason = Reason::ShortWrites { greatest: reach.write, bytes };
        Err(Error::of(self.chip.name, reason).at(Step::Check))
    }

    /// Makes sure that no kernel driver has taken the address.
    pub fn claim(&mut self) -> Result<()> {
        self.wire.bus.claim().map_err(|bus| Error::bus(self.chip.name, bus).at(Step::Check))
    }

    /// Releases an adapter that was removed.
    pub fn release_if_gone(&mut self) {
        self.wire.bus.release_if_gone();
    }

    pub(crate) fn failures(&self) -> u64 {
        self.wire.failures
    }

    /// Marks the following transfers as secret (`true`), until as many calls have ended that (`false`).
    pub fn set_secret(&mut self, secret: bool) {
        self.wire.secrets = if secret { self.wire.secrets + 1 } else { self.wire.secrets.saturating_sub(1) };
        self.wire.bus.set_secret(self.wire.secrets > 0);
    }

    /// Forgets the secrets and the recording of an access that was not brought to its end.
    pub(super) fn hide_nothing(&mut self) {
        (self.wire.secrets, self.wire.recording) = (0, None);
        self.wire.bus.set_secret(false);
    }
}
