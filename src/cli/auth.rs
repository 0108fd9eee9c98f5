// SPDX-License-Identifier: MIT

//! `gaugefs auth`: checks with a challenge whether a pack knows the authentication key.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use nix::errno::Errno;

use super::{mounted, trouble};
use crate::error::{Cause, Error, Result};
use crate::output::{print, say};
use gauge_owner::key_file;
use gaugefs_client::{Gauge, Name as Request, TRIES};
use ti_gauge::authentication::{LENGTH, Message, Order, fits, from_hex, to_hex};
use ti_gauge::keys::Name;

const AUTH: &str = "\
The key file needs a line `authentication = 32 hexadecimal digits`. The key never leaves this
process: the gauge gets a random challenge, and only a gauge with the same key can compute the
digest. Exit code 0: the pack is genuine, 1: it is not, or is a Smart Battery, which is only read,
2: the gauge could not be asked.

Example:
  gaugefs auth /run/gauges/BAT0 --key-file ~/pack.keys";

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
    pub(super) fn run(self) -> Result<ExitCode> {
        let is_only_read = Gauge::open(&self.gauge).is_ok_and(|gauge| gauge.is_smart_battery());
        let outcome = self.prove();
        if is_only_read { outcome } else { trouble(outcome) }
    }

    fn prove(&self) -> Result<ExitCode> {
        let gauge = Gauge::open(&self.gauge)?;
        match self.ask(&gauge)? {
            Ok(text) => print(&text).map(|()| ExitCode::SUCCESS),
            Err(why) => {
                say(format_args!("{}: {why}", gauge.folder().display()));
                Ok(ExitCode::FAILURE)
            }
        }
    }

    /// The text for a genuine pack, or why it is not genuine.
    fn ask(&self, gauge: &Gauge) -> Result<Result<String, &'static str>> {
        let keys = key_file::from_file(&self.key_file, &gauge.name())?;
        let secret = keys.secret(Name::Authentication);
        let key = secret.as_ref().and_then(|key| key.bytes().try_into().ok());
        let Some(key) = key else {
            let why = "has no line `authentication = 32 hexadecimal digits`";
            return Err(Error::new(self.key_file.display().to_string(), Cause::Invalid, why));
        };
        let asked = order(gauge)?;
        mounted::poll(gauge)?;
        let attempt = || exchange(gauge).map(|(challenge, digest)| fits(key, &challenge, &digest, asked));
        // I2C has no error detection: one wrong bit must not call a genuine pack a copy.
        let found = attempt()?.map_or_else(attempt, |order| Ok(Some(order)))?;
        Ok(match found {
            Some(order) if order == asked => Ok(format!("genuine, byte order {}\n", order.as_str())),
            Some(order) => {
                let (order, asked) = (order.as_str(), asked.as_str());
                Ok(format!(
                    "genuine, byte order {order}; it is mounted with {asked}; mount it with --auth-order {order}\n"
                ))
            }
            None => Err("not genuine: its digest does not match this key, in either byte order"),
        })
    }
}

/// The byte order of the gauge's mount.
fn order(gauge: &Gauge) -> Result<Order> {
    const FILE: &str = "gauge/auth_order";
    gauge.check_has(FILE, "authentication")?;
    let word = gauge.text(FILE).map_err(|error| error.doing("cannot read its byte order"))?;
    Order::by_name(word.trim()).ok_or_else(|| {
        let name = gauge.folder().join(FILE).display().to_string();
        Error::new(name, Cause::Protocol, "is not a byte order")
    })
}

/// Writes a challenge and reads its digest. The file may contain the answer to another program's challenge.
fn exchange(gauge: &Gauge) -> Result<(Message, Message)> {
    const FILE: &str = "gauge/authenticate";
    let failed = |error: gaugefs_client::Error| error.doing("the gauge does not answer the challenge");
    for _ in 0..TRIES {
        let mut challenge = [0; LENGTH];
        getrandom::fill(&mut challenge)
            .map_err(|error| Error::host("random numbers", Errno::EIO, error.to_string()))?;
        gauge.send(FILE, to_hex(&challenge).as_bytes()).map_err(failed)?;
        let text = gauge.text(FILE).map_err(failed)?;
        let answer = text.split_once(' ').map(|(asked, digest)| [asked, digest.trim_end()].map(hex));
        match answer {
            Some([Some(asked), Some(digest)]) if asked == challenge => return Ok((challenge, digest)),
            // The other program has failed, and leaves nothing.
            None if text.is_empty() => {}
            Some([Some(_), Some(_)]) => {}
            _ => {
                let why = "the answer is not a digest";
                return Err(Error::new(gauge.folder().display().to_string(), Cause::Protocol, why));
            }
        }
        Request::draw().pause();
    }
    let why = "another program sends challenges to the gauge at the same time, so nothing is known of this pack; try again";
    Err(Error::new(gauge.folder().join(FILE).display().to_string(), Cause::Busy, why))
}

fn hex(text: &str) -> Option<Message> {
    from_hex(text.as_bytes()).ok()
}
