// SPDX-License-Identifier: MIT

use super::super::learning::{EVERY_SEALED, FIRST, learning};
use super::super::rig::{INTERVAL, Rig};
use super::super::{Run, operations as op};
use super::*;
use gauge_bus::clock::Clock as _;
use ti_gauge::chip::{CHIPS, FLAT, Stays, Subclass};

const QMAX: (u16, usize) = (82, 0);

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("gaugefs-learned-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    folder
}

/// The files with versions.
fn kept(folder: &Path) -> Vec<PathBuf> {
    let files = fs::read_dir(folder).into_iter().flatten().map(|file| file.expect("a file").path());
    let mut files: Vec<_> = files.filter(|file| file.to_string_lossy().ends_with(SUFFIX)).collect();
    files.sort();
    files
}

fn chip() -> &'static Chip {
    Chip::by_name("bq27441-g1").expect("it has a table")
}

fn rig(folder: &Path, pack: Option<&str>) -> Rig {
    rig_with(Learned::new(folder.into(), "i2c-1-55".into(), pack.map(String::from)))
}

fn rig_with(learned: Learned) -> Rig {
    let image = "chip = \"bq27441-g1\"\n[state]\ndesign-capacity = 1234\nqmax-cell-0 = 16000\n";
    let image = Image::parse(image, Some(chip())).expect("an image");
    let profile = image.to_restore().expect("values in range");
    let run = Run { profile, learned: Some(learned), ..Run::default() };
    let mut rig = Rig::of("bq27441-g1", run);
    rig.start().expect("it answers");
    rig.poll_after(INTERVAL);
    rig.poll_after(INTERVAL);
    rig
}

/// The gauge learns a Qmax and an Ra, and is looked at.
fn learn(rig: &mut Rig, qmax: u16) {
    learn_now(rig, qmax);
    rig.poll_after(EVERY_SEALED);
}

fn learn_now(rig: &mut Rig, qmax: u16) {
    rig.sim.set_flash(QMAX.0, QMAX.1, &qmax.to_be_bytes());
    rig.sim.set_flash(89, 0, &77_u16.to_be_bytes());
}

fn lose_power(rig: &mut Rig) {
    rig.sim.set("power", "off").expect("a knob");
    rig.sim.set("power", "on").expect("a knob");
    for _ in 0..3 {
        rig.poll_after(Duration::from_secs(3));
    }
}

fn words(rig: &mut Rig) -> (u16, u16) {
    rig.ask(&op::REFRESH, ()).expect("it answers");
    let indices = vec![rig.index(82), rig.index(89)];
    let read = rig.ask(&op::READ, indices).expect("it is read");
    let word = |bytes: &[u8]| u16::from_be_bytes([bytes[0], bytes[1]]);
    (word(&read[0]), word(&read[1]))
}

fn told(rig: &mut Rig) -> String {
    rig.ask(&op::LEARNED, Wish::Show).expect("it is shown");
    rig.handle.published().learned.to_string()
}

#[test]
fn what_was_learned_outlives_the_power_of_a_pack_with_a_name() {
    let folder = folder("named");
    let mut rig = rig(&folder, Some("A"));
    learn(&mut rig, 15_432);
    lose_power(&mut rig);
    assert_eq!(words(&mut rig), (15_432, 77));
    let told = told(&mut rig);
    assert!(told.contains("qmax-cell-0 = 15432") && told.contains("restored with the profile"), "{told}");
    // Another daemon, and another pack, whose gauge gets nothing of it.
    for (pack, expected) in [("B", (16_000, 102)), ("A", (15_432, 77))] {
        let mut rig = self::rig(&folder, Some(pack));
        lose_power(&mut rig);
        assert_eq!(words(&mut rig), expected, "{pack}");
    }
    fs::remove_dir_all(folder).expect("it is there");
}

/// The gauge has power of its own, and another battery comes.
fn exchange_battery(rig: &mut Rig, between: impl FnOnce()) {
    let then = rig.handle.published().presence;
    rig.sim.set("bat_det", "out").expect("a knob");
    rig.poll_after(INTERVAL);
    assert!(!rig.handle.is_present());
    let away = rig.handle.published().presence;
    between();
    rig.sim.set("bat_det", "in").expect("a knob");
    for _ in 0..3 {
        rig.poll_after(INTERVAL);
    }
    let now = rig.handle.published().presence;
    assert!(rig.handle.is_present() && then != away && away != now && then != now);
}

#[test]
fn regression_a_battery_that_was_inserted_had_what_another_one_had_taught() {
    // Without a name it may be any; the one of a name is that one.
    for (pack, expected) in [(None, (16_000, 102)), (Some("A"), (15_440, 77))] {
        let folder = folder(&format!("inserted-{}", pack.is_some()));
        let mut rig = rig(&folder, pack);
        learn(&mut rig, 15_432);
        // No version has this yet.
        learn_now(&mut rig, 15_440);
        exchange_battery(&mut rig, || {});
        assert_eq!(words(&mut rig), expected, "{pack:?}");
        assert_eq!(*rig.handle.published().last_error, *"");
        fs::remove_dir_all(folder).expect("it is there");
    }
}

