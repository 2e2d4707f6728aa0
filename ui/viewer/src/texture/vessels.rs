//! Tileable blood vessels: trees grown by space colonisation (Runions, Lane, Prusinkiewicz, "Modeling trees with a
//! space colonization algorithm", 2007) on a torus, with radii by Murray's law (1926): the cube of a vessel's radius is
//! the sum of the cubes of its branches' radii.

use trocar_scene::random::SplitMix64;

use super::noise::{wrap, wrapped_difference};

/// Parameters of a vessel tree; lengths in widths of the tile.
#[derive(Clone, Copy, Debug)]
pub struct Growth {
    /// Position of the root.
    pub root: [f32; 2],
    /// Direction and length of its trunk, before any attractor acts.
    pub trunk: [f32; 2],
    /// Number of attractors, spread over the tile.
    pub attractors: u32,
    /// Length of one step.
    pub step: f32,
    /// Radius of the finest vessels.
    pub tip_radius: f32,
    /// Radius that no vessel exceeds.
    pub radius_max: f32,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    at: [f32; 2],
    parent: usize,
    radius: f32,
}

/// A tree of vessels in the unit square, wrapped around.
#[derive(Clone, Debug)]
pub struct VesselTree {
    nodes: Vec<Node>,
}

/// Most growth steps.
const STEPS_MAX: usize = 400;
/// Distance within which an attractor acts, in widths of the tile.
const INFLUENCE: f32 = 0.11;
/// Most nodes.
const NODES_MAX: usize = 20_000;

fn apart(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [wrapped_difference(a[0], b[0]), wrapped_difference(a[1], b[1])]
}

fn square(d: [f32; 2]) -> f32 {
    d[0] * d[0] + d[1] * d[1]
}

impl VesselTree {
    /// Grows a tree.
    pub fn grow(seed: u64, growth: &Growth) -> Self {
        let mut random = SplitMix64::new(seed);
        let step = growth.step.clamp(0.002, 0.1);
        let reached = (2.0 * step) * (2.0 * step);
        // Stratified, so that every region is supplied.
        let side = (growth.attractors.clamp(1, 4096) as f32).sqrt().ceil() as u32;
        let mut nodes = trunk(&mut random, growth, step);
        let mut attractors: Vec<Attractor> = (0..side * side)
            .map(|index| {
                let at = [index % side, index / side].map(|i| (i as f32 + random.unit_f32()) / side as f32);
                Attractor { at, nearest: 0, distance: f32::MAX }
            })
            .collect();
        attractors.iter_mut().for_each(|attractor| attractor.look_for(&nodes, 0));
        for _ in 0..STEPS_MAX {
            // For each node with attractors: the sum of their directions, in the order of the nodes. Far attractors do
            // not act before the tree has come near; but if all are far, all act.
            let near = attractors.iter().map(|attractor| attractor.distance).fold(f32::MAX, f32::min);
            let reach = (INFLUENCE * INFLUENCE).max(near * 1.2);
            let mut pulls: Vec<(usize, [f32; 2])> = attractors
                .iter()
                .filter(|attractor| attractor.distance <= reach)
                .map(|attractor| {
                    let d = apart(attractor.at, nodes[attractor.nearest].at);
                    let length = square(d).sqrt().max(1e-6);
                    (attractor.nearest, [d[0] / length, d[1] / length])
                })
                .collect();
            pulls.sort_by_key(|pull| pull.0);
            let first_new = nodes.len();
            for group in pulls.chunk_by(|a, b| a.0 == b.0) {
                let mut pull = [0.0f32; 2];
                group.iter().for_each(|(_, d)| (0..2).for_each(|k| pull[k] += d[k]));
                // A random deviation keeps vessels from being straight lines and breaks ties of opposite directions.
                (0..2).for_each(|k| pull[k] += 0.7 * (random.unit_f32() - 0.5));
                let length = square(pull).sqrt().max(1e-6);
                let parent = group[0].0;
                let at = [0, 1].map(|k| wrap(nodes[parent].at[k] + step * pull[k] / length));
                nodes.push(Node { at, parent, radius: growth.tip_radius });
            }
            attractors.iter_mut().for_each(|attractor| attractor.look_for(&nodes, first_new));
            attractors.retain(|attractor| attractor.distance > reached);
            if attractors.is_empty() || nodes.len() > NODES_MAX {
                break;
            }
        }
        let mut tree = Self { nodes };
        tree.widen(growth.tip_radius, growth.radius_max);
        tree
    }

