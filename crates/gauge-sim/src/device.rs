// SPDX-License-Identifier: MIT

//! The shell of a simulated gauge, the same for every part: power, flash and its state file, timing, the battery's
//! clock, and the knobs of all gauges. The part's scheme adds the rest.
//!
//! Where the documents leave a choice, the gauge does what is worst for a driver: it is silent while it starts, and it
//! acknowledges what it does not store.

use std::borrow::Cow;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use super::envelope::{DRAWN, Envelope, Lost, NackAs};
use super::fault::{Commit, Plan};
use super::flash::{BLOCK, Flash, Store};
use super::knob::{self, Knob, KnobValue, Of};
use super::model::Kept;
use super::model::Model;
use super::options::Options;
use super::part::{Part, Scheme};
use super::scenario::FLASH;
use super::seal::{Level, Seal};
use super::timing::Busy;
use super::timing::Timing;
use super::watchdog::Watchdog;
use gauge_bus::error::{Error, ErrorKind, Result};

enum Power {
    On,
    /// Off, until that time if power returns by itself.
    Off(Option<Duration>),
}

struct Pending {
    old: Kept,
    started: Duration,
    ends: Duration,
}

pub(super) struct Device {
    pub(super) part: &'static Part,
    pub(super) flash: Flash,
    pub(super) store: Store,
    pub(super) timing: Timing,
    pub(super) envelope: Envelope,
    plan: Plan,
    /// Everything has happened up to this time.
    pub(super) now: Duration,
    /// Battery seconds per second.
    speed: f64,
    /// Battery time since 1970: the host's when the gauge was made, and what has passed since.
    clock: Duration,
    /// The battery and its model have been run up to this time.
    pub(super) modelled: Duration,
    power: Power,
    powered_at: Duration,
    pub(super) ready_at: Duration,
    /// Due time of a reset, while the gauge still answers as before.
    resets_at: Option<Duration>,
    /// Power has come; a reset would not set this.
    cold: bool,
    /// First measurement of Voltage() since power came.
    pub(super) measured_from: Duration,
    /// What the first block that was written in this CONFIG UPDATE held before.
    first: Option<Kept>,
    /// Full resets since power came.
    pub(super) resets: u16,
    pub(super) watchdog_expired: bool,
    watchdog: Watchdog,
    busy_until: Duration,
    /// Oldest first.
    pending: Vec<Pending>,
    /// The host's commits, and how many of them were acknowledged and not stored.
    commits: u64,
    dropped: u64,
    last_transfer: Duration,
    transfers: u64,
    /// The gauge's rewrites of its own values, and the last one's time.
    rewrites: usize,
    rewritten_at: Duration,
    /// Silence on the bus before the current message.
    pub(super) quiet: Duration,
}

impl Device {
    /// A device that has long had power. `prepare` adapts a new part's flash to the options.
    pub(super) fn new(
        part: &'static Part,
        options: &Options,
        now: Duration,
        prepare: impl FnOnce(&mut Flash),
    ) -> Result<Self> {
        let mut flash = Flash::new(part.image);
        flash.firmware = part.firmware();
        let mut store = Store::new(options.state.clone(), part.name);
        if !store.load(&mut flash)? {
            prepare(&mut flash);
            store.save(&flash)?;
        }
        Ok(Self {
            part,
            flash,
            store,
            timing: part.timing,
            envelope: Envelope::friendly(options.seed),
            plan: Plan::new(options.seed, options.envelope.is_some()),
            now,
            speed: 1.0,
            clock: SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default(),
            modelled: now,
            power: Power::On,
            powered_at: now,
            ready_at: now,
            resets_at: None,
            cold: false,
            measured_from: now,
            first: None,
            resets: 0,
            watchdog_expired: false,
            watchdog: Watchdog::new(),
            busy_until: now,
            pending: Vec::new(),
            commits: 0,
            dropped: 0,
            last_transfer: Duration::ZERO,
            transfers: 0,
            rewrites: 0,
            rewritten_at: now,
            quiet: Duration::MAX,
        })
    }

    pub(super) fn is_on(&self) -> bool {
        matches!(self.power, Power::On)
    }

