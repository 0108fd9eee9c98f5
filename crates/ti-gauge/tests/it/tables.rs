// SPDX-License-Identifier: MIT

//! The tables of all chips: complete, free of overlaps, and as in the manuals.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::fmt::Debug;
use std::hash::Hash;

use gauge_bus::wire_bytes;
use ti_gauge::chip::bursts;
use ti_gauge::chip::{
    Answers, Bit, CHIPS, Chip, Effect, FLAT, Identity, Kind, Parameter, Range, Recognised, Role, SIBLINGS,
    Safe, Scale, Scaling, Scheme, SealStatus, Signature, Source, Subclass, Tier, kebab_case, recognise,
    snake_case,
};
use ti_gauge::codec::{self, WINDOW};
use ti_gauge::value::{Type, Value};

/// Fails with the first duplicate.
#[track_caller]
fn assert_unique<T: Eq + Hash + Debug>(what: &str, items: impl IntoIterator<Item = T>) {
    let mut seen = HashSet::new();
    for item in items {
        let text = format!("{what}: {item:?} twice");
        assert!(seen.insert(item), "{text}");
    }
}

/// Every parameter, with its subclass and a name for messages.
fn parameters(chip: &'static Chip) -> impl Iterator<Item = (&'static Subclass, &'static Parameter, String)> {
    chip.subclasses.iter().flat_map(move |subclass| {
        subclass.parameters.iter().map(move |parameter| {
            let at = format!("{} {}/{} {}", chip.name, subclass.id, parameter.offset, parameter.name);
            (subclass, parameter, at)
        })
    })
}

/// One line of a golden listing.
fn row(subclass: &Subclass, parameter: &Parameter) -> String {
    let Parameter { offset, kind, name, unit, .. } = parameter;
    let range = match &parameter.range {
        Range::Int { default, .. } if parameter.unprinted => format!("? ? {}", shown(default)),
        Range::Int { min, max, default } => format!("{min} {max} {}", shown(default)),
        Range::Float { min, max, default } => format!("{min} {max} {}", shown(default)),
        Range::Text { default } => format!("x x {}", shown(default)),
    };
    format!(
        "{} | {} | {} {offset} {kind} | {name} | {range} | {unit}",
        subclass.class, subclass.name, subclass.id
    )
}

fn shown<T: ToString>(default: &Option<T>) -> String {
    default.as_ref().map_or("?".to_string(), T::to_string)
}

#[test]
fn names_are_unique() {
    assert!(!CHIPS.is_empty());
    assert_unique("chip", CHIPS.iter().map(|chip| chip.name));
    // Chip::subcommand has one answer.
    for chip in Chip::all() {
        assert_unique(chip.name, chip.subcommands.iter().map(|subcommand| subcommand.code));
    }
    for chip in CHIPS {
        assert_eq!(chip.name, chip.name.to_lowercase());
        assert!(!chip.documents.is_empty(), "{} names no document", chip.name);
        assert!(Chip::by_name(chip.model).is_some_and(|found| found.name == chip.name), "{}", chip.model);
        assert_unique("register source", chip.registers.iter().map(|register| register.source));
        assert_unique("register", chip.registers.iter().map(|register| register.name));
        assert_unique("register file", chip.registers.iter().map(|register| snake_case(register.name)));
        assert_unique("subcommand", chip.subcommands.iter().map(|subcommand| subcommand.name));
        assert_unique("subcommand word", chip.subcommands.iter().map(|one| snake_case(one.name)));
        let stored = chip.subclasses.iter().flat_map(|subclass| subclass.parameters);
        let roles = chip.registers.iter().map(|register| register.role);
        assert_unique("role", roles.chain(stored.map(|parameter| parameter.role)).flatten());
        // All by subclass, or all in one flat address space, depending on the access scheme.
        if chip.access.scheme.is_flat() {
            assert!(chip.subclasses.iter().all(|subclass| subclass.id == FLAT), "{}", chip.name);
        } else {
            assert_unique("subclass", chip.subclasses.iter().map(|subclass| subclass.id));
        }
        assert_unique("class folder", chip.classes().map(|(_, subclass)| chip.class_dir(subclass)));
        for (_, subclass) in chip.classes() {
            let dir = chip.class_dir(subclass);
            let rows = || chip.class_of(subclass).flat_map(|(_, group)| group.parameters);
            assert_unique(&dir, rows().map(|parameter| kebab_case(parameter.name)));
            assert!(!dir.is_empty() && rows().all(|one| !kebab_case(one.name).is_empty()));
        }
        if !chip.access.scheme.is_flat() {
            assert_eq!(chip.classes().count(), chip.subclasses.len(), "{}", chip.name);
        }
    }
}

#[test]
fn registers_are_in_order_and_do_not_overlap() {
    for chip in CHIPS {
        let mut end = 0;
        for register in chip.registers {
            let at = format!("{} {} {}", chip.name, register.source, register.name);
            let Source::Command(code) = register.source else { continue };
            assert!(u16::from(code) >= end, "{at} overlaps the one before");
            assert!(register.size > 0, "{at} is empty");
            end = u16::from(code) + u16::from(register.size);
            assert!(end <= 0x80, "{at} ends above 0x7f");
            if register.tier != Tier::Window {
                assert!(register.text || register.size <= 4, "{at} is no number");
            }
        }
    }
}

#[test]
fn every_role_that_a_power_supply_needs_is_present() {
    for chip in CHIPS {
        for role in [Role::VoltageNow, Role::Temp] {
            assert!(chip.register(role).is_some(), "{} lacks {role:?}", chip.name);
        }
        assert!(
            chip.register(Role::CurrentNow).or(chip.register(Role::CurrentAvg)).is_some(),
            "{} lacks a current",
            chip.name
        );
        let Some(flags) = chip.register(Role::Flags) else {
            panic!("{} lacks Flags", chip.name);
        };
        let condition = &chip.condition;
        for mask in [
            condition.full,
            condition.low,
            condition.critical,
            condition.overheat,
            condition.cold,
            condition.over_voltage,
            condition.under_voltage,
            condition.present,
        ] {
            let named = flags.bits.iter().fold(0, |word, bit| word | bit.mask);
            assert_eq!(mask & !named, 0, "{}: condition 0x{mask:04x} uses an unnamed flag", chip.name);
        }
        for register in chip.registers.iter().filter(|register| register.role.is_some()) {
            // What hardly ever changes makes no poll dearer.
            let is_slow = matches!(
                register.role,
                Some(Role::ChargeVoltage | Role::ChargeCurrent | Role::InternalResistance)
            );
            assert!(
                matches!(register.tier, Tier::Poll | Tier::Proven | Tier::Static) != is_slow
                    && register.tier != Tier::Window,
                "{}: {} feeds a property but is not polled",
                chip.name,
                register.name
            );
        }
        for subclass in chip.subclasses {
            for parameter in subclass.parameters.iter().filter(|parameter| parameter.role.is_some()) {
                let name = format!("{}: {}", chip.name, parameter.name);
                assert!(!parameter.unproven, "{name} may be another value");
                assert!(!parameter.learned, "{name} changes by itself");
            }
        }
    }
}

#[test]
fn a_primary_cell_is_never_charged_or_full() {
    for chip in CHIPS.iter().filter(|chip| chip.condition.primary.is_some()) {
        assert_eq!(chip.condition.full, 0, "{}", chip.name);
        for role in [Role::Capacity, Role::ChargeNow, Role::ChargeFull, Role::TimeToFullNow, Role::CycleCount]
        {
            assert!(chip.register(role).is_none(), "{} has {role:?}", chip.name);
        }
    }
}

#[test]
fn a_poll_reads_the_expected_bursts() {
    for chip in CHIPS {
        let (expected, bytes): (&[(u8, u8)], u64) = match chip.name {
            "bq34z100-g1" => (&[(0x02, 0x12), (0x18, 4), (0x24, 12)], 43),
            "bq34z100-r2" => (&[(0x02, 0x12), (0x18, 4), (0x20, 16)], 47),
            "bq27520-g3" => (&[(0x06, 0x12), (0x22, 0x10)], 40),
            "bq27500" | "bq27500-v130" => (&[(0x06, 0x14), (0x22, 0x0C)], 38),
            "bq27441-g1" | "bq27421-g1" | "bq27426" | "bq27427" => (&[(0x02, 0x10), (0x18, 10)], 32),
            "bq27621-g1" => (&[(0x02, 0x10), (0x18, 6)], 28),
            "bq27541-g1" | "bq27545-g1" => (&[(0x06, 0x12), (0x24, 2), (0x2A, 6)], 35),
            "bq27542-g1" => (&[(0x06, 0x12), (0x2A, 6)], 30),
            "bq27742-g1" => (&[(0x06, 0x12), (0x2A, 6)], 30),
            // Two bytes between 0x06 and 0x1B are read without need. The gap of 14 bytes is not read, because
            // it would cost more than the three bytes of another transfer.
            "bq34110" => (&[(0x06, 0x16), (0x2A, 6)], 34),
            "bq27220" => (&[(0x06, 0x14), (0x22, 14), (0x3A, 2)], 45),
            "bq28z610" => (&[(0x06, 0x14), (0x22, 2), (0x2A, 6)], 37),
            // No byte is read without need.
            "bq35100" => (&[(0x02, 0x0C), (0x2E, 1)], 19),
            name => panic!("{name} has no bursts listed here"),
        };
        let bursts = bursts(chip.registers, |tier| tier == Tier::Poll);
        assert_eq!(bursts, expected, "{}", chip.name);
        assert_eq!(
            bursts.iter().map(|&(_, length)| wire_bytes(1, length.into())).sum::<u64>(),
            bytes,
            "{}",
            chip.name
        );
    }
}

