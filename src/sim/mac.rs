//! ManufacturerAccessControl: a flash gauge whose subcommands and flat data flash are reached through one
//! word, a buffer, a sum and a length (SLUUBH1C 12.1.3, SLUA790 section 3). What a host can do to a bq34110
//! or a bq35100 over the bus is here; what each makes of its pack is in the part's own file.
//!
//! Where the documents leave a choice, the gauge does what is worst for a driver: it is sealed after every
//! reset, what it refuses it refuses silently, and a refused word is echoed above the answer before it.

use std::time::Duration;

use super::battery::Battery;
use super::fault::{Inside, Plan};
use super::flash::{BLOCK, Flash, Image, Store};
use super::seal::{Level, Seal};
use super::window::checksum;
use super::{Chip, Options, knob};
use crate::bus::GAUGE_ADDRESS;
use crate::error::Result;

/// Data flash has the addresses 0x4000 to 0x43FF (SLUUBH1C 12.1.3).
const BASE: u16 = 0x4000;
pub(super) const SIZE: usize = 0x400;
/// The areas of the image: data flash, and what a part keeps where no document at hand says.
pub(super) const DATA_FLASH: u16 = 0;
pub(super) const PRIVATE: u16 = 1;
pub(super) const REGISTERS: usize = 0x80;
/// 0 degrees Celsius in 0.1 K.
pub(super) const FREEZING: f64 = 2731.0;
/// Owners' parts had some addresses one lower than printed, though not the first ones (E2E 668766 and
/// 834655); from where on is not known.
const SHIFTED: u16 = 0x4100;
/// What MACDataLen() counts beside the data: the word, the sum and itself.
const OVERHEAD: usize = 4;
/// Where a gauge in ROM mode answers.
const ROM_ADDRESS: u8 = 0x0B;
/// Programming a word of flash, as in the bq34z100-G1 (SLUSBZ5D 6.12).
const WORD: Duration = Duration::from_millis(2);
/// An owner's full-access key was refused right after the unseal key and taken after a pause (E2E 888302);
/// TI advises 4 s of silence.
const FULL_ACCESS_QUIET: Duration = Duration::from_secs(4);
/// What Control() of a bq34110 reads once after DEVICE_TYPE or FW_VERSION.
const ANSWERED_ELSEWHERE: u16 = 0xFFA5;
/// Measuring an offset, in seconds of the gauge's time.
const OFFSET_S: f64 = 4.0;

/// What makes one such part.
pub(super) struct Part {
    pub(super) name: &'static str,
    pub(super) image: Image,
    /// The address of Flash Update OK Voltage.
    pub(super) gate: u16,
    /// Area and offset of the keys: four words in the order in which they are sent.
    pub(super) keys: (u16, usize),
    /// The subcommand that seals.
    pub(super) seal: u16,
    /// From power or RESET to the first answer, and whether the gauge holds the clock until then.
    pub(super) boot: Duration,
    pub(super) boot_stretches: bool,
    /// Control() reads 0xFFA5 once after DEVICE_TYPE or FW_VERSION.
    pub(super) answers_elsewhere: bool,
    pub(super) model: fn(&Flash) -> Box<dyn Model>,
}

/// Bytes for an area and offset of flash.
pub(super) type Kept = (u16, usize, Vec<u8>);

/// What a subcommand does beside changing the model.
#[derive(Default)]
pub(super) struct Reply {
    /// What it answers with; without any, the buffer stays as it was.
    pub(super) answer: Option<Vec<u8>>,
    pub(super) kept: Vec<Kept>,
}

impl Reply {
    pub(super) fn word(word: u16) -> Option<Self> {
        Self::bytes(&word.to_le_bytes())
    }

    pub(super) fn bytes(bytes: &[u8]) -> Option<Self> {
        Some(Self { answer: Some(bytes.to_vec()), kept: Vec::new() })
    }

    pub(super) fn done() -> Option<Self> {
        Some(Self::default())
    }
}

