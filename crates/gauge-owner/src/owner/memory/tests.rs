// SPDX-License-Identifier: MIT

use super::super::rig::{INTERVAL, Rig};
use super::super::{Run, operations as op};
use super::*;
use crate::choose::Choice;
use crate::evidence::Evidence;
use gauge_bus::clock::{Clock, RealClock, SimClock};
use gauge_bus::{Bus, BusError};
use gauge_sim::{Options, Sim, SimBus};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use ti_gauge::chip::CHIPS;
use ti_gauge::image::Image;
use ti_gauge::journal::Journal;

const CAPACITY: i64 = 1234;

/// The rows of the Design Capacity of parts with RAM.
fn parts() -> impl Iterator<Item = &'static Chip> {
    CHIPS.iter().copied().filter(|chip| chip.volatile.is_some())
}

fn profile(chip: &'static Chip, more: &str) -> Vec<Change> {
    let rows = chip.subclasses.iter().flat_map(|class| class.parameters.iter().map(move |row| (class, row)));
    let row = rows.into_iter().find(|(_, row)| row.name == "Design Capacity").expect("each has one");
    let name = chip.name_of(row);
    let (group, name) = name.split_once('/').expect("a group and a name");
    let image = format!("chip = \"{}\"\n[{group}]\n{name} = {CAPACITY}\n{more}", chip.name);
    let image = Image::parse(&image, Some(chip)).expect("an image");
    image.to_restore().expect("values in range")
}

fn rig(chip: &'static Chip, more: &str) -> Rig {
    let run = Run { profile: profile(chip, more), ..Run::default() };
    let mut rig = Rig::of(chip.name, run);
    rig.start().expect("it answers");
    rig.poll_after(INTERVAL);
    rig.poll_after(INTERVAL);
    rig
}

fn lose_power(sim: &Sim) {
    sim.set("power", "off").expect("a knob");
    sim.set("power", "on").expect("a knob");
}

/// The files of the folder that something is owed by.
fn open(folder: &std::path::Path) -> Vec<String> {
    let files = std::fs::read_dir(folder).expect("a folder").map(|file| file.expect("a file").file_name());
    let names = files.map(|name| name.to_string_lossy().into_owned());
    names.filter(|name| !name.ends_with(".spare")).collect()
}

/// DesignCapacity() as attributes show it.
fn shown(rig: &Rig) -> Option<i64> {
    let published = rig.handle.published();
    let snapshot = published.snapshot.as_ref().filter(|snapshot| snapshot.is_configured)?;
    snapshot.value(rig.handle.chip().register(Role::ChargeFullDesign)?)
}

#[test]
fn a_profile_is_written_before_anything_else_is_shown() {
    for chip in parts() {
        let mut rig = rig(chip, "");
        let register = chip.register(Role::ChargeFullDesign);
        assert_eq!(shown(&rig), register.map(|_| CAPACITY), "{}", chip.name);
        for _ in 0..2 {
            lose_power(&rig.sim);
            rig.clock.sleep(Duration::from_secs(3));
            for _ in 0..3 {
                rig.poll_after(Duration::from_secs(1));
                let shown = shown(&rig);
                assert!(shown.is_none() || shown == Some(CAPACITY), "{}: {shown:?}", chip.name);
            }
            assert_eq!(shown(&rig), register.map(|_| CAPACITY), "{}", chip.name);
            assert_eq!(&*rig.handle.published().last_error, "", "{}", chip.name);
        }
    }
}

/// The gauge resets whenever CONFIG UPDATE is left.
struct Resets {
    bus: SimBus,
    sim: Arc<Mutex<Option<Sim>>>,
}

impl Bus for Resets {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let outcome = self.bus.transfer(write, read);
        if matches!(write, [0x00, 0x42 | 0x91, 0x00])
            && let Some(sim) = &*self.sim.lock().expect("no panic")
        {
            lose_power(sim);
        }
        outcome
    }
}