#[test]
fn bits_are_single_uniquely_named_and_inside_their_word() {
    fn check(at: &str, bits: &[Bit], size: usize) {
        assert_unique(at, bits.iter().map(|bit| bit.name));
        assert_unique(at, bits.iter().map(|bit| bit.mask));
        for bit in bits {
            assert_eq!(bit.mask.count_ones(), 1, "{at}: {}", bit.name);
            assert!(size >= 4 || bit.mask < 1 << (8 * size), "{at}: {} is outside", bit.name);
            assert!(!bit.name.is_empty() && !bit.name.starts_with("RSVD"), "{at}: {:?}", bit.name);
        }
    }
    for chip in CHIPS {
        check(chip.name, chip.control_status, 2);
        for register in chip.registers {
            check(register.name, register.bits, register.size.into());
        }
        for (_, parameter, at) in parameters(chip) {
            check(&at, parameter.bits, parameter.kind.size());
        }
        let named = |bits: &[Bit], mask| bits.iter().find(|bit| bit.mask == mask).map(|bit| bit.name);
        match chip.security.status {
            SealStatus::Bits { sealed, not_full_access } => {
                assert_eq!(named(chip.control_status, sealed), Some("SS"), "{}", chip.name);
                let told = named(chip.control_status, not_full_access).is_some();
                assert_eq!(told, chip.security.full_access, "{}", chip.name);
            }
            SealStatus::Field { word, shift } => {
                let bits = match word {
                    // The answer takes the place of CONTROL_STATUS.
                    Source::Status | Source::Answer(_) => chip.control_status,
                    source => {
                        let register = chip.register_at(source);
                        register.filter(|register| register.size == 2).expect(chip.name).bits
                    }
                };
                assert_eq!(named(bits, 1 << shift), Some("SEC0"), "{}", chip.name);
                assert_eq!(named(bits, 2 << shift), Some("SEC1"), "{}", chip.name);
                assert!(chip.security.full_access, "{}", chip.name);
            }
            SealStatus::None => panic!("{}: a table says where it is", chip.name),
        }
    }
}

#[test]
fn unnamed_bits_are_reserved() {
    for (_, parameter, at) in CHIPS.iter().copied().flat_map(parameters) {
        if parameter.bits.is_empty() {
            continue;
        }
        let word = u32::MAX >> (32 - 8 * parameter.kind.size());
        let named = parameter.bits.iter().fold(0, |word, bit| word | bit.mask);
        let kept = match parameter.safe {
            Some(Safe::Keep(mask, _)) => mask,
            _ => 0,
        };
        assert_eq!(word & !named & !kept, 0, "{at}");
    }
}

#[test]
fn no_subcommand_that_may_be_sent_is_dangerous() {
    for chip in CHIPS {
        let harmful = [0x0F00, 0x7C40, 0x29E7, 0xA613, 0xFFFF];
        let keys = chip.security.default_unseal;
        for subcommand in chip.subcommands {
            let at = format!("{} 0x{:04x} {}", chip.name, subcommand.code, subcommand.name);
            if harmful.contains(&subcommand.code) || keys.contains(&subcommand.code) {
                assert_eq!(subcommand.effect, Effect::Never, "{at}");
            }
            // A subcommand may be repeated after a lost acknowledgement, so it must not toggle; and its answer
            // must not contain a key.
            if subcommand.name.contains("TOGGLE") || subcommand.name.contains("KEY") {
                assert_eq!(subcommand.effect, Effect::Guarded, "{at}");
            }
            if subcommand.code == chip.security.seal {
                assert_eq!(subcommand.effect, Effect::Guarded, "{at}");
            }
        }
        assert!(chip.subcommand(chip.security.seal).is_some(), "{}", chip.name);
    }
}

#[test]
fn parameters_are_in_order_inside_their_subclass_and_do_not_overlap() {
    for chip in CHIPS {
        for subclass in chip.subclasses {
            // A flat group begins with its first parameter.
            assert!(
                subclass.id != FLAT || !subclass.parameters.is_empty(),
                "{} {} is empty",
                chip.name,
                subclass.name
            );
            assert!(subclass.length > 0, "{} {}", chip.name, subclass.id);
        }
        // All groups of a flat address space have the same id, so they are compared with each other as well.
        let mut last: Option<(u8, usize)> = None;
        for (subclass, parameter, at) in parameters(chip) {
            let start = usize::from(parameter.offset);
            let end = start + parameter.kind.size();
            assert!(parameter.kind.size() > 0, "{at} is empty");
            let after = last.is_none_or(|(id, end)| id != subclass.id || start >= end);
            assert!(after, "{at} overlaps the one before");
            let first = usize::from(subclass.start());
            assert!(
                first <= start && end <= first + usize::from(subclass.length),
                "{at} is outside the subclass"
            );
            last = Some((subclass.id, end));
        }
    }
}

/// The range decides what may be selected on a part without subclasses.
#[test]
fn flash_with_flat_addresses_has_a_range_with_all_of_its_rows() {
    for chip in CHIPS {
        assert_eq!(chip.flat.is_empty(), chip.access.scheme != Scheme::Mac, "{}", chip.name);
        for subclass in chip.subclasses.iter().filter(|_| !chip.flat.is_empty()) {
            let last = subclass.start() + subclass.length - 1;
            assert!(chip.flat.contains(&subclass.start()) && chip.flat.contains(&last), "{}", subclass.name);
        }
    }
}

#[test]
fn flat_groups_end_with_their_last_parameter_and_lie_in_data_flash() {
    let flat = CHIPS.iter().flat_map(|chip| chip.subclasses).filter(|subclass| subclass.id == FLAT);
    for subclass in flat {
        let last = subclass.parameters.last().expect("not empty");
        let end = last.offset + last.kind.size() as u16;
        assert_eq!(subclass.start() + subclass.length, end, "{}", subclass.name);
        // The other addresses in these 16 bits are subcommands.
        let is_in = |range: std::ops::Range<u16>| range.contains(&subclass.start()) && end <= range.end;
        assert!(is_in(0x4000..0x4729) || is_in(0x9180..0x9300), "{}", subclass.name);
        // Gaps between parameters are read without need, so they must not be larger than one window.
        for pair in subclass.parameters.windows(2) {
            let gap = usize::from(pair[1].offset - pair[0].offset) - pair[0].kind.size();
            assert!(gap < WINDOW, "{}: {gap} bytes before {}", subclass.name, pair[1].name);
        }
    }
}

/// The bytes of a parameter's default, if it has one.
fn default_bytes(layout: codec::Layout, parameter: &Parameter) -> Option<Vec<u8>> {
    let value = match &parameter.range {
        Range::Int { default, .. } => Value::Int((*default)?),
        Range::Float { default, .. } => Value::Float((*default)?),
        Range::Text { default } => Value::Text((*default)?.into()),
    };
    layout.encode(parameter.kind, &value)
}

#[test]
fn a_signature_is_an_existing_parameter_and_not_a_key() {
    for chip in CHIPS {
        for signature in chip.signature {
            let at = format!("{} {}/0x{:04x}", chip.name, signature.subclass, signature.offset);
            let row = chip.parameter(signature.subclass, signature.offset);
            let row = row.unwrap_or_else(|| panic!("{at} is no parameter"));
            let expected = match row.kind {
                Type::F4 => Type::H(4),
                // Its length.
                Type::S(_) => Type::U(1),
                kind => kind,
            };
            assert_eq!(signature.kind, expected, "{at}");
            let (least, most) = signature.kind.bounds().expect("an integer");
            assert!(least <= signature.min && signature.max <= most, "{at}");
            let is_not_erased = (signature.min, signature.max) == (least + 1, most - 1);
            let is_narrow = signature.max - signature.min < (most - least) / 2;
            assert!(is_narrow || is_not_erased, "{at} says next to nothing");
            if let Some(bytes) = default_bytes(chip.layout, row) {
                assert!(fits(chip.layout, signature, &bytes), "{at} does not fit the default");
            }
            let secret = chip.subclasses.iter().any(|class| {
                class.kind == Kind::Security
                    && class.id == signature.subclass
                    && class.parameter(signature.offset).is_some()
            });
            assert!(!secret, "{at} is a key");
        }
    }
}

fn fits(layout: codec::Layout, signature: &Signature, bytes: &[u8]) -> bool {
    let bytes = &bytes[..signature.kind.size()];
    let Value::Int(value) = layout.decode(signature.kind, bytes) else { panic!("an integer") };
    (signature.min..=signature.max).contains(&value)
}

/// Owners of parts with a flat address space have found parameters one address lower than documented.
/// A value that the signature does not take would be the last one that is written.
#[test]
fn a_signature_takes_every_value_that_may_be_written() {
    for chip in CHIPS {
        for signature in chip.signature {
            let row = chip.parameter(signature.subclass, signature.offset).expect("a parameter");
            let Range::Int { min, max, .. } = row.range else { continue };
            let (least, greatest, _) = row.safe.as_ref().and_then(Safe::limits).unwrap_or((min, max, ""));
            let takes = signature.holds(least.max(min)) && signature.holds(greatest.min(max));
            assert!(takes || row.unproven, "{} {}", chip.name, row.name);
        }
    }
}

