//! An exercise of one's own: its hands get motion metrics, and a virtual fixture adds a force to what they feel. It fails
//! where physics did: by a body that stands still, or a contact that was not kept.

use nalgebra::{Point3, Vector3};
use trocar::prelude::*;
use trocar::run::RunOutcome;
use trocar_scene::scenario::Scenario;
use trocar_tests::lockstep;

/// When the exercise is over \[s\].
const OVER: f64 = 1.5;

/// An exercise of one step that is over after a while. It leads the hand along a line, and adds a fixture to it.
struct OwnTask {
    hand: Entity,
    fixture: VirtualFixture,
    /// How far the hand is led \[m\].
    way: f64,
    /// Time after which the fixture is not renewed \[s\].
    until: f64,
}

impl Controller for OwnTask {
    fn access(&self) -> Access {
        let hand = || EntitySet::Of(vec![self.hand]);
        Access::new()
            .writes::<VirtualFixture>(hand())
            .writes::<HandTarget>(hand())
            .writes::<TaskState>(EntitySet::Own)
    }
    fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let now = tick.time.as_secs_f64();
        if now <= self.until {
            out.put(self.hand, VirtualFixture { at: tick.time, ..self.fixture });
        }
        // Out and back within a second.
        let at = 0.5 * self.way * (1.0 - (std::f64::consts::TAU * now.min(1.0)).cos());
        out.put(self.hand, HandTarget { handle_in_device: Pose::at(at, 0.0, 0.0), gripper: 0.0 });
        let over = now >= OVER;
        out.put(
            tick.me,
            TaskState {
                over,
                completed: over,
                seconds: now,
                score: over.then_some(50.0),
                ..TaskState::default()
            },
        );
        Ok(())
    }
}

/// What the hand was to feel and what its driver rendered, in the device's axes \[N\].
struct Felt {
    secs: f64,
    asked: Vector3<f64>,
    applied: Vector3<f64>,
}

/// The wall without contact, with the exercise.
fn run(fixture: VirtualFixture, way: f64, until: f64) -> (RunOutcome, Vec<Felt>) {
    let app = App::new().controller_with("own-task", move |(): &(), context: &BuildContext<'_>| {
        let hand =
            context.scene.find("hand.right").ok_or_else(|| ControllerError::Scene("no hand".into()))?;
        Ok(OwnTask { hand, fixture, way, until })
    });
    let (_, text) = trocar::app::SCENARIOS.iter().find(|(name, _)| *name == "wall").expect("it is shipped");
    let text = format!("{text}\n[[controller]]\nname = \"task\"\nkind = \"own-task\"\nrate_hz = 100\n");
    let scenario = Scenario::parse("wall.toml".as_ref(), &text, app.registry()).expect("a valid scenario");
    let mut felt = Vec::new();
    // An exercise of which nothing is applied does not end by itself.
    let options = RunOptions { seconds: Some(2.0), ..lockstep(1) };
    let outcome = trocar::run::run(&app, &scenario, &options, &mut |progress| {
        let scene = progress.scene;
        for (hand, state) in scene.iter::<DeviceState>() {
            let asked = scene.get::<DeviceForce>(hand).map_or_else(Vector3::zeros, |force| force.force);
            felt.push(Felt { secs: progress.now.as_secs_f64(), asked, applied: state.applied_force });
        }
    });
    (outcome.expect("the session starts"), felt)
}

#[test]
fn the_hands_of_an_own_task_get_motion_metrics() {
    let (outcome, _) = run(VirtualFixture::default(), 0.030, 0.0);
    let task = &outcome.summary.task;
    assert!(task.completed && task.score == Some(50.0), "{task:?}");
    let right = &task.metrics["right"];
    // Out and back along 30 mm, as closely as the virtual hand follows.
    assert!((right["path_length_m"] - 0.060).abs() < 0.003, "{right:?}");
    assert!((right["time_secs"] - OVER).abs() < 0.1, "{right:?}");
    assert!(right["idle_secs"] > 0.3 && right["depth_m"] < 0.003, "{right:?}");
    assert!(right["smoothness_ldlj"].is_finite() && right["economy"] < 0.1, "{right:?}");
}

