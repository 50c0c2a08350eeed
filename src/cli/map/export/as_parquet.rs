//! An export as Apache Parquet: plain columns, as many rows at once as fit into a row group.
//!
//! Counts are unsigned 64-bit integers; text is UTF-8; what a row may lack is optional.

use std::io::Write;
use std::sync::Arc;

use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DataType, DoubleType, FloatType, Int64Type};
use parquet::errors::Result;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::Type;

use super::output::Output;
use super::row::{COLUMNS, Kind, Row, Value};
use super::rows::Rows;

/// Most rows of a group, which is put together in memory.
const GROUP_ROWS: usize = 10_000;
/// Bytes of text after which a group ends early.
const GROUP_TEXT_BYTES: usize = 16 << 20;

/// Writes all rows.
pub(super) fn write(output: &mut Output, rows: &mut Rows<'_>) -> anyhow::Result<()> {
    let properties = Arc::new(WriterProperties::builder().set_created_by("loci".to_owned()).build());
    let mut file = SerializedFileWriter::new(output, Arc::new(schema()?), properties)?;
    let mut group = Vec::new();
    let mut text_bytes = 0;
    while let Some(row) = rows.next()? {
        text_bytes += row.0.iter().map(text_bytes_of).sum::<usize>();
        group.push(row);
        if group.len() >= GROUP_ROWS || text_bytes >= GROUP_TEXT_BYTES {
            write_group(&mut file, &group)?;
            group.clear();
            text_bytes = 0;
        }
    }
    if !group.is_empty() {
        write_group(&mut file, &group)?;
    }
    file.close()?;
    Ok(())
}

fn schema() -> Result<Type> {
    let mut message = "message experiences {".to_owned();
    for column in &COLUMNS {
        let (physical, logical) = match column.kind {
            Kind::Count => ("INT64", " (INTEGER(64, false))"),
            Kind::Signed => ("INT64", ""),
            Kind::Number => ("DOUBLE", ""),
            Kind::Single => ("FLOAT", ""),
            Kind::Flag => ("BOOLEAN", ""),
            Kind::Text => ("BYTE_ARRAY", " (STRING)"),
        };
        let presence = if column.is_optional { "OPTIONAL" } else { "REQUIRED" };
        message += &format!(" {presence} {physical} {}{logical};", column.name);
    }
    parse_message_type(&(message + " }"))
}

fn text_bytes_of(value: &Value) -> usize {
    match value {
        Value::Text(text) => text.len(),
        _ => 0,
    }
}

fn write_group<W: Write + Send>(file: &mut SerializedFileWriter<W>, group: &[Row]) -> Result<()> {
    let mut writer = file.next_row_group()?;
    for (index, column) in COLUMNS.iter().enumerate() {
        let Some(mut chunk) = writer.next_column()? else { break };
        let values = || group.iter().map(|row| &row.0[index]);
        match column.kind {
            Kind::Count | Kind::Signed => write_column::<Int64Type>(&mut chunk, values(), integer)?,
            Kind::Number => write_column::<DoubleType>(&mut chunk, values(), number)?,
            Kind::Single => write_column::<FloatType>(&mut chunk, values(), single)?,
            Kind::Flag => write_column::<BoolType>(&mut chunk, values(), flag)?,
            Kind::Text => write_column::<ByteArrayType>(&mut chunk, values(), text)?,
        }
        chunk.close()?;
    }
    writer.close()?;
    Ok(())
}

/// Writes those of `values` that there are, and for an optional column which rows have one.
fn write_column<'a, D: DataType>(
    chunk: &mut SerializedColumnWriter<'_>,
    values: impl Iterator<Item = &'a Value>,
    read: fn(&Value) -> Option<D::T>,
) -> Result<()> {
    let values: Vec<Option<D::T>> = values.map(read).collect();
    let presence: Vec<i16> = values.iter().map(|value| i16::from(value.is_some())).collect();
    let present: Vec<D::T> = values.into_iter().flatten().collect();
    // The levels of a column that every row must have are not looked at.
    chunk.typed::<D>().write_batch(&present, Some(&presence), None)?;
    Ok(())
}

/// Unsigned numbers keep their bits.
fn integer(value: &Value) -> Option<i64> {
    match value {
        Value::Count(count) => Some(*count as i64),
        Value::Signed(number) => Some(*number),
        _ => None,
    }
}

fn number(value: &Value) -> Option<f64> {
    match value {
        Value::Number(number) => Some(*number),
        _ => None,
    }
}

fn single(value: &Value) -> Option<f32> {
    match value {
        Value::Single(number) => Some(*number),
        _ => None,
    }
}

fn flag(value: &Value) -> Option<bool> {
    match value {
        Value::Flag(flag) => Some(*flag),
        _ => None,
    }
}

fn text(value: &Value) -> Option<ByteArray> {
    match value {
        Value::Text(text) => Some(text.as_str().into()),
        _ => None,
    }
}
