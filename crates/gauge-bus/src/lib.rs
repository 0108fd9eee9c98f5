// SPDX-License-Identifier: MIT

//! One START...STOP transfer to one I2C target, on real adapters, recordings and other buses.
//!
//! A [`Bus`] addresses one target with a 7-bit address: a real adapter ([`linux`]), a recorded gauge ([`replay`]), any
//! `embedded-hal` I2C ([`hal`]), a simulated gauge (the crate `gauge-sim`), a recorder around another bus ([`trace`]), or
//! one that gives up on a driver that hangs ([`bounded`]). The layers above measure time with [`clock`].
//!
//! Of fuel gauges this crate knows the address only; [`replay`] is told which writes select the answer to a read.
//!
//! ```
//! use gauge_bus::{Bus, BusError};
//!
//! /// A target that answers every read with its register pointer.
//! struct Echo(u8);
//!
//! impl Bus for Echo {
//!     fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
//!         self.0 = *write.first().unwrap_or(&self.0);
//!         read.fill(self.0);
//!         Ok(())
//!     }
//! }
//!
//! let mut word = [0; 2];
//! Echo(0).transfer(&[0x08], &mut word)?;
//! assert_eq!(word, [0x08, 0x08]);
//! # Ok::<(), BusError>(())
//! ```
//!
//! # Features
//!
//! `linux`, on by default: adapters behind `/dev/i2c-N`, by the crates `i2cdev` and `nix`.

#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "tests read what they have made"))]

use std::borrow::Cow;
use std::time::Duration;
use std::{fmt, io};

use rustix::io::Errno;

pub mod adapters;
pub mod bounded;
pub mod clock;
pub mod error;
pub mod hal;
#[cfg(feature = "linux")]
pub mod linux;
mod reach;
pub mod regular;
pub mod replay;
pub mod trace;

pub use adapters::AdapterModel;
pub use error::{Error, ErrorKind};
pub use reach::Reach;

/// The address of all supported gauges; it cannot be changed.
pub const GAUGE_ADDRESS: u8 = 0x55;

/// The cause of a failed transfer, in the terms of the kernel's I2C fault codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusError {
    /// The address or a byte after it was not acknowledged.
    NoAck,
    /// Not acknowledged, or something else with that errno: an answer at the address or an effect is not excluded.
    MaybeNoAck(i32),
    /// Another controller won arbitration.
    ArbitrationLost,
    /// The target stretched the clock for longer than the adapter waits.
    Timeout,
    /// The adapter transferred only a part of the messages.
    Short,
    /// The adapter is gone.
    Gone,
    /// A kernel driver is bound to the address.
    Busy,
    /// The adapter has got a mux that keeps a channel connected: the gauge changes whenever somebody uses another channel.
    HasMux,
    /// Nothing may be written: the bus is a recording, or only the standard commands of the gauge are known.
    ReadOnly,
    /// The bus is a recording that has no answer to this transfer.
    NotRecorded,
    /// A transfer on the adapter of this number has not returned: its driver hangs.
    Hung(u64),
    /// It was not sent: the caller's limit of time is over ([`Bus::limit`]).
    TooSlow {
        /// The transfers within the limit.
        transfers: u32,
        /// Those that failed.
        failed: u32,
        /// The time that they and the pauses between them took, in milliseconds.
        milliseconds: u32,
        /// The limit, in milliseconds.
        limit: u32,
    },
    /// Not sent: a message has more bytes than the bus carries in one.
    TooLong {
        /// The bytes of the message.
        bytes: u16,
        /// The most that the bus carries.
        most: u16,
    },
    /// What belongs together was read in several messages, and differs each time.
    Unsteady,
    /// A packet error code that does not fit the bytes before it.
    Pec,
    /// The host sends no write to this address: SPD Write Disable is set.
    WriteDisabled,
    /// Any other error number from the adapter.
    Other(i32),
}

/// The errnos of a disturbed transfer without a variant. The kernel's `fault-codes.rst` leaves adapters much choice.
const DISTURBED: [Errno; 7] = [
    // i2c-gpio: a byte after the address was not acknowledged. Adapters behind USB: any failure.
    Errno::IO,
    // The checksum of what was transferred, on the bus or between host and adapter, is wrong.
    Errno::BADMSG,
    Errno::ILSEQ,
    // The target broke the protocol, or a USB packet was lost.
    Errno::PROTO,
    Errno::PIPE,
    // The adapter is suspended, and is resumed with the machine.
    Errno::SHUTDOWN,
    // A signal ended the wait for the end of the transfer.
    Errno::INTR,
];

