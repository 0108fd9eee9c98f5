// SPDX-License-Identifier: MIT

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use super::super::identity::check_identity;
use super::super::rig::{INTERVAL, Rig};
use super::super::{Answers, Run, Seal, operations as op};
use super::*;
use crate::error::{Cause, Error};
use gauge_bus::clock::Clock as _;
use gauge_bus::{Bus as _, BusError};
use ti_gauge::chip::{CHIPS, Chip, Limited, Role, Source};
use ti_gauge::dataflash::Change;
use ti_gauge::value::Value;

/// Decides what a part with these answers is when it is to be mounted as that chip.
fn identified(chip: &str, device_type: u16, firmware_version: u16, hardware_version: u16) -> String {
    let chip = Chip::by_name(chip).expect("it has a table");
    let answers = Answers { device_type, firmware_version, hardware_version, ..Answers::default() };
    match check_identity(chip, &answers) {
        Ok(None) => "itself".to_string(),
        Ok(Some(Limited::Sibling(sibling))) => format!("its relative {}", sibling.name),
        Ok(Some(limited)) => format!("unproven: {}", limited.why(chip, &answers)),
        Err(error) => error.to_string(),
    }
}

#[test]
fn the_chip_and_its_relatives_can_be_mounted() {
    assert_eq!(identified("bq34z100-g1", 0x0100, 0x0016, 0x0008), "itself");
    assert_eq!(identified("bq27520-g3", 0x0520, 0x0311, 0), "its relative bq27520-G2");
    assert_eq!(identified("bq34z100-r2", 0x0100, 0x0202, 0x0008), "itself");
    // Without DM_CODE these two cannot be told apart.
    assert_eq!(identified("bq27441-g1", 0x0421, 0x0109, 0), "itself");
    assert_eq!(identified("bq27421-g1", 0x0421, 0x0109, 0), "itself");
}

#[test]
fn another_part_is_refused_by_name() {
    let refused = |device_type, firmware, hardware, what: &str| {
        let found = identified("bq34z100-g1", device_type, firmware, hardware);
        let says = format!(
            "bq34z100-G1: identify: device type 0x{device_type:04x}, firmware 0x{firmware:04x}, hardware \
             0x{hardware:04x}: {what}; refusing to mount it as a bq34z100-G1"
        );
        assert_eq!(found, says);
    };
    refused(0x0520, 0x0324, 0, "this is a bq27520-G3");
    refused(0x0100, 0x0202, 8, "this is a bq34z100-R2");
    refused(0x0520, 0x0329, 0, "this is a bq27520-G4");
    refused(0x0421, 0x0109, 0, "this is a bq27441-G1 or a bq27421-G1");
    refused(0x0521, 0x0017, 8, "unknown part");
    refused(0, 0, 0, Answers::default().unknown());
    assert!(Answers::default().unknown().contains("--byte-writes"));
}

#[test]
fn another_version_of_the_chip_says_which_one_is_proven() {
    for (firmware, hardware) in [(0x0017, 0x0008), (0x0016, 0x0009)] {
        let says = identified("bq34z100-g1", 0x0100, firmware, hardware);
        let found = format!("unproven: firmware 0x{firmware:04x}, hardware 0x{hardware:04x}: ");
        assert!(says.starts_with(&found), "{says}");
        assert!(says.contains("only for firmware 0x0016, hardware 0x0008, so only standard"), "{says}");
        assert!(says.contains("gaugefs report"), "{says}");
    }
}

/// At the address of Control() a bq27000 has other registers.
#[test]
fn a_gauge_without_a_table_is_only_read() {
    for chip in ti_gauge::chip::kernel::GAUGES {
        let mut rig = Rig::of(chip.name, Run::default());
        rig.sim.keep_log(true);
        rig.owner.open().expect("it answers");
        for _ in 0..12 {
            rig.poll_after(INTERVAL);
        }
        rig.ask(&op::REFRESH, ()).expect("it answers");
        for _ in 0..3 {
            rig.sim.set("power", "off").expect("a knob");
            rig.poll_after(INTERVAL);
        }
        assert!(rig.handle.published().snapshot.is_none(), "{}: gone", chip.name);
        rig.sim.set("power", "on").expect("a knob");
        rig.poll_after(INTERVAL);
        rig.poll_after(INTERVAL);
        assert!(rig.handle.published().snapshot.is_some(), "{}: back", chip.name);
        let refused = rig.ask(&op::CONTROL, 0x0001).expect_err("no Control()");
        assert!(matches!(refused.cause(), Cause::NotPermitted), "{refused}");
        let refused = rig.ask(&op::SEAL, Seal::Unsealed);
        assert!(matches!(refused.expect_err("no seal").cause(), Cause::NotPermitted));
        let written = rig.sim.log().into_iter().map(|record| record.write.len()).max();
        assert_eq!(written, Some(1), "{}: register pointers only", chip.name);
    }
}

