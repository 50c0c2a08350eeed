//! Memory asked ahead of time.

/// Bytes that come together.
const LINE_BYTES: usize = 64;

/// Has the processor fetch the first `most_bytes` of `items` into its caches while it does something else; nothing
/// where it cannot be told to.
#[inline]
pub fn prefetch<T>(items: &[T], most_bytes: usize) {
    let item_bytes = size_of::<T>().max(1);
    let items = &items[..items.len().min(most_bytes / item_bytes)];
    // The last item may lie on a line more.
    for item in items.iter().step_by((LINE_BYTES / item_bytes).max(1)).chain(items.last()) {
        fetch(item);
    }
}

#[cfg(target_arch = "x86_64")]
#[inline]
#[expect(unsafe_code, reason = "the intrinsic takes a pointer")]
fn fetch<T>(item: &T) {
    use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
    // SAFETY: every x86-64 processor has the instruction, which never faults and changes nothing but the caches.
    unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(item).cast()) }
}

#[cfg(target_arch = "aarch64")]
#[inline]
#[expect(unsafe_code, reason = "stable Rust has no intrinsic for it")]
fn fetch<T>(item: &T) {
    let address = std::ptr::from_ref(item);
    // SAFETY: the instruction never faults and changes nothing but the caches.
    unsafe {
        std::arch::asm!("prfm pldl1keep, [{0}]", in(reg) address, options(nostack, preserves_flags, readonly));
    }
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
#[inline]
fn fetch<T>(_: &T) {}
