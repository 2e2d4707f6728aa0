//! Cutting of lines: where a blade's edge sweeps through a segment between two frames, the line separates at the nearer
//! end of that segment. So no piece is shorter than a segment, and no shorter step is needed; the position is accurate
//! to half a segment.

use nalgebra::Point3;
use trocar_collision::primitive::Triangle;
use trocar_dynamics::tet_mesh::Sweep;
use trocar_scene::disjoint_sets::DisjointSets;

/// A line after a cut.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CutLine {
    /// Nodes of each segment; their number is unchanged.
    pub segments: Vec<[u32; 2]>,
    /// Original of each new node; new nodes come after all others.
    pub copies: Vec<u32>,
}

/// Fraction from `a` to `b` at which it intersects a triangle.
fn crossing(a: &Point3<f64>, b: &Point3<f64>, triangle: &Triangle) -> Option<f64> {
    let normal = (triangle[1] - triangle[0]).cross(&(triangle[2] - triangle[0]));
    let [above, below] = [a, b].map(|point| normal.dot(&(point - triangle[0])));
    // A segment that only touches with one end is counted once.
    if (above >= 0.0) == (below >= 0.0) {
        return None;
    }
    let share = above / (above - below);
    let point = a + (b - a) * share;
    let is_inside = |side: usize| {
        let (from, to) = (triangle[side], triangle[(side + 1) % 3]);
        normal.dot(&(to - from).cross(&(point - from))) >= 0.0
    };
    (0..3).all(is_inside).then_some(share)
}

/// Edges of a chain of nodes at `positions` \[m\] that `sweeps` intersect, with the fraction along the edge; each edge
/// once, ascending.
#[must_use]
pub fn crossed(positions: &[Point3<f64>], sweeps: &[Sweep]) -> Vec<(usize, f64)> {
    let shares = positions.windows(2).enumerate().map(|(edge, ends)| {
        let triangles = sweeps.iter().flat_map(Sweep::triangles);
        (edge, triangles.into_iter().find_map(|triangle| crossing(&ends[0], &ends[1], &triangle)))
    });
    shares.filter_map(|(edge, share)| Some((edge, share?))).collect()
}

/// Cuts a line where `sweeps` intersect its segments at `positions` \[m\]; `None` without intersections, or only at
/// ends without another segment.
///
/// # Panics
/// A segment with a missing node.
#[must_use]
pub fn part_line(positions: &[Point3<f64>], segments: &[[u32; 2]], sweeps: &[Sweep]) -> Option<CutLine> {
    let mut about = vec![0_u32; positions.len()];
    segments.iter().flatten().for_each(|&node| about[node as usize] += 1);
    let whole = about.clone();
    let mut parted = CutLine { segments: segments.to_vec(), copies: Vec::new() };
    for sweep in sweeps {
        for (index, &ends) in segments.iter().enumerate() {
            let [a, b] = ends.map(|node| &positions[node as usize]);
            let Some(share) = sweep.triangles().find_map(|triangle| crossing(a, b, &triangle)) else {
                continue;
            };
            let nearer = usize::from(share >= 0.5);
            let Some(end) = [nearer, 1 - nearer].into_iter().find(|&end| whole[ends[end] as usize] > 1)
            else {
                continue;
            };
            // Both edges may have cut there, or one through both segments.
            let node = parted.segments[index][end];
            if about[node as usize] < 2 {
                continue;
            }
            about[node as usize] -= 1;
            about.push(1);
            parted.segments[index][end] = (positions.len() + parted.copies.len()) as u32;
            parted.copies.push(node);
        }
    }
    (!parted.copies.is_empty()).then_some(parted)
}

/// Tears a line: the most stretched segment of those longer than `tears_at` times the rest length is detached at an end
/// shared with another segment; `None` where there is none. One at a time, since all others relax then.
///
/// # Panics
/// A segment with a missing node.
#[must_use]
pub fn tear_line([rest, now]: [&[Point3<f64>]; 2], segments: &[[u32; 2]], tears_at: f64) -> Option<CutLine> {
    let length = |of: &[Point3<f64>], [a, b]: [u32; 2]| (of[b as usize] - of[a as usize]).norm();
    let mut about = vec![0_u32; now.len()];
    segments.iter().flatten().for_each(|&node| about[node as usize] += 1);
    let drawn = segments.iter().enumerate().filter_map(|(index, ends)| {
        let stretch = length(now, *ends) / length(rest, *ends);
        let end = (0..2).find(|end| about[ends[*end] as usize] > 1)?;
        (stretch > tears_at).then_some((index, end, stretch))
    });
    let (index, end, _) = drawn.max_by(|a, b| a.2.total_cmp(&b.2).then(b.0.cmp(&a.0)))?;
    let mut parted = CutLine { segments: segments.to_vec(), copies: vec![segments[index][end]] };
    parted.segments[index][end] = now.len() as u32;
    Some(parted)
}

