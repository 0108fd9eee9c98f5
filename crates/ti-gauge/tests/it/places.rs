// SPDX-License-Identifier: MIT

//! Journals of several packs, places and hosts in one folder: each stays until its own pack has been settled.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::panic::resume_unwind;
use std::time::Duration;

use gauge_bus::Bus;
use gauge_bus::clock::Clock;
use ti_gauge::chip::{CHIPS, Kind, Subclass};
use ti_gauge::codec;
use ti_gauge::dataflash::{Change, DataFlash, Decision, Limits, Row, erased};
use ti_gauge::gauge::{Gauge, Seal};
use ti_gauge::journal::Journal;
use ti_gauge::keys::Keys;

use crate::rig::{Rig, cause};
use crate::room::{Folder, PowerCut, until_cut};
use crate::room::{half_way, programs, two_blocks};

const CHIP: &str = "bq34z100-g1";

impl Rig {
    /// A program starts at the place of a journal, and the gauge arrives.
    fn comes_to(&mut self, journal: Journal) -> ti_gauge::error::Result<Option<String>> {
        self.pause(5);
        self.gauge =
            Gauge::new(self.gauge.chip, Box::new(self.sim.bus()), self.clock.clone(), Keys::default());
        self.dataflash = DataFlash::new(Limits::default(), Some(journal));
        self.arrive()
    }
}

/// A new pack that has lost its power while a row was programmed: the row is erased.
fn torn(folder: &Folder) -> Rig {
    let mut rig = Rig::new(CHIP);
    rig.set("tear", "erased");
    rig.start(folder);
    rig.arrive().expect("nothing to settle");
    rig.set("fault", "torn-commit 5");
    let changes = two_blocks(&rig);
    assert_eq!(cause(&rig.write_all(&changes).expect_err("it is torn")), "state-unknown");
    rig.set("power", "on");
    rig.pause(3);
    rig
}

/// A torn write, after the end of the program that made it.
fn left_torn(folder: &Folder) -> Rig {
    Rig { dataflash: DataFlash::default(), ..torn(folder) }
}

/// The pack is left to a person, who has the old values written.
fn is_left_to_a_person(rig: &mut Rig, folder: &Folder, at: &str) {
    let flash = rig.sim.flash();
    let owed = rig.dataflash.owed().unwrap_or_else(|| panic!("{at}: nothing is owed"));
    assert!(owed.needs_decision && owed.why.contains("gaugefs settle"), "{at}: {}", owed.why);
    assert_eq!(cause(&rig.write(58, 3, "0x5a").expect_err(at)), "busy", "{at}");
    assert!(rig.sim.flash() == flash, "{at}");
    rig.dataflash.decide(&mut rig.gauge, Decision::Undo(None), Duration::ZERO).expect(at);
    assert_eq!(rig.read(48, 11), Ok(vec![0x03, 0xe8]), "{at}");
    assert_eq!(folder.files(), Vec::<String>::new(), "{at}");
    rig.write(58, 3, "0x5a").expect(at);
}

/// Two packs alike: the journal of the first one was put aside for the second one, and nobody looked at it again.
#[test]
fn regression_a_torn_pack_was_taken_for_whole_after_another_one_had_been_there() {
    for place in ["i2c-1-55", "i2c-2-55"] {
        let folder = Folder::new("back");
        let mut first = left_torn(&folder);
        let mut second = Rig::new(CHIP);
        second.comes_to(folder.journal()).expect("it is whole").expect("there is a journal");
        assert_eq!(folder.files(), ["i2c-1-55.waiting"]);
        second.write(80, 53, "3200").expect("it is another pack");
        // It is not looked at before somebody looks at data flash.
        first.comes_to(folder.at(place)).expect("mounting opens no gauge");
        assert_eq!((first.seal(), first.dataflash.owed().is_some()), (Seal::Sealed, false));
        first.read(80, 53).expect("it can be read");
        is_left_to_a_person(&mut first, &folder, place);
        // The same with a write.
        let mut first = left_torn(&folder);
        Rig::new(CHIP).comes_to(folder.journal()).expect("it is whole");
        first.comes_to(folder.at(place)).expect("mounting opens no gauge");
        assert_eq!(cause(&first.write(80, 53, "3200").expect_err("it is torn")), "busy");
        is_left_to_a_person(&mut first, &folder, place);
    }
}

