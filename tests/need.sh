# Sourced by the test scripts.
#
# need COMMAND PACKAGE...: makes sure that a command is there, from Debian's packages where this runs as
# root. Without it, prints what to type and fails.
need() {
    local command=$1
    shift
    command -v "$command" >/dev/null && return
    local install=(apt-get -o DPkg::Lock::Timeout=300 install -y --no-install-recommends "$@")
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
        printf '\n== installing %s\n' "$*"
        export DEBIAN_FRONTEND=noninteractive
        "${install[@]}" >/dev/null 2>&1 && return
        apt-get -o DPkg::Lock::Timeout=300 update -qq && "${install[@]}" >/dev/null && return
    fi
    echo "SKIPPED in part: $command is missing; to run all tests: sudo apt-get install $*"
    return 1
}
