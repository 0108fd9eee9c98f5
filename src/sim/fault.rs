//! Faults: what can go wrong with the Nth transfer from now, and a [`Bus`] that makes it so.
//!
//! [`FaultBus`] wraps any bus. The simulated gauge uses the same texts for its `fault` file and knows a
//! few more, which happen inside the gauge and which no wrapper could bring about.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::bus::{Bus, BusError};
use crate::error::{Cause, Error, Result};

/// What happens on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wire {
    /// The address, or the given byte after the register, is not acknowledged; what came before it has
    /// reached the target.
    Nack(Option<usize>),
    /// A bit of a byte is wrong: bytes written first, then bytes read.
    Flip(usize, u8),
    /// The adapter moves only a part: all but the last byte written, or no byte read.
    Short,
    /// The transfer has its effect and its acknowledgement is lost.
    Lost,
    /// A line is held after that many bytes written, until the adapter gives up.
    Stuck(usize),
    /// Another controller wins the bus.
    Arbitration,
    /// The clock is stretched for so many milliseconds.
    Stretch(u64),
}

/// What happens inside the gauge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inside {
    /// The next commit is acknowledged and not stored.
    DropCommit,
    /// The next commit is stored with one wrong bit.
    CorruptCommit,
    /// Power is lost when so many 16-bit words of the next commit are programmed.
    TornCommit(usize),
    /// Power is lost before the transfer, for so many milliseconds or until it is switched on.
    PowerCut(Option<u64>),
    /// Power is lost right after the transfer.
    PowerCutAfter(Option<u64>),
}

/// One of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// On the wire.
    Wire(Wire),
    /// In the gauge.
    Inside(Inside),
}

#[derive(Clone, Copy, Debug)]
struct Armed {
    /// Transfers until it acts, this one included; 0 for those that wait for a commit.
    count: u64,
    fault: Fault,
}

/// The faults that are still to come.
#[derive(Clone, Debug)]
pub struct Plan {
    armed: Vec<Armed>,
    /// Chance of a random fault for each transfer, in thousandths.
    permille: u32,
    random: u64,
}

/// How a line of the plan is written.
pub const SYNTAX: &str = "none, nack N [BYTE], flip N BYTE BIT, short N, lost N, stuck N [BYTE], \
     arbitration N, stretch N MS, power-cut N [MS], power-cut-after N [MS], drop-commit, corrupt-commit, \
     torn-commit WORDS, random PERMILLE; several with `;` between";

impl Plan {
    /// No faults; `seed` is for the random ones.
    pub fn new(seed: u64) -> Self {
        // An odd multiplier keeps seeds apart, and the generator must not start at 0.
        Self { armed: Vec::new(), permille: 0, random: seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1 }
    }

    /// Replaces the faults by those of a text (see [`SYNTAX`]); a bad one changes nothing.
    pub fn set(&mut self, text: &str) -> Result<()> {
        let mut new = Self { armed: Vec::new(), permille: 0, random: self.random };
        for part in text.split(';') {
            let words: Vec<&str> = part.split_whitespace().collect();
            let Some((name, numbers)) = words.split_first() else { continue };
            let numbers: Option<Vec<u64>> = numbers.iter().map(|word| word.parse().ok()).collect();
            new.add(name, &numbers.ok_or_else(|| bad(part))?).ok_or_else(|| bad(part))?;
        }
        *self = new;
        Ok(())
    }

    fn add(&mut self, name: &str, numbers: &[u64]) -> Option<()> {
        use Fault::{Inside as I, Wire as W};
        let (count, fault) = match (name, numbers) {
            ("none", []) => {
                (self.armed, self.permille) = (Vec::new(), 0);
                return Some(());
            }
            ("random", &[permille]) if permille <= 1000 => {
                self.permille = permille as u32;
                return Some(());
            }
            ("nack", &[n]) => (n, W(Wire::Nack(None))),
            ("nack", &[n, byte]) => (n, W(Wire::Nack(Some(byte as usize)))),
            ("flip", &[n, byte, bit]) if bit < 8 => (n, W(Wire::Flip(byte as usize, bit as u8))),
            ("short", &[n]) => (n, W(Wire::Short)),
            ("lost", &[n]) => (n, W(Wire::Lost)),
            ("stuck", &[n]) => (n, W(Wire::Stuck(0))),
            ("stuck", &[n, byte]) => (n, W(Wire::Stuck(byte as usize))),
            ("arbitration", &[n]) => (n, W(Wire::Arbitration)),
            ("stretch", &[n, ms]) => (n, W(Wire::Stretch(ms))),
            ("power-cut", &[n]) => (n, I(Inside::PowerCut(None))),
            ("power-cut", &[n, ms]) => (n, I(Inside::PowerCut(Some(ms)))),
            ("power-cut-after", &[n]) => (n, I(Inside::PowerCutAfter(None))),
            ("power-cut-after", &[n, ms]) => (n, I(Inside::PowerCutAfter(Some(ms)))),
            ("drop-commit", []) => (0, I(Inside::DropCommit)),
            ("corrupt-commit", []) => (0, I(Inside::CorruptCommit)),
            ("torn-commit", &[words]) => (0, I(Inside::TornCommit(words as usize))),
            _ => return None,
        };
        if count == 0 && !name.ends_with("-commit") {
            return None;
        }
        self.armed.push(Armed { count, fault });
        Some(())
    }

