// SPDX-License-Identifier: MIT

//! A Smart Battery: nothing but a command code and a read reaches it, and what is no answer of a pack is no value.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{AdapterModel, Bus, BusError, Reach};
use gauge_sim::{Options, Sim};
use ti_gauge::chip::{Chip, Role, Tier};
use ti_gauge::error::{Cause, Result};
use ti_gauge::gauge::{Gauge, Pec, Seal, Statistics, reads};
use ti_gauge::keys::Keys;
use ti_gauge::probe;
use ti_gauge::registers::Registers;
use ti_gauge::rom::Beside;

use crate::rig::Random;
use crate::room::drawn;

struct Bench {
    sim: Sim,
    clock: Arc<SimClock>,
    gauge: Gauge,
}

fn sbs() -> &'static Chip {
    Chip::by_name("sbs").expect("a chip")
}

impl Bench {
    fn new() -> Self {
        let clock = Arc::new(SimClock::new());
        let sim = Sim::new("sbs", &Options::default(), clock.clone()).expect("it is simulated");
        clock.sleep(Duration::from_secs(1));
        sim.keep_log(true);
        let gauge = Gauge::new(sbs(), Box::new(sim.bus()), clock.clone(), Keys::default());
        Self { sim, clock, gauge }
    }

    /// A pack with these settings.
    fn with(knobs: &[(&str, &str)]) -> Self {
        let bench = Self::new();
        knobs.iter().for_each(|(knob, text)| bench.set(knob, text));
        bench
    }

    fn set(&self, knob: &str, text: &str) {
        self.sim.set(knob, text).unwrap_or_else(|error| panic!("{knob} {text}: {error}"));
    }

    fn read(&mut self) -> Result<Registers> {
        let mut registers = Registers::unread(sbs().registers);
        registers.read(&mut self.gauge, |tier| tier != Tier::Window)?;
        Ok(registers)
    }

    fn property(&mut self, role: Role) -> Option<i64> {
        self.read().expect("it answers").property(role)
    }

    fn text(&mut self, role: Role) -> Option<String> {
        let registers = self.read().expect("it answers");
        registers.text(sbs().register(role).expect("a register")).map(ToString::to_string)
    }

    /// The codes that were sent, each before a read.
    #[track_caller]
    fn codes(&self) -> Vec<u8> {
        let codes = self.sim.log().into_iter().map(|record| match (&record.write[..], record.read.len()) {
            ([code], 1..) => *code,
            other => panic!("it was sent {other:?}"),
        });
        codes.collect()
    }

    fn counts(&self) -> (u64, u64) {
        let statistics = &self.gauge.statistics;
        (Statistics::read(&statistics.pec_checked), Statistics::read(&statistics.pec_wrong))
    }
}

#[test]
fn each_row_is_read_by_its_code_and_nothing_else_is() {
    let mut bench = Bench::new();
    let registers = bench.read().expect("it answers");
    for row in sbs().registers {
        assert!(registers.value(row).is_some() || registers.text(row).is_some(), "{}", row.name);
    }
    let known: Vec<_> = sbs().registers.iter().filter_map(|row| row.source.command()).collect();
    let sent = bench.codes();
    assert!(sent.iter().all(|code| known.contains(code)) && known.iter().all(|code| sent.contains(code)));
    assert!(!known.contains(&0x2f) && !known.contains(&0x23) && known.iter().all(|code| *code <= 0x3f));
    assert_eq!(bench.sim.get("written").as_deref(), Some("0"));
}

/// The dialect has no way to write, whatever is asked of a gauge.
#[test]
fn no_call_of_a_gauge_sends_more_than_a_code_and_a_read() {
    let mut bench = Bench::new();
    let gauge = &mut bench.gauge;
    let mut refused = 0;
    for code in 0..=u8::MAX {
        for data in [&[][..], &[0], &[0x10, 0x00], &[0; 32]] {
            refused += u32::from(gauge.write(code, data).is_err());
            refused += u32::from(gauge.write_once(code, data).is_err());
        }
        let _ = (gauge.word(code), gauge.read(code, &mut [0; 3]), gauge.read(code, &mut []));
    }
    assert_eq!(refused, 256 * 8);
    for word in [0x0000, 0x0001, 0x0010, 0x0029, 0x0030, 0x0041, 0x0f00] {
        gauge.command(word).expect_err("it is only read");
        gauge.command_once(word).expect_err("it is only read");
        gauge.ask(word).expect_err("it is only read");
    }
    for outcome in [
        gauge.unseal().map(drop),
        gauge.full_access().map(drop),
        gauge.close().map(drop),
        gauge.seal().map(drop),
        gauge.go_to(Seal::FullAccess).map(drop),
        gauge.identify().map(drop),
        gauge.whole_firmware_answer().map(drop),
    ] {
        outcome.expect_err("it is only read");
    }
    let known: Vec<_> = sbs().registers.iter().filter_map(|row| row.source.command()).collect();
    assert!(bench.codes().iter().all(|code| known.contains(code)));
    let state = ["written", "battery_mode"].map(|knob| bench.sim.get(knob));
    assert_eq!(state, [Some("0".into()), Some("0x0000".into())]);
}