/// The measuring half of a part.
pub(super) trait Model: Send {
    fn battery(&self) -> &Battery;
    fn battery_mut(&mut self) -> &mut Battery;
    /// RAM is built anew; the pack goes on.
    fn restart(&mut self, flash: &Flash);
    /// Flash has changed.
    fn configure(&mut self, flash: &Flash);
    /// Lets some seconds pass, few against everything modelled; what is to be kept in flash.
    fn step(&mut self, seconds: f64) -> Vec<Kept>;
    /// The pack's voltage as Voltage() shows it.
    fn voltage_mv(&self) -> u16;
    fn percent(&self) -> f64;
    fn set_percent(&mut self, percent: f64);
    fn calibrating(&self) -> bool;
    fn control_status(&self, level: Level) -> u16;
    /// What can be read at 0x00 to 0x7F; the host's own registers are left 0.
    fn registers(&self, level: Level, voltage_mv: u16) -> [u8; REGISTERS];
    /// A subcommand; `None` for one that the part does not take at this level.
    fn subcommand(&mut self, word: u16, level: Level, flash: &Flash) -> Option<Reply>;
    /// Data committed to a subcommand rather than to an address; what to keep of it.
    fn parameters(&mut self, _word: u16, _data: &[u8], _level: Level) -> Vec<Kept> {
        Vec::new()
    }
    /// A standard command is written; whether it is acknowledged.
    fn write(&mut self, _register: u8, _byte: u8) -> bool {
        false
    }
    /// A register has been read.
    fn seen(&mut self, _register: u8) {}
    /// Whether the pack can be charged.
    fn charges(&self) -> bool;
}

/// Offset calibration, which both parts have.
#[derive(Default)]
pub(super) struct Calibration {
    board_s: f64,
    cc_s: f64,
    pub(super) enabled: bool,
    pub(super) mode: bool,
    /// AnalogCount() or Cal_Count().
    pub(super) count: u8,
    part_s: f64,
}

impl Calibration {
    pub(super) fn board_running(&self) -> bool {
        self.board_s > 0.0
    }

    pub(super) fn cc_running(&self) -> bool {
        self.cc_s > 0.0
    }

    /// BOARD_OFFSET measures the offset of the counter first.
    pub(super) fn board_offset(&mut self) {
        (self.board_s, self.cc_s) = (OFFSET_S, OFFSET_S);
    }

    pub(super) fn cc_offset(&mut self) {
        self.cc_s = OFFSET_S;
    }

    pub(super) fn save() -> Kept {
        (DATA_FLASH, offset(0x4008), (-1180i16).to_be_bytes().to_vec())
    }

    /// `current_ma` is taken for offset.
    pub(super) fn step(&mut self, seconds: f64, current_ma: f64) -> Option<Kept> {
        self.part_s += seconds;
        if self.part_s >= 1.0 {
            self.count = self.count.wrapping_add(self.part_s as u8);
            self.part_s = self.part_s.fract();
        }
        self.cc_s = (self.cc_s - seconds).max(0.0);
        if !self.board_running() {
            return None;
        }
        self.board_s = (self.board_s - seconds).max(0.0);
        let measured = (current_ma * 4.0).round().clamp(-128.0, 127.0) as i8;
        (!self.board_running()).then(|| (DATA_FLASH, offset(0x400C), vec![measured as u8]))
    }
}

/// A whole data flash with the given bytes at their addresses, and 0 elsewhere.
pub(super) const fn image(rows: &[(u16, &[u8])]) -> [u8; SIZE] {
    let mut out = [0; SIZE];
    let mut row = 0;
    while row < rows.len() {
        let (address, bytes) = rows[row];
        let mut at = 0;
        while at < bytes.len() {
            out[(address - BASE) as usize + at] = bytes[at];
            at += 1;
        }
        row += 1;
    }
    out
}

/// Where an address stands in the area.
pub(super) const fn offset(address: u16) -> usize {
    (address - BASE) as usize
}

pub(super) fn u8_at(flash: &Flash, address: u16) -> u8 {
    flash.u8(DATA_FLASH, offset(address))
}

pub(super) fn u16_at(flash: &Flash, address: u16) -> u16 {
    flash.u16(DATA_FLASH, offset(address))
}

