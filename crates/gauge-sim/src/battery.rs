// SPDX-License-Identifier: MIT

//! The pack itself: charge, open-circuit voltage, resistance and temperature. A [`Model`](super::model::Model) is the
//! gauge's view of it.

/// Open-circuit voltage of a lithium-ion cell in mV, by state of charge in percent.
const CURVE: &[(f64, f64)] = &[
    (0.0, 3000.0),
    (2.0, 3260.0),
    (5.0, 3430.0),
    (10.0, 3560.0),
    (20.0, 3645.0),
    (30.0, 3692.0),
    (40.0, 3735.0),
    (50.0, 3790.0),
    (60.0, 3855.0),
    (70.0, 3930.0),
    (80.0, 4010.0),
    (90.0, 4092.0),
    (100.0, 4199.0),
];

/// Open-circuit voltage of a primary cell of lithium and thionyl chloride in mV, by state of charge in percent.
const PRIMARY_CURVE: &[(f64, f64)] = &[
    (0.0, 2000.0),
    (3.0, 3000.0),
    (10.0, 3420.0),
    (20.0, 3520.0),
    (50.0, 3580.0),
    (80.0, 3630.0),
    (100.0, 3660.0),
];

const RESISTANCE: f64 = 0.042;
const PRIMARY_RESISTANCE: f64 = 2.0;
/// Slow part of the resistance in ohms, and its time constant in seconds. A rested cell needs most of an hour to come
/// to rest, a nearly empty one longer.
const DIFFUSION: f64 = 0.03;
const DIFFUSION_TIME: f64 = 1800.0;
const CHARGER_MV: f64 = 4200.0;
/// Self-heating: kelvins per watt, and its time constant in seconds.
const WARMING: f64 = 12.0;
const WARMING_TIME: f64 = 600.0;
/// This close to full or empty the protector opens, and charge or discharge ends.
const SHUT: f64 = 1e-9;

#[derive(Clone, Debug)]
pub(super) struct Battery {
    pub(super) cells: f64,
    /// The real number of cells, where data flash has another one.
    pub(super) series: Option<f64>,
    pub(super) capacity_mah: f64,
    /// The capacity does not follow data flash.
    pub(super) is_own: bool,
    /// Until the next reset it does not follow either.
    pub(super) is_kept: bool,
    pub(super) charge_mah: f64,
    /// Negative for a charger.
    pub(super) load_ma: f64,
    pub(super) ambient: f64,
    /// Of the pack above ambient, in kelvins.
    rise: f64,
    /// Voltage of a cell above its open-circuit voltage without a current, in mV.
    offset_mv: f64,
    /// Voltage measured instead of the pack's.
    pub(super) forced_mv: Option<u16>,
    curve: &'static [(f64, f64)],
    /// Of a cell, at 25 degrees Celsius.
    pub(super) ohms: f64,
    diffusion: f64,
}

impl Battery {
    pub(super) fn new(cells: f64, capacity_mah: f64, soc: f64) -> Self {
        let charge_mah = capacity_mah * soc / 100.0;
        Self {
            cells,
            series: None,
            capacity_mah,
            is_own: false,
            is_kept: false,
            charge_mah,
            load_ma: 0.0,
            ambient: 25.0,
            rise: 0.0,
            offset_mv: 0.0,
            forced_mv: None,
            curve: CURVE,
            ohms: RESISTANCE,
            diffusion: DIFFUSION,
        }
    }

    pub(super) fn primary(cells: f64, capacity_mah: f64, soc: f64) -> Self {
        let (curve, ohms) = (PRIMARY_CURVE, PRIMARY_RESISTANCE);
        Self { curve, ohms, diffusion: 0.0, ..Self::new(cells, capacity_mah, soc) }
    }

    /// Takes the size of data flash and keeps the state of charge.
    pub(super) fn resize(&mut self, cells: f64, capacity_mah: f64) {
        if !self.is_own && !self.is_kept {
            self.set_capacity(capacity_mah);
        }
        self.cells = self.series.unwrap_or(cells);
    }

    pub(super) fn set_capacity(&mut self, capacity_mah: f64) {
        self.charge_mah *= capacity_mah / self.capacity_mah;
        self.capacity_mah = capacity_mah;
    }

    pub(super) fn percent(&self) -> f64 {
        (100.0 * self.charge_mah / self.capacity_mah).clamp(0.0, 100.0)
    }

    pub(super) fn set_percent(&mut self, percent: f64) {
        self.charge_mah = self.capacity_mah * percent / 100.0;
    }

    pub(super) fn temperature(&self) -> f64 {
        self.ambient + self.rise
    }

    pub(super) fn resistance(&self) -> f64 {
        let cold = ((25.0 - self.temperature()) * 0.02).clamp(-0.5, 1.5);
        let empty = (10.0 - self.percent()).max(0.0) * 0.1;
        self.ohms * (1.0 + cold + empty)
    }

    /// Current into the pack, in mA. A load draws it while there is charge. A charger delivers it until the cells have
    /// its voltage, and then the current that this voltage still drives.
    pub(super) fn current_ma(&self) -> f64 {
        if self.load_ma > 0.0 {
            return if self.charge_mah > SHUT { -self.load_ma } else { 0.0 };
        }
        if self.charge_mah >= self.capacity_mah - SHUT {
            return 0.0;
        }
        let driven = (CHARGER_MV - self.open_circuit(self.percent()) - self.offset_mv) / self.resistance();
        (-self.load_ma).min(driven.max(0.0))
    }

