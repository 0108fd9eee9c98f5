// SPDX-License-Identifier: MIT

//! What is written to the files of a mount: values, pieces, transactions, and what is refused.

use std::fs::{self, OpenOptions};
use std::io::{Seek, SeekFrom, Write};
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use gauge_bus::{Bus, BusError};
use gauge_sim::Sim;
use nix::errno::Errno;
use ti_gauge::keys::Keys;

use super::until;
use crate::room::{Mount, errno, quiet, statistic};

#[test]
fn data_flash_reads_and_writes() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    assert_eq!(fs::metadata(mount.path("df/80/53")).expect("there").size(), 4096);
    assert_eq!(mount.cat("df/80/53"), "3000");
    assert_eq!(fs::metadata(mount.path("df/80/53")).expect("there").size(), 5);
    assert_eq!(mount.cat("df/by-name/it-cfg/cell-terminate-voltage"), "3000");
    assert_eq!(mount.cat("df/48/43"), "Texas Inst.");
    assert_eq!(mount.cat("df/64/0"), "0x0161");
    assert_eq!(mount.cat("df/104/0"), "0.4768");
    assert_eq!(fs::read(mount.path("df/80/raw")).expect("bytes").len(), 96, "its blocks, whole");
    assert_eq!(mount.echo("3100", "df/80/53"), Ok(()));
    assert_eq!(mount.cat("df/80/53"), "3100");
    assert_eq!(mount.echo("  0xc80 ", "df/80/53"), Ok(()));
    assert_eq!(mount.cat("df/80/53"), "3200", "the value, not the text that was written");
    assert_eq!(mount.cat("gauge/seal"), "sealed");
    assert_eq!(mount.cat("gauge/last_error"), "");
    // A register that is a copy of data flash is updated soon, even with a long poll interval.
    assert_eq!(mount.echo("2000", "df/48/11"), Ok(()));
    until("the new design capacity", || mount.shows("charge_full_design", "2000000"));
}

/// The text of a string is what a write of the same string takes, whatever its bytes are.
#[test]
fn a_string_is_written_back_as_it_was_read() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let stored = || fs::read(mount.path("df/48/raw")).expect("bytes")[31..43].to_vec();
    let in_index = || {
        let index = mount.cat("df/index");
        let line = index.lines().find(|line| line.starts_with("48\t31\t")).expect("a line of its own");
        line.rsplit_once('\t').expect("fields").1.to_string()
    };
    for (written, shown, bytes) in [
        ("AT&T (4S)", "AT%26T %284S%29", &b"\x09AT&T (4S)\0\0"[..]),
        ("%00%ff%0a%09%1b", "%00%ff%0a%09%1b", b"\x05\0\xff\n\t\x1b\0\0\0\0\0\0"),
        ("%20 %20", "%20 %20", b"\x03   \0\0\0\0\0\0\0\0"),
        ("'%2541\"", "%27%2541%22", b"\x05'%41\"\0\0\0\0\0\0"),
        ("12345678901", "12345678901", b"\x0b12345678901"),
        ("-", "-", b"\x01-\0\0\0\0\0\0\0\0\0\0"),
        ("", "", b"\0\0\0\0\0\0\0\0\0\0\0\0"),
    ] {
        assert_eq!(mount.echo("other", "df/48/31"), Ok(()));
        assert_eq!(mount.echo(written, "df/48/31"), Ok(()), "{written}");
        assert_eq!((mount.cat("df/48/31").as_str(), stored().as_slice()), (shown, bytes));
        assert_eq!(in_index(), if shown == "-" { "%2d" } else { shown });
        let programmed = mount.sim.get("programmed");
        assert_eq!(mount.echo(shown, "df/48/31"), Ok(()), "{shown}");
        assert_eq!(mount.sim.get("programmed"), programmed, "{shown}: the same value is not written again");
        assert_eq!(mount.echo("other", "df/48/31"), Ok(()));
        assert_eq!(mount.echo(&format!("begin\n48/31 {shown}\ncommit"), "df/transaction"), Ok(()));
        assert_eq!(stored(), bytes, "{shown}");
    }
    for refused in ["caf\u{e9}", "a\tb", "123456789012"] {
        assert_eq!(mount.echo(refused, "df/48/31"), Err(Errno::EINVAL), "{refused}");
    }
    // A length that is larger than the field counts as the field's.
    let junk = b"\xffLION\x01\x02\x03AT&T";
    mount.sim.set_flash(48, 31, &junk[..12]);
    assert_eq!(mount.echo("1", "gauge/refresh"), Ok(()));
    let shown = mount.cat("df/48/31");
    assert_eq!(shown, "LION%01%02%03AT%26T");
    assert_eq!(mount.echo(&shown, "df/48/31"), Ok(()));
    assert_eq!(stored(), junk[..12]);
}

