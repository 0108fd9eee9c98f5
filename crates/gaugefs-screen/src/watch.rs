// SPDX-License-Identifier: MIT

//! `gaugefs watch`: runs programs when conditions come true.
//!
//! It is a program apart from the daemon, which starts no programs and has no privilege. It uses only files of the
//! mount.

use std::collections::HashMap;
use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, ExitStatus, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

use jiff::Timestamp;
use nix::errno::Errno;

use gaugefs_client::condition::{Condition, Texts};
use gaugefs_client::follow::{self, Calling, Seen};
use gaugefs_client::watch::INTERVAL;
use gaugefs_host::error::{Error, Result, shown};
use gaugefs_host::output::{self, print, say};
use gaugefs_host::program;

/// Raises and clears an alert, and runs programs for it.
#[derive(Clone, Debug)]
pub struct Rule {
    /// Raises the alert.
    pub when: Condition,
    /// Clears the alert, so that it can be raised again; `None` for the end of the first condition.
    pub clear: Option<Condition>,
    /// How long the condition must be true in every poll.
    pub hold: Duration,
    /// Program for raising it, with arguments; empty for none.
    pub exec: Vec<String>,
    /// Program for clearing it.
    pub exec_clear: Vec<String>,
    /// Name in messages; `None` for the condition.
    pub name: Option<String>,
    /// Folder name of its only gauge.
    pub gauge: Option<String>,
}

impl Rule {
    fn shown(&self) -> String {
        self.name.clone().unwrap_or_else(|| self.when.to_string())
    }

    /// Checks that its programs can be started: later it would be too late.
    pub fn check(&self) -> Result<()> {
        let mut programs = [&self.exec, &self.exec_clear].into_iter();
        programs
            .try_for_each(|program| program::check(program))
            .map_err(|error| error.within(&format!("alert {}", self.shown())))
    }

    fn names(&self) -> impl Iterator<Item = &str> {
        self.when.names().chain(self.clear.iter().flat_map(Condition::names))
    }
}

/// Watches the gauges at a mount point, or one by its folder, until nobody reads the output.
pub fn run(place: &Path, rules: &[Rule]) -> Result<ExitCode> {
    Watching::start(place, rules)?.run()
}

/// Runs each alert's programs once, for its first gauge, whatever that shows.
pub fn test(place: &Path, rules: &[Rule]) -> Result<ExitCode> {
    Watching::start(place, rules)?.test()
}

enum Event {
    Seen(Seen),
    Ended(usize, io::Result<ExitStatus>),
}

impl From<Seen> for Event {
    fn from(seen: Seen) -> Self {
        Self::Seen(seen)
    }
}

struct Gauge {
    folder: PathBuf,
    texts: Option<Texts>,
    /// The reason for having no texts that was printed last.
    trouble: String,
    calling: Calling,
}

/// An alert of a gauge.
struct Alert {
    gauge: usize,
    rule: Rule,
    /// Index of its rule.
    of: usize,
    state: State,
    /// A program has run for the last event, or was not needed.
    told: bool,
    running: bool,
}

impl Alert {
    fn command(&self, gauge: &Gauge) -> Option<Command> {
        let words = if self.state.raised { &self.rule.exec } else { &self.rule.exec_clear };
        let (program, arguments) = words.split_first()?;
        let mut command = Command::new(program);
        command.args(arguments).envs(facts(gauge, self)).stdin(Stdio::null());
        Some(command)
    }
}

#[derive(Debug, Default)]
struct State {
    raised: bool,
    /// Start of the time in which its condition was true in every poll.
    since: Option<Instant>,
}

impl State {
    fn update(&mut self, rule: &Rule, texts: Option<&Texts>, now: Instant) {
        let holds = rule.when.holds(texts);
        if self.raised {
            let is_over = match &rule.clear {
                Some(clear) => clear.holds(texts) == Some(true),
                None => holds == Some(false),
            };
            self.raised = !is_over;
            self.since = None;
        }
        // The poll that clears an alert does not raise it again.
        else if holds == Some(true) {
            let since = *self.since.get_or_insert(now);
            self.raised = now.duration_since(since) >= rule.hold;
        } else {
            self.since = None;
        }
    }
}

struct Watching {
    gauges: Vec<Gauge>,
    alerts: Vec<Alert>,
    sender: Sender<Event>,
    events: mpsc::Receiver<Event>,
}