    pub(super) fn cell_mv(&self) -> f64 {
        let rested = self.open_circuit(self.percent()) + self.offset_mv;
        (rested + self.current_ma() * self.resistance()).max(0.0)
    }

    /// Lets a time pass that is short enough for a constant current.
    pub(super) fn step(&mut self, seconds: f64) {
        let current = self.current_ma();
        let moved = current * seconds / 3600.0;
        self.charge_mah = (self.charge_mah + moved).clamp(0.0, self.capacity_mah);
        let watts = (current / 1000.0).powi(2) * self.resistance();
        self.rise += (watts * WARMING - self.rise) * (1.0 - libm::exp(-seconds / WARMING_TIME));
        let aim = current * self.diffusion();
        self.offset_mv += (aim - self.offset_mv) * (1.0 - libm::exp(-seconds / DIFFUSION_TIME));
    }

    fn diffusion(&self) -> f64 {
        self.diffusion * (1.0 + (20.0 - self.percent()).max(0.0) * 0.1)
    }

    pub(super) fn rest(&mut self) {
        self.offset_mv = 0.0;
    }

    /// How fast the voltage of a cell changes at rest, in mV/s.
    pub(super) fn slope_mv_s(&self) -> f64 {
        (self.current_ma() * self.diffusion() - self.offset_mv) / DIFFUSION_TIME
    }

    pub(super) fn energy_mwh(&self, charge_mah: f64) -> f64 {
        let percent = (100.0 * charge_mah / self.capacity_mah).clamp(0.0, 100.0);
        let mut area = 0.0;
        for pair in self.curve.windows(2) {
            let ((from, low), (to, _)) = (pair[0], pair[1]);
            let end = to.min(percent);
            if end > from {
                area += (low + self.open_circuit(end)) / 2.0 * (end - from);
            }
        }
        area / 100.0 * self.capacity_mah / 1000.0 * self.cells
    }

    /// State of charge in percent for an open-circuit voltage.
    pub(super) fn percent_at(&self, mv: f64) -> f64 {
        for pair in self.curve.windows(2) {
            let ((from, low), (to, high)) = (pair[0], pair[1]);
            if mv <= high {
                return (from + (to - from) * (mv - low) / (high - low)).max(0.0);
            }
        }
        100.0
    }

    /// Open-circuit voltage of one cell at a state of charge, in mV.
    pub(super) fn open_circuit(&self, percent: f64) -> f64 {
        for pair in self.curve.windows(2) {
            let ((from, low), (to, high)) = (pair[0], pair[1]);
            if percent <= to {
                return low + (high - low) * (percent - from) / (to - from);
            }
        }
        self.curve[self.curve.len() - 1].1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn voltage_falls_with_the_load_and_with_the_charge() {
        let mut battery = Battery::new(1.0, 1000.0, 60.0);
        assert!((battery.cell_mv() - 3855.0).abs() < 1e-6);
        battery.load_ma = 1000.0;
        assert!((battery.cell_mv() - 3813.0).abs() < 1e-6);
        let mut last = battery.cell_mv();
        loop {
            battery.step(1.0);
            // Once empty, the protector opens and the cell recovers.
            if battery.current_ma() == 0.0 {
                break;
            }
            let now = battery.cell_mv();
            assert!(now < last, "{last} then {now}");
            last = now;
        }
        assert!(battery.charge_mah.abs() < 1e-6);
        // It takes hours until nothing is left of the current.
        assert!(battery.cell_mv() < 2980.0, "{}", battery.cell_mv());
        battery.step(1800.0);
        assert!(battery.slope_mv_s() > 0.004, "{}", battery.slope_mv_s());
        battery.step(10.0 * 3600.0);
        assert!((battery.cell_mv() - 3000.0).abs() < 1e-3);
    }

    #[test]
    fn an_open_circuit_voltage_shows_the_state_of_charge() {
        let battery = Battery::new(1.0, 1000.0, 60.0);
        for percent in [0.0, 1.0, 33.0, 50.0, 99.0, 100.0] {
            assert!((battery.percent_at(battery.open_circuit(percent)) - percent).abs() < 1e-9, "{percent}");
        }
        assert_eq!((battery.percent_at(2000.0), battery.percent_at(4300.0)), (0.0, 100.0));
    }

    #[test]
    fn the_charger_tapers() {
        let mut battery = Battery::new(1.0, 1000.0, 90.0);
        battery.load_ma = -500.0;
        assert_eq!(battery.current_ma(), 500.0);
        let mut tapered = false;
        for _ in 0..7200 {
            battery.step(1.0);
            assert!(battery.cell_mv() <= CHARGER_MV + 1e-6);
            tapered |= (1.0..100.0).contains(&battery.current_ma());
        }
        assert!(tapered);
        assert_eq!(battery.current_ma(), 0.0);
    }

    #[test]
    fn energy_is_the_area_below_the_curve() {
        let battery = Battery::new(4.0, 1000.0, 100.0);
        assert_eq!(battery.energy_mwh(0.0), 0.0);
        let full = battery.energy_mwh(1000.0);
        assert!((14_800.0..15_600.0).contains(&full), "{full}");
        let ten = battery.energy_mwh(1000.0) - battery.energy_mwh(900.0);
        assert!((ten - 0.4 * (4092.0 + 4199.0) / 2.0).abs() < 1e-6, "{ten}");
    }
}
