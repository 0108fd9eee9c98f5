// SPDX-License-Identifier: MIT

use std::fmt;
use std::path::PathBuf;

use super::seal::Level;

/// How a simulated gauge is made.
#[derive(Clone, Default)]
pub struct Options {
    /// File that keeps the flash across processes. It is created if it does not exist.
    pub state: Option<PathBuf>,
    /// The key that unseals a new gauge, in the order of its words on the wire.
    pub unseal_key: Option<[u16; 2]>,
    /// The initial seal state. By default a new gauge with RAM is UNSEALED, as after every power-up, and one with flash
    /// is SEALED.
    pub seal: Option<Level>,
    /// Seed of the random faults and of the part's offsets.
    pub seed: u64,
    /// Seed that draws one gauge from everything that real ones do: late blocks, slow commits, lost resets, values that
    /// the gauge itself rewrites, and more. Without it the gauge is friendly; each behaviour is also a knob.
    pub envelope: Option<u64>,
}

impl fmt::Debug for Options {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { state, unseal_key, seal, seed, envelope } = self;
        let key = unseal_key.map(|_| "hidden");
        let mut out = f.debug_struct("Options");
        out.field("state", state).field("unseal_key", &key).field("seal", seal);
        out.field("seed", seed).field("envelope", envelope).finish()
    }
}
