// SPDX-License-Identifier: MIT

//! A gauge of TI's in a Smart Battery that is asked: its questions are the only words that reach it, and what is no answer
//! of that part ends them.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{Bus, BusError, Reach};
use gauge_sim::{Options, Sim};
use ti_gauge::chip::sbs::failures::failures;
use ti_gauge::chip::sbs::ti::by_device_name;
use ti_gauge::chip::{Chip, Question, Register, Tier, Way};
use ti_gauge::gauge::{Asked, Gauge, Pec, Seal};
use ti_gauge::keys::Keys;
use ti_gauge::registers::Registers;

/// What each part's manual and drivers say of each command: code, name, part, direction, effect, source.
const COMMANDS: &str = include_str!("commands.tsv");

fn gauges() -> impl Iterator<Item = &'static Chip> {
    Chip::all().filter(|chip| chip.asks.is_some())
}

/// The parts that answer with a type, as the table names them.
fn parts_of_type(device_type: u16) -> &'static [&'static str] {
    match device_type {
        0x4500 => &["bq40z50", "bq40z50-R1", "bq40z50-R2", "bq40z50-R3", "bq40z50-R4", "bq40z50-R5"],
        0x4800 => &["bq40z80"],
        0x9e34 => &["bq4050"],
        0x0500 | 0x0550 => &["bq30z50/55-R1"],
        0x0554 => &["bq30z554-R1"],
        0x1e9b => &["bq78350", "bq78350-R1"],
        0x0450 | 0x0650 | 0x0700 | 0x0750 | 0x0800 | 0x0900 | 0x0950 => &["bq20z45/60/65/70/75/80/90/95"],
        other => panic!("no part is known to answer 0x{other:04x}"),
    }
}

#[test]
fn no_question_is_a_command_of_any_part_that_the_name_may_stand_for() {
    let rows: Vec<Vec<&str>> = COMMANDS.lines().skip(1).map(|line| line.split('\t').collect()).collect();
    assert!(rows.len() > 500 && gauges().count() > 0);
    for chip in gauges() {
        let parts = parts_of_type(chip.asks.expect("it is asked").device_type);
        for (question, name) in Question::all(chip) {
            let code = format!("0x{:04X}", question.code());
            // A key is listed as two words, one after the other.
            let of_code = rows.iter().filter(|row| row[0].contains(&code[2..]) && parts.contains(&row[2]));
            let of_code: Vec<_> = of_code.collect();
            assert!(!of_code.is_empty(), "{} {code} {name}: no row", chip.name);
            for row in of_code {
                let is_read = row[3] == "R" && row[4].starts_with("read") && row[0] == code;
                assert!(is_read, "{} {code}: {row:?}", chip.name);
            }
        }
        let rows = chip.registers.iter().filter_map(|row| row.source.answer());
        for (code, _) in rows {
            assert!(Question::of(chip, code).is_some(), "{} 0x{code:04x} cannot be asked", chip.name);
        }
    }
}

struct Bench {
    sim: Sim,
    clock: Arc<SimClock>,
    gauge: Gauge,
    chip: &'static Chip,
}

impl Bench {
    fn of(chip: &str, is_asked: bool, knobs: &[(&str, &str)]) -> Self {
        let clock = Arc::new(SimClock::new());
        let sim = Sim::new(chip, &Options::default(), clock.clone()).expect("it is simulated");
        clock.sleep(Duration::from_secs(1));
        sim.keep_log(true);
        let chip = Chip::by_name(chip).expect("a chip");
        let gauge = Gauge::new(chip, Box::new(sim.bus()), clock.clone(), Keys::default());
        let gauge = if is_asked { gauge.asked() } else { gauge };
        let bench = Self { sim, clock, gauge, chip };
        knobs.iter().for_each(|(knob, text)| bench.set(knob, text));
        bench
    }

    fn new(knobs: &[(&str, &str)]) -> Self {
        Self::of("bq40z50-r2", true, knobs)
    }

    fn set(&self, knob: &str, text: &str) {
        self.sim.set(knob, text).unwrap_or_else(|error| panic!("{knob} {text}: {error}"));
    }

    fn read(&mut self) -> Registers {
        self.try_read().expect("it answers")
    }