#[test]
fn a_poll_reads_a_word_for_each_value_and_the_mode_around_what_it_decides() {
    let mut bench = Bench::new();
    bench.read().expect("it answers");
    bench.sim.clear_log();
    let mut registers = Registers::unread(sbs().registers);
    let begun = bench.clock.now();
    registers.read(&mut bench.gauge, |tier| tier == Tier::Poll).expect("it answers");
    let took = bench.clock.now() - begun;
    assert!(took < Duration::from_millis(50), "{took:?}, though no watchdog limits how often a word is read");
    let (sent, rows) = (bench.codes(), reads(sbs(), Tier::Poll));
    assert_eq!((sent.len(), rows.len()), (22, 19), "{sent:02x?}");
    assert_eq!(sent[sent.len() - 7..], [0x03, 0x0f, 0x03, 0x10, 0x03, 0x18, 0x03]);
}

#[test]
fn packet_error_codes_are_asked_for_once_and_compared_from_then_on() {
    for (knobs, pec) in [
        (&[][..], Pec::Right),
        (&[("specification", "0x0021")], Pec::None),
        (&[("pec", "split")], Pec::Split),
        (&[("pec", "missing")], Pec::Wrong),
    ] {
        let mut bench = Bench::with(knobs);
        bench.read().expect("it answers");
        assert_eq!(bench.gauge.statistics.pec(), pec);
        bench.read().expect("it answers");
        let (checked, wrong) = bench.counts();
        assert_eq!((checked > 40, wrong), (matches!(pec, Pec::Right | Pec::Split), 0), "{pec:?}");
        let lengths = bench.sim.log().into_iter().filter(|record| record.write == [0x09]);
        let without = lengths.filter(|record| record.read.len() == 2).count();
        assert_eq!(without == 0, matches!(pec, Pec::Right | Pec::Split), "{pec:?}");
    }
}

#[test]
fn a_misread_version_does_not_end_the_packet_error_codes() {
    for at in 1..=3 {
        let mut bench = Bench::with(&[("fault", &format!("flip {at} 1 4"))]);
        bench.read().expect("it answers");
        assert_eq!(bench.gauge.statistics.pec(), Pec::Right, "transfer {at}");
    }
}

#[test]
fn an_adapter_that_carries_words_only_is_told_and_not_called_right() {
    let mut bench = Bench::new();
    bench.sim.set_reach(Reach::smbus(2, false));
    let registers = bench.read().expect("it answers");
    assert_eq!(bench.gauge.statistics.pec(), Pec::Unseen);
    assert_eq!((registers.property(Role::VoltageNow), bench.counts()), (Some(15420), (0, 0)));
    assert_eq!(bench.text(Role::Manufacturer), None, "no block passes, and none is filled up");
}

/// i801 compares them, piix4 has blocks and no packet error codes, i2c-stub neither, but messages of 32 bytes.
#[test]
fn behind_an_smbus_host_it_is_words_and_blocks_of_the_host() {
    let texts = [Role::Manufacturer, Role::ModelName, Role::Technology];
    for (adapter, pec) in [("i801", Pec::Host), ("piix4", Pec::Unseen), ("i2c-stub", Pec::Right)] {
        let model = AdapterModel::by_name(adapter).expect("a model");
        let mut bench = Bench::new();
        bench.sim.set_adapter(model, false);
        let read = shown(&bench.read().expect("it answers"));
        assert_eq!(read, shown(&Bench::new().read().expect("it answers")), "{adapter}");
        assert_eq!(bench.gauge.statistics.pec(), pec, "{adapter}");
        assert_eq!(bench.counts().0 > 40, pec != Pec::Unseen, "{adapter}");
        bench.codes();
        // A text that is no block, or empty: EPROTO of the host.
        bench.set("answers", "20=00 21=21414243 22=-");
        let registers = bench.read().expect("the others are there");
        let texts = texts.map(|role| registers.text(sbs().register(role).expect("a row")).is_none());
        assert_eq!(texts, [true; 3], "{adapter}");
        assert_eq!(registers.property(Role::VoltageNow), Some(15420), "{adapter}");
    }
}

#[test]
fn a_flipped_bit_is_counted_behind_a_host_too() {
    for at in [2, 5, 9] {
        for bit in 0..8 {
            let mut bench = Bench::new();
            bench.sim.set_adapter(AdapterModel::by_name("i801").expect("a model"), false);
            let right = shown(&bench.read().expect("it answers"));
            bench.set("fault", &format!("flip {at} 1 {bit}"));
            assert_eq!(shown(&bench.read().expect("it answers")), right, "transfer {at} bit {bit}");
            assert_eq!(bench.counts().1, 1, "transfer {at} bit {bit}");
        }
    }
    let mut bench = Bench::with(&[("pec", "missing")]);
    bench.sim.set_adapter(AdapterModel::by_name("i801").expect("a model"), false);
    bench.read().expect("it answers");
    assert_eq!(bench.gauge.statistics.pec(), Pec::Wrong);
}

