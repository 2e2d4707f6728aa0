//! The control channel: a station and its host, of whose stream parts come from elsewhere, in pieces and at times of any kind.
#![no_main]

use std::sync::{Arc, LazyLock};

use libfuzzer_sys::fuzz_target;
use trocar_fuzz::control_session::{
    ControlSession, client_facts, counts_of, digest_of, host_facts, name, ticket,
};
use trocar_fuzz::{Bound, Step, first, first_chunk, steps};
use trocar_network::control::{
    ClientControl, ClientEvent, ClientMessage, ClientState, FRAME_MAX, FrameDecoder, Goodbye, HeldScene,
    HostControl, HostFacts, HostMessage, HostState, MessageError, Note, NoteKind, RequestKind, SceneKind,
    SceneManifest, StreamWish, WAITING_MAX, after_preamble, preamble,
};
use trocar_network::ticket::Role;
use trocar_scene::SimTime;

/// The dearest byte is the length of a name of one letter in a list of names; a vector that grows is there twice.
const STREAM: Bound = Bound { per_byte: 96, always: 64 << 10 };

static FACTS: LazyLock<Arc<HostFacts>> = LazyLock::new(|| Arc::new(host_facts()));

/// Watches what one end sends in a connection: whole frames, each a message, the first one with a preamble.
struct Witness {
    decoder: FrameDecoder,
    has_opened: bool,
    check: fn(&[u8]) -> Result<(), MessageError>,
}

impl Witness {
    fn new(check: fn(&[u8]) -> Result<(), MessageError>) -> Self {
        Self { decoder: FrameDecoder::new(FRAME_MAX), has_opened: false, check }
    }

    fn see(&mut self, mut bytes: &[u8]) {
        while let Some(frame) = self.decoder.next_frame(&mut bytes).expect("frames only") {
            let body = if self.has_opened { frame } else { after_preamble(frame).expect("a preamble") };
            // A program of another version is told ours, and nothing else.
            let is_bare = !self.has_opened && body.is_empty();
            self.has_opened = true;
            assert!(is_bare || (self.check)(body) == Ok(()), "{body:?} is no message");
        }
    }
}

/// Reads a message of a station; one that is read comes back from its own bytes.
fn client_message(bytes: &[u8]) -> Result<(), MessageError> {
    let message = ClientMessage::decode(bytes)?;
    let again = postcard::to_stdvec(&message).expect("it was read");
    assert_eq!(ClientMessage::decode(&again), Ok(message));
    Ok(())
}

/// The same of a host.
fn host_message(bytes: &[u8]) -> Result<(), MessageError> {
    let message = HostMessage::decode(bytes)?;
    let again = postcard::to_stdvec(&message).expect("it was read");
    assert_eq!(HostMessage::decode(&again), Ok(message));
    Ok(())
}

struct Pair {
    now: SimTime,
    session: ControlSession,
    host: Option<HostControl>,
    client: ClientControl,
    from_host: Witness,
    from_client: Witness,
    /// What the station has built.
    scene: Vec<u8>,
    held: Option<HeldScene>,
    is_up: bool,
}

impl Pair {
    fn new(role: Role) -> Self {
        Self {
            now: SimTime::ZERO,
            session: ControlSession::default(),
            host: None,
            client: ClientControl::new(client_facts(role), ticket(role), SimTime::ZERO),
            from_host: Witness::new(host_message),
            from_client: Witness::new(client_message),
            scene: Vec::new(),
            held: None,
            is_up: true,
        }
    }

