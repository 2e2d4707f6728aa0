//! The trainee on the real physics: the whole chain from its intent to the ring and back.

use crate::support::lockstep::Session;
use trocar_input::{AutopilotConfig, Skill};
use trocar_scene::Instrument;

fn expert() -> AutopilotConfig {
    AutopilotConfig { skill: Skill::Expert, ..AutopilotConfig::default() }
}

#[test]
fn an_expert_completes_the_exercise() {
    let mut session = Session::new(&expert(), 1, |_| {});
    let mut story = Vec::new();
    let mut last = String::new();
    let task = session.run(200.0, |session| {
        let steps = format!("{:?}", session.task().done);
        if steps != last {
            story.push(session.describe());
            last = steps;
        }
    });
    let story = story.join("\n");
    assert!(task.completed && !task.cut_off, "{story}\n{}\n{task:?}", session.describe());
    assert_eq!((task.done, task.steps), (12, 12));
    assert!((60.0..150.0).contains(&task.seconds), "{} s\n{story}", task.seconds);
    assert!(task.score.is_some_and(|score| score > 50.0), "{:?}", task.score);
}

#[test]
fn without_friction_or_with_one_jaw_no_ring_is_lifted() {
    let broken: [fn(&mut Instrument); 2] =
        [|instrument| instrument.jaw_friction = 0.0, |instrument| instrument.jaws = 1];
    for change in broken {
        let mut session = Session::new(&expert(), 1, change);
        let task = session.run(25.0, |_| {});
        assert_eq!(task.done, 0, "{}", session.describe());
        assert!(!task.completed);
        let handed_over =
            session.scene().events().since(0).any(|(_, event)| event.name == "ring_handed_over");
        assert!(!handed_over, "{}", session.describe());
    }
}

#[test]
fn a_left_handed_trainee_starts_on_the_other_side() {
    let mut session = Session::new(&AutopilotConfig { left_handed: true, ..expert() }, 2, |_| {});
    let task = session.run(40.0, |session| {
        let done = session.task().done;
        assert!(done <= 12);
    });
    assert!(task.done >= 2, "{}\n{task:?}", session.describe());
    let scene = session.scene();
    let first_lift = scene.events().since(0).find(|(_, event)| event.name == "ring_lifted");
    let by = first_lift.and_then(|(_, event)| event.object).expect("a ring was lifted");
    assert_eq!(scene.name(by), "grasper.right");
}

#[test]
fn restarts_of_referee_and_trainee_change_no_bit() {
    let (mut whole, mut restarted) = (Session::new(&expert(), 3, |_| {}), Session::new(&expert(), 3, |_| {}));
    whole.run(9.0, |_| {});
    // In the middle of approaches, pinches and the hand-over.
    let mut at = [0.5, 1.77, 1.96, 2.9, 4.61, 5.0, 7.3].into_iter().peekable();
    restarted.run(9.0, |session| {
        if at.peek().is_some_and(|at| session.secs() >= *at) {
            at.next();
            session.restart_referee_and_trainee();
        }
    });
    assert_eq!(at.peek(), None);
    let bytes = |session: &Session| {
        let mut bytes = Vec::new();
        session.scene().encode(&mut bytes).unwrap();
        bytes
    };
    assert!(bytes(&whole) == bytes(&restarted), "{}\n{}", whole.describe(), restarted.describe());
}
