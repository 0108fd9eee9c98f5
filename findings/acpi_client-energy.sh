#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: acpi_client's BatteryInfo has capacities in mAh, as its document says, and a percentage near `capacity`, also for
#   a supply that shows energy.
# Happens:  milliwatt hours are divided by millivolts, which makes whole ampere hours: a pack of 50 Wh at 11.1 V has a design
#   capacity of 4 "mAh" instead of 4504. The percentage is that of the rounded numbers: 33.3 for a pack with 50 %.
# Version:  acpi_client 2.0.0 from crates.io, src/battery.rs, parse_energy_supply(). The folder is an argument.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
supply=$folder/supplies/BAT0
mkdir -p "$supply" "$folder/src"
for file in type=Battery status=Discharging capacity=50 voltage_now=11100000 current_now=1000000 energy_full_design=50000000 \
    energy_full=41000000 energy_now=20500000; do
    echo "${file#*=}" >"$supply/${file%%=*}"
done
cat >"$folder/Cargo.toml" <<'END'
[package]
name = "seen"
version = "0.0.0"
edition = "2021"
[dependencies]
acpi_client = "=2.0.0"
END
cat >"$folder/src/main.rs" <<'END'
fn main() {
    let supplies = std::env::args().nth(1).unwrap();
    for battery in acpi_client::get_battery_info(std::path::Path::new(&supplies)).unwrap() {
        println!("{} {} {} {:.1}", battery.design_capacity, battery.last_capacity, battery.remaining_capacity, battery.percentage);
    }
}
END
export CARGO_TARGET_DIR=$folder/target
seen=$(cargo run -q --manifest-path "$folder/Cargo.toml" -- "$folder/supplies")
echo "acpi_client 2.0.0, design, full and remaining mAh of 4504, 3693 and 1846, and percentage of 50: $seen"
[ "$seen" = "4 3 1 33.3" ]
