// SPDX-License-Identifier: MIT

//! What people and benches do to a station: packs that are swapped, numbers that are scanned twice, an input that ends.

use std::sync::OnceLock;

use super::*;
use crate::station::Sign;

/// A bench at which another pack is put in place of the first one, before a transfer; nothing answers meanwhile.
struct Swapped {
    packs: [Sim; 2],
    clock: Arc<SimClock>,
    sent: Arc<AtomicU64>,
    at: u64,
    gap: Duration,
    /// When the second one is there.
    until: Arc<OnceLock<Duration>>,
}

impl Bus for Swapped {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        if self.sent.fetch_add(1, Ordering::SeqCst) + 1 < self.at {
            return self.packs[0].bus().transfer(write, read);
        }
        let until = *self.until.get_or_init(|| self.clock.now() + self.gap);
        if self.clock.now() < until {
            return Err(BusError::NoAck);
        }
        self.packs[1].bus().transfer(write, read)
    }
}

/// A place at which one pack is begun.
pub(super) struct Bench1<C, F>(pub(super) Arc<C>, pub(super) F, pub(super) bool);

impl<C: Clock + 'static, B: Bus + 'static, F: Fn() -> B + Send> Slot for Bench1<C, F> {
    fn clock(&self) -> Arc<dyn Clock> {
        self.0.clone()
    }

    fn bus(&mut self) -> Box<dyn Bus> {
        Box::new((self.1)())
    }

    fn is_there(&mut self) -> Option<bool> {
        (!self.2).then_some(true)
    }

    fn done(&mut self) {
        self.2 = true;
    }
}

/// Swaps the pack before a transfer of the station, and returns how many transfers there were. If the station says PASS,
/// then the pack that is there has every bit.
fn swap(at: u64, gap: Duration) -> u64 {
    let folder = Folder::new("swapped");
    let plan = folder.plan(&format!("{PLAIN}\nunsettled = 'discard'"));
    let (map, clock) = (Map::of(&plan), Arc::new(SimClock::new()));
    let packs = [1, 2].map(|seed| new_pack(&clock, seed, None));
    let before = packs[1].flash();
    clock.sleep(Duration::from_secs(3));
    let line = Line::start(plan, &[], None).expect("a record");
    let (sent, until) = (Arc::new(AtomicU64::new(0)), Arc::new(OnceLock::new()));
    let bus = || Swapped {
        packs: packs.clone(),
        clock: clock.clone(),
        sent: sent.clone(),
        at,
        gap,
        until: until.clone(),
    };
    line.station.run(&line.bench, &mut Bench1(clock.clone(), bus, false));
    check_record(&folder);
    let last = folder.lines().pop().expect("a line");
    assert_ne!(last.event, Event::Begun, "{at}");
    if last.event == Event::Pass && until.get().is_some() {
        clock.sleep(Duration::from_secs(5));
        map.check(
            &packs[1],
            &before,
            last.serial.as_deref().expect("a number"),
            &format!("swapped at {at}, {gap:?}"),
        );
    }
    sent.load(Ordering::SeqCst)
}

/// A pack that was swapped while it was sealed, after the last reading, passed.
#[test]
fn regression_a_swapped_pack_passed_for_the_one_that_was_programmed() {
    let all = swap(u64::MAX, Duration::ZERO);
    let step = if std::env::var_os("GAUGEFS_ALL_FAULTS").is_some() { 1 } else { 9 };
    for gap in [Duration::from_millis(300), Duration::from_millis(700), Duration::from_secs(3)] {
        let ends = all.saturating_sub(12)..=all;
        for at in (1 + gap.subsec_millis() as u64 % 7..all).step_by(step).chain(ends) {
            swap(at, gap);
        }
    }
}

