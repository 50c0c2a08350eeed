//! `loci review`: a map, or the log of a run, as a recording that people look over.

use std::path::PathBuf;

use clap::Args;

use super::Outcome;

/// Arguments of `loci review`.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  loci review maps/site\n  loci review maps/site --out site.rrd --no-open\n  \
    loci run frames --map maps/site --json > run.jsonl\n  loci review run.jsonl --map maps/site\n\n\
    Of a map, the recording shows every place with the pictures of its experiences, where it lies on the map, what \
    turned out to be the same place, and what is worth a look: places that drifted (as `loci map drift` says), and \
    places of which half of the keyframes or more look, to the CNN, like a place elsewhere. On the timeline `place` it \
    goes from place to place, on `experience` through all that was learnt. It takes about 12 KiB an experience.\n\n\
    Of a run, it shows every answer with what spoke for it and against others, the places as they followed each other, \
    confidence, inliers, latency and losses; with the run's map, the pictures that were matched. Worth a look is a \
    frame that was alone in its answer, where the robot never went from there to there at other times.\n\n\
    rerun 0.36 reads it. What is reviewed is only read. The exit code is 3 where something could not be read."
)]
pub(super) struct ReviewArguments {
    /// Folder of a map, or file that `loci run --json` wrote
    #[arg(value_name = "MAP|LOG")]
    what: PathBuf,
    /// The recording; replaced if it is there [default: the name of what is reviewed with
    /// .review.rrd, here]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Open no viewer
    #[arg(long)]
    no_open: bool,
    /// Of a run, the map that it wrote or read: its pictures are shown
    #[arg(long, value_name = "DIR")]
    map: Option<PathBuf>,
    /// Of a map, the visual vocabulary; given again, a set that is switched by light [default: vocab/default.lvoc]
    #[arg(long, value_name = "FILE")]
    vocab: Vec<PathBuf>,
    /// Of a map, the folder of the CNN whose descriptors it holds, of which only the card is read, or none [default:
    /// models/efficientnet-lite0]
    #[arg(long, env = "LOCI_MODEL", value_name = "DIR")]
    model: Option<PathBuf>,
}

/// Says that rerun is missing from this build.
#[cfg(not(feature = "rerun"))]
pub(super) fn run(_: &ReviewArguments) -> anyhow::Result<Outcome> {
    anyhow::bail!("this build has no rerun; build with `--features rerun`")
}

#[cfg(feature = "rerun")]
pub(super) use shown::run;

#[cfg(feature = "rerun")]
mod shown {
    use std::fs::{self, File};
    use std::io::BufReader;
    use std::path::Path;
    use std::sync::atomic::AtomicBool;

    use loci::place_map::{MapError, PlaceMap};
    use loci::recognition::{Purity, Recogniser};
    use loci::telemetry::{Finding, ReviewError, open_viewer, review_map, review_run};

    use super::*;
    use crate::cli::console::{counted, say, spinner};
    use crate::cli::map::{Eyes, parts_in_words, report_losses};
    use crate::cli::settings::StreamSettings;
    use crate::cli::{WrongArgument, stream};

    /// Share of a place's keyframes that are not astray, from which on downwards the place is worth a look.
    const LOW_PURITY: f64 = 0.5;

    /// Writes the recording and opens it.
    pub(in crate::cli) fn run(arguments: &ReviewArguments) -> anyhow::Result<Outcome> {
        let out = recording(arguments)?;
        let stop = stream::stop_flag()?;
        let outcome = if arguments.what.is_dir() {
            of_map(arguments, &out, &stop)?
        } else {
            of_run(arguments, &out, &stop)?
        };
        if !arguments.no_open
            && let Err(error) = open_viewer(&out)
        {
            eprintln!("loci: {error}; the recording is whole, and --no-open opens no viewer");
        }
        Ok(outcome)
    }

