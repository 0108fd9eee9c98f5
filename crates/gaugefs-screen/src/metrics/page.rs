// SPDX-License-Identifier: MIT

//! Metrics of gauges as text. A row of [`METRICS`] is a metric.
//!
//! Names and units follow Prometheus's rules: base units, `_total` for counters, `_info` for labels. A value that a
//! gauge lacks has no series. A file's text becomes a number, or is escaped in a label, so a line end in it begins no
//! series.

use std::fmt::Write;
use std::path::PathBuf;
use std::time::Duration;

use jiff::Timestamp;
use ti_gauge::chip::Chip;
use ti_gauge::learning::Bits;

use super::Prometheus;
use gaugefs_client::check::Finding;
use gaugefs_client::condition::Texts;

/// A mount, and its gauges as far as they have answered.
pub(super) struct Mount {
    pub(super) path: PathBuf,
    pub(super) up: Up,
    pub(super) gauges: Vec<Gauge>,
}

/// Whether the daemon of a mount answers.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Up {
    Yes,
    No,
    /// Private to another user.
    Unknown,
}

pub(super) struct Gauge {
    pub(super) name: String,
    pub(super) texts: Texts,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Gauge,
    Counter,
    Info,
}

/// A metric of a gauge.
struct Metric {
    /// With its unit, without `_total` and `_info`.
    name: &'static str,
    kind: Kind,
    /// End of the name, if it is a unit of OpenMetrics.
    unit: &'static str,
    help: &'static str,
    origin: Origin,
}

