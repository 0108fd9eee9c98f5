//! Block access: a gauge whose data flash is reached unsealed through class, block, window and checksum
//! (SLUSBZ5D 7.3.3). Everything a host can do over the bus to the parts with flash is here, and to those
//! with RAM (SLUUAC9A), which differ in when the checksum counts. What differs from part to part is in
//! its description, [`Part`].
//!
//! Where the documents leave a choice, the gauge does what is worst for a driver: one with flash is sealed
//! after every reset, it does not answer meanwhile, and what it refuses it refuses silently.

use std::time::Duration;

use sha1::{Digest, Sha1};

use super::fault::{Inside, Plan};
use super::flash::{BLOCK, Flash, Image, Store};
use super::gauging::{Gauging, Map, REGISTERS};
use super::seal::{self, Level, Seal};
use super::update::{Exit, Mode, Ram};
use super::window::{Source, Window, checksum};
use super::{Chip, Options, knob};
use crate::bus::GAUGE_ADDRESS;
use crate::error::{Cause, Error, Result};

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

/// A gauge that sealed itself refuses keys for so long, and again from any subcommand on that is above the
/// second number (SLUUAC9A 6.4.5.1.1).
const LOCKED: Duration = Duration::from_secs(4);
const LOCKING: u16 = 0x001A;
/// From power, or from knowing of a battery, to the first prediction: up to 10 s (SLUUAC9A 2.4.6).
const INITIALIZING: Duration = Duration::from_secs(2);
/// Update Status: the gauge seals itself.
const SEAL: u8 = 0x80;
/// Flags() of the parts with RAM: data memory is ROM's, and CONFIG UPDATE.
const ITPOR: u16 = 0x0020;
const CFGUPMODE: u16 = 0x0010;
/// Flags() `[BAT_DET]`.
const BAT_DET: u16 = 0x0008;

/// What makes one such part.
#[derive(Debug)]
pub(super) struct Part {
    pub(super) name: &'static str,
    pub(super) image: Image,
    /// DM_CODE, which is all that tells some parts apart.
    pub(super) code: u16,
    pub(super) map: Map,
    /// Control(): code, who may send it, what it does. What is not here does nothing.
    pub(super) subcommands: &'static [(u16, Who, Action)],
    /// Bits of CONTROL_STATUS.
    pub(super) status: &'static [(Status, u16)],
    /// Subcommands from here on are not what PREV_MACWRITE shows.
    pub(super) remembered: u16,
    /// Registers above it are not acknowledged.
    pub(super) last_register: u8,
    pub(super) flags_register: u8,
    pub(super) voltage_register: u8,
    /// Registers whose word the host may write.
    pub(super) host_registers: &'static [(u8, Host)],
    /// Where in class 112 the keys stand: to UNSEALED and, where there is such a level, to FULL ACCESS.
    pub(super) keys: &'static [usize],
    /// Data memory is RAM.
    pub(super) ram: Option<Ram>,
    pub(super) gate: Option<Gate>,
    pub(super) authentication: Option<Authentication>,
    /// Blocks that a sealed gauge shows, and the class of each.
    pub(super) sealed_blocks: &'static [(u8, u16)],
    /// The class among them that can be written.
    pub(super) sealed_writes: Option<u16>,
    /// The bit that makes a pin tell of the battery, and not BAT_INSERT: class, offset, bit of that byte.
    pub(super) battery_insert: Option<(u16, usize, u8)>,
    pub(super) own: Own,
}

/// Where something stands in data flash: class and offset.
type Place = (u16, usize);
/// A bit of the word that stands there.
type Flag = (u16, usize, u16);

/// Data flash that the gauge itself reads or keeps, besides what gauging does.
#[derive(Debug)]
pub(super) struct Own {
    pub(super) cycles: Option<Place>,
    /// Classes of the lifetime data and of the count of samples.
    pub(super) lifetime: Option<(u16, u16)>,
    pub(super) update_status: Option<Place>,
    pub(super) cc_offset: Option<Place>,
    pub(super) board_offset: Option<Place>,
    /// The byte that is not 0 for the model of constant power.
    pub(super) load_mode: Option<Place>,
    /// The word and bit that lift the gate.
    pub(super) calibration: Option<Flag>,
    /// The word and bit that allow SLEEP, and where its current stands.
    pub(super) sleep: Option<(Flag, Place)>,
    /// Seconds of silence before FULL SLEEP.
    pub(super) settle: Option<Place>,
    /// The class that the chemistry's checksum is about.
    pub(super) chemistry: Option<u16>,
}

