// SPDX-License-Identifier: MIT

//! `gaugefs rescue`: restores a gauge that is stuck in ROM mode. [`ti_gauge::rom`] decides what is written.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use clap::builder::PossibleValuesParser;
use clap::{ArgGroup, Args};
use nix::errno::Errno;

use crate::config::values::chip_values;
use crate::error::{Cause, Error, Result};
use crate::output::{print, say};
use gauge_bus::adapters::certain;
use gauge_bus::clock::{Clock, RealClock};
use gauge_bus::linux::{Adapter, LinuxBus};
use gauge_bus::regular;
use gauge_bus::{Bus, BusError, GAUGE_ADDRESS};
use gauge_owner::lock::Lock;
use gauge_sim::Sim;
use gaugefs_host::input;
use ti_gauge::chip::Chip;
use ti_gauge::gauge::Gauge;
use ti_gauge::image;
use ti_gauge::keys::Keys;
use ti_gauge::probe::{ROM_ADDRESS, answers_in_rom};
use ti_gauge::rom::{self, Firmware};

const RESCUE: &str = "\
A gauge whose firmware update was interrupted answers at 0x0b only, also after a loss of power.
It takes the whole firmware file (.bq.fs) of the same part and version, as bqStudio exports it; a
.df.fs is not enough. The file replaces firmware and data flash: calibration, keys and what the
gauge has learned become those of the file.

The file is checked as a whole before anything is sent. A gauge in ROM mode does not tell which
part it is: name it with --chip, and be sure. First switch its power off and on: a gauge with
whole firmware then starts by itself. Charge the pack and keep the power on.

It can be interrupted at any time: run it again, and it begins with the first row.

Examples:
  gaugefs rescue 0100_0_16-bq34z100G1.bq.fs --sim bq34z100-g1     to see it once
  gaugefs rescue 0100_0_16-bq34z100G1.bq.fs --bus /dev/i2c-1 --chip bq34z100-g1";

/// Limit for the start of a gauge's firmware, and the interval of looks.
const STARTING: Duration = Duration::from_secs(10);
const STEP: Duration = Duration::from_millis(250);
/// Looks at a gauge's usual address before it counts as absent: it does not answer while it starts or programs flash.
const LOOKS: usize = 8;

/// Restore a gauge that is stuck in ROM mode from a full firmware file
#[derive(Args, Debug)]
#[command(after_help = RESCUE, group(ArgGroup::new("gauge").required(true).args(["bus", "sim"])))]
pub(super) struct Rescue {
    /// Firmware file of the same part (.bq.fs); - is standard input, with --yes
    file: PathBuf,
    /// The I2C bus, such as /dev/i2c-1
    #[arg(long, value_name = "DEVICE", requires = "chip")]
    bus: Option<PathBuf>,
    /// The gauge's part, which it does not tell in ROM mode
    #[arg(long, value_name = "CHIP", value_parser = chips(), ignore_case = true, requires = "bus")]
    chip: Option<String>,
    /// Try it with a simulated gauge of this part, which is left in ROM mode
    #[arg(long, value_name = "CHIP", value_parser = chips(), ignore_case = true)]
    sim: Option<String>,
    /// Do not ask before flash is erased
    #[arg(long)]
    yes: bool,
}

/// All parts: one that is not brought back is refused with what else to do.
fn chips() -> PossibleValuesParser {
    let values = chip_values().map(|(chip, value)| value.hide(chip.firmware_file.is_none()));
    PossibleValuesParser::new(values)
}

