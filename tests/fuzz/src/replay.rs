// SPDX-License-Identifier: MIT

//! Recordings, and the bus that answers from one: `gauge_bus::replay`.

use std::sync::Arc;

use gauge_bus::Bus;
use gauge_bus::clock::SimClock;
use gauge_bus::replay::Recording;
use ti_gauge::chip::{CHIPS, Chip, Tier};
use ti_gauge::gauge::{self, Gauge};
use ti_gauge::keys::Keys;
use ti_gauge::registers::Registers;

use crate::command::Scratch;

pub(crate) fn run(input: &[u8]) {
    let file = Scratch::new("replay", input);
    let Ok(recording) = Recording::open(file.path()) else { return };
    let chip = Chip::by_name(&recording.chip).unwrap_or(CHIPS[0]);
    let mut replay = gauge::replay(chip, &recording);
    for register in 0..=0x7f {
        replay.covers(register, 2);
        let mut into = [0; 32];
        let _ = replay.transfer(&[register], &mut into[..1 + usize::from(register) % 32]);
    }
    // Data flash of a recording is never written.
    assert!(replay.transfer(&[0x40, 1], &mut []).is_err());
    assert!(replay.transfer(&[0x60, 1], &mut []).is_err());
    let _ = replay.transfer(&[0xff, 1, 2, 3], &mut [0; 40]);
    let mut gauge = Gauge::new(chip, Box::new(replay), Arc::new(SimClock::new()), Keys::default());
    let _ = gauge.identify();
    let mut registers = Registers::unread(chip.registers);
    let _ = registers.read(&mut gauge, |tier| tier != Tier::Window);
    let _ = gauge.unseal();
    let _ = gauge.close();
}
