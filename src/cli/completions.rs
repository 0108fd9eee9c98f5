//! `gaugefs completions`.

use std::process::ExitCode;

use clap::{Args, CommandFactory};
use clap_complete::Shell;

use super::{Cli, print};
use crate::error::Result;

const COMPLETIONS: &str = "\
The Debian package installs the completions for bash, zsh and fish.

Example:
  gaugefs completions bash > ~/.local/share/bash-completion/completions/gaugefs";

/// Generate shell completions
#[derive(Args, Debug)]
#[command(after_help = COMPLETIONS)]
pub(super) struct Completions {
    /// Shell to generate them for
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
