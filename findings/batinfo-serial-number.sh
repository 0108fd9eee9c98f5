#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: batinfo gives serial_number and model_name as the texts that the files are.
# Happens:  what int() takes becomes a number: serial number 0042 is 42, and 1_0 is 10. Of two packs, whether the type
#   is str or int depends on their serial numbers; the kernel's drivers show four hexadecimal digits, of which some
#   have no letter.
# Version:  batinfo 0.4.2 from PyPI, batinfo/battery.py, Battery.__update__().
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q --disable-pip-version-check setuptools wheel
"$folder/venv/bin/pip" install -q --disable-pip-version-check --no-build-isolation batinfo==0.4.2
for supply in BAT0=0042 BAT1=004a; do
    mkdir -p "$folder/supplies/${supply%%=*}"
    echo Battery >"$folder/supplies/${supply%%=*}/type"
    echo "${supply#*=}" >"$folder/supplies/${supply%%=*}/serial_number"
done
seen=$("$folder/venv/bin/python" - "$folder/supplies" <<'END'
import sys
from batinfo.battery import Batteries
print(*(repr(battery.serial_number) for battery in sorted(Batteries(sys.argv[1]), key=lambda battery: battery.name)))
END
)
echo "batinfo 0.4.2, serial numbers 0042 and 004a: $seen"
[ "$seen" = "42 '004a'" ]
