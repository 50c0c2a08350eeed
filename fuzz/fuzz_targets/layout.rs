//! Bytes from libFuzzer through [`loci_fuzz::layout`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| loci_fuzz::layout(bytes));
