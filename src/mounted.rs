//! A configuration through the files of a mounted gauge: read from `df/index`, written through `df/transaction`.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use gauge_bus::regular;
use nix::errno::Errno;
use ti_gauge::chip::{CHIPS, Chip, Kind, Row, Word, snake_case};
use ti_gauge::dataflash::Place;
use ti_gauge::image::{self, Difference, Entry, Faults, Image, LeftOut, RawDifference, Reading};
use ti_gauge::text;

use crate::daemon::mountpoint;
use crate::error::{Cause, Error, Result, shown};
use crate::output::say;
use ti_gauge::notation;

mod file;

pub(crate) use file::{Failure, GaugeFile, KEYS, LONGEST, content, send, text};

/// Error for a path that is not a mounted gauge.
const NO_GAUGE: &str = "not a mounted gauge";

/// The error about a path that is not the folder of a mounted gauge: what it is, and which path to give.
pub(crate) fn not_a_gauge(path: &Path) -> Error {
    let why = match mountpoint::of(path) {
        Some(mount) if mountpoint::is_dead(&mount) => {
            let mount = shown(&mount);
            return Error::host(path.display().to_string(), Errno::ENOTCONN, died(&mount));
        }
        Some(mount) => {
            let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
            let inside =
                || whole.ancestors().skip(1).filter(|above| above.starts_with(&mount)).map(Path::to_path_buf);
            let what = if whole == mount { "the mount point of" } else { "inside the mount of" };
            match inside().find(|path| is_gauge(path)).or_else(|| gauges(&mount).into_iter().next()) {
                Some(gauge) => {
                    format!("it is {what} gauges; give the folder of one, such as {}", shown(&gauge))
                }
                None => format!("the mount at {} shows none that may be read", shown(&mount)),
            }
        }
        None if path.is_file() => "it is a file; give the folder of one, such as /run/gauges/BAT0".into(),
        None => {
            const SHOWN: usize = 3;
            let is_there = if path.exists() { "no gaugefs is mounted there" } else { "it does not exist" };
            let places: Vec<String> = mountpoint::list().iter().map(|place| shown(place)).collect();
            match &*places {
                [] => format!("{is_there}, nor is one mounted anywhere; mount a gauge with: gaugefs mount"),
                [first, ..] => {
                    let some = places.iter().take(SHOWN).map(String::as_str).collect::<Vec<_>>().join(", ");
                    let more = match places.len().saturating_sub(SHOWN) {
                        0 => String::new(),
                        more => format!(" and {more} more places"),
                    };
                    format!(
                        "{is_there}; gauges are mounted at {some}{more}: give the folder of one, such as {first}/BAT0"
                    )
                }
            }
        }
    };
    Error::host(path.display().to_string(), Errno::ENOENT, format!("{NO_GAUGE}: {why}"))
}

/// What to do about a mount whose daemon is gone.
pub(crate) fn died(mount: impl std::fmt::Display) -> String {
    format!("its daemon has died; remove the mount with: gaugefs umount {mount}")
}

/// Makes sure that a path is the folder of a gauge, and that its part has a file, without which it has no `what`.
pub(crate) fn has(gauge: &Path, file: &str, what: &str) -> Result<()> {
    match fs::symlink_metadata(gauge.join(file)) {
        Ok(_) => Ok(()),
        Err(_) if !gauge.join("uevent").exists() => Err(not_a_gauge(gauge)),
        Err(_) => {
            let why =
                format!("gaugefs knows no {what} of this part; `gaugefs chips` lists what works on each");
            Err(Error::host(gauge.display().to_string(), Errno::ENOENT, why))
        }
    }
}

/// What stands for standard input in place of a file.
const STANDARD_INPUT: &str = "-";

/// The folder of a mounted gauge: the path itself, or that of the only gauge below a mount point.
pub(crate) fn gauge(path: &Path) -> Result<PathBuf> {
    match fs::metadata(path.join(EVERY)).err().and_then(|error| error.raw_os_error()).map(Errno::from_raw) {
        None => return Ok(path.to_path_buf()),
        Some(Errno::ENOTCONN | Errno::ECONNABORTED) => return Err(not_a_gauge(path)),
        Some(_) => {}
    }
    match &gauges(path)[..] {
        // Whoever reads its files says what is wrong with it.
        [] => Ok(path.to_path_buf()),
        [gauge] => Ok(gauge.clone()),
        several => {
            let names: Vec<_> = several.iter().map(|gauge| shown(gauge)).collect();
            let why = format!("{} gauges are mounted there; name one: {}", names.len(), names.join(", "));
            Err(Error::new(path.display().to_string(), Cause::Invalid(why)))
        }
    }
}

