//! The controller of vessels: cuts and burns open them, jaws clamp them, coagulation of the tissue around the hole
//! seals them. The blood loss is published as a cumulative volume, from which the liquid and the patient take the
//! difference.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_dynamics::soft_body::frozen::{FrozenPart, RejectedBody, freeze};
use trocar_dynamics::soft_body::jaws::holds;
use trocar_scene::{
    Access, BuildContext, Commands, Component, ComponentError, Controller, ControllerError, Entity,
    EntitySet, Frozen, Instrument, JawState, LineMesh, Measured, Pose, RecordPolicy, RestPositions, Snapshot,
    Temperature, TetMesh, Tick, VertexPositions,
};

use super::vital_signs::PatientState;
use crate::controller::cutting::scissors::{Blades, swept};
use crate::controller::cutting::volume::VolumeCuts;
use crate::controller::electrosurgery::HeatState;
use crate::controller::thermal_damage::RemovedElements;
use crate::electrosurgery::BODY;
use crate::fluid::bleeding::{Bleeding, BleedingState, Vessel as Pipe};
use crate::fluid::clamp::{Jaws, Tube};
use crate::fluid::{Hole, vessel_cut};

/// Tissue farther from the hole than this does not heat it \[m\].
const HEAT_REACH: f64 = 0.01;
/// A vertex beyond that is invalid \[m\].
const FAR: f64 = 1e3;
/// Number of vertices whose temperatures are averaged at the hole.
const HEATERS: usize = 4;

/// A blood vessel: a line from its source (the first vertex) to its end.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "vessel", check = Self::ranges, schema)]
#[serde(default, deny_unknown_fields)]
pub struct Vessel {
    /// Inner radius \[m\].
    pub radius: f64,
    /// Wall thickness \[m\].
    pub wall: f64,
    /// Length of the vessel between the patient's pressure and the first vertex \[m\].
    pub before: f64,
    /// Source pressure, as a fraction between mean venous (0) and arterial pressure (1).
    pub arterial: f64,
    /// Initial hole, as a fraction of the cross-section.
    pub injury: f64,
    /// Position of the hole, as a fraction of the line.
    pub hole: f64,
    /// Direction of the hole, in the vessel's frame (any length); along the vessel where it is transected.
    #[schemars(with = "[f64; 3]")]
    pub outwards: Vector3<f64>,
    /// The tissue around it: what burns there burns the vessel.
    #[schemars(with = "Option<String>")]
    pub tissue: Option<Entity>,
}

impl Default for Vessel {
    /// A cystic artery.
    fn default() -> Self {
        Self {
            radius: 0.8e-3,
            wall: 0.2e-3,
            before: 0.03,
            arterial: 1.0,
            injury: 0.0,
            hole: 1.0,
            outwards: Vector3::z(),
            tissue: None,
        }
    }
}

impl Vessel {
    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("radius", self.radius, 1e-5..=0.02, "1e-5 to 0.02 m")?;
        ComponentError::range("wall", self.wall, 0.0..=0.01, "0 to 0.01 m")?;
        ComponentError::range("before", self.before, 0.0..=0.5, "0 to 0.5 m")?;
        for (name, share) in [("arterial", self.arterial), ("injury", self.injury), ("hole", self.hole)] {
            ComponentError::range(name, share, 0.0..=1.0, "0 to 1")?;
        }
        ComponentError::range("outwards", self.outwards.norm(), 1e-6..=1e6, "a direction")
    }
}

/// State of a vessel: injury and blood loss.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "vessel_state", record = RecordPolicy::sampled(10.0, 1e-10))]
pub struct VesselState {
    /// The wound, and the cumulative blood loss.
    pub bleeding: BleedingState,
    /// Position of the hole, as a fraction of the line.
    pub hole: f64,
    /// The hole, in the vessel's frame.
    pub place: Point3<f64>,
    /// Direction of the hole, in the vessel's frame.
    pub outwards: Vector3<f64>,
    /// Area of the hole \[m²\].
    pub area: f64,
    /// Current blood loss rate \[m³/s\].
    pub rate: f64,
    /// Number of removed tissue elements that have been processed.
    pub burned: u32,
    /// Previous blades of all scissors, in the vessel's frame.
    pub blades: Vec<Blades>,
}

