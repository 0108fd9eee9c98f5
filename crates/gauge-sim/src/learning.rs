// SPDX-License-Identifier: MIT

//! Impedance Track's learning since the last reset. The conditions for learning Qmax at rest and Ra in a discharge are
//! those of SLUA450, of chapter 12 of SLUUBW5A, and, for the current of a discharge, of TI's answer to owners whose
//! Update Status stays at 05 (E2E 1263623).

/// A cell's voltage counts as open-circuit voltage below this slope, in mV/s.
const SETTLED: f64 = 0.004;
/// Rest after which it counts in any case, in seconds.
const LONGEST_REST_S: f64 = 5.0 * 3600.0;
const TEMPERATURE: (f64, f64) = (10.0, 40.0);
/// Voltages of a cell in mV where the curve is too flat for Qmax.
const FLAT_MV: (f64, f64) = (3737.0, 3800.0);
/// Charge between two open-circuit voltages, as a share of the design capacity: in the first cycle, and later.
const FIRST_CHARGE: f64 = 0.9;
const LATER_CHARGE: f64 = 0.37;
/// Currents for measuring the resistance, as a share of the design capacity.
const RATE: (f64, f64) = (0.1, 0.5);
/// Discharge before the resistance is measured, in seconds.
const TRANSIENT_S: f64 = 500.0;

/// Bits 0 and 1 of Update Status: Qmax is learned, or Qmax and Ra.
pub(super) const QMAX: u8 = 0x01;
pub(super) const QMAX_AND_RA: u8 = 0x02;
pub(super) const LEARNED: u8 = QMAX | QMAX_AND_RA;

/// Whether the voltage has come to rest.
pub(super) fn settled(slope_mv_s: f64, rest_s: f64) -> bool {
    slope_mv_s.abs() < SETTLED || rest_s >= LONGEST_REST_S
}

/// A newly taken open-circuit voltage.
pub(super) struct Ocv {
    /// Depth of discharge, from 0 to 1.
    pub(super) dod: f64,
    pub(super) cell_mv: f64,
    pub(super) degrees: f64,
}

impl Ocv {
    /// Whether Qmax can be measured from it.
    fn counts(&self) -> bool {
        let warm = (TEMPERATURE.0..=TEMPERATURE.1).contains(&self.degrees);
        warm && !(FLAT_MV.0..=FLAT_MV.1).contains(&self.cell_mv)
    }
}

/// What an open-circuit voltage teaches.
pub(super) struct Lesson {
    pub(super) qmax_mah: f64,
    pub(super) learned: u8,
}

/// The present cycle.
#[derive(Clone, Debug, Default)]
pub(super) struct Learning {
    /// Depth of discharge at the start of the next Qmax measurement, and the charge since.
    from: Option<f64>,
    passed_mah: f64,
    updated: bool,
    /// `[RUP_DIS]`: the resistance is not updated.
    pub(super) ra_off: bool,
    /// How long the discharge current has been suitable.
    steady_s: f64,
    ra: bool,
}

impl Learning {
    /// After a reset the depth of discharge is unknown.
    pub(super) fn after_reset() -> Self {
        Self { ra_off: true, ..Self::default() }
    }

    /// `[VOK]`: a depth of discharge is kept for the next update of Qmax.
    pub(super) fn voltage_ok(&self) -> bool {
        self.from.is_some() && !self.updated
    }

    pub(super) fn change(&mut self) {
        self.updated = false;
        self.steady_s = 0.0;
    }

    pub(super) fn pass(&mut self, mah: f64) {
        self.passed_mah += mah;
    }

    /// Takes a part of a discharge and the cell's open-circuit voltage.
    pub(super) fn discharge(&mut self, seconds: f64, rate: f64, cell_mv: f64, open_mv: f64) {
        // A negative resistance is impossible: the gauge's depth of discharge is wrong.
        if cell_mv > open_mv + 1.0 {
            self.ra_off = true;
        }
        let suits = !self.ra_off && (RATE.0..=RATE.1).contains(&rate);
        self.steady_s = if suits { self.steady_s + seconds } else { 0.0 };
        self.ra |= self.steady_s > TRANSIENT_S;
    }

    /// Takes an open-circuit voltage. `learned` are the bits of Update Status.
    pub(super) fn take(&mut self, ocv: &Ocv, design_mah: f64, learned: u8) -> Option<Lesson> {
        if !ocv.counts() {
            self.from = None;
            return None;
        }
        // The voltage shows the real depth of discharge.
        let ra = std::mem::take(&mut self.ra);
        self.ra_off = false;
        let needed = if learned & LEARNED == 0 { FIRST_CHARGE } else { LATER_CHARGE } * design_mah;
        let Some(from) = self.from else {
            (self.from, self.passed_mah) = (Some(ocv.dod), 0.0);
            return None;
        };
        let (passed, change) = (self.passed_mah.abs(), (ocv.dod - from).abs());
        if passed < needed || change == 0.0 {
            self.ra = ra;
            return None;
        }
        (self.from, self.passed_mah, self.updated) = (Some(ocv.dod), 0.0, true);
        let learned = if ra || learned & QMAX_AND_RA != 0 { QMAX_AND_RA } else { QMAX };
        Some(Lesson { qmax_mah: passed / change, learned })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ocv(percent: f64, cell_mv: f64) -> Ocv {
        Ocv { dod: 1.0 - percent / 100.0, cell_mv, degrees: 25.0 }
    }

    #[test]
    fn qmax_is_the_charge_between_two_open_circuit_voltages() {
        let mut learning = Learning::after_reset();
        assert!(learning.ra_off && !learning.voltage_ok());
        assert!(learning.take(&ocv(2.0, 3260.0), 1000.0, 0).is_none());
        assert!(!learning.ra_off && learning.voltage_ok());
        learning.pass(931.0);
        let lesson = learning.take(&ocv(100.0, 4199.0), 1000.0, 0).expect("Qmax");
        assert!((lesson.qmax_mah - 950.0).abs() < 1e-9 && lesson.learned == QMAX);
        assert!(!learning.voltage_ok());
        learning.change();
        assert!(learning.voltage_ok());
        learning.discharge(501.0, 0.2, 3700.0, 3800.0);
        learning.pass(-500.0);
        let lesson = learning.take(&ocv(30.0, 3692.0), 1000.0, QMAX).expect("Qmax");
        assert_eq!(lesson.learned, QMAX_AND_RA);
    }

    #[test]
    fn neither_cold_nor_flat_nor_close_counts() {
        for (taken, passed) in [
            (Ocv { degrees: 9.9, ..ocv(100.0, 4199.0) }, 1000.0),
            (Ocv { degrees: 40.1, ..ocv(100.0, 4199.0) }, 1000.0),
            (ocv(50.0, 3790.0), 1000.0),
            (ocv(80.0, 4010.0), 890.0),
        ] {
            let mut learning = Learning::after_reset();
            learning.take(&ocv(0.0, 3000.0), 1000.0, 0);
            learning.pass(passed);
            assert!(learning.take(&taken, 1000.0, 0).is_none());
        }
    }
}
