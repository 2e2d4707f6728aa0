//! Intersection of a blade's swept area between two frames with a surface, joined to paths in the rest shape.

use nalgebra::{Point3, Vector3};
use trocar_collision::primitive::{Triangle, common_segment, triangles_overlap};
use trocar_dynamics::tet_mesh::Sweep;

use super::Sheet;

/// A segment within one triangle, in the rest shape.
#[derive(Clone, Copy, Debug)]
struct PathSegment {
    triangle: u32,
    ends: [Point3<f64>; 2],
}

/// A polyline across the surface in the rest shape.
#[derive(Clone, Debug, Default)]
pub(super) struct SurfacePath {
    pub points: Vec<Point3<f64>>,
    /// Triangle of the first and of the last point, before any cut.
    pub triangles: [u32; 2],
}

impl SurfacePath {
    pub fn reverse(&mut self) {
        self.points.reverse();
        self.triangles.reverse();
    }
}

fn bounds(points: &[Point3<f64>]) -> [Point3<f64>; 2] {
    points.iter().fold([points[0]; 2], |[low, high], point| [low.inf(point), high.sup(point)])
}

/// Barycentric weights of a point, by areas.
fn weights(point: &Point3<f64>, [a, b, c]: &Triangle) -> [f64; 3] {
    let normal = (b - a).cross(&(c - a));
    let squared = normal.norm_squared();
    let of = |from: &Point3<f64>, to: &Point3<f64>| {
        let area: f64 = (to - from).cross(&(point - from)).dot(&normal);
        (area / squared).clamp(0.0, 1.0)
    };
    let (u, v, w) = (of(b, c), of(c, a), of(a, b));
    let sum = u + v + w;
    if sum > 0.0 { [u / sum, v / sum, w / sum] } else { [1.0, 0.0, 0.0] }
}

/// All paths of a sweep, in the order of the triangles that they begin with.
pub(super) fn paths(sheet: &Sheet, positions: &[Point3<f64>], sweep: &Sweep) -> Vec<SurfacePath> {
    let mut pieces: Vec<PathSegment> = Vec::new();
    let [low, high] = bounds(&[sweep.before[0], sweep.before[1], sweep.after[0], sweep.after[1]]);
    for (index, corners) in sheet.triangles().iter().enumerate() {
        let placed = corners.map(|vertex| positions[vertex as usize]);
        let [least, most] = bounds(&placed);
        if (0..3).any(|axis| least[axis] > high[axis] || most[axis] < low[axis]) {
            continue;
        }
        let rest = corners.map(|vertex| sheet.rest()[vertex as usize].coords);
        let to_rest = |point: &Point3<f64>| {
            let [u, v, w] = weights(point, &placed);
            Point3::from(rest[0] * u + rest[1] * v + rest[2] * w)
        };
        for swept in sweep.triangles() {
            if triangles_overlap(&swept, &placed) {
                let ends = common_segment(&swept, &placed).map(|end| to_rest(&end));
                pieces.push(PathSegment { triangle: index as u32, ends });
            }
        }
    }
    join(sheet, pieces)
}

/// Distance below which two ends coincide, relative to the largest edge nearby.
const SAME: f64 = 1e-6;

fn join(sheet: &Sheet, mut pieces: Vec<PathSegment>) -> Vec<SurfacePath> {
    let size = |triangle: u32| {
        let [a, b, c] = sheet.triangles()[triangle as usize].map(|vertex| sheet.rest()[vertex as usize]);
        (b - a).norm().max((c - b).norm()).max((a - c).norm())
    };
    let neighbours = |first: u32, second: u32| {
        let corners = sheet.triangles()[first as usize];
        let shared = sheet.triangles()[second as usize].iter().filter(|vertex| corners.contains(vertex));
        shared.count() > 0
    };
    pieces.retain(|piece| (piece.ends[1] - piece.ends[0]).norm() > SAME * size(piece.triangle));
    let mut paths = Vec::new();
    while !pieces.is_empty() {
        let seed = pieces.remove(0);
        let mut path = SurfacePath { points: seed.ends.to_vec(), triangles: [seed.triangle; 2] };
        for side in [1, 0] {
            loop {
                let triangle = path.triangles[side];
                let end = if side == 1 { path.points[path.points.len() - 1] } else { path.points[0] };
                let near = SAME * size(triangle);
                let next = pieces.iter().enumerate().find_map(|(index, piece)| {
                    let at = piece.ends.iter().position(|other| (other - end).norm() <= near)?;
                    neighbours(triangle, piece.triangle).then_some((index, at))
                });
                let Some((index, at)) = next else { break };
                let piece = pieces.remove(index);
                path.triangles[side] = piece.triangle;
                if side == 1 {
                    path.points.push(piece.ends[1 - at]);
                } else {
                    path.points.insert(0, piece.ends[1 - at]);
                }
            }
        }
        paths.push(path);
    }
    paths
}

/// A direction in a triangle's plane as a combination of two of its edges.
pub(super) fn in_edges(direction: &Vector3<f64>, first: &Vector3<f64>, second: &Vector3<f64>) -> [f64; 2] {
    let (aa, ab, bb) = (first.norm_squared(), first.dot(second), second.norm_squared());
    let (da, db) = (direction.dot(first), direction.dot(second));
    let determinant = aa * bb - ab * ab;
    [(bb * da - ab * db) / determinant, (aa * db - ab * da) / determinant]
}
