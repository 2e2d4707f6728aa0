//! A hand on a bench, in virtual time: the real driver core and virtual hand, the real controller, the real
//! store, and a toy engine that knows one wall.

#![allow(dead_code, reason = "each test binary uses a part of the bench")]

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use trocar_devices::{
    DeviceFaults, DeviceMonitor, DeviceSample, DeviceSlot, DriverConfig, DriverCore, HapticDevice,
    VirtualHand, VirtualHandConfig, link,
};
use trocar_haptics::{HapticsConfig, HapticsController};
use trocar_scene::{
    BuildContext, Commands, ContactPlane, Controller, Entity, EntityAllocator, Events, Hand, HandTarget,
    HapticStatus, Instrument, InstrumentForce, InstrumentTarget, Jobs, LocalContactModel, Port, Pose,
    Registry, Side, SimTime, Store, Tick, Velocity, WriterRules,
};

pub const HAND: Entity = Entity::new(0, 0, 1);
pub const INSTRUMENT: Entity = Entity::new(0, 0, 2);
pub const PORT: Entity = Entity::new(0, 0, 3);
const HAPTICS: u16 = 2;

/// Stiffness of the toy engine's coupling and of the wall that it publishes [N/m].
pub const WALL_STIFFNESS: f64 = 1000.0;

/// A wall of the toy engine.
#[derive(Clone, Copy, Debug)]
pub struct Wall {
    pub point_in_world: Vector3<f64>,
    pub normal_in_world: Vector3<f64>,
    pub friction: f64,
    /// Damping that the toy engine publishes with its plane [N·s/m].
    pub damping: f64,
    /// Radius of a sphere that bulges out of the wall's point, [m]; a plane without.
    pub radius: Option<f64>,
    /// From how far away the engine publishes its plane [m].
    pub reach: f64,
    /// Steps per second of the toy engine.
    pub rate: u64,
    pub base_force: Vector3<f64>,
}

/// How the instrument is mounted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mount {
    /// Free six degrees of freedom, device and world axes equal.
    Free,
    /// Through a frictionless port, shaft downwards at the start.
    Port,
    /// Through a port with the default seal.
    SealedPort,
}

pub struct Bench {
    pub now: SimTime,
    pub store: Store,
    pub driver: DriverCore,
    pub device: VirtualHand,
    pub faults: DeviceFaults,
    pub slot: DeviceSlot,
    pub monitor: DeviceMonitor,
    pub controller: HapticsController,
    pub config: HapticsConfig,
    pub wall: Wall,
    pub epoch: u32,
    /// Of driver and haptics.
    pub period: SimTime,
    ticks: u64,
    out: Commands,
    rules: WriterRules,
    engine_out: Commands,
    jobs: Jobs,
}

/// Where the tip is at the start, for each mount.
pub fn start_tip(mount: Mount) -> Vector3<f64> {
    match mount {
        Mount::Free => Vector3::new(0.0, 0.0, 0.33),
        Mount::Port | Mount::SealedPort => Vector3::zeros(),
    }
}

impl Wall {
    /// A rigid, frictionless plane through `point` for an engine of `rate` steps per second.
    pub fn plane(point_in_world: Vector3<f64>, normal_in_world: Vector3<f64>, rate: u64) -> Self {
        Self {
            point_in_world,
            normal_in_world,
            friction: 0.0,
            // A real engine publishes its coupling's damping: more than a hand-held device bears.
            damping: 9.0,
            radius: None,
            reach: f64::INFINITY,
            rate,
            base_force: Vector3::zeros(),
        }
    }

    /// The tangent plane nearest to a tip: point and normal.
    fn tangent(&self, tip: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let Some(radius) = self.radius else { return (self.point_in_world, self.normal_in_world) };
        let centre = self.point_in_world - self.normal_in_world * radius;
        let normal = (tip - centre).normalize();
        (centre + normal * radius, normal)
    }
}

