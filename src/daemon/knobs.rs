// SPDX-License-Identifier: MIT

//! The files of `sim/`.

use crate::error::Result;
use crate::fs::Knobs;
use gauge_sim::Sim;

/// The knobs of a simulated gauge.
pub(crate) struct SimKnobs(pub(crate) Sim);

impl Knobs for SimKnobs {
    fn list(&self) -> Vec<(&'static str, bool)> {
        self.0.knobs().iter().map(|knob| (knob.name, knob.writable)).collect()
    }

    fn get(&self, name: &str) -> Option<String> {
        self.0.get(name)
    }

    fn set(&self, name: &str, text: &str) -> Result<()> {
        Ok(self.0.set(name, text)?)
    }
}
