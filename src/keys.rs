//! Key words, which appear nowhere: not in a log, a trace, an error or a process list.
//!
//! Errors about a key file name the file and the line, never what stands there: a line that is not
//! understood may be a key all the same. The words are wiped from memory when they are dropped.

use std::fmt;
use std::fs::File;
use std::io::{self, Read};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use nix::errno::Errno;
use zeroize::{Zeroize, Zeroizing};

use crate::error::{Cause, Error, Result};

/// The keys of one gauge.
#[derive(Clone, Default)]
pub struct Keys {
    /// The two words that unseal, in the order they are sent.
    pub unseal: Option<[u16; 2]>,
    /// The two words that lead from UNSEALED to FULL ACCESS.
    pub full_access: Option<[u16; 2]>,
    /// The key with which the gauge computes the answer to a challenge.
    pub authentication: Option<[u8; 16]>,
    /// Whether the manual's default keys must not be tried where none is given.
    pub no_default: bool,
}

impl Drop for Keys {
    fn drop(&mut self) {
        self.unseal.zeroize();
        self.full_access.zeroize();
        self.authentication.zeroize();
    }
}

impl fmt::Debug for Keys {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Keys { hidden }")
    }
}

/// Name of the systemd credential that takes the place of a key file.
pub const CREDENTIAL: &str = "gaugefs-keys";
/// A key file has a few lines; more than this is some other file.
const LONGEST: usize = 4096;

impl Keys {
    /// The keys of a file that nobody but its owner may read.
    pub fn from_file(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let (file, status) = open(path, &name)?;
        let me = nix::unistd::geteuid().as_raw();
        let refuse = |why: String| Err(Error::new(&name, Cause::NotPermitted(why)));
        if status.uid() != me && status.uid() != 0 {
            return refuse(format!(
                "the key file belongs to user {}; it must be yours or root's",
                status.uid()
            ));
        }
        if status.mode() & 0o077 != 0 {
            let mode = status.mode() & 0o777;
            return refuse(format!("others may read the key file (mode {mode:03o}); chmod 600 {name}"));
        }
        Self::parse(&name, &read(file, &name)?)
    }

    /// The keys that systemd hands to the service, where it does. Who may read them is its business.
    pub fn from_credential() -> Result<Option<Self>> {
        let Some(folder) = std::env::var_os("CREDENTIALS_DIRECTORY") else { return Ok(None) };
        let path = PathBuf::from(folder).join(CREDENTIAL);
        if !path.exists() {
            return Ok(None);
        }
        let name = path.display().to_string();
        let (file, _) = open(&path, &name)?;
        Self::parse(&name, &read(file, &name)?).map(Some)
    }

    /// Reads lines such as `unseal = 0414 3672`; `#` starts a comment.
    pub fn parse(name: &str, text: &[u8]) -> Result<Self> {
        let mut keys = Self::default();
        for (number, line) in (1..).zip(text.split(|&byte| byte == b'\n')) {
            let refuse = |why: &str| Error::new(format!("{name}: line {number}"), Cause::Invalid(why.into()));
            let line = std::str::from_utf8(line).map_err(|_| refuse("not text"))?;
            let line = line.split('#').next().unwrap_or_default().trim();
            if line.is_empty() {
                continue;
            }
            let Some((key, value)) = line.split_once('=') else {
                return Err(refuse("not of the form `name = value`"));
            };
            let twice = match key.trim() {
                "unseal" => {
                    let words = words(value).ok_or_else(|| refuse(WORDS))?;
                    keys.unseal.replace(words).is_some()
                }
                "full_access" => {
                    let words = words(value).ok_or_else(|| refuse(WORDS))?;
                    keys.full_access.replace(words).is_some()
                }
                "authentication" => {
                    let digits = digits(value).ok_or_else(|| refuse("expected 32 hexadecimal digits"))?;
                    keys.authentication.replace(digits).is_some()
                }
                _ => return Err(refuse("the name is none of: unseal, full_access, authentication")),
            };
            if twice {
                return Err(refuse("this key was given on a line before"));
            }
        }
        Ok(keys)
    }
}