#[test]
fn regression_a_station_went_on_when_its_input_had_ended() {
    let folder = Folder::new("input-ended");
    let plan = folder.plan(&PLAIN.replace("'counter'\nfirst-serial = 1000", "'input'"));
    let clock = Arc::new(SimClock::new());
    let line = Line::start(plan, &["7"], None).expect("a record");
    let packs = (0..4).map(|seed| (new_pack(&clock, seed, None), "none".to_string()));
    let said = line.run(&clock, packs.collect::<Vec<_>>());
    assert!(said.len() == 2 && said[0].starts_with("PASS"), "{said:?}");
    assert!(said[1].contains("the input has ended") && said[1].contains("nothing was changed"), "{said:?}");
    assert!(!line.station.all_passed());
}

#[test]
fn a_line_that_is_no_text_is_asked_for_again() {
    let folder = Folder::new("no-text");
    let lines = PLAIN.replace("'counter'\nfirst-serial = 1000", "'input'") + "\nlabel = true";
    let clock = Arc::new(SimClock::new());
    let typed = ["caf\u{fffd}", "caf\u{e9}, \"=1+1\"", "\u{feff}8", "7\u{0}", "7"];
    let line = Line::start(folder.plan(&lines), &typed, None).expect("a record");
    let said = line.run(&clock, [(new_pack(&clock, 1, None), "none".into())]);
    assert!(
        said[0].starts_with("PASS BAT0 caf\u{e9}, \"=1+1\" serial 7 (0x0007)"),
        "{said:?} {:?}",
        line.said.all()
    );
    let csv = super::super::Records::read(&folder.file("line1.jsonl")).expect("a record").csv();
    let csv = String::from_utf8(csv).expect("text");
    assert!(csv.contains(",\"caf\u{e9}, \"\"=1+1\"\"\","), "{csv}");
}

/// Gives both slots the same number.
#[derive(Clone, Default)]
struct Same(Arc<Mutex<BTreeSet<String>>>);

impl Scanner for Same {
    fn line(&mut self, what: &str) -> Option<String> {
        let slot = what.split(':').next().unwrap_or_default().to_string();
        self.0.lock().expect("nobody panics").insert(slot).then(|| "7".to_string())
    }
}

/// A bus that is held up, once its slot has scanned, until something else has happened.
struct Held<F>(SimBus, &'static str, Same, F);

impl<F: Fn() -> bool + Send> Bus for Held<F> {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        let has_scanned = || self.2.0.lock().expect("nobody panics").contains(self.1);
        while has_scanned() && !(self.3)() {
            std::thread::yield_now();
        }
        self.0.transfer(write, read)
    }
}

/// Two operators scan the same code, one of them at a slot that is slow: by the time at which it is begun, the other pack has
/// passed.
#[test]
fn regression_two_packs_passed_with_a_number_that_was_scanned_at_two_slots() {
    let folder = Folder::new("same-number");
    let plan = folder.plan(&PLAIN.replace("'counter'\nfirst-serial = 1000", "'input'"));
    let clock = Arc::new(SimClock::new());
    let benches = ["LEFT", "RIGHT"].map(|name| {
        let bench = plan.bench(0, name.into(), Reach::FULL, Some(name.into())).expect("a bench");
        Bench { name: name.into(), ..bench }
    });
    let sims = [1, 2].map(|seed| new_pack(&clock, seed, None));
    clock.sleep(Duration::from_secs(3));
    let (same, said) = (Same::default(), Said::default());
    let stops = Arc::new(AtomicBool::new(false));
    let station =
        Station::start(plan, Arc::new(Host), Box::new(said.clone()), Box::new(same.clone()), None, stops)
            .expect("a record");
    let record = folder.file("line1.jsonl");
    let both = || {
        let same = same.clone();
        move || same.0.lock().expect("nobody panics").len() == 2
    };
    let passed = || {
        let record = record.clone();
        move || fs::read_to_string(&record).is_ok_and(|text| text.contains("\"event\":\"pass\""))
    };
    let left = || Held(sims[0].bus(), "LEFT", same.clone(), both());
    let right = || Held(sims[1].bus(), "RIGHT", same.clone(), passed());
    std::thread::scope(|scope| {
        scope.spawn(|| station.run(&benches[0], &mut Bench1(clock.clone(), left, false)));
        scope.spawn(|| station.run(&benches[1], &mut Bench1(clock.clone(), right, false)));
    });
    let said = said.all().into_iter().filter(|line| !line.starts_with('?')).collect::<Vec<_>>();
    assert!(said[0].starts_with("PASS LEFT serial 7 (0x0007)"), "{said:?}");
    assert!(
        said[1].starts_with("FAIL RIGHT") && said[1].contains("0x0007 is the serial number of pack"),
        "{said:?}"
    );
    check_record(&folder);
}

