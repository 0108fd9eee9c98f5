// SPDX-License-Identifier: MIT

//! A gauge without a thread: what its holder asks is carried out before the call returns. It is polled on request only.

use std::sync::mpsc;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::handle::{Queue, Requests, lock};
use super::{Attempt, Handle, Operation, Owner, Run};
use crate::error::Result;
use gauge_bus::Bus;
use gauge_bus::clock::Clock;
use ti_gauge::chip::Chip;
use ti_gauge::keys::{Name, Secret};

/// The owner of a gauge, driven by the caller's thread.
pub struct Direct {
    pub(in crate::owner) owner: Box<Owner>,
    /// What everybody else sees of it.
    pub handle: Handle,
    requests: Arc<Mutex<Requests>>,
}

impl Direct {
    /// Nothing has been sent to the gauge yet.
    pub fn new(chip: &'static Chip, bus: Box<dyn Bus>, clock: Arc<dyn Clock>, run: Run) -> Self {
        let (owner, shared) = Owner::new(chip, bus, clock, run, Arc::default());
        let requests = Arc::default();
        Self { owner, handle: Handle::new(shared, Queue::Direct(Arc::downgrade(&requests))), requests }
    }

    /// Identifies the gauge, settles what an earlier process has left, and polls it.
    pub fn open(&mut self) -> Result<()> {
        self.owner.first_poll()
    }

    /// Carries out an operation.
    pub fn ask<A: Send, T: Send + 'static>(
        &mut self,
        operation: &'static Operation<A, T>,
        argument: A,
    ) -> Result<T> {
        self.ask_late(Duration::ZERO, operation, argument)
    }

    /// Carries out an operation that was asked for that long ago.
    pub(in crate::owner) fn ask_late<A: Send, T: Send + 'static>(
        &mut self,
        delay: Duration,
        operation: &'static Operation<A, T>,
        argument: A,
    ) -> Result<T> {
        let (done, outcome) = mpsc::channel();
        self.handle.ask(operation, argument, Box::new(move |answer| drop(done.send(answer))));
        self.owner.shared().clock.sleep(delay);
        let next = lock(&self.requests).pop_front();
        if let Some((submitted, request)) = next {
            request.carry_out(&mut self.owner, submitted);
        }
        outcome.try_recv().unwrap_or_else(|_| unreachable!("a request that is dropped answers"))
    }

    /// Makes sure that no row of it is erased, by the table and by its own backups.
    pub fn check_erased(&mut self) -> Result<()> {
        let owner = &mut *self.owner;
        owner.backups.check_erased(&mut owner.access, &[], Duration::ZERO)
    }

    /// The key that is sent to the gauge.
    pub fn key(&self, name: Name) -> Option<Secret> {
        self.owner.access.key(name)
    }

    /// The manual's key, unless it must not be tried.
    pub fn default_key(&self, name: Name) -> Option<Secret> {
        self.owner.access.default_key(name)
    }

    /// The keys whose change is neither done nor undone.
    pub fn owed_keys(&self) -> Vec<Name> {
        self.owner.access.owed().map_or(Vec::new(), |owed| owed.keys.to_vec())
    }

    /// Tries to pay what is owed, for as long as that. Returns why it is still owed, and whether a person has to decide.
    pub fn settle(&mut self, patience: Duration) -> Option<(String, bool)> {
        let clock = self.owner.shared().clock.clone();
        let end = clock.now() + patience;
        loop {
            let owed = self.owner.access.owed().map(|owed| (owed.why.to_string(), owed.needs_decision))?;
            let due = self.owner.access.next_payment().filter(|due| *due <= end && !owed.1);
            let Some(due) = due else { return Some(owed) };
            clock.sleep(due.saturating_sub(clock.now()));
            // A panic has thrown away what was known of the gauge, and its journal is still there.
            if self.owner.survive(Attempt::SETTLE, |owner| owner.access.pay()).is_err() {
                return Some(owed);
            }
        }
    }
}
