//! What the figures depend on outside of Loci: processor and memory, as Linux tells them.

use std::fs;
use std::thread;

/// The processor as the system names it, or its architecture where it does not.
#[must_use]
pub fn cpu() -> String {
    let info = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    ["model name", "Model", "Hardware"]
        .iter()
        .find_map(|key| value_of(&info, key))
        .unwrap_or_else(|| std::env::consts::ARCH.to_owned())
}

/// Hardware threads that this process may use.
#[must_use]
pub fn cpu_threads() -> usize {
    thread::available_parallelism().map_or(1, usize::from)
}

/// Largest resident memory since [`forget_peak_memory`], in bytes.
#[must_use]
pub fn peak_memory_bytes() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let kib: u64 = value_of(&status, "VmHWM")?.strip_suffix(" kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

/// Starts the peak anew. Where the system does not allow it, the peak of the whole process stays.
pub fn forget_peak_memory() {
    let _ = fs::write("/proc/self/clear_refs", "5");
}

fn value_of(text: &str, key: &str) -> Option<String> {
    let line = text.lines().find(|line| line.split(':').next().is_some_and(|name| name.trim() == key))?;
    line.split_once(':').map(|(_, value)| value.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_found_by_their_whole_key() {
        let text = "processor\t: 0\nmodel\t\t: 85\nmodel name\t: A Fine CPU @ 2 GHz\n";
        assert_eq!(value_of(text, "model name").unwrap(), "A Fine CPU @ 2 GHz");
        assert_eq!(value_of(text, "mod"), None);
    }

    #[test]
    fn the_peak_covers_what_was_allocated() {
        let before = peak_memory_bytes().unwrap();
        let block = std::hint::black_box(vec![1_u8; 64 << 20]);
        assert!(peak_memory_bytes().unwrap() >= block.len() as u64);
        assert!(before > 0);
    }
}