impl BusError {
    /// What a host answers for a block whose length cannot be one.
    pub const NO_LENGTH: Self = Self::Other(Errno::PROTO.raw_os_error());

    fn row(self) -> (Cow<'static, str>, i32, bool) {
        let (text, errno, is_transient) = match self {
            BusError::NoAck => ("not acknowledged; is the gauge powered and connected?", Errno::NXIO, true),
            BusError::MaybeNoAck(number) => {
                let other = match Errno::from_raw_os_error(number) {
                    Errno::TIMEDOUT => "the bus timed out",
                    Errno::NXIO | Errno::REMOTEIO => "the clock was held low",
                    _ => "another fault of the bus, such as a clock held low",
                };
                let text = format!(
                    "not acknowledged, or {other}: the adapter reports both alike; is the gauge powered and connected?"
                );
                return (text.into(), number, true);
            }
            BusError::ArbitrationLost => {
                ("arbitration lost repeatedly; another controller uses the bus", Errno::AGAIN, true)
            }
            BusError::Timeout => (
                "the bus timed out; a line is held low or the clock stretched too long",
                Errno::TIMEDOUT,
                true,
            ),
            BusError::Short => ("the adapter moved only part of the transfer", Errno::PROTO, true),
            BusError::Gone => ("the adapter is gone", Errno::NODEV, false),
            BusError::Busy => {
                ("a kernel driver is bound to the address; unbind it first", Errno::BUSY, false)
            }
            BusError::HasMux => (
                "the bus has got a mux, so the pack may change at any time; use the bus of its channel",
                Errno::BUSY,
                false,
            ),
            BusError::ReadOnly => ("a recording takes no writes", Errno::ROFS, false),
            BusError::NotRecorded => ("the recording has no answer to this", Errno::NODATA, false),
            BusError::Hung(adapter) => {
                let text = format!(
                    "{} hangs: a transfer has not returned, and nothing is sent on this adapter until it does; reset or \
                     reconnect the adapter",
                    bounded::name(adapter)
                );
                return (text.into(), Errno::TIMEDOUT.raw_os_error(), false);
            }
            BusError::TooSlow { transfers, failed, milliseconds, limit } => {
                let seconds = |milliseconds| f64::from(milliseconds) / 1000.0;
                let (taken, limit) = (seconds(milliseconds), seconds(limit));
                let text = match failed {
                    0 => {
                        format!("the bus is too slow: {transfers} transfers in {taken:.1} s, of {limit:.1} s")
                    }
                    _ => format!(
                        "no time is left: {failed} of {transfers} transfers failed in {taken:.1} s, of {limit:.1} s"
                    ),
                };
                return (text.into(), Errno::TIMEDOUT.raw_os_error(), true);
            }
            BusError::Unsteady => {
                ("what it reads in several messages differs each time; check the bus", Errno::IO, true)
            }
            BusError::Pec => ("its packet error code is wrong; check the bus", Errno::BADMSG, true),
            BusError::WriteDisabled => (
                "the host sends no write to 0x50 to 0x57 (SPD Write Disable, which `dmesg | grep SPD` shows); switch that off \
                 in the settings of its firmware, or connect the gauge to another adapter",
                Errno::ROFS,
                false,
            ),
            BusError::TooLong { bytes, most } => {
                let text = format!(
                    "a message of {bytes} bytes, and the adapter carries {most} at most; connect the gauge to another one"
                );
                return (text.into(), Errno::OPNOTSUPP.raw_os_error(), false);
            }
            BusError::Other(number) => {
                let text =
                    format!("the adapter answered: {}", error::reason(&io::Error::from_raw_os_error(number)));
                let is_transient = DISTURBED.iter().any(|errno| errno.raw_os_error() == number);
                return (text.into(), number, is_transient);
            }
        };
        (text.into(), errno.raw_os_error(), is_transient)
    }

    /// The errno of an operation that fails with it.
    pub fn errno(self) -> i32 {
        self.row().1
    }

    /// Whether the same transfer may succeed when it is sent again.
    pub fn is_transient(self) -> bool {
        self.row().2
    }

    /// Whether the target may not have acknowledged. Some adapters report an input/output error instead.
    pub fn may_be_no_ack(self) -> bool {
        matches!(self, BusError::NoAck | BusError::MaybeNoAck(_))
            || self == BusError::Other(Errno::IO.raw_os_error())
    }