#[test]
fn a_flipped_bit_is_counted_and_read_again() {
    for byte in 1..=3 {
        for bit in 0..8 {
            let mut bench = Bench::new();
            bench.read().expect("it answers");
            bench.set("fault", &format!("flip 2 {byte} {bit}"));
            let mut registers = Registers::unread(sbs().registers);
            registers.read(&mut bench.gauge, |tier| tier == Tier::Poll).expect("it answers");
            assert_eq!(registers.property(Role::VoltageNow), Some(15420));
            assert_eq!(bench.counts().1, 1, "byte {byte} bit {bit}");
        }
    }
}

#[test]
fn a_pec_that_stays_wrong_is_an_error_and_never_dropped() {
    let mut bench = Bench::new();
    bench.read().expect("it answers");
    bench.set("pec", "missing");
    let error = bench.read().expect_err("it is wrong");
    assert_eq!(error.cause(), Cause::Bus(BusError::Pec));
    assert!(error.to_string().contains("packet error code is wrong"), "{error}");
    assert_eq!(bench.gauge.statistics.pec(), Pec::Right);
}

/// A word that decides is an error as before; a text is left out, and all else stands.
#[test]
fn a_text_whose_sum_stays_wrong_is_left_out_and_counted() {
    struct Wrong(gauge_sim::SimBus, u8);
    impl Bus for Wrong {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
            self.0.transfer(write, read)?;
            // Whatever it is: the text, or the sum behind it.
            if write == [self.1] && read.len() > 2 {
                read[2] ^= 0x20;
            }
            Ok(())
        }
    }
    let right = shown(&Bench::new().read().expect("it answers"));
    for row in sbs().registers.iter().filter(|row| row.tier != Tier::Window) {
        let bench = Bench::new();
        let bus = Wrong(bench.sim.bus(), row.source.command().expect("a code"));
        let mut gauge = Gauge::new(sbs(), Box::new(bus), bench.clock.clone(), Keys::default());
        let mut registers = Registers::unread(sbs().registers);
        let read = registers.read(&mut gauge, |tier| tier != Tier::Window);
        if row.name == "SpecificationInfo" {
            // It is not asked for its sum alone.
            continue;
        }
        assert!(Statistics::read(&gauge.statistics.pec_wrong) > 1, "{}", row.name);
        match row.text {
            false => assert_eq!(read.expect_err(row.name).cause(), Cause::Bus(BusError::Pec)),
            true => {
                read.expect(row.name);
                let mut wanted = right.clone();
                wanted.iter_mut().filter(|(name, _)| *name == row.name).for_each(|(_, text)| *text = None);
                assert_eq!(shown(&registers), wanted, "{}", row.name);
            }
        }
    }
}

/// Each word that is no answer is unknown, and the others are as before.
#[test]
fn what_is_no_answer_is_no_value() {
    for (answers, role) in [
        ("0d=ffff", Role::Capacity),
        ("0d=1717", Role::Capacity),
        ("0d=-", Role::Capacity),
        ("13=-", Role::TimeToFullAvg),
        ("17=1717", Role::CycleCount),
        ("20=00", Role::Manufacturer),
        ("20=21414243", Role::Manufacturer),
        ("20=ffffffff", Role::Manufacturer),
        ("22=0417171717", Role::Technology),
        ("1b=-", Role::ManufactureDate),
    ] {
        let mut bench = Bench::with(&[("specification", "0x0021"), ("answers", answers)]);
        let registers = bench.read().expect("the others are there");
        let row = sbs().register(role).expect("a register");
        let is_value = registers.property(role).is_some_and(|value| row.values.hold(value));
        assert!(!is_value && registers.text(row).is_none(), "{answers}: {:?}", registers.property(role));
        assert_eq!(registers.property(Role::VoltageNow), Some(15420), "{answers}");
    }
}

#[test]
fn a_pack_that_repeats_the_word_before_has_no_such_word() {
    // It has no AverageCurrent(), CycleCount() nor cells, and answers as for a reserved code.
    struct Repeats {
        bus: gauge_sim::SimBus,
        last: Vec<u8>,
    }
    impl Bus for Repeats {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
            if [0x0b, 0x17, 0x3c, 0x3d, 0x3e, 0x3f].contains(&write[0]) && self.last.len() >= read.len() {
                read.copy_from_slice(&self.last[..read.len()]);
                return Ok(());
            }
            self.bus.transfer(write, read)?;
            self.last = read.to_vec();
            Ok(())
        }
    }
    for load in ["0", "700"] {
        let bench = Bench::with(&[("specification", "0x0021"), ("load_ma", load)]);
        bench.clock.sleep(Duration::from_secs(2));
        let bus = Repeats { bus: bench.sim.bus(), last: Vec::new() };
        let mut gauge = Gauge::new(sbs(), Box::new(bus), bench.clock.clone(), Keys::default());
        for _ in 0..3 {
            let mut registers = Registers::unread(sbs().registers);
            registers.read(&mut gauge, |tier| tier != Tier::Window).expect("it answers");
            assert_eq!(registers.property(Role::CurrentNow), Some(-load.parse::<i64>().expect("a number")));
            assert_eq!([Role::CurrentAvg, Role::CycleCount].map(|role| registers.property(role)), [None; 2]);
            let cells = sbs().registers.iter().filter(|row| row.name.starts_with("CellVoltage"));
            assert!(cells.into_iter().all(|row| registers.value(row).is_none()));
        }
    }
}