/// In one and the same mount.
#[test]
fn regression_a_torn_pack_that_comes_back_to_a_mount_is_noticed() {
    let folder = Folder::new("mount");
    let first = torn(&folder);
    let mut rig = Rig { dataflash: first.dataflash, ..Rig::new(CHIP) };
    rig.arrive().expect("it is whole").expect("there is a journal");
    assert_eq!(folder.files(), ["i2c-1-55.waiting"]);
    rig.write(80, 53, "3200").expect("it is another pack");
    let mut rig = Rig { dataflash: rig.dataflash, ..first };
    rig.arrive().expect("mounting opens no gauge");
    rig.read(80, 53).expect("it can be read");
    is_left_to_a_person(&mut rig, &folder, "in a mount");
}

#[test]
fn regression_the_journal_of_another_place_is_found_by_its_marks() {
    let folder = Folder::new("moved");
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    let old = rig.sim.flash();
    half_way(&mut rig, &folder);
    // Another pack at another place is not kept from anything, and the journal stays.
    for calibration in [None, Some(5)] {
        let mut other = Rig::new(CHIP);
        if let Some(offset) = calibration {
            other.calibrate(offset);
        }
        assert_eq!(other.comes_to(folder.at("i2c-7-55")), Ok(None));
        other.write(80, 53, "3200").expect("it is another pack");
        assert_eq!(folder.files(), ["i2c-1-55.journal"]);
    }
    let told =
        rig.comes_to(folder.at("i2c-7-55")).expect("nothing is in the way").expect("there is a journal");
    assert!(told.contains("the old values were restored"), "{told}");
    assert!(rig.sim.flash() == old);
    assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec![]));
}

/// The number of an adapter is another one after a start of the host, and the gauge was left open.
#[test]
fn a_gauge_that_was_left_open_is_sealed_under_another_number_of_its_adapter() {
    for (serial, is_sealed) in [([0x12, 0x34], true), ([0x00, 0x01], false)] {
        let folder = Folder::new("number");
        let mut rig = Rig::new(CHIP);
        rig.sim.set_flash(48, 4, &serial);
        rig.power_cycle();
        rig.start_with(&folder, Keys::default(), |bus, _, write, read| {
            let done = bus.transfer(write, read);
            if matches!(write, [0x3E, ..]) {
                resume_unwind(Box::new(PowerCut));
            }
            done
        });
        rig.arrive().expect("nothing to settle");
        assert!(until_cut(|| rig.read(80, 53)).is_none());
        assert_eq!((rig.get("seal"), folder.files()), ("unsealed".into(), vec!["i2c-1-55.journal".into()]));
        rig.comes_to(folder.at("i2c-7-55")).expect("nothing is in the way");
        // A new pack's number says nothing, and somebody may have opened this one.
        assert_eq!(rig.seal() == Seal::Sealed, is_sealed);
        assert_eq!(folder.files().is_empty(), is_sealed);
    }
}

#[test]
fn regression_a_journal_that_was_put_aside_is_never_replaced() {
    let folder = Folder::new("numbered");
    for number in 0..3 {
        let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
        half_way(&mut rig, &folder);
        rig.dataflash.decide(&mut rig.gauge, Decision::Discard, Duration::ZERO).expect("a folder");
        assert_eq!(folder.files().len(), number + 1);
    }
    assert_eq!(folder.files(), ["i2c-1-55.1.dismissed", "i2c-1-55.2.dismissed", "i2c-1-55.dismissed"]);
    for number in 0..3 {
        half_way(&mut Rig::new(CHIP), &folder);
        Rig::new(CHIP).comes_to(folder.journal()).expect("it is whole");
        assert_eq!(folder.files().len(), number + 4);
    }
}

/// All of it is on disk, so blocks may have been written.
#[test]
fn regression_a_complete_plan_with_a_wrong_digit_is_kept_for_a_person() {
    let wrong: [(&str, &str); 4] = [
        ("block 80 32 ", "block 81 0 "),
        ("\nend ", "\nend 0"),
        ("\nmark 104", "\nmark 105"),
        ("reset t", "reset f"),
    ];
    for (from, to) in wrong {
        let folder = Folder::new("digit");
        let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
        half_way(&mut rig, &folder);
        let (flash, whole) = (rig.sim.flash(), folder.text().expect("a journal"));
        folder.edit(|text| text.replacen(from, to, 1));
        let changed = folder.text();
        assert_ne!(changed.as_ref(), Some(&whole), "{to}");
        let error = rig.comes_to(folder.journal()).expect_err(to);
        assert_eq!((cause(&error), folder.text()), ("busy", changed), "{to}: {error}");
        assert_eq!(cause(&rig.write(58, 3, "0x5a").expect_err(to)), "busy", "{to}");
        assert!(rig.sim.flash() == flash, "{to}");
        // What a person has corrected, or moved away, counts at once.
        folder.edit(|_| whole);
        rig.settle().expect(to).expect(to);
        assert_eq!(rig.read(48, 11), Ok(vec![0x03, 0xe8]), "{to}");
    }
}

