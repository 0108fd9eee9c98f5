// SPDX-License-Identifier: MIT

//! `gaugefs check --for`: what a gauge should hold for a battery, and how it gets that.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use serde::Serialize;
use serde_json::Value as Json;

use super::super::batch::json;
use crate::error::{Cause, Error, Result, shown};
use gauge_bus::regular;
use gaugefs_client::Gauge;
use gaugefs_host::input::Source;
use ti_gauge::check::{Battery, Has, Plan, is_source};
use ti_gauge::chip::Row;
use ti_gauge::image::{Difference, Entry, Image};
use ti_gauge::text::unsigned;
use ti_gauge::unit;
use ti_gauge::value::Value;

/// Longer than any property of a battery.
const LONGEST: u64 = 1 << 16;

/// What a gauge should hold for a battery, for people and for --json.
#[derive(Default, Serialize)]
pub(super) struct Fitting {
    battery: String,
    rows: Vec<Differing>,
    /// Rows that hold what they should.
    fit: Vec<String>,
    unread: Vec<String>,
    steps: Vec<Left>,
    /// What gives the gauge these rows.
    command: Option<String>,
    written: bool,
}

#[derive(Serialize)]
struct Differing {
    name: String,
    old: Json,
    new: Json,
    unit: &'static str,
    /// Not by what was said of the battery, but usual for its chemistry.
    usual: bool,
    source: String,
    #[serde(skip)]
    line: String,
}

#[derive(Serialize)]
struct Left {
    step: &'static str,
    due: bool,
    text: String,
}

/// A battery in words, or in a file: TOML, the source of a device tree, or the folder of a compiled node.
pub(super) fn parse(text: &str) -> Result<Battery> {
    let path = Path::new(text);
    let refuse = |why: String| Error::new(shown(path), Cause::Invalid, why);
    if path.is_dir() {
        return Battery::from_node(&node(path)?).map_err(refuse);
    }
    let is_file = path.is_file() || text.contains('/') || text.ends_with(".toml") || text.ends_with(".dts");
    if !is_file {
        return text.parse().map_err(|why: String| Error::new("--for", Cause::Invalid, why));
    }
    let source = Source::read(path)?;
    let text = String::from_utf8_lossy(&source.bytes);
    if is_source(&text) { Battery::from_source(&text) } else { Battery::from_toml(&text) }.map_err(refuse)
}

/// The properties of a node below /sys/firmware/devicetree.
fn node(folder: &Path) -> Result<Vec<(String, Vec<u8>)>> {
    let failed = |error: std::io::Error| Error::io(shown(folder), "cannot be read", &error);
    let mut properties = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        if entry.file_type().map_err(failed)?.is_file() {
            let bytes = regular::read(&entry.path(), LONGEST).map_err(failed)?;
            properties.push((entry.file_name().to_string_lossy().into_owned(), bytes));
        }
    }
    Ok(properties)
}

/// Compares a mounted gauge with a battery, and writes what differs if it is asked to.
pub(super) fn mounted(gauge: &Gauge, battery: &Battery, write: bool) -> Result<Fitting> {
    let chip = gauge.chip()?;
    let scale = |file| gauge.text(file).ok()?.trim().parse().ok();
    let (current, energy) = (scale("gauge/current_scale"), scale("gauge/energy_scale"));
    let chem_id = gauge.text("gauge/chem_id").ok().and_then(|text| unsigned(text.trim()));
    let plan = |image: &Image| {
        let stored = |row: Row| image.entry(row).map(|entry| entry.value.clone());
        planned(battery, &Has { chip, chem_id, stored: &stored, current, energy }, gauge.folder())
    };
    let presence = gauge.presence()?;
    let rows = Battery::rows(chip);
    let found = plan(&gauge.values(chip, &rows)?)?;
    let (old, new) = images(chip, &found);
    let mut fitting = Fitting::new(battery, &found, (&old, &new))?;
    if write && !fitting.rows.is_empty() {
        gauge.apply(&presence, &old.changes(&new, &[], true)?.changes, &[])?;
        let left = plan(&gauge.values(chip, &rows)?)?;
        let (still, wanted) = images(chip, &left);
        let written = std::mem::take(&mut fitting.rows);
        fitting = Fitting::new(battery, &left, (&still, &wanted))?;
        if fitting.rows.is_empty() {
            fitting.fit.retain(|name| !written.iter().any(|row| row.name == *name));
            (fitting.written, fitting.rows) = (true, written);
        }
    }
    Ok(fitting)
}

