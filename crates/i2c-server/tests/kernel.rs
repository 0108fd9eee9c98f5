// SPDX-License-Identifier: MIT

//! The interface as the kernel has it: limits, layouts, error numbers, and what a transaction sends on the wire.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use i2c_server::command::*;
use i2c_server::{Adapter, Client, Errno, FUNCTIONS, MAX_LENGTH, MAX_MESSAGES, Memory, Target, Width};

/// Where the caller's memory begins; what is below or behind it cannot be read.
const BASE: u64 = 0x1000;
const RD: u16 = 1;

/// The memory of the caller.
struct Caller(Vec<u8>);

impl Caller {
    fn new() -> Self {
        Self(vec![0; 1 << 20])
    }

    fn put(&mut self, at: u64, bytes: &[u8]) {
        self.write(at, bytes).expect("within its memory");
    }

    fn get(&mut self, at: u64, length: usize) -> Vec<u8> {
        let mut bytes = vec![0; length];
        self.read(at, &mut bytes).expect("within its memory");
        bytes
    }

    /// Puts a pointer or an unsigned long.
    fn put_long(&mut self, at: u64, value: u64, width: Width) {
        match width {
            Width::Bits32 => self.put(at, &(value as u32).to_ne_bytes()),
            Width::Bits64 => self.put(at, &value.to_ne_bytes()),
        }
    }

    /// Puts the argument of I2C_RDWR and returns its address. A message is its address, flags, length and buffer.
    fn messages(&mut self, messages: &[(u16, u16, u16, u64)], width: Width) -> u64 {
        let (list, size) = (BASE + 64, if width == Width::Bits32 { 12 } else { 16 });
        self.put_long(BASE, list, width);
        let count = if width == Width::Bits32 { BASE + 4 } else { BASE + 8 };
        self.put(count, &(messages.len() as u32).to_ne_bytes());
        for (at, (address, flags, length, buffer)) in (0..).zip(messages) {
            let at = list + at * size;
            self.put(at, &[address.to_ne_bytes(), flags.to_ne_bytes(), length.to_ne_bytes()].concat());
            self.put_long(at + 8, *buffer, width);
        }
        BASE
    }

    /// Puts the argument of I2C_SMBUS and returns its address.
    fn smbus(&mut self, direction: u8, command: u8, size: u32, data: u64, width: Width) -> u64 {
        self.put(BASE, &[direction, command, 0, 0]);
        self.put(BASE + 4, &size.to_ne_bytes());
        self.put_long(BASE + 8, data, width);
        BASE
    }
}

impl Memory for Caller {
    fn read(&mut self, at: u64, to: &mut [u8]) -> Result<(), Errno> {
        let start = at.checked_sub(BASE).ok_or(Errno::FAULT)? as usize;
        let from = self.0.get(start..).and_then(|rest| rest.get(..to.len())).ok_or(Errno::FAULT)?;
        to.copy_from_slice(from);
        Ok(())
    }

    fn write(&mut self, at: u64, from: &[u8]) -> Result<(), Errno> {
        let start = at.checked_sub(BASE).ok_or(Errno::FAULT)? as usize;
        let to = self.0.get_mut(start..).and_then(|rest| rest.get_mut(..from.len()));
        to.ok_or(Errno::FAULT)?.copy_from_slice(from);
        Ok(())
    }
}

/// Transfers: what was written, and how much was read.
type Log = Arc<Mutex<Vec<(Vec<u8>, usize)>>>;

/// A memory of 256 bytes behind a pointer, which writes down its transfers.
struct Eeprom {
    bytes: [u8; 256],
    pointer: u8,
    log: Log,
}

impl Target for Eeprom {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), Errno> {
        self.log.lock().expect("the log").push((write.to_vec(), read.len()));
        if let Some((pointer, data)) = write.split_first() {
            self.pointer = *pointer;
            for byte in data {
                self.bytes[usize::from(self.pointer)] = *byte;
                self.pointer = self.pointer.wrapping_add(1);
            }
        }
        for byte in read {
            *byte = self.bytes[usize::from(self.pointer)];
            self.pointer = self.pointer.wrapping_add(1);
        }
        Ok(())
    }
}

struct Rig {
    adapter: Adapter,
    client: Client,
    caller: Caller,
    log: Log,
}

impl Rig {
    fn new() -> Self {
        let log = Log::default();
        let bytes = std::array::from_fn(|at| at as u8);
        let eeprom = Eeprom { bytes, pointer: 0, log: log.clone() };
        let mut rig = Self {
            adapter: Adapter::new().with(0x50, eeprom),
            client: Client::default(),
            caller: Caller::new(),
            log,
        };
        assert_eq!(rig.ioctl(I2C_SLAVE, 0x50), Ok(0));
        rig
    }