#[test]
fn regression_an_unreadable_journal_that_was_moved_away_stops_nothing() {
    let folder = Folder::new("moved-away");
    fs::create_dir_all(folder.path()).expect("a folder");
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    fs::write(folder.journal().path(), "what is this").expect("a file");
    let error = rig.comes_to(folder.journal()).expect_err("it cannot be read").to_string();
    assert!(error.contains("move it away"), "{error}");
    assert_eq!(cause(&rig.write(58, 3, "0x5a").expect_err("it is there")), "busy");
    fs::rename(folder.journal().path(), folder.path().join("elsewhere")).expect("it is there");
    rig.write(58, 3, "0x5a").expect("it is gone");
    assert!(rig.dataflash.owed().is_none());
}

/// Whoever may write to the folder may also make what never ends.
#[test]
fn a_journal_that_is_too_long_is_not_read_and_blocks_writes() {
    let folder = Folder::new("too-long");
    fs::create_dir_all(folder.path()).expect("a folder");
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    let path = folder.journal().path();
    let long = fs::File::create(&path).expect("a file");
    long.set_len((256 << 20) + 1).expect("a file system with holes");
    let error = rig.comes_to(folder.journal()).expect_err("it cannot be read").to_string();
    assert!(error.contains("longer than 256 MiB"), "{error}");
    let flash = rig.sim.flash();
    assert_eq!(cause(&rig.write(58, 3, "0x5a").expect_err("it is there")), "busy");
    assert!(rig.sim.flash() == flash && path.exists());
    // One that can be read is no journal for another reason, which the message has.
    long.set_len(256 << 10).expect("shorter");
    let error = rig.comes_to(folder.journal()).expect_err("it is no journal").to_string();
    assert!(error.contains("not a whole journal"), "{error}");
    fs::remove_file(&path).expect("it is there");
    rig.write(58, 3, "0x5a").expect("it is gone");
}

/// Two hosts with one folder, and the same place on both; or two containers of one host.
#[test]
fn regression_the_journal_of_a_write_in_progress_was_taken_for_one_left_behind() {
    for (host, is_other) in [("bench-2", true), ("", false)] {
        let folder = Folder::new("hosts");
        let journal = folder.journal();
        let mut rig = Rig::new(CHIP);
        let changes = two_blocks(&rig);
        let (other, second) = if is_other {
            (folder.journal().of_host(host), folder.journal().of_host(host))
        } else {
            (folder.journal(), folder.journal())
        };
        let (mut once, mut third) = (Some((other, second)), Rig::new(CHIP));
        let path = folder.path().to_path_buf();
        rig.start_with(&folder, Keys::default(), move |bus, _, write, read| {
            let done = bus.transfer(write, read);
            if programs(write)
                && let Some((other, second)) = once.take()
            {
                let before = fs::read(path.join("i2c-1-55.journal")).expect("it is in progress");
                let arrived = third.comes_to(other);
                if is_other {
                    assert_eq!(arrived, Ok(None), "it is another host's");
                    third.write(80, 53, "3300").expect("it is another gauge");
                } else {
                    let error = arrived.expect_err("it is at work on a gauge at that place").to_string();
                    assert!(error.contains("another gaugefs"), "{error}");
                    third.write(80, 53, "3300").expect_err("it is at work on a gauge at that place");
                    third.comes_to(second).expect_err("the same");
                }
                assert_eq!(fs::read(path.join("i2c-1-55.journal")).ok(), Some(before));
            }
            done
        });
        rig.write_all(&changes).expect("it is left alone");
        assert_eq!(folder.files(), Vec::<String>::new());
        assert!(!journal.path().exists());
    }
}

