//! Memory asked ahead of time.

/// Has the processor fetch `strings` into its caches while it does something else; nothing where it cannot be told to.
#[inline]
pub fn prefetch(strings: &[[u8; 32]]) {
    // Of strings that begin at a multiple of 32 bytes, two share a cache line; others are fetched nearly all.
    for string in strings.iter().step_by(2).chain(strings.last()) {
        fetch(string);
    }
}

#[cfg(target_arch = "x86_64")]
#[inline]
#[expect(unsafe_code, reason = "the intrinsic takes a pointer")]
fn fetch(string: &[u8; 32]) {
    use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
    // SAFETY: every x86-64 processor has the instruction, which never faults and changes nothing but the caches.
    unsafe { _mm_prefetch::<_MM_HINT_T0>(string.as_ptr().cast()) }
}

#[cfg(not(target_arch = "x86_64"))]
#[inline]
fn fetch(_: &[u8; 32]) {}