    /// Whether the silence before a key's first word was long enough.
    pub(super) fn hears_keys(&self, seal: &Seal) -> bool {
        let timing = &self.timing;
        let full_access =
            if seal.level == Level::Unsealed { timing.full_access_quiet } else { Duration::ZERO };
        let refused = if seal.refused { timing.refused_quiet } else { Duration::ZERO };
        self.quiet >= timing.key_quiet.max(full_access).max(refused)
    }

    pub(super) fn loses(&mut self, lost: Lost) -> bool {
        self.plan.loses(lost) || self.envelope.loses(lost)
    }

    /// Whether nothing has been measured since the start, so that registers are wrong.
    pub(super) fn unmeasured(&self) -> bool {
        !self.envelope.first.is_zero() && self.now < self.measured_from
    }

    /// Flash as a block sees it that is selected now.
    pub(super) fn loadable(&self) -> Cow<'_, Flash> {
        if self.envelope.commit_busy != Busy::Old || self.pending.is_empty() {
            return Cow::Borrowed(&self.flash);
        }
        let mut flash = self.flash.clone();
        // Newest first, so that the content before all of them remains.
        for Pending { old, .. } in self.pending.iter().rev() {
            flash.set(old.area, old.offset, &old.bytes);
        }
        Cow::Owned(flash)
    }

    /// The knob of a time or of the envelope with that name.
    fn knob_value(&mut self, name: &str) -> Option<&mut dyn KnobValue> {
        if name == "reset_busy" {
            return Some(&mut self.timing.reset_busy);
        }
        match self.timing.knob(name) {
            Some(time) => Some(time),
            None => self.envelope.knob_value(name),
        }
    }

    /// Saves flash. The `state` knob reports a failure.
    pub(super) fn save(&mut self) {
        let _ = self.store.save(&self.flash);
    }

    /// Brings everything up to `now`. `settle` asks for a measurement at once.
    fn run(&mut self, wire: &mut dyn Wire, now: Duration, settle: bool) {
        if let Power::Off(Some(until)) = self.power
            && now >= until
        {
            self.now = until;
            self.power_up(wire);
        }
        self.lose_power_again(wire, now);
        if let Some(at) = self.resets_at.take_if(|at| now >= *at) {
            self.now = at;
            self.restart(wire, at);
        }
        self.now = now;
        self.pending.retain(|pending| now < pending.ends);
        wire.run(self, settle);
    }

    /// A loose contact: power goes and comes again. Of several times that have passed the last one counts.
    fn lose_power_again(&mut self, wire: &mut dyn Wire, now: Duration) {
        let every = Duration::from_secs(self.envelope.reset_every_s.into());
        let passed =
            now.saturating_sub(self.powered_at).as_nanos().checked_div(every.as_nanos()).unwrap_or(0);
        if !self.is_on() || passed == 0 {
            return;
        }
        self.now = self.powered_at + Duration::from_nanos((passed * every.as_nanos()) as u64);
        self.power_up(wire);
    }

    /// Rewrites one of the gauge's own values, if due.
    fn rewrite_own(&mut self, wire: &mut dyn Wire) {
        let Envelope { rewrite, rewrite_every, .. } = self.envelope;
        self.transfers += 1;
        let counted = rewrite_every > 0 && self.transfers.is_multiple_of(rewrite_every.into());
        let timed = !rewrite.is_zero() && self.now >= self.rewritten_at + rewrite;
        let rows = self.part.rewrites;
        // One row after the other: what is stored of its own waits until the one before it is over.
        if counted && !timed && self.now < self.busy_until {
            return;
        }
        if !(counted || timed) || rows.is_empty() || self.now < self.ready_at || !wire.gauges() {
            return;
        }
        // At the scheduled time, so that a retrying host meets the pauses too.
        let now = self.now;
        if timed {
            let due = (now - self.rewritten_at).as_nanos() / rewrite.as_nanos() * rewrite.as_nanos();
            self.now = self.rewritten_at + Duration::from_nanos(due as u64);
        }
        self.rewritten_at = self.now;
        self.rewrites += 1;
        let (area, offset, length) = rows[self.rewrites % rows.len()];
        let mut bytes = self.flash.bytes_at(area, offset, length).to_vec();
        if let Some(last) = bytes.last_mut() {
            *last = last.wrapping_add(1);
        }
        self.keep(wire, vec![Kept::new(area, offset, &bytes)]);
        self.now = now;
        self.pending.retain(|pending| now < pending.ends);
    }

    /// Lets battery time pass. The gauge measures once a second of its time; `settle` makes it measure at once.
    pub(super) fn pass(&mut self, wire: &mut dyn Wire, settle: bool) {
        let seconds = self.now.saturating_sub(self.modelled).as_secs_f64() * self.speed;
        if seconds < 1.0 && !settle && self.speed > 0.0 {
            return;
        }
        self.modelled = self.now;
        self.clock += Duration::from_secs_f64(seconds);
        let mut left = seconds;
        while left > 0.0 {
            // A pack at rest is exact over any time; other long runs are coarser.
            let longest = if wire.model().at_rest() {
                60.0_f64.max(left / 100.0)
            } else {
                (seconds / 3600.0).clamp(1.0, 15.0)
            };
            let step = left.min(longest);
            let kept = wire.model().step(step);
            self.keep(wire, kept);
            left -= step;
        }
        let learned = wire.model().learned(&self.flash);
        self.keep(wire, learned);
    }

    /// Stores the gauge's own values, if power and voltage allow it.
    pub(super) fn keep(&mut self, wire: &mut dyn Wire, kept: Vec<Kept>) {
        for kept in kept {
            if self.is_on() && wire.gate(&self.flash) {
                self.program(wire, kept);
            }
        }
    }

    /// Stores the host's commit, unless the gauge or a fault prevents it.
    pub(super) fn commit(&mut self, wire: &mut dyn Wire, mut kept: Kept, allowed: bool) {
        self.commits += 1;
        let fault = self.plan.commit();
        if !allowed || !wire.gate(&self.flash) || fault == Some(Commit::Drop) {
            self.dropped += 1;
            return;
        }
        if fault == Some(Commit::Corrupt) {
            let old = |at: usize| self.flash.u8(kept.area, kept.offset + at);
            let changed = (0..kept.bytes.len()).find(|&at| kept.bytes[at] != old(at));
            kept.bytes[changed.unwrap_or(0)] ^= 0x01;
        }
        if !self.part.has_flash() && self.first.is_none() {
            let Kept { area, offset, bytes } = &kept;
            self.first = Some(Kept::new(*area, *offset, self.flash.bytes_at(*area, *offset, bytes.len())));
        }
        self.program(wire, kept);
        if let Some(Commit::Torn(words)) = fault
            && let Some(pending) = self.pending.pop()
        {
            self.tear(&pending.old, words);
            self.pending.clear();
            self.power_down(wire, None);
        }
    }

    /// Programs flash. An unwritable state file acts as flash that cannot be programmed.
    fn program(&mut self, wire: &mut dyn Wire, kept: Kept) {
        let Kept { area, offset, bytes } = match self.part.scheme {
            Scheme::Block(_) => self.whole_block(kept),
            Scheme::Mac(_) | Scheme::Registers(_) | Scheme::Smbus(_) => kept,
        };
        let before = self.flash.clone();
        self.flash.program(area, offset, &bytes);
        for block in offset / BLOCK..(offset + bytes.len()).div_ceil(BLOCK) {
            self.envelope.wear_out(&mut self.flash, area, block);
        }
        if self.store.save(&self.flash).is_err() {
            self.flash = before;
            self.dropped += 1;
            return;
        }
        let words = bytes.len().div_ceil(2) as u32;
        self.busy_until = self.busy_until.max(self.now) + self.timing.commit + self.timing.word * words;
        let old = Kept::new(area, offset, before.bytes_at(area, offset, bytes.len()));
        self.pending.push(Pending { old, started: self.now, ends: self.busy_until });
        wire.model().configure(&self.flash);
    }

    /// CONFIG UPDATE has ended: a gauge may have lost the block that was written first.
    pub(super) fn end_update(&mut self) {
        if let Some(Kept { area, offset, bytes }) = self.first.take()
            && self.envelope.loses(Lost::Update)
        {
            self.flash.set(area, offset, &bytes);
        }
    }

    /// The whole block around the bytes.
    fn whole_block(&self, kept: Kept) -> Kept {
        let (block, at) = (kept.offset / BLOCK, kept.offset % BLOCK);
        let mut bytes = self.flash.block(kept.area, block as u8).to_vec();
        bytes[at..at + kept.bytes.len()].copy_from_slice(&kept.bytes);
        Kept { area: kept.area, offset: block * BLOCK, bytes }
    }

    /// Applies a loss of power to a commit; nothing else decides what is left of it.
    fn tear(&mut self, old: &Kept, words: usize) {
        self.envelope.tear(&mut self.flash, old, words);
        self.save();
    }

    pub(super) fn power_down(&mut self, wire: &mut dyn Wire, back: Option<Duration>) {
        self.run(wire, self.now, true);
        self.resets_at = None;
        if let Some(pending) = self.pending.pop() {
            self.pending.clear();
            let time = self.now.saturating_sub(pending.started).saturating_sub(self.timing.commit).as_nanos();
            let words = time / self.timing.word.as_nanos().max(1);
            self.tear(&pending.old, words.min(BLOCK as u128) as usize);
        }
        self.power = Power::Off(back.map(|time| self.now + time));
    }

    pub(super) fn power_up(&mut self, wire: &mut dyn Wire) {
        self.power = Power::On;
        self.powered_at = self.now;
        self.cold = true;
        self.first = None;
        self.resets = 0;
        self.watchdog_expired = false;
        self.resets_at = None;
        self.busy_until = self.now;
        self.measured_from = self.now + self.timing.first_voltage;
        wire.model().power_up();
        self.restart(wire, self.now + self.timing.power_up);
    }

    fn expire(&mut self, wire: &mut dyn Wire) {
        self.cold = false;
        self.watchdog = Watchdog::new();
        self.watchdog_expired = true;
        self.resets = self.resets.saturating_add(1);
        self.restart(wire, self.now + self.timing.reset);
    }

    pub(super) fn reset(&mut self, wire: &mut dyn Wire) {
        self.cold = false;
        self.watchdog_expired = false;
        self.resets = self.resets.saturating_add(1);
        let at = self.now + self.timing.reset;
        if self.timing.reset_busy == Busy::Old {
            self.resets_at = Some(at);
        } else {
            self.restart(wire, at);
        }
    }

    /// Starts again, and answers from `ready_at` on.
    fn restart(&mut self, wire: &mut dyn Wire, ready_at: Duration) {
        self.ready_at = ready_at;
        if !self.envelope.first.is_zero() {
            self.measured_from = ready_at + self.envelope.first;
            wire.model().power_up();
        }
        wire.reset(self);
        wire.model().restart(&self.flash);
    }
}

