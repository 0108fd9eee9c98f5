// SPDX-License-Identifier: MIT

//! ManufacturerAccessControl: subcommands and flat data flash are reached through one word, a buffer, a sum and a
//! length (SLUUBH1C 12.1.3, SLUA790 section 3). It covers what a host can do to such a part over the bus. The part's
//! file has the model of its pack. Where data memory is RAM, it is written in FULL ACCESS between ENTER_CFG_UPDATE and
//! one of the ways out (SLUUBD4A 6.1).
//!
//! A gauge with flash is SEALED after every reset. One with RAM is UNSEALED unless its data memory says otherwise. Both
//! ignore refused commands silently, and echo a refused word above the previous answer.

use std::time::Duration;

use super::analog::Thermistor;
use super::device::{Device, Gauge, Wire};
use super::envelope::{Early, First, Lost, Uncommitted};
use super::flash::{BLOCK, Flash};
use super::flat::{DATA_FLASH, PRIVATE, i16_at, u8_at, u16_at};
use super::knob::{self, KnobValue};
use super::model::{Kept, MacModel, Model, Registers, Reply, whole};
use super::options::Options;
use super::part::{MacMemory, MacPart, Part, Scale};
use super::rom::ROM_ADDRESS;
use super::seal::{Level, Seal};
use super::update::{Exit, Mode};
use super::window::checksum;
use gauge_bus::GAUGE_ADDRESS;
use gauge_bus::error::{Error, ErrorKind, Result};

/// Owners' parts had some addresses one lower than printed, but not the first ones (E2E 668766 and 834655). No source
/// has the address where that begins.
const SHIFTED: u16 = 0x4100;
/// Its answer includes the seal state.
const OPERATION_STATUS: u16 = 0x0054;
/// A larger word that is no subcommand counts as one of a key.
const LAST_SUBCOMMAND: u16 = 0x00FF;
/// MACDataLen() also counts the word, the sum and itself.
const OVERHEAD: usize = 4;
const ENTER_CALIBRATION: u16 = 0x0081;
const ENTER_UPDATE: u16 = 0x0090;
const EXIT_UPDATE_ANEW: u16 = 0x0091;
const EXIT_UPDATE: u16 = 0x0092;
/// Control() of a bq34110 reads this once after DEVICE_TYPE or FW_VERSION.
const ANSWERED_ELSEWHERE: u16 = 0xFFA5;
const TEMPERATURE: u8 = 0x06;
const FULL_CHARGE_CAPACITY: u8 = 0x12;

/// MACData(), MACDataSum() and MACDataLen() as the host reads them.
#[derive(Clone, Copy)]
struct Answer {
    data: [u8; BLOCK],
    sum: u8,
    length: u8,
}

impl Default for Answer {
    fn default() -> Self {
        Self::new(0, &[])
    }
}

impl Answer {
    fn new(word: u16, bytes: &[u8]) -> Self {
        let mut data = [0; BLOCK];
        data[..bytes.len()].copy_from_slice(bytes);
        Self { data, sum: sum(word, bytes), length: (bytes.len() + OVERHEAD) as u8 }
    }
}

fn sum(word: u16, data: &[u8]) -> u8 {
    let [low, high] = word.to_le_bytes();
    checksum(data).wrapping_sub(low).wrapping_sub(high)
}

/// The buffer is separate from flash: after a write the host reads it back, whether anything was stored or not.
#[derive(Default)]
struct Buffer {
    shown: Answer,
    /// Its bytes, as they were loaded or committed.
    loaded: [u8; BLOCK],
    /// An answer in preparation, and its time. It overwrites what the host writes before.
    coming: Option<(Answer, Duration)>,
    /// The sum, until the length is written.
    sum_sent: Option<u8>,
}

impl Buffer {
    fn settle(&mut self, now: Duration) {
        if let Some((answer, _)) = self.coming.take_if(|(_, ready)| now >= *ready) {
            self.show(answer);
        }
    }

    fn show(&mut self, answer: Answer) {
        self.loaded = answer.data;
        self.shown = answer;
    }
}

