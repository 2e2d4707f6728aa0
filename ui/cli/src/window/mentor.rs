//! What the person at a window shows the others, as the session's scene has it.

use trocar_kernel::handle::Submitted;
use trocar_kernel::live::Guest;
use trocar_scene::{MentorAnswer, MentorDeed, MentorInput, SurfacePlace};

/// Writes the [`MentorInput`] of the windows of one session.
pub struct MentorWriter {
    guest: Guest,
    input: MentorInput,
    /// The scene does not have it yet.
    is_new: bool,
}

impl MentorWriter {
    /// A new source, after those of the session's windows before.
    pub fn new(guest: Guest) -> Self {
        let scene = guest.snapshot();
        let before = MentorInput::of(&scene, guest.me().station()).map_or(0, |input| input.source);
        let input = MentorInput { source: before.wrapping_add(1), first: 1, ..MentorInput::default() };
        Self { guest, input, is_new: false }
    }

    /// Takes what a window shows, as far as there is room, and writes it into the session.
    pub fn show(&mut self, pointer: Option<Option<SurfacePlace>>, deeds: &mut Vec<MentorDeed>) {
        if let Some(answer) = MentorAnswer::of(&self.guest.snapshot()) {
            let waited = self.input.deeds.len();
            self.input.forget_taken(answer);
            self.is_new |= self.input.deeds.len() != waited;
        }
        if let Some(pointer) = pointer {
            self.is_new |= self.input.pointer != pointer;
            self.input.pointer = pointer;
        }
        let taken = deeds.iter().take_while(|deed| self.input.add((*deed).clone())).count();
        self.is_new |= taken > 0;
        deeds.drain(..taken);
        if !self.is_new {
            return;
        }
        let (me, input) = (self.guest.me(), self.input.clone());
        match self.guest.write(|_, out| out.put(me, input)) {
            // What the session was too busy for is in the next input, too.
            Ok(Submitted::Dropped) => {}
            Ok(_) => self.is_new = false,
            Err(error) => {
                tracing::debug!("what the person shows was refused: {error}");
                // A deed that the scene refuses would stop all after it.
                let deeds = self.input.deeds.len() as u64;
                self.input = MentorInput {
                    source: self.input.source,
                    first: self.input.first + deeds,
                    ..MentorInput::default()
                };
            }
        }
    }
}
