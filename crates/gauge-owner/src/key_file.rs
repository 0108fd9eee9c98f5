// SPDX-License-Identifier: MIT

//! Where keys come from: a file that nobody else may read, or a systemd credential.

use std::fs::{File, Metadata};
use std::io::{self, Read};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use nix::errno::Errno;
use ti_gauge::keys::Keys;
use zeroize::Zeroizing;

use crate::error::{Cause, Error, Result};

/// Name of the systemd credential that takes the place of a key file.
pub const CREDENTIAL: &str = "gaugefs-keys";
/// Environment variable with the file that a unit's credential is a copy of, for messages.
const SOURCE: &str = "GAUGEFS_KEYS";
/// A key file has a few lines a gauge; more than this is some other file.
const LONGEST: usize = 16384;

/// The keys that a file has for the gauge of that name. Nobody but the file's owner may read it.
pub fn from_file(path: &Path, gauge: &str) -> Result<Keys> {
    let name = path.display().to_string();
    let (file, status) = open(path, &name)?;
    private(&status, &name)?;
    Keys::parse(&name, &read(file, &name)?, gauge)
}

/// Checks, for root, the original of a service's credential: the copy hides who may read it. A missing file is private.
pub fn check(path: &Path) -> Result<()> {
    let name = path.display().to_string();
    match open(path, &name) {
        Ok((_, status)) => private(&status, &name),
        Err(error) if error.errno() == Errno::ENOENT as i32 => Ok(()),
        Err(error) => Err(error),
    }
}

fn private(status: &Metadata, name: &str) -> Result<()> {
    let me = nix::unistd::geteuid().as_raw();
    let refuse = |why: String| Err(Error::new(name, Cause::NotPermitted, why));
    if status.uid() != me && status.uid() != 0 {
        return refuse(format!("the key file belongs to user {}; it must be yours or root's", status.uid()));
    }
    if status.mode() & 0o077 != 0 {
        let mode = status.mode() & 0o777;
        return refuse(format!("others may read the key file (mode {mode:03o}); chmod 600 {name}"));
    }
    Ok(())
}

/// The keys that systemd hands to the service for that gauge, if any. The unit has checked the original with [`check`].
pub fn from_credential(gauge: &str) -> Result<Option<Keys>> {
    let Some(path) = credential().filter(|path| path.exists()) else { return Ok(None) };
    let name = of_credential().unwrap_or_else(|| path.display().to_string());
    let (file, _) = open(&path, &name)?;
    Ok(Some(Keys::parse(&name, &read(file, &name)?, gauge)?))
}

/// The file that the credential is a copy of, where this process has a credential and the unit names its file.
pub fn of_credential() -> Option<String> {
    credential().and_then(|_| std::env::var(SOURCE).ok())
}

fn credential() -> Option<PathBuf> {
    std::env::var_os("CREDENTIALS_DIRECTORY").map(|folder| PathBuf::from(folder).join(CREDENTIAL))
}

/// Refuses standard input: who else has seen what comes from there cannot be checked.
pub fn check_name(path: Option<&Path>) -> Result<()> {
    match path {
        Some(path) if path == Path::new("-") => {
            let why = "keys are not read from it; name a file that nobody else may read";
            Err(Error::new("standard input", Cause::Invalid, why))
        }
        _ => Ok(()),
    }
}

fn open(path: &Path, name: &str) -> Result<(File, Metadata)> {
    check_name(Some(path))?;
    let failed = |error: io::Error| Error::io(name, "cannot read the key file", &error);
    // A fifo must not keep the open waiting.
    let mut options = File::options();
    options.read(true).custom_flags(nix::libc::O_NONBLOCK | nix::libc::O_NOCTTY);
    let file = options.open(path).map_err(failed)?;
    let status = file.metadata().map_err(failed)?;
    if !status.is_file() {
        return Err(Error::host(name, Errno::EINVAL, "not a file, so not a key file"));
    }
    Ok((file, status))
}

#[expect(clippy::disallowed_methods, reason = "it is limited, and the only copy is wiped")]
fn read(file: File, name: &str) -> Result<Zeroizing<Vec<u8>>> {
    // Reserved at once: growing would leave copies behind that nobody wipes.
    let mut text = Zeroizing::new(Vec::with_capacity(LONGEST + 1));
    file.take(LONGEST as u64 + 1)
        .read_to_end(&mut text)
        .map_err(|error| Error::io(name, "cannot read the key file", &error))?;
    if text.len() > LONGEST {
        return Err(Error::new(name, Cause::Invalid, "too long for a key file"));
    }
    Ok(text)
}