impl Rescue {
    pub(super) fn run(self) -> Result<ExitCode> {
        let chip = self.chip.as_ref().or(self.sim.as_ref()).and_then(|chip| Chip::by_name(chip));
        let chip = chip.expect("clap demands one, and accepts only names of chips");
        rom::check_part(chip)?;
        let name = input::name(&self.file);
        if self.file.as_os_str() == "-" && !self.yes {
            let why = "it has the file, so the question cannot be answered there; pass --yes";
            return Err(Error::new(name, Cause::Invalid, why));
        }
        let bytes = input::read_file(&self.file, image::LONGEST)
            .map_err(|error| Error::io(&name, "cannot be read", &error))?;
        let firmware = Firmware::parse(&String::from_utf8_lossy(&bytes), chip);
        let firmware = firmware.map_err(|error| error.within(&name))?;
        let clock: Arc<dyn Clock> = Arc::new(RealClock::new());
        let confirm = || if self.yes { Ok(true) } else { is_confirmed(chip) };
        let Some(bus) = &self.bus else {
            let sim = left_in_rom(chip, &clock)?;
            let (gauge, mut boot) = (Box::new(sim.bus()), sim.bus_at(ROM_ADDRESS));
            let subject = format!("simulated gauge, address 0x{ROM_ADDRESS:02x}");
            bring_back(&firmware, chip, gauge, &mut boot, &clock, [&name, &subject], &confirm)?;
            return Ok(ExitCode::SUCCESS);
        };
        let adapter = Adapter::find(bus)?;
        adapter.refuse_mux()?;
        check_driver(&adapter.to_string(), adapter.is_known())?;
        // A daemon that waits for the gauge holds the lock of its usual address.
        let lock = |address| Lock::gauge(&adapter, address, Path::new(""), &*clock, |_| false);
        let _locks = [lock(GAUGE_ADDRESS)?, lock(ROM_ADDRESS)?];
        let open = |address| LinuxBus::open(adapter.clone(), address, clock.clone());
        let (gauge, mut boot) = (open(GAUGE_ADDRESS)?, open(ROM_ADDRESS)?);
        let subject = format!("{adapter} address 0x{ROM_ADDRESS:02x}");
        bring_back(&firmware, chip, Box::new(gauge), &mut boot, &clock, [&name, &subject], &confirm)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// A driver may send a long message in parts, each with a START of its own, and report success: flash would be erased,
/// and never written.
fn check_driver(bus: &str, is_known: bool) -> Result<()> {
    if is_known {
        return Ok(());
    }
    let why = format!(
        "it is not known whether its driver sends the {} bytes of a row in one message, so nothing was sent; use an \
         adapter that does: {}",
        rom::LONGEST,
        certain()
    );
    Err(Error::new(bus, Cause::NotPermitted, why))
}

/// Refuses a bus that does not carry a row, with others that do.
fn check_reach(boot: &mut dyn Bus) -> Result<()> {
    rom::check_reach(boot).map_err(|error| {
        let why = format!("{error}; nothing was sent; use an adapter that carries it: {}", certain());
        Error::new("", error.cause(), why)
    })
}

/// A simulated gauge in ROM mode.
fn left_in_rom(chip: &Chip, clock: &Arc<dyn Clock>) -> Result<Sim> {
    let sim = Sim::new(chip.name, &gauge_sim::Options::default(), clock.clone())?;
    clock.sleep(STEP * 4);
    match sim.leave_in_rom() {
        true => Ok(sim),
        false => {
            let why = "its simulated gauge has no ROM mode";
            Err(Error::new(chip.model, Cause::NotPermitted, why))
        }
    }
}

/// Writes firmware to a gauge in ROM mode, and waits until it works. `names` are those of the file and of the device at
/// ROM mode's address.
fn bring_back(
    firmware: &Firmware,
    chip: &'static Chip,
    mut gauge: Box<dyn Bus>,
    boot: &mut dyn Bus,
    clock: &Arc<dyn Clock>,
    [name, subject]: [&str; 2],
    confirm: &dyn Fn() -> Result<bool>,
) -> Result<()> {
    let within = |error: Error| error.within(subject);
    check_reach(boot).map_err(within)?;
    check_state(&mut *gauge, boot, &**clock).map_err(within)?;
    let found = rom::look(boot, &**clock).map_err(within)?;
    firmware.check(&found).map_err(within)?;
    print(&format!(
        "{name}: whole firmware 0x{:04x} for a {}, Device Name {}\n{subject}: a gauge in ROM mode{}\n",
        firmware.version,
        chip.model,
        firmware.name,
        if found.version.is_some() {
            ", its firmware is whole: switching its power off and on may be enough"
        } else {
            ""
        }
    ))?;
    if !confirm()? {
        return Err(Error::host(subject, Errno::ECANCELED, "nothing was erased"));
    }
    // Somebody may have taken minutes to answer.
    check_state(&mut *gauge, boot, &**clock).map_err(within)?;
    if rom::look(boot, &**clock).map_err(within)? != found {
        let why =
            "the gauge in ROM mode is not the one that was there before the question; nothing was erased";
        return Err(Error::host(subject, Errno::ENODEV, why));
    }
    let (mut shown, mut printed) = (0, Ok(()));
    let written = firmware.write(boot, &**clock, &mut |done, all| {
        let percent = done * 100 / all;
        if percent >= shown + 10 {
            shown = percent / 10 * 10;
            // A full disk must not leave an erased part behind.
            printed = std::mem::replace(&mut printed, Ok(())).and_then(|()| print(&format!("{shown} %\n")));
        }
    });
    written.map_err(|error| {
        say("not finished. Leave the power on, and run the same command again: it begins \
             with the first row.");
        error.within(name)
    })?;
    wait_for(&mut *gauge, &**clock).map_err(within)?;
    // The type is asked for at the present address.
    let mut gauge = Gauge::new(chip, gauge, clock.clone(), Keys::default());
    let answers = gauge.identify().map_err(within)?;
    print(&format!(
        "The gauge answers at 0x{GAUGE_ADDRESS:02x} again: device type 0x{:04x}, firmware 0x{:04x}.\n\
         Check its calibration and change its keys before you use the pack.\n",
        answers.device_type, answers.firmware_version
    ))
    .and(printed)
    .map_err(|error| error.within("the gauge answers again"))
}

/// Checks that a gauge is in ROM mode: nothing answers at the usual address, and something at the other.
fn check_state(gauge: &mut dyn Bus, boot: &mut dyn Bus, clock: &dyn Clock) -> Result<()> {
    for _ in 0..LOOKS {
        match gauge.transfer(&[], &mut [0]) {
            Ok(()) => {
                let why = format!(
                    "a device answers at 0x{GAUGE_ADDRESS:02x}, so no gauge there is in ROM mode; nothing was erased"
                );
                return Err(Error::new("", Cause::Busy, why));
            }
            Err(BusError::NoAck) => clock.sleep(STEP),
            Err(error) if error.may_be_no_ack() => {
                let why = format!(
                    "address 0x{GAUGE_ADDRESS:02x}: {error} So it is not certain that no gauge is there, and nothing was erased; \
                     use an adapter that tells: {}",
                    certain()
                );
                return Err(Error::new("", Cause::NotPermitted, why));
            }
            Err(error) => return Err(error.into()),
        }
    }
    match answers_in_rom(boot) {
        Ok(true) => Ok(()),
        Ok(false) => Err(Error::from(BusError::NoAck)),
        Err(error) => Err(error),
    }
}

/// Waits until the gauge has started its firmware.
fn wait_for(gauge: &mut dyn Bus, clock: &dyn Clock) -> Result<()> {
    let start = clock.now();
    while gauge.transfer(&[], &mut [0]).is_err() {
        if clock.now() - start > STARTING {
            let why = format!(
                "all rows are written and their sums are right, but the gauge does not answer at 0x{GAUGE_ADDRESS:02x}; \
                 switch its power off and on"
            );
            return Err(Error::new("", Cause::NoAnswer, why));
        }
        clock.sleep(STEP);
    }
    // It may still be measuring for the first time.
    clock.sleep(STEP * 4);
    Ok(())
}

/// Asks on the terminal.
fn is_confirmed(chip: &Chip) -> Result<bool> {
    if !std::io::stdin().is_terminal() {
        let why = "erasing flash needs a confirmation: run it in a terminal, or pass --yes";
        return Err(Error::host("", Errno::ENOTTY, why));
    }
    print(&format!(
        "This erases its firmware and data flash. Firmware of another part ruins it for good.\n\
         Is it a {}? Type yes to go on: ",
        chip.model
    ))?;
    // Longest line of a terminal.
    let line = regular::lines(std::io::stdin().lock(), 4096).next().transpose();
    let line = line.map_err(|error| Error::io("", "cannot read the answer", &error))?;
    Ok(line.is_some_and(|line| line.trim() == "yes"))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};

    use super::*;
    use gauge_bus::clock::SimClock;
    use gauge_sim::{Options, firmware};

    const CHIP: &str = "bq34z100-g1";

    /// Instruction and data flash of a whole file.
    fn content(chip: &Chip) -> (Vec<[u8; 96]>, Vec<u8>) {
        let file = chip.firmware_file.as_ref().expect("it has one");
        firmware::named(chip.name, file.name, file.names[0]).expect("a boot loader")
    }

    fn file(chip: &Chip) -> String {
        let (rows, data) = content(chip);
        firmware::file(rows, data, firmware::Style::Row)
    }

    /// Two simulated gauges, one after the other, at the same address.
    struct Exchanged {
        packs: [gauge_sim::SimBus; 2],
        is_second: Arc<AtomicBool>,
    }

    impl Bus for Exchanged {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
            self.packs[usize::from(self.is_second.load(Ordering::Relaxed))].transfer(write, read)
        }
    }

