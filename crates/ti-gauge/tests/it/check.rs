// SPDX-License-Identifier: MIT

//! The rules of `check`: each on a simulated gauge on which it is true, and on one on which it is nearly true and is not said;
//! and drawn gauges with nothing wrong.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_bus::{Bus, BusError};
use gauge_sim::{Options, Sim, SimBus};
use ti_gauge::check::{Checked, Facts, Finding, History, Poll, RULES, Rule, Severity};
use ti_gauge::chip::{Chip, FLAT, Kind, Register, Role, Row, Scale, Source, Tier};
use ti_gauge::dataflash::{Change, DataFlash};
use ti_gauge::gauge::Gauge;
use ti_gauge::keys::Keys;
use ti_gauge::registers::Registers;
use ti_gauge::value::Value;

use crate::rig::{Random, first_address};
use crate::room::drawn;

/// A simulated gauge with other bytes in some of its registers.
struct Altered {
    bus: SimBus,
    bytes: Arc<Mutex<BTreeMap<u8, u8>>>,
}

impl Bus for Altered {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        self.bus.transfer(write, read)?;
        let bytes = self.bytes.lock().expect("no panic");
        for (at, byte) in (write[0]..).zip(read.iter_mut()).filter(|_| write.len() == 1) {
            *byte = *bytes.get(&at).unwrap_or(byte);
        }
        Ok(())
    }
}

struct Bench {
    chip: &'static Chip,
    clock: Arc<SimClock>,
    sim: Sim,
    gauge: Gauge,
    bytes: Arc<Mutex<BTreeMap<u8, u8>>>,
    registers: Registers,
    history: History,
    status: u32,
    own: u64,
    keys: u64,
    unwritten: &'static str,
    owed: &'static str,
    with_flash: bool,
    chem_id: Option<u16>,
}

impl Bench {
    fn new(name: &str) -> Self {
        let clock = Arc::new(SimClock::new());
        let sim = Sim::new(name, &Options::default(), clock.clone()).expect("a simulated part");
        let chip = Chip::by_name(name).expect("a part");
        let bytes: Arc<Mutex<BTreeMap<u8, u8>>> = Arc::default();
        let bus = Altered { bus: sim.bus(), bytes: bytes.clone() };
        let gauge = Gauge::new(chip, Box::new(bus), clock.clone(), Keys::default());
        clock.sleep(Duration::from_secs(3));
        let registers = Registers::unread(chip.registers);
        let (history, status, own, keys) = (History::default(), 0, 0, 0);
        let (unwritten, owed, with_flash) = ("", "", true);
        Self {
            chip,
            clock,
            sim,
            gauge,
            bytes,
            registers,
            history,
            status,
            own,
            keys,
            unwritten,
            owed,
            with_flash,
            chem_id: None,
        }
    }

    fn set(&self, knob: &str, value: impl ToString) {
        self.sim.set(knob, &value.to_string()).unwrap_or_else(|error| panic!("{knob}: {error}"));
    }

    /// Puts numbers into the rows of these names, as far as the part has them, and starts the gauge with them. Returns how
    /// many it has.
    fn store_all(&mut self, numbers: &[(&str, f64)]) -> usize {
        let mut changes = Vec::new();
        for (name, number) in numbers {
            let rows = self.chip.rows().filter(|(_, row)| row.name == *name && !row.unproven);
            for row in rows.take(1) {
                let is_float = row.1.kind.to_string() == "F4";
                let value = if is_float { Value::Float(*number) } else { Value::Int(*number as i64) };
                changes.push((row, value));
            }
        }
        let count = changes.len();
        if self.chip.volatile.is_some() {
            let change = |(row, value): &(Row, Value)| Change::of_value(self.chip, *row, value, true);
            let changes: Vec<_> = changes.iter().map(|pair| change(pair).expect("it fits")).collect();
            if !changes.is_empty() {
                let written = DataFlash::default().write(&mut self.gauge, &changes, Duration::ZERO);
                written.unwrap_or_else(|error| panic!("{}: {error}", self.chip.name));
            }
        } else if count > 0 {
            for (row, value) in changes {
                let bytes = self.chip.layout.encode(row.1.kind, &value).expect("it fits");
                self.store_at(row, &bytes);
            }
            self.lose_power();
        }
        self.clock.sleep(Duration::from_secs(3));
        count
    }

    fn store(&mut self, name: &str, number: f64) {
        assert_eq!(self.store_all(&[(name, number)]), 1, "{name}");
    }

    fn store_at(&self, (subclass, row): Row, bytes: &[u8]) {
        let start = if subclass.id == FLAT { first_address(self.chip) } else { 0 };
        self.sim.set_flash(subclass.id.into(), usize::from(row.offset) - start, bytes);
    }

    fn row(&self, subclass: u8, offset: u16) -> Row {
        let is = |(class, row): &Row| class.id == subclass && row.offset == offset;
        self.chip.rows().find(is).expect("a row")
    }

