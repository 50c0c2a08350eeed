//! The program `loci`: runs the command and makes the exit code.

use std::process::ExitCode;

mod cli;

fn main() -> ExitCode {
    match cli::run() {
        Ok(outcome) => outcome.into(),
        Err(error) => {
            // Our errors carry their cause in their own words; the chain would say it twice. They name files,
            // whose names may hold anything.
            eprintln!("loci: {}", one_line(&error.to_string()));
            cli::exit_code(&error)
        }
    }
}

/// `text` with its control characters escaped.
fn one_line(text: &str) -> String {
    let shown = |c: char| if c.is_control() { c.escape_default().to_string() } else { c.to_string() };
    text.chars().map(shown).collect()
}

#[cfg(test)]
mod tests {
    use super::one_line;

    #[test]
    fn an_error_stays_on_its_line_whatever_a_file_is_called() {
        assert_eq!(one_line("a\nloci: all is well\u{1b}[2J.jpg ü"), "a\\nloci: all is well\\u{1b}[2J.jpg ü");
    }
}