/// As of an EEPROM, of a stuck line, and of packs that do not take a repeated START.
#[test]
fn the_same_word_everywhere_is_no_pack() {
    for answers in ["all=1717", "all=ffff", "all=3100"] {
        let mut bench = Bench::with(&[("answers", answers)]);
        probe::check(&mut bench.gauge).and_then(|()| bench.read().map(drop)).expect_err(answers);
        bench.codes();
    }
    let mut bench = Bench::new();
    bench.read().expect("it answers");
    bench.set("specification", "0x0021");
    bench.gauge.start_over();
    for word in ["ffff", "1717"] {
        bench.set("answers", &format!("all={word}"));
        let error = bench.read().expect_err("nothing answers");
        assert!(error.to_string().contains(&format!("every word reads 0x{word}")), "{error}");
    }
}

#[test]
fn it_is_told_from_other_devices_by_reads_alone() {
    probe::check(&mut Bench::new().gauge).expect("it is one");
    for answers in ["1a=0000", "1a=ffff", "1a=4100", "1a=3104", "1a=3140", "1a=3200"] {
        let mut bench = Bench::with(&[("answers", answers)]);
        let error = probe::check(&mut bench.gauge).expect_err(answers);
        assert!(error.to_string().contains("does not read like"), "{error}");
        bench.codes();
    }
    // Without SpecificationInfo() its values have to be a battery's.
    probe::check(&mut Bench::with(&[("answers", "1a=-")]).gauge).expect("it may be one");
    probe::check(&mut Bench::with(&[("answers", "1a=- 08=0000")]).gauge).expect_err("0 K");
}

#[test]
fn a_pack_that_sleeps_is_waited_for_and_one_that_is_gone_is_told_how_to_wake() {
    let mut bench = Bench::with(&[("sleeps", "on")]);
    bench.clock.sleep(Duration::from_secs(60));
    probe::check(&mut bench.gauge).expect("it wakes up");
    bench.set("power", "off");
    let error = bench.read().expect_err("it is gone");
    assert!(matches!(error.cause(), Cause::Bus(BusError::NoAck)));
    let error = probe::check(&mut bench.gauge).map(|()| error).expect_err("it is gone");
    assert!(error.to_string().contains("woken by a charger's voltage"), "{error}");
    bench.set("power", "on");
    bench.clock.sleep(Duration::from_secs(1));
    assert_eq!(bench.property(Role::Capacity), Some(60));
}

/// As the kernel's `sbs-battery` does for each of its files, on another master of the bus.
#[test]
fn a_mode_that_another_host_changes_meanwhile_misleads_nobody() {
    struct Changes {
        bus: gauge_sim::SimBus,
        at: u32,
        count: u32,
    }
    impl Bus for Changes {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
            self.count += 1;
            if self.count == self.at {
                self.bus.transfer(&[0x03, 0x00, 0x80], &mut [])?;
            }
            self.bus.transfer(write, read)
        }
    }
    for at in 1..=40 {
        let bench = Bench::new();
        let bus = Changes { bus: bench.sim.bus(), at, count: 0 };
        let mut gauge = Gauge::new(sbs(), Box::new(bus), bench.clock.clone(), Keys::default());
        let mut registers = Registers::unread(sbs().registers);
        registers.read(&mut gauge, |tier| tier == Tier::Poll).expect("it answers");
        assert!(has_capacities(&registers), "transfer {at}");
    }
}

/// Whether it has the capacities of a pack at rest, all in one unit; `false` if it has none.
#[track_caller]
fn has_capacities(registers: &Registers) -> bool {
    let of = |roles: [Role; 3]| roles.map(|role| registers.property(role));
    let charge = of([Role::ChargeNow, Role::ChargeFull, Role::ChargeFullDesign]);
    let energy = of([Role::EnergyNow, Role::EnergyFull, Role::EnergyFullDesign]);
    let (right, none) = (([3030, 5050, 5200].map(Some), [43630, 72720, 74880].map(Some)), [None; 3]);
    assert!(
        [(right.0, none), (none, right.1), (none, none)].contains(&(charge, energy)),
        "{charge:?} {energy:?}"
    );
    (charge, energy) != (none, none)
}

/// Every so many transfers the mode is another one, during some of them, until that time.
struct Pulses {
    bus: gauge_sim::SimBus,
    clock: Arc<SimClock>,
    every: u32,
    width: u32,
    count: u32,
    until: Arc<Mutex<Duration>>,
}

impl Bus for Pulses {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        self.count += 1;
        match self.count % self.every {
            0 if self.clock.now() < *self.until.lock().unwrap() => {
                self.bus.transfer(&[0x03, 0x00, 0x80], &mut [])?;
            }
            at if at == self.width => self.bus.transfer(&[0x03, 0x00, 0x00], &mut [])?,
            _ => {}
        }
        self.bus.transfer(write, read)
    }
}

