#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: batterylog's line_power_name and line_power_online tell of the supply that feeds the laptop.
# Happens:  the first supply in the order of the alphabet that has a file online and no name of BAT is taken, without a look at
#   type. The kernel gives the battery of a wireless mouse that file (hidpp_battery_0, scope Device), and its name comes
#   before those of USB-C ports: a discharging laptop has "line power hidpp_battery_0 online".
# Version:  batterylog 0.2.2 from PyPI, batterylog/power.py, find_first_line_power_dir().
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q --disable-pip-version-check batterylog==0.2.2
supply() {
    mkdir -p "$folder/supplies/$1"
    for file in "${@:2}"; do
        echo "${file#*=}" >"$folder/supplies/$1/${file%%=*}"
    done
}
supply BAT0 type=Battery status=Discharging cycle_count=12 charge_now=600000 charge_full=1000000 current_now=-500000 \
    voltage_now=3700000 voltage_min_design=3000000
supply hidpp_battery_0 type=Battery scope=Device online=1 capacity=80 status=Discharging
supply ucsi-source-psy-USBC000:001 type=USB online=0
# The library has the kernel's folder as a constant; its paths are led to another one.
seen=$("$folder/venv/bin/python" - "$folder/supplies" <<'END'
import pathlib, sys
from batterylog import power
power.Path = lambda path: pathlib.Path(str(path).replace('/sys/class/power_supply', sys.argv[1]))
snapshot = power.read_battery_snapshot()
print(snapshot.battery_status, snapshot.line_power_name, snapshot.line_power_online)
END
)
echo "batterylog 0.2.2, status of the battery, name of the line power and whether it is online: $seen"
[ "$seen" = "Discharging hidpp_battery_0 1" ]
