// SPDX-License-Identifier: MIT

//! The simulated bq34z100-G1 and bq34z100-R2, compared byte by byte with the manuals. These tests use no other code of
//! gaugefs, so they fail only if the simulator is wrong.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::error::ErrorKind;
use gauge_bus::{Bus, BusError};
use gauge_sim::{Options, Sim};

use crate::bench::{Bench, UNSEAL, hex, packed, sum};

/// 48/0 and 64/0 as the part leaves the factory (SLUSBZ5D table 7-11).
const DATA_0: &str =
    "00 00 00 00 00 01 00 00 03 84 64 03 E8 15 18 FE 70 10 68 10 68 10 04 0A 32 1E F6 0A 2D 37 01 0B";
const REGISTERS_0: &str =
    "01 61 FF 30 00 00 00 01 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00";
const FULL_ACCESS: &str = "W 00 FF FF ; W 00 FF FF";

const FLAGS: u8 = 0x0E;
const FC: u16 = 0x0200;
const CHG: u16 = 0x0100;
const DSG: u16 = 0x0001;

mod registers {
    use super::*;

    #[test]
    fn identity_matches_slua790() {
        let bench = Bench::new();
        bench.replay("W 00 01 00 ; R 00 2 -> 00 01");
        bench.replay("W 00 08 00 ; R 00 2 -> 07 01");
        bench.replay("W 00 02 00 ; R 00 2 -> 16 00");
        bench.replay("W 00 03 00 ; R 00 2 -> 08 00");
        bench.set("voltage_mv", "15500");
        bench.replay("R 08 2 -> 8C 3C");
    }

    #[test]
    fn control_returns_the_last_answer_and_the_last_code() {
        let bench = Bench::new();
        bench.replay("W 00 01 00 ; R 00 1 -> 00 ; R 01 1 -> 01 ; R 00 2 -> 00 01");
        bench.replay("W 00 07 00 ; R 00 2 -> 01 00 ; W 00 07 00 ; R 00 2 -> 07 00");
        // The same, byte by byte: writing the high byte executes the subcommand.
        bench.replay("W 00 08 ; R 00 2 -> 07 00 ; W 01 00 ; R 00 2 -> 07 01");
        bench.replay("W 00 0C 00 ; R 00 2 -> 00 00 ; W 00 05 00 ; R 00 2 -> 00 00");
        // Unknown codes are acknowledged and do nothing.
        bench.replay("W 00 08 00 ; W 00 34 12 ; R 00 2 -> 07 01");
    }

    #[test]
    fn registers_copy_the_flash_values_of_table_7_8() {
        let bench = Bench::new();
        bench.replay("R 28 2 -> 01 00 ; R 2C 2 -> 00 00 ; R 3A 2 -> 61 01 ; R 3C 2 -> E8 03");
    }

    #[test]
    fn reads_continue_from_the_pointer_and_wrap() {
        let bench = Bench::new();
        bench.replay("W 00 01 00 ; R 7E 4 -> 00 00 00 01");
        let mut all = [0; 0x80];
        bench.sim.bus().transfer(&[0], &mut all).unwrap();
        assert_eq!(u16::from_le_bytes([all[0x3C], all[0x3D]]), 1000);
        // A read without a register continues at the pointer.
        let mut bus = bench.sim.bus();
        bus.transfer(&[0x3C], &mut []).unwrap();
        let mut read = [0; 2];
        bus.transfer(&[], &mut read).unwrap();
        assert_eq!(read, [0xE8, 0x03]);
    }

    #[test]
    fn invalid_writes_are_not_acknowledged() {
        let bench = Bench::unsealed();
        let flash = bench.sim.flash();
        bench.replay("W 80 -> NACK ; R FF 1 -> NACK ; W 7F");
        bench.replay("W 08 00 -> NACK ; W 3A 00 -> NACK ; W 7F 00 -> NACK ; W 62 00 -> NACK");
        // More bytes than a register has.
        bench.replay("W 00 01 00 00 -> NACK ; R 00 2 -> 00 01");
        bench.replay("W 61 00 00 -> NACK ; W 60 00 00 -> NACK ; W 3E 30 00 00 -> NACK");
        assert_eq!(bench.sim.flash(), flash);
    }

    #[test]
    fn other_addresses_do_not_answer() {
        let bench = Bench::new();
        for address in (0x03..0x78).filter(|&address| address != 0x55) {
            assert_eq!(
                bench.sim.bus_at(address).transfer(&[], &mut []),
                Err(BusError::NoAck),
                "{address:#x}"
            );
        }
        assert_eq!(bench.sim.bus().transfer(&[], &mut []), Ok(()));
    }

    #[test]
    fn transfers_take_bus_time_and_are_counted() {
        let bench = Bench::new();
        bench.replay("R 02 12 -> 3C .. ; R 18 4 -> FF FF FF FF ; R 24 C -> ..");
        // 396 bit times at 100 kHz.
        assert_eq!(bench.clock.now(), Duration::from_micros(3960));
        assert_eq!(bench.sim.get("bus_us").unwrap(), "3960");
        assert_eq!(bench.sim.get("bytes").unwrap(), "43");
        assert_eq!(bench.sim.get("transfers").unwrap(), "3");
    }
}

/// The bq34z100-R2, on which the transcripts of the bq34z100-G1 hold except for its version and subclass 48.
mod firmware_2_02 {
    use super::*;

    fn bench() -> Bench {
        Bench::of("bq34z100-r2", &Options::default())
    }

    #[test]
    fn only_the_firmware_version_differs_from_slua790() {
        let bench = bench();
        bench.replay("W 00 01 00 ; R 00 2 -> 00 01");
        bench.replay("W 00 08 00 ; R 00 2 -> 07 01");
        bench.replay("W 00 02 00 ; R 00 2 -> 02 02");
        bench.replay("W 00 03 00 ; R 00 2 -> 08 00");
        bench.replay("R 28 2 -> 01 00 ; R 2C 2 -> 00 00 ; R 3A 2 -> 61 01 ; R 3C 2 -> E8 03");
        bench.set("voltage_mv", "15500");
        bench.replay("R 08 2 -> 8C 3C");
    }

    #[test]
    fn voltsel_is_set_as_in_slusbz5d_7_3_3_1() {
        let bench = bench();
        bench.replay(UNSEAL);
        bench.replay("W 61 00 ; W 3E 40 ; W 3F 00 ; R 40 1 -> 01 ; R 60 1 -> 6D ; W 40 09 ; W 60 65");
        bench.replay("X 20 ; R 3A 2 -> 61 01 ; W 00 41 00 ; X 200 ; R 3A 2 -> 61 09");
    }

