// SPDX-License-Identifier: MIT

//! The profile of a gauge whose data memory is RAM: a given one, or one that is chosen by what the pack shows.

use super::Presence;
use super::handle::Shared;
use crate::choose::{Choice, Undecided, choose};
use crate::evidence::{Evidence, Looks};
use ti_gauge::dataflash::Change;
use ti_gauge::epoch::Fact;

#[derive(Debug)]
pub(super) struct Profile {
    /// See [`super::Run::profile`]; the chosen profile, where there are several.
    changes: Vec<Change>,
    /// See [`super::Run::choices`].
    choices: Vec<Choice>,
    /// The choice was made for this gauge, which nobody may have exchanged since.
    chosen: Fact<(), Presence>,
    /// The chosen profile and the reason, for messages; empty if nothing was chosen.
    why: String,
    /// Looks at what it is chosen by.
    looks: Looks,
}

#[derive(Debug)]
pub(super) struct Pack {
    pub(super) name: Option<String>,
    /// The pack itself shows that name, wherever it is.
    pub(super) anywhere: bool,
}

impl Profile {
    pub(super) fn new(changes: Vec<Change>, choices: Vec<Choice>) -> Self {
        Self { changes, choices, chosen: Fact::default(), why: String::new(), looks: Looks::default() }
    }

    pub(super) fn changes(&self) -> &[Change] {
        &self.changes
    }

    pub(super) fn why(&self) -> &str {
        &self.why
    }

    pub(super) fn is_choice(&self) -> bool {
        !self.choices.is_empty()
    }

    pub(super) fn of_choices(&self) -> impl Iterator<Item = &Change> {
        self.choices.iter().flat_map(|choice| &choice.profile)
    }

    /// The pack may have been exchanged: the choice is made again, by new looks.
    pub(super) fn doubt(&mut self) {
        self.chosen = Fact::default();
        self.look_again();
    }

    /// The pack may have been exchanged since the looks at it were begun.
    pub(super) fn look_again(&mut self) {
        self.looks.forget();
    }

    /// Makes the choice. Returns the pack that it was made for; `None` without a choice, or if the last one holds.
    pub(super) fn choose(&mut self, shared: &Shared, is_lost: bool) -> Result<Option<Pack>, Undecided> {
        let published = shared.published();
        if self.choices.is_empty() || !is_lost && self.chosen.is_known(published.presence) {
            return Ok(None);
        }
        let (name, looks) = (shared.name(), &mut self.looks);
        let deadline = looks.deadline();
        let look = |evidence: &Evidence| looks.at(evidence, name, deadline);
        let chosen = choose(&self.choices, &published.answers, look);
        // The last choice may be for another pack.
        let chosen = chosen.inspect_err(|_| (self.changes, self.why) = (Vec::new(), String::new()))?;
        let pack = chosen.pack.as_ref().map_or(String::new(), |pack| format!(" of the pack {pack}"));
        let why = format!("profile {}{pack}: {}", chosen.choice.rule.profile.display(), chosen.why);
        if self.why != why {
            log::info!("{}: {why}", shared.name());
        }
        self.changes = chosen.choice.profile.clone();
        self.why = why;
        self.chosen.learn(published.presence, ());
        Ok(Some(Pack { name: chosen.pack, anywhere: chosen.choice.rule.pack_by_text }))
    }
}
