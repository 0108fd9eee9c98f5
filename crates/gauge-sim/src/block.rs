// SPDX-License-Identifier: MIT

//! Block access: data flash is reached unsealed through class, block, window and checksum (SLUSBZ5D 7.3.3). It covers
//! all that a host can do over the bus to the parts with flash, and to those with RAM (SLUUAC9A), which differ in when
//! the checksum counts. [`BlockPart`] describes the differences between parts.
//!
//! A gauge with flash is SEALED after every reset. One with RAM is UNSEALED unless its data memory says otherwise. Both
//! ignore refused commands silently.

use std::mem;
use std::time::Duration;

use sha1::{Digest, Sha1};

use super::analog::{BOARD_COUNTS, CC_COUNTS};
use super::device::{Device, Gauge, Wire};
use super::envelope::{Early, First, Lost};
use super::flash::{BLOCK, Flash};
use super::gauging::Gauging;
use super::knob::{self, KnobValue};
use super::model::{Host, Place};
use super::model::{Kept, Model, Registers, bits};
use super::options::Options;
use super::part::{Action, BlockPart, Detection, Flag, Part, Scale, Status};
use super::protector::Fets;
use super::rom::ROM_ADDRESS;
use super::rom::{Boot, Effect};
use super::seal::{self, Level, Seal};
use super::update::{Exit, Mode};
use super::window::{Before, Source, Window, checksum};
use gauge_bus::GAUGE_ADDRESS;
use gauge_bus::error::{Error, ErrorKind, Result};

const CODES: u16 = 112;
/// While a self-sealed gauge refuses keys, a subcommand above this one restarts that time (SLUUAC9A 6.4.5.1.1).
const LOCKING: u16 = 0x001A;
/// Bit of Update Status.
const IT_ENABLE: u8 = 0x04;
/// Bits of Flags() of the parts with RAM.
const ITPOR: u16 = 0x0020;
const CFGUPMODE: u16 = 0x0010;
const BAT_DET: u16 = 0x0008;

pub(super) struct Block {
    part: &'static BlockPart,
    gauging: Gauging,
    ram: Ram,
    board: Option<Scale>,
    board_offset: i8,
    cc_offset: i16,
    /// A sealed gauge acknowledges registers whose values it withholds.
    ignores_sealed: bool,
    is_away: bool,
    /// Challenge and digest go most significant byte first.
    as_sent: bool,
    before: Registers,
    fets: Fets,
}

#[derive(Default)]
struct Ram {
    seal: Seal,
    window: Window,
    /// The low byte of a word, until the high byte is written.
    low: u8,
    answer: u16,
    previous: u16,
    marks: Vec<Status>,
    rom: Option<Boot>,
    full_sleep: bool,
    /// CAL_ENABLE was sent.
    calibration: bool,
    board_until: Option<Duration>,
    offset_until: Option<Duration>,
    update: Mode,
    locked_until: Duration,
    /// SEALED was sent since the last start.
    was_sealed: bool,
    /// BAT_INSERT was sent after the last BAT_REMOVE.
    inserted: bool,
    initialized_from: Duration,
    chemistry: Option<u16>,
    registers: Option<Registers>,
}

impl Ram {
    /// The gauge accepts keys from `ready` on, and predicts from `initialized` on.
    fn new(part: &BlockPart, flash: &Flash, ready: Duration, initialized: Duration) -> Self {
        Self {
            seal: Seal::new(part.level(flash)),
            window: Window::new(part.authentication.is_some()),
            calibration: is_set(flash, part.own.calibration),
            locked_until: ready,
            initialized_from: initialized,
            rom: flash.firmware.as_ref().and_then(|firmware| (!firmware.is_marked()).then(Boot::default)),
            ..Self::default()
        }
    }
}

impl BlockPart {
    /// The level after a start. A gauge with RAM reads it from data memory.
    fn level(&self, flash: &Flash) -> Level {
        match self.data_memory.as_ref().map(|memory| memory.seals) {
            Some((id, offset, bit)) if flash.u8(id, offset) & bit == 0 => Level::Unsealed,
            Some(_) | None => Level::Sealed,
        }
    }

    fn gain_sign(&self) -> Option<Place> {
        self.data_memory.as_ref().and_then(|memory| memory.gain_sign)
    }

    fn scale(&self, flash: &Flash) -> Option<Scale> {
        let ((id, offset), external) = self.gate.as_ref()?.divider?;
        Some(Scale { divider: flash.u16(id, offset), external: is_set(flash, Some(external)) })
    }

    /// Gives CC Gain the sign that this specimen's ROM has.
    fn set_gain_sign(&self, flash: &mut Flash) {
        if let Some((id, offset)) = self.gain_sign() {
            let byte = flash.u8(id, offset) & 0x7F | u8::from(flash.inverted) << 7;
            flash.set(id, offset, &[byte]);
        }
    }

