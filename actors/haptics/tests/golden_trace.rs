//! A golden force trace: how force feels must not change between releases without anybody noticing.
//!
//! A fixed trajectory over two walls with friction and a weight, physics at 100 Hz, through a port with a
//! seal. After an intended change, delete `tests/golden/force_trace.csv`, run this test once, look at the
//! difference, and commit the new file with the reason.

use std::fmt::Write as _;

use crate::support::{Bench, Mount, Wall, handle, start_tip};
use nalgebra::Vector3;
use trocar_devices::VirtualHandConfig;
use trocar_haptics::HapticsConfig;

const GOLDEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/force_trace.csv");
const HEADER: &str = "t_secs,x,y,z,fx,fy,fz,energy";

fn trace() -> Vec<[f64; 8]> {
    let hand = VirtualHandConfig { start_in_device: handle(0.004, 0.0, 0.0), ..VirtualHandConfig::default() };
    let wall = Wall {
        friction: 0.3,
        base_force: Vector3::new(0.0, 0.0, -0.05),
        ..Wall::plane(start_tip(Mount::SealedPort), Vector3::new(-0.8, 0.0, 0.6), 100)
    };
    let mut bench = Bench::new(hand, HapticsConfig::default(), Mount::SealedPort, wall);
    let mut rows = Vec::new();
    // A triangle of aims, so that the trace is made of arithmetic that repeats on every machine.
    for step in 0..100u32 {
        let phase = f64::from(step % 40) / 40.0;
        let press = 1.0 - 2.0 * (phase - 0.5).abs();
        let slide = f64::from(step) / 100.0;
        bench.aim(Vector3::new(0.002 - 0.008 * press, 0.01 * slide, 0.004 * press));
        bench.run(20);
        let (position, force) = bench.felt();
        let energy = bench.status().energy;
        let t = bench.now.as_secs_f64();
        rows.push([t, position.x, position.y, position.z, force.x, force.y, force.z, energy]);
    }
    rows
}

#[test]
fn the_force_trace_is_the_recorded_one() {
    let rows = trace();
    let Ok(recorded) = std::fs::read_to_string(GOLDEN) else {
        let mut text = format!("{HEADER}\n");
        for row in &rows {
            let cells: Vec<String> = row.iter().map(|value| format!("{value:.9e}")).collect();
            writeln!(text, "{}", cells.join(",")).unwrap();
        }
        std::fs::write(GOLDEN, text).unwrap();
        panic!("{GOLDEN} did not exist and was written: look at it, commit it, run again");
    };
    let mut lines = recorded.lines();
    assert_eq!(lines.next(), Some(HEADER));
    let mut strongest = 0.0f64;
    for (number, row) in rows.iter().enumerate() {
        let line = lines.next().unwrap_or_else(|| panic!("the record ends at row {number}"));
        let expected: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        assert_eq!(expected.len(), row.len());
        for (column, (value, expected)) in row.iter().zip(&expected).enumerate() {
            assert!(
                (value - expected).abs() < 1e-7 + 1e-6 * expected.abs(),
                "row {number}, column {column}: {value} instead of {expected}"
            );
        }
        strongest = strongest.max(Vector3::new(row[4], row[5], row[6]).norm());
    }
    assert_eq!(lines.next(), None);
    assert!(strongest > 0.5, "the trace must press: {strongest} N");
}

#[test]
fn the_trace_repeats_to_the_bit() {
    assert_eq!(trace(), trace());
}