    /// A gauge in normal mode, and another that is left in ROM mode.
    struct Bench {
        clock: Arc<dyn Clock>,
        normal: Sim,
        left: Sim,
    }

    impl Bench {
        fn new() -> Self {
            Self::at(Arc::new(SimClock::new()))
        }

        fn at(clock: Arc<dyn Clock>) -> Self {
            let [normal, left] = [(); 2]
                .map(|()| Sim::new(CHIP, &Options::default(), clock.clone()).expect("a simulated gauge"));
            clock.sleep(Duration::from_secs(1));
            assert!(left.leave_in_rom());
            Self { clock, normal, left }
        }

        /// Runs a rescue with that gauge at the usual address, and answers the question with yes.
        fn rescue(&self, gauge: &Sim) -> Result<()> {
            let chip = Chip::by_name(CHIP).expect("a chip");
            let firmware = Firmware::parse(&file(chip), chip).expect("a whole file");
            let mut boot = self.left.bus_at(ROM_ADDRESS);
            let gauge = Box::new(gauge.bus());
            bring_back(&firmware, chip, gauge, &mut boot, &self.clock, ["a file", "a bus"], &|| Ok(true))
        }

        /// A rescue that ends after so many transfers.
        fn rescue_until(&self, transfers: u64) {
            self.left.set("fault", &format!("silence {transfers} 100000")).expect("a fault");
            self.rescue(&self.left).expect_err("it is silent");
            self.left.set("fault", "none").expect("a knob");
            self.clock.sleep(Duration::from_secs(100));
        }
    }

