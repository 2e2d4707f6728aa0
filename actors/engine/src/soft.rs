//! Soft volumes by Rapier: tetrahedra, by Rapier's own solvers, as one more method beside those of `trocar-simulator`;
//! a scenario selects the method in one line.
//!
//! Instruments touch, press and grasp these bodies as any soft body. A contact is a spring of the body's
//! `contact_stiffness`, integrated implicitly within each substep; what stops an instrument leads vertices
//! (`held_back.rs`). The force on grasping jaws is the stress of the elements around the held vertices. Rapier's solvers
//! warm-start from the previous step, and that state is not in the scene: after a restart the body resumes from the same
//! positions and velocities, within the solver's tolerance and not bit-identically.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3, Vector3};
use rapier3d_f64::dynamics::{
    SoftBody, SoftBodyBuilder, SoftBodyCellModel, SoftBodyHandle, SoftBodyMaterial, SoftBodySolver,
};
use rapier3d_f64::pipeline::PhysicsWorld;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_dynamics::elasticity::cauchy_stress;
use trocar_dynamics::soft_body::bearing::rigid_motion::{PressedNodes, RigidMotion, press, press_as_before};
use trocar_dynamics::soft_body::bearing::rigid_response::RigidPresses;
use trocar_dynamics::soft_body::jaw_friction::GripForce;
use trocar_dynamics::soft_body::method::{
    ContactParams, Measures, StepContext, bearing_stiffness, bearing_substep, pressure_wave_squared,
};
use trocar_dynamics::soft_body::rod_contact::{ContactSurface, RodContact};
use trocar_dynamics::soft_body::{Deformable, SoftController, SoftMethod};
use trocar_dynamics::tet_mesh::{MeshRules, TetMesh};
use trocar_scene::{Component, ComponentError, Snapshot, SoftAbilities};

use crate::conversion::{point_from_rapier, vector_from_rapier, vector_to_rapier};
use crate::held_back::{LedVertex, first_led, led_vertices};
use crate::settings::LENGTH_UNIT;

/// Maximum number of substeps of a step.
const PARTS_MAX: u32 = 100;

/// Rapier's solver for the elements.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EngineSoftSolver {
    /// Each element by constraints, solved in sweeps: cheap, and softer than its modulus with few substeps and sweeps.
    #[default]
    Constraints,
    /// All elements together by implicit finite elements.
    FiniteElements,
}

/// A soft volume of the engine. It needs a tetrahedral mesh, and `anchors` where it is to be fixed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(
    name = "engine_soft", check = Self::ranges, schema,
    soft_body = SoftAbilities { responds_to_contacts: true, bears: true, ..SoftAbilities::NONE },
)]
#[serde(default, deny_unknown_fields)]
pub struct EngineSoftBody {
    /// Young's modulus \[Pa\].
    pub young_modulus: f64,
    /// Poisson's ratio, 0 to 0.49.
    pub poisson_ratio: f64,
    /// Density \[kg/m³\].
    pub density: f64,
    /// The solver.
    pub solver: EngineSoftSolver,
    /// Substeps per step, 1 to 100.
    pub parts: u32,
    /// Sweeps over the constraints per substep, 1 to 100; finite elements need only one.
    pub iterations: u32,
    /// Velocity damping \[1/s\].
    pub damping: f64,
    /// Contact stiffness: force per penetration depth \[N/m\].
    pub contact_stiffness: f64,
    /// Coulomb friction against instruments.
    pub friction: f64,
}

impl Default for EngineSoftBody {
    /// The default organ of `xpbd`.
    fn default() -> Self {
        Self {
            young_modulus: 8e3,
            poisson_ratio: 0.45,
            density: 1060.0,
            solver: EngineSoftSolver::default(),
            parts: 4,
            iterations: 4,
            damping: 2.0,
            contact_stiffness: 300.0,
            friction: 0.3,
        }
    }
}

