//! Key words, which appear nowhere: not in a log, a trace, an error or a process list.

use std::fmt;

/// The keys of one gauge.
#[derive(Clone, Default)]
pub struct Keys {
    /// The two words that unseal, in the order they are sent.
    pub unseal: Option<[u16; 2]>,
    /// The two words that lead from UNSEALED to FULL ACCESS.
    pub full_access: Option<[u16; 2]>,
    /// Whether the manual's default keys must not be tried where none is given.
    pub no_default: bool,
}

impl fmt::Debug for Keys {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Keys { hidden }")
    }
}
