//! Bytes from libFuzzer through [`loci_fuzz::runtime_library`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| loci_fuzz::runtime_library(bytes));