impl MacPart {
    fn scale(&self, flash: &Flash) -> Option<Scale> {
        let (divider, (byte, bit)) = self.divider?;
        Some(Scale { divider: u16_at(flash, divider), external: u8_at(flash, byte) & bit != 0 })
    }

    /// The level after a start.
    fn level(&self, flash: &Flash) -> Level {
        match &self.data_memory {
            Some(MacMemory { default_seal: (address, bit), .. })
                if flash.u8(DATA_FLASH, usize::from(address - self.base)) & bit == 0 =>
            {
                Level::Unsealed
            }
            Some(_) | None => Level::Sealed,
        }
    }
}

pub(super) struct Mac {
    part: &'static MacPart,
    model: Box<dyn MacModel>,
    ram: Ram,
    board: Option<Scale>,
    /// How many bytes lower than in the manual this specimen has its data flash.
    shift: u16,
    thermistor: Thermistor,
    /// The full charge capacity does not follow data memory.
    keeps_full: bool,
    before: Registers,
}

#[derive(Default)]
struct Ram {
    seal: Seal,
    buffer: Buffer,
    echo: u16,
    /// Low bytes of Control() and ManufacturerAccessControl() that wait for their high bytes.
    low: [u8; 2],
    previous: u16,
    /// The word came with this message.
    selecting: bool,
    /// Control() shows 0xFFA5, in this message or the next.
    elsewhere: bool,
    elsewhere_seen: bool,
    update: Mode,
    /// This message has read from 0x3E on, and whether it has read the length.
    reads: Option<bool>,
    /// The next read from 0x3E shows the following block.
    advance: bool,
    /// The boot loader runs. Only a loss of power is known to end it.
    rom: bool,
    registers: Option<Registers>,
}

impl Mac {
    #[inline(never)] // A gauge as a value is large; those of all schemes are not to be on the stack together.
    pub(super) fn gauge(
        part: &'static Part,
        scheme: &'static MacPart,
        options: &Options,
        now: Duration,
    ) -> Result<Gauge> {
        let device = Device::new(part, options, now, |flash| {
            if let Some(words) = options.unseal_key {
                let (area, offset) = scheme.keys;
                flash.set(area, offset, words.map(u16::to_be_bytes).as_flattened());
            }
        })?;
        let model = (scheme.model)(&device.flash);
        let board = scheme.scale(&device.flash);
        let ram = Ram { seal: Seal::new(scheme.level(&device.flash)), ..Ram::default() };
        let (shift, thermistor, keeps_full, before) = (0, Thermistor::In, false, [0; 0x80]);
        let mac = Self { part: scheme, model, ram, board, shift, thermistor, keeps_full, before };
        Ok(Gauge::new(device, mac, options.envelope))
    }

    fn sealed(&self) -> bool {
        self.ram.seal.level == Level::Sealed
    }

    /// Puts what the thermistor shows into Temperature(), if the gauge uses it.
    fn sense(&self, flash: &Flash, registers: &mut Registers) {
        let chosen = |(address, bit)| flash.u8(DATA_FLASH, usize::from(address - self.part.base)) & bit != 0;
        if self.part.thermistor.is_none_or(chosen) {
            let at = usize::from(TEMPERATURE);
            let sensed = u16::from_le_bytes([registers[at], registers[at + 1]]);
            let shown = whole(self.thermistor.shows(sensed.into()));
            registers[at..at + 2].copy_from_slice(&shown.to_le_bytes());
        }
    }

    /// Seals, and empties the buffer.
    fn close(&mut self, now: Duration) {
        self.ram.seal.change(Level::Sealed, now);
        self.ram.buffer = Buffer::default();
    }

    fn voltage_mv(&self, flash: &Flash) -> u16 {
        let voltage_mv = self.model.battery().forced_mv.unwrap_or_else(|| self.model.voltage_mv());
        let scales = self.part.scale(flash).zip(self.board);
        scales.map_or(voltage_mv, |(scale, board)| scale.shows(board, voltage_mv))
    }