#[test]
fn regression_the_firmware_that_is_shown_is_the_gauges() {
    for (chip, version) in [("bq27220", 0x0003), ("bq34110", 0x0100), ("bq35100", 0x0018)] {
        let mut rig = Rig::of(chip, Run::default());
        rig.owner.open().expect("it answers");
        assert_eq!(rig.handle.published().answers.firmware_version, version, "{chip}");
        rig.sim.set("firmware", "0x0201").expect("a knob");
        rig.ask(&op::REFRESH, ()).expect("it answers");
        assert_eq!(rig.handle.published().answers.firmware_version, 0x0201, "{chip}");
        rig.ask(&op::CONTROL, 0x0002).expect("it answers");
        assert_eq!(rig.handle.published().control(), Some((0x0002, 0x0201)), "{chip}");
    }
}

/// It is read by the standard commands that every firmware has, without a name of data flash and without a key.
#[test]
fn another_firmware_is_not_asked_for_what_only_the_tables_has() {
    let at = 0x76;
    let has_asked = |rig: &Rig| {
        rig.sim.log().into_iter().any(|record| match record.write[..] {
            [first] => (first..first + record.read.len() as u8).contains(&at),
            _ => record.write[0] == at,
        })
    };
    let shown = |rig: &Rig, role| {
        let published = rig.handle.published();
        published.snapshot.as_ref().expect("a poll").registers.property(role)
    };
    let mut rig = Rig::of("bq27742-g1", Run::default());
    assert_eq!(rig.handle.chip().register(Role::PowerAvg).map(|row| row.source), Some(Source::Command(at)));
    rig.sim.keep_log(true);
    rig.sim.set("load_ma", "500").expect("a knob");
    rig.start().expect("it answers");
    for _ in 0..30 {
        rig.poll_after(INTERVAL);
    }
    assert!(rig.handle.published().limited.is_none());
    let product = [Role::VoltageNow, Role::CurrentAvg].map(|role| shown(&rig, role).expect("it is read"));
    let expected = product.into_iter().product::<i64>() / 1000;
    let power = shown(&rig, Role::PowerAvg).expect("it is read");
    assert!(power < -100 && (power - expected).abs() <= 20, "{power} {expected}");
    assert!(has_asked(&rig));
    // It is exchanged while it is mounted, or it was another one from the start.
    rig.sim.set("firmware", "0x0110").expect("a knob");
    rig.ask(&op::REFRESH, ()).expect("it answers");
    let mut other = Rig::of("bq27742-g1", Run::default());
    other.sim.set("firmware", "0x0110").expect("a knob");
    other.start().expect("it answers");
    for mut rig in [rig, other] {
        rig.sim.keep_log(true);
        for _ in 0..12 {
            rig.poll_after(INTERVAL);
        }
        assert!(rig.sim.log().iter().any(|record| record.write == [0x06]), "the others are polled");
        assert!(matches!(rig.handle.published().limited, Some(Limited::Unproven)));
        assert!(!has_asked(&rig), "{:?}", rig.sim.log());
        assert_eq!(shown(&rig, Role::PowerAvg), None);
        assert!(shown(&rig, Role::VoltageNow).is_some_and(|voltage| (2500..4500).contains(&voltage)));
        let index = rig.index(48);
        let refused = [
            rig.ask(&op::READ, vec![index]).map(drop).expect_err("no names"),
            rig.ask(&op::SEAL, Seal::Unsealed).map(drop).expect_err("no seal"),
        ];
        for error in refused {
            assert_eq!(error.cause(), Cause::NotPermitted, "{error}");
            assert!(error.to_string().contains("only for firmware 0x0103"), "{error}");
        }
        let sent: Vec<_> = rig.sim.log().into_iter().map(|record| record.write).collect();
        assert!(sent.iter().all(|write| write.len() == 1 || write[0] == 0x00), "{sent:?}");
    }
}

