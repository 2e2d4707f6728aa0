//! Local contact model of the proxy's surroundings, which haptics evaluates at its own rate (Adachi, Kumano and Ogino,
//! *Intermediate representation for stiff virtual objects*, 1995; Mark et al., *Adding force feedback to graphics
//! systems*, 1996).

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::components::{ContactPlane, LocalContactModel, Pose, Velocity};
use trocar_scene::time::SimTime;

use super::{FingerProxy, TouchedTriangle};
use crate::moving_surface::MovingSurface;

/// Of two planes whose normals differ by less than this (about 18°) the farther one is dropped.
const SAME_PLANE_COSINE: f64 = 0.95;
/// Most triangles considered for planes.
const SEEN_MAX: usize = 32;

/// Contact properties of a plane of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneProperties {
    /// Stiffness against penetration, the tissue's compliance linearised where it is \[N/m\].
    pub stiffness: f64,
    /// Damping along the normal \[N·s/m\].
    pub damping: f64,
}

impl FingerProxy {
    /// At most four planes: those in contact with the proxy first, then those that it may reach within `foresight`
    /// \[m\], nearest first. A tip above all of them is at an allowed proxy position. The model's proxy velocity is the
    /// proxy's own.
    #[must_use]
    pub fn local_contact_model(
        &self,
        mesh: &MovingSurface,
        world_from_surface: &Isometry3<f64>,
        feel: &PlaneProperties,
        foresight: f64,
        at: SimTime,
    ) -> LocalContactModel {
        let in_world = |on_surface: &Point3<f64>, normal: &Vector3<f64>| ContactPlane {
            point_in_world: world_from_surface * (on_surface + normal * self.hold()),
            normal_in_world: world_from_surface * normal,
            stiffness: feel.stiffness,
            damping: feel.damping,
            friction: self.config.static_friction,
        };
        let mut planes = [None; 4];
        let mut count = 0;
        let mut taken = [Vector3::zeros(); 4];
        for contact in self.contacts() {
            planes[count] = Some(in_world(&contact.on_surface, &contact.normal));
            taken[count] = contact.normal;
            count += 1;
        }
        let mut seen: [Option<TouchedTriangle>; SEEN_MAX] = [None; SEEN_MAX];
        self.nearest_around(mesh, self.hold() + foresight, &mut seen);
        for own in seen.iter().flatten() {
            let is_part = seen.iter().flatten().any(|other| own.is_part_of(other, mesh));
            let is_taken = taken[..count].iter().any(|normal| normal.dot(&own.normal) > SAME_PLANE_COSINE);
            if count < planes.len() && !is_part && !is_taken {
                planes[count] = Some(in_world(&own.on_surface, &own.normal));
                taken[count] = own.normal;
                count += 1;
            }
        }
        let orientation = world_from_surface.rotation;
        LocalContactModel {
            proxy_in_world: Pose::new((world_from_surface * self.proxy).coords, orientation),
            proxy_velocity: Velocity { linear: orientation * self.velocity, angular: Vector3::zeros() },
            planes,
            base_force: Vector3::zeros(),
            at,
        }
    }

    /// The nearest triangles within `reach` \[m\], nearest first.
    fn nearest_around(
        &self,
        mesh: &MovingSurface,
        reach: f64,
        seen: &mut [Option<TouchedTriangle>; SEEN_MAX],
    ) {
        let mut count = 0;
        mesh.tree().nearest_to_point_first(&self.proxy, reach, |triangle, _| {
            let Some(touched) = TouchedTriangle::of(mesh, triangle, &self.proxy) else { return reach };
            if touched.distance <= reach {
                let further = |other: &Option<TouchedTriangle>| {
                    other.is_none_or(|other| other.distance > touched.distance)
                };
                let place = seen[..count].iter().position(further).unwrap_or(count);
                if place < SEEN_MAX {
                    count = (count + 1).min(SEEN_MAX);
                    seen[place..count].rotate_right(1);
                    seen[place] = Some(touched);
                }
            }
            reach
        });
    }
}
