// SPDX-License-Identifier: MIT

//! The text of a large file, for as long as somebody has it.

use std::sync::{Arc, Mutex, PoisonError, Weak};

/// The last text, and what it was rendered from.
#[derive(Default)]
pub(super) struct Rendered(Mutex<Option<(Inputs, Weak<[u8]>)>>);

/// DM_CODE, and the bytes of each subclass that may be read.
pub(super) struct Inputs(pub(super) Option<u16>, pub(super) Vec<Arc<[u8]>>);

impl PartialEq for Inputs {
    /// What has been read again is other bytes.
    fn eq(&self, other: &Self) -> bool {
        let is_same = |(one, other): (&Arc<[u8]>, &Arc<[u8]>)| Arc::ptr_eq(one, other);
        self.0 == other.0 && self.1.len() == other.1.len() && self.1.iter().zip(&other.1).all(is_same)
    }
}

impl Rendered {
    /// The text, if it was rendered from the same.
    pub(super) fn get(&self, inputs: &Inputs) -> Option<Arc<[u8]>> {
        let rendered = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let (of, text) = rendered.as_ref()?;
        text.upgrade().filter(|_| of == inputs)
    }

    pub(super) fn set(&self, inputs: Inputs, text: &Arc<[u8]>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some((inputs, Arc::downgrade(text)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_right_for_what_it_was_rendered_from_only() {
        let bytes = |text: &str| -> Arc<[u8]> { text.as_bytes().into() };
        let (one, other, text) = (bytes("1"), bytes("2"), bytes("one and two"));
        let inputs = |code, two: &Arc<[u8]>| Inputs(code, vec![one.clone(), two.clone()]);
        let rendered = Rendered::default();
        rendered.set(inputs(None, &other), &text);
        assert_eq!(rendered.get(&inputs(None, &other)).as_ref(), Some(&text));
        assert!(rendered.get(&inputs(Some(1), &other)).is_none());
        assert!(rendered.get(&inputs(None, &bytes("2"))).is_none(), "read again");
        assert!(rendered.get(&Inputs(None, vec![one.clone()])).is_none());
        drop(text);
        assert!(rendered.get(&inputs(None, &other)).is_none(), "nobody has it");
    }
}
