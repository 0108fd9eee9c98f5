// SPDX-License-Identifier: MIT

//! `gaugefs watch`: runs programs when conditions come true.
//!
//! It is a program of its own, apart from the daemon, which starts no programs and has no privilege. All it has of a
//! gauge are the files of the mount.

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

/// When an alert is raised and cleared, and what is run for it.
#[derive(Clone, Debug)]
pub struct Rule {
    /// When it is raised.
    pub when: Condition,
    /// When it is cleared, and can be raised again; `None` for when the first condition is false.
    pub clear: Option<Condition>,
    /// For how long the condition must be true in every poll.
    pub hold: Duration,
    /// Program to run when it is raised, with its arguments; none if that is empty.
    pub exec: Vec<String>,
    /// Program to run when it is cleared.
    pub exec_clear: Vec<String>,
    /// Its name in messages; `None` for its condition.
    pub name: Option<String>,
    /// Name of the folder of the only gauge that it is for.
    pub gauge: Option<String>,
}

impl Rule {
    /// What it is called.
    fn shown(&self) -> String {
        self.name.clone().unwrap_or_else(|| self.when.to_string())
    }

    /// Whether its programs can be started, which is seen too late when they have to be.
    pub fn check(&self) -> Result<()> {
        let mut programs = [&self.exec, &self.exec_clear].into_iter();
        programs
            .try_for_each(|program| program::check(program))
            .map_err(|error| error.within(&format!("alert {}", self.shown())))
    }

    /// The files that it compares.
    fn names(&self) -> impl Iterator<Item = &str> {
        self.when.names().chain(self.clear.iter().flat_map(Condition::names))
    }
}

/// Watches the gauges at a mount point, or one by its folder, until nobody reads the output any more.
pub fn run(place: &Path, rules: &[Rule]) -> Result<ExitCode> {
    Watching::start(place, rules)?.run()
}

/// Runs the programs of each alert once, for the first gauge that it is for, whatever that shows.
pub fn test(place: &Path, rules: &[Rule]) -> Result<ExitCode> {
    Watching::start(place, rules)?.test()
}

/// What the main thread waits for.
enum Event {
    Seen(Seen),
    /// The program of an alert has ended.
    Ended(usize, io::Result<ExitStatus>),
}

impl From<Seen> for Event {
    fn from(seen: Seen) -> Self {
        Self::Seen(seen)
    }
}

/// A gauge that is watched.
struct Gauge {
    folder: PathBuf,
    texts: Option<Texts>,
    /// Why there are no texts, as it was printed last.
    trouble: String,
    calling: Calling,
}

/// One alert of one gauge.
struct Alert {
    gauge: usize,
    rule: Rule,
    /// Its place among the rules.
    of: usize,
    state: State,
    /// The event for which a program was run last, or none was needed.
    told: bool,
    running: bool,
}

impl Alert {
    /// The program for its present state.
    fn command(&self, gauge: &Gauge) -> Option<Command> {
        let words = if self.state.raised { &self.rule.exec } else { &self.rule.exec_clear };
        let (program, arguments) = words.split_first()?;
        let mut command = Command::new(program);
        command.args(arguments).envs(facts(gauge, self)).stdin(Stdio::null());
        Some(command)
    }
}

/// Whether an alert is raised.
#[derive(Debug, Default)]
struct State {
    raised: bool,
    /// Since when its condition has been true in every poll.
    since: Option<Instant>,
}

impl State {
    /// Takes a poll in.
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
        // What clears an alert does not raise it again at once.
        else if holds == Some(true) {
            let since = *self.since.get_or_insert(now);
            self.raised = now.duration_since(since) >= rule.hold;
        } else {
            self.since = None;
        }
    }
}

/// All that is watched.
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
        // The alerts of a rule follow each other.
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

    /// What has happened, or is to be said of gauges that do not answer.
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

    /// Whether an alert runs a program.
    fn has_programs(&self) -> bool {
        self.alerts.iter().any(|alert| !(alert.rule.exec.is_empty() && alert.rule.exec_clear.is_empty()))
    }

    /// Keeps what was seen of a gauge.
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

    /// Takes a look at a gauge in.
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
                // Whoever has programs run needs no lines.
                match printed {
                    Err(error) if self.has_programs() => say(error),
                    printed => printed?,
                }
                self.act(number);
            }
        }
        Ok(())
    }

    /// Runs the program for the present state of an alert, unless the last one still runs or has run for it.
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
                // Nobody listens at the end of the program.
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

/// Why a program has failed, if it has.
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

/// A line for each change.
fn print_event(gauge: &Gauge, alert: &Alert) -> Result<()> {
    let (name, values) =
        (gaugefs_client::last_name(&gauge.folder), alert.rule.when.values(gauge.texts.as_ref()));
    let line = format!("{:.0} {name}: {} {} ({values})", Timestamp::now(), event(alert), alert.rule.shown());
    print(&(ti_gauge::text::printable(&line) + "\n"))
}

/// The environment of an alert's program.
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

    /// The states after polls with these capacities, one a second.
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