    /// Radii by Murray's law, from the tips to the root. Children come after their parents.
    fn widen(&mut self, tip: f32, largest: f32) {
        let mut cubes = vec![0.0f32; self.nodes.len()];
        for index in (0..self.nodes.len()).rev() {
            let cube = if cubes[index] > 0.0 { cubes[index] } else { tip * tip * tip };
            self.nodes[index].radius = cube_root(cube).min(largest);
            if index > 0 {
                cubes[self.nodes[index].parent] += cube;
            }
        }
    }

    /// Draws the tree into a square of `size × size` texels: the depth of each texel inside a vessel, as the share of
    /// the chord of a vertical ray through the vessel (0 outside, 1 in the middle of one of the radius `full`).
    /// Softened by one texel.
    pub fn draw(&self, size: u32, full: f32) -> Vec<f32> {
        let mut picture = vec![0.0f32; size as usize * size as usize];
        for node in self.nodes.iter().skip(1) {
            self.draw_segment(&mut picture, size, node, full);
        }
        picture
    }

    fn draw_segment(&self, picture: &mut [f32], size: u32, node: &Node, full: f32) {
        let scale = size as f32;
        let parent = &self.nodes[node.parent];
        let along = apart(node.at, parent.at);
        let length = square(along).max(1e-12);
        let start = parent.at.map(|x| x * scale);
        let end = [start[0] + along[0] * scale, start[1] + along[1] * scale];
        // The root's end is not thicker than its only child, nor a small branch as thick as its trunk.
        let parent_radius = parent.radius.min(node.radius * 1.3);
        let margin = node.radius.max(parent_radius) * scale + 1.5;
        let low = [0, 1].map(|k| (start[k].min(end[k]) - margin).floor() as i64);
        let high = [0, 1].map(|k| (start[k].max(end[k]) + margin).ceil() as i64);
        for row in low[1]..=high[1] {
            for column in low[0]..=high[0] {
                let d = [(column as f32 + 0.5 - start[0]) / scale, (row as f32 + 0.5 - start[1]) / scale];
                let t = ((d[0] * along[0] + d[1] * along[1]) / length).clamp(0.0, 1.0);
                let off = [d[0] - t * along[0], d[1] - t * along[1]];
                let radius = parent_radius + (node.radius - parent_radius) * t;
                // Thinner than a texel: opacity in proportion to the width.
                let shown = radius.max(0.75 / scale);
                let inside = 1.0 - square(off) / (shown * shown);
                if inside > 0.0 {
                    let depth = inside.sqrt() * (radius / full).min(1.0) * (radius / shown);
                    let texel = row.rem_euclid(i64::from(size)) * i64::from(size)
                        + column.rem_euclid(i64::from(size));
                    let value = &mut picture[texel as usize];
                    *value = value.max(depth);
                }
            }
        }
    }
}

/// An attractor, and the nearest node so far.
struct Attractor {
    at: [f32; 2],
    nearest: usize,
    /// Squared distance.
    distance: f32,
}

impl Attractor {
    /// Checks whether a node from `first` on is nearer.
    fn look_for(&mut self, nodes: &[Node], first: usize) {
        for (index, node) in nodes.iter().enumerate().skip(first) {
            let distance = square(apart(self.at, node.at));
            if distance < self.distance {
                (self.nearest, self.distance) = (index, distance);
            }
        }
    }
}

