// SPDX-License-Identifier: MIT

//! The only way to standard output and standard error.
//!
//! Every write to standard output is checked: a command fails if it could not print everything, unless its reader has
//! closed the pipe. Standard error reports failures, so a failure to write there cannot be reported.
//!
//! Texts and JSON pass through the sanitizer: other users choose names, which must not control the terminal.

#![expect(clippy::disallowed_methods, reason = "this is the module that the others use instead")]

use std::fmt::Display;
use std::io::{self, IsTerminal};
use std::os::fd::{AsFd, BorrowedFd};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, OnceLock};

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::unistd::write;
use serde::Serialize;
use ti_gauge::text;

use crate::error::{Error, Result};
use gauge_bus::regular::{self, Replace};

/// The reader of standard output has closed the pipe.
static CLOSED: AtomicBool = AtomicBool::new(false);
/// One text at a time: a long one takes several writes.
static TURN: Mutex<()> = Mutex::new(());

/// What the program is called in its messages, if not `gaugefs`.
static NAME: OnceLock<&'static str> = OnceLock::new();

/// Has messages begin with the name of this program, in place of `gaugefs`. Only the first name counts.
pub fn speak_as(program: &'static str) {
    let _ = NAME.set(program);
}

/// Prints lines for a person. Characters that control a terminal become escapes such as `\u{1b}`.
pub fn print(text: &str) -> Result<()> {
    print_file(text::lines(text).as_bytes())
}

/// Prints a value as one line of JSON.
pub fn print_json(value: &impl Serialize) -> Result<()> {
    let json = serde_json::to_string(value).expect("keys are strings, so it cannot fail");
    // Such a character can only be in a string.
    let escaped = json.chars().fold(String::with_capacity(json.len() + 1), |mut line, letter| {
        match text::is_plain(letter) {
            true => line.push(letter),
            false => line.push_str(&format!("\\u{:04x}", u32::from(letter))),
        }
        line
    });
    print_file((escaped + "\n").as_bytes())
}

/// Prints a file's content unchanged.
pub fn print_file(bytes: &[u8]) -> Result<()> {
    // A panic while this was held has left at most half a line behind.
    let _turn = TURN.lock();
    if is_closed() {
        return Ok(());
    }
    match write_all(io::stdout().as_fd(), bytes) {
        Err(Errno::EPIPE) => CLOSED.store(true, Ordering::SeqCst),
        outcome => {
            outcome.map_err(|errno| Error::io("", "cannot write standard output", &errno.into()))?;
        }
    }
    Ok(())
}

/// Replaces a file as a whole or not at all: see [`regular::replace`]. `-` is standard output.
pub fn write_file(path: &Path, bytes: &[u8], how: Replace) -> Result<()> {
    match is_standard_output(path) {
        true => print_file(bytes),
        false => regular::replace(path, bytes, how).map_err(|error| cannot_write(path, &error)),
    }
}

/// Checks that [`write_file`] would be allowed, before the work for it is done.
pub fn check_file(path: &Path, how: Replace) -> Result<()> {
    match is_standard_output(path) {
        true => Ok(()),
        false => regular::check_replace(path, how).map_err(|error| cannot_write(path, &error)),
    }
}

/// A regular file behind one of these names has a position, and other writers.
pub fn is_standard_output(path: &Path) -> bool {
    ["-", "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"].map(Path::new).contains(&path)
}

fn cannot_write(path: &Path, error: &io::Error) -> Error {
    let errno = match error.kind() {
        io::ErrorKind::AlreadyExists => Errno::EEXIST,
        _ => return Error::io(path.display().to_string(), "cannot write it", error),
    };
    Error::host(path.display().to_string(), errno, "it is there already")
}

/// Whether a write found that the reader of standard output has closed the pipe.
pub fn is_closed() -> bool {
    CLOSED.load(Ordering::SeqCst)
}

/// Whether the reader of standard output is gone, even before a write: commands that print until stopped end then.
pub fn is_unread() -> bool {
    let out = io::stdout();
    let mut polled = [PollFd::new(out.as_fd(), PollFlags::empty())];
    let is_polled = poll(&mut polled, PollTimeout::ZERO).is_ok_and(|count| count > 0);
    is_closed() || is_polled && polled[0].revents().is_some_and(|found| found.contains(PollFlags::POLLERR))
}

/// Prints a line to standard error, such as `gaugefs: warning: ...`.
pub fn say(line: impl Display) {
    let program = NAME.get().unwrap_or(&"gaugefs");
    print_error(&format!("{program}: {}\n", text::printable(&line.to_string())));
}

/// Prints an error to standard error, with all mistakes of a file.
pub fn say_error(error: &Error) {
    error.lines().for_each(say);
}

/// Prints a text to standard error unchanged.
pub fn print_error(text: &str) {
    let _ = write_all(io::stderr().as_fd(), text.as_bytes());
}

/// Whether standard output is a terminal.
pub fn is_terminal() -> bool {
    io::stdout().is_terminal()
}

/// Whether standard error is a terminal.
pub fn errors_are_seen() -> bool {
    io::stderr().is_terminal()
}

/// Writes to the descriptor itself. The standard library hides that a descriptor is not open for writing.
fn write_all(to: BorrowedFd<'_>, mut bytes: &[u8]) -> nix::Result<()> {
    while !bytes.is_empty() {
        match write(to, bytes) {
            Ok(0) => return Err(Errno::EIO),
            Ok(written) => bytes = &bytes[written..],
            Err(Errno::EINTR) => {}
            // Another process has made the terminal or the pipe non-blocking.
            Err(Errno::EAGAIN) => {
                poll(&mut [PollFd::new(to, PollFlags::POLLOUT)], PollTimeout::NONE).map(drop).or_else(
                    |errno| match errno {
                        Errno::EINTR => Ok(()),
                        errno => Err(errno),
                    },
                )?;
            }
            Err(errno) => return Err(errno),
        }
    }
    Ok(())
}
