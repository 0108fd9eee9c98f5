//! A report of a gauge that is not mounted: it is opened, as for a mount, for as long as the report takes.

use std::path::Path;
use std::sync::Arc;

use nix::errno::Errno;

use super::gauges::Opening;
use crate::config::{GaugeOptions, Source};
use crate::error::{Error, Result};
use crate::owner::operations;
use crate::report;
use gauge_bus::clock::RealClock;

/// The text of a report of the gauge.
pub(crate) fn report(gauge: GaugeOptions) -> Result<String> {
    let opening = Opening {
        // Another gaugefs shows it as the place where the gauge is in use.
        mountpoint: Path::new("/proc").join(std::process::id().to_string()),
        clock: Arc::new(RealClock::new()),
        signal: Arc::default(),
        read_only: true,
        no_backup: true,
        state_dir: None,
    };
    let subject = Source::of(&gauge).to_string();
    let ready = opening.one("report".into(), gauge)?;
    let handle = ready.entry.handle.clone();
    handle.wait_for(&operations::REPORT, ()).map_err(|error| error.within(&subject))?;
    let none = || Error::host(&subject, Errno::EIO, "there is no report; try again");
    let report = handle.published().report.clone().ok_or_else(none)?;
    Ok(report::text(handle.chip(), handle.origin(), &report))
}
