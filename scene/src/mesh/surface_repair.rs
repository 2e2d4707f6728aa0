//! Repair of surfaces: vertices within a tolerance are welded, triangles without area, repeated ones and fins dropped, all
//! turned the same way and closed shells outwards, unused vertices dropped. Nothing is closed: a hole stays a hole.

use std::collections::{BTreeSet, HashMap};
use std::fmt;

use nalgebra::Point3;

use super::data::SurfaceData;
use super::shells::{HalfEdge, Shells, half_edges, shells};
use super::validate::is_degenerate;
use crate::disjoint_sets::DisjointSets;

/// The tolerance of welding by default, as a share of the diagonal of the box.
pub const WELD_RELATIVE: f64 = 1e-6;
/// Passes over the triangles without area: each flips the longest edge of some.
const PASSES_MAX: usize = 64;

/// What was repaired, by the numbers of the surface as it came.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SurfaceRepairs {
    /// Vertices welded to one of a smaller number: (vertex, to which).
    pub welded: Vec<(u32, u32)>,
    /// Triangles without area that were dropped.
    pub degenerate: Vec<u32>,
    /// Triangles without area whose longest edge was flipped, so that none is open.
    pub flipped: Vec<u32>,
    /// Triangles that repeated another one and were dropped.
    pub repeated: Vec<u32>,
    /// Triangles that stuck out of a closed body and were dropped.
    pub fins: Vec<u32>,
    /// Triangles that were turned.
    pub turned: Vec<u32>,
    /// Vertices that no triangle uses and that were dropped, without the welded ones.
    pub dropped_vertices: Vec<u32>,
}

impl SurfaceRepairs {
    /// Whether nothing was repaired.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// The repairs in words; `place` names a triangle.
    pub fn told(&self, place: impl Fn(usize) -> String) -> String {
        if self.is_empty() {
            return "nothing had to be mended".into();
        }
        let mut told = Vec::new();
        let many = |count: usize, one: &str, more: &str| match count {
            1 => format!("1 {one}"),
            _ => format!("{count} {more}"),
        };
        if !self.welded.is_empty() {
            let vertices = many(self.welded.len(), "vertex was", "vertices were");
            told.push(format!("{vertices} welded to others at their place"));
        }
        for (which, what) in [
            (&self.degenerate, "dropped that had no area"),
            (&self.flipped, "without area joined to the triangles beside them"),
            (&self.repeated, "dropped that repeated others"),
            (&self.fins, "dropped that stuck out of a closed body"),
            (&self.turned, "turned"),
        ] {
            if let Some(&first) = which.first() {
                let triangles = many(which.len(), "triangle was", "triangles were");
                let first = place(first as usize);
                let first = if which.len() == 1 { first } else { format!("the first: {first}") };
                told.push(format!("{triangles} {what} ({first})"));
            }
        }
        if !self.dropped_vertices.is_empty() {
            let vertices = many(self.dropped_vertices.len(), "vertex was", "vertices were");
            told.push(format!("{vertices} dropped that no triangle uses"));
        }
        told.join("; ")
    }
}

impl fmt::Display for SurfaceRepairs {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.told(|triangle| format!("triangle {triangle}")))
    }
}

/// The tolerance of welding when none is given \[m\].
#[must_use]
pub fn weld_tolerance(positions: &[Point3<f64>]) -> f64 {
    let Some(first) = positions.first() else { return 0.0 };
    let (min, max) = positions.iter().fold((*first, *first), |(min, max), p| (min.inf(p), max.sup(p)));
    WELD_RELATIVE * (max - min).norm()
}

/// A repaired surface, and what was done. `weld` is the distance within which vertices become one \[m\]; 0 welds equal
/// coordinates only.
///
/// # Panics
/// When an index is out of range; no reader returns such a surface.
#[must_use]
pub fn repaired_surface(surface: &SurfaceData, weld: f64) -> (SurfaceData, SurfaceRepairs) {
    let mut repairs = SurfaceRepairs::default();
    let mut mended = surface.clone();
    let into = welded(&surface.positions, weld);
    for (vertex, &to) in into.iter().enumerate().filter(|(vertex, to)| *vertex != **to as usize) {
        repairs.welded.push((vertex as u32, to));
    }
    for vertex in mended.triangles.iter_mut().flatten() {
        *vertex = into[*vertex as usize];
    }
    let mut numbers: Vec<u32> = (0..surface.triangles.len() as u32).collect();
    let repeats = |t: &[u32; 3]| t[0] == t[1] || t[1] == t[2] || t[2] == t[0];
    drop_triangles(&mut mended, &mut numbers, &mut repairs.degenerate, |mended, t| {
        repeats(&mended.triangles[t])
    });
    drop_repeated(&mut mended, &mut numbers, &mut repairs.repeated);
    flip_flat(&mut mended, &numbers, &mut repairs.flipped);
    drop_triangles(&mut mended, &mut numbers, &mut repairs.degenerate, is_degenerate);
    drop_repeated(&mut mended, &mut numbers, &mut repairs.repeated);
    drop_fins(&mut mended, &mut numbers, &mut repairs.fins);
    turn(&mut mended, &numbers, &mut repairs.turned);
    drop_vertices(&mut mended, &into, &mut repairs.dropped_vertices);
    for list in [&mut repairs.degenerate, &mut repairs.repeated, &mut repairs.flipped] {
        list.sort_unstable();
        list.dedup();
    }
    repairs.flipped.retain(|t| repairs.degenerate.binary_search(t).is_err());
    (mended, repairs)
}

