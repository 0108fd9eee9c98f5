// SPDX-License-Identifier: MIT

//! `gaugefs calibrate` and `gaugefs bringup` on a mounted gauge.

use std::fs;
use std::path::Path;

use crate::room::{CHIP, Folder, can_mount, gaugefs, in_real_time, read, within};

#[test]
fn a_mounted_gauge_is_calibrated_and_a_new_board_is_set_up() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let gauge = format!("{at}/BAT0");
    let set = |knob: &str, text: &str| {
        fs::write(Path::new(&gauge).join("sim").join(knob), text).expect("a knob");
    };
    gaugefs(&["mount", "--sim", CHIP, "--state-dir", &folder.file("state"), &at]).done();
    set("temperature_error", "30");
    let told = gaugefs(&["calibrate", &gauge, "temperature", "--actual", "25"]).done();
    let lines: Vec<&str> = told.lines().collect();
    assert!(lines.len() == 3 && lines[0].starts_with("reading Temperature()"), "{told}");
    assert!(lines[1].starts_with("writing Ext Temp Offset = -30"), "{told}");
    assert_eq!(read(&gauge, "df/104/12"), "-30");
    let shown = read(&gauge, "gauge/calibration");
    let (name, steps) = shown.split_once('\n').expect("the name of the request");
    assert!(name.starts_with('#') && name.len() == 17, "{shown}");
    assert_eq!(format!("{steps}\n"), told);
    // Whoever gives no name finds none.
    fs::write(Path::new(&gauge).join("gauge/calibrate"), "leave\n").expect("no fault");
    assert!(!read(&gauge, "gauge/calibration").contains('#'));

    let refused = gaugefs(&["calibrate", &gauge, "current", "--actual", "20mA"]);
    refused.failed(&["Current()", "100 mA"]);
    let refused = gaugefs(&["calibrate", &gauge, "voltage", "--actual", "12600"]);
    assert!(refused.err.contains("gaugefs bringup") && refused.code == Some(1), "{}", refused.err);
    assert_eq!(gaugefs(&["calibrate", &gauge, "leave"]).done().lines().count(), 2);

    set("cells", "7");
    set("board_divider", "33000");
    let bring_up = ["bringup", &gauge, "--cells", "7", "--divider", "33000", "--voltage-now"];
    let wrong = gaugefs(&[&bring_up[..], &["20V"]].concat());
    assert!(wrong.err.contains("is the divider right") && wrong.code == Some(1), "{}", wrong.err);
    assert_eq!(read(&gauge, "df/104/14"), "5000");
    let told = gaugefs(&[&bring_up[..], &["26985"]].concat()).done();
    assert!(told.contains("[VOLTSEL]") && told.contains("flash can be written"), "{told}");
    assert_eq!((read(&gauge, "df/64/7"), read(&gauge, "df/68/0")), ("7".into(), "2970".into()));
    assert_eq!((read(&gauge, "sim/mode"), read(&gauge, "gauge/seal")), ("normal".into(), "sealed".into()));
    gaugefs(&["umount", &at]).done();

    gaugefs(&["mount", "--sim", "bq27441-g1", &at]).done();
    gaugefs(&["calibrate", &gauge, "board-offset"]).failed(&["knows no calibration of this part"]);
    gaugefs(&["umount", &at]).done();
}