impl EngineSoftBody {
    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("young_modulus", self.young_modulus, 1.0..=1e12, "1 to 1e12 Pa")?;
        ComponentError::range("poisson_ratio", self.poisson_ratio, 0.0..=0.49, "0 to 0.49")?;
        ComponentError::range("density", self.density, 1.0..=1e5, "1 to 1e5 kg/m³")?;
        ComponentError::range("parts", f64::from(self.parts), 1.0..=f64::from(PARTS_MAX), "1 to 100")?;
        ComponentError::range("iterations", f64::from(self.iterations), 1.0..=100.0, "1 to 100")?;
        ComponentError::range("damping", self.damping, 0.0..=1e4, "0 to 1e4 1/s")?;
        ComponentError::range("contact_stiffness", self.contact_stiffness, 0.0..=1e6, "0 to 1e6 N/m")?;
        ComponentError::range("friction", self.friction, 0.0..=10.0, "0 to 10")
    }
}

/// One soft volume in a Rapier world of its own.
pub struct EngineSoftMethod {
    kind: EngineSoftBody,
    world: PhysicsWorld,
    handle: SoftBodyHandle,
    mesh: TetMesh,
    masses: Vec<f64>,
    /// Inverse mass of each vertex, 0 where it is fixed \[1/kg\].
    mobility: Vec<f64>,
    /// Stiffness of each contact with a rigid body that moves \[N/m\].
    bearing_stiffness: f64,
    /// Longest substep under a rigid body \[s\].
    bearing_substep: f64,
    /// Fixed vertices, ascending.
    pinned: Vec<u32>,
    /// Vertices held by jaws, ascending.
    driven: Vec<u32>,
    positions: Vec<Point3<f64>>,
    velocities: Vec<Vector3<f64>>,
    /// What the elements bore in the last substep of the push of rigid bodies on a vertex \[N\].
    borne: BTreeMap<u32, Vector3<f64>>,
    /// What the jaws of each watched grip did.
    grips: Vec<GripForce>,
}

/// A contact with a rod during a step.
struct ActiveContact {
    /// The contact point at the beginning of the step \[m\].
    touched: Vector3<f64>,
    /// Its mobility, with all contacts on its vertices counted \[1/kg\].
    yields: f64,
    impulse: Vector3<f64>,
}

impl EngineSoftMethod {
    fn body(&self) -> Result<&SoftBody, String> {
        self.world.soft_bodies.get(self.handle).ok_or_else(|| "the engine has lost it".into())
    }

    /// Updates the vertices that jaws hold.
    fn lead(&mut self, site: &StepContext<'_>) -> Result<(), String> {
        let wanted: Vec<u32> = site.driven.iter().map(|driven| driven.vertex).collect();
        if wanted == self.driven {
            return Ok(());
        }
        let body = self.world.soft_bodies.get_mut(self.handle).ok_or("the engine has lost it")?;
        for &vertex in self.driven.iter().filter(|vertex| wanted.binary_search(vertex).is_err()) {
            body.set_particle_pinned(vertex as usize, false);
        }
        for &vertex in wanted.iter().filter(|vertex| self.driven.binary_search(vertex).is_err()) {
            body.set_particle_pinned(vertex as usize, true);
        }
        self.driven = wanted;
        Ok(())
    }

    /// The mobility of each contact; contacts that share a vertex share its mobility.
    fn pressed(&self, touches: &[RodContact]) -> Vec<ActiveContact> {
        let is_free =
            |node: &u32| self.pinned.binary_search(node).is_err() && self.driven.binary_search(node).is_err();
        let mut shared = std::collections::BTreeMap::<u32, f64>::new();
        for (node, _) in touches.iter().flat_map(joint) {
            *shared.entry(node).or_default() += 1.0;
        }
        let of = |touch: &RodContact| {
            let free = joint(touch).filter(|(node, _)| is_free(node));
            let yields = free.map(|(node, share)| shared[&node] * share * share / self.masses[node as usize]);
            ActiveContact { touched: self.place(touch), yields: yields.sum(), impulse: Vector3::zeros() }
        };
        touches.iter().map(of).collect()
    }