#[test]
fn a_gauge_that_resets_as_soon_as_it_is_configured_is_left_alone_after_three_tries() {
    for chip in parts() {
        let sim = Arc::new(Mutex::new(None));
        let run = Run { profile: profile(chip, ""), ..Run::default() };
        let wrap = |bus| -> Box<dyn Bus> { Box::new(Resets { bus, sim: sim.clone() }) };
        let mut rig = Rig::on(chip.name, run, wrap);
        *sim.lock().expect("no panic") = Some(rig.sim.clone());
        lose_power(&rig.sim);
        rig.clock.sleep(Duration::from_secs(3));
        rig.start().expect("it answers");
        let mut modes = 0;
        for _ in 0..30 {
            rig.poll_after(INTERVAL);
            let resets = Statistics::read(&rig.owner.access.shared().statistics.resets);
            modes = resets.max(modes);
        }
        // A try that fails without a flag that shows why is undone, too.
        assert!((3..=6).contains(&modes), "{}: {modes}", chip.name);
        let error = rig.handle.published().last_error.to_string();
        assert!(
            error.contains("3 times") && error.contains("not written any more"),
            "{}: {error}",
            chip.name
        );
        assert_eq!(shown(&rig), None, "{}", chip.name);
        // It is tried anew when it was away.
        *sim.lock().expect("no panic") = None;
        rig.sim.set("power", "off").expect("a knob");
        for _ in 0..3 {
            rig.poll_after(INTERVAL);
        }
        rig.sim.set("power", "on").expect("a knob");
        for _ in 0..3 {
            rig.poll_after(INTERVAL);
        }
        assert_eq!(shown(&rig), chip.register(Role::ChargeFullDesign).map(|_| CAPACITY), "{}", chip.name);
    }
}

#[test]
fn a_flag_that_somebody_has_cleared_hides_no_loss() {
    for chip in parts().filter(|chip| chip.volatile != Some(0)) {
        let mut rig = rig(chip, "");
        rig.sim.set("power", "off").expect("a knob");
        rig.poll_after(INTERVAL);
        rig.sim.set("power", "on").expect("a knob");
        rig.clock.sleep(Duration::from_secs(3));
        let mut other = rig.sim.bus();
        for word in [0x13, 0x42] {
            other.transfer(&[0x00, word, 0x00], &mut []).expect("it is acknowledged");
            rig.clock.sleep(Duration::from_secs(3));
        }
        for _ in 0..3 {
            rig.poll_after(INTERVAL);
        }
        assert_eq!(shown(&rig), chip.register(Role::ChargeFullDesign).map(|_| CAPACITY), "{}", chip.name);
    }
}

/// Another value than the part's own is no loss, where a flag would show one.
#[test]
fn a_value_that_somebody_has_set_stays_while_the_gauge_keeps_its_memory() {
    let chip = Chip::by_name("bq27441-g1").expect("it has a table");
    let mut rig = rig(chip, "");
    let row = chip.row("82", "10").expect("Design Capacity");
    rig.ask(&op::WRITE, vec![Change::parse(chip, row, b"2000", false).expect("it fits")]).expect("UNSEALED");
    rig.ask(&op::REFRESH, ()).expect("it answers");
    rig.owner.memory.doubt();
    for _ in 0..3 {
        rig.poll_after(INTERVAL);
    }
    assert_eq!(shown(&rig), Some(2000));
    lose_power(&rig.sim);
    for _ in 0..3 {
        rig.poll_after(INTERVAL);
    }
    assert_eq!(shown(&rig), Some(CAPACITY));
}

#[test]
fn what_the_gauge_has_learned_is_no_sign_of_a_loss() {
    let chip = Chip::by_name("bq27441-g1").expect("it has a table");
    // The second one is the part's own, as after a loss.
    for qmax in [17_000_u16, 16_384] {
        let mut rig = rig(chip, "qmax-cell-0 = 15000\n");
        rig.sim.set_flash(82, 0, &qmax.to_be_bytes());
        rig.owner.memory.doubt();
        let before = rig.sim.flash();
        for _ in 0..3 {
            rig.poll_after(INTERVAL);
        }
        assert!(rig.sim.flash() == before, "{qmax}");
    }
}

