#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: energy_rate() of the crate starship-battery is current_now times voltage_now where a supply has no power_now.
# Happens:  without charge_full and charge_full_design it is current_now alone, taken for microwatts: 1.5 A at 3.7 V are 1.5 W
#   instead of 5.55. The kernel's axp20x_battery, of many single-board computers and phones, shows just these files
#   (axp20x_battery_props in drivers/power/supply/axp20x_battery.c), and the ABI gives current_now in microampere.
# Version:  starship-battery 0.12.0 from crates.io, src/platform/linux/sysfs/source.rs, energy_rate(). Its folder of supplies is
#   a constant, so another one is mounted over it for this process (unshare).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
supply=$folder/supplies/axp20x-battery
mkdir -p "$supply" "$folder/src"
for file in type=Battery present=1 online=1 status=Charging health=Good voltage_now=3700000 current_now=1500000 capacity=60 \
    voltage_max=4200000 voltage_min=2900000; do
    echo "${file#*=}" >"$supply/${file%%=*}"
done
cat >"$folder/Cargo.toml" <<'END'
[package]
name = "seen"
version = "0.0.0"
edition = "2021"
[dependencies]
starship-battery = "=0.12.0"
END
cat >"$folder/src/main.rs" <<'END'
use starship_battery::{units::{electric_potential::volt, power::watt}, Manager};

fn main() {
    for battery in Manager::new().unwrap().batteries().unwrap() {
        let battery = battery.unwrap();
        print!("{:.2} {:.2} ", battery.voltage().get::<volt>(), battery.energy_rate().get::<watt>());
    }
}
END
CARGO_TARGET_DIR=$folder/target cargo build -q --manifest-path "$folder/Cargo.toml"
seen=$(unshare --map-root-user --mount bash -c 'mount --bind "$1" /sys/class/power_supply && exec "$2"' - \
    "$folder/supplies" "$folder/target/debug/seen")
echo "starship-battery 0.12.0, volts, and watts of 1.5 A at 3.7 V: $seen"
[ "$seen" = "3.70 1.50 " ]
