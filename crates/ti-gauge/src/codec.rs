// SPDX-License-Identifier: MIT

//! Bytes to values and back, and the checksum of a block. Pure: no bus, no text. Which byte of a number comes first is
//! known here and to the formats of files only.

use crate::value::{Type, Value};

/// Bytes in the block-access window.
pub const WINDOW: usize = 32;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Bytes(pub(crate) u32);

impl Bytes {
    pub(crate) fn of(is: impl Fn(usize) -> bool) -> Self {
        Self((0..WINDOW).filter(|&at| is(at)).fold(0, |set, at| set | 1 << at))
    }

    pub(crate) fn has(self, at: usize) -> bool {
        self.0 >> at & 1 != 0
    }

    pub(crate) fn iter(self) -> impl Iterator<Item = usize> {
        (0..WINDOW).filter(move |&at| self.has(at))
    }

    pub(crate) fn insert(&mut self, at: usize) {
        self.0 |= 1 << at;
    }

    pub(crate) fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    pub(crate) fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }
}

/// BlockDataChecksum(): 255 less the sum of the window's bytes modulo 256 (SLUSBZ5D 7.3.3.1).
pub fn checksum(bytes: &[u8]) -> u8 {
    255 - bytes.iter().fold(0u8, |sum, &byte| sum.wrapping_add(byte))
}

/// What MACDataLen() counts besides the data: the address, the sum and itself.
pub const MAC_OVERHEAD: usize = 4;

/// MACDataSum(): 255 less the sum of the bytes of address and data modulo 256 (SLUA790 3).
pub fn mac_sum(address: u16, data: &[u8]) -> u8 {
    let [low, high] = address.to_le_bytes();
    checksum(data).wrapping_sub(low).wrapping_sub(high)
}

/// Temperature() at 0 °C, in 0.1 K, rounded as in the kernel's driver.
pub const FREEZING: i64 = 2731;

/// Which byte of a number comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// The most significant one.
    Big,
    /// The least significant one.
    Little,
}

impl Order {
    pub(crate) fn number(self, bytes: &[u8]) -> i64 {
        let add = |sum: i64, &byte: &u8| sum << 8 | i64::from(byte);
        match self {
            Order::Big => bytes.iter().fold(0, add),
            Order::Little => bytes.iter().rev().fold(0, add),
        }
    }
}

/// The format of floating-point numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Float {
    /// TI's older one, which is not IEEE 754.
    TiF4,
    /// IEEE 754 of single precision.
    Ieee,
}

/// How a part stores numbers in data flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Which of their bytes comes first.
    pub order: Order,
    /// What those with a fraction are.
    pub float: Float,
}

impl Layout {
    /// That of most of TI's gauges.
    pub const TI: Self = Self { order: Order::Big, float: Float::TiF4 };

    /// The value stored in data flash as `bytes`, whose number must be the type's size.
    pub fn decode(self, kind: Type, bytes: &[u8]) -> Value {
        debug_assert_eq!(bytes.len(), kind.size());
        match kind {
            Type::U(_) | Type::H(_) => Value::Int(self.number(bytes)),
            Type::I(size) => {
                let (raw, span) = (self.number(bytes), 1i64 << (8 * size));
                Value::Int(if raw >= span / 2 { raw - span } else { raw })
            }
            Type::F4 => {
                let bits = self.number(bytes) as u32;
                Value::Float(match self.float {
                    Float::TiF4 => decode_f4(bits.to_be_bytes()),
                    Float::Ieee => f32::from_bits(bits).into(),
                })
            }
            Type::S(_) => Value::Text(text(bytes).to_vec()),
        }
    }

    /// The bytes of a value in data flash; `None` if the value does not fit the type.
    pub fn encode(self, kind: Type, value: &Value) -> Option<Vec<u8>> {
        match (kind, value) {
            (Type::I(size) | Type::U(size) | Type::H(size), Value::Int(value)) => {
                let (min, max) = kind.bounds()?;
                (min..=max).contains(value).then(|| self.bytes(*value, size.into()))
            }
            (Type::F4, Value::Float(value)) => {
                let bits = match self.float {
                    Float::TiF4 => u32::from_be_bytes(encode_f4(*value)?),
                    Float::Ieee => Some(*value as f32).filter(|single| single.is_finite())?.to_bits(),
                };
                Some(self.bytes(bits.into(), 4))
            }
            (Type::S(size), Value::Text(text)) => {
                let room = usize::from(size) - 1;
                (text.len() <= room).then(|| {
                    let mut bytes = vec![0; room + 1];
                    bytes[0] = text.len() as u8;
                    bytes[1..=text.len()].copy_from_slice(text);
                    bytes
                })
            }
            _ => None,
        }
    }