/// For each vertex the first one within `tolerance` that is not itself welded to another.
fn welded(positions: &[Point3<f64>], tolerance: f64) -> Vec<u32> {
    let mut into = Vec::with_capacity(positions.len());
    if tolerance <= 0.0 || tolerance.is_nan() {
        let mut first_at = HashMap::new();
        for (vertex, position) in positions.iter().enumerate() {
            let key: [u64; 3] = position.coords.map(|x| (x + 0.0).to_bits()).into();
            into.push(*first_at.entry(key).or_insert(vertex as u32));
        }
        return into;
    }
    // Cells as wide as the tolerance: only those around a vertex can hold one that is near enough, and no cell holds more
    // than a few that are not welded. Looked up only, so the order of the map does not matter.
    let mut cells: HashMap<[i64; 3], Vec<u32>> = HashMap::new();
    for (vertex, position) in positions.iter().enumerate() {
        let cell: [i64; 3] = position.coords.map(|x| (x / tolerance).floor() as i64).into();
        let mut nearest: Option<u32> = None;
        for offset in 0..27 {
            let near = [offset % 3, offset / 3 % 3, offset / 9];
            let key = [0, 1, 2].map(|k| cell[k].saturating_add(near[k] - 1));
            for &other in cells.get(&key).into_iter().flatten() {
                if (positions[other as usize] - position).norm() <= tolerance {
                    nearest = Some(nearest.map_or(other, |found| found.min(other)));
                }
            }
        }
        into.push(nearest.unwrap_or(vertex as u32));
        if nearest.is_none() {
            cells.entry(cell).or_default().push(vertex as u32);
        }
    }
    into
}

/// Drops the triangles that `drops` tells, with their attributes and numbers; what is dropped is added to a list.
fn drop_triangles(
    surface: &mut SurfaceData,
    numbers: &mut Vec<u32>,
    dropped: &mut Vec<u32>,
    drops: impl Fn(&SurfaceData, usize) -> bool,
) {
    let keep: Vec<bool> = (0..surface.triangles.len()).map(|t| !drops(surface, t)).collect();
    dropped.extend(numbers.iter().zip(&keep).filter(|(_, keep)| !**keep).map(|(&number, _)| number));
    let mut kept = keep.iter();
    surface.triangles.retain(|_| *kept.next().unwrap_or(&true));
    let mut kept = keep.iter();
    if let Some(normals) = &mut surface.normals {
        normals.retain(|_| *kept.next().unwrap_or(&true));
    }
    let mut kept = keep.iter();
    if let Some(uvs) = &mut surface.uvs {
        uvs.retain(|_| *kept.next().unwrap_or(&true));
    }
    let mut kept = keep.iter();
    numbers.retain(|_| *kept.next().unwrap_or(&true));
}

/// Drops triangles with the corners of an earlier one, whichever way they are turned.
fn drop_repeated(surface: &mut SurfaceData, numbers: &mut Vec<u32>, dropped: &mut Vec<u32>) {
    let mut seen = BTreeSet::new();
    let repeated: Vec<bool> = surface
        .triangles
        .iter()
        .map(|triangle| {
            let mut key = *triangle;
            key.sort_unstable();
            !seen.insert(key)
        })
        .collect();
    drop_triangles(surface, numbers, dropped, |_, t| repeated[t]);
}

