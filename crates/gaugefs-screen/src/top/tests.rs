// SPDX-License-Identifier: MIT

//! Screens drawn from folders of plain files, compared with the files in `tests/it/golden/top`.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;
use ratatui::style::Color;

use super::history::{Past, Quantity};
use super::model::{Action, Model};
use super::{draw, picture};
use gaugefs_client::sample::Sample;
use gaugefs_client::watch::{Learned, Order, Report, Seen};

/// 2026-01-01T12:00:00Z
const NOON: f64 = 1_767_268_800.0;
const ERROR: &str = "Cell Terminate Voltage: the value is outside 1000 to 3700 mV";

/// A folder with the files of a mounted gauge.
struct Tree(PathBuf);

impl Tree {
    fn new(name: &str, current_ua: i64) -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let (own, count) = (std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        let root = std::env::temp_dir().join(format!("gaugefs top {own} {count} {name}"));
        let tree = Self(root);
        let status = if current_ua < 0 { "Discharging" } else { "Charging" };
        tree.file(
            "uevent",
            &format!(
                "POWER_SUPPLY_NAME={name}\nPOWER_SUPPLY_TYPE=Battery\nPOWER_SUPPLY_STATUS={status}\n\
                 POWER_SUPPLY_PRESENT=1\nPOWER_SUPPLY_HEALTH=Good\nPOWER_SUPPLY_CAPACITY=60\n\
                 POWER_SUPPLY_VOLTAGE_NOW=3855000\nPOWER_SUPPLY_CURRENT_NOW={current_ua}\n\
                 POWER_SUPPLY_CHARGE_NOW=600000\nPOWER_SUPPLY_CHARGE_FULL=1000000\n\
                 POWER_SUPPLY_TEMP=251\nPOWER_SUPPLY_TIME_TO_EMPTY_NOW=4320\nPOWER_SUPPLY_CYCLE_COUNT=12\n\
                 POWER_SUPPLY_STATE_OF_HEALTH=97\nPOWER_SUPPLY_MODEL_NAME=bq34z100-G1\n"
            ),
        );
        for (name, text) in [
            ("age_ms", "400\n"),
            ("seal", "sealed\n"),
            ("last_error", ""),
            ("poll_interval", "30\n"),
            ("control_status", "FAS SS VOK QEN\n"),
            ("flags", "CHG OCVTAKEN DSG\n"),
            ("flags_b", "\n"),
            ("pack_configuration", "SLEEP\n"),
            ("registers/flags", "257\n"),
            ("registers/flags_b", "0\n"),
            ("registers/pack_configuration", "32\n"),
            ("registers/passed_charge", "-325\n"),
            ("registers/true_fcc", "1000\n"),
            ("registers/voltage", "3855\n"),
            ("registers/grid_number", "5\n"),
        ] {
            tree.file(&format!("gauge/{name}"), text);
        }
        tree.file("gauge/registers/current", &format!("{}\n", current_ua / 1000));
        tree
    }

    fn file(&self, name: &str, text: &str) {
        let path = self.0.join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("a temporary folder");
        fs::write(path, text).expect("a file");
    }

    /// A sample whose poll was at `time`.
    fn sample(&self, time: f64) -> Sample {
        let mut sample = Sample::read(&self.0).expect("a gauge");
        sample.time = jiff::Timestamp::from_millisecond((time * 1000.0) as i64).expect("a time");
        sample
    }
}

