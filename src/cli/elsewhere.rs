// SPDX-License-Identifier: MIT

//! Commands of another program or build, which the error names.

use std::ffi::OsString;
use std::process::ExitCode;

use clap::Args;

use crate::output::say;

/// What was typed behind such a command, whatever it is.
#[derive(Args, Debug)]
pub(super) struct Elsewhere {
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    _rest: Vec<OsString>,
}

impl Elsewhere {
    /// A command of the station.
    pub(super) fn of_station(self, name: &str) -> ExitCode {
        misuse(&format!(
            "{name}: this is `gaugefs-station {name}` now, a program that is installed together with this one"
        ))
    }

    /// A command that this build is without.
    #[cfg(any(test, not(feature = "rescue")))]
    pub(super) fn of_feature(self, name: &str) -> ExitCode {
        misuse(&format!(
            "{name}: this build is without it; the Debian package has it, and so has what cargo builds without \
             --no-default-features, or with --features {name}"
        ))
    }
}

fn misuse(line: &str) -> ExitCode {
    say(line);
    ExitCode::from(2)
}

#[cfg(test)]
mod tests {
    use clap::Command;

    use super::*;

    #[test]
    fn whatever_follows_such_a_command_is_taken() {
        let words = ["--help", "-h", "--version", "--bus=/dev/i2c-1", "x", "--", "-"];
        for count in 0..words.len() {
            let command = Elsewhere::augment_args(Command::new("x").disable_help_flag(true));
            let line = ["x"].iter().chain(&words[..count]);
            let matches = command.try_get_matches_from(line).unwrap_or_else(|error| panic!("{error}"));
            let elsewhere =
                <Elsewhere as clap::FromArgMatches>::from_arg_matches(&matches).expect("all of it");
            assert_eq!(elsewhere._rest, words[..count]);
            assert_eq!(elsewhere.of_feature("rescue"), ExitCode::from(2));
        }
    }
}
