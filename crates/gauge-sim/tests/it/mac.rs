// SPDX-License-Identifier: MIT

//! The simulated bq27220, bq34110 and bq35100, compared byte by byte with the manuals and with traffic that owners have
//! published.

use std::sync::Arc;

use gauge_bus::Bus;
use gauge_bus::clock::SimClock;
use gauge_sim::{Options, Sim};

use crate::bench::Bench;

const UNSEAL: &str = "W 00 14 04 ; W 00 72 36";
const FULL_ACCESS: &str = "X 5000 ; W 00 FF FF ; W 00 FF FF";

fn bench(chip: &str) -> Bench {
    with(chip, &Options::default())
}

fn with(chip: &str, options: &Options) -> Bench {
    let clock = Arc::new(SimClock::new());
    let sim = Sim::new(chip, options, clock.clone()).unwrap();
    Bench { sim, clock }
}

fn unsealed(chip: &str) -> Bench {
    let bench = bench(chip);
    bench.replay(UNSEAL);
    assert_eq!(bench.sim.get("seal").unwrap(), "unsealed");
    bench
}

/// Checksum of a word and data (SLUUBH1C 12.1.3).
fn sum(bytes: &[u8]) -> u8 {
    255 - bytes.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte))
}

mod protocol {
    use super::*;

    /// SLUA790 section 3: Operation Config A, read and set to the end-of-service mode.
    #[test]
    fn operation_config_a_as_in_slua790() {
        let bench = unsealed("bq35100");
        bench.replay("W 3E B1 41 ; R 40 1 -> 80");
        bench.replay("W 3E B1 41 ; W 40 82 ; W 60 8B ; W 61 05 ; X 100");
        bench.replay("W 3E 00 40 ; W 3E B1 41 ; R 40 1 -> 82");
        assert_eq!(bench.sim.get("wear").unwrap(), "0/13 1");
    }

    /// SLUUBH1C 12.1.3: two words at 0x4000, written and read.
    #[test]
    fn two_words_as_in_sluubh1c_12_1_3() {
        for traffic in [
            "W 3E 00 40 ; W 40 12 34 56 78 ; W 60 AB ; W 61 08",
            "W 3E 00 40 12 34 56 78 ; W 60 AB 08",
            "W 3E 00 40 ; W 40 12 34 56 78 ; W 60 AB 08",
        ] {
            let bench = unsealed("bq35100");
            bench.replay(traffic);
            bench.replay("X 100 ; W 3E 02 40 ; R 40 2 -> 56 78 ; W 3E 00 40 ; R 40 4 -> 12 34 56 78");
        }
    }

    #[test]
    fn a_read_returns_echo_checksum_and_length() {
        for chip in ["bq34110", "bq35100"] {
            let bench = unsealed(chip);
            for (address, length) in [(0x4000u16, 36), (0x41F5, 36), (0x43E0, 36), (0x43E1, 35), (0x43FF, 5)]
            {
                let [low, high] = address.to_le_bytes();
                let mut bus = bench.sim.bus();
                bus.transfer(&[0x3E, low, high], &mut []).unwrap();
                let mut read = [0; 36];
                bus.transfer(&[0x3E], &mut read).unwrap();
                assert_eq!((read[0], read[1], read[35]), (low, high, length), "{address:#x}");
                assert_eq!(read[34], sum(&read[..2 + usize::from(length) - 4]), "{address:#x}");
            }
            // There is no data beyond the end.
            bench.replay("W 3E 00 44 ; R 3E 2 -> 00 44 ; R 61 1 -> 05");
        }
    }