    /// Stores whether a gauge with RAM was sealed.
    fn remember_seal(&self, flash: &mut Flash, sealed: bool) {
        if let Some((id, offset, bit)) = self.data_memory.as_ref().map(|memory| memory.seals) {
            let byte = flash.u8(id, offset) & !bit;
            flash.set(id, offset, &[if sealed { byte | bit } else { byte }]);
        }
    }

    /// Whether a pin detects the battery; BAT_INSERT then has no effect.
    fn has_pin(&self, flash: &Flash) -> bool {
        match self.detection {
            Detection::None => false,
            Detection::Pin => true,
            Detection::PinIf(id, offset, bit) => flash.u8(id, offset) & bit != 0,
        }
    }

    fn host_register(&self, register: u8) -> Option<Host> {
        let found = self.host_registers.iter().find(|(at, _)| register & !1 == *at);
        found.map(|&(_, host)| host)
    }
}

fn is_set(flash: &Flash, place: Option<Flag>) -> bool {
    place.is_some_and(|(id, offset, bit)| flash.u16(id, offset) & bit != 0)
}

impl Block {
    #[inline(never)] // A gauge as a value is large; those of all schemes are not to be on the stack together.
    pub(super) fn gauge(
        part: &'static Part,
        scheme: &'static BlockPart,
        options: &Options,
        now: Duration,
    ) -> Result<Gauge> {
        let device = Device::new(part, options, now, |flash| {
            if let Some(words) = options.unseal_key {
                flash.set(CODES, scheme.keys[0], &seal::stored(words));
            }
        })?;
        let block = Self {
            part: scheme,
            gauging: Gauging::new(&scheme.map, &device.flash, 60.0),
            ram: Ram::new(scheme, &device.flash, now, now),
            board: scheme.scale(&device.flash),
            // Offsets differ slightly between specimens.
            board_offset: (options.seed % 17) as i8 - 8,
            cc_offset: -1200 + (options.seed % 101) as i16 - 50,
            ignores_sealed: false,
            is_away: false,
            as_sent: false,
            before: [0; 0x80],
            fets: Fets::default(),
        };
        Ok(Gauge::new(device, block, options.envelope))
    }

    /// Whether broken firmware keeps the gauge silent for good.
    fn is_dead(&self, flash: &Flash) -> bool {
        match (&self.ram.rom, &flash.firmware) {
            (Some(boot), _) => boot.ruined,
            (None, Some(firmware)) => !firmware.is_sound(),
            (None, None) => false,
        }
    }

    fn sealed(&self) -> bool {
        self.ram.seal.level == Level::Sealed
    }

    /// Seals, and closes what was open.
    fn close(&mut self, now: Duration) {
        self.ram.seal.change(Level::Sealed, now);
        self.ram.window = Window::new(self.part.authentication.is_some());
    }

    fn end_update(&mut self, device: &mut Device, exit: Exit) {
        // The bit by which it seals itself is its own, and stays.
        let seals = self.part.level(&device.flash) == Level::Sealed;
        device.end_update();
        self.part.remember_seal(&mut device.flash, seals);
        match exit {
            Exit::Anew => self.gauging.load(&device.flash),
            Exit::Plain | Exit::Forgotten => self.gauging.apply(&device.flash),
        }
        if exit != Exit::Forgotten {
            device.flash.itpor = false;
        }
        self.ram.registers = None;
        if seals || device.envelope.reseals && self.ram.was_sealed {
            self.close(device.now);
            self.ram.locked_until = device.now + device.timing.lock;
        }
        device.save();
    }

    /// The bits of Flags() that do not concern gauging.
    fn own_flags(&self, flash: &Flash) -> u16 {
        let (ram, detects) = (self.part.data_memory.is_some(), self.part.detection != Detection::None);
        bits(&[
            (ITPOR, ram && flash.itpor),
            (CFGUPMODE, ram && self.ram.update.shows()),
            (BAT_DET, detects && self.present(flash)),
        ])
    }

    /// Whether a pin, or the host, has told the gauge of a battery.
    fn present(&self, flash: &Flash) -> bool {
        self.ram.inserted
            || self.part.detection == Detection::None
            || self.part.has_pin(flash) && !self.is_away
    }

    fn voltage(&self, flash: &Flash) -> u16 {
        let voltage_mv = self.gauging.voltage_mv();
        let scales = self.part.scale(flash).zip(self.board);
        scales.map_or(voltage_mv, |(scale, board)| scale.shows(board, voltage_mv))
    }

