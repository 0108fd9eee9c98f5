// SPDX-License-Identifier: MIT

//! The `gaugefs-station` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    gaugefs::station::run(std::env::args_os())
}