    /// Nothing is stored, and the gauge does not report it.
    #[test]
    fn a_wrong_checksum_length_or_order_stores_nothing() {
        let bench = unsealed("bq35100");
        let flash = bench.sim.flash();
        for wrong in [
            "W 3E B1 41 ; W 40 82 ; W 60 8C ; W 61 05",
            // Trailing zeros would not change the checksum, so only the length is wrong.
            "W 3E B1 41 ; W 40 82 ; W 60 8B ; W 61 0A",
            "W 3E B1 41 ; W 40 82 ; W 60 8B ; W 61 04",
            "W 3E B1 41 ; W 40 82 ; W 60 8B ; W 61 01",
            "W 3E B1 41 ; W 40 82 ; W 60 8B ; W 61 25",
            "W 3E B1 41 ; W 40 82 ; W 61 05 ; W 60 8B",
            "W 3E B1 41 ; W 40 82 ; W 61 05",
            "W 3E B1 41 ; W 40 82 ; W 60 8B",
            // Another word or other data, written after the checksum.
            "W 3E B1 41 ; W 40 82 ; W 60 8B ; W 3E B1 41 ; W 61 05",
            "W 3E B1 41 ; W 60 8B ; W 40 82 ; W 61 05",
            // Beyond the end, with the right checksum.
            "W 3E FF 43 ; W 40 82 01 ; W 60 3A 06",
        ] {
            bench.replay(wrong);
            bench.replay("X 100");
            assert!(bench.sim.flash() == flash, "{wrong}");
        }
        // The buffer shows the written bytes nevertheless.
        bench.replay("W 3E B1 41 ; W 40 82 ; W 60 8C 05 ; R 40 1 -> 82 ; W 3E B1 41 ; R 40 1 -> 80");
    }

    /// SLUUBH1C 12.1.3 allows 1 to 32 bytes, which may span two flash pages that the gauge erases separately.
    #[test]
    fn writes_of_any_length_at_any_address() {
        let bench = unsealed("bq34110");
        for (address, count) in [(0x4036u16, 32usize), (0x401F, 2), (0x43FF, 1)] {
            let [low, high] = address.to_le_bytes();
            let data: Vec<u8> = (1..=count as u8).collect();
            let mut message = vec![0x3E, low, high];
            message.extend(&data);
            let mut bus = bench.sim.bus();
            bus.transfer(&message, &mut []).unwrap();
            bus.transfer(&[0x60, sum(&message[1..]), count as u8 + 4], &mut []).unwrap();
            bench.replay("X 100");
            let at = usize::from(address - 0x4000);
            assert_eq!(bench.sim.flash()[at..at + count], data, "{address:#x}");
        }
    }

    #[test]
    fn a_sealed_gauge_shows_and_stores_nothing() {
        for chip in ["bq34110", "bq35100"] {
            let bench = bench(chip);
            let flash = bench.sim.flash();
            bench.replay("W 3E 00 40 ; R 3E 4 -> 00 40 00 00 ; R 61 1 -> 04");
            bench.replay("W 3E 00 40 12 34 56 78 ; W 60 AB 08 ; X 100");
            bench.replay("W 00 41 00 ; R 08 1 -> ..");
            assert_eq!(bench.sim.flash(), flash);
            assert_eq!(bench.sim.get("resets").unwrap(), "0");
        }
    }

    #[test]
    fn an_early_read_shows_the_previous_answer() {
        let bench = unsealed("bq35100");
        bench.set("load_ms", "10");
        bench.replay("W 3E 03 00 ; X 20 ; R 40 2 -> A8 00 ; W 3E 01 00 ; R 3E 4 -> 01 00 A8 00");
        bench.replay("X 20 ; R 40 2 -> 00 01");
        // Data is lost if it is written before the block is loaded, unless it is in the same message.
        bench.replay("W 3E B1 41 ; W 40 82 ; X 20 ; R 40 1 -> 80 ; W 3E B1 41 82 ; R 40 1 -> 82");
        let flash = bench.sim.flash();
        bench.replay("X 20 ; W 3E B1 41 ; W 40 82 ; W 60 8B 05 ; X 100");
        assert!(bench.sim.flash() == flash);
    }

    #[test]
    fn what_is_written_shows_before_its_sum_or_only_after_it() {
        let bench = unsealed("bq35100");
        bench.replay(
            "W 3E 00 40 ; W 40 12 34 56 78 ; R 40 4 -> 12 34 56 78 ; W 3E 00 40 ; R 40 3 -> 7F 71 20",
        );
        bench.set("uncommitted", "stored");
        bench.replay("W 40 12 34 56 78 ; R 40 3 -> 7F 71 20 ; W 60 AB 08 ; R 40 4 -> 12 34 56 78 ; X 100");
        bench.replay("W 3E 00 40 ; R 40 4 -> 12 34 56 78");
    }