#[test]
fn a_signature_detects_a_flat_map_that_is_off_by_one() {
    let flat = CHIPS.iter().copied().filter(|chip| chip.access.scheme.is_flat());
    for chip in flat {
        let mut told = 0;
        for signature in chip.signature {
            let row = chip.parameter(signature.subclass, signature.offset).expect("tested above");
            // What it has to be is as good as a default.
            let only = Value::Int(signature.min);
            let only =
                (signature.min == signature.max).then(|| chip.layout.encode(signature.kind, &only)).flatten();
            let Some(bytes) = default_bytes(chip.layout, row).or(only) else { continue };
            let lower = (0..=u8::MAX).map(|next| [&bytes[1..], &[next]].concat());
            for shifted in lower {
                assert!(
                    !fits(chip.layout, signature, &shifted),
                    "{} 0x{:04x}: {shifted:x?}",
                    chip.name,
                    signature.offset
                );
            }
            told += 1;
        }
        assert!(told >= 2, "{} has too few rows to tell by", chip.name);
    }
}

#[test]
fn ranges_fit_types_and_defaults_and_safe_limits_fit_ranges() {
    for (subclass, parameter, at) in CHIPS.iter().copied().flat_map(parameters) {
        match &parameter.range {
            Range::Int { min, max, default } => {
                let Some((least, most)) = parameter.kind.bounds() else {
                    panic!("{at}: {} has no integer range", parameter.kind);
                };
                assert!(least <= *min && min < max && *max <= most, "{at}: {min} to {max}");
                assert!(default.is_none_or(|default| (*min..=*max).contains(&default)), "{at}: {default:?}");
            }
            Range::Float { min, max, default } => {
                assert_eq!(parameter.kind, Type::F4, "{at}");
                assert!(min.is_finite() && max.is_finite() && min < max, "{at}: {min} to {max}");
                assert!(default.is_none_or(|default| (*min..=*max).contains(&default)), "{at}: {default:?}");
            }
            Range::Text { default } => {
                let Type::S(size) = parameter.kind else { panic!("{at}: {} has no text", parameter.kind) };
                assert!(default.is_none_or(|text| text.len() < size.into()), "{at}: {default:?}");
            }
        }
        assert!(parameter.never.is_none_or(|why| !why.is_empty() && parameter.unproven), "{at}");
        let Some(safe) = &parameter.safe else { continue };
        let (min, max, default) = match parameter.range {
            Range::Int { min, max, default } => (min, max, default),
            _ => panic!("{at}: a safe limit on what is no integer"),
        };
        let check = |one: &Safe| match *one {
            Safe::AtLeast(least, why) => {
                let least = i64::from(least);
                assert!(min < least && least <= max, "{at}: at least {least} narrows nothing");
                assert!(default.is_none_or(|default| default >= least), "{at}: unsafe default");
                why
            }
            Safe::Within(least, greatest, why) => {
                let (least, greatest) = (i64::from(least), i64::from(greatest));
                let narrows = min < least || greatest < max;
                assert!(min <= least && least < greatest && greatest <= max && narrows, "{at}");
                assert!(default.is_none_or(|default| (least..=greatest).contains(&default)), "{at}");
                why
            }
            Safe::BelowVoltage(why) => why,
            // Both are in one block, so that a write sees the other one.
            Safe::Under(other, by, why) | Safe::Over(other, by, why) => {
                let block = |offset: u16| usize::from(offset) / WINDOW;
                assert!(by >= 0 && block(other) == block(parameter.offset), "{at}");
                let other = subclass.parameter(other).expect(&at).safe.as_ref();
                let is_back = |one: &Safe| matches!(one, Safe::Under(back, ..) | Safe::Over(back, ..) if *back == parameter.offset);
                assert!(other.is_some_and(|safe| safe.each().iter().any(is_back)), "{at}");
                why
            }
            Safe::AboveNow(role, by, why) | Safe::BelowNow(role, by, why) => {
                assert!(by > 0 && matches!(role, Role::Temp | Role::VoltageNow), "{at}");
                why
            }
            Safe::All(_) => panic!("{at}: one within another"),
            // What keeps bits asks for the only limit.
            Safe::Keep(..) if safe.each().len() > 1 => panic!("{at}: bits to keep among other limits"),
            Safe::Keep(mask, why) => {
                assert!(mask != 0 && u64::from(mask) < 1 << (8 * parameter.kind.size()), "{at}: 0x{mask:x}");
                why
            }
        };
        assert!(!safe.each().is_empty() && safe.each().iter().all(|one| !check(one).is_empty()), "{at}");
    }
}

#[test]
fn keys_have_no_default() {
    let keys = CHIPS.iter().copied().flat_map(parameters).filter(|(class, ..)| class.kind == Kind::Security);
    let mut found = 0;
    for (_, parameter, at) in keys {
        assert!(
            matches!(parameter.range, Range::Int { default: None, .. } | Range::Text { default: None }),
            "{at}"
        );
        found += 1;
    }
    assert!(found > 0);
}

#[test]
fn the_flash_voltage_check_refers_to_existing_parameters() {
    for chip in CHIPS {
        let Some(gate) = &chip.gate else { continue };
        let limit = chip.parameter(gate.limit.0, gate.limit.1).expect(chip.name);
        assert!(matches!(limit.safe, Some(Safe::BelowVoltage(_))), "{} {}", chip.name, limit.name);
        assert_eq!(limit.kind, Type::I(2), "{}", chip.name);
        if let Some((id, offset)) = gate.divider {
            let divider = chip.parameter(id, offset).expect(chip.name);
            assert!(matches!(divider.safe, Some(Safe::AtLeast(1, _))), "{} {}", chip.name, divider.name);
            assert_eq!(divider.kind, Type::U(2), "{}", chip.name);
        }
        assert!(gate.cell_divider.is_none() || gate.divider.is_some(), "{}", chip.name);
        if let Some(external) = &gate.external {
            let word = chip.parameter(external.byte.0, external.byte.1).expect(chip.name);
            let mask = u32::from(external.mask) << (8 * (word.kind.size() - 1));
            let bit = word.bits.iter().find(|bit| bit.mask == mask);
            // Two of these words have no list of bits.
            let name = bit.map_or(external.name.to_string(), |bit| format!("[{}]", bit.name));
            assert_eq!(name, external.name, "{}", chip.name);
        }
        if let Some((id, offset)) = gate.cells {
            assert_eq!(chip.parameter(id, offset).expect(chip.name).kind, Type::U(1), "{}", chip.name);
        }
        if let Some((source, mask)) = gate.calibration {
            let register = chip.register_at(source).expect(chip.name);
            assert!(
                register.bits.iter().any(|bit| (bit.mask, bit.name) == (mask, "CAL_EN")),
                "{}",
                chip.name
            );
        }
    }
}

#[test]
fn a_quirk_refers_to_a_byte_of_a_parameter() {
    for chip in CHIPS {
        for quirk in chip.quirks {
            let at = format!("{} {}/{}", chip.name, quirk.subclass, quirk.offset);
            let class = chip.subclass(quirk.subclass).expect(&at);
            let inside = |one: &Parameter| {
                let start = usize::from(one.offset);
                (start..start + one.kind.size()).contains(&quirk.offset.into())
            };
            assert!(class.parameters.iter().any(inside), "{at}");
            assert!(quirk.mask != 0 && quirk.wrong & !quirk.mask == 0, "{at}");
            assert!(!quirk.effect.is_empty() && !quirk.remedy.is_empty(), "{at}");
        }
    }
}

#[test]
fn ram_data_memory_has_a_bit_that_reports_its_loss() {
    for chip in CHIPS {
        assert_eq!(chip.volatile.is_some(), chip.access.scheme.is_ram(), "{}", chip.name);
        let Some(lost) = chip.volatile else { continue };
        let flags = chip.register(Role::Flags).unwrap();
        let name = flags.bits.iter().find(|bit| bit.mask == lost).map(|bit| bit.name);
        // No source knows such a bit of the bq27220.
        let expected = (chip.name != "bq27220").then_some("ITPOR");
        assert_eq!((name, lost != 0), (expected, expected.is_some()), "{}", chip.name);
        assert!(chip.gate.is_none(), "{}: RAM needs no flash voltage", chip.name);
    }
}

#[test]
fn no_sibling_has_the_identity_of_a_chip() {
    assert_unique("sibling", SIBLINGS.iter().map(|sibling| sibling.name));
    for chip in CHIPS.iter().copied().filter(|chip| !chip.is_inferred()) {
        let Identity { device_type, hardware, dm_codes, .. } = chip.identity;
        // A table without firmware versions takes any.
        let firmware = chip.identity.firmware;
        for &firmware_version in if firmware.is_empty() { &[0xeeee] } else { firmware } {
            // A code that no chip has stands for a sibling without a code of its own.
            for dm_code in if dm_codes.is_empty() { &[0xee] } else { dm_codes } {
                let answers = Answers {
                    device_type,
                    firmware_version,
                    hardware_version: hardware.unwrap_or_default(),
                    build: chip.identity.build,
                    chem_id: None,
                    dm_code: Some(*dm_code),
                };
                let found = recognise(&answers);
                assert!(matches!(found, Recognised::Chip(one) if one.name == chip.name), "{answers:x?}");
            }
        }
    }
}