#[test]
fn regression_volts_in_place_of_millivolts_are_refused_before_flash_is_touched() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let gauge = format!("{at}/BAT0");
    gaugefs(&["mount", "--sim", CHIP, "--state-dir", &folder.file("state"), &at]).done();
    let bring_up = ["bringup", &gauge, "--cells", "4", "--divider"];
    let calibrate = ["calibrate", &gauge];
    let misused = |words: &[&str], says: &str| {
        let ran = gaugefs(words);
        assert!(ran.code == Some(2) && ran.err.contains(says), "{words:?}: {:?} {}", ran.code, ran.err);
    };
    let transfers = read(&gauge, "gauge/statistics/flash_writes");
    misused(
        &[&bring_up[..], &["20000", "--voltage-now", "15.42"]].concat(),
        "write 15.42V if it means 15.42V",
    );
    misused(&[&bring_up[..], &["20", "--voltage-now", "15.42V"]].concat(), "write 20V if it means 20V");
    misused(&[&bring_up[..], &["20000.5mV"]].concat(), "not rounded");
    misused(&[&calibrate[..], &["voltage", "--actual", "15.42"]].concat(), "write 15.42V");
    misused(&[&calibrate[..], &["current", "--actual", "-2"]].concat(), "write -2A");
    misused(&[&calibrate[..], &["current", "--actual", "-2V"]].concat(), "expected a number with mA or A");
    misused(&[&calibrate[..], &["temperature", "--actual", "235"]].concat(), "-40 to 125");
    // Whoever writes the file gets the same answer from the daemon.
    fs::write(format!("{gauge}/gauge/calibrate"), "bringup 4 20000 15.42").expect_err("volts");
    let told = read(&gauge, "gauge/last_error");
    assert!(told.contains("15.42 mV is too little for 4 cells; if it means 15.42V"), "{told}");
    assert_eq!(
        (read(&gauge, "gauge/statistics/flash_writes"), read(&gauge, "df/104/14")),
        (transfers, "5000".into())
    );

    // Negative values need no `=`. These are accepted, and there is no gauge to calibrate.
    for words in [
        &["calibrate", "/no/such", "current", "--actual", "-2A"][..],
        &["calibrate", "/no/such", "current", "--actual", "-2000"],
        &["calibrate", "/no/such", "temperature", "--actual", "-5C"],
        &["calibrate", "/no/such", "temperature", "--actual", "-5"],
        &["calibrate", "/no/such", "voltage", "--actual", "-3V"],
        &["bringup", "/no/such", "--cells", "4", "--divider", "20V", "--voltage-now", "-15.42V"],
        &["bringup", "/no/such", "--cells", "4", "--divider", "20000mV", "--voltage-now", "15420"],
    ] {
        gaugefs(words).failed(&["/no/such: not a mounted gauge"]);
    }
    gaugefs(&["umount", &at]).done();
}

/// Each printed what the other one had done.
#[test]
fn regression_two_calibrations_at_once_printed_each_others_steps() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let gauge = format!("{at}/BAT0");
    gaugefs(&["mount", "--sim", CHIP, "--fast", "--state-dir", &folder.file("state"), &at]).done();
    let calibrate = |words: &[&str]| gaugefs(&[&["calibrate", &gauge], words].concat());
    for _ in 0..3 {
        let (one, other) = std::thread::scope(|scope| {
            let one = scope.spawn(|| calibrate(&["temperature", "--actual", "25"]));
            (calibrate(&["voltage", "--actual", "3850"]), one.join().expect("no panic"))
        });
        for (own, others, ran) in [("Voltage", "Temp", one), ("Temp", "Voltage", other)] {
            assert!(!ran.out.contains(others), "{}", ran.out);
            match ran.code {
                Some(0) => assert!(ran.out.contains(own), "{}", ran.out),
                Some(2) => assert!(ran.err.contains("another program"), "{}", ran.err),
                // By this gauge's clock the other one has taken too long, or so long that little time was left.
                code => {
                    let is_late = ran.err.contains("Try again") && ran.out.is_empty();
                    let is_late = is_late || ran.err.contains("too slow");
                    assert!(code == Some(1) && is_late, "{code:?} {} {}", ran.out, ran.err);
                }
            }
        }
    }
    gaugefs(&["umount", &at]).done();
}

/// The voltage becomes noisy while the second transaction is measured, so that it is put back and the limit stays 0.
#[test]
fn a_bring_up_that_is_not_complete_fails_and_the_same_command_completes_it() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    let gauge = format!("{at}/BAT0");
    let set = |knob: &str, text: &str| fs::write(format!("{gauge}/sim/{knob}"), text).expect("a knob");
    // Measuring takes eight seconds, in which the test looks and turns a knob.
    let time = in_real_time();
    gaugefs(&["mount", "--sim", CHIP, "--state-dir", &folder.file("state"), &at]).done();
    drop(time);
    set("cells", "7");
    set("board_divider", "33000");
    let bring_up = ["bringup", &gauge, "--cells", "7", "--divider", "33000", "--voltage-now", "26985"];
    let refused = std::thread::scope(|scope| {
        scope.spawn(|| {
            let is_measured = || read(&gauge, "gauge/calibration").contains("and measuring again");
            within("the second transaction", is_measured);
            set("noise_mv", "1000");
        });
        gaugefs(&bring_up)
    });
    assert_eq!(refused.code, Some(1), "{}{}", refused.out, refused.err);
    for says in
        ["not complete", "its limit stays 0", "the old value was restored", "run the same command again"]
    {
        assert!(refused.err.contains(says), "{says}: {}", refused.err);
    }
    assert_eq!((read(&gauge, "df/68/0"), read(&gauge, "df/104/14")), ("0".into(), "33000".into()));
    set("noise_mv", "0");
    let told = gaugefs(&bring_up).done();
    assert!(told.contains("limit 68/0 is 2970 mV"), "{told}");
    assert_eq!((read(&gauge, "df/68/0"), read(&gauge, "gauge/seal")), ("2970".into(), "sealed".into()));
    gaugefs(&["umount", &at]).done();
}
