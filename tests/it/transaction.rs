// SPDX-License-Identifier: MIT

//! `df/transaction`, used through the tree as the mount uses it, on a simulated clock.

use std::sync::{Arc, mpsc};
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_owner::{self as owner, Handle, Run};
use gauge_sim::{Options, Sim};
use gaugefs::fs::{Access, Caller, Fs, Node, Process, Supply};
use nix::errno::Errno;
use ti_gauge::chip::Chip;
use ti_gauge::keys::Keys;

struct Tree {
    clock: Arc<SimClock>,
    sim: Sim,
    handle: Handle,
    fs: Arc<Fs>,
}

impl Tree {
    fn new(chip: &str, keys: Keys) -> Self {
        let clock = Arc::new(SimClock::new());
        let sim = Sim::new(chip, &Options::default(), clock.clone()).expect("a simulated chip");
        clock.sleep(Duration::from_secs(1));
        let table = Chip::by_name(chip).expect("a chip of the tables");
        let interval = Duration::from_secs(3600);
        let run = Run { keys, interval, ..Run::default() };
        let handle = owner::spawn(table, Box::new(sim.bus()), clock.clone(), run, Arc::default());
        let handle = handle.expect("a gauge");
        let entry = Supply::new("BAT0".into(), handle.clone());
        let access = Access { uid: 0, gid: 0, group: false };
        let fs = Arc::new(Fs::new(vec![entry], access));
        Self { clock, sim, handle, fs }
    }

    fn node(&self, path: &str) -> Node {
        let names = ["BAT0"].into_iter().chain(path.split('/'));
        names.fold(Node::Root, |folder, name| self.fs.lookup(folder, name).expect(path))
    }

    fn write(&self, path: &str, text: &str) -> Result<(), Errno> {
        let outcome = self.writes(own(1), path, text);
        self.close(own(1));
        outcome
    }

    /// Writes through an open file, which stays open.
    fn writes(&self, caller: Caller, path: &str, text: &str) -> Result<(), Errno> {
        let (done, is_done) = mpsc::channel();
        let answer = Box::new(move |outcome| done.send(outcome).expect("somebody waits"));
        self.fs.write(self.node(path), caller, 0, text.as_bytes(), answer);
        is_done.recv().expect("an answer").map_err(|error| Errno::from_raw(error.errno()))
    }

    fn close(&self, caller: Caller) {
        self.fs.close(self.node("df/transaction"), caller.file);
    }

    /// Writes lines, the last of which gets its newline here, as a shell that opens the file for them.
    fn stage(&self, lines: &str) -> Result<(), Errno> {
        self.write("df/transaction", &format!("{}\n", lines.trim_end_matches('\n')))
    }

    fn read(&self, path: &str) -> Result<String, Errno> {
        self.bytes(path).map(|bytes| String::from_utf8(bytes).expect("text"))
    }

    fn read_bytes(&self, path: &str) -> Vec<u8> {
        self.bytes(path).expect(path)
    }

    fn bytes(&self, path: &str) -> Result<Vec<u8>, Errno> {
        let (done, is_done) = mpsc::channel();
        let answer = Box::new(move |outcome| done.send(outcome).expect("somebody waits"));
        self.fs.read(self.node(path), answer);
        let read = is_done.recv().expect("an answer");
        read.map(|bytes| bytes.to_vec()).map_err(|error| Errno::from_raw(error.errno()))
    }

    fn count(&self, wanted: &str) -> u64 {
        self.handle.statistics().iter().find(|(name, _)| *name == wanted).expect("it is counted").1
    }
}

/// An open file of this process.
fn own(file: u64) -> Caller {
    Caller { file, process: Process::of_thread(std::process::id()) }
}

/// An open file of nobody who can be seen.
fn unseen(file: u64) -> Caller {
    Caller { file, process: None }
}

fn tree(chip: &str) -> Tree {
    Tree::new(chip, Keys::default())
}

/// Three parameters in two blocks, in one write: each block is programmed once, with one reset.
#[test]
fn each_block_is_programmed_once() {
    let tree = tree("bq34z100-g1");
    assert_eq!(tree.stage("begin\n80/53 3100\n48/11 2200\n48/13 8000\ncommit\n"), Ok(()));
    assert_eq!((tree.count("flash_writes"), tree.count("resets")), (2, 1));
    for (path, text) in [("df/80/53", "3100\n"), ("df/48/11", "2200\n"), ("df/48/13", "8000\n")] {
        assert_eq!(tree.read(path).as_deref(), Ok(text), "{path}");
    }
    assert_eq!(tree.read("df/transaction").as_deref(), Ok("idle\n"));
    // Values that are already stored cause no programming, and neither does an empty transaction.
    assert_eq!(tree.stage("begin\n80/53 3100\ncommit"), Ok(()));
    assert_eq!(tree.stage("begin\ncommit"), Ok(()));
    assert_eq!((tree.count("flash_writes"), tree.count("resets")), (2, 1));
}

#[test]
fn a_flat_part_is_addressed_by_its_path_in_df() {
    let tree = tree("bq34110");
    assert_eq!(tree.stage("begin\nflash/0x41f5 3100\n"), Ok(()));
    let staged = tree.read("df/transaction").expect("readable");
    assert!(staged.ends_with(" -> 3100\n"), "{staged}");
    assert_eq!(tree.stage("commit"), Ok(()));
    assert_eq!(tree.read("df/flash/0x41f5").as_deref(), Ok("3100\n"));
}

