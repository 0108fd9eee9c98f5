// SPDX-License-Identifier: MIT

//! The folder of a mounted gauge.

use std::fmt;
use std::fs;
use std::path::{Component, Path, PathBuf};
use std::sync::mpsc;

use gauge_bus::regular;
use nix::errno::Errno;
use ti_gauge::chip::{CHIPS, Chip, Kind, Row, Source, snake_case};
use ti_gauge::dataflash::Place;
use ti_gauge::error::Cause;
use ti_gauge::image::{Difference, Entry, Image, LeftOut, RawDifference};
use ti_gauge::text;

use crate::asked::{Name, TRIES};
use crate::error::{Error, Result};
use crate::file::{self, GaugeFile, LONGEST, OWED, is_dead, is_set};
use crate::hang;
use crate::mounts;
use crate::names;
use crate::place::{self, EVERY, last_name, not_a_gauge, shown, with_path};
use crate::sample::Sample;
use crate::value::Value;
use ti_gauge::notation;

/// A mounted gauge, by its folder.
///
/// If the daemon hangs, so does each method: a program that must go on uses [`within`](crate::within), or
/// [`follow`](Self::follow) and [`Watch`](crate::watch::Watch), which have threads of their own.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Gauge {
    folder: PathBuf,
}

/// A person's decision about an interrupted write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// Write the old values.
    Undo,
    /// Write the new values.
    Finish,
    /// Leave data flash as it is; the journal is kept under another name.
    Discard,
}

