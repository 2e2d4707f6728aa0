//! Controller of [`ManualHand`]s: a person's input → targets of the hands and activation of their instruments.

use serde::{Deserialize, Serialize};
use thiserror::Error;
use trocar_scene::kinematics::hand_rig::HandRig;
use trocar_scene::{
    Access, Activation, ActivationMode, BuildContext, Camera, Commands, Component, Controller,
    ControllerError, DeviceInfo, DeviceState, Entity, EntitySet, Hand, HandTarget, Instrument, MentorAnswer,
    Name, Parent, PersonInput, PersonView, Port, Pose, PressTarget, RecordPolicy, Side, SimTime, Snapshot,
    TakeOverRequest, Tick,
};

use nalgebra::{Isometry3, Vector3};

use super::lent_hand::{LentHand, is_elsewhere};
use super::mapping::{HandKinematics, HandLimits, ManualHand};
use crate::pedals::asked_by_pedals;

/// Longest time that a hand catches up after a pause of the controller \[s\].
const CATCH_UP_MAX_SECS: f64 = 0.1;
/// Name of the entity that [`add_person`] creates.
pub const PERSON: &str = "person";

/// Parameters of a person's hands in a scenario: [`HandLimits`].
pub type ManualConfig = HandLimits;

/// Error for a scene without hands.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error("nobody can play a scene without hands: no entity has the component 'hand'")]
pub struct NoHands;

/// Restart state, on the controller's own entity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "manual_state", record = RecordPolicy::sampled(20.0, 2.5e-7))]
pub struct ManualState {
    /// Source of the totals seen last: [`PersonInput::source`].
    pub source: u32,
    /// Time up to which the hands have moved.
    pub stepped_at: SimTime,
    /// The hands: left, right; none where the scene has none.
    pub hands: [Option<ManualHand>; 2],
}

/// Adds the person to a scene, with an existing hand active; does nothing if the scene has one of this station.
///
/// # Errors
/// [`NoHands`] when the scene has no hands.
pub fn add_person(scene: &Snapshot, out: &mut Commands) -> Result<(), NoHands> {
    let side = scene.iter::<Hand>().map(|(_, hand)| hand.side).min().ok_or(NoHands)?;
    let station = out.me().station();
    if !scene.iter::<PersonInput>().any(|(person, _)| person.station() == station) {
        let person = out.spawn();
        out.put(person, Name(PERSON.to_owned()));
        out.put(person, PersonInput { in_charge: side, ..PersonInput::default() });
    }
    Ok(())
}

/// Moves the hands by a person's [`PersonInput`]; to be run at 100 Hz. Writes [`HandTarget`], and [`Activation`] where
/// it changes.
pub struct ManualController {
    limits: HandLimits,
    person: Entity,
    /// Left, right.
    hands: [Option<Entity>; 2],
    /// Instruments of the existing hands.
    instruments: Vec<Entity>,
    /// Hands that have pedals.
    pressing: Vec<Entity>,
    state: ManualState,
    /// Left, right: whether another station has them.
    lent: [LentHand; 2],
}

fn wrong(what: impl std::fmt::Display) -> ControllerError {
    ControllerError::Scene(format!("manual: {what}"))
}

impl ManualController {
    /// Finds the person in the scene, and its hands among `own`, those of this station; continues where an earlier life stopped; the first life takes
    /// the hands over at their current poses.
    ///
    /// # Errors
    /// Names the missing part of the scene or the invalid parameter.
    pub fn new(
        limits: &ManualConfig,
        own: &[Entity],
        context: &BuildContext<'_>,
    ) -> Result<Self, ControllerError> {
        limits.check().map_err(wrong)?;
        let scene = context.scene;
        let (person, input) =
            PersonInput::of(scene).ok_or_else(|| wrong("no entity has the component 'person_input'"))?;
        let of_side = |side| {
            own.iter().copied().find(|hand| scene.get::<Hand>(*hand).is_some_and(|hand| hand.side == side))
        };
        let hands = [of_side(Side::Left), of_side(Side::Right)];
        if hands == [None, None] {
            return Err(wrong(NoHands));
        }
        let state = match scene.get::<ManualState>(context.me) {
            Some(state) => state.clone(),
            None => {
                let take = |side: Side| {
                    let taken = hands[side as usize].map(|hand| take_over(scene, hand, side, input, limits));
                    taken.transpose()
                };
                let hands = [take(Side::Left)?, take(Side::Right)?];
                ManualState { source: input.source, stepped_at: context.time, hands }
            }
        };
        let instruments: Result<Vec<Entity>, _> =
            hands.into_iter().flatten().map(|hand| Ok(rig_of(scene, hand)?.instrument)).collect();
        let all = hands.into_iter().flatten();
        let pressing = all.filter(|hand| scene.get::<PressTarget>(*hand).is_some()).collect();
        let lent = Default::default();
        Ok(Self { limits: *limits, person, hands, instruments: instruments?, pressing, state, lent })
    }
}

fn rig_of(scene: &Snapshot, hand: Entity) -> Result<HandRig, ControllerError> {
    HandRig::read(scene, hand).map_err(wrong)
}

