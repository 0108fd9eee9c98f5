// SPDX-License-Identifier: MIT

//! `tests/capture`: recordings of what a logic analyser or i2cdump saw, and public captures of real parts.

use std::fmt::Write as _;
use std::fs;
use std::io::Write as _;
use std::process::{Command, Stdio};

use gauge_bus::Bus;
use gauge_bus::replay::Recording;
use ti_gauge::chip::{Chip, FLAT};
use ti_gauge::codec::checksum;

use crate::room::{Folder, can_mount, gaugefs, read};

const REPORT: &str = include_str!("../reports/bq34z100-g1-simulated.txt");

/// What is on the bus: the bytes written, and the bytes read.
type Transfer = (Vec<u8>, Vec<u8>);

/// A recording of a capture; `None` where there is no Python.
fn converted(arguments: &[&str], capture: &str) -> Option<String> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/capture");
    let ran = Command::new("python3")
        .arg(script)
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn();
    let Ok(mut ran) = ran else {
        eprintln!("SKIPPED: python3 is missing; to run all tests: sudo apt-get install python3");
        return None;
    };
    let sent = ran.stdin.take().expect("a pipe").write_all(capture.as_bytes());
    let output = ran.wait_with_output().expect("it ends");
    assert!(sent.is_ok() && output.status.success(), "{arguments:?} {capture:.300}");
    Some(String::from_utf8(output.stdout).expect("text"))
}

fn bytes(text: &str) -> Vec<u8> {
    text.split_ascii_whitespace().map(|byte| u8::from_str_radix(byte, 16).expect("a byte")).collect()
}

/// The transfers of a recording, without the address.
fn transfers(recording: &str) -> Vec<Transfer> {
    let mut all = Vec::new();
    for line in recording.lines() {
        if let Some(write) = line.strip_prefix("W: AA ") {
            all.push((bytes(write), Vec::new()));
        } else if let Some((register, _)) = line.strip_prefix("R: AA ").and_then(|read| read.rsplit_once(' '))
        {
            all.push((bytes(register), Vec::new()));
        } else if let Some((_, came)) = line.split_once("-> ").filter(|_| line.starts_with(';')) {
            all.last_mut().expect("a transfer").1 = bytes(came);
        }
    }
    all
}

/// How a program exports messages: of each, the second it began, whether it reads, and its bytes.
type Export = fn(messages: &[(f64, bool, Vec<u8>)]) -> String;

fn logic_1(messages: &[(f64, bool, Vec<u8>)]) -> String {
    let mut text = "Time [s],Packet ID,Address,Data,Read/Write,ACK/NAK\n".to_string();
    for (packet, (time, reads, data)) in messages.iter().enumerate() {
        for (at, byte) in data.iter().enumerate() {
            let address = if *reads { "0xAB,0x" } else { "0xAA,0x" };
            let direction = if *reads { "Read" } else { "Write" };
            let answer = if *reads && at + 1 == data.len() { "NAK" } else { "ACK" };
            writeln!(text, "{time:.6},{packet},{address}{byte:02X},{direction},{answer}").expect("a text");
        }
    }
    text
}

fn logic_2(messages: &[(f64, bool, Vec<u8>)]) -> String {
    let mut text = "name,type,start_time,duration,ack,address,read,data\n".to_string();
    for (time, reads, data) in messages {
        writeln!(text, "I2C,start,{time:.6},1e-08,,,,").expect("a text");
        writeln!(text, "I2C,address,{time:.6},8e-05,true,0x55,{reads},").expect("a text");
        for (at, byte) in data.iter().enumerate() {
            let answer = !*reads || at + 1 < data.len();
            writeln!(text, "I2C,data,{time:.6},8e-05,{answer},,,0x{byte:02X}").expect("a text");
        }
        writeln!(text, "I2C,stop,{time:.6},1e-08,,,,").expect("a text");
    }
    text
}