    fn try_read(&mut self) -> ti_gauge::error::Result<Registers> {
        let mut registers = Registers::unread(self.chip.registers);
        registers.read(&mut self.gauge, |tier| tier != Tier::Window)?;
        Ok(registers)
    }

    fn value(&self, registers: &Registers, name: &str) -> Option<i64> {
        registers.value(self.chip.registers.iter().find(|row| row.name == name).expect(name))
    }

    fn bits(&self, registers: &Registers, name: &str) -> Option<String> {
        let row = self.chip.registers.iter().find(|row| row.name == name).expect(name);
        Some(row.set(registers.value(row)?).join(" "))
    }

    fn asked(&self) -> Asked {
        self.gauge.statistics.asked()
    }

    /// The words that were sent, each of which must be a question of the part's; what else was sent is a command code
    /// before a read.
    #[track_caller]
    fn questions(&self) -> Vec<u16> {
        let known: Vec<_> = self.chip.registers.iter().filter_map(|row| row.source.command()).collect();
        let allowed: Vec<u16> = Question::all(self.chip).map(|(question, _)| question.code()).collect();
        let mut sent = Vec::new();
        for record in self.sim.log() {
            let word = match (&record.write[..], record.read.len()) {
                ([code], 1..) if known.contains(code) => continue,
                ([0x00 | 0x23 | 0x44], 1..) if !sent.is_empty() => continue,
                (&[0x00, low, high] | &[0x00, low, high, _], 0) => [low, high],
                (&[0x44, 2, low, high] | &[0x44, 2, low, high, _], 0) => [low, high],
                other => panic!("it was sent {other:?}"),
            };
            let word = u16::from_le_bytes(word);
            assert!(allowed.contains(&word), "0x{word:04x} is no question");
            sent.push(word);
        }
        assert!(self.sim.get("harm").is_none_or(|harm| harm == "0"));
        sent
    }
}

#[test]
fn without_an_agreement_nothing_is_asked_and_only_words_are_read() {
    for chip in gauges().filter(|chip| Sim::knows(chip.name)) {
        let cells = if chip.name == "bq78350" { "15" } else { "4" };
        let mut bench = Bench::of(chip.name, false, &[("series", cells)]);
        let registers = bench.read();
        assert_eq!(bench.questions(), [0; 0]);
        assert_eq!((bench.asked(), bench.sim.get("written").as_deref()), (Asked::Not, Some("0")));
        let is_asked = |row: &&ti_gauge::chip::Register| row.source.answer().is_some();
        for row in chip.registers {
            assert_eq!(
                registers.value(row).is_none() && registers.text(row).is_none(),
                is_asked(&row),
                "{}",
                row.name
            );
        }
    }
}

#[test]
fn an_asked_gauge_tells_its_type_and_firmware_first_and_then_its_status() {
    let mut bench = Bench::new(&[]);
    let registers = bench.read();
    assert_eq!(bench.asked(), Asked::Answers { way: Way::Block, version: 0x0211, build: 52 });
    assert_eq!(bench.questions()[..2], [0x0001, 0x0002]);
    assert_eq!(bench.bits(&registers, "OperationStatus").as_deref(), Some("SEC1 SEC0 CHG DSG PRES"));
    assert_eq!(bench.bits(&registers, "SafetyStatus").as_deref(), Some(""));
    assert_eq!(bench.bits(&registers, "ChargingStatus").as_deref(), Some("MV RT"));
    assert_eq!(bench.bits(&registers, "GaugingStatus").as_deref(), Some("QEN VOK REST DSG"));
    let value = |name: &str| bench.value(&registers, name);
    assert_eq!(value("DAStatus1 CellVoltage4"), Some(3855));
    assert_eq!(value("DAStatus2 GaugingTemperature"), Some(2981));
    assert_eq!(value("Lifetime MaxDischargeCurrent"), Some(-9100));
    assert_eq!((value("Lifetime MinTempCell"), value("Lifetime TimeInOT")), (Some(-3), Some(6)));
    assert_eq!((value("Lifetime CUVCount"), value("Lifetime OCD1LastCycle")), (Some(0), Some(57)));
    assert_eq!(bench.value(&registers, "Voltage"), Some(15420));

    // Each round begins with the type, and the firmware is not asked for again.
    bench.sim.clear_log();
    bench.clock.sleep(Duration::from_secs(3));
    bench.read();
    let again = bench.questions();
    assert!(again[0] == 0x0001 && !again.contains(&0x0002), "{again:04x?}");
    let statistics = &bench.gauge.statistics;
    assert_eq!(ti_gauge::gauge::Statistics::read(&statistics.pec_wrong), 0);
}

