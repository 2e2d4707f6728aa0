//! Liquid as a whole: momentum, walls, limits, restarts.

use crate::support::basin::tank;
use nalgebra::{Point3, Vector3};
use trocar_simulator::fluid::{Fluid, FluidConfig, FluidStepError};

#[test]
fn without_walls_and_weight_momentum_stays_and_a_block_keeps_its_volume() {
    let config = FluidConfig { gravity: Vector3::zeros(), ..FluidConfig::default() };
    let mut fluid = Fluid::new(config).expect("a liquid");
    let spacing = fluid.config().spacing;
    for (i, j, k) in (0..8).flat_map(|i| (0..8).flat_map(move |j| (0..8).map(move |k| (i, j, k)))) {
        let position = Point3::from([i, j, k].map(|index| f64::from(index) * spacing));
        // Two halves run into each other.
        let velocity = if i < 4 { 0.1 } else { -0.2 };
        fluid.add(position, Vector3::new(velocity, 0.0, 0.0)).expect("in the box");
    }
    let momentum = |fluid: &Fluid| fluid.state().velocities.iter().sum::<Vector3<f64>>();
    let energy = |fluid: &Fluid| fluid.state().velocities.iter().map(Vector3::norm_squared).sum::<f64>();
    let (before, energy_before) = (momentum(&fluid), energy(&fluid));
    for _ in 0..40 {
        let report = fluid.step(0.002).expect("a step");
        assert!(report.compression < 5e-3, "{report:?}");
    }
    assert!((momentum(&fluid) - before).norm() < 1e-9 * before.norm());
    assert!(energy(&fluid) < energy_before);
}

#[test]
fn there_are_never_too_many_and_what_leaves_is_counted() {
    let config = FluidConfig { particles_max: 100, ..FluidConfig::default() };
    let mut fluid = Fluid::new(config).expect("a liquid");
    for index in 0..150 {
        let x = f64::from(index) * 1e-3 - 0.09;
        assert_eq!(fluid.add(Point3::new(x, 0.0, 0.0), Vector3::zeros()), Some(index as u64));
    }
    assert_eq!((fluid.state().numbers.len(), fluid.state().absorbed), (100, 50));
    assert_eq!(fluid.state().numbers.iter().min(), Some(&50), "the oldest went");
    assert_eq!(fluid.add(Point3::new(1.0, 0.0, 0.0), Vector3::zeros()), None);
    assert_eq!(fluid.add(Point3::origin(), Vector3::new(f64::NAN, 0.0, 0.0)), None);
    let sucked = fluid.remove_within(&Point3::new(0.05, 0.0, 0.0), 0.0055, u64::MAX);
    assert!(sucked >= 10, "{sucked}");
    for _ in 0..40 {
        fluid.step(0.01).expect("a step");
    }
    // No floor: all particles fell out of the box.
    assert_eq!((fluid.state().numbers.len(), fluid.state().absorbed), (0, 150));
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| {
            let config = FluidConfig { viscosity: 1e-5, ..FluidConfig::default() };
            let mut fluid = tank([30, 12, 24], [14, 12, 20], 2e-3, config);
            (0..5).for_each(|_| {
                fluid.step(0.005).expect("a step");
            });
            fluid.state().clone()
        })
    };
    let one = run(1);
    assert_eq!(one.numbers.len(), 3360);
    for threads in [2, 3] {
        assert_eq!(run(threads), one, "{threads} threads");
    }
}

#[test]
fn a_state_goes_on_bit_for_bit_and_a_refused_step_changes_nothing() {
    let config = FluidConfig::default();
    let mut fluid = tank([8, 8, 12], [4, 4, 8], 2e-3, config.clone());
    (0..10).for_each(|_| {
        fluid.step(0.005).expect("a step");
    });
    let text = serde_json::to_string(fluid.state()).expect("a state");
    let state = serde_json::from_str(&text).expect("a state");
    let mut other = tank([8, 8, 12], [0, 0, 0], 2e-3, config);
    other.restore(&state).expect("its state");
    for fluid in [&mut fluid, &mut other] {
        (0..10).for_each(|_| {
            fluid.step(0.005).expect("a step");
        });
    }
    assert_eq!(fluid.state(), other.state());
    let before = fluid.state().clone();
    for dt in [0.0, -1.0, f64::NAN, 2.0] {
        assert!(matches!(fluid.step(dt), Err(FluidStepError::Time(_))));
    }
    let mut wrong = before.clone();
    wrong.velocities[0].x = f64::NAN;
    assert_eq!(
        other.restore(&wrong).expect_err("not a number").to_string(),
        "particle 0 has a number that is not finite"
    );
    wrong.velocities[0].x = 1e9;
    other.restore(&wrong).expect("fast, but finite");
    assert!(matches!(other.step(0.01), Err(FluidStepError::TooFast { .. })));
    assert_eq!(other.state(), &wrong);
}

#[test]
fn a_drop_that_flies_out_of_the_box_holds_nothing_up() {
    let config = FluidConfig { parts_max: 128, ..FluidConfig::default() };
    let mut fluid = tank([8, 8, 12], [8, 8, 4], 2e-3, config);
    let count = fluid.state().numbers.len();
    // 267 parts of a sixtieth of a second are a spacing each; it is out of the box after 50.
    let drop = fluid.add(Point3::new(0.008, 0.008, 0.03), Vector3::new(0.0, 0.0, 32.0)).expect("in the box");
    let report = fluid.step(1.0 / 60.0).expect("a step");
    assert!(report.absorbed == 1 && report.parts < 100, "{report:?}");
    assert!(!fluid.state().numbers.contains(&drop) && fluid.state().numbers.len() == count);
}