impl Gauge {
    /// The gauge at a path: its folder, a mount point with one gauge, or a name such as `BAT0` of only one gauge.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = &Self::named(path.as_ref())?;
        let Err(error) = fs::metadata(path.join(EVERY)) else { return Ok(Self::of(path)) };
        if is_dead(&error) {
            return Err(not_a_gauge(path));
        }
        match &Self::below(path)[..] {
            [] if [Errno::ENOENT, Errno::ENOTDIR]
                .contains(&Errno::from_raw(error.raw_os_error().unwrap_or(0))) =>
            {
                Err(not_a_gauge(path))
            }
            [] => Err(Error::io(path.display().to_string(), "cannot be examined", error)),
            [gauge] => Ok(gauge.clone()),
            several => {
                let names: Vec<_> = several.iter().map(|gauge| shown(&gauge.folder)).collect();
                let why = format!("{} gauges are mounted there; name one: {}", names.len(), names.join(", "));
                Err(invalid(path.display().to_string(), why).into())
            }
        }
    }

    /// The folder of a gauge named without a path. Any other path, an existing file and an unknown name stay.
    pub fn named(path: &Path) -> Result<PathBuf> {
        let mut parts = path.components();
        let is_name = matches!((parts.next(), parts.next()), (Some(Component::Normal(_)), None));
        let file = path.to_path_buf();
        // The current folder may be in a mount that hangs.
        let is_there =
            || hang::within(hang::PATIENCE, move || file.symlink_metadata().is_ok()).unwrap_or(true);
        if !is_name || is_there() {
            return Ok(path.into());
        }
        let mut found: Vec<PathBuf> = Self::find()?.into_iter().map(|gauge| gauge.folder).collect();
        found.retain(|folder| folder.file_name() == path.file_name());
        match &*found {
            [] => Ok(path.into()),
            [one] => Ok(one.clone()),
            several => {
                let several: Vec<_> = several.iter().map(|folder| shown(folder)).collect();
                let why = format!("several gauges have that name; write one of {}", several.join(", "));
                Err(invalid(path.display().to_string(), why).into())
            }
        }
    }

    /// All mounted gauges in mounts that this user may read and whose daemons answer in time.
    pub fn find() -> Result<Vec<Self>> {
        let (sender, found) = mpsc::channel();
        let mounts = mounts::list();
        for mount in mounts {
            let sender = sender.clone();
            hang::thread(move || {
                // After some seconds nobody receives it.
                let _ = sender.send(Self::below(&mount));
            })?;
        }
        drop(sender);
        let mut gauges = Vec::new();
        while let Ok(below) = found.recv_timeout(hang::PATIENCE) {
            gauges.extend(below);
        }
        gauges.sort_by(|one: &Self, other| one.folder.cmp(&other.folder));
        gauges.dedup();
        Ok(gauges)
    }

    /// The gauges below a mount point.
    pub fn below(mountpoint: &Path) -> Vec<Self> {
        place::gauges_below(mountpoint).unwrap_or_default().iter().map(|folder| Self::of(folder)).collect()
    }

    /// Whether a path is a mounted gauge's folder.
    pub fn is_at(path: &Path) -> bool {
        place::is_gauge(path)
    }

    pub(crate) fn of(folder: &Path) -> Self {
        Self { folder: folder.into() }
    }

    /// Folder of the gauge.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The name of its folder, with symbolic links resolved.
    pub fn name(&self) -> String {
        folder_name(&self.folder)
    }

    /// Text of a file in the folder, such as `status` or `gauge/flags`.
    pub fn text(&self, file: &str) -> Result<String> {
        file::text(&self.folder, file)
    }

    /// Value of an attribute such as `voltage_now`, or of a file such as `gauge/registers/voltage`, with its unit.
    pub fn value(&self, file: &str) -> Result<Value> {
        let own = || match file.strip_prefix("gauge/registers/") {
            // Parts differ in a register's unit.
            Some(name) => {
                let register = |chip: &Chip| chip.registers.iter().find(|row| snake_case(row.name) == name);
                self.chip().ok().and_then(register).map_or("", |row| row.unit)
            }
            None => names::unit(file).unwrap_or(""),
        };
        let text = self.text(file).map_err(|error| error.doing("cannot be read"))?;
        Ok(Value { text: text.trim_end().into(), unit: own() })
    }

    /// All values of one poll. Right after a poll it waits a fraction of a second first.
    pub fn sample(&self) -> Result<Sample> {
        Sample::read(&self.folder).map_err(|error| match is_dead(&error) {
            true => not_a_gauge(&self.folder),
            false => Error::io(self.folder.display().to_string(), "cannot be read", error),
        })
    }

    /// The interrupted write that waits for a decision, with its values; the daemon first tries to settle it.
    pub fn unsettled(&self) -> Result<Option<String>> {
        self.examine().map(|(told, owed)| Some(told).filter(|_| owed))
    }

    /// A description of interrupted writes, and whether something is owed.
    pub fn examine(&self) -> Result<(String, bool)> {
        let told = self.settling("show")?;
        let owed = self.text(OWED).map_err(|error| error.doing("cannot read whether anything is owed"))?;
        Ok((told, is_set(&owed)))
    }

    /// The last failure, after what is owed; empty without one.
    pub fn last_error(&self) -> Result<String> {
        Ok(with_path(self.text(EVERY)?.trim(), &self.folder))
    }

    /// Carries out a decision about what [`unsettled`](Self::unsettled) has shown, and returns what was done. `serial` is
    /// the present pack's serial number, if the write was begun on another pack.
    pub fn settle(&self, decision: Decision, serial: Option<&str>) -> Result<String> {
        let word = match decision {
            Decision::Undo => "undo",
            Decision::Finish => "finish",
            Decision::Discard => "discard",
        };
        self.settling(&serial.map_or(word.to_string(), |serial| format!("{word} {serial}")))
    }

    fn settling(&self, word: &str) -> Result<String> {
        const FILE: &str = "gauge/settle";
        self.check_has(FILE, "data flash")?;
        let told = self.answered(FILE, word, ["cannot be settled", "cannot read what is to settle"])?;
        Ok(with_path(&told, &self.folder))
    }

    /// What the daemon keeps of the gauge's learned values, after `show`, `restore`, `restore VERSION` or `forget`.
    pub fn learned(&self, wish: &str) -> Result<String> {
        const FILE: &str = "gauge/learned";
        self.check_has(FILE, "data memory in RAM")?;
        self.answered(FILE, wish, ["cannot be done", "cannot read what was learned"])
    }

    /// Writes a request, and reads its answer. Only `show` is repeated if the answer is another request's.
    fn answered(&self, file: &str, request: &str, failed: [&'static str; 2]) -> Result<String> {
        for _ in 0..TRIES {
            let name = Name::draw();
            self.send(file, name.on(request).as_bytes()).map_err(|error| error.doing(failed[0]))?;
            let text = self.text(file).map_err(|error| error.doing(failed[1]))?;
            if let Some(answer) = name.answer(&text) {
                return Ok(answer.into());
            }
            if request != "show" {
                break;
            }
            name.pause();
        }
        let what = if request == "show" { "" } else { "done, but " };
        Err(self.answers_another(file, what))
    }

    fn answers_another(&self, file: &str, what: &str) -> Error {
        let why = format!(
            "{what}it has the answer to another program, which writes it at the same time; look again later"
        );
        ti_gauge::error::Error::new(self.folder.join(file).display().to_string(), Cause::Busy, why).into()
    }

    /// Whether something is owed: a seal, or a write that is neither done nor undone.
    pub fn is_owed(&self) -> bool {
        self.text(OWED).is_ok_and(|owed| is_set(&owed))
    }

    /// Writes a request to a file of the folder, and waits for the outcome.
    pub fn send(&self, file: &str, request: &[u8]) -> Result<()> {
        file::send(&self.folder, file, request)
    }

    /// Opens a file of the folder for several requests.
    pub fn open_to_write(&self, file: &str) -> Result<GaugeFile> {
        GaugeFile::to_write(&self.folder, file)
    }

    /// Fails unless it is a gauge whose part has this file; a part without it has no `what`.
    pub fn check_has(&self, file: &str, what: &str) -> Result<()> {
        match fs::symlink_metadata(self.folder.join(file)) {
            Ok(_) => Ok(()),
            Err(_) if !self.folder.join("uevent").exists() => Err(not_a_gauge(&self.folder)),
            Err(_) if self.is_smart_battery() => {
                let why = "a Smart Battery is only read, as its folder shows it";
                Err(Error::host(self.folder.display().to_string(), Errno::EPERM, why))
            }
            Err(_) => {
                let why =
                    format!("gaugefs knows no {what} of this part; `gaugefs chips` lists what works on each");
                Err(Error::host(self.folder.display().to_string(), Errno::ENOENT, why))
            }
        }
    }

    /// The gauge's part, without a transfer. An error if its data flash is unknown.
    pub fn chip(&self) -> Result<&'static Chip> {
        self.check_has("df/index", "data flash")?;
        self.part()
    }

    fn part(&self) -> Result<&'static Chip> {
        let model = self.text("model_name").map_err(|error| error.doing("its part is unknown"))?;
        Ok(CHIPS.iter().copied().find(|chip| chip.model == model.trim()).ok_or_else(|| {
            let why = format!("no gauge that gaugefs knows: {}", model.trim());
            self.within(ti_gauge::error::Error::new("model_name", Cause::Gone, why))
        })?)
    }

    fn within(&self, error: ti_gauge::error::Error) -> ti_gauge::error::Error {
        error.within(&self.folder.display().to_string())
    }

    /// Polls now, and drops cached data flash. A user who may not poll gets the values of the last poll, and their age.
    pub fn poll(&self) -> Result<Polled> {
        let refused = match self.send("gauge/refresh", b"1\n") {
            Ok(()) => None,
            Err(error) if error.is_unopened() && error.is(&[Errno::ENOENT, Errno::ENOTDIR]) => {
                return Err(not_a_gauge(&self.folder));
            }
            Err(error) if error.is_unopened() && error.is(&[Errno::EACCES, Errno::EPERM, Errno::EROFS]) => {
                error.errno()
            }
            Err(error) => return Err(error.doing("gauge/refresh: the gauge cannot be polled")),
        };
        Ok(Polled { identity: self.identity(), refused })
    }

    /// Whether it is a Smart Battery, which alone has this file.
    pub fn is_smart_battery(&self) -> bool {
        self.folder.join("gauge/pec").exists()
    }

    /// The part, and the serial number of parts that show one, without a transfer.
    pub fn pack(&self) -> (Option<String>, Option<String>) {
        let model = self.text("model_name").ok().map(|model| model.trim().to_string());
        (model, self.serial())
    }

    fn serial(&self) -> Option<String> {
        Some(names::serial(&self.text("serial_number").ok()?))
    }

    fn identity(&self) -> String {
        let text = |name: &str| Some(self.text(name).ok()?.trim().to_string());
        let model = text("model_name").unwrap_or("unknown part".into());
        let chem_id = || {
            let pack = self.part().ok()?.preflight.pack.as_ref()?;
            let is_answer = matches!(pack.word, Source::Answer(_));
            Some(format!("{} {}", pack.name, text("gauge/chem_id").filter(|_| is_answer)?))
        };
        let pack = self.serial().map(|serial| format!("SerialNumber() {serial}")).or_else(chem_id);
        let pack = pack.unwrap_or("no serial number".into());
        let age = text("gauge/age_ms").and_then(|age| age.parse::<f64>().ok());
        let age = age.map_or("age unknown".into(), |age| format!("polled {:.1} s ago", age / 1000.0));
        format!("{model}, {pack}, {age}")
    }

    /// The values of some parameters.
    pub fn values(&self, chip: &'static Chip, rows: &[Row]) -> Result<Image> {
        let mut image = Image::new(chip, None);
        for &row in rows {
            let name = chip.name_of(row);
            let (subclass, parameter) = row;
            if subclass.kind == Kind::Security {
                let why = "keys are never read";
                return Err(ti_gauge::error::Error::new(name, Cause::NotPermitted, why).into());
            }
            let read = self.text(&format!("df/by-name/{name}"));
            let text = read.map_err(|error| error.doing(format!("{name} cannot be read")))?;
            let value = notation::parse_stored(parameter, text.as_bytes())?;
            image.entries.push(Entry { subclass, parameter, value, line: 0 });
        }
        Ok(image)
    }

    /// All parameters, from `df/index`. After [`poll`](Self::poll) they are read anew.
    pub fn configuration(&self) -> Result<Image> {
        let chip = self.chip()?;
        let index = self.text("df/index").map_err(|error| error.doing("its data flash cannot be read"))?;
        let firmware = self.text("gauge/firmware_version").ok().and_then(|text| word(text.trim()));
        Ok(read(chip, firmware, &index).map_err(|error| self.within(error))?)
    }

    /// All bytes of a subclass.
    pub fn raw(&self, id: u8) -> ti_gauge::error::Result<Vec<u8>> {
        let file = self.folder.join(format!("df/{id}/raw"));
        regular::read(&file, LONGEST)
            .map_err(|error| ti_gauge::error::Error::io(file.display().to_string(), "cannot be read", &error))
    }

    /// The word with which the gauge answers a subcommand.
    pub fn ask(&self, code: u16) -> Result<u16> {
        let file = "gauge/control";
        let failed = |error: Error| error.doing("the gauge does not answer the subcommand");
        for _ in 0..TRIES {
            self.send(file, format!("0x{code:04x}").as_bytes()).map_err(failed)?;
            let text = self.text(file).map_err(failed)?;
            let answer = text.split_once(' ').filter(|(asked, _)| word(asked) == Some(code));
            if let Some(answer) = answer.and_then(|(_, answer)| word(answer.trim())) {
                return Ok(answer);
            }
            Name::draw().pause();
        }
        Err(self.answers_another(file, ""))
    }

    /// The gauge that is present. Later readings belong to it as long as this does not change.
    pub fn presence(&self) -> Result<Presence> {
        let text = self.text("gauge/presence")?;
        Ok(Presence(text.trim().to_string()))
    }

    /// Writes changes in one transaction, all of them or none, to the gauge for which they were found.
    pub fn apply(
        &self,
        presence: &Presence,
        changes: &[Difference<'_>],
        raw: &[RawDifference],
    ) -> Result<()> {
        if changes.is_empty() && raw.is_empty() {
            if self.presence()? == *presence {
                return Ok(());
            }
            let why = "it has been away or is another gauge since its values were read; nothing was written, try again";
            return Err(ti_gauge::error::Error::new(self.name(), Cause::Gone, why).into());
        }
        let mut lines = format!("begin {}\n", presence.0);
        for Difference { new, .. } in changes {
            lines += &format!("{} {}\n", Place::of((new.subclass, new.parameter)), new.text());
        }
        for RawDifference { new, .. } in raw {
            lines += &format!("{} {}\n", new.name(), new.text());
        }
        lines += "commit\n";
        let failed = |error: Error| error.doing("nothing was written");
        let mut file = self.open_to_write("df/transaction").map_err(failed)?;
        // A refused write is refused as a whole, and leaves no transaction open.
        let mut sent = 0;
        while sent < lines.len() {
            sent += file.send(&lines.as_bytes()[sent..]).map_err(|error| {
                if sent > 0 {
                    // The first piece has opened it; a failed commit has ended it.
                    let _ = file.send(b"abort\n");
                }
                failed(error)
            })?;
        }
        Ok(())
    }
}

