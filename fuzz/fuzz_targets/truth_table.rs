//! Bytes from libFuzzer through [`loci_fuzz::truth_table`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| loci_fuzz::truth_table(bytes));
