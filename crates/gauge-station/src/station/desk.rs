// SPDX-License-Identifier: MIT

//! The people at a station: one question at a time; other prompts wait, as the scanner is in the hand for this one.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use ti_gauge::text;

use super::{Progress, Scanner, Screen, Sign, Totals};
use crate::error::{Cause, Error, Result};

pub(super) struct Desk {
    screen: Box<dyn Screen>,
    pub(super) scanner: Mutex<Box<dyn Scanner>>,
    /// Each slot's last prompt since a question began; `None` without a question.
    held: Mutex<Option<Vec<(String, String)>>>,
    slots: Vec<String>,
    /// Nobody answers any more.
    has_ended: AtomicBool,
}

impl Desk {
    pub(super) fn new(screen: Box<dyn Screen>, scanner: Box<dyn Scanner>, slots: Vec<String>) -> Self {
        Self {
            screen,
            scanner: Mutex::new(scanner),
            held: Mutex::new(None),
            slots,
            has_ended: AtomicBool::new(false),
        }
    }

    /// Whether the input ended at a question.
    pub(super) fn has_ended(&self) -> bool {
        self.has_ended.load(Ordering::SeqCst)
    }

    fn held(&self) -> MutexGuard<'_, Option<Vec<(String, String)>>> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn prompt(&self, slot: &str, what: &str) {
        let mut held = self.held();
        match &mut *held {
            None => self.print(slot, what),
            Some(waiting) => {
                waiting.retain(|(other, _)| other != slot);
                waiting.push((slot.into(), what.into()));
            }
        }
    }

    fn print(&self, slot: &str, what: &str) {
        self.screen.prompt(&text::printable(&format!("{slot}: {what}")));
    }

    pub(super) fn tell(&self, line: &str) {
        self.screen.prompt(&text::printable(line));
    }

    pub(super) fn sign(&self, slot: &str, sign: Sign, what: &str) {
        self.screen.sign(slot, sign, &text::printable(what));
    }

    pub(super) fn progress(&self, slot: &str, progress: &Progress) {
        self.prompt(slot, &progress.to_string());
        self.screen.sign(slot, Sign::Busy, &progress.to_string());
    }

    pub(super) fn outcome(&self, slot: &str, has_passed: bool, line: &str, totals: &Totals) {
        self.screen.outcome(line);
        self.screen.sign(slot, if has_passed { Sign::Pass } else { Sign::Fail }, line);
        self.screen.totals(totals);
    }

    /// Asks for a line for a slot until one is accepted. The end of the input is an error.
    pub(super) fn ask<T>(
        &self,
        slot: &str,
        what: &str,
        accept: impl Fn(&str) -> std::result::Result<T, String>,
    ) -> Result<T> {
        self.sign(slot, Sign::Wait, "another slot is asked about");
        let mut scanner = self.scanner.lock().unwrap_or_else(PoisonError::into_inner);
        self.held().get_or_insert_default();
        let mut asked = format!("{slot}: {what}");
        let answer = loop {
            self.sign(slot, if what.starts_with("scan") { Sign::Scan } else { Sign::Look }, &asked);
            let Some(line) = scanner.line(&asked) else {
                self.has_ended.store(true, Ordering::SeqCst);
                let why = format!("the input has ended: {what}");
                break Err(Error::new("input", Cause::Gone, why));
            };
            let accepted = self.own(slot, line.trim()).and_then(|line| match line {
                "" => Err("the line is empty".into()),
                line if line.contains(char::REPLACEMENT_CHARACTER) => {
                    Err("the line is no text in UTF-8".into())
                }
                line => accept(line),
            });
            match accepted {
                Ok(answer) => break Ok(answer),
                Err(why) => asked = text::printable(&format!("{slot}: {why}; {what}, again")),
            }
        };
        let held = self.held().take();
        for (slot, what) in held.into_iter().flatten() {
            self.print(&slot, &what);
        }
        answer
    }

    /// A line that may begin with its slot's name, such as the code on the slot itself.
    fn own<'a>(&self, slot: &str, line: &'a str) -> std::result::Result<&'a str, String> {
        let named = self.slots.iter().find_map(|name| {
            let rest = line.strip_prefix(name.as_str())?;
            let is_apart = rest.is_empty() || rest.starts_with([':', ' ', '\t']);
            is_apart.then(|| (name, rest.trim_start_matches([':', ' ', '\t'])))
        });
        match named {
            None => Ok(line),
            Some((name, rest)) if name == slot => Ok(rest),
            Some((name, _)) => Err(format!("that is for {name}, and {slot} is asked for")),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Condvar, Mutex};
    use std::thread;

    use super::*;

    #[derive(Clone, Default)]
    struct Said(Arc<Mutex<Vec<String>>>);

    impl Screen for Said {
        fn outcome(&self, line: &str) {
            self.prompt(line);
        }

        fn prompt(&self, line: &str) {
            self.0.lock().expect("nobody panics").push(line.into());
        }
    }

    /// Answers, while another slot wants something.
    struct Scanned(Said, Arc<Mutex<Option<Arc<Desk>>>>, Vec<&'static str>);

    impl Scanner for Scanned {
        fn line(&mut self, what: &str) -> Option<String> {
            self.0.prompt(what);
            if let Some(desk) = &*self.1.lock().expect("nobody panics") {
                desk.prompt("RIGHT", "connect a pack");
                desk.prompt("RIGHT", "take the pack off");
            }
            self.2.pop().map(String::from)
        }
    }

    #[test]
    fn one_thing_is_asked_for_at_a_time_and_for_one_slot() {
        let (said, late) = (Said::default(), Arc::default());
        let lines = vec!["LEFT\t8", "RIGHT 8", "LEFT", "LEFTOVER"];
        let scanned = Scanned(said.clone(), Arc::clone(&late), lines);
        let slots = ["LEFT", "RIGHT"].map(String::from).to_vec();
        let desk = Arc::new(Desk::new(Box::new(said.clone()), Box::new(scanned), slots));
        *late.lock().expect("nobody panics") = Some(desk.clone());
        let number = |line: &str| line.parse::<u32>().map_err(|_| format!("{line} is no number"));
        assert_eq!(desk.ask("LEFT", "scan", number).ok(), Some(8));
        assert!(desk.ask("LEFT", "scan", number).is_err());
        desk.prompt("LEFT", "connect a pack");
        let asked = [
            "LEFT: scan",
            "LEFT: LEFTOVER is no number; scan, again",
            "LEFT: the line is empty; scan, again",
            "LEFT: that is for RIGHT, and LEFT is asked for; scan, again",
            // What another slot wanted meanwhile comes after the answer.
            "RIGHT: take the pack off",
            "LEFT: scan",
            "RIGHT: take the pack off",
            "LEFT: connect a pack",
        ];
        assert_eq!(*said.0.lock().expect("nobody panics"), asked);
        late.lock().expect("nobody panics").take();
    }

    type Shown = Vec<(String, Sign, String)>;

    /// What each slot shows.
    #[derive(Clone, Default)]
    struct Signs(Arc<(Mutex<Shown>, Condvar)>);

    impl Signs {
        /// Waits until a slot shows a sign. Returns all slots that name a scan then.
        fn scans_when(&self, slot: &str, sign: Sign) -> Vec<String> {
            let (shown, changed) = &*self.0;
            let is_there =
                |shown: &Shown| shown.iter().any(|(name, shows, _)| name == slot && *shows == sign);
            let shown = shown.lock().expect("nobody panics");
            let shown = changed.wait_while(shown, |shown| !is_there(shown)).expect("nobody panics");
            let scans =
                |(_, sign, text): &&(String, Sign, String)| *sign == Sign::Scan || text.contains("scan");
            shown.iter().filter(scans).map(|(name, ..)| name.clone()).collect()
        }
    }

    impl Screen for Signs {
        fn outcome(&self, _: &str) {}

        fn prompt(&self, _: &str) {}

        fn sign(&self, slot: &str, sign: Sign, what: &str) {
            let (shown, changed) = &*self.0;
            let mut shown = shown.lock().expect("nobody panics");
            shown.retain(|(name, ..)| name != slot);
            shown.push((slot.into(), sign, what.into()));
            changed.notify_all();
        }
    }

    /// Answers as soon as the other slot waits.
    struct Patient(Signs, Vec<&'static str>);

    impl Scanner for Patient {
        fn line(&mut self, what: &str) -> Option<String> {
            let slot = what.split(':').next().unwrap_or_default();
            if let Some(other) = self.1.pop() {
                assert_eq!(self.0.scans_when(other, Sign::Wait), [slot]);
            }
            Some("8".into())
        }
    }

    #[test]
    fn regression_a_slot_that_waited_for_another_one_said_scan_too() {
        let signs = Signs::default();
        for (first, second) in [("LEFT", "RIGHT"), ("RIGHT", "LEFT")] {
            let scanner = Patient(signs.clone(), vec![second]);
            let slots = ["LEFT", "RIGHT"].map(String::from).to_vec();
            let desk = Desk::new(Box::new(signs.clone()), Box::new(scanner), slots);
            let accept = |line: &str| Ok(line.to_string());
            let ask = |slot| desk.ask(slot, "scan the serial number", accept).is_ok();
            thread::scope(|scope| {
                scope.spawn(|| ask(first));
                signs.scans_when(first, Sign::Scan);
                scope.spawn(|| ask(second));
            });
            for slot in [first, second] {
                signs.sign(slot, Sign::Busy, "");
            }
        }
    }
}
