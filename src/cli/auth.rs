//! `gaugefs auth`: whether the pack behind a mounted gauge knows the key.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use nix::errno::Errno;

use super::{folder_name, print};
use crate::authentication::{LENGTH, Order, fits, from_hex, to_hex};
use crate::error::{Cause, Error, Result};
use crate::key_file;

const AUTH: &str = "\
The key is the line `authentication = 32 hexadecimal digits` of the key file. It stays in this
process: the gauge gets a random challenge and answers with a digest that only a gauge with the
same key can compute. Exit code 0 says that it did, 1 that it did not or could not be asked.

Example:
  gaugefs auth /run/gauges/BAT0 --key-file ~/pack.keys";

/// Between two tries, so that somebody else's challenge to the same gauge does not make a pack a fake.
const TRIES: u32 = 2;

/// Ask a mounted gauge whether its pack is genuine
#[derive(Args, Debug)]
#[command(after_help = AUTH)]
pub(super) struct Auth {
    /// The gauge's folder, such as /run/gauges/BAT0
    gauge: PathBuf,
    /// File with the line `authentication = 32 hexadecimal digits`; nobody else may read it
    #[arg(long, value_name = "FILE")]
    key_file: PathBuf,
}

impl Auth {
    pub(super) fn run(self) -> Result<ExitCode> {
        print(&self.ask()?);
        Ok(ExitCode::SUCCESS)
    }

    /// What to print about a genuine pack; an error for any other.
    fn ask(&self) -> Result<String> {
        let keys = key_file::from_file(&self.key_file, &folder_name(&self.gauge))?;
        let Some(key) = &keys.authentication else {
            let why = "has no line `authentication = 32 hexadecimal digits`";
            return Err(Error::new(self.key_file.display().to_string(), Cause::Invalid(why.into())));
        };
        let asked = order(&self.gauge)?;
        for _ in 0..TRIES {
            let mut challenge = [0; LENGTH];
            getrandom::fill(&mut challenge)
                .map_err(|error| Error::host("random numbers", Errno::EIO, error.to_string()))?;
            let text = exchange(&self.gauge, &to_hex(&challenge))?;
            let digest = from_hex(text.as_bytes()).map_err(|_| self.wrong("answers with no digest"))?;
            match fits(key, &challenge, &digest, asked) {
                Some(order) if order == asked => {
                    return Ok(format!("genuine, byte order {}\n", order.as_str()));
                }
                Some(order) => {
                    let (order, asked) = (order.as_str(), asked.as_str());
                    return Ok(format!(
                        "genuine, byte order {order}; it is mounted with {asked}: mount it with --auth-order {order}\n"
                    ));
                }
                None => {}
            }
        }
        Err(self.wrong("not genuine: its answer is not that of a gauge with this key, in either byte order"))
    }

    fn wrong(&self, why: &str) -> Error {
        Error::new(self.gauge.display().to_string(), Cause::NotPermitted(why.into()))
    }
}

/// The order of bytes that the gauge is mounted with.
fn order(gauge: &Path) -> Result<Order> {
    let path = gauge.join("gauge/auth_order");
    let name = gauge.display().to_string();
    match std::fs::read_to_string(&path) {
        Ok(word) => Order::by_name(word.trim()).ok_or_else(|| {
            Error::new(path.display().to_string(), Cause::Protocol("holds no order of bytes".into()))
        }),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            let why = if gauge.join("gauge/seal").exists() {
                "this part has no authentication that gaugefs knows"
            } else {
                "not a mounted gauge; give a folder such as /run/gauges/BAT0"
            };
            Err(Error::host(name, Errno::ENOENT, why))
        }
        Err(error) => Err(Error::io(path.display().to_string(), "cannot read it", &error)),
    }
}

/// Writes the challenge and reads the digest.
fn exchange(gauge: &Path, challenge: &str) -> Result<String> {
    let path = gauge.join("gauge/authenticate");
    let name = path.display().to_string();
    let mut file = std::fs::File::options()
        .write(true)
        .open(&path)
        .map_err(|error| Error::io(&name, "cannot write a challenge", &error))?;
    file.write_all(challenge.as_bytes()).map_err(|error| {
        let why = std::fs::read_to_string(gauge.join("gauge/last_error")).unwrap_or_default();
        let what = format!("the gauge does not answer ({})", why.trim());
        Error::io(&name, &what, &error)
    })?;
    std::fs::read_to_string(&path).map_err(|error| Error::io(&name, "cannot read the digest", &error))
}
