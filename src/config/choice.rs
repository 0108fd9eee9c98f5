// SPDX-License-Identifier: MIT

//! Rules that choose a gauge's profile: `[[gauge.choose]]`.

use std::path::{Path, PathBuf};

use toml::Spanned;
use toml::de::DeValue;

use super::option::{At, Effect, IN_FILE, Opt, Options, Wrong, names, put};
use super::values;
use crate::error::Error;
use gauge_owner::{Evidence, GaugeOptions, Rule};
use ti_gauge::chip::Chip;
use ti_gauge::text::nearest;

const ABOVE: &str = "write [[gauge.choose]] above the keys of each rule";

/// A rule: its conditions, and the profile that it gives a gauge.
#[derive(Clone, Debug, Default)]
pub(crate) struct ChoiceOptions {
    chip: Option<&'static Chip>,
    chem_id: Option<u16>,
    firmware: Option<u16>,
    file: Option<PathBuf>,
    command: Vec<String>,
    text: Option<String>,
    from: Option<f64>,
    to: Option<f64>,
    profile: Option<PathBuf>,
    pack: Option<String>,
    pack_by_text: bool,
}

impl Options for ChoiceOptions {
    const TABLE: &'static [Opt<Self>] = &[
        Opt {
            name: "chip",
            effect: Effect::Chip(|to| &mut to.chip),
            doc: "The gauge must be this chip",
            at: IN_FILE,
            sample: "'bq27427'",
            ..Opt::NEW
        },
        Opt {
            name: "chem-id",
            effect: Effect::Number("ID", |to, text| put(&mut to.chem_id, values::hexadecimal(text))),
            doc: "It must have this chemistry, as gauge/chem_id shows it",
            more: "Hexadecimal, with or without 0x. After a loss of power it is the part's own.",
            at: IN_FILE,
            sample: "0x1202",
            ..Opt::NEW
        },
        Opt {
            name: "firmware",
            effect: Effect::Number("VERSION", |to, text| put(&mut to.firmware, values::hexadecimal(text))),
            doc: "It must have this version, as gauge/firmware_version shows it",
            more: "Hexadecimal, with or without 0x.",
            at: IN_FILE,
            sample: "0x0202",
            ..Opt::NEW
        },
        Opt {
            name: "file",
            effect: Effect::File("FILE", |to| &mut to.file),
            doc: "File that shows what pack it is, such as /sys/bus/iio/devices/iio:device0/in_voltage0_raw",
            more: "Its only line, without spaces at its ends, has at most 64 characters. It is read three times, and all three must \
                   agree on whether the rule fits.",
            at: IN_FILE,
            sample: "'/sys/x'",
            ..Opt::NEW
        },
        Opt {
            name: "command",
            effect: Effect::Words("CMD", |word| Ok(word.into()), |to, words| to.command = words),
            doc: "Program that prints what pack it is, and its arguments",
            more: "Its path begins with a slash; no shell is involved. It has the rights and the confinement of the daemon, no \
                   input, and in its environment PATH and GAUGEFS_GAUGE, the name of the gauge. It must exit with 0 within 5 \
                   seconds, and print one line as a file has it; otherwise it is killed. The configuration file must then be \
                   yours or root's, and nobody else may be able to write to it.",
            at: IN_FILE,
            not_with: &["file"],
            sample: "['/usr/bin/true', 'x']",
            ..Opt::NEW
        },
        Opt {
            name: "text",
            effect: Effect::Text("TEXT", |to, text| put(&mut to.text, Ok(text.into()))),
            doc: "The line must be this text",
            at: IN_FILE,
            sample: "'ATL'",
            ..Opt::NEW
        },
        Opt {
            name: "from",
            effect: Effect::Number("NUMBER", |to, text| put(&mut to.from, values::number(text))),
            doc: "The line must be a number, and at least this one",
            at: IN_FILE,
            sample: "310",
            ..Opt::NEW
        },
        Opt {
            name: "to",
            effect: Effect::Number("NUMBER", |to, text| put(&mut to.to, values::number(text))),
            doc: "The line must be a number, and at most this one",
            at: IN_FILE,
            sample: "420",
            ..Opt::NEW
        },
        Opt {
            name: "profile",
            effect: Effect::File("FILE", |to| &mut to.profile),
            doc: "The profile that the gauge gets if all of that is so",
            more: "Required.",
            at: IN_FILE,
            sample: "'image'",
            ..Opt::NEW
        },
        Opt {
            name: "pack",
            effect: Effect::Text("NAME", |to, text| put(&mut to.pack, values::name(text))),
            doc: "Name of the pack, if only one fits this rule",
            more: "What it has learned is restored with the profile.",
            at: IN_FILE,
            sample: "'FIRST'",
            ..Opt::NEW
        },
        Opt {
            name: "pack-by-text",
            effect: Effect::Switch(|to, on| to.pack_by_text = on),
            doc: "The line is the name of the pack, such as a serial number",
            more: "So each pack gets back what it has learned itself, at whichever bus and address it is.",
            at: IN_FILE,
            not_with: &["pack"],
            ..Opt::NEW
        },
    ];
}

impl ChoiceOptions {
    /// Reads the rules of a gauge.
    pub(super) fn read(rules: &DeValue<'_>) -> Result<Vec<Self>, Wrong> {
        let rules = rules.as_array().filter(|rules| !rules.is_empty());
        rules.ok_or(ABOVE)?.iter().map(Self::read_one).collect()
    }

