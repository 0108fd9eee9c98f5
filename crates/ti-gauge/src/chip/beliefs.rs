//! What the tables and the simulator have in common although no document, image or part has confirmed it: a test against
//! the simulator cannot show that it is wrong. `docs/BELIEFS.md` is this list.

use super::{Chip, Scale, Scheme, kernel};

/// Something that is held to be so.
#[derive(Debug)]
pub struct Belief {
    /// A name for it.
    pub name: &'static str,
    /// The parts of which it is believed, in words.
    pub parts: &'static str,
    /// What is believed.
    pub holds: &'static str,
    /// What would decide it, and where a report has that.
    pub decided_by: &'static str,
    /// What happens on a gauge of which it is not so.
    pub otherwise: &'static str,
    of: fn(&Chip) -> bool,
}

fn is_calibrated(chip: &Chip) -> bool {
    chip.calibration.is_some()
}

fn is_mac(chip: &Chip) -> bool {
    chip.access.scheme.is_flat()
}

/// A part with a voltage that depends on a divider in data flash.
fn has_divider(chip: &Chip) -> bool {
    chip.gate.as_ref().is_some_and(|gate| gate.divider.is_some())
}

/// All of them.
pub static BELIEFS: &[Belief] = &[
    Belief {
        name: "unit of Board Offset",
        parts: "bq34z100-G1, bq34z100-R2",
        holds: "4 counts of Board Offset are 1 mA",
        decided_by: "Board Offset (`104/0` in a report) beside Current() without a load, before and after BOARD_OFFSET",
        otherwise: "nothing is computed with it: the gauge stores its own measurement, and the old value goes back if Current() \
                    is then further from 0",
        of: is_calibrated,
    },
    Belief {
        name: "unit of CC Offset",
        parts: "bq34z100-G1, bq34z100-R2",
        holds: "2083 counts of CC Offset are 1 mA, as TI's tools show 0.00048 for one",
        decided_by: "CC Offset (`104/0` in a report) beside Current() without a load, before and after CC_OFFSET",
        otherwise: "as for Board Offset",
        of: is_calibrated,
    },
    Belief {
        name: "voltage of the gate",
        parts: "bq34z100-G1, bq34z100-R2, bq34110",
        holds: "Voltage() is in proportion to Voltage Divider, and flash is shut below a limit for Voltage() (bq34z100-R2, bq34110) \
                or for Voltage() at a divider of 5000 as well (bq34z100-G1)",
        decided_by: "a write near the limit that is stored or not; Voltage(), divider and limit (`64/0`, `68/0`, `104/0` in a report)",
        otherwise: "a block that is not stored is noticed when it is read back, and the write is EIO; a bq34z100-G1 is \
                    refused a limit or divider that would shut flash by either reading",
        of: has_divider,
    },
    Belief {
        name: "[VOLTSEL] times 5",
        parts: "bq34z100-G1",
        holds: "[VOLTSEL] alone makes Voltage() five times larger or smaller",
        decided_by: "Voltage() before and after [VOLTSEL] is changed on a gauge whose pack stays the same",
        otherwise: "a bring-up puts the old values back if Voltage() is not the pack's; elsewhere [VOLTSEL] is judged with \
                    the limit, and flash that is shut is opened by a bring-up",
        of: |chip| {
            let external = chip.gate.as_ref().and_then(|gate| gate.external.as_ref());
            external.is_some_and(|external| external.factor.is_some())
        },
    },
    Belief {
        name: "Voltage() before the first measurement",
        parts: "those of which only the standard commands are known",
        holds: "Voltage() is 0 until the gauge has measured after its power-up",
        decided_by: "a recording of the first two seconds after power-up (`gaugefs mount --trace`)",
        otherwise: "values from before the power-up are shown for up to 2 s",
        of: |chip| !chip.has_table() && kernel::driver_name(chip).is_some(),
    },
    Belief {
        name: "[BCA] and [CCA]",
        parts: "bq34z100-G1, bq34z100-R2",
        holds: "one of them is seen within 2 s of BOARD_OFFSET or CC_OFFSET; owners of a bq35100 did not see [CCA] (E2E \
                785441, 928011)",
        decided_by: "CONTROL_STATUS every 50 ms after BOARD_OFFSET (`gaugefs mount --trace`)",
        otherwise: "the calibration of the offset fails, and the old offsets are written back and verified",
        of: is_calibrated,
    },
    Belief {
        name: "RESET",
        parts: "all with data flash",
        holds: "it takes at most the time in the table, and a gauge that had been sealed is sealed after it",
        decided_by: "a recording of a write that resets (`gaugefs mount --trace`)",
        otherwise: "the gauge is waited for until it answers, its seal state is read with two looks whatever was \
                    expected, and SEALED is sent if it was found sealed",
        of: Chip::has_table,
    },
    Belief {
        name: "commits of MACData()",
        parts: "bq27220, bq34110, bq35100",
        holds: "MACDataSum() and MACDataLen(), in this order, commit what was written to MACData(), within 250 ms",
        decided_by: "a recording of a write of one value (`gaugefs mount --trace`), with the time from the length to the new \
                     content",
        otherwise: "nothing is stored, which eight looks 80 ms apart show: the write is EIO",
        of: is_mac,
    },
    Belief {
        name: "order of the scales",
        parts: "bq34z100-R2",
        holds: "48/30 to 48/32 are the scales of voltage, current and energy",
        decided_by: "48/30 to 48/32 of a pack with three different scales, beside VoltScale(), CurrScale() and EnergyScale()",
        otherwise: "attributes follow from the registers, whatever the order; the three bytes are unproven and so read-only",
        of: |chip| chip.scaling.voltage != Scale::None,
    },
    Belief {
        name: "addresses as printed",
        parts: "bq34110, bq35100",
        holds: "addresses above 0x4100 are not lower than printed, as one owner found them (E2E 668766)",
        decided_by: "the block above 0x4100 in a report, beside the printed defaults",
        otherwise: "values that cannot be there show it before the first write, which is refused (ENODEV)",
        of: |chip| chip.access.scheme == Scheme::Mac,
    },
];

impl Chip {
    /// What is believed of this part and not confirmed.
    pub fn beliefs(&self) -> impl Iterator<Item = &'static Belief> + '_ {
        BELIEFS.iter().filter(|belief| (belief.of)(self))
    }
}