    fn protect(&mut self, device: &Device) {
        let Some(part) = &self.part.protector else { return };
        match device.is_on() {
            true => {
                let (flash, gauging) = (&device.flash, &self.gauging);
                self.fets.run(part, flash, device.now, gauging.voltage_mv(), gauging.temperature());
            }
            false => self.fets.lose_power(),
        }
    }

    /// Stores a value of the gauge's own.
    fn store(&mut self, device: &mut Device, place: Option<Place>, bytes: &[u8]) {
        if let Some((id, offset)) = place {
            device.keep(self, vec![Kept::new(id, offset, bytes)]);
        }
    }

    fn commit(&mut self, device: &mut Device, sum: u8) {
        let window = &mut self.ram.window;
        let Source::Flash(id, block) = window.source else { return };
        if sum != checksum(&window.data) {
            return;
        }
        window.commit(sum);
        let mut content = window.bytes().to_vec();
        if id == CODES && self.ram.seal.level != Level::FullAccess {
            // Keys change in FULL ACCESS only (SLUSBZ5D 7.3.3.4), here the authentication key too. A part without that
            // level has its keys in ROM (SLUUAC9A 6.4.5.1.1).
            for &at in self.part.keys {
                content[at..at + 4].copy_from_slice(&device.flash.get::<4>(id, at));
            }
        }
        let taken = self.part.data_memory.is_none() || matches!(self.ram.update, Mode::On(_));
        let allowed = taken && (!self.sealed() || self.part.sealed_writes == Some(id));
        device.commit(self, Kept::new(id, usize::from(block) * BLOCK, &content), allowed);
    }

    fn select(&mut self, device: &Device, block: u8) {
        let special = self.sealed() || self.ram.window.control == 0x01;
        let window = &mut self.ram.window;
        window.block = block;
        let (source, wait) = match block {
            _ if !special => (Source::Flash(u16::from(window.class), block), device.timing.load),
            0 if self.part.authentication.is_some() => (Source::Authentication, device.timing.load),
            _ => {
                let class = self.part.sealed_blocks.iter().find(|(shown, _)| *shown == block);
                let source = class.map_or(Source::Nothing, |&(_, class)| Source::Flash(class, 0));
                (source, device.timing.sealed_load)
            }
        };
        let flash = device.loadable();
        let (bytes, late) = match source {
            Source::Flash(id, block) => (flash.block(id, block), device.envelope.delay(id, block.into())),
            Source::Nothing | Source::Authentication => (&[][..], Duration::ZERO),
        };
        let source = if bytes.is_empty() && !special { Source::Nothing } else { source };
        let early = match device.envelope.early {
            _ if special => Before::Zeros,
            Early::Blank => Before::Blank,
            Early::Previous => Before::Same,
        };
        window.load(source, bytes, early, device.now + wait + late);
    }

    /// Answers a challenge with SHA-1 of the key and SHA-1 of key and challenge (SLUSBZ5D 7.3.15). Least significant
    /// byte first, unless set otherwise: no document settles the order.
    fn authenticate(&mut self, device: &Device, sum: u8) {
        let mut message = self.ram.window.data[..20].to_vec();
        if sum != checksum(&message) {
            return;
        }
        let Some((id, offset)) = self.part.authentication else { return };
        let key = device.flash.get::<16>(id, offset);
        if !self.as_sent {
            message.reverse();
        }
        let inner = Sha1::new().chain_update(key).chain_update(&message).finalize();
        let mut digest = Sha1::new().chain_update(key).chain_update(inner).finalize();
        if !self.as_sent {
            digest.reverse();
        }
        let ready = device.now + device.timing.authentication;
        self.ram.window.load(Source::Authentication, &digest, Before::Same, ready);
    }

    fn shown_level(&self, device: &Device) -> Level {
        self.ram.seal.shown(device.envelope.status, device.now)
    }

    /// Whether predictions are right, as far as the part shows it.
    fn predicts(&self, device: &Device) -> bool {
        let shown = self.part.status.iter().any(|(status, _)| *status == Status::Initialized);
        let initialized = !shown || device.modelled >= self.ram.initialized_from;
        let never = shown && device.envelope.no_initcomp;
        !never && (device.envelope.first.is_zero() || initialized && !device.unmeasured())
    }

