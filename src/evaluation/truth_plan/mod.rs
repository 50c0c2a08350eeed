//! From what was asked for (`--truth`) to a [`GroundTruth`] over frames: read and checked before any
//! frame is looked at, completed afterwards with what the sources themselves know.

mod matrix;
mod spec;
mod table;

use std::collections::HashMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

pub use self::spec::{NamedTolerance, TruthSpec, TruthSpecError};
use super::ground_truth::{GroundTruth, GroundTruthError, LoopMatrix, Rule, Spot, Table, Tolerance};
use super::layout;
use super::traverse::{Observation, Traverse, TraversePlan};

/// A ground truth, read and checked, over frame numbers.
#[derive(Clone, Debug)]
pub struct TruthPlan {
    definition: String,
    sha256: Option<String>,
    kind: Kind,
}

#[derive(Clone, Debug)]
enum Kind {
    /// A spot a frame number, of the query and of the reference.
    Spots {
        query: Vec<Spot>,
        reference: Vec<Spot>,
        tolerance: Tolerance,
    },
    Pairs(Pairs),
    /// Frame numbers.
    Ordinals(Tolerance),
    /// Positions that the frames carry.
    Positions(Tolerance),
    /// Place numbers that the frames carry.
    TruePlaces(Tolerance),
    Folders,
    Strangers,
}

/// Lists of matching frame numbers.
#[derive(Clone, Debug)]
struct Pairs {
    /// The matching reference frames of each query frame, sorted; `None` if nothing is said about it.
    matches: Vec<Option<Vec<u32>>>,
    /// Reference frames about which nothing is said; sorted.
    unsaid: Vec<u32>,
    /// Number of reference frames, where it is known.
    references: Option<usize>,
}

impl TruthPlan {
    /// Reads and checks what `spec` asks for; without it, what the layout of the traverses says.
    /// `reference` is `None` where the query is compared with its own past.
    ///
    /// # Errors
    /// If the ground truth is wrong or does not fit the frames; the error says which rows.
    pub fn prepare(
        spec: Option<&TruthSpec>,
        named: NamedTolerance,
        query: &TraversePlan,
        reference: Option<&TraversePlan>,
    ) -> Result<Self, GroundTruthError> {
        let plan = Self::of_spec(spec, named, query, reference)?;
        let in_use = match spec {
            Some(TruthSpec::Frames(_) | TruthSpec::Radius(_) | TruthSpec::Places(_)) => None,
            _ => plan.tolerance_in_use(),
        };
        match named.names().find(|&name| Some(name) != in_use) {
            Some(name) => Err(GroundTruthError::Mismatch(format!(
                "{name} would change nothing, since what counts is {}; leave it out",
                plan.definition
            ))),
            None => Ok(plan),
        }
    }

    fn of_spec(
        spec: Option<&TruthSpec>,
        named: NamedTolerance,
        query: &TraversePlan,
        reference: Option<&TraversePlan>,
    ) -> Result<Self, GroundTruthError> {
        let tolerance = named.or_default();
        match spec {
            Some(TruthSpec::File(path)) if table::is_table(path)? => {
                table::of_table(&Table::read(path)?, tolerance, query, reference)
            }
            Some(TruthSpec::File(path)) => {
                matrix::of_matrix(path, &LoopMatrix::read(path)?, query, reference)
            }
            Some(TruthSpec::Frames(frames)) => of_frame_numbers(*frames, tolerance, query, reference),
            Some(TruthSpec::Radius(metres)) => {
                of_positions(Tolerance { radius_metres: *metres, ..tolerance }, query, reference)
            }
            Some(TruthSpec::Places(places)) => {
                refuse_unless_synthetic("places=N", query, reference)?;
                Ok(Self::of_rule(
                    format!("places of the synthetic world at most {places} apart"),
                    Kind::TruePlaces(Tolerance { ordinals: *places, ..tolerance }),
                ))
            }
            Some(TruthSpec::Folders) => Ok(Self::of_rule(
                "different folders show different places; of frames of one folder nothing is said",
                Kind::Folders,
            )),
            Some(TruthSpec::Strangers) => {
                Ok(Self::of_rule("no query frame shows a place of the reference", Kind::Strangers))
            }
            None => of_layout(named, query, reference),
        }
    }

