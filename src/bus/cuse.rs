// SPDX-License-Identifier: MIT

//! `gaugefs sim --cuse`: the bus as a character device of CUSE.
//!
//! CUSE (`fs/fuse/cuse.c` of the kernel) makes a device whose calls are FUSE requests. An ioctl's argument is not read
//! from the program's memory: an answer names the memory that is needed, and the repeated request contains it
//! (FUSE_IOCTL_RETRY). So the server needs only the open `/dev/cuse`, and gives up all privileges.

use std::fs::{self, File};
use std::os::fd::OwnedFd;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;

use i2c_server::Adapter;
use i2c_server::fuse::{HEAD, message, u32_at, u64_at};
use nix::sys::signal::SigSet;
use nix::unistd::{read, write};

use super::file::{self, Access};
use super::{rights, spawn};
use crate::error::{Cause, Error, Result};
use crate::fuse::single::MAX_WRITE;
use crate::output::print;

const CUSE: &str = "/dev/cuse";
/// CUSE_INIT of `linux/fuse.h`.
const INIT: u32 = 4096;
/// CUSE_UNRESTRICTED_IOCTL: the driver decides what the arguments are, not the ioctl's number.
const UNRESTRICTED: u32 = 1;
/// Protocol version. FUSE_IOCTL_RETRY with 64-bit addresses came with 7.16.
const VERSION: [u32; 2] = [7, 31];
/// Most bytes of a name, as of any file.
const LONGEST_NAME: usize = 64;

/// `/dev/cuse`, before the device exists.
#[derive(Debug)]
pub(crate) struct Cuse {
    device: OwnedFd,
    name: String,
}

impl Cuse {
    /// Opens `/dev/cuse` for a device of that name, and gives up root's privileges (see [`rights::give_up`]).
    pub(crate) fn open(name: &str, state: Option<&Path>) -> Result<Self> {
        let subject = format!("--cuse {name}");
        let refuse = |why: &'static str| Error::new(&subject, Cause::Invalid, why);
        let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
        if name.is_empty()
            || name.len() > LONGEST_NAME
            || name.starts_with('.')
            || !name.bytes().all(is_plain)
        {
            return Err(refuse("not a name for a device; write letters, digits, - and _, such as i2c-9"));
        }
        let node = Path::new("/dev").join(name);
        if fs::symlink_metadata(&node).is_ok() {
            let why = format!("{} is there already; choose another name", node.display());
            return Err(Error::host(subject, nix::errno::Errno::EEXIST, why));
        }
        let device = File::options().read(true).write(true).open(CUSE).map_err(|error| {
            let what = match error.raw_os_error() {
                Some(nix::libc::ENOENT | nix::libc::ENODEV | nix::libc::ENXIO) => {
                    "cannot be opened; load the kernel's module (sudo modprobe cuse), or use a PATH, which needs none"
                }
                Some(nix::libc::EACCES | nix::libc::EPERM) => {
                    "cannot be opened; run this with sudo, which is given up afterwards, or use a PATH, which needs no root"
                }
                _ => "cannot be opened",
            };
            Error::io(CUSE, what, &error)
        })?;
        rights::give_up(state)?;
        Ok(Self { device: device.into(), name: name.into() })
    }