    /// Pins vertices that contacts lead, or frees them.
    fn pin_led(&mut self, led: &[LedVertex], pins: impl Fn(&LedVertex) -> bool) -> Result<(), String> {
        let body = self.world.soft_bodies.get_mut(self.handle).ok_or("the engine has lost it")?;
        led.iter().for_each(|led| body.set_particle_pinned(led.vertex as usize, pins(led)));
        Ok(())
    }

    /// Calls `each` with the force of each element at these vertices (ascending), and the place among them \[N\].
    fn element_forces(&self, held: &[u32], mut each: impl FnMut(usize, Vector3<f64>)) {
        let EngineSoftBody { young_modulus, poisson_ratio, .. } = self.kind;
        let mu = 0.5 * young_modulus / (1.0 + poisson_ratio);
        let lambda = 2.0 * mu * poisson_ratio / (1.0 - 2.0 * poisson_ratio);
        for (index, tet) in self.mesh.tets().iter().enumerate() {
            if !tet.iter().any(|node| held.binary_search(node).is_ok()) {
                continue;
            }
            let gradients = self.mesh.gradients(index);
            let mut deformation = Matrix3::zeros();
            for (node, gradient) in tet.iter().zip(&gradients) {
                deformation += self.positions[*node as usize].coords * gradient.transpose();
            }
            let Some(inverse) = deformation.try_inverse() else { continue };
            let jacobian = deformation.determinant().max(1e-3);
            let stress = cauchy_stress([lambda, mu], &deformation) * inverse.transpose() * jacobian;
            for (node, gradient) in tet.iter().zip(&gradients) {
                if let Ok(place) = held.binary_search(node) {
                    each(place, stress * gradient * -self.mesh.volumes()[index]);
                }
            }
        }
    }

    fn place(&self, touch: &RodContact) -> Vector3<f64> {
        joint(touch).map(|(node, share)| self.positions[node as usize].coords * share).sum()
    }

    /// Force of a contact \[N\] in a substep of `h` seconds that begins `since` seconds into the step.
    fn force(&self, touch: &RodContact, pressed: &ActiveContact, since: f64, h: f64) -> Vector3<f64> {
        let EngineSoftBody { contact_stiffness, friction, .. } = self.kind;
        let slip: Vector3<f64> =
            joint(touch).map(|(node, share)| self.velocities[node as usize] * share).sum::<Vector3<f64>>()
                - touch.velocity;
        let way = self.place(touch) - pressed.touched - touch.velocity * since;
        let (depth, speed) = (touch.depth - touch.normal.dot(&way), touch.normal.dot(&slip));
        // The spring force at the end of the substep, its own effect on the motion included (implicit).
        let push =
            contact_stiffness * (depth - h * speed) / (1.0 + contact_stiffness * h * h * pressed.yields);
        let push = push.max(0.0);
        if pressed.yields == 0.0 {
            return touch.normal * push;
        }
        let across = (touch.normal * speed - slip) / (h * pressed.yields);
        let (size, most) = (across.norm(), friction * push);
        touch.normal * push + if size > most { across * (most / size) } else { across }
    }

