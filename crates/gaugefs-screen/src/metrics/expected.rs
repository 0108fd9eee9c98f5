// SPDX-License-Identifier: MIT

//! Expected mounts: those of `--expect`, or those in the files of `/etc/gaugefs`.

use std::fs;
use std::path::{Path, PathBuf};

use gauge_bus::regular;
use gaugefs_host::folders;

/// The mount point for `--expect`: a path, or a file's name in `/etc/gaugefs`.
pub(super) fn named(word: &Path) -> PathBuf {
    in_folder(word, Path::new(folders::CONFIGURATION))
}

fn in_folder(word: &Path, folder: &Path) -> PathBuf {
    match word.to_str().filter(|name| !name.contains('/')) {
        Some(name) => mountpoint(folder, name).unwrap_or_else(|| Path::new(folders::RUN).join(name)),
        None => std::path::absolute(word).unwrap_or_else(|_| word.to_path_buf()),
    }
}

/// Mount points in this machine's files at present.
pub(super) fn configured() -> Vec<PathBuf> {
    of_folder(Path::new(folders::CONFIGURATION))
}

fn of_folder(folder: &Path) -> Vec<PathBuf> {
    let files = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.file_name());
    let names = files.filter_map(|name| Some(name.to_str()?.strip_suffix(".toml")?.to_string()));
    let mut all: Vec<_> = names.filter_map(|name| mountpoint(folder, &name)).collect();
    all.sort();
    all.dedup();
    all
}

/// The mount point of a file in the folder: its own one, or that of `gaugefs@i2c-N.service`. A file that is unreadable
/// or not understood has none; mounting it reports that.
fn mountpoint(folder: &Path, name: &str) -> Option<PathBuf> {
    let file = regular::read_text(&folder.join(format!("{name}.toml")), regular::SYSTEM).ok()?;
    let file: toml::Table = file.parse().ok()?;
    let named = file.get("mount").and_then(|mount| mount.get("mountpoint")).and_then(|place| place.as_str());
    let of_bus = || name.starts_with("i2c-").then(|| Path::new(folders::RUN).join(name));
    named.map(|place| folder.join(place)).or_else(of_bus)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_name_their_mount_points() {
        let folder = std::env::temp_dir().join(format!("gaugefs-expected.{}", std::process::id()));
        fs::create_dir_all(&folder).expect("a folder");
        for (name, text) in [
            ("gaugefs.toml", "[mount]\nmountpoint = \"/run/gauges\"\n[[gauge]]\nsim = \"bq34110\"\n"),
            ("also.toml", "mount = { mountpoint = \"/run/gauges\" }\n"),
            ("here.toml", "[mount]\nmountpoint = \"m\"\n"),
            ("i2c-1.toml", "[[gauge]]\n"),
            ("packs.toml", "[[gauge]]\nsim = \"bq34110\"\n"),
            ("line1.toml", "[station]\nname = \"x\"\n"),
            ("broken.toml", "[mount\n"),
            ("i2c-1.keys", "unseal = 0414 3672\n"),
        ] {
            fs::write(folder.join(name), text).expect("a file");
        }
        let wanted = [folder.join("m"), "/run/gaugefs/i2c-1".into(), "/run/gauges".into()];
        let mut found = of_folder(&folder);
        found.sort_by_key(|path| !path.starts_with(&folder));
        assert_eq!(found, wanted);
        for (word, place) in [
            ("gaugefs", "/run/gauges"),
            ("i2c-1", "/run/gaugefs/i2c-1"),
            ("i2c-7", "/run/gaugefs/i2c-7"),
            ("/mnt/x/", "/mnt/x/"),
        ] {
            assert_eq!(in_folder(Path::new(word), &folder), Path::new(place), "{word}");
        }
        fs::remove_dir_all(&folder).expect("a folder");
        assert!(of_folder(&folder).is_empty());
    }
}
