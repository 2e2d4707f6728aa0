//! What a host tells its stations: who is there, what is shown, what has changed in the scene.

use trocar_scene::SimTime;

use super::{HostMachine, Link, told};
use crate::control::{HostState, PACE_BYTES};
use crate::datagram::Kind;
use crate::hands_link::{HandNumbers, HandsOrder, ORDERS_MAX, Parcel};
use crate::peers::comparison::SKETCH_EVERY;
use crate::peers::{repair, sketch};
use crate::replication::pieces;
use crate::session::host_members::{AcceptedNote, NOTES_MAX};

/// Datagrams of rows for one station at a tick.
pub(super) const DATAGRAMS_MAX: usize = 32;
/// The same while the control channel carries them.
const CARRIED_DATAGRAMS_MAX: usize = 4;
/// Places of the ring of orders that rows leave free.
const ORDERS_KEPT: usize = ORDERS_MAX / 4;
/// Time between two rosters with new figures of the links.
const ROSTER_EVERY: SimTime = SimTime::from_millis(1_000);

impl<A: Copy + PartialEq + Send + 'static> HostMachine<A> {
    /// Tells all stations who is there, who serves which hand, and what is shown.
    pub(super) fn tell_all(&mut self, now: SimTime) {
        let served = std::mem::take(&mut self.members.served);
        let notes: Vec<AcceptedNote> = self.members.notes.drain(..).collect();
        let peers = std::mem::take(&mut self.members.peer_tickets);
        if self.members.roster_changed || now >= self.roster_at {
            self.roster_at = now + ROSTER_EVERY;
            self.members.roster_changed = false;
            let stations = self.members.roster.stations();
            for link in self.links.values_mut() {
                told(link.control.send_roster(stations.clone(), now));
            }
        }
        for link in self.links.values_mut() {
            for (hand, station) in &served {
                told(link.control.send_hand_served(*hand, *station, now));
            }
            for note in &notes {
                told(link.control.send_note(note.note.clone(), now));
            }
            for (from, to, ticket) in &peers {
                if link.opened.is_some_and(|(_, station)| station == *to) {
                    told(link.control.send_peer_ticket(*from, ticket.clone(), now));
                }
            }
        }
        let room = NOTES_MAX.saturating_sub(self.shown.len());
        self.shown.extend(notes.into_iter().take(room));
        if !served.is_empty() {
            let links: Vec<(u32, u16)> = self.links.values().filter_map(|link| link.opened).collect();
            for (connection, station) in links {
                let hands = HandNumbers::new(self.members.served_by(station));
                self.hands.order(HandsOrder::Serve { connection, hands });
            }
        }
    }

    /// Sends what has changed to each station that follows.
    pub(super) fn feed(&mut self, now: SimTime) {
        let Self { links, members, hands, payload, .. } = self;
        let scene = members.scene.clone();
        for link in links.values_mut().filter(|link| link.control.state() == HostState::Running) {
            let Some((connection, station)) = link.opened else { continue };
            let Some(member) = members.members.get_mut(&station) else { continue };
            if member.connection != connection {
                continue;
            }
            if link.pieces.is_empty() {
                match member.feed.delta(now, &scene) {
                    Ok(Some(delta)) => link.pieces.extend(pieces::split(&delta)),
                    Ok(None) => {}
                    Err(error) => link.control.broke(&error.to_string(), now),
                }
            }
            // One piece at a time, so that pings and notes wait behind no more than that.
            while link.control.outgoing().len() < PACE_BYTES {
                let Some(piece) = link.pieces.pop_front() else { break };
                told(link.control.send_delta(&piece, now));
            }
            let is_carrying = member.carrier.is_carrying();
            for _ in 0..if is_carrying { CARRIED_DATAGRAMS_MAX } else { DATAGRAMS_MAX } {
                if is_carrying && !member.carrier.has_room(link.control.outgoing().len()) {
                    break;
                }
                // Rows leave room for orders that must not be lost.
                if hands.room() <= ORDERS_KEPT || !member.feed.datagram(now, &scene, payload) {
                    break;
                }
                if let Some(parcel) = Parcel::new(Kind::Rows, payload) {
                    hands.order(HandsOrder::Send { connection, parcel });
                }
            }
        }
    }

    /// Sends peers the rows of bodies that they asked for.
    pub(super) fn repair(&mut self, now: SimTime) {
        while let Some((station, asked)) = self.members.repairs.pop_front() {
            let Some(answer) = repair::answer(&self.members.scene, &self.members.columns, &asked) else {
                continue;
            };
            let of_station = |link: &&mut Link| link.opened.is_some_and(|(_, number)| number == station);
            if let Some(link) = self.links.values_mut().find(of_station) {
                told(link.control.send_repair(&answer, now));
                let what = self.members.scene.name(asked.entity);
                let name = self.members.name_of(station);
                self.note_incident(now, format!("{name}: {what} was repaired, {} bytes", answer.len()));
            }
        }
    }

    /// Tells peers how the bodies are, so that each compares them with its own.
    pub(super) fn send_sketches(&mut self, now: SimTime) {
        if now < self.sketch_at {
            return;
        }
        self.sketch_at = now + SKETCH_EVERY;
        self.sketches += 1;
        let running = self.links.values().filter(|link| link.control.state() == HostState::Running);
        let connections: Vec<u32> = running.filter_map(|link| Some(link.opened?.0)).collect();
        if connections.is_empty() {
            return;
        }
        let (scene, number) = (&self.members.scene, self.sketches);
        let sketches: Vec<_> =
            sketch::bodies(scene).into_iter().flat_map(|body| sketch::of(scene, body, number)).collect();
        for payload in sketch::write(number, &sketches) {
            let Some(parcel) = Parcel::new(Kind::Sketch, &payload) else { continue };
            for &connection in &connections {
                // What has no room is in the next sketch.
                if self.hands.room() > ORDERS_KEPT {
                    self.hands.order(HandsOrder::Send { connection, parcel: parcel.clone() });
                }
            }
        }
    }
}