    /// After a substep of `h` \[s\] under these loads \[N\]: what the led vertices took that had these velocities before.
    fn end_led(
        &self,
        led: &mut [LedVertex],
        was: &[Vector3<f64>],
        loads: &[(u32, Vector3<f64>)],
        (rigid, moving): (&RigidPresses<'_>, &mut [RigidMotion]),
        h: f64,
    ) {
        if led.is_empty() {
            return;
        }
        let vertices: Vec<u32> = led.iter().map(|led| led.vertex).collect();
        let gravity = vector_from_rapier(self.world.gravity);
        let change = |(&vertex, was): (&u32, &Vector3<f64>)| {
            ((self.velocities[vertex as usize] - was) / h - gravity) * self.masses[vertex as usize]
        };
        let mut reactions: Vec<Vector3<f64>> = vertices.iter().zip(was).map(change).collect();
        self.element_forces(&vertices, |place, force| reactions[place] -= force);
        for (vertex, load) in loads {
            if let Ok(place) = vertices.binary_search(vertex) {
                reactions[place] -= load;
            }
        }
        for (led, reaction) in led.iter_mut().zip(&reactions) {
            let contact = &rigid.contacts[led.contact];
            let at = &self.positions[led.vertex as usize];
            led.end(contact, &mut moving[contact.body as usize], (at, reaction), h);
        }
    }

    /// A substep under these forces \[N\], with held vertices led to these places \[m\].
    fn part_under(
        &mut self,
        loads: &[(u32, Vector3<f64>)],
        held: &[(u32, Point3<f64>)],
    ) -> Result<(), String> {
        let body = self.world.soft_bodies.get_mut(self.handle).ok_or("the engine has lost it")?;
        body.reset_forces(false);
        for &(node, force) in loads {
            body.add_particle_force(node as usize, vector_to_rapier(&force), false);
        }
        for (vertex, target) in held {
            body.set_particle_kinematic_target(*vertex as usize, vector_to_rapier(&target.coords));
        }
        self.part()
    }

    /// After a tried substep: what needs more force than its jaws bear is stepped again, free and under as much of that
    /// force as there is.
    fn slip(
        &mut self,
        jaws: &mut SlippingJaws,
        site: &StepContext<'_>,
        (h, loads): (f64, &mut Vec<(u32, Vector3<f64>)>),
    ) -> Result<(), String> {
        let reactions: Vec<(u32, usize, Vector3<f64>)> = site
            .driven
            .iter()
            .filter(|driven| site.grip_limits[driven.grip as usize].is_finite())
            .map(|driven| {
                let node = driven.vertex as usize;
                let change = (self.velocities[node] - jaws.before.1[node]) / h;
                let pull = self.pull_by(&[driven.vertex]);
                (driven.vertex, driven.grip as usize, change * self.masses[node] - pull)
            })
            .collect();
        let mut sums = vec![Vector3::zeros(); site.grip_limits.len()];
        reactions.iter().for_each(|(_, grip, force)| sums[*grip] += force);
        let share = |grip: usize| GripForce::share(&sums[grip], site.grip_limits[grip]);
        for (grip, (by, sum)) in self.grips.iter_mut().zip(&sums).enumerate() {
            by.force += sum * (share(grip) * h);
            by.slipped |= share(grip) < 1.0;
        }
        let slips: Vec<bool> = (0..sums.len()).map(|grip| share(grip) < 1.0).collect();
        if slips.contains(&true) {
            let free = |vertex: u32| {
                let place = site.driven.binary_search_by_key(&vertex, |driven| driven.vertex);
                place.is_ok_and(|place| slips[site.driven[place].grip as usize])
            };
            let body = self.world.soft_bodies.get_mut(self.handle).ok_or("the engine has lost it")?;
            let (positions, velocities) = &jaws.before;
            for (index, (position, velocity)) in positions.iter().zip(velocities).enumerate() {
                let vertex = index as u32;
                if free(vertex) {
                    body.set_particle_pinned(index, false);
                }
                body.set_particle_position(index, vector_to_rapier(&position.coords));
                if self.pinned.binary_search(&vertex).is_ok() {
                    body.set_particle_kinematic_target(index, vector_to_rapier(&position.coords));
                } else {
                    body.set_particle_velocity(index, vector_to_rapier(velocity));
                }
            }
            let slipping = reactions.iter().filter(|(_, grip, _)| slips[*grip]);
            loads.extend(slipping.map(|&(vertex, grip, force)| (vertex, force * share(grip))));
            let held: Vec<(u32, Point3<f64>)> =
                jaws.held.iter().filter(|(vertex, _)| !free(*vertex)).copied().collect();
            self.part_under(loads, &held)?;
            let body = self.world.soft_bodies.get_mut(self.handle).ok_or("the engine has lost it")?;
            let all = jaws.held.iter().zip(&mut jaws.from);
            for ((vertex, place), (_, slipped)) in all.filter(|((vertex, _), _)| free(*vertex)) {
                body.set_particle_pinned(*vertex as usize, true);
                *slipped += self.positions[*vertex as usize] - place;
            }
        }
        jaws.before = (self.positions.clone(), self.velocities.clone());
        Ok(())
    }

    /// One substep. A non-finite result is discarded.
    fn part(&mut self) -> Result<(), String> {
        self.world.step();
        let quarantined = !self.world.physics_pipeline.quarantine().is_empty();
        let body = self.body()?;
        if quarantined || !body.is_enabled() {
            return Err("the engine's solver came to a state that is not finite".into());
        }
        let (positions, velocities) = (body.particle_positions(), body.particle_velocities());
        let (positions, velocities): (Vec<_>, Vec<_>) =
            (positions.map(point_from_rapier).collect(), velocities.map(vector_from_rapier).collect());
        let is_finite = |p: &Point3<f64>| p.iter().all(|x| x.is_finite());
        if !positions.iter().all(is_finite) || !velocities.iter().all(|v| v.iter().all(|x| x.is_finite())) {
            return Err("the engine's solver came to a state that is not finite".into());
        }
        (self.positions, self.velocities) = (positions, velocities);
        Ok(())
    }
}

/// Vertices that jaws hold during a step.
struct SlippingJaws {
    /// Where each is led in the substep \[m\].
    held: Vec<(u32, Point3<f64>)>,
    /// Where each was at the beginning of the step, and by how much it has slipped since \[m\].
    from: Vec<(Point3<f64>, Vector3<f64>)>,
    /// Whether the force of any of them is watched; then all places and velocities before the substep.
    watches: bool,
    before: (Vec<Point3<f64>>, Vec<Vector3<f64>>),
}

impl SlippingJaws {
    fn begin(of: &EngineSoftMethod, site: &StepContext<'_>) -> Self {
        let place = |vertex: u32| of.positions[vertex as usize];
        let watches = site.driven.iter().any(|driven| site.grip_limits[driven.grip as usize].is_finite());
        Self {
            held: site.driven.iter().map(|driven| (driven.vertex, place(driven.vertex))).collect(),
            from: site.driven.iter().map(|driven| (place(driven.vertex), Vector3::zeros())).collect(),
            watches,
            before: if watches { (of.positions.clone(), of.velocities.clone()) } else { Default::default() },
        }
    }

