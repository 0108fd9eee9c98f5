// SPDX-License-Identifier: MIT

//! A report of a gauge that is not mounted: it is opened as for a mount while the report is made.

use std::path::Path;
use std::sync::Arc;

use nix::errno::Errno;

use crate::error::{Error, Result};
use crate::report;
use gauge_bus::clock::RealClock;
use gauge_owner::{GaugeOptions, Opening, Source, operations};

pub(crate) fn report(gauge: &GaugeOptions) -> Result<String> {
    // Other gaugefs processes show it as the place where the gauge is in use.
    let place = Path::new("/proc").join(std::process::id().to_string());
    let opening =
        Opening { read_only: true, no_backup: true, ..Opening::new(place, Arc::new(RealClock::new())) };
    let subject = Source::of(gauge)?.to_string();
    let ready = opening.one("report".into(), gauge)?;
    let handle = &ready.handle;
    handle.wait_for(&operations::REPORT, ()).map_err(|error| error.within(&subject))?;
    let none = || Error::host(&subject, Errno::EIO, "there is no report; try again");
    let report = handle.published().report.clone().ok_or_else(none)?;
    Ok(report::text(handle.chip(), handle.origin(), &report))
}
