//! Another actor, which receives the coach's messages.

use actix::prelude::*;

/// A sentence to speak.
#[derive(Message)]
#[rtype(result = "()")]
pub struct Say(pub String);

/// Speaks sentences one after the other, on its own thread, where it may block.
pub struct Speaker;

impl Actor for Speaker {
    type Context = SyncContext<Self>;
}

impl Handler<Say> for Speaker {
    type Result = ();
    fn handle(&mut self, Say(text): Say, _: &mut Self::Context) {
        eprintln!("coach: {text}");
    }
}