    fn is(&self, device: &Device, status: Status) -> bool {
        let (own, flash) = (&self.part.own, &device.flash);
        match status {
            Status::NotFullAccess => self.shown_level(device) != Level::FullAccess,
            Status::Sealed => self.shown_level(device) == Level::Sealed,
            Status::CcOffset => self.ram.offset_until.is_some(),
            Status::BoardOffset => self.ram.board_until.is_some(),
            Status::Initialized => {
                let is_over = device.modelled >= self.ram.initialized_from;
                self.present(flash) && is_over && !device.envelope.no_initcomp
            }
            Status::WatchdogReset => device.watchdog_expired,
            Status::Sleep => own.sleep.is_some_and(|(allowed, (id, offset))| {
                let current = f64::from(flash.i16(id, offset));
                is_set(flash, Some(allowed)) && self.gauging.is_quiet(current)
            }),
            Status::LoadMode => own.load_mode.is_some_and(|(id, offset)| flash.u8(id, offset) != 0),
            Status::Enabled => self.gauging.ram.enabled,
            Status::VoltageOk => self.gauging.ram.enabled && self.gauging.ram.learning.voltage_ok(),
            Status::RaOff => self.gauging.ram.enabled && self.gauging.ram.learning.ra_off,
            Status::ChemistryChanged => self.ram.chemistry.is_some(),
            Status::Calibrating
            | Status::ChecksumValid
            | Status::DataLog
            | Status::Hibernate
            | Status::OcvDone
            | Status::ShutdownArmed
            | Status::Snooze => self.ram.marks.contains(&status),
        }
    }

    fn mark(&mut self, status: Status, set: bool) {
        self.ram.marks.retain(|mark| *mark != status);
        if set {
            self.ram.marks.push(status);
        }
    }

    fn control_status(&self, device: &Device) -> u16 {
        let set = self.part.status.iter().filter(|(status, _)| self.is(device, *status));
        set.fold(0, |word, (_, bit)| word | bit)
    }

    /// Acts on a word in Control(). An unknown word, or one that a sealed gauge refuses, does nothing.
    fn subcommand(&mut self, device: &mut Device, word: u16) {
        let now = device.now;
        let keys = self.part.keys.iter().map(|&at| seal::words(device.flash.get(CODES, at)));
        let keys: Vec<_> = keys.collect();
        let locked = now < self.ram.locked_until;
        if locked && word > LOCKING {
            self.ram.locked_until = now + device.timing.lock;
        }
        let listening = device.hears_keys(&self.ram.seal) && !locked;
        let before = self.ram.seal;
        if self.ram.seal.word(word, &keys, listening, now) {
            if device.loses(Lost::Key) {
                self.ram.seal = before;
                self.refuse(device);
            }
            return;
        }
        let known = self.part.subcommands.iter().find(|(code, _, _)| *code == word);
        // A wrong second word, or no known command.
        let open = self.ram.seal.level == Level::FullAccess || keys.len() == 1 && !self.sealed();
        if !open && !self.ram.seal.is_half() && (before.is_half() || known.is_none() && word > LOCKING) {
            self.refuse(device);
        }
        if let Some(&(_, least, action)) = known
            && self.ram.seal.level >= least
        {
            self.act(device, action);
            if let (Action::Answer(_), Some(version)) = (action, device.envelope.version(word)) {
                self.ram.answer = version;
            }
        }
        if word < self.part.remembered {
            self.ram.previous = word;
        }
    }

    /// Refuses a key.
    fn refuse(&mut self, device: &Device) {
        self.ram.seal = self.ram.seal.after_refusal();
        if self.part.data_memory.is_some() && device.envelope.key_lock {
            self.ram.locked_until = device.now + device.timing.lock;
        }
    }

