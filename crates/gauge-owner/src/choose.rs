// SPDX-License-Identifier: MIT

//! Chooses a gauge's profile. Rules are tried in order; the first match wins. They look at answers, a file or a program.

use std::io::{self, ErrorKind};
use std::path::PathBuf;

use crate::evidence::Evidence;
use ti_gauge::chip::{Answers, Chip};
use ti_gauge::dataflash::Change;
use ti_gauge::keys;

/// A rule: a profile, and its conditions. Without a condition it always fits.
#[derive(Clone, Debug, Default)]
pub struct Rule {
    /// The part.
    pub chip: Option<&'static Chip>,
    /// Control(CHEM_ID).
    pub chem_id: Option<u16>,
    /// Control(FW_VERSION).
    pub firmware: Option<u16>,
    /// Where the pack shows what it is.
    pub evidence: Option<Evidence>,
    /// What must be found there; without it, only that something can be read.
    pub text: Option<String>,
    /// The least number that must be found there.
    pub from: Option<f64>,
    /// The greatest number that must be found there.
    pub to: Option<f64>,
    /// The profile.
    pub profile: PathBuf,
    /// The name of the pack.
    pub pack: Option<String>,
    /// What is found there is the name of the pack.
    pub pack_by_text: bool,
}

/// A rule with the content of its profile.
#[derive(Clone, Debug)]
pub struct Choice {
    /// The rule.
    pub rule: Rule,
    /// The profile, as changes to data memory.
    pub profile: Vec<Change>,
}

/// What was chosen, and why.
pub(crate) struct Chosen<'a> {
    pub(crate) choice: &'a Choice,
    pub(crate) pack: Option<String>,
    pub(crate) why: String,
}

#[derive(Debug)]
pub(crate) struct Undecided {
    pub(crate) why: String,
    /// What decides it is still being looked at.
    pub(crate) is_pending: bool,
}

impl From<String> for Undecided {
    fn from(why: String) -> Self {
        Self { why, is_pending: false }
    }
}

/// The first choice that fits these answers. An error: no rule fits, or one is undecided, and later ones must not count.
pub(crate) fn choose<'a>(
    choices: &'a [Choice],
    answers: &Answers,
    mut look: impl FnMut(&Evidence) -> io::Result<Vec<String>>,
) -> Result<Chosen<'a>, Undecided> {
    // Rules may share a converter, or a program.
    let mut read: Vec<(&Evidence, Vec<String>)> = Vec::new();
    for choice in choices {
        let rule = &choice.rule;
        let fits = |wanted: Option<u16>, found| wanted.is_none_or(|wanted| Some(wanted) == found);
        if !fits(rule.chem_id, answers.chem_id) || !fits(rule.firmware, Some(answers.firmware_version)) {
            continue;
        }
        let Some(evidence) = &rule.evidence else {
            let why = "no rule before it fits".into();
            return Ok(Chosen { choice, pack: rule.pack.clone(), why });
        };
        let known = read.iter().find(|(other, _)| *other == evidence);
        let found = match known {
            Some((_, found)) => found.clone(),
            None => {
                let found = look(evidence).map_err(|error| Undecided {
                    why: format!("{evidence}: {error}"),
                    is_pending: error.kind() == ErrorKind::WouldBlock,
                })?;
                read.push((evidence, found.clone()));
                found
            }
        };
        let fitting = found.iter().map(|text| rule.accepts(text)).collect::<Result<Vec<bool>, _>>();
        let fitting = fitting.map_err(|why| format!("{evidence}: {why}"))?;
        if fitting.iter().any(|fits| *fits != fitting[0]) {
            return Err(format!("{evidence}: shows {} one after the other", found.join(", ")).into());
        }
        if fitting[0] {
            let text = &found[0];
            let pack = match rule.pack_by_text {
                false => rule.pack.clone(),
                true if keys::is_name(text) && found.iter().all(|other| other == text) => Some(text.clone()),
                true => {
                    return Err(
                        format!("{evidence}: shows {text}, which cannot be the name of a pack").into()
                    );
                }
            };
            return Ok(Chosen { choice, pack, why: format!("{evidence} shows {text}") });
        }
    }
    let chem_id = answers.chem_id.map_or(String::new(), |id| format!(", chem_id 0x{id:04x}"));
    let read: String =
        read.iter().map(|(evidence, found)| format!(", {evidence} shows {}", found[0])).collect();
    Err(format!(
        "none of its {} profiles fits: firmware 0x{:04x}{chem_id}{read}; add a rule to [[gauge.choose]]",
        choices.len(),
        answers.firmware_version
    )
    .into())
}

