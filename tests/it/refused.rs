// SPDX-License-Identifier: MIT

//! Readers never see what is refused to a writer, not for a moment.
//!
//! The kernel copies what is written to its page cache before gaugefs gets it. These tests write in a loop what is
//! refused, in several ways, and read meanwhile, in several ways.

use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{FileExt, MetadataExt};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use nix::errno::Errno;

use crate::room::mapped;
use crate::room::{LONG, Mount, errno, quiet};

/// For this long at least each file is written and read.
const TIME: Duration = Duration::from_millis(200);

fn pread(file: &File) -> Vec<u8> {
    let mut bytes = vec![0; 8192];
    let count = file.read_at(&mut bytes, 0).expect("reads");
    bytes.truncate(count);
    bytes
}

/// Writes `text` to a file, which answers `refusal`, and reads the file meanwhile.
fn is_never_seen(mount: &Mount, name: &str, text: &[u8], refusal: Errno) {
    let path = mount.path(name);
    let accepted = fs::read(&path).expect("reads");
    let (over, reads) = (AtomicBool::new(false), AtomicU64::new(0));
    let ongoing = || !over.load(Ordering::SeqCst);
    let open = || File::open(&path).expect("opens");
    // All are opened by one thread, as a program does that hands them to others.
    let (held, to_map, both) =
        (open(), OwnedFd::from(open()), OpenOptions::new().read(true).write(true).open(&path));
    let both = both.expect("opens");
    let see = |how: &str, found: &[u8]| {
        // A mapping shows whole pages.
        let end = if how == "mapped" { found.iter().position(|&byte| byte == 0) } else { None };
        let found = &found[..end.unwrap_or(found.len())];
        assert!(
            found == accepted,
            "{name}, {how}: {:?} instead of {:?}",
            String::from_utf8_lossy(found),
            String::from_utf8_lossy(&accepted)
        );
        reads.fetch_add(1, Ordering::SeqCst);
    };
    let writes = |file: &File| {
        for offset in [0, 1] {
            let answer = file.write_at(text, offset).map_err(errno);
            let refusal = if offset == 1 && refusal == Errno::ERANGE { Errno::EINVAL } else { refusal };
            assert_eq!(answer, Err(refusal), "{name}");
        }
    };
    std::thread::scope(|scope| {
        let readers: [Box<dyn Fn() + Send + '_>; 3] = [
            Box::new(|| {
                while ongoing() {
                    see("opened", &fs::read(&path).expect("reads"))
                }
            }),
            Box::new(|| {
                while ongoing() {
                    see("held open", &pread(&held))
                }
            }),
            Box::new(|| {
                let pipe = nix::unistd::pipe().expect("a pipe");
                let is_text = accepted.iter().all(|&byte| byte != 0);
                while ongoing() && is_text {
                    see("mapped", &mapped(&to_map, &pipe).expect("a mapping"))
                }
            }),
        ];
        let readers: Vec<_> = readers.into_iter().map(|reader| scope.spawn(reader)).collect();
        let writer = scope.spawn(|| {
            while ongoing() {
                let file = OpenOptions::new().write(true).open(&path).expect("opens");
                writes(&file);
                let appends = OpenOptions::new().append(true).open(&path).expect("opens");
                assert_eq!((&appends).write(text).map_err(errno), Err(refusal), "{name}");
            }
        });
        let owner = scope.spawn(|| {
            while ongoing() {
                writes(&both);
                see("written", &pread(&both));
            }
        });
        let start = Instant::now();
        let is_enough = || start.elapsed() > TIME && reads.load(Ordering::SeqCst) > 50;
        while !is_enough() && !readers.iter().any(|reader| reader.is_finished()) {
            assert!(start.elapsed() < LONG, "{name}: too few reads");
            std::thread::sleep(Duration::from_millis(5));
        }
        over.store(true, Ordering::SeqCst);
        for thread in readers.into_iter().chain([writer, owner]) {
            thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        }
    });
    assert_eq!(fs::read(&path).expect("reads"), accepted);
}

#[test]
fn regression_refused_text_is_never_seen() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    for name in ["df/80/53", "gauge/poll_interval"] {
        is_never_seen(&mount, name, b"99999\n", Errno::ERANGE);
    }
}

/// Nothing but the answer to the write itself keeps root from writing an attribute.
#[test]
fn regression_what_root_writes_to_an_attribute_is_never_seen() {
    if !nix::unistd::geteuid().is_root() {
        eprintln!("SKIPPED: only root can open an attribute for writing");
        return;
    }
    let Some(mount) = quiet("bq34z100-g1") else { return };
    for name in ["voltage_now", "type", "uevent", "gauge/registers/voltage", "df/80/raw"] {
        is_never_seen(&mount, name, b"99", Errno::EACCES);
    }
}

/// As soon as a write is answered, everybody reads what it has stored, also through a file that was open before. It is
/// the same file to all of them.
#[test]
fn accepted_text_is_seen_at_once() {
    let Some(mount) = quiet("bq34z100-g1") else { return };
    let number = |file: &File| file.metadata().expect("it is open").ino();
    for (name, texts) in
        [("gauge/poll_interval", ["60\n", "3600\n", "7\n"]), ("df/80/53", ["3100\n", "3200\n", "3000\n"])]
    {
        let path = mount.path(name);
        let held = File::open(&path).expect("opens");
        pread(&held);
        for text in texts {
            let unread = File::open(&path).expect("opens");
            if text == "3200\n" {
                fs::write(mount.path("df/transaction"), format!("begin\n80/53 {text}commit\n"))
                    .expect("writes");
            } else {
                fs::write(&path, text).expect("writes");
            }
            let fresh = File::open(&path).expect("opens");
            for file in [&held, &unread, &fresh] {
                assert_eq!(String::from_utf8_lossy(&pread(file)), text, "{name}");
                assert_eq!(number(file), fs::metadata(&path).expect("it exists").ino(), "{name}");
            }
        }
    }
}
