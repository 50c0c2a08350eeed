//! The program `loci`: runs the command and makes the exit code.

use std::process::ExitCode;

mod cli;

fn main() -> ExitCode {
    match cli::run() {
        Ok(outcome) => outcome.into(),
        Err(error) => {
            // Our errors carry their cause in their own words; the chain would say it twice.
            eprintln!("loci: {error}");
            cli::exit_code(&error)
        }
    }
}
