// SPDX-License-Identifier: MIT

//! The numbers of the README and of the pages that it sends to for them, and what produces each:
//!
//! | numbers | produced by |
//! | --- | --- |
//! | parameters of each part, "38", "23 more", "thirty-five" | `parts_and_parameters_are_counted` |
//! | its length, and that of all pages | `no_page_is_longer_than_its_reader_needs` |
//! | what its commands print | `pages::the_readme` |
//! | commands | `every_command_is_in_the_default_build` |
//! | exit codes | `exit_codes_are_those_of_the_commands` |
//! | the figures of MEASUREMENTS.md | `benches/run`, which fails if a promise is broken; `each_figure_has_a_measurement` |
//! | those of "What is proven" | `the_figures_of_the_readme_are_those_of_the_measurements` |

use std::collections::BTreeSet;
use std::fs;

use ti_gauge::chip::{CHIPS, Chip, Scheme, kernel};

use super::room::{gaugefs, gaugefs_station, page, readme, root, rows, section};

fn first_number(text: &str) -> Option<usize> {
    let digits = text.trim_start_matches(|letter: char| !letter.is_ascii_digit());
    digits.split(|letter: char| !letter.is_ascii_digit()).next()?.parse().ok()
}

#[test]
fn parts_and_parameters_are_counted() {
    let count = |chip: &Chip| chip.subclasses.iter().map(|subclass| subclass.parameters.len()).sum::<usize>();
    let mut told = 0;
    for row in rows(&readme(), "Gauges") {
        if let Some(chip) = CHIPS.iter().find(|chip| chip.model.eq_ignore_ascii_case(&row[0])) {
            assert_eq!(first_number(&row[1]), Some(count(chip)), "{}: {}", row[0], row[1]);
            told += 1;
        } else if row[0].contains("23 more") {
            assert_eq!(kernel::GAUGES.len(), 23);
        }
    }
    assert_eq!((told, CHIPS.len()), (18, 18), "the README says seventeen relatives");
    // A Smart Battery is anybody's.
    let all = Chip::all().filter(|chip| chip.access.scheme != Scheme::Smbus).count();
    let text = readme().split_whitespace().collect::<Vec<_>>().join(" ");
    let written = CHIPS.iter().filter(|chip| chip.is_proven()).count();
    let claim = format!("Of [{all} gauges](#gauges), {} are only read.", all - written);
    assert!(text.contains(&claim), "the README has no `{claim}`");
    assert!((37..=42).contains(&all), "{all} parts");
    assert!(
        page("COMPARISON.md").contains("some forty of TI's, on I2C; fifteen with data flash that is written")
    );
}

#[test]
fn exit_codes_are_those_of_the_commands() {
    let text = page("IMAGES.md");
    for (claim, help, code) in [
        ("| 3 | written, except for what was passed over |", "import", "3"),
        ("exit codes are those of diff(1)", "diff", "0"),
    ] {
        assert!(text.contains(claim), "{claim}");
        let help = gaugefs(&[help, "--help"]).done();
        assert!(help.contains(code), "{claim}");
    }
    let image = root().join("tests/it/images/pack.toml");
    let image = image.to_str().expect("a path");
    assert_eq!(gaugefs(&["diff", image, image]).code, Some(0));
    assert_eq!(gaugefs(&["diff", image, "/none"]).code, Some(2));
}

/// Each row of "Figures" is one that `benches/run` prints.
#[test]
fn each_figure_has_a_measurement() {
    // The tests of a station print rows of their own.
    let sources = [
        "benches/run",
        "benches/attributes.rs",
        "benches/bus.rs",
        "benches/gauges.rs",
        "benches/restore.rs",
        "crates/gauge-station/src/station/tests.rs",
    ];
    let sources = sources.map(|path| fs::read_to_string(root().join(path)).expect("a measurement"));
    // Text that a line of source breaks.
    let sources: Vec<String> = sources
        .iter()
        .map(|text| text.replace("\\\n", "").split_whitespace().collect::<Vec<_>>().join(" "))
        .collect();
    let figures: Vec<_> = rows(&page("MEASUREMENTS.md"), "Figures")
        .into_iter()
        .filter(|row| !row[0].is_empty() && row[0] != "---")
        .collect();
    assert!(figures.len() >= 12, "{figures:?}");
    // `benches/run` prints these for every part, or in other words.
    let in_other_words = [
        ("bq34z100-G1, transfers/bytes", "transfers/bytes: a poll"),
        ("error of the state of charge of a bq27427", "error of the state of charge of a {} in use"),
        (
            "512 simulated gauges in one mount",
            "simulated gauges in one mount, {gauges} of them polled every 3 s",
        ),
    ];
    let is_measured = |row: &&Vec<String>| {
        let words =
            in_other_words.iter().find(|(readme, _)| row[0].starts_with(readme)).map(|(_, bench)| *bench);
        let words = words.unwrap_or_else(|| row[0].split([',', ':', '(']).next().unwrap_or_default().trim());
        sources.iter().any(|source| source.contains(words))
    };
    let missing: Vec<_> = figures.iter().filter(|row| !is_measured(row)).collect();
    assert!(missing.is_empty(), "{missing:?} are not measured");
    // Figures that are limits or constants of the measurements.
    for (figure, constant) in [
        ("3/43; ", "const POLL: Cost = Cost::of(3, 43);"),
        ("driver: 16/79", "(\"bq34z100-g1\", Cost::of(16, 79))"),
        ("tmpfs being 1, below 1.5", "const OF_TMPFS: f64 = 1.5;"),
        ("at most 8.5 MiB", "const MEMORY_MIB: f64 = 8.5;"),
        ("at most 2 MiB its own", "const OWN_MIB: f64 = 2.0;"),
        ("176 KiB for one gauge more", "const ANOTHER_KIB: f64 = 176.0;"),
        ("at most 40 MB", "const ALL_MB: f64 = 40.0;"),
        ("at most 2 % of a processor", "const ALL_PERCENT: f64 = 2.0;"),
    ] {
        let is_told = figures.iter().any(|row| row.iter().any(|cell| cell.contains(figure)));
        assert!(is_told && sources.iter().any(|source| source.contains(constant)), "{figure}");
    }
}