    /// The option that sets how far apart two frames of one place may be.
    fn tolerance_in_use(&self) -> Option<&'static str> {
        let of_spot = |spot: &Spot| match spot {
            Spot::LapPhase(_) => Some("lap-tolerance"),
            Spot::Metres(_) => Some("radius"),
            Spot::Ordinal(_) => Some("place-tolerance"),
            Spot::Places(_) | Spot::Unscored => None,
        };
        match &self.kind {
            Kind::Spots { query, .. } => query.iter().find_map(of_spot),
            Kind::Positions(_) => Some("radius"),
            _ => None,
        }
    }

    /// A plan that needs no file.
    fn of_rule(definition: impl Into<String>, kind: Kind) -> Self {
        Self { definition: definition.into(), sha256: None, kind }
    }

    /// The ground truth over the frames that were looked at.
    ///
    /// # Errors
    /// If the sources do not know what it needs.
    pub fn complete(&self, query: &Traverse, reference: &Traverse) -> Result<GroundTruth, GroundTruthError> {
        let rule = match &self.kind {
            Kind::Spots { query: queries, reference: references, tolerance } => {
                fits(query, queries.len())?;
                fits(reference, references.len())?;
                Rule::Spots {
                    query: by_number(query, queries),
                    reference: by_number(reference, references),
                    tolerance: *tolerance,
                }
            }
            Kind::Pairs(pairs) => {
                fits(query, pairs.matches.len())?;
                pairs.references.map_or(Ok(()), |references| fits(reference, references))?;
                renumbered(pairs, query, reference)
            }
            Kind::Ordinals(tolerance) => {
                spots(query, reference, *tolerance, |seen| Some(Spot::Ordinal(seen.number as i64)))?
            }
            Kind::Positions(tolerance) => {
                spots(query, reference, *tolerance, |seen| seen.position_metres.map(Spot::Metres))?
            }
            Kind::TruePlaces(tolerance) => spots(query, reference, *tolerance, |seen| {
                seen.true_place.map(|place| Spot::Ordinal(i64::from(place)))
            })?,
            Kind::Folders => by_folder(query, reference),
            Kind::Strangers => Rule::Strangers,
        };
        Ok(GroundTruth { definition: self.definition.clone(), sha256: self.sha256.clone(), rule })
    }
}

fn spots(
    query: &Traverse,
    reference: &Traverse,
    tolerance: Tolerance,
    of: impl Fn(&Observation) -> Option<Spot>,
) -> Result<Rule, GroundTruthError> {
    let all = |traverse: &Traverse| -> Result<Vec<Spot>, GroundTruthError> {
        let spots: Option<Vec<Spot>> = traverse.observations.iter().map(&of).collect();
        spots.ok_or_else(|| {
            let reason =
                format!("the frames of {} do not carry it; name a ground truth with --truth", traverse.name);
            GroundTruthError::Mismatch(reason)
        })
    };
    Ok(Rule::Spots { query: all(query)?, reference: all(reference)?, tolerance })
}

/// A number for each folder, given to its frames.
fn by_folder(query: &Traverse, reference: &Traverse) -> Rule {
    let mut numbers: HashMap<PathBuf, u32> = HashMap::new();
    let mut of = |traverse: &Traverse| {
        let number = |seen: &Observation| {
            let folder = seen.folder.canonicalize().unwrap_or_else(|_| seen.folder.clone());
            let next = numbers.len() as u32;
            *numbers.entry(folder).or_insert(next)
        };
        traverse.observations.iter().map(number).collect()
    };
    Rule::Groups { query: of(query), reference: of(reference) }
}

/// Fails unless the ground truth says something of as many frames as the traverse turned out to have.
fn fits(traverse: &Traverse, said: usize) -> Result<(), GroundTruthError> {
    let beyond = traverse.observations.last().is_some_and(|last| last.number >= said as u64);
    let too_few = traverse.skipped == 0 && traverse.end < said as u64;
    if beyond || too_few {
        let reason = format!("it speaks of {said} frames, but {} has about {}", traverse.name, traverse.end);
        return Err(GroundTruthError::Mismatch(reason));
    }
    Ok(())
}

fn by_number(traverse: &Traverse, spots: &[Spot]) -> Vec<Spot> {
    let spot = |seen: &Observation| spots.get(seen.number as usize).cloned().unwrap_or(Spot::Unscored);
    traverse.observations.iter().map(spot).collect()
}