#[test]
fn regression_a_gauge_that_is_gone_still_had_answers() {
    let mut rig = Rig::open();
    rig.ask(&op::CONTROL, 0x0002).expect("it answers");
    assert!(rig.handle.published().control().is_some());
    rig.sim.set("power", "off").expect("a knob");
    for _ in 0..3 {
        rig.poll_after(INTERVAL);
    }
    assert!(rig.handle.published().snapshot.is_none(), "gone");
    assert_eq!(rig.handle.published().control(), None);
}

/// A bq27441-G1 with an image whose Design Capacity is to be restored.
fn with_image() -> Rig {
    let chip = Chip::by_name("bq27441-g1").expect("it has a table");
    let image = "chip = \"bq27441-g1\"\n[state]\ndesign-capacity = 1234\n";
    let image = ti_gauge::image::Image::parse(image, Some(chip)).expect("an image");
    let profile = image.to_restore().expect("values in range");
    let run = Run { profile, ..Run::default() };
    let mut rig = Rig::of("bq27441-g1", run);
    rig.owner.open().expect("it answers");
    rig
}

fn lose_power(rig: &Rig) {
    rig.sim.set("power", "off").expect("a knob");
    rig.sim.set("power", "on").expect("a knob");
    rig.clock.sleep(Duration::from_secs(3));
}

fn capacity(rig: &mut Rig) -> u16 {
    let index = rig.index(82);
    let read = rig.ask(&op::READ, vec![index]).expect("it is read");
    u16::from_be_bytes([read[0][10], read[0][11]])
}

/// [ITPOR] is bit 5. A bit of a poll that was read wrong is no loss of power.
#[test]
fn regression_one_wrong_bit_of_a_poll_restored_a_healthy_gauge() {
    let mut plain = with_image();
    plain.sim.keep_log(true);
    plain.sim.clear_log();
    plain.owner.poll_on_time();
    let reads: Vec<_> = plain.sim.log().iter().map(|record| record.read.len()).collect();
    assert!(reads.iter().any(|&length| length > 6), "{reads:?}");
    for (at, byte) in
        reads.iter().enumerate().flat_map(|(at, &length)| (0..length).map(move |byte| (at, byte)))
    {
        let mut rig = with_image();
        let flash = rig.sim.flash();
        rig.sim.set("fault", &format!("flip {} {} 5", at + 1, byte + 1)).expect("a fault");
        rig.owner.poll_on_time();
        rig.clock.sleep(INTERVAL);
        rig.owner.poll_on_time();
        assert!(rig.sim.flash() == flash, "byte {byte} of transfer {at}");
    }
}

/// What is stored wrong is stored once more, so that it takes two to fail.
const CORRUPT: &str = "corrupt-commit; corrupt-commit";

/// The end of CONFIG UPDATE clears [ITPOR], also when what was written is wrong.
#[test]
fn a_failed_restoration_is_tried_again_until_it_succeeds() {
    let mut rig = with_image();
    lose_power(&rig);
    rig.sim.set("fault", CORRUPT).expect("a fault");
    let mut pauses = Vec::new();
    for _ in 1..=6 {
        rig.owner.poll_on_time();
        let failure = rig.handle.published().last_error.to_string();
        assert!(failure.starts_with("profile: ") && failure.contains("tried again"), "{failure}");
        pauses.push(rig.owner.access.schedule().due(INTERVAL) - rig.clock.now());
        rig.clock.sleep(INTERVAL);
        rig.sim.set("fault", CORRUPT).expect("a fault");
    }
    let expected = [500, 1000, 2000, 4000, 8000, 8000].map(Duration::from_millis);
    assert_eq!(pauses, expected);
    rig.sim.set("fault", "none").expect("a fault");
    rig.owner.poll_on_time();
    assert_eq!(capacity(&mut rig), 1234);
    rig.clock.sleep(INTERVAL);
    let transfers = rig.transfers();
    rig.owner.poll_on_time();
    assert!(rig.transfers() - transfers < 12, "nothing is owed any more");
}

#[test]
fn a_second_power_loss_is_restored_as_the_first() {
    let mut rig = with_image();
    for _ in 0..2 {
        lose_power(&rig);
        rig.owner.poll_on_time();
        assert_eq!(capacity(&mut rig), 1234);
        rig.clock.sleep(INTERVAL);
        rig.owner.poll_on_time();
    }
}

/// The contents of two subclasses: Calibration, which distinguishes packs, and Discharge.
const CALIBRATION: usize = 104;
const TERMINATE: (u8, usize) = (80, 53);

