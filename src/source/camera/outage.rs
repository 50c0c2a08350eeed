//! What was told of the camera's troubles since its last frame: nothing is told twice.

/// Failures in a row after which not only the stream but the camera is opened anew.
const MAX_FAILURES: u32 = 2;

/// The time without frames.
#[derive(Debug, Default)]
pub(super) struct Outage {
    told: Vec<String>,
    failures: u32,
    /// Why the camera could not be opened when it was last tried for a while.
    refusal: Option<String>,
}

impl Outage {
    /// A frame came; answers whether anything had been told.
    pub(super) fn end(&mut self) -> bool {
        !std::mem::take(self).told.is_empty()
    }

    /// Whether `reason` was not told yet, which it is by this.
    pub(super) fn is_news(&mut self, reason: &str) -> bool {
        let is_news = !self.told.iter().any(|told| told == reason);
        if is_news {
            self.told.push(reason.to_owned());
        }
        is_news
    }

    /// Whether the stream has failed in this outage.
    pub(super) fn has_failed(&self) -> bool {
        self.failures > 0
    }

    /// Counts a failure; answers whether it is time for opening the camera anew.
    pub(super) fn count_failure(&mut self) -> bool {
        self.failures = self.failures.saturating_add(1);
        self.failures >= MAX_FAILURES
    }

    /// Whether `reason` has kept the camera from being opened before: right after it is plugged in, its node may not be
    /// ours to open yet.
    pub(super) fn is_lasting(&mut self, reason: &str) -> bool {
        self.refusal.replace(reason.to_owned()).is_some_and(|before| before == reason)
    }
}
