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
use ti_gauge::chip::{Chip, Evidence, KeyStorage, Kind, Question, Register, Row as ParameterRow};
use ti_gauge::dataflash::Place;

const CHIPS: &str = "\
ATTRIBUTES counts the registers that feed the files of a power supply, and READ and WRITE the
parameters of data flash, keys not counted; WRITE is how many of them can be written without
--allow-unproven, because their address and range are certain. KEYS: a sealed gauge can be unsealed, or its keys changed as
well. EVIDENCE is what the table was written from and checked with: `real part` where a report of
real hardware is one of the tests. `gaugefs report` makes such a report.

With --rows, a line for each parameter of one chip: whether it can be written (`unproven` only with
--allow-unproven), and what shows that it is where it is.

Examples:
  gaugefs chips
  gaugefs chips bq34z100-g1
  gaugefs chips bq28z610 --rows";

/// List the supported gauges: what works, how far it is proven, and by what
#[derive(Args, Debug)]
#[command(after_help = CHIPS)]
pub(super) struct Chips {
    /// Show one chip in detail
    #[arg(value_name = "CHIP", value_parser = chips(), ignore_case = true, hide_possible_values = true)]
    chip: Option<&'static Chip>,
    /// Show each parameter of the chip, with what shows its place
    #[arg(long, requires = "chip")]
    rows: bool,
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
    never: usize,
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
        let is_shown = || chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security);
        let readable = || is_shown().flat_map(|subclass| subclass.parameters);
        Self {
            name: chip.name,
            model: chip.model,
            attributes: chip.registers.iter().filter(count).count(),
            data_flash: scheme(chip),
            parameters: chip.rows().count(),
            unproven: readable().filter(|parameter| parameter.unproven && parameter.never.is_none()).count(),
            never: readable().filter(|parameter| parameter.never.is_some()).count(),
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
            Some(chip) if self.rows => rows(chip, self.json),
            Some(chip) if self.json => print_json(&Row::new(chip)),
            Some(chip) => print(&details(chip)),
            None => list(self.json),
        }?;
        Ok(ExitCode::SUCCESS)
    }
}

/// A parameter of a chip, as a line of the table or an object of JSON.
#[derive(Serialize)]
struct Known {
    place: String,
    name: String,
    written: &'static str,
    /// Why it is never written.
    #[serde(skip_serializing_if = "Option::is_none")]
    never: Option<&'static str>,
    evidence: String,
}

impl Known {
    fn new(chip: &Chip, row: ParameterRow) -> Self {
        let (subclass, parameter) = row;
        let written = match parameter.never {
            Some(_) => "never",
            None if chip.has_only_names() => "no",
            None if parameter.unproven => "unproven",
            None => "yes",
        };
        let evidence = match parameter.source {
            "" => chip.documents.join(", "),
            source => source.to_string(),
        };
        let place = Place { subclass: subclass.id, offset: parameter.offset }.to_string();
        Self { place, name: chip.name_of(row), written, never: parameter.never, evidence }
    }

    fn cells(self) -> [String; 4] {
        [self.place, self.name, self.written.into(), self.evidence]
    }
}

fn rows(chip: &'static Chip, json: bool) -> Result<()> {
    let shown = chip.rows().filter(|(subclass, _)| subclass.kind != Kind::Security);
    let rows = shown.map(|row| Known::new(chip, row));
    if json {
        return print_json(&rows.collect::<Vec<_>>());
    }
    let header = ["PLACE", "NAME", "WRITTEN", "EVIDENCE"];
    print(&align(&iter::once(header.map(String::from)).chain(rows.map(Known::cells)).collect::<Vec<_>>()))
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
        true => {
            let never = row.never;
            let other = if never > 0 { format!("; {never} are never written") } else { String::new() };
            format!(
                "{} parameters in {}, {} can be written; {} are uncertain and read-only without --allow-unproven{other}",
                row.readable, row.data_flash, row.writable, row.unproven
            )
        }
    };
    let keys = match (&chip.security.storage, row.keys) {
        (KeyStorage::Fixed(why) | KeyStorage::Kept(_, why), "unseal") => {
            format!("it can be unsealed; changing keys: {why}")
        }
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
    let questions: Vec<_> = Question::all(chip)
        .map(|(question, name)| [format!("0x{:04x}", question.code()), name.into()])
        .collect();
    if !questions.is_empty() {
        section("Asked with --ask-the-pack", &align(&questions));
    }
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
        KeyStorage::Fixed(_) | KeyStorage::Kept(_, _) => "unseal",
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

    #[test]
    fn each_parameter_has_its_evidence() {
        let mut own = 0;
        for chip in Chip::all().filter(|chip| chip.has_table()) {
            let rows = || chip.rows().filter(|(subclass, _)| subclass.kind != Kind::Security);
            assert!(rows().all(|row| !Known::new(chip, row).evidence.is_empty()), "{}", chip.name);
            // A table that names the evidence of some names that of all.
            let named = rows().filter(|(_, row)| !row.source.is_empty()).count();
            assert!(named == 0 || named == rows().count(), "{}: {named}", chip.name);
            own += usize::from(named > 0);
        }
        assert!(own >= 6, "{own}");
    }

    #[test]
    fn regression_what_is_never_written_counted_as_unproven() {
        for row in Chip::all().map(Row::new) {
            assert_eq!(row.writable + row.unproven + row.never, row.readable, "{}", row.name);
        }
        let counts = |name: &str| {
            let row = Row::new(Chip::by_name(name).expect("a chip"));
            (row.readable, row.writable, row.unproven, row.never)
        };
        assert_eq!(counts("bq28z610"), (403, 16, 168, 219));
        // Only its names are known.
        assert_eq!(counts("bq27541-g1").3, 0);
    }

    #[test]
    fn a_parameter_says_whether_it_is_written_and_why_not() {
        let of = |chip: &str, name: &str| {
            let chip = Chip::by_name(chip).expect("a chip");
            Known::new(chip, chip.find(name).expect("a parameter"))
        };
        let known = of("bq28z610", "it-cfg/resistance-parameter-filter");
        assert_eq!((known.place.as_str(), known.written), ("flash/0x4594", "yes"));
        assert!(known.evidence.contains("dumps") && known.evidence.contains("range"), "{}", known.evidence);
        let fets = of("bq28z610", "configuration/fet-options");
        assert!(fets.written == "never" && fets.never.is_some_and(|why| why.contains("FETs")));
        assert_eq!(of("bq28z610", "it-cfg/qmax-delta").written, "unproven");
        assert_eq!(of("bq27541-g1", "registers/pack-configuration").written, "no");
        assert!(of("bq34z100-g1", "80/53").evidence.contains("SLUSBZ5D"));
    }
}
