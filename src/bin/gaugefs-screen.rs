//! What `gaugefs` hands `top`, `log` and `plot` over to.

use std::process::ExitCode;

fn main() -> ExitCode {
    gaugefs::cli::run(std::env::args_os().collect(), |screen, _| screen.run())
}
