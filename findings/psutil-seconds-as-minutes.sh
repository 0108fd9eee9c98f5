#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: psutil.sensors_battery().secsleft is time_to_empty_now where a supply has neither charge nor energy, because
#   the kernel's ABI gives that file in seconds (Documentation/ABI/testing/sysfs-class-power, time_to_empty_now).
# Happens:  it is 60 times as long: psutil takes the file for minutes. A gauge with one hour left has 60 hours.
# Version:  psutil 7.2.2 from PyPI, psutil/_pslinux.py, sensors_battery(). Its folder of supplies is a variable.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q --disable-pip-version-check psutil==7.2.2
supply=$folder/supplies/BAT0
mkdir -p "$supply"
for file in type=Battery present=1 status=Discharging capacity=50 time_to_empty_now=3600; do
    echo "${file#*=}" >"$supply/${file%%=*}"
done
seen=$("$folder/venv/bin/python" - "$folder/supplies" <<'END'
import sys
import psutil
psutil._pslinux.POWER_SUPPLY_PATH = sys.argv[1]
print(psutil.__version__, psutil.sensors_battery().secsleft)
END
)
echo "psutil, seconds left of 3600: $seen"
[ "$seen" = "7.2.2 216000" ]
