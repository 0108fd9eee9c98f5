//! `gaugefs doctor`: what stands in the way on this machine, and what to do about it.
//!
//! It only looks: at files below one root folder, which a test fills as it likes, at what systemctl
//! says, and at what an adapter answers about itself. No bus is touched.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use serde::Serialize;

use super::{print, print_json};
use crate::error::Result;

mod bus;
mod config;
mod fuse;
mod host;
mod mounts;
mod service;

use host::Host;

const DOCTOR: &str = "\
It looks at files, and asks adapters what they can; nothing goes out on a bus. A problem keeps
gaugefs from something, a warning is worth knowing. Exit code 0 says that there is no problem,
1 that there is one.";

/// Tell what stands in the way on this machine, and what to do about it
#[derive(Args, Debug)]
#[command(after_help = DOCTOR)]
pub(super) struct Doctor {
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// The system to look at
    #[arg(long, value_name = "FOLDER", default_value = "/", hide = true)]
    root: PathBuf,
}

/// How bad it is.
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

/// What was looked at, how it is, and what to do.
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
        let mut findings = fuse::look(&host);
        findings.extend(bus::look(&host, &configured));
        findings.extend(mounts::look(&host));
        findings.extend(config::look(&host));
        findings.extend(service::look(&host, &configured));
        let problems = findings.iter().any(|finding| finding.state == State::Problem);
        if self.json {
            print_json(&Report { findings });
        } else {
            print(&text(&findings));
        }
        Ok(if problems { ExitCode::FAILURE } else { ExitCode::SUCCESS })
    }
}

fn text(findings: &[Finding]) -> String {
    let mut text = String::new();
    for Finding { state, what, says, remedy } in findings {
        // Writing to a String does not fail.
        let _ = writeln!(text, "{:7}  {what}: {says}", state.as_str());
        if let Some(remedy) = remedy {
            let _ = writeln!(text, "         {remedy}");
        }
    }
    let count = |wanted| findings.iter().filter(|finding| finding.state == wanted).count();
    let (problems, warnings) = (count(State::Problem), count(State::Warning));
    let _ = match (problems, warnings) {
        (0, 0) => writeln!(text, "\nNothing stands in the way."),
        (0, _) => writeln!(text, "\nNothing stands in the way; warnings: {warnings}."),
        _ => writeln!(text, "\nProblems: {problems}, warnings: {warnings}."),
    };
    text
}
