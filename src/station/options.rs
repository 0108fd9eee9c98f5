// SPDX-License-Identifier: MIT

//! The keys of a station. One is a field of [`Options`], and a row that says everything else about it but what it is for:
//! `docs/PRODUCTION.md` explains it.

use std::path::PathBuf;

use crate::config::{
    self,
    option::{Effect, IN_FILE, Opt, put},
    values,
};
use gauge_station::{Options, Rehearsed, Seen, SerialFrom, Unsettled};

const SERIAL_FROM: &[(&str, SerialFrom)] =
    &[("counter", SerialFrom::Counter), ("list", SerialFrom::List), ("input", SerialFrom::Input)];
const SEEN: &[(&str, Seen)] = &[("refuse", Seen::Refuse), ("redo", Seen::Redo)];
const UNSETTLED: &[(&str, Unsettled)] = &[("refuse", Unsettled::Refuse), ("discard", Unsettled::Discard)];

/// A row, but for its name and effect.
const OF_STATION: Opt<Options> = Opt { at: IN_FILE, ..Opt::NEW };

type SetText = fn(&mut Options, &str) -> Result<(), String>;

const fn switch(name: &'static str, set: fn(&mut Options, bool)) -> Opt<Options> {
    Opt { name, effect: Effect::Switch(set), ..OF_STATION }
}

const fn file(name: &'static str, field: fn(&mut Options) -> &mut Option<PathBuf>) -> Opt<Options> {
    Opt { name, effect: Effect::File("FILE", field), sample: "'file'", ..OF_STATION }
}

const fn number(name: &'static str, set: SetText, sample: &'static str) -> Opt<Options> {
    Opt { name, effect: Effect::Number("N", set), sample, ..OF_STATION }
}

const fn text(name: &'static str, set: SetText, sample: &'static str) -> Opt<Options> {
    Opt { name, effect: Effect::Text("TEXT", set), sample, ..OF_STATION }
}

/// A bound of the counter, in the notation of its numbers.
fn serial(to: &mut Options, field: fn(&mut Options) -> &mut Option<i64>, text: &str) -> Result<(), String> {
    put(field(to), values::integer(text))?;
    to.serial_is_hex |= text.starts_with("0x");
    Ok(())
}

impl config::option::Options for Options {
    const TABLE: &'static [Opt<Self>] = &[
        text("name", |to, text| put(&mut to.name, Ok(text.into())), "'line 1'"),
        file("record", |to| &mut to.record),
        file("images", |to| &mut to.images),
        file("state-dir", |to| &mut to.state_dir),
        switch("no-backup", |to, on| to.no_backup = on),
        Opt {
            name: "exclude",
            effect: Effect::Words("GROUP", |word| Ok(word.into()), |to, words| to.exclude = Some(words)),
            sample: "['serial']",
            ..OF_STATION
        },
        switch("data-flash", |to, on| to.data_flash = on),
        switch("same-chemistry", |to, on| to.same_chemistry = on),
        text("serial", |to, text| put(&mut to.serial, values::one_of(text, SERIAL_FROM)), "'counter'"),
        number("first-serial", |to, text| serial(to, |to| &mut to.first_serial, text), "1000"),
        number("last-serial", |to, text| serial(to, |to| &mut to.last_serial, text), "2000"),
        file("serial-list", |to| &mut to.serial_list),
        text("serial-parameter", |to, text| put(&mut to.serial_parameter, Ok(text.into())), "'48/1'"),
        text("date", |to, text| put(&mut to.date, Ok(text.into())), "'today'"),
        number("pack-lot", |to, text| put(&mut to.pack_lot, values::integer(text)), "0x12"),
        number("pcb-lot", |to, text| put(&mut to.pcb_lot, values::integer(text)), "0x12"),
        number("cells", |to, text| put(&mut to.cells, values::count(text)), "4"),
        number("divider", |to, text| put(&mut to.divider, values::divider(text)), "33000"),
        number("pack-voltage", |to, text| put(&mut to.pack_voltage, values::pack_voltage(text)), "15420"),
        switch("board-offset", |to, on| to.board_offset = on),
        switch("cc-offset", |to, on| to.cc_offset = on),
        number("voltage", |to, text| put(&mut to.voltage, values::pack_voltage(text)), "15420"),
        number("current", |to, text| put(&mut to.current, values::meter_current(text)), "-2000"),
        number("temperature", |to, text| put(&mut to.temperature, values::celsius(text)), "23.5"),
        number("voltage-tolerance", |to, text| put(&mut to.voltage_tolerance, values::tolerance(text)), "5"),
        number("current-tolerance", |to, text| put(&mut to.current_tolerance, values::tolerance(text)), "5"),
        number(
            "temperature-tolerance",
            |to, text| put(&mut to.temperature_tolerance, values::tolerance(text)),
            "0.5",
        ),
        number("offset-tolerance", |to, text| put(&mut to.offset_tolerance, values::tolerance(text)), "2"),
        switch("label", |to, on| to.label = on),
        text("label-parameter", |to, text| put(&mut to.label_parameter, Ok(text.into())), "'48/12'"),
        Opt {
            name: "exec",
            effect: Effect::Words("CMD", |word| Ok(word.into()), |to, words| to.exec = words),
            sample: "['true', 'x']",
            ..OF_STATION
        },
        switch("seal", |to, on| to.seal = Some(on)),
        file("new-key-file", |to| &mut to.new_key_file),
        text("seen", |to, text| put(&mut to.seen, values::one_of(text, SEEN)), "'redo'"),
        text("unsettled", |to, text| put(&mut to.unsettled, values::one_of(text, UNSETTLED)), "'discard'"),
        number("stop-after-failures", |to, text| put(&mut to.stop_after_failures, values::count(text)), "3"),
        switch("confirm-first", |to, on| to.confirm_first = on),
        Opt {
            name: "rehearse",
            effect: Effect::Words("PACK", rehearsed, |to, words| to.rehearse = words),
            sample: "['good', 'pulled 300']",
            ..OF_STATION
        },
        number("packs", |to, text| put(&mut to.packs, values::count(text)), "2"),
    ];
}

/// A pack of a rehearsal.
fn rehearsed(word: &str) -> Result<String, String> {
    Rehearsed::parse(word).map(|_| word.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_has_an_effect_of_its_own() {
        config::options::tests::check::<Options>();
    }
}
