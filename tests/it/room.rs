// SPDX-License-Identifier: MIT

//! What tests share: the folders that they work in, the program as a command, mounts of their own. A test file uses this
//! room, and no other test file.

mod abort;
mod apart;
mod commands;
mod documents;
pub(crate) mod ioctls;
mod mounted;
mod scratch;
mod served;
mod session;

pub(crate) use abort::Abort;
#[cfg(feature = "screen")]
pub(crate) use apart::drop_copied_mounts;
pub(crate) use apart::{apart, open_fuse};
pub(crate) use commands::{
    CHIP, Foreground, LONG, Ran, STATION, as_nobody, can_mount, command, command_of, gaugefs,
    gaugefs_station, impatient, in_real_time, read, run, same_as_golden, shown, stop, users_can_mount,
    within,
};
pub(crate) use documents::{TEXT, page, readme, root, rows, section, table, within_code};
pub(crate) use mounted::{
    Mount, Swift, errno, keeps_names, mapped, messages, quiet, statistic, swift, write_cut,
};
pub(crate) use scratch::{Connections, Folder, folder, folder_named, remove};
pub(crate) use served::Server;
pub(crate) use session::{Session, Step, steps};
