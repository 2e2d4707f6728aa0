//! Normals of a surface that deforms: the mean of the triangles around a vertex, each weighted by its angle there
//! (Thürmer, Wüthrich, "Computing vertex normals from polygonal facets", 1998). Angles rather than areas, because
//! they do not depend on how the surface is divided: a cut that splits triangles does not change the shading
//! beside it.

use nalgebra::{Point3, Vector3};
use thiserror::Error;
use trocar_scene::mesh::SplitSurface;

/// Vertices at one place whose normals at rest differ by less than this share a normal: they were split for their
/// texture coordinates, or by a file's rounding. cos 2°.
const SAME_NORMAL: f64 = 0.999_39;

/// Too few positions for the surface.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("a surface over {needed} vertices cannot follow {given} positions")]
pub struct TooFewPositions {
    /// Positions that the surface refers to.
    pub needed: usize,
    /// Positions that were given.
    pub given: usize,
}

/// Follows the positions of a deforming surface: the split vertices that are drawn, with smooth normals. Creases and
/// smooth texture seams stay as they were at rest.
#[derive(Clone, Debug)]
pub struct DeformingSurface {
    triangles: Vec<[u32; 3]>,
    /// The vertex of the Model that each drawn one follows.
    sources: Vec<u32>,
    /// Vertices of one group share their normal.
    groups: Vec<u32>,
    /// Last valid normal of each group.
    group_normals: Vec<[f32; 3]>,
    sums: Vec<[f32; 3]>,
    needed: usize,
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
}

impl DeformingSurface {
    /// Takes a surface at rest. Triangles with invalid vertices are left out of the normals.
    pub fn new(rest: &SplitSurface) -> Self {
        let count = rest.positions.len().min(rest.sources.len()).min(rest.normals.len());
        let sources = rest.sources[..count].to_vec();
        let (groups, group_normals) = smooth_groups(&sources, &rest.normals[..count]);
        let valid = |triangle: &&[u32; 3]| triangle.iter().all(|vertex| (*vertex as usize) < count);
        let normals = groups.iter().map(|group| group_normals[*group as usize]).collect();
        Self {
            triangles: rest.triangles.iter().filter(valid).copied().collect(),
            needed: sources.iter().map(|source| *source as usize + 1).max().unwrap_or(0),
            sums: vec![[0.0; 3]; group_normals.len()],
            positions: rest.positions[..count].iter().map(|p| [p.x as f32, p.y as f32, p.z as f32]).collect(),
            sources,
            groups,
            group_normals,
            normals,
        }
    }

    /// Takes new positions of the Model's vertices. Allocates nothing. Where all triangles around a vertex have zero
    /// area, it keeps its last normal.
    ///
    /// # Errors
    /// When there are fewer positions than the surface needs; it stays unchanged.
    pub fn update(&mut self, positions: &[Point3<f64>]) -> Result<(), TooFewPositions> {
        if positions.len() < self.needed {
            return Err(TooFewPositions { needed: self.needed, given: positions.len() });
        }
        for (drawn, source) in self.positions.iter_mut().zip(&self.sources) {
            let p = &positions[*source as usize];
            *drawn = [p.x as f32, p.y as f32, p.z as f32];
        }
        self.sums.fill([0.0; 3]);
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|vertex| self.positions[vertex as usize]);
            let (ab, bc, ca) = (minus(b, a), minus(c, b), minus(a, c));
            let area = cross(ab, minus(c, a));
            let (area_length, lengths) = (dot(area, area).sqrt(), [ab, bc, ca].map(|e| dot(e, e).sqrt()));
            // Also false for lengths that are not finite.
            if !(area_length > 0.0 && area_length < f32::INFINITY) {
                continue;
            }
            let normal = area.map(|x| x / area_length);
            let cosines = [
                -dot(ab, ca) / (lengths[0] * lengths[2]),
                -dot(bc, ab) / (lengths[1] * lengths[0]),
                -dot(ca, bc) / (lengths[2] * lengths[1]),
            ];
            for (vertex, cosine) in triangle.iter().zip(cosines) {
                let angle = arc_cosine(cosine);
                let sum = &mut self.sums[self.groups[*vertex as usize] as usize];
                *sum = [sum[0] + normal[0] * angle, sum[1] + normal[1] * angle, sum[2] + normal[2] * angle];
            }
        }
        for (normal, sum) in self.group_normals.iter_mut().zip(&self.sums) {
            let length = dot(*sum, *sum).sqrt();
            if length > 1e-6 {
                *normal = sum.map(|x| x / length);
            }
        }
        for (normal, group) in self.normals.iter_mut().zip(&self.groups) {
            *normal = self.group_normals[*group as usize];
        }
        Ok(())
    }

    /// Positions of the drawn vertices \[m\].
    pub fn positions(&self) -> &[[f32; 3]] {
        &self.positions
    }

    /// Unit normals of the drawn vertices.
    pub fn normals(&self) -> &[[f32; 3]] {
        &self.normals
    }

    /// Triangles of drawn vertices, without invalid ones.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }
}

