// SPDX-License-Identifier: MIT

//! An ordinary user, without root: what works, and what a mount says where something is missing.
//!
//! The user and `/dev/fuse` with the mode that udev gives it are in a mount namespace of their own, so nothing of the
//! machine is changed.

use std::fs;
use std::os::unix::fs::{PermissionsExt, chown};
use std::process::Command;

use super::room::{Folder, can_mount, gaugefs, users_can_mount};

/// What the scripts below begin with. `user` is in the groups 65534 and 1, `other` in 1 only.
const BEFORE: &str = r#"
set -u
cd "$1"
mknod -m 666 fuse c 10 229 && mount --bind fuse /dev/fuse
user() { setpriv --reuid 65534 --regid 65534 --groups 65534,1 env -u XDG_RUNTIME_DIR HOME="$here/home" "$@"; }
other() { setpriv --reuid 65533 --regid 1 --clear-groups "$@"; }
here=$PWD gaugefs=$PWD/gaugefs
export COLUMNS=100
cd home
"#;

/// Runs a script as root in a namespace of its own, and returns all that it prints.
fn script(folder: &Folder, script: &str) -> Option<String> {
    if !can_mount() {
        return None;
    }
    if !nix::unistd::geteuid().is_root() {
        eprintln!("SKIPPED: only root can try what another user may do");
        return None;
    }
    let home = folder.file("home");
    fs::create_dir(&home).and_then(|()| chown(&home, Some(65534), Some(65534))).expect("a home");
    fs::set_permissions(&folder.0, fs::Permissions::from_mode(0o755)).expect("its mode");
    fs::copy(env!("CARGO_BIN_EXE_gaugefs"), folder.file("gaugefs")).expect("a copy that any user may run");
    let whole = format!("{BEFORE}{script}");
    let output = Command::new("unshare")
        .args(["--mount", "--propagation", "private", "bash", "-c", &whole, "bash"])
        .args([&folder.0])
        .output();
    let output = output.expect("util-linux has unshare and setpriv");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    Some(text(&output.stdout) + &text(&output.stderr))
}

#[track_caller]
fn says(said: &str, words: &[&str]) {
    for word in words {
        assert!(said.contains(word), "`{word}` is not in:\n{said}");
    }
}

#[test]
fn a_user_mounts_and_unmounts_below_the_home() {
    if !users_can_mount() {
        return;
    }
    let folder = Folder::new();
    let commands = r#"
user "$gaugefs" mount --sim bq34z100-g1 gauges && user cat gauges/BAT0/capacity
other cat gauges/BAT0/capacity || echo kept apart
user "$gaugefs" umount gauges && echo unmounted
"#;
    let Some(said) = script(&folder, commands) else { return };
    assert_eq!(
        said.lines().filter(|line| !line.starts_with("cat:")).collect::<Vec<_>>(),
        ["60", "kept apart", "unmounted"]
    );
}

/// A folder that its owner may not write to answers EACCES to a mistyped name before gaugefs is asked.
#[test]
fn regression_a_mistyped_name_is_told_to_the_owner_of_a_mount_too() {
    if !users_can_mount() {
        return;
    }
    let folder = Folder::new();
    let commands = r#"
user "$gaugefs" mount --sim bq34z100-g1 gauges
user sh -c 'echo 3100 > gauges/BAT0/df/80/54'
user cat gauges/BAT0/gauge/last_error
user cat gauges/BAT0/df/80/54
user touch gauges/BAT0/mine
user mkdir gauges/BAT0/df/mine
user rm -f gauges/BAT0/capacity
user "$gaugefs" umount gauges && echo unmounted
"#;
    let Some(said) = script(&folder, commands) else { return };
    says(
        &said,
        &["cannot create gauges/BAT0/df/80/54: Directory nonexistent", "did you mean 80/53", "unmounted"],
    );
    says(&said, &["cat: gauges/BAT0/df/80/54: No such file", "touch '", "mine': No such file"]);
    says(&said, &["df/mine", "'gauges/BAT0/capacity': Operation not permitted"]);
    assert!(!said.contains("Permission denied"), "{said}");
}

