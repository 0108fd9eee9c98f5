// SPDX-License-Identifier: MIT

//! The files of the mount, and what a call on each may answer.

use std::collections::BTreeSet;
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::time::{Duration, Instant};

use nix::errno::Errno;
use rustix::fs::OFlags;
use ti_gauge::chip::{Chip, Kind, Range, kebab_case};
use ti_gauge::value::Type;

/// What kind of file it is, as far as answers differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Class {
    Folder,
    /// A symbolic link to the first parameter.
    Link,
    /// A symbolic link to what is not in the mount.
    Outside,
    /// Public and always there.
    Steady,
    /// Public, and there while the gauge answers.
    Measured,
    /// Public, and there while the gauge predicts it.
    Fleeting,
    Parameter(usize),
    Secret,
    SecretRaw,
    Raw,
    Index,
    Transaction,
    Seal,
    Control,
    Keys,
    Authenticate,
    Settle,
    Interval,
    Refresh,
    Report,
    Knob,
    Reading,
    Missing,
}

impl Class {
    pub(super) fn mode(self) -> Option<u32> {
        Some(match self {
            // The model's mount has a group.
            Class::Folder => 0o775,
            Class::Outside => 0o777,
            Class::Steady | Class::Measured | Class::Fleeting => 0o444,
            Class::Link
            | Class::Parameter(_)
            | Class::Secret
            | Class::Transaction
            | Class::Seal
            | Class::Control
            | Class::Authenticate
            | Class::Report
            | Class::Settle
            | Class::Interval
            | Class::Knob => 0o660,
            Class::Raw | Class::SecretRaw | Class::Index | Class::Reading => 0o440,
            Class::Refresh => 0o220,
            Class::Keys => 0o200,
            Class::Missing => return None,
        })
    }

    pub(super) fn is_secret(self) -> bool {
        matches!(self, Class::Secret | Class::SecretRaw)
    }

    /// What is opened by its path.
    pub(super) fn followed(self) -> Self {
        if self == Class::Link { Class::Parameter(0) } else { self }
    }
}

/// A parameter, and what it may hold. That is one value, unless an answer has left it open.
pub(super) struct Parameter {
    pub(super) place: String,
    /// What a line of `df/transaction` may name it: its place, its names below `df` and `df/by-name`, and where no other
    /// class has one of that name, its own.
    pub(super) names: Vec<String>,
    pub(super) name: &'static str,
    /// Smallest and largest value; `None` for a text of that many characters.
    pub(super) range: Result<(i64, i64), usize>,
    pub(super) values: BTreeSet<String>,
    /// Every value that it has had, which a file that is held open may still show.
    pub(super) history: BTreeSet<String>,
}

/// What a text is to a parameter.
pub(super) enum Verdict {
    /// A value, which reads like this.
    Value(String),
    Refused(Errno),
}

pub(super) struct OpenFile {
    pub(super) fd: Arc<OwnedFd>,
    pub(super) class: Class,
    pub(super) flags: OFlags,
    /// The gauge was disturbed while it was open.
    pub(super) disturbed: bool,
    pub(super) opened: Instant,
    /// What was last written through it: the kernel's page keeps that, over what was there, until the file is read.
    pub(super) written: Option<String>,
}

impl OpenFile {
    /// Whether gaugefs may have forgotten it: a page of it is then an error until read(2) asks for its size first.
    pub(super) fn may_rest(&self) -> bool {
        self.opened.elapsed() > Duration::from_millis(200)
    }
}

/// What a call may answer.
#[derive(Default, Debug)]
pub(super) struct Expected {
    pub(super) may: Vec<Errno>,
    pub(super) fails: bool,
}

impl Expected {
    pub(super) fn success() -> Self {
        Self::default()
    }

    /// Fails with one of these.
    pub(super) fn failure(may: &[Errno]) -> Self {
        Self { may: may.to_vec(), fails: true }
    }

    pub(super) fn or_if(mut self, refused: bool, errno: Errno) -> Self {
        if refused {
            self.may.push(errno);
            self.fails = true;
        }
        self
    }

    pub(super) fn perhaps(mut self, errnos: &[Errno]) -> Self {
        self.may.extend(errnos);
        self
    }
}

/// Parameters without special rules: any value of their range can be written at any time.
pub(super) fn parameters(chip: &'static Chip) -> Vec<Parameter> {
    let rows = chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security);
    let rows = rows.flat_map(|subclass| subclass.parameters.iter().map(move |row| (subclass, row)));
    let plain = rows.filter(|(_, row)| !row.learned && !row.unproven && row.safe.is_none());
    let mut found: Vec<_> = plain
        .filter(|(subclass, row)| [80, 48, 32, 49].contains(&subclass.id) && row.bits.is_empty())
        .filter_map(|(subclass, row)| {
            let range = match (&row.range, row.kind) {
                (Range::Int { min, max, .. }, Type::I(_) | Type::U(_)) => Ok((*min, *max)),
                (Range::Text { .. }, Type::S(size)) => Err(usize::from(size) - 1),
                _ => return None,
            };
            let place = format!("{}/{}", subclass.id, row.offset);
            let own = kebab_case(row.name);
            let all = chip.subclasses.iter().flat_map(|subclass| subclass.parameters);
            let is_only = all.filter(|other| kebab_case(other.name) == own).count() == 1;
            let whole = format!("{}/{own}", chip.class_dir(subclass));
            let mut names = vec![place.clone(), format!("by-name/{whole}"), whole.to_uppercase(), whole];
            names.extend(is_only.then_some(own));
            Some(Parameter {
                place,
                names,
                name: row.name,
                range,
                values: BTreeSet::new(),
                history: BTreeSet::new(),
            })
        })
        .collect();
    // The link leads to the first one.
    let first = found.iter().position(|one| one.place == "80/53").expect("the bq34z100-G1 has it");
    found.swap(0, first);
    found.truncate(14);
    found
}
