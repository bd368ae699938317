#![no_main]
//! See `celestcore_fuzz::replay`.

libfuzzer_sys::fuzz_target!(|data: &[u8]| celestcore_fuzz::replay(data));
