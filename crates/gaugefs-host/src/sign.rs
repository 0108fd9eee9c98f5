// SPDX-License-Identifier: MIT

//! What a slot of a production line shows: the station says it, and the screen draws it.

/// What a slot shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sign {
    /// A pack may be connected.
    Connect,
    /// Something is scanned or typed for it now.
    Scan,
    /// Somebody has to look at it, and to do what the line says.
    Look,
    /// It waits for another slot.
    Wait,
    /// The pack must not be removed.
    Busy,
    /// The pack has passed, and may be taken off.
    Pass,
    /// It has not.
    Fail,
    /// No pack is begun here any more.
    Over,
}
