// SPDX-License-Identifier: MIT

//! Tests in a mount namespace of their own.

use nix::mount::{MntFlags, MsFlags, mount, umount2};

/// Detaches the mounts of gaugefs that this mount namespace, which is new, has copies of: they are of other tests, whose
/// daemons they would keep running.
pub(crate) fn drop_copied_mounts() {
    const NONE: Option<&str> = None;
    mount(NONE, "/", NONE, MsFlags::MS_REC | MsFlags::MS_PRIVATE, NONE).expect("root may");
    for path in gaugefs_client::mounts::list() {
        let _ = umount2(&path, MntFlags::MNT_DETACH);
    }
}