#[test]
fn each_part_answers_by_its_own_messages() {
    for (part, way, version, build, status) in [
        ("bq4050", Way::Block, 0x0001, 22, "XCHG XDSG PF SEC1 SEC0 PRES"),
        ("bq30z55", Way::Word, 0x0036, 52, "XCHG XDSG PF SEC1 SEC0 PRES"),
        ("bq20z45", Way::Back, 0x0110, 0, "PRES FAS SS"),
    ] {
        let mut bench = Bench::of(part, true, &[("pf_status", "0x00000002")]);
        let registers = bench.read();
        assert_eq!(bench.asked(), Asked::Answers { way, version, build }, "{part}");
        assert_eq!(bench.bits(&registers, "OperationStatus").as_deref(), Some(status), "{part}");
        let found = failures(bench.chip, |row| registers.value(row));
        let names: Vec<_> = found.iter().map(|one| &*one.name).collect();
        let expected = match part {
            "bq4050" => "SOV",
            "bq30z55" => "COV",
            // No source has its names.
            _ => "bit 1",
        };
        assert_eq!(names, [expected], "{part}");
        bench.questions();
    }
}

#[test]
fn every_part_of_the_tables_is_asked_all_its_questions_and_answers_them() {
    for chip in gauges() {
        let mut bench = Bench::of(chip.name, true, &[("pf_status", "0x80000002")]);
        let registers = bench.read();
        assert!(matches!(bench.asked(), Asked::Answers { .. }), "{}: {}", chip.name, bench.asked());
        for row in chip.registers.iter().filter(|row| row.source.answer().is_some()) {
            assert!(registers.value(row).is_some(), "{} {}", chip.name, row.name);
        }
        let mut asked = bench.questions();
        asked.sort_unstable();
        asked.dedup();
        let all: Vec<_> = Question::all(chip).map(|(question, _)| question.code()).collect();
        assert_eq!(asked, all, "{}", chip.name);
        // Names, or the number of a bit without one; those of a bq20z are 16.
        let bits = bench.bits(&registers, "PFStatus").expect("it answers");
        let expected = match chip.name {
            "bq40z80" => "bit 1 bit 31",
            "bq78350" => "bit 31 SOV",
            "bq30z50" | "bq30z55" | "bq30z554" => "bit 31 COV",
            "bq20z45" | "bq20z65" => "bit 1",
            _ => "TS4 SOV",
        };
        assert_eq!(bits, expected, "{}", chip.name);
    }
}

/// SLUUBC1D 13.1.41, SLUUBK0B 14.1.41 and SLUUAQ3A 13.1.37 have the same bits at other places.
#[test]
fn the_bits_of_charging_status_are_where_the_firmware_has_them() {
    let bits = |chip: &str, word| {
        let chip = Chip::by_name(chip).expect("a chip");
        chip.registers.iter().find(|row| row.name == "ChargingStatus").expect("a row").set(word).join(" ")
    };
    assert_eq!(bits("bq40z50-r1", 0x2000), "MCHG");
    assert_eq!(bits("bq40z50-r2", 0x2000), "SU");
    assert_eq!(bits("bq40z50-r5", 0x2000), "SU");
    assert_eq!((bits("bq40z50", 0x4000), bits("bq40z50-r2", 0x4000)), ("VCT".into(), "MCHG".into()));
    assert_eq!((bits("bq4050", 0x0060), bits("bq4050", 0x2000)), ("MCHG SU".into(), "bit 13".into()));
}