    /// The pack may be swapped while the question is open: for one in normal mode, or for another one in ROM mode,
    /// whose firmware is half erased.
    #[test]
    fn a_gauge_that_comes_while_the_question_is_open_is_not_erased() {
        let chip = Chip::by_name(CHIP).expect("a chip");
        let firmware = Firmware::parse(&file(chip), chip).expect("a whole file");
        let bring = |packs: [&Sim; 2], clock: &Arc<dyn Clock>| {
            let is_second = Arc::new(AtomicBool::new(false));
            let at = |address| Exchanged {
                packs: packs.map(|pack| pack.bus_at(address)),
                is_second: is_second.clone(),
            };
            let (gauge, mut boot) = (Box::new(at(GAUGE_ADDRESS)), at(ROM_ADDRESS));
            let confirm = || {
                is_second.store(true, Ordering::Relaxed);
                Ok(true)
            };
            bring_back(&firmware, chip, gauge, &mut boot, clock, ["a file", "a bus"], &confirm)
        };
        let bench = Bench::new();
        let before = bench.normal.flash();
        let error = bring([&bench.left, &bench.normal], &bench.clock).expect_err("it is in normal mode");
        assert!(error.to_string().contains("nothing was erased"), "{error}");
        assert!(bench.normal.flash() == before);
        assert_eq!(bench.normal.get("programmed").as_deref(), Some("0"));

        // The first one has whole firmware, and the second one has lost its power while it was written.
        let half = Bench::new();
        let whole = Bench::at(half.clock.clone());
        half.rescue_until(80);
        let before = half.left.firmware();
        let error = bring([&whole.left, &half.left], &whole.clock).expect_err("it is another one");
        assert!(error.to_string().contains("not the one that was there"), "{error}");
        assert!(half.left.firmware() == before);
    }

