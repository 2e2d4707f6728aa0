//! Haptics controller of one hand: device link → registration → port → renderer → device.
//!
//! It only schedules the algorithms of this crate. All its state is in the scene, apart from transients of a few
//! milliseconds (blends, the previous sample): a restarted controller continues with the buttons and the shaft
//! direction of its predecessor, and the driver, which keeps the energy, ramps its force in.

use nalgebra::{Isometry3, Vector3};
use trocar_devices::{
    Capabilities, DeviceCommand, DeviceLink, DeviceSample, Dofs, HAS_PEDALS, HandIntent, Pedals,
};
use trocar_scene::kinematics::coupling::{InstrumentCoupling, Transmission};
use trocar_scene::kinematics::hand_rig::HandRig;
use trocar_scene::kinematics::spatial::{Twist, Wrench};
use trocar_scene::{
    Access, BuildContext, Commands, Controller, ControllerError, DeviceForce, DeviceState, Entity, EntitySet,
    Hand, HandTarget, HapticStatus, Instrument, InstrumentForce, InstrumentTarget, LocalContactModel, Port,
    Pose, PressTarget, Revision, SimTime, Snapshot, StationContactModel, Tick, Velocity, VirtualFixture,
};

use crate::config::{HapticsConfig, HapticsError};
use crate::felt_stiffness::FeltStiffness;
use crate::playout::TargetPlayout;
use crate::renderer::{ForceRenderer, RenderInput, SimulatedInstrument};
use crate::virtual_fixture;

/// Largest damping as a share of m/ΔT of the device. The loop's delay of 1.5 steps and the filter of the measured
/// velocity reduce the apparent mass by `B·τ`, τ about 3 ms; half of the mass must remain.
const DAMPING_SHARE: f64 = 0.15;
/// Period of a driver \[s\]: a faster controller does not shorten the loop's delay further.
const PERIOD_NOMINAL: f64 = 1e-3;

/// When the newest change of a row was first seen here. A row counts as no younger than that, whatever its time stamp says:
/// a pose has none, and a stamp by the clock of another station may lie in the future for ever.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    revision: Option<Revision>,
    at: SimTime,
}

impl Seen {
    /// The time of the row as of `revision`, at time `now`.
    fn at(&mut self, revision: Option<Revision>, now: SimTime) -> SimTime {
        if self.revision != revision {
            *self = Self { revision, at: now };
        }
        self.at
    }
}

/// The rows whose age decides how much of them is rendered.
#[derive(Clone, Copy, Debug, Default)]
struct SeenRows {
    pose: Seen,
    force: Seen,
    model: Seen,
    fixture: Seen,
}

/// Haptics of one hand.
pub struct HapticsController {
    hand: Entity,
    rig: HandRig,
    rig_read_at: Revision,
    link: DeviceLink,
    capabilities: Capabilities,
    renderer: Box<dyn ForceRenderer>,
    passivity: bool,
    remote_scene: bool,
    felt: FeltStiffness,
    status_period: SimTime,

    shaft_axis: Vector3<f64>,
    buttons: u32,
    before: Option<DeviceSample>,
    target: Option<InstrumentTarget>,
    playout: TargetPlayout,
    seen: SeenRows,
    status: HapticStatus,
    status_due: SimTime,
}

impl HapticsController {
    /// Haptics for the entity `hand` of the scene, over `link` to a device with `capabilities`. Continues from an
    /// earlier controller's state in the scene.
    ///
    /// # Errors
    /// [`HapticsError`] when the scene does not describe the hand or a parameter is out of range.
    pub fn new(
        context: &BuildContext<'_>,
        hand: Entity,
        link: DeviceLink,
        capabilities: Capabilities,
        config: HapticsConfig,
    ) -> Result<Self, HapticsError> {
        config.check()?;
        let scene = context.scene;
        let rig = HandRig::read(scene, hand)?;
        let status = scene.get::<HapticStatus>(hand).copied().unwrap_or_default();
        let target = scene.get::<InstrumentTarget>(rig.instrument).copied();
        let tip = target
            .map_or_else(|| scene.world_pose(rig.instrument).rotation, |target| target.tip_in_world.rotation);
        Ok(Self {
            hand,
            rig,
            rig_read_at: scene.revision(),
            link,
            capabilities,
            renderer: config.renderer.build(),
            passivity: config.passivity,
            remote_scene: config.remote_scene,
            felt: FeltStiffness::new(config.felt_window_secs),
            status_period: SimTime::from_secs_f64(config.status_period_secs),
            shaft_axis: tip * Vector3::z(),
            buttons: scene.get::<DeviceState>(hand).map_or(0, |state| state.buttons),
            before: None,
            target,
            playout: TargetPlayout::new(SimTime::from_secs_f64(config.playout_secs)),
            seen: SeenRows::default(),
            status,
            status_due: context.time,
        })
    }

