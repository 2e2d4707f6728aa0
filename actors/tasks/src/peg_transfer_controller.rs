//! Controller of a [`PegTransfer`]: scene → observations → `TaskState` and events.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use trocar_scene::components::PEG_TRANSFER;
use trocar_scene::{
    Access, BuildContext, Camera, CollisionList, Commands, Component, Controller, ControllerError, Entity,
    EntitySet, Grasp, Parent, Pose, RecordPolicy, Side, Snapshot, TaskError, TaskState, Tick, Velocity,
};

use crate::fls_score::FlsWeights;
use crate::peg_bench::{self, BenchError, BenchPeg, BenchRings, find_hand};
use crate::peg_geometry::{FieldOfView, Peg, RingPlacement, RingShape};
use crate::peg_rules::{ErrorKind, PegTransferSetup, RingObservation, Rules, TaskEvent, TipObservation};
use crate::peg_transfer::{Outcome, PegTransfer};

/// `TaskState` is written at least every this many ticks, and whenever something happened.
const WRITE_EVERY: u64 = 10;

/// The exercise as a scenario file describes it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PegTransferConfig {
    /// The trainee's dominant hand is the left one: the right hand lifts first.
    pub left_handed: bool,
    /// Field of view: lowest and highest corner of a box in world \[m\]; without it, the scene's camera's frustum.
    pub view_box: Option<[[f64; 3]; 2]>,
    /// Thresholds of the judgement.
    pub rules: Rules,
    /// Weights of the score.
    pub weights: FlsWeights,
}

/// Restart state of the exercise, on the controller's own entity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "peg_transfer_state", record = RecordPolicy::sampled(10.0, 1e-6))]
pub struct PegTransferState {
    /// The board on which the rings started, counted in entity order.
    pub first_board: u32,
    /// The exercise.
    pub exercise: PegTransfer,
}

/// Judges a peg transfer; to be run at 100 Hz.
pub struct PegTransferController {
    setup: PegTransferSetup,
    rings: Vec<Entity>,
    /// Left, right.
    instruments: [Entity; 2],
    state: PegTransferState,
}

fn missing(what: &str) -> ControllerError {
    ControllerError::Scene(format!("peg transfer: {what}"))
}

impl PegTransferController {
    /// Finds the boards (`peg_board` shapes), the rings (dynamic `torus` shapes), the hands and the camera in the
    /// scene, and continues where an earlier life stopped.
    ///
    /// # Errors
    /// Names the missing part of the scene or the configuration.
    pub fn new(config: &PegTransferConfig, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        config.weights.validate().map_err(|error| missing(&error.to_string()))?;
        let known = |kind: &String| ErrorKind::ALL.iter().any(|known| known.as_str() == kind);
        if let Some(kind) = config.weights.secs_per_error.keys().find(|kind| !known(kind)) {
            let kinds = ErrorKind::ALL.map(ErrorKind::as_str).join(", ");
            return Err(missing(&format!("secs_per_error: no error is called '{kind}'; there are: {kinds}")));
        }
        let scene = context.scene;
        let lacks = |error: BenchError| missing(&error.to_string());
        let (rings, ring) = find_rings(scene).map_err(lacks)?;
        let pegs = find_pegs(scene).map_err(lacks)?;
        let state = match scene.get::<PegTransferState>(context.me) {
            Some(state) if state.exercise.ring_count() as usize == rings.len() => state.clone(),
            _ => {
                let first_giver = if config.left_handed { Side::Right } else { Side::Left };
                PegTransferState {
                    first_board: board_with_rings(scene, &rings, &ring, &pegs)?,
                    exercise: PegTransfer::new(rings.len(), first_giver),
                }
            }
        };
        let setup = PegTransferSetup {
            pegs,
            ring,
            first_board: state.first_board as usize,
            view: find_view(scene, config)?,
            rules: config.rules,
            weights: config.weights.clone(),
        };
        let instrument = |side| find_hand(scene, side).map(|(_, hand)| hand.instrument).map_err(lacks);
        let instruments = [instrument(Side::Left)?, instrument(Side::Right)?];
        Ok(Self { setup, rings, instruments, state })
    }

