#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: battery-stats-collector records what is left in percent of a full battery.
# Happens:  of a gauge of the kernel's bq27xxx (bq27500, bq27510, bq27520) it records up to 370 %, 247 % where 67 % are left: it chooses
#   between energy and charge for each file, and that driver has energy_now, but of a full battery charge_full only. It divides
#   microwatt-hours by microampere-hours.
# Version:  battery-stats 0.5.6-2+b2 of Debian 12, /usr/sbin/battery-stats-collector, get_logline(); the files are those of
#   bq27500_props in Linux 6.12. It reads a folder of plain files in place of /sys/class/power_supply, in a mount namespace.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
pool=http://deb.debian.org/debian/pool/main/b
for package in battery-stats/battery-stats_0.5.6-2+b2_amd64.deb bc/bc_1.07.1-3+b1_amd64.deb; do
    curl -fsSL "$pool/$package" -o "$folder/package.deb"
    dpkg-deb -x "$folder/package.deb" "$folder/root"
done
battery=$folder/supplies/BAT0
mkdir -p "$battery"
# 2 Ah of 3 Ah at 3.7 V, as the driver shows them.
for value in type=Battery present=1 status=Discharging capacity=67 voltage_now=3700000 current_now=-500000 charge_now=2000000 \
    charge_full=3000000 charge_full_design=3000000 energy_now=7400000; do
    echo "${value#*=}" >"$battery/${value%%=*}"
done
seen=$(PATH=$folder/root/usr/bin:$PATH unshare -rm sh -euc '
    mount --bind "$1/supplies" /sys/class/power_supply
    exec sh "$1/root/usr/sbin/battery-stats-collector" --once --output /dev/stdout' sh "$folder" | awk 'NF > 4 { print $2 }')
echo "battery-stats 0.5.6, 2 Ah of 3 Ah, 67 %: $seen %"
[ "$seen" = 246.66 ]
