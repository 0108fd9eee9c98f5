// SPDX-License-Identifier: MIT

//! `docs/PACKAGING.md`: its commands and scripts are run as they are written there.

use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use super::room::{Folder, can_mount, within};

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn page() -> String {
    fs::read_to_string(root().join("docs/PACKAGING.md")).expect("the page")
}

/// The first block of that kind below a heading.
fn block(heading: &str, kind: &str) -> String {
    let page = page();
    let below = page.split_once(&format!("\n## {heading}\n")).expect("the heading").1;
    let below = below.split("\n## ").next().expect("its text");
    let block = below.split_once(&format!("\n```{kind}\n")).expect("a block of that kind").1;
    block.split("```").next().expect("its end").to_string()
}

/// A folder with the program, a configuration of one simulated gauge, and a script.
fn prepared(kind: &str) -> (Folder, String) {
    let folder = Folder::new();
    let bin = folder.file("bin");
    fs::create_dir(&bin).expect("a folder");
    std::os::unix::fs::symlink(env!("CARGO_BIN_EXE_gaugefs"), Path::new(&bin).join("gaugefs"))
        .expect("a link");
    let config = "[mount]\nmountpoint = \"m\"\n[[gauge]]\nsim = \"bq34z100-g1\"\n";
    fs::write(folder.file("gaugefs.toml"), config).expect("a configuration");
    let script = folder.file("script");
    let text = match kind {
        "openrc" => fs::read_to_string(root().join("udev/gaugefs.openrc")).expect("the script"),
        "busybox" => fs::read_to_string(root().join("udev/S60gaugefs")).expect("the script"),
        kind => block("Without systemd", kind),
    };
    fs::write(&script, text).expect("a script");
    fs::set_permissions(&script, Permissions::from_mode(0o755)).expect("its mode");
    (folder, script)
}

/// A command that finds the program and the configuration.
fn run(folder: &Folder, program: &str) -> Command {
    let path = std::env::var("PATH").unwrap_or_default();
    let mut command = Command::new(program);
    command
        .env("PATH", format!("{}:{path}", folder.file("bin")))
        .env("CONFIG", folder.file("gaugefs.toml"))
        .env("MOUNTPOINT", folder.file("m"))
        .current_dir(&folder.0)
        .stdin(Stdio::null());
    command
}

