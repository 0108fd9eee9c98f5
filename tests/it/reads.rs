// SPDX-License-Identifier: MIT

//! Every errno of a read arrives, in each way in which a program can read, on the kernel that runs this. tests/vm/kernels
//! runs this file on others: from Linux 7.2 on, the errno of a READ that fills the page cache becomes EIO.

use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom};
use std::os::fd::OwnedFd;
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::Path;
use std::sync::{Arc, Mutex};

use gauge_bus::{Bus, BusError};
use gauge_sim::SimBus;
use nix::errno::Errno;
use ti_gauge::keys::Keys;

use crate::room::{CHIP, Swift, errno, keeps_names, mapped, messages, quiet, swift, within};

/// Of data flash: a parameter, all bytes of a subclass, a link, and all of it.
const UNREAD: [&str; 4] =
    ["df/80/53", "df/48/raw", "df/by-name/configuration-data/serial-number", "df/index"];

/// What becomes of transfers.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    None,
    Bus(BusError),
    /// One bit of what is read of a block is another one.
    Flip,
}

#[derive(Clone)]
struct Faulty(Arc<Mutex<Fault>>);

struct FaultyBus(SimBus, Faulty);

impl Bus for FaultyBus {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let fault = *self.1.0.lock().expect("no panic");
        if let Fault::Bus(error) = fault {
            return Err(error);
        }
        self.0.transfer(write, read)?;
        if fault == Fault::Flip && read.len() >= 32 {
            read[20] ^= 8;
        }
        Ok(())
    }
}

impl Faulty {
    /// A gauge behind such a bus, whose waits take no time.
    fn mount(keys: Keys) -> Option<(Self, Swift)> {
        let faulty = Self(Arc::new(Mutex::new(Fault::None)));
        let mount = swift(keys, |sim| Box::new(FaultyBus(sim.bus(), faulty.clone())))?;
        Some((faulty, mount))
    }

    fn set(&self, fault: Fault) {
        *self.0.lock().expect("no panic") = fault;
    }
}

type Answer = Result<Vec<u8>, Errno>;

fn read(mut file: &File) -> Answer {
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(errno)?;
    Ok(bytes)
}

fn pread(file: &File) -> Answer {
    let mut bytes = vec![0; 1 << 16];
    let count = file.read_at(&mut bytes, 0).map_err(errno)?;
    bytes.truncate(count);
    Ok(bytes)
}

fn size(file: &File) -> Answer {
    file.metadata().map(|status| vec![0; status.len() as usize]).map_err(errno)
}

fn end(mut file: &File) -> Answer {
    file.seek(SeekFrom::End(0)).map(|end| vec![0; end as usize]).map_err(errno)
}

fn send(file: &File) -> Answer {
    let (mut from, to) = std::io::pipe().expect("a pipe");
    let count = rustix::fs::sendfile(&to, file, Some(&mut 0), 1 << 16)
        .map_err(|error| Errno::from_raw(error.raw_os_error()))?;
    let mut bytes = vec![0; count];
    from.read_exact(&mut bytes).expect("what was sent");
    Ok(bytes)
}

/// As programs do it that want to know how much there is.
fn look_and_send(file: &File) -> Answer {
    size(file)?;
    send(file)
}

fn map(file: &File) -> Answer {
    let (file, pipe) =
        (OwnedFd::from(file.try_clone().expect("a descriptor")), nix::unistd::pipe().expect("a pipe"));
    mapped(&file, &pipe).map_err(|error| Errno::from_raw(error.raw_os_error()))
}

