// SPDX-License-Identifier: MIT

//! The pack of a change of keys, and the rows beside its keys.

use crate::dataflash::job::Job;
use crate::dataflash::keyrow::quietly;
use crate::dataflash::pack::{Match, compare};
use crate::dataflash::planned::{Held, look};
use crate::dataflash::schemes::{Care, sequence};
use crate::dataflash::session::Session;
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::Gauge;
use crate::journal::{Identity, Plan};

pub(super) fn same_pack(gauge: &mut Gauge, [then, now]: [&Identity; 2], plan: &Plan) -> Result<Match> {
    compare(gauge.chip, then, now, plan, |place| sequence(gauge).load(gauge, place, Care::Sure))
}

pub(super) fn another(name: &str) -> String {
    format!("{name} is not what it was when a change of keys was cut short: this is another pack")
}

pub(super) fn restore_rows(gauge: &mut Gauge, session: &mut Session, plan: &Plan) -> Result<()> {
    if plan.blocks.is_empty() {
        return Ok(());
    }
    let seen = quietly(gauge, |gauge| look(gauge, plan))?;
    if seen.iter().any(|seen| seen.held == Held::Unexplained) && !session.decided {
        let why = "a row next to the keys has changed, which the change of keys does not touch";
        return Err(Error::new("", Cause::Protocol, why).at(Step::Restore));
    }
    let mut job = Job::interrupted(seen, false);
    if job.is_intact() {
        return Ok(());
    }
    // The keys that it took have shown that it is the one.
    session.pack.begin(gauge);
    gauge.learn_selection();
    quietly(gauge, |gauge| job.back(gauge, session, true))
}
