// SPDX-License-Identifier: MIT

//! `gaugefs list`, and `gaugefs probe` without a bus.

use std::fs;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;

use crate::room::{CHIP, Folder, can_mount, command, gaugefs, within};

/// The lines of `gaugefs list --json` about what is in a folder: other tests have mounts as well.
fn listed(folder: &Folder) -> Vec<Value> {
    let lines = gaugefs(&["list", "--json"]).out;
    let lines = lines.lines().map(|line| serde_json::from_str::<Value>(line).expect("JSON"));
    let inside = folder.file("");
    lines.filter(|line| line["path"].as_str().expect("a path").starts_with(&inside)).collect()
}

#[test]
fn every_mounted_gauge_is_listed_even_beside_a_stopped_daemon() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let (at, other, config) = (folder.file("m"), folder.file("n"), folder.file("two.toml"));
    fs::write(
        &config,
        format!("[[gauge]]\nsim = \"{CHIP}\"\n[[gauge]]\nsim = \"bq27441-g1\"\nname = \"RAM\"\n"),
    )
    .expect("a file");
    gaugefs(&["mount", "--config", &config, &at]).done();
    let foreground = ["mount", "--foreground", "--sim", CHIP, "--name", "STOPPED", &other];
    let mut daemon = command(&foreground).stderr(std::process::Stdio::null()).spawn().expect("gaugefs runs");
    within(Duration::from_secs(60), "mounted", || {
        std::path::Path::new(&other).join("STOPPED/present").exists()
    });
    let all = listed(&folder);
    let paths: Vec<_> = all.iter().map(|line| line["path"].as_str().expect("a path")).collect();
    assert_eq!(paths, [format!("{at}/BAT0"), format!("{at}/RAM"), format!("{other}/STOPPED")]);
    assert_eq!((&all[0]["part"], &all[0]["serial"]), (&"bq34z100-G1".into(), &"0x0001".into()));
    assert_eq!((&all[0]["capacity"], &all[0]["status"]), (&60.into(), &"Not charging".into()));
    assert!(all[0]["age_ms"].as_u64().is_some_and(|age| age < 60_000), "{}", all[0]);
    assert_eq!(
        (&all[1]["part"], &all[1]["serial"]),
        (&"bq27441-G1".into(), &Value::Null),
        "it has no serial number"
    );
    let table = gaugefs(&["list"]).out;
    assert!(
        table.starts_with("GAUGE ")
            && table.lines().any(|line| line.contains("/m/BAT0") && line.contains("60 %"))
    );

    let pid = Pid::from_raw(daemon.id() as i32);
    crate::room::stop(daemon.id(), &other);
    let start = Instant::now();
    let stopped = gaugefs(&["list"]);
    assert!(start.elapsed() < Duration::from_secs(60), "it hangs");
    assert_eq!(stopped.code, Some(1));
    assert!(stopped.err.contains(&format!("{other}: its daemon does not answer")), "{}", stopped.err);
    assert!(stopped.out.contains("/m/BAT0") && stopped.out.contains("/m/RAM"), "{}", stopped.out);
    // Neither does a completion wait for ever.
    gaugefs(&["names", &format!("{other}/STOPPED")]).done();
    kill(pid, Signal::SIGKILL).expect("it runs");
    daemon.wait().expect("it ends");
    let dead = gaugefs(&["list"]);
    assert_eq!(dead.code, Some(1));
    assert!(
        dead.err.contains(&format!("{other}: its daemon has died; remove the mount with: gaugefs umount")),
        "{}",
        dead.err
    );
    assert!(
        listed(&folder)
            .iter()
            .any(|line| line["error"].as_str().is_some_and(|error| error.contains("has died")))
    );
    gaugefs(&["get", &other, "80/53"]).failed(&["its daemon has died", "gaugefs umount"]);
}

/// Where a machine has buses, each is named; where it has none, that is said.
#[test]
fn probe_without_a_bus_looks_at_all_or_says_why_not() {
    let buses = gauge_bus::linux::adapters(std::path::Path::new("/"));
    let ran = gaugefs(&["probe"]);
    if buses.is_empty() {
        ran.failed(&["no I2C bus", "gaugefs doctor"]);
    } else {
        for (number, _) in &buses {
            assert!(ran.out.contains(&format!("/dev/i2c-{number} (")), "{}", ran.out);
        }
        let lines = gaugefs(&["probe", "--json"]).out;
        assert_eq!(lines.lines().count(), buses.len(), "{lines}");
    }
    assert_eq!(gaugefs(&["probe", "--address", "0x55"]).code, Some(2), "an address is one of a bus");
}