/// Pairs of frame numbers as pairs of positions among the frames that were looked at.
fn renumbered(pairs: &Pairs, query: &Traverse, reference: &Traverse) -> Rule {
    let position: HashMap<u64, u32> =
        (0..).zip(&reference.observations).map(|(position, seen)| (seen.number, position)).collect();
    let positions = |numbers: &[u32]| -> Vec<u32> {
        numbers.iter().filter_map(|&number| position.get(&u64::from(number)).copied()).collect()
    };
    let row = |seen: &Observation| pairs.matches.get(seen.number as usize)?.as_deref().map(positions);
    Rule::Pairs { matches: query.observations.iter().map(row).collect(), unsaid: positions(&pairs.unsaid) }
}

/// SHA-256 of the file at `path`, in hexadecimal.
pub(super) fn sha256(path: &Path) -> Result<String, std::io::Error> {
    let mut file = File::open(path)?;
    let mut hash = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    loop {
        match file.read(&mut buffer)? {
            0 => break,
            read => hash.update(&buffer[..read]),
        }
    }
    Ok(hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

fn hash_of(path: &Path) -> Result<Option<String>, GroundTruthError> {
    sha256(path).map(Some).map_err(|error| GroundTruthError::read(path, error))
}

fn of_frame_numbers(
    frames: i64,
    tolerance: Tolerance,
    query: &TraversePlan,
    reference: Option<&TraversePlan>,
) -> Result<TruthPlan, GroundTruthError> {
    let Some(reference) = reference else {
        let reason = "frames=N needs an aligned --reference; a sequence against its own past has none";
        return Err(GroundTruthError::Mismatch(reason.into()));
    };
    if let (Some(query_frames), Some(reference_frames)) = (query.frame_count(), reference.frame_count())
        && query_frames != reference_frames
    {
        return Err(GroundTruthError::Mismatch(format!(
            "frames=N needs aligned traverses, but {} has {query_frames} frames and {} has {reference_frames}",
            query.name, reference.name
        )));
    }
    Ok(TruthPlan::of_rule(
        format!("frame numbers at most {frames} apart"),
        Kind::Ordinals(Tolerance { ordinals: frames, ..tolerance }),
    ))
}

/// Fails unless the frames carry what only those of a synthetic world carry.
fn refuse_unless_synthetic(
    what: &str,
    query: &TraversePlan,
    reference: Option<&TraversePlan>,
) -> Result<(), GroundTruthError> {
    match [Some(query), reference].into_iter().flatten().find(|plan| !plan.is_synthetic()) {
        Some(plan) => Err(GroundTruthError::Mismatch(format!(
            "the frames of {} do not carry what {what} needs; name a table or matrix with --truth FILE",
            plan.name
        ))),
        None => Ok(()),
    }
}

fn of_positions(
    tolerance: Tolerance,
    query: &TraversePlan,
    reference: Option<&TraversePlan>,
) -> Result<TruthPlan, GroundTruthError> {
    let definition = format!("positions within {} m", tolerance.radius_metres);
    let references = reference.unwrap_or(query);
    let kind = match (&query.positions_metres, &references.positions_metres) {
        (Some(queries), Some(references)) => {
            let spots = |positions: &[[f64; 2]]| positions.iter().map(|&at| Spot::Metres(at)).collect();
            Kind::Spots { query: spots(queries), reference: spots(references), tolerance }
        }
        _ => {
            refuse_unless_synthetic("a radius", query, reference)?;
            Kind::Positions(tolerance)
        }
    };
    Ok(TruthPlan::of_rule(definition, kind))
}

fn of_layout(
    named: NamedTolerance,
    query: &TraversePlan,
    reference: Option<&TraversePlan>,
) -> Result<TruthPlan, GroundTruthError> {
    match (&query.rule, &query.loops) {
        (layout::Rule::Radius { metres }, _) => {
            let radius_metres = named.radius_metres.unwrap_or(*metres);
            of_positions(Tolerance { radius_metres, ..named.or_default() }, query, reference)
        }
        (layout::Rule::Frames { tolerance: frames }, _) => {
            of_frame_numbers(i64::from(*frames), named.or_default(), query, reference)
        }
        (layout::Rule::Loops, Some((path, loops))) => matrix::of_matrix(path, loops, query, reference),
        _ => Err(GroundTruthError::Mismatch(format!(
            "nothing says which frames of {} show the same place; name it with --truth",
            query.name
        ))),
    }
}
