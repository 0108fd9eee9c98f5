// SPDX-License-Identifier: MIT

//! What went wrong, at which step, to which register or parameter, and what to do.
//!
//! Every failure is one [`Error`]: a line that a technician can act on, a [`Cause`] with an errno that a program can match
//! on, and facts by names. A failure with facts is one row of [`Reason`], and the line is made of them when printed.

use std::borrow::Cow;
use std::sync::Arc;
use std::{error, fmt, io};

use crate::{quantity, text};
use gauge_bus::error::{Driver, errno_of, reason};
use gauge_bus::{BusError, ErrorKind};
use rustix::io::Errno;

/// A `Result` whose error is [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// The step of an operation that failed, as it is printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Opening the adapter and claiming the address.
    Open,
    /// Reading a standard command.
    Read,
    /// Sending a Control() subcommand or reading its answer.
    Control,
    /// Asking the gauge which part it is.
    Identify,
    /// Checking a value or the gauge's state before touching anything.
    Check,
    /// Sending key words and confirming the state they lead to.
    Unseal,
    /// Restoring the gauge's earlier state.
    Seal,
    /// Selecting a data-flash block and reading it.
    ReadBlock,
    /// Writing a data-flash block and its checksum.
    WriteBlock,
    /// Reading back what was written.
    Verify,
    /// Resetting the gauge so that new data flash takes effect.
    Reset,
    /// Putting the old block back after a failure.
    Restore,
}

impl Step {
    /// The step's name in a message.
    pub fn as_str(self) -> &'static str {
        match self {
            Step::Open => "open",
            Step::Read => "read",
            Step::Control => "Control()",
            Step::Identify => "identify",
            Step::Check => "check",
            Step::Unseal => "unseal",
            Step::Seal => "seal",
            Step::ReadBlock => "read block",
            Step::WriteBlock => "write block",
            Step::Verify => "verify",
            Step::Reset => "reset",
            Step::Restore => "restore",
        }
    }
}

/// The kind of a failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Not a value of that type, junk after it, or an unsafe subcommand.
    Invalid,
    /// Outside the range of the manual or the narrower safe limits.
    OutOfRange,
    /// Sealed without a working key, or not changeable this way.
    NotPermitted,
    /// Something else holds the gauge: a transaction, a kernel driver, another process.
    Busy,
    /// The gauge cannot do it now: voltage below its flash-update limit, and the like.
    NotNow,
    /// The checksum of a block that was read is wrong.
    BadChecksum,
    /// The reply breaks the protocol.
    Protocol,
    /// The gauge did not finish in time.
    TimedOut,
    /// Failed; the old block was put back and verified.
    RolledBack,
    /// Failed; data flash or seal are unknown or changed.
    StateUnknown,
    /// The gauge is gone, or another part answers in its place.
    Gone,
    /// No answer at the address.
    NoAnswer,
    /// It can only be read behind this adapter.
    ReadOnly,
    /// The bus itself failed.
    Bus(BusError),
    /// The bus could not be opened.
    Adapter(ErrorKind),
    /// The host failed with a file or a folder.
    Io(io::ErrorKind),
}

impl Cause {
    /// Names of all causes.
    pub const NAMES: [&'static str; 16] = [
        "invalid",
        "out-of-range",
        "not-permitted",
        "busy",
        "not-now",
        "bad-checksum",
        "protocol",
        "timed-out",
        "rolled-back",
        "state-unknown",
        "gone",
        "no-answer",
        "read-only",
        "bus",
        "adapter",
        "io",
    ];

    fn row(self) -> (&'static str, i32) {
        let (name, errno) = match self {
            Cause::Invalid => ("invalid", Errno::INVAL),
            Cause::OutOfRange => ("out-of-range", Errno::RANGE),
            Cause::NotPermitted => ("not-permitted", Errno::PERM),
            Cause::Busy => ("busy", Errno::BUSY),
            Cause::NotNow => ("not-now", Errno::AGAIN),
            Cause::BadChecksum => ("bad-checksum", Errno::BADMSG),
            Cause::Protocol => ("protocol", Errno::PROTO),
            Cause::TimedOut => ("timed-out", Errno::TIMEDOUT),
            Cause::RolledBack => ("rolled-back", Errno::IO),
            Cause::StateUnknown => ("state-unknown", Errno::NOTRECOVERABLE),
            Cause::Gone => ("gone", Errno::NODEV),
            Cause::NoAnswer => ("no-answer", Errno::NXIO),
            Cause::ReadOnly => ("read-only", Errno::ROFS),
            // It is no fault of the bus.
            Cause::Bus(BusError::TooSlow { .. }) => ("timed-out", Errno::TIMEDOUT),
            Cause::Bus(bus) => return ("bus", bus.errno()),
            Cause::Adapter(kind) => return ("adapter", kind.errno()),
            Cause::Io(kind) => return ("io", errno_of(kind)),
        };
        (name, errno.raw_os_error())
    }

