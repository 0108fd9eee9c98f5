// SPDX-License-Identifier: MIT

use std::collections::BTreeMap;

use super::*;
use crate::chip::CHIPS;

/// A gauge as shipped, except for some rows.
fn plan(part: &str, battery: &str, set: &[(&str, i64)], scale: f64) -> Result<Plan, String> {
    let chip = Chip::by_name(part).expect("a part");
    let stored = |row: Row| {
        let set = set.iter().find(|(name, _)| *name == row.1.name).map(|(_, value)| *value);
        Some(Value::Int(set.or(row.1.int_default(None)).unwrap_or(0)))
    };
    let has = Has { chip, chem_id: None, stored: &stored, current: Some(scale), energy: Some(1.0) };
    battery.parse::<Battery>().expect(battery).plan(&has)
}

/// `Design Capacity 5200, ...`, in the order of their names.
fn rows(plan: &Plan) -> String {
    let shown = |differs: &Differs| (differs.row.1.name, notation::show(differs.row.1, &differs.new));
    let rows: BTreeMap<&str, String> = plan.differ.iter().map(shown).collect();
    rows.iter().map(|(name, value)| format!("{name} {value}")).collect::<Vec<_>>().join(", ")
}

fn steps(plan: &Plan) -> Vec<&'static str> {
    plan.steps.iter().map(|step| step.name).collect()
}

#[test]
fn each_part_gets_the_rows_that_it_has() {
    for (part, battery, wanted) in [
        ("bq34z100-g1", "li-ion 1s 5200mAh", "Design Capacity 5200, Design Energy 19240"),
        ("bq34z100-r2", "li-ion 1s 5200mAh", "Design Capacity 5200, Design Energy 1924"),
        ("bq27520-g3", "li-ion 1s 2Ah", "Design Capacity 2000"),
        ("bq27500", "li-ion 1s 2Ah terminate-voltage=3.1V", "Design Capacity 2000, Terminate Voltage 3100"),
        ("bq27441-g1", "li-ion 1s 2Ah", "Design Capacity 2000, Design Energy 7400"),
        (
            "bq27421-g1",
            "li-ion 1s 2Ah terminate-voltage=3.1V",
            "Design Capacity 2000, Design Energy 7400, Terminate Voltage 3100",
        ),
        (
            "bq27426",
            "li-ion 1s 2Ah charge-voltage=4.35V taper-current=100mA energy=7.6Wh",
            "Design Capacity 2000, Design Energy 7600, Taper Rate 200, Taper Voltage 4250",
        ),
        ("bq27427", "li-ion 1s 2Ah", "Design Capacity 2000, Design Energy 7400"),
        (
            "bq27621-g1",
            "li-ion 1s 2Ah taper-current=100mA",
            "Design Capacity 2000, Design Energy 7400, Taper Rate 200",
        ),
        (
            "bq27220",
            "li-ion 1s 2Ah charge-voltage=4.35V taper-current=60mA terminate-voltage=3.2V",
            "Charging Voltage 4350, Design Capacity 2000, Fixed EDV 0 3200, Taper Current 60",
        ),
        (
            "bq34110",
            "pb 6s 7Ah taper-current=0.2A",
            "Design Capacity mAh 7000, Number of Series Cells 6, Taper Current 200",
        ),
        (
            "bq35100",
            "li-socl2 2s 2.4Ah",
            "Cell Design Capacity mAh 2400, Cell Design Voltage 3600, Cell Terminate Voltage 2000, Series Cell Count 2",
        ),
        (
            "bq34z100-g1",
            "lfp 1s 20Ah",
            "Cell Charge Voltage T1-T2 3600, Cell Charge Voltage T2-T3 3600, Cell Charge Voltage T3-T4 3600, Design Capacity \
             20000, Design Energy 6400, Design Energy Scale 10",
        ),
        (
            "bq34z100-g1",
            "nimh 1s 2Ah",
            "Cell Terminate Voltage 1000, Design Capacity 2000, Design Energy 2400",
        ),
    ] {
        let plan = plan(part, battery, &[], 1.0).expect(part);
        assert_eq!(rows(&plan), wanted, "{part} {battery}");
        assert!(plan.unread.is_empty() && !plan.is_fine(), "{part}");
    }
}