    fn act(&mut self, device: &mut Device, action: Action) {
        let (own, now) = (&self.part.own, device.now);
        match action {
            Action::ControlStatus => self.ram.answer = self.control_status(device),
            Action::Answer(word) => self.ram.answer = word,
            Action::AnswerCode => self.ram.answer = self.part.code,
            Action::AnswerFrom(id, offset) => self.ram.answer = device.flash.u16(id, offset),
            Action::AnswerChemistry(word) => self.ram.answer = self.ram.chemistry.unwrap_or(word),
            Action::ResetData => self.ram.answer = device.resets,
            Action::Previous => self.ram.answer = self.ram.previous,
            Action::BoardOffset => self.measure_board_offset(device),
            Action::CcOffset => self.ram.offset_until = Some(now + device.timing.calibrating),
            Action::WriteCcOffset => {
                self.store(device, own.cc_offset, &self.cc_offset.to_be_bytes());
                self.gauging.take_offsets(&device.flash);
            }
            Action::AnswerOffset if self.is(device, Status::Calibrating) => {
                self.ram.answer = own.cc_offset.map_or(0, |(id, offset)| device.flash.u16(id, offset));
            }
            Action::FlashChecksum => {
                let bytes = device.flash.bytes();
                self.ram.answer = bytes.iter().fold(0u16, |sum, &byte| sum.wrapping_add(byte.into()));
                self.mark(Status::ChecksumValid, true);
            }
            Action::ChemistryChecksum => {
                let block = own.chemistry.map_or(&[][..], |id| device.flash.block(id, 0));
                self.ram.answer = block.iter().map(|&byte| u16::from(byte)).sum::<u16>() & 0x7FFF;
                self.mark(Status::ChecksumValid, true);
            }
            Action::FullSleep => self.ram.full_sleep = true,
            Action::Set(status) => self.mark(status, true),
            Action::Clear(status) => self.mark(status, false),
            Action::BatteryInsert(inserted) if !self.part.has_pin(&device.flash) => {
                if inserted && !self.ram.inserted {
                    self.ram.initialized_from = now + device.timing.initializing;
                }
                self.ram.inserted = inserted;
            }
            Action::Seal if device.loses(Lost::Seal) => {}
            Action::Seal => {
                if self.part.data_memory.is_some() {
                    self.ram.was_sealed = true;
                    self.part.remember_seal(&mut device.flash, true);
                    device.save();
                }
                self.close(now);
            }
            Action::ItEnable => {
                if let Some((id, offset)) = own.update_status {
                    let status = device.flash.u8(id, offset) | IT_ENABLE;
                    self.store(device, own.update_status, &[status]);
                }
                self.gauging.enable();
            }
            Action::ItDisable => self.gauging.ram.enabled = false,
            Action::CalEnable => self.ram.calibration = !self.ram.calibration,
            Action::ExitCalibration if self.ram.calibration => self.mark(Status::Calibrating, false),
            Action::EnterCalibration if self.ram.calibration => self.mark(Status::Calibrating, true),
            Action::Reset if device.loses(Lost::Reset) => {}
            Action::Reset => self.obey_reset(device),
            Action::OpenFets(why) => self.fets.open(why),
            Action::ProtectorChecksum => self.ram.answer = self.protector_sum(device),
            Action::ConfigUpdate => self.ram.update.enter(device.timing.update_enter, now),
            Action::Leave(exit) => self.ram.update.leave(exit, device.timing.update_leave, now),
            Action::Chemistry(id) if matches!(self.ram.update, Mode::On(_)) => self.ram.chemistry = Some(id),
            Action::Shutdown if self.is(device, Status::ShutdownArmed) => device.power_down(self, None),
            Action::Rom => self.ram.rom = Some(Boot::default()),
            Action::Hdq => {
                device.flash.hdq = true;
                device.save();
            }
            Action::AnswerOffset
            | Action::BatteryInsert(_)
            | Action::ExitCalibration
            | Action::EnterCalibration
            | Action::Chemistry(_)
            | Action::Shutdown => {}
        }
    }

    fn protector_sum(&self, device: &Device) -> u16 {
        self.part.protector.as_ref().map_or(0, |part| part.answer(&device.flash))
    }

    fn obey_reset(&mut self, device: &mut Device) {
        self.fets.open("reset");
        device.reset(self);
    }

    /// A current that flows meanwhile counts as offset.
    fn measure_board_offset(&mut self, device: &Device) {
        let current = self.gauging.battery().current_ma() as i64;
        self.board_offset = (current * 4 + i64::from(self.board_offset)).clamp(-128, 127) as i8;
        self.ram.board_until = Some(device.now + device.timing.calibrating);
    }

    fn write_rom(&mut self, device: &mut Device, register: u8, byte: u8) {
        // The boot loader takes data flash as it is when a command starts.
        let data = if register == 0x65 { device.part.rom_data(&device.flash) } else { Vec::new() };
        let effect = match (&mut self.ram.rom, &mut device.flash.firmware) {
            (Some(boot), Some(firmware)) => boot.write(firmware, &data, register, byte, device.now),
            _ => None,
        };
        self.affect(device, effect);
        if register == 0x65 {
            device.save();
        }
    }

    /// Applies an effect of the boot loader to the gauge.
    fn affect(&mut self, device: &mut Device, effect: Option<Effect>) {
        match effect {
            Some(Effect::Data(parts)) => {
                let mut data = device.part.rom_data(&device.flash);
                for (at, bytes) in parts {
                    data[at..at + bytes.len()].copy_from_slice(&bytes);
                }
                device.part.set_rom_data(&mut device.flash, data);
            }
            Some(Effect::Leave) => device.power_up(self),
            None => {}
        }
    }

    /// Takes a byte of a word that the host may write. The second byte completes it.
    fn write_host(&mut self, register: u8, byte: u8) {
        if register & 1 == 0 {
            self.ram.low = byte;
            return;
        }
        let word = u16::from_le_bytes([self.ram.low, byte]);
        if let Some(host) = self.part.host_register(register) {
            self.gauging.write(host, word);
        }
        self.ram.registers = None;
    }

