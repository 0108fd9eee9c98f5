// SPDX-License-Identifier: MIT

//! `gaugefs settle`: shows an interrupted write, and carries out a decision about it.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;

use super::mounted;
use crate::error::Result;
use crate::output::print;
use gaugefs_client::{Decision, Gauge};

const SETTLE: &str = "\
A write that was interrupted is settled by itself where the gauge is certainly the one it was begun on.
Where it is not, nothing is touched and every further write is refused until you decide. Without an
option this command shows what is known: each parameter with its old value, its new one, and what the
gauge has now. A change of keys that was interrupted is finished or undone with its two keys, which no
journal has: this command shows which keys the gauge has, and what to type. What is written is what was shown: if the
gauge has changed since, nothing is. On a pack that is not the one the write was begun on, --undo and --finish ask for
its serial number. Exit code 0: nothing to settle, or settled; 1: a decision is needed, it failed, or there was
nothing to decide.

Examples:
  gaugefs settle /run/gauges/BAT0             what is there to settle
  gaugefs settle /run/gauges/BAT0 --undo      write the old values";

/// Show an interrupted write, and undo, finish or discard it
#[derive(Args, Debug)]
#[command(after_help = SETTLE)]
pub(super) struct Settle {
    /// Folder of a mounted gauge, such as /run/gauges/BAT0
    gauge: PathBuf,
    /// Write the old values, verify them and seal the gauge as it was
    #[arg(long, group = "writes", conflicts_with = "discard")]
    undo: bool,
    /// Write the new values, verify them and seal the gauge as it was
    #[arg(long, group = "writes", conflicts_with = "discard")]
    finish: bool,
    /// Leave data flash as it is; the journal is kept under another name. Without an interrupted write, this puts aside the
    /// journals that wait for another pack
    #[arg(long)]
    discard: bool,
    /// The serial number of the pack, if it is another one than the write was begun on
    #[arg(long, value_name = "NUMBER", requires = "writes")]
    serial: Option<String>,
}

impl Settle {
    pub(super) fn run(self) -> Result<ExitCode> {
        let gauge = Gauge::open(&self.gauge)?;
        let decision = match (self.undo, self.finish, self.discard) {
            (true, _, _) => Some(Decision::Undo),
            (_, true, _) => Some(Decision::Finish),
            (_, _, true) => Some(Decision::Discard),
            _ => None,
        };
        // Discarding a journal does not need its gauge.
        if !self.discard {
            mounted::poll(&gauge)?;
        }
        let Some(decision) = decision else {
            let (told, owed) = gauge.examine()?;
            print(&format!("{}\n", told.trim_end()))?;
            return Ok(if owed { ExitCode::FAILURE } else { ExitCode::SUCCESS });
        };
        let told = gauge.settle(decision, self.serial.as_deref())?;
        // The decision is done, printed or not.
        print(&format!("{}\n", told.trim_end())).map_err(|error| error.within(told.trim_end()))?;
        Ok(ExitCode::SUCCESS)
    }
}
