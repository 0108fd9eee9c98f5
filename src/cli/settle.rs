//! `gaugefs settle`: shows an interrupted write, and carries out what somebody decides about it.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;

use crate::error::Result;
use crate::mounted;
use crate::output::print;

const SETTLE: &str = "\
A write that was interrupted is settled by itself where the gauge is certainly the one it was begun on.
Where it is not, nothing is touched and every further write is refused until you decide. Without an
option this command shows what is known: each parameter with its old value, its new one, and what the
gauge has now. A change of keys that was interrupted is finished or undone with its two keys, which no
journal has: this command shows which keys the gauge has, and what to type. What is written is what was shown: if the
gauge has changed since, nothing is. On a pack that is not the one the write was begun on, --undo and --finish ask for
its serial number. Exit code 0: nothing to settle, or settled; 1: a decision is needed, or it failed.

Examples:
  gaugefs settle /run/gauges/BAT0             what is there to settle
  gaugefs settle /run/gauges/BAT0 --undo      write the old values";

/// Show an interrupted write, and undo, finish or discard it
#[derive(Args, Debug)]
#[command(after_help = SETTLE)]
pub(super) struct Settle {
    /// Folder of a mounted gauge, such as /run/gauges/BAT0
    gauge: PathBuf,
    /// Write the old values, verify them and reset the gauge
    #[arg(long, group = "writes", conflicts_with = "discard")]
    undo: bool,
    /// Write the new values, verify them and reset the gauge
    #[arg(long, group = "writes", conflicts_with = "discard")]
    finish: bool,
    /// Leave data flash as it is; the journal is kept under another name
    #[arg(long)]
    discard: bool,
    /// The serial number of the pack, if it is another one than the write was begun on
    #[arg(long, value_name = "NUMBER", requires = "writes")]
    serial: Option<String>,
}

impl Settle {
    pub(super) fn run(mut self) -> Result<ExitCode> {
        self.gauge = mounted::gauge(&self.gauge)?;
        let word = match (self.undo, self.finish, self.discard) {
            (true, _, _) => "undo",
            (_, true, _) => "finish",
            (_, _, true) => "discard",
            _ => "show",
        };
        // A journal can be discarded without its gauge.
        if !self.discard {
            mounted::poll(&self.gauge)?;
        }
        let words = self.serial.map_or(word.to_string(), |serial| format!("{word} {serial}"));
        let told = exchange(&self.gauge, &words)?;
        // What was decided is done, whether it can be printed or not.
        print(&format!("{}\n", told.trim_end())).map_err(|error| match word {
            "show" => error,
            _ => error.within(told.trim_end()),
        })?;
        let is_pending = word == "show" && told.trim() != "nothing to settle";
        Ok(if is_pending { ExitCode::FAILURE } else { ExitCode::SUCCESS })
    }
}

/// Writes a word to `gauge/settle` and reads the answer.
fn exchange(gauge: &Path, word: &str) -> Result<String> {
    const FILE: &str = "gauge/settle";
    mounted::has(gauge, FILE, "data flash")?;
    mounted::send(gauge, FILE, word.as_bytes()).map_err(|failure| failure.told("cannot be settled"))?;
    let told = mounted::text(gauge, FILE);
    let told = told.map_err(|failure| failure.told("cannot read what is to settle"))?;
    Ok(mounted::with_gauge(&told, gauge))
}