    /// The number without a sign that bytes are, at most seven.
    pub fn number(self, bytes: &[u8]) -> i64 {
        self.order.number(bytes)
    }

    /// The word that two bytes are.
    pub fn word(self, bytes: [u8; 2]) -> u16 {
        self.number(&bytes) as u16
    }

    fn bytes(self, number: i64, size: usize) -> Vec<u8> {
        let mut bytes = number.to_le_bytes()[..size].to_vec();
        if self.order == Order::Big {
            bytes.reverse();
        }
        bytes
    }

    /// The two bytes of a word.
    pub fn bytes_of(self, word: u16) -> [u8; 2] {
        match self.order {
            Order::Big => word.to_be_bytes(),
            Order::Little => word.to_le_bytes(),
        }
    }

    /// How far byte `at` of a number of `size` bytes is from its lowest bit, in bits.
    pub fn shift(self, size: usize, at: usize) -> usize {
        match self.order {
            Order::Big => 8 * (size - 1 - at),
            Order::Little => 8 * at,
        }
    }
}

/// A number as both formats of [`Float`] hold it, with 24 bits: those of a `f64` that remain.
pub(crate) fn rounded(value: f64) -> f64 {
    const DROPPED: u32 = f64::MANTISSA_DIGITS - 24;
    f64::from_bits(value.to_bits().wrapping_add(1 << (DROPPED - 1)) & (u64::MAX << DROPPED))
}

/// The characters of a string, whose first byte is its length.
pub(crate) fn text(bytes: &[u8]) -> &[u8] {
    let length = usize::from(bytes[0]).min(bytes.len() - 1);
    &bytes[1..=length]
}

/// TI's older floating-point format, which is not IEEE 754: an exponent biased by 128, then 24 bits of
/// mantissa between 0.5 and 1 whose leading one is not stored, the sign in its place. Zero has no code;
/// gauges store it as four zero bytes, which the formula would read as 2^-129.
fn decode_f4(bytes: [u8; 4]) -> f64 {
    if bytes == [0; 4] {
        return 0.0;
    }
    let mantissa = f64::from(u32::from_be_bytes([0, bytes[1] | 0x80, bytes[2], bytes[3]]));
    let magnitude = mantissa * 2f64.powi(i32::from(bytes[0]) - 128 - 24);
    if bytes[1] & 0x80 == 0 { magnitude } else { -magnitude }
}

