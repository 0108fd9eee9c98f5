// SPDX-License-Identifier: MIT

//! The command line of `gaugefs`: the parser and the dispatch. Each command has a file of its own.

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::command::{self, align};
use crate::daemon::{background, service};
use crate::error::Result;
use crate::output::say_error;
use gauge_owner::key_file;

mod assignment;
mod auth;
mod batch;
mod bringup;
mod calibrate;
mod capacity;
mod check;
mod chips;
mod completions;
mod diff;
mod doctor;
mod elsewhere;
mod export;
mod get;
mod import;
mod keys;
mod learned;
mod lint;
mod list;
mod manual;
mod mount;
mod mounted;
mod names;
mod probe;
mod report;
#[cfg(feature = "rescue")]
mod rescue;
mod set;
mod settle;
mod sim;
mod umount;
mod unmounted;
#[cfg(feature = "screen")]
mod watch;

const EXAMPLES: &str = "\
Examples:
  gaugefs mount --sim bq34z100-g1 /tmp/gauges     a simulated gauge
  cat /tmp/gauges/BAT0/voltage_now                its voltage in microvolts
  gaugefs umount /tmp/gauges

  gaugefs set --help                              the options of a command
  gaugefs man | man -l -                          all of it, and a glossary

  gaugefs probe --bus /dev/i2c-1                  scan a bus for gauges
  gaugefs mount --bus /dev/i2c-1 ~/gauges         mount it, for you alone
  sudo gaugefs mount --bus /dev/i2c-1 /run/gauges     for all users to read";

/// Mounts TI battery fuel gauges as a Linux power_supply tree, data flash included
#[derive(Debug, Parser)]
#[command(name = "gaugefs", version, after_help = EXAMPLES, max_term_width = 100, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
#[command(defer = true)]
enum Command {
    Mount(Box<mount::Mount>),
    // An alias is needed before the command's definition is made.
    #[command(visible_alias = "unmount")]
    Umount(umount::Umount),
    List(list::List),
    Sim(sim::Sim),
    Probe(probe::Probe),
    #[cfg(feature = "rescue")]
    Rescue(rescue::Rescue),
    Chips(chips::Chips),
    Report(report::Report),
    Check(check::Check),
    Get(get::Get),
    Set(set::Set),
    Export(export::Export),
    Import(import::Import),
    Diff(diff::Diff),
    Lint(lint::Lint),
    Settle(settle::Settle),
    Learned(learned::Learned),
    Bringup(bringup::BringUp),
    Calibrate(calibrate::Calibrate),
    Auth(auth::Auth),
    Keys(keys::Command),
    #[cfg(feature = "screen")]
    #[command(flatten)]
    Screen(gaugefs_screen::Command),
    #[cfg(feature = "screen")]
    Watch(watch::Watch),
    Doctor(doctor::Doctor),
    Completions(completions::Completions),
    Man(manual::Man),
    Attach(Box<mount::Attach>),
    SimInside(sim::Inside),
    SimEnd(sim::End),
    /// Remove the mounts of services that have ended; systemd's units run it as root
    Detach,
    /// Check that nobody else may read the key file of a service; systemd's units run it as root
    #[command(hide = true)]
    CheckKeys {
        /// The key file
        file: PathBuf,
    },
    Names(names::Names),
    /// A command of gaugefs-station
    #[command(hide = true, disable_help_flag = true)]
    Program(elsewhere::Elsewhere),
    /// A command of gaugefs-station
    #[command(hide = true, disable_help_flag = true)]
    Records(elsewhere::Elsewhere),
    /// A command of other builds
    #[cfg(not(feature = "rescue"))]
    #[command(hide = true, disable_help_flag = true)]
    Rescue(elsewhere::Elsewhere),
}

impl Command {
    fn run(self) -> Result<ExitCode> {
        match self {
            Self::Mount(command) => command.run(),
            Self::Umount(command) => command.run(),
            Self::List(command) => command.run(),
            Self::Sim(command) => command.run(),
            Self::SimInside(command) => command.run(),
            Self::SimEnd(command) => command.run(),
            Self::Probe(command) => command.run(),
            #[cfg(feature = "rescue")]
            Self::Rescue(command) => command.run(),
            Self::Chips(command) => command.run(),
            Self::Report(command) => command.run(),
            Self::Check(command) => command.run(),
            Self::Get(command) => command.run(),
            Self::Set(command) => command.run(),
            Self::Export(command) => command.run(),
            Self::Import(command) => command.run(),
            Self::Diff(command) => command.run(),
            Self::Lint(command) => command.run(),
            Self::Settle(command) => command.run(),
            Self::Learned(command) => command.run(),
            Self::Bringup(command) => command.run(),
            Self::Calibrate(command) => command.run(),
            Self::Auth(command) => command.run(),
            Self::Keys(command) => command.run(),
            #[cfg(feature = "screen")]
            Self::Screen(command) => command.run(),
            #[cfg(feature = "screen")]
            Self::Watch(command) => command.run(),
            Self::Doctor(command) => command.run(),
            Self::Completions(command) => command.run(),
            Self::Man(command) => command.run(),
            Self::Attach(command) => command.run(),
            Self::Detach => service::detach().map(|()| ExitCode::SUCCESS),
            Self::CheckKeys { file } => key_file::check(&file).map(|()| ExitCode::SUCCESS),
            Self::Names(command) => command.run(),
            Self::Program(command) => Ok(command.of_station("program")),
            Self::Records(command) => Ok(command.of_station("records")),
            #[cfg(not(feature = "rescue"))]
            Self::Rescue(command) => Ok(command.of_feature("rescue")),
        }
    }
}

