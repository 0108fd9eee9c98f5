// SPDX-License-Identifier: MIT

//! Adapters plugged into the kernel: root's part of `gaugefs sim --device`, and of `kernel-node`.
//!
//! `i2c_server::usb` serves them without privilege.

use std::fs;
use std::os::fd::AsRawFd;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use i2c_server::usb;

use crate::error::{Cause, Error, Result};
use gauge_bus::clock::{Clock, RealClock};
use gauge_bus::regular;

const CONTROLLER: &str = "/sys/devices/platform/vhci_hcd.0";
/// The kernel modules for an adapter.
pub(crate) const MODULES: &[&str] = &["vhci-hcd", "i2c-tiny-usb"];
/// How long the kernel may take to make the adapter.
pub(crate) const PATIENCE: Duration = Duration::from_secs(20);
/// Interval of looks for what the kernel makes.
const STEP: Duration = Duration::from_millis(50);

/// An adapter that is plugged in but not yet served.
#[derive(Debug)]
pub(crate) struct Plugged {
    /// For `i2c_server::usb` to serve.
    pub(crate) socket: UnixStream,
    /// Port of the host controller.
    pub(crate) port: u32,
}

/// Loads these modules. Present ones stay; the lack of others shows later.
pub(crate) fn load(modules: &[&str]) {
    let _ = Command::new("modprobe").arg("-a").args(modules).stderr(Stdio::null()).status();
}

/// Plugs an adapter into the kernel, for `option`. For root.
pub(crate) fn plug(option: &str) -> Result<Plugged> {
    let failed = |what: &str, error: &std::io::Error| Error::io(option, what, error);
    let status =
        regular::read_text(&Path::new(CONTROLLER).join("status"), regular::SYSTEM).map_err(|error| {
            failed(
                "the kernel has no vhci_hcd; load its modules: sudo modprobe -a vhci-hcd i2c-tiny-usb",
                &error,
            )
        })?;
    let Some(port) = free_port(&status) else {
        let why = "all ports of vhci_hcd are taken; detach one (usbip detach), or end another `gaugefs sim --device`";
        return Err(Error::new(option, Cause::Busy, why));
    };
    let (socket, theirs) = UnixStream::pair().map_err(|error| failed("cannot make a socket", &error))?;
    // The device's number on its bus, which is arbitrary.
    let number = 0x0001_0002 + port;
    let line = format!("{port} {} {number} {}", theirs.as_raw_fd(), usb::SPEED);
    fs::write(Path::new(CONTROLLER).join("attach"), line)
        .map_err(|error| failed("vhci_hcd refuses the adapter", &error))?;
    Ok(Plugged { socket, port })
}

/// A free port of the controller for devices of full speed: `status` has a line per port, such as `hs 0003 004 ...` for
/// the free port 3.
fn free_port(status: &str) -> Option<u32> {
    const FREE: &str = "004";
    status.lines().find_map(|line| {
        let mut words = line.split_ascii_whitespace();
        let (hub, port, state) = (words.next()?, words.next()?, words.next()?);
        (hub == "hs" && state == FREE).then(|| port.parse().ok()).flatten()
    })
}

/// The entry of the adapter at a port in `/sys/bus/i2c/devices` or `/sys/class/i2c-dev`, once the kernel has made it.
pub(crate) fn adapter(folder: &Path, port: u32, patience: Duration) -> Option<PathBuf> {
    // The device is N-P of the controller: bus N, port P of its hub, from 1 on.
    let is_at_port = |name: &str| {
        name.split_once('-')
            .is_some_and(|(bus, at)| bus.parse::<u32>().is_ok() && at == (port + 1).to_string())
    };
    let is_ours = |device: &Path| {
        let mut parts = device.components().map(|part| part.as_os_str().to_string_lossy());
        parts.by_ref().any(|part| part == "vhci_hcd.0") && parts.any(|part| is_at_port(&part))
    };
    entry(folder, patience, |path| {
        let is_adapter = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("i2c-"));
        is_adapter && fs::canonicalize(path).is_ok_and(|device| is_ours(&device))
    })
}

/// The first wanted entry of a folder, once there is one.
pub(crate) fn entry(folder: &Path, patience: Duration, wanted: impl Fn(&Path) -> bool) -> Option<PathBuf> {
    let clock = RealClock::new();
    let start = clock.now();
    loop {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
        if let Some(found) = entries.into_iter().find(|path| wanted(path)) {
            return Some(found);
        }
        if clock.now() - start > patience {
            return None;
        }
        clock.sleep(STEP);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_free_port_and_its_adapter_are_found() {
        let status = "hub port sta spd dev      sockfd local_busid\n\
                      hs  0000 006 002 00010002 000003 1-1\nhs  0001 004 000 00000000 000000 0-0\n\
                      ss  0008 004 000 00000000 000000 0-0\n";
        assert_eq!(free_port(status), Some(1));
        assert_eq!(free_port("hub port sta\nss  0008 004 000\n"), None);
        let folder = std::env::temp_dir().join(format!("gaugefs-vhci-{}", std::process::id()));
        let all = folder.join("all");
        fs::create_dir_all(&all).expect("a folder");
        for (name, place) in [
            ("3-000b", "vhci_hcd.0/usb9/9-2/9-2:1.0/i2c-3/3-000b"),
            ("i2c-3", "vhci_hcd.0/usb9/9-1/9-1:1.0/i2c-3"),
            ("i2c-4", "vhci_hcd.0/usb9/9-2/9-2:1.0/i2c-4"),
        ] {
            let device = folder.join("devices").join(place);
            fs::create_dir_all(&device).expect("a folder");
            std::os::unix::fs::symlink(&device, all.join(name)).expect("a link");
        }
        let found = |port| adapter(&all, port, Duration::ZERO);
        assert_eq!((found(1), found(2)), (Some(all.join("i2c-4")), None));
        fs::remove_dir_all(&folder).expect("removed");
    }
}
