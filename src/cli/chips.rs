//! `gaugefs chips`.

use std::iter;
use std::process::ExitCode;

use clap::Args;
use serde::Serialize;

use super::{align, print, print_json};
use crate::error::Result;
use ti_gauge::chip::{Chip, Evidence, Scheme};

/// List the supported gauges and what each table is based on
#[derive(Args, Debug)]
pub(super) struct Chips {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// One chip, as a line of the table or an object of JSON.
#[derive(Serialize)]
struct Row {
    name: &'static str,
    model: &'static str,
    data_flash: &'static str,
    parameters: usize,
    unproven: usize,
    evidence: &'static str,
    documents: &'static [&'static str],
}

impl Row {
    fn new(chip: &'static Chip) -> Self {
        Self {
            name: chip.name,
            model: chip.model,
            data_flash: scheme(chip),
            parameters: parameters(chip),
            unproven: unproven(chip),
            evidence: evidence(chip.evidence),
            documents: chip.documents,
        }
    }

    fn cells(&self) -> [String; 6] {
        let document = self.documents.first().copied().unwrap_or_default();
        let (parameters, unproven) = (self.parameters.to_string(), self.unproven.to_string());
        [
            self.name.into(),
            self.data_flash.into(),
            parameters,
            unproven,
            self.evidence.into(),
            document.into(),
        ]
    }
}

impl Chips {
    pub(super) fn run(self) -> Result<ExitCode> {
        let rows: Vec<_> = Chip::all().map(Row::new).collect();
        if self.json {
            print_json(&rows);
        } else {
            let header = ["CHIP", "DATA", "PARAMETERS", "UNPROVEN", "EVIDENCE", "DOCUMENT"].map(String::from);
            let cells = rows.iter().map(Row::cells);
            print(&align(&iter::once(header).chain(cells).collect::<Vec<_>>()));
        }
        Ok(ExitCode::SUCCESS)
    }
}

fn parameters(chip: &Chip) -> usize {
    chip.subclasses.iter().map(|subclass| subclass.parameters.len()).sum()
}

/// Parameters that are read-only because their address or range is uncertain.
fn unproven(chip: &Chip) -> usize {
    let rows = chip.subclasses.iter().flat_map(|subclass| subclass.parameters);
    rows.filter(|parameter| parameter.unproven).count()
}

fn scheme(chip: &Chip) -> &'static str {
    match chip.access.scheme {
        Scheme::None => "none",
        scheme if scheme.is_ram() => "RAM",
        _ => "flash",
    }
}

fn evidence(evidence: Evidence) -> &'static str {
    match evidence {
        Evidence::Manual => "manual",
        Evidence::Transcript => "manual, transcripts",
        Evidence::Unproven => "relatives, drivers",
    }
}
