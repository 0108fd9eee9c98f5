// SPDX-License-Identifier: MIT

//! Where packs are connected: a bus on which they are exchanged, or simulated packs one after the other.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use super::{Bench, Plan, STEADY, Slot};
use crate::error::{Error, Result};
use crate::options::Rehearsed;
use gauge_bus::clock::Clock;
use gauge_bus::{Bus, BusError, Reach};
use gauge_owner::Source;
use gauge_owner::lock::{self, Lock};
use gauge_sim::{Level, Sim};
use ti_gauge::chip::{Chip, Role};

/// Absence of a removed pack, in ms.
const FOR_EVER_MS: u32 = 1_000_000_000;
/// An unseal key that the station does not know.
const OTHER_KEY: [u16; 2] = [0x5ca1, 0xab1e];

/// A place for packs, locked by this process.
pub(super) struct Place {
    pub(super) bench: Bench,
    pub(super) slot: Box<dyn Slot>,
}

impl Place {
    pub(super) fn all(plan: &Plan, clock: impl Fn() -> Arc<dyn Clock>) -> Result<Vec<Self>> {
        let mut places = Vec::new();
        for (at, (name, gauge)) in plan.setup.gauges.iter().enumerate() {
            let opened = Self::open(plan, at, Source::of(gauge)?, &clock());
            places.push(opened.map_err(|error| error.within(name))?);
        }
        Ok(places)
    }

    fn open(plan: &Plan, at: usize, mut source: Source, clock: &Arc<dyn Clock>) -> Result<Self> {
        let chip_of_packs = plan.chip();
        if let Source::Sim { state, .. } = &source {
            let subject = source.to_string();
            let key = state.as_deref().map(lock::key_of_state);
            let rehearsed = plan.setup.options.rehearsed().map_err(super::of_key)?;
            let packs = plan.setup.options.packs.unwrap_or(rehearsed.len().max(1) as u32);
            source.check(Path::new(""), clock)?;
            let slot = Simulated {
                source,
                rehearsed,
                clock: clock.clone(),
                left: packs,
                pack: None,
                number: 0,
                looks: STEADY,
                error: None,
            };
            return Ok(Self { bench: plan.bench(at, subject, Reach::FULL, key)?, slot: Box::new(slot) });
        }
        // The image tells the part, so no device is asked before its registers read like that part's.
        if let Source::Bus { chip, .. } = &mut source {
            *chip = Some(chip_of_packs);
        }
        let opened = source.open(Path::new(""), clock, false)?;
        let bench = plan.bench(at, opened.subject, opened.reach, opened.journal_key)?;
        let bus = Shared(Arc::new(Mutex::new(opened.bus)));
        let slot = Wired { looks: Looks::of(chip_of_packs), bus, clock: clock.clone(), _lock: opened.lock };
        Ok(Self { bench, slot: Box::new(slot) })
    }
}

/// A bus shared by the owners of all its packs; one works at a time.
#[derive(Clone)]
struct Shared(Arc<Mutex<Box<dyn Bus>>>);

