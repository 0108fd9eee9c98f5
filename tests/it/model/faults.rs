// SPDX-License-Identifier: MIT

//! Disturbs gauge and bus, and makes all well again.

use std::fs;
use std::time::Duration;

use gauge_bus::clock::Clock;

use super::Model;

impl Model {
    /// Something goes wrong on the bus or in the gauge, or everything is well again.
    pub(super) fn disturb(&mut self) {
        if self.disturbed {
            return self.heal();
        }
        let number = 1 + self.random.below(40);
        let fault = self.random.pick(&[
            "nack N",
            "nack N 1",
            "eio N",
            "etimedout N",
            "flip N 2 3",
            "flip N 20 1",
            "short N",
            "lost N",
            "stuck N",
            "arbitration N",
            "stretch N 5000",
            "silence N 3000",
            "drop-commit",
            "corrupt-commit",
            "drop-seal",
            "drop-reset",
            "random 30",
            "random 300",
            "off",
        ]);
        let fault = fault.replace('N', &number.to_string());
        self.recent.push(format!("fault: {fault}"));
        self.disturbed = true;
        self.open.iter_mut().for_each(|open| open.disturbed = true);
        let knob = if fault == "off" { ("power", "off") } else { ("fault", fault.as_str()) };
        self.mount.sim.set(knob.0, knob.1).expect("a knob");
    }

    /// Afterwards each parameter has a value that the answers allow.
    pub(super) fn heal(&mut self) {
        self.mount.sim.set("fault", "none").expect("a knob");
        self.mount.sim.set("power", "on").expect("a knob");
        self.mount.sim.set("voltage_mv", "auto").expect("a knob");
        (self.low, self.staged, self.spoiled) = (false, None, None);
        let root = self.mount.root.clone();
        for attempt in 0.. {
            self.mount.clock.sleep(Duration::from_secs(2));
            let at = root.clone();
            let _ = self.users[0].does(move || fs::write(at.join("df/transaction"), "abort\n"));
            let at = root.clone();
            let refreshed = self.users[0].does(move || fs::write(at.join("gauge/refresh"), "1\n"));
            let owes = self.shown("gauge/last_error").is_ok_and(|text| text.contains("OWED"));
            let reads = self.shown(&format!("df/{}", self.parameters[0].place));
            // The key of a gauge that was found open has to be used once before data flash may be written.
            let tried = ["sealed", "unsealed", "sealed"].iter().try_for_each(|seal| {
                let at = root.clone();
                self.users[0].does(move || fs::write(at.join("gauge/seal"), seal))
            });
            let shows = ["voltage_now", "gauge/age_ms"].iter().all(|name| self.path(name).exists());
            if refreshed.is_ok() && !owes && reads.is_ok() && tried.is_ok() && shows {
                self.seal = ["sealed"].into();
                break;
            }
            if attempt == 300 {
                self.fail(&format!("the gauge does not recover: {refreshed:?}, {reads:?}, owes: {owes}"));
            }
        }
        self.recent.push("healed".into());
        self.disturbed = false;
        for at in 0..self.parameters.len() {
            self.reads_back(at);
        }
    }
}
