//! Bytes from libFuzzer through [`loci_fuzz::suite`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| loci_fuzz::suite(bytes));
