// SPDX-License-Identifier: MIT

//! A made-up sysfs for the tests of this folder, with the folders and links of the kernel's.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

/// The root of a system that is a folder.
pub(super) struct System(PathBuf);

impl System {
    pub(super) fn new(name: &str) -> Self {
        let root = std::env::temp_dir().join(format!("gauge-bus-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&root);
        Self(root)
    }

    pub(super) fn root(&self) -> &Path {
        &self.0
    }

    pub(super) fn write(&self, path: &str, bytes: &[u8]) {
        let path = self.0.join(path);
        fs::create_dir_all(path.parent().expect("a folder")).expect("folders");
        fs::write(path, bytes).expect("a file");
    }

    fn link(&self, path: &Path, to: &Path) {
        fs::create_dir_all(path.parent().expect("a folder")).expect("folders");
        symlink(to, path).expect("a link");
    }

    /// An adapter of a device with that driver; without one, as i2c-stub's is.
    pub(super) fn adapter(&self, number: u64, driver: Option<&str>, name: &str) {
        let parent = if driver.is_some() { format!("usb/{number}") } else { "virtual".into() };
        let folder = format!("sys/devices/{parent}/i2c-{number}");
        self.write(&format!("{folder}/name"), format!("{name}\n").as_bytes());
        self.link(&self.device(number), &self.0.join(&folder));
        if let Some(driver) = driver {
            let drivers = Path::new("../../../bus/hid/drivers").join(driver);
            self.link(&self.0.join(format!("sys/devices/{parent}/driver")), &drivers);
        }
    }

    /// A channel of a mux on an adapter that is there. The mux is named as its device, such as `0-0070`.
    pub(super) fn channel(&self, of: u64, number: u64, mux: &str, channel: u32) {
        let parent = fs::canonicalize(self.device(of)).expect("the adapter in front of it");
        let folder = parent.join(format!("i2c-{number}"));
        fs::create_dir_all(&folder).expect("folders");
        fs::create_dir_all(parent.join(mux)).expect("folders");
        fs::write(folder.join("name"), format!("i2c-{of}-mux (chan_id {channel})\n")).expect("a file");
        self.link(&folder.join("mux_device"), &parent.join(mux));
        self.link(&self.device(number), &folder);
    }

    /// A driver that is bound to a device of an adapter.
    pub(super) fn driver(&self, number: u64, address: u8, name: &str, driver: &str) {
        let device = format!("sys/bus/i2c/devices/{number}-{address:04x}");
        self.write(&format!("{device}/name"), format!("{name}\n").as_bytes());
        self.link(&self.0.join(device).join("driver"), &Path::new("../../drivers").join(driver));
    }

    fn device(&self, number: u64) -> PathBuf {
        self.0.join(format!("sys/bus/i2c/devices/i2c-{number}"))
    }
}

impl Drop for System {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}
