// SPDX-License-Identifier: MIT

//! `NAME=VALUE` on a command line: a parameter by name or place, and a value as people write it.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use nix::errno::Errno;

use crate::error::{Cause, Error, Result};
use gaugefs_client::{Gauge, Wanted};
use ti_gauge::chip::Chip;

/// `NAME=VALUE`, not yet looked up.
#[derive(Clone, Debug)]
pub(super) struct Assignment {
    name: String,
    value: String,
}

impl FromStr for Assignment {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, value) = text.split_once('=').filter(|(name, _)| !name.trim().is_empty()).ok_or(
            "write NAME=VALUE, such as it-cfg/cell-terminate-voltage=3.1V; `gaugefs get` shows the names",
        )?;
        Ok(Self { name: name.trim().into(), value: value.into() })
    }
}

/// The parameters and values of a command line, checked as far as possible without the gauge.
pub(super) fn wanted(chip: &'static Chip, assignments: &[Assignment]) -> Result<Wanted> {
    let mut wanted = Wanted::new(chip);
    for Assignment { name, value } in assignments {
        wanted.set(name, value)?;
    }
    Ok(wanted)
}

/// Splits a command line into gauges and the words after them. A gauge is a path that begins with `/` or `.`, an
/// existing folder, a folder in a mount whose daemon is gone, or a mounted gauge's name. After a path, no mount is
/// searched for names: another mount that hangs would delay the command.
pub(super) fn split(words: Vec<OsString>) -> Result<(Vec<PathBuf>, Vec<String>)> {
    let is_folder = |word: &OsString| match std::fs::metadata(word) {
        Ok(status) => status.is_dir(),
        Err(error) => {
            let errno = error.raw_os_error().map(Errno::from_raw);
            matches!(errno, Some(Errno::ENOTCONN | Errno::ECONNABORTED))
        }
    };
    let is_path = |word: &OsString| {
        let text = word.to_string_lossy();
        text.starts_with(['/', '.']) || (!text.contains('=') && is_folder(word))
    };
    // Opening it refuses an ambiguous name.
    let is_named = |word: &OsString| {
        let path = Path::new(word);
        !word.to_string_lossy().contains('=') && Gauge::named(path).map_or(true, |folder| folder != path)
    };
    let mut names_only = true;
    let is_gauge = |word: &OsString| {
        let path = is_path(word);
        names_only &= !path;
        path || names_only && is_named(word)
    };
    let first = words.iter().map(is_gauge).position(|is_gauge| !is_gauge).unwrap_or(words.len());
    let mut gauges = words;
    let rest = gauges.split_off(first);
    if gauges.is_empty() {
        let why =
            "is neither a folder nor a mounted gauge; name a gauge first, such as /run/gauges/BAT0 or BAT0";
        return Err(Error::host(rest[0].to_string_lossy(), Errno::ENOENT, why));
    }
    let text = |word: OsString| {
        word.into_string().map_err(|word| Error::new(word.to_string_lossy(), Cause::Invalid, "not text"))
    };
    Ok((gauges.into_iter().map(PathBuf::from).collect(), rest.into_iter().map(text).collect::<Result<_>>()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gauges_come_first() {
        let split = |words: &[&str]| split(words.iter().map(OsString::from).collect());
        let (gauges, rest) =
            split(&["/run/a=b/BAT0", "/tmp", "./x", "it-cfg/x=/tmp", "y=1"]).expect("gauges");
        assert_eq!(
            gauges.iter().map(|path| path.display().to_string()).collect::<Vec<_>>(),
            ["/run/a=b/BAT0", "/tmp", "./x"]
        );
        assert_eq!(rest, ["it-cfg/x=/tmp", "y=1"]);
        let error = split(&["it-cfg/x=1"]).expect_err("no gauge").to_string();
        assert!(error.contains("name a gauge first"), "{error}");
    }

    #[test]
    fn an_error_names_the_parameter_and_never_the_value() {
        let chip = Chip::by_name("bq34z100-g1").expect("it has a table");
        for (words, says) in [
            (&["it-cfg/cell-terminate-voltag=3.1V"][..], "did you mean it-cfg/cell-terminate-voltage?"),
            (&["nonsense=1"], "a bq34z100-G1 has no such parameter; `gaugefs get`"),
            (&["cell-terminate-voltage=8735A"], "it-cfg/cell-terminate-voltage: another unit"),
            (&["codes/sealed-to-unsealed=0x87358735"], "gaugefs keys change"),
            (&["80/53=3100", "cell-terminate-voltage=3.2V"], "it is given twice"),
            (&["80/53=8735"], "outside 1000 to 3700 mV"),
        ] {
            let assignments: Vec<Assignment> = words.iter().map(|word| word.parse().expect("one")).collect();
            let error = wanted(chip, &assignments).expect_err("refused").to_string();
            assert!(error.contains(says) && !error.contains("8735"), "{words:?}: {error}");
        }
    }
}