    #[test]
    fn writes_below_the_voltage_limit_are_dropped() {
        for (chip, address) in [("bq34110", "57 41"), ("bq35100", "B6 41")] {
            let bench = unsealed(chip);
            bench.replay(&format!("W 3E {address} ; R 40 2 -> 0A F0"));
            bench.set("voltage_mv", "2799");
            bench.replay("W 3E 00 40 ; W 40 12 34 56 78 ; W 60 AB 08 ; X 100");
            bench.replay("W 3E 00 40 ; R 40 3 -> 7F 71 20");
            assert_eq!(bench.sim.get("dropped").unwrap(), "1");
            bench.set("voltage_mv", "2800");
            bench.replay("W 3E 00 40 ; W 40 12 34 56 78 ; W 60 AB 08 ; X 100");
            bench.replay("W 3E 00 40 ; R 40 4 -> 12 34 56 78");
        }
    }

    #[test]
    fn power_loss_while_programming_tears_the_write() {
        let bench = unsealed("bq35100");
        bench.set("fault", "torn-commit 1");
        bench.replay("W 3E 00 40 ; W 40 12 34 56 78 ; W 60 AB 08 ; R 08 1 -> NACK");
        assert_eq!(bench.sim.flash()[..4], [0x12, 0x34, 0x20, 0x5B]);
        bench.set("power", "on");
        bench.replay("X 200 ; R 00 2 -> 80 60");
    }

    /// github.com/pilotak/BQ35100 at 01505a5f sends ENTER_CAL alone.
    #[test]
    fn enter_cal_is_enough_unless_the_gauge_wants_cal_enable_before_it() {
        let bench = unsealed("bq35100");
        let mode = || bench.sim.get("mode").unwrap();
        bench.replay("W 00 81 00");
        assert_eq!(mode(), "calibration");
        bench.replay("W 00 80 00");
        assert_eq!(mode(), "normal");
        bench.set("cal_enable", "on");
        bench.replay("W 00 81 00");
        assert_eq!(mode(), "normal");
        bench.replay("W 00 2D 00 ; W 00 81 00");
        assert_eq!(mode(), "calibration");
    }

    #[test]
    fn a_state_file_keeps_flash() {
        let path = std::env::temp_dir().join(format!("gaugefs-mac-{}", std::process::id()));
        let options = Options { state: Some(path.clone()), ..Options::default() };
        let first = with("bq35100", &options);
        first.replay(UNSEAL);
        first.replay("W 3E B1 41 ; W 40 82 ; W 60 8B ; W 61 05 ; X 100");
        let second = with("bq35100", &options);
        second.replay(UNSEAL);
        second.replay("W 3E B1 41 ; R 40 1 -> 82");
        assert!(Sim::new("bq34110", &options, Arc::new(SimClock::new())).is_err());
        std::fs::remove_file(path).unwrap();
    }
}

mod security {
    use super::*;

    /// E2E 888302, with the pause that the second key needs.
    #[test]
    fn seal_states_of_the_bq35100() {
        let bench = bench("bq35100");
        bench.replay("R 00 2 -> 80 60");
        bench.replay(UNSEAL);
        bench.replay("R 00 2 -> 80 40 ; W 00 FF FF ; W 00 FF FF ; R 00 2 -> 80 40");
        bench.replay(FULL_ACCESS);
        bench.replay("R 00 2 -> 80 20");
        // From FULL ACCESS the gauge gets to UNSEALED only through SEALED.
        bench.replay(UNSEAL);
        bench.replay("R 00 2 -> 80 20 ; W 00 20 00 ; R 00 2 -> 80 60");
        // ManufacturerAccessControl() has the same effect.
        bench.replay("W 3E 14 04 ; W 3E 72 36 ; R 00 2 -> 80 40 ; W 3E 20 00 ; R 00 2 -> 80 60");
    }

    #[test]
    fn seal_states_of_the_bq34110() {
        let bench = bench("bq34110");
        bench.replay("R 3A 2 -> 06 02 ; R 00 2 -> 00 00");
        bench.replay(UNSEAL);
        bench.replay("R 3A 2 -> 04 02");
        // On this part 0x0020 has another meaning.
        bench.replay("W 00 20 00 ; R 3A 2 -> 04 02 ; W 00 57 00 ; R 40 2 -> 04 00");
        bench.replay(FULL_ACCESS);
        bench.replay("R 3A 2 -> 02 02 ; W 3E 54 00 ; R 40 2 -> 02 02 ; W 00 30 00 ; R 3A 2 -> 06 02");
    }

