//! Bytes from libFuzzer through [`loci_fuzz::model_card`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| loci_fuzz::model_card(bytes));
