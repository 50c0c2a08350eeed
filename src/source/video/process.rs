//! A child process that can neither hang nor outlive us, read without threads.
//!
//! A child whose messages nobody fetches stops when its pipe is full, and reading two pipes in turn may
//! deadlock. Here messages go into a socket whose far end does not block: what does not fit is lost, and
//! that is the bound. Sockets also know timeouts, which pipes do not.

use std::io::{self, ErrorKind, Read};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// How much is kept of what a child says; the first messages name the cause.
const MAX_LOG_BYTES: usize = 4096;
/// Longest message that is passed on, in characters.
const MAX_COMPLAINT_CHARS: usize = 160;

/// Two ends of a channel: ours, which gives up after `patience` without data, and the child's.
pub(super) fn channel(patience: Duration) -> io::Result<(UnixStream, Stdio)> {
    let (ours, theirs) = UnixStream::pair()?;
    ours.set_read_timeout(Some(patience))?;
    Ok((ours, OwnedFd::from(theirs).into()))
}

/// A running child; dropped, it is killed and reaped.
#[derive(Debug)]
pub(super) struct Process {
    child: Child,
    log: UnixStream,
    patience: Duration,
}

impl Process {
    /// Starts `command`, which is used up: were it kept, so were the child's ends of the channels, and
    /// they would never end.
    pub(super) fn spawn(mut command: Command, patience: Duration) -> Result<Self, String> {
        let program = command.get_program().to_string_lossy().into_owned();
        let mut spawn = || {
            let (log, theirs) = UnixStream::pair()?;
            log.set_read_timeout(Some(patience))?;
            theirs.set_nonblocking(true)?;
            // Ctrl-C is for us alone: we decide whether the frames under way are still wanted.
            let child = command.stderr(OwnedFd::from(theirs)).process_group(0).spawn()?;
            Ok(Self { child, log, patience })
        };
        spawn().map_err(|error: io::Error| match error.kind() {
            ErrorKind::NotFound => {
                format!("{program} is not installed; install ffmpeg: `apt install ffmpeg`")
            }
            _ => format!("{program} cannot be started: {error}; see whether `{program} -version` works"),
        })
    }

    /// Waits for the end of a child that has closed its output.
    ///
    /// # Errors
    /// What it complained of first, or that it failed or does not end.
    pub(super) fn finish(&mut self) -> Result<(), String> {
        let (log, has_ended) = self.rest_of_log();
        if !has_ended {
            let _ = self.child.kill();
            return Err(format!("ffmpeg did not end within {} s", self.patience.as_secs()));
        }
        let status = self.child.wait().map_err(|error| error.to_string())?;
        match complaint(&log) {
            Some(complaint) => Err(complaint),
            None if status.success() => Ok(()),
            None => Err(format!("ffmpeg stopped with {status}")),
        }
    }

    /// The begin of what the child said, and whether it fell silent because it ended.
    fn rest_of_log(&mut self) -> (Vec<u8>, bool) {
        let deadline = Instant::now() + self.patience;
        let mut log = Vec::new();
        let mut chunk = [0; 1024];
        while Instant::now() < deadline {
            match self.log.read(&mut chunk) {
                Ok(0) => return (log, true),
                Ok(count) => {
                    let kept = count.min(MAX_LOG_BYTES - log.len());
                    log.extend_from_slice(&chunk[..kept]);
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => break,
            }
        }
        (log, false)
    }

    #[cfg(test)]
    pub(super) fn id(&self) -> u32 {
        self.child.id()
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // Both do nothing to a child that was waited for.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The first line of `log`, without the `[mov @ 0x55d0]` that ffmpeg puts before some.
fn complaint(log: &[u8]) -> Option<String> {
    let log = String::from_utf8_lossy(log);
    let line = log.lines().map(str::trim).find(|line| !line.is_empty())?;
    let text = match line.strip_prefix('[').and_then(|rest| rest.split_once("] ")) {
        Some((origin, text)) if origin.contains(" @ ") => text,
        _ => line,
    };
    let printable = text.trim_end_matches('.').chars().filter(|c| !c.is_control());
    Some(printable.take(MAX_COMPLAINT_CHARS).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::PathBuf;

    const PATIENCE: Duration = Duration::from_millis(300);
    const LONG: Duration = Duration::from_secs(20);

    fn shell(script: &str, patience: Duration) -> (Process, UnixStream) {
        let (ours, theirs) = channel(patience).unwrap();
        let mut command = Command::new("sh");
        command.args(["-c", script]).stdin(Stdio::null()).stdout(theirs);
        (Process::spawn(command, patience).unwrap(), ours)
    }

    fn is_in_process_table(id: u32) -> bool {
        PathBuf::from(format!("/proc/{id}")).exists()
    }

    #[test]
    fn a_child_that_floods_its_log_still_delivers_its_output() {
        let script =
            "i=0; while [ $i -lt 20000 ]; do echo \"[a @ 0x1] flood $i\" >&2; i=$((i+1)); done; echo done";
        let (mut process, mut output) = shell(script, LONG);
        let mut text = String::new();
        output.read_to_string(&mut text).unwrap();
        assert_eq!(text, "done\n");
        assert_eq!(process.finish().unwrap_err(), "flood 0");
    }

    #[test]
    fn a_child_that_hangs_is_given_up_and_reaped() {
        let (mut process, mut output) = shell("exec sleep 1000", PATIENCE);
        let id = process.id();
        assert!(is_in_process_table(id));
        let error = output.read(&mut [0; 8]).unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut), "{error}");
        assert_eq!(process.finish().unwrap_err(), "ffmpeg did not end within 0 s");
        drop(process);
        assert!(!is_in_process_table(id));
    }

    #[test]
    fn a_failure_without_a_word_is_told_all_the_same() {
        let (mut process, _output) = shell("exit 3", LONG);
        assert_eq!(process.finish().unwrap_err(), "ffmpeg stopped with exit status: 3");
        let (mut process, _output) = shell("exit 0", LONG);
        assert_eq!(process.finish(), Ok(()));
    }

    #[test]
    fn a_complaint_is_one_printable_line_of_bounded_length() {
        assert_eq!(
            complaint(b"\n [mov,mp4 @ 0x55] moov atom not found.\nfile:x: Invalid"),
            Some("moov atom not found".to_owned())
        );
        assert_eq!(complaint(b"a\x1b[31mb \xff"), Some("a[31mb \u{fffd}".to_owned()));
        assert_eq!(complaint(&[b'x'; 5000]).unwrap().len(), MAX_COMPLAINT_CHARS);
        assert_eq!(complaint(b" \n\n"), None);
    }
}
