// SPDX-License-Identifier: MIT

//! Scenarios: what happens to a gauge, and when, written as TOML.
//!
//! A scenario turns knobs at times of the battery, so that it is the same at any `speed`, or after a number of
//! transfers or commits. A step may also exchange the pack or put bytes into flash. Random values are drawn when the
//! file is read: the same file and seed make the same steps.

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::time::Duration;

use gauge_bus::error::{Error, ErrorKind, Result};
use serde::Deserialize;
use toml::Value;

use super::random::Random;

const SHIPPED: &[(&str, &str)] = &[
    ("drone-flight", include_str!("scenarios/drone-flight.toml")),
    ("ebike-ride", include_str!("scenarios/ebike-ride.toml")),
    ("failed-pack", include_str!("scenarios/failed-pack.toml")),
    ("failing-bus", include_str!("scenarios/failing-bus.toml")),
    ("laptop-year", include_str!("scenarios/laptop-year.toml")),
    ("power-cut", include_str!("scenarios/power-cut.toml")),
    ("robot-day", include_str!("scenarios/robot-day.toml")),
    ("solar-week", include_str!("scenarios/solar-week.toml")),
    ("swapped-pack", include_str!("scenarios/swapped-pack.toml")),
];

const LONGEST: u64 = 1 << 20;
/// Largest number of single steps in a file.
const MOST: usize = 200_000;
const LONGEST_TIME: Duration = Duration::from_secs(10 * 366 * 24 * 3600);
/// Interval of a ramp's steps, unless the step sets its own.
const EVERY: Duration = Duration::from_secs(60);

/// Exchanges the pack, before the rest of its step.
pub(super) const PACK: &str = "pack";
/// Puts bytes into flash.
pub(super) const FLASH: &str = "flash";

/// A scenario, ready to be played.
#[derive(Clone, Debug, Default)]
pub struct Scenario {
    /// Seed of random faults too.
    pub(super) seed: u64,
    /// By battery time since the start.
    timed: Vec<(Duration, Act)>,
    /// Steps that wait for traffic.
    counted: Vec<Counted>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Act {
    pub(super) knob: String,
    pub(super) text: String,
    /// The step's number, for messages.
    step: usize,
}

#[derive(Clone, Debug)]
struct Counted {
    count: Count,
    after: Duration,
    acts: Vec<Act>,
}

#[derive(Clone, Copy, Debug)]
enum Count {
    Transfers(u64),
    Commits(u64),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Script {
    #[expect(dead_code, reason = "it is for the reader of the file")]
    about: Option<String>,
    seed: Option<u64>,
    repeat: Option<Time>,
    times: Option<u32>,
    #[serde(default)]
    start: BTreeMap<String, Value>,
    #[serde(default)]
    step: Vec<Step>,
}

#[derive(Deserialize)]
struct Step {
    at: Option<Time>,
    transfer: Option<u64>,
    commit: Option<u64>,
    after: Option<Time>,
    over: Option<Time>,
    every: Option<Time>,
    jitter: Option<f64>,
    #[serde(flatten)]
    knobs: BTreeMap<String, Value>,
}

/// `90`, `"90s"` or `"1h30m"`.
#[derive(Clone, Copy)]
struct Time(Duration);

impl<'de> Deserialize<'de> for Time {
    fn deserialize<D: serde::Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let value = Value::deserialize(from)?;
        let time = match &value {
            Value::Integer(seconds) => u64::try_from(*seconds).ok().map(Duration::from_secs),
            Value::String(text) => time(text),
            _ => None,
        };
        time.filter(|time| *time <= LONGEST_TIME).map(Self).ok_or_else(|| {
            serde::de::Error::custom(
                "not a time; write seconds, or one such as \"1h30m\", \"2d\" or \"250ms\"",
            )
        })
    }
}

fn time(text: &str) -> Option<Duration> {
    let mut rest = text.trim();
    let mut sum = Duration::ZERO;
    while !rest.is_empty() {
        let (number, after) = rest.split_at(rest.find(|at: char| !at.is_ascii_digit())?);
        let end = after.find(|at: char| at.is_ascii_digit() || at == ' ').unwrap_or(after.len());
        let (unit, after) = after.split_at(end);
        let milliseconds: u64 = match unit {
            "ms" => 1,
            "s" => 1000,
            "m" | "min" => 60_000,
            "h" => 3_600_000,
            "d" => 86_400_000,
            _ => return None,
        };
        sum += Duration::from_millis(number.parse::<u64>().ok()?.checked_mul(milliseconds)?);
        rest = after.trim_start();
    }
    (!text.trim().is_empty()).then_some(sum)
}

/// The names of the scenarios that come with the simulator.
pub fn names() -> impl Iterator<Item = &'static str> {
    SHIPPED.iter().map(|(name, _)| *name)
}

