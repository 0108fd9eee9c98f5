#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: systeminformation's battery().timeRemaining is charge_now by current_now while a pack discharges.
# Happens:  it is null where the current is negative, as the kernel's drivers of fuel gauges show a discharge: the number is
#   parsed with a 0 before it, so -500000 is read as 0. With the same current without its sign there are 72 minutes.
# Version:  systeminformation 5.33.23 from npm, lib/battery.js.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm install --silent --no-fund --no-audit systeminformation@5.33.23
# The library has the kernel's folder as a constant; its reads are led to another one.
cat >redirect.js <<'END'
const fs = require('fs');
const to = (path) => String(path).replace('/sys/class/power_supply', process.env.SUPPLIES);
const { existsSync, readFile, readFileSync } = fs;
fs.existsSync = (path) => existsSync(to(path));
fs.readFile = (path, ...more) => readFile(to(path), ...more);
fs.readFileSync = (path, ...more) => (String(path).startsWith('/sys/class/power_supply') ? readFileSync(to(path), ...more) : readFileSync(path, ...more));
END
export SUPPLIES=$folder/supplies
mkdir -p "$SUPPLIES/BAT0"
remaining() {
    printf '%s\n' POWER_SUPPLY_STATUS=Discharging POWER_SUPPLY_VOLTAGE_NOW=3700000 POWER_SUPPLY_CHARGE_FULL=1000000 \
        POWER_SUPPLY_CHARGE_NOW=600000 POWER_SUPPLY_CAPACITY=60 "POWER_SUPPLY_CURRENT_NOW=$1" >"$SUPPLIES/BAT0/uevent"
    node -r ./redirect.js -e "require('systeminformation').battery().then((b) => console.log(b.timeRemaining))"
}
seen="$(remaining -500000) $(remaining 500000)"
echo "systeminformation 5.33.23, minutes left at -500 mA and at 500 mA: $seen"
[ "$seen" = "null 72" ]