impl Drop for Tree {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn report(gauge: &str, seen: Seen) -> Report {
    Report { root: 0, gauge: Path::new("/run/gauges").join(gauge), left: 0, seen }
}

fn sample(sample: &Sample) -> Seen {
    Seen::Sample(Box::new(sample.clone()))
}

/// Two gauges: one was discharged for four minutes and absent for one of them; the other is charging.
fn model(colour: bool) -> Model {
    let mut model = Model::new(1.0, colour);
    model.add_mounts(&[PathBuf::from("/run/gauges")], NOON);
    let (first, second) = (Tree::new("PACK-A", -500_000), Tree::new("PACK-B", 250_000));
    let seen = first.sample(NOON);
    for at in 0..=240u32 {
        let time = NOON - 240.0 + f64::from(at);
        let mut seen = seen.clone();
        seen.time = jiff::Timestamp::from_second(time as i64).expect("a time");
        seen.moment = seen.moment.map(|moment| moment.later(Duration::from_secs(at.into())));
        let voltage = 3_900_000 - i64::from(at) * 187;
        for (name, value) in &mut seen.attributes {
            match name.as_str() {
                "voltage_now" => *value = voltage.to_string(),
                "present" if (100..160).contains(&at) => *value = "0".into(),
                _ => {}
            }
        }
        if at == 0 {
            seen.words
                .iter_mut()
                .for_each(|(_, bits)| *bits = bits.replace(" QEN", "").replace("SS", "SS RUP_DIS"));
        }
        model.update(report("PACK-A", sample(&seen)), time);
    }
    model.update(report("PACK-B", sample(&second.sample(NOON))), NOON);
    model
}

fn press(model: &mut Model, key: char) -> Action {
    model.key(KeyEvent::new(KeyCode::Char(key), KeyModifiers::NONE), NOON)
}

fn drawn(model: &Model, width: u16, height: u16, now: f64) -> Buffer {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).expect("a screen");
    terminal.draw(|frame| draw::screen(frame, model, now)).expect("drawn");
    terminal.backend().buffer().clone()
}

fn text(buffer: &Buffer) -> String {
    let rows = buffer.content().chunks(usize::from(buffer.area.width));
    let row = |cells: &[ratatui::buffer::Cell]| cells.iter().map(|cell| cell.symbol()).collect::<String>();
    rows.map(|cells| row(cells).trim_end().to_string() + "\n").collect()
}

#[track_caller]
fn golden(name: &str, now: &str) {
    matches(&Path::new("tests/it/golden/top").join(name), now);
}

/// Compares with a file of the repository, or writes it if GAUGEFS_GOLDEN is `write`. The package on crates.io lacks
/// these files.
#[track_caller]
pub(crate) fn matches(file: &Path, now: &str) {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    if !repository.join("docs").exists() {
        eprintln!("SKIPPED: there is no {}", file.display());
        return;
    }
    let path = repository.join(file);
    if std::env::var_os("GAUGEFS_GOLDEN").is_some_and(|what| what == "write") {
        fs::write(&path, now).expect("the golden file");
    }
    let then = fs::read_to_string(&path).unwrap_or_default();
    assert!(
        now == then,
        "{}: the screen differs; if that is intended, GAUGEFS_GOLDEN=write\n{now}",
        path.display()
    );
}

#[test]
fn screens_of_all_sizes() {
    let mut model = model(true);
    for (width, height) in [(80, 24), (40, 10), (200, 50)] {
        golden(&format!("{width}x{height}"), &text(&drawn(&model, width, height, NOON)));
    }
    press(&mut model, 'l');
    let learned = |name, value: &str, unit| Learned { name, value: value.into(), unit };
    let before = vec![learned("Qmax Cell 0", "1000", "mAh"), learned("Update Status", "0x04", "Num")];
    let after = vec![learned("Qmax Cell 0", "1012", "mAh"), learned("Update Status", "0x05", "Num")];
    golden("80x24-learning-sealed", &text(&drawn(&model, 80, 24, NOON)));
    model.update(report("PACK-A", Seen::Learned(Ok(before))), NOON - 60.0);
    model.update(report("PACK-A", Seen::Learned(Ok(after))), NOON);
    let mut later = Tree::new("PACK-A", -500_000).sample(NOON + 5.0);
    later.moment = model.gauge().and_then(|gauge| gauge.shown.as_ref()?.moment);
    model.update(report("PACK-A", sample(&later)), NOON + 6.0);
    let learning = text(&drawn(&model, 80, 24, NOON + 7.0));
    assert!(
        learning.contains("discharging for at least") && learning.contains("qualified since"),
        "{learning}"
    );
    golden("80x24-learning", &learning);
    golden("200x50-learning", &text(&drawn(&model, 200, 50, NOON + 7.0)));
    golden("40x10-learning", &text(&drawn(&model, 40, 10, NOON + 7.0)));
    press(&mut model, '?');
    golden("80x24-help", &text(&drawn(&model, 80, 24, NOON)));
}