const WORDS: &str = "expected two words of four hexadecimal digits, such as 0414 3672";

/// Two key words such as `0414 3672`, in the order they are sent.
pub fn words(text: &str) -> Option<[u16; 2]> {
    let mut words = text.split_ascii_whitespace().map(|word| {
        let word = word.strip_prefix("0x").unwrap_or(word);
        let hexadecimal = word.len() == 4 && word.bytes().all(|byte| byte.is_ascii_hexdigit());
        hexadecimal.then(|| u16::from_str_radix(word, 16).ok()).flatten()
    });
    let key = [words.next()??, words.next()??];
    words.next().is_none().then_some(key)
}

fn digits(text: &str) -> Option<[u8; 16]> {
    let text = Zeroizing::new(text.split_ascii_whitespace().collect::<String>());
    if text.len() != 32 || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return None;
    }
    let mut key = [0; 16];
    for (at, byte) in key.iter_mut().enumerate() {
        *byte = u8::from_str_radix(&text[2 * at..2 * at + 2], 16).ok()?;
    }
    Some(key)
}

fn open(path: &Path, name: &str) -> Result<(File, std::fs::Metadata)> {
    let failed = |error: io::Error| Error::io(name, "cannot read the key file", &error);
    // A fifo must not keep the open waiting.
    let mut options = File::options();
    options.read(true).custom_flags(nix::libc::O_NONBLOCK | nix::libc::O_NOCTTY);
    let file = options.open(path).map_err(failed)?;
    let status = file.metadata().map_err(failed)?;
    if !status.is_file() {
        return Err(Error::host(name, Errno::EINVAL, "not a file, so not a key file"));
    }
    Ok((file, status))
}

fn read(file: File, name: &str) -> Result<Zeroizing<Vec<u8>>> {
    // Reserved at once: growing would leave copies behind that nobody wipes.
    let mut text = Zeroizing::new(Vec::with_capacity(LONGEST + 1));
    file.take(LONGEST as u64 + 1)
        .read_to_end(&mut text)
        .map_err(|error| Error::io(name, "cannot read the key file", &error))?;
    if text.len() > LONGEST {
        return Err(Error::new(name, Cause::Invalid("too long for a key file".into())));
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        Keys::parse("keys", text.as_bytes()).expect_err("a bad key file").to_string()
    }

    #[test]
    fn a_key_file_has_names_words_and_comments() {
        let text = "# pack 7\nunseal = 0414 3672\n\nfull_access=FFFF ffff # as it came\r\n\
                    authentication = 0123456789abcdef FEDCBA9876543210";
        let keys = Keys::parse("keys", text.as_bytes()).expect("a good key file");
        assert_eq!(keys.unseal, Some([0x0414, 0x3672]));
        assert_eq!(keys.full_access, Some([0xffff, 0xffff]));
        assert_eq!(keys.authentication.map(|key| (key[0], key[8])), Some((0x01, 0xfe)));
        assert!(Keys::parse("keys", b"").expect("an empty one").unseal.is_none());
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
            "keys: line 1: the name is none of: unseal, full_access, authentication"
        );
        assert_eq!(error("authentication = 0123"), "keys: line 1: expected 32 hexadecimal digits");
        assert_eq!(
            error("unseal = 1234 5678\nunseal = 1234 5678"),
            "keys: line 2: this key was given on a line before"
        );
        assert_eq!(error("unseal = +123 5678 1"), error("unseal = 1"));
    }

    #[test]
    fn keys_do_not_show_themselves() {
        let keys = Keys { unseal: Some([0xbeef, 0xcafe]), ..Keys::default() };
        assert_eq!(format!("{keys:?}"), "Keys { hidden }");
    }
}
