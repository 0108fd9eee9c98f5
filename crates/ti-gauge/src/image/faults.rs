// SPDX-License-Identifier: MIT

//! All mistakes in a file, so that a person need not correct one to see the next.

use super::{Image, at_line};
use crate::error::{Cause, Error, Result};

/// Number of mistakes that are shown, those of the first lines; the rest is counted.
pub const NAMED: usize = 20;

/// The mistakes in a file, in the order of its lines, after those of the file as a whole.
#[derive(Debug, Default)]
pub struct Faults {
    named: Vec<(usize, Error)>,
    count: usize,
}

/// A file as far as it is readable.
#[derive(Debug)]
pub struct Reading {
    /// The image without wrong lines; `None` if the rest is meaningless without them.
    pub image: Option<Image>,
    /// What is wrong with it.
    pub faults: Faults,
}

impl Faults {
    /// Adds a mistake of a line, or of the whole file for line 0.
    pub fn add(&mut self, line: usize, error: Error) {
        self.count += 1;
        let at = self.named.partition_point(|(known, _)| *known <= line);
        if at < NAMED {
            self.named.insert(at, (line, error));
            self.named.truncate(NAMED);
        }
    }

    pub(super) fn at(&mut self, line: usize, why: impl Into<String>) {
        self.add(line, at_line(line, why));
    }

    pub(super) fn stop<T>(&mut self, line: usize, error: Error) -> Option<T> {
        self.add(line, error);
        None
    }

    pub(super) fn keep<T>(&mut self, line: usize, outcome: Result<T>) -> Option<T> {
        outcome.map_err(|error| self.add(line, error)).ok()
    }

    /// Drops mistakes after the line at which reading ended.
    pub(super) fn end_at(&mut self, line: usize) {
        self.named.retain(|(known, _)| *known <= line);
        self.count = self.named.len();
    }

    /// Keeps the first mistake if they are many of one kind: such a file has another format.
    pub(super) fn unite(&mut self) {
        const SEVERAL: usize = 5;
        let Some((line, first)) = self.named.first().cloned() else { return };
        if self.count > SEVERAL && self.named.iter().all(|(_, error)| error.reason() == first.reason()) {
            *self = Self::default();
            self.at(line, format!("{}; no other line of the file can be read either", first.reason()));
        }
    }

    /// Whether nothing is wrong.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The shown mistakes.
    pub fn iter(&self) -> impl Iterator<Item = &Error> {
        self.named.iter().map(|(_, error)| error)
    }

    /// All mistakes as one error, that of the first line; `None` for a faultless file.
    pub fn error(&self) -> Option<Error> {
        let (first, further) = self.named.split_first()?;
        let more = match self.more() {
            0 => None,
            more => Some(Error::new("", Cause::Invalid, format!("and {more} more mistakes"))),
        };
        let further = further.iter().map(|(_, error)| error.clone());
        Some(first.1.clone().and(further.chain(more)))
    }

    /// Number of further mistakes.
    pub fn more(&self) -> usize {
        self.count - self.named.len()
    }
}

