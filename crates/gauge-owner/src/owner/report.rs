// SPDX-License-Identifier: MIT

//! A report of a gauge for a bug report: its identity, its registers, and a recording without keys and serial numbers.

use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use nix::errno::Errno;

use super::access::Access;
use super::{Answers, Seal, Snapshot};
use crate::error::{Cause, Error, Result};
use gauge_bus::trace::Event;
use ti_gauge::chip::{Chip, Kind, Limited, Row, Subclass};
use ti_gauge::dataflash::{anonymous, samples};
use ti_gauge::gauge::{Effects, Statistics};
use ti_gauge::value::{Type, Value};

/// Polls in a report. A mount of the recording needs the first one and the second one, which reads the slow tier.
pub(super) const POLLS: u32 = 3;

/// The place of a gauge.
#[derive(Clone, Debug, Default)]
pub struct Origin {
    /// In words, without a file's path.
    pub place: String,
    /// Its 7-bit address.
    pub address: u8,
    /// The adapter, in words; empty without an adapter.
    pub adapter: String,
}

/// The findings about a gauge.
#[derive(Clone, Debug)]
pub struct Report {
    /// When it was made.
    pub taken: Timestamp,
    /// The answers of the gauge when it was identified.
    pub answers: Answers,
    /// Set if only its standard commands are used: the reason.
    pub limited: Option<Limited>,
    /// Its seal state before data flash was read.
    pub seal: Seal,
    /// The last poll.
    pub snapshot: Arc<Snapshot>,
    /// The whole answer to FW_VERSION of a part that answers with more than a word.
    pub firmware: Vec<u8>,
    /// The subclasses of data flash that were read, none if the part is not known to have any; or why they were not.
    pub data_flash: Result<Vec<&'static Subclass>, String>,
    /// Values that could decide what the table believes, without numbers of the pack and texts.
    pub values: Vec<(Row, Value)>,
    /// The steps of the last calibration since the mount, and what it has reached; empty for none.
    pub calibration: Arc<str>,
    /// How long writes since the mount have taken.
    pub times: Times,
    /// The transfers.
    pub events: Vec<Event>,
}

/// Times from a command to its effect, in ms: the longest until a look showed it, and after which one did not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Effect {
    /// Effects that were seen.
    pub count: u64,
    /// The first look that showed it.
    pub seen_ms: u64,
    /// The last look that did not.
    pub unseen_ms: u64,
}

impl Effect {
    fn of(effects: &Effects) -> Self {
        Self { count: effects.count(), seen_ms: effects.seen_ms(), unseen_ms: effects.unseen_ms() }
    }
}

/// Times and effects that writes have shown since the mount.
#[derive(Clone, Copy, Debug, Default)]
pub struct Times {
    /// Resets that were sent.
    pub resets: u64,
    /// From a commit to its content.
    pub commits: Effect,
    /// From a RESET to SEALED.
    pub reset_seals: Effect,
    /// From BOARD_OFFSET or CC_OFFSET to its bit in CONTROL_STATUS.
    pub offsets: Effect,
}

impl Times {
    fn of(statistics: &Statistics) -> Self {
        Self {
            resets: Statistics::read(&statistics.resets),
            commits: Effect::of(&statistics.commits),
            reset_seals: Effect::of(&statistics.reset_seals),
            offsets: Effect::of(&statistics.offsets),
        }
    }
}

pub(super) struct Recording {
    begun: Duration,
    taken: Timestamp,
}

impl Recording {
    /// Begins it, and removes the last report, which does not describe the gauge as it is now.
    pub(super) fn begin(access: &mut Access) -> Self {
        access.shared().publish(|published| published.report = None);
        let recording = Self { begun: access.now(), taken: Timestamp::now() };
        access.gauge().record();
        recording
    }

    /// Ends it. A gauge that was `polled` is reported with blocks of its data flash.
    pub(super) fn end(self, access: &mut Access, polled: bool, waited: Duration) -> Result<Report> {
        let firmware = match polled {
            true => access.gauge().whole_firmware_answer().unwrap_or_default(),
            false => Vec::new(),
        };
        let published = access.shared().published();
        let read = match polled {
            true => read(access, waited + access.now().saturating_sub(self.begun)),
            false => Err(String::new()),
        };
        let (data_flash, values) = match read {
            Ok((read, values)) => (Ok(read), values),
            Err(why) => (Err(why), Vec::new()),
        };
        let mut events = anonymous(access.chip(), access.gauge().recorded());
        for event in &mut events {
            if let Event::Transfer { at, .. } = event {
                *at = at.saturating_sub(self.begun);
            }
        }
        let Some(snapshot) = published.snapshot.clone() else {
            return Err(Error::new(access.shared().name(), Cause::Gone, "it was not polled; try again"));
        };
        Ok(Report {
            taken: self.taken,
            answers: published.answers,
            limited: published.limited,
            seal: published.seal,
            snapshot,
            firmware,
            data_flash,
            values,
            calibration: published.calibration.clone(),
            times: Times::of(&access.shared().statistics),
            events,
        })
    }
}

