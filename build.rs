// SPDX-License-Identifier: MIT

//! Packs the relocations of the program as it is packaged: they would be a twentieth of it. The C library has to know that
//! form, which glibc has done since 2.36, and GNU ld for x86-64 since 2.38.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let is = |name: &str, value: &str| std::env::var(name).is_ok_and(|found| found == value);
    if is("OPT_LEVEL", "z") && is("CARGO_CFG_TARGET_ENV", "gnu") && is("CARGO_CFG_TARGET_ARCH", "x86_64") {
        println!("cargo::rustc-link-arg-bins=-Wl,-z,pack-relative-relocs");
    }
}
