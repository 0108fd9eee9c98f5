// SPDX-License-Identifier: MIT

//! Where the time of a pack goes: each wait by the functions that wait, held against the table of docs/MEASUREMENTS.md. A wait
//! that no row explains fails.

use std::backtrace::Backtrace;

use super::attacks::Bench1;
use super::*;

/// Rows of the table by their first words, and the functions that wait for that reason; the first row that fits counts.
const ROWS: [(&str, &[&str]); 7] = [
    ("transfers, and the pauses between", &["again"]),
    ("reading all data flash, twice", &["read_found/load", "read_first/load"]),
    ("commits of the write", &["commit", "glance", "verify_written"]),
    ("reading the blocks of the write", &["gather/load"]),
    ("the reset after the write", &["reset"]),
    ("asking for the seal", &["look_at_status"]),
    ("the next look at the registers", &["wait_for_turn"]),
];

/// A clock that notes which row each wait belongs to.
#[derive(Default)]
struct Timed {
    clock: SimClock,
    spent: Mutex<BTreeMap<&'static str, Duration>>,
    of_slot: Mutex<Duration>,
}

impl Timed {
    fn note(&self, row: &'static str, time: Duration) {
        *self.spent.lock().expect("nobody panics").entry(row).or_default() += time;
        self.clock.spend(time);
    }
}

/// The functions of gaugefs that are at work, the innermost first.
fn at_work() -> Vec<String> {
    let trace = Backtrace::force_capture().to_string();
    let lines: Vec<_> = trace.lines().map(str::trim).collect();
    let own = lines.windows(2).filter_map(|pair| {
        let (file, name) = (pair[1].strip_prefix("at ")?, pair[0].split_once(": ")?.1);
        let is_own =
            ["ti-gauge/src/", "gauge-owner/src/", "/src/station"].iter().any(|own| file.contains(own));
        let name = name.split('<').next().unwrap_or_default();
        let name = name.split("::").filter(|part| !part.starts_with('{') && !part.is_empty()).last()?;
        (is_own && !file.contains("/tests/")).then(|| name.to_string())
    });
    own.collect()
}

impl Clock for Timed {
    fn now(&self) -> Duration {
        self.clock.now()
    }

    fn sleep(&self, time: Duration) {
        if time.is_zero() {
            return;
        }
        let names = at_work();
        if !names.iter().any(|name| name == "program") {
            // Nothing of a pack's: the station waits for one.
            *self.of_slot.lock().expect("nobody panics") += time;
            return self.clock.spend(time);
        }
        let is_at_work =
            |wanted: &str| wanted.split('/').all(|wanted| names.iter().any(|name| name == wanted));
        // What waits within a transfer does not wait for what the transfer is for.
        let is_pause = names.iter().take(3).any(|name| name == "again" || name == "pass");
        let row = match is_pause {
            true => Some(&ROWS[0]),
            false => ROWS[1..].iter().find(|(_, functions)| functions.iter().any(|names| is_at_work(names))),
        };
        let (row, _) = row.unwrap_or_else(|| panic!("{time:?}: no row has this wait: {}", names.join(" < ")));
        self.note(row, time);
    }

    fn spend(&self, time: Duration) {
        self.note(ROWS[0].0, time);
    }
}

/// Programs a pack with an image, and tells where its time went.
fn programmed(image: Option<&str>) -> (Entry, BTreeMap<&'static str, Duration>) {
    let folder = Folder::new("waits");
    if let Some(image) = image {
        fs::write(folder.file("golden.toml"), image).expect("a file");
    }
    let plan = folder.plan(PLAIN);
    let clock = Arc::new(Timed::default());
    let sim = Sim::new(CHIP, &gauge_sim::Options::default(), clock.clone()).expect("it is simulated");
    clock.clock.sleep(Duration::from_secs(3));
    let bench = plan.bench(0, "a bus".into(), Reach::FULL, Some(KEY.into())).expect("a bench");
    let stops = Arc::new(AtomicBool::new(false));
    let station =
        Station::start(plan, Arc::new(Host), Box::new(Said::default()), Lines::of(&[]), None, stops)
            .expect("a record");
    station.run(&bench, &mut Bench1(clock.clone(), || sim.bus(), false));
    let pass = folder.lines().pop().expect("a line");
    assert_eq!(pass.event, Event::Pass);
    let spent = clock.spent.lock().expect("nobody panics").clone();
    (pass, spent)
}

#[test]
fn every_wait_of_a_pack_has_its_reason_in_the_document() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/MEASUREMENTS.md");
    // What crates.io has of this crate is without it.
    if !page.parent().is_some_and(Path::exists) {
        eprintln!("SKIPPED: there is no {}", page.display());
        return;
    }
    let page = fs::read_to_string(page).expect("the page");
    let section = page.split_once("\n## A pack at a station\n").expect("the section").1;
    let section = section.split("\n## ").next().unwrap_or_default();
    let image = format!("chip = \"{CHIP}\"\n[it-cfg]\ncell-terminate-voltage = 3100\n");
    let (pass, spent) = programmed(Some(&image));
    let (seconds, transfers) =
        (pass.seconds.expect("it is measured"), pass.transfers.expect("they are counted"));
    let mut lines: Vec<_> = spent.iter().map(|(row, time)| (time.as_secs_f64(), *row)).collect();
    lines.sort_by(|one, other| other.0.total_cmp(&one.0));
    let (whole, _) = programmed(None);
    let told = format!("An image of all values takes {:.1} s", whole.seconds.expect("it is measured"));
    println!("{seconds:.2} s, {transfers} transfers: {lines:#?}\n{told}");
    // Nothing else takes time.
    let sum: f64 = lines.iter().map(|(time, _)| time).sum();
    assert!((sum - seconds).abs() < 0.002, "{sum} and {seconds}");
    // The table has these rows, longest first, and no other.
    let printed: Vec<_> = section.lines().filter_map(|line| line.strip_prefix("| ")).skip(2).collect();
    assert_eq!(printed.len(), lines.len(), "{printed:#?}");
    for (row, (time, name)) in printed.iter().zip(&lines) {
        assert!(
            row.contains(name) && row.contains(&format!(" | {time:.2} | ")),
            "{row}: {name} takes {time:.2}"
        );
    }
    let flat = section.split_whitespace().collect::<Vec<_>>().join(" ");
    for told in
        [format!("takes {seconds:.1} s at 100 kHz"), format!("| {transfers} transfers, and the pauses")]
    {
        assert!(flat.contains(&told), "the page has no `{told}`");
    }
    assert!(flat.contains(&told), "the page has no `{told}`");
}
