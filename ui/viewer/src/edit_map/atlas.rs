//! The texture atlas: the triangle that owns each texel of a surface's texture.
//!
//! A texel belongs to the triangle whose image in texture space is nearest to the texel's centre (distance 0 inside);
//! of equally near ones to the first. Texels farther than √2 from all triangles have no owner. So every texel that
//! bilinear sampling inside a triangle reads has an owner, also beyond the edge of a chart, and the result does not
//! depend on the order of painting.

use nalgebra::Vector2;

use super::DirtyRect;

/// Owner of texels without a triangle nearby.
const NOBODY: u32 = u32::MAX;
/// Bilinear sampling reads texels less than one away in each direction, so at most √2; squared.
const REACH: f32 = 2.0;
/// Larger texture coordinates are invalid.
const UV_MAX: f64 = 1e6;

/// The texels of a surface's triangles.
#[derive(Clone, Debug)]
pub struct Atlas {
    width: u32,
    height: u32,
    owners: Vec<u32>,
    /// Corners in texels, per triangle; `None` for an invalid triangle.
    corners: Vec<Option<[[f32; 2]; 3]>>,
    shared: usize,
    left_out: usize,
    /// Kept between builds, to reuse the memory.
    distances: Vec<f32>,
}

impl Atlas {
    /// An atlas without triangles.
    pub fn new(width: u32, height: u32) -> Self {
        let texels = width as usize * height as usize;
        Self {
            width,
            height,
            owners: vec![NOBODY; texels],
            corners: Vec::new(),
            shared: 0,
            left_out: 0,
            distances: vec![f32::MAX; texels],
        }
    }

    /// Assigns the texels to the triangles of a new topology. A triangle with a missing or non-finite texture
    /// coordinate gets no texels; parts outside the unit square are clipped. Where dozens of triangles overlap, the
    /// last ones get none: the time is bounded.
    pub fn assign(&mut self, triangles: &[[u32; 3]], uv: &[Vector2<f64>]) {
        self.owners.fill(NOBODY);
        self.distances.fill(f32::MAX);
        self.shared = 0;
        self.corners.clear();
        self.corners.extend(triangles.iter().map(|triangle| {
            let mut corners = [[0.0f32; 2]; 3];
            for (corner, vertex) in corners.iter_mut().zip(triangle) {
                let at = uv.get(*vertex as usize)?;
                if !(at.x.abs() <= UV_MAX && at.y.abs() <= UV_MAX) {
                    return None;
                }
                *corner = [(at.x * f64::from(self.width)) as f32, (at.y * f64::from(self.height)) as f32];
            }
            Some(corners)
        }));
        // Charts without overlap need about two visits per texel, and small triangles some extra.
        let mut budget = 64 * (self.owners.len() as u64 + triangles.len() as u64);
        for index in 0..self.corners.len() {
            let cost = self.bounds(index).map_or(0, |rect| u64::from(rect.width) * u64::from(rect.height));
            match budget.checked_sub(cost) {
                Some(left) => {
                    budget = left;
                    self.claim(index);
                }
                None => self.corners[index] = None,
            }
        }
        self.left_out = self.corners.iter().filter(|corners| corners.is_none()).count();
    }

    fn claim(&mut self, index: usize) {
        let Some((corners, rect)) = self.corners[index].zip(self.bounds(index)) else { return };
        let sides = Sides::of(&corners);
        for y in rect.y..rect.y + rect.height {
            for x in rect.x..rect.x + rect.width {
                let center = [x as f32 + 0.5, y as f32 + 0.5];
                let depth = sides.depth(center);
                let distance = if depth >= 0.0 {
                    0.0
                } else if depth * depth > REACH {
                    continue;
                } else {
                    let nearest = closest(center, &corners).1;
                    (nearest[0] - center[0]).powi(2) + (nearest[1] - center[1]).powi(2)
                };
                if distance > REACH {
                    continue;
                }
                let texel = y as usize * self.width as usize + x as usize;
                // Texels on a shared side do not count.
                if depth > 1e-2 && self.distances[texel] == 0.0 {
                    self.shared += 1;
                }
                if distance < self.distances[texel] {
                    self.distances[texel] = distance;
                    self.owners[texel] = index as u32;
                }
            }
        }
    }