/// The pack that answers, which somebody exchanges while the program of `exec` runs.
#[derive(Clone)]
struct Label {
    said: Said,
    clock: Arc<SimClock>,
    now: Arc<Mutex<Sim>>,
    next: Arc<Mutex<Option<Sim>>>,
}

impl Screen for Label {
    fn outcome(&self, line: &str) {
        self.said.outcome(line);
    }

    fn prompt(&self, line: &str) {
        self.said.prompt(line);
    }

    fn sign(&self, _: &str, _: Sign, what: &str) {
        if what.ends_with(": exec)") {
            self.clock.sleep(Duration::from_secs(5));
            if let Some(next) = self.next.lock().expect("nobody panics").take() {
                *self.now.lock().expect("nobody panics") = next;
            }
        }
    }
}

impl Bus for Label {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        self.now.lock().expect("nobody panics").bus().transfer(write, read)
    }
}

/// A label takes its time, and the pack that is there at the end is the one that PASS is shown for.
#[test]
fn regression_a_pack_that_was_put_there_while_its_label_was_printed_passed() {
    // A new one; one that is programmed like the first, but for its number; the first one again.
    for other in ["new", "programmed", "same"] {
        let folder = Folder::new(&format!("label-{other}"));
        let told = folder.file("told");
        let exec =
            format!("exec = ['sh', '-c', 'echo $GAUGEFS_EVENT $GAUGEFS_SERIAL >> {}']", told.display());
        let plan = folder.plan(&format!("{PLAIN}\n{exec}"));
        let clock = Arc::new(SimClock::new());
        let packs = [1, 2].map(|seed| new_pack(&clock, seed, None));
        if other == "programmed" {
            let twin = Folder::new("label-twin");
            let lines = PLAIN.replace("first-serial = 1000", "first-serial = 2000");
            let line = Line::start(twin.plan(&lines), &[], None).expect("a record");
            let said = line.run(&clock, [(packs[1].clone(), "none".into())]);
            assert!(said[0].starts_with("PASS"), "{said:?}");
        }
        clock.sleep(Duration::from_secs(3));
        let flash = packs[1].flash();
        let next = if other == "same" { &packs[0] } else { &packs[1] };
        let label = Label {
            said: Said::default(),
            clock: clock.clone(),
            now: Arc::new(Mutex::new(packs[0].clone())),
            next: Arc::new(Mutex::new(Some(next.clone()))),
        };
        let bench = plan.bench(0, "a bus".into(), Reach::FULL, Some(KEY.into())).expect("a bench");
        let stops = Arc::new(AtomicBool::new(false));
        let station =
            Station::start(plan, Arc::new(Host), Box::new(label.clone()), Lines::of(&[]), None, stops)
                .expect("a record");
        let bus = || label.clone();
        station.run(&bench, &mut Bench1(clock.clone(), bus, false));
        check_record(&folder);
        let outcome = label.said.all().into_iter().find(|line| !line.starts_with('?')).expect("an outcome");
        let events = fs::read_to_string(told).expect("it was told");
        if other == "same" {
            assert!(outcome.starts_with("PASS") && events == "pass 1000\n", "{outcome} {events}");
            continue;
        }
        assert!(outcome.starts_with("FAIL BAT0 serial 1000"), "{other}: {outcome}");
        assert_eq!(events, "pass 1000\nfail 1000\n", "{other}: it knows that its PASS does not hold");
        assert_eq!(folder.lines().pop().and_then(|last| last.step).as_deref(), Some("exec"));
        assert!(packs[1].flash() == flash, "{other}: what is there now was not touched");
    }
}

