// SPDX-License-Identifier: MIT

//! Key words, which appear in no log, trace, error or process list. An error about a key file has no content of it: a line
//! that is not understood may be a key. A key is in one allocation, which is wiped with its last owner.

use std::fmt;
use std::sync::Arc;

use zeroize::{Zeroize, Zeroizing};

use crate::codec::Layout;
use crate::error::{Cause, Error, Result};

/// Name of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Name {
    /// From SEALED to UNSEALED.
    Unseal,
    /// From UNSEALED to FULL ACCESS.
    FullAccess,
    /// Answers a challenge.
    Authentication,
}

impl Name {
    /// All names.
    pub const ALL: [Name; 3] = [Name::Unseal, Name::FullAccess, Name::Authentication];

    fn row(self) -> (&'static str, &'static str, Form) {
        match self {
            Name::Unseal => ("unseal", "unseal", Form::Words),
            Name::FullAccess => ("full-access", "full_access", Form::Words),
            Name::Authentication => ("authentication", "authentication", Form::Digits),
        }
    }

    /// Name in a command.
    pub fn as_str(self) -> &'static str {
        self.row().0
    }

    /// Start of its line in a key file.
    pub fn line(self) -> &'static str {
        self.row().1
    }

    /// Description of its form.
    pub fn form(self) -> &'static str {
        match self.row().2 {
            Form::Words => "expected two words of four hexadecimal digits, such as 0414 3672",
            Form::Digits => "expected 32 hexadecimal digits",
        }
    }
}

enum Form {
    /// Two words in their order on the wire.
    Words,
    /// 16 bytes, with spaces between any two of them.
    Digits,
}

/// A key: two words in their order on the wire, big-endian, or 16 bytes. Clones share it, and a move leaves no copy.
#[derive(Clone, PartialEq, Eq)]
pub struct Secret(Arc<Zeroizing<Vec<u8>>>);

impl From<[u16; 2]> for Secret {
    fn from([first, second]: [u16; 2]) -> Self {
        let ([a, b], [c, d]) = (Layout::TI.bytes_of(first), Layout::TI.bytes_of(second));
        Self::of_bytes(&[a, b, c, d])
    }
}

impl Secret {
    /// Reads a typed key.
    pub fn parse(name: Name, text: &str) -> Option<Self> {
        let words = text.split_ascii_whitespace();
        match name.row().2 {
            Form::Words => {
                let mut words = words.map(|word| word.strip_prefix("0x").unwrap_or(word));
                let is_key = words.clone().count() == 2 && words.all(|word| word.len() == 4);
                let digits = text.split_ascii_whitespace();
                let digits = digits.flat_map(|word| word.strip_prefix("0x").unwrap_or(word).bytes());
                if is_key { Self::of_digits(digits, 4) } else { None }
            }
            Form::Digits => Self::of_digits(words.flat_map(str::bytes), 16),
        }
    }

    fn of_digits(mut digits: impl Iterator<Item = u8>, length: usize) -> Option<Self> {
        let mut bytes = Zeroizing::new(Vec::with_capacity(length));
        let half = |digit: u8| char::from(digit).to_digit(16).map(|half| half as u8);
        while let Some(digit) = digits.next() {
            if bytes.len() == length {
                return None;
            }
            bytes.push(half(digit)? << 4 | half(digits.next()?)?);
        }
        (bytes.len() == length).then(|| Self(Arc::new(bytes)))
    }

    /// A key of these bytes.
    pub fn of_bytes(bytes: &[u8]) -> Self {
        Self(Arc::new(Zeroizing::new(bytes.to_vec())))
    }

    /// Bytes of the key.
    pub fn bytes(&self) -> &[u8] {
        &self.0
    }

    /// The two words of the key.
    pub fn words(&self) -> [u16; 2] {
        let word = |at: usize| Layout::TI.word([self.0[at], self.0[at + 1]]);
        [word(0), word(2)]
    }

    /// Whether it reads like erased flash.
    pub fn is_erased(&self) -> bool {
        self.0.iter().all(|byte| *byte == 0xff)
    }

    pub(crate) fn has_erased_word(&self) -> bool {
        self.0.chunks(2).any(|word| word == [0xff; 2])
    }

