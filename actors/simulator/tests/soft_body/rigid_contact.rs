//! Detected contacts between soft and rigid bodies: action and reaction are equal, at a mass ratio of 1:100 and a rate
//! ratio of 10:1 either way, and no energy is created.

use std::sync::Arc;

use crate::support::stage::other::Other;
use crate::support::stage::{Stage, scene_with};
use nalgebra::{Matrix3, Point3, Vector3};
use trocar_collision::controller::{ObbTreeConfig, ObbTreeController};
use trocar_dynamics::rigid_bodies::RigidBodiesController;
use trocar_dynamics::rigid_world::Inertia;
use trocar_dynamics::soft_body::contact::{
    AppliedTotals, ContactSums, ImpulseTotals, RigidContacts, SoftContacts,
};
use trocar_scene::{
    Access, BuildContext, Commands, Controller, ControllerError, Frozen, Measured, Pose, Snapshot, Store,
    Tick, Velocity, VertexPositions, VertexVelocities,
};
use trocar_simulator::controller::{DynamicFemController, MassSpringController, XpbdController};
use trocar_simulator::impulse_world::{ImpulseWorld, RigidSettings};

const SOFT: u16 = 9;
const RIGID: u16 = 10;
const DETECTOR: u16 = 11;
/// Largest momentum loss relative to the exchanged momentum.
const MOMENTUM: f64 = 1e-6;
/// Mass of a cube of 2 cm \[kg\].
const SOFT_MASS: f64 = 8e-3;

/// The clock of the stage: it does nothing.
struct Nobody;

