//! An export as CSV (RFC 4180): a header, then a line a row.

use std::io::Write;

use super::row::{COLUMNS, Value};
use super::rows::Rows;

/// Writes all rows.
pub(super) fn write(output: &mut dyn Write, rows: &mut Rows<'_>) -> anyhow::Result<()> {
    let mut table = csv::Writer::from_writer(output);
    table.write_record(COLUMNS.map(|column| column.name))?;
    while let Some(row) = rows.next()? {
        table.write_record(row.0.iter().map(Value::to_string))?;
    }
    Ok(table.flush()?)
}
