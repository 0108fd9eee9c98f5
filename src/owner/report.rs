//! A report of a gauge for a bug report: its identity, its registers, and a recording without keys and serial numbers.

use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use nix::errno::Errno;

use super::{Answers, Attempt, Owner, Seal, Snapshot};
use crate::error::{Cause, Error, Result};
use gauge_bus::trace::Event;
use ti_gauge::chip::{Limited, Subclass};
use ti_gauge::dataflash::{anonymous, samples};

/// Polls in a report. A mount of the recording needs the first and the second, of which only that reads the slow tier.
const POLLS: u32 = 3;

/// Where a gauge is.
#[derive(Clone, Debug, Default)]
pub struct Origin {
    /// In words, without a file's path.
    pub place: String,
    /// Its 7-bit address.
    pub address: u8,
    /// The adapter, in words; empty where there is none.
    pub adapter: String,
}

/// What was seen of a gauge.
#[derive(Clone, Debug)]
pub struct Report {
    /// When it was made.
    pub taken: Timestamp,
    /// What the gauge answered when it was identified.
    pub answers: Answers,
    /// Why only its standard commands are used, if it is so.
    pub limited: Option<Limited>,
    /// Its seal state before data flash was read.
    pub seal: Seal,
    /// The last poll.
    pub snapshot: Arc<Snapshot>,
    /// The whole answer to FW_VERSION of a part that answers with more than a word.
    pub firmware: Vec<u8>,
    /// The subclasses of data flash that were read, none if the part is not known to have any; or why they were not.
    pub data_flash: Result<Vec<&'static Subclass>, String>,
    /// The transfers.
    pub events: Vec<Event>,
}

impl Owner {
    /// Identifies and polls the gauge and reads a block of data flash, records that, and publishes it.
    pub(super) fn make_report(&mut self, waited: Duration) -> Result<()> {
        // What was published before is no report of what the gauge does now.
        self.shared.publish(|published| published.report = None);
        let (begun, taken) = (self.gauge.clock.now(), Timestamp::now());
        self.gauge.record();
        let outcome = self.poll_for_report();
        let firmware = match &outcome {
            Ok(()) => self.gauge.whole_firmware_answer().unwrap_or_default(),
            Err(_) => Vec::new(),
        };
        let published = self.shared.published();
        let data_flash = match &outcome {
            Ok(()) => self.read_for_report(waited + self.gauge.clock.now().saturating_sub(begun)),
            Err(_) => Err(String::new()),
        };
        let mut events = anonymous(self.gauge.chip, self.gauge.recorded());
        outcome.inspect_err(|error| self.poll_failed(error))?;
        for event in &mut events {
            if let Event::Transfer { at, .. } = event {
                *at = at.saturating_sub(begun);
            }
        }
        let Some(snapshot) = published.snapshot.clone() else {
            return Err(Error::new(self.shared.name(), Cause::Gone("it was not polled; try again".into())));
        };
        let (answers, limited, seal) = (published.answers, published.limited, published.seal);
        let report = Report { taken, answers, limited, seal, snapshot, firmware, data_flash, events };
        self.shared.publish(|published| published.report = Some(Arc::new(report)));
        self.shared.succeeded(&Attempt::Report);
        Ok(())
    }

    /// Begins as a mount does, so that the recording can be mounted.
    fn poll_for_report(&mut self) -> Result<()> {
        self.forget_dataflash();
        self.dataflash.suspect(self.gauge.chip);
        self.recognise()?;
        self.schedule.begin_anew();
        for _ in 0..POLLS {
            self.gauge.wait(self.schedule.wait(self.gauge.clock.now()));
            self.update()?;
        }
        Ok(())
    }

    /// Reads blocks that belong to no one, as any access to `df` would. Returns why not, without the names of files.
    fn read_for_report(&mut self, waited: Duration) -> Result<Vec<&'static Subclass>, String> {
        let chip = self.gauge.chip;
        let indices = samples(chip);
        if indices.is_empty() {
            return Ok(Vec::new());
        }
        if let Some(limited) = self.limitation() {
            return Err(limited.to_string());
        }
        if self.dataflash.owed().is_some() {
            return Err("an interrupted access is still to be settled".into());
        }
        let read = self.read_anew(&indices, waited);
        // What a mount of the recording has not read, this one has not either.
        self.forget_dataflash();
        match read {
            Ok(_) => Ok(indices.iter().map(|&index| &chip.subclasses[index]).collect()),
            Err(error) if error.errno() == Errno::EPERM => {
                Err("the gauge is sealed and no key opens it".into())
            }
            Err(error) if matches!(error.cause(), Cause::Io(..)) => Err("an error of the host".into()),
            Err(error) => Err(error.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::rig::{INTERVAL, Rig};
    use super::super::{Request, Settings, Startup};
    use super::*;
    use gauge_bus::clock::Clock as _;
    use ti_gauge::keys::Keys;

    #[test]
    fn a_report_is_of_the_gauge_as_it_is_now_and_leaves_it_sealed() {
        let mut rig = Rig::open();
        rig.sim.set("voltage_mv", "11000").expect("a knob");
        let flash = rig.sim.flash();
        rig.ask(Request::Report).expect("it answers");
        let report = rig.handle.published().report.clone().expect("a report");
        let voltage = rig.handle.chip().register_at(0x08).expect("Voltage()");
        assert!(report.snapshot.value(voltage).is_some_and(|mv| (10_900..11_100).contains(&mv)));
        assert!(report.data_flash.is_ok() && report.events.contains(&Event::Hidden));
        assert_eq!(rig.sim.get("seal").as_deref(), Some("sealed"));
        assert!(rig.sim.flash() == flash);

        // A gauge that does not answer has no report, not even the one before.
        rig.sim.set("power", "off").expect("a knob");
        rig.ask(Request::Report).expect_err("it is gone");
        assert!(rig.handle.published().report.is_none());
        rig.sim.set("power", "on").expect("a knob");
        rig.clock.sleep(INTERVAL);
        rig.ask(Request::Report).expect("it is back");
        assert!(rig.gauge_records_nothing());
    }

    #[test]
    fn a_sealed_gauge_without_a_key_is_reported_without_data_flash() {
        let keys = Keys { no_default: true, ..Keys::default() };
        let key_file = Some("/home/somebody/pack.keys".to_string());
        let mut rig =
            Rig::of("bq34z100-g1", Settings { keys, key_file, ..Settings::default() }, Startup::default());
        rig.start().expect("it answers");
        rig.ask(Request::Report).expect("it answers");
        let report = rig.handle.published().report.clone().expect("a report");
        let why = report.data_flash.as_ref().expect_err("it is sealed");
        assert_eq!(why, "the gauge is sealed and no key opens it");
    }
}