    /// Whether a sealed gauge refuses writes to a register that is otherwise writable.
    fn withheld(&self, register: u8) -> bool {
        let ram = self.part.data_memory.is_some();
        self.sealed()
            && (matches!(register, 0x3E | 0x61 | 0x55..=0x5F) || ram && matches!(register, 0x3F..=0x60))
    }

    fn writable(&self, register: u8) -> bool {
        let known =
            matches!(register, 0x00 | 0x01 | 0x3E..=0x61) || self.part.host_register(register).is_some();
        known && !self.withheld(register)
    }
}

impl Wire for Block {
    fn address(&self, flash: &Flash) -> Option<u8> {
        match &self.ram.rom {
            _ if flash.hdq || self.is_dead(flash) => None,
            Some(_) => Some(ROM_ADDRESS),
            None => Some(GAUGE_ADDRESS),
        }
    }

    fn wake(&mut self, device: &Device) -> Duration {
        let settle = self.part.own.settle.map_or(0, |(id, offset)| device.flash.u8(id, offset));
        let settle = Duration::from_secs(u64::from(settle).max(1));
        let asleep = mem::take(&mut self.ram.full_sleep);
        let sleeps = asleep && device.quiet >= settle && self.is(device, Status::Sleep);
        if sleeps { device.timing.waking } else { Duration::ZERO }
    }

    fn has(&self, register: u8) -> bool {
        register <= self.part.last_register
    }

    fn extends(&self, register: u8) -> bool {
        // Other registers refuse a second byte in one message (SLUSBZ5D figure 7-5).
        self.ram.rom.is_some()
            || matches!(register, 0x01 | 0x3F | 0x41..=0x5F)
            || register & 1 == 1 && self.part.host_register(register).is_some()
    }

    fn write(&mut self, device: &mut Device, register: u8, byte: u8) -> bool {
        if self.ram.rom.is_some() {
            self.write_rom(device, register, byte);
            return true;
        }
        if !self.writable(register) {
            return self.ignores_sealed && self.withheld(register);
        }
        match register {
            0x00 => self.ram.low = byte,
            0x01 => self.subcommand(device, u16::from_le_bytes([self.ram.low, byte])),
            0x3E => self.ram.window.class = byte,
            0x3F => self.select(device, byte),
            0x54 if self.ram.window.source == Source::Authentication => self.authenticate(device, byte),
            0x40..=0x5F => self.ram.window.write(usize::from(register - 0x40), byte, device.now),
            0x60 => self.commit(device, byte),
            0x61 => self.ram.window.control = byte,
            _ => self.write_host(register, byte),
        }
        true
    }

    fn read(&mut self, device: &Device, register: u8) -> u8 {
        if let Some(boot) = &self.ram.rom {
            return boot.read(register);
        }
        let window = &self.ram.window;
        match register {
            0x00 | 0x01 => self.ram.answer.to_le_bytes()[usize::from(register)],
            0x3E | 0x3F | 0x60 | 0x61 if self.withheld(register) => 0,
            0x3E => window.class,
            0x3F => window.block,
            0x40..=0x5F => window.read(usize::from(register - 0x40), device.envelope.uncommitted, device.now),
            0x60 => window.read_sum(device.now),
            0x61 => window.control,
            _ => {
                let flash = &device.flash;
                let (voltage, present, flags) =
                    (self.voltage(flash), self.present(flash), self.own_flags(flash));
                let (gauging, calibration) = (&self.gauging, self.ram.calibration);
                let predicts = self.predicts(device);
                let (envelope, before) = (&device.envelope, &self.before);
                let registers = self.ram.registers.get_or_insert_with(|| {
                    let mut registers = gauging.registers(calibration, present);
                    for at in gauging.predicted().filter(|_| present && !predicts) {
                        registers[usize::from(at)] = match envelope.first_values {
                            First::Old => before[usize::from(at)],
                            First::Nonsense => envelope.nonsense(at),
                        };
                    }
                    registers
                });
                let from = |first: u8, word: u16| {
                    word.to_le_bytes().get(usize::from(register.wrapping_sub(first))).copied()
                };
                let byte = registers.get(usize::from(register)).copied().unwrap_or(0);
                let byte = from(self.part.voltage_register, voltage).unwrap_or(byte);
                byte | from(self.part.flags_register, flags).unwrap_or(0)
            }
        }
    }

    fn versions(&mut self, _: &Flash) -> [Option<u16>; 2] {
        [0x0002, 0x0003].map(|code| {
            let found = self.part.subcommands.iter().find(|(known, _, _)| *known == code);
            found
                .and_then(|(_, _, action)| if let Action::Answer(word) = action { Some(*word) } else { None })
        })
    }

    fn gauges(&self) -> bool {
        !self.ram.update.shows() && self.ram.rom.is_none()
    }

