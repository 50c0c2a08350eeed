//! Bytes from libFuzzer through [`loci_fuzz::image`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| loci_fuzz::image(bytes));