    #[test]
    fn subclass_48_has_three_scales_before_the_names() {
        let bench = bench();
        bench.replay(UNSEAL);
        let data = DATA_0.strip_suffix("0B").unwrap();
        bench.replay(&format!("W 61 00 ; W 3E 30 ; W 3F 00 ; R 40 20 -> {data} 01"));
        let names =
            "01 0B 62 71 33 34 7A 31 30 30 2D 47 31 0B 54 65 78 61 73 20 49 6E 73 74 2E 04 4C 49 4F 4E 00 00";
        bench.replay(&format!("W 3F 01 ; R 40 20 -> {names}"));
    }

    #[test]
    fn scales_are_copies_of_data_flash_that_no_other_register_is_multiplied_by() {
        let bench = bench();
        bench.set("voltage_mv", "3900");
        bench.replay("R 20 3 -> 01 01 01");
        let before = [0x04, 0x06, 0x08, 0x24].map(|register| bench.word(register));
        assert_eq!(before[2], 3900);
        bench.replay(UNSEAL);
        bench.write(48, 30, &[2, 10]);
        bench.sleep(1);
        bench.write(48, 32, &[20]);
        bench.replay("X 100 ; W 00 41 00 ; X 200 ; R 20 3 -> 02 0A 14");
        assert_eq!([0x04, 0x06, 0x08, 0x24].map(|register| bench.word(register)), before);
    }

    #[test]
    fn energies_are_in_centiwatthours() {
        let energy = |chip: &str| {
            let bench = Bench::of(chip, &Options::default());
            f64::from(bench.word(0x24))
        };
        let ratio = energy("bq34z100-g1") / energy("bq34z100-r2");
        assert!((ratio - 10.0).abs() < 0.1, "{ratio}");
    }
}

mod security {
    use super::*;

    #[test]
    fn keys_change_the_seal_state() {
        let bench = Bench::new();
        assert_eq!(bench.status() & 0x6000, 0x6000);
        bench.replay(UNSEAL);
        assert_eq!(bench.status() & 0x6000, 0x4000);
        bench.replay(FULL_ACCESS);
        assert_eq!(bench.status() & 0x6000, 0x0000);
        assert_eq!(bench.sim.get("seal").unwrap(), "full-access");
        bench.replay("W 00 20 00");
        assert_eq!(bench.status() & 0x6000, 0x6000);
    }

    #[test]
    fn both_key_words_must_follow_each_other_in_order_and_in_time() {
        for wrong in [
            "W 00 72 36 ; W 00 14 04",
            "W 00 14 04 ; W 00 00 00 ; W 00 72 36",
            "W 00 14 04 ; X 4100 ; W 00 72 36",
            "W 00 04 14 ; W 00 36 72",
            "W 00 FF FF ; W 00 FF FF",
        ] {
            let bench = Bench::new();
            bench.replay(wrong);
            assert_eq!(bench.status() & 0x6000, 0x6000, "{wrong}");
        }
        // Reads between the key words are allowed, because they do not write to Control().
        let bench = Bench::new();
        bench.replay("W 00 14 04 ; R 00 2 -> 00 00 ; X 3900 ; W 00 72 36");
        assert_eq!(bench.status() & 0x6000, 0x4000);
    }

    #[test]
    fn a_gauge_may_require_silence_before_keys() {
        let bench = Bench::new();
        bench.set("key_quiet_ms", "4000");
        bench.replay("R 08 2 -> ..");
        bench.replay(UNSEAL);
        assert_eq!(bench.sim.get("seal").unwrap(), "sealed");
        bench.replay("X 4001");
        bench.replay(UNSEAL);
        assert_eq!(bench.sim.get("seal").unwrap(), "unsealed");
    }

    #[test]
    fn a_sealed_gauge_hides_its_flash() {
        let bench = Bench::unsealed();
        bench.write(58, 0, b"maker");
        bench.replay("X 100 ; W 00 20 00");
        let flash = bench.sim.flash();
        bench.replay("W 61 00 -> NACK ; W 3E 30 -> NACK ; R 3E 1 -> 00 ; R 61 1 -> 00");
        // 0x3F selects the manufacturer's block, which can be read but not changed.
        bench.replay("W 3F 01 ; X 30 ; R 40 5 -> 6D 61 6B 65 72");
        let (mut block, at) = ([0; 32], 0x40);
        block[..5].copy_from_slice(b"Maker");
        bench.replay(&format!("W {at:02X} 4D ; W 60 {:02X}", sum(&block)));
        assert_eq!(bench.sim.flash(), flash);
        // Writes that a sealed gauge does not allow are acknowledged and ignored.
        bench.replay("W 00 41 00 ; R 08 1 -> .. ; W 00 2D 00 ; W 00 21 00");
        assert_eq!(bench.status() & 0x1003, 0);
        bench.set("sealed_writes", "ignore");
        bench.replay("W 61 00 ; W 3E 30 ; R 3E 1 -> 00");
    }

    #[test]
    fn sealed_blocks_are_blank_at_first() {
        let bench = Bench::unsealed();
        bench.write(58, 0, b"maker");
        bench.replay("X 100 ; W 00 20 00 ; W 3F 01 ; R 40 2 -> 00 00 ; X 30 ; R 40 2 -> 6D 61");
    }

    #[test]
    fn keys_can_be_changed_in_full_access_only() {
        let bench = Bench::unsealed();
        bench.write(112, 0, &[0x11, 0x22, 0x33, 0x44]);
        // The buffer shows the new bytes nevertheless.
        bench.replay("R 40 4 -> 11 22 33 44");
        assert_eq!(bench.block(112, 0).0[..4], [0x36, 0x72, 0x04, 0x14]);
        bench.replay(FULL_ACCESS);
        bench.write(112, 0, &[0x11, 0x22, 0x33, 0x44]);
        bench.replay("X 100 ; W 00 20 00");
        bench.replay(UNSEAL);
        assert_eq!(bench.sim.get("seal").unwrap(), "sealed");
        bench.replay("W 00 44 33 ; W 00 22 11");
        assert_eq!(bench.sim.get("seal").unwrap(), "unsealed");
    }

    #[test]
    fn a_new_gauge_can_be_given_another_key() {
        let bench = Bench::with(&Options { unseal_key: Some([0x1234, 0x5678]), ..Options::default() });
        bench.replay(UNSEAL);
        assert_eq!(bench.sim.get("seal").unwrap(), "sealed");
        bench.replay("W 00 34 12 ; W 00 78 56");
        assert_eq!(bench.sim.get("seal").unwrap(), "unsealed");
    }

