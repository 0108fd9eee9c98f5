#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: health() of libmacchina's BatteryReadout is the percentage of its design energy that a full battery still has.
# Happens:  it is an error for every battery, for want of a calculation: energy_full is parsed as a number of eight bits, and is in
#   microwatt-hours, 50000000 of a laptop's. 255 uWh are the most that it could take.
# Version:  libmacchina 8.1.0 from crates.io, src/linux/mod.rs, health(); the unit is that of Documentation/ABI/testing/sysfs-class-power.
#   It reads a folder of plain files in place of /sys/class/power_supply, in a mount namespace.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
mkdir -p "$folder/src" "$folder/supplies/BAT0"
cat >"$folder/Cargo.toml" <<'END'
[package]
name = "seen"
version = "0.0.0"
edition = "2021"
[dependencies]
libmacchina = "=8.1.0"
END
cat >"$folder/src/main.rs" <<'END'
use libmacchina::traits::BatteryReadout as _;

fn main() {
    let battery = libmacchina::BatteryReadout::new();
    println!("{:?} {:?}", battery.percentage(), battery.health());
}
END
for value in type=Battery capacity=67 status=Discharging energy_full=40000000 energy_full_design=50000000 energy_now=27000000; do
    echo "${value#*=}" >"$folder/supplies/BAT0/${value%%=*}"
done
CARGO_TARGET_DIR=$folder/target cargo build -q --manifest-path "$folder/Cargo.toml"
seen=$(unshare -rm sh -euc 'mount --bind "$1/supplies" /sys/class/power_supply; exec "$1/target/debug/seen"' sh "$folder")
echo "libmacchina 8.1.0, charge and health of a battery that has 40 of 50 Wh: $seen"
[ "$seen" = 'Ok(67) Err(Other("Error calculating battery health."))' ]