#[test]
fn refused_writes_return_their_errno_and_change_nothing() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let before = mount.sim.flash();
    let transfers = mount.transfers();
    assert_eq!(mount.echo("abc", "df/80/53"), Err(Errno::EINVAL));
    assert_eq!(mount.echo("", "df/80/53"), Err(Errno::EINVAL));
    assert_eq!(mount.echo("3701", "df/80/53"), Err(Errno::ERANGE));
    assert!(mount.cat("gauge/last_error").contains("the value is outside 1000 to 3700 mV"));
    assert_eq!(mount.echo("0x0", "df/112/0"), Err(Errno::EPERM));
    assert_eq!(fs::read(mount.path("df/112/0")).map_err(errno), Err(Errno::EPERM));
    assert_eq!(mount.echo("0x0f00", "gauge/control"), Err(Errno::EINVAL));
    assert_eq!(mount.echo("RESET", "gauge/control"), Err(Errno::EINVAL));
    assert_eq!(mount.echo("0", "gauge/poll_interval"), Err(Errno::ERANGE));
    assert_eq!(mount.echo("soon", "gauge/poll_interval"), Err(Errno::EINVAL));
    assert_eq!(mount.transfers(), transfers, "nothing was sent");
    // Truncation alone writes nothing, and a write at an offset is refused.
    OpenOptions::new().write(true).truncate(true).open(mount.path("df/80/53")).expect("opens");
    assert_eq!(mount.cat("df/80/53"), "3000");
    let mut file = OpenOptions::new().write(true).open(mount.path("df/80/53")).expect("opens");
    file.seek(SeekFrom::Start(1)).expect("seeks");
    assert_eq!(file.write(b"3100").map_err(errno), Err(Errno::EINVAL));
    drop(file);
    assert!(mount.sim.flash() == before);
    // `>>` acts as `>`.
    let mut file = OpenOptions::new().append(true).open(mount.path("df/80/53")).expect("opens");
    file.write_all(b"3300\n").expect("written");
    drop(file);
    assert_eq!(mount.cat("df/80/53"), "3300");
    assert_eq!(fs::create_dir(mount.path("mine")).map_err(errno), Err(Errno::EPERM));
    assert_eq!(fs::remove_file(mount.path("capacity")).map_err(errno), Err(Errno::EPERM));
    assert_eq!(fs::File::create(mount.path("mine")).map(|_| ()).map_err(errno), Err(Errno::ENOENT));
    for (typo, meant) in [
        ("df/80/54", "80/53 (Cell Terminate Voltage)"),
        ("df/by-name/it-cfg/cell-terminate-voltag", "80/53 (Cell Terminate Voltage)"),
    ] {
        // As a shell does for `>`.
        assert_eq!(fs::write(mount.path(typo), "3100\n").map_err(errno), Err(Errno::ENOENT), "{typo}");
        let error = mount.cat("gauge/last_error");
        assert!(error.contains(&format!("no such parameter; did you mean {meant}?")), "{error}");
    }
    assert_eq!(fs::write(mount.path("df/999"), "3100\n").map_err(errno), Err(Errno::ENOENT));
    assert_eq!(fs::rename(mount.path("temp"), mount.path("mine")).map_err(errno), Err(Errno::EPERM));
    assert_eq!(fs::hard_link(mount.path("temp"), mount.path("mine")).map_err(errno), Err(Errno::EPERM));
}

#[test]
fn writes_below_the_flash_voltage_are_refused() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    mount.sim.set("voltage_mv", "2700").expect("a knob");
    let before = mount.sim.flash();
    assert_eq!(mount.echo("3100", "df/80/53"), Err(Errno::EAGAIN));
    assert!(mount.cat("gauge/last_error").contains("2700 mV"));
    let facts: serde_json::Value =
        serde_json::from_str(&mount.cat("gauge/last_error_facts")).expect("one object");
    assert_eq!((&facts["errno"], &facts["reason"]), (&"EAGAIN".into(), &"flash-voltage".into()));
    assert_eq!((&facts["value"], &facts["least"]), (&2700.into(), &2800.into()));
    assert!(mount.sim.flash() == before);
}

