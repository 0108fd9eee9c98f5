// SPDX-License-Identifier: MIT

//! The file of a station, which programs one pack after the other.

use std::path::Path;

use crate::config::file::{self, File, Head};
use crate::config::{At, absolute, make_absolute};
use crate::error::{Cause, Error, Result};
use gauge_owner::GaugeOptions;
use gauge_station::{Options, Setup};

impl Head for Options {
    const NAME: &'static str = "station";
    const LISTS: &'static [&'static str] = &["gauge", "slot"];
    const GAUGES: Option<At> = Some(At::Station);
}

/// Reads the file of a station; `named` gives its gauges their names.
pub(super) fn read(path: &Path, named: impl FnOnce(&[GaugeOptions]) -> Vec<String>) -> Result<Setup> {
    let mut path = path.to_path_buf();
    absolute(&mut path, Path::new(""))?;
    let text = file::text(&path)?;
    let file = File::<Options>::parse(&path, &text)?;
    let mut read = file.read()?;
    make_absolute(&mut read.head, file::folder(&path))?;
    read.head.check().map_err(|(key, why)| match file.place(key) {
        Some(at) => file.refuse(at, key, &why),
        None => Error::new(format!("{}: {key}", file.name), Cause::Invalid, why),
    })?;
    let gauges = file.complete(read.gauges, &path, None)?;
    let gauges = named(&gauges).into_iter().zip(gauges).collect();
    Ok(Setup::new(&path, read.head, gauges))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::{env, fs, process};

    use super::*;
    use crate::config::names;

    /// The station of a file with that text.
    fn station(name: &str, text: &str) -> Result<Setup> {
        let file = env::temp_dir().join(format!("gaugefs-station-{name}-{}.toml", process::id()));
        fs::write(&file, text).expect("a file");
        let setup = read(&file, |gauges| gauges.iter().map(|_| "BAT0".to_string()).collect());
        fs::remove_file(&file).expect("it is there");
        setup
    }

    #[test]
    fn what_makes_no_sense_at_a_station_is_refused_with_its_line() {
        let refuse = |lines: &str| {
            let text = format!(
                "[station]\nno-backup = true\nstate-dir = 'journals'\n{lines}\n[[gauge]]\nsim = 'bq34z100-g1'\n"
            );
            station("refused", &text).err().map_or(String::new(), |error| error.to_string())
        };
        for (lines, says) in [
            (
                "serial = 'counter'\nfirst-serial = 7\nlast-serial = 6",
                "line 6: last-serial: it is below first-serial",
            ),
            ("serial = 'list'", "line 4: serial: set serial-list too"),
            ("serial = 'lst'", "line 4: serial:"),
            ("sreial = 'list'", "line 4: sreial: unknown key; did you mean `serial`?"),
            ("date = 'tomorrow'", "line 4: date: expected today or YYYY-MM-DD"),
            ("exclude = ['all']", "line 4: exclude: `all` is none of: calibration, serial,"),
            ("divider = 33000", "line 4: divider: set cells too"),
            ("first-serial = 3", "line 4: first-serial: only with serial"),
            ("packs = 0", "line 4: packs: at least 1"),
            ("[defaults]\npoll = 3", "line 5: poll: has no meaning at a station"),
            ("[mount]\nprivate = true", "line 4: mount: unknown key"),
        ] {
            let error = refuse(lines);
            assert!(error.contains(says), "{lines}: {error}");
        }
        assert_eq!(refuse(""), "");
    }

    #[test]
    fn the_manual_has_every_key_of_a_station() {
        let manual =
            include_str!("../../docs/PRODUCTION.md").split_once("\n## A station\n").expect("a section").1;
        let keys: Vec<&str> = names::<Options>(At::Table).collect();
        assert!(keys.len() > 25);
        let table = manual.lines().filter(|line| line.starts_with("| `"));
        let listed: BTreeSet<&str> = table
            .flat_map(|line| line.split('|').nth(1))
            .flat_map(|cell| cell.split('`').skip(1).step_by(2))
            .collect();
        assert_eq!(listed, keys.into_iter().collect());
        let (_, of_gauges) = manual.split_once("with the keys that make sense here:").expect("a list");
        let of_gauges = of_gauges.split("for simulated packs").next().unwrap_or_default();
        let of_gauges: BTreeSet<&str> = of_gauges.split('`').skip(1).step_by(2).collect();
        assert_eq!(of_gauges, names::<GaugeOptions>(At::Station).collect());
        // The example is accepted.
        let example =
            manual.split("```toml\n").nth(1).and_then(|rest| rest.split("```").next()).expect("an example");
        let setup = station("manual", example).expect("a station");
        assert_eq!((setup.gauges.len(), setup.options.first_serial), (2, Some(1000)));
        assert!(!setup.options.serial_is_hex);
        let example = example.replace("first-serial = 1000", "first-serial = 0x03e8");
        let options = station("manual", &example).expect("a station").options;
        assert_eq!((options.first_serial, options.serial_is_hex), (Some(1000), true));
    }
}