    fn ioctl(&mut self, command: u32, argument: u64) -> Result<i32, Errno> {
        self.wide(command, argument, Width::Bits64)
    }

    fn wide(&mut self, command: u32, argument: u64, width: Width) -> Result<i32, Errno> {
        self.client.ioctl(&self.adapter, command, argument, width, &mut self.caller)
    }

    fn rdwr(&mut self, messages: &[(u16, u16, u16, u64)]) -> Result<i32, Errno> {
        let at = self.caller.messages(messages, Width::Bits64);
        self.ioctl(I2C_RDWR, at)
    }

    fn smbus(&mut self, direction: u8, command: u8, size: u32, data: u64) -> Result<i32, Errno> {
        let at = self.caller.smbus(direction, command, size, data, Width::Bits64);
        self.ioctl(I2C_SMBUS, at)
    }

    fn sent(&self) -> Vec<(Vec<u8>, usize)> {
        std::mem::take(&mut *self.log.lock().expect("the log"))
    }
}

/// Where the tests have the data of a call.
const DATA: u64 = BASE + 0x1000;

#[test]
fn a_write_and_a_read_are_one_transfer_for_callers_of_both_widths() {
    for width in [Width::Bits32, Width::Bits64] {
        let mut rig = Rig::new();
        rig.caller.put(DATA, &[0x10]);
        let at = rig.caller.messages(&[(0x50, 0, 1, DATA), (0x50, RD, 3, DATA + 8)], width);
        assert_eq!(rig.wide(I2C_RDWR, at, width), Ok(2));
        assert_eq!(rig.caller.get(DATA + 8, 4), [0x10, 0x11, 0x12, 0]);
        assert_eq!(rig.sent(), [(vec![0x10], 3)]);
        rig.caller.put(DATA, &[0xff; 9]);
        assert_eq!(rig.wide(I2C_FUNCS, DATA, width), Ok(0));
        let long = if width == Width::Bits32 { 4 } else { 8 };
        let all = [&FUNCTIONS.to_ne_bytes()[..long], &[0xff; 1]].concat();
        assert_eq!(rig.caller.get(DATA, long + 1), all, "nothing behind an unsigned long");
        let at = rig.caller.smbus(1, 0x22, 3, DATA, width);
        assert_eq!(rig.wide(I2C_SMBUS, at, width), Ok(0));
        assert_eq!(rig.caller.get(DATA, 2), 0x2322_u16.to_ne_bytes());
    }
}

#[test]
fn the_limits_are_the_kernels() {
    let mut rig = Rig::new();
    let most = vec![(0x50, RD, 1, DATA); MAX_MESSAGES];
    assert_eq!(rig.rdwr(&most), Ok(42));
    assert_eq!(rig.rdwr(&[&most[..], &most[..1]].concat()), Err(Errno::INVAL));
    assert_eq!(rig.rdwr(&[]), Err(Errno::INVAL));
    assert_eq!(rig.rdwr(&[(0x50, RD, 8192, DATA)]), Ok(1));
    assert_eq!(rig.rdwr(&[(0x50, RD, 8193, DATA)]), Err(Errno::INVAL));
    // The first message is not sent either if the second one is refused.
    rig.sent();
    assert_eq!(rig.rdwr(&[(0x50, RD, 1, DATA), (0x50, RD, 8193, DATA)]), Err(Errno::INVAL));
    assert_eq!(rig.rdwr(&[(0x50, RD, 1, DATA), (0x50, 0, 1, 8)]), Err(Errno::FAULT));
    assert_eq!(rig.rdwr(&[(0x50, RD, 1, DATA), (0x50, 0x10, 1, DATA)]), Err(Errno::OPNOTSUPP));
    assert_eq!(rig.sent(), []);
    // read(2) and write(2) move less than they are asked for.
    assert_eq!(rig.client.read(&rig.adapter, 10_000).expect("read").len(), MAX_LENGTH);
    assert_eq!(rig.client.write(&rig.adapter, &[0; 10_000]), Ok(MAX_LENGTH));
}