/// A bus on which the gauge's owner panics during a write.
struct Panics(gauge_sim::SimBus, Arc<AtomicBool>);

impl Bus for Panics {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        assert!(!self.1.load(Ordering::SeqCst), "as the test wants it");
        self.0.transfer(write, read)
    }
}

/// Nobody knows what came of such a write, so EIO, which means that nothing has changed, would be wrong.
#[test]
fn a_write_that_nobody_answers_is_unknown() {
    let now = Arc::new(AtomicBool::new(false));
    let bus = |sim: &Sim| Box::new(Panics(sim.bus(), now.clone())) as Box<dyn Bus>;
    let hour = Duration::from_secs(3600);
    let Some(mount) = Mount::with("bq34z100-g1", hour, Keys::default(), |_| {}, Vec::new(), bus) else {
        return;
    };
    now.store(true, Ordering::SeqCst);
    assert_eq!(mount.echo("3100", "df/80/53"), Err(Errno::ENOTRECOVERABLE));
    // A panic ends one write, and not the owner.
    assert_eq!(mount.echo("3100", "df/80/53"), Err(Errno::ENOTRECOVERABLE));
}

#[test]
fn a_panic_in_a_request_fails_that_request_only() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    mount.defect.store(true, Ordering::SeqCst);
    for _ in 0..2 {
        assert_eq!(fs::read(mount.path("sim/load_ma")).map_err(errno), Err(Errno::EIO));
        assert_eq!(mount.cat("present"), "1");
    }
    let error = mount.cat("gauge/last_error");
    assert!(error.contains("a defect of gaugefs has stopped a request"), "{error}");
    assert_eq!(mount.echo("3100", "df/80/53"), Ok(()));
}

/// Each open of a file that may be written is another file to the kernel. SEMANTICS.md says what to lock instead.
#[test]
fn a_lock_of_a_folder_excludes_others_and_one_of_a_writable_file_does_not() {
    use rustix::fs::{FlockOperation, flock};
    let Some(mount) = quiet("bq34z100-g1") else { return };
    for (name, excludes) in [("", true), ("df", true), ("df/80/53", false), ("df/transaction", false)] {
        let open = || fs::File::open(mount.path(name)).expect("opens");
        let (one, other) = (open(), open());
        flock(&one, FlockOperation::NonBlockingLockExclusive).expect("nobody has it");
        let locked = flock(&other, FlockOperation::NonBlockingLockExclusive);
        assert_eq!(locked.is_err(), excludes, "{name}: {locked:?}");
    }
}

/// Only the owner can read data flash, and only the owner can write.
#[test]
fn file_modes_restrict_other_users() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let mode = |name: &str| fs::metadata(mount.path(name)).expect("there").permissions().mode() & 0o777;
    assert_eq!(mode("df/80/53"), 0o600);
    assert_eq!(mode("df/80/raw"), 0o400);
    assert_eq!(mode("gauge/control"), 0o600);
    assert_eq!(mode("gauge/seal"), 0o600);
    assert_eq!(mode("gauge/age_ms"), 0o444);
    assert_eq!(mode("sim/load_ma"), 0o600);
    let write = OpenOptions::new().write(true).custom_flags(0).open(mount.path("capacity"));
    // File modes do not restrict root, so for root the write itself is refused.
    let refused = write.and_then(|mut file| file.write_all(b"50"));
    assert_eq!(refused.map_err(errno), Err(Errno::EACCES));
}

/// `>` truncates before it writes. A file that cannot be written cannot be truncated either, not even by root.
#[test]
fn a_read_only_file_cannot_be_truncated() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    for name in ["capacity", "uevent", "gauge/registers/voltage", "gauge/age_ms"] {
        assert!(!mount.cat(name).is_empty());
        let opened = OpenOptions::new().write(true).truncate(true).open(mount.path(name));
        assert_eq!(opened.map(|_| ()).map_err(errno), Err(Errno::EACCES), "{name}");
        assert!(!mount.cat(name).is_empty(), "{name}");
    }
}

