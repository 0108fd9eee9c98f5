// SPDX-License-Identifier: MIT

//! `gaugefs keys change`: changes a key of a mounted gauge. Keys come from files that only their owner may read or from
//! the terminal, never from the command line, and leave this process in one write(2) to `gauge/keys`.

use std::fs::File;
use std::io::{Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::builder::PossibleValuesParser;
use clap::{Args, Subcommand};
use nix::sys::termios::{LocalFlags, SetArg, SpecialCharacterIndices, Termios, tcgetattr, tcsetattr};
use zeroize::Zeroizing;

use super::mounted;
use crate::error::{Cause, Error, Result};
use crate::output::print;
use gauge_owner::key_file;
use gaugefs_client::Gauge;
use ti_gauge::keys::{Name, Secret};

const CHANGE: &str = "\
Write the new key down before you begin: without its key, a gauge can never be unsealed again.
Without key files, the terminal asks for the keys, twice for the new one, and does not show them.

The old key is tried first. Exit code 0 means that the new key is in the gauge and was tested: it
has unsealed the gauge, or the gauge has answered a challenge with it. The mount uses the new key
from then on, but its key file is not changed.

A change that a power cut has interrupted is made by the same command with the same two keys, and
undone by the same command with the two keys exchanged; `gaugefs settle` shows which keys the gauge
has meanwhile. Keys of the mount's key file that were erased with it are put back, too.

Examples:
  gaugefs keys change /run/gauges/BAT0 unseal
  gaugefs keys change --key-file old.keys --new-key-file new.keys BAT0 unseal";

/// Longest line from the terminal.
const LINE: usize = 256;
/// Ctrl-C, as a character.
const INTERRUPT: u8 = 3;

/// Change the keys of a mounted gauge
#[derive(Args, Debug)]
#[command(arg_required_else_help = true)]
pub(super) struct Command {
    #[command(subcommand)]
    command: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    Change(Change),
}

/// Change a key of a mounted gauge
#[derive(Args, Debug)]
#[command(after_help = CHANGE)]
struct Change {
    /// Folder of a mounted gauge, such as /run/gauges/BAT0
    gauge: PathBuf,
    /// Which key: unseal, full-access or authentication
    #[arg(value_name = "KEY", value_parser = PossibleValuesParser::new(Name::ALL.map(Name::as_str)), hide_possible_values = true)]
    key: String,
    /// Key file with the old key; must not be readable by others [default: ask for it]
    #[arg(long, value_name = "FILE")]
    key_file: Option<PathBuf>,
    /// Key file with the new key; must not be readable by others [default: ask for it twice]
    #[arg(long, value_name = "FILE")]
    new_key_file: Option<PathBuf>,
}

impl Command {
    pub(super) fn run(self) -> Result<ExitCode> {
        let Action::Change(change) = self.command;
        let gauge = Gauge::open(&change.gauge)?;
        let changed = change.run(&gauge)?;
        // The key is changed, printed or not.
        print(&changed).map_err(|error| error.within(&changed.replace('\n', " ")))?;
        Ok(ExitCode::SUCCESS)
    }
}

impl Change {
    /// The text for a changed key.
    fn run(&self, gauge: &Gauge) -> Result<String> {
        const FILE: &str = "gauge/keys";
        let name = Name::ALL.into_iter().find(|name| name.as_str() == self.key);
        let name = name.expect("clap accepts only names of keys");
        gauge.check_has(FILE, "keys")?;
        mounted::poll(gauge)?;
        let (old, new) = self.keys(name, &gauge.name())?;
        let (word, [old, new]) = (name.as_str(), [old.text(), new.text()]);
        // Reserved at once: a growing string leaves copies behind that are not wiped.
        let mut line = Zeroizing::new(String::with_capacity(LINE));
        for part in [word, " ", &old, " ", &new, "\n"] {
            line.push_str(part);
        }
        let failed = |error: gaugefs_client::Error| Error::from(error.doing("the key was not changed"));
        let mut file = gauge.open_to_write(FILE).map_err(failed)?;
        let sent = file.send(line.as_bytes());
        // The daemon reads its next request into the same buffer, so this overwrites the keys there. Its failure is
        // harmless.
        let _ = file.send(" ".repeat(line.len()).as_bytes());
        match sent {
            Ok(_) => Ok(format!(
                "The {word} key is changed and was tested. The mount uses it now; before the next mount, put the\n\
                 new key into the key file, as the line `{} = ...`.\n",
                name.line()
            )),
            Err(failure) => Err(failed(failure)),
        }
    }

    fn keys(&self, name: Name, gauge: &str) -> Result<(Secret, Secret)> {
        // Both files are checked before anybody types a key.
        let of_file =
            |file: &Option<PathBuf>| file.as_deref().map(|file| of_file(file, name, gauge)).transpose();
        match (of_file(&self.key_file)?, of_file(&self.new_key_file)?) {
            (Some(old), Some(new)) => Ok((old, new)),
            (old, new) => {
                let mut terminal = Terminal::open()?;
                let old = old.map_or_else(|| terminal.ask(name, "old"), Ok)?;
                let new = new.map_or_else(|| terminal.ask_twice(name), Ok)?;
                Ok((old, new))
            }
        }
    }
}

fn of_file(file: &Path, name: Name, gauge: &str) -> Result<Secret> {
    key_file::from_file(file, gauge)?.secret(name).ok_or_else(|| {
        let why = format!("has no line `{} = ...` for {gauge}", name.line());
        Error::new(file.display().to_string(), Cause::Invalid, why)
    })
}

/// The terminal, without echo as long as this exists.
struct Terminal {
    file: File,
    before: Termios,
}

impl Terminal {
    fn open() -> Result<Self> {
        let failed = |error: std::io::Error| {
            let what = "there is no terminal to ask for the key; pass --key-file and --new-key-file";
            Error::io("/dev/tty", what, &error)
        };
        let mut options = File::options();
        let options = options.read(true).write(true).custom_flags(nix::libc::O_NOCTTY);
        let file = options.open("/dev/tty").map_err(failed)?;
        let before = tcgetattr(&file).map_err(|errno| failed(errno.into()))?;
        let mut silent = before.clone();
        silent.local_flags.remove(LocalFlags::ECHO | LocalFlags::ISIG);
        silent.local_flags.insert(LocalFlags::ICANON | LocalFlags::ECHONL);
        // Ctrl-C would end the process and leave the echo off. Here it ends the line, which is then found to contain
        // it.
        silent.control_chars[SpecialCharacterIndices::VEOL as usize] = INTERRUPT;
        tcsetattr(&file, SetArg::TCSAFLUSH, &silent).map_err(|errno| failed(errno.into()))?;
        Ok(Self { file, before })
    }

    fn ask(&mut self, name: Name, which: &str) -> Result<Secret> {
        let subject = format!("{which} {} key", name.as_str());
        let failed = |error: std::io::Error| Error::io(&subject, "cannot ask for it", &error);
        let refuse = |why: &'static str| Error::new(&subject, Cause::Invalid, why);
        write!(self.file, "{which} {} key: ", name.as_str()).map_err(failed)?;
        let mut line = Zeroizing::new([0; LINE]);
        // The terminal gives one line at a time.
        let length = self.file.read(&mut *line).map_err(failed)?;
        let line = &line[..length];
        if line.is_empty() || line.contains(&INTERRUPT) {
            return Err(refuse("no key was typed; nothing was changed"));
        }
        let text = std::str::from_utf8(line).map_err(|_| refuse(name.form()))?;
        Secret::parse(name, text.trim()).ok_or_else(|| refuse(name.form()))
    }

    fn ask_twice(&mut self, name: Name) -> Result<Secret> {
        let first = self.ask(name, "new")?;
        if self.ask(name, "repeat the new")? == first {
            return Ok(first);
        }
        let why = "two different keys were typed; nothing was changed";
        Err(Error::new(format!("new {} key", name.as_str()), Cause::Invalid, why))
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        // A lost terminal needs no restoring.
        let _ = tcsetattr(&self.file, SetArg::TCSAFLUSH, &self.before);
    }
}