impl VesselState {
    /// The hole, in another frame than the vessel's.
    #[must_use]
    pub fn hole_in(&self, frame_from_vessel: &Isometry3<f64>) -> Hole {
        Hole {
            place: frame_from_vessel * self.place,
            outwards: frame_from_vessel * self.outwards,
            area: self.area,
        }
    }
}

struct Body {
    entity: Entity,
    name: String,
    vessel: Vessel,
    bleeding: Bleeding,
    state: VesselState,
    line: Vec<Point3<f64>>,
    frozen: bool,
}

/// Simulates the bleeding of every vessel.
pub struct BleedingController {
    vessels: Vec<Body>,
    refused: Vec<RejectedBody>,
}

fn length(line: &[Point3<f64>]) -> f64 {
    line.windows(2).map(|ends| (ends[1] - ends[0]).norm()).sum()
}

/// The point at a fraction of a line, the line's direction there, and the number of vertices before it.
fn along(line: &[Point3<f64>], share: f64) -> Option<(Point3<f64>, Vector3<f64>, usize)> {
    let mut left = share * length(line);
    for (index, ends) in line.windows(2).enumerate() {
        let run = ends[1] - ends[0];
        let size = run.norm();
        if size > 0.0 && (left <= size || index + 2 == line.len()) {
            return Some((ends[0] + run * (left / size).min(1.0), run / size, index + 1));
        }
        left -= size;
    }
    None
}

impl Body {
    fn read(scene: &Snapshot, entity: Entity, vessel: Vessel) -> Result<Self, ControllerError> {
        let name = scene.name(entity);
        let wrong = |what: &str| ControllerError::Scene(format!("'{name}': {what}"));
        let is_chain = scene.get::<LineMesh>(entity).is_some_and(|line| {
            line.segments.iter().zip(0..).all(|(segment, index): (_, u32)| *segment == [index, index + 1])
        });
        let mut line = Vec::new();
        read_line(scene, entity, &mut line);
        let Some((place, direction, _)) = along(&line, vessel.hole).filter(|_| is_chain) else {
            return Err(wrong("a 'vessel' needs a line, from its source on: mesh = { line = … }"));
        };
        let pipe = Pipe {
            radius: vessel.radius,
            length: vessel.before + vessel.hole * length(&line),
            arterial: vessel.arterial,
        };
        let known = scene.get::<VesselState>(entity).cloned();
        let state = known.unwrap_or_else(|| VesselState {
            bleeding: BleedingState { damage: vessel.injury, ..BleedingState::default() },
            hole: vessel.hole,
            place,
            outwards: if vessel.injury < 1.0 { vessel.outwards } else { direction },
            area: 0.0,
            rate: 0.0,
            burned: 0,
            blades: Vec::new(),
        });
        let bleeding = Bleeding::restore(pipe, state.bleeding).map_err(|error| wrong(&error.to_string()))?;
        let frozen = scene.get::<Frozen>(entity).is_some();
        Ok(Self { entity, vessel, bleeding, state, line, name, frozen })
    }

    /// Transects the vessel at the first cut by closing blades, or by the sweep of closed ones.
    fn cut(&mut self, scene: &Snapshot, world_from_body: &Isometry3<f64>) {
        let whole = length(&self.line);
        for sweep in swept(&mut self.state.blades, scene, world_from_body) {
            let cut = vessel_cut::first_crossing(&self.line, &sweep).map(|at| at / whole);
            // Beyond an existing transection no blood is lost.
            if let Some(hole) = cut.filter(|at| self.state.bleeding.damage < 1.0 || *at < self.state.hole) {
                self.bleeding.sever();
                self.state.bleeding = *self.bleeding.state();
                self.state.hole = hole;
            }
        }
    }