/// No size makes it panic, and it never draws beyond the screen.
#[test]
fn screens_of_odd_sizes() {
    let mut model = model(true);
    for keys in ["", "l", "?"] {
        for key in keys.chars() {
            press(&mut model, key);
        }
        for (width, height) in [(1, 1), (2, 3), (19, 4), (41, 7), (300, 5), (10, 90)] {
            assert_eq!(drawn(&model, width, height, NOON).area.width, width);
        }
    }
}

#[test]
fn the_screen_shows_what_is_wrong() {
    let mut model = model(true);
    let tree = Tree::new("PACK-A", -500_000);
    tree.file("gauge/last_error", &format!("{ERROR}\n"));
    model.update(report("PACK-A", sample(&tree.sample(NOON))), NOON);
    let screen = text(&drawn(&model, 80, 24, NOON));
    assert!(screen.contains(&format!("last error: {ERROR}")), "{screen}");

    // The mount hangs.
    let screen = text(&drawn(&model, 80, 24, NOON + 20.0));
    assert!(screen.contains("no answer for 20 s"), "{screen}");
    // Its daemon was killed.
    let why = "its daemon has died; remove the mount with: gaugefs umount /run/gauges";
    let gone = Report { root: 0, gauge: "/run/gauges".into(), left: 0, seen: Seen::Trouble(why.into()) };
    model.update(gone, NOON + 21.0);
    let screen = text(&drawn(&model, 80, 24, NOON + 21.0));
    assert!(screen.contains("gone") && screen.contains("gaugefs umount"), "{screen}");
    assert!(!screen.contains("3.855") && !screen.contains("Discharging"), "{screen}");
    // Only the gauge is absent.
    let tree = Tree::new("PACK-A", -500_000);
    tree.file("uevent", "POWER_SUPPLY_NAME=PACK-A\nPOWER_SUPPLY_TYPE=Battery\nPOWER_SUPPLY_PRESENT=0\n");
    fs::remove_file(tree.0.join("gauge/age_ms")).expect("a file");
    model.update(report("PACK-A", sample(&tree.sample(NOON + 22.0))), NOON + 22.0);
    let screen = text(&drawn(&model, 80, 24, NOON + 22.0));
    assert!(screen.contains("absent"), "{screen}");
}

#[test]
fn data_flash_is_read_for_a_key_or_while_unsealed() {
    let mut model = model(true);
    let orders = |model: &mut Model, now| {
        let orders = model.orders(now);
        orders.iter().filter(|(_, order)| matches!(order, Order::ReadLearned(_))).count()
    };
    assert_eq!(orders(&mut model, NOON), 0);
    press(&mut model, 'l');
    assert_eq!(orders(&mut model, NOON), 0, "it is sealed");
    press(&mut model, 'd');
    assert_eq!(orders(&mut model, NOON), 1);
    assert_eq!(orders(&mut model, NOON + 600.0), 0, "once");

    let tree = Tree::new("PACK-A", -500_000);
    tree.file("gauge/seal", "unsealed\n");
    model.update(report("PACK-A", sample(&tree.sample(NOON))), NOON);
    assert_eq!(orders(&mut model, NOON), 1);
    assert_eq!(orders(&mut model, NOON + 59.0), 0);
    assert_eq!(orders(&mut model, NOON + 61.0), 1, "a minute later");
    press(&mut model, 'l');
    assert_eq!(orders(&mut model, NOON + 200.0), 0, "the learned values are not shown");

    // A user who may not read the seal state does not know that it is unsealed.
    press(&mut model, 'l');
    fs::remove_file(tree.0.join("gauge/seal")).expect("a file");
    model.update(report("PACK-A", sample(&tree.sample(NOON))), NOON);
    assert_eq!(orders(&mut model, NOON + 400.0), 0);
}

