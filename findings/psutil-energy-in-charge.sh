#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: psutil.sensors_battery().percent is between 0 and 100, and near `capacity`.
# Happens:  a supply with energy_now (uWh), charge_now and charge_full (uAh) and no energy_full, which is what the kernel's
#   bq27xxx_battery shows of a bq27000 (bq27000_props in drivers/power/supply/bq27xxx_battery.c), has energy in percent of
#   charge: 222 for a gauge with 60. Numerator and denominator are each the first file that exists, of either unit.
# Version:  psutil 7.2.2 from PyPI, psutil/_pslinux.py, sensors_battery().
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q --disable-pip-version-check psutil==7.2.2
supply=$folder/supplies/BAT0
mkdir -p "$supply"
for file in type=Battery present=1 status=Discharging capacity=60 energy_now=2220000 charge_now=600000 \
    charge_full=1000000 current_now=-500000; do
    echo "${file#*=}" >"$supply/${file%%=*}"
done
seen=$("$folder/venv/bin/python" - "$folder/supplies" <<'END'
import sys
import psutil
psutil._pslinux.POWER_SUPPLY_PATH = sys.argv[1]
battery = psutil.sensors_battery()
print(psutil.__version__, battery.percent, battery.secsleft)
END
)
echo "psutil, percent of a gauge with 60, and seconds of energy by current: $seen"
[ "$seen" = "7.2.2 222.0 15984" ]
