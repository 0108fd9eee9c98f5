//! The options of an alert, for the command line of `gaugefs watch` and for the tables `[[alert]]` of a configuration
//! file.

use std::time::Duration;

use clap::{Arg, Args, Command};
use serde::Deserialize;

use super::{from_toml, values};
use gaugefs_client::condition::Condition;

// No documentation here: clap would take it for the description of the subcommand.

#[derive(Args, Clone, Debug, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(crate) struct AlertOptions {
    /// When the alert is raised, such as 'capacity<20'
    #[arg(value_name = "CONDITION", required = false, required_unless_present = "config")]
    #[serde(deserialize_with = "from_toml::condition")]
    pub(crate) when: Condition,
    /// When it is cleared, and can be raised again [default: when CONDITION is false]
    #[arg(long, value_name = "CONDITION")]
    #[serde(default, deserialize_with = "from_toml::clear")]
    pub(crate) clear: Option<Condition>,
    /// Seconds for which CONDITION must be true in every poll [default: 0]
    #[arg(id = "for", long, value_name = "SECONDS", value_parser = values::hold)]
    #[serde(default, rename = "for", deserialize_with = "from_toml::hold")]
    pub(crate) hold: Option<Duration>,
    /// Program to run when the alert is raised, with its arguments up to a `;`; no shell
    #[arg(long, value_name = "CMD", num_args = 1.., allow_hyphen_values = true, value_terminator = ";", value_parser = word_of_program)]
    #[serde(default)]
    pub(crate) exec: Vec<String>,
    /// Program to run when it is cleared
    #[arg(long, value_name = "CMD", num_args = 1.., allow_hyphen_values = true, value_terminator = ";", value_parser = word_of_program)]
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

/// A word of a program's command line. It takes all that follows, so an option of gaugefs's own in there was most likely
/// meant for gaugefs: the program would run without the delay that somebody has asked for.
fn word_of_program(word: &str) -> Result<String, String> {
    let name = word.strip_prefix("--").map(|option| option.split('=').next().unwrap_or_default());
    let options = AlertOptions::augment_args(Command::new(""));
    let mut own = options.get_arguments().filter_map(Arg::get_long).chain(["config"]);
    match name.filter(|name| own.any(|own| own == *name)) {
        None => Ok(word.into()),
        Some(name) => Err(format!(
            "--{name} is an option of `gaugefs watch`; end CMD with `;` (in a shell, \\;) or put --{name} before it. If it \
             is meant for CMD, write sh -c 'CMD --{name} ...'"
        )),
    }
}
