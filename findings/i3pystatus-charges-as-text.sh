#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: i3pystatus's {percentage} is charge_now in percent of charge_full, relative to the last full value as its document
#   says.
# Happens:  a charge_now above charge_full leads to the design's capacity instead, and the two are compared as texts: 900000 is
#   above 1000000. So a pack whose full charge has one digit more than what is left jumps from 100 to 66 % when it falls from
#   1000000 to 999000 uAh, and 900000 is 60 % instead of 90, if it was designed for 1500000.
# Version:  i3pystatus 3.35 from PyPI, i3pystatus/battery.py, BatteryCharge. The file uevent is an option.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q --disable-pip-version-check i3pystatus==3.35
cat >"$folder/shown.py" <<'END'
import sys
from i3pystatus.battery import BatteryChecker
checker = BatteryChecker(path=sys.argv[1], format='{percentage:.1f}')
checker.init()
checker.run()
print(checker.output['full_text'], end=' ')
END
seen=
for charge in 1000000 999000 900000; do
    printf 'POWER_SUPPLY_%s\n' NAME=BAT0 STATUS=Discharging VOLTAGE_NOW=3700000 CURRENT_NOW=500000 CHARGE_FULL_DESIGN=1500000 \
        CHARGE_FULL=1000000 "CHARGE_NOW=$charge" >"$folder/uevent"
    seen+=$("$folder/venv/bin/python" "$folder/shown.py" "$folder/uevent")
done
echo "i3pystatus 3.35, percentage of 1000000, 999000 and 900000 uAh of 1000000: $seen"
[ "$seen" = "100.0 66.6 60.0 " ]
