// SPDX-License-Identifier: MIT

//! The wire between the guest's adapter and the gauge: turns the messages of one I2C request into
//! transfers, and counts them.

use gauge_bus::{Bus, BusError, GAUGE_ADDRESS, wire_bits, wire_bytes};

/// One message of a request: what follows one START or repeated START.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Message {
    /// 7-bit address.
    pub(crate) address: u16,
    /// What is written, or where it is read to, and whether it went through.
    pub(crate) data: Data,
    pub(crate) acknowledged: bool,
}

/// Direction and bytes of a [`Message`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Data {
    Write(Vec<u8>),
    Read(Vec<u8>),
}

/// What has passed to and from the gauge since the start or the last `counters reset`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Counters {
    pub(crate) transfers: u64,
    pub(crate) bytes: u64,
    pub(crate) bits: u64,
    pub(crate) refused: u64,
}

/// The wire to a gauge, and what it counts.
#[derive(Debug)]
pub(crate) struct Wire {
    /// 7-bit address of the gauge.
    pub(crate) address: u16,
    pub(crate) counters: Counters,
    /// Whatever is read reads 0xff, as from something that is no gauge.
    pub(crate) strange: bool,
}

impl Default for Wire {
    fn default() -> Self {
        Self { address: GAUGE_ADDRESS.into(), counters: Counters::default(), strange: false }
    }
}

impl Wire {
    /// Carries out the messages of one request. A write followed by a read is one transfer with a
    /// repeated START; `Bus` knows no other combination, so any other message is a transfer of its
    /// own. After the first refusal nothing more is sent, as on a real adapter.
    pub(crate) fn request(&mut self, bus: &mut dyn Bus, messages: &mut [Message]) {
        let mut rest = messages;
        while let Some((first, after)) = rest.split_first_mut() {
            let second = match after.first_mut() {
                Some(next) if first.reads_back_with(next) => Some(next),
                _ => None,
            };
            let used = 1 + usize::from(second.is_some());
            let done = match (&mut first.data, second) {
                (Data::Write(out), Some(Message { data: Data::Read(back), acknowledged, .. })) => {
                    *acknowledged = self.transfer(bus, first.address, out, back).is_ok();
                    *acknowledged
                }
                (Data::Write(out), _) => self.transfer(bus, first.address, out, &mut []).is_ok(),
                (Data::Read(back), _) => self.transfer(bus, first.address, &[], back).is_ok(),
            };
            first.acknowledged = done;
            if !done {
                return;
            }
            rest = &mut rest[used..];
        }
    }

    fn transfer(
        &mut self,
        bus: &mut dyn Bus,
        address: u16,
        write: &[u8],
        read: &mut [u8],
    ) -> Result<(), BusError> {
        if address != self.address {
            return Err(BusError::NoAck);
        }
        let result = bus.transfer(write, read);
        if self.strange {
            read.fill(0xff);
        }
        self.counters.transfers += 1;
        self.counters.bytes += wire_bytes(write.len(), read.len());
        self.counters.bits += wire_bits(write.len(), read.len());
        self.counters.refused += u64::from(result.is_err());
        result
    }
}

impl Message {
    fn reads_back_with(&self, next: &Message) -> bool {
        // A read of nothing is a message of its own: `Bus` has no transfer that ends in one.
        self.address == next.address
            && matches!(&self.data, Data::Write(out) if !out.is_empty())
            && matches!(&next.data, Data::Read(back) if !back.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Writes down its transfers and refuses the nth.
    struct Recorder(Vec<(Vec<u8>, usize)>, Option<usize>);

    impl Bus for Recorder {
        fn transfer(&mut self, write: &[u8], read: &mut [u8]) -> Result<(), BusError> {
            self.0.push((write.to_vec(), read.len()));
            read.fill(0xa5);
            if self.1 == Some(self.0.len() - 1) { Err(BusError::NoAck) } else { Ok(()) }
        }
    }

    fn write(bytes: &[u8]) -> Message {
        Message { address: 0x55, data: Data::Write(bytes.to_vec()), acknowledged: false }
    }

    fn read(count: usize) -> Message {
        Message { address: 0x55, data: Data::Read(vec![0; count]), acknowledged: false }
    }

    fn carried(messages: &mut [Message], refuse: Option<usize>) -> Vec<(Vec<u8>, usize)> {
        let mut bus = Recorder(Vec::new(), refuse);
        Wire::default().request(&mut bus, messages);
        bus.0
    }

    #[test]
    fn a_write_and_a_read_are_one_transfer() {
        let mut messages = [write(&[0x08]), read(2)];
        assert_eq!(carried(&mut messages, None), [(vec![0x08], 2)]);
        assert!(messages.iter().all(|message| message.acknowledged));
        assert_eq!(messages[1].data, Data::Read(vec![0xa5; 2]));
    }

    #[test]
    fn other_messages_are_transfers_of_their_own() {
        let mut messages = [read(1), write(&[1]), write(&[2]), read(3), write(&[]), read(0)];
        let expected = [(vec![], 1), (vec![1], 0), (vec![2], 3), (vec![], 0), (vec![], 0)];
        assert_eq!(carried(&mut messages, None), expected);
    }

    #[test]
    fn a_refusal_ends_the_request() {
        let mut messages = [write(&[1]), read(2), write(&[3]), write(&[4])];
        assert_eq!(carried(&mut messages, Some(1)).len(), 2);
        let acknowledged: Vec<_> = messages.iter().map(|message| message.acknowledged).collect();
        assert_eq!(acknowledged, [true, true, false, false]);
    }

    #[test]
    fn only_the_gauge_answers() {
        let mut messages = [Message { address: 0x54, ..write(&[0]) }];
        assert!(carried(&mut messages, None).is_empty());
        assert!(!messages[0].acknowledged);
    }
}