/// A file that every mounted gauge has, and no supply of the kernel's.
const EVERY: &str = "gauge/last_error";

/// The gauges below a mount point.
pub(crate) fn gauges(mountpoint: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(mountpoint).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut gauges: Vec<_> = entries.filter(|entry| is_gauge(entry)).collect();
    gauges.sort();
    gauges
}

/// Whether it is the folder of a mounted gauge.
pub(crate) fn is_gauge(path: &Path) -> bool {
    path.join(EVERY).exists()
}

/// A configuration file, read once for any number of gauges.
pub(crate) struct Source {
    /// What to call it in messages.
    pub(crate) name: String,
    pub(crate) bytes: Vec<u8>,
}

impl Source {
    /// Reads a file, or standard input where the path is `-`.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        Self::of(name(path), read_file(path, image::LONGEST))
    }

    fn of(name: String, bytes: io::Result<Vec<u8>>) -> Result<Self> {
        let bytes = bytes.map_err(|error| Error::io(&name, "cannot be read", &error))?;
        Ok(Self { name, bytes })
    }

    /// What is in it. `chip` is what it is for where it does not say so itself. An image that holds firmware as well is
    /// refused, unless only its data flash is asked for.
    pub(crate) fn image(&self, chip: Option<&'static Chip>, data_flash: bool) -> Result<Image> {
        let reading = self.examine(chip, data_flash);
        match Error::of_file(&reading.faults) {
            Some(error) => Err(error.within(&self.name)),
            None => Ok(reading.whole()?),
        }
    }

    /// Reads what is in it as far as it goes, and lists all mistakes.
    pub(crate) fn examine(&self, chip: Option<&'static Chip>, data_flash: bool) -> Reading {
        let mut reading = Image::examine(&self.name, &self.bytes, chip);
        if let Some(Err(error)) = reading.image.as_ref().map(|image| image.check_firmware(data_flash)) {
            let line = reading.image.as_ref().and_then(|image| image.firmware_line);
            reading.faults.add(line.unwrap_or(0), error);
        }
        reading
    }
}

/// Reads a mounted gauge as it is now, or a file of any format, as [`Source::image`] does.
pub(crate) fn open(path: &Path, chip: Option<&'static Chip>, data_flash: bool) -> Result<Image> {
    if is_mounted(path) { whole(path) } else { Source::read(path)?.image(chip, data_flash) }
}

/// Reads a mounted gauge or a file as far as it goes, and lists all mistakes.
pub(crate) fn examine(path: &Path, chip: Option<&'static Chip>, data_flash: bool) -> Result<Reading> {
    match is_mounted(path) {
        true => now(path).map(|image| Reading { image: Some(image), faults: Faults::default() }),
        false => Ok(Source::read(path)?.examine(chip, data_flash)),
    }
}

/// The bytes of a file, or of standard input where the path is `-`.
pub(crate) fn read_file(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    match path == Path::new(STANDARD_INPUT) {
        true => regular::read_from(io::stdin().lock(), limit),
        false => regular::read(path, limit),
    }
}

/// What to call a file in messages.
pub(crate) fn name(path: &Path) -> String {
    match path == Path::new(STANDARD_INPUT) {
        true => "standard input".into(),
        false => path.display().to_string(),
    }
}

fn is_mounted(path: &Path) -> bool {
    path.is_dir() || mountpoint::of(path).is_some()
}

/// Reads a mounted gauge with the bytes of subclasses without parameters, such as a chemistry.
pub(crate) fn whole(gauge: &Path) -> Result<Image> {
    let mut image = now(gauge)?;
    image.add_opaque(|id| raw_of(gauge, id))?;
    Ok(image)
}

/// The chip of a mounted gauge, without reading its data flash.
pub(crate) fn chip(gauge: &Path) -> Result<&'static Chip> {
    has(gauge, "df/index", "data flash")?;
    part(gauge)
}

/// Polls a mounted gauge and reads its configuration anew.
pub(crate) fn now(gauge: &Path) -> Result<Image> {
    poll(gauge)?;
    let chip = chip(gauge)?;
    let index = text(gauge, "df/index").map_err(|failure| failure.told("its data flash cannot be read"))?;
    read(gauge, chip, &index).map_err(|error| error.within(&gauge.display().to_string()))
}

