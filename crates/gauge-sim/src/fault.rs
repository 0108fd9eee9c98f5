// SPDX-License-Identifier: MIT

//! Faults: what goes wrong with the nth transfer from now, or with the gauge's next commit.

use std::fmt;
use std::time::Duration;

use super::envelope::{Lost, NackAs};
use super::random::Random;
use gauge_bus::error::{Error, ErrorKind, Result};
use gauge_bus::{Bus, BusError};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Transfer {
    /// The address, or the given byte after the register, is not acknowledged. The bytes before it have arrived.
    Nack(Option<usize>, NackAs),
    /// One bit of one byte is wrong. Bytes written come first, then bytes read.
    Flip(usize, u8),
    /// From a byte on, so many bytes read have this value.
    Burst(usize, usize, u8),
    /// The adapter drops the last byte written, or all bytes read.
    Short,
    /// The transfer takes effect, but its acknowledgement is lost.
    Lost,
    /// A line stays low after so many bytes written, until the adapter gives up.
    Stuck(usize),
    Arbitration,
    /// The clock is held for so many milliseconds.
    Stretch(u64),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Commit {
    /// Acknowledged but not stored.
    Drop,
    /// Stored with one wrong bit.
    Corrupt,
    /// Power is lost after so many 16-bit words.
    Torn(usize),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    Transfer(Transfer),
    /// Power is lost before the transfer, for so many milliseconds or until it is switched on.
    PowerCut(Option<u64>),
    /// Power is lost right after the transfer.
    PowerCutAfter(Option<u64>),
    /// From the transfer on, nothing is acknowledged for so many milliseconds.
    Silence(u64),
    /// In the gauge's next commit.
    Commit(Commit),
    Lost(Lost),
}

#[derive(Clone, Debug)]
struct Armed {
    name: String,
    /// The first one counts down the transfers, this one included, unless the fault waits for a commit.
    numbers: Vec<u64>,
    fault: Fault,
}

#[derive(Clone, Debug)]
pub(super) struct Plan {
    armed: Vec<Armed>,
    /// Chance of a random fault per transfer, in thousandths.
    permille: u32,
    random: Random,
    /// Random faults are of all kinds.
    all: bool,
}

/// A word of a plan: the knob `fault` takes several, separated by `;`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FaultWord {
    /// The word.
    pub name: &'static str,
    /// The numbers after it.
    pub numbers: &'static str,
    /// Describes the fault.
    pub help: &'static str,
}

const fn word(name: &'static str, numbers: &'static str, help: &'static str) -> FaultWord {
    FaultWord { name, numbers, help }
}

/// Every fault. N counts transfers: 1 is the next one.
pub static FAULTS: &[FaultWord] = &[
    word("none", "", "no faults; those still to come are forgotten"),
    word(
        "nack",
        "N [BYTE]",
        "the address is not acknowledged, or byte BYTE after the register; the first one is 0, and those before it arrive",
    ),
    word("eio", "N [BYTE]", "the same, and the adapter reports it as EIO"),
    word("etimedout", "N [BYTE]", "the same, reported as ETIMEDOUT"),
    word("eagain", "N [BYTE]", "the same, reported as EAGAIN, as if another controller had won the bus"),
    word("flip", "N BYTE BIT", "bit BIT of byte BYTE is wrong; bytes written count first, the register is 0"),
    word("burst", "N BYTE COUNT VALUE", "COUNT bytes read, from byte BYTE on, are VALUE"),
    word("short", "N", "the last byte written does not arrive, or none is read"),
    word("lost", "N", "the transfer takes effect, and the host is told that it was not acknowledged"),
    word(
        "stuck",
        "N [BYTE]",
        "a line is held low for 1 s, after BYTE bytes were written or at the beginning",
    ),
    word("arbitration", "N", "another controller wins the bus"),
    word("stretch", "N MS", "the clock is held for that time; beyond 1 s the adapter gives up"),
    word("silence", "N MS", "from that transfer on, nothing is acknowledged for that time"),
    word(
        "power-cut",
        "N [MS]",
        "the gauge loses its power before the transfer, for that time or until `power` is set",
    ),
    word("power-cut-after", "N [MS]", "the same right after the transfer"),
    word("drop-commit", "", "the next commit is acknowledged and not stored"),
    word("corrupt-commit", "", "the next commit is stored with one wrong bit"),
    word(
        "torn-commit",
        "WORDS",
        "the gauge loses its power when so many 16-bit words of the next commit are stored",
    ),
    word("drop-reset", "", "the next RESET is ignored"),
    word("drop-seal", "", "the next SEAL is ignored"),
    word("drop-key", "", "the next right key is refused"),
    word("random", "PERMILLE", "each transfer has a fault with that chance in thousandths"),
];