    /// The error whose `Display` is `text`, for recordings; else an input/output error.
    pub fn by_text(text: &str) -> Self {
        let known = [
            BusError::NoAck,
            BusError::MaybeNoAck(Errno::TIMEDOUT.raw_os_error()),
            BusError::MaybeNoAck(Errno::NXIO.raw_os_error()),
            BusError::MaybeNoAck(Errno::IO.raw_os_error()),
            BusError::ArbitrationLost,
            BusError::Timeout,
            BusError::Short,
            BusError::Gone,
            BusError::Busy,
            BusError::HasMux,
            BusError::ReadOnly,
            BusError::NotRecorded,
            BusError::Unsteady,
            BusError::Pec,
            BusError::WriteDisabled,
        ];
        let found = known.into_iter().find(|error| error.row().0 == text);
        found.unwrap_or(BusError::Other(Errno::IO.raw_os_error()))
    }
}

impl fmt::Display for BusError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.row().0)
    }
}

impl std::error::Error for BusError {}

/// What a host reads as one command of SMBus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packet {
    /// The command code.
    pub code: u8,
    /// A block, whose length the target says; else a word.
    pub is_block: bool,
    /// The host compares the packet error code behind it.
    pub pec: bool,
}

/// Access to one target address.
pub trait Bus: Send {
    /// One transfer: START, `write` to the target, then, if `read` is not empty, a repeated START and
    /// `read.len()` bytes from the target, STOP. If `write` is empty, it reads from the target's current register
    /// pointer; if both are empty, it only checks whether the address is acknowledged.
    ///
    /// After an error, it may be unknown whether the transfer had its effect on the target.
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError>;

    /// A word or a block of SMBus, by hosts that have commands alone ([`Reach::smbus`]). Returns the word, or the block with its
    /// length before it.
    fn packet(&mut self, packet: Packet) -> Result<Vec<u8>, BusError> {
        let nobody = Err(BusError::Other(Errno::OPNOTSUPP.raw_os_error()));
        self.inner().map_or(nobody, |bus| bus.packet(packet))
    }

    /// The bus below a layer. What else a bus is told goes there by itself: `set_secret` must reach a recorder.
    fn inner(&mut self) -> Option<&mut dyn Bus> {
        None
    }

    /// What it can carry; longer messages are refused.
    fn reach(&mut self) -> Reach {
        self.inner().map_or(Reach::FULL, |bus| bus.reach())
    }

    /// Checks that no kernel driver is bound to the address, without a transfer.
    fn claim(&mut self) -> Result<(), BusError> {
        self.inner().map_or(Ok(()), |bus| bus.claim())
    }

    /// Announces when the last transfer may start; one that is under way is not waited for much longer. `None`: no limit.
    fn limit(&mut self, latest: Option<Duration>) {
        if let Some(bus) = self.inner() {
            bus.limit(latest);
        }
    }

    /// Closes an adapter that was unplugged, because the kernel keeps it until its last user has closed it.
    fn release_if_gone(&mut self) {
        if let Some(bus) = self.inner() {
            bus.release_if_gone();
        }
    }

    /// Announces that transfers carry keys or security data from now on, or no longer do: recorders must hide those.
    fn set_secret(&mut self, secret: bool) {
        if let Some(bus) = self.inner() {
            bus.set_secret(secret);
        }
    }
}

impl Bus for Box<dyn Bus> {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        (**self).transfer(write, read)
    }

    fn inner(&mut self) -> Option<&mut dyn Bus> {
        Some(&mut **self)
    }
}

/// Bytes on the wire for a transfer: the address byte of each direction, and the data.
pub fn wire_bytes(write: usize, read: usize) -> u64 {
    let messages = u64::from(write > 0 || read == 0) + u64::from(read > 0);
    messages + write as u64 + read as u64
}

