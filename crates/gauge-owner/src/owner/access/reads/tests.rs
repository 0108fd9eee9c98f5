// SPDX-License-Identifier: MIT

//! Single values of data flash: what they cost, and that each event that puts a subclass out of date does so with them.

use std::time::Duration;

use crate::error::Result;
use crate::owner::rig::{INTERVAL, Rig};
use crate::owner::{Run, operations as op};
use gauge_bus::clock::Clock as _;
use ti_gauge::chip::{Chip, Parameter, Row};
use ti_gauge::dataflash::Change;
use ti_gauge::value::Value;

/// Offsets in subclass 80: Cell Terminate Voltage, a parameter of its block, and one of another block.
const TERMINATE: &str = "53";
const BESIDE: &str = "55";
const ELSEWHERE: &str = "10";

fn index(rig: &Rig, row: Row) -> usize {
    let mut rows = rig.handle.chip().subclasses.iter();
    rows.position(|subclass| std::ptr::eq(subclass, row.0)).expect("a subclass of the table")
}

fn row(rig: &Rig, subclass: &str, offset: &str) -> Row {
    rig.handle.chip().row(subclass, offset).expect("a parameter of the table")
}

fn read(rig: &mut Rig, row: Row) -> Value {
    let index = index(rig, row);
    rig.ask(&op::READ_VALUE, (index, row.1)).expect("the default key")
}

fn kept(rig: &Rig, row: Row) -> Option<Value> {
    rig.handle.kept_parameter(index(rig, row), row.1)
}

/// How many blocks a gauge has been asked for: two bytes of a selection, in DataFlashClass() or ManufacturerAccessControl().
fn blocks(rig: &mut Rig, work: impl FnOnce(&mut Rig)) -> usize {
    rig.sim.keep_log(true);
    rig.sim.clear_log();
    work(rig);
    rig.sim.log().iter().filter(|record| matches!(*record.write, [0x3e, _, _])).count()
}

#[test]
fn a_value_costs_its_block_and_that_of_the_marks() {
    let mut rig = Rig::open();
    let [terminate, beside, elsewhere] = [TERMINATE, BESIDE, ELSEWHERE].map(|offset| row(&rig, "80", offset));
    let mut cost = |row| blocks(&mut rig, |rig| drop(read(rig, row)));
    assert_eq!([terminate, terminate, beside, elsewhere, elsewhere].map(&mut cost), [2, 0, 0, 1, 0]);
}

#[test]
fn a_value_across_a_border_costs_two_blocks() {
    let crosses = |parameter: &&Parameter| {
        let end = usize::from(parameter.offset) + parameter.kind.size() - 1;
        usize::from(parameter.offset) / 32 != end / 32
    };
    let mut found = 0;
    for chip in Chip::all().filter(|chip| chip.has_table() && gauge_sim::Sim::knows(chip.name)) {
        let rows = chip.subclasses.iter().filter(|row| row.kind != ti_gauge::chip::Kind::Security);
        let crossing = rows.filter_map(|row| Some((row, row.parameters.iter().find(crosses)?)));
        for row in crossing.take(1) {
            let mut rig = Rig::of(chip.name, Run::default());
            rig.start().expect("it answers");
            let own = index(&rig, row);
            let whole = rig.ask(&op::READ, vec![own]).expect("the default key");
            let at = usize::from(row.1.offset - row.0.start());
            let value = chip.layout.decode(row.1.kind, &whole[0][at..at + row.1.kind.size()]);
            rig.ask(&op::REFRESH, ()).expect("it answers");
            rig.clock.sleep(INTERVAL);
            assert!(kept(&rig, row).is_none(), "{}", chip.name);
            assert_eq!(read(&mut rig, row), value, "{}", chip.name);
            found += 1;
        }
    }
    assert!(found > 0, "no part has such a value");
}

/// What a subclass shows is of one reading, whatever of it was read before.
#[test]
fn a_subclass_is_read_as_a_whole() {
    let mut rig = Rig::open();
    let terminate = row(&rig, "80", TERMINATE);
    let own = index(&rig, terminate);
    assert_eq!(read(&mut rig, terminate), Value::Int(3000));
    assert!(rig.handle.kept(own).is_none(), "of most of it nothing is known");
    rig.sim.set_flash(80, 53, &3300_u16.to_be_bytes());
    let whole = rig.ask(&op::READ, vec![own]).expect("the default key");
    assert_eq!(whole[0][53..55], 3300_u16.to_be_bytes());
    assert_eq!(rig.handle.kept(own).as_deref(), Some(&*whole[0]));
    assert_eq!(kept(&rig, terminate), Some(Value::Int(3300)), "the later reading counts");
}

