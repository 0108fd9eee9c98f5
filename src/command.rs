// SPDX-License-Identifier: MIT

//! What the command lines of the programs share: the layout of their help, what is said of a misuse, and the exit codes.
//! [`completions`] and [`manual`] make scripts and pages of their definitions.

use std::ffi::OsString;
use std::fmt::Write as _;
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, Parser};
use ti_gauge::text;

use crate::error::{Error, Result};
use crate::output::{print, print_error, say_error};

pub(crate) mod completions;
pub(crate) mod manual;

/// Headings of the list of commands, each with its commands.
pub(crate) type Groups = [(&'static str, &'static [&'static str])];

/// All of a definition that its source names. `defer` leaves out the options of commands that are not in the arguments, which
/// are most of what there is to make when the program starts.
pub(crate) fn whole<C: CommandFactory>() -> clap::Command {
    built(C::command().disable_help_flag(true).disable_help_subcommand(true).disable_version_flag(true))
}

fn built(mut command: clap::Command) -> clap::Command {
    command.build();
    command
}

/// A definition that prints help: commands are listed by what they are for, and prose takes the width of the terminal. A
/// command that is in no group is listed at the end.
pub(crate) fn definition<C: CommandFactory>(groups: &Groups) -> clap::Command {
    let command = flowing(built(C::command()));
    let commands = grouped(&command, groups);
    command.help_template(format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{commands}Options:\n{{options}}{{after-help}}"
    ))
}

/// The list of commands, with a heading per group.
fn grouped(command: &clap::Command, groups: &Groups) -> String {
    let shown = |command: &&clap::Command| !command.is_hide_set() && command.get_name() != "help";
    let is_in = |name: &str| groups.iter().any(|(_, names)| names.contains(&name));
    let others =
        command.get_subcommands().filter(shown).map(clap::Command::get_name).filter(|name| !is_in(name));
    let others: Vec<&str> = others.collect();
    let groups = groups.iter().copied().chain([("Other", &*others)]);
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

/// Parses the arguments. Help, which may be long, is laid out only if it is printed.
fn parse<C: Parser>(arguments: &[OsString], groups: &Groups) -> std::result::Result<C, clap::Error> {
    let parsed = C::try_parse_from(arguments);
    let is_help = |error: &clap::Error| {
        use ErrorKind::{DisplayHelp, DisplayHelpOnMissingArgumentOrSubcommand};
        matches!(error.kind(), DisplayHelp | DisplayHelpOnMissingArgumentOrSubcommand)
    };
    parsed.map_err(|error| match is_help(&error) {
        true => definition::<C>(groups).try_get_matches_from(arguments).err().unwrap_or(error),
        false => error,
    })
}

/// Runs the command in the arguments. The exit code is 0 for done, 1 for failed, 2 for misuse.
pub(crate) fn run<C: Parser>(
    groups: &Groups,
    arguments: impl IntoIterator<Item = OsString>,
    run: impl FnOnce(C) -> Result<ExitCode>,
) -> ExitCode {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let command = match parse::<C>(&arguments, groups) {
        Ok(command) => command,
        Err(error) if error.use_stderr() => {
            let bus = bare_bus(&arguments);
            let tip = bus.map_or_else(String::new, |bus| {
                format!("  tip: a bus is given with an option: --bus {bus}\n\n")
            });
            let text = reworded(&error.to_string(), C::command().get_name());
            print_error(&text::lines(&text.replacen("Usage: ", &format!("{tip}Usage: "), 1)));
            return ExitCode::from(2);
        }
        Err(help) => {
            return ended(print(&help.to_string()).map(|()| ExitCode::SUCCESS));
        }
    };
    ended(run(command))
}

/// The exit code of a command, whose failure is printed.
pub(crate) fn ended(outcome: Result<ExitCode>) -> ExitCode {
    outcome.unwrap_or_else(|error| failed(&error))
}

fn failed(error: &Error) -> ExitCode {
    say_error(error);
    ExitCode::FAILURE
}

/// Rewords clap's message about a misuse in gaugefs's style. It drops the advice to put `--` before an unknown option,
/// because no argument here takes one as a value, and replaces the long list of chips by a hint.
fn reworded(text: &str, program: &str) -> String {
    const LONGEST: usize = 200;
    let text =
        text.strip_prefix("error: ").map_or_else(|| text.to_string(), |text| format!("{program}: {text}"));
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
pub(crate) fn align<const N: usize>(rows: &[[String; N]]) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prose_takes_the_width_of_the_terminal_and_examples_stay() {
        let text = "One\ntwo.\n\nThree\nfour:\n  a\n  b\nFive\nsix";
        assert_eq!(flow(text), "One two.\n\nThree four:\n  a\n  b\nFive six");
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
        check(&crate::cli::definition());
        check(&crate::station::definition());
    }
}
