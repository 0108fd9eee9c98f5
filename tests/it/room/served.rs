// SPDX-License-Identifier: MIT

//! `gaugefs sim` as a bus of other programs.

use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::process::{Child, Stdio};

use i2cdev::linux::LinuxI2CDevice;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use super::{Folder, command};

/// A server at a path, ended with the test.
pub(crate) struct Server {
    pub(crate) child: Child,
    pub(crate) path: String,
}

impl Server {
    pub(crate) fn start(folder: &Folder, arguments: &[&str]) -> Self {
        let path = folder.file("bus");
        let arguments = [&["sim"], arguments, &[&path]].concat();
        let mut child = command(&arguments).stdout(Stdio::piped()).spawn().expect("gaugefs runs");
        let mut said = [0; 1];
        // It says what it serves when the bus is there.
        let ready = child.stdout.as_mut().expect("a pipe").read(&mut said).expect("its output");
        assert_eq!(ready, 1, "{:?}", child.wait());
        Self { child, path }
    }

    pub(crate) fn device(&self, address: u16) -> LinuxI2CDevice {
        LinuxI2CDevice::new(&self.path, address).expect("a bus")
    }

    pub(crate) fn open(&self) -> File {
        File::options().read(true).write(true).open(&self.path).expect("a bus")
    }

    #[track_caller]
    pub(crate) fn ends(&mut self, signal: Signal) {
        kill(Pid::from_raw(self.child.id() as i32), signal).expect("it runs");
        assert_eq!(self.child.wait().expect("a child").code(), Some(0));
        assert!(!Path::new(&self.path).exists(), "the file that it made is removed");
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = kill(Pid::from_raw(self.child.id() as i32), Signal::SIGTERM);
        let _ = self.child.wait();
    }
}
