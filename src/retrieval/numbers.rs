//! Numbers of 16 bits, in memory of their own or where they lie in a mapped file.

use std::ops::{Deref, Range};
use std::sync::Arc;

use crate::storage::FileBytes;

/// Numbers of 16 bits.
#[derive(Debug)]
pub(super) enum Numbers {
    /// In memory of their own.
    Owned(Vec<u16>),
    /// In a file, little-endian, as this processor has them; they begin at an even byte.
    Mapped { file: Arc<FileBytes>, bytes: Range<usize> },
}

impl Numbers {
    /// Those in `bytes` of a file; `None` if they are not all there, or this processor cannot read them as they are.
    pub(super) fn mapped(file: &Arc<FileBytes>, bytes: Range<usize>) -> Option<Self> {
        let is_there = bytemuck::try_cast_slice::<u8, u16>(file.get(bytes.clone())?).is_ok();
        (is_there && cfg!(target_endian = "little")).then(|| Self::Mapped { file: Arc::clone(file), bytes })
    }
}

impl Default for Numbers {
    fn default() -> Self {
        Self::Owned(Vec::new())
    }
}

impl Deref for Numbers {
    type Target = [u16];

    fn deref(&self) -> &[u16] {
        match self {
            Self::Owned(numbers) => numbers,
            Self::Mapped { file, bytes } => bytemuck::cast_slice(&file[bytes.clone()]),
        }
    }
}