    fn step(&mut self, step: Step<'_>) {
        self.now += SimTime(step.pause_ns);
        let bytes = step.bytes;
        match step.what % 12 {
            0 => self.poll(),
            1 => {
                self.poll();
                self.carry(usize::MAX);
                self.poll();
            }
            2 => self.carry(usize::from(first(bytes).0)),
            3 => self.host_hears(bytes),
            4 => self.client_hears(bytes),
            5 => {
                let is_opening = self.host.as_ref().is_some_and(|host| host.state() == HostState::Opening);
                self.host_hears(&framed(bytes, is_opening));
            }
            6 => self.client_hears(&framed(bytes, self.client.state() == ClientState::Opening)),
            7 => self.host_acts(bytes),
            8 => self.client_acts(bytes),
            9 => {
                self.is_up = first(bytes).0.is_multiple_of(2);
                self.drop_stream("connection reset by peer");
                self.client.broke("connection reset by peer", self.now);
            }
            10 => drop(STREAM.holds(bytes.len(), || (client_message(bytes), host_message(bytes)))),
            _ => self.session.grow(u64::from(first(bytes).0)),
        }
    }

    /// What a driver does when it is woken up: it asks until it may sleep, which is soon.
    fn poll(&mut self) {
        let may_sleep = (0..4).any(|_| self.poll_once());
        assert!(may_sleep, "a driver would spin: {:?}, {:?}", self.client, self.host);
    }

    /// Whether neither end wants to be asked again at once.
    fn poll_once(&mut self) -> bool {
        let now = self.now;
        let poll = self.client.poll(now);
        let may_sleep = poll.deadline > now || poll.stream == StreamWish::Over;
        match poll.stream {
            StreamWish::Keep => {}
            StreamWish::None | StreamWish::Over => self.drop_stream("the station closed it"),
            StreamWish::Connect => {
                self.drop_stream("the station closed it");
                if self.is_up {
                    self.host = Some(HostControl::new(FACTS.clone(), now));
                    self.from_host = Witness::new(host_message);
                    self.from_client = Witness::new(client_message);
                    self.client.connected(self.held, now).expect("it asked for a stream");
                } else {
                    self.client.broke("no route to host", now);
                }
            }
        }
        let Some(poll) = self.host.as_mut().map(|host| host.poll(now)) else { return may_sleep };
        if poll.is_over {
            self.drop_stream("the host closed it");
            self.client.broke("the host closed it", now);
            return false;
        }
        may_sleep && poll.deadline > now
    }

    /// The stream carries so many bytes each way.
    fn carry(&mut self, most: usize) {
        let bytes = self.client.outgoing();
        let bytes = bytes[..bytes.len().min(most)].to_vec();
        if let Some(host) = &mut self.host {
            self.from_client.see(&bytes);
            self.client.advance(bytes.len(), self.now);
            host.receive(&bytes, self.now, &mut self.session);
        }
        let Some(host) = &mut self.host else { return };
        let bytes = host.outgoing();
        assert!(bytes.len() <= WAITING_MAX);
        let bytes = bytes[..bytes.len().min(most)].to_vec();
        self.from_host.see(&bytes);
        host.advance(bytes.len(), self.now);
        self.client_hears(&bytes);
    }

    fn host_hears(&mut self, bytes: &[u8]) {
        let Some(host) = &mut self.host else { return };
        let (before, error) = (host.state(), host.error().cloned());
        STREAM.holds(bytes.len(), || host.receive(bytes, self.now, &mut self.session));
        if before == HostState::Ended {
            assert!(host.state() == HostState::Ended && host.error() == error.as_ref(), "the end is the end");
        }
        assert_eq!(host.error().is_some(), host.state() == HostState::Ended);
        let is_outside =
            matches!(host.state(), HostState::Opening | HostState::Diagnosing | HostState::Ended);
        assert!(host.admitted().is_some() || is_outside);
        assert!(host.admitted().is_none() || host.diagnosed().is_none(), "a diagnosis lets nobody in");
    }

