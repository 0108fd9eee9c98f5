// SPDX-License-Identifier: MIT

//! What has become of an interrupted write.

use super::session::reads_wrong;
use crate::error::{Error, Reason, Step};

pub(super) enum Verdict {
    /// It has been settled; the text says how.
    Done(String),
    /// All old values or all new ones; the gauge is not certainly the one of the write, so its journal waits.
    Plausible(String),
    /// The write was begun on another gauge, whose journal is left alone.
    Another,
    /// Nothing was touched; the text says why.
    Undecided(String),
}

/// What is not back. If it was stored and reads otherwise, trying again programs it again.
pub(super) fn unrestored(error: Error) -> Error {
    let is_stored = reads_wrong(&error);
    let unknown = Error::of("", Reason::NotSettled { failed: error });
    if is_stored { unknown.at(Step::Restore) } else { unknown }
}
