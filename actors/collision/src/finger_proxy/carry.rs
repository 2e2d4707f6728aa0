//! Carrying of the proxy by a moving surface, with continuous collision detection in the surface's motion.
//!
//! Motion is relative to the point that the proxy touches, so that rigid motion of the surface has no effect. Each
//! triangle moves linearly from its old to its new position. A step reduces no distance below half of the nearest
//! triangle's; so no triangle passes the proxy's centre, and after each step the planes push the proxy out, without it
//! passing any triangle.

use nalgebra::{Point3, Vector3};

use super::planes::{Plane, Planes};
use super::{EXACT, FingerProxy, RETREAT, SETTLED, TOUCH};
use crate::moving_surface::MovingSurface;
use crate::primitive::{Triangle, closest_on_triangle, sweep_sphere_triangle};

/// Most steps of an update. Each but the last halves the nearest distance, or ends the update.
const STEPS_MAX: usize = 512;
/// Most pushes after each step.
const PUSHES_MAX: usize = 4;
/// Relative to the skin: distance below which there is no room left between two walls.
const NO_ROOM: f64 = 1e-6;

/// A moving triangle.
#[derive(Clone, Copy, Debug)]
struct Moving {
    before: Triangle,
    motion: [Vector3<f64>; 3],
}

impl Moving {
    fn at(&self, share: f64) -> Triangle {
        [0, 1, 2].map(|corner| self.before[corner] + self.motion[corner] * share)
    }

    fn furthest(&self) -> f64 {
        self.motion.iter().map(Vector3::norm_squared).fold(0.0, f64::max).sqrt()
    }
}

/// Moving triangles; the buffer is reused between updates.
#[derive(Clone, Debug, Default)]
pub(super) struct Carried {
    near: Vec<Moving>,
    found: Vec<(u32, f32)>,
}

impl FingerProxy {
    /// Carries the proxy along with the last update of the surface.
    pub(super) fn carry(&mut self, mesh: &MovingSurface) {
        let motion = mesh.last_motion();
        self.around.travel(motion);
        if motion <= 0.0 {
            return;
        }
        let start = self.proxy;
        let (mut share, mut place) = (0.0, self.proxy);
        // At most a few pushes exceed the gathered region.
        for _ in 0..8 {
            let budget = 2.0 * motion + 0.1 * self.hold();
            let Some(with) = self.gather(mesh, &place, share, budget) else {
                share = 1.0;
                break;
            };
            (share, place) = self.push(place, share, &with, budget);
            if share >= 1.0 {
                break;
            }
        }
        if share < 1.0 {
            self.statistics.squeezed += 1;
        }
        self.proxy = place;
        self.around.travel((place - start).norm());
    }

    /// The triangles that may touch the proxy from `share` on, and the motion of the touched point, to which their
    /// motion is relative; `None` if none comes near.
    fn gather(
        &mut self,
        mesh: &MovingSurface,
        place: &Point3<f64>,
        share: f64,
        budget: f64,
    ) -> Option<Vector3<f64>> {
        let hold = self.hold();
        // Twice the motion: that of the proxy with the touched surface, and that of the triangles.
        let reach = hold + 2.0 * mesh.last_motion() + budget;
        let mut carried = std::mem::take(&mut self.carried);
        carried.near.clear();
        carried.found.clear();
        let moved = (place - self.proxy).norm();
        if self.around.cover(mesh, &self.proxy, reach + moved, &mut self.statistics) {
            carried.found.extend(self.around.triangles().map(|triangle| (triangle, 0.0)));
        } else {
            mesh.tree().around_point(place, reach, &mut carried.found);
        }
        let surface = mesh.surface();
        let (now, before) = (surface.vertices(), mesh.vertices_before());
        let mut nearest = f64::INFINITY;
        let mut with = Vector3::zeros();
        for &(triangle, _) in &carried.found {
            let corners = surface.triangles()[triangle as usize].map(|vertex| vertex as usize);
            let moving = Moving {
                before: corners.map(|vertex| before[vertex]),
                motion: corners.map(|vertex| now[vertex] - before[vertex]),
            };
            let closest = closest_on_triangle(place, &moving.at(share));
            let distance = (closest.point - place).norm();
            if distance <= reach {
                carried.near.push(moving);
            }
            if distance < nearest {
                nearest = distance;
                with = mesh.displacement(triangle, &closest.weights);
            }
        }
        if nearest > hold + TOUCH * self.config.skin {
            // A surface without contact does not carry it.
            with = Vector3::zeros();
        }
        for moving in &mut carried.near {
            for motion in &mut moving.motion {
                *motion -= with;
            }
            // Relative to the carried frame, everything is at its position at this share.
            for corner in &mut moving.before {
                *corner += with * share;
            }
        }
        carried.near.retain(|moving| {
            let closest = closest_on_triangle(place, &moving.at(share));
            (closest.point - place).norm() <= hold + moving.furthest() + budget
        });
        let is_far = nearest > hold + 2.0 * mesh.last_motion();
        self.carried = carried;
        (!is_far).then_some(with)
    }

