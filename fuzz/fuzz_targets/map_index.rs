//! Bytes from libFuzzer through [`loci_fuzz::map_index`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| loci_fuzz::map_index(bytes));
