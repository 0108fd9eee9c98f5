// SPDX-License-Identifier: MIT

//! Whether enough of a table is proven for anything to be written by it.

use super::{Chip, Kind};
use crate::error::{Error, Reason, Result, Step};

impl Chip {
    /// Whether a row of its data flash, keys apart, is proven. Without one its layout is in doubt as a whole.
    pub fn is_proven(&self) -> bool {
        let shown = self.subclasses.iter().filter(|subclass| subclass.kind != Kind::Security);
        shown.flat_map(|subclass| subclass.parameters).any(|parameter| !parameter.unproven)
    }

    /// Whether its data flash is known by names that nobody has proven: it is read, and nothing is written to it.
    pub fn has_only_names(&self) -> bool {
        self.has_table() && !self.is_proven()
    }

    /// Refuses every write to data flash of which only names are known, whatever a user allows.
    pub fn check_proven(&self) -> Result<()> {
        match self.has_only_names() {
            true => {
                let rows = self.rows().count() as i64;
                Err(Error::of(self.model, Reason::OnlyNames { rows }).at(Step::Check))
            }
            false => Ok(()),
        }
    }
}