/// The source of a metric's series. A file is read because a row names it here.
enum Origin {
    /// One series: the number of a file, in the metric's unit.
    Number(&'static str, fn(f64) -> f64),
    /// One series, if the file contains 0 or 1.
    Flag(&'static str),
    /// One series of 1: labels, and the file of each.
    Labels(&'static [(&'static str, &'static str)]),
    /// Series made by a function from the texts of these files, in their order.
    Made(&'static [&'static str], fn(&[Option<&str>]) -> Vec<Series>),
}

/// Labels and value.
type Series = (Labels, f64);

type Labels = Vec<(&'static str, String)>;

const fn gauge(name: &'static str, unit: &'static str, help: &'static str, origin: Origin) -> Metric {
    Metric { name, kind: Kind::Gauge, unit, help, origin }
}

const fn counter(name: &'static str, help: &'static str, file: &'static str) -> Metric {
    Metric { name, kind: Kind::Counter, unit: "", help, origin: Number(file, same) }
}

const fn info(name: &'static str, help: &'static str, origin: Origin) -> Metric {
    Metric { name, kind: Kind::Info, unit: "", help, origin }
}

use Origin::{Flag, Made, Number};

static METRICS: &[Metric] = &[
    info(
        "gaugefs_chip",
        "Part, firmware, chemical ID and serial number.",
        Origin::Labels(&[
            ("model", "model_name"),
            ("serial_number", "serial_number"),
            ("firmware", "gauge/firmware_version"),
            ("chem_id", "gauge/chem_id"),
        ]),
    ),
    info(
        "gaugefs_permanent_failure",
        "Why a pack is out of use for good, by TI's name.",
        Made(&["gauge/permanent_failure"], |texts| {
            let lines = texts[0].unwrap_or_default().lines();
            let names = lines.filter_map(|line| Some(line.split_once(": ")?.0.to_string()));
            names.map(|name| (vec![("reason", name)], 1.0)).collect()
        }),
    ),
    gauge("gaugefs_present", "", "Whether the gauge answers and has a battery.", Flag("present")),
    gauge(
        "gaugefs_poll_age_seconds",
        "seconds",
        "Age of the values.",
        Number("gauge/age_ms", |ms| ms / 1000.0),
    ),
    gauge(
        "gaugefs_poll_interval_seconds",
        "seconds",
        "Time between two polls.",
        Number("gauge/poll_interval", same),
    ),
    counter("gaugefs_polls", "Polls that succeeded since the mount.", "gauge/statistics/polls"),
    counter("gaugefs_failed_polls", "Polls that failed since the mount.", "gauge/statistics/failed_polls"),
    counter("gaugefs_bus_transfers", "I2C transfers since the mount.", "gauge/statistics/transfers"),
    counter(
        "gaugefs_bus_retries",
        "I2C transfers that were repeated since the mount.",
        "gauge/statistics/retries",
    ),
    counter(
        "gaugefs_flash_writes",
        "Blocks of data flash programmed since the mount.",
        "gauge/statistics/flash_writes",
    ),
    counter("gaugefs_resets", "Resets sent to the gauge since the mount.", "gauge/statistics/resets"),
    gauge(
        "gaugefs_state_of_health_ratio",
        "ratio",
        "StateOfHealth(), 1 for a new pack.",
        Number("state_of_health", of_percent),
    ),
    gauge(
        "gaugefs_capacity_error_ratio",
        "ratio",
        "MaxError(), the error margin of capacity.",
        Number("capacity_error_margin", of_percent),
    ),
    gauge(
        "gaugefs_control_status",
        "",
        "Bits of CONTROL_STATUS that concern learning: 1 while the bit is set.",
        Made(&["model_name", "gauge/control_status"], control_status),
    ),
    gauge(
        "gaugefs_update_status",
        "",
        "Update Status, as LearnedStatus() shows it.",
        Made(&["gauge/learned_status"], |texts| {
            one(texts[0].map(|bits| f64::from(Bits::named(bits.split_whitespace()).update_status())))
        }),
    ),
    gauge(
        "gaugefs_seal_state",
        "",
        "1 for the state in which the gauge is.",
        Made(&["gauge/seal", "model_name", "gauge/control_status"], seal),
    ),
    gauge("gaugefs_owed", "", "1 while a write or a seal is neither done nor undone.", Flag("gauge/owed")),
    gauge(
        "gaugefs_check",
        "",
        "1 for each rule of gauge/check that is true.",
        Made(&["gauge/check"], |texts| {
            let found = Finding::all(texts[0].unwrap_or_default()).into_iter();
            let found = found.filter(|found| ["wrong", "doubtful", "note"].contains(&&*found.severity));
            found.map(|found| (vec![("severity", found.severity), ("rule", found.rule)], 1.0)).collect()
        }),
    ),
    gauge(
        "gaugefs_memory_lost",
        "",
        "1 while the gauge reports that its RAM has lost the configuration.",
        Flag("gauge/itpor"),
    ),
    gauge(
        "gaugefs_last_error_timestamp_seconds",
        "seconds",
        "Time of the last failure, as in gauge/last_error.",
        Made(&["gauge/last_error"], |texts| {
            let time = texts[0].and_then(|text| text.split_once(": ")?.0.parse().ok());
            one(time.map(|time: Timestamp| time.as_second() as f64))
        }),
    ),
];

/// What node_exporter reads as well.
static ATTRIBUTES: &[Metric] = &[
    info(
        "gaugefs_technology",
        "The chemistry.",
        // It may only become known when data flash is read: no other series has it as a label.
        Made(&["technology"], |texts| {
            let name = texts[0].filter(|name| *name != "Unknown");
            name.map(|name| (vec![("technology", name.to_string())], 1.0)).into_iter().collect()
        }),
    ),
    gauge(
        "gaugefs_capacity_ratio",
        "ratio",
        "State of charge, 1 for a full pack.",
        Number("capacity", of_percent),
    ),
    gauge("gaugefs_voltage_volts", "volts", "Voltage of the pack.", Number("voltage_now", of_millionths)),
    gauge(
        "gaugefs_current_amperes",
        "amperes",
        "Current, negative while discharging.",
        Number("current_now", of_millionths),
    ),
    gauge(
        "gaugefs_temperature_celsius",
        "celsius",
        "Temperature of the pack.",
        Number("temp", |tenths| tenths / 10.0),
    ),
    gauge("gaugefs_cycles", "", "Cycles that the gauge has counted.", Number("cycle_count", same)),
];

fn same(number: f64) -> f64 {
    number
}

fn of_percent(number: f64) -> f64 {
    number / 100.0
}

fn of_millionths(number: f64) -> f64 {
    number / 1e6
}

/// Bits of CONTROL_STATUS about learning.
const LEARNING: [&str; 5] = ["QEN", "VOK", "RUP_DIS", "QMAX_UP", "RES_UP"];

/// The rows of a page; with `all`, also what node_exporter reads.
fn metrics(all: bool) -> impl Iterator<Item = &'static Metric> {
    METRICS.iter().chain(if all { ATTRIBUTES } else { &[] })
}

/// The files behind a page.
pub(super) fn files(all: bool) -> Vec<String> {
    ordered(metrics(all).flat_map(|metric| metric.origin.files()))
}

/// These files without repetition, grouped by folder, which is best for [`gaugefs_client::follow::all`].
pub(super) fn ordered(files: impl Iterator<Item = &'static str>) -> Vec<String> {
    let mut files: Vec<_> = files.map(|file| file.rsplit_once('/').unwrap_or(("", file))).collect();
    files.sort_unstable();
    files.dedup();
    let path = |(folder, name): (&str, &str)| {
        if folder.is_empty() { String::from(name) } else { format!("{folder}/{name}") }
    };
    files.into_iter().map(path).collect()
}

fn one(value: Option<f64>) -> Vec<Series> {
    value.map(|value| (Labels::new(), value)).into_iter().collect()
}

impl Origin {
    fn files(&self) -> Vec<&'static str> {
        match self {
            Self::Number(file, _) | Self::Flag(file) => vec![file],
            Self::Labels(labels) => labels.iter().map(|(_, file)| *file).collect(),
            Self::Made(files, _) => files.to_vec(),
        }
    }

    fn series(&self, gauge: &Gauge) -> Vec<Series> {
        match self {
            Self::Number(file, unit) => one(gauge.number(file).map(unit)),
            Self::Flag(file) => one(gauge.flag(file)),
            Self::Labels(labels) => {
                let labels = labels.iter().filter_map(|(name, file)| Some((*name, gauge.text(file)?.into())));
                let labels: Labels = labels.collect();
                if labels.is_empty() { Vec::new() } else { vec![(labels, 1.0)] }
            }
            Self::Made(files, series) => series(&gauge.texts_of(files)),
        }
    }
}

impl Gauge {
    pub(super) fn text(&self, name: &str) -> Option<&str> {
        self.texts.get(name).map(String::as_str)
    }

