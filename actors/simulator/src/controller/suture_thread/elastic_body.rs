//! The elastic body that a thread is tied around: read from the scene into the thread's island, and written back.
//!
//! Thread and body are one problem in every step, so the thread's controller steps both. The body's inverse is read
//! from a cache or computed by a background job; until then neither moves.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use nalgebra::{Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_dynamics::elasticity::POISSON_MAX;
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::tet_mesh::{MeshRules, TetMesh};
use trocar_scene::{Commands, Component, ComponentError, Entity, Snapshot, Tick};

use crate::controller::linear_fem::inverse_job::{built, built_as_job};
use crate::linear_fem::{Cache, Deformation, LinearFem, Load};
use crate::suture_thread::elastic::{ElasticBody, SurfaceForce};

/// Ticks between two evaluations of the interior.
const INSIDE_EVERY: u64 = 10;
/// Reported distance of a loop without contact from its line \[m\].
const NOWHERE: f64 = 1.0;

/// A line marked around a body: the intersection of a plane with its rest surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Mark {
    /// A point of the plane, in the entity's frame \[m\].
    pub place: [f64; 3],
    /// Normal of the plane.
    pub across: [f64; 3],
}

/// An elastic body that a thread is tied around, named in [`ThreadBody`](crate::controller::ThreadBody). It needs a
/// tetrahedral mesh, and `anchors` where it is fixed. It deforms elastically for small deformations, as
/// [`LinearFemBody`](crate::controller::LinearFemBody) does, and does not move as a whole. Only that thread deforms it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "tied", check = Self::ranges, schema)]
#[serde(default, deny_unknown_fields)]
pub struct TiedBody {
    /// Young's modulus \[Pa\].
    pub young_modulus: f64,
    /// Poisson's ratio, 0 to 0.45.
    pub poisson_ratio: f64,
    /// Coulomb friction coefficient of the thread on it.
    pub friction: f64,
    /// Target line of a loop.
    pub mark: Option<Mark>,
}

impl Default for TiedBody {
    /// Silicone of Shore hardness A 30, the material of practice tubes: 1.1 MPa by Gent's relation (1958). Friction:
    /// assumed.
    fn default() -> Self {
        Self { young_modulus: 1.1e6, poisson_ratio: 0.45, friction: 0.3, mark: None }
    }
}

impl TiedBody {
    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("young_modulus", self.young_modulus, 1.0..=1e12, "1 to 1e12 Pa")?;
        ComponentError::range("poisson_ratio", self.poisson_ratio, 0.0..=POISSON_MAX, "0 to 0.45")?;
        ComponentError::range("friction", self.friction, 0.0..=10.0, "0 to 10")?;
        self.mark.map_or(Ok(()), |mark| {
            let size = Vector3::from(mark.across).norm();
            ComponentError::range("mark.across", size, 1e-6..=1e6, "a direction")
        })
    }
}

/// The elastic body, with its solver.
pub struct ElasticSupport {
    /// Its state in the scene.
    pub body: Deformable,
    /// Its component.
    pub kind: TiedBody,
    mesh: TetMesh,
    solver: Option<(LinearFem, ElasticBody)>,
    submitted: bool,
    progress: Arc<AtomicU64>,
    positions: Vec<Point3<f64>>,
    deformation: Deformation,
    /// Whether the strain was outside the validity of linear elasticity.
    beyond: bool,
}

impl ElasticSupport {
    /// Finds it by name.
    ///
    /// # Errors
    /// There is no such body (the message lists the existing ones); or what is wrong with it.
    pub fn new(name: &str, scene: &Snapshot) -> Result<Self, String> {
        let carriers = Deformable::carriers::<TiedBody>(scene);
        let found = carriers.iter().find(|entity| scene.name(**entity) == name);
        let entity = *found.ok_or_else(|| {
            let names: Vec<String> = carriers.iter().map(|entity| scene.name(*entity)).collect();
            format!("tied_around: nothing called '{name}' has a 'tied'; valid: {}", names.join(", "))
        })?;
        let body = Deformable::read(scene, entity).map_err(|error| error.to_string())?;
        let mesh = TetMesh::new(&body.rest, &body.tets, &MeshRules::default())
            .map_err(|why| format!("tied_around '{name}': {why}"))?;
        Ok(Self {
            kind: scene.get::<TiedBody>(entity).copied().unwrap_or_default(),
            mesh,
            solver: None,
            submitted: false,
            progress: Arc::default(),
            positions: body.positions.to_vec(),
            deformation: Deformation::default(),
            beyond: false,
            body,
        })
    }

    /// The body, once its inverse is ready. It is computed by job number `key`; `presses` are the saved contact forces.
    ///
    /// # Errors
    /// Why the inverse cannot be computed.
    pub fn wait(
        &mut self,
        key: u64,
        cache: Option<&Cache>,
        presses: &[SurfaceForce],
        tick: &Tick<'_>,
    ) -> Result<bool, String> {
        if self.solver.is_some() {
            return Ok(true);
        }
        if let Some(built) = built(tick, key)? {
            let mut elastic = ElasticBody::new(&self.mesh, built.shared_compliance());
            elastic.deform(presses);
            self.solver = Some((built, elastic));
            return Ok(true);
        }
        if !self.submitted {
            let material = [self.kind.young_modulus, self.kind.poisson_ratio];
            let job =
                built_as_job(key, &self.mesh, material, &self.body.pinned, cache.cloned(), &self.progress);
            self.submitted = tick.jobs.submit(job);
        }
        Ok(false)
    }