    fn reset(&mut self, device: &mut Device) {
        self.before = self.gauging.registers(false, true);
        if self.part.data_memory.is_some() {
            device.flash.reload(device.part.image, CODES);
            self.part.set_gain_sign(&mut device.flash);
            device.flash.itpor = true;
            device.save();
        }
        let initialized = device.ready_at + device.timing.initializing;
        self.ram = Ram::new(self.part, &device.flash, device.ready_at, initialized);
    }

    fn run(&mut self, device: &mut Device, settle: bool) {
        if device.is_on() && device.now >= device.measured_from {
            self.gauging.first_voltage();
        }
        if device.is_on()
            && let (Some(boot), Some(firmware)) = (&mut self.ram.rom, &mut device.flash.firmware)
            && let Some(effect) = boot.run(firmware, device.now)
        {
            self.affect(device, effect);
            device.save();
        }
        if device.is_on()
            && let Some((exit, at)) = self.ram.update.run(device.now)
        {
            let now = mem::replace(&mut device.now, at);
            device.pass(self, true);
            self.end_update(device, exit);
            device.now = now;
        }
        device.pass(self, settle);
        if self.ram.board_until.take_if(|until| device.now >= *until).is_some() {
            self.store(device, self.part.own.board_offset, &[self.board_offset as u8]);
            self.gauging.take_offsets(&device.flash);
        }
        self.ram.offset_until.take_if(|until| device.now >= *until);
        self.protect(device);
        if self.gauges() {
            self.ram.registers = None;
        }
    }

    fn refresh(&mut self) {
        self.gauging.measure();
        self.ram.registers = None;
    }

    fn model(&mut self) -> &mut dyn Model {
        &mut self.gauging
    }

    fn level(&self) -> Level {
        self.ram.seal.level
    }

    fn set_level(&mut self, device: &mut Device, level: Level) -> Result<()> {
        if level == Level::FullAccess && self.part.keys.len() < 2 {
            return Err(Error::new(
                "seal",
                ErrorKind::NotPermitted,
                "the part has no FULL ACCESS; write unsealed",
            ));
        }
        self.ram.was_sealed = level == Level::Sealed;
        self.part.remember_seal(&mut device.flash, level == Level::Sealed);
        device.save();
        match level {
            Level::Sealed => self.close(device.now),
            Level::Unsealed | Level::FullAccess => self.ram.seal.change(level, device.now),
        }
        Ok(())
    }

    fn fit_board(&mut self, flash: &Flash) {
        self.board = self.part.scale(flash);
    }

    /// Flash Update OK Cell Volt against Voltage() (SLUSBZ5D 7.3.16.3). The bq34z100-G1 also compares Voltage() scaled
    /// back to one cell, as its limit for seven cells requires (8.2.2.1.3), unless calibration is enabled. Parameters
    /// take effect at once.
    fn gate(&self, flash: &Flash) -> bool {
        let Some(gate) = &self.part.gate else { return true };
        let limit = i64::from(flash.i16(gate.limit.0, gate.limit.1));
        let voltage = i64::from(self.voltage(flash));
        let scaled = self.part.scale(flash).zip(gate.cell_divider);
        let scaled =
            scaled.is_none_or(|(scale, cell)| i64::from(cell) * voltage >= limit * i64::from(scale.divider));
        self.ram.calibration || voltage >= limit && scaled
    }

