//! The controller of the bodies of masses and springs.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::{
    Access, Commands, Component, ComponentError, Entity, EntitySet, Snapshot, SurfaceMesh, TextureCoordinates,
};

use super::burning_surface::BurningSurface;
use super::cuts::Cuts;
use super::deformable::Deformable;
use super::electrosurgery::CauterisedBody;
use super::soft::{Measures, Reshaped, Site, SoftController, SoftMethod};
use super::touch::{Skin, Touch};
use crate::cutting::{Sheet, Sweep, TopologyChange};
use crate::elasticity::Alteration;
use crate::mass_spring::{
    Config, Contact, Input, Integrator, LineMaterial, LinearSolver, MassSpring, Network, Prescribed, State,
    SurfaceMaterial, TooLarge, VolumeMaterial,
};

/// Parts into which a step is divided at most.
const PARTS_MAX: u32 = 200;

/// How its springs are stepped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Symplectic Euler, in as many parts as are safe.
    #[default]
    Explicit,
    /// Backward Euler, at any step.
    Implicit,
}

/// What it is made of, by the kind of its mesh.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Springs {
    /// A thread, along its `line_mesh`.
    Line {
        /// Axial stiffness EA \[N\].
        axial_stiffness: f64,
        /// Bending stiffness EI \[N·m²\].
        bending_stiffness: f64,
        /// Mass per length \[kg/m\].
        density: f64,
    },
    /// A cloth or the wall of a tube, along its `surface_mesh`.
    Surface {
        /// Young's modulus times thickness \[N/m\].
        membrane_stiffness: f64,
        /// Flexural rigidity \[N·m\].
        bending_stiffness: f64,
        /// Mass per area \[kg/m²\].
        density: f64,
    },
    /// A volume, along its `tet_mesh`.
    Volume {
        /// Young's modulus \[Pa\].
        young_modulus: f64,
        /// Mass per volume \[kg/m³\].
        density: f64,
    },
}

impl Default for Springs {
    /// Cotton gauze, in round numbers.
    fn default() -> Self {
        Self::Surface { membrane_stiffness: 150.0, bending_stiffness: 2e-6, density: 0.05 }
    }
}

/// A body of masses and springs: it needs a mesh, and `anchors` where it is to be held.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MassSpringBody {
    /// What it is made of.
    pub springs: Springs,
    /// How it is stepped.
    pub method: Method,
    /// Damping along springs \[s\]: the time by which their force follows their lengthening.
    pub lag: f64,
    /// Damping of every motion \[1/s\].
    pub damping: f64,
    /// How far its surface is from its vertices \[m\]: half the thickness of a cloth.
    pub thickness: f64,
    /// Force per depth of a contact \[N/m\].
    pub contact_stiffness: f64,
    /// Coulomb friction against instruments.
    pub friction: f64,
    /// Of a surface: how far it is drawn, as length over length at rest, where it tears; without it nothing does.
    pub tears_at: Option<f64>,
}

impl Default for MassSpringBody {
    fn default() -> Self {
        Self {
            springs: Springs::default(),
            method: Method::Explicit,
            lag: 2e-4,
            damping: 2.0,
            thickness: 0.0005,
            contact_stiffness: 200.0,
            friction: 0.3,
            tears_at: None,
        }
    }
}

impl Component for MassSpringBody {
    const NAME: &'static str = "mass_spring";
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)?;
        ComponentError::range("lag", self.lag, 0.0..=1.0, "0 to 1 s")?;
        ComponentError::range("damping", self.damping, 0.0..=1e4, "0 to 1e4 1/s")?;
        ComponentError::range("thickness", self.thickness, 0.0..=0.1, "0 to 0.1 m")?;
        ComponentError::range("contact_stiffness", self.contact_stiffness, 0.0..=1e6, "0 to 1e6 N/m")?;
        ComponentError::range("friction", self.friction, 0.0..=10.0, "0 to 10")?;
        ComponentError::range("tears_at", self.tears_at.unwrap_or(2.0), 1.01..=100.0, "1.01 to 100")
    }
    fn schema() -> Option<serde_json::Value> {
        Some(schemars::schema_for!(Self).to_value())
    }
}