#[test]
fn a_battery_that_was_inserted_gets_the_profile_and_the_name_of_its_pack() {
    let folder = folder("chosen");
    fs::create_dir_all(&folder).expect("a folder");
    let shows = folder.join("pack");
    let name = |name: &str| fs::write(&shows, name).expect("a file");
    let choice = |text: &str, design: u16| {
        let evidence = Some(crate::Evidence::File(shows.clone()));
        let rule = crate::Rule {
            evidence,
            text: Some(text.into()),
            pack_by_text: true,
            profile: text.into(),
            ..crate::Rule::default()
        };
        let image =
            format!("chip = \"bq27441-g1\"\n[state]\ndesign-capacity = {design}\nqmax-cell-0 = 16000\n");
        let image = Image::parse(&image, Some(chip())).expect("an image");
        crate::Choice { rule, profile: image.to_restore().expect("values in range") }
    };
    let learned = Learned::new(folder.clone(), "i2c-1-55".into(), None);
    let choices = vec![choice("A", 1234), choice("B", 1300)];
    let run = Run { choices, learned: Some(learned), ..Run::default() };
    name("A");
    let mut rig = Rig::of("bq27441-g1", run);
    rig.start().expect("it answers");
    (0..2).for_each(|_| rig.poll_after(INTERVAL));
    learn(&mut rig, 15_432);
    let design = |rig: &mut Rig| {
        let index = rig.index(82);
        let read = rig.ask(&op::READ, vec![index]).expect("it is read");
        u16::from_be_bytes([read[0][10], read[0][11]])
    };
    for (pack, expected, capacity) in [("B", (16_000, 102), 1300), ("A", (15_432, 77), 1234)] {
        exchange_battery(&mut rig, || name(pack));
        assert_eq!((words(&mut rig), design(&mut rig)), (expected, capacity), "{pack}");
        assert!(told(&mut rig).contains(&format!("of the pack {pack}")), "{}", told(&mut rig));
    }
    fs::remove_dir_all(folder).expect("it is there");
}

/// A version of each Qmax, the last one newest.
fn versions(rig: &mut Rig, qmaxes: &[u16]) -> Vec<Version> {
    for &qmax in qmaxes {
        learn(rig, qmax);
    }
    let store = rig.owner.memory.store().expect("it was given");
    store.files(chip()).into_iter().map(|(version, _)| version).collect()
}

#[test]
fn somebody_may_go_back_to_an_older_version() {
    for pack in [Some("A"), None] {
        let folder = folder(&format!("older-{}", pack.is_some()));
        let mut rig = rig(&folder, pack);
        let there = versions(&mut rig, &[15_001, 15_002, 15_003]);
        let shown = told(&mut rig);
        for (version, qmax) in there.iter().zip([15_001, 15_002]) {
            assert!(shown.contains(&format!("  {version}  state/qmax-cell-0 = {qmax}\n")), "{shown}");
        }
        // What it has learned since is not lost.
        learn_now(&mut rig, 15_004);
        rig.ask(&op::LEARNED, Wish::Restore(Some(there[0].clone()))).expect("a person knows");
        assert_eq!(words(&mut rig), (15_001, 77));
        assert!(told(&mut rig).contains("state/qmax-cell-0 = 15004\n"));
        // It stays after a loss of power, by itself or by the next word.
        lose_power(&mut rig);
        let is_named = pack.is_some();
        assert_eq!(words(&mut rig), if is_named { (15_001, 77) } else { (16_000, 102) });
        let before = versions(&mut rig, &[]);
        rig.ask(&op::LEARNED, Wish::Restore(None)).expect("a person knows");
        assert_eq!(words(&mut rig), (15_001, 77));
        assert_eq!(versions(&mut rig, &[]), before, "a version twice");
        fs::remove_dir_all(folder).expect("it is there");
    }
}

#[test]
fn a_version_that_cannot_be_right_is_refused_with_the_reason() {
    let folder = folder("named-wrong");
    let mut rig = rig(&folder, Some("A"));
    let there = versions(&mut rig, &[15_001, 15_002]);
    let refused = |rig: &mut Rig, version: &Version| {
        let flash = rig.sim.flash();
        let asked = rig.ask(&op::LEARNED, Wish::Restore(Some(version.clone())));
        assert!(rig.sim.flash() == flash);
        asked.expect_err("a reason").to_string()
    };
    let other = Version::parse("19700101T000000Z").expect("a version");
    let error = refused(&mut rig, &other);
    assert!(error.contains(&format!("there are {}, {}", there[0], there[1])), "{error}");

    let store = rig.owner.memory.store().expect("it was given");
    let path = store.files(chip())[0].1.clone();
    let text = fs::read_to_string(&path).expect("text");
    for (from, to, why) in [
        ("qmax-cell-0 = 15001", "qmax-cell-0 = 0", "which is no capacity"),
        ("design-capacity = 1234", "design-capacity = 4321", "a Design Capacity of 4321 mAh"),
        ("r-a0-5 = 59", "r-a0-5 = 0", "which is no resistance"),
        ("bq27441-g1", "bq27427", "it is for a BQ27427"),
        ("[r-a-ram]", "[r-a", "line "),
    ] {
        fs::write(&path, text.replace(from, to)).expect("it is written");
        let error = refused(&mut rig, &there[0]);
        assert!(error.contains(why), "{to}: {error}");
        assert!(told(&mut rig).contains(&format!("  {}  not restored: ", there[0])), "{to}");
    }

    let mut other = self::rig(&folder, Some("B"));
    let error = refused(&mut other, &there[0]);
    assert!(error.contains("was learned with the pack A, and this is the pack B"), "{error}");
    let mut other = self::rig(&folder, None);
    let error = refused(&mut other, &there[0]);
    assert!(error.contains("and this is a pack without a name"), "{error}");
    fs::remove_dir_all(folder).expect("it is there");
}

