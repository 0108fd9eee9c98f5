# SPDX-License-Identifier: MIT
#
# Sourced by the test scripts.
#
# need COMMAND PACKAGE...: makes sure that a command is there, from Debian's packages where this runs as
# root. Without it, prints what to type and fails.
need() { need_that "$1" "command -v $1" "${@:2}"; }

# need_that WHAT TRIAL PACKAGE...: makes sure that a trial succeeds. A compiler may be there without the C library that
# it links with.
need_that() {
    local what=$1 trial=$2 tests=${BASH_SOURCE[0]%/*}
    shift 2
    $trial >/dev/null 2>&1 && return
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        printf '\n== installing %s\n' "$*"
        "$tests/apt" install -y --no-install-recommends "$@" >/dev/null ||
            { "$tests/apt" update && "$tests/apt" install -y --no-install-recommends "$@" >/dev/null; } || :
        $trial >/dev/null 2>&1 && return
    fi
    echo "SKIPPED in part: $what is missing; to have it: sudo apt-get install $*"
    return 1
}

# once FOLDER COMMAND...: has the command make a folder, whose name it gets as its last argument, unless it is there
# already. A second process waits for the first.
once() {
    local folder=$1
    shift
    mkdir -p "$(dirname "$folder")"
    (
        flock 9
        [ ! -d "$folder" ] || exit 0
        rm -rf "$folder.new"
        "$@" "$folder.new" 9>&- && mv "$folder.new" "$folder"
    ) 9>"$folder.lock"
}

# The release of this machine's Debian.
release() { (. /etc/os-release && echo "${VERSION_CODENAME:-stable}"); }

# packaged VERSION FILE: builds the Debian package of that version, and copies it. The steps that need it may run at once, and
# udev/package keeps one version at a time.
packaged() (
    flock 9
    path=$(udev/package "$1" 9>&- | tail -n 1) && cp "$path" "$2"
) 9>"$target/packaged.lock"

# debian FOLDER PACKAGE,...: a small Debian of that release with these packages. It is kept.
debian() { once "$1" make_debian "$2"; }
make_debian() {
    debootstrap --variant=minbase --include="$1" "$(release)" "$2" >"$2.log" 2>&1 || { tail -n 3 "$2.log"; return 1; }
}

# cargo_deb TARGET: makes sure that cargo-deb is there, built below the target folder. It is kept.
cargo_deb() {
    ! command -v cargo-deb >/dev/null || return 0
    once "$1/cargo-deb" make_cargo_deb
    export PATH=$PATH:$1/cargo-deb/bin
}
make_cargo_deb() {
    cargo install --quiet --locked --debug --config profile.dev.debug=0 --root "$1" --target-dir "$1/build" cargo-deb &&
        rm -r "$1/build"
}
