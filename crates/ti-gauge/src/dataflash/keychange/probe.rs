// SPDX-License-Identifier: MIT

//! What a gauge has of a change of keys that another process has begun.

use zeroize::Zeroizing;

use super::beside::{another, restore_rows, same_pack};
use super::remedy::{still_lost, way_out};
use super::ring::{ERASED, LENGTH_OF_KEY, SEALS, unstored};
use crate::chip::KeyBlock;
use crate::dataflash::keyrow::quietly;
use crate::dataflash::pack::Match;
use crate::dataflash::schemes::sequence;
use crate::dataflash::session::Session;
use crate::dataflash::verdict::Verdict;
use crate::dataflash::window::locate;
use crate::error::Result;
use crate::gauge::{Gauge, Seal};
use crate::journal::{Identity, KeyPlan, Plan};
use crate::keys::{Name, Secret};

/// Which of the keys that are known the gauge took.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Has {
    /// The mount's.
    Mine,
    Erased,
    Neither,
    /// It was not asked.
    Unknown,
}

/// Finds out which keys a gauge has on which another process has begun a change, with the keys of this one. Only reads,
/// but for what was erased beside the keys of what is certainly the same pack.
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
    let (erased, mut has, mut now) = (Secret::from([ERASED; 2]), [Has::Unknown; 2], found);
    for (at, (name, goal)) in
        [(Name::Unseal, Seal::Unsealed), (Name::FullAccess, Seal::FullAccess)].into_iter().enumerate()
    {
        if now != [Seal::Sealed, Seal::Unsealed][at] {
            continue;
        }
        let mine = gauge.key(name);
        has[at] = match &mine {
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
        if has[at] == Has::Neither {
            break;
        }
        now = gauge.seal()?;
    }
    let (mut lost, mut same) = (None, Match::Weak);
    if now != Seal::Sealed {
        sequence(gauge).enable(gauge)?;
        same = same_pack(gauge, identities, plan)?;
        if let Match::Other(name) = &same {
            return Ok(Verdict::Undecided(another(name)));
        }
    }
    if now == Seal::FullAccess {
        let (place, start) = locate(block.subclass, block.start);
        let row = quietly(gauge, |gauge| sequence(gauge).load(gauge, place).map(Zeroizing::new))?;
        for (has, (name, at)) in
            has.iter_mut().zip([(Name::Unseal, block.unseal), (Name::FullAccess, block.full_access)])
        {
            let stored = unstored(&row[start + at..start + at + 4], block.order);
            *has = match gauge.key(name) {
                Some(mine) if mine == stored && (!stored.is_erased() || key.erased.contains(&name)) => {
                    Has::Mine
                }
                _ if stored.is_erased() => Has::Erased,
                _ => Has::Neither,
            };
        }
        lost = Some(
            match block
                .authentication
                .map(|at| Secret::of_bytes(&row[start + at..start + at + LENGTH_OF_KEY]))
            {
                None => Has::Mine,
                Some(stored) => match gauge.key(Name::Authentication) {
                    Some(mine) if mine == stored => Has::Mine,
                    _ if stored.has_erased_word() && !key.erased.contains(&Name::Authentication) => {
                        Has::Erased
                    }
                    _ if key.names.contains(&Name::Authentication) => Has::Unknown,
                    _ => Has::Mine,
                },
            },
        );
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
    let tell = |name: Name, has: Has| {
        let what = match has {
            Has::Mine => "the mount's",
            Has::Erased => "ffff ffff (erased)",
            Has::Neither => "neither the mount's nor ffff ffff",
            Has::Unknown => "not known",
        };
        format!("{} key {what}", name.as_str())
    };
    let mut keys: Vec<String> = SEALS.into_iter().zip(has).map(|(name, has)| tell(name, has)).collect();
    if block.authentication.is_some() {
        keys.push(match lost {
            Some(Has::Erased) => "authentication key erased, in part or as a whole".into(),
            _ => tell(Name::Authentication, if lost == Some(Has::Mine) { Has::Mine } else { Has::Unknown })
                .replace("the mount's", "as it was"),
        });
    }
    let keep = match session.found {
        Seal::Sealed => "",
        _ if found != Seal::Sealed => "; do not cut its power and do not seal it before",
        _ => "",
    };
    Ok(Verdict::Undecided(format!(
        "a change of the {} key was cut short while it was written; the gauge has now: {}{keep}; {}",
        key.names(),
        keys.join(", "),
        way_out(&key.names)
    )))
}
