// SPDX-License-Identifier: MIT

//! Options, and their two forms: an argument of the command line, and a key of a configuration file.

use std::fmt;
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

use clap::error::Error;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches};
use toml::Spanned;
use toml::de::{DeString, DeValue};

use super::values;
use ti_gauge::chip::Chip;

/// Options that are read together.
pub(crate) trait Options: Clone + Default + 'static {
    const TABLE: &'static [Opt<Self>];

    fn row(name: &str) -> Option<&'static Opt<Self>> {
        Self::TABLE.iter().find(|row| row.name == name)
    }
}

/// Everything about an option.
pub(crate) struct Opt<T: 'static> {
    /// As on the command line after `--`, and as in a file.
    pub(crate) name: &'static str,
    pub(crate) effect: Effect<T>,
    /// A sentence without its full stop.
    pub(crate) doc: &'static str,
    /// Added to the help; not valid in a file.
    pub(crate) on_line: &'static str,
    /// The default, unless it is obvious.
    pub(crate) default: &'static str,
    /// Further sentences of gaugefs.toml(5).
    pub(crate) more: &'static str,
    /// Heading in the help of the command.
    pub(crate) heading: &'static str,
    pub(crate) at: &'static [At],
    /// Options that it contradicts, listed on one side only. A gauge's own option replaces a default.
    pub(crate) not_with: &'static [&'static str],
    /// For an older name, the option's present name; otherwise empty.
    #[cfg_attr(not(test), allow(dead_code, reason = "what it does follows from its effect"))]
    pub(crate) of: &'static str,
    /// What `-` is, for an option that names a file.
    pub(crate) dash: Dash,
    /// An option that it needs.
    pub(crate) needs: Option<&'static str>,
    /// A value as TOML, for the tests.
    #[cfg_attr(not(test), allow(dead_code, reason = "every option is tested with it"))]
    pub(crate) sample: &'static str,
}

/// Where an option may stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum At {
    /// On the command line, as `--name`.
    Line,
    /// On the command line, by its position.
    Argument,
    /// In the table of a file that it is about: `[mount]`, `[[gauge]]`, `[[alert]]` or `[station]`.
    Table,
    /// In `[defaults]`.
    Defaults,
    /// In the tables of gauges in the file of a station.
    Station,
}

/// What `-` is on a command line, in place of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Dash {
    /// The name of a file.
    Name,
    /// Standard input, which is read as a whole before the command returns.
    Input,
    /// Nothing, for this reason: the file is written while a mount lasts.
    Written(&'static str),
    /// Nothing, because the file has keys.
    Secret,
}

/// Only in a file.
pub(crate) const IN_FILE: &[At] = &[At::Table];