    /// The station takes bytes, and builds what it gets.
    fn client_hears(&mut self, bytes: &[u8]) {
        let (client, now) = (&mut self.client, self.now);
        let mut arrived: Option<(SceneManifest, Vec<u8>)> = None;
        STREAM.holds(bytes.len(), || {
            client.receive(bytes, now, &mut |event| match event {
                ClientEvent::Scene(manifest, bytes) => arrived = Some((manifest.clone(), bytes)),
                ClientEvent::Note(note) => assert_eq!(note.what.check(), Ok(())),
                _ => {}
            });
        });
        let Some((manifest, bytes)) = arrived else { return };
        assert_eq!((manifest.bytes as usize, manifest.hash), (bytes.len(), digest_of(&bytes)));
        if manifest.kind == SceneKind::Whole {
            self.scene.clear();
        }
        self.scene.extend(bytes);
        let digest = digest_of(&self.scene);
        self.held = Some(HeldScene { revision: manifest.revision, digest });
        self.client.scene_built(manifest.revision, &counts_of(&self.scene), digest, now);
    }

    fn host_acts(&mut self, bytes: &[u8]) {
        let (now, (what, rest)) = (self.now, first(bytes));
        let Some(host) = &mut self.host else { return };
        let is_running = host.state() == HostState::Running;
        let sent = match what % 9 {
            0 => host.send_delta(rest, now),
            1 => host.send_roster(self.session.roster.stations(), now),
            2 => host.send_hand_served(first(rest).0, Some(100), now),
            3 => {
                let Ok(what) = postcard::from_bytes::<NoteKind>(rest) else { return };
                host.send_note(Note { station: 100, at: now, what }, now)
            }
            4 => host.send_peer_ticket(100, rest.to_vec(), now),
            5 => host.rekey(now).map(drop),
            6 => {
                host.dismiss(Goodbye::SessionOver, now);
                assert_eq!(host.state(), HostState::Ended);
                return;
            }
            7 => host.send_repair(rest, now),
            _ => {
                host.broke("read error", now);
                assert_eq!(host.state(), HostState::Ended);
                return;
            }
        };
        assert!(
            is_running || sent.is_err() || matches!(host.state(), HostState::Sending | HostState::Awaiting)
        );
    }

    fn client_acts(&mut self, bytes: &[u8]) {
        let (now, (what, rest)) = (self.now, first(bytes));
        let is_running = self.client.state() == ClientState::Running;
        let (client, revision) = (&mut self.client, self.held.map(|held| held.revision).unwrap_or_default());
        let sent = match what % 8 {
            0 => client.write(rest, now),
            1 => {
                let Ok(what) = postcard::from_bytes::<RequestKind>(rest) else { return };
                client.request(what, now).map(drop)
            }
            2 => client.request(RequestKind::TakeHand(name("right")), now).map(drop),
            3 => client.request(RequestKind::GiveHand(name("left")), now).map(drop),
            4 => client.rekeyed(now),
            5 => {
                let (digest, _) = first_chunk(rest);
                return client.scene_built(revision, &counts_of(rest), digest, now);
            }
            6 => return client.scene_failed(revision, "no memory", now),
            _ => {
                client.leave(now);
                assert_eq!(client.state(), ClientState::Ended);
                return;
            }
        };
        assert!(is_running || sent.is_err());
    }

    fn drop_stream(&mut self, why: &str) {
        let Some(mut host) = self.host.take() else { return };
        host.broke(why, self.now);
        if let Some(admitted) = host.admitted() {
            self.session.roster.break_off(admitted.station, admitted.connection, self.now);
        }
    }
}

fn framed(body: &[u8], is_opening: bool) -> Vec<u8> {
    let preamble = if is_opening { preamble().to_vec() } else { Vec::new() };
    let mut bytes = ((preamble.len() + body.len()) as u32).to_le_bytes().to_vec();
    bytes.extend(preamble);
    bytes.extend(body);
    bytes
}

// The first byte says what role the station's ticket has.
fuzz_target!(|bytes: &[u8]| {
    let (role, rest) = first(bytes);
    let mut pair = Pair::new(Role::ALL[usize::from(role) % Role::ALL.len()]);
    steps(rest).for_each(|step| pair.step(step));
});
