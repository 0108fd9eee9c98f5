// SPDX-License-Identifier: MIT

//! FT260 of FTDI (AN_394), in its I2C mode.

use std::thread;
use std::time::Instant;

use crate::board::{Board, Engine, Nack};
use crate::usb::{Descriptor, Firmware, Kind, REPORT};

#[derive(Debug)]
pub(super) struct Ft260 {
    engine: Engine,
    kilohertz: u16,
    /// Bytes of a write, of which more follow.
    coming: Vec<u8>,
    /// A write without STOP.
    held: Option<Vec<u8>>,
}

impl Default for Ft260 {
    fn default() -> Self {
        Self { engine: Engine::default(), kilohertz: 100, coming: Vec::new(), held: None }
    }
}

const CHIP: u8 = 0xa0;
const SYSTEM: u8 = 0xa1;
const STATUS: u8 = 0xc0;
const READ: u8 = 0xc2;
/// Reports of up to 4, 8, ... 60 bytes.
const DATA: std::ops::RangeInclusive<u8> = 0xd0..=0xde;
const MOST: usize = 60;
/// Conditions that go with a message. A repeated START is 3.
const START: u8 = 2;
const STOP: u8 = 4;

impl Firmware for Ft260 {
    fn ids(&self) -> [u16; 2] {
        [0x0403, 0x6030]
    }

    fn descriptor(&self) -> Vec<u8> {
        let mut all = Descriptor::default();
        all.report(CHIP, Kind::Feature, 12).report(SYSTEM, Kind::Feature, 24);
        all.report(STATUS, Kind::Feature, 4).report(READ, Kind::Output, 4);
        for id in DATA {
            let most = 4 * (id - DATA.start() + 1);
            all.report(id, Kind::Input, 1 + most).report(id, Kind::Output, 3 + most);
        }
        all.end()
    }

    fn feature(&mut self, id: u8) -> Option<Vec<u8>> {
        let [low, high] = self.kilohertz.to_le_bytes();
        let (first, size) = match id {
            CHIP => (vec![2, 0x60, 2], 13),
            SYSTEM => (vec![1, 2, 0, 1, 1], 25),
            STATUS => (vec![self.status(), low, high], 5),
            _ => return None,
        };
        let mut report = [vec![id], first].concat();
        report.resize(size, 0);
        Some(report)
    }

    fn set_feature(&mut self, report: &[u8]) {
        const RESET: u8 = 0x20;
        const CLOCK: u8 = 0x22;
        match *report {
            [SYSTEM, RESET, ..] => {
                self.engine.set(Ok(Vec::new()));
                self.held = None;
            }
            [SYSTEM, CLOCK, low, high, ..] => self.kilohertz = u16::from_le_bytes([low, high]),
            _ => {}
        }
    }

    fn output(&mut self, report: &[u8; REPORT], board: &mut Board) -> Vec<Vec<u8>> {
        let (id, address, flags) = (report[0], report[1], report[2]);
        if id == READ {
            let length = u16::from_le_bytes([report[3], report[4]]).into();
            // START while the bus is held is a repeated START.
            let write = self.held.take().filter(|_| flags & START != 0);
            self.engine.start(board, address, write.as_deref(), Some(length));
            return self.deliver(length);
        }
        if DATA.contains(&id) {
            if flags & START != 0 {
                self.coming.clear();
            }
            self.coming.extend(&report[4..][..usize::from(report[3]).min(MOST)]);
            self.held = None;
            if flags & STOP != 0 {
                let bytes = std::mem::take(&mut self.coming);
                self.engine.start(board, address, Some(&bytes), None);
            } else {
                let there = board.acknowledges(address.into());
                self.engine.set(if there { Ok(Vec::new()) } else { Err(Nack::Address) });
                self.held = Some(self.coming.clone());
            }
        }
        Vec::new()
    }
}

impl Ft260 {
    fn status(&self) -> u8 {
        const BUSY: u8 = 0x01;
        const ERROR: u8 = 0x02;
        const NO_ADDRESS: u8 = 0x04;
        const NO_DATA: u8 = 0x08;
        const IDLE: u8 = 0x20;
        const BUS_BUSY: u8 = 0x40;
        if self.engine.is_busy() {
            return BUSY | BUS_BUSY;
        }
        let held = if self.held.is_some() { BUS_BUSY } else { 0 };
        let nack = match self.engine.nack() {
            None => 0,
            Some(Nack::Data) => ERROR | NO_DATA,
            Some(Nack::Address | Nack::Restart) => ERROR | NO_ADDRESS,
        };
        IDLE | held | nack
    }

    /// What is read, in reports. After a refused read the driver gets bytes too, and asks for the status.
    fn deliver(&mut self, length: usize) -> Vec<Vec<u8>> {
        thread::sleep(self.engine.until().saturating_duration_since(Instant::now()));
        let bytes = match self.engine.nack() {
            Some(_) => vec![0xff; length],
            None => self.engine.take(length).to_vec(),
        };
        let report = |bytes: &[u8]| {
            let step = bytes.len().div_ceil(4);
            let mut report = [&[*DATA.start() + step as u8 - 1, bytes.len() as u8], bytes].concat();
            report.resize(2 + 4 * step, 0);
            report
        };
        bytes.chunks(MOST).map(report).collect()
    }
}