/// Another host has lost its power in a write. What it has left is of none of this host's gauges, unless it shows.
#[test]
fn the_journal_of_another_host_stops_no_other_gauge() {
    let folder = Folder::new("other-host");
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    half_way(&mut rig, &folder);
    let mut other = Rig::new(CHIP);
    // It can be told from a new one, also after the silence below.
    other.calibrate(5);
    assert_eq!(other.comes_to(folder.journal().of_host("bench-2")), Ok(None));
    let changes = two_blocks(&other);
    let changed = other.write_all(&changes);
    changed.expect("it is another gauge");
    assert_eq!(folder.files(), ["i2c-1-55.journal"]);
    // It is interrupted as well, and has a name of its own.
    let (path, mut names) = (folder.path().to_path_buf(), Vec::new());
    other.dataflash = DataFlash::new(Limits::default(), Some(folder.journal().of_host("bench-2")));
    let change = other.change(80, 53, "3300");
    other.sim.set("fault", "silence 60 60000").expect("a knob");
    let _ = other.write_all(&[change]).expect_err("it is silent");
    names.extend(fs::read_dir(&path).expect("a folder").map(|entry| entry.expect("an entry").file_name()));
    assert!(names.len() == 2 || other.dataflash.owed().is_none(), "{names:?}");
    other.pause(90);
    other.settle().expect("it answers");
    assert_eq!(folder.files(), ["i2c-1-55.journal"]);
    // The pack itself is found at the other host.
    rig.comes_to(folder.at("i2c-3-55").of_host("bench-2"))
        .expect("nothing is in the way")
        .expect("its journal");
    assert_eq!(folder.files(), Vec::<String>::new());
}

/// Anybody could have written bytes for a pack there.
#[test]
fn regression_a_journal_that_others_may_write_was_believed() {
    for what in ["folder", "file", "owner"] {
        let folder = Folder::new("others");
        let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
        half_way(&mut rig, &folder);
        let (flash, path) = (rig.sim.flash(), folder.journal().path());
        let mode = |path: &std::path::Path, mode| {
            fs::set_permissions(path, fs::Permissions::from_mode(mode)).expect("it is our own");
        };
        match what {
            "folder" => mode(folder.path(), 0o777),
            "file" => mode(&path, 0o622),
            _ => match std::os::unix::fs::chown(&path, Some(65534), None) {
                Ok(()) => {}
                Err(error) => {
                    eprintln!("SKIPPED: only root can give a file away: {error}");
                    continue;
                }
            },
        }
        let error = rig.comes_to(folder.journal()).expect_err(what).to_string();
        let why =
            if what == "owner" { "belongs to another account (uid 65534)" } else { "others may write to it" };
        assert!(error.contains(why) && error.contains("--state-dir"), "{what}: {error}");
        assert!(rig.write(58, 3, "0x5a").is_err() && rig.sim.flash() == flash, "{what}");
        // A reader is not kept out, and what was corrected counts at once.
        rig.read(80, 53).expect(what);
        if what == "owner" {
            let mut trusting = Rig::calibrated(CHIP, Seal::Sealed);
            trusting.sim.set_flash(48, 11, &2200_u16.to_be_bytes());
            let told = trusting.comes_to(folder.journal().trusting(|| Some(65534)));
            told.expect("it is trusted").expect("it is half way");
            continue;
        }
        mode(folder.path(), 0o700);
        mode(&path, 0o600);
        rig.settle().expect(what).expect(what);
    }
    // Without a journal the folder is not written to.
    let folder = Folder::new("others");
    fs::create_dir_all(folder.path()).expect("a folder");
    fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o770)).expect("it is our own");
    let mut rig = Rig::new(CHIP);
    rig.comes_to(folder.journal()).expect("there is no journal");
    assert_eq!(cause(&rig.write(80, 53, "3200").expect_err("others may write there")), "not-permitted");
    rig.read(80, 53).expect("it can be read");
}

/// As an earlier version has left it.
#[test]
fn a_journal_of_version_2_is_settled() {
    let folder = Folder::new("version");
    let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
    let old = rig.sim.flash();
    half_way(&mut rig, &folder);
    folder.edit(|text| {
        let lines = text.lines().filter(|line| !line.starts_with("host "));
        lines.map(|line| line.replace("journal 3", "journal 2") + "\n").collect()
    });
    rig.comes_to(folder.journal()).expect("nothing is in the way").expect("there is a journal");
    assert!(rig.sim.flash() == old);
    assert_eq!((rig.seal(), folder.files()), (Seal::Sealed, vec![]));
}