impl fmt::Display for FaultWord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let gap = if self.numbers.is_empty() { "" } else { " " };
        write!(f, "{}{gap}{}", self.name, self.numbers)
    }
}

impl Plan {
    /// No faults. `seed` draws the random ones, from `all` kinds or from those that every adapter reports alike.
    pub(super) fn new(seed: u64, all: bool) -> Self {
        Self { armed: Vec::new(), permille: 0, random: Random::new(seed), all }
    }

    pub(super) fn seed(&mut self, seed: u64) {
        self.random = Random::new(seed);
    }

    /// Replaces the faults by those of a text (see [`FAULTS`]). A bad text changes nothing.
    pub(super) fn set(&mut self, text: &str) -> Result<()> {
        let mut new = Self { armed: Vec::new(), permille: 0, random: self.random.clone(), all: self.all };
        for part in text.split(';') {
            let words: Vec<&str> = part.split_whitespace().collect();
            let Some((name, numbers)) = words.split_first() else { continue };
            let numbers: Option<Vec<u64>> = numbers.iter().map(|word| word.parse().ok()).collect();
            numbers.and_then(|numbers| new.add(name, numbers)).ok_or_else(|| bad(part))?;
        }
        *self = new;
        Ok(())
    }

    fn add(&mut self, name: &str, numbers: Vec<u64>) -> Option<()> {
        FAULTS.iter().find(|word| word.name == name)?;
        let fault = match (name, &numbers[..]) {
            ("none", []) => {
                (self.armed, self.permille) = (Vec::new(), 0);
                return Some(());
            }
            ("random", &[permille @ ..=1000]) => {
                self.permille = permille as u32;
                return Some(());
            }
            ("nack" | "eio" | "etimedout" | "eagain", &[_, ref byte @ ..]) if byte.len() < 2 => {
                let error = match name {
                    "nack" => NackAs::Enxio,
                    "eio" => NackAs::Eio,
                    "etimedout" => NackAs::Etimedout,
                    _ => NackAs::Eagain,
                };
                Fault::Transfer(Transfer::Nack(byte.first().map(|&byte| byte as usize), error))
            }
            ("burst", &[_, byte, count, value @ ..=255]) => {
                Fault::Transfer(Transfer::Burst(byte as usize, count as usize, value as u8))
            }
            ("silence", &[_, ms]) => Fault::Silence(ms),
            ("drop-reset", []) => Fault::Lost(Lost::Reset),
            ("drop-seal", []) => Fault::Lost(Lost::Seal),
            ("drop-key", []) => Fault::Lost(Lost::Key),
            ("flip", &[_, byte, bit @ ..8]) => Fault::Transfer(Transfer::Flip(byte as usize, bit as u8)),
            ("short", [_]) => Fault::Transfer(Transfer::Short),
            ("lost", [_]) => Fault::Transfer(Transfer::Lost),
            ("stuck", &[n]) => return self.add(name, vec![n, 0]),
            ("stuck", &[_, byte]) => Fault::Transfer(Transfer::Stuck(byte as usize)),
            ("arbitration", [_]) => Fault::Transfer(Transfer::Arbitration),
            ("stretch", &[_, ms]) => Fault::Transfer(Transfer::Stretch(ms)),
            ("power-cut", [_]) => Fault::PowerCut(None),
            ("power-cut", &[_, ms]) => Fault::PowerCut(Some(ms)),
            ("power-cut-after", [_]) => Fault::PowerCutAfter(None),
            ("power-cut-after", &[_, ms]) => Fault::PowerCutAfter(Some(ms)),
            ("drop-commit", []) => Fault::Commit(Commit::Drop),
            ("corrupt-commit", []) => Fault::Commit(Commit::Corrupt),
            ("torn-commit", &[words]) => Fault::Commit(Commit::Torn(words as usize)),
            _ => return None,
        };
        let armed = Armed { name: name.into(), numbers, fault };
        if armed.due() {
            return None;
        }
        self.armed.push(armed);
        Some(())
    }

