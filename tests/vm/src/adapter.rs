// SPDX-License-Identifier: MIT

//! The virtio-i2c device as a vhost-user back end (VIRTIO 1.2, section 5.14): takes requests from
//! the guest's queue, hands them to the [`Wire`], and gives back status and bytes.

use std::io::{self, Read as _, Write as _};
use std::sync::{Arc, Mutex, PoisonError};

use vhost::vhost_user::message::VhostUserProtocolFeatures;
use vhost_user_backend::{VhostUserBackendMut, VringMutex, VringT};
use virtio_queue::{DescriptorChain, QueueOwnedT, Reader, Writer};
use vm_memory::{GuestAddressSpace, GuestMemoryAtomic, GuestMemoryLoadGuard, GuestMemoryMmap};
use vmm_sys_util::epoll::EventSet;
use vmm_sys_util::event::{EventConsumer, EventFlag, EventNotifier, new_event_consumer_and_notifier};

use crate::bench::Bench;
use crate::wire::{Data, Message};

/// VIRTIO_F_VERSION_1 and VHOST_USER_F_PROTOCOL_FEATURES.
const VERSION_1: u64 = 1 << 32;
const PROTOCOL_FEATURES: u64 = 1 << 30;
/// QEMU lets the guest have these without asking the back end, and acknowledges them here:
/// VIRTIO_F_INDIRECT_DESC, VIRTIO_F_EVENT_IDX, VIRTIO_F_RING_RESET.
const QUEUE_FEATURES: u64 = 1 << 28 | 1 << 29 | 1 << 40;
/// VIRTIO_I2C_F_ZERO_LENGTH_REQUEST, which Linux insists on.
const ZERO_LENGTH_REQUEST: u64 = 1;

/// Request flags: the next request belongs to this one; this one reads.
const FAIL_NEXT: u32 = 1;
const READ: u32 = 2;

/// Status of a request.
const OK: u8 = 0;
const ERR: u8 = 1;

type Chain = DescriptorChain<GuestMemoryLoadGuard<GuestMemoryMmap>>;

/// One adapter, for the life of one connection.
#[derive(Debug)]
pub(crate) struct Adapter {
    bench: Arc<Mutex<Bench>>,
    memory: GuestMemoryAtomic<GuestMemoryMmap>,
    /// Requests that say that more follow, which the guest is still writing.
    waiting: Vec<Request>,
    exit: (EventConsumer, EventNotifier),
}

/// A request as it lies in the queue.
#[derive(Debug)]
struct Request {
    chain: Chain,
    message: Message,
    more: bool,
}

impl Adapter {
    pub(crate) fn new(
        bench: Arc<Mutex<Bench>>,
        memory: GuestMemoryAtomic<GuestMemoryMmap>,
    ) -> io::Result<Self> {
        let exit = new_event_consumer_and_notifier(EventFlag::NONBLOCK | EventFlag::CLOEXEC)?;
        Ok(Self { bench, memory, waiting: Vec::new(), exit })
    }

    /// Takes what the guest has queued; whether there was anything.
    fn serve(&mut self, vring: &VringMutex) -> io::Result<bool> {
        let memory = self.memory.memory();
        let chains: Vec<Chain> =
            vring.get_mut().get_queue_mut().iter(memory).map_err(io::Error::other)?.collect();
        let any = !chains.is_empty();
        for chain in chains {
            let request = Request::read(chain)?;
            let complete = !request.more;
            self.waiting.push(request);
            if complete {
                self.carry_out(vring)?;
            }
        }
        Ok(any)
    }

    fn carry_out(&mut self, vring: &VringMutex) -> io::Result<()> {
        let requests = std::mem::take(&mut self.waiting);
        let mut messages: Vec<Message> = requests.iter().map(|request| request.message.clone()).collect();
        {
            let mut bench = self.bench.lock().unwrap_or_else(PoisonError::into_inner);
            bench.request(&mut messages);
        }
        for (request, message) in requests.into_iter().zip(&messages) {
            let head = request.chain.head_index();
            let length = request.answer(message)?;
            vring.add_used(head, length).map_err(io::Error::other)?;
        }
        Ok(())
    }
}

impl Request {
    /// The request's header, then the bytes to write; what is writable besides the status byte is
    /// the room to read into.
    fn read(chain: Chain) -> io::Result<Self> {
        let memory = chain.memory();
        let mut reader = Reader::new(memory, chain.clone()).map_err(io::Error::other)?;
        let writer = Writer::new(memory, chain.clone()).map_err(io::Error::other)?;
        let mut header = [0; 8];
        reader.read_exact(&mut header)?;
        let [a0, a1, _, _, flags @ ..] = header;
        let flags = u32::from_le_bytes(flags);
        let data = if flags & READ == 0 {
            let mut bytes = Vec::new();
            reader.read_to_end(&mut bytes)?;
            Data::Write(bytes)
        } else {
            Data::Read(vec![0; writer.available_bytes().saturating_sub(1)])
        };
        let message = Message { address: u16::from_le_bytes([a0, a1]) >> 1, data, acknowledged: false };
        Ok(Self { chain, message, more: flags & FAIL_NEXT != 0 })
    }

    /// Bytes and status go back to the guest; returns how many bytes that is.
    fn answer(self, message: &Message) -> io::Result<u32> {
        let memory = self.chain.memory();
        let mut writer = Writer::new(memory, self.chain.clone()).map_err(io::Error::other)?;
        if let Data::Read(bytes) = &message.data {
            writer.write_all(bytes)?;
        }
        writer.write_all(&[if message.acknowledged { OK } else { ERR }])?;
        Ok(u32::try_from(writer.bytes_written()).unwrap_or(u32::MAX))
    }
}

impl VhostUserBackendMut for Adapter {
    type Bitmap = ();
    type Vring = VringMutex;

    fn num_queues(&self) -> usize {
        1
    }

    fn max_queue_size(&self) -> usize {
        1024
    }

    fn features(&self) -> u64 {
        VERSION_1 | PROTOCOL_FEATURES | QUEUE_FEATURES | ZERO_LENGTH_REQUEST
    }

    fn protocol_features(&self) -> VhostUserProtocolFeatures {
        VhostUserProtocolFeatures::MQ
    }

    fn reset_device(&mut self) {
        self.waiting.clear();
    }

    fn set_event_idx(&mut self, _enabled: bool) {}

    fn update_memory(&mut self, memory: GuestMemoryAtomic<GuestMemoryMmap>) -> io::Result<()> {
        self.memory = memory;
        Ok(())
    }

    fn exit_event(&self, _thread: usize) -> Option<(EventConsumer, EventNotifier)> {
        Some((self.exit.0.try_clone().ok()?, self.exit.1.try_clone().ok()?))
    }

    fn handle_event(
        &mut self,
        _queue: u16,
        _events: EventSet,
        vrings: &[VringMutex],
        _thread: usize,
    ) -> io::Result<()> {
        let Some(vring) = vrings.first() else { return Ok(()) };
        // The guest need not kick while we are at work: look again after asking it to.
        loop {
            vring.disable_notification().map_err(io::Error::other)?;
            while self.serve(vring)? {
                vring.signal_used_queue()?;
            }
            if !vring.enable_notification().map_err(io::Error::other)? {
                return Ok(());
            }
        }
    }
}