    /// Counts a transfer of so many bytes; the fault that is due with it, if any.
    pub fn next(&mut self, bytes: usize) -> Option<Fault> {
        for armed in &mut self.armed {
            armed.count = armed.count.saturating_sub(u64::from(armed.count > 0 && !armed.waits()));
        }
        let due = self.armed.iter().position(|armed| armed.count == 0 && !armed.waits());
        if let Some(at) = due {
            return Some(self.armed.remove(at).fault);
        }
        if self.permille > 0 && self.roll(1000) < u64::from(self.permille) {
            let byte = self.roll(bytes.max(1) as u64) as usize;
            return Some(Fault::Wire(match self.roll(7) {
                0 => Wire::Nack(None),
                1 => Wire::Nack(Some(byte)),
                2 => Wire::Flip(byte, self.roll(8) as u8),
                3 => Wire::Short,
                4 => Wire::Lost,
                5 => Wire::Stuck(byte),
                _ => Wire::Arbitration,
            }));
        }
        None
    }

    /// Takes the fault that waits for a commit.
    pub(super) fn commit(&mut self) -> Option<Inside> {
        let at = self.armed.iter().position(Armed::waits)?;
        match self.armed.remove(at).fault {
            Fault::Inside(inside) => Some(inside),
            Fault::Wire(_) => None,
        }
    }

    fn roll(&mut self, below: u64) -> u64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        self.random % below
    }
}

impl Armed {
    fn waits(&self) -> bool {
        use Inside::{CorruptCommit, DropCommit, TornCommit};
        matches!(self.fault, Fault::Inside(DropCommit | CorruptCommit | TornCommit(_)))
    }
}

fn bad(part: &str) -> Error {
    Error::new("fault", Cause::Invalid(format!("`{}` is none of: {SYNTAX}", part.trim())))
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.armed.is_empty() && self.permille == 0 {
            return f.write_str("none");
        }
        let mut separator = "";
        for Armed { count: n, fault } in &self.armed {
            f.write_str(separator)?;
            separator = "; ";
            match fault {
                Fault::Wire(Wire::Nack(None)) => write!(f, "nack {n}"),
                Fault::Wire(Wire::Nack(Some(byte))) => write!(f, "nack {n} {byte}"),
                Fault::Wire(Wire::Flip(byte, bit)) => write!(f, "flip {n} {byte} {bit}"),
                Fault::Wire(Wire::Short) => write!(f, "short {n}"),
                Fault::Wire(Wire::Lost) => write!(f, "lost {n}"),
                Fault::Wire(Wire::Stuck(byte)) => write!(f, "stuck {n} {byte}"),
                Fault::Wire(Wire::Arbitration) => write!(f, "arbitration {n}"),
                Fault::Wire(Wire::Stretch(ms)) => write!(f, "stretch {n} {ms}"),
                Fault::Inside(Inside::DropCommit) => f.write_str("drop-commit"),
                Fault::Inside(Inside::CorruptCommit) => f.write_str("corrupt-commit"),
                Fault::Inside(Inside::TornCommit(words)) => write!(f, "torn-commit {words}"),
                Fault::Inside(Inside::PowerCut(None)) => write!(f, "power-cut {n}"),
                Fault::Inside(Inside::PowerCut(Some(ms))) => write!(f, "power-cut {n} {ms}"),
                Fault::Inside(Inside::PowerCutAfter(None)) => write!(f, "power-cut-after {n}"),
                Fault::Inside(Inside::PowerCutAfter(Some(ms))) => write!(f, "power-cut-after {n} {ms}"),
            }?;
        }
        if self.permille > 0 { write!(f, "{separator}random {}", self.permille) } else { Ok(()) }
    }
}

/// How long an adapter waits for a clock that is held low.
pub(super) const ADAPTER_WAITS: Duration = Duration::from_secs(1);