/// It was saved before somebody named the pack.
#[test]
fn what_a_pack_without_a_name_has_learned_can_be_given_to_one_with_a_name() {
    let folder = folder("adopted");
    let mut nameless = rig(&folder, None);
    let there = versions(&mut nameless, &[15_001]);
    let mut rig = rig(&folder, Some("A"));
    lose_power(&mut rig);
    assert_eq!(words(&mut rig), (16_000, 102), "nothing is guessed");
    let shown = told(&mut rig);
    assert!(shown.contains("before the pack had a name") && shown.contains("qmax-cell-0 = 15001"), "{shown}");
    rig.ask(&op::LEARNED, Wish::Restore(Some(there[0].clone()))).expect("a person knows");
    lose_power(&mut rig);
    assert_eq!(words(&mut rig), (15_001, 77));
    fs::remove_dir_all(folder).expect("it is there");
}

/// The profile that is still to be written has a Qmax as well.
#[test]
fn regression_what_somebody_had_restored_was_replaced_by_the_profile() {
    let folder = folder("owed");
    let mut rig = rig(&folder, None);
    let there = versions(&mut rig, &[15_001]);
    rig.sim.set("power", "off").expect("a knob");
    rig.sim.set("power", "on").expect("a knob");
    rig.clock.sleep(Duration::from_secs(3));
    // The adapter fails once the profile is being written.
    let faults: Vec<_> = (20..120).map(|number| format!("eio {number}")).collect();
    rig.sim.set("fault", &faults.join("; ")).expect("faults");
    rig.poll_after(Duration::ZERO);
    assert!(!rig.handle.published().last_error.is_empty());
    rig.sim.set("fault", "none").expect("a knob");
    rig.ask(&op::LEARNED, Wish::Restore(Some(there[0].clone()))).expect("a person knows");
    for _ in 0..3 {
        rig.poll_after(INTERVAL);
    }
    assert_eq!(words(&mut rig), (15_001, 77));
    fs::remove_dir_all(folder).expect("it is there");
}

#[test]
fn a_clock_that_jumps_by_years_makes_no_older_version_the_newest() {
    let folder = folder("jumps");
    let rig = rig(&folder, Some("A"));
    let store = rig.owner.memory.store().expect("it was given");
    // Another daemon, as after a restart.
    let stores = [store.clone(), rig.owner.memory.store().expect("it was given")];
    let times =
        ["2026-11-25T09:30:00Z", "1970-01-01T00:00:00Z", "2099-01-01T00:00:00Z", "2026-11-25T09:30:00Z"];
    for (number, time) in (0..).zip(times) {
        let text = format!("chip = \"bq27441-g1\"\n[state]\nqmax-cell-0 = {}\n", 15_000 + number);
        let image = Image::parse(&text, Some(chip())).expect("an image");
        let now = time.parse().expect("a time");
        assert_eq!(stores[number % 2].save(&image, now), Ok(true), "{time}");
        let (newest, dropped) = store.newest(chip(), None);
        let newest = newest.map(|(_, image)| image.entries[0].value.clone());
        assert_eq!((newest, dropped.len()), (Some(Value::Int(15_000 + number as i64)), 0), "{time}");
    }
    let versions: Vec<_> = store.files(chip()).into_iter().map(|(version, _)| version.0).collect();
    let expected = ["20261125T093000Z", "20261125T094500Z", "20990101T000000Z", "20990101T001500Z"];
    assert_eq!(versions, expected);
    fs::remove_dir_all(folder).expect("it is there");
}

/// A store, and what saves a version with that Qmax at a time.
fn store(name: &str) -> (Learned, impl Fn(usize, Timestamp)) {
    let store = Learned::new(folder(name), "i2c-1-55".into(), Some("A".into()));
    let other = store.clone();
    let save = move |number: usize, now: Timestamp| {
        let qmax = 15_000 + number % 2;
        let text = format!("chip = \"bq27441-g1\"\n[state]\nqmax-cell-0 = {qmax}\n");
        let image = Image::parse(&text, Some(chip())).expect("an image");
        assert_eq!(store.save(&image, now), Ok(true), "{number}");
    };
    (other, save)
}

fn time(text: &str) -> Timestamp {
    text.parse().expect("a time")
}

fn names(store: &Learned) -> Vec<String> {
    store.files(chip()).into_iter().map(|(version, _)| version.0).collect()
}

/// What is left of versions that were saved at these times, without a disk.
fn history(times: impl Iterator<Item = Timestamp>) -> Vec<String> {
    let mut files: Vec<(Version, PathBuf)> = Vec::new();
    for now in times {
        let version = files.last().map_or(Some(Version::at(now)), |(last, _)| last.next(now));
        let version = version.expect("time is left");
        files.push((version.clone(), version.0.into()));
        let gone: Vec<PathBuf> = superfluous(&files).into_iter().map(PathBuf::from).collect();
        files.retain(|(_, path)| !gone.contains(path));
    }
    files.into_iter().map(|(version, _)| version.0).collect()
}

/// Whoever notices after weeks that something wrong was learned can go back.
#[test]
fn the_last_version_of_each_of_thirty_days_is_kept_beside_the_newest_ones() {
    let at = |day: i64, hour: i64| time("2026-11-01T00:30:00Z") + SignedDuration::from_hours(24 * day + hour);
    let left = history((0..40 * 24).map(|hour| at(0, hour)));
    let days = (10..39).map(|day| at(day, 23));
    let newest = (14..24).map(|hour| at(39, hour));
    let expected: Vec<_> = days.chain(newest).map(|time| Version::at(time).0).collect();
    assert_eq!((left, expected.len()), (expected.clone(), KEPT + DAYS - 1));
}

