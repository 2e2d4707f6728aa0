//! Planning by trying: a hand finds its way to a ring without knowing anything of fulcrums, registrations or motors.
//! `cargo run --release -p trocar --example futures`.
//!
//! Again and again the session is branched into a dozen futures, each of which aims the hand a little elsewhere and lets
//! a fifth of a second pass. The one that comes closest to the ring is kept and becomes the session (random shooting:
//! Richards, "Robust constrained model predictive control", 2005).

use std::thread;
use std::time::Instant;

use trocar::prelude::*;

/// Futures that are tried from one moment.
const FUTURES: u32 = 12;
/// How far they look ahead.
const HORIZON: SimTime = SimTime::from_millis(200);
/// Largest change of the aim from one moment to the next, along each axis \[m\].
const REACH: f64 = 0.012;
/// The tip shall come this close to the middle of the tube of the ring \[m\].
const CLOSE: f64 = 0.004;

struct Names {
    hand: Entity,
    instrument: Entity,
    ring: Entity,
}

/// Distance of the tip from the nearest point of the ring's tube \[m\].
fn cost(scene: &Snapshot, names: &Names) -> f64 {
    let ring = scene.world_pose(names.ring);
    let tip = ring.inverse_transform_point(&scene.world_pose(names.instrument).translation.vector.into());
    let radius = match scene.get::<Shape>(names.ring) {
        Some(Shape::Torus { ring_radius, .. }) => *ring_radius,
        _ => 0.0,
    };
    (tip.x.hypot(tip.y) - radius).hypot(tip.z)
}

/// The `index`-th of a sequence of numbers from -1 to 1 that fill the interval evenly (Halton, 1960).
fn spread(mut index: u32, base: u32) -> f64 {
    let (mut share, mut sum) = (1.0, 0.0);
    while index > 0 {
        share /= f64::from(base);
        sum += share * f64::from(index % base);
        index /= base;
    }
    2.0 * sum - 1.0
}

/// What comes of it if the hand aims elsewhere by the given share of its reach.
fn try_out(mut session: Session, names: &Names, aim: HandTarget, share: [f64; 3]) -> Tried {
    let mut target = aim;
    for (axis, share) in share.into_iter().enumerate() {
        target.handle_in_device.translation[axis] += REACH * share;
    }
    // An aim that the Model refuses leaves the hand where it was, and the future as it would have been.
    let _ = session.apply(|out| out.put(names.hand, target));
    session.step(HORIZON);
    let cost = cost(&session.snapshot(), names);
    Tried { session, target, cost }
}

struct Tried {
    session: Session,
    target: HandTarget,
    cost: f64,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut session = Session::builder().without("autopilot").open("peg-transfer")?;
    let scene = session.snapshot();
    let find = |name: &str| scene.find(name).ok_or_else(|| format!("the scenario has no '{name}'"));
    let names =
        Names { hand: find("hand.right")?, instrument: find("grasper.right")?, ring: find("ring.1")? };
    session.step(SimTime::from_millis(100));
    let start = session.snapshot().get::<DeviceState>(names.hand).copied().unwrap_or_default();
    let mut aim = HandTarget { handle_in_device: start.handle_in_device, gripper: 0.5 };
    let begun = Instant::now();
    for round in 0..60 {
        let far = cost(&session.snapshot(), &names);
        println!("{:5.1} s  tip {:5.1} mm from the ring", session.now().as_secs_f64(), far * 1e3);
        if far < CLOSE {
            let wall = begun.elapsed().as_secs_f64();
            println!("there, after {} futures in {wall:.1} s", round * FUTURES);
            return Ok(());
        }
        let futures = (0..FUTURES).map(|_| session.branch()).collect::<Result<Vec<_>, _>>()?;
        let tried: Vec<Tried> = thread::scope(|scope| {
            let threads = (0..).zip(futures).map(|(n, future)| {
                // The first one changes nothing: to wait is a plan, too.
                let share = |base| if n == 0 { 0.0 } else { spread(round * FUTURES + n, base) };
                let (names, shares) = (&names, [2, 3, 5].map(share));
                scope.spawn(move || try_out(future, names, aim, shares))
            });
            let threads: Vec<_> = threads.collect();
            threads.into_iter().map(|thread| thread.join().expect("no future panics")).collect()
        });
        if let Some(best) = tried.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost)) {
            (session, aim) = (best.session, best.target);
        }
    }
    Err("no way to the ring was found".into())
}