/// Takes over a hand at its current pose in the scene.
fn take_over(
    scene: &Snapshot,
    hand: Entity,
    side: Side,
    input: &PersonInput,
    limits: &HandLimits,
) -> Result<ManualHand, ControllerError> {
    let rig = rig_of(scene, hand)?;
    let axis = scene.world_pose(rig.instrument).rotation * Vector3::z();
    let target = scene.get::<HandTarget>(hand).map(|target| (target.handle_in_device, target.gripper));
    let measured = scene.get::<DeviceState>(hand).map(|state| (state.handle_in_device, state.gripper));
    // Without any measurement the handle is at its device's origin, and the jaws take their initial opening.
    let (handle, jaw, goal_jaw) = match target.or(measured) {
        Some((handle, jaw)) => (handle.isometry(), jaw, jaw),
        None => (Isometry3::identity(), 0.0, limits.opening * rig.jaw_angle_max),
    };
    let tip = rig.tip_in_world(&handle, &axis);
    Ok(ManualHand::at(&tip, jaw, goal_jaw, *input.hand(side)))
}

/// The person's viewpoint: its own, or else the scene's first camera.
fn view_of(scene: &Snapshot, input: &PersonInput) -> Option<PersonView> {
    let camera = || {
        let (entity, camera) = scene.iter::<Camera>().next()?;
        let field_of_view = camera.field_of_view.clamp(0.01, 3.0);
        Some(PersonView { world_from_view: scene.world_pose(entity).into(), field_of_view })
    };
    input.view.or_else(camera)
}

/// The pedals that a person's keys stand for: they are up or down.
fn pressed_by_keys((level, mode): (f64, Option<ActivationMode>)) -> PressTarget {
    let is_down = level > 0.0;
    let coagulate = is_down && mode == Some(ActivationMode::Coagulate);
    PressTarget { buttons: 0, energy: is_down && !coagulate, coagulate }
}

impl Controller for ManualController {
    fn access(&self) -> Access {
        let access = Access::new()
            .reads::<PersonInput>()
            .reads::<Pose>()
            .reads::<Parent>()
            .reads::<Hand>()
            .reads::<Instrument>()
            .reads::<Port>()
            .reads::<Camera>()
            .reads::<DeviceInfo>()
            .reads::<DeviceState>()
            .reads::<Activation>()
            .reads::<TakeOverRequest>()
            .reads::<MentorAnswer>()
            .writes::<Activation>(EntitySet::Of(self.instruments.clone()))
            .writes::<HandTarget>(EntitySet::Of(self.hands.iter().flatten().copied().collect()))
            .writes::<ManualState>(EntitySet::Own);
        if self.pressing.is_empty() {
            return access;
        }
        access.reads::<PressTarget>().writes::<PressTarget>(EntitySet::Of(self.pressing.clone()))
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        // A person removed from the scene gives no more input.
        let input = scene.get::<PersonInput>(self.person);
        let dt_secs = tick.time.since(self.state.stepped_at).as_secs_f64().min(CATCH_UP_MAX_SECS);
        if let Some(input) = input
            && input.source != self.state.source
        {
            self.state.source = input.source;
            for hand in self.state.hands.iter_mut().flatten() {
                hand.seen = Default::default();
            }
        }
        let view = input.and_then(|input| view_of(scene, input));
        for side in [Side::Left, Side::Right] {
            let (Some(entity), Some(hand)) =
                (self.hands[side as usize], &mut self.state.hands[side as usize])
            else {
                continue;
            };
            let rig = rig_of(scene, entity)?;
            let workspace =
                scene.get::<DeviceInfo>(entity).map_or_else(Vector3::zeros, |info| info.workspace.into());
            let reach = HandKinematics { rig: &rig, workspace };
            if let (Some(input), Some(state)) = (input, scene.get::<DeviceState>(entity)) {
                let is_elsewhere = is_elsewhere(scene, entity, tick.me.station());
                if self.lent[side as usize].is_followed(tick.time, is_elsewhere, state) {
                    let axis = scene.world_pose(rig.instrument).rotation * Vector3::z();
                    let tip = rig.tip_in_world(&state.handle_in_device.isometry(), &axis);
                    *hand = ManualHand::at(&tip, state.gripper, state.gripper, *input.hand(side));
                }
            }
            if let Some(input) = input {
                let actual = scene.world_pose(rig.instrument).translation.vector;
                hand.ask(input.hand(side), view.as_ref(), &actual, &reach, &self.limits);
            }
            hand.advance(dt_secs, &self.limits);
            let place = hand.place(&reach);
            let handle_in_device = place.handle_in_device.into();
            out.put(entity, HandTarget { handle_in_device, gripper: place.gripper });
            // Without a person nothing is active.
            let asked = input.map(|input| input.hand(side));
            let by_keys = asked.map_or((0.0, None), |asked| (asked.activation, asked.mode));
            let by_keys = match scene.get::<PressTarget>(entity).filter(|_| self.pressing.contains(&entity)) {
                // What is pressed comes back as pedals, a network later.
                Some(before) => {
                    let press = PressTarget { buttons: before.buttons, ..pressed_by_keys(by_keys) };
                    if *before != press {
                        out.put(entity, press);
                    }
                    (0.0, None)
                }
                None => by_keys,
            };
            let (level, mode) = asked_by_pedals(scene, entity).unwrap_or(by_keys);
            let before = scene.get::<Activation>(rig.instrument).copied().unwrap_or_default();
            if (level, mode) != (before.level, before.mode) {
                out.put(rig.instrument, Activation { level, since: tick.time, mode });
            }
        }
        self.state.stepped_at = tick.time;
        out.put(tick.me, self.state.clone());
        Ok(())
    }
}
