// SPDX-License-Identifier: MIT

//! `gaugefs rescue` as somebody uses it who wants to see it once: a whole firmware file, and a simulated gauge that is left
//! in ROM mode. The rules of the boot loader are tested in `crates/ti-gauge/tests/it/rescue.rs`.

use std::fs::{self, File};
use std::io::Write;
use std::process::Stdio;

use ti_gauge::chip::{CHIPS, Chip};

use crate::firmware::{Style, file};
use crate::room::{CHIP, Folder, Ran, command, gaugefs};

/// A file as TI's tools write it, with the lines for the gauge's own address in front.
fn whole_file(folder: &Folder, chip: &Chip, style: Style) -> String {
    let path = folder.file(&format!("{}.bq.fs", chip.name));
    fs::write(&path, file(chip, style)).expect("a file");
    path
}

/// Runs the command at a terminal at which somebody types.
fn typed(arguments: &[&str], keys: &str) -> Ran {
    let terminal = nix::pty::openpty(None, None).expect("a terminal");
    File::from(terminal.master.try_clone().expect("a copy"))
        .write_all(keys.as_bytes())
        .expect("it takes keys");
    let child = command(arguments)
        .stdin(terminal.slave)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("gaugefs runs");
    Ran::of(child.wait_with_output().expect("it ends"))
}

#[test]
fn every_part_with_a_boot_loader_is_brought_back_in_simulation() {
    let folder = Folder::new();
    let chips: Vec<&Chip> = CHIPS.iter().copied().filter(|chip| chip.firmware_file.is_some()).collect();
    assert!(chips.iter().any(|chip| chip.name == CHIP), "the part of the documents is one");
    // Each takes as long as its flash does.
    std::thread::scope(|scope| {
        for (chip, style) in chips.iter().zip([Style::Row, Style::Word].into_iter().cycle()) {
            let path = whole_file(&folder, chip, style);
            scope.spawn(move || {
                let said = gaugefs(&["rescue", &path, "--sim", chip.name, "--yes"]).done();
                let lines: Vec<&str> = said.lines().collect();
                assert!(lines[0].contains("whole firmware 0x") && lines[0].contains(chip.model), "{said}");
                assert!(lines[1].starts_with("simulated gauge, address 0x0b: a gauge in ROM mode"), "{said}");
                assert_eq!(said.matches(" %\n").count(), 10, "{said}");
                assert!(said.contains("\n100 %\nThe gauge answers at 0x55 again: device type 0x"), "{said}");
                assert!(
                    said.ends_with("Check its calibration and change its keys before you use the pack.\n")
                );
            });
        }
    });
}

#[test]
fn a_rescue_asks_before_it_erases_anything() {
    let folder = Folder::new();
    let chip = Chip::by_name(CHIP).expect("a chip");
    let path = whole_file(&folder, chip, Style::Row);
    let arguments = ["rescue", &path, "--sim", CHIP];
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let Ran { code, out, err, .. } = typed(&arguments, "no\n");
            assert!(
                code == Some(1) && err.contains("nothing was erased") && !out.contains(" %"),
                "{out}{err}"
            );
            assert!(out.contains("Is it a bq34z100-G1? Type yes to go on: "), "{out}");
        });
        scope.spawn(|| {
            let Ran { code, out, err, .. } = typed(&arguments, "yes\n");
            assert!(code == Some(0) && out.contains("\nThe gauge answers at 0x55 again"), "{out}{err}");
        });
        // Nobody is there to answer.
        scope.spawn(|| {
            let Ran { code, out, err, .. } = gaugefs(&arguments);
            assert!(code == Some(1) && err.contains("or pass --yes") && !out.contains(" %"), "{out}{err}");
        });
    });
}

/// What is in the file of another part, or in half a file, never reaches even a simulated gauge.
#[test]
fn a_rescue_refuses_a_file_that_is_not_whole_or_another_parts() {
    let folder = Folder::new();
    let chip = Chip::by_name(CHIP).expect("a chip");
    let path = whole_file(&folder, chip, Style::Row);
    gaugefs(&["rescue", &path, "--sim", "bq27520-g3", "--yes"]).failed(&["bq34z100-g1.bq.fs", "0x"]);
    let half = folder.file("half.bq.fs");
    let text = fs::read_to_string(&path).expect("the file");
    let cut = text[..text.len() / 2].rfind('\n').expect("lines") + 1;
    fs::write(&half, &text[..cut]).expect("a file");
    gaugefs(&["rescue", &half, "--sim", CHIP, "--yes"]).failed(&["half.bq.fs"]);
    // The same file is an image of data flash, if somebody says so, and nothing else takes its firmware.
    gaugefs(&["lint", &path]).failed(&["--data-flash"]);
    let ran = gaugefs(&["lint", "--data-flash", &path]);
    assert!(ran.code == Some(0) && ran.out.starts_with("bq34z100-G1"), "{}{}", ran.out, ran.err);
}
