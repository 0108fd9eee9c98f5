// SPDX-License-Identifier: MIT

//! Flat data flash of the parts with ManufacturerAccessControl(), read and written by address (SLUUBH1C 12.1.3).

use super::flash::Flash;

pub(super) const BASE: u16 = 0x4000;
pub(super) const SIZE: usize = 0x400;
/// Areas of the image: data flash, and values whose place no document gives.
pub(super) const DATA_FLASH: u16 = 0;
pub(super) const PRIVATE: u16 = 1;

/// A whole data flash with the given bytes at their addresses, and 0 elsewhere.
pub(super) const fn image(rows: &[(u16, &[u8])]) -> [u8; SIZE] {
    image_from(BASE, rows)
}

/// `N` bytes of data flash from address `base` on, with the given bytes and 0 elsewhere.
pub(super) const fn image_from<const N: usize>(base: u16, rows: &[(u16, &[u8])]) -> [u8; N] {
    let mut out = [0; N];
    let mut row = 0;
    while row < rows.len() {
        let (address, bytes) = rows[row];
        let mut at = 0;
        while at < bytes.len() {
            out[(address - base) as usize + at] = bytes[at];
            at += 1;
        }
        row += 1;
    }
    out
}

pub(super) const fn offset(address: u16) -> usize {
    (address - BASE) as usize
}

pub(super) fn u8_at(flash: &Flash, address: u16) -> u8 {
    flash.u8(DATA_FLASH, offset(address))
}

pub(super) fn u16_at(flash: &Flash, address: u16) -> u16 {
    flash.u16(DATA_FLASH, offset(address))
}

pub(super) fn i16_at(flash: &Flash, address: u16) -> i16 {
    flash.i16(DATA_FLASH, offset(address))
}
