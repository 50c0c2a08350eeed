//! Sizes in bytes as people write them, in flags, variables and files alike.

use std::str::FromStr;

use bytesize::ByteSize;
use serde::Deserialize;

/// A size in bytes: 64MiB, 1.5GB, or the bare number of bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "toml::Value")]
pub(super) struct Size(u64);

impl Size {
    pub(super) fn bytes(self) -> u64 {
        self.0
    }
}

fn wrong(text: impl std::fmt::Display) -> String {
    format!("expected a size such as 64MiB or 1.5GB, got {text}")
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        // The library's own words speak of floats and SI units.
        text.parse::<ByteSize>().map(|size| Self(size.as_u64())).map_err(|_| wrong(text))
    }
}

impl TryFrom<toml::Value> for Size {
    type Error = String;

    fn try_from(value: toml::Value) -> Result<Self, String> {
        match &value {
            toml::Value::String(text) => text.parse(),
            toml::Value::Integer(bytes) => u64::try_from(*bytes).map(Self).map_err(|_| wrong(bytes)),
            other => Err(wrong(format!("a {}", other.type_str()))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_is_read_in_units_of_1024_and_of_1000_and_as_a_number() {
        for (text, bytes) in [("64MiB", 64 << 20), ("1.5GB", 1_500_000_000), ("4 gib", 4 << 30), ("7", 7)] {
            assert_eq!(text.parse(), Ok(Size(bytes)), "{text}");
        }
        assert_eq!(Size::try_from(toml::Value::Integer(7)), Ok(Size(7)));
    }

    #[test]
    fn what_is_no_size_is_refused_with_an_example() {
        for wrong in ["", "banana", "64 apples", "-1", "1e3"] {
            let error = wrong.parse::<Size>().unwrap_err();
            assert_eq!(error, format!("expected a size such as 64MiB or 1.5GB, got {wrong}"));
        }
        assert!(Size::try_from(toml::Value::Integer(-1)).unwrap_err().ends_with("got -1"));
        assert!(Size::try_from(toml::Value::Boolean(true)).unwrap_err().ends_with("got a boolean"));
    }
}
