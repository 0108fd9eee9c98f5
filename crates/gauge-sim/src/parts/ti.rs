// SPDX-License-Identifier: MIT

//! TI's gauges in Smart Batteries: what their manuals and drivers say that each command is (SLUUA43A 12.1, SLUUBC1D 13.1,
//! SLUUBK0B 14.1, SLUUAQ3A 13.1, SLUU852A 11.1, SLUUA79, SLUUBD3D 17.2, E2E 71892 and 1108797, OpenDevicePartnership/bq40z50).

use super::part::{Part, Scheme, TiPart};
use super::timing::Timing;

const BLOCKS: &[u8] = &[0x23, 0x44];

pub(super) static PARTS: &[&Part] = &[
    &part(
        "bq40z50",
        &TiPart {
            device_name: "bq40z50",
            device_type: 0x4500,
            version: 0x0012,
            build: 24,
            answers_at: BLOCKS,
            answers: READS_1,
            does: WRITES_1,
        },
    ),
    &part(
        "bq40z50-r1",
        &TiPart {
            device_name: "bq40z50-R1",
            device_type: 0x4500,
            version: 0x0105,
            build: 25,
            answers_at: BLOCKS,
            answers: READS_2,
            does: WRITES_1,
        },
    ),
    &part(
        "bq40z50-r2",
        &TiPart {
            device_name: "bq40z50-R2",
            device_type: 0x4500,
            version: 0x0211,
            build: 52,
            answers_at: BLOCKS,
            answers: READS_3,
            does: WRITES_2,
        },
    ),
    &part(
        "bq40z50-r3",
        &TiPart {
            device_name: "bq40z50-R3",
            device_type: 0x4500,
            version: 0x0309,
            build: 71,
            answers_at: BLOCKS,
            answers: READS_4,
            does: WRITES_3,
        },
    ),
    &part(
        "bq40z50-r4",
        &TiPart {
            device_name: "bq40z50-R4",
            device_type: 0x4500,
            version: 0x0402,
            build: 79,
            answers_at: BLOCKS,
            answers: READS_5,
            does: WRITES_3,
        },
    ),
    &part(
        "bq40z50-r5",
        &TiPart {
            device_name: "bq40z50-R5",
            device_type: 0x4500,
            version: 0x0505,
            build: 41,
            answers_at: BLOCKS,
            answers: READS_6,
            does: WRITES_3,
        },
    ),
    &part(
        "bq40z80",
        &TiPart {
            device_name: "bq40z80",
            device_type: 0x4800,
            version: 0x0101,
            build: 25,
            answers_at: BLOCKS,
            answers: READS_3,
            does: WRITES_4,
        },
    ),
    &part(
        "bq4050",
        &TiPart {
            device_name: "BQ4050",
            device_type: 0x9E34,
            version: 0x0001,
            build: 22,
            answers_at: BLOCKS,
            answers: READS_7,
            does: WRITES_5,
        },
    ),
    &part(
        "bq30z50",
        &TiPart {
            device_name: "bq30z50",
            device_type: 0x0500,
            version: 0x0036,
            build: 52,
            answers_at: &[0x23],
            answers: READS_8,
            does: WRITES_6,
        },
    ),
    &part(
        "bq30z55",
        &TiPart {
            device_name: "bq30z55",
            device_type: 0x0550,
            version: 0x0036,
            build: 52,
            answers_at: &[0x23],
            answers: READS_8,
            does: WRITES_6,
        },
    ),
    &part(
        "bq30z554",
        &TiPart {
            device_name: "bq30z554",
            device_type: 0x0554,
            version: 0x0036,
            build: 52,
            answers_at: &[0x23],
            answers: READS_8,
            does: WRITES_7,
        },
    ),
    &part(
        "bq78350",
        &TiPart {
            device_name: "bq78350",
            device_type: 0x1E9B,
            version: 0x0105,
            build: 20,
            answers_at: BLOCKS,
            answers: READS_9,
            does: WRITES_8,
        },
    ),
    &part(
        "bq20z45",
        &TiPart {
            device_name: "bq20z451",
            device_type: 0x0450,
            version: 0x0110,
            build: 0,
            answers_at: &[0x00],
            answers: READS_10,
            does: WRITES_9,
        },
    ),
    &part(
        "bq20z65",
        &TiPart {
            device_name: "bq20z65",
            device_type: 0x0650,
            version: 0x0110,
            build: 0,
            answers_at: &[0x00],
            answers: READS_10,
            does: WRITES_9,
        },
    ),
];

