// SPDX-License-Identifier: MIT

//! The command line of `gaugefs-station`: a production line, which mounts nothing.

use std::ffi::OsString;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};
use clap_complete::Shell;

use crate::command::{self, completions, manual};
use crate::error::Result;
use crate::output::{self, print_file};

mod file;
mod options;
mod program;
mod records;

const PAGE: &str = include_str!("../docs/gaugefs-station.1.in");

const EXAMPLES: &str = "\
Examples:
  gaugefs-station program --image golden.gm.fs --station line1.toml --check
  gaugefs-station program --image golden.gm.fs --station line1.toml
  gaugefs-station records line1.jsonl

docs/PRODUCTION.md explains the file of a station, and how to rehearse one without hardware.";

/// Programs TI battery fuel gauges on a production line, one pack after the other
#[derive(Debug, Parser)]
#[command(
    name = "gaugefs-station",
    version,
    after_help = EXAMPLES,
    max_term_width = 100,
    arg_required_else_help = true
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Program(program::Program),
    Records(records::Show),
    Completions(Completions),
    Man(Man),
}

const COMPLETIONS: &str = "\
The Debian package installs the completions for bash, zsh and fish.

Examples:
  mkdir -p ~/.local/share/bash-completion/completions
  cd ~/.local/share/bash-completion/completions
  gaugefs-station completions bash > gaugefs-station";

/// Generate shell completions
#[derive(Args, Debug)]
#[command(after_help = COMPLETIONS)]
struct Completions {
    /// Shell to generate them for
    shell: Shell,
}

const MAN: &str = "\
Examples:
  gaugefs-station man | man -l -";

/// Print the manual page
#[derive(Args, Debug)]
#[command(after_help = MAN)]
struct Man {}

impl Command {
    fn run(self) -> Result<ExitCode> {
        match self {
            Self::Program(command) => return command.run(),
            Self::Records(command) => return command.run(),
            Self::Completions(Completions { shell }) => {
                print_file(completions::script(shell, &command::whole::<Cli>()).as_bytes())?;
            }
            Self::Man(Man {}) => print_file(manual::page(PAGE, command::whole::<Cli>()).as_bytes())?,
        }
        Ok(ExitCode::SUCCESS)
    }
}

const GROUPS: [(&str, &[&str]); 2] =
    [("Line", &["program", "records"]), ("Service", &["completions", "man"])];

/// The definition of the command line, whose prose takes the width of the terminal.
pub fn definition() -> clap::Command {
    command::definition::<Cli>(&GROUPS)
}

/// Runs the command that the arguments name. The exit code is 0 for done, 1 for failed, 2 for misuse.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    output::speak_as("gaugefs-station");
    command::run(&GROUPS, arguments, |cli: Cli| cli.command.run())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clap_accepts_the_definition() {
        definition().debug_assert();
    }
}
