// SPDX-License-Identifier: MIT

//! A learning cycle of a simulated gauge, watched as `gaugefs learn` watches it: a poll every 30 s.

use std::time::Duration;

use gauge_bus::clock::Clock;
use ti_gauge::chip::Role;
use ti_gauge::learning::{Bits, Cycle, Learned, Learns, Limits, Reading, Spoiled, State};

use crate::rig::Rig;

const HOUR: u64 = 3600;

/// A gauge whose cycle is watched.
struct Bench {
    rig: Rig,
    cycle: Cycle,
    states: Vec<State>,
}

impl Bench {
    /// An empty pack that has rested, with Impedance Track enabled.
    fn new() -> Self {
        Self::on("bq34z100-g1")
    }

    fn on(chip: &str) -> Self {
        let mut bench = Self::disabled(chip);
        bench.rig.send(&[0x0021]);
        bench.states.clear();
        bench.poll();
        bench
    }

    fn disabled(chip: &str) -> Self {
        let rig = Rig::found(chip, ti_gauge::gauge::Seal::Unsealed);
        rig.sim.keep_log(false);
        rig.sim.set("soc", "0").expect("a knob");
        rig.clock.sleep(Duration::from_secs(1));
        let learns = Learns::of(rig.gauge.chip).expect("it learns");
        let limits = Limits { cells: Some(1.0), ..Limits::default() };
        let mut bench = Self { rig, cycle: Cycle::new(learns, limits), states: Vec::new() };
        bench.poll();
        bench
    }

    fn set(&mut self, knob: &str, value: &str) {
        self.rig.sim.set(knob, value).expect("a knob");
    }

    /// Reads what a poll reads.
    fn poll(&mut self) -> &State {
        let gauge = &mut self.rig.gauge;
        let mut names: Vec<&str> = Vec::new();
        let status = gauge.control_status().expect("an answer").1;
        names.extend(
            gauge.chip.control_status.iter().filter(|bit| status & bit.mask != 0).map(|bit| bit.name),
        );
        let mut reading = Reading {
            time: self.rig.clock.now().as_secs_f64(),
            has_learned_status: gauge.chip.registers.iter().any(|register| register.name == "LearnedStatus"),
            ..Reading::default()
        };
        for register in gauge.chip.registers {
            if register.role.is_none() && register.name != "LearnedStatus" {
                continue;
            }
            let mut bytes = [0; 2];
            let code = register.source.command().expect("a standard command");
            gauge.read(code, &mut bytes[..usize::from(register.size)]).expect("an answer");
            let word = u16::from_le_bytes(bytes);
            names.extend(
                register.bits.iter().filter(|bit| u32::from(word) & bit.mask != 0).map(|bit| bit.name),
            );
            match register.role {
                Some(Role::CurrentNow) => reading.current_ma = f64::from(word as i16),
                Some(Role::VoltageNow) => reading.voltage_mv = Some(f64::from(word)),
                Some(Role::Temp) => reading.degrees = Some((f64::from(word) - 2731.0) / 10.0),
                Some(Role::ChargeFullDesign) => reading.design_mah = Some(f64::from(word)),
                Some(Role::Capacity) => reading.percent = Some(f64::from(word)),
                _ => {}
            }
        }
        reading.bits = Bits::named(names);
        self.states.push(self.cycle.update(&reading));
        self.last()
    }

    fn last(&self) -> &State {
        self.states.last().expect("a poll")
    }

    /// Polls for a time.
    fn pass(&mut self, seconds: u64) -> &State {
        for _ in 0..seconds / 30 {
            self.rig.clock.sleep(Duration::from_secs(30));
            self.poll();
        }
        self.last()
    }

    /// Lets a current flow until it ends by itself.
    fn flow(&mut self, load_ma: &str) -> &State {
        self.set("load_ma", load_ma);
        self.pass(60);
        for _ in 0..40 * 120 {
            self.pass(30);
            if self.last().rate.is_none() {
                return self.last();
            }
        }
        panic!("it does not end: {:?}", self.last());
    }

    /// From the empty pack to Qmax.
    fn learn_qmax(&mut self) {
        self.flow("-500");
        self.set("load_ma", "0");
        let state = self.pass(3 * HOUR);
        assert_eq!((state.update_status, state.learned, state.spoiled), (Some(0x05), Learned::Qmax, None));
    }

    #[track_caller]
    fn update_status(&mut self) -> u8 {
        self.rig.read(82, 4).expect("data flash")[0]
    }

    /// What went wrong first, as the line says it.
    fn trouble(&self) -> String {
        let clock = |time: f64| format!("{time:.0}");
        self.states
            .iter()
            .find(|state| state.spoiled.is_some())
            .map_or_else(String::new, |state| state.line(clock))
    }
}

