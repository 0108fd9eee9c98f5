//! Block access: a flash gauge whose data flash is reached unsealed through class, block, window and
//! checksum (SLUSBZ5D 7.3.3). Everything a host can do to the bq34z100-G1 over the bus is here.
//!
//! Where the documents leave a choice, the gauge does what is worst for a driver: it is sealed after
//! every reset, it does not answer meanwhile, and what it refuses it refuses silently.

use std::time::Duration;

use sha1::{Digest, Sha1};

use super::fault::{Inside, Plan};
use super::flash::{BLOCK, Flash, Image, Store};
use super::gauging::{Gauging, REGISTERS};
use super::seal::{self, Level, Seal};
use super::window::{Source, Window, checksum};
use super::{Chip, Options, knob};
use crate::bus::GAUGE_ADDRESS;
use crate::error::Result;

/// Where a gauge in ROM mode answers.
const ROM_ADDRESS: u8 = 0x0B;
/// Programming a word of flash (SLUSBZ5D 6.12).
const WORD: Duration = Duration::from_millis(2);
/// A full reset; no document says, drivers found it by trying.
const RESET: Duration = Duration::from_millis(175);
/// From power to the first answer (SLUSBZ5D 6.3), and to the first Voltage().
const POWER_UP: Duration = Duration::from_millis(250);
const FIRST_VOLTAGE: Duration = Duration::from_secs(1);
/// The first message in FULL SLEEP (SLUSBZ5D 7.3.1.2.12).
const WAKING: Duration = Duration::from_millis(8);
/// Measuring an offset.
const CALIBRATING: Duration = Duration::from_secs(4);

// CONTROL_STATUS, table 7-3.
const FAS: u16 = 0x4000;
const SS: u16 = 0x2000;
const CALEN: u16 = 0x1000;
const CCA: u16 = 0x0800;
const BCA: u16 = 0x0400;
const CSV: u16 = 0x0200;
const SLEEP: u16 = 0x0010;
const LDMD: u16 = 0x0008;
const VOK: u16 = 0x0002;
const QEN: u16 = 0x0001;

/// What makes one such part.
pub(super) struct Part {
    pub(super) name: &'static str,
    pub(super) identity: Identity,
    pub(super) image: Image,
}

/// Its answers to Control().
#[derive(Clone, Copy, Debug)]
pub(super) struct Identity {
    pub(super) device_type: u16,
    pub(super) firmware: u16,
    pub(super) hardware: u16,
    pub(super) chemistry: u16,
}

/// A block that is being programmed: what a loss of power would tear.
struct Pending {
    id: u16,
    block: u8,
    old: Vec<u8>,
    started: Duration,
}

enum Power {
    On,
    Off { until: Option<Duration> },
}

/// What the sealed gauge is asked to be, and how slow: settings of the simulation.
struct Manner {
    speed: f64,
    reset_stretches: bool,
    ignores_sealed: bool,
    load: Duration,
    sealed_load: Duration,
    authentication: Duration,
    word: Duration,
    key_quiet: Duration,
    as_sent: bool,
}