    pub(super) fn texts_of(&self, names: &[&str]) -> Vec<Option<&str>> {
        names.iter().map(|name| self.text(name)).collect()
    }

    pub(super) fn number(&self, name: &str) -> Option<f64> {
        self.text(name)?.parse().ok().filter(|number: &f64| number.is_finite())
    }

    /// A file that contains 0 or 1.
    pub(super) fn flag(&self, name: &str) -> Option<f64> {
        self.number(name).filter(|flag| [0.0, 1.0].contains(flag))
    }
}

/// Whether a bit of CONTROL_STATUS is set, by the texts of `model_name` and `gauge/control_status`; `None` if the part
/// lacks it.
fn bit([model, set]: [Option<&str>; 2], name: &str) -> Option<bool> {
    Chip::by_model(model?)?.control_status.iter().find(|bit| bit.name == name)?;
    Some(set?.split_whitespace().any(|set| set == name))
}

fn control_status(texts: &[Option<&str>]) -> Vec<Series> {
    let is_set = |name| bit([texts[0], texts[1]], name);
    let rows = LEARNING
        .iter()
        .filter_map(|name| Some((vec![("bit", name.to_string())], f64::from(u8::from(is_set(name)?)))));
    rows.collect()
}

/// From `gauge/seal`, which not everybody may read, or otherwise from CONTROL_STATUS, if the part shows it there.
fn seal(texts: &[Option<&str>]) -> Vec<Series> {
    let is_set = |name| bit([texts[1], texts[2]], name);
    let by_bits = || match (is_set("SS")?, is_set("FAS")?) {
        (true, _) => Some("sealed"),
        (false, true) => Some("unsealed"),
        (false, false) => Some("full-access"),
    };
    let Some(state) = texts[0].or_else(by_bits) else { return Vec::new() };
    let states = ["sealed", "unsealed", "full-access"];
    states
        .map(|name| (vec![("state", name.to_string())], f64::from(u8::from(name == state))))
        .into_iter()
        .collect()
}

/// The whole page; with `all`, also what node_exporter reads.
pub(super) fn render(mounts: &[Mount], took: Duration, format: Prometheus, all: bool) -> String {
    let mut page = Page { text: String::new(), format };
    page.head("gaugefs_build", Kind::Info, "", "Version of the gaugefs that reads the mounts.");
    page.sample("gaugefs_build", Kind::Info, &[("version", env!("CARGO_PKG_VERSION").into())], 1.0);
    page.head("gaugefs_read_duration_seconds", Kind::Gauge, "seconds", "Time taken to read all gauges.");
    page.sample("gaugefs_read_duration_seconds", Kind::Gauge, &[], took.as_micros() as f64 / 1e6);
    page.head("gaugefs_mount_up", Kind::Gauge, "", "Whether the daemon of the mount answers.");
    let place = |mount: &Mount| ("mountpoint", mount.path.display().to_string());
    for mount in mounts {
        let up = match mount.up {
            Up::Yes => 1.0,
            Up::No => 0.0,
            Up::Unknown => continue,
        };
        page.sample("gaugefs_mount_up", Kind::Gauge, &[place(mount)], up);
    }
    for metric in metrics(all) {
        let mut is_first = true;
        for mount in mounts {
            for gauge in &mount.gauges {
                for (labels, value) in metric.origin.series(gauge) {
                    if std::mem::take(&mut is_first) {
                        page.head(metric.name, metric.kind, metric.unit, metric.help);
                    }
                    let all = [place(mount), ("power_supply", gauge.name.clone())];
                    let all: Labels = all.into_iter().chain(labels).collect();
                    page.sample(metric.name, metric.kind, &all, value);
                }
            }
        }
    }
    if format == Prometheus::OpenMetrics {
        page.text += "# EOF\n";
    }
    page.text
}

struct Page {
    text: String,
    format: Prometheus,
}

impl Page {
    /// In the older format, the metric has its samples' name, units are missing, and OpenMetrics's info is a gauge.
    fn head(&mut self, name: &str, kind: Kind, unit: &str, help: &str) {
        let is_open = self.format == Prometheus::OpenMetrics;
        let end = if is_open { "" } else { end(kind) };
        let kind = match kind {
            Kind::Counter => "counter",
            Kind::Info if is_open => "info",
            Kind::Info | Kind::Gauge => "gauge",
        };
        // Writing to a String does not fail.
        let help = escaped(help);
        let _ = writeln!(self.text, "# HELP {name}{end} {help}\n# TYPE {name}{end} {kind}");
        if is_open && !unit.is_empty() {
            let _ = writeln!(self.text, "# UNIT {name} {unit}");
        }
    }

