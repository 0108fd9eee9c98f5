// SPDX-License-Identifier: MIT

//! An input as a list of decisions.

/// What is left of the input. After its end every decision is 0.
#[derive(Debug)]
pub(crate) struct Script(Vec<u8>);

impl Script {
    pub(crate) fn new(input: &[u8]) -> Self {
        Self(input.iter().rev().copied().collect())
    }

    pub(crate) fn byte(&mut self) -> u8 {
        self.0.pop().unwrap_or_default()
    }

    pub(crate) fn below(&mut self, limit: usize) -> usize {
        usize::from(self.byte()) % limit
    }

    pub(crate) fn is_over(&self) -> bool {
        self.0.is_empty()
    }

    pub(crate) fn fill(&mut self, into: &mut [u8]) {
        into.iter_mut().for_each(|byte| *byte = self.byte());
    }
}