    /// Leads them on to a share of the step.
    fn lead(&mut self, share: f64, site: &StepContext<'_>) {
        let led = self.held.iter_mut().zip(&self.from).zip(site.driven);
        for (((_, place), (from, slipped)), driven) in led {
            *place = from + (driven.position_in_body - from) * share + slipped;
        }
    }
}

/// The vertices before a substep, with the contacts' forces on them. What the elements bore of the last push they are
/// taken to bear again: a vertex that is only seen as a free mass would seem to make way for any push, and bodies at rest
/// would sink in by several times as much as their weight presses the elements together.
struct PushedNodes<'a> {
    of: &'a EngineSoftMethod,
    h: f64,
    pushes: BTreeMap<u32, Vector3<f64>>,
}

/// What the elements bore of a push \[N\], by the change of velocity of a vertex in a substep and that by the weight alone:
/// a share of the push, from none to all of it.
fn borne_of(push: &Vector3<f64>, accelerating: &Vector3<f64>) -> Vector3<f64> {
    let size = push.norm_squared();
    if size == 0.0 {
        return Vector3::zeros();
    }
    push * (1.0 - accelerating.dot(push) / size).clamp(0.0, 1.0)
}

impl PressedNodes for PushedNodes<'_> {
    fn at_end(&self, node: u32) -> (Vector3<f64>, Vector3<f64>, f64) {
        let (index, mobility) = (node as usize, self.of.mobility[node as usize]);
        let push = self.pushes.get(&node).copied().unwrap_or_default();
        let borne = self.of.borne.get(&node).copied().unwrap_or_default();
        let velocity = self.of.velocities[index] + (push - borne) * (mobility * self.h);
        (self.of.positions[index].coords + velocity * self.h, velocity, mobility)
    }

    fn push(&mut self, node: u32, force: &Vector3<f64>) {
        *self.pushes.entry(node).or_default() += force;
    }
}

