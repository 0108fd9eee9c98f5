#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: acpi_client's get_battery_info() gives the data of all batteries, or any error that it meets, as its document says.
# Happens:  a battery whose status is "Not charging" or "Unknown", which are words of the kernel's ABI, is left out without an
#   error, and is back as soon as the word is another one. A laptop that holds its charge at a limit has no battery.
# Version:  acpi_client 2.0.0 from crates.io, src/battery.rs, get_battery_info() and parse_state_from_str().
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
supply=$folder/supplies/BAT0
mkdir -p "$supply" "$folder/src"
for file in type=Battery voltage_now=3700000 current_now=0 charge_full_design=1000000 charge_full=1000000 charge_now=800000; do
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
    println!("{:?}", acpi_client::get_battery_info(std::path::Path::new(&supplies)).map(|batteries| batteries.len()));
}
END
export CARGO_TARGET_DIR=$folder/target
seen=
for status in Discharging "Not charging" Unknown Full; do
    echo "$status" >"$supply/status"
    seen+="$status: $(cargo run -q --manifest-path "$folder/Cargo.toml" -- "$folder/supplies") "
done
echo "acpi_client 2.0.0, number of batteries: $seen"
[ "$seen" = "Discharging: Ok(1) Not charging: Ok(0) Unknown: Ok(0) Full: Ok(1) " ]
