// SPDX-License-Identifier: MIT

//! A part that drives the FETs of its pack: whatever a user does with the program, they stay closed.

use std::fs;
use std::io;
use std::path::Path;
use std::thread::sleep;
use std::time::Duration;

use crate::room::{Folder, can_mount, gaugefs};

const CHIP: &str = "bq27742-g1";

struct Pack {
    gauge: String,
    at: String,
}

impl Pack {
    fn mounted(folder: &Folder, name: &str, more: &[&str]) -> Self {
        let at = folder.file(name);
        let arguments: Vec<_> = ["mount", "--sim", CHIP].iter().chain(more).copied().chain([&*at]).collect();
        gaugefs(&arguments).done();
        Self { gauge: format!("{at}/BAT0"), at }
    }

    fn read(&self, name: &str) -> String {
        let text =
            fs::read_to_string(Path::new(&self.gauge).join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
        text.trim_end().into()
    }

    fn echo(&self, text: &str, name: &str) -> io::Result<()> {
        fs::write(Path::new(&self.gauge).join(name), format!("{text}\n"))
    }

    fn refuses(&self, text: &str, name: &str) {
        let refused = self.echo(text, name).map_err(|error| error.raw_os_error());
        assert_eq!(refused, Err(Some(nix::libc::EPERM)), "{name}: {}", self.read("gauge/last_error"));
    }

    /// After the time in which a wrong sum or a threshold opens them.
    fn is_closed(&self) {
        let before = self.read("sim/resets");
        for _ in 0..2 {
            assert_eq!(self.read("sim/fets"), "closed");
            sleep(Duration::from_millis(1500));
        }
        assert_eq!((self.read("sim/fets"), &*before), ("closed".into(), "0"));
    }
}

#[test]
fn what_is_written_one_by_one_keeps_the_fets_closed() {
    if !can_mount() {
        return;
    }
    let folder = Folder::new();
    let log = folder.file("log");
    let pack = Pack::mounted(&folder, "m", &["--allow-unproven", "--log", &log]);
    assert_eq!(pack.read("gauge/last_error_facts"), "");
    pack.echo("1200", "df/48/12").expect("a value in range");
    pack.echo("begin\n2/0 4350\n2/3 4250\n2/14 9\ncommit", "df/transaction").expect("values in range");
    let facts = r#"{"waits_for":"next-start","places":["2/0","2/3","2/14","48/12"]}"#;
    assert_eq!(pack.read("gauge/last_error_facts"), facts);
    assert_eq!(pack.read("gauge/last_error"), "");
    let told = fs::read_to_string(&log).expect("the log");
    let line =
        "Design Capacity: 1000 -> 1200 mAh, written and verified; it counts from the gauge's next start on\n";
    assert!(told.contains(line), "{told}");
    let flags = |name: &str| {
        let index = pack.read("df/index");
        let line = index.lines().find(|line| line.split('\t').nth(3) == Some(name)).expect(name);
        line.split('\t').nth(8).expect("its flags").to_string()
    };
    assert_eq!(flags("Design Capacity"), "next-start,safe-limit");
    assert_eq!(flags("Block A 0"), "unproven");
    for place in
        ["64/0", "64/2", "64/3", "64/4", "64/5", "64/6", "57/6", "57/8", "57/10", "57/12", "39/0", "39/6"]
    {
        pack.refuses("1", &format!("df/{place}"));
        pack.refuses(&format!("begin\n{place} 1\ncommit"), "df/transaction");
    }
    for command in ["RESET", "0x0041", "SET_SHUTDOWN", "0x0013", "START_FET_TEST", "0x0024"] {
        assert!(pack.echo(command, "gauge/control").is_err(), "{command}");
    }
    assert!(pack.read("gauge/last_error").contains("START_FET_TEST"));
    pack.is_closed();
    gaugefs(&["umount", &pack.at]).done();
}

/// A backup, and a file that was made for another pack, have the protector's rows.
#[test]
fn an_imported_file_leaves_the_protector_alone() {
    if !can_mount() {
        return;
    }
    for format in ["toml", "gg.csv", "flashstream"] {
        let folder = Folder::new();
        let pack = Pack::mounted(&folder, "m", &["--allow-unproven"]);
        let (file, backup) = (folder.file("file"), folder.file("backup"));
        gaugefs(&["export", &pack.gauge, "--format", format, "-o", &backup]).done();
        let text = fs::read_to_string(&backup).expect("a file");
        let edited = match format {
            "toml" => text
                .replace("pack-configuration-d = 0x83", "pack-configuration-d = 0xb3")
                .replace("design-capacity = 1000", "design-capacity = 1300"),
            "gg.csv" => text
                .replace("D,83,H,1,4,83,,,hh,x,x,,hex,,hex,83", "D,b3,H,1,4,83,,,hh,x,x,,hex,,hex,b3")
                .replace(
                    "1000,I,2,12,1000,,,dddd,x,x,,mAh,,mAh,03e8",
                    "1300,I,2,12,1000,,,dddd,x,x,,mAh,,mAh,0514",
                ),
            _ => text.clone(),
        };
        assert!(format == "flashstream" || edited != text, "{format}");
        fs::write(&file, edited).expect("a file");
        let before = (pack.read("df/64/4"), pack.read("df/57/12"));
        let imported = gaugefs(&["import", &pack.gauge, &file]);
        assert!(matches!(imported.code, Some(0 | 3)), "{format}: {}{}", imported.out, imported.err);
        assert_eq!((pack.read("df/64/4"), pack.read("df/57/12")), before, "{format}");
        pack.echo("1250", "df/48/12").expect("a value in range");
        let restored = gaugefs(&["import", &pack.gauge, &backup]);
        assert!(matches!(restored.code, Some(0 | 3)), "{format}: {}{}", restored.out, restored.err);
        assert_eq!(pack.read("df/48/12"), "1000", "{format}");
        pack.is_closed();
        gaugefs(&["umount", &pack.at]).done();
    }
}