    /// The offset in data flash that a word addresses in this specimen.
    fn locate(&self, flash: &Flash, word: u16) -> Option<usize> {
        let size = flash.size(DATA_FLASH);
        let at = word.checked_sub(self.part.base).map(usize::from).filter(|&at| at < size)?;
        let shift = if word < SHIFTED { 0 } else { usize::from(self.shift) };
        Some(at + shift).filter(|&at| at < size)
    }

    fn end_update(&mut self, device: &mut Device, exit: Exit) {
        device.end_update();
        if exit == Exit::Anew {
            self.model.restart(&device.flash);
        }
        self.ram.registers = None;
    }

    /// Acts on the length, written after the sum. Both have to be right.
    fn commit(&mut self, device: &mut Device, told: u8, length: u8) {
        let count = usize::from(length).saturating_sub(OVERHEAD);
        if !(1..=BLOCK).contains(&count) {
            return;
        }
        let (word, level) = (self.ram.echo, self.ram.seal.level);
        let bytes = &self.ram.buffer.shown.data[..count];
        if told != sum(word, bytes) {
            return;
        }
        let Some(offset) = self.locate(&device.flash, word) else {
            let kept = self.model.parameters(word, bytes, level);
            device.keep(self, kept);
            return;
        };
        if offset + count > device.flash.size(DATA_FLASH) {
            return;
        }
        let (area, keys) = self.part.keys;
        let of_keys = area == DATA_FLASH && offset < keys + 8 && keys < offset + count;
        let allowed = match level {
            Level::Sealed => false,
            Level::Unsealed => !of_keys && self.part.data_memory.is_none(),
            Level::FullAccess => self.part.data_memory.is_none() || matches!(self.ram.update, Mode::On(_)),
        };
        let kept = Kept::new(DATA_FLASH, offset, bytes);
        device.commit(self, kept, allowed);
    }

    /// Acts on a word in Control() or ManufacturerAccessControl(). An unknown word, or one that a sealed gauge refuses,
    /// is echoed and does nothing.
    fn word(&mut self, device: &mut Device, word: u16) {
        self.ram.echo = word;
        self.ram.advance = false;
        self.ram.buffer.sum_sent = None;
        let stored: [u8; 8] = device.flash.get(self.part.keys.0, self.part.keys.1);
        let key = |at: usize| u16::from_be_bytes([stored[at], stored[at + 1]]);
        let keys = [[key(0), key(2)], [key(4), key(6)]];
        // The first word ends the silence, the second follows it.
        let listening = device.hears_keys(&self.ram.seal);
        let before = self.ram.seal;
        if self.ram.seal.word(word, &keys, listening, device.now) {
            if device.loses(Lost::Key) {
                self.ram.seal = before.after_refusal();
            }
            return;
        }
        // The second word was wrong.
        self.ram.seal.refused |= before.is_half() && !self.ram.seal.is_half();
        let open = !self.sealed();
        if let Some(at) = self.locate(&device.flash, word) {
            if open {
                let flash = device.loadable();
                let bytes = flash.bytes_at(DATA_FLASH, at, BLOCK.min(flash.size(DATA_FLASH) - at));
                self.answer(device, word, bytes, device.envelope.delay(DATA_FLASH, at / BLOCK));
            }
            return;
        }
        // A delayed status shows the old level.
        let level = if word == OPERATION_STATUS { self.shown_level(device) } else { self.ram.seal.level };
        self.ram.elsewhere |= self.part.answers_elsewhere && matches!(word, 0x0001 | 0x0002);
        match word {
            0x0000 => {}
            0x0007 => self.answer(device, word, &self.ram.previous.to_le_bytes(), Duration::ZERO),
            _ if word == self.part.reset && open && device.loses(Lost::Reset) => {}
            _ if word == self.part.reset && open => {
                device.reset(self);
                return;
            }
            0x0F00 if open => self.ram.rom = true,
            ENTER_UPDATE | EXIT_UPDATE_ANEW | EXIT_UPDATE if self.part.data_memory.is_some() => {
                let (timing, full) = (&device.timing, level == Level::FullAccess);
                match word {
                    ENTER_UPDATE if full => self.ram.update.enter(timing.update_enter, device.now),
                    EXIT_UPDATE_ANEW if open => {
                        self.ram.update.leave(Exit::Anew, timing.update_leave, device.now);
                    }
                    EXIT_UPDATE if open => {
                        self.ram.update.leave(Exit::Plain, timing.update_leave, device.now);
                    }
                    _ => {}
                }
            }
            ENTER_CALIBRATION if device.envelope.cal_enable && !self.model.may_calibrate() => {}
            _ if word == self.part.seal => {
                if open && !device.loses(Lost::Seal) {
                    self.close(device.now);
                }
            }
            _ => match self.model.subcommand(word, level, &device.flash) {
                Some(Reply::Answer(mut bytes)) => {
                    if let Some(version) = device.envelope.version(word) {
                        set_version(word, &mut bytes, version);
                    }
                    self.answer(device, word, &bytes, device.envelope.delay(DATA_FLASH, usize::from(word)));
                }
                Some(Reply::Keep(kept)) => device.keep(self, kept),
                Some(Reply::Done) => {}
                // Almost all subcommands are lower, so this was a key.
                None => self.ram.seal.refused |= word > LAST_SUBCOMMAND,
            },
        }
        self.ram.previous = word;
        if self.gauges() {
            self.ram.registers = None;
        }
    }