impl Watching {
    fn start(place: &Path, rules: &[Rule]) -> Result<Self> {
        rules.iter().try_for_each(Rule::check)?;
        let folders = follow::gauges_at(place)?;
        let names = folders.iter().map(|gauge| gaugefs_client::last_name(gauge)).collect::<Vec<_>>();
        let mut alerts = Vec::new();
        for (of, rule) in rules.iter().enumerate() {
            if let Some(wanted) = &rule.gauge
                && !names.contains(wanted)
            {
                let why = format!("no gauge {wanted} is mounted there, only {}", names.join(", "));
                return Err(Error::host(place.display().to_string(), Errno::ENOENT, why));
            }
            let is_for = |name: &String| rule.gauge.as_ref().is_none_or(|wanted| wanted == name);
            let gauges = (0..).zip(&names).filter(|(_, name)| is_for(name));
            alerts.extend(gauges.map(|(gauge, _)| Alert {
                gauge,
                rule: rule.clone(),
                of,
                state: State::default(),
                told: false,
                running: false,
            }));
        }
        let (sender, events) = mpsc::channel();
        let mut gauges = Vec::new();
        for (number, folder) in folders.into_iter().enumerate() {
            let of_gauge = alerts.iter().filter(|alert| alert.gauge == number);
            let mut files: Vec<_> =
                of_gauge.flat_map(|alert| alert.rule.names()).map(str::to_string).collect();
            files.sort();
            files.dedup();
            let calling = follow::to_channel(number, folder.clone(), files, sender.clone())?;
            gauges.push(Gauge { folder, texts: None, trouble: String::new(), calling });
        }
        Ok(Self { gauges, alerts, sender, events })
    }

    fn run(mut self) -> Result<ExitCode> {
        loop {
            if output::is_unread() && !self.has_programs() {
                return Ok(ExitCode::SUCCESS);
            }
            for event in self.next() {
                match event {
                    Event::Seen(seen) => self.seen(seen)?,
                    Event::Ended(alert, outcome) => self.ended(alert, outcome),
                }
            }
        }
    }

    fn test(mut self) -> Result<ExitCode> {
        if !self.has_programs() {
            return Err(Error::host("--test", Errno::EINVAL, "no alert has a program; give one with --exec"));
        }
        while self.gauges.iter().any(|gauge| gauge.texts.is_none() && gauge.trouble.is_empty()) {
            for event in self.next() {
                if let Event::Seen(seen) = event {
                    self.take(seen);
                }
            }
        }
        let mut code = ExitCode::SUCCESS;
        // Alerts of a rule are neighbours.
        let first = self.alerts.chunk_by_mut(|one, next| one.of == next.of);
        for alert in first.filter_map(<[Alert]>::first_mut) {
            for raised in [true, false] {
                alert.state.raised = raised;
                let gauge = &self.gauges[alert.gauge];
                let Some(mut command) = alert.command(gauge) else { continue };
                print_event(gauge, alert)?;
                let outcome = command.env("GAUGEFS_TEST", "1").status();
                if let Some(why) = failure(outcome) {
                    say(format_args!("alert {}: its program has failed: {why}", alert.rule.shown()));
                    code = ExitCode::FAILURE;
                }
            }
        }
        Ok(code)
    }

    /// Waits for events, including gauges that do not answer.
    fn next(&self) -> Vec<Event> {
        match self.events.recv_timeout(INTERVAL) {
            Ok(event) => vec![event],
            Err(RecvTimeoutError::Timeout) => {
                let silent = (0..).zip(&self.gauges).filter(|(_, gauge)| gauge.calling.is_silent());
                let seen = |gauge| Event::Seen(Seen { gauge, texts: Err(follow::SILENT.into()) });
                silent.map(|(gauge, _)| seen(gauge)).collect()
            }
            Err(RecvTimeoutError::Disconnected) => unreachable!("it has a sender of its own"),
        }
    }

    fn has_programs(&self) -> bool {
        self.alerts.iter().any(|alert| !(alert.rule.exec.is_empty() && alert.rule.exec_clear.is_empty()))
    }

    fn take(&mut self, seen: Seen) {
        let gauge = &mut self.gauges[seen.gauge];
        match seen.texts {
            Ok(texts) => {
                gauge.texts = Some(texts);
                gauge.trouble.clear();
            }
            Err(why) => {
                gauge.texts = None;
                if gauge.trouble != why {
                    say(format_args!("{}: {why}", shown(&gauge.folder)));
                    gauge.trouble = why;
                }
            }
        }
    }

    fn seen(&mut self, seen: Seen) -> Result<()> {
        let (now, gauge) = (Instant::now(), seen.gauge);
        self.take(seen);
        for number in 0..self.alerts.len() {
            let alert = &mut self.alerts[number];
            if alert.gauge != gauge {
                continue;
            }
            let before = alert.state.raised;
            let texts = self.gauges[gauge].texts.as_ref();
            alert.state.update(&alert.rule, texts, now);
            if alert.state.raised != before {
                let printed = print_event(&self.gauges[gauge], alert);
                // Programs make lines unnecessary.
                match printed {
                    Err(error) if self.has_programs() => say(error),
                    printed => printed?,
                }
                self.act(number);
            }
        }
        Ok(())
    }

    /// Runs the program for an alert's state, unless one still runs or has run for it.
    fn act(&mut self, number: usize) {
        let alert = &mut self.alerts[number];
        let raised = alert.state.raised;
        if alert.running || alert.told == raised {
            return;
        }
        alert.told = raised;
        let Some(mut command) = alert.command(&self.gauges[alert.gauge]) else { return };
        let name = alert.rule.shown();
        let waits = command.spawn().and_then(|mut child| {
            let sender = self.sender.clone();
            let wait = move || {
                let outcome = child.wait();
                // The end of watching is the end of listening.
                let _ = sender.send(Event::Ended(number, outcome));
            };
            std::thread::Builder::new().stack_size(256 * 1024).spawn(wait)
        });
        match waits {
            Ok(_) => alert.running = true,
            Err(error) => {
                let program = command.get_program().to_string_lossy();
                say(Error::io(program, "cannot be started", &error).within(&format!("alert {name}")));
            }
        }
    }

