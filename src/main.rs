//! The `gaugefs` command.

fn main() {}
