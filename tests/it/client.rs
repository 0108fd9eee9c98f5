// SPDX-License-Identifier: MIT

//! The crate `gaugefs-client` on mounted simulated gauges.

use std::error::Error as _;
use std::time::{Duration, Instant};

use gaugefs_client::condition::Condition;
use gaugefs_client::watch::{Order, Seen, Watch};
use gaugefs_client::{Decision, Gauge, follow, within};
use nix::errno::Errno;
use nix::sys::signal::Signal;

use crate::room::{CHIP, Folder, Foreground, LONG, can_mount, gaugefs, read};
use crate::terminate_voltage;

const NAME: &str = "Cell Terminate Voltage";

/// A simulated gauge, mounted, and its folder.
fn mounted(folder: &Folder, more: &[&str]) -> Gauge {
    let at = folder.file("m");
    gaugefs(&[&["mount", "--sim", CHIP, "--poll", "0.5", &at], more].concat()).done();
    Gauge::open(&at).expect("the only gauge there")
}

#[test]
fn a_program_reads_values_with_their_units() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let gauge = mounted(&folder, &[]);
    assert_eq!(gauge.name(), "BAT0");
    let value = |file: &str| gauge.value(file).expect(file);
    let voltage = value("voltage_now");
    assert_eq!(voltage.unit, "uV");
    assert!((2.0..70.0).contains(&voltage.in_unit("V").expect("a voltage")), "{voltage}");
    assert_eq!(value("gauge/registers/voltage").unit, "mV");
    assert_eq!(value("gauge/poll_interval").in_unit("ms"), Some(500.0));
    assert_eq!((value("status").number(), value("status").unit), (None, ""));
    let sample = gauge.sample().expect("a sample");
    assert!(sample.present() && sample.attribute("model_name") == Some("bq34z100-G1"));
    assert!(Gauge::find().expect("mounts").contains(&gauge));

    let error = gauge.value("voltage_then").expect_err("there is no such file");
    assert_eq!((error.errno(), error.last_error()), (Some(Errno::ENOENT as i32), None));
    assert!(error.source().is_some_and(|source| source.is::<std::io::Error>()), "{error:?}");
    let error = Gauge::open(folder.file("nothing")).expect_err("it does not exist");
    assert_eq!(error.errno(), Some(Errno::ENOENT as i32));
    assert!(error.to_string().contains("not a mounted gauge: it does not exist"), "{error}");
    // As `main` prints it.
    assert_eq!(format!("{error:?}"), error.to_string());
}