#[test]
fn a_gauge_that_loses_its_power_every_ten_seconds_is_configured_each_time() {
    for chip in parts() {
        let mut rig = rig(chip, "");
        for round in 0..20 {
            lose_power(&rig.sim);
            rig.clock.sleep(Duration::from_secs(3));
            rig.poll_after(Duration::ZERO);
            rig.poll_after(Duration::from_secs(1));
            rig.poll_after(Duration::from_secs(2));
            let expected = chip.register(Role::ChargeFullDesign).map(|_| CAPACITY);
            assert_eq!(shown(&rig), expected, "{}, round {round}", chip.name);
        }
    }
}

/// What ends at a transfer of a restoration.
#[derive(Clone, Copy, Debug)]
enum Lost {
    /// The gauge's power, for a moment.
    Gauge,
    /// The host's: another daemon begins where this one was.
    Host,
}

/// A bus that ends at the transfer of that number.
struct Ends {
    bus: SimBus,
    left: Arc<AtomicU64>,
    /// How.
    end: fn() -> BusError,
}

impl Bus for Ends {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let left = self.left.load(Ordering::Relaxed);
        if left == 0 {
            return Err((self.end)());
        }
        self.left.store(left.saturating_sub(1), Ordering::Relaxed);
        self.bus.transfer(write, read)
    }
}

/// The host does nothing any more, and takes no time for it.
fn dies() -> BusError {
    resume_unwind(Box::new("the host is gone"))
}

/// A bus on which each transfer takes a while.
struct Slow {
    bus: SimBus,
    clock: Arc<SimClock>,
}

impl Bus for Slow {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        self.clock.sleep(Duration::from_millis(6));
        self.bus.transfer(write, read)
    }
}

/// Half a profile is never shown as a whole one, and is whole in the end.
#[test]
fn a_loss_of_power_at_any_transfer_of_a_restoration_is_made_good() {
    let folder = std::env::temp_dir().join(format!("gaugefs-memory-{}", std::process::id()));
    for (chip, lost) in parts().flat_map(|chip| [(chip, Lost::Gauge), (chip, Lost::Host)]) {
        let expected = chip.register(Role::ChargeFullDesign).map(|_| CAPACITY);
        // A restoration has a hundred transfers. Where no flag shows the loss of memory, only what the gauge holds tells what
        // a host has left.
        let is_told_by_values = matches!(lost, Lost::Host) && chip.volatile == Some(0);
        let all = is_told_by_values || std::env::var_os("GAUGEFS_ALL_FAULTS").is_some();
        let every = if all { 1 } else { 23 };
        for number in (1..).step_by(every) {
            let left = Arc::new(AtomicU64::new(u64::MAX));
            let journal = || Journal::new(folder.clone(), "i2c-1-55".into(), "i2c-1 address 0x55".into());
            let journal = || matches!(lost, Lost::Host).then(journal);
            let run = || Run { profile: profile(chip, ""), journal: journal(), ..Run::default() };
            let mut rig = Rig::on(chip.name, run(), |bus| {
                Box::new(Ends { bus, left: left.clone(), end: || BusError::NoAck })
            });
            rig.start().expect("it answers");
            rig.poll_after(INTERVAL);
            lose_power(&rig.sim);
            rig.clock.sleep(Duration::from_secs(3));
            let before = rig.transfers();
            match lost {
                Lost::Gauge => rig.sim.set("fault", &format!("power-cut {number} 300")).expect("a fault"),
                Lost::Host => left.store(number, Ordering::Relaxed),
            }
            rig.poll_after(Duration::ZERO);
            let is_done = rig.transfers() - before < number;
            rig.sim.set("fault", "none").expect("a knob");
            if let Lost::Host = lost {
                let (bus, clock) = (Box::new(rig.sim.bus()), rig.clock.clone());
                rig.direct = super::super::Direct::new(chip, bus, clock, run());
                // A gauge that has just come may still be in CONFIG UPDATE, or on its way out.
                rig.clock.sleep(Duration::from_secs(3));
                let _ = rig.start();
            }
            for _ in 0..6 {
                rig.poll_after(INTERVAL);
                let shown = shown(&rig);
                assert!(shown.is_none() || shown == expected, "{} {lost:?} {number}: {shown:?}", chip.name);
            }
            let error = rig.handle.published().last_error.to_string();
            assert_eq!(shown(&rig), expected, "{} {lost:?} {number}: {error}", chip.name);
            if is_done {
                break;
            }
        }
    }
    let _ = std::fs::remove_dir_all(folder);
}