/// The gauge.
pub(super) struct Gauge {
    identity: Identity,
    flash: Flash,
    store: Store,
    manner: Manner,
    power: Power,
    /// Times before which the gauge does not answer, is in a reset, or holds the clock.
    silent_until: Duration,
    reset_until: Duration,
    busy_until: Duration,
    measured_from: Duration,
    rom: bool,
    rom_bytes: [u8; 3],
    gauging: Gauging,
    /// Up to when the model has been run.
    modelled: Duration,
    seal: Seal,
    window: Window,
    /// BlockDataControl() and DataFlashClass().
    control: u8,
    class: u8,
    block: u8,
    low: u8,
    answer: u16,
    previous: u16,
    resets: u16,
    full_sleep: bool,
    checksum_valid: bool,
    /// CAL_ENABLE, and CALIBRATION mode itself.
    calibration: bool,
    calibrating: bool,
    board_until: Option<Duration>,
    offset_until: Option<Duration>,
    board_offset: i8,
    cc_offset: i16,
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
            if let Some(words) = options.unseal_key {
                flash.preset(112, 0, &seal::stored(words));
            }
            store.save(&flash)?;
        }
        let gauging = Gauging::new(&flash, 60.0);
        let calibration = flash.u16(64, 0) & 0x4000 != 0;
        Ok(Self {
            identity: part.identity,
            store,
            manner: Manner {
                speed: 1.0,
                reset_stretches: false,
                ignores_sealed: false,
                load: Duration::ZERO,
                sealed_load: Duration::from_millis(20),
                authentication: Duration::from_millis(20),
                word: WORD,
                key_quiet: Duration::ZERO,
                as_sent: false,
            },
            power: Power::On,
            silent_until: now,
            reset_until: now,
            busy_until: now,
            measured_from: now,
            rom: false,
            rom_bytes: [0xFF; 3],
            gauging,
            modelled: now,
            seal: Seal::new(),
            window: Window::new(),
            control: 0,
            class: 0,
            block: 0,
            low: 0,
            answer: 0,
            previous: 0,
            resets: 0,
            full_sleep: false,
            checksum_valid: false,
            calibration,
            calibrating: false,
            board_until: None,
            offset_until: None,
            // Offsets differ from part to part, by little.
            board_offset: (options.seed % 17) as i8 - 8,
            cc_offset: -1200 + (options.seed % 101) as i16 - 50,
            last_transfer: Duration::ZERO,
            quiet: Duration::MAX,
            pending: None,
            dropped: 0,
            registers: None,
            flash,
        })
    }

    /// Brings everything that goes by time up to `now`. Measurements are made once a second of the
    /// gauge's time; `settle` makes one at once.
    fn run(&mut self, now: Duration, settle: bool) {
        if let Power::Off { until: Some(until) } = self.power
            && now >= until
        {
            self.power_up(until);
        }
        if self.pending.is_some() && now >= self.busy_until {
            self.pending = None;
        }
        let on = matches!(self.power, Power::On);
        if !self.gauging.measured && on && now >= self.measured_from {
            self.gauging.measured = true;
            self.gauging.update(0.0);
        }
        let seconds = now.saturating_sub(self.modelled).as_secs_f64() * self.manner.speed;
        if seconds >= 1.0 || settle || self.manner.speed == 0.0 {
            self.modelled = now;
            let learned = self.gauging.advance(seconds);
            if on && learned.cycles {
                let cycles = self.gauging.cycles.to_be_bytes();
                self.store_own(48, 6, &cycles, now);
            }
            if on && learned.lifetime {
                let mut bytes = [0; 12];
                for (pair, value) in bytes.chunks_mut(2).zip(self.gauging.lifetime) {
                    pair.copy_from_slice(&(value.round() as i32 as u16).to_be_bytes());
                }
                self.store_own(59, 0, &bytes, now);
                let count = self.flash.u16(60, 0).saturating_add(1);
                self.store_own(60, 0, &count.to_be_bytes(), now);
            }
        }
        if self.board_until.is_some_and(|until| now >= until) {
            self.board_until = None;
            let offset = self.board_offset as u8;
            self.store_own(104, 10, &[offset], now);
        }
        if self.offset_until.is_some_and(|until| now >= until) {
            self.offset_until = None;
        }
        self.registers = None;
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

    /// Leaves the first `count` bytes of a block new and the rest as it was.
    fn tear(&mut self, pending: &Pending, count: usize) {
        let mut bytes = self.flash.block(pending.id, pending.block).to_vec();
        let count = count.min(bytes.len());
        bytes[count..].copy_from_slice(&pending.old[count..]);
        self.flash.overwrite(pending.id, pending.block, &bytes);
        // A file that cannot be written is reported by the `state` knob.
        let _ = self.store.save(&self.flash);
    }

    fn power_up(&mut self, now: Duration) {
        self.power = Power::On;
        self.rom = false;
        self.gauging.measured = false;
        self.measured_from = now + FIRST_VOLTAGE;
        self.silent_until = now + POWER_UP;
        self.restart();
        self.resets = 0;
        self.busy_until = now;
        self.reset_until = now;
    }

    /// RAM is built anew.
    fn restart(&mut self) {
        self.gauging.reset(&self.flash);
        self.seal = Seal::new();
        self.window = Window::new();
        (self.control, self.class, self.block, self.answer, self.previous) = (0, 0, 0, 0, 0);
        (self.full_sleep, self.checksum_valid, self.calibrating) = (false, false, false);
        (self.board_until, self.offset_until) = (None, None);
        self.calibration = self.flash.u16(64, 0) & 0x4000 != 0;
        self.registers = None;
    }

    fn sealed(&self) -> bool {
        self.seal.level == Level::Sealed
    }

    /// Whether flash may be programmed: the stack voltage scaled back to a cell's against Flash Update OK
    /// Cell Volt (SLUSBZ5D 7.3.16.3), unless calibration is enabled. Both parameters count at once.
    fn gate(&self) -> bool {
        let divider = f64::from(self.flash.u16(104, 14));
        let voltage = f64::from(self.voltage());
        let cell = if divider > 0.0 { voltage * 5000.0 / divider } else { 0.0 };
        self.calibration || cell >= f64::from(self.flash.i16(68, 0))
    }

    /// Voltage() as the host reads it: the board's divider is the one that was calibrated, but nothing
    /// times 0 is a voltage.
    fn voltage(&self) -> u16 {
        if self.flash.u16(104, 14) == 0 { 0 } else { self.gauging.voltage_mv() }
    }

    /// Something the gauge itself keeps.
    fn store_own(&mut self, id: u16, offset: usize, bytes: &[u8], now: Duration) {
        if !self.gate() {
            return;
        }
        let block = (offset / BLOCK) as u8;
        let mut content = self.flash.block(id, block).to_vec();
        let start = offset % BLOCK;
        content[start..start + bytes.len()].copy_from_slice(bytes);
        self.program(id, block, &content, now);
    }

    /// Programs a block; a state file that cannot be written is as bad as flash that cannot.
    fn program(&mut self, id: u16, block: u8, content: &[u8], now: Duration) {
        let before = self.flash.clone();
        let old = self.flash.block(id, block).to_vec();
        self.flash.program(id, block, content);
        if self.store.save(&self.flash).is_err() {
            self.flash = before;
            self.dropped += 1;
            return;
        }
        let words = old.len().div_ceil(2) as u32;
        self.busy_until = self.busy_until.max(now) + self.manner.word * words;
        self.pending = Some(Pending { id, block, old, started: now });
    }

    /// The checksum has been written.
    fn commit(&mut self, sum: u8, plan: &mut Plan, now: Duration) {
        let Source::Flash(id, block) = self.window.source else { return };
        if sum != checksum(&self.window.data) {
            return;
        }
        self.window.sum = sum;
        let fault = plan.commit();
        // Sealed, only the lifetime block may be written (SLUSBZ5D 7.3.6.17).
        let allowed = !self.sealed() || id == 59;
        if !allowed || !self.gate() || fault == Some(Inside::DropCommit) {
            self.dropped += 1;
            return;
        }
        let mut content = self.window.block().to_vec();
        if id == 112 && self.seal.level != Level::FullAccess {
            // The keys change in FULL ACCESS only (SLUSBZ5D 7.3.3.4), the authentication key here too.
            content[..8].copy_from_slice(&self.flash.get::<8>(112, 0));
        }
        if fault == Some(Inside::CorruptCommit) {
            let old = self.flash.block(id, block);
            let at = content.iter().zip(old).position(|(new, old)| new != old).unwrap_or(0);
            content[at] ^= 0x01;
        }
        self.program(id, block, &content, now);
        if let Some(Inside::TornCommit(words)) = fault
            && let Some(pending) = self.pending.take()
        {
            self.tear(&pending, 2 * words);
            self.power = Power::Off { until: None };
        }
    }

    fn select(&mut self, block: u8, now: Duration) {
        self.block = block;
        let special = self.sealed() || self.control == 0x01;
        let (source, wait) = match block {
            _ if !special => (Source::Flash(u16::from(self.class), block), self.manner.load),
            0 => (Source::Authentication, self.manner.load),
            1 => (Source::Flash(58, 0), self.manner.sealed_load),
            4 => (Source::Flash(59, 0), self.manner.sealed_load),
            _ => (Source::Nothing, self.manner.sealed_load),
        };
        let bytes = match source {
            Source::Flash(id, block) => self.flash.block(id, block).to_vec(),
            Source::Nothing | Source::Authentication => Vec::new(),
        };
        let source = if bytes.is_empty() && !special { Source::Nothing } else { source };
        // A sealed gauge's blocks are blank at first, as drivers of its siblings found out.
        self.window.load(source, &bytes, special, now + wait);
    }

    /// SHA-1 of the key and SHA-1 of the key and the challenge (SLUSBZ5D 7.3.15). The first byte on the
    /// wire is the least significant one, unless set otherwise: no document settles it.
    fn authenticate(&mut self, sum: u8, now: Duration) {
        let mut message = self.window.data[..20].to_vec();
        if sum != checksum(&message) {
            return;
        }
        let key = self.flash.get::<16>(112, 8);
        if !self.manner.as_sent {
            message.reverse();
        }
        let inner = Sha1::new().chain_update(key).chain_update(&message).finalize();
        let mut digest = Sha1::new().chain_update(key).chain_update(inner).finalize();
        if !self.manner.as_sent {
            digest.reverse();
        }
        self.window.load(Source::Authentication, &digest, false, now + self.manner.authentication);
    }

    fn status(&self) -> u16 {
        let sleeps = self.flash.u16(64, 0) & 0x0040 != 0;
        let quiet = self.gauging.is_quiet(f64::from(self.flash.i16(68, 2)));
        let bits = [
            (FAS, self.seal.level != Level::FullAccess),
            (SS, self.sealed()),
            (CALEN, self.calibrating),
            (CCA, self.offset_until.is_some()),
            (BCA, self.board_until.is_some()),
            (CSV, self.checksum_valid),
            (SLEEP, sleeps && quiet),
            (LDMD, self.flash.u8(80, 1) != 0),
            (VOK, self.gauging.enabled),
            (QEN, self.gauging.enabled),
        ];
        bits.iter().filter(|(_, on)| *on).fold(0, |word, (bit, _)| word | bit)
    }

    /// A word written to Control(). What is not for a sealed gauge, or unknown, does nothing.
    fn subcommand(&mut self, word: u16, now: Duration) {
        let keys = [self.flash.get(112, 0), self.flash.get(112, 4)].map(seal::words);
        let listening = self.quiet >= self.manner.key_quiet;
        if self.seal.word(word, keys, listening, now) {
            return;
        }
        let open = !self.sealed();
        match word {
            0x0000 => self.answer = self.status(),
            0x0001 => self.answer = self.identity.device_type,
            0x0002 => self.answer = self.identity.firmware,
            0x0003 => self.answer = self.identity.hardware,
            0x0005 => self.answer = self.resets,
            0x0007 => self.answer = self.previous,
            0x0008 => self.answer = self.identity.chemistry,
            0x0009 => {
                // Current that flows meanwhile is taken for offset.
                self.board_offset = (self.gauging.battery.current_ma() as i64 * 4
                    + i64::from(self.board_offset))
                .clamp(-128, 127) as i8;
                self.board_until = Some(now + CALIBRATING);
            }
            0x000A => self.offset_until = Some(now + CALIBRATING),
            0x000B => {
                let offset = self.cc_offset.to_be_bytes();
                self.store_own(104, 8, &offset, now);
            }
            0x000C => self.answer = self.flash.u16(56, 10),
            0x0010 => self.full_sleep = true,
            0x0017 => {
                let sum = self.flash.block(88, 0).iter().map(|&byte| u16::from(byte)).sum::<u16>();
                (self.answer, self.checksum_valid) = (sum & 0x7FFF, true);
            }
            0x0020 if open => {
                self.seal = Seal::new();
                self.window = Window::new();
                (self.control, self.class, self.block) = (0, 0, 0);
            }
            0x0021 if open => {
                let status = self.flash.u8(82, 4) | 0x04;
                self.store_own(82, 4, &[status], now);
                self.gauging.enabled = true;
            }
            0x002D if open => self.calibration = !self.calibration,
            0x0041 if open => {
                self.restart();
                self.resets = self.resets.saturating_add(1);
                self.reset_until = now + RESET;
            }
            0x0080 if open && self.calibration => self.calibrating = false,
            0x0081 if open && self.calibration => self.calibrating = true,
            0x0082 if open && self.calibrating => self.answer = self.flash.u16(104, 8),
            0x0F00 if self.seal.level == Level::FullAccess => self.rom = true,
            0x7C40 => {
                self.flash.hdq = true;
                let _ = self.store.save(&self.flash);
            }
            _ => {}
        }
        if word < 0x20 {
            self.previous = word;
        }
    }

    /// A byte for the boot loader, of which only the way out is known: 0x0F at 0x00 and 0x000F at 0x64.
    fn write_rom(&mut self, register: u8, byte: u8, now: Duration) {
        let at = match register {
            0x00 => 0,
            0x64 => 1,
            0x65 => 2,
            _ => return,
        };
        self.rom_bytes[at] = byte;
        if self.rom_bytes == [0x0F, 0x0F, 0x00] {
            self.rom_bytes = [0xFF; 3];
            self.power_up(now);
        }
    }

    fn writable(&self, register: u8) -> bool {
        match register {
            0x00 | 0x01 | 0x3F..=0x54 | 0x60 => true,
            0x3E | 0x61 | 0x55..=0x5F => !self.sealed(),
            _ => false,
        }
    }
}