    /// Counts a transfer of `bytes` bytes. Returns the fault that is due with it.
    pub(super) fn next(&mut self, bytes: usize) -> Option<Fault> {
        for armed in self.armed.iter_mut().filter(|armed| !armed.waits()) {
            armed.numbers[0] = armed.numbers[0].saturating_sub(1);
        }
        if let Some(at) = self.armed.iter().position(Armed::due) {
            return Some(self.armed.remove(at).fault);
        }
        let random = &mut self.random;
        if self.permille > 0 && random.roll(1000) < u64::from(self.permille) {
            let byte = random.roll(bytes.max(1) as u64) as usize;
            return Some(Fault::Transfer(match random.roll(if self.all { 11 } else { 7 }) {
                0 => Transfer::Nack(None, NackAs::Enxio),
                1 => Transfer::Nack(Some(byte), NackAs::Enxio),
                2 => Transfer::Flip(byte, random.roll(8) as u8),
                3 => Transfer::Short,
                4 => Transfer::Lost,
                5 => Transfer::Stuck(byte),
                6 => Transfer::Arbitration,
                7 => {
                    let errors = [NackAs::Eio, NackAs::Etimedout, NackAs::Eagain];
                    Transfer::Nack(random.pick(&[None, Some(byte)]), random.pick(&errors))
                }
                8 | 9 => {
                    let count = random.within(1..=bytes.max(1) as u64) as usize;
                    Transfer::Burst(byte, count, random.pick(&[0x00, 0xFF]))
                }
                _ => return Some(Fault::Silence(random.within(1..=300))),
            }));
        }
        None
    }

    pub(super) fn commit(&mut self) -> Option<Commit> {
        let commits =
            |armed: &Armed| if let Fault::Commit(commit) = armed.fault { Some(commit) } else { None };
        let (at, commit) =
            self.armed.iter().enumerate().find_map(|(at, armed)| Some((at, commits(armed)?)))?;
        self.armed.remove(at);
        Some(commit)
    }

    pub(super) fn loses(&mut self, lost: Lost) -> bool {
        let at = self.armed.iter().position(|armed| armed.fault == Fault::Lost(lost));
        at.map(|at| self.armed.remove(at)).is_some()
    }
}

impl Armed {
    fn waits(&self) -> bool {
        matches!(self.fault, Fault::Commit(_) | Fault::Lost(_))
    }

    fn due(&self) -> bool {
        !self.waits() && self.numbers[0] == 0
    }
}

/// The error for a bad part of a plan. It does not repeat the text, which may be a key that somebody typed into the
/// wrong file.
fn bad(part: &str) -> Error {
    let name = part.split_whitespace().next().unwrap_or_default();
    let why = match FAULTS.iter().find(|word| word.name == name) {
        Some(word) => format!("not the numbers of this fault; write: {word}"),
        None => {
            let all: Vec<_> = FAULTS.iter().map(FaultWord::to_string).collect();
            format!("no such fault; write one of these, or several with `;` between: {}", all.join(", "))
        }
    };
    Error::new("fault", ErrorKind::Invalid, why)
}