/// Another pack takes the place of the one that is mounted: its board is calibrated otherwise, and it has another
/// Cell Terminate Voltage.
fn exchange(rig: &Rig) {
    rig.sim.set_flash(CALIBRATION as u16, 11, &[9]);
    rig.sim.set_flash(TERMINATE.0.into(), TERMINATE.1, &3300_u16.to_be_bytes());
}

fn terminate(rig: &mut Rig) -> u16 {
    let index = rig.index(TERMINATE.0);
    let read = rig.ask(&op::READ, vec![index]).expect("the default key");
    u16::from_be_bytes([read[0][TERMINATE.1], read[0][TERMINATE.1 + 1]])
}

/// Whether the gauge has been met anew since this was last asked.
fn has_arrived(rig: &mut Rig) -> bool {
    let now = rig.handle.published().presence;
    let was_known = rig.owner.backups.is_saved(now);
    rig.owner.backups.note_saved(now);
    !was_known
}

fn write(rig: &mut Rig, value: i64) -> Result<()> {
    let row = rig.handle.chip().row("80", "53").expect("Cell Terminate Voltage");
    let change = Change::of_value(rig.handle.chip(), row, &Value::Int(value), false).expect("it fits");
    rig.ask(&op::WRITE, vec![change])
}

/// Sends words to Control(), as another program would.
fn control(rig: &Rig, words: &[u16]) {
    for word in words {
        let [low, high] = word.to_le_bytes();
        rig.sim.bus().transfer(&[0x00, low, high], &mut []).expect("it is acknowledged");
    }
}

const KEYS: [u16; 2] = [0x0414, 0x3672];
const SEALED: u16 = 0x0020;

fn transfers_of_a_poll(rig: &mut Rig) -> u64 {
    let before = rig.transfers();
    rig.poll_after(INTERVAL);
    rig.transfers() - before
}

#[test]
fn a_gauge_that_is_found_open_has_its_pack_described_once() {
    let (mut sealed, mut open) = (Rig::new(Run::default()), Rig::new(Run::default()));
    control(&open, &KEYS);
    for rig in [&mut sealed, &mut open] {
        rig.owner.open().expect("it answers");
    }
    assert!(sealed.owner.access.shared().unread_places().len() >= 3, "nothing is unsealed for it");
    assert_eq!(sealed.sim.get("seal").as_deref(), Some("sealed"));
    assert!(open.owner.access.shared().unread_places().is_empty());
    assert_eq!(open.sim.get("seal").as_deref(), Some("unsealed"), "left as it was found");
    for _ in 0..12 {
        assert_eq!(transfers_of_a_poll(&mut open), transfers_of_a_poll(&mut sealed), "no poll is dearer");
    }
    // What a refresh forgets is read again.
    open.ask(&op::REFRESH, ()).expect("it answers");
    assert!(!open.owner.access.shared().unread_places().is_empty());
    open.poll_after(INTERVAL);
    assert!(open.owner.access.shared().unread_places().is_empty());
}

#[test]
fn a_gauge_that_was_sealed_meanwhile_is_not_unsealed_to_describe_its_pack() {
    let mut rig = Rig::new(Run::default());
    control(&rig, &KEYS);
    rig.owner.open().expect("it answers");
    control(&rig, &[SEALED]);
    rig.owner.access.shared().forget_dataflash();
    assert_ne!(rig.handle.published().seal, Seal::Sealed, "nothing has shown it yet");
    rig.owner.read_if_open();
    assert_eq!(rig.sim.get("seal").as_deref(), Some("sealed"));
    assert!(!rig.owner.access.shared().unread_places().is_empty());
}

#[test]
fn a_refresh_looks_at_the_gauge_anew_and_a_fingerprint_shows_another_pack() {
    for (open, exchanged) in [(false, false), (false, true), (true, false), (true, true)] {
        let mut rig = Rig::open();
        if open {
            rig.ask(&op::SEAL, Seal::Unsealed).expect("the default key");
        }
        assert_eq!(terminate(&mut rig), 3000);
        has_arrived(&mut rig);
        if exchanged {
            exchange(&rig);
        }
        rig.sim.keep_log(true);
        rig.ask(&op::REFRESH, ()).expect("it answers");
        let asked = rig.sim.log().iter().filter(|record| record.write == [0x00, 0x01, 0x00]).count();
        assert!(asked >= 1, "it is asked what it is");
        assert_eq!(rig.sim.get("seal").as_deref() == Some("unsealed"), open, "nothing is unsealed for it");
        // Of a sealed gauge the fingerprint is compared with the next access.
        assert_eq!(has_arrived(&mut rig), open && exchanged);
        assert_eq!(terminate(&mut rig), if exchanged { 3300 } else { 3000 });
        rig.clock.sleep(INTERVAL);
        rig.owner.poll_on_time();
        assert_eq!(has_arrived(&mut rig), !open && exchanged);
        // The key of another pack has not been tried.
        if !(open && exchanged) {
            write(&mut rig, 3100).expect("its values have been read");
        }
    }
}