/// As of a host without a clock of its own, and of one that was in the year 2099 once.
#[test]
fn days_pass_by_a_clock_that_stays_behind() {
    for (first, ever_after) in
        [("2099-01-01T00:00:00Z", "2026-11-25T09:30:00Z"), ("2026-11-25T09:30:00Z", "1970-01-01T00:01:00Z")]
    {
        let left = history([first].into_iter().chain([ever_after; 4000]).map(time));
        let mut days: Vec<_> = left.iter().map(|name| &name[..8]).collect();
        days.dedup();
        assert!(days.len() == DAYS && left.len() < KEPT + DAYS, "{left:?}");
    }
}

/// The host has lost its power between a new version and the end of the old ones, again and again.
#[test]
fn versions_that_should_have_been_removed_are_removed_with_the_next_one() {
    let (store, save) = store("left");
    let left =
        |number: i64| Version::at(time("2026-11-20T09:30:00Z") + SignedDuration::from_mins(15 * number));
    fs::create_dir_all(&store.folder).expect("a folder");
    for number in 0..80 {
        let name = format!("i2c-1-55-bq27441-g1-A-{}{SUFFIX}", left(number));
        fs::write(store.folder.join(name), "half a").expect("a file");
    }
    save(0, time("2026-11-25T09:30:00Z"));
    // 58 of them are of the first day.
    assert_eq!(names(&store).len(), KEPT + 1);
    assert_eq!(names(&store)[0], left(57).0);
    fs::remove_dir_all(&store.folder).expect("it is there");
}

/// A device with two bays: the pack shows its serial number in either.
#[test]
fn a_pack_that_shows_its_name_takes_what_it_has_learned_along() {
    let (store, save) = store("bays");
    save(1, time("2026-11-25T09:30:00Z"));
    let other = Learned::new(store.folder.clone(), "i2c-2-55".into(), None);
    let of = |pack: &str| other.clone().of_pack_anywhere(Some(pack.into()));
    let qmax = |store: &Learned| {
        let (newest, _) = store.newest(chip(), None);
        newest.map(|(_, image)| image.entries[0].value.clone())
    };
    assert_eq!(qmax(&of("A")), Some(Value::Int(15_001)));
    assert_eq!(
        (qmax(&of("B")), qmax(&of("")), qmax(&other.clone().of_pack(Some("A".into())))),
        Default::default()
    );
    // What it learns there is newer.
    let image = Image::parse("chip = \"bq27441-g1\"\n[state]\nqmax-cell-0 = 15002\n", Some(chip()));
    let image = image.expect("an image");
    assert_eq!(of("A").save(&image, time("2026-11-25T09:30:00Z")), Ok(true));
    assert_eq!(qmax(&store.clone().of_pack_anywhere(Some("A".into()))), Some(Value::Int(15_002)));
    assert_eq!(qmax(&store), Some(Value::Int(15_001)));
    assert_eq!(of("A").forget(chip()), Ok(2));
    fs::remove_dir_all(&store.folder).expect("it is there");
}

#[test]
fn regression_a_folder_named_like_a_version_kept_the_newest_from_being_forgotten() {
    let (store, save) = store("forget");
    for number in 0..3 {
        save(number, time("2026-11-25T09:30:00Z") + SignedDuration::from_mins(15 * number as i64));
    }
    let like = |pack, time| format!("i2c-1-55-bq27441-g1-{pack}-{time}{SUFFIX}");
    let others = [
        like("A", "20261125T091500Z"),
        like("A", "20261126T091500Z"),
        like("B", "20261125T093000Z"),
        like("A", "20261125"),
        "notes.txt".into(),
    ];
    for name in &others {
        let path = store.folder.join(name);
        if name.contains("T091500Z") { fs::create_dir(path) } else { fs::write(path, "") }.expect("made");
    }
    assert_eq!(store.forget(chip()), Ok(3));
    let mut left: Vec<_> = fs::read_dir(&store.folder)
        .expect("a folder")
        .map(|entry| entry.expect("an entry").file_name().into_string().expect("text"))
        .collect();
    let mut others = others.to_vec();
    left.sort();
    others.sort();
    assert_eq!(left, others);
    fs::remove_dir_all(&store.folder).expect("it is there");
}

#[test]
fn a_version_is_named_by_a_time() {
    for text in ["20261125T093000Z", "20261125t093000z", "00010101T000000Z", "99991230T000000Z"] {
        assert_eq!(Version::parse(text).map(|version| version.0), Some(text.to_uppercase()), "{text}");
    }
    for text in
        ["", "20261125", "20261325T093000Z", "2026-11-25T09:30:00Z", "20261125T093000+01", "../../x", "x"]
    {
        assert_eq!(Version::parse(text), None, "{text}");
    }
    let next = |text, now: &str| {
        let next = Version::parse(text).and_then(|version| version.next(now.parse().expect("a time")));
        next.map(|version| version.0)
    };
    for (last, now, expected) in [
        ("20261231T235959Z", "2026-12-31T23:59:59Z", "20270101T000000Z"),
        ("20261231T235959Z", "2026-12-31T23:50:00Z", "20270101T000000Z"),
        ("20261231T235959Z", "2027-01-01T00:00:05Z", "20270101T000005Z"),
        ("20261231T235959Z", "1970-01-01T00:00:00Z", "20270101T001459Z"),
        ("19700101T000000Z", "2026-12-31T23:59:59Z", "20261231T235959Z"),
    ] {
        assert_eq!(next(last, now).as_deref(), Some(expected), "{last} {now}");
    }
    assert_eq!(next("99991230T220000Z", "2026-12-31T23:59:59Z"), None);
}

