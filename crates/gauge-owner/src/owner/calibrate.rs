// SPDX-License-Identifier: MIT

//! Calibration in the owner's thread, which does not poll meanwhile.

use std::sync::Arc;

use super::Attempt;
use super::access::Access;
use super::backup::Backups;
use super::operation::Asked;
use crate::error::{Cause, Error, Result};
use ti_gauge::calibration::{self, Job};

/// Carries out a calibration. Its steps are published before they are done.
pub(super) fn calibrate(access: &mut Access, backups: &mut Backups, job: Job, asked: Asked) -> Result<()> {
    let begun = access.now();
    let shared = access.shared().clone();
    shared.publish(|published| {
        (published.calibration, published.measured) = (asked.title().into(), Arc::default());
    });
    if access.owed().is_some() {
        access.pay();
    }
    if job != Job::Leave && access.owed().is_none() {
        backups.save(access, asked.waited)?;
    }
    let waited = asked.waited + access.now().saturating_sub(begun);
    let mut tell = |text: &str| {
        log::info!("{}calibration: {text}", shared.prefix);
        shared.publish(|published| {
            published.calibration = format!("{}{text}\n", published.calibration).into();
        });
    };
    let outcome = access.run(|dataflash, gauge| calibration::run(dataflash, gauge, &job, waited, &mut tell));
    if let Ok(reached) = &outcome {
        tell(&reached.text);
        let measured = reached.measured.clone().into();
        shared.publish(|published| published.measured = measured);
    }
    access.after_settling();
    outcome.map(drop)
}

/// Reports calibration mode that a host has left on, perhaps because it died.
pub(super) fn report_mode(access: &Access) {
    let (chip, shared) = (access.chip(), access.shared());
    if !calibration::is_on(chip, access.control_status()) || shared.published().limited.is_some() {
        return;
    }
    let why = "the gauge is in calibration mode, which a program has entered and not left: its flash is open at any \
               voltage, and nothing is written; leave it with `gaugefs calibrate GAUGE leave`";
    shared.report(Attempt::CALIBRATE, &Error::new("CONTROL_STATUS [CALEN]", Cause::Busy, why));
}

#[cfg(test)]
mod tests {
    use super::super::rig::{INTERVAL, Rig};
    use super::super::{Run, operations};
    use super::*;
    use gauge_bus::Bus;
    use gauge_bus::clock::Clock;
    use std::time::Duration;

    fn calibrate(rig: &mut Rig, job: Job) -> Result<()> {
        rig.ask(&operations::CALIBRATE, job)
    }

    #[test]
    fn a_calibration_is_told_step_by_step_and_polls_rest_meanwhile() {
        let mut rig = Rig::open();
        rig.sim.set("temperature_error", "30").expect("a knob");
        rig.clock.sleep(Duration::from_secs(1));
        calibrate(&mut rig, Job::Temperature(25.0)).expect("no fault");
        let text = rig.handle.published().calibration.to_string();
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].starts_with("reading Temperature() up to 8 times"), "{text}");
        assert!(lines[1].starts_with("writing Ext Temp Offset = -30"), "{text}");
        assert!(lines[2].contains("the error was +") && lines.len() == 3, "{text}");
        calibrate(&mut rig, Job::Temperature(60.0)).expect_err("too far");
        let published = rig.handle.published();
        assert!(
            published.last_error.contains("-12.8 °C (-128) to 12.7 °C (127)"),
            "{}",
            published.last_error
        );
        rig.clock.sleep(INTERVAL);
        rig.owner.poll_on_time();
        assert!(!rig.handle.published().last_error.is_empty());
        calibrate(&mut rig, Job::Temperature(25.0)).expect("it is right");
        assert_eq!(*rig.handle.published().last_error, *"");
    }

    #[test]
    fn a_start_reports_calibration_mode_and_the_way_out_works() {
        let mut rig = Rig::new(Run::default());
        for word in [0x0414_u16, 0x3672, 0x002D, 0x0081, 0x0020] {
            let [low, high] = word.to_le_bytes();
            rig.sim.bus().transfer(&[0x00, low, high], &mut []).expect("it answers");
        }
        rig.start().expect("it answers");
        let error = rig.handle.published().last_error.to_string();
        assert!(error.contains("[CALEN]") && error.contains("calibrate GAUGE leave"), "{error}");
        calibrate(&mut rig, Job::Leave).expect("no fault");
        assert_eq!(rig.sim.get("mode").as_deref(), Some("normal"));
        assert_eq!(rig.sim.get("seal").as_deref(), Some("sealed"));
        assert_eq!(*rig.handle.published().last_error, *"");
        assert!(rig.handle.published().calibration.contains("it is off now"));
    }
}