    /// The solver's elastic body.
    #[must_use]
    pub fn elastic(&self) -> Option<&ElasticBody> {
        self.solver.as_ref().map(|(_, elastic)| elastic)
    }

    /// After a step of the thread: applies the contact forces.
    pub fn deform(&mut self, presses: &[SurfaceForce]) {
        if let Some((_, elastic)) = &mut self.solver {
            elastic.deform(presses);
        }
    }

    /// After a tick: updates the surface, and periodically the interior. Returns whether the strain has just left the
    /// validity of linear elasticity.
    ///
    /// # Errors
    /// Why the interior could not be evaluated.
    pub fn settle(&mut self, number: u64) -> Result<bool, String> {
        let Some((fem, elastic)) = &mut self.solver else { return Ok(false) };
        if number.is_multiple_of(INSIDE_EVERY) {
            let mut on_nodes: BTreeMap<u32, Vector3<f64>> = BTreeMap::new();
            for press in elastic.presses() {
                for (&node, weight) in press.at.nodes.iter().zip(press.at.weights) {
                    *on_nodes.entry(node).or_default() += press.force * weight;
                }
            }
            let is_free = |node: &u32| fem.compliance().nodes().binary_search(node).is_ok();
            on_nodes.retain(|node, _| is_free(node));
            let whole: Vec<[(u32, f64); 1]> = on_nodes.keys().map(|&node| [(node, 1.0)]).collect();
            let loads: Vec<Load<'_>> = whole
                .iter()
                .zip(on_nodes.values())
                .map(|(weights, &force)| Load { weights, force })
                .collect();
            fem.solve(&loads).map_err(|error| error.to_string())?;
            let mut moved = Vec::new();
            fem.displacements(&mut moved);
            self.deformation = Deformation::of(&self.mesh, &moved);
            for (position, (rest, moved)) in self.positions.iter_mut().zip(self.body.rest.iter().zip(&moved))
            {
                *position = rest + moved;
            }
        }
        for &node in fem.compliance().nodes() {
            self.positions[node as usize] = elastic.positions()[node as usize];
        }
        let beyond = !self.deformation.is_small();
        let new = beyond && !self.beyond;
        self.beyond = beyond;
        Ok(new)
    }

    /// Writes its state to the scene.
    pub fn write(&mut self, out: &mut Commands) {
        // Quasi-static: zero velocities.
        let still = vec![Vector3::zeros(); self.positions.len()];
        self.body.write(&self.positions, &still, out);
    }

    /// Maximum displacement of its surface \[m\].
    #[must_use]
    pub fn displacement_max(&self) -> f64 {
        let moved = self.positions.iter().zip(self.body.rest.iter()).map(|(now, rest)| (now - rest).norm());
        moved.fold(0.0, f64::max)
    }

    /// Pose of its entity.
    #[must_use]
    pub fn entity(&self) -> Entity {
        self.body.entity
    }

    /// Measures of the body, and of the loop around it; `tensions` are those of the edges in contact with it, with
    /// their forces \[N\].
    pub fn measure(
        &self,
        tensions: impl Iterator<Item = (f64, f64)>,
        frozen: bool,
        values: &mut BTreeMap<String, f64>,
    ) {
        let mut put = |what: &str, value: f64| {
            values.insert(format!("{}.{what}", self.body.name), value);
        };
        let flag = |is: bool| f64::from(u8::from(is));
        let presses = self.elastic().map_or(&[][..], ElasticBody::presses);
        let pressed: f64 = presses.iter().map(|press| press.force.norm()).sum();
        let mean = |sum: f64, none: f64| if pressed > 0.0 { sum / pressed } else { none };
        put("pressed_n", pressed);
        put("loop_tension_n", mean(tensions.map(|(tension, force)| tension * force).sum(), 0.0));
        if let Some(mark) = &self.kind.mark {
            let (place, across) = (Point3::from(mark.place), Vector3::from(mark.across).normalize());
            let off = |press: &SurfaceForce| {
                let corners = press.at.nodes.iter().zip(press.at.weights);
                let at_rest: Vector3<f64> =
                    corners.map(|(node, weight)| self.body.rest[*node as usize].coords * weight).sum();
                press.force.norm() * (at_rest - place.coords).dot(&across).abs()
            };
            put("line_off_m", mean(presses.iter().map(off).sum(), NOWHERE));
        }
        put("displacement_max_m", self.displacement_max());
        put("rotation_max_rad", self.deformation.rotation);
        // Infinite for an inverted element.
        put("strain_max", self.deformation.strain.min(1e3));
        put("beyond_linear", flag(self.beyond));
        let share = f64::from_bits(self.progress.load(Ordering::Relaxed));
        put("precomputed_share", if self.solver.is_some() { 1.0 } else { share });
        put("frozen", flag(frozen));
    }
}
