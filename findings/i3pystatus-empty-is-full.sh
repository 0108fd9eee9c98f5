#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: i3pystatus shows DIS for a battery whose status is Discharging, and its alert and critical_level_command come at
#   their percentages.
# Happens:  a power below 0.1 W is "Full", and a negative current_now, which is what the kernel's drivers of fuel gauges show of
#   a discharge, makes a negative power. A pack with 4 % that gives 500 mA is FULL, and neither the alert nor the command that
#   shuts down comes. With the same current without its sign it is DIS, and urgent.
# Version:  i3pystatus 3.35 from PyPI, i3pystatus/battery.py, Battery.status() and consumption(). The file uevent is an option.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q --disable-pip-version-check i3pystatus==3.35
cat >"$folder/shown.py" <<'END'
import sys
from i3pystatus.battery import BatteryChecker
checker = BatteryChecker(path=sys.argv[1], format='{status} {percentage:.0f} %')
checker.init()
checker.run()
print(checker.output['full_text'], checker.output['urgent'], end=', ')
END
seen=
for current in -500000 500000; do
    printf 'POWER_SUPPLY_%s\n' NAME=BAT0 STATUS=Discharging VOLTAGE_NOW=3300000 "CURRENT_NOW=$current" CHARGE_FULL_DESIGN=1000000 \
        CHARGE_FULL=1000000 CHARGE_NOW=40000 >"$folder/uevent"
    seen+=$("$folder/venv/bin/python" "$folder/shown.py" "$folder/uevent")
done
echo "i3pystatus 3.35, status and urgent of a nearly empty pack at -500 mA and at 500 mA: $seen"
[ "$seen" = "FULL 4 % False, DIS 4 % True, " ]
