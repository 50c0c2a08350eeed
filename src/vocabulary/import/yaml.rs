//! DBoW2's YAML, as OpenCV writes it: `k`, `L`, `scoringType` and `weightingType`, then lists of
//! `{ nodeId, parentId, weight, descriptor }` and `{ wordId, nodeId }`. OpenCV's `key:value` without a blank
//! is no YAML that a general parser reads.

use std::io::BufRead;

use super::Fault;
use super::foreign_tree::{ForeignNode, ForeignTree, Parameters};
use super::lines::{Lines, descriptor, number};

/// Longest item of a list in bytes.
const MAX_ITEM_BYTES: usize = 16 << 10;
/// Most lines before the lists; OpenCV writes seven.
const MAX_HEAD_LINES: u64 = 64;

pub(super) fn read(text: impl BufRead) -> Result<ForeignTree, Fault> {
    let mut lines = Lines::new(text);
    let mut head = Head::default();
    while let Some(line) = lines.next()? {
        if line == "nodes:" {
            let tree = head.parameters().and_then(|parameters| parameters.tree());
            return items(&mut lines, tree.map_err(|reason| lines_fault(&head, reason))?);
        }
        if let Err(reason) = head.note(line) {
            return Err(lines.fault(reason));
        }
        head.line = lines.number;
        if head.line == MAX_HEAD_LINES {
            break;
        }
    }
    Err(lines.fault("expected k, L, scoringType, weightingType, then nodes and words, as DBoW2 writes them"))
}

fn lines_fault(head: &Head, reason: String) -> Fault {
    Fault::at_line(head.line + 1, reason)
}

/// What stands before the lists.
#[derive(Default)]
struct Head {
    branching: Option<i64>,
    depth: Option<i64>,
    scoring: Option<i64>,
    weighting: Option<i64>,
    line: u64,
}

impl Head {
    fn note(&mut self, line: &str) -> Result<(), String> {
        let Some((key, value)) = line.split_once(':') else { return Ok(()) };
        let place = match key {
            "k" => &mut self.branching,
            "L" => &mut self.depth,
            "scoringType" => &mut self.scoring,
            "weightingType" => &mut self.weighting,
            _ => return Ok(()),
        };
        *place = Some(number(key, Some(value.trim()))?);
        Ok(())
    }

    fn parameters(&self) -> Result<Parameters, String> {
        let missing = |key: &str| format!("{key} is missing before the nodes");
        Ok(Parameters {
            branching: self.branching.ok_or_else(|| missing("k"))?,
            depth: self.depth.ok_or_else(|| missing("L"))?,
            scoring: self.scoring.ok_or_else(|| missing("scoringType"))?,
            weighting: self.weighting.ok_or_else(|| missing("weightingType"))?,
        })
    }
}

/// Reads the lists: nodes, and behind `words:` the words.
fn items<R: BufRead>(lines: &mut Lines<R>, mut tree: ForeignTree) -> Result<ForeignTree, Fault> {
    let mut in_words = false;
    let mut item = String::new();
    while let Some(line) = lines.next()? {
        if item.is_empty() && line == "words:" {
            if std::mem::replace(&mut in_words, true) {
                return Err(lines.fault("its words begin a second time"));
            }
            continue;
        }
        item.push_str(line);
        if !line.ends_with('}') {
            if item.len() > MAX_ITEM_BYTES {
                return Err(lines.fault("an item of the list does not end"));
            }
            continue;
        }
        let added = if in_words { add_word(&mut tree, &item) } else { add_node(&mut tree, &item) };
        added.map_err(|reason| lines.fault(reason))?;
        item.clear();
    }
    if item.is_empty() { Ok(tree) } else { Err(lines.fault("it ends within a list")) }
}

fn add_node(tree: &mut ForeignTree, item: &str) -> Result<(), String> {
    let fields = Fields::of(item)?;
    let text = fields.value("descriptor")?.trim_matches('"');
    tree.push(ForeignNode {
        id: fields.number("nodeId")?,
        parent: fields.number("parentId")?,
        weight: fields.number("weight")?,
        descriptor: descriptor(text.split_ascii_whitespace())?,
    })
}

fn add_word(tree: &mut ForeignTree, item: &str) -> Result<(), String> {
    let fields = Fields::of(item)?;
    if tree.words.len() >= tree.nodes.len() {
        return Err("it has more words than nodes".to_owned());
    }
    tree.words.push((fields.number("wordId")?, fields.number("nodeId")?));
    Ok(())
}

/// The text between the braces of an item.
struct Fields<'a>(&'a str);

impl<'a> Fields<'a> {
    fn of(item: &'a str) -> Result<Self, String> {
        let inner = item.trim_start_matches('-').trim().strip_prefix('{').and_then(|i| i.strip_suffix('}'));
        inner.map(Self).ok_or_else(|| "expected an item in braces".to_owned())
    }

    fn value(&self, wanted: &str) -> Result<&'a str, String> {
        let mut pairs = self.0.split(',').filter_map(|field| field.split_once(':'));
        let value = pairs.find(|(key, _)| key.trim() == wanted).map(|(_, value)| value.trim());
        value.ok_or_else(|| format!("{wanted} is missing"))
    }

    fn number<T: std::str::FromStr>(&self, wanted: &str) -> Result<T, String> {
        number(wanted, Some(self.value(wanted)?))
    }
}