    /// Shows the following block, if a whole one was read since it was selected.
    fn advance(&mut self, device: &Device) {
        if !std::mem::take(&mut self.ram.advance) || self.sealed() {
            return;
        }
        let next = self.ram.echo.wrapping_add(BLOCK as u16);
        if self.locate(&device.flash, self.ram.echo).is_none() {
            return;
        }
        if let Some(at) = self.locate(&device.flash, next) {
            let length = BLOCK.min(device.flash.size(DATA_FLASH) - at);
            self.ram.echo = next;
            self.ram.buffer.show(Answer::new(next, device.flash.bytes_at(DATA_FLASH, at, length)));
        }
    }

    /// Prepares an answer, `late` longer than others.
    fn answer(&mut self, device: &Device, word: u16, bytes: &[u8], late: Duration) {
        let ready = device.now + device.timing.load + late;
        self.ram.buffer.coming = Some((Answer::new(word, bytes), ready));
        if device.envelope.early == Early::Blank {
            self.ram.buffer.show(Answer::new(word, &[0; BLOCK]));
        }
        self.ram.buffer.settle(device.now);
    }

    fn control_status(&self, device: &Device) -> u16 {
        self.model.control_status(self.shown_level(device)) & !self.hidden(device, 0)
    }

    /// The bit of a register that is clear before the first measurement.
    fn hidden(&self, device: &Device, register: u8) -> u16 {
        let (shown, bit) = self.part.initialized;
        if shown == register && (device.unmeasured() || device.envelope.no_initcomp) { bit } else { 0 }
    }

    /// A byte of the word with the level and CONFIG UPDATE, which stays right while gauging stops.
    fn update_status(&self, device: &Device, register: u8) -> Option<u8> {
        let (first, bit) = self.part.data_memory.as_ref()?.shows;
        let at = usize::from(register.checked_sub(first)?);
        let shown = self.model.registers(self.shown_level(device), 0);
        let low = usize::from(first);
        let word = u16::from_le_bytes([shown[low], shown[low + 1]]);
        let mode = if self.ram.update.shows() { bit } else { 0 };
        ((word | mode) & !self.hidden(device, first)).to_le_bytes().get(at).copied()
    }

    fn shown_level(&self, device: &Device) -> Level {
        self.ram.seal.shown(device.envelope.status, device.now)
    }

    /// The registers, partly wrong before the first measurement.
    fn measure(&self, device: &Device) -> Registers {
        let unmeasured = device.unmeasured();
        let voltage_mv = if unmeasured { 0 } else { self.voltage_mv(&device.flash) };
        let mut registers = self.model.registers(self.shown_level(device), voltage_mv);
        self.sense(&device.flash, &mut registers);
        let never = device.envelope.no_initcomp && self.part.initialized != (0, 0);
        for &first in self.part.predicted.iter().filter(|_| unmeasured || never) {
            for at in [first, first + 1] {
                registers[usize::from(at)] = match device.envelope.first_values {
                    First::Old => self.before[usize::from(at)],
                    First::Nonsense => device.envelope.nonsense(at),
                };
            }
        }
        registers
    }
}

