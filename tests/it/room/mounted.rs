// SPDX-License-Identifier: MIT

//! A simulated gauge that the test's own process mounts.

use std::fs::{self, OpenOptions};
use std::io::Write;
use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use gauge_bus::Bus;
use gauge_bus::clock::{Clock, HurriedClock, RealClock};
use gauge_owner::{self as owner, Handle, Run, Signal};
use gauge_sim::{Options, Sim};
use gaugefs::error::Result;
use gaugefs::fs::{Access, Fs, Knobs, Supply};
use gaugefs::fuse::{self, Mounted};
use nix::errno::Errno;
use ti_gauge::chip::Chip;
use ti_gauge::dataflash::Change;
use ti_gauge::keys::Keys;

use super::commands::is_in_real_time;
use super::{Folder, within};

/// The knobs of a simulated gauge. With `defect`, looking at one of them panics.
struct SimKnobs {
    sim: Sim,
    defect: Arc<AtomicBool>,
}

impl Knobs for SimKnobs {
    fn list(&self) -> Vec<(&'static str, bool)> {
        self.sim.knobs().iter().map(|knob| (knob.name, knob.writable)).collect()
    }

    fn get(&self, name: &str) -> Option<String> {
        assert!(!self.defect.load(Ordering::SeqCst), "as the test wants it");
        self.sim.get(name)
    }

    fn set(&self, name: &str, text: &str) -> Result<()> {
        Ok(self.sim.set(name, text)?)
    }
}

/// One simulated gauge, mounted.
pub(crate) struct Mount {
    pub(crate) folder: PathBuf,
    pub(crate) sim: Sim,
    pub(crate) handle: Handle,
    pub(crate) defect: Arc<AtomicBool>,
    _mounted: Mounted,
}

impl Drop for Mount {
    fn drop(&mut self) {
        // The test may have left files open, but the mount must be removed in any case.
        let _ = nix::mount::umount2(&self.folder, nix::mount::MntFlags::MNT_DETACH);
        let _ = fs::remove_dir(&self.folder);
    }
}

impl Mount {
    /// `None` if this machine cannot mount FUSE.
    pub(crate) fn new(chip: &str, interval: Duration, keys: Keys) -> Option<Self> {
        Self::with(chip, interval, keys, |_| {}, Vec::new(), |sim| Box::new(sim.bus()))
    }

    /// A mount whose simulated gauge is prepared first, with a configuration to restore, behind a given bus.
    pub(crate) fn with(
        chip: &str,
        interval: Duration,
        keys: Keys,
        prepare: impl FnOnce(&Sim),
        profile: Vec<Change>,
        bus: impl FnOnce(&Sim) -> Box<dyn Bus>,
    ) -> Option<Self> {
        Self::of(
            chip,
            Run { keys, interval, profile, ..Run::default() },
            prepare,
            bus,
            fuse::Options::default(),
        )
    }

    pub(crate) fn of(
        chip: &str,
        run: Run,
        prepare: impl FnOnce(&Sim),
        bus: impl FnOnce(&Sim) -> Box<dyn Bus>,
        options: fuse::Options,
    ) -> Option<Self> {
        if OpenOptions::new().read(true).write(true).open("/dev/fuse").is_err() {
            eprintln!("SKIPPED: /dev/fuse cannot be opened; no test of the mount ran");
            return None;
        }
        let folder = super::scratch::folder();
        let clock: Arc<dyn Clock> =
            if is_in_real_time() { Arc::new(RealClock::new()) } else { Arc::new(HurriedClock::default()) };
        let sim = Sim::new(chip, &Options::default(), clock.clone()).expect("a simulated chip");
        sim.be_strict();
        prepare(&sim);
        clock.sleep(Duration::from_millis(1300));
        let (signal, defect) = (Arc::new(Signal::default()), Arc::new(AtomicBool::new(false)));
        let table = Chip::by_name(chip).expect("a chip of the tables");
        let handle = owner::spawn(table, bus(&sim), clock, run, signal.clone()).expect("a gauge");
        let entry = Supply::new("BAT0".into(), handle.clone())
            .with_knobs(Some(Box::new(SimKnobs { sim: sim.clone(), defect: defect.clone() })));
        let access = Access {
            uid: nix::unistd::geteuid().as_raw(),
            gid: nix::unistd::getegid().as_raw(),
            group: false,
        };
        let tree = Arc::new(Fs::new(vec![entry], access));
        let mounted = fuse::mount(tree, &folder, options, signal).expect("a mount");
        // The second poll, half a second later, reads the registers that no attribute needs.
        within("the second poll", || statistic(&handle, "polls") >= 2);
        Some(Self { folder, sim, handle, defect, _mounted: mounted })
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.join("BAT0").join(name)
    }