    /// The name of its row of the design capacity.
    fn design(&self) -> &'static str {
        let names = ["Design Capacity", "Design Capacity mAh"];
        self.chip.rows().find(|(_, row)| names.contains(&row.name)).expect("a row").1.name
    }

    /// Configures a battery of that capacity.
    fn size(&mut self, mah: f64) {
        assert_eq!(self.store_all(&[("Design Capacity", mah), ("Design Energy", mah * 3.7)]), 2);
    }

    fn register(&self, role: Role) -> &'static Register {
        self.chip.register(role).expect("a register")
    }

    /// Shows another value than the simulated gauge has.
    fn show(&self, role: Role, value: i64) {
        self.show_register(self.register(role), value);
    }

    /// Shows what the simulated gauge has, but for capacities.
    fn shows_itself(&self) {
        let roles = [Role::ChargeFull, Role::ChargeFullDesign];
        let codes: Vec<u8> = roles.iter().filter_map(|role| self.register(*role).source.command()).collect();
        self.bytes
            .lock()
            .expect("no panic")
            .retain(|at, _| codes.iter().any(|code| *at == *code || *at == code + 1));
    }

    fn show_register(&self, register: &Register, value: i64) {
        let code = register.source.command().expect("a standard command");
        let all = value.to_le_bytes();
        self.bytes.lock().expect("no panic").extend((code..).zip(all).take(register.size.into()));
    }

    fn value(&self, role: Role) -> i64 {
        self.registers.value(self.register(role)).expect("it was read")
    }

    fn poll_after(&mut self, seconds: u64) {
        self.clock.sleep(Duration::from_secs(seconds));
        self.poll();
    }

    fn poll(&mut self) {
        if self.registers.read(&mut self.gauge, |tier| tier != Tier::Window).is_err() {
            return;
        }
        if self.chip.has_table() {
            self.status = self.gauge.control_status().expect("an answer").1;
        }
        let voltage =
            self.chip.register(Role::VoltageNow).and_then(|register| self.registers.value(register));
        let word = |source| match source {
            Source::Status => Some(i64::from(self.status)),
            source => self.registers.value(self.chip.register_at(source)?),
        };
        let is_complete = self
            .chip
            .condition
            .complete
            .is_none_or(|(source, bit)| word(source).is_some_and(|word| word & i64::from(bit) != 0));
        let poll = Poll {
            time: self.clock.now().as_secs_f64(),
            registers: &self.registers,
            control_status: self.status,
            is_measured: is_complete && voltage != Some(0),
            own: self.own,
            keys: self.keys,
        };
        self.history.note(self.chip, &poll);
    }

    /// All that data flash holds.
    fn flash(&mut self) -> BTreeMap<(u8, u16), Value> {
        if !self.with_flash || !self.chip.has_table() {
            return BTreeMap::new();
        }
        let wanted: Vec<_> = self.chip.subclasses.iter().filter(|row| row.kind != Kind::Security).collect();
        let read =
            DataFlash::default().read(&mut self.gauge, &wanted, Duration::ZERO).expect("the default keys");
        let mut all = BTreeMap::new();
        for (subclass, bytes) in wanted.iter().zip(read) {
            for row in subclass.parameters {
                let at = usize::from(row.offset - subclass.start());
                let value = self.chip.layout.decode(row.kind, &bytes[at..at + row.kind.size()]);
                all.insert((subclass.id, row.offset), value);
            }
        }
        all
    }

    fn check(&mut self) -> Checked {
        let flash = self.flash();
        let stored = |(subclass, row): Row| flash.get(&(subclass.id, row.offset)).cloned();
        Checked::of(&Facts {
            chip: self.chip,
            dm_code: None,
            chem_id: self.chem_id,
            registers: Some(&self.registers),
            control_status: Some(self.status),
            unwritten: self.unwritten,
            owed: self.owed,
            host_scale: 1.0,
            stored: &stored,
            history: self.history.summary(),
        })
    }

    fn finds(&mut self, rule: &str) -> Option<String> {
        let checked = self.check();
        checked.findings.into_iter().find(|finding| finding.rule.name == rule).map(|finding| finding.values)
    }

    /// Lets charge and discharge alternate so often, with two polls in each.
    fn alternate(&mut self, steps: usize) {
        for step in 0..=steps {
            self.set("load_ma", if step % 2 == 0 { 500 } else { -500 });
            self.poll_after(60);
            self.poll_after(30);
        }
    }

    /// The same with one poll in each, so that nothing shows how the voltage moves by itself.
    fn alternate_fast(&mut self, steps: usize) {
        for step in 0..=steps {
            self.set("load_ma", if step % 2 == 0 { 500 } else { -500 });
            self.poll_after(60);
        }
    }

    /// The same with a voltage that goes the other way by chance, and moves by so many mV without a step.
    fn alternate_restless(&mut self, steps: usize, by_itself: i64) {
        for step in 0..=steps {
            self.set("load_ma", if step % 2 == 0 { 500 } else { -500 });
            self.show(Role::VoltageNow, if step % 2 == 0 { 3920 } else { 3880 });
            self.poll_after(60);
            self.show(Role::VoltageNow, if step % 2 == 0 { 3920 - by_itself } else { 3880 + by_itself });
            self.poll_after(30);
        }
    }

    /// The same with a poll each half a minute, and cells of that resistance.
    fn step(&mut self, milliohms: u32) {
        self.set("cell_mohm", milliohms);
        for step in 0..=5 {
            self.set("load_ma", if step % 2 == 0 { 500 } else { -500 });
            self.poll_after(30);
        }
    }

    fn poll_each(&mut self, seconds: u64, times: usize) {
        (0..times).for_each(|_| self.poll_after(seconds));
    }

    fn lose_power(&mut self) {
        self.set("power", "off");
        self.clock.sleep(Duration::from_secs(1));
        self.set("power", "on");
        self.clock.sleep(Duration::from_secs(1));
    }

    fn enable(&mut self) {
        self.set("seal", "unsealed");
        self.gauge.ask(0x0021).expect("IT_ENABLE");
        self.poll_after(2);
    }
}

type Make = fn(&mut Bench);