type Way = (&'static str, fn(&File) -> Answer);

/// Ways to read a file that get the errno of the table.
const WAYS: [Way; 5] = [
    ("read", read),
    ("pread", pread),
    ("fstat", size),
    ("lseek to the end", end),
    ("fstat, sendfile", look_and_send),
];

/// A file fails in each way, with that errno, through a file that was opened before and through a new one.
#[track_caller]
fn fails(root: &Path, name: &str, held: Option<&File>, expected: Errno) {
    let anew = || File::open(root.join(name)).expect("opens");
    let open = || held.map_or_else(anew, |held| held.try_clone().expect("a descriptor"));
    let whose = if held.is_some() { "held open" } else { "opened" };
    for (way, answer) in WAYS {
        let found = answer(&open());
        assert_eq!(found.map(|bytes| bytes.len()), Err(expected), "{name}, {whose}: {way}");
    }
    // To these, Linux 7.2 and later answer EIO. A page that cannot be read is SIGBUS, or EFAULT where the kernel copies it.
    let sent = send(&open()).expect_err("no value");
    assert!([expected, Errno::EIO].contains(&sent), "{name}, {whose}: sendfile: {sent}");
    assert_eq!(map(&open()), Err(Errno::EFAULT), "{name}, {whose}");
    // ENXIO would mean that the rest is a hole.
    let file = open();
    assert_eq!(rustix::fs::seek(&file, rustix::fs::SeekFrom::Data(0)), Ok(0), "{name}, {whose}");
}

#[test]
fn regression_the_errno_of_a_first_read_arrives() {
    let Some((faulty, mount)) = Faulty::mount(Keys::default()) else { return };
    let bus = Fault::Bus;
    for (fault, expected) in [
        (bus(BusError::NoAck), Errno::ENXIO),
        (bus(BusError::ArbitrationLost), Errno::EAGAIN),
        (bus(BusError::Timeout), Errno::ETIMEDOUT),
        (bus(BusError::Short), Errno::EPROTO),
        (bus(BusError::Gone), Errno::ENODEV),
        (bus(BusError::Busy), Errno::EBUSY),
        (Fault::Flip, Errno::EBADMSG),
    ] {
        for name in UNREAD {
            let path = mount.root.join(name);
            let open = || File::open(&path).expect("opens");
            let held = open();
            faulty.set(fault);
            fails(&mount.root, name, Some(&held), expected);
            fails(&mount.root, name, None, expected);
            faulty.set(Fault::None);
            // Then the value comes, through the same open file and in every other way.
            within("the value", || pread(&held).is_ok());
            let value = pread(&held).expect("a value");
            assert!(value.ends_with(b"\n") || name.ends_with("raw"), "{name}");
            for (way, answer) in [
                ("read", read as fn(&File) -> Answer),
                ("sendfile", send),
                ("fstat, sendfile", look_and_send),
            ] {
                within("a refresh", || fs::write(mount.root.join("gauge/refresh"), "1").is_ok());
                assert!(answer(&open()).expect("a value") == value, "{name}: {way}");
            }
            within("a refresh", || fs::write(mount.root.join("gauge/refresh"), "1").is_ok());
        }
    }
}

#[test]
fn regression_the_errno_of_a_sealed_gauge_arrives() {
    let mut none = Keys::default();
    none.no_default = true;
    let Some((_, mount)) = Faulty::mount(none) else { return };
    for name in &UNREAD[..3] {
        fails(&mount.root, name, None, Errno::EPERM);
    }
    // A file of keys is never read, whatever opens the gauge.
    let Some(open) = quiet(CHIP) else { return };
    fails(&open.path(""), "df/112/0", None, Errno::EPERM);
}

#[test]
fn regression_a_value_that_has_gone_is_enodev_to_whoever_holds_it_open() {
    let Some(mount) = quiet(CHIP) else { return };
    let names = ["voltage_now", "capacity", "gauge/registers/voltage", "gauge/age_ms", "gauge/flags"];
    let held: Vec<_> = names.iter().map(|name| File::open(mount.path(name)).expect("opens")).collect();
    // One of each pair has been read.
    for file in &held[..3] {
        pread(file).expect("a value");
    }
    mount.sim.set("power", "off").expect("a knob");
    for _ in 0..3 {
        let _ = mount.echo("1", "gauge/refresh");
    }
    for (name, file) in names.iter().zip(&held) {
        within("the end of its value", || pread(file).is_err());
        for (way, answer) in WAYS {
            assert_eq!(answer(file).map(|bytes| bytes.len()), Err(Errno::ENODEV), "{name}: {way}");
        }
        assert_eq!(fs::metadata(mount.path(name)).map(drop).map_err(errno), Err(Errno::ENOENT), "{name}");
    }
}

/// `stat` and `ls` ask nothing of the gauge; `fstat` of an open file tells the size of its value.
#[test]
fn the_size_of_an_open_file_is_that_of_its_value() {
    let Some(mount) = quiet(CHIP) else { return };
    for name in UNREAD {
        assert_eq!(mount.echo("1", "gauge/refresh"), Ok(()));
        let before = mount.transfers();
        for _ in 0..3 {
            assert!(fs::metadata(mount.path(name)).expect("there").len() >= 32, "{name}");
        }
        assert_eq!(mount.transfers(), before, "{name}");
        let file = File::open(mount.path(name)).expect("opens");
        let status = file.metadata().expect("a value");
        let value = fs::read(mount.path(name)).expect("a value");
        assert_eq!(
            (status.len(), status.blocks()),
            (value.len() as u64, value.len().div_ceil(512) as u64),
            "{name}"
        );
    }
    // Nobody who overwrites a file wants its value.
    assert_eq!(mount.echo("1", "gauge/refresh"), Ok(()));
    let before = mount.transfers();
    let file = File::create(mount.path("df/80/53")).expect("opens");
    assert_eq!((file.metadata().expect("there").len(), mount.transfers()), (4096, before));
}

/// 32-bit programs without large-file support get EOVERFLOW otherwise.
#[test]
fn regression_inode_numbers_have_32_bits() {
    fn walk(folder: &Path, count: &mut usize) {
        for entry in fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            let status = fs::symlink_metadata(&path).expect("there");
            assert!(u32::try_from(status.ino()).is_ok(), "{}: {:#x}", path.display(), status.ino());
            *count += 1;
            if status.is_file() && status.mode() & 0o444 != 0 && !path.display().to_string().contains("/df/")
            {
                let file = File::open(&path).expect("opens");
                assert_eq!(file.metadata().expect("there").ino(), status.ino(), "{}", path.display());
            } else if status.is_dir() {
                walk(&path, count);
            }
        }
    }
    let Some(mount) = quiet(CHIP) else { return };
    let mut count = 0;
    walk(&mount.folder, &mut count);
    assert!(count > 300, "{count}");
}

