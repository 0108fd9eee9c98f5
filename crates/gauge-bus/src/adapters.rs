// SPDX-License-Identifier: MIT

//! The kernel's I2C adapters by their drivers: what they carry, which errno is a NACK, how long they wait for a gauge that
//! holds the clock, and how long a transfer takes.
//!
//! `fault-codes.rst` of the kernel leaves drivers much choice. `linux` finds the model of a real adapter in sysfs; the
//! simulator behaves as one of them.

use std::time::Duration;

use rustix::io::Errno;

use crate::{BusError, Reach};

/// When an errno of a NACK is a NACK, and nothing else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sure {
    Always,
    /// Not in a transfer that writes.
    InReads,
    /// If the transfer was shorter: the driver gives the errno also for a clock that is held low, after this time.
    Sooner(Duration),
    Never,
}

/// The errno of a NACK.
#[derive(Clone, Copy, Debug)]
struct Nack(Errno, Sure);

/// Where the clock of the bus is known from.
#[derive(Clone, Copy, Debug)]
pub enum Source {
    /// The device tree, if it has the clock.
    Tree,
    /// A constant of the driver, in Hz.
    Driver(u32),
    /// A file of the adapter's device, in kHz.
    File(&'static str),
    /// The device tree or else this constant of the driver in Hz, from that version of the kernel on.
    Since([u32; 2], u32),
}

/// What becomes of a message that is longer than the adapter carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Excess {
    /// It is refused with this errno, and nothing is sent.
    Refused(Errno),
    /// The length of a write becomes 8 bits: so many bytes are sent with success. What still is too long is EINVAL.
    EightBits,
    /// It is sent in pieces with success, each with a START of its own; the register of a read goes up with them.
    Pieces,
}

/// How long it waits for a gauge that holds the clock, and the errno after that.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Patience {
    /// In a transfer that writes, be it the register alone.
    pub writes: Duration,
    /// In one that only reads.
    pub reads: Duration,
    /// Also the errno of a line that something else holds.
    errno: Errno,
}

/// What a transfer takes beside its bits: reports of USB and pauses, in milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pace {
    write: u32,
    read: u32,
    /// For each further report of a long message.
    more: u32,
}

/// The bytes of a message in a report.
const REPORT: usize = 60;

/// Why a transfer failed, before an adapter makes an errno of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// The address is not acknowledged.
    Address,
    /// A byte after it is not acknowledged.
    Data,
    /// Another controller wins the bus.
    Arbitration,
    /// A line is held low for too long.
    Held,
}

/// What is known of a driver and the adapters that it drives.
#[derive(Debug)]
pub struct AdapterModel {
    /// The name on the command line.
    pub name: &'static str,
    /// The name by which people know the adapter.
    pub label: &'static str,
    /// The driver of the adapter's device, or the first words of the adapter's name where it has no device.
    pub driver: &'static str,
    /// The first version of the kernel whose driver is like that.
    since: [u32; 2],
    /// Of the address, of a byte after it, and others that may be one.
    nacks: &'static [Nack],
    arbitration: Errno,
    /// Where its clock is known from.
    pub clock: Source,
    /// The bits of I2C_FUNCS.
    pub functions: u32,
    reach: Reach,
    excess: Excess,
    /// A call is one message, or a write and the read after it.
    pub is_pair: bool,
    /// How long it waits for a gauge.
    pub patience: Patience,
    pace: Pace,
}

/// `I2C_FUNC_I2C` of the kernel: it transfers whole messages, and not just the commands of SMBus.
pub(crate) const I2C: u32 = 1;
/// `I2C_FUNC_SMBUS_PEC`: it sends and compares packet error codes.
pub(crate) const PEC: u32 = 8;

const fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

const STRETCHED: Sure = Sure::Sooner(ms(25));
/// No time beside that of its bits.
const BITS: Pace = Pace { write: 0, read: 0, more: 0 };

/// As the kernel's core and most drivers have it: a second for a transfer, of any length.
const USUAL: AdapterModel = AdapterModel {
    name: "",
    label: "",
    driver: "",
    since: [0, 0],
    nacks: &[Nack(Errno::NXIO, Sure::Always); 2],
    arbitration: Errno::AGAIN,
    clock: Source::Tree,
    functions: 0x0eff_0009,
    reach: Reach::FULL,
    excess: Excess::Refused(Errno::OPNOTSUPP),
    is_pair: false,
    patience: Patience { writes: ms(1000), reads: ms(1000), errno: Errno::TIMEDOUT },
    pace: BITS,
};