const fn part(name: &'static str, ti: &'static TiPart) -> Part {
    Part { name, image: &[], timing: Timing::USUAL, scheme: Scheme::Smbus(Some(ti)), rewrites: &[] }
}

// What each answers, with how many bytes, and what does something and must not be sent.
#[rustfmt::skip]
static READS_1: &[(u16, usize)] = &[
    (0x0001, 2), (0x0002, 11), (0x0003, 2), (0x0004, 2), (0x0005, 2), (0x0006, 2), (0x0008, 2), (0x0009, 2),
    (0x0050, 4), (0x0051, 4), (0x0052, 4), (0x0053, 4), (0x0054, 4), (0x0055, 3), (0x0056, 3), (0x0057, 2),
    (0x0058, 21), (0x0060, 32), (0x0061, 8), (0x0062, 16), (0x0063, 32), (0x0064, 32), (0x0070, 32), (0x0071, 32),
    (0x0072, 14), (0x0073, 32), (0x0074, 32), (0x0075, 24), (0x0076, 18), (0x0077, 4), (0x0078, 8),
];

#[rustfmt::skip]
static WRITES_1: &[u16] = &[
    0x0010, 0x0011, 0x0013, 0x001D, 0x001E, 0x001F, 0x0020, 0x0021, 0x0022, 0x0023, 0x0024, 0x0025, 0x0026, 0x0027,
    0x0028, 0x0029, 0x002A, 0x002B, 0x002C, 0x002D, 0x002E, 0x002F, 0x0030, 0x0033, 0x0035, 0x0037, 0x0041, 0x0414,
    0x043D, 0x0F00, 0x23A7, 0x270C, 0x3672, 0xF080, 0xF081, 0xF082, 0xFFFF,
];

#[rustfmt::skip]
static READS_2: &[(u16, usize)] = &[
    (0x0001, 2), (0x0002, 11), (0x0003, 2), (0x0004, 2), (0x0005, 2), (0x0006, 2), (0x0008, 2), (0x0009, 2),
    (0x0050, 4), (0x0051, 4), (0x0052, 4), (0x0053, 4), (0x0054, 4), (0x0055, 3), (0x0056, 3), (0x0057, 2),
    (0x0058, 21), (0x005F, 4), (0x0060, 32), (0x0061, 8), (0x0062, 16), (0x0063, 32), (0x0064, 32), (0x0070, 32),
    (0x0071, 32), (0x0072, 14), (0x0073, 32), (0x0074, 32), (0x0075, 24), (0x0076, 18), (0x0077, 4), (0x0078, 8),
    (0x007A, 4),
];

#[rustfmt::skip]
static READS_3: &[(u16, usize)] = &[
    (0x0001, 2), (0x0002, 11), (0x0003, 2), (0x0004, 2), (0x0005, 2), (0x0006, 2), (0x0008, 2), (0x0009, 2),
    (0x0050, 4), (0x0051, 4), (0x0052, 4), (0x0053, 4), (0x0054, 4), (0x0055, 3), (0x0056, 3), (0x0057, 2),
    (0x0058, 21), (0x005A, 4), (0x0060, 32), (0x0061, 8), (0x0062, 16), (0x0063, 32), (0x0064, 32), (0x0070, 32),
    (0x0071, 32), (0x0072, 16), (0x0073, 32), (0x0074, 32), (0x0075, 24), (0x0076, 18), (0x0077, 4), (0x0078, 8),
    (0x007A, 4),
];

#[rustfmt::skip]
static WRITES_2: &[u16] = &[
    0x0010, 0x0011, 0x0013, 0x001D, 0x001E, 0x001F, 0x0020, 0x0021, 0x0022, 0x0023, 0x0024, 0x0025, 0x0026, 0x0027,
    0x0028, 0x0029, 0x002A, 0x002B, 0x002C, 0x002D, 0x002E, 0x002F, 0x0030, 0x0033, 0x0035, 0x0037, 0x0041, 0x0079,
    0x00F0, 0x00F1, 0x00F2, 0x0414, 0x043D, 0x0F00, 0x23A7, 0x270C, 0x3008, 0x3672, 0xF080, 0xF081, 0xF082, 0xFFFF,
];

