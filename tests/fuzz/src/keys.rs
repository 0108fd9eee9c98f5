// SPDX-License-Identifier: MIT

//! Key files and key changes: `ti_gauge::keys`.

use ti_gauge::error::Error;
use ti_gauge::keys::{KeyChange, Keys, Name, Secret};

/// What an error about keys may say that a key may contain as well.
const SAYS: [&str; 2] = ["0414", "3672"];

pub(crate) fn run(input: &[u8]) {
    for gauge in ["BAT0", "PACK"] {
        match Keys::parse("pack.keys", input, gauge) {
            Ok(keys) => reads_back(&keys),
            Err(error) => shows_no_key(&error, input),
        }
    }
    match KeyChange::parse(input) {
        Ok(change) => {
            for key in [&change.old, &change.new] {
                assert_eq!(Secret::parse(change.name, &key.text()).as_ref(), Some(key));
            }
        }
        Err(error) => shows_no_key(&error, input),
    }
}

fn reads_back(keys: &Keys) {
    let mut text = String::new();
    for name in Name::ALL {
        if let Some(secret) = keys.secret(name) {
            text += &format!("{} = {}\n", name.line(), *secret.text());
        }
    }
    let again = Keys::parse("again.keys", text.as_bytes(), "BAT0").expect("its own text");
    for name in Name::ALL {
        assert_eq!(again.secret(name), keys.secret(name), "{}", name.line());
    }
}

/// No word that could be a part of a key is in an error.
fn shows_no_key(error: &Error, input: &[u8]) {
    let (error, input) = (error.to_string(), String::from_utf8_lossy(input));
    for word in error.split(|letter: char| !letter.is_ascii_alphanumeric()) {
        let may_be_key = word.len() >= 4 && word.bytes().all(|byte| byte.is_ascii_hexdigit());
        let repeated = input.contains(word) && !SAYS.contains(&word);
        // The number of a line may be any number.
        let number = error.contains(&format!("line {word}:"));
        assert!(!(may_be_key && repeated) || number, "the error repeats {word}: {error}");
    }
}
