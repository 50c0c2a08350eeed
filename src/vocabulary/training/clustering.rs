//! One split: k-medians around binary centres (Grana et al., *A Fast Approach for Integrating ORB
//! Descriptors in the Bag of Words Model*, 2013), seeded as k-means++ is.

use rand::Rng;
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::TrainingWatcher;
use crate::feature::Descriptor;
use crate::kernel;

/// Rounds of k-medians after which a split is taken as it is. Splits settle in 5 to 30 rounds; this
/// only bounds one that goes back and forth between equally good answers.
const MAX_ROUNDS: usize = 100;
/// Descriptors that one task works on; smaller sets are not worth a second core.
const CHUNK_DESCRIPTORS: usize = 16_384;
/// The cluster of a descriptor that has none yet.
const NOWHERE: u8 = u8::MAX;

/// A cluster of a split: its centre and how many descriptors it took.
#[derive(Debug)]
pub(super) struct Cluster {
    pub(super) centre: [u8; 32],
    pub(super) size: usize,
}

/// Splits `run` into at most `k` clusters and reorders it so that each is one run, in their order; taken as it is where
/// `watcher` ends it.
pub(super) fn split(
    run: &mut [Descriptor],
    k: usize,
    random: &mut Pcg64,
    watcher: &dyn TrainingWatcher,
) -> Vec<Cluster> {
    let mut centres = first_centres(run, k, random);
    let mut assignment = vec![NOWHERE; run.len()];
    let mut members = vec![BitCounts::default(); centres.len()];
    let chunks = run.len().div_ceil(CHUNK_DESCRIPTORS);
    let mut moves = vec![vec![Moves::default(); centres.len()]; chunks];
    for _ in 0..MAX_ROUNDS {
        if !assign(run, &centres, &mut assignment, &mut moves) || !watcher.goes_on() {
            break;
        }
        for moves in &mut moves {
            members.iter_mut().zip(moves).for_each(|(members, moves)| members.follow(moves));
        }
        centres = medians(&members, &centres);
    }
    let sizes = sort_by_cluster(run, &assignment, centres.len());
    let clusters = centres.into_iter().zip(sizes).map(|(centre, size)| Cluster { centre, size });
    clusters.filter(|cluster| cluster.size > 0).collect()
}

/// Reorders `run` by cluster, stably; answers the sizes.
fn sort_by_cluster(run: &mut [Descriptor], assignment: &[u8], k: usize) -> Vec<usize> {
    let mut sizes = vec![0; k];
    for &cluster in assignment {
        sizes[usize::from(cluster)] += 1;
    }
    let mut next: Vec<usize> = (0..k).map(|cluster| sizes[..cluster].iter().sum()).collect();
    let unsorted = run.to_vec();
    for (descriptor, &cluster) in unsorted.into_iter().zip(assignment) {
        let place = &mut next[usize::from(cluster)];
        run[*place] = descriptor;
        *place += 1;
    }
    sizes
}

/// k-means++ seeding: each further centre is drawn with probability proportional to the squared
/// distance to the nearest one so far. Fewer than `k` where the descriptors repeat.
fn first_centres(run: &[Descriptor], k: usize, random: &mut Pcg64) -> Vec<[u8; 32]> {
    let mut centres = vec![run[random.random_range(0..run.len())].0];
    let mut nearest = vec![u32::MAX; run.len()];
    while centres.len() < k {
        let newest = centres[centres.len() - 1];
        let chunks = nearest.par_chunks_mut(CHUNK_DESCRIPTORS).zip(run.par_chunks(CHUNK_DESCRIPTORS));
        let total: u64 = chunks.map(|(nearest, run)| approach(nearest, run, &newest)).sum();
        if total == 0 {
            break;
        }
        let mut drawn = random.random_range(0..total);
        let chosen = nearest.iter().position(|&distance| {
            let here = drawn < u64::from(distance);
            drawn = drawn.saturating_sub(u64::from(distance));
            here
        });
        centres.extend(chosen.map(|index| run[index].0));
    }
    centres
}

/// Lowers squared distances to that to `centre`, where it is nearer; answers their sum.
fn approach(nearest: &mut [u32], run: &[Descriptor], centre: &[u8; 32]) -> u64 {
    let mut total = 0;
    for (distance, descriptor) in nearest.iter_mut().zip(run) {
        let (_, bits) = kernel::nearest(&descriptor.0, std::slice::from_ref(centre));
        *distance = (*distance).min(bits * bits);
        total += u64::from(*distance);
    }
    total
}

/// Gives every descriptor its nearest centre, the first of equally near ones; whether any moved. Each chunk
/// notes its `moves`.
fn assign(run: &[Descriptor], centres: &[[u8; 32]], assignment: &mut [u8], moves: &mut [Vec<Moves>]) -> bool {
    let chunks = assignment.par_chunks_mut(CHUNK_DESCRIPTORS).zip(run.par_chunks(CHUNK_DESCRIPTORS));
    let moved = chunks.zip(moves).map(|((assignment, run), moves)| {
        let mut any = false;
        for (assigned, descriptor) in assignment.iter_mut().zip(run) {
            let nearest = kernel::nearest(&descriptor.0, centres).0 as u8;
            if nearest == *assigned {
                continue;
            }
            any = true;
            if *assigned != NOWHERE {
                moves[usize::from(*assigned)].lost.add(&descriptor.0);
            }
            moves[usize::from(nearest)].gained.add(&descriptor.0);
            *assigned = nearest;
        }
        any
    });
    moved.reduce(|| false, |a, b| a | b)
}

/// The bitwise majority of each cluster, a tie setting the bit; an empty cluster keeps its centre.
fn medians(members: &[BitCounts], centres: &[[u8; 32]]) -> Vec<[u8; 32]> {
    members.iter().zip(centres).map(|(members, &centre)| members.majority().unwrap_or(centre)).collect()
}