/// For each rule a part, how it comes to be true there, how nearly, and a word of the values that are said.
#[rustfmt::skip]
const CASES: &[(&str, &str, Make, Make, &str)] = &[
    ("configuration-lost", "bq27441-g1", |b| { b.lose_power(); b.poll_after(3) }, |b| b.poll_after(3), "[ITPOR]"),
    ("profile-not-written", "bq27441-g1", |b| b.unwritten = "sealed", |b| b.unwritten = "", "sealed"),
    ("design-capacity-default", "bq34z100-g1", |b| b.poll(), |b| { b.store("Design Capacity", 1001.0); b.poll() }, "1000 mAh"),
    ("configuration-lost", "bq27220", |b| { b.store(b.design(), 2000.0); b.poll(); b.lose_power(); b.poll_after(3) },
        |b| { b.store(b.design(), 2000.0); b.poll(); b.store(b.design(), 2500.0); b.poll_after(3) }, "from 2000 back to"),
    ("divider", "bq34z100-g1", |b| { b.store("Number of series cell", 2.0); b.poll() }, |b| { b.store("Number of series cell", 1.0); b.poll() }, "[VOLTSEL] is clear"),
    ("divider", "bq34z100-g1", |b| { b.store_all(&external(16_700.0)); b.poll() }, |b| { b.store_all(&external(16_900.0)); b.poll() }, "[VOLTSEL] is set"),
    ("divider", "bq34z100-g1", |b| { b.store("Voltage Divider", 5600.0); b.poll() }, |b| { b.store("Voltage Divider", 5400.0); b.poll() }, "external one"),
    ("sense-resistor", "bq34z100-g1", |b| { b.store("CC Gain", 0.4768 * 1.03); b.poll() }, |b| { b.store("CC Gain", 0.4768 * 1.01); b.poll() }, "of 9.71 mΩ, CC Delta of 10.0"),
    ("chem-id", "bq34z100-g1", |b| { b.chem_id = Some(0x0107); b.store("Cell Charge Voltage T2-T3", 3600.0); b.poll() },
        |b| { b.chem_id = Some(0x0107); b.store("Cell Charge Voltage T2-T3", 4100.0); b.poll() }, "CHEM_ID 0x0107 is of lithium-ion cells charged to 4200 mV; Cell Charge Voltage T2-T3 3600 mV"),
    ("chem-id", "bq34z100-g1", |b| { b.chem_id = Some(0x0107); call(b, "LIFE"); b.poll() }, |b| { b.chem_id = Some(0x0107); call(b, "LION"); b.poll() }, "Device Chemistry LIFE"),
    ("chem-id", "bq34z100-g1", |b| { b.chem_id = Some(0x0107); call(b, "NIMH"); b.poll() }, |b| { b.chem_id = Some(0x0500); call(b, "NIMH"); b.poll() }, "NIMH"),
    ("chem-id", "bq27426", |b| { b.chem_id = Some(0x1202); b.store("Taper Voltage", 4250.0); b.poll() }, |b| { b.chem_id = Some(0x3230); b.store("Taper Voltage", 4250.0); b.poll() }, "4200 mV; Taper Voltage 4250 mV"),
    ("chem-id", "bq27426", |b| { b.chem_id = Some(0x3142); b.store("Taper Voltage", 4000.0); b.poll() }, |b| { b.chem_id = Some(0x3142); b.poll() }, "Taper Voltage 4000 mV"),
    ("chem-id", "bq27427", |b| { b.chem_id = Some(0x1202); b.store("Taper Voltage", 4240.0); b.poll() }, |b| { b.chem_id = Some(0x1202); b.poll() }, "Taper Voltage 4240 mV"),
    ("chemistry", "bq34z100-g1", |b| { b.set("voltage_mv", 4301); b.poll_after(2) }, |b| { b.set("voltage_mv", 4299); b.poll_after(2) }, "4200 mV"),
    ("chemistry", "bq27441-g1", |b| { b.set("voltage_mv", 4301); b.poll_after(2) }, |b| { b.set("voltage_mv", 4299); b.poll_after(2) }, "Taper Voltage 4100"),
    ("chemistry", "bq34z100-g1", |b| { b.set("voltage_mv", 4600); b.poll_after(2) }, |b| { b.set("voltage_mv", 4601); b.poll_after(2) }, "4600 mV"),
    ("design-energy", "bq34z100-g1", |b| b.poll(), |b| { b.store("Design Energy", 4500.0); b.poll() }, "5.4 V"),
    ("rows-at-default", "bq34z100-g1", |b| { b.store("Design Capacity", 2000.0); b.poll() }, |b| {
        b.store_all(&[("Design Capacity", 2000.0), ("Design Energy", 7400.0), ("Cell Terminate Voltage", 2900.0), ("Taper Current", 120.0)]);
        b.poll();
    }, "Taper Current 100 mA"),
    ("full-capacity", "bq27441-g1", |b| { b.show(Role::ChargeFullDesign, 200); b.show(Role::ChargeFull, 2891); b.poll() },
        |b| { b.show(Role::ChargeFullDesign, 200); b.show(Role::ChargeFull, 300); b.poll() }, "2891 mAh"),
    ("full-capacity", "bq27441-g1", |b| { b.show(Role::ChargeFull, 400); b.poll() },
        |b| { b.show(Role::ChargeFull, 400); b.show(Role::Temp, 2700); b.poll() }, "400 mAh"),
    ("full-capacity", "bq34z100-g1", |b| { b.show(Role::ChargeFull, 0); b.poll() },
        |b| { b.show(Role::ChargeFull, 0); b.set("first_ms", 5000); b.lose_power(); b.poll() }, "0 mAh"),
    ("full-capacity", "bq27441-g1", |b| { b.show(Role::ChargeFull, 400); b.poll() },
        |b| { b.show(Role::ChargeFull, 400); b.lose_power(); b.poll_after(3) }, "400 mAh"),
    ("full-capacity", "bq27426", |b| { resize(b, 6000.0); b.poll_after(3601) }, |b| { resize(b, 6000.0); b.poll_after(3590) }, "6000 mAh"),
    ("full-capacity", "bq34z100-g1", |b| { b.store_all(&[("Qmax Cell 0", 1500.0), ("Design Capacity", 5200.0)]); b.poll() }, |b| { b.store("Design Capacity", 5200.0); b.poll() }, "1500 mAh"),
    ("full-capacity", "bq34z100-g1", |b| { b.store_all(&[("Update Status", 6.0), ("Design Capacity", 5200.0)]); b.poll() }, |b| { b.store("Design Capacity", 5200.0); b.with_flash = false; b.poll() }, "5200 mAh"),
    ("full-capacity", "bq34z100-g1", |b| { b.store("Design Capacity", 200.0); b.show(Role::ChargeFull, 2891); b.poll() }, |b| { b.store("Design Capacity", 200.0); b.poll() }, "2891 mAh"),
    ("full-capacity-stale", "bq34z100-g1", |b| { b.store("Design Capacity", 5200.0); b.poll() },
        |b| { b.store_all(&[("Qmax Cell 0", 5200.0), ("Design Capacity", 5200.0)]); b.poll() }, "Qmax Cell 0 is 1000 mAh as shipped"),
    ("full-capacity-stale", "bq34z100-g1", |b| { b.store("Design Capacity", 3001.0); b.poll() }, |b| { b.store("Design Capacity", 2999.0); b.poll() }, "3001 mAh"),
    ("full-capacity-stale", "bq27426", |b| resize(b, 6000.0), |b| { b.poll(); b.size(6000.0); b.own += 1; b.poll_after(3) }, "since data flash was written 0 min ago"),
    ("full-capacity-stale", "bq27441-g1", |b| { resize(b, 6000.0); b.poll_after(120) }, |b| { b.poll(); b.size(6000.0); b.own += 1; b.poll_after(3) }, "since it went from 1340 to 6000 mAh 2 min ago"),
    ("full-capacity-stale", "bq27441-g1", |b| { redesign(b, 5000, 2000, 6000) }, |b| { redesign(b, 5000, 2000, 2900) }, "still of the battery before, since it went from 5000 to 2000 mAh"),
    ("full-capacity-stale", "bq27441-g1", |b| { redesign(b, 1340, 6000, 1340); b.show(Role::ChargeFullDesign, 6100); b.poll_after(3) },
        |b| { redesign(b, 1340, 6000, 1340); b.show(Role::ChargeFullDesign, 6100); b.show(Role::ChargeFull, 1100); b.poll_after(3) }, "from 6000 to 6100 mAh"),
    ("full-capacity", "bq27441-g1", |b| { redesign(b, 5000, 2000, 7501) }, |b| { redesign(b, 5000, 2000, 7499) }, "7501 mAh"),
    ("full-capacity-stale", "bq34110", |b| { redesign(b, 1000, 7000, 1000); b.poll_after(86_400) }, |b| { redesign(b, 1000, 7000, 1000); b.show(Role::ChargeFull, 1101); b.poll_after(86_400) }, "has not changed since it went from 1000 to 7000 mAh 1440 min ago"),
    ("full-capacity", "bq34110", |b| { redesign(b, 1000, 7000, 1000); b.show(Role::ChargeFull, 1101); b.poll_after(86_400) }, |b| { redesign(b, 1000, 7000, 1000); b.poll_after(86_400) }, "1101 mAh"),
    ("full-capacity", "bq27441-g1", |b| { redesign(b, 1000, 7000, 1000); b.poll_after(3601) }, |b| { redesign(b, 1000, 7000, 1000); b.poll_after(3590) }, "1000 mAh"),
    ("full-capacity", "bq34z100-g1", |b| { b.store("Update Status", 6.0); redesign(b, 1000, 7000, 1000); b.poll_after(3601) }, |b| { redesign(b, 1000, 7000, 1000); b.poll_after(3601) }, "1000 mAh"),
    ("full-capacity", "bq34110", |b| { redesign(b, 1000, 7000, 1000); learn_full(b); b.poll_after(3601) }, |b| { redesign(b, 1000, 7000, 1000); b.poll_after(3601) }, "1000 mAh"),
    ("remaining-above-full", "bq34z100-g1", |b| { b.poll(); b.show(Role::ChargeNow, 1101); b.own += 1; b.poll() },
        |b| { b.poll(); b.show(Role::ChargeFull, 500); b.own += 1; b.poll_after(2) }, "1101 mAh"),
    ("remaining-above-full", "bq34z100-g1", |b| { b.show(Role::ChargeNow, 1101); b.poll() }, |b| { b.show(Role::ChargeNow, 1099); b.poll() }, "1101 mAh"),
    ("percent-above-100", "bq27441-g1", |b| { b.show(Role::Capacity, 101); b.poll() }, |b| { b.show(Role::Capacity, 100); b.poll() }, "101 %"),
    ("percent-jumped", "bq34z100-g1", |b| { b.poll(); b.set("soc", 35); b.poll_after(30) }, |b| { b.poll(); b.set("soc", 42); b.poll_after(30) }, "from 60 to 35"),
    ("percent-jumped", "bq34z100-g1", |b| { b.poll(); b.set("soc", 35); b.poll_after(299) }, |b| { b.poll(); b.set("soc", 35); b.poll_after(301) }, "from 60 to 35"),
    ("percent-jumped", "bq34z100-g1", |b| { b.poll(); b.own += 1; b.poll(); b.poll_after(3600); b.set("soc", 35); b.poll_after(30) },
        |b| { b.poll(); b.own += 1; b.poll(); b.poll_after(60); b.set("soc", 35); b.poll_after(30) }, "from 60 to 35"),
    ("measures-nothing", "bq27441-g1", |b| { b.set("voltage_mv", 0); (0..5).for_each(|_| b.poll_after(3)) }, |b| { b.set("voltage_mv", 0); (0..4).for_each(|_| b.poll_after(3)) }, "5 polls"),
    ("cell-voltage", "bq34z100-g1", |b| { b.store("Number of series cell", 4.0); b.set("voltage_mv", 5990); b.poll_after(2) },
        |b| { b.store("Number of series cell", 4.0); b.set("voltage_mv", 6010); b.poll_after(2) }, "of 4 cells"),
    ("cell-voltage", "bq34z100-g1", |b| { b.set("voltage_mv", 4610); b.poll_after(2) }, |b| { b.set("voltage_mv", 4590); b.poll_after(2) }, "4610 mV"),
    ("cell-voltage", "bq34z100-r2", |b| { b.store("Number of series cell", 16.0); b.set("voltage_mv", 5990); b.poll_after(2) },
        |b| { b.store("Number of series cell", 16.0); b.bytes.lock().expect("no panic").insert(0x20, 10); b.set("voltage_mv", 5990); b.poll_after(2) }, "of 16 cells"),
    ("temperature", "bq34z100-g1", |b| { b.show(Role::Temp, 2331); b.poll() }, |b| { b.show(Role::Temp, 2332); b.poll() }, "-40.0 °C"),
    ("temperature", "bq34z100-g1", |b| { b.show(Role::Temp, 3631); b.poll() }, |b| { b.show(Role::Temp, 3630); b.poll() }, "90.0 °C"),
    ("current-always-0", "bq34z100-g1", |b| { b.poll(); b.show(Role::VoltageNow, 3690); b.poll_after(49 * 3600) },
        |b| { b.poll(); b.show(Role::VoltageNow, 3690); b.poll_after(47 * 3600) }, "for 49 h"),
    ("current-always-0", "bq34z100-g1", |b| { b.poll(); b.show(Role::VoltageNow, 3690); b.poll_after(49 * 3600) },
        |b| { b.poll(); b.show(Role::VoltageNow, 3720); b.poll_after(49 * 3600) }, "3690"),
    ("current-sign", "bq27427", |b| { b.set("cc_gain_inverted", "on"); b.alternate(5) }, |b| { b.set("cc_gain_inverted", "on"); b.alternate(4) }, "in 5 of 5"),
    ("current-sign", "bq27427", |b| { b.set("cc_gain_inverted", "on"); b.alternate(9) }, |b| b.alternate(9), "in 9 of 9"),
    ("current-sign", "bq27427", |b| { b.set("cc_gain_inverted", "on"); b.alternate_fast(20) }, |b| { b.set("cc_gain_inverted", "on"); b.alternate_fast(19) }, "in 20 of 20"),
    ("current-sign", "bq34z100-g1", |b| b.alternate_restless(6, 5), |b| b.alternate_restless(6, 20), "in 6 of 6"),
    ("end-of-scale", "bq34z100-g1", |b| { b.show(Role::CurrentNow, 32767); b.poll() }, |b| { b.show(Role::CurrentNow, 32766); b.poll() }, "Current() is 32767 mA"),
    ("end-of-scale", "bq34z100-g1", |b| { b.show(Role::ChargeNow, 65535); b.poll() }, |b| { b.show(Role::ChargeNow, 65534); b.poll() }, "65535 mAh"),
    ("defect", "bq27427", |b| { b.set("cc_gain_inverted", "on"); b.poll() }, |b| b.poll(), "CC Gain is negative"),
    ("owed", "bq34z100-g1", |b| b.owed = "a seal is owed", |b| b.owed = "", "a seal is owed"),
    ("erased", "bq34z100-g1", |b| { let row = b.row(36, 0); b.store_at(row, &vec![0xff; row.0.length.into()]); b.poll() },
        |b| { let row = b.row(36, 0); b.store_at(row, &vec![0xff; usize::from(row.0.length) - 1]); b.poll() }, "Taper Current"),
    ("unsafe", "bq34z100-g1", |b| { let row = b.row(104, 14); b.store_at(row, &[0, 0]); b.poll() }, |b| { let row = b.row(104, 14); b.store_at(row, &[0, 1]); b.poll() }, "Voltage Divider"),
    ("out-of-range", "bq34z100-g1", |b| { b.store("Cell Terminate Voltage", 3701.0); b.poll() }, |b| { b.store("Cell Terminate Voltage", 3700.0); b.poll() }, "3701"),
    ("reserved-bits", "bq27441-g1", |b| flip(b, false), |b| flip(b, true), "OpConfig"),
    ("flash-shut", "bq34z100-g1", |b| { b.set("voltage_mv", 2799); b.poll_after(2) }, |b| { b.set("voltage_mv", 2801); b.poll_after(2) }, "2800 mV"),
    ("not-learned", "bq34z100-g1", |b| b.poll(), |b| { b.store("Update Status", 5.0); b.poll() }, "Qmax"),
    ("not-learned", "bq34z100-g1", |b| { b.poll(); b.poll_after(7300) }, |b| { b.store("Update Status", 5.0); b.poll() }, "; for 2 h not seen: a charge to its end ([FC]); for 2 h not seen: a discharge to 10 %"),
    ("learning-lost", "bq34z100-g1", |b| { b.store("Update Status", 6.0); b.poll(); b.store("Update Status", 4.0); b.poll() },
        |b| { b.store("Update Status", 5.0); b.poll(); b.store("Update Status", 6.0); b.poll() }, "Qmax and Ra were learned, and now nothing"),
    ("never-learned", "bq34z100-g1", |b| { b.show(Role::CycleCount, 200); b.poll() }, |b| { b.show(Role::CycleCount, 199); b.poll() }, "is 200"),
    ("never-learned", "bq34z100-g1", |b| { b.show(Role::CycleCount, 200); b.poll() }, |b| { b.store("Update Status", 5.0); b.show(Role::CycleCount, 200); b.poll() }, "is 200"),
    ("not-enabled", "bq34z100-g1", |b| b.poll(), |b| b.enable(), "[QEN]"),
    ("learning-disturbed", "bq34z100-g1", |b| { b.set("temperature", 500); b.enable(); b.set("load_ma", 500); b.poll_after(600) }, |b| { b.enable(); b.poll_after(600) }, "for"),
    ("worn", "bq34z100-g1", |b| { b.show(Role::StateOfHealth, 80); b.poll() }, |b| { b.show(Role::StateOfHealth, 81); b.poll() }, "80 %"),
    ("worn", "bq34z100-g1", |b| { b.store_all(&[("Qmax Cell 0", 1500.0), ("Design Capacity", 2000.0)]); b.poll() }, |b| { b.store("Design Capacity", 1500.0); b.poll() }, "75 %"),
    ("worn-out", "bq34z100-g1", |b| { b.show(Role::StateOfHealth, 50); b.poll() }, |b| { b.show(Role::StateOfHealth, 51); b.poll() }, "50 %"),
    ("cycles", "bq34z100-g1", |b| { b.show(Role::CycleCount, 500); b.poll() }, |b| { b.show(Role::CycleCount, 499); b.poll() }, "is 500"),
    ("was-too-warm", "bq34z100-g1", |b| { b.store("Lifetime Max Temp", 601.0); b.poll() }, |b| { b.store("Lifetime Max Temp", 600.0); b.poll() }, "60.1 °C"),
    ("lifetime-voltage", "bq34z100-g1", |b| { b.store("Lifetime Max Pack Voltage", 216.0); b.poll() }, |b| { b.store("Lifetime Max Pack Voltage", 215.0); b.poll() }, "once 4320 mV"),
    ("lifetime-voltage", "bq34z100-g1", |b| { b.store("Lifetime Min Pack Voltage", 119.0); b.poll() }, |b| { b.store("Lifetime Min Pack Voltage", 120.0); b.poll() }, "once 2380 mV"),
    ("lifetime-voltage", "bq34z100-g1", |b| { b.store("Lifetime Max Pack Voltage", 321.0); b.poll() }, |b| { b.store("Lifetime Max Pack Voltage", 320.0); b.poll() }, "once 6420 mV"),
    ("resistance", "bq34z100-g1", |b| b.step(560), |b| b.step(480), "a cell loses 5"),
    ("resistance", "bq34z100-g1", |b| b.step(560), |b| { b.step(560); b.own += 1; b.poll() }, "a cell loses 5"),
    ("resistance", "bq34z100-g1", |b| b.step(560), |b| { b.set("temperature", 50); b.step(560) }, "a cell loses 5"),
    ("opened", "bq34z100-g1", |b| { b.poll(); b.set("seal", "unsealed"); b.poll() }, |b| { b.poll(); b.set("seal", "unsealed"); b.keys += 1; b.poll() }, "SEALED at first"),
    ("opened", "bq27441-g1", |b| { b.set("seal", "sealed"); b.poll(); b.set("seal", "unsealed"); b.poll() },
        |b| { b.set("seal", "sealed"); b.poll(); b.lose_power(); b.poll_after(10) }, "SEALED at first"),
    ("mode-left-on", "bq27441-g1", |b| { b.poll(); b.show(Role::Flags, b.value(Role::Flags) | 0x10); b.poll() }, |b| b.poll(), "[CFGUPMODE]"),
    ("resets-in-a-row", "bq34z100-g1", |b| reset(b, 3, false), |b| reset(b, 2, false), "3 resets"),
    ("resets-in-a-row", "bq34z100-g1", |b| reset(b, 3, false), |b| reset(b, 3, true), "3 resets"),
    ("reconfigured", "bq34z100-g1", |b| { b.poll(); b.store("Design Capacity", 2000.0); b.poll_after(2) }, |b| { b.poll(); b.store("Design Capacity", 2000.0); b.own += 1; b.poll_after(2) }, "1000 to 2000"),
];

