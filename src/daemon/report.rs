//! A report of a gauge that is not mounted: it is opened, as for a mount, for as long as the report takes.

use std::path::Path;
use std::sync::{Arc, mpsc};

use nix::errno::Errno;

use super::gauges::Opening;
use crate::config::{GaugeOptions, Source};
use crate::error::{Error, Result};
use crate::owner::Request;
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
    let (done, outcome) = mpsc::channel();
    handle.submit(Request::Report(Box::new(move |answer| {
        // If nobody waits any more, the process ends.
        let _ = done.send(answer);
    })));
    let ended = || Error::host(&subject, Errno::EIO, "its thread has ended");
    outcome.recv().map_err(|_| ended())?.map_err(|error| error.within(&subject))?;
    let report = handle.published().report.clone().ok_or_else(ended)?;
    Ok(report::text(handle.chip(), handle.origin(), &report))
}