pub(super) fn i16_at(flash: &Flash, address: u16) -> i16 {
    flash.i16(DATA_FLASH, offset(address))
}

pub(super) fn whole(value: f64) -> u16 {
    value.round().clamp(0.0, 65535.0) as u16
}

pub(super) fn signed(value: f64) -> u16 {
    value.round().clamp(-32768.0, 32767.0) as i16 as u16
}

/// MACData(), MACDataSum() and MACDataLen() as the host reads them.
#[derive(Clone, Copy)]
struct Answer {
    data: [u8; BLOCK],
    sum: u8,
    length: u8,
}

impl Answer {
    fn new(word: u16, bytes: &[u8]) -> Self {
        let mut data = [0; BLOCK];
        data[..bytes.len()].copy_from_slice(bytes);
        Self { data, sum: sum(word, bytes), length: (bytes.len() + OVERHEAD) as u8 }
    }
}

/// The complement of the sum of the word and the data.
fn sum(word: u16, data: &[u8]) -> u8 {
    let [low, high] = word.to_le_bytes();
    checksum(data).wrapping_sub(low).wrapping_sub(high)
}

/// The buffer, kept apart from flash: what a host reads there after writing is this, whether or not
/// anything was stored.
struct Buffer {
    shown: Answer,
    /// An answer that is still being fetched, and until when. What a host writes meanwhile is lost to it.
    coming: Option<(Answer, Duration)>,
    /// The sum has been written and the length has not.
    sum_sent: Option<u8>,
}

impl Buffer {
    fn new() -> Self {
        Self {
            shown: Answer { data: [0; BLOCK], sum: 0xFF, length: OVERHEAD as u8 },
            coming: None,
            sum_sent: None,
        }
    }

    fn settle(&mut self, now: Duration) {
        if let Some((answer, _)) = self.coming.filter(|(_, ready)| now >= *ready) {
            self.shown = answer;
            self.coming = None;
        }
    }
}

/// What a loss of power would tear.
struct Pending {
    area: u16,
    offset: usize,
    old: Vec<u8>,
    started: Duration,
}

enum Power {
    On,
    Off { until: Option<Duration> },
}

/// Settings of the simulation.
struct Manner {
    speed: f64,
    boot_stretches: bool,
    load: Duration,
    word: Duration,
    key_quiet: Duration,
    /// How many bytes lower this part has its data flash than the manual.
    shift: u16,
}

/// The gauge.
pub(super) struct Gauge {
    part: &'static Part,
    flash: Flash,
    store: Store,
    manner: Manner,
    power: Power,
    /// Until when it starts, and holds the clock.
    booting_until: Duration,
    busy_until: Duration,
    rom: bool,
    model: Box<dyn Model>,
    /// Up to when the model has been run.
    modelled: Duration,
    forced_mv: Option<u16>,
    seal: Seal,
    buffer: Buffer,
    /// ManufacturerAccessControl() as it is read back.
    echo: u16,
    low: [u8; 2],
    /// The word came with this message.
    selecting: bool,
    /// Control() has 0xFFA5 to show, and shows it in this message.
    elsewhere: bool,
    elsewhere_seen: bool,
    previous: u16,
    resets: u16,
    last_transfer: Duration,
    quiet: Duration,
    pending: Option<Pending>,
    dropped: u64,
    registers: Option<[u8; REGISTERS]>,
}

impl Gauge {
    pub(super) fn new(part: &'static Part, options: &Options, now: Duration) -> Result<Self> {
        let mut flash = Flash::new(part.image);
        let mut store = Store::new(options.state.clone(), part.name);
        if !store.load(&mut flash)? {
            if let Some([first, second]) = options.unseal_key {
                let bytes = [first.to_be_bytes(), second.to_be_bytes()].concat();
                flash.preset(part.keys.0, part.keys.1, &bytes);
            }
            store.save(&flash)?;
        }
        Ok(Self {
            part,
            model: (part.model)(&flash),
            flash,
            store,
            manner: Manner {
                speed: 1.0,
                boot_stretches: part.boot_stretches,
                load: Duration::ZERO,
                word: WORD,
                key_quiet: Duration::ZERO,
                shift: 0,
            },
            power: Power::On,
            booting_until: now,
            busy_until: now,
            rom: false,
            modelled: now,
            forced_mv: None,
            seal: Seal::new(Level::Sealed),
            buffer: Buffer::new(),
            echo: 0,
            low: [0; 2],
            selecting: false,
            elsewhere: false,
            elsewhere_seen: false,
            previous: 0,
            resets: 0,
            last_transfer: Duration::ZERO,
            quiet: Duration::MAX,
            pending: None,
            dropped: 0,
            registers: None,
        })
    }

