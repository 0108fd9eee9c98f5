// SPDX-License-Identifier: MIT

//! The kernel's `simple-battery` node (Documentation/devicetree/bindings/power/supply/battery.yaml): as the source of a
//! device tree, and as the folder that the kernel shows of it.

use super::battery::{Battery, Chemistry};
use crate::codec::Layout;
use crate::value::Value;
use crate::value::types::U4;

const COMPATIBLE: &str = "simple-battery";

/// A property with its bytes as a compiled tree has them: numbers of 32 bits, most significant byte first, or a text that ends
/// with a zero.
type Property = (String, Vec<u8>);

/// Whether a text is a device tree's.
pub fn is_source(text: &str) -> bool {
    text.contains(COMPATIBLE) || text.contains("-microamp-hours")
}

impl Battery {
    /// Of the one `simple-battery` node of a source, or of its properties alone.
    pub fn from_source(text: &str) -> Result<Self, String> {
        Self::from_node(&node(text)?)
    }

    /// Of the properties of a node. A tree does not say how many cells there are, and often not the chemistry: the number
    /// follows from a voltage, and lithium-ion is taken.
    pub fn from_node(properties: &[(String, Vec<u8>)]) -> Result<Self, String> {
        let find = |name: &str| properties.iter().find(|(known, _)| known == name).map(|(_, bytes)| &**bytes);
        let number = |name: &str| match find(name).map(<[u8; 4]>::try_from) {
            None => Ok(None),
            Some(Ok(bytes)) => Ok(Some(decoded(&bytes) / 1000.0)),
            Some(Err(_)) => Err(format!("{name}: not one number of 32 bits")),
        };
        let text = |name: &str| {
            find(name).map(|bytes| String::from_utf8_lossy(bytes).trim_end_matches('\0').to_string())
        };
        if text("compatible").is_some_and(|value| !value.split('\0').any(|one| one == COMPATIBLE)) {
            return Err(format!("the node is not a {COMPATIBLE}"));
        }
        let named = text("device-chemistry");
        let name = named.as_deref().unwrap_or("lithium-ion");
        let chemistry = Chemistry::by_name(name)
            .ok_or_else(|| format!("device-chemistry: {} is unknown", crate::text::printable(name)))?;
        let charge = "constant-charge-voltage-max-microvolt";
        let full = number(charge)?.or(number("voltage-max-design-microvolt")?);
        let empty = number("voltage-min-design-microvolt")?;
        let of_cell = chemistry.charge.map_or(chemistry.nominal.usual, |charge| charge.usual);
        let count = full.map(|mv| mv / f64::from(of_cell));
        let count = count.or(empty.map(|mv| mv / f64::from(chemistry.terminate.usual)));
        let count = count
            .ok_or("it lacks voltage-max-design-microvolt, by which the cells are counted")?
            .round()
            .max(1.0);
        let capacity = "charge-full-design-microamp-hours";
        let battery = Self {
            chemistry,
            is_assumed: named.is_none(),
            series: count.min(100.0) as u8,
            parallel: 1,
            capacity_mah: number(capacity)?.ok_or_else(|| format!("it lacks {capacity}"))?,
            energy_mwh: number("energy-full-design-microwatt-hours")?,
            charge_mv: full.map(|mv| mv / count).filter(|_| chemistry.charge.is_some()),
            taper_ma: number("charge-term-current-microamp")?,
            terminate_mv: empty.map(|mv| mv / count),
        };
        battery.checked()
    }
}

/// The properties of the `simple-battery` node in a source; of all of it, if it has no node.
fn node(text: &str) -> Result<Vec<Property>, String> {
    let text = without_comments(text);
    let (mut open, mut found, mut lone): (Vec<Vec<Property>>, Vec<Vec<Property>>, Vec<Property>) =
        Default::default();
    let mut from = 0;
    for (at, letter) in text.match_indices(['{', '}', ';']) {
        let statement = text[from..at].trim();
        from = at + 1;
        match letter {
            "{" => open.push(Vec::new()),
            "}" => found.extend(open.pop()),
            _ => open.last_mut().unwrap_or(&mut lone).extend(property(statement)?),
        }
    }
    if found.is_empty() && open.is_empty() {
        return Ok(lone);
    }
    found.retain(|node| {
        node.iter().any(|(name, value)| name == "compatible" && value.starts_with(COMPATIBLE.as_bytes()))
    });
    match (found.pop(), found.is_empty()) {
        (Some(node), true) => Ok(node),
        (Some(_), false) => Err(format!("it has several nodes with compatible = \"{COMPATIBLE}\"; keep one")),
        (None, _) => Err(format!("it has no whole node with compatible = \"{COMPATIBLE}\"")),
    }
}

/// A number as a compiled tree has it, in the order of TI's data flash.
fn encoded(number: u32) -> Vec<u8> {
    Layout::TI.encode(U4, &Value::Int(number.into())).unwrap_or_default()
}

