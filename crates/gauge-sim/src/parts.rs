// SPDX-License-Identifier: MIT

//! The parts that are simulated, a file each.

// Parts name them as `super::part` and so on.
use super::part::Part;
use super::{battery, flash, flat, gauging, learning, model, part, protector, rom, seal, timing, update};

mod bq27220;
mod bq27426;
mod bq27427;
mod bq27441_g1;
mod bq27500;
mod bq27520_g3;
mod bq27541_g1;
mod bq27542_g1;
mod bq27621_g1;
mod bq27742_g1;
mod bq28z610;
mod bq34110;
mod bq34z100_g1;
mod bq34z100_r2;
mod bq35100;
mod kernel;
mod sbs;
mod ti;

static PARTS: &[&Part] = &[
    &bq34z100_g1::PART,
    &bq34z100_r2::PART,
    &bq27520_g3::PART,
    &bq27500::PART,
    &bq27500::V130,
    &bq27541_g1::PART,
    &bq27542_g1::PART,
    &bq27541_g1::BQ27545,
    &bq27742_g1::PART,
    &bq27441_g1::PART,
    &bq27441_g1::BQ27421,
    &bq27426::PART,
    &bq27427::PART,
    &bq27220::PART,
    &bq27621_g1::PART,
    &bq34110::PART,
    &bq35100::PART,
    &bq28z610::PART,
];

/// Every part: those with data flash, those known by their standard commands only, the Smart Battery, and TI's gauges in one.
pub(super) fn all() -> impl Iterator<Item = &'static Part> {
    PARTS.iter().chain(kernel::PARTS).copied().chain([&sbs::PART]).chain(ti::PARTS.iter().copied())
}

/// Compares blocks of an image with the checksums of documents and real parts.
#[cfg(test)]
fn check_sums(image: flash::Image, sums: &[(u16, usize, u8)]) {
    for &(id, block, sum) in sums {
        let (_, bytes) = image.iter().find(|(area, _)| *area == id).unwrap();
        let bytes = bytes.chunks(flash::BLOCK).nth(block).unwrap();
        assert_eq!(super::window::checksum(bytes), sum, "{id}/{block}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_values_that_a_gauge_rewrites_are_in_its_flash() {
        for part in PARTS {
            let flash = flash::Flash::new(part.image);
            for &(area, offset, length) in part.rewrites {
                assert_eq!(
                    flash.bytes_at(area, offset, length).len(),
                    length,
                    "{} {area}/{offset}",
                    part.name
                );
            }
        }
    }
}
