// SPDX-License-Identifier: MIT

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
5 s; processes that wait for that daemon then get an error. What is owed to a gauge, such as a seal, is
tried once more before. Exit code 0: unmounted, and its daemon ends, 3: unmounted, but the daemon keeps
running, because it is mounted elsewhere, 1: failed, or unmounted while something is still owed, which is
printed.";

/// Unmount and release the gauge
#[derive(Args, Debug)]
#[command(after_help = UMOUNT)]
pub(super) struct Umount {
    /// Folder where gaugefs is mounted
    mountpoint: PathBuf,
}

impl Umount {
    pub(super) fn run(self) -> Result<ExitCode> {
        let done = mountpoint::unmount(&self.mountpoint)?;
        for line in &done.owed {
            say(format_args!("{line}"));
        }
        if !done.owed.is_empty() {
            let at = self.mountpoint.display();
            say(format_args!("{at}: it is unmounted now; what is owed is settled when it is mounted again"));
        }
        if let Some(why) = &done.elsewhere {
            say(format_args!(
                "{}: unmounted here, but its daemon keeps running: {why}",
                self.mountpoint.display()
            ));
        }
        Ok(match (done.owed.is_empty(), done.elsewhere) {
            (false, _) => ExitCode::FAILURE,
            (true, Some(_)) => PASSED_OVER.into(),
            (true, None) => ExitCode::SUCCESS,
        })
    }
}
