//! Watches the nodes of adapters, so that one that is unplugged is let go of at once: the kernel waits for
//! the last descriptor before it lets go itself. One that is back is tried at once, too.

use std::collections::HashMap;
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use nix::sys::inotify::{AddWatchFlags, InitFlags, Inotify, WatchDescriptor};

use crate::owner::{Handle, Request};

/// What happens to a name when its device goes, comes, or may be opened from now on.
const EVENTS: AddWatchFlags = AddWatchFlags::IN_CREATE
    .union(AddWatchFlags::IN_DELETE)
    .union(AddWatchFlags::IN_MOVED_FROM)
    .union(AddWatchFlags::IN_MOVED_TO)
    .union(AddWatchFlags::IN_ATTRIB);

/// Tells each gauge's owner when the node of its adapter comes or goes, from a thread of its own. Without
/// it a mount works as well: then the next poll notices.
pub(super) fn watch(nodes: impl Iterator<Item = (PathBuf, Handle)>) {
    let mut looks: Vec<(PathBuf, Look)> = Vec::new();
    for (node, handle) in nodes {
        // The name may be a link; the node itself goes first.
        let real = fs::canonicalize(&node).ok().filter(|real| *real != node);
        for path in real.into_iter().chain([node]) {
            let handle = handle.clone();
            looks.push((path, Box::new(move || handle.submit(Request::Look))));
        }
    }
    if let Err(error) = on_change(looks) {
        log::warn!("cannot watch for adapters that go, so the next poll notices: {error}");
    }
}

/// Called when a name has come or gone.
type Look = Box<dyn Fn() + Send>;

fn on_change(looks: Vec<(PathBuf, Look)>) -> std::io::Result<()> {
    if looks.is_empty() {
        return Ok(());
    }
    let inotify = Inotify::init(InitFlags::IN_CLOEXEC)?;
    let mut named: HashMap<(WatchDescriptor, OsString), Vec<Look>> = HashMap::new();
    for (path, look) in looks {
        let (Some(folder), Some(name)) = (path.parent(), path.file_name()) else { continue };
        let folder = if folder == Path::new("") { Path::new(".") } else { folder };
        // The same folder has the same number each time.
        let number = inotify.add_watch(folder, EVENTS)?;
        named.entry((number, name.to_os_string())).or_default().push(look);
    }
    let run = move || {
        while let Ok(events) = inotify.read_events() {
            for event in events {
                let Some(name) = event.name else { continue };
                named.get(&(event.wd, name)).into_iter().flatten().for_each(|look| look());
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
    fn a_node_that_comes_and_goes_is_told_and_no_other() {
        let folder = std::env::temp_dir().join(format!("gaugefs-adapters-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("a folder");
        let (tell, told) = mpsc::channel();
        let look = |name: &'static str| {
            let tell = tell.clone();
            (folder.join(name), Box::new(move || tell.send(name).expect("the test waits")) as Look)
        };
        on_change(vec![look("i2c-1"), look("i2c-2")]).expect("inotify");
        let next = || told.recv_timeout(Duration::from_secs(30)).expect("it is told");
        fs::write(folder.join("i2c-3"), "").expect("a file");
        fs::rename(folder.join("i2c-3"), folder.join("i2c-1")).expect("it comes");
        assert_eq!(next(), "i2c-1");
        fs::rename(folder.join("i2c-1"), folder.join("i2c-2")).expect("it goes, and the other comes");
        assert_eq!([next(), next()], ["i2c-1", "i2c-2"]);
        fs::remove_file(folder.join("i2c-2")).expect("it goes");
        // The attributes of a file change with its last link.
        assert_eq!(next(), "i2c-2");
        fs::remove_dir(&folder).expect("empty");
    }
}