/// Puts a version in an answer: FW_VERSION has device, version and build, HW_VERSION is one word.
fn set_version(word: u16, bytes: &mut [u8], version: u16) {
    match word {
        0x0002 => bytes[2..4].copy_from_slice(&version.to_be_bytes()),
        _ => bytes[..2].copy_from_slice(&version.to_le_bytes()),
    }
}

impl Wire for Mac {
    fn address(&self, _: &Flash) -> Option<u8> {
        Some(if self.ram.rom { ROM_ADDRESS } else { GAUGE_ADDRESS })
    }

    fn has(&self, register: u8) -> bool {
        register < 0x80
    }

    fn extends(&self, register: u8) -> bool {
        matches!(register, 0x01 | 0x07 | 0x3F..=0x61)
    }

    fn write(&mut self, device: &mut Device, register: u8, byte: u8) -> bool {
        if self.ram.rom {
            return true;
        }
        let buffer = &mut self.ram.buffer;
        buffer.settle(device.now);
        match register {
            0x00 => self.ram.low[0] = byte,
            0x01 => self.word(device, u16::from_le_bytes([self.ram.low[0], byte])),
            0x3E => self.ram.low[1] = byte,
            0x3F => {
                self.word(device, u16::from_le_bytes([self.ram.low[1], byte]));
                self.ram.selecting = true;
            }
            0x40..=0x5F => {
                // Data in the word's own message follows the block.
                if self.ram.selecting {
                    buffer.settle(Duration::MAX);
                }
                buffer.sum_sent = None;
                buffer.shown.data[usize::from(register - 0x40)] = byte;
            }
            0x60 => {
                // The gauge works in order: the block overwrites what came before it.
                buffer.settle(Duration::MAX);
                buffer.shown.sum = byte;
                buffer.sum_sent = Some(byte);
            }
            0x61 => {
                buffer.shown.length = byte;
                if let Some(told) = buffer.sum_sent.take() {
                    buffer.loaded = buffer.shown.data;
                    self.commit(device, told, byte);
                }
            }
            _ => return self.model.write(register, byte),
        }
        true
    }

    fn read(&mut self, device: &Device, register: u8) -> u8 {
        if self.ram.rom {
            return 0;
        }
        self.ram.buffer.settle(device.now);
        match register {
            0x3E => {
                self.advance(device);
                self.ram.reads = Some(false);
            }
            0x61 => self.ram.reads = self.ram.reads.map(|_| true),
            _ => {}
        }
        let Buffer { shown, loaded, .. } = &self.ram.buffer;
        match register {
            0x00 | 0x01 => {
                self.ram.elsewhere_seen |= self.ram.elsewhere;
                let word = if self.ram.elsewhere { ANSWERED_ELSEWHERE } else { self.control_status(device) };
                word.to_le_bytes()[usize::from(register)]
            }
            0x3E | 0x3F => self.ram.echo.to_le_bytes()[usize::from(register - 0x3E)],
            0x40..=0x5F if device.envelope.uncommitted == Uncommitted::Stored => {
                loaded[usize::from(register - 0x40)]
            }
            0x40..=0x5F => shown.data[usize::from(register - 0x40)],
            0x60 => shown.sum,
            0x61 => shown.length,
            _ => {
                let registers = self.ram.registers.unwrap_or_else(|| self.measure(device));
                self.ram.registers = Some(registers);
                let byte = registers.get(usize::from(register)).copied().unwrap_or(0);
                self.model.seen(register);
                self.update_status(device, register).unwrap_or(byte)
            }
        }
    }

    fn stop(&mut self) {
        self.ram.selecting = false;
        self.ram.advance |= self.part.advances && self.ram.reads.take() == Some(true);
        self.ram.elsewhere &= !self.ram.elsewhere_seen;
        self.ram.elsewhere_seen = false;
    }

