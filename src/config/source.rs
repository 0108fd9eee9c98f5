//! Where a gauge is: simulated, recorded, or on a bus.

use std::fmt;
use std::path::Path;

use super::GaugeOptions;
use gauge_bus::GAUGE_ADDRESS;
use ti_gauge::chip::Chip;

/// Where a gauge is.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Source<'a> {
    /// Simulated in this process.
    Sim {
        chip: &'static Chip,
        /// File that keeps its flash.
        state: Option<&'a Path>,
        /// Unseal key of a new one.
        key: Option<[u16; 2]>,
    },
    /// In a file that `--trace` wrote.
    Recording(&'a Path),
    /// On a bus.
    Bus {
        /// The adapter's node.
        bus: &'a Path,
        /// Its 7-bit address.
        address: u8,
        /// `None` where the gauge is asked.
        chip: Option<&'static Chip>,
        /// Write one byte a transfer, also while the gauge is asked.
        byte_writes: bool,
    },
}

impl fmt::Display for Source<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sim { state: Some(state), .. } => write!(f, "simulated gauge kept in {}", state.display()),
            Self::Sim { .. } => f.write_str("simulated gauge"),
            Self::Recording(path) => write!(f, "recording {}", path.display()),
            Self::Bus { bus, address, .. } => write!(f, "{} address 0x{address:02x}", bus.display()),
        }
    }
}

impl<'a> Source<'a> {
    /// The source that the options name.
    pub(crate) fn of(gauge: &'a GaugeOptions) -> Self {
        match (gauge.sim, &gauge.replay, &gauge.bus) {
            (Some(chip), _, _) => {
                let key = gauge.sim_key.as_ref().map(|key| key.0);
                Self::Sim { chip, state: gauge.sim_state.as_deref(), key }
            }
            (None, Some(file), _) => Self::Recording(file),
            (None, None, Some(bus)) => {
                let address = gauge.address.unwrap_or(GAUGE_ADDRESS);
                let byte_writes = gauge.byte_writes;
                Self::Bus { bus, address, chip: gauge.chip, byte_writes }
            }
            (None, None, None) => unreachable!("the command line and the configuration demand a source"),
        }
    }

    /// Describes the source without the names of files.
    pub(crate) fn place(self) -> String {
        match self {
            Self::Sim { .. } => "simulated gauge".into(),
            Self::Recording(_) => "recording".into(),
            Self::Bus { .. } => self.to_string(),
        }
    }

    /// What the gauge is, where the options say so.
    pub(crate) fn chip(self) -> Option<&'static Chip> {
        match self {
            Self::Sim { chip, .. } => Some(chip),
            Self::Bus { chip, .. } => chip,
            Self::Recording(_) => None,
        }
    }
}