#[test]
fn a_virtual_fixture_adds_its_force_to_a_hand_and_fades_when_nobody_renews_it() {
    // World's x is the device's x; y and z are turned around.
    let fixture = VirtualFixture { force: Vector3::new(0.24, 0.0, 0.32), ..VirtualFixture::default() };
    let (outcome, felt) = run(fixture, 0.0, 0.8);
    let at = |secs: f64| felt.iter().find(|felt| felt.secs >= secs).expect("a look");
    let expected = Vector3::new(0.24, 0.0, -0.32);
    assert!((at(0.7).asked - expected).norm() < 1e-9, "{}", at(0.7).asked);
    assert!((at(0.7).applied - expected).norm() < 0.01, "{}", at(0.7).applied);
    assert!((at(0.96).asked - expected * 0.4).norm() < 0.1 * 0.4, "{}", at(0.96).asked);
    assert!(at(1.05).asked.norm() == 0.0 && at(1.05).applied.norm() < 1e-9, "{}", at(1.05).applied);
    assert!(outcome.summary.error.is_none(), "{:?}", outcome.summary.error);
}

/// A hand that puts in no energy is lent half a newton by its driver; what is asked for is at most the device's limit.
#[test]
fn no_fixture_exceeds_the_devices_limits() {
    for fixture in [
        VirtualFixture { force: Vector3::new(100.0, 0.0, 0.0), ..VirtualFixture::default() },
        VirtualFixture {
            stiffness: 1e5,
            center_in_world: Point3::new(1.0, 0.0, 0.0),
            ..VirtualFixture::default()
        },
    ] {
        let (outcome, felt) = run(fixture, 0.0, f64::INFINITY);
        let scene = &outcome.kernel.snapshot;
        let limit = scene.iter::<DeviceInfo>().map(|(_, info)| info.max_force).fold(0.0, f64::max);
        let asked = felt.iter().map(|felt| felt.asked.norm()).fold(0.0, f64::max);
        assert!((asked - limit).abs() < 1e-9, "{asked} N of {limit} N");
        let applied = outcome.summary.force_newtons_max;
        assert!(applied > 0.1 && applied <= limit * (1.0 + 1e-9), "{applied} N of {limit} N");
    }
}

#[test]
fn an_invalid_fixture_is_refused_and_the_run_says_whose_it_was() {
    let fixture = VirtualFixture { stiffness: 1e9, ..VirtualFixture::default() };
    let (outcome, _) = run(fixture, 0.0, f64::INFINITY);
    let error = outcome.summary.error.clone().expect("it says so");
    assert!(
        error.starts_with("task: all of its") && error.contains("'virtual_fixture' of 'hand.right'"),
        "{error}"
    );
    assert_eq!(outcome.exit(), trocar::summary::Exit::Failed);
}

/// What is wrong with the physics of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Wrong {
    Nothing,
    FrozenBody,
    DeepContact,
    StrongContact,
}

/// An exercise that is completed after half a second, in a scene where something goes wrong before.
struct Spoiler {
    wrong: Wrong,
    has_exercise: bool,
    stone: Entity,
    table: Entity,
}

