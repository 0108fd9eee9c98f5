#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: minutes_to_empty() of the PyPI package battery is the minutes that are left, and None while they are not known.
# Happens:  it is None below one hour. upower prints a time in seconds, minutes, hours or days, whichever is the largest that
#   gives 1 or more; only a line with "hours" passes. So the time goes when it starts to matter:
#   1.5 hours are 90, 45.0 minutes are None.
# Version:  battery 1.0.4 from PyPI, battery/battery.json. The text is what upower 0.99.20 of Debian 12 printed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q --disable-pip-version-check battery==1.0.4
cat >"$folder/venv/bin/upower" <<'END'
#!/bin/sh
echo "Device: /org/freedesktop/UPower/devices/battery_BAT0
  native-path:          BAT0
  battery
    present:             yes
    state:               discharging
    energy:              6 Wh
    energy-full:         41 Wh
    energy-rate:         8 W
    time to empty:       $LEFT
    percentage:          12%"
END
chmod +x "$folder/venv/bin/upower"
export PATH=$folder/venv/bin:$PATH
seen=
for left in "1.5 hours" "45.0 minutes"; do
    seen+=$(LEFT=$left python -c 'import battery; print(battery.is_discharging(), battery.percent(), battery.minutes_to_empty())')", "
done
echo "battery 1.0.4, discharging, percent and minutes left of 1.5 hours, and of 45 minutes: $seen"
[ "$seen" = "True 12 90, True 12 None, " ]
