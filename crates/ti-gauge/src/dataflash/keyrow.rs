// SPDX-License-Identifier: MIT

//! The row of data flash that holds the keys, read without a trace of it anywhere.

use zeroize::Zeroizing;

use super::schemes::{Care, sequence};
use super::window::locate;
use crate::chip::KeyOrder;
use crate::error::{Cause, Error, Result};
use crate::gauge::Gauge;
use crate::keys::{Name, Secret};

/// Whether the gauge, which is in FULL ACCESS, keeps the mount's unseal key. Then it is proven.
pub(super) fn keeps_unseal_key(gauge: &mut Gauge) -> Result<bool> {
    let (Some(block), Some(key)) = (gauge.chip.security.storage.block(), gauge.key(Name::Unseal)) else {
        return Ok(false);
    };
    sequence(gauge).enable(gauge)?;
    let (place, start) = locate(block.subclass, block.start);
    let window = quietly(gauge, |gauge| sequence(gauge).load(gauge, place, Care::Sure).map(Zeroizing::new))?;
    let stored = stored(&key, block.order);
    let at = start + block.unseal;
    let keeps = window[at..at + stored.len()] == **stored;
    if keeps {
        gauge.prove_key();
    }
    Ok(keeps)
}

pub(super) fn stored(key: &Secret, order: KeyOrder) -> Zeroizing<Vec<u8>> {
    let mut bytes = Zeroizing::new(key.bytes().to_vec());
    if let (KeyOrder::Reversed, [a, b, c, d]) = (order, bytes.as_slice()) {
        let turned = [*c, *d, *a, *b];
        bytes.copy_from_slice(&turned);
    }
    bytes
}

/// Runs transfers that carry keys: they are not recorded, and no error repeats what was read.
pub(super) fn quietly<T>(gauge: &mut Gauge, run: impl FnOnce(&mut Gauge) -> Result<T>) -> Result<T> {
    gauge.set_secret(true);
    let outcome = run(gauge);
    gauge.set_secret(false);
    outcome.map_err(|error| {
        let cause = error.cause();
        let why = match cause {
            Cause::BadChecksum => "the checksum of the key block is wrong",
            Cause::Protocol => "the key block could not be read correctly",
            _ => return error.about(""),
        };
        let plain = Error::new("", cause, why);
        match error.step() {
            Some(step) => plain.at(step),
            None => plain,
        }
    })
}
