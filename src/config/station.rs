//! The options of a station, which programs one pack after the other: the table `[station]` of its file.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::Deserialize;

use super::file::{self, File, Head, Table};
use super::{GaugeOptions, from_toml, make_absolute};
use crate::error::{Cause, Error, Result};
use ti_gauge::image::Group;
use ti_gauge::{date, text};

// No documentation on the struct, as in `config`. It derives Args for the names of its keys only.

#[derive(Args, Clone, Debug, Default, Deserialize)]
#[serde(rename_all = "kebab-case", default, deny_unknown_fields)]
pub(crate) struct StationOptions {
    /// Name in the records [default: the file's]
    pub(crate) name: Option<String>,
    /// File with a line for each pack [default: the station's file, with the extension jsonl]
    pub(crate) record: Option<PathBuf>,
    /// Folder for an image of each pack [default: the record's file, with the extension images]
    pub(crate) images: Option<PathBuf>,
    /// Folder for journals and backups
    pub(crate) state_dir: Option<PathBuf>,
    /// Do not save a gauge's configuration before the first write to it
    #[arg(long)]
    pub(crate) no_backup: bool,

    /// Groups of the image that are not written [default: calibration, serial, keys]
    pub(crate) exclude: Option<Vec<String>>,
    /// Take only the data flash of a .bq.fs
    #[arg(long)]
    pub(crate) data_flash: bool,
    /// The packs have the chemistry of a .df.fs or .bq.fs
    #[arg(long)]
    pub(crate) same_chemistry: bool,

    /// Source of the serial numbers
    #[arg(value_enum)]
    pub(crate) serial: Option<SerialFrom>,
    /// First number of the counter [default: 1]
    pub(crate) first_serial: Option<i64>,
    /// Last number of the counter [default: the largest that fits]
    pub(crate) last_serial: Option<i64>,
    /// File with one serial number a line
    pub(crate) serial_list: Option<PathBuf>,
    /// The parameter that holds it [default: the one named Serial Number]
    pub(crate) serial_parameter: Option<String>,
    /// Manufacture Date: today, or YYYY-MM-DD
    pub(crate) date: Option<String>,
    /// Pack Lot Code
    pub(crate) pack_lot: Option<i64>,
    /// PCB Lot Code
    pub(crate) pcb_lot: Option<i64>,

    /// Cells in series of a pack that is brought up
    pub(crate) cells: Option<u8>,
    /// Its Voltage Divider in mV
    #[serde(deserialize_with = "from_toml::divider")]
    pub(crate) divider: Option<u16>,
    /// Its voltage in mV
    #[serde(deserialize_with = "from_toml::pack_voltage")]
    pub(crate) pack_voltage: Option<f64>,
    /// Calibrate the offset of the board
    #[arg(long)]
    pub(crate) board_offset: bool,
    /// Calibrate the offset of the converter
    #[arg(long)]
    pub(crate) cc_offset: bool,
    /// Calibrate Voltage() to that many mV
    #[serde(deserialize_with = "from_toml::pack_voltage")]
    pub(crate) voltage: Option<f64>,
    /// Calibrate Current() to that many mA
    #[serde(deserialize_with = "from_toml::meter_current")]
    pub(crate) current: Option<f64>,
    /// Calibrate Temperature() to that many degrees Celsius
    #[serde(deserialize_with = "from_toml::celsius")]
    pub(crate) temperature: Option<f64>,

    /// Leave the packs sealed [default: true]
    pub(crate) seal: Option<bool>,
    /// Key file with the keys that the packs get
    pub(crate) new_key_file: Option<PathBuf>,
    /// How to treat a pack that was programmed before [default: refuse]
    #[arg(value_enum)]
    pub(crate) seen: Option<Seen>,
    /// How to treat an interrupted write that may have been another pack's [default: refuse]
    #[arg(value_enum)]
    pub(crate) unsettled: Option<Unsettled>,
    /// How many simulated packs come one after the other [default: 1]
    pub(crate) packs: Option<u32>,
}

/// The source of the serial numbers.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum SerialFrom {
    /// One after the other.
    Counter,
    /// A file.
    List,
    /// Standard input, such as a barcode scanner.
    Input,
}

/// How to treat a pack that was programmed before.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Seen {
    /// Refuses it.
    #[default]
    Refuse,
    /// Programs it again; it keeps its serial number.
    Redo,
}

/// How to treat an interrupted write that may have been another pack's.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Unsettled {
    /// Programs no pack until a person has settled the write.
    #[default]
    Refuse,
    /// Moves the journal of the write beside the images.
    Discard,
}

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
    pub(super) fn paths(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        let Self { record, images, state_dir, serial_list, new_key_file, .. } = self;
        [record, images, state_dir, serial_list, new_key_file].into_iter().flatten()
    }

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

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct OfStation {
    station: StationOptions,
}

/// Keys of gauges that make no sense for a station.
const NOT_AT_A_STATION: [&str; 10] = [
    "replay",
    "restore",
    "poll",
    "energy",
    "absolute-current",
    "current-scale",
    "voltage-scale",
    "energy-scale",
    "allow-learning",
    "trace",
];

/// Reads the options of a station and of its gauges.
fn read_options(path: &Path) -> Result<(StationOptions, Vec<GaugeOptions>)> {
    let text = file::text(path)?;
    let head = Head::of::<StationOptions>("station", &["gauge"]);
    let (file, OfStation { mut station }, gauges) = File::read::<OfStation>(path, &text, head)?;
    make_absolute(station.paths(), file::folder(path))?;
    station.check().map_err(|(key, why)| match file.place(Table::Head, key) {
        Some(place) => file.refuse(place.at, key, &why),
        None => Error::new(format!("{}: {key}", file.name), Cause::Invalid(why)),
    })?;
    for number in 0..gauges.gauge.len() {
        let not_here = NOT_AT_A_STATION.iter();
        let mut places = not_here
            .filter_map(|key| file.place(Table::Gauge(number), key).or(file.place(Table::Defaults, key)));
        if let Some(place) = places.next() {
            return Err(file.refuse(place.at, &place.key, "has no meaning at a station; remove it"));
        }
    }
    Ok((station, file.gauges(gauges, path, None)?))
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
        make_absolute([&mut path].into_iter(), Path::new(""))?;
        let (station, gauges) = read_options(&path)?;
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let record = station.record.clone().unwrap_or_else(|| path.with_extension("jsonl"));
        let images = station.images.clone().unwrap_or_else(|| record.with_extension("images"));
        let file = path.display().to_string();
        Ok(Self { file, name: station.name.clone().unwrap_or(stem), station, gauges, record, images })
    }
}
