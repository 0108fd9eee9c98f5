// SPDX-License-Identifier: MIT

//! `gaugefs sim --device`: the bus as an adapter of the kernel, to which drivers bind.

use std::path::Path;
use std::process::ExitCode;

use i2c_server::{Adapter, usb};
use nix::sys::signal::SigSet;
use nix::unistd::geteuid;

use super::{rights, spawn};
use crate::error::{Cause, Error, Result};
use crate::output::{print, say};
use crate::vhci::{self, Plugged};

const OPTION: &str = "--device";

/// An adapter that is plugged in but not yet served.
#[derive(Debug)]
pub(crate) struct Vhci(Plugged);

impl Vhci {
    /// Plugs an adapter into the kernel, and gives up root's privileges (see [`rights::give_up`]).
    pub(crate) fn plug(state: Option<&Path>) -> Result<Self> {
        if !geteuid().is_root() {
            let why = "only root may plug an adapter into the kernel; run this with sudo, which is given up afterwards, or use \
                       a PATH, which needs no root";
            return Err(Error::new(OPTION, Cause::NotPermitted, why));
        }
        vhci::load(vhci::MODULES);
        let plugged = vhci::plug(OPTION)?;
        rights::give_up(state)?;
        Ok(Self(plugged))
    }

    /// Serves the adapter until a signal ends this process, which unplugs it.
    pub(crate) fn serve(self, adapter: &Adapter, signals: SigSet, what: &str) -> Result<ExitCode> {
        let Plugged { socket, port } = self.0;
        spawn("signals", move || {
            if signals.wait().is_ok() {
                std::process::exit(0);
            }
        })?;
        let what = what.to_string();
        let class = Path::new("/sys/class/i2c-dev");
        spawn("adapter", move || {
            match vhci::adapter(class, port, vhci::PATIENCE).as_deref().and_then(Path::file_name) {
                Some(node) => drop(print(&format!("{what} at {}\n", Path::new("/dev").join(node).display()))),
                None => say(format_args!(
                    "warning: --device: the kernel has made no adapter of it; is its driver there? sudo modprobe i2c-tiny-usb"
                )),
            }
        })?;
        usb::serve(socket, adapter).map_err(|error| Error::io("vhci_hcd", "cannot be spoken to", &error))?;
        Ok(ExitCode::SUCCESS)
    }
}