fn decoded(bytes: &[u8; 4]) -> f64 {
    match Layout::TI.decode(U4, bytes) {
        Value::Int(number) => number as f64,
        Value::Float(_) | Value::Text(_) => f64::NAN,
    }
}

fn without_comments(text: &str) -> String {
    let (mut plain, mut rest) = (String::new(), text);
    while let Some(at) = rest.find("/*").into_iter().chain(rest.find("//")).min() {
        plain += &rest[..at];
        let end = if rest[at..].starts_with("/*") { "*/" } else { "\n" };
        rest = rest[at..].split_once(end).map_or("", |(_, rest)| rest);
        plain.push(' ');
    }
    plain + rest
}

/// `name = <number>` or `name = "text"`; `None` for what is neither, such as a table.
fn property(statement: &str) -> Result<Option<Property>, String> {
    let Some((name, value)) = statement.split_once('=') else { return Ok(None) };
    let (name, value) = (name.trim(), value.trim());
    if let Some(text) = value.strip_prefix('"').and_then(|value| value.strip_suffix('"')) {
        return Ok(Some((name.into(), [text.as_bytes(), b"\0"].concat())));
    }
    let Some(cells) = value.strip_prefix('<').and_then(|value| value.strip_suffix('>')) else {
        return Ok(None);
    };
    let read = |word: &str| match word.strip_prefix("0x") {
        Some(digits) => u32::from_str_radix(digits, 16),
        None => word.parse(),
    };
    match read(cells.trim()) {
        Ok(number) => Ok(Some((name.into(), encoded(number)))),
        // An expression, or several numbers: only what is needed must be plain.
        Err(_) => Ok(Some((name.into(), Vec::new()))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NODE: &str = "
/ {
    bat: battery {
        compatible = \"simple-battery\"; // the binding's
        device-chemistry = \"lithium-ion-polymer\";
        charge-full-design-microamp-hours = <5200000>; /* all
           of it */
        voltage-max-design-microvolt = <0xc042c0>;
        voltage-min-design-microvolt = <9000000>;
        charge-term-current-microamp = <260000>;
        ocv-capacity-celsius = <(-10) 0 10>;
        ocv-capacity-table-0 = <4185000 100>, <4113000 95>;
    };
    other { compatible = \"ti,bq34z100\"; };
};";

    #[test]
    fn the_source_of_a_tree_is_read() {
        let battery = Battery::from_source(NODE).expect("a battery");
        assert_eq!(
            battery.to_string(),
            "li-ion 3s 5200mAh charge-voltage=4200mV taper-current=260mA terminate-voltage=3000mV"
        );
        assert!(!battery.is_assumed && is_source(NODE));
        // The lines alone, as the binding of ti,bq27xxx shows them.
        let lines = "voltage-min-design-microvolt = <3200000>;\nenergy-full-design-microwatt-hours = <5290000>;\n\
                     charge-full-design-microamp-hours = <1430000>;\n";
        let battery = Battery::from_source(lines).expect("a battery");
        assert_eq!(battery.to_string(), "li-ion 1s 1430mAh energy=5290mWh terminate-voltage=3200mV");
        assert!(battery.is_assumed && is_source(lines));
    }

    #[test]
    fn a_compiled_node_is_read() {
        let number = |name: &str, value: u32| (name.to_string(), encoded(value));
        let mut node = vec![
            ("compatible".into(), b"simple-battery\0".to_vec()),
            ("device-chemistry".into(), b"lithium-ion-iron-phosphate\0".to_vec()),
            number("charge-full-design-microamp-hours", 20_000_000),
            number("constant-charge-voltage-max-microvolt", 57_600_000),
            number("phandle", 7),
        ];
        assert_eq!(
            Battery::from_node(&node).expect("a battery").to_string(),
            "lifepo4 16s 20000mAh charge-voltage=3600mV"
        );
        node[0].1 = b"ti,bq34z100\0".to_vec();
        assert_eq!(Battery::from_node(&node), Err("the node is not a simple-battery".into()));
    }

    #[test]
    fn what_is_wrong_with_a_node_is_named() {
        let two = format!("{NODE}{NODE}");
        for (text, says) in [
            ("/ { };", "it has no whole node with compatible = \"simple-battery\""),
            (&*two, "it has several nodes with compatible = \"simple-battery\"; keep one"),
            (
                "device-chemistry = \"lithium-ion\";",
                "it lacks voltage-max-design-microvolt, by which the cells are counted",
            ),
            ("voltage-max-design-microvolt = <4200000>;", "it lacks charge-full-design-microamp-hours"),
            (
                "voltage-max-design-microvolt = <4200000>; charge-full-design-microamp-hours = <(2 * 1000)>;",
                "charge-full-design-microamp-hours: not one number of 32 bits",
            ),
            ("device-chemistry = \"gold\";", "device-chemistry: gold is unknown"),
        ] {
            assert_eq!(Battery::from_source(text), Err(says.into()), "{text}");
        }
    }
}