#[test]
fn waits_are_at_least_those_that_a_gauge_needs() {
    for chip in CHIPS {
        assert!(chip.security.key_silence.as_secs() >= 4, "{}", chip.name);
        let access = &chip.access;
        assert!(access.select.as_millis() >= 1, "{}", chip.name);
        assert!(access.reset_limit > access.reset, "{}", chip.name);
        let (commit_ms, enters) = match access.scheme {
            Scheme::Block | Scheme::Mac => (100, false),
            Scheme::CfgUpdate | Scheme::MacUpdate => (10, true),
            Scheme::None | Scheme::Smbus => panic!("{}: a table has one", chip.name),
        };
        assert!(access.commit.as_millis() >= commit_ms, "{}", chip.name);
        assert_eq!(!access.enter_limit.is_zero(), enters, "{}", chip.name);
    }
}

#[test]
fn each_chip_has_the_number_of_rows_of_its_manual() {
    let counts: BTreeMap<&str, [usize; 6]> = CHIPS
        .iter()
        .map(|chip| {
            let learned = parameters(chip).filter(|(_, parameter, _)| parameter.learned).count();
            let safe = parameters(chip).filter(|(_, parameter, _)| parameter.safe.is_some()).count();
            let rows = parameters(chip).count();
            let counts =
                [chip.subclasses.len(), rows, learned, safe, chip.registers.len(), chip.subcommands.len()];
            (chip.name, counts)
        })
        .collect();
    // Subclasses, parameters, parameters that the gauge updates, parameters with safe limits, registers, subcommands.
    let expected = BTreeMap::from([
        ("bq34z100-g1", [22, 211, 51, 9, 43, 23]),
        ("bq34z100-r2", [22, 213, 51, 9, 46, 23]),
        ("bq27441-g1", [14, 89, 24, 6, 28, 19]),
        ("bq27421-g1", [14, 89, 24, 6, 28, 19]),
        ("bq27426", [18, 89, 24, 6, 26, 19]),
        ("bq27427", [14, 89, 24, 6, 26, 19]),
        ("bq27621-g1", [22, 72, 20, 5, 24, 21]),
        ("bq27520-g3", [20, 216, 78, 5, 36, 27]),
        ("bq27500", [15, 166, 10, 4, 29, 18]),
        ("bq27500-v130", [15, 170, 10, 4, 29, 18]),
        ("bq27541-g1", [7, 90, 7, 0, 21, 9]),
        ("bq27542-g1", [7, 71, 39, 0, 19, 9]),
        ("bq27545-g1", [6, 27, 1, 0, 19, 9]),
        ("bq27742-g1", [23, 256, 49, 16, 29, 12]),
        ("bq27220", [17, 120, 3, 6, 32, 29]),
        ("bq34110", [20, 87, 8, 6, 33, 56]),
        ("bq35100", [20, 186, 81, 5, 21, 21]),
        ("bq28z610", [90, 403, 140, 11, 21, 23]),
    ]);
    assert_eq!(counts, expected);
}

/// Fails unless each line is a row of the chip's listing.
#[track_caller]
fn assert_lists(chip: &'static Chip, golden: &str) {
    let rows = parameters(chip).map(|(class, one, _)| {
        let mut line = row(class, one);
        if one.unproven {
            line += " | unproven";
        }
        line
    });
    let listing: Vec<String> = rows.collect();
    for line in golden.lines() {
        assert!(listing.iter().any(|row| row == line), "{line}\n{}", listing.join("\n"));
    }
}

/// The bits of a flag word, highest first.
fn listed(bits: &[Bit]) -> String {
    let names = bits.iter().map(|bit| format!("{}:{}", bit.mask.trailing_zeros(), bit.name));
    names.collect::<Vec<_>>().join(" ")
}

/// Bits of a register.
fn flags(chip: &'static Chip, name: &str) -> String {
    listed(chip.registers.iter().find(|register| register.name == name).unwrap().bits)
}

/// Safe limits, each with its address.
fn limits(chip: &'static Chip) -> Vec<String> {
    parameters(chip)
        .filter_map(|(class, parameter, _)| {
            let limit = match parameter.safe.as_ref()? {
                Safe::AtLeast(least, _) => format!("at least {least}"),
                Safe::Within(least, greatest, _) => format!("{least} to {greatest}"),
                Safe::BelowVoltage(_) => "below the voltage".to_string(),
                Safe::Under(other, by, _) => format!("{by} below {other}"),
                Safe::Over(other, by, _) => format!("{by} above {other}"),
                Safe::Keep(mask, _) => format!("keep 0x{mask:x}"),
                other => format!("{other:?}"),
            };
            Some(format!("{}/{} {limit}", class.id, parameter.offset))
        })
        .collect()
}

fn unproven(chip: &'static Chip) -> usize {
    parameters(chip).filter(|(_, parameter, _)| parameter.unproven).count()
}

#[test]
fn bq34z100_g1_matches_table_7_11() {
    let chip = Chip::by_name("bq34z100-g1").unwrap();
    let ids: Vec<u8> = chip.subclasses.iter().map(|subclass| subclass.id).collect();
    assert_eq!(
        ids,
        [2, 32, 34, 36, 48, 49, 56, 59, 60, 64, 66, 67, 68, 58, 80, 81, 82, 88, 89, 104, 107, 112]
    );
    let golden = "\
Configuration | Safety | 2 0 I2 | OT Chg | 0 1200 550 | 0.1°C
Configuration | Charge | 34 5 F4 | Pb Temp Comp | 0 0.078125 ? | %
Configuration | Charge Termination | 36 7 I1 | TCA Set % | -1 100 99 | %
Configuration | Data | 48 4 H2 | Serial Number | 0 65535 1 | hex
Configuration | Data | 48 11 I2 | Design Capacity | 0 32767 1000 | mAh
Configuration | Data | 48 15 I2 | SOH Load I | -32767 0 -400 | mA
Configuration | Data | 48 31 S12 | Device Name | x x BQ34Z100-G1 | 
Configuration | Data | 48 55 S5 | Device Chemistry | x x LION | 
Configuration | Registers | 64 0 H2 | Pack Configuration | 0 65535 ? | flags
Configuration | Registers | 64 7 U1 | Number of series cell | 0 100 1 | Num
Configuration | Power | 68 0 I2 | Flash Update OK Cell Volt | 0 4200 2800 | mV
System Data | Manufacturer Info | 58 31 H1 | Block A 31 | 0 255 0 | hex
Gas Gauging | IT Cfg | 80 53 I2 | Cell Terminate Voltage | 1000 3700 3000 | mV
Gas Gauging | IT Cfg | 80 64 I2 | User Rate-Pwr | -32767 32767 0 | mW/cW
Gas Gauging | IT Cfg | 80 91 I2 | Smooth Relax Time | 1 32767 1000 | s
Gas Gauging | State | 82 4 H1 | Update Status | 0 6 0 | Num
Ra Table | R_a0x | 89 30 I2 | R_a0x 14 | 0 32767 1500 | Num
Calibration | Data | 104 4 F4 | CC Delta | 29800 1190000 567744.56 | Num
Calibration | Data | 104 14 U2 | Voltage Divider | 0 65535 5000 | mV
Calibration | Current | 107 1 U1 | Deadband | 0 255 5 | mA
Security | Codes | 112 20 H4 | Authen Key0 | ? ? ? | hex
";
    assert_lists(chip, golden);
    assert_eq!(unproven(chip), 0);
}

#[test]
fn bq34z100_g1_safe_limits_exclude_values_that_ruin_a_pack() {
    let chip = Chip::by_name("bq34z100-g1").unwrap();
    // They include the reserved bits of Tables 7-17, 7-18 and 7-22; Table 7-19 has none.
    assert_eq!(
        limits(chip),
        [
            "48/11 at least 1",
            "64/0 keep 0x1000",
            "64/2 keep 0x50",
            "64/4 keep 0x4",
            "64/5 keep 0x68",
            "64/7 at least 1",
            "68/0 below the voltage",
            "82/0 at least 1",
            "104/14 at least 1",
        ]
    );
}

#[test]
fn bq34z100_g1_flags_match_their_tables() {
    let chip = Chip::by_name("bq34z100-g1").unwrap();
    let register = |name| chip.registers.iter().find(|register| register.name == name).unwrap();
    assert_eq!(
        listed(chip.control_status),
        "14:FAS 13:SS 12:CALEN 11:CCA 10:BCA 9:CSV 5:FULLSLEEP 4:SLEEP 3:LDMD 2:RUP_DIS 1:VOK 0:QEN"
    );
    assert_eq!(
        listed(register("Flags").bits),
        "15:OTC 14:OTD 13:BATHI 12:BATLOW 11:CHG_INH 10:XCHG 9:FC 8:CHG 7:OCVTAKEN 4:CF 2:SOC1 1:SOCF 0:DSG"
    );
    assert_eq!(listed(register("FlagsB").bits), "15:SOH 14:LIFE 13:FIRSTDOD 10:DODEOC 9:DTRC");
    assert_eq!(listed(register("LearnedStatus").bits), "3:Qmax 2:ITEN 1:CF1 0:CF0");
    let roles = chip.registers.iter().filter(|register| register.role.is_some()).count();
    assert_eq!(roles, 19, "this part feeds nearly every property there is");
}