/// How a part is accessed: its registers, buffer and subcommands. The [`Device`] has power, flash, timing and time, and
/// every method that needs it gets it.
pub(super) trait Wire: Send {
    /// The address that answers now, if any.
    fn address(&self, flash: &Flash) -> Option<u8>;
    /// How long a gauge that wakes up holds the clock.
    fn wake(&mut self, _device: &Device) -> Duration {
        Duration::ZERO
    }
    /// Whether the command byte `register` is acknowledged.
    fn has(&self, register: u8) -> bool;
    /// Whether a message that began at a lower register may continue with `register`.
    fn extends(&self, register: u8) -> bool;
    /// Takes a data byte. Returns whether it is acknowledged.
    fn write(&mut self, device: &mut Device, register: u8, byte: u8) -> bool;
    fn read(&mut self, device: &Device, register: u8) -> u8;
    /// A whole message of a part that has no registers; `None` on one that has. The error is that of [`Gauge::message`].
    fn packet(&mut self, _device: &Device, _write: &[u8], _read: &mut [u8]) -> Option<Result<(), usize>> {
        None
    }
    fn stop(&mut self) {}
    /// Firmware and hardware version as the documents print them.
    fn versions(&mut self, flash: &Flash) -> [Option<u16>; 2];
    /// Whether the gauge is gauging, and so may rewrite its own values.
    fn gauges(&self) -> bool {
        true
    }