#[test]
fn a_whole_cycle_takes_update_status_to_06() {
    for chip in ["bq34z100-g1", "bq34z100-r2"] {
        let mut bench = Bench::on(chip);
        assert_eq!(bench.last().waits_for, "a charge to full");
        assert_eq!(bench.last().bits, "VOK -RUP_DIS QEN");
        bench.learn_qmax();
        assert_eq!(bench.update_status(), 0x05, "{chip}");
        assert_eq!(bench.last().waits_for, "a discharge to empty at C/10 to C/2");
        bench.flow("200");
        bench.set("load_ma", "0");
        let taken = bench.pass(300);
        assert!(taken.waits_for.starts_with("an open-circuit voltage"), "{taken:?}");
        let state = bench.pass(5 * HOUR).clone();
        assert_eq!((state.update_status, state.learned), (Some(0x06), Learned::All), "{chip}");
        assert_eq!(bench.update_status(), 0x06, "{chip}");
        let qmax = u16::from_be_bytes(bench.rig.read(82, 0).expect("data flash").try_into().expect("a word"));
        assert!((995..=1005).contains(&qmax), "{chip}: {qmax}");
        let wrong: Vec<_> = bench.states.iter().filter_map(|state| state.spoiled).collect();
        assert_eq!(wrong, [], "{chip}");
    }
}

/// A learning cycle at 1000 times the speed, polled every 3 s.
#[test]
fn a_cycle_at_speed() {
    let mut rig = Rig::found("bq34z100-g1", ti_gauge::gauge::Seal::Unsealed);
    for (knob, value) in [("soc", "0"), ("speed", "1000")] {
        rig.sim.set(knob, value).expect("a knob");
    }
    rig.send(&[0x0021]);
    for (load, seconds) in [("-500", 12), ("0", 12), ("200", 20), ("0", 20)] {
        rig.sim.set("load_ma", load).expect("a knob");
        for _ in 0..seconds / 2 {
            rig.clock.sleep(Duration::from_secs(2));
            rig.gauge.seal().expect("an answer");
        }
    }
    assert_eq!(rig.read(82, 4).expect("data flash"), [0x06]);
}

#[test]
fn without_it_enable_nothing_is_learned() {
    let mut bench = Bench::disabled("bq34z100-g1");
    bench.flow("-500");
    bench.pass(3 * HOUR);
    assert_eq!(bench.last().spoiled, Some(Spoiled::NotEnabled));
    assert!(bench.last().since.before);
    assert_eq!(bench.update_status(), 0x00);
}

#[test]
fn a_rest_that_a_load_interrupts() {
    let mut bench = Bench::new();
    bench.flow("-500");
    bench.set("load_ma", "0");
    assert_eq!(bench.pass(600).spoiled, None);
    bench.set("load_ma", "100");
    bench.pass(60);
    let state = bench.last().clone();
    assert!(
        matches!(state.spoiled, Some(Spoiled::RestInterrupted(rested, ma)) if rested >= 600.0 && ma == -100.0)
    );
    // The rest begins again, and its open-circuit voltage counts.
    bench.set("load_ma", "0");
    assert!(matches!(bench.pass(1200).spoiled, Some(Spoiled::RestInterrupted(..))));
    assert_eq!(bench.update_status(), 0x04);
    let state = bench.pass(2 * HOUR);
    assert_eq!((state.update_status, state.spoiled), (Some(0x05), None));
    assert!(bench.trouble().contains("100 mA ended the rest after 0:1"), "{}", bench.trouble());
}

#[test]
fn a_pack_that_is_too_cold_or_too_warm_at_rest() {
    for (ambient, says) in [("50", "taken at 5.0 °C"), ("450", "taken at 45.0 °C")] {
        let mut bench = Bench::new();
        bench.flow("-500");
        bench.set("load_ma", "0");
        bench.set("temperature", ambient);
        bench.pass(5 * HOUR);
        assert!(matches!(bench.last().spoiled, Some(Spoiled::Temperature(_))), "{:?}", bench.last());
        assert!(bench.trouble().contains(says), "{}", bench.trouble());
        assert_eq!(bench.update_status(), 0x04);
    }
}

#[test]
fn an_open_circuit_voltage_in_the_flat_range() {
    let mut bench = Bench::new();
    bench.learn_qmax();
    bench.set("load_ma", "200");
    bench.pass(5 * HOUR / 2);
    bench.set("load_ma", "0");
    bench.pass(3 * HOUR);
    assert!(matches!(bench.last().spoiled, Some(Spoiled::Flat(_))), "{:?}", bench.last());
    assert!(bench.trouble().contains("is in the flat range, 3737 to 3800 mV"), "{}", bench.trouble());
    assert_eq!(bench.update_status(), 0x05);
}