    /// Digests computed from the default key with another implementation of SHA-1; the scheme is that of
    /// SLUAAQ0's example.
    #[test]
    fn challenges_get_the_right_digest() {
        let counting: String = (0..20).map(|byte| format!("{byte:02X} ")).collect();
        let zeros = "00 ".repeat(20);
        for (challenge, sum, lsb_first, as_sent) in [
            (
                &zeros,
                "FF",
                "F0F33C8E0A9BC21722E30F628464615BEB7CA22F",
                "2FA27CEB5B616484620FE32217C29B0A8E3CF3F0",
            ),
            (
                &counting,
                "41",
                "67D8D90516ECD55A3C751FC0BE7A361DB366A246",
                "B78043012BB40F9FF86404F645C2AB6A9F28EAF3",
            ),
        ] {
            let bench = Bench::new();
            let ask = format!("W 3F 00 ; W 40 {challenge} ; W 54 {sum} ; X 50 ; R 40 14 -> ");
            bench.replay(&(ask.clone() + &packed(lsb_first)));
            bench.set("auth_order", "as-sent");
            bench.replay(&(ask.clone() + &packed(as_sent)));
            // While unsealed, BlockDataControl() must select authentication.
            bench.replay(UNSEAL);
            bench.replay(&format!("W 61 01 ; {ask}{}", packed(as_sent)));
            // A wrong checksum starts nothing.
            bench.replay(&format!("W 3F 00 ; W 40 {challenge} ; W 54 00 ; X 50 ; R 40 14 -> {challenge}"));
        }
    }

    /// SLUAAQ0's example, with the key written as in SLUSBZ5D 7.3.15.2, at the correct offset.
    #[test]
    fn the_authentication_key_can_be_changed_while_unsealed() {
        let bench = Bench::unsealed();
        bench.write(112, 8, &hex(&packed("42C5413DB9EDBBA212DFB96B7440433C")));
        bench.set("auth_order", "as-sent");
        let zeros = "00 ".repeat(20);
        let digest = packed("B0BEF440CAC492FAF09604A46C2C0996512331AF");
        bench.replay(&format!("W 61 01 ; W 3F 00 ; W 40 {zeros} ; W 54 FF ; X 50 ; R 40 14 -> {digest}"));
    }
}

mod flash {
    use super::*;

    #[test]
    fn voltsel_is_set_as_in_slusbz5d_7_3_3_1() {
        let bench = Bench::unsealed();
        bench.replay("W 61 00 ; W 3E 40 ; W 3F 00 ; R 40 1 -> 01 ; R 60 1 -> 6D ; W 40 09 ; W 60 65");
        bench.replay("X 20 ; R 3A 2 -> 61 01 ; W 00 41 00 ; X 200 ; R 3A 2 -> 61 09");
        bench.replay(UNSEAL);
        bench.replay("W 3E 40 ; W 3F 00 ; R 40 8 -> 09 61 FF 30 00 00 00 01 ; R 60 1 -> 65");
    }

    #[test]
    fn serial_number_and_chemistry_match_slua790() {
        let bench = Bench::unsealed();
        bench.replay(&format!("W 61 00 ; W 3E 30 ; W 3F 00 ; R 40 20 -> {DATA_0} ; R 60 1 -> BF"));
        let before =
            "62 71 33 34 7A 31 30 30 2D 47 31 0B 54 65 78 61 73 20 49 6E 73 74 2E 04 4C 49 4F 4E 00 00 00 00";
        let after =
            "62 71 33 34 7A 31 30 30 2D 47 31 0B 54 65 78 61 73 20 49 6E 73 74 2E 03 50 62 41 00 00 00 00 00";
        bench.replay(&format!("W 3F 01 ; R 40 20 -> {before} ; R 60 1 -> E3"));
        bench.replay(&format!("W 57 03 50 62 41 00 ; W 60 23 ; X 100 ; W 3E 30 01 ; R 40 21 -> {after} 23"));
    }

    #[test]
    fn cc_offset_is_at_48() {
        let bench = Bench::unsealed();
        bench.replay("W 61 00 ; W 3E 68 ; W 3F 00 ; R 48 2 -> FB 50 ; R 4E 2 -> 13 88");
    }

    #[test]
    fn writes_to_the_window_do_not_reach_flash_without_a_commit() {
        let bench = Bench::unsealed();
        bench.replay("W 61 00 ; W 3E 3A ; W 3F 00 ; W 40 01 ; W 41 02 ; W 42 03");
        bench.replay("W 3F 00 ; R 40 3 -> 00 00 00");
        bench.replay(
            "W 40 01 ; W 41 02 ; W 42 03 ; W 60 F8 ; R 40 3 -> 01 02 03 ; W 3F 00 ; R 40 3 -> 00 00 00",
        );
        bench.replay("W 40 01 ; W 41 02 ; W 42 03 ; W 60 F9 ; W 3F 00 ; R 40 3 -> 01 02 03");
        assert_eq!(bench.sim.get("wear").unwrap(), "58/0 1");
    }

    /// sparkfun/SparkFun_BQ27441_Arduino_Library (5ca0dbe8) and its ports sum what they have written by reading it back.
    #[test]
    fn what_is_written_shows_before_its_sum_or_only_after_it() {
        let bench = Bench::unsealed();
        let write = "W 61 00 ; W 3E 3A ; W 3F 00 ; W 40 01 ; W 41 02 ; W 42 03";
        bench.replay(&format!("{write} ; R 40 3 -> 01 02 03 ; W 3F 00"));
        bench.set("uncommitted", "stored");
        bench.replay(&format!("{write} ; R 40 3 -> 00 00 00 ; W 60 F8 ; R 40 3 -> 00 00 00"));
        bench.replay("W 60 F9 ; R 40 3 -> 01 02 03 ; W 3F 00 ; R 40 3 -> 01 02 03");
    }

    #[test]
    fn a_short_block_ends_in_zeros_that_are_not_stored() {
        let bench = Bench::unsealed();
        bench.replay(&format!("W 61 00 ; W 3E 40 ; W 3F 00 ; R 40 20 -> {REGISTERS_0} ; R 60 1 -> 6D"));
        let flash = bench.sim.flash();
        bench.replay("W 48 FF FF ; R 48 2 -> 00 00 ; W 60 6D");
        assert_eq!(bench.sim.flash(), flash);
        assert_eq!(bench.sim.get("wear").unwrap(), "64/0 1");
        // Subclasses and blocks that do not exist store nothing.
        for place in ["W 3E 03 ; W 3F 00", "W 3E 40 ; W 3F 01"] {
            bench.replay(&format!("X 50 ; {place} ; W 40 01 ; R 40 1 -> 00 ; W 60 FE ; W 60 FF"));
            assert_eq!(bench.sim.flash(), flash);
        }
    }