#[test]
fn what_was_written_is_not_wanted_again_and_each_row_has_a_source() {
    for part in CHIPS {
        for battery in
            ["li-ion 1s 1.5Ah", "li-ion 3s 5Ah energy=55Wh", "lfp 4s 100Ah", "pb 6s 7Ah", "li-mno2 2s 2Ah"]
        {
            let set = [("Pack Configuration", 0x0961)];
            let Ok(first) = plan(part.name, battery, &set, 4.0) else { continue };
            let mut set: Vec<_> = set.into();
            for Differs { row, new, source, .. } in &first.differ {
                let Value::Int(number) = new else { panic!("{} is no number", row.1.name) };
                assert!(!source.is_empty() && !row.1.unproven && !row.1.learned, "{}", row.1.name);
                assert_ne!(row.0.class, "Calibration", "{}", row.1.name);
                set.retain(|(name, _)| *name != row.1.name);
                set.push((row.1.name, *number));
            }
            let second = plan(part.name, battery, &set, 4.0).expect(part.name);
            assert_eq!(rows(&second), "", "{} {battery}", part.name);
            assert!(second.is_fine(), "{} {battery}: {:?}", part.name, second.steps);
        }
    }
}

#[test]
fn large_packs_are_scaled() {
    let set = [("Pack Configuration", 0x0961)];
    // Within 29 Ah nothing is scaled. 1024 Wh do not fit, even in 10 mWh.
    let twenty = plan("bq34z100-g1", "lfp 16s 20Ah", &set, 1.0).expect("a plan");
    assert!(
        rows(&twenty).contains("Design Capacity 20000") && rows(&twenty).contains("Number of series cell 16")
    );
    assert!(!rows(&twenty).contains("Energy") && steps(&twenty).contains(&"beyond"), "{twenty:?}");
    let hundred = plan("bq34z100-g1", "lfp 4s 100Ah taper-current=2A", &set, 1.0).expect("a plan");
    let wanted = rows(&hundred);
    for row in [
        "Design Capacity 25000",
        "Design Energy 32000",
        "Design Energy Scale 10",
        "Pack Configuration 0x2961",
        "Taper Current 500",
    ] {
        assert!(wanted.contains(row), "{row}: {wanted}");
    }
    assert!(hundred.steps.iter().any(|step| step.name == "scale" && step.is_due), "{hundred:?}");
    // The scale of the mount is the one that counts.
    let told = plan("bq34z100-g1", "lfp 4s 100Ah", &set, 5.0).expect("a plan");
    assert!(
        rows(&told).contains("Design Capacity 20000") && !told.steps.iter().any(|step| step.is_due),
        "{told:?}"
    );
    let two = plan("bq34z100-r2", "lfp 16s 100Ah", &set, 4.0).expect("a plan");
    assert!(rows(&two).contains("Design Capacity 25000"), "{two:?}");
}

#[test]
fn several_cells_are_brought_up_first() {
    let shipped = plan("bq34z100-g1", "li-ion 3s 5200mAh", &[], 1.0).expect("a plan");
    assert_eq!(rows(&shipped), "Design Capacity 5200, Design Energy 5772, Design Energy Scale 10");
    let due: Vec<_> = shipped.steps.iter().filter(|step| step.is_due).collect();
    assert!(
        matches!(due[..], [step] if step.name == "bringup" && step.text.contains("--cells 3 ")),
        "{due:?}"
    );
    assert_eq!(steps(&shipped), ["energy-unit", "bringup", "taper-current", "chemistry", "learn"]);
    let external =
        plan("bq34z100-g1", "li-ion 3s 5200mAh", &[("Pack Configuration", 0x0961)], 1.0).expect("a plan");
    assert!(rows(&external).contains("Number of series cell 3") && !steps(&external).contains(&"bringup"));
}