/// Subclass 48 is that of the image of a pack with firmware 2.02. The rest is the bq34z100-G1's, as far as that image
/// agrees with it.
#[test]
fn bq34z100_r2_differs_from_the_bq34z100_g1_where_its_image_does() {
    let (chip, old) = (Chip::by_name("bq34z100-r2").unwrap(), Chip::by_name("bq34z100-g1").unwrap());
    let golden = "\
Configuration | Data | 48 13 I2 | Design Energy | 0 32767 5400 | 10mWh
Configuration | Data | 48 29 I1 | JEITA T4 | -128 127 55 | °C
Configuration | Data | 48 30 U1 | Volt Scale | 1 255 1 |  | unproven
Configuration | Data | 48 31 U1 | Curr Scale | 1 255 1 |  | unproven
Configuration | Data | 48 32 U1 | Energy Scale | 1 255 1 |  | unproven
Configuration | Data | 48 33 S12 | Device Name | x x BQ34Z100-G1 | 
Configuration | Data | 48 45 S12 | Manufacturer Name | x x Texas Inst. | 
Configuration | Data | 48 57 S5 | Device Chemistry | x x LION | 
Configuration | Manufacturer Data | 56 10 H2 | DF Config Version | 0 65535 0 | hex | unproven
Configuration | Lifetime Data | 59 8 U2 | Lifetime Max Pack Voltage | 0 65535 ? | mV
Calibration | Current | 107 1 U1 | Deadband | 0 255 5 | mA
";
    assert_lists(chip, golden);
    assert_eq!(unproven(chip), 9);
    let rows = |chip: &'static Chip| -> BTreeSet<String> {
        parameters(chip).map(|(class, parameter, _)| row(class, parameter)).collect()
    };
    let (rows, old_rows) = (rows(chip), rows(old));
    assert_eq!((rows.difference(&old_rows).count(), old_rows.difference(&rows).count()), (9, 7));
    assert_eq!(limits(chip)[1], "64/0 keep 0x3000", "[SCALED] is no bit of this part");
    assert_eq!((limits(chip).len(), limits(old).len()), (9, 9));
}

#[test]
fn scales_are_bytes_of_polled_registers_or_of_data_flash() {
    for chip in CHIPS {
        let Scaling { voltage, current, charge, energy, scaled } = &chip.scaling;
        for scale in [voltage, current, charge, energy] {
            match *scale {
                Scale::None | Scale::Power(..) => {}
                Scale::Register(source) => {
                    let register = chip.register_at(source).expect(chip.name);
                    let found = (register.size, register.tier);
                    assert_eq!(found, (1, Tier::Poll), "{} {}", chip.name, register.name);
                }
                Scale::Flash(subclass, offset) => {
                    let row = chip.parameter(subclass, offset).expect(chip.name);
                    assert_eq!((row.kind, row.int_default(None)), (Type::U(1), Some(1)), "{}", row.name);
                }
            }
        }
        // The log warns of it when the gauge has been opened.
        if let Some((source, bit)) = scaled {
            let register = chip.register_at(*source).expect(chip.name);
            assert!(register.tier == Tier::Static && register.bits.contains(bit), "{}", chip.name);
        }
        // A unit that is not the kernel's thousandth has a step.
        for register in [Role::EnergyNow, Role::PowerAvg].into_iter().filter_map(|role| chip.register(role)) {
            let step = if register.unit.starts_with('c') { (10, 1) } else { (1, 1) };
            assert_eq!(register.step, step, "{} {}", chip.name, register.name);
        }
    }
}

/// SLUUAC9A has a column for each flavour.
#[test]
fn a_bq27441_g1b_has_its_own_defaults() {
    let chip = Chip::by_name("bq27441-g1").unwrap();
    let defaults = |id, offset| {
        let row = chip.parameter(id, offset).expect("a row");
        [Some(0x48), Some(0x58), None].map(|dm_code| row.int_default(dm_code))
    };
    assert_eq!(defaults(82, 10), [Some(1340), Some(1000), None]);
    assert_eq!(defaults(82, 33), [Some(4190), Some(4290), None]);
    assert_eq!(defaults(89, 28), [Some(588), Some(375), None]);
    assert_eq!(defaults(82, 16), [Some(3200); 3]);
    let differ =
        parameters(chip).filter(|(_, row, _)| row.int_default(None).is_none() && row.flavour.is_some());
    assert_eq!(differ.count(), 22);
}

/// LEADACID's driver and the CEDV profile: voltages of a cell.
#[test]
fn bq27441_g1_matches_tables_4_3_to_6_9() {
    let chip = Chip::by_name("bq27441-g1").unwrap();
    let ids: Vec<u8> = chip.subclasses.iter().map(|subclass| subclass.id).collect();
    assert_eq!(ids, [2, 36, 48, 49, 64, 68, 80, 81, 82, 89, 104, 105, 107, 112]);
    let golden = "\
Configuration | Safety | 2 0 I2 | Over Temp | -1200 1200 550 | 0.1°C
Configuration | Charge Termination | 36 5 I1 | FC Set % | -1 100 -1 | %
Configuration | Data | 48 3 I2 | Initial MaxLoad | -32768 0 -200 | mA
Configuration | Discharge | 49 3 U1 | SOCF Clear Threshold | 0 100 5 | %
Configuration | Registers | 64 0 H2 | OpConfig | 0 65535 9720 | flags
Configuration | Power | 68 9 I2 | Hibernate V | 0 5000 2200 | mV
Gas Gauging | IT Cfg | 80 22 U2 | Ra Filter | 0 1000 800 | Num
Gas Gauging | IT Cfg | 80 78 U1 | TermV Valid t | 0 255 2 | s
Gas Gauging | Current Thresholds | 81 4 I2 | Quit Current | 0 2000 250 | 0.1 Hr rate
Gas Gauging | State | 82 0 I2 | Qmax Cell 0 | 0 32767 16384 | Num
Gas Gauging | State | 82 10 I2 | Design Capacity | 0 8000 1340 | mAh
Gas Gauging | State | 82 16 I2 | Terminate Voltage | 2500 3700 3200 | mV
Gas Gauging | State | 82 27 I2 | Taper Rate | 0 2000 100 | 0.1 Hr rate
Gas Gauging | State | 82 35 I2 | Avg I Last Run | -32768 -1 -50 | 0.1 Hr rate
Ra Tables | R_a RAM | 89 28 I2 | R_a0 14 | 0 32767 588 | Num
Calibration | CC Cal | 105 4 F4 | CC Gain | 0.1 40 0.672785 | Num
Calibration | CC Cal | 105 8 F4 | CC Delta | 30000 3000000 799341.14 | Num
Security | Codes | 112 0 H4 | Sealed to Unsealed | ? ? ? | hex
";
    assert_lists(chip, golden);
    assert_eq!(
        limits(chip),
        [
            "64/0 keep 0xc7ca",
            "64/2 keep 0xfb",
            "82/0 at least 1",
            "82/2 keep 0xfc",
            "82/5 keep 0x78",
            "82/10 at least 1",
        ]
    );
    assert_eq!(
        listed(chip.control_status),
        "15:SHUTDOWNEN 14:WDRESET 13:SS 12:CALMODE 11:CCA 10:BCA 9:QMAX_UP 8:RES_UP 7:INITCOMP 6:HIBERNATE \
         4:SLEEP 3:LDMD 2:RUP_DIS 1:VOK"
    );
    assert_eq!(
        flags(chip, "Flags"),
        "15:OT 14:UT 9:FC 8:CHG 7:OCVTAKEN 5:ITPOR 4:CFGUPMODE 3:BAT_DET 2:SOC1 1:SOCF 0:DSG"
    );
}

#[test]
fn bq27421_g1_has_the_rows_of_bq27441_g1_and_marks_the_unproven_ones() {
    let rows = |name| {
        let chip = Chip::by_name(name).unwrap();
        let key =
            |(class, one, _): (&Subclass, &Parameter, String)| (class.id, one.offset, one.kind, one.name);
        parameters(chip).map(key).collect::<Vec<_>>()
    };
    assert_eq!(rows("bq27421-g1"), rows("bq27441-g1"));
    let chip = Chip::by_name("bq27421-g1").unwrap();
    assert_eq!(
        unproven_rows(chip),
        [
            (80, &[52, 54, 72][..]),
            (82, &[33, 35, 37, 39]),
            (104, &[0, 1, 2]),
            (105, &[0, 2, 4, 8]),
            (107, &[1]),
        ]
        .map(|(id, offsets)| (id, offsets.to_vec()))
    );
}

/// The unproven rows: subclass and offsets.
fn unproven_rows(chip: &'static Chip) -> Vec<(u8, Vec<u16>)> {
    let mut found: Vec<(u8, Vec<u16>)> = Vec::new();
    for (class, one, _) in parameters(chip).filter(|(_, one, _)| one.unproven) {
        match found.last_mut() {
            Some((id, offsets)) if *id == class.id => offsets.push(one.offset),
            _ => found.push((class.id, vec![one.offset])),
        }
    }
    found
}

/// The blocks of a product's image for the bq27421-G1, as far as they are documented.
const IMAGE_OF_BQ27421_G1: [(u8, &str); 9] = [
    (2, "0226000032"),
    (36, "001928635fff620032"),
    (48, "0e74fdff38"),
    (49, "0a0f0205"),
    (64, "05f80f"),
    (68, "05003201c21414000308 98"),
    (
        80,
        "02bc012c001e00c8c81408003c0e10000a460514050f03200064465 00a0190006419dc5c60007d00040319250f140a7860 \
         2801f40000000000004380040114000b0bb8012c0a010a000000c8006402",
    ),
    (81, "00a7006400fa003c3c01b3b30190"),
    (82, "4ad9800000010edb0ea808341e5a053c0bcc00c80032001403e801009610040 00a106bffedffed0005"),
];

