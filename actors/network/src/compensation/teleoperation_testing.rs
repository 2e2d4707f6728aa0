//! Test bench of the compensation: a hand at a master device, a faulty link, a tool at a wall or in tissue.
//!
//! The hand and its device are a mass on a spring and a damper about an intended way with a tremor; the tool hangs on the
//! slave's command by a spring and a damper. Every sample crosses the link as single precision and bytes.

use nalgebra::Vector3;
use trocar_kernel::faults::{LinkFaults, Message};
use trocar_kernel::spec::{FaultKind, FaultOrder};
use trocar_scene::SimTime;

use super::*;

/// Mass and damping of the device.
const DEVICE: (f64, f64) = (0.1, 0.5);
/// Mass, damping and stiffness of the arm that holds it.
pub type Arm = (f64, f64, f64);
/// An arm as usual, a loose one and a stiff one.
pub const ARMS: [Arm; 3] = [(0.15, 4.0, 300.0), (0.1, 2.0, 100.0), (0.3, 8.0, 800.0)];
/// Mass of the tool and damping of its coupling.
const TOOL: (f64, f64) = (0.05, 10.0);
/// Tremor of the hand: amplitude \[m\] and frequency \[Hz\].
const TREMOR: (f64, f64) = (1e-4, 9.0);
const SUBSTEPS: u32 = 2;
const STEP: f64 = 1e-3;
const SESSION_MS: u64 = 60_000;

/// A sample in a datagram, as its bytes: single precision and the block.
#[derive(Clone, Debug)]
struct Letter {
    number: u64,
    vectors: [Vector3<f32>; 3],
    block: [u8; BLOCK_BYTES],
}

impl Letter {
    fn new(number: u64, sample: &CouplingSample) -> Self {
        let vectors = [sample.position, sample.velocity, sample.force].map(|vector| vector.cast());
        Self { number, vectors, block: sample.block.encode() }
    }
    fn read(&self) -> CouplingSample {
        let [position, velocity, force] = self.vectors.map(|vector| vector.cast());
        let block = CompensationBlock::decode(&self.block).expect("what was written");
        CouplingSample { position, velocity, force, block }
    }
}

impl Message for Letter {
    fn bytes(&self) -> usize {
        244
    }
    fn duplicate(&self) -> Option<Self> {
        Some(self.clone())
    }
    fn through(self, _: &mut dyn FnMut(&mut [u8])) -> Option<Self> {
        Some(self)
    }
}

/// One way of the link, and the newest number that came out.
struct Way {
    faults: LinkFaults<Letter>,
    sent: u64,
    newest: u64,
}

impl Way {
    fn send(&mut self, now: SimTime, sample: &CouplingSample) {
        self.sent += 1;
        self.faults.send(now, Letter::new(self.sent, sample));
    }
    fn newest(&mut self, now: SimTime) -> Option<CouplingSample> {
        let mut newest = None;
        while let Some(letter) = self.faults.due(now) {
            if letter.number > self.newest {
                self.newest = letter.number;
                newest = Some(letter.read());
            }
        }
        newest
    }
}

/// Share of the datagrams that is lost, and their number in a row; 0: each by itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loss {
    pub name: &'static str,
    share: f64,
    burst: f64,
}

pub const LOSSES: [Loss; 4] = [
    Loss { name: "0 %", share: 0.0, burst: 0.0 },
    Loss { name: "5 %", share: 0.05, burst: 0.0 },
    Loss { name: "20 %", share: 0.2, burst: 0.0 },
    Loss { name: "10 % in bursts of 40", share: 0.1, burst: 40.0 },
];
pub const ROUND_TRIPS_MS: [u64; 5] = [0, 50, 100, 300, 1_000];

