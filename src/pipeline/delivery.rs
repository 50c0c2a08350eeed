//! Records on their way to the sinks, each of which has a queue and a thread of its own: a slow one holds up no other.
//!
//! A stream that can wait does so for its sinks, so that none misses a record. A live one goes on: a sink that is slow
//! misses records, which are counted, and one that fails is left out.

use std::ops::ControlFlow;
use std::panic;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};

use super::{PipelineError, QUEUE_FRAMES, Watcher, stages};
use crate::telemetry::{FrameRecord, RecognitionSink, TelemetryError};

/// Records of a live stream that wait for a sink at most.
const LIVE_RECORDS: usize = 8;
/// How long the sinks of a live stream may take at its end, all together: longer than a viewer that is slow may.
const CLOSING: Duration = Duration::from_secs(if cfg!(test) { 1 } else { 25 });

/// Hands out records.
pub(super) struct Delivery {
    sinks: Vec<Outlet>,
    pub(super) is_live: bool,
    /// Records that a sink was too slow to take, so far.
    pub(super) missed: u64,
    /// Sinks that failed and were left out.
    failed: u64,
}

/// What leads to a sink.
struct Outlet {
    queue: Sender<Arc<FrameRecord>>,
    ended: Receiver<Result<(), TelemetryError>>,
    thread: JoinHandle<()>,
}

impl Delivery {
    /// Starts a thread for every sink.
    ///
    /// # Errors
    /// If the system has no thread left.
    pub(super) fn start(sinks: Vec<Box<dyn RecognitionSink>>, is_live: bool) -> Result<Self, PipelineError> {
        let sinks = (1..).zip(sinks).map(|(number, sink)| Outlet::start(sink, number, is_live));
        Ok(Self { sinks: sinks.collect::<Result<_, _>>()?, is_live, missed: 0, failed: 0 })
    }

    /// Most records that wait for one of the sinks.
    pub(super) fn waiting(&self) -> usize {
        self.sinks.iter().map(|sink| sink.queue.len()).max().unwrap_or_default()
    }

    /// Hands a record to every sink; breaks off where whoever read the output has gone.
    ///
    /// # Errors
    /// If a sink failed, and the stream is not live.
    pub(super) fn deliver(
        &mut self,
        record: &Arc<FrameRecord>,
        watcher: &dyn Watcher,
    ) -> Result<ControlFlow<()>, PipelineError> {
        let mut position = 0;
        while let Some(sink) = self.sinks.get(position) {
            match sink.put(record, self.is_live) {
                Ok(()) => position += 1,
                Err(TrySendError::Full(_)) => {
                    self.missed += 1;
                    position += 1;
                }
                Err(TrySendError::Disconnected(_)) => match self.sinks.remove(position).end(self.is_live) {
                    Err(TelemetryError::ReaderGone) | Ok(()) => return Ok(ControlFlow::Break(())),
                    Err(error) if self.is_live => {
                        watcher.sink_failed(&error);
                        self.failed += 1;
                    }
                    Err(error) => return Err(error.into()),
                },
            }
        }
        Ok(ControlFlow::Continue(()))
    }

    /// Waits until the sinks have everything; those of a live stream for a while. Answers how many failed.
    ///
    /// # Errors
    /// If one failed, and the stream is not live.
    pub(super) fn finish(mut self, watcher: &dyn Watcher) -> Result<u64, PipelineError> {
        let deadline = Instant::now() + CLOSING;
        let ends: Vec<_> = self.sinks.into_iter().map(Outlet::close).collect();
        let mut first_failure = Ok(());
        for (ended, thread) in ends {
            if self.is_live {
                // One that hangs is left to the end of the program.
                let answer = ended.recv_deadline(deadline).unwrap_or(Err(TelemetryError::Stuck));
                if let Err(error) = answer.or_else(TelemetryError::unless_reader_gone) {
                    watcher.sink_failed(&error);
                    self.failed += 1;
                }
                continue;
            }
            // All have their time, whichever of them failed.
            let end = joined(&ended, thread).or_else(TelemetryError::unless_reader_gone);
            first_failure = first_failure.and(end);
        }
        first_failure?;
        Ok(self.failed)
    }
}

impl Outlet {
    fn start(
        mut sink: Box<dyn RecognitionSink>,
        number: usize,
        is_live: bool,
    ) -> Result<Self, PipelineError> {
        let (queue, records) = bounded::<Arc<FrameRecord>>(if is_live { LIVE_RECORDS } else { QUEUE_FRAMES });
        let (to_ended, ended) = bounded(1);
        let deliver = move || {
            let delivered = records.iter().try_for_each(|record| sink.record(&record));
            // Before anybody hears of the end, nobody may be left waiting for room.
            drop(records);
            // Nobody may wait for it any more.
            let _ = to_ended.send(delivered.and_then(|()| sink.finish()));
        };
        let thread = stages::named(&format!("sink-{number}")).spawn(deliver)?;
        Ok(Self { queue, ended, thread })
    }

    fn put(&self, record: &Arc<FrameRecord>, is_live: bool) -> Result<(), TrySendError<Arc<FrameRecord>>> {
        if is_live {
            return self.queue.try_send(Arc::clone(record));
        }
        self.queue.send(Arc::clone(record)).map_err(|refused| TrySendError::Disconnected(refused.0))
    }

    /// How a sink ended that takes nothing any more.
    fn end(self, is_live: bool) -> Result<(), TelemetryError> {
        let (ended, thread) = self.close();
        if is_live {
            // It may have more to clear away than a live stream waits for.
            return ended.recv().unwrap_or(Err(TelemetryError::Stuck));
        }
        joined(&ended, thread)
    }

    fn close(self) -> (Receiver<Result<(), TelemetryError>>, JoinHandle<()>) {
        (self.ended, self.thread)
    }
}

/// What a sink answered at its end; a panic, a defect of ours, goes on in the caller.
fn joined(
    ended: &Receiver<Result<(), TelemetryError>>,
    thread: JoinHandle<()>,
) -> Result<(), TelemetryError> {
    let answer = ended.recv();
    thread.join().unwrap_or_else(|defect| panic::resume_unwind(defect));
    answer.unwrap_or(Ok(()))
}