/// The bytes of a parameter, by a function that reads a subclass.
fn content(rig: &mut Rig) -> impl Fn(Row) -> Option<Vec<u8>> + use<> {
    let chip = rig.gauge.chip;
    let rows: Vec<&Subclass> = chip.subclasses.iter().filter(|row| row.kind != Kind::Security).collect();
    let read = rig.dataflash.read(&mut rig.gauge, &rows, Duration::ZERO).expect("the default key");
    move |(subclass, parameter)| {
        let at = rows.iter().position(|row| std::ptr::eq(*row, subclass))?;
        let start = usize::from(parameter.offset - subclass.start());
        Some(read[at][start..start + parameter.kind.size()].to_vec())
    }
}

#[test]
fn no_new_pack_counts_as_erased() {
    for chip in CHIPS {
        let lost = erased(chip, content(&mut Rig::new(chip.name)));
        let names: Vec<_> = lost.iter().map(|(_, parameter)| parameter.name).collect();
        assert!(names.is_empty(), "{}: {names:?}", chip.name);
    }
}

/// A row that was erased without a journal, or whose journal is lost.
#[test]
fn regression_a_write_beside_erased_parameters_was_made() {
    // The second row of IT Cfg from some place on; Cell Terminate Voltage is at 53.
    for from in [32, 40, 53] {
        let mut rig = Rig::calibrated(CHIP, Seal::Sealed);
        let whole = content(&mut rig);
        rig.sim.set_flash(80, from, &vec![0xff; 64 - from]);
        let flash = rig.sim.flash();
        let now = content(&mut rig);
        let lost = erased(rig.gauge.chip, &now);
        assert!(!lost.is_empty() && lost.iter().all(|(subclass, _)| subclass.id == 80), "{from}");
        let error = rig.write(80, 53, "3100").map(drop);
        if lost.iter().any(|(_, parameter)| parameter.offset != 53) {
            let error = error.expect_err("the rest of the row stays erased");
            assert_eq!(cause(&error), "bad-checksum", "{error}");
            assert!(error.to_string().contains("subclass 80 offset 32"), "{error}");
            assert!(rig.sim.flash() == flash);
        }
        // All of them together.
        let inside = |row: &Row| usize::from(row.1.offset) >= from && usize::from(row.1.offset) < 64;
        let it = rig.gauge.chip.subclasses.iter().filter(|subclass| subclass.id == 80);
        let rows = it.flat_map(|subclass| subclass.parameters.iter().map(move |one| (subclass, one)));
        let changes: Vec<Change> = rows
            .filter(inside)
            .map(|row| {
                let value = codec::Layout::TI.decode(row.1.kind, &whole(row).expect("it was read"));
                Change::of_value(rig.gauge.chip, row, &value, true).expect("a value in range")
            })
            .collect();
        rig.write_all(&changes).expect("it is whole then");
        assert!(erased(rig.gauge.chip, content(&mut rig)).is_empty());
    }
}

/// A line that has torn many packs keeps the journals of all of them. The next pack is compared with all in the time of
/// one reading, and passes; the last torn one, when it is back, is found among them.
#[test]
fn regression_a_pack_was_not_read_beside_the_journals_of_many_others() {
    let folder = Folder::new("many");
    let mut last = None;
    for number in 0..30 {
        let mut rig = Rig::new(CHIP);
        rig.set("tear", "erased");
        rig.dataflash =
            DataFlash::new(Limits::default(), Some(folder.at(&format!("i2c-{}-55", 100 + number))));
        rig.set("fault", "torn-commit 5");
        let changes = two_blocks(&rig);
        assert_eq!(cause(&rig.write_all(&changes).expect_err("it is torn")), "state-unknown");
        rig.set("power", "on");
        rig.pause(3);
        last = Some(rig);
    }
    assert_eq!(folder.files().len(), 30);
    let mut rig = Rig::new(CHIP);
    rig.start(&folder);
    rig.arrive().expect("nothing of it is in any of them");
    let begun = rig.clock.now();
    rig.read(80, 53).expect("it is read");
    rig.write(80, 53, "3100").expect("it is written");
    assert!(rig.clock.now() - begun < Duration::from_secs(8), "{:?}", rig.clock.now() - begun);
    assert_eq!(folder.files().len(), 30);
    let mut torn = last.expect("thirty of them");
    torn.dataflash = DataFlash::default();
    let error = torn.comes_to(folder.journal()).expect_err("a person decides");
    assert!(error.to_string().contains("every new one"), "{error}");
}
