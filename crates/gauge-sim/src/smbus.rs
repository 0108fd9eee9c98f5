// SPDX-License-Identifier: MIT

//! A Smart Battery: words and blocks by command codes, which are no addresses, and PEC (Smart Battery Data 1.1, SMBus 1.1).
//!
//! It does what packs do to a reader: a code that it does not have is the word before again or is not acknowledged, a
//! sealed ManufacturerAccess() takes every command, and after the end of an answer its last byte repeats.

use std::collections::BTreeMap;
use std::time::Duration;

use super::device::{Device, Gauge, Wire};
use super::flash::Flash;
use super::knob::{self, KnobChoice, KnobValue};
use super::model::Model;
use super::options::Options;
use super::part::{Part, SMART_BATTERY as ADDRESS, TiPart};
use super::seal::Level;
use gauge_bus::error::{Error, ErrorKind, Result};

mod mac;
mod pack;

use mac::Mac;
use pack::{BATTERY_MODE, Pack};

/// Silence after which a pack that sleeps does so, and how long it is not awake after the first message then.
const ASLEEP: Duration = Duration::from_secs(10);
const WAKING: Duration = Duration::from_secs(1);
/// Word 0x00 to 0x04 can be written.
const LAST_WRITABLE: u8 = 0x04;
const RESERVED: std::ops::RangeInclusive<u8> = 0x1D..=0x1F;

/// What follows an answer, if the host reads on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pec {
    /// The packet error code of SMBus, if SpecificationInfo() says so.
    Right,
    /// The last byte again, whatever SpecificationInfo() says.
    Missing,
    /// The code of the second message alone, as behind an adapter that puts a STOP between the two.
    Split,
}

impl KnobChoice for Pec {
    const WORDS: &'static [(&'static str, Self)] =
        &[("right", Pec::Right), ("missing", Pec::Missing), ("split", Pec::Split)];
}

/// Answers in place of the pack's own, by command code; `None` is no acknowledgement.
#[derive(Clone, Debug, Default)]
struct Answers {
    all: Option<Vec<u8>>,
    one: BTreeMap<u8, Option<Vec<u8>>>,
}

impl Answers {
    fn of(&self, code: u8) -> Option<Option<&Vec<u8>>> {
        self.one.get(&code).map(Option::as_ref).or_else(|| self.all.as_ref().map(Some))
    }

    fn parse(text: &str) -> Option<Self> {
        let mut new = Self::default();
        for word in text.split_whitespace().filter(|word| *word != "own") {
            let (code, bytes) = word.split_once('=')?;
            let bytes = if bytes == "-" { None } else { Some(hex(bytes)?) };
            match (code, bytes) {
                ("all", Some(bytes)) => new.all = Some(bytes),
                ("all", None) => return None,
                (code, bytes) => drop(new.one.insert(*hex(code)?.first_chunk::<1>()?.first()?, bytes)),
            }
        }
        Some(new)
    }
}

fn hex(text: &str) -> Option<Vec<u8>> {
    let is_hex =
        !text.is_empty() && text.len().is_multiple_of(2) && text.bytes().all(|byte| byte.is_ascii_hexdigit());
    let pairs = (0..text.len()).step_by(2).filter(|_| is_hex);
    let bytes: Option<Vec<u8>> = pairs.map(|at| u8::from_str_radix(&text[at..at + 2], 16).ok()).collect();
    bytes.filter(|bytes| !bytes.is_empty())
}

impl KnobValue for Answers {
    fn show(&self) -> String {
        let digits = |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
        let all = self.all.iter().map(|bytes| format!("all={}", digits(bytes)));
        let one = self.one.iter().map(|(code, bytes)| {
            format!("{code:02x}={}", bytes.as_ref().map_or_else(|| "-".into(), |bytes| digits(bytes)))
        });
        let shown: Vec<_> = all.chain(one).collect();
        if shown.is_empty() { "own".into() } else { shown.join(" ") }
    }

    fn turn(&mut self, name: &str, text: &str) -> Result<()> {
        let why = "no answers; write own, or codes and the bytes of their answers, such as 0d=6400 1b=-";
        *self = Self::parse(text).ok_or_else(|| Error::new(name, ErrorKind::Invalid, why))?;
        Ok(())
    }
}