    /// Brings everything that goes by time up to `now`. Measurements are made once a second of the gauge's
    /// time; `settle` makes one at once.
    fn run(&mut self, now: Duration, settle: bool) {
        if let Power::Off { until: Some(until) } = self.power
            && now >= until
        {
            self.power_up(until);
        }
        if self.pending.is_some() && now >= self.busy_until {
            self.pending = None;
        }
        self.registers = None;
        let seconds = now.saturating_sub(self.modelled).as_secs_f64() * self.manner.speed;
        if seconds < 1.0 && !settle && self.manner.speed > 0.0 {
            return;
        }
        self.modelled = now;
        let mut left = seconds;
        while left > 0.0 {
            // A pack at rest changes in ways that are exact over any time; a long run is coarser.
            let step = match self.model.battery().current_ma() {
                0.0 => left.min(60.0_f64.max(left / 100.0)),
                _ => left.min((seconds / 3600.0).clamp(1.0, 15.0)),
            };
            let kept = self.model.step(step);
            if matches!(self.power, Power::On) {
                self.keep(kept, now);
            }
            left -= step;
        }
    }

    fn power_down(&mut self, now: Duration, back: Option<Duration>) {
        self.run(now, true);
        if let Some(pending) = self.pending.take() {
            let programmed =
                now.saturating_sub(pending.started).as_nanos() / self.manner.word.as_nanos().max(1);
            self.tear(&pending, 2 * programmed.min(BLOCK as u128) as usize);
        }
        self.power = Power::Off { until: back.map(|time| now + time) };
    }

    /// Leaves the first `count` bytes of what was being programmed new and the rest as it was.
    fn tear(&mut self, pending: &Pending, count: usize) {
        let count = count.min(pending.old.len());
        self.flash.preset(pending.area, pending.offset + count, &pending.old[count..]);
        // A file that cannot be written is reported by the `state` knob.
        let _ = self.store.save(&self.flash);
    }

    fn power_up(&mut self, now: Duration) {
        self.power = Power::On;
        self.rom = false;
        self.restart(now);
        self.resets = 0;
    }

    /// RAM is built anew.
    fn restart(&mut self, now: Duration) {
        self.model.restart(&self.flash);
        self.seal = Seal::new(Level::Sealed);
        self.buffer = Buffer::new();
        (self.echo, self.previous, self.elsewhere) = (0, 0, false);
        self.booting_until = now + self.part.boot;
        self.busy_until = now;
        self.registers = None;
    }

    fn sealed(&self) -> bool {
        self.seal.level == Level::Sealed
    }

    fn voltage_mv(&self) -> u16 {
        self.forced_mv.unwrap_or_else(|| self.model.voltage_mv())
    }

    /// Whether flash may be programmed.
    fn gate(&self) -> bool {
        i32::from(self.voltage_mv()) >= i32::from(i16_at(&self.flash, self.part.gate))
    }

    /// Something the gauge itself keeps.
    fn keep(&mut self, kept: Vec<Kept>, now: Duration) {
        for (area, offset, bytes) in kept {
            if self.gate() {
                self.program(area, offset, &bytes, now);
            }
        }
    }

