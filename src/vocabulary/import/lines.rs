//! Lines of a text from outside, each of bounded length.

use std::io::{BufRead, Read};

use super::Fault;

/// Longest line in bytes; a node takes some 200.
const MAX_LINE_BYTES: u64 = 16 << 10;
/// Most empty lines in a row: a small compressed file may hold millions.
const MAX_EMPTY_LINES: u64 = 64;

/// Reads a text line by line.
pub(super) struct Lines<R> {
    text: R,
    line: String,
    empty_lines: u64,
    /// Number of the last line that was read, from 1.
    pub(super) number: u64,
}

impl<R: BufRead> Lines<R> {
    pub(super) fn new(text: R) -> Self {
        Self { text, line: String::new(), empty_lines: 0, number: 0 }
    }

    /// The next line, trimmed; `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<&str>, Fault> {
        self.number += 1;
        self.line.clear();
        let fault = |reason: String| Fault::at_line(self.number, reason);
        let read = (&mut self.text).take(MAX_LINE_BYTES).read_line(&mut self.line);
        match read.map_err(|error| fault(error.to_string()))? {
            0 => Ok(None),
            bytes if bytes as u64 == MAX_LINE_BYTES => Err(fault("the line does not end".to_owned())),
            _ => {
                let line = self.line.trim();
                self.empty_lines = if line.is_empty() { self.empty_lines + 1 } else { 0 };
                if self.empty_lines > MAX_EMPTY_LINES {
                    Err(fault("only empty lines".to_owned()))
                } else {
                    Ok(Some(line))
                }
            }
        }
    }

    /// Whether the last line that was read ends as lines do; else the file may have been cut within it.
    pub(super) fn is_whole(&self) -> bool {
        self.line.ends_with('\n')
    }

    /// A fault in the last line that was read.
    pub(super) fn fault(&self, reason: impl Into<String>) -> Fault {
        Fault::at_line(self.number, reason)
    }
}

/// The 32 bytes that `numbers` are, written in decimal.
pub(super) fn descriptor<'a>(numbers: impl Iterator<Item = &'a str>) -> Result<[u8; 32], String> {
    let mut bytes = [0; 32];
    let mut count = 0;
    for (index, number) in numbers.enumerate() {
        let byte = number.parse().map_err(|_| format!("{number:?} is no byte of a descriptor"))?;
        if let Some(place) = bytes.get_mut(index) {
            *place = byte;
        }
        count = index + 1;
    }
    if count == bytes.len() { Ok(bytes) } else { Err(format!("a descriptor of {count} bytes, expected 32")) }
}

/// The number that `text` is.
pub(super) fn number<T: std::str::FromStr>(name: &str, text: Option<&str>) -> Result<T, String> {
    let text = text.ok_or_else(|| format!("{name} is missing"))?;
    text.parse().map_err(|_| format!("{name} is {text:?}"))
}