impl Chip for Gauge {
    fn start(&mut self, address: u8, now: Duration) -> Option<Duration> {
        self.run(now, false);
        self.quiet = now.saturating_sub(self.last_transfer);
        let here = if self.rom { ROM_ADDRESS } else { GAUGE_ADDRESS };
        if !matches!(self.power, Power::On) || now < self.silent_until || self.flash.hdq || address != here {
            return None;
        }
        let mut wait = self.busy_until.saturating_sub(now);
        if now < self.reset_until {
            if !self.manner.reset_stretches {
                return None;
            }
            wait = wait.max(self.reset_until - now);
        }
        if self.full_sleep {
            self.full_sleep = false;
            let settle = Duration::from_secs(u64::from(self.flash.u8(68, 11)).max(1));
            if self.quiet >= settle && self.status() & SLEEP != 0 {
                wait = wait.max(WAKING);
            }
        }
        Some(wait)
    }

    fn has(&self, register: u8) -> bool {
        register < 0x80
    }

    fn extends(&self, register: u8) -> bool {
        // Where a second byte of one message is taken; elsewhere it is refused (SLUSBZ5D figure 7-5).
        self.rom || matches!(register, 0x01 | 0x3F | 0x41..=0x5F)
    }

    fn write(&mut self, register: u8, byte: u8, plan: &mut Plan, now: Duration) -> bool {
        if self.rom {
            self.write_rom(register, byte, now);
            return true;
        }
        if !self.writable(register) {
            return self.manner.ignores_sealed && matches!(register, 0x3E | 0x61 | 0x55..=0x5F);
        }
        match register {
            0x00 => self.low = byte,
            0x01 => self.subcommand(u16::from_le_bytes([self.low, byte]), now),
            0x3E => self.class = byte,
            0x3F => self.select(byte, now),
            0x54 if self.window.source == Source::Authentication => self.authenticate(byte, now),
            0x40..=0x5F => self.window.write(usize::from(register - 0x40), byte, now),
            0x60 => self.commit(byte, plan, now),
            _ => self.control = byte,
        }
        true
    }

