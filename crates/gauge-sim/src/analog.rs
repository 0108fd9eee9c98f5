// SPDX-License-Identifier: MIT

//! Errors of the board and the specimen: offsets and gains, which a calibration finds, and noise, which it does not. At
//! first there are none, so that the calibration in flash fits the board.

use super::knob::KnobChoice;
use super::random::Random;

/// Counts of Board Offset per milliampere, as in the offset that the gauge measures itself.
pub(super) const BOARD_COUNTS: f64 = 4.0;
/// Counts of CC Offset per milliampere. TI's tools show a count as 0.00048.
pub(super) const CC_COUNTS: f64 = 1.0 / 0.00048;

/// The thermistor, where a gauge uses one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Thermistor {
    In,
    Out,
    Short,
}

impl KnobChoice for Thermistor {
    const WORDS: &'static [(&'static str, Self)] =
        &[("in", Thermistor::In), ("out", Thermistor::Out), ("short", Thermistor::Short)];
}

impl Thermistor {
    /// What it shows of a temperature in 0.1 K.
    pub(super) fn shows(self, sensed: f64) -> f64 {
        match self {
            Self::In => sensed,
            Self::Out => ENDS[0],
            Self::Short => ENDS[1],
        }
    }
}

/// The ends of the conversion in 0.1 K, -40 and 120 degrees Celsius: the manuals print none, and owners see about these.
const ENDS: [f64; 2] = [2331.0, 3931.0];

#[derive(Clone, Debug)]
pub(super) struct Analog {
    /// CC Gain that measures correctly with an exact shunt.
    pub(super) gain: f64,
    /// Excess of the shunt's resistance, in thousandths.
    pub(super) shunt_error: f64,
    /// Offsets in mA before Board Offset and CC Offset are subtracted; `None` while the stored offsets fit.
    pub(super) board_offset_ma: Option<f64>,
    pub(super) cc_offset_ma: Option<f64>,
    pub(super) temperature: f64,
    pub(super) thermistor: Thermistor,
    pub(super) noise_mv: f64,
    pub(super) noise_ma: f64,
    /// From -1 to 1.
    noise: [f64; 2],
    random: Random,
}

impl Analog {
    pub(super) fn fitting(gain: f64) -> Self {
        Self {
            gain,
            shunt_error: 0.0,
            board_offset_ma: None,
            cc_offset_ma: None,
            temperature: 0.0,
            thermistor: Thermistor::In,
            noise_mv: 0.0,
            noise_ma: 0.0,
            noise: [0.0; 2],
            random: Random::new(1),
        }
    }

    /// By how much the counted charge is larger than the real one, with a CC Gain.
    pub(super) fn ratio(&self, gain: f64) -> f64 {
        (1.0 + self.shunt_error / 1000.0) * gain / self.gain
    }

    pub(super) fn measure(&mut self) {
        self.noise = [(); 2].map(|()| self.random.roll(2001) as f64 / 1000.0 - 1.0);
    }

    /// The current that the gauge measures with the calibration in flash.
    pub(super) fn current_ma(&self, true_ma: f64, gain: f64, board: f64, cc: f64) -> f64 {
        let board = self.board_offset_ma.map_or(0.0, |offset| offset - board / BOARD_COUNTS);
        let cc = self.cc_offset_ma.map_or(0.0, |offset| offset - cc / CC_COUNTS);
        true_ma * self.ratio(gain) + (board + cc) * gain / self.gain + self.noise[0] * self.noise_ma
    }

    pub(super) fn voltage_mv(&self, voltage_mv: f64) -> f64 {
        voltage_mv + self.noise[1] * self.noise_mv
    }
}