    /// The name of the renderer in use.
    pub fn renderer_name(&self) -> &'static str {
        self.renderer.name()
    }

    /// Follows changes of the hand's own components, so that they can be edited live. An invalid change is refused with
    /// an event, and the rig stays unchanged.
    fn refresh_rig(&mut self, scene: &Snapshot, out: &mut Commands) {
        let newer = |revision: Option<Revision>| revision.is_some_and(|revision| revision > self.rig_read_at);
        let changed = newer(scene.changed::<Hand>(self.hand))
            || newer(scene.changed::<Instrument>(self.rig.instrument))
            || self.rig.port.is_some_and(|port| newer(scene.changed::<Port>(port)));
        if changed {
            match HandRig::read(scene, self.hand) {
                Ok(rig) => self.rig = rig,
                Err(_) => out.event("hand_rig_refused", self.hand, None, 0.0),
            }
            self.rig_read_at = scene.revision();
        } else if let (InstrumentCoupling::Fulcrum(fulcrum), Some(port)) =
            (&mut self.rig.coupling, self.rig.port)
        {
            // The port may move with the abdominal wall.
            *fulcrum = fulcrum.with_port_at(scene.world_pose(port).translation.vector);
        }
    }

    fn press_buttons(&mut self, buttons: u32, out: &mut Commands) {
        // That a device has pedals is nothing that is pressed.
        let mut changed = (buttons ^ self.buttons) & !HAS_PEDALS;
        while changed != 0 {
            let button = changed.trailing_zeros();
            let name = if buttons & (1 << button) == 0 { "button_released" } else { "button_pressed" };
            out.event(name, self.hand, None, f64::from(button));
            changed &= changed - 1;
        }
        self.buttons = buttons;
    }

    fn simulated_instrument(
        &mut self,
        scene: &Snapshot,
        model: Option<&LocalContactModel>,
        now: SimTime,
    ) -> Option<SimulatedInstrument> {
        let instrument = self.rig.instrument;
        if let Some(model) = model {
            return Some(SimulatedInstrument {
                tip_in_world: model.proxy_in_world.isometry(),
                twist: Twist::new(model.proxy_velocity.linear, model.proxy_velocity.angular),
                at: model.at,
            });
        }
        let revision = scene.changed::<Pose>(instrument)?;
        let velocity = scene.get::<Velocity>(instrument).copied().unwrap_or_default();
        Some(SimulatedInstrument {
            tip_in_world: scene.world_pose(instrument),
            twist: Twist::new(velocity.linear, velocity.angular),
            at: self.seen.pose.at(Some(revision), now),
        })
    }

    /// From when on a row counts: from when it was first seen, or from its own stamp if that is earlier. Of a scene that
    /// comes over a network only the arrival counts: a long path is no reason to fade, one that fell silent is.
    fn age_from(&self, stamp: SimTime, seen_at: SimTime) -> SimTime {
        if self.remote_scene { seen_at } else { stamp.min(seen_at) }
    }

    /// The simulation's force, of the time at which it was first seen or of an earlier one.
    fn instrument_force(&mut self, scene: &Snapshot, now: SimTime) -> Option<InstrumentForce> {
        let instrument = self.rig.instrument;
        let seen_at = self.seen.force.at(scene.changed::<InstrumentForce>(instrument), now);
        let force = scene.get::<InstrumentForce>(instrument)?;
        Some(InstrumentForce { at: self.age_from(force.at, seen_at), ..*force })
    }

    /// The simulation's local contact model, likewise; at a station the one that it makes itself.
    fn contact_model(&mut self, scene: &Snapshot, now: SimTime) -> Option<LocalContactModel> {
        let instrument = self.rig.instrument;
        if let Some(own) = scene.get::<StationContactModel>(instrument) {
            let seen_at = self.seen.model.at(scene.changed::<StationContactModel>(instrument), now);
            return Some(LocalContactModel { at: own.model.at.min(seen_at), ..own.model });
        }
        let seen_at = self.seen.model.at(scene.changed::<LocalContactModel>(instrument), now);
        let model = scene.get::<LocalContactModel>(instrument)?;
        Some(LocalContactModel { at: self.age_from(model.at, seen_at), ..*model })
    }

    /// The hand's virtual fixture, likewise.
    fn fixture(&mut self, scene: &Snapshot, now: SimTime) -> Option<VirtualFixture> {
        let seen_at = self.seen.fixture.at(scene.changed::<VirtualFixture>(self.hand), now);
        let fixture = scene.get::<VirtualFixture>(self.hand)?;
        Some(VirtualFixture { at: self.age_from(fixture.at, seen_at), ..*fixture })
    }

    /// Wrench on the hand in the device's frame, before the driver's limits.
    fn render(
        &mut self,
        tick: &Tick<'_>,
        scene: &Snapshot,
        transmission: &Transmission,
        handle_twist: &Twist,
        energy_available: f64,
    ) -> Wrench {
        let dt = tick.period.as_secs_f64().max(1e-6);
        // Stiffness at the tip maps to the handle with the square of the lever and of the scale.
        let lever = match transmission {
            Transmission::Fulcrum(passage) => passage.lever().abs().max(1.0),
            Transmission::Free { .. } => 1.0,
        };
        let gain = (lever * self.rig.registration.scale()).powi(2);
        let damping_max = DAMPING_SHARE * self.capabilities.apparent_mass / dt.max(PERIOD_NOMINAL);
        let contact_model = self.contact_model(scene, tick.time);
        let instrument_force = self.instrument_force(scene, tick.time);
        let fixture = self.fixture(scene, tick.time);
        let input = RenderInput {
            now: tick.time,
            dt,
            tip_in_world: *transmission.tip_in_world(),
            tip_twist: transmission.tip_twist(handle_twist),
            stiffness_max: self.capabilities.max_stiffness / gain,
            damping_max: damping_max / gain,
            apparent_mass: self.capabilities.apparent_mass / gain,
            energy_available,
            instrument: self.simulated_instrument(scene, contact_model.as_ref(), tick.time),
            instrument_force: instrument_force.as_ref(),
            contact_model: contact_model.as_ref(),
            remote: self.remote_scene,
        };
        let mut at_tip = self.renderer.render(&input);
        if let Some(fixture) = fixture {
            at_tip += virtual_fixture::render(&fixture, &input);
        }
        let at_handle = transmission.handle_wrench(&at_tip)
            + self.rig.coupling.passive_wrench(transmission, handle_twist);
        let mut wrench = self.rig.registration.wrench_to_device(&at_handle);
        if self.capabilities.output_dofs != Dofs::Six {
            wrench.torque = Vector3::zeros();
        }
        if !wrench.is_finite() {
            return Wrench::ZERO;
        }
        let size = wrench.force.norm();
        if size > self.capabilities.max_force_newtons {
            // The driver clamps as well; this clamp keeps the command within the device's range.
            wrench.force *= self.capabilities.max_force_newtons / size;
        }
        wrench
    }

    /// With the device connected: moves the instrument and returns the wrench to render.
    fn serve(
        &mut self,
        tick: &Tick<'_>,
        scene: &Snapshot,
        sample: &DeviceSample,
        out: &mut Commands,
    ) -> Wrench {
        let state = &sample.state;
        let registration = &self.rig.registration;
        let handle_in_world = registration.pose_to_world(&state.pose_in_device);
        let handle_twist =
            registration.twist_to_world(&Twist::new(state.linear_velocity, state.angular_velocity));
        let transmission = self.rig.coupling.transmit(&handle_in_world, &self.shaft_axis);
        self.shaft_axis = transmission.axis_in_world();
        let tip_twist = transmission.tip_twist(&handle_twist);

        let target = InstrumentTarget {
            tip_in_world: renormalised(transmission.tip_in_world()),
            velocity_in_world: Velocity { linear: tip_twist.linear, angular: tip_twist.angular },
            jaw_angle: state.gripper.clamp(0.0, self.rig.jaw_angle_max),
            sampled_at: SimTime(sample.sampled_at_ns),
        };
        let measured_at = SimTime(sample.sampled_at_ns.saturating_sub(sample.lag_ns));
        if let Some(target) = self.playout.pass(tick.time, measured_at, target) {
            self.target = Some(target);
            out.put(self.rig.instrument, target);
        }

        self.felt.update(
            &state.pose_in_device.translation.vector,
            &state.linear_velocity,
            &sample.applied.force,
            tick.period.as_secs_f64(),
        );
        self.render(tick, scene, &transmission, &handle_twist, sample.energy.available)
    }

    /// With the device disconnected: holds the instrument in place.
    fn freeze(&mut self, out: &mut Commands) {
        self.renderer.reset();
        self.felt.clear();
        self.playout.clear();
        if let Some(target) = &mut self.target
            && target.velocity_in_world != Velocity::default()
        {
            target.velocity_in_world = Velocity::default();
            out.put(self.rig.instrument, *target);
        }
    }

    /// The virtual trainee's target for the hand, if present and valid.
    fn intent(&self, scene: &Snapshot) -> Option<HandIntent> {
        let target = scene.get::<HandTarget>(self.hand)?;
        let buttons = scene.get::<PressTarget>(self.hand).map_or(0, pressed);
        let pose_in_device = target.handle_in_device.isometry();
        let intent = HandIntent { pose_in_device, gripper: target.gripper, buttons };
        intent.is_valid().then_some(intent)
    }
}

