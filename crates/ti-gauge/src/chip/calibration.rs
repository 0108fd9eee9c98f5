// SPDX-License-Identifier: MIT

//! How a part is calibrated, as data.

use super::Source;

/// The subcommands, bits and parameters of calibration.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// Toggles the permission to enter and to leave calibration mode.
    pub enable: u16,
    /// Enters calibration mode.
    pub enter: u16,
    /// Leaves calibration mode.
    pub exit: u16,
    /// The register, and its bit that is set while calibration is enabled.
    pub enabled: (Source, u32),
    /// The bit of CONTROL_STATUS that is set in calibration mode.
    pub mode: u32,
    /// Measures the offset of the board and the converter, which the gauge stores.
    pub board_offset: Offset,
    /// Measures the offset of the converter.
    pub cc_offset: Offset,
    /// Stores the offset of the converter.
    pub save: u16,
    /// The parameter of two bytes to which Voltage() is proportional.
    pub divider: (u8, u16),
    /// The parameter to which Current() is proportional, and the one for counting charge.
    pub gain: (u8, u16),
    /// See `gain`.
    pub delta: (u8, u16),
    /// The second in units of the first.
    pub ratio: f64,
    /// The offset of the internal temperature sensor and of the thermistor, in 0.1 degrees.
    pub internal: (u8, u16),
    /// See `internal`.
    pub external: (u8, u16),
    /// The register, and its bit that is set while Temperature() is the thermistor's.
    pub thermistor: (Source, u32),
}

/// An offset that the gauge measures without a current.
#[derive(Clone, Debug)]
pub struct Offset {
    /// The subcommand that starts it.
    pub start: u16,
    /// Bits of CONTROL_STATUS; one of them is set meanwhile.
    pub running: u32,
    /// The parameter for the offset.
    pub row: (u8, u16),
}