#[test]
fn hot_reads_cost_no_message() {
    const READS: u64 = 2000;
    let Some(mount) = quiet(CHIP) else { return };
    let held = File::open(mount.path("voltage_now")).expect("opens");
    let cost = |what: &dyn Fn()| {
        what();
        let before = messages();
        (0..READS).for_each(|_| what());
        messages() - before
    };
    assert_eq!(mount.cat("voltage_now"), String::from_utf8_lossy(&pread(&held).expect("a value")).trim_end());
    let (of_held, of_opened) = (cost(&|| drop(pread(&held))), cost(&|| drop(mount.cat("voltage_now"))));
    println!("{READS} reads cost {of_held} messages held open, {of_opened} opened anew");
    // Each two seconds the kernel asks whether they still hold.
    assert!(of_held < READS / 10, "{of_held}");
    assert!(of_opened < if keeps_names() { READS / 10 } else { READS * 11 / 10 }, "{of_opened}");
}

/// Programs that read hundreds of gauges read one file of each.
#[test]
fn values_tells_what_the_files_tell_for_a_few_messages() {
    const FOLDERS: [&str; 3] = ["", "gauge/", "gauge/statistics/"];
    const OWN: [&str; 2] = ["gauge/poll_interval", "gauge/seal"];
    let Some(mount) = quiet(CHIP) else { return };
    within("the second poll", || mount.cat("gauge/statistics/polls") == "2");
    let folder = mount.path("");
    let files = FOLDERS.iter().flat_map(|inside| {
        let entries = fs::read_dir(folder.join(inside)).expect("a folder").map(|entry| entry.expect("one"));
        entries.map(move |entry| (format!("{inside}{}", entry.file_name().display()), entry))
    });
    // Those that every user may read, but for the files that have the others.
    let is_for_all = |name: &String, entry: &fs::DirEntry| {
        let status = entry.metadata().expect("there");
        status.is_file() && status.mode() & 0o004 != 0 && !["uevent", "gauge/values"].contains(&name.as_str())
    };
    let files = files.filter(|(name, entry)| is_for_all(name, entry));
    let mut files: Vec<_> = files.map(|(name, _)| name).chain(OWN.map(String::from)).collect();
    files.sort();
    let values = || gaugefs_client::follow::values(&folder, &[]).expect("a gauge");
    let told = values();
    assert_eq!(told.keys().collect::<Vec<_>>(), files.iter().collect::<Vec<_>>());
    for (name, text) in told.iter().filter(|(name, _)| *name != "gauge/age_ms") {
        assert_eq!(*text, mount.cat(name), "{name}");
    }
    assert!(told["gauge/check"].lines().count() > 1, "{told:?}");
    let for_all = mount.cat("gauge/values");
    assert!(for_all.contains("gauge/owed=") && OWN.iter().all(|name| !for_all.contains(name)), "{for_all}");
    let before = messages();
    values();
    let cost = messages() - before;
    assert!(cost <= 5, "{cost} messages");
}