/// A program that writes and then reads through one open file gets the stored value, not the written text.
#[test]
fn a_writer_reads_the_stored_value() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let file = OpenOptions::new().read(true).write(true).open(mount.path("df/80/53")).expect("opens");
    let read = || {
        let mut buffer = [0; 64];
        let length = file.read_at(&mut buffer, 0).expect("reads");
        String::from_utf8_lossy(&buffer[..length]).into_owned()
    };
    assert_eq!(read(), "3000\n");
    for (written, value) in [("0xc1c", "3100\n"), (" 3200 \n", "3200\n"), ("3000", "3000\n")] {
        file.write_all_at(written.as_bytes(), 0).expect("written");
        assert_eq!(read(), value);
    }
    assert_eq!(file.write_at(b"99999999", 0).map_err(errno), Err(Errno::ERANGE));
    assert_eq!(read(), "3000\n");
    // The kernel takes over the file's size and time with the answer to a truncation.
    file.write_all_at(b"003000", 0).expect("written");
    file.set_len(0).expect("truncated");
    assert_eq!(read(), "3000\n");
    for millivolts in 3001..3012 {
        file.write_all_at(millivolts.to_string().as_bytes(), 0).expect("written");
    }
    assert_eq!(read(), "3011\n");
}

/// One open file and several writes, as with `{ echo begin; echo ...; } > df/transaction`.
#[test]
fn a_transaction_can_be_sent_in_several_writes() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let mode = fs::metadata(mount.path("df/transaction")).expect("there").permissions().mode() & 0o777;
    assert_eq!(mode, 0o600);
    assert_eq!(mount.cat("df/transaction"), "idle");
    let mut file =
        OpenOptions::new().write(true).truncate(true).open(mount.path("df/transaction")).expect("opens");
    for line in ["begin\n", "80/53 3100\n", "48/11 2200\n"] {
        file.write_all(line.as_bytes()).expect(line);
    }
    let staged = mount.cat("df/transaction");
    assert_eq!(staged, "Cell Terminate Voltage: 3000 -> 3100\nDesign Capacity: 1000 -> 2200");
    assert_eq!(mount.echo("3200", "df/80/53"), Err(Errno::EBUSY));
    assert!(mount.cat("gauge/last_error").contains("a transaction is open"));
    assert_eq!(mount.cat("df/80/53"), "3000");
    file.write_all(b"commit\n").expect("written");
    drop(file);
    assert_eq!(mount.cat("df/transaction"), "idle");
    assert_eq!((mount.cat("df/80/53").as_str(), mount.cat("df/48/11").as_str()), ("3100", "2200"));
    assert_eq!(mount.cat("gauge/seal"), "sealed");
    assert_eq!(mount.echo("3200", "df/80/53"), Ok(()));
}

/// bash writes each line by itself, and goes on after one that is refused.
#[test]
fn regression_a_shell_does_not_commit_what_is_left_of_a_refused_transaction() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let lines = r"begin\n80/53 3111\n48/11 99999999\ncommit\n";
    for script in [
        format!("printf '{lines}' > df/transaction"),
        "{ echo begin; echo 80/53 3111; echo 48/11 99999999; echo commit; } > df/transaction".into(),
        "for line in begin '80/53 3111' '48/11 99999999' commit; do echo $line > df/transaction; done".into(),
    ] {
        let shell = Command::new("bash").args(["-c", &script]).current_dir(mount.path("")).output();
        let output = shell.expect("bash runs");
        let told = String::from_utf8_lossy(&output.stderr);
        assert!(
            !output.status.success() && told.contains("Numerical result out of range"),
            "{script}: {told}"
        );
        let values = ["df/80/53", "df/48/11", "df/transaction"].map(|path| mount.cat(path));
        assert_eq!(values, ["3000", "1000", "idle"], "{script}");
        let reason = mount.cat("gauge/last_error");
        assert!(reason.contains("nothing is committed after a refused line"), "{reason}");
        assert!(reason.contains("Design Capacity"), "{reason}");
    }
}

