//! Another actor, to which the coach talks by message.

use actix::prelude::*;

/// A sentence to be said.
#[derive(Message)]
#[rtype(result = "()")]
pub struct Say(pub String);

/// Says sentences, one after the other, on a thread of its own: it may take its time.
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
