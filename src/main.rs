//! The `gaugefs` command.

use std::process::ExitCode;

mod heap;

#[global_allocator]
static HEAP: heap::Heap = heap::Heap;

fn main() -> ExitCode {
    gaugefs::cli::run(std::env::args_os())
}