/// As by a script that calls `gaugefs get` every second.
#[test]
fn regression_whoever_refreshed_more_often_than_it_was_polled_kept_a_gauge_from_its_profile() {
    for chip in parts() {
        let mut rig = rig(chip, "");
        lose_power(&rig.sim);
        rig.clock.sleep(Duration::from_secs(3));
        for _ in 0..5 {
            rig.clock.sleep(Duration::from_secs(1));
            rig.ask(&op::REFRESH, ()).expect("it answers");
            let shown = shown(&rig);
            assert!(shown.is_none() || shown == Some(CAPACITY), "{}: {shown:?}", chip.name);
        }
        assert_eq!(shown(&rig), chip.register(Role::ChargeFullDesign).map(|_| CAPACITY), "{}", chip.name);
    }
}

/// A device whose host is switched off again and again while its gauge is being configured.
#[test]
fn regression_each_restoration_that_the_host_had_left_kept_its_journal_for_ever() {
    let folder = std::env::temp_dir().join(format!("gaugefs-memory-left-{}", std::process::id()));
    for chip in parts() {
        let journal = Journal::new(folder.clone(), "i2c-1-55".into(), "i2c-1 address 0x55".into());
        let run = || Run { profile: profile(chip, ""), journal: Some(journal.clone()), ..Run::default() };
        let left = Arc::new(AtomicU64::new(u64::MAX));
        let mut rig = Rig::on(chip.name, run(), |bus| {
            Box::new(Ends { bus, left: left.clone(), end: || BusError::NoAck })
        });
        rig.start().expect("it answers");
        rig.poll_after(INTERVAL);
        let mut interrupted = 0;
        for number in (20..120).step_by(9) {
            lose_power(&rig.sim);
            rig.clock.sleep(Duration::from_secs(3));
            left.store(number, Ordering::Relaxed);
            rig.poll_after(Duration::ZERO);
            interrupted += u64::from(journal.path().exists());
            left.store(u64::MAX, Ordering::Relaxed);
            let bus = Box::new(Ends { bus: rig.sim.bus(), left: left.clone(), end: || BusError::NoAck });
            let clock = rig.clock.clone();
            rig.direct = super::super::Direct::new(chip, bus, clock, run());
            rig.clock.sleep(Duration::from_secs(3));
            let _ = rig.start();
            for _ in 0..6 {
                rig.poll_after(INTERVAL);
            }
            let expected = chip.register(Role::ChargeFullDesign).map(|_| CAPACITY);
            assert_eq!(shown(&rig), expected, "{} {number}", chip.name);
            assert_eq!(open(&folder), Vec::<String>::new(), "{} {number}", chip.name);
        }
        assert!(interrupted > 3, "{}: {interrupted}", chip.name);
    }
    let _ = std::fs::remove_dir_all(folder);
}

