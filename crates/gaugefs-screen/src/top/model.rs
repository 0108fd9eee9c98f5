// SPDX-License-Identifier: MIT

//! The state of `top`, and the effects of its keys. It reads no file and draws nothing.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

use super::super::learning;
use super::history::{History, Past, Quantity, seconds};
use gaugefs_client::sample::Sample;
use gaugefs_client::watch::{Learned, Order, Report, Seen};
use ti_gauge::learning::{Cycle, Limits, State};

/// The time spans of a chart, in seconds.
const SPANS: [(f64, &str); 10] = [
    (60.0, "1 min"),
    (300.0, "5 min"),
    (900.0, "15 min"),
    (3600.0, "1 h"),
    (3.0 * 3600.0, "3 h"),
    (6.0 * 3600.0, "6 h"),
    (12.0 * 3600.0, "12 h"),
    (86_400.0, "1 d"),
    (3.0 * 86_400.0, "3 d"),
    (7.0 * 86_400.0, "7 d"),
];
/// A mount hangs if its report is overdue by this many seconds.
const SILENCE: f64 = 5.0;
/// Seconds between two reads of an unsealed gauge's learned values.
const LEARNED_EVERY: f64 = 60.0;
/// Number of kept changes of bits and learned values.
const MOST_CHANGES: usize = 500;

pub(super) struct Gauge {
    pub(super) folder: PathBuf,
    root: usize,
    /// The last sample, and the one on the screen, which is older during a pause.
    latest: Option<Sample>,
    pub(super) shown: Option<Sample>,
    pub(super) trouble: Option<String>,
    pub(super) history: History,
    /// Changes of bits and learned values, newest first.
    pub(super) changes: VecDeque<(f64, String)>,
    pub(super) learned: Option<Result<Vec<Learned>, String>>,
    /// The learning cycle, if the part has one, and its state on the screen.
    cycle: Option<Cycle>,
    limits: Limits,
    state: Option<State>,
    pub(super) shown_state: Option<State>,
    /// When learned values were requested, and when they arrived.
    asked: Option<f64>,
    pub(super) learned_at: Option<f64>,
}

impl Gauge {
    pub(super) fn name(&self) -> String {
        self.folder.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    /// Whether the gauge is unsealed; `None` if the user may not read its seal state.
    pub(super) fn unsealed(&self) -> Option<bool> {
        let seal = self.latest.as_ref()?.seal.as_ref()?;
        Some(seal != "sealed")
    }
}

/// The caller's task after a key press.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Action {
    Nothing,
    Quit,
    /// Control-Z.
    Suspend,
}

pub(super) struct Model {
    pub(super) gauges: Vec<Gauge>,
    pub(super) selected: usize,
    /// The chart's quantity; `None` for all, where there is room.
    pub(super) quantity: Option<Quantity>,
    span: usize,
    pub(super) paused: Option<f64>,
    pub(super) help: bool,
    pub(super) learning: bool,
    /// The reply to the last key press, until the next one.
    pub(super) message: String,
    pub(super) colour: bool,
    /// Recorded histories.
    logs: Vec<Past>,
    /// Time between two samples, in seconds.
    every: f64,
    /// Each mount's last report.
    reported: Vec<f64>,
    orders: Vec<(usize, Order)>,
}

impl Model {
    pub(super) fn new(every: f64, colour: bool) -> Self {
        Self {
            gauges: Vec::new(),
            selected: 0,
            quantity: None,
            span: 1,
            paused: None,
            help: false,
            learning: false,
            message: String::new(),
            colour,
            logs: Vec::new(),
            every,
            reported: Vec::new(),
            orders: Vec::new(),
        }
    }

    pub(super) fn with(mut self, logs: Vec<Past>) -> Self {
        self.logs = logs;
        self
    }

    /// A log's history of a gauge. A log names no mount, so two gauges with the same name have none; nor does a
    /// simulated battery whose time runs faster than the clock.
    pub(super) fn past(&self, gauge: &Gauge) -> Option<&Past> {
        let name = gauge.name();
        let is_other = |other: &Gauge| other.folder != gauge.folder && other.name() == name;
        let is_slow = |sample: &Sample| {
            let ahead = sample.battery_time().duration_since(sample.time).as_secs_f64();
            ahead.abs() < 1.0 && sample.simulated.is_none_or(|(_, speed)| speed == 1.0)
        };
        let has_one =
            self.gauges.iter().all(|other| !is_other(other)) && gauge.shown.as_ref().is_none_or(is_slow);
        self.logs.iter().find(|past| past.gauge == name).filter(|_| has_one)
    }

