//! Bytes from libFuzzer through [`loci_fuzz::training_file`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| loci_fuzz::training_file(bytes));
