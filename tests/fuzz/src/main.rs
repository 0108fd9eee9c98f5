// SPDX-License-Identifier: MIT

//! The target that `GAUGEFS_FUZZ` names, under libFuzzer. `tests/fuzz/run` builds and runs it.
#![no_main]

use std::sync::LazyLock;

use gaugefs_fuzz::{TARGETS, Target};
use libfuzzer_sys::fuzz_target;

static TARGET: LazyLock<&Target> = LazyLock::new(|| {
    let name = std::env::var("GAUGEFS_FUZZ").unwrap_or_default();
    let target = TARGETS.iter().find(|target| target.name == name);
    target.unwrap_or_else(|| panic!("GAUGEFS_FUZZ={name} is not the name of a target"))
});

fuzz_target!(|input: &[u8]| (TARGET.run)(input));
