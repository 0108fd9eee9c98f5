// SPDX-License-Identifier: MIT

//! Mounted gauges for commands, in addition to [`gaugefs_client`]: they tell which gauge was polled, and a file may
//! stand for a gauge.

use std::path::Path;

use crate::error::Result;
use crate::output::say;
use gaugefs_client::{Gauge, mounts};
use gaugefs_host::input::Source;
use ti_gauge::chip::Chip;
use ti_gauge::image::{Faults, Image, Reading};

/// Reads a mounted gauge, or a file of any format as [`Source::image`] does.
pub(super) fn open(path: &Path, chip: Option<&'static Chip>, data_flash: bool) -> Result<Image> {
    match is_mounted(path)? {
        true => whole(&Gauge::open(path)?),
        false => Source::read(path)?.image(chip, data_flash),
    }
}

/// Reads a mounted gauge or a file as far as possible, and lists all mistakes.
pub(super) fn examine(path: &Path, chip: Option<&'static Chip>, data_flash: bool) -> Result<Reading> {
    match is_mounted(path)? {
        true => {
            now(&Gauge::open(path)?).map(|image| Reading { image: Some(image), faults: Faults::default() })
        }
        false => Ok(Source::read(path)?.examine(chip, data_flash)),
    }
}

fn is_mounted(path: &Path) -> Result<bool> {
    Ok(path.is_dir() || mounts::of(&Gauge::named(path)?).is_some())
}

/// Reads a mounted gauge with the bytes of subclasses without parameters, such as a chemistry.
pub(super) fn whole(gauge: &Gauge) -> Result<Image> {
    let mut image = now(gauge)?;
    image.add_opaque(|id| gauge.raw(id))?;
    Ok(image)
}

/// Polls a mounted gauge and reads its configuration anew.
pub(super) fn now(gauge: &Gauge) -> Result<Image> {
    poll(gauge)?;
    Ok(gauge.configuration()?)
}

/// Polls a mounted gauge, and prints on standard error which gauge it is.
pub(super) fn poll(gauge: &Gauge) -> Result<()> {
    let polled = gauge.poll()?;
    say(format_args!("gauge {}: {polled}", gauge.folder().display()));
    Ok(())
}