    /// The key as typed.
    pub fn text(&self) -> Zeroizing<String> {
        let mut text = Zeroizing::new(String::with_capacity(2 * self.0.len() + 1));
        for (at, byte) in self.0.iter().enumerate() {
            if at == 2 && self.0.len() == 4 {
                text.push(' ');
            }
            for half in [byte >> 4, byte & 0xf] {
                text.push(char::from(b"0123456789abcdef"[usize::from(half)]));
            }
        }
        text
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("hidden")
    }
}

/// A request to `gauge/keys`: a new key, and the old one as proof of permission.
#[derive(Clone, Debug)]
pub struct KeyChange {
    /// The key to change.
    pub name: Name,
    /// The gauge's present key.
    pub old: Secret,
    /// The key that replaces it.
    pub new: Secret,
}

impl KeyChange {
    /// Reads `unseal OLD NEW`. An error does not repeat the text.
    pub fn parse(text: &[u8]) -> Result<Self> {
        let change = Self::parse_line(text);
        wipe_stack();
        change
    }

    fn parse_line(text: &[u8]) -> Result<Self> {
        let refuse = |why: String| Error::new("keys", Cause::Invalid, why);
        let one_line = || {
            refuse(
                "expected `NAME OLD NEW` in one write, NAME one of unseal, full-access, authentication"
                    .into(),
            )
        };
        let text = std::str::from_utf8(text).map_err(|_| one_line())?.trim();
        let (word, keys) = text.split_once(' ').ok_or_else(one_line)?;
        let name = Name::ALL.into_iter().find(|name| name.as_str() == word).ok_or_else(one_line)?;
        let keys = keys.trim();
        // Both keys must have the same number of words.
        let count = keys.split_ascii_whitespace().count();
        let middle = keys.split_ascii_whitespace().nth(count / 2).filter(|_| count % 2 == 0);
        let at = middle.map(|word| word.as_ptr() as usize - keys.as_ptr() as usize).ok_or_else(one_line)?;
        let key = |text| {
            Secret::parse(name, text)
                .ok_or_else(|| refuse(format!("{} twice, the old key and the new one", name.form())))
        };
        Ok(Self { name, old: key(&keys[..at])?, new: key(&keys[at..])? })
    }
}

/// The keys of a gauge.
#[derive(Clone, Default)]
pub struct Keys {
    /// By [`Name`].
    secrets: [Option<Secret>; Name::ALL.len()],
    /// Whether the manual's default keys must not be tried for missing ones.
    pub no_default: bool,
}

impl fmt::Debug for Keys {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Keys { hidden }")
    }
}

/// Depth below its caller that [`wipe_stack`] wipes, in bytes.
pub const WIPED: usize = 24 * 1024;

/// How deep the words of a key are wiped. What is wiped stays in memory, so it is no more than a poll needs.
pub const WIPED_OF_WORDS: usize = 8 * 1024;

/// Wipes copies of keys that functions have left on the stack.
#[inline(never)]
pub fn wipe_stack() {
    [0u128; WIPED / size_of::<u128>()].zeroize();
}

#[inline(never)]
pub(crate) fn wipe_words() {
    [0u128; WIPED_OF_WORDS / size_of::<u128>()].zeroize();
}

impl Keys {
    /// No key, not even the manual's.
    pub fn none() -> Self {
        Self { no_default: true, ..Self::default() }
    }

    /// One key; of the others the manual's.
    pub fn of(name: Name, secret: &Secret) -> Self {
        let mut keys = Self::default();
        keys.set(name, secret);
        keys
    }

    /// Reads lines such as `unseal = 0414 3672`, for all gauges; those below `[NAME]` are for one and take precedence.
    pub fn parse(name: &str, text: &[u8], gauge: &str) -> Result<Self> {
        let keys = Self::parse_lines(name, text, gauge);
        wipe_stack();
        keys
    }

