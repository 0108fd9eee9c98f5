#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: input_voltage_limit() of the crate bq24195 returns the limit that set_input_voltage_limit() was given.
# Happens:  the upper eight limits read as the lower eight, 0.64 V less: 4.76 V as 4.12 V. The field has four bits, of which three are
#   read. Who changes another field and copies this one sets the lower limit on a charger.
# Version:  bq24195 0.1.2 from crates.io, src/lib.rs, From<u8> of InputVoltageLimit; the field is VINDPM of REG00, SLUSB97A. Nothing is
#   sent, so no charger is needed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
mkdir "$folder/src"
cat >"$folder/Cargo.toml" <<'END'
[package]
name = "seen"
version = "0.0.0"
edition = "2021"
[dependencies]
bq24195 = "=0.1.2"
END
cat >"$folder/src/main.rs" <<'END'
use bq24195::{InputSourceControl, InputVoltageLimit::*};

fn main() {
    for limit in [V3_88, V4_36, V4_52, V4_76, V5_08] {
        let mut control = InputSourceControl::default();
        print!("{limit:?} ");
        control.set_input_voltage_limit(limit);
        print!("{:?}, ", control.input_voltage_limit());
    }
}
END
seen=$(CARGO_TARGET_DIR=$folder/target cargo run -q --manifest-path "$folder/Cargo.toml" 2>/dev/null)
echo "bq24195 0.1.2, limits as set and as read: $seen"
[ "$seen" = "V3_88 V3_88, V4_36 V4_36, V4_52 V3_88, V4_76 V4_12, V5_08 V4_44, " ]
