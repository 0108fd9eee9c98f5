// SPDX-License-Identifier: MIT

//! `gaugefs chips`.

use std::fmt::Write as _;
use std::iter;
use std::process::ExitCode;

use clap::Args;
use serde::Serialize;

use super::align;
use crate::config::chips;
use crate::error::Result;
use crate::output::{print, print_json};
use gauge_sim::Sim;
use ti_gauge::chip::{Chip, Evidence, KeyStorage, Kind, Register};

const CHIPS: &str = "\
ATTRIBUTES counts the registers that feed the files of a power supply, and READ and WRITE the
parameters of data flash, keys not counted; WRITE is how many of them can be written without
--allow-unproven, because their address and range are certain. KEYS: a sealed gauge can be unsealed, or its keys changed as
well. EVIDENCE is what the table was written from and checked with: `real part` where a report of
real hardware is one of the tests. `gaugefs report` makes such a report.

Examples:
  gaugefs chips
  gaugefs chips bq34z100-g1";

/// List the supported gauges: what works, how far it is proven, and by what
#[derive(Args, Debug)]
#[command(after_help = CHIPS)]
pub(super) struct Chips {
    /// Show one chip in detail
    #[arg(value_name = "CHIP", value_parser = chips(), ignore_case = true, hide_possible_values = true)]
    chip: Option<&'static Chip>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// A chip, as a line of the table or an object of JSON.
#[derive(Serialize)]
struct Row {
    name: &'static str,
    model: &'static str,
    attributes: usize,
    data_flash: &'static str,
    parameters: usize,
    unproven: usize,
    readable: usize,
    writable: usize,
    keys: &'static str,
    authentication: bool,
    simulated: bool,
    evidence: Vec<&'static str>,
    documents: &'static [&'static str],
}

impl Row {
    fn new(chip: &'static Chip) -> Self {
        let count = |register: &&Register| register.role.is_some();
        let all = || chip.subclasses.iter().flat_map(|subclass| subclass.parameters);
        let is_shown = || chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security);
        let readable = || is_shown().flat_map(|subclass| subclass.parameters);
        Self {
            name: chip.name,
            model: chip.model,
            attributes: chip.registers.iter().filter(count).count(),
            data_flash: scheme(chip),
            parameters: all().count(),
            unproven: all().filter(|parameter| parameter.unproven).count(),
            readable: readable().count(),
            writable: readable().filter(|parameter| !parameter.unproven).count(),
            keys: keys(chip),
            authentication: chip.authentication.is_some(),
            simulated: Sim::knows(chip.name),
            evidence: chip.evidence.iter().map(|evidence| evidence.as_str()).collect(),
            documents: chip.documents,
        }
    }

    fn cells(&self) -> [String; 9] {
        [
            self.name.into(),
            self.attributes.to_string(),
            self.data_flash.into(),
            self.readable.to_string(),
            self.writable.to_string(),
            self.keys.into(),
            yes(self.authentication).into(),
            yes(self.simulated).into(),
            self.evidence.join(", "),
        ]
    }
}

impl Chips {
    pub(super) fn run(self) -> Result<ExitCode> {
        match self.chip {
            Some(chip) if self.json => print_json(&Row::new(chip)),
            Some(chip) => print(&details(chip)),
            None => list(self.json),
        }?;
        Ok(ExitCode::SUCCESS)
    }
}

fn list(json: bool) -> Result<()> {
    let rows: Vec<_> = Chip::all().map(Row::new).collect();
    if json {
        return print_json(&rows);
    }
    let header = ["CHIP", "ATTRIBUTES", "DATA", "READ", "WRITE", "KEYS", "AUTH", "SIMULATED", "EVIDENCE"];
    let cells = rows.iter().map(Row::cells);
    print(&align(&iter::once(header.map(String::from)).chain(cells).collect::<Vec<_>>()))
}

