// SPDX-License-Identifier: MIT

//! Programs that a person names now and gaugefs runs later, when the name can no longer be corrected.

use std::env;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use gauge_bus::regular;
use nix::errno::Errno;
use nix::unistd::{AccessFlags, access};

use crate::error::{Error, Result};

/// Longest first line of a script that the kernel reads.
const FIRST_LINE: usize = 256;

/// Checks that a program can be started, as far as possible without running it: its name and its arguments.
pub fn check(words: &[String]) -> Result<()> {
    let Some(program) = words.first() else { return Ok(()) };
    let refused = |errno, why: String| Err(Error::host(program, errno, why));
    let Some(path) = find(program) else { return refused(Errno::ENOENT, missing(words)) };
    if !path.is_file() {
        return refused(Errno::EACCES, format!("{} is no program", path.display()));
    }
    if access(&path, AccessFlags::X_OK).is_err() {
        let why = format!("{0} may not be run by this user; chmod +x {0}", path.display());
        return refused(Errno::EACCES, why);
    }
    match interpreter(&path).filter(|interpreter| !interpreter.exists()) {
        None => Ok(()),
        Some(interpreter) => {
            let why = format!("its first line names {}, which does not exist", interpreter.display());
            refused(Errno::ENOENT, why)
        }
    }
}

fn find(program: &str) -> Option<PathBuf> {
    if program.contains('/') {
        return Some(PathBuf::from(program)).filter(|path| path.exists());
    }
    let found: Vec<_> = env::split_paths(&env::var_os("PATH")?).map(|folder| folder.join(program)).collect();
    let runs = |path: &&PathBuf| path.is_file() && access(*path, AccessFlags::X_OK).is_ok();
    found.iter().find(runs).or_else(|| found.iter().find(|path| path.is_file())).cloned()
}

fn missing(words: &[String]) -> String {
    let program = &words[0];
    let parts: Vec<_> = program.split_whitespace().collect();
    match parts[..] {
        [] => "the name of the program is empty".into(),
        [first, _, ..] if is_for_shell(program) || find(first).is_none() => format!(
            "there is no program of this name: the whole text is taken for one, as no shell is involved; \
             for a shell write sh -c '{program}'"
        ),
        [_, _, ..] => {
            let list: Vec<_> = parts.iter().map(|part| format!("{part:?}")).collect();
            format!(
                "there is no program of this name: write each word by itself, {program} without quotes, in a file \
                 [{}]",
                list.join(", ")
            )
        }
        _ if is_for_shell(program) => {
            "there is no such program: no shell is involved, which would replace a part of it; write the whole path".into()
        }
        _ if program.contains('/') => "there is no such program".into(),
        _ => "there is no such program in PATH; write its whole path".into(),
    }
}

/// Whether only a shell understands the text.
fn is_for_shell(text: &str) -> bool {
    text.starts_with('~') || text.contains(['|', '&', ';', '<', '>', '$', '`', '\'', '"', '*'])
}

fn interpreter(path: &Path) -> Option<PathBuf> {
    let mut start = [0; FIRST_LINE];
    let length = regular::open_linked(File::options().read(true), path).ok()?.read(&mut start).ok()?;
    let line = start[..length].strip_prefix(b"#!")?.split(|&byte| byte == b'\n').next()?;
    let name = str::from_utf8(line).ok()?.trim_start();
    Some(name.split([' ', '\t']).next()?.into()).filter(|name: &PathBuf| !name.as_os_str().is_empty())
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;

    fn refused(words: &[&str]) -> Option<String> {
        let words: Vec<_> = words.iter().map(|word| word.to_string()).collect();
        check(&words).err().map(|error| error.to_string())
    }

    #[track_caller]
    fn says(words: &[&str], why: &str) {
        let text = refused(words).expect("it cannot be started");
        assert!(text.contains(why), "{text}");
    }

    #[test]
    fn a_program_that_can_be_started_is_accepted() {
        for words in [&[][..], &["true"], &["sh", "-c", "no such thing"], &["/bin/sh"]] {
            assert_eq!(refused(words), None, "{words:?}");
        }
    }

    #[test]
    fn regression_a_program_that_cannot_be_started_was_found_when_it_was_needed() {
        says(&["sleep 1"], "write each word by itself, sleep 1 without quotes, in a file [\"sleep\", \"1\"]");
        says(&["no-such-program now"], "sh -c 'no-such-program now'");
        says(&["sleep 1 && sleep 2"], "sh -c 'sleep 1 && sleep 2'");
        says(&["no-such-program"], "no such program in PATH; write its whole path");
        says(&["/no/such/program"], "no such program");
        says(&["~/program"], "no shell is involved");
        says(&[""], "is empty");
        says(&["/"], "is no program");
    }

    #[test]
    fn a_script_needs_its_mode_and_its_interpreter() {
        let path = env::temp_dir().join(format!("gaugefs-program-{}", std::process::id()));
        let name = path.to_str().expect("text");
        let script = |text: &str, mode| {
            fs::write(&path, text).expect("a file");
            fs::set_permissions(&path, fs::Permissions::from_mode(mode)).expect("a mode");
        };
        script("#! /bin/sh -e\n", 0o755);
        let right = refused(&[name]);
        script("#!/no/such/interpreter x\n", 0o755);
        let wrong = refused(&[name]);
        script("#!/bin/sh\n", 0o644);
        let unmarked = refused(&[name]);
        fs::remove_file(&path).expect("it is there");
        assert_eq!(right, None);
        assert!(wrong.is_some_and(|text| text.contains("names /no/such/interpreter, which does not exist")));
        assert!(unmarked.is_some_and(|text| text.contains("chmod +x")));
    }
}
