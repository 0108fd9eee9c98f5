// SPDX-License-Identifier: MIT

//! The I2C side of a bridge: its gauges, a mux in front of them, and the faults that are ordered.
//!
//! With a second gauge there is a PCA9548 at 0x70: the first gauge is on channel 2 and the second one on channel 5.

use std::time::{Duration, Instant};

use crate::bench::Bench;
use crate::wire::{Data, Message};

const MUX: u16 = 0x70;
/// Bits of the channels in the mux's register.
const FIRST: u8 = 1 << 2;
const SECOND: u8 = 1 << 5;

/// Where a target has not acknowledged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Nack {
    Address,
    Data,
    /// The address after a repeated START.
    Restart,
}

/// The gauges of a bridge, and what is to go wrong.
#[derive(Debug)]
pub(crate) struct Board {
    first: Bench,
    second: Option<Bench>,
    /// Register of the mux.
    channels: u8,
    /// START to STOP, those to the mux included.
    pub(crate) transfers: u64,
    is_absent: bool,
    nack_data: Option<usize>,
    nack_restart: bool,
    /// Transfers until the bridge is pulled.
    pull: Option<u32>,
    stretch: (Duration, u32),
}

impl Board {
    pub(crate) fn new(first: Bench, second: Option<Bench>) -> Self {
        Self {
            first,
            second,
            channels: 0,
            transfers: 0,
            is_absent: false,
            nack_data: None,
            nack_restart: false,
            pull: None,
            stretch: (Duration::ZERO, 0),
        }
    }

    /// One transfer. Returns what is read.
    fn carry(&mut self, address: u16, write: Option<&[u8]>, read: Option<usize>) -> Result<Vec<u8>, Nack> {
        self.transfers += 1;
        self.pull = self.pull.map(|left| left.saturating_sub(1));
        if self.is_absent {
            return Err(Nack::Address);
        }
        if self.second.is_some() && address == MUX {
            self.channels = write.and_then(|bytes| bytes.last().copied()).unwrap_or(self.channels);
            return Ok(vec![self.channels; read.unwrap_or(0)]);
        }
        let bench = match &mut self.second {
            None => &mut self.first,
            Some(_) if self.channels & FIRST != 0 => &mut self.first,
            Some(second) if self.channels & SECOND != 0 => second,
            Some(_) => return Err(Nack::Address),
        };
        let bytes =
            |bytes: &[u8]| Message { address, data: Data::Write(bytes.to_vec()), acknowledged: false };
        if let (Some(write), Some(nth)) = (write, self.nack_data.take_if(|_| write.is_some())) {
            bench.request(&mut [bytes(&write[..write.len().min(nth - 1)])]);
            return Err(Nack::Data);
        }
        if let (Some(write), Some(_), true) = (write, read, self.nack_restart) {
            self.nack_restart = false;
            bench.request(&mut [bytes(write)]);
            return Err(Nack::Restart);
        }
        let read =
            read.map(|count| Message { address, data: Data::Read(vec![0; count]), acknowledged: false });
        let mut messages: Vec<Message> = write.map(bytes).into_iter().chain(read).collect();
        bench.request(&mut messages);
        if !messages.iter().take(1).all(|message| message.acknowledged) {
            return Err(Nack::Address);
        }
        match messages.pop() {
            Some(Message { data: Data::Read(bytes), .. }) => Ok(bytes),
            _ => Ok(Vec::new()),
        }
    }

    /// Whether a present gauge has this address, or the mux.
    pub(crate) fn acknowledges(&self, address: u16) -> bool {
        let is_of = |bench: &Bench| bench.wire.address == address;
        !self.is_absent && (is_of(&self.first) || self.second.is_some() && address == MUX)
    }

    /// Whether the bridge is pulled now, in the middle of what it does.
    pub(crate) fn is_pulled(&mut self) -> bool {
        self.pull.take_if(|left| *left == 0).is_some()
    }

    /// Carries out a command of the control line. Returns what it prints.
    pub(crate) fn command(&mut self, words: &[&str]) -> Result<String, String> {
        let number = |text: &str| text.parse::<u32>().map_err(|_| format!("{text}: not a number"));
        match *words {
            ["absent", state] => self.is_absent = state == "on",
            ["nack", "data", nth] => self.nack_data = Some(number(nth)?.max(1) as usize),
            ["nack", "restart"] => self.nack_restart = true,
            ["pull", "after", transfers] => self.pull = Some(number(transfers)?.max(1)),
            ["stretch", milliseconds, transfers] => {
                self.stretch = (Duration::from_millis(number(milliseconds)?.into()), number(transfers)?);
            }
            ["second", ref command @ ..] => {
                return self.second.as_mut().ok_or("there is no second gauge")?.command(command);
            }
            _ => return self.first.command(words),
        }
        Ok(String::new())
    }
}

/// What a bridge knows of its last transfer.
#[derive(Debug)]
pub(crate) struct Engine {
    outcome: Option<Result<Vec<u8>, Nack>>,
    given: usize,
    until: Instant,
}

impl Default for Engine {
    fn default() -> Self {
        Self { outcome: None, given: 0, until: Instant::now() }
    }
}

impl Engine {
    /// Starts a transfer. Only with a stretched clock it takes time: without, it is shorter than the driver's next question,
    /// which an emulated processor would not keep.
    pub(crate) fn start(
        &mut self,
        board: &mut Board,
        address: u8,
        write: Option<&[u8]>,
        read: Option<usize>,
    ) {
        let mut busy = Duration::ZERO;
        if board.stretch.1 > 0 {
            board.stretch.1 -= 1;
            busy = board.stretch.0;
        }
        self.outcome = Some(board.carry(address.into(), write, read));
        self.given = 0;
        self.until = Instant::now() + busy;
    }

    /// Sets an outcome without a transfer.
    pub(crate) fn set(&mut self, outcome: Result<Vec<u8>, Nack>) {
        self.outcome = Some(outcome);
        self.given = 0;
    }

    pub(crate) fn is_busy(&self) -> bool {
        Instant::now() < self.until
    }

    /// When the transfer ends.
    pub(crate) fn until(&self) -> Instant {
        self.until
    }

    pub(crate) fn has_run(&self) -> bool {
        self.outcome.is_some()
    }

    pub(crate) fn nack(&self) -> Option<Nack> {
        self.outcome.as_ref()?.as_ref().err().copied()
    }

    /// The next bytes read, at most so many.
    pub(crate) fn take(&mut self, most: usize) -> &[u8] {
        let all = match &self.outcome {
            Some(Ok(bytes)) => &bytes[self.given..],
            _ => &[],
        };
        let next = &all[..all.len().min(most)];
        self.given += next.len();
        next
    }

    /// Bytes that are not taken yet.
    pub(crate) fn left(&self) -> usize {
        self.outcome
            .as_ref()
            .and_then(|outcome| outcome.as_ref().ok())
            .map_or(0, |all| all.len() - self.given)
    }
}