/// A write with a refused line stages nothing, and causes no transfer.
#[test]
fn lines_are_checked_at_once() {
    let tree = tree("bq34z100-g1");
    // The first one reads what the pack is known by.
    assert_eq!(tree.stage("begin\nabort"), Ok(()));
    let (flash, transfers) = (tree.sim.flash(), tree.count("transfers"));
    for line in ["commit", "abort", "80/53 3100", "nonsense"] {
        assert_eq!(tree.stage(line), Err(Errno::ENODATA), "{line}");
    }
    assert_eq!(tree.stage("begin\n80/53 9999\n"), Err(Errno::ERANGE));
    assert_eq!(tree.stage("commit\n"), Err(Errno::ERANGE), "nothing was begun");
    assert_eq!(tree.read("df/transaction").as_deref(), Ok("idle\n"));
    assert_eq!(tree.stage("begin\n"), Ok(()));
    for (line, errno) in [
        ("begin", Errno::EBUSY),
        ("80/53", Errno::EINVAL),
        ("80/53 abc", Errno::EINVAL),
        ("80/53 3701", Errno::ERANGE),
        ("80/54 1", Errno::ENOENT),
        ("80 53 1", Errno::EINVAL),
        ("112/0 0x0", Errno::EPERM),
        ("104/14 0", Errno::ERANGE),
        ("nonsense", Errno::EINVAL),
        ("80/53 3100\n80/53 1", Errno::ERANGE),
        ("commit\n80/53 3100", Errno::EINVAL),
    ] {
        assert_eq!(tree.stage(line), Err(errno), "{line}");
        assert_eq!(tree.read("df/transaction").as_deref(), Ok(""), "{line}");
    }
    for text in ["80/53 3100", "80/53 3100\n80/53 31", "abort", "commit", " "] {
        assert_eq!(tree.write("df/transaction", text), Err(Errno::EINVAL), "the last line may go on");
        assert!(tree.handle.published().last_error.contains("df/transaction: the last line has no newline"));
        assert_eq!(tree.read("df/transaction").as_deref(), Ok(""), "{text}");
    }
    assert_eq!(tree.write("df/80/53", "3100"), Err(Errno::EBUSY));
    assert_eq!(tree.stage("80/53 3200\n\n 80/53  0xc1c \n"), Ok(()));
    assert_eq!(tree.stage("abort"), Ok(()));
    assert_eq!(tree.count("transfers"), transfers, "nothing was sent");
    assert!(tree.sim.flash() == flash);
}

#[test]
fn a_line_names_its_parameter_by_place_or_by_name() {
    let tree = tree("bq34z100-g1");
    for (line, value) in [
        ("80/53 3100", "3100"),
        ("it-cfg/cell-terminate-voltage 3101", "3101"),
        ("by-name/it-cfg/cell-terminate-voltage 3102", "3102"),
        ("cell-terminate-voltage\t3103", "3103"),
        ("IT-Cfg/Cell-Terminate-Voltage 0xc20", "3104"),
    ] {
        assert_eq!(tree.stage(&format!("begin\n{line}\n")), Ok(()), "{line}");
        let staged = tree.read("df/transaction").expect("readable");
        assert_eq!(staged, format!("Cell Terminate Voltage: 3000 -> {value}\n"), "{line}");
        assert_eq!(tree.stage("abort\n"), Ok(()));
    }
    // The same parameter twice is one change, however it is named.
    assert_eq!(tree.stage("begin\n80/53 3100\nit-cfg/cell-terminate-voltage 3200\ncommit\n"), Ok(()));
    assert_eq!(tree.read("df/80/53").as_deref(), Ok("3200\n"));
    for (line, errno, says) in [
        ("it-cfg/cell-terminate-voltag 1", Errno::ENOENT, "did you mean 80/53 (Cell Terminate Voltage)?"),
        ("cell-terminate-volt 1", Errno::ENOENT, "did you mean 80/53 (Cell Terminate Voltage)?"),
        ("codes/sealed-to-unsealed 1", Errno::EPERM, "keys cannot be changed"),
        ("it-cfg/cell-terminate-voltage 3.1V", Errno::EINVAL, "write the number in mV: 3100"),
        ("it-cfg/cell-terminate-voltage", Errno::EINVAL, "whole number"),
        ("nonsense 1", Errno::EINVAL, "CLASS/NAME VALUE"),
    ] {
        assert_eq!(tree.stage(&format!("begin\n{line}\n")), Err(errno), "{line}");
        let told = tree.handle.published().last_error.clone();
        assert!(told.contains("line 2: ") && told.contains(says), "{line}: {told}");
    }
}

/// The limit below which the gauge would store nothing is that of the parameter, whatever it is called.
#[test]
fn a_name_does_not_pass_by_what_a_place_is_checked_for() {
    let tree = tree("bq34z100-g1");
    let row = Chip::by_name("bq34z100-g1").and_then(|chip| chip.row("104", "14")).expect("Voltage Divider");
    let name = ti_gauge::chip::kebab_case(row.1.name);
    for place in ["104/14", &name] {
        assert_eq!(tree.stage(&format!("begin\n{place} 0\n")), Err(Errno::ERANGE), "{place}");
    }
}

