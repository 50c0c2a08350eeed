//! The robot's database: the map that Loci founds by itself on the reference, then only reads; or one
//! that grows along the query, where a sequence is compared with its own past.
//!
//! Here `loci run` itself answers. The methods differ in what it gets to see: without features there is
//! no BoW+HV, without a model there is no CNN.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use super::EvaluationError;
use super::answer::{Answer, Candidate};
use super::results::Method;
use super::traverse::{Eyes, Observation, Traverse};
use crate::place_map::{ExperienceId, MapError, MapOptions, PlaceId, PlaceMap};
use crate::recognition::{self, Decision, Look, Recogniser, Recognition, RecognitionOptions};

/// What a robot answered along a traverse, and what it knew in the end.
pub struct MapRun {
    /// An answer a frame.
    pub answers: Vec<Answer>,
    /// Time of retrieval and of verification and decision a frame, in microseconds.
    pub latency_us: Vec<(u64, u64)>,
}

/// How a robot decides, and how large its map may grow.
#[derive(Clone, Debug)]
pub struct RobotOptions {
    /// Settings of the decision.
    pub recognition: RecognitionOptions,
    /// Settings of the map, which is kept in memory.
    pub map: MapOptions,
}

/// A robot with a map in memory. Its experiences are frames that it saw while the map grew, in order.
pub struct Robot<'a> {
    method: Method,
    eyes: &'a Eyes,
    options: RecognitionOptions,
    recogniser: Recogniser,
    /// The frame that each experience is of.
    frames: Vec<usize>,
}

impl<'a> Robot<'a> {
    /// A robot that knows no place.
    ///
    /// # Errors
    /// If there is no map to be had.
    pub fn new(method: Method, eyes: &'a Eyes, options: &RobotOptions) -> Result<Self, EvaluationError> {
        let map = PlaceMap::in_memory(options.map)?;
        let options = RecognitionOptions { read_only: false, ..options.recognition.clone() };
        let recogniser = recogniser(method, eyes, map, options.clone())?;
        Ok(Self { method, eyes, options, recogniser, frames: Vec::new() })
    }

    /// From now on the map stays as it is.
    ///
    /// # Errors
    /// If a keyframe cannot be read.
    pub fn reading_only(self) -> Result<Self, EvaluationError> {
        let options = RecognitionOptions { read_only: true, ..self.options };
        let recogniser = recogniser(self.method, self.eyes, self.recogniser.into_map(), options.clone())?;
        Ok(Self { options, recogniser, ..self })
    }

    /// The frames of each place, in order.
    #[must_use]
    pub fn places(&self) -> Vec<Vec<usize>> {
        let places = self.recogniser.map().places();
        places.map(|place| place.experiences.iter().map(|&id| self.frame_of(id)).collect()).collect()
    }

    /// The frame that an experience is of.
    fn frame_of(&self, experience: ExperienceId) -> usize {
        self.frames[experience.0 as usize]
    }

    /// Answers along `traverse`, unless `stop` is set meanwhile.
    ///
    /// # Errors
    /// If the map cannot grow, or it was interrupted.
    pub fn walk(&mut self, traverse: &Traverse, stop: &AtomicBool) -> Result<MapRun, EvaluationError> {
        self.recogniser.begin_anew();
        let mut run = MapRun { answers: Vec::new(), latency_us: Vec::new() };
        for (index, observation) in traverse.observations.iter().enumerate() {
            if stop.load(Ordering::Relaxed) {
                return Err(EvaluationError::Interrupted);
            }
            let look = self.look(observation);
            let frame = observation.frame(index);
            let started = Instant::now();
            let mut candidates = self.recogniser.retrieve(&look);
            let retrieval_us = started.elapsed().as_micros() as u64;
            let verifications = self.recogniser.verify(&look, &mut candidates);
            let recognition = self.recogniser.decide(&frame, &look, (candidates, verifications), Vec::new);
            self.recogniser.take_map_failure().map_or(Ok(()), Err)?;
            if recognition.experience.is_some() {
                self.frames.push(index);
            }
            let verification_us = started.elapsed().as_micros() as u64 - retrieval_us;
            run.answers.push(self.answer(&recognition));
            run.latency_us.push((retrieval_us, verification_us));
        }
        // What a place was called when it was named may have turned out to be another one since.
        run.answers.iter_mut().flat_map(|answer| &mut answer.candidates).for_each(|candidate| {
            let place = candidate.place.and_then(|place| self.recogniser.map().place(PlaceId(place as u32)));
            candidate.place = place.map(|place| place.id.0 as usize);
        });
        Ok(run)
    }

    /// What the method gets to see.
    fn look(&self, observation: &Observation) -> Look {
        let look = &observation.look;
        match self.method {
            Method::Cnn => Look { appearance: look.appearance.clone(), ..Look::default() },
            Method::BowHv => Look { appearance: None, ..look.clone() },
            Method::CnnBowHv => look.clone(),
        }
    }

    fn answer(&self, recognition: &Recognition) -> Answer {
        let candidate = |candidate: &recognition::Candidate| Candidate {
            reference: self.frame_of(candidate.keyframe),
            place: Some(candidate.place.0 as usize),
            probability: f64::from(candidate.probability),
            reason: reason(candidate),
        };
        let is_given = matches!(recognition.decision, Decision::Recognised | Decision::Revisited);
        let chosen = recognition.candidates.iter().find(|candidate| is_given && candidate.rejected.is_none());
        // What was decided to be no match is one as likely as its likeliest place.
        let likeliest = recognition.grounds.places.iter().map(|grounds| grounds.around).reduce(f32::max);
        let confidence = if is_given { recognition.confidence } else { likeliest.unwrap_or_default() };
        let confidence = f64::from(confidence);
        Answer::new(chosen.map(candidate), recognition.candidates.iter().map(candidate).collect(), confidence)
    }
}

fn recogniser(
    method: Method,
    eyes: &Eyes,
    map: PlaceMap,
    options: RecognitionOptions,
) -> Result<Recogniser, MapError> {
    let model = eyes.model.as_ref().filter(|_| method != Method::BowHv).map(|model| model.card().clone());
    Recogniser::new(Arc::clone(&eyes.vocabularies), map, model, options)
}

fn reason(candidate: &recognition::Candidate) -> String {
    let found = match candidate.inliers {
        Some(inliers) => format!("{inliers} effective inliers"),
        None => format!("{} score {:.3}", candidate.by.as_str(), candidate.score),
    };
    match candidate.rejected {
        Some(rejected) => format!("{found}, rejected: {rejected}"),
        None => format!("{found}, accepted"),
    }
}
