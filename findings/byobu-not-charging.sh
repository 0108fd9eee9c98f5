#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: byobu's battery status shows each status of the kernel's ABI: Charging, Discharging, Full and Not charging.
# Happens:  Not charging is not seen: the status has two words, and of lines NAME=VALUE without quotes the script keeps the first
#   word only. What it shows then is as without a status.
# Version:  byobu 5.133-1.1 of Debian 12, /usr/lib/byobu/battery, __battery(); its newest source has the same line. It reads a folder
#   of plain files in place of /sys/class/power_supply, in a mount namespace.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
curl -fsSL http://deb.debian.org/debian/pool/main/b/byobu/byobu_5.133-1.1_all.deb -o "$folder/package.deb"
dpkg-deb -x "$folder/package.deb" "$folder/root"
# As byobu-status does it, with its colours left out.
seen() {
    mkdir -p "$folder/supplies/BAT0"
    cat >"$folder/supplies/BAT0/uevent" <<END
POWER_SUPPLY_NAME=BAT0
POWER_SUPPLY_TYPE=Battery
POWER_SUPPLY_STATUS=$1
POWER_SUPPLY_PRESENT=1
POWER_SUPPLY_CHARGE_FULL=3000000
POWER_SUPPLY_CHARGE_NOW=2100000
END
    unshare -rm sh -c '
        mount --bind "$1/supplies" /sys/class/power_supply
        BATTERY= BYOBU_TEST="command -v" BYOBU_SED=sed PCT=% POWER_SUPPLY_CAPACITY=
        color() { :; }
        . "$1/root/usr/lib/byobu/battery"
        __battery' sh "$folder" 2>"$folder/errors" || :
}
for status in Charging Discharging 'Not charging'; do
    echo "byobu 5.133 of $status: $(seen "$status"); $(cut -d: -f4- "$folder/errors")"
done | tee "$folder/told"
grep -q 'of Charging: .*; $' "$folder/told" && grep -q 'of Not charging: .*not found' "$folder/told"