#[test]
fn a_pause_freezes_the_screen_and_loses_nothing() {
    let mut model = model(true);
    let before = text(&drawn(&model, 80, 24, NOON));
    press(&mut model, 'p');
    let tree = Tree::new("PACK-A", -900_000);
    model.update(report("PACK-A", sample(&tree.sample(NOON + 30.0))), NOON + 30.0);
    let paused = text(&drawn(&model, 80, 24, NOON + 31.0));
    assert_eq!(paused.replace("  paused", "        "), before);
    press(&mut model, 'p');
    assert!(text(&drawn(&model, 80, 24, NOON + 31.0)).contains("-0.900"));
}

#[test]
fn keys_do_what_the_last_line_says() {
    let mut model = model(true);
    for (key, name) in
        [('i', "current in A"), ('c', "capacity in %"), ('t', "temperature in °C"), ('v', "voltage in V")]
    {
        press(&mut model, key);
        assert!(text(&drawn(&model, 80, 24, NOON)).contains(&format!("{name}, last 5 min")));
    }
    press(&mut model, '+');
    assert!(text(&drawn(&model, 80, 24, NOON)).contains("last 15 min"));
    for _ in 0..20 {
        press(&mut model, '-');
    }
    assert!(text(&drawn(&model, 80, 24, NOON)).contains("last 1 min"));
    let mut key = |code, modifiers| model.key(KeyEvent::new(code, modifiers), NOON);
    assert_eq!(key(KeyCode::Tab, KeyModifiers::NONE), Action::Nothing);
    assert_eq!(key(KeyCode::Char('z'), KeyModifiers::CONTROL), Action::Suspend);
    assert_eq!(key(KeyCode::Char('c'), KeyModifiers::CONTROL), Action::Quit);
    assert_eq!(key(KeyCode::Char('q'), KeyModifiers::NONE), Action::Quit);
    assert_eq!(model.gauge().expect("a gauge").name(), "PACK-B");
}

#[test]
fn without_colours_there_are_none() {
    let colours = |model: &Model| {
        let buffer = drawn(model, 80, 24, NOON);
        buffer.content().iter().any(|cell| cell.fg != Color::Reset || cell.bg != Color::Reset)
    };
    assert!(colours(&model(true)));
    assert!(!colours(&model(false)));
}