    #[test]
    fn another_word_between_the_key_words_invalidates_the_key() {
        let bench = bench("bq34110");
        bench.set("reset_busy", "nack");
        bench.replay("W 00 14 04 ; W 3E 00 40 ; W 00 72 36 ; R 3A 1 -> 06");
        bench.replay("W 00 72 36 ; W 00 14 04 ; R 3A 1 -> 06 ; W 00 14 04 ; R 3A 1 -> 06 ; W 00 72 36");
        bench.replay("R 3A 1 -> 04 ; W 00 41 00 ; R 08 1 -> NACK ; X 200 ; R 3A 1 -> 06");
    }

    #[test]
    fn keys_can_be_changed_in_full_access_only() {
        let write = "W 3E CC 41 11 11 22 22 ; W 60 8C 08 ; X 100";
        let bench = unsealed("bq35100");
        bench.replay(write);
        bench.replay("W 3E CC 41 ; R 40 4 -> 04 14 36 72");
        bench.replay(FULL_ACCESS);
        bench.replay(write);
        bench.replay("W 3E CC 41 ; R 40 4 -> 11 11 22 22 ; W 00 20 00");
        bench.replay(UNSEAL);
        bench.replay("R 00 2 -> 80 60 ; W 00 11 11 ; W 00 22 22 ; R 00 2 -> 80 40");

        let write = "W 3E 35 00 11 11 22 22 FF FF FF FF ; W 60 68 0C ; X 100";
        let bench = unsealed("bq34110");
        bench.replay(write);
        bench.replay("W 00 35 00 ; R 40 8 -> 14 04 72 36 FF FF FF FF");
        bench.replay(FULL_ACCESS);
        bench.replay(write);
        bench.replay("W 00 35 00 ; R 40 8 -> 11 11 22 22 FF FF FF FF");
    }

    #[test]
    fn a_new_gauge_can_be_given_another_key() {
        for chip in ["bq34110", "bq35100"] {
            let key = Some([0x1234, 0x5678]);
            let bench = with(chip, &Options { unseal_key: key, ..Options::default() });
            bench.replay(UNSEAL);
            assert_eq!(bench.sim.get("seal").unwrap(), "sealed");
            bench.replay("W 00 34 12 ; W 00 78 56");
            assert_eq!(bench.sim.get("seal").unwrap(), "unsealed");
        }
    }
}

/// Traffic of owners and drivers; where it failed, with the cause of the failure.
mod traffic {
    use super::*;

    #[test]
    fn identity() {
        let bench = bench("bq34110");
        bench.replay("W 3E 01 00 ; R 40 2 -> 10 01");
        // The first read is 0xFFA5, the second CONTROL_STATUS.
        bench.replay("R 00 2 -> A5 FF ; R 00 2 -> 00 00 ; W 00 02 00 ; R 00 2 -> A5 FF ; R 00 2 -> 00 00");
        let bench = super::bench("bq35100");
        bench.replay("W 00 03 00 ; R 40 2 -> A8 00 ; W 3E 01 00 ; R 40 2 -> 00 01 ; R 00 2 -> 80 60");
        bench.replay("W 3E 07 00 ; R 40 2 -> 01 00");
    }

    /// E2E 834655: the factory value of CC Gain, and a write that changed nothing.
    #[test]
    fn cc_gain_and_a_write_at_low_voltage() {
        let bench = unsealed("bq34110");
        bench.replay("W 3E 00 40 ; R 40 4 -> 7F 71 20 5C");
        bench.set("voltage_mv", "700");
        bench.replay("W 3E 00 40 ; W 40 12 34 56 78 ; W 60 AB 08 ; X 100");
        bench.replay("W 3E 00 40 ; R 40 4 -> 7F 71 20 5C");
    }

    #[test]
    fn voltage_follows_the_divider() {
        let bench = unsealed("bq34110");
        bench.set("voltage_mv", "3500");
        bench.replay("W 3E 10 40 ; W 40 17 70 ; W 60 28 06 ; X 100");
        assert_eq!(bench.word(0x08), 4200);
        bench.replay("W 3E 10 40 ; W 40 00 64 ; W 60 4B 06 ; X 100");
        assert_eq!(bench.word(0x08), 70);
        bench.replay("W 3E 10 40 ; W 40 13 88 ; W 60 14 06 ; X 100 ; W 3E 10 40 ; R 40 2 -> 00 64");
    }