    pub(crate) fn cat(&self, name: &str) -> String {
        let text = fs::read_to_string(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        text.trim_end_matches('\n').to_string()
    }

    /// Whether a file is there and has this text. One whose value is not known just now is not there.
    pub(crate) fn shows(&self, name: &str, text: &str) -> bool {
        fs::read_to_string(self.path(name)).is_ok_and(|found| found.trim_end_matches('\n') == text)
    }

    /// Does what `echo text > name` does.
    pub(crate) fn echo(&self, text: &str, name: &str) -> std::result::Result<(), Errno> {
        let mut file = OpenOptions::new().write(true).truncate(true).open(self.path(name)).map_err(errno)?;
        file.write_all(format!("{text}\n").as_bytes()).map_err(errno)
    }

    pub(crate) fn transfers(&self) -> u64 {
        statistic(&self.handle, "transfers")
    }
}

/// Messages that this process has read from the kernel: the mount's thread reads nothing else.
pub(crate) fn messages() -> u64 {
    let threads =
        fs::read_dir("/proc/self/task").expect("threads").map(|entry| entry.expect("a thread").path());
    let of_mounts = threads.filter(|thread| {
        fs::read_to_string(thread.join("comm")).is_ok_and(|name| name.starts_with("fuser-"))
    });
    let calls = |thread: PathBuf| {
        let text = fs::read_to_string(thread.join("io")).expect("the kernel counts calls");
        text.lines().find_map(|line| line.strip_prefix("syscr: ")?.parse::<u64>().ok()).expect("a count")
    };
    of_mounts.map(calls).sum()
}

/// Whether the kernel can be told to look names up again, and so may keep those of files.
pub(crate) fn keeps_names() -> bool {
    let release = nix::sys::utsname::uname().expect("a kernel").release().to_string_lossy().into_owned();
    let mut numbers = release.split(['.', '-', '+']).map(|number| number.parse::<u32>().unwrap_or(0));
    (numbers.next(), numbers.next()) >= (Some(6), Some(16))
}

/// A simulated gauge whose time does not have to pass, mounted at `m` in a folder of its own.
pub(crate) struct Swift {
    /// The gauge's folder.
    pub(crate) root: PathBuf,
    pub(crate) clock: Arc<HurriedClock>,
    pub(crate) sim: Sim,
    pub(crate) handle: Handle,
    _mounted: Mounted,
    pub(crate) folder: Folder,
}

impl Swift {
    /// A mount whose simulated gauge is prepared first.
    pub(crate) fn new(
        chip: &'static Chip,
        folder: Folder,
        run: Run,
        access: Access,
        prepare: impl FnOnce(&Sim),
    ) -> Self {
        Self::behind(chip, folder, run, access, prepare, |sim| Box::new(sim.bus()))
    }