    fn parse_lines(name: &str, text: &[u8], gauge: &str) -> Result<Self> {
        let (mut general, mut own) = (Self::default(), Self::default());
        let mut sections: Vec<&str> = Vec::new();
        let mut present = Self::default();
        for (number, line) in (1..).zip(text.split(|&byte| byte == b'\n')) {
            let refuse =
                |why: &'static str| Error::new(format!("{name}: line {number}"), Cause::Invalid, why);
            let line = std::str::from_utf8(line).map_err(|_| refuse("not text"))?;
            let line = line.split('#').next().unwrap_or_default().trim();
            if line.is_empty() {
                continue;
            }
            if let Some(rest) = line.strip_prefix('[') {
                let section = rest.strip_suffix(']').map(str::trim).filter(|section| is_name(section));
                let section =
                    section.ok_or_else(|| refuse("expected a gauge's name in brackets, such as [BAT0]"))?;
                if sections.contains(&section) {
                    return Err(refuse("this gauge already has a section"));
                }
                sections.push(section);
                present = Self::default();
                continue;
            }
            let Some((key, value)) = line.split_once('=') else {
                return Err(refuse("not of the form `name = value`"));
            };
            let key = Name::ALL.into_iter().find(|known| known.line() == key.trim());
            let key =
                key.ok_or_else(|| refuse("unknown name; expected unseal, full_access or authentication"))?;
            let secret = Secret::parse(key, value).ok_or_else(|| refuse(key.form()))?;
            if present.secret(key).is_some() {
                return Err(refuse("this key was already given"));
            }
            present.set(key, &secret);
            match sections.last() {
                None => general.set(key, &secret),
                Some(&section) if section == gauge => own.set(key, &secret),
                Some(_) => {}
            }
        }
        for key in Name::ALL {
            if let Some(secret) = own.secret(key) {
                general.set(key, &secret);
            }
        }
        Ok(general)
    }

    /// The key of that name.
    pub fn secret(&self, name: Name) -> Option<Secret> {
        self.secrets[name as usize].clone()
    }

    /// Whether there are no keys.
    pub fn is_empty(&self) -> bool {
        self.secrets.iter().all(Option::is_none)
    }

    /// Replaces the key of that name.
    pub fn set(&mut self, name: Name, secret: &Secret) {
        self.secrets[name as usize] = Some(secret.clone());
    }
}

