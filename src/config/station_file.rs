//! The file of a station, which programs one pack after the other.

use std::path::Path;

use serde::Deserialize;

use super::file::{self, File, Head, Table};
use super::{GaugeOptions, make_absolute};
use crate::error::{Cause, Error, Result};
use gauge_station::{Options, Setup};

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct OfStation {
    station: Options,
}

/// Keys of gauges that make no sense for a station.
const NOT_AT_A_STATION: [&str; 10] = [
    "replay",
    "restore",
    "poll",
    "energy",
    "absolute-current",
    "current-scale",
    "voltage-scale",
    "energy-scale",
    "allow-learning",
    "trace",
];

/// Reads the file of a station, whose gauges get the names that `named` gives them.
pub(crate) fn station(path: &Path, named: impl FnOnce(&[GaugeOptions]) -> Vec<String>) -> Result<Setup> {
    let mut path = path.to_path_buf();
    make_absolute([&mut path].into_iter(), Path::new(""))?;
    let text = file::text(&path)?;
    let head = Head::with_keys("station", &["gauge"], Options::keys());
    let (file, OfStation { mut station }, gauges) = File::read::<OfStation>(&path, &text, head)?;
    make_absolute(station.paths(), file::folder(&path))?;
    station.check().map_err(|(key, why)| match file.place(Table::Head, key) {
        Some(place) => file.refuse(place.at, key, &why),
        None => Error::new(format!("{}: {key}", file.name), Cause::Invalid(why)),
    })?;
    for number in 0..gauges.gauge.len() {
        let not_here = NOT_AT_A_STATION.iter();
        let mut places = not_here
            .filter_map(|key| file.place(Table::Gauge(number), key).or(file.place(Table::Defaults, key)));
        if let Some(place) = places.next() {
            return Err(file.refuse(place.at, &place.key, "has no meaning at a station; remove it"));
        }
    }
    let gauges = file.gauges(gauges, &path, None)?;
    let gauges = named(&gauges).into_iter().zip(gauges.iter().map(GaugeOptions::setup)).collect();
    Ok(Setup::new(&path, station, gauges))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::{env, fs, process};

    use super::*;

    /// The station of a file with that text.
    fn read(name: &str, text: &str) -> Result<Setup> {
        let file = env::temp_dir().join(format!("gaugefs-station-{name}-{}.toml", process::id()));
        fs::write(&file, text).expect("a file");
        let setup = station(&file, |gauges| gauges.iter().map(|_| "BAT0".to_string()).collect());
        fs::remove_file(&file).expect("it is there");
        setup
    }

    #[test]
    fn what_makes_no_sense_at_a_station_is_refused_with_its_line() {
        let refuse = |lines: &str| {
            let text = format!(
                "[station]\nno-backup = true\nstate-dir = 'journals'\n{lines}\n[[gauge]]\nsim = 'bq34z100-g1'\n"
            );
            read("refused", &text).err().map_or(String::new(), |error| error.to_string())
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
        let keys = Options::keys();
        assert!(keys.len() > 25);
        let table = manual.lines().filter(|line| line.starts_with("| `"));
        let listed: BTreeSet<&str> = table
            .flat_map(|line| line.split('|').nth(1))
            .flat_map(|cell| cell.split('`').skip(1).step_by(2))
            .collect();
        assert_eq!(listed, keys.iter().copied().collect());
        // The example is accepted.
        let example =
            manual.split("```toml\n").nth(1).and_then(|rest| rest.split("```").next()).expect("an example");
        let setup = read("manual", example).expect("a station");
        assert_eq!((setup.gauges.len(), setup.options.first_serial), (2, Some(1000)));
    }
}
