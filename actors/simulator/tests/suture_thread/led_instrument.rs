//! Instruments that hands lead, and a thread in their way: nothing passes through, and the force is that of the coupling.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_dynamics::instrument::hand_coupling::HandCoupling;
use trocar_simulator::suture_thread::{
    HOLD_STIFFNESS, Hold, LedInstrument, LedMotion, Obstacle, Shape, Surroundings, Thread, ThreadMaterial,
    TwistHold,
};

/// A shaft across the thread \[m\].
const RADIUS: f64 = 1.8e-3;
/// Half of the distance between the thread's ends, which are held \[m\].
const HALF: f64 = 0.015;
const MASS: f64 = 0.03;

/// A thread along x whose ends are held, and a shaft along z that a hand leads along y.
struct Stage {
    thread: Thread,
    nodes: Vec<Point3<f64>>,
    directors: [Vector3<f64>; 2],
    led: LedInstrument,
    /// Of the shaft's axis: where the hand leads it, and where it is \[m\].
    hand: f64,
    /// Largest force of the coupling and of the contact, and largest tension so far \[N\].
    most: [f64; 3],
}

impl Stage {
    fn new(stiffness: f64, force_max: f64) -> Self {
        let nodes: Vec<Point3<f64>> =
            (0..=60).map(|k| Point3::new(-HALF + 5e-4 * f64::from(k), 0.0, 0.0)).collect();
        let thread = Thread::new(ThreadMaterial::silk_2_0(), &nodes).expect("a thread");
        let directors = [thread.state().directors[0], thread.state().directors[nodes.len() - 2]];
        let led = LedInstrument {
            obstacles: [0, 0],
            coupling: HandCoupling::critically_damped(MASS, stiffness, force_max),
            offset: Vector3::zeros(),
            velocity: Vector3::zeros(),
        };
        Self { thread, nodes, directors, led, hand: -5e-3, most: [0.0; 3] }
    }

    fn step(&mut self, speed: f64, dt: f64, friction: f64) -> LedMotion {
        let last = self.nodes.len() - 1;
        let holds = [Hold::fixed(0, self.nodes[0]), Hold::fixed(last, self.nodes[last])];
        let twist_holds = [(0, self.directors[0]), (last - 1, self.directors[1])]
            .map(|(edge, director)| TwistHold { edge, director });
        let at = |y: f64| Isometry3::translation(2e-4, y, 0.0);
        let obstacles = [Obstacle {
            shape: Shape::Capsule { ends: [-0.02, 0.02].map(|z| Point3::new(0.0, 0.0, z)), radius: RADIUS },
            from: at(self.hand),
            to: at(self.hand + speed * dt),
            friction,
            mobility: None,
        }];
        let led = [self.led];
        let around = Surroundings {
            holds: &holds,
            twist_holds: &twist_holds,
            obstacles: &obstacles,
            led: &led,
            ..Surroundings::default()
        };
        self.thread.step(dt, &around).unwrap_or_else(|error| panic!("{speed} m/s, {dt} s: {error}"));
        self.hand += speed * dt;
        let motion = self.thread.led()[0];
        (self.led.offset, self.led.velocity) = (motion.offset, motion.velocity);
        let tension = self.thread.state().tensions.iter().copied().fold(0.0, f64::max);
        let forces = [motion.impulse.norm() / dt, self.thread.reactions()[0].force.norm(), tension];
        self.most = std::array::from_fn(|k| self.most[k].max(forces[k]));
        motion
    }

    /// Leads the shaft to `hand` at a speed, and waits there. Panics where the thread gets to its other side.
    fn lead(&mut self, hand: f64, speed: f64, dt: f64, friction: f64) -> LedMotion {
        while self.hand < hand - 1e-9 {
            self.step(speed.min((hand - self.hand) / dt), dt, friction);
            self.is_in_front();
        }
        for _ in 0..(0.12 / dt) as usize {
            self.step(0.0, dt, friction);
            self.is_in_front();
        }
        self.step(0.0, dt, friction)
    }

    /// The shaft's axis is behind the thread, and no node is in the shaft by more than a tenth of a radius.
    fn is_in_front(&self) {
        let axis = self.axis();
        let positions = &self.thread.state().positions;
        let highest = positions.iter().map(|node| node.y).fold(f64::MIN, f64::max);
        assert!(highest > axis + 0.9 * RADIUS, "it is through: {highest} {axis}, {:?}", self.most);
        let nearest =
            positions.iter().map(|node| (node.x - 2e-4).hypot(node.y - axis)).fold(f64::MAX, f64::min);
        assert!(nearest > 0.9 * RADIUS, "{nearest} m from the axis");
    }