/// The numbers in a text, without the commas of thousands.
fn numbers(text: &str) -> BTreeSet<u64> {
    let text = text.replace(',', "");
    text.split(|letter: char| !letter.is_ascii_digit()).filter_map(|digits| digits.parse().ok()).collect()
}

#[test]
fn the_figures_of_the_readme_are_those_of_the_measurements() {
    let (readme, measured) = (readme(), page("MEASUREMENTS.md"));
    let lines = section(&readme, "What is proven").lines().filter(|line| line.starts_with("- "));
    let told: BTreeSet<u64> =
        lines.map(|line| line.replace("bq34z100-G1", "")).flat_map(|line| numbers(&line)).collect();
    let measured = numbers(section(&measured, "Figures"));
    assert!(told.len() >= 7, "{told:?}");
    assert!(told.is_subset(&measured), "{:?} were not measured", told.difference(&measured));
}

/// Counted as wc(1) does.
fn words(text: &str) -> usize {
    text.split_whitespace().count()
}

#[test]
fn no_page_is_longer_than_its_reader_needs() {
    let of_readme = words(&readme());
    assert!(of_readme <= 1500, "README.md has {of_readme} words");
    let folder = fs::read_dir(root().join("docs")).expect("a folder");
    let names = folder.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned());
    let pages: Vec<_> =
        names.filter(|name| name.ends_with(".md")).map(|name| (words(&page(&name)), name)).collect();
    let all = of_readme + pages.iter().map(|(words, _)| words).sum::<usize>();
    println!("README.md {of_readme}, all pages {all}: {pages:?}");
    assert!(pages.len() > 20 && all <= 42_000, "all pages have {all} words: {pages:?}");
}

/// An example that mounts where only root may says so.
#[test]
fn examples_for_root_say_sudo() {
    let help = fs::read_to_string(root().join("tests/it/golden/help")).expect("the help texts");
    let page = gaugefs(&["man"]).done().replace("\\-", "-");
    let docs =
        ["README.md", "docs/MONITORS.md", "docs/MOUNTING.md", "docs/SEMANTICS.md", "docs/PACKAGING.md"]
            .map(|path| fs::read_to_string(root().join(path)).expect(path));
    let mut seen = 0;
    for line in docs.iter().chain([&help, &page]).flat_map(|text| text.lines()).map(str::trim) {
        let command = line.trim_start_matches("$ ");
        let for_root = ["/run/", "/sys/", "--config /etc/"].iter().any(|place| command.contains(place));
        if for_root && ["gaugefs mount ", "gaugefs umount "].iter().any(|verb| command.starts_with(verb)) {
            panic!("without sudo: {line}");
        }
        seen += usize::from(command.starts_with("sudo gaugefs mount "));
    }
    assert!(seen >= 6, "{seen}");
}

/// `cargo run -- VERB` and `cargo install` have every command of these pages: what draws is part of the default features.
#[test]
fn every_command_is_in_the_default_build() {
    let pages = ["CALIBRATION.md", "FLEET.md", "IMAGES.md", "COMMANDS.md", "SIMULATOR.md"].map(page);
    let text = readme() + &pages.concat();
    let commands = text.lines().filter_map(|line| {
        let line = line.strip_prefix("$ ")?;
        line.strip_prefix("sudo ").unwrap_or(line).strip_prefix("gaugefs ")?.split(' ').next()
    });
    let commands: BTreeSet<&str> = commands.collect();
    assert!(
        ["mount", "top", "learn", "log", "plot"].iter().all(|verb| commands.contains(verb)),
        "{commands:?}"
    );
    for verb in commands {
        let missing = cfg!(not(feature = "screen"))
            && ["top", "learn", "log", "plot", "wait", "watch", "metrics", "events"].contains(&verb);
        assert_eq!(gaugefs(&[verb, "--help"]).code == Some(0), !missing, "{verb}");
    }
    let manifest = fs::read_to_string(root().join("Cargo.toml")).expect("the manifest");
    assert!(manifest.contains("\n[features]\ndefault = [\"screen\", \"rescue\"]\n"), "{manifest}");
    assert!(
        manifest.contains("\ndefault-run = \"gaugefs\"\n") && !manifest.contains("[[bin]]"),
        "{manifest}"
    );
    let text = page("PRODUCTION.md");
    let of_station = text.match_indices("gaugefs-station ").map(|(at, found)| &text[at + found.len()..]);
    let of_station: BTreeSet<&str> = of_station.filter_map(|rest| rest.split([' ', '`']).next()).collect();
    assert_eq!(of_station, BTreeSet::from(["program", "records"]));
    assert!(of_station.iter().all(|verb| gaugefs_station(&[verb, "--help"]).code == Some(0)));
}
