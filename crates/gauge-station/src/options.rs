// SPDX-License-Identifier: MIT

//! The options of a station, which programs one pack after the other: the table `[station]` of its file.

use std::path::PathBuf;

use ti_gauge::image::Group;
use ti_gauge::{date, text};

/// The table `[station]` of a station's file.
#[derive(Clone, Debug, Default)]
// Tests write them as a file does.
#[cfg_attr(test, derive(serde::Deserialize), serde(rename_all = "kebab-case", default, deny_unknown_fields))]
pub struct Options {
    /// Name in the records; by default the file's.
    pub name: Option<String>,
    /// File with a line for each pack; by default the station's file, with the extension jsonl.
    pub record: Option<PathBuf>,
    /// Folder for an image of each pack; by default the record's file, with the extension images.
    pub images: Option<PathBuf>,
    /// Folder for journals and backups.
    pub state_dir: Option<PathBuf>,
    /// Do not save a gauge's configuration before the first write to it.
    pub no_backup: bool,

    /// Groups of the image that are not written; by default calibration, serial, keys.
    pub exclude: Option<Vec<String>>,
    /// Take only the data flash of a .bq.fs.
    pub data_flash: bool,
    /// The packs have the chemistry of a .df.fs or .bq.fs.
    pub same_chemistry: bool,

    /// Source of the serial numbers.
    pub serial: Option<SerialFrom>,
    /// First number of the counter; by default 1.
    pub first_serial: Option<i64>,
    /// The station's file has the counter's numbers in hexadecimal, so they are shown so.
    pub serial_is_hex: bool,
    /// Last number of the counter; by default the largest that fits.
    pub last_serial: Option<i64>,
    /// File with one serial number a line.
    pub serial_list: Option<PathBuf>,
    /// The parameter for the serial number; by default the one named Serial Number.
    pub serial_parameter: Option<String>,
    /// Manufacture Date: today, or YYYY-MM-DD.
    pub date: Option<String>,
    /// Pack Lot Code.
    pub pack_lot: Option<i64>,
    /// PCB Lot Code.
    pub pcb_lot: Option<i64>,

    /// Cells in series of a pack that is brought up.
    pub cells: Option<u8>,
    /// Its Voltage Divider in mV.
    pub divider: Option<u16>,
    /// Its voltage in mV.
    pub pack_voltage: Option<f64>,
    /// Calibrate the offset of the board.
    pub board_offset: bool,
    /// Calibrate the offset of the converter.
    pub cc_offset: bool,
    /// Calibrate Voltage() to this many mV.
    pub voltage: Option<f64>,
    /// Calibrate Current() to this many mA.
    pub current: Option<f64>,
    /// Calibrate Temperature() to this many degrees Celsius.
    pub temperature: Option<f64>,
    /// Tolerance of Voltage() after its calibration or the bring-up, in mV.
    pub voltage_tolerance: Option<f64>,
    /// Tolerance of Current() after its calibration, in mA.
    pub current_tolerance: Option<f64>,
    /// Tolerance of Temperature() after its calibration, in K.
    pub temperature_tolerance: Option<f64>,
    /// Tolerance of Current() without a current after the calibration of an offset, in mA.
    pub offset_tolerance: Option<f64>,

    /// Leave the packs sealed; by default true.
    pub seal: Option<bool>,
    /// Key file with the packs' new keys.
    pub new_key_file: Option<PathBuf>,
    /// How to treat a pack that was programmed before; by default refuse.
    pub seen: Option<Seen>,
    /// How to treat an interrupted write that may be another pack's; by default refuse.
    pub unsettled: Option<Unsettled>,
    /// Ask for a label of each pack.
    pub label: bool,
    /// The parameter for the label; by default only the record has it.
    pub label_parameter: Option<String>,
    /// Program to run at each outcome, with its arguments; none if that is empty.
    pub exec: Vec<String>,
    /// End the station after this many failures in a row; by default it goes on.
    pub stop_after_failures: Option<u64>,
    /// Wait after the first pack of a run until somebody has confirmed it.
    pub confirm_first: bool,
    /// Events of a rehearsal, one per simulated pack; see [`Rehearsed::parse`].
    pub rehearse: Vec<String>,
    /// Number of simulated packs; by default one per event, or 1.
    pub packs: Option<u32>,
}

