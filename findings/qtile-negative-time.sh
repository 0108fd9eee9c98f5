#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: qtile's widget Battery shows the hours and minutes that are left, 1:12 for 600 mAh at 500 mA.
# Happens:  a negative current_now, which is what the kernel's drivers of fuel gauges show of a discharge, makes a negative
#   number of seconds, and hours and minutes are each rounded down: -2:48, which is not even 1:12 with another sign. With the
#   same current without its sign it is 1:12.
# Version:  qtile 0.33.0 from PyPI, libqtile/widget/battery.py, update_status() and build_string(). Its folder of supplies is a
#   variable. The library needs libcairo of the system.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q --disable-pip-version-check qtile==0.33.0
supply=$folder/supplies/BAT0
mkdir -p "$supply"
for file in type=Battery status=Discharging capacity=60 charge_full=1000000 charge_now=600000 voltage_now=3700000; do
    echo "${file#*=}" >"$supply/${file%%=*}"
done
cat >"$folder/shown.py" <<'END'
import sys
from libqtile.widget import battery
battery._LinuxBattery.BAT_DIR = sys.argv[1]
widget = battery.Battery()
widget.layout = None
print(widget.poll(), end=', ')
END
seen=
for current in -500000 500000; do
    echo "$current" >"$supply/current_now"
    seen+=$("$folder/venv/bin/python" "$folder/shown.py" "$folder/supplies")
done
echo "qtile 0.33.0, at -500 mA and at 500 mA: $seen"
[ "$seen" = "V 60% -2:48 -1.85 W, V 60% 1:12 1.85 W, " ]