impl MassSpringBody {
    fn config(&self) -> Config {
        let integrator = match self.method {
            Method::Explicit => Integrator::Explicit { too_large: TooLarge::Divide { most: PARTS_MAX } },
            Method::Implicit => {
                // A cut changes the matrix: nothing is lost with it.
                let solver = LinearSolver::ConjugateGradients { tolerance: 1e-3, iterations_max: 100 };
                Integrator::Implicit { solver, newton: 1 }
            }
        };
        Config { integrator, lag: self.lag, damping: self.damping, ..Config::default() }
    }

    fn network(&self, body: &Deformable, altered: &[Alteration]) -> Result<Network, String> {
        let network = match self.springs {
            Springs::Line { axial_stiffness, bending_stiffness, density } => Network::from_line(
                &body.rest,
                &body.segments,
                &LineMaterial { axial_stiffness, bending_stiffness, density },
            ),
            Springs::Surface { membrane_stiffness, bending_stiffness, density } => {
                Network::from_altered_surface(
                    &body.rest,
                    &body.triangles,
                    &SurfaceMaterial { membrane_stiffness, bending_stiffness, density },
                    altered,
                    &body.loose,
                )
            }
            Springs::Volume { young_modulus, density } => {
                Network::from_volume(&body.rest, &body.tets, &VolumeMaterial { young_modulus, density })
            }
        };
        network.map_err(|error| error.to_string())
    }

    fn skin<'a>(&self, body: &'a Deformable, positions: &'a [Point3<f64>]) -> Skin<'a> {
        let is_line = matches!(self.springs, Springs::Line { .. });
        Skin {
            positions,
            triangles: if is_line { &[] } else { &body.triangles },
            segments: if is_line { &body.segments } else { &[] },
            thickness: if is_line { body.radius } else { self.thickness },
            closed: matches!(self.springs, Springs::Volume { .. }),
        }
    }
}

/// Masses and springs of one body.
pub struct MassSpringMethod {
    kind: MassSpringBody,
    solver: MassSpring,
    contacts: Vec<Contact>,
    prescribed: Vec<Prescribed>,
    /// A surface can be cut.
    surface: Option<Surface>,
    /// Or burned.
    burning: Option<BurningSurface>,
}

/// A surface that can be cut, and what has become of it.
struct Surface {
    sheet: Sheet,
    cuts: Cuts,
    /// Areas of its pieces, the largest first \[m²\].
    areas: Vec<f64>,
    changed: bool,
}

impl Surface {
    fn new(body: &Deformable, scene: &Snapshot) -> Result<Self, String> {
        let (rest, triangles) = (body.rest.to_vec(), body.triangles.to_vec());
        let known = scene.get::<Cuts>(body.entity);
        let sheet = match known {
            Some(known) => known.sheet(rest, triangles),
            None => Sheet::new(rest, triangles),
        };
        let sheet = sheet.map_err(|error| error.to_string())?;
        let mut cuts = known.cloned().unwrap_or_default();
        cuts.take(sheet.state());
        Ok(Self { areas: areas(&sheet), sheet, cuts, changed: known.is_none() })
    }
}

/// Areas of the pieces of a sheet, the largest first \[m²\].
fn areas(sheet: &Sheet) -> Vec<f64> {
    let mut areas: BTreeMap<u32, f64> = BTreeMap::new();
    for (piece, corners) in sheet.pieces().iter().zip(sheet.triangles()) {
        let [a, b, c] = corners.map(|vertex| sheet.rest()[vertex as usize]);
        *areas.entry(*piece).or_default() += 0.5 * (b - a).cross(&(c - a)).norm();
    }
    let mut areas: Vec<f64> = areas.into_values().collect();
    areas.sort_by(|a, b| b.total_cmp(a));
    areas
}