#[test]
fn a_name_that_several_classes_have_is_refused_with_all_of_them() {
    for chip in ti_gauge::chip::CHIPS {
        let names: Vec<String> = chip.rows().map(|row| ti_gauge::chip::kebab_case(row.1.name)).collect();
        let Some(twice) = names.iter().find(|name| names.iter().filter(|other| other == name).count() > 1)
        else {
            continue;
        };
        let tree = tree(chip.name);
        assert_eq!(tree.stage(&format!("begin\n{twice} 1\n")), Err(Errno::EINVAL), "{} {twice}", chip.name);
        let told = tree.handle.published().last_error.clone();
        assert!(told.contains("several parameters have that name; write one of "), "{told}");
        assert!(told.matches(&format!("/{twice}")).count() > 1, "{told}");
    }
}

#[test]
fn an_unproven_parameter_is_not_staged() {
    let tree = tree("bq34110");
    let rows = Chip::by_name("bq34110").expect("a table").subclasses.iter();
    let row = rows.flat_map(|row| row.parameters).find(|row| row.unproven).expect("there are some");
    assert_eq!(tree.stage(&format!("begin\nflash/0x{:04x} 1\n", row.offset)), Err(Errno::EACCES));
}

#[test]
fn an_unknown_parameter_is_not_staged_and_the_nearest_one_is_named() {
    let tree = tree("bq34z100-g1");
    assert_eq!(tree.stage("begin\n80/54 3100\n"), Err(Errno::ENOENT));
    let told = tree.handle.published().last_error.clone();
    assert!(
        told.contains("line 2: no such parameter; did you mean 80/53 (Cell Terminate Voltage)?"),
        "{told}"
    );
    assert_eq!(tree.stage("begin\n80-53 3100\n"), Err(Errno::EINVAL));
    assert_eq!(tree.stage("begin\n80/53 3100\nabort\n"), Ok(()));
    assert_eq!(*tree.handle.published().last_error, *"", "lines have been staged");
}

#[test]
fn a_transaction_is_dropped_after_ten_minutes() {
    let tree = tree("bq34z100-g1");
    assert_eq!(tree.stage("begin\n80/53 3100\n"), Ok(()));
    tree.clock.sleep(Duration::from_secs(590));
    assert_eq!(tree.stage("begin"), Err(Errno::EBUSY));
    tree.clock.sleep(Duration::from_secs(11));
    assert_eq!(tree.read("df/transaction").as_deref(), Ok("idle\n"));
    assert_eq!(tree.stage("commit"), Err(Errno::ENODATA));
    assert!(tree.handle.published().last_error.contains("10 minutes"));
    assert_eq!(tree.read("df/80/53").as_deref(), Ok("3000\n"));
    assert_eq!(tree.stage("begin\n80/53 3100\ncommit"), Ok(()));
}

/// If the second block fails, the first is put back and the transaction ends.
#[test]
fn a_failed_commit_changes_nothing() {
    let tree = tree("bq34z100-g1");
    let flash = tree.sim.flash();
    assert_eq!(tree.stage("begin\n80/53 3100\n48/11 2200\n"), Ok(()));
    tree.sim.set("voltage_mv", "2700").expect("a knob");
    assert_eq!(tree.stage("commit"), Err(Errno::EAGAIN));
    tree.sim.set("voltage_mv", "3700").expect("a knob");
    assert_eq!(tree.stage("commit"), Err(Errno::ENODATA));
    assert!(tree.sim.flash() == flash);
    assert_eq!(tree.stage("begin\n80/53 3100\n48/11 2200\n"), Ok(()));
    tree.sim.set("fault", "drop-commit").expect("a fault");
    assert_eq!(tree.stage("commit"), Err(Errno::EIO));
    assert!(tree.sim.flash() == flash);
    assert_eq!(tree.read("gauge/seal").as_deref(), Ok("sealed\n"));
}

/// Without a key the old values are unknown, but the staged values are shown.
#[test]
fn a_sealed_gauge_refuses_the_commit() {
    let tree = Tree::new("bq34z100-g1", Keys::none());
    assert_eq!(tree.stage("begin\n80/53 3100\n"), Ok(()));
    assert_eq!(tree.read("df/transaction").as_deref(), Ok("Cell Terminate Voltage: - -> 3100\n"));
    assert_eq!(tree.stage("commit"), Err(Errno::EPERM));
}

/// Reserved bits are compared when a line is staged, with the gauge's own, so that a transaction which is staged can be
/// committed.
#[test]
fn reserved_bits_are_refused_when_they_are_staged() {
    let tree = tree("bq34z100-g1");
    assert_eq!(tree.stage("begin\n80/53 3100\n64/0 0x1161\n"), Err(Errno::ERANGE));
    let why = tree.read("gauge/last_error").expect("the reason");
    assert!(why.contains("line 3: Pack Configuration (64/0): check: bits 0x1000 must not change"), "{why}");
    assert_eq!(tree.read("df/transaction").as_deref(), Ok("idle\n"), "nothing of it is staged");
    assert_eq!(tree.stage("begin\n64/0 0x0121\n"), Ok(()));
    assert_eq!(tree.stage("64/0 0x1121\n"), Err(Errno::ERANGE), "one that is kept");
    assert_eq!(tree.stage("104/14 0\n"), Err(Errno::ERANGE), "a limit");
    assert_eq!(tree.stage("begin\n64/0 0x0121\ncommit"), Ok(()));
    assert_eq!(tree.read("df/64/0").as_deref(), Ok("0x0121\n"));
    // What cannot be read is compared by the commit.
    let sealed = Tree::new("bq34z100-g1", Keys::none());
    assert_eq!(sealed.stage("begin\n64/0 0x1161\n"), Ok(()));
    assert_eq!(sealed.stage("commit"), Err(Errno::EPERM));
}

