// SPDX-License-Identifier: MIT

//! `gaugefs names`: the names of a mounted gauge's parameters, for the completions of the shells.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;

use crate::daemon::look;
use crate::error::Result;
use crate::output::print;
use ti_gauge::chip::{Chip, Kind, kebab_case};
use ti_gauge::dataflash::Row;

/// Print the names of a mounted gauge's parameters; the completions run it
#[derive(Args, Debug)]
#[command(hide = true)]
pub(super) struct Names {
    /// Folder of a mounted gauge, or the mount point of a single one
    gauge: PathBuf,
}

impl Names {
    pub(super) fn run(self) -> Result<ExitCode> {
        let listed = look::gauges(&[self.gauge])?;
        let part = listed.first().and_then(|(_, found)| found.gauges.first()?.listed.part.clone());
        let chip = part.and_then(|part| Chip::by_model(&part));
        let rows = chip.into_iter().flat_map(|chip| chip.rows().map(move |row| (chip, row)));
        let rows = rows.filter(|(_, (subclass, _))| subclass.kind != Kind::Security);
        // The short name, where it means one parameter, is what people type.
        let names = |(chip, row): (&Chip, Row)| {
            let short = Some(kebab_case(row.1.name)).filter(|name| chip.find(name).is_ok());
            short.into_iter().chain([chip.name_of(row)]).map(|name| name + "\n").collect::<String>()
        };
        print(&rows.map(names).collect::<String>())?;
        Ok(ExitCode::SUCCESS)
    }
}