    fn read(&mut self, register: u8, now: Duration) -> u8 {
        if self.rom {
            return 0;
        }
        match register {
            0x00 | 0x01 => self.answer.to_le_bytes()[usize::from(register)],
            0x3E => self.class,
            0x3F => self.block,
            0x40..=0x5F => self.window.read(usize::from(register - 0x40), now),
            0x60 => self.window.read_sum(now),
            0x61 => self.control,
            _ => {
                let voltage = self.voltage().to_le_bytes();
                let (gauging, calibration) = (&self.gauging, self.calibration);
                let registers = self.registers.get_or_insert_with(|| gauging.registers(calibration));
                registers[0x08..0x0A].copy_from_slice(&voltage);
                registers[usize::from(register) % REGISTERS]
            }
        }
    }

    fn stop(&mut self, now: Duration) {
        self.last_transfer = now;
    }

    fn power_off(&mut self, now: Duration, back: Option<Duration>) {
        self.power_down(now, back);
    }

    fn flash(&self) -> &Flash {
        &self.flash
    }

    fn knob(&mut self, name: &str, now: Duration) -> Option<String> {
        self.run(now, true);
        let battery = &self.gauging.battery;
        let milliseconds = |time: Duration| time.as_millis().to_string();
        let on = matches!(self.power, Power::On);
        Some(match name {
            "load_ma" => format!("{}", battery.load_ma),
            "temperature" => format!("{}", (battery.ambient * 10.0).round()),
            "speed" => format!("{}", self.manner.speed),
            "soc" => format!("{:.1}", self.gauging.percent()),
            "voltage_mv" => match self.gauging.forced_mv {
                Some(forced) => forced.to_string(),
                None => "auto".into(),
            },
            "power" => if on { "on" } else { "off" }.into(),
            "mode" => match () {
                () if !on => "off",
                () if self.flash.hdq => "hdq",
                () if self.rom => "rom",
                () if now < self.silent_until.max(self.reset_until) => "reset",
                () if self.calibrating => "calibration",
                () => "normal",
            }
            .into(),
            "protocol" => if self.flash.hdq { "hdq" } else { "i2c" }.into(),
            "seal" => self.seal.level.as_str().into(),
            "wear" => self.flash.wear(),
            "programmed" => self.flash.programmed().to_string(),
            "dropped" => self.dropped.to_string(),
            "resets" => self.resets.to_string(),
            "state" => self.store.failure.clone().unwrap_or_else(|| "ok".into()),
            "reset_busy" => if self.manner.reset_stretches { "stretch" } else { "nack" }.into(),
            "sealed_writes" => if self.manner.ignores_sealed { "ignore" } else { "nack" }.into(),
            "load_ms" => milliseconds(self.manner.load),
            "sealed_load_ms" => milliseconds(self.manner.sealed_load),
            "auth_ms" => milliseconds(self.manner.authentication),
            "auth_order" => if self.manner.as_sent { "as-sent" } else { "lsb-first" }.into(),
            "word_ms" => milliseconds(self.manner.word),
            "key_quiet_ms" => milliseconds(self.manner.key_quiet),
            _ => return None,
        })
    }