/// Nodes and weights of a contact.
fn joint(touch: &RodContact) -> impl Iterator<Item = (u32, f64)> {
    touch.nodes.into_iter().zip(touch.weights).filter(|(_, weight)| *weight != 0.0)
}

impl SoftMethod for EngineSoftMethod {
    type Kind = EngineSoftBody;
    const CONTROLLER: &'static str = "rapier-soft";

    fn build(kind: &EngineSoftBody, body: &mut Deformable, _scene: &Snapshot) -> Result<Self, String> {
        if body.tets.is_empty() {
            return Err("'engine_soft' needs a mesh of tetrahedra; of cloths the engine knows no modulus, they are for 'xpbd' \
                        or 'mass_spring'"
                .into());
        }
        let mesh =
            TetMesh::new(&body.rest, &body.tets, &MeshRules::default()).map_err(|why| why.to_string())?;
        let mut masses = vec![0.0; body.rest.len()];
        for (tet, volume) in mesh.tets().iter().zip(mesh.volumes()) {
            tet.iter().for_each(|&node| masses[node as usize] += kind.density * volume / 4.0);
        }
        // Vertices that no element uses are fixed, and need some mass.
        let least = masses.iter().copied().filter(|mass| *mass > 0.0).fold(f64::INFINITY, f64::min);
        masses.iter_mut().filter(|mass| **mass == 0.0).for_each(|mass| *mass = least);
        let mut world = PhysicsWorld::default();
        let parameters = &mut world.integration_parameters;
        parameters.length_unit = LENGTH_UNIT;
        parameters.num_solver_iterations = 1;
        parameters.soft_bodies.max_extra_substeps = 0;
        let pinned = body.staying();
        let material = SoftBodyMaterial {
            young_modulus: kind.young_modulus,
            poisson_ratio: kind.poisson_ratio,
            ..SoftBodyMaterial::default()
        };
        let builder = SoftBodyBuilder::default()
            .positions(body.rest.iter().map(|point| vector_to_rapier(&point.coords)).collect())
            .masses(masses.clone())
            .cells(body.tets.to_vec())
            .cell_model(SoftBodyCellModel::NeoHookean)
            .solver(match kind.solver {
                EngineSoftSolver::Constraints => SoftBodySolver::Constraints,
                EngineSoftSolver::FiniteElements => SoftBodySolver::Fem,
            })
            .material(material)
            .pinned_particles(pinned.iter().copied())
            .linear_damping(kind.damping)
            .additional_pgs_iterations(kind.iterations as usize - 1)
            .no_surface_collider()
            .can_sleep(false);
        let handle = world.soft_bodies.insert(builder, &mut world.bodies, &mut world.colliders);
        let made = world.soft_bodies.get_mut(handle).ok_or("the engine does not take it")?;
        if made.cells().len() != body.tets.len() {
            return Err(format!("of {} elements the engine takes {}", body.tets.len(), made.cells().len()));
        }
        for (index, (position, velocity)) in body.positions.iter().zip(body.velocities.iter()).enumerate() {
            made.set_particle_position(index, vector_to_rapier(&position.coords));
            if pinned.binary_search(&(index as u32)).is_err() {
                made.set_particle_velocity(index, vector_to_rapier(velocity));
            } else {
                made.set_particle_kinematic_target(index, vector_to_rapier(&position.coords));
            }
        }
        let (positions, velocities) = (body.positions.to_vec(), body.velocities.to_vec());
        let mut mobility: Vec<f64> = masses.iter().map(|mass| mass.recip()).collect();
        pinned.iter().for_each(|&vertex| mobility[vertex as usize] = 0.0);
        let bearing_stiffness = bearing_stiffness(kind.contact_stiffness, kind.young_modulus, body);
        Ok(Self {
            kind: *kind,
            world,
            handle,
            mesh,
            masses,
            mobility,
            bearing_stiffness,
            bearing_substep: bearing_substep(
                pressure_wave_squared(kind.young_modulus, kind.poisson_ratio, kind.density),
                body,
            ),
            pinned,
            driven: Vec::new(),
            positions,
            velocities,
            borne: BTreeMap::new(),
            grips: Vec::new(),
        })
    }

