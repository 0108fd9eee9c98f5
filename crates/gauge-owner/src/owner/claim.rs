// SPDX-License-Identifier: MIT

//! The names of the packs that the gauges of this host have now: one pack is never in two bays.
//!
//! A lock on one byte of a file beside what is learned, for as long as its holder runs; each host has its own bytes.

use std::fs::{self, DirBuilder, File};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _, fchown};
use std::path::Path;

use gauge_bus::regular;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc;
use nix::unistd::geteuid;
use ti_gauge::journal::Machine;

/// The file, and half of the bytes that are locked in it at most.
const NAME: &str = "packs";
const BYTES: u64 = 1 << 29;

#[derive(Debug)]
pub(super) struct Claim {
    file: File,
    pack: String,
    anywhere: bool,
}

impl Claim {
    /// `None` without a lock. With `anywhere` the pack itself shows its name; other names belong to their places.
    pub(super) fn new(folder: &Path, chip: &str, pack: &str, anywhere: bool) -> Option<Self> {
        DirBuilder::new().recursive(true).mode(0o700).create(folder).ok()?;
        let mut options = File::options();
        options.read(true).write(true).create(true).mode(0o600);
        let file = regular::open(&options, &folder.join(NAME)).ok()?;
        if geteuid().is_root() {
            let owner = fs::metadata(folder).ok()?;
            fchown(&file, Some(owner.uid()), Some(owner.gid())).ok()?;
        }
        let claim = Self { file, pack: format!("{chip} {pack}"), anywhere };
        let own = claim.lock(libc::F_RDLCK, if anywhere { 1..2 } else { 0..1 });
        fcntl(&claim.file, FcntlArg::F_OFD_SETLK(&own)).ok()?;
        Some(claim)
    }

    pub(super) fn is_of(&self, chip: &str, pack: &str, anywhere: bool) -> bool {
        self.pack == format!("{chip} {pack}") && self.anywhere == anywhere
    }

    pub(super) fn is_contested(&self) -> bool {
        let mut others = self.lock(libc::F_WRLCK, if self.anywhere { 0..2 } else { 1..2 });
        let asked = fcntl(&self.file, FcntlArg::F_OFD_GETLK(&mut others));
        asked.is_ok() && i32::from(others.l_type) != libc::F_UNLCK
    }

    /// A lock on some of the two bytes of the name.
    fn lock(&self, kind: i32, bytes: std::ops::Range<i32>) -> libc::flock {
        let name = format!("{} {}", Machine::this().boot(), self.pack);
        let hash = name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
        });
        let start = 2 * (hash % BYTES) as i32 + bytes.start;
        libc::flock {
            l_type: kind as libc::c_short,
            l_whence: libc::SEEK_SET as libc::c_short,
            l_start: start.into(),
            l_len: (bytes.end - bytes.start).into(),
            l_pid: 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_gauges_with_one_pack_know_of_each_other() {
        let folder = std::env::temp_dir().join(format!("gaugefs-claim-{}", std::process::id()));
        let claim = |pack: &str, anywhere| Claim::new(&folder, "bq27441-g1", pack, anywhere).expect("a lock");
        let (fixed, other) = (claim("A", false), claim("B", true));
        let elsewhere = claim("A", false);
        assert!([&fixed, &other, &elsewhere].iter().all(|claim| !claim.is_contested()));
        let shown = claim("A", true);
        assert!([&fixed, &elsewhere, &shown].iter().all(|claim| claim.is_contested()));
        assert!(!other.is_contested());
        drop((fixed, elsewhere));
        assert!(!shown.is_contested());
        let again = claim("A", true);
        assert!(shown.is_contested() && again.is_contested());
        drop(shown);
        assert!(!again.is_contested());
        fs::remove_dir_all(folder).expect("it is there");
    }
}
