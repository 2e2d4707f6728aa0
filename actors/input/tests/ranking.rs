//! The referee, which does not know the skill, ranks the skills.

use crate::support::{DT, Double};
use trocar_input::motor_model::{MotorParameters, Skill};
use trocar_scene::Side;
use trocar_tasks::fls_score::FlsWeights;
use trocar_tasks::peg_geometry::{FieldOfView, Peg, RingPlacement, RingShape};
use trocar_tasks::peg_rules::{PegTransferSetup, RingObservation, Rules, TipObservation};
use trocar_tasks::peg_transfer::{Outcome, PegTransfer};
use trocar_test_support::median;

use nalgebra::{Point3, Vector3};

fn setup(double: &Double) -> PegTransferSetup {
    let peg = |peg: &trocar_input::trainee_view::PegSeen| Peg {
        board: peg.board,
        foot_in_world: peg.foot.into(),
        axis_in_world: peg.up,
        height: peg.height,
    };
    PegTransferSetup {
        pegs: double.bench.pegs.iter().map(peg).collect(),
        ring: RingShape { ring_radius: double.bench.ring_radius, tube_radius: double.bench.tube_radius },
        first_board: double.bench.first_board,
        view: FieldOfView::Box { min: Point3::new(-0.1, -0.1, -0.01), max: Point3::new(0.1, 0.1, 0.2) },
        rules: Rules::default(),
        weights: FlsWeights::default(),
    }
}

/// Runs the whole exercise and returns the referee.
fn judged(skill: Skill, seed: u64) -> (PegTransfer, f64) {
    let mut double = Double::new(Side::Left, MotorParameters::of(skill), seed);
    let setup = setup(&double);
    let mut referee = PegTransfer::new(double.moment.rings.len(), Side::Left);
    while double.secs < 400.0 && referee.outcome().is_none() {
        double.tick();
        let held = double.moment.hands.map(|hand| hand.held);
        let rings: Vec<RingObservation> = double
            .moment
            .rings
            .iter()
            .enumerate()
            .map(|(index, ring)| RingObservation {
                placement: RingPlacement {
                    center_in_world: ring.center().into(),
                    axis_in_world: ring.pose.rotation * Vector3::z(),
                },
                speed: ring.speed,
                held_by: held.map(|held| held == Some(index)),
                touched_by: [false; 2],
            })
            .collect();
        let tips = double.moment.hands.map(|hand| TipObservation {
            tip_in_world: hand.tip.translation.vector.into(),
            shaft_in_world: hand.tip.rotation * Vector3::z(),
        });
        referee.observe(&setup, double.secs, &rings, &tips);
    }
    assert_eq!(referee.outcome(), Some(Outcome::Completed), "{skill:?} seed {seed}: {:?}", referee.errors());
    assert!(referee.seconds() > DT);
    let score = referee.score(&setup).unwrap();
    (referee, score)
}

#[test]
fn score_time_path_and_smoothness_rank_the_skills_over_twenty_seeds() {
    let of = |skill| {
        let runs: Vec<(PegTransfer, f64)> = (0..20).map(|seed| judged(skill, seed)).collect();
        let metric = |name: &str| {
            let sum = |(run, _): &(PegTransfer, f64)| {
                run.metrics()[0].named()[name] + run.metrics()[1].named()[name]
            };
            median(&runs.iter().map(sum).collect::<Vec<f64>>())
        };
        let score = median(&runs.iter().map(|(_, score)| *score).collect::<Vec<f64>>());
        [score, -metric("time_secs"), -metric("path_length_m"), metric("smoothness_ldlj"), metric("economy")]
    };
    let (novice, intermediate, expert) = (of(Skill::Novice), of(Skill::Intermediate), of(Skill::Expert));
    for (index, name) in ["score", "time", "path", "smoothness", "economy"].into_iter().enumerate() {
        assert!(
            expert[index] > intermediate[index] && intermediate[index] > novice[index],
            "{name}: {} {} {}",
            expert[index],
            intermediate[index],
            novice[index]
        );
    }
}
