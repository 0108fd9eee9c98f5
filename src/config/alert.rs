//! The options of an alert, for the command line of `gaugefs watch` and for the tables `[[alert]]` of a configuration
//! file.

use std::time::Duration;

use clap::Args;
use serde::Deserialize;

use super::{from_toml, values};
use crate::condition::Condition;

// No documentation here: clap would take it for the description of the subcommand.

#[derive(Args, Clone, Debug, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(crate) struct AlertOptions {
    /// When the alert is raised, such as 'capacity<20'
    #[arg(value_name = "CONDITION", required = false, required_unless_present = "config")]
    pub(crate) when: Condition,
    /// When it is cleared, and can be raised again [default: when CONDITION is false]
    #[arg(long, value_name = "CONDITION")]
    #[serde(default)]
    pub(crate) clear: Option<Condition>,
    /// Seconds for which CONDITION must be true in every poll [default: 0]
    #[arg(id = "for", long, value_name = "SECONDS", value_parser = values::hold)]
    #[serde(default, rename = "for", deserialize_with = "from_toml::hold")]
    pub(crate) hold: Option<Duration>,
    /// Program to run when the alert is raised, with its arguments up to a `;`; no shell
    #[arg(long, value_name = "CMD", num_args = 1.., allow_hyphen_values = true, value_terminator = ";")]
    #[serde(default)]
    pub(crate) exec: Vec<String>,
    /// Program to run when it is cleared
    #[arg(long, value_name = "CMD", num_args = 1.., allow_hyphen_values = true, value_terminator = ";")]
    #[serde(default)]
    pub(crate) exec_clear: Vec<String>,
    /// Name of the alert in messages [default: its condition]
    #[arg(long, value_name = "NAME")]
    #[serde(default)]
    pub(crate) name: Option<String>,
    /// Folder of the only gauge that it is for
    #[arg(skip)]
    #[serde(default, deserialize_with = "from_toml::name")]
    pub(crate) gauge: Option<String>,
}

impl AlertOptions {
    /// What it is called.
    pub(crate) fn shown(&self) -> String {
        self.name.clone().unwrap_or_else(|| self.when.to_string())
    }

    /// The files that it compares.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.when.names().chain(self.clear.iter().flat_map(Condition::names))
    }
}