#[rustfmt::skip]
static READS_4: &[(u16, usize)] = &[
    (0x0001, 2), (0x0002, 11), (0x0003, 1), (0x0004, 1), (0x0005, 2), (0x0006, 1), (0x0008, 2), (0x0009, 2),
    (0x0050, 4), (0x0051, 4), (0x0052, 4), (0x0053, 4), (0x0054, 4), (0x0055, 4), (0x0056, 4), (0x0057, 2),
    (0x0058, 21), (0x0060, 32), (0x0061, 20), (0x0062, 4), (0x0063, 32), (0x0064, 32), (0x0065, 32), (0x0066, 32),
    (0x0067, 32), (0x0068, 32), (0x0069, 32), (0x006A, 32), (0x006B, 32), (0x0070, 32), (0x0071, 32), (0x0072, 26),
    (0x0073, 32), (0x0074, 32), (0x0075, 24), (0x0076, 19), (0x0077, 4), (0x0078, 8), (0x007A, 4),
];

#[rustfmt::skip]
static WRITES_3: &[u16] = &[
    0x0010, 0x0011, 0x0013, 0x001D, 0x001E, 0x001F, 0x0020, 0x0021, 0x0022, 0x0023, 0x0024, 0x0025, 0x0026, 0x0027,
    0x0028, 0x0029, 0x002A, 0x002B, 0x002C, 0x002D, 0x002E, 0x002F, 0x0030, 0x0041, 0x0F00, 0xF080, 0xF081, 0xF082,
];

#[rustfmt::skip]
static READS_5: &[(u16, usize)] = &[
    (0x0001, 2), (0x0002, 11), (0x0003, 1), (0x0004, 1), (0x0005, 2), (0x0006, 1), (0x0008, 2), (0x0009, 2),
    (0x0050, 4), (0x0051, 4), (0x0052, 4), (0x0053, 4), (0x0054, 4), (0x0055, 4), (0x0056, 4), (0x0057, 2),
    (0x0058, 21), (0x0060, 26), (0x0061, 20), (0x0062, 4), (0x0063, 32), (0x0064, 32), (0x0065, 32), (0x0066, 32),
    (0x0067, 32), (0x0068, 32), (0x0069, 32), (0x006A, 32), (0x006B, 32), (0x006C, 30), (0x006D, 30), (0x006E, 30),
    (0x006F, 4), (0x0070, 32), (0x0071, 32), (0x0072, 26), (0x0073, 32), (0x0074, 32), (0x0075, 24), (0x0076, 19),
    (0x0077, 4), (0x0078, 8), (0x007A, 32),
];

#[rustfmt::skip]
static READS_6: &[(u16, usize)] = &[
    (0x0001, 2), (0x0002, 11), (0x0003, 1), (0x0004, 1), (0x0005, 2), (0x0006, 1), (0x0008, 2), (0x0009, 2),
    (0x0050, 4), (0x0051, 4), (0x0052, 4), (0x0053, 4), (0x0054, 4), (0x0055, 5), (0x0056, 4), (0x0057, 2),
    (0x0058, 21), (0x0060, 26), (0x0061, 20), (0x0062, 4), (0x0063, 32), (0x0064, 32), (0x0065, 32), (0x0066, 32),
    (0x0067, 32), (0x0068, 32), (0x0069, 32), (0x006A, 32), (0x006B, 32), (0x006C, 30), (0x006D, 30), (0x006E, 30),
    (0x006F, 4), (0x0070, 32), (0x0071, 32), (0x0072, 26), (0x0073, 32), (0x0074, 32), (0x0075, 32), (0x0076, 19),
    (0x0077, 4), (0x0078, 8), (0x007A, 32), (0x007E, 32),
];

#[rustfmt::skip]
static WRITES_4: &[u16] = &[
    0x0010, 0x0011, 0x0013, 0x001C, 0x001D, 0x001E, 0x001F, 0x0020, 0x0021, 0x0022, 0x0023, 0x0024, 0x0025, 0x0026,
    0x0027, 0x0028, 0x0029, 0x002A, 0x002B, 0x002C, 0x002D, 0x002E, 0x002F, 0x0030, 0x0035, 0x0037, 0x0041, 0x0079,
    0x007B, 0x007C, 0x007D, 0x0080, 0x0081, 0x0082, 0x00F0, 0x00F1, 0x00F2, 0x00F3, 0x0F00, 0x3008, 0xF080, 0xF081,
    0xF082, 0xF083,
];