/// The source of the serial numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(test, derive(serde::Deserialize), serde(rename_all = "kebab-case"))]
pub enum SerialFrom {
    /// One after the other.
    Counter,
    /// A file.
    List,
    /// Standard input, such as a barcode scanner.
    Input,
}

/// How to treat a pack that was programmed before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(test, derive(serde::Deserialize), serde(rename_all = "kebab-case"))]
pub enum Seen {
    /// Refuses it.
    #[default]
    Refuse,
    /// Programs it again; it keeps its serial number.
    Redo,
}

/// How to treat an interrupted write that may be another pack's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(test, derive(serde::Deserialize), serde(rename_all = "kebab-case"))]
pub enum Unsettled {
    /// Programs no pack until a person has settled the write.
    #[default]
    Refuse,
    /// Moves the journal of the write beside the images.
    Discard,
}

/// A simulated pack of a rehearsal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rehearsed {
    /// As the station's file says.
    Good,
    /// Taken off at that transfer after it was connected.
    Pulled(u32),
    /// Another part than the image's.
    OtherPart,
    /// Another unseal key than the station knows.
    OtherKey,
    /// Its gauge measures no voltage.
    DeadMeter,
}

impl Rehearsed {
    /// Reads one of `good`, `pulled N`, `other-part`, `other-key` and `dead-meter`. An error lists them.
    pub fn parse(word: &str) -> Result<Self, String> {
        let words: Vec<&str> = word.split_whitespace().collect();
        Ok(match words[..] {
            ["good"] => Self::Good,
            ["pulled", at] => match at.parse() {
                Ok(at @ 1..) => Self::Pulled(at),
                _ => {
                    return Err(format!(
                        "`{}`: expected a transfer, such as pulled 300",
                        text::printable(word)
                    ));
                }
            },
            ["other-part"] => Self::OtherPart,
            ["other-key"] => Self::OtherKey,
            ["dead-meter"] => Self::DeadMeter,
            _ => {
                let why = "is not an event; use good, pulled N, other-part, other-key or dead-meter";
                return Err(format!("`{}` {why}", text::printable(word)));
            }
        })
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Date {
    /// The day on which the pack is programmed.
    Today,
    /// A given day, in data flash's format.
    Day(i64),
}

/// A key with a bad value, and the reason.
pub type Refused = (&'static str, String);

impl Options {
    /// Refuses bad values and contradicting keys.
    pub fn check(&self) -> Result<(), Refused> {
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
        self.rehearsed()?;
        if self.label_parameter.is_some() && !self.label {
            return refuse("label-parameter", "set label = true too");
        }
        let offset = self.board_offset || self.cc_offset;
        let tolerances = [
            (
                "voltage-tolerance",
                self.voltage_tolerance,
                self.voltage.or(self.pack_voltage).is_some(),
                "voltage",
            ),
            ("current-tolerance", self.current_tolerance, self.current.is_some(), "current"),
            ("temperature-tolerance", self.temperature_tolerance, self.temperature.is_some(), "temperature"),
            ("offset-tolerance", self.offset_tolerance, offset, "board-offset or cc-offset"),
        ];
        for (key, tolerance, is_used, needed) in tolerances {
            match tolerance {
                Some(_) if !is_used => return refuse(key, &format!("set {needed} too")),
                Some(number) if !number.is_finite() || number < 0.0 => {
                    return refuse(key, "it must not be negative");
                }
                _ => {}
            }
        }
        match (self.cells, self.divider, self.pack_voltage) {
            (Some(0), ..) => refuse("cells", "a pack has at least one"),
            (Some(_), None, _) => refuse("cells", "set divider too"),
            (None, Some(_), _) => refuse("divider", "set cells too"),
            (None, None, Some(_)) => refuse("pack-voltage", "set cells and divider too"),
            _ if self.packs == Some(0) => refuse("packs", "at least 1"),
            _ if self.stop_after_failures == Some(0) => refuse("stop-after-failures", "at least 1"),
            _ => Ok(()),
        }
    }

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

    pub(crate) fn rehearsed(&self) -> Result<Vec<Rehearsed>, Refused> {
        self.rehearse
            .iter()
            .map(|word| Rehearsed::parse(word))
            .collect::<Result<_, _>>()
            .map_err(|why| ("rehearse", why))
    }

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