#[test]
fn a_missing_fusermount3_is_named_before_anything_is_made() {
    let folder = Folder::new();
    let commands = r#"
export FUSERMOUNT_PATH=/nonexistent/fusermount3
user "$gaugefs" mount --sim bq34z100-g1 gauges; echo "=> $?"
ls -A
"$gaugefs" mount --sim bq34z100-g1 ../root && cat ../root/BAT0/capacity && "$gaugefs" umount ../root
"#;
    let Some(said) = script(&folder, commands) else { return };
    says(
        &said,
        &[
            "gaugefs: fusermount3: not found, and only root can mount without it; install the package fuse3",
            "with sudo",
        ],
    );
    // Root needs none.
    assert!(said.starts_with("=> 1\n60\n"), "{said}");
}

#[test]
fn a_group_that_cannot_have_access_is_refused() {
    let folder = Folder::new();
    let commands = r#"
echo '#user_allow_other' > ../fuse.conf
mount --bind ../fuse.conf /etc/fuse.conf || { echo no /etc/fuse.conf; exit; }
for group in bin daemon; do
    user "$gaugefs" mount --sim bq34z100-g1 --group $group gauges; echo "=> $?"
done
user "$gaugefs" mount --sim bq34z100-g1 --group daemon --private gauges; echo "=> $?"
ls -A
echo user_allow_other > ../fuse.conf
user "$gaugefs" mount --sim bq34z100-g1 --group daemon gauges; echo "=> $?"
other sh -c 'cat gauges/BAT0/df/80/53; echo 3100 > gauges/BAT0/df/80/53; cat gauges/BAT0/df/80/53'
user "$gaugefs" umount gauges
"#;
    let Some(said) = script(&folder, commands) else { return };
    if said.contains("no /etc/fuse.conf") {
        eprintln!("SKIPPED: without /etc/fuse.conf no group was tried");
        return;
    }
    assert!(said.starts_with("=> 1\n=> 1\n=> 1\n=> 0\n3000\n3100\n"), "{said}");
    says(
        &said,
        &[
            "group bin: you are not in it, so you cannot give it access; mount with sudo, or join it (sudo usermod -aG bin",
            "group daemon: only root may open a mount to others; mount with sudo, or allow it to all users with this line \
             in /etc/fuse.conf: user_allow_other",
            "group daemon: --private denies every other user access",
        ],
    );
}

#[test]
fn a_folder_of_roots_is_refused_with_the_way_out() {
    if !users_can_mount() {
        return;
    }
    let folder = Folder::new();
    let commands = r#"
mkdir ../closed
user "$gaugefs" mount --sim bq34z100-g1 ../closed/gauges; echo "=> $?"
user "$gaugefs" mount --sim bq34z100-g1 ../closed; echo "=> $?"
printf '[mount]\nmountpoint = "../closed/gauges"\n[[gauge]]\nsim = "bq34z100-g1"\n' > gauges.toml
user "$gaugefs" mount --config gauges.toml --check; echo "=> $?"
chmod 700 ../closed
user "$gaugefs" mount --sim bq34z100-g1 ../closed/gauges; echo "=> $?"
"#;
    let Some(said) = script(&folder, commands) else { return };
    assert_eq!(said.matches("=> 1\n").count(), 4, "{said}");
    let remedy = "Permission denied; choose a folder of yours, such as ~/gauges, or run it with sudo";
    assert_eq!(said.matches(&format!("cannot create the folder: {remedy}")).count(), 2, "{said}");
    assert_eq!(said.matches(&format!("cannot be examined: {remedy}")).count(), 1, "{said}");
}

#[test]
fn a_bus_without_permission_is_on_the_list_of_a_check() {
    if !users_can_mount() {
        return;
    }
    let folder = Folder::new();
    let commands = r#"
mknod -m 600 ../i2c-250 c 89 250
printf '[mount]\nmountpoint = "gauges"\n[[gauge]]\nname = "PACK"\nbus = "../i2c-250"\n' > gauges.toml
user "$gaugefs" mount --config gauges.toml --check; echo "=> $?"
"#;
    let Some(said) = script(&folder, commands) else { return };
    let refusals: Vec<_> = said.lines().filter(|line| line.starts_with("gaugefs: ")).collect();
    assert!(
        matches!(refusals[..], [one] if one.contains("PACK: ") && one.contains("no permission")),
        "{said}"
    );
    assert!(said.contains("\n=> 1\n"), "{said}");
}

