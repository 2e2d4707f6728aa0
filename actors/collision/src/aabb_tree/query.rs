//! Queries of the AABB tree: the nearest triangle, and all triangles near an object.

use nalgebra::Point3;

use super::bound::{BoxBound, LowerBound, SegmentBound, SphereSweepBound, up};
use super::{Aabb, AabbTree, NONE};
use crate::primitive::{
    PointTriangle, Segment, SegmentTriangle, closest_on_triangle, closest_segment_triangle,
};
use crate::{Surface, SurfaceError};

/// Largest stack of nodes: three per level, and a `u32` of triangles has 16 or 17 levels.
const WAITING: usize = 64;

/// Number of nodes and triangles visited by a query.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct QueryCost {
    /// Nodes of four boxes.
    pub nodes: u32,
    /// Triangles.
    pub triangles: u32,
}

/// The nearest triangle to a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearestToPoint {
    /// Its index.
    pub triangle: u32,
    /// Its nearest point.
    pub nearest: PointTriangle,
    /// Distance \[m\].
    pub distance: f64,
}

/// The nearest triangle to a segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearestToSegment {
    /// Its index.
    pub triangle: u32,
    /// The nearest points.
    pub nearest: SegmentTriangle,
    /// Distance \[m\]; 0 where the segment crosses the triangle.
    pub distance: f64,
}

/// A pending node, with a lower bound of its distance.
#[derive(Clone, Copy)]
struct PendingNode {
    lower: f32,
    node: u32,
}

impl AabbTree {
    /// The triangle nearest to `point` within `radius` \[m\]; of equally near ones the one with the lowest index.
    ///
    /// # Errors
    /// [`SurfaceError::OtherTriangles`] for a surface other than the one fitted.
    pub fn nearest_to_point(
        &self,
        surface: &Surface,
        point: &Point3<f64>,
        radius: f64,
    ) -> Result<Option<NearestToPoint>, SurfaceError> {
        self.nearest_to_point_from(surface, point, radius, None)
    }

    /// The same, warm-started with the triangle `first`, which is tested first: the nearer it is, the faster the query.
    /// An invalid index is ignored.
    ///
    /// # Errors
    /// As [`nearest_to_point`](Self::nearest_to_point).
    pub fn nearest_to_point_from(
        &self,
        surface: &Surface,
        point: &Point3<f64>,
        radius: f64,
        first: Option<u32>,
    ) -> Result<Option<NearestToPoint>, SurfaceError> {
        self.expect(surface)?;
        let first = first.filter(|first| (*first as usize) < self.triangles);
        let mut best: Option<NearestToPoint> = None;
        let mut limit = radius;
        let mut look = |triangle: u32, limit: &mut f64| {
            let nearest = closest_on_triangle(point, &surface.triangle(triangle));
            let distance = (nearest.point - point).norm();
            let is_nearer = best.is_none_or(|best| {
                distance < best.distance || distance == best.distance && triangle < best.triangle
            });
            if distance <= *limit && is_nearer {
                *limit = distance;
                best = Some(NearestToPoint { triangle, nearest, distance });
            }
        };
        if let Some(first) = first {
            look(first, &mut limit);
        }
        self.nearest_first(&BoxBound::point(point, self.scale), limit, |triangle, _| {
            if Some(triangle) != first {
                look(triangle, &mut limit);
            }
            limit
        });
        Ok(best)
    }

    /// The triangle nearest to `segment` within `radius` \[m\].
    ///
    /// # Errors
    /// [`SurfaceError::OtherTriangles`] for a surface other than the one fitted.
    pub fn nearest_to_segment(
        &self,
        surface: &Surface,
        segment: &Segment,
        radius: f64,
    ) -> Result<Option<NearestToSegment>, SurfaceError> {
        self.expect(surface)?;
        let mut best: Option<NearestToSegment> = None;
        let mut limit = radius;
        self.nearest_first(&SegmentBound::new(segment, self.scale), radius, |triangle, _| {
            let nearest = closest_segment_triangle(segment, &surface.triangle(triangle));
            let distance = nearest.distance_squared.sqrt();
            if distance <= limit && best.is_none_or(|best| distance < best.distance) {
                limit = distance;
                best = Some(NearestToSegment { triangle, nearest, distance });
            }
            limit
        });
        Ok(best)
    }

    /// Triangles whose box overlaps `bounds`, appended to `found` in the tree's order. None is missing; some may be
    /// outside by a rounding error.
    pub fn overlapping(&self, bounds: &Aabb, found: &mut Vec<u32>) -> QueryCost {
        self.within(&BoxBound::new(bounds, self.scale), 0.0, |triangle, _| found.push(triangle))
    }