    #[test]
    fn only_the_written_bytes_change() {
        let bench = Bench::unsealed();
        let before = bench.sim.flash();
        bench.write(48, 11, &[0x0D, 0x48]);
        let after = bench.sim.flash();
        let changed: Vec<_> = (0..before.len()).filter(|&at| before[at] != after[at]).collect();
        assert_eq!(changed.len(), 2);
        assert_eq!(after[changed[0]..=changed[1]], [0x0D, 0x48]);
        assert_eq!(before.len(), 450);
    }

    #[test]
    fn a_commit_below_the_voltage_limit_is_acknowledged_and_dropped() {
        let bench = Bench::unsealed();
        let flash = bench.sim.flash();
        for (voltage, stored) in [("2799", false), ("2800", true)] {
            bench.set("voltage_mv", voltage);
            bench.write(58, 0, b"x");
            bench.replay("R 40 1 -> 78");
            assert_eq!(bench.sim.flash() != flash, stored, "{voltage}");
        }
        // For several cells the limit applies to the scaled voltage: 3062 mV of 5000 at a divider of 32000
        // (SLUSBZ5D 8.2.2.1.3 has the limit for seven cells).
        bench.set("voltage_mv", "30000");
        bench.write(68, 0, &[0x0B, 0xF6]);
        bench.write(104, 14, &[0x7D, 0x00]);
        bench.set("voltage_mv", "19596");
        bench.write(58, 0, b"y");
        assert_eq!(bench.block(58, 0).0[0], b'x');
        bench.set("voltage_mv", "19597");
        bench.write(58, 0, b"y");
        assert_eq!(bench.block(58, 0).0[0], b'y');
        assert_eq!(bench.sim.get("dropped").unwrap(), "2");
    }

    /// A pack of four cells behind an external divider: 850 mV at the pin. Five times that without the internal
    /// divider, and in proportion to Voltage Divider.
    #[test]
    fn voltage_follows_the_divider_and_voltsel() {
        let bench = Bench::unsealed();
        bench.write(68, 0, &[0, 0]);
        bench.set("voltage_mv", "850");
        bench.write(64, 0, &[0x09]);
        assert_eq!(bench.word(0x08), 4250);
        bench.write(104, 14, &[0x4E, 0x20]);
        assert_eq!(bench.word(0x08), 17_000);
        bench.write(64, 0, &[0x01]);
        assert_eq!(bench.word(0x08), 3400);
        // Without the external divider, the voltage is out of the converter's range; and it overflows.
        bench.set("voltage_mv", "auto");
        bench.write(104, 14, &[0x13, 0x88]);
        bench.set("voltage_mv", "3855");
        bench.write(64, 0, &[0x09]);
        assert_eq!(bench.word(0x08), 0);
        bench.write(64, 0, &[0x01]);
        bench.set("voltage_mv", "12000");
        bench.write(104, 14, &[0x75, 0x30]);
        assert_eq!(bench.word(0x08), (72_000u32 - 65_536) as u16);
    }

    /// 2800 mV of Voltage() itself, even where the scaled voltage is higher.
    #[test]
    fn the_limit_applies_to_voltage_as_well() {
        let bench = Bench::unsealed();
        bench.write(104, 14, &[0x0F, 0xA0]);
        for (voltage, stored) in [("2799", false), ("2800", true)] {
            bench.set("voltage_mv", voltage);
            bench.write(58, 0, b"x");
            assert_eq!(bench.block(58, 0).0[0] == b'x', stored, "{voltage}");
        }
    }

    #[test]
    fn a_divider_of_0_blocks_writes_until_calibration() {
        let bench = Bench::unsealed();
        bench.write(104, 14, &[0, 0]);
        assert_eq!(bench.word(0x08), 0);
        bench.write(58, 0, b"x");
        assert_eq!(bench.block(58, 0).0[0], 0);
        bench.replay("W 00 2D 00");
        bench.write(104, 14, &[0x13, 0x88]);
        bench.replay("W 00 2D 00");
        assert_eq!(bench.word(0x08), 3855);
        bench.write(58, 0, b"x");
        assert_eq!(bench.block(58, 0).0[0], b'x');
    }

    #[test]
    fn the_clock_is_stretched_while_a_block_is_programmed() {
        let bench = Bench::unsealed();
        bench.write(48, 11, &[0x0D, 0x48]);
        let before = bench.clock.now();
        bench.replay("R 08 2 -> ..");
        assert_eq!(bench.clock.now() - before, Duration::from_micros(32_000 + 480));
        assert_eq!(bench.sim.get("stretched_us").unwrap(), "32000");
    }

    #[test]
    fn an_early_read_may_show_the_block_before() {
        let bench = Bench::unsealed();
        bench.set("load_ms", "5");
        bench.replay("W 61 00 ; W 3E 30 ; W 3F 00 ; X 5 ; R 44 2 -> 00 01");
        bench.replay(
            "W 3E 40 ; W 3F 00 ; R 44 2 -> 00 01 ; R 60 1 -> BF ; X 5 ; R 40 2 -> 01 61 ; R 60 1 -> 6D",
        );
    }
}

mod reset {
    use super::*;

    #[test]
    fn a_reset_applies_flash_and_seals_the_gauge() {
        let bench = Bench::unsealed();
        bench.write(48, 11, &[0x0D, 0x48]);
        bench.write(48, 4, &[0xBE, 0xEF]);
        bench.write(48, 6, &[0x00, 0x07]);
        assert_eq!((bench.word(0x3C), bench.word(0x28), bench.word(0x2C)), (1000, 1, 0));
        assert_ne!(bench.word(0x02) >> 8, 100);
        bench.set("reset_busy", "nack");
        bench.replay("W 00 41 00 ; R 08 2 -> NACK ; X 170 ; R 08 2 -> NACK ; X 10 ; R 08 2 -> 0F 0F");
        assert_eq!((bench.word(0x3C), bench.word(0x28), bench.word(0x2C)), (0x0D48, 0xBEEF, 7));
        assert_eq!(bench.word(0x02), 100 << 8 | 60);
        assert_eq!(bench.status() & 0x6000, 0x6000);
        bench.replay("W 00 05 00 ; R 00 2 -> 01 00");
    }

    #[test]
    fn a_reset_stretches_the_clock() {
        let bench = Bench::unsealed();
        bench.replay("W 00 41 00");
        let before = bench.clock.now();
        bench.replay("R 3C 2 -> E8 03");
        assert!(bench.clock.now() - before >= Duration::from_millis(170));
    }

