// SPDX-License-Identifier: MIT

//! The learning state of Impedance Track since the last reset. The conditions under which it learns Qmax at rest and Ra
//! in a discharge are those of SLUA450, of chapter 12 of SLUUBW5A, and, for the current of a
//! discharge, of TI's answer to owners whose Update Status stays at 05 (E2E 1263623).

/// Slope of a cell's voltage below which it is an open-circuit voltage, in mV/s.
const SETTLED: f64 = 0.004;
/// Rest after which it is taken in any case, in seconds.
const LONGEST_REST_S: f64 = 5.0 * 3600.0;
/// Temperatures in degrees at which an open-circuit voltage counts for Qmax.
const TEMPERATURE: (f64, f64) = (10.0, 40.0);
/// Voltages of a cell in mV at which it does not, because the curve is too flat.
const FLAT_MV: (f64, f64) = (3737.0, 3800.0);
/// Charge in parts of the design capacity that has to pass between two of them: in the first cycle, and later.
const FIRST_CHARGE: f64 = 0.9;
const LATER_CHARGE: f64 = 0.37;
/// Currents in parts of the design capacity at which the resistance is measured.
const RATE: (f64, f64) = (0.1, 0.5);
/// Discharge after which it can be measured, in seconds.
const TRANSIENT_S: f64 = 500.0;

/// Bits 0 and 1 of Update Status: Qmax is learned, or Qmax and Ra.
pub(super) const QMAX: u8 = 0x01;
pub(super) const QMAX_AND_RA: u8 = 0x02;
pub(super) const LEARNED: u8 = QMAX | QMAX_AND_RA;

/// Whether a rest has brought the voltage to rest as well.
pub(super) fn settled(slope_mv_s: f64, rest_s: f64) -> bool {
    slope_mv_s.abs() < SETTLED || rest_s >= LONGEST_REST_S
}

/// An open-circuit voltage that was just taken.
pub(super) struct Ocv {
    /// The depth of discharge that it shows, from 0 to 1.
    pub(super) dod: f64,
    pub(super) cell_mv: f64,
    pub(super) degrees: f64,
}

impl Ocv {
    /// Whether it can be one of the two between which Qmax is measured.
    fn counts(&self) -> bool {
        let warm = (TEMPERATURE.0..=TEMPERATURE.1).contains(&self.degrees);
        warm && !(FLAT_MV.0..=FLAT_MV.1).contains(&self.cell_mv)
    }
}

/// The values that the gauge learns from an open-circuit voltage.
pub(super) struct Lesson {
    pub(super) qmax_mah: f64,
    /// The new bits of Update Status.
    pub(super) learned: u8,
}

/// The state of a cycle. A reset clears it.
#[derive(Clone, Debug, Default)]
pub(super) struct Learning {
    /// The depth of discharge from which the next Qmax is measured, and the charge that has passed since.
    from: Option<f64>,
    passed_mah: f64,
    /// Qmax was updated in this rest.
    updated: bool,
    /// `[RUP_DIS]`: the resistance is not updated.
    pub(super) ra_off: bool,
    /// For how long the present discharge has had a current that suits.
    steady_s: f64,
    /// The resistance was updated since the last open-circuit voltage.
    ra: bool,
}

impl Learning {
    /// After a reset the depth of discharge is not known.
    pub(super) fn after_reset() -> Self {
        Self { ra_off: true, ..Self::default() }
    }

    /// `[VOK]`: a depth of discharge is kept for the next update of Qmax.
    pub(super) fn voltage_ok(&self) -> bool {
        self.from.is_some() && !self.updated
    }

    /// A rest has ended, or begun.
    pub(super) fn change(&mut self) {
        self.updated = false;
        self.steady_s = 0.0;
    }

    pub(super) fn pass(&mut self, mah: f64) {
        self.passed_mah += mah;
    }

    /// A part of a discharge, with the voltage that a cell would have without the current.
    pub(super) fn discharge(&mut self, seconds: f64, rate: f64, cell_mv: f64, open_mv: f64) {
        // A negative resistance is impossible: the gauge is wrong about the depth of discharge.
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
        // It shows the depth of discharge, whatever the gauge thought.
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