/// Whether this is a valid name for a gauge's folder.
pub fn is_name(text: &str) -> bool {
    let allowed = |byte: u8| byte.is_ascii_alphanumeric() || b"._+-".contains(&byte);
    !text.is_empty() && text.len() <= 64 && text.bytes().all(allowed) && !text.starts_with(['.', '-'])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        Keys::parse("keys", text.as_bytes(), "BAT0").expect_err("a bad key file").to_string()
    }

    #[test]
    fn a_key_file_has_names_words_and_comments() {
        let text = "# pack 7\nunseal = 0414 3672\n\nfull_access=FFFF ffff # as it came\r\n\
                    authentication = 0123456789abcdef FEDCBA9876543210";
        let keys = Keys::parse("keys", text.as_bytes(), "BAT0").expect("a good key file");
        assert_eq!(keys.secret(Name::Unseal), Some([0x0414, 0x3672].into()));
        assert_eq!(keys.secret(Name::FullAccess), Some([0xffff, 0xffff].into()));
        assert_eq!(
            keys.secret(Name::Authentication).map(|key| (key.bytes()[0], key.bytes()[8])),
            Some((0x01, 0xfe))
        );
        assert!(Keys::parse("keys", b"", "BAT0").expect("an empty one").is_empty());
    }

    #[test]
    fn an_error_names_the_line_and_nothing_on_it() {
        assert_eq!(
            error("# a\nunseal = 0414 367"),
            "keys: line 2: expected two words of four hexadecimal digits, such as 0414 3672"
        );
        assert_eq!(error("0414beef"), "keys: line 1: not of the form `name = value`");
        assert_eq!(
            error("beef = cafe"),
            "keys: line 1: unknown name; expected unseal, full_access or authentication"
        );
        assert_eq!(error("authentication = 0123"), "keys: line 1: expected 32 hexadecimal digits");
        assert_eq!(
            error("unseal = 1234 5678\nunseal = 1234 5678"),
            "keys: line 2: this key was already given"
        );
        assert_eq!(error("unseal = +123 5678 1"), error("unseal = 1"));
    }

    #[test]
    fn a_section_is_for_one_gauge() {
        let text = b"unseal = 1111 2222\nfull_access = 3333 4444\n[BAT0]\nunseal = 5555 6666 # its own\n\n\
                     [ PACK-7 ]\nauthentication = 000102030405060708090a0b0c0d0e0f\n";
        let keys = |gauge| Keys::parse("keys", text, gauge).expect("a good key file");
        assert_eq!(keys("BAT0").secret(Name::Unseal), Some([0x5555, 0x6666].into()));
        assert_eq!(keys("BAT0").secret(Name::FullAccess), Some([0x3333, 0x4444].into()));
        assert!(keys("BAT0").secret(Name::Authentication).is_none());
        assert_eq!(keys("PACK-7").secret(Name::Unseal), Some([0x1111, 0x2222].into()));
        assert_eq!(keys("PACK-7").secret(Name::Authentication).map(|key| key.bytes()[15]), Some(15));
        assert_eq!(keys("BAT").secret(Name::Unseal), Some([0x1111, 0x2222].into()));
    }

    #[test]
    fn a_bad_section_is_refused_for_any_gauge() {
        for (text, line, why) in [
            ("[BAT0\n", 1, "expected a gauge's name in brackets"),
            ("\n[a/b]", 2, "expected a gauge's name in brackets"),
            ("[]", 1, "expected a gauge's name in brackets"),
            ("[BAT0]\n[BAT1]\n[BAT0]", 3, "this gauge already has a section"),
            ("[BAT1]\nunseal = 1234", 2, "expected two words"),
            ("[BAT1]\nunseal = 1234 5678\nunseal = 1234 5678", 3, "this key was already given"),
            ("[BAT1]\nbeef = 1234", 2, "unknown name"),
        ] {
            let told = error(text);
            assert!(told.starts_with(&format!("keys: line {line}: {why}")), "{told}");
            assert!(!told.contains("1234") && !told.contains("beef") && !told.contains("BAT1"), "{told}");
        }
    }

    #[test]
    fn a_change_is_a_name_and_two_keys() {
        let change = |text: &str| KeyChange::parse(text.as_bytes());
        let one = change("unseal 0414 3672  1234 abCD\n").expect("a change");
        assert_eq!(
            (one.name, one.old.words(), one.new.words()),
            (Name::Unseal, [0x0414, 0x3672], [0x1234, 0xabcd])
        );
        assert_eq!(&*one.new.text(), "1234 abcd");
        let digits = "0123456789abcdeffedcba9876543210";
        let spaced = "01234567 89abcdef fedcba98 76543211";
        let one =
            change(&format!("authentication {spaced} {}", spaced.replace("11", "12"))).expect("a change");
        assert_eq!((one.old.bytes()[15], one.new.bytes()[15]), (0x11, 0x12));
        let one = change(&format!("authentication {digits} {}", digits.replace('7', "8"))).expect("a change");
        assert_eq!(&*one.old.text(), digits);
        for text in [
            "",
            "unseal",
            "unseal 0414 3672",
            "unseal 0414 3672 1234",
            "unseal 0414 3672 1234 567",
            "unseal 0414 3672 1234 5678 9abc",
            "full_access ffff ffff 1234 5678",
            &format!("authentication {digits}"),
            &format!("unseal {digits} {digits}"),
        ] {
            let error = change(text).expect_err("no change");
            assert!(matches!(error.cause(), Cause::Invalid));
            assert!(
                !["0414", "1234", "567", "0123", "ffff"]
                    .iter()
                    .any(|key| { error.to_string().replace("0414 3672", "").contains(key) }),
                "{error}"
            );
        }
    }

    #[test]
    fn keys_do_not_show_themselves() {
        let keys = Keys::of(Name::Unseal, &[0xbeef, 0xcafe].into());
        assert_eq!(format!("{keys:?}"), "Keys { hidden }");
        let change = KeyChange::parse(b"unseal 0414 3672 beef cafe").expect("a change");
        assert_eq!(format!("{change:?}"), "KeyChange { name: Unseal, old: hidden, new: hidden }");
    }
}