impl Bench {
    pub fn new(hand: VirtualHandConfig, config: HapticsConfig, mount: Mount, wall: Wall) -> Self {
        let registry = Registry::standard();
        let mut setup = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
        assert_eq!([setup.spawn(), setup.spawn(), setup.spawn()], [HAND, INSTRUMENT, PORT]);
        let port_height = 0.17;
        let world_from_device = match mount {
            Mount::Free => Pose::default(),
            // The handle starts above the port and points down: 0.33 m of shaft end at the origin.
            _ => Pose::new(
                Vector3::new(0.0, 0.0, 0.33),
                UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
            ),
        };
        setup.put(HAND, Hand { side: Side::Left, instrument: INSTRUMENT, world_from_device, scale: 1.0 });
        let port = (mount != Mount::Free).then_some(PORT);
        setup.put(INSTRUMENT, Instrument { port, ..Instrument::default() });
        let (seal, none) = (Port::default(), 0.0);
        setup.put(
            PORT,
            if mount == Mount::SealedPort {
                seal
            } else {
                Port { axial_damping: none, axial_friction: none, angular_damping: none, ..seal }
            },
        );
        setup.put(PORT, Pose::at(0.0, 0.0, port_height));
        let mut store = Store::new(registry.clone());
        store.apply(&mut setup, SimTime::ZERO);

        let device = VirtualHand::new(hand).unwrap();
        let faults = DeviceFaults::new();
        let (end, slot, monitor) = link();
        let driver = DriverCore::new(DriverConfig::default(), &device, end, faults.clone());
        let controller = build(&store, &slot, &device, config, SimTime::ZERO, 1);
        let allocator = EntityAllocator::new(0, HAPTICS);
        let rules = WriterRules::compile(&controller.access(), &registry, allocator.me()).unwrap();
        Self {
            now: SimTime::ZERO,
            store,
            driver,
            device,
            faults,
            slot,
            monitor,
            controller,
            config,
            wall,
            epoch: 1,
            period: SimTime::from_millis(1),
            ticks: 0,
            out: Commands::new(registry.clone(), allocator),
            rules,
            engine_out: Commands::new(registry, EntityAllocator::new(0, 9)),
            jobs: Jobs::default(),
        }
    }

    /// The trainee wants the handle there (device frame, [m]).
    pub fn aim(&mut self, position: Vector3<f64>) {
        let handle_in_device = Pose::new(position, UnitQuaternion::identity());
        self.engine_out.put(HAND, HandTarget { handle_in_device, gripper: 0.3 });
        self.store.apply(&mut self.engine_out, self.now);
        self.engine_out.clear();
    }

    /// A simulation says this of the force, once.
    pub fn put_force(&mut self, force: Vector3<f64>, at: SimTime) {
        self.engine_out.put(INSTRUMENT, InstrumentForce { force, torque: Vector3::zeros(), at });
        self.store.apply(&mut self.engine_out, self.now);
        self.engine_out.clear();
    }

    /// One period: driver, haptics, engine if due.
    pub fn step(&mut self) {
        self.step_with(|tick| tick());
    }

    /// The same, with `around` called around the controller's tick and nothing else.
    pub fn step_with<R>(&mut self, around: impl FnOnce(&mut dyn FnMut()) -> R) -> R {
        self.driver.step(self.now.as_nanos(), &mut self.device);
        let result = self.tick_controller(around);
        if (self.now.as_nanos() * self.wall.rate).is_multiple_of(1_000_000_000) {
            self.engine();
        }
        self.now += self.period;
        self.ticks += 1;
        result
    }

    /// Only the haptic tick; its commands are validated and applied.
    fn tick_controller<R>(&mut self, around: impl FnOnce(&mut dyn FnMut()) -> R) -> R {
        self.out.begin(self.now);
        let snapshot = self.store.snapshot();
        let tick = Tick {
            time: self.now,
            period: self.period,
            number: self.ticks,
            me: self.out.me(),
            epoch: self.epoch,
            events: Events::new(snapshot.events(), snapshot.events().next()),
            jobs: &self.jobs,
        };
        let (controller, out) = (&mut self.controller, &mut self.out);
        let result = around(&mut || controller.tick(&tick, &snapshot, out).unwrap());
        drop(snapshot);
        self.out.seal();
        self.store.validate(&self.out, &self.rules).unwrap();
        self.store.apply(&mut self.out, self.now);
        self.out.clear();
        result
    }