impl Scenario {
    /// Reads a scenario: one of [`names`], or a file if the path has a slash. `seed` replaces the file's.
    pub fn read(name: &Path, seed: Option<u64>) -> Result<Self> {
        let subject = name.display().to_string();
        if !subject.contains('/') {
            let found = SHIPPED.iter().find(|(shipped, _)| *shipped == subject);
            let known = || names().collect::<Vec<_>>().join(", ");
            let why = || {
                format!(
                    "there is no such scenario; there are: {}. A file has a slash, such as ./day.toml",
                    known()
                )
            };
            let (_, text) = found.ok_or_else(|| Error::new(&subject, ErrorKind::Invalid, why()))?;
            return Self::parse(&subject, text, seed);
        }
        let text = gauge_bus::regular::read_text(name, LONGEST)
            .map_err(|error| Error::file(&subject, "cannot be read", &error))?;
        Self::parse(&subject, &text, seed)
    }

    /// Reads the text of a scenario; `subject` is its name in messages.
    pub fn parse(subject: &str, text: &str, seed: Option<u64>) -> Result<Self> {
        let bad = |text: String| Error::new(subject, ErrorKind::Invalid, text);
        let script: Script = toml::from_str(text).map_err(|error| {
            let line = error.span().map_or(1, |span| text[..span.start].matches('\n').count() + 1);
            bad(format!("line {line}: {}", error.message()))
        })?;
        Reading::new(seed.or(script.seed).unwrap_or(1)).whole(&script).map_err(bad)
    }

    /// Every act once: what a gauge has to accept.
    pub(super) fn acts(&self) -> impl Iterator<Item = &Act> {
        self.timed.iter().map(|(_, act)| act).chain(self.counted.iter().flat_map(|counted| &counted.acts))
    }

    /// Duration in battery time.
    pub fn length(&self) -> Duration {
        self.timed.last().map_or(Duration::ZERO, |(time, _)| *time)
    }
}

/// A step with `at`: its time and its number, and what it sets.
struct Timed<'a> {
    time: Duration,
    at: usize,
    step: &'a Step,
    acts: Vec<Act>,
}

/// How often the steps happen.
#[derive(Clone, Copy)]
struct Repeat {
    period: Duration,
    times: u32,
}

/// A scenario whose text is being read.
struct Reading {
    new: Scenario,
    random: Random,
    /// The last value of each knob, as the start of ramps.
    last: BTreeMap<String, f64>,
}

impl Reading {
    fn new(seed: u64) -> Self {
        let mut random = Random::new(seed);
        random.roll(1);
        Self { new: Scenario { seed, ..Scenario::default() }, random, last: BTreeMap::new() }
    }

    fn whole(mut self, script: &Script) -> Result<Scenario, String> {
        for act in acts(&script.start, 0).map_err(|error| format!("[start]: {error}"))? {
            self.set(Duration::ZERO, &act);
        }
        let repeat = Repeat::of(script)?;
        let timed = self.steps(&script.step)?;
        if repeat.period > Duration::ZERO && timed.last().is_some_and(|last| last.time >= repeat.period) {
            return Err("repeat: a step is later than that".into());
        }
        for turn in 0..repeat.times {
            for (index, Timed { at, .. }) in timed.iter().enumerate() {
                let unrolled = self.unroll(&timed, index, turn, repeat);
                unrolled.map_err(|error| format!("step {at}: {error}"))?;
            }
        }
        self.new.timed.sort_by_key(|(time, _)| *time);
        Ok(self.new)
    }

    /// Sets a knob at a time.
    fn set(&mut self, time: Duration, act: &Act) {
        if let Ok(value) = act.text.parse() {
            self.last.insert(act.knob.clone(), value);
        }
        self.new.timed.push((time, act.clone()));
    }

