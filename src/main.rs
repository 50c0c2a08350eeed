//! The program `loci`: runs the command and makes the exit code.

use std::process::ExitCode;

mod cli;

fn main() -> ExitCode {
    match cli::run() {
        Ok(outcome) => outcome.into(),
        Err(error) => {
            eprintln!("loci: {error:#}");
            cli::exit_code(&error)
        }
    }
}