impl Shared {
    fn with<T>(&self, work: impl FnOnce(&mut dyn Bus) -> T) -> T {
        work(&mut **self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Bus for Shared {
    fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
        self.with(|bus| bus.transfer(write, read))
    }

    fn reach(&mut self) -> Reach {
        self.with(|bus| bus.reach())
    }

    fn claim(&mut self) -> Result<(), BusError> {
        self.with(|bus| bus.claim())
    }

    fn limit(&mut self, latest: Option<std::time::Duration>) {
        self.with(|bus| bus.limit(latest));
    }

    fn release_if_gone(&mut self) {
        self.with(|bus| bus.release_if_gone());
    }

    fn set_secret(&mut self, secret: bool) {
        self.with(|bus| bus.set_secret(secret));
    }
}

struct Wired {
    looks: Looks,
    bus: Shared,
    clock: Arc<dyn Clock>,
    _lock: Option<Lock>,
}

impl Slot for Wired {
    fn clock(&self) -> Arc<dyn Clock> {
        self.clock.clone()
    }

    fn bus(&mut self) -> Box<dyn Bus> {
        Box::new(self.bus.clone())
    }

    fn is_there(&mut self) -> Option<bool> {
        Some(self.looks.find(&mut self.bus))
    }
}

/// Looks for a device by harmless reads, each of another register: a watchdog allows each only twice a second.
struct Looks {
    codes: Vec<u8>,
    next: usize,
}

impl Looks {
    fn of(chip: &Chip) -> Self {
        let roles = [Role::VoltageNow, Role::Temp, Role::CurrentNow];
        let codes = roles.into_iter().filter_map(|role| chip.register(role)?.source.command());
        Self { codes: codes.collect(), next: 0 }
    }

    fn find(&mut self, bus: &mut dyn Bus) -> bool {
        let code = self.codes.get(self.next % self.codes.len().max(1)).copied().unwrap_or(0x08);
        self.next += 1;
        bus.release_if_gone();
        bus.transfer(&[code], &mut [0; 2]).is_ok()
    }
}

/// Simulated packs. The next one comes after the previous one has gone.
struct Simulated {
    source: Source,
    /// Their events, repeated from the first.
    rehearsed: Vec<Rehearsed>,
    clock: Arc<dyn Clock>,
    left: u32,
    pack: Option<Pack>,
    number: u32,
    /// Looks since the previous pack has gone. The next one comes after that was noticed.
    looks: u32,
    error: Option<Error>,
}

struct Pack {
    looks: Looks,
    bus: Shared,
    _lock: Option<Lock>,
}

impl Simulated {
    fn connect(&mut self) -> Result<Pack> {
        let mut source = self.source.clone();
        if let Source::Sim { state: Some(state), .. } = &mut source {
            // `%` in the file's name stands for the pack's number.
            *state = state.to_string_lossy().replace('%', &self.number.to_string()).into();
        }
        self.rehearse(&mut source);
        let opened = source.open(Path::new(""), &self.clock, false)?;
        let looks = source.chip().map_or(Looks { codes: Vec::new(), next: 0 }, Looks::of);
        Ok(Pack { looks, bus: Shared(Arc::new(Mutex::new(opened.bus))), _lock: opened.lock })
    }
}

impl Simulated {
    fn rehearse(&self, of: &mut Source) {
        let at = (self.number as usize).saturating_sub(1) % self.rehearsed.len().max(1);
        let Some(rehearsed) = self.rehearsed.get(at) else { return };
        let Source::Sim { chip, key, seal, knobs, scenario, state, .. } = of else { return };
        let mut turn = |knob: &str, text: &str| knobs.push((knob.into(), text.into()));
        match rehearsed {
            Rehearsed::Good => {}
            Rehearsed::Pulled(transfer) => turn("fault", &format!("silence {transfer} {FOR_EVER_MS}")),
            Rehearsed::OtherPart => {
                let other = Chip::all().filter(|other| Sim::knows(other.name) && other.model != chip.model);
                // Its flash is another part's, which may not know those settings.
                (*scenario, *seal, *state) = (None, None, None);
                knobs.clear();
                if let Some(other) = other.into_iter().next() {
                    *chip = other;
                }
            }
            Rehearsed::OtherKey => (*key, *seal, *state) = (Some(OTHER_KEY), Some(Level::Sealed), None),
            Rehearsed::DeadMeter => turn("voltage_mv", "0"),
        }
    }
}

impl Slot for Simulated {
    fn clock(&self) -> Arc<dyn Clock> {
        self.clock.clone()
    }

    fn bus(&mut self) -> Box<dyn Bus> {
        match &self.pack {
            Some(pack) => Box::new(pack.bus.clone()),
            None => Box::new(Nothing),
        }
    }

    fn is_there(&mut self) -> Option<bool> {
        if let Some(pack) = &mut self.pack {
            return Some(pack.looks.find(&mut pack.bus));
        }
        if self.looks < STEADY {
            self.looks += 1;
            return Some(false);
        }
        self.left = self.left.checked_sub(1)?;
        self.number += 1;
        match self.connect() {
            Ok(pack) => self.pack = Some(pack),
            Err(error) => (self.left, self.error) = (0, Some(error)),
        }
        self.pack.as_ref().map(|_| true)
    }

    fn error(&mut self) -> Option<Error> {
        self.error.take()
    }

    fn done(&mut self) {
        (self.pack, self.looks) = (None, 0);
    }
}

struct Nothing;

impl Bus for Nothing {
    fn transfer(&mut self, _: &[u8], _: &mut [u8]) -> Result<(), BusError> {
        Err(BusError::NoAck)
    }
}