/// Long names, large numbers and many gauges: the columns never touch, and the least important go first.
#[test]
fn columns_do_not_touch() {
    let mut model = Model::new(1.0, true);
    model.add_mounts(&[PathBuf::from("/run/gauges")], NOON);
    let packs = [
        ("BAT0", "bq34z100-R2", -123_456_000, 51_999_000),
        ("A-LONG-NAME-OF-A-PACK", "bq27621-G1", 5_000, 3_700_000),
    ];
    for number in 0..12 {
        let (name, part, current, voltage) = packs[number % 2];
        let name = if number < 2 { name.to_string() } else { format!("PACK{number}") };
        let mut seen = Tree::new(&name, current).sample(NOON);
        for (key, value) in &mut seen.attributes {
            match key.as_str() {
                "model_name" => *value = part.into(),
                "voltage_now" => *value = i64::to_string(&voltage),
                "charge_now" => *value = "1234567000".into(),
                "charge_full" => *value = "2000000000".into(),
                "capacity" => *value = "100".into(),
                "temp" => *value = "-395".into(),
                _ => {}
            }
        }
        seen.seal = Some("full-access".into());
        model.update(report(&name, sample(&seen)), NOON);
    }
    let values = [
        "STATUS",
        "Discharging",
        "Charging",
        "51.999",
        "-123.456",
        "0.005",
        "1234.567/2000.000",
        "100",
        "-39.5",
        "bq34z100-R2",
        "1:12 h to empty",
        "full-access",
    ];
    for (width, height) in [(30, 10), (40, 12), (60, 16), (80, 24), (100, 30), (132, 44), (200, 60)] {
        let screen = text(&drawn(&model, width, height, NOON));
        golden(&format!("{width}x{height}-many"), &screen);
        let table = screen.lines().skip(1).take_while(|line| !line.starts_with("polled"));
        for line in table {
            for cell in line.split("  ").map(str::trim).filter(|cell| !cell.is_empty()).skip(1) {
                let is_bar = cell.chars().all(|letter| "\u{2588}\u{2591}".contains(letter));
                let is_title = is_bar
                    || ["MODEL", "V", "A", "Ah", "CHARGE", "%", "°C", "TIME", "SEAL", "3.700", "bq27621-G1"]
                        .contains(&cell);
                assert!(is_title || values.contains(&cell), "{width}x{height}: `{cell}` in {screen}");
            }
        }
        let has = |word: &str| screen.contains(word);
        assert!(has("STATUS") && has("Discharging"), "{screen}");
        assert!(width < 200 || (has("full-access") && has("1234.567/2000.000")), "{screen}");
    }
}

/// A row of a history: name of the gauge, seconds since 1970, and the fields by their titles.
type Recorded = (String, f64, Vec<(String, String)>);

/// What `tests/record` has recorded of three gauges.
fn recorded() -> Vec<Recorded> {
    let text = include_str!("recorded.csv");
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let titles = reader.headers().expect("a header").clone();
    let row = |record: csv::StringRecord| {
        let time: jiff::Timestamp = record[0].parse().expect("a time");
        let fields = titles.iter().map(str::to_string).zip(record.iter().map(str::to_string));
        (record[1].to_string(), time.as_millisecond() as f64 / 1000.0, fields.collect())
    };
    reader.records().map(|record| row(record.expect("a row"))).collect()
}

/// The sample behind a row.
fn sampled(seen: &Sample, time: f64, passed: f64, fields: &[(String, String)]) -> Sample {
    let mut seen = seen.clone();
    seen.time = jiff::Timestamp::from_millisecond((time * 1000.0) as i64).expect("a time");
    seen.moment = seen.moment.map(|moment| moment.later(Duration::from_secs(passed as u64)));
    let field =
        |title: &str| fields.iter().find(|(found, _)| found == title).map_or("", |(_, text)| text.as_str());
    let scaled = |title: &str, scale: f64| {
        field(title).parse::<f64>().map(|value| ((value * scale).round() as i64).to_string())
    };
    let attributes = [
        ("voltage_now", scaled("voltage (V)", 1e6)),
        ("current_now", scaled("current (A)", 1e6)),
        ("charge_now", scaled("charge (Ah)", 1e6)),
        ("charge_full", scaled("full charge (Ah)", 1e6)),
        ("capacity", scaled("capacity (%)", 1.0)),
        ("temp", scaled("temperature (°C)", 10.0)),
        ("time_to_empty_now", scaled("time to empty (s)", 1.0)),
        ("time_to_full_now", scaled("time to full (s)", 1.0)),
        ("cycle_count", scaled("cycle count", 1.0)),
        ("state_of_health", scaled("state of health (%)", 1.0)),
    ];
    let attributes = attributes.into_iter().filter_map(|(name, value)| Some((name.to_string(), value.ok()?)));
    let flags = |flag: &str| field("flags").split(' ').any(|set| set == flag);
    let level = if flags("SOCF") { "Critical" } else { "Low" };
    let level = if flags("SOCF") || flags("SOC1") { level } else { "Normal" };
    let words = [
        ("present", "1"),
        ("status", field("status")),
        ("model_name", field("part")),
        ("capacity_level", level),
    ];
    seen.attributes = attributes.chain(words.map(|(name, value)| (name.into(), value.into()))).collect();
    let words = [("control_status", "control status"), ("flags", "flags"), ("flags_b", "flags b")];
    let words = words.map(|(name, title)| (name.to_string(), field(title).to_string()));
    seen.words = words.into_iter().filter(|(name, bits)| name != "flags_b" || !bits.is_empty()).collect();
    seen.seal = Some(field("seal").into());
    seen
}

