// SPDX-License-Identifier: MIT

//! What tests of the engine share, beside the rig. A test file uses this room, and no other test file.

mod bus;
mod disk;
mod drawn;
mod power;
mod settling;

pub(crate) use disk::{State, on_disk};
pub(crate) use drawn::{drawn, one_in};
pub(crate) use power::{CASES, Case, Folder, PowerCut, host, restart, until_cut};
pub(crate) use settling::{RESET, Transferred, cut, half_way, programs, two_blocks};
