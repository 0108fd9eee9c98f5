// SPDX-License-Identifier: MIT

//! SHA-1 authentication (SLUSBZ5D 7.3.15): a challenge goes to the gauge, the digest comes back.
//!
//! The gauge computes SHA1(K || SHA1(K || M)) from its key K and the challenge M. This is not the HMAC of RFC 2104.

use std::time::Duration;

use sha1::{Digest as _, Sha1};

use crate::chip::Authentication;
use crate::codec::checksum;
use crate::error::{Cause, Error, Result};
use crate::gauge::{Gauge, Seal, Statistics};
use crate::text;

/// Bytes of a challenge, and of a digest.
pub const LENGTH: usize = 20;
/// A challenge or a digest, most significant byte first, as in SHA-1.
pub type Message = [u8; LENGTH];

/// Shortest time from the selection to the challenge: a window that loads later would overwrite it.
const SELECTED: Duration = Duration::from_millis(60);
/// Shortest time before the buffer is read: gauges take up to 30 ms for its content.
const SETTLED: Duration = Duration::from_millis(30);
const DIGEST_READS: u32 = 4;
/// write(2) returns within 30 s.
const LIMIT: Duration = Duration::from_secs(12);

/// Byte order on the bus. The manual does not say; related parts have the least significant byte first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Order {
    /// Least significant byte first.
    #[default]
    LsbFirst,
    /// First byte first.
    AsSent,
}

impl Order {
    /// Both orders.
    pub const ALL: [Order; 2] = [Order::LsbFirst, Order::AsSent];

    /// The order's word.
    pub fn as_str(self) -> &'static str {
        match self {
            Order::LsbFirst => "lsb-first",
            Order::AsSent => "as-sent",
        }
    }

    /// The order with that word.
    pub fn by_name(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|order| order.as_str() == word)
    }

    /// Converts between the orders of SHA-1 and of the bus.
    fn turn(self, mut message: Message) -> Message {
        if self == Order::LsbFirst {
            message.reverse();
        }
        message
    }
}

/// A gauge's answer to a challenge, with this key.
pub fn answer(key: &[u8; 16], challenge: &Message) -> Message {
    let inner = Sha1::new().chain_update(key).chain_update(challenge).finalize();
    Sha1::new().chain_update(key).chain_update(inner).finalize().into()
}

/// The byte order in which this key gives `digest` after a challenge in the order `asked`; `None` if neither fits.
pub fn fits(key: &[u8; 16], challenge: &Message, digest: &Message, asked: Order) -> Option<Order> {
    let (sent, got) = (asked.turn(*challenge), asked.turn(*digest));
    Order::ALL.into_iter().find(|order| answer(key, &order.turn(sent)) == order.turn(got))
}

/// Asks the gauge for its digest of a challenge, without a key and without a change of the seal state.
pub fn ask(gauge: &mut Gauge, challenge: &Message, order: Order, waited: Duration) -> Result<Message> {
    let Some(waits) = &gauge.chip.authentication else {
        let why = "this part has no authentication that gaugefs knows";
        return Err(Error::new(gauge.chip.model, Cause::NotPermitted, why));
    };
    gauge.limit(Some(LIMIT.saturating_sub(waited)));
    let outcome = gauge.claim().and_then(|()| exchange_twice(gauge, waits, challenge, order));
    gauge.limit(None);
    outcome.map_err(|error| error.within("authenticate"))
}

/// Like [`ask`], within an operation with its own time limit.
pub(crate) fn answered(gauge: &mut Gauge, challenge: &Message, order: Order) -> Result<Message> {
    let waits = gauge.chip.authentication.as_ref().expect("asked of parts that have it");
    exchange_twice(gauge, waits, challenge, order)
}

fn exchange_twice(
    gauge: &mut Gauge,
    waits: &Authentication,
    challenge: &Message,
    order: Order,
) -> Result<Message> {
    let sent = order.turn(*challenge);
    // The exchange stores nothing, so all of it can be repeated.
    let digest = attempt(gauge, waits, &sent).or_else(|_| {
        Statistics::count(&gauge.statistics.retries);
        attempt(gauge, waits, &sent)
    })?;
    Ok(order.turn(digest))
}

fn attempt(gauge: &mut Gauge, waits: &Authentication, sent: &Message) -> Result<Message> {
    // A sealed gauge has no BlockDataControl() (Table 7-8) and needs none.
    let open = gauge.seal()? != Seal::Sealed;
    let view = gauge.challenge().view;
    if open {
        gauge.write(view, &[1])?;
    }
    let digest = exchange(gauge, waits, sent);
    // The window does not show data flash until this is 0 again.
    let closed = if open { gauge.write(view, &[0]) } else { Ok(()) };
    digest.and_then(|digest| closed.map(|()| digest))
}

fn exchange(gauge: &mut Gauge, waits: &Authentication, sent: &Message) -> Result<Message> {
    let at = gauge.challenge();
    gauge.write(at.select, &[0])?;
    gauge.wait(gauge.chip.access.select.max(SELECTED));
    gauge.write(at.data, sent)?;
    gauge.wait(waits.challenge.max(SETTLED));
    // A corrupted challenge starts no computation and stays in the buffer. So neither the challenge nor the buffer's
    // present content must be taken for the digest.
    let mut echo = [0; LENGTH];
    gauge.read(at.data, &mut echo)?;
    // Sent once: a second checksum would apply to the digest.
    let started = gauge.write_once(at.sum, &[checksum(sent)]);
    started.map_err(|bus| Error::bus("AuthenticateChecksum()", bus))?;
    // I2C has no error detection, and the computing time is not documented: two readings must agree.
    let mut before = None;
    for _ in 0..DIGEST_READS {
        gauge.wait(waits.digest.max(SETTLED));
        let mut digest = [0; LENGTH];
        gauge.read(at.data, &mut digest)?;
        let is_blank = digest.iter().all(|&byte| byte == digest[0]);
        let is_new = digest != echo && digest != *sent && !is_blank;
        if is_new && before == Some(digest) {
            return Ok(digest);
        }
        before = Some(digest);
    }
    let why = "the gauge shows no digest of the challenge";
    Err(Error::new("AuthenticateData()", Cause::Protocol, why))
}

