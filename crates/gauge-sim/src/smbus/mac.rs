// SPDX-License-Identifier: MIT

//! ManufacturerAccess() of TI's gauges: a code by a word to 0x00 or a block to 0x44, and its answer in a block, at 0x23
//! without the code and at 0x44 behind it (SLUUBK0B 14.1).
//!
//! Nothing is refused by the bus: a sealed gauge takes every command, and where it has no answer the one before stays.

use std::time::Duration;

use super::pack::Pack;
use crate::knob::{KnobChoice, KnobValue};
use crate::part::TiPart;
use gauge_bus::error::{Error, ErrorKind, Result};

const SHUTDOWN: u16 = 0x0010;
/// A sealed gauge turns itself off if the command comes twice within that time.
const TWICE: Duration = Duration::from_secs(4);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Manner {
    Right,
    Silent,
    Echo,
    Noise,
}

impl KnobChoice for Manner {
    const WORDS: &'static [(&'static str, Self)] =
        &[("right", Self::Right), ("silent", Self::Silent), ("echo", Self::Echo), ("noise", Self::Noise)];
}

pub(super) struct Mac {
    part: &'static TiPart,
    device_type: Option<u16>,
    version: Option<u16>,
    failures: u32,
    sealed: bool,
    unknown: Vec<u16>,
    manner: Manner,
    stale: u32,
    harm: u32,
    /// The code and its answer, and those before.
    now: (u16, Vec<u8>),
    before: (u16, Vec<u8>),
    shutdown: Option<Duration>,
}

impl Mac {
    pub(super) fn new(part: &'static TiPart) -> Self {
        Self {
            part,
            device_type: None,
            version: None,
            failures: 0,
            sealed: true,
            unknown: Vec::new(),
            manner: Manner::Right,
            stale: 0,
            harm: 0,
            now: (0, b"LOT 0042".to_vec()),
            before: (0, Vec::new()),
            shutdown: None,
        }
    }