/// The driver takes two transfers at least between its writes, and a pause of a millisecond.
#[test]
fn regression_a_mode_that_was_changed_and_changed_back_between_two_readings_of_it_misled() {
    let polls = |every, width, count| {
        let Bench { sim, clock, .. } = Bench::new();
        let until = Arc::new(Mutex::new(Duration::MAX));
        let bus = Pulses { bus: sim.bus(), clock: clock.clone(), every, width, count, until };
        let mut gauge = Gauge::new(sbs(), Box::new(bus), clock, Keys::default());
        let mut registers = Registers::unread(sbs().registers);
        let polls = (0..20).filter(|_| {
            registers.read(&mut gauge, |tier| tier == Tier::Poll).expect("it answers");
            has_capacities(&registers)
        });
        polls.count()
    };
    // Once, however short; it costs one reading at most.
    for at in 1..=80 {
        for width in 1..=20 {
            assert!(polls(1000, width, 1000 - at) >= 19, "{width} transfers from {at} on");
        }
    }
    // Always, as of a program that does nothing else.
    for every in 4..=60 {
        for width in 2..every - 1 {
            for count in 0..every.min(8) {
                polls(every, width, count);
            }
        }
    }
    assert!(polls(60, 3, 0) >= 15);
}

/// It changes the mode for each energy, one after the other, whether that hides between two readings of it or not. Then it rests.
#[test]
fn a_uevent_of_the_kernels_driver_misleads_nobody() {
    for every in 2..=24 {
        for width in 1..every {
            for count in 0..every {
                let Bench { sim, clock, .. } = Bench::new();
                let until = Arc::new(Mutex::new(Duration::ZERO));
                let bus = Pulses {
                    bus: sim.bus(),
                    clock: clock.clone(),
                    every,
                    width,
                    count,
                    until: until.clone(),
                };
                let mut gauge = Gauge::new(sbs(), Box::new(bus), clock.clone(), Keys::default());
                let mut registers = Registers::unread(sbs().registers);
                let mut poll = || {
                    registers.read(&mut gauge, |tier| tier == Tier::Poll).expect("it answers");
                    assert!(has_capacities(&registers), "{width} of {every} transfers from {count} on");
                };
                poll();
                *until.lock().unwrap() = clock.now() + Duration::from_millis(150);
                poll();
                poll();
            }
        }
    }
}

/// All rows, as they were read.
fn shown(registers: &Registers) -> Vec<(&'static str, Option<String>)> {
    let rows = sbs().registers.iter().map(|row| {
        let text = registers.text(row).map(ToString::to_string);
        (row.name, text.or_else(|| registers.value(row).map(|value| value.to_string())))
    });
    rows.collect()
}

/// A pack whose values stand still: what it is and says, and its adapter.
fn some_pack(random: &mut Random) -> Bench {
    let bench = Bench::new();
    let pec = *random.pick(&["right", "right", "split", "missing"]);
    let version = *random.pick(&[3, 3, 3, 2, 1]);
    let scales = [random.below(3) / 2, random.below(3) / 2];
    bench.set("specification", &format!("0x{:x}{:x}{version}1", scales[0], scales[1]));
    for (knob, text) in [
        ("pec", pec.to_string()),
        ("series", (random.below(16) + 1).to_string()),
        ("soc", random.below(101).to_string()),
        ("temperature", (random.below(900) as i64 - 300).to_string()),
        ("load_ma", (random.below(9000) as i64 - 3000).to_string()),
        ("battery_mode", if random.below(3) == 0 { "0x8000" } else { "0x0000" }.to_string()),
    ] {
        bench.set(knob, &text);
    }
    bench.clock.sleep(Duration::from_secs(random.below(400)));
    if random.below(3) == 0 {
        let code = [0x0b, 0x0e, 0x13, 0x17, 0x1b, 0x1c, 0x22, 0x3c, 0x3d][random.below(9) as usize];
        // A text that says to be longer than it is has no right sum.
        let answer = *random.pick(&["-", "ffff", "0000", if code == 0x22 { "-" } else { "1717" }]);
        bench.set("answers", &format!("{code:02x}={answer}"));
    }
    bench.set("speed", "0");
    let adapters: Vec<_> = AdapterModel::all().collect();
    if random.below(2) == 0 {
        let adapter = random.pick(&adapters);
        bench.sim.set_adapter(adapter, false);
    }
    bench
}

/// What a bus does to a transfer. A wrong bit is noticed only with packet error codes, which find any within eight bits.
fn some_fault(random: &mut Random, pec: Pec) -> String {
    let at = random.below(60) + 1;
    // Behind an adapter that splits, the code covers the answer alone and not what was asked for.
    let first = u64::from(pec == Pec::Split);
    let is_checked = matches!(pec, Pec::Right | Pec::Split | Pec::Host);
    match random.below(if is_checked { 8 } else { 5 }) {
        0 => format!("nack {at} {}", random.below(3)),
        1 => format!("short {at}"),
        2 => format!("silence {at} {}", random.below(1500)),
        3 => format!("arbitration {at}"),
        4 => format!("stretch {at} {}", random.below(40)),
        5 => format!("flip {at} {} {}", first + random.below(4 - first), random.below(8)),
        6 => format!("burst {at} {} 1 {}", random.below(3) + 1, random.below(2) * 255),
        _ => {
            format!("flip {at} {} {}; nack {} 0", random.below(3) + 1, random.below(8), random.below(60) + 1)
        }
    }
}