/// Drops patches with a rim that are attached to a closed body: each of their edges with more than two triangles has three,
/// one of the patch and two of patches without a rim.
fn drop_fins(surface: &mut SurfaceData, numbers: &mut Vec<u32>, dropped: &mut Vec<u32>) {
    let edges = half_edges(&surface.triangles);
    let alike = || edges.chunk_by(|a, b| a.0 == b.0);
    if alike().all(|edge| edge.len() <= 2) {
        return;
    }
    // Patches end where more than two triangles meet.
    let mut patches = DisjointSets::new(surface.triangles.len());
    for edge in alike().filter(|edge| edge.len() == 2) {
        patches.join(edge[0].2 as usize, edge[1].2 as usize);
    }
    let count = surface.triangles.len();
    let patch: Vec<usize> = (0..count).map(|t| patches.root(t)).collect();
    let mut has_rim = vec![false; count];
    alike().filter(|edge| edge.len() == 1).for_each(|edge| has_rim[patch[edge[0].2 as usize]] = true);
    let mut is_fin = has_rim.clone();
    let mut attached = vec![false; count];
    for edge in alike().filter(|edge| edge.len() > 2) {
        let of: Vec<usize> = edge.iter().map(|half| patch[half.2 as usize]).collect();
        let rims = of.iter().filter(|&&patch| has_rim[patch]).count();
        for &patch in of.iter().filter(|&&patch| has_rim[patch]) {
            attached[patch] = true;
            is_fin[patch] &= of.len() == 3 && rims == 1;
        }
    }
    drop_triangles(surface, numbers, dropped, |_, t| is_fin[patch[t]] && attached[patch[t]]);
}

/// Joins triangles whose corners lie on a line to the one across their longest edge: that edge is flipped to the middle
/// corner, so that no edge becomes open. Each flip makes the sum of the edges shorter, hence it ends.
fn flip_flat(surface: &mut SurfaceData, numbers: &[u32], flipped: &mut Vec<u32>) {
    for _ in 0..PASSES_MAX {
        let flat: Vec<usize> = (0..surface.triangles.len()).filter(|&t| is_degenerate(surface, t)).collect();
        if flat.is_empty() {
            return;
        }
        let edges = half_edges(&surface.triangles);
        let mut touched = vec![false; surface.triangles.len()];
        let mut any = false;
        for t in flat {
            let corners = surface.triangles[t];
            let length = |k: usize| {
                let at = |k: usize| surface.positions[corners[k % 3] as usize];
                (at(k + 1) - at(k)).norm()
            };
            let Some(longest) = (0..3).max_by(|&a, &b| length(a).total_cmp(&length(b))) else { continue };
            let (a, c) = (corners[longest], corners[(longest + 1) % 3]);
            let middle = (longest + 2) % 3;
            let b = corners[middle];
            let key = [a.min(c), a.max(c)];
            let begin = edges.partition_point(|edge: &HalfEdge| edge.0 < key);
            let beside: Vec<usize> =
                edges[begin..].iter().take_while(|edge| edge.0 == key).map(|edge| edge.2 as usize).collect();
            let [one, two] = beside.as_slice() else { continue };
            let other = if *one == t { *two } else { *one };
            let opposite = surface.triangles[other].into_iter().find(|&v| v != a && v != c);
            let Some(d) = opposite.filter(|&d| d != b && !touched[t] && !touched[other]) else { continue };
            let at = |v: u32| surface.positions[v as usize];
            if (at(d) - at(b)).norm() >= length(longest) {
                continue;
            }
            // The neighbour twice, with either end of the edge replaced by the corner in its middle.
            let corner_of = |v: u32| surface.triangles[other].iter().position(|&w| w == v).unwrap_or(0);
            let (at_a, at_c) = (corner_of(a), corner_of(c));
            surface.triangles[t] = surface.triangles[other];
            surface.triangles[t][at_a] = b;
            surface.triangles[other][at_c] = b;
            if let Some(normals) = &mut surface.normals {
                let new = normals[t][middle];
                normals[t] = normals[other];
                normals[t][at_a] = new;
                normals[other][at_c] = new;
            }
            if let Some(uvs) = &mut surface.uvs {
                let new = uvs[t][middle];
                uvs[t] = uvs[other];
                uvs[t][at_a] = new;
                uvs[other][at_c] = new;
            }
            touched[t] = true;
            touched[other] = true;
            flipped.push(numbers[t]);
            any = true;
        }
        if !any {
            return;
        }
    }
}

