//! `gaugefs calibrate` and `gaugefs bringup` on a mounted gauge.

use std::fs;
use std::path::Path;

use super::{CHIP, Folder, can_mount, gaugefs, read};

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
    assert_eq!(format!("{}\n", read(&gauge, "gauge/calibration")), told);

    let refused = gaugefs(&["calibrate", &gauge, "current", "--actual", "20"]);
    refused.failed(&["Current()", "100 mA"]);
    let refused = gaugefs(&["calibrate", &gauge, "voltage", "--actual", "12600"]);
    assert!(refused.err.contains("gaugefs bringup") && refused.code == Some(1), "{}", refused.err);
    assert_eq!(gaugefs(&["calibrate", &gauge, "leave"]).done().lines().count(), 2);

    set("cells", "7");
    set("board_divider", "33000");
    let bring_up = ["bringup", &gauge, "--cells", "7", "--divider", "33000", "--voltage-now"];
    let wrong = gaugefs(&[&bring_up[..], &["20000"]].concat());
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
