//! `gaugefs keys change`: another key for a mounted gauge. Keys come from files that nobody else may read or
//! from the terminal, never from the command line, and leave this process in one write(2) to `gauge/keys`.

use std::fs::File;
use std::io::{Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::builder::PossibleValuesParser;
use clap::{Args, Subcommand};
use nix::errno::Errno;
use nix::sys::termios::{LocalFlags, SetArg, SpecialCharacterIndices, Termios, tcgetattr, tcsetattr};
use zeroize::Zeroizing;

use super::{folder_name, print};
use crate::error::{Cause, Error, Result};
use crate::key_file;
use crate::keys::{Name, Secret};

const CHANGE: &str = "\
A gauge whose key nobody knows is lost for ever: write the new key down before you begin.
Without a file a key is asked for at the terminal, the new one twice, and is not shown.
The old key is tried first. The new one is in the gauge when this returns 0: it has been
sealed and opened with it, or has answered a challenge. The mount uses it from then on; its
key file is yours to change.

Examples:
  gaugefs keys change /run/gauges/BAT0 unseal
  gaugefs keys change /run/gauges/BAT0 unseal --key-file old.keys --new-key-file new.keys";

/// Longest line that is taken from the terminal.
const LINE: usize = 256;
/// Ctrl-C, as a character.
const INTERRUPT: u8 = 3;

/// Change the keys of a mounted gauge
#[derive(Args, Debug)]
#[command(arg_required_else_help = true)]
pub(super) struct Command {
    #[command(subcommand)]
    command: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Change(Change),
}

/// Give a mounted gauge another key
#[derive(Args, Debug)]
#[command(after_help = CHANGE)]
struct Change {
    /// The gauge's folder, such as /run/gauges/BAT0
    gauge: PathBuf,
    /// unseal, full-access or authentication
    #[arg(value_name = "KEY", value_parser = PossibleValuesParser::new(Name::ALL.map(Name::as_str)), hide_possible_values = true)]
    key: String,
    /// Key file with the old key; nobody else may read it [default: it is asked for]
    #[arg(long, value_name = "FILE")]
    key_file: Option<PathBuf>,
    /// Key file with the new key; nobody else may read it [default: it is asked for, twice]
    #[arg(long, value_name = "FILE")]
    new_key_file: Option<PathBuf>,
}

impl Command {
    pub(super) fn run(self) -> Result<ExitCode> {
        let What::Change(change) = self.command;
        print(&change.run()?);
        Ok(ExitCode::SUCCESS)
    }
}

impl Change {
    /// What to print when it is done.
    fn run(&self) -> Result<String> {
        let name = Name::ALL.into_iter().find(|name| name.as_str() == self.key);
        let name = name.expect("clap took only names of keys");
        let path = self.gauge.join("gauge/keys");
        let subject = self.gauge.display().to_string();
        if !path.exists() {
            let why = "not a mounted gauge with keys; give a folder such as /run/gauges/BAT0";
            return Err(Error::host(subject, Errno::ENOENT, why));
        }
        let (old, new) = self.keys(name, &folder_name(&self.gauge))?;
        let (word, [old, new]) = (name.as_str(), [old.text(), new.text()]);
        // Reserved at once: growing would leave copies behind that nobody wipes.
        let mut line = Zeroizing::new(String::with_capacity(LINE));
        for part in [word, " ", &old, " ", &new, "\n"] {
            line.push_str(part);
        }
        // One write(2) is one change.
        let mut file = File::options()
            .write(true)
            .open(&path)
            .map_err(|error| Error::io(path.display().to_string(), "cannot be written", &error))?;
        let written = file.write(line.as_bytes());
        // The daemon reads the next request into the same buffer, over the keys. It is a courtesy: where it
        // fails nothing else does.
        let _ = file.write(" ".repeat(line.len()).as_bytes());
        match written {
            Ok(_) => Ok(format!(
                "The {word} key is changed and was tried. The mount uses it now; before the next mount put the new\n\
                 key into the key file, as the line `{} = ...`.\n",
                name.line()
            )),
            // The daemon's own words, which say more than the errno does.
            Err(error) => match std::fs::read_to_string(self.gauge.join("gauge/last_error")) {
                Ok(why) if !why.trim().is_empty() => Err(Error::host(subject, Errno::EIO, why.trim())),
                _ => Err(Error::io(subject, "the key was not changed", &error)),
            },
        }
    }

    /// The old key and the new one.
    fn keys(&self, name: Name, gauge: &str) -> Result<(Secret, Secret)> {
        // A file that is refused is refused before anybody types.
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
        Error::new(file.display().to_string(), Cause::Invalid(why))
    })
}

/// The terminal, which does not show what is typed while this is there.
struct Terminal {
    file: File,
    before: Termios,
}

impl Terminal {
    fn open() -> Result<Self> {
        let failed = |error: std::io::Error| {
            let what = "there is no terminal to ask for the key; give --key-file and --new-key-file";
            Error::io("/dev/tty", what, &error)
        };
        let mut options = File::options();
        let options = options.read(true).write(true).custom_flags(nix::libc::O_NOCTTY);
        let file = options.open("/dev/tty").map_err(failed)?;
        let before = tcgetattr(&file).map_err(|errno| failed(errno.into()))?;
        let mut silent = before.clone();
        silent.local_flags.remove(LocalFlags::ECHO | LocalFlags::ISIG);
        silent.local_flags.insert(LocalFlags::ICANON | LocalFlags::ECHONL);
        // Ctrl-C would leave the terminal silent. Here it ends a line instead, and the line tells.
        silent.control_chars[SpecialCharacterIndices::VEOL as usize] = INTERRUPT;
        tcsetattr(&file, SetArg::TCSAFLUSH, &silent).map_err(|errno| failed(errno.into()))?;
        Ok(Self { file, before })
    }

    fn ask(&mut self, name: Name, which: &str) -> Result<Secret> {
        let subject = format!("{which} {} key", name.as_str());
        let failed = |error: std::io::Error| Error::io(&subject, "cannot ask for it", &error);
        let refuse = |why: &str| Error::new(&subject, Cause::Invalid(why.into()));
        write!(self.file, "{which} {} key: ", name.as_str()).map_err(failed)?;
        let mut line = Zeroizing::new([0; LINE]);
        // The terminal gives one line at a time.
        let length = self.file.read(&mut *line).map_err(failed)?;
        let line = &line[..length];
        if line.is_empty() || line.contains(&INTERRUPT) {
            return Err(refuse("not given; nothing was changed"));
        }
        let text = std::str::from_utf8(line).map_err(|_| refuse(name.form()))?;
        Secret::parse(name, text.trim()).ok_or_else(|| refuse(name.form()))
    }

    fn ask_twice(&mut self, name: Name) -> Result<Secret> {
        let first = self.ask(name, "new")?;
        if self.ask(name, "once more the new")? == first {
            return Ok(first);
        }
        let why = "two different ones were typed; nothing was changed";
        Err(Error::new(format!("new {} key", name.as_str()), Cause::Invalid(why.into())))
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        // A terminal that is gone needs no echo.
        let _ = tcsetattr(&self.file, SetArg::TCSAFLUSH, &self.before);
    }
}