#[test]
fn a_part_is_named_by_what_ti_ships_as_device_name_and_by_nothing_like_it() {
    let named = |name| by_device_name(name).map(|chip| chip.name);
    assert_eq!(named("bq40z50"), Some("bq40z50"));
    assert_eq!(named("bq40z50-R1"), Some("bq40z50-r1"));
    assert_eq!(named("bq40z50-R2"), Some("bq40z50-r2"));
    assert_eq!(named("BQ4050"), Some("bq4050"));
    assert_eq!(named("bq20z451"), Some("bq20z45"));
    for name in ["bq40z50-R3", "bq40z5", "bq20z45", "bq40z50 4S", "IBM-08K8193", ""] {
        assert_eq!(named(name), None, "{name}");
    }
}

/// As a pack's checksum covers it, a bit that is flipped on the wire makes no command of it.
#[test]
fn a_question_has_its_checksum_where_the_pack_has_shown_that_it_knows_them() {
    for (specification, length) in [("0x0031", 5), ("0x0021", 4)] {
        let mut bench = Bench::new(&[("specification", specification)]);
        bench.read();
        let sent = bench.sim.log().into_iter().filter(|record| record.write.len() > 1);
        let lengths: Vec<_> = sent.map(|record| record.write.len()).collect();
        assert!(!lengths.is_empty() && lengths.iter().all(|sent| *sent == length), "{lengths:?}");
    }
    // 44 02 54 00 with 34, as computed by hand.
    let mut bench = Bench::new(&[]);
    bench.read();
    assert!(bench.sim.log().iter().any(|record| record.write == [0x44, 2, 0x54, 0x00, 0x34]));
}

#[test]
fn an_unsealed_gauge_without_checksums_is_asked_no_more() {
    let mut bench = Bench::new(&[("specification", "0x0021"), ("sealed", "off")]);
    let registers = bench.read();
    assert_eq!(bench.asked(), Asked::Unprotected);
    assert_eq!(bench.questions(), [0x0001, 0x0002, 0x0054]);
    assert_eq!(bench.bits(&registers, "PFStatus"), None);
    let mut bench = Bench::new(&[("sealed", "off")]);
    let registers = bench.read();
    assert_eq!(bench.bits(&registers, "OperationStatus").as_deref(), Some("SEC1 CHG DSG PRES"));
}

#[test]
fn an_adapter_of_smbus_commands_asks_by_words_and_one_without_blocks_not_at_all() {
    let mut bench = Bench::new(&[]);
    bench.sim.set_reach(Reach::smbus(32, true));
    let registers = bench.read();
    assert_eq!(bench.asked(), Asked::Answers { way: Way::Word, version: 0x0211, build: 52 });
    assert_eq!(bench.bits(&registers, "OperationStatus").as_deref(), Some("SEC1 SEC0 CHG DSG PRES"));
    assert_eq!(bench.value(&registers, "DAStatus2 CellTemperature"), Some(2981));
    // 32 bytes and their length do not pass, and none of them is guessed.
    assert_eq!(bench.value(&registers, "DAStatus1 CellVoltage1"), None);
    assert_eq!(bench.bits(&registers, "ChargingStatus").as_deref(), Some("MV RT"));
    bench.questions();

    // A host that reads blocks of SMBus has them whole, and compares their checksums.
    for (reach, pec) in [(Reach::smbus(32, true), Pec::Host), (Reach::smbus(2, false), Pec::Unseen)] {
        let mut bench = Bench::new(&[("pf_status", "0x00000001")]);
        bench.sim.set_reach(reach.with_blocks());
        let registers = bench.read();
        assert_eq!(bench.asked(), Asked::Answers { way: Way::Word, version: 0x0211, build: 52 });
        assert_eq!(bench.value(&registers, "DAStatus1 CellVoltage1"), Some(3855));
        assert_eq!(bench.bits(&registers, "PFStatus").as_deref(), Some("SUV"));
        assert_eq!(bench.gauge.statistics.pec(), pec);
        bench.questions();
    }
    let mut bench = Bench::of("bq20z45", true, &[]);
    bench.sim.set_reach(Reach::smbus(32, true));
    let registers = bench.read();
    assert_eq!(bench.bits(&registers, "OperationStatus").as_deref(), Some("PRES FAS SS"));

    let mut bench = Bench::new(&[]);
    bench.sim.set_reach(Reach::smbus(2, true));
    let registers = bench.read();
    assert_eq!((bench.asked(), bench.value(&registers, "Voltage")), (Asked::NotCarried, Some(15420)));
    assert_eq!(bench.questions(), [0; 0]);
}

