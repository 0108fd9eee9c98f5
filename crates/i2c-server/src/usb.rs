// SPDX-License-Identifier: MIT

//! An adapter for the kernel: an i2c-tiny-usb over USB/IP.
//!
//! The kernel's `vhci_hcd` accepts a socket as a USB device (`Documentation/usb/usbip_protocol.rst`), here an
//! i2c-tiny-usb, for which the kernel's driver makes an adapter (`drivers/i2c/busses/i2c-tiny-usb.c`). All requests are
//! control transfers. Only root may plug the socket in; serving it takes no privilege.

use std::io::{Error, ErrorKind, Read, Result, Write};

use rustix::io::Errno;

use crate::adapter::Adapter;
use crate::client::Client;
use crate::message::{MAX_LENGTH, Message};
use crate::request::{MAX_MESSAGES, Request};

/// USB_SPEED_FULL, the device's speed.
pub const SPEED: u32 = 2;

/// Vendor and product by which the kernel's driver knows an i2c-tiny-usb.
const IDS: [u8; 4] = [0x03, 0x04, 0x31, 0xc6];
/// Number, text: vendor, product, serial number.
const STRINGS: [&str; 3] = ["gaugefs", "simulated I2C bus", "1"];
// Commands of USB/IP.
const SUBMIT: u32 = 1;
const UNLINK: u32 = 2;
const RET_SUBMIT: u32 = 3;
const RET_UNLINK: u32 = 4;
const HEAD: usize = 48;
/// Longest control transfer: its length has 16 bits.
const LONGEST: usize = 0xffff;

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    bytes.get(at..).and_then(|rest| rest.first_chunk()).map_or(0, |field| u32::from_be_bytes(*field))
}

/// Serves the kernel at the other end of a socket until it releases the device.
///
/// An error is the socket's, or `InvalidData` for anything but a USB/IP request, after which nothing can be understood.
pub fn serve(mut socket: impl Read + Write, adapter: &Adapter) -> Result<()> {
    let wrong = |what: &str| Err(Error::new(ErrorKind::InvalidData, what));
    let mut device = Device::default();
    let mut head = [0; HEAD];
    loop {
        match socket.read_exact(&mut head) {
            Ok(()) => {}
            Err(error) if matches!(error.kind(), ErrorKind::UnexpectedEof | ErrorKind::ConnectionReset) => {
                return Ok(());
            }
            Err(error) => return Err(error),
        }
        let (code, sequence) = (u32_at(&head, 0), u32_at(&head, 4));
        let (is_in, endpoint, length) =
            (u32_at(&head, 12) == 1, u32_at(&head, 16), u32_at(&head, 24) as usize);
        let mut answer = Vec::new();
        let (code, status, count) = match code {
            SUBMIT if length > LONGEST => return wrong("it sends more than a control transfer holds"),
            SUBMIT => {
                let mut data = vec![0; if is_in { 0 } else { length }];
                socket.read_exact(&mut data)?;
                let setup = Setup::new(head[40..].first_chunk().expect("eight bytes"));
                // Control transfers have the only endpoint.
                let outcome = if endpoint == 0 { device.control(adapter, &setup, &data) } else { Err(Stall) };
                match outcome {
                    Ok(bytes) if is_in => {
                        answer = bytes;
                        answer.truncate(length);
                        (RET_SUBMIT, 0, answer.len())
                    }
                    Ok(_) => (RET_SUBMIT, 0, length),
                    Err(Stall) => (RET_SUBMIT, -Errno::PIPE.raw_os_error(), 0),
                }
            }
            // Every request is answered before the next one is read.
            UNLINK => (RET_UNLINK, 0, 0),
            _ => return wrong("it sends what is no request of USB/IP"),
        };
        let mut reply = Vec::with_capacity(HEAD + answer.len());
        for field in [code, sequence, 0, 0, 0, status as u32, count as u32] {
            reply.extend(field.to_be_bytes());
        }
        reply.resize(HEAD, 0);
        reply.extend(answer);
        match socket.write_all(&reply) {
            Ok(()) => {}
            Err(error) if error.kind() == ErrorKind::BrokenPipe => return Ok(()),
            Err(error) => return Err(error),
        }
    }
}

struct Setup {
    kind: u8,
    request: u8,
    value: u16,
    index: u16,
    length: usize,
}

impl Setup {
    fn new(&[kind, request, v0, v1, i0, i1, l0, l1]: &[u8; 8]) -> Self {
        let word = |low, high| u16::from_le_bytes([low, high]);
        Self { kind, request, value: word(v0, v1), index: word(i0, i1), length: word(l0, l1).into() }
    }
}

#[derive(Debug, PartialEq, Eq)]
struct Stall;

