//! Bytes from libFuzzer through [`loci_fuzz::vocabulary_import`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| loci_fuzz::vocabulary_import(bytes));