#[test]
fn errors_are_the_kernels() {
    let mut rig = Rig::new();
    let end = BASE + (1 << 20);
    for (command, argument, errno) in [
        (I2C_SLAVE, 0x80, Errno::INVAL),
        (I2C_SLAVE_FORCE, u64::MAX, Errno::INVAL),
        (I2C_RETRIES, 1 << 31, Errno::INVAL),
        (I2C_TIMEOUT, 1 << 31, Errno::INVAL),
        (I2C_FUNCS, 8, Errno::FAULT),
        (I2C_FUNCS, end - 4, Errno::FAULT),
        (I2C_RDWR, 0, Errno::FAULT),
        (I2C_RDWR, end - 8, Errno::FAULT),
        (I2C_SMBUS, 0, Errno::FAULT),
        (0x0709, 0, Errno::NOTTY),
        (0x5401, 0, Errno::NOTTY),
    ] {
        assert_eq!(rig.ioctl(command, argument), Err(errno), "0x{command:04x}");
    }
    for (command, argument) in [(I2C_RETRIES, 3), (I2C_TIMEOUT, 100), (I2C_TENBIT, 0), (I2C_PEC, 0)] {
        assert_eq!(rig.ioctl(command, argument), Ok(0), "0x{command:04x}");
    }
    // No list, and a list that is not there.
    rig.caller.put(BASE, &[0; 16]);
    rig.caller.put(BASE + 8, &[1]);
    assert_eq!(rig.ioctl(I2C_RDWR, BASE), Err(Errno::INVAL));
    rig.caller.put(BASE, &[8]);
    assert_eq!(rig.ioctl(I2C_RDWR, BASE), Err(Errno::FAULT));
    // A length that the target decides needs room for it, and is not offered then either.
    rig.caller.put(DATA, &[1]);
    assert_eq!(rig.rdwr(&[(0x50, RD | 0x400, 32, DATA)]), Err(Errno::INVAL));
    assert_eq!(rig.rdwr(&[(0x50, RD | 0x400, 33, DATA)]), Err(Errno::OPNOTSUPP));
    // Nothing answers.
    assert_eq!(rig.rdwr(&[(0x51, RD, 1, DATA)]), Err(Errno::NXIO));
    assert_eq!(rig.rdwr(&[(0x350, RD, 1, DATA)]), Err(Errno::NXIO));
    // Sizes and directions of SMBus, data that is missing or cannot be read.
    assert_eq!(rig.smbus(1, 0, 9, DATA), Err(Errno::INVAL));
    assert_eq!(rig.smbus(2, 0, 2, DATA), Err(Errno::INVAL));
    assert_eq!(rig.smbus(1, 0, 2, 0), Err(Errno::INVAL));
    assert_eq!(rig.smbus(0, 0, 2, 8), Err(Errno::FAULT));
    assert_eq!(rig.smbus(1, 0, 2, 8), Err(Errno::FAULT));
    for length in [0, 33, 255] {
        rig.caller.put(DATA, &[length]);
        for (direction, size) in [(0, 5), (0, 8), (1, 8)] {
            assert_eq!(rig.smbus(direction, 0, size, DATA), Err(Errno::INVAL), "{size} {length}");
        }
    }
    rig.caller.put(DATA, &[4]);
    for (direction, size) in [(1, 5), (0, 7), (1, 7)] {
        assert_eq!(rig.smbus(direction, 0, size, DATA), Err(Errno::OPNOTSUPP), "{size}");
    }
    // Addresses of 10 bits are accepted, and no transfer with them.
    assert_eq!((rig.ioctl(I2C_TENBIT, 1), rig.ioctl(I2C_SLAVE, 0x350)), (Ok(0), Ok(0)));
    assert_eq!(rig.ioctl(I2C_SLAVE, 0x400), Err(Errno::INVAL));
    assert_eq!(rig.smbus(1, 0, 2, DATA), Err(Errno::OPNOTSUPP));
    assert_eq!(rig.client.read(&rig.adapter, 1), Err(Errno::OPNOTSUPP));
}