/// The descriptors that a cluster gained and lost in a round: late in a split they are few.
#[derive(Clone, Default)]
struct Moves {
    gained: BitCounts,
    lost: BitCounts,
}

/// How many of some bit strings have each bit set. Bits are first counted in bytes, many at a time, which
/// are emptied before they overflow.
#[derive(Clone, Default)]
struct BitCounts {
    /// `recent[bit][byte]`.
    recent: [[u8; 32]; 8],
    recent_strings: u8,
    settled: [[u32; 32]; 8],
    strings: u32,
}

impl BitCounts {
    #[inline]
    fn add(&mut self, string: &[u8; 32]) {
        if self.recent_strings == u8::MAX {
            self.settle();
        }
        for (bit, counts) in self.recent.iter_mut().enumerate() {
            for (count, byte) in counts.iter_mut().zip(string) {
                *count += byte >> bit & 1;
            }
        }
        self.recent_strings += 1;
    }

    fn settle(&mut self) {
        for (settled, recent) in self.settled.as_flattened_mut().iter_mut().zip(self.recent.as_flattened()) {
            *settled += u32::from(*recent);
        }
        self.strings += u32::from(self.recent_strings);
        self.recent = [[0; 32]; 8];
        self.recent_strings = 0;
    }

    /// Takes in what was gained and lets go what was lost; empties `moves`.
    fn follow(&mut self, moves: &mut Moves) {
        let Moves { gained, lost } = moves;
        self.change_by(gained, |mine, theirs| mine + theirs);
        self.change_by(lost, |mine, theirs| mine - theirs);
    }

    fn change_by(&mut self, counts: &mut Self, change: impl Fn(u32, u32) -> u32) {
        if counts.recent_strings == 0 {
            return;
        }
        counts.settle();
        let pairs = self.settled.as_flattened_mut().iter_mut().zip(counts.settled.as_flattened());
        pairs.for_each(|(mine, theirs)| *mine = change(*mine, *theirs));
        self.strings = change(self.strings, counts.strings);
        *counts = Self::default();
    }

    /// The bits that at least half of the settled strings have set; `None` of no string.
    fn majority(&self) -> Option<[u8; 32]> {
        let needed = self.strings.div_ceil(2);
        let byte = |index: usize| {
            (0..8).fold(0, |byte, bit| byte | u8::from(self.settled[bit][index] >= needed) << bit)
        };
        (self.strings > 0).then(|| std::array::from_fn(byte))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::{Rng, SeedableRng};

    proptest! {
        #[test]
        fn a_median_is_never_farther_from_its_cluster_than_any_member(
            run in proptest::collection::vec(any::<[u8; 32]>().prop_map(Descriptor), 1..12),
        ) {
            let mut counts = BitCounts::default();
            run.iter().for_each(|descriptor| counts.add(&descriptor.0));
            counts.settle();
            let median = Descriptor(counts.majority().unwrap());
            let cost = |centre: &Descriptor| run.iter().map(|d| d.distance(centre)).sum::<u32>();
            prop_assert!(run.iter().all(|member| cost(&median) <= cost(member)));
        }

        #[test]
        fn a_split_keeps_every_descriptor_and_gives_each_its_nearest_centre(
            descriptors in proptest::collection::vec(any::<[u8; 32]>().prop_map(Descriptor), 2..60),
            k in 2..8_usize,
        ) {
            let mut run = descriptors.clone();
            let clusters = split(&mut run, k, &mut Pcg64::seed_from_u64(1), &());
            let mut start = 0;
            for cluster in &clusters {
                for descriptor in &run[start..start + cluster.size] {
                    let nearest = clusters.iter().map(|c| descriptor.distance(&Descriptor(c.centre))).min();
                    prop_assert_eq!(Some(descriptor.distance(&Descriptor(cluster.centre))), nearest);
                }
                start += cluster.size;
            }
            prop_assert_eq!(start, run.len());
            let sorted = |mut v: Vec<Descriptor>| { v.sort_by_key(|d| d.0); v };
            prop_assert_eq!(sorted(run), sorted(descriptors));
        }

        #[test]
        fn a_median_has_the_bits_that_half_of_its_cluster_has(
            seed in any::<u64>(), count in 1..700_usize, rounds in 1..4_usize,
        ) {
            let mut random = Pcg64::seed_from_u64(seed);
            let run: Vec<Descriptor> = (0..count).map(|_| Descriptor(random.random())).collect();
            let mut assignment = vec![NOWHERE; count];
            let mut members = vec![BitCounts::default(); 3];
            for _ in 0..rounds {
                let centres: Vec<[u8; 32]> = (0..3).map(|_| random.random()).collect();
                let mut moves = vec![vec![Moves::default(); 3]];
                assign(&run, &centres, &mut assignment, &mut moves);
                members.iter_mut().zip(&mut moves[0]).for_each(|(members, moves)| members.follow(moves));
            }
            for (cluster, median) in medians(&members, &[[9; 32]; 3]).into_iter().enumerate() {
                let of_cluster = run.iter().zip(&assignment).filter(|pair| usize::from(*pair.1) == cluster);
                let strings: Vec<&Descriptor> = of_cluster.map(|pair| pair.0).collect();
                let expected = if strings.is_empty() { [9; 32] } else {
                    std::array::from_fn(|byte| (0..8).fold(0, |all, bit| {
                        let ones = strings.iter().filter(|string| string.0[byte] >> bit & 1 == 1).count();
                        all | u8::from(2 * ones >= strings.len()) << bit
                    }))
                };
                prop_assert_eq!(median, expected);
            }
        }
    }
}
