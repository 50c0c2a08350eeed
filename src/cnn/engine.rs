//! The only code that speaks to ONNX Runtime (crate `ort`) and hashes (crate `sha2`).
//!
//! `ort` holds one library and one environment a process, both for good, and panics when it is asked for
//! anything before a library is loaded. So this module remembers what it loaded, and a [`Network`] can only
//! be made from a [`Library`].

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use ort::environment::Environment;
use ort::logging::LogLevel;
use ort::memory::Allocator;
use ort::session::builder::{GraphOptimizationLevel, SessionBuilder};
use ort::session::{HasSelectedOutputs, OutputSelector, RunOptions, Session};
#[cfg(feature = "train")]
use ort::value::TensorRef;
use ort::value::{Outlet, Tensor, TensorElementType, ValueType};
use sha2::{Digest, Sha256};

use super::error::{CnnError, one_line};
use super::signature::Port;

/// What this process loaded; `ort` can never unload it.
static LOADED: Mutex<Option<Loaded>> = Mutex::new(None);

struct Loaded {
    path: PathBuf,
    library: Library,
}

/// A loaded ONNX Runtime with its environment.
#[derive(Clone, Debug)]
pub(super) struct Library {
    environment: Environment,
}

/// This build has a CNN.
pub(super) fn built() -> Result<(), CnnError> {
    Ok(())
}

/// Loads a library that was checked before, or gives the one that this process holds if it is the same file.
pub(super) fn load(path: &Path) -> Result<Library, CnnError> {
    let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
    match &*loaded {
        Some(Loaded { path: held, library }) if held == path => return Ok(library.clone()),
        Some(Loaded { path: held, .. }) => {
            return Err(CnnError::AnotherRuntimeLoaded { loaded: held.clone(), wanted: path.to_path_buf() });
        }
        None => {}
    }
    let refuse =
        |reason: String| CnnError::RuntimeStart { path: path.to_path_buf(), reason: one_line(&reason) };
    let builder = ort::init_from(path).map_err(|error| refuse(error.to_string()))?;
    // Failures come back as errors and are told once; ONNX Runtime's own log would tell them a second time.
    let silent = Arc::new(|_: LogLevel, _: &str, _: &str, _: &str, _: &str| {});
    let builder = builder.with_name("loci").with_telemetry(false).with_logger(silent);
    let environment = builder.build().map_err(|error| refuse(error.to_string()))?;
    environment.set_log_level(LogLevel::Fatal);
    let library = Library { environment };
    *loaded = Some(Loaded { path: path.to_path_buf(), library: library.clone() });
    Ok(library)
}

/// SHA-256 as 64 lower-case hexadecimal digits.
pub(super) fn sha256_hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A network that is ready to run. Errors are ONNX Runtime's words on one line.
#[derive(Debug)]
pub(super) struct Network {
    session: Session,
}

impl Network {
    /// A network from the bytes of an ONNX file, run by `threads` threads.
    pub(super) fn from_onnx(library: &Library, bytes: &[u8], threads: usize) -> Result<Self, String> {
        let words = |error: ort::Error| one_line(&error.to_string());
        let mut builder = session_builder(&library.environment, threads).map_err(words)?;
        Ok(Self { session: builder.commit_from_memory(bytes).map_err(words)? })
    }

    pub(super) fn inputs(&self) -> Vec<Port> {
        self.session.inputs().iter().map(port).collect()
    }

    pub(super) fn outputs(&self) -> Vec<Port> {
        self.session.outputs().iter().map(port).collect()
    }

    /// What the file's metadata say under `key`.
    #[cfg(feature = "train")]
    pub(super) fn described(&self, key: &str) -> Option<String> {
        self.session.metadata().ok()?.custom(key)
    }