/// Each kind of transaction: direction, size, the data before, what is sent and read, and the data after.
#[test]
fn smbus_transactions_are_sent_as_the_kernel_sends_them() {
    type Row = (u8, u32, &'static [u8], &'static [u8], usize, &'static [u8]);
    let rows: &[Row] = &[
        (0, 0, &[], &[], 0, &[]),
        (1, 0, &[], &[], 0, &[]),
        (0, 1, &[], &[0x20], 0, &[]),
        (1, 1, &[0xaa], &[], 1, &[0x00]),
        (0, 2, &[7], &[0x20, 7], 0, &[7]),
        (1, 2, &[7], &[0x20], 1, &[0x20]),
        (0, 5, &[2, 8, 9], &[0x20, 2, 8, 9], 0, &[2, 8, 9]),
        (0, 8, &[2, 8, 9], &[0x20, 8, 9], 0, &[2, 8, 9]),
        (1, 8, &[2, 8, 9], &[0x20], 2, &[2, 0x20, 0x21]),
        // The kind of old, whose length is not read from the caller.
        (1, 6, &[2, 8, 9], &[0x20], 32, &[32, 0x20, 0x21]),
    ];
    for &(direction, size, before, written, read, after) in rows {
        let mut rig = Rig::new();
        rig.caller.put(DATA, before);
        assert_eq!(rig.smbus(direction, 0x20, size, DATA), Ok(0), "{size}");
        assert_eq!(rig.sent(), [(written.to_vec(), read)], "{direction} {size}");
        assert_eq!(rig.caller.get(DATA, after.len()), after, "{direction} {size}");
    }
    let mut rig = Rig::new();
    // Words are those of the machine here, and little-endian on the wire.
    rig.caller.put(DATA, &0x1234_u16.to_ne_bytes());
    assert_eq!(rig.smbus(0, 0x20, 3, DATA), Ok(0));
    assert_eq!(rig.smbus(0, 0x30, 4, DATA), Ok(0));
    assert_eq!(rig.sent(), [(vec![0x20, 0x34, 0x12], 0), (vec![0x30, 0x34, 0x12], 2)]);
    assert_eq!(rig.caller.get(DATA, 2), 0x3332_u16.to_ne_bytes());
}

/// The codes are those that the kernel's `i2c_smbus_pec` makes of these bytes.
#[test]
fn packet_error_codes_are_sent_and_checked() {
    let mut rig = Rig::new();
    assert_eq!(rig.ioctl(I2C_PEC, 1), Ok(0));
    rig.caller.put(DATA, &[0x5a]);
    assert_eq!(rig.smbus(0, 0x20, 2, DATA), Ok(0));
    let [(written, 0)] = &rig.sent()[..] else { panic!("one write") };
    assert_eq!(written[..2], [0x20, 0x5a]);
    // Over a whole packet the code is 0.
    let crc = |bytes: &[u8]| {
        bytes.iter().fold(0_u8, |crc, byte| {
            (0..8).fold(crc ^ byte, |crc, _| (crc << 1) ^ if crc >> 7 == 1 { 7 } else { 0 })
        })
    };
    assert_eq!(crc(b"123456789"), 0xf4, "CRC-8 of the catalogue");
    assert_eq!(written[2], crc(&[0xa0, 0x20, 0x5a]));
    // A target without codes: its next byte is taken for one.
    assert_eq!(rig.smbus(1, 0x30, 2, DATA), Err(Errno::BADMSG));
    // A target that has the right one.
    let code = crc(&[0xa0, 0x40, 0xa1, 0x40]);
    rig.ioctl(I2C_PEC, 0).expect("off");
    rig.caller.put(DATA, &[code]);
    rig.smbus(0, 0x41, 2, DATA).expect("a write");
    rig.ioctl(I2C_PEC, 1).expect("on");
    assert_eq!(rig.smbus(1, 0x40, 2, DATA), Ok(0));
    assert_eq!(rig.caller.get(DATA, 1), [0x40]);
}

#[test]
fn a_target_that_panics_disturbs_no_other() {
    struct Broken;
    impl Target for Broken {
        fn transfer(&mut self, _: &[u8], _: &mut [u8]) -> Result<(), Errno> {
            panic!("as the test wants it")
        }
    }
    let mut rig = Rig::new();
    rig.adapter = std::mem::take(&mut rig.adapter).with(0x51, Broken);
    assert_eq!(rig.rdwr(&[(0x51, RD, 1, DATA)]), Err(Errno::IO));
    assert_eq!(rig.rdwr(&[(0x50, RD, 1, DATA)]), Ok(1));
}

#[test]
fn a_transfer_takes_the_time_of_its_bits() {
    let waited = Arc::new(Mutex::new(Duration::ZERO));
    let mut rig = Rig::new();
    let sum = waited.clone();
    rig.adapter =
        std::mem::take(&mut rig.adapter).paced(100_000, move |time| *sum.lock().expect("a sum") += time);
    let mut takes = |messages: &[(u16, u16, u16, u64)]| {
        *waited.lock().expect("a sum") = Duration::ZERO;
        let _ = rig.rdwr(messages);
        waited.lock().expect("a sum").as_micros()
    };
    // START, address, a byte, START, address, two bytes, STOP.
    assert_eq!(takes(&[(0x50, 0, 1, DATA), (0x50, RD, 2, DATA)]), (9 * 5 + 3) * 10);
    // Nothing follows an address that is not acknowledged.
    assert_eq!(takes(&[(0x51, RD, 8192, DATA)]), (9 + 2) * 10);
}
