// SPDX-License-Identifier: MIT

//! What a gauge has of a change of keys that another process has begun.

use zeroize::Zeroizing;

use super::beside::{another, restore_rows, same_pack};
use super::remedy::{still_lost, way_out};
use super::ring::{ERASED, LENGTH_OF_KEY, SEALS, unstored};
use super::row::offset;
use crate::chip::KeyBlock;
use crate::codec::WINDOW;
use crate::dataflash::keyrow::quietly;
use crate::dataflash::pack::Match;
use crate::dataflash::schemes::{Care, sequence};
use crate::dataflash::session::Session;
use crate::dataflash::verdict::Verdict;
use crate::dataflash::window::locate;
use crate::error::Result;
use crate::gauge::{Gauge, Seal};
use crate::journal::{Identity, KeyPlan, Plan};
use crate::keys::{Name, Secret};

#[derive(Clone, Copy, PartialEq, Eq)]
enum Has {
    Mine,
    Erased,
    Neither,
    Unknown,
}

/// Finds out with the mount's keys what another process's change left. Writes only what was erased beside the keys.
#[expect(clippy::too_many_arguments, reason = "all that is known of an interrupted change")]
pub(super) fn probe(
    gauge: &mut Gauge,
    block: &KeyBlock,
    plan: &Plan,
    key: &KeyPlan,
    identities: [&Identity; 2],
    watched: bool,
    found: Seal,
    session: &mut Session,
) -> Result<Verdict> {
    let (mut has, now) = tried(gauge, key, found)?;
    let (mut lost, mut same) = (None, Match::Weak);
    if now != Seal::Sealed {
        sequence(gauge).enable(gauge)?;
        same = same_pack(gauge, identities, plan)?;
        if let Match::Other(name) = &same {
            return Ok(Verdict::Undecided(another(name)));
        }
    }
    if now == Seal::FullAccess {
        let row = quietly(gauge, |gauge| Row::read(gauge, block))?;
        has = SEALS.map(|name| row.seal_key(gauge, key, name));
        lost = Some(row.authentication(gauge, key));
        if has == [Has::Mine; 2] && lost == Some(Has::Mine) {
            restore_rows(gauge, session, plan)?;
            let message = format!(
                "a change of the {} key was interrupted; the gauge has the keys of this mount",
                key.names()
            );
            return Ok(if same == Match::Certain || watched {
                Verdict::Done(message)
            } else {
                Verdict::Plausible(message)
            });
        }
        // What was begun is over, but for what was lost with it.
        let is_over = key.names.len() > 1 && key.names.contains(&Name::Authentication);
        if has == [Has::Mine; 2] && lost == Some(Has::Erased) && is_over {
            return Ok(Verdict::Undecided(still_lost(&[Name::Authentication])));
        }
        if found != Seal::Sealed && has.contains(&Has::Neither) {
            // Nobody knows whether it could be opened again.
            session.stays(now);
        }
    } else if now == Seal::Unsealed && found != Seal::Sealed {
        session.stays(now);
    }
    let keep = match session.found {
        Seal::Sealed => "",
        _ if found != Seal::Sealed => "; do not cut its power and do not seal it before",
        _ => "",
    };
    Ok(Verdict::Undecided(format!(
        "a change of the {} key was cut short while it was written; the gauge has now: {}{keep}; {}",
        key.names(),
        told(block, has, lost),
        way_out(&key.names)
    )))
}

/// Goes up from `found` with the mount's keys, or with those of erased flash. Which it took, and how far up it has come.
fn tried(gauge: &mut Gauge, key: &KeyPlan, found: Seal) -> Result<([Has; 2], Seal)> {
    let (erased, mut has, mut now) = (Secret::from([ERASED; 2]), [Has::Unknown; 2], found);
    let rungs = [(Seal::Sealed, Seal::Unsealed), (Seal::Unsealed, Seal::FullAccess)];
    for (has, (name, (from, goal))) in has.iter_mut().zip(SEALS.into_iter().zip(rungs)) {
        if now != from {
            continue;
        }
        *has = match &gauge.key(name) {
            Some(mine) if gauge.takes(mine, goal)? => {
                if mine.is_erased() && !key.erased.contains(&name) {
                    Has::Erased
                } else {
                    Has::Mine
                }
            }
            _ => {
                gauge.wait(gauge.chip.security.key_silence);
                if gauge.takes(&erased, goal)? { Has::Erased } else { Has::Neither }
            }
        };
        if *has == Has::Neither {
            break;
        }
        now = gauge.seal()?;
    }
    Ok((has, now))
}

struct Row<'a> {
    block: &'a KeyBlock,
    window: Zeroizing<[u8; WINDOW]>,
    start: usize,
}

impl<'a> Row<'a> {
    fn read(gauge: &mut Gauge, block: &'a KeyBlock) -> Result<Self> {
        let (place, start) = locate(block.subclass, block.start);
        let window = sequence(gauge).load(gauge, place, Care::Sure).map(Zeroizing::new)?;
        Ok(Self { block, window, start })
    }

    fn seal_key(&self, gauge: &Gauge, key: &KeyPlan, name: Name) -> Has {
        let at = self.start + offset(self.block, name).unwrap_or_default();
        let stored = unstored(&self.window[at..at + 4], self.block.order);
        match gauge.key(name) {
            Some(mine) if mine == stored && (!stored.is_erased() || key.erased.contains(&name)) => Has::Mine,
            _ if stored.is_erased() => Has::Erased,
            _ => Has::Neither,
        }
    }

    /// Whether the authentication key is as it was. A part without one has lost nothing.
    fn authentication(&self, gauge: &Gauge, key: &KeyPlan) -> Has {
        let Some(at) = offset(self.block, Name::Authentication) else { return Has::Mine };
        let at = self.start + at;
        let stored = Secret::of_bytes(&self.window[at..at + LENGTH_OF_KEY]);
        match gauge.key(Name::Authentication) {
            Some(mine) if mine == stored => Has::Mine,
            _ if stored.has_erased_word() && !key.erased.contains(&Name::Authentication) => Has::Erased,
            _ if key.names.contains(&Name::Authentication) => Has::Unknown,
            _ => Has::Mine,
        }
    }
}

fn told(block: &KeyBlock, has: [Has; 2], lost: Option<Has>) -> String {
    let tell = |(name, has): (Name, Has)| {
        let what = match has {
            Has::Mine => "the mount's",
            Has::Erased => "ffff ffff (erased)",
            Has::Neither => "neither the mount's nor ffff ffff",
            Has::Unknown => "not known",
        };
        format!("{} key {what}", name.as_str())
    };
    let mut keys: Vec<String> = SEALS.into_iter().zip(has).map(tell).collect();
    if block.authentication.is_some() {
        let what = match lost {
            Some(Has::Erased) => "erased, in part or as a whole",
            Some(Has::Mine) => "as it was",
            _ => "not known",
        };
        keys.push(format!("{} key {what}", Name::Authentication.as_str()));
    }
    keys.join(", ")
}