    /// Opens the wall where the tissue around it was removed.
    fn perforate(&mut self, scene: &Snapshot, tissue: Entity, body_from_tissue: &Isometry3<f64>) {
        let (Some(gone), Some(rest)) = (scene.get::<RemovedElements>(tissue), rest_of(scene, tissue)) else {
            return;
        };
        let first = (self.state.burned as usize).min(gone.elements.len());
        if first == gone.elements.len() {
            return;
        }
        let elements = FirstElements::read(scene, tissue);
        let reach = self.vessel.radius + self.vessel.wall;
        let section = std::f64::consts::PI * self.vessel.radius.powi(2);
        for &element in &gone.elements[first..] {
            let corners = elements.corners(element as usize);
            let places: Vec<Point3<f64>> = corners
                .iter()
                .filter_map(|node| rest.get(*node as usize))
                .map(|p| body_from_tissue * p)
                .collect();
            let Some((middle, area)) = vessel_cut::middle_and_section(&places) else { continue };
            let (distance, at) = vessel_cut::nearest_on_line(&self.line, &middle);
            if distance > reach {
                continue;
            }
            let at = at / length(&self.line);
            let damage = self.bleeding.state().damage;
            if damage == 0.0 || at < self.state.hole {
                self.state.hole = at;
            }
            self.bleeding.injure(damage + area / section);
        }
        self.state.burned = gone.elements.len() as u32;
    }

    /// Tissue temperature at the hole \[°C\].
    fn heat_at_hole(&self, scene: &Snapshot, tissue: Entity, body_from_tissue: &Isometry3<f64>) -> f64 {
        let (Some(heat), Some(vertices)) =
            (scene.get::<Temperature>(tissue), scene.get::<VertexPositions>(tissue))
        else {
            return BODY;
        };
        let hole = body_from_tissue.inverse() * self.state.place;
        let mut nearest: Vec<(f64, f64)> = Vec::new();
        for (place, celsius) in vertices.positions.iter().zip(heat.celsius.iter()) {
            let distance = (place - hole).norm();
            let at = nearest.partition_point(|(known, _)| *known <= distance);
            if distance <= HEAT_REACH && at < HEATERS {
                nearest.insert(at, (distance, *celsius));
                nearest.truncate(HEATERS);
            }
        }
        // Shepard interpolation, by inverse squared distance.
        let weight = |distance: f64| 1.0 / (distance * distance + 1e-12);
        let sum: f64 = nearest.iter().map(|(distance, _)| weight(*distance)).sum();
        let heat: f64 = nearest.iter().map(|(distance, celsius)| weight(*distance) * celsius).sum();
        if sum > 0.0 { heat / sum } else { BODY }
    }

    /// Fraction of the cross-section that jaws clamp before the hole.
    fn clamped(&self, scene: &Snapshot, world_from_body: &Isometry3<f64>, before: &[Point3<f64>]) -> f64 {
        let tube = Tube { radius: self.vessel.radius, wall: self.vessel.wall };
        let mut closed: f64 = 0.0;
        for (entity, instrument) in scene.iter::<Instrument>() {
            if !holds(instrument.kind) || instrument.jaws < 2 {
                continue;
            }
            let angle = scene.get::<JawState>(entity).map_or(instrument.jaw_angle_max, |jaws| jaws.angle);
            let jaws = Jaws { length: instrument.jaw_length, width: instrument.jaw_width, angle };
            let jaws_from_body = scene.world_pose(entity).inverse() * world_from_body;
            closed = closed.max(jaws.closed_share(&jaws_from_body, before, &tube));
        }
        closed
    }