/// Both scripts go on after what is refused, as a shell does.
#[test]
fn regression_two_shells_that_wrote_at_once_were_mixed() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let shell = |script: &str| {
        let mut bash = Command::new("bash");
        bash.args(["-c", script]).current_dir(mount.path("")).stdin(Stdio::piped()).stdout(Stdio::piped());
        bash.stderr(Stdio::null()).spawn().expect("bash runs")
    };
    let each = "for line in begin \"$1\" commit; do echo $line > df/transaction; done";
    for (first, second) in [
        (
            "{ echo begin; echo 80/53 3100; echo; read; echo commit; } > df/transaction",
            "{ echo begin; echo 48/11 2200; echo commit; } > df/transaction",
        ),
        (
            "echo begin > df/transaction; echo 80/53 3100 > df/transaction; read; echo commit > df/transaction",
            "set -- '48/11 2200'; ",
        ),
    ] {
        let second = if second.starts_with("set") { format!("{second}{each}") } else { second.to_string() };
        assert_eq!(mount.echo("3000", "df/80/53"), Ok(()));
        let mut one = shell(first);
        until("the line is staged", || mount.cat("df/transaction").contains("3100"));
        let other = shell(&second).wait_with_output().expect("it ends");
        assert!(!other.status.success(), "{second}");
        assert_eq!(mount.cat("df/transaction"), "Cell Terminate Voltage: 3000 -> 3100", "{second}");
        let mut waits =
            shell("until echo begin > df/transaction; do sleep 0.1; done; echo abort > df/transaction");
        drop(one.stdin.take());
        assert!(one.wait().expect("it ends").success(), "{first}");
        assert!(waits.wait().expect("it ends").success(), "it gets its turn");
        assert_eq!((mount.cat("df/80/53").as_str(), mount.cat("df/48/11").as_str()), ("3100", "1000"));
    }
    // A program for each line.
    let tee = "for line in begin '48/11 2200' commit; do echo $line | tee df/transaction; done";
    assert!(!shell(tee).wait().expect("it ends").success());
    assert!(mount.cat("gauge/last_error").contains("one open file for all lines"));
    assert_eq!(mount.cat("df/48/11"), "1000");
    let tee = "printf 'begin\\n48/11 2200\\ncommit\\n' | tee df/transaction";
    assert!(shell(tee).wait().expect("it ends").success());
    assert_eq!(mount.cat("df/48/11"), "2200");
}

/// The kernel tells of a closed file in its own time: a shell that opens the file for each line never notices.
#[test]
fn lines_through_one_open_file_after_the_other_are_taken_while_others_read() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let (ends, held) = (AtomicBool::new(false), ["df/80/53", "gauge/seal"].map(|name| mount.path(name)));
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                while !ends.load(Ordering::SeqCst) {
                    held.iter().for_each(|path| drop(fs::read(path).expect("readable")));
                }
            });
        }
        for turn in 0..100 {
            for line in ["begin".to_string(), format!("80/53 {}", 3000 + turn), "abort".to_string()] {
                assert_eq!(mount.echo(&line, "df/transaction"), Ok(()), "{turn}: {line}");
            }
        }
        ends.store(true, Ordering::SeqCst);
    });
}

/// The kernel passes a long write(2) on in pieces. None of them counts as the whole.
#[test]
fn a_piece_that_the_kernel_cuts_is_no_value() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let padded = |before: usize, text: &str| " ".repeat(before) + text;
    for (append, path, text) in [
        (false, "df/48/11", padded(4094, "2200")),
        (true, "df/48/11", padded(4094, "2200")),
        (false, "df/48/11", padded(4094, "2200\n")),
        (false, "df/48/11", padded(3 * 4096 + 4094, "2200\n")),
        (false, "df/48/11", padded((1 << 20) + 4094, "2200\n")),
        (true, "df/48/11", padded(4093, "22\n00\n")),
        (false, "gauge/poll_interval", padded(4095, "30")),
        (false, "gauge/seal", padded(4088, "unsealed\n")),
    ] {
        let mut options = OpenOptions::new();
        options.write(true).append(append);
        let before = mount.cat(path);
        let written = options.open(mount.path(path)).expect("opens").write(text.as_bytes());
        assert_eq!(written.map_err(errno), Err(Errno::EFBIG), "{path}, {} bytes", text.len());
        let reason = mount.cat("gauge/last_error");
        assert!(reason.contains(&format!("Z: {path}: ")) && reason.contains("may not be whole"), "{reason}");
        assert_eq!(mount.cat(path), before);
    }
    // Every position of the cut within a line, the newline included.
    let line = "48/11 2200\n";
    for before in 4096 - line.len() - 1..=4096 {
        mount.echo("begin", "df/transaction").expect("a transaction");
        let text = padded(before, line) + &" ".repeat(100) + "\n";
        let written = fs::write(mount.path("df/transaction"), &text).map_err(errno);
        let staged = mount.cat("df/transaction");
        let all = "Design Capacity: 1000 -> 2200";
        assert!(
            written.is_ok() && staged == all || written == Err(Errno::EINVAL) && staged.is_empty(),
            "{before}: {staged}"
        );
        mount.echo("abort", "df/transaction").expect("the end of it");
    }
    assert_eq!(mount.cat("df/48/11"), "1000");
    assert_eq!(statistic(&mount.handle, "flash_writes"), 0);
    assert_eq!(
        fs::write(mount.path("df/48/11"), "2200").map_err(errno),
        Ok(()),
        "without a newline, but whole"
    );
    assert_eq!(mount.cat("df/48/11"), "2200");
}