/// Number of connected pieces.
#[must_use]
pub fn pieces(nodes: usize, segments: &[[u32; 2]]) -> usize {
    let mut parts = DisjointSets::new(nodes);
    let mut used = vec![false; nodes];
    let mut count = 0;
    for ends in segments {
        let ends = ends.map(|node| node as usize);
        for node in ends {
            count += usize::from(!std::mem::replace(&mut used[node], true));
        }
        count -= usize::from(parts.join(ends[0], ends[1]));
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(n: u32) -> (Vec<Point3<f64>>, Vec<[u32; 2]>) {
        let points = (0..=n).map(|k| Point3::new(f64::from(k), 0.0, 0.0)).collect();
        (points, (0..n).map(|k| [k, k + 1]).collect())
    }

    /// A blade along y that moves down at `x`.
    fn down(x: f64) -> Sweep {
        let edge = |z: f64| [Point3::new(x, -1.0, z), Point3::new(x, 1.0, z)];
        Sweep { before: edge(1.0), after: edge(-1.0) }
    }

    #[test]
    fn a_line_comes_apart_at_the_nearer_node_and_once_only() {
        let (points, segments) = line(5);
        for (x, node, moved) in [(2.2, 2, [2, 0]), (1.9, 2, [1, 1]), (0.3, 1, [0, 1]), (4.9, 4, [4, 0])] {
            let parted = part_line(&points, &segments, &[down(x), down(x)]).expect("a cut");
            assert_eq!(parted.copies, [node], "{x}");
            assert_eq!(parted.segments[moved[0]][moved[1]], 6, "{x}");
            assert_eq!(pieces(7, &parted.segments), 2, "{x}");
        }
        assert_eq!(pieces(6, &segments), 1);
    }

    #[test]
    fn a_line_tears_where_it_is_drawn_farthest_and_nowhere_else() {
        let (rest, segments) = line(5);
        let mut now = rest.clone();
        now[3].x += 0.3;
        now[4].x += 0.35;
        now[5].x += 0.35;
        assert_eq!(tear_line([&rest, &now], &segments, 1.31), None);
        let torn = tear_line([&rest, &now], &segments, 1.04).expect("torn");
        assert_eq!((torn.copies.as_slice(), torn.segments[2]), ([2].as_slice(), [6, 3]));
        assert_eq!(pieces(7, &torn.segments), 2);
        // An end without another segment is no place to tear.
        assert_eq!(tear_line([&rest[..2], &now[2..4]], &segments[..1], 1.1), None);
    }

    #[test]
    fn several_cuts_make_several_pieces_and_a_blade_beside_it_none() {
        let (points, segments) = line(5);
        let parted = part_line(&points, &segments, &[down(1.1), down(3.4)]).expect("cuts");
        assert_eq!((parted.copies.len(), pieces(8, &parted.segments)), (2, 3));
        assert_eq!(part_line(&points, &segments, &[down(7.0)]), None);
        let beside =
            Sweep { before: [Point3::new(2.5, 1.0, 1.0); 2], after: [Point3::new(2.5, 2.0, -1.0); 2] };
        assert_eq!(part_line(&points, &segments, &[beside]), None);
        // A line of one segment has no joint to separate.
        assert_eq!(part_line(&points[..2], &segments[..1], &[down(0.5)]), None);
        // A closed one needs two cuts.
        let ring: Vec<[u32; 2]> = (0..6).map(|k| [k, (k + 1) % 6]).collect();
        let square: Vec<Point3<f64>> = (0..6)
            .map(|k| {
                let (sin, cos) = (f64::from(k) * std::f64::consts::FRAC_PI_3).sin_cos();
                Point3::new(cos, 0.5 * sin, 0.0)
            })
            .collect();
        let parted = part_line(&square, &ring, &[down(0.1)]).expect("a cut");
        assert_eq!((parted.copies.len(), pieces(8, &parted.segments)), (2, 2));
    }
}