fn details(chip: &'static Chip) -> String {
    let row = Row::new(chip);
    let flash = match chip.has_table() {
        false => "none: it is only read".to_string(),
        true if chip.has_only_names() => format!(
            "{} parameters in {} are read by their names; not one is proven, so nothing is written, whatever is allowed",
            row.readable, row.data_flash
        ),
        true => format!(
            "{} parameters in {}, {} can be written; {} are uncertain and read-only without --allow-unproven",
            row.readable,
            row.data_flash,
            row.writable,
            row.readable - row.writable
        ),
    };
    let keys = match (&chip.security.storage, row.keys) {
        (KeyStorage::Fixed(why), "unseal") => format!("it can be unsealed; changing keys: {why}"),
        (_, "unseal, change") => "it can be unsealed, and its keys changed".to_string(),
        _ => "none".to_string(),
    };
    let lines = [
        ["attributes".to_string(), format!("{} registers feed the files of a power supply", row.attributes)],
        ["data flash".to_string(), flash],
        ["keys".to_string(), keys],
        ["authentication".to_string(), yes(row.authentication).to_string()],
        ["simulated".to_string(), yes(row.simulated).to_string()],
    ];
    let evidence = chip.evidence.iter().map(|one| [one.as_str().to_string(), one.meaning().to_string()]);
    let mut text = format!("{}\n", chip.model);
    let mut section = |title: &str, table: &str| {
        // Writing to a String does not fail.
        let _ = writeln!(text, "\n{title}:");
        for line in table.lines() {
            let _ = writeln!(text, "  {line}");
        }
    };
    section("What works", &align(&lines));
    section("How far it is proven", &align(&evidence.collect::<Vec<_>>()));
    if !chip.evidence.contains(&Evidence::RealPart) {
        section("Not proven", "on a real part: no report of one has come in; see `gaugefs report --help`");
    }
    let beliefs: Vec<_> =
        chip.beliefs().map(|belief| [belief.name, belief.holds].map(String::from)).collect();
    if !beliefs.is_empty() {
        section("Not confirmed (docs/BELIEFS.md)", &align(&beliefs));
    }
    section("Documents", &chip.documents.join("\n"));
    text
}

fn yes(is: bool) -> &'static str {
    if is { "yes" } else { "no" }
}

fn keys(chip: &Chip) -> &'static str {
    match chip.security.storage {
        _ if !chip.has_table() => "none",
        KeyStorage::Fixed(_) => "unseal",
        KeyStorage::Flash(_) => "unseal, change",
    }
}

fn scheme(chip: &Chip) -> &'static str {
    match chip.access.scheme.is_ram() {
        _ if !chip.has_table() => "none",
        true => "RAM",
        false => "flash",
    }
}

#[cfg(test)]
mod tests {
    use ti_gauge::chip::BELIEFS;

    use super::*;

    /// After an intended change, run it once with GAUGEFS_GOLDEN=write.
    #[test]
    fn the_page_of_beliefs_is_the_list() {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/BELIEFS.md");
        let page = std::fs::read_to_string(&path).expect("the page");
        let (head, table) = page.split_once("\n| belief |").expect("a table");
        let (_, after) = table.split_once("\n\n").expect("what was found");
        let mut now = format!(
            "{head}\n| belief | of | what would decide it | if it is otherwise |\n| --- | --- | --- | --- |\n"
        );
        for belief in BELIEFS {
            let (name, parts, holds) = (belief.name, belief.parts, belief.holds);
            let (decided_by, otherwise) = (belief.decided_by, belief.otherwise);
            writeln!(now, "| **{name}**: {holds} | {parts} | {decided_by} | {otherwise} |")
                .expect("a string");
        }
        write!(now, "\n{after}").expect("a string");
        if std::env::var_os("GAUGEFS_GOLDEN").is_some_and(|what| what == "write") {
            std::fs::write(&path, now).expect("the page");
            return;
        }
        assert!(now == page, "docs/BELIEFS.md differs; if that is intended, GAUGEFS_GOLDEN=write\n{now}");
    }

    #[test]
    fn what_is_not_confirmed_is_shown_for_its_parts() {
        let shows = |chip: &str, name: &str| {
            let text = details(Chip::by_name(chip).expect("a chip"));
            text.lines().any(|line| line.trim_start().starts_with(name))
        };
        for (name, of, not) in [
            ("unit of Board Offset", "bq34z100-g1", "bq34110"),
            ("voltage of the gate", "bq34110", "bq27441-g1"),
            ("[VOLTSEL] times 5", "bq34z100-g1", "bq34z100-r2"),
            ("Voltage() before the first", "bq27541", "bq27220"),
            ("RESET", "bq27426", "bq27541"),
            ("commits of MACData()", "bq27220", "bq27520-g3"),
            ("order of the scales", "bq34z100-r2", "bq34z100-g1"),
            ("addresses as printed", "bq35100", "bq27220"),
        ] {
            assert!(shows(of, name) && !shows(not, name), "{name}: {of}, {not}");
        }
    }
}
