// SPDX-License-Identifier: MIT

//! The gauge that a gauge's options mean.

use super::{ChoiceOptions, GaugeOptions};
use gauge_bus::GAUGE_ADDRESS;
use gauge_owner::{GaugeSetup, Script, Source};
use ti_gauge::dataflash::{Limits, WRITES_PER_HOUR};

impl GaugeOptions {
    /// Where the gauge is.
    pub(crate) fn source(&self) -> Source {
        match (self.sim, &self.replay, &self.bus) {
            (Some(chip), _, _) => {
                let key = self.sim_key.as_ref().map(|key| key.0);
                let seed = self.scenario_seed;
                let scenario = self.scenario.clone().map(|name| Script { name, seed });
                let knobs = self.sim_set.clone();
                Source::Sim { chip, state: self.sim_state.clone(), key, seal: self.sim_seal, scenario, knobs }
            }
            (None, Some(file), _) => Source::Recording(file.clone()),
            (None, None, Some(bus)) => Source::Bus {
                bus: bus.clone(),
                address: self.address.unwrap_or(self.chip.map_or(GAUGE_ADDRESS, |chip| chip.address)),
                chip: self.chip,
                byte_writes: self.byte_writes,
            },
            (None, None, None) => unreachable!("the command line and the configuration demand a source"),
        }
    }

    /// The gauge, and how it is run.
    pub(crate) fn setup(&self) -> GaugeSetup {
        let usual = GaugeSetup::new(self.source());
        GaugeSetup {
            key_file: self.key_file.clone(),
            no_default_keys: self.no_default_keys,
            interval: self.poll.unwrap_or(usual.interval),
            byte_writes: self.byte_writes,
            allow_unproven: self.allow_unproven,
            limits: Limits {
                allow_learning: self.allow_learning,
                writes_per_hour: self.writes_per_hour.unwrap_or(WRITES_PER_HOUR),
            },
            auth_order: self.auth_order.unwrap_or_default(),
            profile: self.profile.clone(),
            choose: self.choose.iter().map(ChoiceOptions::rule).collect(),
            pack: self.pack.clone(),
            trace: self.trace.clone(),
            trace_replace: self.trace_replace,
            ..usual
        }
    }
}