/// docs/top.svg, the README's picture: an hour of three simulated packs, with a rest of one of them. The first half is
/// from a log.
#[test]
fn the_picture_in_docs_is_what_top_draws() {
    let rows = recorded();
    let (first, last) = (rows[0].1, rows.iter().map(|row| row.1).fold(0.0, f64::max));
    let begin = (first + last) / 2.0;
    let mut model = Model::new(1.0, true).with(past(include_str!("recorded.csv")));
    model.add_mounts(&[PathBuf::from("/run/gauges")], last);
    let seen = Tree::new("PACK-A", -850_000).sample(NOON);
    for (name, time, fields) in rows.iter().filter(|(_, time, _)| *time > begin) {
        model.update(report(name, sample(&sampled(&seen, *time, time - first, fields))), last);
    }
    press(&mut model, '+');
    press(&mut model, '+');
    let screen = drawn(&model, 112, 34, last + 1.0);
    matches(Path::new("docs/top.svg"), &picture::svg(&screen));
    for shown in ["capacity in %", "voltage in V", "current in A", "temperature in °C", "charge low"] {
        assert!(text(&screen).contains(shown), "{shown}");
    }
}

/// What a log has, as `top` reads it.
fn past(log: &str) -> Vec<Past> {
    let file = std::env::temp_dir().join(format!("gaugefs-log-{}-{}", std::process::id(), log.len()));
    fs::write(&file, log).expect("a file");
    let series = crate::plot::recorded(&file).expect("a log");
    fs::remove_file(&file).expect("it is there");
    Past::of(series)
}

#[test]
fn a_large_screen_shows_the_quantities_together() {
    let mut model = model(true);
    let titles = |model: &Model, width, height| {
        let screen = text(&drawn(model, width, height, NOON));
        let quantities = ["capacity in %", "voltage in V", "current in A", "temperature in °C"];
        quantities.map(|title| usize::from(screen.contains(title)))
    };
    let (all, voltage) = ([1, 1, 1, 1], [0, 1, 0, 0]);
    for (width, height, shown) in
        [(200, 50, all), (102, 30, all), (60, 50, all), (80, 24, voltage), (102, 20, voltage)]
    {
        assert_eq!(titles(&model, width, height), shown, "{width} x {height}");
    }
    press(&mut model, 'i');
    assert_eq!(titles(&model, 200, 50), [0, 0, 1, 0]);
    press(&mut model, 'a');
    assert_eq!(titles(&model, 200, 50), all);
    // The learned values beside them leave room for one column.
    press(&mut model, 'l');
    assert_eq!(titles(&model, 200, 50), all);
}

