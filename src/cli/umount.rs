//! `gaugefs umount`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;

use crate::daemon::mountpoint;
use crate::error::Result;

const UMOUNT: &str = "A mount whose daemon has died is taken away too.";

/// Unmount; the gauge is let go
#[derive(Args, Debug)]
#[command(after_help = UMOUNT)]
pub(super) struct Umount {
    /// Folder that it is mounted at
    mountpoint: PathBuf,
}

impl Umount {
    pub(super) fn run(self) -> Result<ExitCode> {
        mountpoint::unmount(&self.mountpoint)?;
        Ok(ExitCode::SUCCESS)
    }
}