/// A challenge or a digest as text, two digits per byte.
pub fn to_hex(message: &Message) -> String {
    text::hex(message)
}

/// Parses a challenge or a digest, with spaces around it. The error does not repeat the text, which may be a key.
pub fn from_hex(digits: &[u8]) -> Result<Message> {
    let message = text::unhex(digits.trim_ascii()).and_then(|bytes| bytes.try_into().ok());
    message.ok_or_else(|| {
        let why = format!("expected a challenge of {LENGTH} bytes as {} hexadecimal digits", 2 * LENGTH);
        Error::new("authenticate", Cause::Invalid, why)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(text: &str) -> Message {
        from_hex(text.as_bytes()).expect("20 bytes")
    }

    fn key(text: &str) -> [u8; 16] {
        let line = format!("authentication = {text}");
        let keys = crate::keys::Keys::parse("keys", line.as_bytes(), "BAT0").expect("a key file");
        keys.secret(crate::keys::Name::Authentication).expect("a key").bytes().try_into().expect("16 bytes")
    }

    const DEFAULT: &str = "0123456789ABCDEFFEDCBA9876543210";
    const ZEROS: &str = "0000000000000000000000000000000000000000";

    /// SLUAAQ0's example, that of the bq26100, and what bqStudio computed for a bq35100.
    #[test]
    fn answers_are_those_of_the_published_examples() {
        for (k, m, d) in [
            ("42C5413DB9EDBBA212DFB96B7440433C", ZEROS, "B0BEF440CAC492FAF09604A46C2C0996512331AF"),
            (
                "00000000000000000000000000000000",
                "C82CA3CA10DEC7268E070A7CF0D1FE8220AAD3B8",
                "FB8A342458E0B136988CB5203BB23F94DFD4440E",
            ),
            (DEFAULT, "546869732069732061207465737420666F722068", "5D80AC0CDB62DA0BADB8AD272AF9D6A11223E734"),
        ] {
            assert_eq!(to_hex(&answer(&key(k), &message(m))), d.to_lowercase());
        }
    }

    /// A bq78350 on the wire: challenge and answer with the least significant byte first.
    #[test]
    fn a_relatives_trace_has_the_least_significant_byte_first() {
        let k = key("01000000000000000000000000000001");
        let sent = message("C82CA3CA10DEC7268E070A7CF0D1FE8220AAD3B8");
        let got = message("ADB2D89D38F6DF5B098850541935F84EC61E0DB3");
        assert_eq!(fits(&k, &sent, &got, Order::AsSent), Some(Order::LsbFirst));
        let (sent, got) = (Order::LsbFirst.turn(sent), Order::LsbFirst.turn(got));
        assert_eq!(fits(&k, &sent, &got, Order::LsbFirst), Some(Order::LsbFirst));
    }

    /// Derived for the default key, in both orders: bytes on the wire.
    #[test]
    fn the_order_on_the_wire_is_found_out() {
        for (sent, lsb_first, as_sent) in [
            (ZEROS, "F0F33C8E0A9BC21722E30F628464615BEB7CA22F", "2FA27CEB5B616484620FE32217C29B0A8E3CF3F0"),
            (
                "000102030405060708090a0b0c0d0e0f10111213",
                "67D8D90516ECD55A3C751FC0BE7A361DB366A246",
                "B78043012BB40F9FF86404F645C2AB6A9F28EAF3",
            ),
            (
                "C82CA3CA10DEC7268E070A7CF0D1FE8220AAD3B8",
                "A89F35E7163A1F0D4F8DEEFE102DA4915EA5E4C3",
                "B46F6021955E203EE105A2235AE7A0ACC1FF0AED",
            ),
        ] {
            for asked in Order::ALL {
                let challenge = asked.turn(message(sent));
                for (got, order) in [(lsb_first, Order::LsbFirst), (as_sent, Order::AsSent)] {
                    let digest = asked.turn(message(got));
                    assert_eq!(fits(&key(DEFAULT), &challenge, &digest, asked), Some(order));
                    assert_eq!(fits(&key(&DEFAULT.replace('7', "8")), &challenge, &digest, asked), None);
                }
            }
        }
    }

    #[test]
    fn a_challenge_is_40_digits_and_nothing_else() {
        assert_eq!(to_hex(&message(" 00FF102030405060708090a0b0c0d0e0f0112233\n")).len(), 40);
        for text in [
            "",
            "00",
            &ZEROS[1..],
            &format!("{ZEROS}0"),
            &ZEROS.replacen('0', "g", 1),
            &format!("0x{}", &ZEROS[2..]),
        ] {
            let error = from_hex(text.as_bytes()).expect_err("not a challenge");
            assert!(matches!(error.cause(), Cause::Invalid));
            assert!(text.len() < 3 || !error.to_string().contains(text));
        }
    }
}
