#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: the promise of the npm package battery is rejected, or has no level, where the level of the battery is not known.
# Happens:  on Linux it asks the program upower. Where that is not installed, the battery is full and charging, as on a desktop
#   without one: { level: 1, charging: true }. A board with a fuel gauge and no UPower has 100 % until it goes out. With upower
#   in the path and a pack of 12 % it is 0.12 and false.
# Version:  battery 1.0.1 from npm, index.js, with battery-level 3.0.0, is-charging 2.0.0 and linux-battery 3.0.1. The text is
#   what upower 0.99.20 of Debian 12 printed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm install --silent --no-fund --no-audit battery@1.0.1 battery-level@3.0.0 is-charging@2.0.0 linux-battery@3.0.1
mkdir without with
cat >with/upower <<'END'
#!/bin/sh
if [ "$1" = -e ]; then
    echo /org/freedesktop/UPower/devices/battery_BAT0
else
    echo '  native-path:          BAT0
  power supply:         yes
  battery
    present:             yes
    state:               discharging
    energy:              6 Wh
    percentage:          12%'
fi
END
chmod +x with/upower
node=$(command -v node)
seen=
for path in with without; do
    seen+=$(PATH=$folder/$path "$node" -e "require('battery')().then((b) => console.log(b.level, b.charging))")", "
done
echo "battery 1.0.1, level and charging with upower, and without it: $seen"
[ "$seen" = "0.12 false, 1 true, " ]
