// SPDX-License-Identifier: MIT

//! Tests in a mount namespace of their own.

use std::fs;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};

use nix::mount::{MntFlags, MsFlags, mount, umount2};
use nix::sched::{CloneFlags, unshare};
use nix::sys::stat::{Mode, SFlag, mknod};
use nix::unistd::geteuid;

use super::Folder;

/// Detaches the mounts of gaugefs that this mount namespace, which is new, has copies of: they are of other tests, whose
/// daemons they would keep running.
pub(crate) fn drop_copied_mounts() {
    const NONE: Option<&str> = None;
    mount(NONE, "/", NONE, MsFlags::MS_REC | MsFlags::MS_PRIVATE, NONE).expect("root may");
    for path in gaugefs_client::mounts::list() {
        let _ = umount2(&path, MntFlags::MNT_DETACH);
    }
}

/// Moves this test into a mount namespace of its own, where root may. The namespaces that it makes would otherwise have
/// copies of the mounts of other tests, and keep their daemons running.
pub(crate) fn apart() {
    if !geteuid().is_root() || unshare(CloneFlags::CLONE_NEWNS).is_err() {
        return;
    }
    drop_copied_mounts();
}

/// Gives `/dev/fuse` the mode that udev gives it, for this test alone, which has to be root's.
pub(crate) fn open_fuse(folder: &Folder) {
    apart();
    let node = folder.file("fuse");
    let status = fs::metadata("/dev/fuse").expect("the device");
    mknod(node.as_str(), SFlag::S_IFCHR, Mode::empty(), status.rdev()).expect("root may");
    fs::set_permissions(&node, fs::Permissions::from_mode(0o666)).expect("its mode");
    mount(Some(node.as_str()), "/dev/fuse", None::<&str>, MsFlags::MS_BIND, None::<&str>).expect("root may");
}