    /// Makes the device, and serves it until a signal ends this process and the device.
    pub(crate) fn serve(self, adapter: Adapter, signals: SigSet, what: &str) -> Result<ExitCode> {
        let Self { device, name } = self;
        spawn("signals", move || {
            if signals.wait().is_ok() {
                std::process::exit(0);
            }
        })?;
        begin(&device, &name)?;
        let node = Path::new("/dev").join(&name);
        if fs::metadata(&node).is_err() {
            let why =
                "the kernel has not made the device; another name may help, or the kernel's log says why";
            return Err(Error::host(node.display().to_string(), nix::errno::Errno::ENODEV, why));
        }
        print(&format!("{what} at {}\n", node.display()))?;
        file::serve(device, &Arc::new(adapter), Access::Asked)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// Agrees on the protocol and makes the device.
fn begin(device: &OwnedFd, name: &str) -> Result<()> {
    let failed = |what, errno: nix::errno::Errno| Error::io(CUSE, what, &errno.into());
    let mut request = [0; 8192];
    let length = read(device, &mut request).map_err(|errno| failed("cannot read a request", errno))?;
    let request = &request[..length];
    if u32_at(request, 4) != INIT || length < HEAD + 16 {
        let why = "this kernel's CUSE begins in a way that is not known here";
        return Err(Error::host(CUSE, nix::errno::Errno::EPROTO, why));
    }
    let [major, minor] = VERSION;
    // cuse_init_out: version, unused, flags, largest read and write, device number (0: any), spare.
    let mut body: Vec<u8> = [major, minor, 0, UNRESTRICTED, MAX_WRITE, MAX_WRITE]
        .iter()
        .flat_map(|field| field.to_ne_bytes())
        .collect();
    body.resize(72, 0);
    body.extend(format!("DEVNAME={name}\0").bytes());
    let answer = message(u64_at(request, 8), Ok(body));
    write(device, &answer).map(drop).map_err(|errno| failed("the kernel refuses the device", errno))
}

#[cfg(test)]
mod tests {
    use std::os::fd::AsFd;
    use std::thread::{self, JoinHandle};

    use i2c_server::{Errno, FUNCTIONS, Target, command};
    use nix::sys::socket::{AddressFamily, SockFlag, SockType, socketpair};

    use super::*;

    /// A target whose answers begin with the register that was written last, and which keeps what is written behind it.
    struct Echo(Vec<u8>);

    impl Target for Echo {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), Errno> {
            if !write.is_empty() {
                self.0 = write.to_vec();
            }
            for (byte, at) in read.iter_mut().zip(self.0.iter().cycle()) {
                *byte = *at;
            }
            Ok(())
        }
    }

    /// Where the memory of the program begins.
    const BASE: u64 = 0x1000;

    /// The kernel's side of `/dev/cuse`, and a program with its memory.
    struct Kernel {
        socket: Option<OwnedFd>,
        server: Option<JoinHandle<Result<()>>>,
        memory: Vec<u8>,
        handle: u64,
        /// How often the last ioctl was asked for more.
        asked: usize,
    }

    const BITS_32: u32 = 1 << 3;

    impl Kernel {
        fn new() -> Self {
            let kind = SockType::SeqPacket;
            let (kernel, device) =
                socketpair(AddressFamily::Unix, kind, None, SockFlag::SOCK_CLOEXEC).expect("sockets");
            let adapter = Adapter::new().with(0x55, Echo(Vec::new()));
            let server = thread::spawn(move || {
                begin(&device, "i2c-9")?;
                file::serve(device, &Arc::new(adapter), Access::Asked)
            });
            let mut new = Self {
                socket: Some(kernel),
                server: Some(server),
                memory: vec![0; 4096],
                handle: 0,
                asked: 0,
            };
            let init = [7_u32, 39, 0, 1].iter().flat_map(|field| field.to_ne_bytes()).collect::<Vec<_>>();
            let (error, body) = new.call(INIT, &init);
            assert_eq!((error, u32_at(&body, 0), u32_at(&body, 12)), (0, 7, UNRESTRICTED));
            assert_eq!(&body[72..], b"DEVNAME=i2c-9\0");
            let (error, body) = new.call(14, &[0; 8]);
            assert_eq!(error, 0);
            new.handle = u64_at(&body, 0);
            new
        }

        fn send(&self, code: u32, body: &[u8]) {
            let mut request = ((HEAD + body.len()) as u32).to_ne_bytes().to_vec();
            request.extend(code.to_ne_bytes());
            request.extend(1_u64.to_ne_bytes());
            request.resize(HEAD, 0);
            request.extend(body);
            write(self.socket.as_ref().expect("open").as_fd(), &request).expect("sent");
        }

        /// The error, and the body of the answer.
        fn call(&self, code: u32, body: &[u8]) -> (i32, Vec<u8>) {
            self.send(code, body);
            let mut answer = vec![0; 1 << 17];
            let length = read(self.socket.as_ref().expect("open").as_fd(), &mut answer).expect("an answer");
            answer.truncate(length);
            assert_eq!((u32_at(&answer, 0) as usize, u64_at(&answer, 8)), (length, 1));
            (u32_at(&answer, 4) as i32, answer.split_off(16))
        }

        fn place(&self, at: u64, length: u64) -> std::ops::Range<usize> {
            let start = (at - BASE) as usize;
            start..start + length as usize
        }

        /// As `fuse_do_ioctl` of the kernel does it: what is asked for comes with the next request.
        fn ioctl(&mut self, number: u32, argument: u64, flags: u32) -> Result<i32, Errno> {
            let (mut came, mut answers) = (Vec::new(), Vec::new());
            for asked in 0..5 {
                self.asked = asked;
                let room: u64 = answers.iter().map(|(_, length)| length).sum();
                let mut body = self.handle.to_ne_bytes().to_vec();
                body.extend([flags, number].iter().flat_map(|field| field.to_ne_bytes()));
                body.extend(argument.to_ne_bytes());
                body.extend(
                    [came.len() as u32, room as u32].iter().flat_map(|field: &u32| field.to_ne_bytes()),
                );
                body.extend(&came);
                let (error, body) = self.call(39, &body);
                if error != 0 {
                    return Err(Errno::from_raw_os_error(-error));
                }
                if u32_at(&body, 4) == 0 {
                    let mut data = &body[16..];
                    for &(at, length) in &answers {
                        let (now, rest) = data.split_at(data.len().min(length as usize));
                        let place = self.place(at, now.len() as u64);
                        self.memory[place].copy_from_slice(now);
                        data = rest;
                    }
                    assert!(data.is_empty(), "more than was announced");
                    return Ok(u32_at(&body, 0) as i32);
                }
                let places: Vec<(u64, u64)> =
                    body[16..].chunks_exact(16).map(|place| (u64_at(place, 0), u64_at(place, 8))).collect();
                let (needed, outs) = places.split_at(u32_at(&body, 8) as usize);
                assert_eq!(outs.len(), u32_at(&body, 12) as usize);
                came = needed
                    .iter()
                    .flat_map(|&(at, length)| self.memory[self.place(at, length)].to_vec())
                    .collect();
                answers = outs.to_vec();
            }
            panic!("it asks again and again");
        }

        fn put(&mut self, at: u64, bytes: &[u8]) {
            let place = self.place(at, bytes.len() as u64);
            self.memory[place].copy_from_slice(bytes);
        }

        fn functions(&mut self) -> u64 {
            assert_eq!(self.ioctl(command::I2C_FUNCS, BASE, 0), Ok(0));
            u64_at(&self.memory, 0)
        }
    }

    impl Drop for Kernel {
        /// The device is gone: the server ends.
        fn drop(&mut self) {
            self.socket.take();
            let ended = self.server.take().map(JoinHandle::join);
            assert!(thread::panicking() || matches!(ended, Some(Ok(Ok(())))), "{ended:?}");
        }
    }

    #[test]
    fn what_an_ioctl_points_to_is_asked_for_before_anything_is_sent() {
        let mut kernel = Kernel::new();
        assert_eq!(kernel.functions(), FUNCTIONS);
        assert_eq!(kernel.asked, 1);
        assert_eq!(kernel.ioctl(command::I2C_SLAVE, 0x55, 0), Ok(0));
        assert_eq!(kernel.asked, 0);

        // I2C_RDWR: two messages at BASE + 32, their buffers behind them.
        let message = |flags: u16, length: u16, at: u64| {
            let head = [0x55, flags, length, 0].into_iter().flat_map(|field| field.to_ne_bytes());
            head.chain(at.to_ne_bytes()).collect::<Vec<u8>>()
        };
        kernel.put(BASE, &[&(BASE + 32).to_ne_bytes()[..], &2_u32.to_ne_bytes(), &[0; 4]].concat());
        kernel.put(BASE + 32, &message(0, 2, BASE + 100));
        kernel.put(BASE + 48, &message(1, 4, BASE + 200));
        kernel.put(BASE + 100, &[0x08, 0x77]);
        assert_eq!(kernel.ioctl(command::I2C_RDWR, BASE, 0), Ok(2));
        assert_eq!(kernel.memory[200..204], [0x08, 0x77, 0x08, 0x77]);
        assert_eq!(kernel.memory[204], 0);

        // A word by SMBus, of a program of 32 bits: the union is at BASE + 64.
        kernel.put(
            BASE,
            &[&[1, 0x08, 0, 0][..], &3_u32.to_ne_bytes(), &(BASE as u32 + 64).to_ne_bytes()].concat(),
        );
        assert_eq!(kernel.ioctl(command::I2C_SMBUS, BASE, BITS_32), Ok(0));
        assert_eq!(kernel.memory[64..66], [0x08, 0x08]);

        assert_eq!(kernel.ioctl(command::I2C_SLAVE, 0x54, 0), Ok(0));
        assert_eq!(kernel.ioctl(command::I2C_SMBUS, BASE, BITS_32), Err(Errno::NXIO));
        assert_eq!(kernel.ioctl(0x1234, BASE, 0), Err(Errno::NOTTY));
        assert_eq!(kernel.ioctl(command::I2C_SLAVE, 0x80, 0), Err(Errno::INVAL));
    }

    #[test]
    fn garbage_is_refused_and_the_next_caller_is_answered() {
        let mut kernel = Kernel::new();
        // xorshift
        let mut state = 0x9e37_79b9_7f4a_7c15_u64;
        let mut random = |below: u64| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state % below
        };
        for _ in 0..5000 {
            let mut body: Vec<u8> = (0..random(120)).map(|_| random(256) as u8).collect();
            if random(2) == 0 && body.len() >= 16 {
                body[..8].copy_from_slice(&kernel.handle.to_ne_bytes());
                body[12..16].copy_from_slice(&(0x0700 + random(0x30) as u32).to_ne_bytes());
            }
            // What is not answered is left out, and what would close the file.
            let code = [39, 39, 39, 15, 16, 25, 3, 4, 4096, 99][random(10) as usize];
            kernel.call(code, &body);
        }
        assert_eq!(kernel.functions(), FUNCTIONS);
    }

    #[test]
    fn a_name_that_is_no_name_or_taken_is_refused() {
        for name in ["", "a/b", ".", "..", "a b", &"x".repeat(65), "i2c\n9"] {
            let error = Cuse::open(name, None).expect_err("refused").to_string();
            assert!(error.contains("not a name for a device"), "{error}");
        }
        let error = Cuse::open("null", None).expect_err("taken").to_string();
        assert!(error.contains("/dev/null is there already"), "{error}");
    }
}
