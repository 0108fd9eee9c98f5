// SPDX-License-Identifier: MIT

//! What may be done to a part at all: whether enough of its table is proven to be written, and whether it is reset.

use super::{Chip, Effect, Kind, Parameter};
use crate::codec::WINDOW;
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

    /// Whether RESET is never sent: to a part that is only read, or to which it does harm.
    pub fn is_never_reset(&self) -> bool {
        self.subcommand(self.access.resets).is_some_and(|reset| reset.effect == Effect::Never)
    }

    /// Refuses a block that is written whole and has a row that is never written: in an undo or for a journal as well.
    pub(crate) fn check_block(&self, subclass: u8, base: u16) -> Result<()> {
        if self.access.scheme.is_flat() {
            return Ok(());
        }
        let block = usize::from(base)..usize::from(base) + WINDOW;
        let rows = self.subclasses.iter().filter(|row| row.id == subclass).flat_map(|row| row.parameters);
        let mut rows = rows.filter(|row| block.contains(&usize::from(row.offset)));
        rows.find_map(Parameter::check_never).map_or(Ok(()), Err)
    }

    /// Whether no source prints what it answers, so that only the user can say that it is this part.
    pub fn is_inferred(&self) -> bool {
        self.has_only_names() && self.identity.firmware.is_empty()
    }

    /// Refuses every write where only names are known, whatever a user allows.
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