fn way(round_trip: SimTime, loss: Loss, seed: u64) -> Way {
    let order = |index: u32, kind: FaultKind| FaultOrder {
        index,
        target: "link".to_owned(),
        kind,
        begins: true,
        span: SimTime::ZERO,
        jitter: SimTime::ZERO,
        independent: true,
        delays: Vec::new(),
        every: SimTime::ZERO,
        burst: loss.burst,
        probability: loss.share,
        bytes_per_sec: 0.0,
        seed: seed + u64::from(index),
    };
    let mut faults = LinkFaults::default();
    let one_way = round_trip.as_secs_f64() / 2.0;
    faults.apply(&FaultOrder {
        span: SimTime::from_secs_f64(one_way),
        jitter: SimTime::from_secs_f64(0.2 * one_way),
        probability: 1.0,
        ..order(0, FaultKind::Delay)
    });
    if loss.share > 0.0 {
        faults.apply(&order(2, FaultKind::Drop));
    }
    Way { faults, sent: 0, newest: 0 }
}

/// What the tool touches: a half space behind `x = 0` of a plane with this outward normal.
#[derive(Clone, Copy, Debug)]
pub struct Matter {
    pub name: &'static str,
    stiffness: f64,
    damping: f64,
    /// Stiffness and damping of a Maxwell element beside it, for tissue that relaxes.
    relaxing: Option<(f64, f64)>,
}

pub const MATTERS: [Matter; 4] = [
    Matter { name: "wall 100", stiffness: 100.0, damping: 0.5, relaxing: None },
    Matter { name: "liver 300", stiffness: 300.0, damping: 1.0, relaxing: Some((200.0, 40.0)) },
    Matter { name: "wall 500", stiffness: 500.0, damping: 0.5, relaxing: None },
    Matter { name: "wall 2000", stiffness: 2_000.0, damping: 1.0, relaxing: None },
];

/// A matter with its relaxation's state.
struct Body {
    matter: Matter,
    normal: Vector3<f64>,
    crept: f64,
}

impl Body {
    /// Force on a tool, never pulling.
    fn force(&mut self, position: &Vector3<f64>, velocity: &Vector3<f64>, secs: f64) -> Vector3<f64> {
        let depth = -self.normal.dot(position);
        let speed = -self.normal.dot(velocity);
        let mut force = 0.0;
        if let Some((stiffness, damping)) = self.matter.relaxing {
            let stretch = stiffness * (depth.max(0.0) - self.crept);
            self.crept += stretch / damping * secs;
            force += stretch;
        }
        if depth > 0.0 {
            force += self.matter.stiffness * depth + self.matter.damping * speed;
            self.normal * force.max(0.0)
        } else {
            Vector3::zeros()
        }
    }
}

struct Point {
    position: Vector3<f64>,
    velocity: Vector3<f64>,
}

/// Where the hand wants to be at a time: in the free, touch and leave twice, press for long, leave.
fn intended(secs: f64, normal: &Vector3<f64>) -> Vector3<f64> {
    let ramp = |from: f64, to: f64, begin: f64, end: f64| {
        let part = ((secs - begin) / (end - begin)).clamp(0.0, 1.0);
        (to - from) * part * part * (3.0 - 2.0 * part)
    };
    // Height over the surface.
    let mut height = 0.03;
    for (begin, end) in [(6.0, 12.0), (16.0, 22.0), (28.0, 52.0)] {
        height += ramp(0.0, -0.038, begin, begin + 0.9) + ramp(0.0, 0.038, end, end + 0.9);
    }
    // Palpation while it presses for the second time, movement in the free at the start.
    if (17.0..22.0).contains(&secs) {
        height += 0.002 * (1.0 - (1.5 * std::f64::consts::TAU * (secs - 17.0)).cos());
    }
    if secs < 5.0 {
        height += 0.025 * (0.5 * std::f64::consts::TAU * secs).sin();
    }
    let tremor = TREMOR.0 * (TREMOR.1 * std::f64::consts::TAU * secs).sin();
    // Sideways along the plane, for three axes.
    let side = if normal.x == 1.0 { 0.0 } else { 0.015 * (0.2 * std::f64::consts::TAU * secs).sin() };
    let along = Vector3::new(0.0, side, -side);
    normal * (height + tremor) + along - normal * normal.dot(&along)
}