fn encode_f4(value: f64) -> Option<[u8; 4]> {
    if value == 0.0 {
        return Some([0; 4]);
    }
    if !value.is_finite() {
        return None;
    }
    // Found by scaling, not by a logarithm, which is off by one at exact powers of two.
    let (mut mantissa, mut exponent) = (value.abs(), 0i32);
    while mantissa >= 1.0 {
        mantissa /= 2.0;
        exponent += 1;
    }
    while mantissa < 0.5 {
        mantissa *= 2.0;
        exponent -= 1;
    }
    let mut bits = (mantissa * f64::from(1 << 24)).round() as u32;
    if bits == 1 << 24 {
        bits = 1 << 23;
        exponent += 1;
    }
    let [_, high, middle, low] = bits.to_be_bytes();
    let sign = if value < 0.0 { 0x80 } else { 0 };
    let exponent = u8::try_from(exponent + 128).ok()?;
    Some([exponent, high & 0x7f | sign, middle, low])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Every type that a table may name, with bytes of its size.
    fn stored() -> impl Strategy<Value = (Type, Vec<u8>)> {
        let size = || prop::sample::select(vec![1u8, 2, 4]);
        let kind = prop_oneof![
            size().prop_map(Type::I),
            size().prop_map(Type::U),
            size().prop_map(Type::H),
            Just(Type::F4),
            (1u8..=32).prop_map(Type::S),
        ];
        kind.prop_flat_map(|kind| (Just(kind), prop::collection::vec(any::<u8>(), kind.size())))
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 2048, failure_persistence: None, ..ProptestConfig::default() })]

        /// Of a string, the bytes after its end may change.
        #[test]
        #[cfg_attr(miri, ignore = "it tries so many values that it takes hours there")]
        fn what_is_decoded_encodes_to_the_same_value((kind, bytes) in stored()) {
            let value = Layout::TI.decode(kind, &bytes);
            let again = Layout::TI.encode(kind, &value).expect("a decoded value fits its type");
            prop_assert_eq!(Layout::TI.decode(kind, &again), value);
            if !matches!(kind, Type::S(_)) {
                prop_assert_eq!(&again, &bytes);
            }
            if !matches!(kind, Type::S(_) | Type::F4) {
                let value = LITTLE.decode(kind, &bytes);
                prop_assert_eq!(LITTLE.encode(kind, &value), Some(bytes.clone()));
                let turned: Vec<u8> = bytes.into_iter().rev().collect();
                prop_assert_eq!(Layout::TI.decode(kind, &turned), value);
            }
        }
    }

    /// Vectors seen on silicon or printed by TI (SLUSBZ5D table 7-12 and TI's forum), and edges.
    #[test]
    fn f4_as_the_gauge_stores_it() {
        for (bytes, value) in [
            ([0x7f, 0x71, 0x20, 0x5c], 0.47095),
            ([0x94, 0x08, 0x98, 0xc0], 559_500.0),
            ([0x94, 0x08, 0xa0, 0xde], 559_629.875),
            ([0x7b, 0x1f, 0xbe, 0x77], 0.019_500_000_4),
            ([0x7e, 0x00, 0x00, 0x00], 0.125),
            ([0x7f, 0x74, 0x1f, 0x21], 0.4768),
            ([0x94, 0x0a, 0x9c, 0x09], 567_744.562_5),
            ([0x7d, 0x4c, 0xcc, 0xcd], 0.1),
            ([0x86, 0x20, 0x00, 0x00], 40.0),
            ([0x80, 0x00, 0x00, 0x00], 0.5),
            ([0x81, 0x00, 0x00, 0x00], 1.0),
            ([0x81, 0x80, 0x00, 0x00], -1.0),
            ([0x00, 0x00, 0x00, 0x00], 0.0),
        ] {
            let Value::Float(read) = Layout::TI.decode(Type::F4, &bytes) else { panic!("F4 is a float") };
            assert!((read - value).abs() <= value.abs() * 1e-7, "{bytes:02x?} reads {read}, not {value}");
            assert_eq!(
                Layout::TI.encode(Type::F4, &Value::Float(value)).as_deref(),
                Some(&bytes[..]),
                "{value}"
            );
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "it tries so many values that it takes hours there")]
    fn every_f4_code_reads_back_to_itself() {
        for high in 0..=u16::MAX {
            let [exponent, mantissa] = high.to_be_bytes();
            for low in [0x0000u16, 0x0001, 0x7fff, 0xffff] {
                let bytes = [exponent, mantissa, low.to_be_bytes()[0], low.to_be_bytes()[1]];
                let value = Layout::TI.decode(Type::F4, &bytes);
                assert_eq!(Layout::TI.encode(Type::F4, &value).as_deref(), Some(&bytes[..]), "{value:?}");
            }
        }
    }

    const LITTLE: Layout = Layout { order: Order::Little, float: Float::Ieee };

    /// What a published dump of a bq28z610 has at 0x4000 and at 0x4006.
    #[test]
    fn a_layout_has_its_own_order_of_bytes_and_format_of_floats() {
        assert_eq!(LITTLE.decode(Type::I(2), &[0x87, 0x2f]), Value::Int(12167));
        assert_eq!(LITTLE.encode(Type::I(2), &Value::Int(12167)), Some(vec![0x87, 0x2f]));
        let bytes = [0x7b, 0x09, 0xed, 0x3f];
        let Value::Float(gain) = LITTLE.decode(Type::F4, &bytes) else { panic!("F4 is a float") };
        assert!((gain - 1.852).abs() < 5e-4, "{gain}");
        assert_eq!(LITTLE.encode(Type::F4, &Value::Float(gain)), Some(bytes.to_vec()));
        assert_eq!(LITTLE.encode(Type::F4, &Value::Float(1e39)), None);
        assert_eq!(LITTLE.decode(Type::I(2), &[0x70, 0xfe]), Value::Int(-400));
        assert_eq!(LITTLE.encode(Type::H(4), &Value::Int(0x3672_0414)), Some(vec![0x14, 0x04, 0x72, 0x36]));
        assert_eq!((LITTLE.word([0x34, 0x12]), LITTLE.bytes_of(0x1234)), (0x1234, [0x34, 0x12]));
        assert_eq!((LITTLE.shift(2, 0), LITTLE.shift(2, 1)), (0, 8));
        assert_eq!((Layout::TI.word([0x12, 0x34]), Layout::TI.bytes_of(0x1234)), (0x1234, [0x12, 0x34]));
        assert_eq!((Layout::TI.shift(2, 0), Layout::TI.shift(2, 1)), (8, 0));
        // A string is the same in each of them.
        assert_eq!(LITTLE.decode(Type::S(5), b"\x04LION"), Layout::TI.decode(Type::S(5), b"\x04LION"));
        // TI's floats may stand in the other order as well.
        let turned = Layout { order: Order::Little, float: Float::TiF4 };
        assert_eq!(turned.decode(Type::F4, &[0, 0, 0, 0x80]), Value::Float(0.5));
    }

    #[test]
    fn a_number_is_rounded_to_what_a_float_of_four_bytes_holds() {
        for value in [0.0, 1.0, -1.0, 0.1, 1.0 / 3.0, 5677445.0, 2e38, 16_777_217.0, -16_777_219.0, 1e-30] {
            assert_eq!(rounded(value), rounded(rounded(value)));
            assert!((rounded(value) - value).abs() <= value.abs() * 6e-8, "{value}");
            let Some(bytes) = Layout::TI.encode(Type::F4, &Value::Float(value)) else { continue };
            assert_eq!(Layout::TI.decode(Type::F4, &bytes), Value::Float(rounded(value)), "{value}");
        }
    }

    #[test]
    fn integers_are_big_endian_twos_complement() {
        assert_eq!(Layout::TI.decode(Type::I(2), &[0xfe, 0x70]), Value::Int(-400));
        assert_eq!(Layout::TI.encode(Type::I(2), &Value::Int(-400)), Some(vec![0xfe, 0x70]));
        assert_eq!(Layout::TI.decode(Type::I(1), &[0xf6]), Value::Int(-10));
        assert_eq!(Layout::TI.decode(Type::H(4), &[0x36, 0x72, 0x04, 0x14]), Value::Int(0x3672_0414));
        assert_eq!(Layout::TI.encode(Type::U(1), &Value::Int(256)), None);
        assert_eq!(Layout::TI.encode(Type::I(1), &Value::Int(-129)), None);
    }

    /// SLUA790 section 2.4, example 2: the device chemistry becomes `PbA`, padded by zeros.
    #[test]
    fn strings_carry_their_length_first() {
        assert_eq!(Layout::TI.decode(Type::S(5), b"\x04LION"), Value::Text(b"LION".to_vec()));
        assert_eq!(Layout::TI.encode(Type::S(5), &Value::Text(b"PbA".to_vec())), Some(b"\x03PbA\0".to_vec()));
        assert_eq!(Layout::TI.encode(Type::S(5), &Value::Text(b"LiFePO4".to_vec())), None);
        assert_eq!(Layout::TI.decode(Type::S(5), b"\xffLION"), Value::Text(b"LION".to_vec()));
    }

    /// SLUSBZ5D 7.3.3.1 with the defaults of subclass 64.
    #[test]
    fn checksum_of_the_worked_example() {
        let mut block = [0; WINDOW];
        block[..8].copy_from_slice(&[0x01, 0x61, 0xff, 0x30, 0, 0, 0, 1]);
        assert_eq!(checksum(&block), 0x6d);
        block[0] |= 0x08;
        assert_eq!(checksum(&block), 0x65);
    }
}
