//! Lines on stderr, above whatever is shown there. A thread of their own writes them, so that a live stream does not
//! wait for a terminal that is stopped or a reader that is slow.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use indicatif::ProgressBar;

use super::console::counted;

/// Lines that wait to be written at most.
const MOST_WAITING: usize = 64;
/// Of what may come with every frame, one is told in this time.
const REPETITION: Duration = Duration::from_secs(10);

/// Says lines. When it is dropped, all of them have been written.
pub(super) struct Voice {
    /// `None` once the last line was said.
    lines: Option<SyncSender<String>>,
    left_out: Arc<AtomicU64>,
    writer: Option<JoinHandle<()>>,
}

impl Voice {
    /// A voice that is heard above `shown`.
    pub(super) fn above(shown: ProgressBar) -> io::Result<Self> {
        Self::to(move |line| {
            // Where nobody can be told, nobody can be told that.
            shown.suspend(|| drop(writeln!(io::stderr(), "loci: {line}")));
        })
    }

    fn to(write: impl Fn(&str) + Send + 'static) -> io::Result<Self> {
        let (lines, said) = sync_channel(MOST_WAITING);
        let left_out = Arc::<AtomicU64>::default();
        let counter = Arc::clone(&left_out);
        let writer = thread::Builder::new().name("loci-voice".to_owned());
        let writer = writer.spawn(move || write_all(&said, &counter, write))?;
        Ok(Self { lines: Some(lines), left_out, writer: Some(writer) })
    }

    /// Says a line; waits for room unless the line `may_be_left_out`.
    pub(super) fn say(&self, line: String, may_be_left_out: bool) {
        let Some(lines) = &self.lines else { return };
        match lines.try_send(line) {
            Err(TrySendError::Full(_)) if may_be_left_out => {
                self.left_out.fetch_add(1, Ordering::Relaxed);
            }
            // The writer goes only after this voice.
            Err(TrySendError::Full(line)) => drop(lines.send(line)),
            _ => {}
        }
    }
}

impl Drop for Voice {
    fn drop(&mut self) {
        self.lines = None;
        // It only writes; there is nothing to hear of it.
        self.writer.take().map(JoinHandle::join);
    }
}

fn write_all(lines: &Receiver<String>, left_out: &AtomicU64, write: impl Fn(&str)) {
    let tell_left_out = || match left_out.swap(0, Ordering::Relaxed) {
        0 => {}
        count => write(&format!("{} left out, for nobody read them in time", counted(count, "message"))),
    };
    for line in lines {
        write(&line);
        tell_left_out();
    }
    tell_left_out();
}

/// What may come with every frame and is told now and then.
#[derive(Debug, Default)]
pub(super) struct Repeated {
    told: Option<Instant>,
    untold: u64,
}

impl Repeated {
    /// It came at this time: whether it is told, and if so, how many were not since the last one that was.
    pub(super) fn came(&mut self, now: Instant) -> Option<u64> {
        if self.told.is_some_and(|told| now.saturating_duration_since(told) < REPETITION) {
            self.untold += 1;
            return None;
        }
        self.told = Some(now);
        Some(std::mem::take(&mut self.untold))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    /// A voice whose lines are collected, each as soon as it is allowed by a message.
    fn collected() -> (Voice, SyncSender<()>, Arc<Mutex<Vec<String>>>) {
        let (allow, allowed) = sync_channel::<()>(1000);
        let heard = Arc::<Mutex<Vec<String>>>::default();
        let ear = Arc::clone(&heard);
        let voice = Voice::to(move |line| {
            let _ = allowed.recv();
            ear.lock().unwrap().push(line.to_owned());
        });
        (voice.unwrap(), allow, heard)
    }

    #[test]
    fn all_lines_were_written_when_the_voice_ends() {
        let (voice, allow, heard) = collected();
        drop(allow);
        (0..200).for_each(|number| voice.say(number.to_string(), false));
        drop(voice);
        assert_eq!(*heard.lock().unwrap(), Vec::from_iter((0..200).map(|number| number.to_string())));
    }

    #[test]
    fn whoever_may_leave_lines_out_does_not_wait_and_how_many_were_is_said() {
        let (voice, allow, heard) = collected();
        (0..200).for_each(|number| voice.say(number.to_string(), true));
        assert!(heard.lock().unwrap().is_empty());
        drop(allow);
        drop(voice);
        let heard = heard.lock().unwrap();
        let notes: Vec<u64> = heard
            .iter()
            .filter_map(|line| line.strip_suffix(" left out, for nobody read them in time"))
            .map(|count| count.split(' ').next().unwrap().parse().unwrap())
            .collect();
        assert_eq!(heard.len() - notes.len() + notes.iter().sum::<u64>() as usize, 200, "{heard:?}");
        assert_eq!(notes.len(), 1, "{heard:?}");
    }

    #[test]
    fn what_comes_again_and_again_is_told_now_and_then_with_how_often() {
        let start = Instant::now();
        let mut damage = Repeated::default();
        let told = |damage: &mut Repeated, seconds| damage.came(start + Duration::from_secs(seconds));
        assert_eq!(told(&mut damage, 0), Some(0));
        assert_eq!([1, 5, 9].map(|seconds| told(&mut damage, seconds)), [None; 3]);
        assert_eq!(told(&mut damage, 10), Some(3));
        assert_eq!(told(&mut damage, 60), Some(0));
    }
}
