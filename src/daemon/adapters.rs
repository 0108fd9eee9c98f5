// SPDX-License-Identifier: MIT

//! Watches adapters' device nodes. An unplugged adapter is closed at once, because the kernel keeps it until its last
//! descriptor is closed; one that returns is tried at once.

use std::collections::HashMap;
use std::ffi::OsString;
use std::fs;
use std::path::PathBuf;

use nix::sys::inotify::{AddWatchFlags, InitFlags, Inotify, WatchDescriptor};

use gauge_owner::{Handle, operations};

/// Events when a node's device goes, comes, or gets its permissions from udev.
const EVENTS: AddWatchFlags = AddWatchFlags::IN_CREATE
    .union(AddWatchFlags::IN_DELETE)
    .union(AddWatchFlags::IN_MOVED_FROM)
    .union(AddWatchFlags::IN_MOVED_TO)
    .union(AddWatchFlags::IN_ATTRIB);

/// Notifies each gauge's owner, from a separate thread, when its adapter's node comes or goes. A mount works without
/// it: then the next poll finds out.
pub(super) fn watch(nodes: impl Iterator<Item = (PathBuf, Handle)>) {
    let mut watched: Vec<(PathBuf, Callback)> = Vec::new();
    for (node, handle) in nodes {
        // The name may be a link, and the node behind it goes first.
        let real = fs::canonicalize(&node).ok().filter(|real| *real != node);
        for path in real.into_iter().chain([node]) {
            let handle = handle.clone();
            watched.push((path, Box::new(move || handle.ask(&operations::LOOK, (), Box::new(drop)))));
        }
    }
    if let Err(error) = on_change(watched) {
        log::warn!("cannot watch for adapters that are unplugged, so only the next poll finds out: {error}");
    }
}

/// Runs when a path has come or gone.
type Callback = Box<dyn Fn() + Send>;

fn on_change(watched: Vec<(PathBuf, Callback)>) -> std::io::Result<()> {
    if watched.is_empty() {
        return Ok(());
    }
    let inotify = Inotify::init(InitFlags::IN_CLOEXEC)?;
    let mut named: HashMap<(WatchDescriptor, OsString), Vec<Callback>> = HashMap::new();
    for (path, callback) in watched {
        let (Some(folder), Some(name)) = (path.parent(), path.file_name()) else { continue };
        // Watching the same folder again returns the same descriptor.
        let folder = inotify.add_watch(folder, EVENTS)?;
        named.entry((folder, name.to_os_string())).or_default().push(callback);
    }
    let run = move || {
        while let Ok(events) = inotify.read_events() {
            for event in events {
                let Some(name) = event.name else { continue };
                named.get(&(event.wd, name)).into_iter().flatten().for_each(|callback| callback());
            }
        }
    };
    let thread = std::thread::Builder::new().name("adapters".into()).stack_size(64 * 1024);
    thread.spawn(run).map(drop)
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_node_that_comes_or_goes_is_reported_and_no_other() {
        let folder = std::env::temp_dir().join(format!("gaugefs-adapters-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("a folder");
        let (report, reported) = mpsc::channel();
        let watch = |name: &'static str| {
            let report = report.clone();
            (folder.join(name), Box::new(move || report.send(name).expect("the test waits")) as Callback)
        };
        on_change(vec![watch("i2c-1"), watch("i2c-2")]).expect("inotify");
        let next = || reported.recv_timeout(Duration::from_secs(30)).expect("a report");
        fs::write(folder.join("i2c-3"), "").expect("a file");
        fs::rename(folder.join("i2c-3"), folder.join("i2c-1")).expect("it comes");
        assert_eq!(next(), "i2c-1");
        fs::rename(folder.join("i2c-1"), folder.join("i2c-2")).expect("it goes, and the other comes");
        assert_eq!([next(), next()], ["i2c-1", "i2c-2"]);
        fs::remove_file(folder.join("i2c-2")).expect("it goes");
        // A file's attributes change with its last link.
        assert_eq!(next(), "i2c-2");
        fs::remove_dir(&folder).expect("empty");
    }
}