#[test]
fn no_fault_makes_a_wrong_number_of_a_drawn_pack() {
    drawn("packs: what they are, say, and meet", 2000, |seed| {
        let random = &mut Random(seed ^ 0x5b5_0000);
        let mut bench = some_pack(random);
        let right = shown(&bench.read().map_err(|error| format!("without a fault: {error}"))?);
        let pec = bench.gauge.statistics.pec();
        let mut told = vec![pec.as_str().to_string()];
        for _ in 0..3 {
            let fault = some_fault(random, pec);
            bench.set("fault", &fault);
            match bench.read() {
                Ok(registers) => {
                    for ((name, read), (_, right)) in shown(&registers).into_iter().zip(&right) {
                        if read.is_some() && read != *right {
                            return Err(format!("{name} is {read:?} and not {right:?} after {fault}"));
                        }
                    }
                    told.push("read".into());
                }
                Err(error) => told.push(format!("{:?}", error.cause())),
            }
        }
        bench.set("fault", "none");
        bench.clock.sleep(Duration::from_secs(2));
        // As after a poll that failed.
        let _ = probe::check(&mut bench.gauge);
        let after = shown(&bench.read().map_err(|error| format!("when all is over: {error}"))?);
        bench.codes();
        match after == right {
            true => Ok(told),
            false => Err(format!("when all is over: {after:?} and not {right:?}")),
        }
    });
}

#[test]
fn no_drawn_call_of_a_gauge_sends_more_than_a_code_and_a_read() {
    let known: Vec<_> = sbs().registers.iter().filter_map(|row| row.source.command()).collect();
    drawn("times a hundred calls", 100, |seed| {
        let random = &mut Random(seed ^ 0xca11);
        let mut bench = Bench::new();
        let gauge = &mut bench.gauge;
        for _ in 0..100 {
            let (code, word) = (random.below(256) as u8, random.below(0x1_0000) as u16);
            let data: Vec<_> = (0..random.below(36)).map(|_| random.below(256) as u8).collect();
            let mut into = vec![0; random.below(40) as usize];
            match random.below(16) {
                0 => drop(gauge.write(code, &data)),
                1 => drop(gauge.write_once(code, &data)),
                2 => drop(gauge.read(code, &mut into)),
                3 => drop(gauge.word(code)),
                4 => drop(gauge.command(word)),
                5 => drop(gauge.command_once(word)),
                6 => drop(gauge.ask(word)),
                7 => drop(gauge.unseal()),
                8 => drop(gauge.full_access()),
                9 => drop(gauge.close()),
                10 => drop(gauge.seal()),
                11 => drop(gauge.identify()),
                12 => drop(gauge.whole_firmware_answer()),
                13 => gauge.start_over(),
                14 => drop(probe::check(gauge)),
                _ => drop(Registers::unread(sbs().registers).read(gauge, |_| true)),
            }
        }
        let state = ["written", "battery_mode"].map(|knob| bench.sim.get(knob));
        let is_kept = state == [Some("0".into()), Some("0x0000".into())];
        match bench.codes().into_iter().find(|code| !known.contains(code)) {
            None if is_kept => Ok(vec!["only reads".into()]),
            None => Err(format!("it was written to: {state:?}")),
            Some(code) => Err(format!("{code:#04x} was sent")),
        }
    });
}