    fn axis(&self) -> f64 {
        self.hand + self.led.offset.y
    }
}

/// Where the axis of a shaft stands that a spring pulls from `hand`, behind a straight thread without friction whose ends
/// are held, and the force: tangents to the shaft, an arc around it, and Hooke's law of the thread and of its holds.
fn in_balance(hand: f64, stiffness: f64, force_max: f64) -> [f64; 2] {
    let material = ThreadMaterial::silk_2_0();
    let radius = RADIUS + material.radius;
    let of_thread = |axis: f64| {
        let distance = HALF.hypot(axis);
        let slope = axis.atan2(HALF) + (radius / distance).asin();
        let length = (distance * distance - radius * radius).sqrt() + radius * slope;
        // The thread and the hold of its end are stretched by one tension.
        let tension = (length - HALF) / (HALF / material.axial_stiffness + 1.0 / HOLD_STIFFNESS);
        if slope <= 0.0 { 0.0 } else { 2.0 * tension * slope.sin() }
    };
    let (mut low, mut high) = (-radius, hand);
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        let pulled = (stiffness * (hand - middle)).min(force_max);
        if of_thread(middle) < pulled { low = middle } else { high = middle }
    }
    [low, of_thread(low)]
}

#[test]
fn a_shaft_led_behind_a_held_thread_stands_where_the_coupling_and_the_thread_balance() {
    for (stiffness, force_max, hand) in [
        (1000.0, 20.0, 0.004),
        (1000.0, 20.0, 0.012),
        (200.0, 20.0, 0.012),
        (5000.0, 50.0, 0.006),
        // At its bound the hand pulls with just that.
        (1000.0, 5.0, 0.030),
    ] {
        let mut stage = Stage::new(stiffness, force_max);
        let motion = stage.lead(hand, 0.05, 1e-3, 0.0);
        let [axis, force] = in_balance(hand, stiffness, force_max);
        let (contact, coupling) = (-stage.thread.reactions()[0].force.y, motion.impulse.y / -1e-3);
        let found = format!(
            "k {stiffness}, {hand} m: axis {} of {axis}, {contact} N and {coupling} N of {force}",
            stage.axis()
        );
        assert!((contact / force - 1.0).abs() < 0.01 && (coupling / contact - 1.0).abs() < 1e-3, "{found}");
        assert!((stage.axis() - axis).abs() < 3e-5, "{found}");
        assert!(stage.led.velocity.norm() < 1e-4, "{found}");
    }
}

#[test]
fn no_shaft_passes_through_a_held_thread_at_any_speed_and_step() {
    let (hand, stiffness, bound) = (0.012, 1000.0, 20.0);
    for speed in [0.1, 0.5, 1.0] {
        for dt in [2e-3, 1e-3, 2.5e-4] {
            for friction in [0.0, 0.3] {
                let mut stage = Stage::new(stiffness, bound);
                stage.lead(hand, speed, dt, friction);
                let [coupling, contact, _] = stage.most;
                let found = format!("{speed} m/s, {dt} s, μ {friction}: {:?}", stage.most);
                assert!(coupling <= bound * (1.0 + 1e-9), "{found}");
                // Beyond the coupling's bound there is only the instrument's own momentum: the thread takes its kinetic
                // energy over a way that grows with the fourth root of the energy.
                let energy = 0.5 * MASS * speed * speed;
                let axial = ThreadMaterial::silk_2_0().axial_stiffness;
                let way = (4.0 * energy * HALF.powi(3) / axial).powf(0.25);
                let stopping = axial * (way / HALF).powi(3);
                assert!(contact <= 1.3 * (bound + stopping), "{found}, {stopping} N to stop it");
                let [axis, _] = in_balance(hand, stiffness, bound);
                if friction == 0.0 {
                    assert!((stage.axis() - axis).abs() < 5e-5, "{found}: {} of {axis}", stage.axis());
                }
            }
        }
    }
}

#[test]
fn a_led_instrument_that_touches_nothing_is_where_its_hand_leads_it_and_comes_back_without_ringing() {
    let mut stage = Stage::new(1000.0, 20.0);
    stage.hand = -0.05;
    for _ in 0..20 {
        assert_eq!(stage.step(0.5, 1e-3, 0.2), LedMotion::default());
    }
    // Let go 4 mm from there.
    stage.led.offset = Vector3::new(0.0, 0.0, 4e-3);
    let mut last = 4e-3;
    for _ in 0..80 {
        let offset = stage.step(0.0, 1e-3, 0.2).offset.z;
        assert!((0.0..=last).contains(&offset), "{offset} after {last} m");
        last = offset;
    }
    assert!(last < 1e-6, "{last} m left");
}