    #[test]
    fn after_power_up_the_gauge_starts_late_and_sealed() {
        let bench = Bench::unsealed();
        bench.set("power", "off");
        assert!(!bench.acknowledged());
        assert_eq!(bench.sim.get("mode").unwrap(), "off");
        bench.set("power", "on");
        bench.replay("X 240 ; R 08 2 -> NACK ; X 10");
        // For the first second Voltage() is not valid and flash cannot be written.
        bench.replay("R 08 2 -> 00 00");
        bench.replay(UNSEAL);
        bench.write(58, 0, b"x");
        assert_eq!(bench.block(58, 0).0[0], 0);
        bench.replay("X 1000 ; R 08 2 -> 0F 0F");
        assert_eq!(bench.word(0x02) >> 8, 100);
    }

    #[test]
    fn full_sleep_ends_with_a_stretched_clock() {
        let bench = Bench::new();
        bench.replay("W 00 10 00 ; X 2000");
        let before = bench.clock.now();
        bench.replay("R 08 2 -> ..");
        assert_eq!(bench.clock.now() - before, Duration::from_micros(8000 + 480));
        let before = bench.clock.now();
        bench.replay("R 08 2 -> ..");
        assert_eq!(bench.clock.now() - before, Duration::from_micros(480));
    }

    #[test]
    fn in_rom_mode_the_gauge_answers_at_another_address() {
        let bench = Bench::unsealed();
        bench.replay("W 00 00 0F");
        assert!(bench.acknowledged(), "only in FULL ACCESS");
        bench.replay(FULL_ACCESS);
        bench.replay("W 00 00 0F");
        assert!(!bench.acknowledged());
        let mut rom = bench.sim.bus_at(0x0B);
        assert_eq!(rom.transfer(&[], &mut []), Ok(()));
        for write in [&[0x00, 0x0F][..], &[0x64, 0x0F, 0x00]] {
            rom.transfer(write, &mut []).unwrap();
        }
        bench.replay("X 300");
        assert!(bench.acknowledged());
        assert_eq!(rom.transfer(&[], &mut []), Err(BusError::NoAck));
    }

    #[test]
    fn after_the_switch_to_hdq_i2c_does_not_answer() {
        let bench = Bench::new();
        bench.replay("W 00 40 7C");
        assert!(!bench.acknowledged());
        bench.set("power", "off");
        bench.set("power", "on");
        bench.sleep(2);
        assert!(!bench.acknowledged());
        bench.set("protocol", "i2c");
        assert!(bench.acknowledged());
    }

    #[test]
    fn calibration_runs_for_a_while() {
        let bench = Bench::new();
        bench.replay("W 00 09 00");
        assert_eq!(bench.status() & 0x0C00, 0x0400);
        bench.sleep(4);
        assert_eq!(bench.status() & 0x0C00, 0);
        assert_eq!(bench.sim.get("wear").unwrap(), "104/0 1");
        bench.replay("W 00 0A 00");
        assert_eq!(bench.status() & 0x0C00, 0x0800);
        bench.sleep(4);
        bench.replay("W 00 0B 00");
        assert_eq!(bench.sim.get("wear").unwrap(), "104/0 2");
        bench.replay(UNSEAL);
        bench.replay("W 00 81 00");
        assert_eq!(bench.status() & 0x1000, 0);
        bench.replay("W 00 2D 00 ; W 00 81 00");
        assert_eq!(bench.status() & 0x1000, 0x1000);
        bench.replay("W 00 80 00");
        assert_eq!(bench.status() & 0x1000, 0);
    }

    #[test]
    fn a_board_has_errors_that_a_calibration_corrects() {
        let bench = Bench::unsealed();
        let word = |register| bench.signed(register);
        bench.set("load_ma", "1000");
        assert_eq!(word(0x10), -1000);
        bench.set("shunt_error", "50");
        assert_eq!(word(0x10), -1050);
        // CC Gain 0.4768 / 1.05, which a reset takes over.
        bench.sim.set_flash(104, 0, &[0x7F, 0x68, 0x7F, 0x8E]);
        bench.reset();
        bench.sleep(2);
        assert_eq!(word(0x10), -1000);
        bench.set("load_ma", "0");
        bench.set("board_offset_ma", "8");
        assert_eq!(word(0x10), 8);
        bench.replay("W 00 09 00");
        bench.sleep(4);
        assert_eq!(word(0x10), 0);
        bench.set("temperature_error", "30");
        assert_eq!(word(0x0C), 2981 + 30);
        // Seven cells behind a divider that nobody has set.
        bench.set("cells", "7");
        bench.set("board_divider", "33000");
        let there = 3855.0 * 7.0 * 5000.0 / (33_000.0 * 5.0);
        assert!((f64::from(word(0x08)) - there).abs() < 2.0, "{} for {there}", word(0x08));
        bench.set("board_divider", "auto");
        bench.set("noise_mv", "20");
        let mut seen = std::collections::BTreeSet::new();
        for _ in 0..20 {
            bench.sleep(1);
            seen.insert(word(0x08));
        }
        let (least, most) = (seen.first().unwrap(), seen.last().unwrap());
        assert!(seen.len() > 5 && (5..=40).contains(&(most - least)), "{seen:?}");
    }

    #[test]
    fn impedance_track_stays_on() {
        let bench = Bench::unsealed();
        assert_eq!(bench.status() & 3, 0);
        bench.replay("W 00 21 00");
        assert_eq!(bench.status() & 3, 3);
        assert_eq!(bench.block(82, 0).0[4], 0x04);
        bench.reset();
        // [QEN]; what was known of the charge is lost, and an open-circuit voltage at rest brings it back.
        assert_eq!(bench.status() & 7, 5);
        bench.sleep(1801);
        assert_eq!(bench.status() & 7, 3);
    }
}

mod faults {
    use super::*;

    #[test]
    fn the_nth_transfer_fails() {
        let bench = Bench::new();
        for (fault, expected) in [
            ("nack 2", BusError::NoAck),
            ("arbitration 2", BusError::ArbitrationLost),
            ("stuck 2", BusError::Timeout),
            ("short 2", BusError::Short),
            ("lost 2", BusError::NoAck),
            ("stretch 2 1001", BusError::Timeout),
        ] {
            bench.set("fault", fault);
            let mut bus = bench.sim.bus();
            let results: Vec<_> = (0..3).map(|_| bus.transfer(&[0x08], &mut [0; 2])).collect();
            assert_eq!(results, [Ok(()), Err(expected), Ok(())], "{fault}");
            assert_eq!(bench.sim.get("fault").unwrap(), "none");
        }
    }

    #[test]
    fn a_transfer_takes_effect_although_its_acknowledgement_is_lost() {
        let bench = Bench::new();
        bench.set("fault", "lost 2");
        bench.replay("W 00 14 04 ; W 00 72 36 -> NACK");
        assert_eq!(bench.sim.get("seal").unwrap(), "unsealed");
    }