    /// Takes the steps that wait for traffic. Returns the others in the order of their times.
    fn steps<'a>(&mut self, steps: &'a [Step]) -> Result<Vec<Timed<'a>>, String> {
        let mut timed = Vec::new();
        for (at, step) in (1..).zip(steps) {
            let bad = |error: String| format!("step {at}: {error}");
            let acts = acts(&step.knobs, at).map_err(bad)?;
            match step.begins().map_err(|error| bad(error.into()))? {
                Begins::At(time) => timed.push(Timed { time, at, step, acts }),
                Begins::After(count) => {
                    let after = step.after.map_or(Duration::ZERO, |time| time.0);
                    self.new.counted.push(Counted { count, after, acts });
                }
            }
        }
        timed.sort_by_key(|step| (step.time, step.at));
        Ok(timed)
    }

    /// Unrolls a step in one of the turns.
    fn unroll(&mut self, timed: &[Timed<'_>], index: usize, turn: u32, repeat: Repeat) -> Result<(), String> {
        let Timed { time, step, acts, .. } = &timed[index];
        let begun = repeat.period * turn + *time;
        if step.every.is_some_and(|every| every.0.is_zero()) {
            return Err("every: it must be longer than 0".into());
        }
        let is_ramp = step.over.is_some() || step.jitter.is_some();
        for act in acts {
            match act.text.parse() {
                Ok(goal) if is_ramp => {
                    let end = repeat.next(timed, index, turn, &act.knob).saturating_sub(*time);
                    self.ramp(step, act, goal, begun, end)?;
                }
                Err(_) if is_ramp && acts.len() == 1 => {
                    return Err("over and jitter: they are for a number".into());
                }
                _ => self.set(begun, act),
            }
        }
        match self.new.timed.len() > MOST {
            true => Err("this comes to more than 200000 single steps".into()),
            false => Ok(()),
        }
    }

    /// A ramp to `goal`, and noise until `end`, which is the time until another step sets the knob.
    fn ramp(
        &mut self,
        step: &Step,
        act: &Act,
        goal: f64,
        begun: Duration,
        end: Duration,
    ) -> Result<(), String> {
        let every = step.every.map_or(EVERY, |time| time.0);
        let over = step.over.map_or(Duration::ZERO, |time| time.0);
        let from = match (self.last.get(&act.knob), over.is_zero()) {
            (_, true) => goal,
            (Some(from), false) => *from,
            (None, false) => {
                return Err(
                    "`over` needs a start value: set this knob in [start] or in an earlier step".into()
                );
            }
        };
        let jitter = step.jitter.unwrap_or(0.0);
        if !jitter.is_finite() || jitter < 0.0 {
            return Err("jitter: not a number from 0".into());
        }
        let length = if jitter > 0.0 { end.max(over) } else { over };
        let mut passed = Duration::ZERO;
        loop {
            let part = if over.is_zero() { 1.0 } else { passed.as_secs_f64() / over.as_secs_f64() };
            let noise = jitter * (self.random.roll(2001) as f64 / 1000.0 - 1.0);
            let value = from + (goal - from) * part.min(1.0) + noise;
            let text = value.round().to_string();
            self.new.timed.push((begun + passed, Act { text, ..act.clone() }));
            if self.new.timed.len() > MOST {
                return Err("this comes to more than 200000 single steps; raise `every`".into());
            }
            if passed >= length {
                break;
            }
            passed = (passed + every).min(length);
        }
        self.last.insert(act.knob.clone(), goal);
        Ok(())
    }
}

/// When a step begins.
enum Begins {
    At(Duration),
    After(Count),
}

impl Step {
    fn begins(&self) -> Result<Begins, &'static str> {
        let count = match (self.at, self.transfer, self.commit) {
            (Some(_), None, None) if self.after.is_some() => {
                return Err("after: it is for a step with transfer or commit");
            }
            (Some(time), None, None) => return Ok(Begins::At(time.0)),
            (None, Some(count @ 1..), None) => Count::Transfers(count),
            (None, None, Some(count @ 1..)) => Count::Commits(count),
            _ => {
                return Err(
                    "it has to say when, by one of `at` with a time, `transfer` or `commit` with a number from 1",
                );
            }
        };
        if self.over.is_some() || self.jitter.is_some() || self.every.is_some() {
            return Err("over, jitter and every: they are for a step with `at`");
        }
        Ok(Begins::After(count))
    }
}

