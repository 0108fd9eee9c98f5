// SPDX-License-Identifier: MIT

//! A progress bar on the terminal while an import programs blocks.

use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::output::{errors_are_seen, print_error};
use gaugefs_client::Gauge;

/// Interval of reads of `df/transaction`, which cause no bus traffic.
const INTERVAL: Duration = Duration::from_millis(100);
/// In characters.
const WIDTH: u32 = 30;

/// A bar that follows `df/transaction` during a commit.
pub(super) struct Bar(Option<(Sender<()>, JoinHandle<()>)>);

impl Bar {
    /// Starts the bar if standard error is a terminal.
    pub(super) fn start(gauge: &Gauge) -> Self {
        if !errors_are_seen() {
            return Self(None);
        }
        let gauge = gauge.clone();
        let (end, ended) = mpsc::channel::<()>();
        let thread = std::thread::spawn(move || {
            let mut shown = false;
            while ended.recv_timeout(INTERVAL) == Err(RecvTimeoutError::Timeout) {
                if let Some(bar) = gauge.text("df/transaction").ok().as_deref().and_then(line) {
                    shown = true;
                    print_error(&format!("\r{bar}"));
                }
            }
            if shown {
                print_error("\r\x1b[K");
            }
        });
        Self(Some((end, thread)))
    }

    pub(super) fn end(self) {
        if let Some((end, thread)) = self.0 {
            drop(end);
            let _ = thread.join();
        }
    }
}

/// The line for `committing 12/40`, or for `saving 12/40`.
fn line(text: &str) -> Option<String> {
    let (phase, blocks) = text.trim().split_once(' ')?;
    let (done, all) = blocks.split_once('/')?;
    let what = match phase {
        "committing" => "blocks",
        "saving" => "blocks saved before the first write",
        _ => return None,
    };
    let (done, all): (u32, u32) = (done.parse().ok()?, all.parse().ok()?);
    let filled = done.min(all) * WIDTH / all.max(1);
    let bar: String = (0..WIDTH).map(|at| if at < filled { '#' } else { '.' }).collect();
    Some(format!("[{bar}] {done} of {all} {what}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bar_shows_the_share_of_programmed_blocks() {
        assert_eq!(line("idle\n"), None);
        assert_eq!(line("committing x/3\n"), None);
        assert_eq!(
            line("saving 1/3\n").as_deref(),
            Some("[##########....................] 1 of 3 blocks saved before the first write")
        );
        assert_eq!(
            line("committing 0/3\n").as_deref(),
            Some("[..............................] 0 of 3 blocks")
        );
        assert_eq!(
            line("committing 1/3\n").as_deref(),
            Some("[##########....................] 1 of 3 blocks")
        );
        assert_eq!(
            line("committing 3/3\n").as_deref(),
            Some("[##############################] 3 of 3 blocks")
        );
    }
}