    /// The same behind a given bus.
    pub(crate) fn behind(
        chip: &'static Chip,
        folder: Folder,
        run: Run,
        access: Access,
        prepare: impl FnOnce(&Sim),
        bus: impl FnOnce(&Sim) -> Box<dyn Bus>,
    ) -> Self {
        let at = PathBuf::from(folder.file("m"));
        fs::create_dir(&at).expect("a folder");
        let clock = Arc::new(HurriedClock::default());
        let sim = Sim::new(chip.name, &Options::default(), clock.clone()).expect("a simulated chip");
        sim.be_strict();
        prepare(&sim);
        clock.sleep(Duration::from_secs(2));
        let signal = Arc::new(Signal::default());
        let handle = owner::spawn(chip, bus(&sim), clock.clone(), run, signal.clone()).expect("a gauge");
        let gauge = Supply::new("BAT0".into(), handle.clone())
            .with_knobs(Some(Box::new(SimKnobs { sim: sim.clone(), defect: Arc::default() })));
        let tree = Arc::new(Fs::new(vec![gauge], access));
        let mounted = fuse::mount(tree, &at, fuse::Options::default(), signal).expect("a mount");
        Self { root: at.join("BAT0"), clock, sim, handle, _mounted: mounted, folder }
    }
}

/// A gauge behind a given bus, polled once an hour; `None` if this machine cannot mount FUSE.
pub(crate) fn swift(keys: Keys, bus: impl FnOnce(&Sim) -> Box<dyn Bus>) -> Option<Swift> {
    if !super::can_mount() {
        return None;
    }
    let run = Run { keys, interval: Duration::from_secs(3600), ..Run::default() };
    let (uid, gid) = (nix::unistd::geteuid().as_raw(), nix::unistd::getegid().as_raw());
    let chip = Chip::by_name(super::CHIP).expect("a chip of the tables");
    Some(Swift::behind(chip, Folder::new(), run, Access { uid, gid, group: false }, |_| {}, bus))
}

pub(crate) fn statistic(handle: &Handle, wanted: &str) -> u64 {
    handle.statistics().iter().find(|(name, _)| *name == wanted).expect("it is counted").1
}

pub(crate) fn errno(error: std::io::Error) -> Errno {
    Errno::from_raw(error.raw_os_error().unwrap_or_default())
}

pub(crate) fn quiet(chip: &str) -> Option<Mount> {
    Mount::new(chip, Duration::from_secs(3600), Keys::default())
}

/// The bytes of a file as a private mapping shows them; the kernel copies them, because touching a page that cannot be
/// read would end the process with SIGBUS. It is a process of its own: while the kernel fetches a page, no thread of that
/// process gets memory, and the daemon that is to answer is one of the test's threads.
pub(crate) fn mapped(fd: &OwnedFd, pipe: &(OwnedFd, OwnedFd)) -> rustix::io::Result<Vec<u8>> {
    use nix::sys::wait::{WaitStatus, waitpid};
    use nix::unistd::{ForkResult, fork};
    use rustix::mm::{MapFlags, ProtFlags, mmap};
    const LENGTH: usize = 4096;
    #[allow(
        unsafe_code,
        reason = "the child makes three system calls and ends; the kernel alone reads its mapping"
    )]
    let child = unsafe {
        match fork().expect("a process") {
            ForkResult::Parent { child } => child,
            ForkResult::Child => {
                let at = mmap(std::ptr::null_mut(), LENGTH, ProtFlags::READ, MapFlags::PRIVATE, fd, 0);
                let copied = at.and_then(|at| {
                    rustix::io::write(&pipe.1, std::slice::from_raw_parts(at.cast::<u8>(), LENGTH))
                });
                nix::libc::_exit(copied.map_or_else(|error| error.raw_os_error(), |_| 0))
            }
        }
    };
    match waitpid(child, None) {
        Ok(WaitStatus::Exited(_, 0)) => {}
        Ok(WaitStatus::Exited(_, errno)) => return Err(rustix::io::Errno::from_raw_os_error(errno)),
        other => panic!("{other:?}"),
    }
    let mut bytes = vec![0; LENGTH];
    let count = rustix::io::read(&pipe.0, &mut bytes[..])?;
    bytes.truncate(count);
    Ok(bytes)
}

/// A write whose buffer ends before its length: only the first `there` bytes of the text can be read.
pub(crate) fn write_cut(fd: &OwnedFd, text: &[u8], there: usize) -> rustix::io::Result<usize> {
    use rustix::mm::{MapFlags, MprotectFlags, ProtFlags, mmap_anonymous, mprotect, munmap};
    const PAGE: usize = 4096;
    let there = there.min(text.len()).min(PAGE);
    #[allow(unsafe_code, reason = "two pages of its own, of which the kernel may read one; unmapped here")]
    unsafe {
        let at = mmap_anonymous(
            std::ptr::null_mut(),
            2 * PAGE,
            ProtFlags::READ | ProtFlags::WRITE,
            MapFlags::PRIVATE,
        )?;
        let first = at.cast::<u8>().add(PAGE - there);
        std::ptr::copy_nonoverlapping(text.as_ptr(), first, there);
        mprotect(at.cast::<u8>().add(PAGE).cast(), PAGE, MprotectFlags::empty())?;
        // The rest is never touched by this process, and the kernel answers EFAULT for it.
        let written = rustix::io::write(fd, std::slice::from_raw_parts(first, text.len()));
        munmap(at, 2 * PAGE)?;
        written
    }
}