    /// One step; if it fails, the vessel keeps its state.
    fn step(&mut self, dt: f64, scene: &Snapshot, pressures: (f64, f64)) -> Result<(), String> {
        let (state, bleeding) = (self.state.clone(), self.bleeding.clone());
        let done = self.stepped(dt, scene, pressures).and_then(|()| self.is_finite());
        if done.is_err() {
            (self.state, self.bleeding) = (state, bleeding);
        }
        done
    }

    fn is_finite(&self) -> Result<(), String> {
        let VesselState { bleeding, hole, place, outwards, area, rate, .. } = &self.state;
        let numbers = [*hole, *area, *rate, bleeding.lost, bleeding.damage, bleeding.clamped];
        let all = numbers.iter().chain(place.iter()).chain(outwards.iter()).all(|x| x.is_finite());
        all.then_some(()).ok_or_else(|| "its hole came to a place or a rate that is no finite number".into())
    }

    fn stepped(&mut self, dt: f64, scene: &Snapshot, pressures: (f64, f64)) -> Result<(), String> {
        read_line(scene, self.entity, &mut self.line);
        if let Some(vertex) = self.line.iter().position(|at| !at.iter().all(|x| x.abs() <= FAR)) {
            return Err(format!("vertex {vertex} of its line is farther than {FAR} m away"));
        }
        let world_from_body = scene.world_pose(self.entity);
        self.cut(scene, &world_from_body);
        let tissue =
            self.vessel.tissue.map(|tissue| (tissue, world_from_body.inverse() * scene.world_pose(tissue)));
        if let Some((tissue, body_from_tissue)) = &tissue {
            self.perforate(scene, *tissue, body_from_tissue);
        }
        let Some((place, direction, vertices)) = along(&self.line, self.state.hole) else {
            return Err("its line has no length left".into());
        };
        (self.state.place, self.state.outwards) = (place, self.vessel.outwards);
        if self.bleeding.state().damage >= 1.0 {
            self.state.outwards = direction;
        }
        self.bleeding.set_length(self.vessel.before + self.state.hole * length(&self.line));
        let mut before = self.line[..vertices].to_vec();
        before.push(place);
        let clamped = self.clamped(scene, &world_from_body, &before);
        self.bleeding.clamp(clamped);
        self.state.rate = self.bleeding.rate(pressures.0, pressures.1);
        if let Some((tissue, body_from_tissue)) = &tissue {
            let celsius = self.heat_at_hole(scene, *tissue, body_from_tissue);
            self.bleeding.heat(dt, celsius, self.state.rate);
        }
        self.bleeding.step(dt, pressures.0, pressures.1).map_err(|error| error.to_string())?;
        self.state.area = self.bleeding.hole();
        self.state.bleeding = *self.bleeding.state();
        Ok(())
    }
}

fn read_line(scene: &Snapshot, entity: Entity, line: &mut Vec<Point3<f64>>) {
    if let Some(vertices) = scene.get::<VertexPositions>(entity) {
        line.clear();
        line.extend_from_slice(&vertices.positions);
    }
}

/// Rest positions of a body's vertices; the current ones if none are stored.
pub(crate) fn rest_of(scene: &Snapshot, tissue: Entity) -> Option<&[Point3<f64>]> {
    let rest = scene.get::<RestPositions>(tissue).map(|rest| &rest.positions);
    rest.or_else(|| scene.get::<VertexPositions>(tissue).map(|now| &now.positions)).map(|all| all.as_slice())
}

/// Elements numbered as in [`RemovedElements`]: those of the first mesh, whatever was cut later.
enum FirstElements {
    Tets(Arc<Vec<[u32; 4]>>),
    Triangles(Arc<Vec<[u32; 3]>>),
}