    /// E2E 846947.
    #[test]
    fn operation_config_a_at_low_voltage() {
        let write = "W 3E 3A 41 ; W 40 12 04 ; W 60 6E ; W 61 06 ; X 100";
        let bench = unsealed("bq34110");
        bench.set("voltage_mv", "700");
        bench.replay(write);
        bench.replay("W 3E 3A 41 ; R 40 2 -> 00 04");
        bench.set("voltage_mv", "auto");
        bench.replay(write);
        bench.replay("W 3E 3A 41 ; R 40 2 -> 12 04");
    }

    /// E2E 797502: the write is dropped; with enough voltage it stores a wrong value, because the bytes are swapped.
    #[test]
    fn design_capacity_in_both_byte_orders() {
        let swapped = "W 3E F5 41 ; W 40 70 17 ; W 60 42 ; W 61 06 ; X 100";
        let bench = unsealed("bq34110");
        bench.set("voltage_mv", "700");
        bench.replay(swapped);
        bench.replay("W 3E F5 41 ; R 40 2 -> 08 98");
        bench.set("voltage_mv", "auto");
        bench.replay(swapped);
        assert_eq!(bench.word(0x3C), 0x7017);
        bench.replay("W 3E F5 41 ; W 40 17 70 ; W 60 42 ; W 61 06 ; X 100");
        assert_eq!(bench.word(0x3C), 6000);
    }

    /// E2E 992107.
    #[test]
    fn security_keys() {
        let bench = unsealed("bq34110");
        bench.replay("W 00 35 00 ; R 40 8 -> 14 04 72 36 FF FF FF FF");
        bench.replay("W 00 30 00 ; W 00 35 00 ; R 40 2 -> 00 00");
    }

    /// E2E 668766 and the FRED driver: some parts have data flash one byte lower than documented.
    #[test]
    fn parts_with_data_flash_one_byte_lower() {
        let bench = unsealed("bq35100");
        bench.set("df_shift", "1");
        bench.replay("W 3E CC 41 ; R 40 4 -> 14 36 72 FF ; W 3E CB 41 ; R 40 4 -> 04 14 36 72");
        let bench = unsealed("bq34110");
        bench.set("df_shift", "1");
        bench.replay("W 3E C5 41 ; R 40 2 -> DC 17 ; W 3E C4 41 ; R 40 2 -> CF DC");
        bench.replay("W 3E 00 40 ; R 40 4 -> 7F 71 20 5C");
    }

    /// Mfg Status Init as a lead-acid driver writes it; it takes effect with the next initialisation.
    #[test]
    fn mfg_status_init() {
        let bench = unsealed("bq34110");
        bench.replay("W 3E D7 40 00 0B ; W 60 DD 06 ; X 100 ; W 3E 57 00 ; R 40 2 -> 00 00");
        bench.replay("W 00 41 00 ; X 200");
        bench.replay(UNSEAL);
        bench.replay("W 3E 57 00 ; R 40 2 -> 0B 00");
        // With PIN_CONTROL_EN it is the 0x001B of E2E 616405.
        bench.replay("W 00 22 00 ; W 3E 57 00 ; R 40 2 -> 1B 00");
    }
}

mod bq35100 {
    use super::*;

    fn used(bench: &Bench) -> i32 {
        let mut read = [0; 4];
        bench.sim.bus().transfer(&[0x02], &mut read).unwrap();
        i32::from_le_bytes(read)
    }

    #[test]
    fn counts_down_between_start_and_stop() {
        let bench = bench("bq35100");
        bench.set("load_ma", "36");
        bench.sleep(10);
        assert_eq!((used(&bench), bench.signed(0x0C)), (0, 0));
        bench.replay("W 00 11 00 ; R 00 2 -> 81 60");
        bench.sleep(100);
        assert!((-1020..=-1000).contains(&used(&bench)), "{}", used(&bench));
        assert_eq!(bench.signed(0x0C), -36);
        bench.replay("R 0A 1 -> 01 ; W 00 12 00 ; R 00 2 -> 80 60 ; X 3000 ; R 00 2 -> C0 60");
        let counted = used(&bench);
        bench.sleep(100);
        assert_eq!((used(&bench), bench.signed(0x0C)), (counted, 0));
        // The count survives a power loss only after GAUGE_STOP.
        bench.replay("W 00 11 00 ; X 60000");
        assert!(used(&bench) < counted);
        bench.set("power", "off");
        bench.set("power", "on");
        bench.replay("X 200");
        assert_eq!(used(&bench), counted);
    }

