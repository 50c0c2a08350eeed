//! ORB-SLAM's text file: `k L scoring weighting`, then a line a node, `parent isLeaf d0 … d31 weight`.
//! Nodes are numbered by their lines from 1, words by the order of the leaves.

use std::io::BufRead;

use super::Fault;
use super::foreign_tree::{ForeignNode, ForeignTree, Parameters};
use super::lines::{Lines, descriptor, number};

/// Whether a text begins with a line of four numbers.
pub(super) fn begins(text: &[u8]) -> bool {
    let line = text.split(|&byte| byte == b'\n').next().and_then(|line| str::from_utf8(line).ok());
    line.is_some_and(|line| parameters(line).is_ok())
}

pub(super) fn read(text: impl BufRead) -> Result<ForeignTree, Fault> {
    let mut lines = Lines::new(text);
    let head = lines.next()?.unwrap_or_default();
    let mut tree = parameters(head).and_then(|parameters| parameters.tree()).map_err(|r| lines.fault(r))?;
    while let Some(line) = lines.next()? {
        // Some writers end with an empty line.
        if !line.is_empty() {
            add_node(&mut tree, line).map_err(|reason| lines.fault(reason))?;
            if !lines.is_whole() {
                return Err(lines.fault("it ends within a line"));
            }
        }
    }
    Ok(tree)
}

fn parameters(line: &str) -> Result<Parameters, String> {
    let mut fields = line.split_ascii_whitespace();
    let parameters = Parameters {
        branching: number("the branching", fields.next())?,
        depth: number("the depth", fields.next())?,
        scoring: number("the scoring", fields.next())?,
        weighting: number("the weighting", fields.next())?,
    };
    match fields.next() {
        None => Ok(parameters),
        Some(_) => Err("expected four numbers".to_owned()),
    }
}

fn add_node(tree: &mut ForeignTree, line: &str) -> Result<(), String> {
    let mut fields = line.split_ascii_whitespace();
    let id = tree.nodes.len() as u32 + 1;
    let parent: u32 = number("the parent", fields.next())?;
    let is_leaf: u32 = number("the leaf flag", fields.next())?;
    let descriptor = descriptor(fields.by_ref().take(32))?;
    let weight = number("the weight", fields.next())?;
    if fields.next().is_some() {
        return Err("there is more than a node in the line".to_owned());
    }
    if parent >= id {
        return Err(format!("parent {parent} comes after its child {id}"));
    }
    if is_leaf > 0 {
        tree.words.push((tree.words.len() as u32, id));
    }
    tree.push(ForeignNode { id, parent, descriptor, weight })
}
