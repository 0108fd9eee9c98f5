// SPDX-License-Identifier: MIT

//! `gaugefs doctor`: checks this machine for problems and shows remedies.
//!
//! It only reads: files below a root folder, which tests fill, the output of systemctl, and adapters' descriptions of
//! themselves. It sends nothing on a bus unless the user names one.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use serde::Serialize;

use crate::error::Result;
use crate::output::{print, print_json};
use ti_gauge::text::printable;

mod bus;
mod config;
mod fuse;
mod host;
mod mounts;
mod rom;
mod service;

use host::Host;

const DOCTOR: &str = "\
It reads files and asks adapters for their capabilities; it sends nothing on a bus. With --bus it
reads a byte at 0x55 and at 0x0b of that bus, where a gauge in ROM mode answers. A problem
prevents some use of gaugefs, a warning is worth knowing. Exit code 0: no problem, 1: at least
one.";

/// Check this machine for problems, and show how to fix them
#[derive(Args, Debug)]
#[command(after_help = DOCTOR)]
pub(super) struct Doctor {
    /// Also look for a gauge in ROM mode on this I2C bus, such as /dev/i2c-1
    #[arg(long, value_name = "DEVICE")]
    bus: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Root folder of the system to check
    #[arg(long, value_name = "FOLDER", default_value = "/", hide = true)]
    root: PathBuf,
}

/// The severity of a finding.
#[derive(Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum State {
    Ok,
    Warning,
    Problem,
}

impl State {
    fn as_str(self) -> &'static str {
        match self {
            State::Ok => "ok",
            State::Warning => "warning",
            State::Problem => "problem",
        }
    }
}

/// All findings, for --json.
#[derive(Serialize)]
struct Report {
    findings: Vec<Finding>,
}

/// A check: its subject, its state, and the remedy.
#[derive(Serialize)]
struct Finding {
    state: State,
    what: String,
    says: String,
    remedy: Option<String>,
}

fn ok(what: impl Into<String>, says: impl Into<String>) -> Finding {
    Finding { state: State::Ok, what: what.into(), says: says.into(), remedy: None }
}

fn warning(what: impl Into<String>, says: impl Into<String>, remedy: impl Into<String>) -> Finding {
    Finding { state: State::Warning, what: what.into(), says: says.into(), remedy: Some(remedy.into()) }
}

fn problem(what: impl Into<String>, says: impl Into<String>, remedy: impl Into<String>) -> Finding {
    Finding { state: State::Problem, what: what.into(), says: says.into(), remedy: Some(remedy.into()) }
}

impl Doctor {
    pub(super) fn run(self) -> Result<ExitCode> {
        let host = Host::new(self.root);
        let configured = config::buses(&host);
        let mut findings = fuse::check(&host);
        findings.extend(bus::check(&host, &configured));
        findings.extend(mounts::check(&host));
        findings.extend(config::check(&host));
        findings.extend(service::check(&host, &configured));
        if let Some(bus) = &self.bus {
            findings.push(rom::check(bus)?);
        }
        let problems = findings.iter().any(|finding| finding.state == State::Problem);
        if self.json {
            print_json(&Report { findings })?;
        } else {
            print(&text(&findings))?;
        }
        Ok(if problems { ExitCode::FAILURE } else { ExitCode::SUCCESS })
    }
}

fn text(findings: &[Finding]) -> String {
    let mut text = String::new();
    for Finding { state, what, says, remedy } in findings {
        // Writing to a String does not fail.
        let line = printable(&format!("{what}: {says}"));
        let _ = writeln!(text, "{:7}  {line}", state.as_str());
        if let Some(remedy) = remedy {
            let _ = writeln!(text, "         {}", printable(remedy));
        }
    }
    let count = |wanted| findings.iter().filter(|finding| finding.state == wanted).count();
    let (problems, warnings) = (count(State::Problem), count(State::Warning));
    let _ = match (problems, warnings) {
        (0, 0) => writeln!(text, "\nNo problems."),
        (0, _) => writeln!(text, "\nNo problems, warnings: {warnings}."),
        _ => writeln!(text, "\nProblems: {problems}, warnings: {warnings}."),
    };
    text
}
