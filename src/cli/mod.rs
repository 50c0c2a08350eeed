//! The commands, one file each, and what they share: arguments, exit codes, settings.
//!
//! Results go to stdout, everything else to stderr. Exit codes: 0 done, 1 failed, 2 wrong arguments,
//! 3 done but something was lost or skipped.

mod assets;
mod console;
mod demo;
mod devices;
mod doctor;
#[cfg(feature = "evaluation")]
mod evaluate;
mod explain;
mod map;
mod review;
mod run;
mod settings;
mod size;
mod stream;
#[cfg(feature = "train")]
mod train;
mod viewers;
mod vocab;
mod voice;

use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};

/// On-device visual place recognition.
#[derive(Parser)]
#[command(name = "loci", version, about, max_term_width = 100, arg_required_else_help = true)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Recognise places in a stream of frames and grow the map
    Run(run::RunArguments),
    /// See it work: a synthetic drive of two laps, noon and dusk, with a summary at the end
    Demo(demo::DemoArguments),
    /// Train, import, inspect and time visual vocabularies
    #[command(subcommand)]
    Vocab(vocab::VocabCommand),
    /// Look after a map
    #[command(subcommand)]
    Map(map::MapCommand),
    /// What works on this computer, what is missing, and how to fix it
    Doctor(doctor::DoctorArguments),
    /// List cameras with their formats, rates and controls, and a source for each
    Devices(devices::DevicesArguments),
    /// Train a better CNN from the clusters of maps
    #[cfg(feature = "train")]
    Train(train::TrainArguments),
    /// Train a better CNN from the clusters of maps (needs a build with the feature `train`)
    #[cfg(not(feature = "train"))]
    Train(Anything),
    /// Recognition rate, recall@N, precision and recall, calibration, by a ground truth
    #[cfg(feature = "evaluation")]
    Evaluate(Box<evaluate::EvaluateArguments>),
    /// Hand over experiences and fetch models (not built yet)
    Sync(Anything),
    /// Look a map or the log of a run over in rerun, and what is odd about it
    Review(review::ReviewArguments),
    /// Stage-by-stage timing on this computer (not built yet)
    Bench(Anything),
}

/// Takes any arguments, so that a command that is not built says so and nothing else.
#[derive(Args)]
struct Anything {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    _arguments: Vec<String>,
}

/// How a command ended, when it did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// All of it was done.
    Done,
    /// Done, but something was lost or skipped.
    Lost,
}

impl From<Outcome> for ExitCode {
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Done => Self::SUCCESS,
            Outcome::Lost => Self::from(3),
        }
    }
}

/// A setting that makes no sense, wherever it came from.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct WrongArgument(String);

/// The exit code for a failure: 2 for wrong arguments, else 1.
pub(crate) fn exit_code(error: &anyhow::Error) -> ExitCode {
    ExitCode::from(if error.is::<WrongArgument>() { 2 } else { 1 })
}

/// Runs the command of this process.
pub(crate) fn run() -> anyhow::Result<Outcome> {
    match Arguments::parse().command {
        Command::Run(arguments) => run::run(arguments),
        Command::Demo(arguments) => demo::run(arguments),
        Command::Vocab(command) => vocab::run(command),
        Command::Map(command) => map::run(command),
        Command::Doctor(arguments) => doctor::run(arguments),
        Command::Devices(arguments) => devices::run(&arguments),
        #[cfg(feature = "train")]
        Command::Train(arguments) => train::run(&arguments),
        #[cfg(not(feature = "train"))]
        Command::Train(_) => anyhow::bail!("this build trains no CNN; build with `--features train`"),
        #[cfg(feature = "evaluation")]
        Command::Evaluate(arguments) => evaluate::run(*arguments),
        Command::Sync(_) => not_built("sync"),
        Command::Review(arguments) => review::run(&arguments),
        Command::Bench(_) => not_built("bench"),
    }
}

fn not_built(command: &str) -> anyhow::Result<Outcome> {
    anyhow::bail!("`loci {command}` is not built yet")
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_arguments_hold_together() {
        Arguments::command().debug_assert();
    }
}
