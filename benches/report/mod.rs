// SPDX-License-Identifier: MIT

//! What a bench ends with: its rows of the table in docs/MEASUREMENTS.md, and its exit code.

use std::process::ExitCode;

/// Rows of the table "Figures" in docs/MEASUREMENTS.md, and the promises that did not hold.
#[derive(Default)]
pub(crate) struct Report {
    rows: Vec<String>,
    broken: Vec<String>,
}

impl Report {
    /// One row: what was measured, the figure, and what it compares with (empty for nothing).
    pub(crate) fn row(&mut self, what: &str, figure: &str, beside: &str) {
        self.rows.push(format!("| {what} | {figure} | {beside} |"));
    }

    /// A promise of the documentation. `found` says what was measured instead.
    pub(crate) fn promise(&mut self, holds: bool, found: impl FnOnce() -> String) {
        if !holds {
            self.broken.push(found());
        }
    }

    /// Prints the rows, and the broken promises on standard error; any of those is a failure.
    pub(crate) fn finish(self) -> ExitCode {
        println!();
        for row in &self.rows {
            println!("{row}");
        }
        for broken in &self.broken {
            eprintln!("BROKEN: {broken}");
        }
        if self.broken.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
    }
}