#[derive(Default)]
struct Device {
    client: Client,
    /// Writes of an incomplete transfer.
    waiting: Vec<Message>,
    /// GET_STATUS: the last message's.
    status: Status,
}

/// STATUS_ of i2c-tiny-usb.
#[derive(Clone, Copy, Default)]
enum Status {
    #[default]
    Idle = 0,
    Acknowledged = 1,
    Refused = 2,
}

impl Device {
    /// Carries out a control transfer. Returns what is read.
    fn control(
        &mut self,
        adapter: &Adapter,
        setup: &Setup,
        data: &[u8],
    ) -> std::result::Result<Vec<u8>, Stall> {
        const VENDOR: u8 = 0x40;
        const KIND: u8 = 0x60;
        if setup.kind & KIND == VENDOR { self.vendor(adapter, setup, data) } else { standard(setup) }
    }

    fn vendor(
        &mut self,
        adapter: &Adapter,
        setup: &Setup,
        data: &[u8],
    ) -> std::result::Result<Vec<u8>, Stall> {
        const ECHO: u8 = 0;
        const GET_FUNC: u8 = 1;
        const SET_DELAY: u8 = 2;
        const GET_STATUS: u8 = 3;
        /// Plus two bits for the first and the last message of a transfer.
        const I2C_IO: u8 = 4;
        const FIRST: u8 = 1;
        const LAST: u8 = 2;
        match setup.request {
            ECHO => Ok(setup.value.to_le_bytes().into()),
            GET_FUNC => Ok((adapter.functions() as u32).to_le_bytes().into()),
            SET_DELAY => Ok(Vec::new()),
            GET_STATUS => Ok(vec![self.status as u8]),
            request if request & !(FIRST | LAST) == I2C_IO => {
                if request & FIRST != 0 {
                    self.waiting.clear();
                }
                self.message(adapter, setup, data, request & LAST != 0)
            }
            _ => Err(Stall),
        }
    }

    /// A message of a transfer. Writes wait for the rest of it; a read is sent with them, as a repeated START.
    fn message(
        &mut self,
        adapter: &Adapter,
        setup: &Setup,
        data: &[u8],
        is_last: bool,
    ) -> std::result::Result<Vec<u8>, Stall> {
        /// I2C_M_DMA_SAFE, set by i2c-dev, concerns the kernel's own memory.
        const DMA_SAFE: u16 = 0x0200;
        /// I2C_CLIENT_PEC, which the kernel leaves in the messages of SMBus. The code is one of their bytes.
        const CLIENT_PEC: u16 = 0x0004;
        let (is_read, flags) = (setup.value & 1 != 0, setup.value & !(DMA_SAFE | CLIENT_PEC));
        let data = if is_read { vec![0; setup.length] } else { data.to_vec() };
        // At most 42 messages; a kernel driver may send longer ones than a program.
        if data.len() > MAX_LENGTH || self.waiting.len() > MAX_MESSAGES {
            self.waiting.clear();
            return Err(Stall);
        }
        self.waiting.push(Message { address: setup.index, flags, data, destination: 0 });
        self.status = Status::Acknowledged;
        if !is_read && !is_last {
            return Ok(Vec::new());
        }
        let outcome = self.client.run(adapter, Request::Messages(std::mem::take(&mut self.waiting)));
        match outcome {
            Ok(mut outcome) => Ok(outcome.writes.pop().map(|(_, bytes)| bytes).unwrap_or_default()),
            // The driver reads as many bytes as it asked for, and then the status. It has one error for all others.
            Err(Errno::NXIO) => {
                self.status = Status::Refused;
                Ok(vec![0; if is_read { setup.length } else { 0 }])
            }
            Err(_) => Err(Stall),
        }
    }
}

/// Requests that every USB device answers (USB 2.0, 9.4).
fn standard(setup: &Setup) -> std::result::Result<Vec<u8>, Stall> {
    const GET_STATUS: u8 = 0;
    const CLEAR_FEATURE: u8 = 1;
    const SET_FEATURE: u8 = 3;
    const SET_ADDRESS: u8 = 5;
    const GET_DESCRIPTOR: u8 = 6;
    const SET_CONFIGURATION: u8 = 9;
    const SET_INTERFACE: u8 = 11;
    match setup.request {
        GET_STATUS => Ok(vec![0; 2]),
        CLEAR_FEATURE | SET_FEATURE | SET_ADDRESS | SET_CONFIGURATION | SET_INTERFACE => Ok(Vec::new()),
        GET_DESCRIPTOR => descriptor(setup.value),
        _ => Err(Stall),
    }
}