#[test]
fn an_answer_that_is_not_the_parts_ends_asking_until_the_next_mount() {
    for (knobs, ended, most) in [
        (&[("device_type", "0x9e34")][..], Asked::OtherType(0x9e34), 3),
        // Without an echo each repeated answer is doubted, and the type asked between.
        (&[("ti_firmware", "0x0402")], Asked::OtherFirmware(0x0402), 8),
        (&[("mac", "echo")], Asked::Unclear, 15),
        (&[("mac", "noise")], Asked::Unclear, 15),
        (&[("mac", "silent")], Asked::Silent, 15),
    ] {
        for reach in [Reach::FULL, Reach::smbus(32, true)] {
            if reach.smbus && knobs[0] == ("mac", "echo") {
                continue;
            }
            let mut bench = Bench::new(knobs);
            bench.sim.set_reach(reach);
            let registers = bench.read();
            assert_eq!((bench.asked(), bench.value(&registers, "Voltage")), (ended, Some(15420)));
            let sent = bench.questions();
            assert!(sent.len() <= most && sent.iter().all(|code| *code <= 0x0002), "{knobs:?}: {sent:04x?}");
            bench.sim.clear_log();
            // Not even by another pack that comes in its place.
            ["device_type", "ti_firmware"].iter().for_each(|knob| bench.set(knob, "printed"));
            bench.set("mac", "right");
            for _ in 0..3 {
                bench.clock.sleep(Duration::from_secs(3));
                bench.read();
            }
            assert_eq!(bench.questions(), [0; 0], "{knobs:?}");
            if ended != Asked::Silent {
                bench.gauge.start_over();
                bench.read();
                assert_eq!(bench.questions(), [0; 0], "{knobs:?}");
            }
        }
    }
}

#[test]
fn a_pack_that_is_exchanged_between_two_polls_gets_its_type_asked_and_nothing_else() {
    let mut bench = Bench::new(&[]);
    bench.read();
    bench.sim.clear_log();
    bench.set("device_type", "0x1e9b");
    bench.clock.sleep(Duration::from_secs(3));
    let registers = bench.read();
    assert_eq!((bench.asked(), bench.bits(&registers, "PFStatus")), (Asked::OtherType(0x1e9b), None));
    assert!(bench.questions().iter().all(|code| *code == 0x0001));
}

#[test]
fn a_pack_that_has_gone_is_asked_anew_when_it_comes_back() {
    let mut bench = Bench::new(&[]);
    bench.read();
    bench.set("power", "off");
    bench.try_read().map(drop).expect_err("it is gone");
    bench.try_read().map(drop).expect_err("it is gone");
    bench.set("power", "on");
    bench.clock.sleep(Duration::from_secs(2));
    bench.sim.clear_log();
    bench.gauge.start_over();
    let registers = bench.read();
    assert_eq!(bench.bits(&registers, "PFStatus").as_deref(), Some(""));
    assert_eq!(bench.questions()[..2], [0x0001, 0x0002]);
}

/// While it programs its flash, a block is that of the question before, and nothing on the bus says so.
#[test]
fn a_stale_block_is_told_by_its_echo_and_without_one_by_its_type() {
    for reach in [Reach::FULL, Reach::smbus(32, true)] {
        for stale in 1..=3 {
            for skip in [false, true] {
                let mut bench = Bench::new(&[]);
                bench.sim.set_reach(reach);
                bench.set("pf_status", "0x00000001");
                let right = bench.read();
                let right = ["PFStatus", "SafetyStatus", "DAStatus2 TS1Temperature"]
                    .map(|name| bench.value(&right, name));
                if skip {
                    bench.clock.sleep(Duration::from_secs(3));
                }
                bench.set("stale", &stale.to_string());
                let registers = bench.read();
                for (name, right) in
                    ["PFStatus", "SafetyStatus", "DAStatus2 TS1Temperature"].into_iter().zip(right)
                {
                    let value = bench.value(&registers, name);
                    assert!(value == right || value.is_none(), "{name}: {value:?} of {right:?}");
                }
            }
        }
    }
}

