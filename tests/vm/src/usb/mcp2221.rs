// SPDX-License-Identifier: MIT

//! MCP2221 of Microchip (DS20005565): each report gets one.

use crate::board::{Board, Engine, Nack};
use crate::usb::{Descriptor, Firmware, Kind, REPORT};

#[derive(Debug, Default)]
pub(super) struct Mcp2221 {
    engine: Engine,
    /// A write that is still being sent to the bridge.
    coming: Option<Coming>,
    /// A write without STOP.
    held: Option<Vec<u8>>,
}

/// Command, all its bytes, and those that are here.
#[derive(Debug)]
struct Coming(u8, usize, Vec<u8>);

/// Writes with and without STOP, reads with START and repeated START, and the bytes read.
const WRITE: u8 = 0x90;
const WRITE_HOLD: u8 = 0x94;
const READ: u8 = 0x91;
const READ_RESTART: u8 = 0x93;
const GET: u8 = 0x40;
const STATUS: u8 = 0x10;
/// State of the engine: the address was not acknowledged.
const NO_ADDRESS: u8 = 0x25;
const MOST: usize = 60;

impl Firmware for Mcp2221 {
    fn ids(&self) -> [u16; 2] {
        [0x04d8, 0x00dd]
    }

    fn descriptor(&self) -> Vec<u8> {
        let mut all = Descriptor::default();
        all.plain(Kind::Input, 64).plain(Kind::Output, 64);
        all.end()
    }

    fn feature(&mut self, _id: u8) -> Option<Vec<u8>> {
        None
    }

    fn set_feature(&mut self, _report: &[u8]) {}

    fn output(&mut self, report: &[u8; REPORT], board: &mut Board) -> Vec<Vec<u8>> {
        let command = report[0];
        let mut answer = vec![0; REPORT];
        answer[0] = command;
        let length = usize::from(u16::from_le_bytes([report[1], report[2]]));
        let address = report[3] >> 1;
        match command {
            STATUS => self.status(report, &mut answer),
            WRITE | WRITE_HOLD if self.engine.is_busy() => answer[1..3].copy_from_slice(&[1, 1]),
            WRITE | WRITE_HOLD => {
                let is_next =
                    self.coming.as_ref().is_some_and(|coming| (coming.0, coming.1) == (command, length));
                if !is_next {
                    self.coming = None;
                }
                let Coming(_, _, bytes) = self.coming.get_or_insert(Coming(command, length, Vec::new()));
                let here = (length - bytes.len()).min(MOST);
                bytes.extend(&report[4..][..here]);
                if bytes.len() >= length {
                    let bytes = std::mem::take(bytes);
                    self.coming = None;
                    self.write(command, address, bytes, board);
                }
            }
            READ => self.engine.start(board, address, None, Some(length)),
            READ_RESTART if self.engine.nack().is_some() => answer[1..3].copy_from_slice(&[1, NO_ADDRESS]),
            READ_RESTART => {
                let write = self.held.take();
                self.engine.start(board, address, write.as_deref(), Some(length));
            }
            GET if self.engine.is_busy() => answer[1..4].copy_from_slice(&[0x41, 0x21, 127]),
            GET if self.engine.nack().is_some() => answer[1..4].copy_from_slice(&[0, NO_ADDRESS, 127]),
            GET => {
                let bytes = self.engine.take(MOST).to_vec();
                answer[2] = if self.engine.left() > 0 { 0x54 } else { 0x55 };
                answer[3] = bytes.len() as u8;
                answer[4..][..bytes.len()].copy_from_slice(&bytes);
            }
            _ => {}
        }
        vec![answer]
    }
}

impl Mcp2221 {
    fn write(&mut self, command: u8, address: u8, bytes: Vec<u8>, board: &mut Board) {
        if command == WRITE {
            self.engine.start(board, address, Some(&bytes), None);
        } else {
            // Its bytes reach the gauge with the read that follows.
            let there = board.acknowledges(address.into());
            self.engine.set(if there { Ok(Vec::new()) } else { Err(Nack::Address) });
            self.held = Some(bytes);
        }
    }

    fn status(&mut self, report: &[u8; REPORT], answer: &mut [u8]) {
        const CANCEL: u8 = 0x10;
        const SET_SPEED: u8 = 0x20;
        if report[2] == CANCEL {
            answer[2] = if self.engine.is_busy() { 0x10 } else { 0x11 };
            self.engine = Engine::default();
            (self.held, self.coming) = (None, None);
        }
        if report[3] == SET_SPEED {
            answer[3..5].copy_from_slice(&report[3..5]);
        }
        let nack = self.engine.nack().filter(|_| !self.engine.is_busy());
        answer[8] = match nack {
            _ if self.engine.is_busy() => 0x41,
            None => 0,
            Some(Nack::Data) => 0x45,
            Some(Nack::Address | Nack::Restart) => NO_ADDRESS,
        };
        answer[20] = if matches!(nack, Some(Nack::Address | Nack::Data)) { 0x40 } else { 0 };
        // Both lines are high; the revisions of hardware and firmware.
        answer[22..24].copy_from_slice(&[1, 1]);
        answer[46..50].copy_from_slice(b"A611");
    }
}
