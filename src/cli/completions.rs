//! `gaugefs completions`.

use std::process::ExitCode;

use clap::{Args, CommandFactory};
use clap_complete::Shell;

use super::{Cli, print};
use crate::error::Result;

const COMPLETIONS: &str = "\
The Debian package installs those of bash, zsh and fish.

Example:
  gaugefs completions bash > ~/.local/share/bash-completion/completions/gaugefs";

/// Print what makes a shell complete gaugefs's command line
#[derive(Args, Debug)]
#[command(after_help = COMPLETIONS)]
pub(super) struct Completions {
    /// The shell
    shell: Shell,
}

impl Completions {
    pub(super) fn run(self) -> Result<ExitCode> {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut Cli::command(), "gaugefs", &mut script);
        print(&String::from_utf8_lossy(&script));
        Ok(ExitCode::SUCCESS)
    }
}
