//! Names of a graph's values: which are taken, and fresh ones.

use std::collections::BTreeSet;

use super::proto::GraphProto;

/// Names that are taken.
#[derive(Debug)]
pub(super) struct Names(BTreeSet<String>);

impl Names {
    /// Those of the inputs and weights of `graph` and of what its nodes give.
    pub(super) fn of(graph: &GraphProto) -> Self {
        let mut names: BTreeSet<String> = graph.initializer.iter().map(|w| w.name().to_owned()).collect();
        names.extend(graph.input.iter().map(|input| input.name().to_owned()));
        names.extend(graph.node.iter().flat_map(|node| node.output.iter().cloned()));
        Self(names)
    }

    /// The name, if it is taken.
    pub(super) fn get(&self, name: &str) -> Option<&String> {
        self.0.get(name)
    }

    /// Takes a name; whether it was free.
    pub(super) fn take(&mut self, name: &str) -> bool {
        self.0.insert(name.to_owned())
    }

    /// Frees a name.
    pub(super) fn give_back(&mut self, name: &str) {
        self.0.remove(name);
    }

    /// `name`, or one like it that is not taken; it is from now on.
    pub(super) fn fresh(&mut self, name: &str) -> String {
        let mut fresh = name.to_owned();
        for number in 2.. {
            if self.take(&fresh) {
                break;
            }
            fresh = format!("{name} {number}");
        }
        fresh
    }
}
