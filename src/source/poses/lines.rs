//! Lines that come bit by bit over a connection which is never waited for.

use std::io::{ErrorKind, Read};

/// Longest line in bytes: gpsd's list of satellites takes a few thousand.
const MOST_LINE_BYTES: usize = 1 << 16;
/// Most bytes that are taken at a time, so that whoever sends without end holds nobody up.
const MOST_BYTES_AT_A_TIME: usize = 1 << 18;

/// What came of a connection so far and is no whole line yet.
#[derive(Debug, Default)]
pub(super) struct Lines {
    begun: Vec<u8>,
    /// Whether the line that is coming is too long and is passed over.
    is_too_long: bool,
}

/// Whether more may come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Connection {
    Open,
    Ended,
}

impl Lines {
    /// Hands every whole line that has come from `connection`, which must not block, to `take`.
    pub(super) fn read(&mut self, connection: &mut impl Read, mut take: impl FnMut(&str)) -> Connection {
        let mut block = [0; 4096];
        let mut taken = 0;
        while taken < MOST_BYTES_AT_A_TIME {
            match connection.read(&mut block) {
                Ok(0) => return Connection::Ended,
                Ok(count) => {
                    taken += count;
                    self.split(&block[..count], &mut take);
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(_) => return Connection::Ended,
            }
        }
        Connection::Open
    }

    fn split(&mut self, bytes: &[u8], take: &mut impl FnMut(&str)) {
        for part in bytes.split_inclusive(|byte| *byte == b'\n') {
            self.is_too_long |= self.begun.len() + part.len() > MOST_LINE_BYTES;
            if !self.is_too_long {
                self.begun.extend_from_slice(part);
            }
            if part.ends_with(b"\n") {
                if !self.is_too_long {
                    take(String::from_utf8_lossy(&self.begun).trim());
                }
                self.begun.clear();
                self.is_too_long = false;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;
    use std::io;

    use proptest::prelude::*;

    use super::*;

    /// Bytes that come in pieces; a piece of none is a moment without any.
    struct Pieces(VecDeque<Vec<u8>>);

    impl Read for Pieces {
        fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
            match self.0.pop_front() {
                None => Ok(0),
                Some(piece) if piece.is_empty() => Err(ErrorKind::WouldBlock.into()),
                Some(mut piece) => {
                    let rest = piece.split_off(piece.len().min(into.len()));
                    into[..piece.len()].copy_from_slice(&piece);
                    if !rest.is_empty() {
                        self.0.push_front(rest);
                    }
                    Ok(piece.len())
                }
            }
        }
    }

    fn read(pieces: Vec<Vec<u8>>) -> Vec<String> {
        let (mut lines, mut pieces) = (Lines::default(), Pieces(pieces.into()));
        let mut read = Vec::new();
        while lines.read(&mut pieces, |line| read.push(line.to_owned())) == Connection::Open {}
        read
    }

    proptest! {
        #[test]
        fn lines_are_the_same_whatever_the_pieces_they_come_in(
            text in "[a-z\n]{0,60}", cuts in prop::collection::vec(0..60_usize, 0..8),
        ) {
            let mut pieces: Vec<Vec<u8>> = Vec::new();
            let mut rest = text.as_bytes();
            for cut in cuts {
                let (piece, others) = rest.split_at(cut.min(rest.len()));
                pieces.push(piece.to_vec());
                rest = others;
            }
            pieces.push(rest.to_vec());
            // What is behind the last line break is no line yet.
            let whole = text.rsplit_once('\n').map_or("", |(whole, _)| whole);
            let expected: Vec<&str> = if text.contains('\n') { whole.split('\n').collect() } else { Vec::new() };
            prop_assert_eq!(read(pieces), expected);
        }
    }

    #[test]
    fn a_line_without_end_takes_no_memory_and_the_next_one_is_read() {
        let mut lines = Lines::default();
        let mut pieces = vec![vec![b'x'; 1 << 15]; 20];
        pieces.push(b"y\nnext\n".to_vec());
        let (mut pieces, mut read) = (Pieces(pieces.into()), Vec::new());
        while lines.read(&mut pieces, |line| read.push(line.to_owned())) == Connection::Open {
            assert!(lines.begun.capacity() <= 2 * MOST_LINE_BYTES);
        }
        assert_eq!(read, ["next"]);
    }
}