/// As by a watchdog that resets the host. The gauge shows CONFIG UPDATE up to a second after it was asked for it, and leaves it
/// by itself only after 240 s.
#[test]
fn regression_a_host_that_was_back_at_once_waited_for_the_end_of_config_update() {
    let folder = std::env::temp_dir().join(format!("gaugefs-memory-back-{}", std::process::id()));
    for chip in parts() {
        let journal = Journal::new(folder.clone(), "i2c-1-55".into(), "i2c-1 address 0x55".into());
        let run = || Run { profile: profile(chip, ""), journal: Some(journal.clone()), ..Run::default() };
        let left = Arc::new(AtomicU64::new(u64::MAX));
        let lost = || {
            let mut rig =
                Rig::on(chip.name, run(), |bus| Box::new(Ends { bus, left: left.clone(), end: dies }));
            rig.start().expect("it answers");
            rig.poll_after(INTERVAL);
            lose_power(&rig.sim);
            rig.clock.sleep(Duration::from_secs(3));
            rig
        };
        let mut whole = lost();
        whole.sim.keep_log(true);
        whole.poll_after(Duration::ZERO);
        let is_asked = |write: &[u8]| matches!(write, [0x00, 0x13 | 0x90, 0x00]);
        let asked = whole.sim.log().iter().position(|record| is_asked(&record.write));
        let asked = asked.expect("it is asked for CONFIG UPDATE") as u64 + 1;
        let takes: u64 = whole.sim.get("cfgupdate_ms").and_then(|time| time.parse().ok()).expect("a time");
        // What is done before the profile is written takes that long on a slow bus.
        for pause in (0..=takes).rev().step_by(25).take(16) {
            let mut rig = lost();
            left.store(asked, Ordering::Relaxed);
            catch_unwind(AssertUnwindSafe(|| rig.poll_after(Duration::ZERO))).expect_err("it ends there");
            left.store(u64::MAX, Ordering::Relaxed);
            let clock = rig.clock.clone();
            let bus = Box::new(Slow { bus: rig.sim.bus(), clock: clock.clone() });
            rig.direct = super::super::Direct::new(chip, bus, clock, run());
            rig.clock.sleep(Duration::from_millis(pause));
            let begun = rig.clock.now();
            let _ = rig.start();
            let expected = chip.register(Role::ChargeFullDesign).map(|_| CAPACITY);
            while shown(&rig) != expected {
                rig.poll_after(Duration::from_millis(500));
                let error = rig.handle.published().last_error.to_string();
                let took = rig.clock.now() - begun;
                assert!(took < Duration::from_secs(12), "{} after {pause} ms: {error}", chip.name);
            }
            rig.poll_after(INTERVAL);
            assert_eq!((shown(&rig), open(&folder)), (expected, vec![]), "{} after {pause} ms", chip.name);
        }
    }
    let _ = std::fs::remove_dir_all(folder);
}

/// Once the profile is there, nothing of what was interrupted is left.
#[test]
fn regression_an_interrupted_restoration_was_told_as_an_error_when_it_had_been_made_good() {
    let folder = std::env::temp_dir().join(format!("gaugefs-memory-told-{}", std::process::id()));
    let chip = Chip::by_name("bq27441-g1").expect("it has a table");
    let journal = Journal::new(folder.clone(), "i2c-1-55".into(), "i2c-1 address 0x55".into());
    let run = || Run { profile: profile(chip, ""), journal: Some(journal.clone()), ..Run::default() };
    let left = Arc::new(AtomicU64::new(u64::MAX));
    let mut rig =
        Rig::on(chip.name, run(), |bus| Box::new(Ends { bus, left: left.clone(), end: || BusError::NoAck }));
    rig.start().expect("it answers");
    rig.poll_after(INTERVAL);
    lose_power(&rig.sim);
    rig.clock.sleep(Duration::from_secs(3));
    left.store(40, Ordering::Relaxed);
    rig.poll_after(Duration::ZERO);
    assert!(journal.path().exists());
    let (bus, clock) = (Box::new(rig.sim.bus()), rig.clock.clone());
    rig.direct = super::super::Direct::new(chip, bus, clock, run());
    lose_power(&rig.sim);
    rig.clock.sleep(Duration::from_secs(3));
    rig.start().expect("it answers");
    rig.poll_after(INTERVAL);
    assert_eq!((shown(&rig), &*rig.handle.published().last_error), (Some(CAPACITY), ""));
    let _ = std::fs::remove_dir_all(folder);
}

/// The time of a machine that may be put to sleep.
struct Sleeps {
    clock: RealClock,
    asleep: AtomicU64,
}

impl Clock for Sleeps {
    fn now(&self) -> Duration {
        self.clock.now() + Duration::from_secs(self.asleep.load(Ordering::SeqCst))
    }

    fn sleep(&self, time: Duration) {
        self.clock.sleep(time);
    }
}

