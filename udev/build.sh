# SPDX-License-Identifier: MIT
#
# Sourced by udev/package and udev/release, at the top of the source: what makes two builds of one source equal.

# The time of everything that has one.
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || stat -c %Y CHANGELOG.md)}
export SOURCE_DATE_EPOCH

# The folders of this machine that the compiler would name in the program, where it says what panicked.
folders="--remap-path-prefix=$PWD=/gaugefs"
for folder in "${CARGO_HOME:-$HOME/.cargo}"/registry/src/*; do
    folders+=" --remap-path-prefix=$folder=/cargo"
done
sysroot=$(rustc --print sysroot)
folders+=" --remap-path-prefix=$sysroot/lib/rustlib/src/rust=/rust"
export RUSTFLAGS="${RUSTFLAGS:+$RUSTFLAGS }$folders"

here=$(rustc -vV | sed -n 's/^host: //p')
made=$(cargo metadata --no-deps --format-version 1 | sed 's/.*"target_directory":"\([^"]*\)".*/\1/')

# dist TARGET: builds the program for a target of Rust.
# On x86-64 the tables that unwind a panic are a third smaller with frame pointers, and the program by 3 %.
dist() {
    local pointers=
    [[ $1 != x86_64-* ]] || pointers=' -Cforce-frame-pointers=yes'
    RUSTFLAGS="$RUSTFLAGS$pointers" cargo build --profile dist --quiet --locked --bin gaugefs --target "$1"
    nameless "$made/$1/dist/gaugefs" || { echo "$1: the program names folders of this machine" >&2; return 1; }
}

# nameless PROGRAM: no path of this machine is in it.
nameless() { ! grep -aoF -e "$PWD/" -e "${CARGO_HOME:-$HOME/.cargo}/" -e "$sysroot/" "$1" | sort | uniq -c >&2; }

# documents PROGRAM FOLDER: writes the manual pages and the completions that a program of this machine prints.
documents() {
    "$1" man >"$2/gaugefs.1"
    "$1" man gaugefs.toml >"$2/gaugefs.toml.5"
    "$1" completions bash >"$2/gaugefs.bash"
    "$1" completions zsh >"$2/_gaugefs"
    "$1" completions fish >"$2/gaugefs.fish"
}
