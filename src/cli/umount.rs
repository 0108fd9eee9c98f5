//! `gaugefs umount`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;

use crate::daemon::mountpoint;
use crate::error::Result;

const UMOUNT: &str = "\
It also removes a mount whose daemon has died, and by force one whose daemon does not answer within
5 s; processes that wait for that daemon then get an error.";

/// Unmount and release the gauge
#[derive(Args, Debug)]
#[command(after_help = UMOUNT)]
pub(super) struct Umount {
    /// Folder where gaugefs is mounted
    mountpoint: PathBuf,
}

impl Umount {
    pub(super) fn run(self) -> Result<ExitCode> {
        mountpoint::unmount(&self.mountpoint)?;
        Ok(ExitCode::SUCCESS)
    }
}
