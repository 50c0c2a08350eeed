//! The log of a run, read line by line: what `loci run --json` wrote, or what is left of it.

use std::io::{BufRead, Read};

use super::ReviewError;
use crate::telemetry::log_line::LogLine;

/// Longest line that is read, in bytes; ours have about 600.
const MAX_LINE_BYTES: usize = 1 << 20;

/// A log that is being read.
pub(super) struct Log<R> {
    input: R,
    line: Vec<u8>,
    /// Lines so far.
    lines: u64,
    /// Whether one of them said something.
    is_log: bool,
    /// Lines that say nothing of a frame.
    pub(super) unreadable: usize,
}

impl<R: BufRead> Log<R> {
    pub(super) fn new(input: R) -> Self {
        Self { input, line: Vec::new(), lines: 0, is_log: false, unreadable: 0 }
    }

    /// The next line that says something of a frame. Others, such as one that was half written when the power failed,
    /// are counted and passed over, unless none came before.
    ///
    /// # Errors
    /// If the log cannot be read, the first line is of no log, or one is too long to be of one.
    pub(super) fn next(&mut self) -> Result<Option<LogLine<'static>>, ReviewError> {
        loop {
            self.line.clear();
            let read = self.input.by_ref().take(MAX_LINE_BYTES as u64 + 1).read_until(b'\n', &mut self.line);
            self.lines += 1;
            if read.map_err(|error| self.refusal(&error.to_string()))? == 0 {
                return Ok(None);
            }
            if self.line.len() > MAX_LINE_BYTES {
                return Err(self.refusal("too long for a line of what `loci run --json` writes"));
            }
            if self.line.trim_ascii().is_empty() {
                continue;
            }
            match serde_json::from_slice::<LogLine<'_>>(&self.line) {
                Ok(line) => {
                    self.is_log = true;
                    return Ok(Some(line));
                }
                Err(error) if !self.is_log => {
                    return Err(self.refusal(&format!("not what `loci run --json` writes: {error}")));
                }
                Err(_) => self.unreadable += 1,
            }
        }
    }

    fn refusal(&self, reason: &str) -> ReviewError {
        ReviewError::Log { line: self.lines, reason: reason.to_owned() }
    }
}

#[cfg(test)]
mod tests {
    use proptest::collection::vec;
    use proptest::prelude::*;

    use super::*;
    use crate::telemetry::rerun::told::Told;

    const LINE: &str =
        r#"{"frame":1,"capture_nanos":5,"decision":"unknown","confidence":0.5,"candidates":[]}"#;

    fn read(text: &str) -> Result<(Vec<u64>, usize), String> {
        let mut log = Log::new(text.as_bytes());
        let mut frames = Vec::new();
        while let Some(line) = log.next().map_err(|error| error.to_string())? {
            frames.push(line.frame);
        }
        Ok((frames, log.unreadable))
    }

    #[test]
    fn what_was_half_written_is_passed_over_and_counted() {
        assert_eq!(read(""), Ok((vec![], 0)));
        assert_eq!(read(&format!("{LINE}\n\n{LINE}\n{}", &LINE[..40])), Ok((vec![1, 1], 1)));
        assert_eq!(read(&format!("{LINE}\n\u{7}nonsense\n{LINE}")), Ok((vec![1, 1], 1)));
    }

    proptest! {
        #[test]
        fn no_line_makes_it_panic_or_say_what_cannot_be(at in 0..LINE.len(), bytes in vec(any::<u8>(), 0..9)) {
            let changed = [&LINE.as_bytes()[..at], &bytes, &LINE.as_bytes()[at..]].concat();
            let text = [LINE.as_bytes(), b"\n", &changed].concat();
            let mut log = Log::new(text.as_slice());
            while let Ok(Some(line)) = log.next() {
                let told = Told::of_line(&line);
                prop_assert!(told.is_none_or(|told| (0.0..=1.0).contains(&told.confidence)));
            }
        }
    }

    #[test]
    fn what_is_no_log_is_refused_by_its_line() {
        let refusal = read("frame,place\n1,2\n").unwrap_err();
        assert!(refusal.starts_with("line 1: not what `loci run --json` writes: "), "{refusal}");
        let endless = format!("{LINE}\n{}", "x".repeat(MAX_LINE_BYTES + 1));
        assert_eq!(
            read(&endless).unwrap_err(),
            "line 2: too long for a line of what `loci run --json` writes"
        );
    }
}
