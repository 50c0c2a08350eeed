//! The header of a record in a log; ARCHITECTURE.md has its bytes.

/// Bytes before a payload.
pub(super) const HEADER_BYTES: usize = 28;
/// Longest payload in bytes; a longer length can only be damage.
pub(super) const MAX_PAYLOAD_BYTES: usize = 16 << 20;

const MARK: [u8; 4] = [0xb7, b'R', b'e', b'c'];

/// What a payload is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Envelope {
    /// Kind, as the log's owner counts them.
    pub kind: u8,
    /// Version of that kind's layout.
    pub version: u8,
}

/// What stands before a payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RecordHeader {
    pub(super) envelope: Envelope,
    pub(super) payload_bytes: u32,
    payload_crc: u32,
    /// Bytes of the log that were on the medium for certain when the record was written.
    pub(super) durable_bytes: u64,
}

impl RecordHeader {
    /// The header of `payload`; `None` if that is empty or too long.
    pub(super) fn new(envelope: Envelope, payload: &[u8], durable_bytes: u64) -> Option<Self> {
        if payload.is_empty() || payload.len() > MAX_PAYLOAD_BYTES {
            return None;
        }
        let payload_crc = crc32fast::hash(payload);
        Some(Self { envelope, payload_bytes: payload.len() as u32, payload_crc, durable_bytes })
    }

    pub(super) fn to_bytes(self) -> [u8; HEADER_BYTES] {
        let mut bytes = [0; HEADER_BYTES];
        bytes[..4].copy_from_slice(&MARK);
        bytes[4] = self.envelope.kind;
        bytes[5] = self.envelope.version;
        bytes[8..12].copy_from_slice(&self.payload_bytes.to_le_bytes());
        bytes[12..16].copy_from_slice(&self.payload_crc.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.durable_bytes.to_le_bytes());
        let crc = crc32fast::hash(&bytes[..24]);
        bytes[24..].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    /// The header in `bytes`; `None` if they are none.
    pub(super) fn from_bytes(bytes: &[u8; HEADER_BYTES]) -> Option<Self> {
        if bytes[..4] != MARK {
            return None;
        }
        let u32_at = |offset: usize| u32::from_le_bytes(std::array::from_fn(|index| bytes[offset + index]));
        let payload_bytes = u32_at(8);
        let is_sound = u32_at(24) == crc32fast::hash(&bytes[..24])
            && bytes[6..8] == [0, 0]
            && (1..=MAX_PAYLOAD_BYTES).contains(&(payload_bytes as usize));
        is_sound.then(|| Self {
            envelope: Envelope { kind: bytes[4], version: bytes[5] },
            payload_bytes,
            payload_crc: u32_at(12),
            durable_bytes: u64::from(u32_at(16)) | u64::from(u32_at(20)) << 32,
        })
    }

    /// Whether `payload` is the one that the header stands before.
    pub(super) fn fits(&self, payload: &[u8]) -> bool {
        payload.len() == self.payload_bytes as usize && crc32fast::hash(payload) == self.payload_crc
    }
}