/// What was written may be a key, and may contain what forges a line of the log.
#[test]
fn refused_text_is_not_repeated_in_last_error() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    for text in [
        "8d3e b7c5",
        "0x8d3eb7c5",
        "9d17c2e85ba3f6047e91d80c3b6fa25e",
        "8d3e\nb7c5",
        "8d3e\x1b[2Jb7c5",
        "36158",
    ] {
        for path in [
            "df/80/53",
            "df/48/11",
            "df/48/32",
            "df/transaction",
            "gauge/seal",
            "gauge/control",
            "gauge/settle",
            "gauge/keys",
            "gauge/authenticate",
            "gauge/poll_interval",
            "sim/load_ma",
            "sim/fault",
            "sim/reset_busy",
            "sim/power",
            "sim/firmware",
        ] {
            if path == "df/transaction" {
                mount.echo("begin", path).expect("a transaction");
                for line in [format!("80/53 {text}"), format!("raw 80/60 {text}"), format!("raw {text}")] {
                    mount.echo(&line, path).expect_err("refused");
                    let told = mount.cat("gauge/last_error");
                    assert!(
                        !["8d3e", "b7c5", "9d17", "36158"].iter().any(|word| told.contains(word)),
                        "{line:?}: {told}"
                    );
                }
                mount.echo(&format!("abort\n{text}"), path).expect_err("refused");
                mount.echo("abort", path).expect("the end of it");
                continue;
            }
            if mount.echo(text, path).is_ok() {
                continue;
            }
            let told = mount.cat("gauge/last_error");
            assert!(!told.is_empty() && !told.contains(char::is_control), "{path}: {told:?}");
            assert!(
                !["8d3e", "b7c5", "9d17", "36158"].iter().any(|word| told.contains(word)),
                "{path}: {told}"
            );
        }
    }
}

fn processor_time() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec as u32)
}

/// A user who may write must not be able to stop the others from reading, or to fill the memory.
#[test]
fn staging_is_linear_and_its_memory_is_given_back() {
    let Some(mount) = quiet("bq27520-g3") else { return };
    let resident = || {
        let pages = fs::read_to_string("/proc/self/statm").expect("it is there");
        pages.split(' ').nth(1).and_then(|pages| pages.parse::<usize>().ok()).expect("a number") * 4096
    };
    // The processor time of this process, which is the daemon as well: the machine may do something else meanwhile.
    let line = |at: usize| format!("raw {}/{} {}", 200 + at / 256, 32 * (at % 256), "5a".repeat(32));
    let lines = |from: usize, to: usize| {
        let batches = (from..to).step_by(100).map(|first| {
            let begin = processor_time();
            for at in first..to.min(first + 100) {
                mount.echo(&line(at), "df/transaction").expect("staged");
            }
            processor_time() - begin
        });
        batches.min().expect("there are lines")
    };
    mount.echo("begin", "df/transaction").expect("a transaction");
    lines(0, 100);
    let before = resident();
    let first = lines(100, 300);
    let _ = lines(300, 1700);
    let last = lines(1700, 1900);
    let full = resident();
    assert_eq!(mount.cat("df/transaction").lines().count(), 1900);
    mount.echo("abort", "df/transaction").expect("the end of it");
    assert_eq!(mount.cat("df/transaction"), "idle");
    let after = resident();
    eprintln!("100 lines in {first:?}, and {last:?} after 1700; {before} bytes, {full}, {after}");
    assert!(last < first * 4, "100 lines took {first:?} at first, and {last:?} after 1700 others");
    assert!(full < before + (8 << 20) && after < before + (4 << 20), "{before} bytes, {full}, {after}");
}
