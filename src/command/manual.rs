// SPDX-License-Identifier: MIT

//! The manual page of a program: a text in `docs/`, and the commands and options of the program's definition.

use clap::{Arg, ArgAction, Command};
use jiff::Timestamp;
use roff::{Inline, Roff, bold, italic, roman};

const WORDS: &str = include_str!("../../docs/COMMANDS.md");

/// A page with its head, dated by SOURCE_DATE_EPOCH, so that a package builds reproducibly.
pub(crate) fn dated(page: &str) -> String {
    let epoch = std::env::var("SOURCE_DATE_EPOCH").ok().and_then(|seconds| seconds.parse().ok());
    let date = epoch.and_then(|seconds| Timestamp::from_second(seconds).ok());
    let date = date.map_or_else(String::new, |date| date.strftime("%F").to_string());
    page.replace("@DATE@", &date).replace("@VERSION@", env!("CARGO_PKG_VERSION"))
}

/// The page of a program, from its text and its definition.
pub(crate) fn page(text: &str, mut program: Command) -> String {
    program.build();
    let (mut synopsis, mut commands) = (Roff::new(), Roff::new());
    let name = program.get_name().to_string();
    for command in program.get_subcommands_mut().filter(|command| !command.is_hide_set()) {
        if command.get_name() != "help" {
            describe(&name, command, &mut synopsis, &mut commands);
        }
    }
    dated(text)
        .replace("@SYNOPSIS@\n", &synopsis.to_roff())
        .replace("@COMMANDS@\n", &commands.to_roff())
        .replace("@WORDS@\n", &words())
}

/// The meanings of gaugefs's words, from their page.
fn words() -> String {
    let (_, table) = WORDS.split_once("\n## Words\n").expect("the page has them");
    let rows = table.lines().skip_while(|line| !line.starts_with("| --- ")).skip(1);
    let mut section = Roff::new();
    for row in rows.map_while(|line| line.strip_prefix("| ")?.strip_suffix(" |")?.split_once(" | ")) {
        section.control("TP", []).text([bold(row.0)]).text([roman(row.1.replace('`', ""))]);
    }
    section.to_roff()
}

/// Adds a command to the synopsis and its section to the page.
fn describe(program: &str, command: &mut Command, synopsis: &mut Roff, section: &mut Roff) {
    let usage = command.render_usage().to_string();
    let usage = usage.strip_prefix("Usage: ").unwrap_or(&usage);
    let name = format!("{program} {}", command.get_name());
    let rest = usage.strip_prefix(&name).unwrap_or_default().to_string();
    if *synopsis != Roff::new() {
        synopsis.control("br", []);
    }
    synopsis.text([bold(&name), roman(&rest)]);
    section.control("SS", [name.as_str()]).text([bold(&name), roman(rest)]).control("PP", []);
    let about = command.get_about().map(ToString::to_string).unwrap_or_default();
    section.text([roman(format!("{about}."))]);
    let shown = || command.get_arguments().filter(|argument| !argument.is_hide_set() && !is_help(argument));
    let mut headings: Vec<Option<&str>> = Vec::new();
    for argument in shown() {
        if !headings.contains(&argument.get_help_heading()) {
            headings.push(argument.get_help_heading());
        }
    }
    for heading in headings {
        if let Some(heading) = heading {
            section.control("PP", []).text([italic(format!("{heading}:"))]);
        }
        for argument in shown().filter(|argument| argument.get_help_heading() == heading) {
            section.control("TP", []).text(term(argument)).text([roman(explain(argument))]);
        }
    }
    if let Some(more) = command.get_after_help() {
        prose(&more.to_string(), section);
    }
}

fn is_help(argument: &Arg) -> bool {
    matches!(argument.get_action(), ArgAction::Help | ArgAction::HelpShort | ArgAction::HelpLong)
}

/// `-f, --foreground` or `--poll SECONDS` or `--ac[=NAME]` or `MOUNTPOINT`.
fn term(argument: &Arg) -> Vec<Inline> {
    let mut term = Vec::new();
    if let Some(letter) = argument.get_short() {
        term.push(bold(format!("-{letter}")));
    }
    if let Some(name) = argument.get_long() {
        if !term.is_empty() {
            term.push(roman(", "));
        }
        term.push(bold(format!("--{name}")));
    }
    if argument.get_action().takes_values() {
        let names = argument.get_value_names().unwrap_or_default();
        let names = italic(names.iter().map(ToString::to_string).collect::<Vec<_>>().join(" "));
        match argument.get_num_args() {
            Some(count) if count.min_values() == 0 => term.extend([roman("[="), names, roman("]")]),
            _ if term.is_empty() => term.push(names),
            _ => term.extend([roman(" "), names]),
        }
    }
    term
}

/// Help of an argument, with its possible values and default.
fn explain(argument: &Arg) -> String {
    let mut text = argument.get_help().map(ToString::to_string).unwrap_or_default();
    let values = argument.get_possible_values();
    if argument.get_action().takes_values() && !values.is_empty() && !argument.is_hide_possible_values_set() {
        let shown = values.iter().filter(|value| !value.is_hide_set());
        let names = shown.map(|value| value.get_name()).collect::<Vec<_>>();
        text += &format!(" [possible values: {}]", names.join(", "));
    }
    if let [default] = argument.get_default_values()
        && argument.get_action().takes_values()
    {
        text += &format!(" [default: {}]", default.display());
    }
    text
}

/// Paragraphs. Indented lines are examples, which keep their line breaks.
fn prose(text: &str, section: &mut Roff) {
    let is_example = |line: &&str| line.starts_with("  ");
    for paragraph in text.split("\n\n") {
        let lines: Vec<&str> = paragraph.lines().collect();
        for run in lines.chunk_by(|a, b| is_example(a) == is_example(b)) {
            let example = is_example(&run[0]);
            section.control("PP", []);
            if example {
                section.control("RS", []).control("nf", []);
            }
            for line in run {
                section.text([roman(line.trim_start())]);
            }
            if example {
                section.control("fi", []).control("RE", []);
            }
        }
    }
}
