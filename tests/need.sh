# Sourced by the test scripts.
#
# need COMMAND PACKAGE...: makes sure that a command is there, from Debian's packages where this runs as
# root. Without it, prints what to type and fails.
need() {
    local command=$1 tests=${BASH_SOURCE[0]%/*}
    shift
    command -v "$command" >/dev/null && return
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        printf '\n== installing %s\n' "$*"
        "$tests/apt" install -y --no-install-recommends "$@" >/dev/null && return
        "$tests/apt" update && "$tests/apt" install -y --no-install-recommends "$@" >/dev/null && return
    fi
    echo "SKIPPED in part: $command is missing; to run all tests: sudo apt-get install $*"
    return 1
}