/// A row is proven if the image has the default there, or it is between two such rows without a gap.
#[test]
fn an_image_of_a_bq27421_g1_proves_its_rows() {
    let chip = Chip::by_name("bq27421-g1").unwrap();
    let mut proven = Vec::new();
    for (id, image) in IMAGE_OF_BQ27421_G1 {
        let digits: String = image.split(' ').collect();
        let bytes = ti_gauge::text::unhex(digits.as_bytes()).unwrap();
        let rows = chip.subclass(id).unwrap().parameters;
        let holds = |row: &Parameter| {
            let found = &bytes[usize::from(row.offset)..][..row.kind.size()];
            let Range::Int { min, max, default } = row.range else { panic!("{}", row.name) };
            let Value::Int(value) = codec::Layout::TI.decode(row.kind, found) else { panic!("{}", row.name) };
            assert!((min..=max).contains(&value), "{} {value}", row.name);
            default == Some(value) && value != 0
        };
        let end = |row: &Parameter| row.offset + row.kind.size() as u16;
        for (at, row) in rows.iter().enumerate() {
            let mut before = rows[..at].iter().rev();
            let mut start = row.offset;
            let below = loop {
                match before.next() {
                    Some(other) if end(other) == start && holds(other) => break true,
                    Some(other) if end(other) == start => start = other.offset,
                    _ => break start == 0,
                }
            };
            let mut stop = end(row);
            let above = rows[at + 1..].iter().find_map(|other| {
                let follows = std::mem::replace(&mut stop, end(other)) == other.offset;
                (!follows || holds(other)).then_some(follows)
            });
            if holds(row) || below && above == Some(true) {
                proven.push((id, row.offset));
            }
        }
    }
    let drivers = [0, 10, 12, 16, 27].map(|offset| (82, offset));
    for (class, row, _) in parameters(chip).filter(|(class, _, _)| class.kind != Kind::Security) {
        let place = (class.id, row.offset);
        let is_proven = proven.contains(&place) || drivers.contains(&place) || class.id == 89;
        assert_eq!(!row.unproven, is_proven, "{place:?} {}", row.name);
    }
}

/// A row of one driver for this part, without another source, is not writable; one of two is.
#[test]
fn bq27520_g3_and_bq35100_are_writable_where_two_sources_agree() {
    let is_unproven = |chip: &str, id: u8, offset: u16| {
        let (_, row, _) = parameters(Chip::by_name(chip).unwrap())
            .find(|(class, row, _)| (class.id, row.offset) == (id, offset))
            .unwrap();
        row.unproven
    };
    for (id, offset) in [(48, 24), (49, 0), (64, 8), (64, 9), (64, 12), (64, 13), (104, 13)] {
        assert!(is_unproven("bq27520-g3", id, offset), "{id}/{offset}");
    }
    for (id, offset) in [(48, 10), (64, 0), (64, 11), (80, 45)] {
        assert!(!is_unproven("bq27520-g3", id, offset), "{id}/{offset}");
    }
    assert!(!is_unproven("bq35100", 0, 0x4206));
    // Its size and sign are not known.
    assert!(is_unproven("bq35100", 0, 0x4010));
    assert!(is_unproven("bq35100", 0, 0x41D4));
}

#[test]
fn bq27427_and_bq27426_are_writable_where_the_images_of_both_agree() {
    let found = |name| unproven_rows(Chip::by_name(name).unwrap());
    let rows = |rows: &[(u8, &[u16])]| -> Vec<(u8, Vec<u16>)> {
        rows.iter().map(|(id, offsets)| (*id, offsets.to_vec())).collect()
    };
    let of_both: [(u8, &[u16]); 2] = [(80, &[50, 52, 68]), (104, &[0, 1, 2])];
    assert_eq!(found("bq27426"), rows(&of_both));
    assert_eq!(
        found("bq27427"),
        rows(&[(64, &[3]), of_both[0], of_both[1], (105, &[8]), (107, &[1])]),
        "no image of this part has other values there"
    );
}

#[test]
fn voltages_of_a_bq34110_are_a_cells_where_the_drivers_say_so() {
    let rows = parameters(Chip::by_name("bq34110").unwrap()).filter(|(_, row, _)| row.unit == "mV/cell");
    let offsets: Vec<u16> = rows.map(|(_, row, _)| row.offset).collect();
    let expected = [0x40C7, 0x40C9, 0x40CB, 0x4114, 0x4116, 0x4118].into_iter();
    assert_eq!(offsets, expected.chain((0..11).map(|step| 0x4263 + 2 * step)).collect::<Vec<_>>());
}

#[test]
fn bq27427_has_the_state_block_of_a_recorded_trace() {
    let chip = Chip::by_name("bq27427").unwrap();
    let ids: Vec<u8> = chip.subclasses.iter().map(|subclass| subclass.id).collect();
    assert_eq!(ids, [2, 36, 49, 64, 68, 80, 81, 82, 89, 109, 104, 105, 107, 112]);
    let golden = "\
Configuration | Safety | 2 2 I2 | Under Temp | -1200 1200 0 | 0.1°C
Configuration | Charge Termination | 36 7 I2 | DODatEOC Delta T | 0 1000 50 | 0.1°C
Configuration | Registers | 64 0 H2 | OpConfig | 0 65535 25720 | flags
Configuration | Registers | 64 4 H1 | OpConfigD | 0 255 35 | flags
Gas Gauging | IT Cfg | 80 59 U2 | Ra Max Delta | 0 32767 8 | 4 mΩ
Gas Gauging | IT Cfg | 80 81 U1 | Design Energy Scale | 1 10 1 | Num
Gas Gauging | Current Thresholds | 81 0 I2 | Dsg Current Threshold | 0 2000 ? | 0.1 Hr rate
Gas Gauging | State | 82 6 I2 | Design Capacity | 0 8000 1340 | mAh
Gas Gauging | State | 82 8 I2 | Design Energy | 0 32767 4960 | mWh
Gas Gauging | State | 82 10 I2 | Terminate Voltage | 2500 3700 3200 | mV
Gas Gauging | State | 82 21 I2 | Taper Rate | 0 2000 100 | 0.1 Hr rate
Gas Gauging | State | 82 29 I2 | Delta Voltage | 0 1000 1 | mV
Ra Tables | Ra0 RAM | 89 2 I2 | Ra 1 | 0 32767 35 | Num
Gas Gauging | Chem Data | 109 8 I2 | Taper Voltage | 0 5000 4250 | mV
Calibration | CC Cal | 105 4 F4 | CC Gain | 0.1 40 ? | Num
Security | Codes | 112 0 H4 | Sealed to Unsealed | ? ? ? | hex
";
    assert_lists(chip, golden);
    assert_eq!(
        limits(chip),
        [
            "64/0 keep 0xd780",
            "64/2 keep 0xfb",
            "82/0 at least 1",
            "82/2 keep 0xfc",
            "82/5 keep 0x78",
            "82/6 at least 1",
        ]
    );
    // The whole block as recorded from a part's ROM, with its checksum: the defaults of the table and two
    // undocumented words give the same checksum.
    let state = chip.subclass(82).unwrap();
    let mut block = [0_u8; 32];
    block[12..16].copy_from_slice(&[0x00, 0xC8, 0x00, 0x32]);
    for parameter in state.parameters {
        let Range::Int { default: Some(default), .. } = parameter.range else { panic!("{}", parameter.name) };
        let (at, size) = (usize::from(parameter.offset), parameter.kind.size());
        block[at..at + size].copy_from_slice(&default.to_be_bytes()[8 - size..]);
    }
    assert_eq!(codec::checksum(&block), 0xFB);
}

#[test]
fn bq27426_has_the_layout_of_bq27427_and_its_chemistry() {
    let chip = Chip::by_name("bq27426").unwrap();
    let places = |chip: &'static Chip| {
        let place = |(class, one, _): (&'static Subclass, &'static Parameter, String)| {
            (class.id, one.offset, one.kind, one.name)
        };
        parameters(chip).map(place).collect::<Vec<_>>()
    };
    assert_eq!(places(chip), places(Chip::by_name("bq27427").unwrap()));
    let known = |id| chip.subclass(id).map(|class| (class.name, class.length, class.stored()));
    assert_eq!(known(83), Some(("OCV Table 83", 43, 64)));
    assert_eq!(known(84), Some(("OCV Table 84", 42, 64)));
    assert_eq!(known(85), Some(("Chemistry 85", 17, 32)));
    assert_eq!(known(108), Some(("Chemistry 108", 17, 32)));
    assert_eq!(known(104), Some(("Data", 58, 64)));
    let golden = "\
Configuration | Registers | 64 0 H2 | OpConfig | 0 65535 25720 | flags
Gas Gauging | IT Cfg | 80 59 U2 | Ra Max Delta | 0 32767 ? | 4 mΩ
Gas Gauging | State | 82 6 I2 | Design Capacity | 0 8000 1340 | mAh
Gas Gauging | State | 82 8 I2 | Design Energy | 0 32767 4960 | mWh
Gas Gauging | State | 82 10 I2 | Terminate Voltage | 2500 3700 3200 | mV
Gas Gauging | State | 82 21 I2 | Taper Rate | 0 2000 100 | 0.1 Hr rate
Gas Gauging | Chem Data | 109 8 I2 | Taper Voltage | 0 5000 ? | mV
Configuration | Registers | 64 3 H1 | OpConfigC | ? ? 159 | flags
Gas Gauging | IT Cfg | 80 81 U1 | Design Energy Scale | 1 10 1 | Num
Calibration | CC Cal | 105 8 F4 | CC Delta | 30000 3000000 ? | Num
Calibration | Current | 107 1 U1 | Deadband | 0 255 5 | mA
";
    assert_lists(chip, golden);
    assert_eq!(unproven(chip), 6);
}