#[test]
fn a_program_writes_parameters_by_name_with_units_and_all_of_them_or_none() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let gauge = mounted(&folder, &[]);
    let shown = |name: &str| gauge.parameter(name).expect(name).to_string();
    gauge.set(NAME, "3100 mV").expect("it is written");
    assert_eq!((shown(NAME), shown("80/53")), ("3100 mV".into(), "3100 mV".into()));

    let mut transaction = gauge.transaction().expect("a part that is known");
    transaction.set(NAME, "3.2 V").expect("a voltage").set("design-capacity", "2200mAh").expect("a charge");
    let error = transaction.set("80/53", "3.3V").expect_err("it is there already").to_string();
    assert!(error.contains("it is given twice"), "{error}");
    let changed = transaction.commit().expect("they are written");
    assert_eq!(changed.len(), 2);
    assert_eq!((&*changed[0].old, &*changed[0].new, changed[0].unit), ("3100", "3200", "mV"));
    assert_eq!(shown("design-capacity"), "2200 mAh");

    // What is refused before any file is touched has no errno, and says why.
    let error = gauge.set(NAME, "9 V").expect_err("out of range");
    assert_eq!((error.errno(), error.last_error()), (None, None));
    let source = error.source().expect("what is wrong with the value");
    assert!(
        source.is::<ti_gauge::error::Error>() && source.to_string().contains("1000 to 3700 mV"),
        "{source}"
    );
    // What the daemon refuses has the errno and its text.
    let error = gauge.send("df/80/53", b"9000\n").expect_err("out of range");
    assert_eq!(error.errno(), Some(Errno::ERANGE as i32));
    assert!(error.last_error().is_some_and(|text| text.contains("1000 to 3700 mV")), "{error}");
    let facts = error.facts().expect("the daemon's");
    assert!(facts.contains(r#""greatest":3700"#) && facts.contains(r#""place":"80/53""#), "{facts}");
    assert_eq!(shown(NAME), "3200 mV");

    assert_eq!(gauge.unsettled().expect("it can be asked"), None);
    let error = gauge.settle(Decision::Undo, None).expect_err("there is nothing to undo");
    assert!(error.errno().is_some() && error.last_error().is_some(), "{error:?}");
}

#[test]
fn a_program_follows_changes_and_orders_a_poll() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let gauge = mounted(&folder, &[]);
    let hot: Condition = "temp>60C && gauge/registers/voltage>1V".parse().expect("a condition");
    let mut follow = gauge.follow(hot.names()).expect("a thread");
    gauge.send("sim/temperature", b"650\n").expect("a knob");
    let begun = Instant::now();
    loop {
        let texts = follow.next(Some(LONG)).expect("a poll");
        // On a busy machine the daemon may be silent for a while.
        if texts.as_ref().is_ok_and(|texts| hot.holds(Some(texts)) == Some(true)) {
            break;
        }
        assert!(begun.elapsed() < LONG, "{texts:?}");
    }

    let watch = Watch::start(Some(gauge.folder()), None).expect("a thread");
    let limit = LONG;
    let report = watch.next(limit).expect("a report");
    assert!(matches!(report.seen, Seen::Sample(_)) && report.gauge == gauge.folder());
    watch.order(report.root, Order::ReadLearned(report.gauge));
    let learned = |seen| if let Seen::Learned(learned) = seen { Some(learned) } else { None };
    let learned = std::iter::from_fn(|| watch.next(limit)).find_map(|report| learned(report.seen));
    let learned = learned.expect("an answer").expect("its values");
    assert!(learned.iter().any(|row| row.name == "Update Status"), "{learned:?}");
}

#[test]
fn a_program_is_not_held_up_by_a_daemon_that_hangs() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let daemon = Foreground::new(&at, &["--poll", "0.5"]);
    let gauge = Gauge::open(&at).expect("the only gauge there");
    let mut follow = gauge.follow(["gauge/flags"]).expect("a thread");
    follow.next(None).expect("it has no end").expect("a gauge");
    daemon.send(Signal::SIGSTOP);
    let silent = std::iter::from_fn(|| follow.next(None)).find_map(Result::err);
    assert_eq!(silent.as_deref(), Some(follow::SILENT));
    let stopped = gauge.clone();
    let error =
        within(Duration::from_millis(200), move || stopped.text("gauge/age_ms")).expect_err("it hangs");
    assert_eq!(error.errno(), Some(Errno::ETIMEDOUT as i32));
    daemon.send(Signal::SIGCONT);
    // Its values may count as too old until it has polled.
    std::iter::from_fn(|| follow.next(None)).find_map(Result::ok).expect("a gauge");

    drop(daemon);
    let error = gauge.text("gauge/age_ms").expect_err("its daemon is gone");
    assert_eq!(error.errno(), Some(Errno::ENOTCONN as i32));
    assert!(
        error.to_string().contains("its daemon has died; remove the mount with: gaugefs umount"),
        "{error}"
    );
    gaugefs(&["umount", &at]).done();
}

#[test]
fn the_example_of_the_client_writes_a_mounted_gauge() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let gauge = mounted(&folder, &[]);
    let path = gauge.folder().display().to_string();
    terminate_voltage::run([path.clone(), "3.1V".into()].into_iter()).expect("it is written");
    assert_eq!(read(&path, "df/80/53"), "3100");
    let error = terminate_voltage::run([folder.file("nothing")].into_iter()).expect_err("there is none");
    assert!(error.to_string().contains("not a mounted gauge"), "{error}");
}
