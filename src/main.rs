//! The `gaugefs` command. What draws is in a program of its own, `gaugefs-screen`: the daemon stays in
//! memory, and has none of it there.

use std::process::ExitCode;

fn main() -> ExitCode {
    gaugefs::cli::run(std::env::args_os().collect(), |_, arguments| gaugefs::cli::hand_over(arguments))
}
