// SPDX-License-Identifier: MIT

//! A megabyte of input for each target, to see what takes time out of proportion:
//! `cargo test -p gaugefs-fuzz --test large -- --ignored --nocapture` prints the times. Only what is out of all
//! proportion fails, because the machine may be busy.

use std::time::{Duration, Instant};

use gaugefs_fuzz::{TARGETS, Target};

const SIZE: usize = 1_000_000;
/// The kernel passes no longer write(2) on.
const WRITE: usize = 128 * 1024;
/// A target runs the code under test several times on an input.
const LIMIT: Duration = Duration::from_secs(60);

/// Each line different, as far as the format allows.
fn lines(head: &str, line: impl Fn(usize) -> String) -> Vec<u8> {
    let mut text = head.to_string();
    for number in 0.. {
        if text.len() >= SIZE {
            break;
        }
        text += &line(number);
    }
    text.into_bytes()
}

fn inputs(target: &Target) -> Vec<Vec<u8>> {
    let zeroes = "00".repeat(32);
    match target.name {
        "image-toml" => vec![
            lines("chip = \"bq27441-g1\"\n", |number| format!("[t{number}]\n")),
            lines("chip = \"bq27441-g1\"\n[state]\n", |number| format!("k{number} = 1\n")),
            lines("a = ", |_| "[".into()),
        ],
        "image-ggcsv" => {
            let head = "* gaugefs chip bq27441-g1\n* Field Order: Class name, Subclass name, Parameter name, Parameter Value\n";
            vec![
                lines(head, |number| format!("A,B,C{number},1\n")),
                lines("* gaugefs chip bq27441-g1\n* Field Order: ", |number| format!("C{number},")),
            ]
        }
        "image-gg" => {
            let head = "[Header]\nDeviceName = bq27500 v1.20\n[Safety(Configuration)]\n";
            vec![
                lines(head, |number| format!("OT Chg{number} = 1\n")),
                lines(head, |number| format!("[S{number}(Configuration)]\n")),
                lines("[Header]\nDeviceName = ", |_| "bq".into()),
            ]
        }
        "image-flashstream" => vec![
            lines("; gaugefs chip bq34z100-g1\n", |number| {
                format!(
                    "W: AA 3E C8 {:02X}\nW: AA 40 {:02X}\nW: AA 60 00\n",
                    number % 256,
                    number / 256 % 256
                )
            }),
            lines("; gaugefs chip bq34z100-g1\nW: AA 3E 30 00", |_| " 00".into()),
        ],
        "value" => vec![lines("", |_| "9".into()), lines("0.", |_| "1".into())],
        "name" => vec![lines("it-cfg/", |_| "a".into()), lines("", |number| format!("a{number}/"))],
        "transaction" => {
            let mut raw = lines("", |number| format!("raw 200/{} {:02x}\n", number % 8192, number % 256));
            let mut one = lines("", |number| format!("80/53 {}\n", 2500 + number % 1000));
            for text in [&mut raw, &mut one] {
                text.truncate(WRITE);
                text.truncate(text.iter().rposition(|&byte| byte == b'\n').map_or(0, |end| end + 1));
            }
            vec![raw, one]
        }
        "keys" => vec![
            lines("", |number| format!("[B{number}]\n")),
            lines("unseal = ", |_| "0414 ".into()),
            lines("unseal ", |_| "0414 3672 ".into()),
        ],
        "journal" => {
            let head = "gaugefs journal 2\ngauge BAT0\npart bq34z100-g1 0100 0016 0001\nfound sealed\nreset true\nmark 104 11 03\n";
            let block =
                |number: usize| format!("block 200 {} 00000001 {zeroes} {zeroes}\n", number % 256 * 32);
            let mut blocks = lines(head, block);
            blocks.extend(b"end *\n");
            let mut marks = lines(head, |number| format!("mark {} {} 00\n", number % 256, number / 256));
            marks.extend(b"end *\n");
            vec![blocks, marks]
        }
        "replay" => {
            let head = "; gaugefs: bq34z100-g1 on x\n";
            vec![
                lines(head, |number| {
                    format!("R: AA {:02X} 2\n;  0.1 -> 00 {:02X}\n", number % 128, number % 256)
                }),
                lines(head, |_| "; hidden\n".into()),
            ]
        }
        "configuration" => vec![
            lines("", |number| format!("[[gauge]]\nsim = \"bq34z100-g1\"\nname = \"B{number}\"\n")),
            lines("[mount]\n", |number| format!("k{number} = 1\n")),
        ],
        "station" => vec![
            lines("[station]\n", |number| format!("k{number} = 1\n")),
            lines("", |number| format!("[[gauge]]\nsim = \"bq34z100-g1\"\nname = \"B{number}\"\n")),
        ],
        "condition" => vec![
            lines("capacity<20", |_| "&&capacity<20".into()),
            lines("capacity", |_| "y".into()),
            lines("capacity<", |_| "9".into()),
        ],
        "csv" => {
            let head = "time (UTC),gauge,voltage (V)\n";
            let time = |number: usize| {
                format!(
                    "2026-01-{:02}T00:{:02}:{:02}Z",
                    1 + number / 3600 % 28,
                    number / 60 % 60,
                    number % 60
                )
            };
            vec![
                lines(head, |number| format!("{},BAT0,{}\n", time(number), number % 7)),
                lines(head, |number| format!("{},B{number},1\n", time(number))),
            ]
        }
        "command-line" => vec![lines("address ", |_| "9".into()), lines("name ", |_| "A".into())],
        "bus" => vec![lines("\u{3}\u{4}", |number| char::from(number as u8 % 0x70).to_string())],
        other => panic!("no large input for {other}"),
    }
}

#[test]
#[ignore = "it is for its output, and takes a minute"]
fn a_megabyte_takes_no_time_out_of_proportion() {
    for target in TARGETS {
        for (number, input) in inputs(target).iter().enumerate() {
            let start = Instant::now();
            (target.run)(input);
            let time = start.elapsed();
            println!("{} {number}: {time:.1?}", target.name);
            assert!(time < LIMIT, "{} {number} took {time:?}", target.name);
        }
    }
}
