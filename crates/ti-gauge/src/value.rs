// SPDX-License-Identifier: MIT

//! Data-flash types and values.

use std::fmt;

/// The type of a parameter as TI's manuals name it: a letter for the kind and the number of bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Type {
    /// A signed integer of this many bytes, two's complement.
    I(u8),
    /// An unsigned integer of this many bytes.
    U(u8),
    /// A bit field or code of this many bytes, shown in hexadecimal.
    H(u8),
    /// TI's four-byte floating-point number, which is not IEEE 754.
    F4,
    /// A string of this many bytes, with its length in the first.
    S(u8),
}

impl Type {
    /// Bytes in data flash.
    pub const fn size(self) -> usize {
        match self {
            Type::I(n) | Type::U(n) | Type::H(n) | Type::S(n) => n as usize,
            Type::F4 => 4,
        }
    }

    /// The smallest and the largest integer of the type; `None` for `F4` and strings.
    pub const fn bounds(self) -> Option<(i64, i64)> {
        match self {
            Type::I(n) => Some((-(1 << (8 * n - 1)), (1 << (8 * n - 1)) - 1)),
            Type::U(n) | Type::H(n) => Some((0, (1 << (8 * n)) - 1)),
            Type::F4 | Type::S(_) => None,
        }
    }
}

impl fmt::Display for Type {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Type::I(n) => write!(f, "I{n}"),
            Type::U(n) => write!(f, "U{n}"),
            Type::H(n) => write!(f, "H{n}"),
            Type::F4 => f.write_str("F4"),
            Type::S(n) => write!(f, "S{n}"),
        }
    }
}

/// The types as the manuals write them, for the tables.
pub mod types {
    use super::Type;

    /// One signed byte.
    pub const I1: Type = Type::I(1);
    /// Two signed bytes.
    pub const I2: Type = Type::I(2);
    /// Four signed bytes.
    pub const I4: Type = Type::I(4);
    /// One unsigned byte.
    pub const U1: Type = Type::U(1);
    /// Two unsigned bytes.
    pub const U2: Type = Type::U(2);
    /// Four unsigned bytes.
    pub const U4: Type = Type::U(4);
    /// One byte in hexadecimal.
    pub const H1: Type = Type::H(1);
    /// Two bytes in hexadecimal.
    pub const H2: Type = Type::H(2);
    /// Four bytes in hexadecimal.
    pub const H4: Type = Type::H(4);
}

/// A data-flash value, decoded.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// Of a type `I`, `U` or `H`.
    Int(i64),
    /// Of type `F4`.
    Float(f64),
    /// Of a type `S`: the bytes after the length, which need not be printable.
    Text(Vec<u8>),
}