    fn observe_rings(&self, scene: &Snapshot) -> Vec<RingObservation> {
        let holds = |instrument: Entity, ring: Entity| {
            scene.get::<Grasp>(instrument).is_some_and(|grasp| grasp.held == ring)
        };
        let mut observed: Vec<RingObservation> = self
            .rings
            .iter()
            .map(|ring| RingObservation {
                placement: placement(scene, *ring),
                speed: scene.get::<Velocity>(*ring).map_or(0.0, |velocity| velocity.linear.norm()),
                held_by: self.instruments.map(|instrument| holds(instrument, *ring)),
                touched_by: [false; 2],
            })
            .collect();
        for (_, list) in scene.iter::<CollisionList>() {
            for collision in list.collisions.iter().filter(|collision| collision.depth >= 0.0) {
                for (one, other) in [(collision.a, collision.b), (collision.b, collision.a)] {
                    let hand = self.instruments.iter().position(|instrument| *instrument == one);
                    let ring = self.rings.iter().position(|ring| *ring == other);
                    if let (Some(hand), Some(ring)) = (hand, ring) {
                        observed[ring].touched_by[hand] = true;
                    }
                }
            }
        }
        observed
    }

    fn observe_tips(&self, scene: &Snapshot) -> [TipObservation; 2] {
        self.instruments.map(|instrument| {
            let tip = scene.world_pose(instrument);
            TipObservation {
                tip_in_world: tip.translation.vector.into(),
                shaft_in_world: tip.rotation * Vector3::z(),
            }
        })
    }

    /// The published task state.
    fn task_state(&self) -> TaskState {
        let exercise = &self.state.exercise;
        let metrics = exercise.metrics();
        let errors = exercise.errors().iter().map(|error| TaskError {
            kind: error.kind.as_str().to_owned(),
            at_secs: error.at_secs,
            entity: self.rings.get(error.ring).copied(),
        });
        TaskState {
            task: PEG_TRANSFER.to_owned(),
            phase: exercise.phase().to_owned(),
            done: exercise.done(),
            steps: exercise.steps(),
            seconds: exercise.seconds(),
            over: exercise.outcome().is_some(),
            completed: exercise.outcome() == Some(Outcome::Completed),
            cut_off: exercise.outcome() == Some(Outcome::CutOff),
            score: exercise.score(&self.setup),
            errors: errors.collect(),
            metrics: BTreeMap::from([
                (Side::Left.as_str().to_owned(), metrics[0].named()),
                (Side::Right.as_str().to_owned(), metrics[1].named()),
            ]),
        }
    }

    fn report(&self, me: Entity, happening: &TaskEvent, out: &mut Commands) {
        let ring = |index: usize| self.rings[index];
        let instrument = |side: Side| {
            Some(match side {
                Side::Left => self.instruments[0],
                Side::Right => self.instruments[1],
            })
        };
        let done = f64::from(self.state.exercise.done());
        match *happening {
            TaskEvent::Started => out.event("task_started", me, None, 0.0),
            TaskEvent::Lifted { ring: index, by } => {
                out.event("ring_lifted", ring(index), instrument(by), done);
            }
            TaskEvent::HandedOver { ring: index, to } => {
                out.event("ring_handed_over", ring(index), instrument(to), done);
            }
            TaskEvent::Placed { ring: index, .. } => out.event("ring_placed", ring(index), None, done),
            TaskEvent::Returning => out.event("rings_return", me, None, done),
            TaskEvent::Error(error) => {
                out.event(error.kind.as_str(), ring(error.ring), None, error.at_secs);
            }
            TaskEvent::Finished => {
                let score = self.state.exercise.score(&self.setup).unwrap_or(0.0);
                out.event("task_finished", me, None, score);
            }
        }
    }
}

impl Controller for PegTransferController {
    fn access(&self) -> Access {
        Access::new()
            .reads::<Pose>()
            .reads::<Parent>()
            .reads::<Velocity>()
            .reads::<Grasp>()
            .reads::<CollisionList>()
            .writes::<TaskState>(EntitySet::Own)
            .writes::<PegTransferState>(EntitySet::Own)
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        if self.state.exercise.outcome().is_some() && scene.get::<TaskState>(tick.me).is_some() {
            return Ok(());
        }
        let (rings, tips) = (self.observe_rings(scene), self.observe_tips(scene));
        let happened = self.state.exercise.observe(&self.setup, tick.time.as_secs_f64(), &rings, &tips);
        for happening in &happened {
            self.report(tick.me, happening, out);
        }
        if !happened.is_empty() || tick.number.is_multiple_of(WRITE_EVERY) {
            out.put(tick.me, self.task_state());
        }
        out.put(tick.me, self.state.clone());
        Ok(())
    }
}

