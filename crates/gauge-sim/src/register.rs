// SPDX-License-Identifier: MIT

//! A gauge known by its standard commands only: readable registers, and what identifies the part. It takes no other
//! writes, so a test sees anything else that a host sends.

use std::time::Duration;

use super::device::{Device, Gauge, Wire};
use super::flash::Flash;
use super::gauging::{Gauging, Quantity};
use super::knob;
use super::model::{Model, Registers};
use super::options::Options;
use super::part::{Part, RegisterPart};
use super::seal::Level;
use gauge_bus::GAUGE_ADDRESS;
use gauge_bus::error::{Error, ErrorKind, Result};

/// A charge of 3.57 µVh across 20 mΩ in mAh, and an energy of 29.2 µV²h across it in mWh.
const CHARGE: f64 = 0.1785;
const ENERGY: f64 = 1.46;
/// `[CHGS]` of the bq27000.
const CHARGING: u8 = 0x80;

pub(super) struct Register {
    part: &'static RegisterPart,
    gauging: Gauging,
    /// Low byte of a word for Control(), and its answer.
    low: u8,
    answer: u16,
    /// The pack was taken out, and the lines are pulled up.
    out: bool,
    registers: Option<Registers>,
}

impl Register {
    #[inline(never)] // A gauge as a value is large; those of all schemes are not to be on the stack together.
    pub(super) fn gauge(
        part: &'static Part,
        scheme: &'static RegisterPart,
        options: &Options,
        now: Duration,
    ) -> Result<Gauge> {
        let device = Device::new(part, options, now, |_| {})?;
        let gauging = Gauging::new(&scheme.map, &device.flash, 60.0);
        let gauge = Self { part: scheme, gauging, low: 0, answer: 0, out: false, registers: None };
        Ok(Gauge::new(device, gauge, options.envelope))
    }

    /// A bq27000's registers are in its own units.
    fn measure(&self) -> Registers {
        let mut registers = self.gauging.registers(false, true);
        if !self.part.in_volts {
            return registers;
        }
        let mut charging = 0;
        for &(register, size, quantity) in self.part.map.registers {
            let at = usize::from(register);
            let word = u16::from_le_bytes([registers[at], registers[at + 1]]);
            let (value, signed) = (f64::from(word), f64::from(word as i16));
            let shown = match quantity {
                Quantity::Temperature => value / 2.5,
                Quantity::NominalRemaining | Quantity::Full => value / CHARGE,
                Quantity::DesignCapacity => value / CHARGE / 256.0,
                Quantity::AvailableEnergy => value / ENERGY,
                Quantity::AveragePower => signed.abs() / ENERGY,
                Quantity::AverageCurrent => {
                    charging = if signed > 0.0 { CHARGING } else { 0 };
                    signed.abs() / CHARGE
                }
                _ => continue,
            };
            let bytes = (shown.round() as u16).to_le_bytes();
            registers[at..at + size].copy_from_slice(&bytes[..size]);
        }
        for &(register, _, quantity) in self.part.map.registers {
            if quantity == Quantity::Flags {
                registers[usize::from(register)] |= charging;
            }
        }
        registers
    }
}

impl Wire for Register {
    fn address(&self, _: &Flash) -> Option<u8> {
        Some(GAUGE_ADDRESS)
    }

    fn has(&self, register: u8) -> bool {
        register < 0x80
    }

    fn extends(&self, register: u8) -> bool {
        register == 0x01
    }

    fn write(&mut self, _: &mut Device, register: u8, byte: u8) -> bool {
        let Some((device_type, firmware)) = self.part.control else { return false };
        match register {
            0x00 => self.low = byte,
            0x01 => {
                self.answer = match u16::from_le_bytes([self.low, byte]) {
                    0x0001 => device_type,
                    0x0002 => firmware,
                    _ => 0,
                };
            }
            _ => return false,
        }
        true
    }

    fn read(&mut self, device: &Device, register: u8) -> u8 {
        if self.out {
            return 0xFF;
        }
        if let (Some(_), 0x00 | 0x01) = (self.part.control, register) {
            return self.answer.to_le_bytes()[usize::from(register)];
        }
        let voltage = self.part.map.registers.iter().find(|(_, _, quantity)| *quantity == Quantity::Voltage);
        if device.unmeasured() && voltage.is_some_and(|(at, ..)| (*at..at + 2).contains(&register)) {
            return 0;
        }
        let registers = self.registers.take().unwrap_or_else(|| self.measure());
        self.registers = Some(registers);
        registers[usize::from(register & 0x7F)]
    }

    fn versions(&mut self, _: &Flash) -> [Option<u16>; 2] {
        [None; 2]
    }

    fn reset(&mut self, _: &mut Device) {
        (self.low, self.answer, self.registers) = (0, 0, None);
    }

    fn run(&mut self, device: &mut Device, settle: bool) {
        if device.is_on() && device.now >= device.measured_from {
            self.gauging.first_voltage();
        }
        device.pass(self, settle);
        self.registers = None;
    }

    fn refresh(&mut self) {
        self.gauging.measure();
        self.registers = None;
    }

    fn model(&mut self) -> &mut dyn Model {
        &mut self.gauging
    }

    fn set_level(&mut self, _: &mut Device, _: Level) -> Result<()> {
        Err(Error::new("seal", ErrorKind::NotPermitted, "the part has no seal"))
    }

    fn knob(&self, _: &Device, name: &str) -> Option<String> {
        (name == "battery").then(|| knob::BATTERY.show(self.out))
    }

    fn set_knob(&mut self, _: &mut Device, name: &str, text: &str) -> Result<()> {
        self.out = knob::BATTERY.read(name, text)?;
        Ok(())
    }
}