impl Repeat {
    fn of(script: &Script) -> Result<Self, String> {
        let (period, times) = match (script.repeat, script.times) {
            (None, None) => (Duration::ZERO, 1),
            (Some(period), Some(times)) if !period.0.is_zero() && times > 0 => (period.0, times),
            _ => return Err("repeat: it needs a time, and `times`, how often the steps happen".into()),
        };
        if period.checked_mul(times).is_none_or(|sum| sum > LONGEST_TIME) {
            return Err("repeat: this takes more than ten years".into());
        }
        Ok(Self { period, times })
    }

    /// The time of this turn at which another step sets the knob, or at which the scenario ends.
    fn next(self, timed: &[Timed<'_>], index: usize, turn: u32, knob: &str) -> Duration {
        let sets = |step: &&Timed<'_>| step.acts.iter().any(|other| other.knob == knob);
        let next = timed[index + 1..].iter().find(sets).map(|step| step.time);
        let is_repeated = turn + 1 < self.times;
        let repeated = || timed.iter().find(sets).filter(|_| is_repeated).map(|step| self.period + step.time);
        next.or_else(repeated).unwrap_or(self.period.max(timed[index].time))
    }
}

impl Act {
    /// Where the act is written.
    pub(super) fn place(&self) -> String {
        match self.step {
            0 => "[start]".into(),
            step => format!("step {step}"),
        }
    }
}

/// The settings of a table as texts of knobs; an exchange of the pack comes first.
fn acts(knobs: &BTreeMap<String, Value>, step: usize) -> Result<Vec<Act>, String> {
    let text = |value: &Value| match value {
        Value::Integer(number) => Some(number.to_string()),
        Value::Float(number) => Some(number.to_string()),
        Value::String(text) => Some(text.clone()),
        _ => None,
    };
    let act = |(knob, value): (&String, &Value)| {
        let text = text(value).ok_or_else(|| format!("{knob}: not a number or a string"))?;
        Ok(Act { knob: knob.clone(), text, step })
    };
    let acts = knobs.iter().map(act).collect::<Result<Vec<_>, String>>()?;
    let (mut first, others): (Vec<_>, Vec<_>) = acts.into_iter().partition(|act| act.knob == PACK);
    first.extend(others);
    Ok(first)
}

/// A running scenario.
#[derive(Debug)]
pub(super) struct Player {
    /// Acts to come.
    timed: VecDeque<(Duration, Act)>,
    counted: Vec<Counted>,
    /// Host time of the last change of speed, battery time since the start then, and the speed.
    since: Duration,
    passed: Duration,
    speed: f64,
    transfers: u64,
}

impl Player {
    pub(super) fn new(scenario: Scenario, now: Duration, speed: f64) -> Self {
        let Scenario { timed, counted, .. } = scenario;
        Self { timed: timed.into(), counted, since: now, passed: Duration::ZERO, speed, transfers: 0 }
    }

    pub(super) fn set_speed(&mut self, speed: f64, now: Duration) {
        self.passed = self.passed_at(now);
        (self.since, self.speed) = (now, speed);
    }

    fn passed_at(&self, now: Duration) -> Duration {
        self.passed + now.saturating_sub(self.since).mul_f64(self.speed)
    }

    pub(super) fn count_transfer(&mut self) {
        self.transfers += 1;
    }