/// The present gauge, for [`Gauge::apply`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Presence(String);

/// The gauge that a poll has shown, and the poll's time.
#[derive(Clone, Debug)]
pub struct Polled {
    identity: String,
    refused: Option<i32>,
}

impl Polled {
    /// The errno, if this user may not poll.
    pub fn refused(&self) -> Option<i32> {
        self.refused
    }
}

impl fmt::Display for Polled {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.identity)?;
        let Some(errno) = self.refused else { return Ok(()) };
        let desc = Errno::from_raw(errno).desc();
        write!(f, "; not polled now, and values may be as old: gauge/refresh: {desc}")
    }
}

/// The name of a folder, with symbolic links resolved.
pub fn folder_name(gauge: &Path) -> String {
    let whole = fs::canonicalize(gauge).unwrap_or_else(|_| gauge.to_path_buf());
    last_name(&whole)
}

fn invalid(subject: String, why: String) -> ti_gauge::error::Error {
    ti_gauge::error::Error::new(subject, Cause::Invalid, why)
}

fn at_line(line: usize, why: &str) -> ti_gauge::error::Error {
    invalid(format!("df/index: line {line}"), why.into())
}

fn word(text: &str) -> Option<u16> {
    text.starts_with("0x").then(|| text::unsigned(text)).flatten()
}

fn read(chip: &'static Chip, firmware: Option<u16>, index: &str) -> ti_gauge::error::Result<Image> {
    let mut image = Image::new(chip, firmware);
    for (number, line) in (1..).zip(index.lines()).skip(1) {
        let fields: Vec<&str> = line.split('\t').collect();
        let [id, offset, .., value] = fields.as_slice() else {
            return Err(at_line(number, "not a line of df/index"));
        };
        let row = chip.row(id, offset);
        let (subclass, parameter) = row.ok_or_else(|| at_line(number, "not in the table"))?;
        if subclass.kind == Kind::Security {
            continue;
        }
        if *value == "-" {
            let text = format!("{}: the gauge does not show its value", parameter.name);
            image.left_out.push(LeftOut { text, group: None });
            continue;
        }
        let value = notation::parse_stored(parameter, value.as_bytes())?;
        image.entries.push(Entry { subclass, parameter, value, line: 0 });
    }
    if image.entries.is_empty() {
        let why = "its data flash cannot be read: it is sealed and no key works; mount with --key-file";
        return Err(ti_gauge::error::Error::new("", Cause::NotPermitted, why));
    }
    Ok(image)
}