    /// Programs bytes; a state file that cannot be written is as bad as flash that cannot.
    fn program(&mut self, area: u16, offset: usize, bytes: &[u8], now: Duration) {
        let before = self.flash.clone();
        let mut old = Vec::with_capacity(bytes.len());
        let (start, end) = (offset / BLOCK, (offset + bytes.len() - 1) / BLOCK);
        for block in start..=end {
            let mut content = self.flash.block(area, block as u8).to_vec();
            for (at, byte) in content.iter_mut().enumerate() {
                let found = (block * BLOCK + at).checked_sub(offset).and_then(|at| bytes.get(at));
                if let Some(&new) = found {
                    old.push(*byte);
                    *byte = new;
                }
            }
            self.flash.program(area, block as u8, &content);
        }
        if self.store.save(&self.flash).is_err() {
            self.flash = before;
            self.dropped += 1;
            return;
        }
        self.busy_until = self.busy_until.max(now) + self.manner.word * bytes.len().div_ceil(2) as u32;
        self.pending = Some(Pending { area, offset, old, started: now });
        self.model.configure(&self.flash);
    }

    /// The place in data flash that a word addresses in this part.
    fn locate(&self, word: u16) -> Option<usize> {
        let at = word.checked_sub(BASE).map(usize::from).filter(|&at| at < SIZE)?;
        let shift = if word < SHIFTED { 0 } else { usize::from(self.manner.shift) };
        Some(at + shift).filter(|&at| at < SIZE)
    }

    /// The length has been written after the sum: both have to verify.
    fn commit(&mut self, told: u8, length: u8, plan: &mut Plan, now: Duration) {
        let Some(count) =
            usize::from(length).checked_sub(OVERHEAD).filter(|count| (1..=BLOCK).contains(count))
        else {
            return;
        };
        let word = self.echo;
        let mut bytes = self.buffer.shown.data[..count].to_vec();
        if told != sum(word, &bytes) {
            return;
        }
        let Some(offset) = self.locate(word) else {
            let kept = self.model.parameters(word, &bytes, self.seal.level);
            self.keep(kept, now);
            return;
        };
        if offset + count > SIZE {
            return;
        }
        let fault = plan.commit();
        let (area, keys) = self.part.keys;
        let of_keys = area == DATA_FLASH && offset < keys + 8 && keys < offset + count;
        let allowed = match self.seal.level {
            Level::Sealed => false,
            Level::Unsealed => !of_keys,
            Level::FullAccess => true,
        };
        if !allowed || !self.gate() || fault == Some(Inside::DropCommit) {
            self.dropped += 1;
            return;
        }
        if fault == Some(Inside::CorruptCommit) {
            let at = (0..count).find(|at| bytes[*at] != self.flash.u8(DATA_FLASH, offset + at)).unwrap_or(0);
            bytes[at] ^= 0x01;
        }
        self.program(DATA_FLASH, offset, &bytes, now);
        if let Some(Inside::TornCommit(words)) = fault
            && let Some(pending) = self.pending.take()
        {
            self.tear(&pending, 2 * words);
            self.power = Power::Off { until: None };
        }
    }

    /// A word written to Control() or ManufacturerAccessControl(). What is not for a sealed gauge, or
    /// unknown, is echoed and does nothing.
    fn word(&mut self, word: u16, now: Duration) {
        self.echo = word;
        self.buffer.sum_sent = None;
        let stored: [u8; 8] = self.flash.get(self.part.keys.0, self.part.keys.1);
        let key = |at: usize| u16::from_be_bytes([stored[at], stored[at + 1]]);
        let keys = [[key(0), key(2)], [key(4), key(6)]];
        let quiet = match self.seal.level {
            Level::Unsealed => self.manner.key_quiet.max(FULL_ACCESS_QUIET),
            Level::Sealed | Level::FullAccess => self.manner.key_quiet,
        };
        // The first word ends the silence, the second follows it.
        if self.seal.word(word, &keys, self.quiet >= quiet, now) {
            return;
        }
        let open = !self.sealed();
        if let Some(at) = self.locate(word) {
            if open {
                let end = SIZE.min(at + BLOCK);
                let bytes = self.flash.bytes()[at..end].to_vec();
                self.answer(word, &bytes, now);
            }
            return;
        }
        self.elsewhere |= self.part.answers_elsewhere && matches!(word, 0x0001 | 0x0002);
        match word {
            0x0000 => {}
            0x0007 => self.answer(word, &self.previous.to_le_bytes(), now),
            0x0041 if open => {
                self.restart(now);
                self.resets = self.resets.saturating_add(1);
                return;
            }
            0x0F00 if open => self.rom = true,
            _ if word == self.part.seal => {
                if open {
                    self.seal = Seal::new(Level::Sealed);
                    self.buffer = Buffer::new();
                }
            }
            _ => {
                if let Some(reply) = self.model.subcommand(word, self.seal.level, &self.flash) {
                    if let Some(bytes) = reply.answer {
                        self.answer(word, &bytes, now);
                    }
                    self.keep(reply.kept, now);
                }
            }
        }
        self.previous = word;
        self.registers = None;
    }

