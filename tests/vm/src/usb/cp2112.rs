// SPDX-License-Identifier: MIT

//! CP2112 of Silicon Labs (AN495), of revision 2.

use crate::board::{Board, Engine, Nack};
use crate::usb::{Descriptor, Firmware, Kind, REPORT};

#[derive(Debug)]
pub(super) struct Cp2112 {
    engine: Engine,
    /// Report 6: clock, address, times and retries.
    settings: [u8; 14],
}

impl Default for Cp2112 {
    fn default() -> Self {
        Self { engine: Engine::default(), settings: [6, 0, 1, 0x86, 0xa0, 2, 0, 0, 0, 0, 0, 0, 0, 0] }
    }
}

fn count(high: u8, low: u8) -> usize {
    u16::from_be_bytes([high, low]).into()
}

impl Firmware for Cp2112 {
    fn ids(&self) -> [u16; 2] {
        [0x10c4, 0xea90]
    }

    fn descriptor(&self) -> Vec<u8> {
        let mut all = Descriptor::default();
        for id in [0x10, 0x11, 0x12, 0x14, 0x15, 0x17] {
            all.report(id, Kind::Output, 63);
        }
        all.report(0x13, Kind::Input, 63).report(0x16, Kind::Input, 63);
        for (id, size) in [(2, 4), (3, 1), (4, 2), (5, 2), (6, 13), (0x20, 1), (0x21, 9)] {
            all.report(id, Kind::Feature, size);
        }
        for id in 0x22..0x25 {
            all.report(id, Kind::Feature, 62);
        }
        all.end()
    }

    fn feature(&mut self, id: u8) -> Option<Vec<u8>> {
        let filled = |first: &[u8], size| {
            let mut report = vec![id];
            report.extend(first);
            report.resize(size, 0);
            Some(report)
        };
        match id {
            2 => filled(&[], 5),
            3 | 0x20 => filled(&[], 2),
            5 => filled(&[0x0c, 2], 3),
            6 => Some(self.settings.to_vec()),
            0x21 => filled(&[], 10),
            // A string of one letter.
            0x22..=0x24 => filled(&[4, 3, b'x'], 63),
            _ => None,
        }
    }

    fn set_feature(&mut self, report: &[u8]) {
        if let Some(settings) = report.first_chunk().filter(|settings| settings[0] == 6) {
            self.settings = *settings;
        }
    }

    fn output(&mut self, report: &[u8; REPORT], board: &mut Board) -> Vec<Vec<u8>> {
        let address = report[1] >> 1;
        match report[0] {
            0x10 => self.engine.start(board, address, None, Some(count(report[2], report[3]))),
            0x11 => {
                let write = &report[5..][..usize::from(report[4]).min(16)];
                self.engine.start(board, address, Some(write), Some(count(report[2], report[3])));
            }
            0x14 => {
                let write = &report[3..][..usize::from(report[2]).min(61)];
                self.engine.start(board, address, Some(write), None);
            }
            0x15 => return vec![self.status()],
            0x12 => {
                let mut answer = vec![0; REPORT];
                let bytes = self.engine.take(count(report[1], report[2]).min(61));
                answer[..3].copy_from_slice(&[0x13, 2, bytes.len() as u8]);
                answer[3..][..bytes.len()].copy_from_slice(bytes);
                return vec![answer];
            }
            _ => {}
        }
        Vec::new()
    }
}

impl Cp2112 {
    fn status(&self) -> Vec<u8> {
        let [high, low] = (self.engine.left() as u16).to_be_bytes();
        let fields = match self.engine.nack() {
            _ if self.engine.is_busy() => [1, 0, 0, 0, 0, 0],
            _ if !self.engine.has_run() => [0; 6],
            None => [2, 5, 0, 0, high, low],
            Some(Nack::Data) => [3, 4, 0, 0, 0, 0],
            Some(Nack::Address | Nack::Restart) => [3, 0, 0, 0, 0, 0],
        };
        let mut answer = [&[0x16][..], &fields].concat();
        answer.resize(REPORT, 0);
        answer
    }
}