    fn versions(&mut self, flash: &Flash) -> [Option<u16>; 2] {
        let mut answer = |word| match self.model.subcommand(word, Level::Sealed, flash) {
            Some(Reply::Answer(bytes)) => Some(bytes),
            _ => None,
        };
        let firmware =
            answer(0x0002).and_then(|bytes| Some(u16::from_be_bytes(bytes.get(2..4)?.try_into().ok()?)));
        let hardware =
            answer(0x0003).and_then(|bytes| Some(u16::from_le_bytes(bytes.get(..2)?.try_into().ok()?)));
        [firmware, hardware]
    }

    fn gauges(&self) -> bool {
        !self.ram.rom && !self.ram.update.shows()
    }

    fn reset(&mut self, device: &mut Device) {
        self.before = self.model.registers(self.ram.seal.level, self.voltage_mv(&device.flash));
        self.model.battery_mut().is_kept = false;
        if self.part.data_memory.is_some() {
            device.flash.reload(device.part.image, PRIVATE);
            device.save();
        }
        self.ram = Ram { seal: Seal::new(self.part.level(&device.flash)), ..Ram::default() };
    }

    fn run(&mut self, device: &mut Device, settle: bool) {
        self.model.battery_mut().is_kept = self.keeps_full;
        if device.is_on()
            && let Some((exit, at)) = self.ram.update.run(device.now)
        {
            let now = std::mem::replace(&mut device.now, at);
            device.pass(self, true);
            self.end_update(device, exit);
            device.now = now;
        }
        if self.gauges() {
            self.ram.registers = None;
        }
        device.pass(self, settle);
    }

    fn refresh(&mut self) {
        self.ram.registers = None;
    }

    fn model(&mut self) -> &mut dyn Model {
        &mut *self.model
    }

    fn level(&self) -> Level {
        self.ram.seal.level
    }

    fn set_level(&mut self, device: &mut Device, level: Level) -> Result<()> {
        match level {
            Level::Sealed => self.close(device.now),
            Level::Unsealed | Level::FullAccess => self.ram.seal.change(level, device.now),
        }
        Ok(())
    }

    fn gate(&self, flash: &Flash) -> bool {
        let little = self.part.is_little;
        let word =
            |address| if little { i16_at(flash, address).swap_bytes() } else { i16_at(flash, address) };
        let limit = self.part.gate.map(|address| i32::from(word(address)));
        limit.is_none_or(|limit| i32::from(self.voltage_mv(flash)) >= limit)
    }

    fn fit_board(&mut self, flash: &Flash) {
        self.board = self.part.scale(flash);
    }

    fn mode(&self, _: &Flash) -> &'static str {
        match () {
            () if self.ram.rom => "rom",
            () if self.model.calibrating() => "calibration",
            () if self.ram.update.shows() => "config-update",
            () => "normal",
        }
    }

    fn knob(&self, _: &Device, name: &str) -> Option<String> {
        Some(match name {
            "df_shift" => self.shift.to_string(),
            "cell_mohm" => (self.model.battery().ohms * 1000.0).to_string(),
            "thermistor" => self.thermistor.show(),
            "keeps_full" => self.keeps_full.show(),
            _ => return None,
        })
    }

    fn set_knob(&mut self, _: &mut Device, name: &str, text: &str) -> Result<()> {
        match name {
            "cell_mohm" => {
                self.model.battery_mut().ohms = knob::number(name, text, 1.0, 10_000.0)? / 1000.0;
            }
            "thermistor" => self.thermistor.turn(name, text)?,
            "keeps_full" => {
                let mut keeps = self.keeps_full;
                keeps.turn(name, text)?;
                if keeps && !self.part.predicted.contains(&FULL_CHARGE_CAPACITY) {
                    let why = "the part has no FullChargeCapacity()";
                    return Err(Error::new(name, ErrorKind::NotPermitted, why));
                }
                self.keeps_full = keeps;
                self.model.battery_mut().is_kept = keeps;
            }
            _ => self.shift = knob::number(name, text, 0.0, 1.0)? as u16,
        }
        Ok(())
    }
}