fn terminal(messages: &[(f64, bool, Vec<u8>)]) -> String {
    let mut text = String::new();
    for (_, reads, data) in messages {
        let direction = if *reads { "read" } else { "write" };
        let data: String = data.iter().map(|byte| format!(" 0x{byte:02X}")).collect();
        writeln!(text, "{direction} to 0x55 ack data:{data}").expect("a text");
    }
    text
}

fn sigrok(messages: &[(f64, bool, Vec<u8>)]) -> String {
    let mut text = String::new();
    for (time, reads, data) in messages {
        let (sample, direction) = (1e6 * time, if *reads { "read" } else { "write" });
        let mut add = |what: String| writeln!(text, "{sample:.0}-{sample:.0} i2c-1: {what}").expect("a text");
        add("Start".into());
        add(format!("Address {direction}: 55"));
        add("ACK".into());
        for (at, byte) in data.iter().enumerate() {
            add(format!("Data {direction}: {byte:02X}"));
            add(if *reads && at + 1 == data.len() { "NACK" } else { "ACK" }.into());
        }
        add("Stop".into());
    }
    text
}

#[test]
fn the_export_of_a_logic_analyser_becomes_a_recording() {
    let original = transfers(REPORT);
    assert!(original.len() > 40, "{}", original.len());
    let mut messages = Vec::new();
    for (at, (write, came)) in original.iter().enumerate() {
        messages.push((at as f64 / 1000.0, false, write.clone()));
        if !came.is_empty() {
            messages.push((at as f64 / 1000.0, true, came.clone()));
        }
    }
    for export in [logic_1, logic_2, terminal, sigrok] as [Export; 4] {
        let capture = export(&messages);
        let Some(recording) = converted(&["bq34z100-g1"], &capture) else { return };
        assert_eq!(transfers(&recording), original, "{capture:.200}");
    }
}

#[test]
fn another_target_a_key_and_what_nobody_answers_are_not_taken_for_the_gauge() {
    let capture = "write to 0x0B ack data: 0x08\nread to 0x0B ack data: 0x01 0x02\nwrite to 0x55 ack data: 0x00 0x14 0x04\n\
                   write to 0x55 ack data: 0x00 0x72 0x36\nwrite to 0x55 nak\nwrite to 0x55 ack data: 0x08\nread to 0x55 nak\n";
    let Some(recording) = converted(&["bq34z100-g1"], capture) else { return };
    let lines: Vec<_> = recording
        .lines()
        .skip(2)
        .map(|line| line.split_once(".000000 ").map_or(line, |(_, rest)| rest))
        .collect();
    assert_eq!(lines, ["; hidden", "; hidden", "R: AA 08 1", "failed: not acknowledged"]);
}

/// With the identity that a dump does not have.
#[test]
fn a_dump_of_all_registers_is_mounted() {
    if !can_mount() {
        return;
    }
    let mut registers = [0; 0x80];
    for (write, came) in transfers(REPORT) {
        if let [register] = write[..] {
            registers[usize::from(register)..][..came.len()].copy_from_slice(&came);
        }
    }
    let row = |first: usize| {
        registers[first..first + 16].iter().map(|byte| format!(" {byte:02x}")).collect::<String>()
    };
    let words = |first: usize| {
        let word = |at: usize| format!(" {:02x}{:02x}", registers.get(at + 1).unwrap_or(&0), registers[at]);
        (first..first + 8).map(word).collect::<String>()
    };
    let by_byte = (0..8).map(|at| format!("{at}0:{}    ................\n", row(16 * at)));
    let by_byte = format!("     0  1  2  3  4  5  6  7\n{}", by_byte.collect::<String>());
    let by_word = (0..16).map(|at| format!("{:02x}:{} \n", 8 * at, words(8 * at)));
    let by_word = format!("     0,8  1,9  2,a  3,b  4,c  5,d  6,e  7,f\n{}", by_word.collect::<String>());
    let identity = ["0=0x6010", "1=0x0100", "2=0x0016", "3=8", "8=0x0107"];
    let mut arguments = vec!["bq34z100-g1"];
    arguments.extend(identity.iter().flat_map(|answer| ["--answer", answer]));
    let Some(recording) = converted(&arguments, &by_byte) else { return };
    assert_eq!(Some(&recording), converted(&arguments, &by_word).as_ref());
    let folder = Folder::new();
    fs::write(folder.file("recording"), recording).expect("a file");
    let at = folder.file("m");
    gaugefs(&["mount", "--replay", &folder.file("recording"), "--name", "BAT0", &at]).done();
    let shown =
        ["capacity", "voltage_now", "charge_full", "temp"].map(|file| read(&at, &format!("BAT0/{file}")));
    assert_eq!(shown, ["60", "3855000", "1000000", "250"]);
    gaugefs(&["umount", &at]).done();
}

