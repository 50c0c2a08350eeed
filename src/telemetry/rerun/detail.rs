//! How much is shown.

use std::fmt;
use std::str::FromStr;

use crate::telemetry::TelemetryError;

/// How much is shown of every frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RerunDetail {
    /// Answers, map and curves of every frame, and a small picture a second.
    Lean,
    /// Similarities of every frame, too, and the camera's picture and matches of ten a second at most. JPEGs go through
    /// as they are, other pictures become JPEGs.
    #[default]
    Normal,
    /// All of every frame; pictures that are no JPEGs with a quarter of their colour values (NV12).
    Full,
}

impl RerunDetail {
    /// All of them.
    const ALL: [(&str, Self); 3] = [("lean", Self::Lean), ("normal", Self::Normal), ("full", Self::Full)];

    /// Pictures a second at most.
    pub(super) fn pictures_hz(self) -> Option<f64> {
        match self {
            Self::Lean => Some(1.0),
            Self::Normal => Some(10.0),
            Self::Full => None,
        }
    }

    /// Whether keypoints, matches and similarities are shown.
    pub(super) fn shows_evidence(self) -> bool {
        self != Self::Lean
    }
}

impl FromStr for RerunDetail {
    type Err = TelemetryError;

    fn from_str(given: &str) -> Result<Self, Self::Err> {
        let known = Self::ALL.into_iter().find(|(name, _)| *name == given);
        known.map(|(_, detail)| detail).ok_or_else(|| TelemetryError::Rerun {
            target: format!("detail '{}'", super::target::one_line(given)),
            reason: "use lean, normal or full".to_owned(),
        })
    }
}

/// As it is written on the command line.
impl fmt::Display for RerunDetail {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = Self::ALL.into_iter().find(|(_, detail)| detail == self).map_or("", |(name, _)| name);
        formatter.write_str(name)
    }
}

/// Keeps to so many pictures a second.
pub(super) struct PicturePace {
    interval_nanos: i64,
    /// When the next picture is due.
    due_nanos: Option<i64>,
}

impl PicturePace {
    pub(super) fn of(detail: RerunDetail) -> Self {
        let interval_nanos = detail.pictures_hz().map_or(0, |hertz| (1e9 / hertz) as i64);
        Self { interval_nanos, due_nanos: None }
    }

    /// Whether the frame that was captured then is shown as a picture; one before it never happened.
    pub(super) fn is_due(&mut self, capture_nanos: i64) -> bool {
        let interval = self.interval_nanos;
        let due = self.due_nanos.unwrap_or(capture_nanos);
        // A camera of just that rate comes a little early now and then, and is not to lose every second frame; a clock
        // that was set back makes nobody wait for it to come round again.
        let early = due.saturating_sub(capture_nanos);
        if early > interval / 8 && early <= interval.saturating_mul(2) {
            return false;
        }
        let is_in_step = early.unsigned_abs() <= interval.unsigned_abs();
        let from = if is_in_step { due } else { capture_nanos };
        self.due_nanos = Some(from.saturating_add(interval));
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_detail_is_written_as_it_is_read_and_others_are_refused_by_name() {
        for (name, detail) in RerunDetail::ALL {
            assert_eq!(name.parse::<RerunDetail>().unwrap(), detail);
            assert_eq!(detail.to_string(), name);
        }
        let refusal = "Lean\n".parse::<RerunDetail>().unwrap_err().to_string();
        assert_eq!(refusal, "rerun detail 'Lean': use lean, normal or full");
    }

    /// The times in milliseconds that are shown of those that came.
    fn shown(detail: RerunDetail, came_ms: impl IntoIterator<Item = i64>) -> Vec<i64> {
        let mut pace = PicturePace::of(detail);
        came_ms.into_iter().filter(|time| pace.is_due(time * 1_000_000)).collect()
    }

    #[test]
    fn pictures_come_at_their_pace_and_never_faster_for_long() {
        let camera = || (0..100).map(|frame| frame * 33);
        assert_eq!(shown(RerunDetail::Full, camera()).len(), 100);
        assert!((32..=34).contains(&shown(RerunDetail::Normal, camera()).len()));
        let seldom = shown(RerunDetail::Lean, camera());
        assert!(seldom.len() == 4 && seldom.windows(2).all(|pair| pair[1] - pair[0] >= 875), "{seldom:?}");
    }

    #[test]
    fn a_camera_of_just_that_pace_loses_none_though_its_times_waver() {
        let wavering = (0..50).map(|frame| frame * 100 + [3, 0, -2, 2][frame as usize % 4]);
        assert_eq!(shown(RerunDetail::Normal, wavering).len(), 50);
    }

    #[test]
    fn a_clock_that_is_set_starts_anew() {
        assert_eq!(shown(RerunDetail::Lean, [5000, 5500, 100, 600, 1100, 99_000]), [5000, 100, 1100, 99_000]);
    }
}