/// Commands by purpose. Commands without a group come last.
const GROUPS: [(&str, &[&str]); 5] = [
    ("Mount", &["mount", "umount", "list", "sim"]),
    (
        "Look",
        &[
            "top", "get", "export", "diff", "lint", "log", "plot", "learn", "wait", "probe", "chips",
            "report", "check", "doctor",
        ],
    ),
    ("Write", &["set", "import", "settle", "learned", "calibrate", "bringup", "keys", "rescue"]),
    ("Factory", &["auth"]),
    ("Service", &["watch", "metrics", "events", "detach", "completions", "man"]),
];

/// The definition of the command line, whose prose has the terminal's width.
pub fn definition() -> clap::Command {
    command::definition::<Cli>(&GROUPS)
}

/// Runs the command in the arguments. The exit code is 0 for done, 1 for failed, 2 for misuse.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let arguments: Vec<_> = arguments.into_iter().collect();
    if background::is_asked(&arguments) {
        return command::ended(background::start(arguments));
    }
    command::run(&GROUPS, arguments, |cli: Cli| cli.command.run())
}

/// `1 parameter` or `N parameters`.
fn counted(parameters: usize) -> String {
    if parameters == 1 { "1 parameter".into() } else { format!("{parameters} parameters") }
}

/// Exit code of a command that has left something out and listed it on standard error.
const PASSED_OVER: u8 = 3;

/// diff(1)'s exit codes: a failure is 2, so that scripts can tell it from a difference.
fn trouble(outcome: Result<ExitCode>) -> Result<ExitCode> {
    outcome.or_else(|error| {
        say_error(&error);
        Ok(ExitCode::from(2))
    })
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;
    use clap_complete::Shell;

    use super::*;
    #[cfg(feature = "screen")]
    use crate::config::AlertOptions;
    use crate::config::{At, MountOptions, Options};
    use gauge_owner::GaugeOptions;

    #[test]
    fn clap_accepts_the_definition() {
        definition().debug_assert();
    }

    /// The options of all commands took nine tenths of the program's start.
    #[test]
    fn a_start_makes_no_options_of_other_commands() {
        let command = Cli::command();
        for command in command.get_subcommands() {
            assert_eq!(command.get_arguments().count(), 0, "{}", command.get_name());
        }
    }

    #[test]
    fn every_command_is_in_one_group_of_the_help() {
        let command = definition();
        let names: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| *names).copied().collect();
        let is_listed = |command: &&clap::Command| !command.is_hide_set() && command.get_name() != "help";
        for shown in command.get_subcommands().filter(is_listed) {
            let count = names.iter().filter(|name| **name == shown.get_name()).count();
            assert_eq!(count, 1, "{}", shown.get_name());
        }
        let help = command.clone().render_help().to_string();
        let headings = ["Mount:", "Look:", "Write:", "Factory:", "Service:", "Options:", "Examples:"];
        let found: Vec<&str> = help.lines().filter(|line| headings.contains(line)).collect();
        assert_eq!(found, headings, "{help}");
        assert!(help.lines().all(|line| line.chars().count() <= 80), "{help}");
    }

    /// Where the options of a table must be found, by the command that has them.
    fn check<T: Options>(command: &str) {
        let pages = [manual::program(Cli::command()), manual::file()].map(|page| page.replace("\\-", "-"));
        let [program, file] = &pages;
        let (_, section) = program.split_once(&format!(".SS \"gaugefs {command}\"\n")).expect("a section");
        let section = section.split("\n.SS ").next().unwrap_or_default();
        let scripts = [Shell::Bash, Shell::Zsh].map(completions::script);
        let fish = completions::script(Shell::Fish);
        for row in T::TABLE {
            let name = row.name;
            if row.is_at(At::Line) {
                assert!(section.contains(&format!("\\fB--{name}\\fR")), "gaugefs(1): {command} --{name}");
                assert!(scripts.iter().all(|script| script.contains(&format!("--{name}"))), "{name}");
                assert!(fish.contains(&format!("{command}\" -l {name} ")), "fish: {name}");
            }
            assert!(file.contains(&format!("\n.TP\n\\fB{name}\\fR ({})\n", row.kind())), "{name}");
        }
    }

    #[test]
    fn every_option_is_in_both_manual_pages_and_in_the_completions() {
        check::<GaugeOptions>("mount");
        check::<MountOptions>("mount");
        #[cfg(feature = "screen")]
        check::<AlertOptions>("watch");
    }
}