/// The bytes of Pack Configuration D's neighbours, and a subclass that the table does not have.
#[test]
fn undocumented_bytes_are_written_on_request() {
    let tree = tree("bq27427");
    assert_eq!(tree.read_bytes("df/64/raw")[10..13], [0x09, 0x04, 0x27]);
    assert_eq!(tree.stage("begin\nraw 64/10 0a05\nraw 64/12 28\n64/0 0x6479\n"), Ok(()));
    let staged = "raw 64/10: 090427 -> 0a0528\nOpConfig: 0x6478 -> 0x6479\n";
    assert_eq!(tree.read("df/transaction").as_deref(), Ok(staged));
    assert_eq!(tree.stage("commit"), Ok(()));
    assert_eq!(tree.count("flash_writes"), 1, "one block");
    assert_eq!(tree.read_bytes("df/64/raw")[10..13], [0x0a, 0x05, 0x28]);
    assert_eq!(tree.read("df/64/0").as_deref(), Ok("0x6479\n"));
    // Bytes that are already stored are not a change.
    assert_eq!(tree.stage("begin\nraw 64/10 0a0528\ncommit"), Ok(()));
    assert_eq!(tree.count("flash_writes"), 1);
}

#[test]
fn a_subclass_that_is_not_in_the_table_is_written_on_request() {
    let tree = tree("bq27520-g3");
    assert!(tree.handle.chip().subclass(82).is_none());
    let flash = tree.sim.flash();
    assert_eq!(tree.stage("begin\nraw 82/1 beef\n"), Ok(()));
    assert_eq!(tree.read("df/transaction").as_deref(), Ok("raw 82/1: - -> beef\n"));
    assert_eq!(tree.stage("commit"), Ok(()));
    let differ = |(one, other): (&u8, &u8)| one != other;
    assert_eq!(flash.iter().zip(&tree.sim.flash()).filter(|pair| differ(*pair)).count(), 2);
    assert_eq!(tree.read("gauge/seal").as_deref(), Ok("sealed\n"));
    // A subclass that the gauge does not have stores nothing, which is reported.
    assert_eq!(tree.stage("begin\nraw 200/0 01\ncommit"), Err(Errno::EIO));
}

/// Raw bytes cannot reach keys, parameters with their limits, or another block.
#[test]
fn raw_lines_reach_undocumented_bytes_only() {
    let tree = tree("bq34z100-g1");
    assert_eq!(tree.stage("begin"), Ok(()));
    let transfers = tree.count("transfers");
    for (line, errno, says) in [
        ("raw 112/24 00", Errno::EPERM, "keys"),
        ("raw 112/0 00000000", Errno::EPERM, "keys"),
        ("raw 80/53 0c1c", Errno::EINVAL, "Cell Terminate Voltage is stored there"),
        ("raw 2/9 0000", Errno::EINVAL, "is stored there"),
        ("raw 2/31 0000", Errno::EINVAL, "one block of 32 bytes"),
        ("raw 2/32 00", Errno::EINVAL, "subclass 2 ends with offset 31"),
        ("raw 200/8192 00", Errno::EINVAL, "subclass 200 ends with offset 8191"),
        ("raw 0/0 00", Errno::EINVAL, "in subclasses only"),
        ("raw 2/10", Errno::EINVAL, "HEX"),
        ("raw 2/10 0", Errno::EINVAL, "HEX"),
        ("raw 2/10 0g", Errno::EINVAL, "HEX"),
        ("raw 2/10 00 00", Errno::EINVAL, "HEX"),
        ("raw 2 00", Errno::EINVAL, "HEX"),
        ("raw 256/0 00", Errno::EINVAL, "HEX"),
    ] {
        assert_eq!(tree.stage(line), Err(errno), "{line}");
        let told = tree.handle.published().last_error.clone();
        assert!(told.contains(says), "{line}: {told}");
    }
    let long = format!("raw 200/0 {}", "00".repeat(33));
    assert_eq!(tree.stage(&long), Err(Errno::EINVAL));
    assert_eq!(tree.read("df/transaction").as_deref(), Ok(""));
    assert_eq!(tree.count("transfers"), transfers, "nothing was sent");
    let flat = self::tree("bq34110");
    assert_eq!(flat.stage("begin\nraw flash/0x41f5 00\n"), Err(Errno::EINVAL));
}

/// The kernel passes on what does not fit a page in pieces. A piece never counts as a value.
#[test]
fn a_piece_of_a_write_is_no_value() {
    let tree = tree("bq34z100-g1");
    let flash = tree.sim.flash();
    let padded = |length: usize, value: &str| " ".repeat(length - value.len()) + value;
    for path in
        ["df/48/11", "gauge/poll_interval", "gauge/seal", "gauge/control", "gauge/settle", "gauge/keys"]
    {
        let value = match path {
            "gauge/seal" => "unsealed",
            "gauge/control" => "CONTROL_STATUS",
            "gauge/settle" => "show",
            "gauge/keys" => "unseal 0414 3672 6fa1 92d4",
            _ => "22",
        };
        for (offset, length) in
            [(0, 4096), (0, 4097), (0, 8192), (0, 65536), (4090, 4102), (4000, 96), (65436, 100)]
        {
            let (done, is_done) = mpsc::channel();
            let answer = Box::new(move |outcome| done.send(outcome).expect("somebody waits"));
            tree.fs.write(tree.node(path), own(1), offset, padded(length, value).as_bytes(), answer);
            let error = is_done.recv().expect("an answer").expect_err("a piece");
            assert_eq!(error.errno(), Errno::EFBIG as i32, "{path}: {length} bytes at {offset}");
            assert!(tree.handle.published().last_error.contains("may not be whole"), "{error}");
        }
    }
    assert!(tree.sim.flash() == flash);
    assert_eq!(tree.write("df/48/11", &padded(4095, "2200")), Ok(()));
    assert_eq!(tree.read("df/48/11").as_deref(), Ok("2200\n"));
}