/// Its next poll is due in an hour.
#[test]
fn a_loss_while_the_host_was_asleep_is_found_when_it_is_awake() {
    let chip = Chip::by_name("bq27441-g1").expect("it has a table");
    let clock = Arc::new(Sleeps { clock: RealClock::new(), asleep: AtomicU64::new(10) });
    let sim = Sim::new(chip.name, &Options::default(), clock.clone()).expect("it is simulated");
    for knob in ["cfgupdate_ms", "cfgexit_ms"] {
        sim.set(knob, "1").expect("a knob");
    }
    let run = Run { profile: profile(chip, ""), interval: Duration::from_secs(3600), ..Run::default() };
    let bus = Box::new(sim.bus());
    let handle = super::super::spawn(chip, bus, clock.clone(), run, Arc::default()).expect("it answers");
    let shows = || {
        let published = handle.published();
        let snapshot = published.snapshot.as_ref().filter(|snapshot| snapshot.is_configured)?;
        snapshot.value(chip.register(Role::ChargeFullDesign)?)
    };
    let is_lost = || {
        let mut flags = [0; 2];
        let read = sim.bus().transfer(&[0x06], &mut flags);
        read.is_err() || u32::from(u16::from_le_bytes(flags)) & chip.volatile.unwrap_or(0) != 0
    };
    let within = |what: &str| {
        let begun = std::time::Instant::now();
        while is_lost() || shows() != Some(CAPACITY) {
            assert!(begun.elapsed() < Duration::from_secs(300), "{what}");
            std::thread::sleep(Duration::from_millis(50));
        }
    };
    within("at first");
    lose_power(&sim);
    clock.asleep.fetch_add(600, Ordering::SeqCst);
    within("after ten minutes asleep");
}

/// As where a processor that idles does not stop the clocks of the kernel.
#[test]
fn regression_a_loss_in_a_sleep_that_stopped_no_clock_was_found_with_the_next_poll() {
    let mut rig = rig(Chip::by_name("bq27441-g1").expect("it has a table"), "");
    rig.owner.access.shared().publish(|published| published.interval = Duration::from_secs(3600));
    rig.poll_after(INTERVAL);
    let asleep = Duration::from_secs(20);
    let then = std::time::Instant::now().checked_sub(asleep).map(|then| (rig.clock.now(), then));
    rig.owner.turn.pretend_ended(then);
    lose_power(&rig.sim);
    rig.clock.sleep(asleep);
    rig.owner.take_turn(None);
    let mut flags = [0; 2];
    rig.sim.bus().transfer(&[0x06], &mut flags).expect("it answers");
    let lost = rig.handle.chip().volatile.expect("it has a flag");
    assert_eq!(u32::from(u16::from_le_bytes(flags)) & lost, 0, "{}", rig.handle.published().last_error);
}

/// A mount waits for the first polls, so that this is when its values are there.
#[test]
fn the_first_values_are_right_within_three_seconds_of_the_bus() {
    for (chip, is_sealed) in parts().flat_map(|chip| [(chip, false), (chip, true)]) {
        let run = Run { profile: profile(chip, ""), ..Run::default() };
        let mut rig = Rig::of(chip.name, run);
        lose_power(&rig.sim);
        rig.clock.sleep(Duration::from_secs(2));
        let [low, high] = chip.security.seal.to_le_bytes();
        if is_sealed {
            rig.sim.bus().transfer(&[0x00, low, high], &mut []).expect("SEALED");
        }
        let begun = rig.clock.now();
        rig.start().expect("it answers");
        let due = rig.owner.access.schedule().due(INTERVAL);
        rig.poll_after(due.saturating_sub(rig.clock.now()));
        let expected = chip.register(Role::ChargeFullDesign).map(|_| CAPACITY);
        assert_eq!(shown(&rig), expected, "{} {is_sealed}", chip.name);
        let took = rig.clock.now() - begun;
        assert!(took < Duration::from_secs(3), "{} {is_sealed}: {took:?}", chip.name);
    }
}

/// Neither is a gauge with flash looked at for what it has lost.
#[test]
fn a_gauge_with_flash_keeps_its_own_configuration() {
    for chip in CHIPS.iter().copied().filter(|chip| chip.volatile.is_none() && chip.is_proven()) {
        let rows =
            || chip.subclasses.iter().flat_map(|class| class.parameters.iter().map(move |row| (class, row)));
        let value = ti_gauge::value::Value::Int(CAPACITY);
        let change = rows().find_map(|row| Change::of_value(chip, row, &value, false).ok());
        let change = change.expect("a row that takes this number");
        let choice = Choice { rule: crate::choose::Rule::default(), profile: vec![change.clone()] };
        for run in [
            Run { profile: vec![change.clone()], ..Run::default() },
            Run { choices: vec![choice], ..Run::default() },
        ] {
            let mut rig = Rig::of(chip.name, run);
            let flash = rig.sim.flash();
            rig.start().expect("it answers");
            lose_power(&rig.sim);
            for _ in 0..12 {
                rig.poll_after(INTERVAL);
            }
            assert!(rig.sim.flash() == flash, "{}", chip.name);
            assert_eq!(rig.sim.get("programmed").as_deref(), Some("0"), "{}", chip.name);
        }
    }
}

