//! A viewer that looks on while the stream runs, and can never hold it up.
//!
//! rerun's own sinks push back: once a hundred messages wait for a viewer that is absent, stopped or
//! on a slow network, logging blocks, and so does dropping the sink. So a [`Relay`] stands between:
//! it queues messages up to a budget of bytes, drops what goes beyond, and a thread of its own does
//! the waiting. At the end the viewer gets the rest as long as it keeps taking it.

use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use ::rerun::log::{ChunkBatcherConfig, LogMsg};
use ::rerun::sink::{GrpcSink, GrpcSinkConnectionState, LogSink, SinkFlushError};
use ::rerun::{MemoryLimit, ServerOptions, SizeBytes};

use super::target::{DEFAULT_PORT, LOCALHOST, one_line};

/// Bytes that wait for a viewer at most; frames are left out from half of it on.
const BUDGET_BYTES: u64 = 64 << 20;
/// What a message costs besides its contents.
const MESSAGE_BYTES: u64 = 1 << 10;
/// Bytes of the past that a served recording keeps for viewers that come late.
const SERVED_PAST_BYTES: u64 = 256 << 20;
/// How long a viewer may take nothing at the end before it is given up.
const PATIENCE: Duration = Duration::from_secs(2);
/// How long the end may take in all.
const MAX_CLOSING: Duration = Duration::from_secs(20);
/// How long a viewer may take to start.
const MAX_STARTING: Duration = Duration::from_secs(20);

const NO_VIEWER: &str =
    "no viewer is installed; pip install rerun-sdk==0.36.3, or cargo install --locked rerun-cli@0.36.3";

/// The stream's end of the queue to a viewer.
pub(super) struct Relay {
    queue: Sender<Parcel>,
    state: Arc<State>,
}

/// The sink's handle on the queue: how full it is, and its end.
pub(super) struct Live {
    queue: Sender<Parcel>,
    state: Arc<State>,
    closed: Receiver<()>,
}

enum Parcel {
    Message(Box<LogMsg>, u64),
    Close,
}

#[derive(Default)]
struct State {
    waiting_bytes: AtomicU64,
    taken: AtomicU64,
    /// Whether a viewer was ever there.
    reached: AtomicBool,
}

/// A viewer at the other end of a relay.
trait Viewer: LogSink {
    /// Whether somebody was ever there to take messages.
    fn is_reached(&self) -> bool;
}

impl Viewer for GrpcSink {
    fn is_reached(&self) -> bool {
        !matches!(self.status(), GrpcSinkConnectionState::Connecting { .. })
    }
}

impl Viewer for ::rerun::grpc_server::GrpcServerSink {
    /// It keeps what it takes, whether somebody looks or not.
    fn is_reached(&self) -> bool {
        true
    }
}

/// A relay to the viewer at `address`, `HOST:PORT`, whenever it answers.
pub(super) fn connect(address: &str) -> Result<(Relay, Live), String> {
    let url = format!("rerun+http://{address}/proxy");
    let uri = url.parse().map_err(|error| one_line(&format!("{url} is no address of a viewer: {error}")))?;
    relay(GrpcSink::new(uri)).map_err(|error| error.to_string())
}

/// A relay to a server of our own at `address`.
pub(super) fn serve(address: SocketAddr) -> Result<(Relay, Live), String> {
    // rerun's server would only log that it cannot listen.
    TcpListener::bind(address)
        .map_err(|error| format!("cannot listen there: {error}; choose another port"))?;
    let memory_limit = MemoryLimit::from_bytes(SERVED_PAST_BYTES);
    let options = ServerOptions { memory_limit, ..ServerOptions::default() };
    let server = ::rerun::grpc_server::GrpcServerSink::new(&bind_ip(address), address.port(), options);
    relay(server.map_err(|error| error.to_string())?).map_err(|error| error.to_string())
}

/// The IP as rerun puts it before `:PORT`.
fn bind_ip(address: SocketAddr) -> String {
    match address {
        SocketAddr::V4(address) => address.ip().to_string(),
        SocketAddr::V6(address) => format!("[{}]", address.ip()),
    }
}

/// Starts the program `viewer` unless a viewer listens already, waits for it, and relays to it.
pub(super) fn spawn(viewer: &str) -> Result<(Relay, Live), String> {
    let address = SocketAddr::new(LOCALHOST, DEFAULT_PORT);
    let is_listening = || TcpStream::connect_timeout(&address, Duration::from_millis(200)).is_ok();
    if !is_listening() {
        let mut child = viewer_command(viewer).spawn().map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => NO_VIEWER.to_owned(),
            _ => format!("the viewer cannot be started: {error}"),
        })?;
        let started = Instant::now();
        while !is_listening() {
            if let Ok(Some(status)) = child.try_wait()
                && !status.success()
            {
                return Err(format!(
                    "the viewer ended at once ({status}); is there a display? try save=run.rrd"
                ));
            }
            if started.elapsed() > MAX_STARTING {
                return Err(format!(
                    "the viewer does not answer at {address}; start `rerun` and use connect"
                ));
            }
            thread::sleep(Duration::from_millis(50));
        }
    }
    connect(&address.to_string())
}

/// Opens the recording `file` in the program `viewer`, which stays open.
pub(super) fn open(viewer: &str, file: &Path) -> Result<(), String> {
    let spawned = viewer_command(viewer).arg(file).spawn();
    spawned.map(drop).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => NO_VIEWER.to_owned(),
        _ => format!("the viewer cannot be started: {error}"),
    })
}