/// Below what voltage nothing is programmed: where the limit stands, and the divider of a stack's voltage.
#[derive(Debug)]
pub(super) struct Gate {
    pub(super) limit: Place,
    pub(super) divider: Option<Place>,
}

/// SHA-1 authentication.
#[derive(Debug)]
pub(super) struct Authentication {
    pub(super) key: Place,
}

/// Who may send a subcommand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Who {
    Anyone,
    Unsealed,
    FullAccess,
}

/// A word that the host writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Host {
    AtRate,
    Temperature,
}

/// What a subcommand does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    ControlStatus,
    Answer(u16),
    AnswerCode,
    /// Answers with a word of data flash.
    AnswerFrom(u16, usize),
    /// Answers with the chemistry that was chosen, or else with this one.
    AnswerChemistry(u16),
    AnswerOffset,
    ResetData,
    Previous,
    BoardOffset,
    CcOffset,
    WriteCcOffset,
    /// Answers with the sum of all data flash.
    FlashChecksum,
    ChemistryChecksum,
    FullSleep,
    Set(Status),
    Clear(Status),
    BatteryInsert(bool),
    Seal,
    ItEnable,
    ItDisable,
    CalEnable,
    EnterCalibration,
    ExitCalibration,
    Reset,
    ConfigUpdate,
    Leave(Exit),
    /// Chooses a chemistry, in CONFIG UPDATE only.
    Chemistry(u16),
    /// Off until power is switched off and on, if it was armed.
    Shutdown,
    Rom,
    Hdq,
}

/// What a bit of CONTROL_STATUS tells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Status {
    NotFullAccess,
    Sealed,
    Calibrating,
    CcOffset,
    BoardOffset,
    ChecksumValid,
    Initialized,
    Sleep,
    LoadMode,
    Enabled,
    ChemistryChanged,
    // Those that a subcommand sets or clears, and nothing else.
    DataLog,
    Hibernate,
    OcvDone,
    ShutdownArmed,
    Snooze,
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
    part: &'static Part,
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
    /// Bits of CONTROL_STATUS that subcommands have set.
    marks: Vec<Status>,
    update: Mode,
    update_enter: Duration,
    update_leave: Duration,
    /// No key is taken before.
    locked_until: Duration,
    /// BAT_INSERT was the last that was heard of the battery.
    inserted: bool,
    initialized_from: Duration,
    chemistry: Option<u16>,
}

