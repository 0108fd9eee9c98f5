//! The options of a station, which programs one pack after the other: the table `[station]` of its file.

use std::path::{Path, PathBuf};

use super::file::{self, File, Head};
use super::make_absolute;
use super::option::At;
use super::options::{GaugeOptions, SerialFrom, StationOptions};
use crate::error::{Cause, Error, Result};
use ti_gauge::image::Group;
use ti_gauge::{date, text};

/// A manufacture date.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Date {
    /// The day on which the pack is programmed.
    Today,
    /// A given day, as data flash has it.
    Day(i64),
}

/// A key with a bad value, and the reason.
type Refused = (&'static str, String);

impl StationOptions {
    /// Refuses bad values, and keys that do not belong together.
    pub(super) fn check(&self) -> Result<(), Refused> {
        let refuse = |key, why: &str| Err((key, why.to_string()));
        self.groups()?;
        self.date()?;
        match (self.serial, &self.serial_list) {
            (Some(SerialFrom::List), None) => return refuse("serial", "set serial-list too"),
            (Some(SerialFrom::List), _) | (_, None) => {}
            (_, Some(_)) => return refuse("serial-list", "only with serial = \"list\""),
        }
        let is_counter = self.serial == Some(SerialFrom::Counter);
        for (key, number) in [("first-serial", self.first_serial), ("last-serial", self.last_serial)] {
            match number {
                Some(_) if !is_counter => return refuse(key, "only with serial = \"counter\""),
                Some(..0) => return refuse(key, "it must not be negative"),
                _ => {}
            }
        }
        if self.last_serial.is_some_and(|last| last < self.first_serial.unwrap_or(1)) {
            return refuse("last-serial", "it is below first-serial");
        }
        if self.serial.is_none() && self.serial_parameter.is_some() {
            return refuse("serial-parameter", "set serial too");
        }
        match (self.cells, self.divider, self.pack_voltage) {
            (Some(0), ..) => refuse("cells", "a pack has at least one"),
            (Some(_), None, _) => refuse("cells", "set divider too"),
            (None, Some(_), _) => refuse("divider", "set cells too"),
            (None, None, Some(_)) => refuse("pack-voltage", "set cells and divider too"),
            _ if self.packs == Some(0) => refuse("packs", "at least 1"),
            _ => Ok(()),
        }
    }

    /// The groups of the image that are not written.
    pub(crate) fn groups(&self) -> Result<Vec<Group>, Refused> {
        let Some(names) = &self.exclude else {
            return Ok(vec![Group::Calibration, Group::Serial, Group::Keys]);
        };
        let group = |name: &String| {
            let found = Group::NAMES.iter().find(|(known, _)| known == name);
            found.map(|(_, group)| *group).ok_or_else(|| {
                let known = Group::NAMES.map(|(known, _)| known).join(", ");
                ("exclude", format!("`{}` is none of: {known}", text::printable(name)))
            })
        };
        names.iter().map(group).collect()
    }

    /// The manufacture date.
    pub(crate) fn date(&self) -> Result<Option<Date>, Refused> {
        let date = |text: &String| match text.as_str() {
            "today" => Ok(Date::Today),
            text => {
                let refused = || ("date", "expected today or YYYY-MM-DD, from 1980 on".to_string());
                date::parse(text).map(Date::Day).ok_or_else(refused)
            }
        };
        self.date.as_ref().map(date).transpose()
    }
}

impl Head for StationOptions {
    const NAME: &'static str = "station";
    const LISTS: &'static [&'static str] = &["gauge"];
    const GAUGES: Option<At> = Some(At::Station);
}

/// Reads the options of a station and of its gauges.
fn read_options(path: &Path) -> Result<(StationOptions, Vec<GaugeOptions>)> {
    let text = file::text(path)?;
    let file = File::<StationOptions>::parse(path, &text)?;
    let mut read = file.read()?;
    make_absolute(&mut read.head, file::folder(path))?;
    read.head.check().map_err(|(key, why)| match file.place(key) {
        Some(at) => file.refuse(at, key, &why),
        None => Error::new(format!("{}: {key}", file.name), Cause::Invalid(why)),
    })?;
    Ok((read.head, file.complete(read.gauges, path, None)?))
}

/// The settings of `gaugefs program`. All paths are absolute.
#[derive(Clone, Debug)]
pub(crate) struct StationSetup {
    pub(crate) station: StationOptions,
    /// Each has a source: it is simulated or on a bus.
    pub(crate) gauges: Vec<GaugeOptions>,
    pub(crate) name: String,
    /// Its file, for messages.
    pub(crate) file: String,
    pub(crate) record: PathBuf,
    pub(crate) images: PathBuf,
}

impl StationSetup {
    /// Reads the file of a station.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let mut path = path.to_path_buf();
        super::absolute(&mut path, Path::new(""))?;
        let (station, gauges) = read_options(&path)?;
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let record = station.record.clone().unwrap_or_else(|| path.with_extension("jsonl"));
        let images = station.images.clone().unwrap_or_else(|| record.with_extension("images"));
        let file = path.display().to_string();
        Ok(Self { file, name: station.name.clone().unwrap_or(stem), station, gauges, record, images })
    }
}