    pub(super) fn span(&self) -> (f64, &'static str) {
        SPANS[self.span]
    }

    pub(super) fn gauge(&self) -> Option<&Gauge> {
        self.gauges.get(self.selected)
    }

    /// Adds new mounts. Silence of a new mount counts from now.
    pub(super) fn add_mounts(&mut self, roots: &[PathBuf], now: f64) {
        for (at, root) in roots.iter().enumerate().skip(self.reported.len()) {
            self.reported.push(now);
            if !self.gauges.iter().any(|gauge| gauge.root == at) {
                self.gauges.push(Gauge::new(root, at));
            }
        }
    }

    /// Seconds without a report from a hanging mount.
    pub(super) fn silence(&self, gauge: &Gauge, now: f64) -> Option<f64> {
        Some(now - self.reported.get(gauge.root)?).filter(|silent| *silent > self.every + SILENCE)
    }

    pub(super) fn update(&mut self, report: Report, now: f64) {
        if let Some(reported) = self.reported.get_mut(report.root) {
            *reported = now;
        }
        let paused = self.paused.is_some();
        if let Seen::Trouble(why) = &report.seen {
            let all = self.gauges.iter_mut().filter(|gauge| gauge.root == report.root);
            for gauge in all.filter(|gauge| gauge.folder.starts_with(&report.gauge)) {
                gauge.trouble = Some(why.clone());
                gauge.latest = None;
                gauge.shown = gauge.shown.take().filter(|_| paused);
                gauge.history.gap(now);
            }
            return;
        }
        let gauge = self.find(&report);
        match report.seen {
            Seen::Sample(sample) => gauge.update(*sample, paused),
            Seen::Learned(outcome) => gauge.update_learned(outcome, now),
            Seen::Limits(limits) => gauge.set_limits(limits),
            Seen::Refused(why) => self.message = why,
            Seen::Trouble(_) => {}
        }
    }

    /// The gauge of a report. A mount's first gauge replaces the mount's own entry.
    fn find(&mut self, report: &Report) -> &mut Gauge {
        let same = |gauge: &Gauge| gauge.root == report.root && gauge.folder == report.gauge;
        let kept = |gauge: &Gauge| {
            gauge.root == report.root && gauge.latest.is_none() && report.gauge.starts_with(&gauge.folder)
        };
        let at = self.gauges.iter().position(same).or_else(|| self.gauges.iter().position(kept));
        let at = at.unwrap_or_else(|| {
            self.gauges.push(Gauge::new(&report.gauge, report.root));
            self.gauges.len() - 1
        });
        self.gauges[at].folder.clone_from(&report.gauge);
        &mut self.gauges[at]
    }

    /// Orders for the threads. Without a key press, data flash is read only if the gauge is unsealed anyway and the
    /// screen shows learned values.
    pub(super) fn orders(&mut self, now: f64) -> Vec<(usize, Order)> {
        let learning = self.learning && self.paused.is_none();
        if let Some(gauge) = self.gauges.get_mut(self.selected).filter(|_| learning) {
            let due = gauge.asked.is_none_or(|asked| now - asked >= LEARNED_EVERY);
            if due && gauge.unsealed() == Some(true) {
                gauge.asked = Some(now);
                self.orders.push((gauge.root, Order::ReadLearned(gauge.folder.clone())));
            }
        }
        std::mem::take(&mut self.orders)
    }