pub(super) struct SmartBattery {
    pack: Pack,
    /// The gauge of TI's in it.
    mac: Option<Mac>,
    /// It has turned itself off, until power comes.
    is_off: bool,
    pec: Pec,
    answers: Answers,
    sleeps: bool,
    /// When the last message came, and since when it wakes up.
    heard: Duration,
    wakes: Option<Duration>,
    /// The word of the last read.
    last: [u8; 2],
    /// Messages that were more than a command and a read.
    written: u32,
}

impl SmartBattery {
    #[inline(never)] // A gauge as a value is large; those of all schemes are not to be on the stack together.
    pub(super) fn gauge(
        part: &'static Part,
        ti: Option<&'static TiPart>,
        options: &Options,
        now: Duration,
    ) -> Result<Gauge> {
        let device = Device::new(part, options, now, |_| {})?;
        let gauge = Self {
            pack: Pack::new(),
            mac: ti.map(Mac::new),
            is_off: false,
            pec: Pec::Right,
            answers: Answers::default(),
            sleeps: false,
            heard: now,
            wakes: None,
            last: [0; 2],
            written: 0,
        };
        Ok(Gauge::new(device, gauge, options.envelope))
    }

    /// Whether it acknowledges its address. A pack that sleeps is woken by it.
    fn is_awake(&mut self, now: Duration) -> bool {
        let silence = now.saturating_sub(self.heard);
        self.heard = now;
        if self.sleeps && silence >= ASLEEP {
            self.wakes = Some(now);
        }
        self.wakes.is_none_or(|since| now >= since + WAKING)
    }

    /// The bytes of an answer without PEC; `None` if the code is not acknowledged.
    fn answer(&mut self, code: u8) -> Option<Vec<u8>> {
        if let Some(given) = self.answers.of(code) {
            return given.cloned();
        }
        if let Some(mac) = &mut self.mac {
            match code {
                0x21 => {
                    let name = mac.device_name().as_bytes();
                    return Some([&[name.len() as u8], name].concat());
                }
                // CellVoltage15() to 5() (SLUUBD3D 17.2).
                0x31..=0x3B if mac.has_15_cells() => {
                    return Some(self.pack.cell_mv(0x40 - code).to_le_bytes().to_vec());
                }
                code if mac.answers_at(code) => return mac.told(code),
                0x23 | 0x44 => return None,
                0x00 => return Some((mac.status() as u16).to_le_bytes().to_vec()),
                _ => {}
            }
        }
        if RESERVED.contains(&code) {
            return Some(self.last.to_vec());
        }
        match self.pack.word(code) {
            Some(word) => Some(word.to_le_bytes().to_vec()),
            None => self.pack.block(code).map(|text| [&[text.len() as u8], &*text].concat()),
        }
    }

    fn read(&mut self, code: u8, into: &mut [u8]) -> Option<()> {
        let mut bytes = self.answer(code)?;
        if let Some(word) = bytes.first_chunk() {
            self.last = *word;
        }
        let [to, from] = [ADDRESS << 1, ADDRESS << 1 | 1];
        match self.pec {
            Pec::Right if self.pack.says_pec() => {
                let all = [&[to, code, from], &*bytes].concat();
                bytes.push(crc(&all));
            }
            Pec::Split => bytes.push(crc(&[&[from], &*bytes].concat())),
            Pec::Right | Pec::Missing => {}
        }
        let last = *bytes.last()?;
        into.iter_mut()
            .zip(bytes.into_iter().chain(std::iter::repeat(last)))
            .for_each(|(to, from)| *to = from);
        Some(())
    }

    /// Takes a word, with its PEC or without one.
    fn write(&mut self, code: u8, data: &[u8], now: Duration) -> std::result::Result<(), usize> {
        self.written += 1;
        if let (Some(mac), 0x44, [2, low, high, rest @ ..]) = (&mut self.mac, code, data)
            && mac.answers_at(0x44)
        {
            return match rest {
                [] => {
                    self.is_off = mac.command(u16::from_le_bytes([*low, *high]), &self.pack, now);
                    Ok(())
                }
                [pec] if *pec == crc(&[ADDRESS << 1, code, 2, *low, *high]) => {
                    self.is_off = mac.command(u16::from_le_bytes([*low, *high]), &self.pack, now);
                    Ok(())
                }
                _ => Err(5),
            };
        }
        let &[low, high, ref rest @ ..] = data else { return Err(1 + data.len()) };
        let sum = crc(&[ADDRESS << 1, code, low, high]);
        match rest {
            _ if code > LAST_WRITABLE => return Err(2),
            [] => {}
            [pec] if *pec == sum => {}
            _ => return Err(4),
        }
        let word = u16::from_le_bytes([low, high]);
        match &mut self.mac {
            Some(mac) if code == 0x00 => self.is_off = mac.command(word, &self.pack, now),
            _ => self.pack.set(code, word),
        }
        Ok(())
    }
}