#[test]
fn the_charge_is_a_bar_whose_colour_is_what_the_gauge_says_of_it() {
    let show = |level: &str, capacity: &str, colour: bool| {
        let mut model = model(colour);
        let mut seen = Tree::new("PACK-A", -500_000).sample(NOON + 1.0);
        seen.attributes.retain(|(name, _)| name != "capacity");
        seen.attributes.push(("capacity".into(), capacity.into()));
        seen.attributes.push(("capacity_level".into(), level.into()));
        model.update(report("PACK-A", sample(&seen)), NOON + 1.0);
        drawn(&model, 200, 50, NOON + 1.0)
    };
    for (level, capacity, blocks, colour, words) in [
        ("Normal", "60", 12, Color::Green, None),
        ("Low", "12", 2, Color::Yellow, Some("charge low")),
        ("Critical", "1", 1, Color::Red, Some("charge critical")),
        ("Critical", "0", 0, Color::Red, Some("charge critical")),
        ("Unknown", "60", 12, Color::Reset, None),
    ] {
        let screen = show(level, capacity, true);
        // The selected gauge's row.
        let row: Vec<_> = (0..screen.area.width).map(|column| &screen[(column, 2)]).collect();
        let bar = || row.iter().filter(|cell| ["\u{2588}", "\u{2591}"].contains(&cell.symbol()));
        assert_eq!((bar().count(), bar().filter(|cell| cell.symbol() == "\u{2588}").count()), (20, blocks));
        assert!(bar().all(|cell| cell.fg == colour), "{level}");
        let plain = show(level, capacity, false);
        assert!(plain.content().iter().all(|cell| cell.fg == Color::Reset && cell.bg == Color::Reset));
        let said = ["charge low", "charge critical"].into_iter().find(|said| text(&plain).contains(said));
        assert_eq!(said, words, "{level}");
    }
}

#[test]
fn the_charts_begin_with_what_a_log_has_of_the_time_before() {
    let row = |name: &str, minutes: i64, voltage: f64| {
        let time = jiff::Timestamp::from_second(NOON as i64 + 60 * minutes).expect("a time");
        format!("{time},{name},{voltage},,,\n")
    };
    let head = "time (UTC),gauge,voltage (V),current (A),capacity (%),temperature (°C)\n";
    // It goes on while top is there.
    let log: String = (-30..0).map(|at| row("PACK-A", at, 4.2) + &row("PACK-B", at, 3.0)).collect();
    let lines = |model: &Model, name: &str| {
        let gauge = model.gauges.iter().find(|gauge| gauge.name() == name).expect("it is there");
        gauge.history.lines(model.past(gauge), Quantity::VOLTAGE, NOON, 3600.0, 4000)
    };
    let model = || model(true).with(past(&format!("{head}{log}")));
    let shown = lines(&model(), "PACK-A");
    // The polls of four minutes, with an absence, go on where the log was.
    assert_eq!(shown.len(), 2, "{shown:?}");
    assert_eq!(shown[0].first().map(|(time, value)| (time.round(), *value)), Some((-1800.0, 4.2)));
    let logged = shown.iter().flatten().filter(|(_, value)| *value == 4.2);
    assert!(logged.clone().count() == 26 && logged.clone().all(|(time, _)| *time < -240.0), "{shown:?}");
    assert!(text(&drawn(&model(), 80, 24, NOON)).contains("voltage in V"));
    // The log does not say to which mount its gauge belongs.
    let mut two = model();
    two.add_mounts(&[PathBuf::from("/run/gauges"), PathBuf::from("/run/other")], NOON);
    let other = Tree::new("PACK-A", -500_000).sample(NOON);
    two.update(Report { root: 1, gauge: "/run/other/PACK-A".into(), left: 0, seen: sample(&other) }, NOON);
    assert!(lines(&two, "PACK-A").iter().flatten().all(|(_, value)| *value != 4.2));
    assert!(lines(&two, "PACK-B").iter().flatten().any(|(_, value)| *value == 3.0));
    // The battery's time was faster.
    let mut fast = model();
    let mut seen = Tree::new("PACK-B", 250_000).sample(NOON + 1.0);
    seen.simulated = Some((seen.time, 60.0));
    fast.update(report("PACK-B", sample(&seen)), NOON + 1.0);
    assert!(lines(&fast, "PACK-B").iter().flatten().all(|(_, value)| *value != 3.0));
}
