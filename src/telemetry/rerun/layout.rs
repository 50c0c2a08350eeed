//! Where the nodes of a graph are drawn: forces that let each keep its distance from the others and draw neighbours
//! together (Fruchterman and Reingold, "Graph drawing by force-directed placement", 1991).
//!
//! A layout goes on from the one before, so that what people have seen stays where it was. The same calls give the same
//! picture.

use std::collections::BTreeMap;

use crate::place_map::PlaceId;

/// Length at which an edge is at rest.
const EDGE: f32 = 1.0;
/// Rounds after each change: enough for a node that is new, and few enough that no picture jumps.
const ROUNDS: usize = 40;
/// How far a node moves in a round at most, in the first one.
const FIRST_STEP: f32 = 0.25;
/// A node that is new lies off the way of the one before by this angle, so that ways are not all straight.
const BEND_RADIANS: f32 = 0.35;

/// Positions of nodes, in lengths of an edge.
#[derive(Default)]
pub(super) struct Layout {
    positions: BTreeMap<PlaceId, [f32; 2]>,
    /// In which direction the way went on.
    heading_radians: f32,
}

impl Layout {
    /// Where a node is, if it is in the layout.
    pub(super) fn position(&self, node: PlaceId) -> Option<[f32; 2]> {
        self.positions.get(&node).copied()
    }

    /// Makes room for `nodes`, which rise, and no others; `edges` join them.
    pub(super) fn settle(&mut self, nodes: &[PlaceId], edges: &[(PlaceId, PlaceId)]) {
        for (position, &node) in nodes.iter().enumerate() {
            if !self.positions.contains_key(&node) {
                let neighbour = edges.iter().find_map(|&(a, b)| match (a == node, b == node) {
                    (true, false) => self.position(b),
                    (false, true) => self.position(a),
                    _ => None,
                });
                let before = position.checked_sub(1).and_then(|before| self.position(nodes[before]));
                self.heading_radians += BEND_RADIANS;
                let (sine, cosine) = self.heading_radians.sin_cos();
                let [x, y] = neighbour.or(before).unwrap_or_default();
                self.positions.insert(node, [x + EDGE * cosine, y + EDGE * sine]);
            }
        }
        self.positions.retain(|node, _| nodes.binary_search(node).is_ok());
        let edges: Vec<[usize; 2]> = edges
            .iter()
            .filter_map(|(a, b)| Some([nodes.binary_search(a).ok()?, nodes.binary_search(b).ok()?]))
            .collect();
        let mut places: Vec<[f32; 2]> = self.positions.values().copied().collect();
        for round in 0..ROUNDS {
            let step = FIRST_STEP * (1.0 - round as f32 / ROUNDS as f32);
            relax(&mut places, &edges, step);
        }
        self.positions.values_mut().zip(places).for_each(|(position, place)| *position = place);
    }
}

/// One round, in which every node moves by `step` at most.
fn relax(places: &mut [[f32; 2]], edges: &[[usize; 2]], step: f32) {
    let mut forces = vec![[0.0_f32; 2]; places.len()];
    for a in 0..places.len() {
        for b in a + 1..places.len() {
            let (dx, dy, distance) = between(places[a], places[b], b);
            push(&mut forces, [a, b], [dx, dy], -EDGE * EDGE / (distance * distance));
        }
    }
    for &[a, b] in edges {
        let (dx, dy, distance) = between(places[a], places[b], b);
        push(&mut forces, [a, b], [dx, dy], distance / EDGE);
    }
    for (place, [x, y]) in places.iter_mut().zip(forces) {
        let length = x.hypot(y).max(f32::MIN_POSITIVE);
        let moved = length.min(step) / length;
        *place = [place[0] + x * moved, place[1] + y * moved];
    }
}

/// From `a` to `b`, never nothing: nodes on top of each other are parted, in a direction that is `b`'s.
fn between(a: [f32; 2], b: [f32; 2], salt: usize) -> (f32, f32, f32) {
    let [mut dx, mut dy] = [b[0] - a[0], b[1] - a[1]];
    if dx.abs().max(dy.abs()) < 1e-3 {
        (dy, dx) = (salt as f32).sin_cos();
        (dx, dy) = (dx * 1e-3, dy * 1e-3);
    }
    (dx, dy, dx.hypot(dy))
}

/// Draws both nodes together, or apart where `strength` is below 0.
fn push(forces: &mut [[f32; 2]], [a, b]: [usize; 2], [dx, dy]: [f32; 2], strength: f32) {
    for (node, sign) in [(a, strength), (b, -strength)] {
        forces[node] = [forces[node][0] + sign * dx, forces[node][1] + sign * dy];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(count: u32) -> (Vec<PlaceId>, Vec<(PlaceId, PlaceId)>) {
        let nodes: Vec<PlaceId> = (0..count).map(PlaceId).collect();
        let edges = (0..count).map(|node| (PlaceId(node), PlaceId((node + 1) % count))).collect();
        (nodes, edges)
    }

    fn distance(layout: &Layout, a: u32, b: u32) -> f32 {
        let [a, b] = [a, b].map(|node| layout.position(PlaceId(node)).unwrap());
        (a[0] - b[0]).hypot(a[1] - b[1])
    }

    #[test]
    fn a_way_that_comes_back_to_its_beginning_becomes_a_ring() {
        let mut layout = Layout::default();
        let (nodes, edges) = ring(12);
        // As it grows, the last edge coming last.
        for known in 1..=12 {
            layout.settle(&nodes[..known], &edges[..known - 1]);
        }
        (0..20).for_each(|_| layout.settle(&nodes, &edges));
        let across = distance(&layout, 0, 6);
        for node in 0..12 {
            let next = distance(&layout, node, (node + 1) % 12);
            assert!(next < 0.5 * across, "{node}: {next} of {across}");
        }
    }

    #[test]
    fn nodes_that_are_gone_are_forgotten() {
        let mut layout = Layout::default();
        let (nodes, edges) = ring(4);
        layout.settle(&nodes, &edges);
        layout.settle(&nodes[..2], &edges);
        assert!(layout.position(PlaceId(1)).is_some() && layout.position(PlaceId(2)).is_none());
    }

    #[test]
    fn nodes_on_top_of_each_other_are_parted_and_no_position_is_lost() {
        let (nodes, edges) = ring(30);
        let positions = nodes.iter().map(|&node| (node, [0.0, 0.0])).collect();
        let mut layout = Layout { positions, heading_radians: 0.0 };
        layout.settle(&nodes, &edges);
        let positions: Vec<[f32; 2]> = nodes.iter().filter_map(|&node| layout.position(node)).collect();
        assert!(positions.iter().flatten().all(|side| side.is_finite()));
        assert!(distance(&layout, 0, 15) > 0.1, "{positions:?}");
    }
}
