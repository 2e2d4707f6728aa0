//! Controller of a [`Path`]: time → hand target and activation.

use serde::{Deserialize, Serialize};
use trocar_scene::kinematics::coupling::InstrumentCoupling;
use trocar_scene::kinematics::hand_rig::HandRig;
use trocar_scene::{
    Access, Activation, ActivationMode, BuildContext, Commands, Controller, ControllerError, DeviceState,
    Entity, EntitySet, Hand, HandTarget, PressTarget, Snapshot, Tick,
};

use crate::path::{Moment, Path, Step};
use crate::pedals::asked_by_pedals;
use crate::trainee_view::tip_pose;

/// A movement as a scenario file describes it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PathConfig {
    /// Name of the entity of the hand.
    pub hand: String,
    /// Opening of the jaws at the start \[rad\].
    #[serde(default)]
    pub jaws: f64,
    /// Steps, in order, from the start of the session.
    pub step: Vec<Step>,
}

/// Moves one virtual hand along a path. To resume after a restart it needs only the time.
pub struct PathController {
    hand: Entity,
    rig: HandRig,
    path: Path,
    activates: bool,
    /// Whether the hand has pedals: they are pressed, and not the instrument switched.
    presses: bool,
    /// Last written level and mode.
    told: Option<(f64, Option<ActivationMode>)>,
}

fn wrong(what: impl std::fmt::Display) -> ControllerError {
    ControllerError::Scene(format!("path: {what}"))
}

impl PathController {
    /// Finds the hand; its path starts where and as its instrument is in the scenario.
    ///
    /// # Errors
    /// Names the missing part of the scene, or the invalid step.
    pub fn new(config: &PathConfig, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let scene = context.scene;
        let hand = scene.find(&config.hand).filter(|hand| scene.get::<Hand>(*hand).is_some());
        let Some(hand) = hand else {
            let mut known: Vec<String> = scene.iter::<Hand>().map(|(hand, _)| scene.name(hand)).collect();
            known.sort_unstable();
            return Err(wrong(format_args!("no hand '{}'; there are: {}", config.hand, known.join(", "))));
        };
        let rig = HandRig::read(scene, hand).map_err(wrong)?;
        // The first target is the handle's pose in the scenario: the origin of the device.
        let home = rig.tip_in_world(&nalgebra::Isometry3::identity(), &-nalgebra::Vector3::z());
        let start = Moment {
            tip_in_world: home.translation.vector.into(),
            jaw_angle: config.jaws,
            closing_in_world: home.rotation * nalgebra::Vector3::x(),
            level: 0.0,
            mode: None,
            buttons: 0,
        };
        let path = Path::new(start, &config.step).map_err(wrong)?;
        let activates = config.step.iter().any(|step| step.level.is_some() || step.mode.is_some());
        let presses = scene.get::<PressTarget>(hand).is_some();
        // What an earlier life has told is not told again.
        let told = scene.get::<Activation>(rig.instrument).map(|asked| (asked.level, asked.mode));
        Ok(Self { hand, rig, path, activates, presses, told })
    }

    fn target(&self, moment: &Moment) -> HandTarget {
        let apex = match &self.rig.coupling {
            InstrumentCoupling::Fulcrum(fulcrum) => *fulcrum.port_in_world(),
            // A free shaft points where its device's axis does.
            _ => {
                let along = self.rig.registration.world_from_device().rotation * nalgebra::Vector3::z();
                moment.tip_in_world.coords - along
            }
        };
        let tip = tip_pose(&moment.tip_in_world.coords, &apex, &moment.closing_in_world);
        HandTarget {
            handle_in_device: self.rig.handle_in_device(&tip).into(),
            gripper: moment.jaw_angle.clamp(0.0, self.rig.jaw_angle_max),
        }
    }
}

/// What a foot and fingers press at this moment: pedals are up or down.
fn pressed_at(moment: &Moment) -> PressTarget {
    let is_down = moment.level > 0.0;
    let coagulate = is_down && moment.mode == Some(ActivationMode::Coagulate);
    PressTarget { buttons: moment.buttons, energy: is_down && !coagulate, coagulate }
}

impl Controller for PathController {
    fn access(&self) -> Access {
        let access = Access::new()
            .reads::<DeviceState>()
            .reads::<Activation>()
            .writes::<Activation>(EntitySet::Of(vec![self.rig.instrument]))
            .writes::<HandTarget>(EntitySet::Of(vec![self.hand]));
        if !self.presses {
            return access;
        }
        access.reads::<PressTarget>().writes::<PressTarget>(EntitySet::Of(vec![self.hand]))
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let moment = self.path.at(tick.time.as_secs_f64());
        out.put(self.hand, self.target(&moment));
        if self.presses {
            let press = pressed_at(&moment);
            if scene.get::<PressTarget>(self.hand) != Some(&press) {
                out.put(self.hand, press);
            }
        }
        let scripted = (self.activates && !self.presses).then_some((moment.level, moment.mode));
        // A script that switches nothing still lets go of what pedals have switched on.
        let is_on = || scene.get::<Activation>(self.rig.instrument).is_some_and(|asked| asked.level > 0.0);
        let let_go = || is_on().then_some((0.0, None));
        let asked = asked_by_pedals(scene, self.hand).or(scripted).or_else(let_go);
        if let Some((level, mode)) = asked.filter(|_| asked != self.told) {
            self.told = asked;
            out.put(self.rig.instrument, Activation { level, since: tick.time, mode });
        }
        Ok(())
    }
}
