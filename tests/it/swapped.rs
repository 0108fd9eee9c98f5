// SPDX-License-Identifier: MIT

//! A pack that is exchanged for another while it is mounted.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use gauge_bus::clock::{Clock, RealClock, SimClock};
use gauge_bus::{Bus, BusError};
use gauge_owner::{self as owner, Run, operations as op};
use gauge_sim::{Options, Sim};
use ti_gauge::chip::Chip;
use ti_gauge::dataflash::{Change, Outcome};
use ti_gauge::error::Result;
use ti_gauge::keys::Keys;
use ti_gauge::value::Value;

use crate::rig::Rig;
use crate::room::Mount;
use crate::room::{Folder, gaugefs, within};

const WRITTEN: Result<Outcome> = Ok(Outcome::Written { reset: true, old: Vec::new() });

/// Two packs at one address; the switch selects one, or none.
struct Swap([Box<dyn Bus>; 2], Arc<AtomicUsize>);

impl Bus for Swap {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let pack = self.0.get_mut(self.1.load(Ordering::SeqCst));
        pack.map_or(Err(BusError::NoAck), |pack| pack.transfer(write, read))
    }
}

/// A pack is exchanged for another one with the same chip between reading its values and a write, and back again
/// between two polls.
#[test]
fn a_swapped_pack_is_detected() {
    let mut other = Rig::new("bq34z100-g1");
    assert_eq!(other.write(48, 4, "0x0007"), WRITTEN);
    let clock: Arc<SimClock> = other.clock.clone();
    let first = Sim::new("bq34z100-g1", &Options::default(), clock.clone()).expect("a simulated chip");
    clock.sleep(Duration::from_secs(1));
    let at = Arc::new(AtomicUsize::new(0));
    let bus = Swap([Box::new(first.bus()), Box::new(other.sim.bus())], at.clone());
    let chip = Chip::by_name("bq34z100-g1").expect("a table");
    let interval = Duration::from_secs(3600);
    let run = Run { interval, ..Run::default() };
    let handle = owner::spawn(chip, Box::new(bus), clock.clone(), run, Arc::default()).expect("a gauge");
    let index = |id| chip.subclasses.iter().position(|row| row.id == id).expect("a subclass");
    let subclass = &chip.subclasses[index(80)];
    let parameter = subclass.parameter(53).expect("a row");
    let serial = || {
        let read = handle.wait_for(&op::READ, vec![index(48)]).expect("it is read");
        u16::from_be_bytes([read[0][4], read[0][5]])
    };
    let write = |value: i64| {
        let change =
            Change::of_value(chip, (subclass, parameter), &Value::Int(value), false).expect("it fits");
        handle.wait_for(&op::WRITE, vec![change])
    };
    assert_eq!(serial(), 1);
    let before = (first.flash(), other.sim.flash());

    at.store(1, Ordering::SeqCst);
    let error = write(3100).expect_err("another pack");
    assert_eq!(error.errno(), nix::errno::Errno::ENODEV as i32, "{error}");
    assert!((first.flash(), other.sim.flash()) == before);
    assert!(handle.published().last_error.contains("another pack"), "{}", handle.published().last_error);
    assert_eq!(serial(), 7, "what was kept is dropped");
    handle.wait_for(&op::REFRESH, ()).expect("it answers");
    write(3100).expect("it is known now");
    assert!(first.flash() == before.0);
    assert!(other.sim.flash() != before.1);

    assert_eq!(serial(), 7);
    at.store(0, Ordering::SeqCst);
    clock.sleep(interval);
    // Any request makes the owner thread poll now.
    handle.wait_for(&op::POLL_INTERVAL, interval).expect("it is set");
    within("the poll notices", || serial() == 1);
}

/// Two packs with the factory's serial number are exchanged between two polls.
#[test]
fn the_commands_read_the_pack_that_is_there() {
    let clock = Arc::new(RealClock::new());
    let second = Sim::new("bq34z100-g1", &Options::default(), clock).expect("a simulated chip");
    let at = Arc::new(AtomicUsize::new(0));
    let bus = |first: &Sim| -> Box<dyn Bus> {
        Box::new(Swap([Box::new(first.bus()), Box::new(second.bus())], at.clone()))
    };
    let hour = Duration::from_secs(3600);
    let Some(mount) = Mount::with("bq34z100-g1", hour, Keys::default(), |_| {}, Vec::new(), bus) else {
        return;
    };
    mount.echo("3100", "df/80/53").expect("a write");
    let (gauge, files) = (mount.path(""), Folder::new());
    let (folder, file) = (gauge.to_str().expect("UTF-8"), &*files.file("golden.toml"));
    let golden = gaugefs(&["export", folder]).done();
    std::fs::write(file, golden).expect("a file");
    assert_eq!(gaugefs(&["diff", file, folder]).done(), "");

    let before = second.flash();
    at.store(1, Ordering::SeqCst);
    let diff = gaugefs(&["diff", file, folder]);
    assert_eq!((diff.code, &*diff.out), (Some(1), "it-cfg/cell-terminate-voltage: 3100 -> 3000 mV\n"));
    at.store(0, Ordering::SeqCst);
    assert_eq!(gaugefs(&["diff", file, folder]).done(), "");
    at.store(1, Ordering::SeqCst);
    assert!(gaugefs(&["export", folder]).done().contains("\ncell-terminate-voltage = 3000 "));
    at.store(0, Ordering::SeqCst);
    assert!(gaugefs(&["export", folder]).done().contains("\ncell-terminate-voltage = 3100 "));
    at.store(1, Ordering::SeqCst);
    let mounted = gaugefs_client::Gauge::open(folder).expect("a mounted gauge");
    let (then, now) = (mounted.presence(), |text: &str| mount.echo(text, "gauge/refresh"));
    let then = then.expect("a number");
    assert!(mounted.apply(&then, &[], &[]).is_ok(), "it is the one");
    at.store(2, Ordering::SeqCst);
    (0..3).for_each(|_| assert!(now("1").is_err(), "nothing answers"));
    at.store(1, Ordering::SeqCst);
    now("1").expect("it is back");
    let error = mounted.apply(&then, &[], &[]).expect_err("it was away").to_string();
    assert!(error.contains("nothing was written"), "{error}");
    let import = gaugefs(&["import", folder, file]);
    assert_eq!(import.done(), "it-cfg/cell-terminate-voltage: 3000 -> 3100 mV\n");
    assert!(second.flash() != before);
}