    /// Name for programs, such as `out-of-range`.
    pub fn name(self) -> &'static str {
        self.row().0
    }

    /// The errno for a file operation.
    pub fn errno(self) -> i32 {
        self.row().1
    }
}

/// A fact about a failure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fact {
    /// A yes.
    Yes,
    /// A number.
    Number(i64),
    /// A name, or a number with its notation.
    Text(Cow<'static, str>),
    /// A place in data flash: the id of its subclass, or [`FLAT`](crate::chip::FLAT), and an offset in bytes.
    Place((u8, u16)),
    /// Another failure.
    Failure(Error),
}

/// A reason's field, for programs.
trait AsFact {
    fn fact(&self) -> Option<Fact>;

    fn failure(&self) -> Option<&Error> {
        None
    }
}

impl AsFact for u16 {
    fn fact(&self) -> Option<Fact> {
        Some(Fact::Number((*self).into()))
    }
}

impl AsFact for u32 {
    fn fact(&self) -> Option<Fact> {
        Some(Fact::Number((*self).into()))
    }
}

impl AsFact for i64 {
    fn fact(&self) -> Option<Fact> {
        Some(Fact::Number(*self))
    }
}

impl AsFact for Cow<'static, str> {
    fn fact(&self) -> Option<Fact> {
        Some(Fact::Text(self.clone()))
    }
}

impl AsFact for String {
    fn fact(&self) -> Option<Fact> {
        Some(Fact::Text(self.clone().into()))
    }
}

impl AsFact for &'static str {
    fn fact(&self) -> Option<Fact> {
        Some(Fact::Text((*self).into()))
    }
}

impl AsFact for bool {
    fn fact(&self) -> Option<Fact> {
        self.then_some(Fact::Yes)
    }
}

impl<T: AsFact> AsFact for Option<T> {
    fn fact(&self) -> Option<Fact> {
        self.as_ref().and_then(AsFact::fact)
    }
}

impl AsFact for Error {
    fn fact(&self) -> Option<Fact> {
        Some(Fact::Failure(self.clone()))
    }

    fn failure(&self) -> Option<&Error> {
        Some(self)
    }
}

/// The reason of a transfer that was not sent, because its access has no time left.
const SLOW_BUS: &str = "slow-bus";

fn told_of_bus(bus: BusError) -> (Option<&'static str>, Vec<(&'static str, Fact)>) {
    let BusError::TooSlow { transfers, failed, milliseconds, limit } = bus else { return (None, Vec::new()) };
    let facts =
        [("transfers", transfers), ("failed", failed), ("milliseconds", milliseconds), ("limit", limit)];
    (Some(SLOW_BUS), facts.map(|(name, number)| (name, Fact::Number(number.into()))).into())
}

