// SPDX-License-Identifier: MIT

//! Images in their formats: `ti_gauge::image`.

use std::collections::BTreeMap;

use ti_gauge::chip::{CHIPS, Kind, Subclass};
use ti_gauge::codec;
use ti_gauge::image::{Entry, Format, Image, Raw, flashstream, ggcsv, toml};
use ti_gauge::value::Value;

pub(crate) fn toml(input: &[u8]) {
    check(input, Format::Toml);
}

pub(crate) fn ggcsv(input: &[u8]) {
    check(input, Format::GgCsv);
    let Some(image) = Image::examine("pack.gg.csv", input, Some(CHIPS[0])).image else { return };
    let is_enclosed = |text: &[u8]| text.len() > 1 && text.starts_with(b"\"") && text.ends_with(b"\"");
    let has_bytes = input.to_ascii_lowercase().windows(3).any(|letters| letters == b"raw");
    for Entry { value, .. } in &image.entries {
        assert!(
            has_bytes || !matches!(value, Value::Text(text) if is_enclosed(text)),
            "quotes are in an image"
        );
    }
}

/// The older form, in sections.
pub(crate) fn gg(input: &[u8]) {
    check(input, Format::GgCsv);
}

pub(crate) fn flashstream(input: &[u8]) {
    check(input, Format::FlashStream);
}

fn check(input: &[u8], format: Format) {
    let text = String::from_utf8_lossy(input);
    let parse = |text: &str, chip| match format {
        Format::Toml => toml::parse(text, chip),
        Format::GgCsv => ggcsv::parse(text, chip),
        Format::FlashStream => flashstream::parse(text, chip),
    };
    let _ = parse(&text, None).or_else(|_| parse(&text, Some(CHIPS[0])));
    // The first line may be that of another format, which is then read as that one. Only this refuses what is empty,
    // cut short or there twice.
    let image = Image::parse(&text, None).or_else(|_| Image::parse(&text, Some(CHIPS[0])));
    let Ok(image) = image else { return };
    for entry in &image.entries {
        assert!(entry.subclass.kind != Kind::Security, "a key is in an image: {}", entry.parameter.name);
        assert!(
            codec::Layout::TI.encode(entry.parameter.kind, &entry.value).is_some(),
            "{}",
            image.name(entry)
        );
    }
    // The result depends on the values only.
    drop(image.to_restore());
    drop(image.undocumented());
    drop(image.raw_changes(|id| Ok(stored(&image, id)), true));
    drop(image.changes(&image, &[], false).map(|changes| assert!(changes.changes.is_empty())));
    for format in [Format::Toml, Format::GgCsv, Format::FlashStream] {
        reads_back(&image, format);
    }
}

/// What is written in a format is read as the same values.
fn reads_back(image: &Image, format: Format) {
    // Firmware that no chip has is refused where the file is opened, after it was parsed.
    let known = image.chip.identity.firmware;
    if image.firmware.is_some_and(|firmware| !known.is_empty() && !known.contains(&firmware)) {
        return;
    }
    // A character that a terminal could act on is written as `_`, and FlashStream leaves out what is unproven.
    let is_compared = |entry: &&Entry| {
        let plain = !matches!(&entry.value, Value::Text(_)) || entry.text() == plain(&entry.value);
        plain && !(format == Format::FlashStream && entry.parameter.unproven)
    };
    // A file without parameters is refused: it would look like a gauge that has none.
    if !image.entries.iter().any(|entry| !(format == Format::FlashStream && entry.parameter.unproven)) {
        return;
    }
    let text = image.write(format, |id| Ok(stored(image, id))).expect("values of an image");
    let again = Image::parse(&text, None).unwrap_or_else(|error| panic!("{format:?}: {error}\n{text}"));
    assert!(std::ptr::eq(image.chip, again.chip));
    assert_eq!(image.firmware, again.firmware);
    let bytes = |image: &Image| -> BTreeMap<String, Option<Vec<u8>>> {
        let entries = image.entries.iter().filter(is_compared);
        entries
            .map(|entry| (image.name(entry), codec::Layout::TI.encode(entry.parameter.kind, &entry.value)))
            .collect()
    };
    let (old, new) = (bytes(image), bytes(&again));
    for (name, value) in &old {
        assert_eq!(new.get(name), Some(value), "{format:?}: {name}\n{text}");
    }
    if format != Format::FlashStream {
        assert_eq!(image.entries.len(), again.entries.len(), "{format:?}\n{text}");
    }
}

fn plain(value: &Value) -> String {
    let Value::Text(bytes) = value else { return String::new() };
    String::from_utf8_lossy(bytes).into_owned()
}

/// A subclass as it is on a gauge that has the values of the image, and elsewhere zeroes.
fn stored(image: &Image, id: u8) -> Vec<u8> {
    let length = image.chip.subclass(id).map_or(0, Subclass::stored);
    let mut bytes = vec![0; length.into()];
    let mut put = |offset: usize, from: &[u8]| {
        if let Some(into) = bytes.get_mut(offset..offset + from.len()) {
            into.copy_from_slice(from);
        }
    };
    for Raw { subclass, offset, bytes, .. } in &image.raw {
        if *subclass == id {
            put((*offset).into(), bytes);
        }
    }
    for entry in image.entries.iter().filter(|entry| entry.subclass.id == id) {
        let bytes = codec::Layout::TI.encode(entry.parameter.kind, &entry.value).unwrap_or_default();
        put((entry.parameter.offset - entry.subclass.start()).into(), &bytes);
    }
    bytes
}
