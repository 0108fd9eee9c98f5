#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: systeminformation's battery().maxCapacity is a property of the pack, like charge_full.
# Happens:  it is charge_full times the voltage of this moment: a pack that has 4200 mWh when it is full has 3000 mWh when it
#   is nearly empty, with the same charge_full. Divided by designedCapacity, which is computed with voltage_min_design, a new
#   pack's health falls from 140 % to 100 % with each discharge.
# Version:  systeminformation 5.33.23 from npm, lib/battery.js; supplies that show charge.
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
capacities() {
    printf '%s\n' POWER_SUPPLY_STATUS=Discharging "POWER_SUPPLY_VOLTAGE_NOW=$1" POWER_SUPPLY_VOLTAGE_MIN_DESIGN=3000000 \
        POWER_SUPPLY_CHARGE_FULL_DESIGN=1000000 POWER_SUPPLY_CHARGE_FULL=1000000 POWER_SUPPLY_CHARGE_NOW=500000 \
        >"$SUPPLIES/BAT0/uevent"
    node -r ./redirect.js -e "require('systeminformation').battery().then((b) => console.log(b.maxCapacity, b.designedCapacity))"
}
seen="$(capacities 4200000), $(capacities 3000000)"
echo "systeminformation 5.33.23, full and design capacity at 4.2 V and at 3.0 V: $seen"
[ "$seen" = "4200 3000, 3000 3000" ]