/// Where the rings start for a left-handed trainee: each mirrored across the plane midway between the two boards, so
/// that they are on the right hand's side. Empty when the scene has no two boards.
///
/// For the set-up of a scene before it starts; the exercise itself never moves a ring.
pub fn mirrored_start(scene: &Snapshot) -> Vec<(Entity, Pose)> {
    let (Ok((rings, _)), Ok(pegs)) = (find_rings(scene), find_pegs(scene)) else { return Vec::new() };
    let middle = |board: usize| {
        let feet = pegs.iter().filter(|peg| peg.board == board).map(|peg| peg.foot_in_world.coords);
        let count = pegs.iter().filter(|peg| peg.board == board).count().max(1);
        feet.sum::<Vector3<f64>>() / count as f64
    };
    let (first, second) = (middle(0), middle(1));
    let Some(normal) = (second - first).try_normalize(1e-9) else { return Vec::new() };
    let plane = 0.5 * (first + second);
    let mirror = |ring: Entity| {
        let mut pose = scene.get::<Pose>(ring).copied().unwrap_or_default();
        let beyond = (pose.translation - plane).dot(&normal);
        pose.translation -= normal * (2.0 * beyond);
        (ring, pose)
    };
    rings.into_iter().map(mirror).collect()
}

fn placement(scene: &Snapshot, ring: Entity) -> RingPlacement {
    let pose = scene.world_pose(ring);
    RingPlacement {
        center_in_world: pose.translation.vector.into(),
        axis_in_world: pose.rotation * Vector3::z(),
    }
}

fn find_rings(scene: &Snapshot) -> Result<(Vec<Entity>, RingShape), BenchError> {
    let BenchRings { entities, ring_radius, tube_radius } = peg_bench::find_rings(scene)?;
    Ok((entities, RingShape { ring_radius, tube_radius }))
}

fn find_pegs(scene: &Snapshot) -> Result<Vec<Peg>, BenchError> {
    let peg = |peg: BenchPeg| Peg {
        board: peg.board,
        foot_in_world: peg.foot_in_world,
        axis_in_world: peg.axis_in_world,
        height: peg.height,
    };
    Ok(peg_bench::find_pegs(scene)?.into_iter().map(peg).collect())
}

fn board_with_rings(
    scene: &Snapshot,
    rings: &[Entity],
    ring: &RingShape,
    pegs: &[Peg],
) -> Result<u32, ControllerError> {
    let on = |board: usize| {
        let here = |entity: &&Entity| {
            ring.peg_inside(&placement(scene, **entity), pegs).is_some_and(|peg| pegs[peg].board == board)
        };
        rings.iter().filter(here).count()
    };
    match (on(0), on(1)) {
        (first, 0) if first == rings.len() => Ok(0),
        (0, second) if second == rings.len() => Ok(1),
        (first, second) => Err(missing(&format!(
            "all {} rings must start around the pegs of one board; {first} are on one and {second} on the other",
            rings.len()
        ))),
    }
}

fn find_view(scene: &Snapshot, config: &PegTransferConfig) -> Result<FieldOfView, ControllerError> {
    if let Some([min, max]) = config.view_box {
        if (0..3).all(|i| min[i].is_finite() && max[i].is_finite() && min[i] < max[i]) {
            return Ok(FieldOfView::Box { min: min.into(), max: max.into() });
        }
        return Err(missing("view_box: the first corner must lie below the second in x, y and z"));
    }
    let (entity, camera) = scene
        .iter::<Camera>()
        .next()
        .ok_or_else(|| missing("give a view_box or a camera: nothing says what is in view"))?;
    Ok(FieldOfView::Frustum {
        world_from_camera: scene.world_pose(entity),
        vertical: camera.field_of_view,
        aspect: camera.aspect,
        depths: [camera.near, camera.far],
    })
}
