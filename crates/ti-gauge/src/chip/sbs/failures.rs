// SPDX-License-Identifier: MIT

//! Why a gauge of TI's has taken its pack out of use for good: its names of the bits of PFStatus(), what trips them, and
//! what that condition is about, to be looked at (SLUUBK0B 3, SLUUAQ3A 3, SLUUA79 3, SLUUBD3D 4).

use super::super::{Chip, Question, Register, Source};

/// A reason of a permanent failure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Defect {
    /// TI's name of the bit, or `bit N` of one without a name.
    pub name: String,
    /// What has happened.
    pub what: &'static str,
    /// What to look at.
    pub check: &'static str,
}

const CELLS: &str = "the voltage of each cell, measured at its tabs";
const CURRENT: &str = "the load or charger, and the sense resistor";
const LATCH: &str = "the load or charger, which has tripped the protection again and again";
const HOT: &str = "the thermistors, and what heats the pack";
const FETS: &str = "the FET, which may be welded: current flows while it is to be off";
const SPREAD: &str = "whether one cell has aged more than the others, or leaks";
const BOARD: &str = "nothing outside: the board has to be replaced";
const OPEN: &str = "the thermistor and its wires";
const TAB: &str = "the tabs and wires of the cells";

/// Names, what they mean, and what to look at. One name means the same on all parts that have it.
#[rustfmt::skip]
static REASONS: &[(&[&str], &str, &str)] = &[
    (&["SUV", "CUV"], "a cell was far below its lowest voltage, where copper may plate: do not charge it", CELLS),
    (&["SOV", "COV"], "a cell was far above its highest voltage", CELLS),
    (&["SOCC"], "the charge current was far too high", CURRENT),
    (&["SOCD"], "the discharge current was far too high", CURRENT),
    (&["SOT", "OTCE"], "the cells were far too hot", HOT),
    (&["SOTF", "OTF"], "the FETs were far too hot", HOT),
    (&["COVL"], "the overvoltage protection has latched for good", CELLS),
    (&["AOLDL"], "the overload protection has latched for good", LATCH),
    (&["ASCCL"], "the protection from a short circuit while charging has latched for good", LATCH),
    (&["ASCDL"], "the protection from a short circuit while discharging has latched for good", LATCH),
    (&["OCDL"], "the protection from too much discharge current has latched for good", LATCH),
    (&["QIM"], "the capacities of the cells differ too much", SPREAD),
    (&["CB"], "balancing the cells took too long", SPREAD),
    (&["IMP"], "the impedance of a cell is out of range", "the cells, which have aged, and their tabs"),
    (&["CD"], "the capacity has worn down too far", "the cells, which have aged"),
    (&["VIMR"], "the voltages of the cells differ too much at rest", SPREAD),
    (&["VIMA"], "the voltages of the cells differ too much under load", SPREAD),
    (&["CFETF"], "the charge FET does not turn off", FETS),
    (&["DFETF", "DFET"], "the discharge FET does not turn off", FETS),
    (&["FUSE"], "the fuse line went high without being asked, or the fuse has failed", "the chemical fuse and its driver"),
    (&["AFER"], "the registers of the front end do not hold", BOARD),
    (&["AFEC"], "the front end does not answer", BOARD),
    (&["2LVL"], "the second protector has fired, which measures on its own", CELLS),
    (&["PTC"], "the PTC element has tripped", HOT),
    (&["IFC"], "the checksum of the firmware is wrong", BOARD),
    (&["DFW"], "data flash can no longer be written", BOARD),
    (&["OPNCELL", "OCECO"], "the connection to a cell is open", TAB),
    (&["TS1", "TS2", "TS3", "TS4", "TH", "THERM"], "a thermistor is open or has failed", OPEN),
];

const UNNAMED: (&str, &str) = ("a reason without a name in TI's documents that are public", CELLS);
const UNTOLD: (&str, &str) = ("a permanent failure, whose reason it does not tell", CELLS);

impl Defect {
    fn of(name: String, (what, check): (&'static str, &'static str)) -> Self {
        Self { name, what, check }
    }
}

/// The reasons of a permanent failure; none where there is no failure, or nothing is known of one. `word` is a row's value.
pub fn failures(chip: &Chip, word: impl Fn(&Register) -> Option<i64>) -> Vec<Defect> {
    let Some(asks) = chip.asks else { return Vec::new() };
    let row = |code| chip.register_at(Source::Answer(code));
    let reasons = row(Question::PF_STATUS).and_then(|row| Some((row, word(row)?)));
    let named = reasons.into_iter().flat_map(|(row, word)| row.set(word)).map(|name| {
        let known = REASONS.iter().find(|(names, ..)| names.contains(&&*name));
        Defect::of(name, known.map_or(UNNAMED, |&(_, what, check)| (what, check)))
    });
    let named: Vec<_> = named.collect();
    let status = row(Question::OPERATION_STATUS).and_then(word);
    match status.is_some_and(|status| status & i64::from(asks.failed) != 0) && named.is_empty() {
        true => vec![Defect::of("PF".into(), UNTOLD)],
        false => named,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_bit_of_a_permanent_failure_has_its_reason_and_what_to_look_at() {
        for chip in Chip::all().filter(|chip| chip.asks.is_some()) {
            let Some(row) = chip.register_at(Source::Answer(Question::PF_STATUS)) else { continue };
            for bit in row.bits {
                let known = REASONS.iter().filter(|(names, ..)| names.contains(&bit.name)).count();
                assert_eq!(known, 1, "{} {}", chip.name, bit.name);
            }
        }
    }

    #[test]
    fn a_failure_is_told_also_where_its_reason_has_no_name() {
        let chip = Chip::by_name("bq40z50-r2").expect("a chip");
        let told = |pf: Option<i64>, status: i64| {
            let of = |row: &Register| match row.source {
                Source::Answer(Question::PF_STATUS) => pf,
                Source::Answer(Question::OPERATION_STATUS) => Some(status),
                _ => None,
            };
            failures(chip, of).into_iter().map(|failure| failure.name).collect::<Vec<_>>().join(" ")
        };
        assert_eq!(told(Some(0), 0x0300), "");
        assert_eq!(told(Some(0x0801), 0x1300), "VIMR SUV");
        assert_eq!(
            told(Some(0x0200_0001), 0x1300),
            "bit 25 SUV",
            "OPNCELL of its siblings is no bit of this one"
        );
        assert_eq!((told(Some(0), 0x1300), told(None, 0x1300)), ("PF".into(), "PF".into()));
    }
}