    #[test]
    fn commits_can_be_dropped_corrupted_and_torn() {
        let old = hex(DATA_0);
        let mut new = old.clone();
        new[4..14].copy_from_slice(&[0xAA; 10]);
        for (fault, expected) in [
            ("drop-commit", old.clone()),
            ("corrupt-commit", [&new[..4], &[0xAB], &new[5..]].concat()),
            ("torn-commit 0", old.clone()),
            ("torn-commit 4", [&new[..8], &old[8..]].concat()),
            ("torn-commit 16", new.clone()),
        ] {
            let bench = Bench::unsealed();
            bench.set("fault", fault);
            bench.write(48, 4, &[0xAA; 10]);
            if fault.starts_with("torn") {
                assert!(!bench.acknowledged(), "{fault}");
                bench.set("power", "on");
                bench.replay("X 1000");
            }
            bench.replay(UNSEAL);
            assert_eq!(bench.block(48, 0).0[..], expected, "{fault}");
        }
    }

    #[test]
    fn power_loss_while_programming_tears_the_block() {
        let old = hex(DATA_0);
        for (ms, words) in [(0, 0), (9, 4), (31, 15), (33, 16)] {
            let bench = Bench::unsealed();
            bench.write(48, 0, &[0xAA; 32]);
            bench.replay(&format!("X {ms}"));
            bench.set("power", "off");
            let flash = bench.sim.flash();
            let at = flash.windows(32).position(|window| {
                window[..2 * words].iter().all(|&byte| byte == 0xAA)
                    && window[2 * words..] == old[2 * words..]
            });
            // Subclasses 2, 32, 34 and 36 are before it.
            let place = if words == 16 { flash[57..89] == [0xAA; 32] } else { at.is_some() };
            assert!(place, "{ms} ms");
        }
    }

    #[test]
    fn power_cuts_happen_around_a_transfer() {
        let bench = Bench::new();
        bench.set("fault", "power-cut 1");
        bench.replay("R 08 2 -> NACK ; X 5000 ; R 08 2 -> NACK");
        bench.set("power", "on");
        bench.replay("X 300");
        bench.set("fault", "power-cut-after 1 100");
        bench.replay("R 3C 2 -> E8 03 ; R 08 2 -> NACK ; X 100 ; R 08 2 -> NACK ; X 250 ; R 3C 2 -> E8 03");
    }

    #[test]
    fn invalid_fault_texts_change_nothing() {
        let bench = Bench::new();
        for (knob, text, invalid) in [
            ("load_ma", "", true),
            ("load_ma", "1e3", true),
            ("load_ma", "nan", true),
            ("load_ma", "5 x", true),
            ("load_ma", "32001", false),
            ("temperature", "1201", false),
            ("soc", "101", false),
            ("soc", "-1", false),
            ("speed", "-1", false),
            ("voltage_mv", "65536", false),
            ("power", "maybe", true),
            ("fault", "nack", true),
            ("nothing", "1", true),
        ] {
            let before: Vec<_> = bench.sim.knobs().iter().map(|knob| bench.sim.get(knob.name)).collect();
            let error = bench.sim.set(knob, text).unwrap_err();
            match error.kind {
                ErrorKind::Invalid => assert!(invalid, "{knob} {text}"),
                ErrorKind::OutOfRange => assert!(!invalid, "{knob} {text}"),
                other => panic!("{knob} {text}: {other:?}"),
            }
            let after: Vec<_> = bench.sim.knobs().iter().map(|knob| bench.sim.get(knob.name)).collect();
            assert_eq!(before, after, "{knob} {text}");
        }
    }

    #[test]
    fn every_knob_is_readable_and_writable_knobs_accept_their_own_text() {
        let bench = Bench::new();
        for knob in bench.sim.knobs() {
            let shown = bench.sim.get(knob.name).unwrap_or_else(|| panic!("{}", knob.name));
            let set = bench.sim.set(knob.name, &shown);
            match knob.writable {
                true => assert_eq!(set, Ok(()), "{}", knob.name),
                false => assert_eq!(set.unwrap_err().kind, ErrorKind::NotPermitted, "{}", knob.name),
            }
            assert!(!knob.help.is_empty());
        }
        assert_eq!(bench.sim.get("nothing"), None);
    }

    #[test]
    fn the_log_shows_transfers_and_hides_keys() {
        let bench = Bench::new();
        bench.replay("R 08 2 -> ..");
        assert!(bench.sim.log().is_empty());
        bench.sim.keep_log(true);
        bench.replay("W 00 01 00 ; R 00 2 -> 00 01 ; W 80 -> NACK");
        let mut bus = bench.sim.bus();
        bus.set_secret(true);
        bus.transfer(&[0x00, 0x14, 0x04], &mut []).unwrap();
        bus.set_secret(false);
        bus.transfer(&[0x3C], &mut []).unwrap();
        let lines: Vec<_> = bench.sim.log().iter().map(ToString::to_string).collect();
        assert_eq!(lines, ["W 00 01 00", "R 00 2 -> 00 01", "W 80 -> NACK", "; hidden", "W 3C"]);
        bench.sim.clear_log();
        assert!(bench.sim.log().is_empty());
        for _ in 0..5000 {
            bus.transfer(&[0x3C], &mut []).unwrap();
        }
        assert_eq!(bench.sim.log().len(), 4096);
    }
}

mod state {
    use super::*;

