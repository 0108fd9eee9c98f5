// SPDX-License-Identifier: MIT

//! Recordings that may be given away.

use std::time::Duration;

use gauge_bus::trace::Event;
use ti_gauge::chip::{CHIPS, FLAT, Kind, Subclass};
use ti_gauge::codec::checksum;
use ti_gauge::dataflash::{anonymous, sample, samples};
use ti_gauge::value::Type;

use crate::rig::{Rig, first_address};

/// Bytes that nothing else holds: a serial number, and the beginning of a text.
const NUMBER: [u8; 2] = [0xbe, 0xef];
const TEXT: &[u8] = b"\x06owner's";

fn holds(events: &[Event], bytes: &[u8]) -> bool {
    events.iter().any(|event| match event {
        Event::Transfer { write, answer, .. } => {
            let answer = answer.as_deref().unwrap_or_default();
            [write, answer].iter().any(|part| part.windows(bytes.len()).any(|part| part == bytes))
        }
        Event::Hidden => false,
    })
}

/// Puts the bytes where every parameter is that is not to be given away. Returns how many there are.
fn mark(rig: &Rig) -> usize {
    let chip = rig.gauge.chip;
    let mut count = 0;
    for subclass in chip.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security) {
        for parameter in subclass.parameters {
            let start = if subclass.id == FLAT { first_address(chip) } else { 0 };
            let bytes = match parameter.kind {
                Type::S(size) if usize::from(size) >= TEXT.len() => TEXT,
                _ if parameter.names_pack() => &NUMBER,
                _ => continue,
            };
            rig.sim.set_flash(subclass.id.into(), usize::from(parameter.offset) - start, bytes);
            count += 1;
        }
    }
    count
}

#[test]
fn serial_numbers_texts_and_keys_are_not_in_an_anonymous_recording() {
    for chip in CHIPS {
        let mut rig = Rig::new(chip.name);
        let marked = mark(&rig);
        let all: Vec<&Subclass> = chip.subclasses.iter().filter(|row| row.kind != Kind::Security).collect();
        rig.gauge.record();
        rig.dataflash.read(&mut rig.gauge, &all, Duration::ZERO).expect("the default key");
        let mut registers = [0; 0x3e];
        rig.gauge.read(0, &mut registers).expect("it answers");
        let whole = rig.gauge.recorded();
        let key = chip.security.default_unseal[0].to_le_bytes();
        let key = [0, key[0], key[1]];
        assert!(!holds(&whole, &key) && whole.contains(&Event::Hidden), "{}", chip.name);
        let shared = anonymous(chip, whole.clone());
        for bytes in [&NUMBER[..], &[NUMBER[1], NUMBER[0]], TEXT] {
            assert!(!holds(&shared, bytes), "{}: {bytes:02x?}", chip.name);
        }
        let secret = holds(&whole, &NUMBER) || holds(&whole, TEXT);
        assert_eq!(secret, marked > 0, "{}: {marked}", chip.name);
        // What is left is most of it.
        assert!(shared.len() > whole.len() / 2, "{}: {} of {}", chip.name, shared.len(), whole.len());
        if chip.name == "bq34z100-g1" {
            assert!(marked > 5, "{marked}");
        }
    }
}

#[test]
fn the_sample_of_every_chip_is_read_and_kept() {
    for chip in CHIPS {
        let mut rig = Rig::new(chip.name);
        mark(&rig);
        let subclass = &chip.subclasses[sample(chip).expect("a sample")];
        rig.gauge.record();
        let read = rig.dataflash.read(&mut rig.gauge, &[subclass], Duration::ZERO).expect("the default key");
        let events = anonymous(chip, rig.gauge.recorded());
        assert!(holds(&events, &read[0]), "{}: {}", chip.name, subclass.name);
        // Every block that is left adds up.
        for event in &events {
            if let Event::Transfer { write, answer: Ok(bytes), .. } = event
                && write[..] == [0x3e]
                && bytes.len() == 36
            {
                let summed = if chip.access.scheme.is_flat() {
                    &bytes[..usize::from(bytes[35]) - 2]
                } else {
                    &bytes[2..34]
                };
                assert_eq!(checksum(summed), bytes[34], "{}: {bytes:02x?}", chip.name);
            }
        }
    }
}

/// More of data flash, and nothing more of the pack's owner.
#[test]
fn the_samples_of_every_chip_hold_no_key_and_no_number() {
    for chip in CHIPS {
        let mut rig = Rig::new(chip.name);
        mark(&rig);
        let all: Vec<_> = samples(chip).into_iter().map(|index| &chip.subclasses[index]).collect();
        assert!(all.iter().any(|row| std::ptr::eq(*row, &chip.subclasses[sample(chip).expect("a sample")])));
        assert!(all.iter().all(|row| row.kind != Kind::Security), "{}", chip.name);
        rig.gauge.record();
        let read = rig.dataflash.read(&mut rig.gauge, &all, Duration::ZERO).expect("the default key");
        let events = rig.gauge.recorded();
        let shared = anonymous(chip, events);
        for bytes in [&NUMBER[..], &[NUMBER[1], NUMBER[0]], TEXT] {
            assert!(!holds(&shared, bytes), "{}: {bytes:02x?}", chip.name);
        }
        assert!(read.len() == all.len() && !read.is_empty(), "{}", chip.name);
    }
}

/// A gauge that loads a block late still shows the block before, under the new selection.
#[test]
fn a_private_block_that_is_shown_late_is_left_out_as_well() {
    let chip = CHIPS[0];
    let select = |class: u8, block: u8| Event::Transfer {
        at: Duration::ZERO,
        write: vec![0x3e, class, block],
        read: 0,
        answer: Ok(Vec::new()),
    };
    let show = |start: u8, bytes: Vec<u8>| Event::Transfer {
        at: Duration::ZERO,
        write: vec![start],
        read: bytes.len(),
        answer: Ok(bytes),
    };
    let private: Vec<u8> = (0..32).collect();
    let other = vec![7; 32];
    let registers = |serial: [u8; 2]| show(0x26, vec![1, 2, serial[0], serial[1], 3]);
    let events = vec![
        registers(NUMBER),
        select(48, 0),
        show(0x40, private.clone()),
        show(0x60, vec![9]),
        select(2, 0),
        show(0x40, private.clone()),
        show(0x40, other.clone()),
        // The selection was disturbed on the wire, and the gauge says so.
        show(0x3e, [&[48, 0][..], &[5; 34]].concat()),
    ];
    assert_eq!(anonymous(chip, events), [registers([0, 0]), select(2, 0), show(0x40, other)]);
}