/// A shell writes each line by itself and goes on after one that was refused.
#[test]
fn regression_a_refused_line_spoils_the_transaction() {
    for (refused, errno) in [
        ("48/11 99999999\n", Errno::ERANGE),
        ("80/54 1\n", Errno::ENOENT),
        ("112/0 0x0\n", Errno::EPERM),
        ("nonsense\n", Errno::EINVAL),
        ("48/11 2200", Errno::EINVAL),
        ("48/11 2200\n48/11 x\n", Errno::EINVAL),
        ("commit\n48/11 2200\n", Errno::EINVAL),
        ("abort\n48/11 2200\n", Errno::ENODATA),
        ("\0\n", Errno::EINVAL),
    ] {
        let tree = tree("bq34z100-g1");
        let flash = tree.sim.flash();
        assert_eq!(tree.stage("begin\n80/53 3111"), Ok(()));
        assert_eq!(tree.write("df/transaction", refused), Err(errno), "{refused:?}");
        let reason = tree.handle.published().last_error.clone();
        let reason = reason.split_once("df/transaction: ").expect("what failed").1;
        // Another line changes nothing, whether it is refused or not; nor does a commit that fails.
        assert_eq!(tree.stage("48/13 8000"), Ok(()));
        assert_eq!(tree.stage("104/14 0"), Err(Errno::ERANGE));
        assert_eq!(tree.stage("48/13 8000\ncommit"), Err(errno), "{refused:?}");
        let told = tree.handle.published().last_error.clone();
        let until = "df/transaction: nothing is committed after a refused line until `begin` or `abort`: ";
        assert!(told.ends_with(&format!("{until}{reason}")), "{told}");
        // It has ended: others may write. Whoever goes on is still told.
        assert_eq!(tree.read("df/transaction").as_deref(), Ok("idle\n"));
        assert_eq!(tree.stage("commit"), Err(errno), "{refused:?}");
        assert_eq!(tree.stage("48/13 8000"), Err(Errno::ENODATA));
        assert_eq!(tree.stage("commit"), Err(errno), "{refused:?}");
        assert!(tree.sim.flash() == flash, "{refused:?}");
        assert_eq!(tree.count("flash_writes"), 0);
        assert_eq!(tree.write("df/48/13", "8000"), Ok(()));
        // `abort` and `begin` begin anew.
        assert_eq!(tree.stage("abort"), Ok(()));
        assert_eq!(tree.stage("commit"), Err(Errno::ENODATA));
        assert_eq!(tree.stage("begin\n80/53 3111\ncommit"), Ok(()));
        assert_eq!(tree.read("df/80/53").as_deref(), Ok("3111\n"));
        assert_eq!(tree.read("df/48/11").as_deref(), Ok("1000\n"), "{refused:?}");
    }
}

#[test]
fn a_spoiled_transaction_is_begun_anew() {
    let tree = tree("bq34z100-g1");
    for again in ["begin", "abort\nbegin", "80/53 3112\nbegin", "48/13 8000\nabort\nbegin"] {
        assert_eq!(tree.stage("begin\n48/13 8000"), Ok(()));
        assert_eq!(tree.stage("48/11 99999999"), Err(Errno::ERANGE));
        assert_eq!(tree.stage(again), Ok(()), "{again}");
        assert_eq!(tree.read("df/transaction").as_deref(), Ok(""), "{again}");
        assert_eq!(tree.stage("80/53 3111\ncommit"), Ok(()), "{again}");
        assert_eq!(tree.read("df/80/53").as_deref(), Ok("3111\n"));
        assert_eq!(tree.read("df/48/13").as_deref(), Ok("5400\n"), "{again}");
    }
    // So is one that was never begun, because its `begin` was refused with the rest of its write.
    assert_eq!(tree.stage("begin\n80/54 1"), Err(Errno::ENOENT));
    assert_eq!(tree.stage("commit"), Err(Errno::ENOENT));
    assert_eq!(tree.stage("begin\n48/11 99999999"), Err(Errno::ERANGE));
    assert_eq!(tree.stage("commit"), Err(Errno::ERANGE));
    assert_eq!(tree.stage("begin\ncommit"), Ok(()));
    // After ten minutes it is dropped like any other.
    assert_eq!(tree.stage("begin\n80/53 3112"), Ok(()));
    assert_eq!(tree.stage("48/11 99999999"), Err(Errno::ERANGE));
    tree.clock.sleep(Duration::from_secs(601));
    assert_eq!(tree.stage("commit"), Err(Errno::ENODATA));
    assert_eq!(tree.stage("commit"), Err(Errno::ENODATA));
    assert_eq!(tree.read("df/80/53").as_deref(), Ok("3111\n"));
}

