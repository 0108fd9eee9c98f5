//! `gaugefs umount`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;

use super::PASSED_OVER;
use crate::daemon::mountpoint;
use crate::error::Result;
use crate::output::say;

const UMOUNT: &str = "\
It also removes a mount whose daemon has died, and by force one whose daemon does not answer within
5 s; processes that wait for that daemon then get an error. Exit code 0: unmounted, and its daemon
ends, 3: unmounted, but the daemon keeps running, because it is mounted elsewhere, 1: failed.";

/// Unmount and release the gauge
#[derive(Args, Debug)]
#[command(after_help = UMOUNT)]
pub(super) struct Umount {
    /// Folder where gaugefs is mounted
    mountpoint: PathBuf,
}

impl Umount {
    pub(super) fn run(self) -> Result<ExitCode> {
        let Some(why) = mountpoint::unmount(&self.mountpoint)? else { return Ok(ExitCode::SUCCESS) };
        say(format_args!(
            "{}: unmounted here, but its daemon keeps running: {why}",
            self.mountpoint.display()
        ));
        Ok(PASSED_OVER.into())
    }
}