#[test]
fn bq27621_g1_has_the_places_that_drivers_and_tis_image_agree_on() {
    let chip = Chip::by_name("bq27621-g1").unwrap();
    let ids: Vec<u8> = chip.subclasses.iter().map(|subclass| subclass.id).collect();
    assert_eq!(
        ids,
        [2, 36, 48, 49, 64, 68, 80, 81, 82, 83, 84, 85, 86, 108, 92, 93, 94, 95, 104, 106, 107, 112]
    );
    let proven = parameters(chip).filter(|(class, one, _)| !one.unproven && class.kind != Kind::Security);
    let proven: Vec<_> = proven.map(|(class, one, _)| format!("{}/{}", class.id, one.offset)).collect();
    assert_eq!(
        proven.join(" "),
        "2/0 2/2 2/4 36/0 36/2 36/5 36/6 49/0 49/1 49/2 49/3 64/0 64/2 82/0 82/2 82/3 82/5 82/7 82/9 82/19 82/20 82/22 \
         82/24 82/26 82/28 82/30 82/32 82/36"
    );
    let golden = "\
Gas Gauging | State | 82 3 I2 | Design Capacity | 0 8000 1340 | mAh
Gas Gauging | State | 82 5 I2 | Design Energy | 0 32767 4960 | mWh
Gas Gauging | State | 82 9 I2 | Terminate Voltage | 2500 3700 3200 | mV
Gas Gauging | State | 82 20 I2 | Taper Rate | 0 2000 100 | 0.1 Hr rate
Gas Gauging | State | 82 36 H2 | Chem ID | 0 65535 4610 | hex
";
    assert_lists(chip, golden);
    assert_eq!(
        limits(chip),
        ["64/0 keep 0x9360", "64/2 keep 0xfb", "82/0 at least 1", "82/2 keep 0x78", "82/3 at least 1"]
    );
    assert_eq!(
        listed(chip.control_status),
        "15:SHUTDOWNEN 14:WDRESET 13:SS 12:CALMODE 9:OCVCMDCOMP 8:OCVFAIL 7:INITCOMP 6:HIBERNATE 5:POWERMIN \
         4:SLEEP 3:LDMD 0:CHEMCHNG"
    );
}

#[test]
fn bq27520_g3_matches_published_drivers_and_marks_the_rest_unproven() {
    let chip = Chip::by_name("bq27520-g3").unwrap();
    let ids: Vec<u8> = chip.subclasses.iter().map(|subclass| subclass.id).collect();
    assert_eq!(ids, [2, 32, 34, 36, 48, 49, 57, 64, 68, 80, 81, 87, 88, 91, 92, 93, 94, 104, 107, 112]);
    let golden = "\
Configuration | Safety | 2 3 I2 | OT Chg Recovery | 0 1200 500 | 0.1°C | unproven
Configuration | Charge | 34 2 I2 | Charging Voltage | 0 20000 4200 | mV | unproven
Configuration | Charge Termination | 36 9 I1 | FC Set % | -1 100 100 | % | unproven
Configuration | Data | 48 10 I2 | Design Capacity | 0 32767 1000 | mAh
Configuration | Discharge | 49 0 U1 | SOC1 Set Threshold | ? ? 150 | mAh | unproven
Configuration | Discharge | 49 5 I2 | SysDown Set Volt Threshold | ? ? ? | mV | unproven
System Data | Manufacturer Info | 57 31 H1 | Block A 31 | 0 255 0 | hex
Configuration | Registers | 64 0 H2 | Operation Configuration | 0 65535 ? | flags
Configuration | Power | 68 0 I2 | Flash Update OK Voltage | 0 4200 2800 | mV | unproven
Fuel Gauging | IT Cfg | 80 45 I2 | Terminate Voltage | -32768 32767 3000 | mV
Fuel Gauging | Current Thresholds | 81 12 U2 | Max IR Correct | 0 1000 400 | mV | unproven
Ra Tables | Pack1 Rax | 94 18 H1 | Byte 18 | ? ? ? | hex | unproven
Calibration | Data | 104 0 F4 | CC Gain | 0.1014 47.68 0.4768 | Num | unproven
Calibration | Current | 107 1 U1 | Deadband | 0 255 5 | mA | unproven
Security | Codes | 112 6 H2 | Full-Access Key 1 | ? ? ? | hex
";
    assert_lists(chip, golden);
    let proven: Vec<String> = parameters(chip)
        .filter(|(class, one, _)| !one.unproven && ![57, 112].contains(&class.id))
        .map(|(class, one, _)| format!("{}/{}", class.id, one.offset))
        .collect();
    assert_eq!(proven, ["48/10", "64/0", "64/11", "80/45"]);
    assert_eq!(
        limits(chip),
        [
            "48/10 at least 1",
            "64/12 keep 0x8",
            "64/13 keep 0x1",
            "68/0 below the voltage",
            "80/45 2000 to 4200"
        ]
    );
    assert_eq!(
        flags(chip, "Flags"),
        "15:OTC 14:OTD 11:CHG_INH 10:XCHG 9:FC 8:CHG 5:OCV_GD 4:WAIT_ID 3:BAT_DET 2:SOC1 1:SYSDOWN 0:DSG"
    );
    assert_eq!(
        listed(chip.control_status),
        "15:DLOGEN 14:FAS 13:SS 12:CSV 11:CCA 10:BCA 9:OCVCMDCOMP 8:OCVFAIL 7:INITCOMP 6:HIBERNATE 5:SNOOZE \
         4:SLEEP 3:LDMD 2:RUP_DIS 1:VOK 0:QEN"
    );
}

/// What is equal in the manual of firmware 1.30 and in TI's images of 1.06 and 1.20.
#[test]
fn bq27500_is_writable_where_the_layouts_of_its_firmware_agree() {
    let proven = |name: &str| -> Vec<String> {
        parameters(Chip::by_name(name).unwrap())
            .filter(|(class, one, _)| !one.unproven && class.id != 112)
            .map(|(class, one, _)| format!("{}/{} {} {}", class.id, one.offset, one.kind, one.name))
            .collect()
    };
    let rows = proven("bq27500");
    assert_eq!(rows, proven("bq27500-v130"));
    assert_eq!(rows.len(), 33);
    let places: Vec<&str> = rows.iter().map(|row| row.split(' ').next().unwrap()).collect();
    assert_eq!(
        places.join(" "),
        "2/0 2/2 2/3 2/5 2/7 2/8 32/2 32/4 34/2 34/4 34/6 34/8 48/4 48/5 48/7 48/10 48/12 49/0 49/1 49/2 49/3 68/0 68/7 \
         68/16 68/18 80/0 80/48 81/0 81/2 81/4 81/6 81/8 81/9"
    );
}

#[test]
fn bq27500_has_the_places_of_its_firmware() {
    let [old, new] = ["bq27500", "bq27500-v130"].map(|name| Chip::by_name(name).unwrap());
    assert_lists(
        old,
        "\
Configuration | Charge Termination | 36 2 I2 | Taper Current | 0 1000 100 | mA | unproven
Configuration | Charge Termination | 36 12 I1 | FC Clear % | -1 100 98 | % | unproven
Configuration | Charge | 34 2 I2 | Charging Voltage | 0 20000 4200 | mV
",
    );
    assert_lists(
        new,
        "\
Configuration | Charge Termination | 36 0 I2 | Taper Current | 0 1000 100 | mA | unproven
Configuration | Charge Termination | 36 10 I1 | FC Clear % | -1 100 98 | % | unproven
Configuration | Registers | 64 8 U2 | Batt Insert Delay | 0 65535 0 | ms | unproven
Configuration | Power | 68 20 U2 | BAT_LOW Enable Voltage | 2800 4000 3400 | mV | unproven
Fuel Gauging | Current Thresholds | 81 12 U2 | Max IR Correct | 0 1000 400 | mV | unproven
",
    );
    let limits_of_both =
        ["34/2 3000 to 4600", "48/10 at least 1", "68/0 below the voltage", "80/48 2000 to 4200"];
    assert_eq!(limits(old), limits_of_both);
    assert_eq!(limits(new), limits_of_both);
    assert_eq!(
        flags(new, "Flags"),
        "15:OTC 14:OTD 11:CHG_INH 10:XCHG 9:FC 8:CHG 5:OCV_GD 4:WAIT_ID 3:BAT_DET 2:SOC1 1:SOCF 0:DSG"
    );
    assert_eq!(
        listed(new.control_status),
        "14:FAS 13:SS 12:CSV 11:CCA 10:BCA 6:HIBERNATE 5:SNOOZE 4:SLEEP 3:LDMD 2:RUP_DIS 1:VOK 0:QEN"
    );
}

#[test]
fn equal_class_names_are_prefixed_with_the_manuals_class() {
    let chip = Chip::by_name("bq34z100-g1").unwrap();
    let dir = |id| chip.class_dir(chip.subclass(id).unwrap());
    assert_eq!(dir(48), "configuration-data");
    assert_eq!(dir(104), "calibration-data");
    assert_eq!(dir(80), "it-cfg");
    assert_eq!(dir(56), "manufacturer-data");
}