    fn file(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("gaugefs-sim-{}-{name}", std::process::id()));
        let _ = fs::remove_file(&path);
        path
    }

    fn with(path: &Path) -> Options {
        Options { state: Some(path.to_path_buf()), ..Options::default() }
    }

    #[test]
    fn flash_and_wear_outlive_the_process() {
        let path = file("keep");
        let first = Bench::with(&with(&path));
        first.replay(UNSEAL);
        first.write(48, 11, &[0x0D, 0x48]);
        let (flash, wear) = (first.sim.flash(), first.sim.get("wear"));
        // The first gauge is not shut down, as when its process is killed.
        let second = Bench::with(&with(&path));
        assert_eq!((second.sim.flash(), second.sim.get("wear")), (flash, wear));
        assert_eq!(second.sim.get("seal").unwrap(), "sealed");
        second.replay("R 3C 2 -> 48 0D");
        let mode = std::os::unix::fs::PermissionsExt::mode(&fs::metadata(&path).unwrap().permissions());
        assert_eq!(mode & 0o777, 0o600);
        fs::remove_file(path).unwrap();
    }

    #[test]
    fn a_key_can_be_given_to_a_new_gauge_only() {
        let path = file("key");
        let options = Options { unseal_key: Some([0x1234, 0x5678]), ..with(&path) };
        Bench::with(&options);
        let again = Bench::with(&with(&path));
        again.replay("W 00 34 12 ; W 00 78 56");
        assert_eq!(again.sim.get("seal").unwrap(), "unsealed");
        fs::remove_file(path).unwrap();
    }

    #[test]
    fn an_incomplete_or_foreign_state_file_is_refused() {
        let path = file("bad");
        Bench::with(&with(&path));
        let good = fs::read_to_string(&path).unwrap();
        let other = good.replace("chip bq34z100-g1", "chip bq27441-g1");
        for (text, reason) in [
            ("", "does not begin"),
            (&good[..good.len() / 2], "end is missing"),
            (&good[..good.len() - 1], "truncated"),
            (&other, "one of a bq27441-g1"),
            (&good.replace("flash 48 0000", "flash 48 0001"), "sum is wrong"),
        ] {
            fs::write(&path, text).unwrap();
            let error = Sim::new("bq34z100-g1", &with(&path), Arc::new(SimClock::new())).unwrap_err();
            assert!(error.to_string().contains(reason), "{error}");
            assert!(error.to_string().contains(path.to_str().unwrap()), "{error}");
            assert_eq!(fs::read_to_string(&path).unwrap(), text, "left as it was");
        }
        fs::remove_file(path).unwrap();
    }

    #[test]
    fn a_commit_that_cannot_be_saved_is_not_stored() {
        let folder = file("folder");
        fs::create_dir(&folder).unwrap();
        let bench = Bench::with(&with(&folder.join("state")));
        bench.replay(UNSEAL);
        let flash = bench.sim.flash();
        fs::remove_dir_all(&folder).unwrap();
        bench.write(48, 11, &[0x0D, 0x48]);
        assert_eq!(bench.sim.flash(), flash);
        assert!(bench.sim.get("state").unwrap().contains("cannot be written"));
    }

    #[test]
    fn an_unknown_chip_is_refused_with_a_list_of_the_known_ones() {
        let error = Sim::new("bq1", &Options::default(), Arc::new(SimClock::new())).unwrap_err();
        assert!(error.to_string().contains("bq34z100-g1"), "{error}");
    }
}

mod battery {
    use super::*;

    #[test]
    fn a_new_gauge_is_at_rest_and_sixty_percent_full() {
        let bench = Bench::new();
        assert_eq!(bench.percent(), 60);
        assert_eq!((bench.word(0x04), bench.word(0x06)), (600, 1000));
        assert_eq!(bench.word(0x08), 3855);
        assert_eq!(bench.word(0x0C), 2981);
        assert_eq!((bench.signed(0x0A), bench.signed(0x10)), (0, 0));
        assert_eq!((bench.word(0x18), bench.word(0x1A)), (65535, 65535));
        assert_eq!(bench.word(0x2E), 100);
        assert_eq!((bench.word(0x30), bench.word(0x32)), (4200, 500));
        // OCV has been measured, and charging is allowed.
        assert_eq!(bench.word(FLAGS), 0x0180);
        let energy = bench.word(0x24);
        assert!((2150..2300).contains(&energy), "{energy}");
    }

    #[test]
    fn an_hour_at_500_ma_moves_500_mah() {
        let bench = Bench::new();
        bench.set("load_ma", "500");
        assert_eq!(bench.signed(0x10), -500);
        assert!(bench.word(0x08) < 3855);
        assert_eq!(bench.word(FLAGS) & DSG, DSG);
        bench.sleep(60);
        assert_eq!(bench.signed(0x0A), -491);
        bench.sleep(3540);
        let remaining = i32::from(bench.word(0x04));
        assert!((remaining - 100).abs() <= 1, "{remaining}");
        assert_eq!(bench.signed(0x0A), -500);
        assert!((bench.signed(0x1C) + 500).abs() <= 1);
        assert!((i32::from(bench.word(0x18)) - 12).abs() <= 1);
        assert_eq!(bench.word(0x1A), 65535);
        let power = f64::from(bench.word(0x26));
        assert!((power - 0.5 * f64::from(bench.word(0x08))).abs() < 2.0, "{power}");
        // Losses warm the cell slightly.
        assert!((2982..3000).contains(&bench.word(0x0C)));
    }

    #[test]
    fn discharge_is_monotonic_and_ends_empty() {
        let bench = Bench::new();
        bench.set("load_ma", "400");
        let mut last = (100, u16::MAX, u16::MAX);
        let mut soc1 = false;
        for _ in 0..120 {
            bench.sleep(60);
            let now = (bench.percent(), bench.word(0x04), bench.word(0x08));
            let moving = bench.signed(0x10) < 0;
            assert!(now.0 <= last.0 && now.1 <= last.1 && (now.2 <= last.2 || !moving), "{last:?} {now:?}");
            assert!((f64::from(now.0) - f64::from(now.1) / 10.0).abs() <= 0.5, "{now:?}");
            let flags = bench.word(FLAGS);
            assert_eq!(flags & 0x0004 != 0, now.1 <= 150, "{now:?}");
            assert_eq!(flags & 0x0002 != 0, now.1 <= 75, "{now:?}");
            soc1 |= flags & 0x0004 != 0;
            last = now;
        }
        assert!(soc1);
        assert_eq!((bench.percent(), bench.word(0x04), bench.signed(0x10)), (0, 0, 0));
        assert_eq!(bench.word(FLAGS) & DSG, 0);
        assert_eq!(bench.word(0x18), 65535);
    }

    #[test]
    fn charging_tapers_and_ends_full() {
        let bench = Bench::new();
        bench.set("load_ma", "-500");
        bench.sleep(120);
        let to_full = bench.word(0x1A);
        assert!((48..58).contains(&to_full), "{to_full}");
        assert_eq!(bench.word(FLAGS) & (FC | CHG | DSG), CHG);
        let mut tapered = false;
        let mut last = 0;
        while bench.word(FLAGS) & FC == 0 {
            bench.sleep(10);
            assert!(bench.percent() >= last && bench.word(0x08) <= 4200);
            last = bench.percent();
            tapered |= bench.signed(0x10) < 200;
            assert!(bench.clock.now() < Duration::from_secs(3 * 3600), "never full");
        }
        assert!(tapered);
        assert_eq!((bench.percent(), bench.word(0x04)), (100, 1000));
        assert_eq!(bench.word(FLAGS) & CHG, 0);
        // Both flags have hysteresis: FC clears at 98 %, CHG is set again at 95 %.
        bench.set("load_ma", "1000");
        let mut seen = Vec::new();
        while bench.percent() > 90 {
            seen.push((bench.percent(), bench.word(FLAGS) & (FC | CHG)));
            bench.sleep(5);
        }
        assert!(seen.iter().all(|&(percent, flags)| (flags & FC != 0) == (percent > 98)), "{seen:?}");
        assert!(seen.iter().all(|&(percent, flags)| (flags & CHG != 0) == (percent <= 95)), "{seen:?}");
    }