/// Four cells behind an external divider.
fn external(divider: f64) -> [(&'static str, f64); 3] {
    [("Number of series cell", 4.0), ("Pack Configuration", f64::from(0x0961)), ("Voltage Divider", divider)]
}

/// Sick gauges: a part, what it has, the rules that call it wrong, and those that doubt it where they do not doubt a new one.
#[rustfmt::skip]
const SICK: &[(&str, Make, &[&str], &[&str])] = &[
    ("bq27426", |b| { b.set("keeps_full", "on"); b.size(6000.0); b.poll_after(3) }, &["full-capacity"], &[]),
    ("bq27421-g1", |b| { b.set("keeps_full", "on"); b.size(6000.0); b.poll_after(3) }, &["full-capacity"], &[]),
    ("bq27426", |b| { b.set("keeps_full", "on"); b.size(1600.0); b.poll_after(3) }, &[], &[]),
    ("bq27426", |b| { b.size(6000.0); b.poll_after(3) }, &[], &[]),
    ("bq34z100-g1", |b| { b.set("voltage_mv", 0); b.poll_each(2, 5) }, &["measures-nothing"], &[]),
    ("bq34110", |b| { b.set("voltage_mv", 0); b.poll_each(2, 5) }, &["measures-nothing"], &[]),
    ("bq27000", |b| { b.set("voltage_mv", 0); b.poll_each(2, 5) }, &["measures-nothing"], &[]),
    ("bq27441-g1", |b| { b.set("no_initcomp", "on"); b.poll_each(2, 5) }, &["measures-nothing"], &[]),
    ("bq27220", |b| { b.set("no_initcomp", "on"); b.set("first_values", "nonsense"); b.poll_each(2, 5) }, &["measures-nothing"], &[]),
    ("bq34z100-g1", |b| { b.set("reset_every_s", 20); b.poll_each(1, 100) }, &["resets-in-a-row"], &[]),
    ("bq27441-g1", |b| { b.set("reset_every_s", 20); b.poll_each(1, 100) }, &["configuration-lost", "resets-in-a-row"], &[]),
    ("bq27441-g1", |b| { b.size(2000.0); b.poll(); b.lose_power(); b.poll_after(10) }, &["configuration-lost"], &[]),
    ("bq34z100-g1", |b| {
        b.set("shunt_error", -500);
        b.set("soc", 90);
        b.set("load_ma", 500);
        b.poll_each(60, 60);
        b.set("load_ma", 0);
        b.poll_each(250, 80);
    }, &[], &["percent-jumped"]),
    ("bq34z100-r2", |b| { b.store("CC Gain", 0.9); b.poll_after(2) }, &[], &["sense-resistor"]),
    ("bq34z100-g1", |b| { b.set("thermistor", "out"); b.poll_after(2) }, &["temperature"], &[]),
    ("bq34z100-g1", |b| { b.set("thermistor", "short"); b.poll_after(2) }, &["temperature"], &[]),
    ("bq27441-g1", |b| { b.set("thermistor", "out"); b.poll_after(2) }, &[], &[]),
    ("bq27220", |b| { b.set("thermistor", "out"); b.poll_after(2) }, &[], &[]),
    ("bq27220", |b| { b.set("thermistor", "out"); b.store("Operation Config A", f64::from(0x8484)); b.poll_after(2) }, &["temperature"], &[]),
    ("bq34110", |b| { b.set("thermistor", "out"); b.poll_after(2) }, &["temperature"], &[]),
    ("bq35100", |b| { b.set("thermistor", "short"); b.poll_after(2) }, &["temperature"], &[]),
    ("bq27220", |b| { b.set("keeps_full", "on"); resize_believed(b, 12_000.0); b.poll_after(3) }, &["full-capacity"], &[]),
    ("bq27220", |b| { resize_believed(b, 12_000.0); b.poll_after(3) }, &[], &[]),
    ("bq34110", |b| { b.set("keeps_full", "on"); resize_believed(b, 7000.0); b.poll_after(3) }, &["full-capacity"], &[]),
    ("bq34110", |b| { resize_believed(b, 7000.0); b.poll_after(3) }, &[], &[]),
    ("bq34110", |b| { b.set("keeps_full", "on"); resize_believed(b, 7000.0); b.lose_power(); b.poll_after(3) }, &[], &[]),
    ("bq27220", |b| b.step(900), &[], &["resistance"]),
    ("bq34z100-g1", |b| b.step(900), &[], &["resistance"]),
    ("bq34z100-g1", |b| { b.set("cells", 4); b.poll_after(2) }, &["cell-voltage"], &[]),
    ("bq27427", |b| { b.set("cc_gain_inverted", "on"); b.alternate(6) }, &["current-sign", "defect"], &[]),
];

#[test]
fn each_sick_gauge_has_its_own_findings_and_no_others() {
    let mut wrong = Vec::new();
    for (number, &(chip, make, says, doubts)) in SICK.iter().enumerate() {
        let named = |bench: &mut Bench, severity| {
            let found = bench.check().findings.into_iter().map(|found| found.rule);
            found.filter(|rule| rule.severity == severity).map(|rule| rule.name).collect::<BTreeSet<_>>()
        };
        let mut new = Bench::new(chip);
        new.poll();
        let usual = named(&mut new, Severity::Doubtful);
        let mut bench = Bench::new(chip);
        make(&mut bench);
        let found = named(&mut bench, Severity::Wrong);
        let doubted: BTreeSet<_> =
            named(&mut bench, Severity::Doubtful).difference(&usual).copied().collect();
        if found != says.iter().copied().collect() || doubted != doubts.iter().copied().collect() {
            wrong.push(format!("{number} {chip}: {found:?}, {doubted:?}; {:?}", bench.check()));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Writes a design capacity that the full one does not follow, and polls before and after.
fn resize(bench: &mut Bench, mah: f64) {
    bench.set("keeps_full", "on");
    bench.poll();
    bench.size(mah);
    bench.own += 1;
    bench.poll_after(3);
}

/// Shows another design capacity, and the full charge capacity after that.
fn redesign(bench: &mut Bench, from: i64, to: i64, full: i64) {
    bench.show(Role::ChargeFullDesign, from);
    bench.show(Role::ChargeFull, if full == from { full } else { from });
    bench.poll();
    bench.show(Role::ChargeFullDesign, to);
    bench.show(Role::ChargeFull, full);
    bench.own += 1;
    bench.poll_after(3);
}

/// Shows a discharge from full to EDV2, after which a CEDV gauge has learned its full charge capacity.
fn learn_full(bench: &mut Bench) {
    for names in [&["VDQ"][..], &["EDV2"]] {
        for register in bench.chip.registers {
            let known = register.bits.iter().filter(|bit| ["VDQ", "EDV2"].contains(&bit.name));
            let word = |bits: &mut dyn Iterator<Item = u32>| bits.fold(0, |word, bit| word | bit);
            let of_both = word(&mut known.clone().map(|bit| bit.mask));
            let set = word(&mut known.filter(|bit| names.contains(&bit.name)).map(|bit| bit.mask));
            if of_both != 0 {
                let value = bench.registers.value(register).expect("it was read") as u32 & !of_both | set;
                bench.show_register(register, value.into());
            }
        }
        bench.poll_after(3);
    }
    // The same register shows whether the gauge is open.
    bench.shows_itself();
}

/// Writes a design capacity, and the full charge capacity that a gauge believes, without taking its power.
fn resize_believed(bench: &mut Bench, mah: f64) {
    let names =
        ["Design Capacity", "Design Capacity mAh", "Full Charge Capacity", "Learned Full Charge Capacity"];
    if bench.chip.volatile.is_some() {
        bench.store_all(&names.map(|name| (name, mah)));
        return;
    }
    let rows: Vec<_> = bench.chip.rows().filter(|(_, row)| names.contains(&row.name)).collect();
    for row in rows {
        let bytes = bench.chip.layout.encode(row.1.kind, &Value::Int(mah as i64)).expect("it fits");
        bench.store_at(row, &bytes);
    }
}

/// Resets the gauge so often, by its power, or as this program does it.
fn reset(bench: &mut Bench, count: u32, ours: bool) {
    bench.poll_after(3);
    bench.set("first_ms", 5000);
    for _ in 0..count {
        bench.lose_power();
        bench.own += u64::from(ours);
        bench.poll();
        bench.poll_after(9);
    }
}

/// Flips a bit of OpConfig that the manual names, or reserves.
fn flip(bench: &mut Bench, named: bool) {
    let row = bench.chip.rows().find(|(_, row)| row.name == "OpConfig").expect("it has one");
    let is_named = |mask: u32| row.1.bits.iter().any(|bit| bit.mask == mask);
    let mask = (0..16).map(|bit| 1 << bit).find(|mask| is_named(*mask) == named).expect("a bit");
    let word = row.1.int_default(None).expect("a default") ^ i64::from(mask);
    let bytes = bench.chip.layout.encode(row.1.kind, &Value::Int(word)).expect("a word");
    bench.store_at(row, &bytes);
    bench.poll();
}

#[test]
fn each_rule_is_said_where_it_is_true_and_not_where_it_is_nearly() {
    let mut wrong = Vec::new();
    for (number, &(rule, chip, sick, near, word)) in CASES.iter().enumerate() {
        let mut bench = Bench::new(chip);
        sick(&mut bench);
        match bench.finds(rule) {
            Some(values) if values.contains(word) => {}
            found => wrong.push(format!("{number} {rule}: {found:?} has no {word:?}; {:?}", bench.check())),
        }
        let mut bench = Bench::new(chip);
        near(&mut bench);
        if let Some(values) = bench.finds(rule) {
            wrong.push(format!("{number} {rule}: said of a gauge without it: {values}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let tried: BTreeSet<_> = CASES.iter().map(|(rule, ..)| *rule).collect();
    assert_eq!(tried, RULES.iter().map(|rule| rule.name).collect::<BTreeSet<_>>());
    assert_eq!(tried.len(), RULES.len(), "two rules have one name");
}

#[test]
fn each_rule_says_what_it_means_what_to_do_and_where_that_stands() {
    for rule in RULES {
        let Rule { name, means, remedy, source, .. } = rule;
        assert!(!means.is_empty() && !remedy.is_empty() && !source.is_empty(), "{name}");
        assert!([means, remedy, source].iter().all(|text| !text.contains(['\t', '\n'])), "{name}");
        assert_eq!(Rule::by_name(name), Some(rule));
    }
}

#[test]
fn what_was_not_read_is_named_and_a_file_without_measurements_misses_none() {
    let mut bench = Bench::new("bq34z100-g1");
    bench.with_flash = false;
    let checked = bench.check();
    assert!(
        checked.findings.is_empty() && checked.missing.iter().any(|(_, name)| *name == "Voltage"),
        "{checked:?}"
    );
    bench.poll();
    let checked = bench.check();
    assert!(checked.missing.is_empty(), "{checked:?}");
    assert!(checked.unread.iter().any(|rule| rule.name == "cell-voltage"), "{checked:?}");
    bench.with_flash = true;
    let checked = bench.check();
    assert!(checked.missing.is_empty() && checked.unread.is_empty(), "{checked:?}");
    let flash = bench.flash();
    let stored = |(subclass, row): Row| flash.get(&(subclass.id, row.offset)).cloned();
    let checked = Checked::of(&Facts::of_flash(bench.chip, &stored));
    assert!(checked.missing.is_empty() && checked.unread.is_empty(), "{checked:?}");
    assert!(checked.findings.iter().any(|found| found.rule.name == "design-capacity-default"), "{checked:?}");
}

/// A battery for a drawn gauge: what a person would configure.
fn configure(bench: &mut Bench, random: &mut Random, told: &mut Vec<String>) -> Vec<(&'static str, f64)> {
    let chip = bench.chip;
    let has = |name: &str| chip.rows().any(|(_, row)| row.name == name && !row.unproven);
    // Where no row of the pack's charge is known, the simulated one keeps its 1000 mAh.
    let is_sized = has("Qmax Cell 0") || has("Learned Full Charge Capacity") || has("Full Charge Capacity");
    let design = (700 + random.below(if is_sized { 6500 } else { 800 })) as f64;
    let mut energy = design * 3.7;
    let mut rows = vec![("Design Capacity", design), ("Design Capacity mAh", design)];
    if has("Design Energy Scale") && (energy > 32_000.0 || random.below(4) == 0) {
        energy /= 10.0;
        rows.push(("Design Energy Scale", 10.0));
        told.push("energy scale".into());
    }
    let taper = if has("Taper Current") { ("Taper Current", design / 20.0) } else { ("Taper Rate", 200.0) };
    rows.extend([("Design Energy", energy.min(32_000.0)), ("Terminate Voltage", 3000.0), taper]);
    // What the pack has learned, or the capacity that it begins with.
    let is_learned = random.below(2) == 0;
    let qmax = if is_learned { design * (85 + random.below(20)) as f64 / 100.0 } else { design };
    let is_share = chip.rows().any(|(_, row)| row.name == "Qmax Cell 0" && row.unit == "Num");
    rows.push(("Qmax Cell 0", if is_share { 16384.0 * qmax / design } else { qmax }));
    rows.extend([("Learned Full Charge Capacity", qmax), ("Full Charge Capacity", qmax)]);
    if is_learned && chip.volatile.is_none() {
        rows.push(("Update Status", 6.0));
    }
    told.push(if is_learned { "learned" } else { "not learned" }.into());
    if chip.stored(Role::Cells).is_some() {
        let cells = 1 + random.below(7);
        rows.extend(["Number of series cell", "Number of Series Cells"].map(|name| (name, cells as f64)));
        told.push(format!("{cells} cells"));
        if has("Pack Configuration") && cells > 1 && bench.chip.scaling.voltage == Scale::None {
            rows.extend([
                ("Pack Configuration", f64::from(0x0961)),
                ("Voltage Divider", 6000.0 * cells as f64),
            ]);
        }
        if bench.chip.scaling.voltage != Scale::None && random.below(3) == 0 {
            // The gauge shows a tenth of what its pack has.
            let cells = 10 + random.below(6);
            rows.extend(["Number of series cell", "Number of Series Cells"].map(|name| (name, cells as f64)));
            bench.bytes.lock().expect("no panic").insert(0x20, 10);
            bench.set("voltage_mv", cells * (3100 + random.below(1100)) / 10);
            told.push("scale".into());
        }
    }
    bench.store_all(&rows);
    if !told.iter().any(|word| word == "scale") {
        bench.set("voltage_mv", "auto");
    }
    if chip.stored(Role::Technology).is_some() && chip.scaling.voltage == Scale::None && random.below(4) == 0
    {
        let cells = rows
            .iter()
            .find(|(name, _)| *name == "Number of series cell")
            .map_or(1, |(_, cells)| *cells as u64);
        told.push(cook(bench, cells, random).into());
    }
    rows
}

/// Gives Device Chemistry another name.
fn call(bench: &mut Bench, name: &str) {
    let row = bench.chip.stored(Role::Technology).expect("a row");
    bench.store_at(row, &[&[name.len() as u8], name.as_bytes()].concat());
}

/// Gives the pack other cells. Their voltage is within what they have, whatever the load.
fn cook(bench: &mut Bench, cells: u64, random: &mut Random) -> &'static str {
    let (name, low, high) =
        [("NIMH", 900, 1500), ("PBA ", 1800, 2450), ("LIFE", 2500, 3650)][random.below(3) as usize];
    call(bench, name);
    bench.set("voltage_mv", cells * (low + random.below(high - low)));
    name
}

/// Some resets by this program, after each of which a gauge with RAM gets its configuration again. Nothing may be wrong at once
/// with one that keeps it.
fn resets(bench: &mut Bench, random: &mut Random, rows: &[(&str, f64)]) -> Vec<Finding> {
    let mut found = Vec::new();
    bench.set("first_ms", 1000 + random.below(1000));
    // A gauge without data flash has no such values.
    let _ = bench.sim.set("first_values", if random.below(2) == 0 { "old" } else { "nonsense" });
    for _ in 0..1 + random.below(4) {
        bench.lose_power();
        bench.own += 1;
        for _ in 0..3 {
            bench.poll_after(1);
            if bench.chip.volatile.is_none() {
                found.extend(bench.check().findings);
            }
        }
        if bench.chip.volatile.is_some() {
            bench.store_all(rows);
            bench.own += 1;
        }
        bench.poll_after(4);
        found.extend(bench.check().findings);
    }
    found
}

/// What real gauges show at times: more than a full battery has, for a while; and little in the cold.
fn vary(bench: &mut Bench, random: &mut Random, told: &mut Vec<String>) {
    let has = |role| bench.chip.register(role).is_some_and(|register| register.size == 2);
    if !bench.chip.has_table() || ![Role::ChargeNow, Role::ChargeFull, Role::Temp].into_iter().all(has) {
        return;
    }
    let (full, degrees) = (bench.value(Role::ChargeFull), bench.value(Role::Temp) / 10 - 273);
    if degrees < -2 && random.below(2) == 0 {
        bench.show(Role::ChargeFull, full / 5);
        bench.show(Role::ChargeNow, full / 6);
        told.push("little in the cold".into());
    } else if full < 30_000 && random.below(3) == 0 {
        bench.show(Role::ChargeNow, full + full * random.below(9) as i64 / 100);
        told.push("a little above full".into());
    }
    bench.poll_after(1);
}

/// What happens to a drawn gauge, with polls in between.
fn live(bench: &mut Bench, random: &mut Random, told: &mut Vec<String>) {
    let design =
        bench.chip.register(Role::ChargeFullDesign).map_or(1000, |_| bench.value(Role::ChargeFullDesign));
    if random.below(3) == 0 && bench.sim.set("noise_mv", "20").is_ok() {
        bench.set("noise_ma", 15);
        told.push("noise".into());
    }
    for _ in 0..3 + random.below(6) {
        let (what, load) = match random.below(5) {
            0 => ("rest", 0),
            1 => ("light load", design / 20),
            2 => ("heavy load", design),
            3 if bench.chip.condition.primary.is_none() => ("charge", -design / 2),
            _ => ("load", design / 3),
        };
        let most = if bench.chip.condition.primary.is_some() { 100 } else { 30_000 };
        bench.set("load_ma", load.clamp(-most, most));
        told.push(what.into());
        for _ in 0..1 + random.below(4) {
            bench.poll_after([1, 3, 30, 300, 1800][random.below(5) as usize]);
        }
    }
}

/// Writes another design capacity, and what else a person knows, into a gauge that goes on. Its full charge capacity may follow
/// or not.
fn configure_anew(bench: &mut Bench, random: &mut Random, told: &mut Vec<String>) -> Vec<Finding> {
    let mah = (200 + random.below(7000)) as f64;
    if bench.sim.set("keeps_full", if random.below(2) == 0 { "on" } else { "off" }).is_err() {
        return Vec::new();
    }
    bench.poll_after(1);
    // Nothing is written to a gauge with RAM that may lose it.
    if bench.chip.volatile.is_some() && bench.value(Role::VoltageNow) < 2500 {
        return Vec::new();
    }
    if bench.store_all(&[("Design Capacity", mah), ("Design Capacity mAh", mah)]) == 0 {
        return Vec::new();
    }
    bench.own += 1;
    told.push(format!("{mah} mAh anew"));
    let mut found = Vec::new();
    for seconds in [0, 1, 30, 600, 1800] {
        bench.poll_after(seconds);
        found.extend(bench.check().findings);
    }
    found
}

/// Draws a gauge that is well, and tells what it is; fails if something is wrong with it.
fn draw(seed: u64) -> Result<Vec<String>, String> {
    // Rules need a table; a Smart Battery has knobs of its own.
    let chips: Vec<&Chip> = Chip::all().filter(|chip| Sim::knows(chip.name) && chip.has_table()).collect();
    let random = &mut Random(seed);
    let chip = chips[(seed % chips.len() as u64) as usize];
    let mut told = vec![chip.name.to_string()];
    let mut bench = Bench::new(chip.name);
    let rows = configure(&mut bench, random, &mut told);
    bench.set("soc", [0, 1, 5, 30, 60, 90, 99, 100][random.below(8) as usize]);
    bench.set("temperature", random.below(900) as i64 - 350);
    if chip.volatile.is_none() && random.below(3) == 0 {
        bench.lose_power();
        told.push("after a reset".into());
    }
    bench.poll_after(random.below(2));
    let mut found = bench.check().findings;
    while bench.history.summary() == History::default().summary() && bench.registers.are_all_ones() {
        bench.poll_after(1);
    }
    bench.poll_after(5);
    if random.below(3) == 0 {
        found.extend(resets(&mut bench, random, &rows));
        told.push("resets of ours".into());
    }
    live(&mut bench, random, &mut told);
    vary(&mut bench, random, &mut told);
    bench.with_flash = random.below(2) == 0;
    found.extend(bench.check().findings);
    bench.bytes.lock().expect("no panic").retain(|at, _| *at == 0x20);
    if random.below(3) == 0 {
        found.extend(configure_anew(&mut bench, random, &mut told));
    }
    let wrong: Vec<_> = found.iter().filter(|found| found.rule.severity == Severity::Wrong).collect();
    told.extend(found.iter().map(|found| format!("{} {}", found.rule.severity.as_str(), found.rule.name)));
    told.sort();
    told.dedup();
    match wrong.is_empty() {
        true => Ok(told),
        false => Err(format!("{wrong:?} <- {}", told.join(", "))),
    }
}

#[test]
fn nothing_is_wrong_with_drawn_gauges_that_are_well() {
    drawn("drawn gauges that are well", 10_000, draw);
}

#[test]
fn regression_gauges_that_were_told_wrong_are_well() {
    // A full charge capacity that was predicted anew just before a write; and a voltage whose noise went against the current.
    let predicted = [2_003_149, 2_007_522, 2_010_820, 2_011_833, 2_024_353, 2_026_887];
    let restless = [2_009_164, 2_018_134, 2_032_005];
    let wrong: Vec<_> = predicted
        .into_iter()
        .chain(restless)
        .filter_map(|seed| draw(seed).err().map(|why| format!("seed {seed}: {why}")))
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