    fn ended(&mut self, number: usize, outcome: io::Result<ExitStatus>) {
        let alert = &mut self.alerts[number];
        alert.running = false;
        if let Some(why) = failure(outcome) {
            say(format_args!("alert {}: its program has failed: {why}", alert.rule.shown()));
        }
        self.act(number);
    }
}

fn failure(outcome: io::Result<ExitStatus>) -> Option<String> {
    match outcome {
        Ok(status) if status.success() => None,
        Ok(status) => Some(status.to_string()),
        Err(error) => Some(error.to_string()),
    }
}

fn event(alert: &Alert) -> &'static str {
    if alert.state.raised { "raised" } else { "cleared" }
}

fn print_event(gauge: &Gauge, alert: &Alert) -> Result<()> {
    let (name, values) =
        (gaugefs_client::last_name(&gauge.folder), alert.rule.when.values(gauge.texts.as_ref()));
    let line = format!("{:.0} {name}: {} {} ({values})", Timestamp::now(), event(alert), alert.rule.shown());
    print(&(ti_gauge::text::printable(&line) + "\n"))
}

fn facts(gauge: &Gauge, alert: &Alert) -> HashMap<String, OsString> {
    let mut facts = HashMap::new();
    let texts = gauge.texts.iter().flatten().filter(|(name, _)| !name.contains('/'));
    facts.extend(texts.map(|(name, text)| (format!("POWER_SUPPLY_{}", name.to_uppercase()), text.into())));
    let value = alert.rule.when.names().next().and_then(|name| gauge.texts.as_ref()?.get(name));
    let rows = [
        ("EVENT", Some(event(alert).into())),
        ("ALERT", Some(alert.rule.shown().into())),
        ("CONDITION", Some(alert.rule.when.to_string().into())),
        ("VALUE", value.map(OsString::from)),
        ("GAUGE", Some(gauge.folder.clone().into_os_string())),
    ];
    facts.extend(rows.into_iter().filter_map(|(name, fact)| Some((format!("GAUGEFS_{name}"), fact?))));
    facts
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rule(when: &str, clear: Option<&str>, hold: u64) -> Rule {
        let parse = |text: &str| text.parse().expect(text);
        Rule {
            when: parse(when),
            clear: clear.map(parse),
            hold: Duration::from_secs(hold),
            exec: Vec::new(),
            exec_clear: Vec::new(),
            name: None,
            gauge: None,
        }
    }

    /// States after polls with these capacities, one per second.
    fn states(rule: &Rule, capacities: &[Option<u32>]) -> Vec<bool> {
        let (start, mut state) = (Instant::now(), State::default());
        let seconds = (0..).zip(capacities);
        let states = seconds.map(|(second, capacity)| {
            let texts: Texts =
                capacity.iter().map(|number| ("capacity".into(), number.to_string())).collect();
            state.update(rule, Some(&texts), start + Duration::from_secs(second));
            state.raised
        });
        states.collect()
    }

    #[test]
    fn an_alert_is_raised_once_and_cleared_by_its_own_condition() {
        let low = rule("capacity<20", Some("capacity>25"), 0);
        let polls = [30, 20, 19, 21, 19, 25, 26, 21, 19].map(Some);
        let raised = [false, false, true, true, true, true, false, false, true];
        assert_eq!(states(&low, &polls), raised);
        let plain = rule("capacity<20", None, 0);
        assert_eq!(states(&plain, &[19, 20, 19].map(Some)), [true, false, true]);
    }

    #[test]
    fn a_missing_value_neither_raises_nor_clears() {
        let low = rule("capacity<20", None, 0);
        assert_eq!(states(&low, &[None, Some(19), None, Some(30), None]), [false, true, true, false, false]);
    }

    #[test]
    fn a_condition_must_be_true_in_every_poll_of_its_time() {
        let low = rule("capacity<20", None, 2);
        let polls = [Some(19), Some(19), Some(19), Some(30), Some(19), None, Some(19), Some(19), Some(19)];
        let raised = [false, false, true, false, false, false, false, false, true];
        assert_eq!(states(&low, &polls), raised);
        let zero = rule("capacity<20", None, 0);
        assert_eq!(states(&zero, &[Some(19)]), [true]);
    }

    #[test]
    fn a_gauge_that_is_gone_raises_missing_only() {
        let (mut gone, mut low) = (State::default(), State::default());
        gone.update(&rule("missing", None, 0), None, Instant::now());
        low.update(&rule("capacity<20", None, 0), None, Instant::now());
        assert!(gone.raised && !low.raised);
        gone.update(&rule("missing", None, 0), Some(&Texts::new()), Instant::now());
        assert!(!gone.raised);
    }
}