    fn set_knob(&mut self, name: &str, text: &str, now: Duration) -> Result<()> {
        self.run(now, true);
        let milliseconds =
            || knob::number(name, text, 0.0, 60_000.0).map(|ms| Duration::from_millis(ms as u64));
        match name {
            "load_ma" => self.gauging.battery.load_ma = knob::number(name, text, -32_000.0, 32_000.0)?,
            "temperature" => {
                self.gauging.battery.ambient = knob::number(name, text, -400.0, 1200.0)? / 10.0;
            }
            "speed" => self.manner.speed = knob::number(name, text, 0.0, 100_000.0)?,
            "soc" => {
                let percent = knob::number(name, text, 0.0, 100.0)?;
                self.gauging.set_percent(percent);
            }
            "voltage_mv" => {
                self.gauging.forced_mv = match text {
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
            "protocol" => {
                let before = self.flash.hdq;
                self.flash.hdq = knob::choice(name, text, &["i2c", "hdq"])? == 1;
                if let Err(error) = self.store.save(&self.flash) {
                    self.flash.hdq = before;
                    return Err(error);
                }
            }
            "reset_busy" => {
                self.manner.reset_stretches = knob::choice(name, text, &["nack", "stretch"])? == 1;
            }
            "sealed_writes" => {
                self.manner.ignores_sealed = knob::choice(name, text, &["nack", "ignore"])? == 1;
            }
            "load_ms" => self.manner.load = milliseconds()?,
            "sealed_load_ms" => self.manner.sealed_load = milliseconds()?,
            "auth_ms" => self.manner.authentication = milliseconds()?,
            "auth_order" => self.manner.as_sent = knob::choice(name, text, &["lsb-first", "as-sent"])? == 1,
            "word_ms" => self.manner.word = milliseconds()?,
            "key_quiet_ms" => self.manner.key_quiet = milliseconds()?,
            _ => return Err(knob::read_only(name)),
        }
        self.gauging.update(0.0);
        self.registers = None;
        Ok(())
    }
}
