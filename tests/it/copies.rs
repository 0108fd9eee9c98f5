// SPDX-License-Identifier: MIT

//! Whatever copies a file gets the bytes of one value or an error.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use ti_gauge::keys::Keys;

use crate::drawn::one_in;
use crate::room::{Folder, Swift, swift, within};

/// Copiers: what each needs, and its script, with the file and the copy as arguments. `cp -a` copies a link as a link.
const COPIERS: [(&str, &str); 14] = [
    ("cp", r#"cp "$1" "$2""#),
    ("cp", r#"cp -a "$1" "$2""#),
    ("cp", r#"cp --sparse=always "$1" "$2""#),
    ("cp", r#"mkdir "$2.d" && cp -rL "$1" "$2.d/" && mv "$2.d/"* "$2""#),
    ("install", r#"install -m 600 "$1" "$2""#),
    ("mv", r#"mv "$1" "$2""#),
    ("rsync", r#"rsync -L "$1" "$2""#),
    ("rsync", r#"rsync -L --sparse --inplace "$1" "$2""#),
    ("tar", r#"tar -chf "$2.tar" -C "${1%/*}" "${1##*/}" && tar -xOf "$2.tar" >"$2""#),
    ("tar", r#"tar -chSf "$2.tar" -C "${1%/*}" "${1##*/}" && tar -xOf "$2.tar" >"$2""#),
    ("dd", r#"dd if="$1" of="$2""#),
    ("dd", r#"dd if="$1" of="$2" bs=7 conv=sparse"#),
    ("cat", r#"cat "$1" >"$2""#),
    ("python3", r#"python3 -c 'import shutil, sys; shutil.copy2(*sys.argv[1:])' "$1" "$2""#),
];

/// Files of every kind, each parameter and each `raw` of another subclass, `df/index` last: it reads all of data flash.
const FILES: [&str; 13] = [
    "capacity",
    "voltage_now",
    "uevent",
    "gauge/registers/voltage",
    "gauge/seal",
    "gauge/settle",
    "sim/load_ma",
    "df/transaction",
    "df/80/53",
    "df/48/43",
    "df/by-name/power/flash-update-ok-cell-volt",
    "df/64/raw",
    "df/index",
];

fn mounted() -> Option<Swift> {
    swift(Keys::default(), |sim| Box::new(sim.bus()))
}

fn is_flash(name: &str) -> bool {
    name.starts_with("df/") && name != "df/transaction"
}

/// Runs a copier. Returns whether it succeeded, and the copy.
fn copied(script: &str, file: &Path, copy: &str) -> (bool, Option<Vec<u8>>) {
    let script =
        Command::new("bash").args(["-c", script, "bash"]).arg(file).arg(copy).stderr(Stdio::null()).output();
    let succeeded = script.expect("bash runs").status.success();
    let is_link = fs::symlink_metadata(copy).is_ok_and(|status| status.is_symlink());
    (succeeded, fs::read(copy).ok().filter(|_| !is_link))
}

/// What is copied of each of these files by each copier. `state` puts the gauge into its state before each copier.
fn copies(
    mount: &Swift,
    files: &[&str],
    state: impl Fn(),
    check: impl Fn(&str, &str, bool, Option<&[u8]>, Option<Vec<u8>>),
) {
    for (number, (needs, script)) in COPIERS.iter().enumerate() {
        let found =
            Command::new("sh").args(["-c", &format!("command -v {needs}")]).output().expect("sh runs");
        if !found.status.success() {
            eprintln!("SKIPPED: without {needs}, `{script}` copied nothing");
            continue;
        }
        let folder = Folder::new();
        state();
        for (at, name) in one_in(2, files.iter().enumerate()) {
            let path = mount.root.join(name);
            // A poll may change it; to read data flash would be to read it for the copier.
            let before = fs::read(&path).ok().filter(|_| !is_flash(name));
            let (succeeded, copy) = copied(script, &path, &folder.file(&format!("{number}-{at}")));
            check(name, script, succeeded, copy.as_deref(), before);
        }
    }
}

fn shown(bytes: &[u8]) -> String {
    format!("{} bytes, {:?}", bytes.len(), String::from_utf8_lossy(&bytes[..bytes.len().min(60)]))
}

/// A copy of an unread parameter was its value, and NULs up to 4096 bytes.
#[test]
fn regression_a_copy_has_the_bytes_of_the_value() {
    let Some(mount) = mounted() else { return };
    let unread = || within("a refresh", || fs::write(mount.root.join("gauge/refresh"), "1").is_ok());
    let check = |name: &str, script: &str, succeeded: bool, copy: Option<&[u8]>, before: Option<Vec<u8>>| {
        // Nobody can remove the file, and a link is moved as a link.
        let is_moved = script.starts_with("mv ");
        if (is_moved || script.starts_with("cp -a")) && name.contains("by-name") {
            return;
        }
        assert_eq!(succeeded, !is_moved, "{name}: {script}");
        let copy = copy.unwrap_or_else(|| panic!("{name}: {script}: no copy"));
        let now = fs::read(mount.root.join(name)).expect("a value");
        let is_value = copy == now || before.is_some_and(|before| copy == before);
        assert!(is_value, "{name}: {script}: {}, not {}", shown(copy), shown(&now));
    };
    let flash: Vec<_> = FILES.into_iter().filter(|name| is_flash(name)).collect();
    copies(&mount, &flash, unread, check);
    copies(&mount, &FILES, || (), check);
}

/// Nor was there an error for a copy of NULs, where the gauge does not answer.
#[test]
fn regression_a_copy_of_what_cannot_be_read_is_an_error() {
    let Some(mount) = mounted() else { return };
    mount.sim.set("power", "off").expect("a knob");
    let check = |name: &str, script: &str, succeeded: bool, copy: Option<&[u8]>, _: Option<Vec<u8>>| {
        if name.contains("by-name") && script.starts_with("cp -a") {
            return;
        }
        assert!(
            copy.is_none_or(<[u8]>::is_empty),
            "{name}: {script}: {}",
            copy.map(shown).unwrap_or_default()
        );
        assert!(!succeeded, "{name}: {script}");
    };
    let (flash, rest): (Vec<_>, Vec<_>) = FILES.into_iter().partition(|name| is_flash(name));
    copies(&mount, &flash, || (), check);
    within("it is gone", || {
        let _ = fs::write(mount.root.join("gauge/refresh"), "1");
        !mount.root.join("voltage_now").exists()
    });
    let gone: Vec<_> = rest.into_iter().filter(|name| fs::metadata(mount.root.join(name)).is_err()).collect();
    assert_eq!(gone, ["capacity", "voltage_now", "gauge/registers/voltage"]);
    copies(&mount, &gone, || (), check);
}
