//! Ties a knot of prescribed throws around nothing but itself, tightens it, lets go of the ears and loads the loop: how
//! far does it slip, how near do strands come to each other, and which knot is it?
//!
//! `cargo run --release -p trocar-simulator --example thread_trial -- "3 -3" 0.3 2.0 60 [dt] [segment/diameter] [pull]
//! [sweeps] [GJ] [EI]`

use trocar_simulator::suture_thread::{Thread, ThreadMaterial, ThreadReport, knot};

#[path = "../tests/support/thread.rs"]
mod thread_support;

fn with_friction(thread: &Thread, friction: f64) -> Thread {
    let material = ThreadMaterial { friction, ..*thread.material() };
    Thread::restore(material, thread.state().clone()).expect("a thread")
}

fn main() {
    let of =
        |k: usize, other: f64| std::env::args().nth(k).and_then(|text| text.parse().ok()).unwrap_or(other);
    let turns: Vec<i32> = std::env::args()
        .nth(1)
        .unwrap_or_else(|| "3 -3".to_owned())
        .split_whitespace()
        .filter_map(|text| text.parse().ok())
        .collect();
    let (friction, pull, seconds, dt, segment) =
        (of(2, 0.3), of(3, 2.0), of(4, 3.0), of(5, 5e-4), of(6, 1.5));
    let tight = of(7, 6.0);
    let material = ThreadMaterial {
        friction,
        twisting_stiffness: of(9, 2.5e-6),
        bending_stiffness: of(10, 3.5e-8),
        ..ThreadMaterial::silk_2_0()
    };
    let points = thread_support::loose_knot(&turns, material.radius, segment * material.diameter());
    println!("{} nodes, {:?}", points.len(), knot::identify(&points).map(|knot| knot.kind.to_string()));
    let mut thread = Thread::new(material, &points).expect("a thread");
    thread.set_sweeps(of(8, 200.0) as usize);
    let begun = std::time::Instant::now();
    let mut bend = thread_support::Bend::new(thread);
    // As if each throw had been drawn tight before the next one was laid: what is wet slides while it is tightened.
    let wet = of(11, friction);
    bend.thread = with_friction(&bend.thread, wet);
    let tightened = bend.tighten(tight, 0.25, dt);
    bend.thread = with_friction(&bend.thread, friction);
    println!("tightened {tightened:?} after {:?}", begun.elapsed());
    let tell = |time: f64, slip: f64, bend: &thread_support::Bend, report: &ThreadReport| {
        let points = bend.thread.positions();
        let kind =
            knot::identify(points).map_or_else(|error| error.to_string(), |knot| knot.kind.to_string());
        let near = thread_support::nearest_strands(points, material.radius).0;
        println!("{time:.3} s: slip {:.5} mm, nearest {:.4} mm, {kind}; {report:?}", slip * 1e3, near * 1e3);
    };
    bend.load(pull, seconds, dt, tell);
    println!("{:?}", begun.elapsed());
}