/// Whoever waits for the end of a transaction with `begin` does no harm to it.
#[test]
fn a_second_begin_leaves_the_transaction_as_it_is() {
    let tree = tree("bq34z100-g1");
    assert_eq!(tree.stage("begin\n80/53 3111"), Ok(()));
    for other in ["begin", "begin", "begin\n48/11 2200\ncommit", "\n begin\nnonsense"] {
        assert_eq!(tree.stage(other), Err(Errno::EBUSY), "{other}");
    }
    assert_eq!(tree.write("df/transaction", "begin"), Err(Errno::EINVAL));
    assert_eq!(tree.stage("commit"), Ok(()));
    assert_eq!(tree.read("df/80/53").as_deref(), Ok("3111\n"));
    assert_eq!(tree.count("flash_writes"), 1);
}

/// A write is refused as a whole, wherever the kernel cuts it, or counts as a whole.
#[test]
fn lines_are_cut_at_every_position() {
    let tree = tree("bq34z100-g1");
    let text = "begin\n48/11 2200\n80/53 3100\ncommit\n";
    for cut in 1..text.len() {
        let (head, tail) = text.split_at(cut);
        let first = tree.write("df/transaction", head);
        assert_eq!(first.is_ok(), head.ends_with('\n'), "{head:?}");
        if first.is_err() {
            assert_eq!(tree.read("df/transaction").as_deref(), Ok("idle\n"), "{head:?}");
            continue;
        }
        assert_eq!(tree.write("df/transaction", tail), Ok(()), "{tail:?}");
        assert_eq!(
            (tree.read("df/48/11").as_deref(), tree.read("df/80/53").as_deref()),
            (Ok("2200\n"), Ok("3100\n"))
        );
    }
}

/// Raw bytes are limited, because the table does not limit them as it does parameters; the limit counts blocks,
/// however often they are staged.
#[test]
fn a_transaction_has_a_limit() {
    let tree = tree("bq27520-g3");
    let block = |at: usize| format!("raw {}/{} {}\n", 200 + at / 256, 32 * (at % 256), "5a".repeat(32));
    let lines: String = (0..4096).map(block).collect();
    assert_eq!(tree.stage("begin"), Ok(()));
    assert_eq!(tree.stage(&lines), Ok(()));
    let shown = tree.read("df/transaction").expect("readable");
    assert_eq!(shown.lines().count(), 4096);
    assert_eq!(tree.stage(&lines), Ok(()), "the same blocks again");
    assert_eq!(tree.stage(&block(4096)), Err(Errno::EFBIG));
    assert!(tree.handle.published().last_error.contains("4096 blocks"));
    assert_eq!(tree.stage(&format!("abort\nbegin\n{lines}{}", block(4096))), Err(Errno::EFBIG));
    assert_eq!(tree.read("df/transaction").expect("readable"), shown, "nothing of it counts");
    assert_eq!(tree.stage("abort"), Ok(()));
    assert_eq!(tree.read("df/transaction").as_deref(), Ok("idle\n"));
}

#[test]
fn bytes_staged_later_replace_the_bytes_that_they_name() {
    let tree = tree("bq27520-g3");
    assert_eq!(tree.stage("begin\nraw 82/0 000102030405\nraw 82/2 aabb\nraw 82/9 09\nabort\nbegin"), Ok(()));
    assert_eq!(tree.stage("raw 82/0 000102030405\nraw 82/2 aabb\nraw 82/9 09"), Ok(()));
    let shown = "raw 82/0: - -> 0001aabb0405\nraw 82/9: - -> 09\n";
    assert_eq!(tree.read("df/transaction").as_deref(), Ok(shown));
    assert_eq!(tree.stage("raw 82/1 ff"), Ok(()));
    assert_eq!(tree.read("df/transaction").as_deref(), Ok(shown.replace("0001", "00ff").as_str()));
}

/// It used to be written to whatever came back.
#[test]
fn regression_a_transaction_ends_when_its_gauge_leaves() {
    let tree = tree("bq34z100-g1");
    let refresh = |answers: bool| {
        let refreshed = tree.write("gauge/refresh", "1");
        assert_eq!(refreshed.is_ok(), answers, "{refreshed:?}");
        tree.clock.sleep(Duration::from_secs(1));
    };
    assert_eq!(tree.stage("begin\n80/53 3100"), Ok(()));
    // A failed poll is no gauge that has left.
    tree.sim.set("power", "off").expect("a knob");
    refresh(false);
    tree.sim.set("power", "on").expect("a knob");
    tree.clock.sleep(Duration::from_secs(3));
    refresh(true);
    assert_eq!(tree.read("df/transaction").as_deref(), Ok("Cell Terminate Voltage: 3000 -> 3100\n"));
    let before = tree.sim.flash();
    tree.sim.set("power", "off").expect("a knob");
    for _ in 0..3 {
        refresh(false);
    }
    tree.sim.set("power", "on").expect("a knob");
    tree.clock.sleep(Duration::from_secs(3));
    refresh(true);
    assert_eq!(tree.read("df/transaction").as_deref(), Ok("idle\n"));
    assert_eq!(tree.stage("commit"), Err(Errno::ENODEV));
    let why = tree.handle.published().last_error.to_string();
    assert!(why.contains("since `begin`") && why.contains("nothing was written"), "{why}");
    assert!(tree.sim.flash() == before);
    assert_eq!(tree.stage("commit"), Err(Errno::ENODATA), "it is said once");
    assert_eq!(tree.stage("begin\n80/53 3100\ncommit"), Ok(()));
    assert_eq!(tree.read("df/80/53").as_deref(), Ok("3100\n"));
}

