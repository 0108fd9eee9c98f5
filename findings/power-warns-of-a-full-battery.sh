#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: get_low_battery_warning_level() of the PyPI package power warns when at most 22 % are left.
# Happens:  it warns of a full battery, and no longer at 4 %: what is compared with 22 is the full energy divided by the present one, 1.0
#   of a full battery and 25.0 at 4 %.
# Version:  power 1.4 from PyPI, power/linux.py, get_low_battery_warning_level(). It reads a folder of plain files, whose path is a constant
#   of its module.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q --disable-pip-version-check power==1.4
cat >"$folder/seen.py" <<'END'
import pathlib
import sys
import warnings

warnings.simplefilter("ignore")
from power import common, linux

supplies = pathlib.Path(sys.argv[1])
battery = supplies / "BAT0"
battery.mkdir(parents=True)
linux.POWER_SUPPLY_PATH = str(supplies)
names = {common.LOW_BATTERY_WARNING_NONE: "none", common.LOW_BATTERY_WARNING_EARLY: "early", common.LOW_BATTERY_WARNING_FINAL: "final"}
for percent in (100, 50, 20, 4):
    values = {"type": "Battery", "present": 1, "status": "Discharging", "energy_full": 50_000_000,
              "energy_now": 500_000 * percent, "power_now": 5_000_000}
    for name, value in values.items():
        (battery / name).write_text(f"{value}\n")
    print(f"{percent} % {names[linux.PowerManagement().get_low_battery_warning_level()]}", end=" ")
END
seen=$("$folder/venv/bin/python" "$folder/seen.py" "$folder/supplies")
echo "power 1.4, warnings of a battery that discharges: $seen"
[ "$seen" = "100 % early 50 % early 20 % early 4 % none " ]