#[test]
fn too_little_charge() {
    // The first time 90 % are needed, and later 37 %.
    let mut bench = Bench::new();
    bench.set("load_ma", "-500");
    bench.pass(HOUR * 3 / 2);
    bench.set("load_ma", "0");
    bench.pass(3 * HOUR);
    assert!(
        matches!(bench.last().spoiled, Some(Spoiled::TooLittleCharge(Some(passed), needed))
            if (74.0..76.0).contains(&passed) && needed == 90.0),
        "{:?}",
        bench.last()
    );
    assert_eq!(bench.update_status(), 0x04);
    let mut bench = Bench::new();
    bench.learn_qmax();
    bench.set("load_ma", "200");
    bench.pass(HOUR);
    bench.set("load_ma", "0");
    bench.pass(3 * HOUR);
    assert!(bench.trouble().ends_with("20 % of the design capacity, 37 % needed"), "{}", bench.trouble());
    assert_eq!(bench.update_status(), 0x05);
    // The rest of the discharge is added to it.
    bench.flow("200");
    bench.set("load_ma", "0");
    bench.pass(5 * HOUR);
    assert_eq!(bench.update_status(), 0x06);
}

#[test]
fn a_reset_in_the_middle() {
    let mut bench = Bench::new();
    bench.set("load_ma", "-500");
    bench.pass(HOUR);
    bench.rig.send(&[0x0041]);
    bench.rig.clock.sleep(Duration::from_secs(1));
    bench.poll();
    assert_eq!(bench.last().spoiled, Some(Spoiled::Reset));
    assert_eq!(bench.last().bits, "-VOK RUP_DIS QEN");
    bench.flow("-500");
    bench.set("load_ma", "0");
    assert_eq!(bench.pass(3 * HOUR).spoiled, None);
    assert_eq!(bench.update_status(), 0x04);
    assert!(bench.trouble().ends_with("the gauge was reset; begin again with a rest"), "{}", bench.trouble());
}

#[test]
fn a_current_that_does_not_suit_ra() {
    for (load, says) in [("80", "not at C/12.5"), ("1000", "not at 1.0 C")] {
        let mut bench = Bench::new();
        bench.learn_qmax();
        bench.flow(load);
        bench.set("load_ma", "0");
        bench.pass(5 * HOUR);
        assert!(bench.trouble().ends_with(says), "{}", bench.trouble());
        assert_eq!(bench.last().spoiled, Some(Spoiled::RaNotLearned));
        assert_eq!(bench.update_status(), 0x05);
    }
}

/// With the wrong chemistry, the measured resistance is negative.
#[test]
fn a_voltage_that_does_not_fit_the_charge() {
    let mut bench = Bench::new();
    bench.learn_qmax();
    bench.set("voltage_mv", "4190");
    bench.set("load_ma", "200");
    bench.pass(HOUR);
    assert_eq!(bench.last().spoiled, Some(Spoiled::RaOff));
    assert!(bench.trouble().contains("[RUP_DIS] is set, Ra is not updated"), "{}", bench.trouble());
}

#[test]
fn a_current_without_an_open_circuit_voltage_before_it() {
    let mut bench = Bench::new();
    bench.rig.send(&[0x0041]);
    bench.rig.clock.sleep(Duration::from_secs(1));
    let limits = Limits::default();
    bench.cycle = Cycle::new(Learns::ImpedanceTrack, limits);
    bench.set("load_ma", "-500");
    bench.pass(60);
    assert_eq!(bench.last().spoiled, Some(Spoiled::NoOpenCircuitVoltage));
}