fn descriptor(value: u16) -> std::result::Result<Vec<u8>, Stall> {
    const DEVICE: u8 = 1;
    const CONFIGURATION: u8 = 2;
    const STRING: u8 = 3;
    /// English (United States).
    const LANGUAGE: [u8; 2] = [0x09, 0x04];
    let [number, kind] = value.to_le_bytes();
    match (kind, number) {
        (DEVICE, _) => {
            // USB 1.1, a class of its own, packets of 64 bytes; then version, the strings, one configuration.
            let mut bytes = vec![18, DEVICE, 0x10, 0x01, 0xff, 0, 0, 64];
            bytes.extend(IDS);
            bytes.extend([0x05, 0x01, 1, 2, 3, 1]);
            Ok(bytes)
        }
        // One interface without further endpoints, 100 mA of a bus that has none.
        (CONFIGURATION, _) => {
            Ok(vec![9, CONFIGURATION, 18, 0, 1, 1, 0, 0x80, 50, 9, 4, 0, 0, 0, 0xff, 0, 0, 0])
        }
        (STRING, 0) => Ok([&[4, STRING][..], &LANGUAGE].concat()),
        (STRING, number) => {
            let text = STRINGS.get(usize::from(number) - 1).ok_or(Stall)?;
            let units: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
            Ok([&[2 + units.len() as u8, STRING][..], &units].concat())
        }
        _ => Err(Stall),
    }
}

#[cfg(test)]
mod tests {
    use crate::functions::FUNCTIONS;
    use std::os::unix::net::UnixStream;
    use std::thread::{self, JoinHandle};

    use super::*;
    use crate::adapter::Target;

    /// A target that keeps what it is written, and answers with that.
    struct Echo(Vec<u8>);