/// "Run": with the drivers of Debian's kernels 6.1.176, 6.12.117 and 7.3.4, where reports of USB were counted as well; one takes
/// a millisecond at full speed. "Source": read in the driver only. Of several rows of a driver the newest kernel's is first.
static ADAPTERS: [AdapterModel; 12] = [
    // Run. Source of the doubt: STATUS1_TIMEOUT_NACK, STATUS1_TIMEOUT_BUS and a transfer that is cancelled after ten
    // status reports, of two milliseconds each, are all ETIMEDOUT, any other status is EIO. Clock: 7.3.4 sets it, 6.1 and 6.12
    // leave the chip's. A word read: 3.3 reports out, 2.3 in.
    AdapterModel {
        name: "cp2112",
        label: "CP2112",
        driver: "cp2112",
        nacks: &[Nack(Errno::TIMEDOUT, Sure::Never), Nack(Errno::IO, Sure::Never)],
        arbitration: Errno::IO,
        clock: Source::Since([7, 3], 100_000),
        functions: 0x0ffe_8001,
        reach: Reach { write: 61, read: 512, first: 16, ..Reach::FULL },
        excess: Excess::EightBits,
        is_pair: true,
        patience: Patience { writes: ms(20), reads: ms(20), errno: Errno::TIMEDOUT },
        pace: Pace { write: 3, read: 6, more: 2 },
        ..USUAL
    },
    // Run (6.12.117, 7.3.4). Source of the doubt: each error bit of the status report is EIO. Its attribute `clock` is in kHz.
    // Since 6.2 a longer message is one transfer ("HID: ft260: support i2c writes larger than HID report size", and reads);
    // but after a report between the first and the last one the driver waits for a free bus, which is EIO. It asks for the status
    // of a write a hundred times, and waits 5 s for what is read. A word read: 2 reports out, 1 in, 2 control transfers.
    AdapterModel {
        name: "ft260",
        label: "FT260",
        driver: "ft260",
        since: [6, 2],
        reach: Reach { write: 120, read: 240, first: 2, ..Reach::FULL },
        excess: Excess::Refused(Errno::IO),
        ..FT260
    },
    // Run (6.1.176): a longer message is cut without an error.
    AdapterModel { name: "ft260-6.1", ..FT260 },
    // Run. Source of the doubt: the state 0x21, "address being sent" one millisecond after a write, is ENXIO as well; in
    // another state the write is cancelled with EIO, which also is a byte that is not acknowledged. Clock: `i2c_clk_freq`, which
    // is no parameter of the module. A word read: 4 reports out, 4 in, 4 pauses of a millisecond.
    AdapterModel {
        name: "mcp2221",
        label: "MCP2221",
        driver: "mcp2221",
        nacks: &[
            Nack(Errno::NXIO, Sure::InReads),
            Nack(Errno::NXIO, Sure::InReads),
            Nack(Errno::IO, Sure::Never),
        ],
        arbitration: Errno::IO,
        clock: Source::Driver(400_000),
        functions: 0x0fff_8001,
        reach: Reach { write: 512, read: 512, first: 512, ..Reach::FULL },
        excess: Excess::Refused(Errno::IO),
        is_pair: true,
        patience: Patience { writes: ms(1), reads: ms(5), errno: Errno::IO },
        pace: Pace { write: 6, read: 12, more: 3 },
        ..USUAL
    },
    // Run. DEV_ERR of both hosts is also a target that holds the clock low for 25 ms (Intel 82801, HST_STS; PIIX4, SMBHSTSTS).
    AdapterModel {
        name: "i801",
        label: "i801",
        driver: "i801_smbus",
        nacks: &[Nack(Errno::NXIO, STRETCHED); 2],
        functions: 0x1fff_8008,
        reach: Reach::smbus(32, true).with_blocks(),
        patience: HOST,
        ..USUAL
    },
    AdapterModel {
        name: "piix4",
        label: "piix4",
        driver: "piix4_smbus",
        nacks: &[Nack(Errno::NXIO, STRETCHED); 2],
        arbitration: Errno::IO,
        functions: 0x037f_0000,
        reach: Reach::smbus(2, false).with_blocks(),
        patience: HOST,
        ..USUAL
    },
    // i2c-algo-bit. Run. Source of the doubt: `bit_doAddress` makes ENXIO of the ETIMEDOUT of a clock that is held low, for
    // 100 ms or longer; a read that ends early is EIO as well.
    AdapterModel {
        name: "i2c-gpio",
        label: "i2c-gpio",
        driver: "i2c-gpio",
        nacks: &[Nack(Errno::NXIO, Sure::Sooner(ms(100))), Nack(Errno::IO, Sure::Never)],
        arbitration: Errno::IO,
        functions: 0x0fff_801f,
        patience: Patience { writes: ms(100), reads: ms(100), errno: Errno::NXIO },
        ..USUAL
    },
    // Run. Only the device's own answer STATUS_ADDRESS_NAK is ENXIO. Source: any other failure is EIO.
    AdapterModel {
        name: "i2c-tiny-usb",
        label: "i2c-tiny-usb",
        driver: "i2c-tiny-usb",
        arbitration: Errno::IO,
        patience: Patience { writes: ms(1000), reads: ms(1000), errno: Errno::IO },
        pace: Pace { write: 4, read: 6, more: 1 },
        ..USUAL
    },
    // i2c-stub, which has no device. Run.
    AdapterModel {
        name: "i2c-stub",
        label: "i2c-stub",
        driver: "SMBus stub driver",
        nacks: &[Nack(Errno::NODEV, Sure::Always); 2],
        functions: 0x0c7f_0000,
        reach: Reach::smbus(32, false),
        ..USUAL
    },
    // Source, not run: the bit ERR, "no acknowledge"; CLKT is 0, so that nothing but the end of the transfer is waited for.
    AdapterModel {
        name: "bcm2835",
        label: "bcm2835",
        driver: "i2c-bcm2835",
        nacks: &[Nack(Errno::REMOTEIO, Sure::Always); 2],
        arbitration: Errno::IO,
        ..USUAL
    },
    // Source, not run: DW_IC_TX_ABRT_NOACK, ARB_LOST.
    AdapterModel { name: "designware", driver: "i2c_designware", ..DESIGNWARE },
    AdapterModel { name: "designware-pci", driver: "i2c-designware-pci", ..DESIGNWARE },
];