/// The option's value: its name in the help, how it is checked, and where it is stored.
pub(crate) enum Effect<T> {
    Switch(fn(&mut T, bool)),
    File(&'static str, fn(&mut T) -> &mut Option<PathBuf>),
    /// A file if the path has a slash, otherwise a name.
    NameOrFile(&'static str, fn(&mut T) -> &mut Option<PathBuf>),
    /// In a file, this and the next may be a number or a string.
    Number(&'static str, fn(&mut T, &str) -> Result<(), String>),
    Text(&'static str, fn(&mut T, &str) -> Result<(), String>),
    Chip(fn(&mut T) -> &mut Option<&'static Chip>),
    /// A switch with an optional text.
    SwitchOrText(&'static str, fn(&mut T, Option<Option<&str>>) -> Result<(), String>),
    /// Names with values: in a file, a table of numbers or strings.
    Table(&'static str, fn(&mut T, Vec<(String, String)>)),
    /// Tables that may occur any number of times, in a file only.
    Tables(fn(&mut T, &DeValue<'_>) -> Result<(), Wrong>),
    /// Words up to a `;`, each checked on the command line.
    Words(&'static str, fn(&str) -> Result<String, String>, fn(&mut T, Vec<String>)),
}

/// What is wrong with a value, and the key within a table.
#[derive(Debug)]
pub(crate) struct Wrong {
    pub(super) why: String,
    pub(super) within: Option<(String, usize)>,
}

impl<Text: Into<String>> From<Text> for Wrong {
    fn from(why: Text) -> Self {
        Self { why: why.into(), within: None }
    }
}

/// Stores an accepted value.
pub(crate) fn put<V>(to: &mut Option<V>, value: Result<V, String>) -> Result<(), String> {
    *to = Some(value?);
    Ok(())
}

impl<T: Options> Opt<T> {
    /// Lets a row list only what is unusual.
    pub(crate) const NEW: Self = Self {
        name: "",
        effect: Effect::Switch(|_, _| ()),
        doc: "",
        on_line: "",
        default: "",
        more: "",
        heading: "",
        at: &[At::Line, At::Table],
        not_with: &[],
        of: "",
        dash: Dash::Name,
        needs: None,
        sample: "true",
    };

    pub(crate) fn is_at(&self, place: At) -> bool {
        self.at.contains(&place)
    }

    fn is_on_command_line(&self) -> bool {
        self.is_at(At::Line) || self.is_at(At::Argument)
    }

    fn arg(&'static self) -> Arg {
        let default = match self.default {
            "" => String::new(),
            default => format!(" [default: {default}]"),
        };
        let help = format!("{}{}{default}", self.doc, self.on_line);
        let heading = Some(self.heading).filter(|heading| !heading.is_empty());
        let mut arg = Arg::new(self.name).help(help).help_heading(heading).conflicts_with_all(self.not_with);
        if let Some(needed) = self.needs {
            arg = arg.requires(needed);
        }
        arg = match self.is_at(At::Argument) {
            true => arg.required_unless_present("config"),
            false => arg.long(self.name),
        };
        let checked = |set: fn(&mut T, &str) -> Result<(), String>| {
            move |text: &str| set(&mut T::default(), text).map(|()| text.to_string())
        };
        match self.effect {
            Effect::Switch(_) => arg.action(ArgAction::SetTrue),
            Effect::File(name, _) | Effect::NameOrFile(name, _) => {
                arg.value_name(name).value_parser(clap::value_parser!(PathBuf))
            }
            Effect::Number(name, set) | Effect::Text(name, set) => {
                arg.value_name(name).value_parser(checked(set))
            }
            Effect::Chip(_) => arg
                .value_name("CHIP")
                .value_parser(values::chips())
                .ignore_case(true)
                .hide_possible_values(true),
            Effect::SwitchOrText(name, set) => {
                let parse =
                    move |text: &str| set(&mut T::default(), Some(Some(text))).map(|()| text.to_string());
                arg.value_name(name).num_args(0..=1).require_equals(true).value_parser(parse)
            }
            Effect::Table(name, _) => {
                arg.action(ArgAction::Append).value_name(name).value_delimiter(',').value_parser(pair)
            }
            Effect::Words(name, word, _) => {
                let arg = arg.action(ArgAction::Append).value_name(name).num_args(1..);
                arg.allow_hyphen_values(true).value_terminator(";").value_parser(word)
            }
            Effect::Tables(_) => unreachable!("it is in files only"),
        }
    }

    fn take(&self, to: &mut T, matches: &ArgMatches) -> Result<(), String> {
        let text = || matches.get_one::<String>(self.name).map(String::as_str);
        match self.effect {
            // An earlier value, from a file, stays.
            Effect::Switch(set) if matches.get_flag(self.name) => set(to, true),
            Effect::Switch(_) => {}
            Effect::File(_, field) | Effect::NameOrFile(_, field) => {
                if let Some(path) = matches.get_one::<PathBuf>(self.name) {
                    *field(to) = Some(path.clone());
                }
            }
            Effect::Number(_, set) | Effect::Text(_, set) => {
                return text().map_or(Ok(()), |text| set(to, text));
            }
            Effect::Chip(field) => {
                if let Some(chip) = matches.get_one::<&'static Chip>(self.name) {
                    *field(to) = Some(chip);
                }
            }
            Effect::SwitchOrText(_, set) if matches.contains_id(self.name) => return set(to, Some(text())),
            Effect::SwitchOrText(..) => {}
            Effect::Table(_, set) => {
                if let Some(pairs) = matches.get_many::<(String, String)>(self.name) {
                    set(to, pairs.cloned().collect());
                }
            }
            Effect::Words(_, _, set) => {
                if let Some(words) = matches.get_many::<String>(self.name) {
                    set(to, words.cloned().collect());
                }
            }
            Effect::Tables(_) => {}
        }
        Ok(())
    }

    pub(super) fn read(&self, to: &mut T, value: &DeValue<'_>) -> Result<(), Wrong> {
        let string = |value: &DeValue<'_>| value.as_str().map(str::to_string);
        match self.effect {
            Effect::Switch(set) => set(to, value.as_bool().ok_or("expected a boolean")?),
            Effect::File(_, field) | Effect::NameOrFile(_, field) => {
                *field(to) = Some(string(value).ok_or("expected a string")?.into())
            }
            Effect::Number(_, set) | Effect::Text(_, set) => set(to, &word(value)?)?,
            Effect::Chip(field) => put(field(to), values::chip(&word(value)?))?,
            Effect::SwitchOrText(_, set) => match (value.as_bool(), value.as_str()) {
                (Some(is_on), _) => set(to, is_on.then_some(None))?,
                (None, Some(text)) => set(to, Some(Some(text)))?,
                (None, None) => return Err("expected true, false or a name".into()),
            },
            Effect::Table(_, set) => {
                let table = value.as_table().ok_or("expected a table, such as { cells = 7 }")?;
                let pair = |(name, value): (&Spanned<DeString<'_>>, &Spanned<DeValue<'_>>)| {
                    let name = name.get_ref().to_string();
                    word(value.get_ref())
                        .map(|text| (name.clone(), text))
                        .map_err(|why| format!("{name}: {why}"))
                };
                set(to, table.iter().map(pair).collect::<Result<_, _>>()?);
            }
            Effect::Words(_, _, set) => {
                let words = value.as_array().map(|list| list.iter().map(|word| string(word.get_ref())));
                let words: Vec<String> =
                    words.and_then(Iterator::collect).ok_or("expected an array of strings")?;
                set(to, words);
            }
            Effect::Tables(set) => set(to, value)?,
        }
        Ok(())
    }

    /// The file that it names.
    pub(super) fn path(&self, options: &T) -> Option<PathBuf> {
        match self.effect {
            Effect::File(_, field) | Effect::NameOrFile(_, field) => field(&mut options.clone()).take(),
            _ => None,
        }
    }

    /// Names another file.
    pub(super) fn set_path(&self, options: &mut T, path: PathBuf) {
        if let Effect::File(_, field) | Effect::NameOrFile(_, field) = self.effect {
            *field(options) = Some(path);
        }
    }

    /// The value's type in a file.
    pub(crate) fn kind(&self) -> &'static str {
        match self.effect {
            Effect::Switch(_) => "boolean",
            Effect::File(..) | Effect::NameOrFile(..) | Effect::Text(..) | Effect::Chip(_) => "string",
            Effect::Number(..) => "number",
            Effect::SwitchOrText(..) => "boolean or string",
            Effect::Table(..) => "table",
            Effect::Words(..) => "array",
            Effect::Tables(_) => "tables",
        }
    }

    /// What gaugefs.toml(5) says about it.
    pub(crate) fn explained(&self) -> String {
        let default = match self.default {
            "" => String::new(),
            default => format!(" Default: {default}."),
        };
        let more = if self.more.is_empty() { String::new() } else { format!(" {}", self.more) };
        format!("{}.{default}{more}", self.doc)
    }
}

/// A name and its value, with `=` between.
fn pair(text: &str) -> Result<(String, String), String> {
    let pair = text.split_once('=').filter(|(name, _)| !name.is_empty());
    pair.map(|(name, value)| (name.into(), value.into())).ok_or_else(|| "expected KNOB=VALUE".into())
}

/// A number or a string. A number keeps its notation without a prefix: data sheets write addresses in hexadecimal, so
/// 55 probably is.
fn word(value: &DeValue<'_>) -> Result<String, &'static str> {
    const EXPECTED: &str = "expected a number or a string";
    Ok(match value {
        DeValue::Integer(number) if number.radix() == 10 => number.as_str().to_string(),
        DeValue::Integer(number) => {
            let number = i64::from_str_radix(number.as_str(), number.radix()).map_err(|_| EXPECTED)?;
            format!("{number:#04x}")
        }
        DeValue::Float(number) => number.as_str().to_string(),
        DeValue::String(text) => text.to_string(),
        _ => return Err(EXPECTED),
    })
}

/// Names of the options that are allowed in a place.
pub(crate) fn names<T: Options>(place: At) -> impl Iterator<Item = &'static str> {
    T::TABLE.iter().filter(move |row| row.is_at(place)).map(|row| row.name)
}

/// The files that the options name.
pub(super) fn paths<T: Options>(options: &mut T, mut each: impl FnMut(&mut PathBuf)) {
    for row in T::TABLE {
        let (Effect::File(_, field) | Effect::NameOrFile(_, field)) = row.effect else { continue };
        let is_name = |path: &Path| !path.as_os_str().as_encoded_bytes().contains(&b'/');
        if let Some(path) = field(options)
            && !(matches!(row.effect, Effect::NameOrFile(..)) && is_name(path))
        {
            each(path);
        }
    }
}

/// Replaces or refuses `-` in place of a file.
pub(super) fn read_dashes<T: Options>(options: &mut T) -> crate::error::Result<()> {
    for row in T::TABLE {
        let Some(path) = row.path(options).filter(|path| path == Path::new("-")) else { continue };
        match row.dash {
            Dash::Name => {}
            Dash::Input => row.set_path(options, super::standard_input(path)),
            Dash::Written(why) => {
                let option = format!("--{}", row.name);
                return Err(super::Error::new(option, super::Cause::Invalid, format!("{why}; name a file")));
            }
            Dash::Secret => gauge_owner::key_file::check_name(Some(&path))?,
        }
    }
    Ok(())
}

/// The files that are written while a mount lasts, each with the name of its option.
pub(crate) fn written<T: Options>(options: &T) -> impl Iterator<Item = (&'static str, PathBuf)> {
    let rows = T::TABLE.iter().filter(|row| matches!(row.dash, Dash::Written(_)));
    rows.filter_map(|row| Some((row.name, row.path(options)?)))
}

/// The options on a command line.
#[derive(Clone)]
pub(crate) struct Given<T>(ArgMatches, PhantomData<T>);

/// Without values, which may contain a key.
impl<T> fmt::Debug for Given<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Given").finish_non_exhaustive()
    }
}

impl<T: Options> Given<T> {
    /// Stores them over earlier values.
    pub(crate) fn over(&self, options: &mut T) {
        for row in T::TABLE.iter().filter(|row| row.is_on_command_line()) {
            row.take(options, &self.0).expect("clap has refused what cannot be stored");
        }
    }

    pub(crate) fn options(&self) -> T {
        let mut options = T::default();
        self.over(&mut options);
        options
    }
}

impl<T: Options> FromArgMatches for Given<T> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, Error> {
        Ok(Self(matches.clone(), PhantomData))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), Error> {
        self.0 = matches.clone();
        Ok(())
    }
}

impl<T: Options> Args for Given<T> {
    fn augment_args(command: Command) -> Command {
        command.args(T::TABLE.iter().filter(|row| row.is_on_command_line()).map(Opt::arg))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}
