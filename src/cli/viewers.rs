//! Where a stream is shown in rerun: any number of targets, all in the same detail.

use loci::telemetry::RecognitionSink;

use super::WrongArgument;
use super::settings::StreamSettings;

#[cfg(feature = "rerun")]
pub(super) use shown::Viewers;

#[cfg(feature = "rerun")]
mod shown {
    use loci::telemetry::{RerunDetail, RerunSink, RerunTarget, TelemetryError};

    use super::*;

    /// Targets that were understood, and nothing opened yet.
    pub(in super::super) struct Viewers {
        targets: Vec<RerunTarget>,
        detail: RerunDetail,
    }

    impl Viewers {
        /// Those of `settings`.
        pub(in super::super) fn of(settings: &StreamSettings) -> anyhow::Result<Self> {
            let wrong = |error: TelemetryError| WrongArgument(error.to_string());
            let mut targets: Vec<RerunTarget> = Vec::new();
            for text in &settings.rerun {
                let target: RerunTarget = text.parse().map_err(wrong)?;
                if let Some(other) = targets.iter().find(|other| other.clashes_with(&target)) {
                    let reason = format!("rerun {other} and {target} are the same, or one shows the other");
                    return Err(WrongArgument(reason).into());
                }
                targets.push(target);
            }
            if targets.len() > 1 && targets.contains(&RerunTarget::Off) {
                return Err(WrongArgument("rerun off goes with no other target".to_owned()).into());
            }
            targets.retain(|target| *target != RerunTarget::Off);
            let detail = settings.rerun_detail.as_deref().map(str::parse).transpose().map_err(wrong)?;
            Ok(Self { targets, detail: detail.unwrap_or_default() })
        }

        /// Opens all of them.
        pub(in super::super) fn open(&self) -> anyhow::Result<Vec<Box<dyn RecognitionSink>>> {
            let open =
                |target| Ok(Box::new(RerunSink::open(target, self.detail)?) as Box<dyn RecognitionSink>);
            self.targets.iter().map(open).collect()
        }
    }
}

/// Nobody: all that a build without rerun can show something to.
#[cfg(not(feature = "rerun"))]
pub(super) struct Viewers;

#[cfg(not(feature = "rerun"))]
impl Viewers {
    pub(super) fn of(settings: &StreamSettings) -> anyhow::Result<Self> {
        if settings.rerun.iter().all(|target| target == "off") {
            return Ok(Self);
        }
        Err(WrongArgument("this build has no rerun; build with `--features rerun`".to_owned()).into())
    }

    pub(super) fn open(&self) -> anyhow::Result<Vec<Box<dyn RecognitionSink>>> {
        Ok(Vec::new())
    }
}
