// SPDX-License-Identifier: MIT

//! The command line: the parser, the dispatch and the exit codes. Each command has a file of its own.

use std::ffi::OsString;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::daemon::{look, service};
use crate::error::{Error, Result};
use crate::output::{print, print_error, say_error};
use gauge_owner::key_file;
use ti_gauge::text;

mod assignment;
mod auth;
mod batch;
mod bringup;
mod calibrate;
mod capacity;
mod chips;
mod completions;
mod diff;
mod doctor;
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
mod program;
mod records;
mod report;
mod rescue;
mod set;
mod settle;
mod sim;
mod umount;
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
enum Command {
    Mount(Box<mount::Mount>),
    Umount(umount::Umount),
    List(list::List),
    Sim(sim::Sim),
    Probe(probe::Probe),
    Program(program::Program),
    Records(records::Show),
    Rescue(rescue::Rescue),
    Chips(chips::Chips),
    Report(report::Report),
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
    /// Remove the mounts of services that have ended; systemd's units run it as root
    Detach,
    /// Check that nobody else may read the key file of a service; systemd's units run it as root
    #[command(hide = true)]
    CheckKeys {
        /// The key file
        file: PathBuf,
    },
    /// Print a full path and whether its daemon is gone; the other commands run it with a time limit
    #[command(hide = true)]
    Look {
        /// The path
        path: PathBuf,
        /// Print the gauges there, too
        #[arg(long)]
        gauges: bool,
    },
    Names(names::Names),
}

impl Command {
    fn run(self) -> Result<ExitCode> {
        match self {
            Self::Mount(command) => command.run(),
            Self::Umount(command) => command.run(),
            Self::List(command) => command.run(),
            Self::Sim(command) => command.run(),
            Self::SimInside(command) => command.run(),
            Self::Probe(command) => command.run(),
            Self::Program(command) => command.run(),
            Self::Records(command) => command.run(),
            Self::Rescue(command) => command.run(),
            Self::Chips(command) => command.run(),
            Self::Report(command) => command.run(),
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
            Self::Look { path, gauges } => look::answer(&path, gauges).map(|()| ExitCode::SUCCESS),
            Self::Names(command) => command.run(),
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
            "report", "doctor",
        ],
    ),
    ("Write", &["set", "import", "settle", "learned", "calibrate", "bringup", "keys", "rescue"]),
    ("Factory", &["program", "records", "auth"]),
    ("Service", &["watch", "metrics", "events", "detach", "completions", "man"]),
];

/// The definition of the command line, whose prose has the terminal's width.
pub fn definition() -> clap::Command {
    let command = flowing(Cli::command());
    let commands = grouped(&command);
    command.help_template(format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{commands}Options:\n{{options}}{{after-help}}"
    ))
}

/// The list of commands, with a heading per group.
fn grouped(command: &clap::Command) -> String {
    let shown = |command: &&clap::Command| !command.is_hide_set();
    let is_in = |name: &str| GROUPS.iter().any(|(_, names)| names.contains(&name));
    let others =
        command.get_subcommands().filter(shown).map(clap::Command::get_name).filter(|name| !is_in(name));
    let others: Vec<&str> = others.collect();
    let groups = GROUPS.iter().copied().chain([("Other", &*others)]);
    let mut text = String::new();
    for (heading, names) in groups {
        // This build may lack some.
        let named = names.iter().filter_map(|name| command.find_subcommand(name)).filter(shown);
        let lines: String = named.map(listed).collect();
        if !lines.is_empty() {
            text += &format!("{heading}:\n{lines}\n");
        }
    }
    text
}

/// A line of the list, or several if it is too long for 80 columns.
fn listed(command: &clap::Command) -> String {
    const NAME: usize = 11;
    const WIDTH: usize = 80 - NAME - 4;
    let about = command.get_about().map(ToString::to_string).unwrap_or_default();
    let aliases: Vec<&str> = command.get_visible_aliases().collect();
    let about = if aliases.is_empty() { about } else { format!("{about} [alias: {}]", aliases.join(", ")) };
    let mut lines = vec![String::new()];
    for word in about.split(' ') {
        match lines.last_mut() {
            Some(line) if line.is_empty() => line.push_str(word),
            Some(line) if line.chars().count() + 1 + word.chars().count() <= WIDTH => {
                *line += &format!(" {word}")
            }
            _ => lines.push(word.into()),
        }
    }
    let names = std::iter::once(command.get_name()).chain(std::iter::repeat(""));
    names.zip(lines).map(|(name, line)| format!("  {name:NAME$}  {line}\n")).collect()
}

fn flowing(command: clap::Command) -> clap::Command {
    let prose = command.get_after_help().map(|help| flow(&help.to_string()));
    let command = match prose {
        Some(prose) => command.after_help(prose),
        None => command,
    };
    let names: Vec<String> = command.get_subcommands().map(|command| command.get_name().into()).collect();
    names.into_iter().fold(command, |command, name| command.mut_subcommand(name, flowing))
}

