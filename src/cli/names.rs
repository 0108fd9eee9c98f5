// SPDX-License-Identifier: MIT

//! `gaugefs names`: words for the shells' completions: mounted gauges and their parameters, buses, scenarios, columns.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, ValueEnum};
use gauge_bus::linux::adapters;

use crate::daemon::look;
use crate::error::Result;
use crate::output::print;
use gaugefs_client::mounts;
use ti_gauge::chip::{Chip, Kind, kebab_case};
use ti_gauge::dataflash::Row;

/// Print the names of a mounted gauge's parameters, or others; the completions run it
#[derive(Args, Debug)]
#[command(hide = true)]
pub(super) struct Names {
    /// Names of something else
    #[arg(long)]
    of: Option<Of>,
    /// Folder of a mounted gauge, or the mount point of a single one
    #[arg(required_unless_present = "of", conflicts_with = "of")]
    gauge: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Of {
    Gauges,
    Buses,
    Scenarios,
    #[cfg(feature = "screen")]
    Columns,
}

impl Names {
    pub(super) fn run(self) -> Result<ExitCode> {
        let names = match (self.of, self.gauge) {
            (Some(of), _) => of.names()?,
            (None, gauge) => parameters(gauge.expect("clap demands it"))?,
        };
        let lines = names.into_iter().map(|name| name + "\n");
        print(&lines.collect::<String>())?;
        Ok(ExitCode::SUCCESS)
    }
}

impl Of {
    fn names(self) -> Result<Vec<String>> {
        Ok(match self {
            Self::Gauges => {
                let found = look::gauges(&mounts::list())?;
                found
                    .into_iter()
                    .flat_map(|(_, found)| found.gauges)
                    .map(|found| found.listed.gauge)
                    .collect()
            }
            Self::Buses => {
                adapters(Path::new("/")).iter().map(|(number, _)| format!("/dev/i2c-{number}")).collect()
            }
            Self::Scenarios => gauge_sim::scenario::names().map(String::from).collect(),
            #[cfg(feature = "screen")]
            Self::Columns => gaugefs_screen::columns().map(|name| name.replace(' ', "_")).collect(),
        })
    }
}

fn parameters(gauge: PathBuf) -> Result<Vec<String>> {
    let listed = look::gauges(&[gauge])?;
    let part = listed.first().and_then(|(_, found)| found.gauges.first()?.listed.part.clone());
    let chip = part.and_then(|part| Chip::by_model(&part));
    let rows = chip.into_iter().flat_map(|chip| chip.rows().map(move |row| (chip, row)));
    let rows = rows.filter(|(_, (subclass, _))| subclass.kind != Kind::Security);
    // People type the short name if it means one parameter.
    let names = |(chip, row): (&Chip, Row)| {
        let short = Some(kebab_case(row.1.name)).filter(|name| chip.find(name).is_ok());
        short.into_iter().chain([chip.name_of(row)])
    };
    Ok(rows.flat_map(names).collect())
}