#[test]
fn of_a_pack_without_a_name_nothing_is_guessed() {
    let folder = folder("unnamed");
    let mut rig = rig(&folder, None);
    learn(&mut rig, 15_432);
    lose_power(&mut rig);
    assert_eq!(words(&mut rig), (16_000, 102));
    assert!(told(&mut rig).contains("--pack"));
    rig.ask(&op::LEARNED, Wish::Restore(None)).expect("a person knows");
    assert_eq!(words(&mut rig), (15_432, 77));
    rig.ask(&op::LEARNED, Wish::Forget).expect("it can be removed");
    rig.ask(&op::LEARNED, Wish::Restore(None)).expect_err("nothing is kept");
    fs::remove_dir_all(folder).expect("it is there");
}

#[test]
fn what_cannot_be_right_is_neither_saved_nor_restored() {
    let folder = folder("implausible");
    let mut rig = rig(&folder, Some("A"));
    for wrong in [0, 5000, 32_767] {
        rig.clock.sleep(Duration::from_secs(1));
        learn(&mut rig, wrong);
        assert!(kept(&folder).is_empty(), "{wrong}");
    }
    learn(&mut rig, 15_000);
    let file = kept(&folder).remove(0);
    let text = fs::read_to_string(&file).expect("text");
    for (from, to) in
        [("qmax-cell-0 = 15000", "qmax-cell-0 = 0"), ("r-a0-5 = 59", "r-a0-5 = 0"), ("[r-a-ram]", "[r-a")]
    {
        let wrong = text.replace(from, to);
        assert_ne!(wrong, text, "{from}\n{text}");
        fs::write(&file, wrong).expect("it is written");
        lose_power(&mut rig);
        assert_eq!(words(&mut rig).0, 16_000, "{to}");
        assert!(told(&mut rig).contains("nothing is kept that could be restored"), "{to}");
    }
    fs::remove_dir_all(folder).expect("it is there");
}

/// The newest version is half written, as by a disk that lies about its cache: the one before it counts.
#[test]
fn an_older_version_counts_where_the_newest_cannot_be_read() {
    let folder = folder("versions");
    let mut rig = rig(&folder, Some("A"));
    let store = rig.owner.memory.store().expect("it was given");
    for qmax in 0..15 {
        learn(&mut rig, 15_000 + qmax);
    }
    let files = store.files(chip());
    assert_eq!(files.len(), KEPT);
    let text = fs::read_to_string(&files[KEPT - 1].1).expect("text");
    fs::write(&files[KEPT - 1].1, &text[..text.len() / 2]).expect("it is written");
    lose_power(&mut rig);
    assert_eq!(words(&mut rig), (15_013, 77));
    fs::remove_dir_all(folder).expect("it is there");
}

#[test]
fn a_folder_that_cannot_be_written_is_said_once_and_tried_again() {
    let folder = folder("full");
    fs::write(&folder, "").expect("a file in place of the folder");
    let mut rig = rig(&folder, Some("A"));
    learn(&mut rig, 15_000);
    let error = rig.handle.published().last_error.to_string();
    assert!(error.contains("cannot save what the gauge has learned"), "{error}");
    fs::remove_file(&folder).expect("it is there");
    rig.poll_after(EVERY_SEALED);
    assert_eq!(&*rig.handle.published().last_error, "");
    lose_power(&mut rig);
    assert_eq!(words(&mut rig), (15_000, 77));
    fs::remove_dir_all(folder).expect("it is there");
}

/// The power of the gauge is lost at every transfer of a look at what it has learned.
#[test]
fn a_loss_of_power_while_it_is_looked_at_saves_no_defaults() {
    let folder = folder("cut");
    let mut number = 1;
    loop {
        let mut rig = rig(&folder, Some("A"));
        rig.sim.set_flash(QMAX.0, QMAX.1, &15_000_u16.to_be_bytes());
        rig.sim.set_flash(89, 0, &77_u16.to_be_bytes());
        rig.clock.sleep(EVERY_SEALED);
        let before = rig.transfers();
        rig.sim.set("fault", &format!("power-cut {number} 20")).expect("a fault");
        rig.poll_after(Duration::ZERO);
        let is_done = rig.transfers() - before < number;
        rig.sim.set("fault", "none").expect("a knob");
        for _ in 0..4 {
            rig.poll_after(Duration::from_secs(4));
        }
        // What was learned before is lost with the first cut; nothing else is ever there.
        for (_, path) in rig.owner.memory.store().expect("it was given").files(chip()) {
            let text = fs::read_to_string(path).expect("text");
            let is_right =
                ["15000", "16000"].iter().any(|qmax| text.contains(&format!("qmax-cell-0 = {qmax}")));
            assert!(is_right, "transfer {number}: {text}");
        }
        let _ = fs::remove_dir_all(&folder);
        if is_done {
            break;
        }
        number += 1;
    }
    assert!(number > 10, "{number}");
}