#[test]
fn a_failed_poll_forgets_data_flash_and_a_write_to_another_pack_is_refused_once() {
    for exchanged in [false, true] {
        let mut rig = Rig::open();
        assert_eq!(terminate(&mut rig), 3000);
        let index = rig.index(TERMINATE.0);
        rig.sim.set("power", "off").expect("a knob");
        rig.owner.poll_on_time();
        assert!(rig.handle.kept(index).is_none(), "the pack may be exchanged now");
        rig.sim.set("power", "on").expect("a knob");
        if exchanged {
            exchange(&rig);
        }
        rig.clock.sleep(Duration::from_secs(2));
        rig.owner.poll_on_time();
        let flash = rig.sim.flash();
        let outcome = write(&mut rig, 3100);
        assert_eq!(outcome.is_err(), exchanged, "{outcome:?}");
        if let Err(error) = outcome {
            assert!(matches!(error.cause(), Cause::Gone), "{error}");
            assert!(error.to_string().contains("another pack"), "{error}");
            assert!(rig.sim.flash() == flash);
            rig.clock.sleep(INTERVAL);
            rig.owner.poll_on_time();
            assert_eq!(terminate(&mut rig), 3300);
            write(&mut rig, 3100).expect("its values have been read");
        }
    }
}

#[test]
fn a_register_that_no_pack_changes_by_itself_shows_another_pack() {
    // The gauge counts in RAM, which it fills when it gets power.
    let cycles = |rig: &Rig, count: u16| {
        rig.sim.set_flash(48, 6, &count.to_be_bytes());
        lose_power(rig);
    };
    for (count, is_other) in [(40, false), (41, false), (39, true)] {
        let mut rig = Rig::open();
        cycles(&rig, 40);
        rig.clock.sleep(INTERVAL);
        rig.owner.poll_on_time();
        assert_eq!(terminate(&mut rig), 3000);
        has_arrived(&mut rig);
        cycles(&rig, count);
        rig.clock.sleep(INTERVAL);
        rig.owner.poll_on_time();
        let index = rig.index(TERMINATE.0);
        assert_eq!(rig.handle.kept(index).is_none(), is_other, "{count} cycles");
        rig.clock.sleep(Duration::from_secs(1));
        rig.owner.poll_on_time();
        assert_eq!(has_arrived(&mut rig), is_other, "{count} cycles");
    }
    // DesignCapacity() is read again with a refresh.
    let mut rig = Rig::open();
    rig.clock.sleep(INTERVAL);
    rig.owner.poll_on_time();
    has_arrived(&mut rig);
    rig.sim.set_flash(48, 11, &1234_u16.to_be_bytes());
    lose_power(&rig);
    rig.ask(&op::REFRESH, ()).expect("it answers");
    rig.clock.sleep(Duration::from_secs(1));
    rig.owner.poll_on_time();
    assert!(has_arrived(&mut rig));
}

#[test]
fn a_parameter_that_this_mount_has_written_is_no_sign_of_another_pack() {
    let mut rig = Rig::open();
    let chip = rig.handle.chip();
    for (offset, value) in [("11", 2200), ("6", 3), ("4", 7)] {
        let row = chip.row("48", offset).expect("a parameter of the table");
        let change = Change::of_value(rig.handle.chip(), row, &Value::Int(value), false).expect("it fits");
        rig.ask(&op::WRITE, vec![change]).expect("the default key");
        has_arrived(&mut rig);
        for _ in 0..3 {
            rig.clock.sleep(INTERVAL);
            rig.owner.poll_on_time();
        }
        rig.ask(&op::REFRESH, ()).expect("it answers");
        assert!(!has_arrived(&mut rig), "48/{offset}");
    }
}