    /// A bus whose adapter has one error number for a missing acknowledge and for other failures.
    struct Doubtful(gauge_sim::SimBus);

    impl Bus for Doubtful {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> std::result::Result<(), BusError> {
            self.0.transfer(write, read).map_err(|_| BusError::MaybeNoAck(nix::libc::ETIMEDOUT))
        }
    }

    #[test]
    fn an_address_of_which_the_adapter_does_not_tell_is_not_taken_for_empty() {
        let chip = Chip::by_name(CHIP).expect("a chip");
        let firmware = Firmware::parse(&file(chip), chip).expect("a whole file");
        let bench = Bench::new();
        let before = (bench.left.firmware(), bench.left.get("programmed"));
        let (gauge, mut boot) = (Box::new(Doubtful(bench.left.bus())), bench.left.bus_at(ROM_ADDRESS));
        let names = ["a file", "a bus"];
        let refused = bring_back(&firmware, chip, gauge, &mut boot, &bench.clock, names, &|| Ok(true));
        let text = refused.expect_err("a gauge may be at 0x55").to_string();
        for word in ["address 0x55", "or the bus timed out", "nothing was erased", "MCP2221"] {
            assert!(text.contains(word), "{word}: {text}");
        }
        assert!(before == (bench.left.firmware(), bench.left.get("programmed")));
    }

    #[test]
    fn an_adapter_that_may_cut_a_row_in_pieces_gets_nothing() {
        let error = check_driver("/dev/i2c-7", false).expect_err("no row").to_string();
        assert!(
            error.starts_with("/dev/i2c-7: ") && error.contains("101 bytes") && error.contains("MCP2221")
        );
        check_driver("/dev/i2c-7", true).expect("it has a row");
        let bench = Bench::new();
        bench.left.set_reach(gauge_bus::Reach { write: 60, ..gauge_bus::Reach::FULL });
        let before = (bench.left.firmware(), bench.left.get("transfers"));
        let error = bench.rescue(&bench.left).expect_err("it carries less").to_string();
        for word in ["101 bytes", "carries 60 at most", "nothing was sent", "i2c-tiny-usb"] {
            assert!(error.contains(word), "{word}: {error}");
        }
        assert!(before == (bench.left.firmware(), bench.left.get("transfers")));
    }

    /// With a gauge in normal mode on the same bus it is not certain whose boot loader answers.
    #[test]
    fn a_rescue_is_refused_while_a_gauge_answers_at_the_usual_address() {
        // The gauge that answers late is busy at the first looks.
        for (fault, late) in
            [("none", false), ("nack 1; nack 2; nack 3; nack 4; nack 5; nack 6; nack 7", true)]
        {
            let bench = Bench::new();
            bench.normal.set("fault", fault).expect("a fault");
            let before = (bench.left.firmware(), bench.left.get("transfers"), bench.left.get("programmed"));
            let error = bench.rescue(&bench.normal).expect_err("a gauge answers at 0x55").to_string();
            assert!(
                error.contains("answers at 0x55") && error.contains("nothing was erased"),
                "{late}: {error}"
            );
            let after = (bench.left.firmware(), bench.left.get("transfers"), bench.left.get("programmed"));
            assert!(before == after, "{late}: nothing was sent to 0x0b");
            assert_eq!(bench.normal.get("programmed").as_deref(), Some("0"), "{late}");
        }
        // Without it the same gauge is brought back.
        let bench = Bench::new();
        bench.rescue(&bench.left).expect("it is alone");
        assert_eq!(bench.left.get("mode").as_deref(), Some("normal"));
        assert!(
            bench.left.firmware().expect("a boot loader").1
                == content(Chip::by_name(CHIP).expect("a chip")).1
        );
    }
}
