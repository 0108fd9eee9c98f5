//! A configuration that was saved by copying `df/index`, as the changes that bring it back.

use crate::chip::{Chip, Kind};
use crate::codec;
use crate::dataflash::Change;
use crate::error::{Cause, Error, Result};
use crate::text;

/// Reads a copy of `df/index`. Rows without a value, keys, and rows whose address is not sure are passed
/// over; a row that the table does not have, or a value that does not fit it, is an error that names the
/// line.
pub fn parse(chip: &'static Chip, saved: &str) -> Result<Vec<Change>> {
    let mut changes = Vec::new();
    for (number, line) in (1..).zip(saved.lines()).skip(1) {
        let fields: Vec<&str> = line.split('\t').collect();
        let at = |error: Error| error.within(&format!("line {number}"));
        let bad = |why: &str| at(Error::new("", Cause::Invalid(why.to_string())));
        let [subclass, offset, .., value] = fields.as_slice() else {
            return Err(bad("not a line of df/index"));
        };
        let row = chip.row(subclass, offset);
        let (subclass, parameter) =
            row.ok_or_else(|| bad(&format!("a {} has no such parameter", chip.model)))?;
        if *value == "-" || subclass.kind == Kind::Security || parameter.unproven {
            continue;
        }
        let value = text::parse(parameter, value.as_bytes()).map_err(at)?;
        let bytes = codec::encode(parameter.kind, &value).ok_or_else(|| bad("does not fit its type"))?;
        changes.push(Change { subclass, parameter, bytes, saved: true });
    }
    Ok(changes)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "subclass\toffset\ttype\tname\tunit\tmin\tmax\tdefault\tflags\tvalue\n";

    fn chip() -> &'static Chip {
        Chip::by_name("bq34z100-g1").expect("it has a table")
    }

    #[test]
    fn lines_become_changes() {
        let saved = format!(
            "{HEAD}80\t53\tI2\tCell Terminate Voltage\tmV\t1000\t3700\t3000\treset\t3100\n\
             112\t0\tH4\tSealed to Unsealed\t-\t-\t-\t-\tsecurity\t-\n"
        );
        let changes = parse(chip(), &saved).expect("well formed");
        assert_eq!(changes.len(), 1);
        assert_eq!((changes[0].subclass.id, changes[0].parameter.offset), (80, 53));
        assert_eq!(changes[0].bytes, [0x0c, 0x1c]);
    }

    #[test]
    fn a_bad_line_is_named() {
        for (line, says) in [
            (
                "80\t53\tI2\tx\tmV\t1000\t3700\t3000\t-\t9999",
                "line 2: Cell Terminate Voltage: 9999 is outside",
            ),
            ("80\t54\tI2\tx\tmV\t0\t0\t0\t-\t1", "line 2: a bq34z100-G1 has no such parameter"),
            ("nonsense", "line 2: not a line of df/index"),
        ] {
            let error = parse(chip(), &format!("{HEAD}{line}\n")).expect_err(line).to_string();
            assert!(error.starts_with(says), "{error}");
        }
    }
}