impl Controller for Spoiler {
    fn access(&self) -> Access {
        Access::new()
            .writes::<Frozen>(EntitySet::Of(vec![self.stone]))
            .writes::<TaskState>(EntitySet::Own)
            .contributes::<CollisionList>()
    }
    fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let now = tick.time.as_secs_f64();
        let touch = |depth: f64, force: f64| CollisionList {
            collisions: vec![Collision {
                a: self.table,
                primitive_a: Primitive::Shape(0),
                b: self.stone,
                primitive_b: Primitive::Shape(0),
                points_in_world: [Point3::new(0.001, 0.002, 0.003); 2],
                normal_in_world: Vector3::z(),
                depth,
                force_in_world: Vector3::new(0.0, 0.0, force),
                velocity_constraint: 0.0,
                method: Detection::Custom,
                detected_at: tick.time,
            }],
            penetration_max: depth,
        };
        if now > 0.2 {
            match self.wrong {
                Wrong::Nothing => out.contribute(touch(1e-3, 1.0)),
                Wrong::FrozenBody => {
                    out.put(self.stone, Frozen { reason: "its solver failed".to_owned(), since: tick.time });
                }
                // The stone is a ball of 10 mm.
                Wrong::DeepContact => out.contribute(touch(8e-3, 1.0)),
                Wrong::StrongContact => out.contribute(touch(1e-3, 150.0)),
            }
        }
        let over = now >= 0.5;
        if self.has_exercise {
            let score = over.then_some(100.0);
            out.put(
                tick.me,
                TaskState { over, completed: over, seconds: now, score, ..TaskState::default() },
            );
        }
        Ok(())
    }
}

#[test]
fn an_exercise_in_which_a_body_froze_or_a_contact_was_not_kept_fails_and_says_why() {
    const SCENE: &str = "schema = 1\nname = \"spoiled\"\ntitle = \"A stone\"\ndescription = \"A stone on a table\"\n\
        [[entity]]\nname = \"stone\"\nshape = { sphere = { radius = 0.005 } }\n\
        rigid_body = { motion = \"dynamic\", mass = 0.01 }\n\
        [[entity]]\nname = \"table\"\nshape = { box = { half_extents = [0.1, 0.1, 0.01] } }\n\
        rigid_body = { motion = \"static\" }\n\
        [[controller]]\nname = \"task\"\nkind = \"spoiler\"\nrate_hz = 100\n";
    let run = |wrong: Wrong, has_exercise: bool| {
        let app = App::new().controller_with("spoiler", move |(): &(), context: &BuildContext<'_>| {
            let find = |name: &str| {
                let found = context.scene.find(name);
                found.ok_or_else(|| ControllerError::Scene(format!("no {name}")))
            };
            Ok(Spoiler { wrong, has_exercise, stone: find("stone")?, table: find("table")? })
        });
        let scenario = Scenario::parse("spoiled.toml".as_ref(), SCENE, app.registry()).expect("a scenario");
        let options = RunOptions { seconds: Some(1.0), ..lockstep(1) };
        let outcome = trocar_tests::finish(&app, &scenario, &options);
        (outcome.exit().code(), outcome.summary)
    };
    let (code, summary) = run(Wrong::Nothing, true);
    assert_eq!((code, summary.bodies_frozen, summary.contacts_not_kept), (0, 0, 0), "{:?}", summary.task);
    let (code, summary) = run(Wrong::FrozenBody, true);
    assert_eq!((code, summary.bodies_frozen, summary.contacts_not_kept), (1, 1, 0));
    assert!(
        summary.task.completed && summary.frozen_bodies[0].to_string().contains("stone stands still since")
    );
    for (wrong, value, limit) in [(Wrong::DeepContact, 8e-3, 7.5e-3), (Wrong::StrongContact, 150.0, 100.0)] {
        let (code, summary) = run(wrong, true);
        assert_eq!((code, summary.bodies_frozen, summary.contacts_not_kept), (1, 0, 1), "{wrong:?}");
        let told = &summary.unkept_contacts[0];
        assert_eq!((told.a.as_str(), told.b.as_str()), ("table", "stone"));
        assert_eq!(told.at_in_world, [0.001, 0.002, 0.003]);
        assert!((told.value - value).abs() < 1e-12 && (told.limit - limit).abs() < 1e-12, "{told:?}");
    }
    // A scene without an exercise counts them, and is no failure.
    let (code, summary) = run(Wrong::DeepContact, false);
    assert_eq!((code, summary.contacts_not_kept), (0, 1), "{:?}", summary.task);
}