/// Turns triangles so that neighbours agree and closed shells face outwards. Of triangles that disagree, those with the
/// smaller area are turned. A shell within another keeps its side of it, so that cavities stay cavities.
fn turn(surface: &mut SurfaceData, numbers: &[u32], turned: &mut Vec<u32>) {
    let count = surface.triangles.len();
    let edges = half_edges(&surface.triangles);
    let mut beside: Vec<Vec<(u32, bool)>> = vec![Vec::new(); count];
    for edge in edges.chunk_by(|a, b| a.0 == b.0) {
        if let [one, two] = edge {
            let agree = one.1 != two.1;
            beside[one.2 as usize].push((two.2, agree));
            beside[two.2 as usize].push((one.2, agree));
        }
    }
    let mut turns: Vec<Option<bool>> = vec![None; count];
    let mut disagreed = vec![false; count];
    for start in 0..count {
        if turns[start].is_some() {
            continue;
        }
        turns[start] = Some(false);
        let mut part = vec![start];
        let mut areas = [0.0; 2];
        let mut next = 0;
        while let Some(&t) = part.get(next) {
            next += 1;
            let own = turns[t].unwrap_or(false);
            areas[usize::from(own)] += surface.area_vector(t).norm();
            for &(other, agree) in &beside[t] {
                if turns[other as usize].is_none() {
                    turns[other as usize] = Some(own == agree);
                    part.push(other as usize);
                }
            }
        }
        let turn_all = areas[1] > areas[0];
        let mixed = areas[0] > 0.0 && areas[1] > 0.0;
        for t in part {
            turns[t] = turns[t].map(|own| own != turn_all);
            disagreed[t] = mixed;
        }
    }
    let mut flips: Vec<bool> = turns.into_iter().map(|own| own.unwrap_or(false)).collect();
    flip(surface, &flips);
    let found = shells(surface);
    let over = turned_shells(surface, &found, |shell| disagreed[found.shells[shell].first]);
    let second: Vec<bool> = found.of_triangle.iter().map(|&shell| over[shell as usize]).collect();
    flip(surface, &second);
    flips.iter_mut().zip(&second).for_each(|(flip, second)| *flip ^= second);
    turned.extend((0..count).filter(|&t| flips[t]).map(|t| numbers[t]));
    turned.sort_unstable();
}

/// Which closed shells have to be turned.
fn turned_shells(surface: &SurfaceData, found: &Shells, was_mixed: impl Fn(usize) -> bool) -> Vec<bool> {
    let around = found.around(surface, |_| true);
    let mut over = vec![false; found.shells.len()];
    let mut order: Vec<usize> = (0..found.shells.len()).filter(|&shell| found.shells[shell].closed).collect();
    order.sort_by_key(|&shell| around[shell].len());
    for shell in order {
        let sign = |shell: usize| if (found.shells[shell].volume < 0.0) != over[shell] { -1 } else { 1 };
        let winding: i64 = around[shell].iter().map(|&outer| sign(outer as usize)).sum();
        // The innermost of those around it.
        let parent = around[shell].iter().copied().max_by_key(|&outer| around[outer as usize].len());
        let turn = match parent {
            None => found.shells[shell].volume < 0.0,
            // What faced either way says nothing about its side: a cavity is likelier than a body in a body.
            Some(parent) if was_mixed(shell) => sign(shell) == sign(parent as usize),
            Some(parent) => over[parent as usize],
        };
        let faces_in = (found.shells[shell].volume < 0.0) != turn;
        over[shell] = turn != (faces_in && winding < 1);
    }
    over
}

/// Turns the triangles that are told, with their attributes; a normal that then points to the other side is turned too.
fn flip(surface: &mut SurfaceData, which: &[bool]) {
    for t in (0..which.len()).filter(|&t| which[t]) {
        surface.triangles[t].swap(1, 2);
        let outside = surface.area_vector(t);
        if let Some(normals) = &mut surface.normals {
            normals[t].swap(1, 2);
            normals[t]
                .iter_mut()
                .filter(|normal| normal.dot(&outside) < 0.0)
                .for_each(|normal| *normal = -*normal);
        }
        if let Some(uvs) = &mut surface.uvs {
            uvs[t].swap(1, 2);
        }
    }
}

fn drop_vertices(surface: &mut SurfaceData, into: &[u32], dropped: &mut Vec<u32>) {
    let mut used = vec![false; surface.positions.len()];
    surface.triangles.iter().flatten().for_each(|&vertex| used[vertex as usize] = true);
    let mut number = vec![0; used.len()];
    let mut kept = Vec::with_capacity(used.len());
    for (vertex, used) in used.iter().enumerate() {
        if *used {
            number[vertex] = kept.len() as u32;
            kept.push(surface.positions[vertex]);
        } else if into[vertex] as usize == vertex {
            dropped.push(vertex as u32);
        }
    }
    surface.positions = kept;
    for vertex in surface.triangles.iter_mut().flatten() {
        *vertex = number[*vertex as usize];
    }
}
