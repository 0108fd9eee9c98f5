// SPDX-License-Identifier: MIT

//! Data flash of a simulated gauge, or its RAM: bytes by area and block, the wear of each block, and the file that
//! keeps both across processes.
//!
//! An area is a subclass. Its blocks have 32 bytes; the last one may be shorter. This module does not know what the
//! bytes mean.

use std::fmt::Write as _;
use std::fs::OpenOptions;
use std::io;
use std::path::{Path, PathBuf};

use gauge_bus::error::{Error, ErrorKind, Result};
use gauge_bus::regular::{self, Replace};
use sha1::{Digest, Sha1};

use super::rom::{DATA, Firmware};

/// Bytes in a whole block.
pub(super) const BLOCK: usize = 32;

/// Content of a new part: number and bytes of each area, in the order of [`Flash::bytes`].
pub(super) type Image = &'static [(u16, &'static [u8])];

#[derive(Clone, Debug)]
struct Area {
    id: u16,
    bytes: Vec<u8>,
    wear: Vec<u32>,
}

#[derive(Clone, Debug)]
pub(super) struct Flash {
    areas: Vec<Area>,
    /// The interface is HDQ instead of I2C, also after a loss of power.
    pub(super) hdq: bool,
    /// Flags() `[ITPOR]` of a gauge with RAM: its content is still ROM's.
    pub(super) itpor: bool,
    /// This specimen's ROM has a negative CC Gain.
    pub(super) inverted: bool,
    pub(super) firmware: Option<Firmware>,
}

impl Flash {
    pub(super) fn new(image: Image) -> Self {
        let area = |&(id, bytes): &(u16, &'static [u8])| Area {
            id,
            bytes: bytes.to_vec(),
            wear: vec![0; bytes.len().div_ceil(BLOCK)],
        };
        let areas = image.iter().map(area).collect();
        Self { areas, hdq: false, itpor: false, inverted: false, firmware: None }
    }

    fn area(&self, id: u16) -> Option<&Area> {
        self.areas.iter().find(|area| area.id == id)
    }

    fn area_mut(&mut self, id: u16) -> Option<&mut Area> {
        self.areas.iter_mut().find(|area| area.id == id)
    }

    pub(super) fn size(&self, id: u16) -> usize {
        self.area(id).map_or(0, |area| area.bytes.len())
    }

    /// The bytes of a block: fewer than 32 at the end of an area, none beyond it.
    pub(super) fn block(&self, id: u16, block: u8) -> &[u8] {
        let start = usize::from(block) * BLOCK;
        match self.area(id) {
            Some(area) if start < area.bytes.len() => &area.bytes[start..area.bytes.len().min(start + BLOCK)],
            _ => &[],
        }
    }

    /// Programs bytes and counts the wear of every block that they touch.
    pub(super) fn program(&mut self, id: u16, offset: usize, bytes: &[u8]) {
        self.set(id, offset, bytes);
        if let Some(area) = self.area_mut(id) {
            let blocks = offset / BLOCK..(offset + bytes.len()).div_ceil(BLOCK);
            for count in area.wear.iter_mut().take(blocks.end).skip(blocks.start) {
                *count += 1;
            }
        }
    }

    /// Changes bytes without wear.
    pub(super) fn set(&mut self, id: u16, offset: usize, bytes: &[u8]) {
        if let Some(target) = self.area_mut(id).and_then(|area| area.bytes.get_mut(offset..)) {
            let count = target.len().min(bytes.len());
            target[..count].copy_from_slice(&bytes[..count]);
        }
    }

    /// `count` bytes of an area from `offset` on; empty if the area is shorter.
    pub(super) fn bytes_at(&self, id: u16, offset: usize, count: usize) -> &[u8] {
        self.area(id).and_then(|area| area.bytes.get(offset..offset + count)).unwrap_or(&[])
    }

    /// `N` bytes of an area from `offset` on; zeros if the area is shorter.
    pub(super) fn get<const N: usize>(&self, id: u16, offset: usize) -> [u8; N] {
        self.bytes_at(id, offset, N).try_into().unwrap_or([0; N])
    }

    pub(super) fn u8(&self, id: u16, offset: usize) -> u8 {
        self.get::<1>(id, offset)[0]
    }

    pub(super) fn u16(&self, id: u16, offset: usize) -> u16 {
        u16::from_be_bytes(self.get(id, offset))
    }

    pub(super) fn i16(&self, id: u16, offset: usize) -> i16 {
        i16::from_be_bytes(self.get(id, offset))
    }

    /// TI's floating point: exponent, sign and 23 bits behind an implied 1 (SLUSBZ5D, F4).
    pub(super) fn f4(&self, id: u16, offset: usize) -> f64 {
        let [exponent, high, middle, low] = self.get::<4>(id, offset);
        let mantissa = f64::from(u32::from_be_bytes([0, high | 0x80, middle, low]));
        let sign = if high & 0x80 == 0 { 1.0 } else { -1.0 };
        sign * libm::ldexp(mantissa, i32::from(exponent) - 128 - 24)
    }