/// Each address that the firmware of a Flipper Zero reads is a row of the table, of as many bytes, whose value is in its range.
#[test]
fn the_table_fits_a_captured_bq27220() {
    let capture = include_str!("../captures/bq27220-kiisu4.txt");
    let Some(recording) = converted(&["bq27220"], capture) else { return };
    let folder = Folder::new();
    fs::write(folder.file("recording"), &recording).expect("a file");
    let chip = Chip::by_name("bq27220").expect("a part with a table");
    let file = folder.file("recording");
    let mut bus = ti_gauge::gauge::replay(chip, &Recording::open(file.as_ref()).expect("a recording"));
    let mut values = Vec::new();
    for pair in transfers(&recording).windows(2) {
        let [(write, _), (_, came)] = pair else { continue };
        let [0x3e, low, high] = write[..] else { continue };
        let address = u16::from_le_bytes([low, high]);
        let row = chip.parameter(FLAT, address).unwrap_or_else(|| panic!("no row at {address:#x}"));
        assert_eq!(row.kind.size(), came.len(), "{}", row.name);
        bus.transfer(write, &mut []).expect("a selection");
        let mut replayed = vec![0; came.len()];
        bus.transfer(&[0x40], &mut replayed).expect("its answer");
        assert_eq!(&replayed, came, "{}", row.name);
        values.push((row.name, came.iter().fold(0, |value, byte| value << 8 | i64::from(*byte))));
    }
    let of = |name| values.iter().find(|(row, _)| *row == name).map(|(_, value)| *value);
    assert_eq!(
        [of("Full Charge Capacity"), of("Design Capacity"), of("Design Voltage")],
        [Some(2100), Some(2100), Some(3679)]
    );
    let curve: Vec<_> =
        values.iter().filter(|(name, _)| name.ends_with("% DOD")).map(|(_, value)| *value).collect();
    assert!(curve.len() == 11 && curve.is_sorted_by(|high, low| high > low), "{curve:?}");
}

/// As gaugefs writes a block of these parts: MACDataSum() is over address and data, MACDataLen() four more than the data.
#[test]
fn bqstudio_stores_a_block_by_sum_and_length() {
    let capture = include_str!("../captures/bq27z561-bqstudio.txt");
    let Some(recording) = converted(&["bq27z561"], capture) else { return };
    let transfers = transfers(&recording);
    let (mut commits, mut looks, mut written) = (0, 0, Vec::new());
    for pair in transfers.windows(2) {
        match (&pair[0].0[..], &pair[1].0[..]) {
            ([0x3e, block @ ..], [0x60, sum, length]) => {
                assert_eq!((*sum, usize::from(*length)), (checksum(block), block.len() + 2));
                // Two halves of one block.
                if commits % 2 == 0 {
                    written.clone_from(&block.to_vec());
                } else {
                    written.extend_from_slice(&block[2..]);
                }
                commits += 1;
            }
            ([0x3e, _, _], [0x3e]) => {
                let (block, end) = pair[1].1.split_at(34);
                assert_eq!((block, end), (&written[..], &[checksum(block), 36][..]));
                looks += 1;
            }
            _ => {}
        }
    }
    assert_eq!((commits, looks), (4, 2));
}