impl Wire {
    /// Performs a transfer on `bus` with this fault. Time that a stretched or stuck bus takes is the
    /// caller's affair.
    pub fn perform(self, bus: &mut dyn Bus, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        match self {
            Wire::Nack(None) => Err(BusError::NoAck),
            Wire::Nack(Some(byte)) => {
                part(bus, write, byte.saturating_add(1))?;
                Err(BusError::NoAck)
            }
            Wire::Flip(byte, bit) => {
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
            Wire::Short => {
                let cut = if read.is_empty() { write.len().saturating_sub(1) } else { write.len() };
                part(bus, write, cut)?;
                Err(BusError::Short)
            }
            Wire::Lost => {
                // The target has sent its bytes, but none of them may be of use to the host.
                let mut lost = vec![0; read.len()];
                bus.transfer(write, &mut lost)?;
                Err(BusError::NoAck)
            }
            Wire::Stuck(byte) => {
                part(bus, write, byte)?;
                Err(BusError::Timeout)
            }
            Wire::Arbitration => Err(BusError::ArbitrationLost),
            Wire::Stretch(ms) if Duration::from_millis(ms) > ADAPTER_WAITS => Err(BusError::Timeout),
            Wire::Stretch(_) => bus.transfer(write, read),
        }
    }
}

fn part(bus: &mut dyn Bus, write: &[u8], count: usize) -> Result<(), BusError> {
    match write.get(..count.min(write.len())) {
        Some(some) if !some.is_empty() => bus.transfer(some, &mut []),
        _ => Ok(()),
    }
}

/// A bus whose transfers go wrong as planned.
#[derive(Debug)]
pub struct FaultBus<B> {
    inner: B,
    plan: Arc<Mutex<Plan>>,
}

impl<B: Bus> FaultBus<B> {
    /// Wraps `inner`. The plan may be changed while the bus is in use; what it says about the inside of
    /// a gauge is left out here.
    pub fn new(inner: B, plan: Arc<Mutex<Plan>>) -> Self {
        Self { inner, plan }
    }
}

impl<B: Bus> Bus for FaultBus<B> {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        let due = {
            let mut plan = self.plan.lock().unwrap_or_else(PoisonError::into_inner);
            plan.next(write.len() + read.len())
        };
        match due {
            Some(Fault::Wire(wire)) => wire.perform(&mut self.inner, write, read),
            Some(Fault::Inside(_)) | None => self.inner.transfer(write, read),
        }
    }

    fn set_secret(&mut self, secret: bool) {
        self.inner.set_secret(secret);
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

    type Heard = (Result<(), BusError>, Vec<Vec<u8>>, [u8; 2]);

    fn run(text: &str, write: &[u8]) -> Heard {
        let mut plan = Plan::new(1);
        plan.set(text).unwrap();
        let mut bus = FaultBus::new(Echo(Vec::new()), Arc::new(Mutex::new(plan)));
        let mut read = [0; 2];
        let result = bus.transfer(write, &mut read);
        (result, bus.inner.0, read)
    }

    #[test]
    fn each_fault_does_what_it_says() {
        let write = [0x40, 1, 2];
        assert_eq!(run("nack 1", &write), (Err(BusError::NoAck), vec![], [0; 2]));
        assert_eq!(run("nack 1 1", &write), (Err(BusError::NoAck), vec![vec![0x40, 1]], [0; 2]));
        assert_eq!(run("flip 1 2 0", &write), (Ok(()), vec![vec![0x40, 1, 3]], [0xA0; 2]));
        assert_eq!(run("flip 1 4 0", &write), (Ok(()), vec![vec![0x40, 1, 2]], [0xA0, 0xA1]));
        assert_eq!(run("short 1", &write), (Err(BusError::Short), vec![vec![0x40, 1, 2]], [0; 2]));
        assert_eq!(run("lost 1", &write), (Err(BusError::NoAck), vec![vec![0x40, 1, 2]], [0; 2]));
        assert_eq!(run("stuck 1", &write), (Err(BusError::Timeout), vec![], [0; 2]));
        assert_eq!(run("stuck 1 2", &write), (Err(BusError::Timeout), vec![vec![0x40, 1]], [0; 2]));
        assert_eq!(run("arbitration 1", &write), (Err(BusError::ArbitrationLost), vec![], [0; 2]));
        assert_eq!(run("nack 2", &write), (Ok(()), vec![vec![0x40, 1, 2]], [0xA0; 2]));
    }

    #[test]
    fn only_the_nth_transfer_fails_and_only_once() {
        let mut plan = Plan::new(1);
        plan.set("nack 2; lost 2; short 5").unwrap();
        let due: Vec<_> = (0..7).map(|_| plan.next(3).is_some()).collect();
        assert_eq!(due, [false, true, true, false, true, false, false]);
        assert_eq!(plan.to_string(), "none");
    }

    #[test]
    fn texts_read_back() {
        let mut plan = Plan::new(1);
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
        ] {
            plan.set(text).unwrap();
            assert_eq!(plan.to_string(), text);
        }
    }

    #[test]
    fn a_bad_text_changes_nothing() {
        let mut plan = Plan::new(1);
        plan.set("nack 3").unwrap();
        for text in ["nack", "nack 0", "nack x", "flip 1 2 8", "fail", "lost 1; bad", "random 1001", "none 1"]
        {
            assert!(plan.set(text).is_err(), "{text}");
            assert_eq!(plan.to_string(), "nack 3");
        }
    }

    #[test]
    fn random_faults_repeat_with_their_seed() {
        let draw = |seed| {
            let mut plan = Plan::new(seed);
            plan.set("random 100").unwrap();
            (0..1000).map(|_| plan.next(8)).collect::<Vec<_>>()
        };
        assert_eq!(draw(7), draw(7));
        assert_ne!(draw(7), draw(8));
        let faults = draw(7).iter().flatten().count();
        assert!((50..200).contains(&faults), "{faults}");
    }
}