    pub(super) fn key(&mut self, key: KeyEvent, now: f64) -> Action {
        let control = key.modifiers.contains(KeyModifiers::CONTROL);
        self.message.clear();
        let count = self.gauges.len().max(1);
        match key.code {
            KeyCode::Char('c') if control => return Action::Quit,
            KeyCode::Char('z') if control => return Action::Suspend,
            _ if control => {}
            KeyCode::Char('?' | 'h') => self.help = !self.help,
            KeyCode::Esc if self.help || self.learning => (self.help, self.learning) = (false, false),
            KeyCode::Char('q') | KeyCode::Esc => return Action::Quit,
            // Hidden or missing things do not change unseen.
            _ if self.help || self.gauges.is_empty() => {}
            KeyCode::Down | KeyCode::Right | KeyCode::Tab => self.selected = (self.selected + 1) % count,
            KeyCode::Up | KeyCode::Left | KeyCode::BackTab => {
                self.selected = (self.selected + count - 1) % count;
            }
            KeyCode::Char('+' | '=') => self.span = (self.span + 1).min(SPANS.len() - 1),
            KeyCode::Char('-') => self.span = self.span.saturating_sub(1),
            KeyCode::Char('l') => self.learning = !self.learning,
            KeyCode::Char('p' | ' ') => self.pause(now),
            KeyCode::Char('r') => self.order(Order::Refresh, "polling now"),
            KeyCode::Char('d') => {
                self.learning = true;
                self.order(Order::ReadLearned, "reading data flash");
            }
            KeyCode::Char('a') => self.quantity = None,
            KeyCode::Char(other) => self.quantity = Quantity::of_key(other).or(self.quantity),
            _ => {}
        }
        Action::Nothing
    }

    fn order(&mut self, order: fn(PathBuf) -> Order, text: &str) {
        if let Some(gauge) = self.gauges.get(self.selected).filter(|gauge| gauge.latest.is_some()) {
            self.orders.push((gauge.root, order(gauge.folder.clone())));
            self.message = format!("{}: {text}", gauge.name());
        }
    }

    fn pause(&mut self, now: f64) {
        self.paused = if self.paused.is_some() { None } else { Some(now) };
        for gauge in self.gauges.iter_mut().filter(|_| self.paused.is_none()) {
            gauge.shown.clone_from(&gauge.latest);
            gauge.shown_state.clone_from(&gauge.state);
        }
    }
}

impl Gauge {
    fn new(folder: &Path, root: usize) -> Self {
        Self {
            folder: folder.to_path_buf(),
            root,
            latest: None,
            shown: None,
            trouble: None,
            history: History::default(),
            changes: VecDeque::new(),
            learned: None,
            cycle: None,
            limits: Limits::default(),
            state: None,
            shown_state: None,
            asked: None,
            learned_at: None,
        }
    }

    fn update(&mut self, sample: Sample, paused: bool) {
        self.trouble = None;
        let time = seconds(sample.time);
        if !sample.present() {
            self.history.gap(time);
        } else {
            let before = self.latest.as_ref();
            let same = before
                .and_then(|before| before.moment)
                .zip(sample.moment)
                .is_some_and(|(a, b)| a.is_same_poll(b));
            if !same {
                self.history.add(&sample);
                self.watch_cycle(&sample);
            }
        }
        let changes = self.latest.iter().flat_map(|before| sample.changed_bits(before));
        let changes: Vec<_> = changes.map(|(name, bits)| format!("{name}: {bits}")).collect();
        changes.into_iter().for_each(|text| self.change(time, text));
        if !paused {
            self.shown = Some(sample.clone());
            self.shown_state.clone_from(&self.state);
        }
        self.latest = Some(sample);
    }

    fn watch_cycle(&mut self, sample: &Sample) {
        if self.cycle.is_none() {
            self.cycle = learning::cycle(sample);
            self.set_limits(self.limits);
        }
        if let (Some(cycle), Some(reading)) = (&mut self.cycle, learning::reading(sample)) {
            self.state = Some(cycle.update(&reading));
        }
    }

    fn set_limits(&mut self, limits: Limits) {
        self.limits = limits;
        if let Some(cycle) = &mut self.cycle {
            cycle.set_limits(limits);
        }
    }

    fn update_learned(&mut self, outcome: Result<Vec<Learned>, String>, now: f64) {
        if let (Some(Ok(before)), Ok(after)) = (&self.learned, &outcome) {
            let pairs = before.iter().zip(after).filter(|(before, after)| before.value != after.value);
            let text: Vec<_> = pairs
                .map(|(before, after)| format!("{}: {} -> {}", after.name, before.value, after.value))
                .collect();
            text.into_iter().for_each(|text| self.change(now, text));
        }
        self.learned = Some(outcome);
        self.learned_at = Some(now);
    }

    fn change(&mut self, time: f64, text: String) {
        self.changes.push_front((time, text));
        self.changes.truncate(MOST_CHANGES);
    }
}