#[test]
fn nothing_keeps_a_value_that_may_have_changed() {
    type Event = fn(&mut Rig) -> Result<()>;
    fn write(rig: &mut Rig, (subclass, offset): (&str, &str), value: i64) -> Result<()> {
        let row = row(rig, subclass, offset);
        let change = Change::of_value(rig.handle.chip(), row, &Value::Int(value), true).expect("it fits");
        rig.ask(&op::WRITE, vec![change])
    }
    let events: [(&str, Event); 7] = [
        ("a refresh", |rig| rig.ask(&op::REFRESH, ())),
        ("a write to its block", |rig| write(rig, ("80", TERMINATE), 3100)),
        ("a reset", |rig| write(rig, ("67", "0"), 5)),
        ("a failed write", |rig| {
            rig.sim.set("fault", "corrupt-commit; corrupt-commit; corrupt-commit").expect("a fault");
            write(rig, ("80", TERMINATE), 3100).expect_err("nothing is stored");
            rig.sim.set("fault", "none").expect("no fault");
            Ok(())
        }),
        ("a failed poll", |rig| {
            rig.sim.set("power", "off").expect("a knob");
            rig.poll_after(INTERVAL);
            rig.sim.set("power", "on").expect("a knob");
            rig.clock.sleep(Duration::from_secs(3));
            rig.poll_after(INTERVAL);
            Ok(())
        }),
        ("another pack", |rig| {
            rig.sim.set_flash(48, 4, &0x1234_u16.to_be_bytes());
            rig.sim.set("power", "off").expect("a knob");
            rig.sim.set("power", "on").expect("a knob");
            rig.poll_after(INTERVAL);
            Ok(())
        }),
        ("a panic", |rig| {
            rig.owner.access.start_over();
            Ok(())
        }),
    ];
    for (name, event) in events {
        let mut rig = Rig::open();
        let terminate = row(&rig, "80", TERMINATE);
        assert_eq!(read(&mut rig, terminate), Value::Int(3000));
        rig.poll_after(INTERVAL);
        assert_eq!(kept(&rig, terminate), Some(Value::Int(3000)), "{name}: a poll changes nothing");
        event(&mut rig).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(kept(&rig, terminate), None, "{name}");
    }
}

#[test]
fn a_value_that_the_gauge_updates_is_read_again_after_a_poll() {
    let mut rig = Rig::open();
    let rows =
        rig.handle.chip().subclasses.iter().flat_map(|row| row.parameters.iter().map(move |own| (row, own)));
    let rows: Vec<Row> = rows.collect();
    let learned = rows.into_iter().find(|(_, parameter)| parameter.learned).expect("it learns");
    read(&mut rig, learned);
    assert!(kept(&rig, learned).is_some());
    rig.poll_after(INTERVAL);
    assert!(kept(&rig, learned).is_none());
}

/// A write without a reset puts only its own subclass out of date.
#[test]
fn a_write_without_a_reset_forgets_what_it_has_changed() {
    let mut rig = Rig::open();
    let [written, other] = [row(&rig, "58", "0"), row(&rig, "80", TERMINATE)];
    assert_eq!(written.1.kind, ti_gauge::value::Type::H(1));
    let _ = [written, other].map(|row| read(&mut rig, row));
    let change = Change::of_value(rig.handle.chip(), written, &Value::Int(0x5a), true).expect("it fits");
    rig.ask(&op::WRITE, vec![change]).expect("the default key");
    assert_eq!([written, other].map(|row| kept(&rig, row)), [None, Some(Value::Int(3000))]);
}

/// Two readings may share a part of their bytes.
#[test]
fn the_latest_reading_of_a_value_counts() {
    let rig = Rig::open();
    let terminate = row(&rig, "80", TERMINATE);
    let (own, shared) = (index(&rig, terminate), rig.owner.access.shared());
    let bytes = |value: u16, at: usize, length: usize| {
        let mut bytes = vec![0; length];
        bytes[at..at + 2].copy_from_slice(&value.to_be_bytes());
        bytes.into()
    };
    shared.keep(own, 32, bytes(3100, 21, 64), 1);
    shared.keep(own, 0, bytes(3200, 53, 64), 1);
    assert_eq!(kept(&rig, terminate), Some(Value::Int(3200)));
    shared.keep(own, 32, bytes(3300, 21, 32), 1);
    assert_eq!(kept(&rig, terminate), Some(Value::Int(3300)));
    assert_eq!(rig.handle.kept(own), None, "three readings are not one");
}