    /// Rebuilds RAM after a reset or a start.
    fn reset(&mut self, device: &mut Device);
    /// Lets time pass. `settle` asks for a measurement at once.
    fn run(&mut self, device: &mut Device, settle: bool);
    /// Measures again after a knob was turned.
    fn refresh(&mut self);
    fn model(&mut self) -> &mut dyn Model;
    fn level(&self) -> Level {
        Level::Sealed
    }
    /// Goes to a level as after a host's commands.
    fn set_level(&mut self, device: &mut Device, level: Level) -> Result<()>;
    /// Makes the board fit the calibration, so that Voltage() shows the pack's voltage until the calibration changes.
    fn fit_board(&mut self, _flash: &Flash) {}
    /// Whether it takes what is written to flash now; a part without flash does not.
    fn gate(&self, _flash: &Flash) -> bool {
        false
    }

    /// The text of the `mode` knob while the gauge is on and not starting.
    fn mode(&self, _flash: &Flash) -> &'static str {
        "normal"
    }
    /// The text of a knob of this scheme, if it has that knob.
    fn knob(&self, device: &Device, name: &str) -> Option<String>;
    fn set_knob(&mut self, device: &mut Device, name: &str, text: &str) -> Result<()>;
}

/// A simulated gauge: a device and its access scheme.
pub(super) struct Gauge {
    device: Device,
    wire: Box<dyn Wire>,
    /// The next register to read or write.
    pointer: u8,
    /// The envelope's seed.
    drawn: Option<u64>,
}

