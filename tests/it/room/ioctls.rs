// SPDX-License-Identifier: MIT

//! What a program that is mad sends to a bus. `tests/vm` has this file, too, for the buses that only a kernel with their
//! modules makes.

use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::AsRawFd;

/// So many calls on a bus, which may be opened at any time: reads, writes and ioctls with numbers and arguments by chance, most
/// of them near valid ones. How many ioctls were carried out.
pub(crate) fn by_chance(open: &dyn Fn() -> File, count: u64, seed: u64) -> u64 {
    let mut random = Random(seed.wrapping_mul(2).wrapping_add(1));
    let mut file = open();
    // What is read for an argument at its end still goes into it.
    let mut arena = vec![0_u8; (1 << 16) + 16_384];
    let start = arena.as_mut_ptr() as u64;
    let mut answered = 0;
    for _ in 0..count {
        match random.below(100) {
            0 => file = open(),
            1 => drop(file.write(&arena[..random.below(9000) as usize])),
            2 => {
                let length = random.below(9000) as usize;
                drop(file.read(&mut arena[..length]));
            }
            _ => answered += u64::from(random.ioctl(&file, &mut arena, start)),
        }
    }
    answered
}

/// Whether a bus answers I2C_FUNCS with plain transfers.
pub(crate) fn funcs(file: &File) -> bool {
    let mut funcs = [0_u8; 8];
    call(file, 0x0705, funcs.as_mut_ptr() as u64) == 0 && u64::from_ne_bytes(funcs) & 1 == 1
}

/// A linear congruential generator: the tests need no better one.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        self.0 >> 11
    }

    fn below(&mut self, limit: u64) -> u64 {
        self.next() % limit
    }

    /// An address: in the arena most times.
    fn place(&mut self, start: u64) -> u64 {
        match self.below(12) {
            0 => 0,
            1 => 8,
            // What no program can have.
            2 => 0x8000_0000_0000_0000 | self.next(),
            _ => start + self.below((1 << 16) - 9000),
        }
    }

    /// One ioctl with an argument that begins anywhere in the arena. Whether it was carried out.
    fn ioctl(&mut self, file: &File, arena: &mut [u8], start: u64) -> bool {
        let commands = [0x0701, 0x0702, 0x0703, 0x0703, 0x0704, 0x0705, 0x0706, 0x0707, 0x0708, 0x0720];
        let command = match self.below(20) {
            0 => self.next() & 0xffff,
            choice => commands[choice as usize % commands.len()],
        };
        let at = self.below(1 << 12) as usize * 4;
        let argument = match command {
            0x0703 | 0x0706 => [0x55, 0x55, 0x55, 0x0b, 0x54, self.next()][self.below(6) as usize],
            0x0704 => u64::from(self.below(50) == 0),
            0x0701 | 0x0702 | 0x0708 => self.below(3) << self.below(40),
            _ if self.below(10) == 0 => self.place(start),
            _ => start + at as u64,
        };
        let head = &mut arena[at..at + 16];
        if command == 0x0720 {
            let data = self.place(start);
            head[..4].copy_from_slice(&[self.below(2) as u8, self.next() as u8, 0, 0]);
            head[4..8].copy_from_slice(&(self.below(10) as u32).to_ne_bytes());
            head[8..].copy_from_slice(&data.to_ne_bytes());
        } else {
            let (list, count) = (start + at as u64 + 64, self.below(45) as u32);
            head[..8].copy_from_slice(&list.to_ne_bytes());
            head[8..12].copy_from_slice(&if self.below(3) > 0 { count % 3 } else { count }.to_ne_bytes());
            for message in arena[at + 64..].chunks_exact_mut(16).take(count as usize) {
                let address: u16 = if self.below(4) > 0 { 0x55 } else { self.next() as u16 };
                let flags = if self.below(8) > 0 { self.below(2) } else { self.next() } as u16;
                let length = if self.below(8) > 0 { self.below(8) } else { self.below(9000) } as u16;
                let words = [address, flags, length, 0].map(u16::to_ne_bytes).concat();
                message[..8].copy_from_slice(&words);
                message[8..].copy_from_slice(&self.place(start).to_ne_bytes());
            }
        }
        call(file, command, argument) >= 0
    }
}

fn call(file: &File, command: u64, argument: u64) -> i32 {
    #[allow(unsafe_code, reason = "the argument points into memory of the test, or to nothing")]
    unsafe {
        nix::libc::ioctl(file.as_raw_fd(), command as nix::libc::Ioctl, argument as nix::libc::c_ulong)
    }
}