/// CRC-8 of SMBus: x^8 + x^2 + x + 1, from 0.
pub(super) fn crc(bytes: &[u8]) -> u8 {
    let shift = |crc: u8| if crc & 0x80 == 0 { crc << 1 } else { crc << 1 ^ 0x07 };
    bytes.iter().fold(0, |crc, byte| (0..8).fold(crc ^ byte, |crc, _| shift(crc)))
}

impl Wire for SmartBattery {
    fn address(&self, _: &Flash) -> Option<u8> {
        Some(ADDRESS)
    }

    fn packet(
        &mut self,
        device: &Device,
        write: &[u8],
        read: &mut [u8],
    ) -> Option<std::result::Result<(), usize>> {
        Some(match write {
            _ if self.is_off || !self.is_awake(device.now) => Err(0),
            [code] if !read.is_empty() => self.read(*code, read).ok_or(1),
            [] => {
                read.fill(0xFF);
                Ok(())
            }
            [code, data @ ..] => self.write(*code, data, device.now),
        })
    }

    fn has(&self, _: u8) -> bool {
        false
    }

    fn extends(&self, _: u8) -> bool {
        false
    }

    fn write(&mut self, _: &mut Device, _: u8, _: u8) -> bool {
        false
    }

    fn read(&mut self, _: &Device, _: u8) -> u8 {
        0xFF
    }

    fn versions(&mut self, _: &Flash) -> [Option<u16>; 2] {
        [None; 2]
    }

    fn reset(&mut self, _: &mut Device) {
        self.pack.set(BATTERY_MODE, 0);
        self.is_off = false;
    }

    fn run(&mut self, device: &mut Device, settle: bool) {
        device.pass(self, settle);
    }

    fn refresh(&mut self) {}

    fn model(&mut self) -> &mut dyn Model {
        &mut self.pack
    }

    fn set_level(&mut self, _: &mut Device, _: Level) -> Result<()> {
        Err(Error::new("seal", ErrorKind::NotPermitted, "a Smart Battery is only read"))
    }

    fn knob(&self, _: &Device, name: &str) -> Option<String> {
        Some(match name {
            "series" => self.pack.battery().cells.to_string(),
            "specification" => Some(self.pack.specification).show(),
            "battery_mode" => Some(self.pack.mode()).show(),
            "pec" => self.pec.show(),
            "answers" => self.answers.show(),
            "sleeps" => self.sleeps.show(),
            "failed" => self.pack.has_failed.show(),
            "written" => self.written.to_string(),
            name => return self.mac.as_ref()?.knob(name),
        })
    }

    fn set_knob(&mut self, _: &mut Device, name: &str, text: &str) -> Result<()> {
        let word = |text| {
            let mut word = None;
            word.turn(name, text)?;
            word.ok_or_else(|| Error::new(name, ErrorKind::Invalid, "not a word; write one such as 0x0031"))
        };
        if let Some(mac) = &mut self.mac
            && let Some(turned) = mac.turn(name, text)
        {
            self.pack.has_failed = mac.has_failed();
            return turned;
        }
        match name {
            "series" => self.pack.set_series(knob::number(name, text, 1.0, 16.0)?.round()),
            "specification" => self.pack.specification = word(text)?,
            "battery_mode" => self.pack.set(BATTERY_MODE, word(text)?),
            "pec" => self.pec.turn(name, text)?,
            "sleeps" => self.sleeps.turn(name, text)?,
            "failed" if self.pack.has_failed && text != "on" => {
                let why = "it has failed for good; put another pack in its place";
                return Err(Error::new(name, ErrorKind::NotPermitted, why));
            }
            "failed" => {
                self.pack.has_failed.turn(name, text)?;
                if let (Some(mac), true) = (&mut self.mac, self.pack.has_failed) {
                    mac.fail();
                }
            }
            _ => self.answers.turn(name, text)?,
        }
        Ok(())
    }
}