/// A place at which a pack is exchanged faster than the station counts one as gone.
struct Quick(Arc<SimClock>, Sim, VecDeque<bool>);

impl Slot for Quick {
    fn clock(&self) -> Arc<dyn Clock> {
        self.0.clone()
    }

    fn bus(&mut self) -> Box<dyn Bus> {
        Box::new(self.1.bus())
    }

    fn is_there(&mut self) -> Option<bool> {
        self.2.pop_front()
    }
}

/// What a slot has shown, one after the other.
#[derive(Clone, Default)]
struct Signs(Arc<Mutex<Vec<(Sign, String)>>>);

impl Screen for Signs {
    fn outcome(&self, _: &str) {}

    fn prompt(&self, line: &str) {
        self.0.lock().expect("nobody panics").push((Sign::Connect, line.into()));
    }

    fn sign(&self, _: &str, sign: Sign, what: &str) {
        self.0.lock().expect("nobody panics").push((sign, what.into()));
    }
}

/// What a slot shows of a pack that is there, and of what is found there after that.
fn shown(name: &str, lines: &str, typed: &[&str], after: &[bool]) -> Vec<(Sign, String)> {
    let folder = Folder::new(name);
    let plan = folder.plan(lines);
    let clock = Arc::new(SimClock::new());
    let sim = new_pack(&clock, 1, None);
    clock.sleep(Duration::from_secs(3));
    let signs = Signs::default();
    let bench = plan.bench(0, "a bus".into(), Reach::FULL, Some(KEY.into())).expect("a bench");
    let stops = Arc::new(AtomicBool::new(false));
    let screen = Box::new(signs.clone());
    let station =
        Station::start(plan, Arc::new(Host), screen, Lines::of(typed), None, stops).expect("a record");
    let looks = std::iter::repeat_n(true, STEADY as usize).chain(after.iter().copied()).collect();
    station.run(&bench, &mut Quick(clock, sim, looks));
    signs.0.lock().expect("nobody panics").clone()
}

#[test]
fn regression_a_slot_at_which_nothing_is_scanned_said_scan() {
    let scans = |lines: &str| {
        let shown = shown("scans", lines, &["SN7"], &[]);
        assert!(shown.iter().any(|(sign, _)| *sign == Sign::Pass), "{shown:?}");
        shown.into_iter().filter(|(_, what)| what.contains("scan")).collect::<Vec<_>>()
    };
    assert_eq!(scans(PLAIN), []);
    assert_eq!(scans(&format!("{PLAIN}\nlabel = true")), [(Sign::Scan, "BAT0: scan the label".into())]);
}

/// The station waited for the pack to be taken off, and went on showing the outcome of the one before.
#[test]
fn regression_pass_was_shown_over_a_pack_that_was_connected_quickly() {
    let run = |after: &[bool]| {
        let signs = shown("quick", PLAIN, &[], after);
        let pass = signs.iter().position(|(sign, _)| *sign == Sign::Pass).expect("it passes");
        signs[pass + 1..].to_vec()
    };
    // It is gone for a moment only.
    let after = run(&[true, true, false, true, true, true]);
    assert!(
        after.iter().any(|(sign, what)| *sign == Sign::Look && what.contains("another pack")),
        "{after:?}"
    );
    assert!(after.iter().any(|(_, line)| line.starts_with("BAT0: the contact was broken")), "{after:?}");
    // It stays, or goes as it should: PASS stands.
    for looks in [&[true, true, true][..], &[true, false, false]] {
        let after = run(looks);
        assert!(after.iter().all(|(sign, _)| *sign != Sign::Look), "{after:?}");
    }
}
