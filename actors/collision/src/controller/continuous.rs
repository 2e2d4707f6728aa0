//! Controller of continuous collision detection: surfaces and lines swept between two ticks, so that fast objects do
//! not tunnel through thin ones.
//!
//! An impact is instantaneous: the next step begins on the other side, without contact. So an impact is *held* as a
//! contact until the two parts are back on their sides, with its current depth. Held impacts are written into the
//! scene, so that the controller's next life continues them. Motion while no controller runs is not swept.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::components::{Detection, LineMesh, Primitive};
use trocar_scene::{
    Access, BuildContext, Commands, Component, Controller, ControllerError, EntitySet, RecordPolicy,
    Snapshot, Tick,
};

use super::bodies::{self, Body, Change, RequiredGeometry};
use super::report::{self, FoundContact, Report, primitive};
use crate::continuous::{FoundImpact, ImpactFinder, SweptLine, SweptSurface};
use crate::{Line, Part, Surface};

/// Most held impacts; later ones are dropped.
const HELD_MAX: usize = 256;

/// Configuration: pairs of bodies and stiffness.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContinuousConfig {
    /// Names of two bodies each; the first one may be a line: a needle, a thread, a band. The same name twice means
    /// self-collision.
    pub pairs: Vec<[String; 2]>,
    /// Total stiffness of a pair of bodies, shared by its contacts \[N/m\].
    #[serde(default = "report::stiffness")]
    pub stiffness: f64,
}

/// A held impact: two parts that have met, and are not yet back on their sides.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeldImpact {
    /// Index of the pair of bodies.
    pub pair: u32,
    /// The parts.
    pub parts: [Primitive; 2],
    /// The vertices of each; the second of a repeated vertex has no weight.
    pub corners: [[u32; 3]; 2],
    /// Weights of the points that met.
    pub weights: [[f64; 3]; 2],
    /// Unit direction from the first to the second when they met, in world.
    pub normal_in_world: Vector3<f64>,
}

/// Held impacts of a controller of continuous detection; on its own entity.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "held_impacts", record = RecordPolicy::sampled(10.0, 1e-5))]
pub struct HeldImpacts {
    /// In the order in which they met.
    pub held: Vec<HeldImpact>,
}

/// A body with its vertices at the last tick and now, in world.
struct SweptBody {
    body: Body,
    before: Vec<Point3<f64>>,
    now: Vec<Point3<f64>>,
}

impl SweptBody {
    fn new(
        context: &BuildContext<'_>,
        name: &str,
        wanted: RequiredGeometry,
    ) -> Result<Self, ControllerError> {
        let body = Body::named(context, name, wanted)?;
        let mut moved = Self { body, before: Vec::new(), now: Vec::new() };
        moved.place();
        moved.before.clone_from(&moved.now);
        Ok(moved)
    }

    fn place(&mut self) {
        let pose = self.body.pose;
        self.now.clear();
        self.now.extend(self.body.vertices().iter().map(|vertex| pose * vertex));
    }

    /// Reads it again; returns whether it was replaced, so that its motion is unknown.
    fn follow(&mut self, scene: &Snapshot, out: &mut Commands) -> bool {
        std::mem::swap(&mut self.before, &mut self.now);
        let change = self.body.follow(scene, out);
        self.place();
        let other = matches!(change, Change::Remeshed | Change::Absent);
        if other {
            self.before.clone_from(&self.now);
        }
        other
    }

    /// Its swept triangles.
    fn surface(&self) -> Option<SweptSurface<'_>> {
        let before = Surface::new(&self.before, self.body.surface().triangles()).ok()?;
        SweptSurface::new(before, &self.now).ok()
    }

    /// The current point of some corners with some weights.
    fn point(&self, corners: &[u32; 3], weights: &[f64; 3]) -> Option<Point3<f64>> {
        let mut point = Vector3::zeros();
        for (corner, weight) in corners.iter().zip(weights) {
            point += self.now.get(*corner as usize)?.coords * *weight;
        }
        Some(point.into())
    }
}

struct Pair {
    /// Both are the same for self-collision.
    bodies: [SweptBody; 2],
    is_self: bool,
}