#[test]
fn the_mount_of_another_user_is_not_unmounted_and_its_owner_is_named() {
    let folder = Folder::new();
    let commands = r#"
mkdir -m 755 ../gauges && "$gaugefs" mount --sim bq34z100-g1 ../gauges
user "$gaugefs" umount ../gauges; echo "=> $?"
"$gaugefs" umount ../gauges; echo "=> $?"
"#;
    let Some(said) = script(&folder, commands) else { return };
    assert!(said.starts_with("=> 1\n=> 0\n"), "{said}");
    says(&said, &["/gauges: mounted by user root, who may unmount it, as root may: sudo gaugefs umount /"]);
}

/// A small Debian has no /etc/mtab, which fusermount3 looks into.
#[test]
fn regression_any_failure_of_fusermount3_is_told_as_that_of_another_user() {
    if !users_can_mount() {
        return;
    }
    let folder = Folder::new();
    let commands = r#"
export FUSERMOUNT_PATH=$PWD/fusermount3
cat >fusermount3 <<'END'
#!/bin/sh
[ "$1" != -u ] || { echo "$0: failed to open /etc/mtab: No such file or directory" >&2; exit 1; }
unset FUSERMOUNT_PATH
exec fusermount3 "$@"
END
chmod 755 fusermount3
user mkdir gauges && user "$gaugefs" mount --sim bq34z100-g1 gauges
user "$gaugefs" umount gauges; echo "=> $?"
"$gaugefs" umount gauges; echo "=> $?"
"#;
    let Some(said) = script(&folder, commands) else { return };
    assert!(said.starts_with("=> 1\n=> 0\n"), "{said}");
    says(
        &said,
        &["/gauges: not unmounted; as root: gaugefs umount /", "fusermount3: failed to open /etc/mtab: "],
    );
}

/// One that is not on the list of `--check` is found before the mount, too.
#[test]
fn a_check_lists_all_that_a_mount_would_stumble_over() {
    let folder = Folder::new();
    let [missing, open, other] = ["missing.keys", "open.keys", "other.keys"].map(|name| folder.file(name));
    for (path, mode) in [(&open, 0o644), (&other, 0o600)] {
        fs::write(path, "[PACK]\nunseal = 0414 3672\n").expect("a key file");
        fs::set_permissions(path, fs::Permissions::from_mode(mode)).expect("its mode");
    }
    let sim = |name: &str, file: &str| {
        format!("[[gauge]]\nname = '{name}'\nsim = 'bq34z100-g1'\nkey-file = '{file}'\n")
    };
    let config = format!(
        "[mount]\nmountpoint = 'file'\ngroup = 'root'\nprivate = true\nlog = 'none/log'\n{}{}{}{}\
         [[gauge]]\nname = 'BUS'\nbus = '/dev/i2c-998'\n[[gauge]]\nname = 'LATER'\nbus = '/dev/i2c-999'\nchip = 'bq34110'\n\
         [[gauge]]\nname = 'REC'\nreplay = 'none.trace'\n[[gauge]]\nname = 'RAM'\nsim = 'bq27441-g1'\nrestore = 'none.toml'\n",
        sim("A", "missing.keys"),
        sim("B", "open.keys"),
        sim("C", "other.keys"),
        sim("PACK", "other.keys"),
    );
    let path = folder.file("gauges.toml");
    fs::write(&path, config.replace("private = true", "private = true\nread-only = true")).expect("a file");
    fs::write(folder.file("file"), "").expect("a file");
    let ran = gaugefs(&["mount", "--config", &path, "--check"]);
    assert_eq!(ran.code, Some(1), "{}{}", ran.out, ran.err);
    assert_eq!(ran.out.lines().count(), 8, "{}", ran.out);
    let at = folder.file("");
    for line in [
        "group root: --private denies every other user access",
        &format!("{at}file: not a folder"),
        &format!("A: {missing}: cannot read the key file: No such file or directory"),
        &format!("B: {open}: others may read the key file (mode 644); chmod 600 {open}"),
        &format!("C: {other}: it has no key for C: neither above its sections nor in a section [C]"),
        "BUS: /dev/i2c-998: no such bus",
        "LATER: /dev/i2c-999: no such bus",
        &format!("REC: {at}none.trace: "),
        &format!("RAM: {at}none.toml: cannot be read"),
    ] {
        assert!(
            ran.err.lines().any(|found| found.starts_with(&format!("gaugefs: {line}"))),
            "{line}\nis not in:\n{}",
            ran.err
        );
    }
    assert!(!ran.err.contains("PACK"), "{}", ran.err);
    let later = ran.err.lines().find(|line| line.contains("LATER: ")).unwrap_or_default();
    assert!(later.ends_with("; a mount would wait for it"), "{later}");
}