/// A part with a profile and a pack of that name, and two rows in different blocks of what it learns.
fn any(chip: &'static Chip, folder: &Path) -> (Rig, [(&'static Subclass, &'static Parameter, u16); 2]) {
    let rows =
        || chip.subclasses.iter().flat_map(|class| class.parameters.iter().map(move |row| (class, row)));
    let design = rows().find(|(_, row)| row.name == "Design Capacity").expect("each has one");
    let profile = Change::of_value(chip, design, &Value::Int(1200), false).expect("it fits").saved();
    let mut learned =
        rows().filter(|row| !row.1.unproven && chip.stays(*row) == Stays::Pack && row.1.kind.size() == 2);
    let (class, row) = learned.clone().find(|(_, row)| is_capacity(row)).expect("each has one");
    let block = |class: &Subclass, row: &Parameter| (class.id, row.offset / 32);
    let is_apart =
        |(other, at): &(&'static Subclass, &'static Parameter)| block(other, at) != block(class, row);
    let other = learned.find(is_apart).unwrap_or((class, row));
    let capacity = if row.unit == "mAh" { 1111 } else { 15_555 };
    let learned = Learned::new(folder.into(), "i2c-1-55".into(), Some("A".into()));
    let run = Run { profile: vec![profile], learned: Some(learned), ..Run::default() };
    let mut rig = Rig::of(chip.name, run);
    rig.start().expect("it answers");
    for pause in [INTERVAL, INTERVAL, FIRST, INTERVAL] {
        rig.poll_after(pause);
    }
    let second = if std::ptr::eq(other.1, row) { capacity } else { 77 };
    (rig, [(class, row, capacity), (other.0, other.1, second)])
}

/// The power of the gauge is lost before each transfer of a look at what it has learned, or, unnoticed, after it.
#[test]
fn regression_what_a_gauge_had_after_an_unnoticed_loss_was_saved_as_learned() {
    for chip in CHIPS.iter().copied().filter(|chip| chip.volatile.is_some()) {
        for fault in ["power-cut", "power-cut-after"] {
            let folder = folder(&format!("half-{}-{fault}", chip.name));
            for number in 1.. {
                let (mut rig, rows) = any(chip, &folder);
                for (class, row, value) in rows {
                    let (area, at) = match class.id {
                        FLAT => (0, usize::from(row.offset) - 0x9180),
                        id => (u16::from(id), usize::from(row.offset)),
                    };
                    rig.sim.set_flash(area, at, &value.to_be_bytes());
                }
                rig.clock.sleep(EVERY_SEALED);
                let before = rig.transfers();
                rig.sim.set("fault", &format!("{fault} {number} 1")).expect("a fault");
                rig.poll_after(Duration::ZERO);
                let is_done = rig.transfers() - before < number;
                rig.sim.set("fault", "none").expect("a knob");
                for _ in 0..4 {
                    rig.poll_after(Duration::from_secs(4));
                }
                rig.poll_after(EVERY_SEALED);
                let files = rig.owner.memory.store().expect("it was given").files(chip);
                for (_, path) in &files {
                    let image = Image::open(path, Some(chip)).expect("an image");
                    for (_, row, value) in rows {
                        let entry = image.entries.iter().find(|entry| std::ptr::eq(entry.parameter, row));
                        let saved = entry.map(|entry| entry.value.clone());
                        assert_eq!(
                            saved,
                            Some(Value::Int(value.into())),
                            "{} {fault} {number}: {} {:?}",
                            chip.name,
                            row.name,
                            files.len()
                        );
                    }
                }
                let _ = fs::remove_dir_all(&folder);
                if is_done {
                    assert_eq!(files.len(), 1, "{}: nothing was saved", chip.name);
                    break;
                }
            }
        }
    }
}

/// It would be the newest version, and hide what was learned before.
#[test]
fn regression_what_the_profile_has_was_saved_as_learned() {
    let folder = folder("profile");
    let mut rig = rig(&folder, None);
    rig.poll_after(EVERY_SEALED);
    assert!(kept(&folder).is_empty(), "nothing was learned");
    learn(&mut rig, 15_432);
    lose_power(&mut rig);
    assert_eq!(words(&mut rig), (16_000, 102));
    rig.poll_after(EVERY_SEALED);
    rig.ask(&op::LEARNED, Wish::Restore(None)).expect("a person knows");
    assert_eq!(words(&mut rig), (15_432, 77));
    fs::remove_dir_all(folder).expect("it is there");
}

/// Qmax is in parts of Design Capacity.
#[test]
fn regression_qmax_of_another_design_capacity_was_restored() {
    let folder = folder("design");
    let mut rig = rig(&folder, Some("A"));
    learn(&mut rig, 15_432);
    let file = kept(&folder).remove(0);
    let text = fs::read_to_string(&file).expect("text");
    fs::write(&file, text.replace("design-capacity = 1234", "design-capacity = 1235")).expect("written");
    lose_power(&mut rig);
    assert_eq!(words(&mut rig), (16_000, 102));
    let told = told(&mut rig);
    assert!(told.contains("Design Capacity of 1235 mAh, and the profile has 1234"), "{told}");
    fs::remove_dir_all(folder).expect("it is there");
}

#[test]
fn regression_a_capacity_of_zero_was_plausible_without_a_design_capacity() {
    let chip = Chip::by_name("bq27220").expect("it has a table");
    let rows = chip.subclasses.iter().flat_map(|class| class.parameters.iter().map(move |row| (class, row)));
    let row = rows.into_iter().find(|(_, row)| row.name == "Full Charge Capacity").expect("it has one");
    let name = chip.name_of(row);
    let (group, name) = name.split_once('/').expect("a group and a name");
    for (value, is_plausible) in [(0, false), (1000, true)] {
        let image = format!("chip = \"bq27220\"\n[{group}]\n{name} = {value}\n");
        let image = Image::parse(&image, Some(chip)).expect("an image");
        assert_eq!(implausible(&image, None).is_none(), is_plausible, "{value}");
    }
}