/// Polls a mounted gauge, drops the values that were kept of its data flash, and prints on standard error which
/// gauge it is: another pack may have taken the place of the one that was there at the last poll. A user who may
/// not do that gets the values of the last poll, and their age.
pub(crate) fn poll(gauge: &Path) -> Result<()> {
    let why = match send(gauge, "gauge/refresh", b"1\n") {
        Ok(()) => String::new(),
        Err(failure) => match failure.errno().filter(|_| failure.is_own()) {
            Some(Errno::ENOENT | Errno::ENOTDIR | Errno::ENOTCONN | Errno::ECONNABORTED) => {
                return Err(not_a_gauge(gauge));
            }
            Some(errno @ (Errno::EACCES | Errno::EPERM | Errno::EROFS)) => {
                format!("; not polled now, and values may be as old: gauge/refresh: {}", errno.desc())
            }
            _ => return Err(failure.told("gauge/refresh: the gauge cannot be polled")),
        },
    };
    say(format_args!("gauge {}: {}{why}", gauge.display(), identity(gauge)));
    Ok(())
}

/// Which gauge it is, without a transfer: its part, and its serial number, for parts that show one.
pub(crate) fn pack(gauge: &Path) -> (Option<String>, Option<String>) {
    let model = text(gauge, "model_name").ok().map(|model| model.trim().to_string());
    (model, part(gauge).ok().and_then(|chip| serial(gauge, chip)))
}

/// The serial number in the register that distinguishes packs.
fn serial(gauge: &Path, chip: &Chip) -> Option<String> {
    let register = chip.register_at(chip.serial_register()?)?;
    let word = text(gauge, &format!("gauge/registers/{}", snake_case(register.name))).ok()?;
    Some(format!("0x{:04x}", word.trim().parse::<u16>().ok()?))
}

/// The part, what distinguishes the pack, and when it was polled.
fn identity(gauge: &Path) -> String {
    let text = |name: &str| Some(text(gauge, name).ok()?.trim().to_string());
    let model = text("model_name").unwrap_or("unknown part".into());
    let chip = part(gauge).ok();
    let pack = chip.and_then(|chip| Some((chip, chip.preflight.pack.as_ref()?)));
    let pack = pack.and_then(|(chip, pack)| match pack.word {
        Word::Register(_) => Some(format!("{} {}", pack.name, serial(gauge, chip)?)),
        Word::Answer(_) => Some(format!("{} {}", pack.name, text("gauge/chem_id")?)),
        Word::ControlStatus => None,
    });
    let pack = pack.unwrap_or("no serial number".into());
    let age = text("gauge/age_ms").and_then(|age| age.parse::<f64>().ok());
    let age = age.map_or("age unknown".into(), |age| format!("polled {:.1} s ago", age / 1000.0));
    format!("{model}, {pack}, {age}")
}

/// An error about a line of `df/index`.
fn at_line(line: usize, why: &str) -> Error {
    Error::new(format!("df/index: line {line}"), Cause::Invalid(why.into()))
}

/// A word in hexadecimal, with `0x`.
fn word(text: &str) -> Option<u16> {
    text.starts_with("0x").then(|| text::unsigned(text)).flatten()
}

fn part(folder: &Path) -> Result<&'static Chip> {
    let model = text(folder, "model_name").map_err(|failure| failure.told("its part is unknown"))?;
    CHIPS.iter().copied().find(|chip| chip.model == model.trim()).ok_or_else(|| {
        let why = format!("no gauge that gaugefs knows: {}", model.trim());
        Error::new("model_name", Cause::Gone(why)).within(&folder.display().to_string())
    })
}

/// The values that a mounted gauge has of some parameters.
pub(crate) fn values(gauge: &Path, chip: &'static Chip, rows: &[Row]) -> Result<Image> {
    let mut image = Image::new(chip, None);
    for &row in rows {
        let name = chip.name_of(row);
        let (subclass, parameter) = row;
        if subclass.kind == Kind::Security {
            return Err(Error::new(name, Cause::NotPermitted("keys are never read".into())));
        }
        let read = text(gauge, &format!("df/by-name/{name}"));
        let text = read.map_err(|failure| failure.told(&format!("{name} cannot be read")))?;
        let value = notation::parse_stored(parameter, text.as_bytes())?;
        image.entries.push(Entry { subclass, parameter, value, line: 0 });
    }
    Ok(image)
}

/// The configuration of a mounted gauge, from its `df/index`.
fn read(folder: &Path, chip: &'static Chip, index: &str) -> Result<Image> {
    let firmware = text(folder, "gauge/firmware_version").ok().and_then(|text| word(text.trim()));
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
        return Err(Error::new("", Cause::NotPermitted(why.into())));
    }
    Ok(image)
}

