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

# The programs of the package.
programs=(gaugefs gaugefs-station)

# dist TARGET: builds the programs for a target of Rust.
# On x86-64 the tables that unwind a panic are a third smaller with frame pointers, and the program by 3 %.
dist() {
    local pointers=
    [[ $1 != x86_64-* ]] || pointers=' -Cforce-frame-pointers=yes'
    RUSTFLAGS="$RUSTFLAGS$pointers" cargo build --profile dist --quiet --locked "${programs[@]/#/--bin=}" --target "$1"
    local program
    for program in "${programs[@]}"; do
        nameless "$made/$1/dist/$program" || { echo "$1: $program names folders of this machine" >&2; return 1; }
    done
}

# nameless PROGRAM: no path of this machine is in it.
nameless() { ! grep -aoF -e "$PWD/" -e "${CARGO_HOME:-$HOME/.cargo}/" -e "$sysroot/" "$1" | sort | uniq -c >&2; }

# documents FOLDER TO: writes the manual pages and the completions that the programs of this machine print, which are in FOLDER.
documents() {
    local program
    for program in "${programs[@]}"; do
        "$1/$program" man >"$2/$program.1"
        "$1/$program" completions bash >"$2/$program.bash"
        "$1/$program" completions zsh >"$2/_$program"
        "$1/$program" completions fish >"$2/$program.fish"
    done
    "$1/gaugefs" man gaugefs.toml >"$2/gaugefs.toml.5"
}
