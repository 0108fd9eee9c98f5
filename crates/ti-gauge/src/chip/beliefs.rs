// SPDX-License-Identifier: MIT

//! Beliefs that the tables and the simulator share although no document, image or part has confirmed them: a test
//! against the simulator cannot refute them. `docs/BELIEFS.md` is this list.

use super::{Chip, Evidence, Gate, Row, Scale, Scheme, kernel};

/// An unconfirmed belief.
#[derive(Debug)]
pub struct Belief {
    /// Name of the belief.
    pub name: &'static str,
    /// The parts concerned, in words.
    pub parts: &'static str,
    /// What is believed.
    pub holds: &'static str,
    /// What would decide it, and the place of that in a report.
    pub decided_by: &'static str,
    /// The consequence for a gauge that differs.
    pub otherwise: &'static str,
    of: fn(&Chip) -> bool,
    rows: fn(&'static Chip) -> Vec<Row>,
}

fn is_calibrated(chip: &Chip) -> bool {
    chip.calibration.is_some()
}

fn is_mac(chip: &Chip) -> bool {
    chip.access.scheme.is_flat()
}

fn has_divider(chip: &Chip) -> bool {
    chip.gate.as_ref().is_some_and(|gate| gate.divider.is_some())
}

fn named(chip: &'static Chip, names: &[&str]) -> Vec<Row> {
    let rows = chip
        .subclasses
        .iter()
        .flat_map(|subclass| subclass.parameters.iter().map(move |row| (subclass, row)));
    rows.filter(|(_, row)| names.contains(&row.name)).collect()
}

fn at(chip: &'static Chip, places: &[(u8, u16)]) -> Vec<Row> {
    let rows = chip
        .subclasses
        .iter()
        .flat_map(|subclass| subclass.parameters.iter().map(move |row| (subclass, row)));
    let holds = |(subclass, row): &Row, (id, place): &(u8, u16)| {
        subclass.id == *id && (row.offset..row.offset + row.kind.size() as u16).contains(place)
    };
    rows.filter(|row| places.iter().any(|place| holds(row, place))).collect()
}

fn gate(chip: &'static Chip) -> Vec<Row> {
    let places = |gate: &Gate| {
        let external = gate.external.as_ref().map(|external| external.byte);
        [Some(gate.limit), gate.divider, external, gate.cells].into_iter().flatten().collect::<Vec<_>>()
    };
    chip.gate.as_ref().map_or_else(Vec::new, |gate| at(chip, &places(gate)))
}

/// Empty: something else would decide it.
fn none(_: &'static Chip) -> Vec<Row> {
    Vec::new()
}

/// All beliefs.
pub static BELIEFS: &[Belief] = &[
    Belief {
        name: "unit of Board Offset",
        parts: "bq34z100-G1, bq34z100-R2",
        holds: "4 counts of Board Offset are 1 mA",
        decided_by: "Board Offset beside Current() without a load, before and after BOARD_OFFSET: `Last calibration` and `Value 104/10` \
                     in a report after `gaugefs calibrate GAUGE board-offset`",
        otherwise: "nothing is computed with it: the gauge stores its own measurement, and the old value goes back if Current() \
                    is then further from 0",
        of: is_calibrated,
        rows: |chip| named(chip, &["Board Offset"]),
    },
    Belief {
        name: "unit of CC Offset",
        parts: "bq34z100-G1, bq34z100-R2",
        holds: "2083 counts of CC Offset are 1 mA, as TI's tools show 0.00048 for one",
        decided_by: "CC Offset beside Current() without a load, before and after CC_OFFSET: `Last calibration` and `Value 104/8` in a \
                     report after `gaugefs calibrate GAUGE cc-offset`",
        otherwise: "as for Board Offset",
        of: is_calibrated,
        rows: |chip| named(chip, &["CC Offset"]),
    },
    Belief {
        name: "voltage of the gate",
        parts: "bq34z100-G1, bq34z100-R2, bq34110",
        holds: "Voltage() is in proportion to Voltage Divider, and flash is shut below a limit for Voltage() (bq34z100-R2, bq34110) \
                or for Voltage() at a divider of 5000 as well (bq34z100-G1)",
        decided_by: "a write near the limit that is stored or not; Voltage(), divider and limit (`Register` and `Value` in a report)",
        otherwise: "a block that is not stored is noticed when it is read back, and the write is EIO; a bq34z100-G1 is \
                    refused a limit or divider that would shut flash by either reading",
        of: has_divider,
        rows: gate,
    },
    Belief {
        name: "[VOLTSEL] times 5",
        parts: "bq34z100-G1",
        holds: "[VOLTSEL] alone makes Voltage() five times larger or smaller",
        decided_by: "Voltage() before and after [VOLTSEL] is changed on a gauge whose pack stays the same (`Register` and `Value 64/0` \
                     in a report before and one after)",
        otherwise: "a bring-up puts the old values back if Voltage() is not the pack's; elsewhere [VOLTSEL] is judged with \
                    the limit, and flash that is shut is opened by a bring-up",
        of: |chip| {
            let external = chip.gate.as_ref().and_then(|gate| gate.external.as_ref());
            external.is_some_and(|external| external.factor.is_some())
        },
        rows: gate,
    },
    Belief {
        name: "Voltage() before the first measurement",
        parts: "parts with standard commands only",
        holds: "Voltage() is 0 until the gauge has measured after its power-up",
        decided_by: "a recording of the first two seconds after power-up (`gaugefs mount --trace`)",
        otherwise: "values from before the power-up are shown for up to 2 s",
        of: |chip| !chip.has_table() && kernel::driver_name(chip).is_some(),
        rows: none,
    },
    Belief {
        name: "[BCA] and [CCA]",
        parts: "bq34z100-G1, bq34z100-R2",
        holds: "one of them is seen within 2 s of BOARD_OFFSET or CC_OFFSET; owners of a bq35100 did not see [CCA] (E2E \
                785441, 928011)",
        decided_by: "a report after `gaugefs calibrate GAUGE board-offset`: `Offsets` has when one of them was seen, and is missing if \
                     none was",
        otherwise: "the calibration of the offset fails, and the old offsets are written back and verified",
        of: is_calibrated,
        rows: none,
    },
    Belief {
        name: "RESET",
        parts: "all with data flash",
        holds: "it takes at most the time in the table, and a gauge that had been sealed is sealed after it",
        decided_by: "writes that reset, then a report: `Resets` has how often and when SEALED was seen",
        otherwise: "the gauge is waited for until it answers, its seal state is read with two looks whatever was \
                    expected, and SEALED is sent if it was found sealed",
        of: Chip::has_table,
        rows: none,
    },
    Belief {
        name: "commits of MACData()",
        parts: "bq27220, bq28z610, bq34110, bq35100",
        holds: "MACDataSum() and MACDataLen(), in this order, commit what was written to MACData(), within 250 ms",
        decided_by: "writes, then a report: `Commits` has the time from the length to the new content, between two looks",
        otherwise: "nothing is stored, which eight looks 80 ms apart show: the write is EIO",
        of: is_mac,
        rows: none,
    },
    Belief {
        name: "order of the scales",
        parts: "bq34z100-R2",
        holds: "48/30 to 48/32 are the scales of voltage, current and energy",
        decided_by: "48/30 to 48/32 of a pack with three different scales (`Value` in a report), beside VoltScale(), CurrScale() and \
                     EnergyScale() (`Register`)",
        otherwise: "attributes follow from the registers, whatever the order; the three bytes are unproven and so read-only",
        of: |chip| chip.scaling.voltage != Scale::None,
        rows: |chip| at(chip, &[(48, 30), (48, 31), (48, 32)]),
    },
    Belief {
        name: "addresses as printed",
        parts: "bq34110, bq35100",
        holds: "addresses above 0x4100 are not lower than printed, as one owner found them (E2E 668766)",
        decided_by: "the block above 0x4100 in a report, beside the printed defaults",
        otherwise: "values that cannot be there show it before the first write, which is refused (ENODEV)",
        of: |chip| chip.access.scheme == Scheme::Mac && !chip.evidence.contains(&Evidence::Image),
        rows: none,
    },
    Belief {
        name: "places of the rows",
        parts: "parts of whose data flash only names are known",
        holds: "each row is where one source, or a sibling's, has it",
        decided_by: "a report: all blocks without texts are in it, and all numbers (`Value`), to be compared with the \
                     printed defaults and with what the pack is made for",
        otherwise: "a name is shown beside the value of another one; nothing is ever written",
        of: Chip::has_only_names,
        rows: |chip| chip.rows().filter(|(subclass, _)| !subclass.is_makers()).collect(),
    },
];

impl Chip {
    /// The unconfirmed beliefs about this part.
    pub fn beliefs(&self) -> impl Iterator<Item = &'static Belief> + '_ {
        BELIEFS.iter().filter(|belief| (belief.of)(self))
    }

    /// The parameters whose values could decide the beliefs.
    pub fn believed_rows(&'static self) -> Vec<Row> {
        let mut rows: Vec<Row> = Vec::new();
        for row in self.beliefs().flat_map(|belief| (belief.rows)(self)) {
            if !rows.iter().any(|(_, known)| std::ptr::eq(*known, row.1)) {
                rows.push(row);
            }
        }
        rows
    }
}