#[test]
fn the_line() {
    let mut cycle = Cycle::new(Learns::ImpedanceTrack, Limits::default());
    let mut reading = Reading {
        time: 1000.0,
        bits: Bits::named(["QEN", "VOK", "OCVTAKEN", "ITEN", "CF0"]),
        voltage_mv: Some(4180.0),
        degrees: Some(25.1),
        design_mah: Some(1000.0),
        percent: Some(99.0),
        has_learned_status: true,
        ..Reading::default()
    };
    let clock = |time: f64| format!("@{time:.0}");
    assert_eq!(
        cycle.update(&reading).line(clock),
        "update status 05; waits for a discharge to empty at C/10 to C/2; resting for at least 0:00 h; 25.1 °C; \
         VOK -RUP_DIS QEN; qualified since before @1000"
    );
    (reading.time, reading.current_ma) = (1030.0, -200.0);
    cycle.update(&reading);
    (reading.time, reading.bits) = (4630.0, Bits::named(["QEN", "VOK", "RUP_DIS", "ITEN", "CF0"]));
    assert_eq!(
        cycle.update(&reading).line(clock),
        "update status 05; waits for the end of the discharge, then a rest; discharging for 1:00 h at C/5.0; 25.1 °C; \
         VOK RUP_DIS QEN; disqualified since @4630: [RUP_DIS] is set, Ra is not updated: no valid state of charge, \
         or the chemistry is wrong"
    );
    reading.bits = Bits::named(["QEN", "ITEN", "CF1"]);
    assert_eq!(
        cycle.update(&reading).line(clock),
        "update status 06; learned; discharging for 1:00 h at C/5.0; 25.1 °C; -VOK -RUP_DIS QEN; since @4630"
    );
}

/// A poll an hour shows the charge, and then a rest with its open-circuit voltage: that was no reset.
#[test]
fn polls_that_are_far_apart() {
    let mut cycle = Cycle::new(Learns::ImpedanceTrack, Limits::default());
    let mut read = |time, bits: &[&str], current_ma| {
        let bits = Bits::named(bits.iter().copied());
        cycle.update(&Reading { time, bits, current_ma, has_learned_status: true, ..Reading::default() })
    };
    assert_eq!(read(0.0, &["QEN", "VOK", "OCVTAKEN", "ITEN"], 500.0).spoiled, None);
    let rested = read(3600.0, &["QEN", "OCVTAKEN", "ITEN", "CF0"], 0.0);
    assert_eq!((rested.spoiled, rested.learned), (None, Learned::Qmax));
    assert_eq!(read(7200.0, &["QEN", "VOK", "OCVTAKEN", "ITEN", "CF0"], -200.0).spoiled, None);
    assert_eq!(read(7230.0, &["QEN", "RUP_DIS", "ITEN", "CF0"], -200.0).spoiled, Some(Spoiled::Reset));
}

/// A part with RAM shows what it has updated; a CEDV part what its discharge is worth.
#[test]
fn parts_that_learn_otherwise() {
    let learns = |chip| ti_gauge::chip::Chip::by_name(chip).and_then(Learns::of);
    assert_eq!(learns("bq27520-g3"), Some(Learns::ImpedanceTrack));
    assert_eq!(learns("bq27500"), Some(Learns::ImpedanceTrack));
    for chip in ["bq27441-g1", "bq27421-g1", "bq27426", "bq27427"] {
        assert_eq!(learns(chip), Some(Learns::InRam), "{chip}");
    }
    for chip in ["bq27220", "bq34110"] {
        assert_eq!(learns(chip), Some(Learns::FullCharge), "{chip}");
    }
    assert_eq!((learns("bq27621-g1"), learns("bq35100")), (None, None));

    let mut ram = Cycle::new(Learns::InRam, Limits::default());
    let mut time = 0.0;
    let mut read = |cycle: &mut Cycle, bits: &[&str], current_ma| {
        time += 30.0;
        let bits = Bits::named(bits.iter().copied());
        cycle.update(&Reading { time, bits, current_ma, design_mah: Some(1000.0), ..Reading::default() })
    };
    assert_eq!(read(&mut ram, &["OCVTAKEN", "VOK"], 0.0).learned, Learned::Nothing);
    let state = read(&mut ram, &["QMAX_UP", "VOK"], -200.0);
    assert_eq!((state.learned, state.spoiled, state.update_status), (Learned::Qmax, None, None));
    assert_eq!(state.bits, "VOK -RUP_DIS QMAX_UP -RES_UP");
    assert_eq!(read(&mut ram, &["QMAX_UP", "RES_UP"], 0.0).learned, Learned::All);

    let mut cedv = Cycle::new(Learns::FullCharge, Limits::default());
    assert!(read(&mut cedv, &[], 0.0).waits_for.starts_with("a charge to full"));
    assert_eq!(read(&mut cedv, &["VDQ"], -200.0).waits_for, "the discharge down to EDV2");
    let charged = read(&mut cedv, &[], 200.0);
    assert_eq!(charged.spoiled, Some(Spoiled::DischargeDisqualified(true)));
    assert_eq!(read(&mut cedv, &["VDQ"], -200.0).spoiled, None);
    assert_eq!(read(&mut cedv, &[], -200.0).spoiled, Some(Spoiled::DischargeDisqualified(false)));
    read(&mut cedv, &["VDQ"], -200.0);
    assert_eq!(read(&mut cedv, &["EDV2"], -200.0).learned, Learned::All);
}