    /// Advances from `share` as far as the budget allows; returns the share reached, and the proxy's position.
    fn push(
        &mut self,
        start: Point3<f64>,
        from: f64,
        with: &Vector3<f64>,
        budget: f64,
    ) -> (f64, Point3<f64>) {
        let near = std::mem::take(&mut self.carried.near);
        let fastest = near.iter().map(Moving::furthest).fold(0.0, f64::max);
        let (mut place, mut share, mut pushed) = (start, from, 0.0);
        let mut room = clearance(&near, &place, share);
        for _ in 0..STEPS_MAX {
            if share >= 1.0 || pushed >= 0.99 * budget || room <= NO_ROOM * self.config.skin {
                break;
            }
            let step = if fastest > 0.0 { 0.5 * room / fastest } else { 1.0 };
            share = (share + step).min(1.0);
            for _ in 0..PUSHES_MAX {
                let (mut motion, nearest) = self.retreat(&near, &place, share);
                room = nearest;
                if motion.norm() <= SETTLED * self.config.skin {
                    break;
                }
                // Beyond the budget there may be ungathered triangles.
                motion *= ((budget - pushed) / motion.norm()).clamp(0.0, 1.0);
                let guard = 0.9 * room.min(self.guard());
                let free = near.iter().fold(1.0_f64, |free, moving| {
                    free.min(sweep_sphere_triangle(&place, guard, &motion, &moving.at(share)))
                });
                place += motion * free;
                pushed += motion.norm() * free;
                room = clearance(&near, &place, share);
            }
        }
        self.carried.near = near;
        (share, place + with * (share - from))
    }

    /// The position to which the planes of too near triangles push it, and the distance of the nearest.
    fn retreat(&self, near: &[Moving], place: &Point3<f64>, share: f64) -> (Vector3<f64>, f64) {
        let hold = self.hold();
        let mut planes = Planes::none();
        let mut nearest = f64::INFINITY;
        for (owner, moving) in near.iter().enumerate() {
            let away = place - closest_on_triangle(place, &moving.at(share)).point;
            let distance = away.norm();
            nearest = nearest.min(distance);
            if distance > 0.0 && distance <= hold + TOUCH * self.config.skin {
                let plane = Plane { normal: away / distance, least: hold - distance, owner };
                planes.push(plane, &Vector3::zeros());
            }
        }
        let motion = planes.retreat(EXACT * self.config.skin, RETREAT * self.config.skin);
        (motion.unwrap_or_else(|| planes.compromise()), nearest)
    }
}

/// Distance of the nearest \[m\].
fn clearance(near: &[Moving], place: &Point3<f64>, share: f64) -> f64 {
    let squared =
        |moving: &Moving| (closest_on_triangle(place, &moving.at(share)).point - place).norm_squared();
    near.iter().map(squared).fold(f64::INFINITY, f64::min).sqrt()
}