#[test]
fn a_code_that_the_part_does_not_know_has_no_value_and_the_others_have_theirs() {
    for reach in [Reach::FULL, Reach::smbus(32, true)] {
        for unknown in ["0x0051", "0x0056", "0x0072", "0x0053 0x0054 0x0055"] {
            let mut bench = Bench::new(&[("unknown", unknown)]);
            bench.sim.set_reach(reach);
            for _ in 0..2 {
                let registers = bench.read();
                for row in bench.chip.registers.iter().filter(|row| row.source.answer().is_some()) {
                    let (code, _) = row.source.answer().expect("it is asked");
                    let is_unknown = unknown.contains(&format!("{code:04x}"));
                    let is_long = reach.smbus && matches!(code, 0x60 | 0x63 | 0x64 | 0x71);
                    let value = registers.value(row);
                    assert_eq!(value.is_none(), is_unknown || is_long, "{unknown}: {} {value:?}", row.name);
                }
            }
            bench.questions();
        }
    }
}

#[test]
fn a_permanent_failure_has_its_reasons_and_what_to_look_at() {
    let mut bench = Bench::new(&[("pf_status", "0x00000801")]);
    let registers = bench.read();
    let found = failures(bench.chip, |row| registers.value(row));
    let told: Vec<_> = found.iter().map(|one| format!("{}: {}; {}", one.name, one.what, one.check)).collect();
    assert_eq!(found.len(), 2, "{told:?}");
    assert!(told[1].starts_with("SUV: a cell was far below") && told[1].ends_with("at its tabs"), "{told:?}");
    assert_eq!(bench.bits(&registers, "BatteryStatus").as_deref(), Some("TCA TDA INIT DSG"));
    let registers = Bench::new(&[]).read();
    assert_eq!(failures(bench.chip, |row| registers.value(row)), []);
}

/// Every call of a gauge, in packs of every manner, with faults on the bus: all that reaches it is on the list.
#[test]
fn no_draw_of_calls_packs_and_faults_sends_what_is_not_on_the_list() {
    let draws = if std::env::var_os("GAUGEFS_ALL_FAULTS").is_some() { 100_000 } else { 1_000 };
    let mut state = 0x5eed_u64;
    let mut below = move |limit: u64| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) % limit
    };
    let parts: Vec<_> = gauges().filter(|chip| Sim::knows(chip.name)).map(|chip| chip.name).collect();
    let (mut done, mut asked) = (0, 0);
    while done < draws {
        let part = parts[below(parts.len() as u64) as usize];
        let mut bench = Bench::of(part, below(8) > 0, &[]);
        let host = Reach::smbus(32, true);
        let reach = [
            Reach::FULL,
            host,
            host.with_blocks(),
            Reach::smbus(2, false).with_blocks(),
            Reach::ONE_BYTE_A_WRITE,
        ];
        bench.sim.set_reach(reach[below(7).saturating_sub(2) as usize]);
        bench.set("specification", ["0x0031", "0x0021"][below(2) as usize]);
        bench.set("pec", ["right", "right", "split", "missing"][below(4) as usize]);
        bench.set("sealed", ["on", "off"][below(2) as usize]);
        bench.set("mac", ["right", "right", "right", "right", "echo", "noise", "silent"][below(7) as usize]);
        for _ in 0..40 {
            done += 1;
            match below(6) {
                0 => bench.set("stale", &below(4).to_string()),
                1 => bench.set("fault", &format!("nack {} {}", below(40) + 1, below(3))),
                2 => bench
                    .set("fault", &format!("burst {} {} {} 255", below(40) + 1, below(3) + 1, below(3) + 1)),
                3 => bench.set("fault", &format!("flip {} {} {}", below(40) + 1, below(8), below(8))),
                _ => {}
            }
            let gauge = &mut bench.gauge;
            let (code, byte) = (below(0x10000) as u16, below(256) as u8);
            match below(16) {
                0..6 => drop(bench.try_read()),
                6 => drop(gauge.command(code)),
                7 => drop(gauge.ask(code)),
                8 => drop((
                    gauge.write(byte, &[2, code as u8, 0]),
                    gauge.write_once(byte, &code.to_le_bytes()),
                )),
                9 => drop((gauge.unseal(), gauge.full_access(), gauge.close())),
                10 => drop((gauge.identify(), gauge.whole_firmware_answer(), gauge.go_to(Seal::FullAccess))),
                11 => drop((gauge.word(byte), gauge.read(byte, &mut [0; 34]))),
                12 => drop(gauge.command_once([0x0010, 0x0029, 0x0030, 0x0041, code][below(5) as usize])),
                13 => gauge.start_over(),
                14 => drop(ti_gauge::probe::check(gauge)),
                _ => bench.clock.sleep(Duration::from_secs(below(30))),
            }
        }
        asked += bench.questions().len();
    }
    assert!(asked > draws / 2, "{asked}");
}

