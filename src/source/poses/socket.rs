//! Poses as lines on a Unix socket: whoever knows where the robot is connects and writes them.

use std::io;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use super::lines::{Connection, Lines};
use super::reading::Format;
use crate::frame::Pose;
use crate::source::SourceError;

/// Writers that are heard at a time; further ones wait.
const MOST_WRITERS: usize = 8;
const TAKEN: &str = "something else is there; name a path at which nothing is";

/// A socket that is listened on; its file goes when this does.
#[derive(Debug)]
pub(super) struct PoseSocket {
    path: PathBuf,
    /// Which file it is.
    identity: [u64; 2],
    listener: UnixListener,
    writers: Vec<Writer>,
}

#[derive(Debug)]
struct Writer {
    stream: UnixStream,
    lines: Lines,
    format: Format,
    /// Whether one of its lines was complained of: one is enough.
    is_known_for_errors: bool,
}

impl PoseSocket {
    /// Listens at `path`. A socket that was left there and on which nobody listens is replaced.
    ///
    /// # Errors
    /// If something else is there, or the folder cannot be written.
    pub(super) fn listen(path: &Path) -> Result<Self, SourceError> {
        let error = |source| SourceError::Io { path: path.to_owned(), source };
        if is_left_over(path) {
            std::fs::remove_file(path).map_err(error)?;
        }
        let listener = UnixListener::bind(path).map_err(|source| match source.kind() {
            io::ErrorKind::AddrInUse => error(io::Error::other(TAKEN)),
            _ => error(source),
        })?;
        listener.set_nonblocking(true).map_err(error)?;
        let identity = identity(path).map_err(error)?;
        Ok(Self { path: path.to_owned(), identity, listener, writers: Vec::new() })
    }

    /// Hands every pose that has come, with its time in nanoseconds, to `take`. Answers what people should know.
    pub(super) fn read(&mut self, mut take: impl FnMut(i64, Pose)) -> Option<String> {
        while self.writers.len() < MOST_WRITERS
            && let Some(writer) = self.next_writer()
        {
            self.writers.push(writer);
        }
        let (mut notice, path) = (None, &self.path);
        self.writers.retain_mut(|writer| {
            let Writer { stream, lines, format, is_known_for_errors } = writer;
            let read = lines.read(stream, |line| match format.pose_of(line) {
                Ok(pose) => pose.into_iter().for_each(|(nanos, pose)| take(nanos, pose)),
                Err(reason) if !*is_known_for_errors => {
                    *is_known_for_errors = true;
                    notice = Some(format!("poses {}: {reason}; such lines are left out", path.display()));
                }
                Err(_) => {}
            });
            read == Connection::Open
        });
        notice
    }

    fn next_writer(&self) -> Option<Writer> {
        let accepted = self.listener.accept().and_then(|(stream, _)| {
            stream.set_nonblocking(true)?;
            Ok::<_, io::Error>(stream)
        });
        let (lines, format) = (Lines::default(), Format::Unknown);
        accepted.ok().map(|stream| Writer { stream, lines, format, is_known_for_errors: false })
    }
}

impl Drop for PoseSocket {
    fn drop(&mut self) {
        if identity(&self.path).is_ok_and(|identity| identity == self.identity) {
            // Nobody is told if that fails: the next run replaces it.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Whether there is a socket on which nobody listens any more.
fn is_left_over(path: &Path) -> bool {
    let is_socket = path.symlink_metadata().is_ok_and(|metadata| metadata.file_type().is_socket());
    let is_refused = |error: io::Error| error.kind() == io::ErrorKind::ConnectionRefused;
    is_socket && UnixStream::connect(path).err().is_some_and(is_refused)
}

/// Device and number of the file at `path`.
fn identity(path: &Path) -> io::Result<[u64; 2]> {
    path.symlink_metadata().map(|metadata| [metadata.dev(), metadata.ino()])
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn read(socket: &mut PoseSocket) -> (Vec<(i64, f64)>, Option<String>) {
        let mut poses = Vec::new();
        let notice = socket.read(|nanos, pose| poses.push((nanos, pose.position_metres[0])));
        (poses, notice)
    }

    #[test]
    fn lines_of_several_writers_are_heard_and_wrong_ones_complained_of_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pose.sock");
        let mut socket = PoseSocket::listen(&path).unwrap();
        let [mut one, mut other] = [(), ()].map(|()| UnixStream::connect(&path).unwrap());
        one.write_all(b"1.5 7 0 0 0 0 0 1\n2 8 0 0 0 0 0 1\n3 9").unwrap();
        other.write_all(b"1 5 0 0 0 0 0 1\nnonsense\nmore of it\n").unwrap();
        let (poses, notice) = read(&mut socket);
        assert_eq!(poses, [(1_500_000_000, 7.0), (2_000_000_000, 8.0), (1_000_000_000, 5.0)]);
        let notice = notice.unwrap();
        assert!(notice.contains("pose.sock: expected eight numbers"), "{notice}");
        one.write_all(b" 0 0 0 0 0 1\n").unwrap();
        other.write_all(b"still nonsense\n").unwrap();
        assert_eq!(read(&mut socket), (vec![(3_000_000_000, 9.0)], None));
        drop((one, other));
        read(&mut socket);
        assert!(socket.writers.is_empty());
    }

    #[test]
    fn a_socket_that_was_left_is_replaced_but_nothing_else_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pose.sock");
        drop(UnixListener::bind(&path).unwrap());
        assert!(path.exists(), "its file stays");
        let socket = PoseSocket::listen(&path).unwrap();
        assert!(PoseSocket::listen(&path).is_err(), "somebody listens");
        drop(socket);
        assert!(!path.exists());
        let datagrams = std::os::unix::net::UnixDatagram::bind(&path).unwrap();
        assert!(PoseSocket::listen(&path).is_err(), "a socket of another kind is in use");
        drop(datagrams);
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, "a file").unwrap();
        let error = PoseSocket::listen(&path).unwrap_err().to_string();
        assert!(error.ends_with("name a path at which nothing is"), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), b"a file");
    }
}