/// A real pack of 2004, from what an analyser saw on the wire.
#[test]
fn a_recorded_pack_shows_what_it_sent() {
    struct Wire(std::collections::BTreeMap<u8, Vec<u8>>);
    impl Bus for Wire {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
            let [code] = write else { panic!("it was sent {write:02x?}") };
            let bytes = self.0.get(code).ok_or(BusError::NoAck)?;
            let last = bytes.last().copied().unwrap_or_default();
            read.iter_mut()
                .zip(bytes.iter().copied().chain(std::iter::repeat(last)))
                .for_each(|(to, from)| *to = from);
            Ok(())
        }
    }
    let lines = include_str!("../packs/t41.txt").lines().filter(|line| !line.starts_with('#'));
    let bytes = lines.map(|line| {
        let bytes = line.split(' ').map(|byte| u8::from_str_radix(byte, 16).expect("a byte"));
        bytes.collect::<Vec<_>>()
    });
    let mut answers: std::collections::BTreeMap<_, _> =
        bytes.filter(|bytes| bytes[2] == 0x17).map(|bytes| (bytes[1], bytes[3..].to_vec())).collect();
    answers.entry(0x1a).and_modify(|bytes| bytes.push(0xda));
    let clock = Arc::new(SimClock::new());
    let mut gauge = Gauge::new(sbs(), Box::new(Wire(answers)), clock, Keys::default());
    let mut registers = Registers::unread(sbs().registers);
    registers.read(&mut gauge, |tier| tier != Tier::Window).expect("it answers");
    for (role, value) in [
        (Role::VoltageNow, Some(11371)),
        (Role::CurrentNow, Some(0)),
        (Role::CurrentAvg, Some(0)),
        (Role::Temp, Some(2980)),
        (Role::EnergyNow, Some(0)),
        (Role::EnergyFull, Some(13470)),
        (Role::EnergyFullDesign, Some(47520)),
        (Role::ChargeFull, None),
        (Role::TimeToEmptyNow, Some(0)),
        (Role::SerialNumber, Some(1208)),
        (Role::ManufactureDate, Some(0x30ba)),
        // They are not in it.
        (Role::Capacity, None),
        (Role::CycleCount, None),
    ] {
        assert_eq!(registers.property(role), value, "{role:?}");
    }
    let texts = [Role::Manufacturer, Role::ModelName, Role::Technology]
        .map(|role| registers.text(sbs().register(role).expect("a register")).map(ToString::to_string));
    assert_eq!(texts, ["SANYO", "IBM-08K8193", "LION"].map(|text| Some(text.to_string())));
    let cell = sbs().registers.iter().find(|row| row.name == "CellVoltage1").expect("a word");
    assert_eq!(registers.value(cell), None, "its word 0x3f is no cell");
    let statistics = &gauge.statistics;
    assert_eq!(statistics.pec(), Pec::Right);
    let counts = [&statistics.pec_checked, &statistics.pec_wrong].map(Statistics::read);
    assert!(counts[0] > 25 && counts[1] == 0, "{counts:?}");
}

/// The words of a sealed bq3050 that its owner has read one after the other, without checksums
/// (laszlodaniel/SmartBatteryHack, issue 22). A code that it does not have is the word before.
#[test]
fn a_recorded_pack_of_ti_has_its_words_and_no_more() {
    struct Dump([u8; 2]);
    impl Bus for Dump {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
            const WORDS: [u16; 0x1d] = [
                0x0000, 0x01b8, 0x000a, 0x6081, 0x0000, 0xffff, 0xffff, 0x0001, 0x0bb4, 0x2a7c, 0x0000,
                0x0000, 0x0064, 0x0064, 0x03fd, 0xff38, 0xff38, 0xffff, 0xffff, 0xffff, 0x09c4, 0x3138,
                0x02c0, 0x0002, 0x1900, 0x2b5c, 0x0031, 0x5099, 0x836e,
            ];
            const CELLS: [u16; 4] = [0x0000, 0x0e2d, 0x0e25, 0x0e2a];
            let &[code] = write else { panic!("it was sent {write:02x?}") };
            let word = match code {
                0x3c..=0x3f => Some(CELLS[usize::from(code - 0x3c)]),
                // Of the texts the dump has two bytes.
                0x20..=0x22 => return Err(BusError::NoAck),
                code => WORDS.get(usize::from(code)).copied(),
            };
            self.0 = word.map_or(self.0, u16::to_le_bytes);
            read.fill(self.0[1]);
            read.iter_mut().zip(self.0).for_each(|(to, byte)| *to = byte);
            Ok(())
        }
    }
    let clock = Arc::new(SimClock::new());
    let mut gauge = Gauge::new(sbs(), Box::new(Dump([0; 2])), clock, Keys::default());
    let mut registers = Registers::unread(sbs().registers);
    registers.read(&mut gauge, |tier| tier != Tier::Window).expect("it answers");
    for (role, value) in [
        (Role::VoltageNow, 10876),
        (Role::CurrentNow, 0),
        (Role::Temp, 2996),
        (Role::Capacity, 100),
        (Role::ChargeFullDesign, 6400),
        (Role::CycleCount, 2),
        (Role::SerialNumber, 0x836e),
        (Role::ManufactureDate, 0x5099),
    ] {
        assert_eq!(registers.property(role), Some(value), "{role:?}");
    }
    let cells = ["CellVoltage1", "CellVoltage2", "CellVoltage3", "CellVoltage4"];
    let cells = cells.map(|name| sbs().registers.iter().find(|row| row.name == name).expect("a word"));
    assert_eq!(cells.map(|row| registers.value(row)), [Some(3626), Some(3621), Some(3629), None]);
    // It says that it has checksums, and none was read.
    assert_eq!(gauge.statistics.pec(), Pec::Wrong);
    let clock = SimClock::new();
    assert!(Beside::ALL.iter().all(|one| !one.reads_like(&mut Dump([0; 2]), &clock).unwrap_or(false)));
}

