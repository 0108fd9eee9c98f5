// SPDX-License-Identifier: MIT

//! For how long what is known of a gauge holds.

/// While it answers, and nobody may have exchanged it.
pub enum Presence {}

/// While nothing may have changed what data flash holds, but for what the gauge rewrites itself.
pub(super) enum Content {}