/// Bit times of a transfer: nine per byte, and one for each START, repeated START and STOP.
pub fn wire_bits(write: usize, read: usize) -> u64 {
    let messages = u64::from(write > 0 || read == 0) + u64::from(read > 0);
    wire_bytes(write, read) * 9 + messages + 1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each error number of the kernel's list of I2C fault codes, and those of adapters behind USB.
    #[test]
    fn a_disturbed_transfer_is_worth_sending_again() {
        let other = |errno: Errno| BusError::Other(errno.raw_os_error());
        for errno in
            [Errno::IO, Errno::BADMSG, Errno::ILSEQ, Errno::PROTO, Errno::PIPE, Errno::SHUTDOWN, Errno::INTR]
        {
            assert!(other(errno).is_transient(), "{errno}");
        }
        let passing = [BusError::NoAck, BusError::ArbitrationLost, BusError::Timeout, BusError::Short];
        for error in passing.into_iter().chain([BusError::Unsteady]) {
            assert!(error.is_transient(), "{error}");
        }
        // The adapter cannot do it, now or later.
        for errno in [Errno::OPNOTSUPP, Errno::INVAL, Errno::NOMEM, Errno::ACCESS, Errno::PERM] {
            assert!(!other(errno).is_transient(), "{errno}");
        }
        let gone = [BusError::Gone, BusError::Hung(1), BusError::TooLong { bytes: 3, most: 2 }];
        for error in gone.into_iter().chain([BusError::Busy, BusError::ReadOnly, BusError::NotRecorded]) {
            assert!(!error.is_transient(), "{error}");
        }
        assert!(BusError::NoAck.may_be_no_ack() && other(Errno::IO).may_be_no_ack());
        assert!(!other(Errno::PROTO).may_be_no_ack() && !BusError::Timeout.may_be_no_ack());
    }

    /// Nobody can tell from it whether the bus or the gauge is at fault, and the errno stays the adapter's.
    #[test]
    fn an_error_that_may_be_a_nack_says_both() {
        for (errno, other) in [
            (Errno::TIMEDOUT, "or the bus timed out"),
            (Errno::NXIO, "or the clock was held low"),
            (Errno::IO, "or another fault of the bus"),
        ] {
            let error = BusError::MaybeNoAck(errno.raw_os_error());
            let text = error.to_string();
            assert!(text.starts_with("not acknowledged, ") && text.contains(other), "{text}");
            assert_eq!((error.errno(), BusError::by_text(&text)), (errno.raw_os_error(), error));
            assert!(error.is_transient() && error.may_be_no_ack());
        }
    }

    /// A bus that keeps what it is told.
    #[derive(Default)]
    struct Told(std::sync::Arc<std::sync::Mutex<Vec<String>>>);

    impl Told {
        fn keep(&self, what: String) {
            self.0.lock().expect("nobody panics").push(what);
        }
    }

    impl Bus for Told {
        fn transfer(&mut self, _: &[u8], _: &mut [u8]) -> Result<(), BusError> {
            Ok(())
        }

        fn reach(&mut self) -> Reach {
            Reach::smbus(32, false)
        }

        fn claim(&mut self) -> Result<(), BusError> {
            self.keep("claim".into());
            Err(BusError::Busy)
        }

        fn limit(&mut self, latest: Option<Duration>) {
            self.keep(format!("limit {latest:?}"));
        }

        fn release_if_gone(&mut self) {
            self.keep("release".into());
        }

        fn set_secret(&mut self, secret: bool) {
            self.keep(format!("secret {secret}"));
        }
    }

    /// A layer that has nothing to say to any of it.
    struct Layer(Box<dyn Bus>);

    impl Bus for Layer {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
            self.0.transfer(write, read)
        }

        fn inner(&mut self) -> Option<&mut dyn Bus> {
            Some(&mut self.0)
        }
    }

    #[test]
    fn what_a_layer_is_told_reaches_the_bus_below_it() {
        let told = Told::default();
        let said = told.0.clone();
        let mut bus: Box<dyn Bus> = Box::new(Layer(Box::new(Layer(Box::new(told)))));
        assert_eq!(bus.reach(), Reach::smbus(32, false));
        assert_eq!(bus.claim(), Err(BusError::Busy));
        bus.limit(Some(Duration::from_secs(1)));
        bus.release_if_gone();
        bus.set_secret(true);
        let said = said.lock().expect("nobody panics");
        assert_eq!(said[..], ["claim", "limit Some(1s)", "release", "secret true"]);
    }

    #[test]
    fn a_full_poll_costs_what_the_readme_says() {
        let poll = [(1, 18), (1, 4), (1, 12)];
        assert_eq!(poll.iter().map(|&(w, r)| wire_bytes(w, r)).sum::<u64>(), 43);
        assert_eq!(poll.iter().map(|&(w, r)| wire_bits(w, r)).sum::<u64>(), 396);
    }
}