    impl Target for Echo {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), Errno> {
            if !write.is_empty() {
                self.0 = write.to_vec();
            }
            for (byte, at) in read.iter_mut().zip(self.0.iter().cycle()) {
                *byte = *at;
            }
            Ok(())
        }
    }

    /// Kernel end of the socket.
    struct Kernel {
        socket: UnixStream,
        server: JoinHandle<Result<()>>,
    }

    impl Kernel {
        fn new() -> Self {
            let (socket, theirs) = UnixStream::pair().expect("sockets");
            let adapter = Adapter::new().with(0x55, Echo(Vec::new()));
            Self { socket, server: thread::spawn(move || serve(theirs, &adapter)) }
        }

        fn send(&mut self, code: u32, fields: [u32; 3], setup: [u8; 8], data: &[u8]) {
            let [direction, endpoint, length] = fields;
            let head = [code, 7, 1, direction, endpoint, 0, length, 0, 0, 0];
            let mut request: Vec<u8> = head.iter().flat_map(|field| field.to_be_bytes()).collect();
            request.extend(setup);
            request.extend(data);
            self.socket.write_all(&request).expect("sent");
        }

        /// The status, and what was read.
        fn answer(&mut self, code: u32, is_in: bool) -> (i32, Vec<u8>) {
            let mut head = [0; HEAD];
            self.socket.read_exact(&mut head).expect("an answer");
            assert_eq!((u32_at(&head, 0), u32_at(&head, 4)), (code, 7));
            let mut data = vec![0; if is_in { u32_at(&head, 24) as usize } else { 0 }];
            self.socket.read_exact(&mut data).expect("its data");
            (u32_at(&head, 20) as i32, data)
        }

        fn get(&mut self, kind: u8, request: u8, value: u16, index: u16, length: u16) -> (i32, Vec<u8>) {
            let setup = setup(kind, request, value, index, length);
            self.send(SUBMIT, [1, 0, length.into()], setup, &[]);
            self.answer(RET_SUBMIT, true)
        }

        fn put(&mut self, request: u8, value: u16, index: u16, data: &[u8]) -> i32 {
            let setup = setup(0x40, request, value, index, data.len() as u16);
            self.send(SUBMIT, [0, 0, data.len() as u32], setup, data);
            self.answer(RET_SUBMIT, false).0
        }

        fn status(&mut self) -> u8 {
            self.get(0xc0, 3, 0, 0, 1).1[0]
        }

        fn ends(self) -> Result<()> {
            drop(self.socket);
            self.server.join().expect("no panic")
        }
    }

    fn setup(kind: u8, request: u8, value: u16, index: u16, length: u16) -> [u8; 8] {
        let [v0, v1] = value.to_le_bytes();
        let [i0, i1] = index.to_le_bytes();
        let [l0, l1] = length.to_le_bytes();
        [kind, request, v0, v1, i0, i1, l0, l1]
    }

    #[test]
    fn the_kernel_finds_the_device_that_its_driver_knows() {
        let mut kernel = Kernel::new();
        let (status, device) = kernel.get(0x80, 6, 0x0100, 0, 64);
        assert_eq!((status, device.len(), &device[8..12]), (0, 18, &IDS[..]));
        // As much as requested.
        assert_eq!(kernel.get(0x80, 6, 0x0200, 0, 9), (0, vec![9, 2, 18, 0, 1, 1, 0, 0x80, 50]));
        assert_eq!(kernel.get(0x80, 6, 0x0200, 0, 255).1.len(), 18);
        assert_eq!(kernel.get(0x80, 6, 0x0300, 0, 255).1, [4, 3, 9, 4]);
        assert_eq!(kernel.get(0x80, 6, 0x0301, 0, 255).1, b"\x10\x03g\0a\0u\0g\0e\0f\0s\0");
        assert_eq!(kernel.get(0x80, 6, 0x0304, 0, 255), (-Errno::PIPE.raw_os_error(), vec![]));
        assert_eq!(kernel.get(0xc0, 1, 0, 0, 4).1, (FUNCTIONS as u32).to_le_bytes());
        // There is no other endpoint.
        kernel.send(SUBMIT, [1, 1, 8], [0; 8], &[]);
        assert_eq!(kernel.answer(RET_SUBMIT, true), (-Errno::PIPE.raw_os_error(), vec![]));
        kernel.send(UNLINK, [0, 0, 0], [0; 8], &[]);
        assert_eq!(kernel.answer(RET_UNLINK, false).0, 0);
        kernel.ends().expect("it ends");
    }

    #[test]
    fn the_messages_of_a_transfer_belong_together() {
        let mut kernel = Kernel::new();
        // A write alone, then a read alone.
        assert_eq!(kernel.put(7, 0, 0x55, &[0x10, 0x20]), 0);
        assert_eq!(kernel.status(), 1);
        assert_eq!(kernel.get(0xc0, 7, 1, 0x55, 3), (0, vec![0x10, 0x20, 0x10]));
        // A write and a read with a repeated START.
        assert_eq!(kernel.put(5, 0, 0x55, &[0x08]), 0);
        assert_eq!(kernel.get(0xc0, 6, 1, 0x55, 2), (0, vec![0x08, 0x08]));
        assert_eq!(kernel.status(), 1);
        // As i2c-dev marks its buffers.
        assert_eq!(kernel.put(5, 0x0200, 0x55, &[0x09]), 0);
        assert_eq!(kernel.get(0xc0, 6, 0x0201, 0x55, 2), (0, vec![0x09, 0x09]));
        // As the drivers of clients with packet error codes do.
        assert_eq!(kernel.put(5, 0x0004, 0x55, &[0x0a]), 0);
        assert_eq!(kernel.get(0xc0, 6, 0x0005, 0x55, 3), (0, vec![0x0a; 3]));
        // Without a target.
        assert_eq!(kernel.put(5, 0, 0x54, &[0x08]), 0);
        assert_eq!(kernel.get(0xc0, 6, 1, 0x54, 2), (0, vec![0, 0]));
        assert_eq!(kernel.status(), 2);
        assert_eq!(kernel.put(7, 0, 0x54, &[]), 0);
        assert_eq!(kernel.status(), 2);
        // A transfer without an end is not sent with the next one.
        assert_eq!(kernel.put(5, 0, 0x55, &[0x66]), 0);
        assert_eq!(kernel.get(0xc0, 7, 1, 0x55, 1), (0, vec![0x0a]));
        // Unsupported flags, and more than a message holds.
        assert_eq!(kernel.put(7, 0x10, 0x55, &[1]), -Errno::PIPE.raw_os_error());
        assert_eq!(kernel.put(7, 0, 0x55, &[1; MAX_LENGTH + 1]), -Errno::PIPE.raw_os_error());
        kernel.ends().expect("it ends");
    }

    #[test]
    fn what_is_no_request_ends_the_server_with_a_reason() {
        let mut kernel = Kernel::new();
        kernel.send(9, [0; 3], [0; 8], &[]);
        assert!(kernel.ends().expect_err("refused").to_string().contains("no request of USB/IP"));
        let mut kernel = Kernel::new();
        kernel.send(SUBMIT, [0, 0, 0x10000], [0; 8], &[]);
        assert!(
            kernel.ends().expect_err("refused").to_string().contains("more than a control transfer holds")
        );
        // Every setup gets one answer.
        let mut kernel = Kernel::new();
        for number in 0..=u16::MAX {
            let [low, high] = number.to_le_bytes();
            let setup = [low, high, high ^ 1, low, 0x55, 0, 4, 0];
            kernel.send(SUBMIT, [1, 0, 4], setup, &[]);
            assert!(kernel.answer(RET_SUBMIT, true).1.len() <= 4);
        }
        kernel.ends().expect("it ends");
    }
}