impl Gauge {
    pub(super) fn new(part: &'static Part, options: &Options, now: Duration) -> Result<Self> {
        let mut flash = Flash::new(part.image);
        let mut store = Store::new(options.state.clone(), part.name);
        if !store.load(&mut flash)? {
            if let Some(words) = options.unseal_key {
                flash.preset(112, part.keys[0], &seal::stored(words));
            }
            if let Some((id, offset)) = part.ram.as_ref().map(|ram| ram.update_status) {
                // Somebody has sealed it, as they do; that is remembered here.
                flash.preset(id, offset, &[flash.u8(id, offset) | SEAL]);
            }
            store.save(&flash)?;
        }
        let gauging = Gauging::new(&part.map, &flash, 60.0);
        let calibration = is_set(&flash, part.own.calibration);
        let level = level(part, &flash);
        let ram = part.ram.as_ref();
        Ok(Self {
            part,
            store,
            manner: Manner {
                speed: 1.0,
                reset_stretches: false,
                ignores_sealed: false,
                load: Duration::ZERO,
                sealed_load: Duration::from_millis(20),
                authentication: Duration::from_millis(20),
                word: if part.ram.is_some() { Duration::ZERO } else { WORD },
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
            seal: Seal::new(level),
            window: Window::new(part.authentication.is_some()),
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
            marks: Vec::new(),
            update: Mode::Off,
            update_enter: ram.map_or(Duration::ZERO, |ram| ram.enter),
            update_leave: ram.map_or(Duration::ZERO, |ram| ram.leave),
            locked_until: now,
            inserted: false,
            initialized_from: now,
            chemistry: None,
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
        if on && let Some((exit, at)) = self.update.run(now) {
            self.pass(at, true);
            self.end_update(exit, at);
        }
        self.pass(now, settle);
        if self.board_until.is_some_and(|until| now >= until) {
            self.board_until = None;
            let offset = self.board_offset as u8;
            self.store_own(self.part.own.board_offset, &[offset], now);
        }
        if self.offset_until.is_some_and(|until| now >= until) {
            self.offset_until = None;
        }
        // In CONFIG UPDATE the gauge does not gauge.
        if !self.update.shows() {
            self.registers = None;
        }
    }

    /// The model's time goes on up to `now`.
    fn pass(&mut self, now: Duration, settle: bool) {
        let on = matches!(self.power, Power::On);
        let seconds = now.saturating_sub(self.modelled).as_secs_f64() * self.manner.speed;
        if seconds >= 1.0 || settle || self.manner.speed == 0.0 {
            self.modelled = now;
            let learned = self.gauging.advance(seconds);
            if on && learned.cycles {
                let cycles = self.gauging.cycles.to_be_bytes();
                self.store_own(self.part.own.cycles, &cycles, now);
            }
            if on
                && learned.lifetime
                && let Some((data, samples)) = self.part.own.lifetime
            {
                let mut bytes = [0; 12];
                for (pair, value) in bytes.chunks_mut(2).zip(self.gauging.lifetime) {
                    pair.copy_from_slice(&(value.round() as i32 as u16).to_be_bytes());
                }
                self.store_own(Some((data, 0)), &bytes, now);
                let count = self.flash.u16(samples, 0).saturating_add(1);
                self.store_own(Some((samples, 0)), &count.to_be_bytes(), now);
            }
        }
    }

    /// CONFIG UPDATE is over.
    fn end_update(&mut self, exit: Exit, at: Duration) {
        match exit {
            Exit::Anew => self.gauging.load(&self.flash),
            Exit::Plain | Exit::Forgotten => self.gauging.apply(&self.flash),
        }
        if exit != Exit::Forgotten {
            self.flash.itpor = false;
        }
        self.registers = None;
        if level(self.part, &self.flash) == Level::Sealed {
            self.close();
            self.locked_until = at + LOCKED;
        }
        // A file that cannot be written is reported by the `state` knob.
        let _ = self.store.save(&self.flash);
    }

    /// To SEALED, with nothing left open.
    fn close(&mut self) {
        self.seal = Seal::new(Level::Sealed);
        self.window = Window::new(self.part.authentication.is_some());
        (self.control, self.class, self.block) = (0, 0, 0);
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
        self.restart(now + POWER_UP);
        self.resets = 0;
        self.busy_until = now;
        self.reset_until = now;
    }

    /// RAM is built anew, and answers from `then` on.
    fn restart(&mut self, then: Duration) {
        if self.part.ram.is_some() {
            self.flash.reload(self.part.image, 112);
            self.invert(self.flash.inverted);
            self.flash.itpor = true;
            // A file that cannot be written is reported by the `state` knob.
            let _ = self.store.save(&self.flash);
        }
        self.gauging.reset(&self.flash);
        self.seal = Seal::new(level(self.part, &self.flash));
        self.window = Window::new(self.part.authentication.is_some());
        (self.control, self.class, self.block, self.answer, self.previous) = (0, 0, 0, 0, 0);
        (self.full_sleep, self.checksum_valid, self.calibrating) = (false, false, false);
        (self.board_until, self.offset_until) = (None, None);
        self.calibration = is_set(&self.flash, self.part.own.calibration);
        self.marks.clear();
        (self.update, self.inserted, self.chemistry) = (Mode::Off, false, None);
        (self.locked_until, self.initialized_from) = (then, then + INITIALIZING);
        self.registers = None;
    }

    fn has_gain_sign(&self) -> bool {
        self.part.ram.as_ref().is_some_and(|ram| ram.gain_sign.is_some())
    }

    /// Makes the sign of CC Gain what this specimen's ROM has.
    fn invert(&mut self, inverted: bool) {
        if let Some((id, offset)) = self.part.ram.as_ref().and_then(|ram| ram.gain_sign) {
            let byte = self.flash.u8(id, offset) & 0x7F | u8::from(inverted) << 7;
            self.flash.preset(id, offset, &[byte]);
        }
    }

    /// The bits of Flags() that are not about gauging.
    fn own_flags(&self) -> u16 {
        let (ram, detects) = (self.part.ram.is_some(), self.part.battery_insert.is_some());
        let bits = [
            (ITPOR, ram && self.flash.itpor),
            (CFGUPMODE, ram && self.update.shows()),
            (BAT_DET, detects && self.present()),
        ];
        bits.iter().filter(|(_, on)| *on).fold(0, |word, (bit, _)| word | bit)
    }

    /// Whether the gauge knows of a battery: a pin tells, and there is one, or the host does.
    fn present(&self) -> bool {
        let pin = |(id, offset, bit)| self.flash.u8(id, offset) & bit != 0;
        self.inserted || self.part.battery_insert.is_none_or(pin)
    }

    fn sealed(&self) -> bool {
        self.seal.level == Level::Sealed
    }

    /// Whether flash may be programmed: the stack voltage scaled back to a cell's against Flash Update OK
    /// Cell Volt (SLUSBZ5D 7.3.16.3), unless calibration is enabled. Both parameters count at once.
    fn gate(&self) -> bool {
        let Some(Gate { limit, divider }) = &self.part.gate else { return true };
        let voltage = f64::from(self.voltage());
        let cell = match divider.map(|(id, offset)| self.flash.u16(id, offset)) {
            None => voltage,
            Some(0) => 0.0,
            Some(divider) => voltage * 5000.0 / f64::from(divider),
        };
        self.calibration || cell >= f64::from(self.flash.i16(limit.0, limit.1))
    }

    /// Voltage() as the host reads it: the board's divider is the one that was calibrated, but nothing
    /// times 0 is a voltage.
    fn voltage(&self) -> u16 {
        let divider = self.part.gate.as_ref().and_then(|gate| gate.divider);
        match divider.map(|(id, offset)| self.flash.u16(id, offset)) {
            Some(0) => 0,
            Some(_) | None => self.gauging.voltage_mv(),
        }
    }

    /// Something the gauge itself keeps.
    fn store_own(&mut self, place: Option<Place>, bytes: &[u8], now: Duration) {
        let Some((id, offset)) = place.filter(|_| self.gate()) else { return };
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
        let taken = self.part.ram.is_none() || matches!(self.update, Mode::On(_));
        let allowed = taken && (!self.sealed() || self.part.sealed_writes == Some(id));
        if !allowed || !self.gate() || fault == Some(Inside::DropCommit) {
            self.dropped += 1;
            return;
        }
        let mut content = self.window.block().to_vec();
        if id == 112 && self.seal.level != Level::FullAccess {
            // The keys change in FULL ACCESS only (SLUSBZ5D 7.3.3.4), the authentication key here too; a
            // part without that level has them in ROM (SLUUAC9A 6.4.5.1.1).
            for &at in self.part.keys {
                content[at..at + 4].copy_from_slice(&self.flash.get::<4>(112, at));
            }
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
            self.power_down(now, None);
        }
    }

    fn select(&mut self, block: u8, now: Duration) {
        self.block = block;
        let special = self.sealed() || self.control == 0x01;
        let (source, wait) = match block {
            _ if !special => (Source::Flash(u16::from(self.class), block), self.manner.load),
            0 if self.part.authentication.is_some() => (Source::Authentication, self.manner.load),
            _ => {
                let class = self.part.sealed_blocks.iter().find(|(shown, _)| *shown == block);
                let source = class.map_or(Source::Nothing, |&(_, class)| Source::Flash(class, 0));
                (source, self.manner.sealed_load)
            }
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
        let Some(Authentication { key: (id, offset) }) = self.part.authentication else { return };
        let key = self.flash.get::<16>(id, offset);
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

    fn is(&self, status: Status) -> bool {
        let own = &self.part.own;
        let byte = |place: Option<Place>| place.map_or(0, |(id, offset)| self.flash.u8(id, offset));
        match status {
            Status::NotFullAccess => self.seal.level != Level::FullAccess,
            Status::Sealed => self.sealed(),
            Status::Calibrating => self.calibrating,
            Status::CcOffset => self.offset_until.is_some(),
            Status::BoardOffset => self.board_until.is_some(),
            Status::ChecksumValid => self.checksum_valid,
            Status::Initialized => self.present() && self.modelled >= self.initialized_from,
            Status::Sleep => own.sleep.is_some_and(|(allowed, (id, offset))| {
                let current = f64::from(self.flash.i16(id, offset));
                is_set(&self.flash, Some(allowed)) && self.gauging.is_quiet(current)
            }),
            Status::LoadMode => byte(own.load_mode) != 0,
            Status::Enabled => self.gauging.enabled,
            Status::ChemistryChanged => self.chemistry.is_some(),
            Status::DataLog
            | Status::Hibernate
            | Status::OcvDone
            | Status::ShutdownArmed
            | Status::Snooze => self.marks.contains(&status),
        }
    }

    fn status(&self) -> u16 {
        let set = self.part.status.iter().filter(|(status, _)| self.is(*status));
        set.fold(0, |word, (_, bit)| word | bit)
    }

    /// A word written to Control(). What is not for a sealed gauge, or unknown, does nothing.
    fn subcommand(&mut self, word: u16, now: Duration) {
        let keys: Vec<_> = self.part.keys.iter().map(|&at| seal::words(self.flash.get(112, at))).collect();
        let locked = now < self.locked_until;
        if locked && word > LOCKING {
            self.locked_until = now + LOCKED;
        }
        let listening = self.quiet >= self.manner.key_quiet && !locked;
        if self.seal.word(word, &keys, listening, now) {
            return;
        }
        if let Some(&(_, who, action)) = self.part.subcommands.iter().find(|(code, _, _)| *code == word) {
            let least = match who {
                Who::Anyone => Level::Sealed,
                Who::Unsealed => Level::Unsealed,
                Who::FullAccess => Level::FullAccess,
            };
            if self.seal.level >= least {
                self.act(action, now);
            }
        }
        if word < self.part.remembered {
            self.previous = word;
        }
    }

    fn act(&mut self, action: Action, now: Duration) {
        let own = &self.part.own;
        match action {
            Action::ControlStatus => self.answer = self.status(),
            Action::Answer(word) => self.answer = word,
            Action::AnswerCode => self.answer = self.part.code,
            Action::AnswerFrom(id, offset) => self.answer = self.flash.u16(id, offset),
            Action::AnswerChemistry(word) => self.answer = self.chemistry.unwrap_or(word),
            Action::ResetData => self.answer = self.resets,
            Action::Previous => self.answer = self.previous,
            Action::BoardOffset => {
                // Current that flows meanwhile is taken for offset.
                self.board_offset = (self.gauging.battery.current_ma() as i64 * 4
                    + i64::from(self.board_offset))
                .clamp(-128, 127) as i8;
                self.board_until = Some(now + CALIBRATING);
            }
            Action::CcOffset => self.offset_until = Some(now + CALIBRATING),
            Action::WriteCcOffset => {
                let offset = self.cc_offset.to_be_bytes();
                self.store_own(own.cc_offset, &offset, now);
            }
            Action::AnswerOffset if self.calibrating => {
                self.answer = own.cc_offset.map_or(0, |(id, offset)| self.flash.u16(id, offset));
            }
            Action::FlashChecksum => {
                let sum = self.flash.bytes().iter().fold(0u16, |sum, &byte| sum.wrapping_add(byte.into()));
                (self.answer, self.checksum_valid) = (sum, true);
            }
            Action::ChemistryChecksum => {
                let block = own.chemistry.map_or(&[][..], |id| self.flash.block(id, 0));
                let sum = block.iter().map(|&byte| u16::from(byte)).sum::<u16>();
                (self.answer, self.checksum_valid) = (sum & 0x7FFF, true);
            }
            Action::FullSleep => self.full_sleep = true,
            Action::Set(status) if !self.marks.contains(&status) => self.marks.push(status),
            Action::Clear(status) => self.marks.retain(|mark| *mark != status),
            Action::BatteryInsert(inserted) => {
                // With a pin to tell, the host is not listened to.
                let pin = |(id, offset, bit)| self.flash.u8(id, offset) & bit != 0;
                if self.part.battery_insert.is_some_and(pin) {
                    return;
                }
                if inserted && !self.inserted {
                    self.initialized_from = now + INITIALIZING;
                }
                self.inserted = inserted;
            }
            Action::Seal => {
                if let Some((id, offset)) = self.part.ram.as_ref().map(|ram| ram.update_status) {
                    let status = self.flash.u8(id, offset) | SEAL;
                    self.flash.preset(id, offset, &[status]);
                    // A file that cannot be written is reported by the `state` knob.
                    let _ = self.store.save(&self.flash);
                }
                self.close();
            }
            Action::ItEnable => {
                if let Some((id, offset)) = own.update_status {
                    let status = self.flash.u8(id, offset) | 0x04;
                    self.store_own(own.update_status, &[status], now);
                }
                self.gauging.enabled = true;
            }
            Action::ItDisable => self.gauging.enabled = false,
            Action::CalEnable => self.calibration = !self.calibration,
            Action::Reset => {
                self.restart(now + RESET);
                self.resets = self.resets.saturating_add(1);
                self.reset_until = now + RESET;
            }
            Action::ExitCalibration if self.calibration => self.calibrating = false,
            Action::EnterCalibration if self.calibration => self.calibrating = true,
            Action::ConfigUpdate => self.update.enter(self.update_enter, now),
            Action::Leave(exit) => self.update.leave(exit, self.update_leave, now),
            Action::Chemistry(id) if matches!(self.update, Mode::On(_)) => self.chemistry = Some(id),
            Action::Shutdown if self.is(Status::ShutdownArmed) => self.power_down(now, None),
            Action::Rom => self.rom = true,
            Action::Hdq => {
                self.flash.hdq = true;
                let _ = self.store.save(&self.flash);
            }
            Action::AnswerOffset
            | Action::Set(_)
            | Action::ExitCalibration
            | Action::EnterCalibration
            | Action::Chemistry(_)
            | Action::Shutdown => {}
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

    /// A byte of a word that the host may write; the second completes it.
    fn write_host(&mut self, register: u8, byte: u8) {
        if register & 1 == 0 {
            self.low = byte;
            return;
        }
        let word = u16::from_le_bytes([self.low, byte]);
        match self.host_register(register) {
            Some(Host::AtRate) => self.gauging.at_rate_ma = word as i16,
            Some(Host::Temperature) => self.gauging.host_temperature = Some(word),
            None => {}
        }
        self.registers = None;
    }

    /// Whether a register is there to be written, but not by a sealed gauge's host.
    fn withheld(&self, register: u8) -> bool {
        let ram = self.part.ram.is_some();
        self.sealed()
            && (matches!(register, 0x3E | 0x61 | 0x55..=0x5F) || ram && matches!(register, 0x3F..=0x60))
    }

    fn host_register(&self, register: u8) -> Option<Host> {
        let found = self.part.host_registers.iter().find(|(at, _)| register & !1 == *at);
        found.map(|&(_, host)| host)
    }

    fn writable(&self, register: u8) -> bool {
        let known = matches!(register, 0x00 | 0x01 | 0x3E..=0x61) || self.host_register(register).is_some();
        known && !self.withheld(register)
    }
}

/// The level of a gauge that has just begun to work with its data memory: one with RAM looks at Update
/// Status.
fn level(part: &Part, flash: &Flash) -> Level {
    match part.ram.as_ref().map(|ram| ram.update_status) {
        Some((id, offset)) if flash.u8(id, offset) & SEAL == 0 => Level::Unsealed,
        Some(_) | None => Level::Sealed,
    }
}

fn is_set(flash: &Flash, place: Option<Flag>) -> bool {
    place.is_some_and(|(id, offset, bit)| flash.u16(id, offset) & bit != 0)
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
            let settle = self.part.own.settle.map_or(0, |(id, offset)| self.flash.u8(id, offset));
            let settle = Duration::from_secs(u64::from(settle).max(1));
            if self.quiet >= settle && self.is(Status::Sleep) {
                wait = wait.max(WAKING);
            }
        }
        Some(wait)
    }

    fn has(&self, register: u8) -> bool {
        register <= self.part.last_register
    }

    fn extends(&self, register: u8) -> bool {
        // Where a second byte of one message is taken; elsewhere it is refused (SLUSBZ5D figure 7-5).
        self.rom
            || matches!(register, 0x01 | 0x3F | 0x41..=0x5F)
            || register & 1 == 1 && self.host_register(register).is_some()
    }

    fn write(&mut self, register: u8, byte: u8, plan: &mut Plan, now: Duration) -> bool {
        if self.rom {
            self.write_rom(register, byte, now);
            return true;
        }
        if !self.writable(register) {
            return self.manner.ignores_sealed && self.withheld(register);
        }
        match register {
            0x00 => self.low = byte,
            0x01 => self.subcommand(u16::from_le_bytes([self.low, byte]), now),
            0x3E => self.class = byte,
            0x3F => self.select(byte, now),
            0x54 if self.window.source == Source::Authentication => self.authenticate(byte, now),
            0x40..=0x5F => self.window.write(usize::from(register - 0x40), byte, now),
            0x60 => self.commit(byte, plan, now),
            0x61 => self.control = byte,
            _ => self.write_host(register, byte),
        }
        true
    }

    fn read(&mut self, register: u8, now: Duration) -> u8 {
        if self.rom {
            return 0;
        }
        match register {
            0x00 | 0x01 => self.answer.to_le_bytes()[usize::from(register)],
            0x3E | 0x3F | 0x60 | 0x61 if self.withheld(register) => 0,
            0x3E => self.class,
            0x3F => self.block,
            0x40..=0x5F => self.window.read(usize::from(register - 0x40), now),
            0x60 => self.window.read_sum(now),
            0x61 => self.control,
            _ => {
                let (voltage, present, flags) = (self.voltage(), self.present(), self.own_flags());
                let (part, gauging, calibration) = (self.part, &self.gauging, self.calibration);
                let registers = self.registers.get_or_insert_with(|| gauging.registers(calibration, present));
                let at = usize::from(part.voltage_register);
                registers[at..at + 2].copy_from_slice(&voltage.to_le_bytes());
                let byte = registers[usize::from(register) % REGISTERS];
                match register.wrapping_sub(part.flags_register) {
                    index @ 0..2 => byte | flags.to_le_bytes()[usize::from(index)],
                    _ => byte,
                }
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
                () if self.update.shows() => "config-update",
                () => "normal",
            }
            .into(),
            "protocol" => if self.flash.hdq { "hdq" } else { "i2c" }.into(),
            "seal" => self.seal.level.as_str().into(),
            "wear" => self.flash.wear(),
            "programmed" => self.flash.programmed().to_string(),
            "dropped" => self.dropped.to_string(),
            "resets" => self.resets.to_string(),
            "cfgupdate_ms" => milliseconds(self.update_enter),
            "cfgexit_ms" => milliseconds(self.update_leave),
            "cc_gain_inverted" => if self.flash.inverted { "on" } else { "off" }.into(),
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
            "cfgupdate_ms" => self.update_enter = milliseconds()?,
            "cfgexit_ms" => self.update_leave = milliseconds()?,
            "cc_gain_inverted" => {
                let inverted = knob::choice(name, text, &["off", "on"])? == 1;
                if inverted && !self.has_gain_sign() {
                    let why = "no such specimen of this part is known";
                    return Err(Error::new(name, Cause::NotPermitted(why.into())));
                }
                self.flash.inverted = inverted;
                self.invert(inverted);
                self.gauging.apply(&self.flash);
                self.store.save(&self.flash)?;
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
