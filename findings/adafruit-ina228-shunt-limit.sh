#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
#
# Believed: shunt_voltage_overlimit of the PyPI package adafruit-circuitpython-ina228 is the voltage across the shunt, in volts, at which an
#   INA228 raises its alert.
# Happens:  the alert comes at a 62.5th of it: 0.1 V (6.7 A through 15 mOhm) is stored as 320 steps, and a step of SOVL is 5 uV, so at
#   1.6 mV, or 0.1 A. The step that the package takes for it, 312.5 uV, is 1000 times that of the 20-bit register VSHUNT.
# Version:  adafruit-circuitpython-ina228 2.0.5, adafruit_ina228.py, shunt_voltage_overlimit; the steps are those of SBOSA20A
#   (SOVL, VSHUNT). The bus is an object of its user, so no part is needed.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install -q --disable-pip-version-check --no-deps adafruit-circuitpython-ina228==2.0.5 adafruit-circuitpython-busdevice==5.2.17 \
    adafruit-circuitpython-register==1.13.0 adafruit-circuitpython-typing==1.13.0 typing_extensions==4.16.0
# CircuitPython has these; elsewhere the package Adafruit-Blinka, which looks for a board.
echo 'def const(value): return value' >"$folder/micropython.py"
printf 'class I2C: pass\nclass SPI: pass\n' >"$folder/busio.py"
echo 'class DigitalInOut: pass' >"$folder/digitalio.py"
cat >"$folder/seen.py" <<'END'
class Bus:
    """An INA228 with DEVICE_ID (0x3f) 0x2281, which keeps what is written to its registers of two bytes."""

    def __init__(self):
        self.registers = {0x3E: b"TI", 0x3F: b"\x22\x81"}

    def try_lock(self):
        return True

    def unlock(self):
        pass

    def writeto(self, address, buffer, start=0, end=None):
        register, data = bytes(buffer[start:end])[:1], bytes(buffer[start:end])[1:]
        if data:
            self.registers[register[0]] = data

    def writeto_then_readfrom(self, address, out, into, out_start=0, out_end=None, in_start=0, in_end=None):
        data = self.registers.get(out[out_start], bytes(5))
        size = (len(into) if in_end is None else in_end) - in_start
        into[in_start:in_start + size] = (data + bytes(5))[:size]

    def readfrom_into(self, address, buffer, start=0, end=None):
        pass


from adafruit_ina228 import INA228

bus = Bus()
part = INA228(bus)
part.shunt_voltage_overlimit = 0.1
steps = int.from_bytes(bus.registers[0x0C], "big", signed=True)
print(f"SOVL is {steps} steps, {steps * 5e-6 * 1000:.1f} mV")
END
seen=$(cd "$folder" && venv/bin/python seen.py)
echo "adafruit-circuitpython-ina228 2.0.5, an alert at 100 mV: $seen"
[ "$seen" = "SOVL is 320 steps, 1.6 mV" ]
