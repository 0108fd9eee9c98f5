#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: laptop_battery_status.battery_present() is True if a battery is installed, otherwise False, as its document
#   says; the kernel tells that with the file present.
# Happens:  present is never read: any supply of the type Battery counts. The kernel's sbs-battery keeps its supply while the
#   pack is out, with present 0 and no other value; that bay is an installed battery, its level None instead of NoBatteryError.
# Version:  laptop_battery_status 0.2.0 from PyPI, laptop_battery_status/_linux.py. Its folder of supplies is a variable.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q --disable-pip-version-check laptop_battery_status==0.2.0
mkdir -p "$folder/supplies/sbs-7-000b" "$folder/supplies/AC"
echo Battery >"$folder/supplies/sbs-7-000b/type"
echo 0 >"$folder/supplies/sbs-7-000b/present"
echo Mains >"$folder/supplies/AC/type"
echo 1 >"$folder/supplies/AC/online"
seen=$("$folder/venv/bin/python" - "$folder/supplies" <<'END'
import sys
import laptop_battery_status as status
from laptop_battery_status import _linux
_linux.POWER_SUPPLY_DIR = sys.argv[1]
print(status.__version__, status.battery_present(), status.battery_level(), status.is_charging())
END
)
echo "laptop_battery_status, battery present, level and charging of an empty bay: $seen"
[ "$seen" = "0.2.0 True None False" ]
