// SPDX-License-Identifier: MIT

//! Transfers as SMBus commands, for adapters without plain I2C (`Documentation/i2c/smbus-protocol.rst` of the kernel).
//!
//! Byte, byte data, word data and I2C block data put on the wire what the messages of a transfer do. A quick command does
//! not, and a block of SMBus sends its length to the gauge; neither is ever used.

use i2cdev::core::I2CDevice;
use nix::libc::c_ulong;

use super::I2C_FUNC_SMBUS_PEC;
use crate::{Packet, Reach};

/// I2C_FUNC_SMBUS_READ_BLOCK_DATA.
const BLOCKS: c_ulong = 0x0100_0000;
// Bits of I2C_FUNCS: byte data, word data and I2C blocks.
const READS: [(u16, c_ulong); 3] = [(1, 0x0008_0000), (2, 0x0020_0000), (32, 0x0400_0000)];
const WRITES: [(u16, c_ulong); 3] = [(1, 0x0010_0000), (2, 0x0040_0000), (32, 0x0800_0000)];

/// What an adapter with these functions carries.
pub(super) fn reach(functions: c_ulong) -> Reach {
    // Each length has a command of its own, so the lengths end where the first one is missing.
    let most = |commands: [(u16, c_ulong); 3]| {
        let has = commands.into_iter().take_while(|(_, bit)| functions & bit != 0);
        has.last().map_or(0, |(length, _)| length)
    };
    Reach {
        write: 1 + most(WRITES),
        read: most(READS),
        blocks: functions & BLOCKS != 0,
        ..Reach::smbus(0, functions & I2C_FUNC_SMBUS_PEC != 0)
    }
}

/// One packet, which the adapter's [`reach`] carries.
pub(super) fn packet<D: I2CDevice>(device: &mut D, packet: Packet) -> Result<Vec<u8>, D::Error> {
    if packet.is_block {
        let block = device.smbus_read_block_data(packet.code)?;
        return Ok([&[block.len() as u8], &*block].concat());
    }
    Ok(device.smbus_read_word_data(packet.code)?.to_le_bytes().to_vec())
}

/// One transfer, which the adapter's [`reach`] carries. Returns whether all of it was moved.
pub(super) fn transfer<D: I2CDevice>(
    device: &mut D,
    write: &[u8],
    read: &mut [u8],
) -> Result<bool, D::Error> {
    match (write, &mut *read) {
        ([], [byte]) => *byte = device.smbus_read_byte()?,
        ([code], []) => device.smbus_write_byte(*code)?,
        ([code], [byte]) => *byte = device.smbus_read_byte_data(*code)?,
        // A word of SMBus has its low byte first.
        ([code], word @ [_, _]) => {
            word.copy_from_slice(&device.smbus_read_word_data(*code)?.to_le_bytes());
        }
        ([code], block) => {
            let bytes = device.smbus_read_i2c_block_data(*code, block.len() as u8)?;
            if bytes.len() != block.len() {
                return Ok(false);
            }
            block.copy_from_slice(&bytes);
        }
        ([code, byte], []) => device.smbus_write_byte_data(*code, *byte)?,
        ([code, low, high], []) => {
            device.smbus_write_word_data(*code, u16::from_le_bytes([*low, *high]))?;
        }
        ([code, block @ ..], []) => device.smbus_write_i2c_block_data(*code, block)?,
        ([], _) | ([_, _, ..], _) => return Ok(false),
    }
    Ok(true)
}

#[cfg(test)]
mod tests {
    use nix::errno::Errno;

    use super::*;
    use crate::BusError;

    /// I2C_FUNCS of drivers of Linux 7.3.4, as read from them.
    const I801: c_ulong = 0x1fff_8008;
    const PIIX4: c_ulong = 0x037f_0000;
    const STUB: c_ulong = 0x0c7f_0000;

    /// A gauge that records the commands, and answers with the register's number and those after it.
    #[derive(Default)]
    struct Gauge {
        commands: Vec<String>,
        fails: Option<Errno>,
        /// How much of a block it leaves out.
        short: usize,
    }

    impl Gauge {
        fn note<T>(&mut self, command: &str, answer: T) -> Result<T, Errno> {
            self.commands.push(command.into());
            self.fails.map_or(Ok(answer), Err)
        }
    }

    /// Whatever is not SMBus's, or puts other bytes on the wire, fails the test.
    impl I2CDevice for Gauge {
        type Error = Errno;

        fn read(&mut self, _: &mut [u8]) -> Result<(), Errno> {
            unreachable!("read(2) is plain I2C")
        }

        fn write(&mut self, _: &[u8]) -> Result<(), Errno> {
            unreachable!("write(2) is plain I2C")
        }

        fn smbus_write_quick(&mut self, _: bool) -> Result<(), Errno> {
            unreachable!("a quick command writes to some devices")
        }

        fn smbus_read_byte(&mut self) -> Result<u8, Errno> {
            self.note("receive byte", 0x5a)
        }

        fn smbus_write_byte(&mut self, value: u8) -> Result<(), Errno> {
            self.note(&format!("send byte {value:02x}"), ())
        }

        fn smbus_read_byte_data(&mut self, code: u8) -> Result<u8, Errno> {
            self.note(&format!("read byte {code:02x}"), code)
        }

        fn smbus_write_byte_data(&mut self, code: u8, value: u8) -> Result<(), Errno> {
            self.note(&format!("write byte {code:02x} {value:02x}"), ())
        }

