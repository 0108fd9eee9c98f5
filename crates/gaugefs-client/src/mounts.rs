// SPDX-License-Identifier: MIT

//! Mounts by `/proc/self/mountinfo`, without a call to any mounted file system.

use std::ffi::OsString;
use std::io;
use std::os::unix::ffi::OsStringExt;
use std::path::{Path, PathBuf};

use gauge_bus::regular;

const TABLE: &str = "/proc/self/mountinfo";
/// The source of gaugefs mounts in mountinfo.
pub const SOURCE: &str = "gaugefs";

/// A line of mountinfo.
#[derive(Clone, Debug)]
pub struct Mount {
    /// The mount point.
    pub path: PathBuf,
    /// Its file system.
    pub kind: String,
    /// What is mounted.
    pub source: String,
    /// Number of the FUSE connection, for a FUSE mount.
    pub connection: Option<u64>,
    /// The user who mounted it, for a FUSE mount.
    pub owner: Option<u32>,
}

impl Mount {
    /// Whether it is gaugefs, dead or alive.
    pub fn is_gaugefs(&self) -> bool {
        self.source == SOURCE && (self.kind == "fuse" || self.kind.starts_with("fuse."))
    }
}

/// The mounts of this process, oldest first.
pub fn all() -> io::Result<Vec<Mount>> {
    Ok(parse(&regular::read(Path::new(TABLE), regular::SYSTEM)?).collect())
}

/// Mount points of gaugefs.
pub fn list() -> Vec<PathBuf> {
    let mounts = all().unwrap_or_default().into_iter();
    mounts.filter(Mount::is_gaugefs).map(|mount| mount.path).collect()
}

/// The gaugefs mount point that a path belongs to.
pub fn of(path: &Path) -> Option<PathBuf> {
    let path = std::path::absolute(path).ok()?;
    containing(all().ok()?, &path).filter(Mount::is_gaugefs).map(|mount| mount.path)
}

/// Whether gaugefs is mounted there, dead or alive.
pub fn is_gaugefs(path: &Path) -> bool {
    topmost(all().unwrap_or_default(), path).is_some_and(|mount| mount.is_gaugefs())
}

/// The file system that was mounted last at a path.
pub fn topmost(mounts: impl IntoIterator<Item = Mount>, path: &Path) -> Option<Mount> {
    mounts.into_iter().filter(|mount| mount.path == path).last()
}

/// The file system that a path belongs to.
pub fn containing(mounts: impl IntoIterator<Item = Mount>, path: &Path) -> Option<Mount> {
    let mounts = mounts.into_iter().filter(|mount| path.starts_with(&mount.path));
    mounts.max_by_key(|mount| mount.path.components().count())
}

/// The lines of mountinfo.
pub fn parse(table: &[u8]) -> impl Iterator<Item = Mount> {
    table.split(|&byte| byte == b'\n').filter_map(|line| {
        let mut fields = line.split(|&byte| byte == b' ');
        // File systems without a block device have major number 0, and FUSE names a connection after the whole number.
        let connection =
            fields.nth(2)?.strip_prefix(b"0:").and_then(|minor| str::from_utf8(minor).ok()?.parse().ok());
        let path = unescape(fields.nth(1)?);
        let mut rest = fields.skip_while(|field| *field != b"-").skip(1);
        let mut text = || Some(unescape(rest.next()?).to_string_lossy().into_owned());
        let (kind, source, options) = (text()?, text()?, text().unwrap_or_default());
        let owner = options.split(',').find_map(|option| option.strip_prefix("user_id=")?.parse().ok());
        Some(Mount { path: path.into(), kind, source, connection, owner })
    })
}

/// mountinfo writes space, tab, newline and backslash as three octal digits.
fn unescape(field: &[u8]) -> OsString {
    let mut bytes = Vec::with_capacity(field.len());
    let mut rest = field;
    while let Some(at) = rest.iter().position(|&byte| byte == b'\\') {
        let (before, after) = rest.split_at(at);
        bytes.extend_from_slice(before);
        let digits = after.get(1..4).and_then(|digits| str::from_utf8(digits).ok());
        let escaped = digits.and_then(|digits| u8::from_str_radix(digits, 8).ok());
        bytes.push(escaped.unwrap_or(b'\\'));
        rest = &after[if escaped.is_some() { 4 } else { 1 }..];
    }
    bytes.extend_from_slice(rest);
    OsString::from_vec(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINES: &[u8] = b"\
22 1 8:1 / / rw,relatime shared:1 - ext4 /dev/sda1 rw\n\
40 22 0:36 / /mnt/a\\040b rw,nosuid shared:3 master:1 - fuse.gaugefs gaugefs rw,user_id=0\n\
41 22 0:37 / /mnt/x rw - tmpfs none rw\n\
42 41 0:38 / /mnt/x rw - fuse gaugefs rw\n\
43 22 0:39 / /mnt/y rw - fuse.sshfs host:/ rw\n";

    #[test]
    fn the_topmost_mount_of_mountinfo_counts() {
        let at = |path: &str| topmost(parse(LINES), Path::new(path)).map(|mount| mount.is_gaugefs());
        assert_eq!(at("/mnt/a b"), Some(true));
        assert_eq!(at("/mnt/x"), Some(true));
        assert_eq!(at("/mnt/y"), Some(false));
        assert_eq!(at("/mnt/z"), None);
        assert_eq!(topmost(parse(LINES), Path::new("/mnt/x")).and_then(|mount| mount.connection), Some(38));
    }

    #[test]
    fn a_path_belongs_to_the_innermost_mount() {
        let kind = |path: &str| containing(parse(LINES), Path::new(path)).map(|mount| mount.kind);
        assert_eq!(kind("/etc").as_deref(), Some("ext4"));
        assert_eq!(kind("/mnt/xy").as_deref(), Some("ext4"));
        assert_eq!(kind("/mnt/x/y").as_deref(), Some("fuse"));
    }

    #[test]
    fn escapes_are_undone() {
        assert_eq!(unescape(b"/a\\040b\\134c\\"), OsString::from("/a b\\c\\"));
        assert_eq!(unescape(b"\\"), OsString::from("\\"));
        assert_eq!(unescape(b"\\04\\040\\999\\400"), OsString::from("\\04 \\999\\400"));
    }
}