const FT260: AdapterModel = AdapterModel {
    label: "FT260",
    driver: "ft260",
    nacks: &[Nack(Errno::IO, Sure::Never); 2],
    arbitration: Errno::IO,
    clock: Source::File("clock"),
    functions: 0x0f7e_0001,
    reach: Reach { write: 60, read: 60, first: 2, ..Reach::FULL },
    excess: Excess::Pieces,
    is_pair: true,
    patience: Patience { writes: ms(200), reads: ms(5000), errno: Errno::IO },
    pace: Pace { write: 2, read: 5, more: 2 },
    ..USUAL
};

/// Hosts of SMBus end a transfer by themselves.
const HOST: Patience = Patience { writes: ms(25), reads: ms(25), errno: Errno::NXIO };

const DESIGNWARE: AdapterModel = AdapterModel {
    label: "DesignWare",
    nacks: &[Nack(Errno::REMOTEIO, Sure::Always); 2],
    functions: 0x0f7e_0003,
    ..USUAL
};

/// The labels of the adapters that people can buy or have, and that are as wanted, with a comma between.
fn labels(is_wanted: impl Fn(&AdapterModel) -> bool) -> String {
    let wanted = ADAPTERS.iter().filter(|model| !model.reach.smbus && is_wanted(model));
    let mut labels: Vec<_> = wanted.map(|model| model.label).collect();
    labels.dedup();
    labels.join(", ")
}

/// Those that say for certain whether an address is acknowledged in a read.
pub fn certain() -> String {
    labels(|model| model.nacks.iter().any(|nack| nack.1 != Sure::Never))
}

/// Those that wait for a gauge that holds the clock.
pub fn patient() -> String {
    labels(|model| !model.is_impatient())
}

