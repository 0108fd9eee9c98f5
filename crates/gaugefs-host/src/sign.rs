// SPDX-License-Identifier: MIT

//! What a slot of a production line shows. The station sets it, and the screen draws it.

/// What a slot shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sign {
    /// Connect a pack.
    Connect,
    /// Scan or type something for the pack.
    Scan,
    /// Do what the line says.
    Look,
    /// The slot waits for another one.
    Wait,
    /// Do not remove the pack.
    Busy,
    /// Passed: take the pack off.
    Pass,
    /// Failed.
    Fail,
    /// No more packs start here.
    Over,
}