    /// The next act due by `now`, and its time.
    pub(super) fn next(&mut self, commits: u64, now: Duration) -> Option<(Duration, Act)> {
        let is_due = |counted: &Counted| match counted.count {
            Count::Transfers(count) => self.transfers >= count,
            Count::Commits(count) => commits >= count,
        };
        while let Some(at) = self.counted.iter().position(is_due) {
            let Counted { after, acts, .. } = self.counted.remove(at);
            let time = self.passed_at(now) + after;
            for act in acts {
                let at = self.timed.partition_point(|(other, _)| *other <= time);
                self.timed.insert(at, (time, act));
            }
        }
        let due = self.timed.front()?.0;
        if due > self.passed_at(now) {
            return None;
        }
        let left = due.saturating_sub(self.passed).as_secs_f64();
        let wait = Duration::try_from_secs_f64(left / self.speed).unwrap_or_default();
        let (_, act) = self.timed.pop_front()?;
        Some((self.since.saturating_add(wait).min(now), act))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use gauge_bus::clock::{Clock, SimClock};

    use super::*;
    use crate::{Options, Sim};

    const CHIP: &str = "bq34z100-g1";

    /// A gauge and its clock, with a scenario from now on.
    fn played(text: &str) -> (Sim, Arc<SimClock>) {
        play(Scenario::parse("test", text, None).expect("a scenario"))
    }

    fn play(scenario: Scenario) -> (Sim, Arc<SimClock>) {
        let clock = Arc::new(SimClock::new());
        let sim = Sim::new(CHIP, &Options::default(), clock.clone()).expect("a part");
        clock.sleep(Duration::from_secs(2));
        sim.play(scenario).expect("it is accepted");
        (sim, clock)
    }

    fn number(sim: &Sim, knob: &str) -> f64 {
        sim.get(knob).expect("a knob").parse().expect("a number")
    }

    #[track_caller]
    fn refused(text: &str) -> String {
        Scenario::parse("day.toml", text, None).expect_err("refused").to_string()
    }

    #[test]
    fn times_are_read_with_their_units() {
        let seconds = |text| time(text).map(|time| time.as_secs_f64());
        assert_eq!(seconds("1h30m"), Some(5400.0));
        assert_eq!(seconds("2d 250ms"), Some(172_800.25));
        assert_eq!(seconds("90s"), Some(90.0));
        for bad in ["", " ", "90", "h", "-1s", "1.5h", "1y", "99999999999999999999s"] {
            assert_eq!(seconds(bad), None, "{bad}");
        }
    }

    #[test]
    fn steps_happen_at_the_time_of_the_battery() {
        let text = "[start]\nload_ma = 0\nspeed = 60\n[[step]]\nat = '1h'\nload_ma = 500\n[[step]]\nat = '2h'\nload_ma = 0\n";
        let (sim, clock) = played(text);
        let soc = number(&sim, "soc");
        clock.sleep(Duration::from_secs(59));
        assert_eq!(number(&sim, "load_ma"), 0.0);
        // Nobody asks for a while: each step has its time all the same.
        clock.sleep(Duration::from_secs(3600));
        assert_eq!(number(&sim, "load_ma"), 0.0);
        let left = number(&sim, "soc");
        assert!((soc - left - 50.0).abs() < 1.0, "{soc} to {left}");
        // At another speed it is the same.
        let (slow, clock) = played(&text.replace("60", "1"));
        clock.sleep(Duration::from_secs(59 * 60));
        assert_eq!(number(&slow, "load_ma"), 0.0);
        clock.sleep(Duration::from_secs(2 * 60));
        assert_eq!(number(&slow, "load_ma"), 500.0);
        slow.set("speed", "3600").expect("it is turned");
        clock.sleep(Duration::from_secs(1));
        assert_eq!(number(&slow, "load_ma"), 0.0);
        assert!((number(&slow, "soc") - left).abs() < 0.5);
    }

    #[test]
    fn a_value_changes_by_and_by_and_with_noise() {
        let (sim, clock) = played(
            "[start]\ntemperature = 0\n[[step]]\nat = 10\ntemperature = 100\nover = '100s'\nevery = '10s'\n",
        );
        let mut shown = Vec::new();
        for _ in 0..14 {
            shown.push(number(&sim, "temperature"));
            clock.sleep(Duration::from_secs(10));
        }
        assert_eq!(shown, [0., 0., 10., 20., 30., 40., 50., 60., 70., 80., 90., 100., 100., 100.]);

        let text =
            "[[step]]\nat = 0\nload_ma = 500\njitter = 100\nevery = '1s'\n[[step]]\nat = 100\nload_ma = 7\n";
        let loads = |seed| {
            let (sim, clock) = play(Scenario::parse("test", text, seed).expect("a scenario"));
            let loads: Vec<i32> = (0..100)
                .map(|_| {
                    clock.sleep(Duration::from_secs(1));
                    number(&sim, "load_ma") as i32
                })
                .collect();
            loads
        };
        let first = loads(None);
        assert_eq!(first[99], 7);
        assert!(first[..99].iter().all(|load| (400..=600).contains(load)));
        assert!(first.iter().max() > Some(&570) && first[..99].iter().min() < Some(&430), "{first:?}");
        assert_eq!(loads(Some(1)), first, "the usual seed");
        assert_ne!(loads(Some(2)), first);
    }

    #[test]
    fn random_faults_are_of_the_seed_too() {
        let failures = |seed| {
            let text = "[start]\nfault = 'random 300'\n";
            let (sim, clock) = play(Scenario::parse("test", text, seed).expect("a scenario"));
            let mut bus = sim.bus();
            let failed = |_| {
                clock.sleep(Duration::from_millis(10));
                gauge_bus::Bus::transfer(&mut bus, &[0x08], &mut [0; 2]).is_err()
            };
            (0..100).map(failed).collect::<Vec<_>>()
        };
        assert_eq!(failures(None), failures(Some(1)));
        assert_ne!(failures(Some(1)), failures(Some(2)));
    }

    #[test]
    fn steps_wait_for_traffic() {
        let (sim, clock) = played(
            "[[step]]\ntransfer = 3\nload_ma = 70\n[[step]]\ntransfer = 3\nafter = 10\nload_ma = 80\n",
        );
        let mut bus = sim.bus();
        let loads = [0; 4].map(|_| {
            let load = number(&sim, "load_ma");
            gauge_bus::Bus::transfer(&mut bus, &[0x08], &mut [0; 2]).expect("it answers");
            load
        });
        assert_eq!(loads, [0.0, 0.0, 0.0, 70.0]);
        clock.sleep(Duration::from_secs(9));
        assert_eq!(number(&sim, "load_ma"), 70.0);
        clock.sleep(Duration::from_secs(2));
        assert_eq!(number(&sim, "load_ma"), 80.0);
    }

    #[test]
    fn steps_repeat_with_other_noise() {
        let text = "repeat = '10s'\ntimes = 3\n[[step]]\nat = 0\nload_ma = 500\njitter = 100\nevery = '1s'\n[[step]]\nat = 5\nload_ma = 7\n";
        let (sim, clock) = played(text);
        let loads: Vec<f64> = (0..40)
            .map(|_| {
                let load = number(&sim, "load_ma");
                clock.sleep(Duration::from_secs(1));
                load
            })
            .collect();
        for turn in loads[..30].chunks(10) {
            assert!(turn[..5].iter().all(|load| *load > 300.0), "{loads:?}");
            assert_eq!(turn[5..], [7.0; 5]);
        }
        assert_ne!(loads[..5], loads[10..15]);
        assert_eq!(loads[30..], [7.0; 10]);
    }

    #[test]
    fn what_makes_no_sense_is_refused_with_its_place() {
        assert_eq!(
            refused("x = 1"),
            "day.toml: line 1: unknown field `x`, expected one of `about`, `seed`, `repeat`, `times`, `start`, `step`"
        );
        assert!(
            refused("\n\n[[step]]\nat = 'soon'\n").starts_with("day.toml: line 4: not a time"),
            "{}",
            refused("\n\n[[step]]\nat = 'soon'\n")
        );
        assert!(
            refused("[[step]]\nload_ma = 1\n").starts_with("day.toml: step 1: it has to say when, by one of")
        );
        assert!(refused("[[step]]\nat = 1\ncommit = 1\n").contains("step 1: it has to say when"));
        assert!(refused("[[step]]\nat = 1\nafter = 1\n").contains("after: it is for a step with"));
        assert!(refused("[[step]]\ncommit = 1\njitter = 1\n").contains("for a step with `at`"));
        assert!(refused("[[step]]\nat = 1\nload_ma = 1\nover = 1\n").contains("needs a start value"));
        assert!(refused("[[step]]\nat = 1\npower = 'off'\njitter = 1\n").contains("they are for a number"));
        assert!(
            refused("[[step]]\nat = 1\nload_ma = 1\njitter = -1\n").contains("jitter: not a number from 0")
        );
        assert!(refused("[[step]]\nat = 1\nload_ma = 1\njitter = 1\nevery = 0\n").contains("longer than 0"));
        assert!(refused("[[step]]\nat = 1\nload_ma = [1]\n").contains("load_ma: not a number or a string"));
        assert!(refused("repeat = 5\n").contains("repeat: it needs a time"));
        assert!(refused("repeat = 5\ntimes = 2\n[[step]]\nat = 5\n").contains("a step is later"));
        assert!(refused("repeat = '300d'\ntimes = 1000\n").contains("ten years"));
        assert!(
            refused("repeat = '300d'\ntimes = 9\n[[step]]\nat = 0\nload_ma = 1\njitter = 1\nevery = '1s'\n")
                .contains("200000")
        );
        let unknown = Scenario::read(Path::new("robot"), None).expect_err("no such").to_string();
        assert!(unknown.contains("robot-day, solar-week") && unknown.contains("./day.toml"), "{unknown}");
        let missing = Scenario::read(Path::new("./none.toml"), None).expect_err("no file");
        assert_eq!(missing.to_string(), "./none.toml: cannot be read: No such file or directory");
    }

    #[test]
    fn a_part_refuses_what_it_cannot_do_before_anything_happens() {
        let clock = Arc::new(SimClock::new());
        let sim = Sim::new("bq27220", &Options::default(), clock).expect("a part");
        let refuse = |text: &str| {
            let scenario = Scenario::parse("test", text, None).expect("a scenario");
            sim.play(scenario).expect_err("refused").to_string()
        };
        assert_eq!(refuse("[start]\nload_ma = 9\nload_mb = 1\n"), "[start]: load_mb: there is no such knob");
        assert!(refuse("[[step]]\nat = 1\nsoc = 101\n").starts_with("step 1: soc: "));
        assert_eq!(
            refuse("[[step]]\nat = 1\nflash = '48 4 0007'\n"),
            "step 1: flash: this part has no flash there"
        );
        assert!(refuse("[[step]]\nat = 1\nflash = '48 4'\n").contains("write an area, an offset and bytes"));
        assert!(refuse("[[step]]\ntransfer = 1\npack = 10\n").starts_with("step 1: pack: "));
        assert_eq!(number(&sim, "load_ma"), 0.0);
    }

    #[test]
    fn another_pack_takes_the_place_of_the_first_and_gives_it_back() {
        let (sim, clock) = played(
            "[start]\nload_ma = 300\nsoc = 90\n[[step]]\nat = 10\npack = 2\nflash = '48 4 0007'\nsoc = 20\n[[step]]\nat = 1000\npack = 1\n",
        );
        let first = sim.flash();
        clock.sleep(Duration::from_secs(900));
        assert_eq!(number(&sim, "load_ma"), 300.0, "the board's load goes on");
        assert!(number(&sim, "soc") < 20.0);
        let second = sim.flash();
        assert!(second != first);
        clock.sleep(Duration::from_secs(200));
        assert!(sim.flash() != second);
        assert!(number(&sim, "soc") > 85.0, "it has rested");
    }

    #[test]
    fn the_shipped_ones_end_as_they_say() {
        // Name, hours, state of charge at the end.
        for (name, hours, soc) in [
            ("robot-day", 24, 99.0..=100.0),
            ("ebike-ride", 3, 10.0..=35.0),
            ("solar-week", 7 * 24, 90.0..=100.0),
            ("failing-bus", 1, 68.0..=72.0),
        ] {
            let scenario = Scenario::read(Path::new(name), None).expect("it is shipped");
            assert!(scenario.length() <= Duration::from_secs(hours * 3600), "{name}");
            let (sim, clock) = play(scenario);
            let mut least = 100.0_f64;
            for _ in 0..hours * 6 {
                clock.sleep(Duration::from_secs(600));
                // A fault waits for a transfer.
                let _ = gauge_bus::Bus::transfer(&mut sim.bus(), &[0x08], &mut [0; 2]);
                least = least.min(number(&sim, "soc"));
            }
            let end = number(&sim, "soc");
            assert!(soc.contains(&end), "{name}: {end}");
            assert_eq!(
                (sim.get("power").as_deref(), sim.get("fault").as_deref()),
                (Some("on"), Some("none")),
                "{name}"
            );
            assert!(least > 5.0, "{name}: {least}");
        }
        assert_eq!(names().count(), 9);
        assert!(names().is_sorted());
    }
}