    /// Triangles whose box may be nearer than `radius` \[m\] to `point`, appended with a lower bound of their distance.
    pub fn around_point(&self, point: &Point3<f64>, radius: f64, found: &mut Vec<(u32, f32)>) -> QueryCost {
        let near = BoxBound::point(point, self.scale);
        self.within(&near, radius, |triangle, lower| found.push((triangle, lower)))
    }

    /// Triangles whose box may be nearer than `radius` \[m\] to `segment`, which a sphere of that radius may hit along
    /// it, appended with a lower bound of their distance.
    pub fn around_segment(&self, segment: &Segment, radius: f64, found: &mut Vec<(u32, f32)>) -> QueryCost {
        let near = SegmentBound::new(segment, self.scale);
        self.within(&near, radius, |triangle, lower| found.push((triangle, lower)))
    }

    /// Visits triangles near `segment`, nearer boxes first. `visit` takes a triangle and the lower bound of its
    /// distance, and returns the distance from which on triangles can be skipped.
    pub(crate) fn nearest_to_segment_first(
        &self,
        segment: &Segment,
        limit: f64,
        visit: impl FnMut(u32, f32) -> f64,
    ) -> QueryCost {
        self.nearest_first(&SegmentBound::new(segment, self.scale), limit, visit)
    }

    /// The same for a point.
    pub(crate) fn nearest_to_point_first(
        &self,
        point: &Point3<f64>,
        limit: f64,
        visit: impl FnMut(u32, f32) -> f64,
    ) -> QueryCost {
        self.nearest_first(&BoxBound::point(point, self.scale), limit, visit)
    }

    /// Visits the triangles that a sphere may hit along `segment`, those near its start first. `visit` returns the
    /// share of the path, 0 to 1, that is still to be searched.
    pub(crate) fn along_way_first(
        &self,
        segment: &Segment,
        radius: f64,
        mut visit: impl FnMut(u32) -> f64,
    ) -> QueryCost {
        let length = (segment[1] - segment[0]).norm();
        let near = SphereSweepBound::new(segment, radius, self.scale);
        self.nearest_first(&near, radius + length, |triangle, _| radius + length * visit(triangle))
    }

    fn expect(&self, surface: &Surface) -> Result<(), SurfaceError> {
        let found = surface.triangles().len();
        if found == self.triangles {
            Ok(())
        } else {
            Err(SurfaceError::OtherTriangles { expected: self.triangles, found })
        }
    }

    /// Visits all of them, in no particular order.
    #[inline]
    fn within(&self, near: &impl LowerBound, radius: f64, mut visit: impl FnMut(u32, f32)) -> QueryCost {
        let mut cost = QueryCost::default();
        let mut stack = [0_u32; WAITING];
        let mut height = usize::from(!self.nodes.is_empty());
        let limit = up(radius);
        while height > 0 {
            height -= 1;
            let node = &self.nodes[stack[height] as usize];
            let lower = near.lower(node);
            cost.nodes += 1;
            for (lane, &lower) in lower.iter().enumerate() {
                if node.child[lane] == NONE || lower > limit {
                    continue;
                }
                if node.is_leaf(lane) {
                    cost.triangles += 1;
                    visit(node.child[lane], lower);
                } else {
                    stack[height] = node.child[lane];
                    height += 1;
                }
            }
        }
        cost
    }

    /// Visits the nearest nodes first, and all triangles of a node before the next node.
    #[inline]
    fn nearest_first(
        &self,
        near: &impl LowerBound,
        limit: f64,
        mut visit: impl FnMut(u32, f32) -> f64,
    ) -> QueryCost {
        let mut cost = QueryCost::default();
        let mut stack = [PendingNode { lower: 0.0, node: 0 }; WAITING];
        let mut height = usize::from(!self.nodes.is_empty());
        let mut limit = up(limit);
        while height > 0 {
            height -= 1;
            let next = stack[height];
            if next.lower > limit {
                continue;
            }
            cost.nodes += 1;
            let node = &self.nodes[next.node as usize];
            let lower = near.lower(node);
            let floor = height;
            for (lane, &lower) in lower.iter().enumerate() {
                if node.child[lane] == NONE || lower > limit {
                    continue;
                }
                if node.is_leaf(lane) {
                    cost.triangles += 1;
                    limit = up(visit(node.child[lane], lower));
                    continue;
                }
                // The nearest is pushed last, on top of the stack.
                let mut place = height;
                while place > floor && stack[place - 1].lower < lower {
                    stack[place] = stack[place - 1];
                    place -= 1;
                }
                stack[place] = PendingNode { lower, node: node.child[lane] };
                height += 1;
            }
        }
        cost
    }
}