/// A bq40z50-R2 on a bus of SMBus commands, without checksums: its block stays until another question is taken.
struct Script {
    /// The questions, as they were taken.
    taken: Arc<Mutex<Vec<u16>>>,
    manner: Manner,
    /// The block, and the one before it.
    block: Vec<u8>,
    before: Vec<u8>,
}

#[derive(Clone, Copy, PartialEq)]
enum Manner {
    /// PFStatus() reads as the address of the pack, and what is read behind it is its block.
    Late,
    /// PFStatus() cannot be read, and then another part is there.
    Exchanged,
    /// Blocks of DAStatus2() read as the address of the pack.
    Address,
    /// Its firmware says that it is a bq4050's.
    Firmware,
}

impl Script {
    fn answer(&self, code: u16) -> Vec<u8> {
        let is_other = self.manner == Manner::Exchanged && self.taken.lock().unwrap().contains(&0x0053);
        let kind = if is_other { 0x9e34_u16 } else { 0x4500 };
        let of_firmware = if self.manner == Manner::Firmware { 0x9e34 } else { kind };
        match code {
            0x0001 => kind.to_le_bytes().to_vec(),
            0x0002 => [&of_firmware.to_be_bytes()[..], &[2, 0x11, 0, 52, 0, 3, 0x85, 2, 0]].concat(),
            0x0053 => vec![1, 0, 0, 0],
            0x0054 => vec![0x01, 0x73, 0, 0],
            0x0072 if self.manner == Manner::Address => vec![0x17; 0x17],
            other => panic!("0x{other:04x} is not asked here"),
        }
    }
}

impl Bus for Script {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let bytes = match *write {
            [0x1a] => vec![0x21, 0],
            [0x16] => vec![0xc0, 0],
            [0x23] => {
                let last = self.taken.lock().unwrap().last().copied();
                let is_late = self.manner == Manner::Late;
                let is_behind = is_late && self.taken.lock().unwrap().ends_with(&[0x0053, 0x0054]);
                let block = match last {
                    Some(0x0053) if self.manner == Manner::Exchanged => return Err(BusError::NoAck),
                    Some(0x0053) if is_late => &vec![0x17; 0x17],
                    _ if is_behind => &self.before,
                    _ => &self.block,
                };
                [&[block.len() as u8], &**block].concat()
            }
            [0x00, low, high] => {
                let code = u16::from_le_bytes([low, high]);
                self.taken.lock().unwrap().push(code);
                let block = self.answer(code);
                self.before = std::mem::replace(&mut self.block, block);
                return Ok(());
            }
            _ => return Err(BusError::NoAck),
        };
        read.iter_mut()
            .zip(bytes.into_iter().chain(std::iter::repeat(0xff)))
            .for_each(|(to, byte)| *to = byte);
        Ok(())
    }

    fn reach(&mut self) -> Reach {
        Reach::smbus(32, true)
    }
}

