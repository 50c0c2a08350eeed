//! Geometric verification: do two images show the same place from two sides?
//!
//! Features that look alike are paired; every pair votes for one similarity transform (Hough voting,
//! the paper's eqs. 1–4); the best hypotheses are checked against all pairs, refined, and counted
//! (vote-and-verify, Schönberger et al., ACCV 2016).

mod agreement;
mod correspondence;
mod hough;
mod verify;

pub use correspondence::{Correspondence, MatchingOptions, MatchingView};
pub use hough::HoughOptions;
pub use verify::{Verification, VerificationOptions, Verifier, verify};
