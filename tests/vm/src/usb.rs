// SPDX-License-Identifier: MIT

//! A USB HID device as a USB/IP server, for the kernel's `vhci_hcd`: the requests of the kernel, the descriptors of USB
//! (USB 2.0, 9.6; HID 1.11, 6.2) and the counts of reports. What the reports mean is the [`Firmware`]'s.

mod cp2112;
mod ft260;
mod mcp2221;

use std::collections::VecDeque;
use std::fmt;
use std::io::{self, Read as _, Write as _};
use std::os::unix::net::UnixStream;

use crate::board::Board;

/// Bytes of a report that is sent, at most.
pub(crate) const REPORT: usize = 64;

/// What a bridge is beyond a HID device.
pub(crate) trait Firmware: fmt::Debug + Send {
    /// Vendor and product.
    fn ids(&self) -> [u16; 2];
    /// Report descriptor.
    fn descriptor(&self) -> Vec<u8>;
    fn feature(&mut self, id: u8) -> Option<Vec<u8>>;
    fn set_feature(&mut self, report: &[u8]);
    /// An output report. Returns input reports.
    fn output(&mut self, report: &[u8; REPORT], board: &mut Board) -> Vec<Vec<u8>>;
}

/// The bridge of this name, as it is when it gets power.
pub(crate) fn firmware(name: &str) -> Option<Box<dyn Firmware>> {
    match name {
        "cp2112" => Some(Box::<cp2112::Cp2112>::default()),
        "mcp2221" => Some(Box::<mcp2221::Mcp2221>::default()),
        "ft260" => Some(Box::<ft260::Ft260>::default()),
        _ => None,
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) enum Kind {
    Input = 0x81,
    Output = 0x91,
    Feature = 0xb1,
}

/// A report descriptor in the making: reports of bytes, of a page of the vendor's.
#[derive(Debug)]
pub(crate) struct Descriptor(Vec<u8>);

impl Default for Descriptor {
    fn default() -> Self {
        Self(vec![0x06, 0x00, 0xff, 0x09, 1, 0xa1, 1])
    }
}

impl Descriptor {
    /// A report without a number.
    pub(crate) fn plain(&mut self, kind: Kind, size: u8) -> &mut Self {
        self.0.extend([0x95, size, 0x75, 8, 0x15, 0, 0x26, 0xff, 0, 0x09, 1, kind as u8, 2]);
        self
    }

    pub(crate) fn report(&mut self, id: u8, kind: Kind, size: u8) -> &mut Self {
        self.0.extend([0x85, id]);
        self.plain(kind, size)
    }

    pub(crate) fn end(mut self) -> Vec<u8> {
        self.0.push(0xc0);
        self.0
    }
}

/// USB transfers since the start or the last reset.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Counts {
    pub(crate) output: u64,
    pub(crate) input: u64,
    pub(crate) control: u64,
}

/// A device that is plugged in.
#[derive(Debug)]
pub(crate) struct Device {
    firmware: Box<dyn Firmware>,
    /// Requests for an input report, by their numbers, with the bytes that there is room for.
    asked: VecDeque<(u32, usize)>,
    /// Input reports that nobody has asked for yet.
    ready: VecDeque<Vec<u8>>,
}

/// A request of the kernel.
#[derive(Debug)]
pub(crate) enum Request {
    Unlink { sequence: u32, of: u32 },
    Submit { sequence: u32, is_in: bool, endpoint: u32, length: usize, setup: [u8; 8], data: Vec<u8> },
}

const SUBMIT: u32 = 1;
const UNLINK: u32 = 2;
const RET_SUBMIT: u32 = 3;
const RET_UNLINK: u32 = 4;
const HEAD: usize = 48;
/// Their values in Linux.
const ECONNRESET: i32 = 104;
const EPIPE: i32 = 32;

impl Request {
    /// Waits for the next one.
    pub(crate) fn read(mut socket: &UnixStream) -> io::Result<Self> {
        let mut head = [0; HEAD];
        socket.read_exact(&mut head)?;
        let field = |at: usize| u32::from_be_bytes(*head[4 * at..].first_chunk().expect("four bytes"));
        let sequence = field(1);
        if field(0) == UNLINK {
            return Ok(Self::Unlink { sequence, of: field(5) });
        }
        if field(0) != SUBMIT {
            return Err(io::ErrorKind::InvalidData.into());
        }
        let (is_in, length) = (field(3) == 1, field(6) as usize);
        let mut data = vec![0; if is_in { 0 } else { length }];
        socket.read_exact(&mut data)?;
        let setup = *head[40..].first_chunk().expect("eight bytes");
        Ok(Self::Submit { sequence, is_in, endpoint: field(4), length, setup, data })
    }
}

fn reply(
    mut socket: &UnixStream,
    code: u32,
    sequence: u32,
    outcome: Result<&[u8], i32>,
    count: usize,
) -> io::Result<()> {
    let status = outcome.err().map_or(0, |errno| -errno);
    let mut bytes = Vec::with_capacity(HEAD + REPORT);
    for field in [code, sequence, 0, 0, 0, status as u32, count as u32] {
        bytes.extend(field.to_be_bytes());
    }
    bytes.resize(HEAD, 0);
    bytes.extend(outcome.unwrap_or_default());
    socket.write_all(&bytes)
}