    fn answer(&mut self, word: u16, bytes: &[u8], now: Duration) {
        self.buffer.coming = Some((Answer::new(word, bytes), now + self.manner.load));
        self.buffer.settle(now);
    }
}

impl Chip for Gauge {
    fn start(&mut self, address: u8, now: Duration) -> Option<Duration> {
        self.run(now, false);
        self.quiet = now.saturating_sub(self.last_transfer);
        self.selecting = false;
        let here = if self.rom { ROM_ADDRESS } else { GAUGE_ADDRESS };
        if !matches!(self.power, Power::On) || address != here {
            return None;
        }
        let wait = self.busy_until.saturating_sub(now);
        let booting = self.booting_until.saturating_sub(now);
        if !booting.is_zero() && !self.manner.boot_stretches {
            return None;
        }
        Some(wait.max(booting))
    }

    fn has(&self, register: u8) -> bool {
        register < 0x80
    }

    fn extends(&self, register: u8) -> bool {
        matches!(register, 0x01 | 0x07 | 0x3F..=0x61)
    }

    fn write(&mut self, register: u8, byte: u8, plan: &mut Plan, now: Duration) -> bool {
        // Of the boot loader nothing is known but that power ends it.
        if self.rom {
            return true;
        }
        self.buffer.settle(now);
        match register {
            0x00 => self.low[0] = byte,
            0x01 => self.word(u16::from_le_bytes([self.low[0], byte]), now),
            0x3E => self.low[1] = byte,
            0x3F => {
                self.word(u16::from_le_bytes([self.low[1], byte]), now);
                self.selecting = true;
            }
            0x40..=0x5F => {
                // Data in the word's own message is taken after the block has been fetched.
                if self.selecting {
                    self.buffer.settle(Duration::MAX);
                }
                self.buffer.sum_sent = None;
                self.buffer.shown.data[usize::from(register - 0x40)] = byte;
            }
            0x60 => {
                // The gauge does one thing after the other: what came before the block is overwritten by it.
                self.buffer.settle(Duration::MAX);
                self.buffer.shown.sum = byte;
                self.buffer.sum_sent = Some(byte);
            }
            0x61 => {
                self.buffer.shown.length = byte;
                if let Some(told) = self.buffer.sum_sent.take() {
                    self.commit(told, byte, plan, now);
                }
            }
            _ => return self.model.write(register, byte),
        }
        true
    }

    fn read(&mut self, register: u8, now: Duration) -> u8 {
        if self.rom {
            return 0;
        }
        self.buffer.settle(now);
        match register {
            0x00 | 0x01 => {
                self.elsewhere_seen |= self.elsewhere;
                let word = if self.elsewhere {
                    ANSWERED_ELSEWHERE
                } else {
                    self.model.control_status(self.seal.level)
                };
                word.to_le_bytes()[usize::from(register)]
            }
            0x3E | 0x3F => self.echo.to_le_bytes()[usize::from(register - 0x3E)],
            0x40..=0x5F => self.buffer.shown.data[usize::from(register - 0x40)],
            0x60 => self.buffer.shown.sum,
            0x61 => self.buffer.shown.length,
            _ => {
                let (model, level, voltage_mv) = (&self.model, self.seal.level, self.voltage_mv());
                let registers = self.registers.get_or_insert_with(|| model.registers(level, voltage_mv));
                let byte = registers[usize::from(register) % REGISTERS];
                self.model.seen(register);
                byte
            }
        }
    }

