//! The inner loops, one file each, in plain Rust, compiled for several processors (`dispatch`).
//!
//! Everything here is integer arithmetic with one right answer, so that a faster version of a loop
//! can be held bit for bit against the simple one.

mod blur;
mod difference_hash;
mod dispatch;
mod dot;
mod hamming;
mod lanes;
mod luma;
mod prefetch;
mod resize;
mod segment;

pub use blur::Blur;
pub use difference_hash::difference_hash;
pub(crate) use dispatch::for_every_processor;
#[cfg(target_arch = "x86_64")]
pub(crate) use dispatch::has_avx2;
pub use dispatch::instructions;
pub use dot::dot;
pub use hamming::{hamming, nearest};
pub use luma::luma;
pub(crate) use luma::luma_in;
pub use prefetch::prefetch;
pub use resize::Resizer;
pub use segment::{corner_scores, local_maxima};