    /// The texels that a triangle may own.
    fn bounds(&self, index: usize) -> Option<DirtyRect> {
        let corners = self.corners.get(index)?.as_ref()?;
        let range = |k: usize, count: u32| {
            let low = corners.iter().map(|c| c[k]).fold(f32::MAX, f32::min) - 1.5;
            let high = corners.iter().map(|c| c[k]).fold(f32::MIN, f32::max) + 1.5;
            let first = low.max(0.0) as u32;
            (first, (high.max(0.0).ceil() as u32).min(count).saturating_sub(first))
        };
        let ((x, width), (y, height)) = (range(0, self.width), range(1, self.height));
        (width > 0 && height > 0).then_some(DirtyRect { x, y, width, height })
    }

    /// Calls `paint` with each texel that a triangle owns and its barycentric weights; returns a rectangle around the
    /// texels.
    pub fn visit(&self, index: usize, mut paint: impl FnMut(usize, [f32; 3])) -> Option<DirtyRect> {
        let (corners, rect) = self.corners.get(index).copied().flatten().zip(self.bounds(index))?;
        let mut painted: Option<DirtyRect> = None;
        for y in rect.y..rect.y + rect.height {
            for x in rect.x..rect.x + rect.width {
                let texel = y as usize * self.width as usize + x as usize;
                if self.owners[texel] == index as u32 {
                    paint(texel, closest([x as f32 + 0.5, y as f32 + 0.5], &corners).0);
                    painted = DirtyRect::union(painted, Some(DirtyRect { x, y, width: 1, height: 1 }));
                }
            }
        }
        painted
    }

    /// The triangle that a texel belongs to.
    pub fn owner(&self, texel: usize) -> Option<usize> {
        self.owners.get(texel).copied().filter(|owner| *owner != NOBODY).map(|owner| owner as usize)
    }

    /// Number of triangles without texels.
    pub fn left_out(&self) -> usize {
        self.left_out
    }

    /// Texels inside more than one triangle: overlapping texture coordinates are ambiguous, and all of the triangles
    /// show the state of the first.
    pub fn shared(&self) -> usize {
        self.shared
    }
}

/// The lines through a triangle's sides: `normal · p + offset` is the signed distance, positive inside.
struct Sides([[f32; 3]; 3]);

impl Sides {
    fn of([a, b, c]: &[[f32; 2]; 3]) -> Self {
        let double_area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        let side = |s: &[f32; 2], t: &[f32; 2]| {
            let length = ((t[0] - s[0]).powi(2) + (t[1] - s[1]).powi(2)).sqrt();
            let scale = double_area.signum() / length;
            let normal = [(s[1] - t[1]) * scale, (t[0] - s[0]) * scale];
            [normal[0], normal[1], -(normal[0] * s[0] + normal[1] * s[1])]
        };
        // Without area there is no inside, and all texels in the bounds are visited.
        if double_area.abs() > 1e-9 {
            Self([side(a, b), side(b, c), side(c, a)])
        } else {
            Self([[0.0, 0.0, -1e-3]; 3])
        }
    }

    /// Inside, the distance from the nearest side; outside, negative and no farther than the triangle is.
    fn depth(&self, [x, y]: [f32; 2]) -> f32 {
        let [a, b, c] = self.0.map(|side| side[0] * x + side[1] * y + side[2]);
        a.min(b).min(c)
    }
}