impl Device {
    pub(crate) fn new(firmware: Box<dyn Firmware>) -> Self {
        Self { firmware, asked: VecDeque::new(), ready: VecDeque::new() }
    }

    /// Answers a request. Whether the device goes on: it may be pulled meanwhile.
    pub(crate) fn serve(
        &mut self,
        socket: &UnixStream,
        request: Request,
        board: &mut Board,
        counts: &mut Counts,
    ) -> io::Result<bool> {
        match request {
            Request::Unlink { sequence, of } => {
                let before = self.asked.len();
                self.asked.retain(|asked| asked.0 != of);
                let outcome = if self.asked.len() < before { Err(ECONNRESET) } else { Ok(&[][..]) };
                reply(socket, RET_UNLINK, sequence, outcome, 0)?;
            }
            Request::Submit { sequence, is_in, endpoint: 0, length, setup, data } => {
                counts.control += 1;
                match self.control(setup, &data) {
                    None => reply(socket, RET_SUBMIT, sequence, Err(EPIPE), 0)?,
                    Some(answer) if is_in => {
                        let answer = &answer[..answer.len().min(length)];
                        reply(socket, RET_SUBMIT, sequence, Ok(answer), answer.len())?;
                    }
                    Some(_) => reply(socket, RET_SUBMIT, sequence, Ok(&[]), length)?,
                }
            }
            Request::Submit { sequence, is_in: true, length, .. } => {
                self.asked.push_back((sequence, length));
                self.deliver(socket, counts)?;
            }
            Request::Submit { sequence, length, mut data, .. } => {
                counts.output += 1;
                reply(socket, RET_SUBMIT, sequence, Ok(&[]), length)?;
                data.resize(REPORT, 0);
                let report = data.first_chunk().expect("as long as a report");
                self.ready.extend(self.firmware.output(report, board));
                if board.is_pulled() {
                    return Ok(false);
                }
                self.deliver(socket, counts)?;
            }
        }
        Ok(true)
    }

    fn deliver(&mut self, socket: &UnixStream, counts: &mut Counts) -> io::Result<()> {
        while !self.asked.is_empty()
            && let Some(report) = self.ready.pop_front()
            && let Some((sequence, room)) = self.asked.pop_front()
        {
            counts.input += 1;
            let report = &report[..report.len().min(room)];
            reply(socket, RET_SUBMIT, sequence, Ok(report), report.len())?;
        }
        Ok(())
    }

    /// A control transfer. Returns what is read; nothing if it is refused.
    fn control(&mut self, setup: [u8; 8], data: &[u8]) -> Option<Vec<u8>> {
        const KIND: u8 = 0x60;
        const CLASS: u8 = 0x20;
        const GET_REPORT: u8 = 1;
        const SET_REPORT: u8 = 9;
        const GET_STATUS: u8 = 0;
        const GET_DESCRIPTOR: u8 = 6;
        let [kind, request, number, of, ..] = setup;
        match (kind & KIND == CLASS, request) {
            (true, GET_REPORT) => return self.firmware.feature(number),
            (true, SET_REPORT) => self.firmware.set_feature(data),
            (false, GET_STATUS) => return Some(vec![0; 2]),
            (false, GET_DESCRIPTOR) => return self.described(of, number),
            _ => {}
        }
        Some(Vec::new())
    }

    fn described(&self, kind: u8, number: u8) -> Option<Vec<u8>> {
        const DEVICE: u8 = 1;
        const CONFIGURATION: u8 = 2;
        const STRING: u8 = 3;
        const HID: u8 = 0x21;
        const REPORTS: u8 = 0x22;
        /// English (United States).
        const LANGUAGE: [u8; 4] = [4, STRING, 0x09, 0x04];
        match kind {
            DEVICE => {
                // USB 2.0, packets of 64 bytes; then version, the strings and one configuration.
                let ids = self.firmware.ids().map(u16::to_le_bytes).concat();
                Some([&[18, DEVICE, 0, 2, 0, 0, 0, 64][..], &ids, &[0, 1, 1, 2, 3, 1]].concat())
            }
            CONFIGURATION => {
                let [low, high] = (self.firmware.descriptor().len() as u16).to_le_bytes();
                Some(
                    [
                        &[9, CONFIGURATION, 41, 0, 1, 1, 0, 0x80, 50][..],
                        &[9, 4, 0, 0, 2, 3, 0, 0, 0],
                        &[9, HID, 0x11, 1, 0, 1, REPORTS, low, high],
                        // Interrupt endpoints, one each way, of 64 bytes each millisecond.
                        &[7, 5, 0x81, 3, 64, 0, 1],
                        &[7, 5, 0x02, 3, 64, 0, 1],
                    ]
                    .concat(),
                )
            }
            STRING if number == 0 => Some(LANGUAGE.to_vec()),
            STRING => Some(vec![4, STRING, b'x', 0]),
            REPORTS => Some(self.firmware.descriptor()),
            _ => None,
        }
    }
}
