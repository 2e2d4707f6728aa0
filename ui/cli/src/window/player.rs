//! Input of a person at a window: mouse, keyboard and gamepad.

use std::sync::Arc;

use trocar::play::{Bindings, Control, Controls, GamepadReader};
use trocar_kernel::handle::Submitted;
use trocar_scene::{PersonAction, PersonView};
use trocar_viewer::window::Player;

use super::link::{PlayerGuest, Shared};

/// Turns key and button presses into control input, and writes it into the session.
pub struct Person {
    shared: Arc<Shared>,
    bindings: Bindings,
    player_guest: Option<(PlayerGuest, Controls)>,
    pad: Option<GamepadReader>,
}

impl Person {
    /// A person who plays as soon as a session offers a guest.
    pub fn new(shared: Arc<Shared>, bindings: Bindings) -> Self {
        let pad =
            GamepadReader::start().map_err(|error| tracing::info!("no gamepads are read: {error}")).ok();
        Self { shared, bindings, player_guest: None, pad }
    }

    fn controls(&mut self) -> Option<&mut Controls> {
        self.player_guest.as_mut().map(|(_, controls)| controls)
    }
}

impl Player for Person {
    fn press(&mut self, control: &str, down: bool) -> bool {
        let amount = f64::from(u8::from(down));
        match (Control::named(control), self.controls()) {
            (Some(control), Some(controls)) => controls.press(control, amount),
            _ => false,
        }
    }

    fn pointer(&mut self, right: f64, down: f64) {
        if let Some(controls) = self.controls() {
            controls.pointer_moved(right, down);
        }
    }

    fn wheel(&mut self, notches: f64) {
        if let Some(controls) = self.controls() {
            controls.scrolled(notches);
        }
    }

    fn release_all(&mut self) {
        if let Some(controls) = self.controls() {
            controls.release_all();
        }
    }

    fn pass(&mut self, secs: f64, view: Option<PersonView>) {
        if let Some(player_guest) = self.shared.take_player_guest() {
            // A new session: its hands begin at their own positions.
            let controls = Controls::new(self.bindings.clone(), &player_guest.guest.snapshot());
            self.player_guest = Some((player_guest, controls));
        }
        let Some((player_guest, controls)) = &mut self.player_guest else { return };
        while let Some(state) = self.pad.as_ref().and_then(GamepadReader::next) {
            controls.gamepad(state.as_ref());
        }
        controls.advance(secs);
        let input = controls.input(view, player_guest.guest.now());
        let person = player_guest.person;
        match player_guest.guest.write(|_, out| out.put(person, input)) {
            // All values are totals: the next batch contains this one.
            Ok(Submitted::Dropped) => tracing::debug!("the session was too busy for what the person did"),
            Ok(_) => {}
            Err(error) => tracing::debug!("what the person did was refused: {error}"),
        }
    }

    fn help(&self) -> Vec<(String, String)> {
        let pointer = [
            ("pointer".to_owned(), "moves the tip in the picture".to_owned()),
            ("wheel".to_owned(), "moves it away and closer".to_owned()),
        ];
        let actions = PersonAction::ALL.iter().map(|action| {
            let controls = self.bindings.controls.get(action).map_or(&[][..], Vec::as_slice);
            let names: Vec<&str> = controls.iter().map(|control| control.name()).collect();
            (names.join(", "), action.about().to_owned())
        });
        pointer.into_iter().chain(actions).collect()
    }
}