/// Reads blocks that hold nothing of one pack alone, and deciding values. An error has no names of files.
fn read(access: &mut Access, waited: Duration) -> Result<DataFlash, String> {
    let chip = access.chip();
    let (shared, rows) = (samples(chip), deciding(chip));
    // A block with a number of the pack's is not in the recording, and what is shown of it is the row alone.
    let holds = |index: &usize| rows.iter().any(|(row, _)| std::ptr::eq(*row, &chip.subclasses[*index]));
    let more = (0..chip.subclasses.len()).filter(|index| holds(index) && !shared.contains(index));
    let indices: Vec<usize> = shared.iter().copied().chain(more).collect();
    if indices.is_empty() {
        return Ok(Default::default());
    }
    if let Some(limited) = access.shared().limitation() {
        return Err(limited.to_string());
    }
    if access.owed().is_some() {
        return Err("an interrupted access is still to be settled".into());
    }
    let read = access.read_anew(&indices, waited);
    let value = |row: &Row| {
        let place = (row.0.id, row.1.offset);
        Some((*row, access.shared().kept_value(place, row.1.kind)?))
    };
    let values = rows.iter().filter_map(value).collect();
    // What a mount of the recording has not read, this one has not either.
    access.shared().forget_dataflash();
    match read {
        Ok(_) => Ok((shared.iter().map(|&index| &chip.subclasses[index]).collect(), values)),
        Err(error) if error.errno() == Errno::EPERM as i32 => {
            Err("the gauge is sealed and no key opens it".into())
        }
        Err(error) if matches!(error.cause(), Cause::Io(_)) => Err("an error of the host".into()),
        Err(error) => Err(error.to_string()),
    }
}

type DataFlash = (Vec<&'static Subclass>, Vec<(Row, Value)>);

/// The numbers in data flash that could decide what the table believes.
fn deciding(chip: &'static Chip) -> Vec<Row> {
    let mut rows = chip.believed_rows();
    rows.retain(|(subclass, row)| {
        subclass.kind != Kind::Security && !row.names_pack() && !matches!(row.kind, Type::S(_))
    });
    rows
}

#[cfg(test)]
mod tests {
    use super::super::rig::{INTERVAL, Rig};
    use super::super::{Run, operations as op};
    use super::*;
    use gauge_bus::clock::Clock as _;
    use ti_gauge::calibration::Job;
    use ti_gauge::dataflash::Change;
    use ti_gauge::keys::Keys;

    #[test]
    fn a_report_is_of_the_gauge_as_it_is_now_and_leaves_it_sealed() {
        let mut rig = Rig::open();
        rig.sim.set("voltage_mv", "11000").expect("a knob");
        let flash = rig.sim.flash();
        rig.ask(&op::REPORT, ()).expect("it answers");
        let report = rig.handle.published().report.clone().expect("a report");
        let voltage = rig.handle.chip().register(ti_gauge::chip::Role::VoltageNow).expect("Voltage()");
        assert!(report.snapshot.value(voltage).is_some_and(|mv| (10_900..11_100).contains(&mv)));
        assert!(report.data_flash.is_ok() && report.events.contains(&Event::Hidden));
        assert_eq!(rig.sim.get("seal").as_deref(), Some("sealed"));
        assert!(rig.sim.flash() == flash);

        // A gauge that does not answer has no report, not even the one before.
        rig.sim.set("power", "off").expect("a knob");
        rig.ask(&op::REPORT, ()).expect_err("it is gone");
        assert!(rig.handle.published().report.is_none());
        rig.sim.set("power", "on").expect("a knob");
        rig.clock.sleep(INTERVAL);
        rig.ask(&op::REPORT, ()).expect("it is back");
        assert!(rig.gauge_records_nothing());
    }

    #[test]
    fn a_report_has_what_writes_and_calibrations_since_the_mount_have_shown() {
        let mut rig = Rig::open();
        rig.ask(&op::REPORT, ()).expect("it answers");
        let report = rig.handle.published().report.clone().expect("a report");
        assert_eq!((report.times.commits, report.times.reset_seals), Default::default());
        // The simulated gauge shows a commit after that time and that of its words; the engine looks after 100 ms.
        rig.sim.set("commit_ms", "230").expect("a knob");
        for (value, busy) in [(3100, "old"), (3200, "nack")] {
            rig.sim.set("commit_busy", busy).expect("a knob");
            let row = rig.handle.chip().row("80", "53").expect("Cell Terminate Voltage");
            let change =
                Change::of_value(rig.handle.chip(), row, &Value::Int(value), false).expect("two bytes");
            rig.ask(&op::WRITE, vec![change]).expect("written");
        }
        rig.ask(&op::CALIBRATE, Job::BoardOffset).expect("calibrated");
        rig.ask(&op::REPORT, ()).expect("it answers");
        let report = rig.handle.published().report.clone().expect("a report");
        let times = &report.times;
        let (commits, seals) = (times.commits, times.reset_seals);
        assert_eq!(commits.count, 2);
        assert!((200..400).contains(&commits.unseen_ms), "{times:?}");
        assert!(commits.seen_ms > 230 && commits.seen_ms < commits.unseen_ms + 250, "{times:?}");
        assert!(times.offsets.count == 1 && times.offsets.seen_ms < 2000, "{times:?}");
        assert!(seals.count >= 2 && seals.count <= times.resets, "{times:?}");
        assert!(report.calibration.contains("Board Offset 0 -> "), "{}", report.calibration);
    }

    #[test]
    fn a_sealed_gauge_without_a_key_is_reported_without_data_flash() {
        let keys = Keys::none();
        let keys_from = Some("/home/somebody/pack.keys".to_string());
        let mut rig = Rig::of("bq34z100-g1", Run { keys, keys_from, ..Run::default() });
        rig.start().expect("it answers");
        rig.ask(&op::REPORT, ()).expect("it answers");
        let report = rig.handle.published().report.clone().expect("a report");
        let why = report.data_flash.as_ref().expect_err("it is sealed");
        assert_eq!(why, "the gauge is sealed and no key opens it");
    }
}
