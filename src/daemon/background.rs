// SPDX-License-Identifier: MIT

//! Going to the background.
//!
//! The parent starts gaugefs again as a child instead of forking, because a fork keeps only one thread. It waits until
//! the child reports the mount. Until then the child prints errors to the user's terminal and can be interrupted
//! together with its parent; after that it has none of the parent's terminal, folder and descriptors.

use std::env;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::Read;
use std::os::fd::RawFd;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::UnixDatagram;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Command, ExitCode, Stdio};

use gauge_bus::regular;
use nix::unistd::{chdir, close, dup2_stderr, dup2_stdin, dup2_stdout, getpid, getppid, setsid};

use crate::error::{Error, Result};
use crate::output::{self, print_file};

/// Environment variable that marks the child.
const CHILD: &str = "GAUGEFS_IN_BACKGROUND";
/// One heap for all threads without per-thread caches, and no cache of stacks. Threads come and go with the gauges'
/// work, and allocate little and seldom: free memory in separate heaps and caches would be as large as the memory in
/// use. The stacks that opened the gauges are not needed again. glibc reads this before a program begins; the packaged
/// services have it in `service.conf`.
const TUNABLES: &str = "GLIBC_TUNABLES";
const SMALL: &str = "glibc.malloc.arena_max=1:glibc.malloc.tcache_count=0:glibc.pthread.stack_cache_size=0";
const READY: &[u8] = b"ready\n";

/// Whether this process is the child.
pub fn is_child() -> bool {
    env::var_os(CHILD).is_some()
}

/// Whether systemd has started this process, or its parent, which waits until this one is ready.
pub(super) fn is_of_a_unit() -> bool {
    let started = env::var("SYSTEMD_EXEC_PID").ok().and_then(|process| process.parse().ok());
    let is_ours = |process: i32| process == getpid().as_raw() || process == getppid().as_raw();
    env::var_os("NOTIFY_SOCKET").is_some() || started.is_some_and(is_ours)
}

/// Whether a command line mounts in the background by its words alone. The child tells what is wrong with it, so the
/// parent need not parse it, too.
pub(crate) fn is_asked(arguments: &[OsString]) -> bool {
    const STAYS: [&str; 4] = ["--check", "--foreground", "--help", "--service"];
    let mut words = arguments.iter().skip(1);
    let goes = |word: &OsString| {
        !word.as_bytes().starts_with(b"-")
            || word.as_bytes().starts_with(b"--") && !STAYS.iter().any(|stays| word == stays)
    };
    words.next().is_some_and(|command| command == "mount") && words.all(goes) && !is_child()
}

/// In the parent: starts the same command line again and waits until it is ready.
pub(crate) fn start(arguments: impl IntoIterator<Item = OsString>) -> Result<ExitCode> {
    let failed = |error| Error::io("gaugefs", "cannot go to the background", &error);
    // Starting it by path keeps the process's name. If the file was replaced, the kernel's link remains.
    let program = env::current_exe().ok().filter(|path| path.exists());
    let program = program.unwrap_or_else(|| "/proc/self/exe".into());
    let mut arguments = arguments.into_iter();
    let mut command = Command::new(program);
    if let Some(name) = arguments.next() {
        command.arg0(name);
    }
    command.args(arguments).env(CHILD, "1").stdout(Stdio::piped());
    if env::var_os(TUNABLES).is_none() {
        command.env(TUNABLES, SMALL);
    }
    let mut child = command.spawn().map_err(failed)?;
    let mut answer = Vec::new();
    if let Some(out) = &mut child.stdout {
        let length = READY.len() as u64;
        answer = regular::read_from(out.take(length), length).map_err(failed)?;
    }
    if answer == READY {
        return Ok(ExitCode::SUCCESS);
    }
    let status = child.wait().map_err(failed)?;
    if let Some(signal) = status.signal() {
        let why = format!("it was killed by signal {signal} before the gauge was mounted");
        return Err(Error::host("gaugefs", nix::errno::Errno::EINTR, why));
    }
    // The child has printed its error. One that was told to end right after mounting ends with 0.
    let code = status.code().and_then(|code| u8::try_from(code).ok()).filter(|&code| code != 0);
    Ok(ExitCode::from(code.unwrap_or(1)))
}

/// Descriptors inherited besides the three standard ones. They may be pipes whose readers wait for their end. Call it
/// before opening anything.
pub fn inherited() -> Vec<RawFd> {
    let open = fs::read_dir("/proc/self/fd").into_iter().flatten().flatten();
    let numbers = open.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    // Listing them needed a descriptor, which is closed by now.
    let mut numbers: Vec<RawFd> = numbers.filter(|&number| number > 2).collect();
    numbers.retain(|number| fs::symlink_metadata(format!("/proc/self/fd/{number}")).is_ok());
    numbers
}

/// In the child: closes the terminal and the inherited descriptors, and lets the parent end.
pub fn ready(inherited: &[RawFd]) -> Result<()> {
    let failed = |error| Error::io("gaugefs", "cannot go to the background", &error);
    let to = |errno: nix::errno::Errno| failed(errno.into());
    setsid().map_err(to)?;
    chdir(Path::new("/")).map_err(to)?;
    let nowhere = File::options().read(true).write(true).open("/dev/null").map_err(failed)?;
    dup2_stdin(&nowhere).map_err(to)?;
    // A missing parent was interrupted, so the mount is not wanted any more.
    print_file(READY)?;
    if output::is_closed() {
        return Err(to(nix::errno::Errno::EPIPE));
    }
    dup2_stdout(&nowhere).map_err(to)?;
    dup2_stderr(&nowhere).map_err(to)?;
    for &number in inherited {
        // Nothing in this process uses it.
        let _ = close(number);
    }
    Ok(())
}

/// Reports to systemd if it started this process, such as `READY=1`: the gauge is mounted.
pub fn notify(what: &str) {
    let Some(socket) = env::var_os("NOTIFY_SOCKET") else { return };
    let sent = UnixDatagram::unbound().and_then(|sender| {
        use std::os::linux::net::SocketAddrExt;
        use std::os::unix::net::SocketAddr;
        let address = match socket.as_bytes() {
            [b'@', name @ ..] => SocketAddr::from_abstract_name(name)?,
            _ => SocketAddr::from_pathname(&socket)?,
        };
        sender.send_to_addr(what.as_bytes(), &address)
    });
    if let Err(error) = sent {
        log::warn!("cannot report to systemd {what}: {error}");
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn what_may_stay_in_the_foreground_is_parsed_first() {
        let is_asked = |line: &str| super::is_asked(&line.split(' ').map(Into::into).collect::<Vec<_>>());
        for goes in
            ["gaugefs mount --sim bq34z100-g1 /m", "gaugefs mount --bus=/dev/i2c-1 /m", "gaugefs mount"]
        {
            assert!(is_asked(goes), "{goes}");
        }
        let flags =
            ["-f", "-rf", "-h", "--help", "--foreground", "--check --config x", "--foreground --service"];
        for flag in flags {
            assert!(!is_asked(&format!("gaugefs mount --sim bq34z100-g1 {flag} /m")), "{flag}");
        }
        for other in ["gaugefs", "gaugefs umount /m", "gaugefs help mount", "gaugefs --help mount"] {
            assert!(!is_asked(other), "{other}");
        }
    }

    #[test]
    fn the_packaged_service_is_as_small_as_a_daemon_in_the_background() {
        let service = include_str!("../../udev/service.conf");
        let line = format!("Environment={}={}", super::TUNABLES, super::SMALL);
        assert!(service.lines().any(|at| at == line), "{line}");
    }
}
