#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: getStatus() of the npm package max17048 says whether the gauge's alerts for voltage and charge are up.
# Happens:  a gauge without an alert is said to have had too high and too low a voltage and too low a charge: the flags are read from
#   VRESET/ID (0x18), whose 0x96 is the reset voltage, not from STATUS (0x1A). What really happens changes nothing in them.
# Version:  max17048 1.0.1 from npm, max17048.js, getStatus(); MAX17048 data sheet, register summary. The bus is an object of its user, so
#   no gauge is needed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm install --silent --no-audit --no-fund --ignore-scripts --omit=optional max17048@1.0.1 async-i2c-bus@1.1.0 >/dev/null
# The call of the kernel, which has to be compiled, and is not needed.
echo 'module.exports = {};' >node_modules/i2c-bus/i2c-bus.js
cat >seen.js <<'END'
const Max17048 = require('max17048/max17048.js');

/** A gauge with these STATUS and the VRESET/ID of a part after power-up; the bus has the low byte first. */
const bus = status => ({
  readWord: async (address, register) => {
    const word = { 0x18: 0x960c, 0x1a: status }[register];
    return (word & 0xff) << 8 | word >> 8;
  },
});

(async () => {
  const shown = [];
  for (const status of [0x0000, 0x1000]) {
    const { voltage_high, voltage_low, soc_low } = await new Max17048(bus(status)).getStatus();
    shown.push([voltage_high, voltage_low, soc_low].join(' '));
  }
  console.log(shown.join(', '));
})();
END
seen=$(node seen.js)
echo "max17048 1.0.1, voltage high, voltage low and charge low without an alert, and with that of a low charge: $seen"
[ "$seen" = "true true true, true true true" ]