impl Reading {
    /// The image of a faultless file, or its first mistake.
    pub fn whole(self) -> Result<Image> {
        match (self.faults.named.into_iter().next(), self.image) {
            (Some((_, error)), _) => Err(error),
            (None, image) => Ok(image.expect("a file that cannot be read has a mistake")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::Chip;

    #[test]
    fn the_first_lines_are_named_and_the_others_counted() {
        let mut faults = Faults::default();
        for line in (1..=50).rev() {
            faults.at(line, format!("mistake {line}"));
        }
        faults.add(0, Error::new("", Cause::Invalid, "the file"));
        let named: Vec<_> = faults.iter().map(ToString::to_string).collect();
        assert_eq!((named.len(), faults.more()), (NAMED, 31));
        assert_eq!(&named[..2], ["the file", "line 1: mistake 1"]);
        assert_eq!(named[NAMED - 1], "line 19: mistake 19");
        let lines: Vec<_> = faults.error().expect("mistakes").lines().collect();
        assert_eq!((&lines[..NAMED], &*lines[NAMED]), (&named[..], "and 31 more mistakes"));
        faults.end_at(3);
        assert_eq!((faults.iter().count(), faults.more()), (4, 0));
    }

    /// All mistakes in a text, for a chip.
    fn all(chip: &str, text: &str) -> Vec<String> {
        let reading = Image::examine_text(text, Chip::by_name(chip));
        assert_eq!(reading.faults.more(), 0);
        reading.faults.iter().map(ToString::to_string).collect()
    }

    fn assert_all(chip: &str, text: &str, says: &[&str]) {
        let found = all(chip, text);
        assert_eq!(found.len(), says.len(), "{text}\n{found:#?}");
        for (found, says) in found.iter().zip(says) {
            assert!(found.starts_with(says), "{found}\n{says}");
        }
    }

    #[test]
    fn every_mistake_of_a_toml_is_named_in_the_order_of_the_lines() {
        let text = "chip = \"bq34z100-g1\"\n[safety]\not-chg = 40000\n[it-cfg]\ncell-terminate-voltag = 3000\n\
                    ra-filter = \"many\"\nload-select = \n[it-cgf]\nra-filter = 1\n[nonsense]\nx = 1\n";
        assert_all(
            "bq34z100-g1",
            text,
            &[
                "line 3: OT Chg: the value is outside",
                "line 5: a bq34z100-G1 has no parameter it-cfg/cell-terminate-voltag; did you mean \
                 it-cfg/cell-terminate-voltage?",
                "line 6: it-cfg/ra-filter: string, but U2 is expected",
                "line 7: not TOML: ",
                "line 8: a bq34z100-G1 has no class it-cgf; did you mean [it-cfg]?",
                "line 10: a bq34z100-G1 has no class nonsense",
            ],
        );
        // A wrong line's facts about the gauge are nobody's mistake.
        let head = "chip = \"bq34z100-g9\"\nfirmware = 70000\n[it-cfg]\n";
        let reading = Image::examine_text(head, None);
        let told: Vec<_> = reading.faults.iter().map(ToString::to_string).collect();
        assert_eq!(told.len(), 2, "{told:?}");
    }

    #[test]
    fn every_mistake_of_a_gg_csv_is_named_in_the_order_of_the_lines() {
        let text = "* Device Number 100\n* Firmware Version 1\n\
                    * Field Order: Class name, Subclass name, Parameter name, Parameter Value\n\
                    Gas Gauging,IT Cfg,Cell Terminate Voltage,low\nGas Gauging,IT Cfg,Ra Filter,1,2,3\n\
                    Gas Gauging\nGas Gauging,IT Cfg,Cell Terminate Voltag,1\nConfiguration,Data,Device Name,much too long it is\n";
        assert_all(
            "bq34z100-g1",
            text,
            &[
                "line 2: Firmware Version: not two or three numbers",
                "line 4, column D: Cell Terminate Voltage: the value is not a whole number",
                "line 5: 6 fields, but the header names 4",
                "line 6: no field `subclass-name`",
                "line 8, column D: Device Name: 19 characters",
            ],
        );
        let image = Image::examine_text(text, Chip::by_name("bq34z100-g1")).image.expect("the other lines");
        let left: Vec<_> = image.left_out.iter().map(|left| left.text.as_str()).collect();
        let meant = "did you mean Gas Gauging/IT Cfg/Cell Terminate Voltage?";
        let why = "line 7: Gas Gauging/IT Cfg/Cell Terminate Voltag: not in the table; left out";
        assert_eq!(left, [format!("{why}; {meant}")]);
    }

    #[test]
    fn every_mistake_of_a_flashstream_is_named_in_the_order_of_the_lines() {
        // Cell Terminate Voltage and Ra Filter, by subclass 80 (0x50).
        let good = "W: AA 3E 50 01\nW: AA 55 0C 1C\nW: AA 60 7A\nX: 10\n";
        let text = format!(
            "W: AA 3E 50 01\nW: AA 55 0C 1G\nW: AA 60 7A\n{good}W: AA 10 00\n{good}X: soon\n\
             W: AA 3E 50 01\nW: AA 55 0C 1C\nW: AA 3E 02 00\nW: AA 40 02\nW: AA 60 7A\nW: 54 00 13 00\nhello\n"
        );
        assert_all(
            "bq34z100-g1",
            &text,
            &[
                "line 2: expected bytes of two hexadecimal digits",
                "line 8: register 0x10 does not configure a gauge",
                "line 13: X: needs a number of milliseconds",
                "line 16: the bytes of line 15 are not committed",
                "line 18: OT Chg: only part of it is written",
                "line 19: no address before the register",
                "line 20: not a line of a FlashStream",
            ],
        );
        // A mistake that follows from a wrong line is not listed as well.
        let sum = "W: AA 3E 08 40 FB 50\nW: AA 60 6D 06\nW: AA 3E 08 40\nC: AA 40 FB 50\n";
        let flat = format!("W: AA 3E 08 40 FB 5\nW: AA 60 6C 06\n{sum}W: AA 3E 08 40 FB\nW: AA 60 BC 05\n");
        assert_all(
            "bq34110",
            &flat,
            &["line 1: expected bytes of two", "line 4: checksum 0x6d, but the bytes give 0x6c"],
        );
        // Half of a key, whose other line is not readable.
        assert_all(
            "bq34z100-g1",
            &format!("W: AA 00 14 0\nW: AA 00 72 36\n{good}"),
            &["line 1: expected bytes"],
        );
    }

    #[test]
    fn a_file_of_another_kind_is_one_mistake() {
        for (line, says) in [
            ("W: AA3E0200", "packed hexadecimal: bytes without spaces between them; expected"),
            ("W:AA3E5001", "packed hexadecimal"),
            ("W: 0xAA 0x3E 0x50 0x01", "a number with 0x; expected"),
            ("W: AA,3E,50,01", "numbers with commas between them; expected"),
            ("AA3E0200", "bytes without a command before them; write W: if a host sends them"),
            ("AA 3E 02 00", "bytes without a command before them"),
            ("W AA 3E 02 00", "not a line of a FlashStream"),
            ("W: 3E 50 01", "no address before the register, as in a file for HDQ"),
            ("W: 3E 50", "no address before the register, as in a file for HDQ"),
            (":10010000214601360121470136007EFE09D21901", "a record of an Intel HEX or S-record file"),
            ("S1130000285F245F2212226A000424290008237C2A", "a record of an Intel HEX or S-record file"),
            ("W: 55 00 13 00", "address 0x55 is not the gauge's, which is AA"),
        ] {
            let many = format!("{line}\n").repeat(50);
            let says = format!("line 1: {says}");
            assert_all("bq27441-g1", &many, &[&says]);
            assert!(all("bq27441-g1", &many)[0].ends_with("; no other line of the file can be read either"));
            let one = all("bq27441-g1", &format!("{line}\n"));
            assert!(one.len() == 1 && one[0].starts_with(&says) && !one[0].contains("no other"), "{one:?}");
            // Such a line among others. It may be a key.
            let among = format!("W: AA 00 42 00\n{line}\n");
            let told = all("bq27441-g1", &among);
            assert_eq!(told.len(), 1, "{told:?}");
            assert!(told[0].starts_with("line 2: ") && !told[0].contains("AA3E0200"), "{told:?}");
        }
    }

    /// What is said of a file is short, however long it and its names are.
    #[test]
    fn what_is_said_of_a_hostile_file_is_short() {
        let long = "x".repeat(100_000);
        let head = "* Field Order: Class name, Subclass name, Parameter name, Parameter Value\n";
        for text in [
            format!("chip = \"{long}\"\n"),
            format!("[{long}]\n{long} = 1\n"),
            format!("[it-cfg]\n{long} = 1\n"),
            "[it-cfg]\n".to_string() + &(0..20_000).map(|at| format!("x{at} = 1\n")).collect::<String>(),
            "[it-cfg]\n".to_string() + &(0..20_000).map(|at| format!("x{at} = =\n")).collect::<String>(),
            "[".repeat(100_000),
            "W: AA 5\n".repeat(20_000) + "W: AA 00 42 00\n",
            format!("W: {long}\n"),
            format!("{head}Gas Gauging,IT Cfg,Ra Filter,{long}\n").repeat(30),
            format!("* Device Number 100\n{head}") + &"Gas Gauging\n".repeat(20_000),
        ] {
            let reading = Image::examine_text(&text, Chip::by_name("bq34z100-g1"));
            let told: String = reading.faults.iter().map(|error| format!("{error}\n")).collect();
            assert!(!told.is_empty() && told.len() < NAMED * 1100, "{}: {}", &text[..20], told.len());
        }
    }
}