#[track_caller]
fn succeeds(output: &Output) {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn the_script_for_busybox_starts_and_stops() {
    if !can_mount() {
        return;
    }
    let (folder, script) = prepared("busybox");
    let gauge = folder.0.join("m/BAT0/capacity");
    let does = |what: &str| run(&folder, &script).arg(what).output().expect("a shell");
    succeeds(&does("start"));
    assert!(gauge.exists());
    succeeds(&does("restart"));
    assert!(gauge.exists());
    succeeds(&does("stop"));
    assert!(!gauge.exists());
    assert_eq!(does("stop").status.code(), Some(1));
    assert_eq!(does("reload").status.code(), Some(2));
}

#[test]
fn the_script_for_openrc_starts_and_stops() {
    if !can_mount() {
        return;
    }
    let (folder, script) = prepared("openrc");
    let gauge = folder.0.join("m/BAT0/capacity");
    let functions = "ebegin() { :; }; eend() { return $1; }; use() { :; }; after() { :; }; einfo() { :; }; eerror() { :; }";
    let does = |what: &str| {
        let whole = format!("{functions}; config=$CONFIG; mountpoint=$MOUNTPOINT; . \"$0\"; depend; {what}");
        run(&folder, "sh").args(["-c", &whole, &script]).output().expect("a shell")
    };
    assert_eq!(does("status").status.code(), Some(3));
    succeeds(&does("start"));
    assert!(gauge.exists());
    succeeds(&does("status"));
    succeeds(&does("stop"));
    assert!(!gauge.exists());
    // Somebody else may have ended the mount; the service can be restarted all the same.
    succeeds(&does("stop"));
}

#[test]
fn the_script_for_runit_runs_until_it_is_told_to_end() {
    if !can_mount() {
        return;
    }
    let (folder, script) = prepared("runit");
    let gauge = folder.0.join("m/BAT0/capacity");
    let mut service = run(&folder, &script).stdout(Stdio::null()).spawn().expect("a shell");
    within("mounted", || gauge.exists());
    kill(Pid::from_raw(service.id() as i32), Signal::SIGTERM).expect("it runs");
    assert_eq!(service.wait().expect("its end").code(), Some(0));
    assert!(!gauge.exists());
}

#[test]
fn the_files_are_installed() {
    let folder = Folder::new();
    let commands = block("Files", "sh").replace("target/dist/gaugefs", env!("CARGO_BIN_EXE_gaugefs"));
    let mut shell = Command::new("sh");
    shell.args(["-euc", &commands]).env("DESTDIR", &folder.0).current_dir(root());
    succeeds(&shell.output().expect("a shell"));
    for file in [
        "usr/bin/gaugefs",
        "usr/bin/gaugefs-station",
        "usr/share/doc/gaugefs/examples/gaugefs.toml",
        "usr/share/man/man1/gaugefs.1",
        "usr/share/man/man1/gaugefs-station.1",
        "usr/share/man/man5/gaugefs.toml.5",
        "usr/share/bash-completion/completions/gaugefs",
        "usr/share/bash-completion/completions/gaugefs-station",
    ] {
        assert!(fs::metadata(folder.0.join(file)).is_ok_and(|status| status.len() > 1000), "{file}");
    }
    let mode = fs::metadata(folder.0.join("var/lib/gaugefs")).expect("a folder").permissions().mode();
    assert_eq!(mode & 0o777, 0o700);
}

/// `tests/cross` builds with the targets, packages and linkers of the page, and the page with its command.
#[test]
fn the_cross_builds_are_those_of_tests_cross() {
    let tried = fs::read_to_string(root().join("tests/cross")).expect("the script");
    let page = page();
    let builds: Vec<&str> = tried.lines().map(str::trim).filter(|line| line.starts_with("arm a")).collect();
    assert_eq!(builds.len(), 2, "{builds:?}");
    for build in builds {
        let (target, rest) = build["arm ".len()..].split_once(" '").expect("a target");
        let (packages, rest) = rest.split_once("' ").expect("packages");
        let prefix = rest.split(' ').next().expect("a prefix");
        let row = format!("| `{target}` | `{packages}` | `{prefix}-gcc` |");
        assert!(page.contains(&row), "{row}");
    }
    let commands = block("Building", "sh");
    for words in [
        "rustup target add aarch64",
        "gcc-aarch64-linux-gnu libc6-dev-arm64-cross",
        "--locked --bin gaugefs --bin gaugefs-station",
    ] {
        assert!(commands.contains(words), "{words}");
    }
    assert!(tried.contains("--locked --bin gaugefs --bin gaugefs-station"));
}

/// A recipe of Buildroot, and one of Yocto, with their words for the package that has `nsenter`.
fn recipes() -> [(String, &'static str); 2] {
    let read = |path: &str| fs::read_to_string(root().join(path)).expect("the version's own file");
    let buildroot =
        read("udev/buildroot/package/gaugefs/gaugefs.mk") + &read("udev/buildroot/package/gaugefs/Config.in");
    let yocto = read(concat!("udev/yocto/gaugefs_", env!("CARGO_PKG_VERSION"), ".bb"));
    assert!(
        buildroot.contains(concat!("\nGAUGEFS_VERSION = ", env!("CARGO_PKG_VERSION"), "\n")),
        "{buildroot}"
    );
    [(buildroot, "BR2_PACKAGE_UTIL_LINUX_NSENTER"), (yocto, "util-linux-nsenter")]
}

/// Without the rule no bus belongs to the service's account, and without `nsenter` nobody sees its mount.
#[test]
fn regression_a_service_of_buildroot_or_yocto_cannot_open_its_bus() {
    for (recipe, nsenter) in recipes() {
        let units = "gaugefs gaugefs@ gaugefs-node@";
        for installed in
            [nsenter, units, "/udev/service.conf", "/udev/60-gaugefs.rules", "/udev/modules-load.conf"]
        {
            assert!(recipe.contains(installed), "{installed}: {recipe}");
        }
    }
}

#[test]
fn the_kernels_options_are_found_where_it_shows_them() {
    let commands = block("The kernel", "sh");
    let (first, second) = commands.split_once('\n').expect("two commands");
    assert_eq!(second.trim(), "gaugefs doctor");
    if !Path::new("/proc/config.gz").exists() || !can_mount() {
        eprintln!("SKIPPED: the kernel does not show its configuration, or has no FUSE");
        return;
    }
    let output = Command::new("sh").args(["-c", first]).output().expect("a shell");
    assert!(String::from_utf8_lossy(&output.stdout).contains("CONFIG_FUSE_FS="), "{output:?}");
}

/// What `udev/licenses` makes of the crates that are linked in, with these arguments; `None` if there is no Python.
fn licenses(arguments: &[&str]) -> Option<Output> {
    let mut command = Command::new("python3");
    match command.arg(root().join("udev/licenses")).args(arguments).current_dir(root()).output() {
        Ok(output) => Some(output),
        Err(_) => {
            eprintln!("SKIPPED: python3 is missing");
            None
        }
    }
}

#[test]
fn every_crate_that_is_linked_in_has_a_license_of_the_list() {
    let Some(output) = licenses(&["x86_64-unknown-linux-gnu"]) else { return };
    succeeds(&output);
    let text = String::from_utf8_lossy(&output.stdout);
    for words in [
        "Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/\n",
        "\nFiles: *\nCopyright: 2026 the gaugefs authors\nLicense: MIT\n",
        "\nLicense: MIT\n Permission is hereby granted",
    ] {
        assert!(text.contains(words), "{words}");
    }
    // What the manifest names is there, what runs at build time is not, and nobody's crate is without a holder.
    assert!(text.contains("\nFiles: fuser-") && !text.contains("\nFiles: syn-"), "{text}");
    let archived = ["\nFiles: musl/*\n", "\nFiles: llvm-project/libunwind/*\n", "\nLicense: Apache-2.0\n"];
    assert!(archived[..2].iter().all(|words| !text.contains(words)), "{text}");
    for stanza in text.split("\n\n").filter(|stanza| stanza.starts_with("Files: ")) {
        let holder = stanza.split_once("\nCopyright: ").expect("a holder").1;
        assert!(holder.starts_with(|first: char| first.is_alphanumeric()), "{stanza}");
    }
    let Some(output) = licenses(&["x86_64-unknown-linux-musl"]) else { return };
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(archived.iter().all(|words| text.contains(words)), "{text}");
}

#[test]
fn a_crate_whose_license_is_not_on_the_list_is_named() {
    let Some(output) = licenses(&["--allow", "Apache-2.0", "x86_64-unknown-linux-gnu"]) else { return };
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(output.stdout, b"");
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(text.contains(": none of its licenses is on the list: MIT\n"), "{text}");
    assert!(!text.contains(" libc 0."), "it may be had under Apache-2.0: {text}");
}

/// Nobody waits for builds to learn that a standard library or a linker is missing.
#[test]
fn what_cannot_be_built_is_named_before_anything_is_built() {
    let folder = Folder::new();
    for (name, script) in [
        ("rustc", "case $* in *print*target-libdir*arm-*) echo /none ;; *) exec \"$REAL\" \"$@\" ;; esac"),
        ("rustup", "echo info: downloading; echo error: the download has failed >&2; exit 1"),
        ("id", "echo 1000"),
    ] {
        let path = folder.file(name);
        fs::write(&path, format!("#!/bin/sh\n{script}\n")).expect("a script");
        fs::set_permissions(&path, Permissions::from_mode(0o755)).expect("its mode");
    }
    let real = Command::new("sh").args(["-c", "command -v rustc"]).output().expect("a shell").stdout;
    let mut release = Command::new(root().join("udev/release"));
    release
        .args(["arm", "arm64"])
        .env("PATH", format!("{}:{}", folder.file("."), std::env::var("PATH").unwrap_or_default()))
        .env("REAL", String::from_utf8_lossy(&real).trim())
        .env("CARGO_TARGET_DIR", folder.file("target"))
        .env("CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER", "/none/gcc");
    let output = release.output().expect("bash");
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let text = String::from_utf8_lossy(&output.stderr);
    let named: Vec<_> = text.lines().filter(|line| line.starts_with("MISSING ")).collect();
    let arm = "no standard library of Rust for arm-unknown-linux-musleabihf: error: the download has failed";
    assert_eq!(named[0], format!("MISSING arm: {arm}"), "{text}");
    // Where Rust has no standard library for this one either, that is named.
    assert!(named.len() == 2 && named[1].starts_with("MISSING arm64: "), "{text}");
    assert_eq!(fs::read_dir(folder.file("target")).expect("a folder").count(), 1, "{text}");
}