    #[test]
    fn a_primary_cell_cannot_be_charged() {
        let bench = bench("bq35100");
        assert!(bench.sim.set("load_ma", "-10").is_err());
        assert_eq!(bench.sim.get("soc").unwrap(), "100.0");
    }

    #[test]
    fn end_of_service_mode_reports_health_and_impedance() {
        let bench = unsealed("bq35100");
        bench.replay("W 3E B1 41 ; W 40 82 ; W 60 8B ; W 61 05 ; X 100");
        bench.set("soc", "70");
        bench.set("load_ma", "20");
        bench.replay("W 00 11 00 ; X 2000 ; W 00 12 00 ; X 3000 ; R 2E 1 -> 46");
        assert_eq!(bench.word(0x22), 2000);
        // NEW_BATTERY works on a sealed gauge, too.
        bench.replay("W 00 20 00 ; W 3E 13 A6 ; X 100 ; R 2E 1 -> 64 ; R 22 2 -> 00 00");
    }

    #[test]
    fn alerts_are_latched_and_cleared() {
        let bench = unsealed("bq35100");
        bench.replay("R 0A 2 -> 00 00");
        // ALERT Configuration: BATLOW and G_DONE.
        bench.replay("W 3E B2 41 82 ; W 60 8A 05 ; X 100");
        bench.replay("W 00 11 00 ; X 2000 ; W 00 12 00 ; X 3000 ; R 0A 2 -> 04 02 ; R 0A 2 -> 00 00");
        bench.set("soc", "0");
        bench.replay("X 5000 ; R 0B 1 -> 00 ; X 7000 ; R 0A 1 -> 04 ; R 0B 1 -> 80 ; R 0B 1 -> 80");
        bench.set("soc", "50");
        bench.replay("X 2000 ; R 0B 1 -> 00");
    }
}

mod bq34110 {
    use super::*;

    #[test]
    fn discharges_and_charges() {
        let bench = bench("bq34110");
        assert_eq!((bench.word(0x10), bench.word(0x12), bench.word(0x2C)), (1320, 2200, 60));
        assert_eq!((bench.word(0x16), bench.word(0x18), bench.word(0x2E)), (0xFFFF, 0xFFFF, 100));
        bench.set("load_ma", "1100");
        bench.sleep(360);
        assert_eq!((bench.signed(0x0C), bench.signed(0x14), bench.word(0x2C)), (-1100, -1100, 55));
        assert!((65..=66).contains(&bench.word(0x16)), "{}", bench.word(0x16));
        assert_eq!(bench.word(0x0A) & 0x0003, 0x0001);
        bench.set("load_ma", "-1100");
        bench.sleep(120);
        assert_eq!(bench.word(0x0A) & 0x0003, 0x0002);
        assert_eq!(bench.word(0x16), 0xFFFF);
        assert!(bench.word(0x18) < 70);
        bench.sleep(4 * 3600);
        assert_eq!((bench.word(0x2C), bench.word(0x0A) & 0x0018), (100, 0x0018));
        bench.set("load_ma", "500");
        bench.sleep(5 * 3600);
        assert_eq!((bench.word(0x2C), bench.word(0x0A) & 0x4020), (0, 0x4020));
        assert_eq!(bench.word(0x2A), 1);
    }

    #[test]
    fn calibration_sets_its_status_bits() {
        let bench = unsealed("bq34110");
        bench.replay("W 00 09 00 ; R 00 2 -> 30 00 ; X 6000 ; R 00 2 -> 00 00");
        bench.replay("W 00 0A 00 ; R 00 2 -> 20 00 ; X 6000 ; W 00 0B 00 ; X 100");
        bench.replay("W 3E 08 40 ; R 40 2 -> FB 64 ; W 00 2D 00 ; W 3E 57 00 ; R 40 2 -> 00 80");
        assert_eq!(bench.sim.get("mode").unwrap(), "calibration");
    }
}

mod bq28z610 {
    use super::*;