#[test]
fn a_battery_that_the_part_cannot_gauge_is_refused() {
    for (part, battery, says) in [
        ("bq27427", "li-ion 2s 2Ah", "a BQ27427 gauges one cell, not 2 in series"),
        (
            "bq27441-g1",
            "lfp 1s 2Ah",
            "a bq27441-G1 gauges lithium-ion cells; the voltages of lifepo4 are others",
        ),
        ("bq27441-g1", "li-ion 1s 10Ah", "a bq27441-G1 cannot hold 10000 mAh in Design Capacity"),
        ("bq34z100-g1", "lfp 4s 300Ah", "a bq34z100-G1 gauges at most 290 Ah, scaled by 10"),
        (
            "bq34z100-r2",
            "lfp 4s 100Ah",
            "a bq34z100-R2 cannot hold 100000 mAh in Design Capacity; set Curr Scale first, whose place in data flash no \
             document has, with TI's tool",
        ),
        (
            "bq34110",
            "pb 6s 100Ah",
            "a bq34110 cannot hold 100000 mAh in Design Capacity mAh; a gauge that is calibrated to a part of the current is \
             mounted with --current-scale",
        ),
        ("bq35100", "li-ion 1s 2Ah", "a bq35100 is for cells that are not charged; li-ion is"),
        ("bq27441-g1", "li-mno2 1s 1Ah", "a bq27441-G1 is for cells that are charged; li-mno2 is not"),
        (
            "bq27541",
            "li-ion 1s 2Ah",
            "gaugefs knows no data memory of a bq27541, which would hold its battery",
        ),
    ] {
        assert_eq!(
            plan(part, battery, &[], 1.0).expect_err(part).to_lowercase(),
            says.to_lowercase(),
            "{battery}"
        );
    }
    // Above the next voltage, the first would never be reached.
    let edv = plan("bq27220", "li-ion 1s 2Ah terminate-voltage=3.5V", &[], 1.0).expect("a plan");
    assert!(edv.steps.iter().any(|step| step.name == "edv" && step.is_due), "{edv:?}");
}

#[test]
fn what_cannot_be_read_is_said() {
    let chip = Chip::by_name("bq34z100-g1").expect("a part");
    let has = Has { chip, chem_id: None, stored: &|_| None, current: None, energy: None };
    let plan = "li-ion 3s 5200mAh".parse::<Battery>().expect("a battery").plan(&has).expect("a plan");
    assert!(plan.differ.is_empty() && plan.fit.is_empty());
    let unread: Vec<_> = plan.unread.iter().map(|(_, row)| row.name).collect();
    assert!(["Design Capacity", "Pack Configuration"].iter().all(|name| unread.contains(name)), "{unread:?}");
}

#[test]
fn a_chemistry_profile_of_other_cells_is_due() {
    for (part, chem_id, battery, is_due, says) in [
        (
            "bq34z100-g1",
            Some(0x0107),
            "li-ion 1s 2Ah",
            false,
            "CHEM_ID 0x0107 is of lithium-ion cells charged to 4200 mV",
        ),
        ("bq34z100-g1", Some(0x0107), "li-ion 1s 2Ah charge-voltage=4.1V", false, "CHEM_ID 0x0107"),
        (
            "bq34z100-g1",
            Some(0x0107),
            "li-ion 1s 2Ah charge-voltage=4.35V",
            true,
            "another one is programmed with TI's tool",
        ),
        (
            "bq34z100-g1",
            Some(0x0107),
            "lfp 1s 2Ah",
            true,
            "must be of lifepo4 cells charged to 3600 mV, but CHEM_ID 0x0107",
        ),
        ("bq34z100-g1", Some(0x0107), "nimh 1s 2Ah", true, "must be of nimh cells, but"),
        ("bq34z100-g1", Some(0x0404), "lfp 1s 2Ah", false, "compare `gauge/chem_id`"),
        ("bq34z100-g1", None, "lfp 1s 2Ah", false, "compare `gauge/chem_id`"),
        (
            "bq27427",
            Some(0x3230),
            "li-ion 1s 2Ah charge-voltage=4.2V",
            true,
            "charged to 4350 mV: 0x1202 (CHEM_B) is for it",
        ),
        (
            "bq27441-g1",
            Some(0x0312),
            "li-ion 1s 2Ah charge-voltage=4.35V",
            false,
            "charged to 4300 to 4350 mV",
        ),
        (
            "bq27621-g1",
            Some(0x1202),
            "li-ion 1s 2Ah charge-voltage=4.35V",
            true,
            "0x1210 (ALT_CHEM1) is for it",
        ),
    ] {
        let chip = Chip::by_name(part).expect("a part");
        let stored = |row: Row| Some(Value::Int(row.1.int_default(None).unwrap_or(0)));
        let has = Has { chip, chem_id, stored: &stored, current: Some(1.0), energy: Some(1.0) };
        let plan = battery.parse::<Battery>().expect(battery).plan(&has).expect(part);
        let step = plan.steps.iter().find(|step| step.name == "chemistry").expect("a step");
        assert!(step.is_due == is_due && step.text.contains(says), "{part} {battery}: {step:?}");
    }
}