/// Joins the lines of each paragraph, whose breaks are for readers of the source. Indented lines are examples and stay,
/// and so does the line above them.
fn flow(text: &str) -> String {
    let mut flowing = String::new();
    let mut lines = text.lines().peekable();
    while let Some(line) = lines.next() {
        flowing += line;
        let stays = |line: &str| line.is_empty() || line.starts_with(' ');
        let Some(next) = lines.peek() else { break };
        flowing.push(if stays(line) || stays(next) { '\n' } else { ' ' });
    }
    flowing
}

/// Runs the command in the arguments. The exit code is 0 for done, 1 for failed, 2 for misuse.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let mut definition = definition();
    let parsed = definition
        .try_get_matches_from_mut(&arguments)
        .and_then(|matches| Cli::from_arg_matches(&matches).map_err(|error| error.format(&mut definition)));
    let cli = match parsed {
        Ok(cli) => cli,
        Err(error) if error.use_stderr() => {
            let bus = bare_bus(&arguments);
            let tip = bus.map_or_else(String::new, |bus| {
                format!("  tip: a bus is given with an option: --bus {bus}\n\n")
            });
            let text = reworded(&error.to_string()).replacen("Usage: ", &format!("{tip}Usage: "), 1);
            print_error(&text::lines(&text));
            return ExitCode::from(2);
        }
        Err(help) => {
            let printed = print(&help.to_string()).map(|()| ExitCode::SUCCESS);
            return printed.unwrap_or_else(|error| failed(&error));
        }
    };
    cli.command.run().unwrap_or_else(|error| failed(&error))
}

fn failed(error: &Error) -> ExitCode {
    say_error(error);
    ExitCode::FAILURE
}

/// Rewords clap's message about a misuse in gaugefs's style. It drops the advice to put `--` before an unknown option,
/// because no argument here takes one as a value, and replaces the long list of chips by a hint.
fn reworded(text: &str) -> String {
    const LONGEST: usize = 200;
    let text =
        text.strip_prefix("error: ").map_or_else(|| text.to_string(), |text| format!("gaugefs: {text}"));
    let kept = text.split("\n\n").filter(|part| !part.starts_with("  tip: to pass '"));
    let lines = kept.collect::<Vec<_>>().join("\n\n");
    let is_long = |line: &str| line.starts_with("  [possible values: bq") && line.len() > LONGEST;
    let lines = lines.split_inclusive('\n').map(|line| match is_long(line) {
        true => "  `gaugefs chips` lists the chips\n",
        false => line,
    });
    lines.collect()
}

/// A bus among the arguments that is no option's value.
fn bare_bus(arguments: &[OsString]) -> Option<&str> {
    let pairs = arguments.windows(2).filter_map(|pair| Some((pair[0].to_str()?, pair[1].to_str()?)));
    let mut bare = pairs.filter(|(before, _)| !before.starts_with("--")).map(|(_, bus)| bus);
    bare.find(|bus| bus.starts_with("/dev/i2c-"))
}

/// Pads every column to its widest cell, with two spaces between columns.
fn align<const N: usize>(rows: &[[String; N]]) -> String {
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: [usize; N] = std::array::from_fn(width);
    let mut table = String::new();
    for row in rows {
        let cells = row.iter().zip(widths).map(|(cell, width)| format!("{cell:width$}"));
        let line = cells.collect::<Vec<_>>().join("  ");
        // Writing to a String does not fail.
        let _ = writeln!(table, "{}", line.trim_end());
    }
    table
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

    #[test]
    fn prose_takes_the_width_of_the_terminal_and_examples_stay() {
        let text = "One\ntwo.\n\nThree\nfour:\n  a\n  b\nFive\nsix";
        assert_eq!(flow(text), "One two.\n\nThree four:\n  a\n  b\nFive six");
    }

    #[test]
    fn every_command_is_in_one_group_of_the_help() {
        let command = definition();
        let names: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| *names).copied().collect();
        for shown in command.get_subcommands().filter(|command| !command.is_hide_set()) {
            let count = names.iter().filter(|name| **name == shown.get_name()).count();
            assert_eq!(count, 1, "{}", shown.get_name());
        }
        let help = command.clone().render_help().to_string();
        let headings = ["Mount:", "Look:", "Write:", "Factory:", "Service:", "Options:", "Examples:"];
        let found: Vec<&str> = help.lines().filter(|line| headings.contains(line)).collect();
        assert_eq!(found, headings, "{help}");
        assert!(help.lines().all(|line| line.chars().count() <= 80), "{help}");
    }

    /// A terminal of 80 columns would break an example in the middle and separate it from its heading.
    #[test]
    fn regression_examples_were_broken_at_80_columns() {
        fn check(command: &clap::Command) {
            let text = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            for line in text.lines().filter(|line| line.starts_with(' ')) {
                assert!(line.chars().count() <= 80, "{}: {line}", command.get_name());
            }
            command.get_subcommands().for_each(check);
        }
        check(&definition());
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