/// Numbers the sets of vertices with the same place and, nearly, the same normal; returns each vertex's set, and each
/// set's normal.
fn smooth_groups(sources: &[u32], normals: &[Vector3<f64>]) -> (Vec<u32>, Vec<[f32; 3]>) {
    let mut order: Vec<u32> = (0..sources.len() as u32).collect();
    order.sort_by_key(|vertex| (sources[*vertex as usize], *vertex));
    let mut groups = vec![0u32; sources.len()];
    let mut found: Vec<Vector3<f64>> = Vec::new();
    for place in order.chunk_by(|a, b| sources[*a as usize] == sources[*b as usize]) {
        let first = found.len();
        for vertex in place {
            let normal = normals[*vertex as usize];
            let known = found[first..].iter().position(|other| other.dot(&normal) >= SAME_NORMAL);
            groups[*vertex as usize] = known.map_or(found.len(), |index| first + index) as u32;
            if known.is_none() {
                found.push(normal);
            }
        }
    }
    (groups, found.iter().map(|n| [n.x as f32, n.y as f32, n.z as f32]).collect())
}

fn minus(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The angle of a cosine, within 7·10⁻⁵ rad (Abramowitz, Stegun, "Handbook of mathematical functions", 4.4.45). That is
/// accurate enough for a weight, and a call into the C library costs several times as much.
fn arc_cosine(cosine: f32) -> f32 {
    let x = cosine.abs().min(1.0);
    let angle = (1.0 - x).sqrt() * (1.570_728_8 + x * (-0.212_114_4 + x * (0.074_261 - 0.018_729_3 * x)));
    if cosine < 0.0 { std::f32::consts::PI - angle } else { angle }
}

#[cfg(test)]
mod tests {
    use trocar_scene::mesh::SurfaceData;

    use super::*;

    /// A ball of `rings × 2·rings` quads as an unsplit surface, with or without texture coordinates.
    fn ball(rings: u32, with_uv: bool) -> SurfaceData {
        let around = 2 * rings;
        let mut positions = vec![Point3::new(0.0, 0.0, 1.0)];
        for ring in 1..rings {
            let polar = std::f64::consts::PI * f64::from(ring) / f64::from(rings);
            for step in 0..around {
                let angle = std::f64::consts::TAU * f64::from(step) / f64::from(around);
                positions.push(Point3::new(
                    polar.sin() * angle.cos(),
                    polar.sin() * angle.sin(),
                    polar.cos(),
                ));
            }
        }
        positions.push(Point3::new(0.0, 0.0, -1.0));
        let last = positions.len() as u32 - 1;
        let at = |ring: u32, step: u32| match ring {
            0 => 0,
            ring if ring == rings => last,
            ring => 1 + (ring - 1) * around + step % around,
        };
        let (mut triangles, mut uvs) = (Vec::new(), Vec::new());
        for (ring, step) in (0..rings).flat_map(|ring| (0..around).map(move |step| (ring, step))) {
            let corner = |r: u32, s: u32| [f64::from(s) / f64::from(around), f64::from(r) / f64::from(rings)];
            let quad = [(ring, step), (ring + 1, step), (ring + 1, step + 1), (ring, step + 1)];
            for triangle in [[0, 1, 2], [0, 2, 3]] {
                let corners = triangle.map(|k: usize| at(quad[k].0, quad[k].1));
                if corners[0] != corners[1] && corners[1] != corners[2] && corners[2] != corners[0] {
                    triangles.push(corners);
                    uvs.push(triangle.map(|k| corner(quad[k].0, quad[k].1)));
                }
            }
        }
        SurfaceData { positions, triangles, normals: None, uvs: with_uv.then_some(uvs) }
    }

    #[test]
    fn a_stretched_ball_has_the_normals_of_an_ellipsoid() {
        let ball = ball(40, true);
        let split = ball.split();
        assert!(split.positions.len() > ball.positions.len(), "the texture has a seam");
        let mut surface = DeformingSurface::new(&split);
        let scale = Vector3::new(1.0, 0.6, 1.4);
        let moved: Vec<Point3<f64>> =
            ball.positions.iter().map(|p| Point3::from(p.coords.component_mul(&scale))).collect();
        surface.update(&moved).expect("as many positions as before");
        for (index, source) in split.sources.iter().enumerate() {
            let expected = ball.positions[*source as usize].coords.component_div(&scale).normalize();
            let n = surface.normals()[index].map(f64::from);
            assert!(expected.dot(&Vector3::from(n)) > 0.999, "{index}: {n:?}, not {expected}");
            let p = surface.positions()[index].map(f64::from);
            assert!((Point3::from(p) - moved[*source as usize]).norm() < 1e-6);
        }
    }

    #[test]
    fn the_seam_of_a_texture_is_smooth_and_an_edge_stays_sharp() {
        let split = ball(12, true).split();
        let surface = DeformingSurface::new(&split);
        let mut seams = 0;
        for (a, b) in (0..split.sources.len()).flat_map(|a| (0..a).map(move |b| (a, b))) {
            if split.sources[a] == split.sources[b] {
                seams += 1;
                assert_eq!(surface.normals()[a], surface.normals()[b]);
            }
        }
        assert!(seams > 10);

        let cube = trocar_scene::shapes::cuboid([0.5; 3]).expect("valid sizes");
        let mut box_surface = DeformingSurface::new(&cube.split());
        let sheared: Vec<Point3<f64>> =
            cube.positions.iter().map(|p| Point3::new(p.x + 0.5 * p.z, p.y, p.z)).collect();
        box_surface.update(&sheared).expect("as many positions as before");
        for triangle in box_surface.triangles() {
            let [a, b, c] = triangle.map(|v| Vector3::from(box_surface.positions()[v as usize]));
            let face = (b - a).cross(&(c - a)).normalize();
            for vertex in triangle {
                assert!(face.dot(&Vector3::from(box_surface.normals()[*vertex as usize])) > 0.9999);
            }
        }
    }

    #[test]
    fn normals_do_not_depend_on_how_the_surface_is_divided() {
        // The corner of a box: three right angles. One face split into two or into ten triangles, the normal is the same.
        for pieces in [1usize, 2, 9] {
            let mut positions =
                vec![Point3::origin(), Point3::new(0.0, 1.0, 0.0), Point3::new(0.0, 0.0, 1.0)];
            let mut triangles = vec![[0u32, 1, 2]];
            let start = positions.len() as u32;
            for k in 0..=pieces {
                let angle = std::f64::consts::FRAC_PI_2 * k as f64 / pieces as f64;
                positions.push(Point3::new(angle.cos(), angle.sin(), 0.0));
            }
            triangles.extend((0..pieces as u32).map(|k| [0, start + k, start + k + 1]));
            triangles.push([0, 2, start]);
            let split = SplitSurface {
                normals: vec![Vector3::z(); positions.len()],
                uvs: vec![[0.0; 2]; positions.len()],
                sources: (0..positions.len() as u32).collect(),
                positions: positions.clone(),
                triangles,
            };
            let mut surface = DeformingSurface::new(&split);
            surface.update(&positions).expect("as many positions as before");
            let n = surface.normals()[0];
            assert!(n.iter().all(|x| (x - 0.577_35).abs() < 2e-3), "{pieces}: {n:?}");
        }
    }

    #[test]
    fn bad_input_is_refused_or_ignored() {
        let mut split = ball(6, false).split();
        split.triangles.push([0, 1, 999_999]);
        let mut surface = DeformingSurface::new(&split);
        let before = surface.normals().to_vec();
        let error = surface.update(&[Point3::origin()]).expect_err("it is refused");
        assert!(error.given == 1 && error.to_string().contains("1 positions"), "{error}");
        // All in one point, or at the range of floats: the last normals stay.
        for x in [0.0, 1e300] {
            surface
                .update(&vec![Point3::new(x, 0.0, 0.0); error.needed])
                .expect("as many positions as before");
            assert_eq!(surface.normals(), before);
        }
        DeformingSurface::new(&SplitSurface::default()).update(&[]).expect("nothing is needed");
    }

    #[test]
    fn arc_cosines_are_close() {
        for i in -1000..=1000 {
            let x = i as f32 / 1000.0;
            assert!((arc_cosine(x) - x.acos()).abs() < 1e-4, "{x}");
        }
        assert!(
            arc_cosine(1.000_001).abs() < 1e-3
                && (arc_cosine(-1.000_001) - std::f32::consts::PI).abs() < 1e-3
        );
    }
}