    fn of_map(arguments: &ReviewArguments, out: &Path, stop: &AtomicBool) -> anyhow::Result<Outcome> {
        if arguments.map.is_some() {
            let reason = "--map goes with the log of a run; of a map, name the folder alone";
            return Err(WrongArgument(reason.to_owned()).into());
        }
        let settings = StreamSettings {
            vocab: arguments.vocab.clone(),
            model: arguments.model.clone(),
            ..StreamSettings::default()
        }
        .completed(None)?;
        let eyes = Eyes::new(&settings)?;
        let mut recogniser = eyes.open(&arguments.what)?;
        eyes.report_foreign(&[&recogniser]);
        let waiting = spinner("comparing the keyframes of every place");
        let findings = findings(&mut recogniser, stop);
        waiting.finish_and_clear();
        let findings = findings.map_err(|error| match error {
            MapError::Interrupted => anyhow::Error::from(ReviewError::Interrupted),
            error => error.into(),
        })?;
        let unreadable = recogniser.take_map_failure();
        let waiting = spinner("writing the recording");
        let reviewed = review_map(recogniser.map(), &findings, out, stop);
        waiting.finish_and_clear();
        let reviewed = reviewed?;
        say(&format!(
            "{} and {} are in {}; {} worth a look",
            counted(reviewed.places, "place"),
            counted(reviewed.experiences, "experience"),
            out.display(),
            counted(findings.len(), "thing"),
        ))?;
        let losses = report_losses(recogniser.map(), &arguments.what);
        if reviewed.unreadable > 0 {
            eprintln!("loci: {} could not be read", counted(reviewed.unreadable, "experience"));
        }
        if let Some(unreadable) = &unreadable {
            eprintln!("loci: {unreadable}");
        }
        let is_whole = reviewed.unreadable == 0 && unreadable.is_none();
        Ok(if is_whole { losses } else { Outcome::Lost })
    }

    fn of_run(arguments: &ReviewArguments, out: &Path, stop: &AtomicBool) -> anyhow::Result<Outcome> {
        let what = arguments.what.display();
        // The model may come from the environment, so it is not held against anybody.
        if !arguments.vocab.is_empty() {
            let reason = format!("--vocab goes with a map; {what} is no folder");
            return Err(WrongArgument(reason).into());
        }
        let neither = |reason: String| anyhow::anyhow!("{what}: neither a map's folder nor a log: {reason}");
        // A pipe would be waited for, and it is read twice.
        if fs::metadata(&arguments.what).is_ok_and(|metadata| !metadata.is_file()) {
            return Err(neither("it is no file".to_owned()));
        }
        let log = File::open(&arguments.what).map_err(|error| neither(error.to_string()))?;
        let map = arguments.map.as_deref().map(PlaceMap::open_read_only).transpose()?;
        let waiting = spinner("writing the recording");
        let reviewed = review_run(BufReader::new(log), map.as_ref(), out, stop);
        waiting.finish_and_clear();
        let reviewed = reviewed.map_err(|error| match error {
            ReviewError::Log { .. } => anyhow::anyhow!("{what}: {error}"),
            error => error.into(),
        })?;
        say(&format!(
            "{} at {} are in {}; {} worth a look",
            counted(reviewed.frames, "frame"),
            counted(reviewed.places, "place"),
            out.display(),
            counted(reviewed.stray, "frame"),
        ))?;
        if reviewed.unreadable > 0 {
            eprintln!("loci: {} of its lines and pictures could not be read", reviewed.unreadable);
        }
        let losses = map.zip(arguments.map.as_ref()).map(|(map, folder)| report_losses(&map, folder));
        Ok(if reviewed.unreadable > 0 { Outcome::Lost } else { losses.unwrap_or(Outcome::Done) })
    }

    /// Where the recording goes.
    fn recording(arguments: &ReviewArguments) -> anyhow::Result<PathBuf> {
        let out = match &arguments.out {
            Some(out) => out.clone(),
            None => {
                let what = arguments.what.canonicalize().unwrap_or_else(|_| arguments.what.clone());
                let mut name = what.file_name().unwrap_or_default().to_owned();
                name.push(".review.rrd");
                name.into()
            }
        };
        if out.extension().is_none_or(|extension| extension != "rrd") {
            let reason = format!("--out {}: its name must end in .rrd, or no viewer knows it", out.display());
            return Err(WrongArgument(reason).into());
        }
        Ok(out)
    }

    fn findings(recogniser: &mut Recogniser, stop: &AtomicBool) -> Result<Vec<Finding>, MapError> {
        let drifted = recogniser.drifted(stop)?;
        let purities = recogniser.purities(stop)?;
        let drifted = drifted.iter().map(|drift| Finding { place: drift.place, what: parts_in_words(drift) });
        let impure = purities.iter().filter(|purity| purity.share() <= LOW_PURITY);
        let impure = impure.map(|purity| Finding { place: purity.place, what: astray_in_words(purity) });
        let mut findings: Vec<Finding> = drifted.chain(impure).collect();
        findings.sort_by_key(|finding| finding.place);
        Ok(findings)
    }

    fn astray_in_words(purity: &Purity) -> String {
        let mut elsewhere: Vec<u32> = purity.astray.iter().map(|(_, other)| other.0).collect();
        elsewhere.sort_unstable();
        elsewhere.dedup();
        let elsewhere: Vec<String> = elsewhere.iter().map(ToString::to_string).collect();
        let (astray, keyframes) = (purity.astray.len(), purity.keyframes);
        format!("{astray} of {keyframes} keyframes look like places elsewhere: {}", elsewhere.join(", "))
    }
}