/// Two makers of cells, told apart by a resistor.
fn two_makers(file: &std::path::Path, chip: &'static Chip) -> Vec<Choice> {
    use crate::choose::Rule;
    let rule = |from: f64, to: f64, pack: &str| Rule {
        evidence: Some(Evidence::File(file.into())),
        from: Some(from),
        to: Some(to),
        profile: pack.into(),
        pack: Some(pack.into()),
        ..Rule::default()
    };
    let second: Vec<Change> =
        profile(chip, "").iter().map(|change| with_capacity(chip, change, 4321)).collect();
    vec![
        Choice { rule: rule(100.0, 200.0, "first"), profile: profile(chip, "") },
        Choice { rule: rule(300.0, 400.0, "second"), profile: second },
    ]
}

fn with_capacity(chip: &Chip, change: &Change, capacity: i64) -> Change {
    let row = change.row().expect("a parameter");
    Change::of_value(chip, row, &Value::Int(capacity), false).expect("it fits").saved()
}

#[test]
fn the_pack_decides_which_profile_is_written_and_an_unknown_one_gets_none() {
    for chip in parts() {
        let file = std::env::temp_dir().join(format!("gaugefs-maker-{}-{}", chip.name, std::process::id()));
        std::fs::write(&file, "150").expect("a file");
        let run = Run { choices: two_makers(&file, chip), ..Run::default() };
        let mut rig = Rig::of(chip.name, run);
        rig.start().expect("it answers");
        // Each time another pack, whose gauge had no power until then. The last one is back.
        for (reading, expected) in
            [("150", Some(CAPACITY)), ("350", Some(4321)), ("250", None), ("", None), ("150", Some(CAPACITY))]
        {
            std::fs::write(&file, reading).expect("a file");
            lose_power(&rig.sim);
            for _ in 0..4 {
                rig.poll_after(INTERVAL);
                let shown = shown(&rig);
                assert!(shown.is_none() || shown == expected, "{} {reading}: {shown:?}", chip.name);
            }
            let register = chip.register(Role::ChargeFullDesign);
            assert_eq!(shown(&rig), expected.filter(|_| register.is_some()), "{} {reading}", chip.name);
            let error = rig.handle.published().last_error.to_string();
            assert_eq!(error.is_empty(), expected.is_some(), "{} {reading}: {error}", chip.name);
            if reading == "250" {
                assert!(error.contains("none of its 2 profiles fits"), "{error}");
                assert!(error.contains("shows 250"), "{error}");
                // Nothing is written.
                let flash = rig.sim.flash();
                rig.poll_after(INTERVAL);
                assert!(rig.sim.flash() == flash);
            }
        }
        std::fs::remove_file(file).expect("it is there");
    }
}

/// The flag of its loss was cleared by another program.
#[test]
fn regression_defaults_were_shown_as_the_packs_while_no_rule_was_decided() {
    for chip in parts().filter(|chip| chip.volatile != Some(0)) {
        let file =
            std::env::temp_dir().join(format!("gaugefs-undecided-{}-{}", chip.name, std::process::id()));
        let run = Run { choices: two_makers(&file, chip), ..Run::default() };
        let mut rig = Rig::of(chip.name, run);
        for word in [0x8000_u16, 0x8000, 0x0013, 0x0042] {
            let [low, high] = word.to_le_bytes();
            rig.sim.bus().transfer(&[0x00, low, high], &mut []).expect("it is acknowledged");
            rig.clock.sleep(Duration::from_secs(3));
        }
        let is_shown = |rig: &Rig| {
            rig.handle.published().snapshot.as_ref().is_some_and(|snapshot| snapshot.is_configured)
        };
        rig.start().expect("it answers");
        for _ in 0..4 {
            assert!(!is_shown(&rig), "{}", chip.name);
            rig.poll_after(INTERVAL);
        }
        let error = rig.handle.published().last_error.to_string();
        assert!(error.contains("No such file"), "{error}");
        std::fs::write(&file, "350").expect("a file");
        for _ in 0..3 {
            rig.poll_after(INTERVAL);
        }
        assert!(is_shown(&rig), "{}", chip.name);
        assert_eq!(shown(&rig), chip.register(Role::ChargeFullDesign).map(|_| 4321), "{}", chip.name);
        assert_eq!(&*rig.handle.published().last_error, "", "{}", chip.name);
        std::fs::remove_file(file).expect("it is there");
    }
}