impl Gauge {
    /// A gauge, drawn from the envelope if a seed is given.
    pub(super) fn new(mut device: Device, mut wire: impl Wire + 'static, envelope: Option<u64>) -> Self {
        if let Some(seed) = envelope {
            let printed = wire.versions(&device.flash);
            device.envelope = Envelope::draw(seed, device.part, printed, &mut device.timing);
        }
        Self { device, wire: Box::new(wire), pointer: 0, drawn: envelope }
    }

    pub(super) fn set_level(&mut self, level: Level) -> Result<()> {
        self.wire.set_level(&mut self.device, level)
    }

    pub(super) fn envelope(&mut self) -> String {
        let device = &mut self.device;
        let drawn = |name: &&str| Some(format!("{name} {}", device.knob_value(name)?.show()));
        let shown: Vec<String> = DRAWN.iter().filter_map(drawn).collect();
        let seed = self.drawn.map_or_else(|| "friendly".into(), |seed| format!("seed {seed}"));
        format!("{seed}: {}", shown.join(", "))
    }

    pub(super) fn nack_as(&self) -> NackAs {
        self.device.envelope.nack_as
    }

    pub(super) fn flash(&self) -> &Flash {
        &self.device.flash
    }

    pub(super) fn firmware(&self) -> Option<(Vec<[u8; 96]>, Vec<u8>)> {
        let flash = &self.device.flash;
        Some((flash.firmware.as_ref()?.rows().to_vec(), self.device.part.rom_data(flash)))
    }

    /// Puts bytes into flash without programming it.
    pub(super) fn set_flash(&mut self, area: u16, offset: usize, bytes: &[u8]) {
        self.device.flash.set(area, offset, bytes);
        self.device.save();
        self.wire.model().configure(&self.device.flash);
    }

    /// Puts bytes into flash and restarts the gauge with them: `AREA OFFSET HEX`.
    pub(super) fn put_flash(&mut self, text: &str, now: Duration) -> Result<()> {
        let bad = |why: &'static str| Error::new(FLASH, ErrorKind::Invalid, why);
        let words: Vec<&str> = text.split_whitespace().collect();
        let [area, offset, hex] = words[..] else {
            return Err(bad("not what to store; write an area, an offset and bytes, such as \"48 4 0007\""));
        };
        let number = |word: &str| match word.strip_prefix("0x") {
            Some(digits) => usize::from_str_radix(digits, 16).ok(),
            None => word.parse().ok(),
        };
        let pairs = hex.is_ascii() && hex.len() % 2 == 0;
        let bytes = (0..hex.len())
            .step_by(2)
            .filter(|_| pairs)
            .map(|at| u8::from_str_radix(&hex[at..at + 2], 16).ok());
        let bytes = bytes.collect::<Option<Vec<u8>>>().filter(|bytes| !bytes.is_empty());
        let bytes =
            bytes.ok_or_else(|| bad("not bytes; write two hexadecimal digits for each, such as 0007"))?;
        let (area, offset) = match (number(area).and_then(|area| u16::try_from(area).ok()), number(offset)) {
            (Some(area), Some(offset @ ..=0xffff)) => (area, offset),
            _ => return Err(bad("not an area and an offset; write numbers")),
        };
        if self.device.flash.bytes_at(area, offset, bytes.len()).len() != bytes.len() {
            return Err(bad("this part has no flash there"));
        }
        self.set_flash(area, offset, &bytes);
        if self.device.is_on() {
            let ready_at = self.device.ready_at.max(now);
            self.device.restart(&mut *self.wire, ready_at);
        }
        Ok(())
    }