/// What is to be changed follows from what the gauge had. A command read that from one pack, and the next one, which had
/// come meanwhile, got what the first one lacked; what it lacked itself was told as being there.
#[test]
fn regression_the_next_pack_got_what_the_first_one_lacked() {
    let tree = tree("bq34z100-g1");
    let presence = || tree.read("gauge/presence").expect("a number").trim().to_string();
    let begin = |presence: &str| tree.stage(&format!("begin {presence}\n80/53 3100\ncommit"));
    let first = presence();
    tree.sim.set("power", "off").expect("a knob");
    for _ in 0..3 {
        assert!(tree.write("gauge/refresh", "1").is_err());
        tree.clock.sleep(Duration::from_secs(1));
    }
    tree.sim.set("power", "on").expect("a knob");
    tree.clock.sleep(Duration::from_secs(3));
    assert_eq!(tree.write("gauge/refresh", "1"), Ok(()));
    let before = tree.sim.flash();
    assert_ne!(presence(), first);
    assert!(presence().parse::<i64>().is_ok_and(|number| number >= 0), "63 bits");
    assert_eq!(begin(&first), Err(Errno::ENODEV));
    let why = tree.handle.published().last_error.to_string();
    assert!(why.contains("since its values were read") && why.contains("read them again"), "{why}");
    assert!(tree.sim.flash() == before);
    assert_eq!(tree.read("df/transaction").as_deref(), Ok("idle\n"));
    for text in ["-1", "x", "1 2"] {
        assert_eq!(begin(text), Err(Errno::EINVAL), "{text}");
    }
    assert_eq!(begin(&presence()), Ok(()));
    assert_eq!(tree.read("df/80/53").as_deref(), Ok("3100\n"));
}

/// A program that runs, and another one's open files.
struct Other(std::process::Child);

impl Other {
    fn new() -> Self {
        Self(std::process::Command::new("sleep").arg("600").spawn().expect("it runs"))
    }

    fn file(&self, file: u64) -> Caller {
        Caller { file, process: Some(Process::of_thread(self.0.id()).expect("it is seen")) }
    }
}