impl Pair {
    /// Impacts since the last tick.
    fn look<'a>(&self, finder: &'a mut ImpactFinder) -> &'a [FoundImpact] {
        let [first, second] = &self.bodies;
        let Some(surface) = second.surface() else { return &[] };
        if self.is_self {
            return finder.surface_self(&surface, 0.0);
        }
        if let Some((segments, radius)) = first.body.segments() {
            let line = Line::new(&first.before, segments, radius);
            let line = line.and_then(|line| SweptLine::new(line, &first.now));
            return line.map_or(&[], |line| finder.line_surface(&line, &surface, 0.0));
        }
        first.surface().map_or(&[], |other| finder.surface_surface(&other, &surface, 0.0))
    }

    /// The vertices of a part of one of the bodies, in the order of its weights.
    fn corners(&self, which: usize, part: Part) -> Option<[u32; 3]> {
        let body = &self.bodies[which].body;
        Some(match part {
            Part::Vertex(vertex) => [vertex; 3],
            Part::Edge([a, b]) => [a, b, b],
            Part::Segment(index) => {
                let [a, b] = *body.segments()?.0.get(index as usize)?;
                [a, b, b]
            }
            Part::Triangle(index) => *body.surface().triangles().get(index as usize)?,
        })
    }
}

/// Finds impacts and crossings between two ticks.
pub struct ContinuousController {
    pairs: Vec<Pair>,
    finder: ImpactFinder,
    state: HeldImpacts,
    report: Report,
}

impl ContinuousController {
    /// Finds the bodies, and continues an earlier life's held impacts.
    ///
    /// # Errors
    /// A body does not exist or is invalid.
    pub fn new(config: &ContinuousConfig, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let pair = |[first, second]: &[String; 2]| {
            let is_self = first == second;
            let wanted = if is_self { RequiredGeometry::Surface } else { RequiredGeometry::SurfaceOrLine };
            let first = SweptBody::new(context, first, wanted)?;
            Ok(Pair { bodies: [first, SweptBody::new(context, second, RequiredGeometry::Surface)?], is_self })
        };
        Ok(Self {
            pairs: config.pairs.iter().map(pair).collect::<Result<_, ControllerError>>()?,
            finder: ImpactFinder::new(),
            state: context.scene.get::<HeldImpacts>(context.me).cloned().unwrap_or_default(),
            report: Report::new(Detection::Continuous, config.stiffness),
        })
    }
}

impl Controller for ContinuousController {
    fn access(&self) -> Access {
        bodies::access().reads::<LineMesh>().writes::<HeldImpacts>(EntitySet::Own)
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        self.report.begin();
        let held_before = self.state.held.len();
        let mut changed = false;
        for (index, pair) in self.pairs.iter_mut().enumerate() {
            let index = index as u32;
            let mut other = false;
            for body in &mut pair.bodies {
                other |= body.follow(scene, out);
            }
            let held = &mut self.state.held;
            if other {
                held.retain(|held| held.pair != index);
            }
            for found in pair.look(&mut self.finder) {
                let parts = [primitive(found.first), primitive(found.second)];
                let known = held.iter().any(|held| held.pair == index && held.parts == parts);
                let corners = [found.first, found.second];
                let corners = [0, 1].map(|which| pair.corners(which, corners[which]));
                if let [Some(first), Some(second)] = corners
                    && found.impact.approach > 0.0
                    && !known
                    && held.len() < HELD_MAX
                {
                    changed = true;
                    held.push(HeldImpact {
                        pair: index,
                        parts,
                        corners: [first, second],
                        weights: found.impact.weights,
                        normal_in_world: found.impact.normal,
                    });
                }
            }
            let [first, second] = &pair.bodies;
            let report = &mut self.report;
            held.retain(|held| {
                if held.pair != index {
                    return true;
                }
                let places = (
                    first.point(&held.corners[0], &held.weights[0]),
                    second.point(&held.corners[1], &held.weights[1]),
                );
                let (Some(on_first), Some(on_second)) = places else { return false };
                let depth = (on_first - on_second).dot(&held.normal_in_world);
                if depth < 0.0 {
                    return false;
                }
                report.add(FoundContact {
                    parts: [(first.body.entity, held.parts[0]), (second.body.entity, held.parts[1])],
                    on_second_in_world: on_second,
                    normal_in_world: held.normal_in_world,
                    depth,
                });
                true
            });
            self.report.end_pair();
        }
        if changed || self.state.held.len() != held_before {
            out.put(tick.me, self.state.clone());
        }
        self.report.send(scene.time(), out);
        Ok(())
    }
}