    /// SLUSBZ5D table 7-17, `[RMFCC]`: a taper current of 400 mA ends the charge before the pack is full.
    #[test]
    fn rmfcc_sets_remaining_capacity_to_full_at_termination() {
        for (pack_configuration, full) in [([0x01, 0x61], true), ([0x01, 0x41], false)] {
            let bench = Bench::unsealed();
            bench.write(36, 0, &[0x01, 0x90]);
            bench.write(64, 0, &pack_configuration);
            bench.reset();
            bench.set("soc", "97");
            bench.set("load_ma", "-500");
            // FlagsB() [DODEOC]: the end of charge was detected.
            while bench.word(0x12) & 0x0400 == 0 {
                assert!(bench.word(0x04) < 999 && bench.clock.now() < Duration::from_secs(1800));
                bench.sleep(1);
            }
            assert_eq!(bench.word(0x04) == 1000, full);
            assert_eq!(bench.word(FLAGS) & FC != 0, full);
        }
    }

    #[test]
    fn cycles_count_discharge_and_survive_a_reset() {
        let bench = Bench::new();
        for _ in 0..2 {
            bench.set("soc", "100");
            bench.set("load_ma", "1000");
            bench.sleep(3600);
        }
        assert_eq!(bench.word(0x2C), 2);
        // A cycle is 900 mAh, and causes one flash write.
        assert_eq!(bench.sim.get("wear").unwrap(), "48/0 2");
        bench.replay("X 100");
        bench.reset();
        assert_eq!(bench.word(0x2C), 2);
    }

    #[test]
    fn lifetime_data_is_kept_once_impedance_track_runs() {
        let bench = Bench::new();
        bench.set("temperature", "500");
        bench.sleep(600);
        assert_eq!(bench.sim.get("wear").unwrap(), "");
        bench.replay(UNSEAL);
        bench.replay("W 00 21 00");
        bench.sleep(600);
        bench.replay("X 100");
        assert_eq!(bench.block(59, 0).0[..4], [0x01, 0xF4, 0x00, 0xC8]);
        let programmed = bench.number("programmed");
        bench.sleep(6000);
        bench.word(0x08);
        assert_eq!(bench.number("programmed"), programmed, "nothing new, nothing written");
    }

    #[test]
    fn temperature_flags_follow_their_thresholds() {
        let bench = Bench::new();
        let flags = |temperature: &str, load: &str| {
            bench.set("load_ma", load);
            bench.set("temperature", temperature);
            bench.sleep(3);
            bench.word(FLAGS) & 0xCC00
        };
        assert_eq!(flags("250", "0"), 0);
        // At rest, charging is inhibited outside 0 to 45 degrees, with a hysteresis of 5 degrees.
        assert_eq!(flags("451", "0"), 0x0800);
        assert_eq!(flags("420", "0"), 0x0800);
        assert_eq!(flags("400", "0"), 0);
        assert_eq!(flags("-1", "0"), 0x0800);
        assert_eq!(flags("250", "0"), 0);
        // While charging: suspended and over temperature above 55 degrees.
        assert_eq!(flags("250", "-500"), 0);
        assert_eq!(flags("551", "-500"), 0x8400);
        assert_eq!(bench.word(FLAGS) & CHG, 0);
        assert_eq!(flags("250", "-500"), 0);
        // While discharging: over temperature from 60 degrees until 55 degrees.
        assert_eq!(flags("590", "200") & 0x4000, 0);
        assert_eq!(flags("600", "200") & 0x4000, 0x4000);
        assert_eq!(flags("570", "200") & 0x4000, 0x4000);
        assert_eq!(flags("540", "200") & 0x4000, 0);
    }

    #[test]
    fn voltage_flags_follow_their_thresholds() {
        let bench = Bench::unsealed();
        bench.write(49, 8, &[0x0B, 0xB8, 2, 0x0C, 0x80]);
        bench.reset();
        let flags = |voltage: &str| {
            bench.set("voltage_mv", voltage);
            bench.sleep(4);
            bench.word(FLAGS) & 0x3000
        };
        assert_eq!(flags("3100"), 0);
        assert_eq!(flags("2999"), 0x1000);
        assert_eq!(flags("3100"), 0x1000);
        assert_eq!(flags("3201"), 0);
        assert_eq!(flags("4301"), 0x2000);
        assert_eq!(flags("4200"), 0);
        bench.set("voltage_mv", "auto");
        assert_eq!(bench.word(0x08), 3855);
    }

    #[test]
    fn the_number_of_cells_is_taken_from_flash() {
        let bench = Bench::unsealed();
        bench.write(64, 7, &[4]);
        bench.write(82, 0, &[0x13, 0x88]);
        bench.reset();
        assert_eq!(bench.word(0x08), 4 * 3855);
        assert_eq!((bench.percent(), bench.word(0x04), bench.word(0x06)), (60, 3000, 5000));
    }

    #[test]
    fn speed_scales_the_battery_and_0_freezes_it() {
        let bench = Bench::new();
        bench.set("load_ma", "100");
        bench.set("speed", "3600");
        bench.sleep(1);
        assert!((i32::from(bench.word(0x04)) - 500).abs() <= 1);
        bench.set("speed", "0");
        bench.sleep(36_000);
        assert!((i32::from(bench.word(0x04)) - 500).abs() <= 1);
        bench.set("speed", "1");
        bench.sleep(3600);
        assert!((i32::from(bench.word(0x04)) - 400).abs() <= 1);
    }

    #[test]
    fn long_times_are_simulated_quickly_and_accurately() {
        let bench = Bench::new();
        bench.set("load_ma", "1");
        bench.sleep(100 * 3600);
        // A current below the deadband is not shown, but the charge decreases.
        assert_eq!(bench.signed(0x10), 0);
        assert!((i32::from(bench.word(0x04)) - 500).abs() <= 1);
        bench.set("load_ma", "0");
        bench.set("speed", "100000");
        bench.sleep(365 * 24 * 3600);
        assert!((i32::from(bench.word(0x04)) - 500).abs() <= 1);
    }

    #[test]
    fn measurements_stay_constant_within_a_second() {
        let bench = Bench::new();
        bench.set("load_ma", "32000");
        bench.sleep(2);
        let mut bus = bench.sim.bus();
        let (mut first, mut second) = ([0; 32], [0; 32]);
        bus.transfer(&[0x02], &mut first).unwrap();
        bus.transfer(&[0x02], &mut second).unwrap();
        assert_eq!(first, second);
    }
}