impl Drop for Other {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

const FILE: &str = "df/transaction";

/// The second writer's line was staged in the first one's transaction, and its `commit` wrote half of that.
#[test]
fn regression_two_writers_were_mixed() {
    let other = Other::new();
    for second in [other.file(2), unseen(2), own(2)] {
        let tree = tree("bq34z100-g1");
        let first = own(1);
        assert_eq!(tree.writes(first, FILE, "begin\n"), Ok(()));
        assert_eq!(tree.writes(first, FILE, "80/53 3100\n"), Ok(()));
        for line in ["begin", "48/11 2200", "48/11 99999999", "abort", "commit", "begin\n48/11 2200\ncommit"]
        {
            assert_eq!(tree.writes(second, FILE, &format!("{line}\n")), Err(Errno::EBUSY), "{line}");
        }
        let told = tree.handle.published().last_error.clone();
        assert!(
            told.contains("until this open file is closed") && told.contains("another open file"),
            "{told}"
        );
        assert_eq!(tree.read(FILE).as_deref(), Ok("Cell Terminate Voltage: 3000 -> 3100\n"));
        assert_eq!(tree.writes(first, FILE, "commit\n"), Ok(()));
        // It goes on to the end, whatever it was answered.
        for line in ["48/11 2200\n", "commit\n", "begin\n"] {
            assert_eq!(tree.writes(second, FILE, line), Err(Errno::EBUSY), "{line}");
        }
        assert_eq!(tree.read("df/80/53").as_deref(), Ok("3100\n"));
        assert_eq!(tree.read("df/48/11").as_deref(), Ok("1000\n"));
        tree.close(second);
        assert_eq!(tree.writes(second, FILE, "begin\n48/11 2200\ncommit\n"), Ok(()));
        assert_eq!(tree.read("df/48/11").as_deref(), Ok("2200\n"));
    }
}

#[test]
fn a_shell_that_opens_the_file_for_each_line_goes_on_with_its_own_transaction_only() {
    let (tree, other) = (tree("bq34z100-g1"), Other::new());
    let each = |caller: Caller, line: &str| {
        let outcome = tree.writes(caller, FILE, &format!("{line}\n"));
        tree.close(caller);
        outcome
    };
    assert_eq!(each(own(1), "begin"), Ok(()));
    for line in ["begin", "48/11 2200", "commit", "abort"] {
        assert_eq!(each(other.file(2), line), Err(Errno::EBUSY), "{line}");
        assert_eq!(each(unseen(3), line), Err(Errno::EBUSY), "{line}");
    }
    assert_eq!(each(own(4), "80/53 3100"), Ok(()));
    assert_eq!(each(own(5), "begin"), Err(Errno::EBUSY), "it goes on");
    assert_eq!(each(own(6), "commit"), Ok(()));
    assert_eq!(tree.read("df/80/53").as_deref(), Ok("3100\n"));
    assert_eq!(tree.read("df/48/11").as_deref(), Ok("1000\n"));
    assert_eq!(each(other.file(7), "begin"), Ok(()), "it has ended");
}

/// `echo begin | sudo tee df/transaction`, and the same for each line.
#[test]
fn a_program_for_each_line_is_told_what_to_do() {
    let tree = tree("bq34z100-g1");
    let ended = Other::new().file(1);
    for begins in [unseen(1), ended] {
        assert_eq!(tree.writes(begins, FILE, "begin\n80/53 3100\n"), Ok(()), "one open file is enough");
        tree.close(begins);
        for line in ["48/11 2200\n", "commit\n"] {
            assert_eq!(tree.writes(unseen(2), FILE, line), Err(Errno::ENODATA), "{line}");
            let told = tree.handle.published().last_error.clone();
            assert!(told.contains("one open file for all lines") && told.contains("sudo tee"), "{told}");
            tree.close(unseen(2));
        }
        assert_eq!(tree.write("df/80/53", "3050"), Ok(()), "nobody is kept out by what is left of it");
    }
    assert_eq!(tree.writes(unseen(3), FILE, "begin\n80/53 3100\n"), Ok(()));
    assert_eq!(tree.writes(unseen(3), FILE, "commit\n"), Ok(()));
    assert_eq!(tree.read("df/80/53").as_deref(), Ok("3100\n"));
}

/// The late lines of a writer whose transaction was dropped were staged in the next one's.
#[test]
fn regression_late_lines_of_a_dropped_transaction_joined_the_next_one() {
    let (tree, other) = (tree("bq34z100-g1"), Other::new());
    for late in [own(1), unseen(1)] {
        assert_eq!(tree.writes(late, FILE, "begin\n48/11 2200\n"), Ok(()));
        tree.clock.sleep(Duration::from_secs(601));
        assert_eq!(tree.writes(other.file(2), FILE, "begin\n80/53 3100\n"), Ok(()));
        for line in ["48/13 8000\n", "commit\n"] {
            assert_eq!(tree.writes(late, FILE, line), Err(Errno::EBUSY), "{line}");
        }
        assert_eq!(tree.writes(other.file(2), FILE, "commit\n"), Ok(()));
        assert_eq!(tree.read("df/48/11").as_deref(), Ok("1000\n"));
        assert_eq!(tree.read("df/48/13").as_deref(), Ok("5400\n"));
        tree.close(late);
        tree.close(other.file(2));
    }
}

/// Two scripts one after the other, the first of which has stopped half-way: `{ one; two; } > df/transaction`.
#[test]
fn a_second_begin_through_one_open_file_ends_the_transaction() {
    let tree = tree("bq34z100-g1");
    assert_eq!(tree.writes(own(1), FILE, "begin\n48/11 2200\n"), Ok(()));
    assert_eq!(tree.writes(own(1), FILE, "begin\n"), Err(Errno::EBUSY));
    for line in ["80/53 3100\n", "commit\n"] {
        assert_eq!(tree.writes(own(1), FILE, line), Err(Errno::EBUSY), "{line}");
    }
    assert_eq!(tree.read(FILE).as_deref(), Ok("idle\n"));
    assert_eq!(tree.count("flash_writes"), 0);
}

/// The service was restarted with another pack in the bay, and its presence counted from 1 again.
#[test]
fn regression_what_one_daemon_had_read_was_written_by_the_next_one() {
    let trees = [tree("bq34z100-g1"), tree("bq34z100-g1")];
    let first = trees[0].read("gauge/presence").expect("a number");
    assert_eq!(trees[1].stage(&format!("begin {}\n80/53 3100\ncommit", first.trim())), Err(Errno::ENODEV));
    assert_eq!(trees[1].count("flash_writes"), 0);
    assert_eq!(trees[0].stage(&format!("begin {}\n80/53 3100\ncommit", first.trim())), Ok(()));
}

/// One with the factory's serial number and another CC gain came while one poll failed. Nothing had been read before `begin`.
#[test]
fn regression_a_pack_with_another_calibration_got_what_was_staged_for_the_one_before() {
    for (is_other, outcome) in [(true, Err(Errno::ENODEV)), (false, Ok(()))] {
        let tree = tree("bq34z100-g1");
        assert_eq!(tree.stage("begin\n80/53 3100"), Ok(()));
        tree.sim.set("power", "off").expect("a knob");
        assert!(tree.write("gauge/refresh", "1").is_err());
        if is_other {
            tree.sim.set_flash(104, 0, &[0x7f, 0x71, 0x20, 0x5c]);
        }
        tree.sim.set("power", "on").expect("a knob");
        tree.clock.sleep(Duration::from_secs(3));
        assert_eq!(tree.write("gauge/refresh", "1"), Ok(()));
        let flash = tree.sim.flash();
        assert_eq!(tree.stage("commit"), outcome);
        assert_eq!(tree.sim.flash() == flash, is_other);
    }
}

/// The kernel may tell of a closed file after what the same shell has written to the next one: that write waits.
#[test]
fn a_write_waits_for_the_end_of_the_open_file_before_it_only() {
    let (tree, other) = (tree("bq34z100-g1"), Other::new());
    let waits = |caller: Caller| tree.fs.awaits_close(tree.node(FILE), caller);
    assert_eq!(tree.writes(own(1), FILE, "begin\n"), Ok(()));
    assert!(waits(own(2)));
    assert!(!waits(own(1)) && !waits(other.file(2)) && !waits(unseen(2)));
    assert_eq!(tree.writes(own(3), FILE, "80/53 3100\n"), Err(Errno::EBUSY));
    assert!(!waits(own(3)), "it is refused already");
    tree.close(own(1));
    assert!(!waits(own(2)));
    assert_eq!(tree.writes(own(2), FILE, "80/53 3100\n"), Ok(()));
    assert!(waits(own(4)), "the second one goes on with it");
    assert_eq!(tree.writes(own(2), FILE, "commit\n"), Err(Errno::EBUSY), "a line of this process is lost");
    assert!(!waits(own(4)), "it has ended");
    assert_eq!(tree.writes(unseen(5), FILE, "begin\n"), Ok(()));
    assert!(!waits(unseen(6)), "it may be anybody");
}