    fn positions(&self) -> &[Point3<f64>] {
        &self.positions
    }

    fn velocities(&self) -> &[Vector3<f64>] {
        &self.velocities
    }

    fn terms(&self) -> Option<ContactParams<'_>> {
        let EngineSoftBody { contact_stiffness: stiffness, friction, .. } = self.kind;
        let (masses_inverse, bearing_stiffness) = (&self.mobility[..], self.bearing_stiffness);
        Some(ContactParams {
            masses_inverse,
            stiffness,
            bearing_stiffness,
            young_modulus: self.kind.young_modulus,
            friction,
        })
    }

    fn contact_surface<'a>(&'a self, body: &'a Deformable) -> ContactSurface<'a> {
        let triangles = &body.triangles[..];
        ContactSurface { positions: &self.positions, triangles, segments: &[], thickness: 0.0, closed: true }
    }

    fn step(
        &mut self,
        _body: &Deformable,
        site: &StepContext<'_>,
        forces: &mut Vec<Vector3<f64>>,
    ) -> Result<(), String> {
        self.lead(site)?;
        let parts = if site.rigid.contacts.is_empty() {
            self.kind.parts
        } else {
            self.kind.parts.max((site.period_secs() / self.bearing_substep).ceil() as u32).min(PARTS_MAX)
        };
        let mut moving: Vec<RigidMotion> =
            site.rigid.bodies.iter().map(|body| RigidMotion::of(body, site.period_secs())).collect();
        let first = first_led(&site.rigid);
        let bearing = &site.rigid.contacts[..first];
        let began: Vec<Vector3<f64>> = bearing.iter().map(|contact| contact.place(&self.positions)).collect();
        let mut borne = vec![0.0; first];
        let mut now: Vec<f64> = bearing.iter().map(|contact| contact.force).collect();
        let is_free =
            |vertex: u32| self.mobility[vertex as usize] > 0.0 && self.driven.binary_search(&vertex).is_err();
        let mut led = led_vertices(&site.rigid, first, &self.positions, is_free);
        let h = site.period_secs() / f64::from(parts);
        self.world.integration_parameters.dt = h;
        self.world.gravity = vector_to_rapier(&site.gravity);
        let mut pressed = self.pressed(site.touches);
        let mut jaws = SlippingJaws::begin(self, site);
        self.grips.clear();
        self.grips.resize(site.grip_limits.len(), GripForce::default());
        for part in 0..parts {
            let since = f64::from(part) * h;
            let pushes: Vec<Vector3<f64>> = site
                .touches
                .iter()
                .zip(&pressed)
                .map(|(touch, of)| self.force(touch, of, since, h))
                .collect();
            let mut nodes = PushedNodes { of: self, h, pushes: BTreeMap::new() };
            press_as_before(bearing, &now, &mut moving, &mut nodes);
            press(bearing, &began, &mut now, &mut moving, h, &mut nodes);
            let mut loads: Vec<(u32, Vector3<f64>)> = site.forces.to_vec();
            for ((touch, of), push) in site.touches.iter().zip(&mut pressed).zip(&pushes) {
                of.impulse += push * h;
                loads.extend(joint(touch).map(|(node, share)| (node, push * share)));
            }
            let pushes = nodes.pushes;
            loads.extend(pushes.iter().map(|(&node, &push)| (node, push)));
            let before: Vec<Vector3<f64>> =
                pushes.keys().map(|&node| self.velocities[node as usize]).collect();
            borne.iter_mut().zip(&now).for_each(|(total, force)| *total += force * h);
            jaws.lead(f64::from(part + 1) / f64::from(parts), site);
            let own = jaws.held.len();
            self.pin_led(&led, |led| led.is_led)?;
            jaws.held.extend(led.iter().filter(|led| led.is_led).map(|led| {
                let contact = &site.rigid.contacts[led.contact];
                let at = &self.positions[led.vertex as usize];
                (led.vertex, led.goal(contact, &moving[contact.body as usize], at, h))
            }));
            let was: Vec<Vector3<f64>> = led.iter().map(|led| self.velocities[led.vertex as usize]).collect();
            self.part_under(&loads, &jaws.held)?;
            jaws.held.truncate(own);
            self.end_led(&mut led, &was, &loads, (&site.rigid, &mut moving), h);
            moving.iter_mut().for_each(|motion| motion.end(h));
            if jaws.watches {
                self.slip(&mut jaws, site, (h, &mut loads))?;
            }
            self.borne.clear();
            for ((node, push), before) in pushes.iter().zip(before) {
                let (now, mass) = (self.velocities[*node as usize], self.masses[*node as usize]);
                let accelerating = ((now - before) / h - site.gravity) * mass;
                self.borne.insert(*node, borne_of(push, &accelerating));
            }
        }
        self.pin_led(&led, |_| false)?;
        borne.resize(site.rigid.contacts.len(), 0.0);
        led.iter().for_each(|led| borne[led.contact] += led.impulse);
        let period = site.period_secs();
        self.grips.iter_mut().for_each(|grip| grip.force /= period);
        forces.extend(pressed.iter().map(|of| of.impulse / site.period_secs()));
        let of_rigid = site.rigid.contacts.iter().zip(&borne);
        forces.extend(of_rigid.map(|(contact, impulse)| contact.normal * (impulse / site.period_secs())));
        Ok(())
    }

    fn grip_forces(&self) -> &[GripForce] {
        &self.grips
    }

    fn pull_by(&mut self, held: &[u32]) -> Vector3<f64> {
        let mut pull = Vector3::zeros();
        self.element_forces(held, |_, force| pull += force);
        let gravity = vector_from_rapier(self.world.gravity);
        pull + held.iter().map(|&node| gravity * self.masses[node as usize]).sum::<Vector3<f64>>()
    }

    fn measure(&self, body: &Deformable, measures: &mut Measures<'_>) {
        let kinetic = self.velocities.iter().zip(&self.masses).map(|(v, mass)| 0.5 * mass * v.norm_squared());
        measures.put("kinetic_energy_j", kinetic.sum());
        let moved = self.positions.iter().zip(body.rest.iter()).map(|(now, rest)| (now - rest).norm());
        measures.put("displacement_max_m", moved.fold(0.0, f64::max));
        let heights = || self.positions.iter().map(|position| position.z);
        measures.put("lowest_m", heights().fold(f64::INFINITY, f64::min));
        measures.put("highest_m", heights().fold(f64::NEG_INFINITY, f64::max));
    }
}

/// Steps every body that carries [`EngineSoftBody`].
pub type EngineSoftController = SoftController<EngineSoftMethod>;
