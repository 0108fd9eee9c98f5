// SPDX-License-Identifier: MIT

//! `gaugefs list`: the mounted gauges of this machine.

use std::path::Path;
use std::process::ExitCode;

use clap::Args;
use nix::errno::Errno;
use serde::Serialize;

use super::align;
use crate::daemon::look::{self, Found, Listed, Seen};
use crate::error::{Error, Result, shown};
use crate::output::{print, print_json, say};
use gaugefs_client::mounts;

const LIST: &str = "\
What is shown is of the last poll of each mount; nothing is sent to a gauge. A mount whose daemon
has died or does not answer within 5 s is shown as that. What is owed to a gauge, such as a decision about
an interrupted write, is named below the list, with what to type. Exit code 0: all answer, 1: one does not,
or none is mounted.

Examples:
  gaugefs list
  gaugefs list --json | jq -r 'select((.capacity // 100) < 20) | .gauge'";

/// List all mounted gauges
#[derive(Args, Debug)]
#[command(after_help = LIST)]
pub(super) struct List {
    /// Print JSON, one object per line for each gauge
    #[arg(long)]
    json: bool,
}

/// A mount without its gauges, for --json.
#[derive(Serialize)]
struct Silent<'a> {
    mountpoint: &'a str,
    error: &'a str,
}

impl List {
    pub(super) fn run(self) -> Result<ExitCode> {
        let mut mounts = mounts::list();
        mounts.sort();
        mounts.dedup();
        if mounts.is_empty() {
            let why = "no gaugefs is mounted; to mount one, see: gaugefs mount --help";
            return Err(Error::host("", Errno::ENOENT, why));
        }
        let (mut code, mut notes) = (ExitCode::SUCCESS, Vec::new());
        let mut rows = vec![["GAUGE", "PART", "SERIAL", "CAPACITY", "STATUS", "AGE"].map(String::from)];
        for (mount, found) in look::gauges(&mounts)? {
            for Seen { listed, notes: its, wrong, doubtful, .. } in &found.gauges {
                if self.json {
                    print_json(listed)?
                } else {
                    rows.push(row(listed))
                }
                let path = ti_gauge::text::printable(&listed.gauge);
                notes.extend(its.iter().map(|note| format!("{path}: {note}")));
                let found = wrong.iter().chain(doubtful);
                notes.extend(found.map(|found| format!("{path}: {found}; see: gaugefs check {path}")));
            }
            let Some(error) = trouble(&mount, &found) else { continue };
            code = ExitCode::FAILURE;
            if self.json {
                print_json(&Silent { mountpoint: &mount.to_string_lossy(), error: &error })?;
            } else {
                say(format_args!("{}: {error}", shown(&mount)));
            }
        }
        if rows.len() > 1 {
            print(&align(&rows))?;
        }
        notes.iter().for_each(say);
        Ok(code)
    }
}

/// Why a mount has not shown all of its gauges.
fn trouble(mount: &Path, found: &Found) -> Option<String> {
    match found {
        Found { dead: Some(true), .. } => Some(gaugefs_client::died(shown(mount))),
        Found { late: true, .. } => {
            let mount = shown(mount);
            Some(format!("its daemon does not answer; remove the mount with: gaugefs umount {mount}"))
        }
        // Another user's mount, which this user may not enter.
        Found { gauges, .. } if gauges.is_empty() => Some("it cannot be read by this user".into()),
        _ => None,
    }
}

fn row(gauge: &Listed) -> [String; 6] {
    let or_none = |text: &Option<String>| text.as_deref().map_or("-".into(), ti_gauge::text::printable);
    let age = gauge.age_ms.map_or("-".into(), |age| match age / 1000 {
        seconds @ 0..120 => format!("{seconds} s"),
        seconds @ 120..7200 => format!("{} min", seconds / 60),
        seconds => format!("{} h", seconds / 3600),
    });
    let capacity = gauge.capacity.map_or("-".into(), |percent| format!("{percent} %"));
    [
        ti_gauge::text::printable(&gauge.gauge),
        or_none(&gauge.part),
        or_none(&gauge.serial),
        capacity,
        or_none(&gauge.status),
        age,
    ]
}
