//! `gaugefs auth`: checks with a challenge whether a pack knows the authentication key.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use nix::errno::Errno;

use super::{folder_name, trouble};
use crate::error::{Cause, Error, Result};
use crate::output::{print, say};
use crate::{key_file, mounted};
use ti_gauge::authentication::{LENGTH, Order, fits, from_hex, to_hex};

const AUTH: &str = "\
The key file needs a line `authentication = 32 hexadecimal digits`. The key never leaves this
process: the gauge gets a random challenge, and only a gauge with the same key can compute the
digest. Exit code 0: the pack is genuine, 1: it is not, 2: the gauge could not be asked.

Example:
  gaugefs auth /run/gauges/BAT0 --key-file ~/pack.keys";

/// A second try, in case another program sent a challenge to the gauge at the same time.
const TRIES: u32 = 2;

/// Check whether the pack of a mounted gauge is genuine
#[derive(Args, Debug)]
#[command(after_help = AUTH)]
pub(super) struct Auth {
    /// Folder of a mounted gauge, such as /run/gauges/BAT0
    gauge: PathBuf,
    /// Key file with the authentication key; must not be readable by others
    #[arg(long, value_name = "FILE")]
    key_file: PathBuf,
}

impl Auth {
    pub(super) fn run(mut self) -> Result<ExitCode> {
        match mounted::gauge(&self.gauge) {
            Ok(gauge) => self.gauge = gauge,
            error => return trouble(error.map(|_| ExitCode::SUCCESS)),
        }
        trouble(self.ask().and_then(|genuine| match genuine {
            Ok(text) => print(&text).map(|()| ExitCode::SUCCESS),
            Err(why) => {
                say(format_args!("{}: {why}", self.gauge.display()));
                Ok(ExitCode::FAILURE)
            }
        }))
    }

    /// Returns `Ok` with the text for a genuine pack, or `Err` with the reason why it is not genuine.
    fn ask(&self) -> Result<Result<String, &'static str>> {
        let keys = key_file::from_file(&self.key_file, &folder_name(&self.gauge))?;
        let key = keys.authentication.as_ref().and_then(|key| key.bytes().try_into().ok());
        let Some(key) = key else {
            let why = "has no line `authentication = 32 hexadecimal digits`";
            return Err(Error::new(self.key_file.display().to_string(), Cause::Invalid(why.into())));
        };
        let asked = order(&self.gauge)?;
        mounted::poll(&self.gauge)?;
        for _ in 0..TRIES {
            let mut challenge = [0; LENGTH];
            getrandom::fill(&mut challenge)
                .map_err(|error| Error::host("random numbers", Errno::EIO, error.to_string()))?;
            let text = exchange(&self.gauge, &to_hex(&challenge))?;
            let digest = from_hex(text.as_bytes()).map_err(|_| {
                let why = "the answer is not a digest".into();
                Error::new(self.gauge.display().to_string(), Cause::Protocol(why))
            })?;
            match fits(key, &challenge, &digest, asked) {
                Some(order) if order == asked => {
                    return Ok(Ok(format!("genuine, byte order {}\n", order.as_str())));
                }
                Some(order) => {
                    let (order, asked) = (order.as_str(), asked.as_str());
                    return Ok(Ok(format!(
                        "genuine, byte order {order}; it is mounted with {asked}; mount it with --auth-order {order}\n"
                    )));
                }
                None => {}
            }
        }
        Ok(Err("not genuine: its digest does not match this key, in either byte order"))
    }
}

/// The byte order that the gauge is mounted with.
fn order(gauge: &Path) -> Result<Order> {
    let path = gauge.join("gauge/auth_order");
    let name = gauge.display().to_string();
    match mounted::content(&path) {
        Ok(word) => Order::by_name(word.trim()).ok_or_else(|| {
            Error::new(path.display().to_string(), Cause::Protocol("is not a byte order".into()))
        }),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            mounted::has(gauge, "gauge/auth_order", "authentication")?;
            Err(Error::io(name, "cannot read its byte order", &error))
        }
        Err(error) => Err(Error::io(path.display().to_string(), "cannot read it", &error)),
    }
}

/// Writes the challenge and reads the digest.
fn exchange(gauge: &Path, challenge: &str) -> Result<String> {
    const FILE: &str = "gauge/authenticate";
    let failed = |failure: mounted::Failure| failure.told("the gauge does not answer the challenge");
    mounted::send(gauge, FILE, challenge.as_bytes()).map_err(failed)?;
    mounted::text(gauge, FILE).map_err(failed)
}