    /// As bq28z610-arduino-driver sends them, with the sums of its dump and its waits.
    #[test]
    fn transcripts_of_the_arduino_driver() {
        let bench = bench("bq28z610");
        bench.replay("W 3E 01 00 ; X 5 ; R 3E 4 -> 01 00 10 26");
        bench.replay("W 3E 02 00 ; X 5 ; R 3E D -> 02 00 26 10 00 17 00 16 00 03 85 00 00");
        bench.replay("W 3E 54 00 ; X 5 ; R 3E 6 -> 54 00 82 43 00 00 ; R 61 1 -> 08");
        bench.replay("W 00 14 04 ; X 5 ; W 00 72 36 ; X 1000");
        bench.replay("W 3E 54 00 ; X 5 ; R 3E 4 -> 54 00 82 42");
        // The first dump's block.
        let block: [u8; 32] = [
            0x5C, 0x07, 0, 0, 0, 0, 0xFA, 0, 0xFA, 0, 0x70, 0x17, 0xB8, 0x0B, 0x0A, 0xA0, 0x0F, 0x0F, 0,
            0x32, 0x32, 0, 0xC2, 0x01, 0x05, 0x14, 0, 0x0A, 0x14, 0xF6, 0xFF, 0xB0,
        ];
        bench.sim.set_flash(0, 0x600, &block);
        bench.replay(
            "W 3E 00 46 ; R 3E 24 -> 00 46 5C 07 00 00 00 00 FA 00 FA 00 70 17 B8 0B 0A A0 0F 0F 00 32 32 00 C2 01 05 14 \
             00 0A 14 F6 FF B0 4D 24",
        );
        bench.replay("W 3E 2A 46 48 0D ; W 60 3A 06 ; X 200 ; W 3E 2A 46 ; R 3E 4 -> 2A 46 48 0D");
    }

    /// E2E 1547680: bqStudio reads gains of another part.
    #[test]
    fn a_trace_of_bqstudio() {
        let bench = unsealed("bq28z610");
        bench.sim.set_flash(0, 0x006, &[0x0C, 0x78, 0x65, 0x40, 0xD5, 0x8A, 0x82, 0x49]);
        bench.sim.set_flash(0, 0x014, &[0, 0]);
        bench.replay(
            "W 3E 06 40 ; R 3E 24 -> 06 40 0C 78 65 40 D5 8A 82 49 00 00 40 00 00 00 00 00 00 00 00 FF FF FF FF FF FF FF \
             FF FF FF FF FF FF 33 24",
        );
        bench.replay(
            "W 3E 0A 40 ; R 3E 24 -> 0A 40 D5 8A 82 49 00 00 40 00 00 00 00 00 00 00 00 FF FF FF FF FF FF FF FF FF FF FF FF \
             FF FF FF FF FF 5C 24",
        );
    }

    /// E2E 939805: TI's example for a host.
    #[test]
    fn a_write_as_ti_explains_it() {
        let bench = unsealed("bq28z610");
        bench
            .replay("W 3E 00 47 01 02 03 04 ; W 60 AE 08 ; X 200 ; W 3E 00 47 ; R 3E 6 -> 00 47 01 02 03 04");
    }

    /// SLUUCO9A: another read of a block shows the next one. A read of a part of it does not.
    #[test]
    fn a_block_that_was_read_makes_room_for_the_next() {
        let bench = unsealed("bq28z610");
        bench.replay("W 3E 00 44 ; R 3E 4 -> 00 44 91 D0 ; R 3E 4 -> 00 44 91 D0 ; R 60 2 -> FC 24");
        let whole = |first: &str| {
            let mut read = [0; 36];
            bench.sim.bus().transfer(&[0x3E], &mut read).unwrap();
            assert_eq!(format!("{:02X} {:02X}", read[0], read[1]), first);
            assert_eq!(read[34], sum(&read[..34]), "{first}");
        };
        whole("00 44");
        whole("20 44");
        whole("40 44");
        bench.replay("W 3E 54 00 ; R 3E 2 -> 54 00");
        whole("54 00");
        whole("54 00");
    }

    /// E2E 791892.
    #[test]
    fn control_shows_full_access_as_none() {
        let bench = bench("bq28z610");
        bench.replay("R 00 2 -> 00 60");
        bench.replay("W 00 14 04 ; W 00 72 36 ; R 00 2 -> 00 40");
        bench.replay(
            "X 5000 ; W 00 FF FF ; W 00 FF FF ; R 00 2 -> 00 00 ; W 3E 54 00 ; R 3E 4 -> 54 00 82 41",
        );
        bench.replay("W 00 30 00 ; R 00 2 -> 00 60");
    }
}