impl Rule {
    fn accepts(&self, found: &str) -> Result<bool, String> {
        let is_text = self.text.as_ref().is_none_or(|text| text == found);
        if self.from.is_none() && self.to.is_none() {
            return Ok(is_text);
        }
        let number = found.parse::<f64>().ok().filter(|number| number.is_finite());
        let number = number.ok_or_else(|| format!("shows {found}, which is no number"))?;
        Ok(is_text && self.from.is_none_or(|from| from <= number) && self.to.is_none_or(|to| number <= to))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rules(evidence: &Evidence) -> Vec<Choice> {
        let rule = |from: f64, to: f64, profile: &str| Rule {
            evidence: Some(evidence.clone()),
            from: Some(from),
            to: Some(to),
            profile: profile.into(),
            pack: Some(profile.to_uppercase()),
            ..Rule::default()
        };
        let rules = [
            Rule { chem_id: Some(0x1202), profile: "chem".into(), ..Rule::default() },
            rule(100.0, 200.0, "a"),
            rule(200.5, 300.0, "b"),
        ];
        rules.into_iter().map(|rule| Choice { rule, profile: Vec::new() }).collect()
    }

    fn outcome(choices: &[Choice], chem_id: u16, found: &[&str]) -> String {
        let answers = Answers { chem_id: Some(chem_id), firmware_version: 0x0202, ..Answers::default() };
        let look = |_: &Evidence| match found {
            [] => Err(ErrorKind::NotFound.into()),
            found => Ok(found.iter().map(ToString::to_string).collect()),
        };
        match choose(choices, &answers, look) {
            Ok(chosen) => format!("{} {:?}", chosen.choice.rule.profile.display(), chosen.pack),
            Err(undecided) => undecided.why,
        }
    }

    #[test]
    fn the_first_rule_that_fits_counts_and_one_that_is_undecided_ends_the_choice() {
        let choices = rules(&Evidence::File("/adc".into()));
        assert_eq!(outcome(&choices, 0x1202, &[]), "chem None");
        assert!(outcome(&choices, 0x3230, &[]).contains("/adc: entity not found"));
        for (found, expected) in [
            (&["150"; 3][..], "a Some(\"A\")"),
            (&["200.5"], "b Some(\"B\")"),
            (&["200.2"], "none of its 3 profiles fits: firmware 0x0202, chem_id 0x3230, /adc shows 200.2; "),
            (&["nonsense"], "which is no number"),
            (&["nan"], "which is no number"),
            // A reading of a converter while a contact bounces.
            (&["150", "250", "150"], "shows 150, 250, 150 one after the other"),
        ] {
            let outcome = outcome(&choices, 0x3230, found);
            assert!(outcome.contains(expected), "{found:?}: {outcome}");
        }
    }

    #[test]
    fn what_is_found_may_name_the_pack() {
        let evidence = Some(Evidence::File("/serial".into()));
        let rule = Rule { evidence, pack_by_text: true, ..Rule::default() };
        let choices = [Choice { rule, profile: Vec::new() }];
        assert_eq!(outcome(&choices, 0, &["SN-1234"]), " Some(\"SN-1234\")");
        for found in [&["../x"][..], &["SN-1", "SN-2"]] {
            let outcome = outcome(&choices, 0, found);
            assert!(outcome.contains("cannot be the name of a pack"), "{found:?}: {outcome}");
        }
    }
}