    fn read_one(table: &Spanned<DeValue<'_>>) -> Result<Self, Wrong> {
        let keys = table.get_ref().as_table().ok_or(ABOVE)?;
        let mut options = Self::default();
        for (name, value) in keys {
            let wrong =
                |why: String| Wrong { why, within: Some((name.get_ref().to_string(), name.span().start)) };
            let name = name.get_ref();
            let Some(row) = Self::row(name) else {
                let known = || names::<Self>(At::Table);
                let why = match nearest(&name.replace('_', "-"), known()) {
                    Some(meant) => format!("unknown key; did you mean `{meant}`?"),
                    None => {
                        let known = known().collect::<Vec<_>>().join(", ");
                        format!("unknown key; known below [[gauge.choose]] are {known}")
                    }
                };
                return Err(wrong(why));
            };
            if let Some(other) = row.not_with.iter().find(|other| keys.contains_key(**other)) {
                return Err(wrong(format!("cannot be combined with {other}")));
            }
            row.read(&mut options, value.get_ref()).map_err(|error| wrong(error.why))?;
        }
        let wrong =
            |why: &str| Wrong { why: why.into(), within: Some(("choose".into(), table.span().start)) };
        options.check().map_err(wrong)?;
        Ok(options)
    }

    fn check(&self) -> Result<(), &'static str> {
        let is_compared =
            self.text.is_some() || self.from.is_some() || self.to.is_some() || self.pack_by_text;
        let has_evidence = self.file.is_some() || !self.command.is_empty();
        if self.profile.is_none() {
            return Err("missing field `profile`");
        }
        if is_compared && !has_evidence {
            return Err("text, from, to and pack-by-text are for what is read; set file or command too");
        }
        if self.command.first().is_some_and(|program| !program.starts_with('/')) {
            return Err("the first word of command is not the whole path of a program; write it from / on");
        }
        if self.from.zip(self.to).is_some_and(|(from, to)| from > to) {
            return Err("from is above to, so that no number fits");
        }
        Ok(())
    }

    /// The rule for a gauge's owner.
    pub(super) fn rule(&self) -> Rule {
        let file = self.file.clone().map(Evidence::File);
        let command = Some(self.command.clone()).filter(|words| !words.is_empty()).map(Evidence::Command);
        Rule {
            chip: self.chip,
            chem_id: self.chem_id,
            firmware: self.firmware,
            evidence: file.or(command),
            text: self.text.clone(),
            from: self.from,
            to: self.to,
            profile: self.profile.as_deref().unwrap_or(Path::new("")).into(),
            pack: self.pack.clone(),
            pack_by_text: self.pack_by_text,
        }
    }
}

/// Whether a program decides which profile a gauge gets.
pub(super) fn runs(options: &GaugeOptions) -> bool {
    options.choose.iter().any(|rule| matches!(rule.evidence, Some(Evidence::Command(_))))
}

/// Makes the paths of a gauge's rules absolute that are relative to `folder`.
pub(super) fn make_absolute(options: &mut GaugeOptions, folder: &Path) -> Result<(), Error> {
    options.choose.iter_mut().try_for_each(|rule| {
        super::absolute(&mut rule.profile, folder)?;
        match &mut rule.evidence {
            Some(Evidence::File(path)) => super::absolute(path, folder),
            Some(Evidence::Command(_)) | None => Ok(()),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use toml::de::DeTable;

    fn refused(rule: &str) -> String {
        let text = format!("[[choose]]\n{rule}");
        let table = DeTable::parse(&text).expect("TOML").into_inner();
        let (_, rules) = table.into_iter().next().expect("a key");
        match ChoiceOptions::read(rules.get_ref()) {
            Ok(_) => String::new(),
            Err(Wrong { why, within }) => {
                let (key, at) = within.expect("a place");
                format!("line {} {key}: {why}", 1 + text[..at].matches('\n').count())
            }
        }
    }

    #[test]
    fn a_rule_is_read_strictly() {
        assert_eq!(refused("profile = 'a'\nchem-id = '1202'\n"), "");
        assert_eq!(refused("profile = 'a'\nfile = '/x'\nfrom = 1.5\nto = '2'\npack = 'A'\n"), "");
        for (rule, says) in [
            ("chem-id = 0x1202", "line 1 choose: missing field `profile`"),
            ("profile = 'a'\nchem-id = 'none'", "line 3 chem-id: expected up to four hexadecimal digits"),
            ("profile = 'a'\nchemid = 1", "line 3 chemid: unknown key; did you mean `chem-id`?"),
            (
                "profile = 'a'\nresistor = 1",
                "line 3 resistor: unknown key; known below [[gauge.choose]] are chip,",
            ),
            (
                "profile = 'a'\nfrom = 3",
                "line 1 choose: text, from, to and pack-by-text are for what is read",
            ),
            ("profile = 'a'\nfile = '/x'\nfrom = 3\nto = 2", "line 1 choose: from is above to"),
            ("profile = 'a'\nfile = '/x'\nfrom = 'nan'", "line 4 from: expected a number"),
            ("profile = 'a'\nfile = '/x'\ncommand = ['/y']", "line 4 command: cannot be combined with file"),
            (
                "profile = 'a'\ncommand = ['y']",
                "line 1 choose: the first word of command is not the whole path",
            ),
            ("profile = 'a'\ncommand = '/y'", "line 3 command: expected an array of strings"),
        ] {
            let error = refused(rule);
            assert!(error.starts_with(says), "{rule}: {error}");
        }
    }
}