impl FirstElements {
    fn read(scene: &Snapshot, tissue: Entity) -> Self {
        let Some(volume) = scene.get::<TetMesh>(tissue) else {
            let heat = scene.get::<HeatState>(tissue);
            return Self::Triangles(heat.map(|heat| heat.triangles.clone()).unwrap_or_default());
        };
        let nodes = rest_of(scene, tissue).map_or(0, <[_]>::len);
        Self::Tets(match scene.get::<VolumeCuts>(tissue) {
            Some(cuts) => Arc::new(cuts.first_tets(nodes, &volume.tets)),
            None => volume.tets.clone(),
        })
    }

    fn corners(&self, element: usize) -> &[u32] {
        match self {
            Self::Tets(tets) => tets.get(element).map_or(&[], |tet| &tet[..]),
            Self::Triangles(triangles) => triangles.get(element).map_or(&[], |triangle| &triangle[..]),
        }
    }
}

impl BleedingController {
    /// Reads the vessels, and resumes their state from the scene.
    ///
    /// # Errors
    /// The name of the vessel, and what is wrong with it.
    pub fn new(context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let (mut vessels, mut refused) = (Vec::new(), Vec::new());
        for (entity, vessel) in context.scene.iter::<Vessel>() {
            match Body::read(context.scene, entity, *vessel) {
                Ok(body) => vessels.push(body),
                Err(error) => refused.push(RejectedBody::of(context, entity, FrozenPart::Body, error)?),
            }
        }
        if vessels.is_empty() && refused.is_empty() {
            return Err(ControllerError::Scene("bleeding: no entity is a 'vessel'".into()));
        }
        vessels.sort_by_key(|vessel| vessel.entity);
        Ok(Self { vessels, refused })
    }
}

impl Controller for BleedingController {
    fn access(&self) -> Access {
        let refused = self.refused.iter().map(|vessel| vessel.entity);
        let vessels: Vec<Entity> = self.vessels.iter().map(|vessel| vessel.entity).chain(refused).collect();
        Access::new()
            .reads::<Vessel>()
            .reads::<LineMesh>()
            .reads::<VertexPositions>()
            .reads::<RestPositions>()
            .reads::<TetMesh>()
            .reads::<Pose>()
            .reads::<Instrument>()
            .reads::<JawState>()
            .reads::<Temperature>()
            .reads::<RemovedElements>()
            .reads::<VolumeCuts>()
            .reads::<HeatState>()
            .reads::<PatientState>()
            .reads::<Frozen>()
            .writes::<Frozen>(EntitySet::Of(vessels.clone()))
            .writes::<VesselState>(EntitySet::Of(vessels))
            .writes::<Measured>(EntitySet::Own)
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let pressures = PatientState::pressures(scene);
        let mut measured = Measured::default();
        for vessel in &mut self.vessels {
            let was_bleeding = vessel.state.rate > 0.0;
            if !vessel.frozen {
                if let Err(reason) = vessel.step(tick.period.as_secs_f64(), scene, pressures) {
                    vessel.frozen = true;
                    // A frozen vessel does not bleed: liquid and patient follow its cumulative loss.
                    vessel.state.rate = 0.0;
                    freeze(vessel.entity, FrozenPart::Body, reason, tick, out);
                }
                if was_bleeding != (vessel.state.rate > 0.0) {
                    let event = if was_bleeding { "bleeding_stopped" } else { "bleeding_began" };
                    out.event(event, vessel.entity, None, vessel.state.rate);
                }
                out.put(vessel.entity, vessel.state.clone());
            }
            let (state, done) = (&vessel.state, &vessel.state.bleeding);
            let values = [
                ("lost_m3", done.lost),
                ("rate_m3_per_s", state.rate),
                ("damage_share", done.damage),
                ("clamped_share", done.clamped),
                ("coagulated_share", done.coagulated),
                ("frozen", f64::from(u8::from(vessel.frozen))),
            ];
            let named = values.into_iter().map(|(what, value)| (format!("{}.{what}", vessel.name), value));
            measured.values.extend(named);
        }
        self.refused.iter_mut().for_each(|vessel| vessel.report(tick, &mut measured, out));
        out.put(tick.me, measured);
        Ok(())
    }
}