/// What a virtual trainee presses, as a device with pedals says it.
pub fn pressed(target: &PressTarget) -> u32 {
    let pedals = match (target.coagulate, target.energy) {
        (true, _) => Pedals::Coagulate,
        (false, true) => Pedals::Energy,
        (false, false) => Pedals::Released,
    };
    u32::from(target.buttons) | pedals.buttons()
}

impl Controller for HapticsController {
    fn access(&self) -> Access {
        let hand = || EntitySet::Of(vec![self.hand]);
        Access::new()
            .reads::<Hand>()
            .reads::<HandTarget>()
            .reads::<PressTarget>()
            .reads::<Instrument>()
            .reads::<Port>()
            .reads::<Pose>()
            .reads::<Velocity>()
            .reads::<InstrumentForce>()
            .reads::<LocalContactModel>()
            .reads::<StationContactModel>()
            .reads::<VirtualFixture>()
            .writes::<DeviceState>(hand())
            .writes::<DeviceForce>(hand())
            .writes::<HapticStatus>(hand())
            .writes::<InstrumentTarget>(EntitySet::Of(vec![self.rig.instrument]))
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        self.refresh_rig(scene, out);
        let sample = *self.link.sample();
        let fresh = self.before.is_none_or(|before| before.published_at_ns != sample.published_at_ns);
        self.status.stale_samples += u64::from(!fresh);
        let connected = sample.state.connected;
        self.press_buttons(if connected { sample.state.buttons } else { 0 }, out);

        let wrench = if connected {
            self.serve(tick, scene, &sample, out)
        } else {
            self.freeze(out);
            Wrench::ZERO
        };
        let intent = self.intent(scene);
        self.link.command(DeviceCommand {
            epoch: self.link.epoch(),
            time_ns: tick.time.as_nanos(),
            wrench: trocar_devices::Wrench { force: wrench.force, torque: wrench.torque },
            passivity: self.passivity,
            intent,
        });

        if fresh {
            out.put(self.hand, device_state(&sample));
        }
        out.put(self.hand, DeviceForce { force: wrench.force, torque: wrench.torque, at: tick.time });
        self.status.force_max = self.status.force_max.max(wrench.force.norm());
        if tick.time >= self.status_due {
            self.status.energy = sample.energy.energy;
            self.status.energy_min = sample.energy.energy_min;
            self.status.dissipated = sample.energy.dissipated;
            self.status.injected_damping = sample.energy.damping;
            self.status.damping_power = sample.energy.power;
            self.status.felt_stiffness = self.felt.value().unwrap_or(0.0);
            out.put(self.hand, self.status);
            self.status_due = tick.time + self.status_period;
        }
        self.before = Some(sample);
        Ok(())
    }
}

/// Converts the driver's sample to the scene's component.
fn device_state(sample: &DeviceSample) -> DeviceState {
    let state = &sample.state;
    DeviceState {
        // Bit-identical to the measurement, so that a replay of the recording renders the same force.
        handle_in_device: Pose::from(state.pose_in_device),
        velocity_in_device: Velocity { linear: state.linear_velocity, angular: state.angular_velocity },
        gripper: state.gripper,
        buttons: state.buttons,
        connected: state.connected,
        applied_force: sample.applied.force,
        sampled_at: SimTime(sample.sampled_at_ns),
    }
}

/// Renormalises a rotation: products of rotations drift off unit length.
fn renormalised(pose: &Isometry3<f64>) -> Pose {
    let mut rotation = pose.rotation;
    rotation.renormalize();
    Pose::new(pose.translation.vector, rotation)
}