/// Compares what is known of a gauge, or of an image, with a battery.
pub(super) fn compared(name: &str, battery: &Battery, has: &Has<'_>) -> Result<Fitting> {
    let plan = planned(battery, has, Path::new(name))?;
    let (old, new) = images(has.chip, &plan);
    Fitting::new(battery, &plan, (&old, &new))
}

fn planned(battery: &Battery, has: &Has<'_>, name: &Path) -> Result<Plan> {
    battery.plan(has).map_err(|why| Error::new(shown(name), Cause::Invalid, why))
}

/// The rows that differ, as they are and as they should be.
fn images(chip: &'static ti_gauge::chip::Chip, plan: &Plan) -> (Image, Image) {
    let (mut old, mut new) = (Image::new(chip, None), Image::new(chip, None));
    for differs in &plan.differ {
        let (subclass, parameter) = differs.row;
        let entry = |value: &Value| Entry { subclass, parameter, value: value.clone(), line: 0 };
        old.entries.push(entry(&differs.old));
        new.entries.push(entry(&differs.new));
    }
    (old, new)
}

impl Fitting {
    fn new(battery: &Battery, plan: &Plan, (old, new): (&Image, &Image)) -> Result<Self> {
        let changes = old.changes(new, &[], true)?.changes;
        let row = |change: &Difference<'_>| {
            let is_it =
                |differs: &&ti_gauge::check::Differs| std::ptr::eq(differs.row.1, change.new.parameter);
            let differs = plan.differ.iter().find(is_it).expect("a row of the plan");
            Differing {
                name: change.name.clone(),
                old: json(change.old),
                new: json(change.new),
                unit: unit::shown(change.new.parameter),
                usual: !differs.is_said,
                source: differs.source.clone(),
                line: change.to_string(),
            }
        };
        let names = |rows: &[Row]| rows.iter().map(|&row| new.chip.name_of(row)).collect();
        let set = |change: &Difference<'_>| format!(" {}={}", change.name, change.new.text());
        let assumed =
            if battery.is_assumed { " (device-chemistry is missing; lithium-ion is taken)" } else { "" };
        Ok(Self {
            battery: format!("{battery}{assumed}"),
            rows: changes.iter().map(row).collect(),
            fit: names(&plan.fit),
            unread: names(&plan.unread),
            steps: plan
                .steps
                .iter()
                .map(|step| Left { step: step.name, due: step.is_due, text: step.text.clone() })
                .collect(),
            command: (!changes.is_empty()).then(|| {
                changes.iter().map(set).fold("gaugefs set GAUGE".into(), |line: String, set| line + &set)
            }),
            written: false,
        })
    }

    /// Names the gauge in what is to be typed, as a shell takes it.
    pub(super) fn name(&mut self, gauge: &str) {
        let plain = |letter: char| letter.is_ascii_alphanumeric() || "/._+-".contains(letter);
        let gauge = match gauge.chars().all(plain) {
            true => gauge.to_string(),
            false => format!("'{}'", gauge.replace('\'', "'\\''")),
        };
        let texts = self.steps.iter_mut().map(|left| &mut left.text).chain(&mut self.command);
        texts.for_each(|text| *text = text.replace("GAUGE", &gauge));
    }

    /// Whether the gauge does not hold what it should.
    pub(super) fn is_wrong(&self) -> bool {
        !self.rows.is_empty() && !self.written || self.steps.iter().any(|left| left.due)
    }

    /// Whether some of it could not be read.
    pub(super) fn is_partly_unread(&self) -> bool {
        !self.unread.is_empty()
    }

    pub(super) fn text(&self, fix: bool) -> String {
        let mut text = format!("for {}:\n", self.battery);
        // Writing to a String does not fail.
        for Differing { line, usual, source, .. } in &self.rows {
            let word = if self.written { "written" } else { "differs" };
            let usual = if *usual { "usual for the chemistry; " } else { "" };
            let _ = writeln!(text, "{word:8}  {line}\n          {usual}{source}");
        }
        if !self.fit.is_empty() {
            let _ = writeln!(text, "fits      {}", self.fit.join(", "));
        }
        if !self.unread.is_empty() {
            let _ = writeln!(text, "unread    {}", self.unread.join(", "));
        }
        for Left { step, due, text: what } in &self.steps {
            let word = if *due { "to do" } else { "note" };
            let _ = writeln!(text, "{word:8}  {step}: {what}");
        }
        if let Some(command) = self.command.as_ref().filter(|_| fix) {
            let _ = writeln!(text, "{command}");
        }
        text
    }
}
