// SPDX-License-Identifier: MIT

//! What uses of a mount cost in messages of the kernel to gaugefs. Times are in `benches/`.

use std::fs::{self, File};
use std::io::Read;
use std::path::Path;
use std::process::Command;
use std::thread;
use std::time::Duration;

use crate::room::{keeps_names, messages, quiet};

const CHIP: &str = "bq34z100-g1";
/// A busy machine makes the kernel ask once more now and then.
const ROUNDS: usize = 20;

/// The fewest messages of a use in several rounds.
fn cost(mut what: impl FnMut()) -> u64 {
    what();
    let rounds = (0..ROUNDS).map(|_| {
        let before = messages();
        what();
        messages() - before
    });
    rounds.min().expect("rounds")
}

/// Whether a use costs no more messages than that some time after the last one, in one of several rounds: other tests look
/// at all mounts now and then. Else what it costs.
fn cost_later(pause: Duration, mut what: impl FnMut(), most: u64) -> Result<(), Vec<u64>> {
    let mut costs = Vec::new();
    while costs.len() < ROUNDS {
        what();
        thread::sleep(pause);
        let before = messages();
        what();
        match messages() - before {
            cost if cost <= most => return Ok(()),
            cost => costs.push(cost),
        }
    }
    Err(costs)
}

/// As `cat` does.
fn cat(path: &Path) -> Vec<u8> {
    let mut file = File::open(path).expect("opens");
    file.metadata().expect("it is open");
    let mut bytes = vec![0; 128 * 1024];
    let mut length = 0;
    while let Ok(count @ 1..) = file.read(&mut bytes[length..]) {
        length += count;
    }
    bytes.truncate(length);
    bytes
}

/// Twice a LOOKUP, of which the first is for the nodeid that the kernel knows; READ; FORGET.
#[test]
fn a_known_parameter_costs_four_messages() {
    let Some(mount) = quiet(CHIP) else { return };
    let path = mount.path("df/80/53");
    let of_parameter = cost(|| assert_eq!(cat(&path), b"3000\n"));
    assert!(of_parameter <= 4, "{of_parameter}");
}

/// The kernel still has what has not changed.
#[test]
fn an_unchanged_file_of_the_gauge_and_the_index_cost_one_message() {
    let Some(mount) = quiet(CHIP) else { return };
    for name in ["gauge/flags", "gauge/registers/voltage", "df/index"] {
        let path = mount.path(name);
        let of_file = cost(|| assert!(!cat(&path).is_empty()));
        assert!(of_file <= 1, "{name}: {of_file}");
    }
}

#[test]
fn an_unchanged_attribute_costs_no_message_and_one_after_it_was_kept() {
    let Some(mount) = quiet(CHIP) else { return };
    let path = mount.path("voltage_now");
    let of_attribute = cost(|| drop(cat(&path)));
    assert!(of_attribute <= u64::from(!keeps_names()), "{of_attribute}");
}

/// The kernel is notified of a change, so it asks again only when a daemon that has ended could tell of none for too long.
#[test]
fn the_first_file_after_some_seconds_of_quiet_costs_no_message() {
    let Some(mount) = quiet(CHIP) else { return };
    let path = mount.path("capacity");
    let of_first = cost_later(Duration::from_secs(4), || drop(cat(&path)), if keeps_names() { 0 } else { 2 });
    assert!(of_first.is_ok(), "{of_first:?}");
}

/// Two LOOKUPs, the first for the values that the kernel knows; READ, and FORGET of the old values. The folders stay as long as
/// the mount.
#[test]
fn all_values_of_a_gauge_cost_four_messages_however_long_ago_the_last_ones_were_read() {
    let Some(mount) = quiet(CHIP) else { return };
    let read = || {
        let values = gaugefs_client::follow::values(&mount.path(""), &[]).expect("a gauge");
        assert!(values.contains_key("gauge/statistics/polls"));
    };
    let of_values = cost_later(Duration::from_secs(3), read, 4);
    assert!(of_values.is_ok(), "{of_values:?}");
}

/// A LOOKUP for each of the three paths that it passes to the kernel, or two.
#[test]
fn a_long_listing_costs_six_messages_a_file() {
    let Some(mount) = quiet(CHIP) else { return };
    for name in ["df/80", "gauge"] {
        let folder = mount.path(name);
        let names = fs::read_dir(&folder).expect("a folder").count() as u64;
        let of_listing = cost(|| {
            let listed = Command::new("ls").arg("-l").arg(&folder).output().expect("ls runs");
            assert!(listed.status.success());
        });
        assert!(of_listing <= 6 * names, "{name}: {of_listing} for {names} names");
    }
}
