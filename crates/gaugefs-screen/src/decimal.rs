// SPDX-License-Identifier: MIT

//! Numbers for display.

/// An integer in units of 10^-`places` as an exact decimal with at least `least` places.
pub(super) fn decimal(value: i64, places: usize, least: usize) -> String {
    let digits = format!("{:0width$}", value.unsigned_abs(), width = places + 1);
    let (whole, fraction) = digits.split_at(digits.len() - places);
    let mut kept = fraction.trim_end_matches('0').len().max(least);
    kept = kept.min(places);
    let sign = if value < 0 { "-" } else { "" };
    let point = if kept > 0 { "." } else { "" };
    format!("{sign}{whole}{point}{}", &fraction[..kept])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimals_are_exact() {
        assert_eq!(decimal(3_855_000, 6, 3), "3.855");
        assert_eq!(decimal(-500, 6, 3), "-0.0005");
        assert_eq!(decimal(-5, 1, 1), "-0.5");
        assert_eq!(decimal(0, 6, 3), "0.000");
        assert_eq!(decimal(i64::MIN, 0, 0), i64::MIN.to_string());
    }
}
