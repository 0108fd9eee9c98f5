// SPDX-License-Identifier: MIT

//! Parameters by name, with values as people write them.

use nix::errno::Errno;
use ti_gauge::chip::{Chip, Kind, Row, Unnamed};
use ti_gauge::dataflash::Place;
use ti_gauge::error::Cause;
use ti_gauge::image::{Changes, Difference, Entry, Image};
use ti_gauge::text;
use ti_gauge::unit;

use crate::error::{Error, Result};
use crate::gauge::Gauge;
use crate::names;
use crate::value::Value;
use ti_gauge::notation;

impl Gauge {
    /// Value of a parameter by name or place: `Cell Terminate Voltage`, `80/53`.
    pub fn parameter(&self, name: &str) -> Result<Value> {
        let chip = self.chip()?;
        let image = self.values(chip, &[row(chip, name)?])?;
        let entry = image.entries.first().expect("the value of that row");
        Ok(Value { text: entry.shown(), unit: unit::shown(entry.parameter) })
    }

    /// Writes and verifies a parameter: `set("Cell Terminate Voltage", "3100 mV")`. Returns when it is in data flash.
    pub fn set(&self, name: &str, value: &str) -> Result<()> {
        let mut transaction = self.transaction()?;
        transaction.set(name, value)?;
        transaction.commit().map(drop)
    }

    /// Parameters that are written together, all of them or none.
    pub fn transaction(&self) -> Result<Transaction<'_>> {
        Ok(Transaction::new(self, self.chip()?))
    }
}

/// Finds a parameter by name or place; the error suggests close names.
pub fn row(chip: &'static Chip, name: &str) -> Result<Row> {
    chip.find(name).map_err(|unnamed| match unnamed {
        Unnamed::Several(names) => {
            let why = format!("several parameters have that name; write one of {}", names.join(", "));
            ti_gauge::error::Error::new(name, Cause::Invalid, why).into()
        }
        Unnamed::Unknown => {
            let why = format!("a {} has no such parameter; {}", chip.model, meant(chip, name));
            Error::host(name, Errno::ENOENT, why)
        }
    })
}

fn meant(chip: &'static Chip, name: &str) -> String {
    const SHOWN: usize = 3;
    let file = |name: &str| format!("the file {name} of the gauge's folder");
    if names::attribute(name).is_some() {
        return format!("did you mean {}?", file(name));
    }
    let mut found: Vec<String> = chip.with_parts(name).into_iter().map(|row| chip.name_of(row)).collect();
    found.truncate(SHOWN);
    if found.is_empty() {
        found.extend(chip.nearest(name).map(|row| chip.name_of(row)));
    }
    let attributes: Vec<&str> = names::attributes().map(|attribute| attribute.name).collect();
    found.extend(
        text::with_parts(name, attributes.iter().map(|&name| (name, name))).first().map(|name| file(name)),
    );
    match &*found {
        [] => "`gaugefs get` without a name lists them".into(),
        [one] => format!("did you mean {one}?"),
        [several @ .., last] => format!("did you mean {} or {last}?", several.join(", ")),
    }
}

/// Parameters and their wanted values, checked as far as possible without the gauge.
#[derive(Clone, Debug)]
pub struct Wanted(Image);

impl Wanted {
    /// An empty set for a part.
    pub fn new(chip: &'static Chip) -> Self {
        Self(Image::new(chip, None))
    }

    /// Adds a parameter and its value, in any unit or as a date. What cannot be stored exactly is refused.
    pub fn set(&mut self, name: &str, value: &str) -> Result<()> {
        let (subclass, parameter) = row(self.0.chip, name)?;
        let name = self.0.chip.name_of((subclass, parameter));
        let refuse = |cause, why: &'static str| Err(ti_gauge::error::Error::new(&name, cause, why).into());
        if subclass.kind == Kind::Security {
            return refuse(Cause::NotPermitted, "keys are changed with `gaugefs keys change`");
        }
        let place = Place::of((subclass, parameter)).into();
        let value = notation::parse_with_unit(parameter, value);
        let value = value.map_err(|error| error.about(&name).at_place(place))?;
        let entry = Entry { subclass, parameter, value, line: 0 };
        if self.0.entries.iter().any(|other| other.is(&entry)) {
            return refuse(Cause::Invalid, "it is given twice; remove one of the two");
        }
        self.0.entries.push(entry);
        Ok(())
    }

    /// The parameters.
    pub fn rows(&self) -> Vec<Row> {
        self.0.entries.iter().map(|entry| (entry.subclass, entry.parameter)).collect()
    }

    /// The parameters and their values.
    pub fn image(&self) -> &Image {
        &self.0
    }
}

/// Parameters of a gauge that are written together, all of them or none.
#[derive(Clone, Debug)]
pub struct Transaction<'a> {
    gauge: &'a Gauge,
    wanted: Wanted,
}

/// A changed parameter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Changed {
    /// Full name, as in `df/by-name`.
    pub name: String,
    /// Previous value.
    pub old: String,
    /// Present value.
    pub new: String,
    /// Unit of both values.
    pub unit: &'static str,
}

impl<'a> Transaction<'a> {
    pub(crate) fn new(gauge: &'a Gauge, chip: &'static Chip) -> Self {
        Self { gauge, wanted: Wanted::new(chip) }
    }

    /// Adds a parameter and its value as in [`Wanted::set`]. Nothing is written yet.
    pub fn set(&mut self, name: &str, value: &str) -> Result<&mut Self> {
        self.wanted.set(name, value)?;
        Ok(self)
    }

    /// Writes and verifies what differs. After an error nothing has changed, unless the error says otherwise.
    pub fn commit(self) -> Result<Vec<Changed>> {
        let presence = self.gauge.presence()?;
        let stored = self.gauge.values(self.wanted.0.chip, &self.wanted.rows())?;
        // The mount decides whether unproven parameters may be written.
        let Changes { changes, .. } = stored.changes(&self.wanted.0, &[], true)?;
        self.gauge.apply(&presence, &changes, &[])?;
        Ok(changes.iter().map(Changed::of).collect())
    }
}

impl Changed {
    fn of(change: &Difference<'_>) -> Self {
        Self {
            name: change.name.clone(),
            old: change.old.shown(),
            new: change.new.shown(),
            unit: unit::shown(change.new.parameter),
        }
    }
}