/// A winding line of nodes from the root on: without it, all branches would start at one point, like spokes.
fn trunk(random: &mut SplitMix64, growth: &Growth, step: f32) -> Vec<Node> {
    let mut nodes = vec![Node { at: growth.root, parent: 0, radius: growth.tip_radius }];
    let length = square(growth.trunk).sqrt();
    let mut direction = growth.trunk.map(|x| x / length.max(1e-6));
    let mut bend = 0.0;
    for index in 1..=((length / step) as usize).min(200) {
        bend = 0.85 * bend + 0.16 * (random.unit_f32() - 0.5);
        direction = [direction[0] - bend * direction[1], direction[1] + bend * direction[0]];
        let norm = square(direction).sqrt();
        direction = direction.map(|x| x / norm);
        let at = [0, 1].map(|k| wrap(nodes[index - 1].at[k] + step * direction[k]));
        nodes.push(Node { at, parent: index - 1, radius: growth.tip_radius });
    }
    nodes
}

/// The cube root of a small positive number by Newton's method: the same bits everywhere.
fn cube_root(x: f32) -> f32 {
    let x = f64::from(x);
    let mut root = 0.05f64;
    for _ in 0..40 {
        root = (2.0 * root + x / (root * root)) / 3.0;
    }
    root as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    const GROWTH: Growth = Growth {
        root: [0.9, 0.1],
        trunk: [0.3, 0.2],
        attractors: 100,
        step: 0.02,
        tip_radius: 0.002,
        radius_max: 0.05,
    };

    #[test]
    fn every_region_is_supplied() {
        let tree = VesselTree::grow(5, &GROWTH);
        for (u, v) in (0..20).flat_map(|i| (0..20).map(move |j| (i as f32 / 20.0, j as f32 / 20.0))) {
            let nearest = tree.nodes.iter().map(|node| square(apart(node.at, [u, v]))).fold(1.0, f32::min);
            assert!(nearest.sqrt() < 0.2, "({u}, {v}) is {} from a vessel", nearest.sqrt());
        }
    }

    #[test]
    fn radii_follow_murrays_law() {
        let tree = VesselTree::grow(5, &GROWTH);
        let mut forks = 0;
        for (index, node) in tree.nodes.iter().enumerate() {
            let fed: Vec<f32> = (1..tree.nodes.len())
                .filter(|child| tree.nodes[*child].parent == index)
                .map(|child| tree.nodes[child].radius.powi(3))
                .collect();
            forks += usize::from(fed.len() > 1);
            let expected = if fed.is_empty() { GROWTH.tip_radius.powi(3) } else { fed.iter().sum() };
            assert!((node.radius.powi(3) / expected - 1.0).abs() < 1e-3, "{index}");
        }
        assert!(forks > 20, "{forks}");
    }

    #[test]
    fn a_drawn_tree_wraps_around() {
        let tree = VesselTree::grow(5, &GROWTH);
        let picture = tree.draw(128, 0.004);
        assert!(picture.iter().all(|depth| (0.0..=1.0).contains(depth)));
        let drawn = picture.iter().filter(|depth| **depth > 0.0).count() as f32 / picture.len() as f32;
        assert!((0.05..0.6).contains(&drawn), "{drawn}");
        // Steps are shorter than a tenth of the tile: each drawn segment is, too, or it went around wrongly.
        for node in &tree.nodes[1..] {
            let parent = tree.nodes[node.parent].at;
            assert!(square(apart(node.at, parent)).sqrt() < 0.021);
        }
        assert_eq!(picture, VesselTree::grow(5, &GROWTH).draw(128, 0.004), "the same bits every time");
    }

    #[test]
    fn cube_roots() {
        for x in [1e-9f32, 1e-6, 0.001, 0.125, 1.0] {
            assert!((cube_root(x).powi(3) / x - 1.0).abs() < 1e-5);
        }
    }
}
