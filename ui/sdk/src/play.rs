//! Sessions that a person plays without a haptic device: by pointer, keyboard or gamepad.
//!
//! With [`RunOptions::play`](crate::run::RunOptions::play) a controller of kind `manual` replaces the virtual trainee,
//! and the scene has an entity with a [`PersonInput`]. The program that owns the window keeps [`Controls`], passes them
//! key and button presses, and writes their input into the scene once per picture:
//!
//! ```
//! use trocar::play::{Bindings, Control, Controls, person};
//! use trocar::prelude::*;
//!
//! let mut session = Session::builder().play().open("peg-transfer")?;
//! let scene = session.snapshot();
//! let person = person(&scene).expect("somebody plays");
//! let mut controls = Controls::new(Bindings::default(), &scene);
//!
//! let right = Control::named("KeyD").expect("a key");
//! controls.press(right, 1.0);
//! for _ in 0..30 {
//!     controls.advance(1.0 / 60.0);
//!     let input = controls.input(None, session.now());
//!     session.apply(|out| out.put(person, input))?;
//!     session.step(SimTime::from_micros(16_667));
//! }
//! let tip = |scene: &Snapshot| scene.world_pose(scene.find("grasper.left").expect("an instrument")).translation.x;
//! assert!(tip(&session.snapshot()) > tip(&scene) + 0.02, "the left tip has moved to the right");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! In real time a window on another thread writes through [`Session::operator`](crate::session::Session::operator)
//! instead, and [`GamepadReader`] reads a gamepad.

use trocar_scene::scenario::Scenario;
use trocar_scene::{Entity, PersonInput, Snapshot};

pub use trocar_devices::gamepad::{GamepadReader, GamepadReaderError, GamepadState};
pub use trocar_input::manual::{Bindings, BindingsError, Control, Controls, ManualConfig};

use crate::error::AssemblyError;
use crate::kind::joining;
use crate::kinds::{AUTOPILOT, MANUAL, PATH};

/// Ticks per second of the person's controller where there is no virtual trainee to take the rate from \[Hz\].
const RATE_HZ: f64 = 100.0;

/// The entity that takes the person's input, in a session that a person plays.
pub fn person(scene: &Snapshot) -> Option<Entity> {
    PersonInput::of(scene).map(|(entity, _)| entity)
}

/// The scenario with a person instead of its virtual trainee, or as a further controller where there is none.
///
/// # Errors
/// [`AssemblyError::NoHands`] when the scenario has no hands.
pub fn played(scenario: &Scenario) -> Result<Scenario, AssemblyError> {
    if scenario.hands.is_empty() {
        return Err(AssemblyError::NoHands(scenario.name.clone()));
    }
    let mut played = scenario.clone();
    let is_trainee = |entry: &trocar_scene::ControllerEntry| [AUTOPILOT, PATH].contains(&entry.kind.as_str());
    let already = played.controllers.iter().any(|entry| entry.kind == MANUAL);
    match played.controllers.iter().position(is_trainee) {
        _ if already => {}
        // One person for all moved hands.
        Some(at) => played.controllers[at] = joining(MANUAL, MANUAL, played.controllers[at].rate_hz),
        None => played.controllers.push(joining(MANUAL, MANUAL, RATE_HZ)),
    }
    played.controllers.retain(|entry| !is_trainee(entry));
    Ok(played)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::App;
    use crate::run::{RunOptions, start};

    fn controllers(name: &str) -> Vec<(String, String, f64)> {
        let scenario = played(&App::new().scenario(name).expect("a scenario")).expect("it has hands");
        let row =
            |entry: &trocar_scene::ControllerEntry| (entry.name.clone(), entry.kind.clone(), entry.rate_hz);
        scenario.controllers.iter().map(row).collect()
    }

    #[test]
    fn a_person_takes_the_trainees_place_or_joins_where_there_is_none() {
        let manual = || ("manual".to_owned(), "manual".to_owned(), 100.0);
        let transfer = controllers("peg-transfer");
        assert_eq!(transfer[4], manual());
        assert!(transfer.iter().all(|(_, kind, _)| kind != AUTOPILOT) && transfer.len() == 5);
        // Two paths for two hands; one person replaces both.
        let cut = controllers("cloth-cut");
        assert!(cut.iter().all(|(_, kind, _)| kind != PATH), "{cut:?}");
        assert_eq!(cut.iter().filter(|(_, kind, _)| kind == MANUAL).count(), 1);
        assert_eq!(controllers("wall")[2..], [manual()]);
    }

    #[test]
    fn a_scene_that_is_played_has_its_person_beside_everything_that_the_file_has() {
        let app = App::new();
        let scenario = app.scenario("wall").expect("a scenario");
        let options = RunOptions { lockstep: true, play: true, ..RunOptions::default() };
        let mut session = start(&app, &scenario, &options).expect("it starts");
        let scene = session.snapshot();
        let person = person(&scene).expect("somebody plays");
        assert_eq!(scene.name(person), "person");
        assert_eq!(
            scene.get::<PersonInput>(person).map(|input| input.in_charge),
            Some(trocar_scene::Side::Right)
        );
        for (name, entity) in scenario.entities() {
            assert_eq!(scene.find(name), Some(*entity), "{name}");
        }
        let unplayed = RunOptions { lockstep: true, ..RunOptions::default() };
        let mut session = start(&app, &scenario, &unplayed).expect("it starts");
        assert_eq!(super::person(&session.snapshot()), None);
    }

    #[test]
    fn a_scenario_without_hands_cannot_be_played_and_says_so() {
        let app = App::new();
        let text = "schema = 1\nname = \"empty\"\n";
        let scenario = app.scenario_from("empty.toml".as_ref(), text).expect("a scenario");
        let options = RunOptions { lockstep: true, play: true, ..RunOptions::default() };
        let error = start(&app, &scenario, &options).err().expect("refused").to_string();
        assert!(error.contains("'empty' has no hands") && error.contains("[[hand]]"), "{error}");
    }
}