#[rustfmt::skip]
static READS_7: &[(u16, usize)] = &[
    (0x0001, 2), (0x0002, 11), (0x0003, 2), (0x0004, 2), (0x0005, 2), (0x0009, 2), (0x0050, 4), (0x0051, 4),
    (0x0052, 4), (0x0053, 4), (0x0054, 4), (0x0055, 2), (0x0056, 2), (0x0057, 2), (0x0058, 21), (0x0060, 32),
    (0x0061, 8), (0x0062, 16), (0x0063, 32), (0x0064, 20), (0x0070, 32), (0x0071, 32), (0x0072, 14), (0x007A, 32),
];

#[rustfmt::skip]
static WRITES_5: &[u16] = &[
    0x0010, 0x0011, 0x001D, 0x001E, 0x001F, 0x0020, 0x0022, 0x0023, 0x0024, 0x0025, 0x0026, 0x0027, 0x0028, 0x0029,
    0x002A, 0x002B, 0x002C, 0x002D, 0x002E, 0x002F, 0x0030, 0x0033, 0x0035, 0x0037, 0x0041, 0x0414, 0x043D, 0x0F00,
    0x23A7, 0x270C, 0x3672, 0xF080, 0xF081, 0xF082, 0xFFFF,
];

#[rustfmt::skip]
static READS_8: &[(u16, usize)] = &[
    (0x0001, 2), (0x0002, 11), (0x0003, 2), (0x0006, 2), (0x0050, 4), (0x0051, 4), (0x0052, 4), (0x0053, 4),
    (0x0054, 4), (0x0055, 2), (0x0056, 2), (0x0057, 2), (0x0058, 12), (0x0060, 32), (0x0061, 27), (0x0062, 16),
    (0x0070, 32), (0x0071, 12), (0x0072, 14), (0x0073, 30), (0x0074, 30),
];

#[rustfmt::skip]
static WRITES_6: &[u16] = &[
    0x0010, 0x0011, 0x0012, 0x001D, 0x001E, 0x001F, 0x0020, 0x0021, 0x0022, 0x0024, 0x0026, 0x0029, 0x0030, 0x0031,
    0x0032, 0x0033, 0x0034, 0x0035, 0x0036, 0x0037,
];

#[rustfmt::skip]
static WRITES_7: &[u16] = &[
    0x0010, 0x0011, 0x0012, 0x001D, 0x001E, 0x001F, 0x0020, 0x0021, 0x0022, 0x0024, 0x0026, 0x0029, 0x0030, 0x0031,
    0x0032, 0x0033, 0x0034, 0x0035, 0x0036, 0x0037, 0x043D, 0x23A7, 0x270C,
];

#[rustfmt::skip]
static READS_9: &[(u16, usize)] = &[
    (0x0001, 2), (0x0002, 11), (0x0003, 2), (0x0004, 2), (0x0006, 2), (0x0050, 4), (0x0051, 4), (0x0052, 2),
    (0x0053, 4), (0x0054, 4), (0x0055, 2), (0x0056, 2), (0x0057, 2), (0x0058, 2), (0x0060, 32), (0x0065, 4),
];

#[rustfmt::skip]
static WRITES_8: &[u16] = &[
    0x0010, 0x0011, 0x001B, 0x001C, 0x0037, 0x0041,
];

#[rustfmt::skip]
static READS_10: &[(u16, usize)] = &[
    (0x0001, 2), (0x0002, 2), (0x0003, 2), (0x0006, 2), (0x0008, 2), (0x0050, 2), (0x0051, 2), (0x0052, 2),
    (0x0053, 2), (0x0054, 2), (0x0055, 2), (0x0057, 2), (0x0058, 2), (0x005A, 2), (0x005D, 2),
];

#[rustfmt::skip]
static WRITES_9: &[u16] = &[
    0x0010, 0x0011, 0x0020, 0x0041, 0x0414, 0x1712, 0x2673, 0x3672, 0xFFFF,
];