/// I2C has no error detection.
#[test]
fn a_bit_error_in_a_poll_does_not_make_another_pack() {
    for transfer in 1..=3 {
        for byte in 0..18 {
            for bit in [0, 7] {
                let mut rig = Rig::open();
                rig.sim.set_flash(48, 6, &40_u16.to_be_bytes());
                lose_power(&rig);
                rig.clock.sleep(INTERVAL);
                rig.owner.poll_on_time();
                has_arrived(&mut rig);
                rig.clock.sleep(INTERVAL);
                rig.sim.set("fault", &format!("flip {transfer} {byte} {bit}")).expect("a fault");
                rig.owner.poll_on_time();
                rig.sim.set("fault", "none").expect("a knob");
                rig.owner.poll_on_time();
                let doubts = rig.owner.access.doubts() || has_arrived(&mut rig);
                assert!(!doubts, "transfer {transfer} byte {byte} bit {bit}");
            }
        }
    }
}

/// I2C has no error detection.
#[test]
fn a_bit_error_does_not_make_another_version_of_the_gauge() {
    for transfer in 1..=10 {
        let mut rig = Rig::new(Run::default());
        rig.sim.set("fault", &format!("flip {transfer} 0 1")).expect("a fault");
        if rig.owner.open().is_ok() {
            assert!(rig.handle.published().limited.is_none(), "transfer {transfer}");
        }
    }
}

#[test]
fn a_gauge_that_is_missing_at_first_is_opened_by_a_later_poll() {
    let missing = Some(Error::new("/dev/i2c-9", Cause::Gone, "no such bus"));
    let mut rig = Rig::new(Run { missing, unverified: true, ..Run::default() });
    let (sender, opened) = std::sync::mpsc::channel();
    rig.owner.turn.begin_with(sender);
    rig.owner.take_turn(None);
    let error = opened.try_recv().expect("an outcome").expect_err("it is missing");
    assert_eq!(*rig.handle.published().last_error, *error.to_string());
    assert_eq!(rig.transfers(), 0);
    assert!(rig.handle.published().snapshot.is_none());

    rig.owner.poll_on_time();
    let published = rig.handle.published();
    assert!(published.snapshot.is_some() && published.answers.device_type == 0x0100);
}

/// SPD Write Disable of an i801: no write gets through, and reads do.
struct Protected {
    bus: Box<dyn gauge_bus::Bus>,
    writes: Arc<AtomicU32>,
}

impl gauge_bus::Bus for Protected {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
        if read.is_empty() {
            self.writes.fetch_add(1, Ordering::Relaxed);
            return Err(BusError::WriteDisabled);
        }
        self.bus.transfer(write, read)
    }

    fn inner(&mut self) -> Option<&mut dyn gauge_bus::Bus> {
        Some(&mut *self.bus)
    }
}

/// Its registers are read, and nothing more is tried after the first answer was refused.
#[test]
fn a_gauge_to_which_nothing_can_be_written_shows_its_standard_commands() {
    for chip in CHIPS {
        let writes = Arc::new(AtomicU32::new(0));
        let counted = writes.clone();
        let run = Run { unverified: true, ..Run::default() };
        let mut rig =
            Rig::on(chip.name, run, |bus| Box::new(Protected { bus: Box::new(bus), writes: counted }));
        rig.start().unwrap_or_else(|error| panic!("{}: {error}", chip.name));
        let published = rig.handle.published();
        assert!(
            published.last_error.contains("SPD Write Disable"),
            "{}: {}",
            chip.name,
            published.last_error
        );
        for _ in 0..20 {
            rig.poll_after(INTERVAL);
        }
        let published = rig.handle.published();
        let snapshot = published.snapshot.as_ref().expect("it is polled");
        assert!(snapshot.is_valid && snapshot.has_current && !published.is_failing, "{}", chip.name);
        // Before it, a look at the mode that the question may begin.
        let looks = u32::from(chip.preflight.slip().is_some());
        assert_eq!(writes.load(Ordering::Relaxed), 1 + looks, "{}: only its type was asked for", chip.name);
        let row = chip.subclasses.iter().find_map(|class| Some((class, class.parameters.first()?)));
        let Some(row) = row else { continue };
        let bytes = vec![0; row.1.kind.size()];
        let change = Change::of_value(chip, row, &chip.layout.decode(row.1.kind, &bytes), true);
        let Ok(change) = change else { continue };
        let refused = rig.ask(&op::WRITE, vec![change]).expect_err("nothing is written");
        assert_eq!(refused.cause(), Cause::ReadOnly, "{}: {refused}", chip.name);
        rig.ask(&op::SEAL, Seal::Unsealed).expect_err("nor unsealed");
        assert_eq!(writes.load(Ordering::Relaxed), 1, "{}", chip.name);
    }
}
