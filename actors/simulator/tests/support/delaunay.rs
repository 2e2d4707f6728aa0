//! Delaunay tetrahedra of random points (Bowyer 1981, Watson 1981): each point opens the tetrahedra whose circumspheres
//! contain it. In f64, for points in general position.

use nalgebra::{Matrix3, Point3, Vector3};

/// The circumsphere of a tetrahedron: its centre, and its squared radius.
fn circumsphere(points: &[Point3<f64>], tet: [u32; 4]) -> Option<(Point3<f64>, f64)> {
    let [a, b, c, d] = tet.map(|node| points[node as usize]);
    let edges = [b - a, c - a, d - a];
    let rows = Matrix3::from_rows(&edges.map(|edge| edge.transpose()));
    let halves = Vector3::from(edges.map(|edge| edge.norm_squared() / 2.0));
    let middle = rows.try_inverse()? * halves;
    Some((a + middle, middle.norm_squared()))
}

fn volume(points: &[Point3<f64>], tet: [u32; 4]) -> f64 {
    let [a, b, c, d] = tet.map(|node| points[node as usize]);
    (b - a).cross(&(c - a)).dot(&(d - a)) / 6.0
}

/// Positively oriented tetrahedra that fill the convex hull of the points, except for thin gaps at its border.
///
/// # Panics
/// When points are not in general position.
pub fn tetrahedra(points: &[Point3<f64>]) -> Vec<[u32; 4]> {
    let count = points.len() as u32;
    let mut all = points.to_vec();
    let reach = points.iter().map(|point| point.coords.amax()).fold(0.0, f64::max) * 100.0;
    all.extend(
        [[-1.0, -1.0, -1.0], [3.0, -1.0, -1.0], [-1.0, 3.0, -1.0], [-1.0, -1.0, 3.0]]
            .map(|at| Point3::from(at.map(|x: f64| x * reach))),
    );
    let of = |tet: [u32; 4]| (tet, circumsphere(&all, tet).expect("general position"));
    let mut tets = vec![of([count, count + 1, count + 2, count + 3])];
    for point in 0..count {
        let at = all[point as usize];
        let (open, kept): (Vec<_>, Vec<_>) =
            tets.into_iter().partition(|(_, (middle, square))| (at - middle).norm_squared() < *square);
        tets = kept;
        let faces: Vec<[u32; 3]> = open
            .iter()
            .flat_map(|([a, b, c, d], _)| [[*a, *b, *c], [*a, *b, *d], [*a, *c, *d], [*b, *c, *d]])
            .map(|mut face| {
                face.sort_unstable();
                face
            })
            .collect();
        for face in &faces {
            if faces.iter().filter(|other| *other == face).count() == 1 {
                tets.push(of([face[0], face[1], face[2], point]));
            }
        }
    }
    let inner = tets.into_iter().map(|(tet, _)| tet).filter(|tet| tet.iter().all(|node| *node < count));
    inner
        .map(|[a, b, c, d]| if volume(points, [a, b, c, d]) > 0.0 { [a, b, c, d] } else { [a, c, b, d] })
        .collect()
}
