// SPDX-License-Identifier: MIT

//! A Smart Battery of four cells, by the Smart Battery Data Specification 1.1.

use super::part::{Part, Scheme};
use super::timing::Timing;

pub(super) static PART: Part =
    Part { name: "sbs", image: &[], timing: Timing::USUAL, scheme: Scheme::Smbus(None), rewrites: &[] };
