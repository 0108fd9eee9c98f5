// SPDX-License-Identifier: MIT

//! The `gaugefs` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    gaugefs::cli::run(std::env::args_os())
}