    fn stop(&mut self, now: Duration) {
        self.last_transfer = now;
        self.elsewhere &= !self.elsewhere_seen;
        self.elsewhere_seen = false;
    }

    fn power_off(&mut self, now: Duration, back: Option<Duration>) {
        self.power_down(now, back);
    }

    fn flash(&self) -> &Flash {
        &self.flash
    }

    fn knob(&mut self, name: &str, now: Duration) -> Option<String> {
        self.run(now, true);
        let battery = self.model.battery();
        let milliseconds = |time: Duration| time.as_millis().to_string();
        let on = matches!(self.power, Power::On);
        Some(match name {
            "load_ma" => format!("{}", battery.load_ma),
            "temperature" => format!("{}", (battery.ambient * 10.0).round()),
            "speed" => format!("{}", self.manner.speed),
            "soc" => format!("{:.1}", self.model.percent()),
            "voltage_mv" => self.forced_mv.map_or_else(|| "auto".into(), |forced| forced.to_string()),
            "power" => if on { "on" } else { "off" }.into(),
            "mode" => match () {
                () if !on => "off",
                () if self.rom => "rom",
                () if now < self.booting_until => "reset",
                () if self.model.calibrating() => "calibration",
                () => "normal",
            }
            .into(),
            "seal" => self.seal.level.as_str().into(),
            "wear" => self.flash.wear(),
            "programmed" => self.flash.programmed().to_string(),
            "dropped" => self.dropped.to_string(),
            "resets" => self.resets.to_string(),
            "state" => self.store.failure.clone().unwrap_or_else(|| "ok".into()),
            "reset_busy" => if self.manner.boot_stretches { "stretch" } else { "nack" }.into(),
            "load_ms" => milliseconds(self.manner.load),
            "word_ms" => milliseconds(self.manner.word),
            "key_quiet_ms" => milliseconds(self.manner.key_quiet),
            "df_shift" => self.manner.shift.to_string(),
            _ => return None,
        })
    }

    fn set_knob(&mut self, name: &str, text: &str, now: Duration) -> Result<()> {
        self.run(now, true);
        let milliseconds =
            || knob::number(name, text, 0.0, 60_000.0).map(|ms| Duration::from_millis(ms as u64));
        match name {
            "load_ma" => {
                // Nobody charges a primary cell.
                let least = if self.model.charges() { -32_000.0 } else { 0.0 };
                self.model.battery_mut().load_ma = knob::number(name, text, least, 32_000.0)?;
            }
            "temperature" => {
                self.model.battery_mut().ambient = knob::number(name, text, -400.0, 1200.0)? / 10.0;
            }
            "speed" => self.manner.speed = knob::number(name, text, 0.0, 100_000.0)?,
            "soc" => {
                let percent = knob::number(name, text, 0.0, 100.0)?;
                self.model.set_percent(percent);
            }
            "voltage_mv" => {
                self.forced_mv = match text {
                    "auto" => None,
                    _ => Some(knob::number(name, text, 0.0, 65_535.0)? as u16),
                };
            }
            "power" => match (knob::choice(name, text, &["off", "on"])?, &self.power) {
                (0, Power::On) => self.power_down(now, None),
                (0, Power::Off { .. }) => self.power = Power::Off { until: None },
                (_, Power::Off { .. }) => self.power_up(now),
                (_, Power::On) => {}
            },
            "reset_busy" => {
                self.manner.boot_stretches = knob::choice(name, text, &["nack", "stretch"])? == 1;
            }
            "load_ms" => self.manner.load = milliseconds()?,
            "word_ms" => self.manner.word = milliseconds()?,
            "key_quiet_ms" => self.manner.key_quiet = milliseconds()?,
            "df_shift" => self.manner.shift = knob::number(name, text, 0.0, 1.0)? as u16,
            _ => return Err(knob::read_only(name)),
        }
        self.registers = None;
        Ok(())
    }
}