    /// Restores all areas but one, as ROM fills RAM.
    pub(super) fn reload(&mut self, image: Image, but: u16) {
        for &(id, bytes) in image.iter().filter(|(id, _)| *id != but) {
            self.set(id, 0, bytes);
        }
    }

    pub(super) fn bytes(&self) -> Vec<u8> {
        self.areas.iter().flat_map(|area| area.bytes.iter().copied()).collect()
    }

    /// Program counts of blocks, without zeros: `48/0 3 68/0 1`.
    pub(super) fn wear(&self) -> String {
        let mut out = String::new();
        for area in &self.areas {
            for (block, &count) in area.wear.iter().enumerate().filter(|&(_, &count)| count > 0) {
                let space = if out.is_empty() { "" } else { " " };
                let _ = write!(out, "{space}{}/{block} {count}", area.id);
            }
        }
        out
    }

    pub(super) fn wear_of(&self, id: u16, block: usize) -> u32 {
        self.area(id).and_then(|area| area.wear.get(block)).copied().unwrap_or(0)
    }

    pub(super) fn programmed(&self) -> u64 {
        self.areas.iter().flat_map(|area| &area.wear).map(|&count| u64::from(count)).sum()
    }
}

#[derive(Debug)]
pub(super) struct Store {
    path: Option<PathBuf>,
    chip: &'static str,
    pub(super) failure: Option<String>,
}

impl Store {
    pub(super) fn new(path: Option<PathBuf>, chip: &'static str) -> Self {
        Self { path, chip, failure: None }
    }

    /// Fills `flash` from the file. Returns `false` if there is no file yet.
    pub(super) fn load(&self, flash: &mut Flash) -> Result<bool> {
        let Some(path) = &self.path else { return Ok(false) };
        let file = match regular::open(OpenOptions::new().read(true), path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(false),
            file => file.and_then(|file| regular::read_file(file, LONGEST)).and_then(regular::text),
        };
        let text = file.map_err(|error| match error.kind() {
            io::ErrorKind::PermissionDenied => host(path, &error, "cannot be read"),
            _ => self.refuse(&error.to_string()),
        })?;
        self.parse(&text, flash).map_err(|why| self.refuse(&why))?;
        Ok(true)
    }

    /// Checks that the file can be read and replaced, as far as possible without a change.
    pub(super) fn check(&self, flash: &mut Flash) -> Result<()> {
        self.load(flash)?;
        let Some(path) = &self.path else { return Ok(()) };
        regular::check_replace(path, Replace::Private)
            .map_err(|error| host(path, &error, "cannot be written"))
    }

    fn refuse(&self, why: &str) -> Error {
        let path = self.path.as_deref().unwrap_or(Path::new("")).display().to_string();
        let remedy = "restore it, or move it away for a new gauge";
        let text = format!("not a usable state of a {} gauge: {why}; {remedy}", self.chip);
        Error::new(path, ErrorKind::Invalid, text)
    }

    fn parse(&self, text: &str, flash: &mut Flash) -> Result<(), String> {
        let mut lines = text.lines();
        if lines.next() != Some(HEAD) {
            return Err(format!("it does not begin with `{HEAD}`"));
        }
        // The chip comes first: it is the most useful error for another gauge's file.
        let chip = lines.next().and_then(|line| line.strip_prefix("chip ")).ok_or("it names no chip")?;
        if chip != self.chip {
            return Err(format!("it is one of a {chip}"));
        }
        let (body, sum) = text.rsplit_once("sum ").ok_or("its end is missing")?;
        if sum.strip_suffix('\n') != Some(&sum_of(body)) {
            return Err("its sum is wrong: it is truncated or was changed".into());
        }
        let mut new = Flash { itpor: false, inverted: false, ..flash.clone() };
        let mut seen = 0;
        for line in body.lines().skip(2) {
            let words: Vec<&str> = line.split(' ').collect();
            match words[..] {
                ["protocol", "i2c"] => new.hdq = false,
                ["protocol", "hdq"] => new.hdq = true,
                ["itpor"] => new.itpor = true,
                ["cc-gain", "inverted"] => new.inverted = true,
                ["instruction", row, digits] => {
                    let bytes = from_hex(digits).and_then(|bytes| bytes.try_into().ok());
                    let rows = new.firmware.as_mut().map(Firmware::rows_mut);
                    let place = rows.and_then(|rows| rows.get_mut(row.parse::<usize>().ok()?));
                    match (place, bytes) {
                        (Some(place), Some(bytes)) => *place = bytes,
                        _ => {
                            return Err(
                                "it holds a row of instruction flash that the part does not have".into()
                            );
                        }
                    }
                }
                ["rest", digits] => match (from_hex(digits), &mut new.firmware) {
                    (Some(bytes), Some(firmware)) if bytes.len() == DATA => firmware.rest = bytes.into(),
                    _ => return Err("it holds data flash that the part does not have".into()),
                },
                ["wear", area, ref counts @ ..] => {
                    let area = area.parse().ok().and_then(|id| new.area_mut(id));
                    let area = area.ok_or_else(|| format!("it holds an unknown line `{line}`"))?;
                    let counts: Result<Vec<u32>, _> = counts.iter().map(|count| count.parse()).collect();
                    match counts {
                        Ok(counts) if counts.len() == area.wear.len() => area.wear = counts,
                        _ => return Err(format!("area {} has another number of blocks", area.id)),
                    }
                }
                ["flash", area, digits] => {
                    let area = area.parse().ok().and_then(|id| new.area_mut(id));
                    let area = area.ok_or("it holds an area that the part does not have")?;
                    match from_hex(digits) {
                        Some(bytes) if bytes.len() == area.bytes.len() => area.bytes = bytes,
                        _ => return Err(format!("area {} does not have the part's length", area.id)),
                    }
                    seen += 1;
                }
                _ => return Err(format!("it holds an unknown line `{line}`")),
            }
        }
        if seen != new.areas.len() {
            return Err("areas are missing".into());
        }
        *flash = new;
        Ok(())
    }

