// SPDX-License-Identifier: MIT

//! A simulated gauge on a bench: transcripts are played on its bus.

use std::sync::Arc;
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{Bus, BusError};
use gauge_sim::{Options, Sim};

pub(crate) struct Bench {
    pub(crate) sim: Sim,
    pub(crate) clock: Arc<SimClock>,
}

impl Bench {
    pub(crate) fn new() -> Self {
        Self::with(&Options::default())
    }

    pub(crate) fn with(options: &Options) -> Self {
        Self::of("bq34z100-g1", options)
    }

    pub(crate) fn of(chip: &str, options: &Options) -> Self {
        let clock = Arc::new(SimClock::new());
        let sim = Sim::new(chip, options, clock.clone()).unwrap();
        Self { sim, clock }
    }

    pub(crate) fn unsealed() -> Self {
        let bench = Self::new();
        bench.replay(UNSEAL);
        bench
    }

    /// Plays a transcript: `W register bytes`, `R register count -> bytes` (the count is 1 if it is left out), either with
    /// `-> NACK`, and `X ms` to wait. Numbers are hexadecimal, except after X; `..` matches any further bytes.
    #[track_caller]
    pub(crate) fn replay(&self, text: &str) {
        let mut bus = self.sim.bus();
        for line in text.split([';', '\n']).map(str::trim).filter(|line| !line.is_empty()) {
            let (sent, expected) = match line.split_once("->") {
                Some((sent, expected)) => (sent, expected.trim()),
                None => (line, ""),
            };
            let (kind, rest) = sent.split_at(1);
            let result = match kind {
                "X" => {
                    self.clock.sleep(Duration::from_millis(rest.trim().parse().unwrap()));
                    continue;
                }
                "W" => bus.transfer(&hex(rest), &mut []).map(|()| Vec::new()),
                "R" => {
                    let numbers = hex(rest);
                    let mut read = vec![0; usize::from(numbers.get(1).copied().unwrap_or(1))];
                    bus.transfer(&numbers[..1], &mut read).map(|()| read)
                }
                _ => panic!("{line}"),
            };
            match (result, expected) {
                (Err(error), "NACK") => assert_eq!(error, BusError::NoAck, "{line}"),
                (Ok(_), "NACK") => panic!("{line}: acknowledged"),
                (Ok(read), _) if expected.ends_with("..") => {
                    let start = hex(expected.trim_end_matches("..").trim());
                    assert_eq!(read[..start.len()], start, "{line}");
                }
                (Ok(read), _) if kind == "R" => assert_eq!(read, hex(expected), "{line}"),
                (Ok(_), _) => {}
                (Err(error), _) => panic!("{line}: {error}"),
            }
        }
    }

    /// Selects a block, and returns its bytes and checksum.
    #[track_caller]
    pub(crate) fn block(&self, class: u8, block: u8) -> ([u8; 32], u8) {
        let mut bus = self.sim.bus();
        for write in [[0x61, 0], [0x3E, class], [0x3F, block]] {
            bus.transfer(&write, &mut []).unwrap();
        }
        let mut read = [0; 33];
        bus.transfer(&[0x40], &mut read).unwrap();
        (read[..32].try_into().unwrap(), read[32])
    }

    /// Writes bytes at an offset of a class with the right checksum.
    #[track_caller]
    pub(crate) fn write(&self, class: u8, offset: u8, bytes: &[u8]) {
        let (mut block, _) = self.block(class, offset / 32);
        let at = usize::from(offset % 32);
        block[at..at + bytes.len()].copy_from_slice(bytes);
        let mut message = vec![0x40 + offset % 32];
        message.extend(bytes);
        let mut bus = self.sim.bus();
        bus.transfer(&message, &mut []).unwrap();
        bus.transfer(&[0x60, sum(&block)], &mut []).unwrap();
    }

    #[track_caller]
    pub(crate) fn reset(&self) {
        self.replay(UNSEAL);
        self.replay("W 00 41 00 ; X 200");
    }

    pub(crate) fn word(&self, register: u8) -> u16 {
        let mut read = [0; 2];
        self.sim.bus().transfer(&[register], &mut read).unwrap();
        u16::from_le_bytes(read)
    }

    pub(crate) fn signed(&self, register: u8) -> i16 {
        self.word(register) as i16
    }

    pub(crate) fn percent(&self) -> u8 {
        self.word(0x02) as u8
    }

    pub(crate) fn status(&self) -> u16 {
        self.replay("W 00 00 00");
        self.word(0x00)
    }

    #[track_caller]
    pub(crate) fn set(&self, knob: &str, text: &str) {
        self.sim.set(knob, text).unwrap();
    }

    pub(crate) fn number(&self, knob: &str) -> f64 {
        self.sim.get(knob).unwrap().parse().unwrap()
    }

    pub(crate) fn sleep(&self, seconds: u64) {
        self.clock.sleep(Duration::from_secs(seconds));
    }

    pub(crate) fn acknowledged(&self) -> bool {
        self.sim.bus().transfer(&[0x08], &mut [0; 2]).is_ok()
    }
}

pub(crate) fn sum(bytes: &[u8]) -> u8 {
    255 - bytes.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte))
}

pub(crate) fn hex(text: &str) -> Vec<u8> {
    text.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).expect(byte)).collect()
}

pub(crate) fn packed(text: &str) -> String {
    text.as_bytes().chunks(2).map(|pair| format!("{}{} ", pair[0] as char, pair[1] as char)).collect()
}

pub(crate) const UNSEAL: &str = "W 00 14 04 ; W 00 72 36";