impl fmt::Display for Armed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)?;
        self.numbers.iter().try_for_each(|number| write!(f, " {number}"))
    }
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut parts: Vec<String> = self.armed.iter().map(Armed::to_string).collect();
        if self.permille > 0 {
            parts.push(format!("random {}", self.permille));
        }
        if parts.is_empty() { f.write_str("none") } else { f.write_str(&parts.join("; ")) }
    }
}

pub(super) const ADAPTER_WAITS: Duration = Duration::from_secs(1);

impl Transfer {
    /// Performs a transfer on `bus` with this fault. The caller lets the time of a stretched or stuck bus pass.
    pub(super) fn perform(self, bus: &mut dyn Bus, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        match self {
            Transfer::Nack(None, error) => Err(error.error()),
            Transfer::Nack(Some(byte), error) => {
                part(bus, write, byte.saturating_add(1))?;
                Err(error.error())
            }
            Transfer::Burst(byte, count, value) => {
                bus.transfer(write, read)?;
                read.iter_mut().skip(byte).take(count).for_each(|byte| *byte = value);
                Ok(())
            }
            Transfer::Flip(byte, bit) => {
                let mut write = write.to_vec();
                if let Some(byte) = write.get_mut(byte) {
                    *byte ^= 1 << bit;
                }
                bus.transfer(&write, read)?;
                let target = byte.checked_sub(write.len()).and_then(|byte| read.get_mut(byte));
                if let Some(byte) = target {
                    *byte ^= 1 << bit;
                }
                Ok(())
            }
            Transfer::Short => {
                let cut = if read.is_empty() { write.len().saturating_sub(1) } else { write.len() };
                part(bus, write, cut)?;
                Err(BusError::Short)
            }
            Transfer::Lost => {
                // The target has sent its bytes, but the host must not get them.
                let mut lost = vec![0; read.len()];
                bus.transfer(write, &mut lost)?;
                Err(BusError::NoAck)
            }
            Transfer::Stuck(byte) => {
                part(bus, write, byte)?;
                Err(BusError::Timeout)
            }
            Transfer::Arbitration => Err(BusError::ArbitrationLost),
            // The caller has waited.
            Transfer::Stretch(_) => bus.transfer(write, read),
        }
    }
}