/// The point of a triangle nearest to `p`: its barycentric weights and itself (after Ericson, "Real-time collision
/// detection", 2005, 5.1.5). Triangles without area count as their longest sides, or as points.
fn closest(p: [f32; 2], [a, b, c]: &[[f32; 2]; 3]) -> ([f32; 3], [f32; 2]) {
    let cross = |o: &[f32; 2], s: &[f32; 2], t: [f32; 2]| {
        (s[0] - o[0]) * (t[1] - o[1]) - (s[1] - o[1]) * (t[0] - o[0])
    };
    let double_area = cross(a, b, *c);
    if double_area.abs() > 1e-9 {
        let weights =
            [cross(b, c, p) / double_area, cross(c, a, p) / double_area, cross(a, b, p) / double_area];
        if weights.iter().all(|w| *w >= 0.0) {
            return (weights, p);
        }
    }
    let on_side = |s: &[f32; 2], t: &[f32; 2]| {
        let along = [t[0] - s[0], t[1] - s[1]];
        let length = along[0] * along[0] + along[1] * along[1];
        let dot = (p[0] - s[0]) * along[0] + (p[1] - s[1]) * along[1];
        let share = if length > 0.0 { (dot / length).clamp(0.0, 1.0) } else { 0.0 };
        let q = [s[0] + share * along[0], s[1] + share * along[1]];
        (share, q, (q[0] - p[0]).powi(2) + (q[1] - p[1]).powi(2))
    };
    let (ab, bc, ca) = (on_side(a, b), on_side(b, c), on_side(c, a));
    if ab.2 <= bc.2 && ab.2 <= ca.2 {
        ([1.0 - ab.0, ab.0, 0.0], ab.1)
    } else if bc.2 <= ca.2 {
        ([0.0, 1.0 - bc.0, bc.0], bc.1)
    } else {
        ([ca.0, 0.0, 1.0 - ca.0], ca.1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn uv(points: &[[f64; 2]]) -> Vec<Vector2<f64>> {
        points.iter().map(|p| Vector2::new(p[0], p[1])).collect()
    }

    #[test]
    fn two_halves_of_a_square_share_it_without_gap_or_overlap() {
        let uv = uv(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]);
        let mut atlas = Atlas::new(16, 16);
        atlas.assign(&[[0, 1, 2], [0, 2, 3]], &uv);
        let counts = [0, 1].map(|t| (0..256).filter(|texel| atlas.owner(*texel) == Some(t)).count());
        // The texels on the diagonal belong to the first of the two.
        assert_eq!(counts, [136, 120]);
        assert_eq!(atlas.shared(), 0);
        atlas.assign(&[[0, 1, 2], [0, 1, 2]], &uv);
        assert!(atlas.shared() > 100, "{}", atlas.shared());
    }

    #[test]
    fn a_chart_is_widened_by_what_bilinear_sampling_touches_and_no_more() {
        let uv = uv(&[[0.25, 0.25], [0.75, 0.25], [0.75, 0.75], [0.25, 0.75]]);
        let mut atlas = Atlas::new(32, 32);
        atlas.assign(&[[0, 1, 2], [0, 2, 3]], &uv);
        for (x, y) in (0..32).flat_map(|y| (0..32).map(move |x| (x, y))) {
            let owned = atlas.owner(y * 32 + x).is_some();
            let inside = (7..=24).contains(&x) && (7..=24).contains(&y);
            assert_eq!(owned, inside, "({x}, {y})");
        }
    }

    #[test]
    fn weights_give_back_the_place() {
        let points = uv(&[[0.1, 0.2], [0.9, 0.15], [0.4, 0.8]]);
        let mut atlas = Atlas::new(64, 32);
        atlas.assign(&[[0, 1, 2]], &points);
        let mut seen = 0;
        let rect = atlas.visit(0, |texel, weights| {
            let at: Vector2<f64> = (0..3).map(|k| points[k] * f64::from(weights[k])).sum();
            let center = [(texel % 64) as f64 + 0.5, (texel / 64) as f64 + 0.5];
            assert!((at.x * 64.0 - center[0]).abs() <= 1.42 && (at.y * 32.0 - center[1]).abs() <= 1.42);
            assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-4);
            seen += 1;
        });
        assert!(seen > 300, "{seen}");
        let rect = rect.expect("something was painted");
        assert!(
            rect.x >= 5 && rect.x + rect.width <= 60 && rect.y >= 3 && rect.y + rect.height <= 28,
            "{rect:?}"
        );
    }

    #[test]
    fn a_pile_of_triangles_takes_bounded_time() {
        let uv = uv(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]);
        let mut atlas = Atlas::new(512, 512);
        // One visit per texel and triangle would be 10¹¹ of them.
        atlas.assign(&vec![[0, 1, 2]; 400_000], &uv);
        assert!(atlas.left_out() > 399_000, "{}", atlas.left_out());
        assert_eq!(atlas.owner(10 * 512 + 300), Some(0));
    }

    #[test]
    fn bad_triangles_get_no_texels_and_harm_nobody() {
        let uv =
            uv(&[[0.1, 0.1], [0.9, 0.1], [0.5, 0.9], [f64::NAN, 0.0], [1e300, 0.5], [-1e5, 1e5], [0.1, 0.1]]);
        let mut atlas = Atlas::new(8, 8);
        let triangles = [[0, 1, 99], [0, 1, 3], [0, 1, 4], [0, 6, 0], [0, 1, 1], [5, 0, 1], [0, 1, 2]];
        atlas.assign(&triangles, &uv);
        for bad in 0..3 {
            assert_eq!(atlas.visit(bad, |_, _| panic!("triangle {bad} owns texels")), None);
        }
        let mut finite = true;
        (3..8).for_each(|t| {
            atlas.visit(t, |_, weights| finite &= weights.iter().all(|w| w.is_finite()));
        });
        assert!(finite);
        assert!(atlas.visit(6, |_, _| {}).is_some());
        assert_eq!(atlas.left_out(), 3);
    }
}
