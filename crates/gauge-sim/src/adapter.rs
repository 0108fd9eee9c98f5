// SPDX-License-Identifier: MIT

//! The adapter in front of a simulated gauge: one that carries and reports everything, or the model of one of the kernel's.

use std::time::Duration;

use super::fault::{ADAPTER_WAITS, Fault, Transfer};
use gauge_bus::adapters::{AdapterModel, Failure};
use gauge_bus::{BusError, Reach};

/// Its errno for what is lost between a host and its adapter.
const EIO: i32 = 5;

/// The longest block of SMBus with its length and its packet error code.
pub(super) const PACKET: usize = 34;

/// Whether a host sends that as a command of its own.
fn is_packet(reach: Reach, write: usize, read: usize) -> bool {
    reach.smbus && reach.blocks && write == 1 && read <= PACKET
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Adapter {
    model: Option<&'static AdapterModel>,
    /// Transfers take the time of the model.
    is_paced: bool,
    /// What it carries, if that is less than what the model does.
    pub(super) narrower: Reach,
    /// Transfers that it has given up because the gauge held the clock.
    given_up: usize,
}

impl Adapter {
    pub(super) const PLAIN: Self = Self { model: None, is_paced: false, narrower: Reach::FULL, given_up: 0 };

    pub(super) fn become_model(&mut self, model: &'static AdapterModel, is_paced: bool) {
        (self.model, self.is_paced) = (Some(model), is_paced);
    }

    pub(super) fn reach(&self) -> Reach {
        self.model.map_or(Reach::FULL, AdapterModel::reach).narrowed(self.narrower)
    }

    /// The parts in which a transfer is sent, as bytes written and read; or its errno.
    pub(super) fn parts(&self, write: usize, read: usize) -> Result<Vec<(usize, usize)>, BusError> {
        match self.model {
            Some(model) if !model.reach().carries(write, read) && !is_packet(model.reach(), write, read) => {
                model.excess(write, read).map_err(BusError::Other)
            }
            _ => Ok(vec![(write, read)]),
        }
    }

    /// What a transfer takes beside its bits.
    pub(super) fn pace(&self, write: usize, read: usize) -> Duration {
        self.model.filter(|_| self.is_paced).map_or(Duration::ZERO, |model| model.pace(write, read))
    }

    pub(super) fn bit(&self) -> Duration {
        let hertz = self.model.map_or(100_000, AdapterModel::hertz);
        Duration::from_secs(1) / hertz
    }

    /// How long it waits for a gauge that holds the clock.
    pub(super) fn waits(&self, wrote: bool) -> Duration {
        self.model.map_or(ADAPTER_WAITS, |model| model.waits(wrote))
    }

    /// Gives up a transfer. Returns how much of its write has arrived: nothing, the register alone, or all, in turn. Without a
    /// model it is nothing.
    pub(super) fn give_up(&mut self, write: usize) -> usize {
        self.given_up += usize::from(self.model.is_some());
        [write, 0, 1][self.given_up % 3].min(write * usize::from(self.model.is_some()))
    }

    /// The errno of its model for what a transfer has met; without one, nothing.
    pub(super) fn errno(&self, error: BusError, due: Option<Fault>, in_data: bool) -> Option<BusError> {
        let model = self.model?;
        let failure = match (due, error) {
            (Some(Fault::Transfer(Transfer::Nack(byte, _))), _) if byte.is_some() => Failure::Data,
            (Some(Fault::Transfer(Transfer::Nack(..))), _) => Failure::Address,
            (_, BusError::NoAck) if in_data => Failure::Data,
            (_, BusError::NoAck) => Failure::Address,
            (_, BusError::ArbitrationLost) => Failure::Arbitration,
            (_, BusError::Timeout) => Failure::Held,
            _ => return Some(BusError::Other(EIO)),
        };
        Some(BusError::Other(model.errno(failure)))
    }

    /// What a program makes of the errno of a transfer that `wrote` something and `took` so long.
    pub(super) fn meant(&self, error: BusError, wrote: bool, took: Duration) -> BusError {
        match (self.model, error) {
            (Some(model), BusError::Other(errno)) => model.error(errno, wrote, took),
            _ => error,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use gauge_bus::Bus;
    use gauge_bus::clock::{Clock, SimClock};

    use super::*;
    use crate::{Options, Sim, SimBus};

    fn gauge(name: &str) -> (Sim, SimBus, Arc<SimClock>) {
        let clock = Arc::new(SimClock::new());
        let sim = Sim::new("bq34z100-g1", &Options::default(), clock.clone()).expect("a part");
        clock.sleep(Duration::from_secs(2));
        let _ = sim.bus().transfer(&[0x08], &mut [0; 2]);
        sim.set_adapter(AdapterModel::by_name(name).expect("a model"), true);
        sim.keep_log(true);
        (sim.clone(), sim.bus(), clock)
    }

    /// As the drivers answered when they were run.
    #[test]
    fn a_failure_has_the_errno_of_the_adapter() {
        let errno = |name, fault: &str| {
            let (sim, mut bus, _) = gauge(name);
            sim.set("fault", fault).expect("a fault");
            bus.call(&[0x08], &mut [0; 2])
        };
        for (name, address, data, held) in [
            ("cp2112", 110, 5, 110),
            ("ft260", 5, 5, 5),
            ("mcp2221", 6, 6, 5),
            ("i801", 6, 6, 6),
            ("i2c-gpio", 6, 5, 6),
            ("i2c-tiny-usb", 6, 6, 5),
            ("bcm2835", 121, 121, 110),
        ] {
            for (fault, expected) in
                [("nack 1", address), ("nack 1 0", data), ("eio 1", address), ("stuck 1", held)]
            {
                assert_eq!(errno(name, fault), Err(BusError::Other(expected)), "{name}, {fault}");
            }
        }
        let (_, mut bus, _) = gauge("i801");
        assert_eq!(bus.call(&[0x7a, 1, 2], &mut []), Err(BusError::Other(6)), "a register that is not there");
        assert_eq!(errno("piix4", "arbitration 1"), Err(BusError::Other(5)));
        assert_eq!(errno("cp2112", "short 1"), Err(BusError::Other(5)));
    }

    /// The failure as gaugefs takes it on such an adapter.
    #[test]
    fn an_error_is_what_the_driver_makes_of_it() {
        for (name, fault, expected) in [
            ("cp2112", "nack 1", BusError::MaybeNoAck(110)),
            ("mcp2221", "nack 1", BusError::MaybeNoAck(6)),
            ("bcm2835", "nack 1", BusError::NoAck),
            ("bcm2835", "stuck 1", BusError::Timeout),
            ("i801", "nack 1", BusError::NoAck),
            ("i801", "stretch 1 26", BusError::MaybeNoAck(6)),
        ] {
            let (sim, mut bus, _) = gauge(name);
            sim.set("fault", fault).expect("a fault");
            assert_eq!(bus.transfer(&[0x08], &mut [0; 2]), Err(expected), "{name}, {fault}");
        }
    }

    #[test]
    fn an_adapter_gives_up_on_a_gauge_that_holds_the_clock_and_some_of_a_write_has_arrived() {
        for (name, least) in [("mcp2221", 1), ("cp2112", 20), ("i801", 25), ("i2c-gpio", 100)] {
            let (sim, mut bus, _) = gauge(name);
            sim.set("fault", &format!("stretch 1 {least}")).expect("a fault");
            assert_eq!(bus.call(&[0x08], &mut [0; 2]), Ok(()), "{name}");
        }
        let (sim, mut bus, _) = gauge("mcp2221");
        let mut arrived = Vec::new();
        for _ in 0..3 {
            sim.set("fault", "stretch 1 20").expect("a fault");
            let transfers = || sim.get("bytes").and_then(|text| text.parse::<u64>().ok()).expect("a number");
            let before = transfers();
            assert_eq!(bus.transfer(&[0x00, 0x00, 0x00], &mut []), Err(BusError::MaybeNoAck(5)));
            arrived.push(transfers() - before);
        }
        assert_eq!(arrived, [0, 2, 4], "nothing, the register, and all of it");
    }

    #[test]
    fn what_is_too_long_goes_as_the_driver_sends_it() {
        let (sim, mut bus, _) = gauge("cp2112");
        assert_eq!(bus.call(&[0x40; 256], &mut []), Ok(()), "as none");
        assert_eq!(bus.call(&[0x40; 62], &mut []), Err(BusError::Other(22)));
        assert_eq!(sim.get("bytes").as_deref(), Some("6"), "a word, and an address");
        let (sim, mut bus, _) = gauge("ft260-6.1");
        let mut whole = [0; 70];
        assert_eq!(bus.call(&[0x04], &mut whole), Ok(()));
        let mut rest = [0; 10];
        assert_eq!(sim.bus().call(&[0x40], &mut rest), Ok(()));
        assert_eq!(whole[60..], rest, "from the register above");
        // gaugefs never does that.
        assert_eq!(bus.transfer(&[0x04], &mut whole), Err(BusError::Other(95)));
        assert_eq!(bus.reach().read, 60);
    }

    #[test]
    fn a_transfer_takes_its_reports_and_its_bits_at_the_clock_of_the_adapter() {
        for (name, micros) in [("mcp2221", 12_000 + 48 * 5 / 2), ("piix4", 480)] {
            let (_, mut bus, clock) = gauge(name);
            let before = clock.now();
            bus.transfer(&[0x08], &mut [0; 2]).expect("it answers");
            assert_eq!((clock.now() - before).as_micros(), micros, "{name}");
        }
    }
}
