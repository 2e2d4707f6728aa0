//! The trainee's strategy on a kinematic double.

mod support;

use support::Double;
use trocar_input::motor_model::{MotorParameters, Skill};
use trocar_scene::Side;

#[test]
fn an_expert_carries_all_rings_over_and_back() {
    for giver in [Side::Left, Side::Right] {
        let mut double = Double::new(giver, MotorParameters::of(Skill::Expert), 1);
        let mut last = [String::new(), String::new()];
        while double.secs < 300.0 && !double.trainee.finished() {
            double.tick();
            let steps = double.trainee.steps().map(|s| s.name().to_string());
            if std::env::var("TRACE").is_ok() && steps != last {
                eprintln!(
                    "{:7.2} {:?} {:?} done {} / {}",
                    double.secs,
                    steps,
                    double.trainee.rings(),
                    double.on_board(0),
                    double.on_board(1)
                );
                last = steps;
            }
        }
        assert!(double.trainee.finished());
        assert_eq!(double.on_board(double.bench.first_board), 6);
        assert!((40.0..150.0).contains(&double.secs), "{}", double.secs);
    }
}