#[test]
fn bq34110_matches_published_drivers() {
    let chip = Chip::by_name("bq34110").unwrap();
    // 16384 is 0x4000. Design Capacity's address and byte order are those of E2E 797502.
    let golden = "\
Calibration | Data | 0 16384 F4 | CC Gain | 0.02 10 0.47095 | 
Calibration | Data | 0 16388 F4 | CC Delta | 29826.2 5677445 567744.6 | 
Calibration | Data | 0 16400 U2 | Voltage Divider | 0 65535 ? | mV
Settings | Manufacturing | 0 16599 H2 | Mfg Status Init | 0 4095 ? | hex
Charge | Termination | 0 16674 U1 | Current Taper Window | ? ? ? | s | unproven
Configuration | Registers | 0 16698 H2 | Operation Config A | 0 65535 ? | hex
Configuration | Registers | 0 16701 H1 | Pin Control Config | 0 31 0 | hex
Configuration | Data | 0 16725 U1 | Number of Series Cells | 1 100 ? | Num
Configuration | Power | 0 16727 I2 | Flash Update OK Voltage | 0 5000 2800 | mV
Calibration | Temp Model | 0 16837 I2 | Int Coeff 3 | -32768 32767 -12324 | Num | unproven
Gas Gauging | Design | 0 16885 I2 | Design Capacity mAh | 0 32767 ? | mAh
Gas Gauging | CEDV Profile | 0 16986 I2 | Fixed EDV 0 | 0 32767 ? | mV
Gas Gauging | CEDV Profile | 0 16988 U1 | EDV 0 Hold Time | ? ? ? | s | unproven
Gas Gauging | CEDV Profile | 0 17015 I2 | Voltage 100% DOD | -32768 32767 ? | mV/cell
Gas Gauging | CEDV Config | 0 17054 U1 | RemCap Init Percent | 0 100 ? | %
";
    assert_lists(chip, golden);
    assert_eq!(unproven(chip), 48);
}

#[test]
fn bq27220_matches_its_manual_and_drivers() {
    let chip = Chip::by_name("bq27220").unwrap();
    // 37300 is 0x91B4, the first row of the manual's summary; 37535 is 0x929F, the address of its example in 6.1.
    let golden = "\
Calibration | Data | 0 37248 I2 | CC Offset | ? ? ? | Counts | unproven
Calibration | Offset | 0 37300 I1 | Board Offset | -128 127 0 | Counts
Calibration | Temperature | 0 37308 I2 | Internal Model Coefficient 3 | -32768 32767 -13356 | Num
Calibration | Temperature | 0 37322 I2 | External Model Coefficient b 1 | -32768 32767 328 | Num
Configuration | Charge | 0 37373 I2 | Charging Voltage | 0 4600 4200 | mV
Configuration | Charge | 0 37377 I2 | Taper Current | 0 1000 100 | mA
Configuration | Registers | 0 37384 H2 | Operation Config B | 0 65535 4096 | hex
Configuration | Current Thresholds | 0 37418 I2 | Chg Current Threshold | 0 2000 75 | mA
Gas Gauging | CEDV Configuration | 0 37483 I2 | Near Full | ? ? ? | mAh
Gas Gauging | SOC Flags | 0 37503 H2 | SOC Flag Config A | 0 4095 3212 | hex
Configuration | Registers | 0 37390 I2 | Init Discharge Set | ? ? ? | mAh
Configuration | Registers | 0 37394 H2 | Device Type | 0 65535 544 | hex
Gas Gauging | SOC Flags | 0 37506 I2 | FD Set Voltage Threshold | ? ? ? | mV
Gas Gauging | SOC Flags | 0 37529 U1 | TC Clear % RSOC Threshold | ? ? ? | %
Gas Gauging | CEDV Profile 1 | 0 37531 H2 | Gauging Configuration | 0 65535 ? | hex
Gas Gauging | CEDV Profile 1 | 0 37535 I2 | Design Capacity | 0 32767 3000 | mAh
Gas Gauging | CEDV Profile 1 | 0 37539 I2 | Design Voltage | 0 32767 3700 | mV
Gas Gauging | CEDV Profile 1 | 0 37543 U2 | EMF | 0 65535 3743 | Num
Gas Gauging | CEDV Profile 1 | 0 37585 I2 | Voltage 100% DOD | 0 32767 ? | mV
";
    assert_lists(chip, golden);
    assert_eq!(unproven(chip), 3);
    let bits = |name| {
        let register = chip.registers.iter().find(|one| one.name == name);
        listed(register.unwrap().bits)
    };
    assert_eq!(
        bits("BatteryStatus"),
        "15:FD 14:OCVCOMP 13:OCVFAIL 12:SLEEP 11:OTC 10:OTD 9:FC 8:CHGINH 6:TCA 5:OCVGD 4:AUTH_GD 3:BATTPRES 2:TDA \
         1:SYSDWN 0:DSG"
    );
    assert_eq!(
        bits("OperationStatus"),
        "10:CFGUPDATE 7:BTPINT 6:SMTH 5:INITCOMP 4:VDQ 3:EDV2 2:SEC1 1:SEC0 0:CALMD"
    );
    assert_eq!(listed(chip.control_status), "5:CCA 4:BCA 3:SNOOZE 2:BATT_ID2 1:BATT_ID1 0:BATT_ID0");
}

#[test]
fn bq35100_matches_its_documents() {
    let chip = Chip::by_name("bq35100").unwrap();
    // 16817 is 0x41B1, the address of SLUA790's example; SLUUBH1C chapters 7 and 8; SLUAAL7, section 7.
    let golden = "\
Calibration | Data | 0 16384 F4 | CC Gain | 0.02 10 ? | 
System Data | Manufacturer Info | 0 16469 H1 | Manufacturer Info Block A32 | 0 255 ? | hex
Configuration | Data | 0 16480 S8 | Device Name | x x bq35100 |  | unproven
Configuration | Registers | 0 16817 H1 | Operation Config A | 0 255 128 | hex
Configuration | Registers | 0 16818 H1 | ALERT Configuration | 0 255 0 | hex
Configuration | Power | 0 16822 I2 | Flash Update OK Voltage | ? ? ? | mV | unproven
Security | Codes | 0 16844 H2 | Unseal Step 1 | 1 65535 ? | hex
Configuration | Discharge | 0 16859 I2 | BatLow Voltage Set Threshold | 0 5000 2800 | mV
Configuration | Discharge | 0 16861 U1 | BatLow Voltage Set Time | 0 255 10 | s | unproven
Configuration | Discharge | 0 16864 I2 | Under Temperature Set Threshold | -400 850 -200 | 0.1°C
Configuration | Discharge | 0 16867 I2 | Under Temperature Clear Threshold | 0 255 100 | 0.1°C
Gas Gauging | Design | 0 16894 I2 | Cell Design Capacity mAh | ? ? ? | mAh
EOS Data | Values | 0 16987 U1 | R Short Trend Filter | 1 255 251 | 
EOS Data | Values | 0 16990 U2 | EOS Detection Pulse Count Thrshd | 1 20000 120 | Num
EOS Data | Values | 0 16996 U4 | Long Trend Average | 1 8355712 ? | 
Accumulator Table | Table1 | 0 17144 I4 | Table1 Fractional Part 8 | ? ? ? |  | unproven
";
    assert_lists(chip, golden);
    assert_eq!(unproven(chip), 114);
}

#[test]
fn bq34110_and_bq35100_flags_match_their_sources() {
    let bits = |chip: &str, name| {
        let register = Chip::by_name(chip).unwrap().registers.iter().find(|one| one.name == name);
        listed(register.unwrap().bits)
    };
    assert_eq!(
        bits("bq34110", "BatteryStatus"),
        "14:SOCLOW 13:UTC 12:UTD 11:OTC 10:OTD 9:BATHIGH 8:BATLOW 7:SLEEP 6:CHGINH 5:FD 4:FC 3:TCA 2:TDA 1:CHG \
         0:DSG"
    );
    assert_eq!(bits("bq34110", "OperationStatus"), "9:INITCOMP 4:VDQ 3:EDV2 2:SEC1 1:SEC0 0:CALMD");
    assert_eq!(
        listed(Chip::by_name("bq35100").unwrap().control_status),
        "15:FLASHF 14:SEC1 13:SEC0 12:CALMODE 11:BCA 10:CCA 9:LTEN 8:OCVFAIL 7:INITCOMP 6:G_DONE 5:SOH_ERR \
         4:SOH_MERIT 3:EOS_BAD_OCV 0:GA"
    );
    assert_eq!(bits("bq35100", "BatteryStatus"), "2:ALERT 0:DSG");
    assert_eq!(
        bits("bq35100", "BatteryAlert"),
        "7:BATLOW 6:TEMPLOW 5:TEMPHIGH 4:SOH_LOW 3:EOS 1:G_DONE 0:INITCOMP"
    );
}

#[test]
fn equal_names_of_flat_groups_are_prefixed_with_their_class() {
    let chip = Chip::by_name("bq35100").unwrap();
    let dirs: Vec<String> = chip.subclasses.iter().map(|class| chip.class_dir(class)).collect();
    for name in ["calibration-data", "configuration-data", "lifetime-data", "registers", "values", "table0"] {
        assert!(dirs.iter().any(|dir| dir == name), "{name} is not in {dirs:?}");
    }
    assert_eq!(chip.parameter(FLAT, 0x41B1).map(|one| one.name), Some("Operation Config A"));
    assert_eq!(chip.parameter(FLAT, 0x41B4).map(|one| one.name), None);
}
