// SPDX-License-Identifier: MIT

//! Who makes calls, and the chance by which they are drawn.

use std::sync::mpsc;

use rustix::process::{Gid, Uid};

pub(super) struct Random(pub(super) u64);

impl Random {
    pub(super) fn below(&mut self, limit: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0 % limit
    }

    pub(super) fn one_in(&mut self, count: u64) -> bool {
        self.below(count) == 0
    }

    pub(super) fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.below(from.len() as u64) as usize]
    }
}

/// Who makes a call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    Root,
    Owner,
    Member,
    Stranger,
}

pub(super) type Job = Box<dyn FnOnce() + Send>;

/// A thread with the user and group ids of one user, and with no capabilities unless that is root.
pub(super) struct User {
    pub(super) role: Role,
    pub(super) ids: Option<(u32, u32)>,
    pub(super) jobs: mpsc::Sender<Job>,
}

impl User {
    pub(super) fn new(role: Role, ids: Option<(u32, u32)>) -> Self {
        let (jobs, queue) = mpsc::channel::<Job>();
        std::thread::spawn(move || {
            if let Some((uid, gid)) = ids {
                let (uid, gid) = (Uid::from_raw(uid), Gid::from_raw(gid));
                rustix::thread::set_thread_groups(&[gid]).expect("root may do that");
                rustix::thread::set_thread_res_gid(gid, gid, gid).expect("root may do that");
                rustix::thread::set_thread_res_uid(uid, uid, uid).expect("root may do that");
            }
            queue.into_iter().for_each(|job| job());
        });
        Self { role, ids, jobs }
    }

    /// Makes a call as this user.
    pub(super) fn does<T: Send + 'static>(&self, call: impl FnOnce() -> T + Send + 'static) -> T {
        let (sender, answer) = mpsc::channel();
        self.jobs.send(Box::new(move || drop(sender.send(call())))).expect("the thread runs");
        answer.recv().expect("the call does not panic")
    }

    /// What the mode lets this user do: bits of `rwx`.
    pub(super) fn may(&self, mode: u32) -> u32 {
        match self.role {
            Role::Root => 0o6 | if mode & 0o111 != 0 { 1 } else { 0 },
            Role::Owner => mode >> 6 & 7,
            Role::Member => mode >> 3 & 7,
            Role::Stranger => mode & 7,
        }
    }
}