/// What came of a session.
#[derive(Debug, Default, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// Mean force over mean depth of the hand at the end of the long press.
    pub felt: f64,
    /// The same for the first press.
    pub first: f64,
    /// Mean force at the end of the long press \[N\].
    pub force: f64,
    /// Least net energy put in at the operator's port, by the plant.
    pub energy_min: f64,
    /// Root mean square of the hand's swing about its mean, early and late in the long press \[m\].
    pub swing: [f64; 2],
    /// Largest swing speed in the last second [m/s], in the free.
    pub speed_end: f64,
    /// Greatest force \[N\].
    pub peak: f64,
    /// Power taken from the hand over its speed squared in the first free movement [N·s/m].
    pub drag: f64,
    /// Distance of both ends at the end \[m\].
    pub apart: f64,
    /// Greatest change of the force within a millisecond of the long press \[N\].
    pub jump: f64,
    /// Lowest level of the two tanks; of the master's alone where the slave is on credit \[J\].
    pub tank_min: f64,
    /// Last method, and the number of changes.
    pub method: (Method, u32),
}

/// What couples hand and tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Coupling {
    /// The tool's coupling itself, in one place: what is felt without a network.
    Direct,
    /// Position and force over the link as they arrive.
    Uncompensated,
    /// Over the link, compensated.
    Compensated(Compensation),
}

/// A session of the bench.
#[derive(Clone, Copy)]
pub struct Setup {
    pub coupling: Coupling,
    /// Real mean round trip of the link.
    pub round_trip: SimTime,
    /// What the link's measurement says at a time, where it is not the real one.
    pub measured: Option<fn(f64) -> SimTime>,
    pub loss: Loss,
    pub matter: Matter,
    pub normal: Vector3<f64>,
    pub arm: Arm,
    /// Where the way of the hand begins \[s\].
    pub begin_secs: f64,
}

impl Setup {
    pub fn new(coupling: Coupling, round_trip_ms: u64, loss: Loss, matter: Matter) -> Self {
        let round_trip = SimTime::from_millis(round_trip_ms);
        Self {
            coupling,
            round_trip,
            measured: None,
            loss,
            matter,
            normal: Vector3::x(),
            arm: ARMS[0],
            begin_secs: 0.0,
        }
    }
}