/// What a mounted gauge answers to a subcommand that it answers with a word.
pub(crate) fn ask(gauge: &Path, code: u16) -> Result<u16> {
    let file = "gauge/control";
    let failed = |failure: Failure| failure.told("the gauge does not answer the subcommand");
    send(gauge, file, format!("0x{code:04x}").as_bytes()).map_err(failed)?;
    let text = text(gauge, file).map_err(failed)?;
    let answer = text.split_once(' ').filter(|(asked, _)| word(asked) == Some(code));
    answer.and_then(|(_, answer)| word(answer.trim())).ok_or_else(|| {
        let why = "holds the answer to another subcommand: somebody else has written it; try again";
        Error::new(gauge.join(file).display().to_string(), Cause::Busy(why.into()))
    })
}

/// Makes sure that a gauge has the chemistry of an image for ROM mode, which an import cannot write. Returns a line
/// that says so.
pub(crate) fn check_chemistry(gauge: &Path, chip: &Chip, expected: u16) -> Result<String> {
    let chem_id = text(gauge, "gauge/chem_id").unwrap_or_default();
    let name = gauge.display().to_string();
    same_chemistry(&name, chip, expected, (chem_id.trim(), "pass --same-chemistry"), |code| ask(gauge, code))
}

/// Makes sure of the chemistry of a gauge of that name and CHEM_ID, which `ask` asks a subcommand. `told` is how a person vouches for the
/// chemistry.
pub(crate) fn same_chemistry(
    name: &str,
    chip: &Chip,
    expected: u16,
    (chem_id, told): (&str, &str),
    ask: impl FnOnce(u16) -> Result<u16>,
) -> Result<String> {
    /// Set if the gauge's data of the chemistry does not have the sum that is stored with it.
    const DIFFERS: u16 = 0x8000;
    let chem_id = match chem_id {
        "" => "CHEM_ID unknown".to_string(),
        id => format!("CHEM_ID {id}"),
    };
    let refuse = |why: String| {
        let why = format!(
            "{why}. An import does not write the chemistry: program it with TI's tools, or {told} if \
             the image was made from a gauge with that CHEM_ID"
        );
        Err(Error::new(name, Cause::Invalid(why)))
    };
    let Some(sum) = chip.subcommands.iter().find(|row| row.name == "STATIC_CHEM_DF_CHKSUM") else {
        return refuse(format!("whether it has the image's chemistry is unknown ({chem_id})"));
    };
    match ask(sum.code)? {
        sum if sum == expected => Ok(format!("same chemistry ({chem_id}, checksum 0x{sum:04x})")),
        sum if sum & DIFFERS != 0 => {
            refuse(format!("it reports that its own chemistry is damaged ({chem_id}, checksum 0x{sum:04x})"))
        }
        sum => refuse(format!(
            "another chemistry: {chem_id}, checksum 0x{sum:04x}, but the image has checksum 0x{expected:04x}"
        )),
    }
}

/// All bytes of a subclass of a mounted gauge.
pub(crate) fn raw_of(gauge: &Path, id: u8) -> ti_gauge::error::Result<Vec<u8>> {
    let file = gauge.join(format!("df/{id}/raw"));
    regular::read(&file, LONGEST)
        .map_err(|error| ti_gauge::error::Error::io(file.display().to_string(), "cannot be read", &error))
}

/// Writes changes to a mounted gauge, all of them or none, as one transaction.
pub(crate) fn apply(gauge: &Path, changes: &[Difference<'_>], raw: &[RawDifference]) -> Result<()> {
    if changes.is_empty() && raw.is_empty() {
        return Ok(());
    }
    let mut lines = String::from("begin\n");
    for Difference { new, .. } in changes {
        lines += &format!("{} {}\n", Place::of((new.subclass, new.parameter)), new.text());
    }
    for RawDifference { new, .. } in raw {
        lines += &format!("{} {}\n", new.name(), new.text());
    }
    lines += "commit\n";
    let failed = |failure: Failure| failure.told("nothing was written");
    let mut file = GaugeFile::to_write(gauge, "df/transaction").map_err(failed)?;
    // One write: what is refused of it is refused as a whole, and leaves no transaction open.
    let mut sent = 0;
    while sent < lines.len() {
        sent += file.send(&lines.as_bytes()[sent..]).map_err(|failure| {
            if sent > 0 {
                // The first piece has opened it; a commit that failed has ended it already.
                let _ = file.send(b"abort\n");
            }
            failed(failure)
        })?;
    }
    Ok(())
}

/// A message of the daemon, which does not know under which path its gauge is seen here.
pub(crate) fn with_gauge(text: &str, gauge: &Path) -> String {
    let path = shown(gauge).to_string();
    let is_plain = path.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"/._+-".contains(&byte));
    let path = if is_plain { path } else { format!("'{}'", path.replace('\'', "'\\''")) };
    text.replace(" GAUGE ", &format!(" {path} "))
}
