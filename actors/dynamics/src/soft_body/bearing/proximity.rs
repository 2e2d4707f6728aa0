//! Which points of a soft and a rigid body are in contact, or may be at the end of a step.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_collision::Surface;
use trocar_collision::moving_surface::MovingSurface;

use super::rigid_surface::{NearestOnSurface, RigidSurface, nearest_on};
use super::{Bearer, Seen, SoftSurface};
use crate::soft_body::contact::BearingFeature;

/// Distance within which a contact is listed before it presses, in addition to what may be covered in a step \[m\].
const MARGIN: f64 = 1e-4;
/// By how much more than its current velocity says a body may move in a step.
const FASTER: f64 = 1.5;

/// A point of the soft surface near the rigid body; all in the soft body's frame.
pub(super) struct NearPoint {
    pub feature: BearingFeature,
    pub nodes: [u32; 3],
    pub weights: [f64; 3],
    /// Unit direction from the rigid body to the soft one.
    pub normal: Vector3<f64>,
    /// Depth now; negative for a gap \[m\].
    pub depth: f64,
    /// Position \[m\].
    pub at: Point3<f64>,
}

/// A rigid body as seen from the frame of a soft one.
struct Approach<'a> {
    of: &'a Bearer<'a>,
    rigid: &'a RigidSurface,
    seen: &'a Seen<'a>,
    rigid_from_body: Isometry3<f64>,
    body_from_rigid: Isometry3<f64>,
    step: f64,
    /// How far the body may fall in a step \[m\].
    falls: f64,
}

impl Approach<'_> {
    /// How near a point of the soft body is to be to be listed, by its velocity relative to the rigid body \[m\].
    fn reach(&self, at_in_body: &Point3<f64>, velocity: &Vector3<f64>) -> f64 {
        if self.seen.is_ahead {
            // The pose ahead of a body that was borne leaves out its weight. If nothing bears it now, it falls by so much.
            return FASTER * self.step * velocity.norm() + self.falls + MARGIN;
        }
        let world_from_body = &self.of.world_from_body;
        let relative =
            world_from_body.rotation * velocity - self.seen.proxy.speed(&(world_from_body * at_in_body));
        FASTER * self.step * relative.norm() + self.falls + MARGIN
    }

    /// A point of the soft body against the surface of the rigid one.
    fn of_soft(
        &self,
        feature: BearingFeature,
        nodes: [u32; 3],
        weights: [f64; 3],
        tell: &mut impl FnMut(NearPoint),
    ) {
        let of = self.of;
        let shares = || nodes.iter().zip(weights);
        let at: Vector3<f64> =
            shares().map(|(&node, weight)| of.positions[node as usize].coords * weight).sum();
        let velocity = shares().map(|(&node, weight)| of.velocities[node as usize] * weight).sum();
        let at = Point3::from(at);
        let reach = of.thickness + self.reach(&at, &velocity);
        let in_rigid = self.rigid_from_body * at;
        if in_rigid.coords.norm() > self.rigid.reach() + reach {
            return;
        }
        let Some(NearestOnSurface { distance, outwards, .. }) = self.rigid.nearest(&in_rigid) else { return };
        if distance > reach {
            return;
        }
        let normal = self.body_from_rigid.rotation * outwards;
        tell(NearPoint { feature, nodes, weights, normal, depth: of.thickness - distance, at });
    }

    /// A point of the rigid body against the surface of the soft one.
    fn of_rigid(
        &self,
        number: u32,
        in_rigid: &Point3<f64>,
        surface: &MovingSurface,
        bounds: &[Point3<f64>; 2],
        tell: &mut impl FnMut(NearPoint),
    ) {
        let of = self.of;
        let at = self.body_from_rigid * in_rigid;
        // The velocity of the soft surface there is not known yet: that of the rigid body alone.
        let far = of.thickness + self.reach(&at, &Vector3::zeros());
        if (0..3).any(|k| at[k] < bounds[0][k] - far || at[k] > bounds[1][k] + far) {
            return;
        }
        let centre = self.of.world_from_body.inverse_transform_point(&self.seen.centre());
        let side = (!of.closed).then_some(&centre);
        let radius = if of.closed { (bounds[1] - bounds[0]).norm() } else { 2.0 * self.rigid.reach() };
        let Some(nearest) = nearest_on(surface, &at, radius.max(far), side) else { return };
        let nodes = of.triangles[nearest.triangle as usize];
        let shares = nodes.iter().zip(nearest.weights);
        let velocity = shares.map(|(&node, weight)| of.velocities[node as usize] * weight).sum();
        if nearest.distance > of.thickness + self.reach(&at, &velocity) {
            return;
        }
        tell(NearPoint {
            feature: BearingFeature::Point(number),
            nodes,
            weights: nearest.weights,
            normal: -nearest.outwards,
            depth: of.thickness - nearest.distance,
            at: nearest.point,
        });
    }
}

/// Tells all points of a soft body whose vertices are within `bounds` \[m\] that may touch a rigid body within `step`
/// seconds.
pub(super) fn near_points(
    soft: &mut SoftSurface,
    of: &Bearer<'_>,
    bounds: &[Point3<f64>; 2],
    rigid: &RigidSurface,
    seen: &Seen<'_>,
    step: f64,
    mut tell: impl FnMut(NearPoint),
) {
    let body_from_rigid = of.world_from_body.inverse() * seen.pose;
    let falls = step * step * seen.proxy.pull().norm();
    let rigid_from_body = body_from_rigid.inverse();
    let approach = Approach { of, rigid, seen, rigid_from_body, body_from_rigid, step, falls };
    let middle = Point3::from(body_from_rigid.translation.vector);
    let spin = seen.proxy.of_origin();
    let fastest = spin.linear.norm() + spin.angular.norm() * rigid.reach();
    let far = rigid.reach() + of.thickness + FASTER * step * fastest + falls + MARGIN;
    let is_far = |at: &Point3<f64>, far: f64| (at - middle).norm_squared() > far * far;
    if (0..3).any(|k| middle[k] < bounds[0][k] - far || middle[k] > bounds[1][k] + far) {
        return;
    }
    for &vertex in &soft.vertices {
        let own = FASTER * step * of.velocities[vertex as usize].norm();
        if !is_far(&of.positions[vertex as usize], far + own) {
            approach.of_soft(BearingFeature::Vertex(vertex), [vertex; 3], [1.0, 0.0, 0.0], &mut tell);
        }
    }
    if soft.triangles.is_empty() {
        for (segment, &[a, b]) in soft.segments.iter().enumerate() {
            let feature = BearingFeature::Middle(segment as u32);
            approach.of_soft(feature, [a, b, b], [0.5, 0.5, 0.0], &mut tell);
        }
        return;
    }
    if !std::mem::replace(&mut soft.is_current, true) {
        let Ok(surface) = Surface::new(of.positions, of.triangles) else { return };
        match &mut soft.surface {
            Some(known) => drop(known.follow(&surface)),
            None => soft.surface = Some(MovingSurface::new(&surface)),
        }
    }
    let Some(surface) = &soft.surface else { return };
    for (number, point) in rigid.points().iter().enumerate() {
        approach.of_rigid(number as u32, point, surface, bounds, &mut tell);
    }
}