#[test]
fn chargers_and_managers_are_told_by_words_that_are_read() {
    /// Words by command code; a byte everywhere, if there are none.
    struct Words(&'static [(u8, u16)], u8);
    impl Bus for Words {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
            let ([code], 2) = (write, read.len()) else { panic!("it was sent {write:02x?}") };
            let word = self.0.iter().find(|(of, _)| of == code).map(|(_, word)| word.to_le_bytes());
            let bytes = if self.0.is_empty() { Some([self.1; 2]) } else { word };
            read.copy_from_slice(&bytes.ok_or(BusError::NoAck)?);
            Ok(())
        }
    }
    let clock = SimClock::new();
    let told = |bus: &mut dyn Bus| Beside::ALL.map(|one| one.reads_like(bus, &clock).unwrap_or(false));
    for (words, expected) in [
        (&[(0x11, 0x0012), (0x13, 0x4013)][..], [true, false]),
        (&[(0x11, 0x0003), (0x13, 0x0000)], [true, false]),
        (&[(0x04, 0x0003), (0x01, 0x1121)], [false, true]),
        (&[(0x04, 0x008f), (0x01, 0x0000)], [false, true]),
        // No version, reserved bits, a pack that the manager does not take, no pack at all.
        (&[(0x11, 0x0010), (0x13, 0x4013)], [false; 2]),
        (&[(0x11, 0x0022), (0x13, 0x4013)], [false; 2]),
        (&[(0x04, 0x0003), (0x01, 0x0004)], [false; 2]),
        (&[(0x04, 0x0010), (0x01, 0x0000)], [false; 2]),
        (&[(0x04, 0x0103), (0x01, 0x0001)], [false; 2]),
        (&[(0x00, 0x0000)], [false; 2]),
    ] {
        assert_eq!(told(&mut Words(words, 0)), expected, "{words:04x?}");
    }
    for byte in 0..=u8::MAX {
        assert_eq!(told(&mut Words(&[], byte)), [false; 2], "{byte:#04x} everywhere");
    }
    for chip in Chip::all() {
        let clock = Arc::new(SimClock::new());
        let sim = Sim::new(chip.name, &Options::default(), clock.clone()).expect("it is simulated");
        clock.sleep(Duration::from_secs(1));
        assert_eq!(told(&mut sim.bus()), [false; 2], "{}", chip.name);
    }
    let addresses = Beside::ALL.map(Beside::address);
    assert_eq!((addresses, addresses.map(Beside::at)), ([0x09, 0x0a], Beside::ALL.map(Some)));
    assert_eq!(Beside::at(0x0b), None);
}

/// Another one with the same words, but its serial number.
#[test]
fn a_pack_that_was_exchanged_between_two_polls_is_known_by_its_serial_number() {
    for specification in ["0x0031", "0x0021"] {
        let mut bench = Bench::with(&[("specification", specification)]);
        bench.read().expect("it answers");
        bench.set("answers", "1c=3412 21=054f74686572");
        let mut registers = Registers::unread(sbs().registers);
        let error =
            registers.read(&mut bench.gauge, |tier| tier == Tier::Poll).expect_err("it is another one");
        assert!(error.to_string().contains("another pack"), "{error}");
        assert_eq!(bench.text(Role::ModelName).as_deref(), Some("Other"));
        assert_eq!(bench.property(Role::SerialNumber), Some(0x1234));
        // A bit that was misread once is no other pack.
        let mut bench = Bench::with(&[("specification", "0x0021")]);
        bench.read().expect("it answers");
        bench.sim.clear_log();
        registers.read(&mut bench.gauge, |tier| tier == Tier::Poll).expect("it answers");
        let at = bench.codes().iter().position(|code| *code == 0x1c).expect("it is read") + 1;
        bench.set("fault", &format!("flip {at} 1 3"));
        registers.read(&mut bench.gauge, |tier| tier == Tier::Poll).expect("it is the same one");
        assert_eq!(registers.property(Role::SerialNumber), Some(0x1a2b));
    }
}

/// A pack with alarms is a master now and then, holds the clock, and may be deaf for a second.
#[test]
fn a_bus_with_other_masters_and_a_slow_pack_costs_no_value() {
    struct Busy {
        bus: gauge_sim::SimBus,
        error: BusError,
        every: u32,
        count: u32,
    }
    impl Bus for Busy {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
            self.count += 1;
            match self.count % self.every {
                0 => Err(self.error),
                _ => self.bus.transfer(write, read),
            }
        }
    }
    for error in [BusError::ArbitrationLost, BusError::Timeout, BusError::NoAck, BusError::MaybeNoAck(121)] {
        for every in [2, 3, 7, 19] {
            let bench = Bench::new();
            let bus = Busy { bus: bench.sim.bus(), error, every, count: 0 };
            let mut gauge = Gauge::new(sbs(), Box::new(bus), bench.clock.clone(), Keys::default());
            for _ in 0..3 {
                let mut registers = Registers::unread(sbs().registers);
                registers.read(&mut gauge, |tier| tier != Tier::Window).expect("it answers");
                assert_eq!(registers.property(Role::VoltageNow), Some(15420), "{error:?} every {every}");
                assert_eq!(registers.property(Role::ChargeNow), Some(3030), "{error:?} every {every}");
                assert_eq!(registers.property(Role::SerialNumber), Some(0x1a2b), "{error:?} every {every}");
            }
        }
    }
    let mut bench = Bench::new();
    bench.read().expect("it answers");
    bench.set("fault", "silence 3 1000");
    let _ = bench.read();
    bench.clock.sleep(Duration::from_secs(1));
    assert_eq!(bench.property(Role::VoltageNow), Some(15420));
}
