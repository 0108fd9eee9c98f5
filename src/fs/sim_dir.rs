// SPDX-License-Identifier: MIT

//! `sim/`: the knobs of a simulated gauge, one file each.

use nix::errno::Errno;

use super::caller::Caller;
use super::{Content, Item, Knobs, Mode, Node, Operations, Shape, not_writable};
use crate::error::Error;
use crate::output::say;
use gauge_owner::{Attempt, Done, Handle};

/// Where the knobs of a gauge are.
pub(super) struct SimDir<'a> {
    /// The index of the gauge in the tree.
    pub(super) gauge: u16,
    pub(super) knobs: Option<&'a dyn Knobs>,
    /// The folder that holds this one; the root holds itself.
    pub(super) parent: Node,
    /// The gauge, if more of it is shown than its knobs.
    pub(super) handle: Option<&'a Handle>,
}

/// An item of `sim/`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SimItem {
    /// The folder itself.
    Folder,
    /// The knob of that index.
    Knob(u8),
}

impl SimItem {
    pub(super) fn of(self, dir: SimDir<'_>) -> Box<dyn Operations + '_> {
        match self {
            SimItem::Folder => Box::new(dir),
            SimItem::Knob(at) => Box::new(Knob { dir, at }),
        }
    }
}

impl SimDir<'_> {
    fn node(&self, item: SimItem) -> Node {
        Node::Of(self.gauge, Item::Sim(item))
    }
}

impl Operations for SimDir<'_> {
    fn parent(&self) -> Node {
        self.parent
    }

    fn shape(&self) -> Shape {
        Shape::Folder
    }

    fn list(&self) -> Vec<(String, Node)> {
        let knobs = self.knobs.map(Knobs::list).unwrap_or_default();
        (0..).zip(knobs).map(|(at, (name, _))| (name.to_string(), self.node(SimItem::Knob(at)))).collect()
    }
}

struct Knob<'a> {
    dir: SimDir<'a>,
    at: u8,
}

impl<'a> Knob<'a> {
    /// All knobs, this one's name, and whether it is writable.
    fn find(&self) -> Option<(&'a dyn Knobs, &'static str, bool)> {
        let knobs = self.dir.knobs?;
        let (name, writable) = *knobs.list().get(usize::from(self.at))?;
        Some((knobs, name, writable))
    }
}

impl Operations for Knob<'_> {
    fn parent(&self) -> Node {
        self.dir.node(SimItem::Folder)
    }

    fn mode(&self) -> Mode {
        if self.find().is_some_and(|(_, _, writable)| writable) { Mode::ReadWrite } else { Mode::Read }
    }

    fn content(&self) -> Content {
        let text = self.find().and_then(|(knobs, name, _)| knobs.get(name));
        text.map(|text| text + "\n").into()
    }

    fn write(&self, _: Caller, data: &[u8], done: Done<()>) {
        let (knobs, name) = match self.find() {
            Some((knobs, name, true)) => (knobs, name),
            Some((_, _, false)) => return done(Err(not_writable())),
            None => return done(Err(Error::host("", Errno::ENODEV, "the simulated gauge has no such knob"))),
        };
        let text = std::str::from_utf8(data).unwrap_or_default().trim();
        let outcome = knobs.set(name, text);
        let Some(handle) = self.dir.handle else {
            // Of what shows nothing but knobs there is no log.
            if let Err(error) = &outcome {
                say(error);
            }
            return done(outcome);
        };
        let attempt = Attempt::Knob(name);
        match outcome {
            Ok(()) => {
                handle.succeeded(&attempt);
                done(Ok(()));
            }
            // The error names the file.
            Err(error) => handle.refuse(attempt, error.about(format!("sim/{name}")), done),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::mpsc;

    use super::*;
    use crate::daemon::knobs::SimKnobs;
    use crate::fs::{Access, Fs};
    use gauge_bus::clock::SimClock;
    use gauge_sim::{Options, Sim};

    /// A tree with the knobs of these gauges.
    fn tree(names: &[&str]) -> Fs {
        let knobs = names.iter().map(|name| {
            let sim =
                Sim::new("bq34z100-g1", &Options::default(), Arc::new(SimClock::new())).expect("a gauge");
            (name.to_string(), Box::new(SimKnobs(sim)) as Box<dyn Knobs>)
        });
        Fs::of_knobs(knobs.collect(), Access { uid: 0, gid: 0, group: false })
    }

    fn write(tree: &Fs, node: Node, data: &[u8]) -> Result<(), Errno> {
        let (sender, answer) = mpsc::channel();
        let done = Box::new(move |outcome| sender.send(outcome).expect("it is awaited"));
        tree.write(node, Caller { file: 1, process: None }, 0, data, done);
        answer.recv().expect("an answer").map_err(|error: Error| Errno::from_raw(error.errno()))
    }

    #[test]
    fn knobs_alone_are_in_the_root_or_in_a_folder_for_each_gauge() {
        let one = tree(&["a"]);
        let voltage = one.lookup(Node::Root, "voltage_mv").expect("a knob");
        assert_eq!(Node::at(voltage.place()), Some(voltage));
        assert_eq!((one.shape(voltage), one.mode(voltage)), (Shape::File, 0o600));
        assert_eq!(write(&one, voltage, b" 3210\n"), Ok(()));
        assert_eq!(one.content(voltage), Content::Bytes(b"3210\n".as_slice().into()));
        assert_eq!(write(&one, voltage, b"nonsense"), Err(Errno::EINVAL));
        assert_eq!(write(&one, voltage, &[b'1'; 4096]), Err(Errno::EFBIG));
        let counter = one.lookup(Node::Root, "transfers").expect("a knob");
        assert_eq!((one.mode(counter), write(&one, counter, b"1")), (0o400, Err(Errno::EACCES)));
        // There is no gauge that could be told.
        one.raise(voltage);
        one.report_defect(Some(voltage));

        let two = tree(&["a", "b"]);
        let names: Vec<_> = two.list(Node::Root).into_iter().map(|(name, _)| name).collect();
        assert_eq!(names, ["a", "b"]);
        let knob = |gauge| two.lookup(two.lookup(Node::Root, gauge)?, "voltage_mv");
        let (first, second) = (knob("a").expect("a knob"), knob("b").expect("a knob"));
        let before = two.content(first);
        assert_eq!(write(&two, second, b"3210"), Ok(()));
        assert!(two.content(first) == before && two.content(second) != before);
        assert_eq!(two.parent(two.parent(second)), Node::Root);
    }
}