impl MassSpringMethod {
    /// Cuts where blades have swept, tears where it is drawn too far, and lets springs follow.
    fn part(&mut self, body: &mut Deformable, sweeps: &[Sweep]) -> Result<Option<TopologyChange>, String> {
        let (Some(surface), Springs::Surface { membrane_stiffness, bending_stiffness, density }) =
            (&mut self.surface, self.kind.springs)
        else {
            return Ok(None);
        };
        let (sheet, positions) = (&mut surface.sheet, &self.solver.state().positions);
        let mut change = TopologyChange::default();
        if !sweeps.is_empty() {
            change = sheet.cut(positions, sweeps).map_err(|error| error.to_string())?;
        }
        // A tear runs on from tick to tick.
        if let Some(stretch) = self.kind.tears_at.filter(|_| change.is_empty()) {
            change = sheet.tear(positions, stretch).map_err(|error| error.to_string())?;
        }
        if change.is_empty() {
            return Ok(None);
        }
        surface.cuts.length += change.length;
        surface.cuts.take(sheet.state());
        surface.areas = areas(sheet);
        let material = SurfaceMaterial { membrane_stiffness, bending_stiffness, density };
        // Whoever reads the scene anew finds the same ones.
        let anchored = |point: &Point3<f64>| body.anchors.hold(point);
        let rest = sheet.rest().iter().enumerate();
        let pinned: Vec<u32> = rest.filter(|(_, point)| anchored(point)).map(|(at, _)| at as u32).collect();
        let followed = self.solver.rebuild(&pinned, |network, state| {
            change.carry(&mut state.positions, |a, b, share| a + (b - a) * share);
            change.carry(&mut state.velocities, |a, b, share| a + (b - a) * share);
            let about = |vertex| sheet.about(vertex);
            network.update_surface(sheet.rest(), sheet.triangles(), &material, &change.stale, about)
        });
        followed.map_err(|error| error.to_string())?;
        body.pinned = pinned;
        body.rest = Arc::new(sheet.rest().to_vec());
        body.triangles = Arc::new(sheet.triangles().to_vec());
        Ok(Some(change))
    }

    fn contact(&self, touch: &Touch) -> Contact {
        Contact {
            nodes: touch.nodes,
            weights: touch.weights,
            normal: touch.normal,
            depth: touch.depth,
            velocity: touch.velocity,
            stiffness: self.kind.contact_stiffness,
            damping: 0.0,
            friction: self.kind.friction,
        }
    }
}

impl SoftMethod for MassSpringMethod {
    type Kind = MassSpringBody;
    const CONTROLLER: &'static str = "mass-spring";

    fn build(kind: &MassSpringBody, body: &mut Deformable, scene: &Snapshot) -> Result<Self, String> {
        let burning = match kind.springs {
            Springs::Surface { .. } => BurningSurface::new(body, scene)?,
            _ if scene.get::<CauterisedBody>(body.entity).is_some() => {
                return Err("'mass_spring' burns as a surface only: 'xpbd', 'dynamic_fem' and 'linear_fem' as volumes".into());
            }
            _ => None,
        };
        if kind.tears_at.is_some() && (burning.is_some() || !matches!(kind.springs, Springs::Surface { .. }))
        {
            return Err(
                "'tears_at' is of surfaces that nothing burns: volumes of 'xpbd' and 'dynamic_fem' tear by \
                        'strength'"
                    .into(),
            );
        }
        let altered = burning.as_ref().map(BurningSurface::altered).unwrap_or_default();
        let network = kind.network(body, &altered)?;
        let state = State { positions: body.positions.to_vec(), velocities: body.velocities.to_vec() };
        let solver = MassSpring::restore(network, state, &body.staying(), kind.config())
            .map_err(|error| error.to_string())?;
        let surface = match kind.springs {
            Springs::Surface { .. } if burning.is_none() => Some(Surface::new(body, scene)?),
            _ => None,
        };
        Ok(Self { kind: *kind, solver, contacts: Vec::new(), prescribed: Vec::new(), surface, burning })
    }

    fn access(access: Access, bodies: &[Entity]) -> Access {
        let all = || EntitySet::Of(bodies.to_vec());
        BurningSurface::access(access, bodies).writes::<Cuts>(all()).writes::<TextureCoordinates>(all())
    }

