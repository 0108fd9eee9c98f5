// SPDX-License-Identifier: MIT

//! The errno that a file operation answers with: one match, so that SEMANTICS.md can be held against it.

use std::io::ErrorKind;

use gauge_bus::{BusError, ErrorKind as AdapterKind};
use nix::errno::Errno;
use ti_gauge::error::Cause;

/// The errno of a cause.
pub(crate) fn of(cause: &Cause) -> Errno {
    match cause {
        Cause::Invalid(_) => Errno::EINVAL,
        Cause::OutOfRange(_) => Errno::ERANGE,
        Cause::NotPermitted(_) => Errno::EPERM,
        Cause::Busy(_) => Errno::EBUSY,
        Cause::NotNow(_) => Errno::EAGAIN,
        Cause::BadChecksum(_) => Errno::EBADMSG,
        Cause::Protocol(_) => Errno::EPROTO,
        Cause::TimedOut(_) => Errno::ETIMEDOUT,
        Cause::RolledBack(_) => Errno::EIO,
        Cause::StateUnknown(_) => Errno::ENOTRECOVERABLE,
        Cause::Gone(_) => Errno::ENODEV,
        Cause::NoAnswer(_) => Errno::ENXIO,
        Cause::Bus(error) => of_bus(*error),
        Cause::Adapter(kind, _) => of_adapter(*kind),
        Cause::Io(kind, _) => of_io(*kind),
    }
}

fn of_bus(error: BusError) -> Errno {
    match error {
        BusError::NoAck => Errno::ENXIO,
        BusError::ArbitrationLost => Errno::EAGAIN,
        BusError::Timeout | BusError::Hung(_) => Errno::ETIMEDOUT,
        BusError::Short => Errno::EPROTO,
        BusError::Gone => Errno::ENODEV,
        BusError::Busy => Errno::EBUSY,
        BusError::ReadOnly => Errno::EROFS,
        BusError::NotRecorded => Errno::ENODATA,
        BusError::Other(number) => Errno::from_raw(number),
    }
}

pub(crate) fn of_adapter(kind: AdapterKind) -> Errno {
    match kind {
        AdapterKind::Invalid => Errno::EINVAL,
        AdapterKind::NotFound => Errno::ENOENT,
        AdapterKind::NotABus => Errno::ENOTTY,
        AdapterKind::SmbusOnly => Errno::EOPNOTSUPP,
        AdapterKind::Busy => Errno::EBUSY,
        AdapterKind::Forbidden => Errno::EACCES,
        AdapterKind::Io(kind) => of_io(kind),
    }
}

/// What the standard library made of an errno, back. What it has no kind for is an input/output error.
fn of_io(kind: ErrorKind) -> Errno {
    match kind {
        ErrorKind::NotFound => Errno::ENOENT,
        ErrorKind::PermissionDenied => Errno::EACCES,
        ErrorKind::StorageFull => Errno::ENOSPC,
        ErrorKind::QuotaExceeded => Errno::EDQUOT,
        ErrorKind::ReadOnlyFilesystem => Errno::EROFS,
        ErrorKind::NotADirectory => Errno::ENOTDIR,
        ErrorKind::IsADirectory => Errno::EISDIR,
        ErrorKind::ResourceBusy => Errno::EBUSY,
        ErrorKind::TimedOut => Errno::ETIMEDOUT,
        ErrorKind::Interrupted => Errno::EINTR,
        _ => Errno::EIO,
    }
}
