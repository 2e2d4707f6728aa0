//! The session behind the connections of a host: what is asked of it, and what it is told.

use std::sync::Arc;

use trocar_scene::{Revision, SimTime};

use super::component_list::ComponentList;
use super::credential::Credential;
use super::diagnosis::Diagnosed;
use super::error::Refusal;
use super::keep_alive::ClockSample;
use super::manifest::{HeldScene, SceneManifest};
use super::message::{RequestKind, SessionInfo, Wish};
use super::plain_text::PlainText;
use crate::ticket::Role;

/// What a host is, as far as a station has to agree with it before it may join.
#[derive(Clone, Debug)]
pub struct HostFacts {
    /// The components of the host's program.
    pub components: ComponentList,
    /// [`ComponentList::digest`] of them.
    pub components_digest: [u8; 32],
    /// Name of the scenario.
    pub scenario_name: PlainText,
    /// BLAKE3 of the scenario's text.
    pub scenario: [u8; 32],
}

/// A station that was let in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Admitted {
    /// Its number.
    pub station: u16,
    /// Number of the connection in datagrams.
    pub connection: u32,
    /// What it may do: the role that it asked for, or else that of its ticket.
    pub role: Role,
}

/// What a newcomer gets.
#[derive(Clone, Debug)]
pub struct SceneOffer {
    /// What it is told of the session.
    pub session: SessionInfo,
    /// The host's clock \[s since 1970\].
    pub host_unix_secs: u64,
    /// What the bytes are.
    pub manifest: SceneManifest,
    /// The encoded scene, or what the station missed of it.
    pub scene: Arc<[u8]>,
}

/// What a station did.
#[derive(Clone, Debug, PartialEq)]
pub enum HostEvent<'a> {
    /// It has built the scene of this revision. Changes after it are to be sent.
    Joined(Revision),
    /// It wrote rows that it owns.
    Write(&'a [u8]),
    /// It tried what its role does not allow.
    Forbidden(Refusal),
    /// A ping came back.
    Clock(ClockSample),
    /// What its hands link has to tell, and a datagram unless it is empty.
    Carried {
        /// Whether it hears the host's datagrams by themselves.
        hears: bool,
        /// How many carried datagrams of hands it has taken.
        taken: u32,
        /// The sealed datagram.
        datagram: &'a [u8],
    },
    /// It uses the keys of this phase.
    Rekeyed(u32),
}

/// The session behind the connections: what the machine asks, and whom it tells.
pub trait HostSession {
    /// Whether a station would be let in, and with which role at most. Changes nothing, and spends no token.
    ///
    /// # Errors
    /// [`Refusal`], foremost [`Refusal::Ticket`].
    fn check(&mut self, credential: &Credential, wish: &Wish) -> Result<Role, Refusal>;

    /// Lets a station in, spends its token, and gives it the hands that it wishes. A station that comes back gets the
    /// number that it had. `role` is what it may do.
    ///
    /// # Errors
    /// [`Refusal`]; then the station is not in the session.
    fn admit(
        &mut self,
        credential: &Credential,
        wish: &Wish,
        role: Role,
        now: SimTime,
    ) -> Result<Admitted, Refusal>;

    /// Gives a connection for echoes to somebody whose ticket the host knows. Spends no token, and lets nobody in.
    ///
    /// # Errors
    /// [`Refusal`]: of a ticket that is not known, expired or withdrawn, or when others are at it.
    fn diagnose(&mut self, credential: &Credential) -> Result<Diagnosed, Refusal>;

    /// What a station that was let in gets: the whole scene, or what it missed since `held`.
    ///
    /// # Errors
    /// [`Refusal::HostTrouble`].
    fn offer(&mut self, admitted: &Admitted, held: Option<HeldScene>) -> Result<SceneOffer, Refusal>;

    /// Does what a station asks for, and has all stations told, this one among them: who serves a hand from now on, and
    /// what a note shows. The station's role allows it.
    ///
    /// # Errors
    /// [`Refusal`], which the station is told.
    fn request(&mut self, station: u16, what: &RequestKind, now: SimTime) -> Result<(), Refusal>;

    /// A station did something.
    fn hear(&mut self, station: u16, event: HostEvent<'_>);
}