/// A gauge in a bay of the same host, whose pack shows its name.
fn in_bay(folder: &Path, bay: u32) -> Rig {
    let learned = Learned::new(folder.into(), format!("i2c-{bay}-55"), None);
    let mut rig = rig_with(learned.of_pack_anywhere(Some("A".into())));
    rig.poll_after(INTERVAL);
    rig
}

#[test]
fn regression_two_gauges_with_one_pack_name_got_what_the_other_had_learned() {
    let folder = folder("twice");
    let mut first = in_bay(&folder, 1);
    learn(&mut first, 15_432);
    let mut second = in_bay(&folder, 2);
    lose_power(&mut second);
    assert_eq!(words(&mut second), (16_000, 102));
    first.poll_after(INTERVAL);
    for (rig, qmax) in [(&mut first, 15_433), (&mut second, 15_434)] {
        let error = rig.handle.published().last_error.to_string();
        assert!(error.contains("another gauge has the pack A as well"), "{error}");
        learn(rig, qmax);
        assert!(told(rig).contains("another gauge has the pack A as well"));
        assert_eq!(kept(&folder).len(), 1, "saved under neither");
    }
    let asked = second.ask(&op::LEARNED, Wish::Restore(None));
    assert!(asked.expect_err("whose is it").to_string().contains("no pack is in two places"));
    drop(second);
    first.poll_after(EVERY_SEALED);
    assert_eq!((kept(&folder).len(), &*first.handle.published().last_error), (2, ""));
    fs::remove_dir_all(folder).expect("it is there");
}

/// The bay that it has left notices that later.
#[test]
fn a_pack_that_moves_to_another_bay_gets_back_what_it_has_learned() {
    let folder = folder("moves");
    let (mut left, mut new) = (in_bay(&folder, 1), in_bay(&folder, 3));
    new.owner.memory.doubt();
    learn(&mut left, 15_432);
    lose_power(&mut new);
    assert_eq!(words(&mut new), (16_000, 102), "it may be in the other one");
    left.sim.set("power", "off").expect("a knob");
    left.poll_after(INTERVAL);
    for _ in 0..2 {
        new.poll_after(INTERVAL);
    }
    assert_eq!(words(&mut new), (15_432, 77));
    fs::remove_dir_all(folder).expect("it is there");
}

#[test]
fn regression_hosts_with_one_folder_got_what_was_learned_on_the_other() {
    let folder = folder("hosts");
    let mut rig = rig(&folder, Some("A"));
    learn(&mut rig, 15_432);
    let theirs = kept(&folder).remove(0);
    let text = fs::read_to_string(&theirs).expect("text");
    let (line, rest) = text.split_once('\n').expect("lines");
    assert_eq!(line, format!("# {}", journal::Machine::this()));
    fs::write(&theirs, format!("# host bench 1 2\n{rest}")).expect("it is written");
    lose_power(&mut rig);
    assert_eq!(words(&mut rig), (16_000, 102));
    assert!(told(&mut rig).contains("nothing is kept that could be restored"));
    // Neither does it stand in the way, nor is it removed.
    learn(&mut rig, 15_432);
    assert_eq!(kept(&folder).len(), 2);
    rig.ask(&op::LEARNED, Wish::Forget).expect("it is removed");
    assert_eq!(kept(&folder), std::slice::from_ref(&theirs));
    // One of an earlier version says nothing.
    fs::write(&theirs, rest).expect("it is written");
    lose_power(&mut rig);
    assert_eq!(words(&mut rig), (15_432, 77));
    fs::remove_dir_all(folder).expect("it is there");
}

#[test]
fn regression_a_version_that_is_not_trusted_kept_the_same_from_being_saved() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = folder("untrusted");
    let mut rig = rig(&folder, Some("A"));
    learn(&mut rig, 15_432);
    let file = kept(&folder).remove(0);
    fs::set_permissions(&file, fs::Permissions::from_mode(0o666)).expect("it is mine");
    for _ in 0..3 {
        rig.poll_after(EVERY_SEALED);
        assert_eq!(kept(&folder).len(), 2, "once more, and no more");
    }
    lose_power(&mut rig);
    assert_eq!(words(&mut rig), (15_432, 77));
    fs::remove_dir_all(folder).expect("it is there");
}

#[test]
fn regression_a_version_that_others_may_write_was_believed() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = folder("planted");
    let mut rig = rig(&folder, Some("A"));
    learn(&mut rig, 15_432);
    let file = kept(&folder).remove(0);
    for path in [&file, &folder] {
        let mode = fs::metadata(path).expect("it is there").permissions().mode();
        fs::set_permissions(path, fs::Permissions::from_mode(mode | 0o022)).expect("it is mine");
        lose_power(&mut rig);
        assert_eq!(words(&mut rig), (16_000, 102), "{}", path.display());
        let told = told(&mut rig);
        assert!(told.contains("others may write to it"), "{told}");
        fs::set_permissions(path, fs::Permissions::from_mode(mode)).expect("it is mine");
    }
    lose_power(&mut rig);
    assert_eq!(words(&mut rig), (15_432, 77));
    fs::remove_dir_all(folder).expect("it is there");
}

