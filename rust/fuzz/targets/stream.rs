#![no_main]
//! See `celestcore_fuzz::stream`.

libfuzzer_sys::fuzz_target!(|data: &[u8]| celestcore_fuzz::stream(data));
