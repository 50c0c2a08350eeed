//! An evaluation as people read it: one HTML file that needs nothing beside it, and Markdown; and as
//! programs read it, JSON, with every single answer as CSV. All show the same [`Report`]; none computes a
//! figure of its own.
//!
//! File names are hostile here: everything that comes from data is escaped in `text`.

mod answers;
mod canvas;
mod cells;
mod confusion;
mod experiment;
mod glance;
mod html;
mod markdown;
mod pairs;
mod palette;
mod precision_recall;
mod reading;
mod reliability;
#[cfg(test)]
mod sample;
#[cfg(test)]
mod table_tests;
#[cfg(test)]
mod tests;
mod text;

use std::error::Error;

use super::results::Report;

/// Why a report could not be written.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The plotting library refused.
    #[error("cannot draw the {plot}: {source}; the JSON and Markdown reports hold the same figures")]
    Plot {
        /// What was drawn.
        plot: &'static str,
        /// What it said.
        source: Box<dyn Error + Send + Sync>,
    },
    /// The report does not fit into JSON.
    #[error("cannot write the report as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// The answers do not fit into CSV.
    #[error("cannot write the answers as CSV: {0}")]
    Csv(#[from] csv::Error),
}

/// The report as one HTML file: no network, no scripts, pictures and plots inside.
///
/// # Errors
///
/// [`ReportError::Plot`] where a plot cannot be drawn.
pub fn html(report: &Report) -> Result<String, ReportError> {
    html::document(report)
}

/// The report as Markdown: prose wrapped at 120 columns, tables as they come.
#[must_use]
pub fn markdown(report: &Report) -> String {
    markdown::document(report)
}

/// The report as indented JSON with a newline at its end.
///
/// # Errors
///
/// [`ReportError::Json`] where a value does not fit into JSON.
pub fn json(report: &Report) -> Result<String, ReportError> {
    Ok(serde_json::to_string_pretty(report)? + "\n")
}

/// Every answer as CSV: a row of heads, then a row an answer; cells are empty where there is nothing to say.
///
/// # Errors
///
/// [`ReportError::Csv`] where a row cannot be written.
pub fn answers_csv(report: &Report) -> Result<Vec<u8>, ReportError> {
    answers::table(report)
}
