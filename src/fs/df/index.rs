// SPDX-License-Identifier: MIT

//! `df/index`. Its text is rendered anew only when one of its values may have changed.

use std::sync::Arc;

use super::super::rendered::Inputs;
use super::super::supply::Supply;
use super::super::{Content, Mode, Node, Operations};
use super::{DfItem, address, bounds, column, unless_sealed, value_text};
use gauge_owner::{Done, operations as op};
use ti_gauge::chip::{FLAT, Kind, Parameter, Subclass};

/// A line is shorter than this.
const LINE: u64 = 256;

pub(super) struct Index<'a>(pub(super) &'a Arc<Supply>);

impl Operations for Index<'_> {
    fn parent(&self) -> Node {
        self.0.df_node(DfItem::Folder)
    }

    fn mode(&self) -> Mode {
        Mode::Read
    }

    fn content(&self) -> Content {
        if let Some(text) = self.0.rendered_index() {
            return Content::Bytes(text);
        }
        let rows = self.0.chip().subclasses.iter().map(|subclass| subclass.parameters.len());
        Content::Unread(LINE * (1 + rows.sum::<usize>() as u64))
    }

    fn read(&self, done: Done<Arc<[u8]>>) {
        let supply = Arc::clone(self.0);
        self.0.handle.ask(
            &op::READ,
            supply.readable().collect(),
            Box::new(move |read| done(unless_sealed(read.map(drop)).map(|()| supply.render_index()))),
        );
    }
}

impl Supply {
    fn readable(&self) -> impl Iterator<Item = usize> {
        let readable = self.subclasses().filter(|(_, subclass)| subclass.kind != Kind::Security);
        readable.map(|(at, _)| at.into())
    }

    /// `None` while some value is not known.
    fn inputs(&self) -> Option<Inputs> {
        let kept: Option<_> = self.readable().map(|at| self.handle.kept(at)).collect();
        Some(Inputs(self.published().answers.dm_code, kept?))
    }

    /// The text as it was last rendered, if it is still right.
    fn rendered_index(&self) -> Option<Arc<[u8]>> {
        self.rendered.get(&self.inputs()?)
    }

    fn render_index(&self) -> Arc<[u8]> {
        // Before the text: one that is rendered of later values is rendered again.
        let inputs = self.inputs();
        let text = self.index().into_bytes().into();
        if let Some(inputs) = inputs {
            self.rendered.set(inputs, &text);
        }
        text
    }

    /// `df/index`: a line for each parameter of the table.
    fn index(&self) -> String {
        let dm_code = self.published().answers.dm_code;
        let rows = self.chip().subclasses.iter().map(|subclass| subclass.parameters.len());
        // Lines are at most half as long as allowed.
        let mut lines = String::with_capacity((LINE / 2) as usize * rows.sum::<usize>());
        lines += "subclass\toffset\ttype\tname\tunit\tmin\tmax\tdefault\tflags\tvalue\n";
        for (at, subclass) in self.chip().subclasses.iter().enumerate() {
            let is_secret = subclass.kind == Kind::Security;
            let bytes = if is_secret { None } else { self.handle.kept(at) };
            for parameter in subclass.parameters {
                let (id, offset) = match subclass.id {
                    FLAT => ("flash".to_string(), address(parameter)),
                    id => (id.to_string(), parameter.offset.to_string()),
                };
                let [min, max, default] =
                    bounds(subclass, parameter, dm_code).map(|bound| bound.unwrap_or("-".into()));
                let value = bytes
                    .as_ref()
                    .map_or("-".into(), |bytes| column(value_text(self.chip(), subclass, parameter, bytes)));
                let unit = if parameter.unit.is_empty() { "-" } else { parameter.unit };
                let (kind, name, flags) = (
                    parameter.kind,
                    parameter.name,
                    flags(subclass, parameter, self.chip().is_never_reset()),
                );
                lines += &format!(
                    "{id}\t{offset}\t{kind}\t{name}\t{unit}\t{min}\t{max}\t{default}\t{flags}\t{value}\n"
                );
            }
        }
        lines
    }
}

fn flags(subclass: &Subclass, parameter: &Parameter, is_never_reset: bool) -> String {
    let flags = [
        ("learned", parameter.learned),
        ("reset", subclass.kind == Kind::Reset && !is_never_reset),
        ("next-start", subclass.kind == Kind::Reset && is_never_reset),
        ("safe-limit", parameter.safe.is_some()),
        ("security", subclass.kind == Kind::Security),
        ("unproven", parameter.unproven && parameter.never.is_none()),
        ("never-written", parameter.never.is_some()),
    ];
    let set: Vec<_> = flags.iter().filter(|(_, set)| *set).map(|(name, _)| *name).collect();
    if set.is_empty() { "-".into() } else { set.join(",") }
}
