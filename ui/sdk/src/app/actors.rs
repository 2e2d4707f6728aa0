//! Plain actix actors that a program adds to its sessions.

use std::sync::Arc;

use trocar_kernel::actix::{Actor, Context};
use trocar_kernel::live::{Guest, HostedActor, LiveError, LiveSession};
use trocar_scene::{Access, WriterId};

use crate::app::{App, SetupError};

type Start = Arc<dyn Fn(&LiveSession, WriterId) -> Result<HostedActor, LiveError> + Send + Sync>;

/// An actor that joins every live session.
#[derive(Clone)]
pub(crate) struct ActorKind {
    pub(crate) name: String,
    pub(crate) start: Start,
}

impl App {
    /// Adds a plain actix actor, by this name among the writers, to every live session.
    ///
    /// `build` makes it from the [`Guest`] that it acts through: at the start, and again after every panic. It has its
    /// own thread and actix system and ends with the session. Even an endless loop in it does not hold up the session.
    ///
    /// Lock-step has no real time, so actors are left out there: use a [`Controller`](trocar_scene::Controller) for
    /// work in virtual time.
    #[must_use]
    pub fn actor<A>(
        mut self,
        name: &str,
        access: Access,
        build: impl Fn(Guest) -> A + Send + Sync + 'static,
    ) -> Self
    where
        A: Actor<Context = Context<A>>,
    {
        if self.actors.iter().any(|actor| actor.name == name) {
            self.wrong.get_or_insert(SetupError::ActorTaken(name.to_owned()));
            return self;
        }
        let (build, own_name) = (Arc::new(build), name.to_owned());
        let start: Start = Arc::new(move |live, id| {
            let build = build.clone();
            live.actor(&own_name, id, &access, move |guest| build(guest))
        });
        self.actors.push(ActorKind { name: name.to_owned(), start });
        self
    }

    /// Names of the actors that join every live session.
    pub fn actors(&self) -> impl Iterator<Item = &str> {
        self.actors.iter().map(|actor| actor.name.as_str())
    }
}
