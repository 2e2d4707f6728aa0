//! Detects cut edges by comparing consecutive topologies: a cut separates neighbouring triangles, so it leaves edges
//! with one triangle where there were two, or where there was no edge.
//!
//! Remeshing renumbers vertices, so borders are compared by their place in texture space: an edge that lies on an old
//! border (a rim that was refined, a seam of the texture) is no cut.

use nalgebra::Vector2;

/// Largest distance in texture space between two lines that count as one.
const TOLERANCE: f64 = 1e-6;
/// Cells of the search grid each way.
const GRID: usize = 64;

/// Finds the border edges that a change of topology has created.
#[derive(Clone, Debug, Default)]
pub struct CutFinder {
    /// Border edges of the last topology; `None` before the first one.
    border: Option<Vec<[Vector2<f64>; 2]>>,
    found: Vec<[Vector2<f64>; 2]>,
}

impl CutFinder {
    /// Takes the next topology and returns its border edges that were no border before, in texture space. The first
    /// topology has none: its initial rim is no cut.
    pub fn update(&mut self, triangles: &[[u32; 3]], uv: &[Vector2<f64>]) -> &[[Vector2<f64>; 2]] {
        let border = border_edges(triangles, uv);
        self.found.clear();
        if let Some(before) = &self.border {
            let grid = Grid::new(before);
            // The midpoint as well: a new edge between two points of the old border may run across the surface.
            let known = |[a, b]: &[Vector2<f64>; 2]| {
                [*a, (a + b) / 2.0, *b].iter().all(|point| grid.is_on_an_edge(before, *point))
            };
            self.found.extend(border.iter().filter(|edge| !known(edge)));
        }
        self.border = Some(border);
        &self.found
    }
}

/// Edges with exactly one triangle whose ends both have texture coordinates, ordered by vertex.
fn border_edges(triangles: &[[u32; 3]], uv: &[Vector2<f64>]) -> Vec<[Vector2<f64>; 2]> {
    let mut edges: Vec<[u32; 2]> = triangles
        .iter()
        .flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a]])
        .map(|[a, b]| if a < b { [a, b] } else { [b, a] })
        .filter(|[a, b]| a != b)
        .collect();
    edges.sort_unstable();
    let place =
        |vertex: u32| uv.get(vertex as usize).copied().filter(|at| at.x.is_finite() && at.y.is_finite());
    edges
        .chunk_by(|a, b| a == b)
        .filter(|group| group.len() == 1)
        .filter_map(|group| Some([place(group[0][0])?, place(group[0][1])?]))
        .collect()
}

/// The edges that touch each cell of the unit square; edges outside it count to the cells at its rim.
struct Grid {
    /// Start of each cell's edges in `edges`; one more entry than cells.
    starts: Vec<u32>,
    edges: Vec<u32>,
}

fn cell(x: f64) -> usize {
    ((x * GRID as f64).max(0.0) as usize).min(GRID - 1)
}

/// The cells that an edge crosses, row by row: those of its bounding box would be too many.
fn cells(&[a, b]: &[Vector2<f64>; 2]) -> impl Iterator<Item = usize> + use<> {
    let rows = cell(a.y.min(b.y) - TOLERANCE)..=cell(a.y.max(b.y) + TOLERANCE);
    rows.flat_map(move |row| {
        // The outermost rows include everything beyond them.
        let low = if row == 0 { f64::NEG_INFINITY } else { row as f64 / GRID as f64 };
        let high = if row + 1 == GRID { f64::INFINITY } else { (row + 1) as f64 / GRID as f64 };
        let (from, to) = span_between(a, b, low - TOLERANCE, high + TOLERANCE);
        (cell(from - TOLERANCE)..=cell(to + TOLERANCE)).map(move |column| row * GRID + column)
    })
}

/// The smallest and largest x of the part of a segment between two heights.
pub(super) fn span_between(a: Vector2<f64>, b: Vector2<f64>, low: f64, high: f64) -> (f64, f64) {
    let rise = b.y - a.y;
    let at = |y: f64| {
        let share = if rise == 0.0 { f64::NAN } else { (y - a.y) / rise };
        // A level segment lies between them completely or not at all.
        if share.is_nan() { None } else { Some(a.x + (b.x - a.x) * share.clamp(0.0, 1.0)) }
    };
    match (at(low), at(high)) {
        (Some(p), Some(q)) => (p.min(q), p.max(q)),
        _ => (a.x.min(b.x), a.x.max(b.x)),
    }
}

impl Grid {
    fn new(edges: &[[Vector2<f64>; 2]]) -> Self {
        let mut starts = vec![0u32; GRID * GRID + 1];
        edges.iter().flat_map(cells).for_each(|cell| starts[cell + 1] += 1);
        (0..GRID * GRID).for_each(|cell| starts[cell + 1] += starts[cell]);
        let mut sorted = vec![0u32; starts[GRID * GRID] as usize];
        let mut next = starts.clone();
        for (index, edge) in edges.iter().enumerate() {
            for cell in cells(edge) {
                sorted[next[cell] as usize] = index as u32;
                next[cell] += 1;
            }
        }
        Self { starts, edges: sorted }
    }

