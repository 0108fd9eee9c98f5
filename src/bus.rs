//! The bus: one trait, one method, one START...STOP transfer.
//!
//! A [`Bus`] speaks to one 7-bit address. What stands behind it is a real adapter (`linux`), a
//! simulated gauge (`crate::sim`), a recorded one (`replay`), or a wrapper around another `Bus` (`trace`).

use std::fmt;

use nix::errno::Errno;

pub mod linux;
pub mod replay;
pub mod trace;

/// The address of every gauge in the tables; the parts allow no other.
pub const GAUGE_ADDRESS: u8 = 0x55;

/// Why a transfer failed, in the words of the kernel's I2C fault codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusError {
    /// The address or a byte after it was not acknowledged.
    NoAck,
    /// Another controller won the bus.
    ArbitrationLost,
    /// The target held the clock for longer than the adapter waits.
    Timeout,
    /// The adapter moved only a part of the messages.
    Short,
    /// The adapter is gone.
    Gone,
    /// A kernel driver is bound to the address.
    Busy,
    /// Any other errno of the adapter's.
    Other(Errno),
}

impl BusError {
    /// The errno that a file operation answers with.
    pub fn errno(self) -> Errno {
        match self {
            BusError::NoAck => Errno::ENXIO,
            BusError::ArbitrationLost => Errno::EAGAIN,
            BusError::Timeout => Errno::ETIMEDOUT,
            BusError::Short => Errno::EPROTO,
            BusError::Gone => Errno::ENODEV,
            BusError::Busy => Errno::EBUSY,
            BusError::Other(errno) => errno,
        }
    }
}

impl BusError {
    /// The error that prints so; what is not known by its text is any other of the adapter's.
    pub fn by_text(text: &str) -> Self {
        let known = [
            BusError::NoAck,
            BusError::ArbitrationLost,
            BusError::Timeout,
            BusError::Short,
            BusError::Gone,
            BusError::Busy,
        ];
        let found = known.into_iter().find(|error| error.to_string() == text);
        found.unwrap_or(BusError::Other(Errno::EIO))
    }
}

impl fmt::Display for BusError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            BusError::NoAck => f.write_str("not acknowledged; is the gauge powered and connected?"),
            BusError::ArbitrationLost => {
                f.write_str("arbitration lost again and again; another controller uses the bus")
            }
            BusError::Timeout => {
                f.write_str("the bus timed out; a line is held low or the clock stretched too long")
            }
            BusError::Short => f.write_str("the adapter moved only a part of the transfer"),
            BusError::Gone => f.write_str("the adapter is gone"),
            BusError::Busy => f.write_str("a kernel driver is bound to the address; unbind it first"),
            BusError::Other(errno) => write!(f, "the adapter answered {errno}"),
        }
    }
}

impl std::error::Error for BusError {}

/// A way to one target address.
pub trait Bus: Send {
    /// One transfer: START, `write` to the target, then, where `read` is not empty, a repeated START
    /// and `read.len()` bytes back, STOP. With nothing to write it reads from where the target's
    /// pointer stands; with nothing to do at all it only asks for the address's acknowledgement.
    ///
    /// An error may leave the transfer's effect on the target unknown.
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError>;

    /// Makes sure that no kernel driver is bound to the address. No transfer is needed for it.
    fn claim(&mut self) -> Result<(), BusError> {
        Ok(())
    }

    /// Lets go of an adapter that has gone. No transfer is needed for it.
    fn look(&mut self) {}

    /// From now on transfers carry keys or security data (`true`), or no longer do (`false`).
    /// Whatever records transfers must hide those in between.
    fn hush(&mut self, _secret: bool) {}
}

impl<B: Bus + ?Sized> Bus for Box<B> {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        (**self).transfer(write, read)
    }

    fn claim(&mut self) -> Result<(), BusError> {
        (**self).claim()
    }

    fn look(&mut self) {
        (**self).look();
    }

    fn hush(&mut self, secret: bool) {
        (**self).hush(secret);
    }
}

/// Bytes on the wire for a transfer: the address byte of each direction, and the data.
pub fn wire_bytes(write: usize, read: usize) -> u64 {
    let messages = u64::from(write > 0 || read == 0) + u64::from(read > 0);
    messages + write as u64 + read as u64
}

/// Bit times of a transfer: nine a byte, and one for each START, repeated START and STOP.
pub fn wire_bits(write: usize, read: usize) -> u64 {
    let messages = u64::from(write > 0 || read == 0) + u64::from(read > 0);
    wire_bytes(write, read) * 9 + messages + 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_poll_costs_what_the_readme_says() {
        let poll = [(1, 18), (1, 4), (1, 12)];
        assert_eq!(poll.iter().map(|&(w, r)| wire_bytes(w, r)).sum::<u64>(), 43);
        assert_eq!(poll.iter().map(|&(w, r)| wire_bits(w, r)).sum::<u64>(), 396);
    }
}