    fn sample(&mut self, name: &str, kind: Kind, labels: &[(&'static str, String)], value: f64) {
        let labels: Vec<_> =
            labels.iter().map(|(name, text)| format!("{name}=\"{}\"", escaped(text))).collect();
        let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
        let _ = writeln!(self.text, "{name}{}{labels} {value}", end(kind));
    }
}

/// A text in a label, or in the help of OpenMetrics.
fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

/// End of the names of samples.
fn end(kind: Kind) -> &'static str {
    match kind {
        Kind::Gauge => "",
        Kind::Counter => "_total",
        Kind::Info => "_info",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mount() -> Mount {
        let rows = [
            ("present", "1"),
            ("model_name", "bq34z100-G1"),
            ("serial_number", "0a10"),
            ("state_of_health", "97"),
            ("gauge/age_ms", "1500"),
            ("gauge/control_status", "FAS SS VOK QEN"),
            ("gauge/learned_status", "CF1 ITEN"),
            ("gauge/statistics/failed_polls", "3"),
            ("gauge/owed", "0"),
            ("gauge/last_error", "2026-11-22T05:40:12Z: df/80/53: refused"),
        ];
        let texts = rows.iter().map(|(name, text)| (name.to_string(), text.to_string())).collect();
        let gauges = vec![Gauge { name: "BAT0".into(), texts }];
        Mount { path: "/a\"b".into(), up: Up::Yes, gauges }
    }

    #[test]
    fn a_page_has_the_values_of_the_files_in_base_units() {
        let gone = Mount { path: "/gone".into(), up: Up::No, gauges: Vec::new() };
        let page = render(&[mount(), gone], Duration::from_millis(12), Prometheus::OpenMetrics, false);
        let of = "{mountpoint=\"/a\\\"b\",power_supply=\"BAT0\"";
        for line in [
            "gaugefs_mount_up{mountpoint=\"/gone\"} 0".to_string(),
            "gaugefs_read_duration_seconds 0.012".into(),
            "# TYPE gaugefs_chip info".into(),
            format!("gaugefs_chip_info{of},model=\"bq34z100-G1\",serial_number=\"0a10\"}} 1"),
            "# UNIT gaugefs_poll_age_seconds seconds".into(),
            format!("gaugefs_poll_age_seconds{of}}} 1.5"),
            "# TYPE gaugefs_failed_polls counter".into(),
            format!("gaugefs_failed_polls_total{of}}} 3"),
            format!("gaugefs_state_of_health_ratio{of}}} 0.97"),
            format!("gaugefs_control_status{of},bit=\"VOK\"}} 1"),
            format!("gaugefs_control_status{of},bit=\"RUP_DIS\"}} 0"),
            format!("gaugefs_update_status{of}}} 6"),
            format!("gaugefs_seal_state{of},state=\"sealed\"}} 1"),
            format!("gaugefs_seal_state{of},state=\"full-access\"}} 0"),
            format!("gaugefs_owed{of}}} 0"),
            format!("gaugefs_last_error_timestamp_seconds{of}}} 1795326012"),
        ] {
            assert!(page.lines().any(|found| found == line), "{line} is not in:\n{page}");
        }
        assert!(page.ends_with("\n# EOF\n"));
        // What the gauge does not have is not there, nor is its head.
        assert!(!page.contains("gaugefs_memory_lost") && !page.contains("QMAX_UP"), "{page}");
    }

    #[test]
    fn regression_a_line_end_in_a_file_or_a_name_begins_no_series() {
        let evil = "1\nevil_series 666\n# HELP evil \"\\".to_string();
        let tricky = "a,b=\"c\"}\u{1b}[2J\ré";
        let texts = files(true).into_iter().map(|name| (name, evil.clone())).collect();
        let path = "/run/a\nevil_mount 1".into();
        let named = Gauge { name: tricky.into(), texts: mount().gauges.remove(0).texts };
        let all = [
            Mount {
                path,
                up: Up::Yes,
                gauges: vec![Gauge { name: evil.clone(), texts }, named, mount().gauges.remove(0)],
            },
            Mount { path: "/private".into(), up: Up::Unknown, gauges: Vec::new() },
        ];
        for format in [Prometheus::OpenMetrics, Prometheus::Text] {
            let page = render(&all, Duration::ZERO, format, true);
            for line in page.lines() {
                let is_ours = ["gaugefs_", "# HELP gaugefs_", "# TYPE gaugefs_", "# UNIT gaugefs_", "# EOF"];
                assert!(is_ours.iter().any(|ours| line.starts_with(ours)), "{line}");
            }
            assert!(page.contains("serial_number=\"1\\nevil_series 666\\n# HELP evil \\\"\\\\\""), "{page}");
            assert!(page.contains("gaugefs_mount_up{mountpoint=\"/run/a\\nevil_mount 1\"} 1\n"), "{page}");
            assert!(!page.contains("/private"), "another user's: {page}");
            // A quoted comma or brace ends nothing, and other characters are as they are: a label may have any.
            let label = "power_supply=\"a,b=\\\"c\\\"}\u{1b}[2J\ré\"";
            let rows = page.split('\n').filter(|line| line.contains(label));
            assert!(rows.filter(|line| line.ends_with("} 0.97")).count() == 1, "{page}");
        }
    }

    /// What no row names is not read: a series that needs it would never appear.
    #[test]
    fn the_files_of_a_page_are_those_of_its_rows() {
        let files = files(false);
        let shown = mount().gauges.remove(0).texts;
        assert!(shown.keys().all(|file| files.contains(file)), "{files:?}");
        assert!(files.contains(&"gauge/seal".into()) && !files.contains(&"technology".into()), "{files:?}");
        assert!(super::files(true).contains(&"technology".into()));
        // Each folder is opened once.
        let folders: Vec<_> = files.iter().filter_map(|file| Some(file.rsplit_once('/')?.0)).collect();
        let runs: Vec<_> = folders.chunk_by(|one, next| one == next).map(|run| run[0]).collect();
        assert_eq!(runs, ["gauge", "gauge/statistics"]);
    }

    #[test]
    fn a_technology_that_becomes_known_begins_a_series_and_ends_none() {
        let page = |technology: &str| {
            let mut mount = mount();
            for (name, text) in [("technology", technology), ("capacity", "60"), ("current_now", "-500000")] {
                mount.gauges[0].texts.insert(name.into(), text.into());
            }
            render(&[mount], Duration::ZERO, Prometheus::Text, true)
        };
        let of = "mountpoint=\"/a\\\"b\",power_supply=\"BAT0\"";
        let (before, after) = (page("Unknown"), page("Li-ion"));
        let added: Vec<_> = after.lines().filter(|line| !before.contains(line)).collect();
        assert!(before.lines().all(|line| after.contains(line)), "{after}");
        assert_eq!(added.last(), Some(&&*format!("gaugefs_technology_info{{{of},technology=\"Li-ion\"}} 1")));
        assert!(after.contains(&format!("gaugefs_capacity_ratio{{{of}}} 0.6\n")), "{after}");
        assert!(after.contains(&format!("gaugefs_current_amperes{{{of}}} -0.5\n")), "{after}");
    }

    #[test]
    fn the_older_format_names_metrics_as_their_samples() {
        let page = render(&[mount()], Duration::ZERO, Prometheus::Text, false);
        let has = |line: &str| page.lines().any(|found| found == line);
        assert!(has("# TYPE gaugefs_failed_polls_total counter") && has("# TYPE gaugefs_chip_info gauge"));
        assert!(!page.contains("# UNIT") && !page.contains("# EOF"), "{page}");
    }
}