pub fn session(setup: &Setup) -> Outcome {
    let Setup { coupling, round_trip, loss, matter, normal, arm, begin_secs, .. } = *setup;
    let config = CouplingConfig::default();
    let mut body = Body { matter, normal, crept: 0.0 };
    let mut hand = Point { position: intended(begin_secs, &normal), velocity: Vector3::zeros() };
    let mut tool = Point { position: hand.position, velocity: Vector3::zeros() };
    let choice = if let Coupling::Compensated(choice) = coupling { choice } else { Compensation::default() };
    let mut master = MasterEnd::new(choice, config);
    let mut slave = SlaveEnd::new(config);
    let mut ways = [way(round_trip, loss, 11), way(round_trip, loss, 23)];
    let mut told: Option<CouplingSample> = None;
    let mut raw = [None::<CouplingSample>; 2];
    let mut outcome = Outcome::default();
    let (mut energy, mut pressed, mut swings) = (0.0, [0.0; 2], [[0.0; 3]; 2]);
    let (mut free, mut first, mut held) = ([0.0; 2], [0.0; 2], Vector3::zeros());
    for ms in (begin_secs * 1e3) as u64..SESSION_MS {
        let (now, secs) = (SimTime::from_millis(ms), ms as f64 * STEP);
        let spring = |to: &Vector3<f64>, speed: &Vector3<f64>, tool: &Point| {
            (to - tool.position) * config.coupling_stiffness + (speed - tool.velocity) * TOOL.1
        };
        let force = match coupling {
            Coupling::Direct => {
                let pull = spring(&hand.position, &hand.velocity, &tool);
                move_tool(&mut tool, &mut body, &pull);
                -pull
            }
            Coupling::Uncompensated => {
                ways[0].send(now, &plain(&hand, Vector3::zeros()));
                raw[0] = ways[0].newest(now).or(raw[0]);
                if let Some(heard) = raw[0] {
                    let pull = spring(&heard.position, &heard.velocity, &tool);
                    move_tool(&mut tool, &mut body, &pull);
                    ways[1].send(now, &plain(&tool, -pull));
                }
                raw[1] = ways[1].newest(now).or(raw[1]);
                raw[1].map_or(Vector3::zeros(), |heard| heard.force)
            }
            Coupling::Compensated(_) => {
                let round_trip = setup.measured.map_or(round_trip, |measured| measured(secs));
                let reading = MasterReading { position: hand.position, velocity: hand.velocity, round_trip };
                let heard = ways[1].newest(now);
                let sent = master.step(now, &reading, heard.as_ref());
                ways[0].send(now, &sent);
                let heard = ways[0].newest(now);
                // The force under the last command, then the tool under the new one.
                let at_port =
                    told.map_or(Vector3::zeros(), |told| -spring(&told.position, &told.velocity, &tool));
                told = slave.step(now, &at_port, heard.as_ref());
                if let Some(told) = &told {
                    ways[1].send(now, told);
                    let pull = spring(&told.position, &told.velocity, &tool);
                    move_tool(&mut tool, &mut body, &pull);
                }
                sent.force
            }
        };
        if master.method() != outcome.method.0 {
            outcome.method = (master.method(), outcome.method.1 + 1);
        }
        if secs > 34.0 && secs < 52.0 {
            outcome.jump = outcome.jump.max((force - held).norm());
        }
        held = force;
        let on_credit = master.method() == Method::ModelMediated;
        let slave_level = if on_credit { 0.0 } else { slave.port().level() };
        outcome.tank_min = outcome.tank_min.min(slave_level).min(master.port().level());
        for substep in 0..SUBSTEPS {
            let secs = ms as f64 * STEP + f64::from(substep) * STEP / f64::from(SUBSTEPS);
            let step = STEP / f64::from(SUBSTEPS);
            let goal = intended(secs, &normal);
            let goal_speed = (intended(secs + step, &normal) - goal) / step;
            let pull = (goal - hand.position) * arm.2 + (goal_speed - hand.velocity) * arm.1;
            hand.velocity += (pull + force - hand.velocity * DEVICE.1) * (step / (DEVICE.0 + arm.0));
            let motion = hand.velocity * step;
            energy -= force.dot(&motion);
            hand.position += motion;
        }
        outcome.energy_min = f64::min(outcome.energy_min, energy);
        let depth = -normal.dot(&hand.position);
        outcome.peak = outcome.peak.max(force.norm());
        if (3.0..5.0).contains(&secs) {
            free[0] -= force.dot(&hand.velocity);
            free[1] += hand.velocity.norm_squared();
        }
        if (45.0..52.0).contains(&secs) {
            pressed[0] += force.dot(&normal);
            pressed[1] += depth;
        }
        if (9.0..12.0).contains(&secs) {
            first[0] += force.dot(&normal);
            first[1] += depth;
        }
        for (window, begin) in [(0, 34.0), (1, 46.0)] {
            if (begin..begin + 6.0).contains(&secs) {
                let sums = &mut swings[window];
                sums[0] += 1.0;
                sums[1] += depth;
                sums[2] += depth * depth;
            }
        }
        if secs > 59.0 {
            outcome.speed_end = outcome.speed_end.max(normal.dot(&hand.velocity).abs());
        }
    }
    outcome.felt = pressed[0] / pressed[1];
    outcome.first = first[0] / first[1];
    outcome.force = pressed[0] / 7_000.0;
    outcome.swing = swings.map(|[n, sum, squares]| (squares / n - (sum / n) * (sum / n)).max(0.0).sqrt());
    outcome.apart = (hand.position - tool.position).norm();
    outcome.drag = free[0] / free[1];
    outcome
}

/// A sample of an end without compensation.
fn plain(point: &Point, force: Vector3<f64>) -> CouplingSample {
    let block = CompensationBlock {
        method: Method::Passivity,
        account: EnergyAccount::default(),
        payload: Payload::None,
    };
    CouplingSample { position: point.position, velocity: point.velocity, force, block }
}

fn move_tool(tool: &mut Point, body: &mut Body, coupling: &Vector3<f64>) {
    let step = STEP / f64::from(SUBSTEPS);
    for _ in 0..SUBSTEPS {
        let touch = body.force(&tool.position, &tool.velocity, step);
        tool.velocity += (coupling + touch) * (step / TOOL.0);
        tool.position += tool.velocity * step;
    }
}
