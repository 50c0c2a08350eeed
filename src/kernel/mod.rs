//! The inner loops, one file each, in plain Rust.
//!
//! Everything here is integer arithmetic with one right answer, so that a faster version of a loop
//! can be held bit for bit against the simple one.

mod blur;
mod difference_hash;
mod hamming;
mod prefetch;
mod resize;
mod segment;

pub use blur::blur_7x7;
pub use difference_hash::difference_hash;
pub use hamming::{hamming, nearest};
pub use prefetch::prefetch;
pub use resize::resize_bilinear;
pub use segment::corner_scores;