        fn smbus_read_word_data(&mut self, code: u8) -> Result<u16, Errno> {
            self.note(&format!("read word {code:02x}"), u16::from_le_bytes([code, code + 1]))
        }

        fn smbus_write_word_data(&mut self, code: u8, value: u16) -> Result<(), Errno> {
            self.note(&format!("write word {code:02x} {value:04x}"), ())
        }

        fn smbus_process_word(&mut self, _: u8, _: u16) -> Result<u16, Errno> {
            unreachable!("a process call writes before it reads")
        }

        fn smbus_read_block_data(&mut self, code: u8) -> Result<Vec<u8>, Errno> {
            self.note(&format!("read block {code:02x}"), vec![code, code + 1, code + 2])
        }

        fn smbus_read_i2c_block_data(&mut self, code: u8, length: u8) -> Result<Vec<u8>, Errno> {
            let block = (code..code + length).take(usize::from(length) - self.short).collect();
            self.note(&format!("read block {code:02x} {length}"), block)
        }

        fn smbus_write_block_data(&mut self, _: u8, _: &[u8]) -> Result<(), Errno> {
            unreachable!("it sends a length")
        }

        fn smbus_write_i2c_block_data(&mut self, code: u8, values: &[u8]) -> Result<(), Errno> {
            self.note(&format!("write block {code:02x} {}", values.len()), ())
        }

        fn smbus_process_block(&mut self, _: u8, _: &[u8]) -> Result<Vec<u8>, Errno> {
            unreachable!("it sends a length")
        }
    }

    #[test]
    fn the_functions_of_an_adapter_say_what_it_carries() {
        assert_eq!(reach(I801), Reach::smbus(32, true).with_blocks());
        assert_eq!(reach(PIIX4), Reach::smbus(2, false).with_blocks());
        assert_eq!(reach(STUB), Reach::smbus(32, false));
        // ICH4 and older write I2C blocks, and read none.
        let older = reach(I801 & !0x0400_0000);
        assert_eq!((older.write, older.read), (33, 2));
        // No byte of a word stands for a command that is missing.
        assert_eq!(reach(I801 & !0x0010_0000).write, 1);
        assert_eq!((reach(0).read, reach(0x0020_0000).read), (0, 0));
    }

    #[test]
    fn each_length_has_its_command() {
        let mut gauge = Gauge::default();
        let mut read = |write: &[u8], length: usize| {
            let mut bytes = vec![0; length];
            assert_eq!(transfer(&mut gauge, write, &mut bytes), Ok(true));
            bytes
        };
        assert_eq!(read(&[], 1), [0x5a]);
        assert_eq!(read(&[0x60], 1), [0x60]);
        assert_eq!(read(&[0x08], 2), [0x08, 0x09]);
        assert_eq!(read(&[0x0c], 3), [0x0c, 0x0d, 0x0e]);
        assert_eq!(read(&[0x40], 32), (0x40..0x60).collect::<Vec<_>>());
        for write in [&[0x08][..], &[0x61, 0], &[0x00, 0x14, 0x04], &[0x40, 1, 2, 3], &[0x40; 33]] {
            read(write, 0);
        }
        let sent = [
            "receive byte",
            "read byte 60",
            "read word 08",
            "read block 0c 3",
            "read block 40 32",
            "send byte 08",
            "write byte 61 00",
            "write word 00 0414",
            "write block 40 3",
            "write block 40 32",
        ];
        assert_eq!(gauge.commands, sent);
    }

    /// By [`Reach::check`], which comes first; here they are not sent either.
    #[test]
    fn what_no_command_carries_is_refused_before_anything_is_sent() {
        let too_long = |bytes, most| Err(BusError::TooLong { bytes, most });
        let unsupported = Err(BusError::Other(Errno::EOPNOTSUPP as i32));
        for (functions, write, read, refused) in [
            (PIIX4, 1, 36, too_long(36, 2)),
            (PIIX4, 33, 0, too_long(33, 3)),
            (I801, 1, 36, too_long(36, 32)),
            (I801, 34, 0, too_long(34, 33)),
            (I801, 2, 2, too_long(2, 1)),
            (I801, 0, 2, too_long(2, 1)),
            (I801, 0, 0, unsupported),
        ] {
            assert_eq!(reach(functions).check(write, read), refused, "{functions:x} {write} {read}");
        }
        let mut gauge = Gauge::default();
        for (write, read) in [(0, 0), (0, 2), (2, 2)] {
            assert_eq!(transfer(&mut gauge, &vec![0; write], &mut vec![0; read]), Ok(false));
        }
        assert_eq!(gauge.commands, Vec::<String>::new());
    }

    #[test]
    fn an_error_keeps_its_number_and_a_short_block_is_none() {
        let mut gauge = Gauge { fails: Some(Errno::ENXIO), ..Gauge::default() };
        assert_eq!(transfer(&mut gauge, &[0x08], &mut [0; 2]), Err(Errno::ENXIO));
        let mut gauge = Gauge { short: 1, ..Gauge::default() };
        assert_eq!(transfer(&mut gauge, &[0x40], &mut [0; 32]), Ok(false));
    }

    #[test]
    fn a_packet_is_one_command() {
        let mut gauge = Gauge::default();
        let mut read = |is_block| packet(&mut gauge, Packet { code: 0x20, is_block, pec: true });
        assert_eq!(read(false), Ok(vec![0x20, 0x21]));
        assert_eq!(read(true), Ok(vec![3, 0x20, 0x21, 0x22]));
        assert_eq!(gauge.commands, ["read word 20", "read block 20"]);
    }
}