impl AdapterModel {
    /// All models.
    pub fn all() -> impl Iterator<Item = &'static Self> {
        ADAPTERS.iter()
    }

    /// The model of that name.
    pub fn by_name(name: &str) -> Option<&'static Self> {
        Self::all().find(|model| model.name == name)
    }

    /// The model of an adapter by its driver or its own name, and the first two numbers of the kernel's version.
    pub fn of(driver: Option<&str>, name: &str, kernel: Option<[u32; 2]>) -> Option<&'static Self> {
        let is_there = |model: &&Self| model.since == [0, 0] || kernel.is_some_and(|now| now >= model.since);
        let is_it = |model: &&Self| driver == Some(model.driver) || name.starts_with(model.driver);
        Self::all().find(|model| is_it(model) && is_there(model))
    }

    /// What it carries.
    pub fn reach(&self) -> Reach {
        Reach { smbus: self.functions & I2C == 0, pec: self.functions & PEC != 0, ..self.reach }
    }

    /// What an errno says that may be a NACK, of a transfer that `wrote` something and `took` so long.
    fn nack(&self, errno: Errno, wrote: bool, took: Duration) -> Option<BusError> {
        let listed = self.nacks.iter().find(|nack| nack.0 == errno);
        let sure = match (listed, errno) {
            (Some(nack), _) => nack.1,
            // Of the mux in front of the gauge, or of a layer between.
            (None, Errno::NXIO | Errno::REMOTEIO) => Sure::Never,
            (None, _) => return None,
        };
        let is_sure = match sure {
            Sure::Always => true,
            Sure::InReads => !wrote,
            Sure::Sooner(limit) => took < limit,
            Sure::Never => false,
        };
        Some(if is_sure { BusError::NoAck } else { BusError::MaybeNoAck(errno.raw_os_error()) })
    }

    /// The error of a transfer that ended with this errno, `wrote` something and `took` so long.
    pub fn error(&self, errno: i32, wrote: bool, took: Duration) -> BusError {
        self.nack(Errno::from_raw_os_error(errno), wrote, took).unwrap_or_else(|| error_of(errno))
    }

    /// The errno of a failure.
    pub fn errno(&self, failure: Failure) -> i32 {
        let errno = match failure {
            Failure::Address => self.nacks[0].0,
            Failure::Data => self.nacks[1].0,
            Failure::Arbitration => self.arbitration,
            Failure::Held => self.patience.errno,
        };
        errno.raw_os_error()
    }

    /// The pieces in which a transfer that it does not carry is sent with success, as bytes written and read; or its errno.
    pub fn excess(&self, write: usize, read: usize) -> Result<Vec<(usize, usize)>, i32> {
        let most = |limit: u16| usize::from(limit).max(1);
        match self.excess {
            // The register is too long.
            _ if read > 0 && write > self.reach.first.into() => Err(Errno::OPNOTSUPP.raw_os_error()),
            Excess::Refused(errno) => Err(errno.raw_os_error()),
            Excess::EightBits if read == 0 && write & 0xff <= self.reach.write.into() => {
                Ok(vec![(write & 0xff, 0)])
            }
            Excess::EightBits => Err(Errno::INVAL.raw_os_error()),
            Excess::Pieces if read == 0 => {
                Ok(pieces(write, most(self.reach.write)).map(|piece| (piece, 0)).collect())
            }
            Excess::Pieces => Ok(pieces(read, most(self.reach.read)).map(|piece| (write, piece)).collect()),
        }
    }

    /// What a transfer takes beside its bits.
    pub fn pace(&self, write: usize, read: usize) -> Duration {
        let Pace { write: alone, read: with_read, more } = self.pace;
        let reports = if read > 0 { with_read } else { alone };
        let further = (write.max(read).saturating_sub(1) / REPORT) as u32;
        ms(u64::from(reports + more * further))
    }

    /// Its clock in Hz, where nothing sets another one.
    pub fn hertz(&self) -> u32 {
        match self.clock {
            Source::Driver(hertz) | Source::Since(_, hertz) => hertz,
            Source::Tree | Source::File(_) => 100_000,
        }
    }

    /// How long it waits for a gauge, in a transfer that writes or one that does not.
    pub fn waits(&self, wrote: bool) -> Duration {
        if wrote { self.patience.writes } else { self.patience.reads }
    }

    /// Whether it gives up on a gauge that holds the clock while it stores a row.
    pub fn is_impatient(&self) -> bool {
        self.patience.writes < ms(100)
    }
}