    fn mode(&self, flash: &Flash) -> &'static str {
        match () {
            () if flash.hdq => "hdq",
            () if self.is_dead(flash) => "dead",
            () if self.ram.rom.is_some() => "rom",
            () if self.ram.marks.contains(&Status::Calibrating) => "calibration",
            () if self.ram.update.shows() => "config-update",
            () => "normal",
        }
    }

    fn knob(&self, device: &Device, name: &str) -> Option<String> {
        Some(match name {
            "protocol" => knob::PROTOCOL.show(device.flash.hdq),
            "cc_gain_inverted" => knob::CC_GAIN_INVERTED.show(device.flash.inverted),
            "sealed_writes" => knob::SEALED_WRITES.show(self.ignores_sealed),
            "bat_det" => knob::BATTERY.show(self.is_away),
            "auth_order" => knob::AUTH_ORDER.show(self.as_sent),
            "cells" => knob::show_or_auto(self.gauging.battery().series),
            "real_mah" => knob::show_or_auto(self.gauging.own_capacity()),
            "real_soc" => format!("{:.2}", self.gauging.battery().percent()),
            "board_divider" => {
                let fits = self.board == self.part.scale(&device.flash);
                knob::show_or_auto(self.board.filter(|_| !fits).map(|board| board.divider.into()))
            }
            "shunt_error" => self.gauging.analog.shunt_error.to_string(),
            "cell_mohm" => (self.gauging.battery().ohms * 1000.0).to_string(),
            "thermistor" => self.gauging.analog.thermistor.show(),
            "keeps_full" => self.gauging.keeps_full.show(),
            "board_offset_ma" => knob::show_or_auto(self.gauging.analog.board_offset_ma),
            "cc_offset_ma" => knob::show_or_auto(self.gauging.analog.cc_offset_ma),
            "temperature_error" => self.gauging.analog.temperature.to_string(),
            "noise_mv" => self.gauging.analog.noise_mv.to_string(),
            "noise_ma" => self.gauging.analog.noise_ma.to_string(),
            "fets" => self.fets.show(),
            _ => return None,
        })
    }

    fn set_knob(&mut self, device: &mut Device, name: &str, text: &str) -> Result<()> {
        match name {
            "protocol" => {
                let before = device.flash.hdq;
                device.flash.hdq = knob::PROTOCOL.read(name, text)?;
                return device.store.save(&device.flash).inspect_err(|_| device.flash.hdq = before);
            }
            "cc_gain_inverted" => {
                let inverted = knob::CC_GAIN_INVERTED.read(name, text)?;
                if inverted && self.part.gain_sign().is_none() {
                    return Err(not_permitted(name, "no such specimen of this part is known"));
                }
                device.flash.inverted = inverted;
                self.part.set_gain_sign(&mut device.flash);
                self.gauging.apply(&device.flash);
                return device.store.save(&device.flash);
            }
            "sealed_writes" => self.ignores_sealed = knob::SEALED_WRITES.read(name, text)?,
            "auth_order" => self.as_sent = knob::AUTH_ORDER.read(name, text)?,
            "bat_det" => {
                let is_away = knob::BATTERY.read(name, text)?;
                if is_away && !self.part.has_pin(&device.flash) {
                    return Err(not_permitted(name, "no pin of this gauge detects a battery"));
                }
                self.is_away = is_away;
            }
            "keeps_full" => {
                let mut keeps = self.gauging.keeps_full;
                keeps.turn(name, text)?;
                if keeps && !self.part.map.learned.as_ref().is_some_and(|learns| learns.of_design) {
                    return Err(not_permitted(name, "Qmax of this part is no share of Design Capacity"));
                }
                self.gauging.keeps_full = keeps;
            }
            "cells" => self.gauging.set_series(knob::or_auto(name, text, 1.0, 32.0)?),
            "real_mah" => self.gauging.set_capacity(knob::or_auto(name, text, 1.0, 32_767.0)?),
            _ => self.set_board(device, name, text)?,
        }
        Ok(())
    }
}

fn not_permitted(name: &str, why: &str) -> Error {
    Error::new(name, ErrorKind::NotPermitted, why)
}

impl Block {
    /// Sets what the board around the gauge has: a divider, offsets, and errors of what is measured.
    fn set_board(&mut self, device: &Device, name: &str, text: &str) -> Result<()> {
        let analog = &mut self.gauging.analog;
        match name {
            "board_divider" => {
                let Some(fits) = self.part.scale(&device.flash) else {
                    return Err(not_permitted(name, "the part has no external divider"));
                };
                let divider = knob::or_auto(name, text, 1.0, 65_535.0)?;
                let board = divider.map(|divider| Scale { divider: divider as u16, external: true });
                self.board = Some(board.unwrap_or(fits));
            }
            "board_offset_ma" => {
                let offset = knob::or_auto(name, text, -31.0, 31.0)?;
                analog.board_offset_ma = offset;
                self.board_offset = offset.map_or(self.board_offset, |ma| (ma * BOARD_COUNTS).round() as i8);
            }
            "cc_offset_ma" => {
                let offset = knob::or_auto(name, text, -15.0, 15.0)?;
                analog.cc_offset_ma = offset;
                self.cc_offset = offset.map_or(self.cc_offset, |ma| (ma * CC_COUNTS).round() as i16);
            }
            "shunt_error" => analog.shunt_error = knob::number(name, text, -900.0, 9000.0)?,
            "cell_mohm" => {
                self.gauging.battery_mut().ohms = knob::number(name, text, 1.0, 10_000.0)? / 1000.0;
            }
            "thermistor" => analog.thermistor.turn(name, text)?,
            "temperature_error" => analog.temperature = knob::number(name, text, -500.0, 500.0)?,
            "noise_mv" => analog.noise_mv = knob::number(name, text, 0.0, 1000.0)?,
            "noise_ma" => analog.noise_ma = knob::number(name, text, 0.0, 1000.0)?,
            _ => unreachable!("`has_knob` knows all knobs"),
        }
        Ok(())
    }
}
