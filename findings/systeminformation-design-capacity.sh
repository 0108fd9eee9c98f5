#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: systeminformation's battery().designedCapacity is energy_full_design.
# Happens:  it is energy_full_design OR energy_full, bit by bit: `|` stands where `||` is meant. A pack of 50000 mWh by design
#   that takes 41000 mWh has a design capacity of 58232 mWh, so its health is computed too low.
# Version:  systeminformation 5.33.23 from npm, lib/battery.js; supplies that show energy instead of charge.
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
printf '%s\n' POWER_SUPPLY_STATUS=Discharging POWER_SUPPLY_VOLTAGE_NOW=11100000 POWER_SUPPLY_ENERGY_FULL_DESIGN=50000000 \
    POWER_SUPPLY_ENERGY_FULL=41000000 POWER_SUPPLY_ENERGY_NOW=20500000 POWER_SUPPLY_CAPACITY=50 >"$SUPPLIES/BAT0/uevent"
seen=$(node -r ./redirect.js -e "require('systeminformation').battery().then((b) => console.log(b.designedCapacity, b.maxCapacity))")
echo "systeminformation 5.33.23, design capacity of 50000 mWh and full capacity of 41000 mWh: $seen"
[ "$seen" = "58232 41000" ]
