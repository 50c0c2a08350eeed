//! A row of an export: its columns, which every format has, and their values.

use std::fmt;

use serde::ser::{Serialize, SerializeMap, Serializer};

/// What a column holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Count,
    Signed,
    Number,
    Single,
    Flag,
    Text,
}

/// A column: its name, what it holds, and whether a row may have nothing there.
pub(super) struct Column {
    pub(super) name: &'static str,
    pub(super) kind: Kind,
    pub(super) is_optional: bool,
}

const fn always(name: &'static str, kind: Kind) -> Column {
    Column { name, kind, is_optional: false }
}

const fn perhaps(name: &'static str, kind: Kind) -> Column {
    Column { name, kind, is_optional: true }
}

pub(super) const COLUMNS: [Column; 19] = [
    always("experience", Kind::Count),
    always("place", Kind::Count),
    always("learnt_as", Kind::Count),
    perhaps("place_name", Kind::Text),
    always("is_keyframe", Kind::Flag),
    always("frame_index", Kind::Count),
    always("frame_name", Kind::Text),
    always("capture_nanos", Kind::Signed),
    perhaps("x", Kind::Number),
    perhaps("y", Kind::Number),
    perhaps("z", Kind::Number),
    perhaps("qx", Kind::Number),
    perhaps("qy", Kind::Number),
    perhaps("qz", Kind::Number),
    perhaps("qw", Kind::Number),
    perhaps("mean_luminance", Kind::Single),
    perhaps("model", Kind::Text),
    perhaps("features", Kind::Count),
    perhaps("thumbnail", Kind::Text),
];

/// What stands in a column of a row.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    Nothing,
    Count(u64),
    Signed(i64),
    Number(f64),
    Single(f32),
    Flag(bool),
    Text(String),
}

/// The values of the columns, in their order.
pub(super) struct Row(pub(super) [Value; COLUMNS.len()]);

impl Value {
    /// Text, if there is any.
    pub(super) fn text(text: Option<String>) -> Self {
        text.map_or(Self::Nothing, Self::Text)
    }
}

/// As it stands in a CSV file: nothing is empty.
impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Nothing => Ok(()),
            Self::Count(count) => write!(f, "{count}"),
            Self::Signed(number) => write!(f, "{number}"),
            Self::Number(number) => write!(f, "{number}"),
            Self::Single(number) => write!(f, "{number}"),
            Self::Flag(flag) => write!(f, "{flag}"),
            Self::Text(text) => f.write_str(text),
        }
    }
}

impl Serialize for Value {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Nothing => serializer.serialize_none(),
            Self::Count(count) => serializer.serialize_u64(*count),
            Self::Signed(number) => serializer.serialize_i64(*number),
            Self::Number(number) => serializer.serialize_f64(*number),
            Self::Single(number) => serializer.serialize_f32(*number),
            Self::Flag(flag) => serializer.serialize_bool(*flag),
            Self::Text(text) => serializer.serialize_str(text),
        }
    }
}

impl Serialize for Row {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(COLUMNS.len()))?;
        for (column, value) in COLUMNS.iter().zip(&self.0) {
            map.serialize_entry(column.name, value)?;
        }
        map.end()
    }
}
