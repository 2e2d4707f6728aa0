//! Controller of an [`Autopilot`]: snapshot → observations → hand targets.

use serde::{Deserialize, Serialize};
use trocar_scene::kinematics::coupling::InstrumentCoupling;
use trocar_scene::kinematics::hand_rig::HandRig;
use trocar_scene::{
    Access, BuildContext, Commands, Component, Controller, ControllerError, Entity, EntitySet, Grasp,
    HandTarget, Instrument, JawState, Parent, Pose, RecordPolicy, Side, Snapshot, Tick, Velocity,
};
use trocar_tasks::peg_bench::{self, BenchError, BenchPeg, BenchRings, find_hand, find_rings};

use crate::autopilot::Autopilot;
use crate::motor_model::{MotorParameters, Skill};
use crate::strategy::Strategy;
use crate::trainee_view::{BenchSeen, GrasperSeen, HandSeen, MomentSeen, PegSeen, RingSeen, tip_pose};

/// The virtual trainee as a scenario file describes it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AutopilotConfig {
    /// Its skill.
    pub skill: Skill,
    /// Its dominant hand is the left one.
    pub left_handed: bool,
    /// Motor parameters that replace the skill's.
    pub motor: Option<MotorParameters>,
    /// Distances and times of the strategy.
    pub strategy: Strategy,
}

/// Restart state of the trainee, on the controller's own entity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "autopilot_state", record = RecordPolicy::sampled(20.0, 2.5e-7))]
pub struct AutopilotState {
    /// The board on which the rings started, counted in entity order.
    pub first_board: u32,
    /// The trainee.
    pub autopilot: Autopilot,
}

/// Moves two virtual hands through the peg transfer; to be run at 100 Hz. Writes [`HandTarget`] only.
pub struct AutopilotController {
    parameters: MotorParameters,
    strategy: Strategy,
    bench: BenchSeen,
    rings: Vec<Entity>,
    /// Left, right.
    hands: [Entity; 2],
    rigs: [HandRig; 2],
    state: AutopilotState,
}

fn missing(what: impl std::fmt::Display) -> ControllerError {
    ControllerError::Scene(format!("autopilot: {what}"))
}

impl AutopilotController {
    /// Finds the boards, the rings and the two hands in the scene, and continues where an earlier life stopped.
    ///
    /// # Errors
    /// Names the missing part of the scene or the configuration.
    pub fn new(config: &AutopilotConfig, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let parameters = config.motor.unwrap_or_else(|| MotorParameters::of(config.skill));
        parameters.validate().map_err(missing)?;
        let scene = context.scene;
        let hand = |side| find_hand(scene, side).map(|(entity, _)| entity).map_err(missing);
        let hands = [hand(Side::Left)?, hand(Side::Right)?];
        let rig = |hand| HandRig::read(scene, hand).map_err(missing);
        let rigs = [rig(hands[0])?, rig(hands[1])?];
        let BenchRings { entities: rings, ring_radius, tube_radius } = find_rings(scene).map_err(missing)?;
        let mut bench = BenchSeen {
            pegs: find_pegs(scene).map_err(missing)?,
            ring_radius,
            tube_radius,
            graspers: [grasper(scene, &rigs[0])?, grasper(scene, &rigs[1])?],
            first_board: 0,
        };
        let moment = look(scene, &rings, &rigs);
        let state = match scene.get::<AutopilotState>(context.me) {
            Some(state) => state.clone(),
            None => {
                let first_giver = if config.left_handed { Side::Right } else { Side::Left };
                AutopilotState {
                    first_board: fullest_board(&bench, &moment) as u32,
                    autopilot: Autopilot::new(&moment, first_giver, context.seed),
                }
            }
        };
        bench.first_board = state.first_board as usize;
        Ok(Self { parameters, strategy: config.strategy, bench, rings, hands, rigs, state })
    }

