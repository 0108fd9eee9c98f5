// SPDX-License-Identifier: MIT

//! `gaugefs man`: the manual pages of a package.
//!
//! The pages are written by hand in `docs/gaugefs.1.in` and `docs/gaugefs.toml.5.in`, except for commands, options and
//! keys, which come from the parser's definitions and from the table of `config`.

use std::process::ExitCode;

use clap::{Args, Command, CommandFactory, ValueEnum};
use roff::{Inline, Roff, bold, roman};

use super::Cli;
use crate::command::manual::{dated, page};
use crate::config::{AlertOptions, At, ChoiceOptions, MountOptions, Opt, Options};
use crate::error::Result;
use crate::output::print_file;
use gauge_owner::GaugeOptions;

const PROGRAM: &str = include_str!("../../docs/gaugefs.1.in");
const FILE: &str = include_str!("../../docs/gaugefs.toml.5.in");

const MAN: &str = "\
Examples:
  gaugefs man | man -l -
  gaugefs man gaugefs.toml | man -l -";

/// Print a manual page, with the meaning of its words
#[derive(Args, Debug)]
#[command(after_help = MAN)]
pub(super) struct Man {
    /// The page
    #[arg(value_enum, default_value = "gaugefs")]
    page: Page,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Page {
    /// gaugefs(1)
    Gaugefs,
    /// gaugefs.toml(5)
    #[value(name = "gaugefs.toml")]
    File,
}

impl Man {
    pub(super) fn run(self) -> Result<ExitCode> {
        let page = match self.page {
            Page::Gaugefs => program(Cli::command()),
            Page::File => file(),
        };
        print_file(page.as_bytes())?;
        Ok(ExitCode::SUCCESS)
    }
}

pub(super) fn program(gaugefs: Command) -> String {
    page(PROGRAM, gaugefs)
}

pub(super) fn file() -> String {
    let is_default = |row: &&Opt<GaugeOptions>| row.is_at(At::Defaults);
    dated(FILE)
        .replace("@MOUNT@\n", &keys(MountOptions::TABLE.iter()))
        .replace("@DEFAULTS@\n", &keys(GaugeOptions::TABLE.iter().filter(is_default)))
        .replace("@GAUGE@\n", &keys(GaugeOptions::TABLE.iter().filter(|row| !is_default(row))))
        .replace("@CHOOSE@\n", &keys(ChoiceOptions::TABLE.iter()))
        .replace("@ALERT@\n", &keys(AlertOptions::TABLE.iter()))
}

fn keys<T: Options>(rows: impl Iterator<Item = &'static Opt<T>>) -> String {
    let mut section = Roff::new();
    for row in rows.filter(|row| row.is_at(At::Table)) {
        section.control("TP", []).text([bold(row.name), roman(format!(" ({})", row.kind()))]);
        section.text(marked::<T>(&row.explained()));
    }
    section.to_roff()
}

/// Text with bold words: those between backticks, and options, which are keys here.
fn marked<T: Options>(text: &str) -> Vec<Inline> {
    let mut marked = Vec::new();
    for (number, part) in text.split('`').enumerate() {
        if number % 2 == 1 {
            marked.push(bold(part));
            continue;
        }
        let mut parts = part.split("--");
        marked.extend(parts.next().map(roman));
        for part in parts {
            let end = part.find(|byte: char| !byte.is_ascii_lowercase() && byte != '-').unwrap_or(part.len());
            let (name, rest) = part.split_at(end);
            debug_assert!(T::row(name).is_some(), "{text}");
            marked.extend([bold(name), roman(rest)]);
        }
    }
    marked
}