    /// Saves `flash`, if there is a file. A process killed at any moment leaves the old content or the new.
    pub(super) fn save(&mut self, flash: &Flash) -> Result<()> {
        let Some(path) = &self.path else { return Ok(()) };
        let result =
            // Flash holds the keys, so only the owner may read the file.
            regular::replace(path, self.print(flash).as_bytes(), Replace::Private).map_err(|error| host(path, &error, "cannot be written"));
        self.failure = result.as_ref().err().map(ToString::to_string);
        result
    }

    fn print(&self, flash: &Flash) -> String {
        let mut out = format!("{HEAD}\nchip {}\n", self.chip);
        out.push_str(if flash.hdq { "protocol hdq\n" } else { "protocol i2c\n" });
        if flash.itpor {
            out.push_str("itpor\n");
        }
        if flash.inverted {
            out.push_str("cc-gain inverted\n");
        }
        for (row, bytes) in flash.firmware.iter().flat_map(Firmware::changed) {
            let _ = writeln!(out, "instruction {row} {}", hex(bytes));
        }
        if let Some(firmware) =
            flash.firmware.as_ref().filter(|firmware| firmware.rest.iter().any(|byte| *byte != 0xFF))
        {
            let _ = writeln!(out, "rest {}", hex(&firmware.rest));
        }
        for area in &flash.areas {
            let _ = write!(out, "wear {}", area.id);
            for count in &area.wear {
                let _ = write!(out, " {count}");
            }
            let _ = writeln!(out, "\nflash {} {}", area.id, hex(&area.bytes));
        }
        let sum = sum_of(&out);
        let _ = writeln!(out, "sum {sum}");
        out
    }
}

/// Longer than the state of any part.
const LONGEST: u64 = 4 << 20;
const HEAD: &str = "gaugefs simulated gauge 1";

fn host(path: &Path, error: &io::Error, what: &str) -> Error {
    Error::file(path.display().to_string(), &format!("the simulated gauge's state {what}"), error)
}

fn sum_of(text: &str) -> String {
    hex(&Sha1::digest(text.as_bytes()))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn from_hex(text: &str) -> Option<Vec<u8>> {
    if !text.len().is_multiple_of(2) || !text.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return None;
    }
    (0..text.len()).step_by(2).map(|at| u8::from_str_radix(&text[at..at + 2], 16).ok()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    static IMAGE: Image = &[(2, &[1, 2, 3]), (48, &[7; 40])];

    #[test]
    fn blocks_end_where_the_area_ends() {
        let mut flash = Flash::new(IMAGE);
        assert_eq!(flash.block(48, 1), [7; 8]);
        assert_eq!(flash.block(48, 2), []);
        assert_eq!(flash.block(3, 0), []);
        flash.program(48, 32, &[9; 32]);
        assert_eq!(flash.block(48, 1), [9; 8]);
        assert_eq!(flash.block(48, 0), [7; 32]);
        assert_eq!((flash.wear().as_str(), flash.programmed()), ("48/1 1", 1));
    }

    #[test]
    fn printed_state_reads_back() {
        let store = Store::new(Some("x".into()), "part");
        let mut flash = Flash::new(IMAGE);
        flash.program(48, 32, &[0xA5; 8]);
        flash.hdq = true;
        let text = store.print(&flash);
        let mut back = Flash::new(IMAGE);
        store.parse(&text, &mut back).unwrap();
        assert_eq!((back.bytes(), back.wear(), back.hdq), (flash.bytes(), flash.wear(), true));
    }

    #[test]
    fn all_damage_is_detected() {
        let store = Store::new(Some("x".into()), "part");
        let text = store.print(&Flash::new(IMAGE));
        for end in 0..text.len() {
            let mut flash = Flash::new(IMAGE);
            assert!(store.parse(&text[..end], &mut flash).is_err(), "cut at {end}");
        }
        for at in 0..text.len() {
            let mut bytes = text.clone().into_bytes();
            bytes[at] ^= 1;
            let Ok(changed) = String::from_utf8(bytes) else { continue };
            let mut flash = Flash::new(IMAGE);
            assert!(store.parse(&changed, &mut flash).is_err(), "changed at {at}");
        }
    }
}
