//! `gaugefs chips`.

use std::process::ExitCode;

use clap::Args;

use super::{align, print};
use crate::chip::{CHIPS, Chip, Evidence, Scheme};
use crate::error::Result;
use crate::json;

/// List the supported gauges, and how far each has been proven
#[derive(Args, Debug)]
pub(super) struct Chips {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Chips {
    pub(super) fn run(self) -> Result<ExitCode> {
        print(&self.table());
        Ok(ExitCode::SUCCESS)
    }

    fn table(&self) -> String {
        if self.json {
            let chips = CHIPS.iter().map(|chip| {
                json::object(&[
                    ("name", json::text(chip.name)),
                    ("model", json::text(chip.model)),
                    ("data_flash", json::text(scheme(chip))),
                    ("parameters", parameters(chip).to_string()),
                    ("unproven", unproven(chip).to_string()),
                    ("evidence", json::text(evidence(chip.evidence))),
                    ("documents", json::array(chip.documents.iter().map(|document| json::text(document)))),
                ])
            });
            return json::array(chips) + "\n";
        }
        let mut rows =
            vec![["CHIP", "DATA", "PARAMETERS", "UNPROVEN", "EVIDENCE", "DOCUMENT"].map(String::from)];
        rows.extend(CHIPS.iter().map(|chip| {
            [
                chip.name.to_string(),
                scheme(chip).to_string(),
                parameters(chip).to_string(),
                unproven(chip).to_string(),
                evidence(chip.evidence).to_string(),
                chip.documents.first().copied().unwrap_or_default().to_string(),
            ]
        }));
        align(&rows)
    }
}

fn parameters(chip: &Chip) -> usize {
    chip.subclasses.iter().map(|subclass| subclass.parameters.len()).sum()
}

/// Parameters that are read-only because their address or range is not sure.
fn unproven(chip: &Chip) -> usize {
    let rows = chip.subclasses.iter().flat_map(|subclass| subclass.parameters);
    rows.filter(|parameter| parameter.unproven).count()
}

fn scheme(chip: &Chip) -> &'static str {
    match chip.access.scheme {
        Scheme::Block | Scheme::Mac => "flash",
        Scheme::CfgUpdate => "RAM",
    }
}

fn evidence(evidence: Evidence) -> &'static str {
    match evidence {
        Evidence::Manual => "manual",
        Evidence::Transcript => "manual, transcripts",
        Evidence::Unproven => "relatives, drivers",
    }
}