    fn is_on_an_edge(&self, edges: &[[Vector2<f64>; 2]], point: Vector2<f64>) -> bool {
        let cell = cell(point.y) * GRID + cell(point.x);
        self.edges[self.starts[cell] as usize..self.starts[cell + 1] as usize].iter().any(|index| {
            let [a, b] = edges[*index as usize];
            let along = b - a;
            let length = along.norm_squared();
            let share = if length > 0.0 { ((point - a).dot(&along) / length).clamp(0.0, 1.0) } else { 0.0 };
            (point - a - along * share).norm() <= TOLERANCE
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn uv(points: &[[f64; 2]]) -> Vec<Vector2<f64>> {
        points.iter().map(|p| Vector2::new(p[0], p[1])).collect()
    }

    const SQUARE: [[f64; 2]; 4] = [[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9]];

    #[test]
    fn the_first_topology_and_the_same_again_have_no_cuts() {
        let mut finder = CutFinder::default();
        assert!(finder.update(&[[0, 1, 2], [0, 2, 3]], &uv(&SQUARE)).is_empty());
        assert!(finder.update(&[[0, 1, 2], [0, 2, 3]], &uv(&SQUARE)).is_empty());
    }

    #[test]
    fn parting_two_triangles_marks_both_lips_of_the_cut() {
        let mut finder = CutFinder::default();
        finder.update(&[[0, 1, 2], [0, 2, 3]], &uv(&SQUARE));
        let mut points = SQUARE.to_vec();
        points.extend([SQUARE[0], SQUARE[2]]);
        let cut = finder.update(&[[0, 1, 2], [4, 5, 3]], &uv(&points));
        assert_eq!(cut.len(), 2);
        for [a, b] in cut {
            assert_eq!((*a, *b), (Vector2::new(0.1, 0.1), Vector2::new(0.9, 0.9)));
        }
    }

    #[test]
    fn removing_a_triangle_marks_the_edge_that_it_shared() {
        let mut finder = CutFinder::default();
        finder.update(&[[0, 1, 2], [0, 2, 3]], &uv(&SQUARE));
        assert_eq!(finder.update(&[[0, 1, 2]], &uv(&SQUARE)).len(), 1);
    }

    #[test]
    fn renumbering_or_splitting_the_rim_is_no_cut() {
        let mut finder = CutFinder::default();
        finder.update(&[[0, 1, 2], [0, 2, 3]], &uv(&SQUARE));
        let mut turned = SQUARE.to_vec();
        turned.rotate_left(1);
        assert!(finder.update(&[[3, 0, 1], [3, 1, 2]], &uv(&turned)).is_empty());
        let mut finer = SQUARE.to_vec();
        finer.push([0.5, 0.1]);
        assert!(finder.update(&[[0, 4, 2], [4, 1, 2], [0, 2, 3]], &uv(&finer)).is_empty());
    }

    #[test]
    fn the_part_of_a_segment_between_two_heights() {
        let (a, b) = (Vector2::new(0.0, 0.0), Vector2::new(1.0, 2.0));
        assert_eq!(span_between(a, b, 0.5, 1.0), (0.25, 0.5));
        assert_eq!(span_between(b, a, 0.5, 9.0), (0.25, 1.0));
        assert_eq!(span_between(a, Vector2::new(-3.0, 0.0), -1.0, 1.0), (-3.0, 0.0));
        assert_eq!(span_between(a, b, f64::NEG_INFINITY, f64::INFINITY), (0.0, 1.0));
    }

    #[test]
    fn every_point_of_a_border_is_found_again() {
        let mut random = trocar_scene::random::SplitMix64::new(6);
        for _ in 0..200 {
            let mut point = || {
                Vector2::new(
                    f64::from(random.unit_f32()) * 1.4 - 0.2,
                    f64::from(random.unit_f32()) * 1.4 - 0.2,
                )
            };
            let edges: Vec<[Vector2<f64>; 2]> = (0..5).map(|_| [point(), point()]).collect();
            let grid = Grid::new(&edges);
            for [a, b] in &edges {
                for k in 0..=100 {
                    assert!(grid.is_on_an_edge(&edges, a + (b - a) * (f64::from(k) / 100.0)));
                }
            }
            assert!(!grid.is_on_an_edge(&edges, Vector2::new(5.0, 0.5)));
        }
    }

    #[test]
    fn bad_indices_and_coordinates_do_no_harm() {
        let mut finder = CutFinder::default();
        finder.update(&[[0, 1, 2]], &uv(&SQUARE));
        let bad = uv(&[[f64::NAN, 0.0], [1e300, 0.1], [-5.0, 7.0]]);
        assert_eq!(finder.update(&[[0, 1, 2], [0, 2, 77], [2, 2, 2]], &bad).len(), 1);
        assert_eq!(finder.update(&[[0, 1, 2]], &uv(&SQUARE)).len(), 3);
    }
}
