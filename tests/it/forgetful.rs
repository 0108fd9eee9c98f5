// SPDX-License-Identifier: MIT

//! A gauge with RAM behind a mount: its profile, and what it has learned.

use std::fs;
use std::path::Path;
use std::time::Duration;

use crate::room::{Folder, can_mount, gaugefs, read, within};

#[test]
fn a_profile_is_there_again_after_a_loss_of_power() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let [at, profile, state] = ["m", "pack.toml", "state"].map(|name| folder.file(name));
    fs::write(&profile, "chip = \"bq27441-g1\"\n[state]\ndesign-capacity = 2100\n").expect("a file");
    let gauge = format!("{at}/BAT0");
    let mount = ["mount", "--sim", "bq27441-g1", "--poll", "0.5", "--state-dir", &state, "--pack", "A", &at];
    gaugefs(&[&mount[..], &["--profile", &profile]].concat()).done();
    let shows = |text: &str| {
        let found = fs::read_to_string(Path::new(&gauge).join("charge_full_design")).unwrap_or_default();
        found.trim_end() == text
    };
    within(Duration::from_secs(20), "the profile", || shows("2100000"));
    for position in ["off", "on"] {
        fs::write(format!("{gauge}/sim/power"), position).expect("a knob");
    }
    // From now on it shows the profile's value, or nothing.
    within(Duration::from_secs(20), "the profile again", || {
        assert!(!shows("1340000"));
        read(&at, "BAT0/gauge/itpor") == "0" && shows("2100000")
    });
    let shown = gaugefs(&["learned", &gauge]);
    assert!(shown.out.contains("nothing is kept that could be restored"), "{} {}", shown.out, shown.err);
    let refused = gaugefs(&["learned", "--restore", &gauge]);
    assert!(
        refused.code == Some(1) && refused.err.contains("nothing is kept of it"),
        "{} {}",
        refused.out,
        refused.err
    );
    let forgotten = gaugefs(&["learned", "--forget", &gauge]);
    assert!(
        forgotten.code == Some(0) && forgotten.out.contains("0 versions removed"),
        "{} {}",
        forgotten.out,
        forgotten.err
    );
    gaugefs(&["umount", &at]).done();
}

#[test]
fn a_gauge_with_flash_forgets_nothing() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let at = folder.file("m");
    gaugefs(&["mount", "--sim", "bq34z100-g1", &at]).done();
    let refused = gaugefs(&["learned", &format!("{at}/BAT0")]);
    assert!(
        refused.code == Some(1) && refused.err.contains("data memory in RAM"),
        "{} {}",
        refused.out,
        refused.err
    );
    gaugefs(&["umount", &at]).done();
}