#[test]
fn regression_a_pack_named_unnamed_got_what_others_had_learned() {
    let folder = folder("unnamed-name");
    let mut rig = rig(&folder, None);
    learn(&mut rig, 15_432);
    let mut rig = self::rig(&folder, Some("unnamed"));
    lose_power(&mut rig);
    assert_eq!(words(&mut rig), (16_000, 102));
    fs::remove_dir_all(folder).expect("it is there");
}

#[test]
fn a_host_that_is_on_for_two_minutes_saves_what_was_learned_while_it_was_off() {
    let folder = folder("short");
    let mut rig = rig(&folder, Some("A"));
    learn_now(&mut rig, 15_432);
    rig.poll_after(FIRST);
    lose_power(&mut rig);
    assert_eq!(words(&mut rig), (15_432, 77));
    fs::remove_dir_all(folder).expect("it is there");
}

#[test]
fn regression_a_gauge_that_is_polled_once_an_hour_had_its_first_look_after_an_hour() {
    let folder = folder("hourly");
    let mut rig = rig(&folder, Some("A"));
    let store = rig.owner.memory.store().expect("it was given");
    rig.owner.access.shared().publish(|published| published.interval = Duration::from_secs(3600));
    rig.poll_after(INTERVAL);
    for (qmax, limit) in [(15_432, FIRST), (15_433, EVERY_SEALED)] {
        learn_now(&mut rig, qmax);
        let (begun, before) = (rig.clock.now(), store.files(chip()).len());
        let polls = rig.transfers();
        while store.files(chip()).len() == before {
            // Nobody was asleep.
            rig.owner.turn.pretend_ended(None);
            let pause = rig.owner.take_turn(None).expect("nobody ends it");
            rig.clock.sleep(pause);
            let took = rig.clock.now() - begun;
            assert!(took < limit + Duration::from_secs(5), "{qmax}: {took:?}");
        }
        // It is not polled all the time for it.
        assert!(rig.transfers() - polls < 300, "{}", rig.transfers() - polls);
    }
    fs::remove_dir_all(folder).expect("it is there");
}

/// `cargo bench --bench restore` lets 1000 days pass.
#[test]
fn the_state_of_charge_is_nearer_to_the_truth_with_what_was_learned() {
    use super::super::rig::days::{Remedy, days};
    for name in ["bq27441-g1", "bq27427", "bq27621-g1"] {
        let chip = Chip::by_name(name).expect("it has a table");
        let folder = folder(&format!("days-{name}"));
        let remedies = [Remedy::Nothing, Remedy::Profile, Remedy::Learned(&folder)];
        let errors = remedies.map(|remedy| days(chip, 900..908, 7, remedy));
        let [nothing, profile, learned] = errors.map(|errors| (errors.quantile(0.5), errors.quantile(1.0)));
        let shown = format!("{name}: {nothing:?} {profile:?} {learned:?}");
        // It shows 0 % while a third of the charge is left.
        assert!(nothing.1 > 30.0 && learned.1 < 15.0 && learned.1 <= profile.1, "{shown}");
        assert!(learned.0 < 1.0 && learned.0 * 3.0 < nothing.0, "{shown}");
        let _ = fs::remove_dir_all(folder);
    }
}

/// Of some parts no document prints what they learn with.
#[test]
fn regression_a_part_without_printed_defaults_had_nothing_saved() {
    for chip in CHIPS.iter().copied().filter(|chip| chip.volatile.is_some()) {
        let folder = folder(&format!("part-{}", chip.name));
        let rows =
            || chip.subclasses.iter().flat_map(|class| class.parameters.iter().map(move |row| (class, row)));
        let named = |name: &str| rows().find(|(_, row)| row.name == name);
        let design = named("Design Capacity").expect("each has one");
        let profile = Change::of_value(chip, design, &Value::Int(1200), false).expect("it fits").saved();
        let (class, row) = named("Qmax Cell 0").or(named("Full Charge Capacity")).expect("each has one");
        let learned = Learned::new(folder.clone(), "i2c-1-55".into(), Some("A".into()));
        let run = Run { profile: vec![profile], learned: Some(learned), ..Run::default() };
        let mut rig = Rig::of(chip.name, run);
        rig.start().expect("it answers");
        for pause in [INTERVAL, INTERVAL, FIRST, INTERVAL] {
            rig.poll_after(pause);
        }
        let value = if row.unit == "mAh" { 1111_u16 } else { 15_555 }.to_be_bytes();
        let (area, at) = match class.id {
            // The first address of its data memory.
            FLAT => (0, usize::from(row.offset) - 0x9180),
            id => (u16::from(id), usize::from(row.offset)),
        };
        rig.sim.set_flash(area, at, &value);
        rig.poll_after(EVERY_SEALED);
        assert!(!kept(&folder).is_empty(), "{}: nothing was saved", chip.name);
        rig.sim.set_flash(area, at, &[0x04, 0x56]);
        lose_power(&mut rig);
        let index = chip.subclasses.iter().position(|other| std::ptr::eq(other, class)).expect("its own");
        rig.ask(&op::REFRESH, ()).expect("it answers");
        let read = rig.ask(&op::READ, vec![index]).expect("it is read");
        let begin = usize::from(row.offset - class.start());
        assert_eq!(read[0][begin..begin + 2], value, "{}", chip.name);
        fs::remove_dir_all(folder).expect("it is there");
    }
}

#[test]
fn every_part_with_ram_has_something_to_learn() {
    for chip in CHIPS.iter().filter(|chip| chip.volatile.is_some()) {
        assert!(!learning(chip).is_empty(), "{}", chip.name);
    }
}