    pub fn run(&mut self, millis: u64) {
        let end = self.now + SimTime::from_millis(millis);
        while self.now < end {
            self.step();
        }
    }

    /// The controller dies and is rebuilt from the scene, as the supervisor would.
    pub fn restart_controller(&mut self) {
        self.epoch += 1;
        self.slot.fence().raise(self.epoch);
        self.controller = build(&self.store, &self.slot, &self.device, self.config, self.now, self.epoch);
    }

    /// Quasi-static toy physics: the instrument follows the hand, and stops at the wall.
    fn engine(&mut self) {
        let scene = self.store.view();
        let Some(target) = scene.get::<InstrumentTarget>(INSTRUMENT).copied() else { return };
        let wall = &self.wall;
        let wanted = target.tip_in_world.translation;
        let (point, normal) = wall.tangent(&wanted);
        let near = (wanted - point).dot(&normal) < wall.reach;
        let depth = (point - wanted).dot(&normal).max(0.0);
        let proxy = Pose::new(wanted + normal * depth, target.tip_in_world.rotation);
        let push = normal * depth * WALL_STIFFNESS;
        let velocity = if depth > 0.0 { Velocity::default() } else { target.velocity_in_world };
        let plane = ContactPlane {
            point_in_world: Point3::from(point),
            normal_in_world: normal,
            stiffness: WALL_STIFFNESS,
            damping: wall.damping,
            friction: wall.friction,
        };
        let out = &mut self.engine_out;
        out.put(INSTRUMENT, proxy);
        out.put(
            INSTRUMENT,
            InstrumentForce { force: push + wall.base_force, torque: Vector3::zeros(), at: self.now },
        );
        out.put(
            INSTRUMENT,
            LocalContactModel {
                proxy_in_world: proxy,
                proxy_velocity: velocity,
                planes: [near.then_some(plane), None, None, None],
                base_force: wall.base_force,
                at: self.now,
            },
        );
        self.store.apply(out, self.now);
        out.clear();
    }

    pub fn sample(&self) -> DeviceSample {
        self.monitor.sample()
    }
    pub fn status(&self) -> HapticStatus {
        self.store.view().get::<HapticStatus>(HAND).copied().unwrap()
    }
    pub fn target(&self) -> InstrumentTarget {
        self.store.view().get::<InstrumentTarget>(INSTRUMENT).copied().unwrap()
    }
    /// Handle position in the device's frame [m] and force that the driver renders [N].
    pub fn felt(&self) -> (Vector3<f64>, Vector3<f64>) {
        let sample = self.sample();
        (sample.state.pose_in_device.translation.vector, sample.applied.force)
    }
    /// Root mean square of the handle's speed over the next `millis` [m/s].
    pub fn speed_rms(&mut self, millis: u64) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        let end = self.now + SimTime::from_millis(millis);
        while self.now < end {
            self.step();
            sum += self.sample().state.linear_velocity.norm_squared();
            count += 1.0;
        }
        (sum / f64::max(count, 1.0)).sqrt()
    }
}

fn build(
    store: &Store,
    slot: &DeviceSlot,
    device: &VirtualHand,
    config: HapticsConfig,
    now: SimTime,
    epoch: u32,
) -> HapticsController {
    let snapshot = store.snapshot();
    let me = Entity::of_writer(0, HAPTICS);
    let period = SimTime::from_millis(1);
    let context =
        BuildContext { scene: &snapshot, time: now, period, name: "haptics.left", me, epoch, seed: 1 };
    let link = slot.take(epoch).unwrap();
    HapticsController::new(&context, HAND, link, device.capabilities().clone(), config).unwrap()
}

/// A handle pose in the device's frame.
pub fn handle(x: f64, y: f64, z: f64) -> Isometry3<f64> {
    Isometry3::translation(x, y, z)
}