/// Makes [`Reason`] from a row per failure: facts; words for the text only; name and cause; the text.
macro_rules! reasons {
    ($($(#[doc = $doc:literal])+
        $variant:ident { $($fact:ident: $type:ty),* $(; $($word:ident: $kind:ty),+)? }
        $name:literal, $cause:ident, $($text:expr),+;)+) => {
        /// Why something failed.
        #[derive(Clone, Debug, PartialEq, Eq)]
        #[non_exhaustive]
        pub enum Reason {
            /// A failure without facts of its own.
            Text(Cause, Cow<'static, str>),
            /// A transfer on the bus.
            Bus(BusError),
            $($(#[doc = $doc])+ $variant {
                $(#[doc = concat!("The fact `", stringify!($fact), "`.")] $fact: $type,)*
                $($(#[doc = concat!("Words of the text: ", stringify!($word), ".")] $word: $kind,)+)?
            },)+
        }

        impl Reason {
            /// Names of the reasons with facts.
            pub const NAMES: &[&str] = &[SLOW_BUS, $($name),+];

            fn row(&self) -> (Option<&'static str>, Cause, Vec<(&'static str, Fact)>, Option<&Error>) {
                match self {
                    Self::Text(cause, _) => (None, *cause, Vec::new(), None),
                    Self::Bus(bus) => {
                        let (name, facts) = told_of_bus(*bus);
                        (name, Cause::Bus(*bus), facts, None)
                    }
                    $(Self::$variant { $($fact,)* .. } => {
                        let facts = [$((stringify!($fact), $fact.fact())),*];
                        let facts = facts.into_iter().filter_map(|(name, fact)| Some((name, fact?)));
                        (Some($name), Cause::$cause, facts.collect(), None$(.or($fact.failure()))*)
                    })+
                }
            }
        }

        impl fmt::Display for Reason {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                match self {
                    Self::Text(_, text) => f.write_str(text),
                    Self::Bus(bus) => bus.fmt(f),
                    $(Self::$variant { $($fact,)* $($($word),+)? } => {
                        // Some facts are not in the text.
                        $(_ = $fact;)*
                        write!(f, $($text),+)
                    })+
                }
            }
        }
    };
}

// Facts never contain a user's text: it may be a key that was meant for another file.
reasons! {
    /// A value is outside of the allowed range.
    OutOfRange { least: String, greatest: String, unit: &'static str } "out-of-range", OutOfRange,
        "the value is outside {}", quantity::pair(least, " to ", greatest, unit);
    /// A value would do harm because it is too small.
    Unsafe { number: i64, least: i64; why: &'static str } "unsafe", OutOfRange, "{number} is below {least}: {why}";
    /// A value would do harm because it is too great.
    UnsafeAbove { number: i64, greatest: i64; why: &'static str } "unsafe-above", OutOfRange,
        "{number} is above {greatest}: {why}";
    /// The gauge's supply is outside of the part's range, in mV.
    Supply { value: u16, least: u16, greatest: u16 } "supply-voltage", NotNow,
        "{value} mV, and the part works from {least} to {greatest} mV: charge the cell, or check its connection";
    /// The gauge programs no flash at this voltage, in mV.
    FlashVoltage { value: i64, least: i64; compared: String, place: String, remedy: String } "flash-voltage", NotNow,
        "the gauge measures {value} mV{compared} and stores nothing below {least} mV ({place}){remedy}";
    /// A kernel driver is bound to the address.
    DriverBound { driver: String, device: String; what: String } "driver-bound", Busy, "{what}";
    /// Another process has the gauge, its state or its journal.
    InUse { process: Option<i64>, mountpoint: Option<String>; what: String } "in-use", Busy, "{what}";
    /// Something of an earlier access must be done first.
    Owed { decision: bool; what: String } "owed", Busy, "{what}";
    /// A mode prevents all writes.
    Mode { word: u32; what: &'static str, remedy: &'static str } "mode", Busy, "set in 0x{word:04x}: {what}; {remedy}";
    /// The checksum of a block does not match its bytes.
    Checksum { found: u16, expected: u16; of: &'static str } "checksum", BadChecksum,
        "{of} is 0x{found:02x}, the block adds up to 0x{expected:02x}";
    /// A readback differs from what was written.
    Mismatch { read: u16, wrote: u16; place: String } "mismatch", Protocol, "{place} reads 0x{read:02x}, wrote 0x{wrote:02x}";
    /// Too many blocks were programmed within the last hour.
    Wear { blocks: i64, greatest: i64, seconds: i64 } "wear", NotNow,
        "{blocks} blocks were programmed within the last hour; the limit is {greatest}, because flash wears out: the next \
         write may come in {} min {} s; --writes-per-hour sets another limit", seconds / 60, seconds % 60;
    /// The adapter carries no whole block of data flash.
    ShortWrites { greatest: u16, bytes: u16 } "short-writes", ReadOnly,
        "data flash can only be read: the adapter carries writes of {greatest} bytes, a block has {bytes} with its register, \
         and this part is not known to take its bytes one by one; connect it to another adapter, or mount it with \
         --byte-writes if it does";
    /// No row of the part's data flash is proven.
    OnlyNames { rows: i64 } "only-names", NotPermitted,
        "nothing is written to its data flash, not even with --allow-unproven: {rows} rows are known by name, and not one is \
         proven; to have them proven, send the file that `gaugefs report` writes";
    /// The gauge shows no sign of a command.
    NoEffect { command: Cow<'static, str>, times: i64 } "no-effect", TimedOut,
        "the gauge was sent {command}{} and shows no sign of it",
        if *times == 1 { String::new() } else { format!(" {times} times") };
    /// A flag of a register has not changed in time.
    NotInTime { flag: &'static str, milliseconds: i64; set: bool, remedy: &'static str } "not-in-time", TimedOut,
        "{flag} was not {} within {} s; {remedy}", if *set { "set" } else { "cleared" }, *milliseconds as f64 / 1000.0;
    /// The gauge does not answer at all.
    Silent { seconds: i64 } "silent", TimedOut, "no answer within {seconds} s";
    /// A register is too noisy for a calibration. Readings are in `unit`.
    Noisy { least: String, greatest: String, spread: i64, unit: &'static str; shown: String } "noisy", NotNow,
        "{shown} is too noisy for a calibration, which needs a spread of {spread} {unit} at most: keep load and \
         temperature steady; nothing was changed";
    /// Current flows during an offset measurement, in mA.
    CurrentFlows { value: i64, greatest: i64; shown: String } "current-flows", NotNow,
        "{shown}, and an offset is measured while no current flows, at {greatest} mA at most: disconnect load and charger";
    /// A register is further from its target than before the calibration. Errors are in `unit`.
    Worse { before: String, after: String, unit: &'static str; shown: String } "worse", Protocol,
        "{shown} after the calibration, {before} {unit} off before and {after} {unit} now";
    /// A register is outside of its plausible range. Readings are in `unit`.
    Implausible { value: String, least: i64, greatest: i64, unit: &'static str; shown: String } "implausible", Protocol,
        "{shown} with the new divider, and it should be {least} to {greatest} {unit}: is the divider right, and the number \
         of cells?";
    /// A key is needed and unknown.
    NoKey { key: &'static str; before: &'static str, file: String } "no-key", NotPermitted,
        "{before}; put it into {file} and mount again";
    /// The gauge did not take a key.
    KeyRefused { key: &'static str; what: String } "key-refused", NotPermitted, "{what}";
    /// Another part answers than the table's.
    OtherPart { expected: u16, found: u16 } "other-part", Gone,
        "device type is 0x{found:04x}, not 0x{expected:04x}: another part answers; mount it anew";
    /// Another pack answers than the one whose values were read: a word that tells packs apart has changed.
    OtherPack { expected: u16, found: u16; what: String } "other-pack", Gone,
        "{what} is 0x{found:04x} and was 0x{expected:04x} when its values were read: another pack answers; check its \
         values before you write";
    /// No table describes the part, or it is not the named one.
    WrongPart { device_type: u16, firmware: u16, hardware: u16; what: String } "wrong-part", Gone,
        "device type 0x{device_type:04x}, firmware 0x{firmware:04x}, hardware 0x{hardware:04x}: {what}";
    /// A write failed and was undone.
    RolledBack { failed: Error; what: String } "rolled-back", RolledBack, "{failed}; {what}";
    /// A write failed, and so did the way back.
    NotRestored { failed: Error, then: Error; what: String } "not-restored", StateUnknown, "{failed}; then {then}: {what}";
    /// A change of keys failed, and the gauge's key is uncertain.
    KeyUnknown { failed: Error; what: String } "key-unknown", StateUnknown, "{failed}; {what}";
    /// An interrupted write could not be settled.
    NotSettled { failed: Error } "not-settled", StateUnknown, "{failed}: data flash contents unknown";
    /// A write failed because the gauge lost its power, and its RAM with it.
    PowerLost { failed: Error } "power-lost", StateUnknown,
        "{failed}; the gauge has lost its power, and its data memory with it";
    /// The request was carried out, but the gauge's earlier seal state was not restored.
    NotClosed { seal: &'static str, failed: Error } "not-closed", StateUnknown,
        "done and verified, but restoring the {seal} state failed: {failed}";
    /// Something failed, and the gauge's earlier seal state was not restored.
    FailedOpen { failed: Error, seal: &'static str, then: Error } "failed-open", StateUnknown,
        "{failed}; then restoring the {seal} state failed: {then}";
    /// Calibration mode could not be left.
    Calibrating { failed: Error } "calibrating", StateUnknown, "the gauge may still be in calibration mode: {failed}";
}

/// A failure: subject, step and reason.
#[derive(Clone, PartialEq, Eq)]
pub struct Error(Box<Inner>);

#[derive(Clone, PartialEq, Eq)]
struct Inner {
    subject: String,
    step: Option<Step>,
    reason: Reason,
    register: Option<String>,
    place: Option<(u8, u16)>,
    /// The access has left something to do, or was refused because an earlier one did.
    owed: bool,
    host: Option<Host>,
    /// The facts of the process that refused the request.
    reported: Option<Box<str>>,
    further: Vec<Error>,
}

#[derive(Clone, Debug)]
struct Host(Arc<io::Error>);

impl PartialEq for Host {
    fn eq(&self, other: &Self) -> bool {
        (self.0.kind(), self.0.raw_os_error()) == (other.0.kind(), other.0.raw_os_error())
    }
}

impl Eq for Host {}

impl Error {
    /// An error about `subject`: a register, a parameter, a file or a bus.
    pub fn new(subject: impl Into<String>, cause: Cause, text: impl Into<Cow<'static, str>>) -> Self {
        Self::of(subject, Reason::Text(cause, text.into()))
    }

    /// An error whose reason has facts.
    pub fn of(subject: impl Into<String>, reason: Reason) -> Self {
        let subject = subject.into();
        Self(Box::new(Inner {
            subject,
            step: None,
            reason,
            register: None,
            place: None,
            owed: false,
            host: None,
            reported: None,
            further: Vec::new(),
        }))
    }

    pub(crate) fn bus(subject: impl Into<String>, bus: BusError) -> Self {
        Self::of(subject, Reason::Bus(bus))
    }

    /// The host's error; `what` names what failed.
    pub fn io(subject: impl Into<String>, what: &str, error: &io::Error) -> Self {
        // It cannot be copied, but its number can, and otherwise its text.
        let own = error
            .raw_os_error()
            .map_or_else(|| io::Error::new(error.kind(), error.to_string()), io::Error::from_raw_os_error);
        Self::host(subject, own, format!("{what}: {}", reason(error)))
    }

    /// An error of the host, such as a file, a folder or a mount, with its remedy.
    pub fn host(subject: impl Into<String>, error: impl Into<io::Error>, text: impl Into<String>) -> Self {
        let error = error.into();
        let mut failed = Self::new(subject, Cause::Io(error.kind()), text.into());
        failed.0.host = Some(Host(Arc::new(error)));
        failed
    }

    /// Notes the facts of the process that refused the request: a JSON object.
    #[must_use]
    pub fn reporting(mut self, facts: impl Into<Box<str>>) -> Self {
        self.0.reported = Some(facts.into());
        self
    }

    /// Adds further mistakes in the same file.
    #[must_use]
    pub fn and(mut self, further: impl IntoIterator<Item = Self>) -> Self {
        self.0.further.extend(further);
        self
    }

    #[must_use]
    pub(crate) fn of_register(mut self) -> Self {
        self.0.register = Some(self.0.subject.clone());
        self
    }

    /// Notes its place in data flash, unless that is known already.
    #[must_use]
    pub fn at_place(mut self, place: (u8, u16)) -> Self {
        self.0.place.get_or_insert(place);
        self
    }

    /// Notes whether it concerns what is owed, unless that is known already.
    #[must_use]
    pub fn owing(mut self, owed: bool) -> Self {
        self.0.owed |= owed;
        self
    }

    /// Adds the step in which it happened, unless one is known already.
    #[must_use]
    pub fn at(mut self, step: Step) -> Self {
        self.0.step.get_or_insert(step);
        self
    }

    /// Replaces the subject, for a caller that knows the parameter's name.
    #[must_use]
    pub fn about(mut self, subject: impl Into<String>) -> Self {
        self.0.subject = subject.into();
        self
    }

    /// Puts a larger subject in front: the parameter whose transaction failed.
    #[must_use]
    pub fn within(mut self, subject: &str) -> Self {
        if self.0.subject.is_empty() {
            self.0.subject = subject.to_string();
        } else if !subject.is_empty() && self.0.subject != subject {
            self.0.subject = format!("{subject}: {}", self.0.subject);
        }
        self.0.further = self.0.further.into_iter().map(|further| further.within(subject)).collect();
        self
    }

    /// The kind of failure.
    pub fn cause(&self) -> Cause {
        self.0.reason.row().1
    }

    /// The errno for a file operation: the host's own, or the cause's.
    pub fn errno(&self) -> i32 {
        self.0.host.as_ref().and_then(|host| host.0.raw_os_error()).unwrap_or_else(|| self.cause().errno())
    }

    /// The reason. Its text is the line without subject and step.
    pub fn reason(&self) -> &Reason {
        &self.0.reason
    }

    /// The failed step, if there is one.
    pub fn step(&self) -> Option<Step> {
        self.0.step
    }

    /// Whether the access has left something to do, or was refused because an earlier one did.
    pub fn is_owed(&self) -> bool {
        self.0.owed
    }

    /// All lines for a person: the error itself, and further mistakes in the same file.
    pub fn lines(&self) -> impl Iterator<Item = String> {
        std::iter::once(self).chain(&self.0.further).map(Self::to_string)
    }

    /// The facts of the process that refused the request: a JSON object.
    pub fn reported(&self) -> Option<&str> {
        self.0.reported.as_deref()
    }

    /// The facts by names for programs.
    pub fn facts(&self) -> Vec<(&'static str, Fact)> {
        let Inner { step, reason, register, place, owed, .. } = &*self.0;
        let (name, cause, own, _) = reason.row();
        let more = [
            ("cause", cause.name().fact()),
            ("step", step.map(Step::as_str).fact()),
            ("reason", name.fact()),
            ("register", register.fact()),
            ("place", place.map(Fact::Place)),
            ("owed", owed.fact()),
        ];
        more.into_iter().filter_map(|(name, fact)| Some((name, fact?))).chain(own).collect()
    }
}

/// One line without control characters: other users choose names of files and processes.
impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Inner { subject, step, reason, .. } = &*self.0;
        let step = step.map_or("", Step::as_str);
        let mut line = String::new();
        for head in [subject, step].into_iter().filter(|head| !head.is_empty()) {
            line += head;
            line += ": ";
        }
        line += &reason.to_string();
        f.write_str(&text::printable(&line))
    }
}

/// The line of `Display`: `main` prints the error that it returns in this way.
impl fmt::Debug for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl error::Error for Error {
    fn source(&self) -> Option<&(dyn error::Error + 'static)> {
        match (&self.0.host, &self.0.reason) {
            (Some(host), _) => Some(&*host.0),
            (None, Reason::Bus(bus)) => Some(bus),
            (None, reason) => reason.row().3.map(|failed| failed as _),
        }
    }
}

impl From<BusError> for Error {
    fn from(bus: BusError) -> Self {
        Self::bus("", bus)
    }
}

impl From<gauge_bus::Error> for Error {
    fn from(error: gauge_bus::Error) -> Self {
        let gauge_bus::Error { subject, kind, text, driver } = error;
        if let Some(Driver { name, device, .. }) = driver.map(|driver| *driver) {
            return Self::of(subject, Reason::DriverBound { driver: name, device, what: text });
        }
        let cause = match kind {
            ErrorKind::Invalid => Cause::Invalid,
            ErrorKind::OutOfRange => Cause::OutOfRange,
            ErrorKind::NotPermitted => Cause::NotPermitted,
            ErrorKind::File(kind) => Cause::Io(kind),
            kind => Cause::Adapter(kind),
        };
        Self::new(subject, cause, text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_subject_that_is_empty_leaves_no_colon() {
        let error = Error::new("Cell Terminate Voltage", Cause::Invalid, "x");
        assert_eq!(error.clone().within("").to_string(), "Cell Terminate Voltage: x");
        assert_eq!(error.clone().within("line 3").to_string(), "line 3: Cell Terminate Voltage: x");
        assert_eq!(Error::new("", Cause::Invalid, "x").within("").to_string(), "x");
    }

    #[test]
    fn an_error_is_one_line_without_control_characters() {
        let error = Error::new("/tmp/a\nb", Cause::Busy, "process 1 (\x1b]0;x\x07)\nwarning: forged");
        assert_eq!(error.to_string(), r"/tmp/a\nb: process 1 (\u{1b}]0;x\u{7})\nwarning: forged");
        let then = Error::of("", Reason::NotSettled { failed: error.clone() });
        assert_eq!(then.to_string(), format!("{error}: data flash contents unknown"));
    }

    #[test]
    fn an_error_has_the_further_mistakes_of_its_file() {
        let at = |line: u32| Error::new(format!("line {line}"), Cause::Invalid, "x\n");
        let error = at(1).and([at(2), at(3)]).within("a.toml");
        assert_eq!(error.to_string(), r"a.toml: line 1: x\n");
        let lines: Vec<_> = error.lines().collect();
        assert_eq!(lines, [1, 2, 3].map(|line| format!(r"a.toml: line {line}: x\n")));
    }

    /// The simulator's kinds are causes; the others say why a bus cannot be opened.
    #[test]
    fn a_kind_of_the_bus_has_a_cause() {
        let cause = |kind| Error::from(gauge_bus::Error::new("soc", kind, "x")).cause();
        assert_eq!(cause(ErrorKind::Invalid), Cause::Invalid);
        assert_eq!(cause(ErrorKind::OutOfRange), Cause::OutOfRange);
        assert_eq!(cause(ErrorKind::NotPermitted), Cause::NotPermitted);
        let denied = io::ErrorKind::PermissionDenied;
        assert_eq!(cause(ErrorKind::File(denied)), Cause::Io(denied));
        assert_eq!(cause(ErrorKind::Io(denied)), Cause::Adapter(ErrorKind::Io(denied)));
        for kind in
            [ErrorKind::Invalid, ErrorKind::OutOfRange, ErrorKind::NotPermitted, ErrorKind::File(denied)]
        {
            assert_eq!(cause(kind).errno(), kind.errno());
        }
    }

    #[test]
    fn an_error_has_facts() {
        let why = Reason::OutOfRange { least: "1000".into(), greatest: "3700".into(), unit: "mV" };
        let error = Error::of("Cell Terminate Voltage", why).at(Step::Check).at_place((80, 53));
        assert_eq!(error.to_string(), "Cell Terminate Voltage: check: the value is outside 1000 to 3700 mV");
        assert_eq!(error.errno(), Errno::RANGE.raw_os_error());
        let facts = [
            ("cause", Fact::Text("out-of-range".into())),
            ("step", Fact::Text("check".into())),
            ("reason", Fact::Text("out-of-range".into())),
            ("place", Fact::Place((80, 53))),
            ("least", Fact::Text("1000".into())),
            ("greatest", Fact::Text("3700".into())),
            ("unit", Fact::Text("mV".into())),
        ];
        assert_eq!(error.facts(), facts);
    }

    #[test]
    fn what_is_not_known_is_no_fact() {
        let in_use = |process| Reason::InUse { process, mountpoint: None, what: "in use".into() };
        let named = |process| {
            let facts = Error::of("i2c-1", in_use(process)).facts();
            facts.into_iter().map(|(name, _)| name).collect::<Vec<_>>()
        };
        assert_eq!(named(Some(12)), ["cause", "reason", "process"]);
        assert_eq!(named(None), ["cause", "reason"]);
        let owed = |decision| Error::of("", Reason::Owed { decision, what: String::new() }).facts().len();
        assert_eq!((owed(true), owed(false)), (3, 2));
    }

    #[test]
    fn a_bound_driver_is_a_fact() {
        let driver = Driver { name: "bq27xxx-battery".into(), device: "bq34z100".into(), bus: 1 };
        let text = "unbind it".to_string();
        let kind = ErrorKind::Busy;
        let error = gauge_bus::Error { subject: "i2c-1".into(), kind, text, driver: Some(Box::new(driver)) };
        let error = Error::from(error);
        assert_eq!(
            (error.to_string(), error.errno()),
            ("i2c-1: unbind it".into(), Errno::BUSY.raw_os_error())
        );
        let driver = error.facts().into_iter().find(|(name, _)| *name == "driver");
        assert_eq!(driver, Some(("driver", Fact::Text("bq27xxx-battery".into()))));
    }

    #[test]
    fn an_error_has_its_source() {
        use std::error::Error as _;
        let bus = Error::bus("Voltage()", BusError::NoAck);
        assert_eq!(bus.source().expect("the bus").downcast_ref(), Some(&BusError::NoAck));
        let full = io::Error::from_raw_os_error(28);
        let host = Error::io("/tmp/x", "cannot be written", &full);
        let source = host.source().expect("the host").downcast_ref::<io::Error>().expect("its error");
        assert_eq!((source.raw_os_error(), host.errno()), (Some(28), 28));
        assert!(Error::new("seal", Cause::Invalid, "x").source().is_none());
        let undone = Error::of("", Reason::RolledBack { failed: bus.clone(), what: "undone".into() });
        assert_eq!(undone.source().expect("what failed").downcast_ref(), Some(&bus));
        assert_eq!(undone.to_string(), format!("{bus}; undone"));
    }
}