/// What such a pack tells of these rows, what came of asking, and the questions.
fn scripted(manner: Manner, names: &[&str]) -> (Vec<Option<i64>>, Asked, Vec<u16>) {
    let chip = Chip::by_name("bq40z50-r2").expect("a chip");
    let rows: Vec<Register> = names
        .iter()
        .filter_map(|name| chip.registers.iter().find(|row| row.name == *name))
        .copied()
        .collect();
    let rows: &'static [Register] = rows.leak();
    let taken = Arc::new(Mutex::new(Vec::new()));
    let script = Script { taken: taken.clone(), manner, block: Vec::new(), before: Vec::new() };
    let clock = Arc::new(SimClock::new());
    let mut gauge = Gauge::new(chip, Box::new(script), clock, Keys::default()).asked();
    let mut registers = Registers::unread(rows);
    registers.read(&mut gauge, |_| true).expect("it answers");
    let values = rows.iter().map(|row| registers.value(row)).collect();
    let taken = taken.lock().unwrap().clone();
    (values, gauge.statistics.asked(), taken)
}

#[test]
fn without_an_echo_an_answer_behind_one_that_did_not_arrive_is_asked_for_again() {
    let (values, _, _) = scripted(Manner::Late, &["PFStatus", "OperationStatus"]);
    assert_eq!(values, [None, Some(0x7301)]);
}

#[test]
fn a_pack_that_is_exchanged_between_two_questions_gets_its_type_asked_and_nothing_else() {
    let names = ["PFStatus", "OperationStatus", "DAStatus2 CellTemperature"];
    let (values, asked, taken) = scripted(Manner::Exchanged, &names);
    assert_eq!((&values[..], asked), (&[None; 3][..], Asked::OtherType(0x9e34)));
    let last = taken.iter().rposition(|code| *code == 0x0053).expect("it is asked");
    let behind = &taken[last + 1..];
    assert!((1..=3).contains(&behind.len()) && behind.iter().all(|code| *code == 0x0001), "{taken:04x?}");
}

#[test]
fn a_block_that_is_the_address_of_the_pack_is_no_answer() {
    let (values, asked, _) = scripted(Manner::Address, &["OperationStatus", "DAStatus2 CellTemperature"]);
    assert!(matches!(asked, Asked::Answers { way: Way::Word, .. }), "{asked}");
    assert_eq!(values, [Some(0x7301), None]);
}

#[test]
fn firmware_of_another_type_than_the_type_ends_asking() {
    let (values, asked, taken) = scripted(Manner::Firmware, &["OperationStatus"]);
    assert_eq!((&values[..], asked), (&[None][..], Asked::OtherType(0x9e34)));
    assert!(taken.iter().all(|code| *code <= 0x0002), "{taken:04x?}");
}

/// With checksums, whatever the bus does to a message.
#[test]
fn no_draw_of_faults_shows_a_status_that_is_not_the_packs() {
    let draws = if std::env::var_os("GAUGEFS_ALL_FAULTS").is_some() { 10_000 } else { 200 };
    let mut state = 0xfa17_u64;
    let mut below = move |limit: u64| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) % limit
    };
    let names =
        ["PFStatus", "OperationStatus", "SafetyStatus", "ChargingStatus", "DAStatus2 CellTemperature"];
    let (mut told, mut left_out) = (0, 0);
    for _ in 0..draws {
        let mut bench = Bench::new(&[("pf_status", "0x00000801")]);
        let host = Reach::smbus(32, true);
        bench.sim.set_reach([Reach::FULL, host, host.with_blocks()][below(3) as usize]);
        bench.read();
        for _ in 0..8 {
            bench.clock.sleep(Duration::from_secs(2));
            let at = below(80) + 1;
            let fault = match below(4) {
                0 => format!("nack {at} {}", below(3)),
                1 => format!("burst {at} {} {} {}", below(4) + 1, below(4) + 1, [0, 255][below(2) as usize]),
                2 => format!("flip {at} {} {}", below(8), below(8)),
                _ => (0..9).map(|more| format!("nack {} 0", at + 2 * more)).collect::<Vec<_>>().join("; "),
            };
            bench.set("fault", &fault);
            bench.set("stale", &below(3).to_string());
            let Ok(registers) = bench.try_read() else { continue };
            for (name, right) in names.iter().zip([0x0801, 0x7301, 0, 0x0408, 2981]) {
                match bench.value(&registers, name) {
                    Some(value) => assert_eq!(value, right, "{name} after {fault}"),
                    None => left_out += 1,
                }
                told += 1;
            }
        }
    }
    assert!(told > 10 * draws && left_out > 0, "{told} {left_out}");
}
