#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: surface_temperature_celsius of battfeed's AndroidBatterySource is the file temp by ten: its document says that
#   temp has tenths of a degree Celsius, as the kernel's ABI does.
# Happens:  at 10.0 degrees and below the number is taken as it is: a battery of 9.5 degrees is reported with 95, one of
#   -2.0 with -20. A phone that cools from 10.1 to 9.9 degrees jumps from 10.1 to 99.
# Version:  battfeed 0.5.0 from PyPI, battfeed/sources/android/parser.py, normalize_temperature_c(). adb is an object that
#   its user may pass, so no phone is needed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q --disable-pip-version-check battfeed==0.5.0
seen=$("$folder/venv/bin/python" - <<'END'
from battfeed.sources.android import AndroidBatterySource
from battfeed.sources.android.adb import AdbDevice

class Phone:
    def __init__(self, temp):
        self.files = {'temp': temp, 'voltage_now': '3700000', 'status': 'Discharging'}
    def list_devices(self):
        return [AdbDevice('phone')]
    def shell(self, device, args, timeout=None):
        if args[0] == 'cat':
            return self.files[args[1].rsplit('/', 1)[1]] + '\n'
        return '\n'.join(self.files) if args[0] == 'ls' else 'Current Battery Service state:\n'

for temp in ('250', '101', '99', '95', '-20'):
    (sample,) = AndroidBatterySource(backend=Phone(temp)).poll()
    print(sample['surface_temperature_celsius'], end=' ')
END
)
echo "battfeed 0.5.0, degrees of temp 250, 101, 99, 95 and -20: $seen"
[ "$seen" = "25.0 10.1 99.0 95.0 -20.0 " ]