    /// Runs the network on one tensor and copies every output, in the order of [`outputs`](Self::outputs).
    #[cfg(feature = "train")]
    pub(super) fn run_all(&mut self, input: (&str, [usize; 4], &[f32])) -> Result<Vec<Vec<f32>>, String> {
        let words = |error: ort::Error| one_line(&error.to_string());
        let (name, shape, values) = input;
        let tensor = TensorRef::from_array_view((shape, values)).map_err(words)?;
        let outputs = self.session.run(ort::inputs![name => tensor]).map_err(words)?;
        let copied = |output: ort::value::DynValue| {
            output.try_extract_tensor::<f32>().map(|(_, values)| values.to_vec())
        };
        outputs.into_iter().map(|(_, output)| copied(output).map_err(words)).collect()
    }

    /// The network with memory for its one input and for one of its outputs, of these shapes.
    pub(super) fn prepared(
        self,
        input_shape: [usize; 4],
        (output, output_shape): (&str, [usize; 2]),
    ) -> Result<PreparedNetwork, String> {
        let words = |error: ort::Error| one_line(&error.to_string());
        let input = Tensor::new(&Allocator::default(), input_shape).map_err(words)?;
        let answer = Tensor::<f32>::new(&Allocator::default(), output_shape).map_err(words)?;
        let outputs = OutputSelector::no_default().with(output).preallocate(output, answer);
        let options = RunOptions::new().map_err(words)?.with_outputs(outputs);
        Ok(PreparedNetwork { session: self.session, input, options })
    }

    /// Runs the network on one tensor and copies one output with its shape.
    #[cfg(feature = "train")]
    pub(super) fn run_shaped(
        &mut self,
        input: (&str, [usize; 4], &[f32]),
        output: &str,
    ) -> Result<(Vec<i64>, Vec<f32>), String> {
        let words = |error: ort::Error| one_line(&error.to_string());
        let (name, shape, values) = input;
        let tensor = TensorRef::from_array_view((shape, values)).map_err(words)?;
        let outputs = self.session.run(ort::inputs![name => tensor]).map_err(words)?;
        let output = outputs.get(output).ok_or_else(|| format!("no output `{output}`"))?;
        let (shape, values) = output.try_extract_tensor::<f32>().map_err(words)?;
        Ok((shape.to_vec(), values.to_vec()))
    }
}

/// A network that writes every answer into the same memory, so that `ort` asks for none when it runs.
pub(super) struct PreparedNetwork {
    session: Session,
    input: Tensor<f32>,
    /// They say which output is wanted, and hold its memory.
    options: RunOptions<HasSelectedOutputs>,
}

impl fmt::Debug for PreparedNetwork {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.debug_struct("PreparedNetwork").field("session", &self.session).finish_non_exhaustive()
    }
}

impl PreparedNetwork {
    /// What the network is run on next, to be written over.
    pub(super) fn input(&mut self) -> &mut [f32] {
        self.input.extract_tensor_mut().1
    }

    /// Runs the network on its input and writes its answer over what is in `answer`.
    pub(super) fn run(&mut self, answer: &mut Vec<f32>) -> Result<(), String> {
        let words = |error: ort::Error| one_line(&error.to_string());
        let Self { session, input, options } = self;
        let outputs = session.run_with_options(ort::inputs![&*input], options).map_err(words)?;
        let (_, values) = outputs[0].try_extract_tensor::<f32>().map_err(words)?;
        answer.clear();
        answer.extend_from_slice(values);
        Ok(())
    }
}

/// One thread pool of its own, sequential, and asleep between frames: measured fastest and kindest to the
/// rest of the robot.
fn session_builder(environment: &Environment, threads: usize) -> ort::Result<SessionBuilder> {
    let builder = Session::builder(environment)?
        .with_optimization_level(GraphOptimizationLevel::All)?
        .with_parallel_execution(false)?
        .with_intra_threads(threads)?
        .with_inter_threads(1)?
        .with_intra_op_spinning(false)?
        .with_inter_op_spinning(false)?
        .with_log_level(LogLevel::Fatal)?;
    Ok(builder)
}

fn port(outlet: &Outlet) -> Port {
    let float_shape = match outlet.dtype() {
        ValueType::Tensor { ty: TensorElementType::Float32, shape, .. } => Some(shape.to_vec()),
        _ => None,
    };
    Port { name: outlet.name().to_owned(), float_shape }
}
