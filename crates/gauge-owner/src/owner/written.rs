// SPDX-License-Identifier: MIT

//! The log of what writes have changed.

use super::handle::Shared;
use ti_gauge::dataflash::{Change, Outcome, Place};
use ti_gauge::notation;
use ti_gauge::quantity;
use ti_gauge::text;
use ti_gauge::unit;

/// What is said of a value that no reset makes the gauge use.
const NEXT_START: &str = "; it counts from the gauge's next start on";

/// Logs what each change of a write has replaced, and notes the scales among them.
pub(super) fn log(shared: &Shared, changes: &[Change], outcome: &Outcome) {
    let prefix = format!("{}{}", shared.prefix, serial(shared));
    for change in changes {
        let Place { subclass, offset } = change.place();
        shared.note_scales(subclass, offset, change.bytes());
    }
    match outcome {
        Outcome::Unchanged => {
            for change in changes {
                log::info!("{prefix}{}: unchanged, nothing written", change.name());
            }
        }
        Outcome::Written { old, .. } => {
            shared.note_waiting(changes);
            for (change, old) in changes.iter().zip(old) {
                let counts = if change.waits(shared.chip) { NEXT_START } else { "" };
                let what = difference(change, old);
                log::info!("{prefix}{}: {what}, written and verified{counts}", change.name());
            }
        }
    }
}

fn serial(shared: &Shared) -> String {
    let register = shared.chip.serial_register();
    let published = shared.published();
    let word = register.and_then(|register| published.snapshot.as_ref()?.value(register));
    word.map_or_else(String::new, |word| format!("serial 0x{word:04x}: "))
}

/// A change and what it replaced, such as `3000 -> 3100 mV`, or in hexadecimal.
fn difference(change: &Change, old: &[u8]) -> String {
    let new = change.stored_over(old);
    let show = |bytes: &[u8]| match change.row().zip(change.value_of(bytes)) {
        Some(((_, parameter), value)) => notation::show(parameter, &value),
        None => text::hex(bytes),
    };
    let unit = change.row().map_or("", |(_, parameter)| unit::shown(parameter));
    quantity::change(&show(old), &show(&new), unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_is_described_by_old_and_new_value() {
        let chip = ti_gauge::chip::Chip::by_name("bq34z100-g1").expect("it has a table");
        let of = |id: &str, offset: &str, old: &[u8], new: &[u8]| {
            let row = chip.row(id, offset).expect("a parameter of the table");
            let value = chip.layout.decode(row.1.kind, new);
            difference(&Change::of_value(chip, row, &value, true).expect("a value in range"), old)
        };
        assert_eq!(of("80", "53", &[0x0b, 0xb8], &[0x0c, 0x1c]), "3000 -> 3100 mV");
        assert_eq!(of("48", "4", &[0, 1], &[0, 7]), "0x0001 -> 0x0007");
        assert_eq!(of("58", "3", &[0x00], &[0x5a]), "0x00 -> 0x5a");
        assert_eq!(of("48", "31", b"\x04old\n       ", b"\x03new        "), "old%0a -> new");
        let raw = Change::raw(chip, Place { subclass: 130, offset: 200 }, vec![0xab, 0xcd]).expect("no row");
        assert_eq!(difference(&raw, &[0, 1]), "0001 -> abcd");
    }
}
