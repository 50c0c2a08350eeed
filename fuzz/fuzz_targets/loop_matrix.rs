//! Bytes from libFuzzer through [`loci_fuzz::loop_matrix`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| loci_fuzz::loop_matrix(bytes));