    pub(super) fn device_name(&self) -> &'static str {
        self.part.device_name
    }

    pub(super) fn has_15_cells(&self) -> bool {
        self.part.device_name == "bq78350"
    }

    pub(super) fn has_failed(&self) -> bool {
        self.failures != 0
    }

    /// Of several reasons one that all parts have: a cell's voltage was too high.
    pub(super) fn fail(&mut self) {
        if !self.has_failed() {
            self.failures = 0x0002;
        }
    }

    /// OperationStatus(): FETs, seal, failure, and why neither charging nor discharging is allowed.
    pub(super) fn status(&self) -> u32 {
        if self.answers_at(0x00) {
            return if self.sealed { 0xE000 } else { 0xC000 };
        }
        let seal = if self.sealed { 0x0300 } else { 0x0200 };
        seal | if self.has_failed() { 0x0000_7001 } else { 0x0000_0007 }
    }

    /// Takes a command. Returns whether the gauge turns itself off.
    pub(super) fn command(&mut self, code: u16, pack: &Pack, now: Duration) -> bool {
        if self.part.does.contains(&code) {
            let twice = |first: Option<Duration>| first.is_some_and(|first| now <= first + TWICE);
            let acts = !self.sealed || code == SHUTDOWN && twice(self.shutdown.replace(now));
            self.harm += u32::from(acts);
            return acts && code == SHUTDOWN;
        }
        let known = self.part.answers.iter().find(|(known, _)| *known == code);
        let Some(&(_, length)) = known.filter(|_| !self.unknown.contains(&code)) else { return false };
        let mut answer = self.answer(code, pack);
        answer.resize(length, 0);
        self.before = std::mem::replace(&mut self.now, (code, answer));
        false
    }

    fn answer(&self, code: u16, pack: &Pack) -> Vec<u8> {
        let kind = self.device_type.unwrap_or(self.part.device_type);
        let version = self.version.unwrap_or(self.part.version);
        let words = |words: &[u16]| words.iter().flat_map(|word| word.to_le_bytes()).collect();
        match code {
            0x0001 => words(&[kind]),
            0x0002 if self.answers_at(0x00) => words(&[version]),
            // Most significant byte first, as real parts have it.
            0x0002 => {
                [&[kind, version, self.part.build].map(u16::to_be_bytes).concat()[..], &[0, 3, 0x85, 2, 0]]
                    .concat()
            }
            0x0003 => words(&[0x00A1]),
            0x0006 => words(&[0x2044]),
            0x0051 => 0_u32.to_le_bytes().to_vec(),
            0x0053 => self.failures.to_le_bytes().to_vec(),
            0x0054 => self.status().to_le_bytes().to_vec(),
            0x0055 => vec![0x08, 0x04, 0x00],
            0x0056 => vec![0x40, 0x19, 0x00],
            0x0060 => words(&[
                4198,
                4201,
                4195,
                4199,
                3012,
                3005,
                3020,
                3011,
                61,
                2590,
                -9100_i16 as u16,
                -5200_i16 as u16,
                -7400_i16 as u16,
            ])
            .into_iter()
            .chain([41, -3_i8 as u8, 4, 44, -2_i8 as u8, 46])
            .collect(),
            0x0061 => vec![2, 0, 1, 0, 7, 6, 7, 9],
            0x0062 => words(&[4210, 3, 41, 290, 3600, 210, 60, 6]),
            0x0063 | 0x0064 => words(&[1, 12, 0, 0, 3, 57]),
            0x0071 => pack.measured(),
            0x0072 => words(&[pack.kelvin(); 8]),
            _ => Vec::new(),
        }
    }

    /// Whether it answers there.
    pub(super) fn answers_at(&self, code: u8) -> bool {
        self.part.answers_at.contains(&code)
    }

    /// The answer at a command code: a block, at 0x44 with the command before it, or a word at 0x00; `None` if it is not
    /// acknowledged.
    pub(super) fn told(&mut self, at: u8) -> Option<Vec<u8>> {
        let stale = self.stale > 0 && !self.before.1.is_empty();
        self.stale = self.stale.saturating_sub(1);
        let (code, answer) = if stale { &self.before } else { &self.now };
        let (echo, answer) = match self.manner {
            Manner::Silent => return None,
            Manner::Right => (*code, answer.clone()),
            Manner::Echo => (code ^ 0x0100, answer.clone()),
            Manner::Noise => (0x1717, vec![0x17; 0x15]),
        };
        if at == 0x00 {
            return Some(answer);
        }
        let echo = if at == 0x44 { echo.to_le_bytes().to_vec() } else { Vec::new() };
        let length = (echo.len() + answer.len()) as u8;
        Some([&[length][..], &echo, &answer].concat())
    }

    pub(super) fn knob(&self, name: &str) -> Option<String> {
        Some(match name {
            "device_type" => self.device_type.show(),
            "ti_firmware" => self.version.show(),
            "pf_status" => format!("0x{:08x}", self.failures),
            "sealed" => self.sealed.show(),
            "unknown" if self.unknown.is_empty() => "none".into(),
            "unknown" => {
                self.unknown.iter().map(|code| format!("0x{code:04x}")).collect::<Vec<_>>().join(" ")
            }
            "mac" => self.manner.show(),
            "stale" => self.stale.show(),
            "harm" => self.harm.to_string(),
            _ => return None,
        })
    }

    /// Whether it is one of its knobs.
    pub(super) fn turn(&mut self, name: &str, text: &str) -> Option<Result<()>> {
        Some(match name {
            "device_type" => self.device_type.turn(name, text),
            "ti_firmware" => self.version.turn(name, text),
            "pf_status" => hex(name, text).map(|word| self.failures = word),
            "sealed" => self.sealed.turn(name, text),
            "unknown" => {
                let words = text.split_whitespace().filter(|word| *word != "none");
                let codes: Result<Vec<_>> =
                    words.map(|word| hex(name, word).map(|word| word as u16)).collect();
                codes.map(|codes| self.unknown = codes)
            }
            "mac" => self.manner.turn(name, text),
            "stale" => self.stale.turn(name, text),
            _ => return None,
        })
    }
}

fn hex(name: &str, text: &str) -> Result<u32> {
    let digits = text.strip_prefix("0x").filter(|digits| digits.bytes().all(|byte| byte.is_ascii_hexdigit()));
    let why = "not a word; write one such as 0x00000001";
    digits
        .and_then(|digits| u32::from_str_radix(digits, 16).ok())
        .ok_or_else(|| Error::new(name, ErrorKind::Invalid, why))
}
