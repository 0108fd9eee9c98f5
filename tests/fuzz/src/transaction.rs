// SPDX-License-Identifier: MIT

//! What is written to `df/transaction`: `gaugefs::fs`.

use std::sync::mpsc;
use std::sync::{Arc, LazyLock};
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_owner::{self as owner, Run, Signal};
use gauge_sim::{Options, Sim};
use gaugefs::error::{Cause, Error, Result};
use gaugefs::fs::{Access, Caller, Content, Fs, Node, Process, Supply};
use ti_gauge::chip::Chip;

struct Tree {
    /// The gauge can be read. It never gets a commit, so it is the same for every input.
    present: (Fs, Node),
    /// There is no gauge, so a commit fails.
    absent: (Fs, Node),
}

static TREES: LazyLock<[Tree; 3]> = LazyLock::new(|| {
    ["bq34z100-g1", "bq27441-g1", "bq34110"]
        .map(|chip| Tree { present: tree(chip, true), absent: tree(chip, false) })
});

static OWN: LazyLock<Option<Process>> = LazyLock::new(|| Process::of_thread(std::process::id()));

fn tree(chip: &str, present: bool) -> (Fs, Node) {
    let clock = Arc::new(SimClock::new());
    let sim = Sim::new(chip, &Options::default(), clock.clone()).expect("a chip that is simulated");
    clock.sleep(Duration::from_secs(1));
    let chip = Chip::by_name(chip).expect("a chip in the tables");
    let missing = (!present).then(|| Error::new("", Cause::Gone, "it is not connected"));
    let run = Run { missing, ..Run::default() };
    let address = if present { 0x55 } else { 0x56 };
    let bus = Box::new(sim.bus_at(address));
    let started = owner::start(chip, bus, clock, run, Arc::new(Signal::default()));
    let (handle, opened) = started.expect("a thread");
    assert_eq!(opened.recv().expect("the owner runs").is_ok(), present);
    let gauge = Supply::new("BAT0".into(), handle);
    let fs = Fs::new(vec![gauge], Access { uid: 0, gid: 0, group: false });
    let node = ["BAT0", "df", "transaction"]
        .iter()
        .fold(Node::Root, |node, name| fs.lookup(node, name).expect("a file of every gauge"));
    (fs, node)
}

pub(crate) fn run(input: &[u8]) {
    let text = String::from_utf8_lossy(input);
    let has = |word: &str| text.lines().any(|line| line.trim() == word);
    for tree in &*TREES {
        let (fs, node) = if has("commit") { &tree.absent } else { &tree.present };
        let write = |data: &[u8]| written(fs, *node, data);
        let _ = write(b"abort\n");
        let _ = write(input);
        let _ = write(b"abort\n");
        assert_eq!(shown(fs, *node), b"idle\n");
        write(b"begin\n").expect("none is open");
        let before = shown(fs, *node);
        let outcome = write(input);
        let after = shown(fs, *node);
        if outcome.is_err() && !has("commit") {
            assert_eq!(before, after, "what was refused has changed what is staged");
        }
        if outcome.is_ok() && !["begin", "abort", "commit"].iter().any(|word| has(word)) {
            write(input).expect("what was accepted before");
            assert_eq!(shown(fs, *node), after, "the same lines again have changed what is staged");
        }
    }
}

fn written(fs: &Fs, node: Node, data: &[u8]) -> Result<()> {
    let (sender, receiver) = mpsc::channel();
    let caller = Caller { file: 1, process: *OWN };
    fs.write(node, caller, 0, data, Box::new(move |outcome| drop(sender.send(outcome))));
    let outcome = receiver.recv().expect("every write is answered");
    fs.close(node, caller.file);
    outcome
}

fn shown(fs: &Fs, node: Node) -> Vec<u8> {
    if let Content::Bytes(bytes) = fs.content(node) {
        return bytes.to_vec();
    }
    let (sender, receiver) = mpsc::channel();
    fs.read(node, Box::new(move |outcome| drop(sender.send(outcome))));
    receiver.recv().expect("every read is answered").map(|bytes| bytes.to_vec()).unwrap_or_default()
}
