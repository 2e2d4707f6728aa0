//! The stream of a station: the control channel over it, and what is heard there.

use trocar_scene::SimTime;

use super::{INVITED_MAX, StationMachine, StationNews, push};
use crate::control::{ClientEvent, ClientState, HeldScene, SceneManifest, StreamWish};
use crate::replication::replica::Replica;
use crate::session::carrier::Carrier;
use crate::streams::StreamState;

/// Bytes taken from the stream at a step.
const TAKEN_MAX: usize = 1 << 20;
/// Deltas that wait to be applied, one a step.
const DELTAS_MAX: usize = 64;

impl<A: Copy + PartialEq + Send + 'static> StationMachine<A> {
    /// Does what the machine wishes about its stream.
    pub(super) fn connect(&mut self, now: SimTime) {
        let poll = self.control.poll(now);
        match poll.stream {
            StreamWish::None | StreamWish::Over => self.stream.close(),
            StreamWish::Connect => self.stream.connect(now),
            StreamWish::Keep => {}
        }
        match (self.stream.work(now), self.control.state()) {
            (StreamState::Open, ClientState::Connecting) => {
                let held = self.held();
                // The machine asked for the stream, and the wish was checked when it was made.
                let _ = self.control.connected(held, now);
            }
            (StreamState::Closed(why), state) if !matches!(state, ClientState::Away | ClientState::Ended) => {
                self.drain(now);
                self.control.broke(&why, now);
            }
            _ => {}
        }
    }

    /// The scene that the station has, if it followed before.
    pub(super) fn held(&self) -> Option<HeldScene> {
        let has_scene = |replica: &&Replica| replica.counts().deltas > 0 || self.is_in_session;
        let replica = self.replica.as_ref().filter(has_scene)?;
        // The host knows by the revision alone what it has sent; of revision zero it has sent nothing.
        Some(HeldScene { revision: replica.applied(), digest: [0; 32] })
    }

    pub(super) fn receive(&mut self, now: SimTime) {
        if self.built.is_some() && self.replica.is_none() {
            // Nobody knows yet what to do with what follows.
            return;
        }
        self.received.clear();
        let received = match self.control.state() {
            ClientState::Away | ClientState::Connecting | ClientState::Ended => Ok(()),
            _ => self.stream.receive(now, TAKEN_MAX, &mut self.received),
        };
        self.hear(now);
        if let Err(closed) = received {
            self.control.broke(&closed.0, now);
        }
    }

    /// Last words of a stream that has ended, such as why the station is not let in.
    pub(super) fn drain(&mut self, now: SimTime) {
        self.received.clear();
        // How it ended is known already.
        let _ = self.stream.receive(now, TAKEN_MAX, &mut self.received);
        self.hear(now);
    }

    pub(super) fn hear(&mut self, now: SimTime) {
        let mut heard = Heard::default();
        let Self { control, received, deltas, news, stations, replica, carrier, peer, invited, .. } = self;
        let mut failed = None;
        control.receive(received, now, &mut |event| match event {
            ClientEvent::Welcomed(welcome) => {
                heard.welcomed = Some((welcome.connection, welcome.station));
                *stations = welcome.session.stations.clone();
                *carrier = Carrier::default();
                deltas.clear();
                heard.hands_changed = true;
            }
            ClientEvent::Scene(manifest, bytes) => heard.scene = Some((manifest.clone(), bytes)),
            ClientEvent::Delta(piece) => {
                if let Some(replica) = replica {
                    match replica.receive_piece(piece) {
                        Ok(Some(_)) if deltas.len() >= DELTAS_MAX => {
                            failed = Some("the station does not follow its host".to_owned());
                        }
                        Ok(Some(delta)) => deltas.push_back(delta),
                        Ok(None) => {}
                        Err(error) => failed = Some(error.to_string()),
                    }
                }
            }
            ClientEvent::Roster(roster) => *stations = roster,
            ClientEvent::HandServed { .. } => heard.hands_changed = true,
            ClientEvent::Note(note) => push(news, StationNews::Note(note)),
            ClientEvent::Repair(bytes) => {
                if let Some(peer) = peer {
                    peer.answered(bytes);
                }
            }
            ClientEvent::Answer { refusal: Some(refusal), .. } => push(news, StationNews::Refused(refusal)),
            ClientEvent::Answer { refusal: None, .. } | ClientEvent::Clock(_) => {}
            ClientEvent::PeerTicket { from, ticket } => {
                if invited.len() < INVITED_MAX {
                    invited.push_back((from, ticket));
                }
            }
            ClientEvent::Carried { hears, taken, datagram } => carrier.arrived(hears, taken, datagram),
            ClientEvent::Rekey(phase) => heard.rekey = Some(phase),
            ClientEvent::Paused(is_paused) => heard.paused = Some(is_paused),
        });
        if let Some(is_paused) = heard.paused {
            self.note_pause(is_paused);
        }
        if let Some(why) = failed {
            self.control.broke(&why, now);
        }
        if let Some((connection, station)) = heard.welcomed {
            self.open(connection, station, now);
        }
        if heard.hands_changed {
            self.serve_hands();
        }
        if let Some(phase) = heard.rekey {
            self.rekey(phase, now);
        }
        self.take_carried();
        self.built = heard.scene.or(self.built.take());
    }

    /// Moves what waits into the stream.
    pub(super) fn flush(&mut self, now: SimTime) {
        self.send_carried(now);
        while !self.control.outgoing().is_empty() {
            match self.stream.send(now, self.control.outgoing()) {
                Ok(0) => break,
                Ok(count) => self.control.advance(count, now),
                Err(closed) => {
                    self.control.broke(&closed.0, now);
                    break;
                }
            }
        }
        if self.control.state() == ClientState::Ended && self.control.outgoing().is_empty() {
            self.stream.close();
        }
    }
}

#[derive(Default)]
struct Heard {
    welcomed: Option<(u32, u16)>,
    scene: Option<(SceneManifest, Vec<u8>)>,
    hands_changed: bool,
    rekey: Option<u32>,
    paused: Option<bool>,
}