    /// Takes the place of another gauge on its board: load, temperature, time and pending faults go on. It has had no
    /// power, and has rested, since it was taken away.
    pub(super) fn follow(&mut self, other: &mut Self, now: Duration) {
        self.device.modelled = now;
        self.power_off(now, None);
        let (device, before) = (&mut self.device, &mut other.device);
        (device.clock, device.speed) = (before.clock, before.speed);
        std::mem::swap(&mut device.plan, &mut before.plan);
        let battery = other.wire.model().battery();
        let (load_ma, ambient) = (battery.load_ma, battery.ambient);
        let wire = &mut *self.wire;
        let battery = wire.model().battery_mut();
        battery.ambient = ambient;
        battery.load_ma = load_ma;
        device.power_up(wire);
    }

    pub(super) fn speed(&self) -> f64 {
        self.device.speed
    }

    pub(super) fn commits(&self) -> u64 {
        self.device.commits
    }

    pub(super) fn plan(&mut self) -> &mut Plan {
        &mut self.device.plan
    }

    /// START and address. Returns how long the clock is held, or `None` without an acknowledgement.
    pub(super) fn start(&mut self, address: u8, now: Duration) -> Option<Duration> {
        let (device, wire) = (&mut self.device, &mut *self.wire);
        device.run(wire, now, false);
        device.quiet = now.saturating_sub(device.last_transfer);
        let starting = device.ready_at.saturating_sub(now);
        let timing = &device.timing;
        let stretches = timing.reset_busy == Busy::Stretch && (timing.power_up_stretches || !device.cold);
        let free = Duration::from_micros(device.envelope.bus_free_us.into());
        if !device.is_on()
            || wire.address(&device.flash) != Some(address)
            || !starting.is_zero() && !stretches
            || !device.last_transfer.is_zero() && device.quiet < free
        {
            return None;
        }
        device.rewrite_own(wire);
        let busy = match (device.busy_until.saturating_sub(now), device.envelope.commit_busy) {
            (busy, Busy::Nack) if !busy.is_zero() => return None,
            (busy, Busy::Stretch) => busy,
            (_, Busy::Nack | Busy::Old) => Duration::ZERO,
        };
        Some(busy.max(starting).max(wire.wake(device)))
    }

    /// The bytes of a message that ends at `now`. An error is the number of bytes sent, including the one that is not
    /// acknowledged.
    pub(super) fn message(&mut self, write: &[u8], read: &mut [u8], now: Duration) -> Result<(), usize> {
        self.device.now = now;
        if let Some(outcome) = self.wire.packet(&self.device, write, read) {
            return outcome;
        }
        if let Some((&register, data)) = write.split_first() {
            if !self.wire.has(register) {
                return Err(1);
            }
            self.pointer = register;
            for (at, &byte) in data.iter().enumerate() {
                if at > 0 && self.device.envelope.single_byte {
                    return Err(at + 2);
                }
                let extends = at == 0 || self.wire.extends(self.pointer);
                if !extends || !self.wire.write(&mut self.device, self.pointer, byte) {
                    return Err(at + 2);
                }
                self.advance();
            }
        }
        let device = &mut self.device;
        if device.envelope.watchdog && !read.is_empty() && device.watchdog.read(self.pointer, now) {
            device.expire(&mut *self.wire);
            return Err(1);
        }
        for byte in read {
            *byte = self.wire.read(&self.device, self.pointer);
            self.advance();
        }
        Ok(())
    }

    /// The pointer goes from 0x7F to 0x00 (SLUSBZ5D figure 7-6).
    fn advance(&mut self) {
        self.pointer = (self.pointer + 1) & 0x7F;
    }

    pub(super) fn stop(&mut self, now: Duration) {
        self.device.last_transfer = now;
        self.wire.stop();
    }