impl Controller for Nobody {
    fn access(&self) -> Access {
        Access::new()
    }
    fn tick(&mut self, _: &Tick<'_>, _: &Snapshot, _: &mut Commands) -> Result<(), ControllerError> {
        Ok(())
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Method {
    Springs,
    Positions,
    Elements,
}

const METHODS: [Method; 3] = [Method::Springs, Method::Positions, Method::Elements];

impl Method {
    fn text(self, damping: f64) -> String {
        match self {
            Self::Springs => format!(
                "mass_spring = {{ springs = {{ volume = {{ young_modulus = 2e4, density = 1000.0 }} }}, \
                 damping = {damping}, friction = 0.2 }}"
            ),
            Self::Positions => format!(
                "xpbd = {{ matter = {{ volume = {{ young_modulus = 2e4, poisson_ratio = 0.3, density = 1000.0 }} }}, \
                 parts = 10, damping = {damping}, friction = 0.2 }}"
            ),
            Self::Elements => format!(
                "dynamic_fem = {{ young_modulus = 2e4, poisson_ratio = 0.3, density = 1000.0, \
                 mass_damping = {damping}, stiffness_damping = 0.0, friction = 0.2 }}"
            ),
        }
    }

    fn on(self, stage: &Stage<Nobody>, every: u32, gravity: Vector3<f64>) -> Other {
        match self {
            Self::Springs => Other::new(stage, SOFT, every, |c| MassSpringController::new(gravity, c)),
            Self::Positions => Other::new(stage, SOFT, every, |c| XpbdController::new(gravity, c)),
            Self::Elements => Other::new(stage, SOFT, every, |c| DynamicFemController::new(gravity, c)),
        }
    }
}

/// A pair of bodies with methods and rates.
struct Pair {
    stage: Stage<Nobody>,
    method: Method,
    gravity: Vector3<f64>,
    soft: Other,
    rigid: Other,
    detector: Other,
    /// Initial inertia published by the rigid body.
    inertia: Option<Inertia>,
}

fn rigid(
    gravity: Vector3<f64>,
    context: &BuildContext<'_>,
) -> Result<RigidBodiesController<ImpulseWorld>, ControllerError> {
    let settings =
        RigidSettings { gravity_in_world: gravity, floor_height: None, ..RigidSettings::default() };
    RigidBodiesController::<ImpulseWorld>::new(context, settings)
        .map_err(|error| ControllerError::Scene(error.to_string()))
}

fn scene(text: &str) -> Store {
    scene_with(text, |builder| trocar_collision::controller::register(builder).expect("names are free"))
}

/// Measurements at one time.
struct Moment {
    /// Momentum of both, including impulses in transit \[N·s\], and the part received by the rigid body so far.
    momentum: Vector3<f64>,
    got: Vector3<f64>,
    /// Spin of the rigid body with impulses in transit \[N·m·s\]: it began without any.
    of_rigid: Vector3<f64>,
    given: ImpulseTotals,
    /// Energy of both, with impulses in transit applied \[J\].
    energy: f64,
}

impl Pair {
    /// Rates as step durations in milliseconds.
    fn new(text: &str, method: Method, [soft, rigid_every]: [u32; 2], gravity: Vector3<f64>) -> Self {
        let stage = Stage::new(scene(text), 1000.0, |_| Ok(Nobody));
        let soft = method.on(&stage, soft, gravity);
        let rigid = Other::new(&stage, RIGID, rigid_every, |context| rigid(gravity, context));
        let pairs = vec![["rigid", "body"].map(str::to_owned)];
        let config = ObbTreeConfig { pairs, stiffness: 500.0 };
        let detector = Other::new(&stage, DETECTOR, 1, |context| ObbTreeController::new(&config, context));
        Self { stage, method, gravity, soft, rigid, detector, inertia: None }
    }

    fn run(&mut self) {
        for other in [&mut self.detector, &mut self.soft, &mut self.rigid] {
            if self.stage.ticks.is_multiple_of(u64::from(other.every)) {
                other.tick(&mut self.stage);
            }
        }
        self.stage.tick();
        self.inertia = self.inertia.or_else(|| Some(self.stage.get::<RigidContacts>("rigid").inertia));
        for name in ["body", "rigid"] {
            assert!(!self.stage.has::<Frozen>(name), "{name}: {}", self.stage.get::<Frozen>(name).reason);
        }
    }

    fn kill(&mut self) {
        let gravity = self.gravity;
        self.rigid.rebuild(&self.stage, |context| rigid(gravity, context));
        match self.method {
            Method::Springs => self.soft.rebuild(&self.stage, |c| MassSpringController::new(gravity, c)),
            Method::Positions => self.soft.rebuild(&self.stage, |c| XpbdController::new(gravity, c)),
            Method::Elements => self.soft.rebuild(&self.stage, |c| DynamicFemController::new(gravity, c)),
        }
    }

    fn measured(&self, what: &str) -> f64 {
        let all = self.stage.store.view().get::<Measured>(self.soft.me).expect("it measures");
        all.values[what]
    }

    fn given(&self) -> [ImpulseTotals; 2] {
        let of = |name: &str| Some(self.stage.entity(name));
        let given = self.stage.get::<SoftContacts>("body").given_whole;
        let given = given.into_iter().find(|sums| sums.body == of("rigid")).unwrap_or_default();
        let taken = self.stage.get::<RigidContacts>("rigid").taken;
        let taken = taken.into_iter().find(|known| known.taken.body == of("body")).unwrap_or_default().taken;
        [given, taken]
    }

    /// `None` until the two have met.
    fn moment(&self) -> Option<Moment> {
        if !self.stage.has::<SoftContacts>("body") {
            return None;
        }
        let masses = self.stage.get::<SoftContacts>("body").masses_inverse;
        let speeds = self.stage.get::<VertexVelocities>("body").velocities;
        let of_soft: Vector3<f64> =
            masses.iter().zip(speeds.iter()).map(|(inverse, speed)| speed / *inverse).sum();
        let told = self.inertia?;
        let pose = self.stage.get::<Pose>("rigid").isometry();
        let motion = self.stage.get::<Velocity>("rigid");
        let centre: Point3<f64> = pose * told.centre_in_body;
        let velocity = motion.linear + motion.angular.cross(&(centre.coords - pose.translation.vector));
        let turn = pose.rotation.to_rotation_matrix();
        let inverse: Matrix3<f64> = turn.matrix() * told.inertia_inverse_in_body * turn.matrix().transpose();
        let inertia = inverse.try_inverse().expect("it turns");
        let (mass, momentum) = (1.0 / told.mass_inverse, velocity / told.mass_inverse);
        let spin = inertia * motion.angular;
        let [given, taken] = self.given();
        let (late, late_moment) = (given.impulse - taken.impulse, given.moment - taken.moment);
        let (then, spin_then) = (momentum + late, spin + late_moment);
        let kinetic = 0.5 * (then.norm_squared() / mass + spin_then.dot(&(inverse * spin_then)));
        Some(Moment {
            momentum: of_soft + then,
            got: given.impulse,
            of_rigid: spin_then,
            given,
            energy: kinetic + self.measured("body.kinetic_energy_j") + self.measured("body.elastic_energy_j"),
        })
    }
}

/// A soft cube at rest, and a rigid block that falls on it off-centre, slowly sideways.
fn falls_on(method: Method, mass: f64) -> String {
    format!(
        "[[entity]]\nname = \"body\"\npose = {{ translation = [0.05, 0.0, 0.0] }}\n\
         mesh = {{ block = {{ size = [0.02, 0.02, 0.02], cells = [3, 3, 3] }} }}\n{}\n\
         [[entity]]\nname = \"rigid\"\npose = {{ translation = [0.052, 0.001, 0.016] }}\n\
         mesh = {{ shape = {{ box = {{ half_extents = [0.007, 0.0065, 0.005] }} }} }}\n\
         rigid_body = {{ motion = \"dynamic\", mass = {mass} }}\n\
         velocity = {{ linear = [0.02, 0.0, -{SPEED}], angular = [0.0, 0.0, 0.0] }}\n",
        method.text(0.0)
    )
}

const SPEED: f64 = 0.1;

/// Result of a pair: largest momentum loss relative to the exchanged momentum, and largest energy relative to the
/// initial one.
struct Outcome {
    lost: f64,
    lost_turning: f64,
    energy: f64,
    exchanged: f64,
    end: Arc<Vec<Point3<f64>>>,
    pose: Pose,
}

fn meet(
    method: Method,
    mass: f64,
    rates: [u32; 2],
    kills: &[usize],
    mut meddle: impl FnMut(&mut Pair, usize),
) -> Outcome {
    let mut pair = Pair::new(&falls_on(method, mass), method, rates, Vector3::zeros());
    let whole = Vector3::new(0.02, 0.0, -SPEED) * mass;
    let energy = 0.5 * whole.norm_squared() / mass;
    let (mut lost, mut lost_turning, mut most, mut exchanged) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
    for tick in 0..400 {
        pair.run();
        meddle(&mut pair, tick);
        if kills.contains(&tick) {
            pair.kill();
        }
        let Some(moment) = pair.moment() else { continue };
        exchanged = exchanged.max(moment.got.norm());
        lost = lost.max((moment.momentum - whole).norm());
        lost_turning = lost_turning.max((moment.of_rigid - moment.given.moment).norm());
        most = most.max(moment.energy / energy);
    }
    let reach = 0.05;
    Outcome {
        lost: lost / exchanged,
        lost_turning: lost_turning / (exchanged * reach),
        energy: most,
        exchanged,
        end: pair.stage.get::<VertexPositions>("body").positions,
        pose: pair.stage.get::<Pose>("rigid"),
    }
}

const RATES: [[u32; 2]; 3] = [[1, 1], [1, 10], [10, 1]];
const MASSES: [f64; 3] = [SOFT_MASS / 100.0, SOFT_MASS, SOFT_MASS * 100.0];

#[test]
fn what_a_soft_body_gets_of_a_rigid_one_that_one_loses() {
    for method in METHODS {
        for rates in RATES {
            for mass in MASSES {
                let what = format!("{method:?}, {mass} kg, {rates:?} ms");
                let Outcome { lost, lost_turning, energy, exchanged, .. } =
                    meet(method, mass, rates, &[], |_, _| {});
                assert!(exchanged > 0.5 * SPEED * mass.min(SOFT_MASS), "{what}: {exchanged} N·s");
                assert!(lost < MOMENTUM, "{what}: {lost} of momentum is lost");
                assert!(lost_turning < MOMENTUM, "{what}: {lost_turning} of angular momentum is lost");
                assert!(energy < 1.0 + 1e-9, "{what}: energy grows to {energy} of what it was");
            }
        }
    }
}

#[test]
fn impulses_that_get_lost_and_masses_that_are_not_known_are_seen() {
    // Impulses in transit when the rigid body restarts count as received.
    let mut has_been_lost = false;
    let lossy = meet(Method::Springs, MASSES[1], [1, 10], &[11, 13, 15, 17], |pair, tick| {
        if [11, 13, 15, 17].contains(&tick) {
            let [given, taken] = pair.given();
            has_been_lost |= given.impulse != taken.impulse;
            let mut told = pair.stage.get::<RigidContacts>("rigid");
            let sums = ImpulseTotals { body: Some(pair.stage.entity("body")), ..given };
            told.taken = vec![AppliedTotals { taken: sums, seen: sums, left: 0.0 }];
            pair.stage.put("rigid", told);
        }
    });
    assert!(has_been_lost && lossy.lost > 1e-3, "{}", lossy.lost);
    // The soft body takes the light rigid one for a heavy one.
    let blind = meet(Method::Springs, MASSES[0], [1, 10], &[], |pair, _| {
        let mut told = pair.stage.get::<RigidContacts>("rigid");
        if let Some(Inertia { mass_inverse, centre_in_body, inertia_inverse_in_body }) = pair.inertia {
            let inertia_inverse_in_body = inertia_inverse_in_body * 1e-3;
            told.inertia =
                Inertia { mass_inverse: 1e-3 * mass_inverse, centre_in_body, inertia_inverse_in_body };
            pair.stage.put("rigid", told);
        }
    });
    assert!(blind.lost < MOMENTUM && blind.energy > 1.1, "{} {}", blind.lost, blind.energy);
}

#[test]
fn either_of_the_two_begins_another_life_without_losing_an_impulse() {
    for method in METHODS {
        for rates in RATES {
            let go = |kills: &[usize]| meet(method, MASSES[1], rates, kills, |_, _| {});
            let (killed, whole) = (go(&[20, 33, 47, 48, 61, 90, 150]), go(&[]));
            let what = format!("{method:?}, {rates:?} ms");
            assert!(killed.lost < MOMENTUM, "{what}: {}", killed.lost);
            let ends = killed.end.iter().zip(whole.end.iter());
            let apart = ends.map(|(one, other)| (one - other).norm()).fold(0.0, f64::max);
            let apart = apart.max((killed.pose.translation - whole.pose.translation).norm());
            assert!(apart < 1e-8, "{what}: they end {apart} m apart");
        }
    }
}

/// A soft cube supported from below, and a rigid plate slightly above it.
fn lies_on(method: Method, mass: f64) -> String {
    let soft = method.text(20.0).replace("young_modulus = 2e4", "young_modulus = 1e5");
    format!(
        "[[entity]]\nname = \"body\"\npose = {{ translation = [0.05, 0.0, 0.0] }}\n\
         mesh = {{ block = {{ size = [0.02, 0.02, 0.02], cells = [3, 3, 3] }} }}\n{soft}\n\
         anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0099] }} }}] }}\n\
         [[entity]]\nname = \"rigid\"\npose = {{ translation = [0.0505, 0.0, 0.0131] }}\n\
         mesh = {{ shape = {{ box = {{ half_extents = [0.008, 0.0075, 0.003] }} }} }}\n\
         rigid_body = {{ motion = \"dynamic\", mass = {mass} }}\n"
    )
}

#[test]
fn a_rigid_plate_comes_to_lie_on_a_soft_cube_that_bears_its_weight() {
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let mass = 0.005;
    for method in METHODS {
        // At 100 Hz a light vertex is too compliant to bear it.
        for rates in [[1, 1], [1, 10], [2, 1]] {
            let what = format!("{method:?}, {rates:?} ms");
            let mut pair = Pair::new(&lies_on(method, mass), method, rates, gravity);
            (0..1500).for_each(|_| pair.run());
            let [before, _] = pair.given();
            (0..500).for_each(|_| pair.run());
            let [after, taken] = pair.given();
            let borne = (after.impulse - before.impulse) / 0.5;
            let weight = -gravity * mass;
            let late = (after.impulse - taken.impulse).norm();
            let (pose, motion) = (pair.stage.get::<Pose>("rigid"), pair.stage.get::<Velocity>("rigid"));
            assert!((borne - weight).norm() < 0.02 * weight.norm(), "{what}: {borne:?} N bear {weight:?} N");
            assert!(late <= 0.021 * weight.norm(), "{what}: {late} N·s are on their way");
            assert!((pose.translation.z - 0.013).abs() < 5e-4, "{what}: it lies at {:?}", pose.translation);
            assert!(motion.linear.norm() < 0.01, "{what}: it moves by {:?}", motion.linear);
        }
    }
}

/// Two soft cubes of two controllers.
fn cubes(first: Method, densities: [f64; 2]) -> String {
    let [one, other] = densities;
    let first = first.text(0.0).replace("density = 1000.0", &format!("density = {one}"));
    let second = Method::Positions.text(0.0).replace("density = 1000.0", &format!("density = {other}"));
    format!(
        "[[entity]]\nname = \"body\"\nmesh = {{ block = {{ size = [0.02, 0.02, 0.02], cells = [3, 3, 3] }} }}\n{first}\n\
         [[entity]]\nname = \"rigid\"\npose = {{ translation = [0.002, 0.001, 0.018] }}\n\
         mesh = {{ block = {{ size = [0.015, 0.015, 0.015], cells = [3, 3, 3] }} }}\n{second}\n"
    )
}

#[test]
fn two_soft_bodies_of_two_controllers_lose_nothing_to_each_other() {
    let densities = [[1000.0, 24.0], [1000.0, 2370.0], [100.0, 23_700.0]];
    for first in [Method::Springs, Method::Elements] {
        for rates in RATES {
            for densities in densities {
                exchange(first, rates, densities);
            }
        }
    }
}

fn exchange(first: Method, [one, other]: [u32; 2], densities: [f64; 2]) {
    let mut stage = Stage::new(scene(&cubes(first, densities)), 1000.0, |_| Ok(Nobody));
    let down = Arc::new(vec![Vector3::new(0.02, 0.0, -SPEED); 64]);
    stage.put("rigid", VertexVelocities { velocities: down });
    let still = Vector3::zeros();
    let soft = first.on(&stage, one, still);
    let second = Other::new(&stage, RIGID, other, |context| XpbdController::new(still, context));
    let pairs = vec![["rigid", "body"].map(str::to_owned)];
    let config = ObbTreeConfig { pairs, stiffness: 500.0 };
    let detector = Other::new(&stage, DETECTOR, 1, |context| ObbTreeController::new(&config, context));
    let mut all = [detector, soft, second];
    let mass = 0.015_f64.powi(3) * densities[1];
    let whole = Vector3::new(0.02, 0.0, -SPEED) * mass;
    let (mut lost, mut most, mut exchanged) = (0.0_f64, 0.0_f64, 0.0_f64);
    for _ in 0..400 {
        for controller in &mut all {
            if stage.ticks.is_multiple_of(u64::from(controller.every)) {
                controller.tick(&mut stage);
            }
        }
        stage.tick();
        if !["body", "rigid"].iter().all(|name| stage.has::<SoftContacts>(name)) {
            continue;
        }
        let mut momentum = Vector3::zeros();
        let mut energy = 0.0;
        for (of, from, controller) in [("body", "rigid", &all[1]), ("rigid", "body", &all[2])] {
            assert!(!stage.has::<Frozen>(of));
            let told = stage.get::<SoftContacts>(of);
            let sums = |of: &[ContactSums], body: &str, vertex: usize| -> Vector3<f64> {
                let all = of.iter().filter(|sums| sums.body == Some(stage.entity(body)));
                let mine = all.flat_map(|sums| sums.vertices.iter().zip(&sums.sums));
                mine.filter(|(of, _)| **of as usize == vertex).map(|(_, sum)| *sum).sum()
            };
            let given = stage.get::<SoftContacts>(from).given;
            let all: Vector3<f64> = given.iter().flat_map(|given| &given.sums).sum();
            exchanged = exchanged.max(all.norm());
            let speeds = stage.get::<VertexVelocities>(of).velocities;
            let measured =
                stage.store.view().get::<Measured>(controller.me).expect("it measures").values.clone();
            energy +=
                measured[&format!("{of}.kinetic_energy_j")] + measured[&format!("{of}.elastic_energy_j")];
            for (vertex, (speed, inverse)) in speeds.iter().zip(told.masses_inverse.iter()).enumerate() {
                let late = sums(&given, of, vertex) - sums(&told.taken, from, vertex);
                momentum += speed / *inverse + late;
                energy += late.dot(speed) + 0.5 * late.norm_squared() * inverse;
            }
        }
        lost = lost.max((momentum - whole).norm());
        most = most.max(energy / (0.5 * whole.norm_squared() / mass));
    }
    let what = format!("{first:?}, {densities:?} kg/m³, [{one}, {other}] ms");
    let least = mass.min(8e-6 * densities[0]) * SPEED;
    assert!(exchanged > 0.5 * least, "{what}: {exchanged} N·s");
    assert!(lost < MOMENTUM * exchanged, "{what}: {lost} N·s are lost");
    assert!(most < 1.0 + 1e-9, "{what}: energy grows to {most} of what it was");
}
