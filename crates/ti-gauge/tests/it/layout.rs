// SPDX-License-Identifier: MIT

//! A part that stores numbers in another way than TI's older gauges, in another range of addresses.

use std::sync::Arc;
use std::time::Duration;

use gauge_bus::clock::{Clock, SimClock};
use gauge_sim::{Options, Sim};
use ti_gauge::chip::{Chip, FLAT, Preflight, bq34110};
use ti_gauge::codec::{Float, Layout, Order};
use ti_gauge::dataflash::{Change, DataFlash, Outcome};
use ti_gauge::image::{Format, Image};

use crate::rig::Rig;

const LAYOUT: Layout = Layout { order: Order::Little, float: Float::Ieee };

/// A bq34110 that stores numbers as a bq28z610 does. What the simulated gauge looks up in its own flash keeps its bytes.
fn table() -> &'static Chip {
    let preflight =
        Preflight { marks: &[], voltage_mv: Some((2000, 5000)), ..bq34110::CHIP.preflight.clone() };
    let chip = Chip {
        layout: LAYOUT,
        flat: 0x4000..0x4200,
        gate: None,
        signature: &[],
        preflight,
        ..bq34110::CHIP.clone()
    };
    Box::leak(Box::new(chip))
}

fn rig(chip: &'static Chip) -> Rig {
    let clock = Arc::new(SimClock::new());
    let sim = Sim::new("bq34110", &Options::default(), clock.clone()).expect("a chip that is simulated");
    sim.be_strict();
    clock.sleep(Duration::from_secs(1));
    Rig::on(chip, sim, clock)
}

/// Address, what flash holds and as what it is shown; what is written, and its bytes.
type Case = (u16, &'static [u8], &'static str, &'static str, &'static [u8]);

/// CC Gain, Taper Current and Operation Config A: a float, a signed word and bits.
const ROWS: [Case; 3] = [
    (0x4000, &[0x7b, 0x09, 0xed, 0x3f], "1.8518518", "0.5", &[0x00, 0x00, 0x00, 0x3f]),
    (0x411C, &[0x87, 0x2f], "12167", "-400", &[0x70, 0xfe]),
    (0x413A, &[0x34, 0x12], "0x1234", "0x0123", &[0x23, 0x01]),
];

#[test]
fn values_are_read_and_written_in_the_layout_of_the_table() {
    let chip = table();
    let mut rig = rig(chip);
    for (address, held, ..) in ROWS {
        rig.sim.set_flash(0, usize::from(address) - 0x4000, held);
    }
    let firmware = rig.gauge.firmware_version().expect("it answers");
    let mut dataflash = DataFlash::default();
    for (address, held, shown, new, written) in ROWS {
        let row @ (subclass, parameter) =
            chip.row("flash", &format!("0x{address:04x}")).expect("a parameter");
        let index = chip.subclasses.iter().position(|one| std::ptr::eq(one, subclass)).expect("its subclass");
        let bytes = dataflash.read(&mut rig.gauge, &[subclass], Duration::ZERO).expect("a read").remove(0);
        let at = usize::from(address - subclass.start());
        assert_eq!(&bytes[at..at + held.len()], held, "{}", parameter.name);
        let image = Image::of_flash(chip, Some(firmware), [(index, &bytes[..])]);
        let text = image.write(Format::Toml, |_| Ok(Vec::new())).expect("a file");
        assert!(text.contains(shown), "{}: {text}", parameter.name);

        let change = Change::parse(chip, row, new.as_bytes(), true).expect("a value in range");
        assert_eq!(change.bytes(), written, "{}", parameter.name);
        let outcome = dataflash.write(&mut rig.gauge, &[change], Duration::ZERO).expect("it is written");
        assert!(matches!(outcome, Outcome::Written { .. }), "{}", parameter.name);
        let at = usize::from(address) - 0x4000;
        assert_eq!(&rig.sim.flash()[at..at + written.len()], written, "{}", parameter.name);
    }
}

#[test]
fn no_address_outside_of_the_range_is_selected() {
    let chip = Box::leak(Box::new(Chip { flat: 0x4000..0x4100, ..table().clone() }));
    let mut rig = rig(chip);
    rig.sim.keep_log(true);
    let (subclass, _) = chip.row("flash", "0x411c").expect("a parameter");
    let read = DataFlash::default().read(&mut rig.gauge, &[subclass], Duration::ZERO);
    let error = read.expect_err("it has no such address").to_string();
    assert!(error.contains("no such address"), "{error}");
    // Low byte first, after ManufacturerAccessControl().
    assert!(
        !rig.log().iter().any(|line| line.contains("3e 00 41") || line.contains("3e 20 41")),
        "{:?}",
        rig.log()
    );
    assert_eq!(subclass.id, FLAT);
}
