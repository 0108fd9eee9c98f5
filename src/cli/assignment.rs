//! `NAME=VALUE` on a command line: a parameter by its name or place, and a value as people write it.

use std::ffi::OsString;
use std::path::PathBuf;
use std::str::FromStr;

use nix::errno::Errno;

use crate::error::{Cause, Error, Result};
use ti_gauge::chip::{Chip, Kind, Row, Unnamed};
use ti_gauge::dataflash::Place;
use ti_gauge::image::{Entry, Image};
use ti_gauge::notation;

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

/// Finds a parameter by name; otherwise the error suggests the nearest.
pub(super) fn row(chip: &'static Chip, name: &str) -> Result<Row> {
    chip.find(name).map_err(|unnamed| match (unnamed, chip.nearest(name)) {
        (Unnamed::Several(names), _) => {
            let why = format!("several parameters have that name; write one of {}", names.join(", "));
            Error::new(name, Cause::Invalid(why))
        }
        (Unnamed::Unknown, nearest) => {
            let what = match nearest {
                Some(row) => format!("did you mean {}?", chip.name_of(row)),
                None => "`gaugefs get` without a name lists them".into(),
            };
            Error::host(name, Errno::ENOENT, format!("a {} has no such parameter; {what}", chip.model))
        }
    })
}

/// The parameters and values of a command line as an image. It is checked as far as it can be without the gauge.
pub(super) fn image(chip: &'static Chip, assignments: &[Assignment]) -> Result<Image> {
    let mut image = Image::new(chip, None);
    for Assignment { name, value } in assignments {
        let (subclass, parameter) = row(chip, name)?;
        let name = chip.name_of((subclass, parameter));
        if subclass.kind == Kind::Security {
            let why = "keys are changed with `gaugefs keys change`";
            return Err(Error::new(name, Cause::NotPermitted(why.into())));
        }
        let place = Place::of((subclass, parameter)).into();
        let value = notation::parse_with_unit(parameter, value);
        let value = value.map_err(|error| error.about(&name).at_place(place))?;
        let entry = Entry { subclass, parameter, value, line: 0 };
        if image.entries.iter().any(|other| other.is(&entry)) {
            return Err(Error::new(name, Cause::Invalid("it is given twice; remove one of the two".into())));
        }
        image.entries.push(entry);
    }
    Ok(image)
}

/// The words of a command line: gauges first, then what is done with each. A word is a gauge if it is a path, with `/` or
/// `.` at its beginning or of a folder that is there.
pub(super) fn split(words: Vec<OsString>) -> Result<(Vec<PathBuf>, Vec<String>)> {
    let is_path = |word: &OsString| {
        let text = word.to_string_lossy();
        text.starts_with(['/', '.']) || (!text.contains('=') && PathBuf::from(word).is_dir())
    };
    let first = words.iter().position(|word| !is_path(word)).unwrap_or(words.len());
    let mut gauges = words;
    let rest = gauges.split_off(first);
    if gauges.is_empty() {
        let why = "is no folder; name a gauge first, such as /run/gauges/BAT0";
        return Err(Error::host(rest[0].to_string_lossy(), Errno::ENOENT, why));
    }
    let text = |word: OsString| {
        word.into_string()
            .map_err(|word| Error::new(word.to_string_lossy(), Cause::Invalid("not text".into())))
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
            let error = image(chip, &assignments).expect_err("refused").to_string();
            assert!(error.contains(says) && !error.contains("8735"), "{words:?}: {error}");
        }
    }
}
