//! The trainee against the real physics.

#[path = "support/lockstep.rs"]
mod lockstep;

use lockstep::Session;
use trocar_input::{AutopilotConfig, Skill};
use trocar_scene::{CollisionList, Grasp, InstrumentTarget, JawState};

#[test]
fn an_expert_completes_the_exercise() {
    let config = AutopilotConfig { skill: Skill::Expert, ..AutopilotConfig::default() };
    let trace = std::env::var("TRACE").is_ok();
    let limit: f64 = std::env::var("LIMIT").ok().and_then(|v| v.parse().ok()).unwrap_or(300.0);
    let seed: u64 = std::env::var("SEED").ok().and_then(|v| v.parse().ok()).unwrap_or(1);
    let mut session = Session::new(&config, seed, |_| {});
    let mut last = String::new();
    let mut errors = 0;
    let task = session.run(limit, |session| {
        let Some(state) = session.trainee() else { return };
        let steps = state.autopilot.steps().map(|step| step.name());
        let rings = state.autopilot.rings();
        let now = format!("{steps:?}{rings:?}");
        let task = session.task();
        if trace && (now != last || task.errors.len() != errors) {
            let scene = session.scene();
            let side = |name: &str| {
                let e = scene.find(name).unwrap();
                let jaw = scene.get::<JawState>(e).copied().unwrap_or_default();
                let tip = scene.world_pose(e).translation.vector * 1e3;
                let target = scene
                    .get::<InstrumentTarget>(e)
                    .map(|t| (t.tip_in_world.translation * 1e3 - tip).norm())
                    .unwrap_or(0.0);
                let held = scene.get::<Grasp>(e).map_or("-".to_string(), |g| {
                    let in_tip = scene.world_pose(e).inverse() * scene.world_pose(g.held);
                    let point = (0..720)
                        .map(|k| {
                            let a = f64::from(k) * std::f64::consts::PI / 360.0;
                            in_tip * nalgebra::Point3::new(0.008 * a.cos(), 0.008 * a.sin(), 0.0)
                        })
                        .min_by(|a, b| (a.x * a.x + a.y * a.y).total_cmp(&(b.x * b.x + b.y * b.y)))
                        .unwrap();
                    format!("{} d{:.2},{:.2}", &scene.name(g.held)[5..], -point.z * 1e3, point.x * 1e3)
                });
                format!(
                    "tip {:6.1} {:6.1} {:6.1} off {:4.1} jaw {:.2} f {:.1}/{:.1} {held:6}",
                    tip.x, tip.y, tip.z, target, jaw.angle, jaw.pad_force[0], jaw.pad_force[1]
                )
            };
            eprintln!(
                "{:7.2} {:24} {:?} L {} R {} done {} err {:?}",
                session.secs(),
                steps.join(" "),
                rings,
                side("grasper.left"),
                side("grasper.right"),
                task.done,
                task.errors.last().map(|e| e.kind.clone())
            );
            last = now;
            errors = task.errors.len();
        }
    });
    let depth = session.scene().iter::<CollisionList>().map(|(_, l)| l.penetration_max).fold(0.0, f64::max);
    eprintln!(
        "{:?} {:?} done {} of {} in {:.1} s, score {:?}, errors {:?}, penetration {:.1} um",
        config.skill,
        task.phase,
        task.done,
        task.steps,
        task.seconds,
        task.score,
        task.errors,
        depth * 1e6
    );
    assert!(task.completed, "{task:?}");
}
