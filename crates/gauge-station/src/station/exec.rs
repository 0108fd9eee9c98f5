// SPDX-License-Identifier: MIT

//! The program that gets every outcome: a label printer, or a factory's manufacturing execution system (MES).

use std::io::{BufReader, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use gauge_bus::clock::{Clock, RealClock};
use gauge_bus::regular;
use nix::sys::signal::{Signal, killpg};
use nix::unistd::Pid;
use ti_gauge::text;

use super::record::{Entry, Event};
use crate::error::{Cause, Error, Result};

/// Its step, and its key in the station's file.
pub(super) const EXEC: &str = "exec";
/// Its time limit, and the interval of looks.
const PATIENCE: Duration = Duration::from_secs(60);
const LOOK: Duration = Duration::from_millis(20);
/// How long its last output is awaited after its end: a process that it left behind may keep the pipe open.
const LAST_WORDS: Duration = Duration::from_secs(1);
/// Longest line of its last output, in bytes.
const MOST: u64 = 64 << 10;

/// Runs the program with an outcome as JSON on its standard input, and waits for its end. `serial` is for people.
pub(super) fn run(words: &[String], entry: &Entry, serial: Option<&str>) -> Result<()> {
    run_within(PATIENCE, words, entry, serial)
}

fn run_within(patience: Duration, words: &[String], entry: &Entry, serial: Option<&str>) -> Result<()> {
    let Some((program, arguments)) = words.split_first() else { return Ok(()) };
    let failed = |error: &std::io::Error| Error::io(program, "cannot be run", error).within(EXEC);
    let event = if entry.event == Event::Pass { "pass" } else { "fail" };
    let facts = [
        ("EVENT", Some(event)),
        ("GAUGE", Some(&*entry.gauge)),
        ("SERIAL", serial),
        ("LABEL", entry.label.as_deref()),
        ("REASON", entry.reason.as_deref()),
    ];
    let facts = facts.into_iter().filter_map(|(name, fact)| Some((format!("GAUGEFS_{name}"), fact?)));
    let mut child = Command::new(program)
        .args(arguments)
        .envs(facts)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        // Ctrl-C ends the station after its packs, but not their labels.
        .process_group(0)
        .spawn()
        .map_err(|error| failed(&error))?;
    let line = serde_json::to_string(entry).expect("keys are strings, so it cannot fail") + "\n";
    if let Some(mut input) = child.stdin.take() {
        // A program may succeed without reading it.
        thread::spawn(move || drop(input.write_all(line.as_bytes())));
    }
    let (sender, last_words) = mpsc::channel();
    if let Some(errors) = child.stderr.take() {
        thread::spawn(move || {
            let lines = regular::lines(BufReader::new(errors), MOST).map_while(std::result::Result::ok);
            sender.send(lines.filter(|line| !line.trim().is_empty()).last().unwrap_or_default())
        });
    }
    let status = wait(&mut child, patience).map_err(|error| failed(&error))?;
    let why = match status {
        Some(status) if status.success() => return Ok(()),
        Some(status) => status.to_string(),
        None => format!("it did not end within {} s, and was killed", patience.as_secs()),
    };
    let said = last_words.recv_timeout(LAST_WORDS).unwrap_or_default();
    let said = if said.is_empty() { said } else { format!("; it says: {}", text::printable(&said)) };
    Err(Error::new(EXEC, Cause::NotPermitted, format!("{program} has failed: {why}{said}")))
}

/// Waits for its end. `None` if it took too long and was killed with all that it has started.
fn wait(child: &mut Child, patience: Duration) -> std::io::Result<Option<ExitStatus>> {
    let (clock, since) = (RealClock::new(), Instant::now());
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        if since.elapsed() > patience {
            let _ = killpg(Pid::from_raw(child.id() as i32), Signal::SIGKILL);
            child.kill().and_then(|()| child.wait())?;
            return Ok(None);
        }
        clock.sleep(LOOK);
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    /// It could print the label of a pack that is recorded as failed.
    #[test]
    fn regression_what_a_program_has_started_went_on_after_it_was_killed() {
        let late = std::env::temp_dir().join(format!("gaugefs-exec-{}", std::process::id()));
        let script = format!("sh -c 'sleep 1; echo label > {}; sleep 60'; true", late.display());
        let entry = Entry { event: Event::Pass, ..Entry::default() };
        let error =
            run_within(Duration::from_millis(300), &["sh", "-c", &script].map(String::from), &entry, None);
        let error = error.expect_err("it takes too long").to_string();
        assert!(error.contains("it did not end within") && error.contains("was killed"), "{error}");
        RealClock::new().sleep(Duration::from_millis(1500));
        let is_printed = late.exists();
        let _ = fs::remove_file(&late);
        assert!(!is_printed);
    }
}