fn part(bus: &mut dyn Bus, write: &[u8], count: usize) -> Result<(), BusError> {
    match write.get(..count.min(write.len())) {
        Some(some) if !some.is_empty() => bus.transfer(some, &mut []),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Echo(Vec<Vec<u8>>);

    impl Bus for Echo {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
            self.0.push(write.to_vec());
            read.fill(0xA0);
            Ok(())
        }
    }

    /// The result, what reached the target, and what was read.
    type Outcome = (Result<(), BusError>, Vec<Vec<u8>>, [u8; 2]);

    fn run(text: &str, write: &[u8]) -> Outcome {
        let mut plan = Plan::new(1, false);
        plan.set(text).unwrap();
        let (mut bus, mut read) = (Echo(Vec::new()), [0; 2]);
        let result = match plan.next(write.len() + read.len()) {
            Some(Fault::Transfer(fault)) => fault.perform(&mut bus, write, &mut read),
            _ => bus.transfer(write, &mut read),
        };
        (result, bus.0, read)
    }

    #[test]
    fn each_fault_does_what_it_says() {
        let write = [0x40, 1, 2];
        assert_eq!(run("nack 1", &write), (Err(BusError::NoAck), vec![], [0; 2]));
        assert_eq!(run("nack 1 1", &write), (Err(BusError::NoAck), vec![vec![0x40, 1]], [0; 2]));
        assert_eq!(run("flip 1 2 0", &write), (Ok(()), vec![vec![0x40, 1, 3]], [0xA0; 2]));
        assert_eq!(run("flip 1 4 0", &write), (Ok(()), vec![vec![0x40, 1, 2]], [0xA0, 0xA1]));
        assert_eq!(run("eio 1", &write), (Err(BusError::Other(5)), vec![], [0; 2]));
        assert_eq!(run("etimedout 1 0", &write), (Err(BusError::Timeout), vec![vec![0x40]], [0; 2]));
        assert_eq!(run("eagain 1", &write), (Err(BusError::ArbitrationLost), vec![], [0; 2]));
        assert_eq!(run("burst 1 1 9 255", &write), (Ok(()), vec![write.to_vec()], [0xA0, 0xFF]));
        assert_eq!(run("short 1", &write), (Err(BusError::Short), vec![vec![0x40, 1, 2]], [0; 2]));
        assert_eq!(run("lost 1", &write), (Err(BusError::NoAck), vec![vec![0x40, 1, 2]], [0; 2]));
        assert_eq!(run("stuck 1", &write), (Err(BusError::Timeout), vec![], [0; 2]));
        assert_eq!(run("stuck 1 2", &write), (Err(BusError::Timeout), vec![vec![0x40, 1]], [0; 2]));
        assert_eq!(run("arbitration 1", &write), (Err(BusError::ArbitrationLost), vec![], [0; 2]));
        assert_eq!(run("nack 2", &write), (Ok(()), vec![vec![0x40, 1, 2]], [0xA0; 2]));
    }

    #[test]
    fn only_the_nth_transfer_fails_and_only_once() {
        let mut plan = Plan::new(1, false);
        plan.set("nack 2; lost 2; short 5").unwrap();
        let due: Vec<_> = (0..7).map(|_| plan.next(3).is_some()).collect();
        assert_eq!(due, [false, true, true, false, true, false, false]);
        assert_eq!(plan.to_string(), "none");
    }

    #[test]
    fn texts_read_back() {
        let mut plan = Plan::new(1, false);
        for text in [
            "none",
            "nack 3",
            "nack 3 1",
            "flip 1 2 7",
            "short 1; lost 2; stuck 3 4",
            "power-cut 2 500; power-cut-after 3",
            "drop-commit",
            "torn-commit 5; random 20",
            "stretch 1 25",
            "eio 1; etimedout 2 1; eagain 3",
            "burst 1 0 32 255; silence 2 300",
            "drop-reset; drop-seal; drop-key; drop-key",
        ] {
            plan.set(text).unwrap();
            assert_eq!(plan.to_string(), text);
        }
    }

    #[test]
    fn a_bad_text_changes_nothing() {
        let mut plan = Plan::new(1, false);
        plan.set("nack 3").unwrap();
        for text in ["nack", "nack 0", "nack x", "flip 1 2 8", "fail", "lost 1; bad", "random 1001", "none 1"]
        {
            assert!(plan.set(text).is_err(), "{text}");
            assert_eq!(plan.to_string(), "nack 3");
        }
    }

    #[test]
    fn commits_and_commands_wait_for_their_own() {
        let mut plan = Plan::new(1, false);
        plan.set("drop-seal; drop-commit").unwrap();
        assert!(!plan.loses(Lost::Reset));
        assert_eq!((plan.commit(), plan.commit()), (Some(Commit::Drop), None));
        assert!(plan.loses(Lost::Seal) && !plan.loses(Lost::Seal));
    }

    #[test]
    fn random_faults_repeat_with_their_seed() {
        let draw = |seed| {
            let mut plan = Plan::new(seed, false);
            plan.set("random 100").unwrap();
            (0..1000).map(|_| plan.next(8)).collect::<Vec<_>>()
        };
        assert_eq!(draw(7), draw(7));
        assert_ne!(draw(7), draw(8));
        let faults = draw(7).iter().flatten().count();
        assert!((50..200).contains(&faults), "{faults}");
    }
}