/// The choice is no reason to write to a gauge that has kept its memory.
#[test]
fn a_gauge_that_somebody_has_configured_stays_as_it_is_when_no_profile_fits() {
    let chip = Chip::by_name("bq27441-g1").expect("it has a table");
    let file = std::env::temp_dir().join(format!("gaugefs-nobody-{}", std::process::id()));
    std::fs::write(&file, "250").expect("a file");
    let mut rig = rig(chip, "");
    let run = Run { choices: two_makers(&file, chip), ..Run::default() };
    // Another daemon on the same gauge.
    rig.direct = super::super::Direct::new(chip, Box::new(rig.sim.bus()), rig.clock.clone(), run);
    rig.start().expect("it answers");
    rig.poll_after(INTERVAL);
    assert_eq!(shown(&rig), Some(CAPACITY));
    assert!(rig.handle.published().last_error.contains("none of its 2 profiles fits"));
    // A poll without an answer: the pack may be another one, and is looked at again.
    std::fs::write(&file, "150").expect("a file");
    rig.sim.set("power", "off").expect("a knob");
    rig.poll_after(INTERVAL);
    rig.sim.set("power", "on").expect("a knob");
    rig.poll_after(INTERVAL);
    rig.poll_after(INTERVAL);
    assert_eq!(shown(&rig), Some(CAPACITY));
    assert_eq!(&*rig.handle.published().last_error, "");
    std::fs::remove_file(file).expect("it is there");
}

/// `[BIE]` is bit 13 of OpConfig, and `[BAT_DET]` bit 3 of Flags().
#[test]
fn a_gauge_that_waits_for_a_battery_is_told_of_it() {
    let with_pin = |chip: &&Chip| chip.subcommands.iter().any(|one| one.name == "BAT_INSERT" && one.sealed);
    assert_eq!(parts().filter(with_pin).count(), 5);
    for (chip, is_sent) in parts().filter(with_pin).flat_map(|chip| [(chip, true), (chip, false)]) {
        let rows =
            chip.subclasses.iter().flat_map(|class| class.parameters.iter().map(move |row| (class, row)));
        let row = rows.into_iter().find(|(_, row)| row.name == "OpConfig").expect("each has one");
        let config = ti_gauge::value::Value::Int(if is_sent { 0x05F8 } else { 0x25F8 });
        let config = Change::of_value(chip, row, &config, false).expect("it fits");
        let profile = [profile(chip, ""), vec![config.saved()]].concat();
        let mut rig = Rig::of(chip.name, Run { profile, ..Run::default() });
        rig.start().expect("it answers");
        rig.poll_after(INTERVAL);
        let flags = |rig: &Rig| {
            let published = rig.handle.published();
            published.snapshot.as_ref().and_then(|snapshot| snapshot.value(chip.register(Role::Flags)?))
        };
        rig.sim.keep_log(true);
        lose_power(&rig.sim);
        for _ in 0..4 {
            rig.poll_after(Duration::from_secs(3));
        }
        let sent = rig.sim.log().iter().filter(|record| record.write == [0x00, 0x0C, 0x00]).count();
        assert_eq!(sent, usize::from(is_sent), "{} {is_sent}", chip.name);
        assert!(flags(&rig).is_some_and(|flags| flags & 8 != 0), "{} {is_sent}", chip.name);
        // What somebody else says afterwards counts.
        rig.sim.bus().transfer(&[0x00, 0x0D, 0x00], &mut []).expect("BAT_REMOVE");
        for _ in 0..4 {
            rig.poll_after(INTERVAL);
        }
        let is_gone = flags(&rig).is_some_and(|flags| flags & 8 == 0);
        assert_eq!(is_gone, is_sent, "{} {is_sent}", chip.name);
    }
}