    /// The trainee, for traces.
    pub fn autopilot(&self) -> &Autopilot {
        &self.state.autopilot
    }
}

impl Controller for AutopilotController {
    fn access(&self) -> Access {
        Access::new()
            .reads::<Pose>()
            .reads::<Parent>()
            .reads::<Velocity>()
            .reads::<Grasp>()
            .reads::<JawState>()
            .writes::<HandTarget>(EntitySet::Of(self.hands.to_vec()))
            .writes::<AutopilotState>(EntitySet::Own)
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let moment = look(scene, &self.rings, &self.rigs);
        let commands = self.state.autopilot.step(
            &self.strategy,
            &self.bench,
            &moment,
            &self.parameters,
            tick.time.as_secs_f64(),
            tick.period.as_secs_f64(),
        );
        for (hand, command) in commands.iter().enumerate() {
            let apex = &self.bench.graspers[hand].apex;
            let tip_in_world = tip_pose(&command.position, apex, &command.closing);
            let target = HandTarget {
                handle_in_device: self.rigs[hand].handle_in_device(&tip_in_world).into(),
                gripper: command.jaw_angle.clamp(0.0, self.rigs[hand].jaw_angle_max),
            };
            out.put(self.hands[hand], target);
        }
        out.put(tick.me, self.state.clone());
        Ok(())
    }
}

/// Observations of a snapshot; hands left then right.
fn look(scene: &Snapshot, rings: &[Entity], rigs: &[HandRig; 2]) -> MomentSeen {
    let seen = |ring: &Entity| RingSeen {
        pose: scene.world_pose(*ring),
        speed: scene.get::<Velocity>(*ring).map_or(0.0, |velocity| velocity.linear.norm()),
    };
    let hands = rigs.map(|rig| {
        let held = scene.get::<Grasp>(rig.instrument).map(|grasp| grasp.held);
        HandSeen {
            tip: scene.world_pose(rig.instrument),
            jaw_angle: scene.get::<JawState>(rig.instrument).map_or(0.0, |jaw| jaw.angle),
            held: held.and_then(|held| rings.iter().position(|ring| *ring == held)),
        }
    });
    MomentSeen { rings: rings.iter().map(seen).collect(), hands }
}

fn find_pegs(scene: &Snapshot) -> Result<Vec<PegSeen>, BenchError> {
    let seen = |peg: &BenchPeg| PegSeen {
        board: peg.board,
        foot: peg.foot_in_world.coords,
        up: peg.axis_in_world,
        height: peg.height,
        radius: peg.radius,
    };
    Ok(peg_bench::find_pegs(scene)?.iter().map(seen).collect())
}

fn grasper(scene: &Snapshot, rig: &HandRig) -> Result<GrasperSeen, ControllerError> {
    let instrument = scene
        .get::<Instrument>(rig.instrument)
        .ok_or_else(|| missing(format_args!("'{}' is no instrument", scene.name(rig.instrument))))?;
    let apex = match (&rig.coupling, rig.port) {
        (InstrumentCoupling::Fulcrum(fulcrum), _) => *fulcrum.port_in_world(),
        // A free shaft is swung about the middle of its device's workspace.
        _ => rig.registration.world_from_device().translation.vector,
    };
    Ok(GrasperSeen {
        jaw_length: instrument.jaw_length,
        jaw_width: instrument.jaw_width,
        jaw_thickness: instrument.jaw_thickness,
        jaw_angle_max: instrument.jaw_angle_max,
        shaft_radius: instrument.shaft_radius,
        apex,
    })
}

/// The board with the most rings.
fn fullest_board(bench: &BenchSeen, moment: &MomentSeen) -> usize {
    let on_second = moment
        .rings
        .iter()
        .filter(|ring| bench.peg_inside(ring).is_some_and(|peg| bench.pegs[peg].board == 1))
        .count();
    usize::from(2 * on_second > moment.rings.len())
}