    fn positions(&self) -> &[Point3<f64>] {
        &self.solver.state().positions
    }

    fn velocities(&self) -> &[Vector3<f64>] {
        &self.solver.state().velocities
    }

    fn skin<'a>(&'a self, body: &'a Deformable) -> Skin<'a> {
        self.kind.skin(body, self.positions())
    }

    fn is_cut_by_blades(&self) -> bool {
        self.surface.is_some()
    }

    fn reshape(
        &mut self,
        body: &mut Deformable,
        site: &Site<'_>,
        out: &mut Commands,
    ) -> Result<Option<Reshaped>, String> {
        if let Some(burning) = &mut self.burning {
            let (changed, reshaped) = burning.burn(body, site, out);
            if changed {
                let network = self.kind.network(body, &burning.altered())?;
                self.solver
                    .rebuild(&body.staying(), |old, _| {
                        *old = network;
                        Ok(())
                    })
                    .map_err(|error| error.to_string())?;
            }
            return Ok(reshaped);
        }
        let Some(surface) = &mut self.surface else { return Ok(None) };
        let had_blades = !surface.cuts.blades.is_empty();
        let sweeps = surface.cuts.sweeps(site.scene, site.world_from_body);
        surface.changed |= had_blades || !surface.cuts.blades.is_empty();
        let vertices = body.rest.len();
        let Some(change) = self.part(body, &sweeps)? else { return Ok(None) };
        if let Some(texture) = site.scene.get::<TextureCoordinates>(body.entity) {
            let mut uv = texture.uv.to_vec();
            if uv.len() == vertices {
                change.carry(&mut uv, |a, b, share| a + (b - a) * share);
            }
            out.put(body.entity, TextureCoordinates { uv: Arc::new(uv) });
        }
        body.changed_topology();
        out.put(body.entity, SurfaceMesh { triangles: body.triangles.clone() });
        Ok(Some(Reshaped { kept: None, parents: change.triangles }))
    }

    fn step(
        &mut self,
        _body: &Deformable,
        site: &Site<'_>,
        forces: &mut Vec<Vector3<f64>>,
    ) -> Result<(), String> {
        let mut contacts = std::mem::take(&mut self.contacts);
        contacts.clear();
        contacts.extend(site.touches.iter().map(|touch| self.contact(touch)));
        self.contacts = contacts;
        self.prescribed.clear();
        let led = site.led.iter().map(|led| Prescribed { node: led.vertex, position: led.position_in_world });
        self.prescribed.extend(led);
        let input = Input {
            gravity: site.gravity,
            contacts: &self.contacts,
            prescribed: &self.prescribed,
            ..Input::default()
        };
        self.solver.step(site.period_secs(), &input).map_err(|error| error.to_string())?;
        forces.clear();
        forces.extend_from_slice(self.solver.contact_forces());
        Ok(())
    }

    fn pull_by(&mut self, held: &[u32]) -> Vector3<f64> {
        self.solver.pull_on(held)
    }

    fn publish(&mut self, body: &Deformable, out: &mut Commands) {
        if let Some(surface) = self.surface.as_mut().filter(|surface| surface.changed) {
            out.put(body.entity, surface.cuts.clone());
            surface.changed = false;
        }
    }

    fn measure(&self, _body: &Deformable, measures: &mut Measures<'_>) {
        measures.put("elastic_energy_j", self.solver.elastic_energy());
        measures.put("kinetic_energy_j", self.solver.kinetic_energy());
        let heights = || self.positions().iter().map(|position| position.z);
        measures.put("lowest_m", heights().fold(f64::INFINITY, f64::min));
        measures.put("highest_m", heights().fold(f64::NEG_INFINITY, f64::max));
        if let Some(surface) = &self.surface {
            measures.put("pieces", surface.areas.len() as f64);
            measures.put("cut_area_m2", surface.areas.get(1).copied().unwrap_or(0.0));
            measures.put("cut_length_m", surface.cuts.length);
        }
    }
}

/// Steps every body that carries [`MassSpringBody`].
pub type MassSpringController = SoftController<MassSpringMethod>;
