#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: energy_rate() of the crate starship-battery is the power that flows, as its document says.
# Happens:  above 100 W it is 0: a pack that gives 99 W has 99 W, one that gives 120 W has none, without an error. Packs of
#   e-bikes, tools and large laptops give and take more than that.
# Version:  starship-battery 0.12.0 from crates.io, src/platform/linux/sysfs/source.rs, energy_rate(). Its folder of supplies is
#   a constant, so another one is mounted over it for this process (unshare).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
supply=$folder/supplies/BAT0
mkdir -p "$supply" "$folder/src"
for file in type=Battery status=Discharging capacity=60 voltage_now=36000000 energy_now=300000000 energy_full=500000000 \
    energy_full_design=500000000; do
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
use starship_battery::{units::power::watt, Manager};

fn main() {
    for battery in Manager::new().unwrap().batteries().unwrap() {
        print!("{} ", battery.unwrap().energy_rate().get::<watt>());
    }
}
END
CARGO_TARGET_DIR=$folder/target cargo build -q --manifest-path "$folder/Cargo.toml"
seen=
for power in 99000000 120000000; do
    echo "$power" >"$supply/power_now"
    seen+=$(unshare --map-root-user --mount bash -c 'mount --bind "$1" /sys/class/power_supply && exec "$2"' - \
        "$folder/supplies" "$folder/target/debug/seen")
done
echo "starship-battery 0.12.0, watts of 99 W and of 120 W: $seen"
[ "$seen" = "99 0 " ]