/// rerun's own `spawn` listens to every network and keeps our standard output open, so that a program
/// we are piped into would wait for the viewer to be closed.
fn viewer_command(viewer: &str) -> Command {
    let mut command = Command::new(viewer);
    command.args(["--bind", "127.0.0.1", "--hide-welcome-screen", "--expect-data-soon"]);
    command.arg(format!("--port={DEFAULT_PORT}")).stdin(Stdio::null()).stdout(Stdio::null());
    // Of what it has to say only failures belong among our own diagnostics.
    command.env("RUST_LOG", "error");
    // Ctrl-C is for us; the viewer stays open.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    command
}

fn relay(viewer: impl Viewer) -> io::Result<(Relay, Live)> {
    let (queue, parcels) = channel();
    let (to_closed, closed) = channel();
    let state = Arc::new(State::default());
    let forwarded = Arc::clone(&state);
    // Not joined: it may hang on the viewer for as long as the program runs.
    thread::Builder::new()
        .name("loci-viewer".to_owned())
        .spawn(move || forward(viewer, parcels, &forwarded, &to_closed))?;
    Ok((Relay { queue: queue.clone(), state: Arc::clone(&state) }, Live { queue, state, closed }))
}

fn forward(viewer: impl Viewer, parcels: Receiver<Parcel>, state: &State, to_closed: &Sender<()>) {
    for parcel in parcels {
        let Parcel::Message(message, bytes) = parcel else { break };
        viewer.send(*message);
        state.waiting_bytes.fetch_sub(bytes, Ordering::Relaxed);
        state.taken.fetch_add(1, Ordering::Relaxed);
        state.reached.store(viewer.is_reached(), Ordering::Relaxed);
    }
    if viewer.flush_blocking(PATIENCE).is_ok() {
        state.reached.store(true, Ordering::Relaxed);
    }
    // A flush hands over to the network; only the drop waits until the viewer has everything.
    drop(viewer);
    let _ = to_closed.send(());
}

impl LogSink for Relay {
    fn send(&self, message: LogMsg) {
        let bytes = message.total_size_bytes() + MESSAGE_BYTES;
        if self.state.waiting_bytes.load(Ordering::Relaxed) + bytes > BUDGET_BYTES {
            return;
        }
        self.state.waiting_bytes.fetch_add(bytes, Ordering::Relaxed);
        let _ = self.queue.send(Parcel::Message(Box::new(message), bytes));
    }

    /// Everything is in the queue already; [`Live::close`] waits for the viewer.
    fn flush_blocking(&self, _: Duration) -> Result<(), SinkFlushError> {
        Ok(())
    }

    fn default_batcher_config(&self) -> ChunkBatcherConfig {
        ChunkBatcherConfig::LOW_LATENCY
    }
}

impl Live {
    /// Whether the viewer is so far behind that a frame had better be left out.
    pub(super) fn is_behind(&self) -> bool {
        self.state.waiting_bytes.load(Ordering::Relaxed) > BUDGET_BYTES / 2
    }

    /// Waits until the viewer has what is queued, as long as it takes any of it; answers whether there
    /// ever was a viewer.
    pub(super) fn close(self) -> bool {
        let started = Instant::now();
        let _ = self.queue.send(Parcel::Close);
        let mut taken = self.state.taken.load(Ordering::Relaxed);
        while self.closed.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout) {
            let before = taken;
            taken = self.state.taken.load(Ordering::Relaxed);
            if taken == before || started.elapsed() > MAX_CLOSING {
                break;
            }
        }
        self.state.reached.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A viewer that takes nothing, like one that was stopped.
    struct Stopped;

    impl LogSink for Stopped {
        fn send(&self, _: LogMsg) {
            loop {
                thread::park();
            }
        }

        fn flush_blocking(&self, _: Duration) -> Result<(), SinkFlushError> {
            Ok(())
        }
    }

    impl Viewer for Stopped {
        fn is_reached(&self) -> bool {
            false
        }
    }

    #[test]
    fn a_viewer_that_takes_nothing_blocks_nobody_and_costs_bounded_memory() {
        let (relay, live) = relay(Stopped).unwrap();
        let state = Arc::clone(&live.state);
        let stream = ::rerun::RecordingStreamBuilder::new("test").buffered().unwrap();
        stream.set_sink(Box::new(relay));
        let started = Instant::now();
        for _ in 0..100 {
            let image = ::rerun::Image::from_rgb24(vec![0; 3 << 20], [1024, 1024]);
            stream.log("image", &image).unwrap();
        }
        stream.flush_with_timeout(Duration::from_secs(5)).unwrap();
        assert!(live.is_behind());
        assert!(state.waiting_bytes.load(Ordering::Relaxed) <= BUDGET_BYTES);
        drop(stream);
        assert!(!live.close(), "nobody was reached");
        assert!(started.elapsed() < Duration::from_secs(30), "took {:?}", started.elapsed());
    }

    #[test]
    fn an_address_in_use_is_refused_by_name() {
        let taken = TcpListener::bind((LOCALHOST, 0)).unwrap();
        let error = serve(taken.local_addr().unwrap()).err().unwrap();
        assert!(error.starts_with("cannot listen there: ") && !error.contains('\n'), "{error}");
    }

    #[test]
    fn a_viewer_that_is_not_installed_is_named_with_the_fix() {
        if TcpStream::connect((LOCALHOST, DEFAULT_PORT)).is_ok() {
            return; // Then a viewer is running, and none is started.
        }
        let error = spawn("no-such-viewer").err().unwrap();
        assert!(error.contains("pip install rerun-sdk==0.36.3") && !error.contains('\n'), "{error}");
    }
}