mod bq27220 {
    use super::*;

    const FULL_ACCESS: &str = "W 00 FF FF ; W 00 FF FF";

    /// SLUUBD4A 6.1: Design Capacity is changed from 3000 to 1200 mAh.
    #[test]
    fn design_capacity_as_in_sluubd4a_6_1() {
        let bench = bench("bq27220");
        bench.replay(UNSEAL);
        bench.replay(FULL_ACCESS);
        bench.replay("W 00 90 00 ; X 1000 ; R 3B 1 -> 04");
        bench.replay("W 3E 9F ; W 3F 92 ; X 20 ; R 61 1 -> 24 ; R 40 2 -> 0B B8");
        bench.replay("W 40 04 ; W 41 B0 ; W 60 1A ; W 61 06 ; X 20");
        bench.replay("W 00 91 00 ; X 2000 ; R 3B 1 -> 00 ; W 00 30 00 ; R 3A 1 -> 26 ; R 3C 2 -> B0 04");
    }

    /// The manual's other example, with its checksum: a byte of 0 at 0x9221.
    #[test]
    fn the_checksum_covers_the_address() {
        let bench = bench("bq27220");
        bench.replay(UNSEAL);
        bench.replay(FULL_ACCESS);
        let wear = || bench.sim.get("wear").unwrap();
        bench.replay("W 00 90 00 ; X 1000 ; W 3E 21 92 00 ; W 60 4C 05 ; X 20");
        assert_eq!(wear(), "0/5 1");
        bench.replay("W 3E 21 92 00 ; W 60 4D 05 ; X 20");
        assert_eq!(wear(), "0/5 1");
    }

    #[test]
    fn data_memory_is_written_in_full_access_and_config_update_only() {
        let bench = bench("bq27220");
        let memory = bench.sim.flash();
        let write = "W 3E 9F 92 04 B0 ; W 60 1A 06 ; X 20";
        bench.replay(write);
        bench.replay(UNSEAL);
        bench.replay(write);
        bench.replay("W 00 90 00 ; X 1000 ; R 3B 1 -> 00");
        bench.replay(FULL_ACCESS);
        bench.replay(write);
        assert!(bench.sim.flash() == memory);
        bench.replay("W 00 90 00 ; X 1000 ; R 3B 1 -> 04");
        bench.replay(write);
        assert!(bench.sim.flash() != memory);
    }

    /// A loss of power loses written values without a sign of it, and the gauge comes back UNSEALED.
    #[test]
    fn power_loss_and_reset_restore_what_is_in_one_time_programmable_memory() {
        for lose in ["W 00 41 00", ""] {
            let bench = bench("bq27220");
            let memory = bench.sim.flash();
            bench.replay(UNSEAL);
            bench.replay(FULL_ACCESS);
            bench.replay("W 00 90 00 ; X 1000 ; W 3E 9F 92 04 B0 ; W 60 1A 06 ; X 20 ; W 00 91 00 ; X 2000");
            assert!(bench.sim.flash() != memory);
            if lose.is_empty() {
                bench.set("power", "off");
                bench.set("power", "on");
            } else {
                bench.replay(lose);
            }
            bench.replay("X 1000 ; R 3A 2 -> 24 00 ; R 3C 2 -> B8 0B");
            assert!(bench.sim.flash() == memory);
        }
    }

    #[test]
    fn identity_is_answered_elsewhere() {
        let bench = bench("bq27220");
        bench.replay("W 00 01 00 ; X 20 ; R 00 2 -> A5 FF ; R 3E 4 -> 01 00 20 02 ; R 00 2 -> 00 00");
    }
}

#[test]
fn every_knob_is_readable_and_accepts_its_own_text() {
    for chip in ["bq27220", "bq34110", "bq35100"] {
        let bench = bench(chip);
        for knob in bench.sim.knobs() {
            let shown = bench.sim.get(knob.name).unwrap_or_else(|| panic!("{}", knob.name));
            assert_eq!(bench.sim.set(knob.name, &shown).is_ok(), knob.writable, "{}", knob.name);
        }
        assert!(bench.sim.set("auth_order", "as-sent").is_err());
    }
}