/// Lengths of at most `most`, `whole` together.
fn pieces(whole: usize, most: usize) -> impl Iterator<Item = usize> {
    (0..whole).step_by(most).map(move |done| most.min(whole - done))
}

/// The error of a transfer that ended with this errno (`Documentation/i2c/fault-codes.rst`), on an adapter of no model.
pub fn error_of(errno: i32) -> BusError {
    match Errno::from_raw_os_error(errno) {
        Errno::NXIO | Errno::REMOTEIO => BusError::NoAck,
        Errno::AGAIN => BusError::ArbitrationLost,
        // The adapter waited in vain for both lines to be high.
        Errno::TIMEDOUT | Errno::BUSY => BusError::Timeout,
        Errno::BADMSG => BusError::Pec,
        Errno::NODEV | Errno::NOENT => BusError::Gone,
        _ => BusError::Other(errno),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_model_has_a_name_of_its_own() {
        for model in AdapterModel::all() {
            assert!(
                std::ptr::eq(AdapterModel::by_name(model.name).expect("by its name"), model),
                "{}",
                model.name
            );
            // Those without a NACK of data among the first two would have no errno for it.
            assert!(
                model.nacks.len() > 1 && !model.label.is_empty() && !model.driver.is_empty(),
                "{}",
                model.name
            );
        }
        assert!(AdapterModel::by_name("CP2112").is_none());
    }

    #[test]
    fn the_driver_of_an_ft260_cuts_long_messages_before_linux_6_2() {
        let reach = |kernel| AdapterModel::of(Some("ft260"), "", kernel).expect("a model").reach();
        for kernel in [Some([6, 2]), Some([6, 12]), Some([7, 3]), Some([10, 0])] {
            assert!(reach(kernel).carries(101, 0) && reach(kernel).carries(1, 96), "{kernel:?}");
            assert!(!reach(kernel).carries(121, 0) && !reach(kernel).carries(3, 2), "{kernel:?}");
        }
        for kernel in [None, Some([6, 1]), Some([5, 13])] {
            assert!(reach(kernel).carries(60, 0) && reach(kernel).carries(2, 60), "{kernel:?}");
            assert!(!reach(kernel).carries(61, 0) && !reach(kernel).carries(1, 61), "{kernel:?}");
        }
    }

    #[test]
    fn only_adapters_that_tell_a_nack_for_certain_are_recommended() {
        assert_eq!(certain(), "MCP2221, i2c-gpio, i2c-tiny-usb, bcm2835, DesignWare");
        assert_eq!(patient(), "FT260, i2c-gpio, i2c-tiny-usb, bcm2835, DesignWare");
    }

    #[test]
    fn what_is_too_long_is_refused_or_sent_as_another_length() {
        let excess = |name, write, read| AdapterModel::by_name(name).expect("a model").excess(write, read);
        assert_eq!(excess("cp2112", 62, 0), Err(22));
        assert_eq!(excess("cp2112", 256, 0), Ok(vec![(0, 0)]));
        assert_eq!(excess("cp2112", 258, 0), Ok(vec![(2, 0)]));
        assert_eq!(excess("cp2112", 1, 513), Err(22));
        assert_eq!(excess("ft260", 121, 0), Err(5));
        assert_eq!(excess("ft260", 3, 2), Err(95));
        assert_eq!(excess("ft260-6.1", 61, 0), Ok(vec![(60, 0), (1, 0)]));
        assert_eq!(excess("ft260-6.1", 1, 130), Ok(vec![(1, 60), (1, 60), (1, 10)]));
        assert_eq!(excess("mcp2221", 8192, 0), Err(5));
        assert_eq!(excess("piix4", 2, 2), Err(95));
    }

    #[test]
    fn a_transfer_takes_its_reports() {
        let pace = |name, write, read| AdapterModel::by_name(name).expect("a model").pace(write, read);
        assert_eq!(pace("mcp2221", 1, 2), ms(12));
        assert_eq!(pace("mcp2221", 61, 0), ms(6 + 3));
        assert_eq!(pace("cp2112", 0, 60), ms(6));
        assert_eq!(pace("i801", 1, 2), ms(0));
    }
}