    pub(super) fn power_off(&mut self, now: Duration, back: Option<Duration>) {
        self.device.now = now;
        self.device.power_down(&mut *self.wire, back);
    }

    pub(super) fn has_knob(&self, knob: &Knob) -> bool {
        match (knob.of, self.device.part.scheme) {
            (Of::Bus, _)
            | (Of::Gauge, Scheme::Block(_) | Scheme::Mac(_))
            | (Of::Block, Scheme::Block(_))
            | (Of::Mac, Scheme::Mac(_)) => true,
            (Of::Gauge, Scheme::Registers(_)) => knob::OF_REGISTERS.contains(&knob.name),
            (Of::Gauge, Scheme::Smbus(_)) => knob::OF_PACKS.contains(&knob.name),
            (Of::Volts, Scheme::Registers(part)) => part.in_volts,
            (Of::Fets, Scheme::Block(part)) => part.protector.is_some(),
            (Of::Ti, scheme) => matches!(scheme, Scheme::Smbus(Some(_))),
            (Of::Smart, scheme) => matches!(scheme, Scheme::Smbus(_)),
            (Of::Block | Of::Mac | Of::Fets | Of::Volts, _) => false,
        }
    }

    pub(super) fn knob(&mut self, name: &str, now: Duration) -> Option<String> {
        let (device, wire) = (&mut self.device, &mut *self.wire);
        device.run(wire, now, true);
        if let Some(value) = device.knob_value(name) {
            return Some(value.show());
        }
        let mode = match wire.mode(&device.flash) {
            _ if !device.is_on() => "off",
            "normal" if now < device.ready_at => "reset",
            mode => mode,
        };
        let battery = wire.model().battery();
        Some(match name {
            "load_ma" => battery.load_ma.to_string(),
            "temperature" => (battery.ambient * 10.0).round().to_string(),
            "speed" => device.speed.to_string(),
            "clock" => format!("{:.3}", device.clock.as_secs_f64()),
            "soc" => format!("{:.1}", wire.model().percent()),
            "voltage_mv" => battery.forced_mv.map_or_else(|| "auto".into(), |forced| forced.to_string()),
            "power" => knob::POWER.show(device.is_on()),
            "mode" => mode.into(),
            "seal" => wire.level().show(),
            "wear" => device.flash.wear(),
            "programmed" => device.flash.programmed().to_string(),
            "dropped" => device.dropped.to_string(),
            "resets" => device.resets.to_string(),
            "state" => device.store.failure.clone().unwrap_or_else(|| "ok".into()),
            _ => return wire.knob(device, name),
        })
    }

    pub(super) fn set_knob(&mut self, name: &str, text: &str, now: Duration) -> Result<()> {
        let (device, wire) = (&mut self.device, &mut *self.wire);
        device.run(wire, now, true);
        let number = |min, max| knob::number(name, text, min, max);
        match name {
            "load_ma" => {
                let least = if wire.model().charges() { -32_000.0 } else { 0.0 };
                wire.model().battery_mut().load_ma = number(least, 32_000.0)?;
            }
            "temperature" => wire.model().battery_mut().ambient = number(-400.0, 1200.0)? / 10.0,
            "speed" => device.speed = number(0.0, 100_000.0)?,
            "soc" => wire.model().set_percent(number(0.0, 100.0)?),
            "seal" => {
                let mut level = wire.level();
                level.turn(name, text)?;
                wire.set_level(device, level)?;
            }
            "voltage_mv" => {
                let forced = if text == "auto" { None } else { Some(number(0.0, 65_535.0)? as u16) };
                wire.model().battery_mut().forced_mv = forced;
                wire.fit_board(&device.flash);
            }
            "power" => match (knob::POWER.read(name, text)?, device.is_on()) {
                (true, false) => device.power_up(wire),
                (false, true) => device.power_down(wire, None),
                (false, false) => device.power = Power::Off(None),
                (true, true) => {}
            },
            _ => match device.knob_value(name) {
                Some(value) => {
                    value.turn(name, text)?;
                    if name == "reset_every_s" {
                        device.powered_at = now;
                    }
                }
                None => wire.set_knob(device, name, text)?,
            },
        }
        wire.refresh();
        Ok(())
    }
}
